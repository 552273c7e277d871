//! Where what a pixel shows was in the picture of the frame before.

use glam::{Mat4, Vec2, Vec3};

/// What is found where it was behind that frame's camera: outside of its picture from everywhere.
pub const NOWHERE: Vec2 = Vec2::splat(4.0);

/// What to add to the place of a point in this picture for its place in the one before, in widths and heights of
/// a picture, to the right and down.
///
/// `position` is in the space of its scene, which `before` takes to the clip space of the frame before; `place` is where
/// it is now, from (0, 0) in the upper left corner to (1, 1).
pub fn motion(before: &Mat4, position: Vec3, place: Vec2) -> Vec2 {
    let clip = *before * position.extend(1.0);
    if clip.w <= 0.0 {
        return NOWHERE;
    }
    0.5 + Vec2::new(0.5, -0.5) * Vec2::new(clip.x, clip.y) / clip.w - place
}

/// The constants of this module, as WGSL.
pub fn wgsl_constants() -> String {
    format!("const MOTION_NOWHERE: f32 = {:?};\n", NOWHERE.x)
}
