//! Triangles of pieces that are hardly more than one: litter, scraps, cards with leaves.
//!
//! Most of them look smaller than a texel and cover the centre of none: they change nothing, which
//! their corners tell at once. Those that are hardly larger are drawn: the centres of
//! texels around them are tried one by one, by the lines that their edges map to, and by a ray against the one triangle
//! where that is a matter of rounding or where the edges bend. The others are counted by their edges, each with the
//! layer that the triangle itself is: what two of them share cancels.

use glam::Vec3;
use pulp::{Simd, WithSimd};

use super::batch::{CLEARANCE, Filling, LANES, whole};
use super::layers::{BELOW, Layers, Point, Points, append, between_lines, crosses_lines};
use super::rounds::Open;
use crate::visibility::{ones, pack_bits, ray};

/// Triangles that span less than this along both axes, in texels, are drawn.
pub(super) const SMALL: f32 = 2.0;

/// Some of them, near one another, side by side.
pub(super) struct Bundle {
    /// Coordinates of their corners.
    pub(super) corners: [[[f32; LANES]; 3]; 3],
    /// Their numbers in the list that the mesh was made of.
    triangles: [u32; LANES],
    count: usize,
}

impl Default for Bundle {
    fn default() -> Self {
        Self {
            corners: [[[0.0; LANES]; 3]; 3],
            triangles: [0; LANES],
            count: 0,
        }
    }
}

impl Bundle {
    /// # Panics
    ///
    /// If it is full.
    pub(super) fn push(&mut self, triangle: u32, corners: [Vec3; 3]) {
        for (all, corner) in self.corners.iter_mut().zip(corners) {
            for (axis, coordinate) in all.iter_mut().zip(corner.to_array()) {
                axis[self.count] = coordinate;
            }
        }
        self.triangles[self.count] = triangle;
        self.count += 1;
    }

    /// Corners of one of them.
    #[inline(always)]
    pub(super) fn triangle(&self, lane: usize) -> [Vec3; 3] {
        (self.corners.each_ref())
            .map(|corner| Vec3::new(corner[0][lane], corner[1][lane], corner[2][lane]))
    }

    pub(super) fn triangles(&self) -> &[u32] {
        &self.triangles[..self.count]
    }

    /// Lanes in use.
    #[inline(always)]
    pub(super) fn lanes(&self) -> u64 {
        (1 << self.count) - 1
    }
}

/// The vectorised part of [`Layers::count_loose`].
pub(super) struct Count<'a, I> {
    pub(super) layers: &'a mut Layers,
    pub(super) directions: &'a [Vec3],
    pub(super) bundles: I,
    pub(super) open: Option<&'a Open>,
}

/// A triangle that was drawn.
pub(super) struct Drawn {
    pub(super) bundle: u32,
    pub(super) lane: u32,
    /// Its middle, in texels.
    pub(super) middle: Point,
    /// Its corners in texels, if it lies within one octant, where its edges are straight.
    pub(super) flat: Option<[Point; 3]>,
}

impl<'a, F: Fn(usize) -> i8, I: Iterator<Item = (usize, &'a Bundle, F)>> WithSimd for Count<'_, I> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let Self {
            layers,
            directions,
            bundles,
            open,
        } = self;
        let (eye, half) = (layers.eye, layers.resolution() as f32 * 0.5);
        let (first, mut segments) = layers.take_segments();
        let mut filling = Filling::new(&mut segments);
        for (number, bundle, face) in bundles {
            // Not by `map`, which would be compiled for any processor.
            let [a, b, c] = &bundle.corners;
            let corners = [
                Points::new(a, eye, half),
                Points::new(b, eye, half),
                Points::new(c, eye, half),
            ];
            let [a, b, c] = &corners;
            let bounds = Bounds::of(&corners, half);
            for lane in ones(bounds.around_centres() & bundle.lanes()) {
                let [low, high] = bounds.rectangle(lane);
                let behind = |open: &Open| {
                    if bounds.within[lane] == 1 {
                        return !open.any_between(low, high);
                    }
                    let [a, b, c] = corners.each_ref().map(|corner| corner.coordinates(lane));
                    !open.any_in(a.min(b).min(c), a.max(b).max(c))
                };
                let step = i32::from(face(lane));
                if step == 0 || open.is_some_and(behind) {
                    continue;
                }
                if bounds.small[lane] == 1 {
                    let flat = (bounds.flat[lane] == 1)
                        .then(|| [a.texel(lane), b.texel(lane), c.texel(lane)]);
                    if bounds.covers_none[lane] == 0 {
                        let texels =
                            [&bounds.first, &bounds.past].map(|of| [of[0][lane], of[1][lane]]);
                        layers.draw(
                            bundle.triangle(lane),
                            flat.map(Flat::new).as_ref(),
                            texels,
                            directions,
                            open,
                        );
                    }
                    layers.drawn.push(Drawn {
                        bundle: number as u32,
                        lane: lane as u32,
                        middle: [0, 1].map(|axis| 0.5 * (low[axis] + high[axis])),
                        flat,
                    });
                    continue;
                }
                for (from, to) in [(a, b), (b, c), (c, a)] {
                    if crosses_lines(from, to, lane) == 1 {
                        append(&mut filling, from, to, lane, step, half);
                    }
                }
            }
        }
        filling.finish();
        layers.add_from(first, segments);
    }
}

