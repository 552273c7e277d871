// The entry point that finds what a reflection shows of what is no light: other surfaces, and what
// a diffuse base sees of the image beyond the lights. One half-space each is enough for it.

override AROUND_BOUNCED: bool = true;
override AROUND_IMAGE: bool = true;

@compute @workgroup_size(8, 8)
fn around_main(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(local_invocation_index) invocation: u32,
) {
    slots_enter(workgroup.x, invocation);
    if slots_surface() == 0u {
        return;
    }
    let triangle = triangles[seen_known(tile_pixel(invocation)).x];
    let corners = triangle.xyz;
    let weights = slots_barycentrics();
    ssdf_load(clusters[triangle.w >> 16u], corners, weights);
    let point = slots_point();
    var diffuse = vec3(0.0);
    if slots_state(slots_gathered_at(SLOTS_SUM).w).reflection == 0u {
        diffuse = slots_gathered_value(SLOTS_DIFFUSE).xyz;
    }
    specular_count = slots_lobe_count();
    var sum = slots_gathered_value(SLOTS_BESIDE).xyz;
    if AROUND_IMAGE {
        sum += image_diffused(point, diffuse);
    }
    if AROUND_BOUNCED && ssdf_cluster.bounced != 0u {
        let outputs = transfer_load(ssdf_cluster.bounced - 1u, corners, weights);
        sum += diffuse / PI * transfer_irradiance(point.normal);
        sum += transfer_reflected(outputs, point.normal);
    }
    slots_put_value(SLOTS_BESIDE, sum, 0u);
}
