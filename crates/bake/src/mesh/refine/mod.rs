//! Divides a mesh until no edge is longer than it may be there, so that visibility, which lives
//! at vertices, is sampled finely enough.

mod pierced;
mod wrong;

use std::collections::HashMap;

use glam::Vec3;
use rayon::prelude::*;

use super::{Mesh, Triangle, Vertex};

pub(crate) use pierced::{Cuts, cut_where_pierced};
pub(crate) use wrong::{Bound, refine as refine_wrong};

/// Both ends of an edge, bit by bit, the lesser first.
type Key = [[u32; 3]; 2];

fn key(a: Vec3, b: Vec3) -> Key {
    // Adding zero turns −0 into +0.
    let [a, b] = [a, b].map(|end| (end + Vec3::ZERO).to_array().map(f32::to_bits));
    if a <= b { [a, b] } else { [b, a] }
}

/// Halves edges whose `length` is above 1 until none is left, or until another round would give
/// more than `max_vertices` vertices, which adds a warning. `length` is that between two ends, in
/// any order, in lengths that an edge may have there.
///
/// Whether and where an edge is cut depends on its two end positions alone, and not on their
/// order, so triangles that meet at an edge cut it alike even if they share no vertex there:
/// the mesh gets no crack and no T-junction. A triangle with one, two or three cut edges
/// becomes two, three or four. New vertices hold plain averages, normals included, so that
/// interpolation across a triangle gives what it gave before.
pub fn refine(
    mut mesh: Mesh,
    length: impl Fn(Vec3, Vec3) -> f32 + Sync,
    max_vertices: usize,
) -> Mesh {
    // Coarse triangles shrink by half per round, so rounds are few.
    loop {
        let lengths = long_edges(&mesh, &length);
        if lengths.is_empty() {
            return mesh;
        }
        let room = max_vertices.saturating_sub(mesh.vertices.len());
        if lengths.len() <= room {
            divide(&mut mesh, |a, b| cut(a, b, length(a, b) > 1.0));
            continue;
        }
        // Spend what is left on the longest edges. Edges of one length are cut together or
        // not at all, or neighbours would disagree.
        let bound = lengths[room];
        if lengths[0] > bound {
            divide(&mut mesh, |a, b| cut(a, b, length(a, b) > bound));
        }
        let left = long_edges(&mesh, &length);
        mesh.warnings.push(format!(
            "refinement stopped at {} of at most {max_vertices} vertices; of {} edges left that are \
             too long for what stands there, one is {:.1} times as long as it should be",
            mesh.vertices.len(),
            left.len(),
            left.first().unwrap_or(&0.0),
        ));
        return mesh;
    }
}

/// The point where an edge that is `long` is cut, or `None`. Symmetric in its ends to the last
/// bit.
fn cut(a: Vec3, b: Vec3, long: bool) -> Option<Vec3> {
    let middle = (a + b) * 0.5;
    // Near the resolution of f32 the middle may be one of the ends.
    (long && middle != a && middle != b).then_some(middle)
}

/// Lengths above 1 of edges to cut, longest first, one per pair of vertex indices: as many as
/// cutting them adds vertices.
fn long_edges(mesh: &Mesh, length: &(impl Fn(Vec3, Vec3) -> f32 + Sync)) -> Vec<f32> {
    let position = |index: u32| mesh.vertices[index as usize].position;
    let long = |[a, b]: [u32; 2]| {
        let [from, to] = [a.min(b), a.max(b)];
        let length = length(position(a), position(b));
        cut(position(a), position(b), length > 1.0).map(|_| ([from, to], length))
    };
    let mut edges: Vec<([u32; 2], f32)> = (mesh.triangles.par_iter())
        .flat_map_iter(|triangle| sides(triangle.vertices).into_iter().filter_map(long))
        .collect();
    edges.sort_unstable_by_key(|&(edge, _)| edge);
    edges.dedup_by_key(|(edge, _)| *edge);
    let mut lengths: Vec<f32> = edges.into_iter().map(|(_, length)| length).collect();
    lengths.sort_unstable_by(|a, b| b.total_cmp(a));
    lengths
}

/// The sides of a triangle, each from one corner to the next.
pub(super) fn sides<T: Copy>([a, b, c]: [T; 3]) -> [[T; 2]; 3] {
    [[a, b], [b, c], [c, a]]
}

