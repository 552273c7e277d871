//! Which points of sources the pixels of a tile see.
//!
//! A pixel of the coarse grid of [`crate::pixel_visibility`] asks for every point by itself. Another takes from the
//! four about it what they agree on, and sends rays to the points that some of them see and some do not. And it tries
//! what they agree on. Of a group that all of them see whole, where anything is in its cone, a quarter of the points,
//! so that wires thinner than a pixel are found; of others a point that all see and one that none does, another one
//! at every pixel. Where one of those is not as the four have it, something thin lies between them, and the pixel asks
//! for every point.

use glam::{Vec2, Vec3};

use super::{
    ALL_GROUPS, FIRST_PLACE, FIRST_POINT, FIRST_RIM, GROUPS, LONGEST_SIDE, Lit, OWN, PLACES, Pixel,
    RIM, SECOND_PLACE, STEP, STRIDE, of_group,
};
use crate::camera::View;
use crate::gpu;
use crate::pixel_visibility::Parents;
use crate::surface::SurfacePoint;

/// From one pixel of a tile to the next, how much further the points are at which it tries what others agree on.
pub(super) const TURN: u32 = 11;

/// One point of each four that lie side by side.
pub(super) const QUARTER: u32 = 0x1111_1111;

/// What a pixel sees of a source.
#[derive(Clone, Copy, Debug, Default)]
pub struct Seen {
    /// A bit for each group: all of it.
    pub(super) whole: u32,
    /// Of every group that is not seen whole, a bit for each of its points.
    pub(super) points: [u32; GROUPS as usize],
    /// Part of its light that an app's shadow map takes away.
    pub(super) hidden: f32,
}

impl Seen {
    /// The part of a group of so many points that is seen.
    pub(super) fn part(&self, group: u32, of_group: u32) -> f32 {
        let points = self.of_group(group, u32::MAX >> (32 - of_group));
        points.count_ones() as f32 / of_group as f32
    }

    /// The part of one of its places that is seen.
    pub(super) fn part_of_place(&self, group: u32, of_group: u32, place: u32) -> f32 {
        let of_place = (of_group / PLACES).max(1);
        let all = u32::MAX >> (32 - of_place);
        let points = self.of_group(group, u32::MAX) >> (place * of_group / PLACES);
        (points & all).count_ones() as f32 / of_place as f32
    }

    /// The points of a group, of which there are those in `all`.
    fn of_group(&self, group: u32, all: u32) -> u32 {
        if self.whole & (1 << group) != 0 {
            all
        } else {
            self.points[group as usize]
        }
    }
}

impl Lit<'_> {
    /// What the pixels of a tile see of every source, those that the eye is above the horizon of; adds the number of rays
    /// cast, a cone counting as one.
    pub fn seen_by_tile(
        pixels: &[Option<(&SurfacePoint, Self)>],
        parents: &Parents,
        rays: &mut u64,
    ) -> Vec<Option<Vec<Seen>>> {
        let mut found: Vec<Option<Vec<Seen>>> = vec![None; pixels.len()];
        for asks in [false, true] {
            for (index, pixel) in pixels.iter().enumerate() {
                let near = parents.of(index);
                if let Some((point, lit)) = pixel
                    && near.is_some() == asks
                {
                    let near = near.into_iter().flatten();
                    let near: Vec<&[Seen]> = (near.filter(|(_, weight)| *weight > 0.0))
                        .filter_map(|(parent, _)| found[parent].as_deref())
                        .collect();
                    let turn = TURN * index as u32;
                    found[index] = Some(lit.seen_between(point, &near, turn, rays));
                }
            }
        }
        found
    }

    /// The same of one pixel, from what those about it see, if there are any; `turn` is of the pixel, see [`tried`].
    pub(super) fn seen_between(
        &self,
        point: &SurfacePoint,
        near: &[&[Seen]],
        turn: u32,
        rays: &mut u64,
    ) -> Vec<Seen> {
        let start = Start::new(self, point);
        let all = self.sources.points.chunks_exact(STRIDE as usize);
        let seen_of = |(source, all): (usize, &[gpu::SourcePoint])| {
            let near: Vec<&Seen> = near.iter().map(|near| &near[source]).collect();
            let mut look = Look {
                lit: self,
                all,
                point,
                start: &start,
                rays: 0,
            };
            let seen = look.seen(&near, turn);
            *rays += look.rays;
            seen
        };
        let mut found: Vec<Seen> = all.enumerate().map(seen_of).collect();
        if let Some((lookup, image)) = &self.shadow_map
            && let Some(seen) = found.get_mut(lookup.source)
        {
            seen.hidden = lookup.hidden(image, point.position);
        }
        found
    }
}

