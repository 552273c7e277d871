//! What the environment's image shows beyond the lights that stand for it, through a lobe.
//!
//! A sum of a few dozen lobes is a blurry mirror. Level by level the image as seen through lobes
//! of one sharpness is stored ([`relight_format::Prefiltered`]); what the lights show through the
//! same lobes is taken off, and a lobe between two sharpnesses mixes the two levels of the
//! difference. So lookups need be exact only as far as the lights are not the image: small
//! bright lights, which the levels blur and mix worst, are in the lights.

use relight_format::math;
use std::sync::Arc;

use glam::Vec3;

use crate::octahedral;
use crate::spherical_gaussian::{SphericalGaussian, energy};

/// An environment's prefiltered image less its lights. Clones share the texels.
#[derive(Clone, Debug)]
pub struct Prefiltered {
    levels: u32,
    texels: Arc<[u32]>,
}

impl Prefiltered {
    /// The image of an environment less `lights`, not turned: those of the frames that it is
    /// for. `None` where the environment has no image, or an invalid one.
    pub fn new(
        prefiltered: &relight_format::Prefiltered,
        lights: &[SphericalGaussian],
    ) -> Option<Self> {
        let levels = prefiltered.levels().filter(|levels| *levels > 0)?;
        let texel = |((axis, sharpness), texel): ((Vec3, f32), &u32)| {
            let lobe = SphericalGaussian {
                axis,
                sharpness,
                amplitude: Vec3::ONE,
            };
            let lights: Vec3 = lights
                .iter()
                .map(|light| light.product(&lobe).integral())
                .sum();
            encode_signed(decode(*texel) - lights / energy(sharpness))
        };
        let texels = Self::lobes(levels).zip(&prefiltered.texels).map(texel);
        Some(Self::of_texels(levels, texels.collect()))
    }

    /// Texels of so many levels, each [`encode_signed`].
    pub(crate) fn of_texels(levels: u32, texels: Arc<[u32]>) -> Self {
        debug_assert_eq!(
            texels.len(),
            relight_format::Prefiltered::texel_count(levels)
        );
        Self { levels, texels }
    }

    /// Axis and sharpness of the lobe that every texel of so many levels sees, before texels are
    /// interpolated.
    pub(crate) fn lobes(levels: u32) -> impl Iterator<Item = (Vec3, f32)> {
        (0..levels).flat_map(move |level| {
            let n = 1u32 << (levels - level);
            let variance = 1.0 / (relight_format::Prefiltered::SHARPNESS * (n * n) as f32);
            let lobe = move |(y, x): (u32, u32)| {
                let axis = octahedral::texel_direction(x, y, n).normalize();
                // Interpolation between texels blurs as well, by a sixth of a texel's area.
                let area = octahedral::texel_area(axis, n);
                (axis, 1.0 / (variance - area / 6.0))
            };
            (0..n)
                .flat_map(move |y| (0..n).map(move |x| (y, x)))
                .map(lobe)
        })
    }

    /// Number of levels, at least 1.
    pub fn levels(&self) -> u32 {
        self.levels
    }

    /// The texels of all levels, in the order of the asset's, each [`encode_signed`].
    pub fn texels(&self) -> &Arc<[u32]> {
        &self.texels
    }

    /// Mean radiance of the image less that of the lights under the lobe
    /// exp(sharpness (axis·ω − 1)). Lobes sharper or wider than
    /// those stored count as the sharpest or widest stored.
    pub fn radiance(&self, axis: Vec3, sharpness: f32) -> Vec3 {
        let rows = (sharpness / relight_format::Prefiltered::SHARPNESS).max(1.0);
        let widest = (self.levels - 1) as f32;
        let level = (self.levels as f32 - 0.5 * math::log2(rows)).clamp(0.0, widest);
        let sharper = level.floor().min((widest - 1.0).max(0.0));
        let number = sharper as u32;
        let a = self.bilinear(number, axis);
        let b = self.bilinear((number + 1).min(self.levels - 1), axis);
        // Linear in the root of the sharpness: between small lights, of which lobes see as much
        // as they are sharp, and large ones.
        a.lerp(b, 2.0 * (1.0 - math::exp2(sharper - level)))
    }

    fn bilinear(&self, level: u32, direction: Vec3) -> Vec3 {
        let n = 1u32 << (self.levels - level);
        // Levels of 4ᵏ texels, from 4 ^ levels down: those from here on are (4 n² − 4) / 3.
        let start = self.texels.len() as u32 - (4 * n * n - 4) / 3;
        let p = octahedral::encode(direction) * n as f32 - 0.5;
        let low = p.floor();
        let f = p - low;
        let texel = |dx: i32, dy: i32| {
            let (x, y) = octahedral::wrap(low.x as i32 + dx, low.y as i32 + dy, n);
            decode_signed(self.texels[(start + y * n + x) as usize])
        };
        let top = texel(0, 0).lerp(texel(1, 0), f.x);
        let bottom = texel(0, 1).lerp(texel(1, 1), f.x);
        top.lerp(bottom, f.y)
    }
}

