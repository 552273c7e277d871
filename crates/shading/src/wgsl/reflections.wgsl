// The entry point that finds what a pixel's first reflection, or its next, is: the only pass that
// knows of materials, but for those of sources and of emission.

override REFLECTIONS_FIRST: bool = true;

@compute @workgroup_size(8, 8)
fn reflections_main(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(local_invocation_index) invocation: u32,
) {
    slots_enter_again(workgroup.x, invocation);
    let pixel = tile_pixel(invocation);
    let seen = seen_triangle(pixel);
    var state = SlotState(SLOTS_DONE, 0u, 0u);
    if seen.x >= frames[frame_index].triangle_count {
        slots_put_gathered(SLOTS_SUM, vec4(0u, 0u, 0u, slots_word(state)));
        slots_put_reflection(SLOTS_TANGENT, vec3(0.0), 0u);
        return;
    }
    if !REFLECTIONS_FIRST {
        state.reflection = slots_state(slots_gathered_at(SLOTS_SUM).w).reflection + 1u;
    }
    let triangle = triangles[seen.x];
    let weights = seen_barycentrics(triangle.xyz, pixel, seen.y);
    let pays = vertex_visibility_pays(triangle.xyz);
    let point = surface_point(triangle.xyz, triangle.w & 0xffffu, weights, state.reflection);
    slots_again();
    let lit = dot(point.normal, point.view) > 0.0;
    var sum = vec3(0.0);
    if REFLECTIONS_FIRST {
        let diffuse = select(vec3(0.0), point.appearance.diffuse, lit);
        let has_diffuse = lit && materials[triangle.w & 0xffffu].has_diffuse != 0u;
        slots_put_value(SLOTS_BESIDE, vec3(0.0), 0u);
        slots_put_value(SLOTS_DIFFUSE, diffuse, u32(has_diffuse));
    } else {
        sum = slots_gathered_value(SLOTS_SUM).xyz;
    }
    var reflects = lit && state.reflection < point.appearance.reflections;
    let wo = surface_to_local(point, point.view);
    let reflection = point.appearance.found;
    reflects = reflects && brdf_reflects(reflection, wo);
    // All that can be written before the lobes: what waits for them takes registers from them.
    slots_put_surface(point, weights, (triangle.w & 0xffffu) + 1u, pays, reflection);
    state.next = select(SLOTS_DONE, shade_first_light(), reflects);
    slots_put_value(SLOTS_SUM, sum, slots_word(state));
    slots_put_value(SLOTS_SCALED, vec3(0.0), select(SLOTS_DONE, 0u, reflects));
    slots_put_value(SLOTS_VISIBLE, vec3(0.0), bitcast<u32>(SLOTS_UNKNOWN));
    if reflects {
        slots_put_color(brdf_lobes(reflection, wo), reflection);
    }
}
