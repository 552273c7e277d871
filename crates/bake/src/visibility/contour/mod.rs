//! Visibility from contours: the bits of one ray per texel for the price of a few rays.
//!
//! Along a direction a ray crosses some number of surface layers; it is visible where that
//! number is zero. Seen from a point, an edge whose triangles lie on both sides of the plane
//! through the edge and the point changes nothing: one layer ends where the other begins.
//! Layers begin and end at *contour* edges alone, those whose triangles lie more to one
//! side. So the differences between neighbouring texels are sums over the contours that
//! pass between their centres (`layers`), their prefix sums are the layers of every texel
//! up to one constant, and a single ray, at a texel where layers are fewest, fixes that
//! constant: if it is visible, texels of as few layers are visible; if it is blocked, every
//! texel is (compare quantitative invisibility, Appel 1967).
//!
//! The result equals one ray per texel. Texels within rounding of a contour get a ray of
//! their own, and sums around the map, which must vanish, are checked: where they do not,
//! rays are cast. Triangles that the point itself lies on are not counted: whether a ray meets
//! them is a matter of its arithmetic, so they are tried one by one, in directions in which
//! nothing else is.

mod batch;
mod candidates;
mod crossings;
mod edges;
mod faces;
mod facing;
mod flats;
mod layers;
mod level;
mod loose;
mod parts;
mod rounds;

use std::collections::{HashMap, HashSet};
use std::ops::{Deref, DerefMut};
use std::sync::{Mutex, PoisonError};

use glam::Vec3;

use crate::visibility::ray::{self, RayCaster};
use crate::visibility::{self, Bitmap, Crossings, Directions};
use candidates::Candidates;
use facing::Facing;
use layers::Layers;
use parts::Parts;
use rounds::Rounds;

/// Points of a group, and of the runs in it, shorter and shorter, that what the group may see as contours is narrowed down for:
/// they follow one another and are close together. Each divides the one before.
pub const RUNS: [usize; 3] = [128, 32, 16];

/// A point that lies on more triangles, in a heap of them, asks a ray per direction what it sees.
const MOST_TOUCHED: usize = 32;

/// A mesh's edges, prepared for finding contours from any point, and what casts the few
/// rays.
pub struct ContourMesh {
    caster: RayCaster,
    /// See [`near`].
    near: Vec3,
    /// Welded vertex positions, from `near`.
    positions: Vec<Vec3>,
    facing: Facing,
    parts: Parts,
    /// Per triangle that the caster was made of, its welded vertices.
    vertices: Vec<[u32; 3]>,
    /// Those that are there more than once, by the same vertices in ascending order.
    repeated: HashMap<[u32; 3], Vec<[u32; 3]>>,
    /// Memory that nobody uses at present: of large meshes it takes as long to get as to find what a group may see.
    unused: Mutex<Vec<Scratch>>,
}

/// An edge where layers begin or end, as seen from some point.
#[derive(Clone, Copy, Debug, Default)]
struct Contour {
    vertices: [u32; 2],
    /// Layers to the left of the edge, seen along its direction, less those to its right.
    step: i32,
}

/// What sampling one point after the other reuses.
pub struct Scratch {
    candidates: Candidates,
    layers: Layers,
    crossings: Crossings,
    rounds: Rounds,
    /// Places of the parts that are counted next.
    chosen: Vec<u32>,
}

impl Scratch {
    fn new(resolution: usize) -> Self {
        Self {
            candidates: Candidates::default(),
            layers: Layers::new(resolution),
            crossings: Crossings::default(),
            rounds: Rounds::default(),
            chosen: Vec::new(),
        }
    }
}

/// A mesh's [`Scratch`], which goes back to it.
pub struct Lent<'a> {
    unused: &'a Mutex<Vec<Scratch>>,
    scratch: Scratch,
}

impl Deref for Lent<'_> {
    type Target = Scratch;

    fn deref(&self) -> &Scratch {
        &self.scratch
    }
}

impl DerefMut for Lent<'_> {
    fn deref_mut(&mut self) -> &mut Scratch {
        &mut self.scratch
    }
}

