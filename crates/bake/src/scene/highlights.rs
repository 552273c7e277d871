//! Whether spherical Gaussians can follow a material's highlights, and vertices what it shows of other surfaces: a bad
//! picture is announced.

use glam::{Vec2, Vec3};
use relight_format::{Material, Surface, Texture, TextureSlot, math};
use relight_shading::accuracy::accuracy;
use relight_shading::surface::{
    MIN_ALPHA, Model, Reflection, metallic_roughness_alpha, visit_layers,
};
use relight_shading::textures::sample_point;

use super::bounce::mirrors;
use crate::mesh::Mesh;
use crate::transfer::reflections::ReflectionError;

/// Ratio of two roughnesses up to which lobes are near every model: a streak's Gaussians overlap.
const NEAR_RATIO: f32 = 4.0;
/// Part of a highlight's light, sent elsewhere than by the model, from which bands are seen in it.
const VISIBLE: f64 = 0.25;
/// Textures are looked at in so many places along each side of theirs.
const TEXTURE_SIDE: u32 = 16;
/// Steps of the binary logarithm of roughnesses that textures have: what lies between is as its neighbours are.
const LOG_STEPS: f32 = 4.0;
/// Angles of the views that it is measured for: from the normal, and the azimuths, radians.
const INCIDENCE: f32 = 0.8;
const AZIMUTHS: [f32; 3] = [0.0, 0.8, 1.5];

/// Warnings of materials whose highlights are streaks too thin for lobes, in a quarter of the places at least where
/// textures tell of roughness.
pub(super) fn warnings(mesh: &Mesh) -> Vec<String> {
    let mut known: Vec<(Model, Vec2, f64)> = Vec::new();
    let mut measured = |reflection: &Reflection| {
        let Reflection { model, alpha, .. } = *reflection;
        if alpha.max_element() <= NEAR_RATIO * alpha.min_element() {
            return 0.0;
        }
        let mut same = known.iter();
        if let Some(known) = same.find(|known| (known.0, known.1) == (model, alpha)) {
            return known.2;
        }
        known.push((model, alpha, misplaced(reflection)));
        known[known.len() - 1].2
    };
    let mut warnings = Vec::new();
    for material in &mesh.materials {
        let (misplaced, alpha) = worst(material, &mesh.textures, &mut measured);
        if misplaced > VISIBLE {
            warnings.push(format!(
                "material {:?}: roughnesses of {} and {} lie so far apart that {:.0} % of the light of its \
                 highlights goes elsewhere than it should, which shows as bands; at most 8 times apart they are drawn well",
                material.name,
                hundredths(alpha.x),
                hundredths(alpha.y),
                100.0 * misplaced,
            ));
        }
    }
    warnings
}

/// Errors of reflections from which warnings tell of them, in a surface's light: by the sky and by lamps, which are seldom all
/// of the light.
const VISIBLE_SKY: f32 = 0.08;
const VISIBLE_LAMPS: f32 = 0.25;
/// Materials that are looked at for it.
const MIRRORS: usize = 64;

/// Warnings of materials whose reflections of other surfaces are far off, `error` by the number of a material.
pub(super) fn of_surfaces<E>(
    mesh: &Mesh,
    lit_by_lamps: bool,
    error: impl Fn(usize) -> Result<Option<ReflectionError>, E>,
) -> Result<Vec<String>, E> {
    let (mut by_lamps, mut by_sky) = (Vec::new(), Vec::new());
    for number in largest_mirrors(mesh, lit_by_lamps) {
        let error = error(number)?.unwrap_or_default();
        let name = &mesh.materials[number].name[..];
        by_lamps.push((error.lamps, name));
        by_sky.push((error.sky, name));
    }
    let lamps = told(&by_lamps, VISIBLE_LAMPS).map(|(materials, error)| {
        format!(
            "{materials}: reflections of what emits light are off by {error:.0} % of the light that this gives it: they \
             are spread, however smooth the surface is; lights of a scene file have sharp ones"
        )
    });
    let sky = told(&by_sky, VISIBLE_SKY).map(|(materials, error)| {
        format!(
            "{materials}: reflections of other surfaces may be off by {error:.0} % of its light: edges in them are \
             spread, and mirrors are shown as if they were matt; compare with `lab truth --kind full`"
        )
    });
    Ok(lamps.into_iter().chain(sky).collect())
}

