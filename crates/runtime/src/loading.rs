//! From memory to the GPU, piece by piece, while others draw.

use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use bytemuck::Pod;
use relight_shading::gpu::LimitError;

use crate::Error;
use crate::transfer::filled_buffer;

/// Most bytes that are handed to a queue at a time: a queue is locked meanwhile, a thread that draws would
/// wait.
const PIECE: usize = 1 << 20;
/// Bytes that go with one submission.
const SUBMITTED_TOGETHER: u64 = 4 << 20;
/// How long an upload waits for a thread that draws to submit: ten frames a second.
const PATIENCE: Duration = Duration::from_millis(100);

/// How far an upload is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct UploadProgress {
    /// Bytes copied.
    pub bytes: u64,
    /// [`Renderer::upload_bytes`](crate::Renderer::upload_bytes), which is what there is to copy or more.
    pub at_most: u64,
}

/// One upload.
pub(crate) struct Loading<'a> {
    device: &'a wgpu::Device,
    queue: &'a wgpu::Queue,
    /// Without, everything is left to the next submission.
    pieces: Option<Pieces<'a>>,
    progress: UploadProgress,
}

/// What goes to the GPU a few megabytes at a time. Where a thread draws they go with its submissions: one of
/// another thread's would make it wait, as drivers may submit only after what was submitted before.
struct Pieces<'a> {
    wanted: &'a mut dyn FnMut(UploadProgress) -> bool,
    /// Frames that were prepared so far.
    frames: &'a AtomicU64,
    /// The same when there was something new last.
    seen: u64,
    /// Whether frames came while it waited for one.
    drawing: bool,
    submitted: u64,
}

impl Pieces<'_> {
    /// Sees that what was copied goes to the GPU, and asks whether there shall be more.
    fn hand_over(
        &mut self,
        device: &wgpu::Device,
        queue: &wgpu::Queue,
        progress: UploadProgress,
    ) -> Result<(), Error> {
        if progress.bytes - self.submitted >= SUBMITTED_TOGETHER {
            self.submitted = progress.bytes;
            if !self.waits_for_a_frame() {
                queue.submit([]);
                // Lets go of what was copied. That the device is lost shows in what is drawn.
                let _ = device.poll(wgpu::PollType::Poll);
            }
        }
        if (self.wanted)(progress) {
            Ok(())
        } else {
            Err(Error::Cancelled)
        }
    }

    /// Whether another frame was prepared, which takes along what was copied before it. Once there is none for a
    /// while nobody is waited for until there is one again.
    fn waits_for_a_frame(&mut self) -> bool {
        let step = Duration::from_millis(1);
        let mut waited = Duration::ZERO;
        loop {
            let frames = self.frames.load(Ordering::Relaxed);
            if frames != self.seen {
                (self.seen, self.drawing) = (frames, true);
                return true;
            }
            // Pages have one thread, which cannot sleep.
            if !self.drawing || waited >= PATIENCE || cfg!(target_family = "wasm") {
                self.drawing = false;
                return false;
            }
            std::thread::sleep(step);
            waited += step;
        }
    }
}

impl<'a> Loading<'a> {
    /// What is left to the app's next submission.
    pub(crate) fn at_once(device: &'a wgpu::Device, queue: &'a wgpu::Queue) -> Self {
        Self {
            device,
            queue,
            pieces: None,
            progress: UploadProgress {
                bytes: 0,
                at_most: 0,
            },
        }
    }

    /// What is handed over piece by piece, for as long as it is `wanted`, between `frames` that are prepared.
    pub(crate) fn by_pieces(
        device: &'a wgpu::Device,
        queue: &'a wgpu::Queue,
        frames: &'a AtomicU64,
        at_most: u64,
        wanted: &'a mut dyn FnMut(UploadProgress) -> bool,
    ) -> Self {
        let seen = frames.load(Ordering::Relaxed);
        Self {
            pieces: Some(Pieces {
                wanted,
                frames,
                seen,
                drawing: seen > 0,
                submitted: 0,
            }),
            progress: UploadProgress { bytes: 0, at_most },
            ..Self::at_once(device, queue)
        }
    }