impl Drop for Lent<'_> {
    fn drop(&mut self) {
        let scratch = std::mem::replace(&mut self.scratch, Scratch::new(0));
        let mut unused = self.unused.lock().unwrap_or_else(PoisonError::into_inner);
        unused.push(scratch);
    }
}

impl ContourMesh {
    /// Welds vertices of equal coordinates and collects edges. Triangles without area and
    /// repeated triangles are left out: neither changes what is visible.
    pub fn new(triangles: &[[Vec3; 3]]) -> Self {
        let bounds = bounds(triangles.as_flattened().iter().copied());
        let near = near(bounds);
        let mut ids = HashMap::new();
        let mut positions = Vec::new();
        let mut weld = |vertex: Vec3| {
            // Adding zero turns −0 into +0.
            *ids.entry((vertex + Vec3::ZERO).to_array().map(f32::to_bits))
                .or_insert_with(|| {
                    positions.push(vertex - near);
                    positions.len() as u32 - 1
                })
        };
        let mut seen = HashSet::new();
        let mut repeated: HashMap<_, Vec<_>> = HashMap::new();
        let mut welded = Vec::with_capacity(triangles.len());
        let mut all_vertices = Vec::with_capacity(triangles.len());
        for triangle in triangles {
            let [a, b, c] = triangle.map(Vec3::as_dvec3);
            let vertices = triangle.map(&mut weld);
            all_vertices.push(vertices);
            if (b - a).cross(c - a) == glam::DVec3::ZERO {
                continue;
            }
            if seen.insert(ascending(vertices)) {
                welded.push(vertices);
            } else {
                let again = repeated.entry(ascending(vertices)).or_default();
                again.push(vertices);
            }
        }
        let parts = Parts::new(&positions, &welded);
        Self {
            caster: RayCaster::new(triangles),
            facing: Facing::new(&positions, &welded, &parts),
            parts,
            vertices: all_vertices,
            repeated,
            near,
            positions,
            unused: Mutex::default(),
        }
    }

    /// How many triangles there are; those that lie on each other count once.
    pub(crate) fn triangles(&self) -> usize {
        self.vertices.len() - self.repeated.values().map(Vec::len).sum::<usize>()
    }

    /// Casts rays at the same triangles.
    pub fn caster(&self) -> &RayCaster {
        &self.caster
    }

