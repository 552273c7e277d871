//! `bake` against hostile inputs and unlucky command lines: what is read, what is replaced,
//! what is printed where nobody listens. Devices, links and pipes are made in folders of the
//! trials' own.

#[path = "../../../../tests/suite/command.rs"]
#[expect(dead_code, reason = "the workspace's suite uses the rest")]
mod command;
mod faults;
mod json;
#[path = "../../../../tests/suite/meshes.rs"]
mod meshes;
mod processors;
mod python;

use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode, Stdio};
use std::time::{Duration, Instant};

use libtest_mimic::{Completion, Failed, Trial};
use serde_json::{Value, json};

use command::{BAD_INPUT, INPUT_OUTPUT, USAGE, describe, error_line, expect, expect_success};
use meshes::sphere_over_ground;

type Outcome = Result<(), Failed>;

fn main() -> ExitCode {
    libtest_mimic::run(&libtest_mimic::Arguments::from_args(), trials()).exit_code()
}

/// The command.
fn program() -> Command {
    Command::new(env!("CARGO_BIN_EXE_bake"))
}

/// `bake scene`, cheap: these trials ask what happens, not how good it looks.
fn bake_scene(input: &Path, output: &Path) -> Command {
    let mut bake = program();
    bake.arg("scene").arg(input).arg("-o").arg(output);
    bake.args(["--preset", "draft", "--sample-resolution", "16"]);
    bake.args(["--basis-resolution", "8", "--max-edge", "1"]);
    bake
}

fn bake_environment(image: &Path, output: &Path, lobes: usize) -> Command {
    let mut bake = program();
    bake.arg("environment").arg(image).arg("-o").arg(output);
    bake.args(["--lobes", &lobes.to_string()]);
    bake
}

/// Longest that a refusal may take.
const SOON: Duration = Duration::from_secs(20);

fn trials() -> Vec<Trial> {
    let mut trials = vec![
        Trial::test("safety::output_is_no_input", output_is_no_input),
        Trial::test("safety::limits", limits),
        Trial::test("safety::threads", threads),
        Trial::test("safety::shapes_of_images", shapes_of_images),
        Trial::test("safety::chromaticities", chromaticities),
        Trial::test("safety::scene_semantics", scene_semantics),
        Trial::test("safety::tables", tables),
        Trial::test("safety::options", options),
        Trial::test("safety::resume_says_what_differs", resume_says_what_differs),
        Trial::test("safety::other_files_are_no_parts", other_files_are_no_parts),
        Trial::test("safety::large_errors_are_told", large_errors_are_told),
    ];
    trials.extend(faults::trials());
    trials.extend(json::trials());
    trials.extend(processors::trials());
    trials.extend(python::trials());
    #[cfg(unix)]
    trials.extend([
        Trial::test("safety::output_is_no_link", unix::output_is_no_link),
        Trial::ignorable_test("safety::output_is_no_device", unix::output_is_no_device),
        Trial::test("safety::gltf_stays_in_its_folder", unix::gltf_stays),
        Trial::test("safety::obj_stays_in_its_folder", unix::obj_stays),
        Trial::test("safety::scene_stays_in_its_folder", unix::scene_stays),
        Trial::test("safety::pipes_do_not_hang", unix::pipes_do_not_hang),
        Trial::test("safety::closed_output", unix::closed_output),
        Trial::ignorable_test("safety::full_output", unix::full_output),
        Trial::test(
            "safety::names_that_are_no_text",
            unix::names_that_are_no_text,
        ),
        Trial::test("safety::interrupts", unix::interrupts),
    ]);
    trials
}

/// A folder with a mesh.
struct Folder(tempfile::TempDir);

impl Folder {
    fn new() -> std::io::Result<Self> {
        let folder = Self(tempfile::tempdir()?);
        folder.write("a.obj", sphere_over_ground(4))?;
        Ok(folder)
    }

    fn at(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    fn write(&self, name: &str, bytes: impl AsRef<[u8]>) -> std::io::Result<PathBuf> {
        let path = self.at(name);
        std::fs::create_dir_all(path.parent().expect("a parent"))?;
        std::fs::write(&path, bytes)?;
        Ok(path)
    }
}

/// Runs a command that must be refused soon, and gives the line that says why.
fn refused(code: i32, command: &mut Command, file: &Path, reason: &str) -> String {
    let start = Instant::now();
    let line = error_line(&expect(code, command), file);
    assert!(start.elapsed() < SOON, "{:?}", start.elapsed());
    assert!(line.contains(reason), "{line:?} does not say {reason:?}");
    line
}

/// A glTF file of one triangle whose buffer is elsewhere.
fn triangle(buffer: &str, image: Option<&str>) -> Vec<u8> {
    let mut scene = json!({
        "asset": {"version": "2.0"},
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "material": 0}]}],
        "materials": [{"name": "paint"}],
        "accessors": [{"bufferView": 0, "type": "VEC3", "componentType": 5126, "count": 3,
                       "min": [0, 0, 0], "max": [1, 1, 0]}],
        "bufferViews": [{"buffer": 0, "byteLength": 36}],
        "buffers": [{"byteLength": 36, "uri": buffer}],
    });
    if let Some(image) = image {
        scene["images"] = json!([{"uri": image}]);
        scene["textures"] = json!([{"source": 0}]);
        scene["materials"] = json!([{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}]);
    }
    scene.to_string().into_bytes()
}

/// Its buffer.
fn triangle_buffer() -> Vec<u8> {
    let corners = [0f32, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0];
    corners.iter().flat_map(|x| x.to_le_bytes()).collect()
}

