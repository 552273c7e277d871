// Twin of transfer.rs. Call ssdf_load first.

// No array: what is indexed lives in memory. Irradiance by x, y and z of the normal; what surfaces
// in the way send, and its slope along x, y and z.
var<private> transfer_x: vec3<f32>;
var<private> transfer_y: vec3<f32>;
var<private> transfer_z: vec3<f32>;
var<private> transfer_mean: vec3<f32>;
var<private> transfer_slope_x: vec3<f32>;
var<private> transfer_slope_y: vec3<f32>;
var<private> transfer_slope_z: vec3<f32>;

fn transfer_word(index: u32) -> u32 {
    let place = vec2(index % TRANSFER_TEXTURE_WIDTH, index / TRANSFER_TEXTURE_WIDTH);
    return textureLoad(transfer_words, place, 0).x;
}

fn transfer_product(index: u32) -> vec3<f32> {
    let place = vec2(index % TRANSFER_TEXTURE_WIDTH, index / TRANSFER_TEXTURE_WIDTH);
    return textureLoad(transfer_products, place, 0).xyz;
}

// Fills the colours of a point of group `number`; returns how many it has.
fn transfer_load(number: u32, corners: vec3<u32>, barycentrics: vec3<f32>) -> u32 {
    let first = transfer_word(2u * number);
    let shape = transfer_word(2u * number + 1u);
    let rank = shape & 0xffu;
    let outputs = shape >> 8u;
    let base = frame_index * frames[frame_index].product_count + number * TRANSFER_STRIDE;
    transfer_x = vec3(0.0);
    transfer_y = vec3(0.0);
    transfer_z = vec3(0.0);
    transfer_mean = vec3(0.0);
    transfer_slope_x = vec3(0.0);
    transfer_slope_y = vec3(0.0);
    transfer_slope_z = vec3(0.0);
    transfer_add(base, 1.0, outputs);
    let per_vertex = (rank + 3u) / 4u;
    for (var row = 0u; row < rank; row++) {
        var weight = 0.0;
        for (var corner = 0u; corner < 3u; corner++) {
            let word = transfer_word(first + corners[corner] * per_vertex + row / 4u);
            weight += barycentrics[corner] * unpack4x8snorm(word)[row % 4u];
        }
        transfer_add(base + (row + 1u) * TRANSFER_OUTPUTS, weight, outputs);
    }
    return outputs;
}

fn transfer_add(texels: u32, weight: f32, outputs: u32) {
    transfer_x += weight * transfer_product(texels);
    transfer_y += weight * transfer_product(texels + 1u);
    transfer_z += weight * transfer_product(texels + 2u);
    if outputs == TRANSFER_OUTPUTS {
        transfer_mean += weight * transfer_product(texels + 3u);
        transfer_slope_x += weight * transfer_product(texels + 4u);
        transfer_slope_y += weight * transfer_product(texels + 5u);
        transfer_slope_z += weight * transfer_product(texels + 6u);
    }
}

fn transfer_irradiance(normal: vec3<f32>) -> vec3<f32> {
    let sum = normal.x * transfer_x + normal.y * transfer_y + normal.z * transfer_z;
    return max(sum, vec3(0.0));
}

// Mean radiance of what blocks the distance about a direction.
fn transfer_radiance(outputs: u32, direction: vec3<f32>, normal: vec3<f32>) -> vec3<f32> {
    if outputs < TRANSFER_OUTPUTS {
        return transfer_irradiance(normal) / PI;
    }
    let slope = direction.x * transfer_slope_x + direction.y * transfer_slope_y
        + direction.z * transfer_slope_z;
    return max(transfer_mean + slope, vec3(0.0));
}

// What a reflection's lobes show of light that other surfaces send.
fn transfer_reflected(outputs: u32, normal: vec3<f32>) -> vec3<f32> {
    var sum = vec3(0.0);
    for (var j = 0u; j < specular_count; j++) {
        let lobe = lobes_in_world(j);
        let whole = tables_cosine_integral(lobe.sharpness, dot(normal, lobe.axis));
        let visible = ambient_integrate(lobe.sharpness, lobe.axis, normal);
        let incoming = transfer_radiance(outputs, lobe.axis, normal);
        sum += lobe.amplitude * incoming * max(whole - visible, 0.0);
    }
    return sum;
}
