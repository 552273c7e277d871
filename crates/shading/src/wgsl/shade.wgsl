// Twin of shade.rs, and the entry point that shades one pixel per invocation.

@compute @workgroup_size(8, 8)
fn shade_main(@builtin(global_invocation_id) id: vec3<u32>) {
    let pixel = id.xy + vec2(frame.first_column, frame.first_row);
    let seen = seen_triangle(pixel);
    if seen.x >= frame.triangle_count {
        return;
    }
    let triangle = triangles[seen.x];
    let corners = triangle.xyz;
    let weights = seen_barycentrics(corners, pixel, seen.y);
    let point = surface_point(corners, triangle.w & 0xffffu, weights);
    ssdf_load(clusters[triangle.w >> 16u], corners, weights);
    // First, so that lobes that add nothing to it are left out.
    var sources = vec3(0.0);
    for (var source = 0u; source < frame.source_count; source++) {
        sources += textureLoad(source_radiance, pixel, source, 0).xyz;
    }
    let direct = shade(point, sources, Seen(pixel, corners, weights));
    var bounced = vec3(0.0);
    if SHADE_BOUNCED {
        bounced = transfer_reflected(point, corners, weights);
    }
    let emitted = surface_emission(corners, triangle.w & 0xffffu, weights);
    textureStore(radiance, pixel, vec4(direct + bounced + emitted, 1.0));
}

// Where a point was seen.
struct Seen {
    pixel: vec2<u32>,
    corners: vec3<u32>,
    barycentrics: vec3<f32>,
}

// What pipelines are made without where it is not needed: a prefiltered image, bounced light.
override SHADE_PREFILTERED: bool = true;
override SHADE_BOUNCED: bool = true;

// `gathered`: what sources add to the radiance.
fn shade(point: SurfacePoint, gathered: vec3<f32>, seen: Seen) -> vec3<f32> {
    if dot(point.normal, point.view) <= 0.0 {
        return vec3(0.0);
    }
    var sum = shade_lobes(point, gathered, seen);
    if SHADE_PREFILTERED && frame.prefiltered_levels > 0u {
        sum += shade_diffused(point);
        for (var k = 0u; k < reflection_count; k++) {
            let reflection = surface_reflection(k);
            brdf_specular_lobes(point, reflection);
            sum += shade_reflected(point, reflection, seen);
        }
    }
    return max(sum, vec3(0.0));
}

// What a Lambertian surface reflects of the image beyond the lights.
fn shade_diffused(point: SurfacePoint) -> vec3<f32> {
    let diffuse = point.appearance.diffuse / PI;
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
        let beyond = prefiltered_radiance(frame.environment_rotation * axis, SHADE_RING_SHARPNESS);
        whole += tables_cosine_integral(SHADE_RING_SHARPNESS, dot(point.normal, axis));
        seen += beyond * ambient_integrate(SHADE_RING_SHARPNESS, axis, point.normal);
    }
    return diffuse * seen * (PI / whole);
}

// What a specular reflection shows of the environment, in the places where the lights are
// visible.
fn shade_reflected(point: SurfacePoint, reflection: Reflection, seen: Seen) -> vec3<f32> {
    var image = vec3(0.0);
    for (var j = 0u; j < specular_count; j++) {
        let lobe = specular_lobes[j];
        let part = lobe.amplitude * tables_cosine_integral(lobe.sharpness, dot(point.normal, lobe.axis));
        image += part * prefiltered_radiance(frame.environment_rotation * lobe.axis, lobe.sharpness);
    }
    var scaled = vec3(0.0);
    var visible = vec3(0.0);
    let holds = vertex_visibility_holds(point.vertex_cosine);
    for (var i = 0u; i < frame.light_count; i++) {
        let fractions = vertex_visibility_of(i, holds, seen.corners, seen.barycentrics);
        let light = shade_light(i, point.position);
        let lobe = glossy_reflected(point, reflection, light, scaled);
        let cosine = dot(point.normal, lobe.axis);
        let whole = lobe.amplitude * tables_cosine_integral(lobe.sharpness, cosine);
        if !shade_negligible(whole, scaled) {
            let share = shade_share(whole, scaled);
            scaled += whole;
            visible += lobe.amplitude * shade_about(fractions, light, lobe, share, point.normal);
        }
    }
    // Lobes that are not quite the model may miss more than there is.
    let unshadowed = max(image + scaled, SHADE_LEAST_OF_LIGHTS * scaled);
    // The part of a light from everywhere that is visible: where the lights are dark, it alone
    // tells.
    let white = SphericalGaussian(point.normal, 0.0, vec3(1.0));
    let everywhere = glossy_reflected(point, reflection, white, vec3(0.0));
    if all(everywhere.amplitude == vec3(0.0)) {
        return vec3(0.0);
    }
    let cosine = dot(point.normal, everywhere.axis);
    let whole = tables_cosine_integral(everywhere.sharpness, cosine);
    let part = shade_visible(everywhere, SHADE_EVEN, point.normal) / max(whole, 1.17549435e-38);
    let even = SHADE_EVEN * max(unshadowed, scaled);
    return unshadowed * (visible + even * part) / max(scaled + even, vec3(1.17549435e-38));
}

// What is visible of a lobe that is about a light.
fn shade_about(
    fractions: LightFractions,
    light: SphericalGaussian,
    lobe: SphericalGaussian,
    share: f32,
    normal: vec3<f32>,
) -> f32 {
    let fraction = vertex_visibility_whole(fractions, light, lobe);
    if fraction >= 0.0 {
        return fraction * tables_cosine_integral(lobe.sharpness, dot(normal, lobe.axis));
    }
    return shade_visible(lobe, share, normal);
}
