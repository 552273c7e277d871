//! Divides a mesh until no edge is longer than a bound, so that visibility, which lives at
//! vertices, is sampled finely enough.

use std::collections::HashMap;

use glam::{Vec2, Vec3};
use relight_format::Vertex;

use crate::import::{ImportedTriangle, Mesh};

/// Halves edges longer than `max_edge` (metres) until none is left, or until another round
/// would give more than `max_vertices` vertices, which adds a warning.
///
/// Whether and where an edge is cut depends on its two end positions alone, and not on their
/// order, so triangles that meet at an edge cut it alike even if they share no vertex there:
/// the mesh gets no crack and no T-junction. A triangle with one, two or three cut edges
/// becomes two, three or four. New vertices hold plain averages, normals included, so that
/// interpolation across a triangle gives what it gave before.
pub fn refine(mut mesh: Mesh, max_edge: f32, max_vertices: usize) -> Mesh {
    // Coarse triangles shrink by half per round, so rounds are few.
    loop {
        let lengths = long_edges(&mesh, max_edge);
        if lengths.is_empty() {
            return mesh;
        }
        let room = max_vertices.saturating_sub(mesh.vertices.len());
        if lengths.len() <= room {
            divide(&mut mesh, max_edge);
            continue;
        }
        // Spend what is left on the longest edges. Edges of one length are cut together or
        // not at all, or neighbours would disagree.
        let bound = lengths[room];
        if lengths[0] > bound {
            divide(&mut mesh, bound);
        }
        let left = long_edges(&mesh, max_edge);
        mesh.warnings.push(format!(
            "refinement stopped at {} of at most {max_vertices} vertices; the longest of {} \
             edges left is {} m, the bound {max_edge} m",
            mesh.vertices.len(),
            left.len(),
            left.first().unwrap_or(&0.0),
        ));
        return mesh;
    }
}

/// The point where an edge longer than `bound` is cut, or `None`. Symmetric in its ends to
/// the last bit.
fn cut(a: Vec3, b: Vec3, bound: f32) -> Option<Vec3> {
    let middle = (a + b) * 0.5;
    // Near the resolution of f32 the middle may be one of the ends.
    (a.distance(b) > bound && middle != a && middle != b).then_some(middle)
}

/// Lengths of edges to cut, longest first, one per pair of vertex indices: as many as
/// cutting them adds vertices.
fn long_edges(mesh: &Mesh, max_edge: f32) -> Vec<f32> {
    let position = |index: u32| Vec3::from(mesh.vertices[index as usize].position);
    let mut edges: Vec<[u32; 2]> = mesh
        .triangles
        .iter()
        .flat_map(|triangle| {
            let [a, b, c] = triangle.vertices;
            [[a, b], [b, c], [c, a]]
        })
        .filter(|&[a, b]| cut(position(a), position(b), max_edge).is_some())
        .map(|[a, b]| [a.min(b), a.max(b)])
        .collect();
    edges.sort_unstable();
    edges.dedup();
    let mut lengths: Vec<f32> =
        edges.iter().map(|&[a, b]| position(a).distance(position(b))).collect();
    lengths.sort_unstable_by(|a, b| b.total_cmp(a));
    lengths
}

/// One round: cuts every edge longer than `bound`.
fn divide(mesh: &mut Mesh, bound: f32) {
    let mut middles: HashMap<[u32; 2], u32> = HashMap::new();
    let mut triangles = Vec::with_capacity(mesh.triangles.len() * 2);
    let vertices = &mut mesh.vertices;
    for &ImportedTriangle { vertices: corners, material } in &mesh.triangles {
        let mut middle = |a: u32, b: u32| {
            let (first, second) = (vertices[a as usize], vertices[b as usize]);
            let position = cut(first.position.into(), second.position.into(), bound)?;
            Some(*middles.entry([a.min(b), a.max(b)]).or_insert_with(|| {
                vertices.push(average(&first, &second, position));
                vertices.len() as u32 - 1
            }))
        };
        let [a, b, c] = corners;
        let halves = [middle(a, b), middle(b, c), middle(c, a)];
        // Turn the triangle so that its cut edges come first.
        let turned = match halves {
            [None, Some(_), _] => 1,
            [Some(_), None, Some(_)] | [None, None, Some(_)] => 2,
            _ => 0,
        };
        let [a, b, c] = [0, 1, 2].map(|i| corners[(i + turned) % 3]);
        let position = |index: u32| Vec3::from(vertices[index as usize].position);
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
            cut_up.iter().map(|&vertices| ImportedTriangle { vertices, material }),
        );
    }
    mesh.triangles = triangles;
}

fn average(a: &Vertex, b: &Vertex, position: Vec3) -> Vertex {
    let [x, y, z, sign] = a.tangent;
    let tangent = (Vec3::new(x, y, z) + Vec3::from_slice(&b.tangent[..3])) * 0.5;
    Vertex {
        position: position.into(),
        normal: ((Vec3::from(a.normal) + Vec3::from(b.normal)) * 0.5).into(),
        tangent: tangent.extend(sign).into(),
        uv: ((Vec2::from(a.uv) + Vec2::from(b.uv)) * 0.5).into(),
    }
}
