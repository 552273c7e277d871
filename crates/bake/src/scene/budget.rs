//! At what rate errors are bought with bytes, so that a scene ends at the error or the size
//! that was asked for. A few chunks from all over the scene tell.

use nalgebra::DMatrix;
use rayon::prelude::*;
use relight_format::math;
use relight_format::{self as format, VisibilityErrors};

use super::assemble::{Cluster, assemble};
use super::bounce::ChunkLight;
use super::error::Error;
use super::options::Options;
use super::sample::{Prepared, Seen};
use super::surface::{ErrorSums, Probe};

/// Chunks that are tried for a size, and for an error at most.
const SIZE_CHUNKS: usize = 32;
const ERROR_CHUNKS: usize = 10;
/// Trials at most; each compresses the chunks once.
const TRIALS: usize = 5;
/// How close a trial must come, as a factor.
const CLOSE: f32 = 1.05;
/// Standard errors by which the estimated size of a whole scene stays below the one asked
/// for: one bake in twenty may end above it.
const SURE: f32 = 1.65;
/// One triangle of so many is probed.
const PROBE_STEP: u32 = 4;
/// An error on the surface that compression can keep, in errors of interpolation.
const LEAST_OVER_INTERPOLATION: f32 = 1.1;
/// Without an error or a size asked for one chunk of so many tells of interpolation.
const CHUNKS_A_TRIAL: usize = 20;
/// The least aim then, in errors of interpolation: compression adds a fiftieth to them, about, and on meshes of rods
/// and leaves, of which interpolation knows little, halves the file.
const AIM_OVER_INTERPOLATION: f32 = 0.25;
/// First trial of a size, radians.
const FIRST_ERROR: f32 = 0.008;
/// Aims beyond these change nothing, radians.
const LEAST_AIM: f32 = 1e-5;
const LARGEST_AIM: f32 = 0.5;
/// Largest change of the aim's logarithm from one trial to the next.
const MAX_STEP: f32 = 2.0;
/// How errors and sizes go with the error aimed at, as exponents, until two trials tell.
const ERROR_EXPONENT: f32 = 0.5;
const SIZE_EXPONENT: f32 = -0.7;

/// A chunk that is tried.
struct Trial {
    triangles: Vec<u32>,
    seen: Seen,
    ssdfs: DMatrix<f32>,
    probes: Vec<Probe>,
    bounced: Option<ChunkLight>,
}

/// An aim, and what to say of it.
pub(super) struct Chosen {
    /// Radians.
    pub(super) aim: f32,
    pub(super) warning: Option<String>,
}

/// Without an error or a size to meet, the aim of the options, or a larger one where interpolation between vertices
/// alone is off by much more: bytes that no picture shows are not spent. Small scenes keep theirs, where finding out
/// would take longer than it saves.
pub(super) fn default_aim(prepared: &Prepared) -> Result<f32, Error> {
    let chunks = &prepared.chunks;
    let count = (chunks.len() / CHUNKS_A_TRIAL).min(ERROR_CHUNKS);
    // Where fewer are enough in the end, fewer are here.
    let fewer = (Options::standard().probes / prepared.options.probes).max(1);
    let step = PROBE_STEP * fewer as u32;
    let mut errors = ErrorSums::default();
    // By all threads at once, as one chunk has few groups of samples.
    let tried = spread(chunks.len(), count).flat_map(|chunk| &chunks[chunk]);
    prepared.sample_kept_for(tried)?;
    for chunk in spread(chunks.len(), count) {
        let (seen, ssdfs) = prepared.seen(&chunks[chunk])?;
        for probe in prepared.probes(&chunks[chunk], step)? {
            let exact = prepared.interpolated(&probe.places, &seen.sources, &ssdfs);
            errors.add_probe(&probe, [&exact; 2], &prepared.weighting);
        }
    }
    let interpolation = errors.errors().interpolation;
    Ok((prepared.options.aim).max(AIM_OVER_INTERPOLATION * interpolation))
}

/// `count` of so many chunks, evenly over all.
fn spread(all: usize, count: usize) -> impl Iterator<Item = usize> {
    (0..count).map(move |i| (2 * i + 1) * all / (2 * count))
}

