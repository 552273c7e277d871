//! glTF 2.0, `.gltf` and `.glb`.
//!
//! The `gltf` crate's JSON types are used, its accessors and validation are not: the former
//! index without bounds checks and the latter refuses `KHR_mesh_quantization`.

mod accessors;
mod materials;
mod meshes;

use std::borrow::Cow;
use std::path::Path;

use base64::Engine as _;
use base64::alphabet;
use base64::engine::{DecodePaddingMode, GeneralPurpose, GeneralPurposeConfig};
use gltf::json::{Index, Root, root::Get};
use percent_encoding::percent_decode_str;
use serde::Deserialize;

use self::materials::Materials;
use super::build::Builder;
use super::{Error, Options};
use crate::files::Files;
use crate::mesh::Mesh;

/// Extensions that change nothing, or only what this product does not show: lights,
/// alternative materials, metadata.
const HARMLESS: [&str; 5] = [
    "KHR_lights_punctual",
    "KHR_materials_variants",
    "KHR_xmp",
    "KHR_xmp_json_ld",
    "EXT_structural_metadata",
];
/// Extensions that are read.
const READ: [&str; 6] = [
    materials::EMISSIVE_STRENGTH,
    materials::WEBP,
    meshes::INSTANCING,
    "KHR_materials_anisotropy",
    "KHR_mesh_quantization",
    "KHR_texture_transform",
];

/// Imports the bytes of a glTF file and what it refers to.
pub(super) fn import(
    files: &Files,
    file: &Path,
    options: &Options,
    bytes: &[u8],
) -> Result<Mesh, Error> {
    let (json, blob) = split_glb(file, bytes)?;
    let syntax = |error: serde_json::Error| Error::Syntax {
        file: file.into(),
        message: error.to_string(),
    };
    let header: Header = serde_json::from_slice(json).map_err(syntax)?;
    let AssetHeader {
        version,
        min_version,
    } = &header.asset;
    if !version.starts_with("2.") {
        let found = format!("{version:?}");
        return Err(Error::invalid(file, "asset.version", "\"2.0\"", found));
    }
    // A reader of an older version must not load the file (glTF 2.0, 3.2).
    if let Some(least) = min_version
        && least != "2.0"
    {
        let found = format!("{least:?}");
        return Err(Error::invalid(
            file,
            "asset.minVersion",
            "\"2.0\" or none",
            found,
        ));
    }
    let known = |name: &str| HARMLESS.contains(&name) || READ.contains(&name);
    if let Some(extension) = header
        .extensions_required
        .into_iter()
        .find(|name| !known(name))
    {
        return Err(Error::UnsupportedExtension {
            file: file.into(),
            hint: conversion(&extension),
            extension,
        });
    }
    let root: Root = serde_json::from_slice(json).map_err(syntax)?;
    let buffers = load_buffers(files, file, &root, blob)?;
    let document = Document {
        files,
        file,
        root: &root,
        buffers,
    };
    let mut builder = Builder::new(file, options, files.max_vertices());
    for extension in root.extensions_used.iter().filter(|name| !known(name)) {
        builder.warn(format!(
            "the glTF extension {extension} is not supported and left out"
        ));
    }
    let mut materials = Materials::new(&document);
    for (node, matrix) in document.nodes()? {
        document.push_node(node, matrix, &mut materials, &mut builder)?;
    }
    let descriptions: Vec<_> = materials
        .list
        .into_iter()
        .map(|converted| converted.material)
        .collect();
    builder.finish(&descriptions, &materials.textures)
}

/// How to do without an extension: commands of the glTF-Transform project.
fn conversion(extension: &str) -> &'static str {
    match extension {
        "KHR_draco_mesh_compression" | "EXT_meshopt_compression" => {
            "; `gltf-transform copy IN.glb OUT.glb` writes the mesh without compression"
        }
        materials::BASISU => {
            "; `gltf-transform ktxdecompress IN.glb OUT.glb` writes its textures as PNG"
        }
        _ => "",
    }
}

/// What must be known before the rest can be parsed.
#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct Header {
    asset: AssetHeader,
    #[serde(default)]
    extensions_required: Vec<String>,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct AssetHeader {
    version: String,
    min_version: Option<String>,
}

