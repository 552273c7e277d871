//! Pictures by the runtime, on a GPU or its twin.

use relight_format::Scene;
use relight_runtime::offscreen::Gpu;
use relight_runtime::{Frame, twin, wgpu};

use crate::image_file::Image;

/// Where to render.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Device {
    /// A GPU if there is one that can, else the CPU. Software is no GPU: the twin is as fast, and
    /// some drivers end long loops.
    Auto,
    /// A GPU, if only in software, or nothing.
    Gpu,
    /// The CPU.
    Cpu,
}

/// A device that was found.
pub enum Renderer {
    /// A graphics device.
    Gpu(Box<Gpu>),
    /// The CPU twin.
    Cpu,
}

impl Renderer {
    /// Opens a device at WebGPU's default limits, which are enough by design.
    pub fn open(device: Device) -> Result<Self, relight_runtime::Error> {
        let open = || Gpu::new(&wgpu::Limits::default()).map(|gpu| Self::Gpu(Box::new(gpu)));
        match device {
            Device::Cpu => Ok(Self::Cpu),
            Device::Gpu => open(),
            Device::Auto => Ok(match open() {
                Ok(Self::Gpu(gpu)) if !gpu.is_software() => Self::Gpu(gpu),
                _ => Self::Cpu,
            }),
        }
    }

    /// Name of the adapter, or `cpu`.
    pub fn name(&self) -> &str {
        match self {
            Self::Gpu(gpu) => gpu.name(),
            Self::Cpu => "cpu",
        }
    }

    /// Renders linear radiance; the frame's exposure has no part in it.
    pub fn render(
        &mut self,
        scene: &Scene,
        frame: &Frame,
        [width, height]: [u32; 2],
    ) -> Result<Image, relight_runtime::Error> {
        let image = match self {
            Self::Gpu(gpu) => {
                let uploaded = gpu.upload(scene)?;
                gpu.render(&uploaded, frame, width, height)?.linear
            }
            Self::Cpu => twin::render(scene, frame, width, height)?,
        };
        Ok(Image {
            width,
            height,
            pixels: image.pixels,
            variance: None,
        })
    }
}