/// One round: cuts edges where `cut`, which does not depend on the order of the ends, says.
/// Returns the new vertex of every edge that was cut.
fn divide(mesh: &mut Mesh, cut: impl Fn(Vec3, Vec3) -> Option<Vec3>) -> HashMap<[u32; 2], u32> {
    let mut middles: HashMap<[u32; 2], u32> = HashMap::new();
    let mut triangles = Vec::with_capacity(mesh.triangles.len() * 2);
    let vertices = &mut mesh.vertices;
    for &Triangle {
        vertices: corners,
        material,
    } in &mesh.triangles
    {
        let mut middle = |a: u32, b: u32| {
            let (first, second) = (vertices[a as usize], vertices[b as usize]);
            let position = cut(first.position, second.position)?;
            Some(*middles.entry([a.min(b), a.max(b)]).or_insert_with(|| {
                vertices.push(between(&first, &second, position));
                vertices.len() as u32 - 1
            }))
        };
        let [a, b, c] = corners;
        let halves = [middle(a, b), middle(b, c), middle(c, a)];
        // Turn the triangle so that its cut edges come first.
        let turned = match halves {
            [None, Some(_), _] => 1,
            [Some(_) | None, None, Some(_)] => 2,
            _ => 0,
        };
        let [a, b, c] = [0, 1, 2].map(|i| corners[(i + turned) % 3]);
        let position = |index: u32| vertices[index as usize].position;
        let cut_up: &[[u32; 3]] = match [0, 1, 2].map(|i| halves[(i + turned) % 3]) {
            [None, ..] => &[[a, b, c]],
            [Some(ab), None, _] => &[[a, ab, c], [ab, b, c]],
            [Some(ab), Some(bc), None] => {
                // The shorter diagonal of the quadrangle that is left.
                if position(a).distance(position(bc)) <= position(ab).distance(position(c)) {
                    &[[ab, b, bc], [a, ab, bc], [a, bc, c]]
                } else {
                    &[[ab, b, bc], [a, ab, c], [ab, bc, c]]
                }
            }
            [Some(ab), Some(bc), Some(ca)] => {
                &[[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]
            }
        };
        triangles.extend(
            cut_up
                .iter()
                .map(|&vertices| Triangle { vertices, material }),
        );
    }
    mesh.triangles = triangles;
    middles
}

/// What is at a position on the edge between two vertices.
fn between(a: &Vertex, b: &Vertex, position: Vec3) -> Vertex {
    let edge = b.position - a.position;
    let part = if position == (a.position + b.position) * 0.5 {
        0.5
    } else {
        ((position - a.position).dot(edge) / edge.length_squared()).clamp(0.0, 1.0)
    };
    Vertex {
        position,
        normal: a.normal * (1.0 - part) + b.normal * part,
        tangent: a.tangent * (1.0 - part) + b.tangent * part,
        bitangent_sign: a.bitangent_sign,
        uv: a.uv * (1.0 - part) + b.uv * part,
        second_uv: a.second_uv * (1.0 - part) + b.second_uv * part,
    }
}

#[cfg(test)]
mod tests {
    use std::collections::{HashMap, HashSet};

    use glam::Vec2;

    use super::*;

    /// Areas and interpolated values go through about ten halvings, each rounded once.
    const TOLERANCE: f32 = 1e-5;

    /// Edges may be of the same length everywhere, metres.
    fn even(max_edge: f32) -> impl Fn(Vec3, Vec3) -> f32 {
        move |a, b| a.distance(b) / max_edge
    }

    fn vertex(position: Vec3) -> Vertex {
        Vertex {
            position,
            normal: position.normalize_or(Vec3::Y),
            tangent: Vec3::X,
            bitangent_sign: -1.0,
            uv: Vec2::new(position.x * 3.0 - position.y, position.z + 0.25),
            second_uv: Vec2::new(position.z - position.x, position.y),
        }
    }

    /// An irregular octahedron whose eight faces share no vertex.
    pub(super) fn soup() -> Mesh {
        let [x, y, z] = [1.3f32, 0.37, 2.1];
        let mut mesh = Mesh::default();
        for octant in 0..8u16 {
            let sign = |bit: u16| if octant >> bit & 1 == 0 { 1.0 } else { -0.61 };
            let corners = [
                Vec3::X * x * sign(0),
                Vec3::Y * y * sign(1),
                Vec3::Z * z * sign(2),
            ];
            let base = mesh.vertices.len() as u32;
            mesh.vertices.extend(corners.map(vertex));
            let flipped = (octant.count_ones() % 2) as usize;
            let mut vertices = [base, base + 1, base + 2];
            vertices.swap(1, 1 + flipped);
            mesh.triangles.push(Triangle {
                vertices,
                material: octant,
            });
        }
        mesh
    }

    fn bits(vertex: &Vertex) -> [u32; 3] {
        vertex.position.to_array().map(|x| (x + 0.0).to_bits())
    }

    fn areas(mesh: &Mesh) -> HashMap<u16, f32> {
        let mut areas = HashMap::new();
        for triangle in &mesh.triangles {
            let [a, b, c] = mesh.corners(triangle);
            *areas.entry(triangle.material).or_default() += (b - a).cross(c - a).length() * 0.5;
        }
        areas
    }

    pub(super) fn assert_closed(mesh: &Mesh) {
        let mut edges: HashMap<_, i32> = HashMap::new();
        let positions: HashSet<_> = mesh.vertices.iter().map(bits).collect();
        for triangle in &mesh.triangles {
            let corners = triangle.vertices.map(|index| mesh.vertices[index as usize]);
            for (a, b) in [(0, 1), (1, 2), (2, 0)] {
                let (a, b) = (&corners[a], &corners[b]);
                *edges.entry((bits(a), bits(b))).or_default() += 1;
                *edges.entry((bits(b), bits(a))).or_default() -= 1;
                let middle = (a.position + b.position) * 0.5;
                assert!(
                    !positions.contains(&bits(&vertex(middle))),
                    "a vertex lies in the middle of the edge {a:?} {b:?}"
                );
            }
        }
        assert!(
            edges.values().all(|count| *count == 0),
            "an edge has no partner"
        );
    }

    #[test]
    fn neighbours_without_common_vertices_stay_joined() {
        assert_closed(&soup());
        for max_edge in [1.5, 0.7, 0.3, 0.05] {
            let mesh = refine(soup(), even(max_edge), usize::MAX);
            assert_closed(&mesh);
            assert!(mesh.warnings.is_empty());
            for triangle in &mesh.triangles {
                let [a, b, c] = mesh.corners(triangle);
                let longest = a.distance(b).max(b.distance(c)).max(c.distance(a));
                assert!(longest <= max_edge, "{longest} is above {max_edge}");
            }
        }
    }

    #[test]
    fn area_material_and_attributes_are_kept() {
        let mesh = refine(soup(), even(0.1), usize::MAX);
        assert_same_surface(&mesh);
    }

    /// That a mesh is [`soup`] divided: areas, materials and what vertices hold.
    pub(super) fn assert_same_surface(mesh: &Mesh) {
        let after = areas(mesh);
        let before = areas(&soup());
        assert_eq!(before.len(), after.len());
        for (material, area) in before {
            assert!((after[&material] / area - 1.0).abs() < TOLERANCE);
        }
        for triangle in &mesh.triangles {
            let base = 3 * usize::from(triangle.material);
            let face = &soup().vertices[base..base + 3];
            for index in triangle.vertices {
                // The face's corners lie on the axes, so coordinates are barycentrics.
                let found = mesh.vertices[index as usize];
                let normal: Vec3 = (0..3)
                    .map(|axis| {
                        let weight = found.position[axis] / face[axis].position[axis];
                        face[axis].normal * weight
                    })
                    .sum();
                assert!(normal.distance(found.normal) < TOLERANCE);
                let expected = vertex(found.position);
                assert!(expected.uv.distance(found.uv) < TOLERANCE);
                assert!(expected.second_uv.distance(found.second_uv) < TOLERANCE);
                assert_eq!(found.tangent, expected.tangent);
            }
        }
    }

    #[test]
    fn orientation_is_kept() {
        let mesh = refine(soup(), even(0.2), usize::MAX);
        for triangle in &mesh.triangles {
            let [a, b, c] = mesh.corners(triangle);
            assert!((b - a).cross(c - a).dot(a + b + c) > 0.0);
        }
    }

    #[test]
    fn the_vertex_bound_holds_and_leaves_no_crack() {
        for bound in [0, 24, 31, 100, 1000] {
            let mesh = refine(soup(), even(0.05), bound);
            assert!(
                mesh.vertices.len() <= bound.max(24),
                "{} of {bound}",
                mesh.vertices.len()
            );
            assert_eq!(mesh.warnings.len(), 1);
            assert_closed(&mesh);
        }
        // What is left of the bound goes to the longest edges.
        assert!(refine(soup(), even(0.05), 31).vertices.len() > 24);
    }

    #[test]
    fn nothing_happens_to_short_edges_or_to_edges_that_cannot_be_halved() {
        assert_eq!(refine(soup(), even(10.0), usize::MAX), soup());
        let mut tiny = soup();
        let up = |x: f32| f32::from_bits(x.to_bits() + 1);
        tiny.triangles.truncate(1);
        tiny.vertices[0].position = Vec3::splat(1e6);
        tiny.vertices[1].position = Vec3::new(up(1e6), 1e6, 1e6);
        tiny.vertices[2].position = Vec3::new(1e6, up(1e6), 1e6);
        let refined = refine(tiny.clone(), even(1e-9), usize::MAX);
        assert!(refined.triangles.len() < 100);
    }
}
