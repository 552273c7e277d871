//! SSDFs of a cluster -> a mean, basis images and coefficients, quantised as stored.
//!
//! Principal component analysis of the cluster's clamped SSDFs (Sloan et al. 2003; Wang et
//! al. 2013) finds a basis, and weighted least squares the one that is stored. The weights
//! are what an error costs in a picture: an SSDF shades by the place of its boundary alone,
//! and light from there by the cosine to the surface's normal; what lies below the horizon
//! is never looked at. Squares of errors are weighted by the cosine, between its square, as
//! is right for light from everywhere, and none, as is right for a low sun and nothing
//! else. The basis is quantised first; each vertex's coefficients are then fitted to the
//! quantised basis.

use glam::Vec3;
use nalgebra::{DMatrix, DVector};
use relight_format::CHANNELS_PER_TILE;

use crate::visibility::Directions;

/// Half-width of the weight about the visibility boundary, radians: two texels of a basis
/// image of usual size.
const BOUNDARY_WIDTH: f32 = 0.05;
/// Half of the angular width of lights that errors are told for.
const LIGHT_WIDTH: f32 = 0.05;
/// A small angle.
const LITTLE: f32 = 1e-3;
/// Weight of texels far from the boundary, which only guide the steps of sphere tracing.
const FAR_WEIGHT: f32 = 0.003;
/// Weight of texels below the horizon, for normals that interpolation turns.
const HIDDEN_WEIGHT: f32 = 0.02;
/// Subspace iterations; four separate the spectrum of SSDFs to well below quantisation.
const ITERATIONS: usize = 4;
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
/// Texels whose weight at every vertex is below this part of the largest are told by the
/// [`SKIPPED`]th of them.
const IDLE: f32 = 0.02;
const SKIPPED: usize = 8;
/// Texels and rows that [`Samples::thinned`] steps by.
const THINNED: usize = 2;
/// Lengths of principal axes, in that of the longest, that come from rounding.
const NOISE: f64 = 1e-4;
/// Extra vectors in the subspace iteration, to converge the last ones kept.
const OVERSAMPLING: usize = 6;

/// A vertex's shading normal as the weights see it.
#[derive(Clone, Copy, Debug)]
pub struct Normal {
    /// Unit length.
    pub direction: Vec3,
    /// Sine of the angle by which a normal map may turn it.
    pub tilt: f32,
}

impl Normal {
    /// Cosine to a direction, of the nearest normal.
    fn seen(&self, direction: Vec3) -> f32 {
        let cosine = self.direction.dot(direction);
        ((cosine + self.tilt) / (1.0 + self.tilt)).max(0.0)
    }
}

/// What an error of an SSDF costs, by direction.
pub struct Weighting {
    directions: Directions,
    /// Solid angle of every texel, in units of the weights that a wall has: of a vertical
    /// wall that hides half of the sky, at a vertex whose normal points up.
    solid_angles: Vec<f32>,
    /// Of such a wall's edge that is off by one, squared, in [`Self::squared_displacement`],
    /// while it is off by little.
    wall: f32,
}

impl Weighting {
    /// For basis images of this many texels per side.
    pub fn new(basis_resolution: u32) -> Self {
        let directions = Directions::new(basis_resolution);
        // The octahedral map shrinks by the third power of the distance to the octahedron's
        // face (Engelhardt & Dachsbacher 2008).
        let solid_angles = (directions.as_slice().iter())
            .map(|direction| direction.abs().element_sum().powi(3))
            .collect();
        let mut weighting = Self {
            directions,
            solid_angles,
            wall: 1.0,
        };
        let wall: Vec<f32> = (weighting.directions.as_slice().iter())
            .map(|direction| direction.x.asin())
            .collect();
        let up = Normal {
            direction: Vec3::Y,
            tilt: 0.0,
        };
        let mut weights = vec![0.0; wall.len()];
        weighting.weigh(&wall, up, &mut weights);
        let sum: f32 = weights.iter().sum();
        (weighting.solid_angles.iter_mut()).for_each(|solid_angle| *solid_angle /= sum);
        let off: Vec<f32> = wall.iter().map(|distance| distance + LITTLE).collect();
        weighting.wall = weighting.squared_displacement(&off, &wall, up) / (LITTLE * LITTLE);
        weighting
    }