fn png(width: u32, height: u32) -> Vec<u8> {
    let mut bytes = std::io::Cursor::new(Vec::new());
    image::RgbImage::new(width, height)
        .write_to(&mut bytes, image::ImageFormat::Png)
        .expect("memory");
    bytes.into_inner()
}

/// A Radiance image of one grey, run-length encoded.
fn grey_hdr(width: u32, height: u32) -> Vec<u8> {
    let mut bytes =
        format!("#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y {height} +X {width}\n").into_bytes();
    for _ in 0..height {
        bytes.extend([2, 2, (width >> 8) as u8, width as u8]);
        for value in [128u8, 128, 128, 128] {
            let mut left = width;
            while left > 0 {
                let run = left.min(127);
                bytes.extend([128 + run as u8, value]);
                left -= run;
            }
        }
    }
    bytes
}

fn bake_material(input: &Path, output: &Path) -> Command {
    let mut bake = program();
    bake.arg("material").arg(input).arg("-o").arg(output);
    bake
}

fn output_is_no_input() -> Outcome {
    let folder = Folder::new()?;
    let unchanged = |path: &Path, before: &[u8]| {
        assert_eq!(
            std::fs::read(path).expect("a file"),
            before,
            "{}",
            path.display()
        );
    };
    let is_input = "expected another file than the inputs";

    let mesh = folder.at("a.obj");
    let before = std::fs::read(&mesh)?;
    refused(USAGE, &mut bake_scene(&mesh, &mesh), &mesh, is_input);
    unchanged(&mesh, &before);
    // By another name.
    let linked = folder.at("linked.obj");
    std::fs::hard_link(&mesh, &linked)?;
    refused(USAGE, &mut bake_scene(&mesh, &linked), &linked, is_input);
    unchanged(&linked, &before);
    let around = folder.0.path().join("b/../a.obj");
    std::fs::create_dir(folder.at("b"))?;
    refused(USAGE, &mut bake_scene(&mesh, &around), &mesh, is_input);
    unchanged(&mesh, &before);

    // What a scene refers to.
    let texture = folder.write("wood.png", png(2, 2))?;
    let sky = folder.write("sky.hdr", grey_hdr(16, 8))?;
    let scene = folder.write(
        "scene.toml",
        "mesh = 'a.obj'\nenvironment = 'sky.hdr'\n[materials.default]\nmodel = 'layers'\n\
         [[materials.default.layers]]\nmaterial = { model = 'diffuse', diffuse = 0.5 }\n\
         diffuse_texture = 'wood.png'\n",
    )?;
    for input in [&mesh, &texture, &sky, &scene] {
        let before = std::fs::read(input)?;
        refused(USAGE, &mut bake_scene(&scene, input), input, is_input);
        unchanged(input, &before);
    }
    // OUT.parts as well.
    let parts = folder.write("out.relight.parts", std::fs::read(&mesh)?)?;
    std::fs::write(&scene, "mesh = 'parts.obj'")?;
    std::fs::hard_link(&parts, folder.at("parts.obj"))?;
    let before = std::fs::read(&parts)?;
    refused(
        USAGE,
        &mut bake_scene(&scene, &folder.at("out.relight")),
        &parts,
        is_input,
    );
    unchanged(&parts, &before);

    let before = std::fs::read(&sky)?;
    refused(USAGE, &mut bake_environment(&sky, &sky, 2), &sky, is_input);
    unchanged(&sky, &before);
    // A report would overwrite the image that it is about.
    let original = folder.write("report/original.png", grey_hdr(16, 8))?;
    let mut bake = bake_environment(&original, &folder.at("sky.relight"), 2);
    bake.arg("--report").arg(folder.at("report"));
    refused(USAGE, &mut bake, &original, is_input);
    unchanged(&original, &grey_hdr(16, 8));
    assert!(!folder.at("sky.relight").exists());

    let material = folder.write("paint.toml", "model = 'diffuse'\ndiffuse = 0.5\n")?;
    let before = std::fs::read(&material)?;
    refused(
        USAGE,
        &mut bake_material(&material, &material),
        &material,
        is_input,
    );
    unchanged(&material, &before);

    let shard = folder.at("1.part");
    expect_success(bake_scene(&mesh, &shard).args(["--shard", "1/1"]));
    let before = std::fs::read(&shard)?;
    let mut merge = program();
    merge.arg("merge").arg(&shard).arg("-o").arg(&shard);
    refused(USAGE, &mut merge, &shard, is_input);
    unchanged(&shard, &before);
    Ok(())
}

