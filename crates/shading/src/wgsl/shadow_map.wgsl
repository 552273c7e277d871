// Twin of shadow_map.rs.

struct ShadowMap {
    // 1 where depth grows with distance from the light, -1 where it falls.
    sign: f32,
    bias: f32,
    source: u32,
    reserved: u32,
    // By instance, to the map's clip space.
    matrices: array<mat4x4<f32>, MAX_BATCH>,
}

@group(3) @binding(0) var<uniform> shadow_map: ShadowMap;
@group(3) @binding(1) var shadow_map_depths: texture_depth_2d;

// How much of the light does not reach a position of the scene.
fn shadow_map_hidden(position: vec3<f32>) -> f32 {
    let clip = shadow_map.matrices[frame_index] * vec4(position, 1.0);
    if clip.w <= 0.0 {
        return 0.0;
    }
    let place = clip.xyz / clip.w;
    if !(place.z >= 0.0 && place.z <= 1.0) {
        return 0.0;
    }
    let size = vec2<f32>(textureDimensions(shadow_map_depths));
    // From the first texel's centre.
    let at = (vec2(place.x, -place.y) * 0.5 + 0.5) * size - 0.5;
    let low = floor(at);
    let f = at - low;
    var hidden = 0.0;
    for (var i = 0u; i < 4u; i++) {
        let corner = vec2<f32>(vec2(i & 1u, i >> 1u));
        let texel = low + corner;
        if all(texel >= vec2(0.0)) && all(texel < size) {
            let depth = textureLoad(shadow_map_depths, vec2<u32>(texel), 0);
            if shadow_map.sign * (depth - place.z) + shadow_map.bias < 0.0 {
                let weight = corner * f + (1.0 - corner) * (1.0 - f);
                hidden += weight.x * weight.y;
            }
        }
    }
    return hidden;
}
