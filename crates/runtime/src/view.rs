//! The images of one size that frames are drawn in.

use std::ops::Range;

use relight_shading::surfaces::TILE;

use crate::composite::Drawing;
use crate::lobes::{LobePasses, Slots};
use crate::motion::Motion;
use crate::renderer::Owner;
use crate::resources::{Resources, Slot};
use crate::{Error, Renderer};

/// Format of the visibility buffer.
pub(crate) const VISIBILITY_FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::R32Uint;
/// Format of samples of visibility.
pub(crate) const SAMPLES_FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::Rgba16Uint;
/// Format of the depth buffer.
pub(crate) const DEPTH_FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::Depth32Float;
/// Format of the linear image.
pub(crate) const RADIANCE_FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::Rgba32Float;

/// Images of one size, and what else is kept from frame to frame:
/// [`Renderer::prepare`] fills it, [`Renderer::composite`] draws it.
///
/// It holds 28 bytes per pixel, 16 more per source, 92 and 24 more per source with antialiasing; and
/// 512 for each of at most 131,072 pixels that are shaded at a time. With [`crate::Method::Polar`] every vertex of
/// every instance takes 4 bytes, and 4 for each distant light. An app
/// has one per camera, and another, or [`Self::resize`], for another size.
#[derive(Debug)]
pub struct View {
    pub(crate) owner: Owner,
    size: [u32; 2],
    pub(crate) images: Option<Images>,
    /// By batch.
    pub(crate) resources: Vec<Resources>,
    /// The same for what catches shadows.
    pub(crate) open: Vec<Resources>,
    /// Numbers of the instances that are shaded together.
    pub(crate) batches: Vec<Vec<u32>>,
    pub(crate) drawing: Drawing,
    pub(crate) world: World,
    pub(crate) motion: Motion,
}

/// The camera that instances share, for the pass for surfaces.
#[derive(Debug, Default)]
pub(crate) struct World {
    pub(crate) slot: Slot,
    pub(crate) group: Option<wgpu::BindGroup>,
}

impl View {
    pub(crate) fn new(owner: &Owner, size: [u32; 2]) -> Self {
        Self {
            owner: owner.clone(),
            size,
            images: None,
            resources: Vec::new(),
            open: Vec::new(),
            batches: Vec::new(),
            drawing: Drawing::default(),
            world: World::default(),
            motion: Motion::default(),
        }
    }

    /// Whether the last frame prepared was antialiased.
    pub(crate) fn antialias(&self) -> bool {
        self.images.as_ref().is_some_and(Images::antialias)
    }

    /// Columns and rows.
    pub fn size(&self) -> [u32; 2] {
        self.size
    }

    /// Gives it another size; what it showed is gone until it is prepared again.
    pub fn resize(&mut self, renderer: &Renderer, size: [u32; 2]) -> Result<(), Error> {
        renderer.check_size(size[0], size[1])?;
        if size != self.size {
            self.size = size;
            self.images = None;
            self.motion = Motion::default();
            self.drawing = Drawing::default();
        }
        Ok(())
    }

    /// The linear radiance of the last frame prepared (rgba32float, alpha is coverage),
    /// not exposed; sampled or copied by commands after it. If it was antialiased, the radiance of
    /// [`Self::surfaces`].
    pub fn radiance(&self) -> Option<&wgpu::Texture> {
        self.images.as_ref().map(|images| &images.radiance)
    }

    /// The triangle under each pixel of the last frame prepared (r32uint): its index + 1,
    /// or 0 on the background. Those of the second instance go on where the first's end. `None` if it
    /// was antialiased.
    pub fn visibility_buffer(&self) -> Option<&wgpu::Texture> {
        (self.images.as_ref()).and_then(|images| images.visibility.as_ref())
    }

    /// What catches shadows, as it would be if nothing hid light from it: [`Self::radiance`] has coverage 0
    /// there, and [`relight_shading::catcher::catch`] makes of both what is drawn. `None` where the last
    /// frame had no scene with such materials.
    pub fn open_radiance(&self) -> Option<&wgpu::Texture> {
        let open = self.images.as_ref()?.open.as_ref()?;
        Some(&open.radiance)
    }

    /// Which surfaces the pixels of the last frame prepared show, if it was antialiased (r32uint):
    /// three bits for each of four samples, the first lowest, and six of a number `base`. 0 is
    /// background; 1 is the texel of [`Self::radiance`] in the pixel's place; a larger number n the texel
    /// number i = `base` + n − 2 of the tile, column 8 x + i % 8 and row H + 4 y + i / 8 of the tile in
    /// column x and row y, H being the height in whole tiles of 8 × 8 pixels.
    pub fn surfaces(&self) -> Option<&wgpu::Texture> {
        (self.images.as_ref())
            .filter(|images| images.antialias())
            .map(|images| &images.shown)
    }

