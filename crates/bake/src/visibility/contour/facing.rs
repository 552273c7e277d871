//! Which triangles face all points of a small group, and which face some and not others.
//! Contours lie between triangles that face a point and those that do not.
//!
//! Triangles are grouped into blocks of similar place and normal. A cone of normals and the
//! range of the planes' offsets tell for most blocks that all of their triangles face one
//! way (Johnson & Cohen 2001); only the others are looked at one by one.

use std::ops::Range;

use glam::{DVec3, Vec3};
use pulp::{Simd, WithSimd};

use super::Contour;
use super::batch;
use super::candidates::{ABSENT, CandidateEdge, Candidates};
use super::parts::Parts;
use crate::simd;
use crate::visibility;

/// Triangles that are tested together; their edges are grouped by it.
pub(super) const BLOCK: usize = 64;
/// Cones that are tested side by side.
const LANES: usize = 16;
/// How far a quarter turn of the normal counts against a distance of the scene's extent
/// when triangles are grouped.
const NORMAL_WEIGHT: f32 = 0.1;
/// Slack of the cone test against rounding, relative to the distances involved. A block
/// within it is looked at triangle by triangle.
const SLACK: f32 = 1e-5;
/// Bounds the rounding of a plane's offset and of its product with a point in single
/// precision, relative to their size: a few units in the last place.
const PLANE_ROUNDING: f32 = 1e-6;
/// Edges whose contours are collected together; at most 256, a power of two.
const CHUNK: usize = 128;

/// Triangles in blocks, and their edges.
pub(super) struct Facing {
    /// Planes `n·p = d` of the triangles with unit normals, structure of arrays, padded to
    /// whole blocks.
    planes: [Vec<f32>; 4],
    /// The same to double precision, for eyes close to a plane; normals of any length.
    precise: Vec<[f64; 4]>,
    /// Vertices of every triangle, in the order of the planes.
    corners: Vec<[u32; 3]>,
    /// Bounds the rounding of the planes in single precision for an eye at the origin;
    /// grows with the eye's distance from it.
    rounding: f32,
    /// Largest coordinates, without their signs.
    extent: DVec3,
    cones: Vec<Cones>,
    blocks: usize,
    /// Edges between two triangles of one block, block after block, and where each block's
    /// begin; triangles as numbers in their block.
    inner: Edges<u8>,
    first_inner: Vec<u32>,
    /// Edges between triangles of different blocks.
    outer: Edges<u32>,
    /// Edges of one triangle, or of several that do not pair up.
    irregular: Vec<IrregularEdge>,
    /// Where the planes of the triangles are, by their numbers in the list that this was made of.
    places: Vec<u32>,
}

/// Normal cones of [`LANES`] blocks: for every triangle of a block, `n·(p − c)` of a point
/// p lies between the least and the largest value of that over the cone, plus `low` or
/// `high`.
#[derive(Clone, Default)]
struct Cones {
    centre: [[f32; LANES]; 3],
    axis: [[f32; LANES]; 3],
    cosine: [f32; LANES],
    sine: [f32; LANES],
    low: [f32; LANES],
    high: [f32; LANES],
}

/// Edges between two triangles: the first is wound along the edge, the second against it.
struct Edges<T> {
    triangles: Vec<[T; 2]>,
    vertices: Vec<[u32; 2]>,
}

/// The triangles at an edge and whether each is wound along it.
#[derive(Clone)]
pub(super) struct IrregularEdge {
    pub(super) vertices: [u32; 2],
    pub(super) triangles: Vec<(u32, bool)>,
}

impl IrregularEdge {
    /// The contour that it makes, if any. `face` is 1 for triangles that face the eye, −1 for those
    /// that do not, and 0 for those that do not count.
    pub(super) fn contour(&self, face: impl Fn(u32) -> i8) -> Option<Contour> {
        let left = |&(triangle, along): &(u32, bool)| {
            let face = i32::from(face(triangle));
            if along { face } else { -face }
        };
        let step = self.triangles.iter().map(left).sum();
        (step != 0).then_some(Contour {
            vertices: self.vertices,
            step,
        })
    }
}

