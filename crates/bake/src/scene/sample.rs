//! Points of a scene -> what is seen from them.

use std::sync::atomic::Ordering;
use std::time::Instant;

use glam::Vec3;
use nalgebra::DMatrix;
use rayon::prelude::*;

use super::bounce::mirrors;
use super::options::Options;
use super::statistics::{Counters, add_time, load};
use crate::compress::{Normal, Samples, Weighting};
use crate::mesh::{Mesh, cluster};
use crate::monitor::{Interrupted, Monitor};
use crate::ssdf::{Sampled, Sampler};
use crate::transfer::radiosity::Radiosity;
use crate::visibility::contour::ContourMesh;
use crate::visibility::places::{Divided, Places};
use crate::visibility::{self, Bitmap};

/// Sine of the angle by which normal maps are taken to turn normals; texels that turn them
/// further only see larger errors.
const NORMAL_MAP_TILT: f32 = 0.35;

/// Vertices of a chunk, at most.
pub(super) const CHUNK_VERTICES: usize = 1024;
/// What the SSDFs of all chunks at hand may take, bytes; copies that compression makes of
/// them come to about six times as much.
const CHUNK_BUDGET_BYTES: usize = 96 << 20;

/// Normals whose differences are shorter are the same.
const SAME_NORMAL: f32 = 1e-3;

/// Where vertices are sampled.
pub(super) struct Placed {
    pub(super) origins: Vec<Vec3>,
    /// The place of every vertex.
    places: Vec<u32>,
    /// The places of every triangle's corners.
    pub(super) triangles: Vec<[u32; 3]>,
    ray_offset: f32,
}

impl Placed {
    /// Copies vertices that see different things from different sides.
    pub(super) fn new(mesh: &mut Mesh, contours: &ContourMesh, ray_offset: f32) -> Self {
        let triangles = mesh.indices();
        let places = Places::new(&mesh.positions(), &triangles, contours.caster(), ray_offset);
        let divided = Divided::new(&triangles, mesh.vertices.len(), &places.corners);
        for (triangle, vertices) in mesh.triangles.iter_mut().zip(divided.triangles) {
            triangle.vertices = vertices;
        }
        for vertex in divided.copied {
            mesh.vertices.push(mesh.vertices[vertex as usize]);
        }
        Self {
            origins: places.origins,
            places: divided.places,
            triangles: places.corners,
            ray_offset,
        }
    }
}

/// A refined scene with all that sampling and compressing parts of it needs, in any order.
pub(super) struct Prepared<'a> {
    pub(super) options: Options,
    pub(super) monitor: Monitor<'a>,
    /// Without its materials.
    pub(super) mesh: Mesh,
    /// How far the normal map of each material may turn normals, as in [`Normal::tilt`].
    tilts: Vec<f32>,
    /// The place of every vertex of the mesh.
    pub(super) places: Vec<u32>,
    /// The places of every triangle's corners.
    pub(super) triangles: Vec<[u32; 3]>,
    /// Triangles that are sampled and compressed together.
    pub(super) chunks: Vec<Vec<u32>>,
    /// Where visibility is sampled, one point per place.
    pub(super) origins: Vec<Vec3>,
    pub(super) contours: ContourMesh,
    /// Distance of samples from the surface, metres.
    pub(super) ray_offset: f32,
    /// Light after its bounces, if it is to bounce.
    pub(super) radiosity: Option<Radiosity>,
    /// Whether each material shows what is about it.
    pub(super) mirrors: Vec<bool>,
    pub(super) sampler: Sampler,
    pub(super) weighting: Weighting,
    /// Whether every point is also sampled by one ray per texel.
    pub(super) verify: bool,
    pub(super) counters: Counters,
}

impl<'a> Prepared<'a> {
    pub(super) fn new(
        mut mesh: Mesh,
        placed: Placed,
        chunks: Vec<Vec<u32>>,
        (contours, radiosity): (ContourMesh, Option<Radiosity>),
        options: &Options,
        monitor: Monitor<'a>,
    ) -> Self {
        let tilt = |material: relight_format::Material| match material.normal_texture {
            Some(_) => NORMAL_MAP_TILT,
            None => 0.0,
        };
        let mirrors = mesh.materials.iter().map(mirrors).collect();
        let tilts = mesh.materials.drain(..).map(tilt).collect();
        Self {
            options: options.clone(),
            monitor,
            tilts,
            origins: placed.origins,
            places: placed.places,
            triangles: placed.triangles,
            ray_offset: placed.ray_offset,
            mesh,
            chunks,
            contours,
            radiosity,
            mirrors,
            sampler: Sampler::new(
                options.sample_resolution,
                options.basis_resolution,
                options.distance_clamp,
            ),
            weighting: Weighting::new(options.basis_resolution),
            verify: false,
            counters: Counters::default(),
        }
    }

    /// Forgets what was counted.
    pub(super) fn reset(&mut self) {
        self.counters = Counters::default();
        self.sampler.reset();
    }

    /// Vertices of some chunks, those that they share for each.
    pub(super) fn vertices_of_chunks(&self, chunks: &[usize]) -> u64 {
        let vertices = |chunk: &usize| self.vertices_of(&self.chunks[*chunk]).len() as u64;
        chunks.par_iter().map(vertices).sum()
    }

    /// How many chunks are compressed at a time.
    pub(super) fn chunks_at_hand(&self) -> usize {
        let texels = (self.options.basis_resolution as usize).pow(2);
        let chunk_bytes = CHUNK_VERTICES * texels * size_of::<f32>();
        (CHUNK_BUDGET_BYTES / chunk_bytes).clamp(1, rayon::current_num_threads())
    }