    /// Memory for [`Self::sample`] at the directions' resolution.
    pub fn scratch(&self, directions: &Directions) -> Lent<'_> {
        let resolution = directions.resolution() as usize;
        let mut unused = self.unused.lock().unwrap_or_else(PoisonError::into_inner);
        let fits = |scratch: &Scratch| scratch.layers.resolution() == resolution;
        let found = unused.iter().position(fits);
        let found = found.map(|index| unused.swap_remove(index));
        Lent {
            unused: &self.unused,
            scratch: found.unwrap_or_else(|| Scratch::new(resolution)),
        }
    }

    /// Finds what the points between `origins` may see as contours. Points close together
    /// have most of it in common: sampling them is then several times faster. Best in [`RUNS`], see [`visibility::arrange`],
    /// sampled in their order.
    pub fn prepare(&self, origins: &[Vec3], scratch: &mut Scratch) {
        let origins: Vec<Vec3> = origins.iter().map(|origin| *origin - self.near).collect();
        let candidates = &mut scratch.candidates;
        candidates.prepare(&self.facing, &self.parts, &self.positions, &origins);
    }

    /// The same bitmap as [`crate::visibility::sample`], and the number of rays it took.
    pub fn sample(
        &self,
        origin: Vec3,
        directions: &Directions,
        scratch: &mut Scratch,
    ) -> (Bitmap, u32) {
        let eye = origin - self.near;
        if !scratch.candidates.covers(eye) {
            self.prepare(&[origin], scratch);
        }
        (scratch.candidates).look(&self.facing, &self.parts, &self.positions, eye);
        let found = self.count(origin, directions.as_slice(), scratch, false);
        let again = |vertices| self.repeated.get(&ascending(vertices)).map_or(0, Vec::len);
        let touched: usize = scratch.candidates.touched().map(|at| 1 + again(at)).sum();
        let (mut bitmap, rays) = found
            .filter(|_| touched <= MOST_TOUCHED)
            .unwrap_or_else(|| {
                let rays = directions.as_slice().len() as u32;
                (visibility::sample(&self.caster, origin, directions), rays)
            });
        if (1..=MOST_TOUCHED).contains(&touched) {
            self.try_touched(eye, directions, scratch, &mut bitmap);
        }
        (bitmap, rays)
    }

    /// How many contours are looked at to tell what is visible from a point, by itself.
    pub(crate) fn contours_from(
        &self,
        origin: Vec3,
        directions: &Directions,
        scratch: &mut Scratch,
    ) -> usize {
        self.prepare(&[origin], scratch);
        self.sample(origin, directions, scratch);
        scratch.rounds.contours()
    }

    /// Takes from what is visible what the triangles hide that the point looked at last lies on.
    fn try_touched(
        &self,
        eye: Vec3,
        directions: &Directions,
        scratch: &mut Scratch,
        bitmap: &mut Bitmap,
    ) {
        let Scratch {
            candidates, layers, ..
        } = scratch;
        for vertices in candidates.touched() {
            let again = self.repeated.get(&ascending(vertices));
            for vertices in [vertices].iter().chain(again.into_iter().flatten()) {
                let triangle = vertices.map(|vertex| self.positions[vertex as usize]);
                bitmap.retain(|texel| !ray::meets(triangle, eye, directions.as_slice()[texel]));
            }
        }
        // Where they end counts for `crossings`.
        let contours = candidates.contours_of_touched(&self.parts, &self.positions);
        layers.count([contours].into_iter());
    }

    /// What contours tell of what the point looked at last sees past the triangles that it lies on, if
    /// anything. `at_once`: no part of the mesh is left out.
    fn count(
        &self,
        origin: Vec3,
        directions: &[Vec3],
        scratch: &mut Scratch,
        at_once: bool,
    ) -> Option<(Bitmap, u32)> {
        let Scratch {
            candidates,
            layers,
            rounds,
            chosen,
            ..
        } = scratch;
        let eye = origin - self.near;
        let (mut rays, mut before) = (0, None);
        layers.begin(eye);
        rounds.begin(candidates, at_once);
        loop {
            rounds.choose(candidates, chosen);
            candidates.find(&self.parts, &self.positions, chosen);
            layers.count(candidates.contours(chosen));
            layers.count_loose(
                directions,
                candidates.loose(&self.parts, chosen),
                rounds.open(),
            );
            let counted = |triangle: usize| {
                let vertices = self.vertices[triangle];
                let alike = |touched| ascending(touched) == ascending(vertices);
                rounds.is_counted(self.parts.of_vertex(vertices[0]))
                    && !candidates.touched().any(alike)
            };
            let open = layers.resolve(
                before.as_ref(),
                &mut rays,
                |texel| !(self.caster).any_hit_of(origin, directions[texel], counted),
                |texel| !self.caster.any_hit(origin, directions[texel]),
            );
            if let Some(open) = open {
                rounds.cull(candidates, eye, &open, layers.resolution());
                before = Some(open);
            } else {
                // Where contours lie is still asked for.
                before = None;
                rounds.leave_none();
            }
            if rounds.is_over() {
                return Some((before?, rays));
            }
        }
    }

    /// Where contours separate visible from blocked texels, at the point that `scratch`
    /// sampled last, which gave `visible`.
    pub fn crossings<'a>(&self, visible: &Bitmap, scratch: &'a mut Scratch) -> &'a Crossings {
        let Scratch {
            crossings, layers, ..
        } = scratch;
        crossings::locate(layers, &self.parts.bundles, visible, crossings);
        crossings
    }
}

/// What the coordinates of a mesh within these bounds are counted from that lies far from zero, so that planes are as exact as its points: a
/// corner of its box, on those axes on which differences to that are exact, of points in the box or near it (Sterbenz
/// 1974).
fn near((low, high): (Vec3, Vec3)) -> Vec3 {
    // Of nothing.
    if low.x > high.x {
        return Vec3::ZERO;
    }
    let of_axis = |low: f32, high: f32| {
        if low > 0.0 && high <= 2.0 * low {
            low
        } else if high < 0.0 && low >= 2.0 * high {
            high
        } else {
            0.0
        }
    };
    Vec3::new(
        of_axis(low.x, high.x),
        of_axis(low.y, high.y),
        of_axis(low.z, high.z),
    )
}

