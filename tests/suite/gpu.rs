//! Baked assets drawn by the GPU and by its twin: the same picture. (The runtime's own
//! tests compare them stage by stage, on scenes that need no bake.)

use std::path::Path;
use std::sync::{Mutex, PoisonError};

use glam::{Quat, Vec3};
use libtest_mimic::Trial;
use relight_bake::monitor;
use relight_bake::scene::{self, load};
use relight_format::{Limits, Scene, read_scene, write_scene};
use relight_lab::camera::framing;
use relight_lab::compare::compare;
use relight_lab::image_file::Image;
use relight_runtime::offscreen::Gpu;
use relight_runtime::twin::{self, Placed};
use relight_runtime::{
    Background, Frame, Instance, Method, Placement, PolarOptions, SphericalGaussian, wgpu,
};

use crate::meshes::sphere_over_ground;
use crate::support::{Outcome, with_data_and_gpu, with_gpu};

/// Relative RMSE of a frame, between devices: texture filtering has 8-bit weights on a GPU
/// and `exp` differs in the last bits, both far below this; a spoke that grazes a boundary
/// amplifies them, for few pixels.
const RELATIVE_RMSE: f64 = 2e-3;
/// Pixels of the silhouette that may fall to either side, as a fraction: vertices snap to
/// 1/256 of a pixel after differently rounded arithmetic.
const COVERAGE_MISMATCH: f64 = 2e-3;

/// A device at WebGPU's default limits, opened once: compiling shaders takes seconds.
static GPU: Mutex<Option<Gpu>> = Mutex::new(None);

const WIDTH: u32 = 160;
const HEIGHT: u32 = 120;

pub fn trials() -> Vec<Trial> {
    vec![
        with_gpu("gpu::made_scene_matches_twin", made_scene),
        with_data_and_gpu("gpu::textured_duck_matches_twin", |data| {
            matches_twin(&data.join("meshes/figures/Duck.glb"))
        }),
        with_data_and_gpu("gpu::normal_mapped_sphere_matches_twin", |data| {
            matches_twin(&data.join("meshes/awkward/gltf/sphere/sphere.gltf"))
        }),
    ]
}

fn made_scene() -> Outcome {
    let folder = tempfile::tempdir()?;
    let mesh = folder.path().join("sphere.obj");
    std::fs::write(&mesh, sphere_over_ground(24))?;
    matches_twin(&mesh)
}

/// Bakes a mesh as a file would hold it.
fn bake(mesh: &Path) -> Result<Scene, libtest_mimic::Failed> {
    let mut input = load::load(mesh)?;
    input.mesh.materials[0].emission = [0.02, 0.1, 0.05];
    // Coarse: both devices draw the same errors.
    let mut options = scene::Options {
        max_edge: 0.05,
        least_vertices: 0,
        ..scene::Options::draft()
    };
    options.transfer.bounces = None;
    let (scene, _) = scene::bake(input, &options, monitor::SILENT)?;
    Ok(read_scene(&write_scene(&scene)?, &Limits::default())?)
}

/// A narrow warm light, a wide blue one and a dim one from everywhere.
fn lights() -> [SphericalGaussian; 3] {
    let light = |axis: Vec3, sharpness, amplitude: [f32; 3]| SphericalGaussian {
        axis: axis.normalize(),
        sharpness,
        amplitude: amplitude.into(),
    };
    [
        light(Vec3::new(1.0, 1.2, 0.3), 200.0, [40.0, 30.0, 20.0]),
        light(Vec3::new(-0.8, 0.9, 0.6), 12.0, [0.5, 1.5, 3.0]),
        light(Vec3::Y, 1.5, [0.2, 0.25, 0.3]),
    ]
}

fn matches_twin(mesh: &Path) -> Outcome {
    let scene = bake(mesh)?;
    assert!(scene.transfer.is_some(), "light bounces");
    let positions = scene
        .vertices
        .iter()
        .map(|vertex| Vec3::from(vertex.position));
    let (low, high) = positions.fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(low, high), p| {
        (low.min(p), high.max(p))
    });
    // A trial that failed leaves the device as good as it was.
    let mut gpu = GPU.lock().unwrap_or_else(PoisonError::into_inner);
    let gpu = match &mut *gpu {
        Some(gpu) => gpu,
        none => none.insert(Gpu::new(&wgpu::Limits::default())?),
    };
    let uploaded = gpu.upload(&scene)?;
    let lights = lights();
    // Seen twice, so that each has bounced light of its own.
    let beside = Placement {
        rotation: Quat::from_rotation_y(2.0),
        translation: 0.5 * (high - low),
        scale: 0.5,
    };
    let placements = [Placement::IDENTITY, beside];
    let instances = placements.map(|placement| Instance {
        scene: &uploaded,
        placement,
    });
    let placed = placements.map(|placement| Placed {
        scene: &scene,
        placement,
    });
    let mut view = gpu.renderer.view([WIDTH, HEIGHT])?;
    for method in [Method::Ambient, Method::Polar(PolarOptions::default())] {
        let frame = Frame {
            camera: framing(low, high).into(),
            lights: &lights,
            rotation: Quat::from_rotation_y(0.4),
            reflections: None,
            sources: None,
            local_lights: &[],
            method,
            antialias: false,
            exposure: 1.0,
            shadow_map: None,
            background: Background::Transparent,
        };
        let mut encoder = gpu
            .device
            .create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        (gpu.renderer).prepare(&mut encoder, &mut view, &instances, &frame)?;
        gpu.queue.submit([encoder.finish()]);
        let drawn = relight_runtime::Image {
            width: WIDTH,
            height: HEIGHT,
            pixels: gpu.read_radiance(&view)?,
        };
        let expected = twin::render_instances(&placed, &frame, WIDTH, HEIGHT)?;
        let [drawn, expected] = [drawn, expected].map(|image| Image {
            width: WIDTH,
            height: HEIGHT,
            pixels: image.pixels,
            variance: None,
        });
        let difference = compare(&drawn, &expected)?;
        println!("{}: {method:?}: {difference:?}", mesh.display());
        assert!(difference.covered_pixels > 2000, "{difference:?}");
        assert!(
            difference.coverage_mismatch <= COVERAGE_MISMATCH,
            "{difference:?}"
        );
        assert!(
            difference.relative_rmse <= RELATIVE_RMSE,
            "{method:?}: {difference:?}"
        );
    }
    Ok(())
}
