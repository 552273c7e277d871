//! The images of one size that frames are drawn in.

use crate::composite::Drawing;
use crate::images::Images;
use crate::motion::Motion;
use crate::owner::Owner;
use crate::resources::Resources;
use crate::transfer::Slot;
use crate::{Error, Renderer};

/// Images of one size, and what else is kept from frame to frame:
/// [`Renderer::prepare`] fills it, [`Renderer::composite`] draws it.
///
/// It holds 28 bytes per pixel, 92 with antialiasing; and 512, and 48 more per source, for each of at most 131,072
/// pixels that are shaded at a time. With [`crate::Method::Polar`] every vertex of
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