fn limits() -> Outcome {
    let folder = Folder::new()?;
    let (mesh, asset) = (folder.at("a.obj"), folder.at("out.relight"));
    let mut bake = bake_scene(&mesh, &asset);
    refused(
        BAD_INPUT,
        bake.args(["--limit-vertices", "10"]),
        &mesh,
        "--limit-vertices",
    );
    let mut bake = bake_scene(&mesh, &asset);
    refused(
        BAD_INPUT,
        bake.args(["--limit-bytes", "100"]),
        &mesh,
        "--limit-bytes",
    );

    // A few hundred bytes that ask for 200 million texels.
    folder.write("0.bin", triangle_buffer())?;
    let bomb = folder.write("bomb.gltf", triangle("0.bin", Some("big.png")))?;
    let mut image = png(1, 1);
    image[16..24].copy_from_slice(&[0, 0, 0x38, 0, 0, 0, 0x38, 0]);
    let checksum = crc32fast::hash(&image[12..29]).to_be_bytes();
    image[29..33].copy_from_slice(&checksum);
    folder.write("big.png", &image)?;
    refused(
        BAD_INPUT,
        &mut bake_scene(&bomb, &asset),
        &bomb,
        "--limit-texels",
    );
    folder.write("big.png", png(64, 64))?;
    let mut bake = bake_scene(&bomb, &asset);
    refused(
        BAD_INPUT,
        bake.args(["--limit-texels", "4095"]),
        &bomb,
        "--limit-texels",
    );
    expect_success(bake_scene(&bomb, &asset).args(["--limit-texels", "4096"]));

    // An accessor without a buffer view is zeros, as many as it says.
    let zeros = String::from_utf8(triangle("0.bin", None))?
        .replace("\"bufferView\":0,", "")
        .replace("\"count\":3", "\"count\":90000000");
    let zeros = folder.write("zeros.gltf", zeros)?;
    refused(
        BAD_INPUT,
        &mut bake_scene(&zeros, &asset),
        &zeros,
        "--limit-vertices",
    );

    let sky = folder.write(
        "sky.hdr",
        "#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 8192 +X 16384\n",
    )?;
    refused(
        BAD_INPUT,
        &mut bake_environment(&sky, &asset, 2),
        &sky,
        "--limit-pixels",
    );
    folder.write("sky.hdr", grey_hdr(32, 16))?;
    let mut bake = bake_environment(&sky, &asset, 2);
    refused(
        BAD_INPUT,
        bake.args(["--limit-pixels", "511"]),
        &sky,
        "--limit-pixels",
    );
    expect_success(bake_environment(&sky, &asset, 2).args(["--limit-pixels", "512"]));
    Ok(())
}

fn threads() -> Outcome {
    let folder = Folder::new()?;
    let mut bake = bake_scene(&folder.at("a.obj"), &folder.at("out.relight"));
    let start = Instant::now();
    let output = expect_success(bake.args(["--threads", "100000"]));
    assert!(start.elapsed() < 3 * SOON, "{:?}", start.elapsed());
    let errors = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(errors.contains("warning: --threads 100000"), "{errors}");
    Ok(())
}

fn shapes_of_images() -> Outcome {
    let folder = Folder::new()?;
    let asset = folder.at("out.relight");
    for (size, looks) in [
        ([64, 64], "light probe"),
        ([48, 64], "vertical cross"),
        ([64, 48], "horizontal cross"),
        ([16, 96], "strip of cube faces"),
        ([64, 40], "twice as wide as high"),
    ] {
        let image = folder.write("map.hdr", grey_hdr(size[0], size[1]))?;
        let line = refused(
            BAD_INPUT,
            &mut bake_environment(&image, &asset, 2),
            &image,
            looks,
        );
        assert!(
            line.contains("--any-shape") && line.contains("--flip"),
            "{line}"
        );
        expect_success(bake_environment(&image, &asset, 2).arg("--any-shape"));
    }
    // One light, up and to the right of the middle.
    let image = folder.at("map.hdr");
    let mut pixels = image::Rgb32FImage::from_pixel(64, 32, image::Rgb([0.01; 3]));
    pixels.put_pixel(40, 6, image::Rgb([500.0; 3]));
    pixels.save(&image)?;
    let brightest = |options: &[&str]| -> Result<[f32; 3], Failed> {
        // By lobes alone: the light would be a source.
        expect_success(
            (bake_environment(&image, &asset, 2).args(options)).args(["--sources", "0"]),
        );
        let limits = relight_format::Limits::default();
        let read = relight_format::read_environment(&std::fs::read(&asset)?, &limits)?;
        let peak = |lobe: &&relight_format::Lobe| lobe.amplitude[0];
        let lobe = read.lobes.iter().max_by(|a, b| peak(a).total_cmp(&peak(b)));
        Ok(lobe.expect("a lobe").axis)
    };
    let upright = brightest(&[])?;
    assert!(upright[1] > 0.5, "{upright:?}");
    let turned = |signs: [f32; 3]| [0, 1, 2].map(|i| upright[i] * signs[i]);
    let close = |a: [f32; 3], b: [f32; 3]| (0..3).all(|i| (a[i] - b[i]).abs() < 0.02);
    let flipped = brightest(&["--flip"])?;
    assert!(
        close(flipped, turned([1.0, -1.0, 1.0])),
        "{upright:?} {flipped:?}"
    );
    let mirrored = brightest(&["--mirror"])?;
    assert!(
        close(mirrored, turned([-1.0, 1.0, 1.0])),
        "{upright:?} {mirrored:?}"
    );
    // A map on its head is suspected.
    let mut bake = bake_environment(&image, &asset, 2);
    let warning =
        |output: std::process::Output| String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(!warning(expect_success(&mut bake)).contains("--flip"));
    let flipped = warning(expect_success(bake.arg("--flip")));
    assert!(flipped.contains("--flip"), "{flipped}");
    Ok(())
}

/// However a scene is put together, it is said when its shadows are far off.
fn large_errors_are_told() -> Outcome {
    let folder = Folder::new()?;
    let mesh = folder.at("a.obj");
    let plane = folder.write("plane.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")?;
    let (asset, part) = (folder.at("out.relight"), folder.at("out.part"));
    let tells = |command: &mut Command| {
        let errors = expect_success(command).stderr;
        String::from_utf8_lossy(&errors).contains("warning: visibility on the surface is off by")
    };
    assert!(tells(&mut bake_scene(&mesh, &asset)));
    assert!(!tells(&mut bake_scene(&plane, &asset)));
    // Only all parts together tell.
    assert!(!tells(bake_scene(&mesh, &part).args(["--shard", "1/1"])));
    let mut merge = program();
    assert!(tells(merge.arg("merge").arg(&part).arg("-o").arg(&asset)));
    Ok(())
}