/// The materials that show what is about them, those with the most surface where there are many.
fn largest_mirrors(mesh: &Mesh, lit_by_lamps: bool) -> Vec<usize> {
    let mut areas = vec![0.0; mesh.materials.len()];
    for triangle in &mesh.triangles {
        let [a, b, c] = mesh.corners(triangle);
        areas[usize::from(triangle.material)] += f64::from((b - a).cross(c - a).length());
    }
    let all = 0..mesh.materials.len();
    let mut mirrors: Vec<usize> = all
        .filter(|&i| mirrors(&mesh.materials[i], lit_by_lamps))
        .collect();
    mirrors.sort_by(|&a, &b| areas[b].total_cmp(&areas[a]));
    mirrors.truncate(MIRRORS);
    mirrors
}

/// The worst of some materials with the number of others whose errors are visible, and its error, per cent.
fn told(errors: &[(f32, &str)], visible: f32) -> Option<(String, f32)> {
    let others = errors
        .iter()
        .filter(|(error, _)| *error > visible)
        .count()
        .checked_sub(1)?;
    let &(error, name) = errors.iter().max_by(|a, b| a.0.total_cmp(&b.0))?;
    let others = match others {
        0 => String::new(),
        1 => ", and less in another".to_owned(),
        others => format!(", and less in {others} others"),
    };
    Some((format!("material {name:?}{others}"), 100.0 * error))
}

/// What the worst of a material's reflections misplaces and its roughnesses; where textures tell of roughness, those
/// of the worst quarter's best place.
fn worst(
    material: &Material,
    textures: &[Texture],
    misplaced: &mut impl FnMut(&Reflection) -> f64,
) -> (f64, Vec2) {
    if let Surface::MetallicRoughness {
        roughness,
        anisotropy_strength,
        ..
    } = material.surface
    {
        let places = alphas(material, textures, roughness, anisotropy_strength).into_iter();
        let mut places: Vec<_> = places
            .map(|alpha| {
                let reflection = Reflection::new(Model::Ggx, Vec3::ONE, alpha);
                (misplaced(&reflection), alpha)
            })
            .collect();
        places.sort_by(|a, b| a.0.total_cmp(&b.0));
        return places[places.len() * 3 / 4];
    }
    let mut worst = (0.0, Vec2::ONE);
    visit_layers(material, |layer| {
        let misplaced = misplaced(&layer.reflection);
        if misplaced > worst.0 {
            worst = (misplaced, layer.reflection.alpha);
        }
    });
    worst
}

/// Roughnesses of a metallic-roughness surface: one, or what textures make of it in places all over them.
fn alphas(material: &Material, textures: &[Texture], roughness: f32, strength: f32) -> Vec<Vec2> {
    let slots = [
        &material.metallic_roughness_texture,
        &material.anisotropy_texture,
    ];
    let alpha = |roughness, strength| {
        metallic_roughness_alpha(roughness, strength).max(Vec2::splat(MIN_ALPHA))
    };
    if strength == 0.0 || slots == [&None, &None] {
        return vec![alpha(roughness, strength)];
    }
    let places = (0..TEXTURE_SIDE).flat_map(|y| (0..TEXTURE_SIDE).map(move |x| [x, y]));
    places
        .map(|place| {
            let uv = Vec2::from(place.map(|i| (i as f32 + 0.5) / TEXTURE_SIDE as f32));
            let channel = |slot: &Option<TextureSlot>, channel: usize| {
                let texel = slot.as_ref().map(|slot| sample_point(textures, slot, uv));
                texel.map_or(1.0, |texel| texel[channel])
            };
            let alpha = alpha(
                roughness * channel(slots[0], 1),
                strength * channel(slots[1], 2),
            );
            let step = |x: f32| math::exp2((LOG_STEPS * math::log2(x)).round() / LOG_STEPS);
            Vec2::from(alpha.to_array().map(step))
        })
        .collect()
}

