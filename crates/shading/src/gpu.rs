//! What lies in buffers and uniforms of a GPU; [`crate::pack`] fills them.
//!
//! The structures mirror `wgsl/bindings.wgsl`, member by member and in order.

use bytemuck::{Pod, Zeroable};
use relight_format::MAX_REFLECTIONS;

use crate::camera::View;

/// `Material::surface`: base colour, metallic and roughness as in glTF.
pub const SURFACE_METALLIC_ROUGHNESS: u32 = 0;
/// `Material::surface`: a Lambertian base plus one specular model.
pub const SURFACE_DIFFUSE_SPECULAR: u32 = 1;
/// `Material::surface`: layers, which the anisotropy texture turns.
pub const SURFACE_LAYERS: u32 = 2;

/// Most layers of the basis atlas: WebGPU's default limit.
pub const MAX_ATLAS_LAYERS: u32 = 256;
/// Largest side of the basis atlas in texels: WebGPU's default limit.
pub const MAX_ATLAS_SIZE: u32 = 8192;

/// What changes from frame to frame (uniform, 304 bytes).
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct Frame {
    /// World to clip space, column after column.
    pub view_projection: [[f32; 4]; 4],
    /// Centre of projection, world space; direction towards the viewer if `perspective` is 0.
    pub eye: [f32; 3],
    /// Number of lights.
    pub light_count: u32,
    /// [`View::corner`].
    pub corner: [f32; 3],
    /// 0.
    pub reserved: u32,
    /// Step of the direction from one column to the next.
    pub right: [f32; 3],
    /// Polar: number of spokes.
    pub spokes: u32,
    /// Step of the direction from one row to the next.
    pub down: [f32; 3],
    /// Rows of images from here on hold further surfaces of pixels; `u32::MAX`: there are none.
    pub first_extra_row: u32,
    /// Reciprocal width and height of the basis atlas.
    pub atlas_texel: [f32; 2],
    /// Texels per side of a basis tile, without its gutter.
    pub basis_resolution: f32,
    /// Stored signed distances are clamped to ± this angle, radians.
    pub distance_clamp: f32,
    /// World directions to those of the prefiltered image, column after column.
    pub environment_rotation: [[f32; 4]; 3],
    /// Levels of the prefiltered image; 0: reflections of lobes only.
    pub prefiltered_levels: u32,
    /// Number of local lights.
    pub local_light_count: u32,
    /// Cells: [`crate::shade::CellsOptions::boundary_error`].
    pub boundary_error: f32,
    /// Cells: [`crate::shade::CellsOptions::lobe_error`].
    pub lobe_error: f32,
    /// Cells: rows and columns of the uniform partition, or zero.
    pub cells: [u32; 2],
    /// Number of sources.
    pub source_count: u32,
    /// What the visibility buffer has where the first triangle is seen; the next has one more.
    pub first_id: u32,
    /// Number of triangles.
    pub triangle_count: u32,
    /// Number of vertices.
    pub vertex_count: u32,
    /// 1; 0 where all rays have one direction.
    pub perspective: f32,
    /// 1 where triangles that face the viewer turn clockwise in the picture.
    pub mirrored: u32,
    /// Directions of the scene to those of the world that instances share, column after column.
    pub to_world: [[f32; 4]; 3],
    /// Number of the instance among all of the picture.
    pub instance: u32,
    /// State of a vertex whose light fractions this frame has to find: number of the light shifted by
    /// [`crate::vertex_visibility::FRAME_BITS`], and number of the frame under it. 0: no fractions
    /// at vertices.
    pub vertex_stamp: u32,
    /// 1 where pixels' squares are lit by sources, and not their centres.
    pub source_squares: u32,
    /// Texels of products of bounced light that an instance has.
    pub product_count: u32,
}

