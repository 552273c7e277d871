//! The passes of one frame: visibility buffer, shading, tone mapping.

use std::sync::Arc;

use relight_format::Scene;
use relight_shading::gpu::{self, LimitError};
use relight_shading::prefiltered::{self, Prefiltered};
use relight_shading::shade::{self, Method};
use relight_shading::sources;
use relight_shading::wgsl::{Entry, source};
use wgpu::util::DeviceExt as _;

use crate::frame::check_local_lights;
use crate::pass_times::{Pass, PassTimes, Timestamps};
use crate::transfer::filled_buffer;
use crate::upload::{GpuScene, check_storage};
use crate::{Error, Frame};

/// Format of the visibility buffer.
const VISIBILITY_FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::R32Uint;
/// Format of the depth buffer.
const DEPTH_FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::Depth32Float;
/// Format of the linear image.
const RADIANCE_FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::Rgba32Float;
/// Side of a compute workgroup in pixels, as in shade.wgsl.
const WORKGROUP: u32 = 8;
/// Largest alignment of uniform buffer offsets that WebGPU allows a device to ask for.
const UNIFORM_STRIDE: usize = 256;

/// How a renderer is set up.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Options {
    /// Format of the targets that frames are drawn into. Formats that do not encode sRGB
    /// themselves receive encoded colours.
    pub target_format: wgpu::TextureFormat,
    /// Rows shaded per dispatch, rounded up to a multiple of 8: short dispatches keep slow devices
    /// responsive and clear of watchdogs. Default 128.
    pub rows_per_dispatch: u32,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            target_format: wgpu::TextureFormat::Rgba8Unorm,
            rows_per_dispatch: 128,
        }
    }
}

/// Draws scenes with an app's device and queue.
#[derive(Debug)]
pub struct Renderer {
    device: wgpu::Device,
    queue: wgpu::Queue,
    options: Options,
    frame_layout: wgpu::BindGroupLayout,
    scene_layout: wgpu::BindGroupLayout,
    image_layout: wgpu::BindGroupLayout,
    /// Groups 0, 1 and 2 of the pass for sources.
    source_layouts: [wgpu::BindGroupLayout; 3],
    tonemap_layout: wgpu::BindGroupLayout,
    visibility_pipeline: wgpu::RenderPipeline,
    shade_pipeline: wgpu::ComputePipeline,
    /// Made when first asked for: few ask.
    cells_pipeline: std::sync::OnceLock<wgpu::ComputePipeline>,
    /// Made when first needed.
    source_pipeline: std::sync::OnceLock<wgpu::ComputePipeline>,
    tonemap_pipeline: wgpu::RenderPipeline,
    tables: wgpu::Buffer,
    /// The reflected image of the last frame, or one texel.
    prefiltered: (Option<Arc<[u32]>>, wgpu::TextureView),
    images: Option<Images>,
    timestamps: Option<Timestamps>,
}

/// Images between the passes, all of one size.
#[derive(Debug)]
struct Images {
    size: [u32; 2],
    visibility: wgpu::Texture,
    visibility_view: wgpu::TextureView,
    depth_view: wgpu::TextureView,
    radiance: wgpu::Texture,
    radiance_view: wgpu::TextureView,
    bind_group: wgpu::BindGroup,
    /// Group 2 of the pass for sources, if there was one.
    sources: Option<wgpu::BindGroup>,
}

impl Renderer {
    /// Builds the pipelines. The device needs WebGPU's default limits and no features.
    pub fn new(
        device: &wgpu::Device,
        queue: &wgpu::Queue,
        options: Options,
    ) -> Result<Self, Error> {
        check_device(device)?;
        let tables = filled_buffer(
            device,
            "relight tables",
            bytemuck::cast_slice(&shade::gpu_tables()),
            wgpu::BufferUsages::STORAGE,
        )?;
        let frame_layout = frame_layout(device);
        let scene_layout = scene_layout(device);
        let image_layout = image_layout(device);
        let tonemap_layout = tonemap_layout(device);
        Ok(Self {
            visibility_pipeline: visibility_pipeline(device, &frame_layout, &scene_layout),
            shade_pipeline: shade_pipeline(
                device,
                &[&frame_layout, &scene_layout, &image_layout],
                Entry::Shade,
            ),
            cells_pipeline: std::sync::OnceLock::new(),
            source_pipeline: std::sync::OnceLock::new(),
            source_layouts: [
                source_frame_layout(device),
                source_scene_layout(device),
                source_image_layout(device),
            ],
            tonemap_pipeline: tonemap_pipeline(device, &tonemap_layout, options.target_format),
            tables,
            prefiltered: (None, prefiltered_texture(device, queue, &[0])),
            device: device.clone(),
            queue: queue.clone(),
            options,
            frame_layout,
            scene_layout,
            image_layout,
            tonemap_layout,
            images: None,
            timestamps: Timestamps::new(device, queue),
        })
    }

