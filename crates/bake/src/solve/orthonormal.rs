//! Columns of a tall matrix -> an orthonormal basis of what they span, by the modified Gram-Schmidt process.

use nalgebra::DMatrix;

use crate::simd::vectorised;

/// Products that are summed side by side.
const LANES: usize = 16;
/// Length of what is left of a unit vector below which it lies in the span of those before, but for rounding.
const LEAST: f32 = 1e-4;
/// The same of a coordinate axis in place of one that does: where there is room for another column, some axis keeps more.
const LEAST_OF_AXIS: f32 = 0.05;
/// Each pass takes away what rounding left of the one before; twice is enough (Giraud, Langou and Rozložník 2005, "The
/// loss of orthogonality in the Gram-Schmidt orthogonalization process").
const PASSES: usize = 2;

/// As many orthonormal columns, the first few of which span what the same number of the first columns do. In place of
/// those that lie in the span of others, any that do not.
///
/// # Panics
///
/// If there are more columns than rows.
pub(crate) fn orthonormal(mut columns: DMatrix<f32>) -> DMatrix<f32> {
    let (rows, count) = columns.shape();
    assert!(count <= rows, "{count} orthonormal columns of {rows} rows");
    let mut axes = 0..rows;
    for index in 0..count {
        let (before, rest) = columns.as_mut_slice().split_at_mut(index * rows);
        let column = &mut rest[..rows];
        let mut least = LEAST;
        while !(normalise(column) && is_left(before, column, least)) {
            let Some(axis) = axes.next() else { break };
            column.fill(0.0);
            column[axis] = 1.0;
            least = LEAST_OF_AXIS;
        }
    }
    columns
}

/// Scales a vector to unit length, if it has a length.
fn normalise(vector: &mut [f32]) -> bool {
    // Of numbers up to one, whose squares neither overflow nor all vanish.
    let largest = vector.iter().fold(0f32, |most, x| most.max(x.abs()));
    if !(largest > 0.0 && largest < f32::INFINITY) {
        return false;
    }
    vectorised!(<'a> vector: &'a mut [f32] = vector, largest: f32 = largest => () {
        for x in &mut *vector {
            *x /= largest;
        }
        let length = dot(vector, vector).sqrt();
        for x in vector {
            *x /= length;
        }
    });
    true
}

/// Takes from a unit vector what lies along the columns `before` it and makes the rest one, if that was longer than `least`.
fn is_left(before: &[f32], vector: &mut [f32], least: f32) -> bool {
    for pass in 0..PASSES {
        vectorised!(<'a> before: &'a [f32] = before, vector: &'a mut [f32] = vector => () {
            for other in before.chunks_exact(vector.len()) {
                let along = dot(other, vector);
                for (x, other) in vector.iter_mut().zip(other) {
                    *x -= along * other;
                }
            }
        });
        let left = vectorised!(<'a> vector: &'a [f32] = vector => f32 { dot(vector, vector) });
        if pass == 0 && left < least * least || !normalise(vector) {
            return false;
        }
    }
    true
}

/// Sum of products, in the same order whatever the width of vectors.
#[inline(always)]
fn dot(a: &[f32], b: &[f32]) -> f32 {
    let ((a, rest_of_a), (b, rest_of_b)) = (a.as_chunks::<LANES>(), b.as_chunks::<LANES>());
    let mut sums = [0.0; LANES];
    for (a, b) in a.iter().zip(b) {
        for lane in 0..LANES {
            sums[lane] += a[lane] * b[lane];
        }
    }
    let rest: f32 = rest_of_a.iter().zip(rest_of_b).map(|(a, b)| a * b).sum();
    sums.iter().sum::<f32>() + rest
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::visibility::tests::random;

    fn furthest_from_orthonormal(columns: &DMatrix<f32>) -> f32 {
        let products = columns.tr_mul(columns);
        let off = products - DMatrix::identity(columns.ncols(), columns.ncols());
        off.amax()
    }

    #[test]
    fn columns_span_what_they_spanned() {
        let mut state = 4;
        let columns = DMatrix::from_fn(203, 28, |_, j| {
            // From large to small.
            (random(&mut state) - 0.5) * 0.5f32.powi(j as i32)
        });
        let basis = orthonormal(columns.clone());
        assert!(furthest_from_orthonormal(&basis) < 1e-5);
        for first in [1, 7, 28] {
            let (columns, basis) = (columns.columns(0, first), basis.columns(0, first));
            for column in columns.column_iter() {
                let left = column - basis * basis.tr_mul(&column);
                assert!(left.norm() < 1e-5 * column.norm(), "{first}");
            }
        }
    }

    #[test]
    fn columns_that_depend_on_others_are_replaced() {
        let mut state = 8;
        for (rows, count) in [(5, 5), (16, 16), (90, 28)] {
            let few = DMatrix::from_fn(rows, 3, |_, _| random(&mut state));
            let mix = DMatrix::from_fn(3, count, |_, _| random(&mut state) - 0.5);
            let dependent = &few * mix;
            let basis = orthonormal(dependent.clone());
            assert!(furthest_from_orthonormal(&basis) < 1e-5, "{rows}, {count}");
            let left = &dependent - &basis * basis.tr_mul(&dependent);
            assert!(left.amax() < 1e-4 * dependent.amax(), "{rows}, {count}");
            for nothing in [0.0, f32::NAN] {
                let basis = orthonormal(DMatrix::from_element(rows, count, nothing));
                assert_eq!(basis, DMatrix::identity(rows, count), "{rows}, {count}");
            }
        }
        assert_eq!(orthonormal(DMatrix::zeros(4, 0)).ncols(), 0);
    }
}