    /// Where everything was in the frame before, as [`Renderer::motion`] found it last (rg32float): what to add to
    /// a pixel's place, in widths and heights of the picture, to the right and down. 0 on the background;
    /// [`relight_shading::motion::NOWHERE`] for what was behind the camera. With antialiasing, of the pixel's
    /// first surface. `None` before that.
    pub fn motion(&self) -> Option<&wgpu::Texture> {
        self.motion.texture()
    }

    /// The depth of the last frame prepared (depth32float): reversed, from 1 in front to 0 on the
    /// background; 1 less that of matrices whose depth is not reversed. Four samples per pixel if it
    /// was antialiased.
    pub fn depth(&self) -> Option<&wgpu::Texture> {
        self.images.as_ref().map(|images| &images.depth)
    }
}

/// Images between the passes, all of one size.
#[derive(Debug)]
pub(crate) struct Images {
    /// Where there is no antialiasing.
    visibility: Option<wgpu::Texture>,
    /// What is shaded: the visibility buffer, or items of pixels.
    pub(crate) seen_view: wgpu::TextureView,
    /// What the pass of triangles draws into.
    pub(crate) drawn_view: wgpu::TextureView,
    depth: wgpu::Texture,
    pub(crate) depth_view: wgpu::TextureView,
    pub(crate) radiance: wgpu::Texture,
    pub(crate) radiance_view: wgpu::TextureView,
    /// Which pixels show something: the visibility buffer, or the surfaces of pixels.
    pub(crate) shown_view: wgpu::TextureView,
    shown: wgpu::Texture,
    pub(crate) bind_group: wgpu::BindGroup,
    /// What the passes that shade by lobes hand on.
    pub(crate) slots: Slots,
    /// Group 2 of the pass for sources, if there was one.
    pub(crate) sources: Option<wgpu::BindGroup>,
    /// What catches shadows.
    pub(crate) open: Option<OpenImage>,
    /// Sources that there is room for.
    pub(crate) source_layers: u32,
    /// Group 1 of the pass for surfaces, with antialiasing.
    pub(crate) surfaces: Option<wgpu::BindGroup>,
}

/// Radiance without what hides light.
#[derive(Debug)]
pub(crate) struct OpenImage {
    radiance: wgpu::Texture,
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
    pub(crate) sources: &'a wgpu::BindGroupLayout,
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
            sources: source_layers,
            antialias,
            open,
        } = needs;
        let layered = |label, format, usage, samples, [width, height]: [u32; 2], layers| {
            device.create_texture(&wgpu::TextureDescriptor {
                label: Some(label),
                size: wgpu::Extent3d {
                    width,
                    height,
                    depth_or_array_layers: layers,
                },
                mip_level_count: 1,
                sample_count: samples,
                dimension: wgpu::TextureDimension::D2,
                format,
                usage,
                view_formats: &[],
            })
        };
        let texture =
            |label, format, usage, samples, size| layered(label, format, usage, samples, size, 1);
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
        let source_radiance = layered(
            "relight source radiance",
            RADIANCE_FORMAT,
            written,
            1,
            if source_layers > 0 { shaded } else { [1; 2] },
            source_layers.max(1),
        );
        let source_view = source_radiance.create_view(&wgpu::TextureViewDescriptor {
            dimension: Some(wgpu::TextureViewDimension::D2Array),
            ..Default::default()
        });
        let views = [&seen_view, &radiance_view, &source_view];
        let slots = layouts.lobes.slots(layouts.slots, views);
        let open = open.then(|| {
            let usage = usage | copied;
            let radiance = texture("relight open radiance", RADIANCE_FORMAT, usage, 1, shaded);
            let view = view(&radiance);
            let views = [&seen_view, &view, &source_view];
            OpenImage {
                slots: layouts.lobes.beside(&slots, views),
                bind_group: group("relight open images", layouts.shade, &views),
                radiance,
                view,
            }
        });
        Self {
            slots,
            sources: (source_layers > 0).then(|| {
                let views = [&seen_view, &source_view];
                group("relight sources' images", layouts.sources, &views)
            }),
            open,
            source_layers,
            bind_group: group("relight images", layouts.shade, &views),
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

/// Pixels that an instance may cover.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Region {
    pub(crate) column: u32,
    pub(crate) row: u32,
    pub(crate) width: u32,
    pub(crate) height: u32,
}

/// Side of a compute workgroup in pixels, as in shade.wgsl.
pub(crate) const WORKGROUP: u32 = 8;

