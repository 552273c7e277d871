//! SSDFs of a cluster -> a mean, basis images and coefficients, quantised as stored.
//!
//! Principal component analysis of the cluster's clamped SSDFs (Sloan et al. 2003; Wang et
//! al. 2013) finds a basis, and weighted least squares the one that is stored. The basis is
//! quantised first; each vertex's coefficients are
//! then the weighted least-squares fit to the quantised basis, so that rounding of the
//! basis is compensated as far as the basis allows and the error near the visibility
//! boundary, where alone an SSDF shades, counts most.

use nalgebra::{DMatrix, DVector};
use relight_format::CHANNELS_PER_TILE;

/// Half-width of the error weight about the visibility boundary, radians: the width of the
/// lobes that resolve the boundary, and of the reported boundary error.
pub const BOUNDARY_WIDTH: f32 = 0.1;
/// Weight of texels far from the boundary, which only guide the steps of sphere tracing.
const FAR_WEIGHT: f32 = 0.01;
/// Subspace iterations; four separate the spectrum of SSDFs to well below quantisation.
const ITERATIONS: usize = 4;
/// Rounds of reweighting: further ones gain 3 % each.
const ROUNDS: usize = 2;
/// Extra vectors in the subspace iteration, to converge the last ones kept.
const OVERSAMPLING: usize = 6;

/// Squared error sums of a compressed set, for root mean squares over many sets.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ErrorSums {
    /// Σ (stored − exact)² over all texels, radians².
    pub all: f64,
    /// Number of texels summed in `all`.
    pub all_count: u64,
    /// The same over texels within [`BOUNDARY_WIDTH`] of the boundary.
    pub boundary: f64,
    /// Number of texels summed in `boundary`.
    pub boundary_count: u64,
}

impl ErrorSums {
    /// Adds another set's sums.
    pub fn add(&mut self, other: &Self) {
        self.all += other.all;
        self.all_count += other.all_count;
        self.boundary += other.boundary;
        self.boundary_count += other.boundary_count;
    }

    /// Root mean square over all texels, radians.
    pub fn rms(&self) -> f32 {
        (self.all / self.all_count.max(1) as f64).sqrt() as f32
    }

    /// Root mean square over texels near the boundary, radians.
    pub fn boundary_rms(&self) -> f32 {
        (self.boundary / self.boundary_count.max(1) as f64).sqrt() as f32
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
    /// Stored minus exact.
    pub error: ErrorSums,
}

/// Mean and leading principal components of a set of SSDFs.
pub struct Basis {
    /// Column 0 is the mean; the others are orthonormal, by falling variance. One row per
    /// texel.
    pub images: DMatrix<f32>,
    /// Projections of the centred SSDFs: one row per component (without the mean), one
    /// column per vertex.
    pub projections: DMatrix<f32>,
}

/// Principal component analysis of `ssdfs` (one row per texel, one column per vertex):
/// the mean and at most `rank` components.
///
/// Randomised subspace iteration (Halko, Martinsson & Tropp 2011) from a fixed seed.
pub fn analyse(ssdfs: &DMatrix<f32>, rank: usize) -> Basis {
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
    let eigen = covariance.symmetric_eigen();
    let mut order: Vec<usize> = (0..eigen.eigenvalues.len()).collect();
    order.sort_by(|&a, &b| {
        eigen.eigenvalues[b]
            .total_cmp(&eigen.eigenvalues[a])
            .then(a.cmp(&b))
    });
    let rotation = DMatrix::from_fn(order.len(), rank, |row, column| {
        eigen.eigenvectors[(row, order[column])] as f32
    });
    let components = &orthonormal * &rotation;
    let mut images = DMatrix::zeros(texels, rank + 1);
    images.column_mut(0).copy_from(&mean);
    images.columns_mut(1, rank).copy_from(&components);
    Basis {
        images,
        projections: rotation.transpose() * &coordinates,
    }
}

/// Fits the first `channels` images to `ssdfs` anew, with the weights that count when
/// coefficients are fitted: principal components spend most of their variance far from the
/// boundary, where an error costs nothing. Alternating least squares from the principal
/// components, which takes the error near the boundary to about 0.6 of theirs.
pub fn reweight(ssdfs: &DMatrix<f32>, basis: &Basis, channels: usize) -> DMatrix<f32> {
    let (texels, vertices) = ssdfs.shape();
    let channels = channels.min(basis.images.ncols());
    let mut images = basis.images.columns(0, channels).into_owned();
    let pairs = channels * (channels + 1) / 2;
    let weights = ssdfs.map(weight);
    let weighted = weights.component_mul(ssdfs);
    let (weights, weighted) = (weights.transpose(), weighted.transpose());
    for _ in 0..ROUNDS {
        let encoder = Encoder::new(ssdfs, &images);
        let mut fitted = DMatrix::zeros(channels, vertices);
        for (mut out, system) in fitted.column_iter_mut().zip(encoder.systems.column_iter()) {
            out.copy_from(&solve(system.as_slice(), channels, channels));
        }
        let mut products = DMatrix::zeros(pairs, vertices);
        for (mut products, fitted) in products.column_iter_mut().zip(fitted.column_iter()) {
            let pair = |j: usize| (0..=j).map(move |i| (i, j));
            for (product, (i, j)) in products.iter_mut().zip((0..channels).flat_map(pair)) {
                *product = fitted[i] * fitted[j];
            }
        }
        let mut systems = DMatrix::zeros(pairs + channels, texels);
        systems
            .rows_mut(0, pairs)
            .copy_from(&(&products * &weights));
        systems
            .rows_mut(pairs, channels)
            .copy_from(&(&fitted * &weighted));
        for (texel, system) in systems.column_iter().enumerate() {
            let image = solve(system.as_slice(), channels, channels);
            images.row_mut(texel).copy_from(&image.transpose());
        }
    }
    images
}

/// Weight of an error where the SSDF is `distance`.
fn weight(distance: f32) -> f32 {
    FAR_WEIGHT + 1.0 / (1.0 + (distance / BOUNDARY_WIDTH).powi(4))
}

/// SSDFs that are fitted in one product of matrices.
const BLOCK_VERTICES: usize = 512;

/// A quantised basis and the least-squares systems of every SSDF in it. Leading parts of
/// the systems belong to fewer images, so one set serves every number of tiles.
pub struct Encoder<'a> {
    ssdfs: &'a DMatrix<f32>,
    /// One column per image, quantised.
    quantised: DMatrix<i8>,
    /// The same, decoded.
    decoded: DMatrix<f32>,
    /// Upper triangle of the normal matrix by columns, then the right side: one column per
    /// vertex.
    systems: DMatrix<f32>,
}

