//! Which parts of a mesh are counted, front to back: what lies wholly behind others is left out.
//!
//! The parts that look largest are counted first. Texels that they block are blocked whatever
//! else there is. A part whose box covers none but such texels changes nothing that can be seen
//! and is never counted; of the others the largest are counted next, and so on.

use glam::Vec3;
use pulp::{Simd, WithSimd};

use super::batch::{LANES, whole};
use super::candidates::Candidates;
use crate::simd;
use crate::visibility::Bitmap;

/// Fewer contours are counted in one round: more rounds cost as much as they would save.
const FEW: usize = 3000;
/// The share of all contours that the first round counts; each further one counts twice as many
/// as the one before.
const FIRST_SHARE: usize = 8;
/// Texels that are added around a part's box, far more than rounding.
const MARGIN: f32 = 0.01;

/// How far the counting for one point has come.
#[derive(Default)]
pub(super) struct Rounds {
    /// Parts that are not counted, by their places in the group's order.
    waiting: Vec<u32>,
    /// Per part, whether it is counted.
    counted: Vec<bool>,
    /// Contours that are counted.
    contours: usize,
    budget: usize,
    open: Open,
}

impl Rounds {
    /// `at_once`: all parts in one round.
    pub(super) fn begin(&mut self, candidates: &Candidates, at_once: bool) {
        let parts = candidates.parts_in_order();
        self.open.rows.clear();
        self.counted.clear();
        self.counted.resize(parts.len(), false);
        self.waiting.clear();
        self.waiting.extend(0..parts.len() as u32);
        self.contours = 0;
        self.budget = if at_once {
            usize::MAX
        } else {
            candidates.expected() / FIRST_SHARE
        };
    }

    /// Counts all that waits in the next round.
    pub(super) fn leave_none(&mut self) {
        self.budget = usize::MAX;
    }

    /// Chooses what is counted next: places of parts in the group's order, which grow.
    pub(super) fn choose(&mut self, candidates: &Candidates, chosen: &mut Vec<u32>) {
        chosen.clear();
        let left: usize = (self.waiting.iter())
            .map(|&place| candidates.contours_of(place))
            .sum();
        let limit = if left <= self.budget.max(FEW) {
            usize::MAX
        } else {
            self.budget
        };
        let mut contours = 0;
        let mut taken = 0;
        while taken < self.waiting.len() && contours < limit {
            contours += candidates.contours_of(self.waiting[taken]);
            taken += 1;
        }
        self.contours += contours;
        chosen.extend(self.waiting.drain(..taken));
        for &place in chosen.iter() {
            self.counted[candidates.parts_in_order()[place as usize] as usize] = true;
        }
        self.budget = self.budget.saturating_mul(2);
    }

    /// What is visible with what was counted in the rounds before, if any.
    pub(super) fn open(&self) -> Option<&Open> {
        (!self.open.rows.is_empty()).then_some(&self.open)
    }

    /// Contours that are counted so far, lanes left free among them.
    pub(super) fn contours(&self) -> usize {
        self.contours
    }

    /// Whether a part is counted.
    pub(super) fn is_counted(&self, part: u32) -> bool {
        self.counted[part as usize]
    }

    pub(super) fn is_over(&self) -> bool {
        self.waiting.is_empty()
    }

    /// Leaves out the parts that lie behind what is counted: `open` has the `n` × `n` texels
    /// that it leaves visible.
    pub(super) fn cull(&mut self, candidates: &Candidates, eye: Vec3, open: &Bitmap, n: usize) {
        if self.waiting.is_empty() {
            return;
        }
        self.open.fill(open, n);
        simd::arch().dispatch(Cull {
            waiting: &mut self.waiting,
            candidates,
            eye,
            open: &self.open,
        });
    }
}

/// The bits from one on, and those up to one.
static FROM: [u128; 128] = {
    let mut bits = [0; 128];
    let mut first = 0;
    while first < 128 {
        bits[first] = u128::MAX << first;
        first += 1;
    }
    bits
};
static UP_TO: [u128; 128] = {
    let mut bits = [0; 128];
    let mut last = 0;
    while last < 128 {
        bits[last] = u128::MAX >> (127 - last);
        last += 1;
    }
    bits
};

/// A whole number, put between 0 and `last`. What is not a number is 0, so that it begins before everything.
#[inline(always)]
fn first_within(x: f32, last: f32) -> u32 {
    let x = if x > 0.0 { x } else { 0.0 };
    whole(if x < last { x } else { last })
}

/// The same, but that what is not a number is `last`.
#[inline(always)]
fn last_within(x: f32, last: f32) -> u32 {
    let x = if x < last { x } else { last };
    whole(if x > 0.0 { x } else { 0.0 })
}

/// The visible texels of a map, for asking whether a rectangle has some.
#[derive(Default)]
pub(super) struct Open {
    n: usize,
    /// Columns that share a bit.
    columns: usize,
    /// Bits of every row, then those of every two rows that follow each other, every four, and
    /// so on, by the first of them.
    rows: Vec<u128>,
}

