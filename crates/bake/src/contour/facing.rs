//! Which triangles face a point, and the contour edges between those that do and those that
//! do not.
//!
//! Triangles are grouped into blocks of similar place and normal. A cone of normals and the
//! range of the planes' offsets tell for most blocks that all of their triangles face one
//! way (Johnson & Cohen 2001); only the others are looked at one by one.

use glam::{DVec3, Vec3};
use pulp::{Arch, Simd, WithSimd};

use super::Contour;

/// Triangles whose facing bits share a word.
const BLOCK: usize = 64;
/// Cones that are tested side by side.
const LANES: usize = 16;
/// How far a quarter turn of the normal counts against a distance of the scene's extent
/// when triangles are grouped.
const NORMAL_WEIGHT: f32 = 0.2;
/// Slack of the cone test against rounding, relative to the distances involved. A block
/// within it is looked at triangle by triangle.
const SLACK: f32 = 1e-5;

/// Triangles in blocks, and their edges.
pub(super) struct Facing {
    /// Planes `n·p = d` of the triangles, structure of arrays, padded to whole blocks.
    normals: [Vec<f64>; 3],
    offsets: Vec<f64>,
    cones: Vec<Cones>,
    blocks: usize,
    /// Edges between two consistently wound triangles, grouped by their pair of blocks.
    groups: Vec<Group>,
    regular: Vec<RegularEdge>,
    /// Edges of one triangle, or of several that do not pair up.
    irregular: Vec<IrregularEdge>,
}

/// Normal cones of [`LANES`] blocks: for every triangle of a block, `n·(p − c)` of a point
/// p lies between the least and the largest value of that over the cone, plus `low` or
/// `high`.
#[derive(Clone, Default)]
struct Cones {
    centre: [[f32; LANES]; 3],
    axis: [[f32; LANES]; 3],
    cosine: [f32; LANES],
    sine: [f32; LANES],
    low: [f32; LANES],
    high: [f32; LANES],
}

struct Group {
    blocks: [u32; 2],
    first_edge: u32,
}

/// The first triangle is wound along the edge, the second against it.
#[derive(Clone, Copy)]
struct RegularEdge {
    vertices: [u32; 2],
    bits: [u8; 2],
}

/// The triangles at an edge and whether each is wound along it.
struct IrregularEdge {
    vertices: [u32; 2],
    triangles: Vec<(u32, bool)>,
}

impl Facing {
    /// `triangles` index `positions`; each has an area.
    pub(super) fn new(positions: &[Vec3], triangles: Vec<[u32; 3]>) -> Self {
        let order = group(positions, &triangles);
        let blocks = order.len().div_ceil(BLOCK);
        let mut facing = Self {
            normals: [(); 3].map(|()| vec![0.0; blocks * BLOCK]),
            // Fills up the last block: such a plane faces no point.
            offsets: vec![f64::INFINITY; blocks * BLOCK],
            cones: vec![Cones::default(); blocks.div_ceil(LANES)],
            blocks,
            groups: Vec::new(),
            regular: Vec::new(),
            irregular: Vec::new(),
        };
        // Edge from lower to higher vertex, triangle, whether it is wound along that.
        let mut halves: Vec<([u32; 2], u32, bool)> = Vec::with_capacity(3 * order.len());
        for (index, &triangle) in order.iter().enumerate() {
            let vertices = triangles[triangle as usize];
            let [a, b, c] = vertices.map(|vertex| positions[vertex as usize].as_dvec3());
            let normal = (b - a).cross(c - a);
            for (out, value) in facing.normals.iter_mut().zip(normal.to_array()) {
                out[index] = value;
            }
            facing.offsets[index] = normal.dot(a);
            for i in 0..3 {
                let (from, to) = (vertices[i], vertices[(i + 1) % 3]);
                halves.push(([from.min(to), from.max(to)], index as u32, from < to));
            }
        }
        for (block, members) in order.chunks(BLOCK).enumerate() {
            let corners = members
                .iter()
                .map(|&t| triangles[t as usize].map(|v| positions[v as usize]));
            facing.cones[block / LANES].set(block % LANES, corners);
        }
        facing.add_edges(halves);
        facing
    }

