//! Spherical signed distance: angle to the nearest texel of the other class.
//!
//! D(ω) is positive where ω is visible and negative where it is blocked (Wang et al. 2013,
//! §4). Half a texel is subtracted so that the zero crossing lies midway between a visible
//! texel and its blocked neighbour. The transform is exact: the texel nearest to ω among
//! those of the other class always has a neighbour of ω's class, so only such boundary
//! texels are candidates, and blocks of 8 × 8 texels share a short list of the candidates
//! that can be nearest to any of them.

use glam::{Vec2, Vec3};
use relight_shading::octahedral;

use crate::visibility::{Bitmap, Directions};

/// Texels per side of a block that shares candidates.
const BLOCK: u32 = 8;
/// Smallest magnitude: keeps the sign of a texel whose half spacing exceeds its distance,
/// radians.
const MIN_DISTANCE: f32 = 1e-4;
/// Slack of the candidate test against rounding, radians.
const ANGLE_SLACK: f32 = 1e-4;

struct Block {
    texels: Vec<u32>,
    centre: Vec3,
    /// Largest angle from the centre to a texel, radians.
    radius: f32,
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

/// Structure of arrays, so that the distance loops vectorise.
#[derive(Default)]
struct Candidates {
    x: Vec<f32>,
    y: Vec<f32>,
    z: Vec<f32>,
    texel: Vec<u32>,
}

impl Candidates {
    fn clear(&mut self) {
        self.x.clear();
        self.y.clear();
        self.z.clear();
        self.texel.clear();
    }

    fn push(&mut self, direction: Vec3, texel: u32) {
        self.x.push(direction.x);
        self.y.push(direction.y);
        self.z.push(direction.z);
        self.texel.push(texel);
    }

    /// Squared chord from `direction` to each candidate.
    fn chords(&self, direction: Vec3, chords: &mut Vec<f32>) {
        chords.clear();
        chords.extend(self.x.iter().zip(&self.y).zip(&self.z).map(|((x, y), z)| {
            let (dx, dy, dz) = (x - direction.x, y - direction.y, z - direction.z);
            dx * dx + dy * dy + dz * dz
        }));
    }
}

fn angle_of_squared_chord(squared: f32) -> f32 {
    2.0 * (0.5 * squared.sqrt()).min(1.0).asin()
}

impl Transform {
    /// Tables for maps of the directions' resolution.
    pub fn new(directions: &Directions) -> Self {
        let n = directions.resolution();
        let at = |x: u32, y: u32| y * n + x;
        let directions = directions.as_slice().to_vec();
        let neighbours = (0..n * n)
            .map(|i| {
                let (x, y) = ((i % n) as i32, (i / n) as i32);
                const STEPS: [(i32, i32); 8] = [
                    (-1, -1),
                    (0, -1),
                    (1, -1),
                    (-1, 0),
                    (1, 0),
                    (-1, 1),
                    (0, 1),
                    (1, 1),
                ];
                STEPS.map(|(dx, dy)| {
                    let (x, y) = octahedral::wrap(x + dx, y + dy, n);
                    at(x, y)
                })
            })
            .collect();
        let half_spacing = (0..n * n)
            .map(|i| {
                // Solid angle of a texel: its area on the octahedron over distance cubed.
                let uv = (Vec2::new((i % n) as f32, (i / n) as f32) + 0.5) / n as f32;
                let direction = octahedral::decode(uv);
                let radius = 1.0 / direction.abs().element_sum();
                (1.0 / n as f32) / radius.powf(1.5)
            })
            .collect();
        let blocks = (0..n.div_ceil(BLOCK))
            .flat_map(|by| (0..n.div_ceil(BLOCK)).map(move |bx| (bx * BLOCK, by * BLOCK)))
            .map(|(x0, y0)| {
                let texels: Vec<u32> = (y0..(y0 + BLOCK).min(n))
                    .flat_map(|y| (x0..(x0 + BLOCK).min(n)).map(move |x| at(x, y)))
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
                }
            })
            .collect();
        Self {
            directions,
            neighbours,
            half_spacing,
            blocks,
        }
    }

    /// The SSDF of a visibility bitmap, radians per texel, clamped to ± `limit`.
    pub fn apply(&self, visible: &Bitmap, limit: f32) -> Vec<f32> {
        let class: Vec<bool> = (0..self.directions.len()).map(|i| visible.get(i)).collect();
        // candidates[1]: blocked texels next to visible ones; they bound the visible.
        let mut candidates = [Candidates::default(), Candidates::default()];
        for (texel, neighbours) in self.neighbours.iter().enumerate() {
            if neighbours
                .iter()
                .any(|&other| class[other as usize] != class[texel])
            {
                let list = &mut candidates[usize::from(!class[texel])];
                list.push(self.directions[texel], texel as u32);
            }
        }
        let mut distances = vec![0.0; self.directions.len()];
        let (mut near, mut chords) = (Candidates::default(), Vec::new());
        for block in &self.blocks {
            for (sign, side) in [(-1.0, false), (1.0, true)] {
                let members = || block.texels.iter().filter(|&&i| class[i as usize] == side);
                if members().next().is_none() {
                    continue;
                }
                let all = &candidates[usize::from(side)];
                all.chords(block.centre, &mut chords);
                let nearest = chords.iter().copied().fold(f32::INFINITY, f32::min);
                let reach = angle_of_squared_chord(nearest.min(4.0)) + ANGLE_SLACK;
                // Half a spacing is subtracted below, at most a texel's diameter.
                if nearest == f32::INFINITY || reach - 2.0 * block.radius > limit + 0.1 {
                    members().for_each(|&i| distances[i as usize] = sign * limit);
                    continue;
                }
                let widest = (reach + 2.0 * block.radius).min(std::f32::consts::PI);
                let widest_chord = (2.0 * (0.5 * widest).sin()).powi(2);
                near.clear();
                for (index, &chord) in chords.iter().enumerate() {
                    if chord <= widest_chord {
                        let texel = all.texel[index];
                        near.push(self.directions[texel as usize], texel);
                    }
                }
                for &texel in members() {
                    near.chords(self.directions[texel as usize], &mut chords);
                    let (mut best, mut chord) = (0, f32::INFINITY);
                    for (index, &candidate) in chords.iter().enumerate() {
                        if candidate < chord {
                            (best, chord) = (index, candidate);
                        }
                    }
                    let half = self.half_spacing[near.texel[best] as usize];
                    let distance = angle_of_squared_chord(chord) - half;
                    distances[texel as usize] = sign * distance.clamp(MIN_DISTANCE, limit);
                }
            }
        }
        distances
    }
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
                    .map(|j| (directions[i].distance_squared(directions[j]), j))
                    .min_by(|a, b| a.0.total_cmp(&b.0));
                let distance = nearest.map_or(limit, |(chord, j)| {
                    (angle_of_squared_chord(chord) - transform.half_spacing[j])
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

    /// Both sides use the same formula; only the choice among candidates at equal distance
    /// up to rounding may differ, which moves the half spacing by less than this, radians.
    const TIE_TOLERANCE: f32 = 2e-3;

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
                            (a - b).abs() < TIE_TOLERANCE,
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