    /// Copies a scene to the GPU; the error names the limit that it exceeds. The scene is
    /// one that [`relight_format::read_scene`] returned or
    /// [`relight_format::write_scene`] accepts.
    pub fn upload(&self, scene: &Scene) -> Result<GpuScene, Error> {
        let layouts = [&self.scene_layout, &self.source_layouts[1]];
        GpuScene::new(&self.device, &self.queue, layouts, scene)
    }

    /// Records one frame into `target`, a view of `width` × `height` pixels in the format
    /// of [`Options::target_format`]. Alpha is coverage; the background is transparent
    /// black.
    pub fn render(
        &mut self,
        encoder: &mut wgpu::CommandEncoder,
        scene: &GpuScene,
        frame: &Frame,
        target: &wgpu::TextureView,
        [width, height]: [u32; 2],
    ) -> Result<(), Error> {
        self.check_size(width, height)?;
        let band = self
            .options
            .rows_per_dispatch
            .max(1)
            .next_multiple_of(WORKGROUP);
        let bands = height.div_ceil(band);
        let buffers = self.frame_buffers(scene, frame, [width, height], band)?;
        self.upload_reflections(frame)?;
        let (lights, local) = (frame.bouncing_lights(), frame.packed_local_lights());
        let products = scene.products(&self.device, &lights, &local)?;
        let frame_group = self.frame_group(&buffers, &products);
        let sources = self.source_group(frame, scene, &buffers[0])?;
        if self.images.as_ref().is_none_or(|images| {
            images.size != [width, height] || sources.is_some() && images.sources.is_none()
        }) {
            let layouts = [&self.image_layout, &self.source_layouts[2]];
            let size = [width, height];
            self.images = Some(Images::new(&self.device, layouts, size, sources.is_some()));
        }
        let images = self.images.as_ref().expect("just made");

        {
            let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
                label: Some("relight visibility buffer"),
                color_attachments: &[Some(wgpu::RenderPassColorAttachment {
                    view: &images.visibility_view,
                    depth_slice: None,
                    resolve_target: None,
                    ops: wgpu::Operations {
                        load: wgpu::LoadOp::Clear(wgpu::Color::TRANSPARENT),
                        store: wgpu::StoreOp::Store,
                    },
                })],
                depth_stencil_attachment: Some(wgpu::RenderPassDepthStencilAttachment {
                    view: &images.depth_view,
                    depth_ops: Some(wgpu::Operations {
                        load: wgpu::LoadOp::Clear(0.0),
                        store: wgpu::StoreOp::Discard,
                    }),
                    stencil_ops: None,
                }),
                timestamp_writes: (self.timestamps.as_ref())
                    .map(|timestamps| timestamps.render(Pass::VisibilityBuffer)),
                ..Default::default()
            });
            pass.set_pipeline(&self.visibility_pipeline);
            pass.set_bind_group(0, &frame_group, &[0]);
            pass.set_bind_group(1, &scene.bind_group, &[]);
            pass.draw(0..3 * scene.triangle_count, 0..1);
        }
        {
            let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
                label: Some("relight shade"),
                timestamp_writes: (self.timestamps.as_ref())
                    .map(|timestamps| timestamps.compute(Pass::Shade)),
            });
            let mut dispatch = |pipeline: &wgpu::ComputePipeline, groups: [&wgpu::BindGroup; 3]| {
                pass.set_pipeline(pipeline);
                pass.set_bind_group(1, groups[1], &[]);
                pass.set_bind_group(2, groups[2], &[]);
                for index in 0..bands {
                    let rows = band.min(height - index * band);
                    pass.set_bind_group(0, groups[0], &[index * UNIFORM_STRIDE as u32]);
                    let [x, y] = [width, rows].map(|side| side.div_ceil(WORKGROUP));
                    pass.dispatch_workgroups(x, y, 1);
                }
            };
            if let (Some((frame, scene)), Some(images)) = (&sources, &images.sources) {
                dispatch(self.source_pipeline(), [frame, scene, images]);
            }
            let pipeline = match frame.method {
                Method::Cells(_) => self.cells_pipeline(),
                Method::Ambient | Method::Polar(_) => &self.shade_pipeline,
            };
            dispatch(
                pipeline,
                [&frame_group, &scene.bind_group, &images.bind_group],
            );
        }
        self.tonemap(encoder, &images.radiance_view, frame.exposure, target)?;
        if let Some(timestamps) = &self.timestamps {
            timestamps.resolve(encoder);
        }
        Ok(())
    }

    /// How long the passes of the last frame took, once it has been submitted; waits for it.
    /// `None` where the device was made without [`wgpu::Features::TIMESTAMP_QUERY`].
    pub fn pass_times(&self) -> Result<Option<PassTimes>, Error> {
        (self.timestamps.as_ref())
            .map(|timestamps| timestamps.read(&self.device))
            .transpose()
    }

    /// The linear radiance of the last frame recorded (rgba32float, alpha is coverage),
    /// not exposed; sampled or copied by commands after it. It is replaced when the size
    /// of frames changes.
    pub fn radiance(&self) -> Option<&wgpu::Texture> {
        self.images.as_ref().map(|images| &images.radiance)
    }

    /// The triangle under each pixel of the last frame recorded (r32uint): its index + 1,
    /// or 0 on the background.
    pub fn visibility_buffer(&self) -> Option<&wgpu::Texture> {
        self.images.as_ref().map(|images| &images.visibility)
    }

    /// The options that the renderer was made with.
    pub fn options(&self) -> &Options {
        &self.options
    }

    pub(crate) fn check_size(&self, width: u32, height: u32) -> Result<(), Error> {
        if width == 0 || height == 0 {
            return Err(Error::EmptyImage { width, height });
        }
        let allowed = self.device.limits().max_texture_dimension_2d;
        LimitError::check(
            "max_texture_dimension_2d",
            u64::from(width.max(height)),
            u64::from(allowed),
        )
        .map_err(Error::Frame)
    }

    fn cells_pipeline(&self) -> &wgpu::ComputePipeline {
        let layouts = [&self.frame_layout, &self.scene_layout, &self.image_layout];
        (self.cells_pipeline)
            .get_or_init(|| shade_pipeline(&self.device, &layouts, Entry::ShadeCells))
    }

    fn source_pipeline(&self) -> &wgpu::ComputePipeline {
        let layouts = self.source_layouts.each_ref();
        (self.source_pipeline).get_or_init(|| {
            compute_pipeline(&self.device, &layouts, Entry::Sources, "sources_main")
        })
    }

    /// Groups 0 and 1 of the pass for sources; `None` where the frame has none.
    fn source_group<'a>(
        &self,
        frame: &Frame,
        scene: &'a GpuScene,
        uniforms: &wgpu::Buffer,
    ) -> Result<Option<(wgpu::BindGroup, &'a wgpu::BindGroup)>, Error> {
        let Some(sources) = frame.rotated_sources() else {
            return Ok(None);
        };
        let scene_group = (scene.sources.as_ref()).map_err(|error| Error::Scene(error.clone()))?;
        let points: Vec<gpu::SourcePoint> = (sources.points().iter())
            .map(|point| gpu::SourcePoint {
                ray_offset: scene.ray_offset,
                ..*point
            })
            .collect();
        let mut scales: Vec<[f32; 4]> = (sources.scales().iter().flatten())
            .map(|scale| scale.extend(0.0).into())
            .collect();
        scales.resize(2 * sources::MAX_SOURCES as usize, [0.0; 4]);
        let buffer = |label, contents, usage| filled_buffer(&self.device, label, contents, usage);
        let points = bytemuck::cast_slice(&points);
        let points = buffer("relight sources", points, wgpu::BufferUsages::STORAGE)?;
        let scales = bytemuck::cast_slice(&scales);
        let scales = buffer("relight source scales", scales, wgpu::BufferUsages::UNIFORM)?;
        let frame_group = self.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("relight sources"),
            layout: &self.source_layouts[0],
            entries: &[
                frame_uniform_entry(uniforms),
                wgpu::BindGroupEntry {
                    binding: 5,
                    resource: points.as_entire_binding(),
                },
                wgpu::BindGroupEntry {
                    binding: 6,
                    resource: scales.as_entire_binding(),
                },
            ],
        });
        Ok(Some((frame_group, scene_group)))
    }

    /// Copies the reflected image to the GPU unless the last frame had the same.
    fn upload_reflections(&mut self, frame: &Frame) -> Result<(), Error> {
        let Some(image) = frame.reflections else {
            return Ok(());
        };
        let (uploaded, view) = &mut self.prefiltered;
        if uploaded
            .as_ref()
            .is_none_or(|texels| !Arc::ptr_eq(texels, image.texels()))
        {
            let rows = image
                .texels()
                .len()
                .div_ceil(prefiltered::TEXTURE_WIDTH as usize);
            LimitError::check(
                "max_texture_dimension_2d",
                rows as u64,
                u64::from(self.device.limits().max_texture_dimension_2d),
            )
            .map_err(Error::Frame)?;
            *view = prefiltered_texture(&self.device, &self.queue, image.texels());
            *uploaded = Some(image.texels().clone());
        }
        Ok(())
    }

    /// Uniforms, lights and local lights of one call, in buffers of its own, so that several calls
    /// may share one encoder.
    fn frame_buffers(
        &self,
        scene: &GpuScene,
        frame: &Frame,
        [width, height]: [u32; 2],
        band: u32,
    ) -> Result<[wgpu::Buffer; 3], Error> {
        let view = frame.view(width, height, scene.near);
        let mut uniform = gpu::Frame::new(&view, &scene.atlas, scene.distance_clamp);
        match frame.method {
            Method::Ambient => uniform.method = gpu::METHOD_AMBIENT,
            Method::Polar(options) => {
                uniform.method = gpu::METHOD_POLAR;
                uniform.spokes = options.spokes.max(1);
            }
            Method::Cells(options) => {
                uniform.method = gpu::METHOD_CELLS;
                uniform.boundary_error = options.boundary_error;
                uniform.lobe_error = options.lobe_error;
                uniform.cells = options.partition().unwrap_or([0; 2]);
            }
        }
        uniform.light_count = frame.lights.len() as u32;
        uniform.source_count = frame.sources.map_or(0, |sources| sources.count() as u32);
        uniform.local_light_count = frame.local_lights.len() as u32;
        uniform.prefiltered_levels = frame.reflections.map_or(0, Prefiltered::levels);
        uniform.environment_rotation = frame
            .reflection_rotation()
            .to_cols_array_2d()
            .map(|[x, y, z]| [x, y, z, 0.0]);
        check_local_lights(frame.local_lights.len()).map_err(Error::Frame)?;
        let mut local_lights = frame.packed_local_lights();
        local_lights.resize(gpu::MAX_LOCAL_LIGHTS as usize, bytemuck::Zeroable::zeroed());
        let mut uniforms = Vec::new();
        for first_row in (0..height).step_by(band as usize) {
            uniform.first_row = first_row;
            uniforms.extend_from_slice(bytemuck::bytes_of(&uniform));
            uniforms.resize(uniforms.len().next_multiple_of(UNIFORM_STRIDE), 0);
        }
        let mut lights: Vec<gpu::Light> = frame
            .rotated_lights()
            .iter()
            .map(|light| gpu::Light {
                axis: light.axis.into(),
                sharpness: light.sharpness,
                amplitude: light.amplitude.into(),
                reserved: 0.0,
            })
            .collect();
        if lights.is_empty() {
            // A binding must not be empty.
            lights.push(bytemuck::Zeroable::zeroed());
        }
        check_storage(&self.device, size_of_val(&lights[..]) as u64).map_err(Error::Frame)?;
        let buffer = |label, contents, usage| filled_buffer(&self.device, label, contents, usage);
        let uniform = wgpu::BufferUsages::UNIFORM;
        let local_lights = bytemuck::cast_slice(&local_lights);
        let (lights, storage) = (bytemuck::cast_slice(&lights), wgpu::BufferUsages::STORAGE);
        Ok([
            buffer("relight frame", &uniforms, uniform)?,
            buffer("relight lights", lights, storage)?,
            buffer("relight local lights", local_lights, uniform)?,
        ])
    }

    fn frame_group(
        &self,
        [uniforms, lights, local_lights]: &[wgpu::Buffer; 3],
        products: &wgpu::TextureView,
    ) -> wgpu::BindGroup {
        self.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("relight frame"),
            layout: &self.frame_layout,
            entries: &[
                frame_uniform_entry(uniforms),
                wgpu::BindGroupEntry {
                    binding: 1,
                    resource: lights.as_entire_binding(),
                },
                wgpu::BindGroupEntry {
                    binding: 2,
                    resource: self.tables.as_entire_binding(),
                },
                wgpu::BindGroupEntry {
                    binding: 3,
                    resource: local_lights.as_entire_binding(),
                },
                wgpu::BindGroupEntry {
                    binding: 4,
                    resource: wgpu::BindingResource::TextureView(&self.prefiltered.1),
                },
                wgpu::BindGroupEntry {
                    binding: 7,
                    resource: wgpu::BindingResource::TextureView(products),
                },
            ],
        })
    }

    fn tonemap(
        &self,
        encoder: &mut wgpu::CommandEncoder,
        radiance: &wgpu::TextureView,
        exposure: f32,
        target: &wgpu::TextureView,
    ) -> Result<(), Error> {
        let uniform = gpu::Tonemap {
            exposure,
            encode_srgb: u32::from(!self.options.target_format.is_srgb()),
        };
        let uniform = filled_buffer(
            &self.device,
            "relight tonemap",
            bytemuck::bytes_of(&uniform),
            wgpu::BufferUsages::UNIFORM,
        )?;
        let bind_group = self.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("relight tonemap"),
            layout: &self.tonemap_layout,
            entries: &[
                wgpu::BindGroupEntry {
                    binding: 0,
                    resource: uniform.as_entire_binding(),
                },
                wgpu::BindGroupEntry {
                    binding: 1,
                    resource: wgpu::BindingResource::TextureView(radiance),
                },
            ],
        });
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("relight tonemap"),
            color_attachments: &[Some(wgpu::RenderPassColorAttachment {
                view: target,
                depth_slice: None,
                resolve_target: None,
                ops: wgpu::Operations {
                    load: wgpu::LoadOp::Clear(wgpu::Color::TRANSPARENT),
                    store: wgpu::StoreOp::Store,
                },
            })],
            timestamp_writes: (self.timestamps.as_ref())
                .map(|timestamps| timestamps.render(Pass::Tonemap)),
            ..Default::default()
        });
        pass.set_pipeline(&self.tonemap_pipeline);
        pass.set_bind_group(0, &bind_group, &[]);
        pass.draw(0..3, 0..1);
        Ok(())
    }
}

