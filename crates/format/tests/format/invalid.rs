//! One objection per rule about content. Reader and writer share the validator, so these
//! go through the writer; `hostile` shows that the reader calls it too.

use relight_format::{
    Blend, Camera, Environment, FieldOfView, FittedLobe, Issue, Layer, Limits, Lobe,
    MAX_FITTED_LOBES, MAX_LAYERS, Scene, SectionKind, Source, Specular, Surface, TextureSlot,
    Transfer, read_environment, read_scene, write_environment, write_scene,
};

use crate::container::File;
use crate::generate::{Random, environment, full_scene};

/// Asserts that `edit` makes a valid scene invalid, for that reason and in that section.
fn assert_rejected(expected: Issue, section: SectionKind, edit: impl FnOnce(&mut Scene)) {
    let mut scene = full_scene();
    write_scene(&scene).expect("valid before the edit");
    edit(&mut scene);
    let error = write_scene(&scene).expect_err("the edit breaks a rule");
    assert_eq!(error.issue(), Some(expected), "{error}");
    assert!(
        error.to_string().contains(&format!("section {section:?}")),
        "{error}"
    );
}

#[test]
fn visibility_parameters() {
    let reject = |edit: fn(&mut Scene)| {
        assert_rejected(Issue::ValueOutOfRange, SectionKind::Metadata, edit);
    };
    reject(|scene| scene.visibility.sample_resolution = 0);
    reject(|scene| scene.visibility.sample_resolution = 4097);
    reject(|scene| scene.visibility.basis_resolution = 1);
    reject(|scene| scene.visibility.basis_resolution = 1025);
    reject(|scene| scene.visibility.distance_clamp = 0.0);
    reject(|scene| scene.visibility.distance_clamp = 3.2);
    reject(|scene| scene.visibility.distance_clamp = f32::NAN);
    reject(|scene| scene.visibility.ray_offset = -1.0);
    reject(|scene| scene.visibility.ray_offset = f32::INFINITY);
    reject(|scene| scene.report.errors.surface = f32::NAN);
    reject(|scene| scene.report.errors.resolution = -1.0);
}

#[test]
fn cameras() {
    let valid = Camera {
        position: [0.0; 3],
        target: [0.0, 0.0, 1.0],
        up: [0.0, 1.0, 0.0],
        field_of_view: FieldOfView::X(1.0),
    };
    for camera in [
        Camera {
            position: [f32::NAN, 0.0, 0.0],
            ..valid
        },
        Camera {
            up: [f32::INFINITY, 0.0, 0.0],
            ..valid
        },
        Camera {
            field_of_view: FieldOfView::X(0.0),
            ..valid
        },
        Camera {
            field_of_view: FieldOfView::Y(3.2),
            ..valid
        },
    ] {
        assert_rejected(Issue::ValueOutOfRange, SectionKind::Metadata, |scene| {
            scene.camera = Some(camera);
        });
    }
}

