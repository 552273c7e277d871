//! The least-squares problem: how far a set of lobes is from the image, and the way down.
//!
//! Amplitudes are eliminated (variable projection, Golub & Pereyra 1973): for given axes
//! and sharpnesses the best ones follow from the lobes' Gram matrix, which is closed-form,
//! and from the integral of the image times each lobe, which touches only the cells under
//! that lobe on the coarsest level that resolves it.
//!
//! The image is taken as continuous, bilinear between pixel centres, as renderers sample
//! it: a light of one pixel is then nearly a Gaussian, whose energy and value at pixel
//! centres agree. Its integral times a lobe is the sum over cells of flux times the lobe
//! blurred by the tent of a pixel and the box of a cell, and a blurred lobe is a lobe.

use std::f64::consts::PI;

use glam::{DMat3, DVec3};
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

use super::amplitude;
use super::level::{Level, Moments};
use super::lobe::{DEGREE_WEIGHTS, Pair, Shape, irradiance_product};
use super::minimise::minimise;
use crate::hdr::LatLong;

/// Rows of the finest level: its cells are as large as the sharpest lobe is wide.
const FINEST_ROWS: usize = 1024;

/// Rows of the coarsest level that lobes are integrated on.
const COARSEST_ROWS: usize = 32;

/// Sharpness bounds: from near-constant to the disk of the sun, 4/radius² = 1.9e5.
const SHARPNESS: (f64, f64) = (0.05, 2e5);

/// Weight of the squared relative error of irradiance beside that of radiance.
const IRRADIANCE_WEIGHT: f64 = 1.0;

/// Cells per lobe width (1/√λ) on the level that a lobe is integrated on.
#[derive(Clone, Copy, PartialEq)]
pub(super) enum Resolution {
    /// For the search.
    Coarse,
    /// For the last steps.
    Fine,
}

impl Resolution {
    fn cells_per_width(self) -> f64 {
        match self {
            Self::Coarse => 2.0,
            Self::Fine => 4.0,
        }
    }
}

/// The image, prepared.
pub(super) struct Problem {
    /// Finest first, each half the rows of the one before.
    pub(super) levels: Vec<Level>,
    /// ∫ I per channel.
    flux: [f64; 3],
    /// ∫ I ω and ∫ I ω ωᵀ per channel.
    first: [DVec3; 3],
    second: [DMat3; 3],
    /// 1 / ∫ I² and weight / ∫ E² over all channels, E the irradiance.
    radiance_weight: f64,
    irradiance_weight: f64,
    /// The value of the objective without any lobe.
    constant: f64,
    /// Angle between the image's own rows.
    pixel: f64,
}

/// Lobes with their best amplitudes.
#[derive(Clone)]
pub(super) struct Fit {
    pub(super) shapes: Vec<Shape>,
    pub(super) amplitudes: Vec<[f64; 3]>,
    /// Squared relative error of radiance plus weighted that of irradiance.
    pub(super) value: f64,
    /// What the objective would grow by without each lobe, about.
    pub(super) worth: Vec<f64>,
}

struct Evaluation {
    value: f64,
    by_axis: Vec<DVec3>,
    by_sharpness: Vec<f64>,
    amplitudes: Vec<[f64; 3]>,
    worth: Vec<f64>,
}

impl Problem {
    /// `None` for a black image.
    pub(super) fn new(image: &LatLong) -> Option<Self> {
        let mut levels = vec![Level::from_image(image, FINEST_ROWS)];
        while let Some(last) = levels.last()
            && last.height() >= 16
        {
            levels.push(last.halved());
        }
        let (mut flux, mut first, mut second) = ([0.0; 3], [DVec3::ZERO; 3], [DMat3::ZERO; 3]);
        let mut power = 0.0;
        for (centre, solid_angle, cell) in levels[0].cells() {
            let outer = DMat3::from_cols(centre * centre.x, centre * centre.y, centre * centre.z);
            for channel in 0..3 {
                flux[channel] += cell[channel];
                first[channel] += centre * cell[channel];
                second[channel] += outer * cell[channel];
                power += cell[channel] * cell[channel] / solid_angle;
            }
        }
        let irradiance: f64 = flux.iter().map(|flux| PI / 4.0 * flux * flux).sum();
        if power.partial_cmp(&0.0) != Some(std::cmp::Ordering::Greater) {
            return None;
        }
        let mut problem = Self {
            levels,
            flux,
            first,
            second,
            radiance_weight: 1.0 / power,
            irradiance_weight: IRRADIANCE_WEIGHT / irradiance,
            constant: 0.0,
            pixel: PI / image.height as f64,
        };
        problem.constant = 1.0 + problem.irradiance_weight * problem.image_irradiance();
        Some(problem)
    }

