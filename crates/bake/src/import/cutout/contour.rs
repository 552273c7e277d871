//! The lines along which a texture's alpha crosses a threshold: marching squares (Lorensen & Cline
//! 1987, in two dimensions), simplified (Douglas & Peucker 1973).
//!
//! Coordinates are texels, as in [`format`](relight_format): the middle of the first is (½, ½).

use glam::DVec2;

/// What lies beyond the edge of a texture.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(in crate::import) enum Wrap {
    /// The texture again.
    #[default]
    Repeat,
    /// The texture again, every other time turned about.
    Mirror,
    /// Its outermost texels.
    Clamp,
}

/// One axis of a mask.
#[derive(Clone, Copy)]
struct Axis {
    /// Texels.
    size: usize,
    /// Values until they repeat: a mirrored texture's are twice as many.
    count: usize,
    /// After how many texels it repeats; none if it goes on as it ends.
    period: Option<f64>,
}

/// Crossings keep this far from texels, so that no two are one.
const LEAST_STEP: f64 = 1e-3;
/// How far the contours of a clamped axis go on, texels.
const FAR: f64 = 1e9;
/// Most crossings of contours with lines between texels, which bounds memory.
const MAX_CROSSINGS: usize = 1 << 22;
/// Most points of a line that are simplified at once, which bounds the time.
const RUN: usize = 1024;
/// How often the sides of a simplified line are moved so that it encloses what it should.
const WIDENED: usize = 3;
/// Texels per side of the squares that contours are found by.
const BUCKET: f64 = 16.0;
/// Most such squares per axis.
const MAX_BUCKETS: usize = 512;

/// Number of a line between neighbouring texels that a contour crosses, and its period.
type Crossing = (usize, [i32; 2]);

/// Where a texture is kept (at least 0) and where it is cut away, bilinear between texels.
pub(in crate::import) struct Mask {
    axes: [Axis; 2],
    values: Vec<f32>,
}

impl Mask {
    /// A mask of `size` texels, of which `value` tells how far above the threshold they are, and
    /// what lies beyond them.
    pub(super) fn new(size: [u32; 2], wrap: [Wrap; 2], value: impl Fn(u32, u32) -> f32) -> Self {
        let axes = [0, 1].map(|axis| {
            let size = size[axis] as usize;
            let (count, repeats) = match wrap[axis] {
                Wrap::Repeat => (size, true),
                Wrap::Mirror => (2 * size, true),
                Wrap::Clamp => (size, false),
            };
            let period = repeats.then_some(count as f64);
            Axis {
                size,
                count,
                period,
            }
        });
        let rows = (0..size[1]).flat_map(|y| (0..size[0]).map(move |x| (x, y)));
        let values = rows.map(|(x, y)| value(x, y)).collect();
        Self { axes, values }
    }

    /// Whether every texel is kept, or none.
    pub(super) fn uniform(&self) -> Option<bool> {
        let kept = self.values.iter().filter(|value| **value >= 0.0).count();
        match kept {
            0 => Some(false),
            all if all == self.values.len() => Some(true),
            _ => None,
        }
    }

    fn value(&self, column: usize, row: usize) -> f32 {
        let [x, y] = [(column, 0), (row, 1)].map(|(index, axis)| {
            let size = self.axes[axis].size;
            if index < size {
                index
            } else {
                2 * size - 1 - index
            }
        });
        self.values[y * self.axes[0].size + x]
    }

    /// How far above the threshold a point is.
    pub(super) fn at(&self, point: DVec2) -> f64 {
        let cell = [0, 1].map(|axis| {
            let Axis { count, period, .. } = self.axes[axis];
            let x = match period {
                Some(period) => point[axis].rem_euclid(period) - 0.5,
                None => point[axis].clamp(0.5, count as f64 - 0.5) - 0.5,
            };
            let low = x.floor();
            let other = |index: i64| match period {
                Some(_) => index.rem_euclid(count as i64) as usize,
                None => index.clamp(0, count as i64 - 1) as usize,
            };
            (other(low as i64), other(low as i64 + 1), x - low)
        });
        let [(x0, x1, s), (y0, y1, t)] = cell;
        let row = |y| {
            let [a, b] = [x0, x1].map(|x| f64::from(self.value(x, y)));
            a + (b - a) * s
        };
        let [a, b] = [y0, y1].map(row);
        a + (b - a) * t
    }

