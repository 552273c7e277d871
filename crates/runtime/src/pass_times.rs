//! How long the passes of a frame take on the GPU.

use std::time::Duration;

use crate::Error;
use crate::transfer::read_buffer;

/// Times of the passes of one frame on the GPU.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PassTimes {
    /// Triangles to visibility buffer.
    pub visibility_buffer: Duration,
    /// Visibility buffer to radiance.
    pub shade: Duration,
    /// Radiance to display colour.
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

/// Timestamps before and after every pass.
#[derive(Debug)]
pub(crate) struct Timestamps {
    queries: wgpu::QuerySet,
    resolved: wgpu::Buffer,
    readable: wgpu::Buffer,
    /// Nanoseconds of one tick.
    period: f32,
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
        Some(Self {
            queries: device.create_query_set(&wgpu::QuerySetDescriptor {
                label: Some("relight timestamps"),
                ty: wgpu::QueryType::Timestamp,
                count: COUNT,
            }),
            resolved: buffer(wgpu::BufferUsages::QUERY_RESOLVE | wgpu::BufferUsages::COPY_SRC),
            readable: buffer(wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::MAP_READ),
            period: queue.get_timestamp_period(),
        })
    }

    pub(crate) fn render(&self, pass: Pass) -> wgpu::RenderPassTimestampWrites<'_> {
        wgpu::RenderPassTimestampWrites {
            query_set: &self.queries,
            beginning_of_pass_write_index: Some(2 * pass as u32),
            end_of_pass_write_index: Some(2 * pass as u32 + 1),
        }
    }

    pub(crate) fn compute(&self, pass: Pass) -> wgpu::ComputePassTimestampWrites<'_> {
        wgpu::ComputePassTimestampWrites {
            query_set: &self.queries,
            beginning_of_pass_write_index: Some(2 * pass as u32),
            end_of_pass_write_index: Some(2 * pass as u32 + 1),
        }
    }

    /// Records the copy to readable memory, after the passes.
    pub(crate) fn resolve(&self, encoder: &mut wgpu::CommandEncoder) {
        encoder.resolve_query_set(&self.queries, 0..COUNT, &self.resolved, 0);
        encoder.copy_buffer_to_buffer(&self.resolved, 0, &self.readable, 0, BYTES);
    }

    pub(crate) fn read(&self, device: &wgpu::Device) -> Result<PassTimes, Error> {
        let bytes = read_buffer(device, &self.readable)?;
        let ticks: Vec<u64> = bytemuck::pod_collect_to_vec(&bytes);
        let time = |pass: Pass| {
            let first = 2 * pass as usize;
            let ticks = ticks[first + 1].saturating_sub(ticks[first]);
            Duration::from_nanos((ticks as f64 * f64::from(self.period)) as u64)
        };
        Ok(PassTimes {
            visibility_buffer: time(Pass::VisibilityBuffer),
            shade: time(Pass::Shade),
            tonemap: time(Pass::Tonemap),
        })
    }
}