impl<'a> Encoder<'a> {
    /// Quantises `images`, one per column, and forms the weighted normal equations of every
    /// column of `ssdfs`.
    pub fn new(ssdfs: &'a DMatrix<f32>, images: &DMatrix<f32>) -> Self {
        let (texels, channels) = images.shape();
        let mut quantised = DMatrix::zeros(texels, channels);
        for (mut out, image) in quantised.column_iter_mut().zip(images.column_iter()) {
            let largest = image.amax();
            let scale = if largest > 0.0 { 127.0 / largest } else { 0.0 };
            out.iter_mut()
                .zip(&image)
                .for_each(|(out, value)| *out = (value * scale).round() as i8);
        }
        let decoded = quantised.map(|value: i8| f32::from(value) / 127.0);
        // Products of images, one row each: a normal matrix is their weighted sum.
        let pairs = channels * (channels + 1) / 2;
        let mut products = DMatrix::zeros(texels, pairs);
        let mut row = 0;
        for j in 0..channels {
            for i in 0..=j {
                let product = decoded.column(i).component_mul(&decoded.column(j));
                products.column_mut(row).copy_from(&product);
                row += 1;
            }
        }
        let (products, images) = (products.transpose(), decoded.transpose());
        let mut systems = DMatrix::zeros(pairs + channels, ssdfs.ncols());
        for first in (0..ssdfs.ncols()).step_by(BLOCK_VERTICES) {
            let count = BLOCK_VERTICES.min(ssdfs.ncols() - first);
            let block = ssdfs.columns(first, count);
            let weights = block.map(weight);
            let weighted = weights.component_mul(&block);
            systems
                .view_mut((0, first), (pairs, count))
                .copy_from(&(&products * weights));
            systems
                .view_mut((pairs, first), (channels, count))
                .copy_from(&(&images * weighted));
        }
        Self {
            ssdfs,
            quantised,
            decoded,
            systems,
        }
    }

