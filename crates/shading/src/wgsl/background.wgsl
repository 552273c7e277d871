// Twin of background.rs: what is behind the scene, drawn first.

@group(0) @binding(4) var prefiltered: texture_2d<u32>;

// Linear radiance behind a point of the picture, in pixels.
fn background_radiance(at: vec2<f32>) -> vec3<f32> {
    if composite.background != BACKGROUND_IMAGE {
        return composite.color;
    }
    var direction = -composite.eye;
    if composite.perspective != 0.0 {
        direction = composite.corner + at.x * composite.right + at.y * composite.down;
    }
    let axis = composite.rotation * normalize(direction);
    let seen = prefiltered_levels_radiance(composite.levels, axis, composite.sharpness);
    return max(seen, vec3(0.0));
}

// As the target stores it.
fn background_stored(at: vec2<f32>) -> vec4<f32> {
    return composite_store(composite_color(background_radiance(at)), 1.0);
}

// As far away as depth goes.
@vertex
fn background_vertex(@builtin(vertex_index) index: u32) -> Place {
    return composite_corner(index, f32(composite.flipped_depth));
}

@fragment
fn background_fragment(place: Place) -> @location(0) vec4<f32> {
    return background_stored(place.pixel);
}
