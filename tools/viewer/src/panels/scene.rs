//! The scene: what it is and how well it is baked.

use egui::Ui;

use crate::app::Viewer;
use crate::state::Quality;

pub fn show(ui: &mut Ui, viewer: &mut Viewer) {
    let Some(document) = &viewer.document else {
        ui.weak("none yet");
        return;
    };
    let scene = &document.scene;
    ui.strong(&scene.name);
    ui.label(format!(
        "{} vertices, {} triangles, {} materials",
        scene.vertices.len(),
        scene.triangles.len(),
        scene.materials.len()
    ));
    let error = scene.report.errors.surface;
    ui.label(format!("visibility boundaries off by {error:.4} rad"));
    let Some(quality) = document.quality else {
        ui.weak("an asset, as it was baked");
        return;
    };
    ui.label(format!("baked: {}", quality.name()));
    ui.horizontal(|ui| {
        ui.label("up to");
        for wanted in Quality::ALL {
            ui.selectable_value(&mut viewer.settings.quality, wanted, wanted.name());
        }
    });
    #[cfg(not(target_family = "wasm"))]
    if ui.button("Bake again").clicked() {
        viewer.bake_again();
    }
}
