//! Meshes as people bring them: doubled, inside out, of no area, tiny, huge, cut by alpha. Each is
//! baked with default options, drawn, and compared with truth; where another mesh shows the same
//! surface without the fault, with the truth of that one.

use std::collections::{BTreeMap, HashMap};
use std::fmt::Write as _;
use std::fs;
use std::path::{Path, PathBuf};

use anyhow::Context as _;
use base64::Engine as _;
use glam::{Quat, Vec3};
use relight_bake::files::{Access, Files};
use relight_bake::import::plain_material;
use relight_bake::mesh::{Mesh, ground};
use relight_bake::scene::load::{self, SceneInput};
use relight_format::{Camera, FieldOfView, Surface, write_file};
use serde_json::json;

use super::report::{Cell, Section, Table};
use super::{Laboratory, METHODS, create, percent_of};
use crate::camera::framing;
use crate::compare::compare;
use crate::display;
use crate::image_file::Image;
use crate::shapes::{cuboid, sphere};

/// Pictures of the worst that are shown.
const SHOWN: usize = 10;
/// Error above which a mesh must have been warned about, %.
pub const TO_WARN: f64 = 5.0;

/// Where meshes are in the folder of data.
const MESHES: &str = "meshes";
/// Those of them that are rooms: they stand on no ground, and are looked at from one place at another where not from
/// outside.
const ROOMS: [(&str, Option<[Vec3; 2]>); 5] = [
    ("awkward/tinyobj/cornell_box.obj", None),
    ("awkward/tinyobj/cornell_box_multimaterial.obj", None),
    ("scenes/CornellBox_bevy.glb", None),
    ("scenes/cornell_box/scene.gltf", None),
    (
        "scenes/vr-gallery.glb",
        Some([Vec3::new(3.2, 1.6, 3.2), Vec3::new(-1.5, 1.4, -1.5)]),
    ),
];

/// Field of view within a room, degrees.
const ROOM_VIEW: f32 = 65.0;

/// A mesh, and the one whose truth it should look like if not its own.
struct Case {
    name: String,
    file: PathBuf,
    ground: bool,
    /// From where it is looked at, and at what; `None`: from outside.
    eye: Option<[Vec3; 2]>,
    like: Option<&'static str>,
}

pub fn run(laboratory: &mut Laboratory, section: &mut Section) -> anyhow::Result<()> {
    section.text = vec![format!(
        "Made meshes with one fault each, and all of other people's making that the folder of data has, on a ground \
         under the lobes of `lobby`, 16 of them, default bakes. What shows the same surface as `plain` is \
         compared with the truth of that; the rest with its own. Above {TO_WARN} % there should be \
         a warning that says why."
    )];
    let folder = laboratory.folder.join("inputs");
    create(&folder)?;
    let mut cases = made(&folder)?;
    cases.extend(found(&laboratory.settings.data.join(MESHES))?);
    let light = laboratory.light("lobby", 16)?;
    let (_, method) = METHODS[2];
    let mut truths: BTreeMap<String, Image> = BTreeMap::new();
    let mut rows: Vec<(f64, Vec<Cell>, String, [Image; 2])> = Vec::new();
    let mut refused: Vec<[String; 2]> = Vec::new();
    for case in cases {
        let (input, camera) = match prepared(&case) {
            Ok(prepared) => prepared,
            Err(error) => {
                refused.push([case.name, error.to_string()]);
                continue;
            }
        };
        let triangles = input.mesh.triangles.len();
        let scene = laboratory.bake(input, &laboratory.settings.bake)?;
        let frame = relight_runtime::Frame {
            method,
            ..light.frame(camera)
        };
        let truth = match case.like {
            Some(name) => truths[name].clone(),
            None => laboratory.truth(&scene, &frame)?,
        };
        let image = laboratory.draw(&scene, &frame)?;
        let compared = compare(&image, &truth)?;
        let found = compared.noiseless();
        let bytes = relight_format::write_scene(&scene)?.len();
        let warnings = &scene.report.warnings;
        let row = vec![
            case.name.as_str().into(),
            case.like.unwrap_or("itself").into(),
            triangles.into(),
            scene.vertices.len().into(),
            (bytes as f64 / 1e6).into(),
            percent_of(&compared),
            warnings.len().into(),
            warnings.join("; ").as_str().into(),
        ];
        if case.like.is_none() {
            truths.insert(case.name.clone(), truth.clone());
        }
        // What cannot be compared comes first.
        let rank = if found.is_nan() { f64::INFINITY } else { found };
        rows.push((rank, row, case.name, [image, truth]));
    }
    rows.sort_by(|a, b| b.0.total_cmp(&a.0));
    if !refused.is_empty() {
        let names: Vec<String> = (refused.iter())
            .map(|[name, _]| format!("`{name}`"))
            .collect();
        section.text.push(format!(
            "Refused, with what is wrong where: {}.",
            names.join(", ")
        ));
    }
    let columns = [
        "mesh",
        "compared with",
        "triangles",
        "vertices",
        "asset, MB",
        "relative RMSE, %",
        "warnings",
        "which",
    ];
    let mut table = Table::new("meshes", "Errors by mesh, worst first", &columns);
    for (_, row, ..) in &rows {
        table.rows.push(row.clone());
    }
    let mut why = Table::new("refused", "Refused", &["mesh", "why"]);
    for [name, error] in &refused {
        why.row([name.as_str().into(), error.as_str().into()]);
    }
    section.tables.extend([table, why]);
    for (_, _, name, [image, truth]) in rows.iter().take(SHOWN) {
        let exposure = display::automatic_exposure(truth);
        let (width, pixels) = display::side_by_side(&[image, truth], exposure);
        let caption = format!("{name}: polar, truth");
        let file = file_name(name);
        laboratory.picture(section, &file, &caption, width, &pixels)?;
    }
    Ok(())
}

