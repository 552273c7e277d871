// Twin of tonemap.rs: linear radiance to what a target is to hold, in a render pass of the app's.

struct Composite {
    // Columns and rows of the images.
    size: vec2<f32>,
    // Multiplies radiance.
    exposure: f32,
    // 0: linear. 1: tone-mapped; the target encodes sRGB. 2: tone-mapped and encoded here.
    encoding: u32,
    // 1: the target's depth grows with distance; that of the images falls.
    flipped_depth: u32,
    reserved: u32,
}

@group(0) @binding(0) var<uniform> composite: Composite;
@group(0) @binding(1) var linear_radiance: texture_2d<f32>;
@group(0) @binding(2) var seen_ids: texture_2d<u32>;
@group(0) @binding(3) var seen_depth: texture_depth_2d;

struct Place {
    @builtin(position) position: vec4<f32>,
    // In pixels of the images, whatever viewport they are drawn into.
    @location(0) pixel: vec2<f32>,
}

struct Drawn {
    @location(0) color: vec4<f32>,
    @builtin(frag_depth) depth: f32,
}

// One triangle that covers the viewport.
@vertex
fn composite_vertex(@builtin(vertex_index) index: u32) -> Place {
    let corner = vec2(f32(index & 1u), f32(index >> 1u)) * 2.0;
    let position = vec4(corner.x * 2.0 - 1.0, 1.0 - corner.y * 2.0, 0.0, 1.0);
    return Place(position, corner * composite.size);
}

fn composite_pixel(place: Place) -> vec2<u32> {
    return vec2<u32>(clamp(place.pixel, vec2(0.0), composite.size - 1.0));
}

@fragment
fn composite_fragment(place: Place) -> @location(0) vec4<f32> {
    let pixel = composite_pixel(place);
    if textureLoad(seen_ids, pixel, 0).x == 0u {
        discard;
    }
    return composite_encode(textureLoad(linear_radiance, pixel, 0));
}

@fragment
fn composite_depth_fragment(place: Place) -> Drawn {
    let pixel = composite_pixel(place);
    if textureLoad(seen_ids, pixel, 0).x == 0u {
        discard;
    }
    let depth = textureLoad(seen_depth, pixel, 0);
    return Drawn(
        composite_encode(textureLoad(linear_radiance, pixel, 0)),
        select(depth, 1.0 - depth, composite.flipped_depth == 1u),
    );
}

fn composite_encode(radiance: vec4<f32>) -> vec4<f32> {
    let exposed = radiance.rgb * composite.exposure;
    if composite.encoding == 0u {
        return vec4(exposed, radiance.a);
    }
    let color = tonemap_neutral(max(exposed, vec3(0.0)));
    if composite.encoding == 1u {
        return vec4(color, radiance.a);
    }
    return vec4(
        tonemap_encode_srgb(color.r),
        tonemap_encode_srgb(color.g),
        tonemap_encode_srgb(color.b),
        radiance.a,
    );
}
