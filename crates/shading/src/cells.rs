//! The integrator of Wang et al. (2013): cells of polar coordinates, each cut by a straight
//! piece of the visibility boundary, and lobes that are linear in a cell.
//!
//! In coordinates about a pole, ω = (cos φ sin θ, sin φ sin θ, cos θ), the boundary of a cell's
//! visible part is a polygon. Within the cell a lobe is α + β p·ω, so that its integral is
//! α A + β p·B, with A = ∫ n·ω dω and B = ∫ ω n·ω dω over the polygon: four moments that
//! all lobes share. A cell whose boundary or lobes are approximated too badly is divided.
//!
//! Where this differs from the paper:
//! - A and B are closed in θ, and by Gauss–Legendre in φ. Closed in both they are sums of
//!   large terms that cancel in small cells; this has no cancellation and no singular slope.
//! - α and β are fitted to nine samples; a secant overestimates grossly.
//! - Cells go depth first, pixel by pixel, and not in rounds through memory.
//! - About the axis of a lobe cells reach to 1 % of its peak, so that nothing need be made up
//!   for, and the horizon is a second signed distance.
//!
//! Longer than other files: one algorithm, whose steps make no sense apart.

use relight_format::math;
use std::f32::consts::PI;

use glam::{Vec2, Vec3};

use crate::polar::{any_orthogonal, support_radius};
use crate::shade::CellsOptions;
use crate::spherical_gaussian::SphericalGaussian;
use crate::ssdf::SignedDistance;

/// Lights sharper than this have cells about their own axis (Wang et al. 2013, §5.1).
pub const NARROW: f32 = 400.0;
/// Cells are divided in four at most this often.
pub const MAX_LEVEL: u32 = 5;
/// Added to a cell's radius before its centre's distance proves it free of boundaries,
/// radians: compressed distances may grow faster than angles.
pub const MARGIN: f32 = 0.01;
/// Widest piece of a polygon's edge in φ that one rule of four nodes integrates, radians.
pub const PANEL: f32 = 0.4;
/// Gauss–Legendre nodes on [−1, 1] and weights; those of the other sign are the same.
pub const NODES: [[f32; 2]; 2] = [[0.339_981_04, 0.652_145_15], [0.861_136_3, 0.347_854_85]];

/// ∫ n·ω dω and ∫ ω n·ω dω.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Moments {
    /// The paper's A.
    pub a: f32,
    /// The paper's B is its product with p.
    pub b: Vec3,
}

impl Moments {
    fn add(&mut self, other: &Self) {
        self.a += other.a;
        self.b += other.b;
    }
}

/// ∫ of sin², sin cos, sin³, sin² cos and sin cos² over `width` from `start`, in \[0, π\].
///
/// Differences are taken of angles, not of antiderivatives.
fn inner(start: f32, width: f32) -> [f32; 5] {
    let (s0, c0) = math::sin_cos(start);
    let (s1, c1) = math::sin_cos(start + width);
    let middle = math::sin(start + 0.5 * width);
    // c0 − c1 and s1 − s0.
    let falls = 2.0 * middle * math::sin(0.5 * width);
    let rises = falls * (c0 + c1) / (s0 + s1).max(f32::MIN_POSITIVE);
    let sine = math::sin(width);
    let square = width * width;
    let less_sine = if width.abs() < 0.5 {
        width * square / 6.0 * (1.0 - square / 20.0 * (1.0 - square / 42.0))
    } else {
        width - sine
    };
    [
        0.5 * less_sine + sine * middle * middle,
        0.5 * falls * (c0 + c1),
        // 1 − (c0² + c0 c1 + c1²)/3 in terms of sines.
        falls * (0.5 * (s0 * s0 + s1 * s1) + falls * falls / 6.0),
        rises * (s0 * s0 + s0 * s1 + s1 * s1) / 3.0,
        falls * (c0 * c0 + c0 * c1 + c1 * c1) / 3.0,
    ]
}

