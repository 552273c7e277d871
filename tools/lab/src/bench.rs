//! Every integrator on the same frame: time, work, and error against ray-traced truth.

use std::time::{Duration, Instant};

use glam::{Quat, Vec3};
use relight_format::{Camera, Scene};
use relight_runtime::offscreen::Gpu;
use relight_runtime::{
    CellsOptions, Frame, Method, PassTimes, PolarOptions, Viewpoint, twin, wgpu,
};
use serde::Serialize;

use crate::compare::compare;
use crate::image_file::Image;
use crate::render::Renderer;
use crate::truth::Options;
use crate::truth::lobes::{self, Visibility};

/// One integrator on one frame.
#[derive(Debug, Serialize)]
pub struct Row {
    /// Name of the integrator and its settings.
    pub method: &'static str,
    /// Seconds that shading takes, least of all repetitions: the shading pass on a GPU that tells,
    /// else the whole frame.
    pub seconds: f64,
    /// The same over that of `ambient`.
    pub time_over_ambient: f64,
    /// Seconds of all passes on a GPU that tells.
    pub frame_seconds: Option<f64>,
    /// On a GPU the seconds of a frame among frames that are handed to it one after the other, as apps do: with the light
    /// turned from one to the next.
    pub turning_seconds: Option<f64>,
    /// The same with the eye moved and the light still.
    pub still_seconds: Option<f64>,
    /// Lobes, or with `cells` groups of them, integrated per covered pixel.
    pub integrals: f64,
    /// SSDF samples per covered pixel.
    pub samples: f64,
    /// Interpolated texels of four basis images per covered pixel.
    pub fetches: f64,
    /// SSDF samples and fetches at vertices, per covered pixel: in a frame whose light has turned.
    pub vertex_samples: f64,
    /// See `vertex_samples`.
    pub vertex_fetches: f64,
    /// Rays towards sources per covered pixel.
    pub rays: f64,
    /// Relative RMSE against truth, its noise removed.
    pub relative_rmse: f64,
    /// What it is at most, where noise may explain all of it.
    pub below_noise: Option<f64>,
    /// The same over that of `ambient`.
    pub error_over_ambient: f64,
    /// Mean FLIP against truth.
    pub mean_flip: f64,
}

/// What is drawn, and how often.
#[derive(Clone, Copy, Debug)]
pub struct Settings {
    /// Picture size, pixels.
    pub size: [u32; 2],
    /// Truth samples per pixel.
    pub samples: u32,
    /// Frames per integrator after a first one, at least 1.
    pub repetitions: u32,
}

/// Frames that are handed to a GPU one after the other.
const RUN: u32 = 8;
/// By how much the light turns from one to the next, radians.
const STEP: f32 = 0.01;

/// The integrators in the order of the rows; `ambient` first.
const METHODS: [(&str, Method); 5] = [
    ("ambient", Method::Ambient),
    ("polar draft", Method::Polar(PolarOptions::DRAFT)),
    ("polar standard", Method::Polar(PolarOptions::STANDARD)),
    ("polar high", Method::Polar(PolarOptions::HIGH)),
    ("cells", Method::Cells(CellsOptions::STANDARD)),
];

/// Measures all of them.
pub fn run(
    scene: &Scene,
    frame: &Frame,
    renderer: &mut Renderer,
    settings: &Settings,
) -> anyhow::Result<Vec<Row>> {
    let [width, height] = settings.size;
    let truth = lobes::of_frame(
        scene,
        frame,
        settings.size,
        &Options::centers(settings.samples).of(scene),
        Visibility::Exact,
        &|| (),
    );
    let mut rows: Vec<Row> = Vec::new();
    for (name, method) in METHODS {
        let frame = Frame {
            method,
            ..frame.clone()
        };
        let Timed {
            image,
            shading,
            passes,
        } = draw(scene, &frame, renderer, settings.size, settings.repetitions)?;
        let found = compare(&image, &truth)?;
        let work = twin::work(scene, &frame, width, height)?;
        let pixels = work.pixels.max(1) as f64;
        let seconds = shading.as_secs_f64();
        let relative_rmse = found.noiseless();
        let mut running = [None; 2];
        if let Renderer::Gpu(gpu) = renderer {
            running = running_seconds(gpu, scene, &frame, settings)?.map(Some);
        }
        let first = rows.first();
        rows.push(Row {
            method: name,
            seconds,
            time_over_ambient: first.map_or(1.0, |first| seconds / first.seconds),
            frame_seconds: passes.map(|passes| passes.total().as_secs_f64()),
            turning_seconds: running[0],
            still_seconds: running[1],
            integrals: work.integrals as f64 / pixels,
            samples: work.samples as f64 / pixels,
            fetches: work.fetches as f64 / pixels,
            vertex_samples: work.vertex_samples as f64 / pixels,
            vertex_fetches: work.vertex_fetches as f64 / pixels,
            rays: work.rays as f64 / pixels,
            relative_rmse,
            below_noise: found.below_noise(),
            error_over_ambient: first.map_or(1.0, |first| relative_rmse / first.relative_rmse),
            mean_flip: found.mean_flip,
        });
    }
    Ok(rows)
}

