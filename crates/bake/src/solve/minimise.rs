//! Limited-memory BFGS (Nocedal & Wright 2006, §7.2).

use std::collections::VecDeque;

/// Pairs of steps and gradient changes that are remembered.
const MEMORY: usize = 20;

/// Decrease demanded of a step, as a part of what the gradient promises (Armijo).
const SUFFICIENT: f64 = 1e-4;

/// Largest change of a coordinate in one step.
const MAX_STEP: f64 = 0.5;

/// Walks downhill from `start` for at most `iterations` steps; stops early where three
/// steps gain less than `tolerance` each. `function` gives value and gradient,
/// `curvature` a positive guess at the Hessian's diagonal. Returns the best point, never
/// worse than the start.
pub(crate) fn minimise(
    start: Vec<f64>,
    curvature: &[f64],
    iterations: usize,
    tolerance: f64,
    mut function: impl FnMut(&[f64]) -> (f64, Vec<f64>),
) -> Vec<f64> {
    let mut point = start;
    let (mut value, mut gradient) = function(&point);
    let mut memory: VecDeque<(Vec<f64>, Vec<f64>, f64)> = VecDeque::new();
    let mut idle = 0;
    for _ in 0..iterations {
        let mut direction = descent(&gradient, curvature, &memory);
        let mut slope = dot(&direction, &gradient);
        if slope >= 0.0 {
            memory.clear();
            direction = descent(&gradient, curvature, &memory);
            slope = dot(&direction, &gradient);
        }
        if slope == 0.0 {
            break;
        }
        let largest = direction.iter().fold(0f64, |m, d| m.max(d.abs()));
        let mut step = (MAX_STEP / largest).min(1.0);
        let mut accepted = None;
        for _ in 0..12 {
            let next: Vec<f64> = point
                .iter()
                .zip(&direction)
                .map(|(p, d)| p + step * d)
                .collect();
            let (next_value, next_gradient) = function(&next);
            if next_value <= value + SUFFICIENT * step * slope {
                accepted = Some((next, next_value, next_gradient));
                break;
            }
            // Minimum of the parabola through both values and the slope.
            let bend = next_value - value - step * slope;
            let parabola = -slope * step * step / (2.0 * bend);
            step = if parabola.is_finite() {
                parabola.clamp(0.1 * step, 0.5 * step)
            } else {
                0.1 * step
            };
        }
        let Some((next, next_value, next_gradient)) = accepted else {
            if memory.is_empty() {
                break;
            }
            memory.clear();
            continue;
        };
        let moved: Vec<f64> = next.iter().zip(&point).map(|(a, b)| a - b).collect();
        let change: Vec<f64> = next_gradient
            .iter()
            .zip(&gradient)
            .map(|(a, b)| a - b)
            .collect();
        let bend = dot(&moved, &change);
        if bend > 1e-12 * dot(&change, &change).sqrt() * dot(&moved, &moved).sqrt() {
            if memory.len() == MEMORY {
                memory.pop_front();
            }
            memory.push_back((moved, change, bend));
        }
        idle = if value - next_value < tolerance {
            idle + 1
        } else {
            0
        };
        (point, value, gradient) = (next, next_value, next_gradient);
        if idle == 3 {
            break;
        }
    }
    point
}

/// Minus the inverse Hessian, as far as guessed and remembered, times the gradient.
fn descent(
    gradient: &[f64],
    curvature: &[f64],
    memory: &VecDeque<(Vec<f64>, Vec<f64>, f64)>,
) -> Vec<f64> {
    let mut direction: Vec<f64> = gradient.iter().map(|g| -g).collect();
    let mut factors = Vec::with_capacity(memory.len());
    for (moved, change, bend) in memory.iter().rev() {
        let factor = dot(moved, &direction) / bend;
        add(&mut direction, -factor, change);
        factors.push(factor);
    }
    let scale = memory.back().map_or(1.0, |(_, change, bend)| {
        bend / change
            .iter()
            .zip(curvature)
            .map(|(y, c)| y * y / c)
            .sum::<f64>()
    });
    for (direction, curvature) in direction.iter_mut().zip(curvature) {
        *direction *= scale / curvature;
    }
    for ((moved, change, bend), factor) in memory.iter().zip(factors.into_iter().rev()) {
        let other = dot(change, &direction) / bend;
        add(&mut direction, factor - other, moved);
    }
    direction
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

fn add(to: &mut [f64], factor: f64, what: &[f64]) {
    for (to, what) in to.iter_mut().zip(what) {
        *to += factor * what;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn finds_the_end_of_a_curved_valley() {
        // Rosenbrock (1960).
        let function = |x: &[f64]| {
            let (a, b) = (1.0 - x[0], x[1] - x[0] * x[0]);
            (
                a * a + 100.0 * b * b,
                vec![-2.0 * a - 400.0 * b * x[0], 200.0 * b],
            )
        };
        let end = minimise(vec![-1.2, 1.0], &[100.0, 100.0], 200, 1e-14, function);
        // A value of 1e-10 is this near.
        assert!(
            (end[0] - 1.0).abs() < 1e-4 && (end[1] - 1.0).abs() < 1e-4,
            "{end:?}"
        );
    }
}
