//! Shader sources: the files of `wgsl/` joined, with constants taken from the Rust side.

use std::fmt::Write as _;

use crate::surface::{Join, Model};
use crate::{
    brdf, cells, glossy, gpu, local_light, occluders, polar, prefiltered, shade, sources,
    spherical_gaussian, surface, surfaces, tables, tonemap, transfer, vertex_visibility,
};

/// What a shader module is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Entry {
    /// Triangle under each pixel: `visibility_buffer_vertex`, `visibility_buffer_fragment`.
    VisibilityBuffer,
    /// The same, four samples per pixel: `surface_samples_vertex`, `surface_samples_fragment`.
    SurfaceSamples,
    /// Samples of visibility to the surfaces of every pixel: `surfaces_main`, workgroups of a tile.
    Surfaces,
    /// Visible fractions of lights at vertices: `vertices_mark`, workgroups of 8 × 8 pixels, and
    /// `vertices_main`, workgroups of 64 vertices and four lights.
    Vertices,
    /// Visibility buffer to irradiance: `diffuse_main`, workgroups of 8 × 8 pixels.
    Diffuse,
    /// Visibility buffer and irradiance to linear radiance: `shade_main`, workgroups of 8 × 8 pixels.
    Shade,
    /// The same by cells, without irradiance; a module of its own, so that its registers cost the others nothing.
    ShadeCells,
    /// Visibility buffer to what sources add to the radiance: `sources_main`, workgroups of 8 × 8
    /// pixels.
    Sources,
    /// Linear radiance into a target: `composite_vertex`; `composite_fragment` or, where the target
    /// has depth, `composite_depth_fragment`. What is behind it: `background_vertex`,
    /// `background_fragment`.
    Composite,
    /// The same for pixels of several surfaces: `composite_vertex`; `composite_fragment` and
    /// `composite_depth_fragment` for targets of one sample, `composite_sample_fragment` and
    /// `composite_sample_depth_fragment` for those of four.
    CompositeSurfaces,
    /// Functions and bindings without an entry point, to append kernels to.
    Library,
}

