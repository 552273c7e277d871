//! What a point of a surface sees: its SSDF, the boundary of it, lights and spokes.

use std::f32::consts::{FRAC_PI_2, TAU};

use glam::Vec3;
use relight_format::Scene;
use relight_runtime::SphericalGaussian;
use relight_shading::polar::{self, PolarOptions};
use relight_shading::ssdf::{Basis, SignedDistance as _, Ssdf};

use crate::pick::Hit;

/// Steps at which the boundary is looked for along a spoke.
const STEPS: u32 = 64;

/// The hemisphere above a point, drawn as a disc: the zenith is the shading normal, in the middle;
/// radius is proportional to the angle from it.
#[derive(Clone, Debug)]
pub struct Inspection {
    /// Texels per side of `distances`.
    pub side: u32,
    /// Radians to the boundary, + visible, − blocked; NaN outside the disc. Row 0 is up.
    pub distances: Vec<f32>,
    /// Farthest distance that is told, radians.
    pub limit: f32,
    /// Lights above the horizon: place on the disc, in [−1, 1]², and colour, brightest first.
    pub lights: Vec<([f32; 2], Vec3)>,
    /// Spokes about the brightest light: on the disc, from where to where it is visible along
    /// each.
    pub spokes: Vec<[[f32; 2]; 2]>,
    /// World space.
    pub normal: Vec3,
}

/// Looks up from a point. `lights` are turned as they light it; `side` is of the map.
pub fn inspect(
    scene: &Scene,
    basis: &Basis,
    hit: &Hit,
    lights: &[SphericalGaussian],
    side: u32,
) -> Inspection {
    let triangle = &scene.triangles[hit.triangle];
    let normal = (triangle.vertices.iter().zip(hit.weights.to_array()))
        .map(|(vertex, weight)| weight * Vec3::from(scene.vertices[*vertex as usize].normal))
        .sum::<Vec3>()
        .normalize_or(Vec3::Y);
    // North of the disc is up, or away where the surface is level.
    let up = if normal.y.abs() < 0.99 {
        Vec3::Y
    } else {
        Vec3::NEG_Z
    };
    let right = up.cross(normal).normalize();
    let up = normal.cross(right);
    let field = Ssdf::interpolate(scene, basis, hit.triangle, hit.weights);
    let direction = |[x, y]: [f32; 2]| {
        let radius = x.hypot(y);
        let (sine, cosine) = (radius * FRAC_PI_2).sin_cos();
        let scale = if radius > 0.0 { sine / radius } else { 0.0 };
        scale * (x * right + y * up) + cosine * normal
    };
    let place = |direction: Vec3| {
        let (x, y) = (direction.dot(right), direction.dot(up));
        let radius = direction.dot(normal).clamp(-1.0, 1.0).acos() / FRAC_PI_2;
        let scale = radius / x.hypot(y).max(f32::MIN_POSITIVE);
        [x * scale, y * scale]
    };
    let texel = |index: u32| {
        let at = |i: u32| 2.0 * (i as f32 + 0.5) / side as f32 - 1.0;
        let point = [at(index % side), -at(index / side)];
        if point[0].hypot(point[1]) > 1.0 {
            return f32::NAN;
        }
        field.distance(direction(point))
    };
    let power = |light: &SphericalGaussian| {
        (light.amplitude.element_sum() / light.sharpness.max(1.0)) * light.axis.dot(normal).max(0.0)
    };
    let mut above: Vec<&SphericalGaussian> = (lights.iter())
        .filter(|light| light.axis.dot(normal) > 0.0)
        .collect();
    above.sort_by(|a, b| power(b).total_cmp(&power(a)));
    let spokes = above.first().map_or_else(Vec::new, |light| {
        // Where the lobe falls to a hundredth, as in `polar`.
        let radius = (1.0 + polar::CUT.ln() / light.sharpness)
            .clamp(-1.0, 1.0)
            .acos();
        spokes(&field, light.axis, radius)
            .into_iter()
            .map(|ends| ends.map(place))
            .collect()
    });
    Inspection {
        side,
        distances: (0..side * side).map(texel).collect(),
        limit: field.limit(),
        lights: (above.iter())
            .map(|light| (place(light.axis), light.amplitude))
            .collect(),
        spokes,
        normal,
    }
}

/// The visible stretches of spokes about an axis, as directions.
fn spokes(field: &Ssdf, axis: Vec3, radius: f32) -> Vec<[Vec3; 2]> {
    let (tangent, bitangent) = axis.any_orthonormal_pair();
    let count = PolarOptions::STANDARD.spokes;
    let mut stretches = Vec::new();
    for spoke in 0..count {
        let azimuth = TAU * (spoke as f32 + polar::PHASE) / count as f32;
        let outward = azimuth.cos() * tangent + azimuth.sin() * bitangent;
        let at = |angle: f32| angle.cos() * axis + angle.sin() * outward;
        let mut from = None;
        for step in 0..=STEPS {
            let angle = radius * step as f32 / STEPS as f32;
            let visible = field.distance(at(angle)) > 0.0;
            match (visible, from) {
                (true, None) => from = Some(angle),
                (false, Some(start)) => {
                    stretches.push([at(start), at(angle)]);
                    from = None;
                }
                _ => {}
            }
        }
        stretches.extend(from.map(|start| [at(start), at(radius)]));
    }
    stretches
}

/// The map as RGBA8: visible directions bright, blocked ones dark, the boundary white, with a line
/// every tenth of a radian.
pub fn picture(inspection: &Inspection) -> Vec<u8> {
    let texel = |distance: &f32| -> [u8; 4] {
        if distance.is_nan() {
            return [0; 4];
        }
        let side = std::f32::consts::PI / inspection.side as f32;
        if distance.abs() < side {
            return [255; 4];
        }
        let depth = (distance.abs() / inspection.limit).min(1.0);
        let line = (10.0 * distance.abs()).fract() < 10.0 * side;
        let strength = if line { 0.75 } else { 1.0 } * (1.0 - 0.6 * depth);
        let base = if *distance > 0.0 {
            [120.0, 190.0, 255.0]
        } else {
            [150.0, 70.0, 40.0]
        };
        let [r, g, b] = base.map(|value| (value * strength) as u8);
        [r, g, b, 255]
    };
    inspection.distances.iter().flat_map(texel).collect()
}
