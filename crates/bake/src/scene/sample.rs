//! Points of a scene -> what is seen from them.

use std::sync::OnceLock;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Instant;

use glam::Vec3;
use nalgebra::DMatrix;
use rayon::prelude::*;

use super::bounce::mirrors;
use super::kept::Kept;
use super::options::Options;
use super::statistics::{Counters, add_time, load};
use crate::compress::{Normal, Samples, Weighting, column};
use crate::memory;
use crate::mesh::size::SizeFunction;
use crate::mesh::{Mesh, cluster};
use crate::monitor::{Interrupted, Monitor};
use crate::simd::add_scaled;
use crate::ssdf::{Sampled, Sampler};
use crate::transfer::gather::Gathered;
use crate::transfer::radiosity::Radiosity;
use crate::visibility::clutter::Drafted;
use crate::visibility::contour::ContourMesh;
use crate::visibility::places::{Divided, Finding};
use crate::visibility::sparse::Sparse;
use crate::visibility::{self, Directions};

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
    /// Of every place, what its errors count for.
    counts: Vec<f32>,
    /// Which of them are sampled, and at which light is gathered.
    sparse: Sparse,
    sparse_light: Sparse,
    /// How many samples small pieces share, and in place of how many, if they do.
    shared: Option<[usize; 2]>,
    /// Whether samples are made by a ray in every direction.
    by_rays: bool,
    ray_offset: f32,
    sizes: SizeFunction,
}

/// Distance of places, in sizes of what is there, below which their errors count by their surface: about that of scans of
/// a hundred thousand triangles.
const EVEN_SPACING: f32 = 0.004;
/// Least that errors at a place count for: a small thing in a large scene may be looked at closely.
const LEAST_COUNT: f32 = 0.2;
/// Area of a vertex of an even mesh, in squares of its edges.
const EVEN_AREA: f32 = 0.866;

impl Placed {
    /// Where a triangle's first corner is sampled.
    pub(super) fn origin(&self, triangle: usize) -> Vec3 {
        self.origins[self.triangles[triangle][0] as usize]
    }

    /// Copies vertices that see different things from different sides. Distances of samples are in sizes of what
    /// is there.
    pub(super) fn new(
        mesh: &mut Mesh,
        contours: &ContourMesh,
        ray_offset: f32,
        sizes: SizeFunction,
        options: &Options,
    ) -> Self {
        let spacing = options.sample_spacing;
        let triangles = mesh.indices();
        let positions = mesh.positions();
        let mut found = Finding::new(
            &positions,
            &triangles,
            contours.caster(),
            ray_offset,
            options.exposure_resolution,
        );
        let (drafted, places) = if spacing > 0.0 {
            let directions = Directions::new(options.sample_resolution);
            let distance = |point: Vec3| spacing * sizes.at(point);
            Drafted::new(found, distance, contours, &directions)
        } else {
            found.emerge(|_| true, true);
            let places = found.into_places();
            let all = || Sparse::all(places.origins.len());
            let drafted = Drafted {
                seen: all(),
                light: all(),
                shared: None,
                by_rays: false,
            };
            (drafted, places)
        };
        let sizes_at: Vec<f32> = (places.origins.par_iter())
            .map(|&origin| sizes.at(origin))
            .collect();
        let divided = Divided::new(&triangles, mesh.vertices.len(), &places.corners);
        for (triangle, vertices) in mesh.triangles.iter_mut().zip(divided.triangles) {
            triangle.vertices = vertices;
        }
        for vertex in divided.copied {
            mesh.vertices.push(mesh.vertices[vertex as usize]);
        }
        Self {
            counts: counts(&places.origins, &places.corners, |place| {
                EVEN_SPACING * sizes_at[place as usize]
            }),
            origins: places.origins,
            places: divided.places,
            triangles: places.corners,
            sparse: drafted.seen,
            sparse_light: drafted.light,
            shared: drafted.shared,
            by_rays: drafted.by_rays,
            ray_offset,
            sizes,
        }
    }