    /// ∫ of the image's squared irradiance, less the constant part, over channels.
    fn image_irradiance(&self) -> f64 {
        (0..3)
            .map(|channel| {
                // Σ |I_1m|² = 3/4π |∫Iω|²; Σ |I_2m|² = 5/4π (3/2 ‖∫Iωωᵀ‖² − ½ (∫I)²).
                let second: f64 = self.second[channel]
                    .to_cols_array()
                    .iter()
                    .map(|x| x * x)
                    .sum();
                let flux = self.flux[channel];
                DEGREE_WEIGHTS[0] * self.first[channel].length_squared()
                    + DEGREE_WEIGHTS[1] * (1.5 * second - 0.5 * flux * flux)
            })
            .sum()
    }

    /// A wide lobe for the light from everywhere.
    pub(super) fn ambient(&self) -> Shape {
        let mean: DVec3 = self.first.iter().sum();
        Shape {
            axis: mean.try_normalize().unwrap_or(DVec3::Y),
            sharpness: 0.2,
        }
    }

    /// Largest sharpness that the image resolves.
    pub(super) fn max_sharpness(&self) -> f64 {
        // The variance of a tent over a pixel is a sixth of its area.
        SHARPNESS.1.min(6.0 / self.levels[0].spacing().powi(2))
    }

    /// Inner products of the image with a lobe, on one level.
    fn moments(&self, shape: &Shape, level: usize) -> [Pair; 3] {
        let level = &self.levels[level];
        // Per axis, the tent of a pixel has h²/6, the box of a cell, less that of the
        // pixels in it, H²/12 − h²/12.
        let variance = (level.spacing().powi(2) + self.pixel.powi(2)) / 12.0;
        let ratio = 1.0 / (1.0 + variance * shape.sharpness);
        let blurred = Shape {
            sharpness: shape.sharpness * ratio,
            ..*shape
        };
        let Moments { integral, offset } = level.moments(&blurred);
        [0, 1, 2].map(|channel| {
            let (integral, offset) = (integral[channel], offset[channel]);
            let along = shape.axis.dot(offset);
            Pair {
                value: ratio * integral,
                by_axis: (offset - shape.axis * along) * (ratio * blurred.sharpness),
                by_sharpness: ratio * ratio * (ratio * along - variance * integral),
            }
        })
    }

    fn level_of(&self, shape: &Shape, resolution: Resolution) -> usize {
        let wanted = 1.0 / (shape.sharpness.sqrt() * resolution.cells_per_width());
        let fits = |level: &&Level| level.spacing() <= wanted && level.height() >= COARSEST_ROWS;
        self.levels.iter().filter(fits).count().saturating_sub(1)
    }

    /// The best amplitudes of given shapes.
    pub(super) fn project(&self, shapes: Vec<Shape>, resolution: Resolution) -> Fit {
        let levels: Vec<usize> = shapes
            .iter()
            .map(|shape| self.level_of(shape, resolution))
            .collect();
        let mut free = [(); 3].map(|()| vec![true; shapes.len()]);
        let Evaluation {
            value,
            amplitudes,
            worth,
            ..
        } = self.evaluate(&shapes, &levels, &mut free);
        Fit {
            shapes,
            amplitudes,
            value,
            worth,
        }
    }

    /// Moves all axes and sharpnesses downhill for some steps.
    pub(super) fn refine(&self, fit: &Fit, resolution: Resolution, iterations: usize) -> Fit {
        let count = fit.shapes.len();
        let levels: Vec<usize> = fit
            .shapes
            .iter()
            .map(|shape| self.level_of(shape, resolution))
            .collect();
        // A lobe must stay wide enough for the level it is integrated on.
        let largest: Vec<f64> = levels
            .iter()
            .map(|&level| match level {
                0 => self.max_sharpness(),
                _ => self.levels[level].spacing().powi(-2),
            })
            .collect();
        // Per lobe: axis in its tangent plane, in lobe widths, and log-sharpness.
        let frames: Vec<[DVec3; 2]> = fit
            .shapes
            .iter()
            .map(|shape| {
                let (s, t) = shape.axis.any_orthonormal_pair();
                let width = shape.sharpness.max(1.0).sqrt().recip();
                [s * width, t * width]
            })
            .collect();
        let place = |index: usize, x: &[f64]| {
            let [s, t] = frames[index];
            let moved = fit.shapes[index].axis + s * x[0] + t * x[1];
            let sharpness = fit.shapes[index].sharpness * x[2].clamp(-20.0, 20.0).exp();
            (moved, sharpness)
        };
        let shapes_at = |x: &[f64]| -> Vec<Shape> {
            x.chunks_exact(3)
                .enumerate()
                .map(|(index, x)| {
                    let (moved, sharpness) = place(index, x);
                    let sharpness = sharpness.clamp(SHARPNESS.0, largest[index]);
                    Shape {
                        axis: moved.normalize(),
                        sharpness,
                    }
                })
                .collect()
        };
        let curvature: Vec<f64> = fit
            .shapes
            .iter()
            .zip(&fit.amplitudes)
            .flat_map(|(shape, amplitude)| {
                let square: f64 = amplitude.iter().map(|a| a * a).sum();
                let power = square * shape.product_integral(shape).value * self.radiance_weight;
                [power.max(1e-8); 3]
            })
            .collect();
        let mut free = [(); 3].map(|()| vec![true; count]);
        let best = minimise(vec![0.0; 3 * count], &curvature, iterations, 1e-7, |x| {
            let shapes = shapes_at(x);
            let evaluation = self.evaluate(&shapes, &levels, &mut free);
            let mut gradient = vec![0.0; x.len()];
            for (index, gradient) in gradient.chunks_exact_mut(3).enumerate() {
                let (moved, sharpness) = place(index, &x[3 * index..3 * index + 3]);
                let tangent = evaluation.by_axis[index] / moved.length();
                gradient[0] = tangent.dot(frames[index][0]);
                gradient[1] = tangent.dot(frames[index][1]);
                // Beyond a bound the sharpness stands still.
                if (SHARPNESS.0..=largest[index]).contains(&sharpness) {
                    gradient[2] = evaluation.by_sharpness[index] * sharpness;
                }
            }
            (evaluation.value, gradient)
        });
        self.project(shapes_at(&best), resolution)
    }