/// An image in ACEScg of the colour that Rec.709 has as (0.2, 0.5, 0.8).
fn chromaticities() -> Outcome {
    use exr::prelude::*;
    let folder = Folder::new()?;
    let (path, asset) = (folder.at("sky.exr"), folder.at("sky.relight"));
    let color = (0.330_28, 0.482_98, 0.754_76);
    let mut image = Image::from_channels((32, 16), SpecificChannels::rgb(move |_| color));
    image.attributes.chromaticities = Some(attribute::Chromaticities {
        red: Vec2(0.713, 0.293),
        green: Vec2(0.165, 0.83),
        blue: Vec2(0.128, 0.044),
        white: Vec2(0.321_68, 0.337_67),
    });
    image.write().to_file(&path)?;
    let mean = || -> std::result::Result<[f64; 3], Failed> {
        expect_success(&mut bake_environment(&path, &asset, 1));
        let limits = relight_format::Limits::default();
        let read = relight_format::read_environment(&std::fs::read(&asset)?, &limits)?;
        let image = relight_bake::environment::render(&read.lobes, 32, 16);
        Ok(image
            .total_power()
            .map(|power| power / (4.0 * std::f64::consts::PI)))
    };
    let converted = mean()?;
    for (found, expected) in converted.into_iter().zip([0.2, 0.5, 0.8]) {
        assert!((found - expected).abs() < 0.01, "{converted:?}");
    }
    image.attributes.chromaticities = Some(attribute::Chromaticities {
        red: Vec2(0.3, 0.3),
        green: Vec2(0.3, 0.3),
        blue: Vec2(0.3, 0.3),
        white: Vec2(0.3, 0.3),
    });
    image.write().to_file(&path)?;
    refused(
        BAD_INPUT,
        &mut bake_environment(&path, &asset, 1),
        &path,
        "chromaticities",
    );
    Ok(())
}

fn scene_semantics() -> Outcome {
    let folder = Folder::new()?;
    let asset = folder.at("out.relight");
    let scene = |text: &str| folder.write("scene.toml", format!("mesh = 'a.obj'\n{text}"));
    let path = scene("environment = 'sky.hdr'")?;
    let sky = folder.at("sky.hdr");
    let mut bake = bake_scene(&path, &asset);
    let line = refused(INPUT_OUTPUT, &mut bake, &sky, "No such file");
    assert_eq!(line.matches("No such file").count(), 1, "{line}");
    std::fs::write(&sky, "no image")?;
    refused(BAD_INPUT, &mut bake_scene(&path, &asset), &sky, "Radiance");
    std::fs::write(&sky, grey_hdr(64, 64))?;
    refused(
        BAD_INPUT,
        &mut bake_scene(&path, &asset),
        &sky,
        "twice as wide as high",
    );
    std::fs::write(&sky, grey_hdr(64, 32))?;
    expect_success(&mut bake_scene(&path, &asset));

    let path = scene(
        "[materials.default]\nmodel = 'layers'\n\
         [[materials.default.layers]]\nmaterial = { model = 'diffuse', diffuse = 0.5 }\n\
         [[materials.default.layers]]\nmaterial = { model = 'diffuse', diffuse = 0.5 }\n\
         blend = 'coat'\n",
    )?;
    refused(
        BAD_INPUT,
        &mut bake_scene(&path, &asset),
        &path,
        "layers[1].blend",
    );
    let light = "[[lights]]\nposition = [0, 1, 0]\nradius = 0.1\nradiance = 1\n";
    let path = scene(&light.repeat(129))?;
    refused(
        BAD_INPUT,
        &mut bake_scene(&path, &asset),
        &path,
        "at most 128 lights",
    );
    expect_success(&mut bake_scene(&scene(&light.repeat(128))?, &asset));

    folder.write("0.bin", triangle_buffer())?;
    let newer = String::from_utf8(triangle("0.bin", None))?.replace(
        "\"version\":\"2.0\"",
        "\"minVersion\":\"2.1\",\"version\":\"2.1\"",
    );
    let newer = folder.write("newer.gltf", newer)?;
    refused(
        BAD_INPUT,
        &mut bake_scene(&newer, &asset),
        &newer,
        "minVersion",
    );
    Ok(())
}

fn tables() -> Outcome {
    let folder = Folder::new()?;
    let asset = folder.at("out.relight");
    for value in [0f64, -1.0] {
        let mut bytes: Vec<u8> = [90i32, 90, 180]
            .iter()
            .flat_map(|n| n.to_le_bytes())
            .collect();
        bytes.extend(std::iter::repeat_n(value.to_le_bytes(), 90 * 90 * 180 * 3).flatten());
        let table = folder.write("table.binary", &bytes)?;
        refused(
            BAD_INPUT,
            &mut bake_material(&table, &asset),
            &table,
            "black",
        );
    }
    Ok(())
}

