//! `bake` as a user meets it: exit codes, messages, files left behind.

use std::fmt::Write as _;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use libtest_mimic::{Failed, Trial};
use serde_json::Value;

pub use crate::command::{
    BAD_INPUT, INPUT_OUTPUT, USAGE, describe, error_line, expect, expect_refusal, expect_success,
};
use crate::command::{INTERRUPTED, OK};
use crate::meshes::sphere_over_ground;
use crate::support::{Outcome, binary, with_data};

/// Cheapest settings: these trials ask what happens, not how good it looks.
const CHEAP: [&str; 8] = [
    "--preset",
    "draft",
    "--sample-resolution",
    "16",
    "--basis-resolution",
    "8",
    "--max-edge",
    "1",
];

pub fn trials() -> Vec<Trial> {
    vec![
        Trial::test("cli::usage", usage),
        Trial::test("cli::scene", scene),
        Trial::test(
            "cli::second_texture_coordinates",
            second_texture_coordinates,
        ),
        Trial::test("cli::budget", budget),
        Trial::test("cli::refine_error", refine_error),
        Trial::test("cli::small_drafts", small_drafts),
        Trial::test("cli::drafts_of_leaves", drafts_of_leaves),
        Trial::test("cli::drafts_of_rooms", drafts_of_rooms),
        Trial::test("cli::environment", environment),
        Trial::test("cli::layered_material", layered_material),
        Trial::test("cli::broken_table", broken_table),
        with_data("cli::measured_material", measured_material),
        Trial::test("cli::missing_input", missing_input),
        Trial::test("cli::unwritable_output", unwritable_output),
        Trial::test("cli::broken_mesh_keeps_the_old_output", broken_mesh),
        Trial::test("cli::broken_image", broken_image),
        Trial::test("cli::damaged_asset", damaged_asset),
        Trial::test("cli::interrupt", interrupt),
    ]
}

/// `bake scene`, cheap.
pub fn bake_scene(input: &Path, output: &Path) -> Command {
    let mut bake = binary("bake");
    bake.arg("scene")
        .arg(input)
        .arg("-o")
        .arg(output)
        .args(CHEAP);
    bake
}

/// `bake environment`.
pub fn bake_environment(image: &Path, output: &Path, lobes: usize) -> Command {
    let mut bake = binary("bake");
    bake.arg("environment").arg(image).arg("-o").arg(output);
    bake.args(["--lobes", &lobes.to_string()]);
    bake
}

/// What materials look up by a second set of texture coordinates, vertices of the asset have.
fn second_texture_coordinates() -> Outcome {
    let folder = tempfile::tempdir()?;
    let input =
        Path::new(env!("CARGO_MANIFEST_DIR")).join("../tools/fuzz/corpus/gltf/two_sets.glb");
    let output = folder.path().join("two_sets.relight");
    expect_success(&mut bake_scene(&input, &output));
    let limits = relight_format::Limits::default();
    let scene = relight_format::read_scene(&std::fs::read(&output)?, &limits)?;
    assert!(scene.materials[0].uses_second_uv());
    assert_eq!(scene.second_uvs.len(), scene.vertices.len());
    // They are no copies: at no corner of the square they agree.
    let pairs = scene.vertices.iter().zip(&scene.second_uvs);
    let differ = pairs.filter(|(vertex, second)| vertex.uv != **second);
    assert!(differ.count() >= 4);
    Ok(())
}

fn names(folder: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().file_name());
    let mut names: Vec<String> = entries.map(|name| name.into_string().unwrap()).collect();
    names.sort();
    names
}

fn usage() -> Outcome {
    for arguments in [
        &[][..],
        &["boil"],
        &["scene"],
        &["scene", "mesh.obj"],
        &["scene", "mesh.obj", "-o", "out.relight", "--no-such-option"],
        &[
            "environment",
            "image.hdr",
            "-o",
            "out.relight",
            "--lobes",
            "many",
        ],
    ] {
        let output = expect(USAGE, binary("bake").args(arguments));
        assert!(!output.stderr.is_empty(), "silent about {arguments:?}");
    }
    let help = expect(OK, binary("bake").arg("--help"));
    for subcommand in [
        "scene",
        "merge",
        "environment",
        "material",
        "inspect",
        "validate",
    ] {
        assert!(
            String::from_utf8_lossy(&help.stdout).contains(subcommand),
            "{subcommand}"
        );
    }
    Ok(())
}

