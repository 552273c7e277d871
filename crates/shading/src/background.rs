//! What is behind a scene: an image of all directions, sharp or blurred.

use std::sync::Arc;

use glam::{Vec2, Vec3};
use relight_format::Environment;
use relight_format::math;

use crate::octahedral::{self, texel_area};
use crate::prefiltered::{Prefiltered, decode, encode_signed};
use crate::sources::Sources;
use crate::spherical_gaussian::{SphericalGaussian, energy};

/// Levels of the image of an environment that has none: 128² texels.
const LEVELS_OF_LOBES: u32 = 7;
/// Most levels: 2048² texels in the sharpest, 22 MB with those below it.
const MOST_LEVELS: u32 = 11;
/// Texels per side of the first level of an image that is blurred by its lobes, and not only enough to
/// be half as sharp as the one above it.
const BLURRED: u32 = 128;
/// Exponent below which a narrow lobe adds nothing.
const NOTHING: f32 = 20.0;

/// The sphere of directions as a picture, for backgrounds. Clones share the texels.
#[derive(Clone, Debug)]
pub struct Panorama(Prefiltered);

impl Panorama {
    /// What an environment asset shows: its image, or its lobes where it has none, and its sources,
    /// all at the resolution of its image (256² texels at most, 0.8° of a direction each). Takes about
    /// a tenth of a second.
    pub fn of_environment(environment: &Environment) -> Self {
        let stored = &environment.prefiltered;
        let levels = stored.levels().filter(|levels| *levels > 0);
        let mut lights: Vec<SphericalGaussian> = Vec::new();
        if levels.is_none() {
            lights.extend(environment.lobes.iter().map(SphericalGaussian::from));
        }
        let sources = Sources::new(environment);
        lights.extend(sources.iter().flat_map(Sources::lobes));
        let levels = levels.unwrap_or(LEVELS_OF_LOBES);
        let texel = |(index, (axis, sharpness)): (usize, (Vec3, f32))| {
            let image = stored.texels.get(index).map_or(Vec3::ZERO, |t| decode(*t));
            let seen: Vec3 = (lights.iter())
                .map(|light| mean_under(light, axis, sharpness))
                .sum();
            encode_signed(image + seen)
        };
        let texels: Arc<[u32]> = Prefiltered::lobes(levels).enumerate().map(texel).collect();
        Self(Prefiltered::of_texels(levels, texels))
    }

    /// A lat-long image as in ARCHITECTURE.md: `pixels` are linear radiance, row 0 is +Y. `None` where
    /// there are none, or not `width` × `height` of them. What is not a number is black; it is stored with
    /// eight bits of the brightest channel, at up to 2048² texels. Takes about a quarter of a second per
    /// million pixels.
    pub fn from_lat_long([width, height]: [u32; 2], pixels: &[[f32; 3]]) -> Option<Self> {
        let count = u64::from(width) * u64::from(height);
        if count == 0 || count != pixels.len() as u64 {
            return None;
        }
        let levels = (0.5 * math::log2(count as f64)).ceil() as u32;
        let levels = levels.clamp(1, MOST_LEVELS);
        let n = 1u32 << levels;
        let look = |at: Vec2| lat_long(pixels, [width, height], octahedral::decode(at / n as f32));
        // Four of each where texels are wider than pixels.
        let fine = u64::from(n) * u64::from(n) < count;
        let texel = |x: u32, y: u32| {
            let centre = Vec2::new(x as f32, y as f32) + 0.5;
            if !fine {
                return look(centre);
            }
            let corner = |dx, dy| look(centre + Vec2::new(dx, dy));
            let rows = [-0.25, 0.25].map(|dy| corner(-0.25, dy) + corner(0.25, dy));
            0.25 * (rows[0] + rows[1])
        };
        let mut level: Vec<Vec3> = (0..n)
            .flat_map(|y| (0..n).map(move |x| (x, y)))
            .map(|(x, y)| texel(x, y))
            .collect();
        let mut texels = Vec::with_capacity(relight_format::Prefiltered::texel_count(levels));
        for index in 0..levels {
            texels.extend(level.iter().map(|&texel| encode_signed(texel)));
            if index + 1 < levels {
                let n = n >> index;
                level = if n / 2 > BLURRED {
                    halved(&level, n)
                } else {
                    blurred(&level, n, index == 0 || n == 2 * BLURRED)
                };
            }
        }
        Some(Self(Prefiltered::of_texels(levels, texels.into())))
    }

    /// Mean radiance under the lobe exp(sharpness (axis·ω − 1)), `axis` of unit length. Lobes sharper
    /// or wider than those stored count as the sharpest or widest stored; of [`Self::from_lat_long`] those
    /// above a sharpness of 800 come out narrower than they are.
    pub fn radiance(&self, axis: Vec3, sharpness: f32) -> Vec3 {
        (self.0.radiance(axis, Self::sharpness(sharpness))).max(Vec3::ZERO)
    }

