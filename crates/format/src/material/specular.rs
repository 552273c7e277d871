//! How surfaces reflect beside their Lambertian base: the models, with the names and ranges of their parameters.

use serde::{Deserialize, Serialize};

use super::{FittedLobe, MAX_FITTED_LOBES, TextureSlot, is_color};

/// A specular reflection model. Every roughness is the model's own parameter, not its
/// perceptual square root.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
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
    /// Ashikhmin & Shirley 2000, the specular term alone, with Schlick's Fresnel.
    AshikhminShirley {
        /// Linear Rec.709 reflectance at normal incidence.
        f0: [f32; 3],
        /// Phong-like exponents along tangent and bitangent, at least 2: an exponent n is
        /// a roughness of √(2/n).
        exponents: [f32; 2],
    },
    /// A measured BRDF as the lobes that were fitted to it.
    Lobes {
        /// The table's file, as named by the scene file.
        path: String,
        /// 1 to [`MAX_FITTED_LOBES`] lobes, added.
        lobes: Vec<FittedLobe>,
        /// What the sum of the lobes is multiplied by to be the table less the diffuse base, by the
        /// directions of light and view: [`crate::TextureEncoding::Rgbe`], [`crate::RATIO_SIZE`] texels. Its
        /// transform is not used.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        ratio: Option<TextureSlot>,
    },
}

impl Specular {
    /// How many reflections it is made of.
    pub fn reflections(&self) -> usize {
        match self {
            Self::Lobes { lobes, .. } => lobes.len(),
            _ => 1,
        }
    }

    pub(super) fn ratio_mut(&mut self) -> Option<&mut TextureSlot> {
        match self {
            Self::Lobes { ratio, .. } => ratio.as_mut(),
            _ => None,
        }
    }

    /// The model and its parameters; `None` for no reflection and for fitted lobes.
    pub fn model(&self) -> Option<(&'static ReflectionModel, ModelParameters)> {
        REFLECTION_MODELS
            .iter()
            .find_map(|model| Some((model, (model.parameters)(self)?)))
    }

    pub(super) fn is_valid(&self) -> bool {
        match (self, self.model()) {
            (_, Some((model, parameters))) => {
                let valid = |value: &f32| model.roughness.contains(*value);
                is_color(&parameters.color) && parameters.roughness.iter().all(valid)
            }
            (Self::Lobes { lobes, .. }, _) => {
                let valid = |lobe: &FittedLobe| {
                    is_color(&lobe.f0)
                        && is_color(&lobe.f90)
                        && Roughness::Alpha.contains(lobe.roughness)
                };
                (1..=MAX_FITTED_LOBES).contains(&lobes.len()) && lobes.iter().all(valid)
            }
            _ => true,
        }
    }
}

/// What one reflection of a model is made of.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ModelParameters {
    /// Linear Rec.709.
    pub color: [f32; 3],
    /// As the model has it: along tangent and bitangent, or twice the same.
    pub roughness: [f32; 2],
}

/// The number that says how rough a model's reflection is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Roughness {
    /// In (0, 1].
    Alpha,
    /// Of a power of a cosine, at least this: the less, the rougher.
    Exponent {
        /// The least.
        least: f32,
    },
}

impl Roughness {
    /// Whether a number is one of its range.
    pub fn contains(self, value: f32) -> bool {
        match self {
            Self::Alpha => value > 0.0 && value <= 1.0,
            Self::Exponent { least } => value >= least && value.is_finite(),
        }
    }

    /// A number in terms of α: √(2/n) of an exponent n, which counts as at least 2.
    pub fn to_alpha(self, value: f32) -> f32 {
        match self {
            Self::Alpha => value,
            Self::Exponent { .. } => (2.0 / value.max(2.0)).sqrt(),
        }
    }

    /// The number that α, in (0, 1], stands for.
    pub fn from_alpha(self, alpha: f32) -> f32 {
        match self {
            Self::Alpha => alpha,
            Self::Exponent { .. } => (2.0 / (alpha * alpha)).max(2.0),
        }
    }
}

