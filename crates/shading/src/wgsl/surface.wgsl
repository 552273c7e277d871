// Twin of surface.rs.

// Reflectance at one point, textures applied and parameters clamped to what is shaded.
struct Appearance {
    diffuse: vec3<f32>,
    model: u32,
    specular: vec3<f32>,
    alpha: vec2<f32>,
}

struct SurfacePoint {
    position: vec3<f32>,
    geometric_normal: vec3<f32>,
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

fn surface_point(corners: vec3<u32>, material_index: u32, barycentrics: vec3<f32>) -> SurfacePoint {
    let a = vertices[corners.x];
    let b = vertices[corners.y];
    let c = vertices[corners.z];
    let position = a.position * barycentrics.x + b.position * barycentrics.y + c.position * barycentrics.z;
    let vertex_normal = a.normal * barycentrics.x + b.normal * barycentrics.y + c.normal * barycentrics.z;
    let vertex_tangent = a.tangent * barycentrics.x + b.tangent * barycentrics.y + c.tangent * barycentrics.z;
    let uv = vec2(a.u, a.v) * barycentrics.x + vec2(b.u, b.v) * barycentrics.y + vec2(c.u, c.v) * barycentrics.z;
    let geometric_normal = surface_unit_or(
        cross(b.position - a.position, c.position - a.position),
        vec3(0.0, 1.0, 0.0),
    );

    var normal = surface_unit_or(vertex_normal, geometric_normal);
    var tangent = surface_orthogonal_unit(vertex_tangent.xyz, normal);
    let handedness = select(1.0, -1.0, vertex_tangent.w < 0.0);
    let normal_texture = materials[material_index].normal_texture;
    if normal_texture.width != 0u {
        let normal_scale = materials[material_index].normal_scale;
        let mapped = surface_sample(normal_texture, uv).xyz * 2.0 - 1.0;
        let bitangent = cross(normal, tangent) * handedness;
        let scaled = tangent * (mapped.x * normal_scale)
            + bitangent * (mapped.y * normal_scale)
            + normal * mapped.z;
        normal = surface_unit_or(scaled, normal);
        tangent = surface_orthogonal_unit(tangent, normal);
    }

    var color = materials[material_index].color;
    let color_texture = materials[material_index].base_color_texture;
    if color_texture.width != 0u {
        color *= surface_sample(color_texture, uv).xyz;
    }
    var appearance: Appearance;
    if materials[material_index].surface == SURFACE_METALLIC_ROUGHNESS {
        var metallic = materials[material_index].metallic;
        var roughness = materials[material_index].roughness;
        let factor_texture = materials[material_index].metallic_roughness_texture;
        if factor_texture.width != 0u {
            let factors = surface_sample(factor_texture, uv);
            metallic *= factors.z;
            roughness *= factors.y;
        }
        let alpha = roughness * roughness;
        var strength = materials[material_index].anisotropy_strength;
        var direction = vec2(1.0, 0.0);
        let anisotropy_texture = materials[material_index].anisotropy_texture;
        if anisotropy_texture.width != 0u {
            let texel = surface_sample(anisotropy_texture, uv);
            strength *= texel.z;
            direction = texel.xy * 2.0 - 1.0;
            if dot(direction, direction) < SURFACE_DEGENERATE_LENGTH_SQUARED {
                direction = vec2(1.0, 0.0);
            }
        }
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
        appearance.specular = mix(vec3(SURFACE_DIELECTRIC_F0), color, metallic);
        appearance.model = MODEL_GGX;
        appearance.alpha = vec2(alpha + (1.0 - alpha) * strength * strength, alpha);
    } else {
        appearance.diffuse = color;
        appearance.specular = materials[material_index].specular;
        appearance.model = materials[material_index].model;
        appearance.alpha = materials[material_index].alpha;
    }
    if appearance.model == MODEL_BLINN_PHONG {
        appearance.alpha = clamp(appearance.alpha.xx, vec2(1.0), vec2(SURFACE_MAX_EXPONENT));
    } else {
        appearance.alpha = clamp(appearance.alpha, vec2(SURFACE_MIN_ALPHA), vec2(1.0));
    }

    var point: SurfacePoint;
    point.position = position;
    point.geometric_normal = geometric_normal;
    point.normal = normal;
    point.tangent = tangent;
    point.bitangent = cross(normal, tangent);
    point.view = surface_unit_or(frame.eye - position, normal);
    point.appearance = appearance;
    return point;
}

fn surface_sample(slot: TextureSlot, vertex_uv: vec2<f32>) -> vec4<f32> {
    let uv = vec2(
        dot(slot.transform_u.xyz, vec3(vertex_uv, 1.0)),
        dot(slot.transform_v.xyz, vec3(vertex_uv, 1.0)),
    );
    let size = vec2(f32(slot.width), f32(slot.height));
    // In texels from the first texel's centre, -1/2 to N - 1/2.
    let p = (uv - floor(uv)) * size - 0.5;
    let low = floor(p);
    let f = p - low;
    // Adding N makes the first operand of the remainder positive.
    let x0 = u32(i32(low.x) + i32(slot.width)) % slot.width;
    let y0 = u32(i32(low.y) + i32(slot.height)) % slot.height;
    let x1 = (x0 + 1u) % slot.width;
    let y1 = (y0 + 1u) % slot.height;
    let top = mix(surface_texel(slot, x0, y0), surface_texel(slot, x1, y0), f.x);
    let bottom = mix(surface_texel(slot, x0, y1), surface_texel(slot, x1, y1), f.x);
    return mix(top, bottom, f.y);
}

fn surface_texel(slot: TextureSlot, x: u32, y: u32) -> vec4<f32> {
    let value = unpack4x8unorm(texels[slot.offset + y * slot.width + x]);
    if slot.srgb == 0u {
        return value;
    }
    let dark = value.xyz / 12.92;
    let bright = pow((value.xyz + 0.055) / 1.055, vec3(2.4));
    return vec4(select(bright, dark, value.xyz <= vec3(0.04045)), value.w);
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
