// Where points of sources are, and which of them pixels see.

// The first of the source's entries.
fn sources_entry(source: u32) -> u32 {
    return (frame_index * frames[frame_index].source_count + source) * (1u + SOURCE_RIM + SOURCE_POINTS);
}

// Where source_seen has a source as a workgroup's pixels see it.
fn sources_seen_row(workgroup: u32, source: u32) -> u32 {
    return workgroup * frames[frame_index].source_count + source;
}

// The first texel of a pixel: whether its points are of the second level, in the second bit whether it sees any; then
// points, a bit each. Of the second level there are more texels.
fn sources_seen_place(row: u32, texel: u32, invocation: u32) -> vec2<u32> {
    let column = row % SOURCE_SEEN_COLUMNS * SOURCE_SEEN_TEXELS + texel;
    return vec2(64u * column + invocation, row / SOURCE_SEEN_COLUMNS);
}