/// The aim that gives what [`super::Options`] ask for. `head` is the asset without clusters.
pub(super) fn choose_aim(prepared: &Prepared, head: &format::Scene) -> Result<Chosen, Error> {
    let mut warning = None;
    let size = prepared.options.max_bytes.map(|bytes| bytes as f32);
    let error = prepared.options.max_error.unwrap_or(FIRST_ERROR);
    let mut target = size.map_or(error, |bytes| bytes / CLOSE);
    // A size is a promise; an error may be missed by a little in small scenes, which
    // trials would cost more than the bake.
    let most = match size {
        Some(_) => SIZE_CHUNKS,
        None => (prepared.chunks.len() / 4).clamp(ERROR_CHUNKS / 2, ERROR_CHUNKS),
    };
    let count = prepared.chunks.len().min(most);
    let mut trials = Vec::new();
    for chunk in spread(prepared.chunks.len(), count) {
        let (seen, ssdfs) = prepared.seen(&prepared.chunks[chunk])?;
        trials.push(Trial {
            triangles: prepared.chunks[chunk].clone(),
            // Only an error that is asked for has to be measured.
            probes: match size {
                Some(_) => Vec::new(),
                None => prepared.probes(&prepared.chunks[chunk], PROBE_STEP)?,
            },
            // Only a size that is asked for counts its bytes.
            bounced: match size {
                Some(_) => prepared.bounced(&prepared.chunks[chunk], &seen.sources, &ssdfs)?,
                None => None,
            },
            ssdfs,
            seen,
        });
    }
    let tried: Vec<usize> = trials.iter().map(|trial| trial.seen.places.len()).collect();
    let chunks: Vec<usize> = (0..prepared.chunks.len()).collect();
    let sizes = size
        .map(|_| Sizes::new(head, prepared.vertices_of_chunks(&chunks) as usize))
        .transpose()?;
    let expected = size.map_or(ERROR_EXPONENT, |_| SIZE_EXPONENT);
    // Logarithms of aims and of how far what they gave is from the target.
    let mut aim = math::ln(error.clamp(LEAST_AIM, LARGEST_AIM));
    let mut found: Vec<[f32; 2]> = Vec::new();
    for _ in 0..TRIALS {
        let compressed = try_aim(prepared, &trials, math::exp(aim))?;
        let reached = if let Some(sizes) = &sizes {
            let bytes: Result<Vec<f32>, Error> = compressed
                .iter()
                .map(|chunk| sizes.of([chunk.clone()]))
                .collect();
            sizes.fixed + at_most(sizes.of(compressed)?, &bytes?, &tried, sizes.vertices)
        } else {
            let errors = errors_of(&compressed);
            let least = LEAST_OVER_INTERPOLATION * errors.interpolation;
            if found.is_empty() && target < least {
                warning = Some(format!(
                    "an error of {error} rad asks for vertices closer together: {} come from \
                         interpolation between them alone; {least} are allowed",
                    errors.interpolation
                ));
                target = least;
            }
            errors.surface
        };
        let miss = math::ln(reached / target);
        if !miss.is_finite() {
            break;
        }
        found.push([aim, miss]);
        if miss.abs() < math::ln(CLOSE) {
            break;
        }
        let next = next_aim(&found, expected).clamp(math::ln(LEAST_AIM), math::ln(LARGEST_AIM));
        if next == aim {
            break;
        }
        aim = next;
    }
    // The one that comes closest from below, else the one that misses least.
    let within = |miss: f32| miss < math::ln(CLOSE);
    found.sort_unstable_by(|[_, a], [_, b]| {
        (within(*b).cmp(&within(*a))).then(a.abs().total_cmp(&b.abs()))
    });
    let aim = found
        .first()
        .map_or(prepared.options.aim, |&[aim, _]| math::exp(aim));
    Ok(Chosen { aim, warning })
}

/// The clusters that the trial chunks become.
fn try_aim(prepared: &Prepared, trials: &[Trial], aim: f32) -> Result<Vec<Vec<Cluster>>, Error> {
    let compress = |trial: &Trial| {
        let Trial {
            triangles,
            seen,
            ssdfs,
            probes,
            bounced,
        } = trial;
        let samples = prepared.weighed(triangles, seen, ssdfs.clone());
        let part = (&triangles[..], seen, &samples);
        let mut clusters = prepared.compress(part, probes, bounced.as_ref(), aim)?;
        if let Some(bounced) = bounced {
            bounced.open_group(&mut clusters);
        }
        Ok(clusters)
    };
    let mut compressed: Vec<Vec<Cluster>> = Vec::new();
    // As many at a time as the bake itself has at hand.
    for batch in trials.chunks(prepared.chunks_at_hand()) {
        let clusters = batch.par_iter().map(compress);
        compressed.extend(clusters.collect::<Result<Vec<_>, Error>>()?);
    }
    Ok(compressed)
}