/// Most instances of a scene that are shaded together: their [`Frame`]s are one uniform.
pub const MAX_BATCH: u32 = 128;
/// Most workgroups of 8 × 8 pixels of a dispatch: their [`tile`]s are one uniform.
pub const MAX_TILES_AT_ONCE: u32 = 8192;
/// Bits of a [`tile`]'s column and row, which come first.
const TILE_BITS: [u32; 2] = [12, 13];

/// The word that names a workgroup's instance, among those shaded together, and column and row of its
/// tile of 8 × 8 pixels.
pub fn tile(instance: u32, column: u32, row: u32) -> u32 {
    let [columns, rows] = TILE_BITS;
    debug_assert!(instance < MAX_BATCH && column < 1 << columns && row < 1 << rows);
    column | row << columns | instance << (columns + rows)
}

/// Constants of [`tile`].
pub(crate) fn wgsl_constants() -> String {
    let [columns, rows] = TILE_BITS;
    format!(
        "const MAX_BATCH: u32 = {MAX_BATCH}u;\n\
         const MAX_TILES_AT_ONCE: u32 = {MAX_TILES_AT_ONCE}u;\n\
         const TILE_COLUMN_BITS: u32 = {columns}u;\n\
         const TILE_ROW_BITS: u32 = {rows}u;\n"
    )
}

/// Most local lights of a frame.
pub const MAX_LOCAL_LIGHTS: u32 = 128;

/// A sphere that emits (48 bytes).
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct LocalLight {
    /// Centre, world space, metres.
    pub position: [f32; 3],
    /// Metres.
    pub radius: f32,
    /// Linear Rec.709 radiance of the surface.
    pub radiance: [f32; 3],
    /// Falloff of a spot is the square of `spot_scale * cosine + spot_offset`, from 0 to 1.
    pub spot_scale: f32,
    /// Unit vector along the spot.
    pub direction: [f32; 3],
    /// See `spot_scale`.
    pub spot_offset: f32,
}

impl LocalLight {
    /// It among [`Light`]s.
    pub fn entries(&self) -> [Light; 2] {
        let place = Light {
            axis: self.position,
            sharpness: self.radius,
            amplitude: self.radiance,
            vertex_spokes: self.spot_scale,
        };
        let spot = Light {
            axis: self.direction,
            sharpness: self.spot_offset,
            ..Light::zeroed()
        };
        [place, spot]
    }
}

/// A distant spherical Gaussian light (32 bytes).
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct Light {
    /// Unit vector, world space.
    pub axis: [f32; 3],
    /// Sharpness λ.
    pub sharpness: f32,
    /// Linear Rec.709 radiance at the axis.
    pub amplitude: [f32; 3],
    /// Spokes at vertices; 0: not integrated there.
    pub vertex_spokes: f32,
}

/// A direction that a source's light comes from, or a cone around several (32 bytes).
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct SourcePoint {
    /// Unit vector, world space.
    pub direction: [f32; 3],
    /// Distance that rays start from the surface, the same for all; metres.
    pub ray_offset: f32,
    /// Its share of the source's light: ∫ radiance dω, linear Rec.709; zero on the rim.
    pub light: [f32; 3],
    /// Of a cone, whose axis is the direction: the cosine of its half angle. Of the first on the rim: how many points a group
    /// has. 0 in others.
    pub cone_cosine: f32,
}

/// How an app's own shadow map is looked up; a matrix to its clip space follows for each instance, up to
/// [`MAX_BATCH`] (16 bytes).
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct ShadowMap {
    /// 1 where depth grows with distance from the light, −1 where it falls.
    pub sign: f32,
    /// What hides a point is nearer by more than this, in units of depth.
    pub bias: f32,
    /// Which source it is of.
    pub source: u32,
    /// Zero.
    pub reserved: u32,
}

