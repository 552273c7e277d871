//! What shading one instance takes, kept from frame to frame.

use std::ops::Range;

use relight_shading::gpu::{self, LimitError};
use relight_shading::prefiltered::Prefiltered;
use relight_shading::shade::Method;
use relight_shading::sources;
use relight_shading::vertex_visibility;

use crate::frame::LocalFrame;
use crate::loading::check_storage;
use crate::transfer::filled_buffer;
use crate::upload::ProductsOfLight;
use crate::vertex_lights::VertexLights;
use crate::view::Region;
use crate::{Error, Frame, GpuScene, Renderer};

/// Bytes from the uniforms of one dispatch to those of the next: a multiple of the largest alignment
/// that WebGPU allows a device to ask for.
pub(crate) const UNIFORM_STRIDE: usize = 512;

/// A buffer that is filled again and again, and what it holds: what stays the same is not written
/// again.
#[derive(Debug, Default)]
pub(crate) struct Slot(Option<(wgpu::Buffer, Vec<u8>)>);

impl Slot {
    /// Fills it, by the next submission; makes a new one if it does not fit. Returns whether it is
    /// new.
    pub(crate) fn fill(
        &mut self,
        renderer: &Renderer,
        label: &str,
        contents: &[u8],
        usage: wgpu::BufferUsages,
    ) -> Result<bool, Error> {
        match &mut self.0 {
            Some((_, held)) if held == contents => Ok(false),
            Some((buffer, held)) if buffer.size() >= contents.len() as u64 => {
                renderer.queue().write_buffer(buffer, 0, contents);
                held.clear();
                held.extend_from_slice(contents);
                Ok(false)
            }
            _ => {
                let usage = usage | wgpu::BufferUsages::COPY_DST;
                let buffer = filled_buffer(renderer.device(), label, contents, usage)?;
                self.0 = Some((buffer, contents.to_vec()));
                Ok(true)
            }
        }
    }

    pub(crate) fn buffer(&self) -> &wgpu::Buffer {
        let (buffer, _) = self.0.as_ref().expect("filled before it is bound");
        buffer
    }
}

/// Uniforms one after the other, as dynamic offsets need them.
pub(crate) fn strided<T: bytemuck::Pod>(uniforms: &[T]) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(uniforms.len() * UNIFORM_STRIDE);
    for uniform in uniforms {
        bytes.extend_from_slice(bytemuck::bytes_of(uniform));
        bytes.resize(bytes.len().next_multiple_of(UNIFORM_STRIDE), 0);
    }
    bytes
}

/// Buffers and bind groups of one instance in one view.
#[derive(Debug, Default)]
pub(crate) struct Resources {
    uniforms: Slot,
    lights: Slot,
    local_lights: Slot,
    points: Slot,
    scales: Slot,
    products: Option<ProductsOfLight>,
    /// What it was made with, and group 0.
    frame_group: Option<([wgpu::TextureView; 3], wgpu::BindGroup)>,
    /// With `polar`, what vertices see of distant lights.
    vertex_lights: Option<VertexLights>,
    /// Group 0 of kernels of vertices.
    vertex_group: Option<wgpu::BindGroup>,
    /// Group 0 of the pass for sources.
    source_group: Option<wgpu::BindGroup>,
    /// Dispatches, by the uniforms' order, and the rows of the picture that they begin with.
    bands: Vec<(u32, Region)>,
}

/// An instance in the order of a frame.
#[derive(Clone, Copy)]
pub(crate) struct Numbered {
    /// What the visibility buffer has for its first triangle.
    pub(crate) first_id: u32,
    /// Its number.
    pub(crate) index: u32,
    /// Where it may be seen.
    pub(crate) region: Region,
    /// Rows of a dispatch.
    pub(crate) band: u32,
    /// Where further surfaces of its pixels are, with antialiasing.
    pub(crate) extras: Option<Region>,
}

impl Resources {
    /// Lets go of the buffers, so that what is recorded already keeps what it was recorded with.
    pub(crate) fn renew(&mut self) {
        let products = self.products.take();
        let vertex_lights = self.vertex_lights.take();
        *self = Self {
            products,
            vertex_lights,
            ..Self::default()
        };
    }

    /// It is not seen.
    pub(crate) fn leave(&mut self) {
        self.bands.clear();
    }