    /// A sharpness as shaders take it: finite, above 0.
    pub fn sharpness(sharpness: f32) -> f32 {
        // Not a number is the least.
        if sharpness >= 1e-3 {
            sharpness.min(1e9)
        } else {
            1e-3
        }
    }

    /// The texels of [`Self::levels`], made before, on another machine or by another process; `None`
    /// where there are not as many as any number of levels has.
    pub fn from_texels(texels: &[u32]) -> Option<Self> {
        let count = relight_format::Prefiltered::texel_count;
        let levels = (1..=MOST_LEVELS).find(|levels| count(*levels) == texels.len())?;
        Some(Self(Prefiltered::of_texels(levels, texels.into())))
    }

    /// The levels, as shaders have them.
    pub fn levels(&self) -> &Prefiltered {
        &self.0
    }
}

/// Mean radiance of a light under a lobe.
fn mean_under(light: &SphericalGaussian, axis: Vec3, sharpness: f32) -> Vec3 {
    // Sharpness of the product as a function of the angle between the axes, about.
    let both = light.sharpness * sharpness / (light.sharpness + sharpness);
    if both * (1.0 - light.axis.dot(axis)) > NOTHING {
        return Vec3::ZERO;
    }
    let lobe = SphericalGaussian {
        axis,
        sharpness,
        amplitude: Vec3::ONE,
    };
    light.product(&lobe).integral() / energy(sharpness)
}

/// Radiance from a direction of unit length, between the four nearest pixels.
fn lat_long(pixels: &[[f32; 3]], [width, height]: [u32; 2], direction: Vec3) -> Vec3 {
    let turn = std::f32::consts::TAU;
    let u = math::atan2(direction.x, -direction.z).rem_euclid(turn) / turn;
    let v = math::acos(direction.y.clamp(-1.0, 1.0)) / std::f32::consts::PI;
    let (x, y) = (u * width as f32 - 0.5, v * height as f32 - 0.5);
    let (left, top) = (x.floor(), y.floor());
    let at = |column: i64, row: i64| {
        let row = row.clamp(0, i64::from(height) - 1);
        let column = column.rem_euclid(i64::from(width));
        let pixel = Vec3::from(pixels[(row * i64::from(width) + column) as usize]);
        // Not a number is not greater.
        Vec3::from(
            pixel
                .to_array()
                .map(|x| if x > 0.0 { x.min(1e6) } else { 0.0 }),
        )
    };
    let (column, row) = (left as i64, top as i64);
    let upper = at(column, row).lerp(at(column + 1, row), x - left);
    let lower = at(column, row + 1).lerp(at(column + 1, row + 1), x - left);
    upper.lerp(lower, y - top)
}

/// An octahedral map of `n` texels per side at half of that: the B-spline of 1, 3, 3, 1 eighths of each
/// direction, weighted by solid angle.
fn halved(level: &[Vec3], n: u32) -> Vec<Vec3> {
    const TAPS: [f32; 4] = [1.0, 3.0, 3.0, 1.0];
    let solid_angle = |x, y| texel_area(octahedral::texel_direction(x, y, n), n);
    let half = n / 2;
    let texel = |x: u32, y: u32| {
        let (mut sum, mut whole) = (Vec3::ZERO, 0.0);
        for (dy, tap_y) in (-1..).zip(TAPS) {
            for (dx, tap_x) in (-1..).zip(TAPS) {
                let (x, y) = octahedral::wrap(2 * x as i32 + dx, 2 * y as i32 + dy, n);
                let weight = tap_x * tap_y * solid_angle(x, y);
                sum += weight * level[(y * n + x) as usize];
                whole += weight;
            }
        }
        sum / whole
    };
    (0..half)
        .flat_map(|y| (0..half).map(move |x| (x, y)))
        .map(|(x, y)| texel(x, y))
        .collect()
}

