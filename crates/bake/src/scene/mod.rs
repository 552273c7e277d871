//! The scene bake: every stage in order, from an imported scene to the asset.
//!
//! Clusters are made from geometry alone, before visibility is known, so the bake streams:
//! a chunk of triangles is sampled, transformed, compressed and handed over before the
//! next. What is held grows with neither vertices × texels nor threads.

mod budget;
pub mod description;
pub mod fingerprint;
mod layout;
pub mod load;
pub mod parts;
pub mod seam;
mod surface;

use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use glam::Vec3;
use nalgebra::DMatrix;
use rayon::prelude::*;
use relight_format as format;
use relight_format::{CHANNELS_PER_TILE, MAX_TILES_PER_CLUSTER, Representation};

use crate::compress::{self, Compressed, Normal, Samples, Weighting};
use crate::mesh::{Mesh, cluster, refine};
use crate::monitor::{Interrupted, Monitor};
use crate::scene::fingerprint::Fingerprint;
use crate::scene::load::SceneInput;
use crate::visibility::Directions;
use crate::visibility::contour::{self, ContourMesh, Scratch};
use crate::{ssdf, visibility};
pub use surface::ErrorSums;
use surface::Probe;

/// Vertices of a chunk, at most.
const CHUNK_VERTICES: usize = 1024;
/// What the SSDFs of all chunks at hand may take, bytes; copies that compression makes of
/// them come to about six times as much.
const CHUNK_BUDGET_BYTES: usize = 96 << 20;
/// Edges up to this part of the object's diagonal are not cut for their error: shadows of
/// contacts have no finest scale.
const RELATIVE_MIN_EDGE: f32 = 0.004;
/// The part of the object's diagonal that errors of edges are told for.
const RELATIVE_EDGE: f32 = 0.02;
/// Sine of the angle by which normal maps are taken to turn normals; texels that turn them
/// further only see larger errors.
const NORMAL_MAP_TILT: f32 = 0.35;
/// What the error aimed at, squared, is worth in bytes per vertex.
const BYTES_PER_ERROR: f32 = 20.0;
/// Bytes that a texel of a basis image and a coefficient take in a file, about.
const BASIS_BYTES: f32 = 0.28;
const COEFFICIENT_BYTES: f32 = 0.8;
/// Part of a cluster's squared error that a split is taken to take away at most.
const SPLIT_GAIN: f32 = 0.75;
/// A cluster of fewer vertices is not split further: its basis would outweigh it.
const MIN_CLUSTER_VERTICES: usize = 96;
/// Rounds of fitting images and coefficients to each other, when clusters are planned and
/// when they are made.
const PLANNING_ROUNDS: usize = 1;
const ROUNDS: usize = 3;
/// Distance of a visibility sample from its surface, in diagonals of the scene: far above
/// the rounding of coordinates, far below anything that casts a visible shadow.
const RELATIVE_RAY_OFFSET: f32 = 1e-4;

/// Triangles in which interpolation is checked, about, but for small scenes one of so many.
const PROBES: usize = 2048;
const LEAST_PROBE_STEP: usize = 4;

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
    /// Clustered: at what rate clusters buy accuracy with bytes, as the error, radians, that
    /// one of ordinary detail ends near. Finer detail ends above it, the rest below.
    pub aim: f32,
    /// Clustered: in place of `aim`, the error that the scene's surface shall have, radians
    /// ([`format::VisibilityErrors::surface`]).
    pub max_error: Option<f32>,
    /// Clustered: in place of `aim`, the bytes that the asset may have.
    pub max_bytes: Option<u64>,
    /// Global: components besides the mean.
    pub global_rank: u32,
    /// Longest edge after refinement, as a fraction of the diagonal of the scene without
    /// its ground. A scene file may set its own in metres. Vertices that lie closer together
    /// also see more alike, and share more of what is stored: half of the length costs twice
    /// the bytes.
    pub max_edge: f32,
    /// Edges are cut further where interpolated visibility is off by more than this, radians
    /// ([`refine::Bound::error`], at a length of 0.02 of the diagonal); infinite
    /// for nowhere. A scene file may set its own.
    pub refine_error: f32,
    /// Refinement stops here.
    pub max_vertices: usize,
}

impl Options {
    /// For looking at a scene soon: a quarter of the rays and a coarse budget.
    pub fn draft() -> Self {
        Self {
            sample_resolution: 64,
            max_tiles: 2,
            aim: 0.02,
            max_edge: 0.08,
            refine_error: f32::INFINITY,
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
            aim: 0.005,
            max_error: None,
            max_bytes: None,
            global_rank: 24,
            max_edge: 0.02,
            refine_error: f32::INFINITY,
            max_vertices: 1_000_000,
        }
    }

