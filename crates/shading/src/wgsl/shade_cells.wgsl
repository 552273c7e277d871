// Twin of shade.rs: `cells`, for many lobes at a time.

fn shade_lobes(point: SurfacePoint, gathered: vec3<f32>, seen: Seen) -> vec3<f32> {
    var sum = gathered;
    let all = frame.light_count + frame.local_light_count;
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
    for (var k = 0u; k < reflection_count; k++) {
        cells_reflection = surface_reflection(k);
        brdf_specular_lobes(point, cells_reflection);
        cells_kind = CELLS_PRODUCTS;
        let around = cells_around();
        sum += cells_integrate(around.xyz, around.w, point.normal);
        sum += shade_narrow(point.normal);
    }
    return sum;
}

// What `cells_reflection` makes of narrow lights.
fn shade_narrow(normal: vec3<f32>) -> vec3<f32> {
    var sum = vec3(0.0);
    let all = frame.light_count + frame.local_light_count;
    var carried = vec3(0.0);
    for (var i = cells_first_light; i < all; i++) {
        let light = shade_light(i, cells_point.position);
        let lobe = glossy_reflected(cells_point, cells_reflection, light, vec3(0.0));
        carried += spherical_gaussian_integral(lobe);
    }
    for (var i = cells_first_light; i < all; i++) {
        let light = shade_light(i, cells_point.position);
        if light.sharpness <= CELLS_NARROW {
            continue;
        }
        let lobe = glossy_reflected(cells_point, cells_reflection, light, vec3(0.0));
        if !shade_negligible(spherical_gaussian_integral(lobe), carried) {
            sum += shade_single(lobe, normal);
        }
    }
    return sum;
}

// The pole for the products of lights with `specular_lobes`, and how far cells have to reach
// from it.
fn cells_around() -> vec4<f32> {
    var mean = vec3(0.0);
    for (var j = 0u; j < specular_count; j++) {
        let lobe = specular_lobes[j];
        mean += lobe.axis * cells_luminance(spherical_gaussian_integral(lobe));
    }
    let size = length(mean);
    var pole = vec3(0.0, 1.0, 0.0);
    if size > 0.0 {
        pole = mean / size;
    }
    var reach = 0.0;
    for (var j = 0u; j < specular_count; j++) {
        let lobe = specular_lobes[j];
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

fn shade_visible(lobe: SphericalGaussian, share: f32, normal: vec3<f32>) -> f32 {
    return shade_single(SphericalGaussian(lobe.axis, lobe.sharpness, vec3(1.0)), normal).x;
}
