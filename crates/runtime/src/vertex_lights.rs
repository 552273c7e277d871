//! Visible fractions of distant lights at the vertices of one instance, kept while its light stands
//! still.

use relight_shading::gpu;
use relight_shading::vertex_visibility::{FRAME_BITS, TEXTURE_WIDTH, texture_rows};

use crate::{GpuScene, Renderer};

/// What is kept of one instance in one view.
#[derive(Debug)]
pub(crate) struct VertexLights {
    /// Group 1 of kernels of vertices, of the scene whose vertices they are.
    scene: wgpu::BindGroup,
    vertices: usize,
    lights: Vec<gpu::Light>,
    /// Of the light that fractions are of, from 1, and of the frame under it.
    light: u32,
    frame: u32,
    /// A word per vertex: the stamp of the frame that it was last wanted in.
    states: wgpu::Buffer,
    /// Written by kernels of vertices and read by others.
    pub(crate) fractions: wgpu::TextureView,
    /// The visibility buffer that it was made with, and group 2 of kernels of vertices.
    group: Option<(wgpu::TextureView, wgpu::BindGroup)>,
}

impl VertexLights {
    /// What is kept, for the next frame of a scene of so many vertices under `lights`; `None` where
    /// nothing is kept of so many.
    pub(crate) fn next_frame(
        kept: Option<Self>,
        renderer: &Renderer,
        scene: &GpuScene,
        lights: &[gpu::Light],
    ) -> Option<Self> {
        let vertices = scene.vertex_count;
        let device = renderer.device();
        let rows = texture_rows(vertices, lights.len())?;
        if rows > device.limits().max_texture_dimension_2d {
            return None;
        }
        let quads = lights.len().div_ceil(4);
        let fits = |kept: &Self| {
            // Numbers of lights end: then all begins anew.
            let numbers_left = kept.light + 1 < 1 << (32 - FRAME_BITS);
            // Another scene may have as many vertices.
            kept.scene == scene.vertex_group
                && kept.lights.len().div_ceil(4) == quads
                && numbers_left
        };
        let Some(mut kept) = kept.filter(fits) else {
            return Some(Self {
                scene: scene.vertex_group.clone(),
                vertices,
                lights: lights.to_vec(),
                light: 1,
                frame: 0,
                states: device.create_buffer(&wgpu::BufferDescriptor {
                    label: Some("relight vertex states"),
                    size: 4 * vertices as u64,
                    usage: wgpu::BufferUsages::STORAGE,
                    mapped_at_creation: false,
                }),
                fractions: fractions_texture(device, rows),
                group: None,
            });
        };
        if kept.lights == lights {
            // A vertex that was wanted a multiple of so many frames ago is found again, which
            // changes nothing.
            kept.frame = (kept.frame + 1) % (1 << FRAME_BITS);
        } else {
            kept.lights = lights.to_vec();
            kept.light += 1;
            kept.frame = 0;
        }
        Some(kept)
    }

    /// `vertex_stamp` of the frame.
    pub(crate) fn stamp(&self) -> u32 {
        self.light << FRAME_BITS | self.frame
    }

    /// Workgroups of `vertices_main`.
    pub(crate) fn workgroups(&self) -> [u32; 2] {
        [
            (self.vertices as u32).div_ceil(64),
            (self.lights.len() as u32).div_ceil(4),
        ]
    }

    /// Makes group 2 of kernels of vertices, unless it is there.
    pub(crate) fn bind(&mut self, renderer: &Renderer, visibility: &wgpu::TextureView) {
        if (self.group.as_ref()).is_none_or(|(made_with, _)| made_with != visibility) {
            let group = renderer.vertex_group(visibility, &self.states, &self.fractions);
            self.group = Some((visibility.clone(), group));
        }
    }

    /// It.
    pub(crate) fn group(&self) -> &wgpu::BindGroup {
        let (_, group) = self.group.as_ref().expect("made before it is used");
        group
    }
}

/// A texture of fractions, [`TEXTURE_WIDTH`] texels wide.
fn fractions_texture(device: &wgpu::Device, rows: u32) -> wgpu::TextureView {
    let usage = wgpu::TextureUsages::STORAGE_BINDING | wgpu::TextureUsages::TEXTURE_BINDING;
    let texture = device.create_texture(&wgpu::TextureDescriptor {
        label: Some("relight light fractions"),
        size: wgpu::Extent3d {
            width: TEXTURE_WIDTH,
            height: rows,
            depth_or_array_layers: 1,
        },
        mip_level_count: 1,
        sample_count: 1,
        dimension: wgpu::TextureDimension::D2,
        format: wgpu::TextureFormat::Rgba32Float,
        usage,
        view_formats: &[],
    });
    texture.create_view(&wgpu::TextureViewDescriptor::default())
}