    /// That small pieces share samples.
    pub(super) fn warning(&self) -> Option<String> {
        let [few, all] = self.shared?;
        Some(format!(
            "so many small pieces, such as leaves, that a draft samples {few} of {all} points: pieces beside each other \
             that face the same way have the same light and shadow; other presets sample each"
        ))
    }
}

/// Of every place, what its errors count for beside those of one at the ordinary distance from others, its `spacing`:
/// where places lie closer together, they count by their surface.
fn counts(origins: &[Vec3], triangles: &[[u32; 3]], spacing: impl Fn(u32) -> f32) -> Vec<f32> {
    let mut counts = vec![0.0; origins.len()];
    for triangle in triangles {
        let [a, b, c] = triangle.map(|place| origins[place as usize]);
        let area = 0.5 * (b - a).cross(c - a).length();
        for &place in triangle {
            let spacing = spacing(place);
            let ordinary = EVEN_AREA * spacing * spacing;
            counts[place as usize] += area / (3.0 * ordinary);
        }
    }
    for count in &mut counts {
        *count = count.clamp(LEAST_COUNT, 1.0);
    }
    counts
}

/// Places, and where what is seen from them is known.
pub(super) struct Seen {
    /// Ascending.
    pub(super) places: Vec<u32>,
    /// What stands for them, ascending: themselves where all are sampled.
    pub(super) sources: Vec<u32>,
}

/// Of a place that no triangle is seen to use.
const NO_NORMAL: Normal = Normal {
    direction: Vec3::ZERO,
    tilt: 0.0,
};

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
    /// Vertices of the mesh, by their places.
    by_place: Vec<u32>,
    /// The places of every triangle's corners.
    pub(super) triangles: Vec<[u32; 3]>,
    /// Of every place, what its errors count for.
    pub(super) counts: Vec<f32>,
    /// Which places are sampled, and at which light is gathered.
    pub(super) sparse: Sparse,
    pub(super) sparse_light: Sparse,
    /// What is seen from those that are sampled.
    pub(super) kept: Kept,
    /// Triangles that are sampled and compressed together.
    pub(super) chunks: Vec<Vec<u32>>,
    /// Whether several chunks have a place.
    pub(super) shared: Vec<bool>,
    /// Where visibility is sampled, one point per place.
    pub(super) origins: Vec<Vec3>,
    pub(super) contours: ContourMesh,
    /// Distance of samples from the surface, metres.
    pub(super) ray_offset: f32,
    pub(super) sizes: SizeFunction,
    /// Where light is not gathered at every vertex, what is gathered at those that stand for others: irradiance, and
    /// with radiance.
    pub(super) gathered: [Vec<OnceLock<Gathered>>; 2],
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

impl Drop for Prepared<'_> {
    fn drop(&mut self) {
        memory::forget();
    }
}

/// Whether several chunks have each place.
fn shared(placed: &Placed, chunks: &[Vec<u32>]) -> Vec<bool> {
    let mut first = vec![usize::MAX; placed.origins.len()];
    let mut shared = vec![false; placed.origins.len()];
    for (chunk, triangles) in chunks.iter().enumerate() {
        for &place in triangles
            .iter()
            .flat_map(|&triangle| &placed.triangles[triangle as usize])
        {
            let place = place as usize;
            shared[place] |= first[place] != usize::MAX && first[place] != chunk;
            first[place] = chunk;
        }
    }
    shared
}

