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

use relight_format::math;
use std::f64::consts::PI;

use glam::DVec3;
use nalgebra::{Cholesky, DMatrix, DVector};
use rayon::prelude::*;

use super::level::{Level, Moments};
use super::lobe::{Blurred, GLOSS, Pair, Shape};
use crate::environment::hdr::LatLong;
use crate::solve::amplitude;
use crate::solve::minimise;

/// Rows of the finest level: its cells are as large as the sharpest lobe is wide.
const FINEST_ROWS: usize = 1024;

/// Rows of the coarsest level that lobes are integrated on, and of the blurred image.
const COARSEST_ROWS: usize = 32;

/// Sharpness bounds: from near-constant to the disk of the sun, 4/radius² = 1.9e5.
const SHARPNESS: (f64, f64) = (0.05, 2e5);

/// Weight of the blurred image's squared relative error beside that of the image itself.
/// Without it all lobes go to the sun, whose square outweighs the sky's ten thousand times
/// though its light is no more.
pub(super) const GLOSS_WEIGHT: f64 = 5.0;

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
    /// The image through a glossy lobe.
    pub(super) blurred: Level,
    /// ∫ I per channel.
    flux: [f64; 3],
    /// Direction of the mean light.
    mean: DVec3,
    /// 1 / ∫ I².
    radiance_weight: f64,
    /// Weight of the blurred image's squared relative error, and that over its ∫ I².
    relative_gloss_weight: f64,
    gloss_weight: f64,
    blurred_power: f64,
    /// Angle between the image's own rows.
    pixel: f64,
}

/// Lobes with their best amplitudes.
#[derive(Clone)]
pub(super) struct Fit {
    pub(super) shapes: Vec<Shape>,
    pub(super) amplitudes: Vec<[f64; 3]>,
    /// Squared relative error of the image plus weighted that of the blurred image.
    pub(super) value: f64,
    /// What the objective would grow by without each lobe, about.
    pub(super) worth: Vec<f64>,
}

/// How a lobe is integrated against the image.
struct Place {
    level: usize,
    /// What the lobe is blurred by there, per axis.
    variance: f64,
    /// Sharpness up to which the level resolves it.
    max_sharpness: f64,
}

