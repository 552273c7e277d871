//! Where a triangle that is partly behind others emerges from them.

use glam::Vec3;
use relight_shading::octahedral;

use super::super::ray::{Crossing, NOTHING, RayCaster};
use super::EXPOSURE_RESOLUTION;

/// How close to another surface a corner touches it, and how close to a position crossings
/// may be of the surface that goes on there, in offsets.
const TOUCHING: f32 = 2.0;
const ADJACENT: f32 = 20.0;
/// Sine of the angle between planes that are the same, but for rounding.
const SAME_PLANE: f32 = 1e-3;

/// Crossings that are closer, in offsets, are of both sides of one sheet.
const SHEET: f32 = 0.01;
/// Directions that tell of a room, but for one or two, and how far from a place its walls are at least, in offsets.
const FEW: usize = 5;
pub(super) const ROOM: f32 = 1000.0;
/// Points of a triangle that may be what people see of it, as weights of its corners. The first is a little off the middle, through
/// which other surfaces go where coordinates are round numbers.
const CENTRES: [[f32; 3]; 4] = [
    [0.345, 0.331, 0.324],
    [0.8, 0.1, 0.1],
    [0.1, 0.8, 0.1],
    [0.1, 0.1, 0.8],
];

/// How open places lie, by a few rays.
pub(crate) struct Exposure {
    /// Of an octahedral map of all directions, and what was last met in each: rays from the next place often meet
    /// the same.
    rays: Vec<(Vec3, u32)>,
}

impl Exposure {
    /// So many rays per side of the map.
    pub(crate) fn new(resolution: u32) -> Self {
        let direction = |i| octahedral::texel_direction(i % resolution, i / resolution, resolution);
        Self {
            rays: (0..resolution * resolution)
                .map(|i| (direction(i), NOTHING))
                .collect(),
        }
    }

    /// Whether something is seen in one of the directions over the hemisphere about a normal.
    pub(crate) fn sees(&mut self, caster: &RayCaster, origin: Vec3, normal: Vec3) -> bool {
        self.rays.iter_mut().any(|(direction, occluder)| {
            direction.dot(normal) > 0.0 && !caster.any_hit_as_before(origin, *direction, occluder)
        })
    }

    /// Whether one of a few of those directions leads to something that faces the place and is farther than `near`, metres:
    /// it lies in a room, through whose openings none of them may lead, and neither within something solid nor in a gap.
    /// With as few directions as drafts take that is not told: much has none that is open.
    pub(crate) fn is_in_a_room(
        &self,
        caster: &RayCaster,
        origin: Vec3,
        normal: Vec3,
        near: f32,
    ) -> bool {
        if self.rays.len() < EXPOSURE_RESOLUTION.pow(2) as usize {
            return false;
        }
        // Odd, so that they are not all of one column of the map.
        let step = (self.rays.len() / FEW) | 1;
        let few = self.rays.iter().step_by(step);
        // Turned to the side of the normal.
        let directions = few.map(|(direction, _)| direction * direction.dot(normal).signum());
        directions.into_iter().any(|direction| {
            let met = caster.closest_side(origin, direction);
            met.is_some_and(|(distance, front)| front && distance > near)
        })
    }

    /// How many of those directions are open, if they are more than `beyond`; else no more than that.
    pub(super) fn count_open(
        &mut self,
        caster: &RayCaster,
        (origin, normal): (Vec3, Vec3),
        beyond: usize,
    ) -> usize {
        let is_above = |direction: Vec3| direction.dot(normal) > 0.0;
        let above = (self.rays.iter()).filter(|(direction, _)| is_above(*direction));
        let mut open = above.count();
        for (direction, occluder) in &mut self.rays {
            if open <= beyond {
                break;
            }
            if is_above(*direction) && caster.any_hit_as_before(origin, *direction, occluder) {
                open -= 1;
            }
        }
        open
    }
}

/// What lies on the way from a point of a triangle to one of its corners.
#[derive(Clone, Copy)]
struct Way {
    /// Where the triangle emerges, if the corner is behind something.
    end: Option<Vec3>,
    /// Whether that is where it passes through a sheet of two sides, which may lead out as well as in.
    by_sheet: bool,
    /// How far the last crossing is, as a part of the way, if there are any.
    last: Option<f32>,
    /// Whether it comes out of something that it has not entered: it begins within.
    from_within: bool,
}

