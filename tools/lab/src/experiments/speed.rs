//! Error over time: every integrator over its settings, and a ray tracer with the same lobes.

use std::time::Instant;

use relight_bake::internals::plot::Curve;
use relight_format::Scene;
use relight_runtime::{CellsOptions, Frame, Method, PolarOptions};
use relight_shading::shade::Lighting;

use super::report::{Section, Table};
use super::{Laboratory, camera, error};
use crate::bench;
use crate::image_file::Image;
use crate::render::Renderer;
use crate::truth::lobes::{self, Visibility};
use crate::truth::{Geometry, Options, REPLICAS, SEED};

/// One setting of a method.
#[derive(Clone, Copy)]
pub struct Point {
    /// Seconds.
    pub cost: f64,
    /// Relative RMSE.
    pub error: f64,
}

/// A method and its settings, ascending in cost.
struct Family {
    name: &'static str,
    settings: Vec<(String, Method)>,
}

const SPOKES: [u32; 8] = [2, 3, 4, 6, 8, 12, 16, 32];
/// Of both thresholds of cells.
const SCALES: [f32; 3] = [16.0, 4.0, 1.0];
const UNIFORM: [[u32; 2]; 3] = [[1, 1], [2, 8], [4, 16]];

pub fn run(laboratory: &mut Laboratory, section: &mut Section) -> anyhow::Result<()> {
    section.text = vec![
        "Spot under 16 lobes of grace. `Ray tracing` draws its rays from the lobes, in \
         proportion to what each reflects, on the bounding volume hierarchy that truth uses; \
         its error is mostly noise. Everything in the first plot runs on the processor, with \
         the same threads: that is where the ray tracer runs. In the second, if there is a GPU, the \
         runtime draws with it."
            .to_owned(),
    ];
    let scene = laboratory.scene("spot")?;
    let light = laboratory.light("grace", 16)?;
    let frame = light.frame(camera(&scene)?);
    let truth = laboratory.truth(&scene, &frame)?;
    let columns = ["method", "setting", "seconds", "relative RMSE, %"];
    let mut readings = Table::new(
        "readings",
        "What other methods take and reach where polar is at its standard setting \
         (interpolated between their settings; empty where they do not get there)",
        &[
            "on",
            "method",
            "time over polar's at equal error",
            "error over polar's at equal time",
            "least error over polar's",
        ],
    );
    let on_gpu = matches!(laboratory.renderer, Renderer::Gpu(_));
    for on_device in [false, true].into_iter().filter(|&on| !on || on_gpu) {
        let (place, name) = if on_device {
            ("device", "speed-device")
        } else {
            ("processor", "speed-processor")
        };
        let mut table = Table::new(name, &format!("Every setting, on the {place}"), &columns);
        let mut curves: Vec<(&str, Vec<Point>)> = Vec::new();
        for family in families() {
            let mut points = Vec::new();
            for (setting, method) in family.settings {
                let frame = Frame {
                    method,
                    ..frame.clone()
                };
                let timed = if on_device {
                    laboratory.time(&scene, &frame)?
                } else {
                    laboratory.monitor.step("render", 0.0)?;
                    let size = laboratory.settings.size;
                    bench::draw(&scene, &frame, &mut Renderer::Cpu, size, 1)?
                };
                let point = Point {
                    cost: timed.shading.as_secs_f64(),
                    error: error(&timed.image, &truth)?,
                };
                table.row([
                    family.name.into(),
                    setting.as_str().into(),
                    point.cost.into(),
                    (100.0 * point.error).into(),
                ]);
                points.push(point);
            }
            curves.push((family.name, points));
        }
        if !on_device {
            let mut points = Vec::new();
            let mut samples = REPLICAS;
            while samples <= laboratory.settings.samples {
                let (cost, image) = ray_trace(&scene, &frame, laboratory.settings.size, samples);
                let error = error(&image, &truth)?;
                table.row([
                    "ray tracing".into(),
                    format!("{samples} rays").as_str().into(),
                    cost.into(),
                    (100.0 * error).into(),
                ]);
                points.push(Point { cost, error });
                samples *= 2;
            }
            curves.push(("ray tracing", points));
        }
        read(&mut readings, place, &curves);
        section.tables.push(table);
        let plotted: Vec<Curve> = (curves.iter())
            .map(|(name, points)| Curve {
                name: (*name).to_owned(),
                points: (points.iter())
                    .map(|point| [point.cost, 100.0 * point.error])
                    .collect(),
            })
            .collect();
        laboratory.plot(
            section,
            name,
            &format!("Error over time, on the {place}"),
            ["seconds per frame", "relative RMSE, %"],
            &plotted,
        )?;
    }
    section.tables.insert(0, readings);
    Ok(())
}

