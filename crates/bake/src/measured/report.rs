//! A picture of a fit: a sphere under two distant lamps, of the table, of the lobes, and
//! their difference.

use glam::Vec3;

use super::Table;
use super::fit::{Fit, as_shaded};
use crate::report::picture::png;

/// Pixels per side of each of the three pictures.
const SIZE: u32 = 320;
/// Directions and irradiances of the lamps: one over the shoulder, one that grazes.
const LAMPS: [(Vec3, f32); 2] = [
    (Vec3::new(-0.45, 0.55, 0.7), 3.0),
    (Vec3::new(0.95, 0.2, -0.25), 2.0),
];
/// Differences are shown this much brighter.
const DIFFERENCE_GAIN: f32 = 2.0;

/// 8-bit sRGB PNG, side by side: table, lobes as the runtime evaluates them, absolute
/// difference (doubled).
pub fn sphere(table: &Table, fit: &Fit) -> Result<Vec<u8>, image::ImageError> {
    let appearance = fit.appearance();
    let mut pixels = vec![[0.0; 3]; (3 * SIZE * SIZE) as usize];
    for y in 0..SIZE {
        for x in 0..SIZE {
            let at = |i: u32| ((i as f32 + 0.5) / SIZE as f32 * 2.0 - 1.0) * 1.05;
            let (x_plane, y_plane) = (at(x), -at(y));
            let square = 1.0 - x_plane * x_plane - y_plane * y_plane;
            if square <= 0.0 {
                continue;
            }
            let normal = Vec3::new(x_plane, y_plane, square.sqrt());
            let (tangent, bitangent) = normal.any_orthonormal_pair();
            let local = |w: Vec3| Vec3::new(w.dot(tangent), w.dot(bitangent), w.dot(normal));
            let view = local(Vec3::Z);
            let shaded = as_shaded(&appearance, view);
            let (mut exact, mut fitted) = (Vec3::ZERO, Vec3::ZERO);
            for (direction, irradiance) in LAMPS {
                let light = local(direction.normalize());
                if light.z <= 0.0 {
                    continue;
                }
                let flux = light.z * irradiance;
                exact += table.evaluate(light, view).max(Vec3::ZERO) * flux;
                fitted += shaded(light) * flux;
            }
            let difference = (fitted - exact).abs() * DIFFERENCE_GAIN;
            for (panel, color) in [exact, fitted, difference].into_iter().enumerate() {
                pixels[((y * 3 + panel as u32) * SIZE + x) as usize] = color.to_array();
            }
        }
    }
    png(3 * SIZE, SIZE, &pixels, 1.0)
}
