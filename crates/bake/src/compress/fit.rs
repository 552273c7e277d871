//! SSDFs -> basis images and coefficients, in floating point.
//!
//! Principal component analysis finds a basis, and alternating weighted least squares the one
//! that is stored.

use nalgebra::DMatrix;

use super::samples::{Fitted, column};
use crate::memory;
use crate::simd::{Panels, both_ways, product, product_of, vectorised, write_product};
use crate::solve::orthonormal;

/// Subspace iterations; two separate the spectrum of SSDFs to well below quantisation.
const ITERATIONS: usize = 2;
/// Lengths of principal axes, in that of the longest, that come from rounding.
const NOISE: f64 = 1e-4;
/// Extra vectors in the subspace iteration, to converge the last ones kept.
const OVERSAMPLING: usize = 6;
/// Systems that are solved side by side.
const SYSTEMS: usize = 8;
/// A number of each of them.
type Each = [f64; SYSTEMS];

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
pub fn analyse(fitted: &Fitted, rank: usize) -> FittedBasis {
    let (texels, vertices) = (fitted.samples.ssdfs.nrows(), fitted.vertices.len());
    let mut mean = vec![0.0; texels];
    for [ssdf, _] in fitted.columns() {
        (mean.iter_mut().zip(ssdf)).for_each(|(mean, distance)| *mean += distance);
    }
    for mean in &mut mean {
        *mean /= vertices as f32;
    }
    let [centred, transposed] = both_ways((texels, vertices), |index, centred| {
        let ssdf = column(&fitted.samples.ssdfs, fitted.vertices[index]);
        for (centred, (distance, mean)) in centred.iter_mut().zip(ssdf.iter().zip(&mean)) {
            *centred = distance - mean;
        }
    });
    let rank = rank.min(vertices.saturating_sub(1)).min(texels);
    let width = (rank + OVERSAMPLING).min(vertices).min(texels);
    let mut state = 0x9e37_79b9_7f4a_7c15_u64;
    let mut subspace = DMatrix::from_fn(vertices, width, |_, _| {
        state = state
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1);
        (state >> 40) as f32 / (1u64 << 23) as f32 - 1.0
    });
    let mut range = product_of(&centred, &subspace);
    for _ in 0..ITERATIONS {
        subspace = product_of(&transposed, &orthonormal(range));
        range = product_of(&centred, &orthonormal(subspace));
    }
    let range = orthonormal(range);
    // Rotate the subspace to principal axes: eigenvectors of a small symmetric matrix.
    let coordinates = product_of(&transposed, &range).transpose();
    drop((centred, transposed));
    let covariance = product(&coordinates, &coordinates.transpose()).cast::<f64>();
    let (axes, lengths) = principal_axes(covariance);
    let rank = rank.min(axes.ncols());
    let rotation = axes.columns(0, rank).into_owned().cast::<f32>();
    let components = product(&range, &rotation);
    let mut values = DMatrix::zeros(texels, rank + 1);
    values.column_mut(0).copy_from_slice(&mean);
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

/// What images fitted to samples with their weights give: principal components spend most of their variance where
/// an error costs nothing.
pub struct Fit {
    /// That the images go with: one row per image, one column per vertex.
    pub coefficients: DMatrix<f32>,
    /// What is off without rounding, root mean square over vertices, radians.
    pub error: f32,
}

/// Fits of more and fewer images to the same samples.
pub struct Fits<'a> {
    fitted: &'a Fitted<'a>,
    images: DMatrix<f32>,
    /// For coefficients of all `images`; those of the first few are among them.
    systems: DMatrix<f32>,
    /// [`Fitted::squares`].
    squares: f64,
}

impl<'a> Fits<'a> {
    /// Of at most so many images.
    pub fn new(fitted: &'a Fitted<'a>, basis: &FittedBasis, channels: usize) -> Self {
        let channels = channels.min(basis.images.values.ncols());
        let images = basis.images.values.columns(0, channels).into_owned();
        let systems = fitted.systems(&images);
        Self {
            fitted,
            images,
            systems,
            squares: fitted.squares,
        }
    }

