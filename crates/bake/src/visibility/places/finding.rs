//! Places of a surface, and which of them rays tell to lie elsewhere.

use glam::Vec3;
use rayon::prelude::*;

use super::super::ray::RayCaster;
use super::emerging::{Emerging, Exposure, ROOM};
use super::{Places, umbrellas, weld};

/// Places that are told by the surface that they are on; which of them lie on or behind another one, rays tell where
/// that is asked for.
pub(crate) struct Finding<'a> {
    pub(crate) places: Places,
    positions: &'a [Vec3],
    triangles: &'a [[u32; 3]],
    caster: &'a RayCaster,
    offset: f32,
    exposure_resolution: u32,
    /// Of the triangles, as long as twice their area.
    normals: Vec<Vec3>,
    /// The corners of places, before any was divided.
    members: Members,
}

impl<'a> Finding<'a> {
    /// As for [`Places::new`].
    pub(crate) fn new(
        positions: &'a [Vec3],
        triangles: &'a [[u32; 3]],
        caster: &'a RayCaster,
        offset: f32,
        exposure_resolution: u32,
    ) -> Self {
        let welded = weld(positions, triangles);
        let (count, of) = umbrellas(positions, triangles, &welded);
        let normals: Vec<Vec3> = (triangles.par_iter())
            .map(|triangle| {
                let [a, b, c] = triangle.map(|vertex| positions[vertex as usize]);
                (b - a).cross(c - a)
            })
            .collect();
        let mut found = Self {
            members: Members::new(&of, count),
            places: Places {
                origins: Vec::new(),
                corners: of.as_chunks::<3>().0.to_vec(),
                moved_corners: 0,
            },
            positions,
            triangles,
            caster,
            offset,
            exposure_resolution,
            normals,
        };
        found.places.origins = (0..count as u32)
            .into_par_iter()
            .map(|place| found.beside(place, |_| true).0)
            .collect();
        found
    }

    /// The places, without what it takes to find more.
    pub(crate) fn into_places(self) -> Places {
        self.places
    }

    fn corner(&self, index: u32) -> Vec3 {
        let triangle = self.triangles[index as usize / 3];
        self.positions[triangle[index as usize % 3] as usize]
    }

