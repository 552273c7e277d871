// Twin of glossy.rs, and of evaluate_specular in reference.rs. A reflection's lobes are in the
// private variables of brdf.wgsl: call brdf_specular_lobes first.

// What the reflection shows of `light`, as one Gaussian. Of no amplitude where there is nothing
// to see, or nothing beside `gathered`.
fn glossy_reflected(
    point: SurfacePoint,
    reflection: Reflection,
    light: SphericalGaussian,
    gathered: vec3<f32>,
) -> SphericalGaussian {
    let none = SphericalGaussian(light.axis, light.sharpness, vec3(0.0));
    var whole = 0.0;
    for (var j = 0u; j < specular_count; j++) {
        let product = glossy_times(light, specular_lobes[j]);
        whole += product.amplitude.x * spherical_gaussian_energy(product.sharpness);
    }
    let first = specular_lobes[0];
    let color = light.amplitude * (first.amplitude / glossy_grey(first));
    if whole < GLOSSY_LEAST_MASS || all(GLOSSY_TAIL * whole * color <= SHADE_NEGLIGIBLE * gathered) {
        return none;
    }
    // Directions are differences to one among them, which keeps the digits of narrow lobes.
    var origin = vec3(0.0);
    var used = 0.0;
    var total = vec3(0.0);
    var mass = 0.0;
    var rest = 0.0;
    var squares = 0.0;
    var mean = vec3(0.0);
    let most = GLOSSY_EXCESS * spherical_gaussian_energy(light.sharpness);
    for (var j = 0u; j < specular_count; j++) {
        let product = glossy_times(light, specular_lobes[j]);
        let part = product.amplitude.x * spherical_gaussian_energy(product.sharpness);
        if part < GLOSSY_LEAST_PART * whole {
            continue;
        }
        if used == 0.0 {
            origin = product.axis;
        }
        used += part;
        let faint = all(part * color <= GLOSSY_FAINT * gathered);
        let points = select(5u, 1u, faint || part < GLOSSY_MINOR_PART * whole);
        let scaled = glossy_scaled(point, reflection, product, part, most, points);
        total += scaled;
        let weight = scaled.x + scaled.y + scaled.z;
        let short = glossy_shortening(product.sharpness);
        let offset = product.axis - origin;
        mass += weight;
        rest += weight * short;
        mean += weight * (1.0 - short) * offset;
        squares += weight * (1.0 - short) * dot(offset, offset);
    }
    if mass < GLOSSY_LEAST_MASS {
        return none;
    }
    rest /= mass;
    mean /= mass;
    squares /= mass;
    // 1 - |m|^2 for the mean vector m = (1 - rest) origin + mean, without the difference of
    // nearly equal numbers: origin . mean is half the sum of squared offsets, below 0.
    let unclamped = rest * (2.0 - rest) + (1.0 - rest) * squares - dot(mean, mean);
    let spread = clamp(unclamped, GLOSSY_LEAST_SPREAD, 1.0);
    let sharpness = sqrt(1.0 - spread) * (2.0 + spread) / spread;
    let scale = whole / (used * spherical_gaussian_energy(sharpness));
    return SphericalGaussian(
        glossy_unit_or((1.0 - rest) * origin + mean, origin),
        sharpness,
        light.amplitude * total * scale,
    );
}

// The product of a white light of this shape and a lobe without its colour.
fn glossy_times(light: SphericalGaussian, lobe: SphericalGaussian) -> SphericalGaussian {
    return spherical_gaussian_product(
        SphericalGaussian(light.axis, light.sharpness, vec3(1.0)),
        SphericalGaussian(lobe.axis, lobe.sharpness, vec3(glossy_grey(lobe))),
    );
}

// The integral of a product, `part`, as the model makes it: in all at most `most` times the
// model's value. Of five points the first `points`.
fn glossy_scaled(
    point: SurfacePoint,
    reflection: Reflection,
    product: SphericalGaussian,
    part: f32,
    most: f32,
    points: u32,
) -> vec3<f32> {
    let view = surface_to_local(point, point.view);
    let reach = min(GLOSSY_POINT_DEVIATIONS / sqrt(product.sharpness + 0.5), GLOSSY_FARTHEST_POINT);
    // Duff et al. 2017.
    let axis = product.axis;
    let orientation = select(1.0, -1.0, axis.z < 0.0);
    let a = -1.0 / (orientation + axis.z);
    let b = axis.x * axis.y * a;
    let u = vec3(1.0 + orientation * axis.x * axis.x * a, orientation * b, -orientation * axis.x);
    let v = vec3(b, orientation + axis.y * axis.y * a, -axis.y);
    var sum = vec3(0.0);
    var whole = 0.0;
    for (var i = 0u; i < points; i++) {
        var offset = vec3(0.0);
        var weight = GLOSSY_CENTER_WEIGHT;
        if i > 0u {
            offset = select(u, v, i > 2u) * select(reach, -reach, (i & 1u) == 0u);
            weight = GLOSSY_POINT_WEIGHT;
        }
        let direction = normalize(axis + offset);
        let local = surface_to_local(point, direction);
        if local.z > 0.0 {
            var lobes = 0.0;
            for (var j = 0u; j < specular_count; j++) {
                let value = spherical_gaussian_evaluate(specular_lobes[j], direction);
                lobes += value.x + value.y + value.z;
            }
            let model = reference_specular(reflection, local, view);
            let times = min(part / max(lobes, 1.17549435e-38), most);
            sum += weight * local.z * times * model;
            whole += weight * local.z;
        }
    }
    return sum / max(whole, GLOSSY_LEAST_COSINE);
}

// A lobe's weight without its colour, which all lobes of a reflection share.
fn glossy_grey(lobe: SphericalGaussian) -> f32 {
    return lobe.amplitude.x + lobe.amplitude.y + lobe.amplitude.z;
}

// By how much a lobe's mean vector is shorter than 1: 1 - coth x + 1/x.
fn glossy_shortening(sharpness: f32) -> f32 {
    if sharpness < 0.25 {
        return 1.0 - sharpness * (1.0 / 3.0 - sharpness * sharpness / 45.0);
    }
    return 1.0 / sharpness - 2.0 / (exp(2.0 * min(sharpness, 40.0)) - 1.0);
}

fn glossy_unit_or(vector: vec3<f32>, otherwise: vec3<f32>) -> vec3<f32> {
    let squared = dot(vector, vector);
    if squared > 1e-30 {
        return vector / sqrt(squared);
    }
    return otherwise;
}