#[test]
#[allow(clippy::too_many_lines, reason = "a table of cases")]
fn materials() {
    let surface = |specular| Surface::DiffuseSpecular {
        diffuse: [0.5; 3],
        specular,
    };
    let metallic_roughness = |base_color, metallic, roughness| Surface::MetallicRoughness {
        base_color,
        metallic,
        roughness,
        anisotropy_strength: 0.0,
        anisotropy_rotation: 0.0,
    };
    let (specular, f0) = ([0.5; 3], [0.5; 3]);
    let negative = [0.5, -0.1, 0.5];
    let lobes = |lobes: Vec<FittedLobe>| Specular::Lobes {
        path: String::new(),
        lobes,
        ratio: None,
    };
    let lobe = FittedLobe {
        f0,
        f90: [1.0; 3],
        roughness: 0.5,
    };
    let layer = |weight| Layer {
        diffuse: [0.5; 3],
        specular: lobes(vec![lobe; 3]),
        weight,
        blend: Blend::Over,
        diffuse_texture: None,
        specular_texture: None,
        roughness_texture: None,
        weight_texture: None,
    };
    let layers = |layers| Surface::Layers { layers };
    for surface in [
        metallic_roughness([f32::NAN; 3], 0.0, 0.5),
        metallic_roughness([0.5; 3], 1.1, 0.5),
        metallic_roughness([0.5; 3], 0.0, -0.1),
        Surface::DiffuseSpecular {
            diffuse: negative,
            specular: Specular::None,
        },
        surface(Specular::BlinnPhong {
            specular,
            exponent: 0.5,
        }),
        surface(Specular::BlinnPhong {
            specular,
            exponent: f32::INFINITY,
        }),
        surface(Specular::Ward {
            specular: negative,
            alpha: [0.5; 2],
        }),
        surface(Specular::Ward {
            specular,
            alpha: [0.5, 0.0],
        }),
        surface(Specular::CookTorrance { f0, roughness: 1.5 }),
        surface(Specular::Ggx {
            f0,
            alpha: [f32::NAN, 0.5],
        }),
        surface(Specular::AshikhminShirley {
            f0,
            exponents: [1.5, 10.0],
        }),
        // Two texels, and not with exponents.
        surface(Specular::Lobes {
            path: String::new(),
            lobes: vec![lobe],
            ratio: Some(TextureSlot::whole(0)),
        }),
        surface(lobes(vec![])),
        surface(lobes(vec![lobe; MAX_FITTED_LOBES + 1])),
        surface(lobes(vec![FittedLobe {
            f90: negative,
            ..lobe
        }])),
        surface(lobes(vec![FittedLobe {
            roughness: 0.0,
            ..lobe
        }])),
        layers(vec![]),
        layers(vec![layer(1.5)]),
        layers(vec![layer(f32::NAN)]),
        layers(vec![Layer {
            blend: Blend::Coat,
            ..layer(1.0)
        }]),
        // Nine reflections, then five layers.
        layers(vec![layer(1.0); 3]),
        layers(vec![
            Layer {
                specular: Specular::None,
                ..layer(1.0)
            };
            MAX_LAYERS + 1
        ]),
    ] {
        assert_rejected(Issue::ValueOutOfRange, SectionKind::Metadata, |scene| {
            scene.materials[0].surface = surface;
        });
    }
    assert_rejected(Issue::ValueOutOfRange, SectionKind::Metadata, |scene| {
        scene.materials[0].normal_scale = f32::NAN;
    });
}

#[test]
fn textures() {
    let transform = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]];
    assert_rejected(Issue::IndexOutOfRange, SectionKind::Metadata, |scene| {
        let texture = scene.textures.len() as u32;
        scene.materials[0].normal_texture = Some(TextureSlot {
            transform,
            ..TextureSlot::whole(texture)
        });
    });
    assert_rejected(Issue::ValueOutOfRange, SectionKind::Metadata, |scene| {
        let transform = [[f32::NAN; 3]; 2];
        scene.materials[0].base_color_texture = Some(TextureSlot {
            transform,
            ..TextureSlot::whole(0)
        });
    });
    let reject =
        |edit: fn(&mut Scene)| assert_rejected(Issue::BadLength, SectionKind::Metadata, edit);
    reject(|scene| scene.textures[0].width += 1);
    reject(|scene| scene.textures[0].texels.push(0));
    reject(|scene| {
        scene.textures[0].height = 0;
        scene.textures[0].texels.clear();
    });
}

