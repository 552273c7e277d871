//! The material that was clicked: every parameter of every model.

use std::sync::Arc;

use egui::{DragValue, Slider, Ui};
use relight_format::{
    Blend, Layer, MAX_LAYERS, MAX_REFLECTIONS, Material, ModelParameters, REFLECTION_MODELS,
    Roughness, Specular, Surface,
};

use crate::app::Viewer;
use crate::dialog::Purpose;

/// Smallest roughness that can be set: as sharp as reflections can be drawn.
const LEAST_ROUGHNESS: f32 = relight_shading::surface::MIN_ALPHA;

pub fn show(ui: &mut Ui, viewer: &mut Viewer) {
    let mut open = false;
    let Some(document) = &mut viewer.document else {
        return;
    };
    let name = |index: usize, material: &Material| {
        if material.name.is_empty() {
            format!("material {index}")
        } else {
            material.name.clone()
        }
    };
    let selected = (document.selected)
        .and_then(|index| Some(name(index, document.materials.get(index)?)))
        .unwrap_or_else(|| "click a surface".into());
    egui::ComboBox::from_label("selected")
        .selected_text(selected)
        .show_ui(ui, |ui| {
            for (index, material) in document.materials.iter().enumerate() {
                ui.selectable_value(&mut document.selected, Some(index), name(index, material));
            }
        });
    let Some(index) = document
        .selected
        .filter(|index| *index < document.materials.len())
    else {
        return;
    };
    let original = document.scene.materials.get(index);
    let mut material = document.materials[index].clone();
    ui.push_id(index, |ui| edit(ui, &mut material));
    ui.horizontal(|ui| {
        open = ui
            .button("Measured…")
            .on_hover_text("fit an RGL or MERL table")
            .clicked();
        if let Some(original) = original
            && *original != material
            && ui.button("Undo changes").clicked()
        {
            material = original.clone();
        }
    });
    if document.materials[index] != material {
        Arc::make_mut(&mut document.materials)[index] = material;
    }
    if open {
        viewer.choose(&Purpose::Open);
    }
}

fn edit(ui: &mut Ui, material: &mut Material) {
    let surface = &mut material.surface;
    let kind = match surface {
        Surface::MetallicRoughness { .. } => "metallic-roughness",
        Surface::DiffuseSpecular { .. } => "base and reflection",
        Surface::Layers { .. } => "layers",
    };
    egui::ComboBox::from_label("surface")
        .selected_text(kind)
        .show_ui(ui, |ui| {
            let color = base_color(surface);
            let choices = [
                (
                    "metallic-roughness",
                    Surface::MetallicRoughness {
                        base_color: color,
                        metallic: 0.0,
                        roughness: 0.5,
                        anisotropy_strength: 0.0,
                        anisotropy_rotation: 0.0,
                    },
                ),
                (
                    "base and reflection",
                    Surface::DiffuseSpecular {
                        diffuse: color,
                        specular: Specular::None,
                    },
                ),
                (
                    "layers",
                    Surface::Layers {
                        layers: vec![layer(color, Specular::None, Blend::Over)],
                    },
                ),
            ];
            for (name, choice) in choices {
                if ui.selectable_label(kind == name, name).clicked() && kind != name {
                    *surface = choice;
                }
            }
        });
    match surface {
        Surface::MetallicRoughness {
            base_color,
            metallic,
            roughness,
            anisotropy_strength,
            anisotropy_rotation,
        } => {
            color_row(ui, "base colour", base_color);
            ui.add(Slider::new(metallic, 0.0..=1.0).text("metallic"));
            ui.add(Slider::new(roughness, 0.0..=1.0).text("roughness"));
            ui.add(Slider::new(anisotropy_strength, 0.0..=1.0).text("anisotropy"));
            let range = -std::f32::consts::PI..=std::f32::consts::PI;
            ui.add(Slider::new(anisotropy_rotation, range).text("its direction, rad"));
        }
        Surface::DiffuseSpecular { diffuse, specular } => {
            color_row(ui, "diffuse", diffuse);
            specular_edit(ui, specular);
        }
        Surface::Layers { layers } => layers_edit(ui, layers),
    }
    color_row(ui, "emits", &mut material.emission);
    ui.checkbox(&mut material.shadow_catcher, "Catches shadows alone")
        .on_hover_text("Pictures have its shadow only, to be laid over a photograph");
    if material.normal_texture.is_some() {
        ui.add(Slider::new(&mut material.normal_scale, 0.0..=4.0).text("normal map"));
    }
    let textures = material.slots().count();
    if textures > 0 {
        ui.weak(format!("{textures} textures multiply these"));
    }
}

fn base_color(surface: &Surface) -> [f32; 3] {
    match surface {
        Surface::MetallicRoughness { base_color, .. } => *base_color,
        Surface::DiffuseSpecular { diffuse, .. } => *diffuse,
        Surface::Layers { layers } => layers.first().map_or([0.5; 3], |layer| layer.diffuse),
    }
}