/// The texel nearest to `radiance`, each at least 0; what is above 65,408 becomes that.
pub fn encode(radiance: Vec3) -> u32 {
    const MOST: f32 = 511.0 * 128.0;
    let radiance = radiance.clamp(Vec3::ZERO, Vec3::splat(MOST));
    let brightest = radiance.max_element();
    // The exponent e with brightest < 2^(e − 15), so that 9 bits reach to it.
    let bits = (brightest.to_bits() >> 23) as i32 - 127;
    let mut exponent = (bits + 16).clamp(0, 31);
    let quantise = |exponent: i32| (radiance / power(exponent)).round();
    // Rounding may reach 512.
    if exponent < 31 && quantise(exponent).max_element() > 511.0 {
        exponent += 1;
    }
    let [r, g, b] = quantise(exponent)
        .min(Vec3::splat(511.0))
        .to_array()
        .map(|x| x as u32);
    r | g << 9 | b << 18 | (exponent as u32) << 27
}

/// The radiance of a texel.
pub fn decode(texel: u32) -> Vec3 {
    let channel = |shift: u32| (texel >> shift & 511) as f32;
    Vec3::new(channel(0), channel(9), channel(18)) * power((texel >> 27) as i32)
}

/// The texel nearest to a difference of radiances: an exponent of 5 bits above three channels of
/// 8 bits and a sign. What is farther from zero than 130,560 becomes that.
pub fn encode_signed(radiance: Vec3) -> u32 {
    const MOST: f32 = 255.0 * 512.0;
    let radiance = radiance.clamp(Vec3::splat(-MOST), Vec3::splat(MOST));
    let brightest = radiance.abs().max_element();
    // The exponent e with brightest < 2^(e − 14), so that 8 bits reach to it.
    let bits = (brightest.to_bits() >> 23) as i32 - 127;
    let mut exponent = (bits + 15).clamp(0, 31);
    let quantise = |exponent: i32| (radiance / power(exponent + 2)).round();
    // Rounding may reach 256.
    if exponent < 31 && quantise(exponent).abs().max_element() > 255.0 {
        exponent += 1;
    }
    let limit = Vec3::splat(255.0);
    let [r, g, b] = quantise(exponent)
        .clamp(-limit, limit)
        .to_array()
        .map(|x| x as i32 as u32 & 511);
    r | g << 9 | b << 18 | (exponent as u32) << 27
}

/// The difference of a texel.
pub fn decode_signed(texel: u32) -> Vec3 {
    let channel = |shift: u32| ((texel << (23 - shift)) as i32 >> 23) as f32;
    Vec3::new(channel(0), channel(9), channel(18)) * power((texel >> 27) as i32 + 2)
}

/// 2^(exponent − 24), exact.
fn power(exponent: i32) -> f32 {
    f32::from_bits(((exponent - 24 + 127) as u32) << 23)
}

/// The constants of this module, as WGSL.
pub fn wgsl_constants() -> String {
    let sharpness = relight_format::Prefiltered::SHARPNESS;
    format!(
        "const PREFILTERED_SHARPNESS: f32 = {sharpness:?};\n\
         const PREFILTERED_TEXTURE_WIDTH: u32 = {TEXTURE_WIDTH}u;\n"
    )
}

/// Texels per row of the GPU texture, which holds the texels in order, row after row.
pub const TEXTURE_WIDTH: u32 = 1024;

#[cfg(test)]
mod tests {
    use super::*;

    /// Half a step of 9 bits of which the highest is set.
    const QUANTISATION: f32 = 1.0 / 512.0;

    #[test]
    fn texels_keep_eight_bits_of_the_brightest_channel() {
        for i in 0..400 {
            let scale = math::powf(2f32, 0.1 * (i - 230) as f32);
            let radiance = Vec3::new(1.0, 0.37, 0.002) * scale;
            if scale > 65_000.0 {
                continue;
            }
            let error = (decode(encode(radiance)) - radiance).abs().max_element();
            // Below 2⁻¹⁵ the exponent ends.
            assert!(
                error <= QUANTISATION * scale.max(1.0 / 32768.0),
                "{radiance}: {error}"
            );
        }
        assert_eq!(decode(encode(Vec3::ZERO)), Vec3::ZERO);
        assert_eq!(decode(encode(Vec3::splat(1e30))), Vec3::splat(65_408.0));
        assert_eq!(decode(encode(Vec3::splat(511.9))), Vec3::splat(512.0));
    }

