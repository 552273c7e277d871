//! Where a surface's visibility is sampled: one place per position and side.
//!
//! Visibility depends on where a point is, not on its normal, so triangles that meet at a
//! position share one sample as long as they lie around the same air. Which do is told edge by
//! edge, in the order in which faces follow each other around the edge: the front of one looks
//! at the next. So both sides of a sheet stay apart even where they share their vertices, and
//! so do solids that touch.
//!
//! Where other surfaces cross or touch a triangle, its corners may lie in them or behind them.
//! Such a corner is sampled where the part of the triangle ends that people see: a ray from its
//! centre towards the corner tells where. Corners that no crossing tells of but nothing is seen
//! from, as in cracks, are sampled near by on the triangle or at its centre, if that sees something.

use relight_format::math;
use std::collections::HashMap;

use glam::{DVec3, Vec3};
use rayon::prelude::*;

mod emerging;
mod finding;

use super::ray::RayCaster;
pub(crate) use emerging::Exposure;
pub(crate) use finding::Finding;

/// Rays per side of an octahedral map of all directions that tell whether a place sees anything, usually.
pub const EXPOSURE_RESOLUTION: u32 = 8;
/// Triangles whose fronts enclose more than this, radians, are two sides of a thin thing.
const THIN: f64 = 330.0 / 180.0 * std::f64::consts::PI;
/// Directions from an edge that differ by less, radians, are the same.
const SAME_ANGLE: f64 = 1e-5;
/// Cosine between normals above which two triangles around an edge need no closer look.
const FOLDED: f64 = -0.8;

/// Places of a mesh.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Places {
    /// Where visibility is sampled.
    pub origins: Vec<Vec3>,
    /// The place of every corner of every triangle.
    pub corners: Vec<[u32; 3]>,
    /// Corners that are sampled elsewhere since they lie on or behind other surfaces, or see nothing.
    pub(crate) moved_corners: usize,
}

impl Places {
    /// Each place is a position moved by `offset`, in metres, along the area-weighted mean
    /// normal of its triangles, or where a triangle emerges from another one. `caster` casts
    /// at the same surface, however it is divided; `exposure_resolution`² rays over all directions tell whether a place
    /// sees anything. Triangles without area stay where they are.
    pub fn new(
        positions: &[Vec3],
        triangles: &[[u32; 3]],
        caster: &RayCaster,
        offset: f32,
        exposure_resolution: u32,
    ) -> Self {
        let mut found = Finding::new(positions, triangles, caster, offset, exposure_resolution);
        found.emerge(|_| true, true);
        found.into_places()
    }
}

/// The side of every corner of every triangle: corners at one position have the same number if
/// their triangles lie around the same air.
pub(crate) fn sides(positions: &[Vec3], triangles: &[[u32; 3]]) -> Vec<[u32; 3]> {
    let welded = weld(positions, triangles);
    let (_, sides) = umbrellas(positions, triangles, &welded);
    sides.as_chunks::<3>().0.to_vec()
}

/// A mesh whose vertices are each at one place.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Divided {
    /// Corners of triangles; vertices from the former number on are copies.
    pub triangles: Vec<[u32; 3]>,
    /// What each copy is a copy of.
    pub copied: Vec<u32>,
    /// The place of every vertex; [`u32::MAX`] for those that no triangle uses.
    pub places: Vec<u32>,
}

impl Divided {
    /// Copies vertices that triangles use at several places, or on several sides.
    pub(crate) fn new(triangles: &[[u32; 3]], vertices: usize, corners: &[[u32; 3]]) -> Self {
        let mut divided = Self {
            triangles: triangles.to_vec(),
            copied: Vec::new(),
            places: vec![u32::MAX; vertices],
        };
        let mut copies: HashMap<[u32; 2], u32> = HashMap::new();
        for (triangle, places) in divided.triangles.iter_mut().zip(corners) {
            for (vertex, &place) in triangle.iter_mut().zip(places) {
                let first = &mut divided.places[*vertex as usize];
                if *first == u32::MAX {
                    *first = place;
                }
                if *first != place {
                    let number = (vertices + divided.copied.len()) as u32;
                    let copy = *copies.entry([*vertex, place]).or_insert(number);
                    if copy == number {
                        divided.copied.push(*vertex);
                        divided.places.push(place);
                    }
                    *vertex = copy;
                }
            }
        }
        divided
    }
}

