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
    let place = frame.corner + point.x * frame.right + point.y * frame.down;
    if frame.perspective == 0.0 {
        return Ray(place, -frame.eye);
    }
    return Ray(frame.eye, place);
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
