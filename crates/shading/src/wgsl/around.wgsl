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
    let pixel = tile_pixel(invocation);
    let seen = seen_triangle(pixel);
    if seen.x >= frames[frame_index].triangle_count {
        return;
    }
    let triangle = triangles[seen.x];
    let corners = triangle.xyz;
    let weights = seen_barycentrics(corners, pixel, seen.y);
    let ssdf = ssdf_load(clusters[triangle.w >> 16u], corners, weights);
    let point = slots_point();
    var diffuse = vec3(0.0);
    if slots_state(slots_gathered_at(SLOTS_SUM).w).reflection == 0u {
        diffuse = slots_gathered_value(SLOTS_DIFFUSE).xyz;
    }
    specular_count = slots_lobe_count();
    var sum = slots_gathered_value(SLOTS_BESIDE).xyz;
    if AROUND_IMAGE {
        sum += image_diffused(ssdf, point, diffuse);
    }
    if AROUND_BOUNCED && ssdf.cluster.bounced != 0u {
        let transfer = transfer_load(ssdf.cluster.bounced - 1u, corners, weights);
        sum += diffuse / PI * transfer_irradiance(transfer, point.normal);
        sum += transfer_reflected(transfer, ssdf, point.normal);
    }
    slots_put_value(SLOTS_BESIDE, sum, 0u);
}