impl<'a> Prepared<'a> {
    pub(super) fn new(
        mesh: Mesh,
        placed: Placed,
        chunks: Vec<Vec<u32>>,
        (contours, radiosity): (ContourMesh, Option<Radiosity>),
        options: &Options,
        monitor: Monitor<'a>,
    ) -> Self {
        let tilt = |material: &relight_format::Material| match material.normal_texture {
            Some(_) => NORMAL_MAP_TILT,
            None => 0.0,
        };
        let lit_by_lamps = radiosity.as_ref().is_some_and(Radiosity::lit_by_lamps);
        let materials = mesh.materials.iter();
        let mirrors = materials
            .map(|material| mirrors(material, lit_by_lamps))
            .collect();
        let tilts = mesh.materials.iter().map(tilt).collect();
        let mut by_place: Vec<u32> = (0..placed.places.len() as u32).collect();
        by_place.sort_by_key(|&vertex| placed.places[vertex as usize]);
        let texels = (options.basis_resolution as usize).pow(2);
        let weighting = if placed.sparse.is_all() {
            Weighting::new(options.basis_resolution)
        } else {
            Weighting::with_between(options.basis_resolution)
        };
        let gathered = if options.sample_spacing > 0.0 {
            by_place.len()
        } else {
            0
        };
        Self {
            shared: shared(&placed, &chunks),
            kept: Kept::new(&placed.sparse, &placed.origins, texels, placed.by_rays),
            counts: placed.counts,
            options: options.clone(),
            monitor,
            tilts,
            gathered: [(); 2].map(|()| (0..gathered).map(|_| OnceLock::new()).collect()),
            origins: placed.origins,
            places: placed.places,
            by_place,
            triangles: placed.triangles,
            sparse: placed.sparse,
            sparse_light: placed.sparse_light,
            ray_offset: placed.ray_offset,
            sizes: placed.sizes,
            mesh,
            chunks,
            contours,
            radiosity,
            mirrors,
            sampler: Sampler::new(
                options.sample_resolution,
                options.basis_resolution,
                options.distance_clamp,
            )
            .by_rays(placed.by_rays),
            weighting,
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

    /// Vertices of the mesh at a place.
    pub(super) fn vertices_at(&self, place: u32) -> &[u32] {
        let first = self
            .by_place
            .partition_point(|&vertex| self.places[vertex as usize] < place);
        let end = self
            .by_place
            .partition_point(|&vertex| self.places[vertex as usize] <= place);
        &self.by_place[first..end]
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

    /// The places that some triangles use, and what is seen from them.
    pub(super) fn seen(&self, triangles: &[u32]) -> Result<(Seen, DMatrix<f32>), Interrupted> {
        let places = self.vertices_of(triangles);
        let seen = Seen {
            sources: self.sparse.sources_of(places.iter().copied()),
            places,
        };
        let ssdfs = self.ssdfs(&seen)?;
        Ok((seen, ssdfs))
    }

    /// SSDFs from places that `triangles` use, with their weights.
    pub(super) fn weighed(&self, triangles: &[u32], seen: &Seen, ssdfs: DMatrix<f32>) -> Samples {
        let normals = self.normals(triangles, &seen.places);
        let normals = self.normals_of_sources(seen, &normals);
        Samples::new(ssdfs, &normals, &self.weighting)
    }

    /// Normals of what stands for places: their own, or those of what they stand for among these.
    fn normals_of_sources(&self, seen: &Seen, of_places: &[Normal]) -> Vec<Normal> {
        let own = |source: &u32| seen.places.binary_search(source).ok();
        let mut normals: Vec<Normal> = (seen.sources.iter())
            .map(|source| own(source).map_or(NO_NORMAL, |index| of_places[index]))
            .collect();
        for (&place, normal) in seen.places.iter().zip(of_places) {
            for (source, _) in self.sparse.sources(place) {
                if own(source).is_none() {
                    let sum = &mut normals[seen.sources.partition_point(|other| other < source)];
                    sum.direction += normal.direction;
                    sum.tilt = sum.tilt.max(normal.tilt);
                }
            }
        }
        for (source, normal) in seen.sources.iter().zip(&mut normals) {
            if own(source).is_none() {
                normal.direction = normal.direction.normalize_or_zero();
            }
        }
        normals
    }

    /// Shading normals at `places`, which `triangles` use: their mean, and how far others of
    /// the same place, and normal maps, turn away from it.
    fn normals(&self, triangles: &[u32], places: &[u32]) -> Vec<Normal> {
        let mut normals = vec![NO_NORMAL; places.len()];
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

    /// Clamped SSDFs at the basis resolution: one column per source.
    fn ssdfs(&self, Seen { places, sources }: &Seen) -> Result<DMatrix<f32>, Interrupted> {
        let texels = (self.options.basis_resolution as usize).pow(2);
        let ssdfs = memory::used(texels * sources.len());
        let mut ssdfs = DMatrix::from_vec(texels, sources.len(), ssdfs);
        let columns = ssdfs.as_mut_slice().chunks_exact_mut(texels);
        if !self.kept.is_empty() {
            self.sample_kept(sources)?;
            (self.counters.known).fetch_add(places.len() as u64, Ordering::Relaxed);
            for (column, &source) in columns.zip(sources) {
                let ssdf = self.kept.ssdf(source);
                column.copy_from_slice(ssdf.expect("it was sampled just now"));
            }
            return Ok(ssdfs);
        }
        let origins = sources.iter().map(|&place| self.origins[place as usize]);
        let done = AtomicUsize::new(0);
        self.sample(origins.zip(columns).collect(), |column, sampled| {
            column.copy_from_slice(&sampled.distances);
            self.counters.sampled.fetch_add(1, Ordering::Relaxed);
            // Those that it stands for are known with it, for the progress.
            let done = done.fetch_add(1, Ordering::Relaxed);
            let known =
                (done + 1) * places.len() / sources.len() - done * places.len() / sources.len();
            (self.counters.known).fetch_add(known as u64, Ordering::Relaxed);
        })?;
        Ok(ssdfs)
    }

    /// SSDFs of some places, by those of sources: one column per place.
    pub(super) fn interpolated(
        &self,
        places: &[u32],
        sources: &[u32],
        ssdfs: &DMatrix<f32>,
    ) -> DMatrix<f32> {
        let texels = ssdfs.nrows();
        let mut interpolated = DMatrix::zeros(texels, places.len());
        let columns = interpolated.as_mut_slice().chunks_exact_mut(texels);
        for (out, &place) in columns.zip(places) {
            for (source, weight) in self.sparse.sources(place) {
                let index = sources.partition_point(|other| other < source);
                add_scaled(out, column(ssdfs, index), *weight);
            }
        }
        interpolated
    }

    /// Samples points and hands over, for each, what is seen from there.
    pub(super) fn sample<T: Send>(
        &self,
        points: Vec<(Vec3, T)>,
        hand_over: impl Fn(&mut T, Sampled) + Sync,
    ) -> Result<(), Interrupted> {
        self.sampler
            .sample(&self.contours, points, |for_whom, sampled| {
                self.verify(&sampled);
                hand_over(for_whom, sampled);
                self.report()
            })
    }

    /// Counts the texels in which one ray each finds something else, if that is asked for.
    pub(super) fn verify(
        &self,
        &Sampled {
            origin, visible, ..
        }: &Sampled,
    ) {
        if !self.verify {
            return;
        }
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
        let done = load(&self.counters.known) + load(&self.counters.compressed);
        let fraction = done as f64 / total as f64;
        self.monitor
            .step("visibility and compression", fraction.min(0.999) as f32)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::cluster::tests::grid;

    /// However fine a mesh is, its errors count as much as those of one as coarse as counts one each.
    #[test]
    fn places_close_together_count_by_their_surface() {
        let sum = |n: u32, spacing: f32| -> (f32, usize) {
            let (mut origins, triangles) = grid(n, |_, _| 0.0);
            for origin in &mut origins {
                *origin *= 12.0 / n as f32;
            }
            let counts = counts(&origins, &triangles, |_| spacing);
            assert!(counts.iter().all(|count| (0.0..=1.0).contains(count)));
            (counts.iter().sum(), counts.len())
        };
        let whole = 144.0 / (EVEN_AREA * 0.25);
        for n in [30, 36] {
            let (counted, places) = sum(n, 0.5);
            assert!(
                (counted / whole - 1.0).abs() < 0.01,
                "{counted} of {places}"
            );
        }
        // However close together they are, something is left of each.
        let (counted, places) = sum(96, 0.5);
        let least = LEAST_COUNT * places as f32;
        assert!((counted / least - 1.0).abs() < 1e-4, "{counted} of {least}");
        // Where they are further apart, each counts one, but for two corners of one triangle each.
        let (counted, places) = sum(12, 0.5);
        assert!(counted > places as f32 - 1.0, "{counted} of {places}");
    }
}
