// Twin of visible in shade.rs, `ambient` or `polar`.

// ∫ exp(λ(p·ω − 1)) max(n·ω, 0) V(ω) dω, more closely for a larger `share`.
fn shade_visible(lobe: SphericalGaussian, share: f32, normal: vec3<f32>) -> f32 {
    if frame.method == METHOD_AMBIENT {
        return ambient_integrate(lobe.sharpness, lobe.axis, normal);
    }
    return polar_integrate(lobe.sharpness, lobe.axis, normal, polar_spokes(frame.spokes, share));
}
