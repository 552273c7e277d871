// Twin of the first half of a round in tile.rs, and the entry point that makes lobes of the next
// SLOTS_WAITING lights and a reflection, those that can add to what is gathered. What is visible of them is left to
// integrals.wgsl.

// Of the distant lights, to say how much of a prefiltered image is visible.
override PRODUCTS_OF_IMAGE: bool = false;

@compute @workgroup_size(8, 8)
fn products_main(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(local_invocation_index) invocation: u32,
) {
    slots_enter_again(workgroup.x, invocation);
    var state = slots_state(slots_gathered_at(SLOTS_SUM).w);
    var end = frames[frame_index].light_count + frames[frame_index].local_light_count;
    if PRODUCTS_OF_IMAGE {
        state.next = slots_gathered_at(SLOTS_SCALED).w;
        // And light from everywhere.
        end = frames[frame_index].light_count + 1u;
    }
    if state.next >= end {
        return;
    }
    specular_count = slots_lobe_count();
    for (var place = 0u; place < min(SLOTS_WAITING, end - state.next); place++) {
        slots_again();
        let index = state.next + place;
        var light = SphericalGaussian(vec3(0.0, 0.0, 1.0), 0.0, vec3(1.0));
        if !PRODUCTS_OF_IMAGE || index < frames[frame_index].light_count {
            light = products_light(index);
        }
        if glossy_begin(light, products_gathered(index)) {
            let count = glossy_count();
            for (var i = 0u; i < count;) {
                i = glossy_add(light, i);
            }
            products_put(place, index, glossy_end(light));
        }
    }
    slots_again();
    // Read again: what loops change is kept through all of them.
    state.waiting = slots_state(slots_gathered_at(SLOTS_SUM).w).waiting;
    state.next += SLOTS_WAITING;
    if PRODUCTS_OF_IMAGE {
        slots_put_word(SLOTS_SCALED, state.next);
        state.next = slots_state(slots_gathered_at(SLOTS_SUM).w).next;
    }
    slots_put_word(SLOTS_SUM, slots_word(state));
}

// A lobe that may wait.
fn products_put(place: u32, index: u32, lobe: SphericalGaussian) {
    slots_again();
    let whole = spherical_gaussian_integral(lobe);
    if any(whole > vec3(0.0)) && !shade_negligible(whole, products_gathered(index)) {
        slots_put_value(slots_shape(place), lobe.axis, bitcast<u32>(lobe.sharpness));
        slots_put_value(slots_amplitude(place), lobe.amplitude, 0u);
        var state = slots_state(slots_gathered_at(SLOTS_SUM).w);
        state.waiting |= 1u << place;
        slots_put_word(SLOTS_SUM, slots_word(state));
    }
}

// What was gathered in the rounds before; read where it is needed: registers are short.
fn products_gathered(index: u32) -> vec3<f32> {
    if !PRODUCTS_OF_IMAGE {
        return slots_gathered_value(SLOTS_SUM).xyz;
    }
    // Light from everywhere is measured by itself.
    if index == frames[frame_index].light_count {
        return vec3(0.0);
    }
    return slots_gathered_value(SLOTS_SUM).xyz + slots_gathered_value(SLOTS_SCALED).xyz;
}

// In the point's frame.
fn products_light(index: u32) -> SphericalGaussian {
    let light = shade_light(index, slots_reflection_value(SLOTS_POSITION).xyz);
    return SphericalGaussian(surface_to_local(slots_point(), light.axis), light.sharpness, light.amplitude);
}
