//! Small files made in memory. Real ones are read by the workspace's test suite.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::Path;

use glam::{Vec2, Vec3};
use relight_format::{Specular, Surface, TextureSlot, math};
use relight_shading::textures::sample_point;
use serde_json::{Value, json};

use super::build::face_normal;
use super::{Error, Options, gltf, obj};
use crate::files::{Access, Files};
use crate::mesh::{Mesh, Vertex};

/// Vectors that should be equal or orthogonal are computed along different paths in f32.
const TOLERANCE: f32 = 1e-5;

fn glb(json: &Value, blob: &[u8]) -> Vec<u8> {
    let mut json = serde_json::to_vec(json).expect("JSON values serialise");
    json.resize(json.len().next_multiple_of(4), b' ');
    let mut bytes = b"glTF\x02\0\0\0".to_vec();
    bytes.extend((28 + json.len() as u32 + blob.len() as u32).to_le_bytes());
    bytes.extend((json.len() as u32).to_le_bytes());
    bytes.extend(b"JSON");
    bytes.extend(json);
    bytes.extend((blob.len() as u32).to_le_bytes());
    bytes.extend(b"BIN\0");
    bytes.extend(blob);
    bytes
}

/// A unit square in the plane z = 0, facing +Z, with everything a vertex can have: buffer
/// view 0 holds indices, 1 positions, 2 normals, 3 tangents, 4 texture coordinates.
fn square() -> (Value, Vec<u8>) {
    let corners = [[0f32, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]];
    let mut blob: Vec<u8> = [0u16, 1, 2, 0, 2, 3]
        .iter()
        .flat_map(|i| i.to_le_bytes())
        .collect();
    let mut views = vec![json!({"buffer": 0, "byteLength": 12})];
    let attributes: [Vec<f32>; 4] = [
        corners.iter().flat_map(|[x, y]| [*x, *y, 0.0]).collect(),
        corners.iter().flat_map(|_| [0.0, 0.0, 1.0]).collect(),
        corners.iter().flat_map(|_| [1.0, 0.0, 0.0, 1.0]).collect(),
        corners.iter().flat_map(|[x, y]| [*x, 1.0 - *y]).collect(),
    ];
    for values in attributes {
        views.push(json!({
            "buffer": 0, "byteOffset": blob.len(), "byteLength": values.len() * 4,
        }));
        blob.extend(values.iter().flat_map(|value| value.to_le_bytes()));
    }
    let accessor = |view: usize, kind: &str, component: u32, count: usize| json!({"bufferView": view, "type": kind, "componentType": component, "count": count});
    let json = json!({
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{
            "indices": 0,
            "attributes": {"POSITION": 1, "NORMAL": 2, "TANGENT": 3, "TEXCOORD_0": 4},
            "material": 0,
        }]}],
        "materials": [{"name": "paint"}],
        "accessors": [
            accessor(0, "SCALAR", 5123, 6),
            accessor(1, "VEC3", 5126, 4),
            accessor(2, "VEC3", 5126, 4),
            accessor(3, "VEC4", 5126, 4),
            accessor(4, "VEC2", 5126, 4),
        ],
        "bufferViews": views,
        "buffers": [{"byteLength": blob.len()}],
    });
    (json, blob)
}

/// Nothing to refer to.
fn no_files() -> Files {
    Files::in_memory(BTreeMap::new(), &Access::default())
}

fn import(json: &Value, blob: &[u8]) -> Result<Mesh, Error> {
    gltf::import(
        &no_files(),
        Path::new("test.glb"),
        &Options::default(),
        &glb(json, blob),
    )
}

fn import_good(json: &Value, blob: &[u8]) -> Mesh {
    import(json, blob).expect("a good file")
}

fn import_obj(text: &str) -> Result<Mesh, Error> {
    obj::import(
        &no_files(),
        Path::new("test.obj"),
        &Options::default(),
        text.as_bytes(),
    )
}

fn area_normals(mesh: &Mesh) -> Vec<Vec3> {
    mesh.soup()
        .into_iter()
        .map(|corners| face_normal(corners).expect("an area").as_vec3())
        .collect()
}

fn frame(vertex: &Vertex) -> [Vec3; 3] {
    let Vertex {
        normal, tangent, ..
    } = *vertex;
    [
        tangent,
        normal.cross(tangent) * vertex.bitangent_sign,
        normal,
    ]
}

fn assert_close(a: Vec3, b: Vec3) {
    assert!(a.distance(b) < TOLERANCE, "{a} is not {b}");
}

#[test]
fn a_square_arrives_as_it_is() {
    let (json, blob) = square();
    let mesh = import_good(&json, &blob);
    assert_eq!((mesh.vertices.len(), mesh.triangles.len()), (4, 2));
    assert_eq!(mesh.warnings, Vec::<String>::new());
    assert_eq!(mesh.materials[0].name, "paint");
    for vertex in &mesh.vertices {
        let [x, y, _] = vertex.position.to_array();
        assert_eq!(vertex.uv.to_array(), [x, 1.0 - y]);
        assert_eq!(frame(vertex), [Vec3::X, Vec3::Y, Vec3::Z]);
    }
    for normal in area_normals(&mesh) {
        assert_close(normal, Vec3::Z);
    }
}

#[test]
fn transforms_carry_the_whole_frame_mirrors_included() {
    let (mut json, blob) = square();
    // Node 0 mirrors x, stretches y; its parent turns x to y, y to -x and moves.
    let half = std::f32::consts::FRAC_1_SQRT_2;
    json["nodes"] = json!([
        {"mesh": 0, "scale": [-1, 3, 2]},
        {"children": [0], "rotation": [0, 0, half, half], "translation": [5, 0, 0]},
    ]);
    json["scenes"][0]["nodes"] = json!([1]);
    let mesh = import_good(&json, &blob);
    assert_eq!(mesh.warnings, Vec::<String>::new());
    for vertex in &mesh.vertices {
        let [u, v] = vertex.uv.to_array();
        let expected = Vec3::new(5.0 - 3.0 * (1.0 - v), -u, 0.0);
        assert_close(vertex.position, expected);
        let [tangent, bitangent, normal] = frame(vertex);
        assert_close(tangent, Vec3::NEG_Y);
        assert_close(bitangent, Vec3::NEG_X);
        assert_close(normal, Vec3::Z);
    }
    for normal in area_normals(&mesh) {
        assert_close(normal, Vec3::Z);
    }
}

#[test]
fn a_shear_keeps_normals_orthogonal() {
    let (mut json, blob) = square();
    json["nodes"][0]["matrix"] = json!([1, 0, 1, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]);
    let mesh = import_good(&json, &blob);
    for (vertex, face) in mesh.vertices.iter().zip([area_normals(&mesh)[0]; 4]) {
        assert_close(vertex.normal, face);
    }
}

#[test]
fn strips_and_fans_face_one_way() {
    for (mode, order) in [(5, [0u16, 1, 3, 2]), (6, [0, 1, 2, 3])] {
        let (mut json, mut blob) = square();
        json["meshes"][0]["primitives"][0]["mode"] = json!(mode);
        json["accessors"][0]["count"] = json!(4);
        for (bytes, index) in blob.chunks_mut(2).zip(order) {
            bytes.copy_from_slice(&index.to_le_bytes());
        }
        let mesh = import_good(&json, &blob);
        assert_eq!(mesh.triangles.len(), 2, "mode {mode}");
        for normal in area_normals(&mesh) {
            assert_close(normal, Vec3::Z);
        }
    }
}

#[test]
fn missing_normals_are_flat_and_void_the_tangents() {
    let (mut json, mut blob) = square();
    let attributes = &mut json["meshes"][0]["primitives"][0]["attributes"];
    attributes
        .as_object_mut()
        .expect("an object")
        .remove("NORMAL");
    // Lift one corner, which only the second triangle has, so that the two faces differ.
    let corner = 12 + 3 * 12 + 8;
    blob[corner..corner + 4].copy_from_slice(&1f32.to_le_bytes());
    let mesh = import_good(&json, &blob);
    assert_eq!(mesh.vertices.len(), 6);
    let faces = area_normals(&mesh);
    assert!(faces[0].distance(faces[1]) > 0.1);
    for (triangle, face) in mesh.triangles.iter().zip(faces) {
        for index in triangle.vertices {
            assert_close(mesh.vertices[index as usize].normal, face);
        }
    }
}