impl Entry {
    /// All of them.
    pub const ALL: [Self; 11] = [
        Self::VisibilityBuffer,
        Self::SurfaceSamples,
        Self::Surfaces,
        Self::Vertices,
        Self::Diffuse,
        Self::Shade,
        Self::ShadeCells,
        Self::Sources,
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
    DIFFUSE,
    SHADE[0],
    SHADE[1],
    SHADE[2],
    SHADE[3],
    SHADE_CELLS,
    SOURCES,
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

/// Irradiance of every pixel.
pub const DIFFUSE: Kernel = Kernel {
    name: "diffuse",
    entry: Entry::Diffuse,
    entry_point: "diffuse_main",
    constants: &[],
};

/// Radiance of every pixel, by lobes: with bounced light at 1 and 3, with a prefiltered image at 2
/// and 3.
pub const SHADE: [Kernel; 4] = [
    shade_kernel(
        "shade",
        &[("SHADE_PREFILTERED", 0.0), ("SHADE_BOUNCED", 0.0)],
    ),
    shade_kernel(
        "shade, bounced light",
        &[("SHADE_PREFILTERED", 0.0), ("SHADE_BOUNCED", 1.0)],
    ),
    shade_kernel(
        "shade, prefiltered",
        &[("SHADE_PREFILTERED", 1.0), ("SHADE_BOUNCED", 0.0)],
    ),
    shade_kernel(
        "shade, both",
        &[("SHADE_PREFILTERED", 1.0), ("SHADE_BOUNCED", 1.0)],
    ),
];

const fn shade_kernel(name: &'static str, constants: &'static [(&'static str, f64)]) -> Kernel {
    Kernel {
        name,
        entry: Entry::Shade,
        entry_point: "shade_main",
        constants,
    }
}

/// Radiance of every pixel, by cells.
pub const SHADE_CELLS: Kernel = Kernel {
    name: "shade by cells",
    entry: Entry::ShadeCells,
    entry_point: "shade_main",
    constants: &[],
};

/// What sources add to every pixel.
pub const SOURCES: Kernel = Kernel {
    name: "sources",
    entry: Entry::Sources,
    entry_point: "sources_main",
    constants: &[],
};

/// [`Entry::Surfaces`]; before shading, with antialiasing.
pub const SURFACES: Kernel = Kernel {
    name: "surfaces",
    entry: Entry::Surfaces,
    entry_point: "surfaces_main",
    constants: &[],
};

/// Joined in this order; the order does not matter to WGSL.
const LIBRARY: &[&str] = &[
    include_str!("wgsl/bindings.wgsl"),
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
    include_str!("wgsl/surface.wgsl"),
    include_str!("wgsl/brdf.wgsl"),
    include_str!("wgsl/reference.wgsl"),
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
    include_str!("wgsl/composite.wgsl"),
];

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
            source.extend(LIBRARY.iter().copied());
            source += include_str!("wgsl/vertices.wgsl");
        }
        Entry::Diffuse => {
            source.extend(LIBRARY.iter().copied());
            source += include_str!("wgsl/visible.wgsl");
            source += include_str!("wgsl/diffuse.wgsl");
        }
        Entry::Shade => {
            source.extend(LIBRARY.iter().copied());
            source += include_str!("wgsl/visible.wgsl");
            source += include_str!("wgsl/shade.wgsl");
            source += include_str!("wgsl/shade_lobes.wgsl");
        }
        Entry::ShadeCells => {
            source.extend(LIBRARY.iter().copied());
            source += include_str!("wgsl/shade.wgsl");
            source += include_str!("wgsl/cells.wgsl");
            source += include_str!("wgsl/shade_cells.wgsl");
        }
        Entry::Sources => {
            source.extend(LIBRARY.iter().copied());
            source += include_str!("wgsl/occluders.wgsl");
            source += include_str!("wgsl/sources.wgsl");
        }
        Entry::Composite => {
            source.extend(COMPOSITE.iter().copied());
            source += include_str!("wgsl/composite_pixels.wgsl");
        }
        Entry::CompositeSurfaces => {
            source.extend(COMPOSITE.iter().copied());
            source += include_str!("wgsl/composite_surfaces.wgsl");
        }
        Entry::Library => source.extend(LIBRARY.iter().copied()),
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
        ("SURFACE_LAYERED", gpu::SURFACE_LAYERED),
        ("SURFACE_LAYERS", gpu::SURFACE_LAYERS),
        ("MODEL_NONE", Model::None as u32),
        ("MODEL_BLINN_PHONG", Model::BlinnPhong as u32),
        ("MODEL_WARD", Model::Ward as u32),
        ("MODEL_COOK_TORRANCE", Model::CookTorrance as u32),
        ("MODEL_GGX", Model::Ggx as u32),
        ("MODEL_ASHIKHMIN_SHIRLEY", Model::AshikhminShirley as u32),
        ("JOIN_ADD", Join::Add as u32),
        ("JOIN_OVER", Join::Over as u32),
        ("JOIN_COAT", Join::Coat as u32),
        ("METHOD_AMBIENT", gpu::METHOD_AMBIENT),
        ("BACKGROUND_NONE", gpu::BACKGROUND_NONE),
        ("BACKGROUND_IMAGE", gpu::BACKGROUND_IMAGE),
        ("MAX_LOCAL_LIGHTS", gpu::MAX_LOCAL_LIGHTS),
        ("MAX_TILES", relight_format::MAX_TILES_PER_CLUSTER),
    ];
    let mut text = String::new();
    for (name, value) in integers {
        writeln!(text, "const {name}: u32 = {value}u;").expect("a String accepts every write");
    }
    text += &spherical_gaussian::wgsl_constants();
    text += &tables::wgsl_constants();
    text += &prefiltered::wgsl_constants();
    text += &local_light::wgsl_constants();
    text += &polar::wgsl_constants();
    text += &cells::wgsl_constants();
    text += &surface::wgsl_constants();
    text += &brdf::wgsl_constants();
    text += &glossy::wgsl_constants();
    text += &shade::wgsl_constants();
    text += &occluders::wgsl_constants();
    text += &sources::wgsl_constants();
    text += &tonemap::wgsl_constants();
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
        for entry in Entry::ALL {
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
