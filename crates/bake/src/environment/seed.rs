//! Where the next lobes should start: peaks of what the present ones leave, over scales.

use rayon::prelude::*;

use super::level::Level;
use super::lobe::{Blurred, GLOSS, Shape};
use super::solve::{Fit, Problem};

/// Lobe width (1/√λ) in cells of the level whose peak it starts from.
const WIDTH: f64 = 1.5;

/// Sharpnesses of lobes that start from a peak of the blurred image, in those of the blur.
const GLOSSY: [f64; 3] = [0.25, 1.0, 4.0];

/// Greatest cosine (normalised inner product) between two lobes of one batch.
const MAX_OVERLAP: f64 = 0.2;

/// Candidates per wanted lobe and level that are looked at closely.
const CANDIDATES: usize = 8;

/// Up to `count` lobes, best first, each of which alone would take most from the objective,
/// not counting those that overlap a better one.
pub(super) fn seeds(problem: &Problem, fit: &Fit, count: usize) -> Vec<Shape> {
    let mut left = problem.levels[0].clone();
    left.subtract(&fit.shapes, &fit.amplitudes);
    let mut left_blurred = problem.blurred.clone();
    let (shapes, amplitudes): (Vec<Shape>, Vec<[f64; 3]>) = fit
        .shapes
        .iter()
        .map(Shape::blurred)
        .zip(&fit.amplitudes)
        .map(
            |(
                Blurred {
                    shape, amplitude, ..
                },
                all,
            )| (shape, all.map(|a| a * amplitude)),
        )
        .unzip();
    left_blurred.subtract(&shapes, &amplitudes);

    let mut candidates: Vec<(f64, Shape)> = Vec::new();
    for number in 0..problem.levels.len() {
        if number > 0 {
            left = left.halved();
        }
        let mut shapes = peaks(&left, &[(WIDTH * left.spacing()).powi(-2)]);
        if number == 0 {
            for index in 0..shapes.len() {
                let axis = shapes[index].axis;
                let sharpness = problem.max_sharpness(axis);
                shapes.push(Shape { axis, sharpness });
            }
        }
        let mut ranked: Vec<(f64, Shape)> = shapes
            .into_par_iter()
            .map(|shape| {
                let norm = shape.product_integral(&shape).value;
                let integral = left.moments(&shape).integral;
                let gain: f64 = integral.iter().map(|x| x.max(0.0).powi(2)).sum();
                (gain / norm, shape)
            })
            .collect();
        sort(&mut ranked);
        ranked.truncate(CANDIDATES * count);
        let mut shapes: Vec<Shape> = ranked.into_iter().map(|(_, shape)| shape).collect();
        if left.height() == left_blurred.height() {
            shapes.extend(peaks(&left_blurred, &GLOSSY.map(|factor| factor * GLOSS)));
        }
        candidates.par_extend(
            shapes
                .into_par_iter()
                .map(|shape| (problem.gain(&shape, &left, &left_blurred), shape)),
        );
    }
    candidates.retain(|(gain, _)| *gain > 0.0);
    sort(&mut candidates);
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

fn peaks(level: &Level, sharpnesses: &[f64]) -> Vec<Shape> {
    let cells = level.peaks();
    let axes = cells.into_iter().map(|cell| level.centre(cell).normalize());
    axes.flat_map(|axis| {
        sharpnesses
            .iter()
            .map(move |&sharpness| Shape { axis, sharpness })
    })
    .collect()
}

/// Best first; equal ones stay in the order of levels and cells.
fn sort(candidates: &mut [(f64, Shape)]) {
    candidates.sort_by(|a, b| b.0.total_cmp(&a.0));
}
