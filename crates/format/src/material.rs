//! Surface appearance and cameras, as stored in the metadata section.

mod specular;

use serde::{Deserialize, Serialize};

use crate::container::SectionKind;
use crate::{Error, Issue};

pub use specular::{ModelParameters, REFLECTION_MODELS, ReflectionModel, Roughness, Specular};

/// How a texture's bytes encode numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub enum TextureEncoding {
    /// RGB is sRGB-encoded colour, alpha is linear.
    Srgb,
    /// All four channels are linear.
    Linear,
    /// RGB is linear and multiplied by 2^(A − 136): numbers of any magnitude (Ward 1991, "Real
    /// pixels").
    Rgbe,
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

/// Width, height and encoding of a texture.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TextureShape {
    /// Texels per row, at least 1.
    pub width: u32,
    /// Rows, at least 1.
    pub height: u32,
    /// Meaning of the bytes.
    pub encoding: TextureEncoding,
}

impl Texture {
    /// Width, height and encoding.
    pub fn shape(&self) -> TextureShape {
        TextureShape {
            width: self.width,
            height: self.height,
            encoding: self.encoding,
        }
    }
}

/// A reference from a material to a texture.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TextureSlot {
    /// Index into [`crate::Scene::textures`].
    pub texture: u32,
    /// Rows of the affine map from the vertex's (u, v, 1) to texture coordinates
    /// (`KHR_texture_transform`); the identity is `[[1, 0, 0], [0, 1, 0]]`.
    pub transform: [[f32; 3]; 2],
    /// Whether those are the vertices' second ones, [`crate::Scene::second_uvs`]. Tangents always
    /// follow the first.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub second_uv: bool,
}

impl TextureSlot {
    /// A texture by the vertices' own coordinates.
    pub fn whole(texture: u32) -> Self {
        Self {
            texture,
            transform: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]],
            second_uv: false,
        }
    }
}

/// Values of [`Specular::Lobes`]' `ratio` along the sine of the half vector's angle with the
/// normal (at its squares), the cosine between light and half vector, and the squared cosine of the
/// azimuth between the normal and the light about the half vector (Rusinkiewicz 1998); each from 0
/// to 1.
pub const RATIO_NODES: [u32; 3] = [64, 24, 8];
/// Width and height of a texture of them: the first runs along rows, the last changes last.
pub const RATIO_SIZE: [u32; 2] = [RATIO_NODES[0], RATIO_NODES[1] * RATIO_NODES[2]];
/// Such a texture.
pub const RATIO_SHAPE: TextureShape = TextureShape {
    width: RATIO_SIZE[0],
    height: RATIO_SIZE[1],
    encoding: TextureEncoding::Rgbe,
};

/// Most lobes of [`Specular::Lobes`].
pub const MAX_FITTED_LOBES: usize = 7;
/// Most layers of [`Surface::Layers`].
pub const MAX_LAYERS: usize = 4;
/// Most specular reflections of one surface: one per layer, or its lobes where those are
/// more.
pub const MAX_REFLECTIONS: usize = 8;

/// One lobe of a fitted BRDF: Cook-Torrance with a Beckmann distribution, nearly a
/// spherical Gaussian of the half vector, whose colour goes from `f0` to `f90` as
/// Schlick's Fresnel goes from normal to grazing incidence.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FittedLobe {
    /// Linear Rec.709 colour at normal incidence, at least 0.
    pub f0: [f32; 3],
    /// Linear Rec.709 colour at grazing incidence, at least 0.
    pub f90: [f32; 3],
    /// Beckmann roughness m in (0, 1].
    pub roughness: f32,
}

/// How a layer covers what lies below it, with w its weight times its texture.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub enum Blend {
    /// A stain: w of this layer and 1 − w of what is below.
    Over,
    /// A transparent coat: w of this layer, and what is below dimmed by what the coat
    /// reflects towards the eye, 1 − w F(n·o) with Schlick's F between the layer's colours
    /// (as `KHR_materials_clearcoat`), but not below 0. Its layer has one reflection.
    Coat,
}

