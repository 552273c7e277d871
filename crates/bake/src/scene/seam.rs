//! How far visibility jumps where clusters meet.

use std::collections::HashMap;

use glam::Vec3;
use rayon::prelude::*;
use relight_format::{self as format, CHANNELS_PER_TILE};

use crate::compress::{self, Normal, Weighting};

/// Differences between the SSDFs that clusters give to the vertices they share.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Seams {
    /// Vertices that lie in several clusters, less one for each of them.
    pub pairs: u64,
    /// Root mean square of the difference, radians: a wall's edge that jumps by this angle
    /// is as visible.
    pub rms: f32,
    /// The largest difference, radians.
    pub largest: f32,
}

/// Compares every vertex with the first of the same place and normal in another cluster.
pub fn measure(scene: &format::Scene) -> Seams {
    let weighting = Weighting::new(scene.visibility.basis_resolution);
    let cluster_of = |vertex: usize| {
        (scene.clusters).partition_point(|cluster| cluster.first_vertex as usize <= vertex) - 1
    };
    let mut first: HashMap<[u32; 6], usize> = HashMap::new();
    let mut pairs = Vec::new();
    for (index, vertex) in scene.vertices.iter().enumerate() {
        let [x, y, z] = vertex.position.map(f32::to_bits);
        let [u, v, w] = vertex.normal.map(f32::to_bits);
        let other = *first.entry([x, y, z, u, v, w]).or_insert(index);
        if cluster_of(other) != cluster_of(index) {
            pairs.push((other, index));
        }
    }
    let squares: Vec<f32> = (pairs.par_iter())
        .map(|&(a, b)| {
            let [first, second] = [a, b].map(|vertex| decode(scene, cluster_of(vertex), vertex));
            let normal = Normal {
                direction: Vec3::from(scene.vertices[a].normal).normalize_or_zero(),
                tilt: 0.0,
            };
            weighting.squared_displacement(&second, &first, normal)
        })
        .collect();
    // The sum of nothing is −0.
    let sum = 0.0 + squares.iter().map(|square| f64::from(*square)).sum::<f64>();
    Seams {
        pairs: pairs.len() as u64,
        rms: (sum / pairs.len().max(1) as f64).sqrt() as f32,
        largest: squares.into_iter().fold(0.0, f32::max).sqrt(),
    }
}

/// The stored SSDF of a vertex, radians, at every texel of the basis.
fn decode(scene: &format::Scene, cluster: usize, vertex: usize) -> Vec<f32> {
    let cluster = &scene.clusters[cluster];
    let texels = (scene.visibility.basis_resolution as usize).pow(2);
    let channels = cluster.tiles as usize * CHANNELS_PER_TILE;
    let start =
        cluster.first_coefficient as usize + (vertex - cluster.first_vertex as usize) * channels;
    let first_texel = cluster.first_tile as usize * texels * CHANNELS_PER_TILE;
    compress::decode(
        &scene.coefficients[start..][..channels],
        &scene.basis[first_texel..][..texels * channels],
        cluster.coefficient_scale,
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::monitor::SILENT;
    use crate::scene::load;
    use crate::scene::{Options, bake};

    #[test]
    fn shared_vertices_differ_by_no_more_than_both_errors() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("steps.obj");
        let mut text = String::new();
        // Stairs: 40 by 40 vertices whose heights jump.
        for i in 0..1600 {
            let (x, z) = (i % 40, i / 40);
            text += &format!("v {} {} {}\n", x, (x / 5 + z / 7) % 3, z);
        }
        for i in 0..1600 {
            if i % 40 < 39 && i < 1560 {
                let a = i + 1;
                text += &format!("f {} {} {} {}\n", a, a + 40, a + 41, a + 1);
            }
        }
        std::fs::write(&path, text).unwrap();
        let options = Options {
            sample_resolution: 32,
            basis_resolution: 32,
            aim: 0.01,
            ..Options::standard()
        };
        let input = load::load(&path).unwrap();
        let (scene, _) = bake(input, &options, SILENT).unwrap();
        assert!(scene.clusters.len() > 1);
        let seams = measure(&scene);
        assert!(seams.pairs > 20, "{seams:?}");
        // Two independent errors; vertices on a border are its clusters' hardest.
        let error = scene.report.errors.compression;
        assert!(
            seams.rms > 0.2 * error && seams.rms < 4.0 * error,
            "{seams:?}, {error}"
        );
        assert!(seams.largest >= seams.rms);
    }
}
