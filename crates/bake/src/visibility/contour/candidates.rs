//! What the points of a small group may see as contours.
//!
//! Seen from points close together, most contours are the same: the flats at them (`flats`) face
//! all of the points or none. Those are found once per group. Of what remains, the flats whose planes pass through the
//! group, fewer pass between the points of a run of it, and fewer still of a shorter one (`level`). What remains then is done for every point.

use std::ops::Range;

use glam::Vec3;
use pulp::{Simd, WithSimd};

use crate::simd;

use super::batch::{Batch, Filling, LANES};
use super::edges::outline;
use super::faces::Faces;
use super::facing::{Facing, Sides, for_each_where};
use super::level::Level;
use super::loose::Bundle;
use super::parts::Parts;
use super::{Contour, RUNS, bounds};

/// Numbers below this stand for flats that face no point of the group, or every point, and
/// for those that are not there.
pub(super) const KNOWN: u32 = 3;
/// Stands for the second flat of an edge that has one.
pub(super) const ABSENT: u32 = 2;
/// Of what these numbers stand for: −1 faces no point, 1 every point, 0 is absent.
pub(super) const FACES_OF_KNOWN: [i8; KNOWN as usize] = [-1, 1, 0];
/// Where fewer edges remain to a group, narrowing takes as long as it saves.
const MANY: usize = 1000;

/// An edge that some points may see as a contour: the first flat is wound along it, the second
/// against it.
#[derive(Clone, Copy, Default)]
pub(super) struct CandidateEdge {
    pub(super) flats: [u32; 2],
    pub(super) vertices: [u32; 2],
}

/// What is found of a group before it is sorted.
#[derive(Default)]
pub(super) struct Open {
    /// Contours that every point sees.
    pub(super) sure: Vec<Contour>,
    /// Edges that some may.
    pub(super) edges: Vec<CandidateEdge>,
}

/// Coordinates of an edge's vertices.
#[inline(always)]
pub(super) fn ends(positions: &[Vec3], vertices: [u32; 2]) -> [[f32; 3]; 2] {
    vertices.map(|vertex| positions[vertex as usize].to_array())
}