/// One layer of a surface.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Layer {
    /// Linear Rec.709 diffuse albedo.
    pub diffuse: [f32; 3],
    /// The specular model.
    pub specular: Specular,
    /// Coverage in [0, 1]. What lies below the lowest layer is black.
    pub weight: f32,
    /// How it covers the layers before it.
    pub blend: Blend,
    /// Multiplies `diffuse`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub diffuse_texture: Option<TextureSlot>,
    /// Multiplies the specular colour; at normal incidence, for models with Fresnel.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub specular_texture: Option<TextureSlot>,
    /// R multiplies the roughness along the tangent, G that along the bitangent. The
    /// exponents of Blinn-Phong (R) and Ashikhmin-Shirley are divided by their squares.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub roughness_texture: Option<TextureSlot>,
    /// R multiplies `weight`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub weight_texture: Option<TextureSlot>,
}

/// The parameters of a surface, before textures.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
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
    /// A Lambertian base plus one specular model, added; `Layered` in files.
    #[serde(rename = "Layered")]
    DiffuseSpecular {
        /// Linear Rec.709 diffuse albedo.
        diffuse: [f32; 3],
        /// The specular model.
        specular: Specular,
    },
    /// Layers from the bottom up, each a Lambertian base plus a specular model, spatially
    /// varying by texture. They share the material's normals and the direction of its
    /// anisotropy.
    Layers {
        /// 1 to [`MAX_LAYERS`] of them, with at most [`MAX_REFLECTIONS`] reflections in all.
        layers: Vec<Layer>,
    },
}

/// One material. Surfaces are one-sided: black from behind. A double-sided surface is two
/// one-sided ones, because each side has its own visibility.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Material {
    /// Name, for messages and editing; need not be unique.
    pub name: String,
    /// Parameters before textures.
    pub surface: Surface,
    /// Multiplies `base_color` (or `diffuse`); not of layers, which have their own.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub base_color_texture: Option<TextureSlot>,
    /// G multiplies `roughness`, B multiplies `metallic`; metallic-roughness surfaces only.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub metallic_roughness_texture: Option<TextureSlot>,
    /// Tangent-space normal map, +Y up.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub normal_texture: Option<TextureSlot>,
    /// Scale of the normal map's x and y.
    pub normal_scale: f32,
    /// `KHR_materials_anisotropy`: RG is the direction in [-1, 1], B the strength. Of layers
    /// RG alone: it turns the tangent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub anisotropy_texture: Option<TextureSlot>,
    /// Linear Rec.709 radiance that the surface emits, the same in all directions.
    pub emission: [f32; 3],
    /// Multiplies `emission`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub emission_texture: Option<TextureSlot>,
    /// Pictures have of this surface only what its surroundings take from and add to its light, to be
    /// laid over photographs: see `relight_shading::catcher`.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub shadow_catcher: bool,
}

impl Surface {
    fn is_valid(&self) -> bool {
        match self {
            Self::MetallicRoughness {
                base_color,
                metallic,
                roughness,
                anisotropy_strength,
                anisotropy_rotation,
            } => {
                is_color(base_color)
                    && [metallic, roughness, anisotropy_strength]
                        .into_iter()
                        .all(|value| (0.0..=1.0).contains(value))
                    && anisotropy_rotation.is_finite()
            }
            Self::DiffuseSpecular { diffuse, specular } => is_color(diffuse) && specular.is_valid(),
            Self::Layers { layers } => {
                let reflections: usize = layers
                    .iter()
                    .map(|layer| layer.specular.reflections())
                    .sum();
                (1..=MAX_LAYERS).contains(&layers.len())
                    && reflections <= MAX_REFLECTIONS
                    && layers.iter().all(|layer| {
                        is_color(&layer.diffuse)
                            && layer.specular.is_valid()
                            && (0.0..=1.0).contains(&layer.weight)
                            && (layer.blend == Blend::Over || layer.specular.reflections() == 1)
                    })
            }
        }
    }
}

/// A material without textures.
pub fn plain_material(name: &str, surface: Surface) -> Material {
    Material {
        name: name.to_owned(),
        surface,
        base_color_texture: None,
        metallic_roughness_texture: None,
        normal_texture: None,
        normal_scale: 1.0,
        anisotropy_texture: None,
        emission: [0.0; 3],
        emission_texture: None,
        shadow_catcher: false,
    }
}

impl Material {
    /// Whether a texture is looked up by second texture coordinates.
    pub fn uses_second_uv(&self) -> bool {
        self.slots().any(|slot| slot.second_uv)
    }

    /// The slots in use, the layers' among them.
    pub fn slots(&self) -> impl Iterator<Item = &TextureSlot> {
        (self.slot_options().into_iter().flatten()).chain(self.ratios())
    }

