//! Basis images -> integers as stored, and each vertex's coefficients, fitted to those.

use std::f32::consts::SQRT_2;

use nalgebra::DMatrix;
use relight_format::CHANNELS_PER_TILE;

use super::fit::{Images, solve_each, triangle};
use super::samples::{Fitted, LANES, column};
use crate::memory;
use crate::simd::{Of, product, vectorised, write_product};

/// What rounding may add to the error, as a part of the error allowed: about where a byte more lowers the error
/// by as much here as in another image or a smaller cluster.
const BASIS_ROUNDING: f32 = 0.32;
const COEFFICIENT_ROUNDING: f32 = 0.2;
/// What coefficients of the coefficient scale are stored as.
const MAX_COEFFICIENT: f32 = 32767.0;
/// Coefficients of an image are multiples of at most this.
const MAX_MULTIPLE: f32 = 1024.0;
/// Finest and coarsest steps of texels, in that which would do for all alike.
const FINEST: f32 = 0.7;
const COARSEST: f32 = 16.0;
/// Differences from predictions are rounded up from this part of a step on, and of a coarse one: the smaller
/// they are the fewer bits they take (Sullivan 1996).
const ROUND_UP: [f32; 2] = [0.62, 0.75];
/// The bits of a positive number's power of two.
const EXPONENT: u32 = 0x7f80_0000;
/// Largest step of basis images, in 127ths of their largest texel.
const MAX_STEP: f32 = 16.0;

/// A cluster as stored; see [`relight_format::Cluster`] for how it is decoded.
#[derive(Clone, Debug, PartialEq)]
pub struct Compressed {
    /// Tiles of four basis images.
    pub tiles: u32,
    /// Radians that a coefficient of 32767 stands for.
    pub coefficient_scale: f32,
    /// `4 * tiles` per vertex.
    pub coefficients: Vec<i16>,
    /// RGBA texels, tile after tile.
    pub basis: Vec<i8>,
    /// Sum over vertices of the squares of what stored minus exact distances cost, radians², as those that were fitted
    /// tell it: a wall whose edge is off by an angle costs its square.
    pub(crate) squared_error: f64,
}

impl Compressed {
    /// The same of vertices in another order, in which some may come several times.
    #[must_use]
    pub(crate) fn reordered(self, order: &[usize]) -> Self {
        let channels = self.tiles as usize * CHANNELS_PER_TILE;
        let rows = order
            .iter()
            .map(|vertex| &self.coefficients[vertex * channels..][..channels]);
        Self {
            coefficients: rows.flatten().copied().collect(),
            ..self
        }
    }
}

/// Σ of coefficients times images, radians per texel; as many tiles of images as there are
/// coefficients for.
pub(crate) fn decode(coefficients: &[i16], basis: &[i8], coefficient_scale: f32) -> Vec<f32> {
    let (coefficients, _) = coefficients.as_chunks::<CHANNELS_PER_TILE>();
    let (images, _) = basis.as_chunks::<CHANNELS_PER_TILE>();
    let texels = images.len() / coefficients.len();
    let mut ssdf = vec![0.0; texels];
    let scale = coefficient_scale / (MAX_COEFFICIENT * 127.0);
    vectorised!(
        <'a>
        ssdf: &'a mut [f32] = &mut ssdf,
        coefficients: &'a [[i16; CHANNELS_PER_TILE]] = coefficients,
        images: &'a [[i8; CHANNELS_PER_TILE]] = images,
        scale: f32 = scale
        => () {
            for (coefficients, tile) in coefficients.iter().zip(images.chunks_exact(ssdf.len())) {
                let factors = coefficients.map(|coefficient| f32::from(coefficient) * scale);
                for (distance, images) in ssdf.iter_mut().zip(tile) {
                    for (factor, image) in factors.iter().zip(images) {
                        *distance += factor * f32::from(*image);
                    }
                }
            }
        }
    );
    ssdf
}

/// Images as stored, and coefficients fitted to them.
pub struct Encoded {
    tiles: u32,
    /// RGBA texels, tile after tile.
    basis: Vec<i8>,
    /// One row per texel, one column per image.
    decoded: DMatrix<f32>,
    /// Not rounded: one row per image, one column per vertex that was fitted.
    coefficients: DMatrix<f32>,
    steps: Steps,
    /// Sum over those vertices, as in [`Compressed`].
    squared_error: f64,
}

/// What coefficients are rounded to.
struct Steps {
    /// Of the finest, radians.
    finest: f32,
    /// Of every image, in that.
    multiples: Vec<f32>,
}

/// SSDFs as stored.
pub(crate) struct Stored {
    /// Images, and coefficients as rounded.
    factors: [DMatrix<f32>; 2],
}

