//! `lab` as a user meets it, and its pictures against each other.

use std::path::Path;
use std::process::Command;

use glam::Vec3;
use libtest_mimic::Trial;
use relight_bake::monitor;
use relight_bake::scene::{self, load};
use relight_format::{Environment, EnvironmentReport, Lobe};
use relight_lab::image_file::{Image, read_exr, write_exr};
use serde_json::Value;

use crate::meshes::sphere_over_ground;
use crate::support::{Outcome, binary, describe, with_browser, with_data, with_gpu};

/// Exit codes of `lab`, as its help lists them.
const OK: i32 = 0;
const BAD_INPUT: i32 = 1;
const USAGE: i32 = 2;
const INPUT_OUTPUT: i32 = 3;

pub fn trials() -> Vec<Trial> {
    vec![
        Trial::test("lab::usage", usage),
        Trial::test("lab::compare", compare),
        Trial::test("lab::render_and_truth", render_and_truth),
        with_gpu("lab::bench_times_frames_of_a_gpu", bench_on_a_gpu),
        Trial::test("lab::compression", compression),
        with_browser("lab::report_in_a_browser", report),
        with_data("lab::boundary", boundary),
        Trial::test("lab::results_go_between_markers", results),
    ]
}

/// Standard output of a command that must end with `code`.
fn expect(code: i32, command: &mut Command) -> String {
    let output = command.output().expect("the binary starts");
    let described = describe(&output);
    assert_eq!(output.status.code(), Some(code), "{command:?}: {described}");
    if code != OK {
        assert!(!output.stderr.is_empty(), "{command:?} is silent");
    }
    String::from_utf8(output.stdout).expect("output is UTF-8")
}

fn usage() -> Outcome {
    for arguments in [
        &[][..],
        &["paint"],
        &["render", "a.relight", "-o", "a.exr"],
        &["truth", "a.relight", "--kind", "guess", "-o", "a.exr"],
        &[
            "truth",
            "a.relight",
            "--kind",
            "full",
            "-o",
            "a.exr",
            "--size",
            "0x4",
        ],
        &[
            "truth",
            "a.relight",
            "--kind",
            "full",
            "-o",
            "a.exr",
            "--up",
            "1,2",
        ],
        &["compare", "a.exr"],
    ] {
        expect(USAGE, binary("lab").args(arguments));
    }
    let help = expect(OK, binary("lab").arg("--help"));
    assert!(help.contains("Exit codes"));
    Ok(())
}

fn compare() -> Outcome {
    let folder = tempfile::tempdir()?;
    let path = |name: &str| folder.path().join(name);
    let mut image = Image::new(16, 16);
    image.pixels.fill([1.0, 2.0, 3.0, 1.0]);
    write_exr(&path("truth.exr"), &image)?;
    image.pixels.fill([1.5, 3.0, 4.5, 1.0]);
    write_exr(&path("candidate.exr"), &image)?;
    let run = |candidate: &str| {
        let mut lab = binary("lab");
        lab.args(["compare", "--json"]);
        lab.arg(path(candidate)).arg(path("truth.exr"));
        lab
    };
    let report: Value = serde_json::from_str(&expect(OK, &mut run("candidate.exr")))?;
    let number = |key: &str| report[key].as_f64().unwrap_or(f64::NAN);
    // √((0.5² + 1² + 1.5²) / 3) over a mean of 2; halves and their squares are exact.
    assert!((number("relative_rmse") - (3.5f64 / 3.0).sqrt() / 2.0).abs() < 1e-9);
    assert!((number("energy_ratio") - 1.5).abs() < 1e-9);
    assert!(number("mean_flip") > 0.0);
    assert_eq!(report["covered_pixels"], 256);
    assert!(report["relative_noise"].is_null());

    expect(INPUT_OUTPUT, &mut run("absent.exr"));
    std::fs::write(path("broken.exr"), b"not an image")?;
    expect(BAD_INPUT, &mut run("broken.exr"));
    write_exr(&path("small.exr"), &Image::new(8, 8))?;
    expect(BAD_INPUT, &mut run("small.exr"));
    Ok(())
}