    /// Fits and quantises the coefficients of the first `channels` images.
    pub fn encode(&self, channels: usize) -> Compressed {
        let (texels, vertices) = self.ssdfs.shape();
        let channels = channels.min(self.quantised.ncols());
        let tiles = channels.div_ceil(CHANNELS_PER_TILE);
        let stored = tiles * CHANNELS_PER_TILE;
        let mut fitted = DMatrix::zeros(channels, vertices);
        for (mut out, system) in fitted.column_iter_mut().zip(self.systems.column_iter()) {
            out.copy_from(&solve(system.as_slice(), channels, self.quantised.ncols()));
        }
        let coefficient_scale = fitted.amax();
        let to_integer = if coefficient_scale > 0.0 {
            32767.0 / coefficient_scale
        } else {
            0.0
        };
        let integers = fitted.map(|value| (value * to_integer).round() as i16);
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
        for (channel, image) in self.quantised.column_iter().take(channels).enumerate() {
            let (tile, lane) = (channel / CHANNELS_PER_TILE, channel % CHANNELS_PER_TILE);
            let out =
                basis[tile * texels * CHANNELS_PER_TILE..].chunks_exact_mut(CHANNELS_PER_TILE);
            out.zip(&image)
                .for_each(|(texel, value)| texel[lane] = *value);
        }
        let images = self.decoded.columns(0, channels);
        let mut error = ErrorSums::default();
        for first in (0..vertices).step_by(BLOCK_VERTICES) {
            let count = BLOCK_VERTICES.min(vertices - first);
            let values = integers
                .columns(first, count)
                .map(|value| f32::from(value) / 32767.0 * coefficient_scale);
            let found = images * values;
            for (found, exact) in found.iter().zip(&self.ssdfs.columns(first, count)) {
                let squared = f64::from((found - exact).powi(2));
                error.all += squared;
                if exact.abs() < BOUNDARY_WIDTH {
                    error.boundary += squared;
                    error.boundary_count += 1;
                }
            }
        }
        error.all_count = (texels * vertices) as u64;
        Compressed {
            tiles: tiles as u32,
            coefficient_scale,
            coefficients,
            basis,
            error,
        }
    }
}

/// Solves the leading `channels` × `channels` part of a packed system of `all` channels.
fn solve(system: &[f32], channels: usize, all: usize) -> DVector<f32> {
    let (packed, right) = system.split_at(all * (all + 1) / 2);
    let mut normal = DMatrix::from_fn(channels, channels, |i, j| {
        let (i, j) = (i.min(j), i.max(j));
        f64::from(packed[j * (j + 1) / 2 + i])
    });
    // Images that quantise to nothing must not make the system singular.
    let ridge = 1e-7 * normal.trace() / channels as f64 + f64::MIN_POSITIVE;
    for i in 0..channels {
        normal[(i, i)] += ridge;
    }
    let right = DVector::from_iterator(channels, right[..channels].iter().map(|&r| f64::from(r)));
    normal
        .cholesky()
        .map_or_else(|| DVector::zeros(channels), |factor| factor.solve(&right))
        .cast::<f32>()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// SSDFs of caps that drift over a small patch, clamped: smooth but not low-rank.
    fn drifting_caps(vertices: usize) -> DMatrix<f32> {
        let n = 16;
        DMatrix::from_fn(n * n, vertices, |texel, vertex| {
            let (x, y) = ((texel % n) as f32 / n as f32, (texel / n) as f32 / n as f32);
            let t = vertex as f32 / vertices as f32;
            let distance = ((x - 0.3 - 0.3 * t).powi(2) + (y - 0.5 + 0.2 * t * t).powi(2)).sqrt();
            (2.0 * (distance - 0.2)).clamp(-0.5, 0.5)
        })
    }

    #[test]
    fn components_are_orthonormal_and_ordered() {
        let ssdfs = drifting_caps(50);
        let basis = analyse(&ssdfs, 8);
        let components = basis.images.columns(1, 8);
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
        let encoder = Encoder::new(&ssdfs, &basis.images);
        let errors = [1, 4, 8, 12, 16].map(|k| encoder.encode(k).error.boundary_rms());
        assert!(
            errors.windows(2).all(|pair| pair[1] < pair[0]),
            "{errors:?}"
        );
    }

    #[test]
    fn reweighting_lowers_the_error_near_the_boundary() {
        let ssdfs = drifting_caps(60);
        for channels in [4, 8] {
            let basis = analyse(&ssdfs, channels - 1);
            let error = |images: &DMatrix<f32>| {
                let compressed = Encoder::new(&ssdfs, images).encode(channels);
                compressed.error.boundary_rms()
            };
            let (before, after) = (
                error(&basis.images),
                error(&reweight(&ssdfs, &basis, channels)),
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
        let compressed = Encoder::new(&ssdfs, &analyse(&ssdfs, 3).images).encode(4);
        // 8-bit steps of images whose largest values are 0.2 and 0.1 rad, half a step off.
        assert!(
            compressed.error.rms() < 0.3 / 127.0 / 2.0,
            "{}",
            compressed.error.rms()
        );
    }

    #[test]
    fn equal_and_single_columns_compress() {
        for (vertices, value) in [(1, 0.5f32), (7, 0.5), (3, -0.5), (2, 0.0)] {
            let ssdfs = DMatrix::from_element(64, vertices, value);
            let compressed = Encoder::new(&ssdfs, &analyse(&ssdfs, 7).images).encode(8);
            assert!(
                compressed.error.rms() < 1e-4,
                "{vertices} columns of {value}"
            );
        }
    }
}