fn scene() -> Outcome {
    let folder = tempfile::tempdir()?;
    let (mesh, asset) = (
        folder.path().join("sphere.obj"),
        folder.path().join("sphere.relight"),
    );
    std::fs::write(&mesh, sphere_over_ground(12))?;
    expect(OK, &mut bake_scene(&mesh, &asset));
    assert_eq!(names(folder.path()), ["sphere.obj", "sphere.relight"]);
    let limits = relight_format::Limits::default();
    let scene = relight_format::read_scene(&std::fs::read(&asset)?, &limits)?;
    // 264 triangles of the sphere and 288 of the ground; refinement may add more.
    assert!(
        scene.triangles.len() >= 552,
        "{} triangles",
        scene.triangles.len()
    );
    assert_eq!(scene.report.source_triangles, 552);
    expect(OK, binary("bake").arg("validate").arg(&asset));
    let inspected = expect(OK, binary("bake").arg("inspect").arg(&asset));
    assert!(!inspected.stdout.is_empty());
    let inspected = expect(OK, binary("bake").arg("inspect").arg(&asset).arg("--json"));
    let json: Value = serde_json::from_slice(&inspected.stdout)?;
    assert!(json.is_object(), "{json}");
    Ok(())
}

/// A 32×16 image, grey with one bright pixel.
/// What a bake at a quarter of the usual resolution says about itself.
fn summary(input: &Path, output: &Path, arguments: &[&str]) -> Result<Value, Failed> {
    let mut bake = binary("bake");
    bake.arg("scene").arg(input).arg("-o").arg(output);
    bake.args(["--sample-resolution", "32", "--basis-resolution", "32"]);
    if !arguments.contains(&"--max-edge") {
        bake.args(["--max-edge", "1"]);
    }
    bake.arg("--json").args(arguments);
    Ok(serde_json::from_slice(&expect_success(&mut bake).stdout)?)
}

fn budget() -> Outcome {
    let folder = tempfile::tempdir()?;
    let (mesh, asset) = (folder.path().join("a.obj"), folder.path().join("a.relight"));
    std::fs::write(&mesh, sphere_over_ground(48))?;
    let of = |arguments: &[&str]| -> Result<(f64, u64), Failed> {
        let summary = summary(&mesh, &asset, arguments)?;
        let bytes = std::fs::metadata(&asset)?.len();
        assert_eq!(summary["bytes"].as_u64(), Some(bytes));
        let error = summary["errors"]["surface"].as_f64();
        Ok((error.expect("an error"), bytes))
    };
    let (coarse, least) = of(&["--max-error", "0.03"])?;
    let (fine, most) = of(&["--max-error", "0.01"])?;
    // Tiles come whole: few clusters cannot meet an error closely.
    assert!(coarse < 1.3 * 0.03 && coarse > 0.3 * 0.03, "{coarse}");
    assert!(fine < 1.3 * 0.01 && fine < coarse, "{fine}");
    assert!(least < most, "{least} and {most} bytes");
    // More vertices take away what interpolation between them costs.
    let coarse_mesh = folder.path().join("b.obj");
    std::fs::write(&coarse_mesh, sphere_over_ground(12))?;
    let parts = |arguments: &[&str]| -> Result<[f64; 2], Failed> {
        let errors = &summary(&coarse_mesh, &asset, arguments)?["errors"];
        Ok(["surface", "interpolation"].map(|part| errors[part].as_f64().expect("an error")))
    };
    let [_, wide] = parts(&[])?;
    let [all, close] = parts(&["--max-edge", "0.02", "--max-error", "0.0001"])?;
    assert!(
        close < 0.8 * wide && close <= all,
        "{wide}, {close} of {all}"
    );
    let between = u64::midpoint(least, most);
    let (error, bytes) = of(&["--max-bytes", &between.to_string()])?;
    assert!(bytes <= between, "{bytes} of {between}");
    assert!(error < 1.05 * coarse, "{error}, {coarse} in {least} bytes");

    let mut both = bake_scene(&mesh, &asset);
    both.args(["--max-error", "0.1", "--max-bytes", "1000"]);
    expect(USAGE, &mut both);
    Ok(())
}