    /// Nodes along an axis: one per value and, where it is clamped, one far off at either end.
    fn nodes(&self, axis: usize) -> usize {
        let Axis { count, period, .. } = self.axes[axis];
        if period.is_some() { count } else { count + 2 }
    }

    /// Place of a node along an axis, and the index of its value.
    fn node(&self, axis: usize, node: usize) -> (f64, usize) {
        let Axis { count, period, .. } = self.axes[axis];
        if period.is_some() {
            return (node as f64 + 0.5, node);
        }
        match node {
            0 => (-FAR, 0),
            node if node > count => (FAR, count - 1),
            node => (node as f64 - 0.5, node - 1),
        }
    }

    /// Directed pairs of crossings, what is kept on the left where y points up. A crossing lies on
    /// the edge from a node to the next one along x (even numbers) or y (odd ones), and in one of
    /// the periods. `None` if there are too many.
    fn crossings(&self) -> Option<Vec<[Crossing; 2]>> {
        let [columns, rows] = [0, 1].map(|axis| self.nodes(axis));
        let cells = |axis: usize, nodes: usize| {
            if self.axes[axis].period.is_some() {
                nodes
            } else {
                nodes - 1
            }
        };
        let mut found = Vec::new();
        for row in 0..cells(1, rows) {
            for column in 0..cells(0, columns) {
                let (right, below) = ((column + 1) % columns, (row + 1) % rows);
                let corners = [(column, row), (right, row), (right, below), (column, below)];
                let values = corners.map(|(x, y)| self.value(self.node(0, x).1, self.node(1, y).1));
                let kept = values.map(|value| value >= 0.0);
                if kept == [kept[0]; 4] {
                    continue;
                }
                let wraps = [i32::from(right < column), i32::from(below < row)];
                let edges = [
                    (2 * (row * columns + column), [0, 0]),
                    (2 * (row * columns + right) + 1, [wraps[0], 0]),
                    (2 * (below * columns + column), [0, wraps[1]]),
                    (2 * (row * columns + column) + 1, [0, 0]),
                ];
                let leaves = |edge: usize| kept[edge] && !kept[(edge + 1) % 4];
                let enters = |edge: usize| !kept[edge] && kept[(edge + 1) % 4];
                // Where two corners are kept that face each other, the sign of the bilinear
                // surface at its saddle tells whether they are joined (Nielson & Hamann 1991).
                let [a, b, c, d] = values;
                let joined = (a * c > b * d) == kept[0];
                for from in (0..4).filter(|&edge| leaves(edge)) {
                    let turn = |steps: usize| (from + steps) % 4;
                    let order = if joined { [1, 2, 3] } else { [3, 2, 1] };
                    let to = order.into_iter().map(turn).find(|&edge| enters(edge));
                    if let Some(to) = to {
                        found.push([edges[from], edges[to]]);
                    }
                }
                if found.len() > MAX_CROSSINGS {
                    return None;
                }
            }
        }
        Some(found)
    }