    /// One round from the first `channels` principal components.
    pub fn fit(&self, channels: usize) -> Fit {
        let fitted = self.fitted;
        let all = self.images.ncols();
        let channels = channels.min(all);
        let (pairs, all_pairs) = (triangle(channels), triangle(all));
        let mut systems = DMatrix::zeros(self.systems.nrows(), pairs + channels);
        systems
            .columns_mut(0, pairs)
            .copy_from(&self.systems.columns(0, pairs));
        systems
            .columns_mut(pairs, channels)
            .copy_from(&self.systems.columns(all_pairs, channels));
        let coefficients = solve_each(&systems, channels);
        let systems = fitted.systems_of_texels(&coefficients);
        let images = solve_each(&systems, channels);
        // Least squares leave the sum of squares less the right sides' products with the solutions.
        let right = systems.columns(triangle(channels), channels);
        let told: f64 = (right.column_iter().zip(images.row_iter()))
            .map(|(right, image)| -> f64 {
                let products = right.iter().zip(image.iter());
                products
                    .map(|(right, value)| f64::from(right * value))
                    .sum()
            })
            .sum();
        let squared = (self.squares - told).max(0.0) / coefficients.ncols() as f64;
        let error = squared.sqrt() as f32;
        let (_, coefficients) = principal(&images.transpose(), &coefficients);
        Fit {
            coefficients,
            error,
        }
    }
}

/// Coefficients that fit the images that fit these best, so many rounds on: alternating least squares takes the
/// error to a fraction of that of principal components in a few.
pub fn alternate(fitted: &Fitted, mut coefficients: DMatrix<f32>, rounds: usize) -> DMatrix<f32> {
    for _ in 0..rounds {
        let images = fitted.images(&coefficients);
        let systems = fitted.systems_of(&images.transpose());
        coefficients = solve_each(&systems, coefficients.nrows());
        memory::keep(systems);
    }
    coefficients
}

/// Images that fit coefficients best, and the coefficients as they go with those.
pub fn images(fitted: &Fitted, coefficients: &DMatrix<f32>) -> (Images, DMatrix<f32>) {
    let texels = fitted.samples.ssdfs.nrows();
    let mut values = DMatrix::zeros(texels, coefficients.nrows());
    let images = fitted.images(coefficients);
    for (texel, image) in fitted.texels.iter().zip(images.column_iter()) {
        values.row_mut(*texel).copy_from(&image.transpose());
    }
    fitted.fill(coefficients, &mut values);
    principal(&values, coefficients)
}