/// Moments of θ from `base` to the line from `from` to `to`, points (φ, θ); negative where φ
/// falls. The cosine is not clamped: `normal` is in the cells' frame.
pub fn strip(normal: Vec3, base: f32, from: Vec2, to: Vec2) -> Moments {
    let mut sum = Moments::default();
    let step = to - from;
    let panels = (step.x.abs() / PANEL).ceil();
    // Heights above the base keep the digits of thin strips.
    let from = Vec2::new(from.x, from.y - base);
    for panel in 0..panels as u32 {
        let middle = from + (panel as f32 + 0.5) / panels * step;
        let half = 0.5 / panels * step;
        for [node, weight] in NODES {
            for at in [middle - node * half, middle + node * half] {
                let (sine, cosine) = math::sin_cos(at.x);
                let across = normal.x * cosine + normal.y * sine;
                let [s2, sc, s3, s2c, sc2] = inner(base, at.y);
                let weight = weight * half.x;
                let aside = s3 * across + s2c * normal.z;
                sum.a += weight * (s2 * across + sc * normal.z);
                sum.b +=
                    weight * Vec3::new(cosine * aside, sine * aside, s2c * across + sc2 * normal.z);
            }
        }
    }
    sum
}

/// Coordinates about a pole.
#[derive(Clone, Copy)]
struct Coordinates {
    x: Vec3,
    y: Vec3,
    z: Vec3,
}

impl Coordinates {
    fn about(z: Vec3) -> Self {
        let x = any_orthogonal(z);
        Self {
            x,
            y: z.cross(x),
            z,
        }
    }

    fn to_local(self, v: Vec3) -> Vec3 {
        Vec3::new(v.dot(self.x), v.dot(self.y), v.dot(self.z))
    }

    fn to_world(self, v: Vec3) -> Vec3 {
        v.x * self.x + v.y * self.y + v.z * self.z
    }
}

/// The unit vector of (φ, θ), in the cells' frame.
fn direction(at: Vec2) -> Vec3 {
    let (s, c) = math::sin_cos(at.y);
    Vec3::new(math::cos(at.x) * s, math::sin(at.x) * s, c)
}

/// Nodes on \[−1, 1\] of the samples that lobes are fitted to, by Gauss and Legendre.
const FIT_NODE: f32 = 0.774_596_7;
/// Weights of the middle node and of the others.
const FIT_WEIGHTS: [f32; 2] = [8.0, 5.0];

/// A cell and where it is sampled.
struct Cell {
    low: Vec2,
    high: Vec2,
    /// Of distances: rows of θ, columns of φ, ends and middles.
    directions: [[Vec3; 3]; 3],
    /// Of lobes: direction and share of the solid angle.
    samples: [(Vec3, f32); 9],
}

impl Cell {
    fn new(low: Vec2, high: Vec2) -> Self {
        let middle = 0.5 * (low + high);
        let directions = [low.y, middle.y, high.y]
            .map(|theta| [low.x, middle.x, high.x].map(|phi| direction(Vec2::new(phi, theta))));
        let node = 0.5 * FIT_NODE * (high - low);
        let mut sum = 0.0;
        let mut samples = [(Vec3::ZERO, 0.0); 9];
        for (index, sample) in samples.iter_mut().enumerate() {
            let place = Vec2::new((index % 3) as f32, (index / 3) as f32) - 1.0;
            let at = middle + place * node;
            let outer = [place.x, place.y].map(|place| FIT_WEIGHTS[usize::from(place != 0.0)]);
            *sample = (direction(at), outer[0] * outer[1] * math::sin(at.y));
            sum += sample.1;
        }
        for (_, weight) in &mut samples {
            *weight /= sum;
        }
        Self {
            low,
            high,
            directions,
            samples,
        }
    }

    fn radius(&self) -> f32 {
        let centre = self.directions[1][1];
        let corners = [0, 2].map(|row| [0, 2].map(|column| self.directions[row][column]));
        let least = (corners.as_flattened().iter())
            .map(|corner| corner.dot(centre))
            .fold(1.0, f32::min);
        math::acos(least)
    }

