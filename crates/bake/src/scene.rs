//! The scene bake: every stage in order, from an imported scene to the asset.
//!
//! Clusters are made from geometry alone, before visibility is known, so the bake streams:
//! a chunk of triangles is sampled, transformed, compressed and forgotten before the next.
//! What is held grows with threads × chunk, never with vertices × texels.

use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use glam::Vec3;
use nalgebra::DMatrix;
use rayon::prelude::*;
use relight_format as format;
use relight_format::{CHANNELS_PER_TILE, MAX_TILES_PER_CLUSTER, Representation};

use crate::compress::{self, Compressed, ErrorSums};
use crate::contour::{ContourMesh, Scratch};
use crate::import::Mesh;
use crate::monitor::{Interrupted, Monitor};
use crate::ray::RayCaster;
use crate::scene_input::SceneInput;
use crate::visibility::Directions;
use crate::{cluster, refine, ssdf, visibility};

/// Vertices whose SSDFs are in memory at once, per thread.
const CHUNK_VERTICES: usize = 1024;
/// A cluster of fewer vertices is not split further: its basis would outweigh it.
const MIN_CLUSTER_VERTICES: usize = 96;
/// Distance of a visibility sample from its surface, in diagonals of the scene: far above
/// the rounding of coordinates, far below anything that casts a visible shadow.
const RELATIVE_RAY_OFFSET: f32 = 1e-4;

/// What to trade. Every field has its default in [`Options::standard`].
#[derive(Clone, Debug, PartialEq)]
pub struct Options {
    /// Rays per vertex are this number squared; a multiple of `basis_resolution`.
    pub sample_resolution: u32,
    /// Texels per side of a stored basis image.
    pub basis_resolution: u32,
    /// SSDFs are clamped to ± this angle, radians.
    pub distance_clamp: f32,
    /// Clustered or global principal components.
    pub representation: Representation,
    /// Clustered: tiles of four images per cluster, at most. The GPU's cost of a sample is
    /// proportional to the tiles.
    pub max_tiles: u32,
    /// Clustered: root mean square error near the visibility boundary that a cluster may
    /// have, radians; clusters gain tiles, then split, until they meet it.
    pub max_error: f32,
    /// Global: components besides the mean.
    pub global_rank: u32,
    /// Longest edge after refinement, as a fraction of the diagonal of the scene without
    /// its ground. A scene file may set its own in metres. The default leaves the default
    /// ground, of 1/80 of three extents, as it is.
    pub max_edge: f32,
    /// Refinement stops here.
    pub max_vertices: usize,
}

impl Options {
    /// For looking at a scene soon: a quarter of the rays and a coarse budget.
    pub fn draft() -> Self {
        Self {
            sample_resolution: 64,
            max_tiles: 2,
            max_error: 0.02,
            max_edge: 0.08,
            ..Self::standard()
        }
    }

    /// The default.
    pub fn standard() -> Self {
        Self {
            sample_resolution: 128,
            basis_resolution: 64,
            distance_clamp: 0.5,
            representation: Representation::ClusteredPca,
            max_tiles: 4,
            max_error: 0.01,
            global_rank: 24,
            max_edge: 0.04,
            max_vertices: 1_000_000,
        }
    }

    /// Small errors at several times the size.
    pub fn high() -> Self {
        Self {
            max_error: 0.004,
            max_edge: 0.02,
            ..Self::standard()
        }
    }
}

/// Processor time per stage, and what was done in it.
#[derive(Clone, Debug, Default)]
pub struct Statistics {
    /// Name of the stage and processor time spent in it, summed over threads.
    pub stages: Vec<(&'static str, Duration)>,
    /// Rays cast.
    pub rays: u64,
    /// Vertices sampled; more than the asset's where chunks share vertices.
    pub sampled_vertices: u64,
    /// Compression error.
    pub error: ErrorSums,
}

/// Why a scene could not be baked.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// Asked to stop.
    #[error("stopped")]
    Interrupted(#[from] Interrupted),
    /// The options contradict each other or the scene.
    #[error("{place}: expected {expected}, found {found}")]
    Options {
        /// The option.
        place: &'static str,
        /// What would do.
        expected: String,
        /// What was given.
        found: String,
    },
}

/// A finished cluster, in indices of the whole mesh.
struct Finished {
    triangles: Vec<u32>,
    vertices: Vec<u32>,
    compressed: Compressed,
}

/// What every chunk shares.
struct Context<'a> {
    options: &'a Options,
    triangles: &'a [[u32; 3]],
    origins: &'a [Vec3],
    caster: RayCaster,
    contours: ContourMesh,
    directions: Directions,
    transform: ssdf::Transform,
    monitor: Monitor<'a>,
    /// Vertices to sample, a close estimate.
    total: usize,
    sampled: AtomicU64,
    rays: AtomicU64,
    visibility_nanoseconds: AtomicU64,
    ssdf_nanoseconds: AtomicU64,
    compress_nanoseconds: AtomicU64,
}