fn options() -> Outcome {
    let folder = Folder::new()?;
    let (mesh, asset) = (folder.at("a.obj"), folder.at("out.relight"));
    let paint = folder.write("paint.toml", "model = 'diffuse'\ndiffuse = 0.5\n")?;
    let sky = folder.write("sky.hdr", grey_hdr(16, 8))?;
    let wrong: [(&str, &Path, &[&str]); 22] = [
        ("scene", &mesh, &["--rank", "3"]),
        (
            "scene",
            &mesh,
            &["--representation", "global", "--max-error", "0.1"],
        ),
        (
            "scene",
            &mesh,
            &["--representation", "global", "--max-tiles", "2"],
        ),
        (
            "scene",
            &mesh,
            &["--representation", "global", "--max-bytes", "2000"],
        ),
        (
            "scene",
            &mesh,
            &["--representation", "global", "--rank", "32"],
        ),
        ("scene", &mesh, &["--max-tiles", "0"]),
        ("scene", &mesh, &["--max-tiles", "9"]),
        ("scene", &mesh, &["--max-error", "0"]),
        ("scene", &mesh, &["--max-error", "nan"]),
        ("scene", &mesh, &["--max-edge", "-1"]),
        ("scene", &mesh, &["--refine-error", "inf"]),
        ("scene", &mesh, &["--max-bytes", "0"]),
        ("scene", &mesh, &["--max-vertices", "0"]),
        ("scene", &mesh, &["--sample-resolution", "100"]),
        ("scene", &mesh, &["--basis-resolution", "512"]),
        ("environment", &sky, &["--lobes", "0"]),
        ("environment", &sky, &["--lobes", "1025"]),
        ("environment", &sky, &["--max-error", "-0.5"]),
        ("material", &paint, &["--lobes", "2"]),
        ("material", &paint, &["--max-error", "0.2"]),
        ("material", &paint, &["--report", "report"]),
        ("material", &folder.at("x.bsdf"), &["--root", "/"]),
    ];
    for (command, input, arguments) in wrong {
        let mut bake = program();
        bake.arg(command)
            .arg(input)
            .arg("-o")
            .arg(&asset)
            .args(arguments);
        let output = expect(USAGE, &mut bake);
        let errors = String::from_utf8_lossy(&output.stderr).into_owned();
        let option = arguments
            .iter()
            .rfind(|word| word.starts_with("--"))
            .expect("one");
        let known = errors.contains(option) || errors.contains("--sample-resolution");
        assert!(known, "{arguments:?}: {errors}");
        assert!(!asset.exists());
    }
    // Every option that takes a number says its range or least value.
    for command in ["scene", "environment", "material"] {
        let help = expect_success(program().args([command, "--help"]));
        let help = String::from_utf8_lossy(&help.stdout).into_owned();
        let mut paragraphs = help.split("\n\n");
        let numbers = [
            "<N>",
            "<K>",
            "<E>",
            "<ERROR>",
            "<RADIANS>",
            "<FRACTION>",
            "<BYTES>",
        ];
        let silent = paragraphs.find(|text| {
            let said = [" to ", "at least", "above 0", "from 0"];
            let first = text.lines().find(|line| line.trim_start().starts_with('-'));
            first.is_some_and(|line| numbers.iter().any(|number| line.contains(number)))
                && !said.iter().any(|words| text.contains(words))
        });
        assert_eq!(silent, None, "bake {command} --help gives no range");
    }
    Ok(())
}

fn resume_says_what_differs() -> Outcome {
    let folder = Folder::new()?;
    let (mesh, asset) = (folder.at("a.obj"), folder.at("out.relight"));
    let parts = folder.at("out.relight.parts");
    expect_success(bake_scene(&mesh, &parts).args(["--shard", "1/1"]));
    let before = std::fs::read(&parts)?;
    let resume = |more: &[&str]| {
        let mut bake = bake_scene(&mesh, &asset);
        bake.arg("--resume").args(more);
        bake
    };
    let line = refused(
        BAD_INPUT,
        &mut resume(&["--max-tiles", "1"]),
        &parts,
        "max_tiles",
    );
    assert!(
        line.contains("max_tiles 1") && line.contains("max_tiles 2"),
        "{line}"
    );
    folder.write("a.obj", sphere_over_ground(5))?;
    let line = refused(BAD_INPUT, &mut resume(&[]), &parts, "mesh");
    assert!(!line.contains("max_tiles"), "{line}");
    assert_eq!(std::fs::read(&parts)?, before);
    // A bake that runs is mentioned first, --resume or not.
    let file = std::fs::File::open(&parts)?;
    file.lock()?;
    let output = expect(BAD_INPUT, &mut bake_scene(&mesh, &asset));
    let errors = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(errors.contains("one that is running"), "{errors}");
    assert!(!errors.contains("--resume"), "{errors}");
    Ok(())
}

fn other_files_are_no_parts() -> Outcome {
    let folder = Folder::new()?;
    let parts = folder.write("out.relight.parts", "a diary")?;
    let mut bake = bake_scene(&folder.at("a.obj"), &folder.at("out.relight"));
    refused(BAD_INPUT, &mut bake, &parts, "not replaced");
    assert_eq!(std::fs::read(&parts)?, b"a diary");
    Ok(())
}

#[cfg(unix)]
mod unix {
    use std::ffi::OsStr;
    use std::os::unix::ffi::OsStrExt as _;
    use std::os::unix::fs::symlink;

    use super::{
        BAD_INPUT, Command, Completion, Duration, Failed, Folder, INPUT_OUTPUT, Instant, Outcome,
        Path, SOON, Stdio, Value, bake_environment, bake_material, bake_scene, describe,
        expect_success, grey_hdr, png, program, refused, sphere_over_ground, triangle,
        triangle_buffer,
    };

    const INTERRUPTED: i32 = 130;

    fn mkfifo(path: &Path) -> Outcome {
        let made = Command::new("mkfifo").arg(path).status()?;
        assert!(made.success());
        Ok(())
    }

    /// A device that swallows what is written, or fails as if full. Only root may make one,
    /// and not everywhere.
    fn mknod(path: &Path, minor: u32) -> bool {
        let made = Command::new("mknod")
            .arg(path)
            .args(["c", "1", &minor.to_string()])
            .stderr(Stdio::null())
            .status();
        made.is_ok_and(|status| status.success()) && std::fs::File::open(path).is_ok()
    }

