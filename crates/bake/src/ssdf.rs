//! Spherical signed distance: angle to the nearest point of the visibility boundary.
//!
//! D(ω) is positive where ω is visible and negative where it is blocked (Wang et al. 2013,
//! §4). The boundary is known where it passes between neighbouring sample texels of
//! different class: at the contour that separates them where one was found
//! ([`Crossings`]), midway otherwise. |D| is the angle to the nearest of these points,
//! found exactly: for directions that lie together, those chunks of points are looked
//! through that can hold the nearest one.
//!
//! The distances may be wanted at fewer texels than were sampled. A texel then spans a
//! block of samples, the majority of which tells the sign at its centre.
//!
//! Distances are read by bilinear interpolation, and shade by where that vanishes. Even
//! exact distances at the centres of texels interpolate to a boundary that is off by a
//! twentieth of a texel or more: it bends and has corners. So the distances are moved, by as
//! little as it takes, to vanish at the points of the boundary: relaxed projections
//! (Kaczmarz 1937) onto one equation per point.

use std::cmp::Ordering;

use glam::{Vec2, Vec2Swizzles as _, Vec3};
use pulp::{Arch, Simd, WithSimd};
use relight_shading::octahedral::{self, Footprint};

use crate::visibility::{Bitmap, Directions};

/// Directions whose distances are computed side by side: those of 4 × 4 texels or samples.
const LANES: usize = SIDE * SIDE;
const SIDE: usize = 4;
/// Points of the boundary that lie together.
const CHUNK: usize = 8;
/// Chunks that are chosen from at once.
const WORD: usize = u64::BITS as usize;
/// 1, 2, 4 …
const POWERS: [f32; LANES] = {
    let mut powers = [1.0; LANES];
    let mut lane = 1;
    while lane < LANES {
        powers[lane] = 2.0 * powers[lane - 1];
        lane += 1;
    }
    powers
};
/// Most samples per texel and side.
pub const MAX_SPAN: u32 = 16;
/// A coordinate of points that are nearest to nothing.
const FAR: f32 = 1e3;
/// Projections onto every point's equation, and how far each goes. More sweeps gain 3 % each
/// time that their number doubles; fuller projections end at the equation that comes last.
const SWEEPS: usize = 16;
const RELAXATION: f32 = 0.3;
/// Projections under way at a time.
const STRANDS: usize = 8;
/// Slack of bounds against rounding, a chord.
const SLACK: f32 = 1e-5;

/// Tables for the transform between two resolutions.
pub struct Transform {
    /// Texels per side of the visibility bitmap.
    n: usize,
    /// Texels per side that distances are wanted at.
    resolution: usize,
    /// The texels' centres.
    tiles: Vec<Group>,
    /// Pairs of texels that are neighbours over the border, and the midpoint between them.
    border: Vec<([u32; 2], Vec2)>,
}

/// That a weighted sum of four distances vanish.
struct Equation {
    texels: [u32; 4],
    weights: [f32; 4],
    /// What a sum of one takes from each distance.
    steps: [f32; 4],
}

impl Equation {
    fn new(footprint: Footprint) -> Self {
        let Footprint { texels, weights } = footprint;
        let squares: f32 = weights.iter().map(|weight| weight * weight).sum();
        Self {
            texels: texels.map(|texel| texel as u32),
            weights,
            steps: weights.map(|weight| RELAXATION * weight / squares),
        }
    }

    #[inline(always)]
    fn project(&self, distances: &mut [f32]) {
        let [a, b, c, d] = self.texels.map(|texel| distances[texel as usize]);
        let [p, q, r, s] = self.weights;
        let sum = (a * p + b * q) + (c * r + d * s);
        for (texel, step) in self.texels.iter().zip(self.steps) {
            // Some texels on the map's border are their own neighbours.
            distances[*texel as usize] -= sum * step;
        }
    }
}

