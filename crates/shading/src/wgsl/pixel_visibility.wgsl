// Twin of pixel_visibility.rs: a workgroup is a tile, whose invocations find together what its pixels see
// of lobes. A kernel says what a lobe is by pixel_axis, and by PIXEL_CLIPS whether nothing is visible behind
// the plane of a pixel's triangle. A round: pixel_ask for
// every lobe of the invocation's pixel, pixel_settle, pixel_fraction.
// Workgroups' memory is what GPUs have least of: places and normals of pixels are read from their slots.

// Of every lobe and pixel: what is known of the visible fraction, to which comes the unknown part times what
// is found; how deep the axis lies, before that how far it is from where visibility changes; what is asked, see
// pixel_packed.
var<workgroup> pixel_fractions: array<f32, PIXEL_LOBES>;
var<workgroup> pixel_depths: array<f32, PIXEL_LOBES>;
var<workgroup> pixel_asked: array<atomic<u32>, PIXEL_LOBES>;
// A bit for each of them that is to be integrated at pixels that others may ask, interpolated, or integrated
// because others disagree.
var<workgroup> pixel_queues: array<atomic<u32>, 3u * PIXEL_WORDS>;
// How many bits that are.
var<workgroup> pixel_queued: array<atomic<u32>, 3>;
var<workgroup> pixel_work: atomic<u32>;
// The slot of the tile's first pixel: read again where it is needed, or compilers keep all places in slots in registers.
var<workgroup> pixel_first_slot: u32;
var<workgroup> pixel_any_work: u32;

// The invocation's pixel in the tile.
var<private> pixel_own: u32;
// Whether it takes fractions from others.
var<private> pixel_asks: bool;

// 1: one visible fraction per lobe stands for where it is visible.
override PIXEL_AMBIENT: bool = false;

// How far an axis is that nobody has looked along.
const PIXEL_UNSEEN: f32 = 10.0;
// Words of a queue.
const PIXEL_WORDS: u32 = PIXEL_LOBES / 32u;
const PIXEL_INTEGRATE: u32 = 0u;
const PIXEL_INTERPOLATE: u32 = 1u;
const PIXEL_INTEGRATE_REST: u32 = 2u;

// Call these three in order, in uniform control flow. Enters the slot of the pixel as well.
fn pixel_enter(workgroup: u32, invocation: u32) {
    slots_enter(workgroup, 0u);
    pixel_own = invocation;
    if invocation < 3u * PIXEL_WORDS {
        atomicStore(&pixel_queues[invocation], 0u);
    }
    if invocation < 3u {
        atomicStore(&pixel_queued[invocation], 0u);
    }
    if invocation == 0u {
        atomicStore(&pixel_work, 0u);
        pixel_first_slot = slot;
    }
    slot += invocation;
    workgroupBarrier();
}

fn pixel_put(works: bool) {
    if works {
        atomicStore(&pixel_work, 1u);
    }
}

// Whether any pixel of the tile works.
fn pixel_works() -> bool {
    workgroupBarrier();
    if pixel_own == 0u {
        pixel_any_work = atomicLoad(&pixel_work);
    }
    // Further surfaces of pixels that lie side by side do not so in the picture.
    let alone = PIXEL_AMBIENT || tile_first.y >= frames[frame_index].first_extra_row;
    pixel_asks = parents_may_ask(pixel_first_slot, pixel_own, alone);
    return workgroupUniformLoad(&pixel_any_work) != 0u;
}

// The unknown part of a fraction, 0 to 1, and what the lobe can add, with as many bits as they need.
fn pixel_packed(unknown: f32, share: f32) -> u32 {
    let rounded = (bitcast<u32>(share) + (1u << (PIXEL_SHARE_BITS - 1u))) >> PIXEL_SHARE_BITS;
    return u32(unknown * PIXEL_UNKNOWN_ONE + 0.5) | (rounded << PIXEL_UNKNOWN_BITS);
}

fn pixel_unknown(index: u32) -> f32 {
    return f32(atomicLoad(&pixel_asked[index]) & ((1u << PIXEL_UNKNOWN_BITS) - 1u)) / PIXEL_UNKNOWN_ONE;
}

fn pixel_share(index: u32) -> f32 {
    return bitcast<f32>((atomicLoad(&pixel_asked[index]) >> PIXEL_UNKNOWN_BITS) << PIXEL_SHARE_BITS);
}

