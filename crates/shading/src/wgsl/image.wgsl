// Twin of what shade.rs knows of prefiltered images.

// What a Lambertian surface reflects of the image beyond the lights.
fn image_diffused(ssdf: Ssdf, point: SurfacePoint, diffuse: vec3<f32>) -> vec3<f32> {
    if all(diffuse == vec3(0.0)) {
        return vec3(0.0);
    }
    var seen = vec3(0.0);
    var whole = 0.0;
    for (var i = 0u; i <= SHADE_RING; i++) {
        var axis = point.normal;
        if i > 0u {
            let azimuth = 2.0 * PI * f32(i) / f32(SHADE_RING);
            let aside = point.tangent * cos(azimuth) + point.bitangent * sin(azimuth);
            axis = SHADE_RING_COSINE * axis + sqrt(1.0 - SHADE_RING_COSINE * SHADE_RING_COSINE) * aside;
        }
        let beyond = prefiltered_radiance(frames[frame_index].environment_rotation * axis, SHADE_RING_SHARPNESS);
        whole += tables_cosine_integral(SHADE_RING_SHARPNESS, dot(point.normal, axis));
        seen += beyond * ambient_integrate(ssdf, SHADE_RING_SHARPNESS, axis, point.normal);
    }
    return diffuse / PI * seen * (PI / whole);
}

// What a reflection's lobes show of the image, nothing in their way.
fn image_reflected(normal: vec3<f32>) -> vec3<f32> {
    var sum = vec3(0.0);
    for (var j = 0u; j < specular_count; j++) {
        let lobe = lobes_in_world(j);
        let part = lobe.amplitude * tables_cosine_integral(lobe.sharpness, dot(normal, lobe.axis));
        sum += part * prefiltered_radiance(frames[frame_index].environment_rotation * lobe.axis, lobe.sharpness);
    }
    return sum;
}

// What a specular reflection shows of the environment, in the places where the lights are visible:
// of `image` and of `scaled` lights, `visible` of which are, and `part` of a light from everywhere.
// Where the lights are dark, that alone tells.
fn image_seen(image: vec3<f32>, scaled: vec3<f32>, visible: vec3<f32>, part: f32) -> vec3<f32> {
    // Lobes that are not quite the model may miss more than there is.
    let unshadowed = max(image + scaled, SHADE_LEAST_OF_LIGHTS * scaled);
    let even = SHADE_EVEN * max(unshadowed, scaled);
    return unshadowed * (visible + even * part) / max(scaled + even, vec3(1.17549435e-38));
}
