// Twin of irradiance in shade.rs, and the entry point that finds a pixel's irradiance: no material
// but the normal has a part in it.

@compute @workgroup_size(8, 8)
fn diffuse_main(@builtin(global_invocation_id) id: vec3<u32>) {
    let pixel = id.xy + vec2(frame.first_column, frame.first_row);
    let seen = seen_triangle(pixel);
    if seen.x >= frame.triangle_count {
        return;
    }
    let triangle = triangles[seen.x];
    let material = triangle.w & 0xffffu;
    let corners = triangle.xyz;
    let weights = seen_barycentrics(corners, pixel, seen.y);
    let shape = surface_shape(corners, material, weights);
    if materials[material].has_diffuse == 0u || dot(shape.normal, shape.view) <= 0.0 {
        textureStore(radiance, pixel, vec4(0.0));
        return;
    }
    ssdf_load(clusters[triangle.w >> 16u], corners, weights);
    let sum = diffuse_irradiance(shape, corners, weights);
    textureStore(radiance, pixel, vec4(sum, 1.0));
}

fn diffuse_irradiance(shape: SurfaceShape, corners: vec3<u32>, weights: vec3<f32>) -> vec3<f32> {
    let holds = vertex_visibility_holds(shape.vertex_cosine);
    var sum = vec3(0.0);
    for (var i = 0u; i < frame.light_count + frame.local_light_count; i++) {
        let fractions = vertex_visibility_of(i, holds, corners, weights);
        let light = shade_light(i, shape.position);
        let whole = spherical_gaussian_integral(light);
        if shade_negligible(whole, sum) {
            continue;
        }
        let share = shade_share(whole, sum);
        let doubt = vertex_visibility_doubt(fractions, share);
        var visible = 0.0;
        if doubt < 1.0 {
            let cosine = dot(shape.normal, light.axis);
            visible = fractions.mean * tables_cosine_integral(light.sharpness, cosine);
        }
        if doubt > 0.0 {
            visible = mix(visible, shade_visible(light, share, shape.normal), doubt);
        }
        sum += light.amplitude * visible;
    }
    return sum;
}
