//! What a bake did and how long that took.

use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

/// Processor time per stage, and what was done in it.
#[derive(Clone, Debug, Default)]
pub struct Statistics {
    /// Name of the stage and processor time spent in it, summed over threads.
    pub stages: Vec<(&'static str, Duration)>,
    /// Rays cast, without those that only verify.
    pub rays: u64,
    /// Places sampled; those that chunks share count for each, but not in drafts, which sample them once.
    pub sampled_vertices: u64,
    /// Points between vertices where interpolation was checked.
    pub probes: u64,
    /// Points whose visibility was compared with one ray per texel: vertices, and between them.
    pub verified_points: u64,
    /// Texels that differed; anything but zero fails the bake.
    pub differing_texels: u64,
}

/// Sums over all threads.
#[derive(Default)]
pub(super) struct Counters {
    /// Vertices to sample and compress.
    pub(super) total: AtomicU64,
    pub(super) sampled: AtomicU64,
    /// Sampled or interpolated.
    pub(super) known: AtomicU64,
    pub(super) probes: AtomicU64,
    pub(super) compressed: AtomicU64,
    pub(super) verified: AtomicU64,
    pub(super) differing: AtomicU64,
    pub(super) compress_nanoseconds: AtomicU64,
    pub(super) verify_nanoseconds: AtomicU64,
    pub(super) bounce_nanoseconds: AtomicU64,
    pub(super) bounce_rays: AtomicU64,
}

pub(super) fn load(counter: &AtomicU64) -> u64 {
    counter.load(Ordering::Relaxed)
}

pub(super) fn add_time(counter: &AtomicU64, start: Instant) {
    counter.fetch_add(start.elapsed().as_nanos() as u64, Ordering::Relaxed);
}
