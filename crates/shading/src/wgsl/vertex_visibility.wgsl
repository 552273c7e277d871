// Twin of vertex_visibility.rs.

// Fractions of one light: where the point is, and the least and the most at the triangle's corners.
struct LightFractions {
    mean: f32,
    low: f32,
    high: f32,
}

// Vertices of an instance follow those of the one before.
fn vertex_visibility_number(vertex: u32) -> u32 {
    return frame_index * frames[frame_index].vertex_count + vertex;
}

fn vertex_visibility_place(vertex: u32, quad: u32) -> vec2<u32> {
    let index = vertex_visibility_number(vertex) * ((frames[frame_index].light_count + 3u) / 4u) + quad;
    return vec2(
        index % VERTEX_VISIBILITY_TEXTURE_WIDTH,
        index / VERTEX_VISIBILITY_TEXTURE_WIDTH,
    );
}

// Whether a triangle covers so many pixels that its corners are asked.
fn vertex_visibility_pays(corners: vec3<u32>) -> bool {
    let a = vertices[corners.x].position;
    let b = vertices[corners.y].position;
    let c = vertices[corners.z].position;
    let normal = cross(b - a, c - a);
    let steps = camera_steps(normal, (a + b + c) / 3.0);
    let pixel = cross(steps[0], steps[1]);
    let least = 4.0 * VERTEX_VISIBILITY_LEAST_PIXELS * VERTEX_VISIBILITY_LEAST_PIXELS;
    return dot(pixel, pixel) > 0.0 && dot(normal, normal) >= least * dot(pixel, pixel);
}

// Whether the corners say anything of a point whose normal is at an angle of this cosine with theirs.
fn vertex_visibility_holds(vertex_cosine: f32) -> bool {
    return frames[frame_index].vertex_stamp != 0u && vertex_cosine >= VERTEX_VISIBILITY_LEAST_COSINE;
}

// Those of light `i`, if they hold.
fn vertex_visibility_of(
    i: u32,
    holds: bool,
    corners: vec3<u32>,
    barycentrics: vec3<f32>,
) -> LightFractions {
    if !holds || i >= frames[frame_index].light_count {
        return LightFractions(0.0, VERTEX_VISIBILITY_UNKNOWN, 1.0);
    }
    // Fetched again for every light: to keep those of four takes more registers than there are.
    let lane = vec4<f32>(vec4(i & 3u) == vec4(0u, 1u, 2u, 3u));
    let fractions = vec3(
        dot(lane, textureLoad(light_fractions, vertex_visibility_place(corners.x, i / 4u), 0)),
        dot(lane, textureLoad(light_fractions, vertex_visibility_place(corners.y, i / 4u), 0)),
        dot(lane, textureLoad(light_fractions, vertex_visibility_place(corners.z, i / 4u), 0)),
    );
    return LightFractions(
        dot(barycentrics, fractions),
        min(min(fractions.x, fractions.y), fractions.z),
        max(max(fractions.x, fractions.y), fractions.z),
    );
}

// Part of a light's visibility that the point has to find for itself.
fn vertex_visibility_doubt(fractions: LightFractions, share: f32) -> f32 {
    if fractions.low < 0.0 {
        return 1.0;
    }
    let leeway = clamp(VERTEX_VISIBILITY_SMALL_SHARE / share, 1.0, VERTEX_VISIBILITY_MOST_LEEWAY);
    let limit = VERTEX_VISIBILITY_AGREEMENT * leeway;
    let above = (fractions.high - fractions.low) / limit - VERTEX_VISIBILITY_FIRM;
    return clamp(above / (1.0 - VERTEX_VISIBILITY_FIRM), 0.0, 1.0);
}

// Visible fraction of a lobe that is about a light: 1 or 0 where all that there is of the
// light at all corners is seen or hidden and the lobe lies within; else unknown.
fn vertex_visibility_whole(
    fractions: LightFractions,
    light: SphericalGaussian,
    lobe: SphericalGaussian,
) -> f32 {
    let visible = fractions.low >= 1.0 - VERTEX_VISIBILITY_SURE;
    let hidden = fractions.low >= 0.0 && fractions.high <= VERTEX_VISIBILITY_SURE;
    if !visible && !hidden {
        return VERTEX_VISIBILITY_UNKNOWN;
    }
    let aside = 2.0 * asin(min(0.5 * length(light.axis - lobe.axis), 1.0));
    let reach = VERTEX_VISIBILITY_REACH * polar_support_radius(light.sharpness);
    if aside + polar_support_radius(lobe.sharpness) > reach {
        return VERTEX_VISIBILITY_UNKNOWN;
    }
    return select(0.0, 1.0, visible);
}