#[test]
fn quantised_attributes_are_scaled() {
    let (mut json, mut blob) = square();
    json["extensionsRequired"] = json!(["KHR_mesh_quantization"]);
    let start = blob.len();
    // Positions as unsigned shorts padded to 8 bytes, normals as normalised bytes, texture
    // coordinates as normalised unsigned shorts.
    for [x, y] in [[0u16, 0], [1000, 0], [1000, 1000], [0, 1000]] {
        for value in [x, y, 7, 0] {
            blob.extend(value.to_le_bytes());
        }
    }
    blob.extend([0u8, 0, 127, 0].repeat(4));
    for [u, v] in [[0u16, 65535], [65535, 65535], [65535, 0], [0, 0]] {
        blob.extend([u, v].iter().flat_map(|value| value.to_le_bytes()));
    }
    json["buffers"][0]["byteLength"] = json!(blob.len());
    let views = json["bufferViews"].as_array_mut().expect("an array");
    for (offset, length, stride) in [(0, 32, 8), (32, 16, 4), (48, 16, 4)] {
        views.push(json!({
            "buffer": 0, "byteOffset": start + offset, "byteLength": length, "byteStride": stride,
        }));
    }
    for (accessor, view, component, normalized) in
        [(1, 5, 5123, false), (2, 6, 5120, true), (4, 7, 5123, true)]
    {
        let accessor = &mut json["accessors"][accessor];
        accessor["bufferView"] = json!(view);
        accessor["componentType"] = json!(component);
        accessor["normalized"] = json!(normalized);
    }
    json["nodes"][0]["scale"] = json!([0.001, 0.001, 0.001]);
    let mesh = import_good(&json, &blob);
    for vertex in &mesh.vertices {
        let [u, v] = vertex.uv.to_array();
        assert_close(vertex.position, Vec3::new(u, 1.0 - v, 0.007));
        assert_close(vertex.normal, Vec3::Z);
    }
}

#[test]
fn sparse_accessors_replace_elements() {
    let (mut json, mut blob) = square();
    let start = blob.len();
    blob.extend([2u8, 0, 0, 0]);
    blob.extend(
        [2f32, 2.0, 0.0]
            .iter()
            .flat_map(|value| value.to_le_bytes()),
    );
    json["buffers"][0]["byteLength"] = json!(blob.len());
    let views = json["bufferViews"].as_array_mut().expect("an array");
    views.push(json!({"buffer": 0, "byteOffset": start, "byteLength": 4}));
    views.push(json!({"buffer": 0, "byteOffset": start + 4, "byteLength": 12}));
    json["accessors"][1]["sparse"] = json!({
        "count": 1,
        "indices": {"bufferView": 5, "componentType": 5121},
        "values": {"bufferView": 6},
    });
    let mesh = import_good(&json, &blob);
    assert_eq!(mesh.vertices[2].position, Vec3::new(2.0, 2.0, 0.0));
    assert_eq!(mesh.vertices[1].position, Vec3::X);
}

#[test]
fn a_double_sided_square_becomes_two_sheets() {
    let (mut json, blob) = square();
    json["materials"][0]["doubleSided"] = json!(true);
    let mesh = import_good(&json, &blob);
    assert_eq!((mesh.vertices.len(), mesh.triangles.len()), (8, 4));
    assert!(
        mesh.warnings
            .iter()
            .any(|warning| warning.contains("double-sided"))
    );
    let faces = area_normals(&mesh);
    for (triangle, face) in mesh.triangles.iter().zip(&faces) {
        for index in triangle.vertices {
            let [tangent, bitangent, normal] = frame(&mesh.vertices[index as usize]);
            assert_close(normal, *face);
            // The whole frame is negated on the back, so it has the other handedness.
            assert_close(tangent.cross(bitangent) * face.z, normal);
        }
    }
    assert_close(faces[0], Vec3::Z);
    assert_close(faces[2], Vec3::NEG_Z);
}

#[test]
fn materials_and_their_textures_are_read() {
    let (mut json, mut blob) = square();
    let start = blob.len();
    let mut png = std::io::Cursor::new(Vec::new());
    let image = image::ImageBuffer::from_fn(2, 1, |x, _| {
        image::Rgba([65535u16, 257 * 128, 257 * x as u16, 65535])
    });
    image::DynamicImage::ImageRgba16(image)
        .write_to(&mut png, image::ImageFormat::Png)
        .expect("PNG encodes");
    blob.extend(png.get_ref());
    json["buffers"][0]["byteLength"] = json!(blob.len());
    let views = json["bufferViews"].as_array_mut().expect("an array");
    views.push(json!({"buffer": 0, "byteOffset": start, "byteLength": png.get_ref().len()}));
    json["images"] = json!([{"bufferView": 5, "mimeType": "image/png"}]);
    json["textures"] = json!([{"source": 0}]);
    json["materials"][0] = json!({
        "pbrMetallicRoughness": {
            "baseColorFactor": [0.5, 0.25, 1, 1],
            "metallicFactor": 0.75,
            "roughnessFactor": 0.5,
            "baseColorTexture": {"index": 0, "extensions": {"KHR_texture_transform": {
                "offset": [0.25, 0.5], "rotation": std::f32::consts::FRAC_PI_2, "scale": [2, 3],
            }}},
        },
        "normalTexture": {"index": 0, "scale": 0.5},
        "extensions": {"KHR_materials_anisotropy": {
            "anisotropyStrength": 0.6, "anisotropyRotation": 0.3,
        }},
    });
    let mesh = import_good(&json, &blob);
    let material = &mesh.materials[0];
    assert_eq!(
        material.surface,
        Surface::MetallicRoughness {
            base_color: [0.5, 0.25, 1.0],
            metallic: 0.75,
            roughness: 0.5,
            anisotropy_strength: 0.6,
            anisotropy_rotation: 0.3,
        }
    );
    let slot = material.base_color_texture.expect("a base colour texture");
    // (u, v) is scaled, then turned counter-clockwise on an image whose v points down.
    let expected = [[0.0, 3.0, 0.25], [-2.0, 0.0, 0.5]];
    for (row, expected) in slot
        .transform
        .iter()
        .flatten()
        .zip(expected.iter().flatten())
    {
        assert!((row - expected).abs() < TOLERANCE, "{:?}", slot.transform);
    }
    assert_eq!(material.normal_scale, 0.5);
    // One image, two encodings.
    assert_eq!(mesh.textures.len(), 2);
    assert_eq!(
        mesh.textures[slot.texture as usize].texels,
        [255, 128, 0, 255, 255, 128, 1, 255]
    );
}

#[test]
fn unreadable_extensions_are_named() {
    for extension in [
        "KHR_draco_mesh_compression",
        "EXT_meshopt_compression",
        "KHR_texture_basisu",
    ] {
        let (mut json, blob) = square();
        json["extensionsRequired"] = json!(["KHR_texture_transform", extension]);
        let message = import(&json, &blob).expect_err("an extension").to_string();
        assert!(
            message.contains(extension) && message.contains("test.glb"),
            "{message}"
        );
    }
}

