// The entry point that finds what a reflection shows of a prefiltered image, once it is known what is
// visible of the lights.

@compute @workgroup_size(8, 8)
fn images_main(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(local_invocation_index) invocation: u32,
) {
    slots_enter(workgroup.x, invocation);
    let scaled = slots_gathered_at(SLOTS_SCALED);
    let visible = slots_gathered_value(SLOTS_VISIBLE);
    if scaled.w == SLOTS_DONE || visible.w == SLOTS_UNKNOWN {
        return;
    }
    specular_count = slots_lobe_count();
    let image = image_reflected(slots_point().normal);
    let seen = image_seen(image, bitcast<vec3<f32>>(scaled.xyz), visible.xyz, visible.w);
    let sum = slots_gathered_value(SLOTS_BESIDE).xyz;
    slots_put_value(SLOTS_BESIDE, sum + seen, 0u);
}
