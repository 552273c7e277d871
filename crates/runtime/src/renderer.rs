//! The passes of one frame: visibility buffer, shading, into the target.
//!
//! Longer than other files: it is the order of a frame, from what is uploaded to what is composited, over the
//! state that all of its steps share.

#[cfg(feature = "paper")]
mod cells;
mod groups;

use groups::{one_texel, prefiltered_texture};

use std::collections::HashMap;
use std::ops::Range;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, OnceLock};

use relight_shading::gpu::{self, LimitError};
use relight_shading::shade;

use crate::fill_texture::FillPass;
use crate::frame::LocalFrame;
use crate::images::{ImageLayouts, Images, Needs, clear, shaded_size};
use crate::layouts::{
    frame_layout, image_layout, scene_layout, source_frame_layout, source_scene_layout,
    surface_frame_layout, surface_image_layout, vertex_frame_layout, vertex_image_layout,
    vertex_scene_layout, visibility_pipeline,
};
use crate::lobes::{self, LobePasses, Slots};
use crate::motion::MotionPass;
use crate::owner::Owner;
use crate::pass_times::{Pass, PassTimes, Recording, Timestamps};
use crate::resources::{FRAMES_BYTES, Numbered, Resources, first_ids};
use crate::tiles::{Region, Tiling, WORKGROUP};
use crate::transfer::filled_buffer;
use crate::upload::GpuScene;
use crate::view::World;
use crate::{Background, Error, Frame, Instance, Options, Placement, View, composite};

/// Images that are reflected, or behind scenes, that are kept on the GPU.
const KEPT_IMAGES: usize = 8;

/// Texels and what they are on the GPU.
type KeptImages = Vec<(Arc<[u32]>, wgpu::TextureView)>;

/// An instance's frame, its number and where it is seen.
type PlacedFrame = (LocalFrame, Numbered);

/// Draws scenes with an app's device and queue. It may be shared by threads.
#[derive(Debug)]
pub struct Renderer {
    device: wgpu::Device,
    queue: wgpu::Queue,
    options: Options,
    frame_layout: wgpu::BindGroupLayout,
    scene_layout: wgpu::BindGroupLayout,
    image_layout: wgpu::BindGroupLayout,
    /// Of the pass for surfaces.
    surface_layouts: [wgpu::BindGroupLayout; 2],
    /// For pixels of one surface and of several.
    composite_layouts: [wgpu::BindGroupLayout; 2],
    visibility_pipeline: wgpu::RenderPipeline,
    /// Groups 0, 1 and 2 of the kernels of vertices.
    vertex_layouts: [wgpu::BindGroupLayout; 3],
    kernels: Arc<Kernels>,
    lobes: Arc<LobePasses>,
    /// The same with four samples per pixel, and the surfaces among them; made when first needed.
    surface_pipelines: OnceLock<(wgpu::RenderPipeline, wgpu::ComputePipeline)>,
    /// Into passes of the app's, for pixels of one surface and of several; made when first needed.
    composite_pipelines: [OnceLock<composite::Pipelines>; 2],
    /// The same into a target that is cleared.
    target_pipelines: [OnceLock<composite::Pipelines>; 2],
    tables: wgpu::Buffer,
    /// Images that are reflected or behind scenes, the last one first.
    prefiltered: Arc<Mutex<KeptImages>>,
    /// One texel.
    no_image: wgpu::TextureView,
    /// One texel.
    no_fractions: wgpu::TextureView,
    /// Of [`Self::render`].
    own: Option<View>,
    timestamps: Option<Timestamps>,
    owner: Owner,
    /// How many were prepared, by all that share pipelines.
    frames: Arc<AtomicU64>,
}

/// The compute pipelines, each made when it is first needed: no frame needs all.
#[derive(Debug, Default)]
struct Kernels {
    vertices_mark: OnceLock<wgpu::ComputePipeline>,
    vertices: OnceLock<wgpu::ComputePipeline>,
    #[cfg(feature = "paper")]
    cells: [OnceLock<wgpu::ComputePipeline>; 2],
    motion: OnceLock<MotionPass>,
    fill: OnceLock<FillPass>,
}

