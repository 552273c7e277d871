//! The examples, and the pictures that they make: stored beside, and written anew if
//! `RELIGHT_UPDATE_PICTURES=1` asks for it.

#![allow(
    clippy::duplicate_mod,
    reason = "every example has the module that they share"
)]

use std::path::{Path, PathBuf};

use relight_format::{Environment, Lobe, write_environment, write_scene};
use relight_runtime::offscreen::Gpu;

use crate::{Outcome, lights, scenes};

#[path = "../../examples/headless.rs"]
mod headless;
#[path = "../../examples/instances.rs"]
mod instances;
#[path = "../../examples/minimal.rs"]
mod minimal;
#[path = "../../examples/own_pass.rs"]
mod own_pass;
#[path = "../../examples/picture_in_picture.rs"]
mod picture_in_picture;

/// Mean difference of display codes: pixels on edges fall to either side on another device.
const MEAN_CODES: f64 = 0.5;
/// Lines that an example may have.
const MOST_LINES: usize = 150;
/// Lines that an app takes to draw a scene in its own pass, without those of comments and of nothing but brackets.
const MOST_LINES_IN_A_PASS: usize = 30;

type Example = fn(&Path, &Path, &Path) -> Result<(), Box<dyn std::error::Error>>;

const EXAMPLES: [(&str, Example); 5] = [
    ("headless", headless::run),
    ("instances", instances::run),
    ("minimal", minimal::run),
    ("own_pass", own_pass::run),
    ("picture_in_picture", picture_in_picture::run),
];

pub fn examples_make_their_pictures(_: &mut Gpu) -> Outcome {
    let folder = tempfile::tempdir()?;
    let [scene, environment] =
        ["scene", "environment"].map(|name| folder.path().join(name).with_extension("relight"));
    std::fs::write(&scene, write_scene(&scenes::sphere_over_plane())?)?;
    let lobes = lights().into_iter().map(|light| Lobe {
        axis: light.axis.into(),
        sharpness: light.sharpness,
        amplitude: light.amplitude.into(),
        reserved: 0.0,
    });
    let lit = Environment {
        lobes: lobes.collect(),
        ..Environment::default()
    };
    std::fs::write(&environment, write_environment(&lit)?)?;
    let here = Path::new(env!("CARGO_MANIFEST_DIR"));
    let update = std::env::var_os("RELIGHT_UPDATE_PICTURES").is_some_and(|value| value == "1");
    let source = std::fs::read_to_string(here.join("examples/support/in_your_pass.rs"))?;
    let lines = (source.lines().map(str::trim))
        .filter(|line| !line.starts_with("//") && line.contains(char::is_alphanumeric))
        .count();
    assert!(lines <= MOST_LINES_IN_A_PASS, "in_your_pass: {lines} lines");
    let mut wrong = Vec::new();
    for (name, run) in EXAMPLES {
        let source = here.join("examples").join(name).with_extension("rs");
        let lines = std::fs::read_to_string(source)?.lines().count();
        assert!(lines <= MOST_LINES, "{name}: {lines} lines");
        let picture = folder.path().join(name).with_extension("png");
        run(&scene, &environment, &picture).map_err(|error| format!("{name}: {error}"))?;
        let stored = here.join("tests/pictures").join(name).with_extension("png");
        if update {
            std::fs::copy(&picture, &stored)?;
            continue;
        }
        let difference = difference(&picture, &stored)?;
        println!("{name}: {difference} codes");
        if difference > MEAN_CODES {
            wrong.push(name);
        }
    }
    assert!(wrong.is_empty(), "other pictures: {wrong:?}");
    Ok(())
}

fn difference(found: &PathBuf, expected: &PathBuf) -> Result<f64, Box<dyn std::error::Error>> {
    let [found, expected] = [found, expected].map(|path| Ok(image::open(path)?.to_rgba8()));
    let (found, expected): (image::RgbaImage, image::RgbaImage) = match (found, expected) {
        (Ok(found), Ok(expected)) => (found, expected),
        (Err(error), _) | (_, Err(error)) => return Err(error),
    };
    assert_eq!(found.dimensions(), expected.dimensions());
    let codes = found.as_raw().iter().zip(expected.as_raw());
    let sum: f64 = codes.map(|(a, b)| f64::from(a.abs_diff(*b))).sum();
    Ok(sum / found.as_raw().len() as f64)
}
