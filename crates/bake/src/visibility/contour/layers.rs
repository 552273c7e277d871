//! Surface layers over an octahedral map, counted from the contours that bound them.
//!
//! In each octant the octahedral map is a central projection, so a contour edge maps to
//! straight segments in the square. Coordinates are in texels: texel (x, y) has its centre
//! at (x, y) and the square spans −½ to n − ½. Steps are summed where segments cross the
//! vertical lines through texel centres, and the line through the centres of row 0, which
//! joins the columns. Beyond the border column x continues as column n − 1 − x, so the sums
//! along both must meet.

use glam::Vec3;
use pulp::{Simd, WithSimd};

use super::batch::{Batch, CLEARANCE, Filling, LANES, Lines, whole};
use super::loose::{self, Bundle, Drawn};
use super::rounds::Open;
use crate::simd::{self, vectorised};
use crate::visibility::{Bitmap, ones, pack_bits};

/// In texels.
pub(super) type Point = [f32; 2];

/// Sums of steps, and the layers that they lead to.
pub(super) struct Layers {
    n: usize,
    /// The point that contours are seen from.
    pub(super) eye: Vec3,
    /// Steps between rows j − 1 and j of every column, n + 1 rows of n. The outer two are
    /// halves of links over the border. Behind them is one for every lane without a step.
    steps: Vec<i32>,
    /// Steps between columns j − 1 and j along row 0.
    first_row: Vec<i32>,
    /// Layers of surface at every texel, up to a constant.
    totals: Vec<i32>,
    /// Texels that need a ray of their own.
    uncertain: Bitmap,
    /// Those of them that have had it, and of these the visible ones.
    traced: Bitmap,
    seen: Bitmap,
    /// Contours in texels, cut at the borders of octants, but for those that pass between all
    /// lines of texel centres.
    segments: Vec<Batch<2>>,
    /// Triangles that were drawn, and texels that they cover; some may be named twice.
    pub(super) drawn: Vec<Drawn>,
    pub(super) covered: Vec<u32>,
    /// Whether some contour could not be projected.
    broken: bool,
}

impl Layers {
    pub(super) fn new(n: usize) -> Self {
        Self {
            n,
            eye: Vec3::ZERO,
            steps: vec![0; n * (n + 1) + LANES],
            first_row: vec![0; n + 1],
            totals: vec![0; n * n],
            uncertain: Bitmap::from_fn(n * n, |_| false),
            traced: Bitmap::from_fn(n * n, |_| false),
            seen: Bitmap::from_fn(n * n, |_| false),
            segments: Vec::new(),
            drawn: Vec::new(),
            covered: Vec::new(),
            broken: false,
        }
    }

    /// Texels per side.
    pub(super) fn resolution(&self) -> usize {
        self.n
    }

    /// All contours, in texels.
    pub(super) fn segments(&self) -> &[Batch<2>] {
        &self.segments
    }

    /// All triangles that were drawn.
    pub(super) fn drawn(&self) -> &[Drawn] {
        &self.drawn
    }

    /// Forgets all contours: others are seen from `eye`.
    pub(super) fn begin(&mut self, eye: Vec3) {
        self.eye = eye;
        self.steps.fill(0);
        self.first_row.fill(0);
        self.uncertain.clear();
        self.traced.clear();
        self.seen.clear();
        self.segments.clear();
        self.drawn.clear();
        self.covered.clear();
        self.broken = false;
    }

