// Twin of sources.rs, and the entry point that finds what a reflection, and with the first one the Lambertian base,
// shows of the points of sources that its pixel sees. Before all that comes from lobes, so that those that add nothing
// to it are left out.

@compute @workgroup_size(8, 8)
fn sources_shown_main(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(local_invocation_index) invocation: u32,
) {
    slots_enter_again(workgroup.x, invocation);
    if slots_surface() == 0u {
        return;
    }
    let state = slots_state(slots_gathered_at(SLOTS_SUM).w);
    if state.next == SLOTS_DONE && all(sources_diffuse(state) == vec3(0.0)) {
        return;
    }
    let row = sources_seen_row(workgroup.x, 0u);
    for (var source = 0u; source < frames[frame_index].source_count; source++) {
        let shown = sources_shown(source, row + source, invocation);
        slots_again();
        let gathered = slots_gathered_at(SLOTS_SUM);
        slots_put_value(SLOTS_SUM, bitcast<vec3<f32>>(gathered.xyz) + shown, gathered.w);
    }
}

// The Lambertian base, which is shown with the first reflection.
fn sources_diffuse(state: SlotState) -> vec3<f32> {
    if state.reflection == 0u {
        return slots_gathered_value(SLOTS_DIFFUSE).xyz / PI;
    }
    return vec3(0.0);
}

// The reflection. None where there is none, or it is black.
fn sources_reflection(state: SlotState) -> Reflection {
    var reflection = lobes_reflection();
    if state.next == SLOTS_DONE {
        reflection.model = MODEL_NONE;
    }
    return reflection;
}

// What they show of one source. What is needed is read where it is: registers are short.
fn sources_shown(source: u32, row: u32, invocation: u32) -> vec3<f32> {
    var sum = vec3(0.0);
    let told = sources_seen_word(row, 0u, invocation);
    if told == 0u {
        return sum;
    }
    let entry = sources_entry(source);
    let of_group = sources_of_group(entry);
    // The next cone: all of the source, or one of its groups. Of the last one what is seen, and the places of it that are
    // still to be looked at.
    var cone = select(SOURCE_FIRST_GROUP, 0u, (told & SOURCE_ALL_GROUPS) == SOURCE_ALL_GROUPS);
    var seen = 0u;
    var places = 0u;
    while places != 0u || cone < SOURCE_FIRST_RIM {
        var at = cone;
        let is_cone = places == 0u;
        if is_cone {
            seen = sources_seen_of_cone(row, told, cone, invocation);
            cone++;
        } else {
            at = SOURCE_FIRST_PLACE + (cone - SOURCE_FIRST_GROUP - 1u) * SOURCE_PLACES + firstTrailingBit(places);
        }
        // How many points it has, and which of them are seen.
        let points = select(max(of_group / SOURCE_PLACES, 1u), of_group, is_cone);
        let first_point = select(firstTrailingBit(places) * of_group / SOURCE_PLACES, 0u, is_cone);
        let bits = (seen >> first_point) & (0xffffffffu >> (32u - points));
        places &= places - 1u;
        slots_again();
        let state = slots_state(slots_gathered_at(SLOTS_SUM).w);
        let reflection = sources_reflection(state);
        let wi = surface_to_local(slots_point(), source_points[entry + at].direction);
        if is_cone && bits != 0u && !sources_is_small(reflection, source_points[entry + at].cone_cosine, wi, lobes_view()) {
            places = select((1u << SOURCE_PLACES) - 1u, 0u, at == 0u);
        } else if bits != 0u && wi.z > 0.0 {
            let shown = sources_diffuse(state) + models_specular(reflection, wi, lobes_view());
            let part = f32(countOneBits(bits)) / f32(points);
            sum += part * source_points[entry + at].light * (wi.z * shown);
            if at == 0u {
                break;
            }
        }
    }
    if (told & SOURCE_SHADOWED) != 0u {
        sum *= 1.0 - bitcast<f32>(sources_seen_word(row, 1u + SOURCE_GROUPS, invocation));
    }
    return sum;
}

// The points that are seen of the source, where all of it is, or of one of its groups.
fn sources_seen_of_cone(row: u32, told: u32, cone: u32, invocation: u32) -> u32 {
    let state = told >> (max(cone, SOURCE_FIRST_GROUP) - SOURCE_FIRST_GROUP);
    if (state & 1u) != 0u {
        return 0xffffffffu;
    }
    if ((state >> SOURCE_GROUPS) & 1u) == 0u {
        return 0u;
    }
    return sources_seen_word(row, cone, invocation);
}

// Whether what is reflected from one direction of a cone, its axis `wi`, stands for all of it.
fn sources_is_small(reflection: Reflection, cosine: f32, wi: vec3<f32>, wo: vec3<f32>) -> bool {
    let radius_squared = 2.0 * (1.0 - cosine);
    if wi.z <= SOURCE_LEAST_COSINE || radius_squared > SOURCE_SMALL_DIFFUSE * SOURCE_SMALL_DIFFUSE {
        return false;
    }
    if reflection.model == MODEL_NONE {
        return true;
    }
    let half = normalize(wi + wo);
    let alpha = brdf_roughness(reflection);
    // In roughnesses, as slopes of the half vector: how far the lobe's peak is, the radius of the cone, and how near it
    // comes to the peak.
    let away = length(half.xy / (alpha * half.z));
    let radius = sqrt(radius_squared) / (2.0 * dot(half, wo) * half.z * half.z * min(alpha.x, alpha.y));
    let near = max(away - radius, 0.0);
    if reflection.model == MODEL_GGX {
        return radius * radius <= SOURCE_SMALL * SOURCE_SMALL * (1.0 + near * near);
    }
    let most = SOURCE_SMALL * SOURCE_SMALL * exp(min(near * near, SOURCE_MOST_EXPONENT));
    return radius * radius * (1.0 + 4.0 * away * away) <= most;
}

fn sources_seen_word(row: u32, word: u32, invocation: u32) -> u32 {
    return textureLoad(source_seen, sources_seen_place(row, word / 4u, invocation, 64u), 0)[word % 4u];
}