    /// The same, to renumber textures by.
    pub fn slots_mut(&mut self) -> impl Iterator<Item = &mut TextureSlot> {
        let (layers, single): (&mut [Layer], _) = match &mut self.surface {
            Surface::Layers { layers } => (layers, None),
            Surface::DiffuseSpecular { specular, .. } => (&mut [], Some(specular)),
            Surface::MetallicRoughness { .. } => (&mut [], None),
        };
        [
            &mut self.base_color_texture,
            &mut self.metallic_roughness_texture,
            &mut self.normal_texture,
            &mut self.anisotropy_texture,
            &mut self.emission_texture,
        ]
        .into_iter()
        .map(Option::as_mut)
        .chain(layers.iter_mut().flat_map(|layer| {
            [
                layer.diffuse_texture.as_mut(),
                layer.specular_texture.as_mut(),
                layer.roughness_texture.as_mut(),
                layer.weight_texture.as_mut(),
                layer.specular.ratio_mut(),
            ]
        }))
        .chain([single.and_then(Specular::ratio_mut)])
        .flatten()
    }

    /// Slots of [`Specular::Lobes`]' ratios.
    fn ratios(&self) -> impl Iterator<Item = &TextureSlot> {
        let (layers, single): (&[Layer], _) = match &self.surface {
            Surface::Layers { layers } => (layers, None),
            Surface::DiffuseSpecular { specular, .. } => (&[], Some(specular)),
            Surface::MetallicRoughness { .. } => (&[], None),
        };
        let speculars = layers.iter().map(|layer| &layer.specular).chain(single);
        speculars.filter_map(|specular| match specular {
            Specular::Lobes { ratio, .. } => ratio.as_ref(),
            _ => None,
        })
    }

    fn slot_options(&self) -> Vec<&Option<TextureSlot>> {
        let mut slots = vec![
            &self.base_color_texture,
            &self.metallic_roughness_texture,
            &self.normal_texture,
            &self.anisotropy_texture,
            &self.emission_texture,
        ];
        if let Surface::Layers { layers } = &self.surface {
            for layer in layers {
                slots.extend([
                    &layer.diffuse_texture,
                    &layer.specular_texture,
                    &layer.roughness_texture,
                    &layer.weight_texture,
                ]);
            }
        }
        slots
    }

    /// Checks every number, and every slot against the textures of the asset and whether its vertices
    /// have second texture coordinates.
    pub fn validate(&self, textures: &[TextureShape], second_uvs: bool) -> Result<(), Error> {
        let metadata = |issue, expected: &str, found: std::fmt::Arguments| {
            Err(Error::section(
                issue,
                SectionKind::Metadata,
                expected,
                found,
            ))
        };
        for slot in self.slots() {
            if slot.texture as usize >= textures.len() {
                return metadata(
                    Issue::IndexOutOfRange,
                    "an existing texture",
                    format_args!("{slot:?} of material {:?}", self.name),
                );
            }
            if slot.second_uv && !second_uvs {
                return metadata(
                    Issue::ValueOutOfRange,
                    "textures by the first texture coordinates, as vertices have no second ones",
                    format_args!("{slot:?} of material {:?}", self.name),
                );
            }
            if !slot.transform.iter().flatten().all(|x| x.is_finite()) {
                return metadata(
                    Issue::ValueOutOfRange,
                    "a finite texture transform",
                    format_args!("{slot:?} of material {:?}", self.name),
                );
            }
        }
        for slot in self.ratios() {
            let found = textures[slot.texture as usize];
            if found != RATIO_SHAPE {
                return metadata(
                    Issue::ValueOutOfRange,
                    &format!("{RATIO_SHAPE:?} for lobes' ratio"),
                    format_args!("{found:?} of material {:?}", self.name),
                );
            }
        }
        let numbers = is_color(&self.emission) && self.normal_scale.is_finite();
        if !self.surface.is_valid() || !numbers {
            return metadata(
                Issue::ValueOutOfRange,
                "finite material parameters in their documented ranges",
                format_args!("{self:?}"),
            );
        }
        Ok(())
    }
}

fn is_color(color: &[f32; 3]) -> bool {
    color.iter().all(|x| x.is_finite() && *x >= 0.0)
}

/// Which image axis a field of view spans.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub enum FieldOfView {
    /// Full horizontal angle, radians.
    X(f32),
    /// Full vertical angle, radians.
    Y(f32),
}

/// A pinhole camera.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
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
