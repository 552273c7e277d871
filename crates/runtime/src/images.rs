//! The images between the passes of a frame.

use relight_shading::pixel_visibility::COARSE_PIXELS;
use relight_shading::sources::{SEEN_COLUMNS, SEEN_TEXELS};
use relight_shading::surfaces::TILE;

use crate::layouts::{
    DEPTH_FORMAT, RADIANCE_FORMAT, SAMPLES_FORMAT, SOURCES_FORMAT, VISIBILITY_FORMAT, texture_entry,
};
use crate::lobes::{LobePasses, Slots};

/// Images between the passes, all of one size.
#[derive(Debug)]
pub(crate) struct Images {
    /// Where there is no antialiasing.
    pub(crate) visibility: Option<wgpu::Texture>,
    /// What is shaded: the visibility buffer, or items of pixels.
    pub(crate) seen_view: wgpu::TextureView,
    /// What the pass of triangles draws into.
    pub(crate) drawn_view: wgpu::TextureView,
    pub(crate) depth: wgpu::Texture,
    pub(crate) depth_view: wgpu::TextureView,
    pub(crate) radiance: wgpu::Texture,
    pub(crate) radiance_view: wgpu::TextureView,
    /// Which pixels show something: the visibility buffer, or the surfaces of pixels.
    pub(crate) shown_view: wgpu::TextureView,
    pub(crate) shown: wgpu::Texture,
    pub(crate) bind_group: wgpu::BindGroup,
    /// What the passes that shade by lobes hand on.
    pub(crate) slots: Slots,
    /// Groups 2 of the passes for sources, if there was one: for points of the coarse grid, for all, and for what is shown
    /// of them, see [`LobePasses::source_images`].
    pub(crate) sources: Option<[wgpu::BindGroup; 3]>,
    /// What catches shadows.
    pub(crate) open: Option<OpenImage>,
    /// Sources that there is room for.
    pub(crate) source_count: u32,
    /// Group 1 of the pass for surfaces, with antialiasing.
    pub(crate) surfaces: Option<wgpu::BindGroup>,
}

/// Radiance without what hides light.
#[derive(Debug)]
pub(crate) struct OpenImage {
    pub(crate) radiance: wgpu::Texture,
    pub(crate) view: wgpu::TextureView,
    /// In place of [`Images::bind_group`].
    pub(crate) bind_group: wgpu::BindGroup,
    /// In place of [`Images::slots`], whose memory they share.
    pub(crate) slots: Slots,
}

/// What images a frame needs beside those that all have.
#[derive(Clone, Copy)]
pub(crate) struct Needs {
    pub(crate) sources: u32,
    pub(crate) antialias: bool,
    /// Something catches shadows.
    pub(crate) open: bool,
}

/// Layouts of the groups that images are in.
pub(crate) struct ImageLayouts<'a> {
    pub(crate) shade: &'a wgpu::BindGroupLayout,
    pub(crate) surfaces: &'a wgpu::BindGroupLayout,
    pub(crate) lobes: &'a LobePasses,
    /// Slots that there is to be room for.
    pub(crate) slots: u32,
}

/// Columns and rows of what is shaded: a place for each pixel; with antialiasing, whole tiles of them,
/// and half as many rows of further surfaces below.
pub(crate) fn shaded_size([width, height]: [u32; 2], antialias: bool) -> [u32; 2] {
    if !antialias {
        return [width, height];
    }
    let [width, height] = [width, height].map(|side| side.next_multiple_of(TILE));
    [width, height + height / 2]
}

