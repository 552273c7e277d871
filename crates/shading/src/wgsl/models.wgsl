// Twin of evaluate_specular in models.rs.

// One specular reflection's value, without the cosine. Both directions in the surface's frame and above the horizon.
fn models_specular(reflection: Reflection, wi: vec3<f32>, wo: vec3<f32>) -> vec3<f32> {
    let half = normalize(wi + wo);
    let half_cosine = dot(half, wo);
    var geometry = brdf_incident_factor(reflection, wi, wo, half_cosine);
    if reflection.model != MODEL_ASHIKHMIN_SHIRLEY {
        geometry *= brdf_direction_factor(reflection, wo);
    }
    let color = surface_reflection_color(reflection, half_cosine);
    let value = color * (models_half_vector_factor(reflection, half) * geometry);
    if reflection.ratio == 0u {
        return value;
    }
    return value * surface_ratio(reflection.ratio, wi, wo);
}

fn models_half_vector_factor(reflection: Reflection, h: vec3<f32>) -> f32 {
    let x = reflection.alpha.x;
    let y = reflection.alpha.y;
    let slope = h.xy / reflection.alpha;
    let slope_squared = dot(slope, slope) / (h.z * h.z);
    switch reflection.model {
        case MODEL_BLINN_PHONG: {
            return (x + 8.0) / (8.0 * PI) * pow(h.z, x);
        }
        case MODEL_WARD: {
            return exp(-slope_squared) / (4.0 * PI * x * y);
        }
        case MODEL_COOK_TORRANCE: {
            return exp(-slope_squared) / (PI * x * y * h.z * h.z * h.z * h.z);
        }
        case MODEL_GGX: {
            let d = dot(slope, slope) + h.z * h.z;
            return 1.0 / (PI * x * y * d * d);
        }
        case MODEL_ASHIKHMIN_SHIRLEY: {
            let exponents = 2.0 / (reflection.alpha * reflection.alpha);
            let sine_squared = dot(h.xy, h.xy);
            var exponent = 0.0;
            if sine_squared > 0.0 {
                exponent = dot(exponents, h.xy * h.xy) / sine_squared;
            }
            let scale = sqrt((exponents.x + 1.0) * (exponents.y + 1.0)) / (2.0 * PI);
            return 0.25 * scale * pow(max(h.z, 0.0), exponent);
        }
        default: {
            return 0.0;
        }
    }
}