#[test]
fn broken_gltf_ends_in_an_error_that_names_the_place() {
    // A JSON pointer, what to put there, and what the message must contain.
    let cases = [
        ("/asset/version", json!("1.0"), "asset.version"),
        ("/scene", json!(3), "scene"),
        ("/scenes/0/nodes", json!([9]), "nodes[9]"),
        ("/nodes/0/mesh", json!(4), "nodes[0].mesh"),
        ("/nodes/0/children", json!([0]), "cycle"),
        ("/nodes/0/scale", json!([1e39, 1, 1]), "out of range"),
        ("/meshes/0/primitives/0/mode", json!(9), "mode"),
        ("/meshes/0/primitives/0/indices", json!(77), "indices"),
        ("/meshes/0/primitives/0/material", json!(1), "materials[1]"),
        ("/meshes/0/primitives/0/attributes", json!({}), "POSITION"),
        (
            "/meshes/0/primitives/0/attributes/NORMAL",
            json!(0),
            "NORMAL",
        ),
        ("/accessors/0/count", json!(7), "bufferViews[0]"),
        ("/accessors/0/count", json!(u64::MAX), "accessors[0]"),
        ("/accessors/0/componentType", json!(5122), "component type"),
        ("/accessors/0/bufferView", json!(4), "indices below 4"),
        ("/accessors/1/count", json!(3), "3 elements"),
        ("/accessors/2/count", json!(3), "NORMAL"),
        ("/accessors/1/byteOffset", json!(u64::MAX), "bufferViews[1]"),
        ("/accessors/1/max", json!([1, 1]), "accessors[1].max"),
        (
            "/accessors/1/sparse",
            json!({
                "count": 5, "indices": {"bufferView": 0, "componentType": 5121},
                "values": {"bufferView": 1},
            }),
            "sparse",
        ),
        (
            "/bufferViews/1/byteOffset",
            json!(u64::MAX),
            "bufferViews[1]",
        ),
        ("/bufferViews/1/byteLength", json!(1000), "bufferViews[1]"),
        ("/bufferViews/1/byteStride", json!(4), "stride"),
        ("/bufferViews/1/buffer", json!(2), "bufferViews[1]"),
        ("/buffers/0/byteLength", json!(100_000), "buffers[0]"),
        (
            "/buffers/0/uri",
            json!("http://example.invalid/a.bin"),
            "buffers[0]",
        ),
        ("/buffers/0/uri", json!("data:;base64,A"), "data URI"),
        (
            "/buffers/0/uri",
            json!("no such file.bin"),
            "no such file.bin",
        ),
        (
            "/materials/0/normalTexture",
            json!({"index": 0}),
            "normalTexture",
        ),
    ];
    for (pointer, value, expected) in cases {
        let (mut json, blob) = square();
        if let Some(target) = json.pointer_mut(pointer) {
            *target = value.clone();
        } else {
            let (parent, key) = pointer.rsplit_once('/').expect("a path");
            json.pointer_mut(parent).expect("a parent")[key] = value.clone();
        }
        let error = import(&json, &blob).expect_err(pointer);
        let message = error.to_string();
        assert!(message.contains(expected), "{pointer} = {value}: {message}");
        assert!(
            message.contains("test.glb") || message.contains(expected),
            "{message}"
        );
    }
}

#[test]
fn not_a_number_is_refused() {
    // Positions and tangents.
    for offset in [12, 12 + 96] {
        let (json, mut blob) = square();
        blob[offset..offset + 4].copy_from_slice(&f32::NAN.to_le_bytes());
        let message = import(&json, &blob).expect_err("a NaN").to_string();
        assert!(message.contains("finite"), "{message}");
    }
}

/// Neither hides where a surface is.
#[test]
fn normals_and_uvs_that_are_no_numbers_are_replaced() {
    let (json, blob) = square();
    let whole = import(&json, &blob).expect("a square");
    for (offset, warning) in [
        (
            12 + 48,
            "1 vertices have a normal that is zero or no number",
        ),
        (
            12 + 160,
            "1 vertices have texture coordinates that are no numbers",
        ),
    ] {
        for number in [f32::NAN, f32::INFINITY] {
            let mut blob = blob.clone();
            blob[offset..offset + 4].copy_from_slice(&number.to_le_bytes());
            let mesh = import(&json, &blob).expect("a square");
            let [told] = &mesh.warnings[..] else {
                panic!("one warning: {:?}", mesh.warnings);
            };
            assert!(told.starts_with(warning), "{told}");
            for (vertex, before) in mesh.vertices.iter().zip(&whole.vertices) {
                assert!(vertex.normal.is_finite() && vertex.uv.is_finite());
                assert_eq!(vertex.normal, before.normal);
            }
        }
    }
    let obj = |uv: &str, normal: &str| {
        let text = format!(
            "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt {uv}\nvn 0 0 1\nvn {normal}\nf 1/1/1 2/2/2 3/1/1\n"
        );
        import_obj(&text)
    };
    for number in ["nan", "-nan", "-nan(ind)", "1.#QNAN0", "inf", "-1.#INF"] {
        let mesh = obj(&format!("0.5 {number}"), "0 0 1").expect("a triangle");
        assert_eq!(mesh.warnings.len(), 1, "{number}: {:?}", mesh.warnings);
        assert!(mesh.vertices.iter().any(|vertex| vertex.uv.x == 0.5));
        assert!(mesh.vertices.iter().all(|vertex| vertex.uv.is_finite()));
        let mesh = obj("0.5 0", &format!("0 {number} 1")).expect("a triangle");
        assert_eq!(mesh.warnings.len(), 1, "{number}: {:?}", mesh.warnings);
        assert!(mesh.vertices.iter().all(|vertex| vertex.normal == Vec3::Z));
    }
    for word in ["ten", "1..5", "nano", "#"] {
        assert!(obj(&format!("0.5 {word}"), "0 0 1").is_err(), "{word}");
    }
}

/// Numbers for mutations, the same on every run.
struct Random(u64);

impl Random {
    fn below(&mut self, bound: usize) -> usize {
        self.0 = self
            .0
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1);
        (self.0 >> 33) as usize % bound
    }
}

/// Feeds every prefix of a file and a number of mutations to an importer, which must return.
fn fuzz(bytes: &[u8], mutations: usize, import: impl Fn(&[u8]) -> Result<Mesh, Error>) {
    for length in 0..bytes.len() {
        let _ = import(&bytes[..length]);
    }
    let mut random = Random(1);
    let mut good = 0;
    for _ in 0..mutations {
        let mut mutated = bytes.to_vec();
        for _ in 0..=random.below(4) {
            let at = random.below(mutated.len());
            match random.below(4) {
                0 => mutated[at] = random.below(256) as u8,
                1 => mutated[at] ^= 1 << random.below(8),
                // Digits make JSON and OBJ that parse but say something else.
                2 => mutated[at] = b"0123456789-.e/"[random.below(14)],
                _ => {
                    let from = random.below(mutated.len());
                    let length = random.below(16).min(mutated.len() - at.max(from));
                    mutated.copy_within(from..from + length, at);
                }
            }
        }
        good += usize::from(import(&mutated).is_ok());
    }
    // Otherwise the mutations stop at the front door.
    assert!(
        good * 20 > mutations,
        "{good} of {mutations} mutations still import"
    );
}

#[test]
fn no_mutation_of_a_glb_panics() {
    let (mut json, blob) = square();
    json["materials"][0]["doubleSided"] = json!(true);
    json["nodes"][0]["rotation"] = json!([0, 0.6, 0, 0.8]);
    fuzz(&glb(&json, &blob), 5000, |bytes| {
        gltf::import(
            &no_files(),
            Path::new("test.glb"),
            &Options::default(),
            bytes,
        )
    });
}

#[test]
fn no_mutation_of_a_textured_glb_panics() {
    let (mut json, mut blob) = square();
    let start = blob.len();
    let mut png = std::io::Cursor::new(Vec::new());
    image::RgbImage::from_pixel(2, 2, image::Rgb([128, 128, 255]))
        .write_to(&mut png, image::ImageFormat::Png)
        .expect("PNG encodes");
    blob.extend(png.get_ref());
    json["buffers"][0]["byteLength"] = json!(blob.len());
    let views = json["bufferViews"].as_array_mut().expect("an array");
    views.push(json!({"buffer": 0, "byteOffset": start, "byteLength": png.get_ref().len()}));
    json["images"] = json!([{"bufferView": 5}]);
    json["textures"] = json!([{"source": 0}]);
    // A normal map without tangents runs MikkTSpace on whatever is left of the coordinates.
    json["materials"][0]["normalTexture"] = json!({"index": 0});
    let attributes = &mut json["meshes"][0]["primitives"][0]["attributes"];
    attributes
        .as_object_mut()
        .expect("an object")
        .remove("TANGENT");
    let bytes = glb(&json, &blob);
    fuzz(&bytes, 5000, |bytes| {
        gltf::import(
            &no_files(),
            Path::new("test.glb"),
            &Options::default(),
            bytes,
        )
    });
    // Extremes of everything that MikkTSpace reads.
    let extremes = [
        f32::MAX,
        -f32::MAX,
        1e30,
        1e12,
        -1e12,
        1e-40,
        0.0,
        -0.0,
        1.0,
    ];
    let mut random = Random(2);
    for _ in 0..5000 {
        let mut blob = blob.clone();
        for _ in 0..=random.below(6) {
            let at = 12 + 4 * random.below((start - 12) / 4);
            blob[at..at + 4].copy_from_slice(&extremes[random.below(9)].to_le_bytes());
        }
        if let Ok(mesh) = import(&json, &blob) {
            for vertex in &mesh.vertices {
                let numbers: &[f32] = bytemuck::cast_slice(std::slice::from_ref(vertex));
                assert!(
                    numbers.iter().all(|number| number.is_finite()),
                    "{vertex:?}"
                );
                assert!(vertex.tangent.is_normalized(), "{vertex:?}");
            }
        }
    }
}

