//! Where the next lobes should start: peaks of what the present ones leave, over scales.

use rayon::prelude::*;

use super::lobe::Shape;
use super::solve::{Fit, Problem};

/// Lobe width (1/√λ) in cells of the level whose peak it starts from.
const WIDTH: f64 = 1.5;

/// The same on the finest level, tried beside it: a light of one pixel.
const FINEST_WIDTH: f64 = 0.6;

/// Greatest cosine (normalised inner product) between two lobes of one batch.
const MAX_OVERLAP: f64 = 0.2;

/// Up to `count` lobes, best first, each of which alone would take most from the squared
/// error, not counting those that overlap a better one.
pub(super) fn seeds(problem: &Problem, fit: &Fit, count: usize) -> Vec<Shape> {
    let mut residual = problem.levels[0].clone();
    residual.subtract(&fit.shapes, &fit.amplitudes);
    let mut candidates: Vec<(f64, Shape)> = Vec::new();
    for number in 0..problem.levels.len() {
        if number > 0 {
            residual = residual.halved();
        }
        let widths: &[f64] = if number == 0 {
            &[FINEST_WIDTH, WIDTH]
        } else {
            &[WIDTH]
        };
        let found: Vec<Vec<(f64, Shape)>> = residual
            .peaks()
            .into_par_iter()
            .map(|cell| {
                widths
                    .iter()
                    .map(|width| {
                        let sharpness = (width * residual.spacing()).powi(-2);
                        let shape = Shape {
                            axis: residual.centre(cell).normalize(),
                            sharpness: sharpness.min(problem.max_sharpness()),
                        };
                        let norm = shape.product_integral(&shape).value;
                        let gain: f64 = residual
                            .moments(&shape)
                            .integral
                            .iter()
                            .map(|flux| flux.max(0.0).powi(2) / norm)
                            .sum();
                        (gain, shape)
                    })
                    .collect()
            })
            .collect();
        candidates.extend(found.into_iter().flatten());
    }
    candidates.retain(|(gain, _)| *gain > 0.0);
    // Stable: equal gains stay in the order of levels and cells.
    candidates.sort_by(|a, b| b.0.total_cmp(&a.0));
    let mut chosen: Vec<Shape> = Vec::new();
    for (_, shape) in candidates {
        if chosen.len() == count {
            break;
        }
        let norm = shape.product_integral(&shape).value;
        let overlaps = chosen.iter().any(|other| {
            let product = shape.product_integral(other).value;
            let other_norm = other.product_integral(other).value;
            product * product > MAX_OVERLAP * MAX_OVERLAP * norm * other_norm
        });
        if !overlaps {
            chosen.push(shape);
        }
    }
    chosen
}
