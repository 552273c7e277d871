//! Every reader of bytes that come from elsewhere, as a function that must return: whatever
//! it is given, it neither panics nor asks for more memory than its limits allow.
//!
//! `libfuzzer/` runs them under libFuzzer, `tests/suite/fuzz.rs` replays the corpus.

pub mod mutate;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use relight_bake::environment::hdr;
use relight_bake::files::{Access, Files};
use relight_bake::measured::Table;
use relight_bake::scene::{description, load, parts};
use relight_bake::{import, scene};
use relight_format::{self as format, Limits};

/// A reader.
#[derive(Clone, Copy)]
pub struct Target {
    /// As on the command line; its corpus is the folder of this name.
    pub name: &'static str,
    /// Reads the bytes.
    pub read: fn(&[u8]),
    /// How mutants of its inputs are kept whole.
    pub repair: mutate::Repair,
}

/// All of them.
pub const TARGETS: [Target; 12] = [
    target("scene", read_scene, mutate::Repair::Asset),
    target("environment", read_environment, mutate::Repair::Asset),
    target("material", read_material, mutate::Repair::Asset),
    target("parts", read_parts, mutate::Repair::Parts),
    target("gltf", read_gltf, mutate::Repair::Glb),
    target("obj", read_obj, mutate::Repair::None),
    target("mtl", read_mtl, mutate::Repair::None),
    target("hdr", read_image, mutate::Repair::None),
    target("exr", read_image, mutate::Repair::None),
    target("rgl", read_table, mutate::Repair::None),
    target("merl", read_merl, mutate::Repair::None),
    target("toml", read_toml, mutate::Repair::None),
];

const fn target(name: &'static str, read: fn(&[u8]), repair: mutate::Repair) -> Target {
    Target { name, read, repair }
}

/// Small enough that no input takes long.
fn access() -> Access {
    Access {
        root: None,
        max_bytes: 1 << 20,
        max_texels: 1 << 16,
        max_vertices: 1 << 12,
    }
}

fn limits() -> Limits {
    Limits {
        max_bytes: 1 << 22,
        ..Limits::default()
    }
}

/// What is valid can be written again, and is then the same.
fn read_scene(bytes: &[u8]) {
    if let Ok(scene) = format::read_scene(bytes, &limits()) {
        let written = format::write_scene(&scene).expect("what was read can be written");
        let again = format::read_scene(&written, &Limits::default()).expect("and read again");
        assert_eq!(
            (scene.vertices.len(), scene.clusters.len()),
            (again.vertices.len(), again.clusters.len())
        );
        let _ = scene::seam::measure(&scene);
    }
    let _ = format::inspect(bytes, &limits());
}

fn read_environment(bytes: &[u8]) {
    if let Ok(environment) = format::read_environment(bytes, &limits()) {
        let written = format::write_environment(&environment).expect("it can be written");
        let again = format::read_environment(&written, &Limits::default()).expect("and read");
        assert_eq!(environment, again);
    }
}

fn read_material(bytes: &[u8]) {
    if let Ok(material) = format::read_material(bytes, &limits()) {
        let written = format::write_material(&material).expect("it can be written");
        let again = format::read_material(&written, &Limits::default()).expect("and read");
        assert_eq!(material, again);
    }
}

/// Parts are files: one in memory, where the system has such.
fn read_parts(bytes: &[u8]) {
    thread_local! {
        static FILE: (tempfile::TempDir, PathBuf) = {
            let memory = Path::new("/dev/shm");
            let folder = if memory.is_dir() {
                tempfile::tempdir_in(memory)
            } else {
                tempfile::tempdir()
            };
            let folder = folder.expect("a temporary folder");
            let path = folder.path().join("parts");
            (folder, path)
        };
    }
    FILE.with(|(_, path)| {
        std::fs::write(path, bytes).expect("a writable folder");
        if let Ok(mut all) = parts::open_all(std::slice::from_ref(path)) {
            for part in &mut all {
                let _ = part.head();
                for chunk in part.identity().chunks().take(64) {
                    let _ = part.chunk(chunk);
                }
            }
        }
        let identity = parts::Identity {
            fingerprint: 0,
            shard: 1,
            shards: 1,
            chunks: 4,
        };
        let _ = parts::Parts::resume(path, identity, "version: 0\n");
    });
}

