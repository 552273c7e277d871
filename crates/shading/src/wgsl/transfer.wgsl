// Twin of transfer.rs. Call ssdf_load first.

var<private> transfer_colors: array<vec3<f32>, TRANSFER_OUTPUTS>;

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
    let base = number * TRANSFER_STRIDE;
    for (var output = 0u; output < outputs; output++) {
        transfer_colors[output] = transfer_product(base + output);
    }
    let per_vertex = (rank + 3u) / 4u;
    for (var row = 0u; row < rank; row++) {
        var weight = 0.0;
        for (var corner = 0u; corner < 3u; corner++) {
            let word = transfer_word(first + corners[corner] * per_vertex + row / 4u);
            weight += barycentrics[corner] * unpack4x8snorm(word)[row % 4u];
        }
        let texels = base + (row + 1u) * TRANSFER_OUTPUTS;
        for (var output = 0u; output < outputs; output++) {
            transfer_colors[output] += weight * transfer_product(texels + output);
        }
    }
    return outputs;
}

fn transfer_irradiance(normal: vec3<f32>) -> vec3<f32> {
    let sum = normal.x * transfer_colors[0] + normal.y * transfer_colors[1]
        + normal.z * transfer_colors[2];
    return max(sum, vec3(0.0));
}

// Mean radiance of what blocks the distance about a direction.
fn transfer_radiance(outputs: u32, direction: vec3<f32>, normal: vec3<f32>) -> vec3<f32> {
    if outputs < TRANSFER_OUTPUTS {
        return transfer_irradiance(normal) / PI;
    }
    let slope = direction.x * transfer_colors[4] + direction.y * transfer_colors[5]
        + direction.z * transfer_colors[6];
    return max(transfer_colors[3] + slope, vec3(0.0));
}

// What the point reflects towards the eye of light that other surfaces send.
fn transfer_reflected(point: SurfacePoint, corners: vec3<u32>, barycentrics: vec3<f32>) -> vec3<f32> {
    if ssdf_cluster.bounced == 0u || dot(point.normal, point.view) <= 0.0 {
        return vec3(0.0);
    }
    let outputs = transfer_load(ssdf_cluster.bounced - 1u, corners, barycentrics);
    var sum = point.appearance.diffuse / PI * transfer_irradiance(point.normal);
    for (var k = 0u; k < reflection_count; k++) {
        brdf_specular_lobes(point, surface_reflection(k));
        for (var j = 0u; j < specular_count; j++) {
            let lobe = specular_lobes[j];
            let whole = tables_cosine_integral(lobe.sharpness, dot(point.normal, lobe.axis));
            let visible = ambient_integrate(lobe.sharpness, lobe.axis, point.normal);
            let incoming = transfer_radiance(outputs, lobe.axis, point.normal);
            sum += lobe.amplitude * incoming * max(whole - visible, 0.0);
        }
    }
    return sum;
}