#[test]
fn no_mutation_of_an_obj_panics() {
    let text = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0.2 0.1 0\nv 0 1 0\nvt 0 0\nvt 1 1\nvn 0 0 1\n\
                s 1\nf 1/1/1 2/2/1 3/1/1 4/2/1 5/1/1\ns off\nf -1 -2 -3\ns 2\nf 1/1 2/2 \\\n3/1\n";
    fuzz(text.as_bytes(), 20_000, |bytes| {
        obj::import(
            &no_files(),
            Path::new("test.obj"),
            &Options::default(),
            bytes,
        )
    });
}

#[test]
fn corner_normals_of_a_cube_are_its_diagonals() {
    let mesh = import_obj(
        "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv 0 0 1\nv 1 0 1\nv 1 1 1\nv 0 1 1\n\
         s 1\nf 4 3 2 1\nf 5 6 7 8\nf 1 2 6 5\nf 2 3 7 6\nf 3 4 8 7\nf 4 1 5 8\n",
    )
    .expect("a cube");
    // Whatever the diagonals of the faces are, the angles at a corner sum to 90° per face.
    assert_eq!((mesh.vertices.len(), mesh.triangles.len()), (8, 12));
    for vertex in &mesh.vertices {
        let diagonal = (vertex.position - 0.5).normalize();
        assert_close(vertex.normal, diagonal);
    }
}

#[test]
fn faces_back_to_back_become_two_sides() {
    // A square, its back on the same vertices, and one triangle twice.
    let square = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n";
    let mesh = import_obj(&format!(
        "{square}f 1 2 3\nf 1 3 4\nf 3 2 1\nf 4 3 1\nf 2 3 1\n"
    ))
    .expect("a sheet");
    assert_eq!((mesh.vertices.len(), mesh.triangles.len()), (8, 4));
    for triangle in &mesh.triangles {
        let [a, b, c] = mesh.corners(triangle);
        let face = (b - a).cross(c - a).normalize();
        for vertex in triangle.vertices {
            assert_close(mesh.vertices[vertex as usize].normal, face);
        }
    }
    for part in [
        "2 pairs of triangles lie back to back",
        "1 triangles repeat",
    ] {
        let told = mesh.warnings.iter().any(|warning| warning.contains(part));
        assert!(told, "{part}: {:?}", mesh.warnings);
    }
    // Normals of the file are of one side.
    let mesh = import_obj(&format!(
        "{square}vn 0 0 1\nf 1//1 2//1 3//1\nf 3//1 2//1 1//1\n"
    ))
    .expect("a sheet");
    let normals: Vec<f32> = mesh.vertices.iter().map(|vertex| vertex.normal.z).collect();
    assert_eq!(normals, [1.0, 1.0, 1.0, -1.0, -1.0, -1.0]);
}

#[test]
fn smoothing_groups_keep_edges() {
    let corner = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv 0 0 1\nv 0 1 1\n";
    let faces = ["f 1 2 3 4\n", "f 1 4 6 5\n"];
    let vertices = |text: String| import_obj(&text).expect("two squares").vertices.len();
    // Without groups what bends by more than the crease angle is an edge.
    assert_eq!(vertices(format!("{corner}{}{}", faces[0], faces[1])), 8);
    let blunt = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv -1 0 1\nv -1 1 1\n";
    assert_eq!(vertices(format!("{blunt}{}{}", faces[0], faces[1])), 6);
    assert_eq!(
        vertices(format!("{corner}s 1\n{}s 2\n{}", faces[0], faces[1])),
        8
    );
    assert_eq!(
        vertices(format!("{corner}s 1\n{}s 1\n{}", faces[0], faces[1])),
        6
    );
    assert_eq!(
        vertices(format!("{corner}{}s off\n{}", faces[0], faces[1])),
        8
    );
}

#[test]
fn concave_faces_are_covered_once() {
    // An arrowhead, an L and a comb, each with its area; in the plane x + z = const.
    let outlines: [(&[[f64; 2]], f64); 4] = [
        (&[[0.0, 0.0], [2.0, 1.0], [0.0, 2.0], [1.0, 1.0]], 1.0),
        (
            &[
                [0.0, 0.0],
                [3.0, 0.0],
                [3.0, 1.0],
                [1.0, 1.0],
                [1.0, 3.0],
                [0.0, 3.0],
            ],
            5.0,
        ),
        (
            &[
                [0.0, 0.0],
                [5.0, 0.0],
                [5.0, 3.0],
                [4.0, 3.0],
                [4.0, 1.0],
                [3.0, 1.0],
                [3.0, 3.0],
                [2.0, 3.0],
                [2.0, 1.0],
                [1.0, 1.0],
                [1.0, 3.0],
                [0.0, 3.0],
            ],
            11.0,
        ),
        // A corner in the middle of a side must not give a triangle without area.
        (
            &[[0.0, 0.0], [1.0, 0.0], [2.0, 0.0], [2.0, 2.0], [0.0, 2.0]],
            4.0,
        ),
    ];
    for (outline, area) in outlines {
        for start in 0..outline.len() {
            let mut text = String::new();
            for i in 0..outline.len() {
                let [s, t] = outline[(start + i) % outline.len()];
                writeln!(text, "v {s} {t} {}", 7.0 - s).expect("strings grow");
            }
            text += "f";
            for i in 1..=outline.len() {
                write!(text, " {i}").expect("strings grow");
            }
            let mesh = import_obj(&text).expect("a polygon");
            assert_eq!(mesh.warnings, Vec::<String>::new());
            assert_eq!(mesh.triangles.len(), outline.len() - 2);
            let total: f32 = mesh
                .triangles
                .iter()
                .map(|triangle| {
                    let [a, b, c] = triangle
                        .vertices
                        .map(|index| mesh.vertices[index as usize].position);
                    let vector = (b - a).cross(c - a) * 0.5;
                    assert!(vector.z > 0.0, "a triangle faces backwards or has no area");
                    vector.z
                })
                .sum();
            assert!(
                (total - area as f32).abs() < TOLERANCE,
                "{total} is not {area}"
            );
        }
    }
}

#[test]
fn obj_indices_may_be_relative_and_lines_continued() {
    let mesh = import_obj(
        "v 0 0 0\nv 1 0 0 2\nv 0 1 0 1\nvt 0.25 0.75\nvt 1\nvn 0 0 2\n\
         f -3/-2/-1 \\\n  -2/1/-1 3/2/1 # end\n"
            .replace(" # end", "")
            .as_str(),
    )
    .expect("a triangle");
    assert_eq!(mesh.vertices.len(), 3);
    assert_eq!(mesh.vertices[0].uv.to_array(), [0.25, 0.25]);
    assert_eq!(mesh.vertices[2].uv.to_array(), [1.0, 1.0]);
    assert_eq!(mesh.vertices[1].normal, Vec3::Z);
}

#[test]
fn broken_obj_files_name_the_line() {
    let triangle = "v 0 0 0\nv 1 0 0\nv 0 1 0\n";
    let cases = [
        ("v 0 0\n", "line 1"),
        ("v 0 nan 0\n", "line 1"),
        ("v 0 1e99 0\n", "line 1"),
        ("v 0 0 0\nvn 0 0\n", "line 2"),
        ("v 0 0 0\nv 1e20 0 0\nv 0 1 0\nf 1 2 3\n", "coordinates"),
        (&format!("{triangle}f 1 2 4\n"), "line 4"),
        (&format!("{triangle}f 1 2 -4\n"), "line 4"),
        (&format!("{triangle}f 0 1 2\n"), "line 4"),
        (&format!("{triangle}f 1 2 x\n"), "line 4"),
        (&format!("{triangle}f 1/2/3/4 2 3\n"), "line 4"),
        (&format!("{triangle}vt 0 0\nf 1/2 2/1 3/1\n"), "line 5"),
        (&format!("{triangle}f 1 1 2\n"), "zero area"),
        (&format!("{triangle}f 1 2\nl 1 2\n"), "no triangle"),
        ("", "no triangle"),
    ];
    for (text, expected) in cases {
        let message = import_obj(text).expect_err(text).to_string();
        assert!(
            message.contains(expected) && message.contains("test.obj"),
            "{text}: {message}"
        );
    }
}

