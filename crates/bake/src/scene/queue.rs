//! Chunks to bake, in an order that tells the time left, and the first error.

use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};

/// Chunks to bake, and the first error.
pub(super) struct Queue<E> {
    order: Vec<usize>,
    next: AtomicUsize,
    failed: AtomicBool,
    error: Mutex<Option<E>>,
}

impl<E: Send> Queue<E> {
    pub(super) fn new(chunks: &[usize]) -> Self {
        Self {
            order: scattered(chunks),
            next: AtomicUsize::new(0),
            failed: AtomicBool::new(false),
            error: Mutex::new(None),
        }
    }

    /// Bakes every chunk, so many at a time, until one fails.
    pub(super) fn run(
        self,
        at_hand: usize,
        bake: impl Fn(usize) -> Result<(), E> + Sync,
    ) -> Result<(), E> {
        rayon::scope(|scope| {
            for _ in 0..at_hand {
                scope.spawn(|scope| self.work(scope, &bake));
            }
        });
        let error = (self.error.into_inner()).unwrap_or_else(PoisonError::into_inner);
        error.map_or(Ok(()), Err)
    }

    /// Bakes one chunk and queues itself again. A thread that waits for another's vertices
    /// may start on the next chunk meanwhile; one chunk per job keeps that short.
    fn work<'s>(
        &'s self,
        scope: &rayon::Scope<'s>,
        bake: &'s (impl Fn(usize) -> Result<(), E> + Sync),
    ) {
        let next = self.next.fetch_add(1, Ordering::Relaxed);
        let Some(&chunk) = self.order.get(next) else {
            return;
        };
        if self.failed.load(Ordering::Relaxed) {
            return;
        }
        match bake(chunk) {
            Ok(()) => scope.spawn(move |scope| self.work(scope, bake)),
            Err(error) => {
                self.failed.store(true, Ordering::Relaxed);
                let mut first = self.error.lock().unwrap_or_else(PoisonError::into_inner);
                first.get_or_insert(error);
            }
        }
    }
}

/// The chunks in steps of about the golden section. Chunks come in spatial order and
/// neighbours cost alike; this way any stretch of the work is a fair sample of the whole,
/// and the time left can be told from the time spent.
fn scattered(chunks: &[usize]) -> Vec<usize> {
    let count = chunks.len();
    let coprime = |step: &usize| {
        let (mut a, mut b) = (*step, count);
        while b > 0 {
            (a, b) = (b, a % b);
        }
        a == 1
    };
    let first = (count as f64 * 0.618) as usize;
    let step = (1..=first).rev().find(coprime).unwrap_or(1);
    (0..count).map(|i| chunks[i * step % count]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scattering_keeps_every_chunk_and_spreads_the_first_ones() {
        for count in [0, 1, 2, 3, 10, 97, 100, 1024] {
            let chunks: Vec<usize> = (0..count).map(|i| 3 * i + 1).collect();
            let mut order = scattered(&chunks);
            assert_eq!(order.len(), count);
            if count >= 100 {
                let first = &order[..count / 10];
                let low = first.iter().filter(|&&chunk| chunk < 3 * count / 2).count();
                assert!(
                    (count / 20 - 1..=count / 20 + 1).contains(&low),
                    "{low} of {count}"
                );
            }
            order.sort_unstable();
            assert_eq!(order, chunks);
        }
    }
}