/// What a mesh's files are called.
fn file_name(name: &str) -> String {
    name.replace(['.', ' ', '/'], "_")
}

/// All meshes of a folder, by name.
fn found(folder: &Path) -> anyhow::Result<Vec<Case>> {
    let mut files = Vec::new();
    let mut folders = vec![folder.to_owned()];
    while let Some(inner) = folders.pop() {
        let entries = fs::read_dir(&inner).with_context(|| inner.display().to_string())?;
        for entry in entries {
            let path = entry.with_context(|| inner.display().to_string())?.path();
            let kind = path.extension().and_then(|kind| kind.to_str());
            if path.is_dir() {
                folders.push(path);
            } else if matches!(kind, Some("obj" | "gltf" | "glb")) {
                files.push(path);
            }
        }
    }
    files.sort_unstable();
    let case = |file: PathBuf| {
        let name = file.strip_prefix(folder).unwrap_or(&file);
        let name = name.display().to_string();
        let room = ROOMS.iter().find(|(room, _)| *room == name);
        Case {
            ground: room.is_none(),
            eye: room.and_then(|(_, eye)| *eye),
            like: None,
            file: file.canonicalize().unwrap_or(file),
            name,
        }
    };
    Ok(files.into_iter().map(case).collect())
}

/// Loads a mesh and puts it on its ground.
fn prepared(case: &Case) -> anyhow::Result<(SceneInput, Camera)> {
    let files = Files::new(&case.file, &Access::default())?;
    let mut input = load::load_from(&files, &case.file)?;
    input.name = file_name(&case.name);
    let (low, high) = input.mesh.bounds().unwrap_or_default();
    let mut camera = framing(low, high);
    if let Some([position, target]) = case.eye {
        camera.position = position.into();
        camera.target = target.into();
        camera.field_of_view = FieldOfView::Y(ROOM_VIEW.to_radians());
    }
    if case.ground {
        let grey = Surface::DiffuseSpecular {
            diffuse: [0.5; 3],
            specular: relight_format::Specular::None,
        };
        let material = plain_material("ground", grey);
        ground::append(&mut input.mesh, &ground::Extent::default(), material)
            .map_err(|(place, expected, found)| anyhow::anyhow!("{place}: {expected}, {found}"))?;
    }
    Ok((input, camera))
}

/// Positions and triangles, as an OBJ file has them.
#[derive(Clone, Default)]
struct Shape {
    positions: Vec<Vec3>,
    triangles: Vec<[usize; 3]>,
}

impl Shape {
    /// A mesh whose vertices are joined where they print alike.
    fn of(mesh: &Mesh) -> Self {
        let mut shape = Self::default();
        let mut known = HashMap::new();
        let mut indices = Vec::new();
        for vertex in &mesh.vertices {
            let key = (vertex.position * 1e5).round().as_ivec3();
            let index = *known.entry(key).or_insert_with(|| {
                shape.positions.push(key.as_vec3() * 1e-5);
                shape.positions.len() - 1
            });
            indices.push(index);
        }
        let triangles = mesh.triangles.iter();
        shape.triangles = triangles
            .map(|triangle| triangle.vertices.map(|vertex| indices[vertex as usize]))
            .filter(|[a, b, c]| a != b && b != c && c != a)
            .collect();
        shape
    }

