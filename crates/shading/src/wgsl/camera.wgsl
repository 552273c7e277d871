// Direction, not of unit length, of the ray through the centre of a pixel.
fn pixel_direction(pixel: vec2<u32>) -> vec3<f32> {
    let centre = vec2<f32>(pixel) + 0.5;
    return frame.corner + centre.x * frame.right + centre.y * frame.down;
}