/// A number for every vertex, the same for the same position.
fn weld(positions: &[Vec3], triangles: &[[u32; 3]]) -> Vec<u32> {
    let mut numbers = HashMap::with_capacity(positions.len());
    let mut welded = vec![u32::MAX; positions.len()];
    for &vertex in triangles.as_flattened() {
        // Adding zero turns −0 into +0.
        let key = (positions[vertex as usize] + Vec3::ZERO)
            .to_array()
            .map(f32::to_bits);
        let next = numbers.len() as u32;
        welded[vertex as usize] = *numbers.entry(key).or_insert(next);
    }
    welded
}

/// A triangle at an edge.
#[derive(Clone, Copy)]
struct Side {
    /// The welded ends of the edge, the lesser first.
    edge: [u32; 2],
    /// Number of the corner at which the edge begins, as the triangle winds.
    corner: u32,
    /// Whether the triangle winds from the lesser end to the other.
    ascends: bool,
}

/// Divides the corners at every position by the air in front of their triangles. Returns how
/// many groups there are and that of every corner, numbered as they come up.
fn umbrellas(positions: &[Vec3], triangles: &[[u32; 3]], welded: &[u32]) -> (usize, Vec<u32>) {
    let mut sides: Vec<Side> = (0..3 * triangles.len())
        .filter_map(|corner| {
            let triangle = triangles[corner / 3];
            let [a, b] = [0, 1].map(|k| welded[triangle[(corner + k) % 3] as usize]);
            (a != b).then_some(Side {
                edge: [a.min(b), a.max(b)],
                corner: corner as u32,
                ascends: a < b,
            })
        })
        .collect();
    sides.par_sort_unstable_by_key(|side| (side.edge, side.corner));
    let mut groups = Groups::new(3 * triangles.len());
    for sides in sides.chunk_by(|a, b| a.edge == b.edge) {
        connect(sides, positions, triangles, &mut groups);
    }
    groups.numbered()
}

/// Connects the triangles around an edge whose fronts face each other.
fn connect(sides: &[Side], positions: &[Vec3], triangles: &[[u32; 3]], groups: &mut Groups) {
    let at = |corner: u32, k: u32| {
        let (triangle, corner) = (corner / 3, (corner + k) % 3);
        positions[triangles[triangle as usize][corner as usize] as usize].as_dvec3()
    };
    let mut join = |a: &Side, b: &Side| {
        let ends = |side: &Side| {
            let next = side.corner / 3 * 3 + (side.corner + 1) % 3;
            if side.ascends {
                [side.corner, next]
            } else {
                [next, side.corner]
            }
        };
        for (a, b) in ends(a).into_iter().zip(ends(b)) {
            groups.join(a, b);
        }
    };
    let normal = |side: &Side| {
        let [a, b, c] = [0, 1, 2].map(|k| at(side.corner, k));
        (b - a).cross(c - a).normalize_or_zero()
    };
    if let [a, b] = sides
        && a.ascends != b.ascends
        && normal(a).dot(normal(b)) > FOLDED
    {
        join(a, b);
        return;
    }
    let [low, high] = {
        let side = &sides[0];
        let ends = [at(side.corner, 0), at(side.corner, 1)];
        if side.ascends {
            ends
        } else {
            [ends[1], ends[0]]
        }
    };
    let axis = (high - low).normalize_or_zero();
    let across = |side: &Side| {
        let away = at(side.corner, 2) - low;
        (away - axis * axis.dot(away)).normalize_or_zero()
    };
    // Angles are told from the first triangle that has area.
    let Some(first) = sides.iter().map(across).find(|way| *way != DVec3::ZERO) else {
        return;
    };
    let third = axis.cross(first);
    let mut around: Vec<(f64, &Side)> = (sides.iter())
        .filter_map(|side| {
            let way = across(side);
            let angle = math::atan2(way.dot(third), way.dot(first));
            (way != DVec3::ZERO).then_some((angle, side))
        })
        .collect();
    around.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.corner.cmp(&b.1.corner)));
    let rays: Vec<&[(f64, &Side)]> = around.chunk_by(|a, b| b.0 - a.0 < SAME_ANGLE).collect();
    for (number, ray) in rays.iter().enumerate() {
        let next = rays[(number + 1) % rays.len()];
        let mut wedge = next[0].0 - ray[0].0;
        if number + 1 == rays.len() {
            wedge += std::f64::consts::TAU;
        }
        // Ascending triangles face growing angles.
        let rising = ray.iter().filter(|(_, side)| side.ascends);
        let falling = next.iter().filter(|(_, side)| !side.ascends);
        if let Some((_, from)) = rising.clone().next()
            && wedge < THIN
        {
            falling.clone().for_each(|(_, side)| join(from, side));
        }
        // The same triangle twice.
        for same in [rising.collect::<Vec<_>>(), falling.collect()] {
            for pair in same.windows(2) {
                join(pair[0].1, pair[1].1);
            }
        }
    }
}

