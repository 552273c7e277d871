// Twin of cells.rs. The lobes of one call are enumerated by cells_lobe, in place of a list.

// The wide lights on a Lambertian surface, the lobe `cells_single`, or what the reflection of
// lobes_of makes of wide lights.
const CELLS_WIDE: u32 = 0u;
const CELLS_SINGLE: u32 = 1u;
const CELLS_PRODUCTS: u32 = 2u;

var<private> cells_kind: u32;
var<private> cells_single: SphericalGaussian;
// Range of lights, where they are seen from, and what a Lambertian surface reflects.
var<private> cells_first_light: u32;
var<private> cells_point: SurfacePoint;
var<private> cells_ssdf: Ssdf;
var<private> cells_diffuse: vec3<f32>;

// The frame of the cells: columns are its axes. Normal in it.
var<private> cells_frame: mat3x3<f32>;
var<private> cells_normal: vec3<f32>;
var<private> cells_allowed: f32;
var<private> cells_radiance: vec3<f32>;

// The cell at hand: (φ, θ) and 3 × 3 directions in the frame, rows of θ.
var<private> cell_low: vec2<f32>;
var<private> cell_high: vec2<f32>;
var<private> cell_directions: array<vec3<f32>, 9>;
var<private> cell_distances: array<f32, 9>;
// Where lobes are sampled, by rows of θ: x, y and z of three directions each, and their shares
// of the solid angle. In rows, because loops are dear and some drivers count them.
var<private> cell_sample_x: mat3x3<f32>;
var<private> cell_sample_y: mat3x3<f32>;
var<private> cell_sample_z: mat3x3<f32>;
var<private> cell_sample_weights: mat3x3<f32>;
var<private> cell_moments: vec4<f32>;

fn cells_lobe_count() -> u32 {
    let all = frames[frame_index].light_count + frames[frame_index].local_light_count;
    if cells_kind == CELLS_SINGLE {
        return 1u;
    }
    if cells_kind == CELLS_WIDE {
        return all;
    }
    return all - cells_first_light;
}

// In world space; of no amplitude if it is none of the call's.
fn cells_lobe(index: u32) -> SphericalGaussian {
    if cells_kind == CELLS_SINGLE {
        return cells_single;
    }
    if cells_kind == CELLS_WIDE {
        var light = shade_light(index, cells_point.position);
        light.amplitude *= select(cells_diffuse, vec3(0.0), light.sharpness > CELLS_NARROW);
        return light;
    }
    var light = shade_light(cells_first_light + index, cells_point.position);
    if light.sharpness <= CELLS_NARROW {
        return lobes_reflected(light, vec3(0.0));
    }
    light.amplitude = vec3(0.0);
    return light;
}

// ∫ of sin², sin cos, sin³, sin² cos and sin cos² over `width` from `start`.
struct CellsInner {
    s2: f32,
    sc: f32,
    s3: f32,
    s2c: f32,
    sc2: f32,
}

fn cells_inner(start: f32, width: f32) -> CellsInner {
    let s0 = sin(start);
    let c0 = cos(start);
    let s1 = sin(start + width);
    let c1 = cos(start + width);
    let middle = sin(start + 0.5 * width);
    // c0 − c1 and s1 − s0.
    let falls = 2.0 * middle * sin(0.5 * width);
    let rises = falls * (c0 + c1) / max(s0 + s1, 1.17549435e-38);
    let sine = sin(width);
    let square = width * width;
    var less_sine = width - sine;
    if abs(width) < 0.5 {
        less_sine = width * square / 6.0 * (1.0 - square / 20.0 * (1.0 - square / 42.0));
    }
    return CellsInner(
        0.5 * less_sine + sine * middle * middle,
        0.5 * falls * (c0 + c1),
        // 1 − (c0² + c0 c1 + c1²)/3 in terms of sines.
        falls * (0.5 * (s0 * s0 + s1 * s1) + falls * falls / 6.0),
        rises * (s0 * s0 + s0 * s1 + s1 * s1) / 3.0,
        falls * (c0 * c0 + c0 * c1 + c1 * c1) / 3.0,
    );
}

