//! Fig. 7: cells that are divided where it pays against even ones, at equal cost and at equal
//! quality.

use std::cell::Cell;

use relight_format::Scene;
use relight_runtime::{CellsOptions, Frame, Method, twin};
use relight_shading::cells;
use relight_shading::shade::Lighting;
use relight_shading::shade_cells;
use relight_shading::ssdf::Ssdf;
use relight_shading::surface::SurfacePoint;

use super::report::{Cell as Entry, Section, Table};
use super::speed::{Point, cost_at, error_at};
use super::{Laboratory, camera, error};

const UNIFORM: [[u32; 2]; 5] = [[1, 1], [1, 4], [2, 4], [2, 8], [4, 16]];
/// Of both thresholds.
const SCALES: [f32; 2] = [4.0, 1.0];

pub fn run(laboratory: &mut Laboratory, section: &mut Section) -> anyhow::Result<()> {
    let scene = super::edits::glossy(&*laboratory.scene("duck")?);
    let light = laboratory.light("grace", 16)?;
    let frame = light.frame(camera(&scene)?);
    let truth = laboratory.truth(&scene, &frame)?;
    let mut table = Table::new(
        "adaptive",
        "Cells of every partition, a duck of glossy plastic over its plane",
        &[
            "partition",
            "cells per pixel",
            "seconds",
            "relative RMSE, %",
        ],
    );
    let mut curves = [Vec::new(), Vec::new()];
    let mut images = Vec::new();
    let standard = CellsOptions::STANDARD;
    let uniform = UNIFORM.map(|counts| CellsOptions {
        uniform: Some(counts),
        ..standard
    });
    let adaptive = SCALES.map(|scale| CellsOptions {
        boundary_error: scale * standard.boundary_error,
        lobe_error: scale * standard.lobe_error,
        uniform: None,
    });
    for options in uniform.into_iter().chain(adaptive) {
        let frame = Frame {
            method: Method::Cells(options),
            ..frame.clone()
        };
        let timed = laboratory.time(&scene, &frame)?;
        let point = Point {
            cost: timed.shading.as_secs_f64(),
            error: error(&timed.image, &truth)?,
        };
        let name = match options.uniform {
            Some([rows, columns]) => format!("{rows}x{columns}"),
            None => format!(
                "adaptive, {} rad, {}",
                options.boundary_error, options.lobe_error
            ),
        };
        table.row([
            name.as_str().into(),
            cells_per_pixel(&scene, &frame, &options, laboratory.settings.size)?.into(),
            point.cost.into(),
            (100.0 * point.error).into(),
        ]);
        curves[usize::from(options.uniform.is_none())].push(point);
        images.push((point, timed.image));
    }
    let chosen = UNIFORM.len() + 1;
    let own = images[chosen].0;
    let [uniform, _] = &curves;
    section.text = vec![
        "Thresholds are scaled together, the smaller ones are the default. The strip shows one \
         cell, the even partitions nearest to the default in time and in error, the default, \
         and truth."
            .to_owned(),
    ];
    section.tables.push(table);
    let mut readings = Table::new(
        "readings",
        "The default's time and error over those of even cells (interpolated between partitions)",
        &["at", "error over theirs", "time over theirs"],
    );
    let over = |other: Option<f64>, own: f64| Entry::from(other.map(|other| own / other));
    readings.row([
        "equal time".into(),
        over(error_at(uniform, own.cost), own.error),
        1.0.into(),
    ]);
    readings.row([
        "equal error".into(),
        1.0.into(),
        over(cost_at(uniform, own.error), own.cost),
    ]);
    section.tables.push(readings);
    let nearest = |value: fn(&Point) -> f64| {
        let away = |index: &usize| (value(&images[*index].0) / value(&own)).ln().abs();
        (0..UNIFORM.len()).min_by(|a, b| away(a).total_cmp(&away(b)))
    };
    let mut shown = vec![&images[0].1];
    for index in [nearest(|point| point.cost), nearest(|point| point.error)] {
        shown.extend(index.map(|index| &images[index].1));
    }
    shown.extend([&images[chosen].1, &truth]);
    laboratory.strip(
        section,
        "adaptive",
        "1x1; even at similar time; even at similar error; adaptive; truth",
        &shown,
    )
}

fn cells_per_pixel(
    scene: &Scene,
    frame: &Frame,
    options: &CellsOptions,
    size: [u32; 2],
) -> anyhow::Result<f64> {
    let count = |point: &SurfacePoint, lighting: &Lighting, field: &Ssdf| {
        let count = Cell::new(0);
        shade_cells::groups(point, lighting, |about, lobes| {
            let leaves = cells::leaves(field, about, point.normal, lobes, options);
            count.set(count.get() + leaves.len());
        });
        Some(count.get())
    };
    let counts = twin::map_pixels(scene, frame, size, count)?;
    let covered = counts.iter().flatten().count();
    Ok(counts.iter().flatten().sum::<usize>() as f64 / covered.max(1) as f64)
}
