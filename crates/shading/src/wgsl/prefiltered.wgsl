// Twin of prefiltered.rs.

// Of the texture `prefiltered`, which has so many levels.
fn prefiltered_levels_radiance(levels: u32, axis: vec3<f32>, sharpness: f32) -> vec3<f32> {
    let rows = max(sharpness / PREFILTERED_SHARPNESS, 1.0);
    let widest = f32(levels - 1u);
    let level = clamp(f32(levels) - 0.5 * log2(rows), 0.0, widest);
    let sharper = min(floor(level), max(widest - 1.0, 0.0));
    let number = u32(sharper);
    let a = prefiltered_bilinear(levels, number, axis);
    let b = prefiltered_bilinear(levels, min(number + 1u, levels - 1u), axis);
    // Linear in the root of the sharpness: between small lights, of which lobes see as much
    // as they are sharp, and large ones.
    return mix(a, b, 2.0 * (1.0 - exp2(sharper - level)));
}

fn prefiltered_bilinear(levels: u32, level: u32, direction: vec3<f32>) -> vec3<f32> {
    let n = 1u << (levels - level);
    // Levels of 4ᵏ texels, from 4 ^ levels down: those from here on are (4 n² − 4) / 3.
    let count = ((4u << (2u * levels)) - 4u) / 3u;
    let start = count - (4u * n * n - 4u) / 3u;
    let p = octahedral_encode(direction) * f32(n) - 0.5;
    let low = floor(p);
    let f = p - low;
    let corner = vec2<i32>(low);
    let top = mix(
        prefiltered_texel(start, corner, n),
        prefiltered_texel(start, corner + vec2(1, 0), n),
        f.x,
    );
    let bottom = mix(
        prefiltered_texel(start, corner + vec2(0, 1), n),
        prefiltered_texel(start, corner + vec2(1, 1), n),
        f.x,
    );
    return mix(top, bottom, f.y);
}

fn prefiltered_texel(start: u32, at: vec2<i32>, n: u32) -> vec3<f32> {
    let inside = octahedral_wrap(at, i32(n));
    let index = start + u32(inside.y) * n + u32(inside.x);
    let place = vec2(index % PREFILTERED_TEXTURE_WIDTH, index / PREFILTERED_TEXTURE_WIDTH);
    let texel = textureLoad(prefiltered, place, 0).x;
    let bits = bitcast<i32>(texel);
    let channels = vec3(extractBits(bits, 0u, 9u), extractBits(bits, 9u, 9u), extractBits(bits, 18u, 9u));
    // 2^(exponent − 22), exact.
    let power = bitcast<f32>(((texel >> 27u) + 105u) << 23u);
    return vec3<f32>(channels) * power;
}