#[test]
fn material_libraries_are_read() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let write = |name: &str, text: &str| {
        std::fs::write(folder.path().join(name), text).expect("a writable folder");
    };
    let mut z = 0;
    let faces = [
        "matte", "shiny", "metal", "absent", "textured", "lamp", "screen",
    ]
    .map(|name| {
        z += 1;
        format!("v 0 0 {z}\nv 1 0 {z}\nv 1 1 {z}\nusemtl {name}\nf -3/1 -2/2 -1/3\n")
    });
    write(
        "a b.obj",
        &format!(
            "mtllib a b.mtl\nmtllib none.mtl\nvt 0 0\nvt 1 0\nvt 1 1\n{}",
            faces.concat()
        ),
    );
    write(
        "a b.mtl",
        "Kd 9 9\nnewmtl matte\nKd 0.25\nKs 1 1 1\nillum 1\nnewmtl shiny\nKd 0.1 0.2 0.3\n\
         Ks 0.5 0.5 0.5\nNs 40\nnewmtl metal\n Kd 1 2 0\n Pr 0.4\n Pm 1\nnewmtl textured\n\
         Kd 0 0 0\nmap_Kd -s 2 4 1 -o 0.5 0.25 -clamp on red dot.png\nbump -bm 2 none.png\n\
         newmtl lamp\nKe 12 10 -7\nnewmtl screen\nmap_Ke red dot.png\n",
    );
    let red = image::RgbImage::from_pixel(1, 1, image::Rgb([255, 0, 0]));
    red.save(folder.path().join("red dot.png"))
        .expect("PNG encodes");
    let mesh = super::mesh(&folder.path().join("a b.obj")).expect("a good file");
    let surface = |name: &str| {
        let material = mesh.materials.iter().find(|material| material.name == name);
        material
            .map(|material| material.surface.clone())
            .expect(name)
    };
    let layered = |diffuse, specular| Surface::DiffuseSpecular { diffuse, specular };
    assert_eq!(surface("matte"), layered([0.25; 3], Specular::None));
    let shine = Specular::BlinnPhong {
        specular: [0.5; 3],
        exponent: 40.0,
    };
    assert_eq!(surface("shiny"), layered([0.1, 0.2, 0.3], shine));
    assert_eq!(surface("absent"), layered([0.5; 3], Specular::None));
    assert_eq!(surface("textured"), layered([1.0; 3], Specular::None));
    let Surface::MetallicRoughness {
        base_color,
        metallic,
        roughness,
        ..
    } = surface("metal")
    else {
        panic!("Pr and Pm make a metallic-roughness material")
    };
    assert_eq!(
        (base_color, metallic, roughness),
        ([1.0, 1.0, 0.0], 1.0, 0.4)
    );
    let textured = mesh
        .materials
        .iter()
        .find(|material| material.name == "textured");
    let slot = textured
        .and_then(|material| material.base_color_texture)
        .expect("a texture");
    assert_eq!(
        mesh.textures[slot.texture as usize].texels,
        [255, 0, 0, 255]
    );
    let emission = |name: &str| {
        let material = mesh.materials.iter().find(|material| material.name == name);
        let material = material.expect(name);
        (material.emission, material.emission_texture.is_some())
    };
    assert_eq!(emission("matte"), ([0.0; 3], false));
    assert_eq!(emission("lamp"), ([12.0, 10.0, 0.0], false));
    assert_eq!(emission("screen"), ([1.0; 3], true));
    // v up: 1 - ((1 - v) 4 + 0.25).
    assert_eq!(slot.transform, [[2.0, 0.0, 0.5], [0.0, 4.0, -3.25]]);
    for expected in [
        "none.mtl",
        "absent",
        "clamped",
        "none.png",
        "negative emission",
    ] {
        let found = mesh
            .warnings
            .iter()
            .any(|warning| warning.contains(expected));
        assert!(found, "{expected}: {:?}", mesh.warnings);
    }
    write("bad.mtl", "newmtl x\nKd 1 2\n");
    write(
        "bad.obj",
        "mtllib bad.mtl\nv 0 0 0\nv 1 0 0\nv 1 1 0\nusemtl x\nf 1 2 3\n",
    );
    let message = super::mesh(&folder.path().join("bad.obj"))
        .expect_err("bad Kd")
        .to_string();
    assert!(message.contains("bad.mtl: line 2"), "{message}");
}

/// A PNG of 8 by 8 texels, clear left of the middle.
fn half_clear() -> Vec<u8> {
    let mut png = std::io::Cursor::new(Vec::new());
    image::RgbaImage::from_fn(8, 8, |x, _| {
        image::Rgba([9, 99, 9, if x < 4 { 0 } else { 255 }])
    })
    .write_to(&mut png, image::ImageFormat::Png)
    .expect("PNG encodes");
    png.into_inner()
}

/// The square with a texture of colours, given as bytes.
fn textured_square(image: &[u8]) -> (Value, Vec<u8>) {
    let (mut json, mut blob) = square();
    let view = json!({"buffer": 0, "byteOffset": blob.len(), "byteLength": image.len()});
    blob.extend(image);
    json["buffers"][0]["byteLength"] = json!(blob.len());
    let views = json["bufferViews"].as_array_mut().expect("an array");
    views.push(view);
    json["images"] = json!([{"bufferView": 5}]);
    json["samplers"] = json!([{"wrapS": 33071, "wrapT": 33071}]);
    json["textures"] = json!([{"source": 0, "sampler": 0}]);
    json["materials"][0]["pbrMetallicRoughness"] = json!({"baseColorTexture": {"index": 0}});
    (json, blob)
}

fn area(mesh: &Mesh) -> f32 {
    let areas = mesh
        .soup()
        .into_iter()
        .map(|[a, b, c]| (b - a).cross(c - a).length() * 0.5);
    areas.sum()
}

fn with_cutoff(json: &Value, blob: &[u8], name: &str, cutoff: f32) -> Result<Mesh, Error> {
    let options = Options {
        cutoffs: BTreeMap::from([(name.to_owned(), cutoff)]),
        ..Options::default()
    };
    gltf::import(
        &no_files(),
        Path::new("test.glb"),
        &options,
        &glb(json, blob),
    )
}

#[test]
fn alpha_cuts_as_the_material_says() {
    let (mut json, blob) = textured_square(&half_clear());
    for (mode, expected, warning) in [
        (json!(null), 1.0, ""),
        (json!("OPAQUE"), 1.0, ""),
        (json!("MASK"), 0.5, "\"paint\": its alpha cuts 2 of 2"),
        // Nearly all of it is clear or opaque.
        (json!("BLEND"), 0.5, "BLEND"),
    ] {
        json["materials"][0]["alphaMode"] = mode.clone();
        if mode.is_null() {
            json["materials"][0]
                .as_object_mut()
                .expect("an object")
                .remove("alphaMode");
        }
        let mesh = import_good(&json, &blob);
        assert!(
            (area(&mesh) - expected).abs() < 1e-4,
            "{mode}: {}",
            area(&mesh)
        );
        let left = if expected < 1.0 { 0.5 } else { 0.0 };
        for vertex in &mesh.vertices {
            assert!(vertex.position.x >= left - 1e-4, "{mode}: {vertex:?}");
            assert!((vertex.uv.x - vertex.position.x).abs() < 1e-5);
        }
        let warned = mesh.warnings.iter().any(|text| text.contains(warning));
        assert!(warned || warning.is_empty(), "{mode}: {:?}", mesh.warnings);
    }
    json["materials"][0]["alphaMode"] = json!("MASK");
    // A cutoff of a quarter lies nearer to the clear texels: 1/8 of the way between two middles
    // of texels from there.
    json["materials"][0]["alphaCutoff"] = json!(0.25);
    assert!((area(&import_good(&json, &blob)) - 0.53125).abs() < 1e-3);
    // The factor multiplies the texture.
    json["materials"][0]["pbrMetallicRoughness"]["baseColorFactor"] = json!([1, 1, 1, 0.5]);
    assert!((area(&import_good(&json, &blob)) - 0.5).abs() < 1e-4);
    json["materials"][0]["alphaCutoff"] = json!(0.6);
    let message = import(&json, &blob)
        .expect_err("nothing is left")
        .to_string();
    assert!(message.contains("alpha"), "{message}");
    // A scene file's cutoff comes first.
    let area_with = |cutoff| area(&with_cutoff(&json, &blob, "paint", cutoff).expect("a square"));
    assert!((area_with(0.0) - 1.0).abs() < 1e-6);
    assert!((area_with(0.25) - 0.5).abs() < 1e-4);
    let message = with_cutoff(&json, &blob, "pain", 0.5)
        .expect_err("no such name")
        .to_string();
    assert!(
        message.contains("\"paint\"") && message.contains("cutout.pain"),
        "{message}"
    );
    json["materials"][0]["alphaCutoff"] = json!(0.5);
    json["materials"][0]["pbrMetallicRoughness"]["baseColorFactor"] = json!([1, 1, 1, 1e39]);
    assert!(import(&json, &blob).is_err());
}

