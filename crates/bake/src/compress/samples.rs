//! SSDFs of a cluster with what an error at each texel costs, and the texels that a fit looks at.

use std::ops::Range;

use nalgebra::DMatrix;

use super::error::{Normal, Weighting};
use crate::memory;
use crate::simd::{Panels, both_ways, vectorised};

/// Texels whose weight at every vertex is below this part of the largest are told by the
/// [`SKIPPED`]th of them.
const IDLE: f32 = 0.02;
const SKIPPED: usize = 8;
/// Sums that are formed side by side.
pub(super) const LANES: usize = 16;
/// Texels and rows that [`Samples::thinned`] steps by.
const THINNED: usize = 2;

/// SSDFs of a cluster and what their errors cost: one row per texel, one column per vertex.
pub struct Samples {
    pub(super) ssdfs: DMatrix<f32>,
    pub(super) weights: DMatrix<f32>,
}

/// Those texels of samples that bases and coefficients are fitted to, of all vertices or some.
pub struct Fitted<'a> {
    pub(super) samples: &'a Samples,
    /// The vertices' columns.
    pub(super) vertices: Vec<usize>,
    pub(super) texels: Vec<usize>,
    /// Mean weights of all texels.
    pub(super) costs: Vec<f32>,
    /// Of those texels, for each vertex.
    pub(super) weights: BothWays,
    /// Products of weights and SSDFs.
    pub(super) weighted: BothWays,
    /// The sum of products of weights and squares of SSDFs.
    pub(super) squares: f64,
    /// What an error of one radian at all of them costs: the mean over vertices.
    pub(super) cost: f32,
}

/// A number of each texel and vertex, as products read them.
pub(super) struct BothWays {
    /// One row per texel.
    pub(super) of_texels: Panels,
    /// One row per vertex.
    pub(super) of_vertices: Panels,
}

impl BothWays {
    fn new([of_texels, of_vertices]: [Panels; 2]) -> Self {
        Self {
            of_texels,
            of_vertices,
        }
    }
}

impl Samples {
    /// One normal per column of `ssdfs`.
    pub fn new(ssdfs: DMatrix<f32>, normals: &[Normal], weighting: &Weighting) -> Self {
        let texels = ssdfs.nrows();
        let weights = memory::used(texels * ssdfs.ncols());
        let mut weights = DMatrix::from_vec(texels, ssdfs.ncols(), weights);
        let columns = ssdfs.as_slice().chunks_exact(texels);
        let weighted = weights.as_mut_slice().chunks_exact_mut(texels);
        for ((weights, ssdf), normal) in weighted.zip(columns).zip(normals) {
            vectorised!(
                <'a>
                weighting: &'a Weighting = weighting,
                ssdf: &'a [f32] = ssdf,
                normal: Normal = *normal,
                weights: &'a mut [f32] = weights
                => () { weighting.weigh(ssdf, normal, weights) }
            );
        }
        Self { ssdfs, weights }
    }

    /// SSDFs, radians: one row per texel, one column per vertex.
    pub(crate) fn ssdfs(&self) -> &DMatrix<f32> {
        &self.ssdfs
    }

    /// One texel of four, which stands for them all: enough to tell what compression would
    /// give.
    #[must_use]
    pub(crate) fn thinned(&self) -> Self {
        let step = THINNED.min(self.ssdfs.nrows().isqrt());
        self.some(|row| row.is_multiple_of(step).then_some((0, step)))
    }

    /// As many, and none of those: of the columns between, by turns. Of fewer than four to a side, the same.
    #[must_use]
    pub(crate) fn staggered(&self) -> Self {
        let apart = THINNED * THINNED;
        if self.ssdfs.nrows().isqrt() < apart {
            return self.thinned();
        }
        self.some(|row| Some((1 + THINNED * (row % THINNED), apart)))
    }

    /// Some texels, which stand for all: of a row the first, and how far the next is from each.
    fn some(&self, of_row: impl Fn(usize) -> Option<(usize, usize)>) -> Self {
        let side = self.ssdfs.nrows().isqrt();
        let rows: Vec<(usize, usize)> = (0..side)
            .filter_map(|row| of_row(row).map(|(first, step)| (row * side + first, step)))
            .collect();
        let some = |matrix: &DMatrix<f32>, scale: f32| {
            let mut values = memory::room(matrix.len() / (THINNED * THINNED));
            for column in matrix.as_slice().chunks_exact(side * side) {
                for (first, step) in &rows {
                    let row = &column[*first..(first / side + 1) * side];
                    values.extend(row.iter().step_by(*step).map(|value| scale * value));
                }
            }
            let texels = values.len() / matrix.ncols().max(1);
            DMatrix::from_vec(texels, matrix.ncols(), values)
        };
        let ssdfs = some(&self.ssdfs, 1.0);
        let scale = (side * side) as f32 / ssdfs.nrows() as f32;
        Self {
            ssdfs,
            weights: some(&self.weights, scale),
        }
    }

