// Twin of polar.rs.

// Spokes of a lobe that can add `share` times what has been gathered before.
fn polar_spokes(spokes: u32, share: f32) -> u32 {
    let power = pow(min(share, 1.0), POLAR_SPOKES_EXPONENT);
    let factor = max(POLAR_MOST_SPOKES * power, POLAR_LEAST_SPOKES);
    return max(u32(f32(spokes) * factor + 0.5), 1u);
}

// Whether a lobe whose axis has this cosine with the normal reaches above the horizon.
fn polar_meets_horizon(sharpness: f32, cosine: f32) -> bool {
    return cosine > -sin(min(polar_support_radius(sharpness), 0.5 * PI));
}

fn polar_integrate(
    ssdf: Ssdf,
    sharpness: f32,
    axis: vec3<f32>,
    normal: vec3<f32>,
    spokes: u32,
) -> f32 {
    let cosine = dot(normal, axis);
    if !polar_meets_horizon(sharpness, cosine) {
        return 0.0;
    }
    let fraction = polar_fraction(ssdf, sharpness, axis, normal, normal, false, ssdf_distance(ssdf, axis), spokes);
    return tables_cosine_integral(sharpness, cosine) * fraction;
}

// The visible fraction of a lobe that meets the horizon, `distance` being that of its axis, if it is
// `clipped` in front of the plane whose normal is `face`.
fn polar_fraction(
    ssdf: Ssdf,
    sharpness: f32,
    axis: vec3<f32>,
    normal: vec3<f32>,
    face: vec3<f32>,
    clipped: bool,
    distance: f32,
    spokes: u32,
) -> f32 {
    let cosine = dot(normal, axis);
    let radius = polar_support_radius(sharpness);
    if distance >= radius && !clipped {
        return 1.0;
    }
    if distance <= -radius {
        return 0.0;
    }
    let projected = normal - cosine * axis;
    let sine = length(projected);
    var tangent = polar_any_orthogonal(axis);
    if sine > 1e-4 {
        tangent = projected / sine;
    }
    let shortest = min(POLAR_SHORTEST_STEP * radius, POLAR_SHORTEST_STEP_LIMIT);
    let count = f32(spokes);
    let at_radius = polar_moments(sharpness, radius);
    var visible = 0.0;
    var whole = 0.0;
    for (var spoke = 0u; spoke < spokes; spoke++) {
        // To turn a vector by one angle, and to keep the bitangent, takes more registers.
        let angle = 2.0 * PI * (f32(spoke) + POLAR_PHASE) / count;
        let azimuth = vec2(cos(angle), sin(angle));
        let outward = azimuth.x * tangent + azimuth.y * cross(axis, tangent);
        // Along the spoke n·ω = cosine cos θ + slope sin θ, which changes sign once.
        let weights = vec2(cosine, sine * azimuth.x);
        var start = 0.0;
        var end = radius;
        var last = dot(weights, at_radius);
        if cosine < 0.0 {
            start = atan2(-cosine, weights.y);
        } else if dot(weights, vec2(cos(radius), sin(radius))) < 0.0 || (weights.y < 0.0 && radius > 0.5 * PI) {
            end = min(end, atan2(cosine, -weights.y));
            last = dot(weights, polar_moments(sharpness, end));
        }
        if start >= end {
            continue;
        }
        var first = 0.0;
        if start > 0.0 {
            first = dot(weights, polar_moments(sharpness, start));
        }
        whole += last - first;
        if clipped {
            let face_cosine = dot(face, axis);
            let face_slope = dot(face, outward);
            if face_cosine < 0.0 {
                let above = atan2(-face_cosine, face_slope);
                if above > start {
                    start = above;
                    first = dot(weights, polar_moments(sharpness, start));
                }
            } else {
                let below = atan2(face_cosine, -face_slope);
                if below < end {
                    end = below;
                    last = dot(weights, polar_moments(sharpness, end));
                }
            }
            if start >= end {
                continue;
            }
        }
        var theta = start;
        var here = distance;
        if start > 0.0 {
            here = ssdf_distance(ssdf, axis * cos(start) + outward * sin(start));
        }
        var sum = select(0.0, -first, here > 0.0);
        while theta + POLAR_RELAXATION * abs(here) < end {
            let next = min(theta + max(POLAR_RELAXATION * abs(here), shortest), end);
            let there = ssdf_distance(ssdf, axis * cos(next) + outward * sin(next));
            if (here > 0.0) != (there > 0.0) {
                let boundary = theta + here / (here - there) * (next - theta);
                let at_boundary = dot(weights, polar_moments(sharpness, boundary));
                sum += select(-at_boundary, at_boundary, here > 0.0);
            }
            theta = next;
            here = there;
        }
        visible += select(sum, sum + last, here > 0.0);
    }
    if whole > 0.0 {
        return clamp(visible / whole, 0.0, 1.0);
    }
    return 0.0;
}

// Whether a plane of the normal `face`, but not that of `normal`, cuts a lobe of this radius.
fn polar_is_clipped(radius: f32, axis: vec3<f32>, normal: vec3<f32>, face: vec3<f32>) -> bool {
    let above = radius < 0.5 * PI && dot(face, axis) >= sin(radius);
    return dot(face, normal) < POLAR_SAME_PLANE && !above;
}

fn polar_support_radius(sharpness: f32) -> f32 {
    let half_chord = sqrt(POLAR_CUT_EXPONENT / max(sharpness, 1.17549435e-38));
    return 2.0 * asin(min(half_chord, 1.0));
}

fn polar_moments(sharpness: f32, theta: f32) -> vec2<f32> {
    let half_chord = sin(0.5 * theta);
    return vec2(
        spherical_gaussian_cosine_moment(sharpness, 2.0 * half_chord * half_chord),
        tables_sine_squared_moment(sharpness, half_chord),
    );
}

fn polar_any_orthogonal(axis: vec3<f32>) -> vec3<f32> {
    let other = select(vec3(1.0, 0.0, 0.0), vec3(0.0, 1.0, 0.0), abs(axis.x) > 0.7);
    return normalize(cross(axis, other));
}
