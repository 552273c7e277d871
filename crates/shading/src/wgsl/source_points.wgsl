// Where points of sources are, and which of them pixels see.

// The first of the source's entries.
fn sources_entry(source: u32) -> u32 {
    return (frame_index * frames[frame_index].source_count + source) * SOURCE_STRIDE;
}

// How many points a group of a source has.
fn sources_of_group(entry: u32) -> u32 {
    return u32(source_points[entry + SOURCE_FIRST_RIM].cone_cosine);
}

// Where source_seen has a source as a workgroup's pixels see it.
fn sources_seen_row(workgroup: u32, source: u32) -> u32 {
    return workgroup * frames[frame_index].source_count + source;
}

// The first texel of a pixel: a word about its groups, one bit of each byte for each of them; then of every group that is
// seen in part a word of bits. The other texels are written where those have any.
//
// Bits of the lowest byte: all of the group is seen; of the next: part of it. SOURCE_SHADOWED: behind the groups' words is
// one more, the part of the light that an app's shadow map takes away.
//
// Pixels are numbered among so many: all of a tile, or those of its coarse grid.
fn sources_seen_place(row: u32, texel: u32, pixel: u32, pixels: u32) -> vec2<u32> {
    let column = row % SOURCE_SEEN_COLUMNS * SOURCE_SEEN_TEXELS + texel;
    return vec2(pixels * column + pixel, row / SOURCE_SEEN_COLUMNS);
}
