//! Geometry, materials and compressed visibility.

use std::panic::resume_unwind;

use bytemuck::{Pod, Zeroable};
use serde::{Deserialize, Serialize};

use crate::container::{Kind, SectionKind, Writer};
use crate::geometry::{self, Places};
use crate::material::TextureShape;
use crate::prediction;
use crate::texels;
use crate::transfer::Transfer;
use crate::{Camera, Error, Issue, Material, Texture};

/// Basis images per tile: one per channel of an RGBA texel.
pub const CHANNELS_PER_TILE: usize = 4;
/// Most tiles a cluster may have: 32 basis images, the mean among them.
pub const MAX_TILES_PER_CLUSTER: u32 = 8;

/// One vertex. Vertices that several clusters share are stored once per cluster.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct Vertex {
    /// World space, metres.
    pub position: [f32; 3],
    /// Shading normal; unit length at original vertices, the plain average of its
    /// neighbours at vertices that refinement added, so that interpolation is unchanged.
    pub normal: [f32; 3],
    /// xyz: tangent, w: sign of the bitangent `cross(normal, tangent) * w`.
    pub tangent: [f32; 4],
    /// Texture coordinates, v down as in glTF.
    pub uv: [f32; 2],
}

/// One triangle: counter-clockwise vertices seen from outside. All three vertices belong
/// to `cluster`.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq, Pod, Zeroable)]
pub struct Triangle {
    /// Indices into [`Scene::vertices`].
    pub vertices: [u32; 3],
    /// Index into [`Scene::materials`].
    pub material: u16,
    /// Index into [`Scene::clusters`].
    pub cluster: u16,
}

/// A set of vertices that share basis images. Clusters tile the vertex array, the
/// coefficient array and the basis array in order, without gaps.
///
/// The SSDF of the cluster's vertex `v` (0-based within the cluster) in direction ω is
/// `Σ_c coefficient(v, c) · coefficient_scale · basis_c(ω)`, in radians, where
/// `coefficient` is `i16 / 32767`, `basis_c` the bilinear sample of `i8 / 127` and c runs
/// over all `4 · tiles` channels.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct Cluster {
    /// First vertex.
    pub first_vertex: u32,
    /// Number of vertices.
    pub vertex_count: u32,
    /// First coefficient: `vertex_count * 4 * tiles` of them, vertex after vertex.
    pub first_coefficient: u32,
    /// First tile: `tiles` of them.
    pub first_tile: u32,
    /// Tiles of four basis images, 1 to [`MAX_TILES_PER_CLUSTER`].
    pub tiles: u32,
    /// Radians that a coefficient of 32767 stands for.
    pub coefficient_scale: f32,
}

/// How visibility is represented.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub enum Representation {
    /// A mean and basis per cluster of vertices (Sloan et al. 2003).
    ClusteredPca,
    /// One mean and basis for the whole scene (Wang et al. 2013).
    GlobalPca,
}

/// What visibility was sampled from and how it is stored.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct VisibilityParameters {
    /// How it is represented.
    pub representation: Representation,
    /// Texels per side of the octahedral map that rays sampled.
    pub sample_resolution: u32,
    /// Texels per side of a basis image.
    pub basis_resolution: u32,
    /// SSDFs are clamped to ± this angle, radians.
    pub distance_clamp: f32,
    /// Rays start this far from the surface along the geometric normal, metres.
    pub ray_offset: f32,
}

/// What the bake measured about itself.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BakeReport {
    /// Vertices read from the mesh.
    pub source_vertices: u64,
    /// Triangles read from the mesh.
    pub source_triangles: u64,
    /// How far visibility is off.
    pub errors: VisibilityErrors,
    /// Warnings, as printed.
    pub warnings: Vec<String>,
}

/// How far visibility boundaries are off: root mean squares, radians. An error counts as much
/// as that of a vertical wall whose edge is off by this angle.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct VisibilityErrors {
    /// All over the surface, of stored distances, interpolated between vertices: what is
    /// shaded. Where things are small beside the scene, area counts in that of what is there.
    pub surface: f32,
    /// The same of distances that are exact at vertices: what compression has no part in.
    pub interpolation: f32,
    /// At vertices, of stored distances.
    pub compression: f32,
    /// Of the place where distances, interpolated between texels, vanish; in none of the
    /// above.
    pub resolution: f32,
}

