// Twin of occluders.rs.

// A walk through the hierarchy: the next node, and what is left of a leaf's triangles.
struct OccludersWalk {
    node: u32,
    triangle: u32,
    last: u32,
    met: bool,
}

// Whether anything lies on the ray more than `nearest` lengths of its direction in front of its origin; all that does is
// known to be in the node `first` and those behind it. Three nodes for each triangle, which rays meet about as often;
// and eight steps at a time: software GPUs bound the iterations of a shader's loops, all together.
fn occluders_block(first: u32, origin: vec3<f32>, direction: vec3<f32>, nearest: f32) -> bool {
    let least = vec3(OCCLUDERS_LEAST_COMPONENT);
    let inverse = 1.0 / select(direction, least, abs(direction) < least);
    let end = arrayLength(&occluder_nodes);
    var walk = OccludersWalk(first, 0u, 0u, false);
    while !walk.met && (walk.node < end || walk.triangle < walk.last) {
        walk = occluders_steps(walk, end, origin, direction, inverse, nearest);
        walk = occluders_steps(walk, end, origin, direction, inverse, nearest);
    }
    return walk.met;
}

fn occluders_steps(
    walk: OccludersWalk,
    end: u32,
    origin: vec3<f32>,
    direction: vec3<f32>,
    inverse: vec3<f32>,
    nearest: f32,
) -> OccludersWalk {
    var next = occluders_step(walk, end, origin, inverse);
    next = occluders_step(next, end, origin, inverse);
    next = occluders_step(next, end, origin, inverse);
    if !next.met && next.triangle < next.last {
        next.met = occluders_meet(next.triangle, origin, direction, nearest);
        next.triangle++;
    }
    return next;
}

// A node further, unless there are triangles before it.
fn occluders_step(walk: OccludersWalk, end: u32, origin: vec3<f32>, inverse: vec3<f32>) -> OccludersWalk {
    if walk.met || walk.triangle < walk.last || walk.node >= end {
        return walk;
    }
    let node = occluder_nodes[walk.node];
    let a = (node.low - origin) * inverse;
    let b = (node.high - origin) * inverse;
    let near = min(a, b);
    let far = max(a, b);
    let enter = max(max(max(near.x, near.y), near.z), 0.0);
    if enter > min(min(far.x, far.y), far.z) {
        return OccludersWalk(node.next, 0u, 0u, false);
    }
    return occluders_enter(walk.node, node.triangles);
}

// Into a node.
fn occluders_enter(node: u32, triangles: u32) -> OccludersWalk {
    let first = triangles >> OCCLUDERS_COUNT_BITS;
    return OccludersWalk(node + 1u, first, first + (triangles & OCCLUDERS_MAX_TRIANGLES), false);
}

// Möller & Trumbore 1997.
fn occluders_meet(index: u32, origin: vec3<f32>, direction: vec3<f32>, nearest: f32) -> bool {
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
    return v >= 0.0 && w >= 0.0 && v + w <= 1.0 && t > nearest;
}

// The first node, from `first` on, that has anything which may lie within a cone with its tip at `origin`, or cut off
// there where it has a radius, and above the plane through `origin` of the normal `face`; OCCLUDERS_NONE: none has.
fn occluders_meet_cone(
    first: u32,
    origin: vec3<f32>,
    radius: f32,
    face: vec3<f32>,
    axis: vec3<f32>,
    cosine: f32,
) -> u32 {
    let end = arrayLength(&occluder_nodes);
    if cosine <= 0.0 {
        return first;
    }
    var walk = OccludersWalk(first, 0u, 0u, false);
    while !walk.met && (walk.node < end || walk.triangle < walk.last) {
        walk = occluders_cone_step(walk, end, origin, radius, face, axis, cosine);
        if walk.triangle < walk.last {
            let cut = radius * cosine / max(occluders_sine(cosine), OCCLUDERS_LEAST_SINE);
            walk.met = occluders_triangle_meets_cone(walk.triangle, origin, cut, face, axis, cosine);
            walk.triangle++;
        }
    }
    // The leaf, behind which the walk would have gone on.
    return select(OCCLUDERS_NONE, walk.node - 1u, walk.met);
}

