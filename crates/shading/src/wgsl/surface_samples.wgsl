// As visibility_buffer.wgsl, for four samples per pixel: beside the triangle's number what tells
// surfaces apart, the key of surfaces.rs.

struct Corner {
    @builtin(position) position: vec4<f32>,
    @location(0) @interpolate(flat, either) id: u32,
    @location(1) @interpolate(flat, either) key: u32,
}

@vertex
fn surface_samples_vertex(@builtin(vertex_index) index: u32) -> Corner {
    let triangle = index / 3u;
    var corner = index % 3u;
    if frame.mirrored == 1u {
        // Front faces turn the other way.
        corner = 2u - corner;
    }
    let corners = triangles[triangle];
    let a = vertices[corners.x].position;
    let b = vertices[corners.y].position;
    let c = vertices[corners.z].position;
    let position = vec4(vertices[corners[corner]].position, 1.0);
    let normal = normalize(frame.to_world * cross(b - a, c - a));
    let at = vec2<u32>(octahedral_encode(normal) * 255.0 + 0.5);
    let tag = (corners.w & 0xffffu) + frame.instance * 0x9e37u;
    let key = at.x | (at.y << 8u) | (tag << 16u);
    return Corner(frame.view_projection * position, triangle + frame.first_id, key);
}

// Formats of 32 bits per channel cannot be multisampled.
@fragment
fn surface_samples_fragment(corner: Corner) -> @location(0) vec4<u32> {
    return vec4(corner.id & 0xffffu, corner.id >> 16u, corner.key & 0xffffu, corner.key >> 16u);
}
