// Twin of shade.rs: what its kernels share.

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

// What a lobe of the integral `whole` can add, in what has been gathered before, in the channel
// where that is most.
fn shade_share(whole: vec3<f32>, gathered: vec3<f32>) -> f32 {
    let shares = whole / max(gathered, vec3(SHADE_DARK));
    return max(max(shares.x, shares.y), shares.z);
}

fn shade_negligible(whole: vec3<f32>, gathered: vec3<f32>) -> bool {
    return all(whole <= SHADE_NEGLIGIBLE * gathered);
}

// The frame's reflected image through a lobe.
fn prefiltered_radiance(axis: vec3<f32>, sharpness: f32) -> vec3<f32> {
    return prefiltered_levels_radiance(frame.prefiltered_levels, axis, sharpness);
}
