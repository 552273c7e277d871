//! Where visibility can change: contour edges, and the texels that they keep apart.
//!
//! Seen from a point, an edge whose triangles lie on both sides of the plane through the
//! edge and the point is covered on both sides; visibility changes only across *contour*
//! edges, those whose triangles all lie on one side (boundary edges always). In each octant
//! the octahedral map is a central projection, so a contour edge maps to straight segments
//! in the square. Each segment puts walls on the links between neighbouring texel centres
//! that it crosses; texels that remain connected see alike, and one ray decides for all of
//! them. The result equals one ray per texel: whatever rounding leaves unclear, within
//! [`CLEARANCE`] of a texel centre, walls that texel off and gives it a ray of its own.

use std::collections::HashMap;

use glam::{DVec3, Vec3};
use pulp::{Arch, Simd, WithSimd};

use crate::ray::RayCaster;
use crate::visibility::{Bitmap, Directions};

/// Distance from a texel centre below which a segment separates the texel from all its
/// neighbours, in texels. Rounding of projected segments stays far below it.
const CLEARANCE: f64 = 1e-3;
/// Triangles whose facing bits share a word.
const BLOCK: usize = 64;

/// A mesh's edges, prepared for finding contours from any point.
pub struct ContourMesh {
    /// Planes of the triangles: `n·p = d`, structure of arrays.
    normals: [Vec<f64>; 3],
    offsets: Vec<f64>,
    /// Welded vertex positions.
    positions: Vec<DVec3>,
    /// Edges between two consistently wound triangles, grouped by their pair of blocks.
    groups: Vec<Group>,
    regular: Vec<RegularEdge>,
    /// Edges with one triangle, or whose triangles all lie on one side from everywhere.
    boundary: Vec<[u32; 2]>,
    /// Every other edge: its triangles and whether each lies left of the edge's direction.
    irregular: Vec<IrregularEdge>,
}

/// Welded vertices; triangles and whether each lies left of the edge's direction.
type IrregularEdge = ([u32; 2], Vec<(u32, bool)>);

struct Group {
    blocks: [u32; 2],
    first_edge: u32,
}

#[derive(Clone, Copy)]
struct RegularEdge {
    vertices: [u32; 2],
    bits: [u8; 2],
}

/// Memory that sampling one point after the other reuses.
pub struct Scratch {
    facing: Vec<u64>,
    walls: Walls,
    parents: Vec<u16>,
    visible: Vec<bool>,
}

impl ContourMesh {
    /// Welds vertices of equal coordinates and collects edges. Triangles without area and
    /// repeated triangles are left out: neither changes what is visible.
    pub fn new(triangles: &[[Vec3; 3]]) -> Self {
        let mut ids = HashMap::new();
        let mut positions = Vec::new();
        let mut weld = |vertex: Vec3| {
            // Adding zero turns −0 into +0.
            *ids.entry((vertex + Vec3::ZERO).to_array().map(f32::to_bits))
                .or_insert_with(|| {
                    positions.push(vertex.as_dvec3());
                    positions.len() as u32 - 1
                })
        };
        let mut seen = std::collections::HashSet::new();
        let mut mesh = Self {
            normals: Default::default(),
            offsets: Vec::new(),
            positions: Vec::new(),
            groups: Vec::new(),
            regular: Vec::new(),
            boundary: Vec::new(),
            irregular: Vec::new(),
        };
        // Edge from lower to higher vertex, triangle, whether it runs along the winding.
        let mut halves: Vec<([u32; 2], u32, bool)> = Vec::new();
        for triangle in triangles {
            let vertices = triangle.map(&mut weld);
            let [a, b, c] = triangle.map(Vec3::as_dvec3);
            let normal = (b - a).cross(c - a);
            let mut key = vertices;
            key.sort_unstable();
            if normal == DVec3::ZERO || !seen.insert(key) {
                continue;
            }
            let index = mesh.offsets.len() as u32;
            for (axis, value) in normal.to_array().into_iter().enumerate() {
                mesh.normals[axis].push(value);
            }
            mesh.offsets.push(normal.dot(a));
            for i in 0..3 {
                let (from, to) = (vertices[i], vertices[(i + 1) % 3]);
                halves.push(([from.min(to), from.max(to)], index, from < to));
            }
        }
        mesh.positions = positions;
        halves.sort_unstable();
        let mut regular: Vec<([u32; 2], RegularEdge)> = Vec::new();
        for sides in halves.chunk_by(|a, b| a.0 == b.0) {
            let vertices = sides[0].0;
            match sides {
                [_] => mesh.boundary.push(vertices),
                [(_, a, along_a), (_, b, along_b)] if along_a != along_b => {
                    let block = |triangle: u32| triangle / BLOCK as u32;
                    let bit = |triangle: u32| (triangle as usize % BLOCK) as u8;
                    let edge = RegularEdge {
                        vertices,
                        bits: [bit(*a), bit(*b)],
                    };
                    regular.push(([block(*a), block(*b)], edge));
                }
                _ => mesh.irregular.push((
                    vertices,
                    sides
                        .iter()
                        .map(|&(_, triangle, along)| (triangle, along))
                        .collect(),
                )),
            }
        }
        regular.sort_by_key(|(blocks, _)| *blocks);
        for (index, (blocks, edge)) in regular.into_iter().enumerate() {
            if mesh
                .groups
                .last()
                .is_none_or(|group| group.blocks != blocks)
            {
                mesh.groups.push(Group {
                    blocks,
                    first_edge: index as u32,
                });
            }
            mesh.regular.push(edge);
        }
        mesh
    }

