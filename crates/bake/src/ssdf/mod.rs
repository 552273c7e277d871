//! Spherical signed distance: angle to the nearest point of the visibility boundary.
//!
//! D(ω) is positive where ω is visible and negative where it is blocked (Wang et al. 2013,
//! §4). The boundary is known where it passes between neighbouring sample texels of
//! different class: at the contour that separates them where one was found
//! ([`Crossings`]), midway otherwise. |D| is the angle to the nearest of these points,
//! found exactly: for directions that lie together, those chunks of points are looked
//! through that can hold a point nearer than those of the nearest chunk.
//!
//! The distances may be wanted at fewer texels than were sampled. A texel then spans a
//! block of samples, the majority of which tells the sign at its centre.
//!
//! Distances are read by bilinear interpolation, and shade by where that vanishes. Even
//! exact distances at the centres of texels interpolate to a boundary that is off by a
//! twentieth of a texel or more: it bends and has corners. So the distances are moved, by as
//! little as it takes, to vanish at the points of the boundary: relaxed projections
//! (Kaczmarz 1937) onto one equation per point.

use glam::{Mat4, UVec2, Vec2, Vec2Swizzles as _, Vec3, Vec4};
use pulp::{Simd, WithSimd};
use relight_format::math;
use relight_shading::octahedral::{self, Footprint};

use crate::simd;
use crate::visibility::{Bitmap, Crossings, Directions};

mod sampler;

pub(crate) use sampler::{Sampled, Sampler};

/// Directions whose distances are computed side by side: those of 4 × 4 texels or samples.
const LANES: usize = SIDE * SIDE;
const SIDE: usize = 4;
/// Points of the boundary that lie together.
const CHUNK: usize = 8;
/// Chunks that are chosen from at once.
const WORD: usize = u64::BITS as usize;
/// Most samples per texel and side.
pub(crate) const MAX_SPAN: u32 = 16;
/// A coordinate of points that are nearest to nothing.
const FAR: f32 = 1e3;
/// Projections onto every point's equation, and how far each goes. More sweeps gain 3 % each
/// time that their number doubles; fuller projections end at the equation that comes last.
const SWEEPS: usize = 16;
const RELAXATION: f32 = 0.3;
/// Quads under way at a time.
const STRANDS: usize = 8;
/// Slack of bounds against rounding, a chord.
const SLACK: f32 = 1e-5;
/// Radians that something has to be away to be no matter of rounding, or of samples between which the boundary passes.
const CLEAR: f32 = 0.02;
/// Square of an angle of a tenth of a radian, from the middle of a texel to its corner, over its chord's, and some.
const ARC: f32 = 1.002;

/// Tables for the transform between two resolutions.
pub struct DistanceTransform {
    /// Texels per side of the visibility bitmap.
    n: usize,
    /// Texels per side that distances are wanted at.
    resolution: usize,
    /// The texels' centres.
    tiles: Vec<Group>,
    /// Pairs of texels that are neighbours over the border, and the midpoint between them.
    border: Vec<([u32; 2], Vec2)>,
}

/// Whether an SSDF, given at the `centres` of its texels, tells that nothing is met in a direction, nor close to it.
pub(crate) fn is_clear(distances: &[f32], centres: &Directions, direction: Vec3) -> bool {
    let resolution = centres.resolution();
    let texel = octahedral::encode(direction) * resolution as f32;
    let [x, y] = (texel.as_uvec2().min(UVec2::splat(resolution - 1))).to_array();
    let texel = (y * resolution + x) as usize;
    // Distances grow no faster than angles, of which chords are a little less.
    let reach = distances[texel] - CLEAR;
    reach > 0.0 && reach * reach > ARC * direction.distance_squared(centres.as_slice()[texel])
}

/// Four neighbouring texels, and what one sweep over the equations of the points between
/// them makes of their distances: the equations' projections, multiplied.
struct Quad {
    texels: [u32; 4],
    product: Mat4,
}

impl Quad {
    /// Adds that the distances' sum by these weights vanish.
    #[inline(always)]
    fn add(&mut self, weights: Vec4) {
        let step = RELAXATION / weights.length_squared() * weights;
        let sums = self.product * weights;
        let columns = step.to_array().map(|step| step * sums);
        let [x, y, z, w] = columns;
        self.product -= Mat4::from_cols(x, y, z, w);
    }