    fn solid_angle(&self) -> f32 {
        (self.high.x - self.low.x) * (math::cos(self.low.y) - math::cos(self.high.y))
    }

    /// α and β of `exp(λ(p·ω − 1)) ≈ α + β p·ω`, and the root mean square of what is left.
    fn fit(&self, axis: Vec3, sharpness: f32) -> [f32; 3] {
        // 1 − p·ω without cancellation.
        let samples = self.samples.map(|(direction, weight)| {
            let aside = 0.5 * (direction - axis).length_squared();
            [weight, aside, math::exp(-sharpness * aside)]
        });
        let (mut mean, mut value) = (0.0, 0.0);
        for [weight, aside, found] in samples {
            mean += weight * aside;
            value += weight * found;
        }
        let (mut variance, mut covariance) = (0.0, 0.0);
        for [weight, aside, found] in samples {
            variance += weight * (aside - mean) * (aside - mean);
            covariance += weight * (aside - mean) * (found - value);
        }
        let slope = if variance > 0.0 {
            covariance / variance
        } else {
            0.0
        };
        let mut left = 0.0;
        for [weight, aside, found] in samples {
            let error = found - value - slope * (aside - mean);
            left += weight * error * error;
        }
        // Of 1 − p·ω to p·ω.
        [value + slope * (1.0 - mean), -slope, left.sqrt()]
    }
}

/// Integrates lobes over what is visible: Σ ∫ G(ω) max(n·ω, 0) \[D(ω) > 0\] dω.
///
/// Cells are about the unit vector `pole` and reach to the angle `reach` from it.
pub fn integrate(
    field: &impl SignedDistance,
    (pole, reach): (Vec3, f32),
    normal: Vec3,
    lobes: &[SphericalGaussian],
    options: &CellsOptions,
) -> Vec3 {
    let mut radiance = Vec3::ZERO;
    divide(
        field,
        (pole, reach),
        normal,
        lobes,
        options,
        |_, _, part| {
            radiance += part;
        },
    );
    radiance.max(Vec3::ZERO)
}

/// A cell that was integrated, for those who want to know how well.
pub struct Leaf {
    coordinates: Coordinates,
    cell: Cell,
    /// None where all is visible.
    boundary: Option<Boundary>,
}

impl Leaf {
    /// Least and greatest (φ, θ), radians.
    pub fn extent(&self) -> [Vec2; 2] {
        [self.cell.low, self.cell.high]
    }

    /// The unit vector of (φ, θ), world space.
    pub fn direction(&self, at: Vec2) -> Vec3 {
        self.coordinates.to_world(direction(at))
    }

    /// Whether (φ, θ) is on the visible side of the cell's straight boundary.
    pub fn visible(&self, at: Vec2) -> bool {
        (self.boundary.as_ref()).is_none_or(|boundary| boundary.contains(at))
    }

    /// α and β of `exp(λ(p·ω − 1)) ≈ α + β p·ω` in the cell.
    pub fn linear(&self, lobe: &SphericalGaussian) -> [f32; 2] {
        let [alpha, beta, _] = self
            .cell
            .fit(self.coordinates.to_local(lobe.axis), lobe.sharpness);
        [alpha, beta]
    }
}

/// The cells that [`integrate`] adds up. They hold all that is visible.
pub fn leaves(
    field: &impl SignedDistance,
    about: (Vec3, f32),
    normal: Vec3,
    lobes: &[SphericalGaussian],
    options: &CellsOptions,
) -> Vec<Leaf> {
    let coordinates = Coordinates::about(about.0);
    let mut leaves = Vec::new();
    divide(field, about, normal, lobes, options, |cell, boundary, _| {
        leaves.push(Leaf {
            coordinates,
            cell,
            boundary,
        });
    });
    leaves
}