/// Seconds of a frame among [`RUN`] that are handed over without waiting for any of them, the light turned from one to the
/// next, and the eye moved; least of all repetitions. Software draws them one at a time anyway: there it is one.
fn running_seconds(
    gpu: &mut Gpu,
    scene: &Scene,
    frame: &Frame,
    settings: &Settings,
) -> anyhow::Result<[f64; 2]> {
    let uploaded = gpu.upload(scene)?;
    let view = (gpu.target(settings.size)).create_view(&wgpu::TextureViewDescriptor::default());
    let Viewpoint::Pinhole(camera) = frame.camera else {
        anyhow::bail!("frames are timed with a pinhole camera");
    };
    let run = if gpu.is_software() { 1 } else { RUN };
    let mut frame = frame.clone();
    let mut least = [f64::INFINITY; 2];
    let mut turned = 0.0;
    for _ in 0..settings.repetitions {
        for (kind, least) in least.iter_mut().enumerate() {
            gpu.device.poll(wgpu::PollType::wait_indefinitely())?;
            let start = Instant::now();
            for _ in 0..run {
                turned += STEP;
                if kind == 0 {
                    frame.rotation = Quat::from_rotation_y(turned);
                } else {
                    frame.camera = about(&camera, 0.1 * turned.sin()).into();
                }
                let mut encoder = gpu
                    .device
                    .create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
                (gpu.renderer).render(&mut encoder, &uploaded, &frame, &view, settings.size)?;
                gpu.queue.submit([encoder.finish()]);
            }
            gpu.device.poll(wgpu::PollType::wait_indefinitely())?;
            *least = least.min(start.elapsed().as_secs_f64() / f64::from(run));
        }
    }
    Ok(least)
}

/// A camera moved about what it looks at.
fn about(camera: &Camera, angle: f32) -> Camera {
    let [position, target] = [camera.position, camera.target].map(Vec3::from);
    let turn = Quat::from_axis_angle(Vec3::from(camera.up).normalize(), angle);
    Camera {
        position: (target + turn * (position - target)).into(),
        ..*camera
    }
}

/// A frame and how long it took.
pub struct Timed {
    /// What was drawn.
    pub image: Image,
    /// Shading alone on a GPU that tells, else the whole frame.
    pub shading: Duration,
    /// All passes of that frame, on a GPU that tells.
    pub passes: Option<PassTimes>,
}

/// Draws a frame once to make pipelines and images, then `repetitions` times, of which the
/// fastest counts.
pub fn draw(
    scene: &Scene,
    frame: &Frame,
    renderer: &mut Renderer,
    [width, height]: [u32; 2],
    repetitions: u32,
) -> anyhow::Result<Timed> {
    let mut draw: Box<dyn FnMut() -> Result<_, relight_runtime::Error>> = match renderer {
        Renderer::Gpu(gpu) => {
            let uploaded = gpu.upload(scene)?;
            Box::new(move || {
                let image = gpu.render(&uploaded, frame, width, height)?.linear;
                Ok((image, gpu.renderer.pass_times()))
            })
        }
        Renderer::Cpu => Box::new(|| Ok((twin::render(scene, frame, width, height)?, None))),
    };
    let (image, _) = draw()?;
    let mut timed = Timed {
        image: Image {
            width,
            height,
            pixels: image.pixels,
            variance: None,
        },
        shading: Duration::MAX,
        passes: None,
    };
    for _ in 0..repetitions {
        let start = Instant::now();
        let (_, passes) = draw()?;
        let shading = passes.map_or(start.elapsed(), |passes| passes.shade);
        if shading < timed.shading {
            (timed.shading, timed.passes) = (shading, passes);
        }
    }
    Ok(timed)
}
