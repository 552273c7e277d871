//! The passes that shade by lobes, see `relight_shading::slots`: many small kernels, one after the other,
//! for as many tiles as there are slots for.

use std::sync::OnceLock;

use relight_shading::pixel_visibility::COARSE_PIXELS;
use relight_shading::wgsl::{
    AROUND, DIFFUSE, IMAGES, INTEGRALS, Kernel, PRODUCTS, REFLECTIONS, SEEN_TEXTURES, SHADE,
    SOURCES, SOURCES_COARSE, SOURCES_SHADOWED, SOURCES_SHOWN,
};
use relight_shading::{gpu, slots};

use crate::layouts::{
    STORAGE, buffer_entry, compute_pipeline, image_entries, layout_entry, scene_entries,
    source_image_layouts, texture_entry, written,
};
use crate::tiles::{Dispatch, WORKGROUP};
use crate::{Frame, GpuScene, Method, shadow_map};

/// Pixels of a workgroup.
const WORKGROUP_PIXELS: u32 = WORKGROUP * WORKGROUP;

/// Workgroups of an image that are shaded at a time: what their slots take of memory is all that the passes take.
/// Those of so many rows are wanted, and `most` at most; buffers of slots have at most `most_bytes`.
pub(crate) fn tiles_at_once(
    [width, height]: [u32; 2],
    [rows, most]: [u32; 2],
    most_bytes: u64,
) -> u32 {
    let [columns, all, rows] = [width, height, rows].map(|side| side.div_ceil(WORKGROUP).max(1));
    let fitting = most_bytes / u64::from(WORKGROUP_PIXELS * slots::BYTES);
    let most = fitting.clamp(1, u64::from(most.min(gpu::MAX_TILES_AT_ONCE))) as u32;
    columns.saturating_mul(all.min(rows)).min(most)
}

/// Bindings of group 1 of kernels that know materials, and of those that know visibility.
pub(crate) const SCENE_BINDINGS: [&[u32]; 2] = [&[0, 1, 4, 5], &[0, 1, 2, 3, 6, 7, 10]];

/// Layouts and pipelines, these made when they are first needed.
#[derive(Debug)]
pub(crate) struct LobePasses {
    device: wgpu::Device,
    frame: wgpu::BindGroupLayout,
    /// Groups 1, see [`SCENE_BINDINGS`].
    pub(crate) scenes: [wgpu::BindGroupLayout; 2],
    /// Groups 2 of the kernels that find textures and reflections, and of the others.
    images: [wgpu::BindGroupLayout; 2],
    textures: [OnceLock<wgpu::ComputePipeline>; 2],
    reflections: [OnceLock<wgpu::ComputePipeline>; 2],
    diffuse: [OnceLock<wgpu::ComputePipeline>; 2],
    products: [OnceLock<wgpu::ComputePipeline>; 2],
    integrals: [OnceLock<wgpu::ComputePipeline>; 4],
    around: [OnceLock<wgpu::ComputePipeline>; 2],
    image: OnceLock<wgpu::ComputePipeline>,
    shade: [OnceLock<wgpu::ComputePipeline>; 2],
    /// Groups 0 and 1 of the passes for sources.
    pub(crate) sources: [wgpu::BindGroupLayout; 2],
    /// Groups 2 of that for their points and of that for what is shown of them.
    pub(crate) source_images: [wgpu::BindGroupLayout; 2],
    /// Group 3 of that for their points, with an app's shadow map.
    pub(crate) shadow_map: wgpu::BindGroupLayout,
    source_points_coarse: OnceLock<wgpu::ComputePipeline>,
    source_points: OnceLock<wgpu::ComputePipeline>,
    source_points_shadowed: OnceLock<wgpu::ComputePipeline>,
    sources_shown: OnceLock<wgpu::ComputePipeline>,
}

/// Slots of one view.
#[derive(Debug)]
pub(crate) struct Slots {
    tiles: u32,
    /// Of the reflections and of what is gathered.
    buffers: [wgpu::Buffer; 2],
    /// As [`LobePasses::images`].
    groups: [wgpu::BindGroup; 2],
}

