//! The whole path on a scene of its own making: mesh and HDR environment, bake, assets,
//! runtime, ray-traced truth, and the errors between them.

use std::f32::consts::TAU;
use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::Context as _;
use glam::Vec3;
use relight_bake::environment::hdr::LatLong;
use relight_bake::mesh::Mesh;
use relight_bake::monitor::Monitor;
use relight_bake::scene::description::Ground;
use relight_bake::scene::load::SceneInput;
use relight_bake::{environment, scene};
use relight_format::{
    self as format, Camera, FieldOfView, Limits, Specular, Surface, VisibilityErrors,
    plain_material,
};
use relight_runtime::Frame;
use relight_shading::polar::PolarOptions;
use relight_shading::shade::Method;
use relight_shading::sources::Sources;
use relight_shading::spherical_gaussian::SphericalGaussian;
use serde::Serialize;

use crate::compare::{Comparison, compare};
use crate::display;
use crate::image_file;
use crate::render::{Device, Renderer};
use crate::shapes::{over_ground, sphere, tube};
use crate::truth;
use crate::truth::lobes::{self, Visibility};

/// What to trade for time.
#[derive(Clone, Debug)]
pub struct Options {
    /// Folder for the assets and pictures; created if absent.
    pub folder: PathBuf,
    /// Picture size, pixels.
    pub size: [u32; 2],
    /// Lobes fitted to the environment.
    pub lobes: usize,
    /// Truth samples per pixel.
    pub samples: u32,
    /// Where to render.
    pub device: Device,
    /// Bake options.
    pub bake: scene::Options,
}