/// Imports `name` from files in memory.
fn import_mesh(name: &str, others: &[(&str, &[u8])]) {
    let files: BTreeMap<PathBuf, Vec<u8>> = others
        .iter()
        .map(|(name, bytes)| (name.into(), bytes.to_vec()))
        .collect();
    let files = Files::in_memory(files, &access());
    let path = Path::new(name);
    if let Ok(mesh) = import::mesh_of(&files, path, &import::Options::default(), || {
        files.read(path)
    }) {
        assert!(mesh.vertices.len() <= access().max_vertices);
        let vertices = mesh.vertices.len() as u32;
        for triangle in &mesh.triangles {
            assert!(triangle.vertices.iter().all(|index| *index < vertices));
            assert!(usize::from(triangle.material) < mesh.materials.len());
        }
        for vertex in &mesh.vertices {
            assert!((vertex.normal.length() - 1.0).abs() < 1e-3, "{vertex:?}");
        }
    }
}

fn read_gltf(bytes: &[u8]) {
    import_mesh("a.glb", &[("a.glb", bytes), ("0.bin", &[0; 64])]);
}

fn read_obj(bytes: &[u8]) {
    let library = b"newmtl a\nKd 0.5 0.5 0.5\nnewmtl b\nNs 5\nKs 1 1 1\n";
    import_mesh("a.obj", &[("a.obj", bytes), ("a.mtl", library)]);
}

/// The smallest PNG: one grey texel.
const PNG: &[u8] = include_bytes!("texel.png");

fn read_mtl(bytes: &[u8]) {
    let mesh = b"mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nusemtl a\nf 1/1 2/1 3/1\n\
                 usemtl b\nf 2/1 1/1 3/1\n";
    let files = [("a.obj", &mesh[..]), ("a.mtl", bytes), ("a.png", PNG)];
    import_mesh("a.obj", &files);
}

fn read_image(bytes: &[u8]) {
    let reading = hdr::Reading {
        max_pixels: 1 << 14,
        any_shape: true,
        flip: true,
        mirror: true,
    };
    if let Ok(image) = hdr::parse(bytes, &reading) {
        assert!(image.pixels.len() <= 1 << 14);
        let sane = |value: &f32| value.is_finite() && *value >= 0.0;
        assert!(image.pixels.iter().flatten().all(sane));
    }
}

fn read_table(bytes: &[u8]) {
    if let Ok(table) = Table::parse(bytes) {
        for (light, view) in [
            ([0.0, 0.0, 1.0], [0.0, 0.0, 1.0]),
            ([0.6, 0.0, 0.8], [0.0, 0.8, 0.6]),
        ] {
            let (light, view) = (light.into(), view.into());
            let _ = table.evaluate(light, view);
            let _ = table.sample(view, [0.3, 0.5, 0.7]);
            let _ = table.pdf(light, view);
        }
    }
}

/// A whole table is 35 MB: what is given is repeated until it is as long, if its header is
/// right.
fn read_merl(bytes: &[u8]) {
    const VALUES: usize = 90 * 90 * 180 * 3 * 8;
    let header: Vec<u8> = [90i32, 90, 180]
        .iter()
        .flat_map(|n| n.to_le_bytes())
        .collect();
    read_table(bytes);
    if let Some(values) = bytes.strip_prefix(&header[..])
        && values.len() >= 8
        // One in many is enough: each takes a tenth of a second.
        && crc32fast::hash(values).is_multiple_of(4096)
    {
        let values = values.iter().copied().cycle().take(VALUES);
        read_table(&header.into_iter().chain(values).collect::<Vec<u8>>());
    }
}

/// Scene files with something to bake beside them, and material files.
fn read_toml(bytes: &[u8]) {
    let path = Path::new("a.toml");
    let _ = description::parse(path, bytes);
    let mesh = b"v 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl a\nf 1 2 3\n";
    let files = [("a.toml", bytes), ("a.obj", &mesh[..]), ("a.png", PNG)];
    let files = files.map(|(name, bytes)| (PathBuf::from(name), bytes.to_vec()));
    let files = Files::in_memory(files.into(), &access());
    // Grounds of a million vertices take seconds.
    let coarse = description::parse(path, bytes).is_ok_and(|scene| {
        scene
            .ground
            .is_none_or(|ground| match (ground.size, ground.spacing) {
                (_, None) => true,
                (None, Some(spacing)) => spacing > 0.1,
                (Some(size), Some(spacing)) => size / spacing < 64.0,
            })
    });
    if coarse {
        let _ = load::load_from(&files, path);
    }
    let _ = load::load_material(&files, path);
}