impl Images {
    #[allow(clippy::too_many_lines, reason = "one image after the other")]
    pub(crate) fn new(
        device: &wgpu::Device,
        layouts: &ImageLayouts,
        size: [u32; 2],
        needs: Needs,
    ) -> Self {
        let Needs {
            sources: source_count,
            antialias,
            open,
        } = needs;
        let texture = |label, format, usage, samples, [width, height]: [u32; 2]| {
            device.create_texture(&wgpu::TextureDescriptor {
                label: Some(label),
                size: wgpu::Extent3d {
                    width,
                    height,
                    depth_or_array_layers: 1,
                },
                mip_level_count: 1,
                sample_count: samples,
                dimension: wgpu::TextureDimension::D2,
                format,
                usage,
                view_formats: &[],
            })
        };
        let bound = wgpu::TextureUsages::TEXTURE_BINDING;
        let drawn = wgpu::TextureUsages::RENDER_ATTACHMENT | bound;
        let copied = wgpu::TextureUsages::COPY_SRC;
        let written = wgpu::TextureUsages::STORAGE_BINDING | bound;
        let view =
            |texture: &wgpu::Texture| texture.create_view(&wgpu::TextureViewDescriptor::default());
        let group = |label, layout, views: &[&wgpu::TextureView]| {
            let entries: Vec<_> = (0..)
                .zip(views)
                .map(|(binding, view)| wgpu::BindGroupEntry {
                    binding,
                    resource: wgpu::BindingResource::TextureView(view),
                })
                .collect();
            device.create_bind_group(&wgpu::BindGroupDescriptor {
                label: Some(label),
                layout,
                entries: &entries,
            })
        };
        let shaded = shaded_size(size, antialias);
        // Drawn into to clear it.
        let usage = written | copied | wgpu::TextureUsages::RENDER_ATTACHMENT;
        let radiance = texture("relight radiance", RADIANCE_FORMAT, usage, 1, shaded);
        let radiance_view = view(&radiance);
        let samples = if antialias { 4 } else { 1 };
        let depth = if antialias { drawn } else { drawn | copied };
        let depth = texture("relight depth", DEPTH_FORMAT, depth, samples, size);
        let depth_view = view(&depth);
        let (visibility, drawn_view, seen_view, shown, surfaces);
        if antialias {
            drawn_view = view(&texture("relight samples", SAMPLES_FORMAT, drawn, 4, size));
            let items = wgpu::TextureFormat::Rg32Uint;
            let items = texture("relight surfaces", items, written, 1, shaded);
            seen_view = view(&items);
            let format = wgpu::TextureFormat::R32Uint;
            shown = texture(
                "relight surfaces of pixels",
                format,
                written | copied,
                1,
                size,
            );
            let views = [&drawn_view, &depth_view, &seen_view, &view(&shown)];
            surfaces = Some(group("relight surfaces", layouts.surfaces, &views));
            visibility = None;
        } else {
            let ids = texture(
                "relight visibility buffer",
                VISIBILITY_FORMAT,
                drawn | copied,
                1,
                size,
            );
            drawn_view = view(&ids);
            seen_view = view(&ids);
            shown = ids.clone();
            visibility = Some(ids);
            surfaces = None;
        }
        let slots = layouts
            .lobes
            .slots(layouts.slots, [&seen_view, &radiance_view]);
        let group_of_cells = |label, radiance: &wgpu::TextureView, slots: &Slots| {
            let [_, gathered] = slots.entries();
            let textures = (0..).zip([&seen_view, radiance]);
            let textures = textures.map(|(binding, view)| texture_entry(binding, view));
            device.create_bind_group(&wgpu::BindGroupDescriptor {
                label: Some(label),
                layout: layouts.shade,
                entries: &textures.chain([gathered]).collect::<Vec<_>>(),
            })
        };
        let open = open.then(|| {
            let usage = usage | copied;
            let radiance = texture("relight open radiance", RADIANCE_FORMAT, usage, 1, shaded);
            let view = view(&radiance);
            OpenImage {
                slots: layouts.lobes.beside(&slots, [&seen_view, &view]),
                bind_group: group_of_cells("relight open images", &view, &slots),
                radiance,
                view,
            }
        });
        let bind_group = group_of_cells("relight images", &radiance_view, &slots);
        let sources = (source_count > 0).then(|| {
            let groups = layouts.slots * source_count;
            let points = |label, pixels| {
                let columns = SEEN_COLUMNS * SEEN_TEXELS * pixels;
                let size = [columns, groups.div_ceil(SEEN_COLUMNS)];
                view(&texture(label, SOURCES_FORMAT, written, 1, size))
            };
            let coarse = points("relight points of sources, coarse", COARSE_PIXELS);
            let points = points("relight points of sources", TILE * TILE);
            let [reflections, gathered] = slots.entries();
            let [layout, layout_shown] = &layouts.lobes.source_images;
            let group = |layout, entries: &[wgpu::BindGroupEntry]| {
                device.create_bind_group(&wgpu::BindGroupDescriptor {
                    label: Some("relight sources' images"),
                    layout,
                    entries,
                })
            };
            let found = |[found, seen]: [&wgpu::TextureView; 2]| {
                let images = [&seen_view, found, seen];
                let images = (0..).zip(images).map(|(at, view)| texture_entry(at, view));
                let entries = images.chain([reflections.clone()]);
                group(layout, &entries.collect::<Vec<_>>())
            };
            [
                // Reads nothing.
                found([&coarse, &points]),
                found([&points, &coarse]),
                group(
                    layout_shown,
                    &[texture_entry(2, &points), reflections.clone(), gathered],
                ),
            ]
        });
        Self {
            sources,
            slots,
            open,
            source_count,
            bind_group,
            visibility,
            seen_view,
            drawn_view,
            depth_view,
            depth,
            radiance,
            radiance_view,
            shown_view: view(&shown),
            shown,
            surfaces,
        }
    }

    pub(crate) fn antialias(&self) -> bool {
        self.surfaces.is_some()
    }
}

/// Nothing is shaded where nothing is seen.
pub(crate) fn clear(encoder: &mut wgpu::CommandEncoder, image: &wgpu::TextureView) {
    encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
        label: Some("relight clear"),
        color_attachments: &[Some(wgpu::RenderPassColorAttachment {
            view: image,
            depth_slice: None,
            resolve_target: None,
            ops: wgpu::Operations {
                load: wgpu::LoadOp::Clear(wgpu::Color::TRANSPARENT),
                store: wgpu::StoreOp::Store,
            },
        })],
        ..Default::default()
    });
}
