//! How clusters are laid out so that they take few bytes: triangles in an order in which each
//! borders on one before, vertices in the order in which triangles use them, normals,
//! tangents and texture coordinates rounded to steps too small to be seen.

use std::collections::HashMap;

use relight_format as format;

/// Steps of normals' and tangents' components: a normal turns by 4e-5 at most, less than a
/// hundredth of what a texel of a normal map can tell.
const NORMAL_STEP: f32 = 1.0 / (1 << 14) as f32;
const TANGENT_STEP: f32 = 1.0 / (1 << 12) as f32;
/// A quarter of a texel of a texture of 16,384 texels.
const UV_STEP: f32 = 1.0 / (1 << 16) as f32;

/// A vertex as stored. Positions stay as they are: rounded to 2⁻¹⁸ of the diagonal, which saves
/// two bytes in a hundred, they no longer lie in the planes that rays were cast against.
pub(super) fn rounded(vertex: format::Vertex) -> format::Vertex {
    format::Vertex {
        position: vertex.position,
        normal: vertex.normal.map(|x| round(x, NORMAL_STEP)),
        tangent: vertex.tangent.map(|x| round(x, TANGENT_STEP)),
        uv: rounded_uv(vertex.uv),
    }
}

/// Second texture coordinates as stored.
pub(super) fn rounded_uv(uv: [f32; 2]) -> [f32; 2] {
    uv.map(|x| round(x, UV_STEP))
}

/// Plus zero, for −0 is not a multiple like others.
fn round(number: f32, step: f32) -> f32 {
    (number / step).round() * step + 0.0
}

/// Orders triangles and vertices. Returns triangles, with their corners renumbered, and the
/// former number of every vertex.
pub(super) fn walk(
    triangles: &[format::Triangle],
    vertices: usize,
) -> (Vec<format::Triangle>, Vec<usize>) {
    let edges = |triangle: &format::Triangle| {
        let [a, b, c] = triangle.vertices;
        [[a, b], [b, c], [c, a]].map(|[a, b]| [a.min(b), a.max(b)])
    };
    let mut beside: HashMap<[u32; 2], Vec<usize>> = HashMap::new();
    for (index, triangle) in triangles.iter().enumerate() {
        for edge in edges(triangle) {
            beside.entry(edge).or_default().push(index);
        }
    }
    let mut visited = vec![false; triangles.len()];
    let mut numbers = vec![u32::MAX; vertices];
    let mut order = Vec::with_capacity(vertices);
    let mut walked = Vec::with_capacity(triangles.len());
    let mut stack = Vec::new();
    for seed in 0..triangles.len() {
        stack.push(seed);
        while let Some(index) = stack.pop() {
            if std::mem::replace(&mut visited[index], true) {
                continue;
            }
            let triangle = &triangles[index];
            // New corners come last, whatever the rotation.
            let is_new = triangle
                .vertices
                .map(|vertex| numbers[vertex as usize] == u32::MAX);
            let rotation = match is_new {
                [true, false, _] => 1,
                [_, true, false] => 2,
                _ => 0,
            };
            let mut corners = triangle.vertices;
            corners.rotate_left(rotation);
            let corners = corners.map(|vertex| {
                let number = &mut numbers[vertex as usize];
                if *number == u32::MAX {
                    *number = order.len() as u32;
                    order.push(vertex as usize);
                }
                *number
            });
            walked.push(format::Triangle {
                vertices: corners,
                ..*triangle
            });
            for edge in edges(triangle) {
                stack.extend(beside[&edge].iter().filter(|&&other| !visited[other]));
            }
        }
    }
    (walked, order)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn triangle(vertices: [u32; 3]) -> format::Triangle {
        format::Triangle {
            vertices,
            material: 3,
            cluster: 0,
        }
    }

    #[test]
    fn walks_keep_every_triangle_and_its_winding() {
        // Two strips that do not touch, one with an edge of three triangles, out of order.
        let triangles = [
            [7, 8, 9],
            [0, 1, 2],
            [9, 8, 6],
            [5, 4, 3],
            [2, 1, 3],
            [1, 2, 10],
        ]
        .map(triangle);
        let (walked, order) = walk(&triangles, 11);
        let mut sorted = order.clone();
        sorted.sort_unstable();
        assert!(sorted.into_iter().eq(0..11));
        let canonical = |mut corners: [u32; 3]| {
            let first = (0..3).min_by_key(|&i| corners[i]).unwrap();
            corners.rotate_left(first);
            corners
        };
        let mut before: Vec<_> = triangles.map(|t| canonical(t.vertices)).into();
        let mut after: Vec<_> = (walked.iter())
            .map(|t| canonical(t.vertices.map(|corner| order[corner as usize] as u32)))
            .collect();
        before.sort_unstable();
        after.sort_unstable();
        assert_eq!(before, after);
        assert!(walked.iter().all(|triangle| triangle.material == 3));
        // Vertices are new in order, and last in their triangle.
        let mut next = 0;
        for triangle in walked {
            for corner in triangle.vertices {
                assert!(corner <= next);
                next = next.max(corner + 1);
            }
        }
    }

    #[test]
    fn attributes_are_off_by_half_a_step_at_most() {
        let vertex = format::Vertex {
            position: [0.123_456_7, -1e9, -0.0],
            normal: [0.577_350_3, -0.1, 1e-9],
            tangent: [0.3, -0.000_001, 0.9, -1.0],
            uv: [12.345_678, 0.1],
        };
        let stored = rounded(vertex);
        assert_eq!(stored.position, vertex.position);
        let pairs = [
            (&vertex.normal[..], &stored.normal[..], NORMAL_STEP),
            (&vertex.tangent, &stored.tangent, TANGENT_STEP),
            (&vertex.uv, &stored.uv, UV_STEP),
        ];
        for (before, after, step) in pairs {
            for (before, after) in before.iter().zip(after) {
                assert!(
                    (before - after).abs() <= 0.5 * step,
                    "{before} {after} {step}"
                );
                assert_eq!((after / step).fract(), 0.0);
                assert_ne!(after.to_bits(), (-0.0f32).to_bits());
            }
        }
    }
}
