//! Contours side by side, and where they cross the lines of texel centres.

use crate::visibility::pack_bits;

/// Contours that are looked at side by side.
pub(super) const LANES: usize = 16;
/// Distance from a segment within which a texel centre is uncertain, in texels: several
/// times the rounding of projected segments and of the texels' directions.
pub(super) const CLEARANCE: f32 = 2.5e-4;

/// Contours side by side, structure of arrays: in space, or projected to the map.
#[derive(Clone, Copy)]
pub(super) struct Batch<const AXES: usize> {
    /// Coordinates of both ends.
    pub(super) ends: [[[f32; LANES]; AXES]; 2],
    pub(super) steps: [i32; LANES],
    /// Lanes in use.
    pub(super) count: usize,
}

impl<const AXES: usize> Batch<AXES> {
    pub(super) const EMPTY: Self = Self {
        ends: [[[0.0; LANES]; AXES]; 2],
        steps: [0; LANES],
        count: 0,
    };

    #[inline(always)]
    pub(super) fn set(&mut self, lane: usize, ends: [[f32; AXES]; 2], step: i32) {
        for (all, end) in self.ends.iter_mut().zip(ends) {
            for (axis, coordinate) in all.iter_mut().zip(end) {
                axis[lane] = coordinate;
            }
        }
        self.steps[lane] = step;
    }

    /// Lanes in use.
    #[inline(always)]
    pub(super) fn lanes(&self) -> u64 {
        (1 << self.count) - 1
    }

    /// Coordinates of the ends of one contour.
    #[inline(always)]
    pub(super) fn lane(&self, lane: usize) -> [[f32; AXES]; 2] {
        let mut ends = [[0.0; AXES]; 2];
        for (end, all) in ends.iter_mut().zip(&self.ends) {
            for (coordinate, axis) in end.iter_mut().zip(all) {
                *coordinate = axis[lane];
            }
        }
        ends
    }
}

/// Puts contours into batches. The one that is being filled is at hand, and joins the others once it is full or [`Self::finish`]
/// is called.
pub(super) struct Filling<'a, const AXES: usize> {
    batches: &'a mut Vec<Batch<AXES>>,
    last: Batch<AXES>,
}

impl<'a, const AXES: usize> Filling<'a, AXES> {
    /// Behind those that are there, whether they are full or not.
    #[inline(always)]
    pub(super) fn new(batches: &'a mut Vec<Batch<AXES>>) -> Self {
        let last = Batch::EMPTY;
        Self { batches, last }
    }

    #[inline(always)]
    pub(super) fn append(&mut self, ends: [[f32; AXES]; 2], step: i32) {
        self.last.set(self.last.count % LANES, ends, step);
        self.last.count += 1;
        if self.last.count == LANES {
            self.flush();
        }
    }

    #[cold]
    fn flush(&mut self) {
        self.batches.push(self.last);
        // What its lanes hold is overwritten, or not in use.
        self.last.count = 0;
    }

    /// Adds what is left.
    #[inline(always)]
    pub(super) fn finish(self) {
        if self.last.count > 0 {
            self.batches.push(self.last);
        }
    }
}

/// A whole number from 0 to below 2²³; of others, any. Casts, which saturate, do not vectorise.
#[inline(always)]
pub(super) fn whole(x: f32) -> u32 {
    const ONES: f32 = (1 << 23) as f32;
    (x + ONES).to_bits().wrapping_sub(ONES.to_bits())
}

/// Where segments side by side cross the lines of texel centres: columns or rows. All go
/// from line to line at once. A segment begins where its coordinate across the lines is
/// least.
pub(super) struct Lines {
    /// The most lines that one of them comes near to.
    pub(super) most: u32,
    /// Lanes of segments with finite ends.
    pub(super) finite: u64,
    /// The line that a segment is at, and one past its last.
    pub(super) line: [f32; LANES],
    pub(super) past: [f32; LANES],
    /// Coordinates across the lines.
    from: [f32; LANES],
    to: [f32; LANES],
    /// Where a segment begins, along the lines.
    start: [f32; LANES],
    pub(super) slope: [f32; LANES],
    /// Bounds along the lines.
    pub(super) low: [f32; LANES],
    pub(super) high: [f32; LANES],
    /// Layers to the side of growing coordinates along the lines, less those to the other, for
    /// columns; its opposite for rows.
    pub(super) steps: [i32; LANES],
}