impl Facing {
    /// `triangles` index `positions`; each has an area. Of those that are loose, edges are left out.
    pub(super) fn new(positions: &[Vec3], triangles: &[[u32; 3]], parts: &Parts) -> Self {
        let order = group(positions, triangles);
        let blocks = order.len().div_ceil(BLOCK);
        let mut facing = Self {
            // What pads the last block is seen by nobody.
            planes: [0.0, 0.0, 0.0, f32::INFINITY].map(|value| vec![value; blocks * BLOCK]),
            precise: vec![[0.0; 4]; order.len()],
            corners: order
                .iter()
                .map(|&triangle| triangles[triangle as usize])
                .collect(),
            rounding: 0.0,
            extent: (positions.iter()).fold(DVec3::ZERO, |extent, position| {
                extent.max(position.as_dvec3().abs())
            }),
            cones: vec![Cones::default(); blocks.div_ceil(LANES)],
            blocks,
            inner: Edges::new(),
            first_inner: Vec::new(),
            outer: Edges::new(),
            irregular: Vec::new(),
            places: vec![0; order.len()],
        };
        // Edge from lower to higher vertex, triangle, whether it is wound along that.
        let mut halves: Vec<([u32; 2], u32, bool)> = Vec::with_capacity(3 * order.len());
        for (index, &triangle) in order.iter().enumerate() {
            let vertices = triangles[triangle as usize];
            facing.places[triangle as usize] = index as u32;
            let [a, b, c] = vertices.map(|vertex| positions[vertex as usize].as_dvec3());
            let normal = (b - a).cross(c - a);
            facing.precise[index] = normal.extend(normal.dot(a)).to_array();
            let unit = normal.normalize();
            let plane = unit.extend(unit.dot(a)).as_vec4();
            for (out, value) in facing.planes.iter_mut().zip(plane.to_array()) {
                out[index] = value;
            }
            facing.rounding = facing.rounding.max(PLANE_ROUNDING * plane.w.abs());
            if parts.bundle_of(parts.of_vertex(vertices[0])).is_some() {
                continue;
            }
            for i in 0..3 {
                let (from, to) = (vertices[i], vertices[(i + 1) % 3]);
                halves.push(([from.min(to), from.max(to)], index as u32, from < to));
            }
        }
        for (block, members) in order.chunks(BLOCK).enumerate() {
            let corners = members
                .iter()
                .map(|&t| triangles[t as usize].map(|v| positions[v as usize]));
            facing.cones[block / LANES].set(block % LANES, &corners);
        }
        facing.add_edges(halves);
        facing
    }

    fn add_edges(&mut self, mut halves: Vec<([u32; 2], u32, bool)>) {
        halves.sort_unstable();
        // Triangles, vertices: in the order of the triangles.
        let mut regular: Vec<([u32; 2], [u32; 2])> = Vec::new();
        for sides in halves.chunk_by(|a, b| a.0 == b.0) {
            let vertices = sides[0].0;
            match *sides {
                [(_, a, along_a), (_, b, along_b)] if along_a != along_b => {
                    regular.push((if along_a { [a, b] } else { [b, a] }, vertices));
                }
                _ => self.irregular.push(IrregularEdge {
                    vertices,
                    triangles: sides.iter().map(|&(_, t, along)| (t, along)).collect(),
                }),
            }
        }
        regular.sort_unstable();
        for (triangles, vertices) in regular {
            let [a, b] = triangles.map(|triangle| triangle as usize / BLOCK);
            if a == b {
                let begun = self.inner.vertices.len() as u32;
                self.first_inner
                    .resize(self.first_inner.len().max(a + 1), begun);
                self.inner
                    .triangles
                    .push(triangles.map(|t| (t as usize % BLOCK) as u8));
                self.inner.vertices.push(vertices);
            } else {
                self.outer.triangles.push(triangles);
                self.outer.vertices.push(vertices);
            }
        }
        let end = self.inner.vertices.len() as u32;
        self.first_inner.resize(self.blocks + 1, end);
    }

