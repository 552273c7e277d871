// Every structure and resource that the shading stages share. The Rust side is gpu.rs,
// whose tests compare sizes and member offsets with this file as naga sees it.

// What changes from frame to frame.
struct Frame {
    // World to clip space: reversed depth. The world is the scene's own: what stands turned, moved
    // or scaled is seen through a camera turned, moved and scaled.
    view_projection: mat4x4<f32>,
    // Centre of projection, world space; direction towards the viewer if perspective is 0.
    eye: vec3<f32>,
    light_count: u32,
    // The ray of pixel (x, y) has direction, or passes through, corner + (x + 1/2) right +
    // (y + 1/2) down.
    corner: vec3<f32>,
    reserved: u32,
    right: vec3<f32>,
    // polar: number of spokes.
    spokes: u32,
    down: vec3<f32>,
    // Rows of images from here on hold further surfaces of pixels.
    first_extra_row: u32,
    // 1 / width and 1 / height of the basis atlas.
    atlas_texel: vec2<f32>,
    // Texels per side of a basis tile, without its gutter.
    basis_resolution: f32,
    // Stored signed distances are clamped to +- this angle, radians.
    distance_clamp: f32,
    // World directions to those of the prefiltered image.
    environment_rotation: mat3x3<f32>,
    // Levels of the prefiltered image; 0: reflections of lobes only.
    prefiltered_levels: u32,
    local_light_count: u32,
    // cells: thresholds of division.
    boundary_error: f32,
    lobe_error: f32,
    // cells: rows and columns of the uniform partition, or zero.
    cells: vec2<u32>,
    source_count: u32,
    // What visibility_buffer has where the first triangle is seen; the next has one more.
    first_id: u32,
    triangle_count: u32,
    // Vertices of the scene.
    vertex_count: u32,
    // 1.0; 0.0: all rays have one direction.
    perspective: f32,
    // 1: triangles that face the viewer turn clockwise in the picture.
    mirrored: u32,
    // Directions of the scene to those of the world that instances share.
    to_world: mat3x3<f32>,
    // Number of the instance among all of the picture.
    instance: u32,
    // State of a vertex whose light fractions this frame has to find: number of the light <<
    // VERTEX_VISIBILITY_FRAME_BITS | number of the frame under it. 0: no fractions at vertices.
    vertex_stamp: u32,
    // 1 where pixels' squares are lit by sources, and not their centres.
    source_squares: u32,
    // Texels of transfer_products that an instance has.
    product_count: u32,
}

// A sphere that emits.
struct LocalLight {
    position: vec3<f32>,
    radius: f32,
    radiance: vec3<f32>,
    // Falloff of a spot is the square of spot_scale * cosine + spot_offset, from 0 to 1.
    spot_scale: f32,
    direction: vec3<f32>,
    spot_offset: f32,
}

// A distant light: amplitude exp(sharpness (axis . w - 1)), linear radiance.
struct Light {
    axis: vec3<f32>,
    sharpness: f32,
    amplitude: vec3<f32>,
    // Spokes at vertices; 0: not integrated there.
    vertex_spokes: f32,
}

// A direction that a source's light comes from, or a cone around several.
struct SourcePoint {
    direction: vec3<f32>,
    // Distance that rays start from the surface, the same for all.
    ray_offset: f32,
    // Its share of the source's light. Of a source's first entry, the cone around all others: how many rays a group asks
    // for where something is in the way, then zeros.
    light: vec3<f32>,
    // Of a cone: the cosine of its half angle.
    cone_cosine: f32,
}

// A box of the hierarchy of what blocks rays.
struct OccluderNode {
    low: vec3<f32>,
    // The first node that does not lie within this one.
    next: u32,
    high: vec3<f32>,
    // First triangle << OCCLUDERS_COUNT_BITS | number of triangles.
    triangles: u32,
}

// A triangle that blocks rays.
struct OccluderTriangle {
    corner: vec3<f32>,
    reserved: f32,
    // From there to the other corners.
    edges: array<vec4<f32>, 2>,
}

struct Vertex {
    position: vec3<f32>,
    u: f32,
    // Shading normal, not necessarily of unit length.
    normal: vec3<f32>,
    v: f32,
    // w: sign of the bitangent cross(normal, tangent).
    tangent: vec4<f32>,
}

// A set of vertices that share basis images.
struct Cluster {
    first_vertex: u32,
    // First word in `coefficients`; vertex after vertex, 2 * tiles words each.
    first_word: u32,
    // Basis tiles of four channels each, at most MAX_TILES.
    tiles: u32,
    // Layer of the atlas.
    layer: u32,
    // Texel coordinates of the corner of the first tile, inside its gutter. The next tile
    // lies basis_resolution + 2 texels to the right.
    tile_origin: vec2<f32>,
    // Radians that a coefficient of 32767 stands for.
    coefficient_scale: f32,
    // Group of bounced light + 1; 0: none.
    bounced: u32,
}

// A texture in `texels`, one RGBA8 word each (red in the low byte), row 0 first.
struct TextureSlot {
    // First texel: column | row << TEXTURES_SIDE_BITS | layer << 2 TEXTURES_SIDE_BITS.
    place: u32,
    // 0: no texture.
    width: u32,
    height: u32,
    // TEXTURES_SRGB: red, green and blue are sRGB encoded, else all channels are linear.
    // TEXTURES_SECOND_UV: u and v are those of textures_second_uv.
    flags: u32,
    // u and v of the texture are dot(row, vec3(u, v, 1)) of the vertex.
    transform_u: vec3<f32>,
    // As `place`, of the texture at half its size; the next halves stand to its right, one above the
    // other.
    coarser: u32,
    transform_v: vec3<f32>,
    // How often it is halved.
    last_level: u32,
}

