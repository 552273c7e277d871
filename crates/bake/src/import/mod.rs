//! glTF and OBJ files to one mesh in world space, with materials and textures.
//!
//! Input is untrusted: every index and length is checked before it is used, allocations
//! are bounded by the file's own size or by [`MAX_VERTICES`] and [`MAX_IMAGE_SIZE`], and
//! whatever is wrong ends in one [`Error`] that names the file and the place. What can be
//! read but not represented is imported without it and listed in [`Mesh::warnings`].

mod build;
mod gltf;
mod image;
mod mtl;
mod obj;
#[cfg(test)]
mod tests;

use std::path::{Path, PathBuf};

use relight_format as format;

/// Most vertices, and most triangles, that an imported mesh may have.
pub const MAX_VERTICES: usize = 1 << 25;
/// Most texels per side of a texture.
pub const MAX_IMAGE_SIZE: u32 = 16384;

/// Largest absolute coordinate, so that products of three coordinates fit an f32.
pub const MAX_COORDINATE: f32 = 1e12;

/// A triangle of an imported mesh.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ImportedTriangle {
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
    pub vertices: Vec<format::Vertex>,
    /// Triangles.
    pub triangles: Vec<ImportedTriangle>,
    /// Materials; each is used by at least one triangle.
    pub materials: Vec<format::Material>,
    /// Textures that materials refer to.
    pub textures: Vec<format::Texture>,
    /// What was left out or changed, one sentence each.
    pub warnings: Vec<String>,
}

/// A material without textures.
pub fn plain_material(name: &str, surface: format::Surface) -> format::Material {
    format::Material {
        name: name.to_owned(),
        surface,
        base_color_texture: None,
        metallic_roughness_texture: None,
        normal_texture: None,
        normal_scale: 1.0,
        anisotropy_texture: None,
    }
}

/// Reads a texture, to be added to `others`.
pub(crate) fn texture(
    path: &Path,
    encoding: format::TextureEncoding,
    others: &[format::Texture],
) -> Result<format::Texture, Error> {
    let bytes = std::fs::read(path).map_err(|source| Error::read(path, source))?;
    let mut texels = others
        .iter()
        .map(|other| u64::from(other.width) * u64::from(other.height))
        .sum();
    image::decode(path, "file", &bytes, encoding, &mut texels)
}

impl Mesh {
    /// A position outside [`MAX_COORDINATE`], if any.
    pub(crate) fn distant_position(vertices: &[format::Vertex]) -> Option<[f32; 3]> {
        let mut positions = vertices.iter().map(|vertex| vertex.position);
        // Written so that NaN counts as outside.
        positions.find(|position| !position.iter().all(|x| x.abs() <= MAX_COORDINATE))
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

    /// Smallest and largest coordinates; `None` for a mesh without vertices.
    pub fn bounds(&self) -> Option<(glam::Vec3, glam::Vec3)> {
        let mut positions = self.vertices.iter().map(|v| glam::Vec3::from(v.position));
        let first = positions.next()?;
        Some(positions.fold((first, first), |(low, high), p| (low.min(p), high.max(p))))
    }

    /// Corners of every triangle.
    pub fn soup(&self) -> Vec<[glam::Vec3; 3]> {
        let position = |vertex: u32| self.vertices[vertex as usize].position.into();
        (self.triangles.iter())
            .map(|triangle| triangle.vertices.map(position))
            .collect()
    }
}

/// Why a scene file, mesh, material library or texture could not be read.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The file system refused.
    #[error("{}: cannot read: {source}", file.display())]
    Read {
        /// The file.
        file: PathBuf,
        /// The reason.
        source: std::io::Error,
    },
    /// The text does not parse.
    #[error("{}: {message}", file.display())]
    Syntax {
        /// The file.
        file: PathBuf,
        /// The parser's message, with line and column.
        message: String,
    },
    /// A value is wrong.
    #[error("{}: {place}: expected {expected}, found {found}", file.display())]
    Invalid {
        /// The file.
        file: PathBuf,
        /// The line, key or element.
        place: String,
        /// What would have been right.
        expected: String,
        /// What is there.
        found: String,
    },
    /// The file requires a glTF extension that is not supported.
    #[error("{}: requires the glTF extension {extension}, which is not supported", file.display())]
    UnsupportedExtension {
        /// The file.
        file: PathBuf,
        /// Its registered name.
        extension: String,
    },
}

impl Error {
    pub(crate) fn read(file: &Path, source: std::io::Error) -> Self {
        Self::Read {
            file: file.into(),
            source,
        }
    }

    pub(crate) fn invalid(
        file: &Path,
        place: impl std::fmt::Display,
        expected: impl std::fmt::Display,
        found: impl std::fmt::Display,
    ) -> Self {
        Self::Invalid {
            file: file.into(),
            place: place.to_string(),
            expected: expected.to_string(),
            found: found.to_string(),
        }
    }
}

/// Imports a `.gltf`, `.glb` or `.obj` file.
pub fn mesh(path: &Path) -> Result<Mesh, Error> {
    let extension = path.extension().and_then(|extension| extension.to_str());
    let read = || std::fs::read(path).map_err(|source| Error::read(path, source));
    match extension.map(str::to_ascii_lowercase).as_deref() {
        Some("gltf" | "glb") => gltf::import(path, &read()?),
        Some("obj") => obj::import(path, &read()?),
        other => Err(Error::invalid(
            path,
            "file name",
            ".gltf, .glb or .obj",
            other.map_or_else(
                || "no extension".into(),
                |extension| format!(".{extension}"),
            ),
        )),
    }
}
