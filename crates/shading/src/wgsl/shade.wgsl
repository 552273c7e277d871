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
    textureStore(radiance, pixel, vec4(shade(point), 1.0));
}

fn shade(point: SurfacePoint) -> vec3<f32> {
    var sum = vec3(0.0);
    if dot(point.normal, point.view) <= 0.0 {
        return sum;
    }
    let diffuse = point.appearance.diffuse / PI;
    if any(diffuse != vec3(0.0)) {
        for (var i = 0u; i < frame.light_count; i++) {
            let light = shade_light(i);
            let lobe = SphericalGaussian(light.axis, light.sharpness, light.amplitude * diffuse);
            sum += shade_lobe(lobe, point.normal, sum);
        }
    }
    for (var k = 0u; k < reflection_count; k++) {
        brdf_specular_lobes(point, reflections[k]);
        for (var i = 0u; i < frame.light_count; i++) {
            let light = shade_light(i);
            for (var j = 0u; j < specular_count; j++) {
                let lobe = spherical_gaussian_product(light, specular_lobes[j]);
                sum += shade_lobe(lobe, point.normal, sum);
            }
        }
    }
    return sum;
}

fn shade_light(index: u32) -> SphericalGaussian {
    let light = lights[index];
    return SphericalGaussian(light.axis, light.sharpness, light.amplitude);
}

// What a lobe adds to the radiance gathered so far.
fn shade_lobe(lobe: SphericalGaussian, normal: vec3<f32>, gathered: vec3<f32>) -> vec3<f32> {
    if all(spherical_gaussian_integral(lobe) <= SHADE_NEGLIGIBLE * gathered) {
        return vec3(0.0);
    }
    if frame.method == METHOD_AMBIENT {
        return lobe.amplitude * ambient_integrate(lobe.sharpness, lobe.axis, normal);
    }
    return lobe.amplitude * polar_integrate(lobe.sharpness, lobe.axis, normal, frame.spokes);
}
