// Twin of tonemap.rs: linear radiance to display colour.

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
