//! The picture, and what pointer and keys do to it.

use egui::{Color32, CornerRadius, Key, PointerButton, Pos2, Rect, Sense, Stroke, Ui, Vec2};
use glam::Vec3;
use relight_shading::camera::View;

use crate::app::Viewer;
use crate::panels;
use crate::pick;
use crate::state::{Background, Integrator, Layout};

/// Distance from the divider within which it is caught, points.
const DIVIDER_REACH: f32 = 8.0;
/// Radius of a light's handle, points.
const HANDLE: f32 = 9.0;
/// Turn of one press of an arrow key, fraction of the picture's height.
const KEY_STEP: f32 = 0.04;
/// Near plane of views that only map points, metres: any will do.
const NEAR: f32 = 1e-3;

/// Draws the newest pixels and takes input.
pub fn show(ui: &mut Ui, viewer: &mut Viewer) {
    let rect = ui.available_rect_before_wrap();
    let scale = ui.ctx().pixels_per_point() * viewer.settings.resolution;
    viewer.size = [rect.width(), rect.height()].map(|side| ((side * scale).round() as u32).max(1));
    let response = ui.interact(
        rect,
        ui.scope_id().with("viewport"),
        Sense::click_and_drag(),
    );
    response
        .widget_info(|| egui::WidgetInfo::labeled(egui::Role::Image, true, "picture of the scene"));
    let painter = ui.painter_at(rect);
    if viewer.settings.background == Background::Transparent {
        painter.rect_filled(rect, CornerRadius::ZERO, Color32::from_gray(70));
    } else {
        painter.rect_filled(rect, CornerRadius::ZERO, Color32::from_gray(24));
    }
    if let Some(texture) = &viewer.texture
        && viewer.document.is_some()
    {
        let whole = Rect::from_min_max(Pos2::ZERO, Pos2::new(1.0, 1.0));
        painter.image(texture.id(), rect, whole, Color32::WHITE);
    }
    if viewer.document.is_none() {
        let what = (viewer.jobs.running().first()).map_or_else(
            || "drop a scene, a mesh or an image here".to_owned(),
            |job| format!("{}: {}", job.name, job.status().stage),
        );
        let font = egui::FontId::proportional(18.0);
        painter.text(
            rect.center(),
            egui::Align2::CENTER_CENTER,
            what,
            font,
            Color32::from_gray(170),
        );
    }
    if !ui.input(|input| input.raw.hovered_files.is_empty()) {
        let stroke = Stroke::new(3.0, ui.visuals().selection.bg_fill);
        painter.rect_stroke(rect.shrink(2.0), 6.0, stroke, egui::StrokeKind::Inside);
    }
    // What lies over the picture catches the pointer first.
    let handled = light_handles(ui, viewer, rect) | divider(ui, viewer, rect);
    if !handled {
        pointer(ui, viewer, rect, &response);
    }
    if !ui.ctx().egui_wants_keyboard_input() {
        keys(ui, viewer, rect);
    }
    labels(ui, viewer, rect);
    panels::notices(ui, viewer, rect);
}

fn pointer(ui: &Ui, viewer: &mut Viewer, rect: Rect, response: &egui::Response) {
    let drag = response.drag_delta() / rect.height().max(1.0);
    let modifiers = ui.input(|input| input.modifiers);
    // Two fingers move the scene and pinch it; the pointer that egui makes of the first is not meant.
    let fingers = ui.input(egui::InputState::multi_touch);
    if let Some(touch) = fingers {
        if rect.contains(touch.center_pos) {
            let moved = touch.translation_delta / rect.height().max(1.0);
            viewer.orbit = viewer.orbit.panned(moved.x, moved.y, rect.aspect_ratio());
            viewer.orbit = viewer.orbit.dollied(touch.zoom_delta);
        }
        return;
    }
    if response.dragged() {
        let primary = response.dragged_by(PointerButton::Primary);
        if primary && (modifiers.ctrl || modifiers.command) {
            viewer.turn.yaw += 4.0 * drag.x;
            viewer.turn.pitch = (viewer.turn.pitch + 4.0 * drag.y).clamp(-1.5, 1.5);
        } else if primary && !modifiers.shift {
            viewer.orbit = viewer.orbit.turned(drag.x, drag.y);
        } else {
            viewer.orbit = viewer.orbit.panned(drag.x, drag.y, rect.aspect_ratio());
        }
    }
    if response.hovered() {
        let (scroll, zoom) = ui.input(|input| (input.smooth_scroll_delta(), input.zoom_delta()));
        if modifiers.shift {
            // egui has turned the wheel of a mouse sideways; two fingers move as they are.
            let [x, y] = [scroll.x, scroll.y].map(|side| side / rect.height().max(1.0));
            viewer.orbit = viewer.orbit.panned(x, y, rect.aspect_ratio());
        } else {
            let factor = zoom * (scroll.y / 300.0).exp();
            if factor != 1.0 {
                viewer.orbit = viewer.orbit.dollied(factor);
            }
        }
    }
    if let Some(at) = response.interact_pointer_pos()
        && (response.clicked() || response.double_clicked())
    {
        click(viewer, rect, at);
        if response.double_clicked() {
            frame_selection(viewer, rect);
        }
    }
}