/// Lowest and highest corner of the box of points; infinite, the wrong way about, of none.
fn bounds(points: impl Iterator<Item = Vec3>) -> (Vec3, Vec3) {
    points.fold(
        (Vec3::INFINITY, Vec3::NEG_INFINITY),
        |(low, high), point| (low.min(point), high.max(point)),
    )
}

/// Three numbers in order.
fn ascending(mut numbers: [u32; 3]) -> [u32; 3] {
    numbers.sort_unstable();
    numbers
}

#[cfg(test)]
mod tests {
    use relight_format::math;
    use relight_shading::octahedral::{self, Footprint};

    use super::*;
    use crate::ssdf;
    use crate::visibility::tests::random;

    #[test]
    fn the_example_of_the_readme() {
        let at = |[x, y]: [f32; 2]| {
            let [u, v] = [x, y].map(|texel| (texel - 7.5) / 8.0);
            Vec3::new(u, 1.0 - u - v, v)
        };
        let triangle = [[8.25, 8.25], [13.25, 8.25], [8.25, 13.25]].map(at);
        assert_eq!(triangle[0], Vec3::new(0.09375, 0.8125, 0.09375));
        let contours = ContourMesh::new(&[triangle]);
        let directions = Directions::new(16);
        let mut scratch = contours.scratch(&directions);
        let (bitmap, rays) = contours.sample(Vec3::ZERO, &directions, &mut scratch);
        assert_eq!(rays, 1);
        for (x, y) in (0..16).flat_map(|x| (0..16).map(move |y| (x, y))) {
            let blocked = x >= 9 && y >= 9 && x + y <= 21;
            assert_eq!(bitmap.get(y * 16 + x), !blocked, "{x}, {y}");
        }
        assert_eq!((0..256).filter(|&texel| !bitmap.get(texel)).count(), 10);
    }

    /// Ground from −1 to 1, of so many cells a side. `height` is told where, and a random number.
    pub(super) fn ground(
        side: usize,
        state: &mut u64,
        height: impl Fn([f32; 2], f32) -> f32,
    ) -> Vec<[Vec3; 3]> {
        let heights: Vec<f32> = (0..(side + 1).pow(2)).map(|_| random(state)).collect();
        let at = |x: usize, z: usize| {
            let [u, v] = [x, z].map(|i| 2.0 * i as f32 / side as f32 - 1.0);
            Vec3::new(u, height([u, v], heights[z * (side + 1) + x]), v)
        };
        let cells = (0..side).flat_map(|z| (0..side).map(move |x| (x, z)));
        let halves = cells.flat_map(|(x, z)| {
            let [a, b, c, d] = [at(x, z), at(x + 1, z), at(x + 1, z + 1), at(x, z + 1)];
            [[a, d, c], [a, c, b]]
        });
        halves.collect()
    }

    pub(super) fn random_point(state: &mut u64) -> Vec3 {
        Vec3::new(random(state), random(state), random(state)) * 2.0 - 1.0
    }

    fn sphere(centre: Vec3, radius: f32, n: u32) -> Vec<[Vec3; 3]> {
        let at = |i: u32, j: u32| {
            let theta = std::f32::consts::PI * j as f32 / n as f32;
            let phi = std::f32::consts::TAU * (i % (2 * n)) as f32 / (2 * n) as f32;
            let pole = j == 0 || j == n;
            let ring = if pole { 0.0 } else { math::sin(theta) };
            centre
                + radius
                    * Vec3::new(
                        ring * math::cos(phi),
                        math::cos(theta),
                        ring * math::sin(phi),
                    )
        };
        (0..n)
            .flat_map(|j| (0..2 * n).map(move |i| (i, j)))
            .flat_map(|(i, j)| {
                [
                    [at(i, j), at(i + 1, j), at(i + 1, j + 1)],
                    [at(i, j), at(i + 1, j + 1), at(i, j + 1)],
                ]
            })
            .collect()
    }