    pub(crate) fn device(&self) -> &'a wgpu::Device {
        self.device
    }

    /// Bytes that it has filled.
    pub(crate) fn bytes(&self) -> u64 {
        self.progress.bytes
    }

    /// So many more were handed over.
    fn passed(&mut self, bytes: usize) -> Result<(), Error> {
        self.progress.bytes += bytes as u64;
        self.ask()
    }

    /// Whether it is still wanted, before work that copies nothing.
    pub(crate) fn ask(&mut self) -> Result<(), Error> {
        match &mut self.pieces {
            Some(pieces) => pieces.hand_over(self.device, self.queue, self.progress),
            None => Ok(()),
        }
    }

    /// A read-only storage buffer of at least one element: a binding must not be empty.
    pub(crate) fn storage<T: Pod>(
        &mut self,
        label: &str,
        data: &[T],
    ) -> Result<wgpu::Buffer, Error> {
        let one = [T::zeroed()];
        let data = if data.is_empty() { &one } else { data };
        check_storage(self.device, size_of_val(data) as u64).map_err(Error::Scene)?;
        let usage = wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_DST;
        let buffer = filled_buffer(self.device, label, bytemuck::cast_slice(data), 0, usage)?;
        self.passed(size_of_val(data))?;
        Ok(buffer)
    }

    /// A texture of four bytes per texel, in layers, without further levels. What is not written yet
    /// counts as filled.
    pub(crate) fn texture(
        &mut self,
        label: &str,
        format: wgpu::TextureFormat,
        usage: wgpu::TextureUsages,
        [width, height, layers]: [u32; 3],
    ) -> Result<wgpu::Texture, Error> {
        let limits = self.device.limits();
        for (limit, needed, allowed) in [
            (
                "max_texture_dimension_2d",
                width.max(height),
                limits.max_texture_dimension_2d,
            ),
            (
                "max_texture_array_layers",
                layers,
                limits.max_texture_array_layers,
            ),
        ] {
            LimitError::check(limit, u64::from(needed), u64::from(allowed))
                .map_err(Error::Scene)?;
        }
        let size = wgpu::Extent3d {
            width,
            height,
            depth_or_array_layers: layers,
        };
        Ok(self.device.create_texture(&wgpu::TextureDescriptor {
            label: Some(label),
            size,
            mip_level_count: 1,
            sample_count: 1,
            dimension: wgpu::TextureDimension::D2,
            format,
            usage: usage | wgpu::TextureUsages::COPY_DST,
            view_formats: &[],
        }))
    }

    /// Fills rows of a texture's layer, of four bytes per texel, from `origin` on.
    pub(crate) fn rows(
        &mut self,
        texture: &wgpu::Texture,
        [x, y, z]: [u32; 3],
        width: u32,
        texels: &[u8],
    ) -> Result<(), Error> {
        let row = 4 * width as usize;
        let rows = (PIECE / row).max(1);
        for (piece, texels) in texels.chunks(rows * row).enumerate() {
            let origin = wgpu::Origin3d {
                x,
                y: y + (piece * rows) as u32,
                z,
            };
            self.queue.write_texture(
                wgpu::TexelCopyTextureInfo {
                    texture,
                    mip_level: 0,
                    origin,
                    aspect: wgpu::TextureAspect::All,
                },
                texels,
                wgpu::TexelCopyBufferLayout {
                    offset: 0,
                    bytes_per_row: Some(row as u32),
                    rows_per_image: None,
                },
                wgpu::Extent3d {
                    width,
                    height: (texels.len() / row) as u32,
                    depth_or_array_layers: 1,
                },
            );
            self.passed(texels.len())?;
        }
        Ok(())
    }
}

/// Checks that a storage buffer of `bytes` can be created and bound.
pub(crate) fn check_storage(device: &wgpu::Device, bytes: u64) -> Result<(), LimitError> {
    let limits = device.limits();
    LimitError::check(
        "max_storage_buffer_binding_size",
        bytes,
        limits.max_storage_buffer_binding_size,
    )?;
    LimitError::check("max_buffer_size", bytes, limits.max_buffer_size)
}
