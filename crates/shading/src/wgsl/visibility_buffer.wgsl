// Twin of runtime::twin::visibility_buffer: which triangle each pixel sees. Vertices are
// pulled by index, so that the triangle's number needs no optional GPU feature.

struct Corner {
    @builtin(position) position: vec4<f32>,
    @location(0) @interpolate(flat, either) id: u32,
}

@vertex
fn visibility_buffer_vertex(
    @builtin(vertex_index) index: u32,
    @builtin(instance_index) instance: u32,
) -> Corner {
    frame_index = instance;
    let triangle = index / 3u;
    var corner = index % 3u;
    if frames[frame_index].mirrored == 1u {
        // Front faces turn the other way.
        corner = 2u - corner;
    }
    let vertex = triangles[triangle][corner];
    let position = vec4(vertices[vertex].position, 1.0);
    return Corner(frames[frame_index].view_projection * position, triangle + frames[frame_index].first_id);
}

@fragment
fn visibility_buffer_fragment(corner: Corner) -> @location(0) u32 {
    return corner.id;
}