    pub(super) fn assert_same_bits(
        triangles: &[[Vec3; 3]],
        origins: &[Vec3],
        resolution: u32,
    ) -> u64 {
        let caster = RayCaster::new(triangles);
        let mesh = ContourMesh::new(triangles);
        let directions = Directions::new(resolution);
        let mut scratch = mesh.scratch(&directions);
        let mut total = 0;
        for (index, &origin) in origins.iter().enumerate() {
            // Some points by themselves, the others in groups that are far too wide.
            if index % 12 == 6 {
                let group = &origins[index..origins.len().min(index + 6)];
                mesh.prepare(group, &mut scratch);
            }
            let exact = visibility::sample(&caster, origin, &directions);
            let (fast, rays) = mesh.sample(origin, &directions, &mut scratch);
            let wrong = (0..(resolution * resolution) as usize)
                .filter(|&texel| exact.get(texel) != fast.get(texel))
                .count();
            assert_eq!(wrong, 0, "{wrong} texels differ at origin {index} {origin}");
            total += u64::from(rays);
        }
        total
    }

    #[test]
    fn closed_surfaces_give_the_bits_of_one_ray_per_texel() {
        let mut state = 3;
        let mut triangles = sphere(Vec3::new(0.2, 0.1, -0.3), 0.5, 20);
        triangles.extend(sphere(Vec3::new(-0.5, 0.6, 0.2), 0.25, 12));
        let origins: Vec<Vec3> = (0..60).map(|_| random_point(&mut state) * 1.5).collect();
        let rays = assert_same_bits(&triangles, &origins, 64);
        assert!(rays < 60 * 64 * 64 / 20, "components are few: {rays} rays");
    }

    #[test]
    fn soups_with_boundaries_and_shared_planes_give_the_same_bits() {
        let mut state = 11;
        let mut triangles: Vec<[Vec3; 3]> = (0..60)
            .map(|_| {
                let centre = random_point(&mut state);
                [0; 3].map(|_| centre + 0.3 * random_point(&mut state))
            })
            .collect();
        // Axis-aligned faces put contours on octant borders and through texel centres.
        for axis in 0..3 {
            let quad = [[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]].map(|[a, b]| {
                let mut p = [0.25; 3];
                p[(axis + 1) % 3] = a;
                p[(axis + 2) % 3] = b;
                Vec3::from(p)
            });
            triangles.push([quad[0], quad[1], quad[2]]);
            triangles.push([quad[0], quad[2], quad[3]]);
            triangles.push([quad[2], quad[1], quad[0]]);
        }
        triangles.push([Vec3::ONE, Vec3::ONE, Vec3::X]);
        let mut origins: Vec<Vec3> = (0..60).map(|_| random_point(&mut state)).collect();
        origins.extend([
            Vec3::ZERO,
            Vec3::new(0.5, 0.0, 0.0),
            Vec3::new(0.0, -0.5, 0.0),
        ]);
        assert_same_bits(&triangles, &origins, 32);
    }

    #[test]
    fn surface_points_give_the_same_bits() {
        let triangles = sphere(Vec3::ZERO, 1.0, 30);
        let origins: Vec<Vec3> = triangles
            .iter()
            .step_by(37)
            .map(|[a, b, c]| (*a + *b + *c) / 3.0 * 1.0001)
            .collect();
        assert_same_bits(&triangles, &origins, 64);
    }

    #[test]
    fn meshes_far_from_zero_take_no_more_rays() {
        for far in [Vec3::new(1e4, 0.0, -2e4), Vec3::splat(3e5)] {
            // Rounded to what coordinates there can be.
            let ball = sphere(Vec3::ZERO, 1.0, 24);
            let moved = ball
                .iter()
                .map(|triangle| triangle.map(|point| point + far));
            let moved: Vec<_> = moved.collect();
            let back: Vec<_> = (moved.iter())
                .map(|triangle| triangle.map(|point| point - far))
                .collect();
            let origins: Vec<Vec3> = (ball.iter().step_by(31))
                .map(|[a, b, c]| (*a + *b + *c) / 3.0 * 1.1 + far)
                .collect();
            let near: Vec<Vec3> = origins.iter().map(|origin| origin - far).collect();
            let rays = [(back, near), (moved, origins)]
                .map(|(triangles, origins)| assert_same_bits(&triangles, &origins, 64));
            assert_eq!(rays[0], rays[1]);
        }
    }

