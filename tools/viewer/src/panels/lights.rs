//! Lights inside the scene.

use egui::{DragValue, Ui};
use glam::Vec3;
use relight_runtime::{LocalLight, MAX_LOCAL_LIGHTS, Spot};
use relight_shading::camera::View;

use crate::app::Viewer;

pub fn show(ui: &mut Ui, viewer: &mut Viewer) {
    let position = place(viewer);
    let Some(document) = &mut viewer.document else {
        return;
    };
    let (low, high) = document.bounds;
    let size = (high - low).length();
    let lights = &mut document.local_lights;
    if lights.len() < MAX_LOCAL_LIGHTS as usize && ui.button("Add").clicked() {
        let radius = 0.02 * size;
        lights.push(LocalLight {
            position,
            radius,
            // As bright one scene's size away as a wall of radiance 1.
            radiance: Vec3::splat(0.5 * (size / radius).powi(2) / std::f32::consts::PI),
            spot: None,
        });
    }
    let mut removed = None;
    for (index, light) in lights.iter_mut().enumerate() {
        ui.push_id(index, |ui| {
            ui.separator();
            edit(ui, light, size);
            if ui.button("Remove").clicked() {
                removed = Some(index);
            }
        });
    }
    if let Some(index) = removed {
        lights.remove(index);
    }
    ui.weak("drag a light's handle in the picture to move it");
}

/// Where a light begins: half of the way to what is looked at, in the upper half of the picture, so
/// that its handle can be taken.
fn place(viewer: &Viewer) -> Vec3 {
    let [width, height] = viewer.size.map(|side| side.max(1));
    let view = View::new(&viewer.orbit.camera(), width, height, 1.0);
    let distance = 0.5 * (view.eye - viewer.orbit.target).length();
    let half = 0.5 * height as f32 * distance * view.down.length();
    view.eye.lerp(viewer.orbit.target, 0.5) - 0.5 * half * view.down.normalize_or_zero()
}

fn edit(ui: &mut Ui, light: &mut LocalLight, size: f32) {
    let speed = f64::from(size) * 0.005;
    ui.horizontal(|ui| {
        ui.label("at");
        for axis in 0..3 {
            ui.add(DragValue::new(&mut light.position[axis]).speed(speed));
        }
    });
    ui.horizontal(|ui| {
        ui.label("radius");
        let range = 1e-4 * size..=size;
        ui.add(
            DragValue::new(&mut light.radius)
                .speed(0.1 * speed)
                .range(range),
        );
        let brightest = light.radiance.max_element().max(1e-6);
        let mut color: [f32; 3] = (light.radiance / brightest).into();
        let mut strength = brightest;
        let colored = ui.color_edit_button_rgb(&mut color).changed();
        ui.label("radiance");
        let strong = ui
            .add(
                DragValue::new(&mut strength)
                    .speed(0.02 * brightest)
                    .range(0.0..=1e9),
            )
            .changed();
        if colored || strong {
            light.radiance = Vec3::from(color) * strength;
        }
    });
    let mut is_spot = light.spot.is_some();
    if ui.checkbox(&mut is_spot, "spot").changed() {
        light.spot = is_spot.then_some(Spot {
            direction: Vec3::NEG_Y,
            inner_angle: 0.3,
            outer_angle: 0.5,
        });
    }
    if let Some(spot) = &mut light.spot {
        let angle = |ui: &mut Ui, angle: &mut f32, name: &str, least: f32| {
            let mut degrees = angle.to_degrees();
            let slider = egui::Slider::new(&mut degrees, least..=90.0)
                .suffix("°")
                .text(name);
            if ui.add(slider).changed() {
                *angle = degrees.to_radians();
            }
        };
        angle(ui, &mut spot.inner_angle, "full within", 0.0);
        let least = spot.inner_angle.to_degrees() + 0.1;
        angle(ui, &mut spot.outer_angle, "none beyond", least.min(90.0));
        spot.outer_angle = spot.outer_angle.max(spot.inner_angle + 1e-3);
        ui.horizontal(|ui| {
            ui.label("towards");
            let mut direction = spot.direction;
            let mut changed = false;
            for axis in 0..3 {
                let value = DragValue::new(&mut direction[axis])
                    .speed(0.02)
                    .range(-1.0..=1.0);
                changed |= ui.add(value).changed();
            }
            if changed {
                spot.direction = direction.normalize_or(spot.direction);
            }
        });
    }
}
