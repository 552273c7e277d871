//! Amplitudes of lobes of given shape: non-negative least squares with the energy held.

use nalgebra::{Cholesky, DMatrix, DVector, Dyn};

/// Added to the unit diagonal, so that coinciding lobes do not make it singular.
const RIDGE: f64 = 1e-9;

/// One channel's solution.
#[derive(Clone, Debug)]
pub(crate) struct Amplitudes {
    pub(crate) values: Vec<f64>,
    /// Lagrange multiplier of the energy.
    pub(crate) multiplier: f64,
}

/// Minimises ½ xᵀ `gram` x − `target`ᵀ x over x ≥ 0 with `energy`ᵀ x = `total`, by the
/// active-set method of Lawson & Hanson (1974, ch. 23) with the equality eliminated by its
/// multiplier. `gram` has a unit diagonal, `energy` is positive, `total` is at least 0.
///
/// `free` says which amplitudes are greater than 0 at the start (a warm start, as in Bro &
/// de Jong 1997) and at the end.
pub(crate) fn solve(
    gram: &DMatrix<f64>,
    target: &DVector<f64>,
    energy: &DVector<f64>,
    total: f64,
    free: &mut [bool],
) -> Amplitudes {
    let count = target.len();
    if total <= 0.0 {
        return Amplitudes {
            values: vec![0.0; count],
            multiplier: 0.0,
        };
    }
    if !free.contains(&true) {
        free.fill(true);
    }
    // Some amplitude stays positive, for the energy is.
    let mut current = loop {
        let solution = solve_free(gram, target, energy, total, free);
        if !drop_negative(&solution.values, free) {
            break solution;
        }
    };
    let tolerance = 1e-10 * target.amax();
    for _ in 0..2 * count {
        let values = DVector::from_column_slice(&current.values);
        let slope = target - gram * values - energy * current.multiplier;
        let entering = (0..count)
            .filter(|&index| !free[index] && slope[index] > tolerance)
            .max_by(|&a, &b| slope[a].total_cmp(&slope[b]));
        let Some(entering) = entering else { break };
        free[entering] = true;
        loop {
            let solution = solve_free(gram, target, energy, total, free);
            // The first bound met on the way from the feasible point to the solution.
            let step = (0..count)
                .filter(|&index| free[index] && solution.values[index] <= 0.0)
                .map(|index| {
                    let (from, to) = (current.values[index], solution.values[index]);
                    (if from > to { from / (from - to) } else { 0.0 }, index)
                })
                .min_by(|a, b| a.0.total_cmp(&b.0));
            let Some((step, leaving)) = step else {
                current = solution;
                break;
            };
            for (value, to) in current.values.iter_mut().zip(&solution.values) {
                *value += step * (to - *value);
            }
            current.values[leaving] = 0.0;
            free[leaving] = false;
        }
    }
    current
}

fn drop_negative(values: &[f64], free: &mut [bool]) -> bool {
    let mut dropped = false;
    for (value, free) in values.iter().zip(free) {
        if *free && *value <= 0.0 {
            *free = false;
            dropped = true;
        }
    }
    dropped
}

fn solve_free(
    gram: &DMatrix<f64>,
    target: &DVector<f64>,
    energy: &DVector<f64>,
    total: f64,
    free: &[bool],
) -> Amplitudes {
    let indices: Vec<usize> = (0..free.len()).filter(|&index| free[index]).collect();
    let factor = factor(gram, &indices);
    let plain = factor.solve(&target.select_rows(&indices));
    let energy = energy.select_rows(&indices);
    let correction = factor.solve(&energy);
    let multiplier = (energy.dot(&plain) - total) / energy.dot(&correction);
    let solution = plain - correction * multiplier;
    let mut values = vec![0.0; free.len()];
    for (&index, value) in indices.iter().zip(&solution) {
        values[index] = *value;
    }
    Amplitudes { values, multiplier }
}

fn factor(gram: &DMatrix<f64>, indices: &[usize]) -> Cholesky<f64, Dyn> {
    let mut ridge = RIDGE;
    loop {
        let mut part = gram.select_rows(indices).select_columns(indices);
        for diagonal in 0..indices.len() {
            part[(diagonal, diagonal)] += ridge;
        }
        // A Gram matrix is positive but for rounding, which the ridge outgrows.
        if let Some(factor) = Cholesky::new(part) {
            return factor;
        }
        ridge *= 10.0;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Rounding of a 12 × 12 solve, and the ridge.
    const TOLERANCE: f64 = 1e-6;

    #[test]
    fn solutions_are_optimal_and_keep_the_energy() {
        let count = 12;
        // Numbers without a pattern, the same on every run.
        let mut state = 1u32;
        let mut next = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            f64::from(state >> 8) / f64::from(1 << 24) - 0.5
        };
        let mut bound = 0;
        for _ in 0..50 {
            let vectors = DMatrix::from_fn(20, count, |_, _| next() + 0.3);
            let vectors = DMatrix::from_columns(
                &vectors
                    .column_iter()
                    .map(|column| column.normalize())
                    .collect::<Vec<_>>(),
            );
            let gram = vectors.transpose() * &vectors;
            let target = DVector::from_fn(count, |_, _| next() + 0.3);
            let energy = DVector::from_fn(count, |_, _| 1.0 + next());
            let mut free: Vec<bool> = (0..count).map(|_| next() > 0.0).collect();
            let solution = solve(&gram, &target, &energy, 1.5, &mut free);
            let values = DVector::from_vec(solution.values.clone());
            assert!((energy.dot(&values) - 1.5).abs() < TOLERANCE);
            let slope = &gram * &values - &target + &energy * solution.multiplier;
            for index in 0..count {
                assert!(values[index] >= 0.0);
                if values[index] > 0.0 {
                    assert!(slope[index].abs() < TOLERANCE, "{}", slope[index]);
                } else {
                    assert!(slope[index] > -TOLERANCE, "{}", slope[index]);
                    bound += 1;
                }
            }
        }
        assert!(bound > 50, "bounds were hardly met: {bound}");
    }

    #[test]
    fn coinciding_lobes_share() {
        let gram = DMatrix::from_element(3, 3, 1.0);
        let target = DVector::from_element(3, 2.0);
        let energy = DVector::from_element(3, 1.0);
        let solution = solve(&gram, &target, &energy, 2.0, &mut [true; 3]);
        assert!((solution.values.iter().sum::<f64>() - 2.0).abs() < TOLERANCE);
        assert!(solution.values.iter().all(|value| *value >= 0.0));
    }

    #[test]
    fn a_channel_without_light_has_no_amplitude() {
        let gram = DMatrix::identity(2, 2);
        let zero = DVector::zeros(2);
        let energy = DVector::from_element(2, 1.0);
        let solution = solve(&gram, &zero, &energy, 0.0, &mut [true; 2]);
        assert_eq!(solution.values, [0.0; 2]);
    }
}