fn layer(diffuse: [f32; 3], specular: Specular, blend: Blend) -> Layer {
    Layer {
        diffuse,
        specular,
        weight: 1.0,
        blend,
        diffuse_texture: None,
        specular_texture: None,
        roughness_texture: None,
        weight_texture: None,
    }
}

fn layers_edit(ui: &mut Ui, layers: &mut Vec<Layer>) {
    let mut removed = None;
    for (index, layer) in layers.iter_mut().enumerate() {
        ui.push_id(index, |ui| {
            ui.separator();
            ui.horizontal(|ui| {
                ui.strong(format!("layer {}", index + 1));
                ui.selectable_value(&mut layer.blend, Blend::Over, "over");
                // A coat has exactly one reflection.
                if layer.specular.reflections() == 1 && !matches!(layer.specular, Specular::None) {
                    ui.selectable_value(&mut layer.blend, Blend::Coat, "coat");
                } else {
                    layer.blend = Blend::Over;
                }
                if index > 0 && ui.small_button("×").clicked() {
                    removed = Some(index);
                }
            });
            color_row(ui, "diffuse", &mut layer.diffuse);
            ui.add(Slider::new(&mut layer.weight, 0.0..=1.0).text("weight"));
            specular_edit(ui, &mut layer.specular);
        });
    }
    if let Some(index) = removed {
        layers.remove(index);
    }
    let reflections: usize = layers
        .iter()
        .map(|layer| layer.specular.reflections())
        .sum();
    if layers.len() < MAX_LAYERS
        && reflections < MAX_REFLECTIONS
        && ui.button("Add a coat").clicked()
    {
        let specular = Specular::Ggx {
            f0: [0.04; 3],
            alpha: [0.1; 2],
        };
        layers.push(layer([0.0; 3], specular, Blend::Coat));
    }
}

fn specular_edit(ui: &mut Ui, specular: &mut Specular) {
    let name = match specular.model() {
        Some((model, _)) => model.name,
        None if *specular == Specular::None => "none",
        None => "measured",
    };
    egui::ComboBox::from_label("reflection")
        .selected_text(name)
        .show_ui(ui, |ui| {
            let (color, alpha) = color_and_alpha(specular);
            let models = REFLECTION_MODELS.iter().map(|model| {
                let roughness = [model.roughness.from_alpha(alpha); 2];
                let parameters = ModelParameters { color, roughness };
                (model.name, model.reflection(parameters))
            });
            for (choice, value) in std::iter::once(("none", Specular::None)).chain(models) {
                if ui.selectable_label(name == choice, choice).clicked() && name != choice {
                    *specular = value;
                }
            }
        });
    if let Some((model, mut parameters)) = specular.model() {
        color_row(ui, model.color(), &mut parameters.color);
        let name = match model.roughness_name {
            "alpha" => "α",
            name => name,
        };
        let [along, across] = &mut parameters.roughness;
        if model.anisotropic {
            roughness_row(ui, model.roughness, along, &format!("{name} along"));
            roughness_row(ui, model.roughness, across, &format!("{name} across"));
        } else {
            roughness_row(ui, model.roughness, along, name);
        }
        *specular = model.reflection(parameters);
    } else if let Specular::Lobes { path, lobes, .. } = specular {
        ui.label(path.as_str());
        for (index, lobe) in lobes.iter_mut().enumerate() {
            ui.push_id(index, |ui| {
                color_row(ui, "f0", &mut lobe.f0);
                color_row(ui, "at grazing", &mut lobe.f90);
                roughness_row(ui, Roughness::Alpha, &mut lobe.roughness, "roughness");
            });
        }
    }
}

/// A slider over what can be drawn of a roughness.
fn roughness_row(ui: &mut Ui, kind: Roughness, value: &mut f32, name: &str) {
    let range = match kind {
        Roughness::Alpha => LEAST_ROUGHNESS..=1.0,
        Roughness::Exponent { least } => least..=relight_shading::surface::MAX_EXPONENT,
    };
    ui.add(Slider::new(value, range).logarithmic(true).text(name));
}

/// Colour and roughness to go on with in another model.
fn color_and_alpha(specular: &Specular) -> ([f32; 3], f32) {
    let (color, alpha) = match (specular, specular.model()) {
        (_, Some((model, parameters))) => {
            let alpha = model.roughness.to_alpha(parameters.roughness[0]);
            (parameters.color, alpha)
        }
        (Specular::Lobes { lobes, .. }, _) if !lobes.is_empty() => {
            (lobes[0].f0, lobes[0].roughness)
        }
        _ => ([0.04; 3], 0.3),
    };
    (color, alpha.clamp(LEAST_ROUGHNESS, 1.0))
}

/// A colour by its picker and its numbers, which may be above 1.
fn color_row(ui: &mut Ui, name: &str, color: &mut [f32; 3]) {
    ui.horizontal(|ui| {
        let mut shown = color.map(|value| value.min(1.0));
        if ui.color_edit_button_rgb(&mut shown).changed() {
            *color = shown;
        }
        for value in color.iter_mut() {
            ui.add(
                DragValue::new(value)
                    .speed(0.005)
                    .range(0.0..=100.0)
                    .max_decimals(3),
            );
        }
        ui.label(name);
    });
}
