//! Random valid assets.

use relight_format::{
    BakeReport, Blend, Camera, Cluster, Environment, EnvironmentReport, FieldOfView, FittedLobe,
    Layer, Lobe, MAX_FITTED_LOBES, MAX_LAYERS, Material, MaterialAsset, MaterialReport,
    Prefiltered, Representation, Scene, Source, Specular, Surface, Texture, TextureEncoding,
    TextureSlot, Transfer, TransferGroup, Triangle, Vertex, VisibilityErrors, VisibilityParameters,
};

/// SplitMix64 (Steele, Lea & Flood 2014): small, seeded, the same everywhere.
pub struct Random(u64);

impl Random {
    pub fn new(seed: u64) -> Self {
        Self(seed)
    }

    pub fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// Below `bound`, which is above 0.
    pub fn below(&mut self, bound: usize) -> usize {
        (self.bits() % bound as u64) as usize
    }

    pub fn chance(&mut self) -> bool {
        self.bits() & 1 == 0
    }

    /// In (0, 1].
    pub fn unit(&mut self) -> f32 {
        ((self.bits() >> 40) + 1) as f32 / (1u32 << 24) as f32
    }

    /// In (−10, 10].
    pub fn signed(&mut self) -> f32 {
        20.0 * self.unit() - 10.0
    }

    fn color(&mut self) -> [f32; 3] {
        std::array::from_fn(|_| 2.0 * self.unit())
    }

    fn vector<const N: usize>(&mut self) -> [f32; N] {
        std::array::from_fn(|_| self.signed())
    }

    fn name(&mut self) -> String {
        let letters = ['a', 'Z', '0', ' ', '/', 'é', '\n', '\u{1f600}'];
        (0..self.below(6))
            .map(|_| letters[self.below(letters.len())])
            .collect()
    }

    fn maybe<T>(&mut self, make: impl FnOnce(&mut Self) -> T) -> Option<T> {
        self.chance().then(|| make(self))
    }
}

/// A valid environment.
pub fn environment(random: &mut Random) -> Environment {
    let lobes = (0..random.below(5))
        .map(|_| {
            let axis = random.vector::<3>();
            let length = axis.iter().map(|x| x * x).sum::<f32>().sqrt();
            Lobe {
                axis: axis.map(|x| x / length),
                sharpness: 1e4 * random.unit(),
                amplitude: random.color(),
                reserved: 0.0,
            }
        })
        .collect();
    let sources: Vec<Source> = (0..random.below(3))
        .map(|_| Source {
            theta: random.unit(),
            phi: 6.0 * random.unit(),
            row_step: 0.01 + 0.1 * random.unit(),
            column_step: 0.01 + 0.1 * random.unit(),
            rows: 1 + random.below(5) as u32,
            columns: 1 + random.below(5) as u32,
        })
        .collect();
    let texels = sources.iter().map(Source::texels).sum();
    Environment {
        source_texels: (0..texels).map(|_| random.color()).collect(),
        sources,
        report: EnvironmentReport {
            source: random.name(),
            source_size: [random.bits() as u32, random.bits() as u32],
            repaired_pixels: random.bits(),
            relative_l2: random.unit(),
            energy_error: random.vector(),
        },
        lobes,
        prefiltered: Prefiltered {
            texels: (0..Prefiltered::texel_count(random.below(4) as u32))
                .map(|_| random.bits() as u32)
                .collect(),
        },
    }
}