// One reflection of a layer, with the Lambertian base that comes with it.
struct Layer {
    diffuse: vec3<f32>,
    // JOIN_ADD, JOIN_OVER or JOIN_COAT.
    join: u32,
    // Colour at normal incidence, or specular albedo.
    specular: vec3<f32>,
    // MODEL_*.
    model: u32,
    // Colour at grazing incidence.
    grazing: vec3<f32>,
    // Coverage.
    weight: f32,
    // Roughness along tangent and bitangent; Blinn-Phong: exponent in both.
    alpha: vec2<f32>,
    // One more than the place of the reflection's ratio; 0: none.
    ratio: u32,
    reserved: u32,
    diffuse_texture: TextureSlot,
    specular_texture: TextureSlot,
    roughness_texture: TextureSlot,
    weight_texture: TextureSlot,
}

struct Material {
    // Metallic-roughness: base colour.
    color: vec3<f32>,
    // SURFACE_METALLIC_ROUGHNESS, SURFACE_DIFFUSE_SPECULAR or SURFACE_LAYERS.
    surface: u32,
    // Metallic-roughness, as in format::Surface.
    metallic: f32,
    roughness: f32,
    anisotropy_strength: f32,
    anisotropy_rotation: f32,
    // Scale of the normal map's x and y.
    normal_scale: f32,
    // Layers in use.
    layer_count: u32,
    // 0: no Lambertian base anywhere.
    has_diffuse: u32,
    // 0: no textures.
    textured: u32,
    base_color_texture: TextureSlot,
    metallic_roughness_texture: TextureSlot,
    normal_texture: TextureSlot,
    anisotropy_texture: TextureSlot,
    // Radiance that the surface emits.
    emission: vec3<f32>,
    // 1.0 where it catches shadows, else 0.
    shadow_catcher: f32,
    emission_texture: TextureSlot,
    layers: array<Layer, MAX_REFLECTIONS>,
}

// Instances of one scene. Numbers and sizes are the same for all.
@group(0) @binding(0) var<uniform> frames: array<Frame, MAX_BATCH>;
// The one that an invocation is of.
var<private> frame_index: u32;
// Distant lights and, two entries each, local ones: of one instance after the other.
@group(0) @binding(1) var<storage, read> lights: array<Light>;
// shade::gpu_tables().
@group(0) @binding(2) var<storage, read> tables: array<f32>;
// What the workgroups of a dispatch shade, see tile_enter.
@group(0) @binding(3) var<uniform> tiles: array<vec4<u32>, MAX_TILES_AT_ONCE / 4u>;
// Texels of format::Prefiltered in order, PREFILTERED_TEXTURE_WIDTH per row.
@group(0) @binding(4) var prefiltered: texture_2d<u32>;
// Rows of colours of every group of transfer.rs, TRANSFER_STRIDE texels per group, of one instance after the
// other, TRANSFER_TEXTURE_WIDTH per row.
@group(0) @binding(7) var transfer_products: texture_2d<f32>;
// Visible fractions of four lights, vertex after vertex and instance after instance,
// VERTEX_VISIBILITY_TEXTURE_WIDTH per row.
@group(0) @binding(8) var light_fractions: texture_2d<f32>;

// Sources alone: SOURCE_STRIDE entries of each, of one instance after the other.
@group(0) @binding(5) var<storage, read> source_points: array<SourcePoint>;

@group(1) @binding(0) var<storage, read> vertices: array<Vertex>;
// Three vertices, then material | cluster << 16.
@group(1) @binding(1) var<storage, read> triangles: array<vec4<u32>>;
@group(1) @binding(2) var<storage, read> clusters: array<Cluster>;
// Two i16 per word, the first in the low half; c / 32767 is the coefficient. A tile at a time.
@group(1) @binding(3) var<storage, read> coefficients: array<vec2<u32>>;
@group(1) @binding(4) var<storage, read> materials: array<Material>;
// The same, word by word.
@group(1) @binding(4) var<storage, read> material_words: array<vec4<u32>>;
// textures::PageLayout.
@group(1) @binding(5) var texels: texture_2d_array<u32>;
// rgba8snorm tiles, each with a one-texel gutter that continues the octahedral map.
@group(1) @binding(6) var basis_atlas: texture_2d_array<f32>;
@group(1) @binding(7) var basis_sampler: sampler;
// Sources alone.
@group(1) @binding(8) var<storage, read> occluder_nodes: array<OccluderNode>;
@group(1) @binding(9) var<storage, read> occluder_triangles: array<OccluderTriangle>;
// PackedTransfer::words, TRANSFER_TEXTURE_WIDTH per row.
@group(1) @binding(10) var transfer_words: texture_2d<u32>;

// first_id + triangle, 0 is background; and at which point of the image, see seen_ray.
@group(2) @binding(0) var visibility_buffer: texture_2d<u32>;
// Linear radiance; alpha is 1 where a surface was shaded and 0 on the background.
@group(2) @binding(1) var radiance: texture_storage_2d<rgba32float, write>;
// Light fractions at vertices alone: the stamp of the frame that each was last wanted in, and what
// light_fractions is.
@group(2) @binding(4) var<storage, read_write> vertex_states: array<atomic<u32>>;
@group(2) @binding(5) var light_fractions_found: texture_storage_2d<rgba32float, write>;
// Sources alone: which points of them pixels see, see sources_seen_place.
@group(2) @binding(1) var source_seen_found: texture_storage_2d<rgba32uint, write>;
@group(2) @binding(2) var source_seen: texture_2d<u32>;
// What is known of a pixel's radiance, and lobes that wait to be integrated, see slots.wgsl.
@group(2) @binding(7) var<storage, read_write> slots_gathered: array<vec4<u32>>;
