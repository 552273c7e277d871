// Twin of sources/seen.rs, and the entry points that find which points of one source (z) a pixel sees: one
// invocation for all would walk further through the scene than software GPUs let a shader loop
// (Mesa's llvmpipe ends all loops after 65,536 iterations). They run after the first reflection is found, which tells
// how the surface stands; sources_shown.wgsl makes light of the points. In one kernel, rays and reflections take more
// registers than 20 warps of an Ampere have.
//
// What takes many rays waits for sources_many.wgsl, where rays of one pixel are followed side by side: an invocation that
// follows them one after the other keeps all beside it waiting, and the frame.

@group(2) @binding(3) var<storage, read_write> source_queue: SourceQueue;

// First the coarse grid of pixels, which take nothing from others, of a tile and four sources.
@compute @workgroup_size(8, 8)
fn sources_coarse_main(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(local_invocation_index) invocation: u32,
) {
    let place = invocation % PARENTS_COUNT;
    let pixel = parents_pixel(place);
    slots_enter(workgroup.x, pixel);
    sources_own = invocation;
    let source = 64u / PARENTS_COUNT * workgroup.z + invocation / PARENTS_COUNT;
    if source < frames[frame_index].source_count && sources_find(workgroup.x, source, pixel, true) {
        sources_write(sources_seen_row(workgroup.x, source), place, PARENTS_COUNT);
    }
}

// Then all.
@compute @workgroup_size(8, 8)
fn sources_main(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(local_invocation_index) invocation: u32,
) {
    let pixel = sources_pixel(invocation);
    slots_enter(workgroup.x, pixel);
    sources_own = invocation;
    if sources_find(workgroup.x, workgroup.z, pixel, false) {
        sources_write_own();
    }
}

// The same where an app has a shadow map of its own.
@compute @workgroup_size(8, 8)
fn sources_shadowed_main(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(local_invocation_index) invocation: u32,
) {
    let pixel = sources_pixel(invocation);
    slots_enter(workgroup.x, pixel);
    sources_own = invocation;
    if sources_find(workgroup.x, workgroup.z, pixel, false) {
        if workgroup.z == shadow_map.source && sources_seen[sources_word(0u)] != 0u {
            let hidden = shadow_map_hidden(slots_reflection_value(SLOTS_POSITION).xyz);
            if hidden > 0.0 {
                sources_seen[sources_word(0u)] |= SOURCE_SHADOWED;
                sources_seen[sources_word(1u + SOURCE_GROUPS)] = bitcast<u32>(hidden);
            }
        }
        sources_write_own();
    }
}

// The pixel of an invocation: first those beside the coarse grid, so that invocations side by side all have rays to follow.
fn sources_pixel(invocation: u32) -> u32 {
    // Columns, or rows, that are not in the grid.
    let between = 2u * (invocation % 4u) + 1u - (invocation % 4u) / 2u;
    if invocation < PARENTS_COUNT {
        return parents_pixel(invocation) / PIXEL_SIDE * PIXEL_SIDE + between;
    }
    if invocation >= 3u * PARENTS_COUNT {
        return parents_pixel(invocation - 3u * PARENTS_COUNT);
    }
    let row = invocation / PIXEL_SIDE - 2u;
    return (2u * row + 1u - row / 2u) * PIXEL_SIDE + invocation % PIXEL_SIDE;
}

