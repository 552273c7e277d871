//! How light is integrated, what is beside it, and what it costs.

use egui::Ui;

use crate::app::Viewer;
use crate::compose;
use crate::state::{Integrator, Layout};

pub fn show(ui: &mut Ui, viewer: &mut Viewer) {
    let layout = viewer.settings.layout;
    let names = if layout == Layout::One {
        &["shown"][..]
    } else {
        &["left", "right"]
    };
    for (pane, name) in names.iter().enumerate() {
        let chosen = &mut viewer.settings.integrators[pane];
        egui::ComboBox::from_label(*name)
            .selected_text(chosen.name())
            .show_ui(ui, |ui| {
                for integrator in Integrator::ALL {
                    ui.selectable_value(chosen, *integrator, integrator.name());
                }
            });
    }
    let bounces =
        (viewer.document.as_ref()).is_some_and(|document| document.scene.transfer.is_some());
    if bounces {
        ui.checkbox(&mut viewer.settings.bounce, "Light that bounces");
    }
    if layout == Layout::Difference {
        let scale = &mut viewer.settings.difference_scale;
        ui.add(
            egui::Slider::new(scale, 1.0..=256.0)
                .logarithmic(true)
                .text("scale"),
        );
    }
    if let [Some(a), Some(b)] = &viewer.pictures
        && layout != Layout::One
        && let Some(difference) = compose::relative_difference(&a.image, &b.image)
    {
        ui.label(format!(
            "relative RMSE of left against right {:.2} %",
            100.0 * difference
        ));
    }
    ui.add(
        egui::Slider::new(&mut viewer.settings.resolution, 0.25..=1.0)
            // Less may be set by hand, for devices that are slower still.
            .clamping(egui::SliderClamping::Edits)
            .text("pixels per pixel"),
    );
    for (pane, name) in names.iter().enumerate() {
        let Some(picture) = &viewer.pictures[pane] else {
            continue;
        };
        let milliseconds =
            |time: std::time::Duration| format!("{:.1} ms", 1e3 * time.as_secs_f64());
        egui::Grid::new(("times", pane)).show(ui, |ui| {
            let mut row = |name: &str, value: String| {
                ui.label(name);
                ui.label(value);
                ui.end_row();
            };
            row(
                name,
                format!("{}×{}", picture.image.width, picture.image.height),
            );
            row("picture", milliseconds(picture.time));
            if let Some(passes) = picture.passes {
                row("visibility buffer", milliseconds(passes.visibility_buffer));
                row("shade", milliseconds(passes.shade));
                row("tone map", milliseconds(passes.tonemap));
            }
            if picture.samples > 0 {
                row("samples", picture.samples.to_string());
            }
        });
    }
}
