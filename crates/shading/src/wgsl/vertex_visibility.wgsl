// Twin of vertex_visibility.rs.

// Fractions of four lights where the point is, and by how much the triangle's corners differ.
struct LightFractions {
    mean: vec4<f32>,
    low: vec4<f32>,
    high: vec4<f32>,
}

fn vertex_visibility_place(vertex: u32, quad: u32) -> vec2<u32> {
    let index = vertex * ((frame.light_count + 3u) / 4u) + quad;
    return vec2(
        index % VERTEX_VISIBILITY_TEXTURE_WIDTH,
        index / VERTEX_VISIBILITY_TEXTURE_WIDTH,
    );
}

// Of lights 4 quad to 4 quad + 3.
fn vertex_visibility_load(corners: vec3<u32>, barycentrics: vec3<f32>, quad: u32) -> LightFractions {
    let a = textureLoad(light_fractions, vertex_visibility_place(corners.x, quad), 0);
    let b = textureLoad(light_fractions, vertex_visibility_place(corners.y, quad), 0);
    let c = textureLoad(light_fractions, vertex_visibility_place(corners.z, quad), 0);
    return LightFractions(
        barycentrics.x * a + barycentrics.y * b + barycentrics.z * c,
        min(min(a, b), c),
        max(max(a, b), c),
    );
}

// Whether the corners say anything of a point whose normal is at an angle of this cosine with theirs.
fn vertex_visibility_holds(vertex_cosine: f32) -> bool {
    return frame.vertex_stamp != 0u && vertex_cosine >= VERTEX_VISIBILITY_LEAST_COSINE;
}

// The fractions of light `i`, after those of the light before it.
fn vertex_visibility_step(
    before: LightFractions,
    i: u32,
    holds: bool,
    corners: vec3<u32>,
    barycentrics: vec3<f32>,
) -> LightFractions {
    if !holds || i >= frame.light_count {
        return LightFractions(vec4(0.0), vec4(VERTEX_VISIBILITY_UNKNOWN), vec4(1.0));
    }
    if (i & 3u) == 0u {
        return vertex_visibility_load(corners, barycentrics, i / 4u);
    }
    return LightFractions(before.mean.yzwx, before.low.yzwx, before.high.yzwx);
}

// Part of the first light's visibility that the point has to find for itself.
fn vertex_visibility_doubt(fractions: LightFractions, share: f32) -> f32 {
    if fractions.low.x < 0.0 {
        return 1.0;
    }
    let leeway = clamp(VERTEX_VISIBILITY_SMALL_SHARE / share, 1.0, VERTEX_VISIBILITY_MOST_LEEWAY);
    let limit = VERTEX_VISIBILITY_AGREEMENT * leeway;
    let above = (fractions.high.x - fractions.low.x) / limit - VERTEX_VISIBILITY_FIRM;
    return clamp(above / (1.0 - VERTEX_VISIBILITY_FIRM), 0.0, 1.0);
}

// Visible fraction of a lobe that is about the first light: 1 or 0 where all that there is of the
// light at all corners is seen or hidden and the lobe lies within; else unknown.
fn vertex_visibility_whole(
    fractions: LightFractions,
    light: SphericalGaussian,
    lobe: SphericalGaussian,
) -> f32 {
    let visible = fractions.low.x >= 1.0 - VERTEX_VISIBILITY_SURE;
    let hidden = fractions.low.x >= 0.0 && fractions.high.x <= VERTEX_VISIBILITY_SURE;
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