    #[test]
    fn points_on_other_surfaces_give_the_same_bits() {
        // A box stands on a floor: its lower corners and what lies between are on both.
        let mut triangles = Vec::new();
        let mut quad = |corners: [[f32; 3]; 4]| {
            let [a, b, c, d] = corners.map(Vec3::from);
            triangles.extend([[a, b, c], [a, c, d]]);
        };
        quad([
            [-3.0, 0.0, -3.0],
            [-3.0, 0.0, 3.0],
            [3.0, 0.0, 3.0],
            [3.0, 0.0, -3.0],
        ]);
        quad([
            [-1.0, 0.0, 1.0],
            [1.0, 0.0, 1.0],
            [1.0, 2.0, 1.0],
            [-1.0, 2.0, 1.0],
        ]);
        quad([
            [1.0, 0.0, 1.0],
            [1.0, 0.0, -1.0],
            [1.0, 2.0, -1.0],
            [1.0, 2.0, 1.0],
        ]);
        let origins = [
            [-1.0, 0.0, 1.001],
            [1.001, 0.0, 1.001],
            [0.5, 0.0, 1.0],
            [1.0, 1.0, 1.0],
            [0.3, 1.2, 1.0],
            [1.001, 0.0, -1.0],
            [0.0, 0.0, 2.0],
            [0.0, 1e-9, 2.0],
            [0.0, 1e-3, 2.0],
        ];
        let origins = origins.map(Vec3::from);
        let rays = assert_same_bits(&triangles, &origins, 64);
        assert!(rays < 64 * 64, "{rays} rays from {} points", origins.len());
        // The same with faces twice, from other corners on and turned over.
        let again: Vec<_> = (triangles.iter())
            .flat_map(|&[a, b, c]| [[b, c, a], [c, b, a]])
            .collect();
        triangles.extend(again);
        assert_same_bits(&triangles, &origins, 64);
        // And in a heap.
        let heap: Vec<_> = (triangles.iter())
            .flat_map(|triangle| [*triangle; MOST_TOUCHED])
            .collect();
        assert_same_bits(&heap, &origins, 16);
        // Anywhere on faces of boxes that pass through one another.
        let mut state = 5;
        let triangles = town(&mut state);
        let on_faces: Vec<Vec3> = (0..60)
            .map(|_| {
                let [a, b, c] = triangles[(random(&mut state) * 1800.0) as usize];
                let (u, v) = (random(&mut state), random(&mut state));
                a + 0.5 * (u * (b - a) + v * (c - a))
            })
            .collect();
        let rays = assert_same_bits(&triangles, &on_faces, 64);
        assert!(rays < 60 * 64 * 64 / 4, "{rays} rays");
    }

    /// A town: boxes, each of which hangs together, among loose triangles and cards of two.
    fn town(state: &mut u64) -> Vec<[Vec3; 3]> {
        let mut triangles = Vec::new();
        for _ in 0..150 {
            let low = random_point(state) * Vec3::new(4.0, 0.2, 4.0);
            let size = Vec3::new(random(state), 2.0 * random(state), random(state)) * 0.6 + 0.05;
            let corner =
                |i: usize| low + size * Vec3::from([0, 1, 2].map(|axis| (i >> axis & 1) as f32));
            for [a, b, c, d] in [
                [0, 2, 3, 1],
                [4, 5, 7, 6],
                [0, 1, 5, 4],
                [2, 6, 7, 3],
                [0, 4, 6, 2],
                [1, 3, 7, 5],
            ] {
                let [a, b, c, d] = [a, b, c, d].map(corner);
                triangles.extend([[a, b, c], [a, c, d]]);
            }
        }
        triangles.extend((0..3000).map(|_| {
            let centre = random_point(state) * Vec3::new(4.0, 1.0, 4.0);
            [0; 3].map(|_| centre + 0.1 * random_point(state))
        }));
        // Cards, bent along a diagonal; some are wound two ways.
        for i in 0..300 {
            let centre = random_point(state) * Vec3::new(4.0, 1.0, 4.0);
            let [a, b, c, d] = [0; 4].map(|_| centre + 0.2 * random_point(state));
            let other = if i % 10 == 0 { [a, d, c] } else { [a, c, d] };
            triangles.extend([[a, b, c], other]);
        }
        triangles
    }