    /// Contours that every point within `radius` of `centre` sees, and edges that some may.
    /// `sides` is scratch memory.
    pub(super) fn find_candidates(
        &self,
        centre: Vec3,
        radius: f32,
        parts: &Parts,
        sides: &mut Sides,
        candidates: &mut Candidates,
    ) {
        sides.triangles.resize(self.blocks * BLOCK, BACK);
        sides.numbers.resize(self.blocks * BLOCK, 0);
        sides.mixed.clear();
        // Distances to planes are rounded, and so is the radius.
        let reach = 1.001 * radius + 2.0 * (self.rounding_at(centre) + PLANE_ROUNDING * radius);
        simd::arch().dispatch(FindSides {
            mesh: self,
            centre,
            reach,
            sides,
        });
        candidates.clear();
        for &block in &sides.mixed {
            for triangle in block as usize * BLOCK..(block as usize + 1) * BLOCK {
                if sides.triangles[triangle] == EITHER {
                    sides.numbers[triangle] = candidates.add_triangle(
                        self.planes.each_ref().map(|plane| plane[triangle]),
                        self.precise[triangle],
                        self.corners[triangle],
                    );
                }
            }
        }
        candidates.finish_triangles();
        for &block in &sides.mixed {
            let block = block as usize;
            let range = self.first_inner[block] as usize..self.first_inner[block + 1] as usize;
            let members = block * BLOCK..(block + 1) * BLOCK;
            let known = &sides.triangles[members.clone()];
            let numbers = &sides.numbers[members];
            let side = |triangle: u8| known[usize::from(triangle) % BLOCK];
            let number = |triangle: u8| numbers[usize::from(triangle) % BLOCK];
            self.inner.collect(range, side, number, candidates);
        }
        let side = |triangle: u32| sides.triangles[triangle as usize];
        let number = |triangle: u32| sides.numbers[triangle as usize];
        let all = 0..self.outer.vertices.len();
        self.outer.collect(all, side, number, candidates);
        for edge in &self.irregular {
            let mut triangles = edge.triangles.iter();
            if !triangles.any(|&(triangle, _)| side(triangle) == EITHER) {
                let face = |triangle| if side(triangle) == FRONT { 1 } else { -1 };
                candidates.sure.extend(edge.contour(face));
            } else if let [(triangle, along)] = edge.triangles[..] {
                let triangle = number(triangle);
                candidates.edges.push(CandidateEdge {
                    triangles: if along {
                        [triangle, ABSENT]
                    } else {
                        [ABSENT, triangle]
                    },
                    vertices: edge.vertices,
                });
            } else {
                let mut edge = edge.clone();
                for (triangle, _) in &mut edge.triangles {
                    *triangle = known_number(side(*triangle)).unwrap_or_else(|| number(*triangle));
                }
                candidates.irregular.push(edge);
            }
        }
        candidates.loose.extend(parts.bundles.iter().map(|bundle| {
            let mut numbers = [ABSENT; batch::LANES];
            for (out, triangle) in numbers.iter_mut().zip(bundle.triangles()) {
                let triangle = self.places[*triangle as usize];
                *out = known_number(side(triangle)).unwrap_or_else(|| number(triangle));
            }
            numbers
        }));
    }

    /// Bounds the rounding of heights above planes, in single precision.
    #[inline(always)]
    pub(super) fn rounding_at(&self, eye: Vec3) -> f32 {
        self.rounding + PLANE_ROUNDING * eye.abs().element_sum()
    }

    /// The same along each axis, for planes along which it vanishes: however wide a floor is, it is as flat as its
    /// heights are exact.
    pub(super) fn rounding_of_axes(&self, eye: Vec3) -> DVec3 {
        f64::from(PLANE_ROUNDING) * (self.extent + eye.as_dvec3().abs())
    }
}

/// How a triangle lies to the points of a group: it faces none of them, all of them, or it
/// is not known.
const BACK: u8 = 0;
const FRONT: u8 = 1;
const EITHER: u8 = 2;

/// The number that stands for all triangles that face no point, or every point.
fn known_number(side: u8) -> Option<u32> {
    (side != EITHER).then_some(u32::from(side))
}

impl<T: Copy> Edges<T> {
    fn new() -> Self {
        Self {
            triangles: Vec::new(),
            vertices: Vec::new(),
        }
    }