/// From where rays to sources start.
struct Start {
    /// The pixel's centre on the surface.
    origin: Vec3,
    /// The sides of the square that a pixel covers.
    square: [Vec3; 2],
    radius: f32,
    /// From where the surface was met to the pixel's centre, pixels.
    from_point: Vec2,
}

impl Start {
    fn new(lit: &Lit, point: &SurfacePoint) -> Self {
        let square = |pixel: Pixel| square(pixel.view, point);
        let (square, radius) = lit.pixel.map_or(([Vec3::ZERO; 2], 0.0), square);
        let from_point = lit.pixel.map_or(Vec2::ZERO, |pixel| pixel.centre);
        let origin = point.position + point.geometric_normal * lit.ray_offset;
        Self {
            origin: origin + square[0] * from_point.x + square[1] * from_point.y,
            square,
            radius,
            from_point,
        }
    }
}

/// A pixel that looks at a source.
struct Look<'a> {
    lit: &'a Lit<'a>,
    /// The source's entries.
    all: &'a [gpu::SourcePoint],
    point: &'a SurfacePoint<'a>,
    start: &'a Start,
    rays: u64,
}

impl Look<'_> {
    fn seen(&mut self, near: &[&Seen], turn: u32) -> Seen {
        let of_source = &self.all[FIRST_RIM as usize..FIRST_POINT as usize];
        if !of_source.iter().any(|entry| self.is_above(entry)) {
            return Seen::default();
        }
        let from = self.meet(0, 0);
        if from.is_none() && self.is_cone_above(0) {
            return Seen {
                whole: ALL_GROUPS,
                ..Seen::default()
            };
        }
        let confirmed = match from {
            Some(from) if !near.is_empty() => self.confirmed(near, turn, from),
            _ => None,
        };
        confirmed.unwrap_or_else(|| self.all_points(from))
    }

    /// The entry of a group's first point, and a bit for each of them.
    fn group(&self, group: u32) -> (u32, u32) {
        let of_group = of_group(self.all);
        (FIRST_POINT + group * of_group, u32::MAX >> (32 - of_group))
    }

    /// What the pixels about this one agree on and rays do not contradict, with rays to what they disagree about.
    fn confirmed(&mut self, near: &[&Seen], turn: u32, from: u32) -> Option<Seen> {
        let mut seen = Seen::default();
        for group in 0..GROUPS {
            let (_, all) = self.group(group);
            let seen_near = near.iter().map(|near| near.of_group(group, all));
            let (common, any) =
                seen_near.fold((all, 0), |(common, any), bits| (common & bits, any | bits));
            let mut asked = tried(common, turn) | (any & !common) | tried(all & !any, turn);
            let mut met = Some(from);
            if common == all {
                met = self.meet(1 + group, from);
                let is_clear = met.is_none() && self.is_cone_above(1 + group);
                asked = if is_clear {
                    0
                } else {
                    all & (QUARTER << (turn % 4))
                };
            }
            let found = self.rays(group, asked, met);
            if found.seen & !any != 0 || found.hidden & common != 0 {
                return None;
            }
            let bits = common | found.seen;
            seen.whole |= u32::from(bits == all) << group;
            seen.points[group as usize] = bits;
        }
        Some(seen)
    }

    /// Asks for every point: `from` is where something is in the way, if anything is.
    fn all_points(&mut self, from: Option<u32>) -> Seen {
        let probed = from.map_or(0, |from| self.probe(from));
        let mut seen = Seen::default();
        if from.is_some() && probed == 0 {
            return seen;
        }
        for group in 0..GROUPS {
            // A first ray that was blocked has told.
            let mut met = from;
            if let Some(from) = from
                && probed & (1 << group) != 0
            {
                met = self.meet(1 + group, from);
            }
            if met.is_none() && self.is_cone_above(1 + group) {
                seen.whole |= 1 << group;
                continue;
            }
            let (_, all) = self.group(group);
            let found = self.rays(group, all, met);
            seen.whole |= u32::from(found.seen != 0 && found.hidden == 0) << group;
            seen.points[group as usize] = found.seen;
        }
        seen
    }

    /// Whether anything of the source is visible: the first place of each group, a bit each, and where all of those are
    /// hidden, a second one and, of a source of many points, the rim.
    fn probe(&mut self, from: u32) -> u32 {
        let mut found = 0;
        for step in 0..probes(of_group(self.all)) {
            if step >= GROUPS && found != 0 {
                break;
            }
            let (entry, place) = probe(step);
            let visible = self.is_visible(entry, place, Some(from));
            found |= u32::from(visible == Some(true)) << step;
        }
        found
    }

    /// Sends rays to points of a group, a bit each.
    fn rays(&mut self, group: u32, asked: u32, from: Option<u32>) -> Found {
        let (first, _) = self.group(group);
        let mut found = Found::default();
        let mut bits = asked;
        while bits != 0 {
            let step = bits.trailing_zeros();
            match self.is_visible(first + step, place(step * GROUPS + group), from) {
                Some(true) => found.seen |= 1 << step,
                Some(false) => found.hidden |= 1 << step,
                None => {}
            }
            bits &= bits - 1;
        }
        found
    }

    /// Where anything is in a cone's way.
    fn meet(&mut self, cone: u32, from: u32) -> Option<u32> {
        self.rays += 1;
        let cone = &self.all[cone as usize];
        self.lit.occluders.meet_cone(
            from,
            self.start.origin,
            self.start.radius,
            self.point.geometric_normal,
            cone.direction.into(),
            cone.cone_cosine,
        )
    }

    /// Whether a ray from a place of the pixel to an entry meets nothing, where something is in the way; `None` for one
    /// below the horizon.
    fn is_visible(&mut self, entry: u32, place: Vec2, from: Option<u32>) -> Option<bool> {
        let source = &self.all[entry as usize];
        if !self.is_above(source) {
            return None;
        }
        let direction = Vec3::from(source.direction);
        if self.point.geometric_normal.dot(direction) <= 0.0 {
            return Some(false);
        }
        let Some(from) = from else {
            return Some(true);
        };
        self.rays += 1;
        let Start {
            square, from_point, ..
        } = self.start;
        let at = |place: Vec2| square[0] * place.x + square[1] * place.y;
        let nearest = OWN * at(place + from_point).length();
        let origin = self.start.origin + at(place);
        let occluders = self.lit.occluders;
        Some(!occluders.block(from, origin, direction, nearest))
    }

    /// Whether a direction is above the point's horizon.
    fn is_above(&self, source: &gpu::SourcePoint) -> bool {
        self.point.normal.dot(source.direction.into()) > 0.0
    }

    /// Whether all of a cone is above the plane of the point's triangle.
    fn is_cone_above(&self, cone: u32) -> bool {
        let cone = &self.all[cone as usize];
        let along = self.point.geometric_normal.dot(cone.direction.into());
        along > 0.0 && along * along + cone.cone_cosine * cone.cone_cosine > 1.0
    }
}