/// Bakes a scene. Deterministic: the same input and options give the same asset on any
/// number of threads.
pub fn bake(
    input: SceneInput,
    options: &Options,
    monitor: Monitor,
) -> Result<(format::Scene, Statistics), Error> {
    check(options)?;
    let mut statistics = Statistics::default();
    let mut clock = Instant::now();
    let mut lap = |statistics: &mut Statistics, stage| {
        statistics.stages.push((stage, clock.elapsed()));
        clock = Instant::now();
    };
    monitor.step("refine", 0.0)?;
    let source = (
        input.mesh.vertices.len() as u64,
        input.mesh.triangles.len() as u64,
    );
    let diagonal = input
        .mesh
        .bounds()
        .map_or(0.0, |(low, high)| low.distance(high));
    let (max_edge, max_vertices) = refinement(&input, options);
    let mut mesh = refine::refine(input.mesh, max_edge, max_vertices);
    let mut warnings = input.warnings;
    warnings.extend(
        mesh.warnings
            .drain(..)
            .filter(|w| !warnings.contains(w))
            .collect::<Vec<_>>(),
    );
    lap(&mut statistics, "refine");

    monitor.step("build bvh", 0.0)?;
    let positions: Vec<Vec3> = mesh.vertices.iter().map(|v| v.position.into()).collect();
    let triangles: Vec<[u32; 3]> = mesh.triangles.iter().map(|t| t.vertices).collect();
    let ray_offset = RELATIVE_RAY_OFFSET * diagonal;
    let soup: Vec<[Vec3; 3]> = triangles
        .iter()
        .map(|t| t.map(|vertex| positions[vertex as usize]))
        .collect();
    let directions = Directions::new(options.sample_resolution);
    let context = Context {
        options,
        triangles: &triangles,
        origins: &visibility::origins(&positions, &triangles, ray_offset),
        caster: RayCaster::new(&soup),
        contours: ContourMesh::new(&soup),
        transform: ssdf::Transform::new(&directions, options.basis_resolution),
        directions,
        monitor,
        total: positions.len(),
        sampled: AtomicU64::new(0),
        rays: AtomicU64::new(0),
        visibility_nanoseconds: AtomicU64::new(0),
        ssdf_nanoseconds: AtomicU64::new(0),
        compress_nanoseconds: AtomicU64::new(0),
    };
    lap(&mut statistics, "build bvh");

    let finished = match options.representation {
        Representation::ClusteredPca => {
            let chunks = cluster::partition(&positions, &triangles, CHUNK_VERTICES);
            let finished: Vec<Vec<Finished>> = chunks
                .into_par_iter()
                .map(|chunk| context.bake_chunk(chunk))
                .collect::<Result<_, _>>()?;
            finished.into_iter().flatten().collect()
        }
        Representation::GlobalPca => vec![context.bake_global()?],
    };
    let nanoseconds = |counter: &AtomicU64| Duration::from_nanos(counter.load(Ordering::Relaxed));
    statistics
        .stages
        .push(("visibility", nanoseconds(&context.visibility_nanoseconds)));
    statistics
        .stages
        .push(("ssdf", nanoseconds(&context.ssdf_nanoseconds)));
    statistics
        .stages
        .push(("compress", nanoseconds(&context.compress_nanoseconds)));
    statistics.sampled_vertices = context.sampled.load(Ordering::Relaxed);
    statistics.rays = context.rays.load(Ordering::Relaxed);
    for cluster in &finished {
        statistics.error.add(&cluster.compressed.error);
    }
    if finished.len() > usize::from(u16::MAX) {
        return Err(Error::Options {
            place: "max_error",
            expected: format!("at most {} clusters", u16::MAX),
            found: format!("{} clusters; allow a larger error", finished.len()),
        });
    }
    let mut scene = format::Scene {
        name: input.name,
        visibility: format::VisibilityParameters {
            representation: options.representation,
            sample_resolution: options.sample_resolution,
            basis_resolution: options.basis_resolution,
            distance_clamp: options.distance_clamp,
            ray_offset,
        },
        camera: input.camera,
        materials: std::mem::take(&mut mesh.materials),
        textures: std::mem::take(&mut mesh.textures),
        report: format::BakeReport {
            source_vertices: source.0,
            source_triangles: source.1,
            rms_error: statistics.error.rms(),
            boundary_rms_error: statistics.error.boundary_rms(),
            warnings,
        },
        vertices: Vec::new(),
        triangles: Vec::new(),
        clusters: Vec::new(),
        coefficients: Vec::new(),
        basis: Vec::new(),
    };
    for cluster in finished {
        append(&mut scene, &mesh, cluster);
    }
    monitor.step("bake", 1.0)?;
    Ok((scene, statistics))
}

