//! The baseline integrator (Wang et al. 2009, §5): the lobe's integral times the fraction of
//! the lobe inside the half-space at the signed distance of its axis. One SSDF sample.
//!
//! Here the lobe of that fraction is the product with the clamped cosine, itself a spherical
//! Gaussian for this purpose: the axis of a broad lobe may lie below the horizon, where a
//! saturated field tells nothing of the part above.

use glam::Vec3;

use crate::ssdf::SignedDistance;
use crate::tables::Tables;

/// Sharpness of the spherical Gaussian nearest to the clamped cosine (Wang et al. 2009, §4).
const COSINE_SHARPNESS: f32 = 2.133;

/// An estimate of ∫ exp(λ(p·ω − 1)) max(n·ω, 0) \[D(ω) > 0\] dω, for the lobe of sharpness
/// λ about the unit vector p = `axis` and the unit vector n = `normal`.
pub fn integrate(field: &impl SignedDistance, sharpness: f32, axis: Vec3, normal: Vec3) -> f32 {
    let unoccluded = Tables::get().cosine_integral(sharpness, normal.dot(axis));
    unoccluded * visible_fraction(field, sharpness, axis, normal)
}

/// The visible fraction of that lobe times the clamped cosine.
pub(crate) fn visible_fraction(
    field: &impl SignedDistance,
    sharpness: f32,
    axis: Vec3,
    normal: Vec3,
) -> f32 {
    let tables = Tables::get();
    let product = sharpness * axis + COSINE_SHARPNESS * normal;
    let sharpness = product.length();
    let axis = if sharpness > 1e-6 {
        product / sharpness
    } else {
        normal
    };
    // A field that saturates says "at least" at its limit: there the lobe counts as wholly
    // visible or blocked, and the fractions between are stretched to meet that.
    let limit = field.limit();
    let fraction = tables.hemisphere_fraction(sharpness, field.distance(axis));
    let rest = tables.hemisphere_fraction(sharpness, -limit);
    ((fraction - rest) / (1.0 - 2.0 * rest)).clamp(0.0, 1.0)
}

/// How little [`integrate`] knows of a lobe, from 0 to 1: the square of four times the part of it, times the clamped
/// cosine, that lies farther to one side of its axis than the field tells. Four and the square, as pictures of metals
/// of roughness 0.15 to 1 come out best.
pub fn beyond(limit: f32, sharpness: f32, axis: Vec3, normal: Vec3) -> f32 {
    let product = sharpness * axis + COSINE_SHARPNESS * normal;
    let part = (4.0 * Tables::get().hemisphere_fraction(product.length(), -limit)).min(1.0);
    part * part
}

#[cfg(test)]
mod tests {
    use super::*;
    use relight_format::math;

    /// Largest error as a fraction of the whole integral: that of two table lookups.
    const TOLERANCE: f32 = 1e-3;

    /// Visible on one side of a great circle.
    struct HalfSpace(Vec3);

    impl SignedDistance for HalfSpace {
        fn distance(&self, direction: Vec3) -> f32 {
            math::asin(self.0.dot(direction).clamp(-1.0, 1.0))
        }
    }

    #[test]
    fn half_a_lobe_behind_its_plane_of_symmetry() {
        let field = HalfSpace(Vec3::X);
        for sharpness in [0.01, 0.5, 3.0, 20.0, 1e3, 1e5] {
            for degrees in 0i16..180 {
                let angle = f32::from(degrees).to_radians();
                let axis = Vec3::new(0.0, math::cos(angle), math::sin(angle));
                let whole = Tables::get().cosine_integral(sharpness, axis.y);
                let found = integrate(&field, sharpness, axis, Vec3::Y);
                assert!(
                    (found - 0.5 * whole).abs() <= TOLERANCE * whole,
                    "λ {sharpness}, {degrees}°"
                );
            }
        }
    }

    #[test]
    fn a_constant_cosine_leaves_the_fraction_of_the_normal_distribution() {
        // A lobe this narrow about the normal is a planar Gaussian of deviation 1/√λ.
        let sharpness = 1e5f32;
        let whole = Tables::get().cosine_integral(sharpness, 1.0);
        // The standard normal distribution function.
        for (deviations, fraction) in [
            (-3.0, 0.001_350),
            (-1.0, 0.158_655),
            (0.0, 0.5),
            (0.5, 0.691_462),
            (2.0, 0.977_250),
        ] {
            let distance = deviations / sharpness.sqrt();
            let field = HalfSpace(Vec3::new(math::cos(distance), math::sin(distance), 0.0));
            let found = integrate(&field, sharpness, Vec3::Y, Vec3::Y) / whole;
            assert!(
                (found - fraction).abs() < TOLERANCE,
                "{deviations}: {found}"
            );
        }
    }

    /// A field that is saturated everywhere.
    struct Saturated(f32);

    impl SignedDistance for Saturated {
        fn distance(&self, _: Vec3) -> f32 {
            self.0
        }

        fn limit(&self) -> f32 {
            self.0.abs()
        }
    }

    #[test]
    fn a_saturated_field_is_wholly_visible_or_blocked() {
        for sharpness in [0.1, 2.0, 30.0] {
            let whole = Tables::get().cosine_integral(sharpness, 1.0);
            let found = integrate(&Saturated(0.5), sharpness, Vec3::Y, Vec3::Y);
            assert!((found - whole).abs() <= TOLERANCE * whole);
            let found = integrate(&Saturated(-0.5), sharpness, Vec3::Y, Vec3::Y);
            assert!(found <= TOLERANCE * whole);
        }
    }
}