    /// Adds the steps of contours.
    pub(super) fn count<'a>(&mut self, contours: impl Iterator<Item = &'a [Batch<3>]>) {
        simd::arch().dispatch(Count {
            layers: self,
            contours,
        });
    }

    /// Adds loose triangles, given with the number of each bundle and with what tells which way each of it faces. Those
    /// that lie behind others, where no texel is `open`, are left out. `directions` are those of all texels.
    pub(super) fn count_loose<'a, F: Fn(usize) -> i8>(
        &mut self,
        directions: &[Vec3],
        bundles: impl Iterator<Item = (usize, &'a Bundle, F)>,
        open: Option<&Open>,
    ) {
        simd::arch().dispatch(loose::Count {
            layers: self,
            directions,
            bundles,
            open,
        });
    }

    /// What is visible with the contours so far; nothing if they tell nothing. `rays` counts up.
    /// `clear` casts a ray at a texel against the parts that are counted. `visible` casts one
    /// against everything: it is asked for texels that contours tell nothing of, except for
    /// those that `before`, what was visible with fewer contours, shows blocked.
    pub(super) fn resolve(
        &mut self,
        before: Option<&Bitmap>,
        rays: &mut u32,
        clear: impl FnOnce(usize) -> bool,
        visible: impl Fn(usize) -> bool,
    ) -> Option<Bitmap> {
        let layers = &mut *self;
        let fewest = vectorised!(<'a> layers: &'a mut Layers = layers => Option<i32> {
            layers.fewest()
        })?;
        let mut bitmap = None;
        if fewest < i32::MAX {
            let representative = self.totals.iter().position(|&layers| layers == fewest);
            *rays += 1;
            if representative.is_some_and(clear) {
                bitmap = Some(vectorised!(
                    <'a> totals: &'a [i32] = &self.totals, fewest: i32 = fewest
                    => Bitmap { Bitmap::equal(totals, fewest) }
                ));
            }
        }
        let mut bitmap = bitmap.unwrap_or_else(|| Bitmap::from_fn(self.n * self.n, |_| false));
        for texel in self.uncertain.set_texels() {
            if !self.traced.get(texel) {
                self.traced.set(texel, true);
                let blocked = before.is_some_and(|before| !before.get(texel));
                *rays += u32::from(!blocked);
                self.seen.set(texel, !blocked && visible(texel));
            }
        }
        bitmap.replace(&self.uncertain, &self.seen);
        Some(bitmap)
    }

    /// The fewest layers at texels that are not covered and need no ray of their own, `i32::MAX` where none is left;
    /// nothing if contours tell nothing. Those others have as many.
    #[inline(always)]
    fn fewest(&mut self) -> Option<i32> {
        if self.broken || !self.sum() {
            return None;
        }
        for texel in self.uncertain.set_texels() {
            self.totals[texel] = i32::MAX;
        }
        for &texel in &self.covered {
            self.totals[texel as usize] = i32::MAX;
        }
        Some(self.totals.iter().copied().fold(i32::MAX, i32::min))
    }

    /// Prefix sums of the steps. Columns whose sums do not meet beyond the border become
    /// uncertain: row 0 has a contour through the centre of such a column's texel on its wrong side.
    /// False if neighbours of them do not meet beyond the upper border either: then row 0 misses a step.
    #[inline(always)]
    fn sum(&mut self) -> bool {
        let n = self.n;
        let mut along = 0;
        for (layers, step) in self.totals[..n].iter_mut().zip(&self.first_row) {
            along += step;
            *layers = along;
        }
        for y in 1..n {
            let (above, row) = self.totals[(y - 1) * n..][..2 * n].split_at_mut(n);
            let steps = &self.steps[y * n..][..n];
            for ((layers, above), step) in row.iter_mut().zip(above).zip(steps) {
                *layers = *above + step;
            }
        }
        let (top, bottom) = (&self.totals[..n], &self.totals[(n - 1) * n..]);
        let (over, under) = (&self.steps[..n], &self.steps[n * n..][..n]);
        let mut before = true;
        for x in 0..n / 2 {
            let other = n - 1 - x;
            let meet_above = top[x] - over[x] == top[other] - over[other];
            let meet_below = bottom[x] + under[x] == bottom[other] + under[other];
            if !(before || meet_above) {
                return false;
            }
            before = meet_above;
            if !(meet_above && meet_below) {
                for texel in (0..n).flat_map(|y| [y * n + x, y * n + other]) {
                    self.uncertain.set(texel, true);
                }
            }
        }
        true
    }

    /// Adds the steps of those of all segments that come from a batch on.
    #[inline(always)]
    pub(super) fn add_from(&mut self, first: usize, segments: Vec<Batch<2>>) {
        for batch in &segments[first..] {
            self.add(batch);
        }
        self.segments = segments;
    }

    /// All segments, to append some, and the batch from which on that is done: what was added before stays as it is.
    #[inline(always)]
    pub(super) fn take_segments(&mut self) -> (usize, Vec<Batch<2>>) {
        let segments = std::mem::take(&mut self.segments);
        (segments.len(), segments)
    }

    /// Adds segments' steps.
    #[inline(always)]
    fn add(&mut self, segments: &Batch<2>) {
        let mut columns = Lines::new(segments, 0, self.n);
        // Some edge ends at the eye.
        self.broken |= columns.finite != segments.lanes();
        for _ in 0..columns.most {
            self.add_at(&columns);
            columns.advance();
        }
        // Few come near the first row.
        let mut near = 0;
        for end in &segments.ends {
            for y in end[1] {
                near |= u32::from(y <= CLEARANCE);
            }
        }
        if near == 0 {
            return;
        }
        let first_row = Lines::new(segments, 1, 1);
        let at = first_row.at();
        for lane in ones(first_row.separating()) {
            // Layers to the left of growing y are those of smaller x.
            self.first_row[first_from(at[lane]).min(self.n)] -= first_row.steps[lane];
        }
    }

    /// Adds the steps of segments at the columns that they are at.
    #[inline(always)]
    fn add_at(&mut self, columns: &Lines) {
        let n = self.n as f32;
        let at = columns.at();
        let (mut links, mut steps) = ([0; LANES], [0; LANES]);
        let mut close = 0;
        for lane in 0..LANES {
            let line = columns.line[lane];
            let link = if at[lane] > 0.0 { at[lane].ceil() } else { 0.0 };
            let (before, reach) = (link - at[lane], reach(columns.slope[lane]));
            close |= u32::from(line < columns.past[lane])
                & (u32::from(before <= reach) | u32::from(1.0 - before <= reach));
            let separates = columns.separates(lane);
            let unused = n * (n + 1.0) + lane as f32;
            links[lane] = whole(if separates { link * n + line } else { unused });
            steps[lane] = if separates { columns.steps[lane] } else { 0 };
        }
        if close != 0 {
            self.doubt(columns, &at);
        }
        // All, as asking which ones takes longer.
        for lane in 0..LANES {
            self.steps[links[lane] as usize] += steps[lane];
        }
    }

    /// Makes texels uncertain whose centres segments pass near, at the columns that they are at.
    #[inline(always)]
    fn doubt(&mut self, columns: &Lines, at: &[f32; LANES]) {
        for lane in ones(columns.crossing()) {
            let (at, reach) = (at[lane], reach(columns.slope[lane]));
            let low = columns.low[lane] - CLEARANCE;
            let high = columns.high[lane] + CLEARANCE;
            // One past the last row within reach.
            let past = ((at + reach).min(high) + 1.0) as usize;
            for row in first_from((at - reach).max(low))..past.min(self.n) {
                let texel = row * self.n + columns.line[lane] as usize;
                self.uncertain.set(texel, true);
            }
        }
    }
}

