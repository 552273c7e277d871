// The entry point that finds what a pixel sees of its material's textures, one after the other: the only pass that
// filters them, but for that of emission. It finds those by the first texture coordinates or those by the second, as
// TEXTURES_SECOND_UVS says. See surface_texture for who reads it.

@compute @workgroup_size(8, 8)
fn seen_textures_main(
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
    let first = (triangle.w & 0xffffu) * SEEN_TEXTURES_MATERIAL;
    if seen_textures_word(first + SEEN_TEXTURES_TEXTURED) < select(1u, 2u, TEXTURES_SECOND_UVS) {
        return;
    }
    let weights = seen_barycentrics(triangle.xyz, pixel, seen.y);
    let a = textures_vertex(triangle.x, true);
    let b = textures_vertex(triangle.y, true);
    let c = textures_vertex(triangle.z, true);
    let uv = vec2(a.u, a.v) * weights.x + vec2(b.u, b.v) * weights.y + vec2(c.u, c.v) * weights.z;
    let position = a.position * weights.x + b.position * weights.y + c.position * weights.z;
    let footprint = textures_footprint(a, b, c, position);
    let count = SURFACE_OWN_TEXTURES + 4u * seen_textures_word(first + SEEN_TEXTURES_LAYER_COUNT);
    let wanted = select(0u, TEXTURES_SECOND_UV, TEXTURES_SECOND_UVS);
    for (var index = 0u; index < count; index++) {
        // Four of the material, and four of each layer.
        let layer = max(index / 4u, 1u) - 1u;
        let place = select(SEEN_TEXTURES_OWN, SEEN_TEXTURES_LAYERS + layer * SEEN_TEXTURES_LAYER, index >= SURFACE_OWN_TEXTURES);
        let at = first + place + (index % 4u) * SEEN_TEXTURES_SLOT;
        let flags = seen_textures_word(at + 3u);
        if seen_textures_word(at + 1u) != 0u && (flags & TEXTURES_SECOND_UV) == wanted {
            slots_put_texture(index, textures_sample(seen_textures_slot(at / 4u), uv, footprint));
        }
    }
}

fn seen_textures_word(word: u32) -> u32 {
    return material_words[word / 4u][word % 4u];
}

fn seen_textures_slot(at: u32) -> TextureSlot {
    let size = material_words[at];
    let u = material_words[at + 1u];
    let v = material_words[at + 2u];
    return TextureSlot(
        size.x,
        size.y,
        size.z,
        size.w,
        bitcast<vec3<f32>>(u.xyz),
        u.w,
        bitcast<vec3<f32>>(v.xyz),
        v.w,
    );
}