/// Relative RMSE that polar must stay below on this coarse scene, and that the baseline
/// exceeds: measured 0.011 and 0.047.
const POLAR_ERROR: f64 = 0.02;
/// The truth's noise must be small beside that.
const TRUTH_NOISE: f64 = 0.01;

/// Writes a scene and an environment of three lobes, baked, to a folder.
fn write_baked(folder: &Path, steps: usize) -> Outcome {
    let path = |name: &str| folder.join(name);
    std::fs::write(path("scene.obj"), sphere_over_ground(steps))?;
    let options = scene::Options {
        sample_resolution: 64,
        basis_resolution: 32,
        max_edge: 1.0,
        least_vertices: 0,
        ..scene::Options::draft()
    };
    let input = load::load(&path("scene.obj"))?;
    let (asset, _) = scene::bake(input, &options, monitor::SILENT)?;
    let lobe = |axis: Vec3, sharpness, amplitude| Lobe {
        axis: axis.normalize().into(),
        sharpness,
        amplitude,
        reserved: 0.0,
    };
    let environment = Environment {
        report: EnvironmentReport::default(),
        lobes: vec![
            lobe(Vec3::new(0.8, 1.0, 0.3), 60.0, [8.0, 5.0, 2.0]),
            lobe(Vec3::new(-0.9, 0.7, 0.5), 20.0, [1.0, 2.0, 4.0]),
            lobe(Vec3::Y, 1.5, [0.3, 0.3, 0.4]),
        ],
        ..Environment::default()
    };
    write(
        &path("scene.relight"),
        &relight_format::write_scene(&asset)?,
    )?;
    write(
        &path("environment.relight"),
        &relight_format::write_environment(&environment)?,
    )?;
    Ok(())
}

fn render_and_truth() -> Outcome {
    let folder = tempfile::tempdir()?;
    let path = |name: &str| folder.path().join(name);
    write_baked(folder.path(), 24)?;

    let run = |command: &str, output: &str, arguments: &[&str]| -> Result<Value, _> {
        let mut lab = binary("lab");
        lab.arg(command).arg(path("scene.relight"));
        lab.arg("--environment").arg(path("environment.relight"));
        lab.args(["--size", "96x72", "--rotate", "40", "--json", "-o"]);
        lab.arg(path(output)).args(arguments);
        serde_json::from_str(&expect(OK, &mut lab))
    };
    let cpu = ["--device", "cpu", "--method"];
    let polar = run("render", "polar.exr", &[&cpu[..], &["polar"]].concat())?;
    run("render", "ambient.exr", &[&cpu[..], &["ambient"]].concat())?;
    let truth = ["--kind", "lobes", "--samples", "512"];
    let report = run("truth", "truth.exr", &truth)?;
    assert_eq!(polar["device"], "cpu");
    assert_eq!(polar["covered_pixels"], report["covered_pixels"]);

    let truth = read_exr(&path("truth.exr"))?;
    let error = |name: &str| -> Result<f64, Box<dyn std::error::Error>> {
        let result = relight_lab::compare::compare(&read_exr(&path(name))?, &truth)?;
        let noise = result.relative_noise.ok_or("no variance")?;
        assert!(noise < TRUTH_NOISE, "noise {noise}");
        Ok(result.relative_rmse)
    };
    let (polar, ambient) = (error("polar.exr")?, error("ambient.exr")?);
    println!("polar {polar:.4}, ambient {ambient:.4}");
    assert!(polar < POLAR_ERROR, "{polar}");
    assert!(polar < ambient, "polar {polar}, ambient {ambient}");

    let report = bench(folder.path(), ["cpu", "64x48", "256"])?;
    let rows = report["methods"].as_array().ok_or("no methods")?;
    let number = |row: usize, key: &str| rows[row][key].as_f64().unwrap_or(f64::NAN);
    assert_eq!(rows.len(), 5);
    assert_eq!(rows[2]["method"], "polar standard");
    assert!(rows[2]["turning_seconds"].is_null(), "{report}");
    assert!(number(2, "error_over_ambient") < 0.6, "{report}");
    assert!(number(2, "samples") > number(1, "samples"), "{report}");
    assert!(number(4, "fetches") >= number(4, "samples"), "{report}");

    run("render", "polar.png", &["--exposure", "-1"])?;
    assert!(std::fs::read(path("polar.png"))?.starts_with(b"\x89PNG"));
    Ok(())
}