/// How far along a column a texel centre may be from where a segment of this slope crosses
/// it, to be uncertain.
#[inline(always)]
fn reach(slope: f32) -> f32 {
    CLEARANCE + CLEARANCE * slope.abs()
}

/// Calls back with the straight segments that an edge, relative to the eye, maps to: one
/// per octant.
#[inline(always)]
pub(super) fn for_pieces(from: Vec3, to: Vec3, half: f32, mut call: impl FnMut(Point, Point)) {
    let signs = |p: Vec3| [p.x < 0.0, p.y < 0.0, p.z < 0.0];
    if signs(from) == signs(to) {
        call(project_own(from, half), project_own(to, half));
        return;
    }
    // Cut at the coordinate planes.
    let mut cuts = [1.0; 3];
    for (axis, cut) in cuts.iter_mut().enumerate() {
        let (a, b) = (from[axis], to[axis]);
        if (a < 0.0) != (b < 0.0) {
            *cut = a / (a - b);
        }
    }
    let (mut start, mut done) = (from, 0.0);
    while done < 1.0 {
        let (mut end, mut cut) = (to, 1.0);
        for axis in 0..3 {
            if done < cuts[axis] && cuts[axis] < cut {
                cut = cuts[axis];
                end = from.lerp(to, cut);
                // Exactly on the plane, so that the pieces on both sides meet.
                end[axis] = 0.0;
            }
        }
        let middle = start + end;
        let sign = Vec3::ONE.copysign(middle);
        call(
            project(start * sign, sign, half),
            project(end * sign, sign, half),
        );
        (start, done) = (end, cut);
    }
}

