//! Exposure and tone curve; turntables.

use egui::Ui;
use relight_shading::tonemap;

use crate::app::Viewer;
#[cfg(not(target_family = "wasm"))]
use crate::dialog::Purpose;
use crate::state::Curve;
#[cfg(not(target_family = "wasm"))]
use crate::turntable::{MAX_FRAMES, Turn};

pub fn show(ui: &mut Ui, viewer: &mut Viewer) {
    ui.horizontal(|ui| {
        ui.add(egui::Slider::new(&mut viewer.settings.exposure, -10.0..=10.0).text("stops"));
        if ui.button("Auto").clicked()
            && let Some(picture) = &viewer.pictures[0]
        {
            viewer.settings.exposure = tonemap::automatic_exposure(&picture.image.pixels);
        }
    });
    let curve = &mut viewer.settings.curve;
    egui::ComboBox::from_label("tone curve")
        .selected_text(curve.name())
        .show_ui(ui, |ui| {
            for choice in Curve::ALL {
                ui.selectable_value(curve, choice, choice.name());
            }
        });
}

/// What a turntable shall be; draws it once a folder is chosen.
#[cfg(not(target_family = "wasm"))]
pub fn turntable(ui: &mut Ui, viewer: &mut Viewer) {
    let options = &mut viewer.turntable;
    ui.horizontal(|ui| {
        ui.selectable_value(&mut options.turn, Turn::Light, "light");
        ui.selectable_value(&mut options.turn, Turn::Camera, "camera");
    });
    ui.add(
        egui::Slider::new(&mut options.frames, 1..=MAX_FRAMES)
            .logarithmic(true)
            .text("frames"),
    );
    ui.add(egui::Slider::new(&mut options.rate, 1..=60).text("frames per second"));
    ui.horizontal(|ui| {
        ui.add(egui::DragValue::new(&mut options.size[0]).range(16..=4096));
        ui.label("×");
        ui.add(egui::DragValue::new(&mut options.size[1]).range(16..=4096));
    });
    if ui.button("Draw into a folder…").clicked() {
        viewer.choose(&Purpose::SaveTurntable);
        ui.close();
    }
}
