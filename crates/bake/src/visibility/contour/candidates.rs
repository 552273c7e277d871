//! What the points of a small group may see as contours.
//!
//! Seen from points close together, most contours are the same: the triangles at them face
//! all of the points or none. Those are found once per group. What remains to be done for
//! every point are the few triangles whose planes pass through the group.

use std::ops::Range;

use glam::{DVec3, Vec3};
use pulp::{Simd, WithSimd};

use crate::simd;

use super::Contour;
use super::batch::{Batch, LANES};
use super::facing::{BLOCK, Facing, IrregularEdge, Sides, block_of, for_each_where};
use super::loose::Bundle;
use super::parts::Parts;

/// Numbers below this stand for triangles that face no point of the group, or every point, and
/// for those that are not there.
const KNOWN: usize = 3;
/// Stands for the second triangle of an edge that has one.
pub(super) const ABSENT: u32 = 2;

/// An edge that some points may see as a contour: the first triangle is wound along it, the second
/// against it.
#[derive(Clone, Copy, Default)]
pub(super) struct CandidateEdge {
    pub(super) triangles: [u32; 2],
    pub(super) vertices: [u32; 2],
}

/// Contours of the points within a sphere.
pub(super) struct Candidates {
    centre: Vec3,
    radius: f32,
    /// Contours that every point sees.
    pub(super) sure: Vec<Contour>,
    /// The same, with the coordinates of their vertices, part after part.
    sure_batches: Vec<Batch<3>>,
    /// Parts of the mesh: those that look largest come first. Their numbers here are their
    /// *places*.
    order: Vec<u32>,
    /// The other way about.
    places: Vec<u32>,
    /// Boxes of the parts.
    boxes: Vec<[Vec3; 2]>,
    /// What each one takes to count, see [`Self::contours_of`].
    costs: Vec<u32>,
    /// Where each one's batches begin, and where the last one's end; the same of its edges.
    first_batch: Vec<u32>,
    first_edge: Vec<u32>,
    /// What is being sorted.
    sorted_contours: Vec<Contour>,
    sorted_edges: Vec<CandidateEdge>,
    /// Triangles that may face some points and others not, as in [`Facing`].
    planes: [Vec<f32>; 4],
    /// Their numbers there.
    numbers: Vec<u32>,
    /// Edges of such triangles. The first [`KNOWN`] numbers are not theirs.
    pub(super) edges: Vec<CandidateEdge>,
    /// The same, with the coordinates of their vertices.
    edge_triangles: Vec<[u32; 2]>,
    edge_ends: Vec<[[f32; 3]; 2]>,
    /// Edges of more triangles than two, or of two that do not fit each other.
    pub(super) irregular: Vec<IrregularEdge>,
    /// Per bundle of loose triangles, their numbers.
    pub(super) loose: Vec<[u32; LANES]>,
    /// Per number, 1 if the triangle faces the point looked at last, −1 if not, 0 if it is absent.
    faces: Vec<i8>,
    /// Triangles whose planes that point lies in, but for rounding.
    in_plane: Vec<u32>,
    /// Those of them that it lies on, which way they face, and their vertices.
    touched: Vec<(u32, i8, [u32; 3])>,
    /// Contours that this point sees besides.
    found_batches: Vec<Batch<3>>,
    sides: Sides,
}

impl Default for Candidates {
    /// Of no point.
    fn default() -> Self {
        Self {
            centre: Vec3::NAN,
            radius: f32::NAN,
            sure: Vec::new(),
            sure_batches: Vec::new(),
            order: Vec::new(),
            boxes: Vec::new(),
            places: Vec::new(),
            costs: Vec::new(),
            first_batch: Vec::new(),
            first_edge: Vec::new(),
            sorted_contours: Vec::new(),
            sorted_edges: Vec::new(),
            planes: [const { Vec::new() }; 4],
            numbers: Vec::new(),
            edges: Vec::new(),
            edge_triangles: Vec::new(),
            edge_ends: Vec::new(),
            irregular: Vec::new(),
            loose: Vec::new(),
            faces: Vec::new(),
            in_plane: Vec::new(),
            touched: Vec::new(),
            found_batches: Vec::new(),
            sides: Sides::default(),
        }
    }
}

