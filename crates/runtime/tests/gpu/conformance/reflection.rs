//! Surface points and specular lobes on random materials, textures and views.

use bytemuck::{Pod, Zeroable};
use glam::{Vec3, Vec4};
use libtest_mimic::Failed;
use relight_format::{
    Blend, FittedLobe, Layer, Material, RATIO_NODES, RATIO_SIZE, Scene, Specular, Surface, Texture,
    TextureEncoding, TextureSlot, Triangle,
};
use relight_runtime::offscreen::Gpu;
use relight_runtime::wgpu;
use relight_shading::brdf::{MAX_SPECULAR_LOBES, specular_lobes};
use relight_shading::camera::View;
use relight_shading::gpu;
use relight_shading::pack::{PackedScene, pack_scene};
use relight_shading::shade::gpu_tables;
use relight_shading::surface::{MAX_REFLECTIONS, Reflection, sample_ratio, surface_seen};
use relight_shading::textures::{Filter, Mipmaps};
use wgpu::util::DeviceExt as _;

use crate::scenes::{self, Random};

const QUERIES: usize = 20_000;
const MATERIALS: usize = 400;
/// Components of frames and reflectances: `pow` and texture coordinates of a few units.
const SURFACE_TOLERANCE: f32 = 1e-4;
/// Lobes, as a fraction of their own sharpness and of the sum's amplitude: logarithms and
/// exponentials of sharpnesses up to 10⁴, on normals that already differ.
const LOBE_TOLERANCE: f32 = 5e-3;
/// Fraction of points that may differ by more: near a ratio at which pairs of lobes merge
/// one side may merge them and the other not.
const MERGED: f32 = 1e-3;

/// Where ratios are looked up, in the surface's frame.
const LIGHT: Vec3 = Vec3::new(0.3, -0.5, 0.7);
/// Ratios, relative: of views that are off by surfaces' tolerance, a step of a sixth per node.
const RATIO_TOLERANCE: f32 = 2e-3;

#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
struct Query {
    barycentrics: [f32; 3],
    triangle: u32,
}

/// Vectors per reflection, and per point.
const REFLECTION_WORDS: usize = 4 + 2 * MAX_SPECULAR_LOBES;
const WORDS: usize = 4 + MAX_REFLECTIONS * REFLECTION_WORDS;

