//! How far the spherical Gaussians of each reflection model are from the model itself, over
//! roughness and incidence.

use std::path::{Path, PathBuf};

use glam::{Vec2, Vec3};
use rayon::prelude::*;
use relight_shading::accuracy::{Accuracy, accuracy};
use relight_shading::surface::{MAX_EXPONENT, Model, Reflection};
use serde::Serialize;

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

/// Worst and mean errors of one kind of material.
#[derive(Debug, Serialize)]
pub struct Summary {
    /// Model and whether it is anisotropic.
    pub name: String,
    /// Most spherical Gaussians.
    pub lobes: usize,
    /// Root mean square over roughness, azimuth and incidence of the relative L2 error.
    pub relative_l2: f64,
    /// The same up to 40 degrees.
    pub relative_l2_to_40_degrees: f64,
    /// Largest absolute albedo error up to 70 degrees.
    pub albedo_error_to_70_degrees: f64,
    /// Largest absolute albedo error.
    pub albedo_error: f64,
}

/// Writes `brdf.csv` into `folder` and sums it up.
pub fn run(folder: &Path) -> anyhow::Result<(PathBuf, Vec<Summary>)> {
    let mut cases = Vec::new();
    for model in [
        Model::BlinnPhong,
        Model::Ward,
        Model::CookTorrance,
        Model::Ggx,
        Model::AshikhminShirley,
    ] {
        let two = !matches!(model, Model::BlinnPhong | Model::CookTorrance);
        let fresnel = !matches!(model, Model::BlinnPhong | Model::Ward);
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
    let rows: Vec<Row> = cases
        .into_par_iter()
        .map(|(model, reflectance, alpha, incidence, azimuth)| {
            let stored = match model {
                Model::BlinnPhong => alpha.map(|alpha| (2.0 / (alpha * alpha)).min(MAX_EXPONENT)),
                _ => alpha,
            };
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
        .collect();
    let mut text = "model,reflectance,alpha_x,alpha_y,incidence_degrees,azimuth_degrees,lobes,\
                    relative_l2,albedo_error\n"
        .to_owned();
    for row in &rows {
        let Accuracy {
            relative_l2,
            albedo_error,
            lobes,
        } = row.accuracy;
        let [x, y] = row.alpha;
        text += &format!(
            "{:?},{},{x},{y},{},{},{lobes},{relative_l2:.5},{albedo_error:.5}\n",
            row.model, row.reflectance, row.incidence, row.azimuth,
        );
    }
    std::fs::create_dir_all(folder)?;
    let path = folder.join("brdf.csv");
    relight_format::write_file(&path, text.as_bytes())?;
    Ok((path, summaries(&rows)))
}

fn summaries(rows: &[Row]) -> Vec<Summary> {
    let mut names: Vec<String> = rows.iter().map(name).collect();
    names.dedup();
    names.sort();
    names.dedup();
    names
        .into_iter()
        .map(|kind| {
            let rows = || rows.iter().filter(|row| name(row) == kind);
            let rms = |most: f32| {
                let squares = rows()
                    .filter(|row| row.incidence <= most)
                    .map(|row| row.accuracy.relative_l2.powi(2));
                let (count, sum) = squares.fold((0.0, 0.0), |(n, sum), x| (n + 1.0, sum + x));
                f64::sqrt(sum / count)
            };
            let albedo = |most: f32| {
                rows()
                    .filter(|row| row.incidence <= most)
                    .map(|row| row.accuracy.albedo_error.abs())
                    .fold(0.0, f64::max)
            };
            Summary {
                lobes: rows().map(|row| row.accuracy.lobes).max().unwrap_or(0),
                relative_l2: rms(90.0),
                relative_l2_to_40_degrees: rms(40.0),
                albedo_error_to_70_degrees: albedo(ALBEDO_INCIDENCE),
                albedo_error: albedo(90.0),
                name: kind,
            }
        })
        .collect()
}

fn name(row: &Row) -> String {
    let kind = if row.alpha[0] == row.alpha[1] {
        "isotropic"
    } else {
        "anisotropic"
    };
    format!("{:?} {kind}", row.model)
}
