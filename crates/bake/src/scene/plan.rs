//! A chunk of triangles -> clusters, and what each is stored as: tiles and splits are tried as
//! long as they lower the sum of bytes and of what errors are worth in bytes.

use nalgebra::DMatrix;
use relight_format::CHANNELS_PER_TILE;
use relight_format::{self as format, math};

use super::assemble::Cluster;
use super::bounce::ChunkLight;
use super::layout;
use super::sample::{Prepared, Seen};
use super::surface::{ErrorSums, Probe};
use crate::compress::{self, Compressed, Fit, Fits, Samples, Stored};
use crate::monitor::Interrupted;
use crate::transfer::compress::ClusterTransfer;

/// What the error aimed at, squared, is worth in bytes per vertex; see `Prepared::counts`.
const BYTES_PER_ERROR: f32 = 17.5;
/// Bytes that a texel of a basis image and a coefficient take in a file, about.
const BASIS_BYTES: f32 = 0.19;
const COEFFICIENT_BYTES: f32 = 0.8;
/// Part of a cluster's squared error that a split is taken to take away at most.
const SPLIT_GAIN: f32 = 0.5;
/// Fewer tiles are tried only where what is left of the error is worth less than so many: the last of them takes away
/// at least as much as others would.
const FEWER_WORTH: f32 = 3.0;
/// A cluster of fewer vertices is not split further: its basis would outweigh it.
const MIN_CLUSTER_VERTICES: usize = 96;
/// Further rounds of fitting images and coefficients to each other once a cluster is planned: by some of the texels, as
/// only the coefficients are kept. Those that it was planned by would fit themselves better still, and the others worse.
const ROUNDS: usize = 1;
/// Part of the error aimed at that rounding adds.
const ROUNDING: f32 = 0.38;

