// Twin of octahedral.rs.

fn octahedral_encode(direction: vec3<f32>) -> vec2<f32> {
    let p = direction / (abs(direction.x) + abs(direction.y) + abs(direction.z));
    var q = p.xz;
    if p.y < 0.0 {
        q = octahedral_fold(q);
    }
    return q * 0.5 + 0.5;
}

// The direction at a point of the unit square.
fn octahedral_decode(uv: vec2<f32>) -> vec3<f32> {
    let q = uv * 2.0 - 1.0;
    let y = 1.0 - abs(q.x) - abs(q.y);
    let p = select(octahedral_fold(q), q, y >= 0.0);
    return normalize(vec3(p.x, y, p.y));
}

// The texel of an n × n map that continues it at `at`, which may lie up to one map outside.
fn octahedral_wrap(at: vec2<i32>, n: i32) -> vec2<i32> {
    var inside = at;
    if at.x < 0 || at.x >= n {
        inside = vec2(select(2 * n - 1 - at.x, -1 - at.x, at.x < 0), n - 1 - at.y);
    }
    if inside.y < 0 || inside.y >= n {
        inside = vec2(n - 1 - inside.x, select(2 * n - 1 - inside.y, -1 - inside.y, inside.y < 0));
    }
    return inside;
}

// Exchanges the inner diamond with the four outer triangles.
fn octahedral_fold(q: vec2<f32>) -> vec2<f32> {
    let magnitude = vec2(1.0) - abs(q.yx);
    return select(-magnitude, magnitude, q >= vec2(0.0));
}
