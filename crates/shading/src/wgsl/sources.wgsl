// Twin of sources.rs, and the entry point that finds what one source (z) adds to a pixel: one
// invocation for all would walk further through the scene than software GPUs let a shader loop
// (Mesa's llvmpipe ends all loops after 65,536 iterations).

@compute @workgroup_size(8, 8)
fn sources_main(@builtin(global_invocation_id) id: vec3<u32>) {
    let pixel = id.xy + vec2(frame.first_column, frame.first_row);
    let seen = seen_triangle(pixel);
    if seen.x >= frame.triangle_count {
        return;
    }
    let triangle = triangles[seen.x];
    let corners = triangle.xyz;
    let weights = seen_barycentrics(corners, pixel, seen.y);
    let point = surface_point(corners, triangle.w & 0xffffu, weights);
    var sum = vec3(0.0);
    if dot(point.normal, point.view) > 0.0 {
        sum = sources_radiance(id.z, point);
    }
    textureStore(source_radiance_found, pixel, id.z, vec4(sum, 1.0));
}

// Radiance of one source from `point` towards the eye, which is above its horizon.
fn sources_radiance(source: u32, point: SurfacePoint) -> vec3<f32> {
    let cone = source_points[source * (1u + SOURCE_RIM + SOURCE_POINTS)];
    let rim = source * (1u + SOURCE_RIM + SOURCE_POINTS) + 1u;
    let first = rim + SOURCE_RIM;
    var above = false;
    for (var i = rim; i < first + SOURCE_LEVELS.x; i++) {
        above = above || surface_to_local(point, source_points[i].direction).z > 0.0;
    }
    if !above {
        return vec3(0.0);
    }
    let origin = point.position + point.geometric_normal * source_points[first].ray_offset;
    let wo = surface_to_local(point, point.view);
    let touched = occluders_meet_cone(origin, cone.direction, cone.cone_cosine);
    var seen = false;
    var hidden = false;
    var level = 1u;
    var sum = vec3(0.0);
    for (var i = first; i < first + SOURCE_POINTS; i++) {
        if i == first + SOURCE_LEVELS.x && !(seen && hidden) {
            for (var j = rim; j < first; j++) {
                let direction = source_points[j].direction;
                if touched && !(seen && hidden) && surface_to_local(point, direction).z > 0.0 {
                    if occluders_block(origin, direction) {
                        hidden = true;
                    } else {
                        seen = true;
                    }
                }
            }
            if !hidden {
                level = 0u;
                break;
            }
            if !seen {
                break;
            }
        }
        let direction = source_points[i].direction;
        let wi = surface_to_local(point, direction);
        if wi.z > 0.0 {
            if touched && occluders_block(origin, direction) {
                hidden = true;
            } else {
                seen = true;
                sum += source_points[i].light * (wi.z * reference_evaluate(point.appearance, wi, wo));
            }
        }
    }
    return sum * source_scales[2u * source + level].xyz;
}
