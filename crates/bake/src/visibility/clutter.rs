//! Which places of a draft are sampled where all would take too long, and what stands for the others.
//!
//! Leaves, blades of grass and loose triangles have borders everywhere: nearly all of their places would be sampled, and
//! from each of them the borders of most others are contours. Where that takes too long for a draft, small pieces share samples, and points at
//! which light is gathered, with those beside them that face the same way, from the further apart the more there are; large pieces have fewer.
//! How long it takes is told by how many contours are looked at from some of the samples.

use glam::Vec3;
use rayon::prelude::*;
use relight_format::math;

use super::Directions;
use super::contour::ContourMesh;
use super::places::{Finding, Groups, Places};
use super::sparse::{Spacing, Sparse};

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

/// Samples of large pieces are as far apart as ordinary ones until they take so many times what there is; then further, so many times
/// at most. Those on edges stay, so that twice as far apart are more than a quarter.
const BEYOND: f32 = 1.2;
const SPARSEST: f32 = 4.0;
/// How many times further from one try to the next.
const LEAST_STEP: f32 = 1.1;
const MOST_STEP: f32 = 2.0;

/// By how much more room samples get from one try to the next, and how often.
const WIDER: f32 = 1.25;
const TRIES: i32 = 20;
/// Pieces that are no larger than so many of the distances between samples that share are small beside them, if they
/// are no larger than so many of the ordinary ones: those are about a quarter of what is there.
const SMALL: f32 = 4.0;
const LARGEST: f32 = 32.0;
/// Distances that differ by less than a part of an octave are one; so many parts.
const LEVELS: f32 = 4.0;
/// Steps of normals from the middle of a cube's face to its edge: those within one share samples.
const FACETS: f32 = 2.0;

/// Least cosine between normals of places that stand for each other.
const SMOOTH: f32 = 0.8;
/// The same for bounced light, which varies less, and less with the normal; and how far apart it is
/// gathered, in the distances of samples.
const LIGHT_SMOOTH: f32 = 0.6;
const LIGHT_SPACING: f32 = 2.5;

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
    /// Finds where places emerge, those of small pieces that share samples only where they are sampled. `distance` tells
    /// how far apart samples are about a point; they are taken in `directions`. With the places.
    pub(crate) fn new(
        mut found: Finding,
        distance: impl Fn(Vec3) -> f32 + Sync,
        contours: &ContourMesh,
        directions: &Directions,
    ) -> (Self, Places) {
        let by_places = |places: &Places| {
            let distances: Vec<f32> = (places.origins.par_iter())
                .map(|&origin| distance(origin))
                .collect();
            Self::by_places(places, &distances, contours, directions)
        };
        let small = of_small_pieces(&found.places, &distance);
        let is_small = |place: u32| small.get(place as usize) == Some(&true);
        if !is_few(small.iter().filter(|small| !**small).count(), small.len()) {
            found.emerge(|_| true, true);
            // Of scenes of a million triangles the rest takes much memory.
            let places = found.into_places();
            return (by_places(&places), places);
        }
        found.emerge(|place| !is_small(place), true);
        let drafted = by_places(&found.places);
        if drafted.shared.is_none() {
            found.emerge(is_small, true);
            let places = found.into_places();
            return (by_places(&places), places);
        }
        let mut sampled = vec![false; small.len()];
        for sparse in [&drafted.seen, &drafted.light] {
            for place in sparse.sampled() {
                if is_small(place) {
                    sampled[place as usize] = true;
                }
            }
        }
        found.emerge(|place| sampled.get(place as usize) == Some(&true), false);
        (drafted, found.into_places())
    }

    fn by_places(
        places: &Places,
        distances: &[f32],
        contours: &ContourMesh,
        directions: &Directions,
    ) -> Self {
        // So many times as far apart as ordinarily.
        let sparse = |factor: f32| {
            let sparse = |factor: f32, smooth| {
                let spacing = Spacing {
                    distances: distances.iter().map(|way| factor * way).collect(),
                    smooth,
                };
                Sparse::new(&places.origins, &places.corners, &spacing)
            };
            let light = factor * LIGHT_SPACING;
            rayon::join(|| sparse(factor, SMOOTH), || sparse(light, LIGHT_SMOOTH))
        };
        let (seen, light) = sparse(1.0);
        let samples = seen.sampled();
        let mut plain = Self {
            seen,
            light,
            shared: None,
            by_rays: true,
        };
        let large = (contours.triangles() as f32 / TRIANGLES).max(1.0);
        let allowed = MOST_TIME * large - OTHERWISE - PER_PLACE * places.origins.len() as f32;
        let mut times = Times {
            by_contours: 0.0,
            by_rays: PER_RAY * directions.as_slice().len() as f32,
            allowed: allowed.max(LEAST_TIME),
        };
        let is_sparse = SPARSE * samples.len() < places.origins.len();
        if is_sparse || plain.takes(&times) <= times.allowed {
            plain.by_rays = false;
            return plain;
        }
        let counted = counted(contours, &places.origins, &samples, directions);
        times.by_contours = PER_SAMPLE + PER_CONTOUR * counted;
        plain.by_rays = times.by_rays < FASTER * times.by_contours;
        if plain.takes(&times) <= times.allowed {
            return plain;
        }
        let clutter = Clutter::new(&places.origins, &places.corners);
        (plain.sharing(&clutter, distances, &times))
            .unwrap_or_else(|| plain.sparser(sparse, &times))
    }

    /// About how long samples and light take, seconds.
    fn takes(&self, times: &Times) -> f32 {
        self.takes_with(times.sample(self.by_rays))
    }

    fn takes_with(&self, sample: f32) -> f32 {
        let [samples, lights] = [&self.seen, &self.light].map(|all| all.sampled().len() as f32);
        samples * sample + lights * PER_LIGHT
    }

    /// With what small pieces share, if that is enough.
    fn sharing(&self, clutter: &Clutter, distances: &[f32], times: &Times) -> Option<Self> {
        let most_lights = (LIGHT_SHARE * times.allowed / PER_LIGHT) as usize;
        let light = clutter.shared(&self.light, distances, most_lights);
        let light = light.unwrap_or_else(|| self.light.clone());
        let left = times.allowed - light.sampled().len() as f32 * PER_LIGHT;
        let left = left.max(LEAST_TIME);
        // Fewer samples are of more of the surface each, and have fewer contours in common.
        let all = self.seen.sampled().len();
        let apart = (all as f32 * times.by_contours / left).max(1.0);
        let by_rays = times.by_rays < apart * times.by_contours;
        let most = (left / times.sample(by_rays)) as usize;
        let seen = clutter.shared(&self.seen, distances, most)?;
        Some(Self {
            shared: Some([seen.sampled().len(), all]),
            by_rays,
            light,
            seen,
        })
    }

    /// With fewer samples and points of light: `sparse` makes those that are so many times as far apart.
    fn sparser(self, sparse: impl Fn(f32) -> (Sparse, Sparse), times: &Times) -> Self {
        let by_rays = times.by_rays < times.by_contours;
        let sample = times.sample(by_rays);
        if self.takes_with(sample) < BEYOND * times.allowed {
            return self;
        }
        let mut found = Self { by_rays, ..self };
        let mut factor = 1.0;
        loop {
            let beyond = found.takes_with(sample) / times.allowed;
            if beyond <= 1.0 || factor >= SPARSEST {
                return found;
            }
            factor = (factor * beyond.clamp(LEAST_STEP, MOST_STEP)).min(SPARSEST);
            (found.seen, found.light) = sparse(factor);
        }
    }
}

