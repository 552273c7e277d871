//! The command line: arguments to plain options, results to text or JSON, failures to exit
//! codes.

mod arguments;
mod inputs;

use std::process::ExitCode;
use std::time::Instant;

use anyhow::Context as _;
use clap::Parser as _;
use indicatif::{ProgressBar, ProgressStyle};
use relight_bake::environment::hdr;
use relight_bake::error::{Error, Objection};
use relight_bake::files::{Access, Files, OutputError};
use relight_bake::monitor::{Monitor, Progress};
use relight_bake::scene::{self, load};
use relight_lab::truth::{self, Filter, Geometry, full, lobes};
use relight_lab::{bench, compare, demo, display, experiments, image_file, render};
use relight_shading::camera::View;
use relight_shading::gpu;
use relight_shading::occluders::Occluders;
use relight_shading::polar::PolarOptions;
use relight_shading::shade::CellsOptions;
use relight_shading::shade::{Lighting, Method};
use relight_shading::sources::Lit;
use serde_json::{Value, json};

use arguments::{
    Bench, Cli, Command, Compare, Demo, Experiments, FilterName, Kind, MethodName, PresetName,
    QualityName, ReflectionsName, Render, Truth,
};
use inputs::{Distant, choose_camera, read_environment, read_local_lights, read_scene};

fn exit_code(error: &anyhow::Error) -> u8 {
    for cause in error.chain() {
        if cause.is::<NoGpu>() {
            return 4;
        }
        if cause.is::<std::io::Error>() || cause.is::<OutputError>() {
            return 3;
        }
        if cause.is::<Usage>() {
            return 2;
        }
    }
    1
}