impl Open {
    fn fill(&mut self, bitmap: &Bitmap, n: usize) {
        self.n = n;
        self.columns = n.div_ceil(128);
        self.rows.clear();
        for y in 0..n {
            self.rows.push(if self.columns == 1 {
                let [low, high] = [0, 64].map(|x| {
                    let own = n.saturating_sub(x).min(64) as u32;
                    let mask = u64::MAX.checked_shr(64 - own).unwrap_or(0);
                    bitmap.bits(y * n + x) & mask
                });
                u128::from(low) | u128::from(high) << 64
            } else {
                let visible = (0..n).filter(|x| bitmap.get(y * n + x));
                visible.fold(0, |row, x| row | 1 << (x / self.columns))
            });
        }
        let mut height = 1;
        while 2 * height <= n {
            let start = self.rows.len() - n;
            for y in 0..n {
                let other = (y + height).min(n - 1);
                self.rows
                    .push(self.rows[start + y] | self.rows[start + other]);
            }
            height *= 2;
        }
    }

    /// Whether some texel of a rectangle, given by its lowest and highest texels, is visible.
    #[inline(always)]
    fn any(&self, low: [f32; 2], high: [f32; 2]) -> bool {
        let last = self.n as f32 - 1.0;
        let [left, top] = [first_within(low[0], last), first_within(low[1], last)];
        let [right, bottom] = [last_within(high[0], last), last_within(high[1], last)];
        self.any_of([left, top], [right, bottom])
    }

    /// [`Self::any`] of texels that are all on the map.
    #[inline(always)]
    fn any_of(&self, [left, top]: [u32; 2], [right, bottom]: [u32; 2]) -> bool {
        let [left, right] = [left, right].map(|x| (x as usize / self.columns) & 127);
        let level = (bottom + 1).saturating_sub(top).max(1).ilog2();
        let rows = &self.rows[level as usize * self.n..][..self.n];
        let bits = rows[top as usize] | rows[bottom as usize + 1 - (1 << level)];
        bits & FROM[left] & UP_TO[right] != 0
    }

    /// Whether a texel may be visible.
    #[inline(always)]
    pub(super) fn may_be(&self, x: usize, y: usize) -> bool {
        self.rows[y] >> (x / self.columns) & 1 == 1
    }

    /// Whether what lies between two points of the map, in texels, may have to do with a visible texel.
    #[inline(always)]
    pub(super) fn any_between(&self, low: [f32; 2], high: [f32; 2]) -> bool {
        self.any(
            low.map(|x| (x - MARGIN).floor()),
            high.map(|x| (x + MARGIN).ceil()),
        )
    }

    /// Whether a part within a box, relative to the eye, may have to do with a visible texel.
    #[inline(always)]
    pub(super) fn any_in(&self, low: Vec3, high: Vec3) -> bool {
        let half = self.n as f32 * 0.5;
        // The distances from the coordinate plane on both of its sides.
        let sides = |axis: usize| {
            let (low, high) = (low[axis], high[axis]);
            [
                ([low.max(0.0), high], 1.0),
                ([(-high).max(0.0), -low], -1.0),
            ]
        };
        for (x, x_sign) in sides(0).into_iter().filter(|([_, far], _)| *far >= 0.0) {
            for (z, z_sign) in sides(2).into_iter().filter(|([_, far], _)| *far >= 0.0) {
                let [low, high] = rectangle(x, [low.y, high.y], z, [x_sign, z_sign], half);
                if self.any(low, high) {
                    return true;
                }
            }
        }
        false
    }
}

/// The lowest and the highest texel around where a box lies in the map, given by the least and the largest of `|x|`, `y`
/// and `|z|` in it, and the signs of its x and z: without these, coordinates that `octahedral::encode` gives grow
/// with their own axis, and fall with the other and with y, above and below the plane y = 0 alike.
#[inline(always)]
fn rectangle(x: [f32; 2], y: [f32; 2], z: [f32; 2], sign: [f32; 2], half: f32) -> [[f32; 2]; 2] {
    let share = |of: f32, y: f32, other: f32| {
        let above = y > 0.0;
        let share = if above { of } else { other } / (of + y.abs() + other);
        if above { share } else { 1.0 - share }
    };
    let u = [share(x[0], y[1], z[1]), share(x[1], y[0], z[0])];
    let v = [share(z[0], y[1], x[1]), share(z[1], y[0], x[0])];
    let texels = |[from, to]: [f32; 2], sign: f32| {
        let low = if sign > 0.0 { from } else { -to };
        let high = if sign > 0.0 { to } else { -from };
        let [low, high] = [half * low + (half - 0.5), half * high + (half - 0.5)];
        [(low - MARGIN).floor(), (high + MARGIN).ceil()]
    };
    let ([left, right], [top, bottom]) = (texels(u, sign[0]), texels(v, sign[1]));
    [[left, top], [right, bottom]]
}

