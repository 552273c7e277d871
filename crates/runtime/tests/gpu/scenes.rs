//! Small scenes with exact signed distances, made without a bake.

use std::f32::consts::{PI, TAU};
use std::sync::LazyLock;

use glam::{Vec2, Vec3};
use relight_format::{
    BakeReport, Blend, Camera, Cluster, FieldOfView, Layer, Material, Representation, Scene,
    Specular, Surface, Texture, TextureEncoding, TextureSlot, Triangle, Vertex,
    VisibilityParameters, plain_material,
};
use relight_shading::{gpu, octahedral};

/// Texels per side of a basis tile.
const RESOLUTION: u32 = 64;
/// Signed distances are clamped to ± this angle, radians.
const CLAMP: f32 = 0.5;
/// Centre and radius of the sphere that floats above the plane.
const CENTRE: Vec3 = Vec3::new(0.0, 0.9, 0.0);
const RADIUS: f32 = 0.6;

/// Distance of the near plane for this scene, metres: the renderer's rule.
pub const NEAR: f32 = 1e-4 * 5.852_349_6;

/// One instance's uniforms where kernels are bound to those of many.
pub fn batch(frame: &gpu::Frame) -> Vec<u8> {
    let mut bytes = bytemuck::bytes_of(frame).to_vec();
    bytes.resize(gpu::MAX_BATCH as usize * bytes.len(), 0);
    bytes
}

/// A camera that sees all of it.
pub fn camera() -> Camera {
    Camera {
        position: [1.5, 2.2, 3.5],
        target: [0.0, 0.5, 0.0],
        up: [0.0, 1.0, 0.0],
        field_of_view: FieldOfView::X(0.9),
    }
}

/// A sphere above a plane of 4 × 4 metres. Each quad is a cluster of its own, whose four
/// basis images are the signed distances of its four vertices.
pub fn sphere_over_plane() -> Scene {
    // It takes half a second, and most tests draw it.
    static SCENE: LazyLock<Scene> = LazyLock::new(compute_sphere_over_plane);
    SCENE.clone()
}

fn compute_sphere_over_plane() -> Scene {
    let mut scene = Scene {
        name: "sphere over plane".into(),
        visibility: VisibilityParameters {
            representation: Representation::ClusteredPca,
            sample_resolution: RESOLUTION,
            basis_resolution: RESOLUTION,
            distance_clamp: CLAMP,
            ray_offset: 0.0,
        },
        camera: Some(camera()),
        materials: vec![plane_material(), sphere_material()],
        textures: vec![checkerboard(), dimples()],
        report: BakeReport::default(),
        vertices: Vec::new(),
        triangles: Vec::new(),
        clusters: Vec::new(),
        coefficients: Vec::new(),
        basis: Vec::new(),
        second_uvs: Vec::new(),
        transfer: None,
    };
    let quads = 16;
    for row in 0..quads {
        for column in 0..quads {
            let corner = |x: u32, y: u32| {
                let uv = Vec2::new((column + x) as f32, (row + y) as f32) / quads as f32;
                Vertex {
                    position: [4.0 * uv.x - 2.0, 0.0, 4.0 * uv.y - 2.0],
                    normal: [0.0, 1.0, 0.0],
                    tangent: [1.0, 0.0, 0.0, -1.0],
                    uv: uv.into(),
                }
            };
            // Counter-clockwise from above: z grows towards the viewer.
            let corners = [corner(0, 0), corner(0, 1), corner(1, 1), corner(1, 0)];
            push_quad(&mut scene, 0, corners, |vertex, direction| {
                let to_centre = CENTRE - Vec3::from(vertex.position);
                let blocked = (RADIUS / to_centre.length()).asin();
                to_centre.angle_between(direction) - blocked
            });
        }
    }
    let (meridians, parallels) = (32, 16);
    for row in 0..parallels {
        for column in 0..meridians {
            let corner = |x: u32, y: u32| {
                let azimuth = TAU * (column + x) as f32 / meridians as f32;
                let polar = PI * (row + y) as f32 / parallels as f32;
                let normal = Vec3::new(
                    polar.sin() * azimuth.sin(),
                    polar.cos(),
                    polar.sin() * azimuth.cos(),
                );
                Vertex {
                    position: (CENTRE + RADIUS * normal).into(),
                    normal: normal.into(),
                    tangent: [azimuth.cos(), 0.0, -azimuth.sin(), -1.0],
                    uv: [azimuth / TAU, polar / PI],
                }
            };
            let corners = [corner(0, 0), corner(0, 1), corner(1, 1), corner(1, 0)];
            push_quad(&mut scene, 1, corners, |vertex, direction| {
                // The sphere's own horizon, and a plane as wide as the world.
                let own = direction
                    .dot(Vec3::from(vertex.normal))
                    .clamp(-1.0, 1.0)
                    .asin();
                own.min(direction.y.clamp(-1.0, 1.0).asin())
            });
        }
    }
    scene
}

