// Twin of glossy.rs, and of evaluate_specular in models.rs. A reflection's lobes are those of
// lobes_shape and its siblings, in lobes.wgsl or slots.wgsl, read where they are needed: to keep
// them takes more registers than there are. All in the point's frame.

// What the reflection shows of `light`, as one Gaussian. Of no amplitude where there is nothing
// to see, or nothing beside `gathered`.
fn glossy_reflected(light: SphericalGaussian, gathered: vec3<f32>) -> SphericalGaussian {
    let whole = glossy_whole(light);
    let color = light.amplitude * lobes_color();
    if whole < GLOSSY_LEAST_MASS || all(GLOSSY_TAIL * whole * color <= SHADE_NEGLIGIBLE * gathered) {
        return SphericalGaussian(light.axis, light.sharpness, vec3(0.0));
    }
    // The part of the light up to which a product is faint.
    return glossy_joined(light, whole, glossy_faint(color, gathered));
}

// The integral of all products with a white light.
fn glossy_whole(light: SphericalGaussian) -> f32 {
    var whole = 0.0;
    for (var j = 0u; j < specular_count; j++) {
        let product = glossy_times(light, j);
        whole += product.amplitude.x * spherical_gaussian_energy(product.sharpness);
    }
    return whole;
}

// All products as one Gaussian, `whole` being their integral.
fn glossy_joined(light: SphericalGaussian, whole: f32, faint: f32) -> SphericalGaussian {
    // Directions are differences to one among them, which keeps the digits of narrow lobes.
    var origin = vec3(0.0);
    var used = 0.0;
    var total = vec3(0.0);
    var rest = 0.0;
    var squares = 0.0;
    var mean = vec3(0.0);
    for (var j = 0u; j < specular_count; j++) {
        let product = glossy_times(light, j);
        let part = product.amplitude.x * spherical_gaussian_energy(product.sharpness);
        if part >= GLOSSY_LEAST_PART * whole {
            if used == 0.0 {
                origin = product.axis;
            }
            used += part;
            let points = select(5u, 1u, part <= faint || part < GLOSSY_MINOR_PART * whole);
            let most = GLOSSY_EXCESS * spherical_gaussian_energy(light.sharpness);
            let scaled = glossy_scaled(product.axis, product.sharpness, part, most, points);
            total += scaled;
            let weight = glossy_sum(scaled);
            let short = glossy_shortening(product.sharpness);
            let offset = product.axis - origin;
            rest += weight * short;
            mean += weight * (1.0 - short) * offset;
            squares += weight * (1.0 - short) * dot(offset, offset);
        }
    }
    let mass = glossy_sum(total);
    if mass < GLOSSY_LEAST_MASS {
        return SphericalGaussian(light.axis, light.sharpness, vec3(0.0));
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
fn glossy_times(light: SphericalGaussian, j: u32) -> SphericalGaussian {
    let shape = lobes_shape(j);
    return spherical_gaussian_product(
        SphericalGaussian(light.axis, light.sharpness, vec3(1.0)),
        SphericalGaussian(shape.xyz, shape.w, vec3(lobes_grey(j))),
    );
}

// The largest part that adds at most GLOSSY_FAINT of `gathered` in every channel.
fn glossy_faint(color: vec3<f32>, gathered: vec3<f32>) -> f32 {
    let parts = GLOSSY_FAINT * gathered / max(color, vec3(1.17549435e-38));
    return min(min(parts.x, parts.y), parts.z);
}

// The integral of a product, `part`, as the model makes it: in all at most `most` times the
// model's value. Of five points the first `points`.
fn glossy_scaled(axis: vec3<f32>, sharpness: f32, part: f32, most: f32, points: u32) -> vec3<f32> {
    var sum = vec3(0.0);
    var whole = 0.0;
    for (var i = 0u; i < points; i++) {
        let direction = glossy_point(axis, sharpness, i);
        if direction.z > 0.0 {
            let lobes = glossy_lobes(direction);
            let weight = direction.z * select(GLOSSY_POINT_WEIGHT, GLOSSY_CENTER_WEIGHT, i == 0u);
            let model = models_specular(lobes_reflection(), direction, lobes_view());
            sum += weight * min(part / max(lobes, 1.17549435e-38), most) * model;
            whole += weight;
        }
    }
    return sum / max(whole, GLOSSY_LEAST_COSINE);
}

// The lobes' value.
fn glossy_lobes(direction: vec3<f32>) -> f32 {
    var sum = 0.0;
    for (var j = 0u; j < specular_count; j++) {
        let shape = lobes_shape(j);
        let chord = direction - shape.xyz;
        sum += lobes_grey(j) * exp(-0.5 * shape.w * dot(chord, chord));
    }
    return sum;
}

// The centre, or a point aside along one of two axes at right angles to it (Duff et al. 2017).
fn glossy_point(axis: vec3<f32>, sharpness: f32, i: u32) -> vec3<f32> {
    if i == 0u {
        return axis;
    }
    let reach = min(GLOSSY_POINT_DEVIATIONS / sqrt(sharpness + 0.5), GLOSSY_FARTHEST_POINT);
    let orientation = select(1.0, -1.0, axis.z < 0.0);
    let a = -1.0 / (orientation + axis.z);
    let b = axis.x * axis.y * a;
    var aside = vec3(1.0 + orientation * axis.x * axis.x * a, orientation * b, -orientation * axis.x);
    if i > 2u {
        aside = vec3(b, orientation + axis.y * axis.y * a, -axis.y);
    }
    return normalize(axis + select(reach, -reach, (i & 1u) == 0u) * aside);
}

fn glossy_sum(color: vec3<f32>) -> f32 {
    return color.x + color.y + color.z;
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
