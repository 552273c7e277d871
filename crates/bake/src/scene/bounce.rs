//! Bounced light of a chunk: gathered at its vertices, compressed, and shared out to its
//! clusters.

use std::sync::atomic::Ordering;
use std::time::Instant;

use glam::Vec3;
use rayon::prelude::*;
use relight_format as format;

use super::assemble::Cluster;
use super::sample::Prepared;
use super::statistics::add_time;
use crate::monitor::Interrupted;
use crate::transfer::compress::{Compressed, compress};
use crate::transfer::gather::Receiver;

/// Bounced light of a chunk.
pub(super) struct ChunkLight {
    /// Ascending.
    vertices: Vec<u32>,
    light: Compressed,
}

impl ChunkLight {
    /// Weights of one of the vertices.
    pub(super) fn weights_of(&self, vertex: u32) -> &[i8] {
        let place = self.vertices.partition_point(|&other| other < vertex);
        self.light.weights_of(place)
    }

    /// Gives the first cluster of a chunk the rows that all of them share.
    pub(super) fn open_group(&self, clusters: &mut [Cluster]) {
        if let Some(first) = clusters.first_mut() {
            first.transfer.group = Some(self.light.group.clone());
        }
    }
}

impl Prepared<'_> {
    /// Bounced light of the vertices that some triangles use, if light bounces.
    pub(super) fn bounced(&self, triangles: &[u32]) -> Result<Option<ChunkLight>, Interrupted> {
        let Some(radiosity) = &self.radiosity else {
            return Ok(None);
        };
        // What arrives depends on the normal as well as on the place.
        let vertices = self.mesh_vertices_of(triangles);
        let mirror = triangles.iter().any(|&triangle| {
            self.mirrors[usize::from(self.mesh.triangles[triangle as usize].material)]
        });
        let rays = self.options.transfer.vertex_rays;
        let caster = self.contours.caster();
        let gather = |&vertex: &u32| {
            let start = Instant::now();
            let normal = self.mesh.vertices[vertex as usize].normal;
            let receiver = Receiver {
                origin: self.origins[self.places[vertex as usize] as usize],
                normal: normal.normalize_or(Vec3::Y),
            };
            let gathered = radiosity.gather(caster, &receiver, rays, !mirror);
            add_time(&self.counters.bounce_nanoseconds, start);
            self.report()?;
            Ok(gathered)
        };
        let gathered: Result<Vec<_>, Interrupted> = vertices.par_iter().map(gather).collect();
        let cast = vertices.len() as u64 * u64::from(rays);
        (self.counters.bounce_rays).fetch_add(cast, Ordering::Relaxed);
        let gathered = gathered?;
        let start = Instant::now();
        let light = compress(&gathered, if mirror { 7 } else { 3 });
        add_time(&self.counters.bounce_nanoseconds, start);
        Ok(Some(ChunkLight { vertices, light }))
    }
}

/// Whether a surface reflects so much as a mirror, rough or not, that it shows what is about it:
/// that takes more than irradiance.
pub(super) fn mirrors(material: &format::Material) -> bool {
    /// Colours below are those of a dielectric, or twice as bright.
    const LEAST: f32 = 0.08;
    let bright = |color: &[f32; 3]| color.iter().any(|x| *x > LEAST);
    let mirrors = |specular: &format::Specular| match specular {
        format::Specular::None => false,
        format::Specular::BlinnPhong { specular, .. } | format::Specular::Ward { specular, .. } => {
            bright(specular)
        }
        format::Specular::CookTorrance { f0, .. }
        | format::Specular::Ggx { f0, .. }
        | format::Specular::AshikhminShirley { f0, .. } => bright(f0),
        format::Specular::Lobes { lobes, .. } => lobes.iter().any(|lobe| bright(&lobe.f0)),
    };
    match &material.surface {
        format::Surface::MetallicRoughness { metallic, .. } => *metallic > LEAST,
        format::Surface::Layered { specular, .. } => mirrors(specular),
        format::Surface::Layers { layers } => layers.iter().any(|layer| mirrors(&layer.specular)),
    }
}
