// Twin of sources/seen.rs for what takes many rays: a pixel and a source for each workgroup, whose invocations are rays.
// Where the pixel takes from those about it, rays tell whether it may. Where it may not, or does not, some tell whether
// anything of the source is seen, and then there is one to every point.

// Of the coarse grid, then of all pixels; what they see is written into another image of its own.
@compute @workgroup_size(32)
fn sources_many_main(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) invocation: u32) {
    let waits = sources_many_enter(workgroup, invocation);
    sources_many_follow(waits.x != SOURCES_NOBODY, invocation);
    sources_many_write(waits, invocation, 0.0);
}

// The same where an app has a shadow map of its own.
@compute @workgroup_size(32)
fn sources_many_shadowed_main(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(local_invocation_index) invocation: u32,
) {
    let waits = sources_many_enter(workgroup, invocation);
    sources_many_follow(waits.x != SOURCES_NOBODY, invocation);
    var hidden = 0.0;
    if waits.x != SOURCES_NOBODY && sources_many_source(waits) == shadow_map.source && many_told() != 0u {
        hidden = shadow_map_hidden(slots_reflection_value(SLOTS_POSITION).xyz);
    }
    sources_many_write(waits, invocation, hidden);
}

// In place of an entry of the queue behind its end.
const SOURCES_NOBODY: u32 = 0xffffffffu;

// Steps: rays to what the pixels about this one do not agree on, and some to what they agree on; to what tells whether
// anything is seen; to all points.
const MANY_NEAR: u32 = 0u;
const MANY_PROBE: u32 = 1u;
const MANY_POINTS: u32 = 2u;

// By group, of the first step and of the last: points that rays go to, the first node that is in their way, and those that
// are seen and hidden.
var<workgroup> many_asked: array<u32, 2u * SOURCE_GROUPS>;
var<workgroup> many_first: array<u32, 2u * SOURCE_GROUPS>;
var<workgroup> many_seen: array<atomic<u32>, 2u * SOURCE_GROUPS>;
var<workgroup> many_hidden: array<atomic<u32>, 2u * SOURCE_GROUPS>;
// By group, the points that the pixels about this one all see, and those that any does.
var<workgroup> many_near: array<vec2<u32>, SOURCE_GROUPS>;
// A bit for each group of which the last step finds that nothing is in the way.
var<workgroup> many_clear: atomic<u32>;
// A bit for each ray of the second step that nothing is in the way of.
var<workgroup> many_probed: atomic<u32>;

// As SOURCES_PIXEL has it.
var<private> many_pixel: u32;
// The source's entries, and the first node that is in its way.
var<private> many_entry: u32;
var<private> many_met: u32;
// Whether the pixel takes from those about it; once it is known to be contradicted, it does not.
var<private> many_asks: bool;

// The workgroup's entry of the queue, and all that is known of it.
fn sources_many_enter(workgroup: vec3<u32>, invocation: u32) -> vec2<u32> {
    let index = workgroup.y * SOURCES_MANY_COLUMNS + workgroup.x;
    var waits = vec2(SOURCES_NOBODY, 0u);
    if index < source_queue.taken {
        waits = source_queue.entries[index];
        let source = sources_many_source(waits);
        let own = waits.x % 64u;
        slots_enter(waits.x >> SOURCES_TILE, own);
        sources_own = invocation;
        many_pixel = own | (sources_seen_row(waits.x >> SOURCES_TILE, source) << 6u);
        many_entry = sources_entry(source);
        many_met = waits.y;
        many_asks = extractBits(waits.x, SOURCES_ASKS, 1u) != 0u;
        let pixel = tile_pixel(own);
        let seen = seen_known(pixel);
        sources_start_at(many_entry, pixel, seen.y, triangles[seen.x].xyz);
    }
    if invocation < 2u * SOURCE_GROUPS {
        atomicStore(&many_seen[invocation], 0u);
        atomicStore(&many_hidden[invocation], 0u);
    }
    if invocation == 0u {
        atomicStore(&many_clear, 0u);
        atomicStore(&many_probed, 0u);
    }
    workgroupBarrier();
    return waits;
}

fn sources_many_source(waits: vec2<u32>) -> u32 {
    return extractBits(waits.x, SOURCES_SOURCE, SOURCES_ASKS - SOURCES_SOURCE);
}

// Whether that step is about points of groups, and which of two it is.
fn many_part(step: u32) -> u32 {
    return select(0u, SOURCE_GROUPS, step == MANY_POINTS);
}

// One place that cones and rays are followed. Barriers are met by workgroups as well that have nothing to do in a step.
fn sources_many_follow(is_one: bool, invocation: u32) {
    for (var step = 0u; step <= MANY_POINTS; step++) {
        var has_rays = is_one;
        if is_one {
            if step == MANY_PROBE && many_asks {
                many_asks = !many_contradicted();
            }
            has_rays = many_has_rays(step);
            if has_rays && step != MANY_PROBE {
                if invocation < SOURCE_GROUPS {
                    many_ready(step, invocation);
                }
            }
        }
        workgroupBarrier();
        if has_rays {
            let count = many_count(step);
            for (var ray = invocation; ray < count; ray += 32u) {
                many_ray(step, ray);
            }
        }
        workgroupBarrier();
    }
}

// Whether there is anything to do in a step, the same for all invocations.
fn many_has_rays(step: u32) -> bool {
    if step == MANY_NEAR || many_asks {
        return step == MANY_NEAR && many_asks;
    }
    return (step == MANY_PROBE) == (many_met != OCCLUDERS_NONE && atomicLoad(&many_probed) == 0u);
}