    /// Adds those edges of `range` whose triangles lie to different sides or may.
    #[inline(always)]
    fn collect(
        &self,
        range: Range<usize>,
        side: impl Fn(T) -> u8,
        number: impl Fn(T) -> u32,
        candidates: &mut Candidates,
    ) {
        let (triangles, vertices) = (&self.triangles[range.clone()], &self.vertices[range]);
        let differ = |pair: [T; 2]| {
            let [a, b] = pair.map(&side);
            (a ^ b) | (a & EITHER) != 0
        };
        for_each_where(triangles, vertices, differ, |triangles, vertices| {
            let sides = triangles.map(&side);
            if sides.contains(&EITHER) {
                candidates.edges.push(CandidateEdge {
                    triangles: triangles.map(|triangle| {
                        known_number(side(triangle)).unwrap_or_else(|| number(triangle))
                    }),
                    vertices,
                });
            } else {
                candidates.sure.push(Contour {
                    vertices,
                    step: step(sides[0]),
                });
            }
        });
    }
}

/// Calls `take` with every edge of which `wanted` is true of its triangles.
#[inline(always)]
pub(super) fn for_each_where<T: Copy, E: Copy>(
    triangles: &[[T; 2]],
    ends: &[[E; 2]],
    wanted: impl Fn([T; 2]) -> bool,
    mut take: impl FnMut([T; 2], [E; 2]),
) {
    let mut found = [0; CHUNK];
    for (triangles, ends) in triangles.chunks(CHUNK).zip(ends.chunks(CHUNK)) {
        // Collected without a branch, which would often be guessed wrong.
        let mut count = 0;
        for (index, pair) in triangles.iter().enumerate() {
            found[count % CHUNK] = index as u8;
            count += usize::from(wanted(*pair));
        }
        for &index in &found[..count] {
            take(triangles[usize::from(index)], ends[usize::from(index)]);
        }
    }
}

/// Layers that begin at an edge whose first triangle faces the eye (1), or end (0), along
/// with those of its second triangle.
fn step(face: u8) -> i32 {
    4 * i32::from(face) - 2
}

/// How triangles lie to a group of points.
#[derive(Default)]
pub(super) struct Sides {
    /// [`BACK`], [`FRONT`] or [`EITHER`] per triangle.
    triangles: Vec<u8>,
    /// Blocks whose triangles may differ.
    mixed: Vec<u32>,
    /// What candidates call a triangle of either side.
    numbers: Vec<u32>,
}

impl Cones {
    fn set(&mut self, lane: usize, corners: &(impl Iterator<Item = [Vec3; 3]> + Clone)) {
        let normal = |[a, b, c]: [Vec3; 3]| {
            let [a, b, c] = [a, b, c].map(Vec3::as_dvec3);
            (b - a).cross(c - a).normalize_or_zero()
        };
        let axis: DVec3 = corners.clone().map(normal).sum();
        let axis = axis.normalize_or_zero();
        let (low, high) = corners.clone().flatten().fold(
            (Vec3::INFINITY, Vec3::NEG_INFINITY),
            |(low, high), corner| (low.min(corner), high.max(corner)),
        );
        let centre = low.as_dvec3().midpoint(high.as_dvec3());
        let cosine = corners
            .clone()
            .map(|triangle| axis.dot(normal(triangle)))
            .fold(1.0, f64::min);
        let offsets = corners
            .clone()
            .map(|triangle| normal(triangle).dot(centre - triangle[0].as_dvec3()));
        let (least, largest) = offsets.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), x| {
            (l.min(x), h.max(x))
        });
        let slack = f64::from(SLACK) * f64::from(low.abs().max(high.abs()).max_element());
        // A cone of a right angle or more, or around no axis, tells nothing.
        let wide = cosine < 0.05;
        for i in 0..3 {
            self.centre[i][lane] = centre[i] as f32;
            self.axis[i][lane] = axis[i] as f32;
        }
        self.cosine[lane] = cosine as f32;
        self.sine[lane] = (1.0 - cosine * cosine).max(0.0).sqrt() as f32;
        self.low[lane] = if wide {
            f32::NEG_INFINITY
        } else {
            (least - slack) as f32
        };
        self.high[lane] = if wide {
            f32::INFINITY
        } else {
            (largest + slack) as f32
        };
    }

    /// Per block, how all of its triangles lie to all points within `reach` of `eye`.
    #[inline(always)]
    fn test(&self, eye: Vec3, reach: f32) -> [u8; LANES] {
        let mut result = [0; LANES];
        for (lane, side) in result.iter_mut().enumerate() {
            let x = eye.x - self.centre[0][lane];
            let y = eye.y - self.centre[1][lane];
            let z = eye.z - self.centre[2][lane];
            let [mx, my, mz] = [self.axis[0][lane], self.axis[1][lane], self.axis[2][lane]];
            let along = mx * x + my * y + mz * z;
            let [cx, cy, cz] = [my * z - mz * y, mz * x - mx * z, mx * y - my * x];
            let across = (cx * cx + cy * cy + cz * cz).sqrt();
            let length = (along * along + across * across).sqrt();
            let (cosine, sine) = (self.cosine[lane], self.sine[lane]);
            // Extremes over the cone; at its axis' or the opposite side if that is inside.
            let least = if along < -length * cosine {
                -length
            } else {
                along * cosine - across * sine
            };
            let largest = if along > length * cosine {
                length
            } else {
                along * cosine + across * sine
            };
            let slack = SLACK * length + reach;
            let front = least - slack + self.low[lane] > 0.0;
            let back = largest + slack + self.high[lane] < 0.0;
            *side = 2 - u8::from(front) - 2 * u8::from(back);
        }
        result
    }
}

