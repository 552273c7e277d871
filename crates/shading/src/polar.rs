//! The default integrator: spokes about the lobe's own axis.
//!
//! With the axis as pole a lobe depends on the polar angle θ alone, so that along a spoke of
//! constant azimuth φ the integral over any visible interval of θ is exact for every
//! sharpness. The intervals are found by sphere tracing the SSDF and the integral over φ
//! is the periodic trapezoid rule.

use std::f32::consts::PI;

use glam::Vec3;

use crate::spherical_gaussian::cosine_moment;
use crate::ssdf::SignedDistance;
use crate::tables::Tables;

/// A lobe ends where it falls to this fraction of its peak.
pub const CUT: f32 = 1e-3;
/// Shortest step along a spoke, in units of the support radius: visibility that changes
/// twice within it may be missed.
pub const SHORTEST_STEP: f32 = 0.05;
/// Steps are this fraction of the distance: interpolation and compression leave the field
/// not quite 1-Lipschitz.
pub const SAFETY: f32 = 0.9;

/// How finely to integrate.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PolarOptions {
    /// Directions about the lobe's axis along which visibility is traced, at least 1.
    pub spokes: u32,
}

impl Default for PolarOptions {
    fn default() -> Self {
        Self { spokes: 8 }
    }
}

/// ∫ exp(λ(p·ω − 1)) max(n·ω, 0) \[D(ω) > 0\] dω, for the lobe of sharpness λ about the unit
/// vector p = `axis` and the unit vector n = `normal`.
///
/// The spokes yield the visible share of the integral; the whole comes from a table.
pub fn integrate(
    field: &impl SignedDistance,
    sharpness: f32,
    axis: Vec3,
    normal: Vec3,
    options: &PolarOptions,
) -> f32 {
    let cosine = normal.dot(axis);
    let unoccluded = Tables::get().cosine_integral(sharpness, cosine);
    let support = support_radius(sharpness);
    let distance = field.distance(axis);
    if distance >= support {
        return unoccluded;
    }
    if distance <= -support {
        return 0.0;
    }
    let projected = normal - cosine * axis;
    let sine = projected.length();
    let tangent = if sine > 1e-4 {
        projected / sine
    } else {
        any_orthogonal(axis)
    };
    let bitangent = axis.cross(tangent);
    let mut visible = 0.0;
    let mut whole = 0.0;
    for k in 0..options.spokes {
        let azimuth = 2.0 * PI * (k as f32 + 0.5) / options.spokes as f32;
        let outward = azimuth.cos() * tangent + azimuth.sin() * bitangent;
        // Along the spoke n·ω = cosine cos θ + slope sin θ, which changes sign once.
        let slope = sine * azimuth.cos();
        let horizon = cosine
            .abs()
            .atan2(if cosine < 0.0 { slope } else { -slope });
        let start = if cosine < 0.0 {
            horizon.min(support)
        } else {
            0.0
        };
        let end = if cosine < 0.0 {
            support
        } else {
            horizon.min(support)
        };
        let mut theta = start;
        let mut here = if start > 0.0 {
            field.distance(axis * start.cos() + outward * start.sin())
        } else {
            distance
        };
        let first = moment(sharpness, cosine, slope, start);
        let mut entered = first;
        while theta < end {
            let next = (theta + (SAFETY * here.abs()).max(SHORTEST_STEP * support)).min(end);
            let there = field.distance(axis * next.cos() + outward * next.sin());
            if (here > 0.0) != (there > 0.0) {
                let crossing = theta + (next - theta) * here / (here - there);
                let value = moment(sharpness, cosine, slope, crossing);
                if here > 0.0 {
                    visible += value - entered;
                }
                entered = value;
            }
            theta = next;
            here = there;
        }
        let last = moment(sharpness, cosine, slope, end);
        if here > 0.0 {
            visible += last - entered;
        }
        whole += last - first;
    }
    if whole > 0.0 {
        unoccluded * (visible / whole).clamp(0.0, 1.0)
    } else {
        0.0
    }
}

/// Angle from the axis at which the lobe has fallen to [`CUT`]; π where it never does.
fn support_radius(sharpness: f32) -> f32 {
    let half_chord = (cut_exponent() / sharpness.max(f32::MIN_POSITIVE)).sqrt();
    2.0 * half_chord.min(1.0).asin()
}

/// ∫₀^θ exp(λ(cos t − 1)) (cosine cos t + slope sin t) sin t dt.
fn moment(sharpness: f32, cosine: f32, slope: f32, theta: f32) -> f32 {
    let half_chord = (0.5 * theta).sin();
    cosine * cosine_moment(sharpness, 2.0 * half_chord * half_chord)
        + slope * Tables::get().sine_squared_moment(sharpness, half_chord)
}

/// A unit vector at right angles to the unit vector `axis`.
fn any_orthogonal(axis: Vec3) -> Vec3 {
    let other = if axis.x.abs() > 0.7 { Vec3::Y } else { Vec3::X };
    axis.cross(other).normalize()
}

/// λ sin²(θ/2) where the lobe has fallen to [`CUT`].
fn cut_exponent() -> f32 {
    -0.5 * CUT.ln()
}

/// The constants of this module, as WGSL.
pub fn wgsl_constants() -> String {
    let cut_exponent = cut_exponent();
    format!(
        "const POLAR_CUT_EXPONENT: f32 = {cut_exponent:?};\n\
         const POLAR_SHORTEST_STEP: f32 = {SHORTEST_STEP:?};\n\
         const POLAR_SAFETY: f32 = {SAFETY:?};\n"
    )
}