/// What a sample takes by contours and by rays, and what all samples and points of light may take, seconds.
struct Times {
    by_contours: f32,
    by_rays: f32,
    allowed: f32,
}

impl Times {
    fn sample(&self, by_rays: bool) -> f32 {
        if by_rays {
            self.by_rays
        } else {
            self.by_contours
        }
    }
}

/// Whether so many of all are few enough for some to be shared.
fn is_few(count: usize, all: usize) -> bool {
    count as f32 <= LEFT * all as f32
}

/// Of every place, whether the piece that it belongs to may be small beside the distances between samples.
fn of_small_pieces(places: &Places, distance: impl Fn(Vec3) -> f32) -> Vec<bool> {
    let (pieces, sizes) = pieces(&places.origins, &places.corners);
    let mut small = vec![true; sizes.len()];
    for (piece, origin) in pieces.iter().zip(&places.origins) {
        let piece = *piece as usize;
        small[piece] &= sizes[piece] <= LARGEST * distance(*origin);
    }
    pieces.iter().map(|&piece| small[piece as usize]).collect()
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

/// A level, a cell of it, and a facet of normals.
type Key = (i32, [i32; 3], [i32; 3]);

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
        for triangle in triangles {
            let [a, b, c] = triangle.map(|place| origins[place as usize]);
            for place in triangle {
                normals[*place as usize] += (b - a).cross(c - a);
            }
        }
        for normal in &mut normals {
            *normal = normal.normalize_or_zero();
        }
        let (pieces, sizes) = pieces(origins, triangles);
        Self {
            sizes: pieces.iter().map(|&piece| sizes[piece as usize]).collect(),
            origins,
            normals,
        }
    }

    /// Fewer samples, at most about `most` if small pieces can share so many; `distances` apart otherwise. Nothing if that
    /// leaves nearly all.
    fn shared(&self, sparse: &Sparse, distances: &[f32], most: usize) -> Option<Sparse> {
        let all = sparse.sampled();
        let is_large = |place: u32| {
            let place = place as usize;
            self.sizes[place] > LARGEST * distances[place]
        };
        // Those of large pieces stay, however much room the others get.
        let large = all.iter().filter(|&&place| is_large(place)).count();
        if all.len() <= most || !is_few(large, all.len()) {
            return None;
        }
        // Those that share, by their keys, each with the one that is sampled.
        let share = |tried: i32| {
            let room = WIDER.powi(tried);
            let keyed = all.par_iter().filter_map(|&place| {
                Some((self.key(place, distances[place as usize], room)?, place))
            });
            let mut keyed: Vec<(Key, u32)> = keyed.collect();
            keyed.par_sort_unstable();
            let sharing = keyed.len();
            keyed.dedup_by_key(|(key, _)| *key);
            let left = all.len() - sharing + keyed.len();
            (left, room, keyed)
        };
        // The least room in which few enough are left.
        let (mut low, mut high) = (0, TRIES - 1);
        while low < high {
            let middle = i32::midpoint(low, high);
            if share(middle).0 <= most {
                high = middle;
            } else {
                low = middle + 1;
            }
        }
        let (left, room, keyed) = share(low);
        let source = |place: u32| {
            let key = self.key(place, distances[place as usize], room)?;
            let index = keyed.binary_search_by_key(&key, |(key, _)| *key).ok()?;
            Some(keyed[index].1)
        };
        is_few(left, all.len()).then(|| sparse.replaced(source))
    }

    /// Places of equal keys share a sample, in so many times their distance. Nothing for those of pieces that are not small.
    fn key(&self, place: u32, distance: f32, room: f32) -> Option<Key> {
        if self.sizes[place as usize] > (SMALL * room).min(LARGEST) * distance {
            return None;
        }
        let room = room * distance;
        let level = (LEVELS * math::log2(room.max(f32::MIN_POSITIVE))).round();
        let cell = (self.origins[place as usize] / math::exp2(level / LEVELS)).floor();
        let normal = self.normals[place as usize];
        let facet = normal / normal.abs().max_element().max(f32::MIN_POSITIVE);
        let facet = (FACETS * facet).round();
        let [cell, facet] = [cell, facet].map(|at| at.as_ivec3().to_array());
        Some((level as i32, cell, facet))
    }
}

