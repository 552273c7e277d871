//! What the points within a sphere may see as contours, and what those within smaller spheres in it may.

use glam::Vec3;
use pulp::{Simd, WithSimd};

use super::batch::{Batch, Filling, LANES};
use super::candidates::{ABSENT, FACES_OF_KNOWN, KNOWN, ends};
use super::edges::IrregularEdge;
use super::facing::{BACK, BLOCK, FRONT, Facing, block_of, for_each_where, sides_of};
use crate::simd;

/// Flats that may face some of the points within a sphere and not others, their edges, and contours that
/// all of the points see.
#[derive(Default)]
pub(super) struct Level {
    /// Nothing is in it before a level was made.
    sphere: Option<(Vec3, f32)>,
    /// Contours that every point sees, part after part, but for those that a wider level has.
    pub(super) sure: Vec<Batch<3>>,
    /// Where each part's begin, and where the last one's end; the same of its edges. By *places*, see
    /// [`super::candidates::Candidates`].
    pub(super) first_sure: Vec<u32>,
    pub(super) first_edge: Vec<u32>,
    /// Planes of the flats, as in [`super::facing::Facing`], padded to whole blocks.
    pub(super) planes: [Vec<f32>; 4],
    /// Their numbers there.
    pub(super) numbers: Vec<u32>,
    /// Edges of such flats. The first [`KNOWN`] numbers are not theirs.
    pub(super) edge_flats: Vec<[u32; 2]>,
    /// Their vertices.
    pub(super) edge_vertices: Vec<[u32; 2]>,
    /// Edges of more flats than two, or of two that do not fit each other.
    pub(super) irregular: Vec<IrregularEdge>,
    /// Per bundle of loose triangles, their numbers.
    pub(super) loose: Vec<[u32; LANES]>,
}

impl Level {
    /// Whether a point is in the sphere.
    pub(super) fn covers(&self, eye: Vec3) -> bool {
        (self.sphere).is_some_and(|(centre, radius)| eye.distance(centre) <= radius)
    }

    #[cfg(test)]
    pub(super) fn sphere(&self) -> Option<(Vec3, f32)> {
        self.sphere
    }

    /// Whether it is that of the points within a sphere.
    pub(super) fn is_of(&self, sphere: (Vec3, f32)) -> bool {
        self.sphere == Some(sphere)
    }

    /// Forgets what it was.
    pub(super) fn begin(&mut self, sphere: (Vec3, f32)) {
        self.sphere = Some(sphere);
        self.sure.clear();
        self.first_sure.clear();
        self.first_edge.clear();
        self.planes.iter_mut().for_each(Vec::clear);
        self.numbers.clear();
        self.edge_flats.clear();
        self.edge_vertices.clear();
        self.irregular.clear();
        self.loose.clear();
    }

    /// What the flat that is added next is called.
    pub(super) fn next_flat(&self) -> u32 {
        KNOWN + self.numbers.len() as u32
    }

    /// `number` is that in [`super::facing::Facing`].
    pub(super) fn add_flat(&mut self, plane: [f32; 4], number: u32) {
        for (planes, value) in self.planes.iter_mut().zip(plane) {
            planes.push(value);
        }
        self.numbers.push(number);
    }

    /// Pads the flats to whole blocks, with some that nobody sees.
    pub(super) fn finish_flats(&mut self) {
        let padded = self.numbers.len().next_multiple_of(BLOCK);
        for (planes, value) in self.planes.iter_mut().zip([0.0, 0.0, 0.0, f32::INFINITY]) {
            planes.resize(padded, value);
        }
    }

