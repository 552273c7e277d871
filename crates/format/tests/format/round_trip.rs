//! What is written comes back, and from the same value the same bytes.

use relight_format::{
    Kind, Limits, Scene, StoredTexels, Surface, TextureSlot, inspect, read_environment,
    read_material, read_scene, write_environment, write_file, write_material, write_scene,
    write_scene_with,
};

use crate::container::{File, Section};
use crate::generate::{Random, environment, material_asset, scene};

const SEEDS: u64 = 200;

#[test]
fn random_scenes_come_back() {
    let (mut triangles, mut second_uvs) = (0, 0);
    for seed in 0..SEEDS {
        let scene = scene(&mut Random::new(seed));
        let bytes = write_scene(&scene).expect("a valid scene");
        assert_eq!(bytes, write_scene(&scene).unwrap(), "seed {seed}");
        let texels = StoredTexels::new(&scene.textures).unwrap();
        let with = write_scene_with(&scene, texels).unwrap();
        assert_eq!(bytes, with, "seed {seed}");
        assert_eq!(
            read_scene(&bytes, &Limits::default()).unwrap(),
            scene,
            "seed {seed}"
        );
        triangles += scene.triangles.len();
        second_uvs += scene.second_uvs.len();
    }
    assert!(triangles > 0, "the generator made only empty scenes");
    assert!(second_uvs > 0, "the generator made no second coordinates");
}

#[test]
fn random_materials_come_back() {
    let mut random = Random::new(5);
    let mut layered = 0;
    for _ in 0..SEEDS {
        let asset = material_asset(&mut random);
        let bytes = write_material(&asset).expect("a valid material");
        assert_eq!(bytes, write_material(&asset).unwrap());
        assert_eq!(read_material(&bytes, &Limits::default()).unwrap(), asset);
        layered += usize::from(matches!(asset.material.surface, Surface::Layers { .. }));
        for length in (0..bytes.len()).step_by(37) {
            assert!(read_material(&bytes[..length], &Limits::default()).is_err());
        }
        assert!(read_scene(&bytes, &Limits::default()).is_err());
        let mut without = asset;
        without.material.normal_texture = Some(TextureSlot {
            texture: without.textures.len() as u32,
            ..TextureSlot::whole(0)
        });
        assert!(write_material(&without).is_err());
    }
    assert!(layered > 0, "the generator made no layers");
}

#[test]
fn random_environments_come_back() {
    for seed in 0..SEEDS {
        let environment = environment(&mut Random::new(seed));
        let bytes = write_environment(&environment).expect("a valid environment");
        assert_eq!(
            bytes,
            write_environment(&environment).unwrap(),
            "seed {seed}"
        );
        let read = read_environment(&bytes, &Limits::default()).unwrap();
        assert_eq!(read, environment, "seed {seed}");
    }
}

/// FORMAT.md alone is enough to write a file: any compression level, same content.
#[test]
fn a_file_written_from_the_specification_is_read() {
    for seed in 0..SEEDS {
        let scene = scene(&mut Random::new(seed));
        let mut file = File::parse(&write_scene(&scene).unwrap());
        assert_eq!((file.version, file.kind), (5, 1));
        for section in &mut file.sections {
            *section = Section::new(section.kind, &section.raw());
        }
        assert_eq!(
            read_scene(&file.bytes(), &Limits::default()).unwrap(),
            scene,
            "seed {seed}"
        );
    }
}

#[test]
fn inspect_reports_what_was_written() {
    let scene = Scene {
        transfer: None,
        second_uvs: Vec::new(),
        ..scene(&mut Random::new(3))
    };
    let bytes = write_scene(&scene).unwrap();
    let (kind, version, sections) = inspect(&bytes, &Limits::default()).unwrap();
    assert_eq!((kind, version), (Kind::Scene, 5));
    let kinds: Vec<u32> = sections.iter().map(|section| section.kind as u32).collect();
    assert_eq!(kinds, [1, 2, 3, 4, 5, 6, 7]);
    let lengths: Vec<u64> = sections[1..]
        .iter()
        .map(|section| section.raw_length)
        .collect();
    let texels: usize = scene
        .textures
        .iter()
        .map(|texture| 1 + texture.texels.len())
        .sum();
    let images: usize = (scene.clusters.iter())
        .map(|cluster| 4 * cluster.tiles as usize)
        .sum();
    let expected = [
        // Every vertex is at a place of its own.
        13 + scene.vertices.len() * 52,
        scene.triangles.len() * 16,
        scene.clusters.len() * 24,
        (images + scene.coefficients.len()) * 2,
        scene.basis.len(),
        texels,
    ];
    assert_eq!(lengths, expected.map(|length| length as u64));
}

#[test]
fn a_written_file_replaces_the_old_one_and_leaves_nothing_else() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("asset.relight");
    write_file(&path, b"old").unwrap();
    write_file(&path, b"new").unwrap();
    assert_eq!(std::fs::read(&path).unwrap(), b"new");
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
}

#[test]
fn a_failed_write_names_the_file_and_leaves_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let occupied = folder.path().join("folder.relight");
    std::fs::create_dir_all(occupied.join("inside")).unwrap();
    let error = write_file(&occupied, b"new").unwrap_err();
    assert!(error.to_string().contains("folder.relight: "), "{error}");
    assert_eq!(error.issue(), None);
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
    let missing = folder.path().join("missing").join("asset.relight");
    assert!(
        write_file(&missing, b"new")
            .unwrap_err()
            .to_string()
            .contains("missing")
    );
}
