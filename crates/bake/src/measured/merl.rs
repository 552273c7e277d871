//! Measured isotropic BRDFs of the MERL database (Matusik et al. 2003, "A Data-Driven
//! Reflectance Model").
//!
//! A file is three `i32` dimensions and, per channel, `f64` values over the half and
//! difference angles of Rusinkiewicz 1998: θ of the half vector, its square root in equal
//! steps, θ of the difference vector and φ of the difference vector, a half turn.

use relight_format::math;
use std::f32::consts::{FRAC_PI_2, PI};

use glam::{Vec2, Vec3};
use relight_shading::reference;
use relight_shading::surface::{Appearance, Model, Reflection};

use crate::error::{Objection, first_bytes};

/// Steps of θ of the half vector, θ and φ of the difference vector.
const DIMENSIONS: [usize; 3] = [90, 90, 180];
const ENTRIES: usize = DIMENSIONS[0] * DIMENSIONS[1] * DIMENSIONS[2];
const HEADER: usize = 12;
/// What stored values are multiplied by.
const SCALES: [f64; 3] = [1.0 / 1500.0, 1.15 / 1500.0, 1.66 / 1500.0];

/// A table.
pub struct Merl {
    /// 1/sr, 0 where nothing was measured: directions below the horizon.
    values: Vec<[f32; 3]>,
}

impl Merl {
    /// Decodes the bytes of a `.binary` file, which are not trusted.
    pub(crate) fn parse(bytes: &[u8]) -> Result<Self, Objection> {
        let length = HEADER + 3 * ENTRIES * 8;
        let expected =
            "\"tensor_file\" of a .bsdf, the numbers 90, 90, 180 of a .binary, or the ending .toml";
        let Some((header, values)) = bytes.split_at_checked(HEADER) else {
            let found = first_bytes(bytes);
            return Err(Objection::new("first bytes", expected, found));
        };
        let dimensions: Vec<i32> = header
            .as_chunks::<4>()
            .0
            .iter()
            .map(|bytes| i32::from_le_bytes(*bytes))
            .collect();
        if dimensions != DIMENSIONS.map(|extent| extent as i32) {
            let found = first_bytes(header);
            return Err(Objection::new("first bytes", expected, found));
        }
        if bytes.len() != length {
            let found = format!("{} bytes", bytes.len());
            return Err(Objection::new(
                "file",
                format_args!("{length} bytes"),
                found,
            ));
        }
        let mut table = vec![[0.0; 3]; ENTRIES];
        let (numbers, _) = values.as_chunks::<8>();
        for (channel, (plane, scale)) in numbers.chunks_exact(ENTRIES).zip(SCALES).enumerate() {
            for (index, (entry, bytes)) in table.iter_mut().zip(plane).enumerate() {
                let value = (f64::from_le_bytes(*bytes) * scale) as f32;
                if !value.is_finite() {
                    let place = format!("value {index} of channel {channel}");
                    return Err(Objection::new(place, "a finite number", value));
                }
                // Unmeasured entries are negative.
                entry[channel] = value.max(0.0);
            }
        }
        Ok(Self { values: table })
    }

    /// Whether nothing is reflected.
    pub(super) fn is_black(&self) -> bool {
        self.values.iter().flatten().all(|value| *value <= 0.0)
    }

    /// BRDF in 1/sr (linear Rec.709, cosine not included) for unit vectors towards the
    /// light and the eye; zero where either is below the surface. The nearest entry, as in
    /// the database's own code.
    pub(crate) fn evaluate(&self, light: Vec3, view: Vec3) -> Vec3 {
        if light.z <= 0.0 || view.z <= 0.0 {
            return Vec3::ZERO;
        }
        let Some(half) = (light + view).try_normalize() else {
            return Vec3::ZERO;
        };
        // The light in the frame whose z is the half vector and whose y is orthogonal to
        // the normal.
        let horizontal = half.truncate().length();
        let along = if horizontal > 0.0 {
            half.truncate() / horizontal
        } else {
            Vec2::X
        };
        let x = Vec3::new(along.x * half.z, along.y * half.z, -horizontal);
        let y = Vec3::new(-along.y, along.x, 0.0);
        let difference = Vec3::new(light.dot(x), light.dot(y), light.dot(half));
        let azimuth = math::atan2(difference.y, difference.x);
        // Light and eye may be exchanged: a half turn tells all.
        let azimuth = if azimuth < 0.0 { azimuth + PI } else { azimuth };
        let step = |t: f32, count: usize| ((t * count as f32) as usize).min(count - 1);
        let index = [
            step((angle(half) / FRAC_PI_2).sqrt(), DIMENSIONS[0]),
            step(angle(difference) / FRAC_PI_2, DIMENSIONS[1]),
            step(azimuth / PI, DIMENSIONS[2]),
        ];
        let entry = (index[0] * DIMENSIONS[1] + index[1]) * DIMENSIONS[2] + index[2];
        Vec3::from(self.values[entry])
    }
}

