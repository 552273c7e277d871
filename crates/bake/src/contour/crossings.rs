//! Where contours cross the links between neighbouring texels of different class, to far
//! below a texel.

use super::layers::{CLEARANCE, Point, first_from};
use crate::ssdf::Crossings;
use crate::visibility::Bitmap;

/// Texels per side of the cells by which contours far from the boundary are told.
const CELL: usize = 4;

/// Finds the crossings of contours, given in texels of a map of `n` to a side, that
/// `visible` shows.
pub(super) fn locate(
    segments: &[[Point; 2]],
    visible: &Bitmap,
    n: usize,
    crossings: &mut Crossings,
) {
    let positions = &mut crossings.positions;
    positions.resize(2 * n * n, f32::NAN);
    let per_side = n.div_ceil(CELL);
    let mut mixed = vec![false; per_side * per_side];
    visible.for_links(n, |x, y, below| {
        mixed[y / CELL * per_side + x / CELL] = true;
        positions[usize::from(below) * n * n + y * n + x] = f32::NAN;
    });
    let cells = Cells::near_to(&mixed, per_side);
    let mut links = Links {
        n,
        visible,
        positions,
    };
    for &[a, b] in segments {
        let reach = (a[0] - b[0]).abs().max((a[1] - b[1]).abs());
        if reach >= CELL as f32 || cells.near(a) {
            links.add_segment(a, b);
        }
    }
}

/// Cells that have texels of different class in them or beside them.
struct Cells {
    per_side: usize,
    near: Vec<bool>,
}

impl Cells {
    fn near_to(mixed: &[bool], per_side: usize) -> Self {
        let mut near = vec![false; per_side * per_side];
        for (i, _) in mixed.iter().enumerate().filter(|(_, mixed)| **mixed) {
            let (x, y) = (i % per_side, i / per_side);
            for y in y.saturating_sub(1)..(y + 2).min(per_side) {
                near[y * per_side + x.saturating_sub(1)..y * per_side + (x + 2).min(per_side)]
                    .fill(true);
            }
        }
        Self { per_side, near }
    }

    #[inline(always)]
    fn near(&self, [x, y]: Point) -> bool {
        // Casts saturate at zero.
        let cell = |x: f32| (x as usize / CELL).min(self.per_side - 1);
        self.near[cell(y) * self.per_side + cell(x)]
    }
}

struct Links<'a> {
    n: usize,
    visible: &'a Bitmap,
    positions: &'a mut [f32],
}

impl Links<'_> {
    #[inline(always)]
    fn add_segment(&mut self, a: Point, b: Point) {
        if !(a[0] + a[1] + b[0] + b[1]).is_finite() {
            return;
        }
        for axis in [0, 1] {
            let other = 1 - axis;
            let (p, q) = if a[axis] <= b[axis] { (a, b) } else { (b, a) };
            let first = first_from(p[axis] - CLEARANCE);
            let past = (q[axis] + CLEARANCE + 1.0).max(0.0) as usize;
            let slope = (q[other] - p[other]) / (q[axis] - p[axis]).max(1e-12);
            let (low, high) = (p[other].min(q[other]), p[other].max(q[other]));
            for line in first..past.min(self.n) {
                let at = (p[other] + (line as f32 - p[axis]) * slope).clamp(low, high);
                self.cross(axis, line, at);
            }
        }
    }

    /// A contour crosses a line of texel centres: column `line` if `axis` is 0, else row
    /// `line`. Of a link's crossings the one next to its visible end counts: there the first
    /// layer begins.
    #[inline(always)]
    fn cross(&mut self, axis: usize, line: usize, at: f32) {
        // Right at a texel's centre it belongs to the links on both sides. Coordinates are
        // above −1, and casts round towards zero.
        let low = (at + 1.0 - CLEARANCE) as usize;
        let high = (at + 1.0 + CLEARANCE) as usize;
        self.add(axis, line, low, at);
        if high != low {
            self.add(axis, line, high, at);
        }
    }

    /// Adds a crossing to the link before texel `past` of a line.
    #[inline(always)]
    fn add(&mut self, axis: usize, line: usize, past: usize, at: f32) {
        let n = self.n;
        if past == 0 || past >= n {
            return;
        }
        let start = past - 1;
        let (texel, next, index) = if axis == 0 {
            let texel = start * n + line;
            (texel, texel + n, n * n + texel)
        } else {
            let texel = line * n + start;
            (texel, texel + 1, texel)
        };
        let first = self.visible.get(texel);
        let differ = first != self.visible.get(next);
        let position = (at - start as f32).clamp(0.0, 1.0);
        let nearest = &mut self.positions[index];
        // Either takes the other operand where nothing was found yet. Whether texels differ
        // is as good as random: no branch depends on it.
        let (less, more) = (nearest.min(position), nearest.max(position));
        let changed = if first { less } else { more };
        *nearest = if differ { changed } else { *nearest };
    }
}
