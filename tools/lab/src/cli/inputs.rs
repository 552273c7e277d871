//! The files that the command line names.

use std::path::Path;

use glam::Vec3;
use relight_bake::error::Error;
use relight_bake::files::{Access, Files};
use relight_bake::scene::description;
use relight_format::{Camera, Environment, FieldOfView, Limits, Scene};
use relight_lab::camera;
use relight_shading::local_light::LocalLight;
use relight_shading::prefiltered::Prefiltered;
use relight_shading::sources::Sources;
use relight_shading::spherical_gaussian::SphericalGaussian;

use super::Usage;
use super::arguments::{CameraArguments, Point};

pub(super) fn read_scene(path: &Path) -> anyhow::Result<Scene> {
    let bytes = read(path)?;
    let scene = relight_format::read_scene(&bytes, &Limits::default());
    Ok(scene.map_err(|error| Error::asset(path, error))?)
}

/// An environment, ready to light frames.
pub(super) struct Distant {
    pub(super) lights: Vec<SphericalGaussian>,
    pub(super) prefiltered: Option<Prefiltered>,
    pub(super) sources: Option<Sources>,
}

pub(super) fn read_environment(path: &Path) -> anyhow::Result<Distant> {
    let bytes = read(path)?;
    let environment: Environment = relight_format::read_environment(&bytes, &Limits::default())
        .map_err(|error| Error::asset(path, error))?;
    let lights: Vec<_> = environment.lobes.iter().map(Into::into).collect();
    Ok(Distant {
        prefiltered: Prefiltered::new(&environment.prefiltered, &lights),
        sources: Sources::new(&environment),
        lights,
    })
}

/// The `[[lights]]` of a scene file.
pub(super) fn read_local_lights(path: Option<&Path>) -> anyhow::Result<Vec<LocalLight>> {
    let Some(path) = path else {
        return Ok(Vec::new());
    };
    let file = description::load(path)?;
    Ok(file
        .lights
        .iter()
        .map(description::Light::to_local_light)
        .collect())
}

/// The bytes of an asset.
fn read(path: &Path) -> anyhow::Result<Vec<u8>> {
    let access = Access {
        max_bytes: Limits::default().max_bytes,
        ..Access::default()
    };
    Ok(Files::new(path, &access)?.read_named(path)?)
}

/// File, else the scene's own, else one that frames it; then the flags' replacements.
pub(super) fn choose_camera(
    arguments: &CameraArguments,
    own: Option<Camera>,
    scene: &Scene,
) -> anyhow::Result<Camera> {
    let mut chosen = match (&arguments.camera, own) {
        (Some(path), _) => camera::load(path)?,
        (None, Some(own)) => own,
        (None, None) => {
            let positions = scene
                .vertices
                .iter()
                .map(|vertex| Vec3::from(vertex.position));
            let bounds = positions.fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(low, high), p| {
                (low.min(p), high.max(p))
            });
            camera::framing(bounds.0, bounds.1)
        }
    };
    let replace = |part: &mut [f32; 3], with: Option<Point>| {
        if let Some(Point(with)) = with {
            *part = with;
        }
    };
    replace(&mut chosen.position, arguments.position);
    replace(&mut chosen.target, arguments.target);
    replace(&mut chosen.up, arguments.up);
    if let Some(degrees) = arguments.fov_y {
        chosen.field_of_view = FieldOfView::Y(degrees.to_radians());
    }
    if let Some(degrees) = arguments.fov_x {
        chosen.field_of_view = FieldOfView::X(degrees.to_radians());
    }
    camera::check(&chosen).map_err(Usage)?;
    Ok(chosen)
}