#[test]
fn vertices_and_triangles() {
    assert_rejected(Issue::ValueOutOfRange, SectionKind::Vertices, |scene| {
        scene.vertices[0].uv[1] = f32::NEG_INFINITY;
    });
    assert_rejected(Issue::ValueOutOfRange, SectionKind::SecondUvs, |scene| {
        scene.second_uvs = vec![[0.0, f32::NAN]; scene.vertices.len()];
    });
    assert_rejected(Issue::BadLength, SectionKind::SecondUvs, |scene| {
        scene.second_uvs = vec![[0.0; 2]; scene.vertices.len() - 1];
    });
    assert_rejected(Issue::ValueOutOfRange, SectionKind::Metadata, |scene| {
        scene.second_uvs.clear();
        assert!(!scene.vertices.is_empty());
        let slot = TextureSlot {
            second_uv: true,
            ..TextureSlot::whole(0)
        };
        scene.materials[0].emission_texture = Some(slot);
    });
    let reject = |edit: fn(&mut Scene)| {
        assert_rejected(Issue::IndexOutOfRange, SectionKind::Triangles, edit);
    };
    reject(|scene| scene.triangles[0].material = scene.materials.len() as u16);
    reject(|scene| scene.triangles[0].cluster = scene.clusters.len() as u16);
    reject(|scene| scene.triangles[0].vertices[2] = u32::MAX);
    // A vertex that exists, in another cluster.
    reject(|scene| {
        let cluster = scene.clusters[scene.triangles[0].cluster as usize];
        let range = cluster.first_vertex..cluster.first_vertex + cluster.vertex_count;
        let other = (0..scene.vertices.len() as u32).find(|vertex| !range.contains(vertex));
        scene.triangles[0].vertices[1] = other.expect("a vertex of another cluster");
    });
}

#[test]
fn clusters() {
    let reject =
        |edit: fn(&mut Scene)| assert_rejected(Issue::ValueOutOfRange, SectionKind::Clusters, edit);
    reject(|scene| scene.clusters[0].first_vertex = 1);
    reject(|scene| scene.clusters[0].first_coefficient = 4);
    reject(|scene| scene.clusters[0].first_tile = 1);
    reject(|scene| scene.clusters[0].tiles = 0);
    reject(|scene| scene.clusters[0].tiles = 9);
    reject(|scene| scene.clusters[0].coefficient_scale = -1.0);
    reject(|scene| scene.clusters[0].coefficient_scale = f32::NAN);
    // first_vertex + vertex_count would wrap 32 bits.
    assert_rejected(Issue::BadLength, SectionKind::Vertices, |scene| {
        scene.clusters.last_mut().unwrap().vertex_count = u32::MAX;
    });
    assert_rejected(Issue::BadLength, SectionKind::Vertices, |scene| {
        scene.vertices.push(scene.vertices[0]);
    });
    assert_rejected(Issue::BadLength, SectionKind::Coefficients, |scene| {
        scene.coefficients.pop();
    });
    assert_rejected(Issue::BadLength, SectionKind::Basis, |scene| {
        scene.basis.push(0);
    });
    assert_rejected(Issue::ValueOutOfRange, SectionKind::Coefficients, |scene| {
        scene.coefficients[0] = i16::MIN;
    });
    assert_rejected(Issue::ValueOutOfRange, SectionKind::Basis, |scene| {
        scene.basis[0] = i8::MIN;
    });
    assert_rejected(Issue::OverBudget, SectionKind::Clusters, |scene| {
        let texels = 4 * (scene.visibility.basis_resolution as usize).pow(2);
        let last = scene.clusters[scene.clusters.len() - 1];
        let mut empty = last;
        empty.first_vertex += last.vertex_count;
        empty.first_coefficient += last.vertex_count * 4 * last.tiles;
        empty.first_tile += last.tiles;
        empty.vertex_count = 0;
        empty.tiles = 1;
        while scene.clusters.len() <= 65_535 {
            scene.clusters.push(empty);
            empty.first_tile += 1;
            scene.basis.extend(std::iter::repeat_n(0, texels));
        }
    });
}

#[test]
fn metadata_beyond_the_limit_is_not_written() {
    assert_rejected(Issue::OverBudget, SectionKind::Metadata, |scene| {
        scene.report.warnings.push("w".repeat(16 << 20));
    });
}