#[test]
fn a_mask_on_a_double_sided_material_cuts_both_sides() {
    let (mut json, blob) = textured_square(&half_clear());
    json["materials"][0]["alphaMode"] = json!("MASK");
    json["materials"][0]["doubleSided"] = json!(true);
    let mesh = import_good(&json, &blob);
    assert!((area(&mesh) - 1.0).abs() < 1e-4);
    let front = area_normals(&mesh)
        .iter()
        .filter(|normal| normal.z > 0.0)
        .count();
    assert_eq!(2 * front, mesh.triangles.len());
}

/// Outlines are as coarse as it takes for about as many triangles as are wanted, on both sides, and a warning tells how far off they are.
#[test]
fn masks_leave_about_as_many_triangles_as_are_wanted() {
    let waves = image::RgbaImage::from_fn(256, 256, |x, y| {
        let [x, y] = [x, y].map(|at| f32::from(u16::try_from(at).expect("small")) * 0.1);
        image::Rgba([
            90,
            120,
            40,
            if math::sin(x) * math::sin(y) > 0.2 {
                255
            } else {
                0
            },
        ])
    });
    let mut png = std::io::Cursor::new(Vec::new());
    (waves.write_to(&mut png, image::ImageFormat::Png)).expect("PNG encodes");
    let (mut json, blob) = textured_square(&png.into_inner());
    json["materials"][0]["alphaMode"] = json!("MASK");
    json["materials"][0]["doubleSided"] = json!(true);
    let run = |cut_triangles, max_vertices| {
        let options = Options {
            cut_triangles,
            ..Options::default()
        };
        let access = Access {
            max_vertices,
            ..Access::default()
        };
        let mesh = gltf::import(
            &Files::in_memory(BTreeMap::new(), &access),
            Path::new("test.glb"),
            &options,
            &glb(&json, &blob),
        );
        mesh.expect("a square")
    };
    let (fine, coarse) = (run(None, 1 << 20), run(Some(1500), 1 << 20));
    let counts = [&fine, &coarse].map(|mesh| mesh.triangles.len());
    assert!(counts[0] > 2000 && counts[1] <= 1500, "{counts:?}");
    assert!((area(&coarse) / area(&fine) - 1.0).abs() < 0.03);
    let warned = |mesh: &Mesh, what| mesh.warnings.iter().any(|text| text.contains(what));
    assert!(warned(&fine, "up to 0.25 texels") && !warned(&fine, "fewer"));
    assert!(!warned(&coarse, "up to 0.25 texels") && warned(&coarse, "fewer"));
    // What helps is told: a preset that wants more, or more room.
    assert!(warned(&coarse, "--preset high") && !warned(&coarse, "--limit-vertices"));
    for cut_triangles in [None, Some(1 << 16)] {
        let limited = run(cut_triangles, 2000);
        assert!(limited.triangles.len() <= 2000);
        assert!(!warned(&limited, "--preset high") && warned(&limited, "--limit-vertices"));
    }
}

#[test]
fn no_mutation_of_a_masked_glb_panics() {
    let (mut json, blob) = textured_square(&half_clear());
    json["materials"][0]["alphaMode"] = json!("MASK");
    json["materials"][0]["normalTexture"] = json!({"index": 0});
    fuzz(&glb(&json, &blob), 3000, |bytes| {
        let options = Options::default();
        gltf::import(&no_files(), Path::new("test.glb"), &options, bytes)
    });
    let extremes = [f32::MAX, -1e30, 1e12, 1e6, 1e-40, 0.0, 0.5, 1.0];
    let mut random = Random(5);
    let vertices = 12..blob.len() - half_clear().len();
    for _ in 0..2000 {
        let mut blob = blob.clone();
        for _ in 0..=random.below(4) {
            let at = vertices.start + 4 * random.below(vertices.len() / 4);
            blob[at..at + 4].copy_from_slice(&extremes[random.below(8)].to_le_bytes());
        }
        if let Ok(mesh) = import(&json, &blob) {
            for vertex in &mesh.vertices {
                assert!(vertex.normal.is_normalized() && vertex.tangent.is_normalized());
                assert!(vertex.position.is_finite() && vertex.uv.is_finite());
            }
        }
    }
}

#[test]
fn opacity_maps_of_libraries_cut() {
    let mut grey = std::io::Cursor::new(Vec::new());
    image::GrayImage::from_fn(8, 8, |_, y| image::Luma([if y < 2 { 255 } else { 0 }]))
        .write_to(&mut grey, image::ImageFormat::Png)
        .expect("PNG encodes");
    let text = "mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\n\
                usemtl leaf\nf 1/1 2/2 3/3 4/4\n";
    let run = |library: &str| {
        let files = [
            ("a.mtl", library.as_bytes().to_vec()),
            ("alpha.png", half_clear()),
            ("grey.png", grey.get_ref().clone()),
        ];
        let files = files.map(|(name, bytes)| (name.into(), bytes));
        let files = Files::in_memory(files.into(), &Access::default());
        obj::import(
            &files,
            Path::new("a.obj"),
            &Options::default(),
            text.as_bytes(),
        )
    };
    for (library, expected, warning) in [
        ("newmtl leaf\nmap_d -clamp on alpha.png\n", 0.5, "cuts"),
        ("newmtl leaf\nmap_d -clamp on grey.png\n", 0.25, "cuts"),
        ("newmtl leaf\nd 1\nmap_Kd alpha.png\n", 1.0, ""),
        ("newmtl leaf\nd -halo 0.2\n", 1.0, "transparent"),
        ("newmtl leaf\nTr 0.4\n", 1.0, "transparent"),
        ("newmtl leaf\nmap_d none.png\n", 1.0, "none.png"),
    ] {
        let mesh = run(library).expect(library);
        assert!(
            (area(&mesh) - expected).abs() < 1e-3,
            "{library}: {}",
            area(&mesh)
        );
        let warned = mesh.warnings.iter().any(|text| text.contains(warning));
        assert!(
            warned || warning.is_empty(),
            "{library}: {:?}",
            mesh.warnings
        );
    }
    assert!(run("newmtl leaf\nd nan\n").is_err());
}

#[test]
fn the_crease_angle_can_be_chosen() {
    // Two squares that meet at a right angle.
    let text = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv 0 0 1\nv 0 1 1\nf 1 2 3 4\nf 1 4 6 5\n";
    for (crease, vertices) in [(None, 8), (Some(45.0), 8), (Some(100.0), 6), (Some(0.0), 8)] {
        let options = Options {
            crease_degrees: crease,
            ..Options::default()
        };
        let mesh = obj::import(&no_files(), Path::new("a.obj"), &options, text.as_bytes());
        assert_eq!(
            mesh.expect("two squares").vertices.len(),
            vertices,
            "{crease:?}"
        );
    }
}

/// Appends a buffer view of floats and an accessor of them; gives the accessor's index.
fn add_floats(json: &mut Value, blob: &mut Vec<u8>, kind: &str, values: &[f32]) -> usize {
    let numbers = match kind {
        "VEC2" => 2,
        "VEC3" => 3,
        _ => 4,
    };
    let view = json["bufferViews"].as_array().map_or(0, Vec::len);
    let bytes = values.len() * 4;
    let added = json!({"buffer": 0, "byteOffset": blob.len(), "byteLength": bytes});
    json["bufferViews"]
        .as_array_mut()
        .expect("an array")
        .push(added);
    blob.extend(values.iter().flat_map(|value| value.to_le_bytes()));
    json["buffers"][0]["byteLength"] = json!(blob.len());
    let accessors = json["accessors"].as_array_mut().expect("an array");
    accessors.push(json!({
        "bufferView": view, "type": kind, "componentType": 5126, "count": values.len() / numbers,
    }));
    accessors.len() - 1
}