/// What rays to a group have told: a bit for each point that is above the horizon.
#[derive(Clone, Copy, Debug, Default)]
struct Found {
    seen: u32,
    hidden: u32,
}

/// One of the bits, the first from the bit `turn` on.
fn tried(bits: u32, turn: u32) -> u32 {
    let above = bits & (u32::MAX << (turn % 32));
    let bits = if above != 0 { above } else { bits };
    bits & bits.wrapping_neg()
}

/// How many rays tell whether anything of a source is visible.
fn probes(of_group: u32) -> u32 {
    2 * GROUPS + if of_group < PLACES { 0 } else { RIM }
}

/// Entry and place in the pixel of what tells whether anything of a source is visible.
fn probe(step: u32) -> (u32, Vec2) {
    if step >= 2 * GROUPS {
        return (FIRST_RIM + step - 2 * GROUPS, Vec2::ZERO);
    }
    let (group, round) = (step % GROUPS, step / GROUPS);
    let of_group = round * SECOND_PLACE;
    let entry = FIRST_PLACE + group * PLACES + of_group;
    (entry, place(of_group * GROUPS + group))
}

/// Where in a pixel the ray to a point starts, from its centre, in columns and rows: −½ to ½.
fn place(index: u32) -> Vec2 {
    STEP.map(|step| ((index.wrapping_mul(step) >> 8) ^ (1 << 23)) as f32 / 16_777_216.0 - 0.5)
        .into()
}

