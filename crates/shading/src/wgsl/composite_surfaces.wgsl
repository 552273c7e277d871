// Pixels of several surfaces, as surfaces.wgsl found them.

@group(0) @binding(2) var surfaces_shown: texture_2d<u32>;
@group(0) @binding(3) var sampled_depth: texture_depth_multisampled_2d;

// The colour of the surface that a sample shows; w is 0 on the background.
fn composite_sample(pixel: vec2<u32>, shown: u32, index: u32) -> vec4<f32> {
    let number = (shown >> (3u * index)) & 7u;
    if number == 0u {
        return vec4(0.0);
    }
    var place = pixel;
    if number > 1u {
        let tile = pixel / SURFACES_TILE;
        let rows = (u32(composite.size.y) + SURFACES_TILE - 1u) / SURFACES_TILE * SURFACES_TILE;
        let slot = (shown >> 12u) + number - 2u;
        place = vec2(tile.x * 8u + slot % 8u, rows + tile.y * 4u + slot / 8u);
    }
    return vec4(composite_color(textureLoad(linear_radiance, place, 0).rgb), 1.0);
}

// The mean of the pixel's samples. Display colours are averaged, not radiance: a bright surface
// would have stairs.
fn composite_mean(pixel: vec2<u32>, shown: u32) -> vec4<f32> {
    var sum = vec4(0.0);
    for (var i = 0u; i < 4u; i++) {
        sum += composite_sample(pixel, shown, i);
    }
    return composite_store(sum.rgb / max(sum.w, 1.0), 0.25 * sum.w);
}

@fragment
fn composite_fragment(place: Place) -> @location(0) vec4<f32> {
    let pixel = composite_pixel(place);
    let shown = textureLoad(surfaces_shown, pixel, 0).x;
    if (shown & 0xfffu) == 0u {
        discard;
    }
    return composite_written(place, composite_mean(pixel, shown));
}

// The depth of the nearest sample.
@fragment
fn composite_depth_fragment(place: Place) -> Drawn {
    let pixel = composite_pixel(place);
    let shown = textureLoad(surfaces_shown, pixel, 0).x;
    if (shown & 0xfffu) == 0u {
        discard;
    }
    var nearest = 0.0;
    for (var i = 0; i < 4; i++) {
        nearest = max(nearest, textureLoad(sampled_depth, pixel, i));
    }
    let color = composite_written(place, composite_mean(pixel, shown));
    return Drawn(color, composite_depth(nearest));
}

@fragment
fn composite_sample_fragment(
    place: Place,
    @builtin(sample_index) index: u32,
) -> @location(0) vec4<f32> {
    let pixel = composite_pixel(place);
    let color = composite_sample(pixel, textureLoad(surfaces_shown, pixel, 0).x, index);
    if color.w == 0.0 {
        discard;
    }
    return composite_store(color.rgb, 1.0);
}

@fragment
fn composite_sample_depth_fragment(place: Place, @builtin(sample_index) index: u32) -> Drawn {
    let pixel = composite_pixel(place);
    let color = composite_sample(pixel, textureLoad(surfaces_shown, pixel, 0).x, index);
    if color.w == 0.0 {
        discard;
    }
    let depth = textureLoad(sampled_depth, pixel, index);
    return Drawn(composite_store(color.rgb, 1.0), composite_depth(depth));
}
