//! Which places are sampled where a mesh is finer than what is seen changes, and what stands for
//! the others.
//!
//! Scans have vertices far closer together than visibility needs. Places are sampled so far apart that each of the
//! others has some within a given way along the surface; those around it stand for it, weighted so that
//! what changes linearly over the surface comes out right (moving least squares: Lancaster & Salkauskas 1981).
//! Those on borders and creases stand for each other and for what is beside them, but nothing beside them stands for
//! them.

use std::cmp::Ordering;
use std::collections::BinaryHeap;

use glam::{DMat3, DVec3, Vec3};

/// How far what stands for a place may be away, in the spacing.
const REACH: f32 = 1.7;
/// How many stand for a place, at most.
const MOST: usize = 8;
/// Least weight of one of them: those around a place may lie to one side of it.
const LEAST_WEIGHT: f64 = -0.15;
/// Determinant of the equations for weights, of which those around a place on a line have less.
const LEAST_AREA: f64 = 1e-6;
/// What is then added to them.
const RIDGE: f64 = 1e-3;

/// For every place those that are sampled for it.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Sparse {
    /// Where each place's begin in `sources`; one more than there are places.
    first: Vec<u32>,
    sources: Vec<(u32, f32)>,
}

/// How far apart, and over what.
#[derive(Clone, Debug)]
pub(crate) struct Spacing {
    /// About every place, metres.
    pub distances: Vec<f32>,
    /// Cosine between the normals of a place and of what stands for it, and between those of triangles that
    /// make no crease, at least.
    pub smooth: f32,
}

impl Sparse {
    /// Every place is sampled.
    pub(crate) fn all(places: usize) -> Self {
        Self {
            first: (0..=places as u32).collect(),
            sources: (0..places as u32).map(|place| (place, 1.0)).collect(),
        }
    }

    /// Sampled places are at most about `spacing` apart. `triangles` have places for corners.
    pub(crate) fn new(origins: &[Vec3], triangles: &[[u32; 3]], spacing: &Spacing) -> Self {
        let surface = Surface::new(origins, triangles, spacing.smooth);
        let mut reached: Vec<Vec<(f32, u32)>> = vec![Vec::new(); origins.len()];
        let mut covered = vec![false; origins.len()];
        let mut sampled = vec![false; origins.len()];
        let mut walk = Walk::new(origins.len());
        let (first, others): (Vec<u32>, Vec<u32>) =
            (0..origins.len() as u32).partition(|&place| surface.is_edge(place));
        for place in first.into_iter().chain(others) {
            if covered[place as usize] {
                continue;
            }
            sampled[place as usize] = true;
            let distance = spacing.distances[place as usize];
            let mut visit = |other: u32, way: f32| {
                covered[other as usize] |= way <= distance;
                reached[other as usize].push((way, place));
            };
            walk.over_faces(&surface, place, REACH * distance, |other, way| {
                if !surface.is_edge(other) {
                    visit(other, way);
                }
            });
            if surface.is_edge(place) {
                walk.along_edges(&surface, place, REACH * distance, visit);
            }
        }
        let mut sparse = Self {
            first: vec![0],
            sources: Vec::new(),
        };
        for (place, mut around) in (0u32..).zip(reached) {
            if sampled[place as usize] {
                sparse.sources.push((place, 1.0));
            } else {
                around.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
                around.truncate(MOST);
                let normal = surface.normals[place as usize];
                let reach = |place: u32| REACH * spacing.distances[place as usize];
                let weights = weights(origins, place, normal, &around, reach);
                sparse.sources.extend(weights);
            }
            sparse.first.push(sparse.sources.len() as u32);
        }
        sparse
    }

    /// With others that stand for places: what `source` tells of one stands for it alone, and for what that one stood for.
    pub(crate) fn replaced(&self, source: impl Fn(u32) -> Option<u32>) -> Self {
        let mut replaced = Self {
            first: vec![0],
            sources: Vec::with_capacity(self.sources.len()),
        };
        for place in 0..self.first.len() as u32 - 1 {
            if let Some(source) = source(place) {
                replaced.sources.push((source, 1.0));
            } else {
                let sources = self.sources(place).iter();
                (replaced.sources).extend(
                    sources.map(|&(other, weight)| (source(other).unwrap_or(other), weight)),
                );
            }
            replaced.first.push(replaced.sources.len() as u32);
        }
        replaced
    }

