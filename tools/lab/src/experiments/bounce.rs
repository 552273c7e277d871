//! Light that bounces: pictures with and without it, against ray tracing with all bounces, and
//! what it costs; then under a light that turns.

use glam::Quat;
use relight_bake::environment::{FitOptions, hdr};
use relight_bake::files::{Access, Files};
use relight_bake::scene::{self, load};
use relight_format::{self as format, Scene};
use relight_runtime::Frame;
use relight_shading::camera::View;

use super::report::{Section, Table};
use super::{Laboratory, Light, camera, write_scene_file};
use crate::image_file::Image;
use crate::truth::lobes::Visibility;
use crate::truth::{ALL_BOUNCES, Geometry, Options, full, lobes};

/// Degrees that the light is turned by, for the error and for the film.
const TURN: f32 = 100.0;
const FILM: u32 = 6;

/// Scene files; `$DATA` in them is the folder of data. Cameras and materials are those of
/// `reference/mitsuba3_path`.
const SCENES: [(&str, &str); 4] = [
    (
        "spot_ground_grace",
        include_str!("../../scenes/spot_ground_grace.toml"),
    ),
    (
        "suzi_gold_studio",
        include_str!("../../scenes/suzi_gold_studio.toml"),
    ),
    (
        "cornell_lobby",
        include_str!("../../scenes/cornell_lobby.toml"),
    ),
    (
        "gallery_park",
        include_str!("../../scenes/gallery_park.toml"),
    ),
];

pub fn run(laboratory: &mut Laboratory, section: &mut Section) -> anyhow::Result<()> {
    section.text = vec![format!(
        "Errors are relative RMSE, noise removed, of the whole picture against ray tracing with \
         all bounces: of the original image and reflection models (full), and of the same sources and \
         lobes under exact visibility (lobes). Part alone is the bounced light of the picture less \
         that of the ray tracing, over the mean of the whole picture: what the direct part has \
         no share in. Turned is part alone with the light turned by {TURN} degrees."
    )];
    let mut table = Table::new(
        "bounce",
        "Pictures with and without bounced light, %",
        &[
            "scene",
            "full, without",
            "full, with",
            "lobes, without",
            "lobes, with",
            "part without",
            "part alone",
            "part alone, turned",
            "bytes",
            "bake time",
            "frame time",
        ],
    );
    for (name, text) in SCENES {
        let bounced = Baked::new(laboratory, name, text, None)?;
        let direct = Baked::new(laboratory, name, text, Some(0))?;
        let image = hdr::load(&bounced.environment)?;
        let light = Light::of(image, &FitOptions::default(), laboratory.monitor)?;
        let frame = light.frame(camera(&bounced.scene)?);
        let with = laboratory.draw(&bounced.scene, &frame)?;
        let without = laboratory.draw(&direct.scene, &frame)?;
        let whole = Frame {
            reflections: light.beyond.as_ref(),
            ..frame.clone()
        };
        let whole_with = laboratory.draw(&bounced.scene, &whole)?;
        let whole_without = laboratory.draw(&direct.scene, &whole)?;
        let truth = full_truth(laboratory, &bounced, &light.image)?;
        let traced = trace(laboratory, &bounced.scene, &frame, ALL_BOUNCES)?;
        let part = part(laboratory, [&bounced.scene, &direct.scene], &frame, &traced)?;
        let turned = Frame {
            rotation: Quat::from_rotation_y(TURN.to_radians()),
            ..frame.clone()
        };
        let traced_turned = trace(laboratory, &bounced.scene, &turned, ALL_BOUNCES)?;
        let scenes = [&bounced.scene, &direct.scene];
        let part_turned = self::part(laboratory, scenes, &turned, &traced_turned)?;
        // One after the other, so that both meet the same load.
        let mut seconds = [0.0; 2];
        for _ in 0..3 {
            for (sum, scene) in seconds.iter_mut().zip(scenes) {
                *sum += laboratory.time(scene, &frame)?.shading.as_secs_f64();
            }
        }
        let percent = |value: f64| (100.0 * value).into();
        let more = |with: f64, without: f64| (100.0 * (with / without - 1.0)).into();
        table.row([
            name.into(),
            super::percent(&whole_without, &truth)?,
            super::percent(&whole_with, &truth)?,
            super::percent(&without, &traced)?,
            super::percent(&with, &traced)?,
            percent(part.missing),
            percent(part.error),
            percent(part_turned.error),
            more(bounced.bytes as f64, direct.bytes as f64),
            more(bounced.seconds, direct.seconds),
            more(seconds[0], seconds[1]),
        ]);
        laboratory.strip(
            section,
            name,
            &format!("{name}: without bounces, with, full truth with all"),
            &[&whole_without, &whole_with, &truth],
        )?;
        film(laboratory, section, name, &bounced.scene, &frame)?;
    }
    section.tables.push(table);
    Ok(())
}

