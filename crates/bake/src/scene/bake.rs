//! The stages of a scene bake in order: refinement, chunks, sampling, compression.

use std::sync::atomic::Ordering;
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use relight_format as format;
use relight_format::Representation;

use super::assemble::{Cluster, assemble};
use super::budget;
use super::darkness;
use super::error::Error;
use super::fingerprint::Dependencies;
use super::highlights;
use super::load::SceneInput;
use super::options::{Options, ROOM_VERTICES};
use super::overlaps;
use super::queue::Queue;
use super::sample::{CHUNK_VERTICES, Placed, Prepared};
use super::statistics::{Statistics, add_time, load};
use crate::clock::ProcessorClock;
use crate::mesh::refine::{self, Cuts};
use crate::mesh::size::SizeFunction;
use crate::mesh::{Mesh, cluster};
use crate::monitor::{Interrupted, Monitor};
use crate::transfer::radiosity::Radiosity;
use crate::transfer::surfaces::Surfaces;
use crate::visibility::contour::ContourMesh;
use crate::visibility::ray::{self, RayCaster};

/// Edges up to this part of what they belong to or stand beside are not cut for their error:
/// shadows of contacts have no finest scale.
const RELATIVE_MIN_EDGE: f32 = 0.004;
/// The part of the same that errors of edges are told for.
const RELATIVE_EDGE: f32 = 0.02;
/// Distance of a visibility sample from its surface, as a part of the size of things: far above
/// the rounding of coordinates, far below anything that casts a visible shadow.
const RELATIVE_RAY_OFFSET: f32 = 1e-5;
/// Small scenes are checked in one triangle of so many.
const LEAST_PROBE_STEP: usize = 4;

