//! Whether spherical Gaussians can follow a material's highlights: a bad picture is announced.

use glam::{Vec2, Vec3};
use relight_format::{Material, Surface, math};
use relight_shading::accuracy::accuracy;
use relight_shading::surface::{
    MIN_ALPHA, Model, Reflection, metallic_roughness_alpha, visit_layers,
};

/// Ratio of two roughnesses up to which lobes are near every model: a streak's Gaussians overlap.
const NEAR_RATIO: f32 = 4.0;
/// Part of a highlight's light, sent elsewhere than by the model, from which bands are seen in it.
const VISIBLE: f64 = 0.25;
/// Angles of the views that it is measured for: from the normal, and the azimuths, radians.
const INCIDENCE: f32 = 0.8;
const AZIMUTHS: [f32; 3] = [0.0, 0.8, 1.5];

/// Warnings of materials whose highlights are streaks too thin for lobes. What textures say of roughness is not looked at.
pub(super) fn warnings(materials: &[Material]) -> Vec<String> {
    let mut measured: Vec<(Model, Vec2, f64)> = Vec::new();
    let mut warnings = Vec::new();
    for material in materials {
        let mut worst = (0.0, Vec2::ONE);
        let mut look = |reflection: &Reflection| {
            let Reflection { model, alpha, .. } = *reflection;
            if alpha.max_element() <= NEAR_RATIO * alpha.min_element() {
                return;
            }
            let known = measured
                .iter()
                .find(|known| (known.0, known.1) == (model, alpha));
            let misplaced = known.map_or_else(|| misplaced(reflection), |known| known.2);
            if known.is_none() {
                measured.push((model, alpha, misplaced));
            }
            if misplaced > worst.0 {
                worst = (misplaced, alpha);
            }
        };
        match material.surface {
            Surface::MetallicRoughness {
                roughness,
                anisotropy_strength,
                ..
            } => {
                let alpha = metallic_roughness_alpha(roughness, anisotropy_strength);
                let alpha = alpha.max(Vec2::splat(MIN_ALPHA));
                look(&Reflection::new(Model::Ggx, Vec3::ONE, alpha));
            }
            _ => visit_layers(material, |layer| look(&layer.reflection)),
        }
        let (misplaced, alpha) = worst;
        if misplaced > VISIBLE {
            warnings.push(format!(
                "material {:?}: roughnesses of {} and {} lie so far apart that {:.0} % of the light of its \
                 highlights goes elsewhere than it should, which shows as bands; at most 8 times apart they are drawn well",
                material.name,
                alpha.x,
                alpha.y,
                100.0 * misplaced,
            ));
        }
    }
    warnings
}

/// Part of the light that lobes send elsewhere, a mean over views.
fn misplaced(reflection: &Reflection) -> f64 {
    let (sine, cosine) = math::sin_cos(INCIDENCE);
    let of = |azimuth| {
        let (y, x) = math::sin_cos(azimuth);
        accuracy(reflection, Vec3::new(sine * x, sine * y, cosine)).misplaced
    };
    AZIMUTHS.map(of).iter().sum::<f64>() / AZIMUTHS.len() as f64
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::import::plain_material;
    use relight_format::Specular;

    fn brushed(alpha: [f32; 2]) -> Material {
        let specular = Specular::Ggx {
            f0: [0.9; 3],
            alpha,
        };
        let surface = Surface::DiffuseSpecular {
            diffuse: [0.0; 3],
            specular,
        };
        plain_material("brushed", surface)
    }

    #[test]
    fn streaks_that_lobes_cannot_follow_are_announced() {
        for alpha in [[0.3, 0.3], [0.08, 0.4], [0.8, 0.1]] {
            assert_eq!(warnings(&[brushed(alpha)]), [""; 0]);
        }
        let thin = [brushed([0.02, 0.8]), brushed([0.5, 0.5])];
        let [warning] = &warnings(&thin)[..] else {
            panic!("one warning of {thin:?}");
        };
        assert!(warning.starts_with("material \"brushed\": roughnesses of 0.02 and 0.8"));
    }
}
