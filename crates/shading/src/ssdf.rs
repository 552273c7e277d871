//! Spherical signed distance functions (Wang et al. 2013, §4): the angle from a direction to
//! the visibility boundary, + where visible.

use std::f32::consts::PI;

use glam::{Vec3, Vec4};
use relight_format::{CHANNELS_PER_TILE, Cluster, MAX_TILES_PER_CLUSTER, Scene};

use crate::octahedral;

const MAX_TILES: usize = MAX_TILES_PER_CLUSTER as usize;

/// A signed distance over the sphere of directions.
pub trait SignedDistance {
    /// Radians from the unit direction to the visibility boundary; + visible, − blocked.
    fn distance(&self, direction: Vec3) -> f32;

    /// Distances saturate at ± this many radians.
    fn limit(&self) -> f32 {
        PI
    }
}

/// A scene's basis images, each in a gutter of one texel that continues it as the octahedral map
/// does: an interpolation's four texels are two pairs of neighbours.
pub struct Basis {
    /// Tile after tile, row 0 first, four channels per texel. −128 has no place in basis values;
    /// snorm decodes it as −127, which stands here.
    texels: Vec<i8>,
    /// Texels per side of a tile, without its gutter.
    resolution: usize,
}

impl Basis {
    /// Copies the images of a scene.
    pub fn new(scene: &Scene) -> Self {
        let resolution = scene.visibility.basis_resolution;
        let n = resolution as usize;
        let tiles = scene.basis.chunks_exact(n * n * CHANNELS_PER_TILE);
        let mut texels = Vec::with_capacity(tiles.len() * Self::tile_length(n));
        for tile in tiles {
            for y in -1..=n as i32 {
                for x in -1..=n as i32 {
                    let (x, y) = octahedral::wrap(x, y, resolution);
                    let first = (y as usize * n + x as usize) * CHANNELS_PER_TILE;
                    let quad = &tile[first..first + CHANNELS_PER_TILE];
                    texels.extend(quad.iter().map(|&value| value.max(-127)));
                }
            }
        }
        Self {
            texels,
            resolution: n,
        }
    }

    /// Row `row` of tile `tile`, gutter included, row 0 of which is the gutter.
    pub(crate) fn row(&self, tile: usize, row: usize) -> &[i8] {
        let length = (self.resolution + 2) * CHANNELS_PER_TILE;
        &self.texels[tile * Self::tile_length(self.resolution) + row * length..][..length]
    }

    fn tile_length(resolution: usize) -> usize {
        (resolution + 2) * (resolution + 2) * CHANNELS_PER_TILE
    }
}

/// The SSDF of a point on a triangle, interpolated from the triangle's vertices.
pub struct Ssdf<'a> {
    /// The cluster's tiles.
    texels: &'a [i8],
    /// Texels per side of a tile.
    resolution: usize,
    tiles: usize,
    limit: f32,
    /// Radians of a byte times a coefficient of 1.
    scale: f32,
    /// Integers of 16 bits, those of vertices interpolated.
    coefficients: [Vec4; MAX_TILES],
}

impl<'a> Ssdf<'a> {
    /// The SSDF at `barycentrics` of triangle `triangle` of `scene`, whose `basis` it is: all
    /// vertices of a triangle share their cluster's basis, so interpolating coefficients
    /// interpolates distances.
    pub fn interpolate(
        scene: &Scene,
        basis: &'a Basis,
        triangle: usize,
        barycentrics: Vec3,
    ) -> Self {
        let triangle = &scene.triangles[triangle];
        let cluster = &scene.clusters[triangle.cluster as usize];
        let [a, b, c] = triangle.vertices;
        let weights = [
            (a, barycentrics.x),
            (b, barycentrics.y),
            (c, barycentrics.z),
        ];
        Self::combine(scene, basis, cluster, weights)
    }

    /// The SSDF at vertex `vertex` of cluster `cluster` of `scene`, whose `basis` it is.
    pub fn at_vertex(scene: &Scene, basis: &'a Basis, cluster: usize, vertex: u32) -> Self {
        Self::combine(scene, basis, &scene.clusters[cluster], [(vertex, 1.0)])
    }

