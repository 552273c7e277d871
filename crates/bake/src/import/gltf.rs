//! glTF 2.0, `.gltf` and `.glb`.
//!
//! The `gltf` crate's JSON types are used, its accessors and validation are not: the former
//! index without bounds checks and the latter refuses `KHR_mesh_quantization`.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::path::Path;

use glam::{DMat3, DMat4, DQuat, DVec3, Vec2, Vec3};
use gltf::json::accessor::{ComponentType, IndexComponentType, Type};
use gltf::json::buffer::View;
use gltf::json::mesh::{Mode, Primitive, Semantic};
use gltf::json::texture::{Sampler, WrappingMode};
use gltf::json::validation::{Checked, USize64};
use gltf::json::{Accessor, Index, Root, material, root::Get, scene, texture};
use relight_format::{Material, Surface, Texture, TextureEncoding, TextureSlot};
use serde::Deserialize;

use super::build::{Builder, GivenVertex, Part, Tangents, face_normal};
use super::{Error, image, plain_material};
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
const READ: [&str; 4] = [
    EMISSIVE_STRENGTH,
    "KHR_materials_anisotropy",
    "KHR_mesh_quantization",
    "KHR_texture_transform",
];

/// Most nodes of a scene, those that several parents share counted once per parent.
const MAX_NODES: usize = 1 << 20;

/// Imports the bytes of a glTF file and what it refers to.
pub(super) fn import(files: &Files, file: &Path, bytes: &[u8]) -> Result<Mesh, Error> {
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
    let mut builder = Builder::new(file, files.max_vertices());
    for extension in root.extensions_used.iter().filter(|name| !known(name)) {
        builder.warn(format!(
            "the glTF extension {extension} is not supported and left out"
        ));
    }
    let mut materials = Materials {
        document: &document,
        converted: BTreeMap::new(),
        list: Vec::new(),
        images: BTreeMap::new(),
        textures: Vec::new(),
        texels: 0,
    };
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
    let decoded = decode_percent(uri).filter(|path| !path.contains(':') && !path.is_empty());
    let path = decoded.ok_or_else(|| wrong(&format!("{uri:?}")))?;
    let path = file.parent().unwrap_or(Path::new("")).join(path);
    files.read(&path)
}

fn decode_base64(text: &str) -> Option<Vec<u8>> {
    let text = text.trim_end_matches('=');
    let mut bytes = Vec::with_capacity(text.len() / 4 * 3 + 2);
    let (mut bits, mut count) = (0u32, 0);
    for byte in text.bytes() {
        let value = match byte {
            b'A'..=b'Z' => byte - b'A',
            b'a'..=b'z' => byte - b'a' + 26,
            b'0'..=b'9' => byte - b'0' + 52,
            b'+' => 62,
            b'/' => 63,
            _ => return None,
        };
        bits = bits << 6 | u32::from(value);
        count += 6;
        if count >= 8 {
            count -= 8;
            bytes.push((bits >> count) as u8);
        }
    }
    // Six bits over means a lone last character.
    (count < 6).then_some(bytes)
}

