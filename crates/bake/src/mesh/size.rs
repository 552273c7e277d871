//! How large the thing is that a point of a scene belongs to or stands beside.
//!
//! Most scenes are one thing, and its diagonal tells how finely their surfaces have to be divided. A figure on a
//! field, or in a hall, is small beside the whole, and so is what its shadow needs. Vertices gather where things are:
//! a ball with a given part of them tells the size of what is there. Away from there sizes grow with the distance, as
//! shadows widen (a gradient-limited mesh size function: Persson 2006, "Mesh size functions for implicit geometry and
//! PDE-based gradient limiting").

use glam::Vec3;
use rayon::prelude::*;

/// Vertices that are looked at, and those that balls are put about, at most.
const POINTS: usize = 1 << 16;
const BALLS: usize = 512;
/// A ball holds one of so many of all vertices, and so many at least besides its middle.
const PARTS: usize = 64;
const LEAST: usize = 7;
/// Diagonal of a thing in radii of the ball that would hold all of it, were its vertices spread evenly. From scans,
/// figures and furniture: with this, balls of one that stands alone tell half of its diagonal to four times that.
const DIAGONALS: f32 = 4.0;
/// Things above this part of the whole are divided as the whole is, whose edges are then at most two fifths as long as they
/// are: to divide them further costs up to three times the bytes, for less than it does for smaller things.
const WHOLE: f32 = 0.05;
/// Nothing is taken to be smaller than this part of the whole: coordinates hardly tell it from a point.
const POINT: f32 = 1e-6;
/// How much sizes grow with every metre of distance, metres.
const GROWTH: f32 = 5.0;

/// What is small beside the whole scene, and where.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct SizeFunction {
    /// Metres.
    whole: f32,
    /// Least size first.
    balls: Vec<Ball>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
struct Ball {
    middle: Vec3,
    radius: f32,
    /// Of what is in it, metres.
    size: f32,
}

impl SizeFunction {
    /// Of vertices at `positions`; nowhere above `whole`, in metres.
    pub(crate) fn new(positions: &[Vec3], whole: f32) -> Self {
        let whole = whole.max(f32::MIN_POSITIVE);
        let mut balls = balls(positions);
        balls.retain(|ball| ball.size < WHOLE * whole);
        for ball in &mut balls {
            ball.size = ball.size.max(POINT * whole);
        }
        balls.sort_by(|a, b| a.size.total_cmp(&b.size));
        let mut kept: Vec<Ball> = Vec::new();
        for ball in balls {
            // Where another asks for as little in all of it, a ball tells nothing.
            let within = |other: &Ball| {
                let beyond = other.middle.distance(ball.middle) + ball.radius - other.radius;
                other.size + GROWTH * beyond.max(0.0) <= ball.size
            };
            if !kept.iter().any(within) {
                kept.push(ball);
            }
        }
        Self { whole, balls: kept }
    }

    /// The same size everywhere, metres.
    #[cfg(test)]
    pub(crate) fn even(whole: f32) -> Self {
        Self::new(&[], whole)
    }

    /// Whether nothing is small beside the whole.
    pub(crate) fn is_even(&self) -> bool {
        self.balls.is_empty()
    }

    /// The size at a point, metres.
    pub(crate) fn at(&self, point: Vec3) -> f32 {
        self.between(point, point)
    }

    /// The size at a point as a part of the whole, in (0, 1].
    pub(crate) fn part(&self, point: Vec3) -> f32 {
        self.at(point) / self.whole
    }

    /// The least size anywhere as a part of the whole, in (0, 1].
    pub(crate) fn least_part(&self) -> f32 {
        self.least() / self.whole
    }

    fn least(&self) -> f32 {
        self.balls.first().map_or(self.whole, |ball| ball.size)
    }

    /// Length of the edge from `a` to `b`, as a part of the least size on its way: the same to the last bit from `b`
    /// to `a`. Where that is at most `short`, something that is no less.
    pub(crate) fn length(&self, a: Vec3, b: Vec3, short: f32) -> f32 {
        let length = a.distance(b);
        let longest = length / self.least();
        if longest <= short {
            return longest;
        }
        length / self.between(a, b)
    }

    /// The least size on the way from `a` to `b`, metres: the same to the last bit from `b` to `a`.
    fn between(&self, a: Vec3, b: Vec3) -> f32 {
        let [a, b] = if a.to_array() <= b.to_array() {
            [a, b]
        } else {
            [b, a]
        };
        let way = b - a;
        let squared = way.length_squared().max(f32::MIN_POSITIVE);
        let size = |ball: &Ball| {
            let along = ((ball.middle - a).dot(way) / squared).clamp(0.0, 1.0);
            let distance = (a + along * way).distance(ball.middle) - ball.radius;
            ball.size + GROWTH * distance.max(0.0)
        };
        (self.balls.iter().map(size)).fold(self.whole, f32::min)
    }
}