/// Calls `accept` with every cell that is not divided further, its boundary where it has one, and
/// what it carries.
fn divide<F: SignedDistance>(
    field: &F,
    (pole, reach): (Vec3, f32),
    normal: Vec3,
    lobes: &[SphericalGaussian],
    options: &CellsOptions,
    accept: impl FnMut(Cell, Option<Boundary>, Vec3),
) {
    let frame = Coordinates::about(pole);
    let local = |v| frame.to_local(v);
    let carried: f32 = lobes.iter().map(|lobe| luminance(lobe.integral())).sum();
    let mut integral = Integral {
        field,
        frame: &frame,
        normal: local(normal),
        lobes: lobes
            .iter()
            .map(|lobe| SphericalGaussian {
                axis: local(lobe.axis),
                ..*lobe
            })
            .collect(),
        allowed: options.lobe_error * carried,
        options,
        accept,
    };
    let [rows, columns] = options.partition().unwrap_or([1, 4]);
    let cells = Vec2::new(columns as f32, rows as f32);
    for row in 0..rows {
        for column in 0..columns {
            let mut stack = vec![[0, column, row]];
            while let Some([level, column, row]) = stack.pop() {
                let size = Vec2::new(2.0 * PI, reach) / (cells * (1 << level) as f32);
                let place = Vec2::new(column as f32, row as f32);
                let cell = Cell::new(place * size, (place + 1.0) * size);
                let may_divide = options.uniform.is_none() && level < MAX_LEVEL;
                if integral.add(cell, may_divide) {
                    for (dx, dy) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
                        stack.push([level + 1, 2 * column + dx, 2 * row + dy]);
                    }
                }
            }
        }
    }
}

fn luminance(color: Vec3) -> f32 {
    color.dot(Vec3::new(0.2126, 0.7152, 0.0722))
}

struct Integral<'a, F, A> {
    field: &'a F,
    frame: &'a Coordinates,
    /// Normal and lobes are in the cells' frame.
    normal: Vec3,
    lobes: Vec<SphericalGaussian>,
    allowed: f32,
    options: &'a CellsOptions,
    accept: A,
}

impl<F: SignedDistance, A: FnMut(Cell, Option<Boundary>, Vec3)> Integral<'_, F, A> {
    /// The lesser of the distances to the visibility boundary and to the horizon.
    fn distance(&self, direction: Vec3) -> f32 {
        let world = self.frame.to_world(direction);
        let horizon = math::asin(self.normal.dot(direction).clamp(-1.0, 1.0));
        self.field.distance(world).min(horizon)
    }

    /// Adds what a cell carries, unless it has to be divided.
    fn add(&mut self, cell: Cell, may_divide: bool) -> bool {
        let centre = self.distance(cell.directions[1][1]);
        let radius = cell.radius() + MARGIN;
        if centre <= -radius {
            return false;
        }
        if centre >= radius {
            let moments = whole(&cell, self.normal);
            return self.add_lobes(cell, None, &moments, may_divide);
        }
        let mut distances = [[0.0; 3]; 3];
        for (distances, directions) in distances.iter_mut().zip(&cell.directions) {
            for (distance, direction) in distances.iter_mut().zip(directions) {
                *distance = self.distance(*direction);
            }
        }
        let boundary = Boundary::new(&cell, &distances);
        if may_divide && boundary.error(&cell, &distances) > self.options.boundary_error {
            return true;
        }
        let moments = boundary.moments(&cell, self.normal);
        self.add_lobes(cell, Some(boundary), &moments, may_divide)
    }

    fn add_lobes(
        &mut self,
        cell: Cell,
        boundary: Option<Boundary>,
        moments: &Moments,
        may_divide: bool,
    ) -> bool {
        if *moments == Moments::default() {
            (self.accept)(cell, boundary, Vec3::ZERO);
            return false;
        }
        let mut radiance = Vec3::ZERO;
        let mut error = 0.0;
        for lobe in &self.lobes {
            let [alpha, beta, left] = cell.fit(lobe.axis, lobe.sharpness);
            radiance += lobe.amplitude * (alpha * moments.a + beta * lobe.axis.dot(moments.b));
            error += luminance(lobe.amplitude) * left;
        }
        if may_divide && error * cell.solid_angle() > self.allowed {
            return true;
        }
        (self.accept)(cell, boundary, radiance);
        false
    }
}