fn decode_percent(uri: &str) -> Option<String> {
    let mut bytes = Vec::with_capacity(uri.len());
    let mut rest = uri.bytes();
    while let Some(byte) = rest.next() {
        bytes.push(match byte {
            b'%' => {
                let [high, low] = [rest.next()?, rest.next()?].map(|b| (b as char).to_digit(16));
                (high? * 16 + low?) as u8
            }
            _ => byte,
        });
    }
    String::from_utf8(bytes).ok()
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

    /// The nodes of the scene in depth-first order, with their transforms to world space. The
    /// specification wants trees; files with shared nodes exist and mean copies.
    fn nodes(&self) -> Result<Vec<(usize, DMat4)>, Error> {
        let roots = match self.root.scene {
            Some(index) => self.get(index, "scene")?.nodes.clone(),
            None => match self.root.scenes.first() {
                Some(scene) => scene.nodes.clone(),
                None => self.parentless_nodes(),
            },
        };
        let mut found = Vec::new();
        let mut stack: Vec<_> = roots
            .into_iter()
            .rev()
            .map(|root| (root, DMat4::IDENTITY, 1))
            .collect();
        while let Some((index, parent, depth)) = stack.pop() {
            let place = format!("nodes[{}]", index.value());
            let node = self.get(index, &place)?;
            if depth > self.root.nodes.len() || found.len() == MAX_NODES {
                let expected = format!("no cycle and at most {MAX_NODES} nodes");
                return Err(self.invalid(place, expected, format_args!("depth {depth}")));
            }
            let matrix = parent * local_transform(node);
            if !matrix.is_finite() {
                return Err(self.invalid(place, "a finite transform", format_args!("{matrix}")));
            }
            found.push((index.value(), matrix));
            let children = node.children.iter().flatten().rev();
            stack.extend(children.map(|child| (*child, matrix, depth + 1)));
        }
        Ok(found)
    }

    fn parentless_nodes(&self) -> Vec<Index<scene::Node>> {
        let mut is_child = vec![false; self.root.nodes.len()];
        for child in self
            .root
            .nodes
            .iter()
            .flat_map(|node| node.children.iter().flatten())
        {
            if let Some(is_child) = is_child.get_mut(child.value()) {
                *is_child = true;
            }
        }
        let indices = is_child
            .iter()
            .enumerate()
            .filter(|(_, is_child)| !**is_child);
        indices.map(|(index, _)| Index::new(index as u32)).collect()
    }

    fn push_node(
        &self,
        node_index: usize,
        matrix: DMat4,
        materials: &mut Materials,
        builder: &mut Builder,
    ) -> Result<(), Error> {
        let node = &self.root.nodes[node_index];
        let Some(mesh_index) = node.mesh else {
            return Ok(());
        };
        let mesh = self.get(mesh_index, &format!("nodes[{node_index}].mesh"))?;
        if node.skin.is_some() {
            builder.warn(format!(
                "nodes[{node_index}] is skinned; it is baked in its bind pose, placed by the node"
            ));
        }
        let weights = node.weights.as_ref().or(mesh.weights.as_ref());
        if weights.is_some_and(|weights| weights.iter().any(|weight| *weight != 0.0)) {
            builder.warn(format!(
                "nodes[{node_index}] is morphed; its base shape is baked"
            ));
        }
        for (index, primitive) in mesh.primitives.iter().enumerate() {
            let place = format!("meshes[{}].primitives[{index}]", mesh_index.value());
            if let Some(part) = self.part(primitive, &place, matrix, materials, builder)? {
                builder.push(part)?;
            }
        }
        Ok(())
    }

    /// One primitive in world space; `None` if it has no triangles.
    fn part(
        &self,
        primitive: &Primitive,
        place: &str,
        matrix: DMat4,
        materials: &mut Materials,
        builder: &mut Builder,
    ) -> Result<Option<Part>, Error> {
        let Checked::Valid(mode) = primitive.mode else {
            return Err(self.invalid(format_args!("{place}.mode"), "a mode in 0..=6", "another"));
        };
        if !matches!(
            mode,
            Mode::Triangles | Mode::TriangleStrip | Mode::TriangleFan
        ) {
            builder.warn(format!(
                "{place} has no triangles but {mode:?} and is left out"
            ));
            return Ok(None);
        }
        let material = materials.convert(primitive.material, builder)?;
        let Converted {
            uv_set,
            double_sided,
            needs_tangents,
            ..
        } = materials.list[material];

        let attribute =
            |semantic: Semantic| primitive.attributes.get(&Checked::Valid(semantic)).copied();
        let key = |name: &str| format!("{place}.attributes.{name}");
        let Some(positions) = attribute(Semantic::Positions) else {
            return Err(self.invalid(key("POSITION"), "an accessor", "none"));
        };
        self.check_bounds(positions, &key("POSITION"))?;
        let positions = self.floats::<3>(positions, &key("POSITION"))?;
        let count = positions.len();
        let optional = |data: &[usize], name: &str| match data {
            [] => Ok(()),
            [length] if *length == count => Ok(()),
            [length, ..] => Err(self.invalid(
                key(name),
                format_args!("{count} elements, as many as POSITION has"),
                length,
            )),
        };
        let normals = attribute(Semantic::Normals)
            .map(|index| self.floats::<3>(index, &key("NORMAL")))
            .transpose()?;
        optional(normals.as_ref().map(Vec::len).as_slice(), "NORMAL")?;
        // Without normals the specification tells readers to ignore tangents.
        let tangents = attribute(Semantic::Tangents)
            .filter(|_| normals.is_some())
            .map(|index| self.floats::<4>(index, &key("TANGENT")))
            .transpose()?;
        optional(tangents.as_ref().map(Vec::len).as_slice(), "TANGENT")?;
        let uv_name = format!("TEXCOORD_{uv_set}");
        let uvs = attribute(Semantic::TexCoords(uv_set))
            .map(|index| self.floats::<2>(index, &key(&uv_name)))
            .transpose()?;
        optional(uvs.as_ref().map(Vec::len).as_slice(), &uv_name)?;
        if let Some(colors) = attribute(Semantic::Colors(0)) {
            self.get(colors, &key("COLOR_0"))?;
            builder.warn("vertex colours are left out".into());
        }
        if uvs.is_none() && materials.list[material].has_textures() {
            builder.warn(format!("{place} is textured but has no {uv_name}"));
        }

        let linear = DMat3::from_mat4(matrix);
        // The cofactor matrix maps normals; unlike the inverse transpose it exists for every
        // matrix. It points them inwards under a reflection, so its sign is restored.
        let mirrored = linear.determinant() < 0.0;
        let sign = if mirrored { -1.0 } else { 1.0 };
        let (x, y, z) = (linear.x_axis, linear.y_axis, linear.z_axis);
        let cofactors = DMat3::from_cols(y.cross(z), z.cross(x), x.cross(y)) * sign;
        let direction = |matrix: DMat3, vector: [f32; 3]| {
            (matrix * Vec3::from(vector).as_dvec3())
                .try_normalize()
                .map(DVec3::as_vec3)
        };
        let mut vertices = Vec::with_capacity(count);
        for (index, position) in positions.into_iter().enumerate() {
            let position = matrix
                .transform_point3(Vec3::from(position).as_dvec3())
                .as_vec3();
            if !position.is_finite() {
                let found = format!("{position} at vertex {index}, in world space");
                return Err(self.invalid(key("POSITION"), "finite coordinates", found));
            }
            let tangent = tangents.as_ref().and_then(|tangents| {
                let [x, y, z, w] = tangents[index];
                Some((direction(linear, [x, y, z])?, w * sign as f32))
            });
            let normal =
                (normals.as_ref()).and_then(|normals| direction(cofactors, normals[index]));
            vertices.push(GivenVertex {
                position,
                normal,
                tangent,
                uv: uvs.as_ref().map_or(Vec2::ZERO, |uvs| uvs[index].into()),
            });
        }

        let indices = match primitive.indices {
            Some(accessor) => self.indices(accessor, &format!("{place}.indices"), count)?,
            None => (0..count as u32).collect(),
        };
        let mut triangles = assemble(mode, &indices);
        if mirrored {
            for triangle in &mut triangles {
                triangle.swap(1, 2);
            }
        }
        if normals.is_none() {
            (vertices, triangles) = flat_shaded(&vertices, &triangles);
        }
        let tangents = match (tangents.is_some(), uvs.is_some(), needs_tangents) {
            (true, ..) => Tangents::Given,
            (false, true, true) => Tangents::MikkTSpace,
            (false, true, false) => Tangents::FromUv,
            (false, false, _) => Tangents::AroundAxis,
        };
        Ok(Some(Part {
            vertices,
            triangles,
            material,
            tangents,
            double_sided,
        }))
    }

    /// POSITION's min and max are not used, but a file that gives them wrong is broken.
    fn check_bounds(&self, index: Index<Accessor>, place: &str) -> Result<(), Error> {
        let accessor = self.get(index, place)?;
        for (name, bound) in [("min", &accessor.min), ("max", &accessor.max)] {
            if let Some(value) = bound
                && <[f32; 3]>::deserialize(value).is_err()
            {
                let place = format!("accessors[{}].{name}", index.value());
                return Err(self.invalid(place, "three numbers", value));
            }
        }
        Ok(())
    }

    fn indices(
        &self,
        index: Index<Accessor>,
        place: &str,
        vertices: usize,
    ) -> Result<Vec<u32>, Error> {
        let indices = self.elements(index, place, Type::Scalar, |component, _, bytes| {
            Some(match component {
                ComponentType::U8 => u32::from(bytes[0]),
                ComponentType::U16 => u32::from(u16::from_le_bytes([bytes[0], bytes[1]])),
                ComponentType::U32 => u32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]),
                _ => return None,
            })
        })?;
        match indices.iter().position(|&index| index as usize >= vertices) {
            None => Ok(indices),
            Some(at) => Err(self.invalid(
                place,
                format_args!("indices below {vertices}"),
                format_args!("{} at element {at}", indices[at]),
            )),
        }
    }

    /// Reads finite vectors of any component type, normalised or not.
    fn floats<const N: usize>(
        &self,
        index: Index<Accessor>,
        place: &str,
    ) -> Result<Vec<[f32; N]>, Error> {
        let kind = [Type::Scalar, Type::Vec2, Type::Vec3, Type::Vec4][N - 1];
        let values = self.elements(index, place, kind, |component, normalized, bytes| {
            let size = component.size();
            Some(std::array::from_fn(|i| {
                component_value(component, normalized, &bytes[i * size..(i + 1) * size])
            }))
        })?;
        match values
            .iter()
            .position(|value: &[f32; N]| !value.iter().all(|x| x.is_finite()))
        {
            None => Ok(values),
            Some(at) => Err(self.invalid(
                place,
                "finite numbers",
                format_args!("{:?} at element {at}", values[at]),
            )),
        }
    }

    /// Decodes the elements of an accessor, sparse ones included. `decode` gets as many bytes
    /// as one element has, and returns `None` for a component type that is not allowed.
    fn elements<T: Copy>(
        &self,
        index: Index<Accessor>,
        place: &str,
        kind: Type,
        decode: impl Fn(ComponentType, bool, &[u8]) -> Option<T>,
    ) -> Result<Vec<T>, Error> {
        let accessor = self.get(index, place)?;
        let place = format!("{place} (accessors[{}])", index.value());
        let wrong_type = || {
            self.invalid(
                &place,
                format_args!("type {kind:?} of an allowed component type"),
                format_args!("{:?} of {:?}", accessor.type_, accessor.component_type),
            )
        };
        let Checked::Valid(component) = accessor.component_type else {
            return Err(wrong_type());
        };
        let component = component.0;
        if accessor.type_ != Checked::Valid(kind) {
            return Err(wrong_type());
        }
        let size = component.size() * kind.multiplicity();
        let count = usize::try_from(accessor.count.0).unwrap_or(usize::MAX);
        // Three corners of each of the most triangles.
        let most = self.files.max_vertices() * 3;
        if !(1..=most).contains(&count) {
            let expected = format!("1 to {most} elements (--limit-vertices)");
            return Err(self.invalid(&place, expected, count));
        }
        let decode_all = |bytes: &[u8], stride: usize, count: usize| -> Result<Vec<T>, Error> {
            let element =
                |i: usize| decode(component, accessor.normalized, &bytes[i * stride..][..size]);
            (0..count)
                .map(|i| element(i).ok_or_else(wrong_type))
                .collect()
        };
        let mut values = match accessor.buffer_view {
            Some(view) => {
                let (bytes, stride) = self.span(view, accessor.byte_offset, count, size, &place)?;
                decode_all(bytes, stride, count)?
            }
            None => vec![decode(component, false, &[0; 16][..size]).ok_or_else(wrong_type)?; count],
        };
        let Some(sparse) = &accessor.sparse else {
            return Ok(values);
        };
        let place = format!("{place}.sparse");
        let changed = usize::try_from(sparse.count.0).unwrap_or(usize::MAX);
        if !(1..=count).contains(&changed) {
            return Err(self.invalid(&place, format_args!("1 to {count} elements"), changed));
        }
        let Checked::Valid(IndexComponentType(index_type)) = sparse.indices.component_type else {
            return Err(self.invalid(&place, "an unsigned index type", "another"));
        };
        let index_size = index_type.size();
        let offset = Some(sparse.indices.byte_offset);
        let (index_bytes, index_stride) = self.span(
            sparse.indices.buffer_view,
            offset,
            changed,
            index_size,
            &place,
        )?;
        let offset = Some(sparse.values.byte_offset);
        let (value_bytes, value_stride) =
            self.span(sparse.values.buffer_view, offset, changed, size, &place)?;
        for (i, value) in decode_all(value_bytes, value_stride, changed)?
            .into_iter()
            .enumerate()
        {
            let mut word = [0; 4];
            word[..index_size].copy_from_slice(&index_bytes[i * index_stride..][..index_size]);
            let target = u32::from_le_bytes(word) as usize;
            *values.get_mut(target).ok_or_else(|| {
                self.invalid(&place, format_args!("indices below {count}"), target)
            })? = value;
        }
        Ok(values)
    }

    /// The bytes of `count` elements of `size` bytes in a buffer view, and their stride.
    fn span(
        &self,
        view: Index<View>,
        offset: Option<USize64>,
        count: usize,
        size: usize,
        place: &str,
    ) -> Result<(&[u8], usize), Error> {
        let bytes = self.view(view, place)?;
        let stride = self
            .get(view, place)?
            .byte_stride
            .map_or(size, |stride| stride.0);
        if stride < size {
            let expected = format!("a stride of at least {size} bytes");
            return Err(self.invalid(format_args!("bufferViews[{view}]"), expected, stride));
        }
        let length = stride.saturating_mul(count - 1).saturating_add(size);
        let start = usize::try_from(offset.unwrap_or_default().0).unwrap_or(usize::MAX);
        let span = bytes
            .get(start..start.saturating_add(length))
            .ok_or_else(|| {
                self.invalid(
                    place,
                    format_args!("{length} bytes from byte {start} of bufferViews[{view}]"),
                    format_args!("{} bytes in all", bytes.len()),
                )
            })?;
        Ok((span, stride))
    }

    fn view(&self, index: Index<View>, place: &str) -> Result<&[u8], Error> {
        let view = self.get(index, place)?;
        let place = format!("bufferViews[{index}]");
        self.get(view.buffer, &place)?;
        let buffer = &self.buffers[view.buffer.value()];
        let offset = view.byte_offset.unwrap_or_default().0;
        let range = usize::try_from(offset)
            .ok()
            .zip(usize::try_from(offset.saturating_add(view.byte_length.0)).ok());
        range
            .and_then(|(start, end)| buffer.get(start..end))
            .ok_or_else(|| {
                self.invalid(
                    place,
                    format_args!("a range inside the buffer's {} bytes", buffer.len()),
                    format_args!("{} bytes from byte {offset}", view.byte_length.0),
                )
            })
    }
}

