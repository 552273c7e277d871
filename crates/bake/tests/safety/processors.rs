//! The same bytes on every processor: with each kind of vector instructions that this one
//! has, and on others that QEMU plays.

use std::ffi::OsStr;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use libtest_mimic::{Completion, Failed, Trial};
use relight_bake::simd;

use crate::meshes::sphere_over_ground;
use crate::{Folder, Outcome, USAGE, bake_environment, expect, expect_success, program};

pub fn trials() -> Vec<Trial> {
    vec![
        Trial::test("processors::instructions", instructions),
        Trial::ignorable_test("processors::emulated", emulated),
    ]
}

/// Inputs, and how they are baked: a scene of several clusters, some refined, and an image.
struct Inputs(Folder);

impl Inputs {
    fn new(steps: usize) -> Result<Self, Failed> {
        let folder = Folder::new()?;
        folder.write("b.obj", sphere_over_ground(steps))?;
        let mut image = image::Rgb32FImage::new(32, 16);
        for (x, y, pixel) in image.enumerate_pixels_mut() {
            *pixel = image::Rgb([(x * 7 % 11) as f32, (y * 5 % 7) as f32, 1.0]);
        }
        image.put_pixel(20, 5, image::Rgb([100.0, 50.0, 25.0]));
        image.save(folder.at("sky.hdr"))?;
        Ok(Self(folder))
    }

    fn scene(&self, output: &Path) -> Command {
        let mut bake = program();
        bake.arg("scene")
            .arg(self.0.at("b.obj"))
            .arg("-o")
            .arg(output);
        bake.args(["--sample-resolution", "32", "--basis-resolution", "16"]);
        bake.args(["--max-edge", "0.2", "--refine-error", "0.1"]);
        bake
    }

    fn environment(&self, output: &Path) -> Command {
        bake_environment(&self.0.at("sky.hdr"), output, 4)
    }

    fn output(&self) -> PathBuf {
        self.0.at("out.relight")
    }

    /// What each command writes.
    fn bytes(&self, run: &dyn Fn(Command) -> Result<(), Failed>) -> Result<[Vec<u8>; 2], Failed> {
        let output = self.output();
        let of = |command: Command| -> Result<Vec<u8>, Failed> {
            run(command)?;
            Ok(std::fs::read(&output)?)
        };
        Ok([of(self.scene(&output))?, of(self.environment(&output))?])
    }
}

fn instructions() -> Outcome {
    let inputs = Inputs::new(24)?;
    let expected = inputs.bytes(&|mut command| {
        expect_success(&mut command);
        Ok(())
    })?;
    let mut tried = 0;
    for name in ["plain", "avx2", "avx512"] {
        if simd::by_name(name).is_none() {
            continue;
        }
        let found = inputs.bytes(&|mut command| {
            expect_success(command.env(simd::VARIABLE, name));
            Ok(())
        })?;
        assert!(found == expected, "other bytes with {name}");
        tried += 1;
    }
    assert!(tried >= 1, "no instructions are known");
    let mut unknown = inputs.scene(&inputs.output());
    expect(USAGE, unknown.env(simd::VARIABLE, "abacus"));
    Ok(())
}

/// Processors from before fused products, with AVX2, and what QEMU has at most.
const PROCESSORS: [&str; 3] = ["Nehalem", "Haswell", "max"];

/// Unlike `RELIGHT_SIMD`, this also changes what other libraries choose by the processor. Of
/// scenes alone: the fit of an environment amplifies the last bit of sines and exponentials,
/// which the C library computes differently with and without fused products.
fn emulated() -> Result<Completion, Failed> {
    let emulator = "qemu-x86_64";
    let version = Command::new(emulator)
        .arg("--version")
        .stdout(Stdio::null())
        .status();
    if !cfg!(all(target_os = "linux", target_arch = "x86_64"))
        || !version.is_ok_and(|v| v.success())
    {
        return Ok(Completion::ignored_with(
            "no qemu-x86_64 (Debian: qemu-user)",
        ));
    }
    let inputs = Inputs::new(6)?;
    let [expected, _] = inputs.bytes(&|mut command| {
        expect_success(&mut command);
        Ok(())
    })?;
    for processor in PROCESSORS {
        let output = inputs.output();
        let scene = inputs.scene(&output);
        let arguments: Vec<&OsStr> = scene.get_args().collect();
        let mut emulated = Command::new(emulator);
        emulated.args(["-cpu", processor]).arg(scene.get_program());
        expect_success(emulated.args(arguments));
        let found = std::fs::read(&output)?;
        assert!(found == expected, "other bytes of the scene on {processor}");
    }
    Ok(Completion::Completed)
}