    fn no_devices() -> Completion {
        Completion::ignored_with("device nodes cannot be made here")
    }

    pub fn output_is_no_link() -> Outcome {
        let folder = Folder::new()?;
        let (mesh, link) = (folder.at("a.obj"), folder.at("link.relight"));
        let target = folder.write("target", "what was there before")?;
        let sky = folder.write("sky.hdr", grey_hdr(16, 8))?;
        let paint = folder.write("paint.toml", "model = 'diffuse'\ndiffuse = 0.5\n")?;
        for to in [target.clone(), folder.at("nothing")] {
            symlink(&to, &link)?;
            let reason = "a symbolic link";
            refused(INPUT_OUTPUT, &mut bake_scene(&mesh, &link), &link, reason);
            refused(
                INPUT_OUTPUT,
                &mut bake_environment(&sky, &link, 2),
                &link,
                reason,
            );
            refused(
                INPUT_OUTPUT,
                &mut bake_material(&paint, &link),
                &link,
                reason,
            );
            assert!(link.is_symlink());
            std::fs::remove_file(&link)?;
        }
        // Links in the place of helpers are not followed either.
        let asset = folder.at("out.relight");
        symlink(&target, folder.at("out.relight.parts"))?;
        let parts = folder.at("out.relight.parts");
        refused(
            INPUT_OUTPUT,
            &mut bake_scene(&mesh, &asset),
            &parts,
            "a symbolic link",
        );
        symlink(&target, folder.at("out.relight.partial"))?;
        expect_success(&mut bake_environment(&sky, &asset, 2));
        assert_eq!(std::fs::read(&target)?, b"what was there before");
        assert!(!folder.at("out.relight.partial").exists());
        let inside = folder.at("folder.relight");
        std::fs::create_dir(&inside)?;
        refused(
            INPUT_OUTPUT,
            &mut bake_environment(&sky, &inside, 2),
            &inside,
            "a folder",
        );
        Ok(())
    }

    pub fn output_is_no_device() -> Result<Completion, Failed> {
        use std::os::unix::fs::FileTypeExt as _;
        let folder = Folder::new()?;
        let sky = folder.write("sky.hdr", grey_hdr(16, 8))?;
        let pipe = folder.at("pipe");
        mkfifo(&pipe)?;
        refused(
            INPUT_OUTPUT,
            &mut bake_environment(&sky, &pipe, 2),
            &pipe,
            "pipe",
        );
        assert!(std::fs::symlink_metadata(&pipe)?.file_type().is_fifo());
        let null = folder.at("null");
        if !mknod(&null, 3) {
            return Ok(no_devices());
        }
        for mut bake in [
            bake_scene(&folder.at("a.obj"), &null),
            bake_environment(&sky, &null, 2),
        ] {
            refused(INPUT_OUTPUT, &mut bake, &null, "device");
            assert!(
                std::fs::symlink_metadata(&null)?
                    .file_type()
                    .is_char_device()
            );
        }
        Ok(Completion::Completed)
    }

    pub fn gltf_stays() -> Outcome {
        let folder = Folder::new()?;
        let asset = folder.at("out.relight");
        let secret = folder.write("secret.bin", triangle_buffer())?;
        folder.write("secret.png", png(2, 2))?;
        let buffer = folder.write("in/0.bin", triangle_buffer())?;
        folder.write("in/own.png", png(2, 2))?;
        symlink(&secret, folder.at("in/absolute.bin"))?;
        symlink("../secret.bin", folder.at("in/relative.bin"))?;
        symlink("..", folder.at("in/up"))?;
        symlink("0.bin", folder.at("in/same.bin"))?;
        let absolute = secret.to_string_lossy().into_owned();
        let mesh = |buffer: &str, image: Option<&str>| {
            folder.write("in/mesh.gltf", triangle(buffer, image))
        };
        for outside in [
            "../secret.bin",
            "%2e%2e/secret.bin",
            "%2E%2E%2Fsecret.bin",
            "./a/../../secret.bin",
            "absolute.bin",
            "relative.bin",
            "up/secret.bin",
            &absolute,
        ] {
            let path = mesh(outside, None)?;
            let file = Path::new(outside.rsplit(['/', 'F']).next().expect("a name"));
            let output = expect_failure(&mut bake_scene(&path, &asset));
            assert!(
                output.contains(&*file.to_string_lossy()),
                "{outside}: {output}"
            );
            let told = output.contains("--root") || output.contains("No such file");
            assert!(told, "{outside}: {output}");
            assert!(!asset.exists());
            // A wider folder may be named.
            if !outside.contains("/a/") && outside != "absolute.bin" {
                let mut bake = bake_scene(&path, &asset);
                expect_success(bake.arg("--root").arg(folder.0.path()));
                std::fs::remove_file(&asset)?;
            }
        }
        for outside in ["../secret.png", "%2e%2e/secret.png"] {
            let path = mesh("0.bin", Some(outside))?;
            let output = expect_failure(&mut bake_scene(&path, &asset));
            assert!(output.contains("--root"), "{outside}: {output}");
        }
        for inside in ["0.bin", "same.bin", "./0.bin", "%30.bin"] {
            expect_success(&mut bake_scene(&mesh(inside, Some("own.png"))?, &asset));
        }
        // The file on the command line may be a link.
        let link = folder.at("in/named.gltf");
        symlink(folder.at("in/mesh.gltf"), &link)?;
        expect_success(&mut bake_scene(&link, &asset));
        std::fs::remove_file(&buffer)?;
        Ok(())
    }

