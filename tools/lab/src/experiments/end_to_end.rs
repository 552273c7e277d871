//! The whole way, from environment image and reflection model to pixel, against a ray tracer
//! that knows of no lobes, and what each step of the way costs.

use relight_bake::environment;
use relight_bake::environment::hdr::LatLong;
use relight_bake::measured;
use relight_format::Scene;
use relight_runtime::{Frame, twin};
use relight_shading::camera::View;

use super::report::{Section, Table};
use super::{Laboratory, METHODS, camera, difference, percent};
use crate::image_file::Image;
use crate::truth::lobes::Visibility;
use crate::truth::{Geometry, Options, SEED, full};

/// Times that differences are drawn.
const DIFFERENCE: f32 = 4.0;

/// Scenes, environments, and the error of `polar` that Relight 0.1.0 had, %: 32 lobes, reflection
/// by lobes alone. The first five rows were measured on other pictures of the same scenes.
const ROWS: [(&str, &str, f64); 11] = [
    ("gold_armadillo", "studio", 31.8),
    ("brushed_walk_1", "stpeters", 20.5),
    ("white_bunny", "lobby", 13.0),
    ("grey_bunny", "grace", 1.8),
    ("gold_suzi", "studio", 10.1),
    ("spot", "grace", 4.07),
    ("spot", "studio", 3.19),
    ("walk_1", "grace", 3.90),
    ("walk_1", "studio", 4.71),
    ("bunny", "grace", 9.88),
    ("bunny", "studio", 35.4),
];

pub fn run(laboratory: &mut Laboratory, section: &mut Section) -> anyhow::Result<()> {
    section.text = vec![
        "Truth here is the original image and the original reflection models, ray-traced. The \
         three methods have as many lobes as `bake environment` fits by default, and what the \
         image has beyond them; `lobes alone` is polar without the latter, to which the steps \
         belong. From truth to that picture lead four, each the relative RMSE between two ray \
         tracings that differ in one thing: lobes in place of the environment; Gaussians in place \
         of reflection models; signed distances at vertices in place of rays; the integrator \
         (polar) in place of random directions. Steps add up as errors do, which may cancel. \
         `Formerly` is polar of version 0.1.0 with 32 lobes. Pictures: ambient, polar, four times \
         its difference from truth, and truth."
            .to_owned(),
    ];
    let mut table = Table::new(
        "end-to-end",
        "Relative RMSE of each method against full truth, and of each step, %",
        &[
            "scene",
            "environment",
            "formerly",
            "ambient",
            "cells",
            "polar",
            "lobes alone",
            "lobes",
            "samples per pixel",
            "environment fit",
            "reflection",
            "visibility",
            "integration",
        ],
    );
    for (scene_name, light_name, formerly) in ROWS {
        let input = laboratory.input(scene_name)?;
        let tables = full::tables(&input)?;
        let scene = laboratory.scene(scene_name)?;
        let light = laboratory.default_light(light_name)?;
        let (width, height) = (light.image.width, light.image.height);
        let fitted = environment::render_all(&light.environment, width, height);
        // With random numbers of their own, so that the noise of two differs.
        let truth = full_truth(laboratory, &scene, &tables, &light.image, SEED)?;
        let under_lobes = full_truth(laboratory, &scene, &tables, &fitted, SEED + 1)?;
        let alone = light.frame(camera(&scene)?);
        let frame = Frame {
            reflections: light.beyond.as_ref(),
            ..alone.clone()
        };
        let exact = laboratory.truth(&scene, &alone)?;
        let baked = laboratory.trace(&scene, &alone, Visibility::Baked, SEED + 1)?;
        let without = laboratory.draw(&scene, &alone)?;
        let mut images = Vec::new();
        for (_, method) in METHODS {
            let frame = Frame {
                method,
                ..frame.clone()
            };
            images.push(laboratory.draw(&scene, &frame)?);
        }
        let [ambient, cells, polar] = &images[..] else {
            anyhow::bail!("three methods");
        };
        let [width, height] = laboratory.settings.size;
        let work = twin::work(&scene, &frame, width, height)?;
        table.row([
            scene_name.into(),
            light_name.into(),
            formerly.into(),
            percent(ambient, &truth)?,
            percent(cells, &truth)?,
            percent(polar, &truth)?,
            percent(&without, &truth)?,
            light.lobes.len().into(),
            (work.samples as f64 / work.pixels.max(1) as f64).into(),
            percent(&under_lobes, &truth)?,
            percent(&exact, &under_lobes)?,
            percent(&baked, &exact)?,
            percent(&without, &baked)?,
        ]);
        let off = difference(polar, &truth, DIFFERENCE);
        laboratory.strip(
            section,
            &format!("{scene_name}-{light_name}"),
            &format!("{scene_name}, {light_name}: ambient, polar, difference, full truth"),
            &[ambient, polar, &off, &truth],
        )?;
    }
    section.tables.push(table);
    Ok(())
}

/// Original reflection models under an image.
fn full_truth(
    laboratory: &Laboratory,
    scene: &Scene,
    tables: &[Option<measured::Table>],
    image: &LatLong,
    seed: u32,
) -> anyhow::Result<Image> {
    laboratory.monitor.step("trace full truth", 0.0)?;
    let [width, height] = laboratory.settings.size;
    // The mesh that was baked: a refined one has the same surface, but other rounding.
    let geometry = Geometry::new(scene, View::new(&camera(scene)?, width, height, 1.0));
    let options = Options {
        seed,
        ..Options::centers(laboratory.settings.samples)
    };
    let environment = full::EnvironmentSampler::new(image, 0.0);
    Ok(full::render(
        &geometry,
        tables,
        &environment,
        &[],
        [width, height],
        &options,
        &|| (),
    ))
}