    fn emerging(&self, triangle: usize) -> Emerging<'_> {
        Emerging {
            caster: self.caster,
            offset: self.offset,
            corners: [0, 1, 2].map(|k| self.corner(3 * triangle as u32 + k)),
            normal: self.normals[triangle].normalize_or_zero(),
        }
    }

    /// The position of a place's corners.
    fn start(&self, place: u32) -> Vec3 {
        let last = self.members.of(place).last();
        last.map_or(Vec3::ZERO, |&corner| self.corner(corner))
    }

    /// Where a place is by the triangles of some of its corners, and the sum of their normals.
    fn beside(&self, place: u32, counts: impl Fn(u32) -> bool) -> (Vec3, Vec3) {
        let corners = self.members.of(place);
        let counted = corners.iter().filter(|&&corner| counts(corner));
        let sum = counted.fold(Vec3::ZERO, |sum, &corner| {
            sum + self.normals[corner as usize / 3]
        });
        let offset = self.offset * sum.normalize_or_zero();
        (self.start(place) + offset, sum)
    }

    /// Finds where the triangles about places that are `asked` for emerge from others, and samples those there. With
    /// `divide`, corners of a place that emerge apart from each other become places of their own.
    pub(crate) fn emerge(&mut self, asked: impl Fn(u32) -> bool + Sync, divide: bool) {
        let exposure = || Exposure::new(self.exposure_resolution);
        // Of corners that another call divided the number is that of no place asked for.
        let of = |corner: usize| self.places.corners[corner / 3][corner % 3];
        let mut ends: Vec<[Option<Vec3>; 3]> = (0..self.triangles.len())
            .into_par_iter()
            .map_init(exposure, |exposure, triangle| {
                let asked = [0, 1, 2].map(|k| asked(of(3 * triangle + k)));
                if asked == [false; 3] {
                    return [None; 3];
                }
                let around = |k: usize| {
                    let members = self.members.of(of(3 * triangle + k)).iter();
                    members.map(|&member| self.normals[member as usize / 3])
                };
                let ends = self.emerging(triangle).ends(around, exposure);
                [0, 1, 2].map(|k| ends[k].filter(|_| asked[k]))
            })
            .collect();
        let ended = |ends: &[[Option<Vec3>; 3]], corner: u32| {
            ends[corner as usize / 3][corner as usize % 3]
        };
        // Where nothing is seen from, though no crossing tells so, the triangles may see something all the same. Of places in
        // rooms more directions tell how much they see: what is twice that, or more, tells of a triangle.
        let exposures = || (exposure(), Exposure::new(2 * self.exposure_resolution));
        let (origins, dark): (Vec<Vec3>, Vec<Option<usize>>) = (0..self.members.count())
            .into_par_iter()
            .map_init(exposures, |(exposure, fine), place| {
                if !asked(place) {
                    return (self.places.origins[place as usize], None);
                }
                let (origin, sum) = self.beside(place, |corner| ended(&ends, corner).is_none());
                if sum == Vec3::ZERO || exposure.sees(self.caster, origin, sum) {
                    return (origin, None);
                }
                let near = ROOM * self.offset;
                let in_a_room = exposure.is_in_a_room(self.caster, origin, sum, near);
                let mut open = || fine.count_open(self.caster, (origin, sum), 0);
                (origin, Some(if in_a_room { open() } else { 0 }))
            })
            .unzip();
        let elsewhere =
            |(exposure, fine): &mut (Exposure, Exposure),
             (triangle, ends): (usize, &mut [Option<Vec3>; 3])| {
                let dark = [0, 1, 2].map(|k| {
                    let open = dark.get(of(3 * triangle + k) as usize).copied().flatten();
                    open.filter(|_| ends[k].is_none())
                });
                let normal = self.normals[triangle];
                if normal == Vec3::ZERO || dark == [None; 3] {
                    return;
                }
                let from = self.emerging(triangle).seen_from(exposure);
                for (k, open) in dark.into_iter().enumerate() {
                    let (Some(open), Some(from)) = (open, from[k]) else {
                        continue;
                    };
                    let most = 2 * open;
                    if open == 0 || fine.count_open(self.caster, (from, normal), most) > most {
                        ends[k] = Some(from);
                    }
                }
            };
        (ends.par_iter_mut().enumerate()).for_each_init(exposures, elsewhere);
        let divided = self.places.origins.split_off(origins.len());
        self.places.origins = [origins, divided].concat();
        for place in 0..self.members.count() {
            self.move_corners(place, divide, |corner| ended(&ends, corner));
        }
        self.places.moved_corners += ends.as_flattened().iter().flatten().count();
    }

    /// Samples corners of a place where they end.
    fn move_corners(&mut self, place: u32, divide: bool, end: impl Fn(u32) -> Option<Vec3>) {
        let corners = self.members.of(place);
        let mut moved: Vec<(Vec3, u32)> = (corners.iter())
            .filter_map(|&corner| Some((end(corner)?, corner)))
            .collect();
        // What emerges nearest to the corner stands for all that it sees.
        let start = self.start(place);
        moved.sort_by(|(a, first), (b, second)| {
            let distance = |end: &Vec3| end.distance_squared(start);
            distance(a).total_cmp(&distance(b)).then(first.cmp(second))
        });
        let mut room = moved.len() == corners.len();
        let places = &mut self.places;
        if !divide {
            if let Some((end, _)) = moved.first().filter(|_| room) {
                places.origins[place as usize] = *end;
            }
            return;
        }
        let mut groups: Vec<(Vec3, u32)> = Vec::new();
        for (end, corner) in moved {
            let of = &mut places.corners[corner as usize / 3][corner as usize % 3];
            let seen = |from: Vec3| !self.caster.blocked(from, end);
            if let Some(&(_, place)) = groups.iter().find(|(from, _)| seen(*from)) {
                *of = place;
                continue;
            }
            // A place that none is left at is used again.
            let first = if std::mem::take(&mut room) {
                places.origins[place as usize] = end;
                place
            } else {
                places.origins.push(end);
                places.origins.len() as u32 - 1
            };
            groups.push((end, first));
            *of = first;
        }
    }
}

/// The corners of every place.
struct Members {
    first: Vec<u32>,
    corners: Vec<u32>,
}

impl Members {
    fn new(of: &[u32], places: usize) -> Self {
        let mut first = vec![0; places + 1];
        for &place in of {
            first[place as usize + 1] += 1;
        }
        for place in 0..places {
            first[place + 1] += first[place];
        }
        let mut next = first.clone();
        let mut corners = vec![0; of.len()];
        for (corner, &place) in of.iter().enumerate() {
            corners[next[place as usize] as usize] = corner as u32;
            next[place as usize] += 1;
        }
        Self { first, corners }
    }

    fn count(&self) -> u32 {
        self.first.len() as u32 - 1
    }

    fn of(&self, place: u32) -> &[u32] {
        let [from, to] = [0, 1].map(|k| self.first[place as usize + k] as usize);
        &self.corners[from..to]
    }
}
