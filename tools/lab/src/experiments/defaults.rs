//! What `bake scene` makes when it is asked for nothing else.

use relight_runtime::{Frame, Method, PolarOptions};

use super::report::{Section, Table};
use super::{Laboratory, camera, percent_of};
use crate::compare::compare;

const SCENES: [&str; 3] = ["spot", "walk_1", "bunny"];
const ENVIRONMENTS: [&str; 3] = ["grace", "stpeters", "studio"];
const LOBES: usize = 16;

pub fn run(laboratory: &mut Laboratory, section: &mut Section) -> anyhow::Result<()> {
    section.text = vec![format!(
        "Scenes over a glossy plane, baked with the preset that the command names (`standard` unless \
         it does), under {LOBES} lobes of each environment, against truth with the same lobes. \
         `studio` is two small softboxes on black, whose shadows are the sharpest. FLIP is the mean."
    )];
    let mut table = Table::new(
        "defaults",
        "Errors of default assets",
        &[
            "scene",
            "asset, MB",
            "environment",
            "polar, %",
            "ambient, %",
            "FLIP of polar",
            "FLIP of ambient",
        ],
    );
    for scene_name in SCENES {
        let scene = laboratory.scene(scene_name)?;
        let bytes = relight_format::write_scene(&scene)?.len();
        for light_name in ENVIRONMENTS {
            let light = laboratory.light(light_name, LOBES)?;
            let frame = light.frame(camera(&scene)?);
            let truth = laboratory.truth(&scene, &frame)?;
            let mut found = |method| {
                let frame = Frame {
                    method,
                    ..frame.clone()
                };
                Ok::<_, anyhow::Error>(compare(&laboratory.draw(&scene, &frame)?, &truth)?)
            };
            let polar = found(Method::Polar(PolarOptions::STANDARD))?;
            let ambient = found(Method::Ambient)?;
            table.row([
                scene_name.into(),
                (bytes as f64 / 1e6).into(),
                light_name.into(),
                percent_of(&polar),
                percent_of(&ambient),
                polar.mean_flip.into(),
                ambient.mean_flip.into(),
            ]);
        }
    }
    section.tables.push(table);
    Ok(())
}