fn families() -> Vec<Family> {
    let cells = |(boundary_error, lobe_error), uniform| {
        Method::Cells(CellsOptions {
            boundary_error,
            lobe_error,
            uniform,
        })
    };
    let standard = CellsOptions::STANDARD;
    vec![
        Family {
            name: "ambient",
            settings: vec![(String::new(), Method::Ambient)],
        },
        Family {
            name: "cells, uniform",
            settings: UNIFORM
                .map(|[rows, columns]| {
                    let method = cells((0.0, 0.0), Some([rows, columns]));
                    (format!("{rows}x{columns}"), method)
                })
                .into(),
        },
        Family {
            name: "cells, adaptive",
            settings: SCALES
                .map(|scale| {
                    let errors = (scale * standard.boundary_error, scale * standard.lobe_error);
                    let name = format!("{} rad, {}", errors.0, errors.1);
                    (name, cells(errors, None))
                })
                .into(),
        },
        Family {
            name: "polar",
            settings: SPOKES
                .map(|spokes| {
                    let method = Method::Polar(PolarOptions { spokes });
                    (format!("{spokes} spokes"), method)
                })
                .into(),
        },
    ]
}

/// Seconds without building the tree, and the picture with its noise as part of its error.
fn ray_trace(scene: &Scene, frame: &Frame, size: [u32; 2], samples: u32) -> (f64, Image) {
    let [width, height] = size;
    let geometry = Geometry::new(
        scene,
        frame
            .camera
            .view(width, height, 1.0)
            .expect("a camera with rays"),
    );
    let lighting = Lighting {
        lights: frame.lights,
        ..Lighting::default()
    };
    let options = Options {
        // Not the truth's rays.
        seed: SEED + 1,
        ..Options::centers(samples)
    };
    let start = Instant::now();
    let visibility = Visibility::Exact;
    let image = lobes::render(&geometry, &lighting, visibility, size, &options, &|| ());
    let seconds = start.elapsed().as_secs_f64();
    let image = Image {
        variance: None,
        ..image
    };
    (seconds, image)
}

fn read(readings: &mut Table, place: &str, curves: &[(&str, Vec<Point>)]) {
    let standard = SPOKES
        .iter()
        .position(|&spokes| spokes == PolarOptions::STANDARD.spokes);
    let polar = curves.iter().find(|(name, _)| *name == "polar");
    let Some(own) = polar
        .zip(standard)
        .map(|((_, points), index)| points[index])
    else {
        return;
    };
    for (name, points) in curves.iter().filter(|(name, _)| *name != "polar") {
        let least = points
            .iter()
            .map(|point| point.error)
            .fold(f64::INFINITY, f64::min);
        readings.row([
            place.into(),
            (*name).into(),
            cost_at(points, own.error)
                .map(|cost| cost / own.cost)
                .into(),
            error_at(points, own.cost)
                .map(|error| error / own.error)
                .into(),
            (least / own.error).into(),
        ]);
    }
}

/// The error that a curve reaches at a cost, by straight lines between logarithms; that of its
/// most expensive setting beyond it, `None` before the cheapest.
pub fn error_at(curve: &[Point], cost: f64) -> Option<f64> {
    let last = curve.last()?;
    if cost >= last.cost {
        return Some(last.error);
    }
    crossing(curve, cost, |point| [point.cost, point.error])
}

/// The least cost at which a curve reaches an error; `None` where it never does.
pub fn cost_at(curve: &[Point], error: f64) -> Option<f64> {
    if curve.first()?.error <= error {
        return Some(curve[0].cost);
    }
    crossing(curve, error, |point| [point.error, point.cost])
}

/// The second coordinate where the first one passes `at` for the first time.
fn crossing(curve: &[Point], at: f64, coordinates: fn(&Point) -> [f64; 2]) -> Option<f64> {
    curve.windows(2).find_map(|pair| {
        let [[a, from], [b, to]] = [coordinates(&pair[0]), coordinates(&pair[1])];
        let along = (at / a).ln() / (b / a).ln();
        (0.0..=1.0)
            .contains(&along)
            .then(|| from * (to / from).powf(along))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn readings_interpolate_and_do_not_extrapolate() {
        let curve =
            [(1.0, 0.4), (4.0, 0.1), (16.0, 0.1)].map(|(cost, error)| Point { cost, error });
        assert_eq!(error_at(&curve, 0.5), None);
        assert!((error_at(&curve, 2.0).unwrap() - 0.2).abs() < 1e-12);
        assert_eq!(error_at(&curve, 99.0), Some(0.1));
        assert!((cost_at(&curve, 0.2).unwrap() - 2.0).abs() < 1e-12);
        assert_eq!(cost_at(&curve, 0.5), Some(1.0));
        assert_eq!(cost_at(&curve, 0.05), None);
    }
}