/// A box of the hierarchy of what blocks rays (32 bytes).
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct OccluderNode {
    /// Lowest corner, world space.
    pub low: [f32; 3],
    /// The first node that does not lie within this one.
    pub next: u32,
    /// Highest corner.
    pub high: [f32; 3],
    /// Number of triangles, 0 of an inner node, in the lowest [`Self::COUNT_BITS`]; above, the
    /// first.
    pub triangles: u32,
}

impl OccluderNode {
    /// Bits of the number of triangles.
    pub const COUNT_BITS: u32 = 3;
    /// Most triangles of a node.
    pub const MAX_TRIANGLES: u32 = (1 << Self::COUNT_BITS) - 1;
}

/// A triangle that blocks rays (48 bytes).
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct OccluderTriangle {
    /// Its first corner, world space.
    pub corner: [f32; 3],
    /// Zero.
    pub reserved: f32,
    /// From there to the others; w is zero.
    pub edges: [[f32; 4]; 2],
}

/// A vertex (48 bytes).
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct Vertex {
    /// World space, metres.
    pub position: [f32; 3],
    /// Texture coordinate u.
    pub u: f32,
    /// Shading normal, not necessarily of unit length.
    pub normal: [f32; 3],
    /// Texture coordinate v, down.
    pub v: f32,
    /// xyz: tangent, w: sign of the bitangent.
    pub tangent: [f32; 4],
}

/// A set of vertices that share basis images (32 bytes).
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct Cluster {
    /// First vertex.
    pub first_vertex: u32,
    /// First word of the coefficients: `2 * tiles` words per vertex.
    pub first_word: u32,
    /// Tiles of four basis images.
    pub tiles: u32,
    /// Layer of the atlas.
    pub layer: u32,
    /// Texel coordinates of the first tile's corner, inside its gutter.
    pub tile_origin: [f32; 2],
    /// Radians that a coefficient of 32767 stands for.
    pub coefficient_scale: f32,
    /// Group of bounced light ([`crate::transfer::PackedTransfer`]) + 1; 0: none.
    pub bounced: u32,
}

/// A texture of a material (48 bytes).
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct TextureSlot {
    /// [`crate::textures::PackedTexture::place`].
    pub place: u32,
    /// Texels per row; 0 where there is no texture.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// [`crate::textures::SRGB`] and [`crate::textures::SECOND_UV`], each where it holds.
    pub flags: u32,
    /// u of the texture is `dot(transform_u, (u, v, 1))`.
    pub transform_u: [f32; 3],
    /// [`crate::textures::PackedTexture::coarser`].
    pub coarser: u32,
    /// v of the texture is `dot(transform_v, (u, v, 1))`.
    pub transform_v: [f32; 3],
    /// How often it is halved.
    pub last_level: u32,
}

/// One reflection of a layer, with the Lambertian base that comes with it (256 bytes).
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct Layer {
    /// Diffuse albedo.
    pub diffuse: [f32; 3],
    /// A [`crate::surface::Join`].
    pub join: u32,
    /// Colour at normal incidence, or specular albedo.
    pub specular: [f32; 3],
    /// A [`crate::surface::Model`].
    pub model: u32,
    /// Colour at grazing incidence.
    pub grazing: [f32; 3],
    /// Coverage.
    pub weight: f32,
    /// Roughness along tangent and bitangent; Blinn-Phong: exponent in both.
    pub alpha: [f32; 2],
    /// One more than the place of the reflection's ratio; 0: none.
    pub ratio: u32,
    /// Zero.
    pub reserved: u32,
    /// Multiplies `diffuse`.
    pub diffuse_texture: TextureSlot,
    /// Multiplies `specular`.
    pub specular_texture: TextureSlot,
    /// R and G multiply the roughnesses.
    pub roughness_texture: TextureSlot,
    /// R multiplies `weight`.
    pub weight_texture: TextureSlot,
}