impl Candidates {
    /// Looks for the contours of all points in the bounds of `origins`.
    pub(super) fn prepare(
        &mut self,
        facing: &Facing,
        parts: &Parts,
        positions: &[Vec3],
        origins: &[Vec3],
    ) {
        let (low, high) = origins.iter().fold(
            (Vec3::INFINITY, Vec3::NEG_INFINITY),
            |(low, high), &origin| (low.min(origin), high.max(origin)),
        );
        self.centre = low.midpoint(high);
        let distances = origins.iter().map(|origin| origin.distance(self.centre));
        self.radius = distances.fold(0.0, f32::max);
        let mut sides = std::mem::take(&mut self.sides);
        facing.find_candidates(self.centre, self.radius, parts, &mut sides, self);
        self.sides = sides;
        self.arrange(parts, positions);
    }

    /// Gathers the contours part after part.
    fn arrange(&mut self, parts: &Parts, positions: &[Vec3]) {
        self.order.clear();
        self.order.extend(0..parts.count() as u32);
        if parts.count() > 1 {
            let centre = self.centre;
            let size = |&part: &u32| {
                let [low, high] = parts.boxes[part as usize];
                let distance = centre.distance_squared(centre.clamp(low, high));
                low.distance_squared(high) / distance.max(f32::MIN_POSITIVE)
            };
            self.order
                .sort_by_cached_key(|part| (std::cmp::Reverse(size(part).to_bits()), *part));
        }
        self.boxes.clear();
        let boxes = self.order.iter().map(|&part| parts.boxes[part as usize]);
        self.boxes.extend(boxes);
        self.places.resize(parts.count(), 0);
        for (place, &part) in self.order.iter().enumerate() {
            self.places[part as usize] = place as u32;
        }
        let place_at = |vertex: u32| self.places[parts.of_vertex(vertex) as usize] as usize;
        let mut first = Vec::new();
        let place = |contour: &Contour| place_at(contour.vertices[0]);
        let sorted = &mut self.sorted_contours;
        sort(&mut self.sure, sorted, parts.count(), place, &mut first);
        self.first_batch.clear();
        self.sure_batches.clear();
        for range in first.windows(2) {
            self.first_batch.push(self.sure_batches.len() as u32);
            let contours = &self.sure[range[0] as usize..range[1] as usize];
            gather(contours, positions, &mut self.sure_batches);
        }
        self.first_batch.push(self.sure_batches.len() as u32);
        self.costs.clear();
        let ends = self.first_batch.windows(2);
        self.costs
            .extend(ends.zip(&self.order).map(|(ends, &part)| {
                let bundle = parts.bundle_of(part).is_some();
                (ends[1] - ends[0] + u32::from(bundle)) * LANES as u32
            }));
        let place = |edge: &CandidateEdge| place_at(edge.vertices[0]);
        let (sorted, first) = (&mut self.sorted_edges, &mut self.first_edge);
        sort(&mut self.edges, sorted, parts.count(), place, first);
        self.edge_triangles.clear();
        self.edge_ends.clear();
        for edge in &self.edges {
            self.edge_triangles.push(edge.triangles);
            let end = |vertex: u32| positions[vertex as usize].to_array();
            self.edge_ends.push(edge.vertices.map(end));
        }
    }

    /// What all parts take to count, see [`Self::contours_of`].
    pub(super) fn expected(&self) -> usize {
        self.sure.len() + self.loose.len() * LANES
    }

    /// Parts of the mesh: those that look largest from the group come first.
    pub(super) fn parts_in_order(&self) -> &[u32] {
        &self.order
    }

