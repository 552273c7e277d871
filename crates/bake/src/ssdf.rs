//! Spherical signed distance: angle to the nearest texel of the other class.
//!
//! D(ω) is positive where ω is visible and negative where it is blocked (Wang et al. 2013,
//! §4). The boundary is where visibility was seen to change: the midpoints between
//! neighbouring sample texels of different class. |D| is the angle to the nearest of them,
//! found exactly: blocks of texels share a short list of the midpoints that can be nearest
//! to any of them.
//!
//! The distances may be wanted at fewer texels than were sampled. A texel then spans a
//! block of samples, and its sign is their mean class: ±1 away from the boundary, and
//! between where the boundary crosses the block, so that the zero crossing stays unbiased.

use glam::Vec3;
use pulp::{Arch, Simd, WithSimd};
use relight_shading::octahedral;

use crate::visibility::{Bitmap, Directions};

/// Texels per side of the blocks that share candidates, coarse to fine. Each level picks
/// from the list of the level above.
const BLOCKS: [u32; 2] = [16, 4];
/// Slack of the candidate test against rounding, radians.
const ANGLE_SLACK: f32 = 1e-4;
/// Distances computed side by side.
const LANES: usize = 16;

/// Texels that share candidates, and the finer blocks they consist of.
struct Block {
    texels: Vec<u32>,
    centre: Vec3,
    /// Largest angle from the centre to a texel, radians.
    radius: f32,
    children: Vec<Block>,
}

/// Tables for the transform between two resolutions.
pub struct Transform {
    /// Texels per side of the visibility bitmap.
    sample_resolution: u32,
    /// Directions of the texels that distances are wanted at.
    directions: Vec<Vec3>,
    /// Every pair of neighbouring sample texels, across the map's border too, and the
    /// direction midway between them.
    links: Vec<([u32; 2], [f32; 3])>,
    blocks: Vec<Block>,
}

/// Directions as a structure of arrays in groups of [`LANES`], so that the distance loops
/// vectorise. The last group is filled with points far from the sphere.
#[derive(Default)]
struct Candidates {
    groups: Vec<[[f32; LANES]; 3]>,
    count: usize,
}

impl Candidates {
    fn clear(&mut self) {
        self.groups.clear();
        self.count = 0;
    }

    #[inline(always)]
    fn push(&mut self, direction: [f32; 3]) {
        let lane = self.count % LANES;
        if lane == 0 {
            self.groups.push([[1e3; LANES]; 3]);
        }
        if let Some(group) = self.groups.last_mut() {
            for (axis, value) in group.iter_mut().zip(direction) {
                axis[lane] = value;
            }
        }
        self.count += 1;
    }

    /// Smallest squared chord from `direction` to a candidate; infinite if there is none.
    #[inline(always)]
    fn nearest(&self, direction: Vec3) -> f32 {
        let mut least = [f32::INFINITY; LANES];
        for group in &self.groups {
            for (least, squared) in least.iter_mut().zip(squared_chords(group, direction)) {
                *least = if squared < *least { squared } else { *least };
            }
        }
        least.into_iter().fold(f32::INFINITY, f32::min)
    }

    /// The candidates that can be nearest to some direction of a block, into `out`, and the
    /// squared chord from the block's centre to the nearest one.
    #[inline(always)]
    fn select(&self, block: &Block, out: &mut Self) -> f32 {
        out.clear();
        let nearest = self.nearest(block.centre);
        let reach = angle_of_squared_chord(nearest) + ANGLE_SLACK + 2.0 * block.radius;
        let widest = (2.0 * (0.5 * reach.min(std::f32::consts::PI)).sin()).powi(2);
        for group in &self.groups {
            let squared = squared_chords(group, block.centre);
            let mut inside = [false; LANES];
            for (inside, squared) in inside.iter_mut().zip(squared) {
                *inside = squared <= widest;
            }
            if inside == [false; LANES] {
                continue;
            }
            for (lane, _) in inside.iter().enumerate().filter(|(_, inside)| **inside) {
                out.push([group[0][lane], group[1][lane], group[2][lane]]);
            }
        }
        nearest
    }
}