/// What `lab bench` reports of [`write_baked`]'s files with a device, a size and so many samples of truth.
fn bench(folder: &Path, [device, size, samples]: [&str; 3]) -> Result<Value, serde_json::Error> {
    let mut bench = binary("lab");
    bench.args(["bench", "--json", "--device", device, "--size", size]);
    bench.args(["--samples", samples, "--repetitions", "1"]);
    bench.arg(folder.join("scene.relight"));
    bench
        .arg("--environment")
        .arg(folder.join("environment.relight"));
    serde_json::from_str(&expect(OK, &mut bench))
}

fn bench_on_a_gpu() -> Outcome {
    let folder = tempfile::tempdir()?;
    write_baked(folder.path(), 8)?;
    let report = bench(folder.path(), ["gpu", "16x12", "1"])?;
    let rows = report["methods"].as_array().ok_or("no methods")?;
    assert_eq!(rows.len(), 5);
    for row in rows {
        for key in ["turning_seconds", "still_seconds"] {
            assert!(
                row[key].as_f64().is_some_and(|seconds| seconds > 0.0),
                "{row}"
            );
        }
    }
    Ok(())
}

fn compression() -> Outcome {
    let folder = tempfile::tempdir()?;
    let path = |name: &str| folder.path().join(name);
    std::fs::write(path("scene.obj"), sphere_over_ground(8))?;
    std::fs::write(
        path("scene.toml"),
        "mesh = 'scene.obj'\n[camera]\nposition = [0, 4, 6]\ntarget = [0, 0.8, 0]\n\
         fov_y_degrees = 45\n[refinement]\nmax_edge = 10\n",
    )?;
    let environment = Environment {
        report: EnvironmentReport::default(),
        lobes: vec![Lobe {
            axis: Vec3::new(0.6, 0.8, 0.0).into(),
            sharpness: 40.0,
            amplitude: [4.0, 3.0, 2.0],
            reserved: 0.0,
        }],
        ..Environment::default()
    };
    write(
        &path("environment.relight"),
        &relight_format::write_environment(&environment)?,
    )?;
    let mut lab = binary("lab");
    lab.args(["experiments", "compression", "--json", "--device", "cpu"]);
    lab.args(["--size", "48x36", "--samples", "32", "--environment"]);
    lab.arg(path("environment.relight"));
    lab.arg("--out").arg(path("out"));
    lab.arg("--scenes").arg(path("scene.toml"));
    let report: Value = serde_json::from_str(&expect(OK, &mut lab))?;
    let table = &report["sections"][0]["tables"][0];
    let columns = table["columns"].as_array().ok_or("columns")?;
    let rows = table["rows"].as_array().ok_or("rows")?;
    let written = std::fs::read_to_string(path("out/compression/compression.csv"))?;
    assert_eq!(written.lines().count(), rows.len() + 1);
    for name in ["diffuse", "specular"] {
        let plot = path(&format!("out/compression/scene-{name}.svg"));
        let plot = std::fs::read_to_string(plot)?;
        assert!(plot.starts_with("<svg") && plot.contains("bytes per vertex"));
    }
    let cell = |row: &Value, column: &str| {
        let index = columns.iter().position(|name| name == column);
        index.map_or(Value::Null, |index| row[index].clone())
    };
    // Of what noise may explain there is a bound.
    let number = |row: &Value, column: &str| match cell(row, column) {
        Value::String(text) => text.trim_start_matches("< ").parse().unwrap_or(f64::NAN),
        number => number.as_f64().unwrap_or(f64::NAN),
    };
    for row in rows {
        let (diffuse, specular) = (number(row, "diffuse, %"), number(row, "specular, %"));
        assert!(diffuse < 20.0 && specular < 30.0, "{row}");
        let texels = number(row, "bytes per vertex") * number(row, "vertices");
        assert!((texels - number(row, "bytes")).abs() < 1.0, "{row}");
    }
    // Along a curve bytes buy accuracy.
    let first = cell(&rows[0], "curve");
    let curve: Vec<&Value> = (rows.iter())
        .filter(|row| cell(row, "curve") == first)
        .collect();
    for pair in curve.windows(2) {
        assert!(
            number(pair[0], "bytes") < number(pair[1], "bytes"),
            "{pair:?}"
        );
        let errors = [pair[0], pair[1]].map(|row| number(row, "compression error, rad"));
        assert!(errors[1] < errors[0], "{errors:?}");
    }
    Ok(())
}

