//! Linear radiance to display colour: exposure, the Khronos PBR Neutral curve (Khronos
//! Group 2024) and the sRGB transfer function (IEC 61966-2-1).

use glam::Vec3;
use relight_format::math;

/// Peak above which colours are compressed.
const START: f32 = 0.8 - 0.04;
/// How fast compressed colours turn white.
const DESATURATION: f32 = 0.15;

/// Display colour in [0, 1], linear, of a non-negative exposed radiance. Base colours come
/// through unchanged, highlights are compressed and desaturated.
pub fn neutral(color: Vec3) -> Vec3 {
    let least = color.min_element();
    let offset = if least < 0.08 {
        least - 6.25 * least * least
    } else {
        0.04
    };
    let shifted = color - offset;
    let peak = shifted.max_element();
    if peak < START {
        return shifted;
    }
    let range = 1.0 - START;
    let new_peak = 1.0 - range * range / (peak + range - START);
    let white = 1.0 - 1.0 / (DESATURATION * (peak - new_peak) + 1.0);
    (shifted * (new_peak / peak)).lerp(Vec3::splat(new_peak), white)
}

/// The sRGB code in [0, 1] of a linear value in [0, 1].
pub fn encode_srgb(linear: f32) -> f32 {
    if linear <= 0.003_130_8 {
        12.92 * linear
    } else {
        1.055 * math::powf(linear, 1.0 / 2.4) - 0.055
    }
}

/// An RGBA8 sRGB pixel of a linear radiance, multiplied by its coverage, and the coverage; the colour
/// is not multiplied by it.
pub fn pixel([red, green, blue, coverage]: [f32; 4], exposure: f32) -> [u8; 4] {
    let scale = if coverage > 0.0 {
        exposure / coverage
    } else {
        exposure
    };
    let quantize = |value: f32| (value * 255.0).round() as u8;
    let color = encoded(Vec3::new(red, green, blue) * scale);
    let [red, green, blue] = color.to_array().map(quantize);
    [red, green, blue, quantize(coverage)]
}

/// The sRGB code, 0 to 1, of an exposed linear radiance; below 0 counts as 0.
pub fn encoded(radiance: Vec3) -> Vec3 {
    let color = neutral(radiance.max(Vec3::ZERO));
    Vec3::from(color.to_array().map(encode_srgb))
}

/// The constants of this module, as WGSL.
pub fn wgsl_constants() -> String {
    format!(
        "const TONEMAP_START: f32 = {START:?};\n\
         const TONEMAP_DESATURATION: f32 = {DESATURATION:?};\n"
    )
}

/// Exposure in stops that shows the log-average luminance of the covered pixels as middle
/// grey, 0.18 (Reinhard et al. 2002, §3.1); 0 for a black picture. `pixels`: linear Rec.709 radiance
/// times coverage, and coverage.
pub fn automatic_exposure(pixels: &[[f32; 4]]) -> f32 {
    let luminances: Vec<f64> = pixels
        .iter()
        .filter(|pixel| pixel[3] > 0.5)
        .map(|pixel| f64::from(luminance([0, 1, 2].map(|i| pixel[i] / pixel[3])).max(0.0)))
        .collect();
    let count = luminances.len().max(1) as f64;
    let mean = luminances.iter().sum::<f64>() / count;
    if !(mean > 0.0 && mean.is_finite()) {
        return 0.0;
    }
    // Keeps black pixels from dragging the average to zero.
    let floor = 1e-3 * mean;
    let log = luminances
        .iter()
        .map(|luminance| math::log2(luminance + floor))
        .sum::<f64>()
        / count;
    (math::log2(0.18f64) - log) as f32
}

/// Rec.709 luminance.
pub fn luminance(color: [f32; 3]) -> f32 {
    0.2126 * color[0] + 0.7152 * color[1] + 0.0722 * color[2]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn base_colours_stay_and_highlights_approach_one() {
        // A surface with 4 % reflectance added to its base colour, the curve's premise.
        let base = Vec3::new(0.6, 0.3, 0.1);
        assert!(neutral(base + 0.04).distance(base) < 1e-6);
        let mut last = 0.0;
        for exponent in -8..20 {
            let gray = neutral(Vec3::splat(2f32.powi(exponent)));
            assert!(gray.x > last && gray.x < 1.0, "2^{exponent} gives {gray}");
            last = gray.x;
        }
        assert!(
            neutral(Vec3::new(1000.0, 0.0, 0.0)).y > 0.8,
            "bright red is not nearly white"
        );
    }

    #[test]
    fn bytes_are_srgb_codes() {
        assert_eq!(pixel([0.0; 4], 1.0), [0; 4]);
        // Linear 0.2140 is sRGB code 127.5; the curve subtracts 0.04 from greys.
        assert_eq!(
            pixel([0.215 + 0.04, 0.215 + 0.04, 0.215 + 0.04, 1.0], 1.0),
            [128, 128, 128, 255]
        );
        assert_eq!(pixel([0.5, 0.5, 0.5, 1.0], 2.0), pixel([1.0; 4], 1.0));
        assert_eq!(
            pixel([0.25, 0.25, 0.25, 0.5], 1.0)[..3],
            pixel([0.5, 0.5, 0.5, 1.0], 1.0)[..3]
        );
        assert_eq!(pixel([-1.0, -1.0, -1.0, 1.0], 1.0), [0, 0, 0, 255]);
    }
}