#[inline(always)]
fn squared_chords([x, y, z]: &[[f32; LANES]; 3], direction: Vec3) -> [f32; LANES] {
    let mut squared = [0.0; LANES];
    for (lane, squared) in squared.iter_mut().enumerate() {
        let (x, y, z) = (
            x[lane] - direction.x,
            y[lane] - direction.y,
            z[lane] - direction.z,
        );
        *squared = x * x + y * y + z * z;
    }
    squared
}

#[inline(always)]
fn angle_of_squared_chord(squared: f32) -> f32 {
    let quarter = 0.25 * squared;
    if quarter > 0.0625 {
        return 2.0 * quarter.sqrt().min(1.0).asin();
    }
    // The series of the arcsine, to the last bit of single precision this near to zero.
    let series =
        1.0 / 6.0 + quarter * (3.0 / 40.0 + quarter * (15.0 / 336.0 + quarter * (105.0 / 3456.0)));
    2.0 * quarter.sqrt() * (1.0 + quarter * series)
}

impl Transform {
    /// Tables from bitmaps of the resolution of `samples` to distances at `resolution`
    /// squared texels. `resolution` must divide that of the samples.
    pub fn new(samples: &Directions, resolution: u32) -> Self {
        let n = samples.resolution();
        assert!(
            n.is_multiple_of(resolution),
            "{resolution} does not divide {n}"
        );
        let mut pairs: Vec<[u32; 2]> = (0..n * n)
            .flat_map(|i| {
                let (x, y) = ((i % n) as i32, (i / n) as i32);
                [(x - 1, y), (x + 1, y), (x, y - 1), (x, y + 1)].map(|(x, y)| {
                    let (x, y) = octahedral::wrap(x, y, n);
                    let other = y * n + x;
                    [i.min(other), i.max(other)]
                })
            })
            .collect();
        pairs.sort_unstable();
        pairs.dedup();
        let links = pairs
            .into_iter()
            .map(|pair| {
                let [a, b] = pair.map(|texel| samples.as_slice()[texel as usize]);
                (pair, (a + b).normalize().to_array())
            })
            .collect();
        let directions = Directions::new(resolution).as_slice().to_vec();
        let blocks = blocks(&directions, resolution, (0, 0, resolution), &BLOCKS);
        Self {
            sample_resolution: n,
            directions,
            links,
            blocks,
        }
    }

    /// The SSDF of a visibility bitmap, radians per texel, clamped to ± `limit`.
    pub fn apply(&self, visible: &Bitmap, limit: f32) -> Vec<f32> {
        let samples = self.sample_resolution.pow(2) as usize;
        let class: Vec<bool> = (0..samples).map(|i| visible.get(i)).collect();
        let mut boundary = Candidates::default();
        for ([a, b], midpoint) in &self.links {
            if class[*a as usize] != class[*b as usize] {
                boundary.push(*midpoint);
            }
        }
        let mut distances = self.mean_class(&class);
        Arch::new().dispatch(ApplyBlocks {
            transform: self,
            boundary: &boundary,
            limit,
            distances: &mut distances,
        });
        distances
    }

    /// Mean of ±1 over the samples that each texel spans.
    fn mean_class(&self, class: &[bool]) -> Vec<f32> {
        let n = self.sample_resolution as usize;
        let resolution = self.directions.len().isqrt();
        let span = n / resolution;
        let step = 2.0 / (span * span) as f32;
        let mut mean = vec![-1.0; self.directions.len()];
        for (y, row) in class.chunks_exact(n).enumerate() {
            let out = &mut mean[y / span * resolution..][..resolution];
            for (out, samples) in out.iter_mut().zip(row.chunks_exact(span)) {
                *out += step * samples.iter().filter(|&&visible| visible).count() as f32;
            }
        }
        mean
    }

    #[inline(always)]
    fn apply_block(
        &self,
        block: &Block,
        boundary: &Candidates,
        near: &mut Candidates,
        limit: f32,
        distances: &mut [f32],
    ) {
        let nearest = angle_of_squared_chord(boundary.select(block, near));
        if near.count == 0 || nearest - block.radius > limit {
            block
                .texels
                .iter()
                .for_each(|&i| distances[i as usize] *= limit);
            return;
        }
        for &texel in &block.texels {
            let squared = near.nearest(self.directions[texel as usize]);
            distances[texel as usize] *= angle_of_squared_chord(squared).min(limit);
        }
    }
}

