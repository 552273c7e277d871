// Twin of local_light.rs.

fn local_light_lobe(light: LocalLight, point: vec3<f32>) -> SphericalGaussian {
    let offset = light.position - point;
    let squared = max(dot(offset, offset), 1.17549435e-38);
    let axis = offset / sqrt(squared);
    // 1 − cos of the angle that the sphere subtends; from inside it, a hemisphere.
    let sine_squared = min(light.radius * light.radius / squared, 1.0);
    let cap = sine_squared / (1.0 + sqrt(1.0 - sine_squared));
    let sharpness = min(2.0 / max(cap, 1.17549435e-38), LOCAL_LIGHT_MAX_SHARPNESS);
    let amplitude = 2.0 * PI * cap / spherical_gaussian_energy(sharpness);
    let cosine = -dot(light.direction, axis);
    let falloff = clamp(light.spot_scale * cosine + light.spot_offset, 0.0, 1.0);
    return SphericalGaussian(axis, sharpness, light.radiance * (amplitude * falloff * falloff));
}