    /// Makes of `inner` what remains of this level for a smaller sphere in it. `names` is scratch memory.
    pub(super) fn narrow(
        &self,
        facing: &Facing,
        sphere: (Vec3, f32),
        positions: &[Vec3],
        names: &mut Vec<u32>,
        inner: &mut Self,
    ) {
        inner.begin(sphere);
        simd::arch().dispatch(Narrow {
            outer: self,
            centre: sphere.0,
            reach: facing.reach(sphere),
            names,
            positions,
            inner,
        });
        let named = |flat: u32| names[flat as usize];
        inner.irregular.extend(self.irregular.iter().map(|edge| {
            let mut edge = edge.clone();
            for (flat, _) in &mut edge.flats {
                *flat = named(*flat);
            }
            edge
        }));
        let loose = self.loose.iter().map(|triangles| triangles.map(named));
        inner.loose.extend(loose);
    }
}

/// The vectorised body of [`Level::narrow`].
struct Narrow<'a> {
    outer: &'a Level,
    centre: Vec3,
    /// How far from it a plane may be that passes through the sphere.
    reach: f32,
    /// What the outer level's flats are called in the inner one.
    names: &'a mut Vec<u32>,
    positions: &'a [Vec3],
    inner: &'a mut Level,
}

impl WithSimd for Narrow<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let Self {
            outer,
            centre,
            reach,
            names,
            positions,
            inner,
        } = self;
        names.clear();
        names.extend([BACK, FRONT, ABSENT]);
        let padded = outer.planes[0].len();
        names.resize(KNOWN as usize + padded, BACK);
        let (blocks, _) = names[KNOWN as usize..].as_chunks_mut::<BLOCK>();
        for (block, (names, numbers)) in blocks
            .iter_mut()
            .zip(outer.numbers.chunks(BLOCK))
            .enumerate()
        {
            let planes = outer.planes.each_ref().map(|plane| block_of(plane, block));
            let [front, either] = sides_of(planes, centre, reach);
            // Without a branch, which would often be guessed wrong.
            let (mut open, mut count) = ([0; BLOCK], 0);
            for index in 0..numbers.len().min(BLOCK) {
                names[index] = u32::from(front[index]);
                open[count % BLOCK] = index as u8;
                count += usize::from(either[index]);
            }
            let open = &open[..count.min(BLOCK)];
            for (name, index) in (inner.next_flat()..).zip(open) {
                names[usize::from(*index) % BLOCK] = name;
            }
            for (all, plane) in inner.planes.iter_mut().zip(planes) {
                all.extend(open.iter().map(|index| plane[usize::from(*index) % BLOCK]));
            }
            let numbers = open.iter().map(|index| numbers[usize::from(*index)]);
            inner.numbers.extend(numbers);
        }
        inner.finish_flats();
        keep_edges(outer, names, positions, inner);
    }
}

/// Sorts the edges of a level into those that remain open and those that every point of the inner one sees as a contour.
#[inline(always)]
fn keep_edges(outer: &Level, names: &[u32], positions: &[Vec3], inner: &mut Level) {
    for range in outer.first_edge.windows(2) {
        inner.first_sure.push(inner.sure.len() as u32);
        inner.first_edge.push(inner.edge_flats.len() as u32);
        let range = range[0] as usize..range[1] as usize;
        let flats = &outer.edge_flats[range.clone()];
        let vertices = &outer.edge_vertices[range];
        let named = |flats: [u32; 2]| flats.map(|flat| names[flat as usize]);
        let differ = |flats: [u32; 2]| {
            let [a, b] = named(flats);
            a != b
        };
        let mut sure = Filling::new(&mut inner.sure);
        for_each_where(flats, vertices, differ, |flats, vertices| {
            let flats = named(flats);
            if flats.iter().any(|flat| *flat >= KNOWN) {
                inner.edge_flats.push(flats);
                inner.edge_vertices.push(vertices);
                return;
            }
            let [a, b] = flats.map(|flat| i32::from(FACES_OF_KNOWN[flat as usize]));
            sure.append(ends(positions, vertices), a - b);
        });
        sure.finish();
    }
    inner.first_sure.push(inner.sure.len() as u32);
    inner.first_edge.push(inner.edge_flats.len() as u32);
}