    /// Where a crossing lies, in the first period.
    fn place(&self, crossing: usize) -> DVec2 {
        let [columns, rows] = [0, 1].map(|axis| self.nodes(axis));
        let (column, row) = (crossing / 2 % columns, crossing / 2 / columns);
        let [(x, i), (y, j)] = [self.node(0, column), self.node(1, row)];
        let along = |axis: usize, node: usize, nodes: usize| {
            let (next, index) = self.node(axis, (node + 1) % nodes);
            let next = if node + 1 == nodes {
                next + self.axes[axis].period.unwrap_or_default()
            } else {
                next
            };
            (next, index)
        };
        let step = |from: f32, to: f32| {
            let [from, to] = [from, to].map(f64::from);
            (from / (from - to)).clamp(LEAST_STEP, 1.0 - LEAST_STEP)
        };
        if crossing.is_multiple_of(2) {
            let (next, k) = along(0, column, columns);
            DVec2::new(x + (next - x) * step(self.value(i, j), self.value(k, j)), y)
        } else {
            let (next, k) = along(1, row, rows);
            DVec2::new(x, y + (next - y) * step(self.value(i, j), self.value(i, k)))
        }
    }

    fn period(&self, tile: [i32; 2]) -> DVec2 {
        let shift = |axis: usize| {
            let period: Option<f64> = self.axes[axis].period;
            period.map_or(0.0, |period| f64::from(tile[axis]) * period)
        };
        DVec2::new(shift(0), shift(1))
    }

    /// The contours, with every point at which they cross a line between texels. `None` if there are too many.
    pub(super) fn lines(&self) -> Option<Vec<Line>> {
        let mut pairs = self.crossings()?;
        pairs.sort_unstable_by_key(|[(from, _), _]| *from);
        let mut entered: Vec<usize> = pairs.iter().map(|[_, (to, _)]| *to).collect();
        entered.sort_unstable();
        let mut done = vec![false; pairs.len()];
        let mut lines = Vec::new();
        let begins = |at: &usize| entered.binary_search(&pairs[*at][0].0).is_err();
        let (open, closed): (Vec<usize>, Vec<usize>) = (0..pairs.len()).partition(begins);
        for start in open.into_iter().chain(closed) {
            if std::mem::replace(&mut done[start], true) {
                continue;
            }
            let [(first, first_tile), mut end] = pairs[start];
            let mut points = vec![self.place(first) + self.period(first_tile)];
            let mut tile = [0, 0];
            let closed = loop {
                let (to, to_tile) = end;
                let arrived = [tile[0] + to_tile[0], tile[1] + to_tile[1]];
                if to == first {
                    break Some([arrived[0] - first_tile[0], arrived[1] - first_tile[1]]);
                }
                points.push(self.place(to) + self.period(arrived));
                let Ok(next) = pairs.binary_search_by_key(&to, |[(from, _), _]| *from) else {
                    break None;
                };
                done[next] = true;
                let [(_, from_tile), after] = pairs[next];
                tile = [arrived[0] - from_tile[0], arrived[1] - from_tile[1]];
                end = after;
            };
            lines.push(Line { points, closed });
        }
        Some(lines)
    }

    /// Lines that are off by at most `tolerance` texels, but for their enclosed areas, which
    /// are kept; those that enclose less than its square are left out.
    pub(super) fn contours(&self, lines: &[Line], tolerance: f64) -> Contours<'_> {
        let mut contours = Contours::new(self);
        for line in lines {
            contours.add(line, tolerance);
        }
        contours
    }
}

/// A contour.
pub(super) struct Line {
    points: Vec<DVec2>,
    /// After how many periods it ends where it began, if it does.
    closed: Option<[i32; 2]>,
}

impl Line {
    fn is_island(&self) -> bool {
        self.closed == Some([0, 0])
    }
}

/// A piece of a contour, between two points of [`Contours::point`], the second of which lies in a
/// tile relative to the first's.
#[derive(Clone, Copy, Debug)]
pub(in crate::import) struct Piece {
    pub ends: [u32; 2],
    pub step: [i32; 2],
}

/// Contours of a mask, to be found by place.
pub(in crate::import) struct Contours<'a> {
    mask: &'a Mask,
    points: Vec<DVec2>,
    pub pieces: Vec<Piece>,
    /// What lines enclose, in texels, those about holes too, and how much more or less that is than it should be.
    pub(super) enclosed: f64,
    pub(super) lost: f64,
    /// Squares per axis.
    counts: [usize; 2],
    /// Pieces of every square, with the tile that they are to be moved by.
    buckets: Vec<Vec<(u32, [i32; 2])>>,
}

