// Twin of camera.rs.

struct Ray {
    origin: vec3<f32>,
    // Not of unit length.
    direction: vec3<f32>,
}

// The ray of a place of the image of visibility: through the centre of its pixel, or through the
// point of the image that `at` names, in eighths of a pixel, row << 16 | column.
fn seen_ray(pixel: vec2<u32>, at: u32) -> Ray {
    return camera_ray(seen_point(pixel, at));
}

// That place, in pixels from the upper left corner.
fn seen_point(pixel: vec2<u32>, at: u32) -> vec2<f32> {
    if at != 0u {
        return vec2(f32(at & 0xffffu), f32(at >> 16u)) * 0.125;
    }
    return vec2<f32>(pixel) + 0.5;
}

fn camera_ray(point: vec2<f32>) -> Ray {
    let place = frames[frame_index].corner + point.x * frames[frame_index].right + point.y * frames[frame_index].down;
    if frames[frame_index].perspective == 0.0 {
        return Ray(place, -frames[frame_index].eye);
    }
    return Ray(frames[frame_index].eye, place);
}

// How far a plane is moved along by going from column to column and from row to row, at a position on it;
// zero where it is seen edge-on. The normal is of any length.
fn camera_steps(normal: vec3<f32>, position: vec3<f32>) -> mat2x3<f32> {
    // From the eye; as long as the ray of a pixel, times `distance`.
    var ray = -frames[frame_index].eye;
    var distance = 1.0;
    if frames[frame_index].perspective != 0.0 {
        ray = position - frames[frame_index].eye;
        let axis = cross(frames[frame_index].right, frames[frame_index].down);
        let depth = dot(frames[frame_index].corner, axis);
        if depth == 0.0 {
            return mat2x3<f32>();
        }
        distance = dot(ray, axis) / depth;
    }
    let towards = dot(ray, normal);
    if towards == 0.0 {
        return mat2x3<f32>();
    }
    let right = distance * frames[frame_index].right;
    let down = distance * frames[frame_index].down;
    return mat2x3<f32>(
        right - ray * (dot(normal, right) / towards),
        down - ray * (dot(normal, down) / towards),
    );
}

// Barycentric coordinates of the point where a ray meets the plane of a
// triangle, clamped to the triangle: a pixel centre may lie a rounding error outside.
fn barycentrics(a: vec3<f32>, b: vec3<f32>, c: vec3<f32>, ray: Ray) -> vec3<f32> {
    let ab = b - a;
    let ac = c - a;
    let from_a = ray.origin - a;
    let p = cross(ray.direction, ac);
    let q = cross(from_a, ab);
    let determinant = dot(ab, p);
    if determinant == 0.0 {
        return vec3<f32>(1.0 / 3.0);
    }
    let v = max(dot(from_a, p) / determinant, 0.0);
    let w = max(dot(ray.direction, q) / determinant, 0.0);
    let excess = max(v + w, 1.0);
    return vec3<f32>(1.0 - (v + w) / excess, v / excess, w / excess);
}
