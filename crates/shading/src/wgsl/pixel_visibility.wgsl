// Twin of pixel_visibility.rs: a workgroup is a tile, whose invocations find together what its pixels see
// of lobes. A kernel says what a lobe is by pixel_axis, and by PIXEL_CLIPS whether nothing is visible behind
// the plane of a pixel's triangle. A round: pixel_ask for
// every lobe of the invocation's pixel, pixel_settle, pixel_fraction.

// Of every pixel: where it is, and material + 1; 0: nothing is seen.
var<workgroup> pixel_places: array<vec4<f32>, PIXEL_COUNT>;
var<workgroup> pixel_normals: array<vec3<f32>, PIXEL_COUNT>;
// Of every pixel and lobe: what is known of the visible fraction, to which comes `unknown` times what
// is found; how deep the axis lies, before that how far it is from where visibility changes; what the lobe can add.
var<workgroup> pixel_fractions: array<f32, PIXEL_LOBES>;
var<workgroup> pixel_unknown: array<f32, PIXEL_LOBES>;
var<workgroup> pixel_depths: array<f32, PIXEL_LOBES>;
var<workgroup> pixel_shares: array<f32, PIXEL_LOBES>;
// From its start: lobes to integrate, first of pixels that others may ask, then of the others. From its end: those
// of the others, to interpolate. Of these, lobes to integrate stay where they are once those before them reach them;
// the rest become PIXEL_DONE.
var<workgroup> pixel_queue: array<u32, PIXEL_LOBES>;
var<workgroup> pixel_queued: array<atomic<u32>, 3>;
var<workgroup> pixel_work: atomic<u32>;
var<workgroup> pixel_any_work: u32;

// The invocation's pixel in the tile.
var<private> pixel_own: u32;
// Whether it takes fractions from others.
var<private> pixel_asks: bool;

// How far an axis is that nobody has looked along.
const PIXEL_UNSEEN: f32 = 10.0;
const PIXEL_DONE: u32 = 0xffffffffu;
const PIXEL_INTEGRATE: u32 = 0u;
const PIXEL_INTERPOLATE: u32 = 1u;
const PIXEL_INTEGRATE_REST: u32 = 2u;

// Call these three in order, in uniform control flow.
fn pixel_enter(invocation: u32) {
    pixel_own = invocation;
    if invocation < 3u {
        atomicStore(&pixel_queued[invocation], 0u);
    }
    if invocation == 0u {
        atomicStore(&pixel_work, 0u);
    }
    workgroupBarrier();
}

fn pixel_put(works: bool, position: vec3<f32>, normal: vec3<f32>, surface: u32) {
    pixel_places[pixel_own] = vec4(position, bitcast<f32>(surface));
    pixel_normals[pixel_own] = normal;
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
    pixel_asks = pixel_may_ask();
    return workgroupUniformLoad(&pixel_any_work) != 0u;
}

fn pixel_low(at: u32) -> u32 {
    return select(select(select(7u, 5u, at < 7u), 2u, at < 5u), 0u, at < 2u);
}

fn pixel_high(at: u32) -> u32 {
    return select(select(select(7u, 5u, at <= 5u), 2u, at <= 2u), 0u, at == 0u);
}

fn pixel_weight(at: u32) -> f32 {
    let low = pixel_low(at);
    return f32(at - low) / f32(max(pixel_high(at) - low, 1u));
}

// One of the four pixels about another, and its weight.
struct PixelParent {
    pixel: u32,
    weight: f32,
}

fn pixel_parent(pixel: u32, index: u32) -> PixelParent {
    let at = vec2(pixel % PIXEL_SIDE, pixel / PIXEL_SIDE);
    let right = pixel_weight(at.x);
    let down = pixel_weight(at.y);
    let column = select(pixel_low(at.x), pixel_high(at.x), (index & 1u) != 0u);
    let row = select(pixel_low(at.y), pixel_high(at.y), index > 1u);
    let weight = select(1.0 - right, right, (index & 1u) != 0u) * select(1.0 - down, down, index > 1u);
    return PixelParent(row * PIXEL_SIDE + column, weight);
}

