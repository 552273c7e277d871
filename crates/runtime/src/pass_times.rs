//! How long the passes of a frame take on the GPU.

use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

/// Times of the passes of one frame on the GPU.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PassTimes {
    /// Triangles to visibility buffer.
    pub visibility_buffer: Duration,
    /// Visibility buffer to radiance.
    pub shade: Duration,
    /// Radiance to target; zero of frames that were drawn into a pass of the app's.
    pub tonemap: Duration,
}

impl PassTimes {
    /// All passes.
    pub fn total(&self) -> Duration {
        self.visibility_buffer + self.shade + self.tonemap
    }
}

/// A pass, by the place of its two timestamps.
#[derive(Clone, Copy)]
pub(crate) enum Pass {
    VisibilityBuffer,
    Shade,
    Tonemap,
}

const COUNT: u32 = 6;
const BYTES: u64 = COUNT as u64 * wgpu::QUERY_SIZE as u64;
/// Frames whose times are on their way at most; others are not timed.
const RING: usize = 4;

/// Timestamps before and after every pass, of a few frames at a time.
#[derive(Debug)]
pub(crate) struct Timestamps {
    slots: Vec<Arc<Slot>>,
    last: Arc<Mutex<Option<PassTimes>>>,
    /// Nanoseconds of one tick.
    period: f32,
}

/// Where the timestamps of one frame go.
#[derive(Debug)]
struct Slot {
    queries: wgpu::QuerySet,
    resolved: wgpu::Buffer,
    readable: wgpu::Buffer,
    /// Somebody records into it, or it is on its way.
    taken: Mutex<bool>,
}

impl Timestamps {
    /// `None` where the device was made without [`wgpu::Features::TIMESTAMP_QUERY`].
    pub(crate) fn new(device: &wgpu::Device, queue: &wgpu::Queue) -> Option<Self> {
        if !device.features().contains(wgpu::Features::TIMESTAMP_QUERY) {
            return None;
        }
        let buffer = |usage| {
            device.create_buffer(&wgpu::BufferDescriptor {
                label: Some("relight timestamps"),
                size: BYTES,
                usage,
                mapped_at_creation: false,
            })
        };
        let slot = || Slot {
            queries: device.create_query_set(&wgpu::QuerySetDescriptor {
                label: Some("relight timestamps"),
                ty: wgpu::QueryType::Timestamp,
                count: COUNT,
            }),
            resolved: buffer(wgpu::BufferUsages::QUERY_RESOLVE | wgpu::BufferUsages::COPY_SRC),
            readable: buffer(wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::MAP_READ),
            taken: Mutex::new(false),
        };
        Some(Self {
            slots: (0..RING).map(|_| Arc::new(slot())).collect(),
            last: Arc::default(),
            period: queue.get_timestamp_period(),
        })
    }

    /// Somewhere to record a frame's times; `None` while all are on their way.
    pub(crate) fn begin(&self) -> Option<Recording> {
        let slot = self.slots.iter().find(|slot| {
            let mut taken = slot.taken.lock().unwrap_or_else(PoisonError::into_inner);
            !std::mem::replace(&mut taken, true)
        })?;
        Some(Recording {
            slot: Taken(slot.clone()),
            last: self.last.clone(),
            period: self.period,
        })
    }

    /// The last times that are known.
    pub(crate) fn last(&self) -> Option<PassTimes> {
        *self.last.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// A slot that is given back when it is no longer needed: also if the commands are never
/// submitted.
#[derive(Debug)]
struct Taken(Arc<Slot>);

impl Drop for Taken {
    fn drop(&mut self) {
        *(self.0.taken.lock()).unwrap_or_else(PoisonError::into_inner) = false;
    }
}

/// The times of a frame that is being recorded.
#[derive(Debug)]
pub(crate) struct Recording {
    slot: Taken,
    last: Arc<Mutex<Option<PassTimes>>>,
    period: f32,
}

impl Recording {
    pub(crate) fn render(&self, pass: Pass) -> wgpu::RenderPassTimestampWrites<'_> {
        wgpu::RenderPassTimestampWrites {
            query_set: &self.slot.0.queries,
            beginning_of_pass_write_index: Some(2 * pass as u32),
            end_of_pass_write_index: Some(2 * pass as u32 + 1),
        }
    }

    pub(crate) fn compute(&self, pass: Pass) -> wgpu::ComputePassTimestampWrites<'_> {
        wgpu::ComputePassTimestampWrites {
            query_set: &self.slot.0.queries,
            beginning_of_pass_write_index: Some(2 * pass as u32),
            end_of_pass_write_index: Some(2 * pass as u32 + 1),
        }
    }

    /// Records the copy to readable memory, after the passes; the times are known once the GPU is
    /// done and the device was polled.
    pub(crate) fn end(self, encoder: &mut wgpu::CommandEncoder, passes: u32) {
        let slot = &self.slot.0;
        // Queries that nothing was written to may not be resolved everywhere.
        let bytes = u64::from(2 * passes) * u64::from(wgpu::QUERY_SIZE);
        encoder.resolve_query_set(&slot.queries, 0..2 * passes, &slot.resolved, 0);
        encoder.copy_buffer_to_buffer(&slot.resolved, 0, &slot.readable, 0, bytes);
        let readable = slot.readable.clone();
        encoder.map_buffer_on_submit(&readable, wgpu::MapMode::Read, 0..bytes, move |result| {
            if result.is_ok() {
                self.read(bytes);
                self.slot.0.readable.unmap();
            }
        });
    }

    fn read(&self, bytes: u64) {
        let Ok(mapped) = self.slot.0.readable.get_mapped_range(0..bytes) else {
            return;
        };
        let ticks: Vec<u64> = bytemuck::pod_collect_to_vec(&mapped);
        drop(mapped);
        let time = |pass: Pass| {
            let first = 2 * pass as usize;
            let ticks =
                (ticks.get(first..first + 2)).map_or(0, |ticks| ticks[1].saturating_sub(ticks[0]));
            Duration::from_nanos((ticks as f64 * f64::from(self.period)) as u64)
        };
        let times = PassTimes {
            visibility_buffer: time(Pass::VisibilityBuffer),
            shade: time(Pass::Shade),
            tonemap: time(Pass::Tonemap),
        };
        *self.last.lock().unwrap_or_else(PoisonError::into_inner) = Some(times);
    }
}
