//! Points spread over a scene's surface, evenly or closer together about what is small, and which of them is nearest.

use glam::{IVec3, Vec3};
use rayon::prelude::*;

use super::surfaces::{Piece, Place, Surfaces};
use crate::mesh::size::SizeFunction;

/// A point with a side.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Point {
    /// On the surface, world space, metres.
    pub position: Vec3,
    /// Geometric normal of the side.
    pub geometric_normal: Vec3,
    /// Shading normal of the side.
    pub normal: Vec3,
    /// Part of diffuse light that is sent on.
    pub albedo: Vec3,
}

/// Normals a quarter turn apart are as far from each other as points at this many times √2 the
/// distance between neighbours.
const NORMAL_DISTANCE: f32 = 2.0;
/// Squared distances are compared with this much to spare.
const ROUNDING: f32 = 1.001;

/// Sizes at places a spacing apart differ by this factor at most, nearly always.
const NEAR_PART: f32 = 0.8;

/// So few points are looked at one after the other: which of them are farther than the nearest takes as long to tell.
const FEW: usize = 8;
/// Hashes per point, about.
const HASHES: usize = 16;
/// What a normal has along the face that one within a spacing of it looks through, at least:
/// 1/√3 less a half, which [`NORMAL_DISTANCE`] makes a spacing.
const LEAST_ALONG: f32 = 0.07;

/// Points and a tree of them over position and normal.
pub(crate) struct Points {
    /// The points, in the order of the tree.
    all: Vec<Point>,
    /// Mean distance of neighbours where things are as large as the scene, metres; elsewhere it is as much smaller as
    /// things are.
    spacing: f32,
    sizes: SizeFunction,
    /// Position and scaled normal, in the same order: median splits along the axis in
    /// `axes`, left half before the median, right half after it.
    keys: Vec<[f32; 6]>,
    axes: Vec<u8>,
    /// By the hash of a cube of one spacing, or up to twice that, and of a face that its normals look through, the
    /// points in it and in its neighbours, among which the nearest one nearly always is; those of
    /// others with this hash do no harm (Teschner et al. 2003, "Optimized spatial hashing for
    /// collision detection").
    near: Vec<u32>,
    /// Where those of each hash begin, and the end.
    starts: Vec<u32>,
}

impl Points {
    /// About `count` points in proportion to area, in that of what is there, on fronts, and on backs
    /// too if `both` sides are asked for.
    pub(crate) fn new(surfaces: &Surfaces, sizes: &SizeFunction, count: usize, both: bool) -> Self {
        let pieces: Vec<Piece> = (in_z_order(surfaces).into_iter())
            .flat_map(|triangle| surfaces.pieces(triangle, sizes))
            .collect();
        let total: f64 = pieces.iter().map(|piece| piece.weight).sum();
        let sides = if both { 2.0 } else { 1.0 };
        let step = total * sides / count.max(1) as f64;
        let spacing = step.sqrt() as f32;
        let mut points = Vec::new();
        for place in surfaces.spread(pieces.into_iter(), step) {
            let Place {
                triangle,
                barycentrics,
                position,
            } = place;
            let geometric_normal = surfaces.geometric_normal(triangle);
            let normal = surfaces.normal(triangle, barycentrics);
            let front = Point {
                position,
                geometric_normal,
                normal,
                albedo: surfaces.albedo(triangle, barycentrics, position + normal),
            };
            points.push(front);
            if both {
                points.push(Point {
                    geometric_normal: -geometric_normal,
                    normal: -normal,
                    ..front
                });
            }
        }
        let key = |point: &Point| {
            let scale = NORMAL_DISTANCE * (spacing * sizes.part(point.position));
            let normal = point.geometric_normal * scale;
            let place = point.position;
            [place.x, place.y, place.z, normal.x, normal.y, normal.z]
        };
        let mut order: Vec<u32> = (0..points.len() as u32).collect();
        let mut axes = vec![0; points.len()];
        let keys: Vec<[f32; 6]> = points.iter().map(key).collect();
        arrange(&keys, &mut order, &mut axes);
        let mut tree = Self {
            keys: order.iter().map(|&i| keys[i as usize]).collect(),
            axes,
            all: order.iter().map(|&i| points[i as usize]).collect(),
            spacing,
            sizes: sizes.clone(),
            near: Vec::new(),
            starts: Vec::new(),
        };
        tree.spread_hashes();
        tree
    }

