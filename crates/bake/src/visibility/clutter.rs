//! Which of many small pieces are sampled, and what stands for the others.
//!
//! Leaves, blades of grass and loose triangles have borders everywhere: nearly all of their places would be sampled, and
//! from each of them the borders of most others are contours. Where that takes too long for a draft, small pieces share samples, and points at
//! which light is gathered, with those beside them that face the same way, from the further apart the more there are. How long it takes is told by
//! how many contours are looked at from some of the samples.

use std::collections::HashMap;

use glam::{IVec3, Vec3};
use rayon::prelude::*;
use relight_format::math;

use super::Directions;
use super::contour::ContourMesh;
use super::places::{Groups, Places};
use super::sparse::Sparse;

/// Seconds that a draft may take of one processor, about, half of it of two; scenes of more than so many triangles accordingly more.
const MOST_TIME: f32 = 16.0;
const TRIANGLES: f32 = 1e5;
/// What is left of them for samples and light, at least.
const LEAST_TIME: f32 = 2.5;
/// What else takes time, by itself and for each place, seconds. These and those below are for one Xeon, fitted to drafts of a dozen scenes.
const OTHERWISE: f32 = 3.0;
const PER_PLACE: f32 = 6e-5;
/// For a sample by contours, and for each contour; for each ray of a sample by rays; for a point at which light is gathered, seconds.
const PER_SAMPLE: f32 = 1.2e-4;
const PER_CONTOUR: f32 = 2.5e-8;
const PER_RAY: f32 = 5e-7;
const PER_LIGHT: f32 = 1.3e-4;
/// Rays are cast in place of looking at contours where they take so small a part of the time.
const FASTER: f32 = 0.5;
/// The part of the time left that light may take, where not all fits.
const LIGHT_SHARE: f32 = 1.0 / 3.0;
/// From how many samples contours are counted.
const COUNTED: usize = 64;
/// Scenes of which one place in so many is sampled, or fewer, are of large pieces: not worth the memory to look at them.
const SPARSE: usize = 16;
/// Samples that are left where some are shared, of all, at most.
const LEFT: f32 = 0.6;

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

/// How a draft samples what is seen and gathers light.
pub(crate) struct Drafted {
    /// Which places are sampled, and at which light is gathered.
    pub seen: Sparse,
    pub light: Sparse,
    /// How many samples there are, and in place of how many, if small pieces share them.
    pub shared: Option<[usize; 2]>,
    /// Whether samples are made by a ray in every direction.
    pub by_rays: bool,
}

impl Drafted {
    /// `distances` of samples are those of `seen`; it is sampled in `directions`.
    pub(crate) fn new(
        (seen, light): (Sparse, Sparse),
        places: &Places,
        distances: &[f32],
        contours: &ContourMesh,
        directions: &Directions,
    ) -> Self {
        let samples = seen.sampled();
        let lights = light.sampled().len();
        let by_rays = PER_RAY * directions.as_slice().len() as f32;
        let large = (contours.triangles() as f32 / TRIANGLES).max(1.0);
        let allowed = MOST_TIME * large - OTHERWISE - PER_PLACE * places.origins.len() as f32;
        let allowed = allowed.max(LEAST_TIME);
        let plain = Self {
            seen,
            light,
            shared: None,
            by_rays: false,
        };
        let takes = |sample: f32| samples.len() as f32 * sample + lights as f32 * PER_LIGHT;
        if takes(by_rays) <= allowed || SPARSE * samples.len() < places.origins.len() {
            return plain;
        }
        let counted = counted(contours, &places.origins, &samples, directions);
        let by_contours = PER_SAMPLE + PER_CONTOUR * counted;
        let plain = Self {
            by_rays: by_rays < FASTER * by_contours,
            ..plain
        };
        let sample = if plain.by_rays { by_rays } else { by_contours };
        if takes(sample) <= allowed {
            return plain;
        }
        let clutter = Clutter::new(&places.origins, &places.corners);
        let most_lights = (LIGHT_SHARE * allowed / PER_LIGHT) as usize;
        let light = clutter.shared(&plain.light, distances, most_lights);
        let lights = light.as_ref().map_or(lights, |light| light.sampled().len());
        let left = (allowed - lights as f32 * PER_LIGHT).max(LEAST_TIME);
        let Some(seen) = clutter.shared(&plain.seen, distances, (left / sample) as usize) else {
            return plain;
        };
        Self {
            shared: Some([seen.sampled().len(), samples.len()]),
            by_rays: by_rays < by_contours,
            light: light.unwrap_or(plain.light),
            seen,
        }
    }
}