    #[test]
    fn differences_keep_eight_bits_and_their_sign() {
        for i in 0..400 {
            let scale = math::powf(2f32, 0.1 * (i - 200) as f32);
            let radiance = Vec3::new(-1.0, 0.37, 0.002) * scale;
            if scale > 130_000.0 {
                continue;
            }
            let error = (decode_signed(encode_signed(radiance)) - radiance).abs();
            assert!(
                error.max_element() <= 2.0 * QUANTISATION * scale.max(1.0 / 16384.0),
                "{radiance}: {error}"
            );
        }
        assert_eq!(decode_signed(encode_signed(Vec3::ZERO)), Vec3::ZERO);
        let least = decode_signed(encode_signed(Vec3::splat(-1e30)));
        assert_eq!(least, Vec3::splat(-130_560.0));
        assert_eq!(
            decode_signed(encode_signed(Vec3::splat(-255.9))),
            Vec3::splat(-256.0)
        );
    }

    #[test]
    fn lights_are_taken_off() {
        // An image that is one light and half as much again of another.
        let light = |axis: Vec3, sharpness| SphericalGaussian {
            axis: axis.normalize(),
            sharpness,
            amplitude: Vec3::new(3.0, 2.0, 1.0),
        };
        let lights = [
            light(Vec3::new(0.2, 0.5, -0.7), 40.0),
            light(Vec3::new(-0.5, 0.1, 0.6), 9.0),
        ];
        let levels = 6;
        let mut texels = vec![];
        for level in 0..levels {
            let n = 1u32 << (levels - level);
            let variance = 1.0 / (relight_format::Prefiltered::SHARPNESS * (n * n) as f32);
            for (y, x) in (0..n).flat_map(|y| (0..n).map(move |x| (y, x))) {
                let axis = octahedral::texel_direction(x, y, n).normalize();
                let area = 4.0 / (n * n) as f32 * axis.abs().element_sum().powi(3);
                let lobe = SphericalGaussian {
                    axis,
                    sharpness: 1.0 / (variance - area / 6.0),
                    amplitude: Vec3::ONE,
                };
                let seen = lights.map(|l| l.product(&lobe).integral() / lobe.integral());
                texels.push(encode(seen[0] + 1.5 * seen[1]));
            }
        }
        let image = relight_format::Prefiltered { texels };
        let rest = Prefiltered::new(&image, &lights).expect("whole levels");
        for sharpness in [5.0, 30.0, 150.0] {
            for axis in [lights[0].axis, lights[1].axis, Vec3::X] {
                let lobe = SphericalGaussian {
                    axis,
                    sharpness,
                    amplitude: Vec3::ONE,
                };
                let expected = 0.5 * (lights[1].product(&lobe).integral() / lobe.integral());
                let found = rest.radiance(axis, sharpness);
                // Half of the second light, which levels mix to a few per cent, and nine bits
                // of the first.
                let error = (found - expected).abs().max_element();
                assert!(error < 0.1, "{sharpness} {axis}: {found} for {expected}");
            }
        }
    }

    /// All levels of one colour but the given one.
    fn image(levels: u32, bright: u32) -> Prefiltered {
        let texels = (0..levels).flat_map(|level| {
            let value = if level == bright { 2.0 } else { 1.0 };
            std::iter::repeat_n(encode(Vec3::splat(value)), 1 << (2 * (levels - level)))
        });
        let texels = texels.collect();
        Prefiltered::new(&relight_format::Prefiltered { texels }, &[]).expect("whole levels")
    }

    #[test]
    fn levels_are_found_by_sharpness_and_mixed() {
        let image = image(4, 1);
        // Level 1 has 8 rows.
        let sharpness = relight_format::Prefiltered::SHARPNESS * 64.0;
        for (factor, expected) in [
            (1.0, 2.0),
            (4.0, 1.0),
            (0.25, 1.0),
            (2.0, 3.0 - 2.0f32.sqrt()),
            (1e9, 1.0),
            (1e-9, 1.0),
        ] {
            let found = image
                .radiance(Vec3::new(0.3, -0.5, 0.7).normalize(), sharpness * factor)
                .x;
            assert!((found - expected).abs() < 1e-5, "{factor}: {found}");
        }
        let single = self::image(1, 0);
        assert_eq!(single.radiance(Vec3::Y, 1.0), Vec3::splat(2.0));
    }

    #[test]
    fn radiance_is_continuous_across_the_border_of_the_map() {
        let texels = (0..relight_format::Prefiltered::texel_count(3) as u32)
            .map(|i| encode(Vec3::splat((i.wrapping_mul(2_654_435_761) >> 24) as f32)))
            .collect();
        let image = Prefiltered::new(&relight_format::Prefiltered { texels }, &[]).expect("levels");
        for i in 0..100 {
            // Either side of the quarter planes x = 0 or z = 0 below the equator.
            let angle = 0.015 * i as f32 + 0.01;
            let near = |side: f32| Vec3::new(side, -math::sin(angle), math::cos(angle)).normalize();
            let [a, b] = [1e-6, -1e-6].map(|side| image.radiance(near(side), 3.0).x);
            assert!((a - b).abs() < 0.01, "{a} {b}");
        }
    }
}
