// The kernels that find light fractions at the vertices that a frame sees, once per light.

// Marks the corners of the triangle under a pixel, if that covers enough pixels.
@compute @workgroup_size(8, 8)
fn vertices_mark(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(local_invocation_index) invocation: u32,
) {
    tile_enter(workgroup.x);
    let pixel = tile_pixel(invocation);
    let seen = seen_triangle(pixel);
    if seen.x >= frames[frame_index].triangle_count {
        return;
    }
    let corners = triangles[seen.x].xyz;
    if !vertex_visibility_pays(corners) {
        return;
    }
    vertices_want(corners.x);
    vertices_want(corners.y);
    vertices_want(corners.z);
}

fn vertices_want(vertex: u32) {
    let number = vertex_visibility_number(vertex);
    let state = atomicLoad(&vertex_states[number]);
    let stamp = frames[frame_index].vertex_stamp;
    if (state >> VERTEX_VISIBILITY_FRAME_BITS) != (stamp >> VERTEX_VISIBILITY_FRAME_BITS) {
        atomicStore(&vertex_states[number], stamp);
    }
}

// Twin of light_fraction in vertex_visibility.rs: four lights (y) at one vertex (x) of a tile's
// instance (z).
@compute @workgroup_size(64)
fn vertices_main(@builtin(global_invocation_id) id: vec3<u32>) {
    let vertex = id.x;
    tile_enter(id.z);
    let stamp = frames[frame_index].vertex_stamp;
    if vertex >= frames[frame_index].vertex_count || stamp == 0u {
        return;
    }
    if atomicLoad(&vertex_states[vertex_visibility_number(vertex)]) != stamp {
        return;
    }
    let cluster = clusters[vertices_cluster(vertex)];
    let ssdf = ssdf_load(cluster, vec3(vertex), vec3(1.0, 0.0, 0.0));
    let normal = surface_unit_or(vertices[vertex].normal, vec3(0.0, 1.0, 0.0));
    var found = vec4(0.0);
    for (var i = 0u; i < 4u; i++) {
        found = vec4(found.yzw, vertices_fraction(ssdf, 4u * id.y + i, normal));
    }
    textureStore(light_fractions_found, vertex_visibility_place(vertex, id.y), found);
}

fn vertices_fraction(ssdf: Ssdf, index: u32, normal: vec3<f32>) -> f32 {
    if index >= frames[frame_index].light_count {
        return VERTEX_VISIBILITY_UNKNOWN;
    }
    let light = light_entry(index);
    let spokes = u32(light.vertex_spokes);
    if spokes == 0u {
        return VERTEX_VISIBILITY_UNKNOWN;
    }
    return polar_lobe_fraction(ssdf, light.sharpness, light.axis, normal, spokes, true);
}

// The last cluster that begins at or before a vertex.
fn vertices_cluster(vertex: u32) -> u32 {
    var low = 0u;
    var high = arrayLength(&clusters);
    while high - low > 1u {
        let middle = (low + high) / 2u;
        if clusters[middle].first_vertex <= vertex {
            low = middle;
        } else {
            high = middle;
        }
    }
    return low;
}
