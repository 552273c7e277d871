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
    if sources_find(workgroup, invocation) {
        sources_write(workgroup, invocation);
    }
}

// The same where an app has a shadow map of its own.
@compute @workgroup_size(8, 8)
fn sources_shadowed_main(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(local_invocation_index) invocation: u32,
) {
    if sources_find(workgroup, invocation) {
        if workgroup.z == shadow_map.source && sources_seen[sources_word(0u)] != 0u {
            let hidden = shadow_map_hidden(slots_reflection_value(SLOTS_POSITION).xyz);
            if hidden > 0.0 {
                sources_seen[sources_word(0u)] |= SOURCE_SHADOWED;
                sources_seen[sources_word(1u + SOURCE_GROUPS)] = bitcast<u32>(hidden);
            }
        }
        sources_write(workgroup, invocation);
    }
}

// Whether there is anything to find them for.
fn sources_find(workgroup: vec3<u32>, invocation: u32) -> bool {
    slots_enter(workgroup.x, invocation);
    sources_own = invocation;
    let pixel = tile_pixel(invocation);
    let seen = seen_triangle(pixel);
    if seen.x >= frames[frame_index].triangle_count {
        return false;
    }
    for (var word = 0u; word < 4u * SOURCE_SEEN_TEXELS; word++) {
        sources_seen[sources_word(word)] = 0u;
    }
    sources_points(workgroup.z, pixel, seen.y, triangles[seen.x].xyz);
    return true;
}

fn sources_write(workgroup: vec3<u32>, invocation: u32) {
    let row = sources_seen_row(workgroup.x, workgroup.z);
    let shadowed = SOURCE_SHADOWED >> SOURCE_GROUPS;
    let partly = (sources_seen[sources_word(0u)] >> SOURCE_GROUPS) & (((1u << SOURCE_GROUPS) - 1u) | shadowed);
    let count = select(1u, SOURCE_SEEN_TEXELS, partly != 0u);
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
    if dot(normal, view) > 0.0 && sources_above(entry, normal) {
        let at = seen_point(pixel, seen_at);
        let from_point = floor(at) + 0.5 - at;
        var square = mat2x3<f32>();
        if frames[frame_index].source_squares != 0u {
            square = sources_square(face, position, view);
        }
        let offset = source_points[entry].ray_offset;
        let origin = position + face * offset + square * from_point;
        sources_parts(entry, normal, face, origin, square, from_point);
    }
}

// Whether anything of a source is above the horizon.
fn sources_above(entry: u32, normal: vec3<f32>) -> bool {
    var above = false;
    for (var i = entry + SOURCE_FIRST_RIM; i < entry + SOURCE_FIRST_POINT && !above; i++) {
        above = dot(source_points[i].direction, normal) > 0.0;
    }
    return above;
}

// The source by itself, then its groups. One place that cones and rays are followed: copies of it are most of a
// shader.
fn sources_parts(
    entry: u32,
    normal: vec3<f32>,
    face: vec3<f32>,
    origin: vec3<f32>,
    square: mat2x3<f32>,
    from_point: vec2<f32>,
) {
    let radius = 0.5 * max(length(square[0] + square[1]), length(square[0] - square[1]));
    var in_the_way = true;
    var told = 0u;
    for (var part = 0u; part <= SOURCE_GROUPS; part++) {
        // A first ray that was blocked has told.
        let first_seen = part == 0u || (sources_seen[sources_word(part)] & 1u) != 0u;
        var met = in_the_way;
        if met && first_seen {
            let cone = source_points[entry + part];
            met = occluders_meet_cone(origin, radius, face, cone.direction, cone.cone_cosine);
        }
        if part == 0u && !met {
            in_the_way = false;
            continue;
        }
        var found = vec2(1u, 0u);
        if met || !sources_cone_above(entry + part, face) {
            found = sources_rays(entry, part, met, normal, face, origin, square, from_point);
        }
        if part == 0u {
            if (found.x & 1u) == 0u {
                break;
            }
        } else if found.x == 1u {
            told |= 1u << (part - 1u);
        } else if found.y != 0u {
            told |= 1u << (SOURCE_GROUPS + part - 1u);
            sources_seen[sources_word(part)] = found.y;
        }
    }
    let finer = u32(source_points[entry].light.x) > SOURCE_PLACES;
    told |= select(0u, ((1u << SOURCE_GROUPS) - 1u) << (2u * SOURCE_GROUPS), finer && told != 0u);
    sources_seen[sources_word(0u)] = told;
}

// Whether all of a cone is above the plane of a triangle.
fn sources_cone_above(cone: u32, face: vec3<f32>) -> bool {
    let along = dot(face, source_points[cone].direction);
    let cosine = source_points[cone].cone_cosine;
    return along > 0.0 && along * along + cosine * cosine > 1.0;
}

// Rays to a source, or to one of its groups: whether any of it was seen (the lowest bit), and any hidden (the next);
// and which places or points of a group were seen.
fn sources_rays(
    entry: u32,
    part: u32,
    met: bool,
    normal: vec3<f32>,
    face: vec3<f32>,
    origin: vec3<f32>,
    square: mat2x3<f32>,
    from_point: vec2<f32>,
) -> vec2<u32> {
    var steps = u32(source_points[entry].light.x);
    let first = select(SOURCE_FIRST_PLACE, SOURCE_FIRST_POINT, steps > SOURCE_PLACES) + (part - 1u) * steps;
    if part == 0u {
        steps = 2u * SOURCE_GROUPS + SOURCE_RIM;
    }
    var found = vec2(0u);
    for (var step = 0u; step < steps; step++) {
        if part == 0u && step >= SOURCE_GROUPS && (found.x & 1u) != 0u {
            break;
        }
        // The entry, and the number of its place in the pixel.
        var at = vec2(first + step, step * SOURCE_GROUPS + part - 1u);
        let is_rim = part == 0u && step >= 2u * SOURCE_GROUPS;
        if part == 0u {
            at = sources_probe(step);
        }
        let direction = source_points[entry + at.x].direction;
        if dot(direction, normal) > 0.0 {
            let offset = select(sources_place(at.y), vec2(0.0), is_rim);
            let visible = sources_visible(face, met, origin, direction, square, offset, from_point);
            found |= select(vec2(2u, 0u), vec2(1u, 1u << (step % 32u)), visible);
            if part == 0u && step < SOURCE_GROUPS {
                sources_seen[sources_word(1u + step)] = u32(visible);
            }
        }
    }
    return found;
}

// What tells whether anything of a source is visible: the first place of each group, and where all of those are
// hidden, a second one and the rim.
fn sources_probe(step: u32) -> vec2<u32> {
    if step >= 2u * SOURCE_GROUPS {
        return vec2(SOURCE_FIRST_RIM + step - 2u * SOURCE_GROUPS, 0u);
    }
    let group = step % SOURCE_GROUPS;
    let of_group = step / SOURCE_GROUPS * SOURCE_SECOND_PLACE;
    return vec2(SOURCE_FIRST_PLACE + group * SOURCE_PLACES + of_group, of_group * SOURCE_GROUPS + group);
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