/// Disjoint sets of corners, or of what else has numbers.
pub(super) struct Groups {
    parents: Vec<u32>,
}

impl Groups {
    pub(super) fn new(corners: usize) -> Self {
        Self {
            parents: (0..corners as u32).collect(),
        }
    }

    fn root(&mut self, mut corner: u32) -> u32 {
        while self.parents[corner as usize] != corner {
            let parent = self.parents[corner as usize];
            self.parents[corner as usize] = self.parents[parent as usize];
            corner = parent;
        }
        corner
    }

    pub(super) fn join(&mut self, a: u32, b: u32) {
        let (a, b) = (self.root(a), self.root(b));
        // The least is the root: what comes out does not depend on the order of joins.
        self.parents[a.max(b) as usize] = a.min(b);
    }

    /// How many sets there are, and that of every corner, numbered as they come up.
    pub(super) fn numbered(mut self) -> (usize, Vec<u32>) {
        let mut count = 0;
        let mut numbers = vec![0; self.parents.len()];
        for corner in 0..self.parents.len() as u32 {
            let root = self.root(corner);
            if root == corner {
                numbers[corner as usize] = count;
                count += 1;
            } else {
                numbers[corner as usize] = numbers[root as usize];
            }
        }
        (count as usize, numbers)
    }
}

#[cfg(test)]
mod tests {
    use glam::Vec3Swizzles as _;

    use super::*;

    const OFFSET: f32 = 1e-3;

    fn places(positions: &[[f32; 3]], triangles: &[[u32; 3]]) -> Places {
        let positions: Vec<Vec3> = positions.iter().copied().map(Vec3::from).collect();
        let corners = triangles.iter();
        let soup: Vec<_> = corners
            .map(|triangle| triangle.map(|vertex| positions[vertex as usize]))
            .collect();
        Places::new(
            &positions,
            triangles,
            &RayCaster::new(&soup),
            OFFSET,
            EXPOSURE_RESOLUTION,
        )
    }

    /// Squares of two triangles each, which share no vertices.
    fn squares(corners: &[[[f32; 3]; 4]]) -> (Vec<[f32; 3]>, Vec<[u32; 3]>) {
        let triangles = (0..corners.len() as u32).map(|i| 4 * i);
        let triangles = triangles.flat_map(|i| [[i, i + 1, i + 2], [i, i + 2, i + 3]]);
        (corners.as_flattened().to_vec(), triangles.collect())
    }

    /// A box with faces outwards.
    fn cuboid([a, b, c]: [f32; 3], [d, e, f]: [f32; 3]) -> [[[f32; 3]; 4]; 6] {
        [
            [[a, b, c], [d, b, c], [d, b, f], [a, b, f]],
            [[a, e, c], [a, e, f], [d, e, f], [d, e, c]],
            [[a, b, f], [d, b, f], [d, e, f], [a, e, f]],
            [[d, b, c], [a, b, c], [a, e, c], [d, e, c]],
            [[a, b, c], [a, b, f], [a, e, f], [a, e, c]],
            [[d, b, f], [d, b, c], [d, e, c], [d, e, f]],
        ]
    }

    const FLOOR: [[f32; 3]; 4] = [
        [-4.0, 0.0, -4.0],
        [-4.0, 0.0, 4.0],
        [4.0, 0.0, 4.0],
        [4.0, 0.0, -4.0],
    ];

