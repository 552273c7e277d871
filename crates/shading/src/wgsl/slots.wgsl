// Twin of slots.rs: what the passes that shade hand on to one another. Each invocation has a slot of
// two buffers: of a workgroup the first words of all invocations, then the second words of all, so
// that neighbours lie side by side, and fields at distances that compilers know.

// One reflection: how it stands, what it is, its lobes. Written by reflections.wgsl alone.
@group(2) @binding(6) var<storage, read_write> slots_reflection_found: array<vec4<u32>>;
@group(2) @binding(6) var<storage, read> slots_reflection: array<vec4<u32>>;

var<private> slot: u32;

fn slots_enter(workgroup: u32, invocation: u32) {
    tile_enter(workgroup);
    slot = 64u * SLOTS_FIELDS * workgroup + invocation;
}

// The slot of the workgroup's first invocation, and which of them this is, for slots_again.
var<workgroup> slots_first: atomic<u32>;
var<private> slots_own: u32;

// In place of slots_enter, in uniform control flow, in kernels of few registers.
fn slots_enter_again(workgroup: u32, invocation: u32) {
    slots_enter(workgroup, invocation);
    slots_own = invocation;
    if invocation == 0u {
        atomicStore(&slots_first, slot);
    }
    workgroupBarrier();
}

// Enters the slot as if for the first time: compilers keep all places in slots that come more than once in registers,
// three for each word.
fn slots_again() {
    slot = atomicLoad(&slots_first) + slots_own;
}

// How far a pixel is.
struct SlotState {
    // The first light of the next round; SLOTS_DONE: none.
    next: u32,
    // A bit for each place in which a lobe waits.
    waiting: u32,
    // Number of the reflection.
    reflection: u32,
}

fn slots_state(word: u32) -> SlotState {
    return SlotState(extractBits(word, 0u, 22u), extractBits(word, 22u, 6u), word >> 28u);
}

fn slots_word(state: SlotState) -> u32 {
    return state.next | (state.waiting << 22u) | (state.reflection << 28u);
}

fn slots_gathered_at(field: u32) -> vec4<u32> {
    return slots_gathered[field * 64u + slot];
}

fn slots_gathered_value(field: u32) -> vec4<f32> {
    return bitcast<vec4<f32>>(slots_gathered_at(field));
}

fn slots_put_gathered(field: u32, words: vec4<u32>) {
    slots_gathered[field * 64u + slot] = words;
}

fn slots_put_value(field: u32, value: vec3<f32>, word: u32) {
    slots_put_gathered(field, vec4(bitcast<vec3<u32>>(value), word));
}

fn slots_put_word(field: u32, word: u32) {
    slots_gathered[field * 64u + slot].w = word;
}

// Fields of a lobe that waits: axis in the point's frame and sharpness; amplitude.
fn slots_shape(place: u32) -> u32 {
    return SLOTS_FIRST + 2u * place;
}

fn slots_amplitude(place: u32) -> u32 {
    return SLOTS_FIRST + 2u * place + 1u;
}

fn slots_put_reflection(field: u32, value: vec3<f32>, word: u32) {
    slots_reflection_found[field * 64u + slot] = vec4(bitcast<vec3<u32>>(value), word);
}

fn slots_reflection_at(field: u32) -> vec4<u32> {
    return slots_reflection[field * 64u + slot];
}

fn slots_reflection_value(field: u32) -> vec4<f32> {
    return bitcast<vec4<f32>>(slots_reflection_at(field));
}

// Fills a slot's reflection, but for its lobes and their colour. See slots_surface. `pays`: of the triangle, see
// vertex_visibility_pays.
fn slots_put_surface(
    point: SurfacePoint,
    barycentrics: vec3<f32>,
    surface: u32,
    pays: bool,
    reflection: Reflection,
) {
    let holds = u32(pays && vertex_visibility_holds(point.vertex_cosine));
    slots_put_reflection(SLOTS_NORMAL, point.normal, bitcast<u32>(barycentrics.y));
    slots_put_reflection(SLOTS_TANGENT, point.tangent, (holds << 8u) | (surface << 9u));
    slots_put_reflection(SLOTS_VIEW, surface_to_local(point, point.view), reflection.model);
    slots_put_reflection(SLOTS_SPECULAR, reflection.specular, reflection.ratio);
    slots_put_reflection(SLOTS_GRAZING, reflection.grazing, bitcast<u32>(reflection.alpha.x));
    slots_put_reflection(SLOTS_POSITION, point.position, bitcast<u32>(barycentrics.z));
}

// Those, the lobes being there: their amplitudes take the colour's sum.
fn slots_put_color(color: vec3<f32>, reflection: Reflection) {
    slots_reflection_found[SLOTS_TANGENT * 64u + slot].w |= specular_count;
    let scale = max(color.x + color.y + color.z, 1.17549435e-38);
    slots_put_reflection(SLOTS_COLOR, color / scale, bitcast<u32>(reflection.alpha.y));
    for (var j = 0u; j < specular_count; j++) {
        let place = (SLOTS_GREYS + j / 4u) * 64u + slot;
        let grey = bitcast<f32>(slots_reflection_found[place][j % 4u]);
        slots_reflection_found[place][j % 4u] = bitcast<u32>(grey * scale);
    }
}

