// A reflection's lobes in private variables, for kernels that hand nothing on: call
// lobes_of first. They are indexed, so they live in memory, and would be copied at every call.
// See slots.wgsl for kernels that hand lobes on.

var<private> lobes_point: SurfacePoint;
var<private> lobes_model: Reflection;
var<private> lobes_tint: vec3<f32>;
var<private> lobes_scale: f32;
// In the point's frame.
var<private> lobes_shapes: array<vec4<f32>, MAX_SPECULAR_LOBES>;
var<private> lobes_greys: array<f32, MAX_SPECULAR_LOBES>;

// What the pixel sees of one of its material's textures: base colour, metallic-roughness, normal map, anisotropy; of
// every layer diffuse and specular colour (3 channels), roughnesses (2), weight (1).
fn surface_texture(index: u32, texture: TextureSlot, place: TexturePlace) -> vec4<f32> {
    if !TEXTURES_SECOND_UVS || (texture.flags & TEXTURES_SECOND_UV) == 0u {
        return textures_sample(texture, place.uv, place.footprint);
    }
    let a = textures_vertex(place.corners.x, true);
    let b = textures_vertex(place.corners.y, true);
    let c = textures_vertex(place.corners.z, true);
    let weights = place.barycentrics;
    let uv = vec2(a.u, a.v) * weights.x + vec2(b.u, b.v) * weights.y + vec2(c.u, c.v) * weights.z;
    let position = a.position * weights.x + b.position * weights.y + c.position * weights.z;
    return textures_sample(texture, uv, textures_footprint(a, b, c, position));
}

fn lobes_of(point: SurfacePoint, reflection: Reflection) {
    lobes_point = point;
    lobes_model = reflection;
    let color = brdf_lobes(reflection, lobes_view());
    lobes_scale = max(glossy_channels(color), 1.17549435e-38);
    lobes_tint = color / lobes_scale;
}

fn lobes_put(j: u32, axis: vec3<f32>, sharpness: f32, grey: f32) {
    lobes_shapes[j] = vec4(axis, sharpness);
    lobes_greys[j] = grey;
}

// Axis in the point's frame, and sharpness.
fn lobes_shape(j: u32) -> vec4<f32> {
    return lobes_shapes[j];
}

// Amplitude, all channels together.
fn lobes_grey(j: u32) -> f32 {
    return lobes_greys[j] * lobes_scale;
}

// Parts of the channels in all amplitudes.
fn lobes_color() -> vec3<f32> {
    return lobes_tint;
}

var<private> lobes_products: GlossySum;

fn lobes_put_sum(sum: GlossySum) {
    lobes_products = sum;
}

fn lobes_sum() -> GlossySum {
    return lobes_products;
}

fn lobes_reflection() -> Reflection {
    return lobes_model;
}

// Towards the eye, in the point's frame.
fn lobes_view() -> vec3<f32> {
    return surface_to_local(lobes_point, lobes_point.view);
}

// In world space.
fn lobes_in_world(j: u32) -> SphericalGaussian {
    let shape = lobes_shapes[j];
    return SphericalGaussian(surface_to_world(lobes_point, shape.xyz), shape.w, lobes_grey(j) * lobes_tint);
}

// glossy_reflected of a light in world space.
fn lobes_reflected(light: SphericalGaussian, gathered: vec3<f32>) -> SphericalGaussian {
    let turned = SphericalGaussian(surface_to_local(lobes_point, light.axis), light.sharpness, light.amplitude);
    let lobe = glossy_reflected(turned, gathered);
    return SphericalGaussian(surface_to_world(lobes_point, lobe.axis), lobe.sharpness, lobe.amplitude);
}