/// The JSON chunk and the binary chunk of a `.glb`; a `.gltf` is all JSON.
fn split_glb<'a>(file: &Path, bytes: &'a [u8]) -> Result<(&'a [u8], Option<&'a [u8]>), Error> {
    if !bytes.starts_with(b"glTF") {
        return Ok((bytes, None));
    }
    let word = |offset: usize| {
        let word = bytes.get(offset..offset.checked_add(4)?)?;
        Some(u32::from_le_bytes(word.try_into().ok()?))
    };
    if word(4) != Some(2) {
        let found = word(4).map_or("the end of the file".into(), |version| version.to_string());
        return Err(Error::invalid(file, "GLB header", "version 2", found));
    }
    let chunk = |offset: usize, kind: &[u8; 4]| {
        let length = word(offset)? as usize;
        let start = offset.checked_add(8)?;
        (bytes.get(offset + 4..start)? == kind).then_some(())?;
        bytes.get(start..start.checked_add(length)?)
    };
    let Some(json) = chunk(12, b"JSON") else {
        return Err(Error::invalid(
            file,
            "GLB, byte 12",
            "a whole JSON chunk",
            format_args!("a file of {} bytes without it", bytes.len()),
        ));
    };
    let next = 20 + json.len();
    if bytes.len() <= next {
        return Ok((json, None));
    }
    let Some(blob) = chunk(next, b"BIN\0") else {
        return Err(Error::invalid(
            file,
            format_args!("GLB, byte {next}"),
            "a whole BIN chunk",
            format_args!("a file of {} bytes without it", bytes.len()),
        ));
    };
    Ok((json, Some(blob)))
}

fn load_buffers<'a>(
    files: &Files,
    file: &Path,
    root: &Root,
    blob: Option<&'a [u8]>,
) -> Result<Vec<Cow<'a, [u8]>>, Error> {
    root.buffers
        .iter()
        .enumerate()
        .map(|(index, buffer)| {
            let place = format!("buffers[{index}]");
            let bytes = match (&buffer.uri, blob) {
                (Some(uri), _) => Cow::Owned(resolve(files, file, &place, uri)?),
                (None, Some(blob)) if index == 0 => Cow::Borrowed(blob),
                (None, _) => {
                    return Err(Error::invalid(
                        file,
                        place,
                        "a uri or a GLB chunk",
                        "neither",
                    ));
                }
            };
            if (bytes.len() as u64) < buffer.byte_length.0 {
                return Err(Error::invalid(
                    file,
                    place,
                    format_args!("{} bytes", buffer.byte_length.0),
                    format_args!("{} bytes", bytes.len()),
                ));
            }
            Ok(bytes)
        })
        .collect()
}

/// The bytes that a URI stands for: a base64 `data:` URI or a path relative to the file.
fn resolve(files: &Files, file: &Path, place: &str, uri: &str) -> Result<Vec<u8>, Error> {
    let wrong = |found: &str| Error::invalid(file, place, "a relative or base64 data URI", found);
    if let Some(data) = uri.strip_prefix("data:") {
        let (kind, text) = data
            .split_once(',')
            .ok_or_else(|| wrong("a data URI without data"))?;
        let decoded = kind
            .ends_with(";base64")
            .then(|| decode_base64(text))
            .flatten();
        return decoded.ok_or_else(|| wrong("a malformed data URI"));
    }
    let decoded = percent_decode_str(uri).decode_utf8().ok();
    let decoded = decoded.filter(|path| !path.contains(':') && !path.is_empty());
    let path = decoded.ok_or_else(|| wrong(&format!("{uri:?}")))?;
    let path = file.parent().unwrap_or(Path::new("")).join(&*path);
    files.read(&path)
}

fn decode_base64(text: &str) -> Option<Vec<u8>> {
    // Files exist whose padding is missing or whose last character has bits to spare.
    let lenient = GeneralPurposeConfig::new()
        .with_decode_padding_mode(DecodePaddingMode::RequireNone)
        .with_decode_allow_trailing_bits(true);
    let engine = GeneralPurpose::new(&alphabet::STANDARD, lenient);
    engine.decode(text.trim_end_matches('=')).ok()
}

/// The parsed file and its buffers.
struct Document<'a> {
    files: &'a Files,
    file: &'a Path,
    root: &'a Root,
    buffers: Vec<Cow<'a, [u8]>>,
}

impl Document<'_> {
    fn invalid(
        &self,
        place: impl std::fmt::Display,
        expected: impl std::fmt::Display,
        found: impl std::fmt::Display,
    ) -> Error {
        Error::invalid(self.file, place, expected, found)
    }

    fn get<T>(&self, index: Index<T>, place: &str) -> Result<&T, Error>
    where
        Root: Get<T>,
    {
        self.root
            .get(index)
            .ok_or_else(|| self.invalid(place, "the index of an existing element", index.value()))
    }
}