/// A decoded scene asset.
#[derive(Clone, Debug, PartialEq)]
pub struct Scene {
    /// Name, from the input file.
    pub name: String,
    /// Visibility parameters.
    pub visibility: VisibilityParameters,
    /// The camera of the scene file, if any.
    pub camera: Option<Camera>,
    /// Materials.
    pub materials: Vec<Material>,
    /// Textures.
    pub textures: Vec<Texture>,
    /// What the bake measured.
    pub report: BakeReport,
    /// Vertices, cluster after cluster.
    pub vertices: Vec<Vertex>,
    /// Second texture coordinates of every vertex, v down, where a texture is looked up by them
    /// ([`crate::TextureSlot::second_uv`]); else empty.
    pub second_uvs: Vec<[f32; 2]>,
    /// Triangles, cluster after cluster.
    pub triangles: Vec<Triangle>,
    /// Clusters.
    pub clusters: Vec<Cluster>,
    /// SSDF coefficients.
    pub coefficients: Vec<i16>,
    /// Basis tiles: `basis_resolution²` RGBA texels each, row 0 first, no gutter.
    pub basis: Vec<i8>,
    /// Light that bounces, where the bake has it.
    pub transfer: Option<Transfer>,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Metadata {
    pub(crate) name: String,
    pub(crate) visibility: VisibilityParameters,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) camera: Option<Camera>,
    pub(crate) materials: Vec<Material>,
    pub(crate) textures: Vec<TextureShape>,
    pub(crate) report: BakeReport,
}

/// The texels of a scene's textures as its file stores them. Compressing them takes about as long as compressing all else, and can
/// be done as soon as the textures are known: see [`write_scene_with`].
pub struct StoredTexels {
    section: Writer,
    /// Of each texture.
    lengths: Vec<usize>,
}

impl StoredTexels {
    /// Compresses the texels of all textures of a scene.
    pub fn new(textures: &[Texture]) -> Result<Self, Error> {
        let mut section = Writer::new(Kind::Scene);
        section.section(SectionKind::Texels, &texels::encode(textures))?;
        Ok(Self {
            section,
            lengths: lengths(textures),
        })
    }
}

fn lengths(textures: &[Texture]) -> Vec<usize> {
    textures
        .iter()
        .map(|texture| texture.texels.len())
        .collect()
}

/// Encodes a scene; the same value gives the same bytes.
pub fn write_scene(scene: &Scene) -> Result<Vec<u8>, Error> {
    scene.validate()?;
    // Texels and images take about as long as all else.
    let (others, texels) = both(
        || other_sections(scene),
        || StoredTexels::new(&scene.textures),
    );
    Ok(whole(others?, texels?))
}

/// The same bytes in less time, with texels that are compressed already.
///
/// # Panics
///
/// If they are of textures of other sizes.
pub fn write_scene_with(scene: &Scene, texels: StoredTexels) -> Result<Vec<u8>, Error> {
    scene.validate()?;
    assert_eq!(
        texels.lengths,
        lengths(&scene.textures),
        "texels of other textures"
    );
    Ok(whole(other_sections(scene)?, texels))
}

/// Sections before the basis images, these, and those after the texels.
fn other_sections(scene: &Scene) -> Result<[Writer; 3], Error> {
    let (others, basis) = both(
        || Ok([early_sections(scene)?, late_sections(scene)?]),
        || basis_section(scene),
    );
    let [early, late] = others?;
    Ok([early, basis?, late])
}

fn whole([early, basis, late]: [Writer; 3], texels: StoredTexels) -> Vec<u8> {
    let images = basis.followed_by(texels.section);
    early.followed_by(images).followed_by(late).finish()
}

/// Does two things at the same time, where there are threads to be had.
pub(crate) fn both<A, B: Send>(first: impl FnOnce() -> A, second: impl Fn() -> B + Sync) -> (A, B) {
    std::thread::scope(|scope| {
        let thread = std::thread::Builder::new().spawn_scoped(scope, &second);
        let first = first();
        let second = match thread {
            Ok(thread) => thread.join().unwrap_or_else(|panic| resume_unwind(panic)),
            // WebAssembly has none.
            Err(_) => second(),
        };
        (first, second)
    })
}

/// What comes before images.
fn early_sections(scene: &Scene) -> Result<Writer, Error> {
    let mut writer = Writer::new(Kind::Scene);
    writer.metadata(&Metadata {
        name: scene.name.clone(),
        visibility: scene.visibility.clone(),
        camera: scene.camera,
        materials: scene.materials.clone(),
        textures: scene.textures.iter().map(Texture::shape).collect(),
        report: scene.report.clone(),
    })?;
    let places = Places::find(&scene.vertices, &scene.clusters, &scene.coefficients);
    let vertices = geometry::encode_vertices(&scene.vertices, &scene.triangles, &places);
    writer.section(SectionKind::Vertices, &vertices)?;
    let triangles = geometry::encode_triangles(&scene.triangles);
    writer.section(SectionKind::Triangles, &triangles)?;
    writer.section(SectionKind::Clusters, &scene.clusters)?;
    let coefficients = geometry::encode_coefficients(
        &scene.coefficients,
        &scene.triangles,
        &scene.clusters,
        &places,
    );
    writer.section(SectionKind::Coefficients, &coefficients)?;
    Ok(writer)
}

