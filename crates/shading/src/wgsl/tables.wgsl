// Twin of tables.rs; the buffer `tables` holds Tables::values().

fn tables_sine_squared_moment(sharpness: f32, half_chord: f32) -> f32 {
    return tables_lookup(TABLES_SINE_SQUARED, sharpness, half_chord) / tables_scale(sharpness);
}

fn tables_cosine_integral(sharpness: f32, cosine: f32) -> f32 {
    let below = tables_lookup(TABLES_BELOW_HORIZON, sharpness, abs(cosine)) / tables_scale(sharpness);
    return max(cosine, 0.0) * spherical_gaussian_first_moment(sharpness) + below;
}

fn tables_hemisphere_fraction(sharpness: f32, distance: f32) -> f32 {
    let sine = sin(clamp(distance, -0.5 * PI, 0.5 * PI));
    let tail = tables_lookup(TABLES_FRACTION, sharpness, abs(sine));
    return select(tail, 1.0 - tail, sine > 0.0);
}

fn tables_lookup(table: u32, sharpness: f32, x: f32) -> f32 {
    let row = sharpness / (sharpness + TABLES_HALF) * f32(TABLES_ROWS);
    let column = x * max(sqrt(sharpness / TABLES_WIDE), 1.0) * f32(TABLES_COLUMNS);
    let i = min(u32(row), TABLES_ROWS - 1u);
    let j = min(u32(column), TABLES_COLUMNS - 1u);
    let u = min(row - f32(i), 1.0);
    let v = min(column - f32(j), 1.0);
    let first = table + i * (TABLES_COLUMNS + 1u) + j;
    let second = first + TABLES_COLUMNS + 1u;
    let a = tables[first] + v * (tables[first + 1u] - tables[first]);
    let b = tables[second] + v * (tables[second + 1u] - tables[second]);
    return a + u * (b - a);
}

fn tables_scale(sharpness: f32) -> f32 {
    let base = sharpness + TABLES_SCALE;
    return base * sqrt(base);
}