impl Renderer {
    /// Builds the pipelines. The device needs WebGPU's default limits and no features.
    pub fn new(
        device: &wgpu::Device,
        queue: &wgpu::Queue,
        options: Options,
    ) -> Result<Self, Error> {
        check_device(device)?;
        options.check(device.features())?;
        let tables = filled_buffer(
            device,
            "relight tables",
            bytemuck::cast_slice(&shade::gpu_tables()),
            0,
            wgpu::BufferUsages::STORAGE,
        )?;
        let frame_layout = frame_layout(device);
        let scene_layout = scene_layout(device);
        let image_layout = image_layout(device);
        Ok(Self {
            visibility_pipeline: visibility_pipeline(device, [&frame_layout, &scene_layout], false),
            kernels: Arc::default(),
            lobes: Arc::new(LobePasses::new(
                device,
                &frame_layout,
                [source_frame_layout(device), source_scene_layout(device)],
            )),
            vertex_layouts: [
                vertex_frame_layout(device),
                vertex_scene_layout(device),
                vertex_image_layout(device),
            ],
            surface_pipelines: OnceLock::new(),
            surface_layouts: [surface_frame_layout(device), surface_image_layout(device)],
            composite_pipelines: Default::default(),
            target_pipelines: Default::default(),
            tables,
            prefiltered: Arc::default(),
            no_image: prefiltered_texture(device, queue, &[0]),
            no_fractions: one_texel(device),
            device: device.clone(),
            queue: queue.clone(),
            options,
            frame_layout,
            scene_layout,
            image_layout,
            composite_layouts: [false, true].map(|surfaces| composite::layout(device, surfaces)),
            own: None,
            timestamps: Timestamps::new(device, queue),
            owner: Owner::default(),
            frames: Arc::default(),
        })
    }

    /// A renderer for other targets that shares everything else with this one: scenes and views may be
    /// used with both. Takes far less time than [`Self::new`].
    pub fn with_options(&self, options: Options) -> Result<Self, Error> {
        options.check(self.device.features())?;
        Ok(Self {
            device: self.device.clone(),
            queue: self.queue.clone(),
            frame_layout: self.frame_layout.clone(),
            scene_layout: self.scene_layout.clone(),
            image_layout: self.image_layout.clone(),
            surface_layouts: self.surface_layouts.clone(),
            composite_layouts: self.composite_layouts.clone(),
            visibility_pipeline: self.visibility_pipeline.clone(),
            vertex_layouts: self.vertex_layouts.clone(),
            kernels: self.kernels.clone(),
            lobes: self.lobes.clone(),
            no_fractions: self.no_fractions.clone(),
            surface_pipelines: self.surface_pipelines.clone(),
            composite_pipelines: Default::default(),
            target_pipelines: Default::default(),
            tables: self.tables.clone(),
            prefiltered: self.prefiltered.clone(),
            no_image: self.no_image.clone(),
            own: None,
            timestamps: Timestamps::new(&self.device, &self.queue),
            owner: self.owner.clone(),
            frames: self.frames.clone(),
            options,
        })
    }

    /// Groups 1 that scenes are bound in, in the order of [`GpuScene`]'s.
    pub(crate) fn scene_layouts(&self) -> [&wgpu::BindGroupLayout; 5] {
        let [materials, visibility] = &self.lobes.scenes;
        [
            &self.scene_layout,
            &self.lobes.sources[1],
            &self.vertex_layouts[1],
            materials,
            visibility,
        ]
    }

    pub(crate) fn shadow_map_layout(&self) -> &wgpu::BindGroupLayout {
        &self.lobes.shadow_map
    }

    pub(crate) fn owner(&self) -> &Owner {
        &self.owner
    }

    /// How many frames were prepared.
    pub(crate) fn frames(&self) -> &AtomicU64 {
        &self.frames
    }