    fn add_edges(&mut self, mut halves: Vec<([u32; 2], u32, bool)>) {
        halves.sort_unstable();
        let block = |triangle: u32| triangle / BLOCK as u32;
        let bit = |triangle: u32| (triangle as usize % BLOCK) as u8;
        let mut regular: Vec<([u32; 2], RegularEdge)> = Vec::new();
        for sides in halves.chunk_by(|a, b| a.0 == b.0) {
            let vertices = sides[0].0;
            match *sides {
                [(_, a, along_a), (_, b, along_b)] if along_a != along_b => {
                    let (along, against) = if along_a { (a, b) } else { (b, a) };
                    let edge = RegularEdge {
                        vertices,
                        bits: [bit(along), bit(against)],
                    };
                    regular.push(([block(along), block(against)], edge));
                }
                _ => self.irregular.push(IrregularEdge {
                    vertices,
                    triangles: sides.iter().map(|&(_, t, along)| (t, along)).collect(),
                }),
            }
        }
        regular.sort_by_key(|(blocks, _)| *blocks);
        for group in regular.chunk_by(|a, b| a.0 == b.0) {
            self.groups.push(Group {
                blocks: group[0].0,
                first_edge: self.regular.len() as u32,
            });
            self.regular.extend(group.iter().map(|(_, edge)| *edge));
        }
    }

    /// All contours seen from `eye`. `facing` is scratch memory.
    pub(super) fn find_contours(
        &self,
        eye: Vec3,
        facing: &mut Vec<u64>,
        contours: &mut Vec<Contour>,
    ) {
        facing.clear();
        facing.resize(self.blocks.next_multiple_of(LANES), 0);
        contours.clear();
        Arch::new().dispatch(FindFacing {
            mesh: self,
            eye,
            facing,
        });
        let ends = self.groups.iter().skip(1).map(|group| group.first_edge);
        let ends = ends.chain([self.regular.len() as u32]);
        for (group, end) in self.groups.iter().zip(ends) {
            let [a, b] = group.blocks.map(|block| facing[block as usize]);
            if a == b && (a == 0 || a == u64::MAX) {
                continue;
            }
            for edge in &self.regular[group.first_edge as usize..end as usize] {
                let [along, against] = [a >> edge.bits[0] & 1, b >> edge.bits[1] & 1];
                if along != against {
                    contours.push(Contour {
                        vertices: edge.vertices,
                        step: 2 * (along as i32 - against as i32),
                    });
                }
            }
        }
        for edge in &self.irregular {
            let left = |&(triangle, along): &(u32, bool)| {
                let word = facing[triangle as usize / BLOCK];
                let faces = word >> (triangle as usize % BLOCK) & 1 == 1;
                if faces == along { 1 } else { -1 }
            };
            let step = edge.triangles.iter().map(left).sum();
            if step != 0 {
                contours.push(Contour {
                    vertices: edge.vertices,
                    step,
                });
            }
        }
    }
}

impl Cones {
    fn set(&mut self, lane: usize, corners: impl Iterator<Item = [Vec3; 3]> + Clone) {
        let normal = |[a, b, c]: [Vec3; 3]| {
            let [a, b, c] = [a, b, c].map(Vec3::as_dvec3);
            (b - a).cross(c - a).normalize_or_zero()
        };
        let axis: DVec3 = corners.clone().map(normal).sum();
        let axis = axis.normalize_or_zero();
        let (low, high) = corners.clone().flatten().fold(
            (Vec3::INFINITY, Vec3::NEG_INFINITY),
            |(low, high), corner| (low.min(corner), high.max(corner)),
        );
        let centre = low.as_dvec3().midpoint(high.as_dvec3());
        let cosine = corners
            .clone()
            .map(|triangle| axis.dot(normal(triangle)))
            .fold(1.0, f64::min);
        let offsets = corners
            .clone()
            .map(|triangle| normal(triangle).dot(centre - triangle[0].as_dvec3()));
        let (least, largest) = offsets.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), x| {
            (l.min(x), h.max(x))
        });
        let slack = f64::from(SLACK) * f64::from(low.abs().max(high.abs()).max_element());
        // A cone of a right angle or more, or around no axis, tells nothing.
        let wide = cosine < 0.05;
        for i in 0..3 {
            self.centre[i][lane] = centre[i] as f32;
            self.axis[i][lane] = axis[i] as f32;
        }
        self.cosine[lane] = cosine as f32;
        self.sine[lane] = (1.0 - cosine * cosine).max(0.0).sqrt() as f32;
        self.low[lane] = if wide { f32::NEG_INFINITY } else { (least - slack) as f32 };
        self.high[lane] = if wide { f32::INFINITY } else { (largest + slack) as f32 };
    }

    /// Per block: 1 if all triangles face the eye, −1 if none does, 0 if it is unknown.
    #[inline(always)]
    fn test(&self, eye: Vec3) -> [i8; LANES] {
        let mut result = [0; LANES];
        for lane in 0..LANES {
            let x = eye.x - self.centre[0][lane];
            let y = eye.y - self.centre[1][lane];
            let z = eye.z - self.centre[2][lane];
            let [mx, my, mz] = [self.axis[0][lane], self.axis[1][lane], self.axis[2][lane]];
            let along = mx * x + my * y + mz * z;
            let [cx, cy, cz] = [my * z - mz * y, mz * x - mx * z, mx * y - my * x];
            let across = (cx * cx + cy * cy + cz * cz).sqrt();
            let slack = SLACK * (along.abs() + across);
            let middle = along * self.cosine[lane];
            let spread = across * self.sine[lane] + slack;
            let front = middle - spread + self.low[lane] > 0.0;
            let back = middle + spread + self.high[lane] < 0.0;
            result[lane] = i8::from(front) - i8::from(back);
        }
        result
    }
}

