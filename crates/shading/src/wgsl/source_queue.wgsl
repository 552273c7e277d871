// Pixels and sources that take many rays, in any order, see sources_many.wgsl.
struct SourceQueue {
    // How many wait.
    waiting: atomic<u32>,
    // How many of them are taken next.
    taken: u32,
    reserved: vec2<u32>,
    // The pixel of its tile, from bit SOURCES_SOURCE on the source, whether it takes from the pixels about it, whether it is of
    // the coarse grid, the tile's number in the dispatch. Then the first node that has anything in the way.
    entries: array<vec2<u32>>,
}

const SOURCES_SOURCE: u32 = 6u;
const SOURCES_ASKS: u32 = 10u;
const SOURCES_COARSE: u32 = 11u;
const SOURCES_TILE: u32 = 12u;
