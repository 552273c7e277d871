//! SSDFs -> basis images and coefficients, in floating point.
//!
//! Principal component analysis finds a basis, and alternating weighted least squares the one
//! that is stored.

use nalgebra::{DMatrix, DVector};

use super::samples::{Fitted, Samples};
use crate::simd::product;

/// Subspace iterations; four separate the spectrum of SSDFs to well below quantisation.
const ITERATIONS: usize = 4;
/// Lengths of principal axes, in that of the longest, that come from rounding.
const NOISE: f64 = 1e-4;
/// Extra vectors in the subspace iteration, to converge the last ones kept.
const OVERSAMPLING: usize = 6;

/// Images whose weighted sums are SSDFs.
#[derive(Clone)]
pub struct Images {
    /// One row per texel, one column per image.
    pub values: DMatrix<f32>,
    /// Root mean square of the coefficients of every image.
    pub amplitudes: Vec<f32>,
}

/// Mean and leading principal components of a set of SSDFs.
pub struct FittedBasis {
    /// Column 0 is the mean; the others are orthonormal, by falling variance.
    pub images: Images,
    /// Projections of the centred SSDFs: one row per component (without the mean), one
    /// column per vertex.
    pub projections: DMatrix<f32>,
}

/// Principal component analysis: the mean and at most `rank` components.
///
/// Randomised subspace iteration (Halko, Martinsson & Tropp 2011) from a fixed seed.
pub fn analyse(samples: &Samples, rank: usize) -> FittedBasis {
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
    let transposed = centred.transpose();
    let mut range = product(&centred, &subspace);
    for _ in 0..ITERATIONS {
        subspace = product(&transposed, &range.qr().q());
        range = product(&centred, &subspace.qr().q());
    }
    let orthonormal = range.qr().q();
    // Rotate the subspace to principal axes: eigenvectors of a small symmetric matrix.
    let coordinates = product(&transposed, &orthonormal).transpose();
    let covariance = product(&coordinates, &coordinates.transpose()).cast::<f64>();
    let (axes, lengths) = principal_axes(covariance);
    let rank = rank.min(axes.ncols());
    let rotation = axes.columns(0, rank).into_owned().cast::<f32>();
    let components = product(&orthonormal, &rotation);
    let mut values = DMatrix::zeros(texels, rank + 1);
    values.column_mut(0).copy_from(&mean);
    values.columns_mut(1, rank).copy_from(&components);
    let projections = rotation.tr_mul(&coordinates);
    let spread = lengths[..rank].iter().map(|length| *length as f32);
    let amplitudes = std::iter::once(1.0)
        .chain(spread.map(|length| length / (vertices as f32).sqrt()))
        .collect();
    FittedBasis {
        images: Images { values, amplitudes },
        projections,
    }
}

/// Fits the first `channels` images to the samples anew, with their weights: principal
/// components spend most of their variance where an error costs nothing. Returns the
/// coefficients that the images go with, too: one row per image, one column per vertex.
pub fn reweight(
    fitted: &Fitted,
    basis: &FittedBasis,
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
pub(crate) fn alternate(
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
    pub(super) fn systems(&self, images: &DMatrix<f32>) -> DMatrix<f32> {
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
        let mut normal = product(coefficients, &transposed).cast::<f64>();
        let ridge = 1e-7 * normal.trace() / channels as f64 + f64::MIN_POSITIVE;
        normal += DMatrix::identity(channels, channels) * ridge;
        let right = product(&self.samples.ssdfs.select_rows(&rest), &transposed).transpose();
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
    let coordinates = product(&to_orthonormal, &coefficients.clone().cast::<f64>());
    let covariance = product(&coordinates, &coordinates.transpose()) / vertices;
    let (rotation, amplitudes) = principal_axes(covariance);
    // Without an image, lengths are next to nothing: their inverses fit no `f32`.
    let turned = product(&from_orthonormal, &rotation);
    let values = product(&factors, &turned).cast::<f32>();
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
    systems
        .rows_mut(0, pairs)
        .copy_from(&product(&products, weights));
    systems
        .rows_mut(pairs, channels)
        .copy_from(&product(factors, weighted));
    systems
}

/// Solves packed systems, one per column.
pub(super) fn solve_each(systems: &DMatrix<f32>, channels: usize) -> DMatrix<f32> {
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
