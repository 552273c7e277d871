//! From the GPU to memory.

use crate::Error;

/// Maps a `MAP_READ` buffer once all submitted work is done, and unmaps it.
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