fn local_transform(node: &scene::Node) -> DMat4 {
    if let Some(matrix) = node.matrix {
        return DMat4::from_cols_array(&matrix.map(f64::from));
    }
    let vector = |given: Option<[f32; 3]>, default| {
        given.map_or(default, |given| DVec3::from(given.map(f64::from)))
    };
    let rotation = node.rotation.map_or(DQuat::IDENTITY, |rotation| {
        let rotation = DQuat::from_array(rotation.0.map(f64::from));
        // A file's quaternion is only as long as its rounding lets it be.
        if rotation.length_squared() > 0.0 {
            rotation.normalize()
        } else {
            DQuat::IDENTITY
        }
    });
    DMat4::from_scale_rotation_translation(
        vector(node.scale, DVec3::ONE),
        rotation,
        vector(node.translation, DVec3::ZERO),
    )
}

fn component_value(component: ComponentType, normalized: bool, bytes: &[u8]) -> f32 {
    let scaled = |value: f32, largest: f32| {
        if normalized {
            (value / largest).max(-1.0)
        } else {
            value
        }
    };
    let pair = || [bytes[0], bytes[1]];
    let word = || [bytes[0], bytes[1], bytes[2], bytes[3]];
    match component {
        ComponentType::I8 => scaled(f32::from(bytes[0] as i8), 127.0),
        ComponentType::U8 => scaled(f32::from(bytes[0]), 255.0),
        ComponentType::I16 => scaled(f32::from(i16::from_le_bytes(pair())), 32767.0),
        ComponentType::U16 => scaled(f32::from(u16::from_le_bytes(pair())), 65535.0),
        ComponentType::U32 => scaled(u32::from_le_bytes(word()) as f32, u32::MAX as f32),
        ComponentType::F32 => f32::from_le_bytes(word()),
    }
}

