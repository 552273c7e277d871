// Twin of the second half of a round in tile.rs, and the entry point that integrates the lobes that
// wait over what is visible. No material: what they reflect is known.

override INTEGRALS_OF_IMAGE: bool = false;

@compute @workgroup_size(8, 8)
fn integrals_main(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(local_invocation_index) invocation: u32,
) {
    pixel_enter(workgroup.x, invocation);
    var waiting = 0u;
    if slots_surface() != 0u {
        waiting = slots_state(slots_gathered_at(SLOTS_SUM).w).waiting;
    }
    pixel_put(waiting != 0u);
    if !pixel_works() {
        return;
    }
    integrals_ask(waiting);
    pixel_settle();
    if waiting != 0u {
        integrals_add_all(waiting);
        let after = slots_gathered_at(SLOTS_SUM);
        var state = slots_state(after.w);
        state.waiting = 0u;
        slots_put_gathered(SLOTS_SUM, vec4(after.xyz, slots_word(state)));
    }
}

// Asks for what waits, and leaves in SLOTS_SCALED what it could add to an image.
fn integrals_ask(waiting: u32) {
    let holds = waiting != 0u && slots_corners_hold();
    var corners = vec3(0u);
    if waiting != 0u {
        corners = triangles[seen_known(tile_pixel(pixel_own)).x].xyz;
    }
    var estimate = vec3(0.0);
    // Of an image, what is gathered besides: of lights that add little to it, it need not be known closely.
    var gathered = vec3(0.0);
    if waiting != 0u {
        estimate = slots_gathered_value(select(SLOTS_SUM, SLOTS_SCALED, INTEGRALS_OF_IMAGE)).xyz;
        if INTEGRALS_OF_IMAGE {
            gathered = slots_gathered_value(SLOTS_SUM).xyz;
        }
    }
    pixel_ask_nothing();
    for (var left = waiting; left != 0u; left &= left - 1u) {
        let place = firstTrailingBit(left);
        if integrals_is_everywhere(place) {
            pixel_ask(place, 0.0, 1.0, SHADE_EVEN);
            continue;
        }
        let shape = slots_gathered_value(slots_shape(place));
        let amplitude = slots_gathered_value(slots_amplitude(place)).xyz;
        let unoccluded = amplitude * tables_cosine_integral(shape.w, shape.z);
        var whole = unoccluded;
        if !INTEGRALS_OF_IMAGE {
            whole = amplitude * spherical_gaussian_energy(shape.w);
        }
        let before = gathered + estimate;
        if shade_negligible(whole, before) {
            continue;
        }
        let share = shade_share(whole, before);
        var known = 0.0;
        var unknown = 0.0;
        if polar_meets_horizon(shape.w, shape.z) {
            let fraction = integrals_of_corners(place, shape, holds, corners);
            unknown = select(0.0, 1.0, fraction < 0.0);
            known = max(fraction, 0.0);
        }
        if INTEGRALS_OF_IMAGE {
            estimate += whole;
        } else {
            estimate += known * unoccluded;
        }
        pixel_ask(place, known, unknown, share);
    }
    if INTEGRALS_OF_IMAGE && waiting != 0u {
        slots_put_value(SLOTS_SCALED, estimate, slots_gathered_at(SLOTS_SCALED).w);
    }
}

// What the corners of the pixel's triangle know of a lobe.
fn integrals_of_corners(place: u32, shape: vec4<f32>, holds: bool, corners: vec3<u32>) -> f32 {
    let index = integrals_light(place);
    if !holds || index >= frames[frame_index].light_count {
        return VERTEX_VISIBILITY_UNKNOWN;
    }
    let axis = surface_to_world(slots_point(), shape.xyz);
    let fractions = vertex_visibility_of(index, holds, corners, vec3(0.0));
    let light = light_distant(index);
    let fraction = vertex_visibility_whole(fractions, light, SphericalGaussian(axis, shape.w, vec3(0.0)));
    // What all corners see may be behind the triangle.
    let radius = polar_support_radius(shape.w);
    if fraction > 0.0
        && polar_is_clipped(radius, axis, slots_reflection_value(SLOTS_NORMAL).xyz, surface_geometric_normal(corners)) {
        return VERTEX_VISIBILITY_UNKNOWN;
    }
    return fraction;
}

fn integrals_light(place: u32) -> u32 {
    if INTEGRALS_OF_IMAGE {
        return slots_gathered_at(SLOTS_SCALED).w - SLOTS_WAITING + place;
    }
    return slots_state(slots_gathered_at(SLOTS_SUM).w).next - SLOTS_WAITING + place;
}

fn integrals_is_everywhere(place: u32) -> bool {
    return INTEGRALS_OF_IMAGE && integrals_light(place) == frames[frame_index].light_count;
}

fn integrals_add_all(waiting: u32) {
    // As many as there are: compilers unroll what they can count.
    let places = firstLeadingBit(waiting) + 1u;
    for (var place = 0u; place < places; place++) {
        let fraction = pixel_fraction(place);
        if fraction >= 0.0 {
            integrals_add(place, fraction);
        }
    }
}

fn integrals_add(place: u32, fraction: f32) {
    let shape = slots_gathered_value(slots_shape(place));
    let amplitude = slots_gathered_value(slots_amplitude(place)).xyz;
    let seen = amplitude * tables_cosine_integral(shape.w, shape.z) * fraction;
    let field = select(SLOTS_SUM, SLOTS_VISIBLE, INTEGRALS_OF_IMAGE);
    let before = slots_gathered_at(field);
    if integrals_is_everywhere(place) {
        slots_put_gathered(field, vec4(before.xyz, bitcast<u32>(fraction)));
    } else {
        slots_put_value(field, bitcast<vec3<f32>>(before.xyz) + seen, before.w);
    }
}

// Axis and sharpness of a lobe.
fn pixel_axis(place: u32) -> vec4<f32> {
    let shape = slots_gathered_value(slots_shape(place));
    return vec4(surface_to_world(slots_point(), shape.xyz), shape.w);
}

const PIXEL_CLIPS: bool = true;
