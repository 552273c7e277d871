// Twin of surface.rs.

// Where textures are looked up: a point of a triangle, by its first texture coordinates and by what it takes to find
// the second.
struct TexturePlace {
    uv: vec2<f32>,
    // See textures_footprint.
    footprint: vec4<f32>,
    corners: vec3<u32>,
    barycentrics: vec3<f32>,
}

// One specular reflection, textures applied and parameters clamped to what is shaded.
struct Reflection {
    // Colour at normal incidence, or at every angle.
    specular: vec3<f32>,
    model: u32,
    // Colour at grazing incidence.
    grazing: vec3<f32>,
    alpha: vec2<f32>,
    // One more than the place of what the value is multiplied by; 0: nothing.
    ratio: u32,
}

// What a point reflects: a Lambertian base, and what surface_reflection makes the reflections of. No
// array: what is indexed lives in memory.
struct Appearance {
    diffuse: vec3<f32>,
    reflections: u32,
    // Reflection number `wanted`, as the layers above leave it.
    found: Reflection,
    wanted: u32,
    material: u32,
    place: TexturePlace,
    view_cosine: f32,
}

// A point's place and frame, before its material.
struct SurfaceShape {
    position: vec3<f32>,
    geometric_normal: vec3<f32>,
    normal: vec3<f32>,
    // Between the normal and the one that the vertices interpolate to.
    vertex_cosine: f32,
    tangent: vec3<f32>,
    view: vec3<f32>,
    place: TexturePlace,
    handedness: f32,
}

struct SurfacePoint {
    position: vec3<f32>,
    geometric_normal: vec3<f32>,
    // Between the normal and the one that the vertices interpolate to.
    vertex_cosine: f32,
    // Shading frame: bitangent = cross(normal, tangent).
    normal: vec3<f32>,
    tangent: vec3<f32>,
    bitangent: vec3<f32>,
    view: vec3<f32>,
    appearance: Appearance,
}

fn surface_to_local(point: SurfacePoint, direction: vec3<f32>) -> vec3<f32> {
    return vec3(
        dot(direction, point.tangent),
        dot(direction, point.bitangent),
        dot(direction, point.normal),
    );
}

fn surface_to_world(point: SurfacePoint, local: vec3<f32>) -> vec3<f32> {
    return point.tangent * local.x + point.bitangent * local.y + point.normal * local.z;
}

fn surface_geometric_normal(corners: vec3<u32>) -> vec3<f32> {
    let a = vertices[corners.x].position;
    let b = vertices[corners.y].position;
    let c = vertices[corners.z].position;
    return surface_unit_or(cross(b - a, c - a), vec3(0.0, 1.0, 0.0));
}

fn surface_shape(corners: vec3<u32>, material_index: u32, barycentrics: vec3<f32>) -> SurfaceShape {
    let a = vertices[corners.x];
    let b = vertices[corners.y];
    let c = vertices[corners.z];
    let position = a.position * barycentrics.x + b.position * barycentrics.y + c.position * barycentrics.z;
    let vertex_normal = a.normal * barycentrics.x + b.normal * barycentrics.y + c.normal * barycentrics.z;
    let vertex_tangent = a.tangent * barycentrics.x + b.tangent * barycentrics.y + c.tangent * barycentrics.z;
    let uv = vec2(a.u, a.v) * barycentrics.x + vec2(b.u, b.v) * barycentrics.y + vec2(c.u, c.v) * barycentrics.z;
    let geometric_normal = surface_geometric_normal(corners);

    let smooth_normal = surface_unit_or(vertex_normal, geometric_normal);
    var normal = smooth_normal;
    var tangent = surface_orthogonal_unit(vertex_tangent.xyz, normal);
    let handedness = select(1.0, -1.0, vertex_tangent.w < 0.0);
    var footprint = vec4(0.0);
    if materials[material_index].textured != 0u {
        footprint = textures_footprint(a, b, c, position);
    }
    let place = TexturePlace(uv, footprint, corners, barycentrics);
    let normal_texture = materials[material_index].normal_texture;
    if normal_texture.width != 0u {
        let normal_scale = materials[material_index].normal_scale;
        let mapped = surface_texture(2u, normal_texture, place).xyz * 2.0 - 1.0;
        let bitangent = cross(normal, tangent) * handedness;
        let scaled = tangent * (mapped.x * normal_scale)
            + bitangent * (mapped.y * normal_scale)
            + normal * mapped.z;
        normal = surface_unit_or(scaled, normal);
        tangent = surface_orthogonal_unit(tangent, normal);
    }

    let view = surface_unit_or(frames[frame_index].eye - position * frames[frame_index].perspective, normal);
    if dot(geometric_normal, view) > 0.0 && dot(normal, view) < SURFACE_LEAST_VIEW_COSINE {
        // Interpolated or mapped, the normal turned away from an eye that sees the surface:
        // it is bent back as far as models reflect at all.
        let aside = surface_unit_or(normal - dot(normal, view) * view, tangent);
        let sine = sqrt(1.0 - SURFACE_LEAST_VIEW_COSINE * SURFACE_LEAST_VIEW_COSINE);
        normal = surface_unit_or(SURFACE_LEAST_VIEW_COSINE * view + sine * aside, view);
        tangent = surface_orthogonal_unit(tangent, normal);
    }
    return SurfaceShape(
        position,
        geometric_normal,
        normal,
        dot(smooth_normal, normal),
        tangent,
        view,
        place,
        handedness,
    );
}

