//! Bounced light of a chunk of vertices as a mean, a few components and weights.
//!
//! Principal components by subspace iteration (Halko, Martinsson & Tropp 2011, algorithm 4.4):
//! what is left after two dozen of them is small, or noise of the rays where vertices have few neighbours alike. Vertices on
//! the edge of a chunk, which its neighbours have too, count for more, and so does irradiance along the chunk's normals.

use glam::{Mat3, Vec3};
use nalgebra::{DMatrix, DVector, Matrix3};
use relight_format::MAX_TRANSFER_RANK;

use super::radiosity::hash;
use crate::simd::product;
use crate::solve::orthonormal;

/// A component is stored where it carries at least this part of the bounced light, and of what
/// an open sky gives; both root mean squares over vertices. What is left is little, or noise. The
/// first is larger where radiance is stored too, which has more of both.
const RELATIVE_GAIN: f64 = 0.01;
const RELATIVE_GAIN_OF_RADIANCE: f64 = 0.02;
const SKY_GAIN: f64 = 0.0005;
/// A vertex's squared light counts as at most so many times that of the chunk's middle one.
const BRIGHTEST: f64 = 16.0;
/// Steps of weights are not finer than this part of what an open sky gives, and of the basis
/// than that.
const WEIGHT_STEP: f32 = 0.001;
const BASIS_STEP: f32 = 0.0003;
/// Sum over channels of the squared norm of an open sky's irradiance over π: ∫ cos² over a
/// hemisphere, over π².
const SKY_SQUARED: f64 = 3.0 * 2.0 / (3.0 * std::f64::consts::PI);
/// How much an error at right angles to a normal counts, over one along it: normals in textures differ from those of
/// vertices.
const ASIDE: f32 = 0.1;
/// How much an error counts at a vertex that several chunks have.
const SHARED: f32 = 2.0;
/// Columns that are iterated besides those wanted, and times.
const EXCESS: usize = 4;
const ITERATIONS: usize = 2;
/// Outputs that are irradiance; the others are radiance, which counts π times as much.
const IRRADIANCE_OUTPUTS: usize = 3;

/// Rows that the vertices of a chunk share.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Group {
    /// Components besides the mean.
    pub rank: u32,
    /// As [`relight_format::TransferGroup::outputs`].
    pub outputs: u32,
    /// As [`relight_format::Transfer::scales`].
    pub scales: Vec<f32>,
    /// As [`relight_format::Transfer::basis`].
    pub basis: Vec<i8>,
    /// Sum over vertices of the squared error of what is stored, by [`Metric`].
    pub(crate) squared_error: f64,
    /// Sum over vertices of the squared bounced light, by the same.
    pub squared: f64,
}

/// A chunk's rows and its vertices' weights.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Compressed {
    /// The rows.
    pub group: Group,
    /// Vertex after vertex, one per component.
    pub weights: Vec<i8>,
}

impl Compressed {
    /// The weights of a vertex.
    pub(crate) fn weights_of(&self, vertex: usize) -> &[i8] {
        let rank = self.group.rank as usize;
        &self.weights[vertex * rank..][..rank]
    }
}

/// What belongs to a cluster: its vertices' weights, and the rows where a group begins.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ClusterTransfer {
    /// Rows of this cluster and those after it up to the next with rows.
    pub group: Option<Group>,
    /// Vertex after vertex, one per component.
    pub weights: Vec<i8>,
}

/// Vertices whose light is compressed together.
pub(crate) struct Receivers<'a> {
    /// Of every vertex, what stands for it, as places in what was gathered, with weights that add up to 1.
    pub sources: &'a [Vec<(u32, f32)>],
    /// Shading normals, unit length.
    pub normals: &'a [Vec3],
    /// Whether other chunks have each as well: errors of those count for more, they are seen as edges.
    pub shared: &'a [bool],
}