/// Triangles of a list, strip or fan; left-over indices are dropped.
fn assemble(mode: Mode, indices: &[u32]) -> Vec<[u32; 3]> {
    match mode {
        Mode::TriangleStrip => indices
            .windows(3)
            .enumerate()
            .map(|(i, w)| {
                if i % 2 == 0 {
                    [w[0], w[1], w[2]]
                } else {
                    [w[1], w[0], w[2]]
                }
            })
            .collect(),
        Mode::TriangleFan => indices
            .get(1..)
            .unwrap_or_default()
            .windows(2)
            .map(|pair| [pair[0], pair[1], indices[0]])
            .collect(),
        _ => indices.as_chunks::<3>().0.to_vec(),
    }
}

/// Gives every triangle its own vertices, with its face's normal.
fn flat_shaded(
    vertices: &[GivenVertex],
    triangles: &[[u32; 3]],
) -> (Vec<GivenVertex>, Vec<[u32; 3]>) {
    let mut flat = Vec::with_capacity(triangles.len() * 3);
    for triangle in triangles {
        let corners = triangle.map(|index| vertices[index as usize]);
        let normal = face_normal(corners.map(|corner| corner.position));
        flat.extend(corners.map(|corner| GivenVertex {
            normal: normal.map(DVec3::as_vec3),
            ..corner
        }));
    }
    let triangles = (0..triangles.len() as u32)
        .map(|i| [3 * i, 3 * i + 1, 3 * i + 2])
        .collect();
    (flat, triangles)
}