    /// The texels that count: all near a boundary above some vertex's horizon, few others.
    pub fn fitted(&self) -> Fitted<'_> {
        self.fitted_of((0..self.ssdfs.ncols()).collect())
    }

    /// The same of some vertices.
    pub(crate) fn fitted_of(&self, vertices: Vec<usize>) -> Fitted<'_> {
        let mut largest = vec![0.0f32; self.weights.nrows()];
        let mut costs = vec![0.0f32; self.weights.nrows()];
        // By slices and comparisons, as vector instructions want it.
        for &vertex in &vertices {
            let weights = column(&self.weights, vertex);
            for ((largest, cost), weight) in largest.iter_mut().zip(&mut costs).zip(weights) {
                *largest = if *weight > *largest {
                    *weight
                } else {
                    *largest
                };
                *cost += weight;
            }
        }
        for cost in &mut costs {
            *cost /= vertices.len() as f32;
        }
        let bound = IDLE * largest.iter().copied().fold(0.0, f32::max);
        let mut idle = 0;
        // Texels side by side that stand for as many.
        let mut runs: Vec<(Range<usize>, f32)> = Vec::new();
        for (texel, largest) in largest.into_iter().enumerate() {
            let busy = largest > bound;
            let factor = if busy { 1.0 } else { SKIPPED as f32 };
            if busy || idle % SKIPPED == 0 {
                match runs.last_mut() {
                    Some((run, same)) if run.end == texel && *same == factor => run.end += 1,
                    _ => runs.push((texel..texel + 1, factor)),
                }
            }
            idle += usize::from(!busy);
        }
        let texels: Vec<usize> = runs.iter().flat_map(|(run, _)| run.clone()).collect();
        let weighed = runs.iter().flat_map(|(run, factor)| {
            let costs = costs[run.clone()].iter();
            costs.map(move |cost| cost * factor)
        });
        let cost = weighed.sum();
        let shape = (texels.len(), vertices.len());
        let weights = both_ways(shape, |index, out| {
            let costs = column(&self.weights, vertices[index]);
            for_runs(&runs, out, |run, factor, out| {
                for (out, weight) in out.iter_mut().zip(&costs[run]) {
                    *out = weight * factor;
                }
            });
        });
        let mut squares = 0.0;
        let weighted = both_ways(shape, |index, out| {
            let [ssdf, costs] =
                [&self.ssdfs, &self.weights].map(|all| column(all, vertices[index]));
            // Side by side, as vector instructions want it.
            let mut sums = [0.0; LANES];
            for_runs(&runs, out, |run, factor, out| {
                let (ssdf, costs) = (&ssdf[run.clone()], &costs[run]);
                let pairs = ssdf.chunks(LANES).zip(costs.chunks(LANES));
                for (out, (ssdf, costs)) in out.chunks_mut(LANES).zip(pairs) {
                    let texels = out.iter_mut().zip(ssdf.iter().zip(costs));
                    for (sum, (out, (distance, weight))) in sums.iter_mut().zip(texels) {
                        *out = weight * factor * distance;
                        *sum += *out * distance;
                    }
                }
            });
            squares += f64::from(sums.iter().sum::<f32>());
        });
        Fitted {
            samples: self,
            weights: BothWays::new(weights),
            weighted: BothWays::new(weighted),
            squares,
            cost,
            vertices,
            texels,
            costs,
        }
    }
}

/// Calls back for each run of texels, with what its weights are multiplied by and its part of `out`.
fn for_runs(
    runs: &[(Range<usize>, f32)],
    mut out: &mut [f32],
    mut call: impl FnMut(Range<usize>, f32, &mut [f32]),
) {
    for (run, factor) in runs {
        let (own, others) = out.split_at_mut(run.len());
        call(run.clone(), *factor, own);
        out = others;
    }
}

impl Fitted<'_> {
    /// SSDFs and weights of all texels, vertex after vertex.
    pub(super) fn columns(&self) -> impl Iterator<Item = [&[f32]; 2]> {
        let both = [&self.samples.ssdfs, &self.samples.weights];
        (self.vertices.iter()).map(move |&vertex| both.map(|all| column(all, vertex)))
    }
}

impl Drop for Samples {
    fn drop(&mut self) {
        memory::keep_of(&mut self.ssdfs);
        memory::keep_of(&mut self.weights);
    }
}

/// Of a matrix, which holds column after column.
pub(crate) fn column(matrix: &DMatrix<f32>, index: usize) -> &[f32] {
    let rows = matrix.nrows();
    &matrix.as_slice()[index * rows..][..rows]
}
