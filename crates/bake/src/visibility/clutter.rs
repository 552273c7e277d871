//! Which of many small pieces are sampled, and what stands for the others.
//!
//! Leaves, blades of grass and loose triangles have borders everywhere: nearly all of their places would be sampled, and
//! from each of them the borders of most others are contours. Where that takes too long for a draft, small pieces share samples with those
//! beside them that face the same way, from the further apart the more there are.

use std::collections::HashMap;

use glam::{IVec3, Vec3};
use relight_format::math;

use super::places::Groups;
use super::sparse::Sparse;

/// By how much more room samples get from one try to the next, and how often.
const WIDER: f32 = 1.25;
const TRIES: u32 = 20;
/// Pieces that are no larger than so many of the distances between samples that share are small beside them, if they
/// are no larger than so many of the ordinary ones: those are about a quarter of what is there.
const SMALL: f32 = 4.0;
const LARGEST: f32 = 32.0;
/// Distances that differ by less than a part of an octave are one; so many parts.
const LEVELS: f32 = 4.0;
/// Steps of normals from the middle of a cube's face to its edge: those within one share samples.
const FACETS: f32 = 2.0;
/// The part of all borders that are contours from a place, as those of leaves and grass are.
const SEEN: f32 = 0.4;

/// Pieces of a surface, and how they end.
pub(crate) struct Clutter<'a> {
    origins: &'a [Vec3],
    /// Unit length, or zero.
    normals: Vec<Vec3>,
    /// The diagonal of the piece that each place belongs to, metres.
    sizes: Vec<f32>,
    /// Edges of one triangle alone.
    borders: usize,
}

impl<'a> Clutter<'a> {
    /// `triangles` have places for corners.
    pub(crate) fn new(origins: &'a [Vec3], triangles: &[[u32; 3]]) -> Self {
        let mut normals = vec![Vec3::ZERO; origins.len()];
        let mut pieces = Groups::new(origins.len());
        let mut sides = Vec::with_capacity(3 * triangles.len());
        for triangle in triangles {
            let [a, b, c] = triangle.map(|place| origins[place as usize]);
            let [i, j, k] = *triangle;
            pieces.join(i, j);
            pieces.join(i, k);
            for place in triangle {
                normals[*place as usize] += (b - a).cross(c - a);
            }
            sides.extend([[i, j], [j, k], [k, i]].map(|[a, b]| [a.min(b), a.max(b)]));
        }
        for normal in &mut normals {
            *normal = normal.normalize_or_zero();
        }
        sides.sort_unstable();
        let ends = sides.chunk_by(|a, b| a == b).filter(|side| side.len() == 1);
        Self {
            borders: ends.count(),
            sizes: sizes(pieces, origins),
            origins,
            normals,
        }
    }

    /// About how many contours are borders, of all that are looked at from so many samples.
    pub(crate) fn contours(&self, samples: usize) -> f32 {
        SEEN * self.borders as f32 * samples as f32
    }

    /// Fewer samples, at most about `most` if small pieces can share so many; `distances` apart otherwise. Nothing if that
    /// leaves more than half.
    pub(crate) fn shared(&self, sparse: &Sparse, distances: &[f32], most: usize) -> Option<Sparse> {
        let all = sparse.sampled();
        let mut room = 1.0;
        for tried in 1..=TRIES {
            let key_at = |place: u32| self.key(place, distances[place as usize], room);
            let mut shared = HashMap::new();
            let mut alone = 0;
            for &place in &all {
                if let Some(key) = key_at(place) {
                    shared.entry(key).or_insert(place);
                } else {
                    alone += 1;
                }
            }
            let count = alone + shared.len();
            if count <= most || tried == TRIES {
                let source = |place| shared.get(&key_at(place)?).copied();
                return (2 * count <= all.len()).then(|| sparse.replaced(source));
            }
            room *= WIDER;
        }
        None
    }

    /// Places of equal keys share a sample, in so many times their distance. Nothing for those of pieces that are not small.
    fn key(&self, place: u32, distance: f32, room: f32) -> Option<(i32, IVec3, IVec3)> {
        if self.sizes[place as usize] > (SMALL * room).min(LARGEST) * distance {
            return None;
        }
        let room = room * distance;
        let level = (LEVELS * math::log2(room.max(f32::MIN_POSITIVE))).round();
        let cell = (self.origins[place as usize] / math::exp2(level / LEVELS)).floor();
        let normal = self.normals[place as usize];
        let facet = normal / normal.abs().max_element().max(f32::MIN_POSITIVE);
        let facet = (FACETS * facet).round();
        Some((level as i32, cell.as_ivec3(), facet.as_ivec3()))
    }
}

