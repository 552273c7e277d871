// Twin of brdf.rs, and of Reflection::incident_factor in models.rs. Where the lobes are put say
// lobes.wgsl and slots.wgsl.

var<private> specular_count: u32;

// Puts them in the point's frame, grey; returns the colour that their amplitudes are multiplied by.
// `wo` is towards the eye.
fn brdf_lobes(reflection: Reflection, wo: vec3<f32>) -> vec3<f32> {
    specular_count = 0u;
    if !brdf_reflects(reflection, wo) {
        return vec3(0.0);
    }
    let unscaled = brdf_shape(reflection, wo);
    let albedo = brdf_albedo(reflection, wo);
    return (reflection.specular * albedo.x + reflection.grazing * albedo.y) / max(unscaled, 1.17549435e-38);
}

// Whether there are any.
fn brdf_reflects(reflection: Reflection, wo: vec3<f32>) -> bool {
    let black = all(max(reflection.specular, reflection.grazing) <= vec3(0.0));
    return reflection.model != MODEL_NONE && !black && wo.z > 0.0;
}

// The sum of what they reflect of a radiance of 1 from everywhere.
fn brdf_shape(reflection: Reflection, wo: vec3<f32>) -> f32 {
    let model = reflection.model;
    let width = vec2(
        brdf_profile_width(model, reflection.alpha.x),
        brdf_profile_width(model, reflection.alpha.y),
    );
    let horizontal = length(wo.xy);
    var incidence = vec2(1.0, 0.0);
    if horizontal > 0.0 {
        incidence = wo.xy / horizontal;
    }
    let cosine = max(wo.z, BRDF_MIN_COSINE);
    let stretched = brdf_stretch(width, incidence, cosine);
    let limit = exp2(f32(BRDF_MIXTURES - 1u) / BRDF_MIXTURES_PER_OCTAVE);
    let full_ratio = sqrt(stretched.long / stretched.short);
    let ratio = min(full_ratio, limit);
    // Beyond the table a lobe keeps its length and is made wider.
    let widening = full_ratio / ratio;

    let round = ratio < BRDF_ROUND_RATIO;
    let alpha = reflection.alpha;
    let isotropic = max(alpha.x, alpha.y) < BRDF_ISOTROPIC_RATIO * min(alpha.x, alpha.y);
    let few = isotropic && model != MODEL_GGX;
    let pairs = select(BRDF_ANISOTROPIC_PAIRS, BRDF_ISOTROPIC_PAIRS, few);
    let table = 2u * u32(model == MODEL_GGX) + u32(!isotropic);
    let position = log2(max(ratio, 1.0)) * BRDF_MIXTURES_PER_OCTAVE;
    let node = min(u32(position), BRDF_MIXTURES - 2u);
    let first = BRDF_MIXTURE_START + (table * BRDF_MIXTURES + node) * BRDF_MIXTURE_STRIDE;
    let fraction = position - f32(node);

    let alone = round && model != MODEL_GGX;
    let count = 1u + select(pairs * select(2u, 1u, round), 0u, alone);
    let step = sqrt(max(ratio * ratio - 1.0, 0.0)) / ratio;
    let slope = stretched.long_axis * width;
    let facing = BRDF_TIPPING * dot(stretched.long_axis * alpha, incidence) * horizontal / cosine;
    var unscaled = 0.0;
    // One place that lobes are made: copies of it are most of a shader.
    for (var i = 0u; i < count; i++) {
        var along = 0.0;
        var scale = 1.0;
        var weight = 1.0;
        if i > 0u {
            let pair = select((i - 1u) / 2u, i - 1u, round);
            scale = exp(brdf_mixture(first + 2u + 3u * pair, fraction));
            weight = exp(brdf_mixture(first + 3u + 3u * pair, fraction));
            if round {
                weight *= 2.0;
            } else {
                along = step * brdf_mixture(first + 4u + 3u * pair, fraction);
                along = select(-along, along, (i & 1u) == 1u);
            }
        } else if !alone {
            scale = exp(brdf_mixture(first, fraction));
            weight = exp(brdf_mixture(first + 1u, fraction));
        }
        var place = vec2(along, 0.0);
        if model == MODEL_GGX {
            place = brdf_tip(along, facing, dot(slope, slope));
        }
        let lobe = brdf_lobe(reflection, wo, width, incidence, stretched.short, widening, slope * place.x, place.y, scale, weight);
        unscaled += lobe.amplitude.x * tables_cosine_integral(lobe.sharpness, lobe.axis.z);
        lobes_put(i, lobe.axis, lobe.sharpness, lobe.amplitude.x);
    }
    specular_count = count;
    return unscaled;
}

