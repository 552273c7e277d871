// Twin of glossy.rs, and of evaluate_specular in models.rs. A reflection's lobes are those of
// lobes_shape and its siblings, in lobes.wgsl or slots.wgsl, read where they are needed: to keep
// them takes more registers than there are. All in the point's frame.

// What the reflection shows of a light is one Gaussian: glossy_begin, glossy_add for every point, glossy_end. A loop over
// points that ends with glossy_end within its last round leaves nothing to be kept through the loops about it, as
// compilers do with all that is used after a loop.

// Of the products with one light.
struct GlossySum {
    // Their integral times the cosine, those that are left out included, and the part of the light up to which a product is faint.
    whole: f32,
    faint: f32,
    // How much points count for beside lobes.
    by_points: f32,
    // Directions are differences to one among them, which keeps the digits of narrow lobes.
    origin: vec3<f32>,
    used: f32,
    total: vec3<f32>,
    rest: f32,
    squares: f32,
    mean: vec3<f32>,
}

// Whether there is anything to see of `light` beside `gathered`.
fn glossy_begin(light: SphericalGaussian, gathered: vec3<f32>) -> bool {
    let whole = glossy_whole(light);
    let color = light.amplitude * lobes_color();
    let faint = glossy_faint(color, gathered);
    let by_points = glossy_by_points(light.sharpness, whole.y);
    lobes_put_sum(GlossySum(whole.x, faint, by_points, vec3(0.0), 0.0, vec3(0.0), 0.0, 0.0, vec3(0.0)));
    glossy_lobe = GlossyLobe(vec3(0.0), 0.0, vec3(0.0), 0.0, 0.0, 0u);
    return whole.x >= GLOSSY_LEAST_MASS && !all(GLOSSY_TAIL * whole.x * color <= SHADE_NEGLIGIBLE * gathered);
}

// The integral of all products with a white light times the cosine, at most, and the mean sharpness of their lobes.
fn glossy_whole(light: SphericalGaussian) -> vec2<f32> {
    var whole = vec2(0.0);
    for (var j = 0u; j < specular_count; j++) {
        let product = glossy_times(light, j);
        let part = product.amplitude.x * spherical_gaussian_energy(product.sharpness);
        whole += part * glossy_most_cosine(product.sharpness, product.axis.z) * vec2(1.0, lobes_shape(j).w);
    }
    return vec2(whole.x, whole.y / max(whole.x, GLOSSY_LEAST_MASS));
}

// How much points count for beside lobes, for a light of some sharpness on lobes whose mean is `own`.
fn glossy_by_points(light: f32, own: f32) -> f32 {
    let sharp = light * (lobes_view().z + GLOSSY_VIEW_COSINE);
    return select(1.0, sharp / max(sharp + GLOSSY_LOBE_PART * own, 1.17549435e-38), lobes_reflection().ratio == 0u);
}

// A bound on glossy_mean_cosine, near it for lobes that are narrow and above the horizon.
fn glossy_most_cosine(sharpness: f32, cosine: f32) -> f32 {
    return max(cosine, 0.0) + GLOSSY_DEVIATION_COSINE / sqrt(sharpness + 1.0);
}

// Of a lobe's integral the part that is left of it times the cosine with the normal, to which its axis has `cosine`.
fn glossy_mean_cosine(sharpness: f32, cosine: f32) -> f32 {
    return tables_cosine_integral(sharpness, cosine) / spherical_gaussian_energy(sharpness);
}

// Of one lobe: its product, what points that look at the model found, and their weight; the product's integral, and how
// many points look.
struct GlossyLobe {
    axis: vec3<f32>,
    sharpness: f32,
    sum: vec3<f32>,
    whole: f32,
    part: f32,
    points: u32,
}

var<private> glossy_lobe: GlossyLobe;

// Points of all lobes, of each GLOSSY_POINTS.
fn glossy_count() -> u32 {
    return GLOSSY_POINTS * specular_count;
}

// How many points of a product, with a light that is much sharper or not, look at the model.
fn glossy_points(shown: f32, is_sharper: bool) -> u32 {
    let whole = lobes_sum().whole;
    let one = is_sharper || shown <= lobes_sum().faint || shown < GLOSSY_MINOR_PART * whole;
    return select(select(GLOSSY_POINTS, 1u, one), 0u, shown < GLOSSY_LEAST_PART * whole);
}

// The integral of the product times the cosine, at most.
fn glossy_shown() -> f32 {
    return glossy_lobe.part * glossy_most_cosine(glossy_lobe.sharpness, glossy_lobe.axis.z);
}

