//! Distant light: which, how turned, how fitted, what is behind the scene.

use egui::{Color32, Sense, Stroke, Ui, Vec2};
use glam::{Mat3, Vec3};

use crate::app::Viewer;
use crate::dialog::Purpose;
use crate::state::Background;

/// Side of the globe, points.
const GLOBE: f32 = 150.0;
/// Radii of dots, points, of the sharpest and the widest lobes.
const DOTS: (f32, f32) = (2.0, 14.0);

pub fn show(ui: &mut Ui, viewer: &mut Viewer) {
    ui.horizontal(|ui| {
        ui.strong(&viewer.light.name);
        if ui.button("Open…").clicked() {
            viewer.choose(&Purpose::Open);
        }
    });
    let report = &viewer.light.environment.report;
    ui.label(format!(
        "{} lobes, relative L2 error {:.3}",
        viewer.light.lobes.len(),
        report.relative_l2
    ));
    ui.horizontal(|ui| {
        ui.add(
            egui::Slider::new(&mut viewer.settings.lobes, 0..=256)
                .logarithmic(true)
                .custom_formatter(|lobes, _| match lobes as usize {
                    0 => "as it takes".to_owned(),
                    lobes => lobes.to_string(),
                })
                .text("lobes"),
        );
        if ui.button("Fit").clicked() {
            viewer.fit_again();
        }
    });
    let degrees = |angle: &mut f32, text: &str, ui: &mut Ui| {
        let mut shown = angle.to_degrees();
        let changed = ui
            .add(
                egui::Slider::new(&mut shown, -180.0..=180.0)
                    .suffix("°")
                    .text(text),
            )
            .changed();
        if changed {
            *angle = shown.to_radians();
        }
    };
    let turn = &mut viewer.turn;
    turn.yaw =
        (turn.yaw + std::f32::consts::PI).rem_euclid(std::f32::consts::TAU) - std::f32::consts::PI;
    degrees(&mut turn.yaw, "turn", ui);
    degrees(&mut turn.pitch, "tilt", ui);
    ui.add(
        egui::Slider::new(&mut viewer.settings.light_speed, -3.0..=3.0).text("rad/s when playing"),
    );
    globe(ui, viewer);
    ui.horizontal(|ui| {
        ui.label("behind");
        for background in Background::ALL {
            ui.selectable_value(
                &mut viewer.settings.background,
                background,
                background.name(),
            );
        }
    });
    ui.checkbox(
        &mut viewer.settings.image_reflections,
        "Reflect the image, not its lobes",
    );
}

/// Lobes as dots on a globe seen from the camera; dragging turns the light.
fn globe(ui: &mut Ui, viewer: &mut Viewer) {
    let (response, painter) = ui.allocate_painter(Vec2::splat(GLOBE), Sense::drag());
    response.widget_info(|| egui::WidgetInfo::labeled(egui::Role::Slider, true, "globe of lights"));
    if response.dragged() {
        let drag = response.drag_delta() / GLOBE;
        viewer.turn.yaw += 3.0 * drag.x;
        viewer.turn.pitch = (viewer.turn.pitch + 3.0 * drag.y).clamp(-1.5, 1.5);
    }
    let (center, radius) = (response.rect.center(), 0.5 * GLOBE - DOTS.1);
    painter.circle(
        center,
        radius,
        Color32::from_gray(16),
        Stroke::new(1.0, Color32::from_gray(90)),
    );
    let outward = viewer.orbit.outward();
    let right = viewer.orbit.up.cross(outward).normalize_or(Vec3::X);
    let up = outward.cross(right);
    let rotation = Mat3::from_quat(viewer.turn.rotation());
    let mut lobes: Vec<_> = (viewer.light.lobes.iter())
        .map(|lobe| (rotation * lobe.axis, lobe.sharpness, lobe.amplitude))
        .collect();
    // Those behind first.
    lobes.sort_by(|a, b| a.0.dot(outward).total_cmp(&b.0.dot(outward)));
    for (axis, sharpness, amplitude) in lobes {
        let at = center + radius * Vec2::new(axis.dot(right), -axis.dot(up));
        let dot = (0.5 * radius / sharpness.max(1.0).sqrt()).clamp(DOTS.0, DOTS.1);
        let light = amplitude / (1.0 + amplitude.max_element());
        let [r, g, b] = light
            .to_array()
            .map(|value| (255.0 * value.max(0.0).powf(0.45)) as u8);
        let front = axis.dot(outward) >= 0.0;
        let alpha = if front { 230 } else { 70 };
        painter.circle_filled(at, dot, Color32::from_rgba_unmultiplied(r, g, b, alpha));
        painter.circle_stroke(
            at,
            dot,
            Stroke::new(0.5, Color32::from_white_alpha(alpha / 2)),
        );
    }
}
