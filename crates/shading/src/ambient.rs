//! The baseline integrator (Wang et al. 2009, §5): the lobe's integral times the fraction of
//! the lobe inside the half-space at the signed distance of its axis. One SSDF sample.

use glam::Vec3;

use crate::ssdf::SignedDistance;
use crate::tables::Tables;

/// An estimate of ∫ exp(λ(p·ω − 1)) max(n·ω, 0) \[D(ω) > 0\] dω, for the lobe of sharpness
/// λ about the unit vector p = `axis` and the unit vector n = `normal`.
pub fn integrate(field: &impl SignedDistance, sharpness: f32, axis: Vec3, normal: Vec3) -> f32 {
    let tables = Tables::get();
    let unoccluded = tables.cosine_integral(sharpness, normal.dot(axis));
    // A field that saturates says "at least" at its limit: there the lobe counts as wholly
    // visible or blocked, and the fractions between are stretched to meet that.
    let limit = field.limit();
    let fraction = tables.hemisphere_fraction(sharpness, field.distance(axis));
    let rest = tables.hemisphere_fraction(sharpness, -limit);
    unoccluded * ((fraction - rest) / (1.0 - 2.0 * rest)).clamp(0.0, 1.0)
}
