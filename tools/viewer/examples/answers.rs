//! How soon the viewer answers: `cargo run --release --example answers -- [FILES…]`.
//!
//! Does what a person does, without a window, and tells how long it took from asking for a picture
//! to its pixels on the screen, egui's own painting aside.

use std::time::{Duration, Instant};

use relight_viewer::app::{Start, Viewer};
use relight_viewer::engine::Device;
use relight_viewer::state::{Integrator, Layout, Quality, Settings};

/// The window, points and pixels.
const WINDOW: [f32; 2] = [1280.0, 800.0];
/// Inputs of a kind.
const INPUTS: usize = 24;
/// How long anything may take.
const PATIENCE: Duration = Duration::from_mins(3);

/// What it is called, and what it does, the how manieth time.
type Input = (&'static str, fn(&mut Viewer, usize));

fn frame(context: &egui::Context, viewer: &mut Viewer) {
    let input = egui::RawInput {
        screen_rect: Some(egui::Rect::from_min_size(egui::Pos2::ZERO, WINDOW.into())),
        ..egui::RawInput::default()
    };
    let _ = context.run_ui(input, |ui| viewer.show(ui));
    std::thread::sleep(Duration::from_millis(1));
}

fn until(context: &egui::Context, viewer: &mut Viewer, holds: impl Fn(&Viewer) -> bool) {
    let start = Instant::now();
    while !holds(viewer) {
        assert!(start.elapsed() < PATIENCE, "{:?}", viewer.messages);
        frame(context, viewer);
    }
}

fn main() {
    let context = egui::Context::default();
    let start = Start {
        files: std::env::args_os().skip(1).map(Into::into).collect(),
        device: match std::env::var("RELIGHT_DEVICE").as_deref() {
            Ok("gpu") => Device::Gpu,
            Ok("cpu") => Device::Cpu,
            _ => Device::Auto,
        },
        settings: Some(Settings {
            quality: Quality::Draft,
            ..Settings::default()
        }),
        ..Start::default()
    };
    let mut viewer = Viewer::new(&context, &start);
    frame(&context, &mut viewer);
    until(&context, &mut viewer, |viewer| {
        viewer.jobs.running().is_empty() && !viewer.answers.is_empty()
    });
    println!("{}", viewer.device_name);
    let inputs: [Input; 6] = [
        ("turn the camera", |viewer, _| {
            viewer.orbit = viewer.orbit.turned(0.02, 0.0);
        }),
        ("turn the light", |viewer, _| viewer.turn.yaw += 0.05),
        ("edit a material", |viewer, index| {
            if let Some(document) = &mut viewer.document {
                let material = &mut std::sync::Arc::make_mut(&mut document.materials)[0];
                material.emission = [0.001 * index as f32; 3];
            }
        }),
        ("turn the camera, split", |viewer, _| {
            viewer.settings.layout = Layout::Split;
            viewer.orbit = viewer.orbit.turned(0.02, 0.0);
        }),
        ("turn the camera, cells", |viewer, _| {
            viewer.settings.layout = Layout::One;
            viewer.settings.integrators[0] = Integrator::Cells;
            viewer.orbit = viewer.orbit.turned(0.02, 0.0);
        }),
        ("turn the camera, ray-traced", |viewer, _| {
            viewer.settings.integrators[0] = Integrator::Truth;
            viewer.orbit = viewer.orbit.turned(0.02, 0.0);
        }),
    ];
    for (name, change) in inputs {
        let mut times = Vec::new();
        let mut pixels = Vec::new();
        for index in 0..INPUTS {
            // As often as a hand does, whatever is under way.
            let since = Instant::now();
            while since.elapsed() < Duration::from_millis(300) {
                frame(&context, &mut viewer);
            }
            viewer.answers.clear();
            change(&mut viewer, index);
            let asked = Instant::now();
            until(&context, &mut viewer, |viewer| !viewer.answers.is_empty());
            times.push(asked.elapsed().as_secs_f64() * 1e3);
            if let Some(([width, height], _)) = viewer.screen() {
                pixels.push(width * height);
            }
        }
        times.sort_by(f64::total_cmp);
        pixels.sort_unstable();
        println!(
            "{name}: {:.0} ms, worst {:.0} ms; {} pixels first",
            times[times.len() / 2],
            times[times.len() - 1],
            pixels[pixels.len() / 2]
        );
    }
    if let Some(picture) = &viewer.pictures[0] {
        println!("{} preparations", picture.preparations);
    }
}