/// The vectorised body of [`Facing::find_contours`]: one bit per triangle, set where the
/// eye is in front of it.
struct FindFacing<'a> {
    mesh: &'a Facing,
    eye: Vec3,
    facing: &'a mut [u64],
}

impl WithSimd for FindFacing<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let Self { mesh, eye, facing } = self;
        let precise = eye.as_dvec3();
        for (number, (cones, words)) in (mesh.cones.iter())
            .zip(facing.chunks_exact_mut(LANES))
            .enumerate()
        {
            for (lane, (class, word)) in cones.test(eye).into_iter().zip(words).enumerate() {
                let block = number * LANES + lane;
                *word = match class {
                    1 => u64::MAX,
                    0 if block < mesh.blocks => mesh.block_facing(block, precise),
                    _ => 0,
                };
            }
        }
    }
}

impl Facing {
    #[inline(always)]
    fn block_facing(&self, block: usize, eye: DVec3) -> u64 {
        let range = block * BLOCK..(block + 1) * BLOCK;
        let [x, y, z] = [0, 1, 2].map(|axis| &self.normals[axis][range.clone()]);
        let d = &self.offsets[range];
        let mut in_front = [0u8; BLOCK];
        for (bit, ((x, y), (z, d))) in in_front
            .iter_mut()
            .zip((x.iter().zip(y)).zip(z.iter().zip(d)))
        {
            *bit = u8::from(x * eye.x + y * eye.y + z * eye.z > *d);
        }
        pack_bits(&in_front)
    }
}

#[inline(always)]
fn pack_bits(bits: &[u8; BLOCK]) -> u64 {
    let mut word = 0;
    for (byte, eight) in bits.as_chunks::<8>().0.iter().enumerate() {
        // Gathers the lowest bit of each byte into the top byte.
        let eight = u64::from_le_bytes(*eight).wrapping_mul(0x0102_0408_1020_4080) >> 56;
        word |= eight << (8 * byte);
    }
    word
}

/// An order of the triangles in which runs of [`BLOCK`] are close in place and normal:
/// recursive cuts, at multiples of the block, along the feature of largest extent.
fn group(positions: &[Vec3], triangles: &[[u32; 3]]) -> Vec<u32> {
    let (low, high) = positions.iter().fold(
        (Vec3::INFINITY, Vec3::NEG_INFINITY),
        |(low, high), position| (low.min(*position), high.max(*position)),
    );
    let scale = 1.0 / (high - low).max_element().max(f32::MIN_POSITIVE);
    let features: Vec<[f32; 6]> = triangles
        .iter()
        .map(|triangle| {
            let [a, b, c] = triangle.map(|vertex| positions[vertex as usize]);
            let centre = (a + b + c) / 3.0 * scale;
            let normal = (b - a).cross(c - a).normalize_or_zero() * NORMAL_WEIGHT;
            [centre.x, centre.y, centre.z, normal.x, normal.y, normal.z]
        })
        .collect();
    let mut order: Vec<u32> = (0..triangles.len() as u32).collect();
    cut(&mut order, &features);
    order
}

fn cut(group: &mut [u32], features: &[[f32; 6]]) {
    if group.len() <= BLOCK {
        group.sort_unstable();
        return;
    }
    let mut range = [(f32::INFINITY, f32::NEG_INFINITY); 6];
    for &triangle in group.iter() {
        for ((low, high), value) in range.iter_mut().zip(features[triangle as usize]) {
            (*low, *high) = (low.min(value), high.max(value));
        }
    }
    let extent = |axis: usize| range[axis].1 - range[axis].0;
    let axis = (0..6)
        .max_by(|&a, &b| extent(a).total_cmp(&extent(b)))
        .unwrap_or(0);
    let middle = (group.len() / 2).next_multiple_of(BLOCK);
    // Ties are broken by index: the cut does not depend on the selection's implementation.
    group.select_nth_unstable_by(middle, |&a, &b| {
        features[a as usize][axis]
            .total_cmp(&features[b as usize][axis])
            .then(a.cmp(&b))
    });
    let (lower, upper) = group.split_at_mut(middle);
    rayon::join(|| cut(lower, features), || cut(upper, features));
}
