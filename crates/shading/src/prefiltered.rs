//! Radiance of the environment's image through a lobe, looked up.
//!
//! A sum of a few dozen lobes is a blurry mirror. Level by level the image as seen through
//! lobes of one sharpness is stored ([`relight_format::Prefiltered`]); a lobe between two
//! sharpnesses mixes the two levels.

use std::sync::Arc;

use glam::Vec3;

use crate::octahedral;

/// An environment's prefiltered image. Clones share the texels.
#[derive(Clone, Debug)]
pub struct Prefiltered {
    levels: u32,
    texels: Arc<[u32]>,
}

impl Prefiltered {
    /// `None` where the environment has no image, or an invalid one.
    pub fn new(prefiltered: &relight_format::Prefiltered) -> Option<Self> {
        let levels = prefiltered.levels().filter(|levels| *levels > 0)?;
        Some(Self {
            levels,
            texels: prefiltered.texels.as_slice().into(),
        })
    }

    /// Number of levels, at least 1.
    pub fn levels(&self) -> u32 {
        self.levels
    }

    /// The texels of all levels, as in the asset.
    pub fn texels(&self) -> &Arc<[u32]> {
        &self.texels
    }

    /// Mean radiance under the lobe exp(sharpness (axis·ω − 1)). Lobes sharper or wider than
    /// those stored count as the sharpest or widest stored.
    pub fn radiance(&self, axis: Vec3, sharpness: f32) -> Vec3 {
        let rows = (sharpness / relight_format::Prefiltered::SHARPNESS).max(1.0);
        let widest = (self.levels - 1) as f32;
        let level = (self.levels as f32 - 0.5 * rows.log2()).clamp(0.0, widest);
        let sharper = level.floor().min((widest - 1.0).max(0.0));
        let number = sharper as u32;
        let a = self.bilinear(number, axis);
        let b = self.bilinear((number + 1).min(self.levels - 1), axis);
        // Linear in the root of the sharpness: between small lights, of which lobes see as much
        // as they are sharp, and large ones.
        a.lerp(b, 2.0 * (1.0 - (sharper - level).exp2()))
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
            decode(self.texels[(start + y * n + x) as usize])
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
            let scale = 2f32.powf(0.1 * (i - 230) as f32);
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

    /// All levels of one colour but the given one.
    fn image(levels: u32, bright: u32) -> Prefiltered {
        let texels = (0..levels).flat_map(|level| {
            let value = if level == bright { 2.0 } else { 1.0 };
            std::iter::repeat_n(encode(Vec3::splat(value)), 1 << (2 * (levels - level)))
        });
        let texels = texels.collect();
        Prefiltered::new(&relight_format::Prefiltered { texels }).expect("whole levels")
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
        let image = Prefiltered::new(&relight_format::Prefiltered { texels }).expect("levels");
        for i in 0..100 {
            // Either side of the quarter planes x = 0 or z = 0 below the equator.
            let angle = 0.015 * i as f32 + 0.01;
            let near = |side: f32| Vec3::new(side, -angle.sin(), angle.cos()).normalize();
            let [a, b] = [1e-6, -1e-6].map(|side| image.radiance(near(side), 3.0).x);
            assert!((a - b).abs() < 0.01, "{a} {b}");
        }
    }
}
