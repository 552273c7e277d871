//! A scene as the GPU sees it: plain buffers and atlas layers, without a GPU.

use bytemuck::Zeroable;
use relight_format::{CHANNELS_PER_TILE, Scene, Surface, Texture, TextureEncoding};

use crate::gpu::{
    AtlasLayout, Cluster, Layer, LimitError, MAX_ATLAS_LAYERS, MAX_ATLAS_SIZE, Material,
    SURFACE_DIFFUSE_SPECULAR, SURFACE_LAYERS, SURFACE_METALLIC_ROUGHNESS, TextureSlot, Vertex,
};
use crate::ssdf::Basis;
use crate::surface::{LayerParameters, Model, has_diffuse, visit_layers};
use crate::textures::{self, PackedTexture, PageLayout};
use crate::transfer::PackedTransfer;

/// Second texture coordinates that take the room of a vertex.
pub const SECOND_UVS: usize = size_of::<Vertex>() / size_of::<[f32; 2]>();

/// A scene as buffers and atlas layers.
#[derive(Clone, Debug)]
pub struct PackedScene {
    /// Vertices, and behind them their second texture coordinates where there are any, [`SECOND_UVS`] in the
    /// room of a vertex.
    pub vertices: Vec<Vertex>,
    /// Three vertices, then `material | cluster << 16`.
    pub triangles: Vec<[u32; 4]>,
    /// Clusters.
    pub clusters: Vec<Cluster>,
    /// Two i16 per word, the first in the low half.
    pub coefficients: Vec<u32>,
    /// Materials.
    pub materials: Vec<Material>,
    /// Size of the texture of all textures' texels, of 32-bit words.
    pub pages: PageLayout,
    /// Where the textures lie in it; [`PackedTexture::visit`] has their texels.
    pub textures: Vec<PackedTexture>,
    /// Size of the atlas.
    pub atlas: AtlasLayout,
    /// RGBA texels of all layers, each in [−127, 127].
    pub basis: Vec<i8>,
    /// Stored signed distances are clamped to ± this angle, radians.
    pub distance_clamp: f32,
    /// Light that bounces, where the scene has it.
    pub transfer: Option<PackedTransfer>,
}

/// Packs a valid scene, that is one that [`relight_format::read_scene`] returned or
/// [`relight_format::write_scene`] accepts.
pub fn pack_scene(scene: &Scene) -> Result<PackedScene, LimitError> {
    let coefficient_words = scene.coefficients.len().div_ceil(2) as u64;
    LimitError::check(
        "32-bit coefficient index",
        coefficient_words,
        u64::from(u32::MAX),
    )?;
    let shapes: Vec<_> = scene.textures.iter().map(Texture::shape).collect();
    let (pages, textures) = textures::place(&shapes)?;
    let (atlas, mut clusters) = place_clusters(scene)?;
    let transfer = PackedTransfer::new(scene);
    if let Some(transfer) = &transfer {
        for (index, cluster) in clusters.iter_mut().enumerate() {
            cluster.bounced = transfer.group(index) + 1;
        }
    }
    Ok(PackedScene {
        vertices: (scene.vertices.iter().map(pack_vertex))
            .chain(scene.second_uvs.chunks(SECOND_UVS).map(pack_second_uvs))
            .collect(),
        triangles: scene
            .triangles
            .iter()
            .map(|triangle| {
                let [a, b, c] = triangle.vertices;
                [
                    a,
                    b,
                    c,
                    u32::from(triangle.material) | u32::from(triangle.cluster) << 16,
                ]
            })
            .collect(),
        basis: fill_atlas(scene, &atlas, &clusters),
        clusters,
        coefficients: scene
            .coefficients
            .chunks(2)
            .map(|pair| {
                let half = |value: i16| u32::from(value.cast_unsigned());
                half(pair[0]) | pair.get(1).map_or(0, |&high| half(high) << 16)
            })
            .collect(),
        materials: scene
            .materials
            .iter()
            .map(|material| pack_material(material, &textures))
            .collect(),
        pages,
        textures,
        atlas,
        distance_clamp: scene.visibility.distance_clamp,
        transfer,
    })
}