fn basis_section(scene: &Scene) -> Result<Writer, Error> {
    let mut writer = Writer::new(Kind::Scene);
    let resolution = scene.visibility.basis_resolution;
    let differences = prediction::differences(&scene.basis, resolution);
    writer.section(SectionKind::Basis, &differences)?;
    Ok(writer)
}

/// What comes after them.
fn late_sections(scene: &Scene) -> Result<Writer, Error> {
    let mut writer = Writer::new(Kind::Scene);
    if let Some(transfer) = &scene.transfer {
        writer.section(SectionKind::Transfer, &transfer.encode(&scene.clusters))?;
    }
    if !scene.second_uvs.is_empty() {
        let uvs = geometry::encode_uvs(&scene.second_uvs, &scene.triangles);
        writer.section(SectionKind::SecondUvs, &uvs)?;
    }
    Ok(writer)
}

impl Scene {
    /// Checks that every number, length and index is in its range, as it is where an asset is read.
    pub fn validate(&self) -> Result<(), Error> {
        validate_metadata(self)?;
        for (index, vertex) in self.vertices.iter().enumerate() {
            let values: &[f32] = bytemuck::cast_slice(std::slice::from_ref(vertex));
            if !values.iter().all(|value| value.is_finite()) {
                return Err(Error::section(
                    Issue::ValueOutOfRange,
                    SectionKind::Vertices,
                    "finite numbers",
                    format_args!("vertex {index}: {vertex:?}"),
                ));
            }
        }
        validate_second_uvs(self)?;
        validate_clusters(self)?;
        if let Some(transfer) = &self.transfer {
            transfer.validate(&self.clusters)?;
        }
        for (index, triangle) in self.triangles.iter().enumerate() {
            let cluster = self.clusters.get(triangle.cluster as usize);
            let inside = cluster.is_some_and(|cluster| {
                let within = |vertex: &u32| {
                    vertex
                        .checked_sub(cluster.first_vertex)
                        .is_some_and(|v| v < cluster.vertex_count)
                };
                triangle.vertices.iter().all(within)
            });
            if !inside || triangle.material as usize >= self.materials.len() {
                return Err(Error::section(
                    Issue::IndexOutOfRange,
                    SectionKind::Triangles,
                    "vertices of its own cluster and an existing material",
                    format_args!("triangle {index}: {triangle:?}"),
                ));
            }
        }
        Ok(())
    }
}

fn validate_second_uvs(scene: &Scene) -> Result<(), Error> {
    let (found, vertices) = (scene.second_uvs.len(), scene.vertices.len());
    if found != 0 && found != vertices {
        return Err(Error::section(
            Issue::BadLength,
            SectionKind::SecondUvs,
            format_args!("none, or one pair for each of {vertices} vertices"),
            format_args!("{found} pairs"),
        ));
    }
    for (index, uv) in scene.second_uvs.iter().enumerate() {
        if !uv.iter().all(|value| value.is_finite()) {
            return Err(Error::section(
                Issue::ValueOutOfRange,
                SectionKind::SecondUvs,
                "finite numbers",
                format_args!("vertex {index}: {uv:?}"),
            ));
        }
    }
    Ok(())
}