/// Projects a point of the octant that it lies in.
#[inline(always)]
fn project_own(p: Vec3, half: f32) -> Point {
    let sign = |x: f32| if x < 0.0 { -1.0 } else { 1.0 };
    project(p.abs(), Vec3::new(sign(p.x), sign(p.y), sign(p.z)), half)
}

/// Projects a point, given by its coordinates in an octant, to the square: `octahedral::encode` in texels, but
/// that the arithmetic depends on the point and the octant alone, so that edges that share a vertex meet exactly.
#[inline(always)]
fn project(p: Vec3, sign: Vec3, half: f32) -> Point {
    let (px, py, pz) = (max_zero(p.x), max_zero(p.y), max_zero(p.z));
    let inverse = 1.0 / (px + py + pz);
    let (mut x, mut z) = (px * inverse, pz * inverse);
    // On the equator x + z = 1, exactly: both hemispheres give the same point there.
    let equator = (x + 2.0) - 2.0;
    if py == 0.0 {
        x = equator;
        z = 1.0 - equator;
    }
    let (u, v) = if sign.y > 0.0 {
        (x, z)
    } else {
        (1.0 - z, 1.0 - x)
    };
    [
        half * (u * sign.x) + (half - 0.5),
        half * (v * sign.z) + (half - 0.5),
    ]
}

/// The first index that is not below `x`. Without SSE4.1, `ceil` is a call.
#[inline(always)]
pub(super) fn first_from(x: f32) -> usize {
    let x = if x > 0.0 { x } else { 0.0 };
    let index = x as u32;
    (index + u32::from((index as f32) < x)) as usize
}

/// Keeps NaN, unlike `f32::max`.
#[inline(always)]
fn max_zero(x: f32) -> f32 {
    if x < 0.0 { 0.0 } else { x }
}

/// The vectorised part of [`Layers::count`]: most edges lie between two lines of texel
/// centres and change nothing.
struct Count<'a, I> {
    layers: &'a mut Layers,
    contours: I,
}

impl<'a, I: Iterator<Item = &'a [Batch<3>]>> WithSimd for Count<'_, I> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let Self { layers, contours } = self;
        let eye = layers.eye;
        let half = layers.n as f32 * 0.5;
        let (first, mut segments) = layers.take_segments();
        let mut filling = Filling::new(&mut segments);
        for batches in contours {
            for batch in batches {
                let [from, to] = &batch.ends;
                let (from, to) = (Points::new(from, eye, half), Points::new(to, eye, half));
                for lane in ones(cross_lines(&from, &to) & batch.lanes()) {
                    append(&mut filling, &from, &to, lane, batch.steps[lane], half);
                }
            }
        }
        filling.finish();
        layers.add_from(first, segments);
    }
}

/// The bit of octants below the equator.
pub(super) const BELOW: u8 = 1 << 1;

/// Points side by side, projected.
pub(super) struct Points {
    /// Relative to the eye.
    coordinates: [[f32; LANES]; 3],
    /// In texels.
    pub(super) texels: [[f32; LANES]; 2],
    pub(super) octants: [u8; LANES],
}

