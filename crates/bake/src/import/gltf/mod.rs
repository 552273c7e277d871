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
use crate::error::{Objection, first_bytes, of_parser};
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
    let syntax = |error: serde_json::Error| of_json(&error, json).in_file(file);
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
        return Err(unsupported(file, "extensionsRequired", &extension));
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

fn unsupported(file: &Path, place: &str, extension: &str) -> Error {
    let expected = format!("extensions that are supported{}", conversion(extension));
    Error::invalid(file, place, expected, extension)
}

/// How to do without an extension: commands of the glTF-Transform project.
fn conversion(extension: &str) -> &'static str {
    match extension {
        "KHR_draco_mesh_compression" | "EXT_meshopt_compression" => {
            " (`gltf-transform copy IN.glb OUT.glb` writes the mesh without compression)"
        }
        materials::BASISU => {
            " (`gltf-transform ktxdecompress IN.glb OUT.glb` writes its textures as PNG)"
        }
        _ => "",
    }
}

/// What `serde_json` objects to. It says what it expected or what it found, or both.
fn of_json(error: &serde_json::Error, json: &[u8]) -> Objection {
    let at = [error.line(), error.column()];
    let message = error.to_string();
    let message = (message.rsplit_once(" at line ")).map_or(message.as_str(), |(text, _)| text);
    let mut objection = of_parser(at, "glTF 2.0", message);
    if error.is_eof() {
        objection.found = "the end of the file".into();
    } else if let Some(expected) = message.strip_prefix("expected ") {
        let line = json
            .split(|&byte| byte == b'\n')
            .nth(at[0].saturating_sub(1));
        let rest = line.and_then(|line| line.get(at[1].saturating_sub(1)..));
        objection.found = first_bytes(rest.unwrap_or_default());
        expected.clone_into(&mut objection.expected);
    }
    objection
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

/// The JSON chunk and the binary chunk of a `.glb`; a `.gltf` is all JSON, by whatever name.
fn split_glb<'a>(file: &Path, bytes: &'a [u8]) -> Result<(&'a [u8], Option<&'a [u8]>), Error> {
    const HEADER: &str = "GLB header";
    const MAGIC: &[u8] = b"glTF";
    if !bytes.starts_with(MAGIC) {
        if bytes.trim_ascii_start().starts_with(b"{") {
            return Ok((bytes, None));
        }
        let expected = "\"glTF\" of a .glb or \"{\" of a .gltf";
        let found = first_bytes(bytes);
        return Err(Error::invalid(file, "first bytes", expected, found));
    }
    let word = |offset: usize| {
        let word = bytes.get(offset..offset.checked_add(4)?)?;
        Some(u32::from_le_bytes(word.try_into().ok()?))
    };
    let (Some(version), Some(length)) = (word(4), word(8)) else {
        let found = format!("{} bytes", bytes.len());
        return Err(Error::invalid(file, HEADER, "12 bytes", found));
    };
    if version != 2 {
        let found = format!("version {version}");
        return Err(Error::invalid(file, HEADER, "version 2", found));
    }
    let cut_off = bytes.len() < length as usize;
    let chunk = |offset: usize, kind: &[u8; 4]| {
        let length = word(offset)? as usize;
        let start = offset.checked_add(8)?;
        (bytes.get(offset + 4..start)? == kind).then_some(())?;
        bytes.get(start..start.checked_add(length)?)
    };
    let missing = |offset: usize, name: &str| {
        if cut_off {
            let expected = format!("{length} bytes, as the header has it");
            return Error::invalid(file, "GLB", expected, format!("{} bytes", bytes.len()));
        }
        let found = match (word(offset), bytes.get(offset + 4..offset + 8)) {
            (Some(length), Some(kind)) => format!(
                "{length} bytes of chunk {}, {} bytes before the end of the file",
                first_bytes(kind),
                bytes.len() - offset - 8
            ),
            _ => "the end of the file".into(),
        };
        let place = format!("GLB, byte {offset}");
        Error::invalid(file, place, format_args!("a whole {name} chunk"), found)
    };
    let json = chunk(12, b"JSON").ok_or_else(|| missing(12, "JSON"))?;
    let next = 20 + json.len();
    if bytes.len() <= next {
        return Ok((json, None));
    }
    let blob = chunk(next, b"BIN\0").ok_or_else(|| missing(next, "BIN"))?;
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
    let bytes = files.read(&path);
    bytes.map_err(|error| error.referred_to(file, place))
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