fn brdf_mixture(index: u32, fraction: f32) -> f32 {
    return mix(tables[index], tables[index + BRDF_MIXTURE_STRIDE], fraction);
}

fn brdf_lobe(
    reflection: Reflection,
    wo: vec3<f32>,
    width: vec2<f32>,
    incidence: vec2<f32>,
    central_short: f32,
    widening: f32,
    offset: vec2<f32>,
    apart: f32,
    scale: f32,
    weight: f32,
) -> SphericalGaussian {
    let h = normalize(vec3(offset, 1.0));
    let axis = 2.0 * dot(h, wo) * h - wo;
    let short = brdf_stretch(width, incidence, max(dot(h, wo), BRDF_MIN_COSINE)).short;
    // A lobe is as wide as the reflection across the long axis, or as it takes to meet its neighbours along it.
    let across = sqrt(short / central_short);
    let growth = max(across, apart);
    let wider = widening * growth;
    let sharpness = 2.0 * scale / (central_short * wider * wider);
    // All of it is as bright as it would be across the long axis.
    let adjusted = weight * across / (growth * growth);
    return brdf_tilt(reflection, wo, axis, sharpness, adjusted);
}

// Where on the long axis a lobe of GGX lies, and how many times as far its neighbours are from it.
fn brdf_tip(along: f32, facing: f32, squared_slope: f32) -> vec2<f32> {
    let root = sqrt(1.0 + facing * facing);
    let straight = 1.0 + along * along;
    let part = 0.5 * (1.0 + along / sqrt(straight));
    let sine = part * (1.0 + root) / root - 1.0;
    let cosine = sqrt(max(1.0 - sine * sine, BRDF_LEAST_TIPPED));
    // Angles whose tangents are kappa and the slope.
    let tipped_cosine = max((cosine - sine * facing) / root, BRDF_LEAST_TIPPED);
    let tipped = (sine + cosine * facing) / (root * tipped_cosine);
    let seen = tipped_cosine * tipped_cosine * cosine;
    let apart = 0.5 * (1.0 + root) / root / (straight * sqrt(straight) * seen);
    let flattened = (1.0 + squared_slope * along * along) / (1.0 + squared_slope * tipped * tipped);
    return vec2(tipped, apart * flattened);
}

struct Stretch {
    long: f32,
    short: f32,
    long_axis: vec2<f32>,
}

fn brdf_stretch(width: vec2<f32>, incidence: vec2<f32>, cosine: f32) -> Stretch {
    let c2 = cosine * cosine;
    let e2 = incidence * incidence;
    let diagonal = 4.0 * width * width * (e2 + c2 * e2.yx);
    let off_diagonal = 4.0 * width.x * width.y * (1.0 - c2) * incidence.x * incidence.y;
    let half = 0.5 * (diagonal.x - diagonal.y);
    let root = sqrt(half * half + off_diagonal * off_diagonal);
    let long = 0.5 * (diagonal.x + diagonal.y) + root;
    // The product of the singular values is known: no cancellation in the short one.
    let area = 4.0 * width.x * width.y * cosine;
    // Of the two proportional forms of the eigenvector, the one that does not cancel.
    let eigenvector = select(
        vec2(off_diagonal, root - half),
        vec2(half + root, off_diagonal),
        half >= 0.0,
    );
    let eigenvector_length = length(eigenvector);
    var long_axis = vec2(1.0, 0.0);
    if eigenvector_length > 0.0 {
        long_axis = eigenvector / eigenvector_length;
    }
    return Stretch(long, area * area / long, long_axis);
}