    /// Small errors at several times the size, and vertices where shadows fall.
    pub fn high() -> Self {
        Self {
            aim: 0.0025,
            max_tiles: 6,
            max_edge: 0.06,
            refine_error: 0.01,
            ..Self::standard()
        }
    }
}

/// Processor time per stage, and what was done in it.
#[derive(Clone, Debug, Default)]
pub struct Statistics {
    /// Name of the stage and processor time spent in it, summed over threads.
    pub stages: Vec<(&'static str, Duration)>,
    /// Rays cast, without those that only verify.
    pub rays: u64,
    /// Vertices sampled; more than the asset's where chunks share vertices.
    pub sampled_vertices: u64,
    /// Points between vertices where interpolation was checked.
    pub probes: u64,
    /// Points whose visibility was compared with one ray per texel: vertices, and between them.
    pub verified_points: u64,
    /// Texels that differed; anything but zero fails the bake.
    pub differing_texels: u64,
}

/// Why a scene could not be baked.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// Asked to stop.
    #[error(transparent)]
    Interrupted(#[from] Interrupted),
    /// The scene does not fit into an asset.
    #[error(transparent)]
    Format(#[from] format::Error),
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
    /// Contours and rays disagree.
    #[error(
        "visibility: expected the texels that one ray each gives, found {texels} others at \
         {vertices} vertices"
    )]
    Visibility {
        /// Vertices compared.
        vertices: u64,
        /// Texels that differ.
        texels: u64,
    },
}

/// What is seen from a point.
struct Sampled<'a> {
    visible: &'a visibility::Bitmap,
    crossings: &'a ssdf::Crossings,
    /// The SSDF, radians.
    distances: Vec<f32>,
}

/// A finished cluster; needs nothing else of the scene.
#[derive(Clone, Debug, PartialEq)]
pub struct Cluster {
    /// As stored.
    pub vertices: Vec<format::Vertex>,
    /// Indices into `vertices`; `cluster` is 0.
    pub triangles: Vec<format::Triangle>,
    /// Visibility of the vertices.
    pub compressed: Compressed,
    /// How far it is off.
    pub errors: ErrorSums,
}

/// A scene ready to be sampled: refined, divided into chunks that can be baked in any
/// order, apart from each other and on different machines.
pub struct Bake<'a> {
    options: Options,
    monitor: Monitor<'a>,
    fingerprint: u128,
    description: String,
    mesh: Mesh,
    /// What is known of the asset before sampling.
    head: format::Scene,
    triangles: Vec<[u32; 3]>,
    origins: Vec<Vec3>,
    chunks: Vec<Vec<u32>>,
    contours: ContourMesh,
    directions: Directions,
    transform: ssdf::Transform,
    weighting: Weighting,
    /// The error that clusters aim at, radians; what it is worth in bytes is the same for
    /// all.
    aim: f32,
    verify: bool,
    stages: Vec<(&'static str, Duration)>,
    counters: Counters,
}

/// Sums over all threads.
#[derive(Default)]
struct Counters {
    /// Vertices to sample and compress.
    total: AtomicU64,
    sampled: AtomicU64,
    probes: AtomicU64,
    compressed: AtomicU64,
    rays: AtomicU64,
    verified: AtomicU64,
    differing: AtomicU64,
    visibility_nanoseconds: AtomicU64,
    ssdf_nanoseconds: AtomicU64,
    compress_nanoseconds: AtomicU64,
    verify_nanoseconds: AtomicU64,
}

/// Bakes a scene in memory. Deterministic: the same input and options give the same asset
/// on any number of threads.
pub fn bake(
    input: SceneInput,
    options: &Options,
    monitor: Monitor,
) -> Result<(format::Scene, Statistics), Error> {
    let bake = Bake::new(input, options, monitor)?;
    let all: Vec<usize> = (0..bake.chunk_count()).collect();
    let finished: Vec<Mutex<Vec<Cluster>>> = all.iter().map(|_| Mutex::default()).collect();
    bake.run(&all, |chunk, clusters| {
        *finished[chunk]
            .lock()
            .unwrap_or_else(PoisonError::into_inner) = clusters;
        Ok::<_, Error>(())
    })?;
    let (head, statistics) = bake.finish();
    let chunks = finished
        .into_iter()
        .map(|chunk| Ok(chunk.into_inner().unwrap_or_else(PoisonError::into_inner)));
    let scene = assemble::<Error>(head, chunks)?;
    monitor.step("bake", 1.0)?;
    Ok((scene, statistics))
}

