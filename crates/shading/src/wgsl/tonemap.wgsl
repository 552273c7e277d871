// Twin of tonemap.rs: linear radiance to display colour.

struct Tonemap {
    // Multiplies radiance.
    exposure: f32,
    // 1: the target stores what it is given, so encode here. 0: the target encodes.
    encode_srgb: u32,
}

@group(0) @binding(0) var<uniform> tonemap: Tonemap;
@group(0) @binding(1) var linear_radiance: texture_2d<f32>;

// One triangle that covers the target.
@vertex
fn tonemap_vertex(@builtin(vertex_index) index: u32) -> @builtin(position) vec4<f32> {
    return vec4(f32(index & 1u) * 4.0 - 1.0, f32(index >> 1u) * 4.0 - 1.0, 0.0, 1.0);
}

@fragment
fn tonemap_fragment(@builtin(position) position: vec4<f32>) -> @location(0) vec4<f32> {
    let pixel = textureLoad(linear_radiance, vec2<u32>(position.xy), 0);
    let color = tonemap_neutral(max(pixel.rgb * tonemap.exposure, vec3(0.0)));
    let encoded = vec3(
        tonemap_encode_srgb(color.r),
        tonemap_encode_srgb(color.g),
        tonemap_encode_srgb(color.b),
    );
    return vec4(select(color, encoded, tonemap.encode_srgb == 1u), pixel.a);
}

// Khronos PBR Neutral (2024): base colours come through unchanged, highlights are
// compressed and desaturated.
fn tonemap_neutral(color: vec3<f32>) -> vec3<f32> {
    let least = min(color.r, min(color.g, color.b));
    let offset = select(0.04, least - 6.25 * least * least, least < 0.08);
    let shifted = color - offset;
    let peak = max(shifted.r, max(shifted.g, shifted.b));
    if peak < TONEMAP_START {
        return shifted;
    }
    let range = 1.0 - TONEMAP_START;
    let new_peak = 1.0 - range * range / (peak + range - TONEMAP_START);
    let white = 1.0 - 1.0 / (TONEMAP_DESATURATION * (peak - new_peak) + 1.0);
    return mix(shifted * (new_peak / peak), vec3(new_peak), white);
}

fn tonemap_encode_srgb(linear: f32) -> f32 {
    return select(1.055 * pow(linear, 1.0 / 2.4) - 0.055, 12.92 * linear, linear <= 0.0031308);
}
