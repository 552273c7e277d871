//! Tells the laboratory which commit and which `wgpu` it was built from.

use std::path::Path;
use std::process::Command;

fn main() {
    let git = |arguments: &[&str]| {
        let output = Command::new("git").args(arguments).output().ok()?;
        let text = String::from_utf8(output.stdout).ok()?;
        (output.status.success()).then(|| text.trim().to_owned())
    };
    let commit = git(&["describe", "--always", "--dirty", "--abbrev=12"]);
    println!(
        "cargo::rustc-env=RELIGHT_COMMIT={}",
        commit.as_deref().unwrap_or("unknown")
    );
    let git_files = ["HEAD", "index"].map(|name| git(&["rev-parse", "--git-path", name]));
    for path in git_files.iter().flatten() {
        println!("cargo::rerun-if-changed={path}");
    }
    // What makes the tree differ from the commit.
    for folder in ["src", "scenes", "../../crates"] {
        println!("cargo::rerun-if-changed={folder}");
    }
    let lock = Path::new("../../Cargo.lock");
    println!("cargo::rerun-if-changed={}", lock.display());
    let text = std::fs::read_to_string(lock).unwrap_or_default();
    let wgpu = (text.split_once("name = \"wgpu\"\nversion = \""))
        .and_then(|(_, rest)| rest.split_once('"'))
        .map_or("unknown", |(version, _)| version);
    println!("cargo::rustc-env=RELIGHT_WGPU={wgpu}");
}
