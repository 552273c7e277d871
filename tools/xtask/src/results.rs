//! All tables of RESULTS.md, from the sources as they are checked out.

use std::path::Path;
use std::process::{Command, ExitCode, Stdio};

use crate::{build_programs, cargo, data_folder, program, succeeds};

/// What visibility is compared on, below the folder of meshes.
const MESHES: [&str; 7] = [
    "stanford/bunny.obj",
    "stanford/dragon_100k.obj",
    "stanford/armadillo.obj",
    "thin/carbon60.glb",
    "scenes/FlightHelmet/FlightHelmet.gltf",
    "scenes/vr-gallery.glb",
    "scenes/CornellBox_bevy.glb",
];

pub fn run(root: &Path) -> ExitCode {
    match write(root) {
        Ok(()) => ExitCode::SUCCESS,
        Err(why) => {
            eprintln!("xtask: {why}");
            ExitCode::FAILURE
        }
    }
}

fn write(root: &Path) -> Result<(), String> {
    let data = data_folder(root)?.ok_or("no test data: RELIGHT_DATA names no folder")?;
    // First: what it writes into RESULTS.md makes the tree differ from the commit, which it names.
    build_programs(root)?;
    let experiments = "experiments all --device cpu --size 160x120 --samples 256 --out out/results \
                       --results RESULTS.md";
    let mut lab = program(root, "lab", experiments);
    match lab.env("RELIGHT_DATA", &data).status() {
        Ok(status) if status.success() => {}
        _ => return Err("lab experiments all failed".to_owned()),
    }
    let file = root.join("RESULTS.md");
    let failed = |error: std::io::Error| format!("{}: {error}", file.display());
    let mut text = std::fs::read_to_string(&file).map_err(failed)?;
    for (name, table) in [
        ("gpu-cost", gpu_cost(root)),
        ("embree", embree(root, &data)),
    ] {
        let inside = table.unwrap_or_else(|why| format!("Not made on this machine: {why}.\n"));
        text = replaced(&text, name, &inside)
            .ok_or_else(|| format!("{}: no markers of {name}", file.display()))?;
    }
    std::fs::write(&file, text).map_err(failed)
}

/// What compilers of GPUs make of the kernels.
fn gpu_cost(root: &Path) -> Result<String, String> {
    printed(&mut program(root, "gpu-cost", ""))
        .ok_or_else(|| "the root of `cargo xtask gpu-cost` cannot be made here".to_owned())
}

/// Times and differences of visibility, beside those of Embree.
fn embree(root: &Path, data: &Path) -> Result<String, String> {
    let peer = root.join("tools/peers/embree");
    let is_there = std::env::var_os("RELIGHT_EMBREE").is_some() || peer.join("occluded").exists();
    if !is_there && !succeeds(&mut Command::new(peer.join("build.sh"))) {
        return Err("`tools/peers/embree/build.sh` finds no Embree".to_owned());
    }
    let mut bench = cargo(root, "bench --quiet --workspace --bench visibility --");
    bench.args(["--vertices", "512", "--threads", "1", "--rounds", "5"]);
    bench.args(MESHES.map(|mesh| data.join("meshes").join(mesh)));
    // Made by the bench.
    bench.arg("city");
    printed(&mut bench).ok_or_else(|| "`cargo bench --bench visibility` failed".to_owned())
}

/// What a command prints, if it ends well.
fn printed(command: &mut Command) -> Option<String> {
    let output = command.stderr(Stdio::inherit()).output().ok()?;
    let text = String::from_utf8(output.stdout).ok()?;
    (output.status.success() && !text.is_empty()).then_some(text)
}

/// A text with what stands between the markers of a name replaced.
fn replaced(text: &str, name: &str, inside: &str) -> Option<String> {
    let [first, last] = ["", "/"].map(|mark| format!("<!-- {mark}{name} -->"));
    let (before, rest) = text.split_once(&first)?;
    let (_, after) = rest.split_once(&last)?;
    Some(format!(
        "{before}{first}\n\n{}\n\n{last}{after}",
        inside.trim()
    ))
}

#[cfg(test)]
mod tests {
    use super::replaced;

    #[test]
    fn what_markers_enclose_is_replaced() {
        let text = "a\n<!-- x -->\nold\n<!-- /x -->\nb\n";
        let expected = "a\n<!-- x -->\n\nnew\n\n<!-- /x -->\nb\n";
        assert_eq!(replaced(text, "x", "new\n").as_deref(), Some(expected));
        assert_eq!(replaced(text, "y", "new"), None);
    }
}
