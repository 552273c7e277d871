//! Pipelines that are made when they are first needed, and the bind groups of a frame.

use std::sync::{Arc, PoisonError};

use relight_shading::gpu::LimitError;
use relight_shading::prefiltered::{self, Prefiltered};
use relight_shading::wgsl;
use wgpu::util::DeviceExt as _;

use super::{KEPT_IMAGES, Renderer};
use crate::fill_texture::FillPass;
use crate::layouts::{
    buffer_entry, compute_pipeline, part_entry, texture_entry, visibility_pipeline,
};
use crate::motion::MotionPass;
use crate::resources::{FRAMES_BYTES, TILES_BYTES};
use crate::{Error, Options, composite};

impl Renderer {
    pub(super) fn mark_pipeline(&self) -> &wgpu::ComputePipeline {
        let layouts = self.vertex_layouts.each_ref();
        (self.kernels.vertices_mark)
            .get_or_init(|| compute_pipeline(&self.device, &layouts, &wgsl::VERTICES_MARK))
    }

    pub(super) fn vertex_pipeline(&self) -> &wgpu::ComputePipeline {
        let layouts = self.vertex_layouts.each_ref();
        (self.kernels.vertices)
            .get_or_init(|| compute_pipeline(&self.device, &layouts, &wgsl::VERTICES))
    }

    pub(crate) fn fill_pass(&self) -> &FillPass {
        (self.kernels.fill).get_or_init(|| FillPass::new(&self.device))
    }

    pub(crate) fn motion_pass(&self) -> &MotionPass {
        let layouts = [&self.frame_layout, &self.scene_layout];
        (self.kernels.motion).get_or_init(|| MotionPass::new(&self.device, layouts))
    }

    /// What is bound where vertices see nothing of lights.
    pub(crate) fn no_fractions(&self) -> &wgpu::TextureView {
        &self.no_fractions
    }