// Whether it is found here what a pixel of the tile sees: not if it shows nothing to find it for, nor if it waits. It is of
// the coarse grid if `is_coarse`; else those have been found, and lie in source_seen.
fn sources_find(workgroup: u32, source: u32, own: u32, is_coarse: bool) -> bool {
    let pixel = tile_pixel(own);
    let seen = seen_triangle(pixel);
    if seen.x >= frames[frame_index].triangle_count {
        return false;
    }
    for (var word = 0u; word < 4u * SOURCE_SEEN_TEXELS; word++) {
        sources_seen[sources_word(word)] = 0u;
    }
    let row = sources_seen_row(workgroup, source);
    sources_seen[sources_word(SOURCES_PIXEL)] = own | (row << 6u);
    if !is_coarse && parents_place(own) < PARENTS_COUNT {
        for (var word = 0u; word < 1u + SOURCE_GROUPS; word++) {
            sources_seen[sources_word(word)] = sources_coarse_word(row, word, own);
        }
        return true;
    }
    // Further surfaces of pixels that lie side by side do not so in the picture.
    let alone = is_coarse || tile_first.y >= frames[frame_index].first_extra_row;
    let asks = parents_may_ask(slot - own, own, alone);
    let entry = sources_entry(source);
    if !sources_start_at(entry, pixel, seen.y, triangles[seen.x].xyz) {
        return true;
    }
    let first = sources_steps(entry, asks);
    if first.x != SOURCES_FOUND {
        let waits = own | (source << SOURCES_SOURCE) | (first.x << SOURCES_ASKS) | (u32(is_coarse) << SOURCES_COARSE);
        let place = atomicAdd(&source_queue.waiting, 1u);
        source_queue.entries[place] = vec2(waits | (workgroup << SOURCES_TILE), first.y);
    }
    return first.x == SOURCES_FOUND;
}

// Where the pixel's own number and row are, so that no register keeps them through all that comes before.
fn sources_write_own() {
    let own = sources_seen[sources_word(SOURCES_PIXEL)];
    sources_write(own >> 6u, own % 64u, 64u);
}

fn sources_write(row: u32, place: u32, places: u32) {
    let count = sources_texels(sources_seen[sources_word(0u)]);
    for (var texel = 0u; texel < count; texel++) {
        let words = vec4(
            sources_seen[sources_word(4u * texel)],
            sources_seen[sources_word(4u * texel + 1u)],
            sources_seen[sources_word(4u * texel + 2u)],
            sources_seen[sources_word(4u * texel + 3u)],
        );
        textureStore(source_seen_found, sources_seen_place(row, texel, place, places), words);
    }
}

// How many texels are written: all where there are words behind the one about groups.
fn sources_texels(told: u32) -> u32 {
    let shadowed = SOURCE_SHADOWED >> SOURCE_GROUPS;
    let partly = (told >> SOURCE_GROUPS) & (((1u << SOURCE_GROUPS) - 1u) | shadowed);
    return select(1u, SOURCE_SEEN_TEXELS, partly != 0u);
}

// What source_seen has of the invocation's pixel: in registers it would be kept through all that comes before and
// after.
var<workgroup> sources_seen: array<u32, 64u * 4u * SOURCE_SEEN_TEXELS>;
// Its last word, which holds nothing else, is the pixel's number in the tile and, behind those six bits, the source's
// row in source_seen.
const SOURCES_PIXEL: u32 = 4u * SOURCE_SEEN_TEXELS - 1u;
// From where rays start, there for the same reason: the pixel's centre on the surface, and the triangle's normal; behind
// each a coordinate of the way there from where the surface was met, pixels.
var<workgroup> sources_starts: array<vec4<f32>, 128>;
// The sides of the square that the pixel covers.
var<private> sources_sides: mat2x3<f32>;
// The invocation's number in the workgroup.
var<private> sources_own: u32;

fn sources_start(part: u32) -> vec4<f32> {
    return sources_starts[64u * part + sources_own];
}

fn sources_word(word: u32) -> u32 {
    return 64u * word + sources_own;
}

// What was found of a pixel of the coarse grid; words of groups that are not seen in part are anything.
fn sources_coarse_word(row: u32, word: u32, pixel: u32) -> u32 {
    let place = sources_seen_place(row, word / 4u, parents_place(pixel), PARENTS_COUNT);
    return textureLoad(source_seen, place, 0)[word % 4u];
}