/// Directions of up to 4 × 4 texels that lie together. Lanes without a texel repeat another.
struct Group {
    x: usize,
    y: usize,
    columns: usize,
    rows: usize,
    centre: Vec3,
    /// Largest chord between a direction and the centre.
    radius: f32,
    directions: [[f32; LANES]; 3],
}

/// Where contours cross the links between neighbouring sample texels of different class.
#[derive(Debug, Default)]
pub struct Crossings {
    /// Per link between texels of different class, from its first texel to the other, 0 to 1;
    /// NaN where no contour was found. The links to the right of every texel are followed by
    /// those to the texel below. Empty if nothing is known.
    pub(crate) positions: Vec<f32>,
}

impl Crossings {
    fn position(&self, link: usize) -> f32 {
        match self.positions.get(link) {
            Some(position) if !position.is_nan() => *position,
            _ => 0.5,
        }
    }
}

/// Where the boundary crosses a link, in sample texels: texel (x, y) has its centre at (x, y).
type Place = Vec2;

/// Points of the boundary.
struct Boundary {
    points: Vec<[[f32; 3]; CHUNK]>,
    /// One of the points of each chunk. Followed by points far from the sphere, to a
    /// multiple of [`WORD`].
    centres: [Vec<f32>; 3],
    /// Largest chord between a chunk's centre and another of its points.
    radii: Vec<f32>,
    /// From some direction to the centres, squared.
    chords: Vec<f32>,
    /// Chunks that can hold the nearest point to some direction.
    candidates: Vec<u32>,
}

impl Transform {
    /// Tables from bitmaps of the resolution of `samples` to distances at `resolution`
    /// squared texels. `resolution` must divide that of the samples, and be at least a
    /// [`MAX_SPAN`]th of it.
    pub fn new(samples: &Directions, resolution: u32) -> Self {
        let n = samples.resolution();
        assert!(
            n.is_multiple_of(resolution) && n / resolution <= MAX_SPAN,
            "{resolution} does not divide {n}, or into too small parts"
        );
        let (n, resolution) = (n as usize, resolution as usize);
        Self {
            n,
            resolution,
            tiles: groups(resolution),
            border: border(n),
        }
    }

    /// The SSDF of a visibility bitmap, radians per texel, clamped to ± `limit`: interpolated,
    /// it vanishes at the boundary as nearly as this resolution can.
    pub fn apply(&self, visible: &Bitmap, crossings: &Crossings, limit: f32) -> Vec<f32> {
        let places = self.places(visible, crossings);
        let mut distances = self.distances(visible, &places, limit);
        self.fit(&places, &mut distances);
        distances
    }

    /// The same, exact at the centres of texels instead.
    pub fn at_centres(&self, visible: &Bitmap, crossings: &Crossings, limit: f32) -> Vec<f32> {
        self.distances(visible, &self.places(visible, crossings), limit)
    }

    /// Mean square of what distances are where they should vanish, interpolated: radians².
    pub fn squared_error(&self, visible: &Bitmap, crossings: &Crossings, distances: &[f32]) -> f32 {
        let places = self.places(visible, crossings);
        let squares = places
            .iter()
            .map(|place| self.footprint(*place).read(distances).powi(2));
        squares.sum::<f32>() / places.len().max(1) as f32
    }

    fn distances(&self, visible: &Bitmap, places: &[Place], limit: f32) -> Vec<f32> {
        let mut distances = vec![0.0; self.resolution * self.resolution];
        Arch::new().dispatch(AtCentres {
            transform: self,
            visible,
            places,
            limit,
            distances: &mut distances,
        });
        distances
    }

    /// Finds all links between texels of different class, and where the boundary crosses them.
    fn places(&self, visible: &Bitmap, crossings: &Crossings) -> Vec<Place> {
        let n = self.n;
        let mut places = Vec::with_capacity(16 * n);
        visible.for_links(n, |x, y, below| {
            let texel = y * n + x;
            let link = if below { n * n + texel } else { texel };
            let along = if below { Vec2::Y } else { Vec2::X };
            places.push(Vec2::new(x as f32, y as f32) + crossings.position(link) * along);
        });
        for ([a, b], midpoint) in &self.border {
            if visible.get(*a as usize) != visible.get(*b as usize) {
                places.push(*midpoint);
            }
        }
        places
    }

