//! Which flats face all points of a small group, and which face some and not others.
//! Contours lie between flats that face a point and those that do not.
//!
//! A flat is one triangle, or several of nearly one plane (`flats`). They are grouped into blocks of similar place and normal.
//! A cone of normals and the range of the planes' offsets tell for most blocks that all of their triangles face one
//! way (Johnson & Cohen 2001); only the others are looked at flat by flat.

use std::ops::Range;

use glam::{DVec3, Vec3};
use pulp::{Simd, WithSimd};

use super::batch;
use super::candidates::{ABSENT, CandidateEdge, Open};
use super::edges::{Edges, HalfEdge, IrregularEdge, half_edges, regular_pair};
use super::flats::{Flats, Plane, Spread};
use super::level::Level;
use super::parts::Parts;
use super::{Contour, bounds};
use crate::simd;
use crate::visibility::{self, ones, pack_bits};

/// Flats that are tested together, as many as a word has bits; their edges are grouped by it.
pub(super) const BLOCK: usize = 64;
/// Cones that are tested side by side.
const LANES: usize = 16;
/// How far a quarter turn of the normal counts against a distance of the scene's extent
/// when flats are grouped.
const NORMAL_WEIGHT: f32 = 0.1;
/// Slack of the cone test against rounding, relative to the distances involved. A block
/// within it is looked at flat by flat.
const SLACK: f32 = 1e-5;
/// Bounds the rounding of a plane's offset and of its product with a point in single
/// precision, relative to their size: a few units in the last place.
const PLANE_ROUNDING: f32 = 1e-6;
/// Edges whose contours are collected together; at most 256, a power of two.
const CHUNK: usize = 128;

/// Flats in blocks, and their edges.
pub(super) struct Facing {
    /// Planes `n·p = d` of the flats with unit normals, structure of arrays, padded to
    /// whole blocks.
    planes: [Vec<f32>; 4],
    /// Where the triangles of each begin, and where the last one's end; nothing where each has one.
    first: Vec<u32>,
    /// How far the planes of those are apart, where there are several, and what is as large as any of that.
    spreads: Vec<Spread>,
    widest: Spread,
    /// Where that is told from.
    centre: Vec3,
    /// Planes of the triangles to double precision, for eyes close to a plane; normals of any length.
    precise: Vec<[f64; 4]>,
    /// Their vertices.
    corners: Vec<[u32; 3]>,
    /// Bounds the rounding of the planes in single precision for an eye at the origin;
    /// grows with the eye's distance from it.
    rounding: f32,
    /// Largest coordinates, without their signs.
    extent: DVec3,
    cones: Vec<Cones>,
    blocks: usize,
    /// Edges between two flats.
    edges: Edges,
    /// Edges of one flat, or of several that do not pair up.
    irregular: Vec<IrregularEdge>,
    /// The flats of the triangles, by their numbers in the list that this was made of.
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

impl Facing {
    /// `triangles` index `positions`; each has an area. Of those that are loose, edges are left out.
    pub(super) fn new(positions: &[Vec3], triangles: &[[u32; 3]], parts: &Parts) -> Self {
        let sides = half_edges(triangles, parts);
        let flats = flats(positions, triangles, &sides);
        let flats = flats.as_ref();
        let members = |flat: u32| {
            let own = flats.is_none().then_some(flat);
            let several = flats.map_or(&[][..], |flats| flats.of(flat));
            own.into_iter().chain(several.iter().copied())
        };
        let largest = |flat: u32| triangles[flats.map_or(flat, |flats| flats.of(flat)[0]) as usize];
        let count = flats.map_or(triangles.len(), Flats::count);
        let order = group(positions, count, largest);
        let blocks = order.len().div_ceil(BLOCK);
        let spreads = flats.map_or(Vec::new(), |flats| {
            order.iter().map(|&flat| flats.spread(flat)).collect()
        });
        let mut facing = Self {
            // What pads the last block is seen by nobody.
            planes: [0.0, 0.0, 0.0, f32::INFINITY].map(|value| vec![value; blocks * BLOCK]),
            first: Vec::new(),
            widest: spreads.iter().copied().fold(Spread::default(), Spread::max),
            spreads,
            centre: flats.map_or(Vec3::ZERO, |flats| flats.centre.as_vec3()),
            precise: Vec::with_capacity(triangles.len()),
            corners: Vec::with_capacity(triangles.len()),
            rounding: 0.0,
            extent: (positions.iter()).fold(DVec3::ZERO, |extent, position| {
                extent.max(position.as_dvec3().abs())
            }),
            cones: vec![Cones::default(); blocks.div_ceil(LANES)],
            blocks,
            edges: Edges::default(),
            irregular: Vec::new(),
            places: vec![0; triangles.len()],
        };
        for (index, &flat) in order.iter().enumerate() {
            if flats.is_some() {
                facing.first.push(facing.corners.len() as u32);
            }
            for triangle in members(flat) {
                let vertices = triangles[triangle as usize];
                let (normal, distance) = plane(positions, vertices);
                facing.precise.push(normal.extend(distance).to_array());
                facing.corners.push(vertices);
                facing.places[triangle as usize] = index as u32;
            }
            let plane = unit_plane(positions, largest(flat));
            let plane = plane.normal.extend(plane.distance).as_vec4();
            for (out, value) in facing.planes.iter_mut().zip(plane.to_array()) {
                out[index] = value;
            }
            facing.rounding = facing.rounding.max(PLANE_ROUNDING * plane.w.abs());
        }
        if flats.is_some() {
            facing.first.push(facing.corners.len() as u32);
        }
        for (block, order) in order.chunks(BLOCK).enumerate() {
            let corners = order
                .iter()
                .flat_map(|&flat| members(flat))
                .map(|t| triangles[t as usize].map(|v| positions[v as usize]));
            facing.cones[block / LANES].set(block % LANES, &corners);
        }
        (facing.edges, facing.irregular) = Edges::new(&sides, &facing.places);
        facing
    }

