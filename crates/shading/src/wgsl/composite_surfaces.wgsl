// Pixels of several surfaces, as surfaces.wgsl found them.

@group(0) @binding(2) var composite_numbers: texture_2d<u32>;
@group(0) @binding(3) var composite_depths: texture_depth_multisampled_2d;

// What a sample shows: a colour whose coverage is 1, or, already as the target stores it, what a catcher
// of shadows does.
struct Sample {
    color: vec3<f32>,
    // 0 on the background, and where shadows are caught.
    coverage: f32,
    caught: vec4<f32>,
    seen: bool,
}

fn composite_sample(pixel: vec2<u32>, shown: u32, index: u32) -> Sample {
    let number = (shown >> (3u * index)) & 7u;
    if number == 0u {
        return Sample(vec3(0.0), 0.0, vec4(0.0), false);
    }
    var place = pixel;
    if number > 1u {
        let tile = pixel / SURFACES_TILE;
        let rows = (u32(composite.size.y) + SURFACES_TILE - 1u) / SURFACES_TILE * SURFACES_TILE;
        let slot = (shown >> 12u) + number - 2u;
        place = vec2(tile.x * 8u + slot % 8u, rows + tile.y * 4u + slot / 8u);
    }
    let shaded = textureLoad(linear_radiance, place, 0);
    if shaded.a == 0.0 {
        return Sample(vec3(0.0), 0.0, composite_caught(place, shaded.rgb), true);
    }
    return Sample(composite_color(shaded.rgb), 1.0, vec4(0.0), true);
}

// As the target stores one sample.
fn composite_one(drawn: Sample) -> vec4<f32> {
    return composite_store(drawn.color, drawn.coverage) + drawn.caught;
}

// The mean of the pixel's samples. Display colours are averaged, not radiance: a bright surface
// would have stairs.
fn composite_mean(pixel: vec2<u32>, shown: u32) -> vec4<f32> {
    var sum = vec4(0.0);
    var caught = vec4(0.0);
    for (var i = 0u; i < 4u; i++) {
        let drawn = composite_sample(pixel, shown, i);
        sum += vec4(drawn.color, drawn.coverage);
        caught += drawn.caught;
    }
    return composite_store(sum.rgb / max(sum.w, 1.0), 0.25 * sum.w) + 0.25 * caught;
}

@fragment
fn composite_surfaces_fragment(place: Place) -> @location(0) vec4<f32> {
    let pixel = composite_pixel(place);
    let shown = textureLoad(composite_numbers, pixel, 0).x;
    if (shown & 0xfffu) == 0u {
        discard;
    }
    return composite_written(place, composite_mean(pixel, shown));
}

// The depth of the nearest sample.
@fragment
fn composite_surfaces_depth_fragment(place: Place) -> Drawn {
    let pixel = composite_pixel(place);
    let shown = textureLoad(composite_numbers, pixel, 0).x;
    if (shown & 0xfffu) == 0u {
        discard;
    }
    var nearest = 0.0;
    for (var i = 0; i < 4; i++) {
        nearest = max(nearest, textureLoad(composite_depths, pixel, i));
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
    let drawn = composite_sample(pixel, textureLoad(composite_numbers, pixel, 0).x, index);
    if !drawn.seen {
        discard;
    }
    return composite_one(drawn);
}

@fragment
fn composite_sample_depth_fragment(place: Place, @builtin(sample_index) index: u32) -> Drawn {
    let pixel = composite_pixel(place);
    let drawn = composite_sample(pixel, textureLoad(composite_numbers, pixel, 0).x, index);
    if !drawn.seen {
        discard;
    }
    let depth = textureLoad(composite_depths, pixel, index);
    return Drawn(composite_one(drawn), composite_depth(depth));
}