// A lobe that the pixel has.
fn pixel_ask(lobe: u32, known: f32, unknown: f32, share: f32) {
    let index = lobe * PIXEL_COUNT + pixel_own;
    pixel_fractions[index] = known;
    pixel_depths[index] = 2.0 * known - 1.0;
    atomicStore(&pixel_asked[index], pixel_packed(unknown, share));
    if unknown > 0.0 {
        pixel_queue(select(PIXEL_INTEGRATE, PIXEL_INTERPOLATE, pixel_asks), index);
    }
}

fn pixel_queue(phase: u32, index: u32) {
    atomicOr(&pixel_queues[phase * PIXEL_WORDS + index / 32u], 1u << (index % 32u));
    atomicAdd(&pixel_queued[phase], 1u);
}

// Which lobe of which pixel is number `i` of a queue that has more.
fn pixel_in_queue(phase: u32, i: u32) -> u32 {
    var left = i;
    var found = 0u;
    for (var word = 0u; word < PIXEL_WORDS; word++) {
        let bits = atomicLoad(&pixel_queues[phase * PIXEL_WORDS + word]);
        let count = countOneBits(bits);
        if left < count {
            // Which half of the bits has it, and of that.
            var rest = left;
            var at = 0u;
            for (var half = 16u; half > 0u; half /= 2u) {
                let below = countOneBits(extractBits(bits, at, half));
                if rest >= below {
                    rest -= below;
                    at += half;
                }
            }
            found = word * 32u + at;
        }
        // Past what there is in all that follow.
        left = select(left - count, PIXEL_LOBES, left < count);
    }
    return found;
}

// Before a round: the pixel has none of its lobes, but for those that pixel_ask is called for.
fn pixel_ask_nothing() {
    for (var lobe = 0u; lobe < SLOTS_WAITING; lobe++) {
        pixel_fractions[lobe * PIXEL_COUNT + pixel_own] = PIXEL_NONE;
    }
}

// Finds all that was asked, in uniform control flow: any invocation for any pixel, so that none waits for
// others' lobes.
fn pixel_settle() {
    for (var phase = PIXEL_INTEGRATE; phase <= PIXEL_INTEGRATE_REST; phase++) {
        workgroupBarrier();
        pixel_serve(phase);
    }
    workgroupBarrier();
    slot = pixel_first_slot + pixel_own;
    if pixel_own < 3u * PIXEL_WORDS {
        atomicStore(&pixel_queues[pixel_own], 0u);
    }
    if pixel_own < 3u {
        atomicStore(&pixel_queued[pixel_own], 0u);
    }
    workgroupBarrier();
}

// The invocation's part of a queue. Loops within loops have functions of their own: the counters that WGSL's compilers
// bound loops by live as long as the function does.
fn pixel_serve(phase: u32) {
    let count = atomicLoad(&pixel_queued[phase]);
    for (var i = pixel_own; i < count; i += PIXEL_COUNT) {
        // As compilers that keep to arrays' ends would write it everywhere.
        pixel_find(phase, min(pixel_in_queue(phase, i), PIXEL_LOBES - 1u));
    }
}

// After pixel_settle; less than zero: it was not asked for.
fn pixel_fraction(lobe: u32) -> f32 {
    return pixel_fractions[lobe * PIXEL_COUNT + pixel_own];
}

// One lobe of one pixel, whose slot it enters.
fn pixel_find(phase: u32, index: u32) {
    let pixel = index % PIXEL_COUNT;
    let lobe = index / PIXEL_COUNT;
    slot = pixel_first_slot + pixel;
    let between = pixel_between(pixel, lobe, select(0u, 4u, phase == PIXEL_INTERPOLATE));
    if phase == PIXEL_INTERPOLATE && between.z >= 1.0 {
        pixel_depths[index] = PIXEL_UNSEEN;
        pixel_queue(PIXEL_INTEGRATE_REST, index);
    } else if phase == PIXEL_INTERPOLATE && pixel_is_sure(between, pixel_share(index)) {
        pixel_fractions[index] = between.x;
    } else {
        pixel_look(phase, index, between);
    }
}

