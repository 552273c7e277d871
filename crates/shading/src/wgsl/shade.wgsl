// Twin of shade.rs, and the entry point that shades one pixel per invocation.

@compute @workgroup_size(8, 8)
fn shade_main(@builtin(global_invocation_id) id: vec3<u32>) {
    let pixel = vec2(id.x, id.y + frame.first_row);
    if any(pixel >= textureDimensions(visibility_buffer)) {
        return;
    }
    let covering = textureLoad(visibility_buffer, pixel, 0).x;
    if covering == 0u {
        textureStore(radiance, pixel, vec4(0.0));
        return;
    }
    let triangle = triangles[covering - 1u];
    let corners = triangle.xyz;
    let weights = barycentrics(
        vertices[corners.x].position,
        vertices[corners.y].position,
        vertices[corners.z].position,
        pixel_direction(pixel),
    );
    let point = surface_point(corners, triangle.w & 0xffffu, weights);
    ssdf_load(clusters[triangle.w >> 16u], corners, weights);
    let direct = shade(point);
    let bounced = transfer_reflected(point, corners, weights);
    let emitted = surface_emission(corners, triangle.w & 0xffffu, weights);
    textureStore(radiance, pixel, vec4(direct + bounced + emitted, 1.0));
}

fn shade(point: SurfacePoint) -> vec3<f32> {
    var sum = vec3(0.0);
    if dot(point.normal, point.view) <= 0.0 {
        return sum;
    }
    sum = shade_lobes(point);
    if frame.prefiltered_levels > 0u {
        for (var k = 0u; k < reflection_count; k++) {
            brdf_specular_lobes(point, reflections[k]);
            for (var j = 0u; j < specular_count; j++) {
                sum += shade_reflected(specular_lobes[j], point.normal);
            }
        }
    }
    return sum;
}

// Lights of specular reflection begin here: no prefiltered image stands for them.
fn shade_first_light() -> u32 {
    return select(0u, frame.light_count, frame.prefiltered_levels > 0u);
}

// Distant lights, then local ones as they reach the point.
fn shade_light(index: u32, position: vec3<f32>) -> SphericalGaussian {
    if index >= frame.light_count {
        return local_light_lobe(local_lights[index - frame.light_count], position);
    }
    let light = lights[index];
    return SphericalGaussian(light.axis, light.sharpness, light.amplitude);
}

// What one specular lobe reflects of the prefiltered image.
fn shade_reflected(lobe: SphericalGaussian, normal: vec3<f32>) -> vec3<f32> {
    let incoming = prefiltered_radiance(frame.environment_rotation * lobe.axis, lobe.sharpness);
    let image = spherical_gaussian_integral(lobe) * incoming;
    let even = SHADE_EVEN * lobe.amplitude * incoming;
    var reflected = even * shade_visible(lobe, SHADE_EVEN, normal);
    var through = vec3(0.0);
    for (var i = 0u; i < frame.light_count; i++) {
        let light = SphericalGaussian(lights[i].axis, lights[i].sharpness, lights[i].amplitude);
        let product = spherical_gaussian_product(light, lobe);
        let whole = spherical_gaussian_integral(product);
        if !shade_negligible(whole, through) {
            let share = shade_share(whole, through);
            through += whole;
            reflected += product.amplitude * shade_visible(product, share, normal);
        }
    }
    let wide = SHADE_DETAIL_SHARPNESS.x;
    let sharp = SHADE_DETAIL_SHARPNESS.y;
    let detail = clamp(log(lobe.sharpness / wide) / log(sharp / wide), 0.0, 1.0);
    let least = vec3(1.17549435e-38);
    return reflected * mix(through, image, detail) / max(through + SHADE_EVEN * image, least);
}

// What a lobe of the integral `whole` can add, in what has been gathered before, in the channel
// where that is most.
fn shade_share(whole: vec3<f32>, gathered: vec3<f32>) -> f32 {
    let shares = whole / max(gathered, vec3(SHADE_DARK));
    return max(max(shares.x, shares.y), shares.z);
}

fn shade_negligible(whole: vec3<f32>, gathered: vec3<f32>) -> bool {
    return all(whole <= SHADE_NEGLIGIBLE * gathered);
}
