// Twin of sources/seen.rs, and the entry points that find which points of one source (z) a pixel sees: one
// invocation for all would walk further through the scene than software GPUs let a shader loop
// (Mesa's llvmpipe ends all loops after 65,536 iterations). They run after the first reflection is found, which tells
// how the surface stands; sources_shown.wgsl makes light of the points. In one kernel, rays and reflections take more
// registers than 20 warps of an Ampere have.

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

// Whether a pixel of the tile shows anything to find them for. It is of the coarse grid if `is_coarse`; else those have
// been found, and lie in source_seen.
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
    sources_points(source, asks, pixel, seen.y, triangles[seen.x].xyz);
    return true;
}

// Where the pixel's own number and row are, so that no register keeps them through all that comes before.
fn sources_write_own() {
    let own = sources_seen[sources_word(SOURCES_PIXEL)];
    sources_write(own >> 6u, own % 64u, 64u);
}

fn sources_write(row: u32, place: u32, places: u32) {
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
        textureStore(source_seen_found, sources_seen_place(row, texel, place, places), words);
    }
}

// What source_seen has of the invocation's pixel: in registers it would be kept through all that comes before and
// after.
var<workgroup> sources_seen: array<u32, 64u * 4u * SOURCE_SEEN_TEXELS>;
// Its last word, which holds nothing else, is the pixel's number in the tile and, behind those six bits, the source's
// row in source_seen.
const SOURCES_PIXEL: u32 = 4u * SOURCE_SEEN_TEXELS - 1u;
// The one before: points that rays will be sent to, where pixels take from others.
const SOURCES_ASKED: u32 = 4u * SOURCE_SEEN_TEXELS - 2u;
// And those that no other pixel sees, where later is what an app's shadow map takes away.
const SOURCES_NONE: u32 = 1u + SOURCE_GROUPS;
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

