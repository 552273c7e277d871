//! Visible fractions of distant lights at the vertices of triangles in sight. Twin of
//! `vertices_main`.

use std::cell::Cell;

use glam::Vec3;
use rayon::prelude::*;
use relight_shading::polar::PolarOptions;
use relight_shading::ssdf::Ssdf;
use relight_shading::vertex_visibility::{light_fraction, spokes, texture_rows};

use super::{Counted, Staged};
/// Fractions at the vertices of triangles in sight.
pub(super) struct VertexFractions {
    /// Where a vertex stands in `fractions`, in vertices; meaningless for those not seen.
    slots: Vec<u32>,
    /// Light by light for every vertex seen.
    fractions: Vec<f32>,
    lights: usize,
    /// SSDF samples that it took, and texels of four basis images interpolated for them.
    pub work: [u64; 2],
}

impl VertexFractions {
    /// `None` where there are none: no lights, or more than a GPU keeps.
    pub fn new(staged: &Staged, visible: &[u32], options: PolarOptions) -> Option<Self> {
        let Staged {
            scene,
            basis,
            first_id,
            ..
        } = staged;
        let lights = &staged.local.lights;
        texture_rows(scene.vertices.len(), lights.len())?;
        let mut seen = vec![false; scene.vertices.len()];
        for id in visible {
            // Background and other instances' triangles are before the first or past the last.
            let number = id.checked_sub(*first_id).map(|number| number as usize);
            let triangle = number.and_then(|number| scene.triangles.get(number));
            for vertex in triangle.into_iter().flat_map(|triangle| triangle.vertices) {
                seen[vertex as usize] = true;
            }
        }
        let mut slots = vec![0; seen.len()];
        let mut places = Vec::new();
        for (index, cluster) in scene.clusters.iter().enumerate() {
            let first = cluster.first_vertex;
            for vertex in (first..first + cluster.vertex_count).filter(|v| seen[*v as usize]) {
                slots[vertex as usize] = places.len() as u32;
                places.push((index, vertex));
            }
        }
        let spokes = spokes(lights, options);
        let mut fractions = vec![0.0; places.len() * lights.len()];
        let fill = |(fractions, &(cluster, vertex)): (&mut [f32], &(usize, u32))| {
            let counted = Counted {
                field: &Ssdf::at_vertex(scene, basis, cluster, vertex),
                samples: Cell::new(0),
            };
            let normal = Vec3::from(scene.vertices[vertex as usize].normal);
            let normal = normal.try_normalize().unwrap_or(Vec3::Y);
            for ((light, &spokes), fraction) in lights.iter().zip(&spokes).zip(fractions) {
                *fraction = light_fraction(light, spokes, normal, &counted);
            }
            let samples = counted.samples.get();
            [samples, samples * counted.field.tiles() as u64]
        };
        let work = fractions
            .par_chunks_mut(lights.len())
            .zip(&places)
            .map(fill)
            .reduce(|| [0; 2], |a, b| [a[0] + b[0], a[1] + b[1]]);
        Some(Self {
            slots,
            fractions,
            lights: lights.len(),
            work,
        })
    }

    pub fn of(&self, vertex: u32) -> &[f32] {
        let first = self.slots[vertex as usize] as usize * self.lights;
        &self.fractions[first..first + self.lights]
    }
}