/// From one sample, on average, contours that are looked at.
fn counted(
    contours: &ContourMesh,
    origins: &[Vec3],
    samples: &[u32],
    directions: &Directions,
) -> f32 {
    let some: Vec<u32> = (0..COUNTED)
        .map(|index| samples[index * samples.len() / COUNTED])
        .collect();
    let counted: usize = (some.par_iter())
        .map_init(
            || contours.scratch(directions),
            |scratch, &place| contours.contours_from(origins[place as usize], directions, scratch),
        )
        .sum();
    counted as f32 / COUNTED as f32
}

/// Pieces of a surface.
struct Clutter<'a> {
    origins: &'a [Vec3],
    /// Unit length, or zero.
    normals: Vec<Vec3>,
    /// The diagonal of the piece that each place belongs to, metres.
    sizes: Vec<f32>,
}

impl<'a> Clutter<'a> {
    /// `triangles` have places for corners.
    fn new(origins: &'a [Vec3], triangles: &[[u32; 3]]) -> Self {
        let mut normals = vec![Vec3::ZERO; origins.len()];
        let mut pieces = Groups::new(origins.len());
        for triangle in triangles {
            let [a, b, c] = triangle.map(|place| origins[place as usize]);
            pieces.join(triangle[0], triangle[1]);
            pieces.join(triangle[0], triangle[2]);
            for place in triangle {
                normals[*place as usize] += (b - a).cross(c - a);
            }
        }
        for normal in &mut normals {
            *normal = normal.normalize_or_zero();
        }
        Self {
            sizes: sizes(pieces, origins),
            origins,
            normals,
        }
    }

    /// Fewer samples, at most about `most` if small pieces can share so many; `distances` apart otherwise. Nothing if that
    /// leaves nearly all.
    fn shared(&self, sparse: &Sparse, distances: &[f32], most: usize) -> Option<Sparse> {
        let all = sparse.sampled();
        let key_at = |place: u32, room: f32| self.key(place, distances[place as usize], room);
        let few = |count: usize| count as f32 <= LEFT * all.len() as f32;
        // Those of large pieces stay, however much room the others get.
        let widest = WIDER.powi(TRIES as i32 - 1);
        let large = all.iter().filter(|&&place| key_at(place, widest).is_none());
        if all.len() <= most || !few(large.count()) {
            return None;
        }
        let mut room = 1.0;
        for tried in 1..=TRIES {
            let mut shared = HashMap::new();
            let mut alone = 0;
            for &place in &all {
                if let Some(key) = key_at(place, room) {
                    shared.entry(key).or_insert(place);
                } else {
                    alone += 1;
                }
            }
            let count = alone + shared.len();
            if count <= most || tried == TRIES {
                let source = |place| shared.get(&key_at(place, room)?).copied();
                return few(count).then(|| sparse.replaced(source));
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

    /// What there is time for is sampled as it was; of more, some is shared.
    #[test]
    fn drafts_share_what_would_take_too_long() {
        let drafted = |count: u32, side: u32| {
            let (origins, corners) = leaves(count);
            let mesh: Vec<[Vec3; 3]> = (corners.iter())
                .map(|corners| corners.map(|corner| origins[corner as usize]))
                .collect();
            let distances = vec![0.01; origins.len()];
            let sparse = || sparse(&origins, &corners, &distances);
            let (seen, light, all) = (sparse(), sparse(), sparse().sampled().len());
            let places = Places {
                origins: origins.iter().map(|origin| *origin + 1e-4).collect(),
                corners: corners.clone(),
                ..Places::default()
            };
            let contours = ContourMesh::new(&mesh);
            let directions = Directions::new(side);
            let drafted = Drafted::new((seen, light), &places, &distances, &contours, &directions);
            (drafted, all)
        };
        let (few, all) = drafted(2_000, 32);
        assert!(few.shared.is_none() && few.seen.sampled().len() == all);
        let (many, all) = drafted(20_000, 32);
        let [left, of] = many.shared.expect("too many");
        assert!(many.by_rays && of == all && left == many.seen.sampled().len());
        assert!((2_000..all / 2).contains(&left), "{left} of {all}");
        assert!(many.light.sampled().len() < all);
        // Where there are more rays to a sample, contours take less.
        let finer = drafted(20_000, 64).0;
        assert!(!finer.by_rays && finer.shared.is_some());
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
