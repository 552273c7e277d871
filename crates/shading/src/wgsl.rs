//! Shader sources: the files of `wgsl/` joined, with constants taken from the Rust side.

use std::fmt::Write as _;

use crate::surface::{Join, Model};
use crate::{
    brdf, catcher, glossy, gpu, local_light, motion, occluders, pixel_visibility, polar,
    prefiltered, shade, slots, sources, spherical_gaussian, surface, surfaces, tables, textures,
    tonemap, transfer, vertex_visibility,
};

/// What a shader module is for.
///
/// Kernels of workgroups of 8 × 8 pixels, but for `surfaces_main`, are dispatched along x, one workgroup for each
/// [`gpu::tile`] that is bound; `sources_main` along z for each source as well.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Entry {
    /// Triangle under each pixel: `visibility_buffer_vertex`, `visibility_buffer_fragment`.
    VisibilityBuffer,
    /// The same, four samples per pixel: `surface_samples_vertex`, `surface_samples_fragment`.
    SurfaceSamples,
    /// Samples of visibility to the surfaces of every pixel: `surfaces_main`, workgroups of a tile.
    Surfaces,
    /// Visible fractions of lights at vertices: `vertices_mark`, workgroups of 8 × 8 pixels, and
    /// `vertices_main`, workgroups of 64 vertices (x) and four lights (y), for the instance of each tile bound (z).
    Vertices,
    /// Visibility buffer to what it shows of textures: `seen_textures_main`, as the following seven
    /// workgroups of 8 × 8 pixels.
    SeenTextures,
    /// Visibility buffer to a reflection and its lobes: `reflections_main`.
    Reflections,
    /// Lambertian base and lights to what it shows of them: `diffuse_main`.
    Diffuse,
    /// Reflection and lights to lobes that wait: `products_main`.
    Products,
    /// Lobes that wait to what is visible of them: `integrals_main`.
    Integrals,
    /// Reflection to what it shows of other surfaces and, of the Lambertian base, of a prefiltered
    /// image: `around_main`.
    Around,
    /// Reflection to what it shows of a prefiltered image: `images_main`.
    Images,
    /// What is gathered to linear radiance: `shade_main`.
    Shade,
    /// Visibility buffer to linear radiance by cells: `cells_main`, workgroups of 8 × 8 pixels.
    #[cfg(feature = "paper")]
    ShadeCells,
    /// Visibility buffer, and what it shows of textures, to which points of sources it sees: of a tile's coarse grid of pixels, for four
    /// sources, `sources_coarse_main`; then `sources_main` or, with an app's own shadow map, `sources_shadowed_main`,
    /// workgroups of 8 × 8 pixels.
    Sources,
    /// Those, and materials, to what sources add to the radiance: `sources_shown_main`, workgroups of 8 × 8 pixels.
    SourcesShown,
    /// Visibility buffer to where it was in the frame before: `motion_main`, workgroups of 8 × 8 pixels.
    Motion,
    /// An image into one level of a material's texture: `fill_texture_main`, workgroups of 8 × 8 texels.
    FillTexture,
    /// Linear radiance into a target: `composite_vertex`; `composite_fragment` or, where the target
    /// has depth, `composite_depth_fragment`. What is behind it: `background_vertex`,
    /// `background_fragment`.
    Composite,
    /// The same for pixels of several surfaces: `composite_vertex`; `composite_surfaces_fragment` and
    /// `composite_surfaces_depth_fragment` for targets of one sample, `composite_sample_fragment` and
    /// `composite_sample_depth_fragment` for those of four.
    CompositeSurfaces,
    /// Functions and bindings without an entry point, to append kernels to.
    Library,
}

impl Entry {
    /// All of them.
    pub const ALL: &[Self] = &[
        Self::VisibilityBuffer,
        Self::SurfaceSamples,
        Self::Surfaces,
        Self::Vertices,
        Self::SeenTextures,
        Self::Reflections,
        Self::Diffuse,
        Self::Products,
        Self::Integrals,
        Self::Around,
        Self::Images,
        Self::Shade,
        #[cfg(feature = "paper")]
        Self::ShadeCells,
        Self::Sources,
        Self::SourcesShown,
        Self::Motion,
        Self::FillTexture,
        Self::Composite,
        Self::CompositeSurfaces,
        Self::Library,
    ];
}

/// A compute pipeline.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Kernel {
    /// What it does.
    pub name: &'static str,
    /// Its module.
    pub entry: Entry,
    /// Its function.
    pub entry_point: &'static str,
    /// Values of its module's overridable constants.
    pub constants: &'static [(&'static str, f64)],
}

