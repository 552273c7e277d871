//! Radiance of a surface point: lights times reflection, lobe by lobe, over what is
//! visible.

use std::f32::consts::FRAC_1_PI;

use glam::Vec3;

use crate::polar::PolarOptions;
use crate::spherical_gaussian::SphericalGaussian;
use crate::ssdf::SignedDistance;
use crate::surface::SurfacePoint;
use crate::tables::Tables;
use crate::{ambient, brdf, polar};

/// A product lobe whose whole energy is below this fraction of the radiance gathered so
/// far, in every channel, is not integrated.
pub const NEGLIGIBLE: f32 = 1e-4;

/// How lobes are integrated over the visible region.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Method {
    /// One half-space per lobe (Wang et al. 2009).
    Ambient,
    /// Spokes about each lobe's axis.
    Polar(PolarOptions),
}

/// Calls `visit` with every product of a light and a reflection lobe at `point`: the
/// radiance towards the eye is the sum over them of ∫ G(ω) max(n·ω, 0) V(ω) dω with n the
/// shading normal. None where the eye is below the shading horizon.
pub fn product_lobes(
    point: &SurfacePoint,
    lights: &[SphericalGaussian],
    mut visit: impl FnMut(SphericalGaussian),
) {
    if point.normal.dot(point.view) <= 0.0 {
        return;
    }
    let diffuse = point.appearance.diffuse * FRAC_1_PI;
    let specular = brdf::specular_lobes(point);
    for light in lights {
        if diffuse != Vec3::ZERO {
            visit(SphericalGaussian {
                amplitude: light.amplitude * diffuse,
                ..*light
            });
        }
        for lobe in specular.as_slice() {
            visit(light.product(lobe));
        }
    }
}

/// Radiance from `point` towards the eye.
pub fn shade(
    point: &SurfacePoint,
    lights: &[SphericalGaussian],
    field: &impl SignedDistance,
    method: &Method,
) -> Vec3 {
    let mut radiance = Vec3::ZERO;
    product_lobes(point, lights, |lobe| {
        if lobe.integral().cmple(NEGLIGIBLE * radiance).all() {
            return;
        }
        let visible = match method {
            Method::Ambient => ambient::integrate(field, lobe.sharpness, lobe.axis, point.normal),
            Method::Polar(options) => {
                polar::integrate(field, lobe.sharpness, lobe.axis, point.normal, options)
            }
        };
        radiance += lobe.amplitude * visible;
    });
    radiance
}

/// The constants of this module, as WGSL.
pub fn wgsl_constants() -> String {
    format!("const SHADE_NEGLIGIBLE: f32 = {NEGLIGIBLE:?};\n")
}

/// Contents of the GPU buffer `tables`.
pub fn gpu_tables() -> Vec<f32> {
    [Tables::get().values(), brdf::table_values()].concat()
}
