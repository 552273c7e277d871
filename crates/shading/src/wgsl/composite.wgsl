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

// Linear radiance to linear target or display colour, the coverage of which is 1.
fn composite_color(radiance: vec3<f32>) -> vec3<f32> {
    let exposed = radiance * composite.exposure;
    if composite.encoding == 0u {
        return exposed;
    }
    return tonemap_neutral(max(exposed, vec3(0.0)));
}

// As the target stores it: linear but for encoding 2, multiplied by coverage.
fn composite_store(color: vec3<f32>, coverage: f32) -> vec4<f32> {
    if composite.encoding != 2u {
        return vec4(color * coverage, coverage);
    }
    let encoded = vec3(
        tonemap_encode_srgb(color.r),
        tonemap_encode_srgb(color.g),
        tonemap_encode_srgb(color.b),
    );
    return vec4(encoded * coverage, coverage);
}

fn composite_depth(depth: f32) -> f32 {
    return select(depth, 1.0 - depth, composite.flipped_depth == 1u);
}
