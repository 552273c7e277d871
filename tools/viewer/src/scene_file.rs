//! What is shown to camera and scene files.

use std::path::{Path, PathBuf};

use anyhow::{Context as _, bail};
use relight_bake::scene::description::{
    self, BlendName, Color, LayerFile, MaterialOverride, SceneFile,
};
use relight_format::{self as format, Blend, Camera, FieldOfView, Material, Surface};
use relight_runtime::LocalLight;

use crate::state::{Document, Light};

/// A camera as scene and camera files have it.
fn describe_camera(camera: &Camera) -> description::Camera {
    let degrees = |angle: f32| Some(angle.to_degrees());
    let (fov_x_degrees, fov_y_degrees) = match camera.field_of_view {
        FieldOfView::X(angle) => (degrees(angle), None),
        FieldOfView::Y(angle) => (None, degrees(angle)),
    };
    description::Camera {
        position: camera.position,
        target: camera.target,
        up: camera.up,
        fov_x_degrees,
        fov_y_degrees,
    }
}

fn describe_light(light: &LocalLight) -> description::Light {
    description::Light {
        position: light.position.into(),
        radius: light.radius,
        radiance: Color::Rgb(light.radiance.into()),
        direction: light.spot.map(|spot| spot.direction.into()),
        inner_degrees: light.spot.map(|spot| spot.inner_angle.to_degrees()),
        outer_degrees: light.spot.map(|spot| spot.outer_angle.to_degrees()),
    }
}

/// Writes a scene file of what is shown: the mesh and everything that was changed about it.
pub fn scene(
    path: &Path,
    document: &Document,
    light: &Light,
    camera: &Camera,
) -> anyhow::Result<()> {
    let text = toml::to_string_pretty(&scene_file(path, document, light, camera)?)?;
    Ok(format::write_file(path, text.as_bytes())?)
}

fn scene_file(
    path: &Path,
    document: &Document,
    light: &Light,
    camera: &Camera,
) -> anyhow::Result<SceneFile> {
    let source = document
        .source
        .as_deref()
        .filter(|source| !has_ending(source, "relight"))
        .context("a scene file names a mesh, and this scene was not made from one")?;
    let new_folder = folder_of(path)?;
    let old_folder = folder_of(source)?;
    // Scene files name nothing outside their folder.
    let place = |file: &Path| {
        let absolute = old_folder.join(file);
        match absolute.strip_prefix(&new_folder) {
            Ok(relative) => Ok(relative.to_owned()),
            Err(_) => Err(anyhow::anyhow!(
                "a scene file lies in the folder of what it names, or above it: {} is not below {}",
                absolute.display(),
                new_folder.display()
            )),
        }
    };
    let mut file = if has_ending(source, "toml") {
        let mut file = description::load(source)?;
        file.mesh = place(&file.mesh)?;
        let mut moved = Ok(());
        let materials = (file.materials.values_mut()).chain(
            file.ground
                .as_mut()
                .and_then(|ground| ground.material.as_mut()),
        );
        for material in materials {
            visit_paths(material, &mut |file| match place(file) {
                Ok(placed) => *file = placed,
                Err(error) => moved = Err(error),
            });
        }
        moved?;
        file
    } else {
        let name = source.file_name().context("the mesh has no name")?;
        SceneFile {
            mesh: place(Path::new(name))?,
            environment: None,
            transform: description::Transform::default(),
            materials: std::collections::BTreeMap::new(),
            crease_degrees: None,
            emission: std::collections::BTreeMap::new(),
            shadow_catchers: Vec::new(),
            cutout: std::collections::BTreeMap::new(),
            ground: None,
            camera: None,
            lights: Vec::new(),
            refinement: None,
        }
    };
    // Light from elsewhere is not named: the scene is whole without it.
    file.environment = match &light.source {
        Some(image) => place(&std::path::absolute(image)?).ok(),
        None => file.environment.and_then(|image| place(&image).ok()),
    };
    file.camera = Some(describe_camera(camera));
    file.lights = document.local_lights.iter().map(describe_light).collect();
    let edited = (document
        .materials
        .iter()
        .zip(&document.scene.materials)
        .enumerate())
    .filter(|(_, (new, old))| new != old)
    .map(|(index, (new, _))| (index, new));
    for (index, material) in edited {
        if material.emission != [0.0; 3] || file.emission.contains_key(&material.name) {
            let emission = Color::Rgb(material.emission);
            file.emission.insert(material.name.clone(), emission);
        }
        file.shadow_catchers.retain(|name| *name != material.name);
        if material.shadow_catcher {
            file.shadow_catchers.push(material.name.clone());
        }
        let described = match document.dropped.get(&index) {
            Some((source, surface)) if *surface == material.surface => MaterialOverride::Measured {
                file: place(&std::path::absolute(source)?)?,
                original: None,
            },
            _ => describe_material(material)?,
        };
        match &mut file.ground {
            Some(ground) if material.name == "ground" => ground.material = Some(described),
            _ => drop(file.materials.insert(material.name.clone(), described)),
        }
    }
    Ok(file)
}

