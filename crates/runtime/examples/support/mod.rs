//! What the app of every example has already: files, a device, textures to draw into.
#![allow(dead_code, reason = "no example needs all of it")]

use std::error::Error;
use std::path::{Path, PathBuf};

use relight_format::{Environment, Limits, Scene, read_environment, read_scene};
use relight_runtime::{offscreen, wgpu};

/// Scene, environment and picture, as the command line has them.
pub fn paths() -> Result<[PathBuf; 3], Box<dyn Error>> {
    let paths: Vec<PathBuf> = std::env::args_os().skip(1).map(PathBuf::from).collect();
    <[PathBuf; 3]>::try_from(paths)
        .map_err(|_| "usage: SCENE.relight ENVIRONMENT.relight PICTURE.png".into())
}

/// Reads both assets.
pub fn read(scene: &Path, environment: &Path) -> Result<(Scene, Environment), Box<dyn Error>> {
    let limits = Limits::default();
    Ok((
        read_scene(&std::fs::read(scene)?, &limits)?,
        read_environment(&std::fs::read(environment)?, &limits)?,
    ))
}

/// A device at WebGPU's default limits, without features.
pub fn device() -> Result<(wgpu::Device, wgpu::Queue), Box<dyn Error>> {
    let instance = wgpu::Instance::new(wgpu::InstanceDescriptor::new_without_display_handle());
    let options = wgpu::RequestAdapterOptions::default();
    let adapter = pollster::block_on(instance.request_adapter(&options))?;
    let descriptor = wgpu::DeviceDescriptor::default();
    Ok(pollster::block_on(adapter.request_device(&descriptor))?)
}

/// A texture to draw into; one of one sample can be read back.
pub fn attachment(
    device: &wgpu::Device,
    size: [u32; 2],
    format: wgpu::TextureFormat,
    samples: u32,
) -> wgpu::Texture {
    let mut usage = wgpu::TextureUsages::RENDER_ATTACHMENT;
    if samples == 1 {
        usage |= wgpu::TextureUsages::COPY_SRC;
    }
    device.create_texture(&wgpu::TextureDescriptor {
        label: None,
        size: wgpu::Extent3d {
            width: size[0],
            height: size[1],
            depth_or_array_layers: 1,
        },
        mip_level_count: 1,
        sample_count: samples,
        dimension: wgpu::TextureDimension::D2,
        format,
        usage,
        view_formats: &[],
    })
}

/// Depth that is tested and written.
pub fn depth(
    format: wgpu::TextureFormat,
    compare: wgpu::CompareFunction,
) -> wgpu::DepthStencilState {
    wgpu::DepthStencilState {
        format,
        depth_write_enabled: Some(true),
        depth_compare: Some(compare),
        stencil: wgpu::StencilState::default(),
        bias: wgpu::DepthBiasState::default(),
    }
}

/// All of a texture.
pub fn whole(texture: &wgpu::Texture) -> wgpu::TextureView {
    texture.create_view(&wgpu::TextureViewDescriptor::default())
}

/// Clears a target first.
pub fn clear(color: wgpu::Color) -> wgpu::Operations<wgpu::Color> {
    wgpu::Operations {
        load: wgpu::LoadOp::Clear(color),
        store: wgpu::StoreOp::Store,
    }
}

/// A pass that clears a colour target.
pub fn pass<'a>(
    encoder: &'a mut wgpu::CommandEncoder,
    target: &wgpu::TextureView,
    clear: wgpu::Color,
) -> wgpu::RenderPass<'a> {
    encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
        label: Some("app"),
        color_attachments: &[Some(wgpu::RenderPassColorAttachment {
            view: target,
            depth_slice: None,
            resolve_target: None,
            ops: self::clear(clear),
        })],
        ..Default::default()
    })
}

/// Saves a texture of four bytes per texel as PNG.
pub fn save(
    device: &wgpu::Device,
    queue: &wgpu::Queue,
    texture: &wgpu::Texture,
    picture: &Path,
) -> Result<(), Box<dyn Error>> {
    let bytes = offscreen::read_texture(device, queue, texture)?;
    let (width, height) = (texture.width(), texture.height());
    image::save_buffer(picture, &bytes, width, height, image::ColorType::Rgba8)?;
    println!("{}: {width}x{height}", picture.display());
    Ok(())
}