    /// Fills everything for one frame.
    pub(crate) fn fill(
        &mut self,
        renderer: &Renderer,
        scene: &GpuScene,
        frame: &Frame,
        local: &LocalFrame,
        numbered: Numbered,
        prefiltered: &wgpu::TextureView,
    ) -> Result<(), Error> {
        let mut uniform = uniforms(scene, frame, local);
        uniform.first_id = numbered.first_id;
        let lights = packed_lights(frame, local);
        self.vertex_lights = match frame.method {
            Method::Polar(_) => {
                let kept = self.vertex_lights.take();
                VertexLights::next_frame(kept, renderer, scene, &lights)
            }
            Method::Ambient | Method::Cells(_) => None,
        };
        uniform.vertex_stamp = (self.vertex_lights.as_ref()).map_or(0, VertexLights::stamp);
        uniform.instance = numbered.index;
        let bands = |region: Region| region.bands(numbered.band);
        self.bands = (bands(numbered.region).map(|band| (band.row, band))).collect();
        if let Some(extras) = numbered.extras {
            // Half as many rows for as many pixels.
            let first = numbered.region.row;
            let begin = |band: Region| (first + 2 * (band.row - extras.row), band);
            self.bands.extend(bands(extras).map(begin));
        }
        let first_extra = numbered.extras.map_or(u32::MAX, |extras| extras.row);
        let banded = |(_, band): &(u32, Region)| {
            uniform.pixels_apart = u32::from(band.row >= first_extra);
            band.uniform(&uniform)
        };
        let uniforms = strided(&self.bands.iter().map(banded).collect::<Vec<_>>());
        // A binding must not be empty.
        let none = [bytemuck::Zeroable::zeroed()];
        let lights = if lights.is_empty() {
            &none
        } else {
            &lights[..]
        };
        let bytes = size_of_val(lights) as u64;
        check_storage(renderer.device(), bytes).map_err(Error::Frame)?;
        let mut local_lights = local.local_lights.clone();
        local_lights.resize(gpu::MAX_LOCAL_LIGHTS as usize, bytemuck::Zeroable::zeroed());
        let (uniform, storage) = (wgpu::BufferUsages::UNIFORM, wgpu::BufferUsages::STORAGE);
        let lights = bytemuck::cast_slice(lights);
        let local_lights = bytemuck::cast_slice(&local_lights);
        let new = [
            (self.uniforms).fill(renderer, "relight frame", &uniforms, uniform)?,
            (self.lights).fill(renderer, "relight lights", lights, storage)?,
            (self.local_lights).fill(renderer, "relight local lights", local_lights, uniform)?,
        ];
        let products = scene.products(
            renderer.device(),
            &mut self.products,
            || local.bouncing_lights(),
            &local.local_lights,
        )?;
        let fractions = (self.vertex_lights.as_ref())
            .map_or_else(|| renderer.no_fractions(), |lights| &lights.fractions);
        let views = [prefiltered.clone(), products, fractions.clone()];
        if new[..2].contains(&true) {
            self.vertex_group = None;
        }
        if new.contains(&true)
            || self
                .frame_group
                .as_ref()
                .is_none_or(|(made, _)| *made != views)
        {
            let buffers = [&self.uniforms, &self.lights, &self.local_lights].map(Slot::buffer);
            let group = renderer.frame_group(buffers, &views);
            self.frame_group = Some((views, group));
        }
        self.fill_sources(renderer, scene, local, new[0])
    }

    /// The same for the pass for sources.
    fn fill_sources(
        &mut self,
        renderer: &Renderer,
        scene: &GpuScene,
        local: &LocalFrame,
        new_uniforms: bool,
    ) -> Result<(), Error> {
        let Some(sources) = &local.sources else {
            self.source_group = None;
            return Ok(());
        };
        (scene.sources.as_ref()).map_err(|error| Error::Scene(error.clone()))?;
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
        let (uniform, storage) = (wgpu::BufferUsages::UNIFORM, wgpu::BufferUsages::STORAGE);
        let points = bytemuck::cast_slice(&points);
        let scales = bytemuck::cast_slice(&scales);
        let new = [
            new_uniforms,
            (self.points).fill(renderer, "relight sources", points, storage)?,
            (self.scales).fill(renderer, "relight source scales", scales, uniform)?,
        ];
        if new.contains(&true) || self.source_group.is_none() {
            let buffers = [&self.uniforms, &self.points, &self.scales].map(Slot::buffer);
            self.source_group = Some(renderer.source_group(buffers));
        }
        Ok(())
    }