fn has_ending(path: &Path, ending: &str) -> bool {
    (path.extension()).is_some_and(|found| found.eq_ignore_ascii_case(ending))
}

fn folder_of(path: &Path) -> anyhow::Result<PathBuf> {
    let path = std::path::absolute(path)?;
    Ok(path.parent().unwrap_or(Path::new("/")).to_owned())
}

/// Every file that a material names.
fn visit_paths(material: &mut MaterialOverride, visit: &mut dyn FnMut(&mut PathBuf)) {
    match material {
        MaterialOverride::Measured { file, original } => {
            visit(file);
            if let Some(original) = original {
                visit(original);
            }
        }
        MaterialOverride::Layers {
            layers,
            normal_texture,
            anisotropy_texture,
            ..
        } => {
            let textures = [normal_texture, anisotropy_texture];
            for texture in textures.into_iter().flatten() {
                visit(texture);
            }
            for layer in layers {
                let textures = [
                    &mut layer.diffuse_texture,
                    &mut layer.specular_texture,
                    &mut layer.roughness_texture,
                    &mut layer.glossiness_texture,
                    &mut layer.weight_texture,
                ];
                for texture in textures.into_iter().flatten() {
                    visit(texture);
                }
                visit_paths(&mut layer.material, visit);
            }
        }
        _ => {}
    }
}

fn describe_material(material: &Material) -> anyhow::Result<MaterialOverride> {
    if material.slots().next().is_some() {
        bail!(
            "material {:?} has textures, or lobes of a table that were changed, which a scene file \
             cannot describe; undo its change to save the rest",
            material.name
        );
    }
    match &material.surface {
        Surface::MetallicRoughness {
            base_color,
            metallic,
            roughness,
            anisotropy_strength,
            anisotropy_rotation,
        } => Ok(MaterialOverride::MetallicRoughness {
            base_color: Color::Rgb(*base_color),
            metallic: *metallic,
            roughness: *roughness,
            anisotropy_strength: *anisotropy_strength,
            anisotropy_rotation_degrees: anisotropy_rotation.to_degrees(),
        }),
        Surface::DiffuseSpecular { diffuse, specular } => {
            Ok(MaterialOverride::over_base(*diffuse, specular))
        }
        Surface::Layers { layers } => {
            let layers = layers.iter().map(|layer| LayerFile {
                material: Box::new(MaterialOverride::over_base(layer.diffuse, &layer.specular)),
                weight: layer.weight,
                blend: match layer.blend {
                    Blend::Over => BlendName::Over,
                    Blend::Coat => BlendName::Coat,
                },
                diffuse_texture: None,
                specular_texture: None,
                roughness_texture: None,
                glossiness_texture: None,
                weight_texture: None,
            });
            Ok(MaterialOverride::Layers {
                layers: layers.collect(),
                normal_texture: None,
                normal_scale: 1.0,
                anisotropy_texture: None,
            })
        }
    }
}