fn check(options: &Options) -> Result<(), Error> {
    let Options {
        sample_resolution: sample,
        basis_resolution: basis,
        ..
    } = *options;
    let wrong = |place, expected: String, found: String| {
        Err(Error::Options {
            place,
            expected,
            found,
        })
    };
    if !(8..=512).contains(&basis) || !(basis..=256).contains(&sample) || sample % basis != 0 {
        return wrong(
            "resolution",
            "a basis resolution in 8..=512 that divides a sample resolution up to 256".into(),
            format!("{basis} and {sample}"),
        );
    }
    if !(1..=MAX_TILES_PER_CLUSTER).contains(&options.max_tiles) {
        return wrong(
            "max_tiles",
            format!("1..={MAX_TILES_PER_CLUSTER}"),
            options.max_tiles.to_string(),
        );
    }
    let max_rank = MAX_TILES_PER_CLUSTER * CHANNELS_PER_TILE as u32 - 1;
    if options.global_rank > max_rank {
        return wrong(
            "global_rank",
            format!("0..={max_rank}"),
            options.global_rank.to_string(),
        );
    }
    let positive = [options.distance_clamp, options.max_error, options.max_edge];
    if !positive.iter().all(|value| *value > 0.0) || options.distance_clamp > 3.0 {
        return wrong(
            "options",
            "a clamp in (0, 3], an error and an edge length above 0".into(),
            format!("{positive:?}"),
        );
    }
    Ok(())
}

/// Edge bound in metres and vertex bound: the scene file's, else the options'.
fn refinement(input: &SceneInput, options: &Options) -> (f32, usize) {
    let from_file = input.refinement.as_ref();
    let max_edge = from_file.map_or(options.max_edge * input.object_diagonal, |refinement| {
        refinement.max_edge
    });
    let max_vertices = from_file
        .and_then(|refinement| refinement.max_vertices)
        .unwrap_or(options.max_vertices);
    (max_edge, max_vertices)
}

