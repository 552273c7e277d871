//! How far a candidate image is from the truth.
//!
//! Only pixels covered in both images count: those with alpha above one half. What is
//! compared is the radiance of the covered part, colour divided by alpha, so that images
//! with and without antialiased silhouettes can be set against each other.

use crate::display;
use crate::image_file::Image;

/// The measures of one comparison.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct Comparison {
    /// Pixels covered in both images: those that the measures average over.
    pub covered_pixels: u64,
    /// Pixels covered in one image only, as a fraction of those covered in the truth.
    pub coverage_mismatch: f64,
    /// Root mean square difference over pixels and channels, over the truth's mean.
    pub relative_rmse: f64,
    /// The same per channel R, G, B, each over the truth's mean of that channel.
    pub relative_rmse_rgb: [f64; 3],
    /// Mean LDR-FLIP error (Andersson et al. 2020) of both images shown at one exposure,
    /// the truth's automatic one ([`display::automatic_exposure`]), 0 (same) to 1.
    pub mean_flip: f64,
    /// Sum of the candidate over sum of the truth, all channels.
    pub energy_ratio: f64,
    /// The same per channel R, G, B.
    pub energy_ratio_rgb: [f64; 3],
    /// Root of the mean variance of both images over the truth's mean, where at least one
    /// carries variance: what `relative_rmse` would be from noise alone.
    pub relative_noise: Option<f64>,
    /// `relative_rmse` with the noise taken out of the mean square; 0 where noise explains
    /// all of it.
    pub relative_rmse_corrected: Option<f64>,
    /// What that may be at most: two standard errors of the mean square more, as pixels scatter about it.
    pub relative_rmse_at_most: Option<f64>,
}

/// Standard errors within which noise may explain what is found.
const STANDARD_ERRORS: f64 = 2.0;

impl Comparison {
    /// `relative_rmse` with the noise taken out, where it is known.
    pub fn noiseless(&self) -> f64 {
        self.relative_rmse_corrected.unwrap_or(self.relative_rmse)
    }

    /// What there is besides noise, at most, where noise may explain all that is found.
    pub fn below_noise(&self) -> Option<f64> {
        // The mean square is no further from zero than the bound is from it.
        let (found, most) = (self.relative_rmse_corrected?, self.relative_rmse_at_most?);
        (2.0 * found * found <= most * most).then_some(most)
    }

    /// [`Self::noiseless`], percent, for people: `< 1.2` where noise may explain all of it.
    pub fn noiseless_percent(&self, digits: usize) -> String {
        percent(self.noiseless(), self.below_noise(), digits)
    }
}

/// What is found, percent, for people, or the bound that it is known to be below.
pub fn percent(found: f64, below: Option<f64>, digits: usize) -> String {
    match below {
        Some(most) => format!("< {:.digits$}", 100.0 * most),
        None => format!("{:.digits$}", 100.0 * found),
    }
}

/// Why two images cannot be compared.
#[derive(Debug, PartialEq, thiserror::Error)]
pub enum Error {
    /// The sizes differ.
    #[error("size of the candidate: expected {}x{}, found {}x{}", truth[0], truth[1], candidate[0], candidate[1])]
    Size {
        /// Width and height of the truth.
        truth: [u32; 2],
        /// Width and height of the candidate.
        candidate: [u32; 2],
    },
    /// No pixel is covered in both images.
    #[error("covered pixels: expected at least one in common, found none")]
    NoCommonPixel,
    /// A covered pixel is NaN or infinite.
    #[error("pixel {index} of the {image}: expected finite numbers, found {found:?}")]
    NotFinite {
        /// Which image.
        image: &'static str,
        /// Index of the pixel, row after row.
        index: usize,
        /// Its value.
        found: [f32; 4],
    },
    /// The truth is black, so nothing can be relative to it.
    #[error("mean of the truth: expected more than zero, found {0}")]
    BlackTruth(f64),
}

