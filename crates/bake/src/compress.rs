//! SSDFs of a cluster -> a mean, basis images and coefficients, quantised as stored.
//!
//! Principal component analysis of the cluster's clamped SSDFs (Sloan et al. 2003; Wang et
//! al. 2013) finds the basis. The basis is quantised first; each vertex's coefficients are
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
    let mut range = &centred * &subspace;
    for _ in 0..ITERATIONS {
        let orthonormal = range.qr().q();
        subspace = centred.tr_mul(&orthonormal);
        range = &centred * subspace.qr().q();
    }
    let orthonormal = range.qr().q();
    // Rotate the subspace to principal axes: eigenvectors of a small symmetric matrix.
    let coordinates = orthonormal.tr_mul(&centred);
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
        projections: rotation.tr_mul(&coordinates),
    }
}

/// Quantises the first `channels` images of `basis` and fits the coefficients of every
/// column of `ssdfs` to them.
pub fn encode(ssdfs: &DMatrix<f32>, basis: &Basis, channels: usize) -> Compressed {
    let (texels, vertices) = ssdfs.shape();
    let channels = channels.min(basis.images.ncols());
    let tiles = channels.div_ceil(CHANNELS_PER_TILE);
    let stored = tiles * CHANNELS_PER_TILE;
    let mut quantised = vec![0i8; texels * stored];
    // Decoded basis, the channels of a texel side by side.
    let mut decoded = vec![0f32; texels * channels];
    for channel in 0..channels {
        let image = basis.images.column(channel);
        let largest = image.amax();
        let scale = if largest > 0.0 { 127.0 / largest } else { 0.0 };
        let (tile, lane) = (channel / CHANNELS_PER_TILE, channel % CHANNELS_PER_TILE);
        for (texel, value) in image.iter().enumerate() {
            let value = (value * scale).round() as i8;
            quantised[(tile * texels + texel) * CHANNELS_PER_TILE + lane] = value;
            decoded[texel * channels + channel] = f32::from(value) / 127.0;
        }
    }
    let fitted: Vec<DVector<f32>> = ssdfs
        .column_iter()
        .map(|column| fit_coefficients(column.as_slice(), &decoded, channels))
        .collect();
    let coefficient_scale = fitted.iter().map(|c| c.amax()).fold(0.0, f32::max);
    let to_integer = if coefficient_scale > 0.0 {
        32767.0 / coefficient_scale
    } else {
        0.0
    };
    let mut coefficients = vec![0i16; vertices * stored];
    let mut error = ErrorSums::default();
    for (vertex, fit) in fitted.iter().enumerate() {
        let out = &mut coefficients[vertex * stored..][..channels];
        for (out, value) in out.iter_mut().zip(fit.iter()) {
            *out = (value * to_integer).round() as i16;
        }
        let values: Vec<f32> = out
            .iter()
            .map(|&c| f32::from(c) / 32767.0 * coefficient_scale)
            .collect();
        for (exact, row) in ssdfs
            .column(vertex)
            .iter()
            .zip(decoded.chunks_exact(channels))
        {
            let found: f32 = row.iter().zip(&values).map(|(a, b)| a * b).sum();
            let squared = f64::from((found - exact).powi(2));
            error.all += squared;
            error.all_count += 1;
            if exact.abs() < BOUNDARY_WIDTH {
                error.boundary += squared;
                error.boundary_count += 1;
            }
        }
    }
    Compressed {
        tiles: tiles as u32,
        coefficient_scale,
        coefficients,
        basis: quantised,
        error,
    }
}

/// Weighted least squares of one SSDF in the basis, by normal equations.
fn fit_coefficients(ssdf: &[f32], basis: &[f32], channels: usize) -> DVector<f32> {
    let mut normal = vec![0f32; channels * channels];
    let mut right = vec![0f32; channels];
    for (&distance, row) in ssdf.iter().zip(basis.chunks_exact(channels)) {
        let weight = FAR_WEIGHT + 1.0 / (1.0 + (distance / BOUNDARY_WIDTH).powi(4));
        for (i, &value) in row.iter().enumerate() {
            let weighted = weight * value;
            right[i] += weighted * distance;
            for (sum, other) in normal[i * channels..].iter_mut().zip(row) {
                *sum += weighted * other;
            }
        }
    }
    let mut normal = DMatrix::from_row_slice(channels, channels, &normal).cast::<f64>();
    // Images that quantise to nothing must not make the system singular.
    let ridge = 1e-7 * normal.trace() / channels as f64 + f64::MIN_POSITIVE;
    for i in 0..channels {
        normal[(i, i)] += ridge;
    }
    let right = DVector::from_row_slice(&right).cast::<f64>();
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
        let errors: Vec<f32> = [1, 4, 8, 12, 16]
            .map(|k| encode(&ssdfs, &basis, k).error.boundary_rms())
            .to_vec();
        assert!(
            errors.windows(2).all(|pair| pair[1] < pair[0]),
            "{errors:?}"
        );
    }

    #[test]
    fn a_set_of_low_rank_is_stored_to_quantisation() {
        let ssdfs = DMatrix::from_fn(256, 40, |texel, vertex| {
            let (a, b) = ((texel as f32 * 0.1).sin(), (texel as f32 * 0.07).cos());
            0.2 * a + 0.1 * b * (vertex as f32 * 0.3).sin()
        });
        let compressed = encode(&ssdfs, &analyse(&ssdfs, 3), 4);
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
            let compressed = encode(&ssdfs, &analyse(&ssdfs, 7), 8);
            assert!(
                compressed.error.rms() < 1e-4,
                "{vertices} columns of {value}"
            );
        }
    }
}