/// A valid scene; some have no vertices, some no clusters, some no textures.
#[allow(clippy::too_many_lines, reason = "one field after the other")]
pub fn scene(random: &mut Random) -> Scene {
    let textures: Vec<Texture> = (0..random.below(3))
        .map(|_| {
            let (width, height) = (1 + random.below(4) as u32, 1 + random.below(4) as u32);
            let encoding = if random.chance() {
                TextureEncoding::Srgb
            } else {
                TextureEncoding::Linear
            };
            let texels = (0..width * height * 4)
                .map(|_| random.bits() as u8)
                .collect();
            Texture {
                width,
                height,
                encoding,
                texels,
            }
        })
        .collect();
    let materials: Vec<Material> = (0..=random.below(8))
        .map(|_| material(random, textures.len()))
        .collect();
    let resolution = 2 + random.below(3) as u32;
    let mut scene = Scene {
        name: random.name(),
        visibility: VisibilityParameters {
            representation: if random.chance() {
                Representation::ClusteredPca
            } else {
                Representation::GlobalPca
            },
            sample_resolution: 1 + random.below(4096) as u32,
            basis_resolution: resolution,
            distance_clamp: 3.0 * random.unit(),
            ray_offset: random.unit(),
        },
        camera: random.maybe(|random| Camera {
            position: random.vector(),
            target: random.vector(),
            up: random.vector(),
            field_of_view: if random.chance() {
                FieldOfView::X(3.0 * random.unit())
            } else {
                FieldOfView::Y(3.0 * random.unit())
            },
        }),
        materials,
        textures,
        report: BakeReport {
            source_vertices: random.bits(),
            source_triangles: random.bits(),
            errors: VisibilityErrors {
                surface: random.unit(),
                interpolation: random.unit(),
                compression: random.unit(),
                resolution: random.unit(),
            },
            warnings: (0..random.below(3)).map(|_| random.name()).collect(),
        },
        vertices: Vec::new(),
        second_uvs: Vec::new(),
        triangles: Vec::new(),
        clusters: Vec::new(),
        coefficients: Vec::new(),
        basis: Vec::new(),
        transfer: None,
    };
    for cluster in 0..random.below(4) {
        let first_vertex = scene.vertices.len() as u32;
        let vertex_count = random.below(6) as u32;
        let tiles = 1 + random.below(8) as u32;
        scene.clusters.push(Cluster {
            first_vertex,
            vertex_count,
            first_coefficient: scene.coefficients.len() as u32,
            first_tile: scene.basis.len() as u32 / (4 * resolution * resolution),
            tiles,
            coefficient_scale: random.unit(),
        });
        scene.vertices.extend((0..vertex_count).map(|_| Vertex {
            position: random.vector(),
            normal: random.vector(),
            tangent: random.vector(),
            uv: random.vector(),
        }));
        let coefficients = vertex_count * 4 * tiles;
        scene
            .coefficients
            .extend((0..coefficients).map(|_| (random.bits() as i16).max(-32767)));
        let texels = tiles * 4 * resolution * resolution;
        scene
            .basis
            .extend((0..texels).map(|_| (random.bits() as i8).max(-127)));
        if vertex_count > 0 {
            scene
                .triangles
                .extend((0..random.below(6)).map(|_| Triangle {
                    vertices: std::array::from_fn(|_| {
                        first_vertex + random.below(vertex_count as usize) as u32
                    }),
                    material: random.below(scene.materials.len()) as u16,
                    cluster: cluster as u16,
                }));
        }
    }
    if random.chance() && !scene.vertices.is_empty() {
        scene.second_uvs = scene.vertices.iter().map(|_| random.vector()).collect();
        for slot in scene.materials.iter_mut().flat_map(Material::slots_mut) {
            slot.second_uv = random.chance();
        }
    }
    scene.transfer = random.maybe(|random| transfer(random, &scene.clusters));
    scene
}

fn transfer(random: &mut Random, clusters: &[Cluster]) -> Transfer {
    let mut transfer = Transfer {
        order: random.below(3) as u32,
        emitted: random.chance(),
        bounces: random.bits() as u32,
        last_bounce: random.unit(),
        error: random.unit(),
        ..Transfer::default()
    };
    for (index, cluster) in clusters.iter().enumerate() {
        if index == 0 || random.chance() {
            let (rank, outputs) = (random.below(4), if random.chance() { 3 } else { 7 });
            let rows = (rank + 1) * outputs;
            transfer.groups.push(TransferGroup {
                first_cluster: index as u32,
                rank: rank as u32,
                outputs: outputs as u32,
                reserved: 0,
            });
            transfer.scales.extend((0..rows).map(|_| random.unit()));
            let numbers = rows * 3 * transfer.columns();
            let number = |_| (random.bits() as i8).max(-127);
            transfer.basis.extend((0..numbers).map(number));
        }
        let rank = transfer.groups.last().map_or(0, |group| group.rank);
        let number = |_| (random.bits() as i8).max(-127);
        transfer
            .weights
            .extend((0..cluster.vertex_count * rank).map(number));
    }
    transfer
}