/// What an instance's light and materials make necessary.
#[derive(Clone, Copy, Debug)]
#[allow(
    clippy::struct_excessive_bools,
    reason = "each says that there is a pass"
)]
pub(crate) struct Work<'a> {
    /// Reflections of a material, at most.
    pub(crate) reflections: u32,
    /// Whether a material has textures.
    pub(crate) textured: bool,
    /// Whether one may be looked up by second texture coordinates.
    pub(crate) second_uvs: bool,
    pub(crate) distant_lights: usize,
    pub(crate) local_lights: usize,
    /// Whether a prefiltered image stands for the distant lights.
    pub(crate) image: bool,
    /// Whether light bounces.
    pub(crate) bounced: bool,
    /// Whether one visible fraction stands for all of a lobe.
    pub(crate) ambient: bool,
    /// Suns, lamps and windows, if there are any.
    pub(crate) sources: Option<SourceWork<'a>>,
}

/// Of [`SourceWork::images`].
const COARSE: usize = 0;
const ALL: usize = 1;
const SHOWN: usize = 2;

/// What passes for sources are given.
#[derive(Clone, Copy, Debug)]
pub(crate) struct SourceWork<'a> {
    pub(crate) count: u32,
    /// Groups 0 and 1.
    pub(crate) groups: [&'a wgpu::BindGroup; 2],
    /// Groups 2, see [`crate::images::Images::sources`].
    pub(crate) images: &'a [wgpu::BindGroup; 3],
    /// Group 3, with an app's shadow map.
    pub(crate) shadow_map: Option<&'a wgpu::BindGroup>,
}

impl<'a> Work<'a> {
    pub(crate) fn of(frame: &Frame, scene: &GpuScene, sources: Option<SourceWork<'a>>) -> Self {
        Self {
            sources,
            reflections: scene.reflections(),
            textured: scene.is_textured(),
            second_uvs: scene.second_uvs,
            distant_lights: frame.lights.len(),
            local_lights: frame.local_lights.len(),
            image: frame.reflections.is_some(),
            bounced: scene.is_bounced(),
            ambient: frame.method == Method::Ambient,
        }
    }
}

impl LobePasses {
    pub(crate) fn new(
        device: &wgpu::Device,
        frame: &wgpu::BindGroupLayout,
        sources: [wgpu::BindGroupLayout; 2],
    ) -> Self {
        let scene = |bindings: &[u32]| {
            let entries: Vec<_> = (scene_entries().into_iter())
                .filter(|entry| bindings.contains(&entry.binding))
                .map(|entry| wgpu::BindGroupLayoutEntry {
                    visibility: wgpu::ShaderStages::COMPUTE,
                    ..entry
                })
                .collect();
            layout(device, &entries)
        };
        let [visibility, radiance] = image_entries();
        let read = |binding| layout_entry(binding, wgpu::ShaderStages::COMPUTE, STORAGE);
        Self {
            device: device.clone(),
            frame: frame.clone(),
            scenes: SCENE_BINDINGS.map(scene),
            images: [
                layout(device, &[visibility, written(6), written(7)]),
                layout(device, &[visibility, radiance, read(6), written(7)]),
            ],
            textures: Default::default(),
            reflections: Default::default(),
            diffuse: Default::default(),
            products: Default::default(),
            integrals: Default::default(),
            around: Default::default(),
            image: OnceLock::new(),
            shade: Default::default(),
            sources,
            source_images: source_image_layouts(device),
            shadow_map: shadow_map::layout(device),
            source_points_coarse: OnceLock::new(),
            source_points: OnceLock::new(),
            source_points_shadowed: OnceLock::new(),
            sources_shown: OnceLock::new(),
        }
    }

    /// Slots for so many workgroups; the images are the visibility buffer and radiance.
    pub(crate) fn slots(&self, tiles: u32, images: [&wgpu::TextureView; 2]) -> Slots {
        let buffer = |label| {
            self.device.create_buffer(&wgpu::BufferDescriptor {
                label: Some(label),
                size: u64::from(tiles * WORKGROUP_PIXELS) * u64::from(slots::BYTES),
                usage: wgpu::BufferUsages::STORAGE,
                mapped_at_creation: false,
            })
        };
        let buffers = ["relight reflections", "relight gathered"].map(buffer);
        self.slots_of(tiles, buffers, images)
    }

    /// The same slots for other images: those of one are done with before another's begin.
    pub(crate) fn beside(&self, slots: &Slots, images: [&wgpu::TextureView; 2]) -> Slots {
        self.slots_of(slots.tiles, slots.buffers.clone(), images)
    }

