//! Shaded pixels into an app's render pass.

use relight_shading::gpu;
use relight_shading::wgsl::{Entry, source};

use crate::options::Encoding;
use crate::resources::Slot;
use crate::view::Images;
use crate::{Error, Options, Renderer};

/// What drawing a view takes, kept from frame to frame.
#[derive(Debug, Default)]
pub(crate) struct Drawing {
    uniform: Slot,
    group: Option<wgpu::BindGroup>,
}

impl Drawing {
    /// Lets go of the buffers, so that what is recorded already keeps what it was recorded with.
    pub(crate) fn renew(&mut self) {
        *self = Self::default();
    }

    pub(crate) fn fill(
        &mut self,
        renderer: &Renderer,
        layout: &wgpu::BindGroupLayout,
        images: &Images,
        uniform: gpu::Composite,
    ) -> Result<(), Error> {
        let bytes = bytemuck::bytes_of(&uniform);
        let usage = wgpu::BufferUsages::UNIFORM;
        let new = (self.uniform).fill(renderer, "relight composite", bytes, usage)?;
        if new || self.group.is_none() {
            let view = wgpu::BindingResource::TextureView;
            let resources = [
                self.uniform.buffer().as_entire_binding(),
                view(&images.radiance_view),
                view(&images.shown_view),
                view(&images.depth_view),
            ];
            let entries: Vec<_> = (0..)
                .zip(resources)
                .map(|(binding, resource)| wgpu::BindGroupEntry { binding, resource })
                .collect();
            let device = renderer.device();
            self.group = Some(device.create_bind_group(&wgpu::BindGroupDescriptor {
                label: Some("relight composite"),
                layout,
                entries: &entries,
            }));
        }
        Ok(())
    }

    /// Its images were replaced.
    pub(crate) fn forget_images(&mut self) {
        self.group = None;
    }

    pub(crate) fn group(&self) -> Option<&wgpu::BindGroup> {
        self.group.as_ref()
    }
}

/// Group 0 of composite.wgsl, for pixels of one surface or of several.
pub(crate) fn layout(device: &wgpu::Device, surfaces: bool) -> wgpu::BindGroupLayout {
    let uniform = wgpu::BindingType::Buffer {
        ty: wgpu::BufferBindingType::Uniform,
        has_dynamic_offset: false,
        min_binding_size: None,
    };
    let texture = |sample_type| wgpu::BindingType::Texture {
        sample_type,
        view_dimension: wgpu::TextureViewDimension::D2,
        multisampled: surfaces && sample_type == wgpu::TextureSampleType::Depth,
    };
    // 32-bit floats cannot be filtered at default limits, and are not.
    let radiance = texture(wgpu::TextureSampleType::Float { filterable: false });
    let bindings = [
        (uniform, wgpu::ShaderStages::VERTEX_FRAGMENT),
        (radiance, wgpu::ShaderStages::FRAGMENT),
        (
            texture(wgpu::TextureSampleType::Uint),
            wgpu::ShaderStages::FRAGMENT,
        ),
        (
            texture(wgpu::TextureSampleType::Depth),
            wgpu::ShaderStages::FRAGMENT,
        ),
    ];
    let entries: Vec<_> = (0..)
        .zip(bindings)
        .map(|(binding, (ty, visibility))| wgpu::BindGroupLayoutEntry {
            binding,
            visibility,
            ty,
            count: None,
        })
        .collect();
    device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
        label: Some("relight composite"),
        entries: &entries,
    })
}

/// Draws into passes as `options` describe them.
pub(crate) fn pipeline(
    device: &wgpu::Device,
    layout: &wgpu::BindGroupLayout,
    options: &Options,
    surfaces: bool,
) -> wgpu::RenderPipeline {
    let entry = if surfaces {
        Entry::CompositeSurfaces
    } else {
        Entry::Composite
    };
    let module = device.create_shader_module(wgpu::ShaderModuleDescriptor {
        label: Some("relight composite"),
        source: wgpu::ShaderSource::Wgsl(source(entry).into()),
    });
    let layout = device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
        label: Some("relight composite"),
        bind_group_layouts: &[Some(layout)],
        immediate_size: 0,
    });
    let samples = surfaces && options.multisample.count == 4;
    let fragment = match (&options.depth_stencil, samples) {
        (Some(_), false) => "composite_depth_fragment",
        (None, false) => "composite_fragment",
        (Some(_), true) => "composite_sample_depth_fragment",
        (None, true) => "composite_sample_fragment",
    };
    device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
        label: Some("relight composite"),
        layout: Some(&layout),
        vertex: wgpu::VertexState {
            module: &module,
            entry_point: Some("composite_vertex"),
            compilation_options: wgpu::PipelineCompilationOptions::default(),
            buffers: &[],
        },
        primitive: wgpu::PrimitiveState::default(),
        depth_stencil: options.depth_stencil.clone(),
        multisample: options.multisample,
        fragment: Some(wgpu::FragmentState {
            module: &module,
            entry_point: Some(fragment),
            compilation_options: wgpu::PipelineCompilationOptions::default(),
            targets: &[Some(wgpu::ColorTargetState {
                format: options.target_format,
                blend: options.blend,
                write_mask: wgpu::ColorWrites::ALL,
            })],
        }),
        multiview_mask: None,
        cache: None,
    })
}

/// The uniforms of a frame.
pub(crate) fn uniform(
    [width, height]: [u32; 2],
    exposure: f32,
    encoding: Encoding,
    flipped_depth: bool,
) -> gpu::Composite {
    gpu::Composite {
        size: [width as f32, height as f32],
        exposure,
        encoding: encoding as u32,
        flipped_depth: u32::from(flipped_depth),
        reserved: 0,
    }
}