impl<'a> Bake<'a> {
    /// Refines the mesh, divides it into chunks and builds what rays and contours need.
    pub fn new(input: SceneInput, options: &Options, monitor: Monitor<'a>) -> Result<Self, Error> {
        check(options)?;
        let mut stages = Vec::new();
        let mut clock = Instant::now();
        monitor.step("build bvh", 0.0)?;
        // Refinement does not move the surface: what was imported blocks the same light with
        // the fewest edges.
        let soup = input.mesh.soup();
        let contours = ContourMesh::new(&soup);
        drop(soup);
        stages.push(("build bvh", clock.elapsed()));

        clock = Instant::now();
        monitor.step("refine", 0.0)?;
        let fingerprint = fingerprint(&input, options);
        let description = describe(&input, options);
        let diagonal = input.mesh.diagonal();
        let (max_edge, bound) = refinement(&input, options, RELATIVE_RAY_OFFSET * diagonal);
        let mut report = format::BakeReport {
            source_vertices: input.mesh.vertices.len() as u64,
            source_triangles: input.mesh.triangles.len() as u64,
            warnings: input.warnings,
            ..Default::default()
        };
        let by_error = bound.error.is_finite();
        // Of the vertices that may be added, half are kept for where shadows fall.
        let even_vertices = if by_error {
            usize::midpoint(input.mesh.vertices.len(), bound.max_vertices)
        } else {
            bound.max_vertices
        };
        let mut mesh = refine::refine(input.mesh, max_edge, even_vertices);
        if by_error {
            mesh = refine::refine_wrong(mesh, &contours, bound, monitor)?;
        }
        for warning in mesh.warnings.drain(..) {
            if !report.warnings.contains(&warning) {
                report.warnings.push(warning);
            }
        }
        let ray_offset = RELATIVE_RAY_OFFSET * diagonal;
        let head = format::Scene {
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
            report,
            vertices: Vec::new(),
            triangles: Vec::new(),
            clusters: Vec::new(),
            coefficients: Vec::new(),
            basis: Vec::new(),
        };
        let positions = mesh.positions();
        let triangles = mesh.indices();
        let chunks = match options.representation {
            Representation::ClusteredPca => {
                cluster::partition(&positions, &triangles, CHUNK_VERTICES)
            }
            Representation::GlobalPca => vec![(0..triangles.len() as u32).collect()],
        };
        stages.push(("refine", clock.elapsed()));

        let directions = Directions::new(options.sample_resolution);
        let transform = ssdf::Transform::new(&directions, options.basis_resolution);
        let mut bake = Self {
            aim: options.aim,
            options: options.clone(),
            monitor,
            fingerprint,
            description,
            head,
            origins: visibility::origins(&positions, &triangles, ray_offset),
            mesh,
            triangles,
            chunks,
            contours,
            directions,
            transform,
            weighting: Weighting::new(options.basis_resolution),
            verify: false,
            stages,
            counters: Counters::default(),
        };
        let asked = options.max_error.is_some() || options.max_bytes.is_some();
        if asked && options.representation == Representation::ClusteredPca {
            clock = Instant::now();
            bake.aim = bake.choose_aim()?;
            bake.stages.push(("budget", clock.elapsed()));
        }
        Ok(bake)
    }

    /// Also casts one ray per texel at every vertex; a difference fails the bake.
    pub fn verify_visibility(&mut self) {
        self.verify = true;
    }

    /// Chunks in all, numbered from 0.
    pub fn chunk_count(&self) -> usize {
        self.chunks.len()
    }

    /// Vertices of the refined mesh; chunks share some.
    pub fn vertex_count(&self) -> usize {
        self.mesh.vertices.len()
    }

    /// Of the input, the options and the version: chunks of equal fingerprints are the same.
    pub fn fingerprint(&self) -> u128 {
        self.fingerprint
    }

    /// What the fingerprint is of, for messages: a line of name and value for every option and
    /// part of the input.
    pub fn description(&self) -> &str {
        &self.description
    }

    /// Bakes chunks and hands each over as it finishes, from many threads and in no
    /// particular order. Stops at the first error.
    ///
    /// Chunks at hand at a time are bounded by memory as well as by threads; vertices of a
    /// chunk are sampled in parallel.
    pub fn run<E: From<Error> + Send>(
        &self,
        chunks: &[usize],
        hand_over: impl Fn(usize, Vec<Cluster>) -> Result<(), E> + Sync,
    ) -> Result<(), E> {
        let total = self.vertices_of_chunks(chunks);
        self.counters.total.store(total, Ordering::Relaxed);
        let queue = Queue {
            order: scattered(chunks),
            next: AtomicUsize::new(0),
            failed: AtomicBool::new(false),
            error: Mutex::new(None),
        };
        let at_hand = self.chunks_at_hand();
        let bake_next = |chunk| hand_over(chunk, self.bake_chunk(&self.chunks[chunk])?);
        rayon::scope(|scope| {
            for _ in 0..at_hand {
                scope.spawn(|scope| queue.work(scope, &bake_next));
            }
        });
        if let Some(error) = queue
            .error
            .into_inner()
            .unwrap_or_else(PoisonError::into_inner)
        {
            return Err(error);
        }
        let (vertices, texels) = (
            load(&self.counters.verified),
            load(&self.counters.differing),
        );
        if texels > 0 {
            return Err(Error::Visibility { vertices, texels }.into());
        }
        Ok(())
    }

