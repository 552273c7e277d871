// Twin of shade.rs: lobe by lobe, `ambient` or `polar`.

fn shade_lobes(point: SurfacePoint, gathered: vec3<f32>) -> vec3<f32> {
    var sum = gathered;
    let diffuse = point.appearance.diffuse / PI;
    let all = frame.light_count + frame.local_light_count;
    if any(diffuse != vec3(0.0)) {
        for (var i = 0u; i < all; i++) {
            let light = shade_light(i, point.position);
            let lobe = SphericalGaussian(light.axis, light.sharpness, light.amplitude * diffuse);
            sum += shade_lobe(lobe, point.normal, sum);
        }
    }
    let begin = shade_first_light();
    if begin < all {
        for (var k = 0u; k < reflection_count; k++) {
            brdf_specular_lobes(point, reflections[k]);
            for (var i = begin; i < all; i++) {
                let light = shade_light(i, point.position);
                let lobe = glossy_reflected(point, reflections[k], light, sum);
                sum += shade_lobe(lobe, point.normal, sum);
            }
        }
    }
    return sum;
}

// What a lobe adds to the radiance gathered so far.
fn shade_lobe(lobe: SphericalGaussian, normal: vec3<f32>, gathered: vec3<f32>) -> vec3<f32> {
    let whole = spherical_gaussian_integral(lobe);
    if shade_negligible(whole, gathered) {
        return vec3(0.0);
    }
    return lobe.amplitude * shade_visible(lobe, shade_share(whole, gathered), normal);
}

fn shade_visible(lobe: SphericalGaussian, share: f32, normal: vec3<f32>) -> f32 {
    if frame.method == METHOD_AMBIENT {
        return ambient_integrate(lobe.sharpness, lobe.axis, normal);
    }
    return polar_integrate(lobe.sharpness, lobe.axis, normal, polar_spokes(frame.spokes, share));
}