// Found again where it is needed: to keep it takes registers that there are not.
fn occluders_sine(cosine: f32) -> f32 {
    return sqrt(max(1.0 - cosine * cosine, 0.0));
}

// A node further, unless there are triangles before it.
fn occluders_cone_step(
    walk: OccludersWalk,
    end: u32,
    origin: vec3<f32>,
    radius: f32,
    face: vec3<f32>,
    axis: vec3<f32>,
    cosine: f32,
) -> OccludersWalk {
    if walk.triangle < walk.last || walk.node >= end {
        return walk;
    }
    let node = occluder_nodes[walk.node];
    let middle = 0.5 * (node.low + node.high) - origin;
    let half = 0.5 * (node.high - node.low);
    let along = dot(axis, middle);
    let aside = middle - along * axis;
    // Away from the side of the cone that is nearest to the middle.
    let away = aside * (cosine / max(length(aside), OCCLUDERS_LEAST_LENGTH)) - axis * occluders_sine(cosine);
    let outside = dot(away, middle) - radius * cosine - dot(abs(away), half);
    let highest = dot(face, middle) + dot(abs(face), half);
    if outside > 0.0 || along < -dot(abs(axis), half) || highest <= 0.0 {
        return OccludersWalk(node.next, 0u, 0u, false);
    }
    return occluders_enter(walk.node, node.triangles);
}

// A cone meets a triangle that its axis hits, or an edge of which enters it; its first part, of length
// `cut`, is not there, nor what is below a plane.
fn occluders_triangle_meets_cone(
    index: u32,
    origin: vec3<f32>,
    cut: f32,
    face: vec3<f32>,
    axis: vec3<f32>,
    cosine: f32,
) -> bool {
    let ab = occluder_triangles[index].edges[0].xyz;
    let ac = occluder_triangles[index].edges[1].xyz;
    let a = occluder_triangles[index].corner - origin;
    if dot(face, a) + max(max(dot(face, ab), dot(face, ac)), 0.0) <= 0.0 {
        return false;
    }
    var met = occluders_meet(index, origin, axis, 0.0);
    // One place that edges are looked at.
    for (var edge = 0u; edge < 3u && !met; edge++) {
        let start = select(a, a + ab, edge == 2u);
        let along = select(select(ac, ab, edge == 0u), ac - ab, edge == 2u);
        met = occluders_cone_meets_edge(start, along, cut, axis, cosine);
    }
    return met;
}

// The part of an edge that is in front.
fn occluders_cone_meets_edge(
    start: vec3<f32>,
    edge: vec3<f32>,
    cut: f32,
    axis: vec3<f32>,
    cosine: f32,
) -> bool {
    let first = dot(axis, start);
    let last = dot(axis, start + edge);
    if first < 0.0 && last < 0.0 {
        return false;
    }
    var front = start;
    var part = edge;
    if first < 0.0 {
        let behind = first / (first - last);
        front = start + behind * edge;
        part = (1.0 - behind) * edge;
    } else if last < 0.0 {
        part = edge * (first / (first - last));
    }
    return occluders_cone_holds_part(front + cut * axis, part, axis, cosine);
}

fn occluders_cone_holds_part(start: vec3<f32>, edge: vec3<f32>, axis: vec3<f32>, cosine: f32) -> bool {
    let along = dot(axis, edge);
    let square = along * along - cosine * cosine * dot(edge, edge);
    let linear = dot(axis, start) * along - cosine * cosine * dot(start, edge);
    var best = 0.0;
    if square < 0.0 {
        best = clamp(-linear / square, 0.0, 1.0);
    }
    return occluders_cone_holds(start, axis, cosine)
        || occluders_cone_holds(start + edge, axis, cosine)
        || occluders_cone_holds(start + best * edge, axis, cosine);
}

fn occluders_cone_holds(x: vec3<f32>, axis: vec3<f32>, cosine: f32) -> bool {
    return dot(axis, x) >= cosine * length(x);
}