fn refine_error() -> Outcome {
    let folder = tempfile::tempdir()?;
    let (mesh, asset) = (folder.path().join("a.obj"), folder.path().join("a.relight"));
    std::fs::write(&mesh, sphere_over_ground(12))?;
    let vertices = |arguments: &[&str]| -> Result<u64, Failed> {
        let summary = summary(&mesh, &asset, arguments)?;
        Ok(summary["vertices"].as_u64().expect("a number"))
    };
    let plain = vertices(&[])?;
    let refined = vertices(&["--refine-error", "0.05"])?;
    let finer = vertices(&["--refine-error", "0.02"])?;
    assert!(
        plain < refined && refined < finer,
        "{plain}, {refined}, {finer}"
    );
    let bound = ["--refine-error", "0.02", "--max-vertices", "600"];
    let bounded = summary(&mesh, &asset, &bound)?;
    let warnings = bounded["warnings"].as_array().expect("a list");
    assert!(bounded["vertices"].as_u64() < Some(finer), "{bounded}");
    assert!(
        warnings
            .iter()
            .any(|w| w.as_str().is_some_and(|w| w.contains("600")))
    );
    Ok(())
}

/// Drafts of few vertices are divided to edges of a quarter of the longest, but to no more vertices than are allowed;
/// where that stops is nothing to warn of.
fn small_drafts() -> Outcome {
    let folder = tempfile::tempdir()?;
    let (mesh, asset) = (folder.path().join("a.obj"), folder.path().join("a.relight"));
    std::fs::write(&mesh, sphere_over_ground(12))?;
    let vertices = |arguments: &[&str]| -> Result<u64, Failed> {
        let arguments = [&["--max-edge", "0.2"], arguments].concat();
        let summary = summary(&mesh, &asset, &arguments)?;
        let warnings = summary["warnings"].as_array().expect("a list");
        let warns = |w: &Value| w.as_str().is_some_and(|w| w.contains("stopped"));
        assert!(!warnings.iter().any(warns), "{summary}");
        Ok(summary["vertices"].as_u64().expect("a number"))
    };
    let standard = vertices(&[])?;
    let most = (standard + 500).to_string();
    let bounded = vertices(&["--preset", "draft", "--max-vertices", &most])?;
    let draft = vertices(&["--preset", "draft"])?;
    assert!(
        standard < bounded && bounded < draft,
        "{standard}, {bounded}, {draft}"
    );
    Ok(())
}

/// So many triangles, each by itself, turned in all directions, in a cube of side 2, as an OBJ file.
fn leaves(count: u32) -> String {
    let mut state = 1u64;
    let mut random = || {
        state = state
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (state >> 40) as f32 / (1u64 << 24) as f32 - 0.5
    };
    let mut obj = String::from("# leaves\n");
    for _ in 0..count {
        let centre = [(); 3].map(|()| 2.0 * random());
        for _ in 0..3 {
            let [x, y, z] = centre.map(|centre| centre + 0.1 * random());
            let _ = writeln!(obj, "v {x} {y} {z}");
        }
        obj.push_str("f -3 -2 -1\n");
    }
    obj
}

/// Of very many small pieces a draft samples few points, and says so. Of fewer it samples what it always does.
fn drafts_of_leaves() -> Outcome {
    let folder = tempfile::tempdir()?;
    let mesh = folder.path().join("a.obj");
    let baked = |count: u32| -> Result<(bool, u64), Failed> {
        let asset = folder.path().join(format!("{count}.relight"));
        std::fs::write(&mesh, leaves(count))?;
        let mut bake = binary("bake");
        bake.arg("scene").arg(&mesh).arg("-o").arg(&asset);
        bake.args(["--preset", "draft", "--bounces", "0", "--json"]);
        let text = String::from_utf8(expect(OK, &mut bake).stdout)?;
        let summary: Value = serde_json::from_str(&text)?;
        let triangles = summary["triangles"].as_u64();
        assert!(triangles >= Some(count.into()), "{summary}");
        let warnings = summary["warnings"].as_array().expect("a list");
        let shared = |w: &Value| w.as_str().is_some_and(|w| w.contains("small pieces"));
        let sampled = summary["sampled_vertices"].as_u64().expect("a number");
        Ok((warnings.iter().any(shared), sampled))
    };
    let (warned, sampled) = baked(50_000)?;
    assert!(warned && sampled < 8_000, "{sampled}");
    let (warned, sampled) = baked(1_000)?;
    assert!(!warned && sampled > 1_000, "{sampled}");
    Ok(())
}

