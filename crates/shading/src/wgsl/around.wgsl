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
    let cluster = triangle.w >> 16u;
    var diffuse = vec3(0.0);
    if slots_state(slots_gathered_at(SLOTS_SUM).w).reflection == 0u {
        diffuse = slots_gathered_value(SLOTS_DIFFUSE).xyz;
    }
    specular_count = slots_lobe_count();
    var sum = slots_gathered_value(SLOTS_BESIDE).xyz;
    if AROUND_BOUNCED && clusters[cluster].bounced != 0u {
        let group = transfer_group(clusters[cluster].bounced - 1u);
        transfer_load(group, corners, weights);
        let irradiance = transfer_irradiance(slots_point().normal);
        sum += diffuse / PI * irradiance;
        transfer_load_radiance(group, corners, weights, irradiance);
        // Visibility as late as can be: it takes registers.
        ssdf_load(clusters[cluster], corners, weights);
        sum += transfer_reflected(slots_point().normal);
    }
    if AROUND_IMAGE {
        ssdf_load(clusters[cluster], corners, weights);
        sum += image_diffused(slots_point(), diffuse);
    }
    slots_put_value(SLOTS_BESIDE, sum, 0u);
}
