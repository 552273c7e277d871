// Twin of occluders.rs.

// Whether anything lies on the ray in front of its origin.
fn occluders_block(origin: vec3<f32>, direction: vec3<f32>) -> bool {
    let least = vec3(OCCLUDERS_LEAST_COMPONENT);
    let inverse = 1.0 / select(direction, least, abs(direction) < least);
    let end = arrayLength(&occluder_nodes);
    var place = 0u;
    while place < end {
        let node = occluder_nodes[place];
        let a = (node.low - origin) * inverse;
        let b = (node.high - origin) * inverse;
        let near = min(a, b);
        let far = max(a, b);
        let enter = max(max(max(near.x, near.y), near.z), 0.0);
        if enter > min(min(far.x, far.y), far.z) {
            place = node.next;
            continue;
        }
        let first = node.triangles >> OCCLUDERS_COUNT_BITS;
        let last = first + (node.triangles & OCCLUDERS_MAX_TRIANGLES);
        for (var i = first; i < last; i++) {
            if occluders_meet(i, origin, direction) {
                return true;
            }
        }
        place++;
    }
    return false;
}

// Möller & Trumbore 1997.
fn occluders_meet(index: u32, origin: vec3<f32>, direction: vec3<f32>) -> bool {
    let triangle = occluder_triangles[index];
    let ab = triangle.edges[0].xyz;
    let ac = triangle.edges[1].xyz;
    let from_a = origin - triangle.corner;
    let p = cross(direction, ac);
    let q = cross(from_a, ab);
    let determinant = dot(ab, p);
    // Of slivers, and of triangles seen edge-on from afar, rounding alone would decide.
    let uncertain = OCCLUDERS_UNCERTAIN * OCCLUDERS_UNCERTAIN * dot(from_a, from_a);
    if determinant * determinant <= uncertain * max(dot(ab, ab), dot(ac, ac)) {
        return false;
    }
    let v = dot(from_a, p) / determinant;
    let w = dot(direction, q) / determinant;
    let t = dot(ac, q) / determinant;
    return v >= 0.0 && w >= 0.0 && v + w <= 1.0 && t > 0.0;
}
