// Twin of the first half of a round in shade.rs, and the entry point that makes lobes of the lights
// and a reflection until SLOTS_WAITING of them wait. No SSDF: what is visible of them is left to
// integrals.wgsl.

// Of the distant lights, to say how much of a prefiltered image is visible.
override PRODUCTS_OF_IMAGE: bool = false;

@compute @workgroup_size(8, 8)
fn products_main(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(num_workgroups) workgroups: vec3<u32>,
    @builtin(local_invocation_index) invocation: u32,
) {
    slots_enter(workgroup, workgroups, invocation);
    let before = slots_gathered_at(SLOTS_SUM);
    var state = slots_state(before.w);
    var sum = bitcast<vec3<f32>>(before.xyz);
    var end = frame.light_count + frame.local_light_count;
    if PRODUCTS_OF_IMAGE {
        let scaled = slots_gathered_at(SLOTS_SCALED);
        state.next = scaled.w;
        sum = bitcast<vec3<f32>>(scaled.xyz);
        // And light from everywhere.
        end = frame.light_count + 1u;
    }
    if state.next >= end {
        return;
    }
    let word = slots_reflection_at(SLOTS_TANGENT).w;
    specular_count = word & 0xffu;
    while state.next < end && state.waiting < SLOTS_WAITING {
        let index = state.next;
        state.next++;
        let everywhere = PRODUCTS_OF_IMAGE && index == frame.light_count;
        var light = SphericalGaussian(vec3(0.0, 0.0, 1.0), 0.0, vec3(1.0));
        var gathered = vec3(0.0);
        if !everywhere {
            light = products_light(index);
            gathered = sum;
        }
        let lobe = glossy_reflected(light, gathered);
        if everywhere {
            if any(lobe.amplitude != vec3(0.0)) {
                products_wait(state.waiting, lobe, SLOTS_UNKNOWN);
                state.waiting++;
            }
            continue;
        }
        var whole = spherical_gaussian_energy(lobe.sharpness);
        if PRODUCTS_OF_IMAGE {
            whole = tables_cosine_integral(lobe.sharpness, lobe.axis.z);
        }
        if shade_negligible(lobe.amplitude * whole, sum) {
            continue;
        }
        var share = 0.0;
        if PRODUCTS_OF_IMAGE {
            share = shade_share(lobe.amplitude * whole, sum);
            sum += lobe.amplitude * whole;
        }
        let fraction = products_fraction(index, word, light, lobe);
        if fraction < 0.0 {
            products_wait(state.waiting, lobe, share);
            state.waiting++;
        } else if fraction > 0.0 {
            let seen = lobe.amplitude * (fraction * tables_cosine_integral(lobe.sharpness, lobe.axis.z));
            if PRODUCTS_OF_IMAGE {
                let visible = slots_gathered_at(SLOTS_VISIBLE);
                slots_put_value(SLOTS_VISIBLE, bitcast<vec3<f32>>(visible.xyz) + seen, visible.w);
            } else {
                sum += seen;
            }
        }
    }
    if PRODUCTS_OF_IMAGE {
        slots_put_value(SLOTS_SCALED, sum, state.next);
        sum = bitcast<vec3<f32>>(before.xyz);
        state.next = slots_state(before.w).next;
    }
    slots_put_value(SLOTS_SUM, sum, slots_word(state));
}

// In the point's frame.
fn products_light(index: u32) -> SphericalGaussian {
    let light = shade_light(index, slots_reflection_value(SLOTS_POSITION).xyz);
    return SphericalGaussian(surface_to_local(slots_point(), light.axis), light.sharpness, light.amplitude);
}

// What is visible of a lobe, if the corners of the pixel's triangle know.
fn products_fraction(index: u32, word: u32, light: SphericalGaussian, lobe: SphericalGaussian) -> f32 {
    let corners = triangles[slots_reflection_at(SLOTS_NORMAL).w].xyz;
    let fractions = vertex_visibility_of(index, (word >> 8u) != 0u, corners, vec3(0.0));
    return vertex_visibility_whole(fractions, light, lobe);
}

fn products_wait(place: u32, lobe: SphericalGaussian, share: f32) {
    let axis = surface_to_world(slots_point(), lobe.axis);
    slots_put_value(SLOTS_FIRST + 2u * place, axis, bitcast<u32>(lobe.sharpness));
    slots_put_value(SLOTS_FIRST + 2u * place + 1u, lobe.amplitude, bitcast<u32>(share));
}
