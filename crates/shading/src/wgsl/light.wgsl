// Twin of shade.rs: what its kernels share.

// Lights of specular reflection begin here: no prefiltered image stands for them.
fn shade_first_light() -> u32 {
    return select(0u, frames[frame_index].light_count, frames[frame_index].prefiltered_levels > 0u);
}

// Those of an instance follow those of the one before.
fn light_entry(index: u32) -> Light {
    return lights[frame_index * (frames[frame_index].light_count + 2u * frames[frame_index].local_light_count) + index];
}

fn light_distant(index: u32) -> SphericalGaussian {
    let light = light_entry(index);
    return SphericalGaussian(light.axis, light.sharpness, light.amplitude);
}

// Two entries each.
fn light_local(index: u32) -> LocalLight {
    let place = light_entry(frames[frame_index].light_count + 2u * index);
    let spot = light_entry(frames[frame_index].light_count + 2u * index + 1u);
    return LocalLight(
        place.axis,
        place.sharpness,
        place.amplitude,
        place.vertex_spokes,
        spot.axis,
        spot.sharpness,
    );
}

// Distant lights, then local ones as they reach the point.
fn shade_light(index: u32, position: vec3<f32>) -> SphericalGaussian {
    if index >= frames[frame_index].light_count {
        return local_light_lobe(light_local(index - frames[frame_index].light_count), position);
    }
    return light_distant(index);
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
    return prefiltered_levels_radiance(frames[frame_index].prefiltered_levels, axis, sharpness);
}
