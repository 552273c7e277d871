// Direction, not of unit length, of the ray through the centre of a pixel.
fn pixel_direction(pixel: vec2<u32>) -> vec3<f32> {
    let centre = vec2<f32>(pixel) + 0.5;
    return frame.corner + centre.x * frame.right + centre.y * frame.down;
}

// Barycentric coordinates of the point where a ray from the eye meets the plane of a
// triangle, clamped to the triangle: a pixel centre may lie a rounding error outside.
fn barycentrics(a: vec3<f32>, b: vec3<f32>, c: vec3<f32>, direction: vec3<f32>) -> vec3<f32> {
    let ab = b - a;
    let ac = c - a;
    let from_a = frame.eye - a;
    let p = cross(direction, ac);
    let q = cross(from_a, ab);
    let determinant = dot(ab, p);
    if determinant == 0.0 {
        return vec3<f32>(1.0 / 3.0);
    }
    let v = max(dot(from_a, p) / determinant, 0.0);
    let w = max(dot(direction, q) / determinant, 0.0);
    let excess = max(v + w, 1.0);
    return vec3<f32>(1.0 - (v + w) / excess, v / excess, w / excess);
}
