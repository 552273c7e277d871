//! A picture of a fit: a sphere under two distant lamps, of the table, of the lobes, and
//! their difference.

use glam::Vec3;
use relight_shading::accuracy::local_point;
use relight_shading::brdf::specular_lobes;

use super::Table;
use super::fit::Fit;

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
    let mut pixels = vec![0u8; (SIZE * SIZE * 9) as usize];
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
            let point = local_point(appearance, view);
            let gaussians: Vec<_> = appearance
                .reflections()
                .flat_map(|reflection| specular_lobes(&point, reflection).as_slice().to_vec())
                .collect();
            let (mut exact, mut fitted) = (Vec3::ZERO, Vec3::ZERO);
            for (direction, irradiance) in LAMPS {
                let light = local(direction.normalize());
                if light.z <= 0.0 {
                    continue;
                }
                let flux = light.z * irradiance;
                exact += table.evaluate(light, view).max(Vec3::ZERO) * flux;
                let specular: Vec3 = gaussians.iter().map(|lobe| lobe.evaluate(light)).sum();
                fitted += (specular + appearance.diffuse * std::f32::consts::FRAC_1_PI) * flux;
            }
            let difference = (fitted - exact).abs() * DIFFERENCE_GAIN;
            for (panel, color) in [exact, fitted, difference].into_iter().enumerate() {
                let start = ((y * 3 + panel as u32) * SIZE + x) as usize * 3;
                pixels[start..start + 3].copy_from_slice(&encode(color));
            }
        }
    }
    let mut file = Vec::new();
    image::ImageEncoder::write_image(
        image::codecs::png::PngEncoder::new(&mut file),
        &pixels,
        3 * SIZE,
        SIZE,
        image::ExtendedColorType::Rgb8,
    )?;
    Ok(file)
}

/// Highlights compressed (Reinhard et al. 2002, on each channel), then sRGB.
fn encode(radiance: Vec3) -> [u8; 3] {
    radiance.to_array().map(|value| {
        let linear = value / (1.0 + value);
        let encoded = if linear <= 0.003_130_8 {
            12.92 * linear
        } else {
            1.055 * linear.powf(1.0 / 2.4) - 0.055
        };
        (encoded * 255.0).round() as u8
    })
}