impl Images {
    fn new(
        device: &wgpu::Device,
        [layout, source_layout]: [&wgpu::BindGroupLayout; 2],
        size: [u32; 2],
        with_sources: bool,
    ) -> Self {
        let sized = |label, format, usage, [width, height]: [u32; 2]| {
            device.create_texture(&wgpu::TextureDescriptor {
                label: Some(label),
                size: wgpu::Extent3d {
                    width,
                    height,
                    depth_or_array_layers: 1,
                },
                mip_level_count: 1,
                sample_count: 1,
                dimension: wgpu::TextureDimension::D2,
                format,
                usage,
                view_formats: &[],
            })
        };
        let texture = |label, format, usage| sized(label, format, usage, size);
        let drawn = wgpu::TextureUsages::RENDER_ATTACHMENT;
        let read = wgpu::TextureUsages::TEXTURE_BINDING | wgpu::TextureUsages::COPY_SRC;
        let written = wgpu::TextureUsages::STORAGE_BINDING;
        let visibility = texture("relight visibility buffer", VISIBILITY_FORMAT, drawn | read);
        let depth = texture("relight depth", DEPTH_FORMAT, drawn);
        let radiance = texture("relight radiance", RADIANCE_FORMAT, written | read);
        let view =
            |texture: &wgpu::Texture| texture.create_view(&wgpu::TextureViewDescriptor::default());
        let visibility_view = view(&visibility);
        let radiance_view = view(&radiance);
        let source_size = if with_sources { size } else { [1; 2] };
        let source_radiance = sized(
            "relight source radiance",
            RADIANCE_FORMAT,
            written | wgpu::TextureUsages::TEXTURE_BINDING,
            source_size,
        );
        let source_view = view(&source_radiance);
        let sources = with_sources.then(|| {
            device.create_bind_group(&wgpu::BindGroupDescriptor {
                label: Some("relight source images"),
                layout: source_layout,
                entries: &[
                    wgpu::BindGroupEntry {
                        binding: 0,
                        resource: wgpu::BindingResource::TextureView(&visibility_view),
                    },
                    wgpu::BindGroupEntry {
                        binding: 1,
                        resource: wgpu::BindingResource::TextureView(&source_view),
                    },
                ],
            })
        });
        let bind_group = device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("relight images"),
            layout,
            entries: &[
                wgpu::BindGroupEntry {
                    binding: 0,
                    resource: wgpu::BindingResource::TextureView(&visibility_view),
                },
                wgpu::BindGroupEntry {
                    binding: 1,
                    resource: wgpu::BindingResource::TextureView(&radiance_view),
                },
                wgpu::BindGroupEntry {
                    binding: 2,
                    resource: wgpu::BindingResource::TextureView(&source_view),
                },
            ],
        });
        Self {
            sources,
            size,
            visibility,
            visibility_view,
            depth_view: view(&depth),
            radiance,
            radiance_view,
            bind_group,
        }
    }
}

