//! Fig. 9: where a half-space stands for a concave occluder too little is blocked, for a convex
//! one too much.

use relight_runtime::Frame;

use super::report::{Section, Table};
use super::{Laboratory, METHODS, camera, difference, percent_of};
use crate::compare::compare;
use crate::image_file::Image;

/// Of the difference pictures.
const SCALE: f32 = 4.0;

pub fn run(laboratory: &mut Laboratory, section: &mut Section) -> anyhow::Result<()> {
    section.text = vec![
        "A teapot (concave: handle, spout, rim) and a duck (mostly convex) over glossy planes, \
         in place of the paper's bird and turtle, 16 lobes per environment, against truth with \
         the same lobes."
            .to_owned(),
    ];
    let mut table = Table::new(
        "occluders",
        "Errors of shadows",
        &[
            "scene",
            "environment",
            "method",
            "relative RMSE, %",
            "mean FLIP",
            "energy over truth's",
        ],
    );
    for scene_name in ["teapot", "duck"] {
        let scene = laboratory.scene(scene_name)?;
        for light_name in ["grace", "stpeters"] {
            let light = laboratory.light(light_name, 16)?;
            let frame = light.frame(camera(&scene)?);
            let truth = laboratory.truth(&scene, &frame)?;
            let mut images = Vec::new();
            for (name, method) in METHODS {
                let frame = Frame {
                    method,
                    ..frame.clone()
                };
                let image = laboratory.draw(&scene, &frame)?;
                let found = compare(&image, &truth)?;
                table.row([
                    scene_name.into(),
                    light_name.into(),
                    name.into(),
                    percent_of(&found),
                    found.mean_flip.into(),
                    found.energy_ratio.into(),
                ]);
                images.push(image);
            }
            let differences: Vec<Image> = (images.iter())
                .map(|image| difference(image, &truth, SCALE))
                .collect();
            let mut shown: Vec<&Image> = images.iter().collect();
            shown.push(&truth);
            let name = format!("{scene_name}-{light_name}");
            let caption = format!("{scene_name}, {light_name}: ambient, cells, polar, truth");
            laboratory.strip(section, &name, &caption, &shown)?;
            let mut shown: Vec<&Image> = differences.iter().collect();
            shown.push(&truth);
            let caption = format!(
                "{scene_name}, {light_name}: {SCALE} times the differences of ambient, cells and \
                 polar to truth; truth"
            );
            laboratory.strip(section, &format!("{name}-difference"), &caption, &shown)?;
        }
    }
    section.tables.push(table);
    Ok(())
}
