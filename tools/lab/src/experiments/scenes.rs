//! Table 1: five scenes with the paper's reflection models.

use relight_runtime::{Frame, twin};

use super::report::{Section, Table};
use super::{Laboratory, METHODS, camera, percent_of};
use crate::compare::compare;
use crate::image_file::Image;

/// Scene, environment, reflection of object and ground.
const ROWS: [(&str, &str, &str); 5] = [
    ("teapot", "grace", "Blinn-Phong"),
    ("bunny", "grace", "measured, Ward"),
    ("spot", "stpeters", "Ward, Cook-Torrance"),
    ("duck", "stpeters", "measured and stain, GGX"),
    ("walk_1", "grace", "Ashikhmin-Shirley, Phong"),
];

pub fn run(laboratory: &mut Laboratory, section: &mut Section) -> anyhow::Result<()> {
    section.text = vec![
        "Every scene over a glossy plane that its shadow falls on, 16 lobes per environment. \
         `Integrals` are lobes (ambient, polar) or groups of lobes (cells) that are integrated \
         over what is visible of them. Seconds are those of the shading pass where the device \
         tells, else of the frame; errors are against truth with the same lobes."
            .to_owned(),
    ];
    let mut table = Table::new(
        "scenes",
        "Five scenes, three methods",
        &[
            "scene",
            "reflection",
            "environment",
            "pixels",
            "vertices",
            "asset, MB",
            "method",
            "integrals per pixel",
            "samples per pixel",
            "seconds",
            "frames/s",
            "time over ambient",
            "relative RMSE, %",
            "error over ambient",
            "mean FLIP",
        ],
    );
    let [width, height] = laboratory.settings.size;
    for (scene_name, light_name, reflection) in ROWS {
        let scene = laboratory.scene(scene_name)?;
        let bytes = relight_format::write_scene(&scene)?.len();
        let light = laboratory.light(light_name, 16)?;
        let frame = light.frame(camera(&scene)?);
        let truth = laboratory.truth(&scene, &frame)?;
        let mut images = Vec::new();
        let mut ambient = None;
        for (name, method) in METHODS {
            let frame = Frame {
                method,
                ..frame.clone()
            };
            let timed = laboratory.time(&scene, &frame)?;
            let work = twin::work(&scene, &frame, width, height)?;
            let pixels = work.pixels.max(1) as f64;
            let found = compare(&timed.image, &truth)?;
            let (seconds, error) = (timed.shading.as_secs_f64(), found.noiseless());
            let (base_seconds, base_error) = *ambient.get_or_insert((seconds, error));
            table.row([
                scene_name.into(),
                reflection.into(),
                light_name.into(),
                pixels.into(),
                scene.vertices.len().into(),
                (bytes as f64 / 1e6).into(),
                name.into(),
                (work.integrals as f64 / pixels).into(),
                (work.samples as f64 / pixels).into(),
                seconds.into(),
                (1.0 / seconds).into(),
                (seconds / base_seconds).into(),
                percent_of(&found),
                (error / base_error).into(),
                found.mean_flip.into(),
            ]);
            images.push(timed.image);
        }
        let mut shown: Vec<&Image> = images.iter().collect();
        shown.push(&truth);
        let caption =
            format!("{scene_name}, {reflection}, {light_name}: ambient, cells, polar, truth");
        laboratory.strip(section, scene_name, &caption, &shown)?;
    }
    section.tables.push(table);
    Ok(())
}