/// Checks the limits that do not depend on a scene; WebGPU's defaults satisfy them.
fn check_device(device: &wgpu::Device) -> Result<(), Error> {
    let limits = device.limits();
    for (limit, needed, allowed) in [
        ("max_bind_groups", 3, limits.max_bind_groups),
        (
            "max_storage_buffers_per_shader_stage",
            8,
            limits.max_storage_buffers_per_shader_stage,
        ),
        (
            "max_storage_textures_per_shader_stage",
            1,
            limits.max_storage_textures_per_shader_stage,
        ),
        (
            "max_dynamic_uniform_buffers_per_pipeline_layout",
            1,
            limits.max_dynamic_uniform_buffers_per_pipeline_layout,
        ),
        (
            "max_compute_invocations_per_workgroup",
            WORKGROUP * WORKGROUP,
            limits.max_compute_invocations_per_workgroup,
        ),
    ] {
        LimitError::check(limit, u64::from(needed), u64::from(allowed)).map_err(Error::Device)?;
    }
    Ok(())
}

const BOTH: wgpu::ShaderStages = wgpu::ShaderStages::VERTEX.union(wgpu::ShaderStages::COMPUTE);

fn layout_entry(
    binding: u32,
    visibility: wgpu::ShaderStages,
    ty: wgpu::BindingType,
) -> wgpu::BindGroupLayoutEntry {
    wgpu::BindGroupLayoutEntry {
        binding,
        visibility,
        ty,
        count: None,
    }
}