/// A material and what its primitives must know.
struct Converted {
    material: Material,
    /// n of the TEXCOORD_n that its textures use.
    uv_set: u32,
    double_sided: bool,
    needs_tangents: bool,
}

impl Converted {
    fn has_textures(&self) -> bool {
        let material = &self.material;
        material.base_color_texture.is_some()
            || material.metallic_roughness_texture.is_some()
            || material.normal_texture.is_some()
            || material.anisotropy_texture.is_some()
    }
}

/// Materials and textures converted so far: only what a primitive uses.
struct Materials<'a> {
    document: &'a Document<'a>,
    /// Index into `list` by index into the file's materials; `None` is the default material.
    converted: BTreeMap<Option<usize>, usize>,
    list: Vec<Converted>,
    /// Index into `textures` by index into the file's images and encoding.
    images: BTreeMap<(usize, bool), u32>,
    textures: Vec<Texture>,
    texels: u64,
}

/// A texture reference of whatever kind.
struct Reference {
    place: String,
    texture: Index<texture::Texture>,
    uv_set: u32,
    transform: TextureTransform,
    encoding: TextureEncoding,
}

/// `KHR_texture_transform`, which the JSON types know on some texture references only.
#[derive(Deserialize)]
#[serde(default, rename_all = "camelCase")]
struct TextureTransform {
    offset: [f32; 2],
    rotation: f32,
    scale: [f32; 2],
    tex_coord: Option<u32>,
}