    #[test]
    fn what_lies_behind_other_parts_is_left_out_and_nothing_else() {
        let mut state = 21;
        let triangles = town(&mut state);
        let mesh = ContourMesh::new(&triangles);
        let caster = mesh.caster();
        let directions = Directions::new(128);
        let (mut scratch, mut all) = (mesh.scratch(&directions), mesh.scratch(&directions));
        let (mut segments, mut of_all, mut blocked) = (0, 0, 0);
        let (mut counted, mut of_all_parts) = (0, 0);
        for index in 0..120 {
            let [a, b, c] = triangles[index * 7919 % triangles.len()];
            let normal = (b - a).cross(c - a).normalize();
            let mut origin = (a + b + c) / 3.0 + 1e-3 * normal;
            if index % 10 == 0 {
                // In a box, maybe in several.
                let corners = triangles[12 * index..][..12].as_flattened();
                origin = corners.iter().sum::<Vec3>() / corners.len() as f32;
            }
            let (bitmap, _) = mesh.sample(origin, &directions, &mut scratch);
            assert!(
                bitmap == visibility::sample(caster, origin, &directions),
                "{index}"
            );
            mesh.prepare(&[origin], &mut all);
            (all.candidates).look(&mesh.facing, &mesh.parts, &mesh.positions, origin);
            let at_once = mesh.count(origin, directions.as_slice(), &mut all, true);
            assert!(at_once.is_some_and(|(found, _)| found == bitmap), "{index}");
            let bits = |crossings: &Crossings| -> Vec<u32> {
                crossings.positions.iter().map(|x| x.to_bits()).collect()
            };
            let mut links = Vec::new();
            bitmap.for_links(128, |x, y, below| {
                links.push(usize::from(below) * 128 * 128 + y * 128 + x);
            });
            let some = bits(mesh.crossings(&bitmap, &mut scratch));
            let every = bits(mesh.crossings(&bitmap, &mut all));
            assert!(
                links.iter().all(|&link| some[link] == every[link]),
                "{index}"
            );
            // What is drawn is laid over the map by its three edges too, for crossings.
            let laid = |layers: &Layers| {
                let contours = layers.segments().iter().map(|batch| batch.count);
                contours.sum::<usize>() + 3 * layers.drawn().len()
            };
            let parts = |scratch: &Scratch| {
                let parts = 0..mesh.parts.count() as u32;
                parts
                    .filter(|&part| scratch.rounds.is_counted(part))
                    .count()
            };
            segments += laid(&scratch.layers);
            of_all += laid(&all.layers);
            counted += parts(&scratch);
            of_all_parts += parts(&all);
            blocked += usize::from(links.is_empty());
        }
        assert!(
            2 * counted < of_all_parts,
            "{counted} of {of_all_parts} parts"
        );
        assert!(2 * segments < of_all, "{segments} of {of_all}");
        assert!(blocked > 0, "no point in a box");
    }

    #[test]
    fn litter_about_the_horizon_gives_the_same_bits() {
        let mut state = 33;
        let mut litter = |size: f32, height: f32| {
            let angle = std::f32::consts::TAU * random(&mut state);
            let distance = 0.5 + 2.0 * random(&mut state);
            let centre = distance * Vec3::new(math::cos(angle), 0.0, math::sin(angle))
                + height * random_point(&mut state).y * Vec3::Y;
            [0; 3].map(|_| centre + size * random_point(&mut state))
        };
        let mut triangles: Vec<_> = (0..1500).map(|_| litter(0.02, 0.02)).collect();
        // Slivers, and some that are too large to be drawn.
        triangles.extend((0..300).map(|_| {
            let [a, b, c] = litter(0.05, 0.05);
            [a, b, a.lerp(b, 0.4) + 1e-4 * (c - a)]
        }));
        triangles.extend((0..300).map(|_| litter(0.3, 0.3)));
        let mut state = 34;
        let origins: Vec<Vec3> = (0..36)
            .map(|_| random_point(&mut state) * Vec3::new(0.4, 0.02, 0.4))
            .collect();
        for resolution in [64, 128] {
            let rays = assert_same_bits(&triangles, &origins, resolution);
            let few = 36 * u64::from(resolution).pow(2) / 20;
            assert!(rays < few, "{rays} rays at {resolution}");
        }
    }