    /// Images of `width` × `height` pixels, for one camera.
    pub fn view(&self, [width, height]: [u32; 2]) -> Result<View, Error> {
        self.check_size(width, height)?;
        Ok(View::new(&self.owner, [width, height]))
    }

    /// Records the drawing and shading of one frame into the view's images, outside of any pass.
    /// [`Self::composite`] then draws them into a pass recorded after it.
    ///
    /// A view holds what it was prepared with last, by the time of a submission: prepare it once per
    /// submission. Several cameras take several views.
    ///
    /// The cost is that of the pixels that instances cover and, less, of the boxes around them; a few
    /// microseconds of the processor for each instance, and a few dispatches for every 128 of one scene.
    ///
    /// # Errors
    /// What the frame, an instance or the device cannot; nothing is drawn then.
    pub fn prepare(
        &self,
        encoder: &mut wgpu::CommandEncoder,
        view: &mut View,
        instances: &[Instance],
        frame: &Frame,
    ) -> Result<(), Error> {
        let recording = self.timestamps.as_ref().and_then(Timestamps::begin);
        let rows = 0..view.size()[1];
        self.prepare_timed(encoder, view, instances, frame, rows, recording.as_ref())?;
        if let Some(recording) = recording {
            recording.end(encoder, 2);
        }
        Ok(())
    }

    /// [`Self::prepare`] of a part of a frame, for apps that submit long frames in parts and may
    /// stop between them. The part that begins with row 0 draws all triangles; each shades the tiles
    /// of 8 rows that begin within `rows`. All parts are of the same frame,
    /// each is submitted by itself, and nothing else is prepared into the view between them. They are
    /// not timed.
    pub fn prepare_rows(
        &self,
        encoder: &mut wgpu::CommandEncoder,
        view: &mut View,
        instances: &[Instance],
        frame: &Frame,
        rows: Range<u32>,
    ) -> Result<(), Error> {
        self.prepare_timed(encoder, view, instances, frame, rows, None)
    }

    /// Draws what the view was prepared with into a pass of the app's: over what is there, or
    /// behind it where the pass has depth that says so. Where no instance is seen there is the
    /// [`Frame::background`], if any, as far away as depth goes: over all of the viewport in passes without
    /// depth, else where nothing nearer was drawn before.
    ///
    /// The pass is as [`Options`] describe it, on the device of the renderer; `wgpu` reports
    /// one that is not as an invalid pipeline. The view fills the viewport, which a pass may move by
    /// [`wgpu::RenderPass::set_viewport`]; scissors hold. Pipeline, bind group 0 and nothing else of
    /// the pass's state are changed.
    pub fn composite(&self, view: &View, pass: &mut wgpu::RenderPass) -> Result<(), Error> {
        self.check_view(view)?;
        if view.drawing.group().is_none() {
            return Err(Error::NotPrepared);
        }
        (self.composite_pipelines(view.antialias())).draw(pass, &view.drawing);
        Ok(())
    }