/// A scene ready to be sampled: refined, divided into chunks that can be baked in any
/// order, apart from each other and on different machines.
pub struct Bake<'a> {
    prepared: Prepared<'a>,
    /// What is known of the asset before sampling.
    head: format::Scene,
    /// Its texels, compressed.
    texels: format::StoredTexels,
    /// The error that clusters aim at, radians; what it is worth in bytes is the same for
    /// all.
    aim: f32,
    fingerprint: u128,
    description: String,
    stages: Vec<(&'static str, Duration)>,
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
    let (head, _, statistics) = bake.finish();
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
        options.check()?;
        let mut stages = Vec::new();
        let clock = ProcessorClock::start();
        monitor.step("build bvh", 0.0)?;
        // Refinement does not move the surface: what was imported blocks the same light with
        // the fewest edges.
        let soup = input.mesh.soup();
        let sizes = SizeFunction::new(&input.mesh.positions(), input.object_diagonal);
        let (ray_offset, far_off) = ray_offset(&input.mesh, &sizes);
        let light = || {
            let contours = ContourMesh::new(&soup);
            drop(soup);
            stages.push(("build bvh and textures", clock.elapsed()));
            let mesh = &input.mesh;
            let scale = (&sizes, ray_offset);
            bounces(
                mesh,
                contours.caster(),
                options,
                scale,
                monitor,
                &mut stages,
            )
            .map(|found| (contours, found))
        };
        // Texels are work for one thread, beside what is so in part. What is left of it counts with bounces.
        let beside = || {
            let texels = format::StoredTexels::new(&input.mesh.textures);
            (texels, Dependencies::new(&input, options))
        };
        let (light, (texels, dependencies)) = rayon::join(light, beside);
        let (contours, (radiosity, reflections)) = light?;
        let texels = texels?;

        let clock = ProcessorClock::start();
        monitor.step("refine", 0.0)?;
        let mut report = format::BakeReport {
            source_vertices: input.mesh.vertices.len() as u64,
            source_triangles: input.mesh.triangles.len() as u64,
            ..Default::default()
        };
        let diagonal = input.object_diagonal;
        let (name, camera) = (input.name.clone(), input.camera);
        let mut warnings = input.warnings.clone();
        warnings.extend(far_off.into_iter().chain(highlights::warnings(&input.mesh)));
        warnings.extend(overlaps::warning(&input.mesh, contours.caster()));
        warnings.extend(reflections);
        let scale = (&sizes, ray_offset);
        let (mut mesh, ref options) = refined(input, options, &contours, scale, monitor)?;
        for warning in mesh.warnings.drain(..) {
            if !warnings.contains(&warning) {
                warnings.push(warning);
            }
        }
        report.warnings = warnings;
        let mut head = format::Scene {
            name,
            camera,
            report,
            ..head(&mut mesh, options, ray_offset, radiosity.as_ref())
        };
        let placed = Placed::new(&mut mesh, &contours, ray_offset, sizes, options);
        head.report.warnings.extend(placed.warning());
        head.report.warnings.extend(darkness::warning(
            &mesh,
            &|index| placed.origin(index),
            contours.caster(),
            diagonal,
        ));
        let chunks = chunks(&placed, options.representation);
        stages.push(("refine", clock.elapsed()));

        let mut bake = Self {
            prepared: Prepared::new(
                mesh,
                placed,
                chunks,
                (contours, radiosity),
                options,
                monitor,
            ),
            head,
            texels,
            aim: options.aim,
            fingerprint: dependencies.fingerprint(),
            description: dependencies.description(),
            stages,
        };
        let asked = options.max_error.is_some() || options.max_bytes.is_some();
        if options.representation == Representation::ClusteredPca {
            let clock = ProcessorClock::start();
            if asked {
                let chosen = budget::choose_aim(&bake.prepared, &bake.head)?;
                bake.aim = chosen.aim;
                bake.head.report.warnings.extend(chosen.warning);
            } else {
                bake.aim = budget::default_aim(&bake.prepared)?;
            }
            bake.prepared.reset();
            bake.stages.push(("budget", clock.elapsed()));
        }
        Ok(bake)
    }

    /// Also casts one ray per texel at every vertex; a difference fails the bake.
    pub fn verify_visibility(&mut self) {
        self.prepared.verify = true;
        // What the choice of an aim sampled was not compared.
        self.prepared.kept.forget();
    }

    /// The error that clusters aim at, radians.
    #[cfg(test)]
    pub(super) fn aim(&self) -> f32 {
        self.aim
    }

    /// Chunks in all, numbered from 0.
    pub fn chunk_count(&self) -> usize {
        self.prepared.chunks.len()
    }

    /// Vertices of the refined mesh; chunks share some.
    pub fn vertex_count(&self) -> usize {
        self.prepared.mesh.vertices.len()
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
        let prepared = &self.prepared;
        let counters = &prepared.counters;
        let total = prepared.vertices_of_chunks(chunks);
        counters.total.store(total, Ordering::Relaxed);
        Queue::new(chunks).run(prepared.chunks_at_hand(), |chunk| {
            hand_over(chunk, self.bake_chunk(&prepared.chunks[chunk])?)
        })?;
        let (vertices, texels) = (load(&counters.verified), load(&counters.differing));
        if texels > 0 {
            return Err(Error::Visibility { vertices, texels }.into());
        }
        Ok(())
    }

    fn bake_chunk(&self, triangles: &[u32]) -> Result<Vec<Cluster>, Error> {
        let prepared = &self.prepared;
        let (seen, ssdfs) = prepared.seen(triangles)?;
        let start = Instant::now();
        let samples = prepared.weighed(triangles, &seen, ssdfs);
        add_time(&prepared.counters.compress_nanoseconds, start);
        let every = (prepared.triangles.len() / prepared.options.probes).max(LEAST_PROBE_STEP);
        let probes = prepared.probes(triangles, every as u32)?;
        let count = seen.places.len() as u64;
        let bounced = prepared.bounced(triangles, &seen.sources, samples.ssdfs())?;
        let bounced = bounced.as_ref();
        let start = Instant::now();
        let part = (triangles, &seen, &samples);
        let mut finished = if prepared.options.representation == Representation::GlobalPca {
            vec![prepared.whole(part, &probes, bounced, self.aim)]
        } else {
            prepared.compress(part, &probes, bounced, self.aim)?
        };
        if let Some(bounced) = bounced {
            bounced.open_group(&mut finished);
        }
        add_time(&prepared.counters.compress_nanoseconds, start);
        (prepared.counters.compressed).fetch_add(count, Ordering::Relaxed);
        prepared.report()?;
        Ok(finished)
    }

    /// The asset without its clusters, its texels as its file has them, and what was done.
    pub fn finish(self) -> (format::Scene, format::StoredTexels, Statistics) {
        let Prepared {
            counters,
            sampler,
            verify,
            ..
        } = &self.prepared;
        let mut stages = self.stages;
        let mut rays = sampler.rays();
        let [visibility, ssdf] = sampler.times();
        let counted = |counter| Duration::from_nanos(load(counter));
        stages.extend([
            ("visibility", visibility),
            ("ssdf", ssdf),
            ("compress", counted(&counters.compress_nanoseconds)),
        ]);
        if let Some(radiosity) = &self.prepared.radiosity {
            let time = counted(&counters.bounce_nanoseconds);
            stages.push(("bounces at vertices", time));
            rays += radiosity.rays() + load(&counters.bounce_rays);
        }
        if *verify {
            stages.push(("verify", counted(&counters.verify_nanoseconds)));
        }
        let statistics = Statistics {
            stages,
            rays,
            sampled_vertices: load(&counters.sampled) + self.prepared.kept.sampled() as u64,
            probes: load(&counters.probes),
            verified_points: load(&counters.verified),
            differing_texels: load(&counters.differing),
        };
        (self.head, self.texels, statistics)
    }
}