// At hand is its reflection number `wanted`.
fn surface_point(
    corners: vec3<u32>,
    material_index: u32,
    barycentrics: vec3<f32>,
    wanted: u32,
) -> SurfacePoint {
    let shape = surface_shape(corners, material_index, barycentrics);
    let normal = shape.normal;
    var tangent = shape.tangent;
    let view = shape.view;
    let handedness = shape.handedness;
    let place = shape.place;
    var appearance: Appearance;
    appearance.wanted = wanted;
    appearance.material = material_index;
    appearance.place = place;
    appearance.view_cosine = dot(normal, view);
    var anisotropic = false;
    // Direction of anisotropy relative to the tangent, and its strength.
    var direction = vec2(1.0, 0.0);
    var strength = 1.0;
    let anisotropy_texture = materials[material_index].anisotropy_texture;
    if anisotropy_texture.width != 0u {
        let texel = surface_texture(3u, anisotropy_texture, place);
        strength = texel.z;
        direction = texel.xy * 2.0 - 1.0;
        if dot(direction, direction) < SURFACE_DEGENERATE_LENGTH_SQUARED {
            direction = vec2(1.0, 0.0);
        }
    }
    if materials[material_index].surface == SURFACE_METALLIC_ROUGHNESS {
        var color = materials[material_index].color;
        let color_texture = materials[material_index].base_color_texture;
        if color_texture.width != 0u {
            color *= surface_texture(0u, color_texture, place).xyz;
        }
        var metallic = materials[material_index].metallic;
        var roughness = materials[material_index].roughness;
        let factor_texture = materials[material_index].metallic_roughness_texture;
        if factor_texture.width != 0u {
            let factors = surface_texture(1u, factor_texture, place);
            metallic *= factors.z;
            roughness *= factors.y;
        }
        let alpha = roughness * roughness;
        strength *= materials[material_index].anisotropy_strength;
        if strength > 0.0 {
            let rotation = materials[material_index].anisotropy_rotation;
            let rotated = vec2(
                direction.x * cos(rotation) - direction.y * sin(rotation),
                direction.x * sin(rotation) + direction.y * cos(rotation),
            );
            let bitangent = cross(normal, tangent) * handedness;
            tangent = surface_unit_or(tangent * rotated.x + bitangent * rotated.y, tangent);
        }
        appearance.diffuse = color * (1.0 - metallic);
        let specular = mix(vec3(SURFACE_DIELECTRIC_F0), color, metallic);
        let alphas = vec2(alpha + (1.0 - alpha) * strength * strength, alpha);
        appearance.found = surface_clamped(Reflection(specular, MODEL_GGX, vec3(1.0), alphas, 0u));
        appearance.reflections = 1u;
    } else {
        if materials[material_index].surface == SURFACE_LAYERS && anisotropy_texture.width != 0u {
            let bitangent = cross(normal, tangent) * handedness;
            tangent = surface_unit_or(tangent * direction.x + bitangent * direction.y, tangent);
        }
        appearance.reflections = materials[material_index].layer_count;
        for (var i = 0u; i < appearance.reflections; i++) {
            let weight = surface_layer_weight(appearance, i);
            let reflection = surface_layer_reflection(appearance, i);
            let below = surface_layer_below(appearance, i, weight, reflection);
            appearance.diffuse = appearance.diffuse * below + surface_layer_diffuse(appearance, i) * weight;
            if i == wanted {
                appearance.found = surface_weighted(reflection, weight);
            } else if i > wanted {
                appearance.found = surface_below(appearance.found, below);
            }
            let alpha = surface_clamped(reflection).alpha;
            anisotropic = anisotropic || (reflection.model != MODEL_NONE && alpha.x != alpha.y);
        }
    }
    if anisotropic && materials[material_index].surface == SURFACE_DIFFUSE_SPECULAR {
        // glTF says that the frame is interpolated from the vertices; that of other materials is
        // the triangle's own: x along the derivative of position by u, up to its length. Zero
        // without texture coordinates.
        let a = vertices[corners.x];
        let b = vertices[corners.y];
        let c = vertices[corners.z];
        let to_b = vec2(b.u - a.u, b.v - a.v);
        let to_c = vec2(c.u - a.u, c.v - a.v);
        let turn = select(-1.0, 1.0, to_b.x * to_c.y - to_b.y * to_c.x >= 0.0);
        let along = ((b.position - a.position) * to_c.y - (c.position - a.position) * to_b.y) * turn;
        let flat = along - normal * dot(along, normal);
        let size = length(flat);
        // As the twin: what rounds to no length is no direction.
        if size > 1e-19 {
            tangent = flat / size;
        }
    }

    var point: SurfacePoint;
    point.position = shape.position;
    point.geometric_normal = shape.geometric_normal;
    point.vertex_cosine = shape.vertex_cosine;
    point.normal = normal;
    point.tangent = tangent;
    point.bitangent = cross(normal, tangent);
    point.view = view;
    point.appearance = appearance;
    return point;
}

