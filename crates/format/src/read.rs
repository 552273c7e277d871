//! A scene from the sections of its file.

use crate::container::Reader;
use crate::geometry::{self, Places};
use crate::scene::{Metadata, both};
use crate::{
    Cluster, Error, Issue, Kind, Limits, Scene, SectionKind, Transfer, Triangle, Vertex,
    prediction, texels,
};

/// Decodes and validates a scene.
pub fn read_scene(bytes: &[u8], limits: &Limits) -> Result<Scene, Error> {
    let mut reader = Reader::new(bytes, Kind::Scene, limits)?;
    let metadata: Metadata = reader.metadata()?;
    let vertices: Vec<u8> = reader.pod(SectionKind::Vertices)?;
    let triangles: Vec<u8> = reader.pod(SectionKind::Triangles)?;
    let clusters: Vec<Cluster> = reader.pod(SectionKind::Clusters)?;
    let coefficients: Vec<u8> = reader.pod(SectionKind::Coefficients)?;
    let basis: Vec<i8> = reader.pod(SectionKind::Basis)?;
    let version = reader.version();
    let stored_texels: Vec<u8> = reader.pod(SectionKind::Texels)?;
    let mut optional = |kind| -> Result<Option<Vec<u8>>, Error> {
        let is_there = reader.has(kind);
        is_there.then(|| reader.pod(kind)).transpose()
    };
    let transfer = optional(SectionKind::Transfer)?;
    let second_uvs = optional(SectionKind::SecondUvs)?;
    reader.finish()?;
    // Images take about as long as all else.
    let images = || {
        let basis = prediction::sums(basis, metadata.visibility.basis_resolution);
        let textures = texels::decode(&metadata.textures, &stored_texels, version);
        (basis, textures)
    };
    let others = || -> Result<_, Error> {
        let triangles = decode_triangles(&triangles)?;
        let (vertices, places) = decode_vertices(&vertices, &triangles, &clusters)?;
        let coefficients = decode_coefficients(&coefficients, &triangles, &clusters, &places)?;
        let transfer = (transfer.as_ref())
            .map(|bytes| Transfer::decode(bytes, &clusters))
            .transpose()?;
        let second_uvs = match &second_uvs {
            Some(bytes) => decode_second_uvs(bytes, &triangles, vertices.len())?,
            None => Vec::new(),
        };
        Ok((triangles, vertices, coefficients, transfer, second_uvs))
    };
    let ((basis, textures), others) = both(images, others);
    let (triangles, vertices, coefficients, transfer, second_uvs) = others?;
    let scene = Scene {
        textures: textures?,
        name: metadata.name,
        visibility: metadata.visibility,
        camera: metadata.camera,
        materials: metadata.materials,
        report: metadata.report,
        vertices,
        second_uvs,
        triangles,
        clusters,
        coefficients,
        basis,
        transfer,
    };
    scene.validate()?;
    Ok(scene)
}

fn bad_length(section: SectionKind, expected: &str, bytes: &[u8]) -> Error {
    let found = format_args!("{} bytes", bytes.len());
    Error::section(Issue::BadLength, section, expected, found)
}

fn decode_triangles(bytes: &[u8]) -> Result<Vec<Triangle>, Error> {
    let decoded = geometry::decode_triangles(bytes);
    decoded.ok_or_else(|| bad_length(SectionKind::Triangles, "16 bytes per triangle", bytes))
}

fn decode_vertices(
    bytes: &[u8],
    triangles: &[Triangle],
    clusters: &[Cluster],
) -> Result<(Vec<Vertex>, Places), Error> {
    geometry::decode_vertices(bytes, triangles, clusters).ok_or_else(|| {
        let expected = "13 bytes, 40 per vertex of the clusters and 12 per place in them";
        bad_length(SectionKind::Vertices, expected, bytes)
    })
}

fn decode_coefficients(
    bytes: &[u8],
    triangles: &[Triangle],
    clusters: &[Cluster],
    places: &Places,
) -> Result<Vec<i16>, Error> {
    let decoded = geometry::decode_coefficients(bytes, triangles, clusters, places);
    decoded.ok_or_else(|| {
        let expected = "2 bytes per image of the clusters and coefficient of their places";
        bad_length(SectionKind::Coefficients, expected, bytes)
    })
}

fn decode_second_uvs(
    bytes: &[u8],
    triangles: &[Triangle],
    vertices: usize,
) -> Result<Vec<[f32; 2]>, Error> {
    geometry::decode_uvs(bytes, triangles, vertices).ok_or_else(|| {
        let expected = "2 bytes and 8 per vertex, of which there are some";
        bad_length(SectionKind::SecondUvs, expected, bytes)
    })
}