/// What [`pack_scene`] makes of a valid scene takes as buffers and textures of a GPU, but for light that bounces;
/// with all levels of its textures or without.
pub fn packed_bytes(scene: &Scene, textures: bool) -> Result<u64, LimitError> {
    fn of<T>(count: usize) -> u64 {
        // Bindings must not be empty.
        count.max(1) as u64 * size_of::<T>() as u64
    }
    let (atlas, _) = place_clusters(scene)?;
    let mut bytes =
        of::<Vertex>(scene.vertices.len() + scene.second_uvs.len().div_ceil(SECOND_UVS))
            + of::<[u32; 4]>(scene.triangles.len())
            + of::<Cluster>(scene.clusters.len())
            + of::<u32>(scene.coefficients.len().div_ceil(2))
            + of::<Material>(scene.materials.len())
            + 4 * u64::from(atlas.width) * u64::from(atlas.height) * u64::from(atlas.layers);
    if textures {
        let shapes: Vec<_> = scene.textures.iter().map(Texture::shape).collect();
        bytes += textures::place(&shapes)?.0.bytes();
    }
    Ok(bytes)
}

/// Packs one material; a slot that names a texture beyond `textures` becomes no texture.
pub fn pack_material(material: &relight_format::Material, textures: &[PackedTexture]) -> Material {
    let slot = |slot: Option<&relight_format::TextureSlot>| {
        slot.and_then(|slot| {
            let texture = textures.get(slot.texture as usize)?;
            let [[a, b, c], [d, e, f]] = slot.transform;
            let mut flags = 0;
            if texture.shape.encoding == TextureEncoding::Srgb {
                flags |= textures::SRGB;
            }
            if slot.second_uv {
                flags |= textures::SECOND_UV;
            }
            Some(TextureSlot {
                place: texture.place,
                width: texture.shape.width,
                height: texture.shape.height,
                flags,
                transform_u: [a, b, c],
                coarser: texture.coarser,
                transform_v: [d, e, f],
                last_level: textures::level_count(texture.shape) - 1,
            })
        })
        .unwrap_or(TextureSlot::zeroed())
    };
    let ratio = |slot: &relight_format::TextureSlot| {
        let texture = textures.get(slot.texture as usize);
        let texture = texture.filter(|t| t.shape == relight_format::RATIO_SHAPE);
        texture.map_or(0, |texture| texture.place + 1)
    };
    let mut packed = Material {
        has_diffuse: u32::from(has_diffuse(material)),
        textured: if material.uses_second_uv() {
            2
        } else {
            u32::from(material.slots().next().is_some())
        },
        normal_scale: material.normal_scale,
        base_color_texture: slot(material.base_color_texture.as_ref()),
        metallic_roughness_texture: slot(material.metallic_roughness_texture.as_ref()),
        normal_texture: slot(material.normal_texture.as_ref()),
        anisotropy_texture: slot(material.anisotropy_texture.as_ref()),
        emission: material.emission,
        shadow_catcher: f32::from(u8::from(material.shadow_catcher)),
        emission_texture: slot(material.emission_texture.as_ref()),
        ..Material::zeroed()
    };
    match material.surface {
        Surface::MetallicRoughness {
            base_color,
            metallic,
            roughness,
            anisotropy_strength,
            anisotropy_rotation,
        } => {
            return Material {
                color: base_color,
                surface: SURFACE_METALLIC_ROUGHNESS,
                metallic,
                roughness,
                anisotropy_strength,
                anisotropy_rotation,
                ..packed
            };
        }
        Surface::DiffuseSpecular { .. } => packed.surface = SURFACE_DIFFUSE_SPECULAR,
        Surface::Layers { .. } => packed.surface = SURFACE_LAYERS,
    }
    visit_layers(material, |layer: LayerParameters| {
        packed.layers[packed.layer_count as usize] = Layer {
            diffuse: layer.diffuse.into(),
            join: layer.join as u32,
            specular: layer.reflection.specular.into(),
            model: layer.reflection.model as u32,
            grazing: layer.reflection.grazing.into(),
            weight: layer.weight,
            alpha: layer.reflection.alpha.into(),
            ratio: layer.ratio.map_or(0, ratio),
            reserved: 0,
            diffuse_texture: slot(layer.diffuse_texture),
            specular_texture: slot(layer.specular_texture),
            roughness_texture: slot(layer.roughness_texture),
            weight_texture: slot(layer.weight_texture),
        };
        packed.layer_count += 1;
    });
    packed
}