#[test]
fn instances_are_copies() {
    let (mut json, mut blob) = square();
    let at = add_floats(
        &mut json,
        &mut blob,
        "VEC3",
        &[0.0, 0.0, 0.0, 5.0, 0.0, 0.0],
    );
    let half = std::f32::consts::FRAC_1_SQRT_2;
    let turn = add_floats(
        &mut json,
        &mut blob,
        "VEC4",
        &[0.0, 0.0, 0.0, 1.0, 0.0, half, 0.0, half],
    );
    let scale = add_floats(
        &mut json,
        &mut blob,
        "VEC3",
        &[1.0, 1.0, 1.0, 2.0, 3.0, 1.0],
    );
    let extension =
        |attributes: Value| json!({"EXT_mesh_gpu_instancing": {"attributes": attributes}});
    json["extensionsUsed"] = json!(["EXT_mesh_gpu_instancing"]);
    json["extensionsRequired"] = json!(["EXT_mesh_gpu_instancing"]);
    json["nodes"][0]["extensions"] =
        extension(json!({"TRANSLATION": at, "ROTATION": turn, "SCALE": scale}));
    json["nodes"][0]["translation"] = json!([0, 10, 0]);
    let mesh = import_good(&json, &blob);
    assert_eq!((mesh.vertices.len(), mesh.triangles.len()), (8, 4));
    assert!(mesh.warnings.is_empty(), "{:?}", mesh.warnings);
    // Scaled, then turned about y so that x becomes -z, then moved.
    let (low, high) = mesh.vertices[4..].iter().fold(
        (Vec3::INFINITY, Vec3::NEG_INFINITY),
        |(low, high), vertex| (low.min(vertex.position), high.max(vertex.position)),
    );
    assert!(
        low.distance(Vec3::new(5.0, 10.0, -2.0)) < TOLERANCE,
        "{low}"
    );
    assert!(
        high.distance(Vec3::new(5.0, 13.0, 0.0)) < TOLERANCE,
        "{high}"
    );
    // Attributes of different lengths, accessors that are none, numbers that are none.
    for bad in [
        json!({"TRANSLATION": at, "SCALE": 1}),
        json!({"TRANSLATION": 99}),
        json!(7),
    ] {
        json["nodes"][0]["extensions"] = extension(bad.clone());
        let message = import(&json, &blob).expect_err("bad instances").to_string();
        assert!(
            message.contains("EXT_mesh_gpu_instancing"),
            "{bad}: {message}"
        );
    }
    // A million copies of nothing.
    let many = json["accessors"].as_array().map_or(0, Vec::len);
    let accessors = json["accessors"].as_array_mut().expect("an array");
    accessors.push(json!({"type": "VEC3", "componentType": 5126, "count": 3_000_000}));
    json["nodes"][0]["extensions"] = extension(json!({"SCALE": many}));
    let message = import(&json, &blob).expect_err("too many").to_string();
    assert!(message.contains("copies"), "{message}");
}

#[test]
fn webp_textures_are_read() {
    let texels = [10u8, 20, 30, 255, 40, 50, 60, 128];
    let mut webp = Vec::new();
    image::codecs::webp::WebPEncoder::new_lossless(&mut webp)
        .encode(&texels, 2, 1, image::ExtendedColorType::Rgba8)
        .expect("WebP encodes");
    let (mut json, blob) = textured_square(&webp);
    json["extensionsUsed"] = json!(["EXT_texture_webp"]);
    json["extensionsRequired"] = json!(["EXT_texture_webp"]);
    json["textures"] = json!([{"extensions": {"EXT_texture_webp": {"source": 0}}}]);
    let mesh = import_good(&json, &blob);
    assert_eq!(mesh.textures[0].texels, texels);
    for bad in [json!({}), json!({"source": 9}), json!({"source": -1})] {
        json["textures"] = json!([{"extensions": {"EXT_texture_webp": bad}}]);
        assert!(import(&json, &blob).is_err());
    }
    // The last bytes are padding.
    for length in 0..webp.len() - 8 {
        let (json, blob) = textured_square(&webp[..length]);
        assert!(import(&json, &blob).is_err(), "{length} bytes");
    }
    // Bytes at random in place of one: an image or an error.
    let mut random = Random(11);
    for _ in 0..2000 {
        let mut webp = webp.clone();
        let at = random.below(webp.len());
        webp[at] = random.below(256) as u8;
        let (json, blob) = textured_square(&webp);
        let _ = import(&json, &blob);
    }
}

#[test]
fn refusals_of_compression_name_the_command() {
    for (extension, command) in [
        ("KHR_draco_mesh_compression", "gltf-transform copy"),
        ("EXT_meshopt_compression", "gltf-transform copy"),
        ("KHR_texture_basisu", "gltf-transform ktxdecompress"),
    ] {
        let (mut json, blob) = square();
        json["extensionsRequired"] = json!([extension]);
        let message = import(&json, &blob).expect_err(extension).to_string();
        assert!(
            message.contains(extension) && message.contains(command),
            "{message}"
        );
    }
    // Used without a texture to fall back on.
    let (mut json, blob) = textured_square(&half_clear());
    json["extensionsUsed"] = json!(["KHR_texture_basisu"]);
    json["textures"] = json!([{"extensions": {"KHR_texture_basisu": {"source": 0}}}]);
    let message = import(&json, &blob).expect_err("no PNG").to_string();
    assert!(message.contains("ktxdecompress"), "{message}");
}

/// The colour at a vertex, as pictures show it.
fn painted(mesh: &Mesh, vertex: usize) -> [u8; 3] {
    let slot = mesh.materials[0]
        .base_color_texture
        .expect("a texture of colours");
    let texture = &mesh.textures[slot.texture as usize];
    let Vertex { uv, .. } = mesh.vertices[vertex];
    let [x, y] = [uv.x * texture.width as f32, uv.y * texture.height as f32].map(|x| x as usize);
    let at = 4 * (y * texture.width as usize + x);
    [0, 1, 2].map(|k| texture.texels[at + k])
}

/// The textured square with a second set of coordinates, whose u runs up and whose v runs right.
fn square_of_two_sets() -> (Value, Vec<u8>) {
    let (mut json, mut blob) = textured_square(&half_clear());
    json["textures"] = json!([{"source": 0}]);
    let turned = [0.0f32, 0.0, 0.0, 1.0, 1.0, 1.0, 1.0, 0.0];
    let set = add_floats(&mut json, &mut blob, "VEC2", &turned);
    json["meshes"][0]["primitives"][0]["attributes"]["TEXCOORD_1"] = json!(set);
    (json, blob)
}

#[test]
fn textures_of_two_sets_are_kept_and_tangents_follow_the_normal_map() {
    let (mut json, blob) = square_of_two_sets();
    json["materials"][0]["normalTexture"] = json!({"index": 0, "texCoord": 1});
    json["materials"][0]["emissiveFactor"] = json!([1, 1, 1]);
    json["materials"][0]["emissiveTexture"] = json!({"index": 0, "texCoord": 2});
    let attributes = &mut json["meshes"][0]["primitives"][0]["attributes"];
    attributes
        .as_object_mut()
        .expect("an object")
        .remove("TANGENT");
    let mesh = import_good(&json, &blob);
    let [warning] = &mesh.warnings[..] else {
        panic!("one warning: {:?}", mesh.warnings);
    };
    assert!(warning.contains("materials[0].emissiveTexture uses a third set"));
    let material = &mesh.materials[0];
    let second = |slot: &Option<TextureSlot>| slot.map(|slot| slot.second_uv);
    assert_eq!(second(&material.normal_texture), Some(false));
    assert_eq!(second(&material.base_color_texture), Some(true));
    assert_eq!(second(&material.emission_texture), None);
    for vertex in &mesh.vertices {
        let Vec3 { x, y, .. } = vertex.position;
        assert_eq!(vertex.uv.to_array(), [y, x]);
        assert_eq!(vertex.second_uv.to_array(), [x, 1.0 - y]);
        assert_close(vertex.tangent, Vec3::Y);
    }
    // Without the set that is missing its textures are seen at one point.
    json["materials"][0]["normalTexture"]["texCoord"] = json!(3);
    let mesh = import_good(&json, &blob);
    let missing = "is textured but has no TEXCOORD_3";
    assert!(
        mesh.warnings.iter().any(|text| text.contains(missing)),
        "{:?}",
        mesh.warnings
    );
}