// Finds them, from a pixel's point on a triangle, which takes from others if it `asks`.
fn sources_points(source: u32, asks: bool, pixel: vec2<u32>, seen_at: u32, corners: vec3<u32>) {
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
        sources_starts[sources_own] = vec4(origin, from_point.x);
        sources_starts[64u + sources_own] = vec4(face, from_point.y);
        sources_sides = square;
        sources_steps(entry, asks);
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

// What is done, one after the other. First what is in the way of the whole source. For pixels that take from others: rays
// to what those do not agree on, and some to what they agree on, group by group. For others, and where those were
// contradicted: whether any of the source is seen, then points, group by group.
const SOURCES_TRY: u32 = 1u;
const SOURCES_PROBE: u32 = SOURCES_TRY + SOURCE_GROUPS;
const SOURCES_POINTS: u32 = SOURCES_PROBE + 1u;
const SOURCES_END: u32 = SOURCES_POINTS + SOURCE_GROUPS;

// The group that a step is about.
fn sources_group(step: u32) -> u32 {
    return (step - select(SOURCES_TRY, SOURCES_POINTS, step >= SOURCES_POINTS)) % SOURCE_GROUPS;
}

// Readies a step: what the pixels about this one all see of its group, and none, goes where that is kept, and for which
// points there will be rays. Done before cones are followed, it would take more registers.
fn sources_ask(all: u32, step: u32) {
    let group = sources_group(step);
    var near = vec2(0u, all);
    if step < SOURCES_PROBE {
        near = sources_between(all, group);
    }
    var asked = (near.y & ~near.x) | sources_tried(near.x) | sources_tried(all & ~near.y);
    if near.x == all {
        asked = all & (SOURCE_QUARTER << sources_turn(4u));
    }
    sources_seen[sources_word(SOURCES_NONE)] = all & ~near.y;
    sources_seen[sources_word(SOURCES_ASKED)] = asked;
    if step < SOURCES_END {
        sources_seen[sources_word(1u + group)] = near.x;
    }
}

// One place that cones and rays are followed: copies of it are most of a shader.
fn sources_steps(entry: u32, asks: bool) {
    let of_group = sources_of_group(entry);
    let all = 0xffffffffu >> (32u - of_group);
    // The first node that has anything in the way.
    var first = 0u;
    // Groups whose first place is seen.
    var probed = 0u;
    var step = 0u;
    while step < SOURCES_END {
        let group = sources_group(step);
        // Of the whole source; of a group that all pixels about this one see; and of one of which a first ray, that was
        // not blocked, has not told enough.
        var by_cone = step == 0u || (step >= SOURCES_POINTS && (probed & (1u << group)) != 0u);
        if step < SOURCES_PROBE {
            by_cone = by_cone || sources_seen[sources_word(1u + group)] == all;
        }
        var met = first;
        let cone = entry + select(SOURCE_FIRST_GROUP + group, 0u, step == 0u);
        if by_cone {
            let across = max(length(sources_sides[0] + sources_sides[1]), length(sources_sides[0] - sources_sides[1]));
            met = occluders_meet_cone(
                first,
                sources_start(0u).xyz,
                0.5 * across,
                sources_start(1u).xyz,
                source_points[cone].direction,
                source_points[cone].cone_cosine,
            );
        }
        let is_clear = met == OCCLUDERS_NONE && sources_cone_above(cone, sources_start(1u).xyz);
        var next = step + 1u;
        if step == 0u {
            first = met;
            next = select(SOURCES_PROBE, SOURCES_TRY, asks);
            if met == OCCLUDERS_NONE {
                next = SOURCES_POINTS;
            }
            if is_clear {
                sources_seen[sources_word(0u)] = SOURCE_ALL_GROUPS;
                break;
            }
        } else {
            var asked = all;
            if step < SOURCES_PROBE {
                asked = sources_seen[sources_word(SOURCES_ASKED)];
            }
            if step == SOURCES_PROBE {
                asked = sources_probes(of_group);
            }
            if is_clear {
                asked = 0u;
            }
            let found = sources_rays(entry, step, group, asked, met);
            if step == SOURCES_PROBE {
                probed = found.x;
                if probed == 0u {
                    break;
                }
            } else {
                let agreed = sources_seen[sources_word(1u + group)];
                let bits = agreed | found.x;
                var whole = bits == all;
                if step >= SOURCES_POINTS {
                    whole = asked == 0u || (bits != 0u && found.y == 0u);
                }
                let wrong = (found.x & sources_seen[sources_word(SOURCES_NONE)]) | (found.y & agreed);
                sources_seen[sources_word(1u + group)] = bits;
                sources_seen[sources_word(0u)] |= select(select(0u, 1u << SOURCE_GROUPS, bits != 0u), 1u, whole) << group;
                if step < SOURCES_PROBE {
                    if wrong != 0u {
                        // All that was told so far is told again.
                        sources_seen[sources_word(0u)] = 0u;
                        next = SOURCES_PROBE;
                    } else if next == SOURCES_PROBE {
                        break;
                    }
                }
            }
        }
        step = next;
        if asks {
            sources_ask(all, step);
        }
    }
}

// The points of a group that the pixels about one all see, and those that any does.
fn sources_between(all: u32, group: u32) -> vec2<u32> {
    let row = sources_seen[sources_word(SOURCES_PIXEL)] >> 6u;
    var found = vec2(all, 0u);
    // Four, which compilers do not know: they would do all at once, in registers of their own.
    for (var index = 0u; index < min(4u, all); index++) {
        // One that has no weight is one of the others.
        let pixel = parents_of(sources_seen[sources_word(SOURCES_PIXEL)] % 64u, index).pixel;
        let told = sources_coarse_word(row, 0u, pixel) >> group;
        var bits = select(0u, all, (told & 1u) != 0u);
        if ((told >> SOURCE_GROUPS) & 1u) != 0u {
            bits = sources_coarse_word(row, 1u + group, pixel);
        }
        found = vec2(found.x & bits, found.y | bits);
    }
    return found;
}

// One of the bits, another one at every pixel.
fn sources_tried(bits: u32) -> u32 {
    let above = bits & (0xffffffffu << sources_turn(32u));
    let turned = select(bits, above, above != 0u);
    return turned & (~turned + 1u);
}

// Of so many turns, which are a power of two, the pixel's.
fn sources_turn(turns: u32) -> u32 {
    return (SOURCE_TURN * sources_seen[sources_word(SOURCES_PIXEL)]) % turns;
}

// Rays to the points of a group, or to what tells whether anything of a source is visible, for which there is a bit in
// `asked`: which are seen, and which are hidden.
fn sources_rays(
    entry: u32,
    step: u32,
    group: u32,
    asked: u32,
    first: u32,
) -> vec2<u32> {
    let start = SOURCE_FIRST_POINT + group * sources_of_group(entry);
    var found = vec2(0u);
    var bits = asked;
    while bits != 0u {
        let bit = firstTrailingBit(bits);
        bits &= bits - 1u;
        // The entry, and the number of its place in the pixel.
        var at = vec2(start + bit, bit * SOURCE_GROUPS + group);
        if step == SOURCES_PROBE {
            at = sources_probe(bit);
            if bit >= SOURCE_GROUPS && found.x != 0u {
                break;
            }
        }
        let direction = source_points[entry + at.x].direction;
        if dot(direction, slots_reflection_value(SLOTS_NORMAL).xyz) > 0.0 {
            let is_rim = step == SOURCES_PROBE && bit >= 2u * SOURCE_GROUPS;
            let offset = select(sources_place(at.y), vec2(0.0), is_rim);
            let visible = sources_visible(first, direction, offset);
            found |= select(vec2(0u, 1u), vec2(1u, 0u), visible) << vec2(bit);
        }
    }
    return found;
}

// Whether all of a cone is above the plane of a triangle.
fn sources_cone_above(cone: u32, face: vec3<f32>) -> bool {
    let along = dot(face, source_points[cone].direction);
    let cosine = source_points[cone].cone_cosine;
    return along > 0.0 && along * along + cosine * cosine > 1.0;
}

// How many rays tell whether anything of a source is visible, as bits.
fn sources_probes(of_group: u32) -> u32 {
    return 0xffffffffu >> (32u - 2u * SOURCE_GROUPS - select(0u, SOURCE_RIM, of_group >= SOURCE_PLACES));
}

// What tells whether anything of a source is visible: the first place of each group, and where all of those are
// hidden, a second one and, of a source of many points, the rim.
fn sources_probe(step: u32) -> vec2<u32> {
    if step >= 2u * SOURCE_GROUPS {
        return vec2(SOURCE_FIRST_RIM + step - 2u * SOURCE_GROUPS, 0u);
    }
    let group = step % SOURCE_GROUPS;
    let of_group = step / SOURCE_GROUPS * SOURCE_SECOND_PLACE;
    return vec2(SOURCE_FIRST_PLACE + group * SOURCE_PLACES + of_group, of_group * SOURCE_GROUPS + group);
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