/// What was made and how far each method is from the truth.
#[derive(Debug, Serialize)]
pub struct Report {
    /// Ambient, polar and truth side by side, PNG.
    pub triptych: PathBuf,
    /// The scene asset.
    pub scene: PathBuf,
    /// The environment asset.
    pub environment: PathBuf,
    /// Adapter that rendered, or `cpu`.
    pub device: String,
    /// Vertices of the asset.
    pub vertices: usize,
    /// Bytes of the scene asset.
    pub bytes: usize,
    /// How far visibility is off.
    pub visibility: VisibilityErrors,
    /// Relative L2 error of the environment's lobes.
    pub environment_relative_l2: f32,
    /// Against truth with the same lobes.
    pub ambient: Comparison,
    /// Against truth with the same lobes.
    pub polar: Comparison,
    /// Stage and wall-clock seconds, in order.
    pub seconds: Vec<(&'static str, f64)>,
}

/// Runs everything and writes the assets and pictures.
pub fn run(options: &Options, monitor: Monitor) -> anyhow::Result<Report> {
    display::create_folder(&options.folder)?;
    let mut seconds = Vec::new();
    let mut clock = Instant::now();
    let mut lap = |stage| {
        seconds.push((stage, clock.elapsed().as_secs_f64()));
        clock = Instant::now();
    };
    let (baked, _) = scene::bake(scene_input(1.0)?, &options.bake, monitor)?;
    let scene_path = options.folder.join("demo.relight");
    let bytes = format::write_scene(&baked)?;
    format::write_file(&scene_path, &bytes)?;
    // What is rendered is what was read back.
    let scene = format::read_scene(&read(&scene_path)?, &Limits::default())?;
    lap("bake scene");

    let image = sky(512, 256);
    let fit = environment::FitOptions::with_lobes(options.lobes);
    let fitted = environment::fit(&image, &fit, monitor)?.environment;
    let environment_path = options.folder.join("demo-environment.relight");
    format::write_file(&environment_path, &format::write_environment(&fitted)?)?;
    let environment = format::read_environment(&read(&environment_path)?, &Limits::default())?;
    let lights: Vec<SphericalGaussian> = environment.lobes.iter().map(Into::into).collect();
    let sources = Sources::new(&environment);
    lap("bake environment");

    let mut renderer = Renderer::open(options.device)?;
    let camera = scene.camera.context("the demo scene has a camera")?;
    let frame = Frame {
        sources: sources.as_ref(),
        antialias: true,
        ..Frame::new(camera, &lights)
    };
    let mut render = |method| {
        let frame = Frame {
            method,
            ..frame.clone()
        };
        renderer.render(&scene, &frame, options.size)
    };
    monitor.step("render ambient", 0.0)?;
    let ambient = render(Method::Ambient)?;
    lap("render ambient");
    monitor.step("render polar", 0.0)?;
    let polar = render(Method::Polar(PolarOptions::default()))?;
    lap("render polar");

    let [_, height] = options.size;
    let rows = std::sync::atomic::AtomicU32::new(0);
    let row_done = || {
        let done = rows.fetch_add(1, std::sync::atomic::Ordering::Relaxed) + 1;
        let _ = monitor.step("trace truth", done as f32 / height as f32);
    };
    let truth = lobes::of_frame(
        &scene,
        &frame,
        options.size,
        &truth::Options {
            filter: truth::Filter::Box,
            ..truth::Options::centers(options.samples)
        },
        Visibility::Exact,
        &row_done,
    );
    monitor.step("trace truth", 1.0)?;
    lap("trace truth");

    let triptych = options.folder.join("demo.png");
    let shown = [&ambient, &polar, &truth];
    let exposure = display::automatic_exposure(&truth);
    let (joined, pixels) = display::side_by_side(&shown, exposure);
    image_file::write_png(&triptych, joined, &pixels)?;
    for (name, image) in [("ambient", &ambient), ("polar", &polar), ("truth", &truth)] {
        image_file::write_exr(&options.folder.join(name).with_extension("exr"), image)?;
    }
    Ok(Report {
        triptych,
        scene: scene_path,
        environment: environment_path,
        device: renderer.name().to_owned(),
        vertices: scene.vertices.len(),
        bytes: bytes.len(),
        visibility: scene.report.errors,
        environment_relative_l2: environment.report.relative_l2,
        ambient: compare(&ambient, &truth)?,
        polar: compare(&polar, &truth)?,
        seconds,
    })
}

fn read(path: &Path) -> anyhow::Result<Vec<u8>> {
    std::fs::read(path).with_context(|| path.display().to_string())
}

/// A knot, a sphere of brushed gold and a post over a glossy plane. `detail` is that of the demo
/// at 1, with a quarter of its vertices at ½.
pub fn scene_input(detail: f32) -> anyhow::Result<SceneInput> {
    let count = |of_demo: f32| (detail * of_demo).round().max(3.0) as u32;
    let mut mesh = Mesh::default();
    let material = |name: &str, diffuse, f0, alpha: [f32; 2]| {
        let specular = Specular::Ggx { f0, alpha };
        plain_material(name, Surface::DiffuseSpecular { diffuse, specular })
    };
    mesh.materials = vec![
        material("knot", [0.6, 0.6, 0.62], [0.04; 3], [0.3; 2]),
        material("gold", [0.0; 3], [1.0, 0.71, 0.29], [0.12, 0.4]),
        material("post", [0.55, 0.5, 0.45], [0.04; 3], [0.5; 2]),
    ];
    tube(&mut mesh, 0, count(320.0), count(20.0), 0.13, |t| {
        let (a, b) = (2.0 * TAU * t, 3.0 * TAU * t);
        let ring = 0.62 + 0.26 * b.cos();
        Vec3::new(ring * a.cos(), 0.78 + 0.3 * b.sin(), ring * a.sin())
    });
    sphere(&mut mesh, 1, Vec3::new(1.35, 0.42, 0.35), 0.42, count(48.0));
    for x in [-1.5, -1.2] {
        let base = Vec3::new(x, 0.0, 0.3);
        tube(&mut mesh, 2, count(24.0), count(12.0), 0.05, |t| {
            base + 1.5 * Vec3::Y * t
        });
    }
    let surface = Surface::DiffuseSpecular {
        diffuse: [0.45; 3],
        specular: Specular::Ggx {
            f0: [0.06; 3],
            alpha: [0.25; 2],
        },
    };
    let ground = Ground {
        size: Some(6.0),
        height: Some(0.0),
        center: None,
        spacing: Some(0.06 / detail),
        material: None,
    };
    let camera = Camera {
        position: [0.4, 2.3, 4.4],
        target: [0.0, 0.45, 0.0],
        up: [0.0, 1.0, 0.0],
        field_of_view: FieldOfView::Y(0.62),
    };
    over_ground("demo", mesh, &ground, surface, camera)
}

/// Three coloured lights of different size over a dim sky, lat-long.
pub fn sky(width: u32, height: u32) -> LatLong {
    // Direction, sharpness, radiance.
    let lights = [
        (
            Vec3::new(-0.75, 0.6, 0.35),
            400.0,
            Vec3::new(60.0, 14.0, 5.0),
        ),
        (Vec3::new(0.8, 0.75, 0.15), 120.0, Vec3::new(3.0, 16.0, 6.0)),
        (Vec3::new(0.1, 0.7, -0.75), 40.0, Vec3::new(1.5, 2.5, 9.0)),
    ];
    let pixels = (0..width * height)
        .map(|i| {
            let (u, v) = ((i % width) as f64 + 0.5, (i / width) as f64 + 0.5);
            let direction = LatLong::direction_at(u / f64::from(width), v / f64::from(height));
            let direction = direction.as_vec3();
            let sky = Vec3::new(0.05, 0.06, 0.09) * (0.3 + 0.7 * direction.y.max(0.0));
            let light: Vec3 = lights
                .iter()
                .map(|(axis, sharpness, radiance)| {
                    let cosine = axis.normalize().dot(direction);
                    *radiance * (sharpness * (cosine - 1.0)).exp()
                })
                .sum();
            (sky + light).to_array()
        })
        .collect();
    LatLong::repair(width, height, pixels)
}