const STORAGE: wgpu::BindingType = wgpu::BindingType::Buffer {
    ty: wgpu::BufferBindingType::Storage { read_only: true },
    has_dynamic_offset: false,
    min_binding_size: None,
};

/// Group 0 of bindings.wgsl.
fn frame_layout(device: &wgpu::Device) -> wgpu::BindGroupLayout {
    let uniform = wgpu::BindingType::Buffer {
        ty: wgpu::BufferBindingType::Uniform,
        has_dynamic_offset: true,
        min_binding_size: None,
    };
    let local_lights = wgpu::BindingType::Buffer {
        ty: wgpu::BufferBindingType::Uniform,
        has_dynamic_offset: false,
        min_binding_size: None,
    };
    let prefiltered = wgpu::BindingType::Texture {
        sample_type: wgpu::TextureSampleType::Uint,
        view_dimension: wgpu::TextureViewDimension::D2,
        multisampled: false,
    };
    let products = wgpu::BindingType::Texture {
        // 32-bit floats cannot be filtered at default limits, and are not.
        sample_type: wgpu::TextureSampleType::Float { filterable: false },
        view_dimension: wgpu::TextureViewDimension::D2,
        multisampled: false,
    };
    device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
        label: Some("relight frame"),
        entries: &[
            layout_entry(0, BOTH, uniform),
            layout_entry(1, wgpu::ShaderStages::COMPUTE, STORAGE),
            layout_entry(2, wgpu::ShaderStages::COMPUTE, STORAGE),
            layout_entry(3, wgpu::ShaderStages::COMPUTE, local_lights),
            layout_entry(4, wgpu::ShaderStages::COMPUTE, prefiltered),
            layout_entry(7, wgpu::ShaderStages::COMPUTE, products),
        ],
    })
}

