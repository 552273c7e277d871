// Twin of transfer.rs.

// Light that bounces, at a point. No array: what is indexed lives in memory.
struct Transfer {
    // How many of what follows are there.
    outputs: u32,
    // Irradiance by x, y and z of the normal.
    x: vec3<f32>,
    y: vec3<f32>,
    z: vec3<f32>,
    // What surfaces in the way send, and its slope along x, y and z.
    mean: vec3<f32>,
    slope_x: vec3<f32>,
    slope_y: vec3<f32>,
    slope_z: vec3<f32>,
}

fn transfer_word(index: u32) -> u32 {
    let place = vec2(index % TRANSFER_TEXTURE_WIDTH, index / TRANSFER_TEXTURE_WIDTH);
    return textureLoad(transfer_words, place, 0).x;
}

fn transfer_product(index: u32) -> vec3<f32> {
    let place = vec2(index % TRANSFER_TEXTURE_WIDTH, index / TRANSFER_TEXTURE_WIDTH);
    return textureLoad(transfer_products, place, 0).xyz;
}

// That of a point of group `number`.
fn transfer_load(number: u32, corners: vec3<u32>, barycentrics: vec3<f32>) -> Transfer {
    let first = transfer_word(2u * number);
    let shape = transfer_word(2u * number + 1u);
    let rank = shape & 0xffu;
    let outputs = shape >> 8u;
    let base = frame_index * frames[frame_index].product_count + number * TRANSFER_STRIDE;
    let none = vec3(0.0);
    var sum = transfer_add(Transfer(outputs, none, none, none, none, none, none, none), base, 1.0);
    let per_vertex = (rank + 3u) / 4u;
    for (var row = 0u; row < rank; row++) {
        var weight = 0.0;
        for (var corner = 0u; corner < 3u; corner++) {
            let word = transfer_word(first + corners[corner] * per_vertex + row / 4u);
            weight += barycentrics[corner] * unpack4x8snorm(word)[row % 4u];
        }
        sum = transfer_add(sum, base + (row + 1u) * TRANSFER_OUTPUTS, weight);
    }
    return sum;
}

fn transfer_add(to: Transfer, texels: u32, weight: f32) -> Transfer {
    var sum = to;
    sum.x += weight * transfer_product(texels);
    sum.y += weight * transfer_product(texels + 1u);
    sum.z += weight * transfer_product(texels + 2u);
    if to.outputs == TRANSFER_OUTPUTS {
        sum.mean += weight * transfer_product(texels + 3u);
        sum.slope_x += weight * transfer_product(texels + 4u);
        sum.slope_y += weight * transfer_product(texels + 5u);
        sum.slope_z += weight * transfer_product(texels + 6u);
    }
    return sum;
}

fn transfer_irradiance(transfer: Transfer, normal: vec3<f32>) -> vec3<f32> {
    let sum = normal.x * transfer.x + normal.y * transfer.y + normal.z * transfer.z;
    return max(sum, vec3(0.0));
}

// Mean radiance of what blocks the distance about a direction.
fn transfer_radiance(transfer: Transfer, direction: vec3<f32>, normal: vec3<f32>) -> vec3<f32> {
    if transfer.outputs < TRANSFER_OUTPUTS {
        return transfer_irradiance(transfer, normal) / PI;
    }
    let slope = direction.x * transfer.slope_x + direction.y * transfer.slope_y
        + direction.z * transfer.slope_z;
    return max(transfer.mean + slope, vec3(0.0));
}

// What a reflection's lobes show of light that other surfaces send.
fn transfer_reflected(transfer: Transfer, ssdf: Ssdf, normal: vec3<f32>) -> vec3<f32> {
    var sum = vec3(0.0);
    for (var j = 0u; j < specular_count; j++) {
        let lobe = lobes_in_world(j);
        let whole = tables_cosine_integral(lobe.sharpness, dot(normal, lobe.axis));
        let visible = ambient_integrate(ssdf, lobe.sharpness, lobe.axis, normal);
        let incoming = transfer_radiance(transfer, lobe.axis, normal);
        sum += lobe.amplitude * incoming * max(whole - visible, 0.0);
    }
    return sum;
}