/// Compares `candidate` with `truth`.
pub fn compare(candidate: &Image, truth: &Image) -> Result<Comparison, Error> {
    let sizes = [truth, candidate].map(|image| [image.width, image.height]);
    if sizes[0] != sizes[1] {
        return Err(Error::Size {
            truth: sizes[0],
            candidate: sizes[1],
        });
    }
    let covered = |image: &Image, index: usize| image.pixels[index][3] > 0.5;
    let mut common = Vec::new();
    let (mut mismatched, mut covered_in_truth) = (0u64, 0u64);
    for index in 0..truth.pixels.len() {
        let (a, b) = (covered(candidate, index), covered(truth, index));
        mismatched += u64::from(a != b);
        covered_in_truth += u64::from(b);
        if a && b {
            common.push(index);
        }
    }
    if common.is_empty() {
        return Err(Error::NoCommonPixel);
    }
    for (image, name) in [(candidate, "candidate"), (truth, "truth")] {
        for &index in &common {
            let found = image.pixels[index];
            if !found.iter().all(|value| value.is_finite()) {
                return Err(Error::NotFinite {
                    image: name,
                    index,
                    found,
                });
            }
        }
    }

    let count = common.len() as f64;
    let (mut square, mut sum, mut truth_sum) = ([0.0; 3], [0.0; 3], [0.0; 3]);
    let mut variance = 0.0;
    // Of pixels' squares without their noise.
    let mut square_of_squares = 0.0;
    for &index in &common {
        let mut beyond_noise = 0.0;
        for channel in 0..3 {
            let [a, b] = [candidate, truth].map(|image| {
                f64::from(image.pixels[index][channel]) / f64::from(image.pixels[index][3])
            });
            square[channel] += (a - b) * (a - b);
            beyond_noise += (a - b) * (a - b);
            sum[channel] += a;
            truth_sum[channel] += b;
            for image in [candidate, truth] {
                if let Some(values) = &image.variance {
                    let alpha = f64::from(image.pixels[index][3]);
                    let noise = f64::from(values[index][channel]) / (alpha * alpha);
                    variance += noise;
                    beyond_noise -= noise;
                }
            }
        }
        square_of_squares += (beyond_noise / 3.0).powi(2);
    }
    let truth_mean = truth_sum.iter().sum::<f64>() / (3.0 * count);
    if truth_mean <= 0.0 {
        return Err(Error::BlackTruth(truth_mean));
    }
    let mean_square = square.iter().sum::<f64>() / (3.0 * count);
    let mean_variance = variance / (3.0 * count);
    let corrected = mean_square - mean_variance;
    let scatter = (square_of_squares / count - corrected * corrected).max(0.0);
    let most = corrected.max(0.0) + STANDARD_ERRORS * (scatter / count).sqrt();
    let noisy = candidate.variance.is_some() || truth.variance.is_some();
    Ok(Comparison {
        covered_pixels: common.len() as u64,
        coverage_mismatch: mismatched as f64 / covered_in_truth as f64,
        relative_rmse: mean_square.sqrt() / truth_mean,
        relative_rmse_rgb: [0, 1, 2].map(|i| (square[i] * count).sqrt() / truth_sum[i]),
        mean_flip: mean_flip(candidate, truth, &common),
        energy_ratio: sum.iter().sum::<f64>() / truth_sum.iter().sum::<f64>(),
        energy_ratio_rgb: [0, 1, 2].map(|i| sum[i] / truth_sum[i]),
        relative_noise: noisy.then(|| mean_variance.sqrt() / truth_mean),
        relative_rmse_corrected: noisy.then(|| corrected.max(0.0).sqrt() / truth_mean),
        relative_rmse_at_most: noisy.then(|| most.sqrt() / truth_mean),
    })
}