fn validate_metadata(scene: &Scene) -> Result<(), Error> {
    let metadata = |issue, expected: &str, found: std::fmt::Arguments| {
        Err(Error::section(
            issue,
            SectionKind::Metadata,
            expected,
            found,
        ))
    };
    let parameters = &scene.visibility;
    let valid = (1..=4096).contains(&parameters.sample_resolution)
        && (2..=1024).contains(&parameters.basis_resolution)
        && parameters.distance_clamp > 0.0
        && parameters.distance_clamp <= std::f32::consts::PI
        && parameters.ray_offset >= 0.0
        && parameters.ray_offset.is_finite();
    if !valid {
        return metadata(
            Issue::ValueOutOfRange,
            "sample resolution 1..=4096, basis resolution 2..=1024, clamp in (0, pi], offset >= 0",
            format_args!("{parameters:?}"),
        );
    }
    let shapes: Vec<_> = scene.textures.iter().map(Texture::shape).collect();
    for material in &scene.materials {
        // The head of a scene, without vertices yet, may have its materials.
        material.validate(&shapes, scene.second_uvs.len() == scene.vertices.len())?;
    }
    validate_textures(&scene.textures)?;
    let errors = &scene.report.errors;
    let valid = [
        errors.surface,
        errors.interpolation,
        errors.compression,
        errors.resolution,
    ]
    .iter()
    .all(|error| error.is_finite() && *error >= 0.0);
    if !valid {
        return metadata(
            Issue::ValueOutOfRange,
            "finite errors >= 0",
            format_args!("{errors:?}"),
        );
    }
    if let Some(camera) = &scene.camera {
        let (crate::FieldOfView::X(angle) | crate::FieldOfView::Y(angle)) = camera.field_of_view;
        let vectors = [camera.position, camera.target, camera.up];
        let finite = vectors.iter().flatten().all(|value| value.is_finite());
        if !(finite && angle > 0.0 && angle < std::f32::consts::PI) {
            return metadata(
                Issue::ValueOutOfRange,
                "a finite camera with a field of view in (0, pi)",
                format_args!("{camera:?}"),
            );
        }
    }
    Ok(())
}

pub(crate) fn validate_textures(textures: &[Texture]) -> Result<(), Error> {
    for (index, texture) in textures.iter().enumerate() {
        if texels::texel_bytes(texture.width, texture.height) != Some(texture.texels.len()) {
            return Err(Error::section(
                Issue::BadLength,
                SectionKind::Metadata,
                "4 bytes per texel, at least one texel",
                format_args!(
                    "{} bytes in texture {index} of {}x{} texels",
                    texture.texels.len(),
                    texture.width,
                    texture.height
                ),
            ));
        }
    }
    Ok(())
}

fn validate_clusters(scene: &Scene) -> Result<(), Error> {
    let resolution = scene.visibility.basis_resolution as usize;
    let tile_length = resolution * resolution * CHANNELS_PER_TILE;
    let (mut vertex, mut coefficient, mut tile) = (0u64, 0u64, 0u64);
    for (index, cluster) in scene.clusters.iter().enumerate() {
        let valid = u64::from(cluster.first_vertex) == vertex
            && u64::from(cluster.first_coefficient) == coefficient
            && u64::from(cluster.first_tile) == tile
            && (1..=MAX_TILES_PER_CLUSTER).contains(&cluster.tiles)
            && cluster.coefficient_scale.is_finite()
            && cluster.coefficient_scale >= 0.0;
        if !valid {
            return Err(Error::section(
                Issue::ValueOutOfRange,
                SectionKind::Clusters,
                format_args!("first vertex {vertex}, coefficient {coefficient}, tile {tile}"),
                format_args!("cluster {index}: {cluster:?}"),
            ));
        }
        let channels = u64::from(cluster.tiles) * CHANNELS_PER_TILE as u64;
        vertex += u64::from(cluster.vertex_count);
        coefficient += u64::from(cluster.vertex_count) * channels;
        tile += u64::from(cluster.tiles);
    }
    let lengths = [
        (SectionKind::Vertices, vertex, scene.vertices.len()),
        (
            SectionKind::Coefficients,
            coefficient,
            scene.coefficients.len(),
        ),
        (
            SectionKind::Basis,
            tile * tile_length as u64,
            scene.basis.len(),
        ),
    ];
    for (section, expected, found) in lengths {
        if expected != found as u64 {
            return Err(Error::section(
                Issue::BadLength,
                section,
                format_args!("{expected} elements, as the clusters say"),
                found,
            ));
        }
    }
    // −1 is the least value that both signed normalised encodings mean the same by
    // everywhere; one step below it is clamped by some decoders and not by others.
    let below_minus_one = [
        (
            SectionKind::Coefficients,
            scene.coefficients.iter().position(|x| *x == i16::MIN),
        ),
        (
            SectionKind::Basis,
            scene.basis.iter().position(|x| *x == i8::MIN),
        ),
    ];
    for (section, position) in below_minus_one {
        if let Some(position) = position {
            return Err(Error::section(
                Issue::ValueOutOfRange,
                section,
                "signed normalised values of at least -1",
                format_args!("less at element {position}"),
            ));
        }
    }
    if scene.clusters.len() > usize::from(u16::MAX) {
        return Err(Error::section(
            Issue::OverBudget,
            SectionKind::Clusters,
            format_args!("at most {} clusters", u16::MAX),
            scene.clusters.len(),
        ));
    }
    Ok(())
}