    #[test]
    fn corners_of_a_solid_share_a_place_outside_of_it() {
        let (positions, triangles) = squares(&cuboid([-1.0; 3], [1.0; 3]));
        let places = places(&positions, &triangles);
        assert_eq!(places.origins.len(), 8);
        assert_eq!(places.moved_corners, 0);
        for (triangle, corners) in triangles.iter().zip(&places.corners) {
            for (vertex, place) in triangle.iter().zip(corners) {
                let position = Vec3::from(positions[*vertex as usize]);
                let moved = places.origins[*place as usize] - position;
                assert!((moved.length() - OFFSET).abs() < 1e-6);
                assert!((moved * position).min_element() > 0.0, "{moved}");
            }
        }
    }

    #[test]
    fn sides_of_a_sheet_are_apart_though_they_share_vertices() {
        // Two squares in one plane, each with its back.
        let positions = [
            [0.0, 0.0],
            [0.0, 1.0],
            [1.0, 1.0],
            [1.0, 0.0],
            [2.0, 0.0],
            [2.0, 1.0],
        ]
        .map(|[x, z]| [x, 0.0, z]);
        let front = [[0, 1, 2], [0, 2, 3], [3, 2, 5], [3, 5, 4]];
        let back = front.map(|[a, b, c]| [a, c, b]);
        let triangles = [front, back].concat();
        let places = places(&positions, &triangles);
        assert_eq!(places.origins.len(), 12);
        for (index, corners) in places.corners.iter().enumerate() {
            let height = if index < 4 { OFFSET } else { -OFFSET };
            for place in corners {
                let origin = places.origins[*place as usize];
                assert!((origin.y - height).abs() < 1e-6, "{index}: {origin}");
            }
        }
        let divided = Divided::new(&triangles, positions.len(), &places.corners);
        assert_eq!(divided.places.len(), 12);
        for (triangle, corners) in divided.triangles.iter().zip(&places.corners) {
            assert_eq!(
                triangle.map(|vertex| divided.places[vertex as usize]),
                *corners
            );
        }
    }

    #[test]
    fn corners_that_see_nothing_are_sampled_where_their_triangle_does() {
        // A plate lies over one corner of a floor, too high to touch it.
        let height = 3.0 * OFFSET;
        let plate = [[3.0, 3.0], [5.0, 3.0], [5.0, 5.0], [3.0, 5.0]];
        let (positions, triangles) = squares(&[FLOOR, plate.map(|[x, z]| [x, height, z])]);
        let places = places(&positions, &triangles);
        for (triangle, corners) in triangles.iter().zip(&places.corners).take(2) {
            for (vertex, place) in triangle.iter().zip(corners) {
                let position = Vec3::from(positions[*vertex as usize]);
                let origin = places.origins[*place as usize];
                if position.x + position.z > 7.0 {
                    assert!(origin.xz().min_element() < 3.0, "{position}: {origin}");
                } else {
                    assert!(
                        origin.distance(position) < 1.1 * OFFSET,
                        "{position}: {origin}"
                    );
                }
            }
        }
    }

    #[test]
    fn faces_that_touch_others_are_sampled_in_front_of_them() {
        // A box stands on a floor; another one is sunk into it.
        for bottom in [0.0, -0.5] {
            let mut faces = vec![FLOOR];
            faces.extend(cuboid([-1.0, bottom, -1.0], [1.0, 2.0, 1.0]));
            let (positions, triangles) = squares(&faces);
            let places = places(&positions, &triangles);
            // The lower corners of the four walls.
            for (index, triangle) in triangles.iter().enumerate().skip(6) {
                for (vertex, place) in triangle.iter().zip(&places.corners[index]) {
                    let position = Vec3::from(positions[*vertex as usize]);
                    let origin = places.origins[*place as usize];
                    if position.y > 0.0 {
                        continue;
                    }
                    let outside = origin.xz().abs().max_element() > 1.0;
                    assert!(
                        origin.y > 0.0 && origin.y < 0.1 && outside,
                        "{position}: {origin}"
                    );
                }
            }
        }
    }