    /// Contours that every point within `radius` of `centre` sees, and edges that some may.
    /// `sides` is scratch memory.
    pub(super) fn find_candidates(
        &self,
        sphere: (Vec3, f32),
        parts: &Parts,
        sides: &mut Sides,
        level: &mut Level,
        open: &mut Open,
    ) {
        sides.blocks.resize(self.blocks, Side::default());
        sides.mixed.clear();
        simd::arch().dispatch(FindSides {
            mesh: self,
            centre: sphere.0,
            reach: self.reach(sphere),
            sides,
        });
        for &block in &sides.mixed {
            let side = &mut sides.blocks[block as usize];
            side.first = level.next_flat();
            for index in ones(side.either) {
                let flat = block as usize * BLOCK + index;
                let plane = self.planes.each_ref().map(|plane| plane[flat]);
                level.add_flat(plane, flat as u32);
            }
        }
        level.finish_flats();
        simd::arch().dispatch(Collect {
            edges: &self.edges,
            sides: &sides.blocks,
            open,
        });
        let number = |flat: u32| {
            let side = sides.blocks[flat as usize / BLOCK];
            side.number((flat % BLOCK as u32) as u8)
        };
        for edge in &self.irregular {
            let mut flats = edge.flats.iter();
            if flats.all(|&(flat, _)| is_known(number(flat))) {
                let face = |flat| if number(flat) == FRONT { 1 } else { -1 };
                open.sure.extend(edge.contour(face));
            } else if let [(flat, along)] = edge.flats[..] {
                let flat = number(flat);
                open.edges.push(CandidateEdge {
                    flats: if along {
                        [flat, ABSENT]
                    } else {
                        [ABSENT, flat]
                    },
                    vertices: edge.vertices,
                });
            } else {
                let mut edge = edge.clone();
                for (flat, _) in &mut edge.flats {
                    *flat = number(*flat);
                }
                level.irregular.push(edge);
            }
        }
        level.loose.extend(parts.bundles.iter().map(|bundle| {
            let mut numbers = [ABSENT; batch::LANES];
            for (out, triangle) in numbers.iter_mut().zip(bundle.triangles()) {
                *out = number(self.places[*triangle as usize]);
            }
            numbers
        }));
    }

