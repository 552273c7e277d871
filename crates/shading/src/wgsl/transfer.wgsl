// Twin of transfer.rs.

// Irradiance at a point, by x, y and z of the normal. No array: what is indexed lives in memory.
struct TransferIrradiance {
    x: vec3<f32>,
    y: vec3<f32>,
    z: vec3<f32>,
}

// What surfaces in a point's way send, and its slope along x, y and z.
struct TransferRadiance {
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

// A group of bounced light: where its words begin, how many rows its vertices weigh and colours it has, and its colours.
struct TransferGroup {
    first: u32,
    rank: u32,
    outputs: u32,
    base: u32,
}

fn transfer_group(number: u32) -> TransferGroup {
    let shape = transfer_word(2u * number + 1u);
    let base = frame_index * frames[frame_index].product_count + number * TRANSFER_STRIDE;
    return TransferGroup(transfer_word(2u * number), shape & 0xffu, shape >> 8u, base);
}

// What row `row` counts at a point; the first is of all points.
fn transfer_weight(group: TransferGroup, row: u32, corners: vec3<u32>, barycentrics: vec3<f32>) -> f32 {
    if row == 0u {
        return 1.0;
    }
    let words = group.first + corners * ((group.rank + 3u) / 4u) + (row - 1u) / 4u;
    let byte = (row - 1u) % 4u;
    return barycentrics.x * transfer_byte(transfer_word(words.x), byte)
        + barycentrics.y * transfer_byte(transfer_word(words.y), byte)
        + barycentrics.z * transfer_byte(transfer_word(words.z), byte);
}

// As unpack4x8snorm reads it.
fn transfer_byte(word: u32, byte: u32) -> f32 {
    return max(f32(extractBits(bitcast<i32>(word), 8u * byte, 8u)) / 127.0, -1.0);
}

fn transfer_load(group: TransferGroup, corners: vec3<u32>, barycentrics: vec3<f32>) -> TransferIrradiance {
    var sum: TransferIrradiance;
    for (var row = 0u; row <= group.rank; row++) {
        let weight = transfer_weight(group, row, corners, barycentrics);
        let texel = group.base + row * TRANSFER_OUTPUTS;
        sum.x += weight * transfer_product(texel);
        sum.y += weight * transfer_product(texel + 1u);
        sum.z += weight * transfer_product(texel + 2u);
    }
    return sum;
}

// Where a group has no colours for it, as its irradiance has it. By itself: all at once takes more registers than there
// are.
fn transfer_load_radiance(
    group: TransferGroup,
    corners: vec3<u32>,
    barycentrics: vec3<f32>,
    irradiance: vec3<f32>,
) -> TransferRadiance {
    var sum: TransferRadiance;
    if group.outputs < TRANSFER_OUTPUTS {
        sum.mean = irradiance / PI;
        return sum;
    }
    for (var row = 0u; row <= group.rank; row++) {
        let weight = transfer_weight(group, row, corners, barycentrics);
        let texel = group.base + row * TRANSFER_OUTPUTS;
        sum.mean += weight * transfer_product(texel + 3u);
        sum.slope_x += weight * transfer_product(texel + 4u);
        sum.slope_y += weight * transfer_product(texel + 5u);
        sum.slope_z += weight * transfer_product(texel + 6u);
    }
    return sum;
}

fn transfer_irradiance(transfer: TransferIrradiance, normal: vec3<f32>) -> vec3<f32> {
    let sum = normal.x * transfer.x + normal.y * transfer.y + normal.z * transfer.z;
    return max(sum, vec3(0.0));
}

// Mean radiance of what blocks the distance about a direction.
fn transfer_radiance(transfer: TransferRadiance, direction: vec3<f32>) -> vec3<f32> {
    let slope = direction.x * transfer.slope_x + direction.y * transfer.slope_y
        + direction.z * transfer.slope_z;
    return max(transfer.mean + slope, vec3(0.0));
}

// What a reflection's lobes show of light that other surfaces send.
fn transfer_reflected(transfer: TransferRadiance, ssdf: Ssdf, normal: vec3<f32>) -> vec3<f32> {
    var sum = vec3(0.0);
    for (var j = 0u; j < specular_count; j++) {
        let lobe = lobes_in_world(j);
        let whole = tables_cosine_integral(lobe.sharpness, dot(normal, lobe.axis));
        let visible = ambient_integrate(ssdf, lobe.sharpness, lobe.axis, normal);
        let about = transfer_radiance(transfer, lobe.axis) * max(whole - visible, 0.0);
        let beyond = ambient_beyond(lobe.sharpness, lobe.axis, normal);
        sum += lobe.amplitude * about * (1.0 - beyond);
    }
    return sum;
}

// What those show of it that are wider than SSDFs tell of. By itself, before radiance and SSDF are known: all at once
// takes more registers than there are.
fn transfer_reflected_beyond(irradiance: vec3<f32>, towards: vec3<f32>, normal: vec3<f32>) -> vec3<f32> {
    var sum = vec3(0.0);
    for (var j = 0u; j < specular_count; j++) {
        let lobe = lobes_in_world(j);
        let along = exp(lobe.sharpness * (dot(lobe.axis, towards) - 1.0));
        sum += lobe.amplitude * (along * ambient_beyond(lobe.sharpness, lobe.axis, normal));
    }
    return sum * irradiance;
}

// Where most of it comes from.
fn transfer_towards(transfer: TransferIrradiance, normal: vec3<f32>) -> vec3<f32> {
    let one = vec3(1.0);
    let sums = vec3(dot(transfer.x, one), dot(transfer.y, one), dot(transfer.z, one));
    return surface_unit_or(sums, normal);
}
