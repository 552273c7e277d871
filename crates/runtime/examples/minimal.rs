//! Draws a scene asset under an environment asset into a texture of the app's own device:
//!
//!     cargo run --release -p relight-runtime --example minimal SCENE.relight ENV.relight

use relight_format::{Limits, read_environment, read_scene};
use relight_runtime::{Frame, Options, Renderer, Sources, wgpu};

const SIZE: [u32; 2] = [400, 300];

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let paths: Vec<String> = std::env::args().skip(1).collect();
    let [scene, environment] = &paths[..] else {
        return Err("usage: minimal SCENE.relight ENVIRONMENT.relight".into());
    };
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
        usage: wgpu::TextureUsages::RENDER_ATTACHMENT,
        view_formats: &[],
    });

    let mut renderer = Renderer::new(&device, &queue, Options::default())?;
    let uploaded = renderer.upload(&scene)?;
    let lights: Vec<_> = environment.lobes.iter().map(Into::into).collect();
    let camera = scene.camera.ok_or("the scene has no camera")?;
    let sources = Sources::new(&environment);
    let frame = Frame {
        sources: sources.as_ref(),
        rotation: glam::Quat::from_rotation_y(0.5),
        ..Frame::new(camera, &lights)
    };
    let start = std::time::Instant::now();
    let view = target.create_view(&wgpu::TextureViewDescriptor::default());
    let mut encoder = device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
    renderer.render(&mut encoder, &uploaded, &frame, &view, SIZE)?;
    queue.submit([encoder.finish()]);
    device.poll(wgpu::PollType::wait_indefinitely())?;
    println!("{:?} on {}", start.elapsed(), adapter.get_info().name);
    Ok(())
}
