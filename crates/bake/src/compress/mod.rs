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

mod encode;
mod error;
mod fit;
mod samples;

pub(crate) use encode::{Compressed, Stored, decode};
pub use encode::{Encoded, encode};
pub use error::{Normal, Weighting};
pub use fit::{Fit, Fits, alternate, analyse, images};
pub use samples::Samples;
pub(crate) use samples::column;

#[cfg(test)]
mod tests {
    use glam::Vec3;
    use nalgebra::DMatrix;
    use relight_format::math;

    use super::*;
    use crate::visibility::Directions;

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

    /// So many images, fitted in so many rounds.
    fn reweight(
        fitted: &samples::Fitted,
        basis: &fit::FittedBasis,
        channels: usize,
        rounds: usize,
    ) -> (fit::Images, DMatrix<f32>) {
        let fit = Fits::new(fitted, basis, channels).fit(channels);
        images(fitted, &alternate(fitted, fit.coefficients, rounds))
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
                let distances = directions.as_slice().iter().map(|d| math::asin(d.x) + off);
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
    fn quarters_of_the_texels_share_none_and_count_for_all() {
        for side in [1, 2, 3, 4, 8, 16, 64] {
            let texels = side * side;
            let all = samples(DMatrix::from_fn(texels, 2, |texel, _| texel as f32));
            let [thinned, staggered] = [all.thinned(), all.staggered()];
            for some in [&thinned, &staggered] {
                let scale = texels as f32 / some.ssdfs.nrows() as f32;
                for (row, texel) in some.ssdfs.column(1).iter().enumerate() {
                    let weight = all.weights[(*texel as usize, 1)];
                    assert_eq!(some.weights[(row, 1)], scale * weight, "{side}");
                }
            }
            if side % 4 == 0 {
                assert_eq!(thinned.ssdfs.nrows(), texels / 4);
                assert_eq!(staggered.ssdfs.nrows(), texels / 4);
                let others = staggered.ssdfs.column(0);
                let shared = others
                    .iter()
                    .filter(|&texel| thinned.ssdfs.column(0).iter().any(|other| other == texel));
                assert_eq!(shared.count(), 0, "{side}");
            }
        }
    }

    #[test]
    fn components_are_orthonormal_and_ordered() {
        let ssdfs = drifting_caps(50);
        let basis = analyse(&ssdfs.fitted(), 8);
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
        let basis = analyse(&ssdfs.fitted(), 15);
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
            let basis = analyse(&ssdfs.fitted(), channels - 1);
            let error = |images: &fit::Images| {
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
            let (a, b) = (
                math::sin(texel as f32 * 0.1),
                math::cos(texel as f32 * 0.07),
            );
            0.2 * a + 0.1 * b * math::sin(vertex as f32 * 0.3)
        });
        let ssdfs = samples(ssdfs);
        let compressed = encode(&ssdfs.fitted(), &analyse(&ssdfs.fitted(), 3).images, 1e-4);
        // 8-bit steps of images whose largest values are 0.2 and 0.1 rad, off by 0.62 of a step at most.
        assert!(
            compressed.error() < 0.3 / 127.0 * 0.62,
            "{}",
            compressed.error()
        );
    }

    #[test]
    fn rounding_takes_its_part_of_the_error() {
        let ssdfs = drifting_caps(60);
        let fitted = ssdfs.fitted();
        let (images, _) = reweight(&fitted, &analyse(&ssdfs.fitted(), 15), 16, 3);
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
            let each: Vec<_> = (0..60).map(|vertex| vec![(vertex, 1.0)]).collect();
            assert!(
                bits(&compressed.of(&each).0) < 13,
                "coarse coefficients are small"
            );
        }
    }

    #[test]
    fn coefficients_interpolate_as_distances_do() {
        let ssdfs = drifting_caps(60);
        let fitted = ssdfs.fitted();
        let (images, _) = reweight(&fitted, &analyse(&ssdfs.fitted(), 15), 16, 3);
        let each = |vertex: usize| vec![(vertex, 1.0)];
        let (compressed, stored) = encode(&fitted, &images, 1e-4).of(&[each(3), each(8)]);
        let ends = stored.ssdfs(&[0, 1]);
        let (all, _) = encode(&fitted, &images, 1e-4).of(&(0..60).map(each).collect::<Vec<_>>());
        let channels = compressed.tiles as usize * relight_format::CHANNELS_PER_TILE;
        for (index, vertex) in [3, 8].into_iter().enumerate() {
            let coefficients = &all.coefficients[vertex * channels..][..channels];
            let own = &compressed.coefficients[index * channels..][..channels];
            assert_eq!(own, coefficients);
            let decoded = decode(own, &all.basis, all.coefficient_scale);
            let difference = DMatrix::from_vec(256, 1, decoded) - ends.columns(index, 1);
            assert!(difference.amax() < 1e-5);
        }
        // What most vertices of a mesh that is finer than samples get.
        let sums = [(0.25, 0.75), (1.1, -0.1)];
        let mixed = sums.map(|(first, second)| vec![(3, first), (8, second)]);
        let (_, stored) = encode(&fitted, &images, 1e-4).of(&mixed);
        let between = stored.ssdfs(&[0, 1]);
        for (column, (first, second)) in sums.into_iter().enumerate() {
            let expected = ends.column(0) * first + ends.column(1) * second;
            let off = (between.column(column) - expected).amax();
            assert!(off < 1e-4, "{off}");
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
            math::asin(directions.as_slice()[texel].y).clamp(-0.5, 0.5) + rounding
        });
        let ssdfs = samples(ssdfs);
        let fitted = ssdfs.fitted();
        for channels in [4, 8, 16] {
            let basis = analyse(&ssdfs.fitted(), channels - 1);
            let (images, _) = reweight(&fitted, &basis, channels, 3);
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
            let basis = analyse(&ssdfs.fitted(), 7);
            let (images, _) = reweight(&fitted, &basis, 8, 3);
            for images in [&basis.images, &images] {
                assert!(images.values.iter().all(|value| value.is_finite()));
                let compressed = encode(&fitted, images, 1e-4);
                assert!(compressed.error() < 1e-4, "{vertices} columns of {value}");
            }
        }
    }
}
