//! Files of every version, frozen: today's reader must read them as what they were.
//!
//! `RELIGHT_UPDATE_GOLDEN=1` writes those of the current version; that is right only until
//! the version is released. A missing file fails.

use std::fmt::Debug;
use std::path::PathBuf;

use relight_format::{
    BakeReport, Blend, Camera, Cluster, Environment, EnvironmentReport, Error, FieldOfView,
    FittedLobe, Layer, Limits, Lobe, Material, MaterialAsset, MaterialReport, Prefiltered,
    RATIO_SIZE, Representation, Scene, Source, Specular, Surface, Texture, TextureEncoding,
    TextureSlot, Transfer, TransferGroup, Triangle, VERSION, Vertex, VisibilityErrors,
    VisibilityParameters, read_environment, read_material, read_scene, write_environment,
    write_material, write_scene,
};

use crate::container::File;

/// The first version that is read.
const FIRST_VERSION: u32 = 4;

fn path(version: u32, name: &str) -> PathBuf {
    let folder = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("tests/golden");
    folder.join(format!("v{version}")).join(name)
}

/// What is written has today's layout, and files of every version are read as the value.
fn frozen<T: PartialEq + Debug>(
    name: &str,
    value: &T,
    write: impl Fn(&T) -> Result<Vec<u8>, Error>,
    read: impl Fn(&[u8], &Limits) -> Result<T, Error>,
) {
    let written = write(value).unwrap();
    if std::env::var_os("RELIGHT_UPDATE_GOLDEN").is_some_and(|value| value == "1") {
        let path = path(VERSION, name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(&path, &written).unwrap();
    }
    for version in FIRST_VERSION..=VERSION {
        let path = path(version, name);
        let bytes = std::fs::read(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
        assert_eq!(read(&bytes, &Limits::default()).unwrap(), *value);
        let found = content(&bytes);
        assert_eq!(found.0, version);
        if version == VERSION {
            assert!(found == content(&written), "the writer's layout changed");
        }
    }
}

/// The header and the raw bytes of every section: all that a release of zstd cannot change.
fn content(bytes: &[u8]) -> (u32, u32, Vec<(u32, Vec<u8>)>) {
    let file = File::parse(bytes);
    let sections = file
        .sections
        .iter()
        .map(|section| (section.kind, section.raw()))
        .collect();
    (file.version, file.kind, sections)
}

#[test]
fn scenes_of_every_version() {
    frozen("scene.relight", &scene(), write_scene, read_scene);
}

/// What scenes of version 4 did not have at first.
#[test]
fn scenes_with_second_texture_coordinates() {
    let mut scene = scene();
    scene.second_uvs = (0..7u8).map(|i| [0.5 * f32::from(i), 0.1]).collect();
    for slot in scene.materials[0].slots_mut().skip(1) {
        slot.second_uv = true;
    }
    assert!(scene.materials[0].uses_second_uv());
    frozen("scene_second_uvs.relight", &scene, write_scene, read_scene);
}

#[test]
fn environments_of_every_version() {
    frozen(
        "environment.relight",
        &environment(),
        write_environment,
        read_environment,
    );
}

#[test]
fn materials_of_every_version() {
    frozen(
        "material.relight",
        &material(),
        write_material,
        read_material,
    );
}

fn texture(
    [width, height]: [u32; 2],
    encoding: TextureEncoding,
    texels: std::ops::Range<u8>,
) -> Texture {
    Texture {
        width,
        height,
        encoding,
        texels: texels.collect(),
    }
}

/// What scenes of version 4 did not have at first: layers, both blends, every texture.
fn material() -> MaterialAsset {
    let slot = |texture| {
        Some(TextureSlot {
            texture,
            transform: [[2.0, 0.0, 0.5], [0.0, -1.0, 1.0]],
            second_uv: false,
        })
    };
    let lobe = |roughness| FittedLobe {
        f0: [0.5, 0.25, 0.125],
        f90: [1.0, 0.75, 0.5],
        roughness,
    };
    let base = Layer {
        diffuse: [0.75, 0.5, 0.25],
        specular: Specular::Lobes {
            path: "métal.binary".to_owned(),
            lobes: vec![lobe(0.5), lobe(0.125)],
            ratio: Some(TextureSlot::whole(2)),
        },
        weight: 1.0,
        blend: Blend::Over,
        diffuse_texture: slot(0),
        specular_texture: slot(1),
        roughness_texture: None,
        weight_texture: None,
    };
    let coat = Layer {
        diffuse: [0.0; 3],
        specular: Specular::AshikhminShirley {
            f0: [0.0625; 3],
            exponents: [8.0, 512.0],
        },
        weight: 0.5,
        blend: Blend::Coat,
        diffuse_texture: None,
        specular_texture: None,
        roughness_texture: slot(0),
        weight_texture: slot(1),
    };
    MaterialAsset {
        report: MaterialReport {
            source: "métal.binary".to_owned(),
            relative_l2: 0.25,
            corrected_relative_l2: 0.0625,
            shaded_relative_l2: 0.5,
            albedo_error: 0.125,
        },
        material: Material {
            name: "métal".to_owned(),
            surface: Surface::Layers {
                layers: vec![base, coat],
            },
            base_color_texture: None,
            metallic_roughness_texture: None,
            normal_texture: slot(1),
            normal_scale: 0.5,
            anisotropy_texture: None,
            emission: [0.0; 3],
            emission_texture: None,
            shadow_catcher: false,
        },
        textures: vec![
            texture([2, 1], TextureEncoding::Srgb, 0..8),
            texture([1, 1], TextureEncoding::Linear, 100..104),
            Texture {
                width: RATIO_SIZE[0],
                height: RATIO_SIZE[1],
                encoding: TextureEncoding::Rgbe,
                texels: [128, 64, 32, 129].repeat((RATIO_SIZE[0] * RATIO_SIZE[1]) as usize),
            },
        ],
    }
}

fn environment() -> Environment {
    Environment {
        report: EnvironmentReport {
            source: "grâce.hdr".to_owned(),
            source_size: [1024, 512],
            repaired_pixels: 3,
            relative_l2: 0.25,
            energy_error: [0.5, -0.25, 0.125],
        },
        lobes: vec![
            Lobe {
                axis: [0.0, 1.0, 0.0],
                sharpness: 4096.0,
                amplitude: [100.0, 50.0, 25.0],
                reserved: 0.0,
            },
            Lobe {
                axis: [0.6, 0.0, -0.8],
                sharpness: 0.5,
                amplitude: [0.0, 0.5, 1.0],
                reserved: 0.0,
            },
        ],
        prefiltered: Prefiltered {
            texels: (0..20).map(|index| 0x7fa3_9b21 ^ (index << 14)).collect(),
        },
        sources: vec![Source {
            theta: 0.75,
            phi: -0.5,
            row_step: 0.125,
            column_step: 0.0625,
            rows: 1,
            columns: 2,
        }],
        source_texels: vec![[1e5, 5e4, 0.0], [0.25, 0.5, 1.0]],
    }
}

/// Every variant, every optional field both ways, two clusters of different tile counts.
#[allow(clippy::too_many_lines, reason = "one literal of every field")]
fn scene() -> Scene {
    let vertex = |index: u32| {
        let x = index as f32;
        Vertex {
            position: [x, -x, 0.5 * x],
            normal: [0.0, 1.0, 0.0],
            tangent: [1.0, 0.0, 0.0, -1.0],
            uv: [0.25 * x, 1.0 - 0.25 * x],
        }
    };
    Scene {
        name: "scène.toml".to_owned(),
        visibility: VisibilityParameters {
            representation: Representation::GlobalPca,
            sample_resolution: 128,
            basis_resolution: 2,
            distance_clamp: 0.5,
            ray_offset: 0.0625,
        },
        camera: Some(Camera {
            position: [1.0, 2.0, 3.0],
            target: [0.0, 0.5, 0.0],
            up: [0.0, 1.0, 0.0],
            field_of_view: FieldOfView::Y(0.75),
        }),
        materials: materials(),
        textures: vec![
            texture([2, 1], TextureEncoding::Srgb, 0..8),
            texture([1, 3], TextureEncoding::Linear, 100..112),
        ],
        report: BakeReport {
            source_vertices: 8,
            source_triangles: 6,
            errors: VisibilityErrors {
                surface: 0.125,
                interpolation: 0.25,
                compression: 0.375,
                resolution: 0.5,
            },
            warnings: vec!["one".to_owned(), "zwei".to_owned()],
        },
        vertices: (0..7).map(vertex).collect(),
        second_uvs: Vec::new(),
        triangles: vec![
            Triangle {
                vertices: [0, 1, 2],
                material: 0,
                cluster: 0,
            },
            Triangle {
                vertices: [3, 4, 5],
                material: 6,
                cluster: 1,
            },
            Triangle {
                vertices: [6, 5, 4],
                material: 2,
                cluster: 1,
            },
        ],
        clusters: vec![
            Cluster {
                first_vertex: 0,
                vertex_count: 3,
                first_coefficient: 0,
                first_tile: 0,
                tiles: 1,
                coefficient_scale: 0.5,
            },
            Cluster {
                first_vertex: 3,
                vertex_count: 4,
                first_coefficient: 12,
                first_tile: 1,
                tiles: 2,
                coefficient_scale: 0.25,
            },
        ],
        coefficients: (0..44).map(|index| index * 1489 - 32767).collect(),
        basis: (0..48).map(|index| (index * 5 - 127) as i8).collect(),
        transfer: Some(Transfer {
            order: 1,
            emitted: true,
            bounces: 5,
            last_bounce: 0.125,
            error: 0.25,
            groups: vec![
                TransferGroup {
                    first_cluster: 0,
                    rank: 2,
                    outputs: 3,
                    reserved: 0,
                },
                TransferGroup {
                    first_cluster: 1,
                    rank: 1,
                    outputs: 7,
                    reserved: 0,
                },
            ],
            scales: (0..23).map(|index| 0.25 * index as f32).collect(),
            basis: (0..345).map(|index| (index % 255 - 127) as i8).collect(),
            weights: (0..10).map(|index| index * 25 - 127).collect(),
        }),
    }
}

fn materials() -> Vec<Material> {
    let slot = |texture| TextureSlot {
        texture,
        transform: [[2.0, 0.0, 0.5], [0.0, -1.0, 1.0]],
        second_uv: false,
    };
    let layered = |specular| Surface::DiffuseSpecular {
        diffuse: [0.75, 0.5, 0.25],
        specular,
    };
    let (specular, f0) = ([0.5, 0.25, 0.125], [0.0625, 0.5, 1.0]);
    let surfaces = [
        Surface::MetallicRoughness {
            base_color: [1.0, 0.5, 0.25],
            metallic: 0.5,
            roughness: 0.25,
            anisotropy_strength: 0.75,
            anisotropy_rotation: 1.5,
        },
        layered(Specular::None),
        layered(Specular::BlinnPhong {
            specular,
            exponent: 64.0,
        }),
        layered(Specular::Ward {
            specular,
            alpha: [0.25, 0.5],
        }),
        layered(Specular::CookTorrance {
            f0,
            roughness: 0.375,
        }),
        layered(Specular::Ggx {
            f0,
            alpha: [0.125, 0.25],
        }),
        layered(Specular::AshikhminShirley {
            f0,
            exponents: [8.0, 32.0],
        }),
    ];
    surfaces
        .into_iter()
        .enumerate()
        .map(|(index, surface)| Material {
            name: format!("material {index}"),
            surface,
            base_color_texture: (index == 0).then(|| slot(0)),
            metallic_roughness_texture: (index == 0).then(|| slot(1)),
            normal_texture: (index < 2).then(|| slot(1)),
            normal_scale: 1.0 - 0.125 * index as f32,
            anisotropy_texture: (index == 0).then(|| slot(0)),
            emission: [0.5 * index as f32, 0.25, 0.0],
            emission_texture: (index == 2).then(|| slot(0)),
            shadow_catcher: false,
        })
        .collect()
}
