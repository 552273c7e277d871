//! Layouts of the groups of `bindings.wgsl`, and pipelines made of them.

use relight_shading::wgsl::{Entry, Kernel, source};

/// Format of the visibility buffer.
pub(crate) const VISIBILITY_FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::R32Uint;
/// Format of samples of visibility.
pub(crate) const SAMPLES_FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::Rgba16Uint;
/// Format of the depth buffer.
pub(crate) const DEPTH_FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::Depth32Float;
/// Format of the image of which points of sources pixels see.
pub(crate) const SOURCES_FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::Rgba32Uint;
/// Format of the linear image.
pub(crate) const RADIANCE_FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::Rgba32Float;

/// Bindings of group 1 that kernels of vertices need.
pub(crate) const VERTEX_BINDINGS: [u32; 6] = [0, 1, 2, 3, 6, 7];

const BOTH: wgpu::ShaderStages = wgpu::ShaderStages::VERTEX.union(wgpu::ShaderStages::COMPUTE);

pub(crate) fn layout_entry(
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

pub(crate) const STORAGE: wgpu::BindingType = wgpu::BindingType::Buffer {
    ty: wgpu::BufferBindingType::Storage { read_only: true },
    has_dynamic_offset: false,
    min_binding_size: None,
};

pub(crate) const UNIFORM: wgpu::BindingType = wgpu::BindingType::Buffer {
    ty: wgpu::BufferBindingType::Uniform,
    has_dynamic_offset: false,
    min_binding_size: None,
};

/// A part of a buffer, whose beginning is said when it is bound.
pub(crate) const UNIFORM_PARTS: wgpu::BindingType = wgpu::BindingType::Buffer {
    ty: wgpu::BufferBindingType::Uniform,
    has_dynamic_offset: true,
    min_binding_size: None,
};

/// Group 0 of bindings.wgsl.
pub(crate) fn frame_layout(device: &wgpu::Device) -> wgpu::BindGroupLayout {
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
            layout_entry(0, BOTH, UNIFORM),
            layout_entry(1, wgpu::ShaderStages::COMPUTE, STORAGE),
            layout_entry(2, wgpu::ShaderStages::COMPUTE, STORAGE),
            layout_entry(3, wgpu::ShaderStages::COMPUTE, UNIFORM_PARTS),
            layout_entry(4, wgpu::ShaderStages::COMPUTE, prefiltered),
            layout_entry(7, wgpu::ShaderStages::COMPUTE, products),
            layout_entry(8, wgpu::ShaderStages::COMPUTE, products),
        ],
    })
}

/// Group 1 of bindings.wgsl.
pub(crate) fn scene_layout(device: &wgpu::Device) -> wgpu::BindGroupLayout {
    device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
        label: Some("relight scene"),
        entries: &scene_entries(),
    })
}

pub(crate) fn scene_entries() -> [wgpu::BindGroupLayoutEntry; 9] {
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
    let texels = wgpu::BindingType::Texture {
        sample_type: wgpu::TextureSampleType::Uint,
        view_dimension: wgpu::TextureViewDimension::D2Array,
        multisampled: false,
    };
    [
        layout_entry(0, BOTH, STORAGE),
        layout_entry(1, BOTH, STORAGE),
        layout_entry(2, compute, STORAGE),
        layout_entry(3, compute, STORAGE),
        layout_entry(4, compute, STORAGE),
        layout_entry(5, compute, texels),
        layout_entry(6, compute, atlas),
        layout_entry(7, compute, sampler),
        layout_entry(10, compute, words),
    ]
}

pub(crate) fn buffer_entry(binding: u32, buffer: &wgpu::Buffer) -> wgpu::BindGroupEntry<'_> {
    wgpu::BindGroupEntry {
        binding,
        resource: buffer.as_entire_binding(),
    }
}

pub(crate) fn texture_entry(binding: u32, texture: &wgpu::TextureView) -> wgpu::BindGroupEntry<'_> {
    wgpu::BindGroupEntry {
        binding,
        resource: wgpu::BindingResource::TextureView(texture),
    }
}

