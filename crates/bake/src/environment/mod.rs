//! An HDR environment as a few compact sources and a sum of spherical Gaussians for the rest.
//!
//! Solid-angle-weighted least squares, non-linear in axes and sharpnesses (Tsai & Shih
//! 2006), with the amplitudes eliminated, non-negative, and of exactly the image's energy
//! per channel. Lobes start from peaks of the residual over scales and are moved together;
//! then lobes that matter least are started anew where most is missing.

pub mod hdr;
mod lat_long;
mod level;
mod lobe;
mod measure;
mod open_exr;
mod prefilter;
mod primaries;
#[cfg(not(target_family = "wasm"))]
pub mod report;
mod seed;
mod solve;
pub mod sources;

use std::path::Path;

pub use relight_format::MAX_SOURCES;
use relight_format::{Environment, EnvironmentReport, Lobe};

use crate::error::Objection;
use crate::monitor::{Interrupted, Monitor};
use hdr::LatLong;
use lobe::Shape;
pub(crate) use measure::{energy_error, irradiance_error, relative_l2};
pub use measure::{render, render_all};
use prefilter::prefilter;
use solve::{Fit, GLOSS_WEIGHT, Problem, Resolution};

/// Most lobes that can be asked for: the time grows with the cube.
pub const MAX_LOBES: usize = 1024;

/// Least lobes that stand for an image, whatever their error.
pub const LEAST_LOBES: usize = 8;

/// Error of irradiance, over that of the whole image, at which pictures hardly gain by more lobes.
const ENOUGH: f32 = 0.0035;

/// How to fit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FitOptions {
    /// Number of lobes, 1 to [`MAX_LOBES`]. The fit has fewer where more do not help.
    pub lobes: usize,
    /// Stop at the first number of lobes, from [`LEAST_LOBES`] on and among those of the curve, whose error of irradiance
    /// times the part of the image's light that is not the sources' is at most this: about the error of the whole image's
    /// irradiance, root mean square over normals, as sources are exact.
    pub irradiance_error: Option<f32>,
    /// Stop at the first number of lobes, among those of the curve, with at most this
    /// relative L2 error; then `lobes` is the most to try.
    pub max_error: Option<f32>,
    /// Most sources to take out of the image first, up to [`MAX_SOURCES`]; 0 leaves all light
    /// to the lobes.
    pub sources: usize,
}

impl Default for FitOptions {
    fn default() -> Self {
        Self {
            lobes: 64,
            irradiance_error: Some(ENOUGH),
            max_error: None,
            sources: MAX_SOURCES,
        }
    }
}

impl FitOptions {
    /// As many lobes as this, where more help.
    pub fn with_lobes(lobes: usize) -> Self {
        Self {
            lobes,
            irradiance_error: None,
            ..Self::default()
        }
    }
}

/// Why there is no fit.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// An option is out of range, or asks for more than was reached.
    #[error(transparent)]
    Options(Objection),
    /// Someone asked to stop.
    #[error(transparent)]
    Interrupted(#[from] Interrupted),
}

/// One number of lobes on the way to the fit.
#[derive(Clone, Debug, PartialEq)]
pub struct Rung {
    /// Lobes allowed.
    pub allowed: usize,
    /// The lobes, brightest energy first.
    pub lobes: Vec<Lobe>,
    /// As in [`EnvironmentReport`]; never more than with fewer lobes.
    pub relative_l2: f32,
    /// As in [`EnvironmentReport`].
    pub energy_error: [f32; 3],
    /// See `irradiance_error`.
    pub irradiance_error: f32,
}

/// An environment, and the fits with fewer lobes that it grew from.
#[derive(Clone, Debug, PartialEq)]
pub struct Fitted {
    /// The last of the curve.
    pub environment: Environment,
    /// Numbers of lobes, ascending; empty where the sources leave nothing.
    pub curve: Vec<Rung>,
    /// Of every source, its part of the image's light, over all channels.
    pub source_light: Vec<f32>,
}