/// A GPU was demanded.
#[derive(Debug, thiserror::Error)]
#[error("--device gpu")]
struct NoGpu(#[source] relight_runtime::Error);

/// The command line is wrong in a way that its syntax does not tell. The place is the option.
#[derive(Debug, thiserror::Error)]
#[error(transparent)]
struct Usage(Objection);

/// Parses the command line and runs the command.
pub fn run() -> ExitCode {
    let cli = Cli::parse();
    let result = match &cli.command {
        Command::Render(arguments) => run_render(arguments),
        Command::Truth(arguments) => run_truth(arguments),
        Command::Compare(arguments) => run_compare(arguments),
        Command::Bench(arguments) => run_bench(arguments, cli.json),
        Command::Demo(arguments) => run_demo(arguments, cli.json),
        Command::Experiments(arguments) => run_experiments(arguments, cli.json),
    };
    match result {
        Ok(report) if cli.json => println!("{report}"),
        Ok(report) => print_plain(&report),
        Err(error) => {
            eprintln!("error: {}", relight_bake::error::sentence(error.chain()));
            return ExitCode::from(exit_code(&error));
        }
    }
    ExitCode::SUCCESS
}

/// One line per entry of a JSON object.
fn print_plain(report: &Value) {
    for (name, value) in report.as_object().into_iter().flatten() {
        match value {
            Value::Null => {}
            Value::String(text) => println!("{name}: {text}"),
            other => println!("{name}: {other}"),
        }
    }
}

fn run_render(arguments: &Render) -> anyhow::Result<Value> {
    display::check_output(&arguments.picture.output)?;
    let scene = read_scene(&arguments.scene)?;
    let Distant {
        lights,
        prefiltered,
        sources,
    } = read_environment(&arguments.environment)?;
    let picture = &arguments.picture;
    let local_lights = read_local_lights(picture.lights.as_deref())?;
    let reflections = match arguments.reflections {
        ReflectionsName::Auto => prefiltered,
        ReflectionsName::Lobes => None,
        ReflectionsName::Prefiltered => Some(prefiltered.ok_or_else(|| {
            let expected = "a prefiltered image, as --reflections prefiltered needs";
            Error::invalid(&arguments.environment, "environment", expected, "none")
        })?),
    };
    let method = match arguments.method {
        MethodName::Ambient => Method::Ambient,
        MethodName::Polar => {
            let quality = match arguments.quality {
                QualityName::Draft => PolarOptions::DRAFT,
                QualityName::Standard => PolarOptions::STANDARD,
                QualityName::High => PolarOptions::HIGH,
            };
            Method::Polar(PolarOptions {
                spokes: arguments.spokes.unwrap_or(quality.spokes),
            })
        }
        MethodName::Cells => {
            let default = CellsOptions::default();
            Method::Cells(CellsOptions {
                boundary_error: arguments.boundary_error.unwrap_or(default.boundary_error),
                lobe_error: arguments.lobe_error.unwrap_or(default.lobe_error),
                uniform: arguments.partition,
            })
        }
    };
    let mut renderer = render::Renderer::open(arguments.device.into()).map_err(NoGpu)?;
    let camera = choose_camera(&picture.camera, scene.camera, &scene)?;
    let frame = relight_runtime::Frame {
        reflections: reflections.as_ref(),
        sources: sources.as_ref(),
        rotation: glam::Quat::from_rotation_y(picture.rotate.to_radians()),
        local_lights: &local_lights,
        method,
        antialias: arguments.antialias,
        ..relight_runtime::Frame::new(camera, &lights)
    };
    let start = Instant::now();
    let image = renderer.render(&scene, &frame, picture.size)?;
    let seconds = start.elapsed().as_secs_f64();
    display::write_image(&picture.output, &image, picture.exposure)?;
    Ok(json!({
        "output": picture.output,
        "width": image.width,
        "height": image.height,
        "device": renderer.name(),
        "method": match method {
            Method::Ambient => "ambient",
            Method::Polar(_) => "polar",
            Method::Cells(_) => "cells",
        },
        "lights": lights.len(),
        "local_lights": local_lights.len(),
        "reflections": if reflections.is_some() { "prefiltered" } else { "lobes" },
        "covered_pixels": covered(&image),
        "seconds": seconds,
    }))
}

/// Seconds of a frame among others, where a GPU draws.
fn running(seconds: Option<f64>) -> String {
    seconds.map_or_else(|| "-".into(), |seconds| format!("{seconds:.4}"))
}

fn run_bench(arguments: &Bench, json: bool) -> anyhow::Result<Value> {
    let scene = read_scene(&arguments.scene)?;
    let Distant {
        lights, sources, ..
    } = read_environment(&arguments.environment)?;
    let camera = choose_camera(&arguments.camera, scene.camera, &scene)?;
    let mut renderer = render::Renderer::open(arguments.device.into()).map_err(NoGpu)?;
    let settings = bench::Settings {
        size: arguments.size,
        samples: arguments.samples,
        repetitions: arguments.repetitions,
    };
    let frame = relight_runtime::Frame {
        sources: sources.as_ref(),
        ..relight_runtime::Frame::new(camera, &lights)
    };
    let rows = bench::run(&scene, &frame, &mut renderer, &settings)?;
    if !json {
        println!(
            "{:<16}{:>10}{:>10}{:>10}{:>10}{:>10}{:>10}{:>10}{:>10}{:>10}{:>10}",
            "",
            "seconds",
            "/ambient",
            "turning",
            "still",
            "samples",
            "fetches",
            "at vert.",
            "rays",
            "error",
            "/ambient"
        );
        for row in &rows {
            println!(
                "{:<16}{:>10.4}{:>10.2}{:>10}{:>10}{:>10.0}{:>10.0}{:>10.0}{:>10.1}{:>9}%{:>10.2}",
                row.method,
                row.seconds,
                row.time_over_ambient,
                running(row.turning_seconds),
                running(row.still_seconds),
                row.samples,
                row.fetches,
                row.vertex_fetches,
                row.rays,
                compare::percent(row.relative_rmse, row.below_noise, 3),
                row.error_over_ambient
            );
        }
    }
    Ok(json!({
        "device": renderer.name(),
        "width": arguments.size[0],
        "height": arguments.size[1],
        "lights": lights.len(),
        "methods": if json { json!(rows) } else { Value::Null },
    }))
}

#[allow(
    clippy::too_many_lines,
    reason = "one command: its options, its pictures, its report"
)]
fn run_truth(arguments: &Truth) -> anyhow::Result<Value> {
    let picture = &arguments.picture;
    display::check_output(&picture.output)?;
    let mut options = truth::Options {
        samples: arguments.samples,
        filter: match arguments.filter {
            FilterName::Center => Filter::Center,
            FilterName::Box => Filter::Box,
        },
        seed: arguments.seed,
        bounces: arguments.bounces.unwrap_or(0),
    };
    let rotation = picture.rotate.to_radians();
    let mut local: Vec<gpu::LocalLight> = read_local_lights(picture.lights.as_deref())?
        .iter()
        .map(Into::into)
        .collect();
    let [width, height] = picture.size;
    let bar = ProgressBar::new(height.into()).with_style(
        ProgressStyle::with_template("{bar:40} {pos}/{len} rows, {eta} left")
            .expect("a valid template"),
    );
    let row_done = || bar.inc(1);
    let start;
    let image = match arguments.kind {
        Kind::Lobes => {
            let scene = read_scene(&arguments.scene)?;
            if arguments.bounces.is_none() {
                options = options.of(&scene);
            }
            let environment = arguments.environment.as_deref().ok_or_else(|| {
                Usage(Objection::new(
                    "--environment",
                    "a baked environment",
                    "none",
                ))
            })?;
            let turn = glam::Mat3::from_rotation_y(rotation);
            let distant = read_environment(environment)?;
            let lights: Vec<_> = (distant.lights.iter())
                .map(|light| light.rotate(&turn))
                .collect();
            let sources = distant.sources.map(|sources| sources.turned(&turn));
            let camera = choose_camera(&picture.camera, scene.camera, &scene)?;
            start = Instant::now();
            let geometry = Geometry::new(&scene, View::new(&camera, width, height, 1.0));
            // Rays are cast by `geometry`.
            let occluders = Occluders::default();
            let lighting = Lighting {
                lights: &lights,
                local: &local,
                sources: sources.as_ref().map(|sources| Lit {
                    sources,
                    occluders: &occluders,
                    ray_offset: 0.0,
                    pixel: None,
                    shadow_map: None,
                }),
                ..Lighting::default()
            };
            let visibility = arguments.visibility.into();
            lobes::render(
                &geometry,
                &lighting,
                visibility,
                picture.size,
                &options,
                &row_done,
            )
        }
        Kind::Full => {
            let access = Access {
                root: arguments.root.clone(),
                ..Access::default()
            };
            let files = Files::new(&arguments.scene, &access)?;
            let loaded = load::load_from(&files, &arguments.scene)?;
            for warning in &loaded.warnings {
                eprintln!("warning: {warning}");
            }
            let path = arguments
                .environment
                .as_ref()
                .or(loaded.environment.as_ref());
            let path = path.ok_or_else(|| {
                Usage(Objection::new("--environment", "a lat-long image", "none"))
            })?;
            let environment = hdr::load(path)?;
            if environment.repaired > 0 {
                eprintln!(
                    "warning: {}: repaired {} pixels",
                    path.display(),
                    environment.repaired
                );
            }
            if picture.lights.is_none() {
                local.extend(loaded.lights.iter().map(gpu::LocalLight::from));
            }
            let tables = full::tables(&loaded)?;
            let scene = full::unbaked(&loaded);
            let camera = choose_camera(&picture.camera, scene.camera, &scene)?;
            start = Instant::now();
            let geometry = Geometry::new(&scene, View::new(&camera, width, height, 1.0));
            let sampler = full::EnvironmentSampler::new(&environment, rotation);
            full::render(
                &geometry,
                &tables,
                &sampler,
                &local,
                picture.size,
                &options,
                &row_done,
            )
        }
    };
    let seconds = start.elapsed().as_secs_f64();
    bar.finish_and_clear();
    display::write_image(&picture.output, &image, picture.exposure)?;
    Ok(json!({
        "output": picture.output,
        "width": width,
        "height": height,
        "kind": if arguments.kind == Kind::Lobes { "lobes" } else { "full" },
        "samples": arguments.samples.next_multiple_of(truth::REPLICAS),
        "bounces": options.bounces,
        "covered_pixels": covered(&image),
        "relative_noise": image.relative_noise(),
        "seconds": seconds,
    }))
}

