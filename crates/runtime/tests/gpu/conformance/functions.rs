//! Functions of a few numbers: the oracle, the twin and the GPU on the same random input.

use bytemuck::{Pod, Zeroable};
use glam::{DVec2, DVec4, Vec2, Vec3, Vec4, Vec4Swizzles as _};
use libtest_mimic::Failed;
use relight_runtime::offscreen::Gpu;
use relight_runtime::wgpu;
use relight_shading::spherical_gaussian::SphericalGaussian;
use relight_shading::surface::{Model, Reflection};
use relight_shading::tables::Tables;
use relight_shading::{models, octahedral, tonemap};

use super::oracle;
use crate::scenes::Random;

/// Inputs of each function.
const CASES: usize = 2_000;

#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
struct Case {
    function: u32,
    reserved: [u32; 3],
    inputs: [Vec4; 4],
}

/// One function; its number is its place in `FUNCTIONS`, and its case in the shader.
struct Function {
    name: &'static str,
    /// What the twin and what the GPU may be off by, as a part of the oracle's longest component or of `scale`,
    /// whichever is more.
    tolerances: [f64; 2],
    scale: f64,
    draw: fn(&mut Random) -> [Vec4; 4],
    oracle: fn(&[DVec4; 4]) -> DVec4,
    twin: fn(&[Vec4; 4]) -> Vec4,
}

const FUNCTIONS: &[Function] = &[
    Function {
        name: "octahedral map, encode",
        tolerances: [3e-7, 1e-6],
        scale: 1.0,
        draw: |random| {
            [
                random.direction().extend(0.0),
                Vec4::ZERO,
                Vec4::ZERO,
                Vec4::ZERO,
            ]
        },
        oracle: |[a, ..]| oracle::octahedral_encode(a.xyz()).extend(0.0).extend(0.0),
        twin: |[a, ..]| octahedral::encode(a.xyz()).extend(0.0).extend(0.0),
    },
    Function {
        name: "octahedral map, decode",
        tolerances: [5e-7, 1e-6],
        scale: 1.0,
        draw: |random| {
            let at = Vec2::new(random.unit(), random.unit());
            [
                at.extend(0.0).extend(0.0),
                Vec4::ZERO,
                Vec4::ZERO,
                Vec4::ZERO,
            ]
        },
        oracle: |[a, ..]| oracle::octahedral_decode(a.xy()).extend(0.0),
        twin: |[a, ..]| octahedral::decode(a.xy()).extend(0.0),
    },
    Function {
        name: "product of lobes, axis and sharpness",
        tolerances: [5e-7, 2e-6],
        scale: 1.0,
        draw: pair,
        oracle: |[a, _, c, _]| oracle::product((a.xyz(), a.w), (c.xyz(), c.w)).0,
        twin: |[a, b, c, d]| {
            let product = lobe(*a, *b).product(&lobe(*c, *d));
            (product.axis * product.sharpness).extend(product.sharpness)
        },
    },
    // Exponents of up to some ten, of axes that are unit vectors to 1e-7 times sharpnesses of up to 10³.
    Function {
        name: "product of lobes, amplitude",
        tolerances: [2e-4, 1e-3],
        scale: 1e-3,
        draw: pair,
        oracle: |[a, b, c, d]| {
            let (_, factor) = oracle::product((a.xyz(), a.w), (c.xyz(), c.w));
            (factor * b.xyz() * d.xyz()).extend(0.0)
        },
        twin: |[a, b, c, d]| lobe(*a, *b).product(&lobe(*c, *d)).amplitude.extend(0.0),
    },
    Function {
        name: "integral of a lobe",
        tolerances: [5e-7, 1e-5],
        scale: 0.0,
        draw: pair,
        oracle: |[a, b, ..]| (oracle::energy(a.w) * b.xyz()).extend(0.0),
        twin: |[a, b, ..]| lobe(*a, *b).integral().extend(0.0),
    },
    // Interpolated in a table; relative to what is left of a lobe below the horizon.
    Function {
        name: "integral of a lobe times a cosine",
        tolerances: [1.5e-2, 1.5e-2],
        scale: 0.0,
        draw: |random| horizon(random, 1.0),
        oracle: |[a, ..]| {
            let [integral, _] = oracle::above_horizon(a.x, a.y);
            DVec4::new(integral, 0.0, 0.0, 0.0)
        },
        twin: |[a, ..]| Tables::get().cosine_integral(a.x, a.y) * Vec4::X,
    },
    Function {
        name: "fraction of a lobe in a half-space",
        tolerances: [5e-4, 5e-4],
        scale: 1.0,
        draw: |random| horizon(random, std::f32::consts::FRAC_PI_2),
        oracle: |[a, ..]| {
            let [_, fraction] = oracle::above_horizon(a.x, a.y.sin());
            DVec4::new(fraction, 0.0, 0.0, 0.0)
        },
        twin: |[a, ..]| Tables::get().hemisphere_fraction(a.x, a.y) * Vec4::X,
    },
    Function {
        name: "tone curve",
        tolerances: [5e-7, 2e-6],
        scale: 1.0,
        draw: |random| {
            let mut channel = || 10f32.powf(-2.0 + 4.0 * random.unit());
            let color = Vec3::new(channel(), channel(), channel());
            [color.extend(0.0), Vec4::ZERO, Vec4::ZERO, Vec4::ZERO]
        },
        oracle: |[a, ..]| oracle::neutral(a.xyz()).extend(0.0),
        twin: |[a, ..]| tonemap::neutral(a.xyz()).extend(0.0),
    },
    Function {
        name: "sRGB transfer function",
        tolerances: [5e-7, 2e-5],
        scale: 1.0,
        draw: |random| {
            [
                random.unit().powi(3) * Vec4::X,
                Vec4::ZERO,
                Vec4::ZERO,
                Vec4::ZERO,
            ]
        },
        oracle: |[a, ..]| DVec4::new(oracle::encode_srgb(a.x), 0.0, 0.0, 0.0),
        twin: |[a, ..]| tonemap::encode_srgb(a.x) * Vec4::X,
    },
    model::<0>("Blinn-Phong", [2e-4, 5e-3]),
    model::<1>("Ward", [1e-5, 1e-4]),
    model::<2>("Cook-Torrance", [1e-5, 1e-4]),
    model::<3>("GGX", [5e-6, 1e-4]),
    model::<4>("Ashikhmin-Shirley", [4e-4, 5e-3]),
];