    fn evaluate(
        &self,
        shapes: &[Shape],
        levels: &[usize],
        free: &mut [Vec<bool>; 3],
    ) -> Evaluation {
        let count = shapes.len();
        let zonals: Vec<[(f64, f64); 2]> = shapes.iter().map(Shape::zonal).collect();
        let (moments, pairs): (Vec<[Pair; 3]>, Vec<Vec<Pair>>) = (0..count)
            .into_par_iter()
            .map(|index| {
                let shape = &shapes[index];
                let pairs = shapes
                    .iter()
                    .zip(&zonals)
                    .map(|(other, zonal)| {
                        let radiance = shape.product_integral(other);
                        let irradiance =
                            irradiance_product((shape, &zonals[index]), (other, zonal));
                        self.combine(radiance, irradiance)
                    })
                    .collect();
                (self.moments(shape, levels[index]), pairs)
            })
            .unzip();
        let norms: Vec<f64> = (0..count).map(|i| pairs[i][i].value.sqrt()).collect();
        let gram = DMatrix::from_fn(count, count, |i, j| {
            pairs[i][j].value / (norms[i] * norms[j])
        });
        let integrals: Vec<(f64, f64)> = shapes.iter().map(Shape::integral).collect();
        let energy = DVector::from_fn(count, |i, _| integrals[i].0 / norms[i]);
        let inverse = nalgebra::Cholesky::new(&gram + DMatrix::identity(count, count) * 1e-6)
            .map(|factor| factor.inverse());

        let mut evaluation = Evaluation {
            value: self.constant,
            by_axis: vec![DVec3::ZERO; count],
            by_sharpness: vec![0.0; count],
            amplitudes: vec![[0.0; 3]; count],
            worth: vec![0.0; count],
        };
        for channel in 0..3 {
            let targets: Vec<Pair> = (0..count)
                .map(|i| self.target(channel, &shapes[i], &zonals[i], moments[i][channel]))
                .collect();
            let target = DVector::from_fn(count, |i, _| targets[i].value / norms[i]);
            let solution = amplitude::solve(
                &gram,
                &target,
                &energy,
                self.flux[channel],
                &mut free[channel],
            );
            let scaled = DVector::from_vec(solution.values);
            evaluation.value += scaled.dot(&(&gram * &scaled)) - 2.0 * scaled.dot(&target);
            let a: Vec<f64> = scaled
                .iter()
                .zip(&norms)
                .map(|(a, norm)| a / norm)
                .collect();
            for i in (0..count).filter(|&i| a[i] > 0.0) {
                let mut by_axis = -targets[i].by_axis;
                let mut by_sharpness =
                    solution.multiplier * integrals[i].1 - targets[i].by_sharpness;
                for (pair, a) in pairs[i].iter().zip(&a) {
                    by_axis += pair.by_axis * *a;
                    by_sharpness += pair.by_sharpness * a;
                }
                evaluation.by_axis[i] += by_axis * (2.0 * a[i]);
                evaluation.by_sharpness[i] += 2.0 * a[i] * by_sharpness;
                evaluation.amplitudes[i][channel] = a[i];
                let pivot = inverse.as_ref().map_or(1.0, |inverse| inverse[(i, i)]);
                evaluation.worth[i] += scaled[i] * scaled[i] / pivot;
            }
        }
        evaluation
    }

