//! Flats: neighbouring triangles of nearly one plane, as those of a quad, of a floor, or of a mesh that is divided finer
//! than its shape asks for.
//!
//! From almost everywhere all of them are seen from one side, so that they are looked at as one, and no edge between them
//! is a contour. The planes of small triangles differ by the rounding of their corners: from points so close to the flat's
//! plane that this may tell, each triangle is looked at. What is found is the same to the bit.

use glam::DVec3;

/// The most triangles of a flat: each may have to be looked at.
const MOST: usize = 64;
/// How far apart the planes of a flat may be anywhere in the mesh's box, in its diagonals.
const APART: f64 = 2e-4;
/// Where flats are more than this share of the triangles, they save less than it takes to look closely.
const MANY: f64 = 0.875;
/// Stands for the neighbour of a triangle that has none.
const NONE: u32 = u32::MAX;

/// Triangles by flats.
pub(super) struct Flats {
    /// Numbers of the triangles, flat after flat. The first of a flat is the largest; its plane stands for all.
    triangles: Vec<u32>,
    /// Where each flat begins, and where the last one ends.
    first: Vec<u32>,
    /// Of each flat.
    spreads: Vec<Spread>,
    /// Where those are told from.
    pub(super) centre: DVec3,
}

/// How far a point may be from the plane of a flat that lies on or between those of its triangles. That grows with the
/// point's distance from a centre.
#[derive(Clone, Copy, Default)]
pub(super) struct Spread {
    /// How far that is at the centre.
    there: f32,
    /// How much farther for every unit of length away from it.
    growth: f32,
}

impl Spread {
    /// Of a point at that distance from the centre.
    #[inline(always)]
    pub(super) fn at(self, distance: f32) -> f32 {
        self.there + self.growth * distance
    }

    /// One that is as large as both.
    pub(super) fn max(self, other: Self) -> Self {
        Self {
            there: self.there.max(other.there),
            growth: self.growth.max(other.growth),
        }
    }
}

/// A triangle's plane: its normal, of unit length, that times a point of it, and the triangle's area.
#[derive(Clone, Copy)]
pub(super) struct Plane {
    pub(super) normal: DVec3,
    pub(super) distance: f64,
    pub(super) area: f64,
}

impl Plane {
    /// How far the other plane is apart.
    fn spread(self, other: Self, centre: DVec3) -> [f64; 2] {
        let turned = other.normal - self.normal;
        let there = turned.dot(centre) - (other.distance - self.distance);
        [there.abs(), turned.length()]
    }
}

impl Flats {
    /// Of so many triangles, unless there are hardly any. `neighbours` are pairs of them that share an edge and are wound alike; the box is
    /// that of the mesh.
    pub(super) fn new<P: Fn(u32) -> Plane>(
        count: usize,
        plane: P,
        neighbours: impl Iterator<Item = [u32; 2]> + Clone,
        [low, high]: [DVec3; 2],
    ) -> Option<Self> {
        let mut growing = Growing {
            plane,
            around: Vec::new(),
            radius: 0.5 * low.distance(high),
            taken: Vec::new(),
            flats: Self {
                triangles: Vec::new(),
                first: vec![0],
                spreads: Vec::new(),
                centre: low.midpoint(high),
            },
        };
        // Each such pair makes one flat of two at most: most meshes have few.
        let most = (MANY * count as f64) as usize;
        let pairs = neighbours.clone().filter(|pair| growing.may_join(*pair));
        if count - pairs.count().min(count) > most {
            return None;
        }
        growing.taken = vec![false; count];
        growing.around = vec![[NONE; 3]; count];
        for [a, b] in neighbours {
            for (one, other) in [(a, b), (b, a)] {
                let mut slots = growing.around[one as usize].iter_mut();
                if let Some(slot) = slots.find(|slot| **slot == NONE) {
                    *slot = other;
                }
            }
        }
        // The largest are rounded least.
        let mut seeds: Vec<u32> = (0..count as u32).collect();
        let area = |triangle: &u32| (growing.plane)(*triangle).area;
        let areas: Vec<f64> = seeds.iter().map(area).collect();
        seeds.sort_by(|&a, &b| areas[b as usize].total_cmp(&areas[a as usize]));
        for seed in seeds {
            growing.grow(seed);
        }
        Some(growing.flats).filter(|flats| flats.count() <= most)
    }

    pub(super) fn count(&self) -> usize {
        self.first.len() - 1
    }

    /// The triangles of a flat.
    pub(super) fn of(&self, flat: u32) -> &[u32] {
        let [from, to] = [0, 1].map(|next| self.first[flat as usize + next] as usize);
        &self.triangles[from..to]
    }

    pub(super) fn spread(&self, flat: u32) -> Spread {
        self.spreads[flat as usize]
    }
}

/// Flats that are being made.
struct Growing<P> {
    /// Of a triangle.
    plane: P,
    /// The neighbours of every triangle.
    around: Vec<[u32; 3]>,
    /// Of the sphere around the mesh's box.
    radius: f64,
    /// Triangles that some flat has.
    taken: Vec<bool>,
    flats: Flats,
}

impl<P: Fn(u32) -> Plane> Growing<P> {
    /// Whether two triangles may be of one flat.
    fn may_join(&self, [a, b]: [u32; 2]) -> bool {
        let [there, growth] = (self.plane)(a).spread((self.plane)(b), self.flats.centre);
        // Each as far from a third one as may be, on either side.
        there + growth * self.radius <= 4.0 * APART * self.radius
    }

