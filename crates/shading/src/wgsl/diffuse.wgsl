// Twin of irradiance in tile.rs, and the entry point that finds a pixel's irradiance: no material
// but the normal has a part in it.

// The first light of the round.
var<private> diffuse_first: u32;

@compute @workgroup_size(8, 8)
fn diffuse_main(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(local_invocation_index) invocation: u32,
) {
    pixel_enter(invocation, workgroup);
    let pixel = pixel_first + vec2(invocation % PIXEL_SIDE, invocation / PIXEL_SIDE);
    let seen = seen_triangle(pixel);
    let is_seen = seen.x < frame.triangle_count;
    var works = false;
    var corners = vec3(0u);
    var weights = vec3(0.0);
    var vertex_cosine = 0.0;
    if is_seen {
        let triangle = triangles[seen.x];
        let material = triangle.w & 0xffffu;
        corners = triangle.xyz;
        weights = seen_barycentrics(corners, pixel, seen.y);
        let shape = surface_shape(corners, material, weights);
        works = materials[material].has_diffuse != 0u && dot(shape.normal, shape.view) > 0.0;
        vertex_cosine = shape.vertex_cosine;
        pixel_put(works, shape.position, shape.normal, material + 1u);
    } else {
        pixel_put(false, vec3(0.0), vec3(0.0), 0u);
    }
    var sum = vec3(0.0);
    if pixel_works() {
        let holds = vertex_visibility_holds(vertex_cosine);
        let count = frame.light_count + frame.local_light_count;
        for (diffuse_first = 0u; diffuse_first < count; diffuse_first += SLOTS_WAITING) {
            if works {
                diffuse_ask(sum, min(SLOTS_WAITING, count - diffuse_first), holds, corners, weights);
            } else {
                for (var lobe = 0u; lobe < SLOTS_WAITING; lobe++) {
                    pixel_ask_nothing(lobe);
                }
            }
            pixel_settle();
            if works {
                for (var lobe = 0u; lobe < SLOTS_WAITING; lobe++) {
                    let fraction = pixel_fraction(lobe);
                    if fraction >= 0.0 {
                        sum += fraction * diffuse_whole(diffuse_light(pixel_own, lobe));
                    }
                }
            }
        }
    }
    if is_seen {
        textureStore(radiance, pixel, vec4(sum, select(0.0, 1.0, works)));
    }
}

fn diffuse_ask(sum: vec3<f32>, count: u32, holds: bool, corners: vec3<u32>, weights: vec3<f32>) {
    var estimate = sum;
    for (var lobe = 0u; lobe < SLOTS_WAITING; lobe++) {
        if lobe >= count {
            pixel_ask_nothing(lobe);
            continue;
        }
        let light = diffuse_light(pixel_own, lobe);
        let whole = spherical_gaussian_integral(light);
        if shade_negligible(whole, estimate) {
            pixel_ask_nothing(lobe);
            continue;
        }
        let share = shade_share(whole, estimate);
        var known = 0.0;
        var unknown = 0.0;
        if polar_meets_horizon(light.sharpness, dot(pixel_normals[pixel_own], light.axis)) {
            let fractions = vertex_visibility_of(diffuse_first + lobe, holds, corners, weights);
            unknown = vertex_visibility_doubt(fractions, share);
            known = (1.0 - unknown) * fractions.mean;
        }
        estimate += known * diffuse_whole(light);
        pixel_ask(lobe, known, unknown, share);
    }
}

// What a light could add.
fn diffuse_whole(light: SphericalGaussian) -> vec3<f32> {
    return light.amplitude * tables_cosine_integral(light.sharpness, dot(pixel_normals[pixel_own], light.axis));
}

fn diffuse_light(pixel: u32, lobe: u32) -> SphericalGaussian {
    return shade_light(diffuse_first + lobe, pixel_places[pixel].xyz);
}

// Axis and sharpness of a lobe.
fn pixel_axis(pixel: u32, lobe: u32) -> vec4<f32> {
    let light = diffuse_light(pixel, lobe);
    return vec4(light.axis, light.sharpness);
}