/// The sides of the square that a pixel covers on the plane of a surface, and the radius around it.
fn square(view: &View, point: &SurfacePoint) -> ([Vec3; 2], f32) {
    let Some(steps) = view.steps(point.geometric_normal, point.position) else {
        return ([Vec3::ZERO; 2], 0.0);
    };
    // The plane that faces the eye is crossed by the same rays.
    let facing = view.steps(point.view, point.position);
    let facing = facing.unwrap_or([Vec3::ZERO; 2]).map(Vec3::length);
    let longest = LONGEST_SIDE * facing[0].max(facing[1]);
    let [x, y] = steps.map(|side| side * (longest / side.length().max(1e-20)).min(1.0));
    ([x, y], 0.5 * (x + y).length().max((x - y).length()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::occluders::{Node, Occluders};
    use crate::pixel_visibility::{PIXELS, Place, SIDE};
    use crate::sources::{GROUP_POINTS, Sources};
    use crate::surface::{Appearance, local_point};
    use relight_format::{Environment, Source};

    /// Points of 256 that a pixel may miss where what is between it and its neighbours hides a few.
    const TOLERANCE: f32 = 2.5 / 256.0;

    /// A square source of a tenth of a radian straight above.
    fn sources() -> Sources {
        let environment = Environment {
            sources: vec![Source {
                theta: 0.95 * std::f32::consts::FRAC_PI_2,
                phi: 0.0,
                row_step: 0.01,
                column_step: 0.01,
                rows: 10,
                columns: 10,
            }],
            source_texels: vec![[1.0; 3]; 100],
            ..Environment::default()
        };
        let sources = Sources::new(&environment).unwrap();
        let turn = glam::Quat::from_rotation_arc(sources.axis(0).unwrap(), Vec3::Z);
        sources.turned(&glam::Mat3::from_quat(turn))
    }

    /// The part that a tile of pixels a tenth apart sees past rectangles one above it, each by itself and together, and
    /// the rays of both.
    fn seen(rectangles: &[[f32; 2]]) -> ([Vec<f32>; 2], [u64; 2]) {
        let triangles: Vec<[Vec3; 3]> = (rectangles.iter())
            .flat_map(|&[left, right]| {
                let [a, b] = [left, right].map(|x| Vec3::new(x, -9.0, 1.0));
                let [c, d] = [left, right].map(|x| Vec3::new(x, 9.0, 1.0));
                [[a, b, c], [d, c, b]]
            })
            .collect();
        let root = Node {
            low: Vec3::new(-99.0, -9.0, 1.0),
            high: Vec3::new(99.0, 9.0, 1.0),
            first: 0,
            count: triangles.len() as u32,
        };
        let occluders = Occluders::new(&[root], &triangles);
        let sources = sources();
        let points: Vec<_> = (0..PIXELS as u32)
            .map(|pixel| {
                let at = Vec2::new((pixel % SIDE) as f32, (pixel / SIDE) as f32);
                let mut point = local_point(Appearance::new(Vec3::ONE, &[]), Vec3::Z);
                point.position = (0.1 * at).extend(0.0);
                point
            })
            .collect();
        let lit = Lit::at_points(&sources, &occluders);
        let place = |point: &SurfacePoint| {
            Some(Place {
                position: point.position,
                normal: point.normal,
                surface: [0; 2],
            })
        };
        let parents = Parents::new(&points.iter().map(place).collect::<Vec<_>>());
        let pixels: Vec<_> = points.iter().map(|point| Some((point, lit))).collect();
        let mut rays = [0; 2];
        let part = |seen: &[Seen]| {
            let points = |group| seen[0].of_group(group, u32::MAX).count_ones();
            (0..GROUPS).map(points).sum::<u32>() as f32 / (GROUPS * GROUP_POINTS) as f32
        };
        let alone = points
            .iter()
            .map(|point| part(&lit.seen(point, &mut rays[0])));
        let alone = alone.collect();
        let together = Lit::seen_by_tile(&pixels, &parents, &mut rays[1]);
        let together = together.iter().map(|seen| part(seen.as_ref().unwrap()));
        ([alone, together.collect()], rays)
    }

    fn assert_close([alone, together]: &[Vec<f32>; 2]) {
        for (pixel, (alone, together)) in alone.iter().zip(together).enumerate() {
            assert!(
                (alone - together).abs() <= TOLERANCE,
                "{pixel}: {alone} {together}"
            );
        }
    }

    #[test]
    fn together_pixels_see_the_same_by_fewer_rays() {
        // Light, shadow, and the edge of one: the penumbra is a tenth wide, as the pixels are.
        for (edge, most) in [(-2.0, 1.0), (2.0, 0.6), (0.32, 0.9)] {
            let (parts, rays) = seen(&[[-9.0, edge]]);
            assert_close(&parts);
            let part = rays[1] as f64 / rays[0] as f64;
            println!("{edge}: {rays:?}, {part}");
            assert!(part <= most, "{rays:?}");
        }
        let ([alone, _], _) = seen(&[[-9.0, 0.32]]);
        assert_eq!([alone[0], alone[7]], [0.0, 1.0]);
    }

    #[test]
    fn wires_thinner_than_pixels_are_found() {
        // From a twenty-fifth of a pixel on, which hide from a fifteenth to two fifths of the source.
        for width in [0.004, 0.01, 0.02, 0.04] {
            let (parts, _) = seen(&[[0.3 - 0.5 * width, 0.3 + 0.5 * width]]);
            assert!(parts[0][3] < 0.95);
            assert_close(&parts);
        }
    }

    #[test]
    fn what_is_thin_is_found_between_pixels_that_agree() {
        // Over the fourth column, which lies between the third and the sixth; light alone, and a slit in a shadow.
        let wire: &[[f32; 2]] = &[[0.26, 0.34]];
        let slit: &[[f32; 2]] = &[[-9.0, 0.22], [0.38, 9.0]];
        for (rectangles, around) in [(wire, 1.0), (slit, 0.0)] {
            let (parts, _) = seen(rectangles);
            assert_close(&parts);
            for (pixel, &found) in parts[1].iter().enumerate() {
                match pixel % SIDE as usize {
                    3 => assert!((found - around).abs() > 0.5, "{pixel}: {found}"),
                    0 | 7 => assert_eq!(found, around, "{pixel}"),
                    _ => {}
                }
            }
        }
    }
}