/// Angle from +z, accurate near the pole.
fn angle(direction: Vec3) -> f32 {
    2.0 * math::asin((0.5 * direction.distance(Vec3::Z)).min(1.0))
}

/// What directions are drawn from: a Lambertian base and highlights of every width, as the
/// table itself offers no density to invert.
fn proposal() -> Appearance<'static> {
    let highlights =
        [0.03, 0.1, 0.3].map(|alpha| Reflection::new(Model::Ggx, Vec3::ONE, Vec2::splat(alpha)));
    Appearance::new(Vec3::ONE, &highlights)
}

/// A direction towards the light, distributed as [`pdf`].
pub(super) fn sample(view: Vec3, uniform: [f32; 3]) -> Option<Vec3> {
    reference::sample(&proposal(), view, uniform)
}

/// Density of [`sample`] in 1/sr.
pub(super) fn pdf(light: Vec3, view: Vec3) -> f32 {
    reference::pdf(&proposal(), light, view)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A file whose entries say where they are.
    fn file() -> Vec<u8> {
        let mut bytes: Vec<u8> = DIMENSIONS
            .iter()
            .flat_map(|&extent| (extent as i32).to_le_bytes())
            .collect();
        for scale in SCALES {
            for index in 0..ENTRIES {
                bytes.extend((index as f64 / scale).to_le_bytes());
            }
        }
        bytes
    }

    fn direction(elevation: f32, azimuth: f32) -> Vec3 {
        let (sin, cos) = math::sin_cos(elevation);
        Vec3::new(sin * math::cos(azimuth), sin * math::sin(azimuth), cos)
    }

    #[test]
    fn half_and_difference_angles_choose_the_entry() {
        let table = Merl::parse(&file()).expect("a valid file");
        // Light straight above, eye at 2θ: θ of half and difference are θ, φ is 0 or half a
        // turn, which is the same.
        for degrees in [10.5f32, 20.5, 40.5] {
            let theta = degrees.to_radians();
            let value = table
                .evaluate(direction(0.0, 0.0), direction(2.0 * theta, 0.7))
                .x;
            let entry = value as usize;
            assert_eq!(
                entry / (90 * 180),
                ((degrees / 90.0).sqrt() * 90.0) as usize
            );
            assert_eq!(entry / 180 % 90, degrees as usize);
            assert!(matches!(entry % 180, 0 | 179), "{}", entry % 180);
        }
        // A mirror: half vector up, any φ; light and eye exchanged give the same entry but
        // for the rounding of φ by one step.
        let (light, view) = (direction(0.61, 0.3), direction(0.9, 2.0));
        let (there, back) = (table.evaluate(light, view), table.evaluate(view, light));
        assert!(there.distance(back) <= 2.0, "{there} and {back}");
        let turned = table.evaluate(direction(0.61, 1.3), direction(0.9, 3.0));
        assert!(there.distance(turned) <= 2.0, "{there} and {turned}");
        assert_eq!(table.evaluate(light, -view), Vec3::ZERO);
    }

    #[test]
    fn broken_files_are_errors_that_name_the_place() {
        let message = |bytes: &[u8]| Merl::parse(bytes).err().expect("broken").to_string();
        let good = file();
        assert!(message(&good[..11]).starts_with("first bytes"));
        assert!(message(&good[..good.len() - 1]).starts_with("file"));
        assert!(message(&[&good[..], &[0]].concat()).starts_with("file"));
        for (position, value) in [(0, 91), (4, 0), (11, 0x80), (2, 0xff)] {
            let mut bytes = good.clone();
            bytes[position] = value;
            assert!(message(&bytes).starts_with("first bytes"), "{position}");
        }
        let mut bytes = good.clone();
        bytes[HEADER + 8 * (ENTRIES + 5)..][..8].copy_from_slice(&f64::NAN.to_le_bytes());
        assert!(message(&bytes).starts_with("value 5 of channel 1"));
        bytes[HEADER + 8 * (ENTRIES + 5)..][..8].copy_from_slice(&(-1f64).to_le_bytes());
        assert!(Merl::parse(&bytes).is_ok());
    }
}
