// Appended to the shading library: one function of a few numbers per invocation.

struct Case {
    function: u32,
    reserved_0: u32,
    reserved_1: u32,
    reserved_2: u32,
    inputs: array<vec4<f32>, 4>,
}

@group(3) @binding(0) var<storage, read> cases: array<Case>;
@group(3) @binding(1) var<storage, read_write> answers: array<vec4<f32>>;

fn functions_lobe(shape: vec4<f32>, amplitude: vec4<f32>) -> SphericalGaussian {
    return SphericalGaussian(shape.xyz, shape.w, amplitude.xyz);
}

fn functions_answer(case_: Case) -> vec4<f32> {
    let a = case_.inputs[0];
    let b = case_.inputs[1];
    let c = case_.inputs[2];
    let d = case_.inputs[3];
    switch case_.function {
        case 0u: {
            return vec4(octahedral_encode(a.xyz), 0.0, 0.0);
        }
        case 1u: {
            return vec4(octahedral_decode(a.xy), 0.0);
        }
        case 2u: {
            let product = spherical_gaussian_product(functions_lobe(a, b), functions_lobe(c, d));
            return vec4(product.axis * product.sharpness, product.sharpness);
        }
        case 3u: {
            let product = spherical_gaussian_product(functions_lobe(a, b), functions_lobe(c, d));
            return vec4(product.amplitude, 0.0);
        }
        case 4u: {
            return vec4(spherical_gaussian_integral(functions_lobe(a, b)), 0.0);
        }
        case 5u: {
            return vec4(tables_cosine_integral(a.x, a.y), 0.0, 0.0, 0.0);
        }
        case 6u: {
            return vec4(tables_hemisphere_fraction(a.x, a.y), 0.0, 0.0, 0.0);
        }
        case 7u: {
            return vec4(tonemap_neutral(a.xyz), 0.0);
        }
        case 8u: {
            return vec4(tonemap_encode_srgb(a.x), 0.0, 0.0, 0.0);
        }
        default: {
            let reflection = Reflection(a.xyz, case_.function - 8u, b.xyz, vec2(b.w, c.w), 0u);
            return vec4(models_specular(reflection, c.xyz, d.xyz), 0.0);
        }
    }
}

@compute @workgroup_size(64)
fn functions(@builtin(global_invocation_id) id: vec3<u32>) {
    if id.x < arrayLength(&cases) {
        answers[id.x] = functions_answer(cases[id.x]);
    }
}
