//! What changes from frame to frame, for the GPU and its twin alike.

use glam::{Mat3, Quat, Vec3};
use relight_format::{Camera, Scene};
use relight_shading::camera::View;
use relight_shading::gpu::{self, LimitError};
use relight_shading::local_light::LocalLight;
use relight_shading::polar::PolarOptions;
use relight_shading::prefiltered::Prefiltered;
use relight_shading::shade::Method;
use relight_shading::sources::Sources;
use relight_shading::spherical_gaussian::SphericalGaussian;

/// Camera, light and look of one frame.
#[derive(Clone, Debug)]
pub struct Frame<'a> {
    /// The camera.
    pub camera: Camera,
    /// Distant light, for instance the lobes of a [`relight_format::Environment`].
    pub lights: &'a [SphericalGaussian],
    /// What the environment's image has beyond `lights`, as they are here before they are turned;
    /// without it, surfaces see the lights alone. Sharp reflections show it where the lights say
    /// that the environment is visible.
    pub reflections: Option<&'a Prefiltered>,
    /// The environment's suns, lamps and windows, which its lobes and its image do not have:
    /// [`Sources::new`]. Rays against the scene shadow them.
    pub sources: Option<&'a Sources>,
    /// Turns the lights, the image and the sources, world space.
    pub rotation: Quat,
    /// Lights inside the scene, at most [`MAX_LOCAL_LIGHTS`](relight_shading::gpu::MAX_LOCAL_LIGHTS).
    pub local_lights: &'a [LocalLight],
    /// How visible light is integrated.
    pub method: Method,
    /// Multiplies radiance before tone mapping; the linear output is not exposed.
    pub exposure: f32,
}

impl<'a> Frame<'a> {
    /// Distant light alone, not turned, by `polar` at its standard quality; exposure 1.
    pub fn new(camera: Camera, lights: &'a [SphericalGaussian]) -> Self {
        Self {
            camera,
            lights,
            reflections: None,
            sources: None,
            rotation: Quat::IDENTITY,
            local_lights: &[],
            method: Method::Polar(PolarOptions::STANDARD),
            exposure: 1.0,
        }
    }

    /// The lights after rotation.
    pub fn rotated_lights(&self) -> Vec<SphericalGaussian> {
        let rotation = Mat3::from_quat(self.rotation);
        self.lights
            .iter()
            .map(|light| light.rotate(&rotation))
            .collect()
    }

    /// The sources after rotation.
    pub fn rotated_sources(&self) -> Option<Sources> {
        let rotation = Mat3::from_quat(self.rotation);
        self.sources.map(|sources| sources.turned(&rotation))
    }

    /// Distant light as surfaces pass it on to others: the lights, and the sources point by point.
    pub(crate) fn bouncing_lights(&self) -> Vec<SphericalGaussian> {
        let mut lights = self.rotated_lights();
        if let Some(sources) = self.rotated_sources() {
            lights.extend(sources.lobes());
        }
        lights
    }

    pub(crate) fn packed_local_lights(&self) -> Vec<gpu::LocalLight> {
        self.local_lights.iter().map(Into::into).collect()
    }

    /// World directions to those of the reflected image.
    pub(crate) fn reflection_rotation(&self) -> Mat3 {
        Mat3::from_quat(self.rotation).transpose()
    }

    pub(crate) fn view(&self, width: u32, height: u32, near: f32) -> View {
        View::new(&self.camera, width, height, near)
    }
}

pub(crate) fn check_local_lights(count: usize) -> Result<(), LimitError> {
    LimitError::check(
        "number of local lights",
        count as u64,
        u64::from(gpu::MAX_LOCAL_LIGHTS),
    )
}

/// Distance of the near plane, metres: a ten-thousandth of the scene's diagonal. Reversed
/// floating-point depth needs no closer fit.
pub(crate) fn near_plane(scene: &Scene) -> f32 {
    let (low, high) = scene
        .vertices
        .iter()
        .map(|vertex| Vec3::from(vertex.position))
        .fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(low, high), p| {
            (low.min(p), high.max(p))
        });
    let diagonal = (high - low).length();
    if diagonal.is_finite() && diagonal > 0.0 {
        1e-4 * diagonal
    } else {
        1e-4
    }
}

#[cfg(test)]
mod tests {
    use relight_format::FieldOfView;

    use super::*;

    #[test]
    fn rotation_turns_lights_right_handed() {
        let light = SphericalGaussian {
            axis: Vec3::Z,
            sharpness: 5.0,
            amplitude: Vec3::ONE,
        };
        let frame = Frame {
            camera: Camera {
                position: [0.0; 3],
                target: [0.0, 0.0, -1.0],
                up: [0.0, 1.0, 0.0],
                field_of_view: FieldOfView::X(1.0),
            },
            lights: &[light],
            rotation: Quat::from_rotation_y(std::f32::consts::FRAC_PI_2),
            reflections: None,
            sources: None,
            local_lights: &[],
            method: Method::Ambient,
            exposure: 1.0,
        };
        let [turned] = frame.rotated_lights()[..] else {
            panic!("one light in, one light out");
        };
        assert!(turned.axis.distance(Vec3::X) < 1e-6, "{}", turned.axis);
        assert_eq!((turned.sharpness, turned.amplitude), (5.0, Vec3::ONE));
    }
}
