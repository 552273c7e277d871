//! Shares its device, queue, encoder and target with other rendering: a sky of the app's own, and
//! the scene over it, in windows of two sizes as after a resize. Writes a PNG of each.
//!
//!     cargo run --release -p relight-runtime --example shared SCENE.relight ENV.relight

use relight_format::{Limits, read_environment, read_scene};
use relight_runtime::offscreen::Gpu;
use relight_runtime::{Frame, Prefiltered, Sources, wgpu};

/// The app's own rendering: a sky, and a picture over it where the picture covers.
const SHADER: &str = "
@group(0) @binding(0) var picture: texture_2d<f32>;

@vertex
fn corner(@builtin(vertex_index) index: u32) -> @builtin(position) vec4<f32> {
    return vec4(f32(index % 2u) * 4.0 - 1.0, f32(index / 2u) * 4.0 - 1.0, 0.0, 1.0);
}

@fragment
fn sky_with_picture(@builtin(position) at: vec4<f32>) -> @location(0) vec4<f32> {
    let size = vec2<f32>(textureDimensions(picture));
    let sky = mix(vec3(0.25, 0.45, 0.8), vec3(0.85, 0.9, 0.95), at.y / size.y);
    let over = textureLoad(picture, vec2<u32>(at.xy), 0);
    return vec4(mix(sky, over.rgb, over.a), 1.0);
}
";

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let paths: Vec<String> = std::env::args().skip(1).collect();
    let [scene, environment] = &paths[..] else {
        return Err("usage: shared SCENE.relight ENVIRONMENT.relight".into());
    };
    let scene = read_scene(&std::fs::read(scene)?, &Limits::default())?;
    let environment = read_environment(&std::fs::read(environment)?, &Limits::default())?;
    let lights: Vec<_> = environment.lobes.iter().map(Into::into).collect();
    let camera = scene.camera.ok_or("the scene has no camera")?;
    let image = Prefiltered::new(&environment.prefiltered, &lights);
    let sources = Sources::new(&environment);

    let mut gpu = Gpu::new(&wgpu::Limits::default())?;
    let uploaded = gpu.upload(&scene)?;
    let pipeline = sky_pipeline(&gpu.device, gpu.renderer.options().target_format);
    for (number, size) in [[480, 320], [320, 400]].into_iter().enumerate() {
        let frame = Frame {
            reflections: image.as_ref(),
            sources: sources.as_ref(),
            rotation: glam::Quat::from_rotation_y(0.7 * number as f32),
            ..Frame::new(camera, &lights)
        };
        let [picture, window] = [(); 2].map(|()| target(&gpu, size));
        let view = picture.create_view(&wgpu::TextureViewDescriptor::default());
        let mut encoder = gpu
            .device
            .create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        gpu.renderer
            .render(&mut encoder, &uploaded, &frame, &view, size)?;
        draw_sky(&gpu.device, &mut encoder, &pipeline, &view, &window);
        gpu.queue.submit([encoder.finish()]);
        let path = format!("shared-{number}.png");
        let bytes = gpu.read_texture(&window)?;
        image::save_buffer(&path, &bytes, size[0], size[1], image::ColorType::Rgba8)?;
        println!("{path}: {}x{} on {}", size[0], size[1], gpu.name());
    }
    Ok(())
}

fn target(gpu: &Gpu, [width, height]: [u32; 2]) -> wgpu::Texture {
    gpu.device.create_texture(&wgpu::TextureDescriptor {
        label: None,
        size: wgpu::Extent3d {
            width,
            height,
            depth_or_array_layers: 1,
        },
        mip_level_count: 1,
        sample_count: 1,
        dimension: wgpu::TextureDimension::D2,
        format: gpu.renderer.options().target_format,
        usage: wgpu::TextureUsages::RENDER_ATTACHMENT
            | wgpu::TextureUsages::TEXTURE_BINDING
            | wgpu::TextureUsages::COPY_SRC,
        view_formats: &[],
    })
}

fn sky_pipeline(device: &wgpu::Device, format: wgpu::TextureFormat) -> wgpu::RenderPipeline {
    let module = device.create_shader_module(wgpu::ShaderModuleDescriptor {
        label: Some("sky"),
        source: wgpu::ShaderSource::Wgsl(SHADER.into()),
    });
    device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
        label: Some("sky"),
        layout: None,
        vertex: wgpu::VertexState {
            module: &module,
            entry_point: Some("corner"),
            compilation_options: wgpu::PipelineCompilationOptions::default(),
            buffers: &[],
        },
        fragment: Some(wgpu::FragmentState {
            module: &module,
            entry_point: Some("sky_with_picture"),
            compilation_options: wgpu::PipelineCompilationOptions::default(),
            targets: &[Some(format.into())],
        }),
        primitive: wgpu::PrimitiveState::default(),
        depth_stencil: None,
        multisample: wgpu::MultisampleState::default(),
        multiview_mask: None,
        cache: None,
    })
}

fn draw_sky(
    device: &wgpu::Device,
    encoder: &mut wgpu::CommandEncoder,
    pipeline: &wgpu::RenderPipeline,
    picture: &wgpu::TextureView,
    window: &wgpu::Texture,
) {
    let view = window.create_view(&wgpu::TextureViewDescriptor::default());
    let group = device.create_bind_group(&wgpu::BindGroupDescriptor {
        label: None,
        layout: &pipeline.get_bind_group_layout(0),
        entries: &[wgpu::BindGroupEntry {
            binding: 0,
            resource: wgpu::BindingResource::TextureView(picture),
        }],
    });
    let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
        label: Some("sky"),
        color_attachments: &[Some(wgpu::RenderPassColorAttachment {
            view: &view,
            depth_slice: None,
            resolve_target: None,
            ops: wgpu::Operations::default(),
        })],
        ..Default::default()
    });
    pass.set_pipeline(pipeline);
    pass.set_bind_group(0, &group, &[]);
    pass.draw(0..3, 0..1);
}