    /// Boxes of the parts, in the same order.
    pub(super) fn boxes(&self) -> &[[Vec3; 2]] {
        &self.boxes
    }

    /// What a part takes to count, in contours that every point sees: lanes in use and those left free. A bundle
    /// takes one batch.
    pub(super) fn contours_of(&self, place: u32) -> usize {
        self.costs[place as usize] as usize
    }

    /// Bundles of loose triangles among the parts at these places, with their numbers, and which way each triangle faces, as seen from the point looked at
    /// last: 1 or −1, and 0 if it does not count.
    pub(super) fn loose<'a>(
        &'a self,
        parts: &'a Parts,
        places: &'a [u32],
    ) -> impl Iterator<Item = (usize, &'a Bundle, impl Fn(usize) -> i8)> {
        places.iter().filter_map(|&place| {
            let number = parts.bundle_of(self.order[place as usize])?;
            let triangles = &self.loose[number];
            let face = |lane: usize| self.faces[triangles[lane] as usize];
            Some((number, &parts.bundles[number], face))
        })
    }

    /// The contours of the parts at these places: those that every point sees, and those that
    /// were found last.
    pub(super) fn contours<'a>(
        &'a self,
        places: &'a [u32],
    ) -> impl Iterator<Item = &'a [Batch<3>]> {
        ranges(places, &self.first_batch)
            .map(|range| &self.sure_batches[range])
            .chain([&self.found_batches[..]])
    }

    /// Finds the other contours of the parts at these places that the point looked at last sees.
    /// The triangles that it lies on do not count.
    pub(super) fn find(&mut self, parts: &Parts, positions: &[Vec3], places: &[u32]) {
        self.found_batches.clear();
        simd::arch().dispatch(Find {
            candidates: self,
            places,
        });
        let face = |triangle: u32| self.faces[triangle as usize];
        for edge in &self.irregular {
            let place = self.places[parts.of_vertex(edge.vertices[0]) as usize];
            if let Some(contour) = edge.contour(face)
                && places.binary_search(&place).is_ok()
            {
                append(&mut self.found_batches, contour, positions);
            }
        }
    }

    /// Contours of the triangles that the point looked at last lies on.
    pub(super) fn contours_of_touched(&mut self, parts: &Parts, positions: &[Vec3]) -> &[Batch<3>] {
        self.found_batches.clear();
        for &(index, face, _) in &self.touched {
            self.faces[KNOWN + index as usize] = face;
        }
        let is_touched = |triangle: u32| {
            let mut touched = self.touched.iter();
            touched.any(|(index, ..)| KNOWN + *index as usize == triangle as usize)
        };
        let face = |triangle: u32| self.faces[triangle as usize];
        let regular = self.edges.iter().filter_map(|edge| {
            let step = edge.triangles.map(|triangle| i32::from(face(triangle)));
            let contour = Contour {
                vertices: edge.vertices,
                step: step[0] - step[1],
            };
            (contour.step != 0 && edge.triangles.into_iter().any(is_touched)).then_some(contour)
        });
        let irregular = self.irregular.iter().filter_map(|edge| {
            let mut triangles = edge.triangles.iter();
            (triangles.any(|(triangle, _)| is_touched(*triangle))).then(|| edge.contour(face))?
        });
        let loose = self.touched.iter().flat_map(|&(_, face, corners)| {
            let loose = parts.bundle_of(parts.of_vertex(corners[0])).is_some();
            let edges =
                loose.then(|| [[0, 1], [1, 2], [2, 0]].map(|edge| edge.map(|i| corners[i])));
            let step = i32::from(face);
            (edges.into_iter().flatten()).map(move |vertices| Contour { vertices, step })
        });
        for contour in regular.chain(irregular).chain(loose) {
            append(&mut self.found_batches, contour, positions);
        }
        &self.found_batches
    }

    /// Whether these are the contours of `eye` among others.
    pub(super) fn covers(&self, eye: Vec3) -> bool {
        eye.distance(self.centre) <= self.radius
    }

    pub(super) fn clear(&mut self) {
        self.sure.clear();
        self.planes.iter_mut().for_each(Vec::clear);
        self.numbers.clear();
        self.edges.clear();
        self.irregular.clear();
        self.loose.clear();
    }

    /// What the triangle that is added next is called.
    pub(super) fn next_triangle(&self) -> u32 {
        (KNOWN + self.numbers.len()) as u32
    }

    /// `number` is that in [`Facing`].
    pub(super) fn add_triangle(&mut self, plane: [f32; 4], number: u32) {
        for (planes, value) in self.planes.iter_mut().zip(plane) {
            planes.push(value);
        }
        self.numbers.push(number);
    }

    /// Pads the triangles to whole blocks, with some that nobody sees.
    pub(super) fn finish_triangles(&mut self) {
        let padded = self.numbers.len().next_multiple_of(BLOCK);
        let [x, y, z, d] = &mut self.planes;
        for normal in [x, y, z] {
            normal.resize(padded, 0.0);
        }
        d.resize(padded, f32::INFINITY);
        self.faces.resize(KNOWN + padded, 0);
        self.faces[..KNOWN].copy_from_slice(&[-1, 1, 0]);
    }

    /// Finds what `eye` sees. Triangles that it lies on, but for rounding, are told by
    /// [`Self::touched`]: whether a ray from there meets them is a matter of its arithmetic.
    pub(super) fn look(&mut self, facing: &Facing, positions: &[Vec3], eye: Vec3) {
        self.in_plane.clear();
        simd::arch().dispatch(Look {
            candidates: self,
            facing,
            rounding: facing.rounding_at(eye),
            rounding_of_axes: facing.rounding_of_axes(eye),
            eye,
        });
        self.touched.clear();
        for i in 0..self.in_plane.len() {
            let index = self.in_plane[i];
            let corners = facing.corners(self.numbers[index as usize]);
            let places = corners.map(|vertex| positions[vertex as usize].as_dvec3());
            if touches(places, eye, 4.0 * facing.rounding_at(eye)) {
                let face = &mut self.faces[KNOWN + index as usize];
                self.touched.push((index, *face, corners));
                *face = 0;
            }
        }
    }

    /// Vertices of the triangles that the point looked at last lies on.
    pub(super) fn touched(&self) -> impl Iterator<Item = [u32; 3]> {
        self.touched.iter().map(|(.., corners)| *corners)
    }

    #[inline(always)]
    fn find_faces(
        &mut self,
        of: &Facing,
        block: usize,
        eye: Vec3,
        (rounding, of_axes): (f32, DVec3),
    ) {
        let first = block * BLOCK;
        let [x, y, z, d] = self.planes.each_ref().map(|plane| block_of(plane, block));
        let faces = &mut self.faces[KNOWN + first..][..BLOCK];
        let mut unclear = false;
        for i in 0..BLOCK {
            let height = x[i] * eye.x + y[i] * eye.y + z[i] * eye.z - d[i];
            faces[i] = facing(height > 0.0);
            unclear |= height.abs() < rounding;
        }
        if unclear {
            let eye = eye.as_dvec3();
            let numbers = &self.numbers[first..];
            for ((face, number), index) in faces.iter_mut().zip(numbers).zip(first..) {
                let [x, y, z, d] = of.precise(*number);
                let height = x * eye.x + y * eye.y + z * eye.z - d;
                *face = facing(height > 0.0);
                let normal = DVec3::new(x, y, z);
                let rounding = f64::from(rounding) * normal.length();
                if height.abs() <= rounding.min(normal.abs().dot(of_axes)) {
                    self.in_plane.push(index as u32);
                }
            }
        }
    }
}