    /// Runs a command that must refuse its input, and gives what it says.
    fn expect_failure(command: &mut Command) -> String {
        let output = command.stdin(Stdio::null()).output().expect("it starts");
        let code = output.status.code();
        assert!(
            code == Some(BAD_INPUT) || code == Some(INPUT_OUTPUT),
            "{command:?}: {}",
            describe(&output)
        );
        String::from_utf8_lossy(&output.stderr).into_owned()
    }

    pub fn obj_stays() -> Outcome {
        let folder = Folder::new()?;
        let asset = folder.at("out.relight");
        folder.write("secret.png", png(2, 2))?;
        folder.write("secret.mtl", "newmtl body\nKd 1 0 0\n")?;
        let absolute = folder.at("secret.png").to_string_lossy().into_owned();
        let mesh = format!("mtllib a.mtl\nusemtl body\n{}", sphere_over_ground(4));
        let path = folder.write("in/a.obj", mesh.replace("vn ", "vt 0 0\nvn "))?;
        for outside in ["../secret.png", "..\\secret.png", &absolute] {
            folder.write("in/a.mtl", format!("newmtl body\nmap_Kd {outside}\n"))?;
            let output = expect_success(bake_scene(&path, &asset).arg("--json"));
            let summary: Value = serde_json::from_slice(&output.stdout)?;
            assert!(
                summary["warnings"].to_string().contains("--root"),
                "{summary}"
            );
            let limits = relight_format::Limits::default();
            let scene = relight_format::read_scene(&std::fs::read(&asset)?, &limits)?;
            assert!(scene.textures.is_empty());
        }
        folder.write(
            "in/a.obj",
            format!(
                "mtllib ../secret.mtl\nusemtl body\n{}",
                sphere_over_ground(4)
            ),
        )?;
        let output = expect_success(bake_scene(&path, &asset).arg("--json"));
        let summary: Value = serde_json::from_slice(&output.stdout)?;
        assert!(
            summary["warnings"].to_string().contains("--root"),
            "{summary}"
        );
        Ok(())
    }

    pub fn scene_stays() -> Outcome {
        let folder = Folder::new()?;
        let asset = folder.at("out.relight");
        folder.write("wood.png", png(2, 2))?;
        folder.write("in/a.obj", sphere_over_ground(4))?;
        folder.write("sky.hdr", grey_hdr(16, 8))?;
        symlink("../a.obj", folder.at("in/link.obj"))?;
        let scene = folder.at("in/scene.toml");
        let absolute = folder.at("a.obj").to_string_lossy().into_owned();
        let layers = "[materials.default]\nmodel = 'layers'\n[[materials.default.layers]]\n\
                      material = { model = 'diffuse', diffuse = 0.5 }\n";
        for text in [
            "mesh = '../a.obj'",
            "mesh = 'link.obj'",
            &format!("mesh = '{absolute}'"),
            "mesh = 'a.obj'\nenvironment = '../sky.hdr'",
            &format!("mesh = 'a.obj'\n{layers}diffuse_texture = '../wood.png'"),
            "mesh = 'a.obj'\n[materials.default]\nmodel = 'measured'\nfile = '../x.relight'",
            "mesh = 'a.obj'\n[materials.default]\nmodel = 'measured'\nfile = '../x.bsdf'",
        ] {
            std::fs::write(&scene, text)?;
            let output = expect_failure(&mut bake_scene(&scene, &asset));
            let told = output.contains("--root") || output.contains("No such file");
            assert!(told, "{text}: {output}");
            if !text.contains("measured") {
                assert!(output.contains("--root"), "{text}: {output}");
                let mut bake = bake_scene(&scene, &asset);
                expect_success(bake.arg("--root").arg(folder.0.path()));
            }
        }
        Ok(())
    }

    pub fn pipes_do_not_hang() -> Outcome {
        let folder = Folder::new()?;
        let asset = folder.at("out.relight");
        for name in [
            "pipe.bin",
            "pipe.obj",
            "pipe.hdr",
            "pipe.binary",
            "pipe.toml",
        ] {
            mkfifo(&folder.at(name))?;
        }
        let mesh = folder.write("mesh.gltf", triangle("pipe.bin", None))?;
        let pipe = folder.at("pipe.bin");
        refused(
            BAD_INPUT,
            &mut bake_scene(&mesh, &asset),
            &pipe,
            "a regular file",
        );
        for (mut bake, name) in [
            (bake_scene(&folder.at("pipe.obj"), &asset), "pipe.obj"),
            (bake_scene(&folder.at("pipe.toml"), &asset), "pipe.toml"),
            (
                bake_environment(&folder.at("pipe.hdr"), &asset, 2),
                "pipe.hdr",
            ),
            (
                bake_material(&folder.at("pipe.binary"), &asset),
                "pipe.binary",
            ),
        ] {
            refused(BAD_INPUT, &mut bake, &folder.at(name), "a regular file");
        }
        let mut validate = program();
        validate.arg("validate").arg(&pipe);
        refused(BAD_INPUT, &mut validate, &pipe, "a regular file");
        let mut merge = program();
        merge.arg("merge").arg(&pipe).arg("-o").arg(&asset);
        refused(BAD_INPUT, &mut merge, &pipe, "a regular file");
        Ok(())
    }

    /// Starts a command whose standard output nobody reads.
    fn closed(command: &mut Command) -> Result<std::process::Output, Failed> {
        let (reader, writer) = std::io::pipe()?;
        drop(reader);
        let child = command
            .stdin(Stdio::null())
            .stdout(writer)
            .stderr(Stdio::piped());
        Ok(child.spawn()?.wait_with_output()?)
    }

