// Twin of ambient.rs.

fn ambient_integrate(sharpness: f32, axis: vec3<f32>, normal: vec3<f32>) -> f32 {
    let unoccluded = tables_cosine_integral(sharpness, dot(normal, axis));
    // A field that saturates says "at least" at its limit: there the lobe counts as wholly
    // visible or blocked, and the fractions between are stretched to meet that.
    let limit = ssdf_limit();
    let fraction = tables_hemisphere_fraction(sharpness, ssdf_distance(axis));
    let rest = tables_hemisphere_fraction(sharpness, -limit);
    return unoccluded * clamp((fraction - rest) / (1.0 - 2.0 * rest), 0.0, 1.0);
}
