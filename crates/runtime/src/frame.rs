//! What changes from frame to frame, for the GPU and its twin alike.

use glam::{Mat3, Quat, Vec3};
use relight_format::{Camera, Scene};
use relight_shading::camera::View;
use relight_shading::shade::Method;
use relight_shading::spherical_gaussian::SphericalGaussian;

/// Camera, light and look of one frame.
#[derive(Clone, Debug)]
pub struct Frame<'a> {
    /// The camera.
    pub camera: Camera,
    /// Distant light, for instance the lobes of a [`relight_format::Environment`].
    pub lights: &'a [SphericalGaussian],
    /// Turns the lights, world space.
    pub rotation: Quat,
    /// How visible light is integrated.
    pub method: Method,
    /// Multiplies radiance before tone mapping; the linear output is not exposed.
    pub exposure: f32,
}

impl Frame<'_> {
    /// The lights after rotation.
    pub fn rotated_lights(&self) -> Vec<SphericalGaussian> {
        let rotation = Mat3::from_quat(self.rotation);
        self.lights
            .iter()
            .map(|light| light.rotate(&rotation))
            .collect()
    }

    pub(crate) fn view(&self, width: u32, height: u32, near: f32) -> View {
        View::new(&self.camera, width, height, near)
    }
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