/// What numbers are in its range, as messages say it.
impl std::fmt::Display for Roughness {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Alpha => formatter.write_str("a roughness in (0, 1]"),
            Self::Exponent { least } => write!(formatter, "a number of at least {least}"),
        }
    }
}

/// A reflection model as the format has it. What it reflects is in `relight-shading`.
#[derive(Clone, Copy, Debug)]
pub struct ReflectionModel {
    /// For people.
    pub name: &'static str,
    /// In scene files.
    pub key: &'static str,
    /// Whether its colour goes to white at grazing angles (Schlick 1994).
    pub fresnel: bool,
    /// How it says how rough it is.
    pub roughness: Roughness,
    /// What that is called in scene files.
    pub roughness_name: &'static str,
    /// Whether that may differ along tangent and bitangent.
    pub anisotropic: bool,
    make: fn(ModelParameters) -> Specular,
    parameters: fn(&Specular) -> Option<ModelParameters>,
}

impl ReflectionModel {
    /// What its colour is called in scene files.
    pub fn color(&self) -> &'static str {
        if self.fresnel { "f0" } else { "specular" }
    }

    /// The reflection that parameters make. An isotropic model takes the first roughness.
    pub fn reflection(&self, parameters: ModelParameters) -> Specular {
        (self.make)(parameters)
    }
}

/// All of them, one entry for each variant of [`Specular`] that is one reflection.
pub const REFLECTION_MODELS: &[ReflectionModel] = &[
    ReflectionModel {
        name: "Blinn-Phong",
        key: "blinn-phong",
        fresnel: false,
        roughness: Roughness::Exponent { least: 1.0 },
        roughness_name: "exponent",
        anisotropic: false,
        make: |ModelParameters { color, roughness }| Specular::BlinnPhong {
            specular: color,
            exponent: roughness[0],
        },
        parameters: |specular| match *specular {
            Specular::BlinnPhong {
                specular: color,
                exponent: roughness,
            } => Some(ModelParameters {
                color,
                roughness: [roughness; 2],
            }),
            _ => None,
        },
    },
    ReflectionModel {
        name: "Ward",
        key: "ward",
        fresnel: false,
        roughness: Roughness::Alpha,
        roughness_name: "alpha",
        anisotropic: true,
        make: |ModelParameters { color, roughness }| Specular::Ward {
            specular: color,
            alpha: roughness,
        },
        parameters: |specular| match *specular {
            Specular::Ward {
                specular: color,
                alpha: roughness,
            } => Some(ModelParameters { color, roughness }),
            _ => None,
        },
    },
    ReflectionModel {
        name: "Cook-Torrance",
        key: "cook-torrance",
        fresnel: true,
        roughness: Roughness::Alpha,
        roughness_name: "roughness",
        anisotropic: false,
        make: |ModelParameters { color, roughness }| Specular::CookTorrance {
            f0: color,
            roughness: roughness[0],
        },
        parameters: |specular| match *specular {
            Specular::CookTorrance {
                f0: color,
                roughness,
            } => Some(ModelParameters {
                color,
                roughness: [roughness; 2],
            }),
            _ => None,
        },
    },
    ReflectionModel {
        name: "GGX",
        key: "ggx",
        fresnel: true,
        roughness: Roughness::Alpha,
        roughness_name: "alpha",
        anisotropic: true,
        make: |ModelParameters { color, roughness }| Specular::Ggx {
            f0: color,
            alpha: roughness,
        },
        parameters: |specular| match *specular {
            Specular::Ggx {
                f0: color,
                alpha: roughness,
            } => Some(ModelParameters { color, roughness }),
            _ => None,
        },
    },
    ReflectionModel {
        name: "Ashikhmin-Shirley",
        key: "ashikhmin-shirley",
        fresnel: true,
        roughness: Roughness::Exponent { least: 2.0 },
        roughness_name: "exponent",
        anisotropic: true,
        make: |ModelParameters { color, roughness }| Specular::AshikhminShirley {
            f0: color,
            exponents: roughness,
        },
        parameters: |specular| match *specular {
            Specular::AshikhminShirley {
                f0: color,
                exponents: roughness,
            } => Some(ModelParameters { color, roughness }),
            _ => None,
        },
    },
];