    /// Fills `near` and `starts`.
    fn spread_hashes(&mut self) {
        let buckets = (HASHES * self.all.len()).next_power_of_two();
        let mut pairs: Vec<(u32, u32)> = Vec::with_capacity(27 * self.all.len());
        for (index, point) in self.all.iter().enumerate() {
            let part = self.sizes.part(point.position);
            // Places of the next level may be near.
            let levels = [(part / NEAR_PART).min(1.0), part * NEAR_PART].map(level);
            for level in levels[0]..=levels[1] {
                let cube = cube(point.position, side(self.spacing, level));
                for (face, along) in faces(point.geometric_normal).into_iter().enumerate() {
                    for offset in (0..27).filter(|_| along > LEAST_ALONG) {
                        let beside = IVec3::new(offset % 3, offset / 3 % 3, offset / 9) - 1;
                        let cube = cube.wrapping_add(beside);
                        pairs.push((bucket(cube, (face, level), buckets), index as u32));
                    }
                }
            }
        }
        pairs.par_sort_unstable();
        pairs.dedup();
        self.starts = vec![0; buckets + 1];
        for (bucket, _) in &pairs {
            self.starts[*bucket as usize + 1] += 1;
        }
        for bucket in 0..buckets {
            self.starts[bucket + 1] += self.starts[bucket];
        }
        self.near = pairs.into_iter().map(|(_, index)| index).collect();
    }

    /// The points.
    pub(crate) fn as_slice(&self) -> &[Point] {
        &self.all
    }

    /// Mean distance of neighbours at a place, metres.
    pub(crate) fn spacing_at(&self, place: Vec3) -> f32 {
        self.spacing * self.sizes.part(place)
    }

    /// The point nearest to a position on a side with the given normal; `None` only where
    /// there are no points.
    pub(crate) fn nearest(&self, position: Vec3, normal: Vec3) -> Option<usize> {
        let any = (!self.all.is_empty()).then_some(0);
        // Distances that overflow are alike.
        self.nearest_within(position, normal, f32::INFINITY).or(any)
    }

    /// The same, where it is at most `reach` spacings away and its normal has a cosine of `alike` at least to the given
    /// one; where it is not, it may be found all the same, or nothing.
    pub(crate) fn nearest_alike(
        &self,
        position: Vec3,
        normal: Vec3,
        reach: f32,
        alike: f32,
    ) -> Option<usize> {
        let squared = reach * reach + NORMAL_DISTANCE * NORMAL_DISTANCE * 2.0 * (1.0 - alike);
        let spacing = self.spacing_at(position);
        let squared = ROUNDING * squared * spacing * spacing;
        self.nearest_within(position, normal, squared)
    }