impl Default for TextureTransform {
    fn default() -> Self {
        Self {
            offset: [0.0; 2],
            rotation: 0.0,
            scale: [1.0; 2],
            tex_coord: None,
        }
    }
}

impl TextureTransform {
    /// Rows of the map from (u, v, 1): scale, then rotation, counter-clockwise as seen on an
    /// image whose v points down, then translation.
    fn rows(&self) -> [[f32; 3]; 2] {
        let ([su, sv], [ou, ov]) = (self.scale, self.offset);
        let (sin, cos) = self.rotation.sin_cos();
        [[cos * su, sin * sv, ou], [-sin * su, cos * sv, ov]]
    }
}

/// `KHR_materials_anisotropy`.
#[derive(Default, Deserialize)]
#[serde(default)]
struct Anisotropy {
    #[serde(rename = "anisotropyStrength")]
    strength: f32,
    #[serde(rename = "anisotropyRotation")]
    rotation: f32,
    #[serde(rename = "anisotropyTexture")]
    texture: Option<texture::Info>,
}

/// `KHR_materials_emissive_strength`.
#[derive(Deserialize)]
#[serde(default)]
struct EmissiveStrength {
    #[serde(rename = "emissiveStrength")]
    strength: f32,
}

impl Default for EmissiveStrength {
    fn default() -> Self {
        Self { strength: 1.0 }
    }
}