/// A valid scene with something in every section and vertices in two clusters.
pub fn full_scene() -> Scene {
    let full = |scene: &Scene| {
        let populated = scene
            .clusters
            .iter()
            .filter(|cluster| cluster.vertex_count > 0)
            .count();
        let bounced =
            (scene.transfer.as_ref()).is_some_and(|transfer| !transfer.weights.is_empty());
        populated > 1 && !scene.triangles.is_empty() && !scene.textures.is_empty() && bounced
    };
    (0..1000)
        .map(|seed| scene(&mut Random::new(seed)))
        .find(full)
        .expect("such scenes are common")
}

pub fn material_asset(random: &mut Random) -> MaterialAsset {
    let textures: Vec<_> = (0..random.below(4))
        .map(|_| {
            let (width, height) = (1 + random.below(5), 1 + random.below(5));
            Texture {
                width: width as u32,
                height: height as u32,
                encoding: TextureEncoding::Linear,
                texels: (0..width * height * 4)
                    .map(|_| random.bits() as u8)
                    .collect(),
            }
        })
        .collect();
    MaterialAsset {
        report: MaterialReport {
            source: random.name(),
            relative_l2: random.unit(),
            corrected_relative_l2: random.unit(),
            shaded_relative_l2: random.unit(),
            albedo_error: random.unit(),
        },
        material: material(random, textures.len()),
        textures,
    }
}

fn material(random: &mut Random, textures: usize) -> Material {
    let slot = |random: &mut Random| {
        (textures > 0 && random.chance()).then(|| TextureSlot {
            texture: random.below(textures) as u32,
            transform: [random.vector(), random.vector()],
            second_uv: false,
        })
    };
    Material {
        base_color_texture: slot(random),
        metallic_roughness_texture: slot(random),
        normal_texture: slot(random),
        anisotropy_texture: slot(random),
        emission: random.color(),
        emission_texture: slot(random),
        shadow_catcher: random.below(4) == 0,
        normal_scale: random.signed(),
        name: random.name(),
        surface: surface(random, &slot),
    }
}

fn surface(random: &mut Random, slot: &impl Fn(&mut Random) -> Option<TextureSlot>) -> Surface {
    if random.chance() {
        let layers = (0..=random.below(MAX_LAYERS))
            .map(|_| {
                let (blend, most_lobes) = if random.chance() {
                    (Blend::Over, 2)
                } else {
                    (Blend::Coat, 1)
                };
                Layer {
                    diffuse: random.color(),
                    specular: specular(random, most_lobes),
                    weight: random.unit(),
                    blend,
                    diffuse_texture: slot(random),
                    specular_texture: slot(random),
                    roughness_texture: slot(random),
                    weight_texture: slot(random),
                }
            })
            .collect();
        return Surface::Layers { layers };
    }
    if random.chance() {
        return Surface::MetallicRoughness {
            base_color: random.color(),
            metallic: random.unit(),
            roughness: random.unit(),
            anisotropy_strength: random.unit(),
            anisotropy_rotation: random.signed(),
        };
    }
    Surface::DiffuseSpecular {
        diffuse: random.color(),
        specular: specular(random, MAX_FITTED_LOBES),
    }
}

fn specular(random: &mut Random, most_lobes: usize) -> Specular {
    match random.below(8) {
        0 => Specular::None,
        1 => Specular::BlinnPhong {
            specular: random.color(),
            exponent: 1.0 + 1e3 * random.unit(),
        },
        2 => Specular::Ward {
            specular: random.color(),
            alpha: [random.unit(), random.unit()],
        },
        3 => Specular::CookTorrance {
            f0: random.color(),
            roughness: random.unit(),
        },
        4 => Specular::Ggx {
            f0: random.color(),
            alpha: [random.unit(), random.unit()],
        },
        5 => Specular::AshikhminShirley {
            f0: random.color(),
            exponents: [2.0 + 1e3 * random.unit(), 2.0 + random.unit()],
        },
        _ => Specular::Lobes {
            ratio: None,
            path: random.name(),
            lobes: (0..=random.below(most_lobes))
                .map(|_| FittedLobe {
                    f0: random.color(),
                    f90: random.color(),
                    roughness: random.unit(),
                })
                .collect(),
        },
    }
}