    fn add(&mut self, other: &Self) {
        let base = self.positions.len();
        self.positions.extend(&other.positions);
        let triangles = other.triangles.iter();
        (self.triangles).extend(triangles.map(|triangle| triangle.map(|index| base + index)));
    }

    fn turned(mut self) -> Self {
        for triangle in &mut self.triangles {
            triangle.swap(1, 2);
        }
        self
    }

    fn moved(mut self, scale: f32, by: Vec3) -> Self {
        for position in &mut self.positions {
            *position = *position * scale + by;
        }
        self
    }

    /// The text of an OBJ file; each triangle is preceded by what `before` says.
    fn obj(&self, before: impl Fn(usize) -> String) -> String {
        let mut text = String::new();
        for p in &self.positions {
            let _ = writeln!(text, "v {:e} {:e} {:e}", p.x, p.y, p.z);
        }
        for (index, triangle) in self.triangles.iter().enumerate() {
            let [a, b, c] = triangle.map(|corner| corner + 1);
            let _ = writeln!(text, "{}f {a} {b} {c}", before(index));
        }
        text
    }
}

/// A ball on a slab beside a pole, all closed.
fn figure() -> Shape {
    let mut mesh = Mesh::default();
    cuboid(
        &mut mesh,
        0,
        Vec3::new(-0.5, 0.0, -0.35),
        Vec3::new(0.5, 0.2, 0.35),
    );
    sphere(&mut mesh, 0, Vec3::new(-0.15, 0.46, 0.0), 0.25, 24);
    cuboid(
        &mut mesh,
        0,
        Vec3::new(0.32, 0.21, -0.05),
        Vec3::new(0.36, 0.9, -0.01),
    );
    Shape::of(&mesh)
}

/// A level square that reaches so far from zero, in rows of cells.
fn square(half: f32, cells: usize) -> Shape {
    let mut square = Shape::default();
    let row = cells + 1;
    for corner in 0..row * row {
        let [x, z] =
            [corner % row, corner / row].map(|k| (2.0 * k as f32 / cells as f32 - 1.0) * half);
        square.positions.push(Vec3::new(x, 0.0, z));
    }
    for cell in 0..cells * cells {
        let a = cell / cells * row + cell % cells;
        square
            .triangles
            .extend([[a, a + row, a + row + 1], [a, a + row + 1, a + 1]]);
    }
    square
}

fn boxes(count: usize) -> Shape {
    let mut all = Shape::default();
    for index in 0..count {
        let mut mesh = Mesh::default();
        // Low-discrepancy numbers (Roberts 2018).
        let [u, v, w] =
            [0.819_172_5, 0.671_043_6, 0.549_700_5].map(|step: f32| (index as f32 * step).fract());
        let half = Vec3::new(0.04 + 0.08 * v, 0.05 + 0.25 * w, 0.04 + 0.08 * u);
        cuboid(&mut mesh, 0, -half, half);
        let turn = Quat::from_rotation_y(6.0 * w) * Quat::from_rotation_x(0.2 * (u - 0.5));
        let at = Vec3::new(u - 0.5, half.y - 0.01, v - 0.5);
        for vertex in &mut mesh.vertices {
            vertex.position = turn * vertex.position + at;
        }
        all.add(&Shape::of(&mesh));
    }
    all
}

