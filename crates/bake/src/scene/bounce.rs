//! Bounced light of a chunk: gathered at its vertices, compressed, and shared out to its
//! clusters.

use std::sync::atomic::Ordering;
use std::time::Instant;

use glam::Vec3;
use nalgebra::DMatrix;
use rayon::prelude::*;
use relight_format as format;

use super::assemble::Cluster;
use super::sample::Prepared;
use super::statistics::add_time;
use crate::compress::column;
use crate::monitor::Interrupted;
use crate::ssdf;
use crate::transfer::compress::{Compressed, Receivers, compress};
use crate::transfer::gather::Receiver;
use crate::transfer::smooth::smoothed;

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
    /// Bounced light of the vertices that some triangles use, if light bounces. `ssdfs` has a column for each of
    /// `places`, which ascend: those that stand for the triangles'.
    pub(super) fn bounced(
        &self,
        triangles: &[u32],
        places: &[u32],
        ssdfs: &DMatrix<f32>,
    ) -> Result<Option<ChunkLight>, Interrupted> {
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
        // Where all places are sampled: what others stand for is no surer than what it is interpolated between.
        let sampled = self.options.sample_spacing == 0.0;
        let centres = self.weighting.directions();
        let receiver = |&vertex: &u32| Receiver {
            origin: self.origins[self.places[vertex as usize] as usize],
            normal: (self.mesh.vertices[vertex as usize].normal).normalize_or(Vec3::Y),
        };
        let gather = |vertex: u32| {
            let start = Instant::now();
            let place = self.places[vertex as usize];
            let ssdf = (places.binary_search(&place).ok())
                .filter(|_| sampled)
                .map(|index| column(ssdfs, index));
            let is_clear = |direction| {
                ssdf.is_some_and(|distances| ssdf::is_clear(distances, centres, direction))
            };
            let gathered = radiosity.gather(caster, &receiver(&vertex), rays, !mirror, is_clear);
            add_time(&self.counters.bounce_nanoseconds, start);
            (self.counters.bounce_rays).fetch_add(gathered.cast, Ordering::Relaxed);
            gathered
        };
        let mut stand: Vec<Vec<(u32, f32)>> = (vertices.iter())
            .map(|&vertex| self.gathered_for(vertex))
            .collect();
        let mut sources: Vec<u32> = stand.iter().flatten().map(|source| source.0).collect();
        sources.sort_unstable();
        sources.dedup();
        let known = |&vertex: &u32| {
            self.report()?;
            // Those that stand for others do so in several chunks.
            let kept = self.gathered[usize::from(mirror)].get(vertex as usize);
            let gathered = match kept {
                Some(kept) => kept.get_or_init(|| gather(vertex)).clone(),
                None => gather(vertex),
            };
            Ok(gathered)
        };
        let gathered: Result<Vec<_>, Interrupted> = sources.par_iter().map(known).collect();
        let gathered = gathered?;
        let start = Instant::now();
        let receivers: Vec<Receiver> = sources.iter().map(receiver).collect();
        let mut outputs = smoothed(&receivers, &gathered);
        for (outputs, gathered) in outputs.iter_mut().zip(&gathered) {
            radiosity.add_irradiance(outputs, &gathered.lamps);
        }
        let normals: Vec<Vec3> = vertices
            .iter()
            .map(|vertex| receiver(vertex).normal)
            .collect();
        let shared: Vec<bool> = (vertices.iter())
            .map(|&vertex| self.shared[self.places[vertex as usize] as usize])
            .collect();
        // By their places in what was gathered.
        for (source, _) in stand.iter_mut().flatten() {
            *source = sources.partition_point(|other| other < source) as u32;
        }
        let receivers = Receivers {
            sources: &stand,
            normals: &normals,
            shared: &shared,
        };
        let light = compress(&outputs, &receivers, if mirror { 7 } else { 3 });
        add_time(&self.counters.bounce_nanoseconds, start);
        Ok(Some(ChunkLight { vertices, light }))
    }
}

impl Prepared<'_> {
    /// The vertices that light is gathered at for one, with their weights: of those at the places that stand
    /// for its own, the ones whose normals are nearest.
    fn gathered_for(&self, vertex: u32) -> Vec<(u32, f32)> {
        let place = self.places[vertex as usize];
        let sources = self.sparse_light.sources(place);
        if sources == [(place, 1.0)] {
            return vec![(vertex, 1.0)];
        }
        let normal = self.mesh.vertices[vertex as usize].normal;
        let cosine = |other: u32| self.mesh.vertices[other as usize].normal.dot(normal);
        let at = |place: u32| {
            let alike = self.vertices_at(place).iter().copied();
            alike.max_by(|&a, &b| cosine(a).total_cmp(&cosine(b)).then(b.cmp(&a)))
        };
        (sources.iter())
            .map(|&(source, weight)| (at(source).unwrap_or(vertex), weight))
            .collect()
    }
}

/// Whether a surface reflects so much as a mirror, rough or not, that it shows what is about it:
/// that takes more than irradiance. Where lamps light the scene, dielectrics
/// count as well: from irradiance alone they would show these lamps in every direction.
pub(super) fn mirrors(material: &format::Material, lit_by_lamps: bool) -> bool {
    /// Colours below are those of a dielectric, or twice as bright.
    const LEAST: f32 = 0.08;
    let least = if lit_by_lamps { 0.0 } else { LEAST };
    let bright = |color: &[f32; 3]| color.iter().any(|x| *x > least);
    let mirrors = |specular: &format::Specular| match (specular, specular.model()) {
        (_, Some((_, parameters))) => bright(&parameters.color),
        (format::Specular::Lobes { lobes, .. }, _) => lobes.iter().any(|lobe| bright(&lobe.f0)),
        _ => false,
    };
    match &material.surface {
        format::Surface::MetallicRoughness { metallic, .. } => lit_by_lamps || *metallic > LEAST,
        format::Surface::DiffuseSpecular { specular, .. } => mirrors(specular),
        format::Surface::Layers { layers } => layers.iter().any(|layer| mirrors(&layer.specular)),
    }
}
