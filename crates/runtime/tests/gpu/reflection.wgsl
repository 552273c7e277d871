// Appended to the shading library: one surface point and its lobes per invocation.

struct Query {
    barycentrics: vec3<f32>,
    triangle: u32,
}

@group(3) @binding(0) var<storage, read> queries: array<Query>;
@group(3) @binding(1) var<storage, read_write> answers: array<vec4<f32>>;

@compute @workgroup_size(64)
fn reflection(@builtin(global_invocation_id) id: vec3<u32>) {
    if id.x >= arrayLength(&queries) {
        return;
    }
    let query = queries[id.x];
    let triangle = triangles[query.triangle];
    let point = surface_point(triangle.xyz, triangle.w & 0xffffu, query.barycentrics);
    brdf_specular_lobes(point);
    let first = id.x * (5u + 2u * MAX_SPECULAR_LOBES);
    answers[first] = vec4(point.normal, f32(point.appearance.model));
    answers[first + 1u] = vec4(point.tangent, f32(specular_count));
    answers[first + 2u] = vec4(point.view, point.appearance.alpha.x);
    answers[first + 3u] = vec4(point.appearance.diffuse, point.appearance.alpha.y);
    answers[first + 4u] = vec4(point.appearance.specular, 0.0);
    for (var i = 0u; i < specular_count; i++) {
        let lobe = specular_lobes[i];
        answers[first + 5u + 2u * i] = vec4(lobe.axis, lobe.sharpness);
        answers[first + 6u + 2u * i] = vec4(lobe.amplitude, 0.0);
    }
}