/// Whether a point in a triangle's plane lies on it, or within a margin.
fn touches([a, b, c]: [DVec3; 3], eye: Vec3, margin: f32) -> bool {
    let normal = (b - a).cross(c - a).normalize_or_zero();
    [(a, b), (b, c), (c, a)].into_iter().all(|(from, to)| {
        let inward = normal.cross(to - from).normalize_or_zero();
        inward.dot(eye.as_dvec3() - from) >= -f64::from(margin)
    })
}

fn append(batches: &mut Vec<Batch<3>>, contour: Contour, positions: &[Vec3]) {
    let ends = (contour.vertices).map(|vertex| positions[vertex as usize].into());
    Batch::append(batches, ends, contour.step);
}

fn gather(contours: &[Contour], positions: &[Vec3], batches: &mut Vec<Batch<3>>) {
    batches.extend(contours.chunks(LANES).map(|contours| {
        let mut batch = Batch::EMPTY;
        batch.count = contours.len();
        for (lane, contour) in contours.iter().enumerate() {
            let [a, b] = contour
                .vertices
                .map(|vertex| positions[vertex as usize].into());
            batch.set(lane, [a, b], contour.step);
        }
        batch
    }));
}

/// The vectorised body of [`Candidates::look`].
struct Look<'a> {
    candidates: &'a mut Candidates,
    facing: &'a Facing,
    eye: Vec3,
    rounding: f32,
    rounding_of_axes: DVec3,
}