    /// The triangles of a flat.
    pub(super) fn triangles_of(&self, flat: u32) -> Range<usize> {
        let flat = flat as usize;
        if self.first.is_empty() {
            return flat..flat + 1;
        }
        self.first[flat] as usize..self.first[flat + 1] as usize
    }

    /// The plane of a triangle, and its vertices.
    pub(super) fn precise(&self, triangle: usize) -> [f64; 4] {
        self.precise[triangle]
    }

    pub(super) fn corners(&self, triangle: usize) -> [u32; 3] {
        self.corners[triangle]
    }

    /// How many flats there are.
    #[cfg(test)]
    pub(super) fn flats(&self) -> usize {
        self.places
            .iter()
            .max()
            .map_or(0, |flat| *flat as usize + 1)
    }

    /// How many edges there are between two flats.
    #[cfg(test)]
    pub(super) fn regular_edges(&self) -> usize {
        self.edges.count()
    }

    /// How far from a flat's plane a point may seem that lies between those of its triangles: of any flat, and of one.
    pub(super) fn widest_at(&self, eye: Vec3) -> f32 {
        self.widest.at(self.away(eye))
    }

    #[inline(always)]
    pub(super) fn spread(&self, flat: u32) -> Spread {
        (self.spreads.get(flat as usize)).map_or(Spread::default(), |spread| *spread)
    }

    /// How far a point is from where spreads are told from, or a little more.
    pub(super) fn away(&self, eye: Vec3) -> f32 {
        1.001 * eye.distance(self.centre) + PLANE_ROUNDING * eye.abs().element_sum()
    }

    /// Bounds the rounding of heights above planes, in single precision.
    #[inline(always)]
    pub(super) fn rounding_at(&self, eye: Vec3) -> f32 {
        self.rounding + PLANE_ROUNDING * eye.abs().element_sum()
    }

    /// How far from the centre of a sphere a flat's plane may seem if that of one of its triangles passes through it.
    pub(super) fn reach(&self, (centre, radius): (Vec3, f32)) -> f32 {
        // Distances to planes are rounded, and so is the radius.
        let rounding = self.rounding_at(centre) + PLANE_ROUNDING * radius;
        let spread = self.widest.at(self.away(centre) + 1.001 * radius);
        1.001 * radius + 2.0 * rounding + spread
    }

    /// The same along each axis, for planes along which it vanishes: however wide a floor is, it is as flat as its
    /// heights are exact.
    pub(super) fn rounding_of_axes(&self, eye: Vec3) -> DVec3 {
        f64::from(PLANE_ROUNDING) * (self.extent + eye.as_dvec3().abs())
    }
}

/// How a flat lies to the points of a group: it faces all of them, or it is not known; 0 if it faces none. What is less than
/// [`EITHER`] is also the number that stands for such flats.
pub(super) const BACK: u32 = 0;
pub(super) const FRONT: u32 = 1;
const EITHER: u32 = 2;

/// Whether a number stands for all flats that face no point, or every point.
fn is_known(number: u32) -> bool {
    number < EITHER
}

/// Adds the edges whose flats lie to different sides or may: for processors that count the bits of a word at once.
struct Collect<'a> {
    edges: &'a Edges,
    sides: &'a [Side],
    open: &'a mut Open,
}