// The point to go on with is returned.
fn glossy_add(light: SphericalGaussian, index: u32) -> u32 {
    let i = index % GLOSSY_POINTS;
    if i == 0u {
        let product = glossy_times(light, index / GLOSSY_POINTS);
        let part = product.amplitude.x * spherical_gaussian_energy(product.sharpness);
        glossy_lobe = GlossyLobe(product.axis, product.sharpness, vec3(0.0), 0.0, part, 0u);
        let is_sharper = light.sharpness > GLOSSY_SHARPER * lobes_shape(index / GLOSSY_POINTS).w;
        glossy_lobe.points = glossy_points(glossy_shown(), is_sharper);
    }
    if i < glossy_lobe.points {
        glossy_look(i, GLOSSY_EXCESS * spherical_gaussian_energy(light.sharpness));
        if i + 1u == glossy_lobe.points {
            let by_points = glossy_lobe.sum / max(glossy_lobe.whole, GLOSSY_LEAST_COSINE);
            let scaled = mix(glossy_lobe.part * lobes_color(), by_points, lobes_sum().by_points);
            glossy_join(scaled * glossy_mean_cosine(glossy_lobe.sharpness, glossy_lobe.axis.z));
        }
    }
    return index + select(1u, GLOSSY_POINTS - i, i + 1u >= glossy_lobe.points);
}

// The integral of a product, as one point says that the model makes it: in all at most `most` times the
// model's value.
fn glossy_look(i: u32, most: f32) {
    let direction = glossy_point(glossy_lobe.axis, glossy_lobe.sharpness, i);
    if direction.z > 0.0 {
        let lobes = glossy_lobes(direction);
        let weight = direction.z * select(GLOSSY_POINT_WEIGHT, GLOSSY_CENTER_WEIGHT, i == 0u);
        let model = models_specular(lobes_reflection(), direction, lobes_view());
        glossy_lobe.sum += weight * min(glossy_lobe.part / max(lobes, 1.17549435e-38), most) * model;
        glossy_lobe.whole += weight;
    }
}

// What all points say.
fn glossy_join(scaled: vec3<f32>) {
    var sum = lobes_sum();
    if sum.used == 0.0 {
        sum.origin = glossy_lobe.axis;
    }
    sum.used += glossy_shown();
    sum.total += scaled;
    let weight = glossy_channels(scaled);
    let short = glossy_shortening(glossy_lobe.sharpness);
    let offset = glossy_lobe.axis - sum.origin;
    sum.rest += weight * short;
    sum.mean += weight * (1.0 - short) * offset;
    sum.squares += weight * (1.0 - short) * dot(offset, offset);
    lobes_put_sum(sum);
}

// The Gaussian. Of no amplitude where there is nothing to see.
fn glossy_end(light: SphericalGaussian) -> SphericalGaussian {
    let sum = lobes_sum();
    let mass = glossy_channels(sum.total);
    if mass < GLOSSY_LEAST_MASS {
        return SphericalGaussian(light.axis, light.sharpness, vec3(0.0));
    }
    let rest = sum.rest / mass;
    let mean = sum.mean / mass;
    let squares = sum.squares / mass;
    // 1 - |m|^2 for the mean vector m = (1 - rest) origin + mean, without the difference of
    // nearly equal numbers: origin . mean is half the sum of squared offsets, below 0.
    let unclamped = rest * (2.0 - rest) + (1.0 - rest) * squares - dot(mean, mean);
    let spread = clamp(unclamped, GLOSSY_LEAST_SPREAD, 1.0);
    let sharpness = sqrt(1.0 - spread) * (2.0 + spread) / spread;
    let axis = glossy_unit_or((1.0 - rest) * sum.origin + mean, sum.origin);
    let mean_cosine = max(glossy_mean_cosine(sharpness, axis.z), GLOSSY_LEAST_MEAN_COSINE);
    let integral = spherical_gaussian_energy(sharpness) * mean_cosine;
    let scale = sum.whole / (sum.used * integral);
    return SphericalGaussian(axis, sharpness, light.amplitude * sum.total * scale);
}

// All of it, for kernels that have registers.
fn glossy_reflected(light: SphericalGaussian, gathered: vec3<f32>) -> SphericalGaussian {
    if !glossy_begin(light, gathered) {
        return SphericalGaussian(light.axis, light.sharpness, vec3(0.0));
    }
    for (var i = 0u; i < glossy_count();) {
        i = glossy_add(light, i);
    }
    return glossy_end(light);
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

fn glossy_channels(color: vec3<f32>) -> f32 {
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
