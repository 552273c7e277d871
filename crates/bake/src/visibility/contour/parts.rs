//! Parts of a mesh that share no vertex with one another, as boxes in space.
//!
//! The layers of a scene are the sum of those of its parts, so that a part that lies behind
//! others can be left out as a whole (`rounds`).

use glam::Vec3;

use super::batch::LANES;
use super::loose::Bundle;
use crate::visibility;

/// Pieces of at most so many triangles are loose.
const MOST_LOOSE: usize = 2;

/// Pieces of a mesh that hang together are parts; the small ones are gathered, with others near
/// by, to parts that fill a batch of contours. Those of one or two triangles are *loose*: their
/// parts are bundles of triangles, and come last.
pub(super) struct Parts {
    /// Per welded vertex.
    of_vertex: Vec<u32>,
    /// Corners of the boxes that bound them.
    pub(super) boxes: Vec<[Vec3; 2]>,
    /// The triangles of the last parts.
    pub(super) bundles: Vec<Bundle>,
}

impl Parts {
    /// `triangles` index `positions`.
    pub(super) fn new(positions: &[Vec3], triangles: &[[u32; 3]]) -> Self {
        let mut piece: Vec<u32> = (0..positions.len() as u32).collect();
        for &[a, b, c] in triangles {
            for other in [b, c] {
                let (one, other) = (root(&mut piece, a), root(&mut piece, other));
                piece[one.max(other) as usize] = one.min(other);
            }
        }
        for vertex in 0..piece.len() as u32 {
            // Roots come before all that they stand for.
            piece[vertex as usize] = piece[piece[vertex as usize] as usize];
        }
        let mut boxes = vec![[Vec3::INFINITY, Vec3::NEG_INFINITY]; positions.len()];
        let mut sizes = vec![0; positions.len()];
        for triangle in triangles {
            let piece = piece[triangle[0] as usize] as usize;
            sizes[piece] += 1;
            for vertex in triangle {
                boxes[piece] = joined(boxes[piece], [positions[*vertex as usize]; 2]);
            }
        }
        let pieces = (0..positions.len() as u32).filter(|&piece| sizes[piece as usize] > 0);
        let (mut loose, mut others): (Vec<u32>, Vec<u32>) =
            pieces.partition(|&piece| sizes[piece as usize] <= MOST_LOOSE);
        for pieces in [&mut loose, &mut others] {
            visibility::arrange(pieces, &[1], &|&piece| {
                let [low, high] = boxes[piece as usize];
                (low.midpoint(high).to_array(), piece)
            });
        }
        let mut parts = Self {
            of_vertex: vec![0; positions.len()],
            boxes: Vec::new(),
            bundles: Vec::new(),
        };
        // Per piece, the part that it belongs to.
        let mut part = vec![0; positions.len()];
        let mut gather = |pieces: Vec<u32>, lanes: &dyn Fn(usize) -> usize| {
            let mut filled = usize::MAX;
            for piece in pieces.into_iter().map(|piece| piece as usize) {
                let more = lanes(sizes[piece]);
                filled = filled.saturating_add(more);
                if filled > LANES {
                    filled = more;
                    parts.boxes.push([Vec3::INFINITY, Vec3::NEG_INFINITY]);
                }
                let number = parts.boxes.len() - 1;
                part[piece] = number as u32;
                parts.boxes[number] = joined(parts.boxes[number], boxes[piece]);
            }
            parts.boxes.len()
        };
        let first_loose = gather(others, &expected_contours);
        let count = gather(loose, &|triangles| triangles);
        for (of_vertex, piece) in parts.of_vertex.iter_mut().zip(piece) {
            *of_vertex = part[piece as usize];
        }
        (parts.bundles).resize_with(count - first_loose, Bundle::default);
        for (number, triangle) in (0..).zip(triangles) {
            let corners = triangle.map(|vertex| positions[vertex as usize]);
            if let Some(bundle) = parts.bundle_of(parts.of_vertex(triangle[0])) {
                parts.bundles[bundle].push(number, corners);
            }
        }
        parts
    }

