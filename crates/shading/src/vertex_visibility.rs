//! The visible fraction of every distant light at every vertex.
//!
//! A light's visible fraction changes slowly over most of a surface, and neither with the
//! view nor with the diffuse colour. Found once per vertex and light, it serves every pixel of the
//! triangles whose corners agree, until the light turns; where corners disagree a shadow's
//! edge passes between them and pixels integrate for themselves.

use glam::Vec3;

use crate::polar::{self, PolarOptions};
use crate::shade::{negligible, share};
use crate::spherical_gaussian::SphericalGaussian;
use crate::ssdf::SignedDistance;
use crate::tables::Tables;

/// Corners whose fractions differ by no more than this agree. At 0.05 pictures of the bench
/// scenes lose at most 0.015 % and a third to four fifths of the samples go.
pub const AGREEMENT: f32 = 0.05;
/// Least cosine between the shading normal of a point and the one that its vertices interpolate
/// to: normal maps that turn it further see another part of the sky.
pub const LEAST_COSINE: f32 = 0.95;
/// Stands for a fraction that was not integrated, as the light adds nothing there.
pub const UNKNOWN: f32 = -1.0;

/// Fractions at the corners of the triangle that a point lies on.
#[derive(Clone, Copy, Debug)]
pub struct Corners<'a> {
    /// A fraction in [0, 1] or [`UNKNOWN`] per distant light, at each corner.
    pub fractions: [&'a [f32]; 3],
    /// Weights of the corners.
    pub barycentrics: Vec3,
    /// Unit normal that the vertices interpolate to.
    pub normal: Vec3,
}

impl Corners<'_> {
    /// The visible fraction of light `index` where the corners agree on it; `normal` is the
    /// point's shading normal.
    pub fn fraction(&self, index: usize, normal: Vec3) -> Option<f32> {
        let corners = Vec3::from(self.fractions.map(|fractions| fractions[index]));
        let agree = corners.min_element() >= 0.0
            && corners.max_element() - corners.min_element() <= AGREEMENT
            && self.normal.dot(normal) >= LEAST_COSINE;
        agree.then(|| self.barycentrics.dot(corners))
    }
}

/// Fills in the fraction of every light at a vertex of unit normal `normal`, whose SSDF is
/// `field`: of ∫ G(ω) max(n·ω, 0) dω, in the order and as closely as a white diffuse point
/// there would integrate them.
pub fn fractions(
    lights: &[SphericalGaussian],
    normal: Vec3,
    field: &impl SignedDistance,
    options: PolarOptions,
    fractions: &mut [f32],
) {
    let mut gathered = Vec3::ZERO;
    for (light, fraction) in lights.iter().zip(fractions) {
        let whole = light.integral();
        if negligible(whole, gathered) {
            *fraction = UNKNOWN;
            continue;
        }
        let options = options.for_share(share(whole, gathered));
        let visible = polar::integrate(field, light.sharpness, light.axis, normal, &options);
        let unoccluded =
            Tables::get().cosine_integral(light.sharpness, normal.dot(light.axis));
        gathered += light.amplitude * visible;
        *fraction = (visible / unoccluded.max(f32::MIN_POSITIVE)).clamp(0.0, 1.0);
    }
}

/// The constants of this module, as WGSL.
pub fn wgsl_constants() -> String {
    format!(
        "const VERTEX_VISIBILITY_AGREEMENT: f32 = {AGREEMENT:?};\n\
         const VERTEX_VISIBILITY_LEAST_COSINE: f32 = {LEAST_COSINE:?};\n\
         const VERTEX_VISIBILITY_UNKNOWN: f32 = {UNKNOWN:?};\n"
    )
}