/// Balls about some vertices, each with its part of all.
fn balls(positions: &[Vec3]) -> Vec<Ball> {
    // Adding zero turns −0 into +0. Copies of a vertex, at seams and hard edges, are one.
    let bits = |position: &Vec3| (*position + Vec3::ZERO).to_array().map(f32::to_bits);
    let mut places: Vec<[u32; 3]> = positions.iter().map(bits).collect();
    places.par_sort_unstable();
    places.dedup();
    let points: Vec<Vec3> = evenly(places.len(), POINTS)
        .map(|index| Vec3::from(places[index].map(f32::from_bits)))
        .collect();
    let nearest = (points.len() / PARTS).max(LEAST);
    if nearest >= points.len() {
        return Vec::new();
    }
    // As many balls as this, beside one another, would cover an even surface.
    let parts = points.len() as f32 / (nearest + 1) as f32;
    let middles: Vec<usize> = evenly(points.len(), BALLS).collect();
    let about = |index: usize| {
        let middle = points[index];
        let mut distances: Vec<f32> = (points.iter())
            .map(|point| point.distance_squared(middle))
            .collect();
        let (_, squared, _) = distances.select_nth_unstable_by(nearest, f32::total_cmp);
        let radius = squared.sqrt();
        Ball {
            middle,
            radius,
            size: DIAGONALS * radius * parts.sqrt(),
        }
    };
    middles.into_par_iter().map(about).collect()
}

/// Numbers below `count`, at most `most` of them.
fn evenly(count: usize, most: usize) -> impl Iterator<Item = usize> {
    let taken = count.min(most);
    (0..taken).map(move |index| (index as u64 * count as u64 / taken as u64) as usize)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Points evenly over a sphere (Fibonacci lattice).
    fn sphere(centre: Vec3, radius: f32, count: u32) -> Vec<Vec3> {
        let point = |index: u32| {
            let y = 1.0 - (2 * index + 1) as f32 / count as f32;
            let angle = 2.399_963 * index as f32;
            let ring = (1.0 - y * y).sqrt();
            let (sin, cos) = relight_format::math::sin_cos(angle);
            centre + radius * Vec3::new(ring * cos, y, ring * sin)
        };
        (0..count).map(point).collect()
    }

    fn square(half: f32) -> [Vec3; 4] {
        [[-1.0, -1.0], [-1.0, 1.0], [1.0, 1.0], [1.0, -1.0]]
            .map(|[x, z]| half * Vec3::new(x, 0.0, z))
    }

    #[test]
    fn one_thing_is_as_large_as_it_is() {
        for count in [8, 30, 400, 5000] {
            let points = sphere(Vec3::Y, 1.0, count);
            let sizes = SizeFunction::new(&points, 3.46);
            assert!(sizes.is_even(), "{count}: {sizes:?}");
            assert_eq!(sizes.between(points[0], points[1]), 3.46);
        }
        assert!(SizeFunction::new(&[], 0.0).is_even());
    }

    #[test]
    fn what_stands_on_a_wide_ground_is_found_and_sizes_grow_away_from_it() {
        for count in [8, 400] {
            let mut points = sphere(Vec3::new(20.0, 1.0, 0.0), 1.0, count);
            points.extend(square(1000.0));
            let sizes = SizeFunction::new(&points, 2828.0);
            let beside = sizes.at(Vec3::new(20.0, 0.0, 0.0));
            assert!((0.5..20.0).contains(&beside), "{count}: {beside}");
            let away = |metres: f32| sizes.at(Vec3::new(20.0 + metres, 0.0, 0.0));
            assert!(away(100.0) > 100.0 && away(100.0) < 600.0);
            assert_eq!(away(900.0), 2828.0);
            // A side that passes by is as small as what it passes.
            let [a, b] = [Vec3::new(-1000.0, 0.0, -2.0), Vec3::new(1000.0, 0.0, 2.0)];
            let passing = sizes.between(a, b);
            assert!(passing < 2.0 * beside + 10.0, "{passing}");
            assert_eq!(passing.to_bits(), sizes.between(b, a).to_bits());
            assert!(sizes.length(a, b, 0.5) > 50.0);
        }
    }

    #[test]
    fn two_things_far_apart_are_both_found() {
        let mut points = sphere(Vec3::Y, 1.0, 300);
        points.extend(sphere(Vec3::new(800.0, 1.0, 0.0), 2.0, 300));
        points.extend(square(1000.0));
        let sizes = SizeFunction::new(&points, 2828.0);
        for at in [Vec3::ZERO, Vec3::X * 800.0] {
            assert!(sizes.at(at) < 30.0, "{}", sizes.at(at));
        }
        assert!(sizes.at(Vec3::X * 400.0) > 1000.0);
        // Copies of a vertex are one.
        let doubled: Vec<Vec3> = points.iter().flat_map(|&point| [point; 3]).collect();
        assert_eq!(SizeFunction::new(&doubled, 2828.0), sizes);
    }

    #[test]
    fn a_knot_of_vertices_is_no_smaller_than_a_millionth_of_all() {
        let mut points: Vec<Vec3> = (0..12)
            .map(|index| 1e-25 * Vec3::new(index as f32, 0.0, (index * 5 % 7) as f32))
            .collect();
        points.extend(square(9.0).map(|corner| corner - Vec3::Y));
        let whole = 25.5;
        let sizes = SizeFunction::new(&points, whole);
        assert_eq!(sizes.at(Vec3::ZERO), POINT * whole);
        assert!(sizes.at(points[12]) > WHOLE * whole);
        let length = sizes.length(Vec3::ZERO, points[12], 0.5);
        assert!(
            length < 1.01 * points[12].length() / (POINT * whole),
            "{length}"
        );
    }
}
