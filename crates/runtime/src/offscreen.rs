//! A device and renderer for tools and tests, which have neither window nor device.

use relight_format::Scene;
use relight_shading::catcher;
use relight_shading::surfaces::{SAMPLES, TILE};

use crate::transfer::read_buffer;
use crate::{Error, Frame, GpuScene, Image, Options, Renderer, View};

/// A graphics device of its own with a renderer.
#[derive(Debug)]
pub struct Gpu {
    /// The device.
    pub device: wgpu::Device,
    /// Its queue.
    pub queue: wgpu::Queue,
    /// The renderer; its targets are RGBA8, sRGB-encoded by the renderer.
    pub renderer: Renderer,
    adapter: wgpu::AdapterInfo,
}

/// One frame read back.
#[derive(Clone, Debug, PartialEq)]
pub struct Picture {
    /// Linear radiance, not exposed.
    pub linear: Image,
    /// Tone-mapped sRGB RGBA8, row 0 first; colours are not multiplied by coverage.
    pub display: Vec<u8>,
}

impl Gpu {
    /// Opens the most capable adapter that offers `limits`: a graphics card before an
    /// integrated one before a software one.
    pub fn new(limits: &wgpu::Limits) -> Result<Self, Error> {
        pollster::block_on(Self::open(limits))
    }

    async fn open(limits: &wgpu::Limits) -> Result<Self, Error> {
        let instance = wgpu::Instance::new(wgpu::InstanceDescriptor::new_without_display_handle());
        let adapters = instance.enumerate_adapters(wgpu::Backends::PRIMARY).await;
        let found = adapters
            .iter()
            .map(|adapter| adapter.get_info().name)
            .collect();
        let adapter = adapters
            .into_iter()
            .filter(|adapter| limits.check_limits(&adapter.limits()))
            .min_by_key(|adapter| match adapter.get_info().device_type {
                wgpu::DeviceType::DiscreteGpu => 0,
                wgpu::DeviceType::IntegratedGpu => 1,
                wgpu::DeviceType::VirtualGpu => 2,
                wgpu::DeviceType::Other => 3,
                wgpu::DeviceType::Cpu => 4,
            })
            .ok_or(Error::NoAdapter { found })?;
        let (device, queue) = adapter
            .request_device(&wgpu::DeviceDescriptor {
                label: Some("relight offscreen"),
                // For [`Renderer::pass_times`] and [`Renderer::set_texture`], where there are any.
                required_features: adapter.features()
                    & (wgpu::Features::TIMESTAMP_QUERY | wgpu::Features::TEXTURE_COMPRESSION_BC),
                required_limits: limits.clone(),
                ..Default::default()
            })
            .await?;
        let renderer = Renderer::new(&device, &queue, Options::default())?;
        Ok(Self {
            device,
            queue,
            renderer,
            adapter: adapter.get_info(),
        })
    }

    /// Name of the adapter, as its driver gives it.
    pub fn name(&self) -> &str {
        &self.adapter.name
    }

    /// Whether it is a program on the processor that is drawn with.
    pub fn is_software(&self) -> bool {
        self.adapter.device_type == wgpu::DeviceType::Cpu
    }

    /// Copies a scene to the GPU.
    pub fn upload(&self, scene: &Scene) -> Result<GpuScene, Error> {
        let guard = self.device.push_error_scope(wgpu::ErrorFilter::OutOfMemory);
        let uploaded = self.renderer.upload(scene);
        check(guard)?;
        uploaded
    }

    /// Draws one frame and waits for it.
    pub fn render(
        &mut self,
        scene: &GpuScene,
        frame: &Frame,
        width: u32,
        height: u32,
    ) -> Result<Picture, Error> {
        self.renderer.check_size(width, height)?;
        let guard = self.device.push_error_scope(wgpu::ErrorFilter::OutOfMemory);
        let target = self.target([width, height]);
        let view = target.create_view(&wgpu::TextureViewDescriptor::default());
        let mut encoder = self
            .device
            .create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        self.renderer
            .render(&mut encoder, scene, frame, &view, [width, height])?;
        self.queue.submit([encoder.finish()]);
        check(guard)?;
        let view = self.renderer.own_view().expect("a frame was recorded");
        let pixels = self.read_radiance(view)?;
        let mut display = self.read_texture(&target)?;
        if frame.antialias && target.format().block_copy_size(None) == Some(4) {
            display.chunks_exact_mut(4).for_each(divide_by_coverage);
        }
        Ok(Picture {
            linear: Image {
                width,
                height,
                pixels,
            },
            display,
        })
    }

