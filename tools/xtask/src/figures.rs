//! The pictures of README.md, from the sources as they are checked out.

use std::path::Path;
use std::process::{Command, ExitCode};

use crate::{build_programs, data_folder, program, runtime_folder};

/// Of the window, points; as wide as README.md has room for.
const WINDOW: &str = "760x473";
/// Of each of the four pictures of legs.
const LEGS: &str = "240x180";

pub fn run(root: &Path) -> ExitCode {
    match draw(root) {
        Ok(()) => ExitCode::SUCCESS,
        Err(why) => {
            eprintln!("xtask: {why}");
            ExitCode::FAILURE
        }
    }
}

fn draw(root: &Path) -> Result<(), String> {
    let data = data_folder(root)?.ok_or("no test data: RELIGHT_DATA names no folder")?;
    let out = root.join("out/figures");
    let failed = |error: std::io::Error| error.to_string();
    std::fs::create_dir_all(&out).map_err(failed)?;
    let scene = std::fs::read_to_string(root.join("tools/lab/scenes/suzi_gold_studio.toml"));
    let scene = scene
        .map_err(failed)?
        .replace("$DATA", &data.to_string_lossy());
    std::fs::write(out.join("suzi_gold_studio.toml"), scene).map_err(failed)?;

    build_programs(root)?;
    let legs = format!(
        "experiments interpolation --device cpu --size {LEGS} --samples 1024 --out out/figures"
    );
    finish(program(root, "lab", &legs).env("RELIGHT_DATA", &data))?;
    let legs = out.join("interpolation/legs.png");
    std::fs::copy(legs, root.join("crates/bake/figures/legs.png")).map_err(failed)?;

    let bake =
        "scene out/figures/suzi_gold_studio.toml --root / -o out/figures/suzi_gold_studio.relight";
    finish(&mut program(root, "bake", bake))?;
    let mut studio = program(
        root,
        "bake",
        "environment -o out/figures/studio.hdr.relight",
    );
    finish(studio.arg(data.join("env/polyhaven/studio.hdr")))?;
    for layout in ["split", "difference"] {
        let window = program(root, "viewer", "--device cpu");
        let mut viewer = if std::env::var_os("DISPLAY").is_some() {
            window
        } else {
            let mut screen = Command::new("xvfb-run");
            screen.arg("-a").arg(window.get_program());
            screen.args(window.get_args()).current_dir(root);
            screen
        };
        // Nobody's settings but the defaults.
        viewer
            .env("XDG_CONFIG_HOME", &out)
            .env("XDG_RUNTIME_DIR", runtime_folder(root))
            .env_remove("WAYLAND_DISPLAY");
        viewer.args(["--layout", layout, "--size", WINDOW, "--window-picture"]);
        viewer.arg(root.join(format!("tools/viewer/figures/{layout}.png")));
        viewer.args(["suzi_gold_studio.relight", "studio.hdr.relight"].map(|name| out.join(name)));
        finish(&mut viewer)?;
    }
    Ok(())
}

/// Runs a command to its end.
fn finish(command: &mut Command) -> Result<(), String> {
    match command.status() {
        Ok(status) if status.success() => Ok(()),
        Ok(status) => Err(format!("{}: {status}", command.get_program().display())),
        Err(error) => Err(format!("{}: {error}", command.get_program().display())),
    }
}