/// Moments of a whole cell.
fn whole(cell: &Cell, normal: Vec3) -> Moments {
    strip(
        normal,
        cell.low.y,
        Vec2::new(cell.low.x, cell.high.y),
        cell.high,
    )
}

/// What of a cell is visible: nothing, all, or what lies on one side of one or two lines.
struct Boundary {
    /// Corners as (φ, θ), in a circle: low–low, high–low, high–high, low–high.
    corners: [Vec2; 4],
    inside: [bool; 4],
    /// Where the boundary crosses the side from a corner to the next.
    crossings: [Vec2; 4],
    /// Whether visible corners on a diagonal are connected.
    connected: bool,
}

impl Boundary {
    fn new(cell: &Cell, distances: &[[f32; 3]; 3]) -> Self {
        let (low, high) = (cell.low, cell.high);
        let corners = [
            low,
            Vec2::new(high.x, low.y),
            high,
            Vec2::new(low.x, high.y),
        ];
        let at = [
            distances[0][0],
            distances[0][2],
            distances[2][2],
            distances[2][0],
        ];
        let crossing = |side: usize| {
            let (a, b) = (at[side], at[(side + 1) % 4]);
            let along = if a == b {
                0.5
            } else {
                (a / (a - b)).clamp(0.0, 1.0)
            };
            corners[side].lerp(corners[(side + 1) % 4], along)
        };
        Self {
            corners,
            inside: at.map(|distance| distance > 0.0),
            crossings: [0, 1, 2, 3].map(crossing),
            connected: distances[1][1] > 0.0,
        }
    }

    fn crossed(&self, side: usize) -> bool {
        self.inside[side] != self.inside[(side + 1) % 4]
    }

    /// Moments of the visible polygon, whose inner sides are straight lines.
    fn moments(&self, cell: &Cell, normal: Vec3) -> Moments {
        let mut sum = Moments::default();
        // The strip under a side; around a polygon they add up to its moments, negative.
        self.visit_sides(|from, to| {
            if from.x != to.x {
                sum.add(&strip(normal, cell.low.y, to, from));
            }
        });
        sum
    }

    /// Whether a point of the cell is in the visible polygon: whether a ray from it crosses an
    /// odd number of sides.
    fn contains(&self, at: Vec2) -> bool {
        let mut inside = false;
        self.visit_sides(|from, to| {
            if (from.y > at.y) != (to.y > at.y) {
                let along = (at.y - from.y) / (to.y - from.y);
                inside ^= from.x + along * (to.x - from.x) > at.x;
            }
        });
        inside
    }

    /// The sides of the visible polygon, or of both.
    fn visit_sides(&self, mut side: impl FnMut(Vec2, Vec2)) {
        let diagonal = (0..4).all(|i| self.crossed(i));
        // Where a line that leaves the visible part at side i comes back to it.
        let back = |i: usize| {
            let turn = if diagonal && !self.connected { 3 } else { 1 };
            let other = (0..4).map(|j| (i + turn * (j + 1)) % 4);
            other.into_iter().find(|&j| self.crossed(j)).unwrap_or(i)
        };
        for i in 0..4 {
            let next = (i + 1) % 4;
            match (self.inside[i], self.inside[next]) {
                (true, true) => side(self.corners[i], self.corners[next]),
                (true, false) => {
                    side(self.corners[i], self.crossings[i]);
                    side(self.crossings[i], self.crossings[back(i)]);
                }
                (false, true) => side(self.crossings[i], self.corners[next]),
                (false, false) => {}
            }
        }
    }