    /// Moves distances to vanish at places, where they are interpolated.
    fn fit(&self, places: &[Place], distances: &mut [f32]) {
        // One after the other, points that share texels wait for each other: places are taken
        // from all over the map in turn.
        let stride = places.len().div_ceil(STRANDS).max(1);
        let equations: Vec<Equation> = (0..stride)
            .flat_map(|first| places[first.min(places.len())..].iter().step_by(stride))
            .map(|place| Equation::new(self.footprint(*place)))
            .collect();
        for _ in 0..SWEEPS {
            for equation in &equations {
                equation.project(distances);
            }
        }
    }

    /// What is read where distances are interpolated.
    fn footprint(&self, place: Place) -> Footprint {
        let scale = self.resolution as f32 / self.n as f32;
        Footprint::new((place + 0.5) * scale - 0.5, self.resolution as u32)
    }

    /// Sorts points of the boundary into chunks.
    #[inline(always)]
    fn boundary(&self, places: &[Place]) -> Boundary {
        let cells_per_side = self.n.div_ceil(SIDE);
        let cells = cells_per_side * cells_per_side;
        // Casts saturate at zero.
        let cell = |place: &Place| {
            let side = |x: f32| (x as usize / SIDE).min(cells_per_side - 1);
            side(place.y) * cells_per_side + side(place.x)
        };
        let mut starts = vec![0u32; cells + 1];
        for place in places {
            starts[cell(place) + 1] += 1;
        }
        // A cell's last chunk is filled up with its last point.
        for cell in 0..cells {
            starts[cell + 1] = starts[cell] + starts[cell + 1].next_multiple_of(CHUNK as u32);
        }
        let padded = starts[cells] as usize;
        let mut next = starts.clone();
        let [mut u, mut v] = [vec![0.0; padded], vec![0.0; padded]];
        for place in places {
            let next = &mut next[cell(place)];
            [u[*next as usize], v[*next as usize]] = place.to_array();
            *next += 1;
        }
        for (next, end) in next.iter().zip(&starts[1..]) {
            for place in *next as usize..*end as usize {
                (u[place], v[place]) = (u[place - 1], v[place - 1]);
            }
        }
        let mut points = vec![[[0.0; 3]; CHUNK]; padded / CHUNK];
        let scale = 2.0 / self.n as f32;
        let flat = points.as_flattened_mut();
        for ((point, u), v) in flat.iter_mut().zip(u).zip(v) {
            *point = decode([u, v], scale);
        }
        Boundary::new(points)
    }

    /// Visible samples per texel of a tile.
    #[inline(always)]
    fn visible_samples(&self, visible: &Bitmap, tile: &Group) -> [u32; LANES] {
        let (n, span) = (self.n, self.n / self.resolution);
        let one = (1u64 << span) - 1;
        let mut counts = [0; LANES];
        for y in 0..tile.rows * span {
            let bits = visible.bits((tile.y * span + y) * n + tile.x * span);
            for (column, count) in counts[y / span * SIDE..][..SIDE].iter_mut().enumerate() {
                *count += (bits >> (column * span) & one).count_ones();
            }
        }
        counts
    }
}

/// The vectorised body of [`Transform::distances`].
struct AtCentres<'a> {
    transform: &'a Transform,
    visible: &'a Bitmap,
    places: &'a [Place],
    limit: f32,
    distances: &'a mut [f32],
}