// Lobes of the reflection, and whether what the corners of its triangle know of visibility holds.
fn slots_lobe_count() -> u32 {
    return slots_reflection_at(SLOTS_TANGENT).w & 0xffu;
}

fn slots_corners_hold() -> bool {
    return (slots_reflection_at(SLOTS_TANGENT).w & 0x100u) != 0u;
}

// One more than the number of what tells surfaces apart; 0: the pixel shows none. Those that lie outside of the image
// or show others have slots as well.
fn slots_surface() -> u32 {
    return slots_reflection_at(SLOTS_TANGENT).w >> 9u;
}

// Where on its triangle the point is.
fn slots_barycentrics() -> vec3<f32> {
    let rest = vec2(slots_reflection_value(SLOTS_NORMAL).w, slots_reflection_value(SLOTS_POSITION).w);
    return vec3(1.0 - rest.x - rest.y, rest);
}

// How the surface stands; the rest of the point is nothing.
fn slots_point() -> SurfacePoint {
    var point: SurfacePoint;
    point.normal = slots_reflection_value(SLOTS_NORMAL).xyz;
    point.tangent = slots_reflection_value(SLOTS_TANGENT).xyz;
    point.bitangent = cross(point.normal, point.tangent);
    return point;
}

fn lobes_put(j: u32, axis: vec3<f32>, sharpness: f32, grey: f32) {
    slots_put_reflection(SLOTS_LOBES + j, axis, bitcast<u32>(sharpness));
    slots_reflection_found[(SLOTS_GREYS + j / 4u) * 64u + slot][j % 4u] = bitcast<u32>(grey);
}

// What the pixel sees of its material's textures, see surface_texture, is written where lobes wait later and, of many
// layers, where the reflection's lobes lie later.
fn slots_put_texture(index: u32, value: vec4<f32>) {
    let words = bitcast<vec4<u32>>(value);
    let field = slots_texture(index);
    let of_layer = index >= SURFACE_OWN_TEXTURES;
    if of_layer && index % 4u == 3u {
        slots_put_texture_word(field, 2u, words.x);
    } else {
        slots_put_texture_word(field, 0u, words.x);
        slots_put_texture_word(field, 1u, words.y);
        if !(of_layer && index % 4u == 2u) {
            slots_put_texture_word(field, 2u, words.z);
        }
    }
}

fn slots_put_texture_word(field: u32, word: u32, value: u32) {
    if field < SLOTS_FIELDS {
        slots_gathered[field * 64u + slot][word] = value;
    } else {
        slots_reflection_found[(field - SLOTS_FIELDS) * 64u + slot][word] = value;
    }
}

// Its field in both buffers: of a layer three, the last of which has roughnesses and weight.
fn slots_texture(index: u32) -> u32 {
    let layer = (index - SURFACE_OWN_TEXTURES) / 4u;
    let of_layer = SURFACE_OWN_TEXTURES + 3u * layer + min(index % 4u, 2u);
    return SLOTS_FIRST + select(index, of_layer, index >= SURFACE_OWN_TEXTURES);
}

fn surface_texture(index: u32, texture: TextureSlot, place: TexturePlace) -> vec4<f32> {
    let field = slots_texture(index);
    var words = vec4(0u);
    if field < SLOTS_FIELDS {
        words = slots_gathered[field * 64u + slot];
    } else {
        words = slots_reflection_found[(field - SLOTS_FIELDS) * 64u + slot];
    }
    if index >= SURFACE_OWN_TEXTURES && index % 4u == 3u {
        words.x = words.z;
    }
    return bitcast<vec4<f32>>(words);
}

// As in lobes.wgsl.
fn lobes_shape(j: u32) -> vec4<f32> {
    return slots_reflection_value(SLOTS_LOBES + j);
}

fn lobes_grey(j: u32) -> f32 {
    return bitcast<f32>(slots_reflection[(SLOTS_GREYS + j / 4u) * 64u + slot][j % 4u]);
}

fn lobes_color() -> vec3<f32> {
    return slots_reflection_value(SLOTS_COLOR).xyz;
}

// Where they take no registers.
var<workgroup> slots_products: array<GlossySum, 64>;

fn lobes_put_sum(sum: GlossySum) {
    slots_products[slots_own] = sum;
}

fn lobes_sum() -> GlossySum {
    return slots_products[slots_own];
}

fn lobes_reflection() -> Reflection {
    let specular = slots_reflection_at(SLOTS_SPECULAR);
    let grazing = slots_reflection_value(SLOTS_GRAZING);
    let alpha = vec2(grazing.w, slots_reflection_value(SLOTS_COLOR).w);
    let model = slots_reflection_at(SLOTS_VIEW).w;
    return Reflection(bitcast<vec3<f32>>(specular.xyz), model, grazing.xyz, alpha, specular.w);
}

fn lobes_view() -> vec3<f32> {
    return slots_reflection_value(SLOTS_VIEW).xyz;
}

fn lobes_in_world(j: u32) -> SphericalGaussian {
    let shape = lobes_shape(j);
    return SphericalGaussian(surface_to_world(slots_point(), shape.xyz), shape.w, lobes_grey(j) * lobes_color());
}
