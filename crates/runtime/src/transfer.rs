//! From memory to the GPU and back.

use crate::{Error, Renderer};

/// A buffer of at least `room` bytes that holds `contents`. On a device that is lost this is an error, where
/// `create_buffer_init` panics.
pub(crate) fn filled_buffer(
    device: &wgpu::Device,
    label: &str,
    contents: &[u8],
    room: u64,
    usage: wgpu::BufferUsages,
) -> Result<wgpu::Buffer, Error> {
    let size = room.max(contents.len() as u64);
    let size = size.next_multiple_of(wgpu::COPY_BUFFER_ALIGNMENT);
    let buffer = device.create_buffer(&wgpu::BufferDescriptor {
        label: Some(label),
        size,
        usage,
        mapped_at_creation: true,
    });
    buffer
        .get_mapped_range_mut(..)
        .map_err(|error| Error::DeviceFailed(error.to_string()))?
        .slice(..contents.len())
        .copy_from_slice(contents);
    buffer.unmap();
    Ok(buffer)
}

/// A buffer that is filled again and again, and what it holds: what stays the same is not written
/// again.
#[derive(Debug, Default)]
pub(crate) struct Slot(Option<(wgpu::Buffer, Vec<u8>)>);

impl Slot {
    /// Fills it, by the next submission; makes a new one, of at least `room` bytes, if it does not
    /// fit. Returns whether it is new.
    pub(crate) fn fill(
        &mut self,
        renderer: &Renderer,
        label: &str,
        contents: &[u8],
        room: u64,
        usage: wgpu::BufferUsages,
    ) -> Result<bool, Error> {
        match &mut self.0 {
            Some((_, held)) if held == contents => Ok(false),
            Some((buffer, held)) if buffer.size() >= room.max(contents.len() as u64) => {
                renderer.queue().write_buffer(buffer, 0, contents);
                held.clear();
                held.extend_from_slice(contents);
                Ok(false)
            }
            _ => {
                let usage = usage | wgpu::BufferUsages::COPY_DST;
                let buffer = filled_buffer(renderer.device(), label, contents, room, usage)?;
                self.0 = Some((buffer, contents.to_vec()));
                Ok(true)
            }
        }
    }

    pub(crate) fn buffer(&self) -> &wgpu::Buffer {
        let (buffer, _) = self.0.as_ref().expect("filled before it is bound");
        buffer
    }
}

/// Maps a `MAP_READ` buffer once all submitted work is done, and unmaps it.
#[cfg(feature = "offscreen")]
pub(crate) fn read_buffer(device: &wgpu::Device, buffer: &wgpu::Buffer) -> Result<Vec<u8>, Error> {
    let failed = |error: &dyn std::fmt::Display| Error::DeviceFailed(error.to_string());
    let (sender, receiver) = std::sync::mpsc::channel();
    buffer.map_async(wgpu::MapMode::Read, .., move |result| {
        // The receiver outlives the poll below.
        let _ = sender.send(result);
    });
    device
        .poll(wgpu::PollType::wait_indefinitely())
        .map_err(|error| failed(&error))?;
    receiver
        .recv()
        .map_err(|error| failed(&error))?
        .map_err(|error| failed(&error))?;
    let bytes = buffer
        .get_mapped_range(..)
        .map_err(|error| failed(&error))?
        .to_vec();
    buffer.unmap();
    Ok(bytes)
}
