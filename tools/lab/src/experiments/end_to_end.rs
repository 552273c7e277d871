//! The whole way, from environment image and reflection model to pixel, against a ray tracer
//! that knows of no lobes, and what each step of the way costs.

use relight_bake::environment::hdr::LatLong;
use relight_bake::environment::{self, MAX_SOURCES};
use relight_bake::measured;
use relight_format::Scene;
use relight_runtime::Frame;
use relight_shading::camera::View;

use super::report::{Section, Table};
use super::{Laboratory, METHODS, camera, error};
use crate::image_file::Image;
use crate::truth::lobes::Visibility;
use crate::truth::{Geometry, Options, SEED, full};

const LOBES: usize = 32;

pub fn run(laboratory: &mut Laboratory, section: &mut Section) -> anyhow::Result<()> {
    section.text = vec![format!(
        "Truth here is the original image and the original reflection models, ray-traced. \
             From it to a picture lead four steps, each the relative RMSE between two ray \
             tracings that differ in one thing: {LOBES} lobes in place of the environment; lobes in \
             place of reflection models; signed distances at vertices in place of rays; the \
             integrator (polar) in place of random directions. Steps add up as errors do, which \
             may cancel."
    )];
    let mut table = Table::new(
        "end-to-end",
        "Relative RMSE of each method against full truth, and of each step, %",
        &[
            "scene",
            "environment",
            "ambient",
            "cells",
            "polar",
            "environment fit",
            "reflection fit",
            "visibility",
            "integration",
        ],
    );
    for scene_name in ["spot", "walk_1", "bunny"] {
        let input = laboratory.input(scene_name)?;
        let tables = full::tables(&input)?;
        let scene = laboratory.scene(scene_name)?;
        for light_name in ["grace", "studio"] {
            let light = laboratory.light_with_sources(light_name, LOBES, MAX_SOURCES)?;
            let (width, height) = (light.image.width, light.image.height);
            let fitted = environment::render_all(&light.environment, width, height);
            // With random numbers of their own, so that the noise of two differs.
            let truth = full_truth(laboratory, &scene, &tables, &light.image, SEED)?;
            let under_lobes = full_truth(laboratory, &scene, &tables, &fitted, SEED + 1)?;
            let frame = light.frame(camera(&scene)?);
            let exact = laboratory.truth(&scene, &frame)?;
            let baked = laboratory.trace(&scene, &frame, Visibility::Baked, SEED + 1)?;
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
            let percent = |a: &Image, b: &Image| anyhow::Ok((100.0 * error(a, b)?).into());
            table.row([
                scene_name.into(),
                light_name.into(),
                percent(ambient, &truth)?,
                percent(cells, &truth)?,
                percent(polar, &truth)?,
                percent(&under_lobes, &truth)?,
                percent(&exact, &under_lobes)?,
                percent(&baked, &exact)?,
                percent(polar, &baked)?,
            ]);
            laboratory.strip(
                section,
                &format!("{scene_name}-{light_name}"),
                &format!("{scene_name}, {light_name}: ambient, cells, polar, full truth"),
                &[ambient, cells, polar, &truth],
            )?;
        }
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