/// Writes the meshes with faults.
#[allow(clippy::too_many_lines, reason = "one fault after the other")]
fn made(folder: &Path) -> anyhow::Result<Vec<Case>> {
    let figure = figure();
    let plain = |_| String::new();
    let mut cases = Vec::new();
    let mut add = |name: &str, text: &str, like: Option<&'static str>| -> anyhow::Result<()> {
        let file = folder.join(name).with_extension("obj");
        write_file(&file, text.as_bytes())?;
        cases.push(Case {
            name: name.into(),
            file,
            ground: true,
            eye: None,
            like,
        });
        Ok(())
    };
    add("plain", &figure.obj(plain), None)?;
    let like = Some("plain");
    add("inside_out", &figure.clone().turned().obj(plain), like)?;
    let mut doubled = figure.clone();
    doubled.triangles.extend(figure.clone().turned().triangles);
    add("doubled", &doubled.obj(plain), like)?;
    let mut copied = figure.clone();
    copied.add(&figure.clone().turned());
    add("inside_out_copy", &copied.obj(plain), like)?;
    let mut repeated = figure.clone();
    repeated.triangles.extend(figure.triangles.clone());
    repeated.add(&figure);
    add("repeated", &repeated.obj(plain), like)?;
    let mut empty = figure.clone();
    for [a, b, c] in figure.triangles.iter().copied().step_by(3) {
        empty.triangles.extend([[a, a, b], [c, b, c]]);
        let middle = (figure.positions[a] + figure.positions[b]) * 0.5;
        empty.positions.push(middle);
        empty.triangles.push([a, empty.positions.len() - 1, b]);
    }
    add("zero_area", &empty.obj(plain), like)?;
    add(
        "tiny",
        &figure.clone().moved(1e-6, Vec3::ZERO).obj(plain),
        like,
    )?;
    add(
        "huge",
        &figure.clone().moved(1e6, Vec3::ZERO).obj(plain),
        like,
    )?;
    let far = Vec3::new(1e4, 0.0, -1e4);
    add("far_off", &figure.clone().moved(1.0, far).obj(plain), None)?;
    let numbers = figure.obj(|face| ["vt nan nan\n", "vt 0 inf\n"][face % 2].into());
    let not_a_number: String = numbers
        .lines()
        .map(|line| match line.strip_prefix("f ") {
            Some(corners) => format!("f {}/-1\n", corners.replace(' ', "/-1 ")),
            None => format!("{line}\n"),
        })
        .collect();
    add("uv_not_a_number", &not_a_number, like)?;
    let mut many = Mesh::default();
    sphere(&mut many, 0, Vec3::new(0.0, 0.5, 0.0), 0.5, 56);
    let many = Shape::of(&many);
    add("one_material", &many.obj(plain), None)?;
    let named = many.obj(|index| format!("usemtl m{}\n", index % 10_000));
    add("10000_materials", &named, Some("one_material"))?;
    add("crossing_boxes", &boxes(60).obj(plain), None)?;
    let mut loose = Shape::default();
    for (index, part) in boxes(60)
        .triangles
        .iter()
        .zip(boxes(60).positions)
        .enumerate()
    {
        let (_, at) = part;
        let turn = Quat::from_rotation_y(index as f32) * Quat::from_rotation_x(2.0 * index as f32);
        let corners = [Vec3::X, Vec3::Y, Vec3::Z].map(|axis| at + 0.08 * (turn * axis));
        loose.add(&Shape {
            positions: corners.to_vec(),
            triangles: vec![[0, 1, 2]],
        });
    }
    add("loose_triangles", &loose.obj(plain), None)?;
    // Sheets that share an edge, like the leaves of a book.
    let mut book = Shape {
        positions: vec![Vec3::ZERO, Vec3::Y],
        triangles: Vec::new(),
    };
    for leaf in 0..7 {
        let way = Quat::from_rotation_y(0.4 * leaf as f32) * Vec3::X * 0.8;
        let base = book.positions.len();
        book.positions.extend([way, way + Vec3::Y]);
        book.triangles
            .extend([[0, base, base + 1], [0, base + 1, 1]]);
        book.triangles
            .extend([[0, base + 1, base], [0, 1, base + 1]]);
    }
    add("book", &book.obj(plain), None)?;
    // Half a ball, one-sided, and seen from within as well.
    let mut bowl = Mesh::default();
    sphere(&mut bowl, 0, Vec3::new(0.0, 0.5, 0.0), 0.5, 24);
    let mut bowl = Shape::of(&bowl);
    let positions = bowl.positions.clone();
    (bowl.triangles).retain(|triangle| triangle.iter().all(|&index| positions[index].y < 0.501));
    add("open_bowl", &bowl.obj(plain), None)?;
    // On grounds far wider than the figure, of two triangles and of many; and two of them far apart.
    let beside = figure.clone().moved(1.0, Vec3::new(700.0, 0.0, 300.0));
    let mut two = figure.clone();
    two.add(&beside);
    for (name, mut shape, half, cells) in [
        ("ground_of_100_m", figure.clone(), 50.0, 1),
        ("ground_of_10_km", figure.clone(), 5000.0, 1),
        ("ground_of_10_km_in_cells", figure.clone(), 5000.0, 20),
        ("two_on_a_ground", two, 1000.0, 1),
    ] {
        shape.add(&square(half, cells));
        let file = folder.join(name).with_extension("obj");
        write_file(&file, shape.obj(plain).as_bytes())?;
        cases.push(Case {
            name: name.into(),
            file,
            ground: false,
            eye: Some([Vec3::new(1.3, 1.2, -1.6), Vec3::new(0.0, 0.3, 0.0)]),
            like: None,
        });
    }
    for mode in ["MASK", "BLEND"] {
        let name = format!("alpha_{}", mode.to_lowercase());
        let file = folder.join(&name).with_extension("gltf");
        write_file(&file, &cards(mode)?)?;
        cases.push(Case {
            name,
            file,
            ground: true,
            eye: None,
            like: (mode == "BLEND").then_some("alpha_mask"),
        });
    }
    Ok(cases)
}