    /// Root mean square over the centre and the middles of the sides of the difference
    /// between distances and those to the line, radians.
    fn error(&self, cell: &Cell, distances: &[[f32; 3]; 3]) -> f32 {
        let samples = [[1, 1], [0, 1], [1, 0], [1, 2], [2, 1]];
        let mut sum = 0.0;
        let count = (0..4).filter(|&i| self.crossed(i)).count();
        if count == 4 {
            return f32::INFINITY;
        }
        if count == 0 {
            // No line: a boundary closer than half the way to the next sample may pass
            // between samples.
            let gap = 0.25 * cell.radius();
            for [row, column] in samples {
                let distance = distances[row][column];
                let inside = if self.inside[0] { distance } else { -distance };
                let miss = (gap - inside).max(0.0);
                sum += miss * miss;
            }
            return (0.2 * sum).sqrt();
        }
        // The great circle through both crossings, its pole on the visible side.
        let (mut leaving, mut entering) = (Vec3::ZERO, Vec3::ZERO);
        for i in (0..4).filter(|&i| self.crossed(i)) {
            if self.inside[i] {
                leaving = direction(self.crossings[i]);
            } else {
                entering = direction(self.crossings[i]);
            }
        }
        let mut pole = leaving.cross(entering).normalize_or_zero();
        let visible = (0..4).find(|&i| self.inside[i]).unwrap_or(0);
        if pole.dot(direction(self.corners[visible])) < 0.0 {
            pole = -pole;
        }
        for [row, column] in samples {
            let line = pole.dot(cell.directions[row][column]);
            let miss = distances[row][column] - math::asin(line.clamp(-1.0, 1.0));
            sum += miss * miss;
        }
        (0.2 * sum).sqrt()
    }
}

/// The pole for the products of lights with the lobes of one reflection, and how far cells
/// have to reach from it: the mean axis, and all lobes' supports.
pub fn around(lobes: &[SphericalGaussian]) -> (Vec3, f32) {
    let mean: Vec3 = lobes
        .iter()
        .map(|lobe| lobe.axis * luminance(lobe.integral()))
        .sum();
    let pole = mean.normalize_or(Vec3::Y);
    let reach = (lobes.iter())
        .map(|lobe| {
            let aside = math::acos(pole.dot(lobe.axis).clamp(-1.0, 1.0));
            (aside + support_radius(lobe.sharpness)).min(PI)
        })
        .fold(0.0, f32::max);
    (pole, reach)
}

/// Cells to come, at most: each level leaves three.
const STACK: u32 = 3 * MAX_LEVEL + 4;

/// The constants of this module, as WGSL.
pub fn wgsl_constants() -> String {
    let [[a, b], [c, d]] = NODES;
    format!(
        "const CELLS_NARROW: f32 = {NARROW:?};\n\
         const CELLS_MAX_LEVEL: u32 = {MAX_LEVEL}u;\n\
         const CELLS_STACK: u32 = {STACK}u;\n\
         const CELLS_MARGIN: f32 = {MARGIN:?};\n\
         const CELLS_PANEL: f32 = {PANEL:?};\n\
         const CELLS_FIT_NODE: f32 = {FIT_NODE:?};\n\
         const CELLS_FIT_WEIGHTS: vec2<f32> = vec2({:?}, {:?});\n\
         const CELLS_NODES: array<vec2<f32>, 2> = array(vec2({a:?}, {b:?}), vec2({c:?}, {d:?}));\n",
        FIT_WEIGHTS[0], FIT_WEIGHTS[1]
    )
}

#[cfg(test)]
mod tests {
    use std::f32::consts::FRAC_PI_2;

    use super::*;
    use crate::tables::Tables;

    /// Of f32 against f64, over the integral of |n·ω|.
    const TOLERANCE: f64 = 1e-4;