#[test]
fn lobes() {
    let valid = Lobe {
        axis: [0.0, 1.0, 0.0],
        sharpness: 10.0,
        amplitude: [1.0; 3],
        reserved: 0.0,
    };
    let make = |lobe| Environment {
        lobes: vec![valid, lobe],
        ..Environment::default()
    };
    write_environment(&make(valid)).expect("a valid environment");
    for lobe in [
        Lobe {
            axis: [0.0, 1.1, 0.0],
            ..valid
        },
        Lobe {
            axis: [f32::NAN, 1.0, 0.0],
            ..valid
        },
        Lobe {
            sharpness: 0.0,
            ..valid
        },
        Lobe {
            sharpness: f32::INFINITY,
            ..valid
        },
        Lobe {
            amplitude: [0.0, -1.0, 0.0],
            ..valid
        },
        Lobe {
            amplitude: [0.0, f32::NAN, 0.0],
            ..valid
        },
        Lobe {
            reserved: 1.0,
            ..valid
        },
        Lobe {
            reserved: -0.0,
            ..valid
        },
    ] {
        let error = write_environment(&make(lobe)).expect_err("an invalid lobe");
        assert_eq!(error.issue(), Some(Issue::ValueOutOfRange));
        assert!(error.to_string().contains("lobe 1"), "{error}");
    }
    let mut environment = environment(&mut Random::new(1));
    environment.report.relative_l2 = f32::NAN;
    assert!(write_environment(&environment).is_err());
}

#[test]
fn sources() {
    let valid = Source {
        theta: 0.5,
        phi: 6.0,
        row_step: 0.1,
        column_step: 0.2,
        rows: 2,
        columns: 3,
    };
    let make = |source: Source, texel: [f32; 3]| Environment {
        sources: vec![valid, source],
        source_texels: [vec![[1.0; 3]; 6], vec![texel; source.texels().min(1 << 15)]].concat(),
        ..Environment::default()
    };
    write_environment(&make(valid, [0.0; 3])).expect("a valid environment");
    // All around the image, and to the lower pole.
    let around = Source {
        theta: 3.1,
        column_step: std::f32::consts::TAU / 64.0,
        rows: 1,
        columns: 64,
        ..valid
    };
    write_environment(&make(around, [0.0; 3])).expect("a valid environment");
    for source in [
        Source {
            theta: -0.1,
            ..valid
        },
        Source {
            theta: f32::NAN,
            ..valid
        },
        Source {
            phi: f32::INFINITY,
            ..valid
        },
        Source {
            row_step: 0.0,
            ..valid
        },
        Source {
            row_step: f32::INFINITY,
            rows: 1,
            ..valid
        },
        Source {
            column_step: -0.1,
            ..valid
        },
        Source { rows: 0, ..valid },
        Source {
            columns: 0,
            ..valid
        },
        // Below the lower pole, more than once around, and more than there may be.
        Source { rows: 40, ..valid },
        Source {
            columns: 40,
            ..valid
        },
        Source {
            row_step: 1e-4,
            column_step: 1e-4,
            rows: 200,
            columns: 200,
            ..valid
        },
        Source {
            row_step: 1e-30,
            column_step: 1e-30,
            rows: u32::MAX,
            columns: u32::MAX,
            ..valid
        },
    ] {
        let error = write_environment(&make(source, [0.0; 3])).expect_err("an invalid source");
        assert_eq!(error.issue(), Some(Issue::ValueOutOfRange), "{source:?}");
        assert!(error.to_string().contains("source 1"), "{error}");
    }
    for texel in [
        [-1.0, 0.0, 0.0],
        [0.0, f32::NAN, 0.0],
        [0.0, 0.0, f32::INFINITY],
    ] {
        let error = write_environment(&make(valid, texel)).expect_err("an invalid texel");
        assert!(error.to_string().contains("texel 6"), "{error}");
    }
    let mut missing = make(valid, [0.0; 3]);
    missing.source_texels.pop();
    let error = write_environment(&missing).expect_err("a texel less");
    assert_eq!(error.issue(), Some(Issue::BadLength));
    let many = Environment {
        sources: vec![valid; 9],
        source_texels: vec![[0.0; 3]; 54],
        ..Environment::default()
    };
    let error = write_environment(&many).expect_err("nine sources");
    assert_eq!(error.issue(), Some(Issue::BadLength));
    // The same as bytes: the rows of the first source.
    let file = File::parse(&write_environment(&make(valid, [0.0; 3])).unwrap());
    let bytes = file.with_raw(3, |raw| raw[19] = 0x7f);
    assert!(read_environment(&bytes, &Limits::default()).is_err());
}