impl Receivers<'_> {
    /// For how many vertices each of what was gathered stands, where one that is shared counts for so many.
    fn masses(&self, gathered: usize, of_shared: f32) -> Vec<f32> {
        let mut masses = vec![0.0; gathered];
        for (sources, &shared) in self.sources.iter().zip(self.shared) {
            let count = if shared { of_shared } else { 1.0 };
            for &(source, weight) in sources {
                masses[source as usize] += count * weight;
            }
        }
        // Single weights may be less than nothing.
        for mass in &mut masses {
            *mass = mass.max(0.0);
        }
        masses
    }

    /// A number of every vertex, by those of what was gathered.
    fn mixed(&self, of_gathered: &[f32]) -> Vec<f32> {
        let mix = |sources: &Vec<(u32, f32)>| -> f32 {
            let parts = sources.iter();
            (parts.map(|&(source, weight)| weight * of_gathered[source as usize])).sum()
        };
        self.sources.iter().map(mix).collect()
    }
}

/// Compresses the outputs of vertices by what was `gathered` for them, each of `outputs` blocks of equal length.
pub(crate) fn compress(gathered: &[Vec<f32>], vertices: &Receivers, outputs: usize) -> Compressed {
    let length = gathered.first().map_or(0, Vec::len);
    let block = length / outputs.max(1);
    let factor = |row: usize| {
        if row / block.max(1) < IRRADIANCE_OUTPUTS {
            std::f32::consts::FRAC_1_PI
        } else {
            1.0
        }
    };
    let factors: Vec<f32> = (0..length).map(factor).collect();
    let values = gathered
        .iter()
        .flat_map(|values| values.iter().zip(&factors));
    let values = values.map(|(value, factor)| value * factor).collect();
    let mut samples = DMatrix::from_vec(length, gathered.len(), values);
    let metric = Metric::new(vertices.normals);
    let along = IRRADIANCE_OUTPUTS * block;
    (samples.column_iter_mut()).for_each(|mut column| {
        Metric::apply(&metric.root, &mut column.as_mut_slice()[..along]);
    });
    let masses = vertices.masses(gathered.len(), 1.0);
    let squares = weighed_squares(&samples, &masses);
    let squared = squares.iter().map(|(square, mass)| square * mass).sum();
    let counted = counted(squares);
    let mean = subtract_mean(&mut samples, &masses);
    let mut weighed = samples.clone();
    let counts = vertices.masses(gathered.len(), SHARED * SHARED);
    for (mut column, count) in weighed.column_iter_mut().zip(counts) {
        column *= count.sqrt();
    }
    let components = principal(&weighed);
    let coefficients = product(&components.transpose(), &samples);
    let sky = SKY_SQUARED.sqrt() as f32;
    let gain = if outputs > IRRADIANCE_OUTPUTS {
        RELATIVE_GAIN_OF_RADIANCE
    } else {
        RELATIVE_GAIN
    };
    let sky_gain = SKY_GAIN.powi(2) * SKY_SQUARED * vertices.sources.len() as f64;
    let least = (gain.powi(2) * counted).max(sky_gain);
    let stored = |mut row: Vec<f32>| {
        Metric::apply(&metric.inverse, &mut row[..along]);
        row
    };
    let mut rows = vec![stored(mean.as_slice().to_vec())];
    // Of the vertices, and of what was gathered as if it were one.
    let mut weights: Vec<[Vec<i8>; 2]> = Vec::new();
    let finest = 127.0 * WEIGHT_STEP * sky;
    let energy = |values: &[f32]| -> f64 { values.iter().map(|x| f64::from(x * x)).sum() };
    for (index, coefficients) in coefficients.row_iter().enumerate() {
        let of_gathered: Vec<f32> = coefficients.iter().copied().collect();
        let mut left = [vertices.mixed(&of_gathered), of_gathered];
        if energy(&left[0]) <= least {
            break;
        }
        // Where one vertex is far brighter than others, their weights take finer steps in another row.
        let mut is_coarse = true;
        while is_coarse && energy(&left[0]) > least && weights.len() < MAX_TRANSFER_RANK as usize {
            let brightest = left[0].iter().fold(0f32, |most, x| most.max(x.abs()));
            is_coarse = brightest > finest;
            let largest = brightest.max(finest);
            let component = components.column(index);
            rows.push(stored(component.iter().map(|x| x * largest).collect()));
            weights.push(left.each_mut().map(|left| quantised(left, largest)));
        }
    }
    let rank = weights.len();
    let mut group = Group {
        rank: rank as u32,
        outputs: outputs as u32,
        squared,
        ..Group::default()
    };
    let mut decoded = store(&mut group, &rows, block, factor);
    for row in &mut decoded {
        Metric::apply(&metric.root, &mut row[..along]);
    }
    let shown = DMatrix::from_fn(length, rank, |row, index| decoded[index + 1][row]);
    let shares = DMatrix::from_fn(rank, gathered.len(), |index, column| {
        f32::from(weights[index][1][column]) / 127.0
    });
    let mut shown = product(&shown, &shares);
    let mean = DVector::from_fn(length, |row, _| decoded[0][row] - mean[row]);
    for (mut shown, sample) in shown.column_iter_mut().zip(samples.column_iter()) {
        shown += &mean;
        shown -= sample;
    }
    let errors = weighed_squares(&shown, &masses).into_iter();
    group.squared_error = errors.map(|(square, mass)| square * mass).sum();
    let weights = (0..vertices.sources.len())
        .flat_map(|vertex| weights.iter().map(move |[weights, _]| weights[vertex]))
        .collect();
    Compressed { group, weights }
}