    /// Group 0 of kernels of vertices.
    pub(crate) fn vertex_frame_group(
        &self,
        [frames, lights, tiles]: [&wgpu::Buffer; 3],
    ) -> wgpu::BindGroup {
        self.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("relight vertices"),
            layout: &self.vertex_layouts[0],
            entries: &[
                part_entry(0, frames, FRAMES_BYTES),
                buffer_entry(1, lights),
                buffer_entry(2, &self.tables),
                part_entry(3, tiles, TILES_BYTES),
            ],
        })
    }

    /// Group 2 of kernels of vertices.
    pub(crate) fn vertex_group(
        &self,
        visibility: &wgpu::TextureView,
        states: &wgpu::Buffer,
        fractions: &wgpu::TextureView,
    ) -> wgpu::BindGroup {
        self.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("relight light fractions"),
            layout: &self.vertex_layouts[2],
            entries: &[
                texture_entry(0, visibility),
                buffer_entry(4, states),
                texture_entry(5, fractions),
            ],
        })
    }

    pub(super) fn composite_pipelines(&self, surfaces: bool) -> &composite::Pipelines {
        let index = usize::from(surfaces);
        self.composite_pipelines[index].get_or_init(|| {
            let layout = &self.composite_layouts[index];
            composite::Pipelines::new(&self.device, layout, self.options.clone(), surfaces)
        })
    }

    pub(super) fn target_pipelines(&self, surfaces: bool) -> &composite::Pipelines {
        let index = usize::from(surfaces);
        self.target_pipelines[index].get_or_init(|| {
            let options = Options {
                depth_stencil: None,
                multisample: wgpu::MultisampleState::default(),
                blend: None,
                ..self.options.clone()
            };
            let layout = &self.composite_layouts[index];
            composite::Pipelines::new(&self.device, layout, options, surfaces)
        })
    }

    /// Samples of visibility, and the surfaces among them.
    pub(super) fn surface_pipelines(&self) -> &(wgpu::RenderPipeline, wgpu::ComputePipeline) {
        self.surface_pipelines.get_or_init(|| {
            let groups = [&self.frame_layout, &self.scene_layout];
            let surfaces = self.surface_layouts.each_ref();
            (
                visibility_pipeline(&self.device, groups, true),
                compute_pipeline(&self.device, &surfaces, &wgsl::SURFACES),
            )
        })
    }

    /// Group 0 of the pass for surfaces.
    pub(super) fn world_group(&self, uniforms: &wgpu::Buffer) -> wgpu::BindGroup {
        self.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("relight world"),
            layout: &self.surface_layouts[0],
            entries: &[part_entry(0, uniforms, FRAMES_BYTES)],
        })
    }

    /// Group 0 of the passes for sources: frames, tiles, points.
    pub(crate) fn source_group(&self, buffers: [&wgpu::Buffer; 3]) -> wgpu::BindGroup {
        let [frames, tiles, points] = buffers;
        self.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("relight sources"),
            layout: &self.lobes.sources[0],
            entries: &[
                part_entry(0, frames, FRAMES_BYTES),
                part_entry(3, tiles, TILES_BYTES),
                buffer_entry(5, points),
            ],
        })
    }

    /// An image on the GPU; one texel without.
    pub(super) fn image(&self, image: Option<&Prefiltered>) -> Result<wgpu::TextureView, Error> {
        let Some(image) = image else {
            return Ok(self.no_image.clone());
        };
        let mut kept = (self.prefiltered.lock()).unwrap_or_else(PoisonError::into_inner);
        let found = kept
            .iter()
            .position(|(texels, _)| Arc::ptr_eq(texels, image.texels()));
        let entry = match found {
            Some(index) => kept.remove(index),
            None => (image.texels().clone(), self.upload_image(image)?),
        };
        let view = entry.1.clone();
        kept.insert(0, entry);
        kept.truncate(KEPT_IMAGES);
        Ok(view)
    }

    pub(super) fn upload_image(&self, image: &Prefiltered) -> Result<wgpu::TextureView, Error> {
        let width = prefiltered::TEXTURE_WIDTH as usize;
        let rows = image.texels().len().div_ceil(width);
        let allowed = self.device.limits().max_texture_dimension_2d;
        LimitError::check("max_texture_dimension_2d", rows as u64, u64::from(allowed))
            .map_err(Error::Frame)?;
        Ok(prefiltered_texture(
            &self.device,
            &self.queue,
            image.texels(),
        ))
    }

    /// Group 0: frames, lights and tiles; the reflected image, the products of bounced light and the fractions of
    /// lights.
    pub(crate) fn frame_group(
        &self,
        [frames, lights, tiles]: [&wgpu::Buffer; 3],
        [prefiltered, products, fractions]: &[wgpu::TextureView; 3],
    ) -> wgpu::BindGroup {
        self.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("relight frame"),
            layout: &self.frame_layout,
            entries: &[
                part_entry(0, frames, FRAMES_BYTES),
                buffer_entry(1, lights),
                buffer_entry(2, &self.tables),
                part_entry(3, tiles, TILES_BYTES),
                texture_entry(4, prefiltered),
                texture_entry(7, products),
                texture_entry(8, fractions),
            ],
        })
    }
}

/// A texture that nobody reads.
pub(super) fn one_texel(device: &wgpu::Device) -> wgpu::TextureView {
    let texture = device.create_texture(&wgpu::TextureDescriptor {
        label: Some("relight nothing"),
        size: wgpu::Extent3d::default(),
        mip_level_count: 1,
        sample_count: 1,
        dimension: wgpu::TextureDimension::D2,
        format: wgpu::TextureFormat::Rgba32Float,
        usage: wgpu::TextureUsages::TEXTURE_BINDING,
        view_formats: &[],
    });
    texture.create_view(&wgpu::TextureViewDescriptor::default())
}

/// The texels of a prefiltered image, row after row; rgb9e5 is decoded by the shader, so that
/// the CPU and every GPU see the same.
pub(super) fn prefiltered_texture(
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
