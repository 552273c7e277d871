//! What changes from frame to frame, for the GPU and its twin alike.

use glam::{Mat3, Quat, Vec3};
use relight_format::{Environment, Scene};
use relight_shading::camera::{View, Viewpoint};
use relight_shading::gpu::{self, LimitError};
use relight_shading::local_light::{LocalLight, Spot};
use relight_shading::polar::PolarOptions;
use relight_shading::prefiltered::Prefiltered;
use relight_shading::shade::Method;
use relight_shading::shadow_map::Lookup;
use relight_shading::sources::Sources;
use relight_shading::spherical_gaussian::SphericalGaussian;

use crate::placement::check_rotation;
use crate::{Background, Error, Placement, ShadowMap};

/// An environment asset in the form that frames take: made once, for any number of frames.
#[derive(Clone, Debug)]
pub struct EnvironmentLight {
    lights: Vec<SphericalGaussian>,
    image: Option<Prefiltered>,
    sources: Option<Sources>,
}

impl EnvironmentLight {
    /// Takes as long as there are texels and lobes: about a second for the sharpest image.
    pub fn new(environment: &Environment) -> Self {
        let lights: Vec<_> = environment.lobes.iter().map(Into::into).collect();
        Self {
            image: Prefiltered::new(&environment.prefiltered, &lights),
            sources: Sources::new(environment),
            lights,
        }
    }

    /// Its lobes.
    pub fn lights(&self) -> &[SphericalGaussian] {
        &self.lights
    }

    /// What its image has beyond the lobes, if it has one.
    pub fn image(&self) -> Option<&Prefiltered> {
        self.image.as_ref()
    }

    /// Its suns, lamps and windows, if it has some.
    pub fn sources(&self) -> Option<&Sources> {
        self.sources.as_ref()
    }
}

/// Camera, light and look of one frame.
#[derive(Clone, Debug)]
pub struct Frame<'a> {
    /// The camera: a [`relight_format::Camera`] or matrices.
    pub camera: Viewpoint,
    /// Distant light, for instance the lobes of a [`relight_format::Environment`].
    pub lights: &'a [SphericalGaussian],
    /// What the environment's image has beyond `lights`, as they are here before they are turned;
    /// without it, surfaces see the lights alone. Sharp reflections show it where the lights say
    /// that the environment is visible.
    pub reflections: Option<&'a Prefiltered>,
    /// The environment's suns, lamps and windows, which its lobes and its image do not have:
    /// [`Sources::new`]. Rays against the scene shadow them.
    pub sources: Option<&'a Sources>,
    /// What of one of the sources the app's own things hide. Default nothing, which costs nothing.
    pub shadow_map: Option<ShadowMap<'a>>,
    /// Turns the lights, the image and the sources, world space. Of unit length.
    pub rotation: Quat,
    /// Lights inside the scene, at most [`MAX_LOCAL_LIGHTS`](relight_shading::gpu::MAX_LOCAL_LIGHTS).
    pub local_lights: &'a [LocalLight],
    /// How visible light is integrated.
    pub method: Method,
    /// Whether silhouettes and edges are smooth: visibility has four samples per pixel, every
    /// distinct surface of a pixel is shaded once, and [`Self::sources`] light the whole square that a pixel
    /// covers, for edges of shadows. It costs as many more pixels as show
    /// several surfaces, and 92 bytes per pixel in place of 28. Default false: pixels are what their
    /// centres show.
    pub antialias: bool,
    /// Multiplies radiance on its way into targets; [`crate::View::radiance`] and pictures of the
    /// twin are not exposed.
    pub exposure: f32,
    /// What is drawn behind the instances, into targets only. Default nothing.
    pub background: Background<'a>,
}

impl<'a> Frame<'a> {
    /// Distant light alone, not turned, by `polar` at its standard quality; exposure 1.
    pub fn new(camera: impl Into<Viewpoint>, lights: &'a [SphericalGaussian]) -> Self {
        Self {
            camera: camera.into(),
            lights,
            reflections: None,
            sources: None,
            shadow_map: None,
            rotation: Quat::IDENTITY,
            local_lights: &[],
            method: Method::Polar(PolarOptions::STANDARD),
            antialias: false,
            exposure: 1.0,
            background: Background::Transparent,
        }
    }

