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
    let point = surface_point(triangle.xyz, triangle.w & 0xffffu, query.barycentrics, 0u);
    let first = id.x * (4u + MAX_REFLECTIONS * (4u + 2u * MAX_SPECULAR_LOBES));
    answers[first] = vec4(point.normal, f32(point.appearance.reflections));
    answers[first + 1u] = vec4(point.tangent, 0.0);
    answers[first + 2u] = vec4(point.view, 0.0);
    answers[first + 3u] = vec4(point.appearance.diffuse, 0.0);
    for (var k = 0u; k < point.appearance.reflections; k++) {
        let reflection = surface_reflection(point.appearance, k);
        lobes_of(point, reflection);
        let start = first + 4u + k * (4u + 2u * MAX_SPECULAR_LOBES);
        answers[start] = vec4(reflection.specular, f32(reflection.model));
        answers[start + 1u] = vec4(reflection.grazing, f32(specular_count));
        answers[start + 2u] = vec4(reflection.alpha, 0.0, 0.0);
        let view = surface_to_local(point, point.view);
        if reflection.ratio != 0u && view.z > 0.0 {
            let light = normalize(vec3(0.3, -0.5, 0.7));
            answers[start + 3u] = vec4(surface_ratio(reflection.ratio, light, view), 0.0);
        }
        for (var i = 0u; i < specular_count; i++) {
            let lobe = lobes_in_world(i);
            answers[start + 4u + 2u * i] = vec4(lobe.axis, lobe.sharpness);
            answers[start + 5u + 2u * i] = vec4(lobe.amplitude, 0.0);
        }
    }
}
