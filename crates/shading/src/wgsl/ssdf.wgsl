// Twin of ssdf.rs.

// The SSDF of a point.
struct Ssdf {
    cluster: Cluster,
    // Coefficients of MAX_TILES tiles, each as an integer of 16 bits, as those of vertices are: half the registers.
    // No array: what is indexed lives in memory.
    tile_0: vec2<u32>,
    tile_1: vec2<u32>,
    tile_2: vec2<u32>,
    tile_3: vec2<u32>,
    tile_4: vec2<u32>,
    tile_5: vec2<u32>,
    tile_6: vec2<u32>,
    tile_7: vec2<u32>,
}

// Bits of 2^23, whose last bit is 1, and that with what integers of 16 bits begin at.
const SSDF_BITS: u32 = 0x4b000000u;
const SSDF_ZERO: f32 = 8421376.0;
// Two coefficients of 0.
const SSDF_ZEROS: u32 = 0x80008000u;

fn ssdf_load(cluster: Cluster, corners: vec3<u32>, barycentrics: vec3<f32>) -> Ssdf {
    let first = cluster.first_word / 2u + (corners - cluster.first_vertex) * cluster.tiles;
    let none = vec2(SSDF_ZEROS);
    var ssdf = Ssdf(cluster, none, none, none, none, none, none, none, none);
    // A pair at a time, each of which moves the others on: written out, it is an eighth of a shader.
    for (var left = (cluster.tiles + 1u) & 0xeu; left > 0u; left -= 2u) {
        ssdf.tile_7 = ssdf.tile_5;
        ssdf.tile_6 = ssdf.tile_4;
        ssdf.tile_5 = ssdf.tile_3;
        ssdf.tile_4 = ssdf.tile_2;
        ssdf.tile_3 = ssdf.tile_1;
        ssdf.tile_2 = ssdf.tile_0;
        ssdf.tile_0 = ssdf_coefficients(first + left - 2u, barycentrics);
        ssdf.tile_1 = none;
        if left <= cluster.tiles {
            ssdf.tile_1 = ssdf_coefficients(first + left - 1u, barycentrics);
        }
    }
    return ssdf;
}

// Of one tile, from where it is of three vertices.
fn ssdf_coefficients(at: vec3<u32>, weights: vec3<f32>) -> vec2<u32> {
    let sum = weights.x * ssdf_quad(coefficients[at.x] ^ vec2(SSDF_ZEROS))
        + weights.y * ssdf_quad(coefficients[at.y] ^ vec2(SSDF_ZEROS))
        + weights.z * ssdf_quad(coefficients[at.z] ^ vec2(SSDF_ZEROS));
    // Rounded to an integer by what is added.
    let words = bitcast<vec4<u32>>(clamp(sum, vec4(-32767.0), vec4(32767.0)) + SSDF_ZERO);
    return (words.xz & vec2(0xffffu)) | (words.yw << vec2(16u));
}

// Integers from 0 on, less 32768.
fn ssdf_quad(words: vec2<u32>) -> vec4<f32> {
    let low = words & vec2(0xffffu);
    let high = words >> vec2(16u);
    return bitcast<vec4<f32>>(vec4(low.x, high.x, low.y, high.y) | vec4(SSDF_BITS)) - SSDF_ZERO;
}

// A cluster's tiles lie side by side in one row of the atlas, each in a gutter of one texel,
// so that the sampler's bilinear fetch wraps as the octahedral map does. Fetches come by the pair:
// they do not wait for one another.
fn ssdf_distance(ssdf: Ssdf, direction: vec3<f32>) -> f32 {
    var texel = ssdf.cluster.tile_origin + octahedral_encode(direction) * frames[frame_index].basis_resolution;
    let next = vec2(frames[frame_index].basis_resolution + 2.0, 0.0);
    let tiles = ssdf.cluster.tiles;
    let layer = ssdf.cluster.layer;
    var distance = dot(ssdf_quad(ssdf.tile_0), ssdf_fetch(texel, layer));
    if tiles > 1u {
        texel += next;
        distance += dot(ssdf_quad(ssdf.tile_1), ssdf_fetch(texel, layer));
    }
    if tiles > 2u {
        texel += next;
        distance += dot(ssdf_quad(ssdf.tile_2), ssdf_fetch(texel, layer));
        texel += next;
        distance += dot(ssdf_quad(ssdf.tile_3), ssdf_fetch(texel, layer));
    }
    if tiles > 4u {
        texel += next;
        distance += dot(ssdf_quad(ssdf.tile_4), ssdf_fetch(texel, layer));
        texel += next;
        distance += dot(ssdf_quad(ssdf.tile_5), ssdf_fetch(texel, layer));
    }
    if tiles > 6u {
        texel += next;
        distance += dot(ssdf_quad(ssdf.tile_6), ssdf_fetch(texel, layer));
        texel += next;
        distance += dot(ssdf_quad(ssdf.tile_7), ssdf_fetch(texel, layer));
    }
    return distance * (ssdf.cluster.coefficient_scale / 32767.0);
}

// Past the last tile, whatever is there: its coefficients are zero.
fn ssdf_fetch(texel: vec2<f32>, layer: u32) -> vec4<f32> {
    let uv = texel * frames[frame_index].atlas_texel;
    return textureSampleLevel(basis_atlas, basis_sampler, uv, layer, 0.0);
}

fn ssdf_limit() -> f32 {
    return frames[frame_index].distance_clamp;
}