/// Contours of the points of a group.
#[derive(Default)]
pub(super) struct Candidates {
    /// The points.
    origins: Vec<Vec3>,
    /// What all points of the group may see, and what runs of them may, shorter and shorter.
    levels: [Level; RUNS.len()],
    /// How many of these the point looked at last needs; the last one has the edges that remain open.
    depth: usize,
    /// What the flats of one level are called in the next.
    names: Vec<u32>,
    open: Open,
    /// Parts of the mesh: those that look largest come first. Their numbers here are their
    /// *places*.
    order: Vec<u32>,
    /// The other way about.
    places: Vec<u32>,
    /// Boxes of the parts.
    boxes: Vec<[Vec3; 2]>,
    /// What each one takes to count, see [`Self::contours_of`].
    costs: Vec<u32>,
    /// See [`Self::expected`].
    expected: usize,
    /// What is being sorted.
    sorted_contours: Vec<Contour>,
    sorted_edges: Vec<CandidateEdge>,
    /// Which way flats face the point looked at last.
    faces: Faces,
    /// Contours that this point sees besides.
    found_batches: Vec<Batch<3>>,
    sides: Sides,
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
        self.origins.clear();
        self.origins.extend_from_slice(origins);
        let sphere = sphere_around(origins);
        let Self {
            levels,
            sides,
            open,
            ..
        } = self;
        open.sure.clear();
        open.edges.clear();
        levels[0].begin(sphere);
        facing.find_candidates(sphere, parts, sides, &mut levels[0], open);
        self.depth = 1;
        self.arrange(sphere.0, parts, positions);
    }

    /// Narrows down what the group may see to what the runs may that a point belongs to.
    fn narrow(&mut self, facing: &Facing, parts: &Parts, positions: &[Vec3], eye: Vec3) {
        let before = self.depth;
        let is_whole = before == RUNS.len();
        if is_whole && self.levels[1..].iter().all(|level| level.covers(eye)) {
            return;
        }
        // Levels from here on are made anew: those of a point before are of other runs.
        let mut known = before;
        self.depth = 1;
        while self.depth < RUNS.len() {
            let [.., outer, inner] = &mut self.levels[..=self.depth] else {
                break;
            };
            let length = RUNS[self.depth];
            let mut runs = self.origins.chunks(length);
            let origins = (self.origins.len() > length && outer.edge_flats.len() >= MANY)
                .then(|| runs.find(|run| run.contains(&eye)))
                .flatten();
            let Some(origins) = origins else {
                break;
            };
            let sphere = sphere_around(origins);
            if self.depth >= known || !inner.is_of(sphere) {
                known = self.depth;
                outer.narrow(facing, sphere, positions, &mut self.names, inner);
            }
            self.depth += 1;
        }
        if self.depth != before || known < before {
            self.set_costs(parts);
        }
    }

    fn level(&self) -> &Level {
        &self.levels[self.depth - 1]
    }

    /// Gathers the contours part after part.
    fn arrange(&mut self, centre: Vec3, parts: &Parts, positions: &[Vec3]) {
        self.order.clear();
        self.order.extend(0..parts.count() as u32);
        if parts.count() > 1 {
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
        sort(
            &mut self.open.sure,
            sorted,
            parts.count(),
            place,
            &mut first,
        );
        let level = &mut self.levels[0];
        for range in first.windows(2) {
            level.first_sure.push(level.sure.len() as u32);
            let contours = &self.open.sure[range[0] as usize..range[1] as usize];
            gather(contours, positions, &mut level.sure);
        }
        level.first_sure.push(level.sure.len() as u32);
        let place = |edge: &CandidateEdge| place_at(edge.vertices[0]);
        let (sorted, first) = (&mut self.sorted_edges, &mut level.first_edge);
        sort(&mut self.open.edges, sorted, parts.count(), place, first);
        let edges = self.open.edges.iter();
        (level.edge_flats).extend(edges.clone().map(|edge| edge.flats));
        (level.edge_vertices).extend(edges.map(|edge| edge.vertices));
        self.set_costs(parts);
    }

    fn set_costs(&mut self, parts: &Parts) {
        let is_bundle = |&part: &u32| u32::from(parts.bundle_of(part).is_some());
        self.costs.clear();
        self.costs.extend(self.order.iter().map(is_bundle));
        self.expected = parts.bundles.len() * LANES;
        for level in &self.levels[..self.depth] {
            for (cost, ends) in self.costs.iter_mut().zip(level.first_sure.windows(2)) {
                *cost += ends[1] - ends[0];
            }
            let counts = level.sure.iter().map(|batch| batch.count);
            self.expected += counts.sum::<usize>();
        }
        self.costs.iter_mut().for_each(|cost| *cost *= LANES as u32);
    }

    /// Contours that every point sees, and lanes of loose triangles.
    pub(super) fn expected(&self) -> usize {
        self.expected
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
            let triangles = &self.level().loose[number];
            let face = |lane: usize| self.faces.of(triangles[lane]);
            Some((number, &parts.bundles[number], face))
        })
    }

    /// The contours of the parts at these places: those that every point sees, and those that
    /// were found last.
    pub(super) fn contours<'a>(
        &'a self,
        places: &'a [u32],
    ) -> impl Iterator<Item = &'a [Batch<3>]> {
        (self.levels[..self.depth].iter())
            .flat_map(|level| ranges(places, &level.first_sure).map(|range| &level.sure[range]))
            .chain([&self.found_batches[..]])
    }

    /// Finds the other contours of the parts at these places that the point looked at last sees.
    /// The triangles that it lies on do not count.
    pub(super) fn find(&mut self, parts: &Parts, positions: &[Vec3], places: &[u32]) {
        self.found_batches.clear();
        simd::arch().dispatch(Find {
            level: &self.levels[self.depth - 1],
            positions,
            faces: &self.faces,
            found: &mut self.found_batches,
            places,
        });
        let irregular = self.levels[self.depth - 1].irregular.iter();
        let others =
            irregular.filter_map(|edge| edge.contour(|flat| self.faces.at(flat, || edge.vertices)));
        let mut found = Filling::new(&mut self.found_batches);
        for contour in others.chain(self.faces.within().iter().copied()) {
            let place = self.places[parts.of_vertex(contour.vertices[0]) as usize];
            if places.binary_search(&place).is_ok() {
                append(&mut found, contour, positions);
            }
        }
        found.finish();
    }

    /// Contours of the triangles that the point looked at last lies on.
    pub(super) fn contours_of_touched(&mut self, parts: &Parts, positions: &[Vec3]) -> &[Batch<3>] {
        self.found_batches.clear();
        let mut found = Filling::new(&mut self.found_batches);
        let faces = &self.faces;
        let is_touched = |flat: u32, edge: [u32; 2]| faces.of_touched(flat, edge).is_some();
        let face = |flat: u32, edge: [u32; 2]| {
            let touched = faces.of_touched(flat, edge);
            touched.unwrap_or_else(|| faces.at(flat, || edge))
        };
        let touched_flats: Vec<u32> = faces.touched().iter().map(|member| member.flat).collect();
        let level = &self.levels[self.depth - 1];
        for (flats, &vertices) in level.edge_flats.iter().zip(&level.edge_vertices) {
            if !flats.iter().any(|flat| touched_flats.contains(flat)) {
                continue;
            }
            let [a, b] = flats.map(|flat| i32::from(face(flat, vertices)));
            if a != b && flats.iter().any(|flat| is_touched(*flat, vertices)) {
                let step = a - b;
                append(&mut found, Contour { vertices, step }, positions);
            }
        }
        let irregular = level.irregular.iter().filter_map(|edge| {
            let mut flats = edge.flats.iter();
            let touched = flats.any(|(flat, _)| is_touched(*flat, edge.vertices));
            touched.then(|| edge.contour(|flat| face(flat, edge.vertices)))?
        });
        let loose = faces.touched().iter().flat_map(|member| {
            let part = parts.of_vertex(member.corners[0]);
            let edges = (parts.bundle_of(part)).map(|_| outline(member.corners));
            let step = i32::from(member.face);
            (edges.into_iter().flatten()).map(move |vertices| Contour { vertices, step })
        });
        for contour in irregular.chain(loose) {
            append(&mut found, contour, positions);
        }
        found.finish();
        &self.found_batches
    }

    /// Whether these are the contours of `eye` among others.
    pub(super) fn covers(&self, eye: Vec3) -> bool {
        self.levels[0].covers(eye)
    }

    /// Finds which way what `eye` may see faces it. Triangles that it lies on, but for rounding, are told by
    /// [`Self::touched`]: whether a ray from there meets them is a matter of its arithmetic.
    pub(super) fn look(&mut self, facing: &Facing, parts: &Parts, positions: &[Vec3], eye: Vec3) {
        self.narrow(facing, parts, positions, eye);
        let level = &self.levels[self.depth - 1];
        self.faces.look(level, facing, positions, eye);
    }

    /// Which way flats face the point looked at last.
    #[cfg(test)]
    pub(super) fn faces(&self) -> &Faces {
        &self.faces
    }

    /// Vertices of the triangles that the point looked at last lies on.
    pub(super) fn touched(&self) -> impl Iterator<Item = [u32; 3]> {
        self.faces.touched().iter().map(|member| member.corners)
    }
}

