//! The command line.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::bail;
use clap::{Parser, ValueEnum};
use relight_shading::catcher;

use crate::app::{Start, Viewer};
use crate::compose::Look;
use crate::engine::{Artist, Device, Shot};
use crate::jobs::{self, FileKind, Loaded};
use crate::orbit::Orbit;
use crate::settings;
use crate::state::{Background, Document, Integrator, Layout, Light, LightTurn, Quality, Settings};
use crate::turntable::{self, Turn, Turntable};

/// Of the window, points.
const WINDOW: [u32; 2] = [1280, 800];
/// Of a picture, pixels.
const PICTURE: [u32; 2] = [960, 720];

/// Looks at scenes, turns their light and edits their materials.
#[derive(Debug, Parser)]
#[command(name = "viewer", version)]
struct Arguments {
    /// Scenes (.toml, .gltf, .glb, .obj, .relight), images (.hdr, .exr), materials (.bsdf,
    /// .binary); without any, a built-in scene.
    files: Vec<PathBuf>,
    /// Distant light: an image or an environment asset.
    #[arg(long, value_name = "FILE")]
    environment: Option<PathBuf>,
    /// Where to draw: a graphics card if there is one (auto), any graphics device (gpu), the
    /// processor (cpu).
    #[arg(long, value_enum, default_value_t = DeviceArgument::Auto)]
    device: DeviceArgument,
    /// How well meshes are baked.
    #[arg(long, value_enum)]
    quality: Option<QualityArgument>,
    /// Lobes to fit to images [default: as many as it takes, 8 to 64].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=256))]
    lobes: Option<u16>,
    /// Write a picture and end, without a window.
    #[arg(long, value_name = "OUT.png")]
    screenshot: Option<PathBuf>,
    /// Write a picture of the whole window once everything is drawn, and end.
    #[arg(long, value_name = "OUT.png", conflicts_with_all = ["screenshot", "turntable"])]
    window_picture: Option<PathBuf>,
    /// How many pictures the window shows: one, two with a divider, or how far apart they are.
    #[arg(long, value_enum)]
    layout: Option<LayoutArgument>,
    /// Draw a whole turn into this folder and end, without a window.
    #[arg(long, value_name = "FOLDER")]
    turntable: Option<PathBuf>,
    /// What a turntable turns.
    #[arg(long, value_enum, default_value_t = TurnArgument::Light)]
    turn: TurnArgument,
    /// Frames of a turntable.
    #[arg(long, default_value_t = 48)]
    frames: u32,
    /// Size of pictures, pixels, 960x720 if it is not given; of the window, points.
    #[arg(long, value_name = "WxH", value_parser = size)]
    size: Option<[u32; 2]>,
    /// Camera file for pictures, in place of the scene's.
    #[arg(long, value_name = "FILE")]
    camera: Option<PathBuf>,
    /// Turn of the light in pictures, degrees.
    #[arg(
        long,
        value_name = "DEGREES",
        default_value_t = 0.0,
        allow_negative_numbers = true
    )]
    rotation: f32,
    /// Stops of exposure in pictures.
    #[arg(
        long,
        value_name = "STOPS",
        default_value_t = 0.0,
        allow_negative_numbers = true
    )]
    exposure: f32,
    /// How light is integrated in pictures.
    #[arg(long, value_enum, default_value_t = MethodArgument::Polar)]
    method: MethodArgument,
    /// What is behind the scene in pictures.
    #[arg(long, value_enum, default_value_t = BackgroundArgument::Blurred)]
    background: BackgroundArgument,
    /// Samples per pixel of ray-traced pictures.
    #[arg(long, value_name = "N", default_value_t = 64)]
    samples: u32,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum DeviceArgument {
    Auto,
    Gpu,
    Cpu,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum QualityArgument {
    Draft,
    Standard,
    High,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum LayoutArgument {
    One,
    Split,
    Difference,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum TurnArgument {
    Light,
    Camera,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum MethodArgument {
    Ambient,
    PolarDraft,
    Polar,
    PolarHigh,
    Cells,
    Truth,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum BackgroundArgument {
    Sharp,
    Blurred,
    Grey,
    None,
}

fn size(text: &str) -> Result<[u32; 2], String> {
    let parsed = text
        .split_once('x')
        .and_then(|(width, height)| Some([width.parse().ok()?, height.parse().ok()?]));
    parsed
        .filter(|size: &[u32; 2]| size.iter().all(|side| (1..=16384).contains(side)))
        .ok_or_else(|| "expected WIDTHxHEIGHT, each 1 to 16384".to_owned())
}

/// Parses the command line and runs the application. 0 done, 1 the input is not what it should be
/// or there is no window, 2 the command line is wrong.
pub fn run() -> ExitCode {
    let arguments = Arguments::parse();
    let result = if arguments.screenshot.is_some() || arguments.turntable.is_some() {
        pictures(&arguments)
    } else {
        window(&arguments)
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {}", relight_bake::error::sentence(error.chain()));
            ExitCode::FAILURE
        }
    }
}

impl Arguments {
    fn device(&self) -> Device {
        match self.device {
            DeviceArgument::Auto => Device::Auto,
            DeviceArgument::Gpu => Device::Gpu,
            DeviceArgument::Cpu => Device::Cpu,
        }
    }

    fn settings(&self, mut settings: Settings) -> Settings {
        if let Some(quality) = self.quality {
            settings.quality = match quality {
                QualityArgument::Draft => Quality::Draft,
                QualityArgument::Standard => Quality::Standard,
                QualityArgument::High => Quality::High,
            };
        }
        if let Some(layout) = self.layout {
            settings.layout = match layout {
                LayoutArgument::One => Layout::One,
                LayoutArgument::Split => Layout::Split,
                LayoutArgument::Difference => Layout::Difference,
            };
        }
        if let Some(lobes) = self.lobes {
            settings.lobes = usize::from(lobes);
        }
        settings
    }

    fn integrator(&self) -> Integrator {
        match self.method {
            MethodArgument::Ambient => Integrator::Ambient,
            MethodArgument::PolarDraft => Integrator::PolarDraft,
            MethodArgument::Polar => Integrator::Polar,
            MethodArgument::PolarHigh => Integrator::PolarHigh,
            MethodArgument::Cells => Integrator::Cells,
            MethodArgument::Truth => Integrator::Truth,
        }
    }

    fn background(&self) -> Background {
        match self.background {
            BackgroundArgument::Sharp => Background::Sharp,
            BackgroundArgument::Blurred => Background::Blurred,
            BackgroundArgument::Grey => Background::Off,
            BackgroundArgument::None => Background::Transparent,
        }
    }
}

fn window(arguments: &Arguments) -> anyhow::Result<()> {
    let options = eframe::NativeOptions {
        viewport: egui::ViewportBuilder::default()
            .with_title("Relight")
            .with_inner_size(arguments.size.unwrap_or(WINDOW).map(|side| side as f32))
            .with_drag_and_drop(true),
        ..Default::default()
    };
    let files = arguments
        .environment
        .iter()
        .chain(&arguments.files)
        .cloned()
        .collect();
    let start = Start {
        files,
        device: arguments.device(),
        settings: Some(arguments.settings(settings::read())),
        capture: arguments.window_picture.clone(),
    };
    eframe::run_native(
        "relight-viewer",
        options,
        Box::new(move |creation| Ok(Box::new(Viewer::new(&creation.egui_ctx, &start)))),
    )
    .map_err(|error| anyhow::anyhow!("no window: {error}"))
}

/// Draws without a window.
fn pictures(arguments: &Arguments) -> anyhow::Result<()> {
    let settings = arguments.settings(Settings::default());
    let size = arguments.size.unwrap_or(PICTURE);
    let (document, named) = final_scene(arguments, &settings)?;
    let environment = arguments.environment.clone().or(named);
    let light = final_light(&settings, environment.as_deref())?;
    let camera = match &arguments.camera {
        Some(path) => relight_lab::camera::load(path)?,
        None if document.scene.camera.is_some() => document.camera().camera(),
        None => {
            let [width, height] = size.map(|side| side as f32);
            let (low, high) = document.bounds;
            let orbit: Orbit = document.camera();
            orbit.framing(low, high, width / height).camera()
        }
    };
    let turn = LightTurn {
        yaw: arguments.rotation.to_radians(),
        pitch: 0.0,
    };
    let integrator = arguments.integrator();
    let shot = Shot {
        scene: document.scene.clone(),
        materials: document.materials.clone(),
        camera,
        lights: light.lobes.clone(),
        reflections: light
            .prefiltered
            .clone()
            .filter(|_| integrator != Integrator::Truth),
        sources: light.sources.clone(),
        rotation: turn.rotation(),
        local_lights: document.local_lights.clone(),
        integrator,
    };
    let look = Look {
        background: arguments.background(),
        exposure: arguments.exposure,
        catches: catcher::catches(&document.materials),
        ..Look::from(&settings)
    };
    if let Some(path) = &arguments.screenshot {
        let mut artist = Artist::open(arguments.device());
        let passes = arguments.samples.div_ceil(8);
        if path
            .extension()
            .is_some_and(|ending| ending.eq_ignore_ascii_case("exr"))
        {
            let image = artist
                .finished(&shot, size, passes)
                .map_err(anyhow::Error::msg)?;
            crate::save::exr(path, &image)?;
        } else {
            let pixels = turntable::still(&mut artist, &shot, &light, &look, size, passes)?;
            crate::save::png(path, size, &pixels)?;
        }
        println!("{}", path.display());
    }
    if let Some(folder) = &arguments.turntable {
        let options = Turntable {
            turn: match arguments.turn {
                TurnArgument::Light => Turn::Light,
                TurnArgument::Camera => Turn::Camera,
            },
            frames: arguments.frames,
            size,
            ..Turntable::default()
        };
        let device = arguments.device();
        let said = jobs::collect(|context| {
            turntable::draw(&options, &shot, &light, &look, folder, device, context)
        })?;
        for loaded in said {
            if let Loaded::Saved(what) = loaded {
                println!("{what}");
            }
        }
    }
    Ok(())
}

fn final_scene(
    arguments: &Arguments,
    settings: &Settings,
) -> anyhow::Result<(Document, Option<PathBuf>)> {
    let best = &[settings.quality];
    let stages = match &arguments.files[..] {
        [] => jobs::collect(|context| jobs::built_in_scene(best, context))?,
        [file] if jobs::kind_of(file) == Some(FileKind::Scene) => {
            jobs::collect(|context| jobs::scene_from_file(file, best, context))?
        }
        [file] => bail!("{}: expected a scene", file.display()),
        _ => bail!("expected one scene, found {} files", arguments.files.len()),
    };
    match stages.into_iter().last() {
        Some(Loaded::Scene {
            scene,
            source,
            quality,
            lights,
            environment,
            warnings,
            ..
        }) => {
            for warning in warnings {
                eprintln!("warning: {warning}");
            }
            Ok((Document::new(scene, source, quality, lights), environment))
        }
        _ => bail!("nothing was loaded"),
    }
}

fn final_light(settings: &Settings, path: Option<&Path>) -> anyhow::Result<Light> {
    let lobes = &[settings.lobes];
    let stages = match path {
        Some(path) => jobs::collect(|context| jobs::light_from_file(path, lobes, context))?,
        None => jobs::collect(|context| jobs::built_in_light(lobes, context))?,
    };
    match stages.into_iter().last() {
        Some(Loaded::Light(light)) => Ok(light),
        _ => bail!("nothing was loaded"),
    }
}