impl Material {
    /// How many reflections have to be asked for, in order, until no other is left.
    pub fn reflections(&self) -> u32 {
        if self.surface == SURFACE_METALLIC_ROUGHNESS {
            return 1;
        }
        let layers = &self.layers[..self.layer_count as usize];
        let last = layers
            .iter()
            .rposition(|layer| layer.model != Model::None as u32);
        last.map_or(0, |last| last as u32 + 1)
    }
}

fn pack_vertex(vertex: &relight_format::Vertex) -> Vertex {
    Vertex {
        position: vertex.position,
        u: vertex.uv[0],
        normal: vertex.normal,
        v: vertex.uv[1],
        tangent: vertex.tangent,
    }
}

/// See textures_second_uv in textures.wgsl.
fn pack_second_uvs(uvs: &[[f32; 2]]) -> Vertex {
    let mut six = [[0.0; 2]; SECOND_UVS];
    six[..uvs.len()].copy_from_slice(uvs);
    bytemuck::cast(six)
}

/// Places the tiles of each cluster side by side, rows of clusters from the top, layer
/// after layer.
fn place_clusters(scene: &Scene) -> Result<(AtlasLayout, Vec<Cluster>), LimitError> {
    let stride = scene.visibility.basis_resolution + 2;
    let widest = scene.clusters.iter().map(|c| c.tiles).max().unwrap_or(1) * stride;
    LimitError::check(
        "max_texture_dimension_2d",
        u64::from(widest),
        u64::from(MAX_ATLAS_SIZE),
    )?;
    // Small pages waste little in the last layer; larger ones are for scenes that would
    // otherwise have too many layers.
    let mut page = 2048;
    loop {
        let width = widest.max(page);
        let (height, layers, clusters) = place_in_rows(scene, stride, width, page.max(stride));
        if layers <= MAX_ATLAS_LAYERS || page == MAX_ATLAS_SIZE {
            LimitError::check(
                "max_texture_array_layers",
                u64::from(layers),
                u64::from(MAX_ATLAS_LAYERS),
            )?;
            let basis_resolution = scene.visibility.basis_resolution;
            return Ok((
                AtlasLayout {
                    basis_resolution,
                    width,
                    height,
                    layers,
                },
                clusters,
            ));
        }
        page *= 2;
    }
}

/// Used height, number of layers, and clusters placed in pages of `width` × `page`.
fn place_in_rows(scene: &Scene, stride: u32, width: u32, page: u32) -> (u32, u32, Vec<Cluster>) {
    let (mut x, mut y, mut layer, mut height) = (0, 0, 0, stride);
    let clusters = scene
        .clusters
        .iter()
        .map(|cluster| {
            let extent = cluster.tiles * stride;
            if x + extent > width {
                (x, y) = (0, y + stride);
            }
            if y + stride > page {
                (x, y, layer) = (0, 0, layer + 1);
            }
            let tile_origin = [(x + 1) as f32, (y + 1) as f32];
            x += extent;
            height = height.max(y + stride);
            Cluster {
                first_vertex: cluster.first_vertex,
                first_word: cluster.first_coefficient / 2,
                tiles: cluster.tiles,
                layer,
                tile_origin,
                coefficient_scale: cluster.coefficient_scale,
                bounced: 0,
            }
        })
        .collect();
    (height, layer + 1, clusters)
}

/// Copies every tile with its gutter to its place.
fn fill_atlas(scene: &Scene, atlas: &AtlasLayout, clusters: &[Cluster]) -> Vec<i8> {
    let n = atlas.basis_resolution;
    let row_length = atlas.width as usize * CHANNELS_PER_TILE;
    let mut texels = vec![0i8; row_length * atlas.height as usize * atlas.layers as usize];
    let basis = Basis::new(scene);
    for (cluster, placed) in scene.clusters.iter().zip(clusters) {
        for tile in 0..cluster.tiles {
            // Corner of the tile with its gutter.
            let left = placed.tile_origin[0] as u32 - 1 + tile * (n + 2);
            let top = placed.layer * atlas.height + placed.tile_origin[1] as u32 - 1;
            for y in 0..n + 2 {
                let row = basis.row((cluster.first_tile + tile) as usize, y as usize);
                let to = (top + y) as usize * row_length + left as usize * CHANNELS_PER_TILE;
                texels[to..to + row.len()].copy_from_slice(row);
            }
        }
    }
    texels
}

