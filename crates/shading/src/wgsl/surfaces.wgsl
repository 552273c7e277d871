// Twin of surfaces.rs, and the entry point that finds the surfaces of a tile's pixels.

@group(1) @binding(0) var sampled_ids: texture_multisampled_2d<u32>;
@group(1) @binding(1) var sampled_depth: texture_depth_multisampled_2d;
// Triangle and point of the image, as in visibility_buffer: a texel for every pixel and, below
// whole tiles, half as many rows for the others, 8 × 4 for every tile.
@group(1) @binding(2) var surface_items: texture_storage_2d<rg32uint, write>;
// Three bits per sample: 0 background, 1 the pixel's own item, from 2 on items of the tile,
// counted from the six bits behind.
@group(1) @binding(3) var surfaces_shown: texture_storage_2d<r32uint, write>;

var<workgroup> tile_extras: array<u32, 64>;

fn surfaces_normal(key: u32) -> vec3<f32> {
    return normalize(octahedral_decode(vec2(f32(key & 255u), f32((key >> 8u) & 255u)) / 255.0));
}

// The point of the image where a sample of a pixel is, eighths of a pixel, row << 16 | column.
fn surfaces_place(pixel: vec2<u32>, index: u32) -> u32 {
    var pattern = SURFACES_PATTERN;
    let at = pixel * 8u + pattern[index];
    return (at.y << 16u) | at.x;
}

fn surfaces_point(ray: Ray, depth: f32) -> vec3<f32> {
    let rows = transpose(frames[frame_index].view_projection);
    let origin = vec4(ray.origin, 1.0);
    let direction = vec4(ray.direction, 0.0);
    let distance = (dot(rows[2], origin) - depth * dot(rows[3], origin))
        / (depth * dot(rows[3], direction) - dot(rows[2], direction));
    return ray.origin + distance * ray.direction;
}

@compute @workgroup_size(8, 8)
fn surfaces_main(
    @builtin(workgroup_id) tile: vec3<u32>,
    @builtin(global_invocation_id) id: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let pixel = id.xy;
    let size = textureDimensions(sampled_ids);
    let inside = all(pixel < size);
    var ids: array<u32, 4>;
    var keys: array<u32, 4>;
    var points: array<vec3<f32>, 4>;
    var surfaces: array<u32, 4>;
    // The sample that each surface was first seen by.
    var first: array<u32, 4>;
    var count = 0u;
    if inside {
        for (var i = 0u; i < 4u; i++) {
            let texel = textureLoad(sampled_ids, pixel, i);
            ids[i] = texel.x | (texel.y << 16u);
            keys[i] = texel.z | (texel.w << 16u);
        }
        if ids[0] == ids[1] && ids[0] == ids[2] && ids[0] == ids[3] {
            count = select(1u, 0u, ids[0] == 0u);
            surfaces = array(count, count, count, count);
        } else {
            for (var i = 0u; i < 4u; i++) {
                let ray = seen_ray(pixel, surfaces_place(pixel, i));
                points[i] = surfaces_point(ray, textureLoad(sampled_depth, pixel, i));
            }
            for (var i = 0u; i < 4u; i++) {
                if ids[i] == 0u {
                    continue;
                }
                var number = 0u;
                for (var other = 0u; other < count; other++) {
                    let known = first[other];
                    let facing = surfaces_normal(keys[known]);
                    let between = points[i] - points[known];
                    let near = (keys[known] >> 16u) == (keys[i] >> 16u)
                        && dot(facing, surfaces_normal(keys[i])) >= SURFACES_LEAST_COSINE
                        && abs(dot(facing, between)) <= SURFACES_MOST_SLOPE * length(between);
                    if number == 0u && (ids[known] == ids[i] || near) {
                        number = other + 1u;
                    }
                }
                if number == 0u {
                    first[count] = i;
                    count++;
                    number = count;
                }
                surfaces[i] = number;
            }
        }
    }
    tile_extras[local] = max(count, 1u) - 1u;
    workgroupBarrier();
    var base = 0u;
    var all_extras = 0u;
    for (var i = 0u; i < 64u; i++) {
        let room = SURFACES_EXTRAS - all_extras;
        base = select(base, all_extras, i == local);
        all_extras += min(tile_extras[i], room);
    }
    let extras_row = (size.y + SURFACES_TILE - 1u) / SURFACES_TILE * SURFACES_TILE + tile.y * 4u;
    if local >= all_extras && local < SURFACES_EXTRAS {
        let place = vec2(tile.x * 8u + local % 8u, extras_row + local / 8u);
        textureStore(surface_items, place, vec4(0u));
    }
    let kept = min(count, 1u + SURFACES_EXTRAS - base);
    var own = vec4(0u);
    if count > 0u {
        // The whole pixel, or the sample that saw it first.
        let whole = ids[0] == ids[1] && ids[0] == ids[2] && ids[0] == ids[3];
        own = vec4(ids[first[0]], select(surfaces_place(pixel, first[0]), 0u, whole), 0u, 0u);
    }
    textureStore(surface_items, pixel, own);
    for (var i = 1u; i < kept; i++) {
        let slot = base + i - 1u;
        let place = vec2(tile.x * 8u + slot % 8u, extras_row + slot / 8u);
        let by = first[i];
        textureStore(surface_items, place, vec4(ids[by], surfaces_place(pixel, by), 0u, 0u));
    }
    if inside {
        var shown = base << 12u;
        for (var i = 0u; i < 4u; i++) {
            let number = select(surfaces[i], 1u, surfaces[i] > kept);
            shown |= number << (3u * i);
        }
        textureStore(surfaces_shown, pixel, vec4(shown));
    }
}