// Radiance that the surface emits.
fn surface_emission(corners: vec3<u32>, material_index: u32, barycentrics: vec3<f32>) -> vec3<f32> {
    let emission = materials[material_index].emission;
    let slot = materials[material_index].emission_texture;
    if slot.width == 0u {
        return emission;
    }
    let second = (slot.flags & TEXTURES_SECOND_UV) != 0u;
    let a = textures_vertex(corners.x, second);
    let b = textures_vertex(corners.y, second);
    let c = textures_vertex(corners.z, second);
    let uv = vec2(a.u, a.v) * barycentrics.x + vec2(b.u, b.v) * barycentrics.y + vec2(c.u, c.v) * barycentrics.z;
    let position = a.position * barycentrics.x + b.position * barycentrics.y + c.position * barycentrics.z;
    return emission * textures_sample(slot, uv, textures_footprint(a, b, c, position)).xyz;
}

// Reflection `k`, as the layers above leave it.
fn surface_reflection(appearance: Appearance, k: u32) -> Reflection {
    if k == appearance.wanted {
        return appearance.found;
    }
    var reflection = surface_weighted(surface_layer_reflection(appearance, k), surface_layer_weight(appearance, k));
    for (var i = k + 1u; i < appearance.reflections; i++) {
        let weight = surface_layer_weight(appearance, i);
        let below = surface_layer_below(appearance, i, weight, surface_layer_reflection(appearance, i));
        reflection = surface_below(reflection, below);
    }
    return reflection;
}

fn surface_layer_weight(appearance: Appearance, i: u32) -> f32 {
    let weight = materials[appearance.material].layers[i].weight;
    let texture = materials[appearance.material].layers[i].weight_texture;
    if texture.width == 0u {
        return weight;
    }
    return weight * surface_texture(7u + 4u * i, texture, appearance.place).x;
}

fn surface_layer_diffuse(appearance: Appearance, i: u32) -> vec3<f32> {
    let diffuse = materials[appearance.material].layers[i].diffuse;
    let texture = materials[appearance.material].layers[i].diffuse_texture;
    if texture.width == 0u {
        return diffuse;
    }
    return diffuse * surface_texture(4u + 4u * i, texture, appearance.place).xyz;
}

// A layer's reflection by itself, its parameters not yet clamped.
fn surface_layer_reflection(appearance: Appearance, i: u32) -> Reflection {
    var reflection = Reflection(
        materials[appearance.material].layers[i].specular,
        materials[appearance.material].layers[i].model,
        materials[appearance.material].layers[i].grazing,
        materials[appearance.material].layers[i].alpha,
        materials[appearance.material].layers[i].ratio,
    );
    let specular_texture = materials[appearance.material].layers[i].specular_texture;
    if specular_texture.width != 0u {
        reflection.specular *= surface_texture(5u + 4u * i, specular_texture, appearance.place).xyz;
    }
    let roughness_texture = materials[appearance.material].layers[i].roughness_texture;
    if roughness_texture.width != 0u {
        let roughness = surface_texture(6u + 4u * i, roughness_texture, appearance.place).xy;
        switch reflection.model {
            case MODEL_BLINN_PHONG: {
                // A quotient by zero need not be infinite here.
                reflection.alpha /= max(roughness.x * roughness.x, 1e-12);
            }
            case MODEL_COOK_TORRANCE: {
                reflection.alpha *= roughness.x;
            }
            default: {
                reflection.alpha *= roughness;
            }
        }
    }
    return reflection;
}