impl<'a> Contours<'a> {
    fn new(mask: &'a Mask) -> Self {
        let counts = [0, 1].map(|axis| {
            let count = (mask.axes[axis].count as f64 / BUCKET).ceil() as usize;
            count.clamp(1, MAX_BUCKETS)
        });
        Self {
            mask,
            points: Vec::new(),
            pieces: Vec::new(),
            enclosed: 0.0,
            lost: 0.0,
            counts,
            buckets: vec![Vec::new(); counts[0] * counts[1]],
        }
    }

    /// A point, in a tile.
    pub(super) fn point(&self, point: u32, tile: [i32; 2]) -> DVec2 {
        self.points[point as usize] + self.mask.period(tile)
    }

    /// How many tiles to move a point by to bring it near the first one.
    pub(super) fn tile(&self, point: DVec2) -> [i32; 2] {
        [0, 1].map(|axis| {
            let period: Option<f64> = self.mask.axes[axis].period;
            period.map_or(0, |period| (point[axis] / period).floor() as i32)
        })
    }

    /// A point as it is in another tile.
    pub(super) fn moved(&self, point: DVec2, tile: [i32; 2]) -> DVec2 {
        point + self.mask.period(tile)
    }

    /// Squares that a range touches: how many before the first, and one past the last.
    fn range(&self, axis: usize, low: f64, high: f64) -> [i64; 2] {
        let Axis { count, period, .. } = self.mask.axes[axis];
        let size = count as f64 / self.counts[axis] as f64;
        [low, high].map(|x| {
            let index = (x / size).floor();
            let last = self.counts[axis] as f64 - 1.0;
            let index = if period.is_some() {
                index
            } else {
                index.clamp(0.0, last)
            };
            index as i64
        })
    }

    /// Calls back with the squares of a box and the tiles they lie in.
    fn squares(&self, low: DVec2, high: DVec2, mut visit: impl FnMut(usize, [i32; 2])) {
        let [columns, rows] = [0, 1].map(|axis| self.range(axis, low[axis], high[axis]));
        let [x, y] = self.counts.map(|count| count as i64);
        for row in rows[0]..=rows[1] {
            for column in columns[0]..=columns[1] {
                let square = row.rem_euclid(y) * x + column.rem_euclid(x);
                let tile = [column.div_euclid(x) as i32, row.div_euclid(y) as i32];
                visit(square as usize, tile);
            }
        }
    }

    /// How many squares a box touches.
    pub(super) fn count(&self, low: DVec2, high: DVec2) -> f64 {
        let [x, y] = [0, 1].map(|axis| self.range(axis, low[axis], high[axis]));
        ((x[1] - x[0]) as f64 + 1.0) * ((y[1] - y[0]) as f64 + 1.0)
    }

    /// Pieces that may touch a box, each with its tile, once each and in order; `None` if more
    /// than about `most`.
    pub(super) fn near(
        &self,
        low: DVec2,
        high: DVec2,
        most: usize,
    ) -> Option<Vec<(u32, [i32; 2])>> {
        let mut found = Vec::new();
        self.squares(low, high, |square, [x, y]| {
            if found.len() <= most {
                let pieces = self.buckets[square].iter();
                found.extend(pieces.map(|(piece, tile)| (*piece, [tile[0] + x, tile[1] + y])));
            }
        });
        if found.len() > most {
            return None;
        }
        found.sort_unstable();
        found.dedup();
        Some(found)
    }

    /// Some points of a line; the last is not the first again where it is closed.
    fn simplified(&self, line: &Line, tolerance: f64) -> Vec<DVec2> {
        let Some(tile) = line.closed else {
            return simplified(&line.points, tolerance);
        };
        let mut round = line.points.clone();
        round.push(round[0] + self.mask.period(tile));
        let mut round = simplified(&round, tolerance);
        round.pop();
        round
    }