    /// Vertices of some chunks, those that they share for each.
    fn vertices_of_chunks(&self, chunks: &[usize]) -> u64 {
        let vertices = |chunk: &usize| {
            cluster::vertices_of(&self.chunks[*chunk], &self.triangles).len() as u64
        };
        chunks.par_iter().map(vertices).sum()
    }

    /// How many chunks are compressed at a time.
    fn chunks_at_hand(&self) -> usize {
        let texels = (self.options.basis_resolution as usize).pow(2);
        let chunk_bytes = CHUNK_VERTICES * texels * size_of::<f32>();
        (CHUNK_BUDGET_BYTES / chunk_bytes).clamp(1, rayon::current_num_threads())
    }

    /// The asset without its clusters, and what was done.
    pub fn finish(self) -> (format::Scene, Statistics) {
        let counters = &self.counters;
        let mut stages = self.stages;
        for (stage, nanoseconds) in [
            ("visibility", &counters.visibility_nanoseconds),
            ("ssdf", &counters.ssdf_nanoseconds),
            ("compress", &counters.compress_nanoseconds),
            ("verify", &counters.verify_nanoseconds),
        ] {
            stages.push((stage, Duration::from_nanos(load(nanoseconds))));
        }
        if !self.verify {
            stages.pop();
        }
        let statistics = Statistics {
            stages,
            rays: load(&counters.rays),
            sampled_vertices: load(&counters.sampled),
            probes: load(&counters.probes),
            verified_points: load(&counters.verified),
            differing_texels: load(&counters.differing),
        };
        (self.head, statistics)
    }
}

/// Chunks to bake, and the first error.
struct Queue<E> {
    order: Vec<usize>,
    next: AtomicUsize,
    failed: AtomicBool,
    error: Mutex<Option<E>>,
}

impl<E: Send> Queue<E> {
    /// Bakes one chunk and queues itself again. A thread that waits for another's vertices
    /// may start on the next chunk meanwhile; one chunk per job keeps that short.
    fn work<'s>(
        &'s self,
        scope: &rayon::Scope<'s>,
        bake: &'s (impl Fn(usize) -> Result<(), E> + Sync),
    ) {
        let next = self.next.fetch_add(1, Ordering::Relaxed);
        let Some(&chunk) = self.order.get(next) else {
            return;
        };
        if self.failed.load(Ordering::Relaxed) {
            return;
        }
        match bake(chunk) {
            Ok(()) => scope.spawn(move |scope| self.work(scope, bake)),
            Err(error) => {
                self.failed.store(true, Ordering::Relaxed);
                let mut first = self.error.lock().unwrap_or_else(PoisonError::into_inner);
                first.get_or_insert(error);
            }
        }
    }
}

/// The chunks in steps of about the golden section. Chunks come in spatial order and
/// neighbours cost alike; this way any stretch of the work is a fair sample of the whole,
/// and the time left can be told from the time spent.
fn scattered(chunks: &[usize]) -> Vec<usize> {
    let count = chunks.len();
    let coprime = |step: &usize| {
        let (mut a, mut b) = (*step, count);
        while b > 0 {
            (a, b) = (b, a % b);
        }
        a == 1
    };
    let first = (count as f64 * 0.618) as usize;
    let step = (1..=first).rev().find(coprime).unwrap_or(1);
    (0..count).map(|i| chunks[i * step % count]).collect()
}

fn load(counter: &AtomicU64) -> u64 {
    counter.load(Ordering::Relaxed)
}

/// Everything that the asset depends on.
fn fingerprint(input: &SceneInput, options: &Options) -> u128 {
    let SceneInput {
        name,
        mesh,
        object_diagonal,
        camera,
        environment: _,
        lights: _,
        refinement,
        measured: _,
        warnings,
    } = input;
    let mut fingerprint = Fingerprint::default();
    fingerprint.add(env!("CARGO_PKG_VERSION").as_bytes());
    // Debug text of a number tells all its bits.
    let small = (
        name,
        object_diagonal,
        camera,
        refinement,
        warnings,
        &mesh.materials,
    );
    fingerprint.add(format!("{options:?} {small:?}").as_bytes());
    fingerprint.add(bytemuck::cast_slice(&mesh.vertices));
    for triangle in &mesh.triangles {
        fingerprint.add(bytemuck::cast_slice(&triangle.vertices));
        fingerprint.add(&triangle.material.to_le_bytes());
    }
    for texture in &mesh.textures {
        fingerprint.add_texture(texture);
    }
    fingerprint.value()
}