    /// A texture to draw into with the renderer. The size is one that the device can have.
    pub fn target(&self, [width, height]: [u32; 2]) -> wgpu::Texture {
        self.device.create_texture(&wgpu::TextureDescriptor {
            label: Some("relight offscreen target"),
            size: wgpu::Extent3d {
                width,
                height,
                depth_or_array_layers: 1,
            },
            mip_level_count: 1,
            sample_count: 1,
            dimension: wgpu::TextureDimension::D2,
            format: self.renderer.options().target_format,
            usage: wgpu::TextureUsages::RENDER_ATTACHMENT | wgpu::TextureUsages::COPY_SRC,
            view_formats: &[],
        })
    }

    /// The linear radiance of the last frame that a view was prepared with, row 0 first; of a pixel
    /// that was antialiased the mean of its samples, alpha their coverage.
    pub fn read_radiance(&self, view: &View) -> Result<Vec<[f32; 4]>, Error> {
        let radiance = view.radiance().ok_or(Error::NotPrepared)?;
        let mut texels: Vec<[f32; 4]> = bytemuck::pod_collect_to_vec(&self.read_texture(radiance)?);
        if let Some(open) = view.open_radiance() {
            let open: Vec<[f32; 4]> = bytemuck::pod_collect_to_vec(&self.read_texture(open)?);
            for (shaded, open) in texels.iter_mut().zip(&open) {
                *shaded = catcher::caught(*shaded, *open);
            }
        }
        let Some(surfaces) = view.surfaces() else {
            return Ok(texels);
        };
        let shown: Vec<u32> = bytemuck::pod_collect_to_vec(&self.read_texture(surfaces)?);
        let row = radiance.width();
        let [width, height] = view.size();
        let tiles = height.next_multiple_of(TILE);
        let mean = |(index, shown): (u32, &u32)| {
            let (x, y) = (index % width, index / width);
            let mut sum = glam::Vec4::ZERO;
            for sample in 0..SAMPLES {
                let place = match shown >> (3 * sample) & 7 {
                    0 => continue,
                    1 => y * row + x,
                    number => {
                        let slot = (shown >> 12) + number - 2;
                        let column = x / TILE * TILE + slot % TILE;
                        (tiles + y / TILE * (TILE / 2) + slot / TILE) * row + column
                    }
                };
                sum += glam::Vec4::from(texels[place as usize]);
            }
            (sum / SAMPLES as f32).to_array()
        };
        Ok((0..).zip(&shown).map(mean).collect())
    }

    /// [`read_texture`] on this device.
    pub fn read_texture(&self, texture: &wgpu::Texture) -> Result<Vec<u8>, Error> {
        read_texture(&self.device, &self.queue, texture)
    }

    /// Reads a `MAP_READ` buffer once all submitted work is done.
    pub fn read_buffer(&self, buffer: &wgpu::Buffer) -> Result<Vec<u8>, Error> {
        read_buffer(&self.device, buffer)
    }
}

/// Copies a texture without mip levels or layers back and waits for it: its rows, without padding.
/// It was made with [`wgpu::TextureUsages::COPY_SRC`].
pub fn read_texture(
    device: &wgpu::Device,
    queue: &wgpu::Queue,
    texture: &wgpu::Texture,
) -> Result<Vec<u8>, Error> {
    let texel = texture.format().block_copy_size(None).unwrap_or(4);
    let row = texture.width() * texel;
    let padded = row.next_multiple_of(wgpu::COPY_BYTES_PER_ROW_ALIGNMENT);
    let buffer = device.create_buffer(&wgpu::BufferDescriptor {
        label: Some("relight read back"),
        size: u64::from(padded) * u64::from(texture.height()),
        usage: wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::MAP_READ,
        mapped_at_creation: false,
    });
    let mut encoder = device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
    encoder.copy_texture_to_buffer(
        texture.as_image_copy(),
        wgpu::TexelCopyBufferInfo {
            buffer: &buffer,
            layout: wgpu::TexelCopyBufferLayout {
                offset: 0,
                bytes_per_row: Some(padded),
                rows_per_image: None,
            },
        },
        texture.size(),
    );
    queue.submit([encoder.finish()]);
    let bytes = read_buffer(device, &buffer)?;
    Ok(bytes
        .chunks(padded as usize)
        .flat_map(|line| &line[..row as usize])
        .copied()
        .collect())
}

/// Undoes the multiplication by coverage of an RGBA8 pixel.
fn divide_by_coverage(pixel: &mut [u8]) {
    let coverage = u16::from(pixel[3]);
    for value in &mut pixel[..3] {
        let whole = (u16::from(*value) * 255 + coverage / 2).checked_div(coverage);
        *value = whole.unwrap_or(0).min(255) as u8;
    }
}

/// The error that a scope caught, if any.
fn check(guard: wgpu::ErrorScopeGuard) -> Result<(), Error> {
    match pollster::block_on(guard.pop()) {
        Some(error) => Err(Error::DeviceFailed(error.to_string())),
        None => Ok(()),
    }
}