const EMISSIVE_STRENGTH: &str = "KHR_materials_emissive_strength";

impl Materials<'_> {
    /// Converts a material once; gives its index into `list`.
    fn convert(
        &mut self,
        index: Option<Index<material::Material>>,
        builder: &mut Builder,
    ) -> Result<usize, Error> {
        let key = index.map(|index| index.value());
        if let Some(done) = self.converted.get(&key) {
            return Ok(*done);
        }
        let default = material::Material::default();
        let (place, source) = match index {
            Some(index) => {
                let place = format!("materials[{index}]");
                (place.clone(), self.document.get(index, &place)?)
            }
            None => ("default material".into(), &default),
        };
        let unnamed = || key.map_or("default".into(), |index| format!("material {index}"));
        let name = source.name.clone().unwrap_or_else(unnamed);
        let anisotropy = match extension(source.extensions.as_ref().map(|e| &e.others), ANISOTROPY)
        {
            Some(value) => self.parse::<Anisotropy>(value, &format!("{place}.{ANISOTROPY}"))?,
            None => Anisotropy::default(),
        };
        if source.alpha_mode != Checked::Valid(material::AlphaMode::Opaque) {
            builder.warn(format!(
                "material {name:?} is transparent; it is baked as opaque"
            ));
        }
        let others = source.extensions.as_ref().map(|e| &e.others);
        let strength = match extension(others, EMISSIVE_STRENGTH) {
            Some(value) => {
                let place = format!("{place}.{EMISSIVE_STRENGTH}");
                self.parse::<EmissiveStrength>(value, &place)?.strength
            }
            None => 1.0,
        };
        let emission = source.emissive_factor.0.map(|factor| factor * strength);
        if !emission.iter().all(|x| x.is_finite() && *x >= 0.0) {
            let expected = "a finite emission of at least 0";
            let found = format!("{emission:?}");
            return Err(self.document.invalid(place, expected, found));
        }

        let metallic_roughness = &source.pbr_metallic_roughness;
        let rotation = anisotropy.rotation;
        let numbers = [
            source.normal_texture.as_ref().map_or(1.0, |t| t.scale),
            rotation,
        ];
        if !numbers.iter().all(|number| number.is_finite()) {
            let expected = "a finite normal scale and anisotropy rotation";
            return Err(self
                .document
                .invalid(place, expected, format_args!("{numbers:?}")));
        }
        let mut unit = |value: f32| {
            if !(0.0..=1.0).contains(&value) {
                builder.warn(format!(
                    "material {name:?}: factors outside [0, 1] are clamped"
                ));
            }
            value.clamp(0.0, 1.0)
        };
        let [red, green, blue, _] = metallic_roughness.base_color_factor.0;
        let surface = Surface::MetallicRoughness {
            base_color: [red, green, blue].map(&mut unit),
            metallic: unit(metallic_roughness.metallic_factor.0),
            roughness: unit(metallic_roughness.roughness_factor.0),
            anisotropy_strength: unit(anisotropy.strength),
            anisotropy_rotation: rotation,
        };

        let info = |info: &Option<texture::Info>, what: &str, encoding| {
            let info = info.as_ref()?;
            let given = info
                .extensions
                .as_ref()
                .and_then(|e| e.texture_transform.as_ref());
            let transform = given.map_or_else(TextureTransform::default, |t| TextureTransform {
                offset: t.offset.0,
                rotation: t.rotation.0,
                scale: t.scale.0,
                tex_coord: t.tex_coord,
            });
            let place = format!("{place}.{what}");
            Some(Reference {
                place,
                texture: info.index,
                uv_set: info.tex_coord,
                transform,
                encoding,
            })
        };
        let base_color = &metallic_roughness.base_color_texture;
        let packed = &metallic_roughness.metallic_roughness_texture;
        let normal = match &source.normal_texture {
            Some(normal) => {
                let place = format!("{place}.normalTexture");
                let others = normal.extensions.as_ref().map(|e| &e.others);
                let transform = match extension(others, "KHR_texture_transform") {
                    Some(value) => self.parse(value, &place)?,
                    None => TextureTransform::default(),
                };
                let encoding = TextureEncoding::Linear;
                let (texture, uv_set) = (normal.index, normal.tex_coord);
                Some(Reference {
                    place,
                    texture,
                    uv_set,
                    transform,
                    encoding,
                })
            }
            None => None,
        };
        let references = [
            info(base_color, "baseColorTexture", TextureEncoding::Srgb),
            info(packed, "metallicRoughnessTexture", TextureEncoding::Linear),
            normal,
            info(
                &anisotropy.texture,
                "anisotropyTexture",
                TextureEncoding::Linear,
            ),
            info(
                &source.emissive_texture,
                "emissiveTexture",
                TextureEncoding::Srgb,
            )
            .filter(|_| emission != [0.0; 3]),
        ];
        let set = |reference: &Reference| reference.transform.tex_coord.unwrap_or(reference.uv_set);
        let uv_set = references.iter().flatten().next().map_or(0, set);
        let mut slots = [None; 5];
        for (slot, reference) in slots.iter_mut().zip(references) {
            let Some(reference) = reference else { continue };
            if set(&reference) == uv_set {
                *slot = Some(self.slot(&reference, builder)?);
            } else {
                builder.warn(format!(
                    "{} uses other texture coordinates than the material's first texture and is \
                     left out",
                    reference.place
                ));
            }
        }
        let [
            base_color_texture,
            metallic_roughness_texture,
            normal_texture,
            anisotropy_texture,
            emission_texture,
        ] = slots;
        let material = Material {
            base_color_texture,
            metallic_roughness_texture,
            normal_texture,
            anisotropy_texture,
            emission,
            emission_texture,
            normal_scale: numbers[0],
            ..plain_material(&name, surface)
        };
        self.list.push(Converted {
            needs_tangents: normal_texture.is_some() || anisotropy.strength > 0.0,
            material,
            uv_set,
            double_sided: source.double_sided,
        });
        self.converted.insert(key, self.list.len() - 1);
        Ok(self.list.len() - 1)
    }

    fn parse<T: serde::de::DeserializeOwned>(
        &self,
        value: &serde_json::Value,
        place: &str,
    ) -> Result<T, Error> {
        T::deserialize(value).map_err(|error| {
            self.document
                .invalid(place, "an object as the extension specifies", error)
        })
    }

    fn slot(&mut self, reference: &Reference, builder: &mut Builder) -> Result<TextureSlot, Error> {
        let document = self.document;
        let place = &reference.place;
        let transform = reference.transform.rows();
        if !transform.iter().flatten().all(|value| value.is_finite()) {
            let found = format!("{transform:?}");
            return Err(document.invalid(place, "a finite texture transform", found));
        }
        let texture = document.get(reference.texture, place)?;
        if let Some(index) = texture.sampler {
            let Sampler { wrap_s, wrap_t, .. } = document.get(index, place)?;
            if [wrap_s, wrap_t]
                .into_iter()
                .any(|mode| *mode != Checked::Valid(WrappingMode::Repeat))
            {
                builder.warn(format!("{place} does not repeat in its sampler, but will"));
            }
        }
        let key = (
            texture.source.value(),
            reference.encoding == TextureEncoding::Srgb,
        );
        if let Some(&texture) = self.images.get(&key) {
            return Ok(TextureSlot { texture, transform });
        }
        let source = document.get(texture.source, place)?;
        let place = format!("images[{}]", texture.source);
        let bytes = match (&source.uri, source.buffer_view) {
            (Some(uri), _) => Cow::Owned(resolve(document.files, document.file, &place, uri)?),
            (None, Some(view)) => Cow::Borrowed(document.view(view, &place)?),
            (None, None) => {
                return Err(document.invalid(place, "a uri or a bufferView", "neither"));
            }
        };
        let (file, encoding) = (document.file, reference.encoding);
        self.textures.push(image::decode(
            file,
            &place,
            &bytes,
            encoding,
            &mut self.texels,
            document.files.access().max_texels,
        )?);
        let texture = self.textures.len() as u32 - 1;
        self.images.insert(key, texture);
        Ok(TextureSlot { texture, transform })
    }
}

const ANISOTROPY: &str = "KHR_materials_anisotropy";

fn extension<'a>(
    extensions: Option<&'a serde_json::Map<String, serde_json::Value>>,
    name: &str,
) -> Option<&'a serde_json::Value> {
    extensions?.get(name)
}