/// Lines of [`Bake::description`]: options as they are, parts of the input by their fingerprints.
fn describe(input: &SceneInput, options: &Options) -> String {
    let mut lines = format!("version: {}\n", env!("CARGO_PKG_VERSION"));
    for line in format!("{options:#?}")
        .replace("(\n        ", "(")
        .replace(",\n    )", ")")
        .lines()
    {
        if let Some((name, value)) = line.trim().trim_end_matches(',').split_once(": ") {
            lines += &format!("{name}: {value}\n");
        }
    }
    let mesh = &input.mesh;
    let mut add = |name: &str, fill: &dyn Fn(&mut Fingerprint)| {
        let mut fingerprint = Fingerprint::default();
        fill(&mut fingerprint);
        lines += &format!("{name}: {:08x}\n", fingerprint.value() as u32);
    };
    let text = |fingerprint: &mut Fingerprint, value: &dyn std::fmt::Debug| {
        fingerprint.add(format!("{value:?}").as_bytes());
    };
    add("name of the scene", &|f| text(f, &input.name));
    add("camera", &|f| text(f, &input.camera));
    add("refinement of the scene file", &|f| {
        text(f, &input.refinement);
    });
    add("materials", &|f| text(f, &mesh.materials));
    add("textures", &|f| {
        for texture in &mesh.textures {
            f.add_texture(texture);
        }
    });
    add("mesh", &|f| {
        f.add(bytemuck::cast_slice(&mesh.vertices));
        for triangle in &mesh.triangles {
            f.add(bytemuck::cast_slice(&triangle.vertices));
            f.add(&triangle.material.to_le_bytes());
        }
    });
    lines
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
    if options.max_bytes.is_some() && options.representation == Representation::GlobalPca {
        return wrong(
            "max_bytes",
            "a rank: the global representation has no other choice".into(),
            "a number of bytes".into(),
        );
    }
    let positive = [
        options.distance_clamp,
        options.aim,
        options.max_error.unwrap_or(options.aim),
        options.max_edge,
        options.refine_error,
    ];
    if !positive.iter().all(|value| *value > 0.0) || options.distance_clamp > 3.0 {
        return wrong(
            "options",
            "a clamp in (0, 3], an error and an edge length above 0".into(),
            format!("{positive:?}"),
        );
    }
    Ok(())
}

/// Edge bound in metres, and the bounds on cuts by error: the scene file's, else the
/// options'.
fn refinement(input: &SceneInput, options: &Options, ray_offset: f32) -> (f32, refine::Bound) {
    let file = input.refinement.as_ref();
    let max_edge = file.and_then(|refinement| refinement.max_edge);
    let bound = refine::Bound {
        error: file
            .and_then(|refinement| refinement.error)
            .unwrap_or(options.refine_error),
        edge: RELATIVE_EDGE * input.object_diagonal,
        min_edge: RELATIVE_MIN_EDGE * input.object_diagonal,
        max_vertices: file
            .and_then(|refinement| refinement.max_vertices)
            .unwrap_or(options.max_vertices),
        ray_offset,
    };
    (
        max_edge.unwrap_or(options.max_edge * input.object_diagonal),
        bound,
    )
}