#[cfg(test)]
mod tests {
    use relight_format::{
        BakeReport, Representation, TextureSlot as FormatSlot, VisibilityParameters,
    };

    use super::*;
    use crate::octahedral;

    /// Clusters of the given numbers of tiles, three vertices and one triangle each; the
    /// basis bytes and coefficients are all different from their neighbours'.
    fn scene(resolution: u32, tiles: &[u32]) -> Scene {
        let mut clusters = Vec::new();
        let (mut coefficient, mut tile) = (0, 0);
        for (index, &tiles) in tiles.iter().enumerate() {
            clusters.push(relight_format::Cluster {
                first_vertex: 3 * index as u32,
                vertex_count: 3,
                first_coefficient: coefficient,
                first_tile: tile,
                tiles,
                coefficient_scale: 0.5 + index as f32,
            });
            coefficient += 12 * tiles;
            tile += tiles;
        }
        let vertex = relight_format::Vertex {
            position: [1.0, 2.0, 3.0],
            normal: [0.0, 1.0, 0.0],
            tangent: [1.0, 0.0, 0.0, -1.0],
            uv: [0.25, 0.75],
        };
        Scene {
            name: "test".into(),
            visibility: VisibilityParameters {
                representation: Representation::ClusteredPca,
                sample_resolution: 128,
                basis_resolution: resolution,
                distance_clamp: 0.5,
                ray_offset: 0.0,
            },
            camera: None,
            materials: Vec::new(),
            textures: Vec::new(),
            report: BakeReport::default(),
            second_uvs: Vec::new(),
            transfer: None,
            vertices: vec![vertex; 3 * tiles.len()],
            triangles: (0..tiles.len())
                .map(|index| relight_format::Triangle {
                    vertices: [3 * index as u32, 3 * index as u32 + 1, 3 * index as u32 + 2],
                    material: 7,
                    cluster: index as u16,
                })
                .collect(),
            clusters,
            coefficients: (0..coefficient)
                .map(|i| (i as i16).wrapping_mul(2477))
                .collect(),
            basis: (0..tile * resolution * resolution * 4)
                .map(|i| (i.wrapping_mul(97) >> 2) as i8)
                .collect(),
        }
    }

    #[test]
    fn tiles_arrive_in_the_atlas_with_wrapped_gutters() {
        // More than one row and more than one layer: 2048 / 258 = 7 tiles per row.
        let n = 256;
        let scene = scene(n, &[3, 4, 1, 8, 2, 7, 7, 7, 7, 7, 7, 5]);
        let packed = pack_scene(&scene).expect("fits");
        assert!(packed.atlas.layers > 1 && packed.atlas.width >= 8 * 258);
        for (cluster, placed) in scene.clusters.iter().zip(&packed.clusters) {
            for tile in 0..cluster.tiles {
                let texel = |x: i32, y: i32| {
                    let column = placed.tile_origin[0] as i32 + (tile * (n + 2)) as i32 + x;
                    let row = (placed.layer * packed.atlas.height) as i32
                        + placed.tile_origin[1] as i32
                        + y;
                    let index = (row as usize * packed.atlas.width as usize + column as usize) * 4;
                    &packed.basis[index..index + 4]
                };
                for (x, y) in [
                    (0, 0),
                    (255, 255),
                    (13, 100),
                    (-1, 3),
                    (256, 90),
                    (9, -1),
                    (200, 256),
                    (-1, -1),
                ] {
                    let (from_x, from_y) = octahedral::wrap(x, y, n);
                    let index =
                        (((cluster.first_tile + tile) * n + from_y) * n + from_x) as usize * 4;
                    let expected: Vec<i8> = scene.basis[index..index + 4]
                        .iter()
                        .map(|&b| b.max(-127))
                        .collect();
                    assert_eq!(
                        texel(x, y),
                        expected,
                        "tile {tile} texel ({x}, {y}) of {cluster:?}"
                    );
                }
            }
        }
        assert!(!packed.basis.contains(&-128));
    }