#[allow(clippy::too_many_lines, reason = "one comparison after the other")]
pub fn surface_and_lobes_match_twins(gpu: &mut Gpu) -> Result<(), Failed> {
    let scene = scene();
    let view = view();
    let filter = Filter {
        view: &view,
        mipmaps: &Mipmaps::new(&scene),
    };
    let mut random = Random(3);
    let queries: Vec<_> = (0..QUERIES)
        .map(|_| {
            let mut weights = Vec3::new(random.unit(), random.unit(), random.unit()) + 1e-3;
            weights /= weights.element_sum();
            Query {
                barycentrics: weights.into(),
                triangle: (random.next() % scene.triangles.len() as u64) as u32,
            }
        })
        .collect();
    let answers = answers(gpu, &scene, &queries)?;
    let (mut worst_ratio, mut ratios) = (0f32, 0);
    let (mut worst_surface, mut worst_lobe, mut different, mut lobes_seen) = (0f32, 0f32, 0, 0);
    for (query, answer) in queries.iter().zip(answers.chunks_exact(WORDS)) {
        let point = surface_seen(
            &scene,
            query.triangle as usize,
            query.barycentrics.into(),
            view.homogeneous_eye(),
            Some(filter),
        );
        let reflections: Vec<_> = point.appearance.reflections.to_vec();
        let expected = [
            point.normal.extend(answer[0].w),
            point.tangent.extend(0.0),
            point.view.extend(0.0),
            point.appearance.diffuse.extend(0.0),
        ];
        for (expected, found) in expected.into_iter().zip(answer) {
            worst_surface = worst_surface.max(expected.distance(*found));
        }
        let mut error = 0f32;
        let count = answer[0].w as usize;
        // A layer without reflection has an entry all the same.
        assert!(reflections[count..].iter().all(|r| *r == Reflection::NONE));
        for (reflection, found) in reflections[..count]
            .iter()
            .zip(answer[4..].chunks_exact(REFLECTION_WORDS))
        {
            let expected = [
                reflection.specular.extend(reflection.model as u32 as f32),
                reflection.grazing.extend(found[1].w),
            ];
            for (expected, found) in expected.into_iter().zip(found) {
                worst_surface = worst_surface.max(expected.distance(*found));
            }
            let alpha = (found[2].truncate().truncate() / reflection.alpha - 1.0).abs();
            worst_surface = worst_surface.max(alpha.max_element());
            let view = point.to_local(point.view);
            if let Some(ratio) = reflection.ratio
                && view.z > 0.0
            {
                let expected = sample_ratio(ratio, LIGHT.normalize(), view);
                let error = (expected - found[3].truncate()).abs() / expected;
                worst_ratio = worst_ratio.max(error.max_element());
                ratios += 1;
            }
            let lobes = specular_lobes(&point, reflection);
            lobes_seen += lobes.count;
            let sum: f32 = lobes
                .as_slice()
                .iter()
                .map(|lobe| lobe.amplitude.max_element())
                .sum();
            if found[1].w != lobes.count as f32 {
                error = 1.0;
            }
            for (lobe, found) in lobes.as_slice().iter().zip(found[4..].chunks_exact(2)) {
                // How far the axis is off, in units of the lobe's own width.
                let axis = lobe.axis.distance(found[0].truncate()) * lobe.sharpness.sqrt();
                let sharpness = (found[0].w / lobe.sharpness - 1.0).abs();
                let amplitude = lobe.amplitude.distance(found[1].truncate()) / sum;
                error = error.max(axis).max(sharpness).max(amplitude);
            }
        }
        if error > LOBE_TOLERANCE {
            different += 1;
        } else {
            worst_lobe = worst_lobe.max(error);
        }
    }
    println!(
        "surface differs by {worst_surface:e}, {lobes_seen} lobes by {worst_lobe:e}, \
         beyond tolerance {different}"
    );
    println!("{ratios} ratios differ by {worst_ratio:e}");
    assert!(ratios > QUERIES / 20, "only {ratios} ratios");
    assert!(
        worst_ratio < RATIO_TOLERANCE,
        "ratios differ by {worst_ratio}"
    );
    assert!(
        worst_surface < SURFACE_TOLERANCE,
        "surface differs by {worst_surface}"
    );
    assert!(
        different as f32 <= MERGED * QUERIES as f32,
        "{different} points differ"
    );
    assert!(lobes_seen > QUERIES, "only {lobes_seen} lobes");
    Ok(())
}

