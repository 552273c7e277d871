//! How long work reports its progress and is told to stop.

use std::sync::atomic::{AtomicBool, Ordering};

/// Progress of the stage at hand.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Progress {
    /// Name of the stage, for people.
    pub stage: &'static str,
    /// Done so far, in [0, 1].
    pub fraction: f32,
}

/// Someone asked the work to stop.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("interrupted")]
pub struct Interrupted;

/// Where progress goes and where the wish to stop comes from. Called from many threads.
#[derive(Clone, Copy)]
pub struct Monitor<'a> {
    /// Called often; must be cheap.
    pub report: &'a (dyn Fn(Progress) + Sync),
    /// Set from outside to stop.
    pub stop: &'a AtomicBool,
}

impl Monitor<'_> {
    /// Reports progress, and fails if the work shall stop.
    pub fn step(&self, stage: &'static str, fraction: f32) -> Result<(), Interrupted> {
        (self.report)(Progress { stage, fraction });
        if self.stop.load(Ordering::Relaxed) {
            Err(Interrupted)
        } else {
            Ok(())
        }
    }
}

static NEVER: AtomicBool = AtomicBool::new(false);

/// Reports to nobody and never stops.
pub const SILENT: Monitor<'static> = Monitor {
    report: &|_| (),
    stop: &NEVER,
};
