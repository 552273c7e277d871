//! Spherical signed distance: angle to the nearest texel of the other class.
//!
//! D(ω) is positive where ω is visible and negative where it is blocked (Wang et al. 2013,
//! §4). Half a texel is subtracted so that the zero crossing lies midway between a visible
//! texel and its blocked neighbour. The transform is exact: the texel nearest to ω among
//! those of the other class always has a neighbour of ω's class, so only such boundary
//! texels are candidates, and blocks of texels share a short list of the candidates that
//! can be nearest to any of them.

use glam::{Vec2, Vec3};
use pulp::{Arch, Simd, WithSimd};
use relight_shading::octahedral;

use crate::visibility::{Bitmap, Directions};

/// Texels per side of the blocks that share candidates, coarse to fine. Each level picks
/// from the list of the level above.
const BLOCKS: [u32; 2] = [16, 4];
/// Smallest magnitude: keeps the sign of a texel whose half spacing exceeds its distance,
/// radians.
const MIN_DISTANCE: f32 = 1e-4;
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

/// Tables for the transform at one resolution.
pub struct Transform {
    directions: Vec<Vec3>,
    /// The up to eight neighbours of each texel, across the map's border.
    neighbours: Vec<[u32; 8]>,
    /// Half the spacing between texels about each texel, radians.
    half_spacing: Vec<f32>,
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
        let (x, y, z) = (x[lane] - direction.x, y[lane] - direction.y, z[lane] - direction.z);
        *squared = x * x + y * y + z * z;
    }
    squared
}

#[inline(always)]
fn angle_of_squared_chord(squared: f32) -> f32 {
    2.0 * (0.5 * squared.sqrt()).min(1.0).asin()
}

impl Transform {
    /// Tables for maps of the directions' resolution.
    pub fn new(directions: &Directions) -> Self {
        const STEPS: [(i32, i32); 8] =
            [(-1, -1), (0, -1), (1, -1), (-1, 0), (1, 0), (-1, 1), (0, 1), (1, 1)];
        let n = directions.resolution();
        let directions = directions.as_slice();
        let neighbours = (0..n * n)
            .map(|i| {
                STEPS.map(|(dx, dy)| {
                    let (x, y) = ((i % n) as i32 + dx, (i / n) as i32 + dy);
                    let (x, y) = octahedral::wrap(x, y, n);
                    y * n + x
                })
            })
            .collect();
        let half_spacing = (0..n * n)
            .map(|i| {
                // Solid angle of a texel: its area on the octahedron over distance cubed.
                let uv = (Vec2::new((i % n) as f32, (i / n) as f32) + 0.5) / n as f32;
                let radius = 1.0 / octahedral::decode(uv).abs().element_sum();
                (1.0 / n as f32) / radius.powf(1.5)
            })
            .collect();
        Self {
            directions: directions.to_vec(),
            neighbours,
            half_spacing,
            blocks: blocks(directions, n, (0, 0, n), &BLOCKS),
        }
    }

    /// The SSDF of a visibility bitmap, radians per texel, clamped to ± `limit`.
    pub fn apply(&self, visible: &Bitmap, limit: f32) -> Vec<f32> {
        let class: Vec<bool> = (0..self.directions.len()).map(|i| visible.get(i)).collect();
        // The first are visible texels next to blocked ones, which bound the blocked.
        let mut candidates = [Candidates::default(), Candidates::default()];
        for (texel, neighbours) in self.neighbours.iter().enumerate() {
            if neighbours.iter().any(|&other| class[other as usize] != class[texel]) {
                let list = &mut candidates[usize::from(!class[texel])];
                list.push(self.directions[texel].to_array());
            }
        }
        let mut distances = vec![0.0; self.directions.len()];
        Arch::new().dispatch(ApplyBlocks {
            transform: self,
            class: &class,
            candidates: &candidates,
            limit,
            distances: &mut distances,
        });
        distances
    }

    #[inline(always)]
    fn apply_block(
        &self,
        block: &Block,
        side: bool,
        class: &[bool],
        candidates: &Candidates,
        near: &mut Candidates,
        limit: f32,
        distances: &mut [f32],
    ) {
        let members = || block.texels.iter().filter(|&&i| class[i as usize] == side);
        if members().next().is_none() {
            return;
        }
        let sign = if side { 1.0 } else { -1.0 };
        let nearest = angle_of_squared_chord(candidates.select(block, near));
        // Half a spacing, at most a block's radius, is subtracted from what is compared.
        if near.count == 0 || nearest - 2.0 * block.radius > limit {
            members().for_each(|&i| distances[i as usize] = sign * limit);
            return;
        }
        for &texel in members() {
            let squared = near.nearest(self.directions[texel as usize]);
            let distance = angle_of_squared_chord(squared) - self.half_spacing[texel as usize];
            distances[texel as usize] = sign * distance.clamp(MIN_DISTANCE, limit);
        }
    }
}

