//! Which triangles face a point, and the contour edges between those that do and those that
//! do not.
//!
//! Triangles are grouped into blocks of similar place and normal. A cone of normals and the
//! range of the planes' offsets tell for most blocks that all of their triangles face one
//! way (Johnson & Cohen 2001); only the others are looked at one by one.

use std::ops::Range;

use glam::{DVec3, Vec3};
use pulp::{Arch, Simd, WithSimd};

use super::Contour;

/// Triangles that are tested together; their edges are grouped by it.
const BLOCK: usize = 64;
/// Cones that are tested side by side.
const LANES: usize = 16;
/// How far a quarter turn of the normal counts against a distance of the scene's extent
/// when triangles are grouped.
const NORMAL_WEIGHT: f32 = 0.1;
/// Slack of the cone test against rounding, relative to the distances involved. A block
/// within it is looked at triangle by triangle.
const SLACK: f32 = 1e-5;
/// Bounds the rounding of a plane's offset and of its product with a point in single
/// precision, relative to their size: a few units in the last place.
const PLANE_ROUNDING: f32 = 1e-6;
/// Edges whose contours are collected together; at most 256, a power of two.
const CHUNK: usize = 128;

/// Triangles in blocks, and their edges.
pub(super) struct Facing {
    /// Planes `n·p = d` of the triangles with unit normals, structure of arrays, padded to
    /// whole blocks.
    planes: [Vec<f32>; 4],
    /// The same to double precision, for eyes close to a plane; normals of any length.
    precise: Vec<[f64; 4]>,
    /// Vertices of every triangle, in the order of the planes.
    corners: Vec<[u32; 3]>,
    /// Bounds the rounding of the planes in single precision for an eye at the origin;
    /// grows with the eye's distance from it.
    rounding: f32,
    cones: Vec<Cones>,
    blocks: usize,
    /// Edges between two triangles of one block, block after block, and where each block's
    /// begin; triangles as numbers in their block.
    inner: Edges<u8>,
    first_inner: Vec<u32>,
    /// Edges between triangles of different blocks.
    outer: Edges<u32>,
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

/// Edges between two triangles: the first is wound along the edge, the second against it.
struct Edges<T> {
    triangles: Vec<[T; 2]>,
    vertices: Vec<[u32; 2]>,
}

/// The triangles at an edge and whether each is wound along it.
struct IrregularEdge {
    vertices: [u32; 2],
    triangles: Vec<(u32, bool)>,
}

impl Facing {
    /// `triangles` index `positions`; each has an area.
    pub(super) fn new(positions: &[Vec3], triangles: &[[u32; 3]]) -> Self {
        let order = group(positions, triangles);
        let blocks = order.len().div_ceil(BLOCK);
        let mut facing = Self {
            planes: [(); 4].map(|()| vec![0.0; blocks * BLOCK]),
            precise: vec![[0.0; 4]; blocks * BLOCK],
            corners: order
                .iter()
                .map(|&triangle| triangles[triangle as usize])
                .collect(),
            rounding: 0.0,
            cones: vec![Cones::default(); blocks.div_ceil(LANES)],
            blocks,
            inner: Edges::new(),
            first_inner: Vec::new(),
            outer: Edges::new(),
            irregular: Vec::new(),
        };
        // Edge from lower to higher vertex, triangle, whether it is wound along that.
        let mut halves: Vec<([u32; 2], u32, bool)> = Vec::with_capacity(3 * order.len());
        for (index, &triangle) in order.iter().enumerate() {
            let vertices = triangles[triangle as usize];
            let [a, b, c] = vertices.map(|vertex| positions[vertex as usize].as_dvec3());
            let normal = (b - a).cross(c - a);
            facing.precise[index] = normal.extend(normal.dot(a)).to_array();
            let unit = normal.normalize();
            let plane = unit.extend(unit.dot(a)).as_vec4();
            for (out, value) in facing.planes.iter_mut().zip(plane.to_array()) {
                out[index] = value;
            }
            facing.rounding = facing.rounding.max(PLANE_ROUNDING * plane.w.abs());
            for i in 0..3 {
                let (from, to) = (vertices[i], vertices[(i + 1) % 3]);
                halves.push(([from.min(to), from.max(to)], index as u32, from < to));
            }
        }
        for (block, members) in order.chunks(BLOCK).enumerate() {
            let corners = members
                .iter()
                .map(|&t| triangles[t as usize].map(|v| positions[v as usize]));
            facing.cones[block / LANES].set(block % LANES, &corners);
        }
        facing.add_edges(halves);
        facing
    }

