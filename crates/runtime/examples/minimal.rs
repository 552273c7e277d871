//! The smallest program that draws a scene asset under an environment asset, with its own device:
//!
//!     cargo run --release -p relight-runtime --example minimal SCENE.relight ENV.relight OUT.png

use std::path::Path;

use relight_format::{Limits, read_environment, read_scene};
use relight_runtime::{EnvironmentLight, Frame, Options, Renderer, offscreen, wgpu};

const SIZE: [u32; 2] = [400, 300];

/// Draws and saves one picture.
pub fn run(
    scene: &Path,
    environment: &Path,
    picture: &Path,
) -> Result<(), Box<dyn std::error::Error>> {
    let scene = read_scene(&std::fs::read(scene)?, &Limits::default())?;
    let environment = read_environment(&std::fs::read(environment)?, &Limits::default())?;

    // What an app has already: a device, a queue and something to draw into.
    let instance = wgpu::Instance::new(wgpu::InstanceDescriptor::new_without_display_handle());
    let adapter =
        pollster::block_on(instance.request_adapter(&wgpu::RequestAdapterOptions::default()))?;
    let (device, queue) =
        pollster::block_on(adapter.request_device(&wgpu::DeviceDescriptor::default()))?;
    let target = device.create_texture(&wgpu::TextureDescriptor {
        label: None,
        size: wgpu::Extent3d {
            width: SIZE[0],
            height: SIZE[1],
            depth_or_array_layers: 1,
        },
        mip_level_count: 1,
        sample_count: 1,
        dimension: wgpu::TextureDimension::D2,
        format: wgpu::TextureFormat::Rgba8Unorm,
        usage: wgpu::TextureUsages::RENDER_ATTACHMENT | wgpu::TextureUsages::COPY_SRC,
        view_formats: &[],
    });

    // Once.
    let mut renderer = Renderer::new(&device, &queue, Options::default())?;
    let uploaded = renderer.upload(&scene)?;
    let light = EnvironmentLight::new(&environment);

    // Every frame.
    let camera = scene.camera.ok_or("the scene has no camera")?;
    let frame = Frame {
        rotation: glam::Quat::from_rotation_y(0.5),
        antialias: true,
        ..Frame::under(camera, &light)
    };
    let view = target.create_view(&wgpu::TextureViewDescriptor::default());
    let mut encoder = device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
    renderer.render(&mut encoder, &uploaded, &frame, &view, SIZE)?;
    queue.submit([encoder.finish()]);

    // Colours are multiplied by coverage: over white, add as much white as is not covered.
    let mut bytes = offscreen::read_texture(&device, &queue, &target)?;
    for pixel in bytes.chunks_exact_mut(4) {
        let white = 255 - pixel[3];
        for value in pixel {
            *value = value.saturating_add(white);
        }
    }
    image::save_buffer(picture, &bytes, SIZE[0], SIZE[1], image::ColorType::Rgba8)?;
    println!("{} on {}", picture.display(), adapter.get_info().name);
    Ok(())
}

#[allow(dead_code, reason = "tests call `run`")]
fn main() -> Result<(), Box<dyn std::error::Error>> {
    let paths: Vec<String> = std::env::args().skip(1).collect();
    let [scene, environment, picture] = &paths[..] else {
        return Err("usage: minimal SCENE.relight ENVIRONMENT.relight PICTURE.png".into());
    };
    run(scene.as_ref(), environment.as_ref(), picture.as_ref())
}