/// All compute pipelines that shade.
pub const KERNELS: &[Kernel] = &[
    VERTICES_MARK,
    VERTICES,
    SEEN_TEXTURES[0],
    SEEN_TEXTURES[1],
    REFLECTIONS[0],
    REFLECTIONS[1],
    DIFFUSE[0],
    DIFFUSE[1],
    PRODUCTS[0],
    PRODUCTS[1],
    INTEGRALS[0],
    INTEGRALS[1],
    INTEGRALS[2],
    INTEGRALS[3],
    AROUND[0],
    AROUND[1],
    IMAGES,
    SHADE[0],
    SHADE[1],
    #[cfg(feature = "paper")]
    SHADE_CELLS[0],
    #[cfg(feature = "paper")]
    SHADE_CELLS[1],
    SOURCES_COARSE,
    SOURCES,
    SOURCES_SHADOWED,
    SOURCES_SHOWN,
];

/// Marks the vertices that a frame sees.
pub const VERTICES_MARK: Kernel = Kernel {
    name: "vertices mark",
    entry: Entry::Vertices,
    entry_point: "vertices_mark",
    constants: &[],
};

/// Finds the visible fractions of lights at them.
pub const VERTICES: Kernel = Kernel {
    name: "vertices",
    entry: Entry::Vertices,
    entry_point: "vertices_main",
    constants: &[],
};

/// What every pixel sees of its material's textures by their first texture coordinates, and by the second.
pub const SEEN_TEXTURES: [Kernel; 2] = [
    shading(
        "textures",
        (Entry::SeenTextures, "seen_textures_main"),
        &[("TEXTURES_SECOND_UVS", 0.0)],
    ),
    shading(
        "textures, second",
        (Entry::SeenTextures, "seen_textures_main"),
        &[("TEXTURES_SECOND_UVS", 1.0)],
    ),
];

/// What every pixel's Lambertian base shows of lights; the same by one visible fraction for all of a light.
pub const DIFFUSE: [Kernel; 2] = [
    shading(
        "diffuse",
        (Entry::Diffuse, "diffuse_main"),
        &[("PIXEL_AMBIENT", 0.0)],
    ),
    shading(
        "diffuse, ambient",
        (Entry::Diffuse, "diffuse_main"),
        &[("PIXEL_AMBIENT", 1.0)],
    ),
];

/// The first reflection of every pixel and its lobes, and the next one.
pub const REFLECTIONS: [Kernel; 2] = [
    shading(
        "reflections",
        (Entry::Reflections, "reflections_main"),
        &[("REFLECTIONS_FIRST", 1.0)],
    ),
    shading(
        "reflections, next",
        (Entry::Reflections, "reflections_main"),
        &[("REFLECTIONS_FIRST", 0.0)],
    ),
];

/// Lobes of lights and a reflection; to say what is visible of a prefiltered image.
pub const PRODUCTS: [Kernel; 2] = [
    shading(
        "products",
        (Entry::Products, "products_main"),
        &[("PRODUCTS_OF_IMAGE", 0.0)],
    ),
    shading(
        "products, image",
        (Entry::Products, "products_main"),
        &[("PRODUCTS_OF_IMAGE", 1.0)],
    ),
];

/// What is visible of them, for an image at odd places; from 2 on by one visible fraction for all of a lobe.
pub const INTEGRALS: [Kernel; 4] = [
    shading(
        "integrals",
        (Entry::Integrals, "integrals_main"),
        &[("INTEGRALS_OF_IMAGE", 0.0), ("PIXEL_AMBIENT", 0.0)],
    ),
    shading(
        "integrals, image",
        (Entry::Integrals, "integrals_main"),
        &[("INTEGRALS_OF_IMAGE", 1.0), ("PIXEL_AMBIENT", 0.0)],
    ),
    shading(
        "integrals, ambient",
        (Entry::Integrals, "integrals_main"),
        &[("INTEGRALS_OF_IMAGE", 0.0), ("PIXEL_AMBIENT", 1.0)],
    ),
    shading(
        "integrals, image, ambient",
        (Entry::Integrals, "integrals_main"),
        &[("INTEGRALS_OF_IMAGE", 1.0), ("PIXEL_AMBIENT", 1.0)],
    ),
];

/// What is around beside the lights: other surfaces, an image.
pub const AROUND: [Kernel; 2] = [
    shading(
        "around, bounced light",
        (Entry::Around, "around_main"),
        &[("AROUND_IMAGE", 0.0)],
    ),
    shading(
        "around, image",
        (Entry::Around, "around_main"),
        &[("AROUND_IMAGE", 1.0)],
    ),
];