    /// Records one frame into `target`, a view of `width` × `height` pixels in the format
    /// of [`Options::target_format`], without depth and of one sample. Alpha is coverage; without
    /// a [`Frame::background`] the rest is transparent black.
    pub fn render(
        &mut self,
        encoder: &mut wgpu::CommandEncoder,
        scene: &GpuScene,
        frame: &Frame,
        target: &wgpu::TextureView,
        size: [u32; 2],
    ) -> Result<(), Error> {
        self.check_target(target.texture(), size)?;
        let mut view = match self.own.take() {
            Some(view) if view.size() == size => view,
            _ => self.view(size)?,
        };
        // Several calls may share one encoder.
        let resources = view.resources.iter_mut().chain(&mut view.open);
        resources.for_each(Resources::renew);
        view.drawing.renew();
        view.world = World::default();
        let recording = self.timestamps.as_ref().and_then(Timestamps::begin);
        let instances = [Instance::from(scene)];
        let rows = 0..size[1];
        self.prepare_timed(
            encoder,
            &mut view,
            &instances,
            frame,
            rows,
            recording.as_ref(),
        )?;
        {
            let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
                label: Some("relight target"),
                color_attachments: &[Some(wgpu::RenderPassColorAttachment {
                    view: target,
                    depth_slice: None,
                    resolve_target: None,
                    ops: wgpu::Operations {
                        load: wgpu::LoadOp::Clear(wgpu::Color::TRANSPARENT),
                        store: wgpu::StoreOp::Store,
                    },
                })],
                timestamp_writes: recording.as_ref().map(|times| times.render(Pass::Tonemap)),
                ..Default::default()
            });
            (self.target_pipelines(frame.antialias)).draw(&mut pass, &view.drawing);
        }
        if let Some(recording) = recording {
            recording.end(encoder, 3);
        }
        self.own = Some(view);
        Ok(())
    }

    fn prepare_timed(
        &self,
        encoder: &mut wgpu::CommandEncoder,
        view: &mut View,
        instances: &[Instance],
        frame: &Frame,
        rows: Range<u32>,
        recording: Option<&Recording>,
    ) -> Result<(), Error> {
        self.check_view(view)?;
        let (drawn_frames, world) = self.place(view.size(), instances, frame)?;
        let behind = match &frame.background {
            Background::Panorama { image, .. } => Some(image.levels()),
            Background::Transparent | Background::Color(_) => None,
        };
        let behind = self.image(behind)?;
        let catches = (instances.iter()).any(|instance| instance.scene.open.is_some());
        self.make_images(view, frame, catches)?;
        self.fill(view, instances, frame, &drawn_frames, &rows)?;
        let images = view.images.as_ref().expect("just made");
        let uniform = composite::uniform(view.size(), frame, &world.view, &self.options);
        let layout = &self.composite_layouts[usize::from(frame.antialias)];
        (view.drawing).fill(self, layout, images, &behind, uniform)?;
        // Not in the app's pass.
        (self.composite_pipelines(frame.antialias)).prepare(&view.drawing);
        if frame.antialias {
            let world = gpu::Frame::of_view(&world.view);
            let uniform = bytemuck::bytes_of(&world);
            let usage = wgpu::BufferUsages::UNIFORM;
            if (view.world.slot).fill(self, "relight world", uniform, FRAMES_BYTES, usage)? {
                view.world.group = Some(self.world_group(view.world.slot.buffer()));
            }
        }

        for resources in view.resources.iter_mut().chain(&mut view.open) {
            resources.bind_vertices(self, &images.seen_view);
        }
        let scene = |batch: &Vec<u32>| instances[batch[0] as usize].scene;
        let drawn = view.batches.iter().map(scene).zip(&view.resources);
        if rows.start == 0 {
            clear(encoder, &images.radiance_view);
            if let Some(open) = &images.open {
                clear(encoder, &open.view);
            }
            let mut pass = visibility_pass(encoder, images, recording);
            pass.set_pipeline(if frame.antialias {
                &self.surface_pipelines().0
            } else {
                &self.visibility_pipeline
            });
            for (scene, resources) in drawn.clone() {
                for seen in resources.seen() {
                    pass.set_bind_group(0, resources.frame_group(), &[0]);
                    pass.set_bind_group(1, &scene.bind_group, &[]);
                    pass.draw(0..3 * scene.triangle_count, seen);
                }
            }
        }
        let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
            label: Some("relight shade"),
            timestamp_writes: recording.map(|times| times.compute(Pass::Shade)),
        });
        if let (0, Some(world), Some(surfaces)) = (rows.start, &view.world.group, &images.surfaces)
        {
            pass.set_pipeline(&self.surface_pipelines().1);
            pass.set_bind_group(0, world, &[]);
            pass.set_bind_group(1, surfaces, &[]);
            let [x, y] = view.size().map(|side| side.div_ceil(WORKGROUP));
            pass.dispatch_workgroups(x, y, 1);
        }
        // What catches shadows is shaded once more, without what hides light.
        let open = (drawn.clone().zip(&view.open)).filter_map(|((scene, _), resources)| {
            let open = images.open.as_ref()?;
            let scene = scene.open.as_deref()?;
            Some((scene, resources, (&open.bind_group, &open.slots)))
        });
        let drawn =
            drawn.map(|(scene, resources)| (scene, resources, (&images.bind_group, &images.slots)));
        for (scene, resources, targets) in drawn.chain(open) {
            self.shade(&mut pass, (scene, resources), images, targets, frame);
        }
        self.frames.fetch_add(1, Ordering::Relaxed);
        Ok(())
    }

    /// Fills what instances are drawn with.
    fn fill(
        &self,
        view: &mut View,
        instances: &[Instance],
        frame: &Frame,
        placed: &[PlacedFrame],
        rows: &Range<u32>,
    ) -> Result<(), Error> {
        let image = self.image(frame.reflections)?;
        let images = view.images.as_ref().expect("made before");
        let tiling = Tiling {
            size: view.size(),
            antialias: frame.antialias,
            at_once: images.slots.tiles(),
        };
        view.batches = self.batches(instances, frame.lights.len());
        let count = view.batches.len();
        view.resources.resize_with(count, Default::default);
        let open = images.open.as_ref().map_or(0, |_| count);
        view.open.resize_with(open, Default::default);
        for (index, batch) in view.batches.iter().enumerate() {
            let scene = instances[batch[0] as usize].scene;
            let placed: Vec<_> = (batch.iter())
                .map(|&index| &placed[index as usize])
                .collect();
            if placed.iter().all(|(_, numbered)| numbered.region.is_none()) {
                let resources = view.resources.get_mut(index).into_iter();
                resources
                    .chain(view.open.get_mut(index))
                    .for_each(Resources::leave);
                continue;
            }
            let part = (tiling, rows);
            view.resources[index].fill(self, scene, frame, &image, part, &placed)?;
            match (view.open.get_mut(index), &scene.open) {
                (Some(open), Some(scene)) => {
                    // Without what hides light, the app's things among it.
                    let frame = &Frame {
                        shadow_map: None,
                        ..frame.clone()
                    };
                    open.fill(self, scene, frame, &image, part, &placed)?;
                }
                (Some(open), None) => *open = Resources::default(),
                (None, _) => {}
            }
        }
        Ok(())
    }

    /// Numbers of the instances that are shaded together: those of a scene, as many as fit.
    fn batches(&self, instances: &[Instance], lights: usize) -> Vec<Vec<u32>> {
        let mut batches: Vec<Vec<u32>> = Vec::new();
        // By scene: the batch that its next instance joins, and how many that may have.
        let mut filled: HashMap<*const GpuScene, (usize, usize)> = HashMap::new();
        for (index, instance) in (0..).zip(instances) {
            let scene = instance.scene;
            let (batch, most) = (filled.entry(std::ptr::from_ref(scene)))
                .or_insert_with(|| (usize::MAX, scene.most_instances(&self.device, lights)));
            match batches.get_mut(*batch) {
                Some(batch) if batch.len() < *most => batch.push(index),
                _ => {
                    *batch = batches.len();
                    batches.push(vec![index]);
                }
            }
        }
        batches
    }

    /// Shades instances of one scene into the image that the group and the slots have.
    fn shade(
        &self,
        pass: &mut wgpu::ComputePass,
        (scene, resources): (&GpuScene, &Resources),
        images: &Images,
        targets: (&wgpu::BindGroup, &Slots),
        frame: &Frame,
    ) {
        if resources.dispatches().is_empty() {
            return;
        }
        let groups = (resources.frame_group(), &scene.lobe_groups);
        let sources = frame.sources.as_ref().map(|sources| sources.count() as u32);
        let sources = sources.and_then(|count| {
            Some(lobes::SourceWork {
                count,
                groups: [resources.source_group()?, scene.sources.as_ref().ok()?],
                images: images.sources.as_ref()?,
                shadow_map: resources.shadow_group(),
            })
        });
        let work = lobes::Work::of(frame, scene, sources);
        #[cfg(feature = "paper")]
        if let shade::Method::Cells(_) = frame.method {
            for &dispatch in resources.dispatches() {
                if work.sources.is_some() {
                    for reflection in 0..work.reflections.max(1) {
                        let to = (targets.1, dispatch);
                        (self.lobes).record_reflection(pass, groups, to, work, reflection);
                    }
                }
                pass.set_pipeline(self.cells_pipeline(work.second_uvs));
                pass.set_bind_group(0, groups.0, &[dispatch.offset]);
                pass.set_bind_group(1, &scene.bind_group, &[]);
                pass.set_bind_group(2, targets.0, &[]);
                pass.dispatch_workgroups(dispatch.workgroups, 1, 1);
            }
            return;
        }
        if let Some(work) = resources.vertices() {
            let ([frame, images], [x, y, z]) = (work.groups, work.workgroups);
            let groups = [frame, &scene.vertex_group, images];
            dispatch_tiles(pass, self.mark_pipeline(), groups, resources);
            pass.set_pipeline(self.vertex_pipeline());
            pass.set_bind_group(0, frame, &[work.offset]);
            pass.set_bind_group(1, &scene.vertex_group, &[]);
            pass.set_bind_group(2, images, &[]);
            pass.dispatch_workgroups(x, y, z);
        }
        (self.lobes).record(pass, groups, targets.1, work, resources.dispatches());
    }

    /// Every instance's frame, its number and where it is seen; and the camera that they share.
    fn place(
        &self,
        size: [u32; 2],
        instances: &[Instance],
        frame: &Frame,
    ) -> Result<(Vec<PlacedFrame>, LocalFrame), Error> {
        let ids = first_ids(
            instances
                .iter()
                .map(|instance| instance.scene.triangle_count),
        )?;
        // One for all, or their depths would not compare.
        let near = (instances.iter())
            .map(|instance| instance.scene.near * instance.placement.scale)
            .fold(f32::INFINITY, f32::min);
        let place = |(index, (instance, first_id)): (u32, (&Instance, u32))| {
            if instance.scene.owner != self.owner {
                return Err(Error::Foreign { what: "scene" });
            }
            let local = frame.seen_from(&instance.placement, size, near)?;
            let numbered = Numbered {
                first_id,
                index,
                region: Region::of_box(&local.view, instance.scene.bounds, size),
            };
            Ok((local, numbered))
        };
        let world = frame.seen_from(&Placement::IDENTITY, size, near.min(f32::MAX))?;
        let drawn = (0..).zip(instances.iter().zip(ids)).map(place);
        Ok((drawn.collect::<Result<_, Error>>()?, world))
    }

    /// Makes the images of a view that has none, or others than are needed.
    fn make_images(&self, view: &mut View, frame: &Frame, open: bool) -> Result<(), Error> {
        let sources = frame.sources.as_ref();
        let sources = sources.map_or(0, |sources| sources.count() as u32);
        let shaded = shaded_size(view.size(), frame.antialias);
        let wanted = self.options.dispatch(&self.device);
        let most_bytes = self.device.limits().max_storage_buffer_binding_size;
        let slots = lobes::tiles_at_once(shaded, wanted, most_bytes);
        if view.images.as_ref().is_some_and(|images| {
            images.antialias() == frame.antialias
                && images.source_count >= sources
                && images.slots.tiles() >= slots
                && (images.open.is_some() || !open)
        }) {
            return Ok(());
        }
        let [width, height] = shaded;
        self.check_size(width, height)?;
        let layouts = ImageLayouts {
            shade: &self.image_layout,
            surfaces: &self.surface_layouts[1],
            lobes: &self.lobes,
            slots,
        };
        let size = view.size();
        let needs = Needs {
            sources,
            antialias: frame.antialias,
            open,
        };
        let images = Images::new(&self.device, &layouts, size, needs);
        view.images = Some(images);
        view.drawing.forget_images();
        Ok(())
    }

    /// How long the passes of a frame took: the last one whose times are known, some frames after
    /// it was submitted. Never waits. `None` before that, and where the device was made without
    /// [`wgpu::Features::TIMESTAMP_QUERY`].
    pub fn pass_times(&self) -> Option<PassTimes> {
        self.timestamps.as_ref().and_then(Timestamps::last)
    }

    /// [`View::radiance`] of the last frame that [`Self::render`] recorded. It is replaced when the
    /// size of frames changes.
    pub fn radiance(&self) -> Option<&wgpu::Texture> {
        self.own.as_ref().and_then(View::radiance)
    }

    /// [`View::visibility_buffer`] of the last frame that [`Self::render`] recorded.
    pub fn visibility_buffer(&self) -> Option<&wgpu::Texture> {
        self.own.as_ref().and_then(View::visibility_buffer)
    }

    #[cfg(feature = "offscreen")]
    pub(crate) fn own_view(&self) -> Option<&View> {
        self.own.as_ref()
    }

    /// The options that the renderer was made with.
    pub fn options(&self) -> &Options {
        &self.options
    }

    /// The device that the renderer was made on.
    pub fn device(&self) -> &wgpu::Device {
        &self.device
    }

    /// Its queue.
    pub fn queue(&self) -> &wgpu::Queue {
        &self.queue
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

    pub(crate) fn check_view(&self, view: &View) -> Result<(), Error> {
        if view.owner == self.owner {
            Ok(())
        } else {
            Err(Error::Foreign { what: "view" })
        }
    }

    fn check_target(&self, target: &wgpu::Texture, size: [u32; 2]) -> Result<(), Error> {
        self.check_size(size[0], size[1])?;
        let format = self.options.target_format;
        // Views may add or leave out the encoding of sRGB.
        let same_format = target.format() == format
            || target.format().remove_srgb_suffix() == format.remove_srgb_suffix();
        let drawn = wgpu::TextureUsages::RENDER_ATTACHMENT;
        let found = [target.width(), target.height()];
        // A view may be of another level than the first.
        let fits = found == size || target.mip_level_count() > 1;
        if same_format && target.sample_count() == 1 && target.usage().contains(drawn) && fits {
            return Ok(());
        }
        let text = |[width, height]: [u32; 2], format, samples, usage| {
            format!("{format:?}, {width}x{height}, {samples} samples, {usage:?}")
        };
        Err(Error::Target {
            expected: text(size, format, 1, drawn),
            found: text(
                found,
                target.format(),
                target.sample_count(),
                target.usage(),
            ),
        })
    }
}

