// Twin of polar.rs.

// Added to the number of spokes where they are counted once more: a variable for it takes more registers.
const POLAR_AGAIN: u32 = 65536u;

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

// The visible share of a lobe; 0 where it does not meet the horizon.
fn polar_lobe_fraction(
    ssdf: Ssdf,
    sharpness: f32,
    axis: vec3<f32>,
    normal: vec3<f32>,
    spokes: u32,
    thoroughly: bool,
) -> f32 {
    if !polar_meets_horizon(sharpness, dot(normal, axis)) {
        return 0.0;
    }
    let distance = ssdf_distance(ssdf, axis);
    return polar_fraction(ssdf, sharpness, axis, normal, normal, false, distance, spokes, thoroughly);
}

// The visible fraction of a lobe that meets the horizon, `distance` being that of its axis, if it is
// `clipped` in front of the plane whose normal is `face`. `thoroughly`: in shorter steps, and by more spokes if little is.
fn polar_fraction(
    ssdf: Ssdf,
    sharpness: f32,
    axis: vec3<f32>,
    normal: vec3<f32>,
    face: vec3<f32>,
    clipped: bool,
    distance: f32,
    spokes: u32,
    thoroughly: bool,
) -> f32 {
    let cosine = dot(normal, axis);
    let radius = polar_support_radius(sharpness);
    let projected = normal - cosine * axis;
    let sine = length(projected);
    let tangent = select(polar_any_orthogonal(axis), projected / sine, sine > 1e-4);
    // None where the axis tells it.
    let seen = distance >= radius && !clipped;
    var count = select(spokes, 0u, seen || distance <= -radius);
    var visible = select(0.0, 1.0, seen);
    var whole = visible;
    var spoke = 0u;
    while spoke < (count & (POLAR_AGAIN - 1u)) {
        // To turn a vector by one angle, and to keep the bitangent, takes more registers.
        let angle = 2.0 * PI * (f32(spoke) + POLAR_PHASE) / f32(count & (POLAR_AGAIN - 1u));
        let azimuth = vec2(cos(angle), sin(angle));
        let outward = azimuth.x * tangent + azimuth.y * cross(axis, tangent);
        // Along the spoke n·ω = cosine cos θ + slope sin θ, which changes sign once.
        let weights = vec2(cosine, sine * azimuth.x);
        let above = polar_above(weights, radius);
        var ends = above;
        if clipped {
            let front = polar_above(vec2(dot(face, axis), dot(face, outward)), radius);
            ends = vec2(max(above.x, front.x), min(above.y, front.y));
        }
        // Up to where the normal's plane begins and ends, and the face's.
        var last = 0.0;
        let first_end = select(1u, 0u, above.x > 0.0);
        let end_count = select(select(2u, 3u, ends.y < above.y), 0u, above.x >= above.y);
        for (var i = first_end; i < end_count; i++) {
            let at = select(select(ends.y, above.y, i == 1u), above.x, i == 0u);
            last = dot(weights, polar_moments(sharpness, at));
            whole += select(select(0.0, last, i == 1u), -last, i == 0u);
        }
        var theta = ends.x;
        var here = 0.0;
        var ahead = 0.0;
        var shortest = 0.0;
        while theta + max(ahead, POLAR_LAST_STEP * shortest) < ends.y {
            let next = min(theta + max(ahead, shortest), ends.y);
            var there = distance;
            if next > 0.0 {
                there = ssdf_distance(ssdf, axis * cos(next) + outward * sin(next));
            }
            if (here > 0.0) != (there > 0.0) {
                let boundary = theta + here / (here - there) * (next - theta);
                if boundary > 0.0 {
                    let at_boundary = dot(weights, polar_moments(sharpness, boundary));
                    visible += select(-at_boundary, at_boundary, here > 0.0);
                }
            }
            theta = next;
            here = there;
            ahead = select(POLAR_RELAXATION, POLAR_THOROUGH_RELAXATION, thoroughly) * abs(here);
            shortest = select(POLAR_SHORTEST_STEP, POLAR_THOROUGH_SHORTEST * POLAR_SHORTEST_STEP, thoroughly)
                * min(radius, POLAR_SHORTEST_STEP_LIMIT / POLAR_SHORTEST_STEP);
        }
        visible += select(0.0, last, here > 0.0);
        spoke++;
        // Once more where little is visible.
        if thoroughly && spoke == count && visible < max(POLAR_THIN * whole, 1.17549435e-38) {
            count = POLAR_MORE_SPOKES * count + POLAR_AGAIN;
            spoke = 0u;
            visible = 0.0;
            whole = 0.0;
        }
    }
    return select(0.0, clamp(visible / max(whole, 1.17549435e-38), 0.0, 1.0), whole > 0.0);
}

// From where to where along a spoke a plane's normal, weights.x cos θ + weights.y sin θ, is above.
fn polar_above(weights: vec2<f32>, radius: f32) -> vec2<f32> {
    let below = weights.x < 0.0;
    let change = atan2(abs(weights.x), select(-weights.y, weights.y, below));
    return select(vec2(0.0, min(radius, change)), vec2(change, radius), below);
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