fn brdf_tilt(
    reflection: Reflection,
    wo: vec3<f32>,
    axis: vec3<f32>,
    sharpness: f32,
    weight: f32,
) -> SphericalGaussian {
    let sine_squared = max(1.0 - axis.z * axis.z, 0.0);
    // Standard deviation of n.w: linear in the angle off the pole, quadratic at the pole.
    let variance = sine_squared / (sharpness + 1.0) + 1.0 / (sharpness * sharpness + 4.0);
    let deviation = max(sqrt(variance), BRDF_MIN_DEVIATION);
    // Near the mean of max(n.w, 0).
    let middle = 0.5 * (axis.z + sqrt(axis.z * axis.z + 0.64 * variance));
    let low = max(middle - deviation, BRDF_MIN_COSINE);
    let high = clamp(middle + deviation, 2.0 * BRDF_MIN_COSINE, 1.0);
    let sine = sqrt(sine_squared);
    // At the pole neither axis of an anisotropic material is preferred.
    var azimuth = vec2(sqrt(0.5));
    if sine > 0.0 {
        azimuth = axis.xy / sine;
    }
    let at_low = brdf_modulation(reflection, wo, azimuth, low);
    let slope = log(brdf_modulation(reflection, wo, azimuth, high) / at_low) / (high - low);
    let k = max(slope, -BRDF_MAX_TILT * sharpness);
    let sum = sharpness * axis + vec3(0.0, 0.0, k);
    let tilted = length(sum);
    // tilted - sharpness - k low, without the difference of the first two.
    let exponent = k * (2.0 * sharpness * axis.z + k) / (tilted + sharpness) - k * low;
    let amplitude = vec3(weight * at_low * exp(exponent));
    return SphericalGaussian(sum / tilted, tilted, amplitude);
}

fn brdf_modulation(reflection: Reflection, wo: vec3<f32>, azimuth: vec2<f32>, cosine: f32) -> f32 {
    let sine = sqrt(max(1.0 - cosine * cosine, 0.0));
    let wi = vec3(azimuth * sine, cosine);
    let half_cosine = sqrt(max(0.5 + 0.5 * dot(wi, wo), 0.0));
    let masking = brdf_incident_factor(reflection, wi, wo, half_cosine);
    if !surface_has_fresnel(reflection.model) {
        return masking;
    }
    let f0 = reflection.specular.x + reflection.specular.y + reflection.specular.z;
    let f90 = reflection.grazing.x + reflection.grazing.y + reflection.grazing.z;
    let fresnel = f0 + (f90 - f0) * pow(clamp(1.0 - half_cosine, 0.0, 1.0), 5.0);
    return masking * max(fresnel, BRDF_MIN_FRESNEL * f90);
}

fn brdf_incident_factor(reflection: Reflection, wi: vec3<f32>, wo: vec3<f32>, half_cosine: f32) -> f32 {
    if reflection.model == MODEL_ASHIKHMIN_SHIRLEY {
        return 1.0 / (half_cosine * max(wi.z, wo.z));
    }
    return brdf_direction_factor(reflection, wi);
}

fn brdf_direction_factor(reflection: Reflection, w: vec3<f32>) -> f32 {
    let projected = length(w.xy * reflection.alpha);
    let cosine = w.z;
    switch reflection.model {
        case MODEL_WARD: {
            return 1.0 / cosine;
        }
        case MODEL_COOK_TORRANCE: {
            if cosine >= 1.6 * projected {
                return 0.5 / cosine;
            }
            let a = cosine / projected;
            return 0.5 * (3.535 + 2.181 * a) / ((1.0 + (2.276 + 2.577 * a) * a) * projected);
        }
        case MODEL_GGX: {
            return 1.0 / (cosine + sqrt(cosine * cosine + projected * projected));
        }
        default: {
            return 1.0;
        }
    }
}

fn brdf_profile_width(model: u32, alpha: f32) -> f32 {
    var inverse_square = 1.0;
    switch model {
        case MODEL_BLINN_PHONG: {
            inverse_square = 0.5 * alpha + 1.0 - 1.0 / alpha;
        }
        case MODEL_WARD: {
            inverse_square = 1.0 / (alpha * alpha) + 2.0 - alpha;
        }
        case MODEL_COOK_TORRANCE: {
            inverse_square = 1.0 / (alpha * alpha) - 1.4 * alpha * alpha;
        }
        case MODEL_GGX: {
            inverse_square = 1.0 / (alpha * alpha) - 1.0;
        }
        case MODEL_ASHIKHMIN_SHIRLEY: {
            let exponent = 2.0 / (alpha * alpha);
            inverse_square = 0.5 * exponent + 1.0 - 1.0 / exponent;
        }
        default: {}
    }
    return 1.0 / sqrt(max(inverse_square, BRDF_MIN_INVERSE_SQUARE));
}

