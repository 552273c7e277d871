//! How a point reflects: the models, one reflection of one, and the sum of several over a base.

use glam::{Vec2, Vec3};
use relight_format::{MAX_REFLECTIONS, REFLECTION_MODELS, ReflectionModel, Texture};

use super::{MAX_EXPONENT, MIN_ALPHA};

/// Specular reflection model. The values are those of `Material::model` on the GPU.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum Model {
    /// Diffuse only.
    None = 0,
    /// Normalised Blinn-Phong.
    BlinnPhong = 1,
    /// Ward with the Duer normalisation.
    Ward = 2,
    /// Beckmann distribution, Smith masking, Schlick's Fresnel.
    CookTorrance = 3,
    /// GGX distribution, Smith masking, Schlick's Fresnel.
    Ggx = 4,
    /// Ashikhmin-Shirley's specular term, Schlick's Fresnel.
    AshikhminShirley = 5,
}

impl Model {
    /// All that reflect.
    pub const ALL: [Self; 5] = [
        Self::BlinnPhong,
        Self::Ward,
        Self::CookTorrance,
        Self::Ggx,
        Self::AshikhminShirley,
    ];

    /// Its entry in the format; `None` reflects nothing and has none.
    pub fn entry(self) -> Option<&'static ReflectionModel> {
        let index = Self::ALL.iter().position(|model| *model == self)?;
        REFLECTION_MODELS.get(index)
    }

    /// Of an entry of the format.
    pub(super) fn of(entry: &ReflectionModel) -> Self {
        let same = |model: &&Self| model.entry().is_some_and(|other| other.key == entry.key);
        Self::ALL.iter().find(same).copied().unwrap_or(Self::None)
    }

    /// Whether a [`Reflection`] of it holds an exponent in place of a roughness.
    pub fn has_exponent(self) -> bool {
        self == Self::BlinnPhong
    }

    /// What a [`Reflection`] of it holds for a roughness.
    pub fn from_alpha(self, alpha: f32) -> f32 {
        if self.has_exponent() {
            2.0 / (alpha * alpha)
        } else {
            alpha
        }
    }
}

/// One specular reflection, textures applied and parameters clamped to what is shaded.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reflection<'a> {
    /// The model.
    pub model: Model,
    /// Models with Fresnel: colour at normal incidence. Blinn-Phong and Ward: specular
    /// albedo. Linear Rec.709.
    pub specular: Vec3,
    /// Models with Fresnel: colour at grazing incidence, white unless fitted or part of a
    /// mixture.
    pub grazing: Vec3,
    /// Roughness along tangent and bitangent, [`MIN_ALPHA`] to 1; that of Ashikhmin-Shirley
    /// with exponents n is √(2/n). Blinn-Phong: the exponent, 1 to [`MAX_EXPONENT`], in both.
    pub alpha: Vec2,
    /// What the model's value is multiplied by, by directions: of lobes fitted to a measured table.
    pub ratio: Option<&'a Texture>,
}

/// GGX's roughnesses along tangent and bitangent of a metallic-roughness surface, from its perceptual roughness and the
/// strength of its anisotropy (`KHR_materials_anisotropy`).
pub fn metallic_roughness_alpha(roughness: f32, strength: f32) -> Vec2 {
    let alpha = roughness * roughness;
    Vec2::new(alpha + (1.0 - alpha) * strength * strength, alpha)
}

impl Reflection<'_> {
    /// None.
    pub const NONE: Self = Self {
        model: Model::None,
        specular: Vec3::ZERO,
        grazing: Vec3::ZERO,
        alpha: Vec2::ONE,
        ratio: None,
    };

    /// A reflection that goes to white at grazing incidence, if its model has Fresnel.
    pub fn new(model: Model, specular: Vec3, alpha: Vec2) -> Self {
        Self {
            model,
            specular,
            grazing: Vec3::ONE,
            alpha,
            ratio: None,
        }
    }

    /// Roughness along tangent and bitangent, of models with an exponent as well.
    pub(crate) fn roughness(&self) -> Vec2 {
        if self.model.has_exponent() {
            Vec2::splat((2.0 / self.alpha.x).sqrt())
        } else {
            self.alpha
        }
    }

    /// Colour of the reflection about a half vector at `cosine` = h·o.
    pub fn color(&self, cosine: f32) -> Vec3 {
        if self.has_fresnel() {
            self.specular + (self.grazing - self.specular) * schlick(cosine)
        } else {
            self.specular
        }
    }

    /// Whether the model's colour changes towards grazing incidence.
    pub(crate) fn has_fresnel(&self) -> bool {
        self.model.entry().is_some_and(|entry| entry.fresnel)
    }

    pub(super) fn scale(&mut self, by: Vec3) {
        self.specular *= by;
        self.grazing *= by;
    }

    /// The reflection with its roughness within what is shaded.
    pub(super) fn clamped(self) -> Self {
        let (low, high) = if self.model.has_exponent() {
            (1.0, MAX_EXPONENT)
        } else {
            (MIN_ALPHA, 1.0)
        };
        Self {
            alpha: self.alpha.clamp(Vec2::splat(low), Vec2::splat(high)),
            ..self
        }
    }
}

/// Reflectance at one point: a Lambertian base plus the sum of some specular reflections.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Appearance<'a> {
    /// Lambertian albedo, linear Rec.709.
    pub diffuse: Vec3,
    /// The reflections; those behind the last one in use are [`Reflection::NONE`].
    pub reflections: [Reflection<'a>; MAX_REFLECTIONS],
}

impl<'a> Appearance<'a> {
    /// A base and at most [`MAX_REFLECTIONS`] reflections.
    ///
    /// # Panics
    /// If there are more.
    pub fn new(diffuse: Vec3, reflections: &[Reflection<'a>]) -> Self {
        let mut all = [Reflection::NONE; MAX_REFLECTIONS];
        all[..reflections.len()].copy_from_slice(reflections);
        Self {
            diffuse,
            reflections: all,
        }
    }

    /// The reflections in use.
    pub fn reflections(&self) -> impl Iterator<Item = &Reflection<'a>> {
        self.reflections
            .iter()
            .filter(|reflection| reflection.model != Model::None)
    }
}

/// Schlick's (1 − cosθ)⁵.
pub(crate) fn schlick(cosine: f32) -> f32 {
    (1.0 - cosine).clamp(0.0, 1.0).powi(5)
}
