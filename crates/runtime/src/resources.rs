//! What shading instances of one scene takes, kept from frame to frame.

use std::ops::Range;

use relight_shading::gpu::{self, LimitError};
use relight_shading::prefiltered::Prefiltered;
use relight_shading::shade::Method;
use relight_shading::vertex_visibility;

use crate::frame::LocalFrame;
use crate::loading::check_storage;
use crate::shadow_map::BoundMap;
use crate::tiles::{self, Dispatch, Region, Tiling};
use crate::transfer::Slot;
use crate::upload::ProductsOfLight;
use crate::vertex_lights::VertexLights;
use crate::{Error, Frame, GpuScene, Renderer};

/// Bytes of the uniforms that kernels are bound to.
pub(crate) const FRAMES_BYTES: u64 = (gpu::MAX_BATCH as usize * size_of::<gpu::Frame>()) as u64;
pub(crate) const TILES_BYTES: u64 = 4 * gpu::MAX_TILES_AT_ONCE as u64;

/// Buffers and bind groups of instances of one scene, at most [`gpu::MAX_BATCH`], in one view.
#[derive(Debug, Default)]
pub(crate) struct Resources {
    frames: Slot,
    tiles: Slot,
    lights: Slot,
    points: Slot,
    products: Option<ProductsOfLight>,
    /// Of group 0: the image that is reflected, [`Self::products`] and fractions.
    views: Option<[wgpu::TextureView; 3]>,
    /// Group 0.
    frame_group: Option<wgpu::BindGroup>,
    /// With `polar`, what vertices see of distant lights.
    vertex_lights: Option<VertexLights>,
    /// Group 0 of kernels of vertices.
    vertex_group: Option<wgpu::BindGroup>,
    /// Group 0 of the passes for sources.
    source_group: Option<wgpu::BindGroup>,
    shadow_map: BoundMap,
    /// Where instances may be seen, if anywhere.
    regions: Vec<Option<Region>>,
    dispatches: Vec<Dispatch>,
    /// Whether these shade all rows.
    whole: bool,
    /// As many workgroups as instances may be seen, a tile of each.
    per_instance: Dispatch,
}

/// An instance in the order of a frame.
#[derive(Clone, Copy)]
pub(crate) struct Numbered {
    /// What the visibility buffer has for its first triangle.
    pub(crate) first_id: u32,
    /// Its number.
    pub(crate) index: u32,
    /// Where it may be seen, if anywhere.
    pub(crate) region: Option<Region>,
}