    /// How far the boundary of `found` is off, squared: as an error of light shows, which
    /// grows with the displacement until the boundary has passed all of a light.
    pub(crate) fn squared_displacement(&self, found: &[f32], exact: &[f32], normal: Normal) -> f32 {
        let squash = |distance: f32| distance / (1.0 + (distance / LIGHT_WIDTH).powi(2)).sqrt();
        let texels = self.directions.as_slice().iter().zip(&self.solid_angles);
        let sum: f32 = (found.iter().zip(exact).zip(texels))
            .map(|((found, exact), (direction, solid_angle))| {
                let difference = squash(*found) - squash(*exact);
                solid_angle * normal.seen(*direction) * difference.powi(2)
            })
            .sum();
        sum / self.wall
    }

    /// Weight of a squared error at every texel of an SSDF.
    pub(crate) fn weigh(&self, ssdf: &[f32], normal: Normal, weights: &mut [f32]) {
        let texels = self.directions.as_slice().iter().zip(&self.solid_angles);
        for ((weight, distance), (direction, solid_angle)) in
            weights.iter_mut().zip(ssdf).zip(texels)
        {
            let seen = normal.seen(*direction);
            let near = 1.0 / (1.0 + (distance / BOUNDARY_WIDTH).powi(4));
            *weight = solid_angle * (FAR_WEIGHT + near) * (HIDDEN_WEIGHT + seen);
        }
    }
}

/// SSDFs of a cluster and what their errors cost: one row per texel, one column per vertex.
pub struct Samples {
    ssdfs: DMatrix<f32>,
    weights: DMatrix<f32>,
}

/// Those texels of samples that bases and coefficients are fitted to.
pub struct Fitted<'a> {
    samples: &'a Samples,
    texels: Vec<usize>,
    /// Products of weights and SSDFs.
    weighted: DMatrix<f32>,
    weights: DMatrix<f32>,
}

impl Samples {
    /// One normal per column of `ssdfs`.
    pub fn new(ssdfs: DMatrix<f32>, normals: &[Normal], weighting: &Weighting) -> Self {
        let mut weights = DMatrix::zeros(ssdfs.nrows(), ssdfs.ncols());
        let texels = ssdfs.nrows();
        let columns = ssdfs.as_slice().chunks_exact(texels);
        let weighted = weights.as_mut_slice().chunks_exact_mut(texels);
        for ((weights, ssdf), normal) in weighted.zip(columns).zip(normals) {
            weighting.weigh(ssdf, *normal, weights);
        }
        Self { ssdfs, weights }
    }

    /// The SSDF of a vertex, radians.
    pub(crate) fn ssdf(&self, column: usize) -> &[f32] {
        let texels = self.ssdfs.nrows();
        &self.ssdfs.as_slice()[column * texels..][..texels]
    }

    /// Those of some vertices.
    #[must_use]
    pub fn select(&self, columns: &[usize]) -> Self {
        Self {
            ssdfs: self.ssdfs.select_columns(columns),
            weights: self.weights.select_columns(columns),
        }
    }

    /// One texel of four, which stands for them all: enough to tell what compression would
    /// give.
    #[must_use]
    pub fn thinned(&self) -> Self {
        let side = self.ssdfs.nrows().isqrt();
        let step = THINNED.min(side);
        let texels: Vec<usize> = (0..side * side)
            .filter(|texel| {
                [texel / side, texel % side]
                    .iter()
                    .all(|i| i.is_multiple_of(step))
            })
            .collect();
        let scale = (side * side) as f32 / texels.len() as f32;
        Self {
            ssdfs: self.ssdfs.select_rows(&texels),
            weights: self.weights.select_rows(&texels) * scale,
        }
    }

    /// The texels that count: all near a boundary above some vertex's horizon, few others.
    pub fn fitted(&self) -> Fitted<'_> {
        let mut largest = vec![0.0f32; self.weights.nrows()];
        for column in self.weights.column_iter() {
            for (largest, weight) in largest.iter_mut().zip(&column) {
                *largest = largest.max(*weight);
            }
        }
        let bound = IDLE * largest.iter().copied().fold(0.0, f32::max);
        let mut idle = 0;
        let (mut texels, mut factors) = (Vec::new(), Vec::new());
        for (texel, largest) in largest.into_iter().enumerate() {
            let busy = largest > bound;
            if busy || idle % SKIPPED == 0 {
                texels.push(texel);
                factors.push(if busy { 1.0 } else { SKIPPED as f32 });
            }
            idle += usize::from(!busy);
        }
        let mut weights = self.weights.select_rows(&texels);
        for mut column in weights.column_iter_mut() {
            for (weight, factor) in column.iter_mut().zip(&factors) {
                *weight *= factor;
            }
        }
        Fitted {
            samples: self,
            weighted: self.ssdfs.select_rows(&texels).component_mul(&weights),
            texels,
            weights,
        }
    }
}

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
    pub squared_error: f64,
}

