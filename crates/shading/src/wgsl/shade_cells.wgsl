// Twin of shade_cells.rs, and the entry point that shades one pixel by cells: all in one pass, which is what
// they were written for.

@compute @workgroup_size(8, 8)
fn cells_main(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(local_invocation_index) invocation: u32,
) {
    tile_enter(workgroup.x);
    let pixel = tile_pixel(invocation);
    let seen = seen_triangle(pixel);
    if seen.x >= frames[frame_index].triangle_count {
        return;
    }
    let triangle = triangles[seen.x];
    let corners = triangle.xyz;
    let weights = seen_barycentrics(corners, pixel, seen.y);
    let point = surface_point(corners, triangle.w & 0xffffu, weights, 0u);
    let ssdf = ssdf_load(clusters[triangle.w >> 16u], corners, weights);
    var sum = vec3(0.0);
    if dot(point.normal, point.view) > 0.0 {
        // First, so that lobes that add nothing to it are left out. They are where the passes that shade by lobes have
        // their sum.
        if frames[frame_index].source_count > 0u {
            sum += bitcast<vec3<f32>>(slots_gathered[64u * (SLOTS_FIELDS * workgroup.x + SLOTS_SUM) + invocation].xyz);
        }
        cells_ssdf = ssdf;
        sum = shade_lobes(point, sum);
        if frames[frame_index].prefiltered_levels > 0u {
            sum += image_diffused(ssdf, point, point.appearance.diffuse);
        }
        var blocked: TransferRadiance;
        if ssdf.cluster.bounced != 0u {
            let group = transfer_group(ssdf.cluster.bounced - 1u);
            let transfer = transfer_load(group, corners, weights);
            let irradiance = transfer_irradiance(transfer, point.normal);
            sum += point.appearance.diffuse / PI * irradiance;
            blocked = transfer_load_radiance(group, corners, weights, irradiance);
        }
        for (var k = 0u; k < point.appearance.reflections; k++) {
            lobes_of(point, surface_reflection(point.appearance, k));
            if ssdf.cluster.bounced != 0u {
                sum += transfer_reflected(blocked, ssdf, point.normal);
            }
            if frames[frame_index].prefiltered_levels > 0u {
                sum += shade_image(point.normal);
            }
        }
    }
    let emitted = surface_emission(corners, triangle.w & 0xffffu, weights);
    let coverage = 1.0 - materials[triangle.w & 0xffffu].shadow_catcher;
    textureStore(radiance, pixel, vec4(max(sum, vec3(0.0)) + emitted, coverage));
}

// What the lobes show of a prefiltered image.
fn shade_image(normal: vec3<f32>) -> vec3<f32> {
    let white = SphericalGaussian(normal, 0.0, vec3(1.0));
    let everywhere = lobes_reflected(white, vec3(0.0));
    if all(everywhere.amplitude == vec3(0.0)) {
        return vec3(0.0);
    }
    var scaled = vec3(0.0);
    var visible = vec3(0.0);
    for (var i = 0u; i < frames[frame_index].light_count; i++) {
        let lobe = lobes_reflected(shade_light(i, vec3(0.0)), scaled);
        let whole = lobe.amplitude * tables_cosine_integral(lobe.sharpness, dot(normal, lobe.axis));
        if !shade_negligible(whole, scaled) {
            scaled += whole;
            visible += lobe.amplitude * shade_visible(lobe, normal);
        }
    }
    let whole = tables_cosine_integral(everywhere.sharpness, dot(normal, everywhere.axis));
    let part = shade_visible(everywhere, normal) / max(whole, 1.17549435e-38);
    return image_seen(image_reflected(normal), scaled, visible, part);
}

fn shade_lobes(point: SurfacePoint, gathered: vec3<f32>) -> vec3<f32> {
    var sum = gathered;
    let all = frames[frame_index].light_count + frames[frame_index].local_light_count;
    cells_point = point;
    cells_diffuse = point.appearance.diffuse / PI;
    if any(cells_diffuse != vec3(0.0)) {
        cells_kind = CELLS_WIDE;
        sum += cells_integrate(point.normal, 0.5 * PI, point.normal);
        for (var i = 0u; i < all; i++) {
            var light = shade_light(i, point.position);
            if light.sharpness > CELLS_NARROW {
                light.amplitude *= cells_diffuse;
                sum += shade_single(light, point.normal);
            }
        }
    }
    cells_first_light = shade_first_light();
    for (var k = 0u; k < point.appearance.reflections; k++) {
        lobes_of(point, surface_reflection(point.appearance, k));
        cells_kind = CELLS_PRODUCTS;
        let around = cells_around();
        sum += cells_integrate(around.xyz, around.w, point.normal);
        sum += shade_narrow(point.normal);
    }
    return sum;
}

// What the reflection of lobes_of makes of narrow lights.
fn shade_narrow(normal: vec3<f32>) -> vec3<f32> {
    var sum = vec3(0.0);
    let all = frames[frame_index].light_count + frames[frame_index].local_light_count;
    var carried = vec3(0.0);
    for (var i = cells_first_light; i < all; i++) {
        let light = shade_light(i, cells_point.position);
        let lobe = lobes_reflected(light, vec3(0.0));
        carried += spherical_gaussian_integral(lobe);
    }
    for (var i = cells_first_light; i < all; i++) {
        let light = shade_light(i, cells_point.position);
        if light.sharpness <= CELLS_NARROW {
            continue;
        }
        let lobe = lobes_reflected(light, vec3(0.0));
        if !shade_negligible(spherical_gaussian_integral(lobe), carried) {
            sum += shade_single(lobe, normal);
        }
    }
    return sum;
}

// The pole for the products of lights with a reflection's lobes, and how far cells have to reach
// from it.
fn cells_around() -> vec4<f32> {
    var mean = vec3(0.0);
    for (var j = 0u; j < specular_count; j++) {
        let lobe = lobes_in_world(j);
        mean += lobe.axis * cells_luminance(spherical_gaussian_integral(lobe));
    }
    let size = length(mean);
    var pole = vec3(0.0, 1.0, 0.0);
    if size > 0.0 {
        pole = mean / size;
    }
    var reach = 0.0;
    for (var j = 0u; j < specular_count; j++) {
        let lobe = lobes_in_world(j);
        let aside = acos(clamp(dot(pole, lobe.axis), -1.0, 1.0));
        reach = max(reach, min(aside + polar_support_radius(lobe.sharpness), PI));
    }
    return vec4(pole, reach);
}

fn shade_single(lobe: SphericalGaussian, normal: vec3<f32>) -> vec3<f32> {
    cells_kind = CELLS_SINGLE;
    cells_single = lobe;
    return cells_integrate(lobe.axis, polar_support_radius(lobe.sharpness), normal);
}

fn shade_visible(lobe: SphericalGaussian, normal: vec3<f32>) -> f32 {
    return shade_single(SphericalGaussian(lobe.axis, lobe.sharpness, vec3(1.0)), normal).x;
}