/// A box of 2 m without its lid, whose sides face each other or away from each other, as OBJ.
fn open_box(inwards: bool) -> String {
    let mut text = String::new();
    for corner in 0..8 {
        let [x, y, z] = [1, 2, 4].map(|bit| if corner & bit == 0 { -1 } else { 1 });
        let _ = writeln!(text, "v {x} {y} {z}");
    }
    // By their corners counter-clockwise, seen from within.
    for side in [
        [1, 5, 6, 2],
        [1, 3, 7, 5],
        [2, 6, 8, 4],
        [1, 2, 4, 3],
        [5, 7, 8, 6],
    ] {
        let [a, b, c, d] = side;
        let [first, second] = if inwards { [b, d] } else { [d, b] };
        let _ = writeln!(text, "f {a} {first} {c} {second}");
    }
    text
}

/// A draft of a room is finer than others, unless options say how fine it is to be.
fn drafts_of_rooms() -> Outcome {
    let folder = tempfile::tempdir()?;
    let [mesh, asset] = ["a.obj", "a.relight"].map(|name| folder.path().join(name));
    let resolution = |inwards: bool, options: &[&str]| -> Result<u32, Failed> {
        std::fs::write(&mesh, open_box(inwards))?;
        let mut bake = binary("bake");
        bake.arg("scene").arg(&mesh).arg("-o").arg(&asset);
        bake.args(["--preset", "draft", "--bounces", "0"]);
        expect(OK, bake.args(options));
        let limits = relight_format::Limits::default();
        let scene = relight_format::read_scene(&std::fs::read(&asset)?, &limits)?;
        Ok(scene.visibility.sample_resolution)
    };
    assert_eq!(resolution(true, &[])?, 64);
    assert_eq!(resolution(false, &[])?, 32);
    assert_eq!(resolution(true, &["--max-tiles", "2"])?, 32);
    Ok(())
}

pub fn write_hdr(path: &Path) -> Outcome {
    let mut image = image::Rgb32FImage::from_pixel(32, 16, image::Rgb([0.5, 0.5, 0.5]));
    image.put_pixel(20, 5, image::Rgb([100.0, 50.0, 25.0]));
    image.save(path)?;
    Ok(())
}

fn environment() -> Outcome {
    let folder = tempfile::tempdir()?;
    let (image, asset) = (
        folder.path().join("sky.hdr"),
        folder.path().join("sky.relight"),
    );
    write_hdr(&image)?;
    let mut bake = bake_environment(&image, &asset, 4);
    expect(OK, &mut bake);
    let limits = relight_format::Limits::default();
    let environment = relight_format::read_environment(&std::fs::read(&asset)?, &limits)?;
    assert!(
        (1..=4).contains(&environment.lobes.len()),
        "{} lobes",
        environment.lobes.len()
    );
    assert_eq!(environment.report.source, "sky.hdr");
    assert_eq!(environment.report.source_size, [32, 16]);
    expect(OK, binary("bake").arg("validate").arg(&asset));
    expect(OK, binary("bake").arg("inspect").arg(&asset).arg("--json"));
    Ok(())
}

/// `bake material`.
fn bake_material(input: &Path, output: &Path) -> Command {
    let mut bake = binary("bake");
    bake.arg("material").arg(input).arg("-o").arg(output);
    bake
}