impl Layers {
    /// Draws a triangle, whose corners these are if it lies within one octant, from the first to past the last texels
    /// that it may cover, where texels are `open`.
    #[inline(always)]
    fn draw(
        &mut self,
        triangle: [Vec3; 3],
        flat: Option<&Flat>,
        [[left, top], [right, bottom]]: [[u32; 2]; 2],
        directions: &[Vec3],
        open: Option<&Open>,
    ) {
        for y in top..bottom {
            for x in left..right {
                let texel = y * self.resolution() as u32 + x;
                if open.is_some_and(|open| !open.may_be(x as usize, y as usize)) {
                    continue;
                }
                let covers = flat.and_then(|flat| flat.covers([x as f32, y as f32]));
                if covers
                    .unwrap_or_else(|| ray::meets(triangle, self.eye, directions[texel as usize]))
                {
                    self.covered.push(texel);
                }
            }
        }
    }
}

/// A triangle with straight edges in the map.
struct Flat {
    corners: [Point; 3],
    /// 1 if they go round as the first axis turns to the second, else −1.
    sign: f32,
    /// Per edge, how far from it a centre is uncertain, times its length.
    reach: [f32; 3],
    /// Whether it is so thin that it is a matter of rounding which way round it goes.
    thin: bool,
}

impl Flat {
    #[inline(always)]
    fn new([a, b, c]: [Point; 3]) -> Self {
        let area = turn(a, b, c);
        let sign = if area < 0.0 { -1.0 } else { 1.0 };
        let [ab, bc, ca] = [reach(a, b), reach(b, c), reach(c, a)];
        let area = sign * area;
        let thick = u32::from(area > ab) & u32::from(area > bc) & u32::from(area > ca);
        Self {
            corners: [a, b, c],
            sign,
            reach: [ab, bc, ca],
            thin: thick == 0,
        }
    }

    /// Whether a texel's centre lies inside; nothing within rounding of an edge.
    #[inline(always)]
    fn covers(&self, centre: Point) -> Option<bool> {
        let ([a, b, c], [ab, bc, ca], sign) = (self.corners, self.reach, self.sign);
        let of_ab = sign * turn(a, b, centre);
        let of_bc = sign * turn(b, c, centre);
        let of_ca = sign * turn(c, a, centre);
        let outside = u32::from(of_ab < -ab) | u32::from(of_bc < -bc) | u32::from(of_ca < -ca);
        let inside = u32::from(of_ab > ab) & u32::from(of_bc > bc) & u32::from(of_ca > ca);
        if self.thin || outside == inside {
            None
        } else {
            Some(inside == 1)
        }
    }
}

/// Rectangles around triangles side by side, in texels, where each lies within one octant, or in the two that meet
/// at a quarter of the equator.
struct Bounds {
    low: [[f32; LANES]; 2],
    high: [[f32; LANES]; 2],
    within: [u8; LANES],
    /// Whether they are small, too.
    small: [u8; LANES],
    /// Whether they lie within one octant, where their edges are straight.
    flat: [u8; LANES],
    /// The first texels whose centres lie in the rectangle or near it, and those past the last.
    first: [[u32; LANES]; 2],
    past: [[u32; LANES]; 2],
    /// Whether there is but one, which lies outside of a flat triangle.
    covers_none: [u8; LANES],
}

impl Bounds {
    #[inline(always)]
    fn of(corners: &[Points; 3], half: f32) -> Self {
        let mut bounds = Self {
            low: [[0.0; LANES]; 2],
            high: [[0.0; LANES]; 2],
            within: [0; LANES],
            small: [0; LANES],
            flat: [0; LANES],
            first: [[0; LANES]; 2],
            past: [[0; LANES]; 2],
            covers_none: [0; LANES],
        };
        let mut over_equator = [0; LANES];
        for (lane, over_equator) in over_equator.iter_mut().enumerate() {
            let [a, b, c] = corners.each_ref().map(|corner| corner.octants[lane]);
            let differ = (a ^ b) | (b ^ c);
            bounds.within[lane] = u8::from(differ & !BELOW == 0);
            *over_equator = u8::from(differ == BELOW);
            bounds.flat[lane] = u8::from(differ == 0);
        }
        bounds.surround(corners);
        if over_equator.contains(&1) {
            // Every edge maps to two straight segments, which meet on the equator, between where the corners are
            // that lie above or below its ends.
            for corner in corners {
                bounds.grow(&corner.on_equator(half), &over_equator);
            }
        }
        for lane in 0..LANES {
            let span = |axis: usize| bounds.high[axis][lane] - bounds.low[axis][lane];
            let small = u8::from(span(0) < SMALL) & u8::from(span(1) < SMALL);
            bounds.small[lane] = bounds.within[lane] & small;
        }
        bounds.find_texels(corners, 2.0 * half);
        bounds
    }

