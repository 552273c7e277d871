//! At what rate errors are bought with bytes, so that a scene ends at the error or the size
//! that was asked for. A few chunks from all over the scene tell.

use rayon::prelude::*;
use relight_format as format;

use super::{Bake, Cluster, Counters, Error, assemble};
use crate::compress::{ErrorSums, Samples};

/// Chunks that are tried.
const CHUNKS: usize = 12;
/// Trials at most; each compresses the chunks once.
const TRIALS: usize = 4;
/// How close a trial must come, as a factor.
const CLOSE: f32 = 1.05;
/// What the estimated size of a whole scene may miss, as a part of it.
const SIZE_MARGIN: f32 = 0.07;
/// First trial of a size, radians.
const FIRST_ERROR: f32 = 0.008;
/// How errors and sizes go with the error aimed at, as exponents, until two trials tell.
const ERROR_EXPONENT: f32 = 0.5;
const SIZE_EXPONENT: f32 = -0.7;

/// A chunk that is tried.
struct Trial {
    triangles: Vec<u32>,
    vertices: Vec<u32>,
    samples: Samples,
}

impl Bake<'_> {
    /// The error to aim at in every cluster, radians.
    pub(super) fn choose_aim(&mut self) -> Result<f32, Error> {
        let size = self.options.max_bytes.map(|bytes| bytes as f32);
        let target = size.map_or(self.options.max_error, |bytes| bytes / (1.0 + SIZE_MARGIN));
        let count = self.chunks.len().min(CHUNKS);
        let chosen = (0..count).map(|i| (2 * i + 1) * self.chunks.len() / (2 * count));
        let mut trials = Vec::new();
        for chunk in chosen {
            let (vertices, samples) = self.samples(&self.chunks[chunk])?;
            trials.push(Trial {
                triangles: self.chunks[chunk].clone(),
                vertices,
                samples,
            });
        }
        let tried: usize = trials.iter().map(|trial| trial.triangles.len()).sum();
        let share = tried as f32 / self.triangles.len().max(1) as f32;
        let fixed = format::write_scene(&self.head).map_or(0, |bytes| bytes.len()) as f32;
        // Logarithms of the aim and of how far what it gave is from the target.
        let mut aim = (size.map_or(self.options.max_error, |_| FIRST_ERROR)).ln();
        let mut found: Vec<[f32; 2]> = Vec::new();
        for _ in 0..TRIALS {
            let (error, bytes) = self.try_aim(&trials, aim.exp())?;
            let reached = size.map_or(error, |_| fixed + (bytes - fixed).max(0.0) / share);
            let miss = (reached / target).ln();
            if !miss.is_finite() {
                break;
            }
            found.push([aim, miss]);
            if miss.abs() < CLOSE.ln() {
                break;
            }
            let expected = if size.is_some() {
                SIZE_EXPONENT
            } else {
                ERROR_EXPONENT
            };
            let exponent = match found[..] {
                [.., [a, first], [b, second]] => {
                    let slope = (second - first) / (b - a);
                    // Steps of tiles and splits may hide the slope between two trials.
                    if slope * expected > 0.0 {
                        slope.abs().clamp(0.2, 2.0) * expected.signum()
                    } else {
                        expected
                    }
                }
                _ => expected,
            };
            aim = (aim - miss / exponent).clamp(1e-5f32.ln(), 0.5f32.ln());
        }
        self.counters = Counters::default();
        Ok(aim.exp())
    }

    /// Root mean square error of the trial chunks, radians, and the bytes of a file of them.
    fn try_aim(&self, trials: &[Trial], aim: f32) -> Result<(f32, f32), Error> {
        let compressed = (trials.par_iter())
            .map(|trial| {
                let mut clusters = Vec::new();
                self.compress_clusters(
                    &trial.triangles,
                    &trial.vertices,
                    &trial.samples,
                    aim,
                    &mut clusters,
                )?;
                Ok(clusters)
            })
            .collect::<Result<Vec<Vec<Cluster>>, Error>>()?;
        let mut error = ErrorSums::default();
        for cluster in compressed.iter().flatten() {
            error.add(&cluster.compressed.error);
        }
        let chunks = compressed.into_iter().map(Ok::<_, Error>);
        let scene = assemble(self.head.clone(), chunks)?;
        let bytes = format::write_scene(&scene).map_or(0, |bytes| bytes.len());
        Ok((error.boundary_rms(), bytes as f32))
    }
}
