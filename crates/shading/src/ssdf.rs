//! Spherical signed distance functions (Wang et al. 2013, §4): the angle from a direction to
//! the visibility boundary, + where visible.

use std::f32::consts::PI;

use glam::{Vec2, Vec3, Vec4};
use relight_format::{CHANNELS_PER_TILE, MAX_TILES_PER_CLUSTER, Scene};

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

/// The SSDF of a point on a triangle, interpolated from the triangle's vertices.
pub struct Ssdf<'a> {
    /// The cluster's tiles, row 0 first, four signed bytes per texel.
    basis: &'a [i8],
    /// Texels per side of a tile.
    resolution: u32,
    tiles: usize,
    limit: f32,
    coefficients: [Vec4; MAX_TILES],
}

impl<'a> Ssdf<'a> {
    /// The SSDF at `barycentrics` of triangle `triangle` of `scene`: all vertices of a
    /// triangle share their cluster's basis, so interpolating coefficients interpolates
    /// distances.
    pub fn interpolate(scene: &'a Scene, triangle: usize, barycentrics: Vec3) -> Self {
        let triangle = &scene.triangles[triangle];
        let cluster = &scene.clusters[triangle.cluster as usize];
        let tiles = cluster.tiles as usize;
        let mut coefficients = [Vec4::ZERO; MAX_TILES];
        for (corner, &vertex) in triangle.vertices.iter().enumerate() {
            let weight = barycentrics[corner] * cluster.coefficient_scale;
            let first = cluster.first_coefficient as usize
                + (vertex - cluster.first_vertex) as usize * tiles * CHANNELS_PER_TILE;
            for (tile, coefficient) in coefficients[..tiles].iter_mut().enumerate() {
                let quad = &scene.coefficients[first + tile * CHANNELS_PER_TILE..][..4];
                *coefficient += weight * Vec4::from_array([0, 1, 2, 3].map(|c| snorm16(quad[c])));
            }
        }
        let resolution = scene.visibility.basis_resolution;
        let tile_length = (resolution * resolution) as usize * CHANNELS_PER_TILE;
        let basis =
            &scene.basis[cluster.first_tile as usize * tile_length..][..tiles * tile_length];
        let limit = scene.visibility.distance_clamp;
        Self {
            basis,
            resolution,
            tiles,
            limit,
            coefficients,
        }
    }

    /// The distance at texel (`x`, `y`), which may lie one texel outside the map.
    fn texel(&self, x: i32, y: i32) -> f32 {
        let n = self.resolution as usize;
        let (x, y) = octahedral::wrap(x, y, self.resolution);
        let first = (y as usize * n + x as usize) * CHANNELS_PER_TILE;
        let tile_length = n * n * CHANNELS_PER_TILE;
        let mut distance = 0.0;
        for (tile, coefficient) in self.coefficients[..self.tiles].iter().enumerate() {
            let quad = &self.basis[tile * tile_length + first..][..4];
            distance += coefficient.dot(Vec4::from_array([0, 1, 2, 3].map(|c| snorm8(quad[c]))));
        }
        distance
    }
}

impl SignedDistance for Ssdf<'_> {
    fn distance(&self, direction: Vec3) -> f32 {
        let texel = octahedral::encode(direction) * self.resolution as f32 - 0.5;
        let corner = texel.floor();
        let (x, y) = (corner.x as i32, corner.y as i32);
        let Vec2 { x: u, y: v } = texel - corner;
        let top = self.texel(x, y) * (1.0 - u) + self.texel(x + 1, y) * u;
        let bottom = self.texel(x, y + 1) * (1.0 - u) + self.texel(x + 1, y + 1) * u;
        top * (1.0 - v) + bottom * v
    }

    fn limit(&self) -> f32 {
        self.limit
    }
}

/// As `unpack2x16snorm` reads it.
fn snorm16(value: i16) -> f32 {
    (f32::from(value) / 32767.0).max(-1.0)
}

/// As an `rgba8snorm` texture reads it.
fn snorm8(value: i8) -> f32 {
    (f32::from(value) / 127.0).max(-1.0)
}