    /// Brute force in double precision: the strip's moments, and ∫ |n·ω| dω.
    fn expected(normal: Vec3, base: f32, from: Vec2, to: Vec2) -> ([f64; 4], f64) {
        let n = normal.as_dvec3();
        let (base, from, step) = (f64::from(base), from.as_dvec2(), (to - from).as_dvec2());
        let steps = 400;
        let (mut sum, mut size) = ([0.0; 4], 0.0);
        for i in 0..steps {
            let at = from + step * ((f64::from(i) + 0.5) / f64::from(steps));
            let height = at.y - base;
            for j in 0..steps {
                let theta = base + height * (f64::from(j) + 0.5) / f64::from(steps);
                let direction = glam::DVec3::new(
                    math::cos(at.x) * math::sin(theta),
                    math::sin(at.x) * math::sin(theta),
                    math::cos(theta),
                );
                let area = step.x * height / f64::from(steps * steps) * math::sin(theta);
                let cosine = n.dot(direction);
                size += (area * cosine).abs();
                let terms = [1.0, direction.x, direction.y, direction.z];
                for (sum, term) in sum.iter_mut().zip(terms) {
                    *sum += area * cosine * term;
                }
            }
        }
        (sum, size)
    }

    #[test]
    fn moments_match_double_precision() {
        let normals = [
            Vec3::Z,
            Vec3::new(0.6, 0.0, 0.8),
            Vec3::new(-0.5, 0.7, -0.4).normalize(),
        ];
        let mut worst = 0.0f64;
        for normal in normals {
            for width in [1e-3f32, 0.03, 0.4, FRAC_PI_2, 2.0 * PI] {
                for height in [1e-3f32, 0.1, 0.7, FRAC_PI_2] {
                    for base in [0.0f32, 1e-3, 0.5, 1.2] {
                        for phi in [0.0f32, 4.0] {
                            for slope in [0.0f32, 0.5, -1.0] {
                                // From a strip of even height to a triangle.
                                let from = Vec2::new(phi, base + height * (1.0 - slope.max(0.0)));
                                let to =
                                    Vec2::new(phi + width, base + height * (1.0 + slope.min(0.0)));
                                if from.y.max(to.y) > PI || from.y == to.y && height == 0.0 {
                                    continue;
                                }
                                let found = strip(normal, base, from, to);
                                let (exact, size) = expected(normal, base, from, to);
                                let found = [found.a, found.b.x, found.b.y, found.b.z];
                                for (found, exact) in found.into_iter().zip(exact) {
                                    let error = (f64::from(found) - exact).abs() / size;
                                    worst = worst.max(error);
                                    assert!(
                                        error < TOLERANCE,
                                        "{normal} {width} {height} {base} {phi} {slope}: {error}"
                                    );
                                }
                            }
                        }
                    }
                }
            }
        }
        println!("largest error {worst:e}");
    }

    /// What is on the side of a plane through the eye.
    struct HalfSpace(Vec3);

    impl SignedDistance for HalfSpace {
        fn distance(&self, direction: Vec3) -> f32 {
            math::asin(self.0.dot(direction).clamp(-1.0, 1.0))
        }
    }

    fn lobe(axis: Vec3, sharpness: f32) -> SphericalGaussian {
        SphericalGaussian {
            axis: axis.normalize(),
            sharpness,
            amplitude: Vec3::new(1.0, 2.0, 0.5),
        }
    }

    /// Fine thresholds, for what remains of the approximations.
    const FINE: CellsOptions = CellsOptions {
        boundary_error: 2e-3,
        lobe_error: 1e-4,
        uniform: None,
    };

    #[test]
    fn unblocked_lobes_have_their_cosine_integral() {
        let open = HalfSpace(Vec3::Y);
        for sharpness in [0.5, 4.0, 30.0] {
            for axis in [Vec3::Y, Vec3::new(0.8, 0.6, 0.0), Vec3::new(0.5, 0.3, 0.9)] {
                let lobe = lobe(axis, sharpness);
                let found = integrate(&open, (Vec3::Y, FRAC_PI_2), Vec3::Y, &[lobe], &FINE);
                let whole = Tables::get().cosine_integral(sharpness, lobe.axis.y);
                let error = (found / lobe.amplitude - whole).abs().max_element() / whole;
                assert!(error < 0.01, "{sharpness} {axis}: {found} for {whole}");
            }
        }
    }