impl Compressed {
    /// Root mean square over vertices, radians.
    pub fn error(&self) -> f32 {
        let channels = self.tiles as usize * CHANNELS_PER_TILE;
        let vertices = self.coefficients.len() / channels;
        (self.squared_error / vertices as f64).sqrt() as f32
    }

    /// The same of vertices in another order, of which each comes once.
    #[must_use]
    pub fn reordered(self, order: &[usize]) -> Self {
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
    pub fn decode(&self, vertex: usize) -> Vec<f32> {
        let channels = self.tiles as usize * CHANNELS_PER_TILE;
        let coefficients = &self.coefficients[vertex * channels..][..channels];
        decode(coefficients, &self.basis, self.coefficient_scale)
    }
}

/// Σ of coefficients times images, radians per texel; as many tiles of images as there are
/// coefficients for.
pub fn decode(coefficients: &[i16], basis: &[i8], coefficient_scale: f32) -> Vec<f32> {
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

/// Images whose weighted sums are SSDFs.
#[derive(Clone)]
pub struct Images {
    /// One row per texel, one column per image.
    pub values: DMatrix<f32>,
    /// Root mean square of the coefficients of every image.
    pub amplitudes: Vec<f32>,
}

/// Mean and leading principal components of a set of SSDFs.
pub struct Basis {
    /// Column 0 is the mean; the others are orthonormal, by falling variance.
    pub images: Images,
    /// Projections of the centred SSDFs: one row per component (without the mean), one
    /// column per vertex.
    pub projections: DMatrix<f32>,
}

/// Principal component analysis: the mean and at most `rank` components.
///
/// Randomised subspace iteration (Halko, Martinsson & Tropp 2011) from a fixed seed.
pub fn analyse(samples: &Samples, rank: usize) -> Basis {
    let ssdfs = &samples.ssdfs;
    let (texels, vertices) = ssdfs.shape();
    let mean = ssdfs.column_mean();
    let mut centred = ssdfs.clone();
    for mut column in centred.column_iter_mut() {
        column -= &mean;
    }
    let rank = rank.min(vertices.saturating_sub(1)).min(texels);
    let width = (rank + OVERSAMPLING).min(vertices).min(texels);
    let mut state = 0x9e37_79b9_7f4a_7c15_u64;
    let mut subspace = DMatrix::from_fn(vertices, width, |_, _| {
        state = state
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1);
        (state >> 40) as f32 / (1u64 << 23) as f32 - 1.0
    });
    // Products with an explicit transpose run at the speed of a blocked kernel.
    let transposed = centred.transpose();
    let mut range = &centred * &subspace;
    for _ in 0..ITERATIONS {
        subspace = &transposed * range.qr().q();
        range = &centred * subspace.qr().q();
    }
    let orthonormal = range.qr().q();
    // Rotate the subspace to principal axes: eigenvectors of a small symmetric matrix.
    let coordinates = orthonormal.transpose() * &centred;
    let covariance = (&coordinates * coordinates.transpose()).cast::<f64>();
    let (axes, lengths) = principal_axes(covariance);
    let rank = rank.min(axes.ncols());
    let rotation = axes.columns(0, rank).into_owned().cast::<f32>();
    let components = &orthonormal * &rotation;
    let mut values = DMatrix::zeros(texels, rank + 1);
    values.column_mut(0).copy_from(&mean);
    values.columns_mut(1, rank).copy_from(&components);
    let projections = rotation.tr_mul(&coordinates);
    let spread = lengths[..rank].iter().map(|length| *length as f32);
    let amplitudes = std::iter::once(1.0)
        .chain(spread.map(|length| length / (vertices as f32).sqrt()))
        .collect();
    Basis {
        images: Images { values, amplitudes },
        projections,
    }
}

/// Fits the first `channels` images to the samples anew, with their weights: principal
/// components spend most of their variance where an error costs nothing. Returns the
/// coefficients that the images go with, too: one row per image, one column per vertex.
pub fn reweight(
    fitted: &Fitted,
    basis: &Basis,
    channels: usize,
    rounds: usize,
) -> (Images, DMatrix<f32>) {
    let channels = channels.min(basis.images.values.ncols());
    let values = basis.images.values.columns(0, channels).into_owned();
    let coefficients = solve_each(&fitted.systems(&values), channels);
    alternate(fitted, coefficients, rounds)
}

/// Alternating least squares from coefficients, which takes the error to a fraction of that
/// of principal components in a few rounds: of images, then, before the next round, of
/// coefficients.
pub fn alternate(
    fitted: &Fitted,
    mut coefficients: DMatrix<f32>,
    rounds: usize,
) -> (Images, DMatrix<f32>) {
    let channels = coefficients.nrows();
    let mut values = DMatrix::zeros(fitted.samples.ssdfs.nrows(), channels);
    let (weights, weighted) = (fitted.weights.transpose(), fitted.weighted.transpose());
    for round in 0..rounds {
        if round > 0 {
            coefficients = solve_each(&fitted.systems(&values), channels);
        }
        let systems = normal_equations(&coefficients, &weights, &weighted);
        let images = solve_each(&systems, channels);
        for (texel, image) in fitted.texels.iter().zip(images.column_iter()) {
            values.row_mut(*texel).copy_from(&image.transpose());
        }
    }
    fitted.fill(&coefficients, &mut values);
    principal(&values, &coefficients)
}

impl Fitted<'_> {
    /// Normal equations of every vertex for its coefficients of images.
    fn systems(&self, images: &DMatrix<f32>) -> DMatrix<f32> {
        let factors = images.select_rows(&self.texels).transpose();
        normal_equations(&factors, &self.weights, &self.weighted)
    }

