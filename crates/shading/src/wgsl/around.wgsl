// The entry point that finds what a reflection shows of what is no light: other surfaces, or what
// a diffuse base sees of the image beyond the lights. One half-space each is enough for it.

// The image, in place of other surfaces.
override AROUND_IMAGE: bool = false;

@compute @workgroup_size(8, 8)
fn around_main(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(local_invocation_index) invocation: u32,
) {
    slots_enter_again(workgroup.x, invocation);
    if slots_surface() == 0u {
        return;
    }
    let triangle = triangles[seen_known(tile_pixel(invocation)).x];
    if AROUND_IMAGE {
        let ssdf = ssdf_load(clusters[triangle.w >> 16u], triangle.xyz, slots_barycentrics());
        around_add(image_diffused(ssdf, slots_point(), around_diffuse()));
    } else {
        around_bounced(triangle);
    }
}

// Visibility as late as can be: it takes registers.
fn around_bounced(triangle: vec4<u32>) {
    let number = clusters[triangle.w >> 16u].bounced;
    if number == 0u {
        return;
    }
    let group = transfer_group(number - 1u);
    let transfer = transfer_load(group, triangle.xyz, slots_barycentrics());
    let irradiance = transfer_irradiance(transfer, slots_point().normal);
    around_add(around_diffuse() / PI * irradiance);
    specular_count = slots_lobe_count();
    if specular_count > 0u {
        let towards = transfer_towards(transfer, slots_point().normal);
        around_add(transfer_reflected_beyond(irradiance, towards, slots_point().normal));
        slots_again();
        let blocked = transfer_load_radiance(group, triangle.xyz, slots_barycentrics(), irradiance);
        slots_again();
        let ssdf = ssdf_load(clusters[triangle.w >> 16u], triangle.xyz, slots_barycentrics());
        around_add(transfer_reflected(blocked, ssdf, slots_point().normal));
    }
}

// The Lambertian base comes with the first reflection.
fn around_diffuse() -> vec3<f32> {
    if slots_state(slots_gathered_at(SLOTS_SUM).w).reflection > 0u {
        return vec3(0.0);
    }
    return slots_gathered_value(SLOTS_DIFFUSE).xyz;
}

fn around_add(value: vec3<f32>) {
    slots_again();
    slots_put_value(SLOTS_BESIDE, slots_gathered_value(SLOTS_BESIDE).xyz + value, 0u);
}
