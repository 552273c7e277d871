//! The ray-traced truth and the measured tables against what an independent renderer,
//! Mitsuba 3, computed from the same files.

use std::collections::BTreeMap;
use std::path::Path;

use glam::Vec3;
use libtest_mimic::Trial;
use relight_bake::environment::hdr;
use relight_bake::files::{Access, Files};
use relight_bake::measured::Table;
use relight_bake::scene::load;
use relight_lab::compare::compare;
use relight_lab::image_file::{Image, read_exr};
use relight_lab::truth::{Filter, Geometry, Options, full};
use relight_shading::camera::View;

use crate::cli::bake_environment;
use crate::command::expect_success;
use crate::support::{Outcome, binary, with_data};

/// Trials of this module.
pub fn trials() -> Vec<Trial> {
    let mut trials = vec![with_data("truth::measured_tables", measured_tables)];
    for (name, material) in [
        ("bunny_diffuse_grace", "model = \"diffuse\"\ndiffuse = 0.5"),
        (
            "walk1_aniso_stpeters",
            "model = \"ggx\"\nf0 = 1.0\nalpha_x = 0.08\nalpha_y = 0.4",
        ),
        (
            "bunny_rgl_aurora_white_lobby",
            "model = \"measured\"\nfile = \"{file}\"",
        ),
    ] {
        trials.push(with_data(format!("truth::full::{name}"), move |data| {
            full_agrees(data, name, material)
        }));
    }
    for name in [
        "spot_ground_grace",
        "suzi_gold_studio",
        "cornell_lobby",
        "gallery_park",
    ] {
        trials.push(with_data(format!("truth::paths::{name}"), move |data| {
            paths_agree(data, name)
        }));
    }
    trials.push(with_data("truth::baked", baked_agrees));
    trials
}

/// Both evaluate one formula in f32; values near zero are held against this.
const SMALLEST_REFLECTANCE: f32 = 1e-3;
/// A few hundred roundings of f32, the inversion of a table's distribution among them.
const MEASURED_TOLERANCE: f32 = 1e-4;

fn measured_tables(data: &Path) -> Outcome {
    let csv = std::fs::read_to_string(data.join("reference/rgl_eval.csv"))?;
    let mut tables: BTreeMap<&str, Option<Table>> = BTreeMap::new();
    let mut compared = 0;
    for line in csv.lines().skip(1) {
        let (name, numbers) = line.split_once(',').ok_or("a name before the numbers")?;
        let path = data.join(format!("brdf/rgl/{name}.bsdf"));
        if !tables.contains_key(name) {
            // The reference covers more materials than may be at hand.
            let table = path.is_file().then(|| Table::load(&path)).transpose()?;
            tables.insert(name, table);
        }
        let Some(table) = &tables[name] else { continue };
        let numbers: Vec<f32> = numbers
            .split(',')
            .map(str::parse)
            .collect::<Result<_, _>>()?;
        let vector = |first: usize| Vec3::from_slice(&numbers[first..]);
        let (view, light, expected) = (vector(0), vector(3), vector(6));
        let found = table.evaluate(light, view);
        let error =
            (found - expected).abs() / expected.abs().max(Vec3::splat(SMALLEST_REFLECTANCE));
        assert!(error.max_element() < MEASURED_TOLERANCE, "{line}: {found}");
        compared += 1;
    }
    assert!(compared > 0, "no table of the reference is there");
    Ok(())
}

/// Energy of 24,000 (8,000) pixels of 16 samples each has a standard error of half a percent. Where
/// interpolated normals turn away from the eye the reference is black and this is not: on the
/// coarse walking figure that is most, measured 2.1 %.
const ENERGY_TOLERANCE: f64 = 0.03;
/// The mean square difference over what both noises predict: the two are heavy-tailed, and
/// the reference states its noise, an estimate itself, to ten percent or so.
const NOISE_RATIO: std::ops::Range<f64> = 0.75..1.25;
/// Pixels whose coverage lies so near one half that 16 samples decide it by chance.
const COVERAGE_TOLERANCE: f64 = 0.01;