/// The vectorised part of [`Transform::apply`]: multiplies signs by distances.
struct ApplyBlocks<'a> {
    transform: &'a Transform,
    boundary: &'a Candidates,
    limit: f32,
    distances: &'a mut [f32],
}

impl WithSimd for ApplyBlocks<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let Self {
            transform,
            boundary,
            limit,
            distances,
        } = self;
        let [mut coarse, mut fine] = [Candidates::default(), Candidates::default()];
        for block in &transform.blocks {
            boundary.select(block, &mut coarse);
            for block in &block.children {
                transform.apply_block(block, &coarse, &mut fine, limit, distances);
            }
        }
    }
}

/// Divides the square region (x, y, side) of an `n` × `n` map into blocks of `sizes[0]`
/// texels per side, and those into finer ones.
fn blocks(
    directions: &[Vec3],
    n: u32,
    (x0, y0, side): (u32, u32, u32),
    sizes: &[u32],
) -> Vec<Block> {
    let Some((&size, finer)) = sizes.split_first() else {
        return Vec::new();
    };
    let starts = || (0..side.div_ceil(size)).map(|i| i * size);
    starts()
        .flat_map(|y| starts().map(move |x| (x0 + x, y0 + y)))
        .filter(|&(x, y)| x < n && y < n)
        .map(|(x0, y0)| {
            let texels: Vec<u32> = (y0..(y0 + size).min(n))
                .flat_map(|y| (x0..(x0 + size).min(n)).map(move |x| y * n + x))
                .collect();
            let sum: Vec3 = texels.iter().map(|&i| directions[i as usize]).sum();
            let centre = sum.normalize();
            let radius = texels
                .iter()
                .map(|&i| centre.distance_squared(directions[i as usize]))
                .fold(0.0, f32::max);
            Block {
                texels,
                centre,
                radius: angle_of_squared_chord(radius),
                children: blocks(directions, n, (x0, y0, size), finer),
            }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn brute_force(
        samples: &Directions,
        resolution: u32,
        visible: &Bitmap,
        limit: f32,
    ) -> Vec<f32> {
        let n = samples.resolution() as i32;
        let at = |x: i32, y: i32| {
            let (x, y) = octahedral::wrap(x, y, n as u32);
            (y * n as u32 + x) as usize
        };
        let mut midpoints = Vec::new();
        for (x, y) in (0..n * n).map(|i| (i % n, i / n)) {
            for (dx, dy) in [(-1, 0), (1, 0), (0, -1), (0, 1)] {
                let (a, b) = (at(x, y), at(x + dx, y + dy));
                if visible.get(a) != visible.get(b) {
                    midpoints.push((samples.as_slice()[a] + samples.as_slice()[b]).normalize());
                }
            }
        }
        let span = n / resolution as i32;
        (0..(resolution * resolution) as i32)
            .map(|i| {
                let (x, y) = (i % resolution as i32, i / resolution as i32);
                let block = (0..span * span).map(|j| at(x * span + j % span, y * span + j / span));
                let visible = block.filter(|&texel| visible.get(texel)).count();
                let sign = 2.0 * visible as f32 / (span * span) as f32 - 1.0;
                let direction = octahedral::texel_direction(x as u32, y as u32, resolution);
                let distance = midpoints
                    .iter()
                    .map(|&midpoint| 2.0 * (0.5 * direction.distance(midpoint)).min(1.0).asin())
                    .fold(limit, f32::min);
                sign * distance
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
    /// radians.
    const ROUNDING: f32 = 2e-6;

    #[test]
    fn equals_brute_force() {
        for (samples, resolution) in [(16, 16), (48, 24), (64, 16)] {
            let directions = Directions::new(samples);
            let transform = Transform::new(&directions, resolution);
            for (number, bitmap) in patterns(&directions).iter().enumerate() {
                for limit in [0.5, std::f32::consts::PI] {
                    let fast = transform.apply(bitmap, limit);
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
        let distances = transform.apply(&bitmap, std::f32::consts::PI);
        let exact: Vec<f32> = transform
            .directions
            .iter()
            .map(|&d| angle(d) - radius)
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