/// The vectorised part of [`Transform::apply`].
struct ApplyBlocks<'a> {
    transform: &'a Transform,
    class: &'a [bool],
    candidates: &'a [Candidates; 2],
    limit: f32,
    distances: &'a mut [f32],
}

impl WithSimd for ApplyBlocks<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let Self { transform, class, candidates, limit, distances } = self;
        let mut lists = [Candidates::default(), Candidates::default()];
        for (side, candidates) in candidates.iter().enumerate() {
            let side = side == 1;
            for block in &transform.blocks {
                if !block.texels.iter().any(|&i| class[i as usize] == side) {
                    continue;
                }
                let [coarse, fine] = &mut lists;
                candidates.select(block, coarse);
                for block in &block.children {
                    transform.apply_block(block, side, class, coarse, fine, limit, distances);
                }
            }
        }
    }
}

/// Divides the square region (x, y, side) of an `n` × `n` map into blocks of `sizes[0]`
/// texels per side, and those into finer ones.
fn blocks(directions: &[Vec3], n: u32, (x0, y0, side): (u32, u32, u32), sizes: &[u32]) -> Vec<Block> {
    let Some((&size, finer)) = sizes.split_first() else { return Vec::new() };
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

    fn brute_force(transform: &Transform, visible: &Bitmap, limit: f32) -> Vec<f32> {
        let directions = &transform.directions;
        (0..directions.len())
            .map(|i| {
                let sign = if visible.get(i) { 1.0 } else { -1.0 };
                let nearest = (0..directions.len())
                    .filter(|&j| visible.get(j) != visible.get(i))
                    .map(|j| directions[i].distance_squared(directions[j]))
                    .min_by(f32::total_cmp);
                let distance = nearest.map_or(limit, |squared| {
                    (angle_of_squared_chord(squared) - transform.half_spacing[i])
                        .clamp(MIN_DISTANCE, limit)
                });
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

    /// Both sides evaluate the same formula on the same nearest texel; wider registers may
    /// round its last bits otherwise, radians.
    const ROUNDING: f32 = 1e-6;

    #[test]
    fn equals_brute_force() {
        for resolution in [16, 48] {
            let directions = Directions::new(resolution);
            let transform = Transform::new(&directions);
            for (number, bitmap) in patterns(&directions).iter().enumerate() {
                for limit in [0.5, std::f32::consts::PI] {
                    let fast = transform.apply(bitmap, limit);
                    let exact = brute_force(&transform, bitmap, limit);
                    for (i, (a, b)) in fast.iter().zip(&exact).enumerate() {
                        assert!(
                            (a - b).abs() < ROUNDING,
                            "pattern {number}, {resolution}², limit {limit}, texel {i}: {a} instead of {b}"
                        );
                    }
                }
            }
        }
    }

    #[test]
    fn nearest_opposite_texel_is_always_next_to_the_own_class() {
        // Greedy descent: from any texel some neighbour is nearer to any other texel.
        let directions = Directions::new(24);
        let transform = Transform::new(&directions);
        for (p, &from) in directions.as_slice().iter().enumerate() {
            for (q, &to) in directions.as_slice().iter().enumerate() {
                let distance = from.distance_squared(to);
                let nearer =
                    |&r: &u32| from.distance_squared(directions.as_slice()[r as usize]) < distance;
                assert!(
                    p == q || transform.neighbours[q].iter().any(nearer),
                    "{p} {q}"
                );
            }
        }
    }

    #[test]
    fn matches_the_distance_to_an_analytic_cap() {
        let directions = Directions::new(128);
        let transform = Transform::new(&directions);
        let (axis, radius) = (Vec3::new(0.3, 0.8, -0.5).normalize(), 0.6f32);
        let angle = |direction: Vec3| axis.dot(direction).clamp(-1.0, 1.0).acos();
        let texels = directions.as_slice();
        let bitmap = Bitmap::from_fn(texels.len(), |i| angle(texels[i]) > radius);
        let distances = transform.apply(&bitmap, std::f32::consts::PI);
        let exact: Vec<f32> = texels.iter().map(|&d| angle(d) - radius).collect();
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
        assert!(mean.abs() < 0.001, "the zero crossing lies {mean} off");
    }
}