// Readies where rays start from a pixel's point on a triangle, unless none of the source is above it.
fn sources_start_at(entry: u32, pixel: vec2<u32>, seen_at: u32, corners: vec3<u32>) -> bool {
    let normal = slots_reflection_value(SLOTS_NORMAL).xyz;
    let position = slots_reflection_value(SLOTS_POSITION).xyz;
    let view = surface_unit_or(frames[frame_index].eye - position * frames[frame_index].perspective, normal);
    if dot(normal, view) <= 0.0 || !sources_above(entry, normal) {
        return false;
    }
    let face = surface_geometric_normal(corners);
    let at = seen_point(pixel, seen_at);
    let from_point = floor(at) + 0.5 - at;
    var square = mat2x3<f32>();
    if frames[frame_index].source_squares != 0u {
        square = sources_square(face, position, view);
    }
    let offset = source_points[entry].ray_offset;
    let origin = position + face * offset + square * from_point;
    sources_starts[sources_own] = vec4(origin, from_point.x);
    sources_starts[64u + sources_own] = vec4(face, from_point.y);
    sources_sides = square;
    return true;
}

// Whether anything of a source is above the horizon.
fn sources_above(entry: u32, normal: vec3<f32>) -> bool {
    var above = false;
    for (var i = entry + SOURCE_FIRST_RIM; i < entry + SOURCE_FIRST_POINT && !above; i++) {
        above = dot(source_points[i].direction, normal) > 0.0;
    }
    return above;
}

// Nothing waits, see sources_steps.
const SOURCES_FOUND: u32 = 2u;

// More rays than this wait.
const SOURCES_MOST: u32 = 16u;

// The points of a group that rays go to, where the pixels about one all see those of near.x and any those of near.y: of a
// group that all see whole, a quarter; else what they do not agree on, and one of each that they agree on.
fn sources_asked(all: u32, near: vec2<u32>, pixel: u32) -> u32 {
    if near.x == all {
        return all & (SOURCE_QUARTER << sources_turn(pixel, 4u));
    }
    return (near.y & ~near.x) | sources_tried(near.x, pixel) | sources_tried(all & ~near.y, pixel);
}

// SOURCES_FOUND, if the invocation's pixel sees nothing in the way of the source, or takes from the pixels about it, and
// rays do not contradict those. Else what the rest takes, which waits: whether it takes from those, and the first node
// that has anything in the way.
fn sources_steps(entry: u32, asks: bool) -> vec2<u32> {
    let all = 0xffffffffu >> (32u - sources_of_group(entry));
    var first = 0u;
    // The whole source, then its groups: one place that cones and rays are followed, as copies of it are most of a shader.
    for (var step = 0u; step <= SOURCE_GROUPS; step++) {
        let group = step - 1u;
        let pixel = sources_seen[sources_word(SOURCES_PIXEL)];
        var met = first;
        if step == 0u || sources_seen[sources_word(step)] == all {
            met = sources_meet(entry + select(SOURCE_FIRST_GROUP + group, 0u, step == 0u), first);
        }
        if step == 0u {
            first = met;
            if met == OCCLUDERS_NONE && sources_cone_above(entry, sources_start(1u).xyz) {
                sources_seen[sources_word(0u)] = SOURCE_ALL_GROUPS;
                return vec2(SOURCES_FOUND, 0u);
            }
            if !asks || met == OCCLUDERS_NONE {
                return vec2(0u, met);
            }
            var count = 0u;
            for (var next = 0u; next < SOURCE_GROUPS; next++) {
                let near = sources_between(all, next, pixel);
                sources_seen[sources_word(1u + next)] = near.x;
                count += countOneBits(sources_asked(all, near, pixel));
            }
            if count > SOURCES_MOST {
                return vec2(1u, met);
            }
        } else if met != OCCLUDERS_NONE || !sources_cone_above(entry + SOURCE_FIRST_GROUP + group, sources_start(1u).xyz) {
            let near = sources_between(all, group, pixel);
            var bits = sources_asked(all, near, pixel);
            var found = vec2(0u);
            while bits != 0u {
                let bit = firstTrailingBit(bits);
                bits &= bits - 1u;
                let at = SOURCE_FIRST_POINT + group * sources_of_group(entry) + bit;
                found |= sources_look(entry + at, bit * SOURCE_GROUPS + group, met) << vec2(bit);
            }
            if ((found.x & ~near.y) | (found.y & near.x)) != 0u {
                // All that was told so far is told again.
                return vec2(0u, first);
            }
            bits = near.x | found.x;
            sources_seen[sources_word(step)] = bits;
            sources_seen[sources_word(0u)] |= sources_told(bits, bits == all) << group;
        } else {
            sources_seen[sources_word(0u)] |= 1u << group;
        }
    }
    return vec2(SOURCES_FOUND, 0u);
}