// x: the paper's A, yzw: its B without p.
fn cells_strip(base: f32, from_: vec2<f32>, to: vec2<f32>) -> vec4<f32> {
    var sum = vec4(0.0);
    let step = to - from_;
    let panels = ceil(abs(step.x) / CELLS_PANEL);
    for (var panel = 0.0; panel < panels; panel += 1.0) {
        // Heights above the base keep the digits of thin strips.
        let middle = vec2(from_.x, from_.y - base) + (panel + 0.5) / panels * step;
        let half = 0.5 / panels * step;
        sum += cells_node(base, middle - CELLS_NODES[0].x * half, CELLS_NODES[0].y * half.x);
        sum += cells_node(base, middle + CELLS_NODES[0].x * half, CELLS_NODES[0].y * half.x);
        sum += cells_node(base, middle - CELLS_NODES[1].x * half, CELLS_NODES[1].y * half.x);
        sum += cells_node(base, middle + CELLS_NODES[1].x * half, CELLS_NODES[1].y * half.x);
    }
    return sum;
}

fn cells_node(base: f32, at: vec2<f32>, weight: f32) -> vec4<f32> {
    let sine = sin(at.x);
    let cosine = cos(at.x);
    let across = cells_normal.x * cosine + cells_normal.y * sine;
    let inner = cells_inner(base, at.y);
    let aside = inner.s3 * across + inner.s2c * cells_normal.z;
    return weight * vec4(
        inner.s2 * across + inner.sc * cells_normal.z,
        cosine * aside,
        sine * aside,
        inner.s2c * across + inner.sc2 * cells_normal.z,
    );
}

fn cells_direction(at: vec2<f32>) -> vec3<f32> {
    let s = sin(at.y);
    return vec3(cos(at.x) * s, sin(at.x) * s, cos(at.y));
}

fn cells_set(low: vec2<f32>, high: vec2<f32>) {
    cell_low = low;
    cell_high = high;
    let middle = 0.5 * (low + high);
    for (var row = 0u; row < 3u; row++) {
        let theta = select(select(high.y, middle.y, row == 1u), low.y, row == 0u);
        cell_directions[3u * row] = cells_direction(vec2(low.x, theta));
        cell_directions[3u * row + 1u] = cells_direction(vec2(middle.x, theta));
        cell_directions[3u * row + 2u] = cells_direction(vec2(high.x, theta));
    }
    let node = 0.5 * CELLS_FIT_NODE * (high - low);
    let phi = middle.x + vec3(-node.x, 0.0, node.x);
    let theta = middle.y + vec3(-node.y, 0.0, node.y);
    let sines = sin(theta);
    let across = cos(phi);
    let aside = sin(phi);
    cell_sample_x = mat3x3(across * sines.x, across * sines.y, across * sines.z);
    cell_sample_y = mat3x3(aside * sines.x, aside * sines.y, aside * sines.z);
    let cosines = cos(theta);
    cell_sample_z = mat3x3(vec3(cosines.x), vec3(cosines.y), vec3(cosines.z));
    let nodes = CELLS_FIT_WEIGHTS.yxy;
    let rows = nodes * sines;
    let share = nodes / (dot(nodes, vec3(1.0)) * dot(rows, vec3(1.0)));
    cell_sample_weights = mat3x3(share * rows.x, share * rows.y, share * rows.z);
}

fn cells_radius() -> f32 {
    let centre = cell_directions[4];
    var least = 1.0;
    least = min(least, dot(cell_directions[0], centre));
    least = min(least, dot(cell_directions[2], centre));
    least = min(least, dot(cell_directions[6], centre));
    least = min(least, dot(cell_directions[8], centre));
    return acos(clamp(least, -1.0, 1.0));
}

// The lesser of the distances to the visibility boundary and to the horizon.
fn cells_distance(direction: vec3<f32>) -> f32 {
    let horizon = asin(clamp(dot(cells_normal, direction), -1.0, 1.0));
    return min(ssdf_distance(cells_ssdf, cells_frame * direction), horizon);
}

// 1 − p·ω of a row of samples, without cancellation.
fn cells_aside(row: u32, axis: vec3<f32>) -> vec3<f32> {
    let x = cell_sample_x[row] - axis.x;
    let y = cell_sample_y[row] - axis.y;
    let z = cell_sample_z[row] - axis.z;
    return 0.5 * (x * x + y * y + z * z);
}

fn cells_sum(a: mat3x3<f32>, b: mat3x3<f32>) -> f32 {
    return dot(a[0], b[0]) + dot(a[1], b[1]) + dot(a[2], b[2]);
}

fn cells_product(a: mat3x3<f32>, b: mat3x3<f32>) -> mat3x3<f32> {
    return mat3x3(a[0] * b[0], a[1] * b[1], a[2] * b[2]);
}

fn cells_less(a: mat3x3<f32>, b: f32) -> mat3x3<f32> {
    return mat3x3(a[0] - b, a[1] - b, a[2] - b);
}

