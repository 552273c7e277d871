// Twin of ssdf.rs. The invocation's SSDF lives in private variables: call ssdf_load first.

var<private> ssdf_cluster: Cluster;
// Coefficients of MAX_TILES tiles. No array: what is indexed lives in memory.
var<private> ssdf_tile_0: vec4<f32>;
var<private> ssdf_tile_1: vec4<f32>;
var<private> ssdf_tile_2: vec4<f32>;
var<private> ssdf_tile_3: vec4<f32>;
var<private> ssdf_tile_4: vec4<f32>;
var<private> ssdf_tile_5: vec4<f32>;
var<private> ssdf_tile_6: vec4<f32>;
var<private> ssdf_tile_7: vec4<f32>;

fn ssdf_load(cluster: Cluster, corners: vec3<u32>, barycentrics: vec3<f32>) {
    ssdf_cluster = cluster;
    let weights = barycentrics * cluster.coefficient_scale;
    let first = cluster.first_word + (corners - cluster.first_vertex) * cluster.tiles * 2u;
    ssdf_tile_0 = ssdf_coefficients(first, 0u, weights);
    ssdf_tile_1 = ssdf_coefficients(first, 1u, weights);
    ssdf_tile_2 = ssdf_coefficients(first, 2u, weights);
    ssdf_tile_3 = ssdf_coefficients(first, 3u, weights);
    ssdf_tile_4 = ssdf_coefficients(first, 4u, weights);
    ssdf_tile_5 = ssdf_coefficients(first, 5u, weights);
    ssdf_tile_6 = ssdf_coefficients(first, 6u, weights);
    ssdf_tile_7 = ssdf_coefficients(first, 7u, weights);
}

// Of one tile, from the first words of three vertices.
fn ssdf_coefficients(first: vec3<u32>, tile: u32, weights: vec3<f32>) -> vec4<f32> {
    if tile >= ssdf_cluster.tiles {
        return vec4(0.0);
    }
    return weights.x * ssdf_quad(first.x + tile * 2u)
        + weights.y * ssdf_quad(first.y + tile * 2u)
        + weights.z * ssdf_quad(first.z + tile * 2u);
}

fn ssdf_quad(word: u32) -> vec4<f32> {
    return vec4(unpack2x16snorm(coefficients[word]), unpack2x16snorm(coefficients[word + 1u]));
}

// A cluster's tiles lie side by side in one row of the atlas, each in a gutter of one texel,
// so that the sampler's bilinear fetch wraps as the octahedral map does. Fetches come by the pair:
// they do not wait for one another.
fn ssdf_distance(direction: vec3<f32>) -> f32 {
    let texel = ssdf_cluster.tile_origin + octahedral_encode(direction) * frames[frame_index].basis_resolution;
    let tiles = ssdf_cluster.tiles;
    var distance = dot(ssdf_tile_0, ssdf_fetch(texel, 0.0));
    if tiles > 1u {
        distance += dot(ssdf_tile_1, ssdf_fetch(texel, 1.0));
    }
    if tiles > 2u {
        distance += dot(ssdf_tile_2, ssdf_fetch(texel, 2.0));
        distance += dot(ssdf_tile_3, ssdf_fetch(texel, 3.0));
    }
    if tiles > 4u {
        distance += dot(ssdf_tile_4, ssdf_fetch(texel, 4.0));
        distance += dot(ssdf_tile_5, ssdf_fetch(texel, 5.0));
    }
    if tiles > 6u {
        distance += dot(ssdf_tile_6, ssdf_fetch(texel, 6.0));
        distance += dot(ssdf_tile_7, ssdf_fetch(texel, 7.0));
    }
    return distance;
}

// Past the last tile, whatever is there: its coefficients are zero.
fn ssdf_fetch(texel: vec2<f32>, tile: f32) -> vec4<f32> {
    let place = vec2(texel.x + tile * (frames[frame_index].basis_resolution + 2.0), texel.y);
    let uv = place * frames[frame_index].atlas_texel;
    return textureSampleLevel(basis_atlas, basis_sampler, uv, ssdf_cluster.layer, 0.0);
}

fn ssdf_limit() -> f32 {
    return frames[frame_index].distance_clamp;
}