    /// The bundle that a part is, if what belongs to it is loose.
    pub(super) fn bundle_of(&self, part: u32) -> Option<usize> {
        (part as usize).checked_sub(self.boxes.len() - self.bundles.len())
    }

    pub(super) fn count(&self) -> usize {
        self.boxes.len()
    }

    /// The part that what lies at a vertex belongs to.
    pub(super) fn of_vertex(&self, vertex: u32) -> u32 {
        self.of_vertex[vertex as usize]
    }
}

/// Contours of a piece of so many triangles, about: a triangle has three, a box six to nine.
fn expected_contours(triangles: usize) -> usize {
    triangles / 2 + 3
}

/// The vertex that stands for all that hang together with this one: none comes before it.
fn root(piece: &mut [u32], mut vertex: u32) -> u32 {
    while piece[vertex as usize] != vertex {
        let next = piece[piece[vertex as usize] as usize];
        piece[vertex as usize] = next;
        vertex = next;
    }
    vertex
}

fn joined([low, high]: [Vec3; 2], [other_low, other_high]: [Vec3; 2]) -> [Vec3; 2] {
    [low.min(other_low), high.max(other_high)]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pieces_near_one_another_share_parts_and_large_ones_do_not() {
        // A fan of 40 triangles, 20 loose ones far away, and strips of three farther still.
        let mut positions = vec![Vec3::ZERO];
        let mut triangles = Vec::new();
        for i in 0..41 {
            let angle = i as f32 * 0.1;
            positions.push(Vec3::new(angle, angle * angle, 1.0));
        }
        // Against the order of the vertices, so that roots have roots.
        triangles.extend((1..41).rev().map(|i| [i + 1, i, 0]));
        for i in 0..20 {
            let first = positions.len() as u32;
            let at = Vec3::new(100.0 + i as f32, 0.0, 0.0);
            positions.extend([at, at + 0.5 * Vec3::X, at + 0.5 * Vec3::Y]);
            triangles.push([first, first + 1, first + 2]);
        }
        for i in 0..9 {
            let first = positions.len() as u32;
            let at = Vec3::new(200.0 + i as f32, 0.0, 0.0);
            positions.extend([0.0, 0.1, 0.2, 0.3, 0.4].map(|x| at + Vec3::new(x, x * x, 0.0)));
            triangles.extend((first..first + 3).map(|vertex| [vertex, vertex + 1, vertex + 2]));
        }
        let parts = Parts::new(&positions, &triangles);
        assert_eq!(parts.count(), 1 + 3 + 2);
        let loose = |vertex| parts.bundle_of(parts.of_vertex(vertex));
        let of_bundles: Vec<&[u32]> = parts.bundles.iter().map(Bundle::triangles).collect();
        assert_eq!(of_bundles.concat(), (40..60).collect::<Vec<u32>>());
        for (number, triangle) in (0..).zip(&triangles) {
            assert_eq!(
                loose(triangle[0]).is_some(),
                (40..60).contains(&number),
                "triangle {number}"
            );
            if let Some(bundle) = loose(triangle[0]) {
                assert!(of_bundles[bundle].contains(&number));
            }
        }
        let fan = parts.of_vertex(0);
        for (vertex, position) in positions.iter().enumerate() {
            let part = parts.of_vertex(vertex as u32);
            assert_eq!(part == fan, vertex <= 41, "vertex {vertex}");
            let [low, high] = parts.boxes[part as usize];
            assert_eq!(position.clamp(low, high), *position);
            assert!(high.x - low.x < 16.0, "{low} {high}");
        }
        for triangle in &triangles[40..] {
            let [a, b, c] = triangle.map(|vertex| parts.of_vertex(vertex));
            assert!(a == b && b == c);
        }
    }
}