/// The diagonal of the box about each place's piece.
fn sizes(pieces: Groups, origins: &[Vec3]) -> Vec<f32> {
    let (count, pieces) = pieces.numbered();
    let mut boxes = vec![(Vec3::INFINITY, Vec3::NEG_INFINITY); count];
    for (piece, origin) in pieces.iter().zip(origins) {
        let (low, high) = &mut boxes[*piece as usize];
        (*low, *high) = (low.min(*origin), high.max(*origin));
    }
    let size = |piece: &u32| {
        let (low, high) = boxes[*piece as usize];
        low.distance(high)
    };
    pieces.iter().map(size).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::cluster::tests::grid;
    use crate::visibility::sparse::Spacing;
    use crate::visibility::tests::random;

    /// Triangles of one size, in a cube of one metre.
    fn leaves(count: u32) -> (Vec<Vec3>, Vec<[u32; 3]>) {
        let mut state = 7;
        let mut point = || Vec3::new(random(&mut state), random(&mut state), random(&mut state));
        let mut origins = Vec::new();
        for _ in 0..count {
            let centre = point();
            origins.extend([(); 3].map(|()| centre + 0.03 * (point() - 0.5)));
        }
        (
            origins,
            (0..count).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect(),
        )
    }

    fn sparse(origins: &[Vec3], triangles: &[[u32; 3]], distances: &[f32]) -> Sparse {
        let spacing = Spacing {
            distances: distances.to_vec(),
            smooth: 0.9,
        };
        Sparse::new(origins, triangles, &spacing)
    }

    #[test]
    fn leaves_share_samples_with_those_beside_them_that_face_the_same_way() {
        let (origins, triangles) = leaves(20_000);
        let distances = vec![0.01; origins.len()];
        let all = sparse(&origins, &triangles, &distances);
        assert!(all.sampled().len() > 40_000);
        let clutter = Clutter::new(&origins, &triangles);
        assert_eq!(clutter.borders, 60_000);
        let shared = clutter.shared(&all, &distances, 5_000).unwrap();
        let sampled = shared.sampled();
        assert!(
            (3_000..=5_000).contains(&sampled.len()),
            "{}",
            sampled.len()
        );
        let (mut apart, mut turned) = (0f32, 1f32);
        for place in 0..origins.len() as u32 {
            let sources = shared.sources(place);
            assert!((sources.iter().map(|(_, weight)| weight).sum::<f32>() - 1.0).abs() < 1e-5);
            for (source, _) in sources {
                assert!(sampled.binary_search(source).is_ok());
                let [a, b] = [place, *source].map(|place| place as usize);
                apart = apart.max(origins[a].distance(origins[b]));
                turned = turned.min(clutter.normals[a].dot(clutter.normals[b]));
            }
        }
        assert!(apart < 0.6, "{apart}");
        assert!(turned > 0.7, "{turned}");
    }

    #[test]
    fn large_pieces_share_nothing() {
        let (mut origins, mut triangles) = grid(60, |_, _| 0.0);
        let plane = origins.len() as u32;
        let distances = vec![0.5; origins.len()];
        let all = sparse(&origins, &triangles, &distances);
        assert!(
            Clutter::new(&origins, &triangles)
                .shared(&all, &distances, 100)
                .is_none()
        );
        // Beside leaves they stay as they were.
        let (more, others) = leaves(20_000);
        origins.extend(more.iter().map(|point| 5.0 * *point));
        triangles.extend(
            others
                .iter()
                .map(|triangle| triangle.map(|place| plane + place)),
        );
        let distances = vec![0.5; origins.len()];
        let all = sparse(&origins, &triangles, &distances);
        let clutter = Clutter::new(&origins, &triangles);
        let shared = clutter.shared(&all, &distances, 5_000).unwrap();
        assert!(shared.sampled().len() <= 5_000);
        for place in 0..plane {
            assert_eq!(shared.sources(place), all.sources(place));
        }
    }
}
