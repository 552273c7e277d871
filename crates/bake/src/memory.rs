//! Memory of large matrices, kept for those to come.
//!
//! What is freed in pieces of megabytes goes back to the system, which clears it page by page before it is used
//! again: as much as a fifth of the time that compression takes, whose matrices are as large as what they are made of.

use std::sync::{Mutex, PoisonError};

use nalgebra::DMatrix;

/// Matrices of fewer numbers are left to the allocator.
const LEAST: usize = 1 << 16;
/// Numbers kept at most.
const MOST: usize = 1 << 26;

static KEPT: Kept = Kept(Mutex::new(Vec::new()));

/// Vectors, with the numbers that were last in them.
struct Kept(Mutex<Vec<Vec<f32>>>);

impl Kept {
    fn take(&self, count: usize) -> Option<Vec<f32>> {
        if count < LEAST {
            return None;
        }
        let mut kept = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let fits = |values: &Vec<f32>| (count..=2 * count).contains(&values.capacity());
        let all = (0..kept.len()).filter(|&i| fits(&kept[i]));
        let smallest = all.min_by_key(|&i| kept[i].capacity())?;
        Some(kept.swap_remove(smallest))
    }

    fn put(&self, values: Vec<f32>) {
        if values.capacity() < LEAST {
            return;
        }
        let mut kept = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let held: usize = kept.iter().map(Vec::capacity).sum();
        if held + values.capacity() <= MOST {
            kept.push(values);
        }
    }
}

/// An empty vector with room for so many numbers.
pub(crate) fn room(count: usize) -> Vec<f32> {
    let mut values = (KEPT.take(count)).unwrap_or_else(|| Vec::with_capacity(count));
    values.clear();
    values
}

/// So many numbers, whichever were there before: for what is written whole.
pub(crate) fn used(count: usize) -> Vec<f32> {
    let mut values = KEPT.take(count).unwrap_or_default();
    values.resize(count, 0.0);
    values
}

/// Keeps a matrix's memory.
pub(crate) fn keep(matrix: DMatrix<f32>) {
    keep_values(matrix.data.into());
}

/// Keeps the memory of a matrix that is not used any more.
pub(crate) fn keep_of(matrix: &mut DMatrix<f32>) {
    keep(std::mem::replace(matrix, DMatrix::zeros(0, 0)));
}

/// Keeps a vector's memory.
pub(crate) fn keep_values(values: Vec<f32>) {
    KEPT.put(values);
}

/// Gives all that is kept back to the system.
pub(crate) fn forget() {
    KEPT.0
        .lock()
        .unwrap_or_else(PoisonError::into_inner)
        .clear();
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn memory_is_used_again() {
        let kept = Kept(Mutex::default());
        let first = vec![1.0; 2 * LEAST];
        let place = first.as_ptr();
        kept.put(first);
        assert!(kept.take(LEAST - 1).is_none(), "too little");
        assert!(kept.take(2 * LEAST + 1).is_none(), "too much");
        let second = kept.take(2 * LEAST - 1).expect("it fits");
        assert_eq!(second.as_ptr(), place);
        assert!(kept.take(2 * LEAST).is_none(), "it is taken");
        // No more than there may be.
        (0..2).for_each(|_| kept.put(Vec::with_capacity(MOST / 2 + 1)));
        assert!(kept.take(MOST / 2).is_some() && kept.take(MOST / 2).is_none());
    }
}