/// The first `size` bytes of a buffer, or as many from another place.
pub(crate) fn part_entry(
    binding: u32,
    buffer: &wgpu::Buffer,
    size: u64,
) -> wgpu::BindGroupEntry<'_> {
    wgpu::BindGroupEntry {
        binding,
        resource: wgpu::BindingResource::Buffer(wgpu::BufferBinding {
            buffer,
            offset: 0,
            size: std::num::NonZeroU64::new(size),
        }),
    }
}

/// Group 0 of bindings.wgsl as sources need it.
pub(crate) fn source_frame_layout(device: &wgpu::Device) -> wgpu::BindGroupLayout {
    let compute = wgpu::ShaderStages::COMPUTE;
    device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
        label: Some("relight sources"),
        entries: &[
            layout_entry(0, compute, UNIFORM),
            layout_entry(3, compute, UNIFORM_PARTS),
            layout_entry(5, compute, STORAGE),
        ],
    })
}

/// Group 1 of bindings.wgsl as the points of sources need it.
pub(crate) fn source_scene_layout(device: &wgpu::Device) -> wgpu::BindGroupLayout {
    let entry = |binding| layout_entry(binding, wgpu::ShaderStages::COMPUTE, STORAGE);
    device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
        label: Some("relight occluders"),
        entries: &[0, 1, 8, 9].map(entry),
    })
}

/// A buffer of slots that kernels write.
pub(crate) fn written(binding: u32) -> wgpu::BindGroupLayoutEntry {
    let kind = wgpu::BindingType::Buffer {
        ty: wgpu::BufferBindingType::Storage { read_only: false },
        has_dynamic_offset: false,
        min_binding_size: None,
    };
    layout_entry(binding, wgpu::ShaderStages::COMPUTE, kind)
}

/// Groups 2 of bindings.wgsl as the points of sources need it, and what is shown of them.
pub(crate) fn source_image_layouts(device: &wgpu::Device) -> [wgpu::BindGroupLayout; 2] {
    let compute = wgpu::ShaderStages::COMPUTE;
    let [visibility, ..] = image_entries();
    let found = wgpu::BindingType::StorageTexture {
        access: wgpu::StorageTextureAccess::WriteOnly,
        format: SOURCES_FORMAT,
        view_dimension: wgpu::TextureViewDimension::D2,
    };
    let found = layout_entry(1, compute, found);
    let seen = layout_entry(2, compute, visibility.ty);
    let reflection = layout_entry(6, compute, STORAGE);
    let layout = |entries: &[wgpu::BindGroupLayoutEntry]| {
        device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
            label: Some("relight source images"),
            entries,
        })
    };
    [
        layout(&[visibility, found, seen, reflection]),
        layout(&[seen, reflection, written(7)]),
    ]
}

/// Group 0 of bindings.wgsl as vertices need it.
pub(crate) fn vertex_frame_layout(device: &wgpu::Device) -> wgpu::BindGroupLayout {
    let compute = wgpu::ShaderStages::COMPUTE;
    device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
        label: Some("relight vertices"),
        entries: &[
            layout_entry(0, compute, UNIFORM),
            layout_entry(1, compute, STORAGE),
            layout_entry(2, compute, STORAGE),
            layout_entry(3, compute, UNIFORM_PARTS),
        ],
    })
}

/// Group 1 of bindings.wgsl as vertices need it.
pub(crate) fn vertex_scene_layout(device: &wgpu::Device) -> wgpu::BindGroupLayout {
    let entries: Vec<_> = (scene_entries().into_iter())
        .filter(|entry| VERTEX_BINDINGS.contains(&entry.binding))
        .collect();
    device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
        label: Some("relight vertices"),
        entries: &entries,
    })
}

/// Group 2 of bindings.wgsl as vertices need it.
pub(crate) fn vertex_image_layout(device: &wgpu::Device) -> wgpu::BindGroupLayout {
    let [visibility, found] = image_entries();
    let states = wgpu::BindingType::Buffer {
        ty: wgpu::BufferBindingType::Storage { read_only: false },
        has_dynamic_offset: false,
        min_binding_size: None,
    };
    device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
        label: Some("relight light fractions"),
        entries: &[
            visibility,
            layout_entry(4, wgpu::ShaderStages::COMPUTE, states),
            wgpu::BindGroupLayoutEntry {
                binding: 5,
                ..found
            },
        ],
    })
}