impl Region {
    /// What a box covers at most of an image, whole workgroups; `None` if nothing.
    pub(crate) fn of_box(
        view: &relight_shading::camera::View,
        [low, high]: [glam::Vec3; 2],
        [width, height]: [u32; 2],
    ) -> Option<Self> {
        if low.x > high.x {
            return None;
        }
        let image = glam::Vec2::new(width as f32, height as f32);
        let (mut first, mut last) = (glam::Vec2::INFINITY, glam::Vec2::NEG_INFINITY);
        for index in 0..8 {
            let corner = glam::Vec3::new(
                [low.x, high.x][index & 1],
                [low.y, high.y][index >> 1 & 1],
                [low.z, high.z][index >> 2],
            );
            let clip = view.view_projection * corner.extend(1.0);
            // At the eye, or behind: its edges may reach anywhere.
            let whole = clip.w <= 1e-3 * clip.truncate().abs().max_element() && !view.parallel;
            let at = if whole {
                first = glam::Vec2::ZERO;
                image
            } else {
                let ndc = glam::Vec2::new(clip.x, -clip.y) / clip.w;
                (0.5 * ndc + 0.5) * image
            };
            first = first.min(at);
            last = last.max(at);
        }
        // A pixel more, for rounding.
        let first = (first - 1.0).max(glam::Vec2::ZERO);
        let last = (last + 1.0).min(image);
        if !(first.x < last.x && first.y < last.y) {
            return None;
        }
        let [column, row] = [first.x, first.y].map(|at| at as u32 / WORKGROUP * WORKGROUP);
        Some(Self {
            column,
            row,
            width: (last.x.ceil() as u32).min(width) - column,
            height: (last.y.ceil() as u32).min(height) - row,
        })
    }

    /// The first row of images that holds further surfaces of pixels.
    pub(crate) fn first_extra_row([_, height]: [u32; 2], antialias: bool) -> u32 {
        if antialias {
            height.next_multiple_of(TILE)
        } else {
            u32::MAX
        }
    }

    /// Where further surfaces of the region's pixels are, in the images of a picture of such a size; whole
    /// workgroups.
    pub(crate) fn extras(self, size: [u32; 2]) -> Self {
        // Half as many rows for as many pixels.
        let first = Self::first_extra_row(size, true);
        let row = first + self.row / 2 / WORKGROUP * WORKGROUP;
        let end = first + (self.row + self.height).next_multiple_of(TILE) / 2;
        Self {
            row,
            height: end - row,
            ..self
        }
    }

    /// Rows of workgroups, and their columns. Of those only whose pixels lie in `rows` of the picture, `extra`
    /// being where further surfaces begin.
    pub(crate) fn tile_rows(
        self,
        extra: u32,
        rows: &Range<u32>,
    ) -> impl Iterator<Item = (u32, Range<u32>)> {
        let first = self.column / WORKGROUP;
        let columns = first..first + self.width.div_ceil(WORKGROUP);
        let tiles = self.row / WORKGROUP..(self.row + self.height).div_ceil(WORKGROUP);
        tiles.filter_map(move |tile| {
            let row = WORKGROUP * tile;
            let in_picture = row.checked_sub(extra).map_or(row, |below| 2 * below);
            (rows.contains(&in_picture)).then(|| (tile, columns.clone()))
        })
    }
}

#[cfg(test)]
mod tests {
    use glam::Vec3;
    use relight_format::{Camera, FieldOfView};
    use relight_shading::camera::View as Projection;

    use super::*;

    fn camera(distance: f32) -> Projection {
        let camera = Camera {
            position: [0.0, 0.0, distance],
            target: [0.0; 3],
            up: [0.0, 1.0, 0.0],
            field_of_view: FieldOfView::Y(1.0),
        };
        Projection::new(&camera, 640, 480, 0.01)
    }

    #[test]
    fn regions_hold_what_boxes_cover() {
        let cube = [Vec3::splat(-0.5), Vec3::splat(0.5)];
        let size = [640, 480];
        let region = Region::of_box(&camera(10.0), cube, size).expect("visible");
        assert!(region.width < 80 && region.height < 80, "{region:?}");
        let middle = [320, 240];
        assert!(region.column < middle[0] && region.column + region.width > middle[0]);
        assert!(region.row < middle[1] && region.row + region.height > middle[1]);
        // The eye in the box, beside it, and far from it.
        let whole = Region {
            column: 0,
            row: 0,
            width: 640,
            height: 480,
        };
        assert_eq!(Region::of_box(&camera(0.2), cube, size), Some(whole));
        let aside = cube.map(|corner| corner + Vec3::X * 100.0);
        assert_eq!(Region::of_box(&camera(10.0), aside, size), None);
        let nothing = [Vec3::INFINITY, Vec3::NEG_INFINITY];
        assert_eq!(Region::of_box(&camera(10.0), nothing, size), None);
        let tiles = |rows| {
            let rows = whole.tile_rows(u32::MAX, &rows);
            rows.map(|(_, columns)| columns.len()).collect::<Vec<_>>()
        };
        assert_eq!(tiles(0..480), [80; 60]);
        assert_eq!((tiles(0..9).len(), tiles(9..480).len()), (2, 58));
        let extras = whole.extras(size);
        let (rows, extra) = (0..16, Region::first_extra_row(size, true));
        assert_eq!(extras.tile_rows(extra, &rows).count(), 1);
        assert_eq!(extras.tile_rows(extra, &(0..480)).count(), 30);
    }
}