/// How far some chunks are off.
fn errors_of(chunks: &[Vec<Cluster>]) -> VisibilityErrors {
    let mut errors = ErrorSums::default();
    for cluster in chunks.iter().flatten() {
        errors.add(&cluster.errors);
    }
    errors.errors()
}

/// Bytes that a scene of `all` vertices hardly exceeds if chunks of it take `together` bytes, and
/// each by itself, with so many `vertices`, so many `bytes`: the estimate from the ratio of
/// bytes to vertices and [`SURE`] standard errors of it (Cochran 1977, section 6.3).
fn at_most(together: f32, bytes: &[f32], vertices: &[usize], all: usize) -> f32 {
    let count = bytes.len() as f32;
    let tried = vertices.iter().sum::<usize>() as f32;
    let share = tried / all.max(1) as f32;
    let ratio = bytes.iter().sum::<f32>() / tried;
    let squares: f32 = (bytes.iter().zip(vertices))
        .map(|(bytes, vertices)| (bytes - ratio * *vertices as f32).powi(2))
        .sum();
    let variance = (1.0 - share).max(0.0) * count * squares / (count - 1.0).max(1.0);
    (together + SURE * variance.sqrt()) / share
}

/// What clusters add to a file.
struct Sizes {
    /// Of all chunks.
    vertices: usize,
    /// Bytes of the asset without its clusters.
    fixed: f32,
    /// The asset without its clusters and without its textures, which take long to write.
    bare: format::Scene,
    bare_bytes: f32,
}

impl Sizes {
    fn new(head: &format::Scene, vertices: usize) -> Result<Self, Error> {
        let mut bare = head.clone();
        for texture in &mut bare.textures {
            (texture.width, texture.height) = (1, 1);
            texture.texels.truncate(4);
        }
        Ok(Self {
            vertices,
            fixed: format::write_scene(head)?.len() as f32,
            bare_bytes: format::write_scene(&bare)?.len() as f32,
            bare,
        })
    }

    /// Bytes that the clusters of chunks add: together less than each by itself.
    fn of(&self, chunks: impl IntoIterator<Item = Vec<Cluster>>) -> Result<f32, Error> {
        let scene = assemble::<Error>(self.bare.clone(), chunks.into_iter().map(Ok))?;
        Ok(format::write_scene(&scene)?.len() as f32 - self.bare_bytes)
    }
}

/// Where to try next, after aims and misses that go with them by about the exponent
/// `expected`.
fn next_aim(found: &[[f32; 2]], expected: f32) -> f32 {
    let exponent = match found {
        [.., [a, first], [b, second]] if (second - first) / (b - a) * expected > 0.0 => {
            // Steps of tiles and splits may hide the slope between two trials.
            ((second - first) / (b - a)).abs().clamp(0.2, 2.0) * expected.signum()
        }
        _ => expected,
    };
    let Some([last, miss]) = found.last() else {
        return 0.0;
    };
    let next = (last - miss / exponent).clamp(last - MAX_STEP, last + MAX_STEP);
    // Between the trials on both sides of the target.
    let side = |wanted: bool| {
        (found.iter())
            .filter(move |[_, miss]| (miss * expected.signum() < 0.0) == wanted)
            .map(|[aim, _]| *aim)
    };
    let low = side(true).fold(f32::NEG_INFINITY, f32::max);
    let high = side(false).fold(f32::INFINITY, f32::min);
    if low < next && next < high {
        next
    } else {
        0.5 * (low + high)
    }
}

#[cfg(test)]
mod tests {
    use glam::{Vec2, Vec3};

    use super::super::bake::Bake;
    use super::super::load::SceneInput;
    use super::*;
    use crate::import::plain_material;
    use crate::mesh::{Mesh, Triangle, Vertex};
    use crate::monitor::SILENT;

    /// Looks for the aim that gives 0 with at most `TRIALS` trials.
    fn search(expected: f32, miss: impl Fn(f32) -> f32) -> f32 {
        let mut found = vec![[0.0, miss(0.0)]];
        while found.len() < TRIALS {
            let aim = next_aim(&found, expected);
            found.push([aim, miss(aim)]);
        }
        found
            .into_iter()
            .map(|[_, miss]| miss.abs())
            .fold(f32::INFINITY, f32::min)
    }

