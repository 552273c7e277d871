//! Which way the flats that a group of points may see from either side face one of these points.
//!
//! Where a point lies so close to a flat's plane that its triangles may not face it alike, each of them is looked at.

use glam::{DVec3, Vec3};
use pulp::{Simd, WithSimd};

use crate::simd;
use crate::visibility::{ones, pack_bits};

use super::Contour;
use super::candidates::{FACES_OF_KNOWN, KNOWN};
use super::edges::outline;
use super::facing::{BLOCK, Facing, block_of};
use super::level::Level;

/// The face of flats whose triangles do not face the point alike: each has its own.
const PARTED: i8 = 2;

/// Faces of a level's flats.
#[derive(Default)]
pub(super) struct Faces {
    /// Per number, 1 if the flat faces the point, −1 if not, 0 if it does not count; or [`PARTED`].
    of_flats: Vec<i8>,
    /// Triangles of flats that were looked at one by one, flat after flat.
    members: Vec<Member>,
    /// Those that the point lies on.
    touched: Vec<Member>,
    /// All those of flats that are parted.
    parted: Vec<Member>,
    /// Contours between triangles of one flat.
    within: Vec<Contour>,
}

/// A triangle of a flat.
#[derive(Clone, Copy)]
pub(super) struct Member {
    /// The flat's number.
    pub(super) flat: u32,
    pub(super) corners: [u32; 3],
    /// 1 if it faces the point, −1 if not.
    pub(super) face: i8,
    /// The same, but 0 if the point lies on it.
    counted: i8,
    /// Whether the point lies in its plane, but for rounding.
    in_plane: bool,
}

impl Faces {
    /// Looks at all flats of a level from `eye`. Triangles that it lies on, but for rounding, do not count.
    pub(super) fn look(&mut self, level: &Level, facing: &Facing, positions: &[Vec3], eye: Vec3) {
        let rounding = facing.rounding_at(eye);
        self.of_flats
            .resize(KNOWN as usize + level.planes[0].len(), 0);
        self.of_flats[..KNOWN as usize].copy_from_slice(&FACES_OF_KNOWN);
        self.members.clear();
        simd::arch().dispatch(Look {
            level,
            faces: &mut self.of_flats[KNOWN as usize..],
            members: &mut self.members,
            facing,
            unclear: rounding + facing.widest_at(eye),
            away: facing.away(eye),
            rounding,
            rounding_of_axes: facing.rounding_of_axes(eye),
            eye,
        });
        self.touched.clear();
        self.parted.clear();
        self.within.clear();
        for members in self.members.chunk_by_mut(|a, b| a.flat == b.flat) {
            for member in members.iter_mut() {
                let corners = (member.corners).map(|vertex| positions[vertex as usize].as_dvec3());
                if member.in_plane && touches(corners, eye, 4.0 * rounding) {
                    member.counted = 0;
                    self.touched.push(*member);
                }
            }
            let Member { flat, counted, .. } = members[0];
            let alike = members.iter().all(|member| member.counted == counted);
            self.of_flats[flat as usize] = if alike { counted } else { PARTED };
            if !alike {
                self.parted.extend_from_slice(members);
                add_within(members, &mut self.within);
            }
        }
    }

    /// That of a flat that is not parted.
    #[inline(always)]
    pub(super) fn of(&self, flat: u32) -> i8 {
        self.of_flats[flat as usize]
    }

    /// That of the flat's triangle that has an edge between such vertices.
    #[inline(always)]
    pub(super) fn at(&self, flat: u32, edge: impl FnOnce() -> [u32; 2]) -> i8 {
        match self.of(flat) {
            PARTED => self.of_part(flat, edge()),
            face => face,
        }
    }

    #[cold]
    fn of_part(&self, flat: u32, edge: [u32; 2]) -> i8 {
        member_at(&self.parted, flat, edge).map_or(0, |member| member.counted)
    }

    /// Whether an edge of two flats may be a contour.
    #[inline(always)]
    pub(super) fn may_differ(&self, [a, b]: [u32; 2]) -> bool {
        let a = self.of(a);
        u8::from(a != self.of(b)) | u8::from(a == PARTED) == 1
    }

    /// Triangles that the point lies on.
    pub(super) fn touched(&self) -> &[Member] {
        &self.touched
    }

