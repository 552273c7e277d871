//! The images of one size that frames are drawn in.

use relight_shading::gpu;

use crate::composite::Drawing;
use crate::renderer::Owner;
use crate::resources::Resources;
use crate::{Error, Renderer};

/// Format of the visibility buffer.
pub(crate) const VISIBILITY_FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::R32Uint;
/// Format of the depth buffer.
pub(crate) const DEPTH_FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::Depth32Float;
/// Format of the linear image.
pub(crate) const RADIANCE_FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::Rgba32Float;

/// Images of one size, and what else is kept from frame to frame:
/// [`Renderer::prepare`] fills it, [`Renderer::composite`] draws it.
///
/// It holds 44 bytes per pixel, 60 under environments with sources. An app
/// has one per camera, and another, or [`Self::resize`], for another size.
#[derive(Debug)]
pub struct View {
    pub(crate) owner: Owner,
    size: [u32; 2],
    pub(crate) images: Option<Images>,
    /// By instance.
    pub(crate) resources: Vec<Resources>,
    pub(crate) drawing: Drawing,
}

impl View {
    pub(crate) fn new(owner: &Owner, size: [u32; 2]) -> Self {
        Self {
            owner: owner.clone(),
            size,
            images: None,
            resources: Vec::new(),
            drawing: Drawing::default(),
        }
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
            self.drawing = Drawing::default();
        }
        Ok(())
    }

    /// The linear radiance of the last frame prepared (rgba32float, alpha is coverage),
    /// not exposed; sampled or copied by commands after it.
    pub fn radiance(&self) -> Option<&wgpu::Texture> {
        self.images.as_ref().map(|images| &images.radiance)
    }

    /// The triangle under each pixel of the last frame prepared (r32uint): its index + 1,
    /// or 0 on the background. Those of the second instance go on where the first's end.
    pub fn visibility_buffer(&self) -> Option<&wgpu::Texture> {
        self.images.as_ref().map(|images| &images.visibility)
    }

    /// The depth of the last frame prepared (depth32float): reversed, from 1 in front to 0 on the
    /// background; 1 less that of matrices whose depth is not reversed.
    pub fn depth(&self) -> Option<&wgpu::Texture> {
        self.images.as_ref().map(|images| &images.depth)
    }
}

/// Images between the passes, all of one size.
#[derive(Debug)]
pub(crate) struct Images {
    pub(crate) visibility: wgpu::Texture,
    pub(crate) visibility_view: wgpu::TextureView,
    depth: wgpu::Texture,
    pub(crate) depth_view: wgpu::TextureView,
    pub(crate) radiance: wgpu::Texture,
    pub(crate) radiance_view: wgpu::TextureView,
    pub(crate) bind_group: wgpu::BindGroup,
    /// Group 2 of the pass for irradiance.
    pub(crate) diffuse: wgpu::BindGroup,
    /// Group 2 of the pass for sources, if there was one.
    pub(crate) sources: Option<wgpu::BindGroup>,
}

impl Images {
    pub(crate) fn new(
        device: &wgpu::Device,
        [layout, source_layout]: [&wgpu::BindGroupLayout; 2],
        size: [u32; 2],
        with_sources: bool,
    ) -> Self {
        let sized = |label, format, usage, [width, height]: [u32; 2]| {
            device.create_texture(&wgpu::TextureDescriptor {
                label: Some(label),
                size: wgpu::Extent3d {
                    width,
                    height,
                    depth_or_array_layers: 1,
                },
                mip_level_count: 1,
                sample_count: 1,
                dimension: wgpu::TextureDimension::D2,
                format,
                usage,
                view_formats: &[],
            })
        };
        let texture = |label, format, usage| sized(label, format, usage, size);
        let drawn = wgpu::TextureUsages::RENDER_ATTACHMENT;
        let read = wgpu::TextureUsages::TEXTURE_BINDING | wgpu::TextureUsages::COPY_SRC;
        let written = wgpu::TextureUsages::STORAGE_BINDING;
        let visibility = texture("relight visibility buffer", VISIBILITY_FORMAT, drawn | read);
        let depth = texture("relight depth", DEPTH_FORMAT, drawn | read);
        // Drawn into to clear it.
        let usage = written | read | drawn;
        let radiance = texture("relight radiance", RADIANCE_FORMAT, usage);
        let view =
            |texture: &wgpu::Texture| texture.create_view(&wgpu::TextureViewDescriptor::default());
        let visibility_view = view(&visibility);
        let radiance_view = view(&radiance);
        let source_size = if with_sources { size } else { [1; 2] };
        let source_radiance = sized(
            "relight source radiance",
            RADIANCE_FORMAT,
            written | wgpu::TextureUsages::TEXTURE_BINDING,
            source_size,
        );
        let source_view = view(&source_radiance);
        let irradiance = sized(
            "relight irradiance",
            RADIANCE_FORMAT,
            written | wgpu::TextureUsages::TEXTURE_BINDING,
            size,
        );
        let irradiance_view = view(&irradiance);
        // Visibility buffer in, another image out.
        let writing = |image: &wgpu::TextureView| {
            device.create_bind_group(&wgpu::BindGroupDescriptor {
                label: Some("relight images before shading"),
                layout: source_layout,
                entries: &[
                    wgpu::BindGroupEntry {
                        binding: 0,
                        resource: wgpu::BindingResource::TextureView(&visibility_view),
                    },
                    wgpu::BindGroupEntry {
                        binding: 1,
                        resource: wgpu::BindingResource::TextureView(image),
                    },
                ],
            })
        };
        let diffuse = writing(&irradiance_view);
        let sources = with_sources.then(|| writing(&source_view));
        let bind_group = device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("relight images"),
            layout,
            entries: &[
                wgpu::BindGroupEntry {
                    binding: 0,
                    resource: wgpu::BindingResource::TextureView(&visibility_view),
                },
                wgpu::BindGroupEntry {
                    binding: 1,
                    resource: wgpu::BindingResource::TextureView(&radiance_view),
                },
                wgpu::BindGroupEntry {
                    binding: 2,
                    resource: wgpu::BindingResource::TextureView(&source_view),
                },
                wgpu::BindGroupEntry {
                    binding: 3,
                    resource: wgpu::BindingResource::TextureView(&irradiance_view),
                },
            ],
        });
        Self {
            diffuse,
            sources,
            visibility,
            visibility_view,
            depth_view: view(&depth),
            depth,
            radiance,
            radiance_view,
            bind_group,
        }
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

    /// Dispatches of at most `band` rows.
    pub(crate) fn bands(self, band: u32) -> impl Iterator<Item = Self> {
        let end = self.row + self.height;
        (self.row..end).step_by(band as usize).map(move |row| Self {
            row,
            height: band.min(end - row),
            ..self
        })
    }

    /// Numbers of workgroups.
    pub(crate) fn workgroups(self) -> [u32; 2] {
        [self.width, self.height].map(|side| side.div_ceil(WORKGROUP))
    }

    /// The uniforms of a dispatch.
    pub(crate) fn uniform(self, frame: gpu::Frame) -> gpu::Frame {
        gpu::Frame {
            first_row: self.row,
            first_column: self.column,
            ..frame
        }
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
        let rows: u32 = whole.bands(128).map(|band| band.height).sum();
        assert_eq!((rows, whole.bands(u32::MAX - 7).count()), (480, 1));
    }
}