/// Selects what lies under the pointer, and looks at its visibility where that is wanted.
fn click(viewer: &mut Viewer, rect: Rect, at: Pos2) {
    let view = view(viewer, rect);
    let inspecting = viewer.inspecting;
    let Some(document) = &mut viewer.document else {
        return;
    };
    let from = at - rect.min;
    let hit = pick::pick(&document.scene, &view, from.x, from.y);
    document.selected = hit.map(|hit| usize::from(document.scene.triangles[hit.triangle].material));
    if inspecting {
        document.inspected = hit;
        viewer.inspect();
    }
}

/// Moves the camera to where it sees all of the selected material, or of the scene.
pub fn frame_selection(viewer: &mut Viewer, rect: Rect) {
    if let Some(document) = &viewer.document {
        let (low, high) = (document.selected)
            .and_then(|material| pick::bounds(&document.scene, Some(material)))
            .unwrap_or(document.bounds);
        viewer.orbit = viewer.orbit.framing(low, high, rect.aspect_ratio());
    }
}

fn view(viewer: &Viewer, rect: Rect) -> View {
    let size = [rect.width(), rect.height()].map(|side| (side as u32).max(1));
    View::new(&viewer.orbit.camera(), size[0], size[1], NEAR)
}

fn keys(ui: &Ui, viewer: &mut Viewer, rect: Rect) {
    let pressed = |key| ui.input(|input| input.key_pressed(key) && !input.modifiers.any());
    for (key, x, y) in [
        (Key::ArrowLeft, -KEY_STEP, 0.0),
        (Key::ArrowRight, KEY_STEP, 0.0),
        (Key::ArrowUp, 0.0, KEY_STEP),
        (Key::ArrowDown, 0.0, -KEY_STEP),
    ] {
        if pressed(key) {
            viewer.orbit = viewer.orbit.turned(x, y);
        }
    }
    if pressed(Key::Plus) || pressed(Key::Equals) {
        viewer.orbit = viewer.orbit.dollied(1.1);
    }
    if pressed(Key::Minus) {
        viewer.orbit = viewer.orbit.dollied(1.0 / 1.1);
    }
    if pressed(Key::F) {
        frame_selection(viewer, rect);
    }
    if pressed(Key::Space) {
        viewer.playing = !viewer.playing;
    }
    for (key, turn) in [(Key::OpenBracket, -0.1), (Key::CloseBracket, 0.1)] {
        if pressed(key) {
            viewer.turn.yaw += turn;
        }
    }
    if pressed(Key::I) {
        viewer.set_inspecting(!viewer.inspecting);
    }
    if pressed(Key::P) {
        viewer.settings.panels = !viewer.settings.panels;
    }
    if pressed(Key::S) {
        viewer.settings.layout = match viewer.settings.layout {
            Layout::One => Layout::Split,
            Layout::Split => Layout::Difference,
            Layout::Difference => Layout::One,
        };
    }
    let numbers = [
        Key::Num1,
        Key::Num2,
        Key::Num3,
        Key::Num4,
        Key::Num5,
        Key::Num6,
    ];
    for (key, integrator) in numbers.into_iter().zip(Integrator::ALL) {
        if pressed(key) {
            viewer.settings.integrators[0] = *integrator;
        }
    }
}

/// The line between two pictures; whether the pointer has it.
fn divider(ui: &Ui, viewer: &mut Viewer, rect: Rect) -> bool {
    if viewer.settings.layout != Layout::Split {
        return false;
    }
    let x = rect.left() + viewer.settings.divider * rect.width();
    let area = Rect::from_x_y_ranges(x - DIVIDER_REACH..=x + DIVIDER_REACH, rect.y_range());
    let response = ui
        .interact(area, ui.scope_id().with("divider"), Sense::drag())
        .on_hover_and_drag_cursor(egui::CursorIcon::ResizeHorizontal);
    response.widget_info(|| egui::WidgetInfo::labeled(egui::Role::Slider, true, "divider"));
    if response.dragged() {
        let moved = response.drag_delta().x / rect.width().max(1.0);
        viewer.settings.divider = (viewer.settings.divider + moved).clamp(0.0, 1.0);
    }
    let painter = ui.painter_at(rect);
    painter.vline(x, rect.y_range(), Stroke::new(2.0, Color32::WHITE));
    painter.circle_filled(Pos2::new(x, rect.center().y), 7.0, Color32::WHITE);
    response.hovered() || response.dragged()
}

