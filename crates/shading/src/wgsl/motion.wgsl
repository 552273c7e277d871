// Twin of motion.rs, and the entry point that finds where what an instance's pixels show was in the frame
// before.

struct Motion {
    // The scene's own space to that frame's clip space.
    before: mat4x4<f32>,
    // Columns and rows of the picture.
    size: vec2<f32>,
    reserved_0: u32,
    reserved_1: u32,
}

@group(2) @binding(1) var motion_found: texture_storage_2d<rg32float, write>;
@group(2) @binding(2) var<uniform> motion: Motion;

@compute @workgroup_size(8, 8)
fn motion_main(@builtin(global_invocation_id) id: vec3<u32>) {
    let pixel = id.xy + vec2(frame.first_column, frame.first_row);
    let seen = seen_triangle(pixel);
    // Further surfaces of pixels lie below the picture.
    if seen.x >= frame.triangle_count || any(vec2<f32>(pixel) >= motion.size) {
        return;
    }
    let corners = triangles[seen.x].xyz;
    let weights = seen_barycentrics(corners, pixel, seen.y);
    let position = vertices[corners.x].position * weights.x
        + vertices[corners.y].position * weights.y
        + vertices[corners.z].position * weights.z;
    let clip = motion.before * vec4(position, 1.0);
    var found = vec2(MOTION_NOWHERE);
    if clip.w > 0.0 {
        let place = seen_point(pixel, seen.y) / motion.size;
        found = 0.5 + vec2(0.5, -0.5) * clip.xy / clip.w - place;
    }
    textureStore(motion_found, pixel, vec4(found, 0.0, 0.0));
}