    /// Asserts that the other corners of a triangle are sampled where its tip, so far along x, comes out of these faces at x = 0.
    fn assert_tip_tells(along: f32, faces: &[[[f32; 3]; 4]]) {
        let tip = [along, 0.0, 0.0];
        let (mut positions, mut triangles) = squares(faces);
        positions.extend([tip, [-2.0, 0.0, -1.0], [-2.0, 0.0, 1.0]]);
        let first = positions.len() as u32 - 3;
        triangles.push([first, first + 1, first + 2]);
        let places = places(&positions, &triangles);
        let corners = places.corners.last().expect("a triangle");
        let origins = corners.map(|place| places.origins[place as usize]);
        let moved = origins[0] - Vec3::from(tip);
        assert!((moved - OFFSET * Vec3::Y).length() < 1e-6, "{moved}");
        for origin in &origins[1..] {
            assert!(origin.x > 0.0 && origin.x < 0.1, "{origin}");
            assert!((origin.y - OFFSET).abs() < 1e-6, "{origin}");
        }
    }

    #[test]
    fn a_tip_tells_of_corners_deep_within_solids_that_touch() {
        let solids = [
            cuboid([-5.0, -1.0, -3.0], [0.0, 1.0, 0.5]),
            cuboid([-5.0, -1.0, 0.5], [0.0, 1.0, 3.0]),
        ];
        assert_tip_tells(0.1, &solids.concat());
    }

    /// A room of single sheets that face inwards, up to so high.
    fn room(ceiling: f32) -> [[[f32; 3]; 4]; 6] {
        let mut walls = cuboid([-20.0, -20.0, -20.0], [20.0, ceiling, 20.0]);
        for wall in &mut walls {
            wall.reverse();
        }
        walls
    }

    #[test]
    fn a_tip_tells_of_its_corners_in_a_room_without_a_window() {
        let solid = cuboid([-5.0, -1.0, -3.0], [0.0, 1.0, 3.0]);
        assert_tip_tells(0.1, &[room(20.0), solid].concat());
    }

    #[test]
    fn a_tip_tells_of_its_corners_where_a_wall_passes_through_the_ceiling() {
        let solid = cuboid([-15.0, -1.0, -15.0], [0.0, 3.0, 15.0]);
        let faces = [room(2.0), solid].concat();
        // From within the wall, the ceiling looks like that of a room.
        let (positions, triangles) = squares(&faces);
        let soup: Vec<[Vec3; 3]> = (triangles.iter())
            .map(|triangle| triangle.map(|vertex| positions[vertex as usize].into()))
            .collect();
        let exposure = Exposure::new(EXPOSURE_RESOLUTION);
        let within = Vec3::new(-1.3, OFFSET, 0.0);
        assert!(exposure.is_in_a_room(&RayCaster::new(&soup), within, Vec3::Y, 1.0));
        assert_tip_tells(0.1, &faces);
    }

    #[test]
    fn a_large_tip_tells_of_its_corners_within_a_box_of_two_sides() {
        let outer = cuboid([-5.0, -1.0, -3.0], [0.0, 1.0, 3.0]);
        let inner = outer.map(|[a, b, c, d]| [d, c, b, a]);
        assert_tip_tells(5.0, &[outer, inner].concat());
    }

    #[test]
    fn what_sticks_out_of_a_room_is_sampled_within_it() {
        let (mut positions, mut triangles) = squares(&room(20.0));
        positions.extend([[19.8, 0.0, 0.0], [20.03, 0.0, 0.1], [20.03, 0.0, -0.1]]);
        let first = positions.len() as u32 - 3;
        triangles.push([first, first + 1, first + 2]);
        let places = places(&positions, &triangles);
        let corners = places.corners.last().expect("a triangle");
        for origin in corners.map(|place| places.origins[place as usize]) {
            assert!(19.7 < origin.x && origin.x < 20.0, "{origin}");
            assert!((origin.y - OFFSET).abs() < 1e-5, "{origin}");
        }
    }