/// An octahedral map of `n` texels per side at half of that: what the lobes of that level see. The map is
/// what lobes of its own level see, or as `sharp` as it can be.
fn blurred(level: &[Vec3], n: u32, sharp: bool) -> Vec<Vec3> {
    let variance = |n: u32| 1.0 / (relight_format::Prefiltered::SHARPNESS * (n * n) as f32);
    let half = n / 2;
    let axes: Vec<Vec3> = (0..n * n)
        .map(|index| octahedral::texel_direction(index % n, index / n, n).normalize())
        .collect();
    let texel = |x: u32, y: u32| {
        let axis = octahedral::texel_direction(x, y, half).normalize();
        // Per axis: interpolation blurs by a sixth of a texel, the B-spline by a quarter.
        let before = if sharp {
            0.25 * texel_area(axis, n)
        } else {
            variance(n) - texel_area(axis, n) / 6.0
        };
        let missing = variance(half) - texel_area(axis, half) / 6.0 - before;
        let reach = (3.5 * (missing / texel_area(axis, n)).sqrt()).ceil() as i32;
        let (mut sum, mut whole) = (Vec3::ZERO, 0.0);
        let mut add = |index: usize| {
            let weight =
                math::exp((axis.dot(axes[index]) - 1.0) / missing) * texel_area(axes[index], n);
            sum += weight * level[index];
            whole += weight;
        };
        if 2 * reach + 2 >= n as i32 {
            (0..level.len()).for_each(&mut add);
        } else {
            for (dx, dy) in
                (-reach..=reach + 1).flat_map(|y| (-reach..=reach + 1).map(move |x| (x, y)))
            {
                let (x, y) = octahedral::wrap(2 * x as i32 + dx, 2 * y as i32 + dy, n);
                add((y * n + x) as usize);
            }
        }
        sum / whole
    };
    (0..half)
        .flat_map(|y| (0..half).map(move |x| (x, y)))
        .map(|(x, y)| texel(x, y))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::prefiltered::encode;

    #[test]
    fn a_lat_long_image_is_seen_where_it_is() {
        // Red rises with the column, green with the row; blue in the middle of the image, at +Z.
        let (width, height) = (256, 128);
        let pixel = |i: u32| {
            let (x, y) = (i % width, i / width);
            let blue = x.abs_diff(128) < 8 && y.abs_diff(64) < 8;
            [
                x as f32 / 256.0,
                y as f32 / 128.0,
                f32::from(u8::from(blue)),
            ]
        };
        let pixels: Vec<_> = (0..width * height).map(pixel).collect();
        let panorama = Panorama::from_lat_long([width, height], &pixels).expect("an image");
        let sharp = panorama.radiance(Vec3::Z, f32::INFINITY);
        assert!(sharp.distance(Vec3::new(0.5, 0.5, 1.0)) < 0.01, "{sharp}");
        let side = panorama.radiance(Vec3::X, f32::INFINITY);
        assert!(side.distance(Vec3::new(0.25, 0.5, 0.0)) < 0.01, "{side}");
        // A lobe sees 1 − exp(−λ r²/2) of a disc; the square has the area of one of 0.208 radians.
        for lobe in [10.0f32, 40.0, 100.0] {
            let expected = 1.0 - math::exp(-0.5 * lobe * 0.208f32.powi(2));
            let blurred = panorama.radiance(Vec3::Z, lobe).z;
            let error = (blurred / expected - 1.0).abs();
            println!("sharpness {lobe}: {blurred} for {expected}");
            // Levels are a factor of four apart. Measured 0.15.
            assert!(error < 0.16, "{lobe}: {blurred} {expected}");
        }
        assert!(panorama.radiance(Vec3::Y, f32::NAN).is_finite());
        assert!(Panorama::from_lat_long([3, 3], &pixels).is_none());
        assert!(Panorama::from_lat_long([0, 0], &[]).is_none());
        assert!(Panorama::from_lat_long([1, 1], &[[f32::NAN, -1.0, 3.0]]).is_some());
        let texels = panorama.levels().texels();
        let again = Panorama::from_texels(texels).expect("the same");
        assert_eq!(
            again.radiance(Vec3::Z, 40.0),
            panorama.radiance(Vec3::Z, 40.0)
        );
        assert!(
            Panorama::from_texels(&texels[1..]).is_none() && Panorama::from_texels(&[]).is_none()
        );
    }

    #[test]
    fn an_environment_shows_all_that_it_has() {
        let lobe = |axis, sharpness| relight_format::Lobe {
            axis,
            sharpness,
            amplitude: [2.0, 1.0, 0.5],
            ..bytemuck::Zeroable::zeroed()
        };
        let mut environment = Environment {
            lobes: vec![lobe([0.0, 0.6, 0.8], 30.0)],
            ..Environment::default()
        };
        let axis = Vec3::new(0.0, 0.6, 0.8);
        let seen = Panorama::of_environment(&environment).radiance(axis, 1e6);
        assert!(seen.distance(Vec3::new(2.0, 1.0, 0.5)) < 0.1, "{seen}");
        // An image is there in place of lobes.
        environment.prefiltered.texels = vec![encode(Vec3::splat(0.25)); 4 + 16];
        let seen = Panorama::of_environment(&environment).radiance(axis, 1e6);
        assert!(seen.distance(Vec3::splat(0.25)) < 0.002, "{seen}");
    }
}
