//! Where contours cross the links between neighbouring texels of different class, to far
//! below a texel.

use pulp::{Arch, Simd, WithSimd};

use super::layers::{CLEARANCE, Point};
use crate::ssdf::Crossings;
use crate::visibility::Bitmap;

/// How many texels a short segment reaches from its middle to the first texel of a link that
/// it crosses, at most: one to either side, and a link begins before it.
const MARGIN: usize = 2;

/// Segments that are chosen from together; at most 256, a power of two.
const CHUNK: usize = 128;
/// Segments that are looked at side by side.
const LANES: usize = 16;

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
    let mut near = Near::new(n);
    visible.for_links(n, |x, y, below| {
        near.mark(x, y);
        positions[usize::from(below) * n * n + y * n + x] = f32::NAN;
    });
    Arch::new().dispatch(Locate {
        segments,
        near: &near,
        links: Links {
            n,
            visible,
            positions,
        },
    });
}

/// The vectorised part of [`locate`].
struct Locate<'a> {
    segments: &'a [[Point; 2]],
    near: &'a Near,
    links: Links<'a>,
}

impl WithSimd for Locate<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let Self {
            segments,
            near,
            mut links,
        } = self;
        let mut found = [0; CHUNK];
        for segments in segments.chunks(CHUNK) {
            // Collected without a branch, which would often be guessed wrong.
            let mut count = 0;
            for (index, [a, b]) in segments.iter().enumerate() {
                let reach = (a[0] - b[0]).abs().max((a[1] - b[1]).abs());
                let middle = [0.5 * (a[0] + b[0]), 0.5 * (a[1] + b[1])];
                found[count % CHUNK] = index as u8;
                count += usize::from((reach >= 2.0) | near.at(middle));
            }
            for found in found[..count].chunks(LANES) {
                let mut lanes = [[[0.0; LANES]; 2]; 2];
                for (lane, index) in found.iter().enumerate() {
                    let [a, b] = segments[usize::from(*index)];
                    (lanes[0][0][lane], lanes[0][1][lane]) = (a[0], a[1]);
                    (lanes[1][0][lane], lanes[1][1][lane]) = (b[0], b[1]);
                }
                for axis in [0, 1] {
                    let lines = Lines::new(&lanes, axis, links.n);
                    for lane in 0..found.len() {
                        for line in lines.first[lane]..lines.past[lane] {
                            links.cross(axis, line as usize, lines.at(lane, line));
                        }
                    }
                }
            }
        }
    }
}

/// Where segments side by side cross the lines of texel centres: columns or rows.
struct Lines {
    first: [i32; LANES],
    past: [i32; LANES],
    /// An end's coordinates, across the lines and along them.
    end: [[f32; LANES]; 2],
    slope: [f32; LANES],
    /// Bounds along the lines.
    low: [f32; LANES],
    high: [f32; LANES],
}

impl Lines {
    #[inline(always)]
    fn new(ends: &[[[f32; LANES]; 2]; 2], axis: usize, n: usize) -> Self {
        let mut lines = Self {
            first: [0; LANES],
            past: [0; LANES],
            end: [[0.0; LANES]; 2],
            slope: [0.0; LANES],
            low: [0.0; LANES],
            high: [0.0; LANES],
        };
        let [[a, other_a], [b, other_b]] = [0, 1].map(|end| [ends[end][axis], ends[end][1 - axis]]);
        for lane in 0..LANES {
            let (a, other_a) = (a[lane], other_a[lane]);
            let (b, other_b) = (b[lane], other_b[lane]);
            let swap = a > b;
            let (p, other_p) = if swap { (b, other_b) } else { (a, other_a) };
            let (q, other_q) = if swap { (a, other_a) } else { (b, other_b) };
            let first = (p - CLEARANCE).ceil() as i32;
            let past = (q + CLEARANCE + 1.0) as i32;
            let length = q - p;
            let slope = (other_q - other_p) / if length > 1e-12 { length } else { 1e-12 };
            let (low, high) = if other_p < other_q {
                (other_p, other_q)
            } else {
                (other_q, other_p)
            };
            // What is not finite crosses nothing.
            let finite = (p + q + low + high).abs() < f32::INFINITY;
            lines.first[lane] = if first > 0 { first } else { 0 };
            lines.past[lane] = if !finite {
                0
            } else if past < n as i32 {
                past
            } else {
                n as i32
            };
            (lines.end[0][lane], lines.end[1][lane]) = (p, other_p);
            lines.slope[lane] = slope;
            lines.low[lane] = low;
            lines.high[lane] = high;
        }
        lines
    }

    #[inline(always)]
    fn at(&self, lane: usize, line: i32) -> f32 {
        let across = line as f32 - self.end[0][lane];
        let at = self.end[1][lane] + across * self.slope[lane];
        at.clamp(self.low[lane], self.high[lane])
    }
}

/// Texels near to links between texels of different class: most contours are short and pass
/// far from all of them.
struct Near {
    stride: usize,
    /// With a margin on all sides.
    texels: Vec<bool>,
}

impl Near {
    fn new(n: usize) -> Self {
        let stride = n + 2 * MARGIN;
        Self {
            stride,
            texels: vec![false; stride * stride],
        }
    }

    /// Marks the texels around the first of a link.
    #[inline(always)]
    fn mark(&mut self, x: usize, y: usize) {
        for row in y..=y + 2 * MARGIN {
            self.texels[row * self.stride + x..][..=2 * MARGIN]
                .copy_from_slice(&[true; 2 * MARGIN + 1]);
        }
    }

    #[inline(always)]
    fn at(&self, [x, y]: Point) -> bool {
        // Coordinates are above −1, and casts round towards zero.
        let [x, y] = [x, y].map(|x| (x + MARGIN as f32) as i32 as usize);
        self.texels
            .get(y * self.stride + x)
            .is_some_and(|near| *near)
    }
}

struct Links<'a> {
    n: usize,
    visible: &'a Bitmap,
    positions: &'a mut [f32],
}

impl Links<'_> {
    /// A contour crosses a line of texel centres: column `line` if `axis` is 0, else row
    /// `line`. Of a link's crossings the one next to its visible end counts: there the first
    /// layer begins.
    #[inline(always)]
    fn cross(&mut self, axis: usize, line: usize, at: f32) {
        // Right at a texel's centre it belongs to the links on both sides. Coordinates are
        // above −1, and casts round towards zero.
        let low = (at + 1.0 - CLEARANCE) as i32 as usize;
        let high = (at + 1.0 + CLEARANCE) as i32 as usize;
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