/// The vectorised body of [`Facing::find_candidates`].
struct FindSides<'a> {
    mesh: &'a Facing,
    centre: Vec3,
    reach: f32,
    sides: &'a mut Sides,
}

impl WithSimd for FindSides<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let Self {
            mesh,
            centre,
            reach,
            sides,
        } = self;
        let groups = sides.triangles.chunks_mut(LANES * BLOCK);
        for (number, (cones, group)) in mesh.cones.iter().zip(groups).enumerate() {
            let known = cones.test(centre, reach);
            let blocks = group.as_chunks_mut::<BLOCK>().0;
            for (lane, (side, block)) in known.into_iter().zip(blocks).enumerate() {
                if side == EITHER {
                    let index = number * LANES + lane;
                    let planes = mesh.planes.each_ref().map(|plane| block_of(plane, index));
                    let [x, y, z, d] = planes;
                    for i in 0..BLOCK {
                        let height = x[i] * centre.x + y[i] * centre.y + z[i] * centre.z - d[i];
                        block[i] = if height > reach {
                            FRONT
                        } else if height < -reach {
                            BACK
                        } else {
                            EITHER
                        };
                    }
                    sides.mixed.push(index as u32);
                } else {
                    block.fill(side);
                }
            }
        }
    }
}

/// The elements that belong to a block of triangles.
#[inline(always)]
pub(super) fn block_of<T>(elements: &[T], block: usize) -> &[T; BLOCK] {
    &elements.as_chunks().0[block]
}

/// An order of the triangles in which runs of [`BLOCK`] are close in place and normal.
fn group(positions: &[Vec3], triangles: &[[u32; 3]]) -> Vec<u32> {
    let (low, high) = positions.iter().fold(
        (Vec3::INFINITY, Vec3::NEG_INFINITY),
        |(low, high), position| (low.min(*position), high.max(*position)),
    );
    let scale = 1.0 / (high - low).max_element().max(f32::MIN_POSITIVE);
    let features: Vec<[f32; 6]> = (triangles.iter())
        .map(|triangle| {
            let [a, b, c] = triangle.map(|vertex| positions[vertex as usize]);
            let place = (a + b + c) / 3.0 * scale;
            let normal = (b - a).cross(c - a).normalize_or_zero() * NORMAL_WEIGHT;
            [place.x, place.y, place.z, normal.x, normal.y, normal.z]
        })
        .collect();
    let mut order: Vec<u32> = (0..triangles.len() as u32).collect();
    visibility::arrange(&mut order, BLOCK, &|&triangle| {
        (features[triangle as usize], triangle)
    });
    order
}