    /// Which way such a triangle faces the point, if the flat has one with this edge.
    pub(super) fn of_touched(&self, flat: u32, edge: [u32; 2]) -> Option<i8> {
        member_at(&self.touched, flat, edge).map(|member| member.face)
    }

    /// Contours between triangles of one flat.
    pub(super) fn within(&self) -> &[Contour] {
        &self.within
    }

    /// Whether triangles of some flat do not face the point alike.
    #[cfg(test)]
    pub(super) fn are_parted(&self) -> bool {
        !self.parted.is_empty()
    }
}

fn member_at(members: &[Member], flat: u32, edge: [u32; 2]) -> Option<&Member> {
    let mut members = members.iter().filter(|member| member.flat == flat);
    members.find(|member| edge.iter().all(|end| member.corners.contains(end)))
}

/// Adds the contours between triangles of a flat.
fn add_within(members: &[Member], contours: &mut Vec<Contour>) {
    let sides = members.iter().flat_map(|member| {
        let face = i32::from(member.counted);
        outline(member.corners)
            .map(|[a, b]| ([a.min(b), a.max(b)], if a < b { face } else { -face }))
    });
    let mut sides: Vec<([u32; 2], i32)> = sides.collect();
    sides.sort_unstable();
    for pair in sides.chunk_by(|a, b| a.0 == b.0) {
        // Of edges that one of them has, flats that are neighbours tell.
        if let [(vertices, along), (_, against)] = *pair
            && along + against != 0
        {
            let step = along + against;
            contours.push(Contour { vertices, step });
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

/// The vectorised body of [`Faces::look`].
struct Look<'a> {
    level: &'a Level,
    /// Of the level's flats.
    faces: &'a mut [i8],
    members: &'a mut Vec<Member>,
    facing: &'a Facing,
    eye: Vec3,
    /// How high above any flat's plane the point has to be for all of its triangles to face it alike.
    unclear: f32,
    /// See [`Facing::away`].
    away: f32,
    /// Of heights above planes of triangles.
    rounding: f32,
    rounding_of_axes: DVec3,
}

impl WithSimd for Look<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(mut self, _: S) {
        for block in 0..self.faces.len() / BLOCK {
            self.find_faces(block);
        }
    }
}

impl Look<'_> {
    #[inline(always)]
    fn find_faces(&mut self, block: usize) {
        let first = block * BLOCK;
        let [x, y, z, d] = (self.level.planes.each_ref()).map(|plane| block_of(plane, block));
        let faces = &mut self.faces[first..][..BLOCK];
        let eye = self.eye;
        let height = |i: usize| x[i] * eye.x + y[i] * eye.y + z[i] * eye.z - d[i];
        let mut unclear = [0; BLOCK];
        for i in 0..BLOCK {
            let height = height(i);
            faces[i] = face(height > 0.0);
            unclear[i] = u8::from(height.abs() < self.unclear);
        }
        for i in ones(pack_bits(&unclear)) {
            let flat = first + i;
            let spread = self.facing.spread(self.level.numbers[flat]).at(self.away);
            if height(i).abs() < self.rounding + spread {
                self.look_closely(flat);
            }
        }
    }

    /// Looks at the triangles of a flat.
    fn look_closely(&mut self, flat: usize) {
        let eye = self.eye.as_dvec3();
        let begin = self.members.len();
        for triangle in self.facing.triangles_of(self.level.numbers[flat]) {
            let [x, y, z, d] = self.facing.precise(triangle);
            let height = x * eye.x + y * eye.y + z * eye.z - d;
            let face = face(height > 0.0);
            let normal = DVec3::new(x, y, z);
            let rounding = f64::from(self.rounding) * normal.length();
            self.members.push(Member {
                flat: KNOWN + flat as u32,
                corners: self.facing.corners(triangle),
                face,
                counted: face,
                in_plane: height.abs() <= rounding.min(normal.abs().dot(self.rounding_of_axes)),
            });
        }
        let members = &self.members[begin..];
        let face = members[0].face;
        self.faces[flat] = face;
        if (members.iter()).all(|member| member.face == face && !member.in_plane) {
            self.members.truncate(begin);
        }
    }
}

fn face(front: bool) -> i8 {
    2 * i8::from(front) - 1
}
