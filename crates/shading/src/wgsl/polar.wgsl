// Twin of polar.rs.

fn polar_integrate(sharpness: f32, axis: vec3<f32>, normal: vec3<f32>, spokes: u32) -> f32 {
    let cosine = dot(normal, axis);
    let unoccluded = tables_cosine_integral(sharpness, cosine);
    let support = polar_support_radius(sharpness);
    let distance = ssdf_distance(axis);
    if distance >= support {
        return unoccluded;
    }
    if distance <= -support {
        return 0.0;
    }
    let projected = normal - cosine * axis;
    let sine = length(projected);
    var tangent = polar_any_orthogonal(axis);
    if sine > 1e-4 {
        tangent = projected / sine;
    }
    let bitangent = cross(axis, tangent);
    var visible = 0.0;
    var whole = 0.0;
    for (var k = 0u; k < spokes; k++) {
        let azimuth = 2.0 * PI * (f32(k) + 0.5) / f32(spokes);
        let outward = cos(azimuth) * tangent + sin(azimuth) * bitangent;
        // Along the spoke n·ω = cosine cos θ + slope sin θ, which changes sign once.
        let slope = sine * cos(azimuth);
        let horizon = atan2(abs(cosine), select(-slope, slope, cosine < 0.0));
        let start = select(0.0, min(horizon, support), cosine < 0.0);
        let end = select(min(horizon, support), support, cosine < 0.0);
        var theta = start;
        var here = distance;
        if start > 0.0 {
            here = ssdf_distance(axis * cos(start) + outward * sin(start));
        }
        let first = polar_moment(sharpness, cosine, slope, start);
        var entered = first;
        while theta < end {
            let next = min(theta + max(POLAR_SAFETY * abs(here), POLAR_SHORTEST_STEP * support), end);
            let there = ssdf_distance(axis * cos(next) + outward * sin(next));
            if (here > 0.0) != (there > 0.0) {
                let crossing = theta + (next - theta) * here / (here - there);
                let value = polar_moment(sharpness, cosine, slope, crossing);
                if here > 0.0 {
                    visible += value - entered;
                }
                entered = value;
            }
            theta = next;
            here = there;
        }
        let last = polar_moment(sharpness, cosine, slope, end);
        if here > 0.0 {
            visible += last - entered;
        }
        whole += last - first;
    }
    return select(0.0, unoccluded * clamp(visible / whole, 0.0, 1.0), whole > 0.0);
}

fn polar_support_radius(sharpness: f32) -> f32 {
    let half_chord = sqrt(POLAR_CUT_EXPONENT / max(sharpness, 1.17549435e-38));
    return 2.0 * asin(min(half_chord, 1.0));
}

fn polar_moment(sharpness: f32, cosine: f32, slope: f32, theta: f32) -> f32 {
    let half_chord = sin(0.5 * theta);
    return cosine * spherical_gaussian_cosine_moment(sharpness, 2.0 * half_chord * half_chord)
        + slope * tables_sine_squared_moment(sharpness, half_chord);
}

fn polar_any_orthogonal(axis: vec3<f32>) -> vec3<f32> {
    let other = select(vec3(1.0, 0.0, 0.0), vec3(0.0, 1.0, 0.0), abs(axis.x) > 0.7);
    return normalize(cross(axis, other));
}