/// The piece that each place belongs to, and the diagonal of the box about each, metres. `triangles` have places for corners.
fn pieces(origins: &[Vec3], triangles: &[[u32; 3]]) -> (Vec<u32>, Vec<f32>) {
    let mut pieces = Groups::new(origins.len());
    for [a, b, c] in triangles {
        pieces.join(*a, *b);
        pieces.join(*a, *c);
    }
    let (count, pieces) = pieces.numbered();
    let mut boxes = vec![(Vec3::INFINITY, Vec3::NEG_INFINITY); count];
    for (piece, origin) in pieces.iter().zip(origins) {
        let (low, high) = &mut boxes[*piece as usize];
        (*low, *high) = (low.min(*origin), high.max(*origin));
    }
    let sizes = boxes.iter().map(|(low, high)| low.distance(*high));
    (pieces, sizes.collect())
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
            let all = sparse(&origins, &corners, &distances).sampled().len();
            let places = Places {
                origins: origins.iter().map(|origin| *origin + 1e-4).collect(),
                corners: corners.clone(),
                ..Places::default()
            };
            let contours = ContourMesh::new(&mesh);
            let directions = Directions::new(side);
            let drafted = Drafted::by_places(&places, &distances, &contours, &directions);
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
        let finer = drafted(20_000, 128).0;
        assert!(!finer.by_rays && finer.shared.is_some());
    }

    #[test]
    fn one_large_piece_has_fewer_samples_where_they_would_take_too_long() {
        let (origins, triangles) = grid(60, |_, _| 0.0);
        let spaced = |factor: f32| sparse(&origins, &triangles, &vec![1.5 * factor; origins.len()]);
        let both = |factor: f32| (spaced(factor), spaced(2.5 * factor));
        let drafted = |allowed: f32| {
            let (seen, light) = both(1.0);
            let plain = Drafted {
                seen,
                light,
                shared: None,
                by_rays: false,
            };
            let times = Times {
                by_contours: 3e-3,
                by_rays: 1e-3,
                allowed,
            };
            let before = plain.takes_with(times.by_rays);
            let after = plain.sparser(both, &times);
            (before, after.takes(&times), after)
        };
        let (before, ..) = drafted(1.0);
        // A little is let be, and by contours as it was.
        let (_, _, same) = drafted(before / 1.1);
        assert!(!same.by_rays && same.seen == both(1.0).0);
        let (_, after, fewer) = drafted(before / 3.0);
        assert!(fewer.by_rays && fewer.shared.is_none());
        assert!(
            (0.1 * before..before / 3.0).contains(&after),
            "{after} of {before}"
        );
        for place in 0..origins.len() as u32 {
            let sum: f32 = fewer
                .seen
                .sources(place)
                .iter()
                .map(|(_, weight)| weight)
                .sum();
            assert!((sum - 1.0).abs() < 1e-4);
        }
        // It does not go on for ever.
        let (_, after, _) = drafted(before / 1e4);
        assert!(after > before / 1e4);
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
