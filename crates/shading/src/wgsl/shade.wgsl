// The entry point that puts a pixel's radiance together.

@compute @workgroup_size(8, 8)
fn shade_main(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(local_invocation_index) invocation: u32,
) {
    slots_enter(workgroup.x, invocation);
    let pixel = tile_pixel(invocation);
    let seen = seen_triangle(pixel);
    if seen.x >= frames[frame_index].triangle_count {
        return;
    }
    let triangle = triangles[seen.x];
    let weights = seen_barycentrics(triangle.xyz, pixel, seen.y);
    let emitted = surface_emission(triangle.xyz, triangle.w & 0xffffu, weights);
    let reflected = slots_gathered_value(SLOTS_SUM).xyz + slots_gathered_value(SLOTS_BESIDE).xyz;
    // What catches shadows covers nothing by itself.
    let coverage = 1.0 - materials[triangle.w & 0xffffu].shadow_catcher;
    textureStore(radiance, pixel, vec4(max(reflected, vec3(0.0)) + emitted, coverage));
}
