// Twin of ssdf.rs. The invocation's SSDF lives in private variables: call ssdf_load first.

var<private> ssdf_cluster: Cluster;
var<private> ssdf_coefficients: array<vec4<f32>, MAX_TILES>;

fn ssdf_load(cluster: Cluster, corners: vec3<u32>, barycentrics: vec3<f32>) {
    ssdf_cluster = cluster;
    for (var tile = 0u; tile < cluster.tiles; tile++) {
        ssdf_coefficients[tile] = vec4(0.0);
    }
    for (var corner = 0u; corner < 3u; corner++) {
        let weight = barycentrics[corner] * cluster.coefficient_scale;
        let first = cluster.first_word + (corners[corner] - cluster.first_vertex) * cluster.tiles * 2u;
        for (var tile = 0u; tile < cluster.tiles; tile++) {
            let low = unpack2x16snorm(coefficients[first + tile * 2u]);
            let high = unpack2x16snorm(coefficients[first + tile * 2u + 1u]);
            ssdf_coefficients[tile] += weight * vec4(low, high);
        }
    }
}

// A cluster's tiles lie side by side in one row of the atlas, each in a gutter of one texel,
// so that the sampler's bilinear fetch wraps as the octahedral map does.
fn ssdf_distance(direction: vec3<f32>) -> f32 {
    var texel = ssdf_cluster.tile_origin + octahedral_encode(direction) * frame.basis_resolution;
    var distance = 0.0;
    for (var tile = 0u; tile < ssdf_cluster.tiles; tile++) {
        let uv = texel * frame.atlas_texel;
        let basis = textureSampleLevel(basis_atlas, basis_sampler, uv, ssdf_cluster.layer, 0.0);
        distance += dot(ssdf_coefficients[tile], basis);
        texel.x += frame.basis_resolution + 2.0;
    }
    return distance;
}

fn ssdf_limit() -> f32 {
    return frame.distance_clamp;
}