    #[test]
    fn half_of_a_lobe_is_visible_behind_a_wall_through_its_axis() {
        let wall = HalfSpace(Vec3::X);
        for sharpness in [2.0, 20.0, 300.0] {
            let lobe = lobe(Vec3::new(0.0, 1.0, 0.4), sharpness);
            let whole = Tables::get().cosine_integral(sharpness, lobe.axis.y) * lobe.amplitude;
            for about in [
                (Vec3::Y, FRAC_PI_2),
                around(&[lobe]),
                (lobe.axis, support_radius(sharpness)),
            ] {
                let found = integrate(&wall, about, Vec3::Y, &[lobe], &FINE);
                let error = (found / whole - 0.5).abs().max_element();
                assert!(error < 0.012, "{sharpness} {about:?}: {}", found / whole);
            }
        }
    }

    #[test]
    fn leaves_add_up_to_the_integral() {
        let wall = HalfSpace(Vec3::new(0.6, 0.5, -0.3).normalize());
        let lobes = [lobe(Vec3::new(0.3, 1.0, 0.4), 6.0)];
        let about = (Vec3::Y, FRAC_PI_2);
        let options = CellsOptions {
            uniform: Some([4, 16]),
            ..FINE
        };
        let found = integrate(&wall, about, Vec3::Y, &lobes, &options);
        let mut sum = 0.0;
        for leaf in leaves(&wall, about, Vec3::Y, &lobes, &options) {
            const STEPS: usize = 40;
            let [low, high] = leaf.extent();
            let size = (high - low) / STEPS as f32;
            let [alpha, beta] = leaf.linear(&lobes[0]);
            for i in 0..STEPS * STEPS {
                let place = Vec2::new((i % STEPS) as f32, (i / STEPS) as f32) + 0.5;
                let at = low + place * size;
                if leaf.visible(at) {
                    let direction = leaf.direction(at);
                    let area = size.x * size.y * math::sin(at.y);
                    sum += (alpha + beta * lobes[0].axis.dot(direction)) * area * direction.y;
                }
            }
        }
        let expected = sum * lobes[0].amplitude;
        let error = (found - expected).length() / expected.length();
        assert!(error < 2e-3, "{found} for {expected}");
    }

    #[test]
    fn smaller_thresholds_have_smaller_errors() {
        let wall = HalfSpace(Vec3::new(0.6, 0.5, -0.3).normalize());
        let lobes = [
            lobe(Vec3::new(0.3, 1.0, 0.4), 6.0),
            lobe(Vec3::new(-0.3, 0.5, 0.4), 40.0),
        ];
        let found = |boundary_error: f32, lobe_error: f32, uniform: Option<[u32; 2]>| {
            let options = CellsOptions {
                boundary_error,
                lobe_error,
                uniform,
            };
            integrate(&wall, (Vec3::Y, FRAC_PI_2), Vec3::Y, &lobes, &options)
        };
        let exact = found(1e-9, 1e-9, None);
        let error = |radiance: Vec3| (radiance - exact).length() / exact.length();
        let adaptive = [0.3, 0.03].map(|scale| error(found(0.1 * scale, 0.05 * scale, None)));
        assert!(
            adaptive[1] < adaptive[0] && adaptive[1] < 0.02,
            "{adaptive:?}"
        );
        let uniform =
            [[1, 1], [2, 8], [4, 16], [16, 64]].map(|cells| error(found(0.0, 0.0, Some(cells))));
        assert!(
            uniform[1] > 0.01 && uniform[2] < 0.5 * uniform[1] && uniform[3] < 0.1 * uniform[2],
            "{uniform:?}"
        );
    }
}