/// What a reflection shows of a prefiltered image.
pub const IMAGES: Kernel = shading("images", (Entry::Images, "images_main"), &[]);

/// Radiance of every pixel; the same of scenes with second texture coordinates.
pub const SHADE: [Kernel; 2] = [
    shading(
        "shade",
        (Entry::Shade, "shade_main"),
        &[("TEXTURES_SECOND_UVS", 0.0)],
    ),
    shading(
        "shade, second",
        (Entry::Shade, "shade_main"),
        &[("TEXTURES_SECOND_UVS", 1.0)],
    ),
];

const fn shading(
    name: &'static str,
    (entry, entry_point): (Entry, &'static str),
    constants: &'static [(&'static str, f64)],
) -> Kernel {
    Kernel {
        name,
        entry,
        entry_point,
        constants,
    }
}

/// Radiance of every pixel, by cells; the same of scenes with second texture coordinates.
#[cfg(feature = "paper")]
pub const SHADE_CELLS: [Kernel; 2] = [
    shading(
        "shade by cells",
        (Entry::ShadeCells, "cells_main"),
        &[("TEXTURES_SECOND_UVS", 0.0)],
    ),
    shading(
        "shade by cells, second",
        (Entry::ShadeCells, "cells_main"),
        &[("TEXTURES_SECOND_UVS", 1.0)],
    ),
];

/// Which points of every source the pixels see that take nothing from others.
pub const SOURCES_COARSE: Kernel = shading(
    "sources, coarse",
    (Entry::Sources, "sources_coarse_main"),
    &[],
);

/// Which points of every source every pixel sees.
pub const SOURCES: Kernel = shading("sources", (Entry::Sources, "sources_main"), &[]);

/// The same, with an app's own shadow map.
pub const SOURCES_SHADOWED: Kernel = shading(
    "sources, shadow map",
    (Entry::Sources, "sources_shadowed_main"),
    &[],
);

/// What those add to every pixel.
pub const SOURCES_SHOWN: Kernel = shading(
    "sources, shown",
    (Entry::SourcesShown, "sources_shown_main"),
    &[],
);

/// [`Entry::Motion`].
pub const MOTION: Kernel = Kernel {
    name: "motion",
    entry: Entry::Motion,
    entry_point: "motion_main",
    constants: &[],
};

/// [`Entry::FillTexture`].
pub const FILL_TEXTURE: Kernel = Kernel {
    name: "fill texture",
    entry: Entry::FillTexture,
    entry_point: "fill_texture_main",
    constants: &[],
};

/// [`Entry::Surfaces`]; before shading, with antialiasing.
pub const SURFACES: Kernel = Kernel {
    name: "surfaces",
    entry: Entry::Surfaces,
    entry_point: "surfaces_main",
    constants: &[],
};

/// Names that shared files use and other files define, each of those in its own way: WGSL cannot hand functions or
/// textures to functions. A module has one of the files. All other names are defined once among all files;
/// `tests/suite/modules.rs` holds both.
#[derive(Clone, Copy, Debug)]
pub struct Interface {
    /// What a file that has all of these names is.
    pub what: &'static str,
    /// Functions or bindings.
    pub names: &'static [&'static str],
    /// The files that define them.
    pub files: &'static [&'static str],
}

/// All of them.
pub const INTERFACES: &[Interface] = &[
    Interface {
        what: "where a reflection's lobes, sums over them and what is seen of textures are: with the invocation, or where passes hand them on",
        names: &[
            "lobes_put",
            "lobes_shape",
            "lobes_grey",
            "lobes_color",
            "lobes_reflection",
            "lobes_view",
            "lobes_in_world",
            "lobes_put_sum",
            "lobes_sum",
            "surface_texture",
        ],
        files: &["lobes.wgsl", "slots.wgsl"],
    },
    Interface {
        what: "the lobe that a pixel of a tile asks about: a light, or one that waits and ends at planes",
        names: &["pixel_axis", "PIXEL_CLIPS"],
        files: &["diffuse.wgsl", "integrals.wgsl"],
    },
    Interface {
        what: "the prefiltered image: that of reflections, or that of the background",
        names: &["prefiltered"],
        files: &["background.wgsl", "bindings.wgsl"],
    },
];

