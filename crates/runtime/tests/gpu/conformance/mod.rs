//! Stages that every part of Relight builds on, function by function: what shaders compute, what the CPU's twin
//! computes, and what they should.
//!
//! `functions` has an oracle in `f64` for each, with what either may be off by. `visibility` and `reflection` need
//! a scene: there the twin is the oracle, but for decoded SSDFs, which have one of their own; what lobes are off by is a matter of
//! approximation, which the tests of `relight_shading::brdf` bound against the exact models.

pub mod functions;
mod oracle;
pub mod reflection;
pub mod visibility;

use bytemuck::Pod;
use glam::Vec4;
use libtest_mimic::Failed;
use relight_runtime::offscreen::Gpu;
use relight_runtime::wgpu;
use relight_shading::wgsl::{Entry, source};
use wgpu::util::DeviceExt as _;

fn buffer(gpu: &Gpu, contents: &[u8], usage: wgpu::BufferUsages) -> wgpu::Buffer {
    let descriptor = wgpu::util::BufferInitDescriptor {
        label: None,
        contents,
        usage,
    };
    gpu.device.create_buffer_init(&descriptor)
}

fn storage(gpu: &Gpu, contents: &[impl Pod]) -> wgpu::Buffer {
    let contents = bytemuck::cast_slice(contents);
    buffer(gpu, contents, wgpu::BufferUsages::STORAGE)
}

/// Runs a kernel of 64 invocations a workgroup that is appended to the shading library, an invocation for each input,
/// which writes so many answers. Beside `groups` it is bound to the inputs and the answers, bindings 0 and 1 of group 3.
fn run(
    gpu: &Gpu,
    (name, wgsl): (&str, &str),
    groups: &[(u32, &[(u32, wgpu::BindingResource)])],
    inputs: &[impl Pod],
    answers_each: usize,
) -> Result<Vec<Vec4>, Failed> {
    let device = &gpu.device;
    let module = device.create_shader_module(wgpu::ShaderModuleDescriptor {
        label: Some(name),
        source: wgpu::ShaderSource::Wgsl((source(Entry::Library) + wgsl).into()),
    });
    let pipeline = device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
        label: Some(name),
        layout: None,
        module: &module,
        entry_point: Some(name),
        compilation_options: wgpu::PipelineCompilationOptions::default(),
        cache: None,
    });
    let size = (inputs.len() * answers_each * size_of::<Vec4>()) as u64;
    let made = |usage| {
        device.create_buffer(&wgpu::BufferDescriptor {
            label: None,
            size,
            usage,
            mapped_at_creation: false,
        })
    };
    let output = made(wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_SRC);
    let read_back = made(wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::MAP_READ);
    let input = storage(gpu, inputs);
    let own = [
        (0, input.as_entire_binding()),
        (1, output.as_entire_binding()),
    ];
    let mut encoder = device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
    {
        let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default());
        pass.set_pipeline(&pipeline);
        for (index, bindings) in groups.iter().chain(&[(3, &own[..])]) {
            let entries = bindings.iter().cloned();
            let entries =
                entries.map(|(binding, resource)| wgpu::BindGroupEntry { binding, resource });
            let group = device.create_bind_group(&wgpu::BindGroupDescriptor {
                label: None,
                layout: &pipeline.get_bind_group_layout(*index),
                entries: &entries.collect::<Vec<_>>(),
            });
            pass.set_bind_group(*index, &group, &[]);
        }
        pass.dispatch_workgroups((inputs.len() as u32).div_ceil(64), 1, 1);
    }
    encoder.copy_buffer_to_buffer(&output, 0, &read_back, 0, size);
    gpu.queue.submit([encoder.finish()]);
    Ok(bytemuck::pod_collect_to_vec(&gpu.read_buffer(&read_back)?))
}