fn pixel_may_ask() -> bool {
    // Further surfaces of pixels that lie side by side do not so in the picture.
    if frames[frame_index].ambient != 0u || tile_first.y >= frames[frame_index].first_extra_row {
        return false;
    }
    let place = pixel_places[pixel_own];
    let normal = pixel_normals[pixel_own];
    for (var index = 0u; index < 4u; index++) {
        let parent = pixel_parent(pixel_own, index);
        if parent.pixel == pixel_own {
            return false;
        }
        if parent.weight > 0.0 {
            let other = pixel_places[parent.pixel];
            let between = other.xyz - place.xyz;
            let same = bitcast<u32>(other.w) == bitcast<u32>(place.w)
                && dot(normal, pixel_normals[parent.pixel]) >= PIXEL_LEAST_COSINE
                && abs(dot(normal, between)) <= PIXEL_MOST_SLOPE * length(between);
            if !same {
                return false;
            }
        }
    }
    return true;
}

// A lobe that the pixel has.
fn pixel_ask(lobe: u32, known: f32, unknown: f32, share: f32) {
    let index = pixel_own * SLOTS_WAITING + lobe;
    pixel_fractions[index] = known;
    pixel_unknown[index] = unknown;
    pixel_depths[index] = 2.0 * known - 1.0;
    pixel_shares[index] = share;
    if unknown > 0.0 {
        if pixel_asks {
            let place = atomicAdd(&pixel_queued[PIXEL_INTERPOLATE], 1u);
            pixel_queue[PIXEL_LOBES - 1u - place] = index;
        } else {
            pixel_queue[atomicAdd(&pixel_queued[PIXEL_INTEGRATE], 1u)] = index;
        }
    }
}

// Before a round: the pixel has none of its lobes, but for those that pixel_ask is called for.
fn pixel_ask_nothing() {
    for (var lobe = 0u; lobe < SLOTS_WAITING; lobe++) {
        pixel_fractions[pixel_own * SLOTS_WAITING + lobe] = PIXEL_NONE;
    }
}

// Finds all that was asked, in uniform control flow: any invocation for any pixel, so that none waits for
// others' lobes.
fn pixel_settle() {
    for (var phase = PIXEL_INTEGRATE; phase <= PIXEL_INTEGRATE_REST; phase++) {
        workgroupBarrier();
        let interpolated = atomicLoad(&pixel_queued[PIXEL_INTERPOLATE]);
        // From the start of the queue, then from its end.
        var first = min(atomicLoad(&pixel_queued[phase]), PIXEL_LOBES - interpolated);
        var last = 0u;
        if phase == PIXEL_INTERPOLATE {
            first = 0u;
            last = interpolated;
        } else if atomicLoad(&pixel_queued[phase]) > first {
            last = interpolated;
        }
        for (var i = pixel_own; i < first + last; i += PIXEL_COUNT) {
            let at = select(PIXEL_LOBES - 1u - (i - first), i, i < first);
            let index = pixel_queue[at];
            if index != PIXEL_DONE {
                pixel_find(phase, index, at);
            }
        }
    }
    workgroupBarrier();
    if pixel_own < 3u {
        atomicStore(&pixel_queued[pixel_own], 0u);
    }
    workgroupBarrier();
}

// After pixel_settle; less than zero: it was not asked for.
fn pixel_fraction(lobe: u32) -> f32 {
    return pixel_fractions[pixel_own * SLOTS_WAITING + lobe];
}