fn run_compare(arguments: &Compare) -> anyhow::Result<Value> {
    let candidate = image_file::read_exr(&arguments.candidate)?;
    let truth = image_file::read_exr(&arguments.truth)?;
    let comparison = compare::compare(&candidate, &truth);
    let comparison = comparison.with_context(|| arguments.candidate.display().to_string())?;
    Ok(serde_json::to_value(comparison)?)
}

/// Progress of stages that follow one another.
fn stage_bar() -> ProgressBar {
    ProgressBar::new(1000).with_style(
        ProgressStyle::with_template("{msg:<28} {bar:40} {percent:>3} %")
            .expect("a valid template"),
    )
}

fn show_stage(bar: &ProgressBar, progress: Progress) {
    if bar.message() != progress.stage {
        bar.set_message(progress.stage);
    }
    bar.set_position((progress.fraction * 1000.0) as u64);
}

fn run_demo(arguments: &Demo, json: bool) -> anyhow::Result<Value> {
    let bar = stage_bar();
    let report = |progress| show_stage(&bar, progress);
    let stop = std::sync::atomic::AtomicBool::new(false);
    let options = demo::Options {
        folder: arguments.out.clone(),
        size: arguments.size,
        lobes: 8,
        samples: arguments.samples,
        device: arguments.device.into(),
        bake: scene::Options::standard(),
    };
    let report = demo::run(
        &options,
        Monitor {
            report: &report,
            stop: &stop,
        },
    );
    bar.finish_and_clear();
    let report = report?;
    if json {
        return Ok(serde_json::to_value(report)?);
    }
    println!(
        "{} vertices in {} bytes, visibility boundaries off by {:.4} rad, \
         environment relative L2 error {:.4}\nrendered on {}\n",
        report.vertices,
        report.bytes,
        report.visibility.surface,
        report.environment_relative_l2,
        report.device,
    );
    println!("against truth       relative RMSE   noise-free   mean FLIP  energy ratio");
    for (name, c) in [("ambient", &report.ambient), ("polar", &report.polar)] {
        println!(
            "{name:<18} {:>12.2} % {:>10} % {:>11.4} {:>13.4}",
            100.0 * c.relative_rmse,
            c.noiseless_percent(2),
            c.mean_flip,
            c.energy_ratio,
        );
    }
    let noise = report.polar.relative_noise.unwrap_or(0.0);
    println!("noise of the truth {:>12.2} %\n", 100.0 * noise);
    for (stage, seconds) in &report.seconds {
        println!("{stage:<18} {seconds:>8.1} s");
    }
    Ok(json!({ "ambient, polar, truth": report.triptych }))
}

