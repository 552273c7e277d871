//! How far visibility is off where it is shaded: between vertices.
//!
//! Points all over the surface are sampled as vertices are. What interpolation makes of the
//! vertices around them is compared with what they see. Errors count by area, in that of what
//! is there: those on a figure do not vanish among square kilometres of field.

use std::sync::atomic::Ordering;

use glam::Vec3;
use nalgebra::DMatrix;
use relight_format::VisibilityErrors;
use relight_shading::octahedral;

use super::sample::Prepared;
use crate::compress::{Compressed, Normal, Weighting, column};
use crate::monitor::Interrupted;
use crate::simd::add_scaled;
use crate::visibility::ray::Crossing;

/// Rays per side of the map that tells whether a point lies inside of something.
const INSIDE_RESOLUTION: u32 = 8;

/// A point inside a triangle.
pub(super) struct Probe {
    pub(super) triangle: u32,
    /// Of its corners.
    pub(super) places: [u32; 3],
    vertices: [u32; 3],
    /// What each vertex counts; their sum is 1.
    weights: [f32; 3],
    /// Where rays from it begin.
    origin: Vec3,
    /// Unit normal of the triangle.
    face: Vec3,
    /// What its errors count: the triangle's area, in that of what is there.
    weight: f32,
    exact: Vec<f32>,
    normal: Normal,
    /// Mean square of the angle from the boundary to where `exact`, interpolated, vanishes.
    resolution: f32,
}

/// Sums for root mean squares over many clusters.
#[derive(Clone, Copy, Debug, Default, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
#[repr(C)]
pub struct ErrorSums {
    /// Sums of squared errors at probes, radians², times what they count.
    surface: f64,
    interpolation: f64,
    resolution: f64,
    /// Of what probes count.
    weight: f64,
    /// Sum of squared errors of vertices, radians².
    compression: f64,
    vertices: f64,
}

impl ErrorSums {
    /// Of compressed vertices.
    pub(super) fn at_vertices(compressed: &Compressed, vertices: usize) -> Self {
        Self {
            compression: compressed.squared_error,
            vertices: vertices as f64,
            ..Self::default()
        }
    }

    /// Adds a probe at whose corners SSDFs, as stored and exact, are columns of matrices.
    pub(super) fn add_probe(
        &mut self,
        probe: &Probe,
        [stored, exact]: [&DMatrix<f32>; 2],
        weighting: &Weighting,
    ) {
        let weight = f64::from(probe.weight);
        let squared_error = |ssdfs: &DMatrix<f32>| {
            let mut found = vec![0.0; probe.exact.len()];
            for (corner, weight) in probe.weights.into_iter().enumerate() {
                add_scaled(&mut found, column(ssdfs, corner), weight);
            }
            f64::from(weighting.squared_displacement(&found, &probe.exact, probe.normal))
        };
        self.surface += weight * squared_error(stored);
        self.interpolation += weight * squared_error(exact);
        self.resolution += weight * f64::from(probe.resolution);
        self.weight += weight;
    }

    /// Adds another set's sums.
    pub(crate) fn add(&mut self, other: &Self) {
        self.surface += other.surface;
        self.interpolation += other.interpolation;
        self.resolution += other.resolution;
        self.weight += other.weight;
        self.compression += other.compression;
        self.vertices += other.vertices;
    }

    /// Root mean squares.
    pub(crate) fn errors(&self) -> VisibilityErrors {
        let mean = |sum: f64, count: f64| (sum / count.max(f64::MIN_POSITIVE)).sqrt() as f32;
        VisibilityErrors {
            surface: mean(self.surface, self.weight),
            interpolation: mean(self.interpolation, self.weight),
            compression: mean(self.compression, self.vertices),
            resolution: mean(self.resolution, self.weight),
        }
    }
}

impl Prepared<'_> {
    /// One probe in every `step`th of some triangles.
    pub(super) fn probes(&self, triangles: &[u32], step: u32) -> Result<Vec<Probe>, Interrupted> {
        let mut probes: Vec<Probe> = (triangles.iter())
            .filter(|triangle| triangle.is_multiple_of(step))
            .map(|&triangle| self.probe(triangle))
            .collect();
        probes.retain(|probe| !self.is_inside(probe));
        let points = (probes.iter_mut())
            .map(|probe| (probe.origin, probe))
            .collect();
        self.sample(points, |probe, sampled| {
            let direction = probe
                .mean(|vertex| (self.mesh.vertices[vertex as usize].normal).normalize_or_zero());
            probe.normal.direction = direction.normalize_or_zero();
            probe.resolution = self.sampler.transform().squared_error(
                sampled.visible,
                sampled.crossings,
                &sampled.distances,
            );
            probe.exact = sampled.distances;
            self.counters.probes.fetch_add(1, Ordering::Relaxed);
        })?;
        Ok(probes)
    }

    /// Whether a point lies where nobody looks: inside of something. All around it are backs, or
    /// sheets with two fronts.
    fn is_inside(&self, probe: &Probe) -> bool {
        let count = INSIDE_RESOLUTION;
        let texels = (0..count * count).map(|i| [i % count, i / count]);
        let mut fronts = 0;
        let mut backs = 0;
        for [x, y] in texels {
            let direction = octahedral::texel_direction(x, y, count);
            if direction.dot(probe.face) <= 0.0 {
                continue;
            }
            let caster = self.contours.caster();
            let Some(hit) = caster.closest_hit(probe.origin, direction) else {
                return false;
            };
            // Besides the nearest, whatever coincides with it.
            let reach = hit.distance * (1.0 + 1e-5);
            let around = caster.crossings(probe.origin, direction, reach);
            let back = |crossing: &Crossing| crossing.normal.dot(direction) >= 0.0;
            if around.iter().any(back) {
                backs += 1;
            } else {
                fronts += 1;
            }
        }
        backs > fronts
    }

    fn probe(&self, triangle: u32) -> Probe {
        let corners = &self.mesh.triangles[triangle as usize];
        let [a, b, c] = self.mesh.corners(corners);
        let area_normal = (b - a).cross(c - a);
        // An additive recurrence covers a square evenly, whatever triangles are taken
        // (Roberts 2018); its upper half is folded onto the lower one.
        let along = |ratio: f64| (f64::from(triangle) * ratio).fract() as f32;
        let [u, v] = [along(0.754_877_666_246_693), along(0.569_840_290_998_053)];
        let [u, v] = if u + v > 1.0 {
            [1.0 - u, 1.0 - v]
        } else {
            [u, v]
        };
        let point = a * (1.0 - u - v) + b * u + c * v;
        let part = self.sizes.part(point);
        let offset = self.ray_offset * area_normal.normalize_or_zero();
        Probe {
            triangle,
            places: self.triangles[triangle as usize],
            vertices: corners.vertices,
            weights: [1.0 - u - v, u, v],
            origin: point + offset,
            face: area_normal.normalize_or_zero(),
            weight: 0.5 * area_normal.length() / part.powi(2),
            exact: Vec::new(),
            normal: Normal {
                direction: Vec3::ZERO,
                tilt: self.tilt(triangle),
            },
            resolution: 0.0,
        }
    }
}

impl Probe {
    fn mean(&self, value: impl Fn(u32) -> Vec3) -> Vec3 {
        let weighted = self.vertices.iter().zip(self.weights);
        weighted
            .map(|(&vertex, weight)| weight * value(vertex))
            .sum()
    }
}