    /// All that an environment has, not turned, by `polar` at its standard quality; exposure 1.
    pub fn under(camera: impl Into<Viewpoint>, environment: &'a EnvironmentLight) -> Self {
        Self {
            reflections: environment.image(),
            sources: environment.sources(),
            ..Self::new(camera, environment.lights())
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

    /// The frame as a scene sees it that stands somewhere else than it was baked. `near`: distance
    /// of a pinhole's near plane, world space.
    pub(crate) fn seen_from(
        &self,
        placement: &Placement,
        [width, height]: [u32; 2],
        near: f32,
    ) -> Result<LocalFrame, Error> {
        placement.check()?;
        check_method(self.method)?;
        check_rotation(self.rotation)?;
        check_local_lights(self.local_lights.len()).map_err(Error::Frame)?;
        let view = if *placement == Placement::IDENTITY {
            self.camera.view(width, height, near)
        } else {
            let matrix = self.camera.matrix(width, height, near) * placement.matrix();
            View::from_matrix(matrix, width, height)
        };
        let view = view.ok_or_else(|| Error::Camera {
            matrix: self.camera.matrix(width, height, near),
        })?;
        let rotation = Mat3::from_quat(placement.rotation.inverse() * self.rotation);
        let local = |light: &LocalLight| LocalLight {
            position: placement.point_to_scene(light.position),
            radius: light.radius / placement.scale,
            spot: light.spot.map(|spot| Spot {
                direction: placement.to_scene() * spot.direction,
                ..spot
            }),
            ..*light
        };
        Ok(LocalFrame {
            view,
            lights: (self.lights.iter())
                .map(|light| light.rotate(&rotation))
                .collect(),
            local_lights: (self.local_lights.iter())
                .map(|light| (&local(light)).into())
                .collect(),
            sources: self.sources.map(|sources| sources.turned(&rotation)),
            shadow_map: (self.shadow_map.as_ref())
                .map(|map| map.lookup(placement))
                .transpose()?,
            reflection_rotation: rotation.transpose(),
            to_world: placement.to_scene().transpose(),
        })
    }
}

/// Camera and light of a frame in the space of a scene.
#[derive(Clone, Debug)]
pub(crate) struct LocalFrame {
    pub(crate) view: View,
    pub(crate) lights: Vec<SphericalGaussian>,
    pub(crate) local_lights: Vec<gpu::LocalLight>,
    pub(crate) sources: Option<Sources>,
    pub(crate) shadow_map: Option<Lookup>,
    /// Directions to those of the reflected image.
    pub(crate) reflection_rotation: Mat3,
    /// Directions to those of the world.
    pub(crate) to_world: Mat3,
}

impl LocalFrame {
    /// Distant light as surfaces pass it on to others: the lights, and the sources point by point.
    pub(crate) fn bouncing_lights(&self) -> Vec<SphericalGaussian> {
        let mut lights = self.lights.clone();
        if let Some(sources) = &self.sources {
            lights.extend(sources.lobes());
        }
        lights
    }
}

fn check_method(method: Method) -> Result<(), Error> {
    if matches!(method, Method::Cells(_)) && !cfg!(feature = "paper") {
        return Err(Error::Feature {
            what: "method of a frame, cells",
            feature: "paper",
        });
    }
    Ok(())
}

pub(crate) fn check_local_lights(count: usize) -> Result<(), LimitError> {
    LimitError::check(
        "number of local lights",
        count as u64,
        u64::from(gpu::MAX_LOCAL_LIGHTS),
    )
}

/// Lowest and highest corner of a scene's box; infinite where it is empty.
pub(crate) fn bounds(scene: &Scene) -> [Vec3; 2] {
    (scene.vertices.iter())
        .map(|vertex| Vec3::from(vertex.position))
        .fold([Vec3::INFINITY, Vec3::NEG_INFINITY], |[low, high], p| {
            [low.min(p), high.max(p)]
        })
}

/// Distance of the near plane, metres: a ten-thousandth of the scene's diagonal. Reversed
/// floating-point depth needs no closer fit.
pub(crate) fn near_plane([low, high]: [Vec3; 2]) -> f32 {
    let diagonal = (high - low).length();
    if diagonal.is_finite() && diagonal > 0.0 {
        1e-4 * diagonal
    } else {
        1e-4
    }
}

#[cfg(test)]
mod tests {
    use relight_format::{Camera, FieldOfView};

    use super::*;

    #[test]
    fn rotation_turns_lights_right_handed() {
        let light = SphericalGaussian {
            axis: Vec3::Z,
            sharpness: 5.0,
            amplitude: Vec3::ONE,
        };
        let frame = Frame {
            camera: Viewpoint::Pinhole(Camera {
                position: [0.0; 3],
                target: [0.0, 0.0, -1.0],
                up: [0.0, 1.0, 0.0],
                field_of_view: FieldOfView::X(1.0),
            }),
            lights: &[light],
            rotation: Quat::from_rotation_y(std::f32::consts::FRAC_PI_2),
            reflections: None,
            sources: None,
            shadow_map: None,
            local_lights: &[],
            method: Method::Ambient,
            antialias: false,
            exposure: 1.0,
            background: Background::Transparent,
        };
        let [turned] = frame.rotated_lights()[..] else {
            panic!("one light in, one light out");
        };
        assert!(turned.axis.distance(Vec3::X) < 1e-6, "{}", turned.axis);
        assert_eq!((turned.sharpness, turned.amplitude), (5.0, Vec3::ONE));
    }
}
