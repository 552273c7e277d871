//! A material's layers, as the reflections that they add up to.

use glam::{Vec2, Vec3};
use relight_format::{
    Blend, FittedLobe, Layer, Material, ModelParameters, Specular, Surface, TextureSlot,
};

use super::{Model, Reflection};

/// How a reflection joins those before it. The values are those of `Layer::join` on the
/// GPU.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum Join {
    /// Added: a further lobe of the same layer.
    Add = 0,
    /// [`Blend::Over`].
    Over = 1,
    /// [`Blend::Coat`].
    Coat = 2,
}

/// One reflection of a material before textures, with the base that comes with it.
#[derive(Clone, Copy, Debug)]
pub struct LayerParameters<'a> {
    /// Lambertian albedo.
    pub diffuse: Vec3,
    /// The reflection, not clamped.
    pub reflection: Reflection<'a>,
    /// What the reflection's value is multiplied by, by directions.
    pub ratio: Option<&'a TextureSlot>,
    /// Coverage before its texture.
    pub weight: f32,
    /// How it joins those before it.
    pub join: Join,
    /// Multiplies `diffuse`.
    pub diffuse_texture: Option<&'a TextureSlot>,
    /// Multiplies the reflection's `specular`.
    pub specular_texture: Option<&'a TextureSlot>,
    /// R and G multiply the roughnesses.
    pub roughness_texture: Option<&'a TextureSlot>,
    /// R multiplies `weight`.
    pub weight_texture: Option<&'a TextureSlot>,
}

/// Whether a material has a Lambertian base anywhere, whatever its textures say.
pub fn has_diffuse(material: &Material) -> bool {
    if let Surface::MetallicRoughness { metallic, .. } = material.surface {
        return metallic < 1.0 || material.metallic_roughness_texture.is_some();
    }
    let mut found = false;
    visit_layers(material, |layer| found |= layer.diffuse != Vec3::ZERO);
    found
}

/// Visits the reflections of a material from the bottom up, at most [`super::MAX_REFLECTIONS`];
/// none of a metallic-roughness surface.
pub fn visit_layers<'a>(material: &'a Material, mut visit: impl FnMut(LayerParameters<'a>)) {
    let mut visit_layer = |layer: LayerParameters<'a>, specular: &'a Specular| match specular {
        Specular::Lobes { lobes, ratio, .. } => {
            let layer = LayerParameters {
                ratio: ratio.as_ref(),
                ..layer
            };
            for (index, lobe) in lobes.iter().enumerate() {
                let reflection = fitted_reflection(lobe);
                visit(if index == 0 {
                    LayerParameters {
                        reflection,
                        ..layer
                    }
                } else {
                    LayerParameters {
                        diffuse: Vec3::ZERO,
                        join: Join::Add,
                        reflection,
                        ..layer
                    }
                });
            }
        }
        single => visit(LayerParameters {
            reflection: single_reflection(single),
            ..layer
        }),
    };
    let plain = |diffuse: &[f32; 3]| LayerParameters {
        diffuse: Vec3::from(*diffuse),
        reflection: Reflection::NONE,
        ratio: None,
        weight: 1.0,
        join: Join::Over,
        diffuse_texture: None,
        specular_texture: None,
        roughness_texture: None,
        weight_texture: None,
    };
    match &material.surface {
        Surface::MetallicRoughness { .. } => {}
        Surface::DiffuseSpecular { diffuse, specular } => visit_layer(
            LayerParameters {
                diffuse_texture: material.base_color_texture.as_ref(),
                ..plain(diffuse)
            },
            specular,
        ),
        Surface::Layers { layers } => {
            for Layer {
                diffuse,
                specular,
                weight,
                blend,
                diffuse_texture,
                specular_texture,
                roughness_texture,
                weight_texture,
            } in layers
            {
                let parameters = LayerParameters {
                    weight: *weight,
                    join: match blend {
                        Blend::Over => Join::Over,
                        Blend::Coat => Join::Coat,
                    },
                    diffuse_texture: diffuse_texture.as_ref(),
                    specular_texture: specular_texture.as_ref(),
                    roughness_texture: roughness_texture.as_ref(),
                    weight_texture: weight_texture.as_ref(),
                    ..plain(diffuse)
                };
                visit_layer(parameters, specular);
            }
        }
    }
}

/// The reflection of one lobe of a fitted BRDF, not clamped.
pub fn fitted_reflection(lobe: &FittedLobe) -> Reflection<'static> {
    Reflection {
        grazing: lobe.f90.into(),
        ..Reflection::new(
            Model::CookTorrance,
            lobe.f0.into(),
            Vec2::splat(lobe.roughness),
        )
    }
}

/// The reflection of a model that has but one, not clamped.
fn single_reflection(specular: &Specular) -> Reflection<'static> {
    let Some((entry, parameters)) = specular.model() else {
        return Reflection::NONE;
    };
    let model = Model::of(entry);
    let ModelParameters { color, roughness } = parameters;
    let alpha = if model.has_exponent() {
        roughness
    } else {
        roughness.map(|value| entry.roughness.to_alpha(value))
    };
    Reflection::new(model, color.into(), alpha.into())
}