/// A material (2,352 bytes).
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct Material {
    /// Metallic-roughness: base colour.
    pub color: [f32; 3],
    /// [`SURFACE_METALLIC_ROUGHNESS`], [`SURFACE_DIFFUSE_SPECULAR`] or [`SURFACE_LAYERS`].
    pub surface: u32,
    /// Metallic-roughness: 0 dielectric, 1 metal.
    pub metallic: f32,
    /// Metallic-roughness: perceptual roughness.
    pub roughness: f32,
    /// Metallic-roughness: strength of anisotropy.
    pub anisotropy_strength: f32,
    /// Metallic-roughness: direction of anisotropy, radians from the tangent.
    pub anisotropy_rotation: f32,
    /// Scale of the normal map's x and y.
    pub normal_scale: f32,
    /// Entries of `layers` in use.
    pub layer_count: u32,
    /// 0 where there is no Lambertian base anywhere, whatever the textures say.
    pub has_diffuse: u32,
    /// Pairs of texture coordinates that textures are looked up by: 0 where there are none, 2 where any needs
    /// the second.
    pub textured: u32,
    /// Multiplies `color`.
    pub base_color_texture: TextureSlot,
    /// G multiplies `roughness`, B multiplies `metallic`.
    pub metallic_roughness_texture: TextureSlot,
    /// Tangent-space normal map.
    pub normal_texture: TextureSlot,
    /// RG is the direction in [−1, 1], B the strength.
    pub anisotropy_texture: TextureSlot,
    /// Radiance that the surface emits.
    pub emission: [f32; 3],
    /// 1 where it catches shadows, else 0.
    pub shadow_catcher: f32,
    /// Multiplies `emission`.
    pub emission_texture: TextureSlot,
    /// The reflections of other surfaces than metallic-roughness.
    pub layers: [Layer; MAX_REFLECTIONS],
}

/// How radiance becomes what a target holds, and what is behind it (uniform, 160 bytes).
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct Composite {
    /// Columns and rows of the images.
    pub size: [f32; 2],
    /// Multiplies radiance.
    pub exposure: f32,
    /// 0 for linear radiance, 1 for tone-mapped colour, 2 for that encoded as sRGB.
    pub encoding: u32,
    /// 1 where the target's depth grows with distance.
    pub flipped_depth: u32,
    /// [`BACKGROUND_NONE`], [`BACKGROUND_COLOR`] or [`BACKGROUND_IMAGE`].
    pub background: u32,
    /// Of an image: levels of its texture.
    pub levels: u32,
    /// Of an image: that of the lobe that it is seen through.
    pub sharpness: f32,
    /// [`View::corner`].
    pub corner: [f32; 3],
    /// 1.0; 0.0 where all rays have one direction.
    pub perspective: f32,
    /// [`View::right`].
    pub right: [f32; 3],
    /// Zero.
    pub reserved_0: u32,
    /// [`View::down`].
    pub down: [f32; 3],
    /// Zero.
    pub reserved_1: u32,
    /// [`View::eye`].
    pub eye: [f32; 3],
    /// Zero.
    pub reserved_2: u32,
    /// Of a colour: linear radiance.
    pub color: [f32; 3],
    /// Zero.
    pub reserved_3: u32,
    /// World directions to those of the image, column after column.
    pub rotation: [[f32; 4]; 3],
}

/// Where a scene was in the frame before (uniform, 80 bytes).
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct Motion {
    /// The scene's own space to that frame's clip space, column after column.
    pub before: [[f32; 4]; 4],
    /// Columns and rows of the picture.
    pub size: [f32; 2],
    /// Zero.
    pub reserved_0: u32,
    /// Zero.
    pub reserved_1: u32,
}

/// What fills one level of a texture with an image (uniform, 32 bytes).
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct TextureFill {
    /// Column, row and layer of the level's first texel.
    pub corner: [u32; 3],
    /// 1 where colours are stored as sRGB.
    pub srgb: u32,
    /// Columns and rows of the level.
    pub size: [u32; 2],
    /// Zero.
    pub reserved_0: u32,
    /// Zero.
    pub reserved_1: u32,
}