    /// A sphere seen from outside: its direction and angular radius, the bitmap and where its
    /// contours cross.
    fn ball(directions: &Directions) -> (Vec3, f32, Bitmap, Crossings) {
        let centre = Vec3::new(0.7, 1.9, -1.1);
        let triangles = sphere(centre, 1.0, 160);
        let mesh = ContourMesh::new(&triangles);
        let mut scratch = mesh.scratch(directions);
        let (bitmap, _) = mesh.sample(Vec3::ZERO, directions, &mut scratch);
        mesh.crossings(&bitmap, &mut scratch);
        let radius = math::asin(1.0 / centre.length());
        (
            centre,
            radius,
            bitmap,
            std::mem::take(&mut scratch.crossings),
        )
    }

    /// Root mean square error of signed distances near the boundary, without and with the
    /// contours' crossings, radians.
    fn errors_near_a_cap(sample_resolution: u32, resolution: u32) -> [f32; 2] {
        let directions = Directions::new(sample_resolution);
        let (centre, radius, bitmap, crossings) = ball(&directions);
        let transform = ssdf::DistanceTransform::new(&directions, resolution);
        [&Crossings::default(), &crossings].map(|crossings| {
            let distances = transform.at_centres(&bitmap, crossings, 0.5);
            let errors: Vec<f32> = (Directions::new(resolution).as_slice().iter())
                .map(|direction| direction.angle_between(centre) - radius)
                .zip(distances)
                .filter(|(exact, _)| exact.abs() < 0.06)
                .map(|(exact, found)| found - exact)
                .collect();
            assert!(errors.len() > 50, "{} texels", errors.len());
            let squares: f32 = errors.iter().map(|error| error * error).sum();
            (squares / errors.len() as f32).sqrt()
        })
    }

    #[test]
    fn crossings_make_distances_finer_than_texels() {
        for (samples, resolution) in [(128, 128), (64, 64)] {
            let [without, with] = errors_near_a_cap(samples, resolution);
            println!("{samples} to {resolution}: {without} without, {with} with crossings");
            assert!(with < 0.4 * without, "{samples}: {with}, {without} without");
        }
    }

    /// Mean distance that is interpolated where the boundary is, radians.
    fn mean_at_the_boundary(distances: &[f32], resolution: u32, axis: Vec3, radius: f32) -> f32 {
        let (tangent, axis) = (axis.any_orthonormal_vector(), axis.normalize());
        let bitangent = axis.cross(tangent);
        let points = 1000;
        let sum: f32 = (0..points)
            .map(|i| {
                let angle = std::f32::consts::TAU * i as f32 / points as f32;
                let side = math::cos(angle) * tangent + math::sin(angle) * bitangent;
                let direction = math::cos(radius) * axis + math::sin(radius) * side;
                let texel = octahedral::encode(direction) * resolution as f32 - 0.5;
                Footprint::new(texel, resolution).read(distances).abs()
            })
            .sum();
        sum / points as f32
    }

    #[test]
    fn interpolated_distances_vanish_at_the_boundary() {
        for (samples, resolution) in [(128, 64), (128, 32)] {
            let directions = Directions::new(samples);
            let (centre, radius, bitmap, crossings) = ball(&directions);
            let transform = ssdf::DistanceTransform::new(&directions, resolution);
            let axis = centre.normalize();
            let mean =
                |distances: Vec<f32>| mean_at_the_boundary(&distances, resolution, axis, radius);
            let exact = mean(transform.at_centres(&bitmap, &crossings, 0.5));
            let fitted = mean(transform.apply(&bitmap, &crossings, 0.5));
            println!("{samples} to {resolution}: {fitted}, {exact} at centres");
            assert!(fitted < 0.5 * exact, "{fitted}, {exact} at centres");
        }
    }
}