    /// Memory for [`Self::sample`] at the directions' resolution.
    pub fn scratch(&self, directions: &Directions) -> Scratch {
        let n = directions.resolution() as usize;
        Scratch {
            facing: vec![0; self.offsets.len().div_ceil(BLOCK)],
            walls: Walls::new(n),
            parents: vec![0; n * n],
            visible: vec![false; n * n],
        }
    }

    /// The same bitmap as [`crate::visibility::sample`], and the number of rays it took.
    /// `directions` must have at most 256 × 256 texels.
    pub fn sample(
        &self,
        caster: &RayCaster,
        origin: Vec3,
        directions: &Directions,
        scratch: &mut Scratch,
    ) -> (Bitmap, u32) {
        let Scratch {
            facing,
            walls,
            parents,
            visible,
        } = scratch;
        let eye = origin.as_dvec3();
        self.find_facing(eye, facing);
        walls.clear();
        self.for_each_contour(facing, |[from, to]| {
            let (from, to) = (self.positions[from as usize], self.positions[to as usize]);
            walls.add(from - eye, to - eye);
        });
        walls.label(parents);
        let mut rays = 0;
        let directions = directions.as_slice();
        for texel in 0..parents.len() {
            let parent = parents[texel] as usize;
            visible[texel] = if parent == texel {
                rays += 1;
                !caster.any_hit(origin, directions[texel])
            } else {
                visible[parent]
            };
        }
        (Bitmap::from_fn(visible.len(), |texel| visible[texel]), rays)
    }

    /// One bit per triangle: whether the eye is in front of it.
    fn find_facing(&self, eye: DVec3, facing: &mut [u64]) {
        Arch::new().dispatch(FindFacing {
            mesh: self,
            eye,
            facing,
        });
    }

    fn for_each_contour(&self, facing: &[u64], mut contour: impl FnMut([u32; 2])) {
        let end = self.regular.len() as u32;
        let ends = self
            .groups
            .iter()
            .skip(1)
            .map(|group| group.first_edge)
            .chain([end]);
        for (group, end) in self.groups.iter().zip(ends) {
            let [a, b] = group.blocks.map(|block| facing[block as usize]);
            if a == b && (a == 0 || a == u64::MAX) {
                continue;
            }
            for edge in &self.regular[group.first_edge as usize..end as usize] {
                if (a >> edge.bits[0] ^ b >> edge.bits[1]) & 1 == 1 {
                    contour(edge.vertices);
                }
            }
        }
        self.boundary.iter().copied().for_each(&mut contour);
        for (vertices, sides) in &self.irregular {
            let side = |&(triangle, along): &(u32, bool)| {
                (facing[triangle as usize / BLOCK] >> (triangle as usize % BLOCK) & 1 == 1) == along
            };
            let first = side(&sides[0]);
            if sides.iter().all(|other| side(other) == first) {
                contour(*vertices);
            }
        }
    }
}