/// The sphere around the box of points, by its centre and radius.
fn sphere_around(origins: &[Vec3]) -> (Vec3, f32) {
    let (low, high) = bounds(origins.iter().copied());
    let centre = low.midpoint(high);
    let distances = origins.iter().map(|origin| origin.distance(centre));
    (centre, distances.fold(0.0, f32::max))
}

fn append(found: &mut Filling<3>, contour: Contour, positions: &[Vec3]) {
    let ends = (contour.vertices).map(|vertex| positions[vertex as usize].into());
    found.append(ends, contour.step);
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

/// The vectorised body of [`Candidates::find`].
struct Find<'a> {
    level: &'a Level,
    positions: &'a [Vec3],
    faces: &'a Faces,
    found: &'a mut Vec<Batch<3>>,
    places: &'a [u32],
}

impl WithSimd for Find<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let Self {
            level,
            positions,
            faces,
            found,
            places,
        } = self;
        let differ = |flats| faces.may_differ(flats);
        let mut found = Filling::new(found);
        for range in ranges(places, &level.first_edge) {
            let flats = &level.edge_flats[range.clone()];
            let vertices = &level.edge_vertices[range];
            for_each_where(flats, vertices, differ, |[a, b], vertices| {
                let face = |flat| i32::from(faces.at(flat, || vertices));
                let step = face(a) - face(b);
                if step != 0 {
                    found.append(ends(positions, vertices), step);
                }
            });
        }
        found.finish();
    }
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::visibility::contour::ContourMesh;
    use crate::visibility::contour::tests::ground;
    use crate::visibility::tests::random;
    use crate::visibility::{self, Directions};

    #[test]
    fn what_a_run_may_see_is_narrowed_down_to_the_same_bits() {
        let mut state = 17;
        let triangles = ground(128, &mut state, |_, random| 0.03 * random);
        let mesh = ContourMesh::new(&triangles);
        let directions = Directions::new(32);
        // Three runs, the last one of few, each around a place of its own, and shorter runs in them.
        let run = RUNS[1];
        let origins: Vec<Vec3> = (0..2 * run + 5)
            .map(|index| {
                let place = Vec3::new(0.1 * (index / run) as f32, 0.05, 0.0);
                place + 0.02 * Vec3::new(random(&mut state), random(&mut state), random(&mut state))
            })
            .collect();
        let mut scratch = mesh.scratch(&directions);
        mesh.prepare(&origins, &mut scratch);
        let of_group = scratch.candidates.level().edge_flats.len();
        assert!(of_group >= MANY, "{of_group} edges");
        // One run after the other, then from run to run, and one that is in none.
        let orders = (0..origins.len()).chain((0..origins.len()).map(|i| i * 17 % origins.len()));
        let points = orders.map(|index| origins[index]);
        let between = origins[0].midpoint(origins[run]);
        let mut runs = 0;
        for (index, eye) in points.chain([between, origins[1]]).enumerate() {
            let (found, _) = mesh.sample(eye, &directions, &mut scratch);
            let exact = visibility::sample(mesh.caster(), eye, &directions);
            assert!(found == exact, "{index}");
            let of_run = scratch.candidates.level().edge_flats.len();
            runs += usize::from(scratch.candidates.depth == RUNS.len() && of_run < of_group);
        }
        assert_eq!(runs, 2 * origins.len() + 1, "all but the one between");
    }

    #[test]
    fn a_point_is_in_every_run_that_is_narrowed_down_for_it() {
        let mut state = 23;
        let triangles = ground(128, &mut state, |_, random| 0.03 * random);
        let mesh = ContourMesh::new(&triangles);
        let directions = Directions::new(32);
        let mut at = |centre: Vec3, size: f32| {
            let offset = Vec3::from([0; 3].map(|_| 2.0 * random(&mut state) - 1.0));
            centre + size * offset
        };
        let origins: Vec<Vec3> = (0..RUNS[0])
            .map(|_| at(Vec3::new(0.1, 0.05, 0.0), 0.02))
            .collect();
        let mut scratch = mesh.scratch(&directions);
        mesh.prepare(&origins, &mut scratch);
        assert!(scratch.candidates.level().edge_flats.len() >= MANY);
        // A shorter run's sphere reaches out of that of the longer one that it is a part of: a point
        // there is in neither, though it is in the one that was narrowed down last.
        let mut beyond = 0;
        for origin in origins {
            mesh.sample(origin, &directions, &mut scratch);
            let [_, outer, inner] = &scratch.candidates.levels;
            let (centre, radius) = inner.sphere().expect("a run of the point");
            let points = (0..200).map(|_| at(centre, radius));
            let eye = { points }.find(|eye| inner.covers(*eye) && !outer.covers(*eye));
            let Some(eye) = eye.filter(|eye| scratch.candidates.covers(*eye)) else {
                continue;
            };
            let (found, _) = mesh.sample(eye, &directions, &mut scratch);
            assert!(found == visibility::sample(mesh.caster(), eye, &directions));
            let used = &scratch.candidates.levels[1..scratch.candidates.depth];
            assert!(used.iter().all(|level| level.covers(eye)));
            beyond += 1;
        }
        assert!(beyond > 20, "{beyond}");
    }
}
