// Twin of shade_cells.rs, and the entry point that shades one pixel by cells: all in one pass, which is what
// they were written for.

@compute @workgroup_size(8, 8)
fn cells_main(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(local_invocation_index) invocation: u32,
) {
    tile_enter(workgroup.x);
    let pixel = tile_pixel(invocation);
    let seen = seen_triangle(pixel);
    if seen.x >= frames[frame_index].triangle_count {
        return;
    }
    let triangle = triangles[seen.x];
    let corners = triangle.xyz;
    let weights = seen_barycentrics(corners, pixel, seen.y);
    let point = surface_point(corners, triangle.w & 0xffffu, weights, 0u);
    let ssdf = ssdf_load(clusters[triangle.w >> 16u], corners, weights);
    var sum = vec3(0.0);
    if dot(point.normal, point.view) > 0.0 {
        // Light of sources, where the passes that shade by lobes have their sum.
        if frames[frame_index].source_count > 0u {
            sum += bitcast<vec3<f32>>(slots_gathered[64u * (SLOTS_FIELDS * workgroup.x + SLOTS_SUM) + invocation].xyz);
        }
        cells_ssdf = ssdf;
        var blocked: TransferRadiance;
        if ssdf.cluster.bounced != 0u {
            let group = transfer_group(ssdf.cluster.bounced - 1u);
            let transfer = transfer_load(group, corners, weights);
            let irradiance = transfer_irradiance(transfer, point.normal);
            sum += point.appearance.diffuse / PI * irradiance;
            blocked = transfer_load_radiance(group, corners, weights, irradiance);
        }
        if frames[frame_index].prefiltered_levels > 0u {
            sum += image_diffused(ssdf, point, point.appearance.diffuse);
        }
        cells_point = point;
        cells_diffuse = point.appearance.diffuse / PI;
        cells_first_light = shade_first_light();
        sum += shade_layers(blocked);
    }
    let emitted = surface_emission(corners, triangle.w & 0xffffu, weights);
    let coverage = 1.0 - materials[triangle.w & 0xffffu].shadow_catcher;
    textureStore(radiance, pixel, vec4(max(sum, vec3(0.0)) + emitted, coverage));
}

// What is integrated of the Lambertian base and of each reflection, one after the other: all wide lights together, every
// narrow one, and of reflections what they show of a prefiltered image: of white light, then of every lobe. There is one
// call of cells_integrate, as drivers put all of it wherever it is called.
fn shade_layers(blocked: TransferRadiance) -> vec3<f32> {
    let normal = cells_point.normal;
    let distant = frames[frame_index].light_count;
    let count = distant + frames[frame_index].local_light_count;
    let shows = frames[frame_index].prefiltered_levels > 0u;
    var sum = vec3(0.0);
    for (var layer = 0u; layer <= cells_point.appearance.reflections; layer++) {
        let reflects = layer > 0u;
        var about = vec4(normal, 0.5 * PI);
        var carried = vec3(0.0);
        if reflects {
            lobes_of(cells_point, surface_reflection(cells_point.appearance, layer - 1u));
            if cells_ssdf.cluster.bounced != 0u {
                sum += transfer_reflected(blocked, cells_ssdf, normal);
            }
            about = cells_around();
            for (var i = cells_first_light; i < count; i++) {
                let light = shade_light(i, cells_point.position);
                carried += spherical_gaussian_integral(lobes_reflected(light, vec3(0.0)));
            }
        } else if all(cells_diffuse == vec3(0.0)) {
            continue;
        }
        let first = select(0u, cells_first_light, reflects);
        let white = 1u + count - first;
        let steps = white + select(0u, 1u + distant, reflects && shows);
        // Of the image: what lobes gather, what of it is visible, and the visible part of white light, if any is reflected.
        var scaled = vec3(0.0);
        var visible = vec3(0.0);
        var part = -1.0;
        for (var step = 0u; step < steps; step++) {
            var lobe = SphericalGaussian(normal, 0.0, vec3(1.0));
            var scale = vec3(1.0);
            cells_kind = select(CELLS_WIDE, CELLS_PRODUCTS, reflects);
            if step > 0u {
                cells_kind = CELLS_SINGLE;
                let narrow = step < white;
                if step != white {
                    lobe = shade_light(select(step - white - 1u, first + step - 1u, narrow), cells_point.position);
                }
                if narrow && lobe.sharpness <= CELLS_NARROW {
                    continue;
                }
                if reflects {
                    lobe = lobes_reflected(lobe, scaled);
                } else {
                    lobe.amplitude *= cells_diffuse;
                }
                if narrow {
                    if reflects && shade_negligible(spherical_gaussian_integral(lobe), carried) {
                        continue;
                    }
                } else {
                    let whole = tables_cosine_integral(lobe.sharpness, dot(normal, lobe.axis));
                    if step == white {
                        if all(lobe.amplitude == vec3(0.0)) {
                            break;
                        }
                        scale = vec3(1.0 / max(whole, 1.17549435e-38));
                    } else {
                        scale = lobe.amplitude;
                        if shade_negligible(scale * whole, scaled) {
                            continue;
                        }
                        scaled += scale * whole;
                    }
                    lobe.amplitude = vec3(1.0);
                }
                cells_single = lobe;
                about = vec4(lobe.axis, polar_support_radius(lobe.sharpness));
            }
            let found = scale * cells_integrate(about.xyz, about.w, normal);
            if step < white {
                sum += found;
            } else if step == white {
                part = found.x;
            } else {
                visible += found;
            }
        }
        if part >= 0.0 {
            sum += image_seen(image_reflected(normal), scaled, visible, part);
        }
    }
    return sum;
}

// The pole for the products of lights with a reflection's lobes, and how far cells have to reach
// from it.
fn cells_around() -> vec4<f32> {
    var mean = vec3(0.0);
    for (var j = 0u; j < specular_count; j++) {
        let lobe = lobes_in_world(j);
        mean += lobe.axis * cells_luminance(spherical_gaussian_integral(lobe));
    }
    let size = length(mean);
    var pole = vec3(0.0, 1.0, 0.0);
    if size > 0.0 {
        pole = mean / size;
    }
    var reach = 0.0;
    for (var j = 0u; j < specular_count; j++) {
        let lobe = lobes_in_world(j);
        let aside = acos(clamp(dot(pole, lobe.axis), -1.0, 1.0));
        reach = max(reach, min(aside + polar_support_radius(lobe.sharpness), PI));
    }
    return vec4(pole, reach);
}