impl Bake<'_> {
    fn bake_chunk(&self, triangles: &[u32]) -> Result<Vec<Cluster>, Error> {
        let (vertices, samples) = self.samples(triangles)?;
        let every = (self.triangles.len() / PROBES).max(LEAST_PROBE_STEP);
        let probes = self.probes(triangles, every as u32)?;
        let count = vertices.len() as u64;
        let start = Instant::now();
        let mut finished = Vec::new();
        if self.options.representation == Representation::GlobalPca {
            let rank = self.options.global_rank as usize;
            let basis = compress::analyse(&samples, rank);
            let compressed = compress::encode(&samples.fitted(), &basis.images, self.aim);
            let part = (triangles, &vertices[..], &samples);
            finished.push(self.cluster(part, &probes, compressed));
        } else {
            finished = self.compress_clusters(triangles, &vertices, &samples, &probes, self.aim)?;
        }
        add_time(&self.counters.compress_nanoseconds, start);
        self.counters.compressed.fetch_add(count, Ordering::Relaxed);
        self.report()?;
        Ok(finished)
    }

    /// The vertices that some triangles use, and what they see.
    fn samples(&self, triangles: &[u32]) -> Result<(Vec<u32>, Samples), Interrupted> {
        let vertices = cluster::vertices_of(triangles, &self.triangles);
        let ssdfs = self.ssdfs(&vertices)?;
        let start = Instant::now();
        let samples = self.weighed(triangles, &vertices, ssdfs);
        add_time(&self.counters.compress_nanoseconds, start);
        Ok((vertices, samples))
    }

    /// SSDFs of `vertices`, which `triangles` use, with their weights.
    fn weighed(&self, triangles: &[u32], vertices: &[u32], ssdfs: DMatrix<f32>) -> Samples {
        let normals = self.normals(triangles, vertices);
        Samples::new(ssdfs, &normals, &self.weighting)
    }

    /// Shading normals of `vertices`, which `triangles` use.
    fn normals(&self, triangles: &[u32], vertices: &[u32]) -> Vec<Normal> {
        let mut normals: Vec<Normal> = (vertices.iter())
            .map(|&vertex| Normal {
                direction: (self.mesh.vertices[vertex as usize].normal).normalize_or_zero(),
                tilt: 0.0,
            })
            .collect();
        for &triangle in triangles {
            let tilt = self.tilt(triangle);
            if tilt > 0.0 {
                for vertex in self.triangles[triangle as usize] {
                    normals[vertices.partition_point(|&other| other < vertex)].tilt = tilt;
                }
            }
        }
        normals
    }

    /// How far a normal map may turn a triangle's normals, as in [`Normal::tilt`].
    fn tilt(&self, triangle: u32) -> f32 {
        let material = self.mesh.triangles[triangle as usize].material;
        match self.head.materials[usize::from(material)].normal_texture {
            Some(_) => NORMAL_MAP_TILT,
            None => 0.0,
        }
    }

    /// Clamped SSDFs at the basis resolution: one column per vertex.
    fn ssdfs(&self, vertices: &[u32]) -> Result<DMatrix<f32>, Interrupted> {
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
    fn sample<T: Send>(
        &self,
        points: Vec<(Vec3, T)>,
        hand_over: impl Fn(&mut T, Sampled) + Sync,
    ) -> Result<(), Interrupted> {
        let mut points: Vec<(u32, Vec3, T)> = (0..)
            .zip(points)
            .map(|(number, (origin, for_whom))| (number, origin, for_whom))
            .collect();
        cluster::arrange(&mut points, contour::GROUP, &|(number, origin, _)| {
            (origin.to_array(), *number)
        });
        points.par_chunks_mut(contour::GROUP).try_for_each_init(
            || self.contours.scratch(&self.directions),
            |scratch, group| {
                let start = Instant::now();
                let origins: Vec<Vec3> = group.iter().map(|(_, origin, _)| *origin).collect();
                self.contours.prepare(&origins, scratch);
                add_time(&self.counters.visibility_nanoseconds, start);
                group.iter_mut().try_for_each(|(_, origin, for_whom)| {
                    self.sample_one(*origin, scratch, |sampled| hand_over(for_whom, sampled))
                })
            },
        )
    }

    fn sample_one(
        &self,
        origin: Vec3,
        scratch: &mut Scratch,
        hand_over: impl FnOnce(Sampled),
    ) -> Result<(), Interrupted> {
        let counters = &self.counters;
        let start = Instant::now();
        let (visible, rays) = self.contours.sample(origin, &self.directions, scratch);
        add_time(&counters.visibility_nanoseconds, start);
        let start = Instant::now();
        let crossings = self.contours.crossings(&visible, scratch);
        let distances = self
            .transform
            .apply(&visible, crossings, self.options.distance_clamp);
        add_time(&counters.ssdf_nanoseconds, start);
        hand_over(Sampled {
            visible: &visible,
            crossings,
            distances,
        });
        if self.verify {
            let start = Instant::now();
            let exact = visibility::sample(self.contours.caster(), origin, &self.directions);
            let texels = 0..self.directions.as_slice().len();
            let differing = texels.filter(|&i| exact.get(i) != visible.get(i)).count();
            counters.verified.fetch_add(1, Ordering::Relaxed);
            counters
                .differing
                .fetch_add(differing as u64, Ordering::Relaxed);
            add_time(&counters.verify_nanoseconds, start);
        }
        counters.rays.fetch_add(u64::from(rays), Ordering::Relaxed);
        self.report()
    }

    /// Sampling and compressing a vertex count alike: once the first chunks are through,
    /// both go on side by side, and any weights tell the time left.
    fn report(&self) -> Result<(), Interrupted> {
        let total = 2 * load(&self.counters.total);
        if total == 0 {
            return self.monitor.step("budget", 0.0);
        }
        let done = load(&self.counters.sampled) + load(&self.counters.compressed);
        let fraction = done as f64 / total as f64;
        self.monitor
            .step("visibility and compression", fraction.min(0.999) as f32)
    }

    /// Divides a chunk into clusters and compresses them.
    fn compress_clusters(
        &self,
        triangles: &[u32],
        vertices: &[u32],
        samples: &Samples,
        probes: &[Probe],
        aim: f32,
    ) -> Result<Vec<Cluster>, Interrupted> {
        let mut plan = Vec::new();
        let tiles = self.options.max_tiles;
        self.plan(
            triangles,
            vertices,
            &samples.thinned(),
            (aim, tiles),
            &mut plan,
        )?;
        let compress = |planned| {
            let Planned {
                triangles,
                coefficients,
            } = planned;
            self.report()?;
            let members = cluster::vertices_of(&triangles, &self.triangles);
            let samples = samples.select(&columns(&members, vertices));
            let fitted = samples.fitted();
            let (images, _) = compress::alternate(&fitted, coefficients, ROUNDS);
            let compressed = compress::encode(&fitted, &images, aim);
            Ok(self.cluster((&triangles, &members, &samples), probes, compressed))
        };
        plan.into_iter().map(compress).collect()
    }

    /// Tiles, and splits along the leading principal component, where vertices that see
    /// alike stay together, as long as they lower the sum of bytes and of what errors are
    /// worth in bytes. Returns that sum. `tiles` is where the search begins.
    fn plan(
        &self,
        triangles: &[u32],
        vertices: &[u32],
        samples: &Samples,
        (aim, tiles): (f32, u32),
        plan: &mut Vec<Planned>,
    ) -> Result<f32, Interrupted> {
        self.report()?;
        let max_channels = self.options.max_tiles as usize * CHANNELS_PER_TILE;
        let basis = compress::analyse(samples, max_channels - 1);
        let fitted = samples.fitted();
        let count = vertices.len() as f32;
        let texels = self.options.basis_resolution.pow(2) as f32;
        let tile_bytes =
            CHANNELS_PER_TILE as f32 * (texels * BASIS_BYTES + count * COEFFICIENT_BYTES);
        let with_tiles = |tiles: u32| {
            let channels = tiles as usize * CHANNELS_PER_TILE;
            let (images, coefficients) =
                compress::reweight(&fitted, &basis, channels, PLANNING_ROUNDS);
            let compressed = compress::encode(&fitted, &images, aim);
            let error = compressed.error() / aim;
            Tried {
                tiles: compressed.tiles,
                bytes: compressed.tiles as f32 * tile_bytes,
                worth: count * BYTES_PER_ERROR * error * error,
                coefficients,
            }
        };
        let most = (basis.images.values.ncols().div_ceil(CHANNELS_PER_TILE) as u32).max(1);
        let whole = cheapest(tiles.min(most), most, with_tiles);
        let cost = whole.cost();
        let begun = plan.len();
        plan.push(Planned {
            triangles: triangles.to_vec(),
            coefficients: whole.coefficients,
        });
        let split_bytes = whole.tiles as f32 * texels * 4.0 * BASIS_BYTES;
        let hopeless = SPLIT_GAIN * whole.worth < split_bytes;
        if hopeless || vertices.len() < MIN_CLUSTER_VERTICES || triangles.len() < 2 {
            return Ok(cost);
        }
        let position = |triangle: u32| -> f32 {
            columns(&self.triangles[triangle as usize], vertices)
                .into_iter()
                .map(|column| basis.projections[(0, column)])
                .sum()
        };
        let mut keyed: Vec<(f32, u32)> = triangles.iter().map(|&t| (position(t), t)).collect();
        keyed.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        let (low, high) = keyed.split_at(keyed.len() / 2);
        drop((fitted, basis));
        let mut split_cost = 0.0;
        for half in [low, high] {
            let mut group: Vec<u32> = half.iter().map(|&(_, triangle)| triangle).collect();
            group.sort_unstable();
            let members = cluster::vertices_of(&group, &self.triangles);
            let subset = samples.select(&columns(&members, vertices));
            split_cost += self.plan(&group, &members, &subset, (aim, whole.tiles), plan)?;
        }
        if split_cost < cost {
            plan.remove(begun);
            return Ok(split_cost);
        }
        plan.truncate(begun + 1);
        Ok(cost)
    }

    /// Copies what a cluster needs of the mesh and measures how far it is off. Triangles and
    /// vertices, with their samples, ascend.
    fn cluster(
        &self,
        (triangles, vertices, samples): (&[u32], &[u32], &Samples),
        probes: &[Probe],
        compressed: Compressed,
    ) -> Cluster {
        let stored = |column: usize| compressed.decode(column);
        let exact = |column: usize| samples.ssdf(column).to_vec();
        let mut errors = ErrorSums::at_vertices(&compressed, vertices.len());
        for probe in probes {
            if triangles.binary_search(&probe.triangle).is_ok() {
                let columns = columns(&probe.vertices, vertices);
                errors.add_probe(probe, &columns, &stored, &exact, &self.weighting);
            }
        }
        let local = |vertex: u32| vertices.partition_point(|&other| other < vertex) as u32;
        let triangle = |&index: &u32| {
            let source = &self.mesh.triangles[index as usize];
            format::Triangle {
                vertices: source.vertices.map(local),
                material: source.material,
                cluster: 0,
            }
        };
        let triangles: Vec<_> = triangles.iter().map(triangle).collect();
        let (triangles, order) = layout::walk(&triangles, vertices.len());
        let vertex = |&column: &usize| {
            let vertex = self.mesh.vertices[vertices[column] as usize];
            layout::rounded(vertex.into())
        };
        Cluster {
            vertices: order.iter().map(vertex).collect(),
            triangles,
            compressed: compressed.reordered(&order),
            errors,
        }
    }
}