impl Prepared<'_> {
    /// Divides a chunk into clusters and compresses them.
    pub(super) fn compress(
        &self,
        (triangles, seen, samples): (&[u32], &Seen, &Samples),
        probes: &[Probe],
        bounced: Option<&ChunkLight>,
        aim: f32,
    ) -> Result<Vec<Cluster>, Interrupted> {
        let mut plan = Vec::new();
        let tiles = self.options.max_tiles;
        let chunk = (&seen.sources[..], &samples.thinned());
        self.plan(triangles, chunk, (aim, tiles), &mut plan)?;
        let staggered = samples.staggered();
        let compress = |planned| {
            let Planned {
                triangles,
                coefficients,
                error,
            } = planned;
            self.report()?;
            let members = self.vertices_of(&triangles);
            let sources = self.sparse.sources_of(members.iter().copied());
            let columns = columns(&sources, &seen.sources);
            let few = staggered.fitted_of(columns.clone());
            let coefficients = compress::alternate(&few, coefficients, ROUNDS);
            drop(few);
            let fitted = samples.fitted_of(columns);
            let (images, _) = compress::images(&fitted, &coefficients);
            let encoded = compress::encode(&fitted, &images, error.max(aim));
            drop(fitted);
            let compressed = encoded.of(&self.weights(&members, &sources));
            let exact = (&seen.sources[..], samples);
            Ok(self.cluster((&triangles, &members), exact, probes, compressed, bounced))
        };
        plan.into_iter().map(compress).collect()
    }

    /// Tiles, and splits along the leading principal component, where vertices that see
    /// alike stay together, as long as they lower the sum of bytes and of what errors are
    /// worth in bytes. Returns that sum. The samples are of `sources`, which stand for all vertices of the triangles;
    /// `tiles` is where the search begins.
    fn plan(
        &self,
        triangles: &[u32],
        (sources, samples): (&[u32], &Samples),
        (aim, tiles): (f32, u32),
        plan: &mut Vec<Planned>,
    ) -> Result<f32, Interrupted> {
        self.report()?;
        let max_channels = self.options.max_tiles as usize * CHANNELS_PER_TILE;
        let members = self.vertices_of(triangles);
        let of_members = self.sparse.sources_of(members.iter().copied());
        let fitted = samples.fitted_of(columns(&of_members, sources));
        let basis = compress::analyse(&fitted, max_channels - 1);
        let count = members.len() as f32;
        let counted: f32 = members
            .iter()
            .map(|&place| self.counts[place as usize])
            .sum();
        let texels = self.options.basis_resolution.pow(2) as f32;
        let tile_bytes =
            CHANNELS_PER_TILE as f32 * (texels * BASIS_BYTES + count * COEFFICIENT_BYTES);
        let fits = Fits::new(&fitted, &basis, max_channels);
        let with_tiles = |tiles: u32| {
            let Fit {
                coefficients,
                error,
            } = fits.fit(tiles as usize * CHANNELS_PER_TILE);
            let tiles = coefficients.nrows().div_ceil(CHANNELS_PER_TILE) as u32;
            // Rounding takes its part of the error allowed.
            let error = math::hypot(error, ROUNDING * aim);
            Tried {
                error,
                tiles,
                bytes: tiles as f32 * tile_bytes,
                worth: counted * BYTES_PER_ERROR * (error / aim).powi(2),
                coefficients,
            }
        };
        let most = (basis.images.values.ncols().div_ceil(CHANNELS_PER_TILE) as u32).max(1);
        let whole = cheapest(tiles.min(most), most, FEWER_WORTH * tile_bytes, with_tiles);
        let cost = whole.cost();
        let begun = plan.len();
        plan.push(Planned {
            triangles: triangles.to_vec(),
            coefficients: whole.coefficients,
            error: whole.error,
        });
        let split_bytes = whole.tiles as f32 * texels * 4.0 * BASIS_BYTES;
        let hopeless = SPLIT_GAIN * whole.worth < split_bytes;
        if hopeless || members.len() < MIN_CLUSTER_VERTICES || triangles.len() < 2 {
            return Ok(cost);
        }
        let along: Vec<f32> = (self.weights(&members, &of_members).iter())
            .map(|sources| {
                let projections = sources.iter();
                projections
                    .map(|&(source, weight)| weight * basis.projections[(0, source)])
                    .sum()
            })
            .collect();
        let position = |triangle: u32| -> f32 {
            columns(&self.triangles[triangle as usize], &members)
                .into_iter()
                .map(|column| along[column])
                .sum()
        };
        let mut keyed: Vec<(f32, u32)> = triangles.iter().map(|&t| (position(t), t)).collect();
        keyed.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        let (low, high) = keyed.split_at(keyed.len() / 2);
        drop(fits);
        drop((fitted, basis));
        let mut split_cost = 0.0;
        for half in [low, high] {
            let mut group: Vec<u32> = half.iter().map(|&(_, triangle)| triangle).collect();
            group.sort_unstable();
            split_cost += self.plan(&group, (sources, samples), (aim, whole.tiles), plan)?;
        }
        if split_cost < cost {
            plan.remove(begun);
            return Ok(split_cost);
        }
        plan.truncate(begun + 1);
        Ok(cost)
    }

    /// All of a scene's triangles as one cluster, by as many principal components as the
    /// options ask for.
    pub(super) fn whole(
        &self,
        (triangles, seen, samples): (&[u32], &Seen, &Samples),
        probes: &[Probe],
        bounced: Option<&ChunkLight>,
        aim: f32,
    ) -> Cluster {
        let fitted = samples.fitted();
        let basis = compress::analyse(&fitted, self.options.global_rank as usize);
        let encoded = compress::encode(&fitted, &basis.images, aim);
        let compressed = encoded.of(&self.weights(&seen.places, &seen.sources));
        let exact = (&seen.sources[..], samples);
        self.cluster(
            (triangles, &seen.places),
            exact,
            probes,
            compressed,
            bounced,
        )
    }

    /// What stands for each of some places, by its number among `sources`, with its weight.
    fn weights(&self, places: &[u32], sources: &[u32]) -> Vec<Vec<(usize, f32)>> {
        let number = |source: u32| sources.partition_point(|&other| other < source);
        (places.iter())
            .map(|&place| {
                let weighted = self.sparse.sources(place).iter();
                weighted
                    .map(|&(source, weight)| (number(source), weight))
                    .collect()
            })
            .collect()
    }

    /// Copies what a cluster needs of the mesh and measures how far it is off. Triangles and
    /// vertices ascend; the samples are of `sources`.
    fn cluster(
        &self,
        (triangles, vertices): (&[u32], &[u32]),
        (sources, samples): (&[u32], &Samples),
        probes: &[Probe],
        (compressed, stored): (Compressed, Stored),
        bounced: Option<&ChunkLight>,
    ) -> Cluster {
        let mut errors = ErrorSums::at_vertices(&compressed, vertices.len());
        for probe in probes {
            if triangles.binary_search(&probe.triangle).is_ok() {
                let stored = stored.ssdfs(&columns(&probe.places, vertices));
                let exact = self.interpolated(&probe.places, sources, samples.ssdfs());
                errors.add_probe(probe, [&stored, &exact], &self.weighting);
            }
        }
        let used = self.mesh_vertices_of(triangles);
        let local = |vertex: u32| used.partition_point(|&other| other < vertex) as u32;
        let triangle = |&index: &u32| {
            let source = &self.mesh.triangles[index as usize];
            format::Triangle {
                vertices: source.vertices.map(local),
                material: source.material,
                cluster: 0,
            }
        };
        let triangles: Vec<_> = triangles.iter().map(triangle).collect();
        let (triangles, order) = layout::walk(&triangles, used.len());
        let order: Vec<u32> = order.into_iter().map(|number| used[number]).collect();
        let vertex = |&vertex: &u32| layout::rounded(self.mesh.vertices[vertex as usize].into());
        let second_uv = |&vertex: &u32| {
            layout::rounded_uv(self.mesh.vertices[vertex as usize].second_uv.into())
        };
        let column = |&vertex: &u32| {
            let place = self.places[vertex as usize];
            vertices.partition_point(|&other| other < place)
        };
        let columns: Vec<usize> = order.iter().map(column).collect();
        let weights = |bounced: &ChunkLight| -> Vec<i8> {
            (order.iter())
                .flat_map(|&vertex| bounced.weights_of(vertex))
                .copied()
                .collect()
        };
        Cluster {
            vertices: order.iter().map(vertex).collect(),
            second_uvs: if self.mesh.has_second_uvs() {
                order.iter().map(second_uv).collect()
            } else {
                Vec::new()
            },
            triangles,
            compressed: compressed.reordered(&columns),
            errors,
            transfer: ClusterTransfer {
                group: None,
                weights: bounced.map(weights).unwrap_or_default(),
            },
        }
    }
}