impl Lines {
    /// Of the first `count` lines across `axis`.
    #[inline(always)]
    pub(super) fn new(batch: &Batch<2>, axis: usize, count: usize) -> Self {
        let mut lines = Self {
            most: 0,
            finite: 0,
            line: [0.0; LANES],
            past: [0.0; LANES],
            from: [0.0; LANES],
            to: [0.0; LANES],
            start: [0.0; LANES],
            slope: [0.0; LANES],
            low: [0.0; LANES],
            high: [0.0; LANES],
            steps: [0; LANES],
        };
        let count = count as f32;
        let (mut finite, mut most) = ([0; LANES], 0);
        let ends = batch.ends.each_ref();
        let [[a, other_a], [b, other_b]] = ends.map(|end| [&end[axis], &end[1 - axis]]);
        for lane in 0..LANES {
            let (a, other_a) = (a[lane], other_a[lane]);
            let (b, other_b) = (b[lane], other_b[lane]);
            let swap = a > b;
            let (p, other_p) = if swap { (b, other_b) } else { (a, other_a) };
            let (q, other_q) = if swap { (a, other_a) } else { (b, other_b) };
            let length = q - p;
            let slope = (other_q - other_p) / if length > 1e-12 { length } else { 1e-12 };
            let (low, high) = if other_p < other_q {
                (other_p, other_q)
            } else {
                (other_q, other_p)
            };
            let is_finite = (p + q + low + high).abs() < f32::INFINITY;
            let used = lane < batch.count;
            let first = (p - CLEARANCE).ceil();
            let first = if first > 0.0 { first } else { 0.0 };
            let past = (q + CLEARANCE).floor() + 1.0;
            let past = if past < count { past } else { count };
            let crosses = u32::from(is_finite) & u32::from(used) & u32::from(first < past);
            let past = if crosses == 1 { past } else { first };
            most = most.max(whole(past - first));
            finite[lane] = u8::from(is_finite);
            (lines.line[lane], lines.past[lane]) = (first, past);
            (lines.from[lane], lines.to[lane]) = (p, q);
            lines.start[lane] = other_p;
            lines.slope[lane] = slope;
            (lines.low[lane], lines.high[lane]) = (low, high);
            let step = batch.steps[lane];
            lines.steps[lane] = if swap { -step } else { step };
        }
        lines.finite = pack_bits(&finite) & batch.lanes();
        lines.most = most;
        lines
    }

    /// Lanes that come near to the line that they are at.
    #[inline(always)]
    pub(super) fn crossing(&self) -> u64 {
        let mut crossing = [0; LANES];
        for (lane, crossing) in crossing.iter_mut().enumerate() {
            *crossing = u8::from(self.line[lane] < self.past[lane]);
        }
        pack_bits(&crossing)
    }

    /// Takes every segment to its next line.
    #[inline(always)]
    pub(super) fn advance(&mut self) {
        self.line.iter_mut().for_each(|line| *line += 1.0);
    }

    /// Where segments cross their lines.
    #[inline(always)]
    pub(super) fn at(&self) -> [f32; LANES] {
        let mut result = [0.0; LANES];
        for (lane, result) in result.iter_mut().enumerate() {
            let across = self.line[lane] - self.from[lane];
            let at = self.start[lane] + across * self.slope[lane];
            let at = if at < self.low[lane] {
                self.low[lane]
            } else {
                at
            };
            let at = if at > self.high[lane] {
                self.high[lane]
            } else {
                at
            };
            *result = at;
        }
        result
    }

    /// Whether the line passes between a segment's ends, not only near one.
    #[inline(always)]
    pub(super) fn separates(&self, lane: usize) -> bool {
        let line = self.line[lane];
        let is_near = u32::from(line < self.past[lane]);
        is_near & u32::from(self.from[lane] <= line) & u32::from(line < self.to[lane]) == 1
    }

    /// Lanes of which that is so.
    #[inline(always)]
    pub(super) fn separating(&self) -> u64 {
        let mut separating = [0; LANES];
        for (lane, separating) in separating.iter_mut().enumerate() {
            *separating = u8::from(self.separates(lane));
        }
        pack_bits(&separating)
    }
}