    /// The nearest, if it is nearer than a squared distance.
    fn nearest_within(&self, position: Vec3, normal: Vec3, squared: f32) -> Option<usize> {
        let part = self.sizes.part(position);
        let spacing = self.spacing * part;
        let scaled = normal * (NORMAL_DISTANCE * spacing);
        let key = [
            position.x, position.y, position.z, scaled.x, scaled.y, scaled.z,
        ];
        if self.all.is_empty() {
            return None;
        }
        let along = faces(normal);
        let face = (0..6).fold(0, |best, face| {
            if along[face] > along[best] {
                face
            } else {
                best
            }
        });
        let level = level(part);
        let cube = cube(position, side(self.spacing, level));
        let bucket = bucket(cube, (face, level), self.starts.len() - 1) as usize;
        let near = &self.near[self.starts[bucket] as usize..self.starts[bucket + 1] as usize];
        // Distances are not negative, so that their bits are in order: the least without a branch.
        let packed = (near.iter())
            .map(|&index| {
                let distance = self.distance(&key, index as usize);
                u64::from(distance.to_bits()) << 32 | u64::from(index)
            })
            .fold(u64::MAX, u64::min);
        let mut best = (squared, None);
        let distance = f32::from_bits((packed >> 32) as u32);
        if packed != u64::MAX && distance < squared {
            best = (distance, Some(packed as u32 as usize));
        }
        // What lies in no neighbouring cube is farther than this.
        if best.0 > spacing * spacing {
            self.search(&key, 0, self.keys.len(), &mut best);
        }
        best.1
    }

    /// Squared, of a key and a point.
    fn distance(&self, key: &[f32; 6], index: usize) -> f32 {
        let pairs = key.iter().zip(&self.keys[index]);
        pairs.map(|(a, b)| (a - b) * (a - b)).sum()
    }

    fn search(&self, key: &[f32; 6], start: usize, end: usize, best: &mut (f32, Option<usize>)) {
        if end - start <= FEW {
            for index in start..end {
                let distance = self.distance(key, index);
                if distance < best.0 {
                    *best = (distance, Some(index));
                }
            }
            return;
        }
        let middle = start + (end - start) / 2;
        let distance = self.distance(key, middle);
        if distance < best.0 {
            *best = (distance, Some(middle));
        }
        let axis = usize::from(self.axes[middle]);
        let offset = key[axis] - self.keys[middle][axis];
        let (near, far) = if offset < 0.0 {
            ((start, middle), (middle + 1, end))
        } else {
            ((middle + 1, end), (start, middle))
        };
        self.search(key, near.0, near.1, best);
        if offset * offset < best.0 {
            self.search(key, far.0, far.1, best);
        }
    }
}

/// Sorts numbers of keys as a part of the tree is, and tells the axes of its splits.
fn arrange(keys: &[[f32; 6]], part: &mut [u32], axes: &mut [u8]) {
    if part.len() < 2 {
        return;
    }
    let range = |axis: usize| {
        let values = part.iter().map(|&i| keys[i as usize][axis]);
        let (low, high) = values.fold((f32::INFINITY, f32::NEG_INFINITY), |(low, high), x| {
            (low.min(x), high.max(x))
        });
        high - low
    };
    let axis = (0..6)
        .max_by(|&a, &b| range(a).total_cmp(&range(b)))
        .unwrap_or(0);
    part.par_sort_unstable_by(|&a, &b| {
        let (x, y) = (keys[a as usize][axis], keys[b as usize][axis]);
        x.total_cmp(&y).then(a.cmp(&b))
    });
    let middle = part.len() / 2;
    axes[middle] = axis as u8;
    let (left, right) = part.split_at_mut(middle);
    let (axes_of_left, axes_of_right) = axes.split_at_mut(middle);
    rayon::join(
        || arrange(keys, left, axes_of_left),
        || arrange(keys, &mut right[1..], &mut axes_of_right[1..]),
    );
}

/// Which cube with sides of this length a place is in.
fn cube(position: Vec3, side: f32) -> IVec3 {
    (position / side.max(f32::MIN_POSITIVE)).floor().as_ivec3()
}

/// How far a normal points along each of the six axes.
fn faces(normal: Vec3) -> [f32; 6] {
    let [x, y, z] = normal.to_array();
    [x, -x, y, -y, z, -z]
}

/// How often the whole has to be halved at most to be as small as a part of it in (0, 1]; to the least normal number.
fn level(part: f32) -> i32 {
    let below = (part.to_bits() - 1) >> 23;
    (126 - below as i32).max(0)
}

