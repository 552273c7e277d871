// As visibility_buffer.wgsl, for four samples per pixel: beside the triangle's number what tells
// surfaces apart, the key of surfaces.rs.

struct SampledCorner {
    @builtin(position) position: vec4<f32>,
    @location(0) @interpolate(flat, either) id: u32,
    @location(1) @interpolate(flat, either) key: u32,
}

@vertex
fn surface_samples_vertex(
    @builtin(vertex_index) index: u32,
    @builtin(instance_index) instance: u32,
) -> SampledCorner {
    frame_index = instance;
    let triangle = index / 3u;
    var corner = index % 3u;
    if frames[frame_index].mirrored == 1u {
        // Front faces turn the other way.
        corner = 2u - corner;
    }
    let corners = triangles[triangle];
    let a = vertices[corners.x].position;
    let b = vertices[corners.y].position;
    let c = vertices[corners.z].position;
    let position = vec4(vertices[corners[corner]].position, 1.0);
    let normal = normalize(frames[frame_index].to_world * cross(b - a, c - a));
    let at = vec2<u32>(octahedral_encode(normal) * 255.0 + 0.5);
    let tag = (corners.w & 0xffffu) + frames[frame_index].instance * 0x9e37u;
    let key = at.x | (at.y << 8u) | (tag << 16u);
    return SampledCorner(frames[frame_index].view_projection * position, triangle + frames[frame_index].first_id, key);
}

// Formats of 32 bits per channel cannot be multisampled.
@fragment
fn surface_samples_fragment(corner: SampledCorner) -> @location(0) vec4<u32> {
    return vec4(corner.id & 0xffffu, corner.id >> 16u, corner.key & 0xffffu, corner.key >> 16u);
}
