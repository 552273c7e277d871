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
    ssdf_load(clusters[triangle.w >> 16u], triangle.xyz, seen_barycentrics(triangle.xyz, pixel, seen.y));
    // What is not needed within an integral is read again after it: registers are short.
    for (var place = 0u; place < waiting; place++) {
        let shape = slots_gathered_value(SLOTS_FIRST + 2u * place);
        let share = integrals_share(place, shape.w);
        if share <= 0.0 {
            continue;
        }
        let visible = integrals_visible(shape.xyz, shape.w, share);
        integrals_add(place, visible);
    }
    let after = slots_gathered_at(SLOTS_SUM);
    var state = slots_state(after.w);
    state.waiting = 0u;
    slots_put_gathered(SLOTS_SUM, vec4(after.xyz, slots_word(state)));
}

// What a lobe can add, in what there is; 0: nothing.
fn integrals_share(place: u32, sharpness: f32) -> f32 {
    let lobe = slots_gathered_value(SLOTS_FIRST + 2u * place + 1u);
    if INTEGRALS_OF_IMAGE {
        return select(lobe.w, SHADE_EVEN, lobe.w == SLOTS_UNKNOWN);
    }
    let sum = slots_gathered_value(SLOTS_SUM).xyz;
    let whole = lobe.xyz * spherical_gaussian_energy(sharpness);
    return select(shade_share(whole, sum), 0.0, shade_negligible(whole, sum));
}

fn integrals_visible(axis: vec3<f32>, sharpness: f32, share: f32) -> f32 {
    let normal = slots_reflection_value(SLOTS_NORMAL).xyz;
    if INTEGRALS_AMBIENT {
        return ambient_integrate(sharpness, axis, normal);
    }
    return polar_integrate(sharpness, axis, normal, polar_spokes(frame.spokes, share));
}

fn integrals_add(place: u32, visible: f32) {
    let lobe = slots_gathered_value(SLOTS_FIRST + 2u * place + 1u);
    if !INTEGRALS_OF_IMAGE {
        let before = slots_gathered_at(SLOTS_SUM);
        slots_put_value(SLOTS_SUM, bitcast<vec3<f32>>(before.xyz) + lobe.xyz * visible, before.w);
        return;
    }
    let before = slots_gathered_at(SLOTS_VISIBLE);
    if lobe.w == SLOTS_UNKNOWN {
        // The part of a light from everywhere.
        let shape = slots_gathered_value(SLOTS_FIRST + 2u * place);
        let cosine = dot(slots_reflection_value(SLOTS_NORMAL).xyz, shape.xyz);
        let whole = tables_cosine_integral(shape.w, cosine);
        let part = visible / max(whole, 1.17549435e-38);
        slots_put_gathered(SLOTS_VISIBLE, vec4(before.xyz, bitcast<u32>(part)));
    } else {
        slots_put_value(SLOTS_VISIBLE, bitcast<vec3<f32>>(before.xyz) + lobe.xyz * visible, before.w);
    }
}