/// Distances of an interval from zero, its sign, and 1 if it lies to one side.
#[inline(always)]
fn distances(low: f32, high: f32) -> ([f32; 2], f32, u8) {
    let negative = high < 0.0;
    let near = if negative { -high } else { low };
    let far = if negative { -low } else { high };
    let sign = if negative { -1.0 } else { 1.0 };
    ([near, far], sign, u8::from(low > 0.0) | u8::from(negative))
}

/// The vectorised part of [`Rounds::cull`].
struct Cull<'a> {
    waiting: &'a mut Vec<u32>,
    candidates: &'a Candidates,
    eye: Vec3,
    open: &'a Open,
}

impl WithSimd for Cull<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let Self {
            waiting,
            candidates,
            eye,
            open,
        } = self;
        let half = open.n as f32 * 0.5;
        let last = open.n as f32 - 1.0;
        let boxes = candidates.boxes();
        let mut left = 0;
        for first in (0..waiting.len()).step_by(LANES) {
            let count = LANES.min(waiting.len() - first);
            let mut corners = [[[0.0; LANES]; 3]; 2];
            for lane in 0..count {
                let [low, high] = boxes[waiting[first + lane] as usize];
                for axis in 0..3 {
                    corners[0][axis][lane] = low[axis] - eye[axis];
                    corners[1][axis][lane] = high[axis] - eye[axis];
                }
            }
            let ([x_low, y_low, z_low], [x_high, y_high, z_high]) = (&corners[0], &corners[1]);
            let (mut lows, mut highs) = ([[0; LANES]; 2], [[0; LANES]; 2]);
            let mut within = [0; LANES];
            for lane in 0..LANES {
                let (x, x_sign, one_x) = distances(x_low[lane], x_high[lane]);
                let (z, z_sign, one_z) = distances(z_low[lane], z_high[lane]);
                within[lane] = one_x & one_z;
                let y = [y_low[lane], y_high[lane]];
                let [low, high] = rectangle(x, y, z, [x_sign, z_sign], half);
                lows[0][lane] = first_within(low[0], last);
                lows[1][lane] = first_within(low[1], last);
                highs[0][lane] = last_within(high[0], last);
                highs[1][lane] = last_within(high[1], last);
            }
            for lane in 0..count {
                let stays = if within[lane] == 1 {
                    open.any_of(
                        [lows[0][lane], lows[1][lane]],
                        [highs[0][lane], highs[1][lane]],
                    )
                } else {
                    let [low, high] =
                        corners.map(|corner| Vec3::from(corner.map(|axis| axis[lane])));
                    open.any_in(low, high)
                };
                waiting[left] = waiting[first + lane];
                left += usize::from(stays);
            }
        }
        waiting.truncate(left);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::visibility::tests::random;
    use relight_shading::octahedral;

    #[test]
    fn rectangles_are_asked_about_as_texel_by_texel() {
        let mut state = 5;
        for n in [2, 16, 25, 64, 100, 128, 200, 256] {
            let bitmap = Bitmap::from_fn(n * n, |_| random(&mut state) < 0.002);
            let mut open = Open::default();
            open.fill(&bitmap, n);
            for _ in 0..500 {
                let mut at = || random(&mut state) * (n as f32 + 4.0) - 2.0;
                let (a, b) = ([at(), at()], [at(), at()]);
                let low = [0, 1].map(|i| f32::min(a[i], b[i]).floor());
                let high = [0, 1].map(|i| f32::max(a[i], b[i]).ceil());
                let texel = |x: f32| x.clamp(0.0, n as f32 - 1.0) as usize;
                // With more columns than bits, those that share a bit count as one.
                let shared = n.div_ceil(128);
                let columns = texel(low[0]) / shared * shared
                    ..((texel(high[0]) / shared + 1) * shared).min(n);
                let any = (texel(low[1])..=texel(high[1]))
                    .any(|y| columns.clone().any(|x| bitmap.get(y * n + x)));
                assert_eq!(open.any(low, high), any, "{n}: {low:?} to {high:?}");
            }
            assert!(
                bitmap == Bitmap::from_fn(n * n, |_| false)
                    || open.any([f32::NAN; 2], [f32::NAN; 2])
            );
        }
    }

    #[test]
    fn boxes_cover_all_directions_to_what_is_in_them() {
        let mut state = 9;
        let n = 64;
        for _ in 0..400 {
            let mut at = || Vec3::from([0; 3].map(|_| 2.0 * random(&mut state) - 1.0));
            let (centre, size) = (at(), 0.7 * at().abs());
            let (low, high) = (centre - size, centre + size);
            for _ in 0..20 {
                let point = low + at().abs() * (high - low);
                let texel = octahedral::encode(point.normalize()) * n as f32 - 0.5;
                let mut open = Open::default();
                let [x, y] = texel
                    .round()
                    .to_array()
                    .map(|x| x.clamp(0.0, n as f32 - 1.0));
                let seen = y as usize * n + x as usize;
                open.fill(&Bitmap::from_fn(n * n, |index| index == seen), n);
                assert!(open.any_in(low, high), "{low} to {high}, {point}");
            }
        }
    }
}