/// Nothing to be seen.
pub fn empty() -> Scene {
    Scene {
        vertices: Vec::new(),
        triangles: Vec::new(),
        clusters: Vec::new(),
        coefficients: Vec::new(),
        basis: Vec::new(),
        ..sphere_over_plane()
    }
}

/// The same geometry with pseudo-random coefficients and basis images, 1 to 8 tiles per
/// cluster: exercises every decoding path with values that nothing hides.
pub fn noise(seed: u64) -> Scene {
    let mut scene = sphere_over_plane();
    let mut random = Random(seed);
    scene.visibility.basis_resolution = 12;
    scene.coefficients.clear();
    scene.basis.clear();
    let mut first_tile = 0;
    for (index, cluster) in scene.clusters.iter_mut().enumerate() {
        cluster.tiles = 1 + index as u32 % 8;
        cluster.first_tile = first_tile;
        cluster.first_coefficient = scene.coefficients.len() as u32;
        cluster.coefficient_scale = 0.02;
        first_tile += cluster.tiles;
        let count = cluster.vertex_count * cluster.tiles * 4;
        scene.coefficients.extend(random.coefficients(count));
    }
    let bytes = first_tile * 12 * 12 * 4;
    scene.basis.extend(random.texels(bytes));
    scene
}

/// A white floor whose vertices, about as close as pixels of a small picture, see what chance has: neighbours
/// agree on no light.
pub fn disagreeing_floor() -> Scene {
    const CELLS: u32 = 64;
    let mut random = Random(11);
    let mut scene = empty();
    scene.visibility.basis_resolution = 12;
    scene.materials = vec![Material {
        base_color_texture: None,
        surface: Surface::DiffuseSpecular {
            diffuse: [0.8; 3],
            specular: Specular::None,
        },
        ..plane_material()
    }];
    scene.textures.clear();
    let side = CELLS + 1;
    scene.clusters = vec![Cluster {
        first_vertex: 0,
        vertex_count: side * side,
        first_coefficient: 0,
        first_tile: 0,
        tiles: 8,
        coefficient_scale: 0.15,
    }];
    for at in 0..side * side {
        let uv = Vec2::new((at % side) as f32, (at / side) as f32) / CELLS as f32;
        scene.vertices.push(Vertex {
            position: [4.0 * uv.x - 2.0, 0.0, 4.0 * uv.y - 2.0],
            normal: [0.0, 1.0, 0.0],
            tangent: [1.0, 0.0, 0.0, -1.0],
            uv: uv.into(),
        });
    }
    for at in (0..CELLS * side).filter(|at| at % side < CELLS) {
        for vertices in [[at, at + side, at + side + 1], [at, at + side + 1, at + 1]] {
            scene.triangles.push(Triangle {
                vertices,
                material: 0,
                cluster: 0,
            });
        }
    }
    let coefficients = side * side * 8 * 4;
    let texels = 8 * 12 * 12 * 4;
    scene.coefficients.extend(random.coefficients(coefficients));
    scene.basis.extend(random.texels(texels));
    scene
}

/// SplitMix64 (Steele et al. 2014).
pub struct Random(pub u64);

impl Random {
    pub fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// Coefficients of SSDFs.
    fn coefficients(&mut self, count: u32) -> impl Iterator<Item = i16> {
        (0..count).map(|_| (self.next() as i16).max(-i16::MAX))
    }

    /// Channels of basis images.
    fn texels(&mut self, count: u32) -> impl Iterator<Item = i8> {
        (0..count).map(|_| (self.next() as i8).max(-127))
    }

    /// Uniform in [0, 1).
    pub fn unit(&mut self) -> f32 {
        (self.next() >> 40) as f32 / (1u64 << 24) as f32
    }

    /// Uniform on the sphere.
    pub fn direction(&mut self) -> Vec3 {
        let (z, azimuth) = (2.0 * self.unit() - 1.0, TAU * self.unit());
        let radius = (1.0 - z * z).sqrt();
        Vec3::new(radius * azimuth.cos(), radius * azimuth.sin(), z)
    }
}