/// A scene, baked.
struct Baked {
    scene: Scene,
    input: load::SceneInput,
    environment: std::path::PathBuf,
    bytes: usize,
    /// Of processor time.
    seconds: f64,
}

impl Baked {
    fn new(
        laboratory: &Laboratory,
        name: &str,
        text: &str,
        bounces: Option<u32>,
    ) -> anyhow::Result<Self> {
        let settings = &laboratory.settings;
        let path = write_scene_file(name, text, &settings.folder, &settings.data)?;
        // It names the folder of data.
        let files = Files::new(&path, &Access::anywhere())?;
        let input = load::load_from(&files, &path)?;
        let environment = (input.environment.clone())
            .ok_or_else(|| anyhow::anyhow!("{name}: expected an environment, found none"))?;
        let mut options = settings.bake.clone();
        options.transfer.bounces = bounces;
        let (scene, statistics) = scene::bake(input.clone(), &options, laboratory.monitor)?;
        let seconds = (statistics.stages.iter()).map(|(_, time)| time.as_secs_f64());
        Ok(Self {
            bytes: format::write_scene(&scene)?.len(),
            seconds: seconds.sum(),
            scene,
            input,
            environment,
        })
    }
}

fn full_truth(
    laboratory: &Laboratory,
    baked: &Baked,
    image: &hdr::LatLong,
) -> anyhow::Result<Image> {
    laboratory.monitor.step("trace full truth", 0.0)?;
    let size @ [width, height] = laboratory.settings.size;
    let scene = full::unbaked(&baked.input);
    let geometry = Geometry::new(&scene, View::new(&camera(&scene)?, width, height, 1.0));
    let options = Options {
        bounces: ALL_BOUNCES,
        ..Options::centers(laboratory.settings.samples)
    };
    let sampler = full::EnvironmentSampler::new(image, 0.0);
    let tables = full::tables(&baked.input)?;
    Ok(full::render(
        &geometry,
        &tables,
        &sampler,
        &[],
        size,
        &options,
        &|| (),
    ))
}

fn trace(
    laboratory: &Laboratory,
    scene: &Scene,
    frame: &Frame,
    bounces: u32,
) -> anyhow::Result<Image> {
    laboratory.monitor.step("trace truth", 0.0)?;
    let options = Options {
        bounces,
        ..Options::centers(laboratory.settings.samples)
    };
    let size = laboratory.settings.size;
    Ok(lobes::of_frame(
        scene,
        frame,
        size,
        &options,
        Visibility::Exact,
        &|| (),
    ))
}

/// Errors of bounced light alone, over the mean of the whole picture.
struct Part {
    /// Where there is none.
    missing: f64,
    error: f64,
}

/// Of the first scene, whose direct light is that of the second.
fn part(
    laboratory: &mut Laboratory,
    [bounced, direct]: [&Scene; 2],
    frame: &Frame,
    traced: &Image,
) -> anyhow::Result<Part> {
    let with = laboratory.draw(bounced, frame)?;
    let without = laboratory.draw(direct, frame)?;
    let seen = trace(laboratory, bounced, frame, 0)?;
    let (mut error, mut missing, mut noise, mut sum, mut count) = (0.0, 0.0, 0.0, 0.0, 0.0);
    let variance = |image: &Image, index: usize, channel: usize| {
        let all = image.variance.as_ref();
        all.map_or(0.0, |all| f64::from(all[index][channel]))
    };
    for index in 0..traced.pixels.len() {
        let covered = [traced, &seen, &with, &without].map(|image| image.pixels[index][3] > 0.5);
        if covered.contains(&false) {
            continue;
        }
        for channel in 0..3 {
            let at = |image: &Image| f64::from(image.pixels[index][channel]);
            let truth = at(traced) - at(&seen);
            missing += truth * truth;
            error += (at(&with) - at(&without) - truth).powi(2);
            noise += variance(traced, index, channel) + variance(&seen, index, channel);
            sum += at(traced);
            count += 1.0;
        }
    }
    let mean = sum / f64::max(count, 1.0);
    let relative = |squares: f64| ((squares - noise).max(0.0) / f64::max(count, 1.0)).sqrt() / mean;
    Ok(Part {
        missing: relative(missing),
        error: relative(error),
    })
}

/// The light turns once.
fn film(
    laboratory: &mut Laboratory,
    section: &mut Section,
    name: &str,
    scene: &Scene,
    frame: &Frame,
) -> anyhow::Result<()> {
    let mut frames = Vec::new();
    for step in 0..FILM {
        let angle = std::f32::consts::TAU * step as f32 / FILM as f32;
        let turned = Frame {
            rotation: Quat::from_rotation_y(angle),
            ..frame.clone()
        };
        frames.push(laboratory.draw(scene, &turned)?);
    }
    let caption = format!(
        "{name}: the light turns, by {} degrees a picture",
        360 / FILM
    );
    let frames: Vec<&Image> = frames.iter().collect();
    laboratory.strip(section, &format!("{name}-film"), &caption, &frames)
}