    /// Adds a line with fewer points.
    fn add(&mut self, line: &Line, tolerance: f64) {
        let island = line.is_island();
        let exact = area(&line.points);
        if island {
            self.enclosed += exact.abs();
        }
        let coarse = if island && exact.abs() < tolerance * tolerance {
            Vec::new()
        } else {
            self.simplified(line, tolerance)
        };
        if island && coarse.len() < 3 {
            self.lost += exact.abs();
            return;
        }
        let (mut line, closed) = (coarse, line.closed);
        if island {
            for _ in 0..WIDENED {
                let missing = exact - area(&line);
                widen(&mut line, missing);
            }
            self.lost += (exact - area(&line)).abs();
        }
        let base = self.points.len() as u32;
        let count = line.len() as u32;
        self.points.extend(line);
        let last = if closed.is_some() { count } else { count - 1 };
        for at in 0..last {
            let wraps = at + 1 == count;
            let piece = Piece {
                ends: [base + at, if wraps { base } else { base + at + 1 }],
                step: if wraps {
                    closed.unwrap_or_default()
                } else {
                    [0, 0]
                },
            };
            let index = self.pieces.len() as u32;
            self.pieces.push(piece);
            let [a, b] = [
                self.point(piece.ends[0], [0, 0]),
                self.point(piece.ends[1], piece.step),
            ];
            let mut squares = Vec::new();
            self.squares(a.min(b), a.max(b), |square, tile| {
                squares.push((square, tile));
            });
            for (square, [x, y]) in squares {
                self.buckets[square].push((index, [-x, -y]));
            }
        }
    }
}

/// What a closed line encloses.
fn area(line: &[DVec2]) -> f64 {
    let pairs = line.iter().zip(line.iter().cycle().skip(1));
    pairs
        .map(|(a, b)| (*a - line[0]).perp_dot(*b - line[0]))
        .sum::<f64>()
        * 0.5
}

/// Fewer points of a line, both ends among them, none of which was farther than `tolerance` from
/// what is left.
fn simplified(line: &[DVec2], tolerance: f64) -> Vec<DVec2> {
    let count = line.len();
    let mut kept = vec![false; count];
    // A closed line needs a third point, and a long one is taken piece by piece.
    let farthest = (0..count).max_by(|&a, &b| {
        let distance = |at: usize| line[at].distance_squared(line[0]);
        distance(a).total_cmp(&distance(b))
    });
    let mut anchors: Vec<usize> = (0..count).step_by(RUN).collect();
    anchors.extend(farthest);
    anchors.push(count - 1);
    anchors.sort_unstable();
    anchors.dedup();
    let mut stack: Vec<[usize; 2]> = anchors.windows(2).map(|pair| [pair[0], pair[1]]).collect();
    for anchor in anchors {
        kept[anchor] = true;
    }
    while let Some([first, last]) = stack.pop() {
        let (a, b) = (line[first], line[last]);
        let along = b - a;
        let distance = |at: usize| {
            let from = line[at] - a;
            let t = from.dot(along) / along.length_squared().max(f64::MIN_POSITIVE);
            from.distance_squared(along * t.clamp(0.0, 1.0))
        };
        let worst = (first + 1..last).max_by(|&a, &b| distance(a).total_cmp(&distance(b)));
        let Some(worst) = worst.filter(|&at| distance(at) > tolerance * tolerance) else {
            continue;
        };
        kept[worst] = true;
        stack.extend([[first, worst], [worst, last]]);
    }
    let mut kept = kept.into_iter();
    line.iter()
        .copied()
        .filter(|_| kept.next() == Some(true))
        .collect()
}