// What the word about groups tells of the first where those of its points are seen.
fn sources_told(bits: u32, whole: bool) -> u32 {
    return select(select(0u, 1u << SOURCE_GROUPS, bits != 0u), 1u, whole);
}

// The first node, from `first` on, that has anything in the way of a cone.
fn sources_meet(cone: u32, first: u32) -> u32 {
    let across = max(length(sources_sides[0] + sources_sides[1]), length(sources_sides[0] - sources_sides[1]));
    return occluders_meet_cone(
        first,
        sources_start(0u).xyz,
        0.5 * across,
        sources_start(1u).xyz,
        source_points[cone].direction,
        source_points[cone].cone_cosine,
    );
}

// The points of a group that the pixels about one all see, and those that any does. Pixels are as SOURCES_PIXEL has them.
fn sources_between(all: u32, group: u32, pixel: u32) -> vec2<u32> {
    var found = vec2(all, 0u);
    // Four, which compilers do not know: they would do all at once, in registers of their own.
    for (var index = 0u; index < min(4u, all); index++) {
        // One that has no weight is one of the others.
        let parent = parents_of(pixel % 64u, index).pixel;
        let told = sources_coarse_word(pixel >> 6u, 0u, parent) >> group;
        var bits = select(0u, all, (told & 1u) != 0u);
        if ((told >> SOURCE_GROUPS) & 1u) != 0u {
            bits = sources_coarse_word(pixel >> 6u, 1u + group, parent);
        }
        found = vec2(found.x & bits, found.y | bits);
    }
    return found;
}

// One of the bits, another one at every pixel.
fn sources_tried(bits: u32, pixel: u32) -> u32 {
    let above = bits & (0xffffffffu << sources_turn(pixel, 32u));
    let turned = select(bits, above, above != 0u);
    return turned & (~turned + 1u);
}

// Of so many turns, which are a power of two, the pixel's.
fn sources_turn(pixel: u32, turns: u32) -> u32 {
    return (SOURCE_TURN * pixel) % turns;
}

// A ray to an entry, from the place of the pixel that has the number `place`: a bit if it is seen, and one if it is hidden;
// none below the horizon.
fn sources_look(entry: u32, place: u32, first: u32) -> vec2<u32> {
    return sources_look_from(entry, sources_place(place), first);
}

fn sources_look_from(entry: u32, place: vec2<f32>, first: u32) -> vec2<u32> {
    let direction = source_points[entry].direction;
    if dot(direction, slots_reflection_value(SLOTS_NORMAL).xyz) <= 0.0 {
        return vec2(0u);
    }
    let visible = sources_visible(first, direction, place);
    return select(vec2(0u, 1u), vec2(1u, 0u), visible);
}

// Whether all of a cone is above the plane of a triangle.
fn sources_cone_above(cone: u32, face: vec3<f32>) -> bool {
    let along = dot(face, source_points[cone].direction);
    let cosine = source_points[cone].cone_cosine;
    return along > 0.0 && along * along + cosine * cosine > 1.0;
}

// Whether a source is visible from a place of the pixel: not if its triangle is in the way, nor if anything is, in the
// node `first` or behind it.
fn sources_visible(first: u32, direction: vec3<f32>, place: vec2<f32>) -> bool {
    if dot(sources_start(1u).xyz, direction) <= 0.0 {
        return false;
    }
    if first == OCCLUDERS_NONE {
        return true;
    }
    let from_point = vec2(sources_start(0u).w, sources_start(1u).w);
    let nearest = SOURCE_OWN * length(sources_sides * (place + from_point));
    return !occluders_block(first, sources_start(0u).xyz + sources_sides * place, direction, nearest);
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
