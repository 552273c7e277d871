// Twin of shade.rs: lobe by lobe, `ambient` or `polar`. The Lambertian base has its irradiance from
// diffuse.wgsl.

fn shade_lobes(point: SurfacePoint, gathered: vec3<f32>, seen: Seen) -> vec3<f32> {
    let all = frame.light_count + frame.local_light_count;
    let base = point.appearance.diffuse / PI * textureLoad(irradiance, seen.pixel, 0).xyz;
    var sum = gathered + base;
    let begin = shade_first_light();
    if begin < all {
        let holds = vertex_visibility_holds(point.vertex_cosine);
        for (var k = 0u; k < reflection_count; k++) {
            let reflection = surface_reflection(k);
            brdf_specular_lobes(point, reflection);
                    for (var i = begin; i < all; i++) {
                let fractions = vertex_visibility_of(i, holds, seen.corners, seen.barycentrics);
                let light = shade_light(i, point.position);
                let lobe = glossy_reflected(point, reflection, light, sum);
                let whole = spherical_gaussian_integral(lobe);
                if !shade_negligible(whole, sum) {
                    let share = shade_share(whole, sum);
                    sum += lobe.amplitude * shade_about(fractions, light, lobe, share, point.normal);
                }
            }
        }
    }
    return sum;
}
