// Twin of irradiance in tile.rs, and the entry point that finds what a pixel's Lambertian base shows of lights.

// The first light of the round.
var<private> diffuse_first: u32;

@compute @workgroup_size(8, 8)
fn diffuse_main(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(local_invocation_index) invocation: u32,
) {
    pixel_enter(workgroup.x, invocation);
    var works = false;
    if slots_surface() != 0u {
        works = slots_gathered_at(SLOTS_DIFFUSE).w != 0u;
    }
    pixel_put(works);
    if !pixel_works() {
        return;
    }
    if works {
        slots_put_value(SLOTS_IRRADIANCE, vec3(0.0), 0u);
    }
    let count = frames[0].light_count + frames[0].local_light_count;
    // By a variable of the function, of the first instance: of others browsers do not know that all
    // invocations have the same.
    for (var first = 0u; first < count; first += SLOTS_WAITING) {
        diffuse_first = first;
        // No more than there are, which also keeps compilers from writing the loops out.
        let lobes = min(SLOTS_WAITING, count - first);
        pixel_ask_nothing();
        if works {
            diffuse_ask(lobes);
        }
        pixel_settle();
        if works {
            diffuse_add(lobes);
        }
    }
    if works {
        let before = slots_gathered_at(SLOTS_SUM);
        let base = slots_gathered_value(SLOTS_DIFFUSE).xyz / PI;
        let shown = base * slots_gathered_value(SLOTS_IRRADIANCE).xyz;
        slots_put_value(SLOTS_SUM, bitcast<vec3<f32>>(before.xyz) + shown, before.w);
    }
}

// Asks for the `count` lights of a round, where the corners of the pixel's triangle agree on them known from those.
fn diffuse_ask(count: u32) {
    let corners = triangles[seen_known(tile_pixel(pixel_own)).x].xyz;
    let weights = slots_barycentrics();
    let holds = slots_corners_hold();
    // Lights that add little to the radiance that sources gave need not be known closely.
    let base = slots_gathered_value(SLOTS_DIFFUSE).xyz / PI;
    let besides = slots_gathered_value(SLOTS_SUM).xyz / max(base, vec3(SHADE_BLACK));
    var estimate = slots_gathered_value(SLOTS_IRRADIANCE).xyz + besides;
    for (var lobe = 0u; lobe < count; lobe++) {
        let light = diffuse_light(lobe);
        let whole = spherical_gaussian_integral(light);
        if shade_negligible(whole, estimate) {
            continue;
        }
        let share = shade_share(whole, estimate);
        var known = 0.0;
        var unknown = 0.0;
        if polar_meets_horizon(light.sharpness, dot(slots_reflection_value(SLOTS_NORMAL).xyz, light.axis)) {
            let fractions = vertex_visibility_of(diffuse_first + lobe, holds, corners, weights);
            unknown = vertex_visibility_doubt(fractions, share);
            known = (1.0 - unknown) * fractions.mean;
        }
        estimate += known * diffuse_whole(light);
        pixel_ask(lobe, known, unknown, share);
    }
}

// Adds what was found of the lights of a round.
fn diffuse_add(count: u32) {
    var sum = slots_gathered_value(SLOTS_IRRADIANCE).xyz;
    for (var lobe = 0u; lobe < count; lobe++) {
        let fraction = pixel_fraction(lobe);
        if fraction >= 0.0 {
            sum += fraction * diffuse_whole(diffuse_light(lobe));
        }
    }
    slots_put_value(SLOTS_IRRADIANCE, sum, 0u);
}

// What a light could add.
fn diffuse_whole(light: SphericalGaussian) -> vec3<f32> {
    return light.amplitude * tables_cosine_integral(light.sharpness, dot(slots_reflection_value(SLOTS_NORMAL).xyz, light.axis));
}

fn diffuse_light(lobe: u32) -> SphericalGaussian {
    return shade_light(diffuse_first + lobe, slots_reflection_value(SLOTS_POSITION).xyz);
}

// Axis and sharpness of a lobe.
fn pixel_axis(lobe: u32) -> vec4<f32> {
    let light = diffuse_light(lobe);
    return vec4(light.axis, light.sharpness);
}

// Most pixels take what corners know, which is of the surface about them: so do the others.
const PIXEL_CLIPS: bool = false;