impl WithSimd for Collect<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let Self { edges, sides, open } = self;
        for (blocks, range) in edges.blocks.iter().zip(edges.first.windows(2)) {
            let [a, b] = blocks.map(|block| sides[block as usize]);
            if a.is_same(b) {
                continue;
            }
            let range = range[0] as usize..range[1] as usize;
            let (flats, vertices) = (&edges.flats[range.clone()], &edges.vertices[range]);
            let differ = |[i, j]: [u8; 2]| {
                let [i, j] = [i, j].map(u32::from);
                let [front, other] = [a.front.wrapping_shr(i), b.front.wrapping_shr(j)];
                let either = a.either.wrapping_shr(i) | b.either.wrapping_shr(j);
                ((front ^ other) | either) & 1 != 0
            };
            for_each_where(flats, vertices, differ, |[i, j], vertices| {
                let flats = [a.number(i), b.number(j)];
                if flats.into_iter().all(is_known) {
                    open.sure.push(Contour {
                        vertices,
                        step: step(flats[0]),
                    });
                } else {
                    open.edges.push(CandidateEdge { flats, vertices });
                }
            });
        }
    }
}

/// Calls `take` with every edge of which `wanted` is true of its flats.
#[inline(always)]
pub(super) fn for_each_where<T: Copy, E: Copy>(
    flats: &[[T; 2]],
    ends: &[E],
    wanted: impl Fn([T; 2]) -> bool,
    mut take: impl FnMut([T; 2], E),
) {
    let mut found = [0; CHUNK];
    for (flats, ends) in flats.chunks(CHUNK).zip(ends.chunks(CHUNK)) {
        // Collected without a branch, which would often be guessed wrong.
        let mut count = 0;
        for (index, pair) in flats.iter().enumerate() {
            found[count % CHUNK] = index as u8;
            count += usize::from(wanted(*pair));
        }
        for &index in &found[..count] {
            take(flats[usize::from(index)], ends[usize::from(index)]);
        }
    }
}

/// Layers that begin at an edge whose first flat faces the eye (1), or end (0), along
/// with those of its second one.
fn step(face: u32) -> i32 {
    4 * face as i32 - 2
}

/// How the flats of a block lie to a group of points, a bit for each.
#[derive(Clone, Copy, Default)]
struct Side {
    /// [`FRONT`].
    front: u64,
    /// [`EITHER`]; their numbers follow one another, from `first` on.
    either: u64,
    first: u32,
}

impl Side {
    /// What candidates call a flat of the block.
    #[inline(always)]
    fn number(self, flat: u8) -> u32 {
        let bit = 1u64.wrapping_shl(u32::from(flat));
        if self.either & bit == 0 {
            u32::from(self.front & bit != 0)
        } else {
            self.first + (self.either & (bit - 1)).count_ones()
        }
    }

    /// Whether all flats of both blocks lie to one side.
    #[inline(always)]
    fn is_same(self, other: Self) -> bool {
        self.front == other.front
            && (self.either | other.either) == 0
            && (self.front == 0 || self.front == !0)
    }
}

/// How flats lie to a group of points.
#[derive(Default)]
pub(super) struct Sides {
    blocks: Vec<Side>,
    /// Blocks whose flats may differ.
    mixed: Vec<u32>,
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
    fn test(&self, eye: Vec3, reach: f32) -> [u32; LANES] {
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
            *side = EITHER - u32::from(front) - 2 * u32::from(back);
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
        let groups = sides.blocks.chunks_mut(LANES);
        for (number, (cones, group)) in mesh.cones.iter().zip(groups).enumerate() {
            let known = cones.test(centre, reach);
            for (lane, (known, side)) in known.into_iter().zip(group).enumerate() {
                *side = Side {
                    front: if known == FRONT { !0 } else { 0 },
                    either: 0,
                    first: 0,
                };
                if known == EITHER {
                    let index = number * LANES + lane;
                    let planes = mesh.planes.each_ref().map(|plane| block_of(plane, index));
                    let [front, either] = sides_of(planes, centre, reach);
                    side.front = pack_bits(&front);
                    side.either = pack_bits(&either);
                    sides.mixed.push(index as u32);
                }
            }
        }
    }
}