fn full_agrees(data: &Path, name: &str, material: &str) -> Outcome {
    let folder = data.join("reference/mitsuba3_direct");
    let scenes: serde_json::Value =
        serde_json::from_str(&std::fs::read_to_string(folder.join("scenes.json"))?)?;
    let description = &scenes["images"][name];
    let path = |key: &serde_json::Value| -> Result<String, &str> {
        Ok(data
            .join(key.as_str().ok_or("a path")?)
            .display()
            .to_string())
    };
    let camera = &description["camera"];
    let mut material = material.to_owned();
    if let Ok(file) = path(&description["bsdf"]["filename"]) {
        material = material.replace("{file}", &file);
    }
    let text = format!(
        "mesh = \"{}\"\n[materials.default]\n{material}\n[camera]\nposition = {}\ntarget = {}\n\
         up = {}\nfov_x_degrees = {}\n",
        path(&description["mesh"])?,
        camera["origin"],
        camera["target"],
        camera["up"],
        camera["fov_x_deg"],
    );
    let temporary = tempfile::tempdir()?;
    let scene_path = temporary.path().join("scene.toml");
    std::fs::write(&scene_path, text)?;

    let input = load::load_from(&Files::new(&scene_path, &Access::anywhere())?, &scene_path)?;
    let environment = hdr::load(path(&description["env"])?.as_ref())?;
    let reference = read_exr(&folder.join(format!("{name}.exr")))?;
    let size = [reference.width, reference.height];
    let scene = full::unbaked(&input);
    let view = View::new(&scene.camera.ok_or("a camera")?, size[0], size[1], 1.0);
    let image = full::render(
        &Geometry::new(&scene, view),
        &full::tables(&input)?,
        &full::EnvironmentSampler::new(&environment, 0.0),
        &[],
        size,
        &Options {
            samples: 16,
            filter: Filter::Box,
            seed: 0,
            bounces: 0,
        },
        &|| (),
    );

    let result = compare(&image, &reference)?;
    let stated = description["rel_rmse_estimate"].as_f64().ok_or("a noise")?;
    let noise = result.relative_noise.ok_or("variance")?;
    let ratio = result.relative_rmse.powi(2) / (noise.powi(2) + stated.powi(2));
    assert!(
        (result.energy_ratio - 1.0).abs() < ENERGY_TOLERANCE,
        "{result:?}"
    );
    assert!(
        NOISE_RATIO.contains(&ratio),
        "{ratio}, stated {stated}: {result:?}"
    );
    assert!(result.coverage_mismatch < COVERAGE_TOLERANCE, "{result:?}");
    Ok(())
}

/// Root mean square over blocks of 8 × 8 pixels of their means' differences, without what the
/// noise of both explains, over the picture's mean: paths of the same length, other numbers.
const BLOCK_TOLERANCE: f64 = 0.015;
/// The reference's gold reflects alike at all angles, ours more at grazing ones: measured 0.016 to
/// 0.017, direct light alone included.
const FRESNEL_TOLERANCE: f64 = 0.02;
/// Pixels per side of a block.
const BLOCK: u32 = 8;

/// Light that bounces, against Mitsuba's path tracer: nine segments from eye to light, the last to the light, are seven bounces.
fn paths_agree(data: &Path, name: &str) -> Outcome {
    let folder = data.join("reference/mitsuba3_path");
    let scenes: serde_json::Value =
        serde_json::from_str(&std::fs::read_to_string(folder.join("path_scenes.json"))?)?;
    let description = &scenes[name];
    let path = |key: &str| -> Result<std::path::PathBuf, &str> {
        Ok(data.join(description[key].as_str().ok_or("a path")?))
    };
    let material = |bsdf: &serde_json::Value| match bsdf["b"]["type"].as_str() {
        Some("diffuse") => format!(
            "model = \"diffuse\"\ndiffuse = {}\n",
            bsdf["b"]["reflectance"]["value"]
        ),
        _ => format!(
            "model = \"ggx\"\nf0 = {}\nalpha = {}\n",
            bsdf["b"]["specular_reflectance"]["value"], bsdf["b"]["alpha"]
        ),
    };
    let mut text = format!(
        "mesh = \"{}\"\n[materials.default]\n{}[camera]\nposition = {}\ntarget = {}\n\
         fov_y_degrees = {}\n",
        path("mesh")?.display(),
        material(&description["bsdf"]),
        description["origin"],
        description["target"],
        description["fov_y_deg"],
    );
    if description["ground"].is_object() {
        text += &format!(
            "[ground]\nsize = {}\nheight = {}\n[ground.material]\n{}",
            description["ground_size"],
            description["ground_height"],
            material(&description["ground"]),
        );
    }
    let temporary = tempfile::tempdir()?;
    let scene_path = temporary.path().join("scene.toml");
    std::fs::write(&scene_path, text)?;
    let files = Files::new(&scene_path, &Access::anywhere())?;
    let input = load::load_from(&files, &scene_path)?;
    let environment = hdr::load(&path("env")?)?;
    let scene = full::unbaked(&input);
    let tables = full::tables(&input)?;
    for (suffix, key, bounces) in [("one_bounce", "one_bounce", 1), ("all", "all", 7)] {
        let reference = read_exr(&folder.join(format!("{name}_{suffix}.exr")))?;
        let size = [reference.width, reference.height];
        let view = View::new(&scene.camera.ok_or("a camera")?, size[0], size[1], 1.0);
        let image = full::render(
            &Geometry::new(&scene, view),
            &tables,
            &full::EnvironmentSampler::new(&environment, 0.0),
            &[],
            size,
            &Options {
                samples: 64,
                filter: Filter::Box,
                seed: 0,
                bounces,
            },
            &|| (),
        );
        let result = compare(&image, &reference)?;
        assert!(
            (result.energy_ratio - 1.0).abs() < ENERGY_TOLERANCE,
            "{suffix}: {result:?}"
        );
        let stated = description[key]["noise"].as_f64().ok_or("a noise")?;
        let error = block_error(&image, &reference, stated);
        println!("{name} {suffix}: blocks differ by {error}");
        let most = if name == "suzi_gold_studio" {
            FRESNEL_TOLERANCE
        } else {
            BLOCK_TOLERANCE
        };
        assert!(error < most, "{suffix}: {error}");
    }
    Ok(())
}