/// A cluster to be.
struct Planned {
    triangles: Vec<u32>,
    /// As they were fitted to thinned samples.
    coefficients: DMatrix<f32>,
}

/// What a number of tiles would cost.
struct Tried {
    tiles: u32,
    bytes: f32,
    /// Of the error that is left, in bytes.
    worth: f32,
    coefficients: DMatrix<f32>,
}

impl Tried {
    fn cost(&self) -> f32 {
        self.bytes + self.worth
    }
}

/// The number of tiles in `1..=most` at which costs stop falling, on the way from `start`;
/// each costs a fit. Costs rise on both sides of the least, but for noise.
fn cheapest(start: u32, most: u32, with_tiles: impl Fn(u32) -> Tried) -> Tried {
    let first = with_tiles(start);
    let walk = |tiles: &mut dyn Iterator<Item = u32>| {
        let mut best: Option<Tried> = None;
        for tiles in tiles {
            let next = with_tiles(tiles);
            if next.cost() >= best.as_ref().unwrap_or(&first).cost() {
                break;
            }
            best = Some(next);
        }
        best
    };
    let fewer = walk(&mut (1..start).rev());
    let best = fewer.or_else(|| walk(&mut (start + 1..=most)));
    best.unwrap_or(first)
}

/// Where `members` are among the ascending `vertices`.
fn columns(members: &[u32], vertices: &[u32]) -> Vec<usize> {
    let place = |vertex| vertices.binary_search(vertex).ok();
    members.iter().filter_map(place).collect()
}