impl WithSimd for AtCentres<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self {
            transform,
            visible,
            places,
            limit,
            distances,
        } = self;
        let Transform { n, resolution, .. } = *transform;
        let samples = (n / resolution).pow(2) as u32;
        let mut boundary = transform.boundary(places);
        let limit = [limit, squared_chord(limit).sqrt()];
        for tile in &transform.tiles {
            let counts = transform.visible_samples(visible, tile);
            let found = boundary.nearest(simd, tile, limit);
            for row in 0..tile.rows {
                let start = (tile.y + row) * resolution + tile.x;
                for column in 0..tile.columns {
                    let (count, angle) = (counts[row * SIDE + column], found[row * SIDE + column]);
                    distances[start + column] = match (2 * count).cmp(&samples) {
                        Ordering::Less => -angle,
                        Ordering::Equal => 0.0,
                        Ordering::Greater => angle,
                    };
                }
            }
        }
    }
}

impl Boundary {
    #[inline(always)]
    fn new(points: Vec<[[f32; 3]; CHUNK]>) -> Self {
        let padded = points.len().next_multiple_of(WORD);
        let mut centres = [(); 3].map(|()| vec![FAR; padded]);
        let mut radii = vec![0.0; padded];
        let [x, y, z] = &mut centres;
        for (chunk, points) in points.iter().enumerate() {
            let centre = points[CHUNK / 2];
            [x[chunk], y[chunk], z[chunk]] = centre;
            let mut largest = 0.0f32;
            for point in points {
                largest = largest.max(squared_distance(*point, centre));
            }
            radii[chunk] = largest.sqrt();
        }
        Self {
            points,
            chords: vec![0.0; padded],
            candidates: Vec::with_capacity(padded),
            centres,
            radii,
        }
    }

    /// Angle from each direction of a group to the nearest point, at most `limit`: an angle
    /// and its chord.
    #[inline(always)]
    fn nearest<S: Simd>(
        &mut self,
        simd: S,
        group: &Group,
        [limit, limit_chord]: [f32; 2],
    ) -> [f32; LANES] {
        let from_centre = self.chords_from(simd, group.centre);
        // No direction of the group is farther from the boundary than this.
        let bound = (from_centre.sqrt() + group.radius).min(limit_chord);
        self.choose(simd, bound + group.radius + SLACK);
        let mut nearest = [0.0; LANES];
        let [tx, ty, tz] = group.directions.each_ref().map(|axis| lanes::<S>(axis));
        let found = S::as_mut_simd_f32s(&mut nearest).0;
        for (((found, tx), ty), tz) in found.iter_mut().zip(tx).zip(ty).zip(tz) {
            let mut least = simd.splat_f32s(limit_chord * limit_chord);
            for &chunk in &self.candidates {
                for [x, y, z] in self.points[chunk as usize] {
                    let x = simd.sub_f32s(*tx, simd.splat_f32s(x));
                    let y = simd.sub_f32s(*ty, simd.splat_f32s(y));
                    let z = simd.sub_f32s(*tz, simd.splat_f32s(z));
                    let squared = simd.mul_add_f32s(x, x, simd.mul_f32s(y, y));
                    least = simd.min_f32s(least, simd.mul_add_f32s(z, z, squared));
                }
            }
            *found = least;
        }
        angles(nearest, limit)
    }

    /// Computes the chords to all centres; returns the least, squared.
    #[inline(always)]
    fn chords_from<S: Simd>(&mut self, simd: S, direction: Vec3) -> f32 {
        let [tx, ty, tz] = direction.to_array().map(|axis| simd.splat_f32s(axis));
        let [x, y, z] = self.centres.each_ref().map(|axis| lanes::<S>(axis));
        let mut least = simd.splat_f32s(f32::MAX);
        let chords = S::as_mut_simd_f32s(&mut self.chords).0;
        for (((chord, x), y), z) in chords.iter_mut().zip(x).zip(y).zip(z) {
            let (x, y, z) = (
                simd.sub_f32s(*x, tx),
                simd.sub_f32s(*y, ty),
                simd.sub_f32s(*z, tz),
            );
            let squared = simd.mul_add_f32s(x, x, simd.mul_f32s(y, y));
            *chord = simd.mul_add_f32s(z, z, squared);
            least = simd.min_f32s(least, *chord);
        }
        simd.reduce_min_f32s(least)
    }