/// The vectorised body of [`ContourMesh::find_facing`].
struct FindFacing<'a> {
    mesh: &'a ContourMesh,
    eye: DVec3,
    facing: &'a mut [u64],
}

impl WithSimd for FindFacing<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let Self { mesh, eye, facing } = self;
        let [x, y, z] = &mesh.normals;
        let blocks = (x.chunks(BLOCK).zip(y.chunks(BLOCK)))
            .zip(z.chunks(BLOCK).zip(mesh.offsets.chunks(BLOCK)));
        for (word, ((x, y), (z, d))) in facing.iter_mut().zip(blocks) {
            let mut in_front = [0u8; BLOCK];
            for (bit, ((x, y), (z, d))) in in_front
                .iter_mut()
                .zip((x.iter().zip(y)).zip(z.iter().zip(d)))
            {
                *bit = u8::from(x * eye.x + y * eye.y + z * eye.z > *d);
            }
            *word = pack_bits(&in_front);
        }
    }
}

#[inline(always)]
fn pack_bits(bits: &[u8; BLOCK]) -> u64 {
    let mut word = 0;
    for (byte, eight) in bits.chunks_exact(8).enumerate() {
        let eight = u64::from_le_bytes(eight.try_into().expect("chunks of eight"));
        // Gathers the lowest bit of each byte into the top byte.
        word |= (eight.wrapping_mul(0x0102_0408_1020_4080) >> 56) << (8 * byte);
    }
    word
}

/// Links between neighbouring texel centres that a contour crosses. Link k of a row joins
/// texels k − 1 and k; links 0 and n are halves of links over the map's border.
struct Walls {
    n: usize,
    /// `n` rows of `n + 1` links between columns.
    across_columns: Vec<u8>,
    /// `n` columns of `n + 1` links between rows.
    across_rows: Vec<u8>,
}

impl Walls {
    fn new(n: usize) -> Self {
        assert!(n * n <= 1 << 16, "labels have 16 bits");
        Self {
            n,
            across_columns: vec![0; n * (n + 1)],
            across_rows: vec![0; n * (n + 1)],
        }
    }

    fn clear(&mut self) {
        self.across_columns.fill(0);
        self.across_rows.fill(0);
    }

    /// Adds the contour edge between two points given relative to the eye.
    fn add(&mut self, from: DVec3, to: DVec3) {
        let signs = |p: DVec3| [p.x < 0.0, p.y < 0.0, p.z < 0.0];
        if signs(from) == signs(to) {
            self.add_in_octant(from, to);
            return;
        }
        // Cut at the coordinate planes.
        let mut cuts = [1.0; 4];
        for (cut, (a, b)) in cuts
            .iter_mut()
            .zip(from.to_array().into_iter().zip(to.to_array()))
        {
            if (a < 0.0) != (b < 0.0) {
                *cut = a / (a - b);
            }
        }
        cuts.sort_unstable_by(f64::total_cmp);
        let mut start = (0.0, from);
        for cut in cuts {
            if cut > start.0 {
                let end = if cut < 1.0 { from.lerp(to, cut) } else { to };
                self.add_in_octant(start.1, end);
                start = (cut, end);
            }
        }
    }

