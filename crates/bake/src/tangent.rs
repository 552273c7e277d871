//! Tangent frames for vertices that come without one.
//!
//! A frame is (tangent, bitangent, normal) with bitangent = `cross(normal, tangent) * w`.
//! Where texture coordinates exist the tangent points along increasing u and the bitangent
//! along decreasing v: "up" in an image whose row 0 is at v = 0.

use glam::{Vec2, Vec3};
use relight_format::Vertex;

/// The part of `tangent` orthogonal to the unit `normal`, normalised; `None` if there is none.
pub fn orthogonal(normal: Vec3, tangent: Vec3) -> Option<Vec3> {
    (tangent - normal * normal.dot(tangent)).try_normalize()
}

/// A tangent that runs around the vertical axis, as the grooves of a turned part do; smooth
/// everywhere except at the poles.
pub fn around_axis(normal: Vec3) -> Vec3 {
    let around = Vec3::Y.cross(normal).try_normalize().unwrap_or(Vec3::X);
    orthogonal(normal, around).unwrap_or_else(|| normal.any_orthonormal_vector())
}

/// Sets every tangent to [`around_axis`].
pub fn set_around_axis(vertices: &mut [Vertex]) {
    for vertex in vertices {
        vertex.tangent = around_axis(vertex.normal.into()).extend(1.0).into();
    }
}

/// Sets every tangent to the area-weighted mean of ∂p/∂u over the vertex's triangles.
pub fn set_from_uv(vertices: &mut [Vertex], triangles: &[[u32; 3]]) {
    let mut along_u = vec![Vec3::ZERO; vertices.len()];
    let mut against_v = vec![Vec3::ZERO; vertices.len()];
    for triangle in triangles {
        let [a, b, c] = triangle.map(|index| vertices[index as usize]);
        let [p, q, r] = [a, b, c].map(|vertex| Vec3::from(vertex.position));
        let [u, v, w] = [a, b, c].map(|vertex| Vec2::from(vertex.uv));
        let (pq, pr, uv, uw) = (q - p, r - p, v - u, w - u);
        // Only the direction of ∂p/∂u is wanted, so the determinant enters by its sign.
        let sign = uv.perp_dot(uw).signum();
        let area = pq.cross(pr).length();
        let du = ((pq * uw.y - pr * uv.y) * sign).normalize_or_zero() * area;
        let dv = ((pr * uv.x - pq * uw.x) * sign).normalize_or_zero() * area;
        for index in triangle {
            along_u[*index as usize] += du;
            against_v[*index as usize] -= dv;
        }
    }
    for ((vertex, along_u), against_v) in vertices.iter_mut().zip(along_u).zip(against_v) {
        let normal = Vec3::from(vertex.normal);
        vertex.tangent = match orthogonal(normal, along_u) {
            Some(tangent) => {
                let flipped = normal.cross(tangent).dot(against_v) < 0.0;
                tangent.extend(if flipped { -1.0 } else { 1.0 }).into()
            }
            None => around_axis(normal).extend(1.0).into(),
        };
    }
}

/// Sets every tangent as MikkTSpace does (Mikkelsen 2008), which normal maps are baked for.
/// Vertices whose triangles disagree are split.
pub fn set_mikktspace(vertices: &mut Vec<Vertex>, triangles: &mut [[u32; 3]]) {
    let mut geometry = Corners {
        vertices,
        triangles,
        tangents: vec![[0.0; 4]; triangles.len() * 3],
    };
    // A refusal leaves all tangents zero, which the loop below replaces.
    let _ = mikktspace::generate_tangents(&mut geometry);
    let tangents = geometry.tangents;
    let mut split = std::collections::HashMap::new();
    let mut assigned = vec![false; vertices.len()];
    for (corner, given) in tangents.into_iter().enumerate() {
        let index = &mut triangles[corner / 3][corner % 3];
        let old = *index as usize;
        let normal = Vec3::from(vertices[old].normal);
        let [x, y, z, w] = given;
        let tangent = match orthogonal(normal, Vec3::new(x, y, z)) {
            // The algorithm takes v to point up; ours points down.
            Some(tangent) => tangent.extend(-w).to_array(),
            None => around_axis(normal).extend(1.0).to_array(),
        };
        *index = *split.entry((old, tangent.map(f32::to_bits))).or_insert_with(|| {
            if std::mem::replace(&mut assigned[old], true) {
                vertices.push(Vertex { tangent, ..vertices[old] });
                vertices.len() as u32 - 1
            } else {
                vertices[old].tangent = tangent;
                old as u32
            }
        });
    }
}

struct Corners<'a> {
    vertices: &'a [Vertex],
    triangles: &'a [[u32; 3]],
    tangents: Vec<[f32; 4]>,
}

impl Corners<'_> {
    fn vertex(&self, face: usize, corner: usize) -> &Vertex {
        &self.vertices[self.triangles[face][corner] as usize]
    }
}

impl mikktspace::Geometry for Corners<'_> {
    fn num_faces(&self) -> usize {
        self.triangles.len()
    }

    fn num_vertices_of_face(&self, _face: usize) -> usize {
        3
    }

    fn position(&self, face: usize, corner: usize) -> [f32; 3] {
        self.vertex(face, corner).position
    }

    fn normal(&self, face: usize, corner: usize) -> [f32; 3] {
        self.vertex(face, corner).normal
    }

    fn tex_coord(&self, face: usize, corner: usize) -> [f32; 2] {
        self.vertex(face, corner).uv
    }

    fn set_tangent_encoded(&mut self, tangent: [f32; 4], face: usize, corner: usize) {
        self.tangents[face * 3 + corner] = tangent;
    }
}
