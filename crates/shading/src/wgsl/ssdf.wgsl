// Twin of ssdf.rs.

// The SSDF of a point.
struct Ssdf {
    cluster: Cluster,
    // Coefficients of MAX_TILES tiles. No array: what is indexed lives in memory.
    tile_0: vec4<f32>,
    tile_1: vec4<f32>,
    tile_2: vec4<f32>,
    tile_3: vec4<f32>,
    tile_4: vec4<f32>,
    tile_5: vec4<f32>,
    tile_6: vec4<f32>,
    tile_7: vec4<f32>,
}

fn ssdf_load(cluster: Cluster, corners: vec3<u32>, barycentrics: vec3<f32>) -> Ssdf {
    let weights = barycentrics * cluster.coefficient_scale;
    let first = cluster.first_word + (corners - cluster.first_vertex) * cluster.tiles * 2u;
    let tiles = cluster.tiles;
    return Ssdf(
        cluster,
        ssdf_coefficients(first, tiles, 0u, weights),
        ssdf_coefficients(first, tiles, 1u, weights),
        ssdf_coefficients(first, tiles, 2u, weights),
        ssdf_coefficients(first, tiles, 3u, weights),
        ssdf_coefficients(first, tiles, 4u, weights),
        ssdf_coefficients(first, tiles, 5u, weights),
        ssdf_coefficients(first, tiles, 6u, weights),
        ssdf_coefficients(first, tiles, 7u, weights),
    );
}

// Of one tile, from the first words of three vertices.
fn ssdf_coefficients(first: vec3<u32>, tiles: u32, tile: u32, weights: vec3<f32>) -> vec4<f32> {
    if tile >= tiles {
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
fn ssdf_distance(ssdf: Ssdf, direction: vec3<f32>) -> f32 {
    let texel = ssdf.cluster.tile_origin + octahedral_encode(direction) * frames[frame_index].basis_resolution;
    let tiles = ssdf.cluster.tiles;
    let layer = ssdf.cluster.layer;
    var distance = dot(ssdf.tile_0, ssdf_fetch(texel, layer, 0.0));
    if tiles > 1u {
        distance += dot(ssdf.tile_1, ssdf_fetch(texel, layer, 1.0));
    }
    if tiles > 2u {
        distance += dot(ssdf.tile_2, ssdf_fetch(texel, layer, 2.0));
        distance += dot(ssdf.tile_3, ssdf_fetch(texel, layer, 3.0));
    }
    if tiles > 4u {
        distance += dot(ssdf.tile_4, ssdf_fetch(texel, layer, 4.0));
        distance += dot(ssdf.tile_5, ssdf_fetch(texel, layer, 5.0));
    }
    if tiles > 6u {
        distance += dot(ssdf.tile_6, ssdf_fetch(texel, layer, 6.0));
        distance += dot(ssdf.tile_7, ssdf_fetch(texel, layer, 7.0));
    }
    return distance;
}

// Past the last tile, whatever is there: its coefficients are zero.
fn ssdf_fetch(texel: vec2<f32>, layer: u32, tile: f32) -> vec4<f32> {
    let place = vec2(texel.x + tile * (frames[frame_index].basis_resolution + 2.0), texel.y);
    let uv = place * frames[frame_index].atlas_texel;
    return textureSampleLevel(basis_atlas, basis_sampler, uv, layer, 0.0);
}

fn ssdf_limit() -> f32 {
    return frames[frame_index].distance_clamp;
}