/// Random triangles in front of the camera, every surface kind and every texture slot.
fn scene() -> Scene {
    let eye = Vec3::from(scenes::camera().position);
    let mut random = Random(2);
    let mut scene = scenes::sphere_over_plane();
    scene.textures = (0..4)
        .map(|i| {
            let (width, height) = (1 + 3 * i, 5 - i);
            Texture {
                width,
                height,
                encoding: if i % 2 == 0 {
                    TextureEncoding::Srgb
                } else {
                    TextureEncoding::Linear
                },
                texels: (0..width * height * 4)
                    .map(|_| random.next() as u8)
                    .collect(),
            }
        })
        .chain([ratio()])
        .collect();
    scene.materials = (0..MATERIALS).map(|_| material(&mut random)).collect();
    let mut vertex = scene.vertices[0];
    let cluster = scene.triangles[0].cluster;
    scene.vertices.clear();
    scene.triangles.clear();
    for material in 0..MATERIALS {
        let first = scene.vertices.len() as u32;
        // Facing the eye, more or less, up to grazing.
        let centre = eye + 3.0 * random.direction();
        let towards = (eye - centre).normalize() + 0.9 * random.direction();
        for _ in 0..3 {
            vertex.position = (centre + 0.3 * random.direction()).into();
            vertex.normal = (towards + 0.2 * random.direction()).into();
            let sign = if random.unit() < 0.5 { -1.0 } else { 1.0 };
            vertex.tangent = random.direction().extend(sign).into();
            vertex.uv = [4.0 * random.unit() - 2.0, 4.0 * random.unit() - 2.0];
            scene.vertices.push(vertex);
            let uv = [4.0 * random.unit() - 2.0, 4.0 * random.unit() - 2.0];
            scene.second_uvs.push(uv);
        }
        // All of one triangle's tangents agree on the handedness, as an import's do.
        for other in 1..3 {
            scene.vertices[first as usize + other].tangent[3] =
                scene.vertices[first as usize].tangent[3];
        }
        scene.triangles.push(Triangle {
            vertices: [first, first + 1, first + 2],
            material: material as u16,
            cluster,
        });
    }
    scene
}

/// Numbers of about 1 that tell every node from the next.
fn ratio() -> Texture {
    let [width, height] = RATIO_SIZE;
    let rows = RATIO_NODES[1];
    let texel = |index: u32| {
        let [x, y, z] = [index % width, index / width % rows, index / (width * rows)];
        [100 + x as u8, 80 + 5 * y as u8, 40 + 25 * z as u8, 129]
    };
    Texture {
        width,
        height,
        encoding: TextureEncoding::Rgbe,
        texels: (0..width * height).flat_map(texel).collect(),
    }
}

fn material(random: &mut Random) -> Material {
    let color = |random: &mut Random| [random.unit(), random.unit(), random.unit()];
    let slot = |random: &mut Random| {
        (random.unit() < 0.5).then(|| TextureSlot {
            texture: (random.next() % 4) as u32,
            transform: [
                [random.unit(), random.unit(), random.unit()],
                [random.unit(), -random.unit(), random.unit()],
            ],
            second_uv: random.unit() < 0.3,
        })
    };
    let kind = random.next() % 4;
    let surface = match kind {
        0 => Surface::DiffuseSpecular {
            diffuse: color(random),
            specular: specular(random, 7),
        },
        1 => Surface::Layers {
            layers: (0..=random.next() % 4)
                .map(|_| Layer {
                    diffuse: color(random),
                    specular: specular(random, 2),
                    weight: random.unit(),
                    blend: if random.unit() < 0.5 {
                        Blend::Over
                    } else {
                        Blend::Coat
                    },
                    diffuse_texture: slot(random),
                    specular_texture: slot(random),
                    roughness_texture: slot(random),
                    weight_texture: slot(random),
                })
                .collect(),
        },
        _ => Surface::MetallicRoughness {
            base_color: color(random),
            metallic: random.unit(),
            roughness: random.unit(),
            anisotropy_strength: if kind == 2 { random.unit() } else { 0.0 },
            anisotropy_rotation: 6.0 * random.unit(),
        },
    };
    Material {
        name: String::new(),
        surface,
        base_color_texture: slot(random),
        metallic_roughness_texture: slot(random),
        normal_texture: slot(random),
        // Random texels are steep normals.
        normal_scale: 0.3,
        anisotropy_texture: slot(random),
        emission: [0.0; 3],
        emission_texture: None,
        shadow_catcher: false,
    }
}

