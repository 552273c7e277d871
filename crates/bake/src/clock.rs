//! Processor time of this process.

use std::time::Duration;

/// When something began.
pub struct ProcessorClock(Duration);

impl ProcessorClock {
    /// Begins now.
    pub fn start() -> Self {
        Self(now())
    }

    /// Processor time of all threads since then; of systems that do not tell, wall-clock time.
    pub fn elapsed(&self) -> Duration {
        now().saturating_sub(self.0)
    }
}

#[cfg(unix)]
fn now() -> Duration {
    let time = rustix::time::clock_gettime(rustix::time::ClockId::ProcessCPUTime);
    // Neither is negative.
    Duration::new(time.tv_sec as u64, time.tv_nsec as u32)
}

#[cfg(not(unix))]
fn now() -> Duration {
    std::time::SystemTime::UNIX_EPOCH
        .elapsed()
        .unwrap_or_default()
}