    pub fn closed_output() -> Outcome {
        let folder = Folder::new()?;
        let (mesh, asset) = (folder.at("a.obj"), folder.at("out.relight"));
        for mut command in [
            bake_scene(&mesh, &asset),
            {
                let mut inspect = program();
                inspect.arg("inspect").arg(&asset);
                inspect
            },
            {
                let mut inspect = program();
                inspect.arg("inspect").arg(&asset).arg("--json");
                inspect
            },
            {
                let mut help = program();
                help.arg("--help");
                help
            },
        ] {
            let output = closed(&mut command)?;
            assert_eq!(
                output.status.code(),
                Some(0),
                "{command:?}: {}",
                describe(&output)
            );
        }
        // Nor need anybody read errors and warnings.
        let (reader, writer) = std::io::pipe()?;
        drop(reader);
        let mut bake = bake_scene(&folder.at("missing.obj"), &asset);
        let status = bake.stdout(Stdio::null()).stderr(writer).status()?;
        assert_eq!(status.code(), Some(INPUT_OUTPUT));
        Ok(())
    }

    pub fn full_output() -> Result<Completion, Failed> {
        let folder = Folder::new()?;
        let full = folder.at("full");
        if !mknod(&full, 7) {
            return Ok(no_devices());
        }
        let asset = folder.at("out.relight");
        let mut bake = bake_scene(&folder.at("a.obj"), &asset);
        let open = || std::fs::OpenOptions::new().write(true).open(&full);
        let output = bake.stdout(open()?).stderr(Stdio::piped()).output()?;
        let errors = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(INPUT_OUTPUT), "{errors}");
        assert!(errors.contains("standard output"), "{errors}");
        // The asset itself is whole.
        expect_success(program().arg("validate").arg(&asset));
        let status = bake.stdout(open()?).stderr(open()?).status()?;
        assert_eq!(status.code(), Some(INPUT_OUTPUT));
        Ok(Completion::Completed)
    }

    pub fn names_that_are_no_text() -> Outcome {
        let folder = tempfile::tempdir()?;
        let at = |name: &[u8]| folder.path().join(OsStr::from_bytes(name));
        let (mesh, asset) = (at(b"m\xff.obj"), at(b"a\xfe.relight"));
        if std::fs::write(&mesh, sphere_over_ground(4)).is_err() {
            // Some file systems take text only: then there is nothing to go wrong.
            return Ok(());
        }
        let sky = at(b"s\xff.hdr");
        std::fs::write(&sky, grey_hdr(16, 8))?;
        for json in [&[][..], &["--json"], &["--json-progress"]] {
            expect_success(bake_scene(&mesh, &asset).args(json));
            let part = at(b"p\xfd.part");
            expect_success(bake_scene(&mesh, &part).args(["--shard", "1/1"]).args(json));
            let mut merge = program();
            expect_success(
                merge
                    .arg("merge")
                    .arg(&part)
                    .arg("-o")
                    .arg(&asset)
                    .args(json),
            );
            for command in ["inspect", "validate"] {
                expect_success(program().arg(command).arg(&asset).args(json));
            }
            expect_success(bake_environment(&sky, &asset, 2).args(json));
        }
        Ok(())
    }

    /// Sends an interrupt some time after the start; gives the exit code.
    fn interrupted(command: &mut Command, after: Duration) -> Result<i32, Failed> {
        let child = command.stdin(Stdio::null()).stdout(Stdio::null());
        let mut child = child.stderr(Stdio::null()).spawn()?;
        std::thread::sleep(after);
        if let Some(status) = child.try_wait()? {
            return Err(format!("{command:?} ended too early: {status}").into());
        }
        let kill = Command::new("sh")
            .arg("-c")
            .arg(format!("kill -INT {}", child.id()))
            .status()?;
        assert!(kill.success());
        let start = Instant::now();
        while start.elapsed() < SOON {
            if let Some(status) = child.try_wait()? {
                return Ok(status.code().unwrap_or(-1));
            }
            std::thread::sleep(Duration::from_millis(20));
        }
        child.kill()?;
        child.wait()?;
        Err(format!("{command:?} runs on").into())
    }

    pub fn interrupts() -> Outcome {
        let folder = Folder::new()?;
        let asset = folder.write("out.relight", "what was there before")?;
        let sky = folder.at("sky.hdr");
        let mut image = image::Rgb32FImage::new(512, 256);
        for (x, y, pixel) in image.enumerate_pixels_mut() {
            *pixel = image::Rgb([(x * 7919 % 101) as f32, (y * 31 % 17) as f32, 1.0]);
        }
        image.save(&sky)?;
        let after = Duration::from_millis(700);
        let mut bake = bake_environment(&sky, &asset, 512);
        assert_eq!(interrupted(&mut bake, after)?, INTERRUPTED);
        // A table of noise takes all the lobes there are.
        let mut bytes: Vec<u8> = [90i32, 90, 180]
            .iter()
            .flat_map(|n| n.to_le_bytes())
            .collect();
        let mut state = 1u32;
        for _ in 0..90 * 90 * 180 * 3 {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            bytes.extend(f64::from(state >> 8).to_le_bytes());
        }
        let table = folder.write("noise.binary", bytes)?;
        let mut bake = bake_material(&table, &asset);
        assert_eq!(
            interrupted(bake.args(["--lobes", "7"]), after)?,
            INTERRUPTED
        );
        assert_eq!(std::fs::read(&asset)?, b"what was there before");
        assert!(!folder.at("out.relight.partial").exists());
        Ok(())
    }
}