    /// Finds the texels that they may cover, on a map of `n` to a side.
    #[inline(always)]
    fn find_texels(&mut self, [a, b, c]: &[Points; 3], n: f32) {
        for axis in 0..2 {
            let (low, high) = (&self.low[axis], &self.high[axis]);
            for lane in 0..LANES {
                let first = (low[lane] - CLEARANCE).ceil();
                let past = (high[lane] + CLEARANCE).floor() + 1.0;
                let past = if past < n { past } else { n };
                self.first[axis][lane] = whole(if first > 0.0 { first } else { 0.0 });
                self.past[axis][lane] = whole(if past > 0.0 { past } else { 0.0 });
            }
        }
        let ([au, av], [bu, bv], [cu, cv]) = (&a.texels, &b.texels, &c.texels);
        for lane in 0..LANES {
            let one = self.first[0][lane] + 1 == self.past[0][lane]
                && self.first[1][lane] + 1 == self.past[1][lane];
            let centre = [self.first[0][lane] as f32, self.first[1][lane] as f32];
            let corners = [
                [au[lane], av[lane]],
                [bu[lane], bv[lane]],
                [cu[lane], cv[lane]],
            ];
            let covers = Flat::new(corners).covers(centre);
            self.covers_none[lane] =
                self.flat[lane] & u8::from(one) & u8::from(covers == Some(false));
        }
    }

    /// Begins with the corners. Where one is not a number, both ends are not.
    #[inline(always)]
    fn surround(&mut self, corners: &[Points; 3]) {
        for axis in 0..2 {
            let [a, b, c] = corners.each_ref().map(|corner| &corner.texels[axis]);
            let (low, high) = (&mut self.low[axis], &mut self.high[axis]);
            for lane in 0..LANES {
                let (a, b, c) = (a[lane], b[lane], c[lane]);
                let (least, most) = if a < b { (a, b) } else { (b, a) };
                let least = if c < least { c } else { least };
                let most = if c > most { c } else { most };
                let sum = a + b + c;
                low[lane] = if sum.is_nan() { sum } else { least };
                high[lane] = if sum.is_nan() { sum } else { most };
            }
        }
    }

    /// Grows to some points, where that is asked for. Where one is not a number, both ends are not.
    #[inline(always)]
    fn grow(&mut self, points: &[[f32; LANES]; 2], wanted: &[u8; LANES]) {
        for (axis, points) in points.iter().enumerate() {
            let (low, high) = (&mut self.low[axis], &mut self.high[axis]);
            for lane in 0..LANES {
                let (x, wanted) = (points[lane], wanted[lane] == 1);
                let lower = wanted & ((x < low[lane]) | x.is_nan());
                let higher = wanted & ((x > high[lane]) | x.is_nan());
                low[lane] = if lower { x } else { low[lane] };
                high[lane] = if higher { x } else { high[lane] };
            }
        }
    }

    /// Lanes that a texel's centre may lie in or near.
    #[inline(always)]
    fn around_centres(&self) -> u64 {
        let mut around = [0; LANES];
        for (lane, around) in around.iter_mut().enumerate() {
            // Written so that NaN is.
            let u = between_lines(self.low[0][lane], self.high[0][lane]);
            let v = between_lines(self.low[1][lane], self.high[1][lane]);
            *around = 1 - (self.within[lane] & (u8::from(u) | u8::from(v)));
        }
        pack_bits(&around)
    }

    /// The lowest and the highest point.
    #[inline(always)]
    fn rectangle(&self, lane: usize) -> [Point; 2] {
        [&self.low, &self.high].map(|corner| [corner[0][lane], corner[1][lane]])
    }
}

/// Twice the area of a triangle, positive if its corners go round as the first axis turns to the second.
#[inline(always)]
fn turn(a: Point, b: Point, c: Point) -> f32 {
    (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
}

/// How far from an edge a texel's centre is uncertain, as far as along the columns that a contour crosses, times the
/// edge's length.
#[inline(always)]
fn reach(a: Point, b: Point) -> f32 {
    CLEARANCE * ((b[0] - a[0]).abs() + (b[1] - a[1]).abs())
}