/// Experiments that need no data, in one page that needs nothing else.
fn report(browser: &str) -> Outcome {
    let folder = tempfile::tempdir()?;
    let out = folder.path().join("out");
    for name in ["penumbra", "brdf"] {
        let mut lab = binary("lab");
        lab.args(["experiments", name, "--device", "cpu", "--size", "96x72"]);
        lab.args(["--samples", "256", "--preset", "draft", "--json", "--out"]);
        let found: Value = serde_json::from_str(&expect(OK, lab.arg(&out)))?;
        assert_eq!(found["sections"][0]["name"], name);
    }
    let table = std::fs::read_to_string(out.join("penumbra/penumbra.csv"))?;
    let rows: Vec<Vec<&str>> = (table.lines().skip(1))
        .map(|line| line.split(',').collect())
        .collect();
    // Three angles, three methods: polar is closest to truth at each.
    assert_eq!(rows.len(), 9, "{table}");
    for angle in rows.chunks(3) {
        // Of what noise may explain there is a bound.
        let error = |row: usize| angle[row][5].trim_start_matches("< ").parse::<f64>();
        assert!(!angle[0][5].starts_with('<'), "{table}");
        assert_eq!([angle[0][1], angle[2][1]], ["ambient", "polar"]);
        assert!(error(2)? < 0.8 * error(0)?, "{table}");
        assert!(angle[2][2].parse::<f64>()? > 100.0, "{table}");
    }
    let page = out.join("report.html");
    let browse_once = |arguments: &[&str]| {
        let mut timed = Command::new("timeout");
        timed.args(["--kill-after=5", "120", browser]);
        timed.args(["--headless", "--no-sandbox", "--disable-gpu"]);
        timed.args([
            "--hide-scrollbars",
            "--enable-logging=stderr",
            "--log-level=0",
        ]);
        timed.arg(format!(
            "--user-data-dir={}",
            folder.path().join("profile").display()
        ));
        timed.args(arguments);
        timed.arg(format!("file://{}", page.display()));
        timed.output()
    };
    // Chromium has been seen to hang for good on a machine that was busy: it is asked once more.
    let browse = |arguments: &[&str]| match browse_once(arguments) {
        Ok(hung) if hung.status.code() == Some(124) => browse_once(arguments),
        found => found,
    };
    let loaded = browse(&["--dump-dom"])?;
    let dom = String::from_utf8_lossy(&loaded.stdout);
    assert!(loaded.status.success(), "{}", describe(&loaded));
    let console = String::from_utf8_lossy(&loaded.stderr);
    assert!(!console.contains("ERR_"), "{console}");
    // Both sections, and no picture, style or script from elsewhere.
    for text in [
        "id=\"penumbra\"",
        "id=\"brdf\"",
        "AshikhminShirley isotropic",
    ] {
        assert!(dom.contains(text), "{text} is missing");
    }
    assert_eq!(dom.matches("<img").count(), 3);
    assert_eq!(dom.matches("src=\"data:image/png;base64,").count(), 3);
    for text in ["<script", "<link", "src=\"http", "url("] {
        assert!(!dom.contains(text), "{text} is there");
    }
    // The pictures show: the sphere's lights are coloured, the page is grey.
    let screenshot = folder.path().join("page.png");
    let argument = format!("--screenshot={}", screenshot.display());
    let shot = browse(&[&argument, "--window-size=900,2400"])?;
    assert!(shot.status.success(), "{}", describe(&shot));
    let picture = image::open(&screenshot)?.into_rgb8();
    let coloured = |pixel: &&image::Rgb<u8>| pixel.0[0].abs_diff(pixel.0[2]) > 60;
    let count = picture.pixels().filter(coloured).count();
    assert!(count > 2000, "{count} coloured pixels");
    Ok(())
}