/// What kernels of vertices are run with.
pub(crate) struct VertexWork<'a> {
    /// Groups 0 and 2.
    pub(crate) groups: [&'a wgpu::BindGroup; 2],
    /// Where tiles of instances begin, for the kernel that finds fractions, and its workgroups.
    pub(crate) offset: u32,
    pub(crate) workgroups: [u32; 3],
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

    /// None of the instances is seen.
    pub(crate) fn leave(&mut self) {
        self.regions.clear();
        self.dispatches.clear();
        self.whole = true;
    }

    /// Fills everything for one picture.
    pub(crate) fn fill(
        &mut self,
        renderer: &Renderer,
        scene: &GpuScene,
        frame: &Frame,
        prefiltered: &wgpu::TextureView,
        (tiling, rows): (Tiling, &Range<u32>),
        instances: &[&(LocalFrame, Numbered)],
    ) -> Result<(), Error> {
        self.regions.clear();
        (self.regions).extend(instances.iter().map(|(_, numbered)| numbered.region));
        self.list_tiles(renderer, tiling, rows)?;
        let distant: Vec<_> = (instances.iter())
            .map(|(local, _)| packed_lights(frame, local))
            .collect();
        self.vertex_lights = match frame.method {
            Method::Polar(_) => {
                let kept = self.vertex_lights.take();
                VertexLights::next_frame(kept, renderer, scene, &distant)
            }
            Method::Ambient | Method::Cells(_) => None,
        };
        let first_extra_row = Region::first_extra_row(tiling.size, frame.antialias);
        let uniform = |(place, (local, numbered)): (usize, &&(LocalFrame, Numbered))| gpu::Frame {
            first_id: numbered.first_id,
            instance: numbered.index,
            vertex_stamp: (self.vertex_lights.as_ref()).map_or(0, |kept| kept.stamp(place)),
            first_extra_row,
            ..uniforms(scene, frame, local)
        };
        let frames: Vec<gpu::Frame> = instances.iter().enumerate().map(uniform).collect();
        let mut lights = Vec::new();
        for (distant, (local, _)) in distant.into_iter().zip(instances) {
            lights.extend(distant);
            let entries = local.local_lights.iter().map(gpu::LocalLight::entries);
            lights.extend(entries.flatten());
        }
        let bytes = size_of_val(&lights[..]) as u64;
        check_storage(renderer.device(), bytes).map_err(Error::Frame)?;
        let (uniform, storage) = (wgpu::BufferUsages::UNIFORM, wgpu::BufferUsages::STORAGE);
        let frames = bytemuck::cast_slice(&frames);
        let lights = bytemuck::cast_slice(&lights);
        // A binding must not be empty.
        let light = size_of::<gpu::Light>() as u64;
        let new = [
            (self.frames).fill(renderer, "relight frames", frames, FRAMES_BYTES, uniform)?,
            (self.lights).fill(renderer, "relight lights", lights, light, storage)?,
        ];
        let locals = instances.iter().map(|(local, _)| local);
        let products = scene.products(renderer.device(), &mut self.products, locals)?;
        let fractions = (self.vertex_lights.as_ref())
            .map_or_else(|| renderer.no_fractions(), |lights| &lights.fractions);
        let views = Some([prefiltered.clone(), products, fractions.clone()]);
        if new.contains(&true) {
            self.forget_groups();
        }
        if self.views != views {
            self.frame_group = None;
            self.views = views;
        }
        self.bind_frames(renderer);
        let lookups = instances.iter().map(|(local, _)| local.shadow_map);
        let layout = renderer.shadow_map_layout();
        self.shadow_map
            .fill(renderer, layout, frame.shadow_map.as_ref(), lookups)?;
        self.fill_sources(renderer, scene, instances)
    }

    /// Makes group 0, unless it is there.
    fn bind_frames(&mut self, renderer: &Renderer) {
        if let (Some(views), None) = (&self.views, &self.frame_group) {
            let buffers = [&self.frames, &self.lights, &self.tiles].map(Slot::buffer);
            self.frame_group = Some(renderer.frame_group(buffers, views));
        }
    }

    fn forget_groups(&mut self) {
        self.frame_group = None;
        self.vertex_group = None;
        self.source_group = None;
    }

    /// Lists the tiles of all rows. What is recorded already keeps those that it was recorded with.
    pub(crate) fn list_all(&mut self, renderer: &Renderer, tiling: Tiling) -> Result<(), Error> {
        if !self.whole {
            self.tiles = Slot::default();
            self.list_tiles(renderer, tiling, &(0..tiling.size[1]))?;
            self.bind_frames(renderer);
        }
        Ok(())
    }

    /// Lists the tiles that instances may be seen in, of some rows of the picture.
    fn list_tiles(
        &mut self,
        renderer: &Renderer,
        tiling: Tiling,
        rows: &Range<u32>,
    ) -> Result<(), Error> {
        self.whole = *rows == (0..tiling.size[1]);
        let (mut words, dispatches) = tiles::list(&self.regions, tiling, rows);
        self.dispatches = dispatches;
        self.per_instance = tiles::list_instances(&self.regions, &mut words);
        // What the last dispatch is bound to ends behind it.
        let room = u64::from(self.per_instance.offset) + TILES_BYTES;
        let words = bytemuck::cast_slice(&words);
        let usage = wgpu::BufferUsages::UNIFORM;
        if (self.tiles).fill(renderer, "relight tiles", words, room, usage)? {
            self.forget_groups();
        }
        Ok(())
    }

    /// The same for the passes for sources.
    fn fill_sources(
        &mut self,
        renderer: &Renderer,
        scene: &GpuScene,
        instances: &[&(LocalFrame, Numbered)],
    ) -> Result<(), Error> {
        let all: Vec<_> = (instances.iter())
            .filter_map(|(local, _)| local.sources.as_ref())
            .collect();
        if all.is_empty() {
            self.source_group = None;
            return Ok(());
        }
        (scene.sources.as_ref()).map_err(|error| Error::Scene(error.clone()))?;
        let points: Vec<gpu::SourcePoint> = (all.iter())
            .flat_map(|sources| sources.points())
            .map(|point| gpu::SourcePoint {
                ray_offset: scene.ray_offset,
                ..*point
            })
            .collect();
        let bytes = size_of_val(&points[..]) as u64;
        check_storage(renderer.device(), bytes).map_err(Error::Frame)?;
        let points = bytemuck::cast_slice(&points);
        let storage = wgpu::BufferUsages::STORAGE;
        let is_new = (self.points).fill(renderer, "relight sources", points, 0, storage)?;
        if is_new || self.source_group.is_none() {
            let buffers = [&self.frames, &self.tiles, &self.points];
            self.source_group = Some(renderer.source_group(buffers.map(Slot::buffer)));
        }
        Ok(())
    }

    /// What vertices see of distant lights, and group 0 of their kernels, if they are asked.
    pub(crate) fn bind_vertices(&mut self, renderer: &Renderer, visibility: &wgpu::TextureView) {
        let Some(vertex_lights) = &mut self.vertex_lights else {
            return;
        };
        if self.regions.is_empty() {
            return;
        }
        vertex_lights.bind(renderer, visibility);
        let buffers = [&self.frames, &self.lights, &self.tiles].map(Slot::buffer);
        (self.vertex_group).get_or_insert_with(|| renderer.vertex_frame_group(buffers));
    }

    /// The same, once bound.
    pub(crate) fn vertices(&self) -> Option<VertexWork<'_>> {
        let lights = self.vertex_lights.as_ref()?;
        let frame = self.vertex_group.as_ref()?;
        let Dispatch { offset, workgroups } = self.per_instance;
        let [x, y] = lights.workgroups();
        Some(VertexWork {
            groups: [frame, lights.group()],
            offset,
            workgroups: [x, y, workgroups],
        })
    }

    /// Group 0.
    pub(crate) fn frame_group(&self) -> &wgpu::BindGroup {
        (self.frame_group.as_ref()).expect("filled before it is drawn")
    }

    /// Group 0 of the passes for sources; `None` where the frame has none.
    pub(crate) fn source_group(&self) -> Option<&wgpu::BindGroup> {
        self.source_group.as_ref()
    }

    /// Group 3 of it, where the frame has a shadow map.
    pub(crate) fn shadow_group(&self) -> Option<&wgpu::BindGroup> {
        self.shadow_map.group()
    }

    /// Runs of instances that may be seen.
    pub(crate) fn seen(&self) -> impl Iterator<Item = Range<u32>> {
        let count = self.regions.len() as u32;
        let seen = |place: &u32| self.regions[*place as usize].is_some();
        let mut next = 0;
        std::iter::from_fn(move || {
            let start = (next..count).find(seen)?;
            next = (start..count).find(|place| !seen(place)).unwrap_or(count);
            Some(start..next)
        })
    }

    /// What shades them.
    pub(crate) fn dispatches(&self) -> &[Dispatch] {
        &self.dispatches
    }
}

/// Distant lights as an instance sees them, with their spokes at vertices.
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

/// All but what tells an instance from others of the picture.
fn uniforms(scene: &GpuScene, frame: &Frame, local: &LocalFrame) -> gpu::Frame {
    let mut uniform = gpu::Frame::new(&local.view, &scene.atlas, scene.distance_clamp);
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
    uniform.vertex_count = scene.vertex_count as u32;
    uniform.product_count = scene.product_count() as u32;
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