/// Which flats of a block face all points within `reach` of a point, and which may face some of them, by their planes.
#[inline(always)]
pub(super) fn sides_of(
    [x, y, z, d]: [&[f32; BLOCK]; 4],
    point: Vec3,
    reach: f32,
) -> [[u8; BLOCK]; 2] {
    let (mut front, mut either) = ([0; BLOCK], [0; BLOCK]);
    for i in 0..BLOCK {
        let height = x[i] * point.x + y[i] * point.y + z[i] * point.z - d[i];
        front[i] = u8::from(height > reach);
        // Also where the height is no number.
        either[i] = 1 - front[i] - u8::from(height < -reach);
    }
    [front, either]
}

/// The elements that belong to a block of flats.
#[inline(always)]
pub(super) fn block_of<T>(elements: &[T], block: usize) -> &[T; BLOCK] {
    &elements.as_chunks().0[block]
}

/// Normal of any length, and its product with a point of the triangle.
fn plane(positions: &[Vec3], triangle: [u32; 3]) -> (DVec3, f64) {
    let [a, b, c] = triangle.map(|vertex| positions[vertex as usize].as_dvec3());
    let normal = (b - a).cross(c - a);
    (normal, normal.dot(a))
}

/// The same with a normal of unit length, and the triangle's area.
fn unit_plane(positions: &[Vec3], triangle: [u32; 3]) -> Plane {
    let (normal, _) = plane(positions, triangle);
    let unit = normal.normalize();
    Plane {
        normal: unit,
        distance: unit.dot(positions[triangle[0] as usize].as_dvec3()),
        area: 0.5 * normal.length(),
    }
}

fn flats(positions: &[Vec3], triangles: &[[u32; 3]], edges: &[HalfEdge]) -> Option<Flats> {
    let plane = |triangle: u32| unit_plane(positions, triangles[triangle as usize]);
    let around = || edges.chunk_by(|a, b| a.0 == b.0);
    // At edges of more triangles, of which a flat may have two, its part would not be told by the edge.
    let mut alone = vec![false; triangles.len()];
    for sides in around().filter(|sides| sides.len() > 1 && regular_pair(sides).is_none()) {
        for &(_, triangle, _) in sides {
            alone[triangle as usize] = true;
        }
    }
    let neighbours = around().filter_map(regular_pair);
    let neighbours =
        neighbours.filter(|pair| !pair.iter().any(|&triangle| alone[triangle as usize]));
    let (low, high) = bounds(positions.iter().copied());
    let bounds = [low, high].map(Vec3::as_dvec3);
    Flats::new(triangles.len(), plane, neighbours, bounds)
}

/// An order of so many flats, by their largest triangles, in which runs of [`BLOCK`] are close in place and normal.
fn group(positions: &[Vec3], count: usize, largest: impl Fn(u32) -> [u32; 3]) -> Vec<u32> {
    let (low, high) = positions.iter().fold(
        (Vec3::INFINITY, Vec3::NEG_INFINITY),
        |(low, high), position| (low.min(*position), high.max(*position)),
    );
    let scale = 1.0 / (high - low).max_element().max(f32::MIN_POSITIVE);
    let features: Vec<[f32; 6]> = (0..count as u32)
        .map(|flat| {
            let [a, b, c] = largest(flat).map(|vertex| positions[vertex as usize]);
            let place = (a + b + c) / 3.0 * scale;
            let normal = (b - a).cross(c - a).normalize_or_zero() * NORMAL_WEIGHT;
            [place.x, place.y, place.z, normal.x, normal.y, normal.z]
        })
        .collect();
    let mut order: Vec<u32> = (0..count as u32).collect();
    visibility::arrange(&mut order, &[BLOCK], &|&flat| {
        (features[flat as usize], flat)
    });
    order
}