// One lobe of one pixel, which is at that place of the queue.
fn pixel_find(phase: u32, index: u32, at: u32) {
    let pixel = index / SLOTS_WAITING;
    let lobe = index % SLOTS_WAITING;
    let between = pixel_between(pixel, lobe, select(0u, 4u, phase == PIXEL_INTERPOLATE));
    var distance = pixel_depths[index];
    let axis = pixel_axis(pixel, lobe);
    let radius = polar_support_radius(axis.w);
    var ssdf: Ssdf;
    if between.z < 1.0 || phase != PIXEL_INTERPOLATE {
        ssdf = pixel_ssdf(pixel);
        if phase != PIXEL_INTEGRATE_REST || distance == PIXEL_UNSEEN {
            distance = ssdf_distance(ssdf, axis.xyz);
        }
    }
    if phase == PIXEL_INTERPOLATE {
        var doubt = between.z;
        if doubt < 1.0 {
            let aside = abs(clamp(distance / radius, -1.0, 1.0) - between.y);
            doubt = max(doubt, pixel_doubt(aside / (PIXEL_DEPTH_AGREEMENT * pixel_leeway(index))));
        } else {
            distance = PIXEL_UNSEEN;
        }
        pixel_depths[index] = distance;
        pixel_fractions[index] = mix(between.x, pixel_fractions[index], doubt);
        pixel_unknown[index] *= doubt;
        // What waits at the end of the queue may not have been read yet.
        var moved = true;
        if doubt > 0.0 {
            let place = atomicAdd(&pixel_queued[PIXEL_INTEGRATE_REST], 1u);
            moved = place < PIXEL_LOBES - atomicLoad(&pixel_queued[PIXEL_INTERPOLATE]);
            if moved {
                pixel_queue[place] = index;
            }
        }
        if moved {
            pixel_queue[at] = PIXEL_DONE;
        }
        return;
    }
    pixel_depths[index] = clamp(distance / radius, -1.0, 1.0);
    let normal = pixel_normals[pixel];
    var found = 0.0;
    if frames[frame_index].ambient != 0u {
        found = ambient_integrate(ssdf, axis.w, axis.xyz, normal)
            / max(tables_cosine_integral(axis.w, dot(normal, axis.xyz)), 1.17549435e-38);
    } else {
        let spokes = polar_spokes(frames[frame_index].spokes, pixel_shares[index]);
        let face = pixel_face(pixel);
        let clipped = PIXEL_CLIPS && polar_is_clipped(radius, axis.xyz, normal, face);
        found = polar_fraction(ssdf, axis.w, axis.xyz, normal, face, clipped, distance, spokes);
    }
    pixel_fractions[index] += pixel_unknown[index] * found;
}

// Fraction and depth of a lobe between those of the pixels about one, and the part that it has to find for itself.
// Of so many pixels: compilers unroll what they can count.
fn pixel_between(pixel: u32, lobe: u32, parents: u32) -> vec3<f32> {
    var mean = vec2(0.0);
    var low = 1.0;
    var high = 0.0;
    for (var i = 0u; i < parents; i++) {
        let parent = pixel_parent(pixel, i);
        if parent.weight > 0.0 {
            let other = parent.pixel * SLOTS_WAITING + lobe;
            let fraction = pixel_fractions[other];
            mean += parent.weight * vec2(fraction, pixel_depths[other]);
            low = min(low, fraction);
            high = max(high, fraction);
        }
    }
    if low < 0.0 || parents == 0u {
        return vec3(0.0, 0.0, 1.0);
    }
    let leeway = pixel_leeway(pixel * SLOTS_WAITING + lobe);
    return vec3(mean, pixel_doubt((high - low) / (PIXEL_AGREEMENT * leeway)));
}

fn pixel_leeway(index: u32) -> f32 {
    return clamp(PIXEL_SMALL_SHARE / pixel_shares[index], 1.0, PIXEL_MOST_LEEWAY);
}

fn pixel_doubt(part: f32) -> f32 {
    return clamp((part - PIXEL_FIRM) / (1.0 - PIXEL_FIRM), 0.0, 1.0);
}

// Normal of the triangle under a pixel of the tile.
fn pixel_face(pixel: u32) -> vec3<f32> {
    let triangle = triangles[seen_triangle(tile_pixel(pixel)).x];
    return surface_geometric_normal(triangle.xyz);
}

// The SSDF of a pixel of the tile.
fn pixel_ssdf(pixel: u32) -> Ssdf {
    let at = tile_pixel(pixel);
    let seen = seen_triangle(at);
    let triangle = triangles[min(seen.x, frames[frame_index].triangle_count - 1u)];
    return ssdf_load(clusters[triangle.w >> 16u], triangle.xyz, seen_barycentrics(triangle.xyz, at, seen.y));
}