/// The texels of a prefiltered image, row after row; rgb9e5 is decoded by the shader, so that
/// the CPU and every GPU see the same.
fn prefiltered_texture(
    device: &wgpu::Device,
    queue: &wgpu::Queue,
    texels: &[u32],
) -> wgpu::TextureView {
    let width = prefiltered::TEXTURE_WIDTH;
    let rows = texels.len().div_ceil(width as usize);
    let mut padded = texels.to_vec();
    padded.resize(rows * width as usize, 0);
    let texture = device.create_texture_with_data(
        queue,
        &wgpu::TextureDescriptor {
            label: Some("relight prefiltered environment"),
            size: wgpu::Extent3d {
                width,
                height: rows as u32,
                depth_or_array_layers: 1,
            },
            mip_level_count: 1,
            sample_count: 1,
            dimension: wgpu::TextureDimension::D2,
            format: wgpu::TextureFormat::R32Uint,
            usage: wgpu::TextureUsages::TEXTURE_BINDING,
            view_formats: &[],
        },
        wgpu::util::TextureDataOrder::LayerMajor,
        bytemuck::cast_slice(&padded),
    );
    texture.create_view(&wgpu::TextureViewDescriptor::default())
}

/// Group 1 of bindings.wgsl.
fn scene_layout(device: &wgpu::Device) -> wgpu::BindGroupLayout {
    let compute = wgpu::ShaderStages::COMPUTE;
    let atlas = wgpu::BindingType::Texture {
        sample_type: wgpu::TextureSampleType::Float { filterable: true },
        view_dimension: wgpu::TextureViewDimension::D2Array,
        multisampled: false,
    };
    let sampler = wgpu::BindingType::Sampler(wgpu::SamplerBindingType::Filtering);
    let words = wgpu::BindingType::Texture {
        sample_type: wgpu::TextureSampleType::Uint,
        view_dimension: wgpu::TextureViewDimension::D2,
        multisampled: false,
    };
    device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
        label: Some("relight scene"),
        entries: &[
            layout_entry(0, BOTH, STORAGE),
            layout_entry(1, BOTH, STORAGE),
            layout_entry(2, compute, STORAGE),
            layout_entry(3, compute, STORAGE),
            layout_entry(4, compute, STORAGE),
            layout_entry(5, compute, STORAGE),
            layout_entry(6, compute, atlas),
            layout_entry(7, compute, sampler),
            layout_entry(10, compute, words),
        ],
    })
}