/// The values of a reflection model. Those with exponents raise a cosine that is off by 6e-8 to their power, of up to
/// two thousand; GPUs by way of a logarithm.
const fn model<const NUMBER: usize>(name: &'static str, tolerances: [f64; 2]) -> Function {
    Function {
        name,
        tolerances,
        scale: 1e-3,
        draw: reflection::<NUMBER>,
        oracle: |[a, b, c, d]| {
            let (alpha, wi, wo) = (DVec2::new(b.w, c.w), c.xyz(), d.xyz());
            let value = oracle::MODELS[NUMBER](alpha, wi, wo);
            let color = if NUMBER < 2 {
                a.xyz()
            } else {
                let cosine = (wi + wo).normalize().dot(wo);
                a.xyz() + (b.xyz() - a.xyz()) * (1.0 - cosine).powi(5)
            };
            (value * color).extend(0.0)
        },
        twin: |[a, b, c, d]| {
            let reflection = Reflection {
                grazing: b.xyz(),
                ..Reflection::new(Model::ALL[NUMBER], a.xyz(), Vec2::new(b.w, c.w))
            };
            models::evaluate_specular(&reflection, c.xyz(), d.xyz()).extend(0.0)
        },
    }
}

fn lobe(shape: Vec4, amplitude: Vec4) -> SphericalGaussian {
    SphericalGaussian {
        axis: shape.xyz(),
        sharpness: shape.w,
        amplitude: amplitude.xyz(),
    }
}

/// Two lobes from wider than the sky to a window's.
fn pair(random: &mut Random) -> [Vec4; 4] {
    let mut lobe = || {
        let axis = random.direction();
        let color = 0.1 + 0.9 * Vec3::new(random.unit(), random.unit(), random.unit());
        (
            axis.extend(2f32.powf(-2.0 + 12.0 * random.unit())),
            color.extend(0.0),
        )
    };
    let ((a, b), (c, d)) = (lobe(), lobe());
    // Not so far apart that their product is nothing.
    let near = (a.xyz() + 4.0 * c.xyz() / c.w.sqrt().max(1.0)).normalize();
    [a, b, near.extend(c.w), d]
}

