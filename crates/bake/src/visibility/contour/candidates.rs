//! What the points of a small group may see as contours.
//!
//! Seen from points close together, most contours are the same: the triangles at them face
//! all of the points or none. Those are found once per group. What remains to be done for
//! every point are the few triangles whose planes pass through the group.

use glam::Vec3;
use pulp::{Simd, WithSimd};

use crate::simd;

use super::Contour;
use super::batch::{Batch, LANES};
use super::facing::{BLOCK, Edges, Facing, IrregularEdge, Sides, block_of};

/// Numbers below this stand for triangles that face no point of the group, or every point.
const KNOWN: usize = 2;

/// Contours of the points within a sphere.
pub(super) struct Candidates {
    centre: Vec3,
    radius: f32,
    /// Contours that every point sees.
    pub(super) sure: Vec<Contour>,
    /// The same, with the coordinates of their vertices.
    sure_batches: Vec<Batch<3>>,
    /// Triangles that may face some points and others not, as in [`Facing`].
    planes: [Vec<f32>; 4],
    precise: Vec<[f64; 4]>,
    corners: Vec<[u32; 3]>,
    /// Edges of such triangles. The first [`KNOWN`] numbers are not theirs.
    pub(super) edges: Edges<u32>,
    pub(super) irregular: Vec<IrregularEdge>,
    /// Per number, whether the triangle faces the point looked at last, 1 or 0.
    faces: Vec<u8>,
    /// Triangles whose planes that point lies in, but for rounding.
    in_plane: Vec<u32>,
    /// Contours that this point sees besides.
    found: Vec<Contour>,
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
            planes: [const { Vec::new() }; 4],
            precise: Vec::new(),
            corners: Vec::new(),
            edges: Edges::new(),
            irregular: Vec::new(),
            faces: Vec::new(),
            in_plane: Vec::new(),
            found: Vec::new(),
            found_batches: Vec::new(),
            sides: Sides::default(),
        }
    }
}

impl Candidates {
    /// Looks for the contours of all points in the bounds of `origins`.
    pub(super) fn prepare(&mut self, facing: &Facing, positions: &[Vec3], origins: &[Vec3]) {
        let (low, high) = origins.iter().fold(
            (Vec3::INFINITY, Vec3::NEG_INFINITY),
            |(low, high), &origin| (low.min(origin), high.max(origin)),
        );
        self.centre = low.midpoint(high);
        let distances = origins.iter().map(|origin| origin.distance(self.centre));
        self.radius = distances.fold(0.0, f32::max);
        let mut sides = std::mem::take(&mut self.sides);
        facing.find_candidates(self.centre, self.radius, &mut sides, self);
        self.sides = sides;
        gather(&self.sure, positions, &mut self.sure_batches);
    }

    /// Whether these are the contours of `eye` among others.
    pub(super) fn covers(&self, eye: Vec3) -> bool {
        eye.distance(self.centre) <= self.radius
    }

    pub(super) fn clear(&mut self) {
        self.sure.clear();
        self.planes.iter_mut().for_each(Vec::clear);
        self.precise.clear();
        self.corners.clear();
        self.edges.triangles.clear();
        self.edges.vertices.clear();
        self.irregular.clear();
    }

    /// The triangle's number.
    pub(super) fn add_triangle(
        &mut self,
        plane: [f32; 4],
        precise: [f64; 4],
        corners: [u32; 3],
    ) -> u32 {
        for (planes, value) in self.planes.iter_mut().zip(plane) {
            planes.push(value);
        }
        self.precise.push(precise);
        self.corners.push(corners);
        (KNOWN + self.corners.len() - 1) as u32
    }

    /// Pads the triangles to whole blocks, with some that nobody sees.
    pub(super) fn finish_triangles(&mut self) {
        let padded = self.corners.len().next_multiple_of(BLOCK);
        let [x, y, z, d] = &mut self.planes;
        for normal in [x, y, z] {
            normal.resize(padded, 0.0);
        }
        d.resize(padded, f32::INFINITY);
        self.faces.resize(KNOWN + padded, 0);
        self.faces[1] = 1;
    }

    /// Finds what `eye` sees. Returns whether it lies on a triangle, but for rounding: what a
    /// ray from there meets is a matter of its arithmetic.
    pub(super) fn look(&mut self, facing: &Facing, positions: &[Vec3], eye: Vec3) -> bool {
        self.in_plane.clear();
        self.found.clear();
        simd::arch().dispatch(Look {
            candidates: self,
            rounding: facing.rounding_at(eye),
            eye,
        });
        let face = |triangle: u32| self.faces[triangle as usize];
        let irregular = self.irregular.iter();
        self.found
            .extend(irregular.filter_map(|edge| edge.contour(face)));
        gather(&self.found, positions, &mut self.found_batches);
        self.touches(positions, eye, 4.0 * facing.rounding_at(eye))
    }

    /// The contours of the point looked at last.
    pub(super) fn contours(&self) -> impl Iterator<Item = &Batch<3>> {
        self.sure_batches.iter().chain(&self.found_batches)
    }

    fn touches(&self, positions: &[Vec3], eye: Vec3, margin: f32) -> bool {
        self.in_plane.iter().any(|&index| {
            let corners = self.corners[index as usize].map(|v| positions[v as usize].as_dvec3());
            let [a, b, c] = corners;
            let normal = (b - a).cross(c - a).normalize_or_zero();
            [(a, b), (b, c), (c, a)].into_iter().all(|(from, to)| {
                let inward = normal.cross(to - from).normalize_or_zero();
                inward.dot(eye.as_dvec3() - from) >= -f64::from(margin)
            })
        })
    }

    #[inline(always)]
    fn find_faces(&mut self, block: usize, eye: Vec3, rounding: f32) {
        let first = block * BLOCK;
        let [x, y, z, d] = self.planes.each_ref().map(|plane| block_of(plane, block));
        let faces = &mut self.faces[KNOWN + first..][..BLOCK];
        let mut unclear = false;
        for i in 0..BLOCK {
            let height = x[i] * eye.x + y[i] * eye.y + z[i] * eye.z - d[i];
            faces[i] = u8::from(height > 0.0);
            unclear |= height.abs() < rounding;
        }
        if unclear {
            let eye = eye.as_dvec3();
            let planes = &self.precise[first..];
            for ((face, [x, y, z, d]), index) in faces.iter_mut().zip(planes).zip(first..) {
                let height = x * eye.x + y * eye.y + z * eye.z - d;
                *face = u8::from(height > 0.0);
                if height.abs() <= f64::from(rounding) * (x * x + y * y + z * z).sqrt() {
                    self.in_plane.push(index as u32);
                }
            }
        }
    }
}

fn gather(contours: &[Contour], positions: &[Vec3], batches: &mut Vec<Batch<3>>) {
    batches.clear();
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
    eye: Vec3,
    rounding: f32,
}

impl WithSimd for Look<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let Self {
            candidates,
            eye,
            rounding,
        } = self;
        for block in 0..candidates.planes[0].len() / BLOCK {
            candidates.find_faces(block, eye, rounding);
        }
        let faces = &candidates.faces;
        let face = |triangle: u32| faces[triangle as usize];
        candidates.edges.find(face, &mut candidates.found);
    }
}