impl Steps {
    fn round(&self, coefficients: &DMatrix<f32>) -> DMatrix<i16> {
        DMatrix::from_fn(
            coefficients.nrows(),
            coefficients.ncols(),
            |channel, vertex| {
                let multiple = self.multiples[channel];
                let most = (MAX_COEFFICIENT / multiple).floor();
                let value = coefficients[(channel, vertex)] / (self.finest * multiple);
                (value.round().clamp(-most, most) * multiple) as i16
            },
        )
    }

    /// What integers stand for, radians.
    fn decode(&self, integers: &DMatrix<i16>) -> DMatrix<f32> {
        integers.map(|value| f32::from(value) * self.finest)
    }
}

impl Encoded {
    /// Root mean square over vertices, radians.
    pub fn error(&self) -> f32 {
        (self.squared_error / self.coefficients.ncols() as f64).sqrt() as f32
    }

    /// For each of some vertices the weighted sum of those that were fitted, given by their numbers: SSDFs are linear
    /// in coefficients, and so what interpolates the one interpolates the other.
    pub(crate) fn of(self, vertices: &[Vec<(usize, f32)>]) -> (Compressed, Stored) {
        let channels = self.coefficients.nrows();
        let mut coefficients = DMatrix::zeros(channels, vertices.len());
        for (mut sum, sources) in coefficients.column_iter_mut().zip(vertices) {
            for &(source, weight) in sources {
                sum += self.coefficients.column(source) * weight;
            }
        }
        let integers = self.steps.round(&coefficients);
        let lanes = self.tiles as usize * CHANNELS_PER_TILE;
        let mut coefficients = vec![0i16; vertices.len() * lanes];
        let columns = integers.column_iter();
        for (out, column) in coefficients.chunks_exact_mut(lanes).zip(columns) {
            out.iter_mut()
                .zip(&column)
                .for_each(|(out, value)| *out = *value);
        }
        let all = vertices.len() as f64 / self.coefficients.ncols() as f64;
        let compressed = Compressed {
            tiles: self.tiles,
            coefficient_scale: self.steps.finest * MAX_COEFFICIENT,
            coefficients,
            basis: self.basis,
            squared_error: self.squared_error * all,
        };
        let stored = Stored {
            factors: [self.decoded, self.steps.decode(&integers)],
        };
        (compressed, stored)
    }
}

impl Stored {
    /// Of some vertices, radians: one row per texel, one column per vertex.
    pub(crate) fn ssdfs(&self, vertices: &[usize]) -> DMatrix<f32> {
        let [images, coefficients] = &self.factors;
        product(images, &coefficients.select_columns(vertices))
    }
}

/// Quantises images and fits coefficients to them. Rounding takes its part of `max_error`,
/// the root mean square that [`Encoded::error`] is expected to have or may have, radians.
pub fn encode(fitted: &Fitted, images: &Images, max_error: f32) -> Encoded {
    let (texels, vertices) = (images.values.nrows(), fitted.vertices.len());
    let channels = images.values.ncols();
    let rounding = max_error * BASIS_ROUNDING / fitted.cost.sqrt();
    let quantised = quantise(images, rounding, &fitted.costs);
    let decoded = quantised.map(|value: i8| f32::from(value) / 127.0);
    let systems = fitted.systems(&decoded);
    let coefficients = solve_each(&systems, channels);
    // Coefficients of every image err by the same. What one costs that is off by one: the
    // diagonal of the normal matrices.
    let rounding = max_error * COEFFICIENT_ROUNDING / (channels as f32).sqrt();
    let steps: Vec<f32> = (0..channels)
        .map(|channel| {
            let cost = systems.column(triangle(channel) + channel).sum() / vertices as f32;
            rounding * (12.0 / cost).sqrt()
        })
        .collect();
    let least = steps.iter().copied().fold(f32::MAX, f32::min);
    let representable = coefficients.amax() / MAX_COEFFICIENT;
    // Images of nothing have no least step.
    let finest = if least < f32::MAX {
        least.max(representable)
    } else {
        representable
    };
    let multiple = |step: &f32| (step / finest).floor().clamp(1.0, MAX_MULTIPLE);
    let steps = Steps {
        finest,
        multiples: steps.iter().map(multiple).collect(),
    };
    let tiles = channels.div_ceil(CHANNELS_PER_TILE);
    let lanes = tiles * CHANNELS_PER_TILE;
    let mut basis = vec![0i8; texels * lanes];
    for (channel, image) in quantised.column_iter().enumerate() {
        let (tile, lane) = (channel / CHANNELS_PER_TILE, channel % CHANNELS_PER_TILE);
        let out = basis[tile * texels * CHANNELS_PER_TILE..].chunks_exact_mut(CHANNELS_PER_TILE);
        out.zip(&image)
            .for_each(|(texel, value)| texel[lane] = *value);
    }
    let mut stored = memory::used(texels * vertices);
    let rounded = steps.decode(&steps.round(&coefficients));
    write_product(&Of(&decoded), &rounded, &mut stored);
    let stored = DMatrix::from_vec(texels, vertices, stored);
    let squared_error = vectorised!(
        <'a> fitted: &'a Fitted<'a> = fitted, stored: &'a DMatrix<f32> = &stored
        => f64 {
            let mut sum = 0.0;
            for ([exact, weights], found) in
                fitted.columns().zip(stored.as_slice().chunks_exact(stored.nrows()))
            {
                sum += f64::from(squared_error(found, exact, weights));
            }
            sum
        }
    );
    memory::keep(stored);
    Encoded {
        tiles: tiles as u32,
        basis,
        decoded,
        coefficients,
        steps,
        squared_error,
    }
}