/// A handle for every light in the scene, which moves it parallel to the picture; whether the
/// pointer has one.
fn light_handles(ui: &Ui, viewer: &mut Viewer, rect: Rect) -> bool {
    let view = view(viewer, rect);
    let outward = viewer.orbit.outward();
    let Some(document) = &mut viewer.document else {
        return false;
    };
    let mut handled = false;
    for (index, light) in document.local_lights.iter_mut().enumerate() {
        let Some((at, per_point)) = project(&view, rect, outward, light.position) else {
            continue;
        };
        let area = Rect::from_center_size(at, Vec2::splat(2.0 * HANDLE));
        let response = ui.interact(area, ui.scope_id().with(("light", index)), Sense::drag());
        let name = format!("handle of light {}", index + 1);
        response.widget_info(|| egui::WidgetInfo::labeled(egui::Role::Slider, true, &name));
        if response.dragged() {
            let drag = response.drag_delta();
            light.position += drag.x * per_point * view.right.normalize_or_zero()
                + drag.y * per_point * view.down.normalize_or_zero();
        }
        let brightest = light.radiance.max_element().max(f32::MIN_POSITIVE);
        let [r, g, b] = (light.radiance / brightest)
            .to_array()
            .map(|value| (255.0 * value) as u8);
        let painter = ui.painter_at(rect);
        let width = if response.hovered() { 3.0 } else { 1.5 };
        painter.circle(
            at,
            HANDLE - 2.0,
            Color32::from_rgb(r, g, b),
            Stroke::new(width, Color32::BLACK),
        );
        painter.circle_stroke(at, HANDLE, Stroke::new(1.0, Color32::WHITE));
        handled |= response.hovered() || response.dragged();
    }
    handled
}

/// Where a point is on the screen, and metres per point of it there; `None` behind the camera.
fn project(view: &View, rect: Rect, outward: Vec3, position: Vec3) -> Option<(Pos2, f32)> {
    let clip = view.view_projection * position.extend(1.0);
    if clip.w <= 0.0 {
        return None;
    }
    let place = Vec2::new(0.5 + 0.5 * clip.x / clip.w, 0.5 - 0.5 * clip.y / clip.w);
    let depth = (view.eye - position).dot(outward);
    Some((rect.min + place * rect.size(), depth * view.down.length()))
}

/// Names of the pictures, how far they are, and what keys do.
fn labels(ui: &Ui, viewer: &Viewer, rect: Rect) {
    let painter = ui.painter_at(rect);
    let font = egui::FontId::proportional(13.0);
    let text = |at: Pos2, align: egui::Align2, text: String| {
        let galley = painter.layout_no_wrap(text, font.clone(), Color32::WHITE);
        let area = align.anchor_size(at, galley.size());
        painter.rect_filled(
            area.expand2(Vec2::new(5.0, 2.0)),
            4.0,
            Color32::from_black_alpha(140),
        );
        painter.galley(area.min, galley, Color32::WHITE);
    };
    let name = |pane: usize| {
        let integrator = viewer.settings.integrators[pane];
        let Some(picture) = &viewer.pictures[pane] else {
            return integrator.name().to_owned();
        };
        let size = [picture.image.width, picture.image.height];
        if picture.draft {
            format!("{}, draft {}×{}", integrator.name(), size[0], size[1])
        } else if integrator == Integrator::Truth && picture.samples > 0 {
            format!("{}, {} samples", integrator.name(), picture.samples)
        } else if size == viewer.size {
            integrator.name().to_owned()
        } else {
            format!("{}, {}×{}", integrator.name(), size[0], size[1])
        }
    };
    if viewer.document.is_none() {
        return;
    }
    let corner = rect.left_top() + Vec2::new(12.0, 10.0);
    let other = rect.right_top() + Vec2::new(-12.0, 10.0);
    match viewer.settings.layout {
        Layout::One => text(corner, egui::Align2::LEFT_TOP, name(0)),
        Layout::Split => {
            text(corner, egui::Align2::LEFT_TOP, name(0));
            text(other, egui::Align2::RIGHT_TOP, name(1));
        }
        Layout::Difference => {
            let scale = viewer.settings.difference_scale;
            let what = format!("|{} − {}| × {scale}", name(0), name(1));
            text(corner, egui::Align2::LEFT_TOP, what);
        }
    }
}
