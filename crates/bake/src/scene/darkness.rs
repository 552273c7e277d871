//! Scenes that little light of an environment gets into.

use glam::Vec3;
use rayon::prelude::*;
use relight_format::math;

use crate::mesh::Mesh;
use crate::visibility::ray::RayCaster;

/// Triangles that are looked at, about.
const PROBES: usize = 2048;
/// Directions looked in from each.
const RAYS: usize = 32;
/// Mean part of light from everywhere below which errors of what is left of it show.
const DIM: f64 = 0.25;

/// A warning if the distance is seen from nearly nowhere, or little of it; `origin` tells where rays from a triangle begin.
pub(super) fn warning(
    mesh: &Mesh,
    origin: &(impl Fn(usize) -> Vec3 + Sync),
    caster: &RayCaster,
) -> Option<String> {
    let step = (mesh.triangles.len() / PROBES).max(1);
    let looked_at: Vec<usize> = (0..mesh.triangles.len()).step_by(step).collect();
    // Area, and of light from everywhere the part that arrives, at most.
    let seen = |&triangle: &usize| {
        let [a, b, c] = mesh.corners(&mesh.triangles[triangle]);
        let area = (b - a).cross(c - a);
        let face = area.normalize_or_zero();
        let origin = origin(triangle);
        let [mut open, mut all] = [0.0, 0.0];
        for ray in 0..RAYS {
            // Spread over the sphere by the golden angle.
            let y = (2.0 * ray as f32 + 1.0) / RAYS as f32 - 1.0;
            let (sin, cos) = math::sin_cos(2.399_963_f32 * ray as f32);
            let around = (1.0 - y * y).max(0.0).sqrt();
            let direction = Vec3::new(around * cos, y, around * sin);
            let cosine = face.dot(direction);
            all += cosine.abs();
            if !caster.any_hit(origin, direction * cosine.signum()) {
                open += cosine.abs();
            }
        }
        [area.length(), open / all.max(f32::MIN_POSITIVE)]
    };
    let seen: Vec<[f32; 2]> = looked_at.par_iter().map(seen).collect();
    let lit = seen.iter().filter(|[_, part]| *part > 0.0).count();
    if lit * 50 < seen.len() {
        return Some(format!(
            "the distance is seen from {lit} of {} points on fronts of triangles: an environment \
             hardly lights this scene; a closed room needs lights or openings, and a mesh whose \
             triangles face inwards must be turned about in the program that made it",
            seen.len()
        ));
    }
    let (light, area) = seen.iter().fold((0.0, 0.0), |(light, all), [area, part]| {
        (light + f64::from(area * part), all + f64::from(*area))
    });
    let part = light / area;
    (part < DIM).then(|| {
        format!(
            "of light from everywhere {:.0} % arrives at the surface, on average: errors show {:.0} times as \
             much as out in the open; compare with `lab truth`, and draw with high quality",
            100.0 * part,
            1.0 / part
        )
    })
}

#[cfg(test)]
mod tests {
    use glam::Vec2;

    use super::*;
    use crate::mesh::{Triangle, Vertex};

    /// The warning of so many faces of a box that look inwards, its last face the lid, each divided into triangles.
    fn told(faces: usize) -> Option<String> {
        const PARTS: u32 = 8;
        let mut mesh = Mesh::default();
        let sides = [
            Vec3::NEG_Y,
            Vec3::X,
            Vec3::NEG_X,
            Vec3::Z,
            Vec3::NEG_Z,
            Vec3::Y,
        ];
        for outwards in sides.into_iter().take(faces) {
            let (u, v) = (-outwards).any_orthonormal_pair();
            for (row, column) in (0..PARTS).flat_map(|row| (0..PARTS).map(move |i| (row, i))) {
                let first = mesh.vertices.len() as u32;
                for [x, y] in [[0, 0], [1, 0], [1, 1], [0, 1]] {
                    let at = |part: u32| 2.0 * part as f32 / PARTS as f32 - 1.0;
                    mesh.vertices.push(Vertex {
                        position: outwards + at(column + x) * u + at(row + y) * v,
                        normal: -outwards,
                        tangent: u,
                        bitangent_sign: 1.0,
                        uv: Vec2::ZERO,
                        second_uv: Vec2::ZERO,
                    });
                }
                for corners in [[0, 1, 2], [0, 2, 3]] {
                    mesh.triangles.push(Triangle {
                        vertices: corners.map(|corner| first + corner),
                        material: 0,
                    });
                }
            }
        }
        let middle = |triangle: usize| {
            let corners = mesh.corners(&mesh.triangles[triangle]);
            let face = (corners[1] - corners[0]).cross(corners[2] - corners[0]);
            assert!(face.dot(corners[0]) < 0.0, "faces look inwards");
            corners.iter().sum::<Vec3>() / 3.0 + 1e-4 * face.normalize()
        };
        warning(&mesh, &middle, &RayCaster::new(&mesh.soup()))
    }

    #[test]
    fn a_floor_is_light_a_box_without_its_lid_dim_and_a_closed_one_dark() {
        assert_eq!(told(1), None);
        // A fifth of what leaves the lid arrives at each of the others.
        let dim = told(5).unwrap();
        let part: f32 = (dim.split_whitespace().nth(4).unwrap().parse()).unwrap();
        assert!((part - 20.0).abs() <= 2.0, "{dim}");
        assert!(told(6).unwrap().contains("is seen from 0 of"));
    }
}