struct Evaluation {
    value: f64,
    by_axis: Vec<DVec3>,
    by_sharpness: Vec<f64>,
    amplitudes: Vec<[f64; 3]>,
    /// Amplitudes of the lobes scaled to unit norm, and their Gram matrix.
    scaled: Vec<[f64; 3]>,
    gram: DMatrix<f64>,
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
        let (mut flux, mut mean) = ([0.0; 3], DVec3::ZERO);
        for (centre, _, cell) in levels[0].cells() {
            for (flux, cell) in flux.iter_mut().zip(cell) {
                *flux += cell;
                mean += centre * cell;
            }
        }
        let coarse = levels
            .iter()
            .filter(|level| level.height() >= COARSEST_ROWS)
            .count();
        // Fine enough for the place of a sun to be right to a fiftieth of the blur.
        let fine = levels
            .iter()
            .position(|level| level.height() <= 512)
            .unwrap_or(0);
        let blurred = levels[coarse.saturating_sub(1)].blurred(&levels[fine], GLOSS);
        let (power, blurred_power) = (levels[0].power(), blurred.power());
        (power > 0.0 && blurred_power > 0.0).then(|| Self {
            levels,
            blurred,
            flux,
            mean: mean.try_normalize().unwrap_or(DVec3::Y),
            radiance_weight: 1.0 / power,
            relative_gloss_weight: GLOSS_WEIGHT,
            gloss_weight: GLOSS_WEIGHT / blurred_power,
            blurred_power,
            pixel: PI / image.height as f64,
        })
    }

    /// Changes the weight of the blurred image, at first [`GLOSS_WEIGHT`].
    pub(super) fn weigh_gloss(&mut self, weight: f64) {
        self.relative_gloss_weight = weight;
        self.gloss_weight = weight / self.blurred_power;
    }

    /// A wide lobe for the light from everywhere.
    pub(super) fn ambient(&self) -> Shape {
        Shape {
            axis: self.mean,
            sharpness: 0.2,
        }
    }

    /// Largest sharpness that the image resolves in some direction.
    pub(super) fn max_sharpness(&self, axis: DVec3) -> f64 {
        // The variance of a tent over a pixel is a sixth of its area.
        let area = self
            .pixel_area(axis)
            .max(self.levels[0].spacing().powi(2) * 0.5);
        SHARPNESS.1.min(6.0 / area)
    }

    /// Solid angle of the image's pixels in some direction, but for the poles.
    fn pixel_area(&self, axis: DVec3) -> f64 {
        self.pixel * self.pixel * math::hypot(axis.x, axis.z).max(0.1)
    }

    /// Where to integrate a lobe: the coarsest level that resolves it.
    fn place(&self, shape: &Shape, resolution: Resolution) -> Place {
        let wanted = 1.0 / (shape.sharpness.sqrt() * resolution.cells_per_width());
        let fits = |level: &&Level| level.spacing() <= wanted && level.height() >= COARSEST_ROWS;
        let level = self.levels.iter().filter(fits).count().saturating_sub(1);
        let cell = self.levels[level].spacing().powi(2);
        let pixel = self.pixel_area(shape.axis);
        Place {
            level,
            // Per axis, the tent of a pixel has a sixth of its area, the box of a cell,
            // less that of the pixels in it, a twelfth of the difference.
            variance: (cell.max(pixel) + pixel) / 12.0,
            max_sharpness: match level {
                0 => self.max_sharpness(shape.axis),
                _ => 1.0 / cell,
            },
        }
    }

    /// Inner products of the image with a lobe.
    fn target(&self, shape: &Shape, place: &Place) -> [Pair; 3] {
        let ratio = 1.0 / (1.0 + place.variance * shape.sharpness);
        let smooth = Shape {
            sharpness: shape.sharpness * ratio,
            ..*shape
        };
        let inner = inner_products(&self.levels[place.level], &smooth);
        let blurred = shape.blurred();
        let gloss = inner_products(&self.blurred, &blurred.shape);
        [0, 1, 2].map(|channel| {
            let inner = inner[channel];
            let radiance = Pair {
                value: ratio * inner.value,
                by_axis: inner.by_axis * ratio,
                by_sharpness: ratio
                    * ratio
                    * (ratio * inner.by_sharpness - place.variance * inner.value),
            };
            self.combine(radiance, blurred.chain(gloss[channel], 1.0))
        })
    }

    /// How much a lobe alone would take from the objective, given what is left of the
    /// image and of the blurred image.
    pub(super) fn gain(&self, shape: &Shape, left: &Level, left_blurred: &Level) -> f64 {
        let blurred = shape.blurred();
        let radiance = left.moments(shape).integral;
        let gloss = left_blurred.moments(&blurred.shape).integral;
        let norm = self.radiance_weight * shape.product_integral(shape).value
            + self.gloss_weight * blurred.product_integral(&blurred).value;
        (0..3)
            .map(|channel| {
                let inner = self.radiance_weight * radiance[channel]
                    + self.gloss_weight * blurred.amplitude * gloss[channel];
                inner.max(0.0).powi(2) / norm
            })
            .sum()
    }

    /// The best amplitudes of given shapes.
    pub(super) fn project(&self, shapes: Vec<Shape>, resolution: Resolution) -> Fit {
        let places: Vec<Place> = shapes
            .iter()
            .map(|shape| self.place(shape, resolution))
            .collect();
        let mut free = [(); 3].map(|()| vec![true; shapes.len()]);
        let Evaluation {
            value,
            amplitudes,
            scaled,
            gram,
            ..
        } = self.evaluate(&shapes, &places, &mut free);
        let inverse = Cholesky::new(gram + DMatrix::identity(shapes.len(), shapes.len()) * 1e-6)
            .map(|factor| factor.inverse());
        let worth = scaled
            .iter()
            .enumerate()
            .map(|(i, scaled)| {
                let pivot = inverse.as_ref().map_or(1.0, |inverse| inverse[(i, i)]);
                scaled.iter().map(|x| x * x).sum::<f64>() / pivot
            })
            .collect();
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
        let places: Vec<Place> = fit
            .shapes
            .iter()
            .map(|shape| self.place(shape, resolution))
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
        let moved = |index: usize, x: &[f64]| {
            let [s, t] = frames[index];
            let axis = fit.shapes[index].axis + s * x[0] + t * x[1];
            let sharpness = fit.shapes[index].sharpness * math::exp(x[2].clamp(-20.0, 20.0));
            (axis, sharpness)
        };
        let shapes_at = |x: &[f64]| -> Vec<Shape> {
            x.chunks_exact(3)
                .enumerate()
                .map(|(index, x)| {
                    let (axis, sharpness) = moved(index, x);
                    let sharpness = sharpness.clamp(SHARPNESS.0, places[index].max_sharpness);
                    Shape {
                        axis: axis.normalize(),
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
                let blurred = shape.blurred();
                // Steps are in widths of the lobe, of which blur leaves a part.
                let part = blurred.shape.sharpness / shape.sharpness;
                let power = self.radiance_weight * shape.product_integral(shape).value
                    + self.gloss_weight * part * blurred.product_integral(&blurred).value;
                [(square * power).max(1e-8); 3]
            })
            .collect();
        let mut free = [(); 3].map(|()| vec![true; count]);
        let best = minimise(vec![0.0; 3 * count], &curvature, iterations, 1e-7, |x| {
            let shapes = shapes_at(x);
            let evaluation = self.evaluate(&shapes, &places, &mut free);
            let mut gradient = vec![0.0; x.len()];
            for (index, gradient) in gradient.chunks_exact_mut(3).enumerate() {
                let (axis, sharpness) = moved(index, &x[3 * index..3 * index + 3]);
                let tangent = evaluation.by_axis[index] / axis.length();
                gradient[0] = tangent.dot(frames[index][0]);
                gradient[1] = tangent.dot(frames[index][1]);
                // Beyond a bound the sharpness stands still.
                if (SHARPNESS.0..=places[index].max_sharpness).contains(&sharpness) {
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
        places: &[Place],
        free: &mut [Vec<bool>; 3],
    ) -> Evaluation {
        let count = shapes.len();
        let blurred: Vec<Blurred> = shapes.iter().map(Shape::blurred).collect();
        let (targets, pairs): (Vec<[Pair; 3]>, Vec<Vec<Pair>>) = (0..count)
            .into_par_iter()
            .map(|index| {
                let pairs = (0..count)
                    .map(|other| {
                        self.combine(
                            shapes[index].product_integral(&shapes[other]),
                            blurred[index].product_integral(&blurred[other]),
                        )
                    })
                    .collect();
                (self.target(&shapes[index], &places[index]), pairs)
            })
            .unzip();
        let norms: Vec<f64> = (0..count).map(|i| pairs[i][i].value.sqrt()).collect();
        let gram = DMatrix::from_fn(count, count, |i, j| {
            pairs[i][j].value / (norms[i] * norms[j])
        });
        let integrals: Vec<(f64, f64)> = shapes.iter().map(Shape::integral).collect();
        let energy = DVector::from_fn(count, |i, _| integrals[i].0 / norms[i]);
        let mut evaluation = Evaluation {
            value: 1.0 + self.relative_gloss_weight,
            by_axis: vec![DVec3::ZERO; count],
            by_sharpness: vec![0.0; count],
            amplitudes: vec![[0.0; 3]; count],
            scaled: vec![[0.0; 3]; count],
            gram: DMatrix::zeros(0, 0),
        };
        for channel in 0..3 {
            let target = DVector::from_fn(count, |i, _| targets[i][channel].value / norms[i]);
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
                let mut by_axis = -targets[i][channel].by_axis;
                let mut by_sharpness =
                    solution.multiplier * integrals[i].1 - targets[i][channel].by_sharpness;
                for (pair, a) in pairs[i].iter().zip(&a) {
                    by_axis += pair.by_axis * *a;
                    by_sharpness += pair.by_sharpness * a;
                }
                evaluation.by_axis[i] += by_axis * (2.0 * a[i]);
                evaluation.by_sharpness[i] += 2.0 * a[i] * by_sharpness;
                evaluation.amplitudes[i][channel] = a[i];
                evaluation.scaled[i][channel] = scaled[i];
            }
        }
        evaluation.gram = gram;
        evaluation
    }

    fn combine(&self, radiance: Pair, gloss: Pair) -> Pair {
        let (r, g) = (self.radiance_weight, self.gloss_weight);
        Pair {
            value: r * radiance.value + g * gloss.value,
            by_axis: radiance.by_axis * r + gloss.by_axis * g,
            by_sharpness: r * radiance.by_sharpness + g * gloss.by_sharpness,
        }
    }
}

/// ∫ I G per channel, as a sum over cells.
fn inner_products(level: &Level, shape: &Shape) -> [Pair; 3] {
    let Moments { integral, offset } = level.moments(shape);
    [0, 1, 2].map(|channel| {
        let along = shape.axis.dot(offset[channel]);
        Pair {
            value: integral[channel],
            by_axis: (offset[channel] - shape.axis * along) * shape.sharpness,
            by_sharpness: along,
        }
    })
}

#[cfg(test)]
mod tests {
    use super::super::{lobes, relative_l2};
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
        let places: Vec<Place> = shapes
            .iter()
            .map(|shape| problem.place(shape, Resolution::Fine))
            .collect();
        let value = |shapes: &[Shape]| {
            let mut free = [(); 3].map(|()| vec![true; shapes.len()]);
            problem.evaluate(shapes, &places, &mut free)
        };
        let evaluation = value(&shapes);
        for index in 0..shapes.len() {
            let change = |axis: DVec3, log_sharpness: f64| {
                let mut changed = shapes;
                changed[index].axis = (changed[index].axis + axis).normalize();
                changed[index].sharpness *= math::exp(log_sharpness);
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
        let lobes = lobes(&fit);
        let radiance = relative_l2(&image, &lobes) as f64;
        let mut left = problem.blurred.clone();
        let blurred: Vec<Blurred> = fit.shapes.iter().map(Shape::blurred).collect();
        let shapes: Vec<Shape> = blurred.iter().map(|blurred| blurred.shape).collect();
        let amplitude = fit.amplitudes[0].map(|a| a * blurred[0].amplitude);
        left.subtract(&shapes, &[amplitude]);
        let expected = radiance.powi(2) + GLOSS_WEIGHT * left.power() / problem.blurred_power;
        // Pixels are bilinear, and the blurred image's cells are of five degrees.
        assert!(
            (fit.value / expected - 1.0).abs() < 0.02,
            "{} {expected}",
            fit.value
        );
    }
}
