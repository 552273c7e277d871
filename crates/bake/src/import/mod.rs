//! glTF and OBJ files to one mesh in world space, with materials and textures.
//!
//! Input is untrusted: every index and length is checked before it is used, allocations
//! are bounded by the file's own size or by [`Access`] and [`MAX_IMAGE_SIZE`], other files are
//! read only where [`Files`] allows it, and whatever is wrong ends in one [`Error`] that names the file and the place. What can be
//! read but not represented is imported without it and listed in [`Mesh::warnings`].

mod build;
mod colors;
mod cutout;
mod gltf;
mod image;
mod mtl;
mod obj;
#[cfg(test)]
mod tests;

use std::collections::BTreeMap;
use std::path::Path;

use relight_format as format;
pub use relight_format::plain_material;

pub use crate::error::Error;
use crate::files::{Access, Files};
use crate::mesh::Mesh;

/// What a mesh does not say itself.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Options {
    /// Alpha, by the name of a material, below which it is cut away, in place of what the file
    /// says; 0 keeps all of it.
    pub cutoffs: BTreeMap<String, f32>,
    /// Degrees; where an OBJ file has neither normals nor smoothing groups, faces that bend by
    /// more meet at a hard edge. [`DEFAULT_CREASE_DEGREES`] where there is none.
    pub crease_degrees: Option<f32>,
    /// Triangles that alpha masks leave, about: where there would be more, outlines get coarser, as far as they still enclose nearly as
    /// much. As fine as a picture of the whole mesh can show where there is none.
    pub cut_triangles: Option<usize>,
}

/// Boxes are flat and scans smooth.
pub const DEFAULT_CREASE_DEGREES: f32 = 80.0;

/// Most texels per side of a texture.
pub const MAX_IMAGE_SIZE: u32 = 16384;

/// Decodes a texture, to be added to `others`.
pub(crate) fn texture(
    files: &Files,
    path: &Path,
    bytes: &[u8],
    encoding: format::TextureEncoding,
    others: &[format::Texture],
) -> Result<format::Texture, Error> {
    let mut texels = others
        .iter()
        .map(|other| u64::from(other.width) * u64::from(other.height))
        .sum();
    let most = files.access().max_texels;
    image::decode(path, "file", bytes, encoding, &mut texels, most)
}

/// Imports a `.gltf`, `.glb` or `.obj` file that the command line names, and what it refers to
/// in its own folder.
pub fn mesh(path: &Path) -> Result<Mesh, Error> {
    let files = Files::new(path, &Access::default())?;
    mesh_of(&files, path, &Options::default(), || files.read_named(path))
}

/// Imports the file at `path`, whose bytes `read` gives, and what it refers to, from `files`.
pub fn mesh_of(
    files: &Files,
    path: &Path,
    options: &Options,
    read: impl FnOnce() -> Result<Vec<u8>, Error>,
) -> Result<Mesh, Error> {
    match ending(path) {
        Ok(Ending::Gltf) => gltf::import(files, path, options, &read()?),
        Ok(Ending::Obj) => obj::import(files, path, options, &read()?),
        Err(found) => Err(Error::invalid(path, "file name", ENDINGS, found)),
    }
}

/// How names of meshes end, for messages.
pub(crate) const ENDINGS: &str = ".gltf, .glb or .obj";

/// How the name of a mesh ends.
pub(crate) enum Ending {
    Gltf,
    Obj,
}

/// How a name ends; or, where that is not as a mesh's, what it has in its place.
pub(crate) fn ending(path: &Path) -> Result<Ending, String> {
    let extension = path.extension().and_then(|extension| extension.to_str());
    match extension.map(str::to_ascii_lowercase).as_deref() {
        Some("gltf" | "glb") => Ok(Ending::Gltf),
        Some("obj") => Ok(Ending::Obj),
        Some(other) => Err(format!(".{other}")),
        None => Err("no extension".into()),
    }
}