fn add_time(counter: &AtomicU64, start: Instant) {
    counter.fetch_add(start.elapsed().as_nanos() as u64, Ordering::Relaxed);
}

/// Lays out the clusters of all chunks, in the chunks' order, behind what
/// [`Bake::finish`] gave.
///
/// # Errors
///
/// The first that `chunks` yields, or more clusters than the format can number.
pub fn assemble<E: From<Error>>(
    head: format::Scene,
    chunks: impl IntoIterator<Item = Result<Vec<Cluster>, E>>,
) -> Result<format::Scene, E> {
    let mut scene = head;
    let mut errors = ErrorSums::default();
    for chunk in chunks {
        for cluster in chunk? {
            errors.add(&cluster.errors);
            append(&mut scene, cluster)?;
        }
    }
    scene.report.errors = errors.errors();
    Ok(scene)
}

/// Lays out a cluster behind the others.
fn append(scene: &mut format::Scene, cluster: Cluster) -> Result<(), Error> {
    let number = u16::try_from(scene.clusters.len())
        .ok()
        .filter(|number| *number < u16::MAX)
        .ok_or_else(|| Error::Options {
            place: "max_error",
            expected: format!("at most {} clusters", u16::MAX),
            found: "more; allow a larger error or fewer vertices".into(),
        })?;
    let index = |count: usize| {
        u32::try_from(count).map_err(|_| Error::Options {
            place: "max_vertices",
            expected: format!("at most {} vertices and coefficients", u32::MAX),
            found: "more; allow a larger error or fewer vertices".into(),
        })
    };
    let first_vertex = index(scene.vertices.len())?;
    // That indices within the cluster do not overflow either.
    index(scene.vertices.len() + cluster.vertices.len())?;
    let compressed = cluster.compressed;
    let last = scene.clusters.last();
    scene.clusters.push(format::Cluster {
        first_vertex,
        vertex_count: cluster.vertices.len() as u32,
        first_coefficient: index(scene.coefficients.len())?,
        first_tile: last.map_or(0, |last| last.first_tile + last.tiles),
        tiles: compressed.tiles,
        coefficient_scale: compressed.coefficient_scale,
    });
    scene.coefficients.extend(compressed.coefficients);
    scene.basis.extend(compressed.basis);
    scene.vertices.extend(cluster.vertices);
    let triangles = cluster.triangles.iter().map(|triangle| format::Triangle {
        vertices: triangle.vertices.map(|vertex| first_vertex + vertex),
        cluster: number,
        ..*triangle
    });
    scene.triangles.extend(triangles);
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scattering_keeps_every_chunk_and_spreads_the_first_ones() {
        for count in [0, 1, 2, 3, 10, 97, 100, 1024] {
            let chunks: Vec<usize> = (0..count).map(|i| 3 * i + 1).collect();
            let mut order = scattered(&chunks);
            assert_eq!(order.len(), count);
            if count >= 100 {
                let first = &order[..count / 10];
                let low = first.iter().filter(|&&chunk| chunk < 3 * count / 2).count();
                assert!(
                    (count / 20 - 1..=count / 20 + 1).contains(&low),
                    "{low} of {count}"
                );
            }
            order.sort_unstable();
            assert_eq!(order, chunks);
        }
    }
}