impl Context<'_> {
    fn bake_chunk(&self, triangles: Vec<u32>) -> Result<Vec<Finished>, Interrupted> {
        let vertices = cluster::vertices_of(&triangles, self.triangles);
        let ssdfs = self.ssdfs(&vertices)?;
        let start = Instant::now();
        let mut finished = Vec::new();
        self.compress_clusters(triangles, vertices, &ssdfs, &mut finished);
        add_time(&self.compress_nanoseconds, start);
        Ok(finished)
    }

    fn bake_global(&self) -> Result<Finished, Interrupted> {
        let triangles: Vec<u32> = (0..self.triangles.len() as u32).collect();
        let vertices = cluster::vertices_of(&triangles, self.triangles);
        let ssdfs = self.ssdfs(&vertices)?;
        let start = Instant::now();
        let rank = self.options.global_rank as usize;
        let basis = compress::analyse(&ssdfs, rank);
        let compressed = compress::Encoder::new(&ssdfs, &basis).encode(rank + 1);
        add_time(&self.compress_nanoseconds, start);
        Ok(Finished {
            triangles,
            vertices,
            compressed,
        })
    }

    /// Clamped SSDFs at the basis resolution: one column per vertex.
    fn ssdfs(&self, vertices: &[u32]) -> Result<DMatrix<f32>, Interrupted> {
        let columns: Vec<Vec<f32>> = vertices
            .par_iter()
            .map_init(
                || self.contours.scratch(&self.directions),
                |scratch, &vertex| self.ssdf(vertex, scratch),
            )
            .collect::<Result<_, Interrupted>>()?;
        let texels = (self.options.basis_resolution as usize).pow(2);
        Ok(DMatrix::from_iterator(
            texels,
            columns.len(),
            columns.into_iter().flatten(),
        ))
    }

    fn ssdf(&self, vertex: u32, scratch: &mut Scratch) -> Result<Vec<f32>, Interrupted> {
        let start = Instant::now();
        let origin = self.origins[vertex as usize];
        let (bitmap, rays) = self
            .contours
            .sample(&self.caster, origin, &self.directions, scratch);
        add_time(&self.visibility_nanoseconds, start);
        let start = Instant::now();
        let column = self.transform.apply(&bitmap, self.options.distance_clamp);
        add_time(&self.ssdf_nanoseconds, start);
        self.rays.fetch_add(u64::from(rays), Ordering::Relaxed);
        let done = self.sampled.fetch_add(1, Ordering::Relaxed) + 1;
        let fraction = (done as f32 / self.total as f32).min(0.999);
        self.monitor.step("visibility and compression", fraction)?;
        Ok(column)
    }

    /// Adds tiles until the cluster meets the error bound, or splits it along its leading
    /// principal component: vertices that see alike stay together.
    fn compress_clusters(
        &self,
        mut triangles: Vec<u32>,
        vertices: Vec<u32>,
        ssdfs: &DMatrix<f32>,
        finished: &mut Vec<Finished>,
    ) {
        let max_channels = self.options.max_tiles as usize * CHANNELS_PER_TILE;
        let basis = compress::analyse(ssdfs, max_channels - 1);
        let encoder = compress::Encoder::new(ssdfs, &basis);
        let mut channels = CHANNELS_PER_TILE;
        let compressed = loop {
            let compressed = encoder.encode(channels);
            let good = compressed.error.boundary_rms() <= self.options.max_error;
            if good || channels >= max_channels.min(basis.images.ncols()) {
                break compressed;
            }
            channels += CHANNELS_PER_TILE;
        };
        let good = compressed.error.boundary_rms() <= self.options.max_error;
        if good || vertices.len() < MIN_CLUSTER_VERTICES || triangles.len() < 2 {
            finished.push(Finished {
                triangles,
                vertices,
                compressed,
            });
            return;
        }
        let position = |triangle: u32| -> f32 {
            self.triangles[triangle as usize]
                .iter()
                .filter_map(|vertex| vertices.binary_search(vertex).ok())
                .map(|column| basis.projections[(0, column)])
                .sum()
        };
        let mut keyed: Vec<(f32, u32)> = triangles.drain(..).map(|t| (position(t), t)).collect();
        keyed.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        let (low, high) = keyed.split_at(keyed.len() / 2);
        drop((encoder, basis));
        for half in [low, high] {
            let mut group: Vec<u32> = half.iter().map(|&(_, triangle)| triangle).collect();
            group.sort_unstable();
            let members = cluster::vertices_of(&group, self.triangles);
            let columns: Vec<usize> = members
                .iter()
                .filter_map(|vertex| vertices.binary_search(vertex).ok())
                .collect();
            let subset = ssdfs.select_columns(&columns);
            self.compress_clusters(group, members, &subset, finished);
        }
    }
}

fn add_time(counter: &AtomicU64, start: Instant) {
    counter.fetch_add(start.elapsed().as_nanos() as u64, Ordering::Relaxed);
}

/// Lays out a cluster behind the others; vertices that several share are repeated.
fn append(scene: &mut format::Scene, mesh: &Mesh, finished: Finished) {
    let Finished {
        triangles,
        vertices,
        compressed,
    } = finished;
    let number = scene.clusters.len() as u16;
    let first_vertex = scene.vertices.len() as u32;
    scene.clusters.push(format::Cluster {
        first_vertex,
        vertex_count: vertices.len() as u32,
        first_coefficient: scene.coefficients.len() as u32,
        first_tile: scene
            .clusters
            .last()
            .map_or(0, |last| last.first_tile + last.tiles),
        tiles: compressed.tiles,
        coefficient_scale: compressed.coefficient_scale,
    });
    scene.coefficients.extend(compressed.coefficients);
    scene.basis.extend(compressed.basis);
    scene
        .vertices
        .extend(vertices.iter().map(|&v| mesh.vertices[v as usize]));
    scene.triangles.extend(triangles.iter().map(|&triangle| {
        let source = &mesh.triangles[triangle as usize];
        format::Triangle {
            vertices: source.vertices.map(|vertex| {
                let local = vertices.partition_point(|&other| other < vertex);
                first_vertex + local as u32
            }),
            material: source.material,
            cluster: number,
        }
    }));
}
