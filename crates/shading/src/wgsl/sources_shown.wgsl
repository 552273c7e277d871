// Twin of sources.rs, and the entry point that finds what a reflection, and with the first one the Lambertian base,
// shows of the points of sources that its pixel sees. Before all that comes from lobes, so that those that add nothing
// to it are left out.

@compute @workgroup_size(8, 8)
fn sources_shown_main(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(local_invocation_index) invocation: u32,
) {
    slots_enter(workgroup.x, invocation);
    if slots_surface() == 0u {
        return;
    }
    let gathered = slots_gathered_at(SLOTS_SUM);
    let state = slots_state(gathered.w);
    var diffuse = vec3(0.0);
    if state.reflection == 0u {
        diffuse = slots_gathered_value(SLOTS_DIFFUSE).xyz / PI;
    }
    var reflection = lobes_reflection();
    if state.next == SLOTS_DONE {
        // There is none, or it is black.
        reflection.model = MODEL_NONE;
        if all(diffuse == vec3(0.0)) {
            return;
        }
    }
    let point = slots_point();
    let wo = lobes_view();
    let row = sources_seen_row(workgroup.x, 0u);
    var sum = bitcast<vec3<f32>>(gathered.xyz);
    for (var source = 0u; source < frames[frame_index].source_count; source++) {
        sum += sources_shown(source, row + source, invocation, point, wo, diffuse, reflection);
    }
    slots_put_value(SLOTS_SUM, sum, gathered.w);
}

// What they show of one source.
fn sources_shown(
    source: u32,
    row: u32,
    invocation: u32,
    point: SurfacePoint,
    wo: vec3<f32>,
    diffuse: vec3<f32>,
    reflection: Reflection,
) -> vec3<f32> {
    var sum = vec3(0.0);
    let level = sources_seen_word(row, 0u, invocation);
    if level == 0u {
        return sum;
    }
    let first = sources_entry(source) + 1u + SOURCE_RIM;
    let words = SOURCE_LEVELS[level & 1u] / 32u;
    var word = 0u;
    var bits = sources_seen_word(row, 1u, invocation);
    while word < words {
        if bits != 0u {
            let entry = first + 32u * word + firstTrailingBit(bits);
            bits &= bits - 1u;
            let wi = surface_to_local(point, source_points[entry].direction);
            let shown = diffuse + models_specular(reflection, wi, wo);
            sum += source_points[entry].light * (max(wi.z, 0.0) * shown);
        } else {
            word++;
            bits = sources_seen_word(row, 1u + min(word, words - 1u), invocation);
        }
    }
    return sum * source_scales[2u * source + (level & 1u)].xyz;
}

fn sources_seen_word(row: u32, word: u32, invocation: u32) -> u32 {
    return textureLoad(source_seen, sources_seen_place(row, word / 4u, invocation), 0)[word % 4u];
}