// What a layer leaves of those below it.
fn surface_layer_below(appearance: Appearance, i: u32, weight: f32, reflection: Reflection) -> vec3<f32> {
    switch materials[appearance.material].layers[i].join {
        case JOIN_OVER: {
            return vec3(1.0 - weight);
        }
        case JOIN_COAT: {
            // Colours above 1 pass nothing.
            let reflected = weight * surface_reflection_color(reflection, appearance.view_cosine);
            return max(1.0 - reflected, vec3(0.0));
        }
        default: {
            return vec3(1.0);
        }
    }
}

fn surface_weighted(reflection: Reflection, weight: f32) -> Reflection {
    return surface_clamped(surface_below(reflection, vec3(weight)));
}

fn surface_below(reflection: Reflection, part: vec3<f32>) -> Reflection {
    return Reflection(
        reflection.specular * part,
        reflection.model,
        reflection.grazing * part,
        reflection.alpha,
        reflection.ratio,
    );
}

fn surface_reflection_color(reflection: Reflection, cosine: f32) -> vec3<f32> {
    if !surface_has_fresnel(reflection.model) {
        return reflection.specular;
    }
    let white = pow(clamp(1.0 - cosine, 0.0, 1.0), 5.0);
    return reflection.specular + (reflection.grazing - reflection.specular) * white;
}

fn surface_clamped(reflection: Reflection) -> Reflection {
    var clamped = reflection;
    if reflection.model == MODEL_BLINN_PHONG {
        clamped.alpha = clamp(reflection.alpha, vec2(1.0), vec2(SURFACE_MAX_EXPONENT));
    } else {
        clamped.alpha = clamp(reflection.alpha, vec2(SURFACE_MIN_ALPHA), vec2(1.0));
    }
    return clamped;
}

// What a reflection with a ratio is multiplied by.
fn surface_ratio(ratio: u32, wi: vec3<f32>, wo: vec3<f32>) -> vec3<f32> {
    let half = normalize(wi + wo);
    let cosine = clamp(dot(half, wi), 0.0, 1.0);
    let half_sine = min(length(half.xy), 1.0);
    let sines = half_sine * sqrt(1.0 - cosine * cosine);
    let azimuth = (wi.z - half.z * cosine) / max(sines, SURFACE_LEAST_RATIO_SINE);
    let coordinates = vec3(sqrt(half_sine), cosine, min(azimuth * azimuth, 1.0));
    let position = coordinates * vec3<f32>(SURFACE_RATIO_NODES - 1u);
    let low = min(vec3<u32>(position), SURFACE_RATIO_NODES - 2u);
    let f = position - vec3<f32>(low);
    // Planes stand one below the other.
    let plane = SURFACE_RATIO_NODES.y;
    let first = vec2(low.x, low.z * plane + low.y);
    let next = first + vec2(0u, plane);
    let below = vec2(0u, 1u);
    let near = mix(
        surface_ratio_row(ratio, first, f.x),
        surface_ratio_row(ratio, first + below, f.x),
        f.y,
    );
    let far = mix(
        surface_ratio_row(ratio, next, f.x),
        surface_ratio_row(ratio, next + below, f.x),
        f.y,
    );
    return mix(near, far, f.z);
}

fn surface_ratio_row(ratio: u32, first: vec2<u32>, f: f32) -> vec3<f32> {
    let a = surface_rgbe(textures_word(ratio - 1u, first));
    return mix(a, surface_rgbe(textures_word(ratio - 1u, first + vec2(1u, 0u))), f);
}

// Ward 1991.
fn surface_rgbe(texel: u32) -> vec3<f32> {
    let bytes = vec3<f32>(vec3(texel & 0xffu, (texel >> 8u) & 0xffu, (texel >> 16u) & 0xffu));
    return ldexp(bytes, vec3(i32(texel >> 24u) - SURFACE_RGBE_BIAS));
}

fn surface_unit_or(vector: vec3<f32>, fallback: vec3<f32>) -> vec3<f32> {
    let squared = dot(vector, vector);
    if squared > 1e-36 {
        return vector / sqrt(squared);
    }
    return fallback;
}

fn surface_orthogonal_unit(vector: vec3<f32>, normal: vec3<f32>) -> vec3<f32> {
    let projected = vector - normal * dot(normal, vector);
    let squared = dot(projected, projected);
    if squared > SURFACE_DEGENERATE_LENGTH_SQUARED * dot(vector, vector) && squared > 1e-36 {
        return projected / sqrt(squared);
    }
    // Duff et al. 2017.
    let orientation = select(1.0, -1.0, normal.z < 0.0);
    let a = -1.0 / (orientation + normal.z);
    return vec3(
        1.0 + orientation * normal.x * normal.x * a,
        orientation * normal.x * normal.y * a,
        -orientation * normal.x,
    );
}