fn layered_material() -> Outcome {
    let folder = tempfile::tempdir()?;
    let at = |name: &str| folder.path().join(name);
    let mask = image::RgbaImage::from_pixel(2, 2, image::Rgba([128, 0, 0, 255]));
    mask.save(at("mask.png"))?;
    std::fs::write(
        at("door.toml"),
        "model = 'layers'\n\
         [[layers]]\n\
         material = { model = 'ggx', diffuse = 0.3, f0 = 0.04, alpha = 0.7 }\n\
         [[layers]]\n\
         material = { model = 'ashikhmin-shirley', f0 = 0.5, exponent_x = 20, exponent_y = 800 }\n\
         weight_texture = 'mask.png'\n",
    )?;
    expect(
        OK,
        &mut bake_material(&at("door.toml"), &at("door.relight")),
    );
    expect(OK, binary("bake").arg("validate").arg(at("door.relight")));
    expect(OK, binary("bake").arg("inspect").arg(at("door.relight")));
    let limits = relight_format::Limits::default();
    let asset = relight_format::read_material(&std::fs::read(at("door.relight"))?, &limits)?;
    assert_eq!(asset.textures.len(), 1);
    assert_eq!(asset.material.name, "door");

    // The scene that names it holds the same layers and its texture.
    std::fs::write(at("sphere.obj"), sphere_over_ground(4))?;
    std::fs::write(
        at("scene.toml"),
        "mesh = 'sphere.obj'\n\
         [materials.default]\n\
         model = 'measured'\n\
         file = 'door.relight'\n",
    )?;
    expect(OK, &mut bake_scene(&at("scene.toml"), &at("scene.relight")));
    let scene = relight_format::read_scene(&std::fs::read(at("scene.relight"))?, &limits)?;
    assert_eq!(scene.textures, asset.textures);
    for material in &scene.materials {
        assert_eq!(material.surface, asset.material.surface);
    }
    Ok(())
}

fn broken_table() -> Outcome {
    let folder = tempfile::tempdir()?;
    let (table, asset) = (
        folder.path().join("broken.binary"),
        folder.path().join("out.relight"),
    );
    std::fs::write(&table, [90, 0, 0, 0, 90, 0, 0, 0, 180, 0, 0, 0, 1, 2, 3])?;
    error_line(
        &expect(BAD_INPUT, &mut bake_material(&table, &asset)),
        &table,
    );
    assert_eq!(names(folder.path()), ["broken.binary"]);
    Ok(())
}

/// Largest relative L2 error of a fit worth its name: 1 is what black has.
const MEASURED_L2_TOLERANCE: f32 = 0.5;
/// Largest albedo error of one: views near the horizon, where lobes of a half vector are
/// least like a table, are among those measured.
const MEASURED_ALBEDO_TOLERANCE: f32 = 0.25;

fn measured_material(data: &Path) -> Outcome {
    let folder = tempfile::tempdir()?;
    let asset = folder.path().join("paint.relight");
    let table = data.join("brdf/rgl/vch_golden_yellow_rgb.bsdf");
    let mut bake = bake_material(&table, &asset);
    expect(OK, bake.arg("--report").arg(folder.path()));
    assert_eq!(names(folder.path()), ["paint.relight", "sphere.png"]);
    let limits = relight_format::Limits::default();
    let asset = relight_format::read_material(&std::fs::read(&asset)?, &limits)?;
    let report = &asset.report;
    assert_eq!(report.source, "vch_golden_yellow_rgb.bsdf");
    assert!(
        report.albedo_error < MEASURED_ALBEDO_TOLERANCE,
        "{report:?}"
    );
    assert!(
        report.relative_l2 > 0.0 && report.relative_l2 < MEASURED_L2_TOLERANCE,
        "{report:?}"
    );
    Ok(())
}

fn missing_input() -> Outcome {
    let folder = tempfile::tempdir()?;
    let (missing, asset) = (
        folder.path().join("missing.obj"),
        folder.path().join("out.relight"),
    );
    error_line(
        &expect(INPUT_OUTPUT, &mut bake_scene(&missing, &asset)),
        &missing,
    );
    let image = folder.path().join("missing.hdr");
    let mut bake = bake_environment(&image, &asset, 4);
    error_line(&expect(INPUT_OUTPUT, &mut bake), &image);
    for subcommand in ["inspect", "validate"] {
        let output = expect(INPUT_OUTPUT, binary("bake").arg(subcommand).arg(&asset));
        error_line(&output, &asset);
    }
    assert!(names(folder.path()).is_empty());
    Ok(())
}

