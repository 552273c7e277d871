// Which instance and which pixels a workgroup of 8 × 8 invocations shades.

// The pixel of the images that the tile begins with.
var<private> tile_first: vec2<u32>;

// Call it first, with the number of the workgroup.
fn tile_enter(workgroup: u32) {
    let tile = tiles[workgroup / 4u][workgroup % 4u];
    let column = extractBits(tile, 0u, TILE_COLUMN_BITS);
    let row = extractBits(tile, TILE_COLUMN_BITS, TILE_ROW_BITS);
    tile_first = 8u * vec2(column, row);
    frame_index = tile >> (TILE_COLUMN_BITS + TILE_ROW_BITS);
}

fn tile_pixel(invocation: u32) -> vec2<u32> {
    return tile_first + vec2(invocation % 8u, invocation / 8u);
}
