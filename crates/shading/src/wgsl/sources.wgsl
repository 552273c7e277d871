// Twin of sources.rs, and the entry point that finds what one source (z) adds to a pixel: one
// invocation for all would walk further through the scene than software GPUs let a shader loop
// (Mesa's llvmpipe ends all loops after 65,536 iterations).

@compute @workgroup_size(8, 8)
fn sources_main(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(local_invocation_index) invocation: u32,
) {
    slots_enter_again(workgroup.x, invocation);
    let pixel = tile_pixel(invocation);
    let seen = seen_triangle(pixel);
    if seen.x >= frames[frame_index].triangle_count {
        return;
    }
    let triangle = triangles[seen.x];
    let weights = seen_barycentrics(triangle.xyz, pixel, seen.y);
    sources_points(workgroup.z, pixel, seen.y, triangle.xyz, triangle.w & 0xffffu, weights);
    textureStore(source_radiance_found, pixel, workgroup.z, vec4(sources_reflected(workgroup.z, weights), 1.0));
}

// Points of the source that the invocation's pixel sees, a bit each, then whether they are of the second level, and
// in the second bit whether there are any: in
// registers they would be kept through all that comes before and after.
var<workgroup> sources_seen: array<u32, 64u * (SOURCE_POINTS / 32u + 1u)>;

fn sources_word(word: u32) -> u32 {
    return 64u * word + slots_own;
}

// The first of the source's entries.
fn sources_entry(source: u32) -> u32 {
    return (frame_index * frames[frame_index].source_count + source) * (1u + SOURCE_RIM + SOURCE_POINTS);
}

// Finds them, from a pixel's point on a triangle.
fn sources_points(
    source: u32,
    pixel: vec2<u32>,
    seen_at: u32,
    corners: vec3<u32>,
    material: u32,
    weights: vec3<f32>,
) {
    for (var word = 0u; word <= SOURCE_POINTS / 32u; word++) {
        sources_seen[sources_word(word)] = 0u;
    }
    let shape = surface_shape(corners, material, weights);
    let entry = sources_entry(source);
    if dot(shape.normal, shape.view) > 0.0 && sources_above(entry + 1u, shape.normal) {
        let at = seen_point(pixel, seen_at);
        let from_point = floor(at) + 0.5 - at;
        var square = mat2x3<f32>();
        if frames[frame_index].source_squares != 0u {
            square = sources_square(shape);
        }
        let radius = 0.5 * max(length(square[0] + square[1]), length(square[0] - square[1]));
        let offset = source_points[entry + 1u + SOURCE_RIM].ray_offset;
        let origin = shape.position + shape.geometric_normal * offset + square * from_point;
        let touched = occluders_meet_cone(origin, radius, source_points[entry].direction, source_points[entry].cone_cosine);
        sources_rays(entry + 1u, shape.normal, shape.geometric_normal, touched, origin, square, from_point);
    }
}

// Whether anything of a source, whose rim begins there, is above the horizon.
fn sources_above(rim: u32, normal: vec3<f32>) -> bool {
    var above = false;
    for (var i = rim; i < rim + SOURCE_RIM + SOURCE_LEVELS.x && !above; i++) {
        above = dot(source_points[i].direction, normal) > 0.0;
    }
    return above;
}

// The first points, the rim unless it is known by them that there is an edge, and the rest where there is. One
// place that rays are followed: copies of it are most of a shader.
fn sources_rays(
    rim: u32,
    normal: vec3<f32>,
    face: vec3<f32>,
    touched: bool,
    origin: vec3<f32>,
    square: mat2x3<f32>,
    from_point: vec2<f32>,
) {
    // Bits: seen, hidden.
    var found = 0u;
    var count = SOURCE_LEVELS.x + SOURCE_RIM;
    for (var step = 0u; step < count; step++) {
        let on_rim = step >= SOURCE_LEVELS.x && step < SOURCE_LEVELS.x + SOURCE_RIM;
        let index = step - select(SOURCE_RIM, 0u, step < SOURCE_LEVELS.x);
        // The rim comes before the points.
        let direction = source_points[rim + select(SOURCE_RIM + index, step - SOURCE_LEVELS.x, on_rim)].direction;
        if dot(direction, normal) > 0.0 && !(on_rim && found == 3u) {
            let offset = select(sources_place(index), vec2(0.0), on_rim);
            let visible = sources_visible(face, touched, origin, direction, square, offset, from_point);
            found |= select(2u, 1u, visible);
            if visible && !on_rim {
                sources_seen[sources_word(index / 32u)] |= 1u << (index % 32u);
                sources_seen[sources_word(SOURCE_POINTS / 32u)] |= 2u;
            }
        }
        if step + 1u == SOURCE_LEVELS.x + SOURCE_RIM {
            sources_seen[sources_word(SOURCE_POINTS / 32u)] |= found / 2u;
            count = select(count, SOURCE_RIM + SOURCE_POINTS, found == 3u);
        }
    }
}

// Radiance by these points towards the eye.
fn sources_reflected(source: u32, weights: vec3<f32>) -> vec3<f32> {
    let level = sources_seen[sources_word(SOURCE_POINTS / 32u)];
    if level == 0u {
        return vec3(0.0);
    }
    // What the surface is, found again: rays and reflections at once take more registers than there are.
    slots_again();
    let triangle = triangles[seen_known(tile_pixel(slot % 64u)).x];
    let point = surface_point(triangle.xyz, triangle.w & 0xffffu, weights, 0u);
    let wo = surface_to_local(point, point.view);
    var sum = vec3(0.0);
    for (var k = 0u; k < max(point.appearance.reflections, 1u); k++) {
        var reflection = point.appearance.found;
        if k > 0u {
            reflection = surface_reflection(point.appearance, k);
        }
        let diffuse = select(vec3(0.0), point.appearance.diffuse / PI, k == 0u);
        sum += sources_shown(sources_entry(source) + 1u + SOURCE_RIM, point, wo, diffuse, reflection);
    }
    return sum * source_scales[2u * source + (level & 1u)].xyz;
}

// What a Lambertian base, and a reflection, show of points.
fn sources_shown(
    first: u32,
    point: SurfacePoint,
    wo: vec3<f32>,
    diffuse: vec3<f32>,
    reflection: Reflection,
) -> vec3<f32> {
    var sum = vec3(0.0);
    var word = 0u;
    var bits = sources_seen[sources_word(0u)];
    while word < SOURCE_POINTS / 32u {
        if bits != 0u {
            let entry = first + 32u * word + firstTrailingBit(bits);
            bits &= bits - 1u;
            let wi = surface_to_local(point, source_points[entry].direction);
            let shown = diffuse + models_specular(reflection, wi, wo);
            sum += source_points[entry].light * (max(wi.z, 0.0) * shown);
        } else {
            word++;
            bits = sources_seen[sources_word(min(word, SOURCE_POINTS / 32u - 1u))];
        }
    }
    return sum;
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
fn sources_square(shape: SurfaceShape) -> mat2x3<f32> {
    let steps = camera_steps(shape.geometric_normal, shape.position);
    let facing = camera_steps(shape.view, shape.position);
    let longest = SOURCE_LONGEST_SIDE * max(length(facing[0]), length(facing[1]));
    return mat2x3<f32>(
        steps[0] * min(longest / max(length(steps[0]), 1e-20), 1.0),
        steps[1] * min(longest / max(length(steps[1]), 1e-20), 1.0),
    );
}