    /// Fits the texels left out to coefficients, without weights.
    fn fill(&self, coefficients: &DMatrix<f32>, images: &mut DMatrix<f32>) {
        let mut left = vec![true; images.nrows()];
        self.texels.iter().for_each(|&texel| left[texel] = false);
        let rest: Vec<usize> = (0..left.len()).filter(|&texel| left[texel]).collect();
        let channels = coefficients.nrows();
        let transposed = coefficients.transpose();
        let mut normal = (coefficients * &transposed).cast::<f64>();
        let ridge = 1e-7 * normal.trace() / channels as f64 + f64::MIN_POSITIVE;
        normal += DMatrix::identity(channels, channels) * ridge;
        let right = (self.samples.ssdfs.select_rows(&rest) * transposed).transpose();
        if let Some(factor) = normal.cholesky() {
            let found = factor.solve(&right.cast::<f64>()).cast::<f32>();
            for (texel, image) in rest.into_iter().zip(found.column_iter()) {
                images.row_mut(texel).copy_from(&image.transpose());
            }
        }
    }
}

/// The same products of images and coefficients by orthonormal images, by falling mean square
/// of their coefficients. Those that add nothing are left out: rounded, they would be noise
/// that large coefficients fit.
fn principal(images: &DMatrix<f32>, coefficients: &DMatrix<f32>) -> (Images, DMatrix<f32>) {
    let vertices = coefficients.ncols() as f64;
    let factors = images.clone().cast::<f64>();
    let (axes, lengths) = principal_axes(factors.tr_mul(&factors));
    let mut to_orthonormal = axes.transpose();
    let mut from_orthonormal = axes;
    for (i, length) in lengths.into_iter().enumerate() {
        to_orthonormal.row_mut(i).scale_mut(length);
        from_orthonormal.column_mut(i).scale_mut(1.0 / length);
    }
    let coordinates = to_orthonormal * coefficients.clone().cast::<f64>();
    let (rotation, amplitudes) = principal_axes(&coordinates * coordinates.transpose() / vertices);
    // Without an image, lengths are next to nothing: their inverses fit no `f32`.
    let values = (factors * (from_orthonormal * &rotation)).cast::<f32>();
    let amplitudes = amplitudes.into_iter().map(|length| length as f32).collect();
    let coefficients = rotation.tr_mul(&coordinates).cast::<f32>();
    (Images { values, amplitudes }, coefficients)
}