/// A second set that is the first one turned shows what turning the texture does.
#[test]
fn surfaces_are_seen_by_their_second_set() {
    let mut png = std::io::Cursor::new(Vec::new());
    image::RgbaImage::from_fn(8, 8, |x, y| {
        image::Rgba([30 * x as u8, 30 * y as u8, 99, 255])
    })
    .write_to(&mut png, image::ImageFormat::Png)
    .expect("PNG encodes");
    let (mut json, mut blob) = textured_square(png.get_ref());
    json["textures"] = json!([{"source": 0}]);
    json["materials"][0]["emissiveFactor"] = json!([1, 1, 1]);
    let mut two_sets = json.clone();
    // (u, v) -> (v, 1 - u) of the corners.
    let turned = [1.0f32, 1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0];
    let set = add_floats(&mut two_sets, &mut blob, "VEC2", &turned);
    two_sets["meshes"][0]["primitives"][0]["attributes"]["TEXCOORD_1"] = json!(set);
    two_sets["materials"][0]["emissiveTexture"] = json!({"index": 0, "texCoord": 1});
    json["buffers"] = two_sets["buffers"].clone();
    json["materials"][0]["emissiveTexture"] = json!({"index": 0, "extensions": {
        "KHR_texture_transform": {"rotation": std::f32::consts::FRAC_PI_2, "offset": [0.0, 1.0]},
    }});
    json["extensionsUsed"] = json!(["KHR_texture_transform"]);
    let [one, two] = [&json, &two_sets].map(|json| {
        let mesh = import_good(json, &blob);
        assert!(mesh.warnings.is_empty(), "{:?}", mesh.warnings);
        mesh
    });
    assert!(!one.has_second_uvs() && two.has_second_uvs());
    for (one_vertex, two_vertex) in one.vertices.iter().zip(&two.vertices) {
        let seen = |mesh: &Mesh, vertex: &Vertex, slot: Option<TextureSlot>| {
            let slot = slot.expect("a texture");
            // Away from corners, where texels of both sides meet.
            let uv = if slot.second_uv {
                vertex.second_uv
            } else {
                vertex.uv
            };
            sample_point(&mesh.textures, &slot, 0.8 * uv + 0.1)
        };
        let of = |mesh: &Mesh, vertex: &Vertex| {
            let material = &mesh.materials[0];
            let slots = [material.base_color_texture, material.emission_texture];
            slots.map(|slot| seen(mesh, vertex, slot))
        };
        let [[color, emitted], [color_of_one, emitted_of_one]] =
            [of(&two, two_vertex), of(&one, one_vertex)];
        assert!(color.distance(color_of_one) < TOLERANCE);
        assert!(
            emitted.distance(emitted_of_one) < 1e-4,
            "{emitted} {emitted_of_one}"
        );
        assert!(color.distance(emitted) > 1e-3, "{color} {emitted}");
    }
}

#[test]
fn alpha_cuts_by_a_second_set() {
    let (mut json, blob) = square_of_two_sets();
    json["textures"] = json!([{"source": 0, "sampler": 0}]);
    let material = &mut json["materials"][0];
    material["alphaMode"] = json!("MASK");
    material["pbrMetallicRoughness"]["baseColorTexture"]["texCoord"] = json!(1);
    material["normalTexture"] = json!({"index": 0});
    let mesh = import_good(&json, &blob);
    assert!(
        mesh.materials[0]
            .base_color_texture
            .expect("a texture")
            .second_uv
    );
    assert!((area(&mesh) - 0.5).abs() < 1e-4, "{}", area(&mesh));
    for vertex in &mesh.vertices {
        let Vec3 { x, y, .. } = vertex.position;
        assert!(y >= 0.5 - 1e-4, "{vertex:?}");
        assert!(vertex.second_uv.distance(Vec2::new(y, x)) < 1e-5);
        assert!(vertex.uv.distance(Vec2::new(x, 1.0 - y)) < 1e-5);
    }
}

#[test]
fn vertex_colours_become_a_texture() {
    let (mut json, mut blob) = square();
    let linear = [
        1.0f32, 0.0, 0.0, 0.5, 0.0, 1.0, 0.0, 1.0, 0.0, 0.0, 1.0, 1.0, 0.5, 0.5, 0.5, 1.0,
    ];
    let colors = add_floats(&mut json, &mut blob, "VEC4", &linear);
    let attributes = &mut json["meshes"][0]["primitives"][0]["attributes"];
    attributes["COLOR_0"] = json!(colors);
    let mesh = import_good(&json, &blob);
    assert!(mesh.warnings.is_empty(), "{:?}", mesh.warnings);
    // Every corner has its own colour, whatever triangle it is of.
    for triangle in &mesh.triangles {
        for vertex in triangle.vertices {
            let at = mesh.vertices[vertex as usize].position;
            let expected = match (at.x > 0.5, at.y > 0.5) {
                (false, false) => [255, 0, 0],
                (true, false) => [0, 255, 0],
                (true, true) => [0, 0, 255],
                (false, true) => [188; 3],
            };
            assert_eq!(painted(&mesh, vertex as usize), expected, "{at}");
        }
    }
    // One colour needs no copies.
    let grey = [0.25f32; 16];
    let start = blob.len() - 64;
    blob[start..].copy_from_slice(bytemuck::cast_slice(&grey));
    let mesh = import_good(&json, &blob);
    assert_eq!(mesh.vertices.len(), 4);
    assert_eq!(painted(&mesh, 0), [137; 3]);
    // White is no colour, and a texture comes first.
    blob[start..].copy_from_slice(bytemuck::cast_slice(&[1f32; 16]));
    assert!(import_good(&json, &blob).textures.is_empty());
    blob[start..].copy_from_slice(bytemuck::cast_slice(&grey));
    let (mut textured, mut with_image) = textured_square(&half_clear());
    let colors = add_floats(&mut textured, &mut with_image, "VEC4", &grey);
    textured["meshes"][0]["primitives"][0]["attributes"]["COLOR_0"] = json!(colors);
    let mesh = import_good(&textured, &with_image);
    let mut warnings = mesh.warnings.iter();
    assert!(warnings.any(|text| text.contains("vertex colours")));
    assert_eq!(mesh.textures.len(), 1);
    // As many as there are positions.
    let short = add_floats(&mut json, &mut blob, "VEC3", &[0.5; 9]);
    json["meshes"][0]["primitives"][0]["attributes"]["COLOR_0"] = json!(short);
    assert!(import(&json, &blob).is_err());
}

#[test]
fn vertex_colours_of_obj_files_are_encoded() {
    for (text, expected) in [
        (
            "v 0 0 0 1 0.5 0\nv 1 0 0 1 0.5 0\nv 0 1 0 1 0.5 0\nf 1 2 3\n",
            [255, 128, 0],
        ),
        (
            "v 0 0 0 255 128 0\nv 1 0 0 255 128 0\nv 0 1 0 255 128 0\nf 1 2 3\n",
            [255, 128, 0],
        ),
    ] {
        let mesh = import_obj(text).expect("a triangle");
        assert_eq!(painted(&mesh, 0), expected);
        let white = Surface::DiffuseSpecular {
            diffuse: [1.0; 3],
            specular: Specular::None,
        };
        assert_eq!(mesh.materials[0].surface, white);
    }
    // A weight is no colour, and one colour leaves the others white.
    assert!(
        import_obj("v 0 0 0 1\nv 1 0 0 1\nv 0 1 0 1\nf 1 2 3\n")
            .expect("a triangle")
            .textures
            .is_empty()
    );
    let mesh = import_obj("v 0 0 0\nv 1 0 0 0 0 0\nv 0 1 0\nf 1 2 3\n").expect("a triangle");
    let found: Vec<_> = (0..3).map(|vertex| painted(&mesh, vertex)).collect();
    assert_eq!(found, [[255; 3], [0; 3], [255; 3]]);
}

#[test]
fn of_primitives_on_each_other_the_first_is_kept() {
    let (mut json, blob) = square();
    let again = json["meshes"][0]["primitives"][0].clone();
    let primitives = json["meshes"][0]["primitives"]
        .as_array_mut()
        .expect("an array");
    primitives.push(again);
    primitives[1]["material"] = json!(1);
    json["materials"] = json!([{"name": "first"}, {"name": "second"}]);
    let mesh = import_good(&json, &blob);
    assert_eq!((mesh.vertices.len(), mesh.triangles.len()), (4, 2));
    assert_eq!(mesh.materials.len(), 1);
    assert_eq!(mesh.materials[0].name, "first");
    assert!(
        mesh.warnings[0].starts_with("2 triangles lie exactly"),
        "{:?}",
        mesh.warnings
    );
}