/// Numbers in steps of a 127th of the largest; leaves what is lost.
fn quantised(values: &mut [f32], largest: f32) -> Vec<i8> {
    let quantise = |x: &mut f32| {
        let weight = (*x / largest * 127.0).round().clamp(-127.0, 127.0);
        *x -= weight * largest / 127.0;
        weight as i8
    };
    values.iter_mut().map(quantise).collect()
}

/// Puts rows into a group, whose outputs are times a factor by their first number; returns what is stored of them.
fn store(
    group: &mut Group,
    rows: &[Vec<f32>],
    block: usize,
    factor: impl Fn(usize) -> f32,
) -> Vec<Vec<f32>> {
    let least = 127.0 * BASIS_STEP * SKY_SQUARED.sqrt() as f32;
    let store = |row: &Vec<f32>| {
        let mut exact = Vec::with_capacity(row.len());
        for (output, values) in row.chunks_exact(block.max(1)).enumerate() {
            let scale = values.iter().fold(0f32, |most, x| most.max(x.abs()));
            let scale = if scale > 0.0 { scale.max(least) } else { 0.0 };
            let step = if scale > 0.0 { scale / 127.0 } else { 1.0 };
            group.scales.push(scale / factor(output * block));
            for value in values {
                let stored = (value / step).round() as i8;
                group.basis.push(stored);
                exact.push(f32::from(stored) * step);
            }
        }
        exact
    };
    rows.iter().map(store).collect()
}

/// How much errors of the vector irradiance matter, by their direction: what is shown is along normals.
struct Metric {
    /// An error e counts as eᵀ A e: the square root of A, and its inverse.
    root: Mat3,
    inverse: Mat3,
}

impl Metric {
    fn new(normals: &[Vec3]) -> Self {
        let squares: Mat3 = (normals.iter())
            .map(|&normal| Mat3::from_cols(normal * normal.x, normal * normal.y, normal * normal.z))
            .sum();
        let matrix = squares * ((1.0 - ASIDE) / normals.len().max(1) as f32)
            + Mat3::from_diagonal(Vec3::splat(ASIDE));
        let eigen = Matrix3::from_column_slice(&matrix.to_cols_array()).symmetric_eigen();
        let power = |exponent: i32| {
            let of_value = |value: f32| value.max(ASIDE).sqrt().powi(exponent);
            let values = Matrix3::from_diagonal(&eigen.eigenvalues.map(of_value));
            let root = eigen.eigenvectors * values * eigen.eigenvectors.transpose();
            Mat3::from_cols_slice(root.as_slice())
        };
        Self {
            root: power(1),
            inverse: power(-1),
        }
    }