/// As people are told.
fn hundredths(x: f32) -> f32 {
    (100.0 * x).round() / 100.0
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

    fn mesh(materials: &[Material], textures: &[Texture]) -> Mesh {
        Mesh {
            materials: materials.to_vec(),
            textures: textures.to_vec(),
            ..Default::default()
        }
    }

    #[test]
    fn streaks_that_lobes_cannot_follow_are_announced() {
        for alpha in [[0.3, 0.3], [0.08, 0.4], [0.8, 0.1]] {
            assert_eq!(warnings(&mesh(&[brushed(alpha)], &[])), [""; 0]);
        }
        let thin = [brushed([0.02, 0.8]), brushed([0.5, 0.5])];
        let [warning] = &warnings(&mesh(&thin, &[]))[..] else {
            panic!("one warning of {thin:?}");
        };
        assert!(warning.starts_with("material \"brushed\": roughnesses of 0.02 and 0.8"));
    }

    #[test]
    fn reflections_are_announced_by_the_worst_of_them() {
        let mut materials = vec![brushed([0.1; 2]); 4];
        for (material, name) in materials.iter_mut().zip(["one", "two", "three", "four"]) {
            material.name = name.to_owned();
        }
        materials[3].surface = Surface::DiffuseSpecular {
            diffuse: [0.5; 3],
            specular: Specular::None,
        };
        let mesh = mesh(&materials, &[]);
        let with = |sky: [f32; 3], lamps: f32| {
            let error = |number: usize| {
                let sky = sky[number];
                Ok::<_, ()>(Some(ReflectionError { sky, lamps }))
            };
            of_surfaces(&mesh, false, error).unwrap()
        };
        assert_eq!(with([0.05, 0.07, 0.02], 0.2), [""; 0]);
        let [warning] = &with([0.05, 0.3, 0.1], 0.2)[..] else {
            panic!("one warning");
        };
        assert!(warning.starts_with("material \"two\", and less in another: reflections of other"));
        assert!(warning.contains("off by 30 %"), "{warning}");
        let [warning, _] = &with([0.05, 0.07, 0.1], 1.5)[..] else {
            panic!("two warnings");
        };
        assert!(
            warning
                .contains("and less in 2 others: reflections of what emits light are off by 150 %")
        );
    }

    #[test]
    fn dielectrics_show_lamps() {
        let with = |specular| {
            let surface = Surface::DiffuseSpecular {
                diffuse: [0.5; 3],
                specular,
            };
            plain_material("wall", surface)
        };
        let plastic = with(Specular::Ggx {
            f0: [0.04; 3],
            alpha: [0.3; 2],
        });
        let matt = with(Specular::None);
        let found = [false, true].map(|lamps| [&plastic, &matt].map(|wall| mirrors(wall, lamps)));
        assert_eq!(found, [[false, false], [true, false]]);
    }

    #[test]
    fn what_textures_say_of_roughness_counts() {
        let surface = Surface::MetallicRoughness {
            base_color: [1.0; 3],
            metallic: 1.0,
            roughness: 1.0,
            anisotropy_strength: 1.0,
            anisotropy_rotation: 0.0,
        };
        let mut material = plain_material("lamp", surface);
        material.metallic_roughness_texture = Some(TextureSlot::whole(0));
        // Roughness 0.3, which is 0.09 squared, in so many of eight columns.
        let texture = |thin: usize| Texture {
            width: 8,
            height: 1,
            encoding: relight_format::TextureEncoding::Linear,
            texels: (0..8)
                .flat_map(|x| [255, if x < thin { 77 } else { 255 }, 255, 255])
                .collect(),
        };
        assert_eq!(warnings(&mesh(&[material.clone()], &[texture(1)])), [""; 0]);
        let [warning] = &warnings(&mesh(&[material.clone()], &[texture(4)]))[..] else {
            panic!("one warning");
        };
        assert!(warning.starts_with("material \"lamp\": roughnesses of 1 and 0.09"));
        material.anisotropy_texture = Some(TextureSlot::whole(1));
        let textures = [
            texture(8),
            Texture {
                texels: vec![0; 32],
                ..texture(8)
            },
        ];
        assert_eq!(warnings(&mesh(&[material], &textures)), [""; 0]);
    }
}