// α and β of exp(λ(p·ω − 1)) ≈ α + β p·ω, and the root mean square of what is left.
fn cells_fit(axis: vec3<f32>, sharpness: f32) -> vec3<f32> {
    let aside = mat3x3(cells_aside(0u, axis), cells_aside(1u, axis), cells_aside(2u, axis));
    let found = mat3x3(
        exp(-sharpness * aside[0]),
        exp(-sharpness * aside[1]),
        exp(-sharpness * aside[2]),
    );
    let mean = cells_sum(cell_sample_weights, aside);
    let value = cells_sum(cell_sample_weights, found);
    let apart = cells_less(aside, mean);
    let rest = cells_less(found, value);
    let weighted = cells_product(cell_sample_weights, apart);
    let variance = cells_sum(weighted, apart);
    var slope = 0.0;
    if variance > 0.0 {
        slope = cells_sum(weighted, rest) / variance;
    }
    let error = rest - slope * apart;
    let left = cells_sum(cells_product(cell_sample_weights, error), error);
    // Of 1 − p·ω to p·ω.
    return vec3(value + slope * (1.0 - mean), -slope, sqrt(left));
}

fn cells_luminance(color: vec3<f32>) -> f32 {
    return dot(color, vec3(0.2126, 0.7152, 0.0722));
}

// Integrates the call's lobes over what is visible, in cells about `pole` up to `reach`.
fn cells_integrate(pole: vec3<f32>, reach: f32, normal: vec3<f32>) -> vec3<f32> {
    let x = polar_any_orthogonal(pole);
    cells_frame = mat3x3(x, cross(pole, x), pole);
    cells_normal = normal * cells_frame;
    cells_radiance = vec3(0.0);
    var carried = 0.0;
    let count = cells_lobe_count();
    for (var i = 0u; i < count; i++) {
        carried += cells_luminance(spherical_gaussian_integral(cells_lobe(i)));
    }
    if carried <= 0.0 {
        return cells_radiance;
    }
    cells_allowed = frames[frame_index].lobe_error * carried;
    let uniform_cells = frames[frame_index].cells.x > 0u;
    let top = select(vec2(4u, 1u), frames[frame_index].cells.yx, uniform_cells);
    // Level, column and row of cells to come: each level leaves three.
    var stack: array<vec3<u32>, CELLS_STACK>;
    for (var first = 0u; first < top.x * top.y; first++) {
        stack[0] = vec3(0u, first % top.x, first / top.x);
        var depth = 1u;
        while depth > 0u {
            depth--;
            let level = stack[depth].x;
            let place = stack[depth].yz;
            let size = vec2(2.0 * PI, reach) / (vec2<f32>(top) * f32(1u << level));
            cells_set(vec2<f32>(place) * size, (vec2<f32>(place) + 1.0) * size);
            let may_divide = !uniform_cells && level < CELLS_MAX_LEVEL;
            if cells_add(may_divide) {
                for (var i = 0u; i < 4u; i++) {
                    stack[depth] = vec3(level + 1u, 2u * place + vec2(i % 2u, i / 2u));
                    depth++;
                }
            }
        }
    }
    return max(cells_radiance, vec3(0.0));
}

// Adds what the cell carries, unless it has to be divided.
fn cells_add(may_divide: bool) -> bool {
    let centre = cells_distance(cell_directions[4]);
    let radius = cells_radius() + CELLS_MARGIN;
    if centre <= -radius {
        return false;
    }
    let whole = centre >= radius;
    for (var i = 0u; i < 9u; i++) {
        cell_distances[i] = centre;
        if !whole {
            cell_distances[i] = cells_distance(cell_directions[i]);
        }
    }
    boundary_find();
    if may_divide && !whole && boundary_error() > frames[frame_index].boundary_error {
        return true;
    }
    boundary_moments();
    return cells_add_lobes(may_divide);
}

fn cells_add_lobes(may_divide: bool) -> bool {
    if all(cell_moments == vec4(0.0)) {
        return false;
    }
    var radiance = vec3(0.0);
    var error = 0.0;
    let count = cells_lobe_count();
    for (var i = 0u; i < count; i++) {
        let lobe = cells_lobe(i);
        if all(lobe.amplitude == vec3(0.0)) {
            continue;
        }
        let axis = lobe.axis * cells_frame;
        let fit = cells_fit(axis, lobe.sharpness);
        radiance += lobe.amplitude * (fit.x * cell_moments.x + fit.y * dot(axis, cell_moments.yzw));
        error += cells_luminance(lobe.amplitude) * fit.z;
    }
    let solid_angle = (cell_high.x - cell_low.x) * (cos(cell_low.y) - cos(cell_high.y));
    if may_divide && error * solid_angle > cells_allowed {
        return true;
    }
    cells_radiance += radiance;
    return false;
}