    fn combine(&self, radiance: Pair, irradiance: Pair) -> Pair {
        let (r, i) = (self.radiance_weight, self.irradiance_weight);
        Pair {
            value: r * radiance.value + i * irradiance.value,
            by_axis: radiance.by_axis * r + irradiance.by_axis * i,
            by_sharpness: r * radiance.by_sharpness + i * irradiance.by_sharpness,
        }
    }

    /// Adds the inner product of irradiance to that of radiance.
    fn target(
        &self,
        channel: usize,
        shape: &Shape,
        zonal: &[(f64, f64); 2],
        radiance: Pair,
    ) -> Pair {
        let axis = shape.axis;
        let first = axis.dot(self.first[channel]);
        let turned = self.second[channel] * axis;
        let second = 1.5 * axis.dot(turned) - 0.5 * self.flux[channel];
        let weights = [0, 1].map(|degree| DEGREE_WEIGHTS[degree] * zonal[degree].0);
        let tangential = |v: DVec3| v - axis * axis.dot(v);
        let irradiance = Pair {
            value: weights[0] * first + weights[1] * second,
            by_axis: tangential(self.first[channel] * weights[0] + turned * (3.0 * weights[1])),
            by_sharpness: DEGREE_WEIGHTS[0] * zonal[0].1 * first
                + DEGREE_WEIGHTS[1] * zonal[1].1 * second,
        };
        self.combine(radiance, irradiance)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Differences of sums of f32 products.
    const SLOPE_TOLERANCE: f64 = 2e-3;

    #[test]
    fn the_gradient_matches_differences() {
        let pixels = (0..64 * 32u32)
            .map(|i| {
                let bright = if (i % 64).abs_diff(20) < 4 && (i / 64).abs_diff(9) < 3 {
                    8.0
                } else {
                    0.0
                };
                [
                    bright + 0.2,
                    0.5 * bright + (i % 64) as f32 / 64.0,
                    (i / 640) as f32,
                ]
            })
            .collect();
        let problem = Problem::new(&LatLong::repair(64, 32, pixels)).expect("light");
        let axis = |x, y, z| DVec3::new(x, y, z).normalize();
        let shapes = [
            Shape {
                axis: axis(0.1, 0.5, 0.2),
                sharpness: 0.3,
            },
            Shape {
                axis: axis(0.7, 0.6, 0.4),
                sharpness: 20.0,
            },
            Shape {
                axis: axis(-0.5, -0.6, 0.4),
                sharpness: 3.0,
            },
        ];
        let levels = [0; 3];
        let value = |shapes: &[Shape]| {
            let mut free = [(); 3].map(|()| vec![true; shapes.len()]);
            problem.evaluate(shapes, &levels, &mut free)
        };
        let evaluation = value(&shapes);
        for index in 0..shapes.len() {
            let change = |axis: DVec3, log_sharpness: f64| {
                let mut changed = shapes;
                changed[index].axis = (changed[index].axis + axis).normalize();
                changed[index].sharpness *= log_sharpness.exp();
                value(&changed).value
            };
            let (s, t) = shapes[index].axis.any_orthonormal_pair();
            let step = 1e-3;
            for tangent in [s, t] {
                let slope =
                    (change(tangent * step, 0.0) - change(-tangent * step, 0.0)) / (2.0 * step);
                let given = evaluation.by_axis[index].dot(tangent);
                assert!((slope - given).abs() < SLOPE_TOLERANCE, "{slope} {given}");
            }
            let slope = (change(DVec3::ZERO, step) - change(DVec3::ZERO, -step)) / (2.0 * step);
            let given = evaluation.by_sharpness[index] * shapes[index].sharpness;
            assert!((slope - given).abs() < SLOPE_TOLERANCE, "{slope} {given}");
        }
    }

    #[test]
    fn the_objective_is_the_squared_error_it_claims() {
        let pixels = (0..64 * 32u32)
            .map(|i| [1.0 + (i / 64) as f32 * 0.1; 3])
            .collect();
        let image = LatLong::repair(64, 32, pixels);
        let problem = Problem::new(&image).expect("light");
        let fit = problem.project(vec![problem.ambient()], Resolution::Fine);
        let lobes = super::super::lobes(&fit);
        let radiance = super::super::relative_l2(&image, &lobes) as f64;
        let irradiance = super::super::irradiance_error(&image, &lobes) as f64;
        let expected = radiance.powi(2) + IRRADIANCE_WEIGHT * irradiance.powi(2);
        // Irradiance beyond degree 2, and the weighting by degree instead of by direction.
        assert!(
            (fit.value / expected - 1.0).abs() < 0.03,
            "{} {expected}",
            fit.value
        );
    }
}
