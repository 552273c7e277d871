//! Basis images -> integers as stored, and each vertex's coefficients, fitted to those.

use nalgebra::DMatrix;
use relight_format::CHANNELS_PER_TILE;

use super::fit::{Images, solve_each};
use super::samples::{Fitted, Samples};
use crate::simd::product;

/// What rounding may add to the error, as a part of the error allowed: the squares of both
/// come to less than a tenth of its square.
const BASIS_ROUNDING: f32 = 0.25;
const COEFFICIENT_ROUNDING: f32 = 0.15;
/// What coefficients of the coefficient scale are stored as.
const MAX_COEFFICIENT: f32 = 32767.0;
/// Coefficients of an image are multiples of at most this.
const MAX_MULTIPLE: f32 = 1024.0;
/// Largest step of basis images, in 127ths of their largest texel.
const MAX_STEP: f32 = 16.0;
/// SSDFs whose errors are summed in one product of matrices.
const BLOCK_VERTICES: usize = 512;
/// Sums that are formed side by side.
const LANES: usize = 16;

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
    /// Sum over vertices of the squares of what stored minus exact distances cost, radians²:
    /// a wall whose edge is off by an angle costs its square.
    pub(crate) squared_error: f64,
}

impl Compressed {
    /// Root mean square over vertices, radians.
    pub fn error(&self) -> f32 {
        let channels = self.tiles as usize * CHANNELS_PER_TILE;
        let vertices = self.coefficients.len() / channels;
        (self.squared_error / vertices as f64).sqrt() as f32
    }

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

    /// The stored SSDF of a vertex, radians, at every texel.
    pub(crate) fn decode(&self, vertex: usize) -> Vec<f32> {
        let channels = self.tiles as usize * CHANNELS_PER_TILE;
        let coefficients = &self.coefficients[vertex * channels..][..channels];
        decode(coefficients, &self.basis, self.coefficient_scale)
    }
}

/// Σ of coefficients times images, radians per texel; as many tiles of images as there are
/// coefficients for.
pub(crate) fn decode(coefficients: &[i16], basis: &[i8], coefficient_scale: f32) -> Vec<f32> {
    let coefficients = coefficients.chunks_exact(CHANNELS_PER_TILE);
    let tile_bytes = basis.len() / coefficients.len();
    let mut ssdf = vec![0.0; tile_bytes / CHANNELS_PER_TILE];
    let scale = coefficient_scale / (MAX_COEFFICIENT * 127.0);
    for (coefficients, tile) in coefficients.zip(basis.chunks_exact(tile_bytes)) {
        for (distance, images) in ssdf.iter_mut().zip(tile.chunks_exact(CHANNELS_PER_TILE)) {
            for (coefficient, image) in coefficients.iter().zip(images) {
                *distance += f32::from(*coefficient) * f32::from(*image) * scale;
            }
        }
    }
    ssdf
}

/// Quantises images and fits coefficients to them. Rounding takes its part of `max_error`,
/// the root mean square that `Compressed::error` may have, radians.
pub fn encode(fitted: &Fitted, images: &Images, max_error: f32) -> Compressed {
    let Samples { ssdfs, weights } = fitted.samples;
    let (texels, vertices) = ssdfs.shape();
    let channels = images.values.ncols();
    // What an error of one radian everywhere costs.
    let cost = fitted.weights.sum() / vertices as f32;
    let quantised = quantise(images, max_error * BASIS_ROUNDING / cost.sqrt());
    let decoded = quantised.map(|value: i8| f32::from(value) / 127.0);
    let systems = fitted.systems(&decoded);
    let coefficients = solve_each(&systems, channels);
    // Coefficients of every image err by the same. What one costs that is off by one: the
    // diagonal of the normal matrices.
    let rounding = max_error * COEFFICIENT_ROUNDING / (channels as f32).sqrt();
    let steps: Vec<f32> = (0..channels)
        .map(|channel| {
            let cost = systems.row(channel * (channel + 3) / 2).sum() / vertices as f32;
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
    let coefficient_scale = finest * MAX_COEFFICIENT;
    let integers = DMatrix::from_fn(channels, vertices, |channel, vertex| {
        let multiple = (steps[channel] / finest).floor().clamp(1.0, MAX_MULTIPLE);
        let most = (MAX_COEFFICIENT / multiple).floor();
        let value = coefficients[(channel, vertex)] / (finest * multiple);
        (value.round().clamp(-most, most) * multiple) as i16
    });
    let tiles = channels.div_ceil(CHANNELS_PER_TILE);
    let stored = tiles * CHANNELS_PER_TILE;
    let mut coefficients = vec![0i16; vertices * stored];
    for (out, column) in coefficients
        .chunks_exact_mut(stored)
        .zip(integers.column_iter())
    {
        out.iter_mut()
            .zip(&column)
            .for_each(|(out, value)| *out = *value);
    }
    let mut basis = vec![0i8; texels * stored];
    for (channel, image) in quantised.column_iter().enumerate() {
        let (tile, lane) = (channel / CHANNELS_PER_TILE, channel % CHANNELS_PER_TILE);
        let out = basis[tile * texels * CHANNELS_PER_TILE..].chunks_exact_mut(CHANNELS_PER_TILE);
        out.zip(&image)
            .for_each(|(texel, value)| texel[lane] = *value);
    }
    let mut squared_error = 0.0;
    for first in (0..vertices).step_by(BLOCK_VERTICES) {
        let count = BLOCK_VERTICES.min(vertices - first);
        let values = integers
            .columns(first, count)
            .map(|value| f32::from(value) * finest);
        let found = product(&decoded, &values);
        for ((found, exact), weights) in columns(&found, 0)
            .zip(columns(ssdfs, first))
            .zip(columns(weights, first))
        {
            squared_error += f64::from(self::squared_error(found, exact, weights));
        }
    }
    Compressed {
        tiles: tiles as u32,
        coefficient_scale,
        coefficients,
        basis,
        squared_error,
    }
}

/// The columns from `first` on.
fn columns(matrix: &DMatrix<f32>, first: usize) -> std::slice::ChunksExact<'_, f32> {
    let texels = matrix.nrows();
    matrix.as_slice()[first * texels..].chunks_exact(texels)
}

/// What a wrong SSDF costs, radians²: the weighted sum of squared differences.
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

/// Images in steps that together err by `rounding`, radians root mean square, and the values
/// that those stand for. Images of small coefficients need less precision: they take part of
/// the range, and compress better.
fn quantise(images: &Images, rounding: f32) -> DMatrix<i8> {
    let (texels, channels) = images.values.shape();
    let each = rounding * (12.0 / channels as f32).sqrt();
    let mut quantised = DMatrix::zeros(texels, channels);
    let pairs = quantised.column_iter_mut().zip(images.values.column_iter());
    for ((mut out, image), amplitude) in pairs.zip(&images.amplitudes) {
        let finest = image.amax() / 127.0;
        if finest > 0.0 {
            let step = (each / amplitude).clamp(finest, MAX_STEP * finest);
            out.zip_apply(&image, |out, value| *out = (value / step).round() as i8);
        }
    }
    quantised
}
