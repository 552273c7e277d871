// Twin of Parents in pixel_visibility.rs: the pixels of a tile from which another takes what they have found.

// Pixels of the coarse grid, which take nothing from others, and where they are.
fn parents_pixel(place: u32) -> u32 {
    let at = vec2(place % 4u, place / 4u);
    let pixel = 2u * at + at / 2u;
    return pixel.y * PIXEL_SIDE + pixel.x;
}

// Of another pixel: PARENTS_COUNT.
fn parents_place(pixel: u32) -> u32 {
    let place = pixel / PIXEL_SIDE / 2u * 4u + pixel % PIXEL_SIDE / 2u;
    return select(PARENTS_COUNT, place, parents_pixel(place) == pixel);
}

fn parents_low(at: u32) -> u32 {
    return select(select(select(7u, 5u, at < 7u), 2u, at < 5u), 0u, at < 2u);
}

fn parents_high(at: u32) -> u32 {
    return select(select(select(7u, 5u, at <= 5u), 2u, at <= 2u), 0u, at == 0u);
}

fn parents_weight(at: u32) -> f32 {
    let low = parents_low(at);
    return f32(at - low) / f32(max(parents_high(at) - low, 1u));
}

// One of the four pixels about another, and its weight.
struct Parent {
    pixel: u32,
    weight: f32,
}

fn parents_of(pixel: u32, index: u32) -> Parent {
    let at = vec2(pixel % PIXEL_SIDE, pixel / PIXEL_SIDE);
    let right = parents_weight(at.x);
    let down = parents_weight(at.y);
    let column = select(parents_low(at.x), parents_high(at.x), (index & 1u) != 0u);
    let row = select(parents_low(at.y), parents_high(at.y), index > 1u);
    let weight = select(1.0 - right, right, (index & 1u) != 0u) * select(1.0 - down, down, index > 1u);
    return Parent(row * PIXEL_SIDE + column, weight);
}

// Whether the tile's pixel `own`, whose slot is entered, may take anything from them; `alone`: it may not.
fn parents_may_ask(first_slot: u32, own: u32, alone: bool) -> bool {
    let place = slots_reflection_value(SLOTS_POSITION).xyz;
    let normal = slots_reflection_value(SLOTS_NORMAL).xyz;
    let surface = slots_surface();
    var asks = !alone;
    // None if it is told: compilers unroll what they can count.
    for (var index = 0u; index < select(4u, 0u, alone); index++) {
        let parent = parents_of(own, index);
        if parent.pixel == own {
            asks = false;
        } else if parent.weight > 0.0 {
            slot = first_slot + parent.pixel;
            let between = slots_reflection_value(SLOTS_POSITION).xyz - place;
            let same = slots_surface() == surface
                && dot(normal, slots_reflection_value(SLOTS_NORMAL).xyz) >= PIXEL_LEAST_COSINE
                && abs(dot(normal, between)) <= PIXEL_MOST_SLOPE * length(between);
            asks = asks && same;
        }
    }
    slot = first_slot + own;
    return asks;
}
