// Twin of ambient.rs.

const AMBIENT_COSINE_SHARPNESS: f32 = 2.133;

fn ambient_integrate(ssdf: Ssdf, sharpness: f32, axis: vec3<f32>, normal: vec3<f32>) -> f32 {
    let unoccluded = tables_cosine_integral(sharpness, dot(normal, axis));
    let product = ambient_product(sharpness, axis, normal);
    return unoccluded * ambient_fraction(product.w, ssdf_distance(ssdf, product.xyz));
}

// Axis and sharpness of a lobe times the clamped cosine.
fn ambient_product(sharpness: f32, axis: vec3<f32>, normal: vec3<f32>) -> vec4<f32> {
    let product = sharpness * axis + AMBIENT_COSINE_SHARPNESS * normal;
    let product_sharpness = length(product);
    var product_axis = normal;
    if product_sharpness > 1e-6 {
        product_axis = product / product_sharpness;
    }
    return vec4(product_axis, product_sharpness);
}

// The visible fraction of such a product, `distance` being that of its axis.
fn ambient_fraction(sharpness: f32, distance: f32) -> f32 {
    // A field that saturates says "at least" at its limit: there the lobe counts as wholly
    // visible or blocked, and the fractions between are stretched to meet that.
    let fraction = tables_hemisphere_fraction(sharpness, distance);
    let rest = tables_hemisphere_fraction(sharpness, -ssdf_limit());
    return clamp((fraction - rest) / (1.0 - 2.0 * rest), 0.0, 1.0);
}

// How little ambient_integrate knows of a lobe.
fn ambient_beyond(sharpness: f32, axis: vec3<f32>, normal: vec3<f32>) -> f32 {
    let product = ambient_product(sharpness, axis, normal);
    let part = min(4.0 * tables_hemisphere_fraction(product.w, -ssdf_limit()), 1.0);
    return part * part;
}
