//! `lab demo`: the whole path, small.

use libtest_mimic::Trial;
use serde_json::Value;

use crate::cli::expect_success;
use crate::support::{Outcome, binary};

/// Truth samples per pixel, all over its square; their noise is taken off.
const SAMPLES: &str = "64";
/// What `polar` may be off by. What it cannot do better is representation, interpolation,
/// lobes at the horizon and, most in a picture as small, four samples of silhouettes; a wrong picture is off
/// by tens of percent.
const POLAR_RELATIVE_RMSE: f64 = 0.1;
/// How far its sum of radiance may be from the truth's: 3 %.
const POLAR_ENERGY: std::ops::Range<f64> = 0.97..1.03;

pub fn trials() -> Vec<Trial> {
    vec![Trial::test(
        "demo::polar_beats_ambient",
        polar_beats_ambient,
    )]
}

fn polar_beats_ambient() -> Outcome {
    let folder = tempfile::tempdir()?;
    let mut demo = binary("lab");
    demo.args(["demo", "--json", "--device", "cpu", "--size", "96x72"]);
    demo.args(["--samples", SAMPLES, "--out"])
        .arg(folder.path());
    let output = expect_success(&mut demo);
    let report: Value = serde_json::from_slice(&output.stdout)?;
    let number = |method: &str, measure: &str| {
        report[method][measure]
            .as_f64()
            .unwrap_or_else(|| panic!("{method} {measure}: {report}"))
    };
    let [polar, ambient] =
        ["polar", "ambient"].map(|method| number(method, "relative_rmse_corrected"));
    assert!(polar < POLAR_RELATIVE_RMSE, "{report}");
    assert!(polar < ambient, "{report}");
    assert!(
        POLAR_ENERGY.contains(&number("polar", "energy_ratio")),
        "{report}"
    );
    let triptych = image::open(report["triptych"].as_str().expect("a path"))?;
    assert!(
        triptych.width() >= 3 * 96 && triptych.height() >= 72,
        "three pictures"
    );
    for asset in ["scene", "environment"] {
        let path = report[asset].as_str().expect("a path");
        expect_success(binary("bake").arg("validate").arg(path));
    }
    Ok(())
}
