//! What programs and libraries pull in with the features that they ask for.

use std::path::Path;
use std::process::Command;

use libtest_mimic::Trial;

use crate::support::Outcome;

pub fn trials() -> Vec<Trial> {
    vec![Trial::test(
        "features::apps_leave_out_what_is_for_tools",
        apps_leave_out_what_is_for_tools,
    )]
}

/// The lines of `cargo tree`: packages, and features as `package feature "name"`.
fn tree(arguments: &str) -> Result<String, Box<dyn std::error::Error>> {
    let cargo = std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into());
    let output = Command::new(cargo)
        .args("tree --offline --locked --prefix none -e normal,features".split(' '))
        .args(arguments.split(' '))
        .current_dir(Path::new(env!("CARGO_MANIFEST_DIR")).join(".."))
        .output()?;
    if !output.status.success() {
        return Err(String::from_utf8_lossy(&output.stderr).into());
    }
    Ok(String::from_utf8(output.stdout)?)
}

fn apps_leave_out_what_is_for_tools() -> Outcome {
    const PAPER: [&str; 3] = [
        "relight-bake feature \"paper\"",
        "relight-runtime feature \"paper\"",
        "relight-shading feature \"paper\"",
    ];
    const ACCURACY: &str = "relight-shading feature \"accuracy\"";
    const REFERENCE: &str = "relight-shading feature \"reference\"";
    let tools = [
        "rayon v",
        "pollster v",
        "relight-runtime feature \"twin\"",
        ACCURACY,
        REFERENCE,
    ];
    let page = "--target wasm32-unknown-unknown";
    // Bakes measure lobes, to warn of materials that they cannot follow.
    for (arguments, absent) in [
        ("-p relight-runtime --no-default-features", &tools[..]),
        ("-p relight-runtime", &[ACCURACY, REFERENCE]),
        ("-p relight-bake", &[]),
        (&format!("-p relight-embed {page}"), &tools[..]),
        (&format!("-p relight-viewer {page}"), &tools[1..3]),
    ] {
        let tree = tree(arguments)?;
        assert!(tree.contains("relight-shading v"), "{arguments}: {tree}");
        for name in PAPER.iter().chain(absent) {
            let found = tree.lines().find(|line| line.starts_with(name));
            assert_eq!(found, None, "{arguments}");
        }
    }
    // The check itself.
    let tree = tree("-p relight-lab")?;
    for name in PAPER.iter().chain(&tools) {
        assert!(tree.contains(name), "lab has no {name}");
    }
    Ok(())
}