fn pixel_look(phase: u32, index: u32, between: vec3<f32>) {
    let axis = pixel_axis(index / PIXEL_COUNT);
    let normal = slots_reflection_value(SLOTS_NORMAL).xyz;
    var product = axis;
    if PIXEL_AMBIENT {
        product = ambient_product(axis.w, axis.xyz, normal);
    }
    let ssdf = pixel_ssdf(index % PIXEL_COUNT);
    var distance = pixel_depths[index];
    if phase != PIXEL_INTEGRATE_REST || distance == PIXEL_UNSEEN {
        distance = ssdf_distance(ssdf, product.xyz);
    }
    let radius = polar_support_radius(axis.w);
    let depth = clamp(distance / radius, -1.0, 1.0);
    let share = pixel_share(index);
    if phase == PIXEL_INTERPOLATE {
        let aside = abs(depth - between.y);
        let doubt = max(between.z, pixel_doubt(aside / (PIXEL_DEPTH_AGREEMENT * pixel_leeway(share))));
        pixel_depths[index] = distance;
        pixel_fractions[index] = mix(between.x, pixel_fractions[index], doubt);
        atomicStore(&pixel_asked[index], pixel_packed(pixel_unknown(index) * doubt, share));
        if doubt > 0.0 {
            pixel_queue(PIXEL_INTEGRATE_REST, index);
        }
    } else {
        pixel_depths[index] = depth;
        var found = 0.0;
        if PIXEL_AMBIENT {
            found = ambient_fraction(product.w, distance);
        } else {
            let spokes = polar_spokes(frames[frame_index].spokes, share);
            var face = normal;
            if PIXEL_CLIPS {
                face = surface_geometric_normal(triangles[seen_known(tile_pixel(index % PIXEL_COUNT)).x].xyz);
            }
            let clipped = PIXEL_CLIPS && polar_is_clipped(radius, axis.xyz, normal, face);
            let thoroughly = share > POLAR_LARGE_SHARE;
            found = polar_fraction(ssdf, axis.w, axis.xyz, normal, face, clipped, distance, spokes, thoroughly);
        }
        pixel_fractions[index] += pixel_unknown(index) * found;
    }
}

// Fraction and depth of a lobe between those of the pixels about one, and the part that it has to find for itself.
// Of so many pixels: compilers unroll what they can count.
fn pixel_between(pixel: u32, lobe: u32, parents: u32) -> vec3<f32> {
    var mean = vec2(0.0);
    var low = 1.0;
    var high = 0.0;
    for (var i = 0u; i < parents; i++) {
        let parent = parents_of(pixel, i);
        if parent.weight > 0.0 {
            let other = lobe * PIXEL_COUNT + parent.pixel;
            let fraction = pixel_fractions[other];
            mean += parent.weight * vec2(fraction, pixel_depths[other]);
            low = min(low, fraction);
            high = max(high, fraction);
        }
    }
    if low < 0.0 || parents == 0u {
        return vec3(0.0, 0.0, 1.0);
    }
    let leeway = pixel_leeway(pixel_share(lobe * PIXEL_COUNT + pixel));
    return vec3(mean, pixel_doubt((high - low) / (PIXEL_AGREEMENT * leeway)));
}

// Whether others agree, and no depth that a pixel may find, -1 to 1, is far enough from theirs for doubt.
fn pixel_is_sure(between: vec3<f32>, share: f32) -> bool {
    return between.z == 0.0 && 1.0 + abs(between.y) <= PIXEL_FIRM * PIXEL_DEPTH_AGREEMENT * pixel_leeway(share);
}

fn pixel_leeway(share: f32) -> f32 {
    return clamp(PIXEL_SMALL_SHARE / share, 1.0, PIXEL_MOST_LEEWAY);
}

// With the bits that are kept of what is unknown, so that both parts make a whole.
fn pixel_doubt(part: f32) -> f32 {
    let doubt = clamp((part - PIXEL_FIRM) / (1.0 - PIXEL_FIRM), 0.0, 1.0);
    return floor(doubt * PIXEL_UNKNOWN_ONE + 0.5) / PIXEL_UNKNOWN_ONE;
}

// The SSDF of a pixel of the tile that shows a surface, whose slot is entered.
fn pixel_ssdf(pixel: u32) -> Ssdf {
    let triangle = triangles[seen_known(tile_pixel(pixel)).x];
    return ssdf_load(clusters[triangle.w >> 16u], triangle.xyz, slots_barycentrics());
}
