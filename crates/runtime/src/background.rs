//! What is drawn behind the scene.

use glam::{Mat3, Vec3};
use relight_shading::background::Panorama;
use relight_shading::camera::View;
use relight_shading::gpu;

use crate::Frame;

/// What is behind the scene: all of the viewport that no instance covers, and the part of pixels
/// that they cover only in part. Exposed and tone-mapped as they are.
#[derive(Clone, Copy, Debug, Default)]
pub enum Background<'a> {
    /// Nothing: the app's own picture, or transparency.
    #[default]
    Transparent,
    /// One linear radiance, at least 0.
    Color(Vec3),
    /// Directions of an image, turned as the frame's lights are. An orthographic camera sees one
    /// direction, so one colour.
    Panorama {
        /// [`Panorama::of_environment`], or a sharper one of the app's own image.
        image: &'a Panorama,
        /// Sharpness of the lobe that it is seen through, above 0: [`Self::SHARP`], [`Self::BLURRED`].
        sharpness: f32,
    },
}

impl<'a> Background<'a> {
    /// The image as sharp as it is stored.
    pub const SHARP: f32 = f32::INFINITY;
    /// The image out of focus: a lobe of 13° to either side.
    pub const BLURRED: f32 = 40.0;

    /// An image as sharp as it is stored.
    pub fn sharp(image: &'a Panorama) -> Self {
        let sharpness = Self::SHARP;
        Self::Panorama { image, sharpness }
    }

    /// An image out of focus.
    pub fn blurred(image: &'a Panorama) -> Self {
        let sharpness = Self::BLURRED;
        Self::Panorama { image, sharpness }
    }

    /// Linear radiance in a direction of the world of unit length, not exposed, where `to_image` turns
    /// those to the image's; `None` where nothing is behind the scene.
    pub fn radiance(&self, direction: Vec3, to_image: &Mat3) -> Option<Vec3> {
        match self {
            Self::Transparent => None,
            Self::Color(color) => Some(*color),
            Self::Panorama { image, sharpness } => {
                Some(image.radiance(*to_image * direction, *sharpness))
            }
        }
    }
}

impl Frame<'_> {
    /// World directions to those of the reflected image and of the background's.
    pub(crate) fn to_image(&self) -> Mat3 {
        Mat3::from_quat(self.rotation).transpose()
    }
}

/// The part of the uniforms that draws the frame's background, seen in `view`.
pub(crate) fn uniform(frame: &Frame, view: &View) -> gpu::Composite {
    let columns = frame.to_image().to_cols_array_2d();
    let none = gpu::Composite {
        size: [0.0; 2],
        exposure: frame.exposure,
        encoding: 0,
        flipped_depth: u32::from(view.flipped_depth),
        background: gpu::BACKGROUND_NONE,
        levels: 0,
        sharpness: 0.0,
        corner: view.corner.into(),
        perspective: view.homogeneous_eye().w,
        right: view.right.into(),
        reserved_0: 0,
        down: view.down.into(),
        reserved_1: 0,
        eye: view.eye.into(),
        reserved_2: 0,
        color: [0.0; 3],
        reserved_3: 0,
        rotation: columns.map(|[x, y, z]| [x, y, z, 0.0]),
    };
    match frame.background {
        Background::Transparent => none,
        Background::Color(color) => gpu::Composite {
            background: gpu::BACKGROUND_COLOR,
            color: color.into(),
            ..none
        },
        Background::Panorama { image, sharpness } => gpu::Composite {
            background: gpu::BACKGROUND_IMAGE,
            levels: image.levels().levels(),
            sharpness: Panorama::sharpness(sharpness),
            ..none
        },
    }
}