fn unwritable_output() -> Outcome {
    let folder = tempfile::tempdir()?;
    let mesh = folder.path().join("sphere.obj");
    std::fs::write(&mesh, sphere_over_ground(4))?;
    let nowhere = folder.path().join("no such folder");
    let mut bake = bake_scene(&mesh, &nowhere.join("out.relight"));
    error_line(&expect(INPUT_OUTPUT, &mut bake), &nowhere);
    assert_eq!(names(folder.path()), ["sphere.obj"]);
    Ok(())
}

fn broken_mesh() -> Outcome {
    let folder = tempfile::tempdir()?;
    let (mesh, asset) = (
        folder.path().join("broken.obj"),
        folder.path().join("out.relight"),
    );
    std::fs::write(&mesh, "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n")?;
    std::fs::write(&asset, "what was there before")?;
    error_line(&expect(BAD_INPUT, &mut bake_scene(&mesh, &asset)), &mesh);
    assert_eq!(std::fs::read(&asset)?, b"what was there before");
    assert_eq!(names(folder.path()), ["broken.obj", "out.relight"]);
    Ok(())
}

fn broken_image() -> Outcome {
    let folder = tempfile::tempdir()?;
    let (image, asset) = (
        folder.path().join("broken.hdr"),
        folder.path().join("out.relight"),
    );
    std::fs::write(
        &image,
        "#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 1000 +X 2000\nshort",
    )?;
    let mut bake = bake_environment(&image, &asset, 4);
    error_line(&expect(BAD_INPUT, &mut bake), &image);
    assert_eq!(names(folder.path()), ["broken.hdr"]);
    Ok(())
}

fn damaged_asset() -> Outcome {
    let folder = tempfile::tempdir()?;
    let asset = folder.path().join("damaged.relight");
    let environment = relight_format::Environment::default();
    let mut bytes = relight_format::write_environment(&environment)?;
    let last = bytes.len() - 1;
    bytes[last] ^= 1;
    std::fs::write(&asset, &bytes)?;
    let line = error_line(
        &expect(BAD_INPUT, binary("bake").arg("validate").arg(&asset)),
        &asset,
    );
    assert!(line.ends_with("(the file is damaged)"), "{line}");
    std::fs::write(&asset, &bytes[..last])?;
    let line = error_line(
        &expect(BAD_INPUT, binary("bake").arg("inspect").arg(&asset)),
        &asset,
    );
    assert!(line.ends_with("(the file ends too early)"), "{line}");
    Ok(())
}

/// Ctrl-C in the middle: the old file stays, nothing half-written is left.
fn interrupt() -> Outcome {
    /// Longer than any bake takes to be interrupted, shorter than a hung test's patience.
    const PATIENCE: Duration = Duration::from_mins(1);
    let folder = tempfile::tempdir()?;
    let (mesh, asset) = (
        folder.path().join("sphere.obj"),
        folder.path().join("out.relight"),
    );
    // Enough work for many seconds, were it left alone.
    std::fs::write(&mesh, sphere_over_ground(250))?;
    std::fs::write(&asset, "what was there before")?;
    let mut bake = binary("bake");
    bake.arg("scene").arg(&mesh).arg("-o").arg(&asset);
    let mut child = bake
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()?;
    std::thread::sleep(Duration::from_secs(1));
    assert!(
        child.try_wait()?.is_none(),
        "finished before it could be interrupted"
    );
    let kill = Command::new("sh")
        .arg("-c")
        .arg(format!("kill -INT {}", child.id()))
        .status()?;
    assert!(kill.success());
    let start = Instant::now();
    let status = loop {
        if let Some(status) = child.try_wait()? {
            break status;
        }
        if start.elapsed() > PATIENCE {
            child.kill()?;
            return Err("still running a minute after the interrupt".into());
        }
        std::thread::sleep(Duration::from_millis(20));
    };
    assert_eq!(status.code(), Some(INTERRUPTED), "{status}");
    assert_eq!(std::fs::read(&asset)?, b"what was there before");
    // A checkpoint is there if a chunk was finished by then.
    let mut names = names(folder.path());
    names.retain(|name| name != "out.relight.parts");
    assert_eq!(names, ["out.relight", "sphere.obj"]);
    Ok(())
}