fn run_experiments(arguments: &Experiments, json: bool) -> anyhow::Result<Value> {
    if let Some(file) = &arguments.results {
        // Not after minutes of work.
        experiments::around_results(file)?;
    }
    display::create_folder(&arguments.out)?;
    let bake = match arguments.preset {
        PresetName::Draft => scene::Options::draft(),
        PresetName::Standard => scene::Options::standard(),
        PresetName::High => scene::Options::high(),
    };
    let bar = stage_bar();
    let stop = std::sync::atomic::AtomicBool::new(false);
    let report = |progress| show_stage(&bar, progress);
    let monitor = Monitor {
        report: &report,
        stop: &stop,
    };
    let lights = (arguments.environment.as_deref())
        .map(|path| read_environment(path).map(|distant| distant.lights))
        .transpose()?;
    let command: Vec<String> = std::env::args().skip(1).collect();
    let settings = experiments::Settings {
        folder: arguments.out.clone(),
        data: arguments.data.clone(),
        size: arguments.size,
        samples: arguments.samples,
        bake,
        scenes: arguments.scenes.clone(),
        lights,
        command: format!("lab {}", command.join(" ")),
    };
    let renderer = render::Renderer::open(arguments.device.into()).map_err(NoGpu)?;
    let mut laboratory = experiments::Laboratory::new(settings, renderer, monitor);
    let mut sections = Vec::new();
    for experiment in &experiments::ALL {
        if arguments.name != "all" && arguments.name != experiment.name {
            continue;
        }
        let section = laboratory.run(experiment)?;
        bar.suspend(|| {
            if !json {
                println!("{} ({:.0} s)\n", section.title, section.seconds);
                for table in section.tables.iter().filter(|table| table.rows.len() <= 48) {
                    println!("{}\n\n{}", table.caption, table.markdown());
                }
            }
        });
        sections.push(section);
    }
    bar.finish_and_clear();
    let page = experiments::write_report(&arguments.out)?;
    if let Some(file) = &arguments.results {
        experiments::write_results(file, &experiments::sections(&arguments.out)?)?;
    }
    Ok(json!({
        "report": page,
        "sections": if json { json!(sections) } else { Value::Null },
    }))
}

fn covered(image: &image_file::Image) -> usize {
    image.pixels.iter().filter(|pixel| pixel[3] > 0.5).count()
}
