//! Visible fractions of distant lights at the vertices of triangles in sight. Twin of
//! `vertices_main`.

use std::cell::Cell;
use std::sync::PoisonError;

use glam::Vec3;
use rayon::prelude::*;
use relight_shading::polar::PolarOptions;
use relight_shading::spherical_gaussian::SphericalGaussian;
use relight_shading::ssdf::Ssdf;
use relight_shading::vertex_visibility::{light_fraction, spokes, texture_rows};

use super::{Counted, Prepared, Staged};

/// Of so many lights and options fractions are kept: those of drafts, and of what they are drafts of.
const MOST_KEPT: usize = 2;
/// Of a vertex without fractions.
const NONE: u32 = u32::MAX;

/// Fractions at the vertices of triangles in sight.
pub(super) struct VertexFractions {
    /// Of what they are.
    lights: Vec<SphericalGaussian>,
    options: PolarOptions,
    /// Where a vertex stands in `fractions`, in vertices, or [`NONE`].
    slots: Vec<u32>,
    /// Light by light for every vertex that was seen.
    fractions: Vec<f32>,
    /// SSDF samples that it took, and texels of four basis images interpolated for them.
    pub work: [u64; 2],
}

impl VertexFractions {
    /// Those that the last frame left, where lights are the same, and those that are missing.
    /// `None` where there are none: no lights, more than a GPU keeps, or nobody `wanted` them long
    /// enough.
    pub fn new(
        staged: &Staged,
        visible: &[u32],
        options: PolarOptions,
        wanted: &(dyn Fn() -> bool + Sync),
    ) -> Option<Self> {
        let Staged {
            scene,
            prepared,
            first_id,
            ..
        } = staged;
        let lights = &staged.local.lights;
        texture_rows(scene.vertices.len(), lights.len())?;
        let fits = |kept: &Self| {
            let same_lights = kept.options == options && kept.lights == *lights;
            same_lights && kept.slots.len() == scene.vertices.len()
        };
        let mut kept = (prepared.fractions.lock()).unwrap_or_else(PoisonError::into_inner);
        let known = kept.iter().position(fits).map(|index| kept.remove(index));
        drop(kept);
        let mut found = known.unwrap_or_else(|| Self {
            lights: lights.clone(),
            options,
            slots: vec![NONE; scene.vertices.len()],
            fractions: Vec::new(),
            work: [0; 2],
        });
        let mut missing = vec![false; scene.vertices.len()];
        for id in visible {
            // Background and other instances' triangles are before the first or past the last.
            let number = id.checked_sub(*first_id).map(|number| number as usize);
            let triangle = number.and_then(|number| scene.triangles.get(number));
            let paying = triangle.filter(|triangle| staged.pays(triangle));
            for vertex in paying.into_iter().flat_map(|triangle| triangle.vertices) {
                missing[vertex as usize] = found.slots[vertex as usize] == NONE;
            }
        }
        let first_place = found.fractions.len() / lights.len();
        let mut places = Vec::new();
        for (index, cluster) in scene.clusters.iter().enumerate() {
            let first = cluster.first_vertex;
            for vertex in (first..first + cluster.vertex_count).filter(|v| missing[*v as usize]) {
                found.slots[vertex as usize] = (first_place + places.len()) as u32;
                places.push((index, vertex));
            }
        }
        let spokes = spokes(lights, options);
        let before = found.fractions.len();
        (found.fractions).resize(before + places.len() * lights.len(), 0.0);
        let fill = |(fractions, &(cluster, vertex)): (&mut [f32], &(usize, u32))| {
            if !wanted() {
                return [0; 2];
            }
            let counted = Counted {
                field: &Ssdf::at_vertex(scene, &prepared.basis, cluster, vertex),
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
        found.work = found.fractions[before..]
            .par_chunks_mut(lights.len())
            .zip(&places)
            .map(fill)
            .reduce(|| [0; 2], |a, b| [a[0] + b[0], a[1] + b[1]]);
        if wanted() {
            return Some(found);
        }
        // Those may be zeros.
        found.fractions.truncate(before);
        for (_, vertex) in places {
            found.slots[vertex as usize] = NONE;
        }
        found.keep(prepared);
        None
    }

    /// For the next frame.
    pub fn keep(self, prepared: &Prepared) {
        let mut kept = (prepared.fractions.lock()).unwrap_or_else(PoisonError::into_inner);
        let surplus = (kept.len() + 1).saturating_sub(MOST_KEPT);
        kept.drain(..surplus);
        kept.push(self);
    }

    pub fn of(&self, vertex: u32) -> &[f32] {
        let first = self.slots[vertex as usize] as usize * self.lights.len();
        &self.fractions[first..first + self.lights.len()]
    }
}