// Which points of its group an invocation asks for.
fn many_ready(step: u32, group: u32) {
    let of_group = sources_of_group(many_entry);
    let all = 0xffffffffu >> (32u - of_group);
    var asked = all;
    // Where there are few points, rays to all take no longer. A first ray that was blocked has told.
    var by_cone = of_group >= SOURCE_LEAST_FOR_CONES && extractBits(atomicLoad(&many_probed), group, 1u) != 0u;
    if step == MANY_NEAR {
        let near = sources_between(all, group, many_pixel);
        many_near[group] = near;
        asked = sources_asked(all, near, many_pixel);
        by_cone = near.x == all;
    }
    var met = many_met;
    let cone = many_entry + SOURCE_FIRST_GROUP + group;
    if by_cone {
        met = sources_meet(cone, many_met);
    }
    if met == OCCLUDERS_NONE && sources_cone_above(cone, sources_start(1u).xyz) {
        asked = 0u;
        if step == MANY_POINTS {
            atomicOr(&many_clear, 1u << group);
        }
    }
    many_asked[many_part(step) + group] = asked;
    many_first[many_part(step) + group] = met;
}

// Whether a ray is not as all pixels about this one have it.
fn many_contradicted() -> bool {
    var wrong = 0u;
    for (var group = 0u; group < SOURCE_GROUPS; group++) {
        let near = many_near[group];
        wrong |= (atomicLoad(&many_seen[group]) & ~near.y) | (atomicLoad(&many_hidden[group]) & near.x);
    }
    return wrong != 0u;
}

// Rays of a step.
fn many_count(step: u32) -> u32 {
    if step == MANY_PROBE {
        return many_probes();
    }
    var count = 0u;
    for (var group = 0u; group < SOURCE_GROUPS; group++) {
        count += countOneBits(many_asked[many_part(step) + group]);
    }
    return count;
}

fn many_ray(step: u32, ray: u32) {
    var at = vec2(0u);
    var place = vec2(0.0);
    var met = many_met;
    var group = 0u;
    var bit = ray;
    if step == MANY_PROBE {
        at = many_probe(ray);
        if ray < 2u * SOURCE_GROUPS {
            place = sources_place(at.y);
        }
    } else {
        // The ray's point among those that are asked for.
        var bits = many_asked[many_part(step)];
        var left = ray;
        while left >= countOneBits(bits) {
            left -= countOneBits(bits);
            group++;
            bits = many_asked[many_part(step) + group];
        }
        for (; left > 0u; left--) {
            bits &= bits - 1u;
        }
        bit = firstTrailingBit(bits);
        at.x = SOURCE_FIRST_POINT + group * sources_of_group(many_entry) + bit;
        place = sources_place(bit * SOURCE_GROUPS + group);
        met = many_first[many_part(step) + group];
    }
    let found = sources_look_from(many_entry + at.x, place, met) << vec2(bit);
    if step == MANY_PROBE {
        atomicOr(&many_probed, found.x);
    } else {
        atomicOr(&many_seen[many_part(step) + group], found.x);
        atomicOr(&many_hidden[many_part(step) + group], found.y);
    }
}

// How many rays tell whether anything of a source is visible.
fn many_probes() -> u32 {
    return 2u * SOURCE_GROUPS + select(0u, SOURCE_RIM, sources_of_group(many_entry) >= SOURCE_PLACES);
}

// What tells whether anything of a source is visible, its entry and the number of its place in the pixel: two places of
// each group and, of a source of many points, the rim.
fn many_probe(ray: u32) -> vec2<u32> {
    if ray >= 2u * SOURCE_GROUPS {
        return vec2(SOURCE_FIRST_RIM + ray - 2u * SOURCE_GROUPS, 0u);
    }
    let group = ray % SOURCE_GROUPS;
    let of_group = ray / SOURCE_GROUPS * SOURCE_SECOND_PLACE;
    return vec2(SOURCE_FIRST_PLACE + group * SOURCE_PLACES + of_group, of_group * SOURCE_GROUPS + group);
}

// The points of a group that are seen.
fn many_bits(group: u32) -> u32 {
    if many_asks {
        return many_near[group].x | atomicLoad(&many_seen[group]);
    }
    return atomicLoad(&many_seen[SOURCE_GROUPS + group]);
}

// The word about groups.
fn many_told() -> u32 {
    let all = 0xffffffffu >> (32u - sources_of_group(many_entry));
    var told = 0u;
    for (var group = 0u; group < SOURCE_GROUPS; group++) {
        let bits = many_bits(group);
        var whole = bits == all;
        if !many_asks {
            whole = bits != 0u && atomicLoad(&many_hidden[SOURCE_GROUPS + group]) == 0u;
        }
        whole = whole || extractBits(atomicLoad(&many_clear), group, 1u) != 0u;
        told |= sources_told(bits, whole) << group;
    }
    return told;
}

fn sources_many_write(waits: vec2<u32>, invocation: u32, hidden: f32) {
    if waits.x == SOURCES_NOBODY {
        return;
    }
    var told = many_told();
    if hidden > 0.0 {
        told |= SOURCE_SHADOWED;
    }
    if invocation >= sources_texels(told) {
        return;
    }
    var words = vec4(0u);
    for (var word = 0u; word < 4u; word++) {
        let index = 4u * invocation + word;
        if index == 0u {
            words[word] = told;
        } else if index <= SOURCE_GROUPS {
            words[word] = many_bits(index - 1u);
        } else if index == 1u + SOURCE_GROUPS {
            words[word] = bitcast<u32>(hidden);
        }
    }
    let own = many_pixel % 64u;
    let is_coarse = extractBits(waits.x, SOURCES_COARSE, 1u) != 0u;
    let place = select(own, parents_place(own), is_coarse);
    let places = select(64u, PARENTS_COUNT, is_coarse);
    textureStore(source_seen_found, sources_seen_place(many_pixel >> 6u, invocation, place, places), words);
}