    /// Whether every place is sampled.
    pub(crate) fn is_all(&self) -> bool {
        (0u32..)
            .zip(self.first.windows(2))
            .all(|(place, _)| self.sources(place) == [(place, 1.0)])
    }

    /// Places that are sampled, ascending.
    pub(crate) fn sampled(&self) -> Vec<u32> {
        let places = 0..self.first.len() as u32 - 1;
        places
            .filter(|&place| self.sources(place) == [(place, 1.0)])
            .collect()
    }

    /// What stands for a place; itself where it is sampled. Weights add up to 1.
    pub(crate) fn sources(&self, place: u32) -> &[(u32, f32)] {
        let [first, end] = [0, 1].map(|next| self.first[place as usize + next] as usize);
        &self.sources[first..end]
    }

    /// Those that stand for some places, ascending.
    pub(crate) fn sources_of(&self, places: impl Iterator<Item = u32>) -> Vec<u32> {
        let mut sources: Vec<u32> = places
            .flat_map(|place| self.sources(place).iter().map(|(source, _)| *source))
            .collect();
        sources.sort_unstable();
        sources.dedup();
        sources
    }
}

/// The weights of those `around` a place, with their ways from it, each of which reaches so far.
fn weights(
    origins: &[Vec3],
    place: u32,
    normal: Vec3,
    around: &[(f32, u32)],
    reach: impl Fn(u32) -> f32,
) -> Vec<(u32, f32)> {
    let centre = origins[place as usize];
    let normal = normal.as_dvec3();
    let basis = (normal.try_normalize()).unwrap_or(DVec3::Y);
    let (x, y) = basis.any_orthonormal_pair();
    let near = |way: f32, source: u32| {
        let way = f64::from(way / reach(source));
        (1.0 - way).max(1e-3).powi(2) / (way * way + 1e-4)
    };
    let rows: Vec<(f64, DVec3)> = (around.iter())
        .map(|&(way, source)| {
            let away = (origins[source as usize] - centre).as_dvec3() / f64::from(reach(place));
            (near(way, source), DVec3::new(1.0, away.dot(x), away.dot(y)))
        })
        .collect();
    let mut normal_matrix = DMat3::ZERO;
    for (weight, row) in &rows {
        normal_matrix += DMat3::from_cols(*row * row.x, *row * row.y, *row * row.z) * *weight;
    }
    let total: f64 = rows.iter().map(|(weight, _)| weight).sum();
    if normal_matrix.determinant() < LEAST_AREA * total.powi(3) {
        // On a line, what changes across it is unknown, and taken for none.
        normal_matrix += DMat3::from_diagonal(DVec3::new(0.0, RIDGE, RIDGE)) * total;
    }
    let mut found: Vec<f64> = rows.iter().map(|(weight, _)| weight / total).collect();
    let solution = normal_matrix.inverse() * DVec3::X;
    let linear: Vec<f64> = (rows.iter())
        .map(|(weight, row)| weight * row.dot(solution))
        .collect();
    if linear.iter().all(|weight| *weight >= LEAST_WEIGHT) {
        found = linear;
    }
    let sum: f64 = found.iter().sum();
    (around.iter().zip(found))
        .map(|(&(_, source), weight)| (source, (weight / sum) as f32))
        .collect()
}

/// Places with their neighbours.
struct Surface<'a> {
    origins: &'a [Vec3],
    /// Unit length, or zero.
    normals: Vec<Vec3>,
    /// Where each place's begin in `neighbours`.
    first: Vec<u32>,
    neighbours: Vec<u32>,
    /// Whether each place is on a border or a crease.
    edges: Vec<bool>,
    smooth: f32,
}