/// Joined in this order; the order does not matter to WGSL.
const LIBRARY: &[&str] = &[
    include_str!("wgsl/bindings.wgsl"),
    include_str!("wgsl/tile.wgsl"),
    include_str!("wgsl/camera.wgsl"),
    include_str!("wgsl/seen.wgsl"),
    include_str!("wgsl/octahedral.wgsl"),
    include_str!("wgsl/spherical_gaussian.wgsl"),
    include_str!("wgsl/prefiltered.wgsl"),
    include_str!("wgsl/local_light.wgsl"),
    include_str!("wgsl/tables.wgsl"),
    include_str!("wgsl/ssdf.wgsl"),
    include_str!("wgsl/polar.wgsl"),
    include_str!("wgsl/ambient.wgsl"),
    include_str!("wgsl/textures.wgsl"),
    include_str!("wgsl/surface.wgsl"),
    include_str!("wgsl/brdf.wgsl"),
    include_str!("wgsl/models.wgsl"),
    include_str!("wgsl/glossy.wgsl"),
    include_str!("wgsl/transfer.wgsl"),
    include_str!("wgsl/vertex_visibility.wgsl"),
    include_str!("wgsl/light.wgsl"),
];

/// What draws pixels and what is behind them.
const COMPOSITE: &[&str] = &[
    include_str!("wgsl/octahedral.wgsl"),
    include_str!("wgsl/prefiltered.wgsl"),
    include_str!("wgsl/tonemap.wgsl"),
    include_str!("wgsl/background.wgsl"),
    include_str!("wgsl/catcher.wgsl"),
    include_str!("wgsl/composite.wgsl"),
];

/// The files of the first of [`INTERFACES`].
const LOBES: &str = include_str!("wgsl/lobes.wgsl");
const SLOTS: &str = include_str!("wgsl/slots.wgsl");

fn library(lobes: &str) -> String {
    LIBRARY.concat() + lobes
}

/// What the pixels of a tile find together.
const PIXEL_VISIBILITY: &str = concat!(
    include_str!("wgsl/parents.wgsl"),
    include_str!("wgsl/pixel_visibility.wgsl")
);

/// The complete WGSL of one module.
pub fn source(entry: Entry) -> String {
    let mut source = constants();
    match entry {
        Entry::VisibilityBuffer => {
            source += include_str!("wgsl/bindings.wgsl");
            source += include_str!("wgsl/visibility_buffer.wgsl");
        }
        Entry::SurfaceSamples => {
            source += include_str!("wgsl/bindings.wgsl");
            source += include_str!("wgsl/octahedral.wgsl");
            source += include_str!("wgsl/surface_samples.wgsl");
        }
        Entry::Surfaces => {
            source += include_str!("wgsl/bindings.wgsl");
            source += include_str!("wgsl/camera.wgsl");
            source += include_str!("wgsl/octahedral.wgsl");
            source += include_str!("wgsl/surfaces.wgsl");
        }
        Entry::Vertices => {
            source += &library(LOBES);
            source += include_str!("wgsl/vertices.wgsl");
        }
        Entry::Diffuse => {
            source += &library(SLOTS);
            source += PIXEL_VISIBILITY;
            source += include_str!("wgsl/diffuse.wgsl");
        }
        Entry::SeenTextures => {
            source += &library(SLOTS);
            source += include_str!("wgsl/seen_textures.wgsl");
        }
        Entry::Reflections => {
            source += &library(SLOTS);
            source += include_str!("wgsl/reflections.wgsl");
        }
        Entry::Products => {
            source += &library(SLOTS);
            source += include_str!("wgsl/products.wgsl");
        }
        Entry::Integrals => {
            source += &library(SLOTS);
            source += PIXEL_VISIBILITY;
            source += include_str!("wgsl/integrals.wgsl");
        }
        Entry::Around => {
            source += &library(SLOTS);
            source += include_str!("wgsl/image.wgsl");
            source += include_str!("wgsl/around.wgsl");
        }
        Entry::Images => {
            source += &library(SLOTS);
            source += include_str!("wgsl/image.wgsl");
            source += include_str!("wgsl/images.wgsl");
        }
        Entry::Shade => {
            source += &library(SLOTS);
            source += include_str!("wgsl/shade.wgsl");
        }
        #[cfg(feature = "paper")]
        Entry::ShadeCells => {
            source += &library(LOBES);
            source += include_str!("wgsl/image.wgsl");
            source += &crate::cells::wgsl_constants();
            source += include_str!("wgsl/cells.wgsl");
            source += include_str!("wgsl/shade_cells.wgsl");
        }
        Entry::Sources => {
            source += &library(SLOTS);
            source += include_str!("wgsl/source_points.wgsl");
            source += include_str!("wgsl/parents.wgsl");
            source += include_str!("wgsl/occluders.wgsl");
            source += include_str!("wgsl/shadow_map.wgsl");
            source += include_str!("wgsl/sources.wgsl");
        }
        Entry::SourcesShown => {
            source += &library(SLOTS);
            source += include_str!("wgsl/source_points.wgsl");
            source += include_str!("wgsl/sources_shown.wgsl");
        }
        Entry::Motion => {
            source += include_str!("wgsl/bindings.wgsl");
            source += include_str!("wgsl/camera.wgsl");
            source += include_str!("wgsl/seen.wgsl");
            source += include_str!("wgsl/tile.wgsl");
            source += include_str!("wgsl/motion.wgsl");
        }
        Entry::FillTexture => {
            source += include_str!("wgsl/tonemap.wgsl");
            source += include_str!("wgsl/fill_texture.wgsl");
        }
        Entry::Composite => {
            source.extend(COMPOSITE.iter().copied());
            source += include_str!("wgsl/composite_pixels.wgsl");
        }
        Entry::CompositeSurfaces => {
            source.extend(COMPOSITE.iter().copied());
            source += include_str!("wgsl/composite_surfaces.wgsl");
        }
        Entry::Library => source += &library(LOBES),
    }
    source
}