/// Mean FLIP error over the `common` pixels. Pixels not in common show the background in
/// both images, so that silhouettes count as coverage mismatch and not here.
fn mean_flip(candidate: &Image, truth: &Image, common: &[usize]) -> f64 {
    let exposure = display::automatic_exposure(truth);
    let [truth, candidate] = [truth, candidate].map(|image| {
        let mut opaque = Image::new(image.width, image.height);
        for &index in common {
            let [r, g, b, alpha] = image.pixels[index];
            opaque.pixels[index] = [r / alpha, g / alpha, b / alpha, 1.0];
        }
        let pixels = display::pixels(&opaque, exposure);
        nv_flip::FlipImageRgb8::with_data(image.width, image.height, pixels.as_flattened())
    });
    let errors = nv_flip::flip(truth, candidate, nv_flip::DEFAULT_PIXELS_PER_DEGREE).to_vec();
    common
        .iter()
        .map(|&index| f64::from(errors[index]))
        .sum::<f64>()
        / common.len() as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    /// f32 pixels, f64 sums: rounding of the inputs only.
    const ROUNDING: f64 = 1e-6;

    fn flat(color: [f32; 3]) -> Image {
        let mut image = Image::new(32, 16);
        image.pixels.fill([color[0], color[1], color[2], 1.0]);
        image
    }

    fn close(found: f64, expected: f64) {
        assert!(
            (found - expected).abs() < ROUNDING,
            "expected {expected}, found {found}"
        );
    }

    #[test]
    fn an_image_equals_itself() {
        let image = flat([0.2, 1.5, 7.0]);
        let result = compare(&image, &image).unwrap();
        close(result.relative_rmse, 0.0);
        close(result.mean_flip, 0.0);
        close(result.energy_ratio, 1.0);
        close(result.coverage_mismatch, 0.0);
        assert_eq!(result.covered_pixels, 32 * 16);
        assert_eq!(result.relative_noise, None);
    }

    #[test]
    fn a_known_offset_gives_the_known_measures() {
        let result = compare(&flat([1.1, 2.0, 3.0]), &flat([1.0, 2.0, 6.0])).unwrap();
        close(result.relative_rmse, ((0.01 + 9.0) / 3.0f64).sqrt() / 3.0);
        close(result.relative_rmse_rgb[0], 0.1);
        close(result.relative_rmse_rgb[1], 0.0);
        close(result.relative_rmse_rgb[2], 0.5);
        close(result.energy_ratio, 6.1 / 9.0);
        close(result.energy_ratio_rgb[2], 0.5);
        assert!(result.mean_flip > 0.01);
    }

    #[test]
    fn only_commonly_covered_pixels_count() {
        let (mut a, mut b) = (flat([1.0; 3]), flat([1.0; 3]));
        a.pixels[0] = [500.0, 500.0, 500.0, 0.0];
        b.pixels[1] = [500.0, 500.0, 500.0, 0.25];
        let result = compare(&a, &b).unwrap();
        close(result.relative_rmse, 0.0);
        close(result.mean_flip, 0.0);
        close(result.coverage_mismatch, 2.0 / (32.0 * 16.0 - 1.0));
        assert_eq!(result.covered_pixels, 32 * 16 - 2);
    }

    #[test]
    fn partly_covered_pixels_compare_the_covered_part() {
        let (a, mut b) = (flat([2.0; 3]), flat([2.0; 3]));
        b.pixels[5] = [1.5, 1.5, 1.5, 0.75];
        close(compare(&a, &b).unwrap().relative_rmse, 0.0);
    }

    #[test]
    fn noise_is_taken_out_of_the_error() {
        // A checkerboard of ±0.3 is exactly the noise its variance states.
        let mut truth = flat([1.0; 3]);
        for (i, pixel) in truth.pixels.iter_mut().enumerate() {
            let sign = if i % 2 == 0 { 0.3 } else { -0.3 };
            *pixel = [1.0 + sign, 1.0 + sign, 1.0 + sign, 1.0];
        }
        truth.variance = Some(vec![[0.09; 3]; truth.pixels.len()]);
        let result = compare(&flat([1.0; 3]), &truth).unwrap();
        close(result.relative_rmse, 0.3);
        close(result.relative_noise.unwrap(), 0.3);
        // A difference of two equal squares: its root magnifies rounding.
        assert!(result.relative_rmse_corrected.unwrap() < 1e-3);
        // A real offset of 0.4 remains: 0.5² − 0.3².
        let result = compare(&flat([1.4; 3]), &truth).unwrap();
        close(result.relative_rmse, 0.5);
        close(result.relative_rmse_corrected.unwrap(), 0.4);
    }

    #[test]
    fn noise_is_not_taken_for_exactness() {
        let noisy = |offset: f32| {
            let mut state = 1u32;
            let mut candidate = Image::new(64, 64);
            for pixel in &mut candidate.pixels {
                *pixel = [0, 1, 2, 3].map(|channel| {
                    state = state.wrapping_mul(747_796_405).wrapping_add(2_891_336_453);
                    let noise = 0.1 * 3f32.sqrt() * (state as f32 / 2f32.powi(31) - 1.0);
                    1.0 + if channel < 3 { offset + noise } else { 0.0 }
                });
            }
            candidate.variance = Some(vec![[0.01; 3]; 64 * 64]);
            let mut truth = Image::new(64, 64);
            truth.pixels.fill([1.0; 4]);
            compare(&candidate, &truth).unwrap()
        };
        // Offsets far below what 4,096 pixels can tell from noise, and far above it.
        for offset in [0.0, 0.002, 0.05] {
            let found = noisy(offset);
            let most = found.relative_rmse_at_most.unwrap();
            assert!(most >= f64::from(offset), "{offset}: {found:?}");
            assert_eq!(
                found.below_noise(),
                (offset < 0.01).then_some(most),
                "{offset}: {found:?}"
            );
            assert!(most < f64::from(offset) + 0.03, "{offset}: {found:?}");
            assert_eq!(found.noiseless_percent(1).starts_with('<'), offset < 0.01);
        }
    }

    #[test]
    fn what_cannot_be_compared_is_an_error() {
        let image = flat([1.0; 3]);
        assert!(matches!(
            compare(&Image::new(3, 3), &image),
            Err(Error::Size { .. })
        ));
        assert_eq!(
            compare(&Image::new(32, 16), &image),
            Err(Error::NoCommonPixel)
        );
        assert_eq!(
            compare(&image, &flat([0.0; 3])),
            Err(Error::BlackTruth(0.0))
        );
        let mut bad = image.clone();
        bad.pixels[3][1] = f32::NAN;
        assert!(matches!(
            compare(&bad, &image),
            Err(Error::NotFinite { index: 3, .. })
        ));
    }
}
