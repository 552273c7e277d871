//! Memory of large matrices, kept for those to come.
//!
//! What is freed in pieces of megabytes goes back to the system, which clears it page by page before it is used
//! again: as much as a fifth of the time that compression takes, whose matrices are as large as what they are made of.

use std::sync::{Mutex, PoisonError};

use nalgebra::DMatrix;

/// Matrices of fewer numbers are left to the allocator.
const LEAST: usize = 1 << 16;
/// Numbers kept at most.
const MOST: usize = 1 << 25;

static KEPT: Mutex<Vec<Vec<f32>>> = Mutex::new(Vec::new());

/// An empty vector with room for so many numbers.
pub(crate) fn room(count: usize) -> Vec<f32> {
    if count >= LEAST {
        let mut kept = KEPT.lock().unwrap_or_else(PoisonError::into_inner);
        let fits = |values: &Vec<f32>| (count..=2 * count).contains(&values.capacity());
        let smallest = (0..kept.len()).filter(|&i| fits(&kept[i]));
        if let Some(index) = smallest.min_by_key(|&i| kept[i].capacity()) {
            return kept.swap_remove(index);
        }
    }
    Vec::with_capacity(count)
}

/// A matrix of zeros.
pub(crate) fn zeros(rows: usize, columns: usize) -> DMatrix<f32> {
    let mut values = room(rows * columns);
    values.resize(rows * columns, 0.0);
    DMatrix::from_vec(rows, columns, values)
}

/// Keeps a matrix's memory.
pub(crate) fn keep(matrix: DMatrix<f32>) {
    let mut values = Vec::from(matrix.data);
    if values.capacity() < LEAST {
        return;
    }
    values.clear();
    let mut kept = KEPT.lock().unwrap_or_else(PoisonError::into_inner);
    let held: usize = kept.iter().map(Vec::capacity).sum();
    if held + values.capacity() <= MOST {
        kept.push(values);
    }
}

/// Keeps the memory of a matrix that is not used any more.
pub(crate) fn keep_of(matrix: &mut DMatrix<f32>) {
    keep(std::mem::replace(matrix, DMatrix::zeros(0, 0)));
}

/// Gives all that is kept back to the system.
pub(crate) fn forget() {
    KEPT.lock().unwrap_or_else(PoisonError::into_inner).clear();
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn memory_is_used_again_and_holds_nothing_of_before() {
        // A size that no other test asks for.
        let (rows, columns) = (1009, 2003);
        let mut first = zeros(rows, columns);
        first.fill(1.0);
        let place = first.as_ptr();
        keep(first);
        let second = zeros(rows, columns - 1);
        assert_eq!(second.as_ptr(), place);
        assert!(second.iter().all(|value| *value == 0.0));
        // Too little is not kept, too much not given.
        keep(second);
        assert!(room(LEAST).capacity() < rows * columns);
    }
}