fn frame_uniform_entry(uniforms: &wgpu::Buffer) -> wgpu::BindGroupEntry<'_> {
    wgpu::BindGroupEntry {
        binding: 0,
        resource: wgpu::BindingResource::Buffer(wgpu::BufferBinding {
            buffer: uniforms,
            offset: 0,
            size: std::num::NonZeroU64::new(size_of::<gpu::Frame>() as u64),
        }),
    }
}

/// Group 0 of bindings.wgsl as sources need it.
fn source_frame_layout(device: &wgpu::Device) -> wgpu::BindGroupLayout {
    let uniform = |has_dynamic_offset| wgpu::BindingType::Buffer {
        ty: wgpu::BufferBindingType::Uniform,
        has_dynamic_offset,
        min_binding_size: None,
    };
    device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
        label: Some("relight sources"),
        entries: &[
            layout_entry(0, wgpu::ShaderStages::COMPUTE, uniform(true)),
            layout_entry(5, wgpu::ShaderStages::COMPUTE, STORAGE),
            layout_entry(6, wgpu::ShaderStages::COMPUTE, uniform(false)),
        ],
    })
}

/// Group 1 of bindings.wgsl as sources need it.
fn source_scene_layout(device: &wgpu::Device) -> wgpu::BindGroupLayout {
    let entry = |binding| layout_entry(binding, wgpu::ShaderStages::COMPUTE, STORAGE);
    device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
        label: Some("relight occluders"),
        entries: &[0, 1, 4, 5, 8, 9].map(entry),
    })
}

/// Group 2 of bindings.wgsl as sources need it.
fn source_image_layout(device: &wgpu::Device) -> wgpu::BindGroupLayout {
    let [visibility, radiance, _] = image_entries();
    device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
        label: Some("relight source images"),
        entries: &[visibility, radiance],
    })
}

/// Group 2 of bindings.wgsl.
fn image_layout(device: &wgpu::Device) -> wgpu::BindGroupLayout {
    device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
        label: Some("relight images"),
        entries: &image_entries(),
    })
}

fn image_entries() -> [wgpu::BindGroupLayoutEntry; 3] {
    let texture = |sample_type| wgpu::BindingType::Texture {
        sample_type,
        view_dimension: wgpu::TextureViewDimension::D2,
        multisampled: false,
    };
    let radiance = wgpu::BindingType::StorageTexture {
        access: wgpu::StorageTextureAccess::WriteOnly,
        format: RADIANCE_FORMAT,
        view_dimension: wgpu::TextureViewDimension::D2,
    };
    let sources = wgpu::TextureSampleType::Float { filterable: false };
    let compute = wgpu::ShaderStages::COMPUTE;
    [
        layout_entry(0, compute, texture(wgpu::TextureSampleType::Uint)),
        layout_entry(1, compute, radiance),
        layout_entry(2, compute, texture(sources)),
    ]
}

