// Twin of motion.rs, and the entry point that finds where what instances' pixels show was in the frame
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
// Of every instance.
@group(2) @binding(2) var<uniform> motions: array<Motion, MAX_BATCH>;

@compute @workgroup_size(8, 8)
fn motion_main(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(local_invocation_index) invocation: u32,
) {
    tile_enter(workgroup.x);
    let pixel = tile_pixel(invocation);
    let seen = seen_triangle(pixel);
    // Further surfaces of pixels lie below the picture.
    if seen.x >= frames[frame_index].triangle_count || any(vec2<f32>(pixel) >= motions[frame_index].size) {
        return;
    }
    let corners = triangles[seen.x].xyz;
    let weights = seen_barycentrics(corners, pixel, seen.y);
    let position = vertices[corners.x].position * weights.x
        + vertices[corners.y].position * weights.y
        + vertices[corners.z].position * weights.z;
    let clip = motions[frame_index].before * vec4(position, 1.0);
    var found = vec2(MOTION_NOWHERE);
    if clip.w > 0.0 {
        let place = seen_point(pixel, seen.y) / motions[frame_index].size;
        found = 0.5 + vec2(0.5, -0.5) * clip.xy / clip.w - place;
    }
    textureStore(motion_found, pixel, vec4(found, 0.0, 0.0));
}