    fn add_edges(&mut self, mut halves: Vec<([u32; 2], u32, bool)>) {
        halves.sort_unstable();
        // Triangles, vertices: in the order of the triangles.
        let mut regular: Vec<([u32; 2], [u32; 2])> = Vec::new();
        for sides in halves.chunk_by(|a, b| a.0 == b.0) {
            let vertices = sides[0].0;
            match *sides {
                [(_, a, along_a), (_, b, along_b)] if along_a != along_b => {
                    regular.push((if along_a { [a, b] } else { [b, a] }, vertices));
                }
                _ => self.irregular.push(IrregularEdge {
                    vertices,
                    triangles: sides.iter().map(|&(_, t, along)| (t, along)).collect(),
                }),
            }
        }
        regular.sort_unstable();
        for (triangles, vertices) in regular {
            let [a, b] = triangles.map(|triangle| triangle as usize / BLOCK);
            if a == b {
                let begun = self.inner.vertices.len() as u32;
                self.first_inner
                    .resize(self.first_inner.len().max(a + 1), begun);
                self.inner
                    .triangles
                    .push(triangles.map(|t| (t as usize % BLOCK) as u8));
                self.inner.vertices.push(vertices);
            } else {
                self.outer.triangles.push(triangles);
                self.outer.vertices.push(vertices);
            }
        }
        let end = self.inner.vertices.len() as u32;
        self.first_inner.resize(self.blocks + 1, end);
    }

