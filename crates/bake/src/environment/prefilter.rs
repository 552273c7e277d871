//! The image through lobes of decreasing sharpness, for reflections sharper than the fit.

use rayon::prelude::*;
use relight_format::Prefiltered;
use relight_format::math;
use relight_shading::{octahedral, prefiltered};

use super::level::Level;
use super::lobe::Shape;
use crate::environment::hdr::LatLong;

/// Most levels: 256² texels in the sharpest, for lobes of sharpness 3,300 (GGX with α = 0.012).
const MAX_LEVELS: u32 = 8;

/// Cells of the image per lobe width (1/√λ).
const CELLS_PER_WIDTH: f64 = 4.0;

/// Least variance of a lobe per axis, in areas of a cell: at less, the sum over cells is off
/// by more than half a percent.
const LEAST_VARIANCE: f64 = 0.3;

/// Prefilters an image. The sharpest level has no more texels than the image has pixels.
pub(crate) fn prefilter(image: &LatLong) -> Prefiltered {
    let pixels = f64::from(image.width) * f64::from(image.height);
    let levels = ((0.5 * math::log2(pixels)) as u32).clamp(1, MAX_LEVELS);
    let mut cells = Level::from_image(image, image.height as usize);
    let mut texels = Vec::with_capacity(Prefiltered::texel_count(levels));
    for level in 0..levels {
        let n = 1u32 << (levels - level);
        let wanted = f64::from(Prefiltered::SHARPNESS) * f64::from(n * n);
        let width = 1.0 / wanted.sqrt();
        while cells.height() > 2 && 2.0 * cells.spacing() * CELLS_PER_WIDTH <= width {
            cells = cells.halved();
        }
        let even = cells.even();
        let cell = cells.spacing().powi(2);
        let rows: Vec<Vec<u32>> = (0..n)
            .into_par_iter()
            .map(|y| {
                let texel = |x| {
                    let axis = octahedral::texel_direction(x, y, n).as_dvec3().normalize();
                    // The octahedral map shrinks by the third power of the distance to the
                    // octahedron's face (Engelhardt & Dachsbacher 2008).
                    let area = 4.0 / f64::from(n * n) * axis.abs().element_sum().powi(3);
                    // Per axis, bilinear interpolation blurs by the tent of a texel, a sixth of
                    // its area, and cells by their box, a twelfth of theirs.
                    let variance = 1.0 / wanted - area / 6.0 - cell / 12.0;
                    let sharpness = 1.0 / variance.max(LEAST_VARIANCE * cell);
                    mean(&cells, &even, &Shape { axis, sharpness })
                };
                (0..n).map(texel).collect()
            })
            .collect();
        texels.extend(rows.into_iter().flatten());
    }
    Prefiltered { texels }
}

/// The image's mean under a lobe, encoded. `even` has the same cells and a radiance of one.
fn mean(cells: &Level, even: &Level, shape: &Shape) -> u32 {
    let [whole, ..] = even.moments(shape).integral;
    let radiance = (cells.moments(shape).integral).map(|sum| (sum / whole) as f32);
    prefiltered::encode(radiance.into())
}

#[cfg(test)]
mod tests {
    use super::super::measure::render;
    use super::*;
    use glam::Vec3;
    use relight_format::Lobe;

    /// Of the most that the lobe sees. Measured 6.2 %, between levels.
    const TOLERANCE: f32 = 0.07;

    #[test]
    fn a_lobe_is_seen_through_lobes_as_their_product() {
        let axis = Vec3::new(0.3, 0.8, -0.5).normalize();
        let light = Lobe {
            axis: axis.to_array(),
            sharpness: 60.0,
            amplitude: [4.0, 2.0, 1.0],
            reserved: 0.0,
        };
        let image = render(&[light], 256, 128);
        let levels = prefilter(&image);
        assert_eq!(levels.levels(), Some(7));
        let seen = prefiltered::Prefiltered::new(&levels, &[]).unwrap();
        let light = relight_shading::spherical_gaussian::SphericalGaussian::from(&light);
        for sharpness in [2000.0, 300.0, 50.0, 25.0] {
            for aside in [0.0, 0.05, 0.2] {
                let direction = (axis + aside * axis.any_orthonormal_vector()).normalize();
                let through = relight_shading::spherical_gaussian::SphericalGaussian {
                    axis: direction,
                    sharpness,
                    amplitude: Vec3::ONE,
                };
                let expected = light.product(&through).integral() / through.integral();
                let most = light.amplitude * (sharpness / (sharpness + light.sharpness));
                let found = seen.radiance(direction, sharpness);
                println!("{sharpness} {aside}: {found} for {expected}");
                let error = (found - expected).abs().max_element();
                assert!(error < TOLERANCE * most.max_element(), "{found} {expected}");
            }
        }
    }

    #[test]
    fn a_constant_image_stays_constant() {
        for (width, height) in [(1, 1), (16, 8), (64, 32)] {
            let image = LatLong::repair(
                width,
                height,
                vec![[0.5, 2.0, 8.0]; (width * height) as usize],
            );
            let prefiltered = prefilter(&image);
            for texel in prefiltered.texels {
                let radiance = prefiltered::decode(texel);
                // Nine bits, and the midpoint rule on cells a third as wide as the lobe.
                assert!(
                    (radiance / Vec3::new(0.5, 2.0, 8.0) - 1.0)
                        .abs()
                        .max_element()
                        < 0.02,
                    "{radiance}"
                );
            }
        }
    }
}