    /// Makes a flat around a triangle, unless some flat has it.
    fn grow(&mut self, seed: u32) {
        if std::mem::replace(&mut self.taken[seed as usize], true) {
            return;
        }
        let begin = self.flats.triangles.len();
        self.flats.triangles.push(seed);
        self.flats.spreads.push(Spread::default());
        let plane = (self.plane)(seed);
        let mut next = begin;
        while let Some(&triangle) = self.flats.triangles.get(next) {
            for other in self.around[triangle as usize] {
                let is_free = other != NONE && !self.taken[other as usize];
                if is_free && self.flats.triangles.len() - begin < MOST {
                    self.join(plane, other);
                }
            }
            next += 1;
        }
        self.flats.first.push(self.flats.triangles.len() as u32);
    }

    /// Adds a triangle to the last flat if it lies almost in its plane.
    fn join(&mut self, plane: Plane, triangle: u32) {
        let [there, growth] = plane.spread((self.plane)(triangle), self.flats.centre);
        if there + growth * self.radius <= 2.0 * APART * self.radius {
            self.taken[triangle as usize] = true;
            self.flats.triangles.push(triangle);
            // A little more than what is rounded.
            let [there, growth] = [there, growth].map(|x| (1.0001 * x) as f32);
            if let Some(spread) = self.flats.spreads.last_mut() {
                *spread = spread.max(Spread { there, growth });
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use glam::Vec3;

    use crate::visibility::contour::tests::{assert_same_bits, ground, random_point};
    use crate::visibility::contour::{ContourMesh, MOST_TOUCHED};
    use crate::visibility::tests::random;
    use crate::visibility::{self, Directions};

    /// Each triangle as four, again and again; what they share is rounded alike.
    fn divided(mut triangles: Vec<[Vec3; 3]>, times: usize) -> Vec<[Vec3; 3]> {
        for _ in 0..times {
            let parts = triangles.iter().flat_map(|&[a, b, c]| {
                let [d, e, f] = [a.midpoint(b), b.midpoint(c), c.midpoint(a)];
                [[a, d, f], [d, b, e], [f, e, c], [d, e, f]]
            });
            triangles = parts.collect();
        }
        triangles
    }

    /// Ridged and tilted, so that nothing is exact.
    fn ridges(state: &mut u64) -> Vec<[Vec3; 3]> {
        ground(5, state, |[u, v], random| 0.3 * u - 0.2 * v + 0.2 * random)
    }

    #[test]
    fn what_is_divided_finer_has_as_many_flats_as_it_had_triangles() {
        let triangles = ridges(&mut 3);
        for times in 1..4 {
            let mesh = ContourMesh::new(&divided(triangles.clone(), times));
            assert_eq!(mesh.facing.flats(), triangles.len(), "{times} times");
            assert_eq!(mesh.facing.regular_edges(), 65 << times);
        }
        // A flat of more than there may be, and one that is none.
        let quad = [Vec3::ZERO, Vec3::Z, Vec3::X + Vec3::Z, Vec3::X];
        let quad = vec![[quad[0], quad[1], quad[2]], [quad[0], quad[2], quad[3]]];
        let many = ContourMesh::new(&divided(quad, 5)).facing.flats();
        assert!((2048 / super::MOST..200).contains(&many), "{many}");
        let rough = ContourMesh::new(&triangles);
        assert_eq!(rough.facing.flats(), triangles.len());
        assert_eq!(rough.facing.widest_at(Vec3::ONE), 0.0);
    }

    #[test]
    fn points_on_flats_and_in_their_planes_give_the_same_bits() {
        let mut state = 8;
        let mut coarse = ridges(&mut state);
        // A fin stands on it: edges of three triangles.
        let [a, b, _] = coarse[20];
        coarse.push([a, b, a.midpoint(b) + 0.3 * Vec3::Y]);
        let triangles = divided(coarse.clone(), 3);
        let mut origins = Vec::new();
        for index in 0..200 {
            let [a, b, c] = coarse[index % coarse.len()];
            let normal = (b - a).cross(c - a).normalize();
            // On the flat, or beyond it.
            let wide = if index % 3 == 0 { 1.0 } else { 8.0 };
            let [u, v] = [0; 2].map(|_| 0.5 + wide * (random(&mut state) - 0.5));
            let height = [0.0, 1e-8, 1e-7, -1e-7, 1e-6, -1e-5, 1e-4, 1e-3][index % 8];
            origins.push(a + 0.5 * (u * (b - a) + v * (c - a)) + height * normal);
        }
        // On its corners, as vertices of the mesh are.
        origins.extend(
            triangles
                .iter()
                .step_by(97)
                .map(|[a, ..]| *a + 1e-4 * Vec3::Y),
        );
        let far = (0..20).map(|_| 30.0 * random_point(&mut state));
        origins.extend(far);
        assert_same_bits(&triangles, &origins, 64);

        // Some of them ask for a closer look, and touch some triangles of a flat.
        let mesh = ContourMesh::new(&triangles);
        let directions = Directions::new(64);
        let mut scratch = mesh.scratch(&directions);
        let (mut parted, mut touched) = (0, 0);
        for origin in origins {
            let (found, _) = mesh.sample(origin, &directions, &mut scratch);
            let seen = scratch.candidates.touched().count();
            parted += usize::from(scratch.candidates.faces().are_parted());
            touched += usize::from((1..=MOST_TOUCHED).contains(&seen));
            mesh.crossings(&found, &mut scratch);
            let exact = visibility::sample(mesh.caster(), origin, &directions);
            assert!(found == exact, "{origin}");
        }
        assert!(
            parted > touched && touched > 20,
            "{parted} parted, {touched} touched"
        );
    }
}