    /// What vertices see of distant lights, and group 0 of their kernels, if they are asked.
    pub(crate) fn bind_vertices(&mut self, renderer: &Renderer, visibility: &wgpu::TextureView) {
        let Some(vertex_lights) = &mut self.vertex_lights else {
            return;
        };
        vertex_lights.bind(renderer, visibility);
        let buffers = [&self.uniforms, &self.lights].map(Slot::buffer);
        (self.vertex_group).get_or_insert_with(|| renderer.vertex_frame_group(buffers));
    }

    /// The same, once bound: groups 0 and 2, and workgroups.
    pub(crate) fn vertices(&self) -> Option<([&wgpu::BindGroup; 2], [u32; 2])> {
        let lights = self.vertex_lights.as_ref()?;
        let frame = self.vertex_group.as_ref()?;
        Some(([frame, lights.group()], lights.workgroups()))
    }

    /// Group 0.
    pub(crate) fn frame_group(&self) -> &wgpu::BindGroup {
        let (_, group) = self
            .frame_group
            .as_ref()
            .expect("filled before it is drawn");
        group
    }

    /// Group 0 of the pass for sources; `None` where the frame has none.
    pub(crate) fn source_group(&self) -> Option<&wgpu::BindGroup> {
        self.source_group.as_ref()
    }

    /// Dispatches of the bands that begin within some rows: offset of the uniforms, and workgroups.
    pub(crate) fn dispatches(&self, rows: &Range<u32>) -> impl Iterator<Item = (u32, [u32; 2])> {
        (0..)
            .step_by(UNIFORM_STRIDE)
            .zip(&self.bands)
            .filter(|(_, (row, _))| rows.contains(row))
            .map(|(offset, (_, band))| (offset, band.workgroups()))
    }
}

/// Distant lights as the instance sees them, with their spokes at vertices.
fn packed_lights(frame: &Frame, local: &LocalFrame) -> Vec<gpu::Light> {
    let spokes = match frame.method {
        Method::Polar(options) => vertex_visibility::spokes(&local.lights, options),
        Method::Ambient | Method::Cells(_) => vec![0; local.lights.len()],
    };
    (local.lights.iter())
        .zip(spokes)
        .map(|(light, spokes)| gpu::Light {
            axis: light.axis.into(),
            sharpness: light.sharpness,
            amplitude: light.amplitude.into(),
            vertex_spokes: spokes as f32,
        })
        .collect()
}

/// All but what changes from dispatch to dispatch and from instance to instance.
fn uniforms(scene: &GpuScene, frame: &Frame, local: &LocalFrame) -> gpu::Frame {
    let mut uniform = gpu::Frame::new(&local.view, &scene.atlas, scene.distance_clamp);
    uniform.ambient = u32::from(frame.method == Method::Ambient);
    match frame.method {
        Method::Ambient => {}
        Method::Polar(options) => uniform.spokes = options.spokes.max(1),
        Method::Cells(options) => {
            uniform.boundary_error = options.boundary_error;
            uniform.lobe_error = options.lobe_error;
            uniform.cells = options.partition().unwrap_or([0; 2]);
        }
    }
    uniform.light_count = local.lights.len() as u32;
    uniform.source_count = (local.sources.as_ref()).map_or(0, |sources| sources.count() as u32);
    uniform.source_squares = u32::from(frame.antialias);
    uniform.local_light_count = local.local_lights.len() as u32;
    uniform.prefiltered_levels = frame.reflections.map_or(0, Prefiltered::levels);
    uniform.environment_rotation =
        (local.reflection_rotation.to_cols_array_2d()).map(|[x, y, z]| [x, y, z, 0.0]);
    uniform.triangle_count = scene.triangle_count;
    uniform.to_world = (local.to_world.to_cols_array_2d()).map(|[x, y, z]| [x, y, z, 0.0]);
    uniform
}

/// What the visibility buffer has for the first triangle of every instance.
pub(crate) fn first_ids(counts: impl Iterator<Item = u32>) -> Result<Vec<u32>, Error> {
    let mut next = 1u64;
    let mut first = Vec::new();
    for count in counts {
        first.push(next as u32);
        next += u64::from(count);
        LimitError::check("triangles of a frame", next, u64::from(u32::MAX))
            .map_err(Error::Frame)?;
    }
    Ok(first)
}
