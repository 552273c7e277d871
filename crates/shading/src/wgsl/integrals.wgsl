// Twin of the second half of a round in shade.rs, and the entry point that integrates the lobes that
// wait over what is visible. No material: what they reflect is known.

override INTEGRALS_OF_IMAGE: bool = false;
override INTEGRALS_AMBIENT: bool = false;

@compute @workgroup_size(8, 8)
fn integrals_main(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(num_workgroups) workgroups: vec3<u32>,
    @builtin(local_invocation_index) invocation: u32,
    @builtin(global_invocation_id) id: vec3<u32>,
) {
    slots_enter(workgroup, workgroups, invocation);
    let waiting = slots_state(slots_gathered_at(SLOTS_SUM).w).waiting;
    if waiting == 0u {
        return;
    }
    let pixel = id.xy + vec2(frame.first_column, frame.first_row);
    let seen = seen_triangle(pixel);
    let triangle = triangles[min(seen.x, frame.triangle_count - 1u)];
    if integrals_ask_corners(waiting, triangle.xyz) {
        ssdf_load(clusters[triangle.w >> 16u], triangle.xyz, seen_barycentrics(triangle.xyz, pixel, seen.y));
    }
    // What is not needed within an integral is read again after it: registers are short.
    for (var place = 0u; place < waiting; place++) {
        let share = integrals_share(place);
        if share > 0.0 {
            integrals_add(place, integrals_visible(place, share));
        }
    }
    let after = slots_gathered_at(SLOTS_SUM);
    var state = slots_state(after.w);
    state.waiting = 0u;
    slots_put_gathered(SLOTS_SUM, vec4(after.xyz, slots_word(state)));
}

// Leaves INTEGRALS_VISIBLE or INTEGRALS_HIDDEN in the place of the light's number where the corners of
// the pixel's triangle know what is visible of a lobe. Whether any are left.
fn integrals_ask_corners(waiting: u32, corners: vec3<u32>) -> bool {
    let holds = slots_corners_hold();
    var any_left = false;
    for (var place = 0u; place < waiting; place++) {
        let index = slots_gathered_at(slots_amplitude(place)).w;
        var fraction = VERTEX_VISIBILITY_UNKNOWN;
        if holds && index < frame.light_count {
            let shape = slots_gathered_value(slots_shape(place));
            let axis = surface_to_world(slots_point(), shape.xyz);
            let fractions = vertex_visibility_of(index, holds, corners, vec3(0.0));
            let light = SphericalGaussian(lights[index].axis, lights[index].sharpness, vec3(0.0));
            fraction = vertex_visibility_whole(fractions, light, SphericalGaussian(axis, shape.w, vec3(0.0)));
        }
        if fraction >= 0.0 {
            let known = select(INTEGRALS_HIDDEN, INTEGRALS_VISIBLE, fraction > 0.0);
            slots_put_word(slots_amplitude(place), known);
        }
        any_left = any_left || fraction < 0.0;
    }
    return any_left;
}

const INTEGRALS_VISIBLE: u32 = 0xffffffffu;
const INTEGRALS_HIDDEN: u32 = 0xfffffffeu;

// All that a lobe could add.
fn integrals_whole(place: u32) -> vec3<f32> {
    let shape = slots_gathered_value(slots_shape(place));
    let amplitude = slots_gathered_value(slots_amplitude(place)).xyz;
    if INTEGRALS_OF_IMAGE {
        return amplitude * tables_cosine_integral(shape.w, shape.z);
    }
    return amplitude * spherical_gaussian_energy(shape.w);
}

fn integrals_is_everywhere(place: u32) -> bool {
    return INTEGRALS_OF_IMAGE && slots_gathered_at(slots_amplitude(place)).w == frame.light_count;
}

// That, in what there is; 0: nothing.
fn integrals_share(place: u32) -> f32 {
    if integrals_is_everywhere(place) {
        return SHADE_EVEN;
    }
    let sum = slots_gathered_value(select(SLOTS_SUM, SLOTS_SCALED, INTEGRALS_OF_IMAGE)).xyz;
    let whole = integrals_whole(place);
    return select(shade_share(whole, sum), 0.0, shade_negligible(whole, sum));
}

fn integrals_visible(place: u32, share: f32) -> f32 {
    let shape = slots_gathered_value(slots_shape(place));
    let known = slots_gathered_at(slots_amplitude(place)).w;
    if known >= INTEGRALS_HIDDEN {
        return select(0.0, tables_cosine_integral(shape.w, shape.z), known == INTEGRALS_VISIBLE);
    }
    let point = slots_point();
    let axis = surface_to_world(point, shape.xyz);
    if INTEGRALS_AMBIENT {
        return ambient_integrate(shape.w, axis, point.normal);
    }
    return polar_integrate(shape.w, axis, point.normal, polar_spokes(frame.spokes, share));
}

fn integrals_add(place: u32, visible: f32) {
    let seen = slots_gathered_value(slots_amplitude(place)).xyz * visible;
    if !INTEGRALS_OF_IMAGE {
        let before = slots_gathered_at(SLOTS_SUM);
        slots_put_value(SLOTS_SUM, bitcast<vec3<f32>>(before.xyz) + seen, before.w);
        return;
    }
    let before = slots_gathered_at(SLOTS_VISIBLE);
    if integrals_is_everywhere(place) {
        let shape = slots_gathered_value(slots_shape(place));
        let part = visible / max(tables_cosine_integral(shape.w, shape.z), 1.17549435e-38);
        slots_put_gathered(SLOTS_VISIBLE, vec4(before.xyz, bitcast<u32>(part)));
    } else {
        slots_put_value(SLOTS_VISIBLE, bitcast<vec3<f32>>(before.xyz) + seen, before.w);
        let scaled = slots_gathered_at(SLOTS_SCALED);
        slots_put_value(SLOTS_SCALED, bitcast<vec3<f32>>(scaled.xyz) + integrals_whole(place), scaled.w);
    }
}