/// Sharpness from wider than the sky to a sun's, and a number from −`most` to `most` that is not so far below the
/// horizon that nothing is left.
fn horizon(random: &mut Random, most: f32) -> [Vec4; 4] {
    let sharpness = 2f32.powf(-2.0 + 16.0 * random.unit());
    let lowest = -(most.min(2.0 / sharpness.sqrt()));
    let height = lowest + (most - lowest) * random.unit();
    [
        Vec4::new(sharpness, height, 0.0, 0.0),
        Vec4::ZERO,
        Vec4::ZERO,
        Vec4::ZERO,
    ]
}

/// Parameters of a model, and directions above the horizon.
fn reflection<const NUMBER: usize>(random: &mut Random) -> [Vec4; 4] {
    let mut color = || 0.1 + 0.9 * Vec3::new(random.unit(), random.unit(), random.unit());
    let (specular, grazing) = (color(), color());
    let mut alpha = || 10f32.powf(-1.5 * random.unit());
    let (mut x, mut y) = (alpha(), alpha());
    match Model::ALL[NUMBER] {
        Model::BlinnPhong => (x, y) = (1.0 / (x * x), 1.0 / (x * x)),
        Model::CookTorrance => y = x,
        _ => {}
    }
    let mut above = || {
        let direction = random.direction();
        direction.with_z(direction.z.abs().max(0.05)).normalize()
    };
    let (wi, wo) = (above(), above());
    [
        specular.extend(0.0),
        grazing.extend(x),
        wi.extend(y),
        wo.extend(0.0),
    ]
}

pub fn functions_match_oracle_and_twin(gpu: &mut Gpu) -> Result<(), Failed> {
    let mut random = Random(5);
    let cases: Vec<Case> = (FUNCTIONS.iter().zip(0..))
        .flat_map(|(function, number)| std::iter::repeat_n((function, number), CASES))
        .map(|(function, number)| Case {
            function: number,
            reserved: [0; 3],
            inputs: (function.draw)(&mut random),
        })
        .collect();
    let answers = answers(gpu, &cases)?;
    let mut wrong = String::new();
    for (index, function) in FUNCTIONS.iter().enumerate() {
        let range = index * CASES..(index + 1) * CASES;
        let mut worst = [0f64; 2];
        for (case, found) in cases[range.clone()].iter().zip(&answers[range]) {
            let expected = (function.oracle)(&case.inputs.map(Vec4::as_dvec4));
            let scale = expected.abs().max_element().max(function.scale);
            let found = [(function.twin)(&case.inputs), *found];
            for (worst, found) in worst.iter_mut().zip(found) {
                let error = (found.as_dvec4() - expected).abs().max_element() / scale;
                // Not a number is as wrong as can be.
                *worst = worst.max(if error.is_finite() { error } else { f64::MAX });
            }
        }
        let Function {
            name, tolerances, ..
        } = function;
        println!(
            "{name}: twin off by {:.1e}, GPU by {:.1e}",
            worst[0], worst[1]
        );
        if worst
            .iter()
            .zip(tolerances)
            .any(|(worst, most)| worst > most)
        {
            wrong += &format!("{name}: expected at most {tolerances:?}, found {worst:?}\n");
        }
    }
    if wrong.is_empty() {
        Ok(())
    } else {
        Err(wrong.into())
    }
}

fn answers(gpu: &Gpu, cases: &[Case]) -> Result<Vec<Vec4>, Failed> {
    let wgsl = concat!(
        include_str!("../../../../shading/src/wgsl/tonemap.wgsl"),
        include_str!("functions.wgsl")
    );
    let tables = super::storage(gpu, Tables::get().values());
    // No reflection has a ratio; something has to be bound where one would be.
    let texels = gpu.device.create_texture(&wgpu::TextureDescriptor {
        label: None,
        size: wgpu::Extent3d::default(),
        mip_level_count: 1,
        sample_count: 1,
        dimension: wgpu::TextureDimension::D2,
        format: wgpu::TextureFormat::R32Uint,
        usage: wgpu::TextureUsages::TEXTURE_BINDING,
        view_formats: &[],
    });
    let texels = texels.create_view(&wgpu::TextureViewDescriptor {
        dimension: Some(wgpu::TextureViewDimension::D2Array),
        ..Default::default()
    });
    let groups = [
        (0, &[(2, tables.as_entire_binding())][..]),
        (1, &[(5, wgpu::BindingResource::TextureView(&texels))]),
    ];
    super::run(gpu, ("functions", wgsl), &groups, cases, 1)
}
