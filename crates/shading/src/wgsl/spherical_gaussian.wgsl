// Twin of spherical_gaussian.rs.

struct SphericalGaussian {
    axis: vec3<f32>,
    sharpness: f32,
    amplitude: vec3<f32>,
}

fn spherical_gaussian_product(a: SphericalGaussian, b: SphericalGaussian) -> SphericalGaussian {
    let sum = a.sharpness * a.axis + b.sharpness * b.axis;
    let sharpness = length(sum);
    let chord = a.axis - b.axis;
    let total = max(sharpness + a.sharpness + b.sharpness, 1.17549435e-38);
    let exponent = -a.sharpness * b.sharpness / total * dot(chord, chord);
    // Equal lobes back to back have a constant product: any axis will do.
    var axis = a.axis;
    if sharpness > 0.0 {
        axis = sum / sharpness;
    }
    return SphericalGaussian(axis, sharpness, a.amplitude * b.amplitude * exp(exponent));
}

fn spherical_gaussian_integral(lobe: SphericalGaussian) -> vec3<f32> {
    return lobe.amplitude * spherical_gaussian_energy(lobe.sharpness);
}

fn spherical_gaussian_energy(sharpness: f32) -> f32 {
    return 2.0 * PI * spherical_gaussian_sine_moment(sharpness, 2.0);
}

fn spherical_gaussian_first_moment(sharpness: f32) -> f32 {
    return 2.0 * PI * spherical_gaussian_cosine_moment(sharpness, 2.0);
}

fn spherical_gaussian_sine_moment(sharpness: f32, q: f32) -> f32 {
    return q * spherical_gaussian_decay_0(sharpness * q);
}

fn spherical_gaussian_cosine_moment(sharpness: f32, q: f32) -> f32 {
    return q * (spherical_gaussian_decay_0(sharpness * q) - q * spherical_gaussian_decay_1(sharpness * q));
}

fn spherical_gaussian_decay_0(z: f32) -> f32 {
    if z < SPHERICAL_GAUSSIAN_SERIES_LIMIT {
        return 1.0 - z * (1.0 / 2.0 - z * (1.0 / 6.0 - z * (1.0 / 24.0 - z / 120.0)));
    }
    return (1.0 - exp(-z)) / z;
}

fn spherical_gaussian_decay_1(z: f32) -> f32 {
    if z < SPHERICAL_GAUSSIAN_SERIES_LIMIT {
        return 1.0 / 2.0 - z * (1.0 / 3.0 - z * (1.0 / 8.0 - z * (1.0 / 30.0 - z / 144.0)));
    }
    return (1.0 - (1.0 + z) * exp(-z)) / (z * z);
}
