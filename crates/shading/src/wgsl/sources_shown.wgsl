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
    let told = sources_seen_word(row, 0u, invocation);
    if told == 0u {
        return sum;
    }
    let entry = sources_entry(source);
    let least_cosine = sources_small_cosine(reflection, wo.z);
    var group = 0u;
    var bits = 0u;
    var first = 0u;
    while bits != 0u || group < SOURCE_GROUPS {
        if bits != 0u {
            let at = first + firstTrailingBit(bits);
            bits &= bits - 1u;
            let wi = surface_to_local(point, source_points[at].direction);
            if wi.z > 0.0 {
                let shown = diffuse + models_specular(reflection, wi, wo);
                sum += source_points[at].light * (wi.z * shown);
            }
        } else {
            let state = told >> group;
            first = entry + SOURCE_FIRST_PLACE + group * SOURCE_PLACES;
            if (state & 1u) != 0u {
                bits = (1u << SOURCE_PLACES) - 1u;
                let cone = entry + SOURCE_FIRST_GROUP + group;
                let is_small = source_points[cone].cone_cosine >= least_cosine;
                if is_small && dot(point.normal, source_points[cone].direction) > SOURCE_SMALL {
                    first = cone;
                    bits = 1u;
                }
            } else if ((state >> SOURCE_GROUPS) & 1u) != 0u {
                bits = sources_seen_word(row, 1u + group, invocation);
                if ((state >> (2u * SOURCE_GROUPS)) & 1u) != 0u {
                    first = entry + SOURCE_FIRST_POINT + group * SOURCE_GROUP_POINTS;
                }
            }
            group++;
        }
    }
    if (told & SOURCE_SHADOWED) != 0u {
        sum *= 1.0 - bitcast<f32>(sources_seen_word(row, 1u + SOURCE_GROUPS, invocation));
    }
    return sum;
}

// The least cosine of half the angle of a cone at one place of which a reflection's value stands for all of it, seen
// at the cosine `view` with the normal.
fn sources_small_cosine(reflection: Reflection, view: f32) -> f32 {
    let alpha = min(reflection.alpha.x, reflection.alpha.y);
    var radius = SOURCE_SMALL * view * alpha;
    if reflection.model == MODEL_BLINN_PHONG {
        radius = SOURCE_SMALL * view * sqrt(2.0 / alpha);
    }
    if reflection.model == MODEL_NONE {
        radius = SOURCE_SMALL_DIFFUSE;
    }
    return 1.0 - 0.5 * radius * radius;
}

fn sources_seen_word(row: u32, word: u32, invocation: u32) -> u32 {
    return textureLoad(source_seen, sources_seen_place(row, word / 4u, invocation, 64u), 0)[word % 4u];
}