/// A cluster to be.
struct Planned {
    triangles: Vec<u32>,
    /// As they were fitted to thinned samples.
    coefficients: DMatrix<f32>,
    /// As it was there, radians. What is far off for want of images needs no fine rounding.
    error: f32,
}

/// What a number of tiles would cost.
struct Tried {
    tiles: u32,
    bytes: f32,
    /// Of the error that is left, in bytes.
    worth: f32,
    coefficients: DMatrix<f32>,
    /// Radians.
    error: f32,
}

impl Tried {
    fn cost(&self) -> f32 {
        self.bytes + self.worth
    }
}

/// The number of tiles in `1..=most` at which costs stop falling, on the way from `start`;
/// each costs a fit. Costs rise on both sides of the least, but for noise. Fewer are tried where the error
/// that is left is worth less than `fewer_worth`.
fn cheapest(start: u32, most: u32, fewer_worth: f32, with_tiles: impl Fn(u32) -> Tried) -> Tried {
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
    let least = if first.worth < fewer_worth { 1 } else { start };
    let fewer = walk(&mut (least..start).rev());
    let best = fewer.or_else(|| walk(&mut (start + 1..=most)));
    best.unwrap_or(first)
}

/// Where `members` are among the ascending `vertices`.
pub(super) fn columns(members: &[u32], vertices: &[u32]) -> Vec<usize> {
    let place = |vertex| vertices.binary_search(vertex).ok();
    members.iter().filter_map(place).collect()
}