    /// Vertices that some triangles use, ascending.
    pub(super) fn vertices_of(&self, triangles: &[u32]) -> Vec<u32> {
        cluster::vertices_of(triangles, &self.triangles)
    }

    /// Vertices of the mesh that some triangles use, ascending: at hard edges several of one
    /// place.
    pub(super) fn mesh_vertices_of(&self, triangles: &[u32]) -> Vec<u32> {
        let mut used: Vec<u32> = (triangles.iter())
            .flat_map(|&index| self.mesh.triangles[index as usize].vertices)
            .collect();
        used.sort_unstable();
        used.dedup();
        used
    }

    /// The vertices that some triangles use, and what they see.
    pub(super) fn samples(&self, triangles: &[u32]) -> Result<(Vec<u32>, Samples), Interrupted> {
        let vertices = self.vertices_of(triangles);
        let ssdfs = self.ssdfs(&vertices)?;
        let start = Instant::now();
        let samples = self.weighed(triangles, &vertices, ssdfs);
        add_time(&self.counters.compress_nanoseconds, start);
        Ok((vertices, samples))
    }

    /// SSDFs of `vertices`, which `triangles` use, with their weights.
    pub(super) fn weighed(
        &self,
        triangles: &[u32],
        vertices: &[u32],
        ssdfs: DMatrix<f32>,
    ) -> Samples {
        let normals = self.normals(triangles, vertices);
        Samples::new(ssdfs, &normals, &self.weighting)
    }

    /// Shading normals at `places`, which `triangles` use: their mean, and how far others of
    /// the same place, and normal maps, turn away from it.
    fn normals(&self, triangles: &[u32], places: &[u32]) -> Vec<Normal> {
        let mut normals = vec![
            Normal {
                direction: Vec3::ZERO,
                tilt: 0.0,
            };
            places.len()
        ];
        let corners = |triangle: u32| {
            let vertices = self.mesh.triangles[triangle as usize].vertices;
            vertices.map(|vertex| {
                let place = self.places[vertex as usize];
                let normal = self.mesh.vertices[vertex as usize].normal;
                let column = places.partition_point(|&other| other < place);
                (column, normal.normalize_or_zero())
            })
        };
        for &triangle in triangles {
            for (column, normal) in corners(triangle) {
                // Where all are the same, their mean is it to the last bit.
                let sum = &mut normals[column].direction;
                if sum.normalize_or_zero().distance(normal) > SAME_NORMAL {
                    *sum += normal;
                }
            }
        }
        for normal in &mut normals {
            normal.direction = normal.direction.normalize_or_zero();
        }
        for &triangle in triangles {
            let map = self.tilt(triangle);
            for (column, corner) in corners(triangle) {
                let normal = &mut normals[column];
                let cosine = normal.direction.dot(corner);
                let turned = if cosine > 0.0 {
                    (1.0 - cosine * cosine).max(0.0).sqrt()
                } else {
                    1.0
                };
                normal.tilt = normal.tilt.max((map + turned).min(1.0));
            }
        }
        normals
    }

    /// How far a normal map may turn a triangle's normals, as in [`Normal::tilt`].
    pub(super) fn tilt(&self, triangle: u32) -> f32 {
        self.tilts[usize::from(self.mesh.triangles[triangle as usize].material)]
    }

    /// Clamped SSDFs at the basis resolution: one column per vertex.
    pub(super) fn ssdfs(&self, vertices: &[u32]) -> Result<DMatrix<f32>, Interrupted> {
        let texels = (self.options.basis_resolution as usize).pow(2);
        let mut ssdfs = DMatrix::zeros(texels, vertices.len());
        let columns = ssdfs.as_mut_slice().chunks_exact_mut(texels);
        let origins = vertices.iter().map(|&vertex| self.origins[vertex as usize]);
        self.sample(origins.zip(columns).collect(), |column, sampled| {
            column.copy_from_slice(&sampled.distances);
            self.counters.sampled.fetch_add(1, Ordering::Relaxed);
        })?;
        Ok(ssdfs)
    }

    /// Samples points and hands over, for each, what is seen from there.
    pub(super) fn sample<T: Send>(
        &self,
        points: Vec<(Vec3, T)>,
        hand_over: impl Fn(&mut T, Sampled) + Sync,
    ) -> Result<(), Interrupted> {
        self.sampler
            .sample(&self.contours, points, |for_whom, sampled| {
                if self.verify {
                    self.compare(sampled.origin, sampled.visible);
                }
                hand_over(for_whom, sampled);
                self.report()
            })
    }

    /// Counts the texels in which one ray each finds something else.
    fn compare(&self, origin: Vec3, visible: &Bitmap) {
        let counters = &self.counters;
        let start = Instant::now();
        let directions = self.sampler.directions();
        let exact = visibility::sample(self.contours.caster(), origin, directions);
        let texels = 0..directions.as_slice().len();
        let differing = texels.filter(|&i| exact.get(i) != visible.get(i)).count();
        counters.verified.fetch_add(1, Ordering::Relaxed);
        (counters.differing).fetch_add(differing as u64, Ordering::Relaxed);
        add_time(&counters.verify_nanoseconds, start);
    }

    /// Sampling and compressing a vertex count alike: once the first chunks are through,
    /// both go on side by side, and any weights tell the time left.
    pub(super) fn report(&self) -> Result<(), Interrupted> {
        let total = 2 * load(&self.counters.total);
        if total == 0 {
            return self.monitor.step("budget", 0.0);
        }
        let done = load(&self.counters.sampled) + load(&self.counters.compressed);
        let fraction = done as f64 / total as f64;
        self.monitor
            .step("visibility and compression", fraction.min(0.999) as f32)
    }
}
