//! Edges between flats: those that are contours from where one of the two is seen from its front and the other is not.

use super::Contour;
use super::facing::BLOCK;
use super::parts::Parts;

/// Edges between two flats: the first is wound along the edge, the second against it.
#[derive(Default)]
pub(super) struct Edges {
    /// Blocks of the first and the second flat, and where the edges of each such pair begin; one end more.
    pub(super) blocks: Vec<[u32; 2]>,
    pub(super) first: Vec<u32>,
    /// The flats as numbers in their blocks.
    pub(super) flats: Vec<[u8; 2]>,
    pub(super) vertices: Vec<[u32; 2]>,
}

/// The flats at an edge and whether each is wound along it.
#[derive(Clone)]
pub(super) struct IrregularEdge {
    pub(super) vertices: [u32; 2],
    pub(super) flats: Vec<(u32, bool)>,
}

impl IrregularEdge {
    /// The contour that it makes, if any. `face` is 1 for flats that face the eye, −1 for those
    /// that do not, and 0 for those that do not count.
    pub(super) fn contour(&self, face: impl Fn(u32) -> i8) -> Option<Contour> {
        let left = |&(flat, along): &(u32, bool)| {
            let face = i32::from(face(flat));
            if along { face } else { -face }
        };
        let step = self.flats.iter().map(left).sum();
        (step != 0).then_some(Contour {
            vertices: self.vertices,
            step,
        })
    }
}

/// An edge of a triangle: from its lower to its higher vertex, the triangle, whether it is wound along that.
pub(super) type HalfEdge = ([u32; 2], u32, bool);

/// The edges of a triangle, as it is wound.
pub(super) fn outline([a, b, c]: [u32; 3]) -> [[u32; 2]; 3] {
    [[a, b], [b, c], [c, a]]
}

/// Edges of the triangles that are not loose, those between the same vertices one after the other.
pub(super) fn half_edges(triangles: &[[u32; 3]], parts: &Parts) -> Vec<HalfEdge> {
    let mut edges = Vec::with_capacity(3 * triangles.len());
    for (&vertices, triangle) in triangles.iter().zip(0..) {
        if parts.bundle_of(parts.of_vertex(vertices[0])).is_some() {
            continue;
        }
        for [from, to] in outline(vertices) {
            edges.push(([from.min(to), from.max(to)], triangle, from < to));
        }
    }
    edges.sort_unstable();
    edges
}

/// Of an edge between two triangles that are wound alike, that which is wound along it and the other one.
pub(super) fn regular_pair(sides: &[HalfEdge]) -> Option<[u32; 2]> {
    match *sides {
        [(_, a, along_a), (_, b, along_b)] if along_a != along_b => {
            Some(if along_a { [a, b] } else { [b, a] })
        }
        _ => None,
    }
}

impl Edges {
    /// Of triangles with the numbers of their flats. Edges of one triangle, or of several that do not pair up, are apart.
    pub(super) fn new(sides: &[HalfEdge], flats: &[u32]) -> (Self, Vec<IrregularEdge>) {
        let flat = |triangle: u32| flats[triangle as usize];
        // Flats, vertices: in the order of the flats.
        let mut regular: Vec<([u32; 2], [u32; 2])> = Vec::new();
        let mut irregular = Vec::new();
        for sides in sides.chunk_by(|a, b| a.0 == b.0) {
            let vertices = sides[0].0;
            match regular_pair(sides).map(|pair| pair.map(flat)) {
                // Within a flat.
                Some([a, b]) if a == b => {}
                Some(pair) => regular.push((pair, vertices)),
                None => irregular.push(IrregularEdge {
                    vertices,
                    flats: (sides.iter().map(|&(_, t, along)| (flat(t), along))).collect(),
                }),
            }
        }
        let blocks = |flats: [u32; 2]| flats.map(|flat| flat / BLOCK as u32);
        regular.sort_unstable_by_key(|&(flats, vertices)| (blocks(flats), flats, vertices));
        let mut edges = Self::default();
        for (flats, vertices) in regular {
            if edges.blocks.last() != Some(&blocks(flats)) {
                edges.blocks.push(blocks(flats));
                edges.first.push(edges.vertices.len() as u32);
            }
            (edges.flats).push(flats.map(|flat| (flat % BLOCK as u32) as u8));
            edges.vertices.push(vertices);
        }
        edges.first.push(edges.vertices.len() as u32);
        (edges, irregular)
    }

    /// How many there are.
    #[cfg(test)]
    pub(super) fn count(&self) -> usize {
        self.vertices.len()
    }
}