// Corners as (φ, θ) in a circle: low–low, high–low, high–high, low–high; whether each is
// visible; where the boundary crosses the side from a corner to the next.
var<private> boundary_corners: array<vec2<f32>, 4>;
var<private> boundary_inside: array<bool, 4>;
var<private> boundary_crossings: array<vec2<f32>, 4>;

fn boundary_find() {
    boundary_corners[0] = cell_low;
    boundary_corners[1] = vec2(cell_high.x, cell_low.y);
    boundary_corners[2] = cell_high;
    boundary_corners[3] = vec2(cell_low.x, cell_high.y);
    let at = vec4(cell_distances[0], cell_distances[2], cell_distances[8], cell_distances[6]);
    for (var side = 0u; side < 4u; side++) {
        let a = at[side];
        let b = at[(side + 1u) % 4u];
        boundary_inside[side] = a > 0.0;
        var along = 0.5;
        if a != b {
            along = clamp(a / (a - b), 0.0, 1.0);
        }
        let start = boundary_corners[side];
        boundary_crossings[side] = start + along * (boundary_corners[(side + 1u) % 4u] - start);
    }
}

fn boundary_crossed(side: u32) -> bool {
    return boundary_inside[side] != boundary_inside[(side + 1u) % 4u];
}

fn boundary_count() -> u32 {
    var count = 0u;
    for (var i = 0u; i < 4u; i++) {
        count += u32(boundary_crossed(i));
    }
    return count;
}

// Where a line that leaves the visible part at a side comes back to it.
fn boundary_back(side: u32, turn: u32) -> u32 {
    for (var j = 1u; j <= 4u; j++) {
        let other = (side + turn * j) % 4u;
        if boundary_crossed(other) {
            return other;
        }
    }
    return side;
}

// Sum over the sides of the visible polygon, whose inner sides are straight lines: of every side of the cell what is
// visible, then the line from there to where the polygon comes back to the cell's sides. The strips under them add up to
// the moments, negative.
fn boundary_moments() {
    cell_moments = vec4(0.0);
    let turn = select(1u, 3u, boundary_count() == 4u && cell_distances[4] <= 0.0);
    for (var j = 0u; j < 8u; j++) {
        let i = j / 2u;
        let next = (i + 1u) % 4u;
        var start = boundary_crossings[i];
        var end = start;
        if j % 2u == 0u {
            start = select(start, boundary_corners[i], boundary_inside[i]);
            end = select(end, boundary_corners[next], boundary_inside[next]);
        } else if boundary_inside[i] && !boundary_inside[next] {
            end = boundary_crossings[boundary_back(i, turn)];
        }
        // Under the cell's lower side there is nothing.
        if start.x != end.x && max(start.y, end.y) > cell_low.y {
            cell_moments += cells_strip(cell_low.y, end, start);
        }
    }
}

// Root mean square over the centre and the middles of the sides of the difference between
// distances and those to the line, radians.
fn boundary_error() -> f32 {
    let count = boundary_count();
    if count == 4u {
        return 3.0e38;
    }
    var pole = vec3(0.0);
    if count == 2u {
        // The great circle through both crossings, its pole on the visible side.
        var leaving = vec3(0.0);
        var entering = vec3(0.0);
        var visible = 0u;
        for (var i = 0u; i < 4u; i++) {
            if boundary_crossed(i) {
                if boundary_inside[i] {
                    leaving = cells_direction(boundary_crossings[i]);
                } else {
                    entering = cells_direction(boundary_crossings[i]);
                }
            }
            if boundary_inside[3u - i] {
                visible = 3u - i;
            }
        }
        let normal = cross(leaving, entering);
        let size = length(normal);
        if size > 0.0 {
            pole = normal / size;
        }
        if dot(pole, cells_direction(boundary_corners[visible])) < 0.0 {
            pole = -pole;
        }
    }
    // Without a line, a boundary closer than half the way to the next sample may pass between
    // samples.
    let gap = 0.25 * cells_radius();
    var sum = 0.0;
    for (var i = 0u; i < 9u; i++) {
        if i % 2u == 0u && i != 4u {
            continue;
        }
        let distance = cell_distances[i];
        var miss = 0.0;
        if count == 0u {
            miss = max(gap - select(-distance, distance, boundary_inside[0]), 0.0);
        } else {
            miss = distance - asin(clamp(dot(pole, cell_directions[i]), -1.0, 1.0));
        }
        sum += miss * miss;
    }
    return sqrt(0.2 * sum);
}
