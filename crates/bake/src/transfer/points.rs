//! Points spread evenly over a scene's surface, and which of them is nearest.

use glam::Vec3;

use super::surfaces::Surfaces;

/// A point with a side.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Point {
    /// On the surface, world space, metres.
    pub position: Vec3,
    /// Geometric normal of the side.
    pub geometric_normal: Vec3,
    /// Shading normal of the side.
    pub normal: Vec3,
}

/// Normals a quarter turn apart are as far from each other as points at this many times √2 the
/// distance between neighbours.
const NORMAL_DISTANCE: f32 = 2.0;

/// Points and a tree of them over position and normal.
pub struct Points {
    /// The points, in the order of the tree.
    all: Vec<Point>,
    /// Mean distance of neighbours, metres.
    spacing: f32,
    /// Position and scaled normal, in the same order: median splits along the axis in
    /// `axes`, left half before the median, right half after it.
    keys: Vec<[f32; 6]>,
    axes: Vec<u8>,
}

impl Points {
    /// About `count` points in proportion to area, on fronts, and on backs too if `both` sides
    /// are asked for.
    pub fn new(surfaces: &Surfaces, count: usize, both: bool) -> Self {
        let triangles: Vec<usize> = in_z_order(surfaces);
        let areas: Vec<f64> = (triangles.iter())
            .map(|&triangle| {
                let [a, b, c] = surfaces.corners(triangle);
                0.5 * f64::from((b - a).cross(c - a).length())
            })
            .collect();
        let total: f64 = areas.iter().sum();
        let sides = if both { 2.0 } else { 1.0 };
        let spacing = (total * sides / count.max(1) as f64).sqrt() as f32;
        let mut points = Vec::new();
        // Systematic sampling: every `step` of area, from half of it on.
        let step = total * sides / count.max(1) as f64;
        let mut due = 0.5 * step;
        for (&triangle, area) in triangles.iter().zip(areas) {
            let mut number = 0u32;
            while due < area && step > 0.0 {
                let barycentrics = spread(number);
                let [a, b, c] = surfaces.corners(triangle);
                let position = a * barycentrics.x + b * barycentrics.y + c * barycentrics.z;
                let geometric_normal = surfaces.geometric_normal(triangle);
                let normal = surfaces.normal(triangle, barycentrics);
                let front = Point {
                    position,
                    geometric_normal,
                    normal,
                };
                points.push(front);
                if both {
                    points.push(Point {
                        geometric_normal: -geometric_normal,
                        normal: -normal,
                        ..front
                    });
                }
                number += 1;
                due += step;
            }
            due -= area;
        }
        let scale = NORMAL_DISTANCE * spacing;
        let key = |point: &Point| {
            let normal = point.geometric_normal * scale;
            let place = point.position;
            [place.x, place.y, place.z, normal.x, normal.y, normal.z]
        };
        let mut tree = Self {
            keys: points.iter().map(key).collect(),
            axes: vec![0; points.len()],
            all: points,
            spacing,
        };
        let mut order: Vec<u32> = (0..tree.all.len() as u32).collect();
        tree.arrange(&mut order, 0);
        tree.all = order.iter().map(|&i| tree.all[i as usize]).collect();
        tree.keys = order.iter().map(|&i| tree.keys[i as usize]).collect();
        tree
    }

    /// The points.
    pub fn as_slice(&self) -> &[Point] {
        &self.all
    }

    /// Mean distance of neighbours, metres.
    pub fn spacing(&self) -> f32 {
        self.spacing
    }

    /// Sorts the part of the tree that begins at `start`.
    fn arrange(&mut self, part: &mut [u32], start: usize) {
        if part.len() < 2 {
            return;
        }
        let range = |axis: usize| {
            let values = part.iter().map(|&i| self.keys[i as usize][axis]);
            let (low, high) = values.fold((f32::INFINITY, f32::NEG_INFINITY), |(low, high), x| {
                (low.min(x), high.max(x))
            });
            high - low
        };
        let axis = (0..6)
            .max_by(|&a, &b| range(a).total_cmp(&range(b)))
            .unwrap_or(0);
        part.sort_unstable_by(|&a, &b| {
            let (x, y) = (self.keys[a as usize][axis], self.keys[b as usize][axis]);
            x.total_cmp(&y).then(a.cmp(&b))
        });
        let middle = part.len() / 2;
        self.axes[start + middle] = axis as u8;
        let (left, right) = part.split_at_mut(middle);
        self.arrange(left, start);
        self.arrange(&mut right[1..], start + middle + 1);
    }

    /// The point nearest to a position on a side with the given normal; `None` only where
    /// there are no points.
    pub fn nearest(&self, position: Vec3, normal: Vec3) -> Option<usize> {
        let normal = normal * (NORMAL_DISTANCE * self.spacing);
        let key = [
            position.x, position.y, position.z, normal.x, normal.y, normal.z,
        ];
        let mut best = (f32::INFINITY, None);
        self.search(&key, 0, self.keys.len(), &mut best);
        best.1
    }

    fn search(&self, key: &[f32; 6], start: usize, end: usize, best: &mut (f32, Option<usize>)) {
        if start >= end {
            return;
        }
        let middle = start + (end - start) / 2;
        let distance: f32 = (key.iter().zip(&self.keys[middle]))
            .map(|(a, b)| (a - b) * (a - b))
            .sum();
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

/// Barycentrics of the points of one triangle, evenly spread (Roberts 2018, R2, folded).
fn spread(number: u32) -> Vec3 {
    let index = f64::from(number);
    let u = (0.5 + index * 0.754_877_666_246_693) % 1.0;
    let v = (0.5 + index * 0.569_840_290_998_053) % 1.0;
    let (u, v) = if u + v > 1.0 {
        (1.0 - u, 1.0 - v)
    } else {
        (u, v)
    };
    // Of a triangle's first point: its middle, not the middle of an edge.
    let (u, v) = if number == 0 {
        (1.0 / 3.0, 1.0 / 3.0)
    } else {
        (u, v)
    };
    Vec3::new((1.0 - u - v) as f32, u as f32, v as f32)
}
