// Twin of sources.rs, and the entry point that finds what sources add to a pixel.

@compute @workgroup_size(8, 8)
fn sources_main(@builtin(global_invocation_id) id: vec3<u32>) {
    let pixel = vec2(id.x, id.y + frame.first_row);
    if any(pixel >= textureDimensions(visibility_buffer)) {
        return;
    }
    let covering = textureLoad(visibility_buffer, pixel, 0).x;
    if covering == 0u {
        textureStore(radiance, pixel, vec4(0.0));
        return;
    }
    let triangle = triangles[covering - 1u];
    let corners = triangle.xyz;
    let weights = barycentrics(
        vertices[corners.x].position,
        vertices[corners.y].position,
        vertices[corners.z].position,
        pixel_direction(pixel),
    );
    let point = surface_point(corners, triangle.w & 0xffffu, weights);
    var sum = vec3(0.0);
    if dot(point.normal, point.view) > 0.0 {
        for (var source = 0u; source < frame.source_count; source++) {
            sum += sources_radiance(source, point);
        }
    }
    textureStore(radiance, pixel, vec4(sum, 1.0));
}

// Radiance of one source from `point` towards the eye, which is above its horizon.
fn sources_radiance(source: u32, point: SurfacePoint) -> vec3<f32> {
    let probes = source * (SOURCE_PROBES + SOURCE_POINTS);
    let first = probes + SOURCE_PROBES;
    let origin = point.position + point.geometric_normal * source_points[first].ray_offset;
    let wo = surface_to_local(point, point.view);
    var seen = false;
    var hidden = false;
    for (var i = probes; i < first; i++) {
        let direction = source_points[i].direction;
        if dot(point.normal, direction) > 0.0 && !(seen && hidden) {
            if occluders_block(origin, direction) {
                hidden = true;
            } else {
                seen = true;
            }
        }
    }
    var sum = vec3(0.0);
    if !seen {
        return sum;
    }
    let last = first + select(SOURCE_LEVELS.x, SOURCE_LEVELS.y, hidden);
    for (var i = first; i < last; i++) {
        let direction = source_points[i].direction;
        let wi = surface_to_local(point, direction);
        if wi.z > 0.0 {
            if !hidden || !occluders_block(origin, direction) {
                sum += source_points[i].light * (wi.z * reference_evaluate(point.appearance, wi, wo));
            }
        }
    }
    return sum * source_scales[2u * source + select(0u, 1u, hidden)].xyz;
}
