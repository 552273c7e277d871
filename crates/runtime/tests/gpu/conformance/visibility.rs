//! SSDF decoding and both integrators, function by function on random input.

use bytemuck::{Pod, Zeroable};
use glam::{DVec3, Vec3, Vec4};
use libtest_mimic::Failed;
use relight_format::{CHANNELS_PER_TILE, Scene};
use relight_runtime::offscreen::Gpu;
use relight_runtime::{PolarOptions, wgpu};
use relight_shading::camera::View;
use relight_shading::gpu;
use relight_shading::pack::pack_scene;
use relight_shading::spherical_gaussian::energy;
use relight_shading::ssdf::{Basis, SignedDistance as _, Ssdf};
use relight_shading::tables::Tables;
use relight_shading::{ambient, octahedral, polar};
use wgpu::util::{DeviceExt as _, TextureDataOrder};

use super::oracle;
use crate::scenes::{self, Random};

/// Signed distances may differ by this fraction of what neighbouring texels may differ by:
/// GPUs interpolate with 8-bit weights.
const DECODE_TOLERANCE: f32 = 2.0 / 256.0;
/// What the twin's distances may be off by, radians: sums of up to 32 products of order 1.
const TWIN_DECODE_TOLERANCE: f64 = 2e-5;
/// Integrals may differ by this fraction of the lobe's energy.
const INTEGRAL_TOLERANCE: f32 = 1e-3;
/// Fraction of integrals that may differ by more: a boundary that a spoke just touches is
/// seen by one and missed by the other.
const GRAZING: f32 = 2e-3;
/// The same on graphics cards, whose weights of texels have 8 bits: 2.5 % of noise on an H200.
const GRAZING_ON_CARDS: f32 = 4e-2;
const QUERIES: usize = 20_000;
const SPOKES: u32 = 8;

#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
struct Query {
    barycentrics: [f32; 3],
    triangle: u32,
    axis: [f32; 3],
    sharpness: f32,
    normal: [f32; 3],
    reserved: f32,
}

pub fn ssdf_and_integrators_match_twins(gpu: &mut Gpu) -> Result<(), Failed> {
    for (name, scene, texel_range) in [
        ("smooth", scenes::sphere_over_plane(), 0.2),
        ("noise", scenes::noise(7), 2.0 * 32.0 * 0.02),
    ] {
        let queries = queries(&scene);
        let answers = probe(gpu, &scene, &queries)?;
        let basis = Basis::new(&scene);
        let mut grazing = [0; 2];
        let (mut worst, mut twin_worst) = (0f32, 0f64);
        for (query, answer) in queries.iter().zip(&answers) {
            let triangle = query.triangle as usize;
            let field = Ssdf::interpolate(&scene, &basis, triangle, query.barycentrics.into());
            let (axis, normal) = (Vec3::from(query.axis), Vec3::from(query.normal));
            let options = PolarOptions { spokes: SPOKES };
            worst = worst.max((field.distance(axis) - answer[0]).abs());
            let exact = decoded(&scene, triangle, query.barycentrics, axis.as_dvec3());
            twin_worst = twin_worst.max((f64::from(field.distance(axis)) - exact).abs());
            let tolerance = INTEGRAL_TOLERANCE * energy(query.sharpness);
            let expected = [
                polar::integrate(&field, query.sharpness, axis, normal, &options),
                ambient::integrate(&field, query.sharpness, axis, normal),
            ];
            for method in 0..2 {
                let found = answer[1 + method];
                assert!(found.is_finite(), "{name}: {found}");
                if (found - expected[method]).abs() > tolerance {
                    grazing[method] += 1;
                }
            }
        }
        println!("{name}: distance differs by up to {worst:e}; beyond tolerance {grazing:?}");
        println!("{name}: the twin's distance is off by up to {twin_worst:e}");
        assert!(
            twin_worst <= TWIN_DECODE_TOLERANCE,
            "{name}: the twin's distance is off by {twin_worst}"
        );
        assert!(
            worst <= DECODE_TOLERANCE * texel_range,
            "{name}: distance differs by {worst}"
        );
        let grazing_part = if gpu.is_software() {
            GRAZING
        } else {
            GRAZING_ON_CARDS
        };
        for count in grazing {
            assert!(
                count as f32 <= grazing_part * QUERIES as f32,
                "{name}: {grazing:?} differ"
            );
        }
    }
    Ok(())
}

