// Twin of ambient.rs.

const AMBIENT_COSINE_SHARPNESS: f32 = 2.133;

fn ambient_integrate(ssdf: Ssdf, sharpness: f32, axis: vec3<f32>, normal: vec3<f32>) -> f32 {
    let unoccluded = tables_cosine_integral(sharpness, dot(normal, axis));
    let product = sharpness * axis + AMBIENT_COSINE_SHARPNESS * normal;
    let product_sharpness = length(product);
    var product_axis = normal;
    if product_sharpness > 1e-6 {
        product_axis = product / product_sharpness;
    }
    // A field that saturates says "at least" at its limit: there the lobe counts as wholly
    // visible or blocked, and the fractions between are stretched to meet that.
    let limit = ssdf_limit();
    let fraction = tables_hemisphere_fraction(product_sharpness, ssdf_distance(ssdf, product_axis));
    let rest = tables_hemisphere_fraction(product_sharpness, -limit);
    return unoccluded * clamp((fraction - rest) / (1.0 - 2.0 * rest), 0.0, 1.0);
}