impl<'a> Surface<'a> {
    fn new(origins: &'a [Vec3], triangles: &[[u32; 3]], smooth: f32) -> Self {
        let count = origins.len();
        let face = |triangle: &[u32; 3]| {
            let [a, b, c] = triangle.map(|place| origins[place as usize]);
            (b - a).cross(c - a)
        };
        let mut normals = vec![Vec3::ZERO; count];
        let mut ends: Vec<[u32; 2]> = Vec::with_capacity(3 * triangles.len());
        for triangle in triangles {
            for k in 0..3 {
                normals[triangle[k] as usize] += face(triangle);
                let [a, b] = [triangle[k], triangle[(k + 1) % 3]];
                ends.push([a.min(b), a.max(b)]);
            }
        }
        for normal in &mut normals {
            *normal = normal.normalize_or_zero();
        }
        let mut edges = vec![false; count];
        for triangle in triangles {
            let face = face(triangle).normalize_or_zero();
            for &place in triangle {
                edges[place as usize] |= normals[place as usize].dot(face) < smooth;
            }
        }
        ends.sort_unstable();
        let sides = || ends.chunk_by(|a, b| a == b);
        let mut first = vec![0u32; count + 1];
        for side in sides() {
            for place in side[0] {
                first[place as usize + 1] += 1;
                edges[place as usize] |= side.len() != 2;
            }
        }
        for place in 0..count {
            first[place + 1] += first[place];
        }
        let mut next = first.clone();
        let mut neighbours = vec![0; first[count] as usize];
        for side in sides() {
            let [a, b] = side[0];
            for [from, to] in [[a, b], [b, a]] {
                let at = &mut next[from as usize];
                neighbours[*at as usize] = to;
                *at += 1;
            }
        }
        Self {
            origins,
            normals,
            first,
            neighbours,
            edges,
            smooth,
        }
    }

    fn is_edge(&self, place: u32) -> bool {
        self.edges[place as usize]
    }

    fn neighbours(&self, place: u32) -> &[u32] {
        let [first, end] = [0, 1].map(|next| self.first[place as usize + next] as usize);
        &self.neighbours[first..end]
    }
}

/// A place on the way, the nearest the greatest.
#[derive(PartialEq)]
struct Step {
    way: f32,
    place: u32,
}

impl Eq for Step {}

impl Ord for Step {
    fn cmp(&self, other: &Self) -> Ordering {
        other
            .way
            .total_cmp(&self.way)
            .then(other.place.cmp(&self.place))
    }
}

impl PartialOrd for Step {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

/// Shortest ways along edges (Dijkstra 1959), and what they need.
struct Walk {
    ahead: BinaryHeap<Step>,
    /// To every place, infinite to those that are not known.
    ways: Vec<f32>,
    known: Vec<u32>,
}

impl Walk {
    fn new(places: usize) -> Self {
        Self {
            ahead: BinaryHeap::new(),
            ways: vec![f32::INFINITY; places],
            known: Vec::new(),
        }
    }

    /// Visits the places within `reach` of one, over smooth surface alone, itself first.
    fn over_faces(
        &mut self,
        surface: &Surface,
        start: u32,
        reach: f32,
        visit: impl FnMut(u32, f32),
    ) {
        // Beyond a crease or a border the surface goes on as another.
        let goes_on = |place: u32| place == start || !surface.is_edge(place);
        self.walk(surface, (start, reach), goes_on, |_| true, visit);
    }

    /// The same along borders and creases.
    fn along_edges(
        &mut self,
        surface: &Surface,
        start: u32,
        reach: f32,
        visit: impl FnMut(u32, f32),
    ) {
        let is_edge = |place: u32| surface.is_edge(place);
        self.walk(surface, (start, reach), |_| true, is_edge, visit);
    }

    fn walk(
        &mut self,
        surface: &Surface,
        (start, reach): (u32, f32),
        goes_on: impl Fn(u32) -> bool,
        is_open: impl Fn(u32) -> bool,
        mut visit: impl FnMut(u32, f32),
    ) {
        for place in self.known.drain(..) {
            self.ways[place as usize] = f32::INFINITY;
        }
        self.reach(start, 0.0);
        let normal = surface.normals[start as usize];
        while let Some(Step { way, place }) = self.ahead.pop() {
            if self.ways[place as usize] < way {
                continue;
            }
            visit(place, way);
            if !goes_on(place) {
                continue;
            }
            for &next in surface.neighbours(place) {
                let [from, to] = [place, next].map(|place| surface.origins[place as usize]);
                let way = way + from.distance(to);
                if is_open(next)
                    && way < reach.min(self.ways[next as usize])
                    && surface.normals[next as usize].dot(normal) >= surface.smooth
                {
                    self.reach(next, way);
                }
            }
        }
    }

