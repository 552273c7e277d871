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

/// Inputs, and how they are baked: a scene of several clusters, some refined, an image, a table.
struct Inputs {
    folder: Folder,
    /// How the scene is baked.
    options: &'static str,
}

impl Inputs {
    fn new(steps: usize, options: &'static str) -> Result<Self, Failed> {
        let folder = Folder::new()?;
        folder.write("b.obj", sphere_over_ground(steps))?;
        let mut image = image::Rgb32FImage::new(32, 16);
        for (x, y, pixel) in image.enumerate_pixels_mut() {
            *pixel = image::Rgb([(x * 7 % 11) as f32, (y * 5 % 7) as f32, 1.0]);
        }
        image.put_pixel(20, 5, image::Rgb([100.0, 50.0, 25.0]));
        image.save(folder.at("sky.hdr"))?;
        let table =
            Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tools/fuzz/corpus/rgl/small.bsdf");
        std::fs::copy(table, folder.at("gloss.bsdf"))?;
        Ok(Self { folder, options })
    }

    fn scene(&self, output: &Path) -> Command {
        let mut bake = program();
        bake.arg("scene")
            .arg(self.folder.at("b.obj"))
            .arg("-o")
            .arg(output);
        bake.args(["--sample-resolution", "32", "--basis-resolution", "16"]);
        bake.args(self.options.split(' '));
        bake
    }

    fn environment(&self, output: &Path) -> Command {
        bake_environment(&self.folder.at("sky.hdr"), output, 4)
    }

    fn output(&self) -> PathBuf {
        self.folder.at("out.relight")
    }

    fn material(&self, output: &Path) -> Command {
        let mut bake = program();
        bake.arg("material").arg(self.folder.at("gloss.bsdf"));
        bake.arg("-o").arg(output).args(["--lobes", "1"]);
        bake
    }

    /// What each command writes.
    fn bytes(&self, run: &dyn Fn(Command) -> Result<(), Failed>) -> Result<[Vec<u8>; 3], Failed> {
        let output = self.output();
        let of = |command: Command| -> Result<Vec<u8>, Failed> {
            run(command)?;
            Ok(std::fs::read(&output)?)
        };
        Ok([
            of(self.scene(&output))?,
            of(self.environment(&output))?,
            of(self.material(&output))?,
        ])
    }
}

/// In the order of [`Inputs::bytes`].
const WHAT: [&str; 3] = ["scene", "environment", "material"];

fn instructions() -> Outcome {
    let inputs = Inputs::new(24, "--max-edge 0.2 --refine-error 0.1 --bounces auto")?;
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

/// From before AVX and fused products, which machines that run tests have: the farthest from them.
const PROCESSOR: &str = "Nehalem";

/// Unlike `RELIGHT_SIMD`, this also changes what other libraries choose by the processor.
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
    // Few points, because each takes 180 times as long. Light that bounces, by rays and sums of our own, would be most of the
    // time.
    let inputs = Inputs::new(4, "--max-edge 0.5 --refine-error 0.2 --bounces 0")?;
    let expected = inputs.bytes(&|mut command| {
        expect_success(&mut command);
        Ok(())
    })?;
    let found = inputs.bytes(&|command| {
        let arguments: Vec<&OsStr> = command.get_args().collect();
        let mut emulated = Command::new(emulator);
        emulated
            .args(["-cpu", PROCESSOR])
            .arg(command.get_program());
        expect_success(emulated.args(arguments));
        Ok(())
    })?;
    for ((found, expected), what) in found.iter().zip(&expected).zip(WHAT) {
        assert!(
            found == expected,
            "other bytes of the {what} on {PROCESSOR}"
        );
    }
    Ok(Completion::Completed)
}
