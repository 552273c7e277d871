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
    // BACKGROUND_NONE, BACKGROUND_IMAGE or a colour.
    background: u32,
    // Levels of the image.
    levels: u32,
    // Of the lobe that the image is seen through.
    sharpness: f32,
    // Rays as in camera.wgsl.
    corner: vec3<f32>,
    perspective: f32,
    right: vec3<f32>,
    reserved_0: u32,
    down: vec3<f32>,
    reserved_1: u32,
    eye: vec3<f32>,
    reserved_2: u32,
    // Linear radiance.
    color: vec3<f32>,
    reserved_3: u32,
    // World directions to those of the image.
    rotation: mat3x3<f32>,
}

// Whether nothing blends what is written: pixels that show the background as well mix it in.
override COMPOSITE_MIXES: bool = false;

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

// A corner of one triangle that covers the viewport.
fn composite_corner(index: u32, depth: f32) -> Place {
    let corner = vec2(f32(index & 1u), f32(index >> 1u)) * 2.0;
    let position = vec4(corner.x * 2.0 - 1.0, 1.0 - corner.y * 2.0, depth, 1.0);
    return Place(position, corner * composite.size);
}

@vertex
fn composite_vertex(@builtin(vertex_index) index: u32) -> Place {
    return composite_corner(index, 0.0);
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

// Places of the images, of which `linear_radiance` says by its coverage whether they catch shadows.
@group(0) @binding(5) var open_radiance: texture_2d<f32>;

// As the target stores what catches shadows: over what is open, in the target's own numbers, it makes
// what is shaded.
fn composite_caught(place: vec2<u32>, shaded: vec3<f32>) -> vec4<f32> {
    let open = textureLoad(open_radiance, place, 0).rgb;
    let stored = composite_store(composite_color(shaded), 1.0).rgb;
    return catcher_catch(stored, composite_store(composite_color(open), 1.0).rgb);
}

// What a pixel writes, over what is behind it where nothing blends.
fn composite_written(place: Place, stored: vec4<f32>) -> vec4<f32> {
    if COMPOSITE_MIXES && stored.w < 1.0 && composite.background != BACKGROUND_NONE {
        return stored + (1.0 - stored.w) * background_stored(place.pixel);
    }
    return stored;
}

fn composite_depth(depth: f32) -> f32 {
    return select(depth, 1.0 - depth, composite.flipped_depth == 1u);
}