/// Side of the cubes of a level.
fn side(spacing: f32, level: i32) -> f32 {
    spacing * f32::from_bits((127 - level.min(126) as u32) << 23)
}

/// The hash of a cube and a face, of a level.
fn bucket(cube: IVec3, (face, level): (usize, i32), buckets: usize) -> u32 {
    let face = (face as i32 + 6 * level) as u32;
    let [x, y, z] = cube.to_array().map(|x| x as u32);
    let mixed =
        x.wrapping_mul(73_856_093) ^ y.wrapping_mul(19_349_663) ^ z.wrapping_mul(83_492_791);
    let mixed = mixed ^ face.wrapping_mul(0x9e37_79b9);
    (mixed ^ mixed >> 15) & (buckets as u32 - 1)
}

/// Triangles by the place of their middles on the Z-order curve (Morton 1966).
fn in_z_order(surfaces: &Surfaces) -> Vec<usize> {
    let middle = |triangle: usize| {
        let [a, b, c] = surfaces.corners(triangle);
        (a + b + c) / 3.0
    };
    let count = surfaces.triangle_count();
    let (low, high) = (0..count).map(middle).fold(
        (Vec3::INFINITY, Vec3::NEG_INFINITY),
        |(low, high), place| (low.min(place), high.max(place)),
    );
    let scale = 1023.0 / (high - low).max_element().max(f32::MIN_POSITIVE);
    let spread = |x: u32| {
        (0..10)
            .map(|bit| ((x >> bit) & 1) << (3 * bit))
            .sum::<u32>()
    };
    let code = |triangle: usize| {
        let place = (middle(triangle) - low) * scale;
        spread(place.x as u32) | spread(place.y as u32) << 1 | spread(place.z as u32) << 2
    };
    let mut keyed: Vec<(u32, usize)> = (0..count).map(|i| (code(i), i)).collect();
    keyed.sort_unstable();
    keyed.into_iter().map(|(_, triangle)| triangle).collect()
}

#[cfg(test)]
mod tests {
    use super::super::radiosity::{hash, tests::squares};
    use super::*;

    #[test]
    fn the_nearest_point_is_the_nearest_of_all() {
        // A floor, a wall, a board that hangs close above the floor, and one far away.
        let mesh = squares(
            &[
                [Vec3::ZERO, Vec3::Z, Vec3::X],
                [Vec3::ZERO, Vec3::Y, Vec3::Z],
                [Vec3::new(0.2, 0.03, 0.2), Vec3::Z, Vec3::new(0.3, 0.1, 0.0)],
                [Vec3::splat(40.0), Vec3::X, Vec3::Y],
            ],
            0.5,
            0.0,
        );
        let sizes = SizeFunction::even(mesh.diagonal());
        let points = Points::new(&Surfaces::new(&mesh), &sizes, 800, true);
        let number = |seed: u32| (hash(seed, 9) >> 8) as f32 / 16_777_216.0;
        for query in 0..4000 {
            let [x, y, z, u, v] = [0, 1, 2, 3, 4].map(|k| number(8 * query + k));
            // Near the floor, anywhere, and far from all.
            let position = Vec3::new(x, y, z)
                * [Vec3::new(1.0, 0.1, 1.0), Vec3::ONE, Vec3::splat(90.0)][query as usize % 3];
            let normal = if query % 2 == 0 {
                Vec3::Y
            } else {
                Vec3::new(u - 0.5, v - 0.4, x - 0.5).normalize()
            };
            let found = points.nearest(position, normal).expect("there are points");
            let normal = normal * (NORMAL_DISTANCE * points.spacing);
            let key = [
                position.x, position.y, position.z, normal.x, normal.y, normal.z,
            ];
            let least = (0..points.all.len())
                .map(|index| points.distance(&key, index))
                .fold(f32::INFINITY, f32::min);
            assert_eq!(points.distance(&key, found), least, "{query}");
        }
    }
}