    /// The weighted sum of the SSDFs of some vertices of `cluster`.
    fn combine<const N: usize>(
        scene: &Scene,
        basis: &'a Basis,
        cluster: &Cluster,
        weights: [(u32, f32); N],
    ) -> Self {
        let tiles = cluster.tiles as usize;
        let mut coefficients = [Vec4::ZERO; MAX_TILES];
        for (vertex, weight) in weights {
            let first = cluster.first_coefficient as usize
                + (vertex - cluster.first_vertex) as usize * tiles * CHANNELS_PER_TILE;
            for (tile, coefficient) in coefficients[..tiles].iter_mut().enumerate() {
                let quad = &scene.coefficients[first + tile * CHANNELS_PER_TILE..][..4];
                *coefficient += weight * Vec4::from_array([0, 1, 2, 3].map(|c| f32::from(quad[c])));
            }
        }
        // GPUs have few registers: what is interpolated is as fine as what is stored.
        let most = f32::from(i16::MAX);
        for coefficient in &mut coefficients {
            let whole = coefficient.clamp(Vec4::splat(-most), Vec4::splat(most));
            *coefficient = whole.map(f32::round_ties_even);
        }
        let tile_length = Basis::tile_length(basis.resolution);
        let first = cluster.first_tile as usize * tile_length;
        Self {
            texels: &basis.texels[first..first + tiles * tile_length],
            resolution: basis.resolution,
            tiles,
            limit: scene.visibility.distance_clamp,
            scale: cluster.coefficient_scale / most * SNORM8_STEP,
            coefficients,
        }
    }

    /// Texels of four basis images that one distance interpolates.
    pub fn tiles(&self) -> usize {
        self.tiles
    }
}

impl SignedDistance for Ssdf<'_> {
    fn distance(&self, direction: Vec3) -> f32 {
        // The gutter moves the map by a texel.
        let texel = octahedral::encode(direction) * self.resolution as f32 + 0.5;
        let last = self.resolution as i32;
        // Truncated, which is the floor of what is not negative.
        let (x, y) = ((texel.x as i32).min(last), (texel.y as i32).min(last));
        let (u, v) = (texel.x - x as f32, texel.y - y as f32);
        let weights = [(1.0 - u) * (1.0 - v), u * (1.0 - v), (1.0 - u) * v, u * v];
        let stride = (self.resolution + 2) * CHANNELS_PER_TILE;
        let first = y as usize * stride + x as usize * CHANNELS_PER_TILE;
        let mut sum = Vec4::ZERO;
        let tiles = self
            .texels
            .chunks_exact(Basis::tile_length(self.resolution));
        for (tile, coefficient) in tiles.zip(&self.coefficients) {
            let [a, b] = pair(&tile[first..]);
            let [c, d] = pair(&tile[first + stride..]);
            let basis = a * weights[0] + b * weights[1] + c * weights[2] + d * weights[3];
            sum += *coefficient * basis;
        }
        sum.element_sum() * self.scale
    }

    fn limit(&self) -> f32 {
        self.limit
    }
}

/// Two neighbouring texels.
#[inline(always)]
fn pair(bytes: &[i8]) -> [Vec4; 2] {
    let mut values = [0.0; 2 * CHANNELS_PER_TILE];
    if let Some(bytes) = bytes.first_chunk::<{ 2 * CHANNELS_PER_TILE }>() {
        for i in 0..values.len() {
            values[i] = f32::from(bytes[i]);
        }
    }
    [
        Vec4::from_slice(&values[..4]),
        Vec4::from_slice(&values[4..]),
    ]
}

/// What a byte counts where an `rgba8snorm` texture holds it.
const SNORM8_STEP: f32 = 1.0 / 127.0;

#[cfg(test)]
mod tests {
    use relight_format::math;
    use relight_format::{BakeReport, Representation, Triangle, Vertex, VisibilityParameters};

    use super::*;

    const RESOLUTION: u32 = 8;
    /// Sums of eight products in f32, radians.
    const TOLERANCE: f32 = 1e-5;