    /// Multiplies the vectors whose x, y and z are the thirds of `values`.
    fn apply(matrix: &Mat3, values: &mut [f32]) {
        let block = values.len() / 3;
        for index in 0..block {
            let at = |axis: usize| axis * block + index;
            let vector = *matrix * Vec3::new(values[at(0)], values[at(1)], values[at(2)]);
            (0..3).for_each(|axis| values[at(axis)] = vector[axis]);
        }
    }
}

/// Principal components of the columns, as columns; strongest first.
fn principal(samples: &DMatrix<f32>) -> DMatrix<f32> {
    let (length, count) = samples.shape();
    let width = (MAX_TRANSFER_RANK as usize + EXCESS).min(length).min(count);
    if width == 0 {
        return DMatrix::zeros(length, 0);
    }
    let chance = DMatrix::from_fn(count, width, |i, j| {
        if hash(i as u32, j as u32) & 1 == 0 {
            1.0
        } else {
            -1.0
        }
    });
    let across_samples = samples.transpose();
    let mut range = orthonormal(product(samples, &chance));
    for _ in 0..ITERATIONS {
        let across = orthonormal(product(&across_samples, &range));
        range = orthonormal(product(samples, &across));
    }
    let projected = product(&range.transpose(), samples);
    let eigen = product(&projected, &projected.transpose()).symmetric_eigen();
    let mut order: Vec<usize> = (0..width).collect();
    order.sort_by(|&a, &b| eigen.eigenvalues[b].total_cmp(&eigen.eigenvalues[a]));
    let turn = DMatrix::from_fn(width, width, |i, j| eigen.eigenvectors[(i, order[j])]);
    product(&range, &turn)
}

/// Takes the mean of columns from each, which count so much; returns it.
fn subtract_mean(samples: &mut DMatrix<f32>, masses: &[f32]) -> DVector<f32> {
    let mut mean = DVector::zeros(samples.nrows());
    let part = 1.0 / masses.iter().sum::<f32>().max(f32::MIN_POSITIVE);
    for (column, mass) in samples.column_iter().zip(masses) {
        mean.axpy(mass * part, &column, 1.0);
    }
    for mut column in samples.column_iter_mut() {
        column -= &mean;
    }
    mean
}

/// Sum of the columns' squares, which count so much, each as if it were at most [`BRIGHTEST`] times that of the middle
/// one: what is brighter by far, next to lamps, does not decide how the others look.
fn counted(mut squares: Vec<(f64, f64)>) -> f64 {
    squares.sort_by(|a, b| a.0.total_cmp(&b.0));
    let half = squares.iter().map(|(_, mass)| 0.5 * mass).sum::<f64>();
    let mut below = 0.0;
    let middle = squares.iter().find(|(_, mass)| {
        below += mass;
        below > half
    });
    let most = BRIGHTEST * middle.map_or(0.0, |(square, _)| *square);
    (squares.iter().map(|(square, mass)| square.min(most) * mass)).sum()
}