impl Way {
    const CLEAR: Self = Self {
        end: None,
        by_sheet: false,
        last: None,
        from_within: false,
    };
}

/// A triangle that may be partly behind others.
pub(super) struct Emerging<'a> {
    pub(super) caster: &'a RayCaster,
    pub(super) offset: f32,
    pub(super) corners: [Vec3; 3],
    /// Unit length, or zero without area.
    pub(super) normal: Vec3,
}

impl Emerging<'_> {
    /// For every corner that lies on or behind something, where the triangle emerges from it.
    /// `around` gives the normals of the triangles that the surface goes on with at a corner.
    pub(super) fn ends<I: Iterator<Item = Vec3>>(
        &self,
        around: impl Fn(usize) -> I,
        exposure: &mut Exposure,
    ) -> [Option<Vec3>; 3] {
        if self.normal == Vec3::ZERO {
            return [None; 3];
        }
        let from = |weights: [f32; 3]| {
            let centre = self.at(weights);
            [0, 1, 2].map(|k| self.way(centre, self.corners[k], || around(k)))
        };
        let ways = from(CENTRES[0]);
        if ways.iter().all(|way| way.last.is_none()) {
            return [None; 3];
        }
        // With nothing in its way a middle that sees something tells of the triangle, however dim it is there.
        let middle = self.above(CENTRES[0]);
        if ways.iter().all(|way| way.end.is_none())
            && exposure.sees(self.caster, middle, self.normal)
        {
            return [None; 3];
        }
        // What people see of the triangle may be near one of its corners alone.
        let in_a_room = |exposure: &Exposure, weights: [f32; 3]| {
            let near = ROOM * self.offset;
            exposure.is_in_a_room(self.caster, self.above(weights), self.normal, near)
        };
        let mut open = |weights: [f32; 3], beyond: usize| {
            exposure.count_open(self.caster, (self.above(weights), self.normal), beyond)
        };
        // Halfway to the corner from where the centre's way to it comes out of something.
        let tips: Vec<(Way, [f32; 3])> = ways
            .into_iter()
            .enumerate()
            .filter_map(|(k, way)| {
                let along = 0.5 + 0.5 * way.last?;
                let mut weights = CENTRES[0].map(|weight| (1.0 - along) * weight);
                weights[k] += along;
                way.end.is_none().then_some((way, weights))
            })
            .collect();
        // Behind a wall of one side all may be open, but that is outside.
        let before_end = |&(way, weights): &(Way, [f32; 3])| {
            let near = middle.distance(self.above(weights));
            way.by_sheet || way.end.is_none_or(|end| near < middle.distance(end))
        };
        let near_corners = ways.into_iter().zip(CENTRES.into_iter().skip(1));
        let near_corners = near_corners.filter(before_end).map(|(_, weights)| weights);
        let mut best = (CENTRES[0], open(CENTRES[0], 0));
        for weights in near_corners.chain(tips.iter().map(|(_, tip)| *tip)) {
            let open = open(weights, 2 * best.1);
            if open > 2 * best.1 {
                best = (weights, open);
            }
        }
        // In a room few directions are open, or none of these. A wall that passes through a room's ceiling looks like one
        // from within.
        if best.1 == 0 {
            let hidden = |way: &Way| way.from_within || !in_a_room(exposure, CENTRES[0]);
            let tip =
                (tips.into_iter()).find(|(way, tip)| in_a_room(exposure, *tip) && hidden(way));
            if let Some((_, tip)) = tip {
                best = (tip, 0);
            }
        }
        let ways = if best.0 == CENTRES[0] {
            ways
        } else {
            from(best.0)
        };
        ways.map(|way| way.end)
    }

    /// For every corner, a point of the triangle near by that sees something, or else its centre, if that does: where
    /// neither does, a corner that sees nothing tells of the whole triangle, as in a gap behind a ledge.
    pub(super) fn seen_from(&self, exposure: &mut Exposure) -> [Option<Vec3>; 3] {
        let points = CENTRES.map(|weights| self.above(weights));
        let mut sees = |point: usize| exposure.sees(self.caster, points[point], self.normal);
        if !sees(0) {
            return [None; 3];
        }
        [1, 2, 3].map(|near| Some(points[if sees(near) { near } else { 0 }]))
    }

    /// Where rays from a point of the triangle begin.
    fn above(&self, weights: [f32; 3]) -> Vec3 {
        self.at(weights) + self.offset * self.normal
    }

    pub(super) fn at(&self, weights: [f32; 3]) -> Vec3 {
        let [a, b, c] = self.corners;
        a * weights[0] + b * weights[1] + c * weights[2]
    }

    /// What lies between a point of the triangle and a corner.
    fn way<I: Iterator<Item = Vec3>>(
        &self,
        centre: Vec3,
        corner: Vec3,
        around: impl Fn() -> I,
    ) -> Way {
        let start = centre + self.offset * self.normal;
        let way = corner - centre;
        let length = way.length();
        let direction = way.normalize_or_zero();
        let reach = TOUCHING * self.offset;
        let mut crossings = self.caster.crossings(start, direction, length + reach);
        crossings.retain(|crossing| {
            let near = (crossing.distance - length).abs() <= ADJACENT * self.offset;
            !(near && self.goes_on(crossing, corner, around()))
        });
        if crossings.is_empty() || direction == Vec3::ZERO {
            return Way::CLEAR;
        }
        crossings.sort_by(|a, b| {
            let slope = |crossing: &Crossing| crossing.normal.dot(direction);
            (a.distance.total_cmp(&b.distance)).then(slope(a).total_cmp(&slope(b)))
        });
        let before = |crossing: &Crossing| {
            let slope = crossing.normal.dot(direction).abs();
            let margin = self.offset / slope.max(1.0 / ADJACENT);
            (crossing.distance - margin).max(0.0)
        };
        let touching = crossings.partition_point(|crossing| crossing.distance <= length - reach);
        let (crossed, touching) = crossings.split_at(touching);
        let last = crossings
            .last()
            .map(|crossing| (crossing.distance / length).min(1.0));
        // How many solids the way has entered, where it entered the first, and whether through a sheet.
        let (mut depth, mut entered, mut by_sheet) = (0, None, false);
        let same = |a: &Crossing, b: &Crossing| b.distance - a.distance < SHEET * self.offset;
        for sheets in crossed.chunk_by(same) {
            let fronts = sheets
                .iter()
                .filter(|sheet| sheet.normal.dot(direction) < 0.0);
            let fronts = fronts.count() as i32;
            let backs = sheets.len() as i32 - fronts;
            // Where both sides of a sheet face outwards, every other one leads inside; from within a solid into one that
            // touches it leads further.
            let is_sheet = fronts > 0 && backs > 0;
            let step = match (is_sheet, depth) {
                (true, 0) => 1,
                (true, 1..) if by_sheet => -1,
                (true, _) => 0,
                _ => (fronts - backs).signum(),
            };
            if depth == 0 && step > 0 {
                (entered, by_sheet) = (Some(before(&sheets[0])), is_sheet);
            }
            depth += step;
        }
        let end = if depth > 0 {
            entered
        } else {
            touching.iter().map(before).min_by(f32::total_cmp)
        };
        Way {
            end: end.map(|end| start + end * direction),
            by_sheet: depth > 0 && by_sheet,
            last,
            from_within: depth < 0,
        }
    }

    /// Whether what is crossed is the surface itself, which goes on at the corner.
    fn goes_on(
        &self,
        crossing: &Crossing,
        corner: Vec3,
        mut around: impl Iterator<Item = Vec3>,
    ) -> bool {
        let height = crossing.normal.dot(corner - crossing.vertex).abs();
        height < SAME_PLANE * ADJACENT * self.offset
            && around.any(|normal| {
                let normal = normal.normalize_or_zero();
                normal.dot(crossing.normal) > 0.0
                    && normal.cross(crossing.normal).length() < SAME_PLANE
            })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn open_directions_are_counted_as_far_as_they_matter() {
        let wall = [[-5.0, -5.0], [5.0, -5.0], [5.0, 5.0]].map(|[y, z]| Vec3::new(0.5, y, z));
        let caster = RayCaster::new(&[wall]);
        let mut exposure = Exposure::new(EXPOSURE_RESOLUTION);
        let at = (Vec3::ZERO, Vec3::Y);
        let open = exposure.count_open(&caster, at, 0);
        let above = exposure
            .rays
            .iter()
            .filter(|(direction, _)| direction.y > 0.0);
        assert!(0 < open && open < above.count());
        for beyond in 0..open {
            assert_eq!(exposure.count_open(&caster, at, beyond), open);
        }
        for beyond in open..open + 3 {
            assert!(exposure.count_open(&caster, at, beyond) <= beyond);
        }
        assert!(exposure.sees(&caster, at.0, at.1));
    }
}