    /// Two clusters of one triangle each, with one and two tiles of irregular contents.
    fn scene() -> Scene {
        let texels = (RESOLUTION * RESOLUTION) as usize * CHANNELS_PER_TILE;
        let cluster = |index: u32, tiles: u32| Cluster {
            first_vertex: 3 * index,
            vertex_count: 3,
            first_coefficient: 12 * index,
            first_tile: index,
            tiles,
            coefficient_scale: 0.7,
        };
        let triangle = |index: u16| Triangle {
            vertices: [2, 0, 1].map(|corner| u32::from(3 * index) + corner),
            material: 0,
            cluster: index,
        };
        let vertex = Vertex {
            position: [0.0; 3],
            normal: [0.0, 1.0, 0.0],
            tangent: [1.0, 0.0, 0.0, 1.0],
            uv: [0.0; 2],
        };
        Scene {
            name: String::new(),
            visibility: VisibilityParameters {
                representation: Representation::ClusteredPca,
                sample_resolution: 128,
                basis_resolution: RESOLUTION,
                distance_clamp: 0.5,
                ray_offset: 0.0,
            },
            camera: None,
            materials: Vec::new(),
            textures: Vec::new(),
            report: BakeReport::default(),
            second_uvs: Vec::new(),
            transfer: None,
            vertices: vec![vertex; 6],
            triangles: vec![triangle(0), triangle(1)],
            clusters: vec![cluster(0, 1), cluster(1, 2)],
            coefficients: (0..36)
                .map(|i| (i * i * 997 % 65_535 - 32_767) as i16)
                .collect(),
            basis: (0..3 * texels)
                .map(|i| (i * i * 31 % 255) as u8 as i8)
                .collect(),
        }
    }

    /// The format's definition, in f64, of cluster 1 at texel (x, y), for vertices of these weights, whose coefficients are
    /// interpolated to integers.
    fn defined(scene: &Scene, weights: [f64; 3], x: u32, y: u32) -> f64 {
        let texel = (y * RESOLUTION + x) as usize;
        let tile_length = (RESOLUTION * RESOLUTION) as usize * 4;
        (0..8)
            .map(|channel| {
                let of = |vertex: usize| {
                    f64::from(scene.coefficients[12 + vertex * 8 + channel].max(-32_767))
                };
                let interpolated: f64 = (0..3).map(|vertex| weights[vertex] * of(vertex)).sum();
                let tile = 1 + channel / 4;
                let basis = scene.basis[tile * tile_length + texel * 4 + channel % 4];
                interpolated.round_ties_even() / 32_767.0 * f64::from(basis.max(-127)) / 127.0
            })
            .sum::<f64>()
            * f64::from(scene.clusters[1].coefficient_scale)
    }

    #[test]
    fn texel_centres_hold_the_interpolated_definition() {
        let scene = scene();
        // Exact in f32, as are the sums.
        let weights = Vec3::new(0.25, 0.125, 0.625);
        let basis = Basis::new(&scene);
        let ssdf = Ssdf::interpolate(&scene, &basis, 1, weights);
        assert_eq!(ssdf.limit(), 0.5);
        for y in 0..RESOLUTION {
            for x in 0..RESOLUTION {
                // The triangle's corners are vertices 2, 0 and 1 of its cluster.
                let expected = defined(&scene, [0.125, 0.625, 0.25], x, y);
                let found = ssdf.distance(octahedral::texel_direction(x, y, RESOLUTION));
                assert!(
                    (found - expected as f32).abs() < TOLERANCE,
                    "({x}, {y}): {found}, {expected}"
                );
            }
        }
    }

    #[test]
    fn the_seam_is_continuous() {
        let scene = scene();
        let basis = Basis::new(&scene);
        let ssdf = Ssdf::interpolate(&scene, &basis, 0, Vec3::new(0.1, 0.1, 0.8));
        // The border of the map is where the lower half's great circles x = 0 and z = 0 lie.
        let step = 1e-5;
        for i in 1..100 {
            let angle = -PI * i as f32 / 100.0;
            for sides in [
                [-1.0, 1.0].map(|side| Vec3::new(math::cos(angle), math::sin(angle), side * step)),
                [-1.0, 1.0].map(|side| Vec3::new(side * step, math::sin(angle), math::cos(angle))),
            ] {
                let [a, b] = sides.map(|direction| ssdf.distance(direction));
                // The field spans a radian within a texel of 0.2 rad: slopes stay below 100.
                assert!((a - b).abs() < 100.0 * step, "at {angle}: {a} and {b}");
            }
        }
    }
}