    fn reach(&mut self, place: u32, way: f32) {
        self.ways[place as usize] = way;
        self.known.push(place);
        self.ahead.push(Step { way, place });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::cluster::tests::grid;

    fn spacing(distance: f32, origins: &[Vec3]) -> Spacing {
        Spacing {
            distances: vec![distance; origins.len()],
            smooth: 0.9,
        }
    }

    fn sampled(sparse: &Sparse, places: u32) -> Vec<u32> {
        (0..places)
            .filter(|&place| sparse.sources(place) == [(place, 1.0)])
            .collect()
    }

    #[test]
    fn few_stand_for_a_fine_plane_and_linear_functions_come_out() {
        let n = 60;
        let (origins, triangles) = grid(n, |_, _| 0.0);
        let sparse = Sparse::new(&origins, &triangles, &spacing(4.0, &origins));
        let count = origins.len() as u32;
        let sampled = sampled(&sparse, count);
        let border = 4 * n as usize;
        assert!(sampled.len() < border + 500, "{}", sampled.len());
        let linear = |place: u32| 0.3 * origins[place as usize].x - origins[place as usize].z;
        let (mut worst, mut right) = (0f32, 0);
        for place in 0..count {
            let sources = sparse.sources(place);
            let sum: f32 = sources.iter().map(|(_, weight)| weight).sum();
            assert!((sum - 1.0).abs() < 1e-4);
            let found: f32 = (sources.iter())
                .map(|&(source, weight)| weight * linear(source))
                .sum();
            let off = (found - linear(place)).abs();
            right += usize::from(off < 1e-3);
            worst = worst.max(off);
            for &(source, _) in sources {
                assert!(sampled.binary_search(&source).is_ok());
                let apart = origins[source as usize].distance(origins[place as usize]);
                assert!(apart <= 4.0 * REACH);
            }
        }
        assert!(right as f32 > 0.9 * count as f32, "{right} of {count}");
        // No worse than what the nearest alone would be.
        assert!(worst < 1.05 * 4.0, "{worst}");
    }

    #[test]
    fn creases_are_not_crossed() {
        let (origins, triangles) = grid(20, |x, _| x.abs_diff(10) as f32);
        let sparse = Sparse::new(&origins, &triangles, &spacing(5.0, &origins));
        let count = origins.len() as u32;
        let sampled = sampled(&sparse, count);
        assert!(sampled.len() < 220, "{}", sampled.len());
        for place in 0..count {
            let at = origins[place as usize];
            for &(source, _) in sparse.sources(place) {
                let other = origins[source as usize];
                assert!((at.x - 10.0) * (other.x - 10.0) >= 0.0, "{at} {other}");
            }
        }
    }

    #[test]
    fn places_on_edges_stand_for_others_there_alone() {
        let n = 40;
        let (origins, triangles) = grid(n, |x, _| x.abs_diff(20) as f32);
        let sparse = Sparse::new(&origins, &triangles, &spacing(5.0, &origins));
        let count = origins.len() as u32;
        let sampled = sampled(&sparse, count);
        let is_edge = |at: Vec3| at.x == 20.0 || [at.x, at.z].iter().any(|x| x % n as f32 == 0.0);
        let on_edges = (0..count).filter(|&place| is_edge(origins[place as usize]));
        assert!(on_edges.clone().count() == 5 * n as usize - 1);
        let (mut few, mut along, mut worst) = (0, 0f32, 0f32);
        for place in on_edges {
            few += usize::from(sampled.contains(&place));
            let at = origins[place as usize];
            let mut found = 0.0;
            for &(source, weight) in sparse.sources(place) {
                let from = origins[source as usize];
                assert!(is_edge(from), "{at} {from}");
                found += weight * (from.x + 0.5 * from.z);
            }
            let off = (found - at.x - 0.5 * at.z).abs();
            worst = worst.max(off);
            let corner = |(x, z): (f32, f32)| at.distance(Vec3::new(x, at.y, z)) < 5.0 * REACH;
            let corners = [0.0, 20.0, 40.0].map(|x| [(x, 0.0), (x, 40.0)]);
            if !corners.into_iter().flatten().any(corner) {
                along = along.max(off);
            }
        }
        assert!(few < 5 * n as usize / 3, "{few}");
        // Along straight lines; no worse at corners than what the nearest alone would be.
        assert!(along < 0.2, "{along}");
        assert!(worst < 5.0, "{worst}");
    }

    #[test]
    fn coarse_meshes_are_sampled_everywhere() {
        let (origins, triangles) = grid(10, |_, _| 0.0);
        let count = origins.len();
        assert_eq!(
            Sparse::new(&origins, &triangles, &spacing(0.5, &origins)),
            Sparse::all(count)
        );
        assert_eq!(
            Sparse::new(&[], &[], &spacing(1.0, &origins)),
            Sparse::all(0)
        );
        assert!(Sparse::all(0).is_all() && Sparse::all(count).is_all());
        assert!(!Sparse::new(&origins, &triangles, &spacing(1.5, &origins)).is_all());
    }
}