    /// Adds a piece that lies in one octant, up to rounding at its ends.
    fn add_in_octant(&mut self, from: DVec3, to: DVec3) {
        let middle = from + to;
        let sign = DVec3::new(
            1f64.copysign(middle.x),
            1f64.copysign(middle.y),
            1f64.copysign(middle.z),
        );
        let half = self.n as f64 * 0.5;
        let project = |p: DVec3| {
            let p = (p * sign).max(DVec3::ZERO);
            let p = p / p.element_sum();
            let (u, v) = if sign.y > 0.0 {
                (p.x, p.z)
            } else {
                (1.0 - p.z, 1.0 - p.x)
            };
            (
                half + half * u * sign.x - 0.5,
                half + half * v * sign.z - 0.5,
            )
        };
        let (a, b) = (project(from), project(to));
        if !(a.0 + a.1 + b.0 + b.1).is_finite() {
            // The edge ends at the eye; its triangles are seen edge-on.
            return;
        }
        add_crossings(&mut self.across_columns, self.n, a, b);
        add_crossings(&mut self.across_rows, self.n, (a.1, a.0), (b.1, b.0));
    }

    /// Union-find over links without a wall. Every texel's entry ends as the smallest texel
    /// of its component.
    fn label(&self, parents: &mut [u16]) {
        let n = self.n;
        let stride = n + 1;
        for (texel, parent) in parents.iter_mut().enumerate() {
            *parent = texel as u16;
        }
        for y in 0..n {
            let links = &self.across_columns[y * stride..][..stride];
            for (x, link) in links.iter().enumerate().take(n) {
                let texel = y * n + x;
                if x > 0 && *link == 0 {
                    parents[texel] = parents[texel - 1];
                }
                if y > 0 && self.across_rows[x * stride + y] == 0 {
                    union(parents, texel, texel - n);
                }
            }
        }
        // Over the border: each half link may hold the wall.
        for i in 0..n / 2 {
            let other = n - 1 - i;
            for end in [0, n] {
                let line = if end == 0 { 0 } else { n - 1 };
                let wall = |links: &[u8]| links[i * stride + end] | links[other * stride + end];
                if wall(&self.across_columns) == 0 {
                    union(parents, i * n + line, other * n + line);
                }
                if wall(&self.across_rows) == 0 {
                    union(parents, line * n + i, line * n + other);
                }
            }
        }
        for texel in 0..parents.len() {
            // Parents are never larger, so this one is final already.
            parents[texel] = parents[parents[texel] as usize];
        }
    }
}

fn root(parents: &mut [u16], mut texel: usize) -> usize {
    while parents[texel] as usize != texel {
        let next = parents[texel] as usize;
        parents[texel] = parents[next];
        texel = next;
    }
    texel
}

fn union(parents: &mut [u16], a: usize, b: usize) {
    if parents[a] == parents[b] {
        return;
    }
    let (a, b) = (root(parents, a), root(parents, b));
    parents[a.max(b)] = a.min(b) as u16;
}