impl Fitted<'_> {
    /// Normal equations of every vertex for its coefficients of images.
    pub(super) fn systems(&self, images: &DMatrix<f32>) -> DMatrix<f32> {
        self.systems_of(&images.select_rows(&self.texels))
    }

    /// The same of images at the fitted texels alone.
    fn systems_of(&self, images: &DMatrix<f32>) -> DMatrix<f32> {
        normal_equations(
            images,
            &self.weights.of_vertices,
            &self.weighted.of_vertices,
        )
    }

    /// Images that fit coefficients best: one row per image, one column per fitted texel.
    fn images(&self, coefficients: &DMatrix<f32>) -> DMatrix<f32> {
        let systems = self.systems_of_texels(coefficients);
        let images = solve_each(&systems, coefficients.nrows());
        memory::keep(systems);
        images
    }

    /// Normal equations of every fitted texel for its value in each image.
    fn systems_of_texels(&self, coefficients: &DMatrix<f32>) -> DMatrix<f32> {
        let factors = coefficients.transpose();
        normal_equations(&factors, &self.weights.of_texels, &self.weighted.of_texels)
    }

    /// Fits the texels left out to coefficients, without weights.
    fn fill(&self, coefficients: &DMatrix<f32>, images: &mut DMatrix<f32>) {
        let mut left = vec![true; images.nrows()];
        self.texels.iter().for_each(|&texel| left[texel] = false);
        let rest: Vec<usize> = (0..left.len()).filter(|&texel| left[texel]).collect();
        let runs: Vec<&[usize]> = rest.chunk_by(|a, b| a + 1 == *b).collect();
        let channels = coefficients.nrows();
        let transposed = coefficients.transpose();
        let mut normal = product(coefficients, &transposed).cast::<f64>();
        let ridge = 1e-7 * normal.trace() / channels as f64 + f64::MIN_POSITIVE;
        normal += DMatrix::identity(channels, channels) * ridge;
        let mut values = memory::room(rest.len() * self.vertices.len());
        for [ssdf, _] in self.columns() {
            let runs = runs.iter().map(|run| &ssdf[run[0]..][..run.len()]);
            runs.for_each(|run| values.extend_from_slice(run));
        }
        let values = DMatrix::from_vec(rest.len(), self.vertices.len(), values);
        let right = product(&values, &transposed).transpose();
        memory::keep(values);
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

/// Pairs of so many, where order does not count.
pub(super) fn triangle(channels: usize) -> usize {
    channels * (channels + 1) / 2
}

/// Normal equations for factors of `factors`, one row per equation. `matrices` are the weights and `right` the right
/// sides of the equations, which have one row per system. One row per system: the upper triangle of its
/// matrix by columns, then its right side.
fn normal_equations(factors: &DMatrix<f32>, matrices: &Panels, right: &Panels) -> DMatrix<f32> {
    let (equations, channels) = factors.shape();
    let pairs = triangle(channels);
    // A normal matrix is a weighted sum of products of factors.
    let mut products = Vec::with_capacity(equations * pairs);
    let factor = |channel: usize| column(factors, channel);
    for j in 0..channels {
        for i in 0..=j {
            products.extend(factor(i).iter().zip(factor(j)).map(|(a, b)| a * b));
        }
    }
    let rows = matrices.rows();
    let mut systems = memory::used(rows * (pairs + channels));
    let (of_matrices, of_right) = systems.split_at_mut(rows * pairs);
    let products = DMatrix::from_vec(equations, pairs, products);
    write_product(matrices, &products, of_matrices);
    write_product(right, factors, of_right);
    DMatrix::from_vec(rows, pairs + channels, systems)
}

/// Solves packed systems, one per row: one solution per column.
pub(super) fn solve_each(systems: &DMatrix<f32>, channels: usize) -> DMatrix<f32> {
    let (count, pairs) = (systems.nrows(), triangle(channels));
    let mut solutions = DMatrix::zeros(channels, count);
    let mut system = vec![[0.0; SYSTEMS]; pairs + channels];
    let solved = solutions
        .as_mut_slice()
        .chunks_mut(SYSTEMS * channels.max(1));
    for (first, solved) in (0..).step_by(SYSTEMS).zip(solved) {
        // Those beyond the last keep the values of others: what they give is not looked at.
        let rows = first..count.min(first + SYSTEMS);
        let columns = systems.as_slice().chunks_exact(count);
        for (all, column) in system.iter_mut().zip(columns) {
            for (number, value) in all.iter_mut().zip(&column[rows.clone()]) {
                *number = f64::from(*value);
            }
        }
        let (normal, right) = system.split_at_mut(pairs);
        vectorised!(
            <'a> normal: &'a mut [Each] = normal, right: &'a mut [Each] = right
            => () { solve(normal, right) }
        );
        for (lane, solved) in solved.chunks_exact_mut(channels).enumerate() {
            for (solved, all) in solved.iter_mut().zip(&system[pairs..]) {
                *solved = all[lane] as f32;
            }
        }
    }
    solutions
}

/// Solves systems by the lower triangles of their matrices, one row after another, with a ridge that images
/// of nothing need (Cholesky). `right` becomes the solutions: zero where a matrix is not positive.
#[inline(always)]
fn solve(normal: &mut [Each], right: &mut [Each]) {
    let channels = right.len();
    let mut trace = [0.0; SYSTEMS];
    for i in 0..channels {
        let diagonal = normal[triangle(i) + i];
        trace = std::array::from_fn(|lane| trace[lane] + diagonal[lane]);
    }
    let ridge: Each =
        std::array::from_fn(|lane| 1e-7 * trace[lane] / channels as f64 + f64::MIN_POSITIVE);
    let mut positive = [true; SYSTEMS];
    for i in 0..channels {
        let (above, this) = normal.split_at_mut(triangle(i));
        for j in 0..i {
            let other = &above[triangle(j)..=triangle(j) + j];
            let rest = less_products(this[j], &this[..j], &other[..j]);
            // The diagonal holds its inverses.
            this[j] = std::array::from_fn(|lane| rest[lane] * other[j][lane]);
        }
        let diagonal: Each = std::array::from_fn(|lane| this[i][lane] + ridge[lane]);
        let rest = less_products(diagonal, &this[..i], &this[..i]);
        for lane in 0..SYSTEMS {
            positive[lane] &= rest[lane] > 0.0;
            this[i][lane] = 1.0 / rest[lane].sqrt();
        }
        let rest = less_products(right[i], &this[..i], &right[..i]);
        right[i] = std::array::from_fn(|lane| rest[lane] * this[i][lane]);
    }
    for i in (0..channels).rev() {
        let mut rest = right[i];
        for j in i + 1..channels {
            let (factor, solution) = (normal[triangle(j) + i], right[j]);
            rest = std::array::from_fn(|lane| rest[lane] - factor[lane] * solution[lane]);
        }
        let inverse = normal[triangle(i) + i];
        right[i] = std::array::from_fn(|lane| rest[lane] * inverse[lane]);
    }
    for solution in right {
        *solution = std::array::from_fn(|lane| if positive[lane] { solution[lane] } else { 0.0 });
    }
}

/// A number less products.
#[inline(always)]
fn less_products(mut rest: Each, a: &[Each], b: &[Each]) -> Each {
    for (a, b) in a.iter().zip(b) {
        rest = std::array::from_fn(|lane| rest[lane] - a[lane] * b[lane]);
    }
    rest
}
