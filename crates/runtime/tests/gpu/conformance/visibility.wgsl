// Appended to the shading library: one lobe over one point's visibility per invocation.

struct Query {
    barycentrics: vec3<f32>,
    triangle: u32,
    axis: vec3<f32>,
    sharpness: f32,
    normal: vec3<f32>,
    reserved: f32,
}

@group(3) @binding(0) var<storage, read> queries: array<Query>;
@group(3) @binding(1) var<storage, read_write> answers: array<vec4<f32>>;

@compute @workgroup_size(64)
fn probe(@builtin(global_invocation_id) id: vec3<u32>) {
    if id.x >= arrayLength(&queries) {
        return;
    }
    let query = queries[id.x];
    let triangle = triangles[query.triangle];
    let ssdf = ssdf_load(clusters[triangle.w >> 16u], triangle.xyz, query.barycentrics);
    answers[id.x] = vec4(
        ssdf_distance(ssdf, query.axis),
        tables_cosine_integral(query.sharpness, dot(query.normal, query.axis))
            * polar_lobe_fraction(ssdf, query.sharpness, query.axis, query.normal, frames[frame_index].spokes, false),
        ambient_integrate(ssdf, query.sharpness, query.axis, query.normal),
        0.0,
    );
}
