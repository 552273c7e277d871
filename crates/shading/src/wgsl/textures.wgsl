// Twin of textures.rs.

// Whether textures may be looked up by second texture coordinates; only where a scene has them, as it takes registers.
override TEXTURES_SECOND_UVS: bool = true;

// Second texture coordinates of a vertex: six take the room of one, behind all of them.
fn textures_second_uv(index: u32) -> vec2<f32> {
    let six = vertices[frames[frame_index].vertex_count + index / 6u];
    switch index % 6u {
        case 0u: {
            return six.position.xy;
        }
        case 1u: {
            return vec2(six.position.z, six.u);
        }
        case 2u: {
            return six.normal.xy;
        }
        case 3u: {
            return vec2(six.normal.z, six.v);
        }
        case 4u: {
            return six.tangent.xy;
        }
        default: {
            return six.tangent.zw;
        }
    }
}

// A vertex, with its second texture coordinates in place of the first where those are asked for.
fn textures_vertex(index: u32, second: bool) -> Vertex {
    var vertex = vertices[index];
    if TEXTURES_SECOND_UVS && second {
        let uv = textures_second_uv(index);
        vertex.u = uv.x;
        vertex.v = uv.y;
    }
    return vertex;
}

// How far vertices' texture coordinates go from column to column (xy) and from row to row (zw) of the
// picture, at a point of a triangle.
fn textures_footprint(a: Vertex, b: Vertex, c: Vertex, position: vec3<f32>) -> vec4<f32> {
    let ab = b.position - a.position;
    let ac = c.position - a.position;
    let normal = cross(ab, ac);
    let area = dot(normal, normal);
    let steps = camera_steps(normal, position);
    if area == 0.0 {
        return vec4(0.0);
    }
    let uv_b = vec2(b.u - a.u, b.v - a.v);
    let uv_c = vec2(c.u - a.u, c.v - a.v);
    let x = steps[0];
    let y = steps[1];
    let to_x = vec2(dot(normal, cross(x, ac)), dot(normal, cross(ab, x))) / area;
    let to_y = vec2(dot(normal, cross(y, ac)), dot(normal, cross(ab, y))) / area;
    let found = vec4(to_x.x * uv_b + to_x.y * uv_c, to_y.x * uv_b + to_y.y * uv_c);
    return clamp(found, vec4(-TEXTURES_WIDEST), vec4(TEXTURES_WIDEST));
}

fn textures_sample(slot: TextureSlot, vertex_uv: vec2<f32>, footprint: vec4<f32>) -> vec4<f32> {
    let uv = vec2(
        dot(slot.transform_u, vec3(vertex_uv, 1.0)),
        dot(slot.transform_v, vec3(vertex_uv, 1.0)),
    );
    let size = vec2(f32(slot.width), f32(slot.height));
    let x = vec2(
        dot(slot.transform_u.xy, footprint.xy),
        dot(slot.transform_v.xy, footprint.xy),
    ) * size;
    let y = vec2(
        dot(slot.transform_u.xy, footprint.zw),
        dot(slot.transform_v.xy, footprint.zw),
    ) * size;
    // Squares of the ellipse about the unit circle's image.
    let p = x.x * x.x + y.x * y.x;
    let q = x.x * x.y + y.x * y.y;
    let r = x.y * x.y + y.y * y.y;
    let difference = 0.5 * (p - r);
    let root = sqrt(difference * difference + q * q);
    let longest = sqrt(0.5 * (p + r) + root);
    let shortest = abs(x.x * y.y - x.y * y.x) / max(longest, 1e-20);
    let count = clamp(floor(longest / max(shortest, 1.0) + 0.5), 1.0, TEXTURES_TAPS);
    let level = min(log2(max(longest / count, 1.0)), f32(slot.last_level));
    let axis = select(
        vec2(q, root - difference),
        vec2(difference + root, q),
        difference >= 0.0,
    );
    let step = axis * (longest / count / max(length(axis), 1e-20)) / size;
    let first = uv - step * (0.5 * (count - 1.0));
    let fraction = level - floor(level);

    // A row at a time: more would take registers from what waits for it.
    var sum = vec4(0.0);
    let levels = select(1u, 2u, fraction > 0.0);
    for (var i = 0u; i < u32(count) * levels * 2u; i++) {
        let above = (i >> 1u) % levels;
        let at = first + f32((i >> 1u) / levels) * step;
        let weight = select(1.0 - fraction, fraction, above == 1u);
        sum += weight * textures_row(slot, u32(level) + above, at, i & 1u);
    }
    return sum / count;
}

// From level 1 to `level`, which is coarser: see PackedTexture::beside.
fn textures_beside(width: u32, height: u32, level: u32) -> vec2<u32> {
    let halvings = max(firstLeadingBit(height), 1u) + 1u;
    let rows = (height >> 1u) - (height >> (level - 1u)) + max(level, halvings) - halvings;
    return vec2(max(width >> 1u, 1u), rows);
}

// One of the two rows around a point, times its part in what is interpolated there.
fn textures_row(slot: TextureSlot, level: u32, uv: vec2<f32>, row: u32) -> vec4<f32> {
    var place = slot.place;
    if level > 0u {
        place = slot.coarser;
    }
    let mask = (1u << TEXTURES_SIDE_BITS) - 1u;
    var origin = vec2(place & mask, (place >> TEXTURES_SIDE_BITS) & mask);
    if level > 1u {
        origin += textures_beside(slot.width, slot.height, level);
    }
    let n = max(vec2(slot.width, slot.height) >> vec2(level), vec2(1u));
    // In texels from the first texel's centre, -1/2 to N - 1/2.
    let p = (uv - floor(uv)) * vec2<f32>(n) - 0.5;
    let low = floor(p);
    let f = p - low;
    // Adding N makes the first operand of the remainder positive.
    let a = (vec2<u32>(vec2<i32>(low) + vec2<i32>(n)) + vec2(0u, row)) % n;
    let b = vec2((a.x + 1u) % n.x, a.y);
    let layer = place >> (2u * TEXTURES_SIDE_BITS);
    let srgb = (slot.flags & TEXTURES_SRGB) != 0u;
    let left = textures_texel(origin + a, layer, srgb);
    let right = textures_texel(origin + b, layer, srgb);
    return select(1.0 - f.y, f.y, row == 1u) * mix(left, right, f.x);
}

fn textures_texel(at: vec2<u32>, layer: u32, srgb: bool) -> vec4<f32> {
    let value = unpack4x8unorm(textureLoad(texels, at, layer, 0).x);
    if !srgb {
        return value;
    }
    let dark = value.xyz / 12.92;
    let bright = pow((value.xyz + 0.055) / 1.055, vec3(2.4));
    return vec4(select(bright, dark, value.xyz <= vec3(0.04045)), value.w);
}

// The word of a table that lies at `place`, at a column and row of it.
fn textures_word(place: u32, at: vec2<u32>) -> u32 {
    let mask = (1u << TEXTURES_SIDE_BITS) - 1u;
    let corner = vec2(place & mask, (place >> TEXTURES_SIDE_BITS) & mask);
    return textureLoad(texels, corner + at, place >> (2u * TEXTURES_SIDE_BITS), 0).x;
}