/// Runs a kernel over the pixels of instances.
fn dispatch_tiles(
    pass: &mut wgpu::ComputePass,
    pipeline: &wgpu::ComputePipeline,
    groups: [&wgpu::BindGroup; 3],
    resources: &Resources,
) {
    pass.set_pipeline(pipeline);
    pass.set_bind_group(1, groups[1], &[]);
    pass.set_bind_group(2, groups[2], &[]);
    for dispatch in resources.dispatches() {
        pass.set_bind_group(0, groups[0], &[dispatch.offset]);
        pass.dispatch_workgroups(dispatch.workgroups, 1, 1);
    }
}

fn visibility_pass<'a>(
    encoder: &'a mut wgpu::CommandEncoder,
    images: &Images,
    recording: Option<&Recording>,
) -> wgpu::RenderPass<'a> {
    encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
        label: Some("relight visibility buffer"),
        color_attachments: &[Some(wgpu::RenderPassColorAttachment {
            view: &images.drawn_view,
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
                store: wgpu::StoreOp::Store,
            }),
            stencil_ops: None,
        }),
        timestamp_writes: recording.map(|times| times.render(Pass::VisibilityBuffer)),
        ..Default::default()
    })
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
            2,
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
    let uniforms = limits.max_uniform_buffer_binding_size;
    LimitError::check("max_uniform_buffer_binding_size", FRAMES_BYTES, uniforms)
        .map_err(Error::Device)
}