    #[test]
    fn what_lies_in_the_open_behind_a_sheet_stays_where_it_is() {
        let wall = [
            [0.0, -1.0, -3.0],
            [0.0, 1.0, -3.0],
            [0.0, 1.0, 3.0],
            [0.0, -1.0, 3.0],
        ];
        let (mut positions, mut triangles) = squares(&[wall]);
        let corners = [[0.1, 0.0, 0.0], [-2.0, 0.0, -1.0], [-2.0, 0.0, 1.0]];
        positions.extend(corners);
        triangles.push([4, 5, 6]);
        let places = places(&positions, &triangles);
        for (corner, place) in corners.into_iter().zip(places.corners[2]) {
            let moved = places.origins[place as usize] - Vec3::from(corner);
            assert!(
                (moved - OFFSET * Vec3::Y).length() < 1e-6,
                "{corner:?}: {moved}"
            );
        }
    }

    /// A box that is sunk into a floor, and a tip beside it that sticks out of another box.
    fn sunk() -> (Vec<Vec3>, Vec<[u32; 3]>) {
        let mut faces = vec![FLOOR];
        faces.extend(cuboid([-1.0, -0.5, -1.0], [1.0, 2.0, 1.0]));
        faces.extend(cuboid([2.0, -0.5, 0.0], [3.0, 1.0, 1.0]));
        let (mut positions, mut triangles) = squares(&faces);
        let first = positions.len() as u32;
        positions.extend([[1.9, 0.5, 0.5], [2.5, 0.5, 0.7], [2.5, 0.5, 0.3]]);
        triangles.push([first, first + 1, first + 2]);
        (positions.into_iter().map(Vec3::from).collect(), triangles)
    }

    fn found<R>(call: impl FnOnce(Finding) -> R) -> R {
        let (positions, triangles) = sunk();
        let soup: Vec<[Vec3; 3]> = (triangles.iter())
            .map(|triangle| triangle.map(|vertex| positions[vertex as usize]))
            .collect();
        let caster = RayCaster::new(&soup);
        call(Finding::new(
            &positions,
            &triangles,
            &caster,
            OFFSET,
            EXPOSURE_RESOLUTION,
        ))
    }

    #[test]
    fn pieces_that_are_asked_for_one_after_the_other_lie_where_they_do_at_once() {
        let corners = |places: &Places| -> Vec<[Vec3; 3]> {
            let corners = places.corners.iter();
            corners
                .map(|corners| corners.map(|place| places.origins[place as usize]))
                .collect()
        };
        let at_once = found(|mut found| {
            found.emerge(|_| true, true);
            found.places
        });
        assert!(at_once.moved_corners > 8);
        // The floor's four places come first, then those of the first box.
        for first in [4, 12] {
            let in_turn = found(|mut found| {
                let all = found.places.origins.len() as u32;
                found.emerge(|place| place < first, true);
                found.emerge(|place| (first..all).contains(&place), true);
                found.places
            });
            assert_eq!(corners(&in_turn), corners(&at_once));
            assert_eq!(in_turn.moved_corners, at_once.moved_corners);
        }
    }

    #[test]
    fn places_that_are_not_divided_are_sampled_where_all_of_them_emerge() {
        found(|mut found| {
            let before = found.places.clone();
            found.emerge(|place| place >= 4, false);
            let after = &found.places;
            assert_eq!(after.corners, before.corners);
            assert_eq!(after.origins.len(), before.origins.len());
            let moved = (before.origins.iter().zip(&after.origins)).filter(|(a, b)| a != b);
            assert!(moved.count() >= 2);
            // The tip's other corners, within the box, are seen where it comes out of that.
            let [tip, inside, _] = after.corners[after.corners.len() - 1];
            assert_eq!(after.origins[tip as usize], before.origins[tip as usize]);
            let inside = after.origins[inside as usize];
            assert!(inside.x < 2.0, "{inside}");
        });
    }

    #[test]
    fn what_a_pole_goes_through_stays_where_it_is() {
        let mut faces = vec![FLOOR];
        faces.extend(cuboid([0.5, -1.0, 0.5], [0.6, 2.0, 0.6]));
        let (positions, triangles) = squares(&faces);
        let places = places(&positions, &triangles);
        for corner in places.corners[..2].as_flattened() {
            let origin = places.origins[*corner as usize];
            assert!(origin.xz().abs().min_element() > 3.99, "{origin}");
        }
    }
}