    #[inline(always)]
    fn project(&self, distances: &mut [f32]) {
        let old = self.texels.map(|texel| distances[texel as usize]);
        let new = self.product * Vec4::from(old);
        // Some texels on the map's border are their own neighbours: one of both counts.
        for (texel, distance) in self.texels.into_iter().zip(new.to_array()) {
            distances[texel as usize] = distance;
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

/// Where the boundary crosses a link, in sample texels: texel (x, y) has its centre at (x, y).
type Place = Vec2;

/// Points of the boundary.
struct Boundary {
    /// Coordinates of the points of each chunk.
    points: Vec<[[f32; CHUNK]; 3]>,
    /// Amid the points of each chunk. Followed by points far from the sphere, to a
    /// multiple of [`WORD`].
    centres: [Vec<f32>; 3],
    /// Largest chord between a chunk's centre and one of its points.
    radii: Vec<f32>,
    largest_radius: f32,
    /// From some direction to the centres, squared.
    chords: Vec<f32>,
    /// Memory for chunks that can hold the nearest point to some direction of a group, and
    /// for those of them that it takes to tell.
    candidates: Vec<u32>,
    needed: Vec<u32>,
}

impl DistanceTransform {
    /// Tables from bitmaps of the resolution of `samples` to distances at `resolution`
    /// squared texels. `resolution` must divide that of the samples, and be at least a
    /// `MAX_SPAN`th of it.
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
    pub(crate) fn squared_error(
        &self,
        visible: &Bitmap,
        crossings: &Crossings,
        distances: &[f32],
    ) -> f32 {
        let places = self.places(visible, crossings);
        let squares = places
            .iter()
            .map(|place| self.footprint(*place).read(distances).powi(2));
        squares.sum::<f32>() / places.len().max(1) as f32
    }

    fn distances(&self, visible: &Bitmap, places: &[Place], limit: f32) -> Vec<f32> {
        let mut distances = vec![0.0; self.resolution * self.resolution];
        simd::arch().dispatch(AtCentres {
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
        let mut quads: Vec<Quad> = Vec::with_capacity(places.len());
        // By their first texels; another one takes the place of one across the border.
        let mut numbers = vec![0u32; distances.len()];
        for place in places {
            let Footprint { texels, weights } = self.footprint(*place);
            let number = &mut numbers[texels[0]];
            let texels = texels.map(|texel| texel as u32);
            let known = quads.get(*number as usize);
            if known.is_none_or(|quad| quad.texels != texels) {
                *number = quads.len() as u32;
                quads.push(Quad {
                    texels,
                    product: Mat4::IDENTITY,
                });
            }
            quads[*number as usize].add(weights.into());
        }
        // One after the other, quads that share texels wait for each other: they are taken
        // from all over the map in turn.
        let stride = quads.len().div_ceil(STRANDS).max(1);
        let quads: Vec<&Quad> = (0..stride)
            .flat_map(|first| quads[first.min(quads.len())..].iter().step_by(stride))
            .collect();
        for _ in 0..SWEEPS {
            for quad in &quads {
                quad.project(distances);
            }
        }
    }

    /// What is read where distances are interpolated.
    #[inline(always)]
    fn footprint(&self, place: Place) -> Footprint {
        let scale = self.resolution as f32 / self.n as f32;
        Footprint::new((place + 0.5) * scale - 0.5, self.resolution as u32)
    }

    /// Sorts points of the boundary into chunks.
    #[inline(always)]
    fn boundary(&self, places: &[Place]) -> Boundary {
        let mut chunks = Vec::with_capacity(places.len());
        let mut rest = places;
        while let Some(first) = rest.first() {
            let near = |place: &&Place| (*place - first).abs().max_element() < SIDE as f32;
            let count = rest.iter().take(CHUNK).take_while(near).count();
            let (chunk, others) = rest.split_at(count);
            chunks.push(chunk);
            rest = others;
        }
        Boundary::new(&chunks, 2.0 / self.n as f32)
    }

    /// Per tile, whether its samples differ, or may.
    #[inline(always)]
    fn mixed(&self, places: &[Place]) -> Vec<bool> {
        let per_row = self.resolution.div_ceil(SIDE);
        let mut mixed = vec![false; self.tiles.len()];
        let scale = self.resolution as f32 / (SIDE * self.n) as f32;
        for place in places {
            let tile = (*place + 0.5) * scale;
            // Those on the map's border may lie on its far side.
            let [x, y] = [tile.x, tile.y].map(|at| (at as usize).min(per_row - 1));
            mixed[y * per_row + x] = true;
        }
        mixed
    }

    /// Of a tile whose samples are alike.
    #[inline(always)]
    fn sign(&self, visible: &Bitmap, tile: &Group) -> f32 {
        let span = self.n / self.resolution;
        let first = visible.get(tile.y * span * self.n + tile.x * span);
        if first { 1.0 } else { -1.0 }
    }

    /// Per texel of a tile, 1 if most of its samples are visible, −1 if most are blocked.
    #[inline(always)]
    fn signs(&self, visible: &Bitmap, tile: &Group) -> [f32; LANES] {
        let (n, span) = (self.n, self.n / self.resolution);
        let within = !0 >> (64 - tile.columns * span);
        let row = |y: usize| visible.bits((tile.y * span + y) * n + tile.x * span) & within;
        let one = (1u64 << span) - 1;
        let mut counts = [0; LANES];
        for y in 0..tile.rows * span {
            let bits = row(y);
            for (column, count) in counts[y / span * SIDE..][..SIDE].iter_mut().enumerate() {
                *count += (bits >> (column * span) & one).count_ones() as i32;
            }
        }
        let samples = (span * span) as i32;
        counts.map(|count| (2 * count - samples).signum() as f32)
    }
}

/// The vectorised body of [`DistanceTransform::distances`].
struct AtCentres<'a> {
    transform: &'a DistanceTransform,
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
        let resolution = transform.resolution;
        let mut boundary = transform.boundary(places);
        let limit = [limit, squared_chord(limit).sqrt()];
        let mixed = transform.mixed(places);
        for (tile, mixed) in transform.tiles.iter().zip(mixed) {
            let signs = if mixed {
                transform.signs(visible, tile)
            } else {
                [transform.sign(visible, tile); LANES]
            };
            let found = boundary.nearest(simd, tile, limit);
            for row in 0..tile.rows {
                let start = (tile.y + row) * resolution + tile.x;
                let lanes = row * SIDE..row * SIDE + tile.columns;
                let signed = signs[lanes.clone()].iter().zip(&found[lanes]);
                for (distance, (sign, angle)) in distances[start..].iter_mut().zip(signed) {
                    *distance = sign * angle;
                }
            }
        }
    }
}

impl Boundary {
    #[inline(always)]
    fn new(chunks: &[&[Place]], scale: f32) -> Self {
        let padded = chunks.len().next_multiple_of(WORD);
        let mut centres = [(); 3].map(|()| vec![FAR; padded]);
        let mut radii = vec![0.0; padded];
        let mut points = Vec::with_capacity(chunks.len());
        for (index, places) in chunks.iter().enumerate() {
            let mut chunk = [[0.0; CHUNK]; 3];
            for i in 0..CHUNK {
                // What remains of a chunk repeats its last point.
                let place = places[i.min(places.len() - 1)];
                let [x, y, z] = octahedral::decode_lane(place.to_array(), scale);
                (chunk[0][i], chunk[1][i], chunk[2][i]) = (x, y, z);
            }
            let centre = chunk.map(|axis| {
                let bounds = (f32::MAX, f32::MIN);
                let (low, high) =
                    (axis.iter()).fold(bounds, |(low, high), x| (low.min(*x), high.max(*x)));
                0.5 * (low + high)
            });
            let mut largest = 0.0f32;
            for i in 0..CHUNK {
                let point = chunk.map(|axis| axis[i]);
                largest = largest.max(squared_distance(point, centre));
            }
            for (centres, centre) in centres.iter_mut().zip(centre) {
                centres[index] = centre;
            }
            radii[index] = largest.sqrt();
            points.push(chunk);
        }
        Self {
            points,
            chords: vec![0.0; padded],
            candidates: vec![0; padded],
            needed: vec![0; padded],
            centres,
            largest_radius: radii.iter().copied().fold(0.0, f32::max),
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
        let least = self.chords_from(simd, group.centre);
        let from_centre = least.sqrt();
        if from_centre - group.radius - self.largest_radius > limit_chord {
            return [limit; LANES];
        }
        // No direction of the group is farther from the boundary than this.
        let bound = (from_centre + self.largest_radius + group.radius).min(limit_chord);
        let (first, candidates) = self.choose(simd, least, bound + group.radius + SLACK);
        let mut nearest = [0.0; LANES];
        let [tx, ty, tz] = group.directions.each_ref().map(|axis| lanes::<S>(axis));
        let found = S::as_mut_simd_f32s(&mut nearest).0;
        for (((found, tx), ty), tz) in found.iter_mut().zip(tx).zip(ty).zip(tz) {
            let directions = [*tx, *ty, *tz];
            let farthest = simd.splat_f32s(limit_chord * limit_chord);
            let mut least = nearer(simd, directions, &self.points[first as usize], farthest);
            let bound = simd.add_f32s(simd.sqrt_f32s(least), simd.splat_f32s(SLACK));
            let mut count = 0;
            for &chunk in &self.candidates[..candidates] {
                let index = chunk as usize;
                let centre = self.centres.each_ref().map(|axis| axis[index]);
                let reach = simd.add_f32s(bound, simd.splat_f32s(self.radii[index]));
                let within = simd.less_than_f32s(
                    squared_chords(simd, directions, centre),
                    simd.mul_f32s(reach, reach),
                );
                // Kept without a branch, which would often be guessed wrong.
                self.needed[count] = chunk;
                count += usize::from(bits(simd, within) != 0) & usize::from(chunk != first);
            }
            for &chunk in &self.needed[..count] {
                least = nearer(simd, directions, &self.points[chunk as usize], least);
            }
            *found = least;
        }
        angles(nearest, limit)
    }

    /// Computes the chords to all centres; returns the least, squared.
    #[inline(always)]
    fn chords_from<S: Simd>(&mut self, simd: S, direction: Vec3) -> f32 {
        let [x, y, z] = self.centres.each_ref().map(|axis| lanes::<S>(axis));
        let mut least = simd.splat_f32s(f32::MAX);
        let chords = S::as_mut_simd_f32s(&mut self.chords).0;
        for (((chord, x), y), z) in chords.iter_mut().zip(x).zip(y).zip(z) {
            *chord = squared_chords(simd, [*x, *y, *z], direction.to_array());
            least = simd.min_f32s(least, *chord);
        }
        simd.reduce_min_f32s(least)
    }

    /// Finds the chunks with points within `reach`, a chord. Returns the one whose centre is
    /// at the squared chord `least`, and how many there are.
    #[inline(always)]
    fn choose<S: Simd>(&mut self, simd: S, least: f32, reach: f32) -> (u32, usize) {
        let (least, reach) = (simd.splat_f32s(least), simd.splat_f32s(reach));
        let words = lanes::<S>(&self.chords).chunks_exact(WORD / S::F32_LANES);
        let radii = lanes::<S>(&self.radii).chunks_exact(WORD / S::F32_LANES);
        let (mut nearest, mut count) = (0, 0);
        for ((chords, radii), first) in words.zip(radii).zip((0..).step_by(WORD)) {
            let (mut near, mut least_of_all) = (0, 0);
            for (i, (chord, radius)) in chords.iter().zip(radii).enumerate() {
                let reach = simd.add_f32s(reach, *radius);
                let within = simd.less_than_f32s(*chord, simd.mul_f32s(reach, reach));
                near |= bits(simd, within) << (i * S::F32_LANES);
                let equal = simd.equal_f32s(*chord, least);
                least_of_all |= bits(simd, equal) << (i * S::F32_LANES);
            }
            if least_of_all != 0 {
                nearest = first + least_of_all.trailing_zeros();
            }
            while near != 0 {
                self.candidates[count] = first + near.trailing_zeros();
                count += 1;
                near &= near - 1;
            }
        }
        (nearest, count)
    }
}

/// Squared chords from one point to a vector of them. No closure, as [`nearer`] is none: compilers may leave a closure out
/// of line, without the instructions of those that call it, which takes three times as long.
#[inline(always)]
fn squared_chords<S: Simd>(simd: S, [tx, ty, tz]: [S::f32s; 3], [x, y, z]: [f32; 3]) -> S::f32s {
    let x = simd.sub_f32s(tx, simd.splat_f32s(x));
    let y = simd.sub_f32s(ty, simd.splat_f32s(y));
    let z = simd.sub_f32s(tz, simd.splat_f32s(z));
    let squared = simd.mul_add_f32s(x, x, simd.mul_f32s(y, y));
    simd.mul_add_f32s(z, z, squared)
}

/// The least of those to the points of a chunk, and `least`.
#[inline(always)]
fn nearer<S: Simd>(
    simd: S,
    directions: [S::f32s; 3],
    [x, y, z]: &[[f32; CHUNK]; 3],
    mut least: S::f32s,
) -> S::f32s {
    for ((&x, &y), &z) in x.iter().zip(y).zip(z) {
        least = simd.min_f32s(least, squared_chords(simd, directions, [x, y, z]));
    }
    least
}

/// One bit per lane. `first_true_m32s` of pulp 0.22 counts from the wrong end with AVX-512.
#[inline(always)]
#[cfg_attr(not(target_arch = "x86_64"), expect(unused_variables))]
fn bits<S: Simd>(simd: S, mask: S::m32s) -> u64 {
    // One instruction, which compilers don't find.
    #[cfg(target_arch = "x86_64")]
    if let Some(simd) = (&simd as &dyn std::any::Any).downcast_ref::<pulp::x86::V3>() {
        let mask = bytemuck::pod_read_unaligned(bytemuck::bytes_of(&mask));
        return u64::from(simd.avx._mm256_movemask_ps(mask) as u32);
    }
    let mut bits = [0; size_of::<u64>()];
    let bytes = bytemuck::bytes_of(&mask);
    if size_of::<S::m32s>() < size_of::<S::f32s>() {
        // Lanes are bits, or there is but one.
        bits[..bytes.len()].copy_from_slice(bytes);
        return u64::from_le_bytes(bits);
    }
    let lanes = bytes.as_chunks::<4>().0.iter().enumerate();
    lanes.fold(0, |bits, (lane, bytes)| {
        bits | u64::from(bytes[0] & 1) << lane
    })
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
    let mut large = false;
    for lane in 0..LANES {
        let angle = small_angle(squared[lane]);
        angles[lane] = if angle < limit { angle } else { limit };
        large |= squared[lane] > SMALL_SQUARED_CHORD;
    }
    if large {
        // The series is for small angles.
        angles = squared.map(|squared| angle_of_squared_chord(squared).min(limit));
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

/// A direction amid others and the largest chord to one of them.
fn bounds(directions: impl Iterator<Item = Vec3> + Clone) -> (Vec3, f32) {
    let sum: Vec3 = directions.clone().sum();
    let centre = sum.normalize_or(Vec3::Y);
    let squared = directions.map(|direction| centre.distance_squared(direction));
    (centre, squared.fold(0.0, f32::max).sqrt())
}

fn squared_chord(angle: f32) -> f32 {
    (2.0 * math::sin(0.5 * angle)).powi(2)
}

fn angle_of_squared_chord(squared: f32) -> f32 {
    if squared > SMALL_SQUARED_CHORD {
        return 2.0 * math::asin((0.5 * squared.sqrt()).min(1.0));
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
    use std::cmp::Ordering;

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
                .map(|&midpoint| 2.0 * math::asin((0.5 * direction.distance(midpoint)).min(1.0)))
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
            let transform = DistanceTransform::new(&directions, resolution);
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
        let transform = DistanceTransform::new(&directions, resolution);
        let (axis, radius) = (Vec3::new(0.3, 0.8, -0.5).normalize(), 0.6f32);
        let angle = |direction: Vec3| math::acos(axis.dot(direction).clamp(-1.0, 1.0));
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