/// Nothing behind the scene.
pub const BACKGROUND_NONE: u32 = 0;
/// One colour.
pub const BACKGROUND_COLOR: u32 = 1;
/// The texture `prefiltered`.
pub const BACKGROUND_IMAGE: u32 = 2;

/// What a packed scene looks like to [`Frame`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AtlasLayout {
    /// Texels per side of a tile, without its gutter.
    pub basis_resolution: u32,
    /// Texels per row of a layer.
    pub width: u32,
    /// Rows of a layer.
    pub height: u32,
    /// Layers.
    pub layers: u32,
}

/// A scene needs more of something than the GPU, or this layout, offers.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{limit} is {allowed}, needed {needed}")]
pub struct LimitError {
    /// Name of the limit, that of `wgpu::Limits` where there is one.
    pub limit: &'static str,
    /// What the scene needs.
    pub needed: u64,
    /// What is allowed.
    pub allowed: u64,
}

impl LimitError {
    /// An error unless `needed` is at most `allowed`.
    pub fn check(limit: &'static str, needed: u64, allowed: u64) -> Result<(), Self> {
        if needed <= allowed {
            Ok(())
        } else {
            Err(Self {
                limit,
                needed,
                allowed,
            })
        }
    }
}

impl Frame {
    /// The frame of a packed scene seen through `view`, before lights and method are set:
    /// no lights.
    pub fn new(view: &View, atlas: &AtlasLayout, distance_clamp: f32) -> Self {
        Self {
            atlas_texel: [1.0 / atlas.width as f32, 1.0 / atlas.height as f32],
            basis_resolution: atlas.basis_resolution as f32,
            distance_clamp,
            ..Self::of_view(view)
        }
    }

    /// The frame of no scene.
    pub fn of_view(view: &View) -> Self {
        Self {
            view_projection: view.view_projection.to_cols_array_2d(),
            eye: view.eye.into(),
            light_count: 0,
            corner: view.corner.into(),
            reserved: 0,
            right: view.right.into(),
            spokes: 0,
            down: view.down.into(),
            first_extra_row: u32::MAX,
            atlas_texel: [0.0; 2],
            basis_resolution: 0.0,
            distance_clamp: 0.0,
            environment_rotation: [
                [1.0, 0.0, 0.0, 0.0],
                [0.0, 1.0, 0.0, 0.0],
                [0.0, 0.0, 1.0, 0.0],
            ],
            prefiltered_levels: 0,
            local_light_count: 0,
            boundary_error: 0.0,
            lobe_error: 0.0,
            cells: [0; 2],
            source_count: 0,
            first_id: 1,
            triangle_count: u32::MAX,
            vertex_count: 0,
            perspective: view.homogeneous_eye().w,
            mirrored: u32::from(view.mirrored),
            to_world: [
                [1.0, 0.0, 0.0, 0.0],
                [0.0, 1.0, 0.0, 0.0],
                [0.0, 0.0, 1.0, 0.0],
            ],
            instance: 0,
            vertex_stamp: 0,
            source_squares: 0,
            product_count: 0,
        }
    }
}

#[cfg(test)]
mod tests {
    use std::mem::{offset_of, size_of};

    use super::*;
    use crate::wgsl::{Entry, source};

    /// Compares a Rust structure with the WGSL one of the same name, both ways round.
    macro_rules! check_layout {
        ($module:expr, $name:ident { $($member:ident),* $(,)? }) => {{
            let (_, found) = $module
                .types
                .iter()
                .find(|(_, found)| found.name.as_deref() == Some(stringify!($name)))
                .expect(concat!(stringify!($name), " is in the WGSL"));
            let naga::TypeInner::Struct { members, span } = &found.inner else {
                panic!("{} is no structure", stringify!($name));
            };
            assert_eq!(*span as usize, size_of::<$name>(), "size of {}", stringify!($name));
            let wgsl: Vec<_> = members
                .iter()
                .map(|member| (member.name.as_deref().unwrap_or(""), member.offset as usize))
                .collect();
            let rust = vec![$((stringify!($member), offset_of!($name, $member))),*];
            assert_eq!(wgsl, rust, "members of {}", stringify!($name));
        }};
    }