impl Fitted {
    /// Error of irradiance over that of the whole image, as [`FitOptions::irradiance_error`] has it.
    pub fn irradiance_error_of_all(&self) -> f32 {
        let last = self.curve.last().map_or(0.0, |last| last.irradiance_error);
        last * rest_light(&self.source_light)
    }
}

/// Part of an image's light that is not its sources'.
fn rest_light(source_light: &[f32]) -> f32 {
    1.0 - source_light.iter().sum::<f32>()
}

/// Fits an image that was loaded from `input`, whose name the report has.
pub fn bake(
    input: &Path,
    image: &LatLong,
    options: &FitOptions,
    monitor: Monitor,
) -> Result<Fitted, Error> {
    let mut fitted = fit(image, options, monitor)?;
    fitted.environment.report.source = input
        .file_name()
        .unwrap_or_default()
        .to_string_lossy()
        .into_owned();
    Ok(fitted)
}

/// Takes the sources out of an image and fits the rest. The same image and options give the same lobes on any number of threads.
/// A black image has no lobes.
pub fn fit(image: &LatLong, options: &FitOptions, monitor: Monitor) -> Result<Fitted, Error> {
    if !(1..=MAX_LOBES).contains(&options.lobes) {
        let expected = format!("1 to {MAX_LOBES}");
        return Err(Error::Options(Objection::new(
            "lobes",
            expected,
            options.lobes,
        )));
    }
    if let Some(error) = options.max_error
        && (error.is_nan() || error <= 0.0)
    {
        return Err(Error::Options(Objection::new(
            "max_error",
            "more than 0",
            error,
        )));
    }
    let split = sources::split(image, options.sources);
    let rest = rest_light(&split.light);
    let is_enough = |rung: &Rung| {
        let enough = (options.irradiance_error).is_some_and(|most| {
            rung.allowed >= LEAST_LOBES && rest * rung.irradiance_error <= most
        });
        enough || (options.max_error).is_some_and(|most| rung.relative_l2 <= most)
    };
    let curve = match Problem::new(&split.rest) {
        Some(problem) => climb(problem, &split.rest, options.lobes, is_enough, monitor)?,
        None => Vec::new(),
    };
    let (lobes, relative_l2, energy_error) = match curve.last() {
        Some(last) => (last.lobes.clone(), last.relative_l2, last.energy_error),
        None => (Vec::new(), 0.0, [0.0; 3]),
    };
    if let Some(expected) = options.max_error
        && relative_l2 > expected
    {
        let place = "relative L2 error (--max-error)";
        let found = format!("{relative_l2} with {} lobes", options.lobes);
        let objection = Objection::new(place, format_args!("at most {expected}"), found);
        return Err(Error::Options(objection));
    }
    let report = EnvironmentReport {
        source: String::new(),
        source_size: [image.width, image.height],
        repaired_pixels: image.repaired,
        relative_l2,
        energy_error,
    };
    Ok(Fitted {
        environment: Environment {
            report,
            prefiltered: prefilter(&split.rest),
            lobes,
            sources: split.sources,
            source_texels: split.texels,
        },
        curve,
        source_light: split.light,
    })
}

/// Steps of all lobes together after each batch of new ones, and at the end of a rung.
const STEPS_PER_BATCH: usize = 25;
const LAST_STEPS: usize = 100;

/// Rounds per rung in which the least lobes are started anew.
const ROUNDS: usize = 6;

/// Weights of the blurred image to go on with in turn where the image itself is fitted worse
/// than with fewer lobes.
const LESSER_GLOSS_WEIGHTS: [f64; 2] = [0.2 * GLOSS_WEIGHT, 0.02 * GLOSS_WEIGHT];

/// Weights of the blurred image, and steps, to fit lobes with beside those of the last rung
/// where that does not help either.
const LAST_RESORTS: [(f64, usize); 3] = [
    (0.02 * GLOSS_WEIGHT, STEPS_PER_BATCH),
    (0.02 * GLOSS_WEIGHT, 0),
    (0.002 * GLOSS_WEIGHT, 0),
];

