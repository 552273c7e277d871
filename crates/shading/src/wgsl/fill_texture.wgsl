// The entry point that fills one level of a material's texture with what an image of the app's shows.

struct TextureFill {
    // Column, row and layer of the level's first texel.
    corner: vec3<u32>,
    // 1: colours are stored as sRGB.
    srgb: u32,
    // Columns and rows of the level.
    size: vec2<u32>,
    reserved_0: u32,
    reserved_1: u32,
}

@group(0) @binding(0) var<uniform> fill: TextureFill;
@group(0) @binding(1) var fill_image: texture_2d<f32>;
@group(0) @binding(2) var fill_sampler: sampler;
@group(0) @binding(3) var fill_texels: texture_storage_2d_array<r32uint, write>;

@compute @workgroup_size(8, 8)
fn fill_texture_main(@builtin(global_invocation_id) id: vec3<u32>) {
    if any(id.xy >= fill.size) {
        return;
    }
    // The finest level that the image has which is no coarser, and points of it that are averaged for a texel: as
    // many as its texels are in one. All by what the view shows, which may leave out levels of its texture.
    let whole = textureDimensions(fill_image, 0);
    let ratio = max(min(whole.x / fill.size.x, whole.y / fill.size.y), 1u);
    let level = min(firstLeadingBit(ratio), textureNumLevels(fill_image) - 1u);
    let side = fill.size << vec2(level);
    let taps = clamp((whole + side - 1u) / side, vec2(1u), vec2(TEXTURES_MOST_TAPS));
    var sum = vec4(0.0);
    for (var row = 0u; row < taps.y; row++) {
        for (var column = 0u; column < taps.x; column++) {
            let within = (vec2<f32>(vec2(column, row)) + 0.5) / vec2<f32>(taps);
            let at = (vec2<f32>(id.xy) + within) / vec2<f32>(fill.size);
            sum += textureSampleLevel(fill_image, fill_sampler, at, f32(level));
        }
    }
    var color = clamp(sum / f32(taps.x * taps.y), vec4(0.0), vec4(1.0));
    if fill.srgb != 0u {
        color = vec4(
            tonemap_encode_srgb(color.r),
            tonemap_encode_srgb(color.g),
            tonemap_encode_srgb(color.b),
            color.a,
        );
    }
    textureStore(fill_texels, fill.corner.xy + id.xy, fill.corner.z, vec4(pack4x8unorm(color)));
}