    #[test]
    fn coefficients_and_triangles_are_found_as_documented() {
        let scene = scene(4, &[2, 1, 3]);
        let packed = pack_scene(&scene).expect("fits");
        for (cluster, placed) in scene.clusters.iter().zip(&packed.clusters) {
            let channels = 4 * cluster.tiles;
            for vertex in 0..cluster.vertex_count {
                for channel in 0..channels {
                    let word = packed.coefficients
                        [(placed.first_word + vertex * 2 * placed.tiles + channel / 2) as usize];
                    let found = (word >> (16 * (channel % 2))) as u16 as i16;
                    let index = cluster.first_coefficient + vertex * channels + channel;
                    assert_eq!(found, scene.coefficients[index as usize]);
                }
            }
        }
        assert_eq!(packed.triangles[2], [6, 7, 8, 7 | 2 << 16]);
    }

    #[test]
    fn limits_are_named() {
        let error = pack_scene(&scene(1024, &[8])).expect_err("8 × 1026 texels in a row");
        assert_eq!(error.limit, "max_texture_dimension_2d");
        assert_eq!(error.needed, 8208);
    }

    #[test]
    fn a_material_keeps_its_numbers_and_finds_its_texture() {
        let mut scene = scene(4, &[1]);
        for (width, encoding) in [(3, TextureEncoding::Linear), (2, TextureEncoding::Srgb)] {
            scene.textures.push(Texture {
                width,
                height: 1,
                encoding,
                texels: (0..4 * width as u8).collect(),
            });
        }
        scene.materials.push(relight_format::Material {
            name: "painted".into(),
            surface: Surface::DiffuseSpecular {
                diffuse: [0.1, 0.2, 0.3],
                specular: relight_format::Specular::Ward {
                    specular: [0.4, 0.5, 0.6],
                    alpha: [0.7, 0.8],
                },
            },
            base_color_texture: Some(FormatSlot {
                texture: 1,
                transform: [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]],
                second_uv: true,
            }),
            metallic_roughness_texture: None,
            normal_texture: None,
            normal_scale: 0.9,
            anisotropy_texture: None,
            emission: [0.5, 0.25, 0.0],
            emission_texture: None,
            shadow_catcher: true,
        });
        let count = scene.vertices.len();
        scene.second_uvs = (0..count).map(|i| [i as f32, -(i as f32)]).collect();
        let packed = pack_scene(&scene).expect("fits");
        assert_eq!(packed.vertices.len(), count + count.div_ceil(SECOND_UVS));
        let behind: &[[f32; 2]] = bytemuck::cast_slice(&packed.vertices[count..]);
        assert_eq!(behind[..count], scene.second_uvs);
        let bytes = size_of_val(&packed.vertices[..]);
        let without = Scene {
            second_uvs: Vec::new(),
            ..scene.clone()
        };
        let room = [&scene, &without].map(|scene| packed_bytes(scene, true).expect("fits"));
        let behind = bytes - count * size_of::<Vertex>();
        assert_eq!(room[0] - room[1], behind as u64);
        let material = packed.materials[0];
        assert_eq!(
            (material.surface, material.layer_count),
            (SURFACE_DIFFUSE_SPECULAR, 1)
        );
        let layer = material.layers[0];
        assert_eq!(layer.model, Model::Ward as u32);
        assert_eq!(
            (layer.diffuse, layer.specular),
            ([0.1, 0.2, 0.3], [0.4, 0.5, 0.6])
        );
        assert_eq!((layer.alpha, material.normal_scale), ([0.7, 0.8], 0.9));
        let slot = layer.diffuse_texture;
        assert_eq!(
            (slot.place, slot.width, slot.height, slot.flags),
            (
                packed.textures[1].place,
                2,
                1,
                textures::SRGB | textures::SECOND_UV
            )
        );
        assert_eq!((slot.transform_v, slot.last_level), ([4.0, 5.0, 6.0], 1));
        assert_eq!(material.textured, 2);
        assert_eq!(material.normal_texture, TextureSlot::zeroed());
    }
}