/// Factor by which the error of irradiance may then grow: without blurred light, lobes that
/// gain a little in the image may lose much of it.
const IRRADIANCE_GROWTH: f32 = 1.2;

/// Numbers of lobes at which the fit is finished and measured: powers of 2 and the middles
/// between them, up to `count` and ending with it.
fn rungs(count: usize) -> Vec<usize> {
    let powers = std::iter::successors(Some(1), |power: &usize| power.checked_mul(2));
    let mut rungs: Vec<usize> = powers
        .flat_map(|power| [power, power + power / 2])
        .take_while(|rung| *rung < count)
        .collect();
    rungs.push(count);
    rungs.dedup();
    rungs
}

/// Fits with more and more lobes, up to `most` or until there are enough, each from the one before, so that a fit does not depend on
/// how many lobes will follow.
fn climb(
    mut problem: Problem,
    image: &LatLong,
    most: usize,
    is_enough: impl Fn(&Rung) -> bool,
    monitor: Monitor,
) -> Result<Vec<Rung>, Interrupted> {
    let tell = |part: f64| monitor.step("fitting lobes", part as f32);
    tell(0.0)?;
    let mut curve: Vec<Rung> = Vec::new();
    let mut fit = problem.project(vec![problem.ambient()], Resolution::Coarse);
    fit = problem.refine(&fit, Resolution::Coarse, STEPS_PER_BATCH);
    let mut best = fit.clone();
    for allowed in rungs(most) {
        let tell = || {
            // Time grows with the square of the number of lobes or so.
            tell(0.99 * (allowed as f64 / most as f64).powi(2))
        };
        fit = improve(&problem, &fit, allowed, tell)?;
        let last = curve.last();
        let most_l2 = last.map_or(f32::INFINITY, |last| last.relative_l2);
        let accept = |fit: &Fit| {
            let rung = measured(image, allowed, lobes(fit));
            (rung.relative_l2 <= most_l2).then(|| (fit.clone(), rung))
        };
        let most_irradiance = last.map_or(f32::INFINITY, |last| {
            IRRADIANCE_GROWTH * last.irradiance_error
        });
        let mut accepted = accept(&fit);
        let mut sharper = fit.clone();
        for weight in LESSER_GLOSS_WEIGHTS {
            if accepted.is_none() {
                problem.weigh_gloss(weight);
                sharper = problem.refine(&sharper, Resolution::Fine, STEPS_PER_BATCH);
                accepted = accept(&sharper);
            }
        }
        problem.weigh_gloss(GLOSS_WEIGHT);
        if accepted.is_none() {
            // Lobes beside those of the last rung, whose shapes stay, cannot take from it.
            let more = beside(&problem, &best, allowed);
            for (weight, steps) in LAST_RESORTS {
                if accepted.is_none() {
                    problem.weigh_gloss(weight);
                    let fit = problem.project(more.clone(), Resolution::Fine);
                    accepted = accept(&problem.refine(&fit, Resolution::Fine, steps))
                        .filter(|(_, rung)| rung.irradiance_error <= most_irradiance);
                }
            }
            problem.weigh_gloss(GLOSS_WEIGHT);
        }
        let rung = match (accepted, last) {
            (None, Some(last)) => Rung {
                allowed,
                ..last.clone()
            },
            (None, None) => measured(image, allowed, lobes(&fit)),
            (Some((fit, rung)), _) => {
                best = fit;
                rung
            }
        };
        let enough = is_enough(&rung);
        curve.push(rung);
        if enough {
            break;
        }
    }
    tell(1.0)?;
    Ok(curve)
}

fn measured(image: &LatLong, allowed: usize, lobes: Vec<Lobe>) -> Rung {
    Rung {
        allowed,
        relative_l2: relative_l2(image, &lobes),
        energy_error: energy_error(image, &lobes),
        irradiance_error: irradiance_error(image, &lobes),
        lobes,
    }
}

