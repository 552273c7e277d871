//! Surfaces that lie in one plane and face the same way: which of them is seen is chance.

use rayon::prelude::*;

use crate::mesh::Mesh;
use crate::visibility::places::{EXPOSURE_RESOLUTION, Exposure};
use crate::visibility::ray::RayCaster;

/// Most triangles that are looked at.
const PROBES: usize = 1 << 16;
/// Heights above a surface, in diagonals of the mesh, that pictures and rays do not tell from none.
const SAME_HEIGHT: f32 = 1e-6;
/// Cosine of the angle between planes that are the same, but for rounding.
const SAME_PLANE: f32 = 0.999_99;
/// Part of all surface from which it is said.
const VISIBLE: f64 = 0.001;

/// A warning where middles of triangles lie on triangles of another material. `caster` casts at the triangles of `mesh`.
pub(super) fn warning(mesh: &Mesh, caster: &RayCaster) -> Option<String> {
    let height = SAME_HEIGHT * mesh.diagonal();
    let exposure = || Exposure::new(EXPOSURE_RESOLUTION);
    let step = mesh.triangles.len().div_ceil(PROBES).max(1);
    let probed: Vec<(f64, bool)> = (mesh.triangles.par_iter().step_by(step))
        .map_init(exposure, |exposure, triangle| {
            let [a, b, c] = mesh.corners(triangle);
            let across = (b - a).cross(c - a);
            let normal = across.normalize_or_zero();
            let above = (a + b + c) / 3.0 + height * normal;
            let crossings = caster.crossings(above, -normal, 2.0 * height);
            // Of the same material or not, facing the same way or the other.
            let there_is = |same: bool, side: f32| {
                crossings.iter().any(|crossing| {
                    let material = mesh.triangles[crossing.triangle].material;
                    (material == triangle.material) == same
                        && side * crossing.normal.dot(normal) > SAME_PLANE
                })
            };
            // Of what stands on a floor the bottom is never seen from within, and seldom from below.
            let mut sees_both_ways = || {
                exposure.sees(caster, above, normal)
                    && exposure.sees(caster, above - 2.0 * height * normal, -normal)
            };
            let overlaps = there_is(false, 1.0) && (!there_is(true, -1.0) || sees_both_ways());
            (f64::from(across.length()), overlaps)
        })
        .collect();
    let area: f64 = probed.iter().map(|(area, _)| area).sum();
    let overlaps = probed.iter().filter(|(_, overlaps)| *overlaps);
    let part = overlaps.map(|(area, _)| area).sum::<f64>() / area.max(f64::MIN_POSITIVE);
    (part > VISIBLE).then(|| {
        format!(
            "{:.1} % of all surface lies in the plane of a surface of another material that faces the same way: which \
             of them is seen is chance; move one a little in front of the other",
            100.0 * part
        )
    })
}

#[cfg(test)]
mod tests {
    use glam::{Vec2, Vec3};

    use super::*;
    use crate::import::plain_material;
    use crate::mesh::{Triangle, Vertex};

    /// A wall of 4 m and a picture of 1 m so far in front of it, facing it or as it does.
    fn walls(front: f32, turned: bool) -> Mesh {
        let mut mesh = Mesh::default();
        let surface = relight_format::Surface::DiffuseSpecular {
            diffuse: [0.5; 3],
            specular: relight_format::Specular::None,
        };
        mesh.materials = ["wall", "picture"]
            .map(|name| plain_material(name, surface.clone()))
            .into();
        for (material, size, z) in [(0, 4.0, 0.0), (1, 1.0, front)] {
            let first = mesh.vertices.len() as u32;
            let corners = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]];
            mesh.vertices.extend(corners.map(|[x, y]| Vertex {
                position: Vec3::new(size * (x - 0.4), size * (y - 0.3), z),
                normal: Vec3::Z,
                tangent: Vec3::X,
                bitangent_sign: 1.0,
                uv: Vec2::ZERO,
                second_uv: Vec2::ZERO,
            }));
            for mut vertices in [[0, 1, 2], [0, 2, 3]] {
                if turned && material == 1 {
                    vertices.swap(1, 2);
                }
                let vertices = vertices.map(|vertex| first + vertex);
                mesh.triangles.push(Triangle { vertices, material });
            }
        }
        mesh
    }

    #[test]
    fn what_lies_within_a_box_of_two_sides_is_not_meant() {
        let mut mesh = walls(0.0, false);
        // The picture has a back, and a hood over it.
        let first = mesh.vertices.len() as u32 - 4;
        let hood = mesh.vertices[first as usize..].to_vec();
        mesh.vertices.extend(hood.iter().map(|vertex| Vertex {
            position: vertex.position + 1e-3 * Vec3::Z,
            ..*vertex
        }));
        let add = |mesh: &mut Mesh, corners: [u32; 3]| {
            let vertices = corners.map(|corner| first + corner);
            let material = 1;
            mesh.triangles.push(Triangle { vertices, material });
        };
        for corners in [[0, 2, 1], [0, 3, 2]] {
            add(&mut mesh, corners);
        }
        let lit = warning(&mesh, &RayCaster::new(&mesh.soup()));
        assert!(lit.is_some());
        for corners in [[4, 5, 6], [4, 6, 7]] {
            add(&mut mesh, corners);
        }
        for i in 0..4 {
            let next = (i + 1) % 4;
            add(&mut mesh, [i, next, 4 + next]);
            add(&mut mesh, [i, 4 + next, 4 + i]);
        }
        assert_eq!(warning(&mesh, &RayCaster::new(&mesh.soup())), None);
    }

    #[test]
    fn pictures_within_a_wall_are_told_from_those_on_it() {
        for (front, turned, warns) in [
            (0.0, false, true),
            (1e-6, false, true),
            (1e-3, false, false),
            (0.0, true, false),
        ] {
            let mesh = walls(front, turned);
            let warning = warning(&mesh, &RayCaster::new(&mesh.soup()));
            assert_eq!(warning.is_some(), warns, "{front} {turned}: {warning:?}");
            assert!(warning.is_none_or(|text| text.starts_with("5.9 %")));
        }
    }
}