/// What a wrong SSDF costs, radians²: the weighted sum of squared differences.
#[inline(always)]
fn squared_error(found: &[f32], exact: &[f32], weights: &[f32]) -> f32 {
    // Side by side, as vector instructions want it.
    let mut sums = [0.0; LANES];
    let chunks = found.chunks(LANES).zip(exact.chunks(LANES));
    for ((found, exact), weights) in chunks.zip(weights.chunks(LANES)) {
        let texels = found.iter().zip(exact).zip(weights);
        for (sum, ((found, exact), weight)) in sums.iter_mut().zip(texels) {
            *sum += (found - exact).powi(2) * weight;
        }
    }
    sums.iter().sum()
}

/// Images in steps that together cost `rounding`, radians root mean square, and the values that
/// those stand for, where an error of one radian at a texel costs `costs`.
///
/// Images of small coefficients need less precision: they take part of the range. So do texels
/// whose errors cost little, below the horizon and far from boundaries: at the least sum of bits,
/// steps go with the inverse root of the cost. What is stored are differences from what is predicted; so
/// it is differences that are multiples of coarser steps, and readers need not know which.
fn quantise(images: &Images, rounding: f32, costs: &[f32]) -> DMatrix<i8> {
    let (texels, channels) = images.values.shape();
    let mean = costs.iter().sum::<f32>() / texels as f32;
    // Steps in that which would do for all texels alike.
    let coarseness: Vec<f32> = (costs.iter())
        .map(|cost| (mean / cost).sqrt().clamp(FINEST, COARSEST))
        .collect();
    let least = coarseness.iter().copied().fold(f32::MAX, f32::min);
    let each = rounding * (12.0 / channels as f32).sqrt();
    let mut quantised = DMatrix::zeros(texels, channels);
    for first in (0..channels).step_by(LANES) {
        // Images of nothing keep these.
        let (mut wanted, mut steps) = ([0.0; LANES], [1.0; LANES]);
        let mut values = vec![[0.0; LANES]; texels];
        for (lane, channel) in (first..channels.min(first + LANES)).enumerate() {
            let image = column(&images.values, channel);
            for (values, value) in values.iter_mut().zip(image) {
                values[lane] = *value;
            }
            let finest = image
                .iter()
                .fold(0.0f32, |most, value| most.max(value.abs()))
                / 127.0;
            if finest > 0.0 {
                wanted[lane] = each / images.amplitudes[channel];
                steps[lane] = (wanted[lane] * least).clamp(finest, MAX_STEP * finest);
            }
        }
        let rounded = vectorised!(
            <'a>
            values: &'a [[f32; LANES]] = &values,
            coarseness: &'a [f32] = &coarseness,
            scales: [[f32; LANES]; 2] = [wanted, steps]
            => Vec<[i8; LANES]> { round(values, coarseness, scales[0], scales[1]) }
        );
        for (lane, channel) in (first..channels.min(first + LANES)).enumerate() {
            for (to, from) in quantised.column_mut(channel).iter_mut().zip(&rounded) {
                *to = from[lane];
            }
        }
    }
    quantised
}

/// Images side by side in multiples of their steps, where `wanted` is what would do for texels of a coarseness of 1.
#[inline(always)]
fn round(
    values: &[[f32; LANES]],
    coarseness: &[f32],
    wanted: [f32; LANES],
    steps: [f32; LANES],
) -> Vec<[i8; LANES]> {
    let side = values.len().isqrt();
    let mut rounded = vec![[0i8; LANES]; values.len()];
    for texel in 0..values.len() {
        let predicted = relight_format::predict(&rounded, texel, side);
        for lane in 0..LANES {
            let predicted = f32::from(predicted[lane]);
            // The nearest power of two. Nothing is finer than a step.
            let multiple = (wanted[lane] * coarseness[texel] / steps[lane] * SQRT_2).max(1.0);
            let multiple = f32::from_bits(multiple.to_bits() & EXPONENT);
            let difference = (values[texel][lane] / steps[lane] - predicted) / multiple;
            let up = if multiple > 1.0 {
                ROUND_UP[1]
            } else {
                ROUND_UP[0]
            };
            let multiples = (difference.abs() + 1.0 - up).floor().copysign(difference);
            rounded[texel][lane] = (predicted + multiples * multiple).clamp(-127.0, 127.0) as i8;
        }
    }
    rounded
}
