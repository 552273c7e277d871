//! What a point sees.

use egui::{Color32, Pos2, Rect, Sense, Stroke, Ui, Vec2};

use crate::app::Viewer;

/// Side of the map, points.
const SIDE: f32 = 240.0;
/// Lights that are drawn.
const MOST_LIGHTS: usize = 32;

pub fn show(ui: &mut Ui, viewer: &mut Viewer) {
    ui.checkbox(&mut viewer.inspecting, "Look at what is clicked");
    // The light may have turned.
    if viewer.inspecting && viewer.playing {
        viewer.inspect();
    }
    let Some((inspection, texture)) = &viewer.inspection else {
        ui.weak("click a point: bright is what it sees, dark what is blocked; the normal is in the middle");
        return;
    };
    let (response, painter) = ui.allocate_painter(Vec2::splat(SIDE), Sense::hover());
    let rect = response.rect;
    let whole = Rect::from_min_max(Pos2::ZERO, Pos2::new(1.0, 1.0));
    painter.image(texture.id(), rect, whole, Color32::WHITE);
    let at = |[x, y]: [f32; 2]| rect.center() + 0.5 * SIDE * Vec2::new(x, -y);
    for [from, to] in &inspection.spokes {
        painter.line_segment([at(*from), at(*to)], Stroke::new(1.5, Color32::YELLOW));
    }
    for (place, amplitude) in inspection.lights.iter().take(MOST_LIGHTS) {
        let light = *amplitude / amplitude.max_element().max(f32::MIN_POSITIVE);
        let [r, g, b] = light.to_array().map(|value| (255.0 * value) as u8);
        painter.circle(
            at(*place),
            3.5,
            Color32::from_rgb(r, g, b),
            Stroke::new(1.0, Color32::BLACK),
        );
    }
    let normal = inspection.normal;
    ui.label(format!(
        "normal {:.2} {:.2} {:.2}",
        normal.x, normal.y, normal.z
    ));
    let seen: Vec<f32> = (inspection.distances.iter().copied())
        .filter(|d| !d.is_nan())
        .collect();
    let visible = seen.iter().filter(|distance| **distance > 0.0).count();
    let part = 100.0 * visible as f32 / seen.len().max(1) as f32;
    ui.label(format!(
        "{part:.0} % of the disc is visible; spokes of the brightest light in yellow"
    ));
}