/// Appends a quad as a cluster with the signed distances of its own four vertices.
fn push_quad(
    scene: &mut Scene,
    material: u16,
    corners: [Vertex; 4],
    distance: impl Fn(&Vertex, Vec3) -> f32,
) {
    let first_vertex = scene.vertices.len() as u32;
    let cluster = scene.clusters.len() as u16;
    scene.clusters.push(Cluster {
        first_vertex,
        vertex_count: 4,
        first_coefficient: scene.coefficients.len() as u32,
        first_tile: u32::from(cluster),
        tiles: 1,
        coefficient_scale: CLAMP,
    });
    for vertices in [[0, 1, 2], [0, 2, 3]] {
        let position = |i: u32| Vec3::from(corners[i as usize].position);
        let [a, b, c] = vertices.map(position);
        // At the poles of the sphere a quad is a triangle.
        if (b - a).cross(c - a).length() > 1e-6 {
            let vertices = vertices.map(|vertex| first_vertex + vertex);
            scene.triangles.push(Triangle {
                vertices,
                material,
                cluster,
            });
        }
    }
    for y in 0..RESOLUTION {
        for x in 0..RESOLUTION {
            let direction = octahedral::texel_direction(x, y, RESOLUTION);
            scene.basis.extend(corners.iter().map(|vertex| {
                (distance(vertex, direction) / CLAMP * 127.0)
                    .clamp(-127.0, 127.0)
                    .round() as i8
            }));
        }
    }
    for (index, vertex) in corners.into_iter().enumerate() {
        scene.vertices.push(vertex);
        scene
            .coefficients
            .extend((0..4).map(|channel| if channel == index { i16::MAX } else { 0 }));
    }
}

fn plane_material() -> Material {
    let surface = Surface::MetallicRoughness {
        base_color: [0.9, 0.8, 0.7],
        metallic: 0.0,
        roughness: 0.4,
        anisotropy_strength: 0.0,
        anisotropy_rotation: 0.0,
    };
    Material {
        base_color_texture: Some(TextureSlot {
            transform: [[3.0, 0.5, 0.1], [-0.5, 3.0, 0.2]],
            ..TextureSlot::whole(0)
        }),
        ..plain_material("checkerboard", surface)
    }
}

fn sphere_material() -> Material {
    let surface = Surface::DiffuseSpecular {
        diffuse: [0.5, 0.1, 0.1],
        specular: Specular::Ward {
            specular: [0.2, 0.2, 0.2],
            alpha: [0.15, 0.4],
        },
    };
    Material {
        normal_texture: Some(TextureSlot {
            transform: [[8.0, 0.0, 0.0], [0.0, 4.0, 0.0]],
            ..TextureSlot::whole(1)
        }),
        normal_scale: 0.5,
        ..plain_material("dimpled", surface)
    }
}

/// Two reflections, the upper one in front of the lower one.
pub fn coated_material() -> Material {
    let layer = |diffuse, specular, weight| Layer {
        diffuse,
        specular,
        weight,
        blend: Blend::Coat,
        diffuse_texture: None,
        specular_texture: None,
        roughness_texture: None,
        weight_texture: None,
    };
    let paint = Specular::Ward {
        specular: [0.3, 0.2, 0.1],
        alpha: [0.4, 0.2],
    };
    let coat = Specular::Ggx {
        f0: [0.04; 3],
        alpha: [0.1; 2],
    };
    let layers = vec![
        layer([0.4, 0.1, 0.1], paint, 1.0),
        layer([0.0; 3], coat, 0.8),
    ];
    Material {
        surface: Surface::Layers { layers },
        ..sphere_material()
    }
}

fn checkerboard() -> Texture {
    let texel = |i: u32| {
        if (i % 8 / 4 + i / 32).is_multiple_of(2) {
            [230, 220, 200, 255]
        } else {
            [70, 90, 160, 255]
        }
    };
    Texture {
        width: 8,
        height: 8,
        encoding: TextureEncoding::Srgb,
        texels: (0..64).flat_map(texel).collect(),
    }
}

/// A normal map of one round bump.
fn dimples() -> Texture {
    let texel = |i: u32| {
        let slope = (Vec2::new((i % 16) as f32, (i / 16) as f32) - 7.5) / 7.5;
        let inside = slope.length() < 1.0;
        let normal = Vec3::new(slope.x, -slope.y, 1.0).normalize();
        let normal = if inside { normal } else { Vec3::Z };
        let [x, y, z] = ((normal * 0.5 + 0.5) * 255.0)
            .round()
            .to_array()
            .map(|v| v as u8);
        [x, y, z, 255]
    };
    Texture {
        width: 16,
        height: 16,
        encoding: TextureEncoding::Linear,
        texels: (0..256).flat_map(texel).collect(),
    }
}