    fn slots_of(
        &self,
        tiles: u32,
        buffers: [wgpu::Buffer; 2],
        images: [&wgpu::TextureView; 2],
    ) -> Slots {
        let group = |layout, textures: &[usize]| {
            let textures = textures.iter();
            let textures = textures.map(|&binding| texture_entry(binding as u32, images[binding]));
            let buffers = slot_entries(&buffers);
            self.device.create_bind_group(&wgpu::BindGroupDescriptor {
                label: Some("relight slots"),
                layout,
                entries: &textures.chain(buffers).collect::<Vec<_>>(),
            })
        };
        let [first, others] = &self.images;
        Slots {
            tiles,
            groups: [group(first, &[0]), group(others, &[0, 1])],
            buffers,
        }
    }

    /// Finds one reflection of what is seen of instances, and what it shows of sources: groups 0 and 1.
    pub(crate) fn record_reflection(
        &self,
        pass: &mut wgpu::ComputePass,
        (frame, scenes): (&wgpu::BindGroup, &[wgpu::BindGroup; 2]),
        (slots, Dispatch { offset, workgroups }): (&Slots, Dispatch),
        work: Work,
        reflection: u32,
    ) {
        let next = usize::from(reflection > 0);
        let mut run = |kernel: &OnceLock<wgpu::ComputePipeline>, made_of: &Kernel| {
            let layouts = [&self.frame, &self.scenes[0], &self.images[0]];
            let make = || compute_pipeline(&self.device, &layouts, made_of);
            pass.set_pipeline(kernel.get_or_init(make));
            pass.set_bind_group(0, frame, &[offset]);
            pass.set_bind_group(1, &scenes[0], &[]);
            pass.set_bind_group(2, &slots.groups[0], &[]);
            pass.dispatch_workgroups(workgroups, 1, 1);
        };
        // Lobes wait later where it is left what is seen of them.
        for (index, there_are) in [work.textured, work.second_uvs].into_iter().enumerate() {
            if there_are {
                run(&self.textures[index], &SEEN_TEXTURES[index]);
            }
        }
        run(&self.reflections[next], &REFLECTIONS[next]);
        let Some(sources) = work.sources else {
            return;
        };
        let mut run = |kernel: &OnceLock<wgpu::ComputePipeline>,
                       made_of: &Kernel,
                       scene,
                       images: usize,
                       z| {
            let (layout, group): (&wgpu::BindGroupLayout, &wgpu::BindGroup) = scene;
            let of_images = &self.source_images[usize::from(images == SHOWN)];
            let mut layouts = vec![&self.sources[0], layout, of_images];
            if let (true, Some(map)) = (*made_of == SOURCES_SHADOWED, sources.shadow_map) {
                layouts.push(&self.shadow_map);
                pass.set_bind_group(3, map, &[]);
            }
            let make = || compute_pipeline(&self.device, &layouts, made_of);
            pass.set_pipeline(kernel.get_or_init(make));
            pass.set_bind_group(0, sources.groups[0], &[offset]);
            pass.set_bind_group(1, group, &[]);
            pass.set_bind_group(2, &sources.images[images], &[]);
            pass.dispatch_workgroups(workgroups, 1, z);
        };
        // Which points are seen holds for the next reflections.
        if next == 0 {
            let scene = (&self.sources[1], sources.groups[1]);
            let (kernel, made_of) = match sources.shadow_map {
                None => (&self.source_points, &SOURCES),
                Some(_) => (&self.source_points_shadowed, &SOURCES_SHADOWED),
            };
            let coarse = &self.source_points_coarse;
            let at_once = WORKGROUP_PIXELS / COARSE_PIXELS;
            run(
                coarse,
                &SOURCES_COARSE,
                scene,
                COARSE,
                sources.count.div_ceil(at_once),
            );
            run(kernel, made_of, scene, ALL, sources.count);
        }
        let scene = (&self.scenes[0], &scenes[0]);
        run(&self.sources_shown, &SOURCES_SHOWN, scene, SHOWN, 1);
    }