/// Fig. 6 on real input: both errors fall with the size of cells.
fn boundary(data: &Path) -> Outcome {
    let folder = tempfile::tempdir()?;
    let mut lab = binary("lab");
    lab.args([
        "experiments",
        "boundary",
        "--device",
        "cpu",
        "--size",
        "96x72",
    ]);
    lab.args(["--samples", "8", "--preset", "draft", "--data"]);
    lab.arg(data).arg("--out").arg(folder.path());
    expect(OK, &mut lab);
    let table = std::fs::read_to_string(folder.path().join("boundary/boundary.csv"))?;
    let rows = (table.lines().skip(1)).map(|line| {
        let cells: Vec<&str> = line.split(',').collect();
        [1, 2, 3].map(|column| cells[column].parse::<f64>().unwrap_or(f64::NAN))
    });
    let rows: Vec<[f64; 3]> = rows.collect();
    for pair in rows[..3].windows(2) {
        let [[_, boundary, lobes], [_, finer_boundary, finer_lobes]] = [pair[0], pair[1]];
        assert!(
            finer_boundary < 0.7 * boundary && finer_lobes < 0.7 * lobes,
            "{table}"
        );
    }
    // Adaptive cells are better than as many even ones.
    let [even, adaptive] = [rows[2], rows[3]];
    assert!(
        adaptive[0] < even[0] && adaptive[1] < even[1] && adaptive[2] < even[2],
        "{table}"
    );
    Ok(())
}

/// Tables come between the markers of a results file, whose other text stays.
fn results() -> Outcome {
    use relight_lab::experiments::{Section, write_results};
    let section: Section = serde_json::from_value(serde_json::json!({
        "name": "contours",
        "title": "Contours",
        "command": "lab experiments contours",
        "text": ["How far boundaries are off."],
        "tables": [{
            "name": "contours",
            "caption": "Displacements",
            "columns": ["mesh", "displacement"],
            "rows": [["bunny", 1.25]],
        }, {
            "name": "every point of it",
            "caption": "left out",
            "columns": ["left out"],
            "rows": [["left out"]],
        }],
        "figures": [],
        "provenance": [["commit", "0123456"], ["machine", "left out"]],
    }))?;
    let folder = tempfile::tempdir()?;
    let file = folder.path().join("RESULTS.md");
    let around = |inside: &str| {
        format!("before\n<!-- experiments -->\n{inside}<!-- /experiments -->\nafter\n")
    };
    write(&file, around("of yesterday\n").as_bytes())?;
    for _ in 0..2 {
        write_results(&file, std::slice::from_ref(&section))?;
        let text = std::fs::read_to_string(&file)?;
        assert!(text.starts_with("before\n<!-- experiments -->\n"), "{text}");
        assert!(text.ends_with("<!-- /experiments -->\nafter\n"), "{text}");
        assert!(text.contains("| bunny | 1.25 |"), "{text}");
        let made = "Made by `lab experiments contours`, commit 0123456: ";
        assert_eq!(text.matches(made).count(), 1, "{text}");
        assert!(text.contains("\nHow far boundaries are off.\n"), "{text}");
        for gone in ["of yesterday", "left out"] {
            assert!(!text.contains(gone), "{text}");
        }
    }
    write(&file, b"no markers")?;
    let message = write_results(&file, &[section]).expect_err("no markers");
    assert!(format!("{message:#}").contains("<!-- experiments -->"));
    assert_eq!(std::fs::read(&file)?, b"no markers");
    // That is told before any work is done.
    let out = folder.path().join("out");
    for (file, code) in [
        (file, BAD_INPUT),
        (folder.path().join("absent.md"), INPUT_OUTPUT),
    ] {
        let mut command = binary("lab");
        command.args(["experiments", "contours", "--device", "cpu", "--out"]);
        expect(code, command.arg(&out).arg("--results").arg(file));
        assert!(!out.exists());
    }
    Ok(())
}

fn write(path: &Path, bytes: &[u8]) -> Outcome {
    Ok(relight_format::write_file(path, bytes)?)
}
