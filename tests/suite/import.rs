//! Meshes and scene files from the test data.

use std::path::{Path, PathBuf};

use libtest_mimic::Trial;
use relight_bake::files::{Access, Files};
use relight_bake::import;
use relight_bake::internals::mesh::{refine, set_mikktspace};
use relight_bake::mesh::{Mesh, Vertex};
use relight_bake::scene::load;
use relight_format::{FieldOfView, Specular, Surface};
use serde_json::Value;

use crate::support::{Outcome, with_data};

/// Trials of this module.
pub fn trials() -> Vec<Trial> {
    vec![
        with_data("import::good_files", good_files),
        with_data("import::broken_files", broken_files),
        with_data("import::awkward_files_import_or_say_why", awkward_files),
        with_data("import::reference_scenes_are_expressible", reference_scenes),
        with_data("import::mikktspace_agrees_with_exporters", mikktspace),
        with_data("import::refined_figures_stay_closed", refined_figures),
    ]
}

/// File below meshes/, vertices, triangles, materials and textures; then what the warnings
/// must mention, in order. Counts of vertices in use and of triangles with area are those
/// of MANIFEST.md except where one of the mentions says why; hard edges of OBJ files without
/// normals add vertices.
type Good = (&'static str, [usize; 4], &'static [&'static str]);

const GOOD: [Good; 27] = [
    ("stanford/bunny.obj", [34978, 69451, 1, 0], &[]),
    ("stanford/armadillo.obj", [43437, 86482, 1, 0], &[]),
    ("stanford/dragon_100k.obj", [60711, 100_000, 1, 0], &[]),
    ("figures/spot.obj", [3235, 5856, 1, 0], &[]),
    ("figures/teapot.obj", [3657, 6320, 1, 0], &[]),
    (
        "figures/suzanne_quads.obj",
        [512, 968, 1, 0],
        &["back to back"],
    ),
    ("figures/suzi.glb", [8098, 15744, 1, 0], &[]),
    (
        "figures/cesium_man_walk/walk_0.obj",
        [3273, 4672, 1, 0],
        &["wind against"],
    ),
    (
        "figures/cesium_man_walk/walk_1.obj",
        [3273, 4672, 1, 0],
        &["wind against"],
    ),
    (
        "figures/cesium_man_walk/walk_2.obj",
        [3273, 4672, 1, 0],
        &["wind against"],
    ),
    ("figures/CesiumMan.glb", [3273, 4672, 1, 1], &["bind pose"]),
    ("figures/Duck.glb", [2399, 4212, 1, 1], &[]),
    (
        "scenes/FlightHelmet/FlightHelmet.gltf",
        [65864, 114_402, 6, 15],
        &["transparent", "double-sided"],
    ),
    (
        "scenes/cornell_box/scene.gltf",
        [128, 64, 8, 0],
        &["double-sided"],
    ),
    (
        "scenes/CornellBox_bevy.glb",
        [148, 72, 5, 0],
        &["double-sided"],
    ),
    (
        "scenes/vr-gallery.glb",
        [2582, 1930, 1, 2],
        &["KHR_materials_unlit"],
    ),
    (
        "anisotropy/AnisotropyBarnLamp/AnisotropyBarnLamp_png.gltf",
        [7712, 10203, 3, 4],
        &["clearcoat", "transmission", "volume"],
    ),
    (
        "anisotropy/AnisotropyDiscTest.glb",
        [3279, 2788, 12, 1],
        &[],
    ),
    // Every instance gets its own vertices.
    (
        "anisotropy/AnisotropyStrengthTest.glb",
        [53311, 97240, 50, 1],
        &[],
    ),
    (
        "thin/carbon60.glb",
        [157_480, 211_118, 1, 0],
        &[
            "own normals",
            "inside out",
            "4461 triangles of zero",
            "back to back",
            "wind against",
        ],
    ),
    (
        "thin/low-poly-tree.glb",
        [6064, 2252, 1, 2],
        &["double-sided"],
    ),
    ("thin/simple_pole.glb", [936, 580, 3, 0], &[]),
    ("awkward/nested.glb", [144, 72, 1, 0], &["double-sided"]),
    (
        "awkward/gltf/box_sparse.glb",
        [36, 12, 1, 0],
        &["inside out"],
    ),
    (
        "awkward/gltf/sphere/sphere.gltf",
        [231, 224, 1, 2],
        &[
            "sheen",
            "transmission",
            "clearcoat",
            "volume",
            "ior",
            "specular",
        ],
    ),
    ("awkward/tinyobj/cornell_box.obj", [72, 36, 4, 0], &[]),
    ("awkward/draco/cube_quads.obj", [24, 12, 1, 0], &[]),
];

fn good_files(data: &Path) -> Outcome {
    for (file, counts, warnings) in GOOD {
        let mesh = import::mesh(&data.join("meshes").join(file))?;
        let found = [
            mesh.vertices.len(),
            mesh.triangles.len(),
            mesh.materials.len(),
            mesh.textures.len(),
        ];
        assert_eq!(
            found, counts,
            "{file}: vertices, triangles, materials, textures"
        );
        assert_eq!(
            mesh.warnings.len(),
            warnings.len(),
            "{file}: {:?}",
            mesh.warnings
        );
        for (warning, expected) in mesh.warnings.iter().zip(warnings) {
            assert!(
                warning.contains(expected),
                "{file}: {warning:?} lacks {expected:?}"
            );
        }
        assert_promises(&mesh, file);
    }
    Ok(())
}

/// What `mesh::Mesh` promises.
fn assert_promises(mesh: &Mesh, file: &str) {
    /// f32 normalisation, and a dot product of two unit vectors.
    const TOLERANCE: f32 = 1e-4;
    let mut used = vec![false; mesh.vertices.len()];
    for triangle in &mesh.triangles {
        let [a, b, c] = triangle.vertices.map(|index| {
            used[index as usize] = true;
            mesh.vertices[index as usize].position.as_dvec3()
        });
        assert!(
            (b - a).cross(c - a).length() > 0.0,
            "{file}: a triangle has no area"
        );
        assert!(
            usize::from(triangle.material) < mesh.materials.len(),
            "{file}: a bad material"
        );
    }
    assert!(
        used.into_iter().all(|used| used),
        "{file}: a vertex is not used"
    );
    for vertex in &mesh.vertices {
        let numbers: &[f32] = bytemuck::cast_slice(std::slice::from_ref(vertex));
        assert!(
            numbers.iter().all(|number| number.is_finite()),
            "{file}: {vertex:?}"
        );
        let Vertex {
            normal, tangent, ..
        } = *vertex;
        assert!(
            (normal.length() - 1.0).abs() < TOLERANCE,
            "{file}: {vertex:?}"
        );
        assert!(
            (tangent.length() - 1.0).abs() < TOLERANCE,
            "{file}: {vertex:?}"
        );
        assert!(normal.dot(tangent).abs() < TOLERANCE, "{file}: {vertex:?}");
        assert!(vertex.bitangent_sign.abs() == 1.0, "{file}: {vertex:?}");
    }
}

/// File below meshes/awkward/ and what its one error must mention.
const BROKEN: [(&str, &str); 16] = [
    ("draco/degenerate_mesh.obj", "zero area"),
    ("draco/inf_nan.obj", "line 1"),
    ("draco/test_lines.obj", "no triangle"),
    ("gltf/Box_Draco.glb", "KHR_draco_mesh_compression"),
    (
        "gltf/BoxMetaDraco/BoxMetaDraco.gltf",
        "KHR_draco_mesh_compression",
    ),
    ("gltf/minimal_accessor_invalid.gltf", "accessors[1].max"),
    (
        "gltf/non_sparse_accessor_without_buffer_view.gltf",
        "zero area",
    ),
    ("tinyobj/invalid-face-definition.obj", "no triangle"),
    ("tinyobj/invalid-relative-texture-index.obj", "line 2"),
    ("tinyobj/invalid-relative-vertex-index.obj", "line 1"),
    ("tinyobj/issue-140-zero-face-idx.obj", "line 16"),
    ("tinyobj/issue-356-leading-spaces-newmtl.obj", "no triangle"),
    ("tinyobj/line-prim.obj", "no triangle"),
    ("tinyobj/points-prim.obj", "no triangle"),
    ("tinyobj/test-nan.obj", "line 12"),
    ("tinyobj/no such file.obj", "expected a readable file"),
];

fn broken_files(data: &Path) -> Outcome {
    for (file, expected) in BROKEN {
        let path = data.join("meshes/awkward").join(file);
        let message = import::mesh(&path).expect_err(file).to_string();
        assert!(message.contains(expected), "{file}: {message}");
        assert!(
            message.contains(path.to_str().expect("a path in UTF-8")),
            "{message}"
        );
        assert!(!message.contains('\n'), "{message}");
    }
    Ok(())
}

fn awkward_files(data: &Path) -> Outcome {
    let folder = data.join("meshes/awkward");
    let mut files = Vec::new();
    collect(&folder, &mut files)?;
    let mut failed = Vec::new();
    for file in &files {
        let name = file.strip_prefix(&folder)?.to_string_lossy().into_owned();
        match import::mesh(file) {
            Ok(mesh) => assert_promises(&mesh, &name),
            Err(_) => failed.push(name),
        }
    }
    let mut expected: Vec<_> = BROKEN
        .iter()
        .map(|(file, _)| *file)
        .filter(|file| folder.join(file).exists())
        .collect();
    failed.sort_unstable();
    expected.sort_unstable();
    assert_eq!(failed, expected, "of {} files", files.len());
    Ok(())
}

fn collect(folder: &Path, files: &mut Vec<PathBuf>) -> std::io::Result<()> {
    for entry in std::fs::read_dir(folder)? {
        let path = entry?.path();
        if path.is_dir() {
            collect(&path, files)?;
        } else if path
            .extension()
            .is_some_and(|e| e == "obj" || e == "glb" || e == "gltf")
        {
            files.push(path);
        }
    }
    Ok(())
}

/// Writes each scene of the reference renders as a scene file and checks what arrives.
fn reference_scenes(data: &Path) -> Outcome {
    let text = std::fs::read(data.join("reference/mitsuba3_direct/scenes.json"))?;
    let scenes: Value = serde_json::from_slice(&text)?;
    let scenes = scenes["images"].as_object().expect("an object of scenes");
    let folder = tempfile::tempdir()?;
    for (name, scene) in scenes {
        let path = folder.path().join(format!("{name}.toml"));
        std::fs::write(&path, scene_toml(data, scene))?;
        let input = load::load_from(&Files::new(&path, &Access::anywhere())?, &path)?;
        assert_eq!(input.name, *name);
        let environment = input.environment.expect("an environment");
        assert!(environment.is_file(), "{}", environment.display());
        let camera = input.camera.expect("a camera");
        let vector = |key: &str| -> [f32; 3] {
            serde_json::from_value(scene["camera"][key].clone()).expect("a vector")
        };
        assert_eq!(
            [camera.position, camera.target, camera.up],
            ["origin", "target", "up"].map(vector)
        );
        assert_eq!(camera.field_of_view, FieldOfView::X(28f32.to_radians()));
        let [material] = &*input.mesh.materials else {
            panic!("one material")
        };
        let Surface::DiffuseSpecular { diffuse, specular } = &material.surface else {
            panic!("{:?}", material.surface)
        };
        match name.as_str() {
            "bunny_diffuse_grace" => {
                assert_eq!((*diffuse, specular), ([0.5; 3], &Specular::None));
            }
            "walk1_aniso_stpeters" => {
                let ggx = Specular::Ggx {
                    f0: [1.0; 3],
                    alpha: [0.08, 0.4],
                };
                assert_eq!((*diffuse, specular), ([0.0; 3], &ggx));
            }
            "bunny_rgl_aurora_white_lobby" => {
                assert!(matches!(specular, Specular::Lobes { .. }), "{specular:?}");
                let [(0, table)] = &*input.measured else {
                    panic!("{:?}", input.measured)
                };
                assert!(table.is_file(), "{}", table.display());
            }
            other => panic!("no expectation for {other}"),
        }
    }
    assert_eq!(scenes.len(), 3);
    Ok(())
}

fn scene_toml(data: &Path, scene: &Value) -> String {
    let path = |value: &Value| {
        let file = data.join(value.as_str().expect("a path"));
        format!("{:?}", file.to_str().expect("a path in UTF-8"))
    };
    let bsdf = if scene["bsdf"]["type"] == "twosided" {
        &scene["bsdf"]["b"]
    } else {
        &scene["bsdf"]
    };
    let material = match bsdf["type"].as_str() {
        Some("diffuse") => {
            format!(
                "model = 'diffuse'\ndiffuse = {}",
                bsdf["reflectance"]["value"]
            )
        }
        // `material: none` is a perfect mirror's Fresnel term: 1 everywhere.
        Some("roughconductor") => format!(
            "model = 'ggx'\nf0 = 1\nalpha_x = {}\nalpha_y = {}",
            bsdf["alpha_u"], bsdf["alpha_v"]
        ),
        Some("measured") => format!("model = 'measured'\nfile = {}", path(&bsdf["filename"])),
        other => panic!("no model for {other:?}"),
    };
    let camera = &scene["camera"];
    format!(
        "mesh = {}\nenvironment = {}\n[materials.default]\n{material}\n[camera]\norigin = {}\n\
         target = {}\nup = {}\nfov_x_degrees = {}\n",
        path(&scene["mesh"]),
        path(&scene["env"]),
        camera["origin"],
        camera["target"],
        camera["up"],
        camera["fov_x_deg"],
    )
}

/// Sample files carry tangents made by MikkTSpace in other programs.
fn mikktspace(data: &Path) -> Outcome {
    /// Cosine within which tangents count as equal. The files store rounded positions and
    /// normals, to which tangents on small triangles are sensitive.
    const AGREES: f32 = 0.99;
    /// Corners that must agree. The helmet's and the spheres' do to 98 and 100 %; the lamp's
    /// own tangents have the other handedness on 5 % of its corners.
    const FRACTION: f64 = 0.93;
    for file in [
        "scenes/FlightHelmet/FlightHelmet.gltf",
        "anisotropy/AnisotropyBarnLamp/AnisotropyBarnLamp_png.gltf",
        "awkward/gltf/duplicate_meshes/duplicate_meshes.gltf",
    ] {
        let mesh = import::mesh(&data.join("meshes").join(file))?;
        // The hose is double-sided, and the frames of a back sheet are negated as a whole.
        let textured = |material: u16| {
            let material = &mesh.materials[usize::from(material)];
            material.normal_texture.is_some() && material.name != "HoseMat"
        };
        let given: Vec<[u32; 3]> = mesh
            .triangles
            .iter()
            .filter(|triangle| textured(triangle.material))
            .map(|triangle| triangle.vertices)
            .collect();
        let (mut vertices, mut triangles) = (mesh.vertices.clone(), given.clone());
        set_mikktspace(&mut vertices, &mut triangles);
        let mut agreeing = 0;
        for (old, new) in given.iter().flatten().zip(triangles.iter().flatten()) {
            let (old, new) = (&mesh.vertices[*old as usize], &vertices[*new as usize]);
            let cosine = old.tangent.dot(new.tangent);
            agreeing += usize::from(cosine > AGREES && old.bitangent_sign == new.bitangent_sign);
        }
        let fraction = agreeing as f64 / (given.len() * 3) as f64;
        println!("{file}: {:.2} % of corners agree", 100.0 * fraction);
        assert!(fraction > FRACTION, "{file}: {fraction}");
    }
    Ok(())
}

/// Closed figures, texture seams included, must stay closed: every edge between two
/// positions is run through once each way.
fn refined_figures(data: &Path) -> Outcome {
    for (file, max_edge) in [
        ("figures/spot.obj", 0.03),
        ("figures/cesium_man_walk/walk_1.obj", 0.02),
    ] {
        let mesh = import::mesh(&data.join("meshes").join(file))?;
        let before = open_edges(&mesh);
        let (old_vertices, old_triangles) = (mesh.vertices.len(), mesh.triangles.len());
        let refined = refine(mesh, |a, b| a.distance(b) / max_edge, usize::MAX);
        println!(
            "{file}: {old_vertices} to {} vertices, {old_triangles} to {} triangles",
            refined.vertices.len(),
            refined.triangles.len()
        );
        assert!(refined.triangles.len() > old_triangles);
        assert_eq!((before, open_edges(&refined)), (0, 0), "{file}");
    }
    Ok(())
}

fn open_edges(mesh: &Mesh) -> usize {
    let mut edges = std::collections::HashMap::new();
    for triangle in &mesh.triangles {
        let corners = triangle.vertices.map(|index| {
            mesh.vertices[index as usize]
                .position
                .to_array()
                .map(|x| (x + 0.0).to_bits())
        });
        for (a, b) in [(0, 1), (1, 2), (2, 0)] {
            let (a, b) = (corners[a], corners[b]);
            *edges.entry((a.min(b), a.max(b))).or_insert(0i32) += if a < b { 1 } else { -1 };
        }
    }
    edges.values().filter(|balance| **balance != 0).count()
}
