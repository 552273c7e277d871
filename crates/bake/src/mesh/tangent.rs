//! Tangent frames for vertices that come without one.
//!
//! A frame is (tangent, bitangent, normal) with bitangent = `cross(normal, tangent) * w`.
//! Where texture coordinates exist the tangent points along increasing u and the bitangent
//! along decreasing v: "up" in an image whose row 0 is at v = 0.

use glam::Vec3;

use super::Vertex;

/// The part of `tangent` orthogonal to the unit `normal`, normalised; `None` if there is none.
pub(crate) fn orthogonal(normal: Vec3, tangent: Vec3) -> Option<Vec3> {
    (tangent - normal * normal.dot(tangent)).try_normalize()
}

/// A tangent that runs around the vertical axis, as the grooves of a turned part do; smooth
/// everywhere except at the poles.
pub(crate) fn around_axis(normal: Vec3) -> Vec3 {
    let around = Vec3::Y.cross(normal).try_normalize().unwrap_or(Vec3::X);
    orthogonal(normal, around).unwrap_or_else(|| normal.any_orthonormal_vector())
}

/// Sets every tangent to the area-weighted mean of ∂p/∂u over the vertex's triangles.
pub(crate) fn set_from_uv(vertices: &mut [Vertex], triangles: &[[u32; 3]]) {
    let mut along_u = vec![Vec3::ZERO; vertices.len()];
    let mut against_v = vec![Vec3::ZERO; vertices.len()];
    for triangle in triangles {
        let [a, b, c] = triangle.map(|index| vertices[index as usize]);
        let [p, q, r] = [a, b, c].map(|vertex| vertex.position);
        let [u, v, w] = [a, b, c].map(|vertex| vertex.uv);
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
        let normal = vertex.normal;
        (vertex.tangent, vertex.bitangent_sign) = match orthogonal(normal, along_u) {
            Some(tangent) => {
                let flipped = normal.cross(tangent).dot(against_v) < 0.0;
                (tangent, if flipped { -1.0 } else { 1.0 })
            }
            None => (around_axis(normal), 1.0),
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
        let normal = vertices[old].normal;
        let [x, y, z, w] = given;
        let (tangent, bitangent_sign) = match orthogonal(normal, Vec3::new(x, y, z)) {
            // The algorithm takes v to point up; ours points down.
            Some(tangent) => (tangent, -w),
            None => (around_axis(normal), 1.0),
        };
        *index = *split
            .entry((
                old,
                tangent.extend(bitangent_sign).to_array().map(f32::to_bits),
            ))
            .or_insert_with(|| {
                if std::mem::replace(&mut assigned[old], true) {
                    vertices.push(Vertex {
                        tangent,
                        bitangent_sign,
                        ..vertices[old]
                    });
                    vertices.len() as u32 - 1
                } else {
                    vertices[old].tangent = tangent;
                    vertices[old].bitangent_sign = bitangent_sign;
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
        self.vertex(face, corner).position.into()
    }

    fn normal(&self, face: usize, corner: usize) -> [f32; 3] {
        self.vertex(face, corner).normal.into()
    }

    fn tex_coord(&self, face: usize, corner: usize) -> [f32; 2] {
        self.vertex(face, corner).uv.into()
    }

    fn set_tangent_encoded(&mut self, tangent: [f32; 4], face: usize, corner: usize) {
        self.tangents[face * 3 + corner] = tangent;
    }
}

#[cfg(test)]
mod tests {
    use glam::Vec2;

    use super::*;

    /// Rounding of a few products in f32.
    const TOLERANCE: f32 = 1e-5;

    /// Two unit squares side by side in z = 0, their u running away from each other from the
    /// shared edge x = 0, v down.
    fn mirrored_pair() -> (Vec<Vertex>, Vec<[u32; 3]>) {
        let mut vertices = Vec::new();
        for x in [-1f32, 0.0, 1.0] {
            for y in [0f32, 1.0] {
                vertices.push(Vertex {
                    position: Vec3::new(x, y, 0.0),
                    normal: Vec3::Z,
                    tangent: Vec3::ZERO,
                    bitangent_sign: 0.0,
                    uv: Vec2::new(x.abs(), 1.0 - y),
                    second_uv: Vec2::ZERO,
                });
            }
        }
        (vertices, vec![[0, 2, 3], [0, 3, 1], [2, 4, 5], [2, 5, 3]])
    }

    fn assert_frame(vertex: &Vertex, tangent: Vec3, bitangent: Vec3) {
        let found = vertex.tangent;
        assert!(found.distance(tangent) < TOLERANCE, "{vertex:?}");
        let across = vertex.normal.cross(found) * vertex.bitangent_sign;
        assert!(across.distance(bitangent) < TOLERANCE, "{vertex:?}");
    }

    #[test]
    fn both_methods_follow_u_and_rise_against_v() {
        let (mut vertices, mut triangles) = mirrored_pair();
        set_from_uv(&mut vertices, &triangles);
        for vertex in [&vertices[0], &vertices[1], &vertices[4], &vertices[5]] {
            assert_frame(vertex, Vec3::X * vertex.position[0], Vec3::Y);
        }
        set_mikktspace(&mut vertices, &mut triangles);
        // The two vertices on the shared edge are split.
        assert_eq!(vertices.len(), 8);
        for (index, triangle) in triangles.iter().enumerate() {
            let side = if index < 2 { Vec3::NEG_X } else { Vec3::X };
            for corner in triangle {
                assert_frame(&vertices[*corner as usize], side, Vec3::Y);
            }
        }
    }

    #[test]
    fn without_usable_texture_coordinates_tangents_run_around_the_axis() {
        let (mut vertices, mut triangles) = mirrored_pair();
        for vertex in &mut vertices {
            vertex.uv = Vec2::splat(0.5);
            vertex.normal = Vec3::new(1.0, 0.5, 2.0).normalize();
        }
        let around = Vec3::new(2.0, 0.0, -1.0).normalize();
        for method in 0..3 {
            match method {
                0 => vertices
                    .iter_mut()
                    .for_each(|vertex| vertex.tangent = around_axis(vertex.normal)),
                1 => set_from_uv(&mut vertices, &triangles),
                _ => set_mikktspace(&mut vertices, &mut triangles),
            }
            for vertex in &vertices {
                let tangent = vertex.tangent;
                assert!(tangent.is_normalized(), "method {method}: {vertex:?}");
                assert!(tangent.dot(vertex.normal).abs() < TOLERANCE);
                if method < 2 {
                    assert!(
                        tangent.distance(around) < TOLERANCE,
                        "method {method}: {vertex:?}"
                    );
                }
            }
        }
    }

    #[test]
    fn poles_have_a_tangent() {
        for normal in [Vec3::Y, Vec3::NEG_Y] {
            let tangent = around_axis(normal);
            assert!(tangent.is_normalized() && tangent.dot(normal).abs() < TOLERANCE);
        }
    }
}