    /// All contours seen from `eye`. `faces` is scratch memory.
    pub(super) fn find_contours(&self, eye: Vec3, faces: &mut Faces, contours: &mut Vec<Contour>) {
        faces.triangles.resize(self.blocks * BLOCK, 0);
        faces.mixed.clear();
        faces.in_plane.clear();
        contours.clear();
        Arch::new().dispatch(FindFaces {
            mesh: self,
            eye,
            faces,
        });
        for &block in &faces.mixed {
            let block = block as usize;
            let range = self.first_inner[block] as usize..self.first_inner[block + 1] as usize;
            let members = &faces.triangles[block * BLOCK..(block + 1) * BLOCK];
            let face = |triangle: u8| members[usize::from(triangle) % BLOCK];
            self.inner.collect(range, face, contours);
        }
        let face = |triangle: u32| faces.triangles[triangle as usize];
        self.outer
            .collect(0..self.outer.vertices.len(), face, contours);
        for edge in &self.irregular {
            let left = |&(triangle, along): &(u32, bool)| {
                if (face(triangle) == 1) == along {
                    1
                } else {
                    -1
                }
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

impl<T: Copy> Edges<T> {
    fn new() -> Self {
        Self {
            triangles: Vec::new(),
            vertices: Vec::new(),
        }
    }

    /// Appends those edges of `range` of which one triangle faces the eye and one does not.
    #[inline(always)]
    fn collect(&self, range: Range<usize>, face: impl Fn(T) -> u8, contours: &mut Vec<Contour>) {
        let mut found = [0; CHUNK];
        let vertices = self.vertices[range.clone()].chunks(CHUNK);
        for (triangles, vertices) in self.triangles[range].chunks(CHUNK).zip(vertices) {
            // Collected without a branch, which would often be guessed wrong.
            let mut count = 0;
            for (index, pair) in triangles.iter().enumerate() {
                found[count % CHUNK] = index as u8;
                count += usize::from(face(pair[0]) ^ face(pair[1]));
            }
            contours.extend(found[..count].iter().map(|&index| Contour {
                vertices: vertices[usize::from(index)],
                step: 4 * i32::from(face(triangles[usize::from(index)][0])) - 2,
            }));
        }
    }
}

/// Which triangles face the eye.
#[derive(Default)]
pub(super) struct Faces {
    /// 1 or 0 per triangle.
    triangles: Vec<u8>,
    /// Blocks whose triangles may differ.
    mixed: Vec<u32>,
    /// Triangles whose planes the eye lies in, but for rounding.
    in_plane: Vec<u32>,
}

impl Cones {
    fn set(&mut self, lane: usize, corners: &(impl Iterator<Item = [Vec3; 3]> + Clone)) {
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
        self.low[lane] = if wide {
            f32::NEG_INFINITY
        } else {
            (least - slack) as f32
        };
        self.high[lane] = if wide {
            f32::INFINITY
        } else {
            (largest + slack) as f32
        };
    }

    /// Per block: 1 if all triangles face the eye, −1 if none does, 0 if it is unknown.
    #[inline(always)]
    fn test(&self, eye: Vec3) -> [i8; LANES] {
        let mut result = [0; LANES];
        for (lane, class) in result.iter_mut().enumerate() {
            let x = eye.x - self.centre[0][lane];
            let y = eye.y - self.centre[1][lane];
            let z = eye.z - self.centre[2][lane];
            let [mx, my, mz] = [self.axis[0][lane], self.axis[1][lane], self.axis[2][lane]];
            let along = mx * x + my * y + mz * z;
            let [cx, cy, cz] = [my * z - mz * y, mz * x - mx * z, mx * y - my * x];
            let across = (cx * cx + cy * cy + cz * cz).sqrt();
            let length = (along * along + across * across).sqrt();
            let (cosine, sine) = (self.cosine[lane], self.sine[lane]);
            // Extremes over the cone; at its axis' or the opposite side if that is inside.
            let least = if along < -length * cosine {
                -length
            } else {
                along * cosine - across * sine
            };
            let largest = if along > length * cosine {
                length
            } else {
                along * cosine + across * sine
            };
            let slack = SLACK * length;
            let front = least - slack + self.low[lane] > 0.0;
            let back = largest + slack + self.high[lane] < 0.0;
            *class = i8::from(front) - i8::from(back);
        }
        result
    }
}

/// The vectorised body of [`Facing::find_contours`].
struct FindFaces<'a> {
    mesh: &'a Facing,
    eye: Vec3,
    faces: &'a mut Faces,
}

impl WithSimd for FindFaces<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let Self { mesh, eye, faces } = self;
        let groups = faces.triangles.chunks_mut(LANES * BLOCK);
        for (number, (cones, group)) in mesh.cones.iter().zip(groups).enumerate() {
            let classes = cones.test(eye);
            let blocks = group.as_chunks_mut::<BLOCK>().0;
            for (lane, (class, block)) in classes.into_iter().zip(blocks).enumerate() {
                if class == 0 {
                    let index = number * LANES + lane;
                    mesh.find_faces(index, eye, block, &mut faces.in_plane);
                    faces.mixed.push(index as u32);
                } else {
                    block.fill(u8::from(class > 0));
                }
            }
        }
    }
}

impl Facing {
    #[inline(always)]
    fn find_faces(
        &self,
        block: usize,
        eye: Vec3,
        faces: &mut [u8; BLOCK],
        in_plane: &mut Vec<u32>,
    ) {
        let range = block * BLOCK..(block + 1) * BLOCK;
        let [x, y, z, d] = [0, 1, 2, 3].map(|i| {
            let whole = self.planes[i][range.clone()].as_chunks::<BLOCK>().0;
            &whole[0]
        });
        let rounding = self.rounding_at(eye);
        let mut unclear = false;
        for i in 0..BLOCK {
            let height = x[i] * eye.x + y[i] * eye.y + z[i] * eye.z - d[i];
            faces[i] = u8::from(height > 0.0);
            unclear |= height.abs() < rounding;
        }
        if unclear {
            let eye = eye.as_dvec3();
            let planes = self.precise[range.clone()].iter();
            for ((face, [x, y, z, d]), index) in faces.iter_mut().zip(planes).zip(range) {
                let height = x * eye.x + y * eye.y + z * eye.z - d;
                *face = u8::from(height > 0.0);
                let bound = f64::from(rounding) * (x * x + y * y + z * z).sqrt();
                if height.abs() <= bound && index < self.corners.len() {
                    in_plane.push(index as u32);
                }
            }
        }
    }
}

impl Facing {
    /// Whether the eye of the last search lies on a triangle, but for rounding. What a ray
    /// from there meets is a matter of its arithmetic.
    pub(super) fn touches(&self, positions: &[Vec3], eye: Vec3, faces: &Faces) -> bool {
        let margin = 4.0 * f64::from(self.rounding_at(eye));
        faces.in_plane.iter().any(|&index| {
            let corners = self.corners[index as usize].map(|v| positions[v as usize].as_dvec3());
            let [a, b, c] = corners;
            let normal = (b - a).cross(c - a).normalize_or_zero();
            [(a, b), (b, c), (c, a)].into_iter().all(|(from, to)| {
                let inward = normal.cross(to - from).normalize_or_zero();
                inward.dot(eye.as_dvec3() - from) >= -margin
            })
        })
    }

    /// Bounds the rounding of heights above planes, in single precision.
    #[inline(always)]
    fn rounding_at(&self, eye: Vec3) -> f32 {
        self.rounding + PLANE_ROUNDING * eye.abs().element_sum()
    }
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