    #[test]
    #[allow(clippy::too_many_lines, reason = "a table of structures")]
    fn structures_match_wgsl() {
        let module = naga::front::wgsl::parse_str(&source(Entry::Composite)).expect("valid WGSL");
        check_layout!(
            module,
            Composite {
                size,
                exposure,
                encoding,
                flipped_depth,
                background,
                levels,
                sharpness,
                corner,
                perspective,
                right,
                reserved_0,
                down,
                reserved_1,
                eye,
                reserved_2,
                color,
                reserved_3,
                rotation,
            }
        );
        let module = naga::front::wgsl::parse_str(&source(Entry::FillTexture)).expect("valid WGSL");
        check_layout!(
            module,
            TextureFill {
                corner,
                srgb,
                size,
                reserved_0,
                reserved_1,
            }
        );
        let module = naga::front::wgsl::parse_str(&source(Entry::Motion)).expect("valid WGSL");
        check_layout!(
            module,
            Motion {
                before,
                size,
                reserved_0,
                reserved_1,
            }
        );
        let module = naga::front::wgsl::parse_str(&source(Entry::Library)).expect("valid WGSL");
        check_layout!(
            module,
            Frame {
                view_projection,
                eye,
                light_count,
                corner,
                reserved,
                right,
                spokes,
                down,
                first_extra_row,
                atlas_texel,
                basis_resolution,
                distance_clamp,
                environment_rotation,
                prefiltered_levels,
                local_light_count,
                boundary_error,
                lobe_error,
                cells,
                source_count,
                first_id,
                triangle_count,
                vertex_count,
                perspective,
                mirrored,
                to_world,
                instance,
                vertex_stamp,
                source_squares,
                product_count,
            }
        );
        check_layout!(
            module,
            SourcePoint {
                direction,
                ray_offset,
                light,
                cone_cosine
            }
        );
        check_layout!(
            module,
            OccluderNode {
                low,
                next,
                high,
                triangles
            }
        );
        check_layout!(
            module,
            OccluderTriangle {
                corner,
                reserved,
                edges
            }
        );
        check_layout!(
            module,
            LocalLight {
                position,
                radius,
                radiance,
                spot_scale,
                direction,
                spot_offset,
            }
        );
        check_layout!(
            module,
            Light {
                axis,
                sharpness,
                amplitude,
                vertex_spokes
            }
        );
        check_layout!(
            module,
            Vertex {
                position,
                u,
                normal,
                v,
                tangent
            }
        );
        check_layout!(
            module,
            Cluster {
                first_vertex,
                first_word,
                tiles,
                layer,
                tile_origin,
                coefficient_scale,
                bounced,
            }
        );
        check_layout!(
            module,
            TextureSlot {
                place,
                width,
                height,
                flags,
                transform_u,
                coarser,
                transform_v,
                last_level,
            }
        );
        check_layout!(
            module,
            Layer {
                diffuse,
                join,
                specular,
                model,
                grazing,
                weight,
                alpha,
                ratio,
                reserved,
                diffuse_texture,
                specular_texture,
                roughness_texture,
                weight_texture,
            }
        );
        check_layout!(
            module,
            Material {
                color,
                surface,
                metallic,
                roughness,
                anisotropy_strength,
                anisotropy_rotation,
                normal_scale,
                layer_count,
                has_diffuse,
                textured,
                base_color_texture,
                metallic_roughness_texture,
                normal_texture,
                anisotropy_texture,
                emission,
                shadow_catcher,
                emission_texture,
                layers,
            }
        );
    }
}
