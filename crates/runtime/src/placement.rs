//! Where scenes stand in a frame.

use glam::{Mat3, Mat4, Quat, Vec3};

use crate::{Error, GpuScene};

/// A scene turned, scaled and moved, in this order.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Placement {
    /// Of unit length, but for rounding.
    pub rotation: Quat,
    /// Metres.
    pub translation: Vec3,
    /// The same along all axes; greater than 0.
    pub scale: f32,
}

/// Most that the length of a rotation may differ from 1: far above rounding.
const UNIT_TOLERANCE: f32 = 1e-3;

impl Placement {
    /// The scene as it was baked.
    pub const IDENTITY: Self = Self {
        rotation: Quat::IDENTITY,
        translation: Vec3::ZERO,
        scale: 1.0,
    };

    /// Moved, neither turned nor scaled.
    pub const fn at(translation: Vec3) -> Self {
        Self {
            translation,
            ..Self::IDENTITY
        }
    }

    /// Scene to world space.
    pub fn matrix(&self) -> Mat4 {
        let scale = Vec3::splat(self.scale);
        Mat4::from_scale_rotation_translation(scale, self.rotation, self.translation)
    }

    /// World to scene space, directions.
    pub(crate) fn to_scene(self) -> Mat3 {
        Mat3::from_quat(self.rotation).transpose()
    }

    /// World to scene space, a point.
    pub(crate) fn point_to_scene(self, point: Vec3) -> Vec3 {
        self.to_scene() * (point - self.translation) / self.scale
    }

    /// Refuses rotations that are not of unit length and scales that are not positive.
    pub(crate) fn check(&self) -> Result<(), Error> {
        check_rotation(self.rotation)?;
        if self.scale > 0.0 && self.scale.is_finite() && self.translation.is_finite() {
            Ok(())
        } else {
            Err(Error::Placement(*self))
        }
    }
}

impl Default for Placement {
    fn default() -> Self {
        Self::IDENTITY
    }
}

pub(crate) fn check_rotation(rotation: Quat) -> Result<(), Error> {
    let length = rotation.length();
    // Not a number is not close to 1 either.
    if (length - 1.0).abs() <= UNIT_TOLERANCE {
        Ok(())
    } else {
        Err(Error::Rotation { length })
    }
}

/// A scene in a place. Instances occlude one another; they neither shadow nor light one another.
#[derive(Clone, Copy, Debug)]
pub struct Instance<'a> {
    /// The scene.
    pub scene: &'a GpuScene,
    /// Where it stands.
    pub placement: Placement,
}

impl<'a> From<&'a GpuScene> for Instance<'a> {
    fn from(scene: &'a GpuScene) -> Self {
        Self {
            scene,
            placement: Placement::IDENTITY,
        }
    }
}