/// A bush of crossed cards with leaves on them.
fn cards(mode: &str) -> anyhow::Result<Vec<u8>> {
    const TEXELS: u32 = 128;
    let texel = |at: u32| {
        let [x, y] = [at % TEXELS, at / TEXELS].map(|i| (i as f32 + 0.5) / TEXELS as f32);
        // Seven leaves in a fan, each an ellipse, and a stalk.
        let root = Vec3::new(0.5, 0.95, 0.0);
        let point = Vec3::new(x, y, 0.0) - root;
        let mut inside = 0.02 - point.x.abs().max(-point.y - 0.5);
        for leaf in 0..7 {
            let angle = (leaf as f32 - 3.0) * 0.38;
            let along = Vec3::new(angle.sin(), -angle.cos(), 0.0);
            let (s, t) = (point.dot(along) - 0.6, point.cross(along).z);
            inside = inside.max(0.07 - (s * s * 0.1 + t * t).sqrt());
        }
        let alpha = (inside * TEXELS as f32 + 0.5).clamp(0.0, 1.0);
        [60, 130, 40, (alpha * 255.0) as u8]
    };
    let texels: Vec<u8> = (0..TEXELS * TEXELS).flat_map(texel).collect();
    let mut png = Vec::new();
    let encoder = image::codecs::png::PngEncoder::new(&mut png);
    let kind = image::ExtendedColorType::Rgba8;
    image::ImageEncoder::write_image(encoder, &texels, TEXELS, TEXELS, kind)?;
    let mut positions: Vec<f32> = Vec::new();
    let mut uvs: Vec<f32> = Vec::new();
    let mut indices: Vec<u16> = Vec::new();
    for card in 0..9u16 {
        let turn = Quat::from_rotation_y(2.399_963 * f32::from(card));
        let lean = Quat::from_rotation_x(0.15 * f32::from(card % 3));
        let at = turn * Vec3::new(0.0, 0.0, 0.06 * f32::from(card));
        for (u, v) in [(0.0f32, 1.0f32), (1.0, 1.0), (1.0, 0.0), (0.0, 0.0)] {
            let corner = at + turn * (lean * Vec3::new(u - 0.5, 1.0 - v, 0.0));
            positions.extend(corner.to_array());
            uvs.extend([u, v]);
        }
        indices.extend([0, 1, 2, 0, 2, 3].map(|corner| 4 * card + corner));
    }
    let parts: [Vec<u8>; 3] = [
        positions.iter().flat_map(|x| x.to_le_bytes()).collect(),
        uvs.iter().flat_map(|x| x.to_le_bytes()).collect(),
        indices.iter().flat_map(|x| x.to_le_bytes()).collect(),
    ];
    let mut start = 0;
    let views: Vec<_> = (parts.iter())
        .map(|part| {
            start += part.len();
            json!({"buffer": 0, "byteOffset": start - part.len(), "byteLength": part.len()})
        })
        .collect();
    let encode = |kind: &str, bytes: &[u8]| {
        let text = base64::engine::general_purpose::STANDARD.encode(bytes);
        format!("data:{kind};base64,{text}")
    };
    let blob = parts.concat();
    let file = json!({
        "asset": {"version": "2.0"},
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{
            "attributes": {"POSITION": 0, "TEXCOORD_0": 1}, "indices": 2, "material": 0,
        }]}],
        "materials": [{
            "name": "leaves", "alphaMode": mode, "doubleSided": true,
            "pbrMetallicRoughness": {
                "baseColorTexture": {"index": 0}, "metallicFactor": 0.0, "roughnessFactor": 0.9,
            },
        }],
        "textures": [{"source": 0}],
        "images": [{"uri": encode("image/png", &png)}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "type": "VEC3", "count": positions.len() / 3},
            {"bufferView": 1, "componentType": 5126, "type": "VEC2", "count": uvs.len() / 2},
            {"bufferView": 2, "componentType": 5123, "type": "SCALAR", "count": indices.len()},
        ],
        "bufferViews": views,
        "buffers": [{"byteLength": blob.len(), "uri": encode("application/octet-stream", &blob)}],
    });
    Ok(serde_json::to_vec_pretty(&file)?)
}
