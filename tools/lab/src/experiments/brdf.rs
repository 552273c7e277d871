//! How far the spherical Gaussians of each reflection model are from the model itself, over
//! roughness and incidence.

use glam::{Vec2, Vec3};
use rayon::prelude::*;
use relight_shading::accuracy::{Accuracy, accuracy};
use relight_shading::surface::{MAX_EXPONENT, Model, Reflection};

use super::Laboratory;
use super::report::{Section, Table};

/// Roughnesses, on the scale of GGX alpha: an exponent n counts as √(2/n).
const ROUGHNESSES: [f32; 8] = [0.05, 0.1, 0.15, 0.2, 0.3, 0.5, 0.7, 1.0];
/// Pairs of roughnesses of anisotropic materials.
const PAIRS: [[f32; 2]; 9] = [
    [0.05, 0.1],
    [0.05, 0.2],
    [0.1, 0.2],
    [0.1, 0.3],
    [0.3, 0.6],
    [0.5, 1.0],
    [0.1, 0.8],
    [0.2, 1.0],
    [0.05, 0.5],
];
/// Degrees from the normal.
const INCIDENCES: [f32; 9] = [0.0, 10.0, 20.0, 30.0, 40.0, 50.0, 60.0, 70.0, 80.0];
/// Azimuths of the view on an anisotropic material, degrees from its tangent.
const AZIMUTHS: [f32; 4] = [0.0, 30.0, 60.0, 90.0];
/// Reflectances at normal incidence of models with Fresnel.
const REFLECTANCES: [f32; 2] = [0.04, 1.0];
/// Incidence up to which the worst albedo error is stated, degrees.
const ALBEDO_INCIDENCE: f32 = 70.0;

/// One row of the table.
struct Row {
    model: Model,
    reflectance: f32,
    alpha: [f32; 2],
    incidence: f32,
    azimuth: f32,
    accuracy: Accuracy,
}

pub fn run(laboratory: &mut Laboratory, section: &mut Section) -> anyhow::Result<()> {
    laboratory.monitor.step("compare lobes with models", 0.0)?;
    let rows = rows();
    section.text = vec![
        "Every model over roughness 0.05 to 1 and incidence 0 to 80° against the spherical \
         Gaussians that the runtime makes of it: relative L2 error of the cosine-weighted lobe, \
         and error of the albedo."
            .to_owned(),
    ];
    section.tables = vec![summary(&rows), table(&rows)];
    Ok(())
}

fn rows() -> Vec<Row> {
    let mut cases = Vec::new();
    for model in Model::ALL {
        let entry = model.entry().expect("a model that reflects");
        let (two, fresnel) = (entry.anisotropic, entry.fresnel);
        for &reflectance in if fresnel {
            &REFLECTANCES[..]
        } else {
            &REFLECTANCES[1..]
        } {
            for incidence in INCIDENCES {
                for alpha in ROUGHNESSES {
                    cases.push((model, reflectance, [alpha; 2], incidence, 0.0));
                }
                for pair in PAIRS.into_iter().filter(|_| two) {
                    for azimuth in AZIMUTHS {
                        cases.push((model, reflectance, pair, incidence, azimuth));
                    }
                }
            }
        }
    }
    cases
        .into_par_iter()
        .map(|(model, reflectance, alpha, incidence, azimuth)| {
            let stored = alpha.map(|alpha| model.from_alpha(alpha).min(MAX_EXPONENT));
            let reflection = Reflection::new(model, Vec3::splat(reflectance), Vec2::from(stored));
            let (sine, cosine) = incidence.to_radians().sin_cos();
            let view = (Vec2::from_angle(azimuth.to_radians()) * sine).extend(cosine);
            Row {
                model,
                reflectance,
                alpha,
                incidence,
                azimuth,
                accuracy: accuracy(&reflection, view),
            }
        })
        .collect()
}

fn table(rows: &[Row]) -> Table {
    let columns = [
        "model",
        "reflectance",
        "alpha x",
        "alpha y",
        "incidence, °",
        "azimuth, °",
        "lobes",
        "relative L2",
        "albedo error",
    ];
    let mut table = Table::new("brdf", "Every case", &columns);
    for row in rows {
        let Accuracy {
            relative_l2,
            albedo_error,
            lobes,
            ..
        } = row.accuracy;
        let [x, y] = row.alpha.map(f64::from);
        table.row([
            format!("{:?}", row.model).as_str().into(),
            f64::from(row.reflectance).into(),
            x.into(),
            y.into(),
            f64::from(row.incidence).into(),
            f64::from(row.azimuth).into(),
            lobes.into(),
            relative_l2.into(),
            albedo_error.into(),
        ]);
    }
    table
}

/// Worst and mean errors of each kind of material.
fn summary(rows: &[Row]) -> Table {
    let columns = [
        "model",
        "lobes, at most",
        "relative L2, %",
        "to 40°, %",
        "albedo error to 70°, %",
        "to 80°, %",
    ];
    let mut table = Table::new(
        "models",
        "Root mean square of the relative L2 error over all cases, largest error of the albedo",
        &columns,
    );
    let mut names: Vec<String> = rows.iter().map(name).collect();
    names.sort();
    names.dedup();
    for kind in names {
        let to = |most: f32| {
            let kind = &kind;
            rows.iter()
                .filter(move |row| name(row) == *kind && row.incidence <= most)
        };
        let rms = |most: f32| {
            let squares = to(most).map(|row| row.accuracy.relative_l2.powi(2));
            let (count, sum) = squares.fold((0.0, 0.0), |(n, sum), x| (n + 1.0, sum + x));
            100.0 * f64::sqrt(sum / count)
        };
        let albedo = |most: f32| {
            let errors = to(most).map(|row| row.accuracy.albedo_error.abs());
            100.0 * errors.fold(0.0, f64::max)
        };
        table.row([
            kind.as_str().into(),
            to(90.0)
                .map(|row| row.accuracy.lobes)
                .max()
                .unwrap_or(0)
                .into(),
            rms(90.0).into(),
            rms(40.0).into(),
            albedo(ALBEDO_INCIDENCE).into(),
            albedo(90.0).into(),
        ]);
    }
    table
}

fn name(row: &Row) -> String {
    let kind = if row.alpha[0] == row.alpha[1] {
        "isotropic"
    } else {
        "anisotropic"
    };
    format!("{:?} {kind}", row.model)
}
