//! Where contours cross the links between neighbouring texels of different class, to far
//! below a texel.

use pulp::{Simd, WithSimd};

use super::batch::{Batch, CLEARANCE, Filling, LANES, Lines, whole};
use super::layers::{Layers, Point, between_lines, for_pieces};
use super::loose::{Bundle, SMALL};
use crate::simd;
use crate::visibility::{Bitmap, Crossings, ones, pack_bits};

/// How many texels a short segment or a small triangle reaches from its middle to the first texel of a link that
/// it crosses, at most: one to either side, and a link begins before it.
const MARGIN: usize = 2;

/// Finds the crossings that `visible` shows of the contours in `layers`, and of the edges of triangles drawn there, which
/// are some of those in `bundles`.
pub(super) fn locate(
    layers: &Layers,
    bundles: &[Bundle],
    visible: &Bitmap,
    crossings: &mut Crossings,
) {
    let n = layers.resolution();
    let positions = &mut crossings.positions;
    positions.resize(2 * n * n, f32::NAN);
    let mut near = Near::new(n);
    let mut any = false;
    visible.for_links(n, |x, y, below| {
        any = true;
        near.mark(x, y);
        let texel = y * n + x;
        let first = if visible.get(texel) { -1.0 } else { 1.0 };
        positions[usize::from(below) * n * n + texel] = f32::NAN.copysign(first);
    });
    if !any {
        return;
    }
    simd::arch().dispatch(Locate {
        layers,
        bundles,
        near: &near,
        links: Links { n, positions },
    });
}

/// The vectorised part of [`locate`].
struct Locate<'a> {
    layers: &'a Layers,
    bundles: &'a [Bundle],
    near: &'a Near,
    links: Links<'a>,
}

impl WithSimd for Locate<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let Self {
            layers,
            bundles,
            near,
            mut links,
        } = self;
        let mut chosen = Vec::new();
        let mut filling = Filling::new(&mut chosen);
        for batch in layers.segments() {
            for lane in ones(near.to(batch)) {
                filling.append(batch.lane(lane), 0);
            }
        }
        let half = layers.resolution() as f32 * 0.5;
        for drawn in (layers.drawn().iter()).filter(|drawn| near.to_small(drawn.middle)) {
            if let Some([a, b, c]) = drawn.flat {
                // Edges that pass between all lines of texel centres cross no link.
                for [from, to] in [[a, b], [b, c], [c, a]] {
                    let u = between_lines(from[0], to[0]);
                    let v = between_lines(from[1], to[1]);
                    if !(u && v) {
                        filling.append([from, to], 0);
                    }
                }
                continue;
            }
            let triangle = bundles[drawn.bundle as usize].triangle(drawn.lane as usize);
            let [a, b, c] = triangle.map(|corner| corner - layers.eye);
            for (from, to) in [(a, b), (b, c), (c, a)] {
                for_pieces(from, to, half, |from, to| {
                    filling.append([from, to], 0);
                });
            }
        }
        filling.finish();
        for batch in &chosen {
            links.cross(batch);
        }
    }
}

/// Texels near to links between texels of different class: most contours are short and pass
/// far from all of them.
struct Near {
    stride: usize,
    /// 1 for those, 0 for others; with a margin on all sides.
    texels: Vec<u8>,
}

impl Near {
    fn new(n: usize) -> Self {
        let stride = n + 2 * MARGIN;
        Self {
            stride,
            texels: vec![0; stride * stride],
        }
    }

    /// Marks the texels around the first of a link.
    #[inline(always)]
    fn mark(&mut self, x: usize, y: usize) {
        for row in y..=y + 2 * MARGIN {
            self.texels[row * self.stride + x..][..=2 * MARGIN]
                .copy_from_slice(&[1; 2 * MARGIN + 1]);
        }
    }

    /// Lanes of long segments and of those whose middle is near.
    #[inline(always)]
    fn to(&self, batch: &Batch<2>) -> u64 {
        let [a, b] = &batch.ends;
        let (mut texels, mut wanted) = ([0; LANES], [0; LANES]);
        for lane in 0..LANES {
            // Coordinates are above −1.
            let middle = |axis: usize| 0.5 * (a[axis][lane] + b[axis][lane]) + MARGIN as f32;
            texels[lane] = whole(middle(1).floor() * self.stride as f32 + middle(0).floor());
            let long = |axis: usize| (a[axis][lane] - b[axis][lane]).abs() >= SMALL;
            wanted[lane] = u8::from(long(0)) | u8::from(long(1));
        }
        for lane in 0..LANES {
            let near = self.texels.get(texels[lane] as usize);
            wanted[lane] |= near.copied().unwrap_or(0);
        }
        pack_bits(&wanted) & batch.lanes()
    }

    /// Whether the middle of a small triangle is near.
    #[inline(always)]
    fn to_small(&self, middle: Point) -> bool {
        // Coordinates are above −1.
        let [x, y] = middle.map(|x| (x + MARGIN as f32) as usize);
        self.texels[y * self.stride + x] == 1
    }
}

struct Links<'a> {
    n: usize,
    positions: &'a mut [f32],
}

impl Links<'_> {
    #[inline(always)]
    fn cross(&mut self, segments: &Batch<2>) {
        for axis in [0, 1] {
            let mut lines = Lines::new(segments, axis, self.n);
            for _ in 0..lines.most {
                self.cross_lines(axis, &lines);
                lines.advance();
            }
        }
    }

    /// Adds crossings of columns if `axis` is 0, else of rows.
    #[inline(always)]
    fn cross_lines(&mut self, axis: usize, lines: &Lines) {
        let n = self.n as f32;
        let (along, across) = if axis == 0 { (n, 1.0) } else { (1.0, n) };
        let at = lines.at();
        let (mut texels, mut positions) = ([0; LANES], [0.0; LANES]);
        let (mut within, mut also_next) = ([0; LANES], [0; LANES]);
        for lane in 0..LANES {
            let start = (at[lane] - CLEARANCE).floor();
            let next = (at[lane] + CLEARANCE).floor();
            texels[lane] = whole(start.max(0.0) * along + lines.line[lane] * across);
            positions[lane] = at[lane] - start;
            within[lane] = u8::from(start >= 0.0) & u8::from(start < n - 1.0);
            also_next[lane] = u8::from(start != next) & u8::from(next < n - 1.0);
        }
        let crossing = lines.crossing();
        for lane in ones(crossing & pack_bits(&within)) {
            self.add(axis, texels[lane] as usize, positions[lane].min(1.0));
        }
        // Right at a texel's centre it belongs to the links on both sides.
        for lane in ones(crossing & pack_bits(&also_next)) {
            let start = at[lane].round();
            let texel = start * along + lines.line[lane] * across;
            self.add(axis, texel as usize, (at[lane] - start).max(0.0));
        }
    }

    /// Adds a crossing of the link from a texel to the one below if `axis` is 0, else to its
    /// right. Of a link's crossings the one next to its visible end counts: there the first
    /// layer begins. That is the greatest, because positions on links whose first texel is the visible one are
    /// kept with their sign changed. On links between texels of one class nobody asks for it.
    #[inline(always)]
    fn add(&mut self, axis: usize, texel: usize, position: f32) {
        let below = if axis == 0 { self.n * self.n } else { 0 };
        let nearest = &mut self.positions[below + texel];
        let position = position.copysign(*nearest);
        // Nothing is greater than what is no number, where none was found yet.
        *nearest = if *nearest > position {
            *nearest
        } else {
            position
        };
    }
}
