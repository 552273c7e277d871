// What lies under a pixel.

// The triangle of this instance under a pixel, and at which point of the image it is seen, see
// seen_ray. No triangle, triangle_count or more: the pixel is outside of the image, shows
// background or belongs to another instance.
fn seen_triangle(pixel: vec2<u32>) -> vec2<u32> {
    if any(pixel >= textureDimensions(visibility_buffer)) {
        return vec2(frames[frame_index].triangle_count, 0u);
    }
    // Background, and what belongs to others, wraps to more than there is.
    return seen_known(pixel);
}

// The same of a pixel that shows this instance.
fn seen_known(pixel: vec2<u32>) -> vec2<u32> {
    let seen = textureLoad(visibility_buffer, pixel, 0).xy;
    return vec2(seen.x - frames[frame_index].first_id, seen.y);
}

// Where on a triangle that is.
fn seen_barycentrics(corners: vec3<u32>, pixel: vec2<u32>, at: u32) -> vec3<f32> {
    return barycentrics(
        vertices[corners.x].position,
        vertices[corners.y].position,
        vertices[corners.z].position,
        seen_ray(pixel, at),
    );
}
