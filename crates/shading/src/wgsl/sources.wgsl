// Twin of sources.rs, and the entry point that finds which points of one source (z) a pixel sees: one
// invocation for all would walk further through the scene than software GPUs let a shader loop
// (Mesa's llvmpipe ends all loops after 65,536 iterations). It runs after the first reflection is found, which tells
// how the surface stands; sources_shown.wgsl makes light of the points. In one kernel, rays and reflections take more
// registers than 20 warps of an Ampere have.

@compute @workgroup_size(8, 8)
fn sources_main(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(local_invocation_index) invocation: u32,
) {
    slots_enter(workgroup.x, invocation);
    sources_own = invocation;
    let pixel = tile_pixel(invocation);
    let seen = seen_triangle(pixel);
    if seen.x >= frames[frame_index].triangle_count {
        return;
    }
    for (var word = 0u; word < 4u * SOURCE_SEEN_TEXELS; word++) {
        sources_seen[sources_word(word)] = 0u;
    }
    sources_points(workgroup.z, pixel, seen.y, triangles[seen.x].xyz);
    let row = sources_seen_row(workgroup.x, workgroup.z);
    let count = select(1u, SOURCE_SEEN_TEXELS, (sources_seen[sources_word(0u)] & 1u) != 0u);
    for (var texel = 0u; texel < count; texel++) {
        let words = vec4(
            sources_seen[sources_word(4u * texel)],
            sources_seen[sources_word(4u * texel + 1u)],
            sources_seen[sources_word(4u * texel + 2u)],
            sources_seen[sources_word(4u * texel + 3u)],
        );
        textureStore(source_seen_found, sources_seen_place(row, texel, invocation), words);
    }
}

// What source_seen has of the invocation's pixel: in registers it would be kept through all that comes before and
// after.
var<workgroup> sources_seen: array<u32, 64u * 4u * SOURCE_SEEN_TEXELS>;
var<private> sources_own: u32;

fn sources_word(word: u32) -> u32 {
    return 64u * word + sources_own;
}

// Finds them, from a pixel's point on a triangle.
fn sources_points(source: u32, pixel: vec2<u32>, seen_at: u32, corners: vec3<u32>) {
    let normal = slots_reflection_value(SLOTS_NORMAL).xyz;
    let position = slots_reflection_value(SLOTS_POSITION).xyz;
    let view = surface_unit_or(frames[frame_index].eye - position * frames[frame_index].perspective, normal);
    let face = surface_geometric_normal(corners);
    let entry = sources_entry(source);
    if dot(normal, view) > 0.0 && sources_above(entry + 1u, normal) {
        let at = seen_point(pixel, seen_at);
        let from_point = floor(at) + 0.5 - at;
        var square = mat2x3<f32>();
        if frames[frame_index].source_squares != 0u {
            square = sources_square(face, position, view);
        }
        let radius = 0.5 * max(length(square[0] + square[1]), length(square[0] - square[1]));
        let offset = source_points[entry + 1u + SOURCE_RIM].ray_offset;
        let origin = position + face * offset + square * from_point;
        let touched = occluders_meet_cone(origin, radius, source_points[entry].direction, source_points[entry].cone_cosine);
        sources_rays(entry + 1u, normal, face, touched, origin, square, from_point);
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
                sources_seen[sources_word(1u + index / 32u)] |= 1u << (index % 32u);
                sources_seen[sources_word(0u)] |= 2u;
            }
        }
        if step + 1u == SOURCE_LEVELS.x + SOURCE_RIM {
            sources_seen[sources_word(0u)] |= found / 2u;
            count = select(count, SOURCE_RIM + SOURCE_POINTS, found == 3u);
        }
    }
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

// The sides of the square that a pixel covers on the plane of a surface of the normal `face`.
fn sources_square(face: vec3<f32>, position: vec3<f32>, view: vec3<f32>) -> mat2x3<f32> {
    let steps = camera_steps(face, position);
    let facing = camera_steps(view, position);
    let longest = SOURCE_LONGEST_SIDE * max(length(facing[0]), length(facing[1]));
    return mat2x3<f32>(
        steps[0] * min(longest / max(length(steps[0]), 1e-20), 1.0),
        steps[1] * min(longest / max(length(steps[1]), 1e-20), 1.0),
    );
}
