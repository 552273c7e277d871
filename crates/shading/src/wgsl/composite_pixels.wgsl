// Pixels of one surface each.

@group(0) @binding(2) var seen_ids: texture_2d<u32>;
@group(0) @binding(3) var seen_depth: texture_depth_2d;

fn composite_shown(pixel: vec2<u32>) -> vec4<f32> {
    let shaded = textureLoad(linear_radiance, pixel, 0);
    if shaded.a == 0.0 {
        return composite_caught(pixel, shaded.rgb);
    }
    return composite_store(composite_color(shaded.rgb), 1.0);
}

@fragment
fn composite_fragment(place: Place) -> @location(0) vec4<f32> {
    let pixel = composite_pixel(place);
    if textureLoad(seen_ids, pixel, 0).x == 0u {
        discard;
    }
    return composite_written(place, composite_shown(pixel));
}

@fragment
fn composite_depth_fragment(place: Place) -> Drawn {
    let pixel = composite_pixel(place);
    if textureLoad(seen_ids, pixel, 0).x == 0u {
        discard;
    }
    let color = composite_written(place, composite_shown(pixel));
    return Drawn(color, composite_depth(textureLoad(seen_depth, pixel, 0)));
}