impl WithSimd for Look<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let Self {
            candidates,
            facing,
            eye,
            rounding,
            rounding_of_axes,
        } = self;
        for block in 0..candidates.planes[0].len() / BLOCK {
            candidates.find_faces(facing, block, eye, (rounding, rounding_of_axes));
        }
    }
}

/// The vectorised body of [`Candidates::find`].
struct Find<'a> {
    candidates: &'a mut Candidates,
    places: &'a [u32],
}

impl WithSimd for Find<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let Self { candidates, places } = self;
        let faces = &candidates.faces;
        let face = |triangle: u32| faces[triangle as usize];
        let differ = |[a, b]: [u32; 2]| face(a) != face(b);
        let found = &mut candidates.found_batches;
        for range in ranges(places, &candidates.first_edge) {
            let triangles = &candidates.edge_triangles[range.clone()];
            let ends = &candidates.edge_ends[range];
            for_each_where(triangles, ends, differ, |[a, b], ends| {
                Batch::append(found, ends, i32::from(face(a)) - i32::from(face(b)));
            });
        }
    }
}

fn facing(front: bool) -> i8 {
    2 * i8::from(front) - 1
}

/// Of what is sorted by place and begins at `first`, that of some places, which grow: most follow
/// each other, and theirs comes as one.
fn ranges<'a>(places: &'a [u32], first: &'a [u32]) -> impl Iterator<Item = Range<usize>> + 'a {
    places.chunk_by(|a, b| a + 1 == *b).map(|places| {
        let start = places[0] as usize;
        first[start] as usize..first[start + places.len()] as usize
    })
}

/// Sorts by place, and tells where each one's begin and where the last one's end.
fn sort<T: Copy + Default>(
    items: &mut Vec<T>,
    sorted: &mut Vec<T>,
    places: usize,
    place: impl Fn(&T) -> usize,
    first: &mut Vec<u32>,
) {
    first.clear();
    if places == 1 {
        first.extend([0, items.len() as u32]);
        return;
    }
    // Counted two places on, and moved on while items are sorted, each begins at its own.
    first.resize(places + 2, 0);
    for item in items.iter() {
        first[place(item) + 2] += 1;
    }
    for place in 2..first.len() {
        first[place] += first[place - 1];
    }
    sorted.resize(items.len(), T::default());
    for item in items.iter() {
        let next = &mut first[place(item) + 1];
        sorted[*next as usize] = *item;
        *next += 1;
    }
    first.pop();
    std::mem::swap(items, sorted);
}