/// The same rules hold for what arrives as bytes.
#[test]
fn readers_apply_the_rules() {
    let scene = full_scene();
    let file = File::parse(&write_scene(&scene).unwrap());
    let patch = |section: usize, edits: &[(usize, u8)]| {
        let bytes = file.with_raw(section, |raw| {
            for (at, byte) in edits {
                raw[*at] = *byte;
            }
        });
        read_scene(&bytes, &Limits::default())
            .unwrap_err()
            .issue()
            .unwrap()
    };
    // The exponent of x.
    assert_eq!(patch(1, &[(0, 127)]), Issue::ValueOutOfRange);
    // The high bytes of the first triangle's first corner, material and cluster.
    let triangles = scene.triangles.len();
    for number in [
        12 * triangles,
        4 * triangles + 3 * triangles,
        12 * triangles + 3 * triangles,
    ] {
        assert_eq!(patch(2, &[(number, 0x7f)]), Issue::IndexOutOfRange);
    }
    assert_eq!(patch(3, &[(0, 1)]), Issue::ValueOutOfRange);
    // A first coefficient of -1 in steps of 32768.
    let images = 4 * scene
        .clusters
        .iter()
        .map(|cluster| cluster.tiles as usize)
        .sum::<usize>();
    let coefficients = scene.coefficients.len();
    let edits = [
        (0, 0),
        (images, 0x80),
        (2 * images, 1),
        (2 * images + coefficients, 0),
    ];
    assert_eq!(patch(4, &edits), Issue::ValueOutOfRange);
    assert_eq!(patch(5, &[(0, 0x80)]), Issue::ValueOutOfRange);
    let lobe = Lobe {
        axis: [1.0, 0.0, 0.0],
        sharpness: 1.0,
        amplitude: [0.0; 3],
        reserved: 0.0,
    };
    let environment = Environment {
        lobes: vec![lobe],
        ..Environment::default()
    };
    let file = File::parse(&write_environment(&environment).unwrap());
    let bytes = file.with_raw(1, |raw| raw[28] = 1);
    let error = read_environment(&bytes, &Limits::default()).unwrap_err();
    assert_eq!(error.issue(), Some(Issue::ValueOutOfRange));
}

#[test]
fn bounced_light() {
    let reject = |issue, edit: fn(&mut Transfer)| {
        assert_rejected(issue, SectionKind::Transfer, |scene| {
            edit(scene.transfer.as_mut().expect("a full scene has one"));
        });
    };
    let range = Issue::ValueOutOfRange;
    reject(range, |transfer| transfer.order = 10);
    reject(range, |transfer| transfer.last_bounce = f32::NAN);
    reject(range, |transfer| transfer.error = -1.0);
    reject(range, |transfer| transfer.groups[0].first_cluster = 1);
    reject(range, |transfer| transfer.groups[0].rank = 25);
    reject(range, |transfer| transfer.groups[0].outputs = 4);
    reject(range, |transfer| transfer.groups[0].reserved = 1);
    reject(range, |transfer| {
        let mut last = *transfer.groups.last().unwrap();
        last.first_cluster = 99;
        transfer.groups.push(last);
    });
    reject(range, |transfer| transfer.groups.push(transfer.groups[0]));
    reject(range, |transfer| transfer.scales[0] = f32::INFINITY);
    reject(range, |transfer| transfer.basis[0] = -128);
    reject(range, |transfer| transfer.weights[0] = -128);
    let length = Issue::BadLength;
    reject(length, |transfer| transfer.groups.clear());
    reject(length, |transfer| transfer.emitted ^= true);
    reject(length, |transfer| transfer.scales.push(0.0));
    reject(length, |transfer| transfer.basis.push(0));
    reject(length, |transfer| transfer.weights.push(0));
}

#[test]
fn emission() {
    let reject = |edit: fn(&mut Scene)| {
        assert_rejected(Issue::ValueOutOfRange, SectionKind::Metadata, edit);
    };
    reject(|scene| scene.materials[0].emission[1] = -1.0);
    reject(|scene| scene.materials[0].emission[2] = f32::INFINITY);
}
