//! What is reflected of an environment's sources: random directions, each with a ray.

use glam::Vec3;
use relight_shading::models;
use relight_shading::sources::Sources;
use relight_shading::surface::SurfacePoint;

use super::Geometry;
use super::random::{hash, kronecker_pair};

/// An estimate of the radiance from `count` directions of every source.
pub(super) fn reflected(
    geometry: &Geometry,
    point: &SurfacePoint,
    sources: &Sources,
    count: u32,
    seed: u32,
) -> Vec3 {
    let wo = point.to_local(point.view);
    if wo.z <= 0.0 {
        return Vec3::ZERO;
    }
    let mut sum = Vec3::ZERO;
    for source in 0..sources.count() {
        let seed = hash(seed, 16 + source as u32);
        for sample in 0..count {
            let (direction, light) = sources.sample(source, kronecker_pair(sample, seed));
            let wi = point.to_local(direction);
            if wi.z > 0.0 && geometry.visible(point, direction) {
                sum += light * (wi.z * models::evaluate(&point.appearance, wi, wo));
            }
        }
    }
    sum / count as f32
}