/// Marks, on every line of integer second coordinate that the segment comes within
/// [`CLEARANCE`] of, the links of the first coordinate that it may cross there.
fn add_crossings(links: &mut [u8], n: usize, a: (f64, f64), b: (f64, f64)) {
    let (a, b) = if a.1 <= b.1 { (a, b) } else { (b, a) };
    let first = ((a.1 - CLEARANCE).ceil().max(0.0)) as usize;
    let last = (b.1 + CLEARANCE).floor();
    if last < 0.0 {
        return;
    }
    let last = (last as usize).min(n - 1);
    let slope = (b.0 - a.0) / (b.1 - a.1).max(1e-12);
    let (low, high) = (a.0.min(b.0) - CLEARANCE, a.0.max(b.0) + CLEARANCE);
    let reach = CLEARANCE + CLEARANCE * slope.abs();
    for line in first..=last {
        let at = a.0 + (line as f64 - a.1) * slope;
        let from = (at - reach).clamp(low, high);
        let to = (at + reach).clamp(low, high);
        // Link k is crossed between coordinates k − 1 and k.
        let from = (from + 1.0).max(0.0) as usize;
        let to = ((to + 1.0).max(0.0) as usize).min(n);
        links[line * (n + 1)..][from.min(n)..=to].fill(1);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::visibility;

    /// Deterministic numbers in [0, 1).
    fn random(state: &mut u64) -> f32 {
        *state = state
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (*state >> 40) as f32 / (1u64 << 24) as f32
    }

    fn random_point(state: &mut u64) -> Vec3 {
        Vec3::new(random(state), random(state), random(state)) * 2.0 - 1.0
    }

    fn sphere(centre: Vec3, radius: f32, n: u32) -> Vec<[Vec3; 3]> {
        let at = |i: u32, j: u32| {
            let theta = std::f32::consts::PI * j as f32 / n as f32;
            let phi = std::f32::consts::TAU * (i % (2 * n)) as f32 / (2 * n) as f32;
            let pole = j == 0 || j == n;
            let ring = if pole { 0.0 } else { theta.sin() };
            centre + radius * Vec3::new(ring * phi.cos(), theta.cos(), ring * phi.sin())
        };
        (0..n)
            .flat_map(|j| (0..2 * n).map(move |i| (i, j)))
            .flat_map(|(i, j)| {
                [
                    [at(i, j), at(i + 1, j), at(i + 1, j + 1)],
                    [at(i, j), at(i + 1, j + 1), at(i, j + 1)],
                ]
            })
            .collect()
    }

    fn assert_same_bits(triangles: &[[Vec3; 3]], origins: &[Vec3], resolution: u32) -> u64 {
        let caster = RayCaster::new(triangles);
        let mesh = ContourMesh::new(triangles);
        let directions = Directions::new(resolution);
        let mut scratch = mesh.scratch(&directions);
        let mut total = 0;
        for (index, &origin) in origins.iter().enumerate() {
            let exact = visibility::sample(&caster, origin, &directions);
            let (fast, rays) = mesh.sample(&caster, origin, &directions, &mut scratch);
            let wrong = (0..(resolution * resolution) as usize)
                .filter(|&texel| exact.get(texel) != fast.get(texel))
                .count();
            assert_eq!(wrong, 0, "{wrong} texels differ at origin {index} {origin}");
            total += u64::from(rays);
        }
        total
    }

    #[test]
    fn closed_surfaces_give_the_bits_of_one_ray_per_texel() {
        let mut state = 3;
        let mut triangles = sphere(Vec3::new(0.2, 0.1, -0.3), 0.5, 20);
        triangles.extend(sphere(Vec3::new(-0.5, 0.6, 0.2), 0.25, 12));
        let origins: Vec<Vec3> = (0..60).map(|_| random_point(&mut state) * 1.5).collect();
        let rays = assert_same_bits(&triangles, &origins, 64);
        assert!(rays < 60 * 64 * 64 / 20, "components are few: {rays} rays");
    }

    #[test]
    fn soups_with_boundaries_and_shared_planes_give_the_same_bits() {
        let mut state = 11;
        let mut triangles: Vec<[Vec3; 3]> = (0..60)
            .map(|_| {
                let centre = random_point(&mut state);
                [0; 3].map(|_| centre + 0.3 * random_point(&mut state))
            })
            .collect();
        // Axis-aligned faces put contours on octant borders and through texel centres.
        for axis in 0..3 {
            let quad = [[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]].map(|[a, b]| {
                let mut p = [0.25; 3];
                p[(axis + 1) % 3] = a;
                p[(axis + 2) % 3] = b;
                Vec3::from(p)
            });
            triangles.push([quad[0], quad[1], quad[2]]);
            triangles.push([quad[0], quad[2], quad[3]]);
            triangles.push([quad[2], quad[1], quad[0]]);
        }
        triangles.push([Vec3::ONE, Vec3::ONE, Vec3::X]);
        let mut origins: Vec<Vec3> = (0..60).map(|_| random_point(&mut state)).collect();
        origins.extend([
            Vec3::ZERO,
            Vec3::new(0.5, 0.0, 0.0),
            Vec3::new(0.0, -0.5, 0.0),
        ]);
        assert_same_bits(&triangles, &origins, 32);
    }

    #[test]
    fn surface_points_give_the_same_bits() {
        let triangles = sphere(Vec3::ZERO, 1.0, 30);
        let origins: Vec<Vec3> = triangles
            .iter()
            .step_by(37)
            .map(|[a, b, c]| (*a + *b + *c) / 3.0 * 1.0001)
            .collect();
        assert_same_bits(&triangles, &origins, 64);
    }
}