/// Principal axes of a covariance, one per column, and the root mean squares along them, by
/// falling length; those without length but for rounding are left out.
fn principal_axes(covariance: DMatrix<f64>) -> (DMatrix<f64>, Vec<f64>) {
    let eigen = covariance.symmetric_eigen();
    let mut order: Vec<usize> = (0..eigen.eigenvalues.len()).collect();
    order.sort_by(|&a, &b| {
        eigen.eigenvalues[b]
            .total_cmp(&eigen.eigenvalues[a])
            .then(a.cmp(&b))
    });
    let largest = order.first().map_or(0.0, |&i| eigen.eigenvalues[i]);
    // Never empty: there is always something to store.
    let count = (order.iter())
        .take_while(|&&i| eigen.eigenvalues[i] > NOISE * NOISE * largest)
        .count()
        .max(1);
    order.truncate(count);
    let lengths = (order.iter())
        .map(|&i| eigen.eigenvalues[i].max(f64::MIN_POSITIVE).sqrt())
        .collect();
    (eigen.eigenvectors.select_columns(&order), lengths)
}

/// Normal equations for factors of `factors`, one column per equation, with `weights` and
/// right sides `weighted`, one row per equation. One column per system: the upper triangle
/// of its matrix by columns, then its right side.
fn normal_equations(
    factors: &DMatrix<f32>,
    weights: &DMatrix<f32>,
    weighted: &DMatrix<f32>,
) -> DMatrix<f32> {
    let channels = factors.nrows();
    let pairs = channels * (channels + 1) / 2;
    // A normal matrix is a weighted sum of products of factors.
    let mut products = DMatrix::zeros(pairs, factors.ncols());
    for (mut products, factors) in products.column_iter_mut().zip(factors.column_iter()) {
        let pair = |j: usize| (0..=j).map(move |i| (i, j));
        for (product, (i, j)) in products.iter_mut().zip((0..channels).flat_map(pair)) {
            *product = factors[i] * factors[j];
        }
    }
    let mut systems = DMatrix::zeros(pairs + channels, weights.ncols());
    systems.rows_mut(0, pairs).copy_from(&(products * weights));
    systems
        .rows_mut(pairs, channels)
        .copy_from(&(factors * weighted));
    systems
}

/// SSDFs whose errors are summed in one product of matrices.
const BLOCK_VERTICES: usize = 512;
/// Sums that are formed side by side.
const LANES: usize = 16;

/// Quantises images and fits coefficients to them. Rounding takes its part of `max_error`,
/// the root mean square that [`Compressed::error`] may have, radians.
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
        let found = &decoded * values;
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

/// Solves packed systems, one per column.
fn solve_each(systems: &DMatrix<f32>, channels: usize) -> DMatrix<f32> {
    let mut solutions = DMatrix::zeros(channels, systems.ncols());
    for (mut solution, system) in solutions.column_iter_mut().zip(systems.column_iter()) {
        solution.copy_from(&solve(system.as_slice(), channels));
    }
    solutions
}