    /// Finds the chunks with points within `reach`, a chord.
    #[inline(always)]
    fn choose<S: Simd>(&mut self, simd: S, reach: f32) {
        self.candidates.clear();
        let (reach, none) = (simd.splat_f32s(reach), simd.splat_f32s(0.0));
        let powers = lanes::<S>(&POWERS)[0];
        let words = lanes::<S>(&self.chords).chunks_exact(WORD / S::F32_LANES);
        let radii = lanes::<S>(&self.radii).chunks_exact(WORD / S::F32_LANES);
        for ((chords, radii), first) in words.zip(radii).zip((0..).step_by(WORD)) {
            // One bit per chunk, first summed as powers of two, which is exact.
            let mut near = 0;
            for (i, (chord, radius)) in chords.iter().zip(radii).enumerate() {
                let reach = simd.add_f32s(reach, *radius);
                let within = simd.less_than_f32s(*chord, simd.mul_f32s(reach, reach));
                let bits = simd.reduce_sum_f32s(simd.select_f32s(within, powers, none));
                near |= (bits as u64) << (i * S::F32_LANES);
            }
            while near != 0 {
                self.candidates.push(first + near.trailing_zeros());
                near &= near - 1;
            }
        }
    }
}

/// A slice whose length is a multiple of all vectors'.
#[inline(always)]
fn lanes<S: Simd>(values: &[f32]) -> &[S::f32s] {
    S::as_simd_f32s(values).0
}