/// A better fit with up to `count` lobes.
fn improve(
    problem: &Problem,
    fit: &Fit,
    count: usize,
    tell: impl Fn() -> Result<(), Interrupted>,
) -> Result<Fit, Interrupted> {
    let mut fit = problem.project(fit.shapes.clone(), Resolution::Coarse);
    while fit.shapes.len() < count {
        let batch = (fit.shapes.len() / 4).clamp(1, count - fit.shapes.len());
        let Some(next) = grown(problem, &fit, batch) else {
            break;
        };
        fit = next;
        tell()?;
    }
    for round in 0..ROUNDS {
        let renewed = (fit.shapes.len() / 8).max(1) >> (round % 3);
        let kept = without_least(problem, &fit, renewed.max(1));
        if kept.shapes.is_empty() {
            break;
        }
        if let Some(next) = grown(problem, &kept, count - kept.shapes.len())
            && next.value < fit.value
        {
            fit = next;
        }
        tell()?;
    }
    for _ in 0..LAST_STEPS / STEPS_PER_BATCH {
        fit = problem.refine(&fit, Resolution::Coarse, STEPS_PER_BATCH);
        tell()?;
    }
    Ok(problem.refine(&fit, Resolution::Fine, STEPS_PER_BATCH))
}

/// A fit's shapes and new ones, up to `count`, where the most is left.
fn beside(problem: &Problem, fit: &Fit, count: usize) -> Vec<Shape> {
    let mut fit = problem.project(fit.shapes.clone(), Resolution::Coarse);
    while fit.shapes.len() < count {
        let batch = (fit.shapes.len() / 4).clamp(1, count - fit.shapes.len());
        let new = seed::seeds(problem, &fit, batch);
        if new.is_empty() {
            break;
        }
        fit = problem.project([fit.shapes, new].concat(), Resolution::Coarse);
    }
    fit.shapes
}

fn grown(problem: &Problem, fit: &Fit, batch: usize) -> Option<Fit> {
    let new = seed::seeds(problem, fit, batch);
    if new.is_empty() {
        return None;
    }
    let shapes = [fit.shapes.as_slice(), &new].concat();
    let started = problem.project(shapes, Resolution::Coarse);
    Some(problem.refine(&started, Resolution::Coarse, STEPS_PER_BATCH))
}

/// The fit without the lobes that matter least.
fn without_least(problem: &Problem, fit: &Fit, removed: usize) -> Fit {
    let mut order: Vec<usize> = (0..fit.shapes.len()).collect();
    order.sort_by(|&a, &b| fit.worth[b].total_cmp(&fit.worth[a]));
    order.truncate(fit.shapes.len().saturating_sub(removed));
    order.sort_unstable();
    let shapes: Vec<_> = order.iter().map(|&index| fit.shapes[index]).collect();
    if shapes.is_empty() {
        return Fit {
            shapes,
            amplitudes: Vec::new(),
            value: fit.value,
            worth: Vec::new(),
        };
    }
    problem.project(shapes, Resolution::Coarse)
}