/// Solves a packed system.
fn solve(system: &[f32], channels: usize) -> DVector<f32> {
    let (packed, right) = system.split_at(channels * (channels + 1) / 2);
    let mut normal = DMatrix::from_fn(channels, channels, |i, j| {
        let (i, j) = (i.min(j), i.max(j));
        f64::from(packed[j * (j + 1) / 2 + i])
    });
    // Images that quantise to nothing must not make the system singular.
    let ridge = 1e-7 * normal.trace() / channels as f64 + f64::MIN_POSITIVE;
    for i in 0..channels {
        normal[(i, i)] += ridge;
    }
    let right = DVector::from_iterator(channels, right.iter().map(|&r| f64::from(r)));
    normal
        .cholesky()
        .map_or_else(|| DVector::zeros(channels), |factor| factor.solve(&right))
        .cast::<f32>()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// SSDFs of caps that drift over a small patch, clamped: smooth but not low-rank.
    fn drifting_caps(vertices: usize) -> Samples {
        let n = 16;
        let ssdfs = DMatrix::from_fn(n * n, vertices, |texel, vertex| {
            let (x, y) = ((texel % n) as f32 / n as f32, (texel / n) as f32 / n as f32);
            let t = vertex as f32 / vertices as f32;
            let distance = ((x - 0.3 - 0.3 * t).powi(2) + (y - 0.5 + 0.2 * t * t).powi(2)).sqrt();
            (2.0 * (distance - 0.2)).clamp(-0.5, 0.5)
        });
        samples(ssdfs)
    }

    /// At vertices whose normals point up.
    fn samples(ssdfs: DMatrix<f32>) -> Samples {
        let up = Normal {
            direction: Vec3::Y,
            tilt: 0.0,
        };
        let weighting = Weighting::new(ssdfs.nrows().isqrt() as u32);
        let normals = vec![up; ssdfs.ncols()];
        Samples::new(ssdfs, &normals, &weighting)
    }

    #[test]
    fn a_wall_off_by_an_angle_costs_that_angle() {
        for (resolution, off) in [(64, 0.01f32), (64, -0.003), (32, 0.01)] {
            let directions = Directions::new(resolution);
            let wall = |off: f32| {
                let distances = directions.as_slice().iter().map(|d| d.x.asin() + off);
                DMatrix::from_iterator(directions.as_slice().len(), 1, distances)
            };
            let exact = samples(wall(0.0));
            let squared: f32 = (wall(off) - &exact.ssdfs)
                .component_mul(&(wall(off) - &exact.ssdfs))
                .component_mul(&exact.weights)
                .sum();
            assert!((squared.sqrt() - off.abs()).abs() < 1e-4, "{squared}");
        }
    }

    #[test]
    fn displacements_count_until_a_light_is_passed() {
        let weighting = Weighting::new(64);
        let wall = |off: f32| -> Vec<f32> {
            let directions = weighting.directions.as_slice().iter();
            directions
                .map(|d| (d.x.asin() + off).clamp(-0.5, 0.5))
                .collect()
        };
        let up = Normal {
            direction: Vec3::Y,
            tilt: 0.0,
        };
        let displacement = |off: f32| {
            weighting
                .squared_displacement(&wall(off), &wall(0.0), up)
                .sqrt()
        };
        for off in [-0.01f32, 0.003, 0.01] {
            assert!((displacement(off) / off.abs() - 1.0).abs() < 0.02, "{off}");
        }
        // An area, which is what is left of a displacement of several lights' widths, grows
        // with its square root.
        let growth = displacement(0.4) / displacement(0.2);
        assert!((1.3..1.7).contains(&growth), "{growth}");
    }

    #[test]
    fn boundaries_below_the_horizon_cost_next_to_nothing() {
        let weighting = Weighting::new(64);
        let floor: Vec<f32> = (weighting.directions.as_slice().iter())
            .map(|direction| direction.y.asin() + 0.1)
            .collect();
        let cost = |direction: Vec3, tilt: f32| {
            let mut weights = vec![0.0; floor.len()];
            weighting.weigh(&floor, Normal { direction, tilt }, &mut weights);
            weights.iter().sum::<f32>()
        };
        let (up, down) = (cost(Vec3::Y, 0.0), cost(Vec3::NEG_Y, 0.0));
        assert!(up < 0.2 && up < cost(Vec3::Y, 0.3), "{up}");
        assert!(cost(Vec3::X, 0.0) > 0.8, "{down}");
    }

    #[test]
    fn components_are_orthonormal_and_ordered() {
        let ssdfs = drifting_caps(50);
        let basis = analyse(&ssdfs, 8);
        let components = basis.images.values.columns(1, 8);
        let gram = components.tr_mul(&components);
        // Single-precision orthogonalisation of a few hundred texels.
        assert!((gram - DMatrix::identity(8, 8)).amax() < 1e-4);
        let variances: Vec<f32> = basis
            .projections
            .row_iter()
            .map(|row| row.norm_squared())
            .collect();
        assert!(
            variances.windows(2).all(|pair| pair[0] >= pair[1]),
            "{variances:?}"
        );
    }

    #[test]
    fn error_falls_with_rank() {
        let ssdfs = drifting_caps(60);
        let basis = analyse(&ssdfs, 15);
        let errors = [1, 4, 8, 12, 16].map(|k| {
            let (images, _) = reweight(&ssdfs.fitted(), &basis, k, 3);
            encode(&ssdfs.fitted(), &images, 1e-4).error()
        });
        // Beyond 8, the caps are as good as their images' eight bits: measured within 0.4 %.
        let falls = errors[..3].windows(2).all(|pair| pair[1] < pair[0]);
        let stays = errors[2..].windows(2).all(|pair| pair[1] < 1.005 * pair[0]);
        assert!(falls && stays, "{errors:?}");
    }

    #[test]
    fn reweighting_lowers_the_error_near_the_boundary() {
        let ssdfs = drifting_caps(60);
        for channels in [2, 4] {
            let basis = analyse(&ssdfs, channels - 1);
            let error = |images: &Images| {
                let compressed = encode(&ssdfs.fitted(), images, 1e-4);
                compressed.error()
            };
            let (before, after) = (
                error(&basis.images),
                error(&reweight(&ssdfs.fitted(), &basis, channels, 3).0),
            );
            // These caps are so smooth that quantisation bounds the gain.
            assert!(
                after < 0.95 * before,
                "{channels}: {after}, {before} before"
            );
        }
    }

    #[test]
    fn a_set_of_low_rank_is_stored_to_quantisation() {
        let ssdfs = DMatrix::from_fn(256, 40, |texel, vertex| {
            let (a, b) = ((texel as f32 * 0.1).sin(), (texel as f32 * 0.07).cos());
            0.2 * a + 0.1 * b * (vertex as f32 * 0.3).sin()
        });
        let ssdfs = samples(ssdfs);
        let compressed = encode(&ssdfs.fitted(), &analyse(&ssdfs, 3).images, 1e-4);
        // 8-bit steps of images whose largest values are 0.2 and 0.1 rad, half a step off.
        assert!(
            compressed.error() < 0.3 / 127.0 / 2.0,
            "{}",
            compressed.error()
        );
    }

    #[test]
    fn rounding_takes_its_part_of_the_error() {
        let ssdfs = drifting_caps(60);
        let fitted = ssdfs.fitted();
        let (images, _) = reweight(&fitted, &analyse(&ssdfs, 15), 16, 3);
        let fine = encode(&fitted, &images, 1e-5).error();
        for max_error in [4.0 * fine, 10.0 * fine] {
            let compressed = encode(&fitted, &images, max_error);
            let added = (compressed.error().powi(2) - fine.powi(2)).max(0.0);
            assert!(
                added < 0.1 * max_error.powi(2),
                "{added} for {max_error}, {fine} without"
            );
            let bits = |compressed: &Compressed| {
                let largest = compressed.coefficients.iter().map(|c| c.unsigned_abs());
                largest.max().unwrap_or(0).ilog2()
            };
            assert!(bits(&compressed) < 13, "coarse coefficients are small");
        }
    }

    /// A floor that sees half of every direction and nothing else, as its vertices tell it.
    #[test]
    fn a_flat_region_takes_one_image() {
        let directions = Directions::new(64);
        let mut state = 1u32;
        let ssdfs = DMatrix::from_fn(64 * 64, 300, |texel, _| {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            let rounding = 1e-6 * (state >> 8) as f32 / (1 << 24) as f32;
            directions.as_slice()[texel].y.asin().clamp(-0.5, 0.5) + rounding
        });
        let ssdfs = samples(ssdfs);
        let fitted = ssdfs.fitted();
        for channels in [4, 8, 16] {
            let basis = analyse(&ssdfs, channels - 1);
            let (_, coefficients) = reweight(&fitted, &basis, channels, 1);
            let (images, _) = alternate(&fitted, coefficients, 3);
            assert_eq!(images.values.ncols(), 1);
            let error = encode(&fitted, &images, 0.0025).error();
            assert!(error < 0.0025, "{channels}: {error}");
        }
    }

    #[test]
    fn equal_and_single_columns_compress() {
        for (vertices, value) in [(1, 0.5f32), (7, 0.5), (3, -0.5), (2, 0.0)] {
            let ssdfs = samples(DMatrix::from_element(64, vertices, value));
            let fitted = ssdfs.fitted();
            let basis = analyse(&ssdfs, 7);
            let (images, _) = reweight(&fitted, &basis, 8, 3);
            for images in [&basis.images, &images] {
                assert!(images.values.iter().all(|value| value.is_finite()));
                let compressed = encode(&fitted, images, 1e-4);
                assert!(compressed.error() < 1e-4, "{vertices} columns of {value}");
            }
        }
    }
}
