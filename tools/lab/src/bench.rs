//! Every integrator on the same frame: time, work, and error against ray-traced truth.

use std::time::{Duration, Instant};

use relight_format::Scene;
use relight_runtime::{CellsOptions, Frame, Method, PassTimes, PolarOptions, twin};
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
        let first = rows.first();
        rows.push(Row {
            method: name,
            seconds,
            time_over_ambient: first.map_or(1.0, |first| seconds / first.seconds),
            frame_seconds: passes.map(|passes| passes.total().as_secs_f64()),
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