fn specular(random: &mut Random, most_lobes: u64) -> Specular {
    let mut color = || [random.unit(), random.unit(), random.unit()];
    let (specular, f0, f90) = (color(), color(), color());
    let mut alpha = || 10f32.powf(-2.0 * random.unit());
    let (x, y) = (alpha(), alpha());
    match random.next() % 7 {
        0 => Specular::None,
        1 => Specular::BlinnPhong {
            specular,
            exponent: 1.0 / (x * x),
        },
        2 => Specular::Ward {
            specular,
            alpha: [x, y],
        },
        3 => Specular::CookTorrance { f0, roughness: x },
        4 => Specular::Ggx { f0, alpha: [x, y] },
        5 => Specular::AshikhminShirley {
            f0,
            exponents: [2.0 / (x * x), 2.0 / (y * y)],
        },
        _ => Specular::Lobes {
            path: String::new(),
            lobes: (0..=random.next() % most_lobes)
                .map(|i| FittedLobe {
                    f0,
                    f90,
                    roughness: x / (1 + i) as f32,
                })
                .collect(),
            ratio: Some(TextureSlot::whole(4)),
        },
    }
}

fn answers(gpu: &Gpu, scene: &Scene, queries: &[Query]) -> Result<Vec<Vec4>, Failed> {
    let packed = pack_scene(scene)?;
    let mut frame = gpu::Frame::new(&view(), &packed.atlas, packed.distance_clamp);
    frame.vertex_count = scene.vertices.len() as u32;
    let frame = super::buffer(gpu, &scenes::batch(&frame), wgpu::BufferUsages::UNIFORM);
    let tables = super::storage(gpu, &gpu_tables());
    let vertices = super::storage(gpu, &packed.vertices);
    let triangles = super::storage(gpu, &packed.triangles);
    let materials = super::storage(gpu, &packed.materials);
    let texels = texels(gpu, scene, &packed);
    let groups = [
        (
            0,
            &[
                (0, frame.as_entire_binding()),
                (2, tables.as_entire_binding()),
            ][..],
        ),
        (
            1,
            &[
                (0, vertices.as_entire_binding()),
                (1, triangles.as_entire_binding()),
                (4, materials.as_entire_binding()),
                (5, wgpu::BindingResource::TextureView(&texels)),
            ],
        ),
    ];
    let kernel = ("reflection", include_str!("reflection.wgsl"));
    super::run(gpu, kernel, &groups, queries, WORDS)
}

/// Pixels so wide that textures are seen at several levels.
fn view() -> View {
    View::new(&scenes::camera(), 48, 36, 1.0)
}

/// All textures' texels, as an app without our renderer would upload them.
fn texels(gpu: &Gpu, scene: &Scene, packed: &PackedScene) -> wgpu::TextureView {
    let size = wgpu::Extent3d {
        width: packed.pages.width,
        height: packed.pages.height,
        depth_or_array_layers: packed.pages.layers,
    };
    let mut words = vec![0u32; (packed.pages.bytes() / 4) as usize];
    for (texture, place) in scene.textures.iter().zip(&packed.textures) {
        place
            .visit(texture, |[x, y, layer], level| {
                let rows = bytemuck::pod_collect_to_vec::<u8, u32>(&level.texels);
                for (row, texels) in (y..).zip(rows.chunks_exact(level.width as usize)) {
                    let first = ((layer * size.height + row) * size.width + x) as usize;
                    words[first..first + texels.len()].copy_from_slice(texels);
                }
                Ok::<(), std::convert::Infallible>(())
            })
            .expect("nothing fails");
    }
    let texture = gpu.device.create_texture_with_data(
        &gpu.queue,
        &wgpu::TextureDescriptor {
            label: None,
            size,
            mip_level_count: 1,
            sample_count: 1,
            dimension: wgpu::TextureDimension::D2,
            format: wgpu::TextureFormat::R32Uint,
            usage: wgpu::TextureUsages::TEXTURE_BINDING,
            view_formats: &[],
        },
        wgpu::util::TextureDataOrder::LayerMajor,
        bytemuck::cast_slice(&words),
    );
    texture.create_view(&wgpu::TextureViewDescriptor {
        dimension: Some(wgpu::TextureViewDimension::D2Array),
        ..Default::default()
    })
}