/// Constants that WGSL and Rust share, written by Rust.
fn constants() -> String {
    let integers = [
        (
            "SURFACE_METALLIC_ROUGHNESS",
            gpu::SURFACE_METALLIC_ROUGHNESS,
        ),
        ("SURFACE_DIFFUSE_SPECULAR", gpu::SURFACE_DIFFUSE_SPECULAR),
        ("SURFACE_LAYERS", gpu::SURFACE_LAYERS),
        ("MODEL_NONE", Model::None as u32),
        ("JOIN_ADD", Join::Add as u32),
        ("JOIN_OVER", Join::Over as u32),
        ("JOIN_COAT", Join::Coat as u32),
        ("BACKGROUND_NONE", gpu::BACKGROUND_NONE),
        ("BACKGROUND_IMAGE", gpu::BACKGROUND_IMAGE),
        ("MAX_TILES", relight_format::MAX_TILES_PER_CLUSTER),
    ];
    let mut text = String::new();
    for (name, value) in integers {
        writeln!(text, "const {name}: u32 = {value}u;").expect("a String accepts every write");
    }
    for (entry, model) in relight_format::REFLECTION_MODELS.iter().zip(Model::ALL) {
        let name = entry.key.replace('-', "_").to_ascii_uppercase();
        let value = model as u32;
        writeln!(text, "const MODEL_{name}: u32 = {value}u;")
            .expect("a String accepts every write");
    }
    let fresnel = (Model::ALL.into_iter())
        .filter(|model| model.entry().is_some_and(|entry| entry.fresnel))
        .map(|model| format!("model == {}u", model as u32));
    let fresnel = fresnel.collect::<Vec<_>>().join(" || ");
    writeln!(
        text,
        "fn surface_has_fresnel(model: u32) -> bool {{ return {fresnel}; }}"
    )
    .expect("a String accepts every write");
    text += &gpu::wgsl_constants();
    text += &spherical_gaussian::wgsl_constants();
    text += &tables::wgsl_constants();
    text += &prefiltered::wgsl_constants();
    text += &local_light::wgsl_constants();
    text += &motion::wgsl_constants();
    text += &pixel_visibility::wgsl_constants();
    text += &polar::wgsl_constants();
    text += &surface::wgsl_constants();
    text += &textures::wgsl_constants();
    text += &brdf::wgsl_constants();
    text += &glossy::wgsl_constants();
    text += &shade::wgsl_constants();
    text += &slots::wgsl_constants();
    text += &occluders::wgsl_constants();
    text += &sources::wgsl_constants();
    text += &tonemap::wgsl_constants();
    text += &catcher::wgsl_constants();
    text += &surfaces::wgsl_constants();
    text += &transfer::wgsl_constants();
    text += &vertex_visibility::wgsl_constants();
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_entry_is_valid_wgsl() {
        for &entry in Entry::ALL {
            let source = source(entry);
            let module = naga::front::wgsl::parse_str(&source)
                .unwrap_or_else(|error| panic!("{entry:?}: {}", error.emit_to_string(&source)));
            naga::valid::Validator::new(
                naga::valid::ValidationFlags::all(),
                // `sample_index`, which WebGPU always has.
                naga::valid::Capabilities::MULTISAMPLED_SHADING,
            )
            .validate(&module)
            .unwrap_or_else(|error| panic!("{entry:?}: {}", error.emit_to_string(&source)));
        }
    }
}