/// Rooms, how they are baked, samples of their truth, and how far their pictures may be off it under `lobby`: measured
/// .067, .039 and .120. The first has a lamp; where dielectrics knew irradiance alone it was .15 off. The walls and boxes of the second are
/// sheets with two sides; where these hid the floor it was .054.
const BAKED: [(&str, &str, &str, f64); 3] = [
    ("CornellBox_bevy.glb", "standard", "2048", 0.1),
    ("cornell_box/scene.gltf", "standard", "512", 0.045),
    ("vr-gallery.glb", "draft", "512", 0.15),
];

/// The whole way from a mesh and an image to a picture, all bounces included, as a new user goes it.
fn baked_agrees(data: &Path) -> Outcome {
    let folder = tempfile::tempdir()?;
    let [asset, light, picture, truth] =
        ["a.relight", "light.relight", "a.exr", "b.exr"].map(|name| folder.path().join(name));
    let image = data.join("env/polyhaven/lobby.hdr");
    expect_success(&mut bake_environment(&image, &light, 32));
    let size = ["--size", "80x60"];
    for (mesh, preset, samples, most) in BAKED {
        let mesh = data.join("meshes/scenes").join(mesh);
        let mut bake = binary("bake");
        bake.arg("scene").arg(&mesh).arg("-o").arg(&asset);
        expect_success(bake.args(["--preset", preset]));
        let mut render = binary("lab");
        render.arg("render").arg(&asset).arg("-o").arg(&picture);
        render.arg("--environment").arg(&light).args(size);
        expect_success(render.args(["--device", "cpu"]));
        let mut trace = binary("lab");
        trace.arg("truth").arg(&mesh).arg("-o").arg(&truth);
        trace.arg("--environment").arg(&image).args(size);
        expect_success(trace.args(["--kind", "full", "--bounces", "16", "--samples", samples]));
        let result = compare(&read_exr(&picture)?, &read_exr(&truth)?)?;
        let error = result
            .relative_rmse_corrected
            .ok_or("noise that is known")?;
        println!("{}: {error}, {result:?}", mesh.display());
        assert!(error < most, "{}: {result:?}", mesh.display());
    }
    Ok(())
}

/// See [`BLOCK_TOLERANCE`]; `noise` is that of a pixel of the reference over its mean. Blocks
/// that the scene covers in part count as they are: premultiplied.
fn block_error(image: &Image, reference: &Image, noise: f64) -> f64 {
    let variance = image.variance.as_ref().expect("an estimate has a variance");
    let (mut squares, mut sum, mut covered) = (0.0, 0.0, 0.0);
    for index in 0..reference.pixels.len() {
        let pixel = reference.pixels[index];
        sum += pixel[..3].iter().map(|&x| f64::from(x)).sum::<f64>();
        covered += 3.0 * f64::from(pixel[3]);
    }
    let mean = sum / covered;
    let mut count = 0.0;
    let blocks = |length: u32| (0..length / BLOCK).map(|block| block * BLOCK);
    for (top, left) in
        blocks(reference.height).flat_map(|y| blocks(reference.width).map(move |x| (y, x)))
    {
        let indices = || {
            (top..top + BLOCK).flat_map(move |y| {
                (left..left + BLOCK).map(move |x| (y * reference.width + x) as usize)
            })
        };
        let coverage: f64 = indices().map(|i| f64::from(reference.pixels[i][3])).sum();
        let area = f64::from(BLOCK * BLOCK);
        for channel in [0, 1, 2] {
            let of = |image: &Image| -> f64 {
                indices()
                    .map(|i| f64::from(image.pixels[i][channel]))
                    .sum::<f64>()
                    / area
            };
            let own: f64 = indices().map(|i| f64::from(variance[i][channel])).sum();
            let expected = own / (area * area) + coverage * (noise * mean / area).powi(2);
            squares += (of(image) - of(reference)).powi(2) - expected;
        }
        count += 3.0 * coverage / area;
    }
    (squares / count).max(0.0).sqrt() / mean
}