    /// Shades what is seen of instances: groups 0 and 1.
    pub(crate) fn record(
        &self,
        pass: &mut wgpu::ComputePass,
        (frame, scenes): (&wgpu::BindGroup, &[wgpu::BindGroup; 2]),
        slots: &Slots,
        work: Work,
        dispatches: &[Dispatch],
    ) {
        let ambient = usize::from(work.ambient);
        for dispatch in dispatches {
            debug_assert!(
                dispatch.workgroups <= slots.tiles,
                "{dispatch:?}: {slots:?}"
            );
            let run = |pass: &mut wgpu::ComputePass,
                       kernel: &OnceLock<wgpu::ComputePipeline>,
                       made_of: &Kernel,
                       scene: usize| {
                let layouts = [&self.frame, &self.scenes[scene], &self.images[1]];
                let make = || compute_pipeline(&self.device, &layouts, made_of);
                pass.set_pipeline(kernel.get_or_init(make));
                pass.set_bind_group(0, frame, &[dispatch.offset]);
                pass.set_bind_group(1, &scenes[scene], &[]);
                pass.set_bind_group(2, &slots.groups[1], &[]);
                pass.dispatch_workgroups(dispatch.workgroups, 1, 1);
            };
            for reflection in 0..work.reflections.max(1) {
                let (groups, to) = ((frame, scenes), (slots, *dispatch));
                self.record_reflection(pass, groups, to, work, reflection);
                if reflection == 0 {
                    run(pass, &self.diffuse[ambient], &DIFFUSE[ambient], 1);
                }
                for (kind, there_is) in [work.bounced, work.image].into_iter().enumerate() {
                    if there_is {
                        run(pass, &self.around[kind], &AROUND[kind], 1);
                    }
                }
                if work.reflections == 0 {
                    continue;
                }
                // Of an image there is light from everywhere as well.
                let [lights, of_image] = if work.image {
                    [work.local_lights, work.distant_lights + 1]
                } else {
                    [work.distant_lights + work.local_lights, 0]
                };
                for (of_image, lights) in [lights, of_image].into_iter().enumerate() {
                    let kind = of_image + 2 * ambient;
                    for _ in 0..slots::rounds(lights) {
                        run(pass, &self.products[of_image], &PRODUCTS[of_image], 0);
                        run(pass, &self.integrals[kind], &INTEGRALS[kind], 1);
                    }
                }
                if work.image {
                    run(pass, &self.image, &IMAGES, 0);
                }
            }
            let kind = usize::from(work.second_uvs);
            run(pass, &self.shade[kind], &SHADE[kind], 0);
        }
    }
}

impl Slots {
    /// Their part of group 2 of bindings.wgsl: of the reflections and of what is gathered.
    pub(crate) fn entries(&self) -> [wgpu::BindGroupEntry<'_>; 2] {
        slot_entries(&self.buffers)
    }

    /// Workgroups that there are slots for.
    pub(crate) fn tiles(&self) -> u32 {
        self.tiles
    }
}

fn slot_entries([reflections, gathered]: &[wgpu::Buffer; 2]) -> [wgpu::BindGroupEntry<'_>; 2] {
    [buffer_entry(6, reflections), buffer_entry(7, gathered)]
}

fn layout(device: &wgpu::Device, entries: &[wgpu::BindGroupLayoutEntry]) -> wgpu::BindGroupLayout {
    device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
        label: Some("relight lobes"),
        entries,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tiles_of_an_image() {
        let allowed = wgpu::Limits::default().max_storage_buffer_binding_size;
        let tiles = |size, rows| tiles_at_once(size, [rows, u32::MAX], allowed);
        assert_eq!(tiles([320, 240], 128), 40 * 16);
        assert_eq!(tiles([9, 9], 128), 4);
        assert_eq!(tiles([9, 9], 0), 2);
        // As many as are listed in a uniform have as many slots as WebGPU's devices can bind.
        let most = gpu::MAX_TILES_AT_ONCE;
        assert_eq!(tiles([3840, 2160], u32::MAX), most);
        assert_eq!(tiles([u32::MAX; 2], u32::MAX), most);
        let wanted = [u32::MAX, u32::MAX];
        assert_eq!(tiles_at_once([3840, 2160], wanted, allowed / 2), most / 2);
        assert_eq!(tiles_at_once([3840, 2160], [128, 2048], allowed), 2048);
        assert_eq!(tiles_at_once([9, 9], wanted, 0), 1);
    }
}