// Roughness along tangent and bitangent, of models with an exponent as well.
fn brdf_roughness(reflection: Reflection) -> vec2<f32> {
    return select(reflection.alpha, sqrt(2.0 / reflection.alpha), vec2(reflection.model == MODEL_BLINN_PHONG));
}

// Factors of the specular colour and of white.
fn brdf_albedo(reflection: Reflection, wo: vec3<f32>) -> vec2<f32> {
    let alpha = brdf_roughness(reflection);
    let low = sqrt(SURFACE_MIN_ALPHA);
    let last = f32(BRDF_ALBEDO_ALPHAS - 1u);
    let position = clamp((sqrt(alpha) - low) / (1.0 - low), vec2(0.0), vec2(1.0)) * last;
    let angle = sqrt(clamp(1.0 - wo.z, 0.0, 1.0)) * f32(BRDF_ALBEDO_ANGLES - 1u);
    let table = brdf_albedo_table(reflection.model);
    let first = table.x;
    let stride = table.y;
    // Tabulated for a view in the plane of the first roughness and a quarter of the way to
    // that of the second; the rest of the way by swapping them.
    let several = stride != 0u && max(alpha.x, alpha.y) / min(alpha.x, alpha.y) >= BRDF_ISOTROPIC_RATIO;
    // What varies with azimuth is masking, by the roughness that the view is masked by: the
    // cubic in it through the four that are tabulated (Lagrange).
    let squares = wo.xy * wo.xy / max(1.0 - wo.z * wo.z, 1e-12);
    let alpha_squares = alpha * alpha;
    let azimuth = vec2(BRDF_QUARTER_COSINE, BRDF_QUARTER_SINE);
    let tabulated = vec4(
        alpha.x,
        sqrt(dot(alpha_squares, azimuth * azimuth)),
        sqrt(dot(alpha_squares, azimuth.yx * azimuth.yx)),
        alpha.y,
    );
    let beyond = vec4(sqrt(dot(alpha_squares, squares))) - tabulated;
    var mean = vec2(0.0);
    // One place that tables are read: copies of it are most of a shader.
    for (var i = 0u; i < select(1u, 4u, several); i++) {
        let block = first + select(0u, 2u * BRDF_ALBEDO_BLOCK, i == 1u || i == 2u);
        let place = select(position, position.yx, i > 1u);
        var weight = 1.0;
        if several {
            let own = vec4(i) == vec4(0u, 1u, 2u, 3u);
            let factors = select(beyond / (vec4(tabulated[i]) - tabulated), vec4(1.0), own);
            weight = factors.x * factors.y * factors.z * factors.w;
        }
        mean += brdf_albedo_lookup(block, stride, place.x, place.y, angle) * weight;
    }
    let white = max(mean.y, 0.0) * max(mean.y, 0.0);
    return vec2(max(mean.x, 0.0), white * white);
}

fn brdf_albedo_lookup(first: u32, stride: u32, x: f32, y: f32, angle: f32) -> vec2<f32> {
    let i = min(u32(x), BRDF_ALBEDO_ALPHAS - 2u);
    let j = min(u32(y), BRDF_ALBEDO_ALPHAS - 2u);
    let k = min(u32(angle), BRDF_ALBEDO_ANGLES - 2u);
    let near = first + (j * stride + i * BRDF_ALBEDO_ANGLES + k) * 2u;
    let far = near + stride * 2u;
    let u = x - f32(i);
    let w = angle - f32(k);
    let near_value = mix(brdf_albedo_at(near, w), brdf_albedo_at(near + BRDF_ALBEDO_ANGLES * 2u, w), u);
    let far_value = mix(brdf_albedo_at(far, w), brdf_albedo_at(far + BRDF_ALBEDO_ANGLES * 2u, w), u);
    return mix(near_value, far_value, y - f32(j));
}

fn brdf_albedo_at(index: u32, w: f32) -> vec2<f32> {
    return mix(
        vec2(tables[index], tables[index + 1u]),
        vec2(tables[index + 2u], tables[index + 3u]),
        w,
    );
}
