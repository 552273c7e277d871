//! Shaded pixels into an app's render pass.

use std::sync::OnceLock;

use relight_shading::gpu;
use relight_shading::wgsl::{Entry, source};

use crate::images::Images;
use crate::transfer::Slot;
use crate::{Error, Frame, Options, Renderer, background};

/// What drawing a view takes, kept from frame to frame.
#[derive(Debug, Default)]
pub(crate) struct Drawing {
    uniform: Slot,
    /// The background's image, and the group that has it.
    group: Option<(wgpu::TextureView, wgpu::BindGroup)>,
    /// Whether there is a background.
    has_background: bool,
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
        image: &wgpu::TextureView,
        uniform: gpu::Composite,
    ) -> Result<(), Error> {
        let bytes = bytemuck::bytes_of(&uniform);
        let usage = wgpu::BufferUsages::UNIFORM;
        let new = (self.uniform).fill(renderer, "relight composite", bytes, 0, usage)?;
        self.has_background = uniform.background != gpu::BACKGROUND_NONE;
        if new || self.group.as_ref().is_none_or(|(of, _)| of != image) {
            let view = wgpu::BindingResource::TextureView;
            let resources = [
                self.uniform.buffer().as_entire_binding(),
                view(&images.radiance_view),
                view(&images.shown_view),
                view(&images.depth_view),
                view(image),
                view(
                    images
                        .open
                        .as_ref()
                        .map_or(&images.radiance_view, |open| &open.view),
                ),
            ];
            let entries: Vec<_> = (0..)
                .zip(resources)
                .map(|(binding, resource)| wgpu::BindGroupEntry { binding, resource })
                .collect();
            let device = renderer.device();
            let group = device.create_bind_group(&wgpu::BindGroupDescriptor {
                label: Some("relight composite"),
                layout,
                entries: &entries,
            });
            self.group = Some((image.clone(), group));
        }
        Ok(())
    }

    /// Its images were replaced.
    pub(crate) fn forget_images(&mut self) {
        self.group = None;
    }

    pub(crate) fn group(&self) -> Option<&wgpu::BindGroup> {
        self.group.as_ref().map(|(_, group)| group)
    }

    pub(crate) fn has_background(&self) -> bool {
        self.has_background
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
        (
            texture(wgpu::TextureSampleType::Uint),
            wgpu::ShaderStages::FRAGMENT,
        ),
        (radiance, wgpu::ShaderStages::FRAGMENT),
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

/// Pipelines into passes of one kind.
#[derive(Debug)]
pub(crate) struct Pipelines {
    device: wgpu::Device,
    layout: wgpu::BindGroupLayout,
    options: Options,
    surfaces: bool,
    /// What instances cover.
    pixels: wgpu::RenderPipeline,
    /// What is behind them; made when first needed.
    background: OnceLock<wgpu::RenderPipeline>,
}

impl Pipelines {
    /// Into passes as `options` describe them.
    pub(crate) fn new(
        device: &wgpu::Device,
        layout: &wgpu::BindGroupLayout,
        options: Options,
        surfaces: bool,
    ) -> Self {
        Self {
            pixels: pipeline(device, layout, &options, surfaces, false),
            background: OnceLock::new(),
            device: device.clone(),
            layout: layout.clone(),
            options,
            surfaces,
        }
    }

    fn background(&self) -> &wgpu::RenderPipeline {
        self.background.get_or_init(|| {
            pipeline(
                &self.device,
                &self.layout,
                &self.options,
                self.surfaces,
                true,
            )
        })
    }

    /// Makes what [`Self::draw`] takes.
    pub(crate) fn prepare(&self, drawing: &Drawing) {
        if drawing.has_background() {
            self.background();
        }
    }

    /// Draws all that a view was prepared with.
    pub(crate) fn draw(&self, pass: &mut wgpu::RenderPass, drawing: &Drawing) {
        pass.set_bind_group(0, drawing.group(), &[]);
        if drawing.has_background() {
            pass.set_pipeline(self.background());
            pass.draw(0..3, 0..1);
        }
        pass.set_pipeline(&self.pixels);
        pass.draw(0..3, 0..1);
    }
}

/// Depth of passes as the background takes part in it: as far away as can be, where nothing else is.
fn behind(depth: &wgpu::DepthStencilState) -> wgpu::DepthStencilState {
    use wgpu::CompareFunction as C;
    wgpu::DepthStencilState {
        depth_write_enabled: Some(false),
        depth_compare: depth.depth_compare.map(|compare| match compare {
            C::Greater => C::GreaterEqual,
            C::Less => C::LessEqual,
            other => other,
        }),
        ..depth.clone()
    }
}

fn pipeline(
    device: &wgpu::Device,
    layout: &wgpu::BindGroupLayout,
    options: &Options,
    surfaces: bool,
    background: bool,
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
    let fragment = match (&options.depth_stencil, surfaces, samples) {
        _ if background => "background_fragment",
        (Some(_), false, _) => "composite_depth_fragment",
        (None, false, _) => "composite_fragment",
        (Some(_), true, false) => "composite_surfaces_depth_fragment",
        (None, true, false) => "composite_surfaces_fragment",
        (Some(_), true, true) => "composite_sample_depth_fragment",
        (None, true, true) => "composite_sample_fragment",
    };
    let (vertex, depth_stencil) = if background {
        (
            "background_vertex",
            options.depth_stencil.as_ref().map(behind),
        )
    } else {
        ("composite_vertex", options.depth_stencil.clone())
    };
    let constants = [(
        "COMPOSITE_MIXES",
        f64::from(u8::from(options.blend.is_none())),
    )];
    device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
        label: Some("relight composite"),
        layout: Some(&layout),
        vertex: wgpu::VertexState {
            module: &module,
            entry_point: Some(vertex),
            compilation_options: wgpu::PipelineCompilationOptions::default(),
            buffers: &[],
        },
        primitive: wgpu::PrimitiveState::default(),
        depth_stencil,
        multisample: options.multisample,
        fragment: Some(wgpu::FragmentState {
            module: &module,
            entry_point: Some(fragment),
            compilation_options: wgpu::PipelineCompilationOptions {
                constants: if background { &[] } else { &constants },
                ..Default::default()
            },
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

/// The uniforms of a frame as `options` draw it, the world seen in `world`.
pub(crate) fn uniform(
    [width, height]: [u32; 2],
    frame: &Frame,
    world: &relight_shading::camera::View,
    options: &Options,
) -> gpu::Composite {
    gpu::Composite {
        size: [width as f32, height as f32],
        encoding: options.output.encoding(options.target_format) as u32,
        ..background::uniform(frame, world)
    }
}
