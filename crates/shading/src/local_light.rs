//! Lights inside the scene: spheres, of which a spot keeps only a cone.
//!
//! Seen from a surface point a sphere is a disk, and the disk becomes the spherical Gaussian
//! of the same energy and mean direction cosine. Visibility is baked for distant light, so a
//! light counts as blocked by what lies behind it as well: it is right where whatever is
//! in its direction is nearer than the light.

use glam::Vec3;
use relight_format::math;

use crate::gpu;
use crate::spherical_gaussian::{SphericalGaussian, energy};

/// Lobes of lights are no sharper: the interpolated visibility is not.
pub const MAX_SHARPNESS: f32 = 1e5;

/// A sphere that emits, seen by surfaces and not by the camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LocalLight {
    /// Centre, world space, metres.
    pub position: Vec3,
    /// Radius, metres, greater than 0.
    pub radius: f32,
    /// Radiance of its surface, linear Rec.709.
    pub radiance: Vec3,
    /// Confines the light to a cone.
    pub spot: Option<Spot>,
}

/// The cone of a spot light, about the line from the light's centre. Between the two angles the
/// light falls off as in the glTF extension KHR_lights_punctual.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Spot {
    /// Unit vector away from the light.
    pub direction: Vec3,
    /// Angle from the direction up to which the light is whole, radians.
    pub inner_angle: f32,
    /// Angle beyond which there is none, radians, greater than the inner one.
    pub outer_angle: f32,
}

impl From<&LocalLight> for gpu::LocalLight {
    fn from(light: &LocalLight) -> Self {
        let (direction, spot_scale, spot_offset) = match light.spot {
            None => (Vec3::Y, 0.0, 1.0),
            Some(spot) => {
                let outer = math::cos(spot.outer_angle);
                let scale = 1.0 / (math::cos(spot.inner_angle) - outer).max(1e-4);
                (spot.direction, scale, -outer * scale)
            }
        };
        Self {
            position: light.position.into(),
            radius: light.radius,
            radiance: light.radiance.into(),
            spot_scale,
            direction: direction.into(),
            spot_offset,
        }
    }
}

impl gpu::LocalLight {
    /// The light as it reaches `point`.
    pub fn lobe(&self, point: Vec3) -> SphericalGaussian {
        let offset = Vec3::from(self.position) - point;
        let squared = offset.length_squared().max(f32::MIN_POSITIVE);
        let axis = offset / squared.sqrt();
        let cap = self.cap(squared);
        let sharpness = (2.0 / cap.max(f32::MIN_POSITIVE)).min(MAX_SHARPNESS);
        let amplitude = 2.0 * std::f32::consts::PI * cap / energy(sharpness);
        SphericalGaussian {
            axis,
            sharpness,
            amplitude: Vec3::from(self.radiance) * (amplitude * self.spot(axis)),
        }
    }

    /// 1 − cos of the half-angle of the sphere seen from the root of `squared` metres away; from
    /// inside it, a hemisphere.
    pub fn cap(&self, squared: f32) -> f32 {
        let sine_squared = (self.radius * self.radius / squared).min(1.0);
        sine_squared / (1.0 + (1.0 - sine_squared).sqrt())
    }

    /// The part of the light that is sent along −`axis`, `axis` pointing to its centre.
    pub fn spot(&self, axis: Vec3) -> f32 {
        let cosine = -Vec3::from(self.direction).dot(axis);
        let falloff = (self.spot_scale * cosine + self.spot_offset).clamp(0.0, 1.0);
        falloff * falloff
    }
}

/// The constants of this module, as WGSL.
pub fn wgsl_constants() -> String {
    format!("const LOCAL_LIGHT_MAX_SHARPNESS: f32 = {MAX_SHARPNESS:?};\n")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tables::Tables;
    use std::f32::consts::PI;

    fn light(radius: f32, spot: Option<Spot>) -> gpu::LocalLight {
        gpu::LocalLight::from(&LocalLight {
            position: Vec3::new(0.0, 2.0, 0.0),
            radius,
            radiance: Vec3::new(3.0, 2.0, 1.0),
            spot,
        })
    }

    /// The lobe's tails where the disk has an edge, at up to 30° of the sphere.
    const IRRADIANCE_TOLERANCE: f32 = 0.02;

    #[test]
    fn irradiance_is_that_of_a_sphere() {
        for radius in [1e-4, 0.01, 0.1, 0.5, 1.0] {
            let lobe = light(radius, None).lobe(Vec3::ZERO);
            assert!(lobe.axis.distance(Vec3::Y) < 1e-6);
            // Tilted so that the sphere stays above the horizon: π L sin²σ cos θ.
            for tilt in [0.0f32, 0.5, 1.0] {
                let irradiance = lobe.amplitude.x
                    * Tables::get().cosine_integral(lobe.sharpness, math::cos(tilt));
                let expected = 3.0 * PI * (radius / 2.0).powi(2) * math::cos(tilt);
                assert!(
                    (irradiance / expected - 1.0).abs() < IRRADIANCE_TOLERANCE,
                    "{radius} {tilt}: {irradiance} for {expected}"
                );
            }
        }
    }

    #[test]
    fn a_spot_is_whole_inside_and_dark_outside() {
        let spot = Spot {
            direction: Vec3::NEG_Y,
            inner_angle: 0.3,
            outer_angle: 0.5,
        };
        let energy_at = |angle: f32| {
            // On a circle about the light, so that the distance stays.
            let point = Vec3::new(2.0 * math::sin(angle), 2.0 - 2.0 * math::cos(angle), 0.0);
            light(0.1, Some(spot)).lobe(point).integral().x
        };
        let whole = light(0.1, None).lobe(Vec3::ZERO).integral().x;
        assert!((energy_at(0.29) / whole - 1.0).abs() < 1e-3);
        assert_eq!(energy_at(0.51), 0.0);
        let half = energy_at(0.4) / whole;
        assert!((0.1..0.9).contains(&half), "{half}");
    }

    #[test]
    fn points_in_the_light_and_far_from_it_are_finite() {
        for point in [
            Vec3::new(0.0, 2.0, 0.0),
            Vec3::new(0.0, 1.95, 0.0),
            Vec3::splat(1e15),
        ] {
            let lobe = light(0.1, None).lobe(point);
            assert!(
                lobe.axis.is_finite() && lobe.amplitude.is_finite() && lobe.sharpness > 0.0,
                "{lobe:?}"
            );
        }
    }
}
