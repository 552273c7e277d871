//! Surface appearance and cameras, as stored in the metadata section.

use serde::{Deserialize, Serialize};

/// How a texture's bytes encode numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum TextureEncoding {
    /// RGB is sRGB-encoded colour, alpha is linear.
    Srgb,
    /// All four channels are linear.
    Linear,
}

/// An RGBA8 image, row 0 first, repeated in both directions.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Texture {
    /// Texels per row, at least 1.
    pub width: u32,
    /// Rows, at least 1.
    pub height: u32,
    /// Meaning of the bytes.
    pub encoding: TextureEncoding,
    /// `width * height * 4` bytes.
    pub texels: Vec<u8>,
}

/// A reference from a material to a texture.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct TextureSlot {
    /// Index into [`crate::Scene::textures`].
    pub texture: u32,
    /// Rows of the affine map from the vertex's (u, v, 1) to texture coordinates
    /// (`KHR_texture_transform`); the identity is `[[1, 0, 0], [0, 1, 0]]`.
    pub transform: [[f32; 3]; 2],
}

/// A specular reflection model. Every roughness is the model's own parameter, not its
/// perceptual square root.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Specular {
    /// No specular reflection.
    None,
    /// Normalised Blinn-Phong: `specular * (n + 8)/(8 pi) * (n·h)^n` (Blinn 1977).
    BlinnPhong {
        /// Linear Rec.709 specular albedo.
        specular: [f32; 3],
        /// Exponent n, at least 1.
        exponent: f32,
    },
    /// Ward's anisotropic model with the Duer normalisation (Ward 1992; Duer 2005).
    Ward {
        /// Linear Rec.709 specular albedo.
        specular: [f32; 3],
        /// Standard deviations of the slope along tangent and bitangent, in (0, 1].
        alpha: [f32; 2],
    },
    /// Cook-Torrance with Beckmann distribution, Smith masking and Schlick's Fresnel
    /// (Cook & Torrance 1982; Walter et al. 2007).
    CookTorrance {
        /// Linear Rec.709 reflectance at normal incidence.
        f0: [f32; 3],
        /// Beckmann roughness m in (0, 1].
        roughness: f32,
    },
    /// GGX with separable Smith masking and Schlick's Fresnel (Walter et al. 2007), as in
    /// Mitsuba 3 `roughconductor`.
    Ggx {
        /// Linear Rec.709 reflectance at normal incidence.
        f0: [f32; 3],
        /// GGX alpha along tangent and bitangent, in (0, 1].
        alpha: [f32; 2],
    },
    /// A measured BRDF. The surface's `diffuse` together with `f0` and `alpha` are the GGX
    /// stand-in fitted to the table, for renderers that do not hold it.
    Measured {
        /// File, as named by the scene file.
        path: String,
        /// Stand-in: linear Rec.709 reflectance at normal incidence.
        f0: [f32; 3],
        /// Stand-in: GGX alpha in (0, 1].
        alpha: f32,
    },
}

/// The parameters of a surface, before textures.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Surface {
    /// glTF 2.0 metallic-roughness: diffuse albedo `base_color * (1 - metallic)`, GGX with
    /// `f0 = mix(0.04, base_color, metallic)` and `alpha = roughness²`, stretched by
    /// `KHR_materials_anisotropy`: `alpha_t = mix(alpha, 1, strength²)`, `alpha_b = alpha`.
    MetallicRoughness {
        /// Linear Rec.709.
        base_color: [f32; 3],
        /// 0 dielectric, 1 metal.
        metallic: f32,
        /// Perceptual roughness in [0, 1].
        roughness: f32,
        /// `KHR_materials_anisotropy` strength in [0, 1]; 0 is isotropic.
        anisotropy_strength: f32,
        /// Direction of anisotropy, radians counter-clockwise from the tangent.
        anisotropy_rotation: f32,
    },
    /// A Lambertian base plus one specular model, added.
    Layered {
        /// Linear Rec.709 diffuse albedo.
        diffuse: [f32; 3],
        /// The specular model.
        specular: Specular,
    },
}

/// One material. Surfaces are one-sided: black from behind. A double-sided surface is two
/// one-sided ones, because each side has its own visibility.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Material {
    /// Name, for messages and editing; need not be unique.
    pub name: String,
    /// Parameters before textures.
    pub surface: Surface,
    /// Multiplies `base_color` (or `diffuse`).
    pub base_color_texture: Option<TextureSlot>,
    /// G multiplies `roughness`, B multiplies `metallic`; metallic-roughness surfaces only.
    pub metallic_roughness_texture: Option<TextureSlot>,
    /// Tangent-space normal map, +Y up.
    pub normal_texture: Option<TextureSlot>,
    /// Scale of the normal map's x and y.
    pub normal_scale: f32,
    /// `KHR_materials_anisotropy`: RG is the direction in [-1, 1], B the strength.
    pub anisotropy_texture: Option<TextureSlot>,
}

/// Which image axis a field of view spans.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum FieldOfView {
    /// Full horizontal angle, radians.
    X(f32),
    /// Full vertical angle, radians.
    Y(f32),
}

/// A pinhole camera.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Camera {
    /// Centre of projection, world space.
    pub position: [f32; 3],
    /// A point on the optical axis.
    pub target: [f32; 3],
    /// Approximate up direction.
    pub up: [f32; 3],
    /// Full angle of view.
    pub field_of_view: FieldOfView,
}
