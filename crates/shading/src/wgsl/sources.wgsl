// Twin of sources.rs, and the entry point that finds what one source (z) adds to a pixel: one
// invocation for all would walk further through the scene than software GPUs let a shader loop
// (Mesa's llvmpipe ends all loops after 65,536 iterations).

@compute @workgroup_size(8, 8)
fn sources_main(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(local_invocation_index) invocation: u32,
) {
    slots_enter(workgroup.x, invocation);
    let pixel = tile_pixel(invocation);
    let seen = seen_triangle(pixel);
    if seen.x >= frames[frame_index].triangle_count {
        return;
    }
    let triangle = triangles[seen.x];
    let corners = triangle.xyz;
    let weights = seen_barycentrics(corners, pixel, seen.y);
    let point = surface_point(corners, triangle.w & 0xffffu, weights);
    var sum = vec3(0.0);
    if dot(point.normal, point.view) > 0.0 {
        let at = seen_point(pixel, seen.y);
        sum = sources_radiance(workgroup.z, point, floor(at) + 0.5 - at);
    }
    textureStore(source_radiance_found, pixel, workgroup.z, vec4(sum, 1.0));
}

// Radiance of one source from `point` towards the eye, which is above its horizon. `from_point` is the way to the
// pixel's centre, pixels.
fn sources_radiance(source: u32, point: SurfacePoint, from_point: vec2<f32>) -> vec3<f32> {
    let entry = (frame_index * frames[frame_index].source_count + source) * (1u + SOURCE_RIM + SOURCE_POINTS);
    let cone = source_points[entry];
    let rim = entry + 1u;
    let first = rim + SOURCE_RIM;
    var above = false;
    for (var i = rim; i < first + SOURCE_LEVELS.x; i++) {
        above = above || surface_to_local(point, source_points[i].direction).z > 0.0;
    }
    if !above {
        return vec3(0.0);
    }
    let wo = surface_to_local(point, point.view);
    var square = mat2x3<f32>();
    if frames[frame_index].source_squares != 0u {
        square = sources_square(point);
    }
    let radius = 0.5 * max(length(square[0] + square[1]), length(square[0] - square[1]));
    let origin = point.position + point.geometric_normal * source_points[first].ray_offset
        + square * from_point;
    let touched = occluders_meet_cone(origin, radius, cone.direction, cone.cone_cosine);
    var seen = false;
    var hidden = false;
    var level = 1u;
    var sum = vec3(0.0);
    // The first points, the rim unless it is known by them that there is an edge, and the rest where there is. One
    // place that rays are followed: copies of it are most of a shader.
    for (var step = 0u; step < SOURCE_RIM + SOURCE_POINTS; step++) {
        let on_rim = step >= SOURCE_LEVELS.x && step < SOURCE_LEVELS.x + SOURCE_RIM;
        let edge = seen && hidden;
        if step == SOURCE_LEVELS.x + SOURCE_RIM && !edge {
            level = u32(hidden);
            break;
        }
        let index = step - select(SOURCE_RIM, 0u, step < SOURCE_LEVELS.x);
        let entry = select(first + index, rim + step - SOURCE_LEVELS.x, on_rim);
        let direction = source_points[entry].direction;
        let wi = surface_to_local(point, direction);
        if wi.z > 0.0 && !(on_rim && edge) {
            let place = select(sources_place(index), vec2(0.0), on_rim);
            if sources_visible(point.geometric_normal, touched, origin, direction, square, place, from_point) {
                seen = true;
                if !on_rim {
                    sum += source_points[entry].light * (wi.z * models_evaluate(point.appearance, wi, wo));
                }
            } else {
                hidden = true;
            }
        }
    }
    return sum * source_scales[2u * source + level].xyz;
}

// Whether a source is visible from a place of a pixel, whose centre is at `origin`, on a triangle of the normal `face`:
// not if that itself is in the way, nor if anything is, where the cone about the source is `touched`.
fn sources_visible(
    face: vec3<f32>,
    touched: bool,
    origin: vec3<f32>,
    direction: vec3<f32>,
    square: mat2x3<f32>,
    place: vec2<f32>,
    from_point: vec2<f32>,
) -> bool {
    if dot(face, direction) <= 0.0 {
        return false;
    }
    if !touched {
        return true;
    }
    let nearest = SOURCE_OWN * length(square * (place + from_point));
    return !occluders_block(origin + square * place, direction, nearest);
}

// Where in a pixel the ray to a point starts, from its centre, in columns and rows.
fn sources_place(index: u32) -> vec2<f32> {
    return vec2<f32>(((index * SOURCE_STEP) >> vec2(8u)) ^ vec2(1u << 23u)) / 16777216.0 - 0.5;
}

// The sides of the square that a pixel covers on the plane of a surface.
fn sources_square(point: SurfacePoint) -> mat2x3<f32> {
    let steps = camera_steps(point.geometric_normal, point.position);
    let facing = camera_steps(point.view, point.position);
    let longest = SOURCE_LONGEST_SIDE * max(length(facing[0]), length(facing[1]));
    return mat2x3<f32>(
        steps[0] * min(longest / max(length(steps[0]), 1e-20), 1.0),
        steps[1] * min(longest / max(length(steps[1]), 1e-20), 1.0),
    );
}
