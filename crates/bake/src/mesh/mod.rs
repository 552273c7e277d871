//! The triangles between import and sampling: tangents, an optional ground, vertices where
//! shadows need them, and the clusters that visibility is compressed by.

pub(crate) mod cluster;
pub mod ground;
pub(crate) mod orient;
pub(crate) mod refine;
pub(crate) mod size;
pub(crate) mod tangent;

use glam::{Vec2, Vec3};
use relight_format as format;

/// Largest absolute coordinate, so that products of three coordinates fit an f32.
pub(crate) const MAX_COORDINATE: f32 = 1e12;

/// A vertex with its frame.
#[derive(Clone, Copy, Debug, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
#[repr(C)]
pub struct Vertex {
    /// World space, metres.
    pub position: Vec3,
    /// Shading normal.
    pub normal: Vec3,
    /// Where the texture coordinate u grows.
    pub tangent: Vec3,
    /// 1 or −1: the bitangent is `cross(normal, tangent)` times this.
    pub bitangent_sign: f32,
    /// Texture coordinates; v points down, as rows of an image do.
    pub uv: Vec2,
    /// The others of a material whose textures use two sets; else zero.
    pub second_uv: Vec2,
}

impl From<Vertex> for format::Vertex {
    fn from(vertex: Vertex) -> Self {
        Self {
            position: vertex.position.into(),
            normal: vertex.normal.into(),
            tangent: vertex.tangent.extend(vertex.bitangent_sign).into(),
            uv: vertex.uv.into(),
        }
    }
}

/// Three vertices and what lies between them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Triangle {
    /// Indices into [`Mesh::vertices`], counter-clockwise seen from outside.
    pub vertices: [u32; 3],
    /// Index into [`Mesh::materials`].
    pub material: u16,
}

/// Triangles in world space. Imported meshes hold only finite numbers, unit normals, unit
/// tangents orthogonal to them, and no triangle of zero area.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Mesh {
    /// Vertices; each is used by at least one triangle.
    pub vertices: Vec<Vertex>,
    /// Triangles.
    pub triangles: Vec<Triangle>,
    /// Materials; each is used by at least one triangle.
    pub materials: Vec<format::Material>,
    /// Textures that materials refer to.
    pub textures: Vec<format::Texture>,
    /// What was left out or changed, one sentence each.
    pub warnings: Vec<String>,
}

impl Mesh {
    /// Position of every vertex, metres.
    pub fn positions(&self) -> Vec<Vec3> {
        self.vertices.iter().map(|v| v.position).collect()
    }

    /// Vertices of every triangle.
    pub fn indices(&self) -> Vec<[u32; 3]> {
        self.triangles.iter().map(|t| t.vertices).collect()
    }

    /// Whether a texture is looked up by second texture coordinates.
    pub(crate) fn has_second_uvs(&self) -> bool {
        self.materials.iter().any(format::Material::uses_second_uv)
    }

    /// Corners of a triangle, metres.
    pub(crate) fn corners(&self, triangle: &Triangle) -> [Vec3; 3] {
        (triangle.vertices).map(|vertex| self.vertices[vertex as usize].position)
    }

    /// Corners of every triangle, metres.
    pub fn soup(&self) -> Vec<[Vec3; 3]> {
        self.triangles.iter().map(|t| self.corners(t)).collect()
    }

    /// Smallest and largest coordinates; `None` for a mesh without vertices.
    pub fn bounds(&self) -> Option<(Vec3, Vec3)> {
        let mut positions = self.vertices.iter().map(|vertex| vertex.position);
        let first = positions.next()?;
        Some(positions.fold((first, first), |(low, high), p| (low.min(p), high.max(p))))
    }

    /// Diagonal of the bounding box, metres; zero for a mesh without vertices.
    pub fn diagonal(&self) -> f32 {
        self.bounds().map_or(0.0, |(low, high)| low.distance(high))
    }

    /// Removes textures that no material refers to.
    pub(crate) fn drop_unused_textures(&mut self) {
        let mut moved: Vec<Option<u32>> = vec![None; self.textures.len()];
        let mut textures = Vec::new();
        for material in &mut self.materials {
            for slot in material.slots_mut() {
                let old = slot.texture as usize;
                slot.texture = *moved[old].get_or_insert_with(|| {
                    textures.push(self.textures[old].clone());
                    textures.len() as u32 - 1
                });
            }
        }
        self.textures = textures;
    }
}

/// A position with a coordinate beyond [`MAX_COORDINATE`], if any.
pub(crate) fn distant_position(mut positions: impl Iterator<Item = Vec3>) -> Option<Vec3> {
    // Written so that NaN counts as outside.
    positions.find(|position| !position.abs().cmple(Vec3::splat(MAX_COORDINATE)).all())
}
