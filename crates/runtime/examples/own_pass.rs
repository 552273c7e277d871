//! A baked scene among an app's own objects, in the app's own render pass: its camera, its reversed
//! depth, its four samples. What it takes is in `support/in_your_pass.rs`, the rest is the app.
//!
//!     cargo run --release -p relight-runtime --example own_pass SCENE.relight ENV.relight OUT.png

use std::error::Error;
use std::path::Path;

use glam::{Mat4, Vec3, camera::rh};
use relight_runtime::{Options, Renderer, wgpu};

#[path = "support/in_your_pass.rs"]
mod in_your_pass;
mod support;

use in_your_pass::Relit;

const SIZE: [u32; 2] = [400, 300];

/// The app's own objects: two bars, one behind and one before the middle of the scene.
const BARS: &str = "
@group(0) @binding(0) var<uniform> clip: mat4x4<f32>;
struct Corner { @builtin(position) position: vec4<f32>, @location(0) color: vec3<f32> }
@vertex fn bar(@builtin(vertex_index) corner: u32, @builtin(instance_index) bar: u32) -> Corner {
    let side = select(-1.0, 1.0, bar == 1u);
    let x = 0.25 * side + 0.12 * (f32(corner % 2u) - 0.5);
    let at = vec3(x, 2.0 * f32(corner / 2u), 0.8 * side);
    return Corner(clip * vec4(at, 1.0), vec3(0.02, 0.3 + 0.2 * side, 0.6));
}
@fragment fn paint(corner: Corner) -> @location(0) vec4<f32> { return vec4(corner.color, 1.0); }
";

/// Draws and saves one picture.
pub fn run(scene: &Path, environment: &Path, picture: &Path) -> Result<(), Box<dyn Error>> {
    let (device, queue) = support::device()?;
    let look = rh::view::look_at_mat4(Vec3::new(1.2, 1.6, 3.2), 0.6 * Vec3::Y, Vec3::Y);
    let aspect = SIZE[0] as f32 / SIZE[1] as f32;
    let projection = rh::proj::directx::perspective_infinite_reverse(0.8, aspect, 0.05);
    let options = Options {
        target_format: wgpu::TextureFormat::Rgba8UnormSrgb,
        depth_stencil: Some(wgpu::DepthStencilState {
            format: wgpu::TextureFormat::Depth32Float,
            depth_write_enabled: Some(true),
            depth_compare: Some(wgpu::CompareFunction::Greater), // Less: not reversed
            stencil: wgpu::StencilState::default(),
            bias: wgpu::DepthBiasState::default(),
        }),
        multisample: wgpu::MultisampleState {
            count: 4,
            ..Default::default()
        },
        ..Options::default()
    };
    let renderer = Renderer::new(&device, &queue, options)?;
    let [scene, environment] = [std::fs::read(scene)?, std::fs::read(environment)?];
    let mut relit = Relit::new(&renderer, SIZE, [&scene, &environment])?;
    let mut encoder = device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
    relit.prepare(&renderer, &mut encoder, [look, projection])?;

    let options = renderer.options();
    let (bars, clip) = bars(&device, options, projection * look);
    let attachment = |format, samples| support::attachment(&device, SIZE, format, samples);
    let [color, resolved] = [4, 1].map(|samples| attachment(options.target_format, samples));
    let depth = attachment(wgpu::TextureFormat::Depth32Float, 4);
    let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
        color_attachments: &[Some(wgpu::RenderPassColorAttachment {
            view: &support::whole(&color),
            depth_slice: None,
            resolve_target: Some(&support::whole(&resolved)),
            ops: support::clear(wgpu::Color::WHITE),
        })],
        depth_stencil_attachment: Some(wgpu::RenderPassDepthStencilAttachment {
            view: &support::whole(&depth),
            // Cleared to 0, the farthest of reversed depth.
            depth_ops: Some(wgpu::Operations::default()),
            stencil_ops: None,
        }),
        ..Default::default()
    });
    pass.set_pipeline(&bars);
    pass.set_bind_group(0, &clip, &[]);
    pass.draw(0..4, 0..2);
    relit.draw(&renderer, &mut pass)?;
    drop(pass);
    queue.submit([encoder.finish()]);
    support::save(&device, &queue, &resolved, picture)
}

/// The app's pipeline and its matrix.
fn bars(
    device: &wgpu::Device,
    options: &Options,
    clip: Mat4,
) -> (wgpu::RenderPipeline, wgpu::BindGroup) {
    use wgpu::util::DeviceExt as _;
    let module = device.create_shader_module(wgpu::ShaderModuleDescriptor {
        label: Some("bars"),
        source: wgpu::ShaderSource::Wgsl(BARS.into()),
    });
    let pipeline = device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
        label: Some("bars"),
        layout: None,
        vertex: wgpu::VertexState {
            module: &module,
            entry_point: None,
            compilation_options: wgpu::PipelineCompilationOptions::default(),
            buffers: &[],
        },
        fragment: Some(wgpu::FragmentState {
            module: &module,
            entry_point: None,
            compilation_options: wgpu::PipelineCompilationOptions::default(),
            targets: &[Some(options.target_format.into())],
        }),
        primitive: wgpu::PrimitiveState {
            topology: wgpu::PrimitiveTopology::TriangleStrip,
            ..Default::default()
        },
        depth_stencil: options.depth_stencil.clone(),
        multisample: options.multisample,
        multiview_mask: None,
        cache: None,
    });
    let uniform = device.create_buffer_init(&wgpu::util::BufferInitDescriptor {
        label: None,
        contents: bytemuck::bytes_of(&clip),
        usage: wgpu::BufferUsages::UNIFORM,
    });
    let group = device.create_bind_group(&wgpu::BindGroupDescriptor {
        label: Some("bars"),
        layout: &pipeline.get_bind_group_layout(0),
        entries: &[wgpu::BindGroupEntry {
            binding: 0,
            resource: uniform.as_entire_binding(),
        }],
    });
    (pipeline, group)
}

#[allow(dead_code, reason = "tests call `run`")]
fn main() -> Result<(), Box<dyn Error>> {
    let [scene, environment, picture] = support::paths()?;
    run(&scene, &environment, &picture)
}