/// The fit's lobes in single precision, brightest energy first, dark ones left out.
fn lobes(fit: &Fit) -> Vec<Lobe> {
    let mut lobes: Vec<(f64, Lobe)> = fit
        .shapes
        .iter()
        .zip(&fit.amplitudes)
        .map(|(shape, amplitude)| {
            let energy = shape.integral().0 * amplitude.iter().sum::<f64>();
            let lobe = Lobe {
                axis: shape.axis.as_vec3().to_array(),
                sharpness: shape.sharpness as f32,
                amplitude: amplitude.map(|a| a as f32),
                reserved: 0.0,
            };
            (energy, lobe)
        })
        .filter(|(energy, _)| *energy > 0.0)
        .collect();
    lobes.sort_by(|a, b| b.0.total_cmp(&a.0));
    lobes.into_iter().map(|(_, lobe)| lobe).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::monitor::{Progress, SILENT};
    use glam::Vec3;
    use std::sync::atomic::{AtomicBool, Ordering};

    fn lobe(axis: [f32; 3], sharpness: f32, amplitude: [f32; 3]) -> Lobe {
        let axis = Vec3::from(axis).normalize().to_array();
        Lobe {
            axis,
            sharpness,
            amplitude,
            reserved: 0.0,
        }
    }

    fn fitted(image: &LatLong, lobes: usize) -> Environment {
        let options = FitOptions {
            sources: 0,
            ..FitOptions::with_lobes(lobes)
        };
        fit(image, &options, SILENT).unwrap().environment
    }

    #[test]
    fn there_are_as_few_lobes_as_irradiance_takes() {
        let image = patches();
        let options = FitOptions::default();
        let found = fit(&image, &options, SILENT).unwrap();
        let rest = rest_light(&found.source_light);
        let errors: Vec<f32> = (found.curve.iter())
            .filter(|rung| rung.allowed >= LEAST_LOBES)
            .map(|rung| rest * rung.irradiance_error)
            .collect();
        let (last, before) = errors.split_last().unwrap();
        assert!(*last <= ENOUGH && before.iter().all(|error| *error > ENOUGH));
        assert!(found.environment.lobes.len() < options.lobes);
        let all = fit(&image, &FitOptions::with_lobes(24), SILENT).unwrap();
        assert_eq!(all.curve.last().map(|rung| rung.allowed), Some(24));
        // What is fitted does not depend on where the fit ends.
        assert_eq!(all.curve[..found.curve.len()], found.curve);
    }

    /// Patches, stripes and a small light: nothing that lobes fit exactly.
    fn patches() -> LatLong {
        let pixels = (0..64 * 32u32)
            .map(|i| {
                let (x, y) = (i % 64, i / 64);
                let window = if (10..16).contains(&x) && (6..14).contains(&y) {
                    9.0
                } else {
                    0.0
                };
                let light = if (x, y) == (45, 8) { 400.0 } else { 0.0 };
                let floor = if y > 20 {
                    0.3 + 0.2 * ((x / 8) % 2) as f32
                } else {
                    0.1
                };
                [
                    floor + window + light,
                    floor + 0.8 * window + light,
                    0.5 * (floor + window) + light,
                ]
            })
            .collect();
        LatLong::repair(64, 32, pixels)
    }

    #[test]
    fn known_lobes_are_recovered() {
        let truth = [
            lobe([0.3, 0.5, 0.8], 60.0, [5.0, 4.0, 3.0]),
            lobe([-0.8, 0.1, 0.1], 12.0, [0.5, 1.0, 2.0]),
            lobe([0.1, -0.9, -0.4], 3.0, [0.8, 0.4, 0.2]),
        ];
        let fit = fitted(&render(&truth, 128, 64), 3);
        // An image is bilinear between its pixels, lobes are not.
        assert!(fit.report.relative_l2 < 0.02, "{:?}", fit.report);
        for known in &truth {
            let found = fit
                .lobes
                .iter()
                .max_by(|a, b| {
                    let cosine = |lobe: &Lobe| Vec3::from(lobe.axis).dot(known.axis.into());
                    cosine(a).total_cmp(&cosine(b))
                })
                .unwrap();
            // The image is sampled and area-averaged: a part of a pixel, and a few per cent.
            assert!(
                Vec3::from(found.axis).distance(known.axis.into()) < 0.01,
                "{found:?}"
            );
            assert!(
                (found.sharpness / known.sharpness - 1.0).abs() < 0.05,
                "{found:?}"
            );
            for channel in 0..3 {
                let ratio = found.amplitude[channel] / known.amplitude[channel];
                assert!((ratio - 1.0).abs() < 0.05, "{found:?}");
            }
        }
    }

    #[test]
    fn energy_is_kept_and_more_lobes_fit_better() {
        let image = patches();
        let mut last = f32::INFINITY;
        for count in [1, 2, 5, 9, 16] {
            let environment = fitted(&image, count);
            let report = &environment.report;
            assert!(environment.lobes.len() <= count);
            // Exact but for f32 lobes.
            assert!(
                report.energy_error.iter().all(|error| error.abs() < 1e-4),
                "{report:?}"
            );
            // Every fit ends in an optimum of its own neighbourhood: between 5 and 9 lobes nothing
            // is gained here, and the last bit of an exponential decides which is better.
            assert!(
                report.relative_l2 <= 1.01 * last,
                "{count}: {report:?} after {last}"
            );
            last = report.relative_l2;
            relight_format::write_environment(&environment).unwrap();
        }
    }

    #[test]
    fn a_sun_of_one_pixel_has_its_own_lobe() {
        let mut image = LatLong::repair(256, 128, vec![[0.5, 0.6, 0.8]; 256 * 128]);
        let index = 30 * 256 + 100;
        image.pixels[index] = [60_000.0, 50_000.0, 40_000.0];
        let flux = image.solid_angle(30) as f32 * 60_000.0;
        let environment = fitted(&image, 2);
        let sun = environment
            .lobes
            .iter()
            .max_by(|a, b| a.sharpness.total_cmp(&b.sharpness))
            .unwrap();
        // Within half a pixel of its centre, half a pixel wide, and of its energy.
        let pixel = std::f32::consts::TAU / 256.0;
        let offset = Vec3::from(sun.axis).distance(image.direction(100, 30));
        assert!(offset < 0.5 * pixel, "{offset}");
        assert!(sun.sharpness > 1.0 / (pixel * pixel), "{sun:?}");
        let found = std::f32::consts::TAU / sun.sharpness * sun.amplitude[0];
        assert!((found / flux - 1.0).abs() < 0.02, "{found} {flux}");
    }

    #[test]
    fn threads_do_not_change_the_lobes() {
        let image = patches();
        let on = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new()
                .num_threads(threads)
                .build()
                .unwrap();
            pool.install(|| fitted(&image, 8))
        };
        assert_eq!(on(1), on(2));
    }

    #[test]
    fn extreme_images_have_valid_fits() {
        let constant = |width: u32, height: u32, value: f32| {
            LatLong::repair(width, height, vec![[value; 3]; (width * height) as usize])
        };
        assert!(fitted(&constant(16, 8, 0.0), 4).lobes.is_empty());
        let mut red = constant(16, 8, 0.0);
        red.pixels[40] = [3.0, 0.0, 0.0];
        for image in [
            constant(1, 1, 2.0),
            constant(16, 8, 1e30),
            constant(3, 40, 1e-20),
            red,
        ] {
            let environment = fitted(&image, 3);
            relight_format::write_environment(&environment).unwrap();
            let report = &environment.report;
            assert!(
                report.energy_error.iter().all(|error| error.abs() < 1e-3),
                "{report:?}"
            );
        }
    }

    #[test]
    fn progress_grows_to_one_and_can_cancel() {
        let seen = std::sync::Mutex::new(Vec::new());
        let stop = AtomicBool::new(false);
        let report = |progress: Progress| seen.lock().unwrap().push(progress.fraction);
        let image = patches();
        let options = FitOptions {
            lobes: 4,
            ..FitOptions::default()
        };
        fit(
            &image,
            &options,
            Monitor {
                report: &report,
                stop: &stop,
            },
        )
        .unwrap();
        let seen = seen.into_inner().unwrap();
        assert!(
            seen.is_sorted() && seen[0] == 0.0 && seen.last() == Some(&1.0),
            "{seen:?}"
        );
        let report = |progress: Progress| stop.store(progress.fraction > 0.1, Ordering::Relaxed);
        let cancelled = fit(
            &image,
            &options,
            Monitor {
                report: &report,
                stop: &stop,
            },
        );
        assert!(matches!(cancelled, Err(Error::Interrupted(_))));
        assert!(matches!(
            fit(
                &image,
                &FitOptions {
                    lobes: 0,
                    ..FitOptions::default()
                },
                SILENT
            ),
            Err(Error::Options(_))
        ));
    }
}