#[inline(always)]
fn squared_distance(a: [f32; 3], b: [f32; 3]) -> f32 {
    let [x, y, z] = [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
    x.mul_add(x, y.mul_add(y, z * z))
}

/// Angles of squared chords, at most `limit`.
#[inline(always)]
fn angles(squared: [f32; LANES], limit: f32) -> [f32; LANES] {
    let mut angles = [0.0; LANES];
    for lane in 0..LANES {
        // Rounding may leave less than nothing.
        angles[lane] = small_angle(squared[lane].max(0.0));
    }
    for lane in 0..LANES {
        // The series is for small angles.
        if squared[lane] > SMALL_SQUARED_CHORD {
            angles[lane] = angle_of_squared_chord(squared[lane]);
        }
        angles[lane] = angles[lane].min(limit);
    }
    angles
}

/// An `n` × `n` map's texels in groups.
fn groups(n: usize) -> Vec<Group> {
    let starts = || (0..n).step_by(SIDE);
    starts()
        .flat_map(|y| starts().map(move |x| (x, y)))
        .map(|(x, y)| {
            let columns = SIDE.min(n - x);
            let rows = SIDE.min(n - y);
            let directions = (0..LANES).map(|lane| {
                let column = (lane % SIDE).min(columns - 1);
                let row = (lane / SIDE).min(rows - 1);
                direction(Vec2::new((x + column) as f32, (y + row) as f32), n)
            });
            let (centre, radius) = bounds(directions.clone());
            let mut group = Group {
                x,
                y,
                columns,
                rows,
                centre,
                radius,
                directions: [[0.0; LANES]; 3],
            };
            for (lane, direction) in directions.enumerate() {
                for (axis, value) in group.directions.iter_mut().zip(direction.to_array()) {
                    axis[lane] = value;
                }
            }
            group
        })
        .collect()
}

/// Neighbours over the border, each pair once.
fn border(n: usize) -> Vec<([u32; 2], Vec2)> {
    let last = n - 1;
    let middle = |x: f32, y: usize| Vec2::new(x, y as f32);
    (0..n / 2)
        .flat_map(|i| {
            let pair = |a: [usize; 2], b: [usize; 2]| [a, b].map(|[x, y]| (y * n + x) as u32);
            let (low, high) = (-0.5, last as f32 + 0.5);
            [
                (pair([0, i], [0, last - i]), middle(low, i)),
                (pair([last, i], [last, last - i]), middle(high, i)),
                (pair([i, 0], [last - i, 0]), middle(low, i).yx()),
                (pair([i, last], [last - i, last]), middle(high, i).yx()),
            ]
        })
        .collect()
}

/// The direction at a point of the map in texels: texel (x, y) has its centre at (x, y).
fn direction(at: Vec2, n: usize) -> Vec3 {
    octahedral::decode((at + 0.5) / n as f32)
}

/// The same by arithmetic that vectorises.
#[inline(always)]
fn decode([u, v]: [f32; 2], scale: f32) -> [f32; 3] {
    let x = (u + 0.5) * scale - 1.0;
    let z = (v + 0.5) * scale - 1.0;
    let y = 1.0 - x.abs() - z.abs();
    // How far a point of the lower hemisphere moves towards the middle.
    let over = if y < 0.0 { -y } else { 0.0 };
    let x = x - over.copysign(x);
    let z = z - over.copysign(z);
    let inverse = 1.0 / (x * x + y * y + z * z).sqrt();
    [x * inverse, y * inverse, z * inverse]
}

/// A direction amid others and the largest chord to one of them.
fn bounds(directions: impl Iterator<Item = Vec3> + Clone) -> (Vec3, f32) {
    let sum: Vec3 = directions.clone().sum();
    let centre = sum.normalize_or(Vec3::Y);
    let squared = directions.map(|direction| centre.distance_squared(direction));
    (centre, squared.fold(0.0, f32::max).sqrt())
}

fn squared_chord(angle: f32) -> f32 {
    (2.0 * (0.5 * angle).sin()).powi(2)
}

fn angle_of_squared_chord(squared: f32) -> f32 {
    if squared > SMALL_SQUARED_CHORD {
        return 2.0 * (0.5 * squared.sqrt()).min(1.0).asin();
    }
    small_angle(squared)
}

/// Of an angle of half a radian.
const SMALL_SQUARED_CHORD: f32 = 0.25;

/// The series of the arcsine, to the last bit of single precision for small angles.
#[inline(always)]
fn small_angle(squared: f32) -> f32 {
    let quarter = 0.25 * squared;
    let series =
        1.0 / 6.0 + quarter * (3.0 / 40.0 + quarter * (15.0 / 336.0 + quarter * (105.0 / 3456.0)));
    2.0 * quarter.sqrt() * (1.0 + quarter * series)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn brute_force(samples: &Directions, resolution: u32, bitmap: &Bitmap, limit: f32) -> Vec<f32> {
        let n = samples.resolution() as i32;
        let at = |x: i32, y: i32| {
            let (x, y) = octahedral::wrap(x, y, n as u32);
            (y * n as u32 + x) as usize
        };
        let mut midpoints = Vec::new();
        for (x, y) in (0..n * n).map(|i| (i % n, i / n)) {
            for (dx, dy) in [(-1, 0), (1, 0), (0, -1), (0, 1)] {
                let (a, b) = (at(x, y), at(x + dx, y + dy));
                if bitmap.get(a) != bitmap.get(b) {
                    let link = Vec2::new(dx as f32, dy as f32);
                    let at = Vec2::new(x as f32, y as f32) + 0.5 * link;
                    midpoints.push(direction(at, n as usize));
                }
            }
        }
        let span = n / resolution as i32;
        let distance = |direction: Vec3| {
            midpoints
                .iter()
                .map(|&midpoint| 2.0 * (0.5 * direction.distance(midpoint)).min(1.0).asin())
                .fold(limit, f32::min)
        };
        (0..(resolution * resolution) as i32)
            .map(|i| {
                let (x, y) = (i % resolution as i32, i / resolution as i32);
                let block = (0..span * span).map(|j| at(x * span + j % span, y * span + j / span));
                let visible = block.filter(|&texel| bitmap.get(texel)).count();
                let centre = octahedral::texel_direction(x as u32, y as u32, resolution);
                let all = (span * span) as usize;
                match (2 * visible).cmp(&all) {
                    Ordering::Less => -distance(centre),
                    Ordering::Equal => 0.0,
                    Ordering::Greater => distance(centre),
                }
            })
            .collect()
    }

    /// Blobs, stripes and single texels from a small generator of random numbers.
    fn patterns(directions: &Directions) -> Vec<Bitmap> {
        let mut state = 7u64;
        let mut random = move || {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963_407);
            (state >> 40) as f32 / (1u64 << 24) as f32
        };
        let texels = directions.as_slice();
        let mut bitmaps = vec![
            Bitmap::from_fn(texels.len(), |_| true),
            Bitmap::from_fn(texels.len(), |_| false),
            Bitmap::from_fn(texels.len(), |i| i != 17),
            Bitmap::from_fn(texels.len(), |i| i == texels.len() - 1),
            Bitmap::from_fn(texels.len(), |_| random() < 0.5),
        ];
        for caps in [1, 3, 12] {
            let caps: Vec<(Vec3, f32)> = (0..caps)
                .map(|_| {
                    let axis = Vec3::new(random() - 0.5, random() - 0.5, random() - 0.5);
                    (axis.normalize(), 1.0 - 0.3 * random())
                })
                .collect();
            bitmaps.push(Bitmap::from_fn(texels.len(), |i| {
                caps.iter()
                    .all(|(axis, cosine)| axis.dot(texels[i]) < *cosine)
            }));
        }
        bitmaps
    }

    /// Both sides take the same nearest midpoint; arithmetic rounds its last bits otherwise,
    /// radians. An arcsine near a half-turn magnifies them.
    const ROUNDING: f32 = 4e-6;

    #[test]
    fn equals_brute_force() {
        for (samples, resolution) in [(16, 16), (48, 24), (64, 16)] {
            let directions = Directions::new(samples);
            let transform = Transform::new(&directions, resolution);
            for (number, bitmap) in patterns(&directions).iter().enumerate() {
                for limit in [0.5, 3.0] {
                    let fast = transform.at_centres(bitmap, &Crossings::default(), limit);
                    let exact = brute_force(&directions, resolution, bitmap, limit);
                    for (i, (a, b)) in fast.iter().zip(&exact).enumerate() {
                        assert!(
                            (a - b).abs() < ROUNDING,
                            "pattern {number}, {samples}², limit {limit}, texel {i}: {a} instead of {b}"
                        );
                    }
                }
            }
        }
    }

    #[test]
    fn matches_the_distance_to_an_analytic_cap() {
        for resolution in [64, 128] {
            matches_analytic_cap(resolution);
        }
    }

    fn matches_analytic_cap(resolution: u32) {
        let directions = Directions::new(128);
        let transform = Transform::new(&directions, resolution);
        let (axis, radius) = (Vec3::new(0.3, 0.8, -0.5).normalize(), 0.6f32);
        let angle = |direction: Vec3| axis.dot(direction).clamp(-1.0, 1.0).acos();
        let texels = directions.as_slice();
        let bitmap = Bitmap::from_fn(texels.len(), |i| angle(texels[i]) > radius);
        let distances = transform.at_centres(&bitmap, &Crossings::default(), std::f32::consts::PI);
        let exact: Vec<f32> = Directions::new(resolution)
            .as_slice()
            .iter()
            .copied()
            .map(|d| angle(d) - radius)
            .collect();
        let worst = exact
            .iter()
            .zip(&distances)
            .map(|(a, b)| (a - b).abs())
            .fold(0f32, f32::max);
        // Distances to texel centres shrink both sides alike; what shades is where the zero
        // crossing lies: the mean of both sides' errors.
        let mean_error = |side: &dyn Fn(f32) -> bool| {
            let errors: Vec<f32> = (exact.iter().zip(&distances))
                .filter(|(exact, _)| exact.abs() < 0.1 && side(**exact))
                .map(|(exact, found)| found - exact)
                .collect();
            errors.iter().sum::<f32>() / errors.len() as f32
        };
        let mean = 0.5 * (mean_error(&|x| x > 0.0) + mean_error(&|x| x < 0.0));
        assert!(worst < 0.02, "worst error {worst}");
        assert!(mean.abs() < 0.002, "the zero crossing lies {mean} off");
    }
}
