//! Visible fractions of distant lights at the vertices of instances, kept while their light stands
//! still.

use relight_shading::gpu;
use relight_shading::vertex_visibility::{FRAME_BITS, TEXTURE_WIDTH, texture_rows};

use crate::{GpuScene, Renderer};

/// What is kept of instances of one scene in one view.
#[derive(Debug)]
pub(crate) struct VertexLights {
    /// Group 1 of kernels of vertices, of the scene whose vertices they are.
    scene: wgpu::BindGroup,
    vertices: usize,
    /// Four lights each.
    quads: usize,
    /// By instance; those of frames before this one may have been more.
    lights: Vec<LightOfInstance>,
    /// Instances that there is room for.
    room: usize,
    /// A word per vertex, instance after instance: the stamp of the frame that it was last wanted in.
    states: wgpu::Buffer,
    /// Written by kernels of vertices and read by others.
    pub(crate) fractions: wgpu::TextureView,
    /// The visibility buffer that it was made with, and group 2 of kernels of vertices.
    group: Option<(wgpu::TextureView, wgpu::BindGroup)>,
}

/// What fractions are of.
#[derive(Debug)]
struct LightOfInstance {
    lights: Vec<gpu::Light>,
    /// Its number, from 1, and that of the frame under it.
    light: u32,
    frame: u32,
}

impl LightOfInstance {
    fn new(lights: &[gpu::Light]) -> Self {
        Self {
            lights: lights.to_vec(),
            light: 1,
            frame: 0,
        }
    }

    fn next_frame(&mut self, lights: &[gpu::Light]) {
        if self.lights == lights {
            // A vertex that was wanted a multiple of so many frames ago is found again, which
            // changes nothing.
            self.frame = (self.frame + 1) % (1 << FRAME_BITS);
        } else {
            self.lights.clear();
            self.lights.extend_from_slice(lights);
            self.light += 1;
            self.frame = 0;
        }
    }
}

impl VertexLights {
    /// What is kept, for the next frame of instances of a scene under the lights of each; `None` where
    /// nothing is kept of so many.
    pub(crate) fn next_frame(
        kept: Option<Self>,
        renderer: &Renderer,
        scene: &GpuScene,
        lights: &[Vec<gpu::Light>],
    ) -> Option<Self> {
        let vertices = scene.vertex_count;
        let device = renderer.device();
        let quads = lights.first()?.len().div_ceil(4);
        let rows = texture_rows(vertices * lights.len(), 4 * quads)?;
        if rows > device.limits().max_texture_dimension_2d {
            return None;
        }
        let fits = |kept: &Self| {
            // Another scene may have as many vertices.
            kept.scene == scene.vertex_group
                && kept.quads == quads
                && kept.room >= lights.len()
                // Numbers of lights end: then all begins anew.
                && (kept.lights.iter()).all(|of| of.light + 1 < 1 << (32 - FRAME_BITS))
        };
        let Some(mut kept) = kept.filter(fits) else {
            return Some(Self {
                scene: scene.vertex_group.clone(),
                vertices,
                quads,
                lights: (lights.iter())
                    .map(|lights| LightOfInstance::new(lights))
                    .collect(),
                room: lights.len(),
                states: device.create_buffer(&wgpu::BufferDescriptor {
                    label: Some("relight vertex states"),
                    size: 4 * (vertices * lights.len()) as u64,
                    usage: wgpu::BufferUsages::STORAGE,
                    mapped_at_creation: false,
                }),
                fractions: fractions_texture(device, rows),
                group: None,
            });
        };
        for (index, lights) in lights.iter().enumerate() {
            match kept.lights.get_mut(index) {
                Some(of) => of.next_frame(lights),
                None => kept.lights.push(LightOfInstance::new(lights)),
            }
        }
        Some(kept)
    }

    /// Most instances whose fractions fit into one texture; all where there are none.
    pub(crate) fn most_instances(device: &wgpu::Device, vertices: usize, lights: usize) -> usize {
        let allowed = device.limits().max_texture_dimension_2d;
        let fits = |instances: usize| {
            texture_rows(vertices * instances, lights).is_some_and(|rows| rows <= allowed)
        };
        let most = gpu::MAX_BATCH as usize;
        if fits(1) {
            (1..=most).rev().find(|&count| fits(count)).unwrap_or(1)
        } else {
            most
        }
    }

    /// `vertex_stamp` of the frame of an instance.
    pub(crate) fn stamp(&self, instance: usize) -> u32 {
        let of = &self.lights[instance];
        of.light << FRAME_BITS | of.frame
    }

    /// Workgroups of `vertices_main` for an instance.
    pub(crate) fn workgroups(&self) -> [u32; 2] {
        [(self.vertices as u32).div_ceil(64), self.quads as u32]
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