/// Moves the sides of a closed line outwards so that it encloses that much more, to first order.
fn widen(line: &mut [DVec2], area: f64) {
    let count = line.len();
    let side = |at: usize| line[(at + 1) % count] - line[at % count];
    let length: f64 = (0..count).map(|at| side(at).length()).sum();
    let by = area / length.max(f64::MIN_POSITIVE);
    let moved: Vec<DVec2> = (0..count)
        .map(|at| {
            let [before, after] = [side(at + count - 1), side(at)].map(DVec2::normalize_or_zero);
            // What is enclosed lies on the left. Sharp corners move at most twice as far.
            let outwards = -(before + after).perp();
            line[at] + outwards * (by / (1.0 + before.dot(after)).max(0.5))
        })
        .collect();
    line.copy_from_slice(&moved);
}

#[cfg(test)]
mod tests {
    use super::*;

    fn disc(size: u32, radius: f64, wrap: Wrap) -> Mask {
        let centre = f64::from(size) * 0.5;
        Mask::new([size, size], [wrap; 2], |x, y| {
            let point = DVec2::new(f64::from(x) + 0.5, f64::from(y) + 0.5);
            (radius - point.distance(DVec2::splat(centre))) as f32
        })
    }

    #[test]
    fn a_disc_becomes_one_loop_of_its_area() {
        for tolerance in [0.1, 0.5, 2.0] {
            let mask = disc(64, 20.0, Wrap::Repeat);
            let lines = mask.lines().expect("few");
            let contours = mask.contours(&lines, tolerance);
            let sum: f64 = (contours.pieces.iter())
                .map(|piece| {
                    let [a, b] = [
                        contours.point(piece.ends[0], [0, 0]),
                        contours.point(piece.ends[1], piece.step),
                    ];
                    a.perp_dot(b) * 0.5
                })
                .sum();
            let exact = std::f64::consts::PI * 400.0;
            assert!((sum / exact - 1.0).abs() < 0.01, "{tolerance}: {sum}");
            let pieces = contours.pieces.len();
            assert!(pieces < 60 && pieces > 5, "{tolerance}: {pieces}");
        }
    }

    #[test]
    fn stripes_go_on_over_the_edge() {
        // Two lines per period, neither of which encloses anything.
        let stripe = |_, y: u32| if (8..24).contains(&y) { 1.0 } else { -1.0 };
        let mask = Mask::new([32, 32], [Wrap::Repeat; 2], stripe);
        let lines = mask.lines().expect("few");
        let contours = mask.contours(&lines, 0.25);
        assert_eq!(
            contours.pieces.iter().filter(|p| p.step != [0, 0]).count(),
            2
        );
        // Clamped, they end far off.
        let mask = Mask::new([32, 32], [Wrap::Clamp; 2], stripe);
        let lines = mask.lines().expect("few");
        let contours = mask.contours(&lines, 0.25);
        let far = contours.points.iter().filter(|p| p.x.abs() > 1e8).count();
        assert_eq!(far, 4);
        let [low, high] = [DVec2::new(5000.0, 7.0), DVec2::new(5001.0, 9.0)];
        let near = contours.near(low, high, 100).expect("few");
        assert!(!near.is_empty());
    }

    #[test]
    fn samples_are_those_of_the_wrap() {
        let ramp = |wrap| Mask::new([4, 1], [wrap, Wrap::Repeat], |x, _| x as f32);
        let at = |wrap, x: f64| ramp(wrap).at(DVec2::new(x, 0.25));
        for (wrap, x, expected) in [
            (Wrap::Repeat, 0.5, 0.0),
            (Wrap::Repeat, 2.0, 1.5),
            (Wrap::Repeat, 0.0, 1.5),
            (Wrap::Repeat, 4.75, 0.25),
            (Wrap::Clamp, -7.0, 0.0),
            (Wrap::Clamp, 9.0, 3.0),
            (Wrap::Mirror, 4.5, 3.0),
            (Wrap::Mirror, 6.5, 1.0),
            (Wrap::Mirror, -0.5, 0.0),
        ] {
            let found = at(wrap, x);
            assert!((found - expected).abs() < 1e-9, "{wrap:?} {x}: {found}");
        }
    }
}