/// Group 0 of surfaces.wgsl.
pub(crate) fn surface_frame_layout(device: &wgpu::Device) -> wgpu::BindGroupLayout {
    device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
        label: Some("relight world"),
        entries: &[layout_entry(0, wgpu::ShaderStages::COMPUTE, UNIFORM)],
    })
}

/// Group 1 of surfaces.wgsl.
pub(crate) fn surface_image_layout(device: &wgpu::Device) -> wgpu::BindGroupLayout {
    let samples = |sample_type| wgpu::BindingType::Texture {
        sample_type,
        view_dimension: wgpu::TextureViewDimension::D2,
        multisampled: true,
    };
    let written = |format| wgpu::BindingType::StorageTexture {
        access: wgpu::StorageTextureAccess::WriteOnly,
        format,
        view_dimension: wgpu::TextureViewDimension::D2,
    };
    let compute = wgpu::ShaderStages::COMPUTE;
    device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
        label: Some("relight surfaces"),
        entries: &[
            layout_entry(0, compute, samples(wgpu::TextureSampleType::Uint)),
            layout_entry(1, compute, samples(wgpu::TextureSampleType::Depth)),
            layout_entry(2, compute, written(wgpu::TextureFormat::Rg32Uint)),
            layout_entry(3, compute, written(wgpu::TextureFormat::R32Uint)),
        ],
    })
}

/// Group 2 of bindings.wgsl as cells need it.
pub(crate) fn image_layout(device: &wgpu::Device) -> wgpu::BindGroupLayout {
    let [visibility, radiance] = image_entries();
    device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
        label: Some("relight images"),
        entries: &[visibility, radiance, written(7)],
    })
}

/// The visibility buffer and radiance.
pub(crate) fn image_entries() -> [wgpu::BindGroupLayoutEntry; 2] {
    let visibility = wgpu::BindingType::Texture {
        sample_type: wgpu::TextureSampleType::Uint,
        view_dimension: wgpu::TextureViewDimension::D2,
        multisampled: false,
    };
    let radiance = wgpu::BindingType::StorageTexture {
        access: wgpu::StorageTextureAccess::WriteOnly,
        format: RADIANCE_FORMAT,
        view_dimension: wgpu::TextureViewDimension::D2,
    };
    let compute = wgpu::ShaderStages::COMPUTE;
    [
        layout_entry(0, compute, visibility),
        layout_entry(1, compute, radiance),
    ]
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

/// Triangles to visibility; with `samples`, four per pixel and what tells surfaces apart.
pub(crate) fn visibility_pipeline(
    device: &wgpu::Device,
    groups: [&wgpu::BindGroupLayout; 2],
    samples: bool,
) -> wgpu::RenderPipeline {
    let (entry, [vertex, fragment], format, count) = if samples {
        let names = ["surface_samples_vertex", "surface_samples_fragment"];
        (Entry::SurfaceSamples, names, SAMPLES_FORMAT, 4)
    } else {
        let names = ["visibility_buffer_vertex", "visibility_buffer_fragment"];
        (Entry::VisibilityBuffer, names, VISIBILITY_FORMAT, 1)
    };
    let module = shader(device, entry);
    device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
        label: Some("relight visibility buffer"),
        layout: Some(&pipeline_layout(device, &groups)),
        vertex: wgpu::VertexState {
            module: &module,
            entry_point: Some(vertex),
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
        multisample: wgpu::MultisampleState {
            count,
            ..Default::default()
        },
        fragment: Some(wgpu::FragmentState {
            module: &module,
            entry_point: Some(fragment),
            compilation_options: wgpu::PipelineCompilationOptions::default(),
            targets: &[Some(format.into())],
        }),
        multiview_mask: None,
        cache: None,
    })
}

pub(crate) fn compute_pipeline(
    device: &wgpu::Device,
    groups: &[&wgpu::BindGroupLayout],
    kernel: &Kernel,
) -> wgpu::ComputePipeline {
    device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
        label: Some(kernel.name),
        layout: Some(&pipeline_layout(device, groups)),
        module: &shader(device, kernel.entry),
        entry_point: Some(kernel.entry_point),
        compilation_options: wgpu::PipelineCompilationOptions {
            constants: kernel.constants,
            ..Default::default()
        },
        cache: None,
    })
}
