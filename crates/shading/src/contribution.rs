//! What a lobe can add to what has been gathered before it.

use glam::Vec3;

/// A product lobe whose whole energy is below this fraction of the radiance gathered so
/// far, in every channel, is not integrated.
pub(crate) const NEGLIGIBLE: f32 = 3e-4;

/// Radiance that is as good as none.
pub(crate) const DARK: f32 = 1e-30;

/// Radiance by unit of irradiance, as little as none.
pub(crate) const BLACK: f32 = 1e-6;

/// Whether a lobe of the integral `whole` adds nothing to what has been gathered before.
pub(crate) fn negligible(whole: Vec3, gathered: Vec3) -> bool {
    whole.cmple(NEGLIGIBLE * gathered).all()
}

/// What a lobe of the integral `whole` can add, in what has been gathered before, in the
/// channel where that is most.
pub(crate) fn share(whole: Vec3, gathered: Vec3) -> f32 {
    (whole / gathered.max(Vec3::splat(DARK))).max_element()
}