/// The squares of columns, and what they count.
fn weighed_squares(values: &DMatrix<f32>, masses: &[f32]) -> Vec<(f64, f64)> {
    let square = |column: &[f32]| column.iter().map(|x| f64::from(*x) * f64::from(*x)).sum();
    let columns = values.as_slice().chunks_exact(values.nrows().max(1));
    (columns
        .map(square)
        .zip(masses.iter().map(|&mass| f64::from(mass))))
    .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use relight_format::math;

    #[test]
    fn a_few_smooth_functions_come_back() {
        // Three functions of the vertex and a little noise, 3 outputs of 30 numbers.
        let vertex = |i: usize| -> Vec<f32> {
            let t = i as f32 / 200.0;
            (0..90)
                .map(|k| {
                    let k = k as f32;
                    let noise = (hash(i as u32, k as u32) >> 8) as f32 / 16_777_216.0 - 0.5;
                    1.0 + math::sin(0.1 * k) * t
                        + math::cos(0.3 * k) * math::sin(3.0 * t)
                        + 0.2 * math::sin(0.7 * k) * math::cos(5.0 * t)
                        + 0.002 * noise
                })
                .collect()
        };
        let vertices: Vec<_> = (0..200).map(vertex).collect();
        let sources: Vec<_> = (0..200).map(|vertex| vec![(vertex, 1.0)]).collect();
        let receivers = Receivers {
            sources: &sources,
            normals: &[Vec3::Y; 200],
            shared: &[false; 200],
        };
        let compressed = compress(&vertices, &receivers, 3);
        let Group {
            rank,
            squared_error,
            squared,
            ..
        } = compressed.group;
        assert!((2..=3).contains(&rank), "{rank}");
        let error = (squared_error / squared).sqrt();
        // What is allowed, and steps of 1/254.
        assert!(error < RELATIVE_GAIN + 0.004, "{error}");
        assert_eq!(compressed.weights.len(), 200 * rank as usize);
    }

    /// Compressing what a few stand for, or all of them as mixed, comes to the same light.
    #[test]
    fn what_stands_for_others_is_compressed_for_them() {
        let value = |i: usize, k: usize| {
            let (t, k) = (i as f32 / 60.0, k as f32);
            1.0 + math::sin(0.1 * k) * t + math::cos(0.3 * k) * math::sin(3.0 * t)
        };
        let gathered: Vec<Vec<f32>> = (0..60)
            .map(|i| (0..90).map(|k| value(i, k)).collect())
            .collect();
        // Between each and the next three more.
        let sources: Vec<Vec<(u32, f32)>> = (0..236u32)
            .map(|i| {
                let part = (i % 4) as f32 / 4.0;
                vec![(i / 4, 1.0 - part), (i / 4 + 1, part)]
            })
            .collect();
        let mixed: Vec<Vec<f32>> = (sources.iter())
            .map(|sources| {
                let at = |k: usize| -> f32 {
                    let parts = sources.iter();
                    (parts.map(|&(source, weight)| weight * gathered[source as usize][k])).sum()
                };
                (0..90).map(at).collect()
            })
            .collect();
        let alone: Vec<_> = (0..236).map(|vertex| vec![(vertex, 1.0)]).collect();
        let of = |gathered: &[Vec<f32>], sources: &[Vec<(u32, f32)>]| {
            let receivers = Receivers {
                sources,
                normals: &[Vec3::Y; 236],
                shared: &[false; 236],
            };
            compress(gathered, &receivers, 3)
        };
        let (few, all) = (of(&gathered, &sources), of(&mixed, &alone));
        assert_eq!(few.group.rank, all.group.rank);
        let relative = |group: &Group| (group.squared_error / group.squared).sqrt();
        assert!((few.group.squared / all.group.squared - 1.0).abs() < 0.01);
        assert!(relative(&few.group) < 1.2 * relative(&all.group));
        let error = |compressed: &Compressed, vertex: usize| -> f32 {
            let Group { scales, basis, .. } = &compressed.group;
            let row = |row: usize, k: usize| {
                f32::from(basis[row * 90 + k]) / 127.0 * scales[row * 3 + k / 30]
            };
            let weights = compressed.weights_of(vertex).iter().enumerate();
            let shown = |k: usize| -> f32 {
                let parts = weights.clone();
                row(0, k)
                    + parts
                        .map(|(i, weight)| f32::from(*weight) / 127.0 * row(i + 1, k))
                        .sum::<f32>()
            };
            let off = |k: usize| (shown(k) - mixed[vertex][k]).powi(2);
            ((0..90).map(off).sum::<f32>() / 90.0).sqrt()
        };
        for vertex in 0..236 {
            let errors = [error(&few, vertex), error(&all, vertex)];
            // Of values about 1 to 3.
            assert!(
                errors.iter().all(|error| *error < 0.03),
                "{vertex}: {errors:?}"
            );
        }
    }

    #[test]
    fn darkness_takes_no_components() {
        let sources: Vec<_> = (0..5).map(|vertex| vec![(vertex, 1.0)]).collect();
        let receivers = Receivers {
            sources: &sources,
            normals: &[Vec3::Y; 5],
            shared: &[false; 5],
        };
        let compressed = compress(&vec![vec![0.0; 12]; 5], &receivers, 3);
        assert_eq!(compressed.group.rank, 0);
        assert_eq!(compressed.group.scales, [0.0; 3]);
        assert_eq!(compressed.group.squared_error, 0.0);
    }
}