/// An asset of a mesh whose textures it takes, without a name and without clusters.
fn head(
    mesh: &mut Mesh,
    options: &Options,
    ray_offset: f32,
    radiosity: Option<&Radiosity>,
) -> format::Scene {
    format::Scene {
        name: String::new(),
        visibility: format::VisibilityParameters {
            representation: options.representation,
            sample_resolution: options.sample_resolution,
            basis_resolution: options.basis_resolution,
            distance_clamp: options.distance_clamp,
            ray_offset,
        },
        camera: None,
        materials: mesh.materials.clone(),
        textures: std::mem::take(&mut mesh.textures),
        report: format::BakeReport::default(),
        vertices: Vec::new(),
        second_uvs: Vec::new(),
        triangles: Vec::new(),
        clusters: Vec::new(),
        coefficients: Vec::new(),
        basis: Vec::new(),
        transfer: radiosity.map(|all| all.head(options.transfer.order)),
    }
}

/// Light after its bounces, if it is to bounce, and warnings of what reflections lack of it.
fn bounces(
    mesh: &Mesh,
    caster: &RayCaster,
    options: &Options,
    scale: (&SizeFunction, f32),
    monitor: Monitor,
    stages: &mut Vec<(&'static str, Duration)>,
) -> Result<(Option<Radiosity>, Vec<String>), Interrupted> {
    monitor.step("bounces", 0.0)?;
    let clock = ProcessorClock::start();
    let surfaces = Surfaces::new(mesh);
    let Some(radiosity) = Radiosity::new(surfaces, caster, &options.transfer, scale, monitor)?
    else {
        return Ok((None, Vec::new()));
    };
    stages.push(("bounces", clock.elapsed()));
    let clock = ProcessorClock::start();
    let error = |material| radiosity.reflection_error(caster, material, monitor);
    let warnings = highlights::of_surfaces(mesh, radiosity.lit_by_lamps(), error)?;
    stages.push(("reflections", clock.elapsed()));
    Ok((Some(radiosity), warnings))
}

/// Distance of samples from their surface, metres, and a warning if coordinates are so large that
/// their rounding, not the size of the scene, tells it.
fn ray_offset(mesh: &Mesh, sizes: &SizeFunction) -> (f32, Option<String>) {
    let (low, high) = mesh.bounds().unwrap_or_default();
    let diagonal = mesh.diagonal();
    let offset = ray::ray_offset([low, high], RELATIVE_RAY_OFFSET * sizes.least_part());
    if offset <= RELATIVE_RAY_OFFSET * diagonal {
        return (offset, None);
    }
    let largest = low.abs().max(high.abs()).max_element();
    let warning = format!(
        "coordinates of up to {largest} m round to {} m, which blurs a scene of {} m; move it to \
         the origin in the program that made it",
        largest * f32::EPSILON,
        mesh.diagonal()
    );
    (offset, Some(warning))
}

/// Triangles that are sampled together.
fn chunks(placed: &Placed, representation: Representation) -> Vec<Vec<u32>> {
    match representation {
        Representation::ClusteredPca => {
            cluster::partition(&placed.origins, &placed.triangles, CHUNK_VERTICES)
        }
        Representation::GlobalPca => vec![(0..placed.triangles.len() as u32).collect()],
    }
}

/// The mesh, fine enough to carry shadows, and the options for it: rooms may have others.
fn refined(
    input: SceneInput,
    options: &Options,
    contours: &ContourMesh,
    (sizes, ray_offset): (&SizeFunction, f32),
    monitor: Monitor,
) -> Result<(Mesh, Options), Error> {
    let (max_edge, bound) = refinement(&input, options, sizes, ray_offset);
    let by_error = bound.error.is_finite();
    // Of the vertices that may be added, half are kept for where shadows fall.
    let even_vertices = if by_error {
        usize::midpoint(input.mesh.vertices.len(), bound.max_vertices)
    } else {
        bound.max_vertices
    };
    let diagonal = input.object_diagonal;
    let length = |edge: f32| move |a, b| sizes.length(a, b, edge) / edge;
    let mut mesh = refine::refine(input.mesh, length(max_edge), even_vertices);
    let rooms = darkness::has_rooms(&mesh, ray_offset, contours.caster(), diagonal);
    let options = if rooms && options.finer_rooms && mesh.vertices.len() < ROOM_VERTICES {
        options.for_rooms()
    } else {
        options.clone()
    };
    let least = options.least_vertices.min(bound.max_vertices);
    if mesh.vertices.len() < least {
        let warnings = mesh.warnings.len();
        mesh = refine::refine(mesh, length(0.25 * max_edge), least);
        // Where that stops is no loss.
        mesh.warnings.truncate(warnings);
    }
    let cuts = if by_error {
        Some(Cuts::All)
    } else {
        rooms.then_some(Cuts::BetweenRooms)
    };
    if let Some(cuts) = cuts {
        let scale = (sizes, ray_offset);
        mesh = refine::cut_where_pierced(mesh, contours.caster(), scale, bound.max_vertices, cuts);
    }
    if by_error {
        mesh = refine::refine_wrong(mesh, contours, bound, monitor)?;
    }
    Ok((mesh, options))
}

/// The longest edge as a part of the size of things, and the bounds on cuts by error: the scene
/// file's, else the options'.
fn refinement<'a>(
    input: &SceneInput,
    options: &Options,
    sizes: &'a SizeFunction,
    ray_offset: f32,
) -> (f32, refine::Bound<'a>) {
    let file = input.refinement.as_ref();
    let max_edge = file.and_then(|refinement| refinement.max_edge);
    let bound = refine::Bound {
        error: file
            .and_then(|refinement| refinement.error)
            .unwrap_or(options.refine_error),
        edge: RELATIVE_EDGE,
        min_edge: RELATIVE_MIN_EDGE,
        sizes,
        max_vertices: file
            .and_then(|refinement| refinement.max_vertices)
            .unwrap_or(options.max_vertices),
        ray_offset,
    };
    let of_whole = |metres: f32| metres / input.object_diagonal;
    (max_edge.map_or(options.max_edge, of_whole), bound)
}