/// Group 0 of tonemap.wgsl.
fn tonemap_layout(device: &wgpu::Device) -> wgpu::BindGroupLayout {
    let uniform = wgpu::BindingType::Buffer {
        ty: wgpu::BufferBindingType::Uniform,
        has_dynamic_offset: false,
        min_binding_size: None,
    };
    let radiance = wgpu::BindingType::Texture {
        // 32-bit floats cannot be filtered at default limits, and are not.
        sample_type: wgpu::TextureSampleType::Float { filterable: false },
        view_dimension: wgpu::TextureViewDimension::D2,
        multisampled: false,
    };
    device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
        label: Some("relight tonemap"),
        entries: &[
            layout_entry(0, wgpu::ShaderStages::FRAGMENT, uniform),
            layout_entry(1, wgpu::ShaderStages::FRAGMENT, radiance),
        ],
    })
}

fn shader(device: &wgpu::Device, entry: Entry) -> wgpu::ShaderModule {
    device.create_shader_module(wgpu::ShaderModuleDescriptor {
        label: Some("relight"),
        source: wgpu::ShaderSource::Wgsl(source(entry).into()),
    })
}

fn pipeline_layout(
    device: &wgpu::Device,
    groups: &[&wgpu::BindGroupLayout],
) -> wgpu::PipelineLayout {
    let groups: Vec<_> = groups.iter().copied().map(Some).collect();
    device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
        label: Some("relight"),
        bind_group_layouts: &groups,
        immediate_size: 0,
    })
}

fn visibility_pipeline(
    device: &wgpu::Device,
    frame: &wgpu::BindGroupLayout,
    scene: &wgpu::BindGroupLayout,
) -> wgpu::RenderPipeline {
    let module = shader(device, Entry::VisibilityBuffer);
    device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
        label: Some("relight visibility buffer"),
        layout: Some(&pipeline_layout(device, &[frame, scene])),
        vertex: wgpu::VertexState {
            module: &module,
            entry_point: Some("visibility_buffer_vertex"),
            compilation_options: wgpu::PipelineCompilationOptions::default(),
            buffers: &[],
        },
        primitive: wgpu::PrimitiveState {
            front_face: wgpu::FrontFace::Ccw,
            cull_mode: Some(wgpu::Face::Back),
            ..Default::default()
        },
        depth_stencil: Some(wgpu::DepthStencilState {
            format: DEPTH_FORMAT,
            depth_write_enabled: Some(true),
            depth_compare: Some(wgpu::CompareFunction::Greater),
            stencil: wgpu::StencilState::default(),
            bias: wgpu::DepthBiasState::default(),
        }),
        multisample: wgpu::MultisampleState::default(),
        fragment: Some(wgpu::FragmentState {
            module: &module,
            entry_point: Some("visibility_buffer_fragment"),
            compilation_options: wgpu::PipelineCompilationOptions::default(),
            targets: &[Some(VISIBILITY_FORMAT.into())],
        }),
        multiview_mask: None,
        cache: None,
    })
}

fn shade_pipeline(
    device: &wgpu::Device,
    groups: &[&wgpu::BindGroupLayout],
    entry: Entry,
) -> wgpu::ComputePipeline {
    compute_pipeline(device, groups, entry, "shade_main")
}

fn compute_pipeline(
    device: &wgpu::Device,
    groups: &[&wgpu::BindGroupLayout],
    entry: Entry,
    entry_point: &str,
) -> wgpu::ComputePipeline {
    device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
        label: Some("relight shade"),
        layout: Some(&pipeline_layout(device, groups)),
        module: &shader(device, entry),
        entry_point: Some(entry_point),
        compilation_options: wgpu::PipelineCompilationOptions::default(),
        cache: None,
    })
}

fn tonemap_pipeline(
    device: &wgpu::Device,
    layout: &wgpu::BindGroupLayout,
    target_format: wgpu::TextureFormat,
) -> wgpu::RenderPipeline {
    let module = shader(device, Entry::Tonemap);
    device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
        label: Some("relight tonemap"),
        layout: Some(&pipeline_layout(device, &[layout])),
        vertex: wgpu::VertexState {
            module: &module,
            entry_point: Some("tonemap_vertex"),
            compilation_options: wgpu::PipelineCompilationOptions::default(),
            buffers: &[],
        },
        primitive: wgpu::PrimitiveState::default(),
        depth_stencil: None,
        multisample: wgpu::MultisampleState::default(),
        fragment: Some(wgpu::FragmentState {
            module: &module,
            entry_point: Some("tonemap_fragment"),
            compilation_options: wgpu::PipelineCompilationOptions::default(),
            targets: &[Some(target_format.into())],
        }),
        multiview_mask: None,
        cache: None,
    })
}