/// The distance as FORMAT.md defines it, in `f64`.
fn decoded(scene: &Scene, triangle: usize, barycentrics: [f32; 3], direction: DVec3) -> f64 {
    let triangle = &scene.triangles[triangle];
    let cluster = &scene.clusters[triangle.cluster as usize];
    let n = scene.visibility.basis_resolution;
    let channels = cluster.tiles as usize * CHANNELS_PER_TILE;
    let coefficient = |vertex: u32, channel: usize| {
        let first = cluster.first_coefficient as usize;
        let vertex = (vertex - cluster.first_vertex) as usize;
        let value = scene.coefficients[first + vertex * channels + channel];
        f64::from(cluster.coefficient_scale) * (f64::from(value) / 32767.0).max(-1.0)
    };
    let basis = |channel: usize| {
        let tile = cluster.first_tile as usize + channel / CHANNELS_PER_TILE;
        let texel = |x, y| {
            let (x, y) = octahedral::wrap(x, y, n);
            let texel = tile * (n * n) as usize + (y * n + x) as usize;
            let value = scene.basis[texel * CHANNELS_PER_TILE + channel % CHANNELS_PER_TILE];
            (f64::from(value) / 127.0).max(-1.0)
        };
        oracle::octahedral_lookup(texel, n, direction)
    };
    (0..channels)
        .map(|channel| {
            let at = triangle.vertices.into_iter().zip(barycentrics);
            let sum: f64 = at
                .map(|(vertex, weight)| f64::from(weight) * coefficient(vertex, channel))
                .sum();
            sum * basis(channel)
        })
        .sum()
}

fn queries(scene: &Scene) -> Vec<Query> {
    let mut random = Random(1);
    (0..QUERIES)
        .map(|_| {
            let (u, v) = (random.unit(), random.unit());
            let (u, v) = if u + v > 1.0 {
                (1.0 - u, 1.0 - v)
            } else {
                (u, v)
            };
            Query {
                barycentrics: [1.0 - u - v, u, v],
                triangle: (random.next() % scene.triangles.len() as u64) as u32,
                axis: random.direction().into(),
                // From wider than the sky to a sun.
                sharpness: 2f32.powf(-2.0 + 18.0 * random.unit()),
                normal: random.direction().into(),
                reserved: 0.0,
            }
        })
        .collect()
}

fn probe(gpu: &Gpu, scene: &Scene, queries: &[Query]) -> Result<Vec<Vec4>, Failed> {
    let device = &gpu.device;
    let packed = pack_scene(scene)?;
    let view = View::new(&scenes::camera(), 1, 1, 1.0);
    let mut frame = gpu::Frame::new(&view, &packed.atlas, packed.distance_clamp);
    frame.spokes = SPOKES;
    let frame = super::buffer(gpu, &scenes::batch(&frame), wgpu::BufferUsages::UNIFORM);
    let tables = super::storage(gpu, Tables::get().values());
    let triangles = super::storage(gpu, &packed.triangles);
    let clusters = super::storage(gpu, &packed.clusters);
    let coefficients = super::storage(gpu, &packed.coefficients);
    let atlas = device.create_texture_with_data(
        &gpu.queue,
        &wgpu::TextureDescriptor {
            label: None,
            size: wgpu::Extent3d {
                width: packed.atlas.width,
                height: packed.atlas.height,
                depth_or_array_layers: packed.atlas.layers,
            },
            mip_level_count: 1,
            sample_count: 1,
            dimension: wgpu::TextureDimension::D2,
            format: wgpu::TextureFormat::Rgba8Snorm,
            usage: wgpu::TextureUsages::TEXTURE_BINDING,
            view_formats: &[],
        },
        TextureDataOrder::LayerMajor,
        bytemuck::cast_slice(&packed.basis),
    );
    let atlas = atlas.create_view(&wgpu::TextureViewDescriptor {
        dimension: Some(wgpu::TextureViewDimension::D2Array),
        ..Default::default()
    });
    let sampler = device.create_sampler(&wgpu::SamplerDescriptor {
        mag_filter: wgpu::FilterMode::Linear,
        min_filter: wgpu::FilterMode::Linear,
        ..Default::default()
    });
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
                (1, triangles.as_entire_binding()),
                (2, clusters.as_entire_binding()),
                (3, coefficients.as_entire_binding()),
                (6, wgpu::BindingResource::TextureView(&atlas)),
                (7, wgpu::BindingResource::Sampler(&sampler)),
            ],
        ),
    ];
    let kernel = ("probe", include_str!("visibility.wgsl"));
    super::run(gpu, kernel, &groups, queries, 1)
}