impl Points {
    #[inline(always)]
    pub(super) fn new(points: &[[f32; LANES]; 3], eye: Vec3, half: f32) -> Self {
        let mut projected = Self {
            coordinates: [[0.0; LANES]; 3],
            texels: [[0.0; LANES]; 2],
            octants: [0; LANES],
        };
        let [xs, ys, zs] = &mut projected.coordinates;
        let [us, vs] = &mut projected.texels;
        for lane in 0..LANES {
            let x = points[0][lane] - eye.x;
            let y = points[1][lane] - eye.y;
            let z = points[2][lane] - eye.z;
            (xs[lane], ys[lane], zs[lane]) = (x, y, z);
            projected.octants[lane] =
                u8::from(x < 0.0) | (u8::from(y < 0.0) * BELOW) | u8::from(z < 0.0) << 2;
            let sign = |x: f32| if x < 0.0 { -1.0 } else { 1.0 };
            let absolute = Vec3::new(x.abs(), y.abs(), z.abs());
            [us[lane], vs[lane]] = project(absolute, Vec3::new(sign(x), sign(y), sign(z)), half);
        }
        projected
    }

    /// Where the equator is above or below them, in texels.
    #[inline(always)]
    pub(super) fn on_equator(&self, half: f32) -> [[f32; LANES]; 2] {
        let mut texels = [[0.0; LANES]; 2];
        let [xs, _, zs] = &self.coordinates;
        for lane in 0..LANES {
            let size = half / (xs[lane].abs() + zs[lane].abs());
            texels[0][lane] = size * xs[lane] + (half - 0.5);
            texels[1][lane] = size * zs[lane] + (half - 0.5);
        }
        texels
    }

    /// Relative to the eye.
    #[inline(always)]
    pub(super) fn coordinates(&self, lane: usize) -> Vec3 {
        // Not by `map`, which would copy all lanes.
        let [x, y, z] = &self.coordinates;
        Vec3::new(x[lane], y[lane], z[lane])
    }

    #[inline(always)]
    pub(super) fn texel(&self, lane: usize) -> Point {
        let [u, v] = &self.texels;
        [u[lane], v[lane]]
    }
}

/// Adds an edge's segments: one if it lies within one octant.
#[inline(always)]
pub(super) fn append(
    segments: &mut Filling<2>,
    from: &Points,
    to: &Points,
    lane: usize,
    step: i32,
    half: f32,
) {
    let mut add = |a, b| segments.append([a, b], step);
    if from.octants[lane] == to.octants[lane] {
        add(from.texel(lane), to.texel(lane));
    } else {
        for_pieces(from.coordinates(lane), to.coordinates(lane), half, add);
    }
}

/// Lanes of edges that come near a line of texel centres.
#[inline(always)]
fn cross_lines(from: &Points, to: &Points) -> u64 {
    let mut crossing = [0; LANES];
    for (lane, crossing) in crossing.iter_mut().enumerate() {
        *crossing = crosses_lines(from, to, lane);
    }
    pack_bits(&crossing)
}

/// 1 if one of these edges comes near a line of texel centres, else 0.
#[inline(always)]
pub(super) fn crosses_lines(from: &Points, to: &Points, lane: usize) -> u8 {
    let ([u0, v0], [u1, v1]) = (&from.texels, &to.texels);
    // Written so that NaN crosses, and without a branch.
    let u = u8::from(between_lines(u0[lane], u1[lane]));
    let v = u8::from(between_lines(v0[lane], v1[lane]));
    let within = u8::from(from.octants[lane] == to.octants[lane]);
    1 - (u & v & within)
}

/// Whether no texel centre's coordinate comes near to those between two.
#[inline(always)]
pub(super) fn between_lines(a: f32, b: f32) -> bool {
    let (low, high) = if a < b { (a, b) } else { (b, a) };
    (low - CLEARANCE).floor() == (high + CLEARANCE).floor()
}