    /// The default aim for triangles, each with vertices of its own.
    fn aim_for(triangles: &[[Vec3; 3]]) -> f32 {
        let mut mesh = Mesh::default();
        for triangle in triangles {
            let base = mesh.vertices.len() as u32;
            let normal = (triangle[1] - triangle[0]).cross(triangle[2] - triangle[0]);
            mesh.vertices.extend(triangle.map(|position| Vertex {
                position,
                normal: normal.normalize(),
                tangent: (triangle[1] - triangle[0]).normalize(),
                bitangent_sign: 1.0,
                uv: Vec2::ZERO,
                second_uv: Vec2::ZERO,
            }));
            let vertices = [base, base + 1, base + 2];
            let material = 0;
            mesh.triangles.push(Triangle { vertices, material });
        }
        let grey = format::Surface::DiffuseSpecular {
            diffuse: [0.5; 3],
            specular: format::Specular::None,
        };
        mesh.materials.push(plain_material("grey", grey));
        let input = SceneInput {
            name: String::new(),
            object_diagonal: mesh.diagonal(),
            mesh,
            camera: None,
            environment: None,
            lights: Vec::new(),
            refinement: None,
            measured: Vec::new(),
            warnings: Vec::new(),
        };
        let options = Options {
            sample_resolution: 16,
            basis_resolution: 16,
            max_edge: 1.0,
            ..Options::standard()
        };
        let bake = Bake::new(input, &options, SILENT).expect("a scene");
        assert!(bake.chunk_count() >= CHUNKS_A_TRIAL);
        bake.aim() / options.aim
    }

    #[test]
    fn little_is_spent_where_interpolation_is_far_off() {
        let at = |x: usize, z: usize| Vec3::new(x as f32, 0.0, z as f32);
        let plane = (0..150).flat_map(|x| (0..150).map(move |z| [x, z]));
        let plane: Vec<[Vec3; 3]> = plane
            .flat_map(|[x, z]| {
                let [a, b, c, d] = [at(x, z), at(x, z + 1), at(x + 1, z + 1), at(x + 1, z)];
                [[a, b, c], [a, c, d]]
            })
            .collect();
        assert_eq!(aim_for(&plane), 1.0);
        // Leaves, in places that are as good as random (Roberts 2018).
        let number = |index: usize, step: f32| (index as f32 * step).fract();
        let leaves: Vec<[Vec3; 3]> = (0..8000)
            .map(|i| {
                let centre = Vec3::new(
                    number(i, 0.819_172_5),
                    number(i, 0.671_043_6),
                    number(i, 0.549_700_5),
                );
                [0, 1, 2].map(|k| {
                    let [u, v, w] =
                        [0.754_877_7, 0.569_840_3, 0.618_034].map(|step| number(3 * i + k, step));
                    centre + 0.1 * (Vec3::new(u, v, w) - 0.5)
                })
            })
            .collect();
        assert!(aim_for(&leaves) > 2.0);
    }

    #[test]
    fn sizes_are_told_from_chunks_and_their_spread() {
        assert_eq!(at_most(30.0, &[10.0, 20.0], &[1, 2], 3), 30.0);
        assert_eq!(at_most(30.0, &[10.0, 20.0], &[1, 2], 30), 300.0);
        assert_eq!(at_most(24.0, &[10.0, 20.0], &[1, 2], 30), 240.0);
        // Two chunks of four, whose bytes have a variance of 8: their sum is off by √(½ · 2 · 8).
        let bound = at_most(20.0, &[8.0, 12.0], &[5, 5], 20);
        assert!(
            (bound - (40.0 + SURE * 4.0 * 2.0f32.sqrt())).abs() < 1e-3,
            "{bound}"
        );
    }

    #[test]
    fn aims_are_found_along_smooth_and_stepped_curves() {
        for offset in [-1.5, -0.4, 0.3, 1.2] {
            for slope in [0.25, 0.5, 1.0] {
                assert!(search(0.5, |aim| slope * aim + offset) < 0.05);
                assert!(search(-0.7, |aim| -slope * aim + offset) < 0.05);
            }
            let stepped = |aim: f32| 0.2 * ((0.5 * aim + offset) / 0.2).round() + 0.07;
            assert!(search(0.5, stepped) < 0.15, "{offset}");
        }
    }
}
