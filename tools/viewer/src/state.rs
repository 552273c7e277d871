//! What is shown and how: plain data that panels change and pictures are made from.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;

use glam::{Quat, Vec3};
use relight_format::{
    Camera, Environment, FieldOfView, Layer, Material, Scene, Specular, Surface, Texture,
    TextureSlot,
};
use relight_runtime::{
    CellsOptions, LocalLight, Method, Panorama, PolarOptions, Prefiltered, Sources,
    SphericalGaussian,
};
use serde::{Deserialize, Serialize};

use crate::orbit::Orbit;
use crate::pick::{self, Hit};

/// How visible light is integrated in a picture.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum Integrator {
    /// Every lobe times the fraction of it that is visible: fastest.
    Ambient,
    /// Our integrator, with few spokes.
    PolarDraft,
    /// Our integrator.
    #[default]
    Polar,
    /// Our integrator, with many spokes.
    PolarHigh,
    /// The paper's method: slow.
    Cells,
    /// Ray-traced on the processor with the same lights and lobes; gets better while one waits.
    Truth,
}

impl Integrator {
    /// All of them, fastest first. A page has no processor to trace rays on, and does without the paper's method.
    pub const ALL: &[Self] = &[
        Self::Ambient,
        Self::PolarDraft,
        Self::Polar,
        Self::PolarHigh,
        #[cfg(not(target_family = "wasm"))]
        Self::Cells,
        #[cfg(not(target_family = "wasm"))]
        Self::Truth,
    ];

    /// For people.
    pub fn name(self) -> &'static str {
        match self {
            Self::Ambient => "ambient",
            Self::PolarDraft => "polar, draft",
            Self::Polar => "polar",
            Self::PolarHigh => "polar, high",
            Self::Cells => "cells",
            Self::Truth => "ray-traced",
        }
    }

    /// As the runtime has it; `None` for the ray tracer.
    pub fn method(self) -> Option<Method> {
        Some(match self {
            Self::Ambient => Method::Ambient,
            Self::PolarDraft => Method::Polar(PolarOptions::DRAFT),
            Self::Polar => Method::Polar(PolarOptions::STANDARD),
            Self::PolarHigh => Method::Polar(PolarOptions::HIGH),
            Self::Cells => Method::Cells(CellsOptions::STANDARD),
            Self::Truth => return None,
        })
    }
}

/// What is behind the scene.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Background {
    /// The environment's image.
    Sharp,
    /// The environment as a wide lobe sees it.
    #[default]
    Blurred,
    /// Grey.
    Off,
    /// Nothing: pictures that are saved are transparent there.
    Transparent,
}

impl Background {
    /// All of them.
    pub const ALL: [Self; 4] = [Self::Sharp, Self::Blurred, Self::Off, Self::Transparent];

    /// For people.
    pub fn name(self) -> &'static str {
        match self {
            Self::Sharp => "sharp",
            Self::Blurred => "blurred",
            Self::Off => "grey",
            Self::Transparent => "none",
        }
    }
}

/// How radiance becomes the light of a screen.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Curve {
    /// Khronos' PBR neutral, as the runtime has it: colours stay until they are nearly white.
    #[default]
    Neutral,
    /// Cut off at white.
    Clip,
    /// x / (1 + x) of every channel (Reinhard et al. 2002, equation 3).
    Reinhard,
    /// A fit of ACES (Narkowicz 2015).
    Filmic,
}

impl Curve {
    /// All of them.
    pub const ALL: [Self; 4] = [Self::Neutral, Self::Clip, Self::Reinhard, Self::Filmic];

    /// For people.
    pub fn name(self) -> &'static str {
        match self {
            Self::Neutral => "neutral",
            Self::Clip => "cut off",
            Self::Reinhard => "Reinhard",
            Self::Filmic => "filmic",
        }
    }
}

/// How many pictures are shown.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Layout {
    /// The first.
    #[default]
    One,
    /// The first left of a divider, the second right of it.
    Split,
    /// How far apart they are.
    Difference,
}

/// What is remembered from one start to the next.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default)]
#[expect(
    clippy::struct_excessive_bools,
    reason = "switches that do not depend on each other"
)]
pub struct Settings {
    /// Of both pictures.
    pub integrators: [Integrator; 2],
    /// One, two or their difference.
    pub layout: Layout,
    /// Where the divider is, fraction of the width.
    pub divider: f32,
    /// Multiplies differences.
    pub difference_scale: f32,
    /// Behind the scene.
    pub background: Background,
    /// Tone curve.
    pub curve: Curve,
    /// Stops.
    pub exposure: f32,
    /// Whether specular lobes reflect the environment's image.
    pub image_reflections: bool,
    /// Whether light bounces, where the asset has it.
    pub bounce: bool,
    /// Whether panels are shown.
    pub panels: bool,
    /// Which sections of the side panel are open.
    pub sections: [bool; 7],
    /// Lobes to fit to images; 0: as many as it takes.
    pub lobes: usize,
    /// Whether files that change are read again.
    pub watch: bool,
    /// Radians per second that the playing light turns.
    pub light_speed: f32,
    /// Pixels of a picture per pixel of the screen, at most.
    pub resolution: f32,
    /// Stage at which meshes stop being baked better.
    pub quality: Quality,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            integrators: [Integrator::Polar, Integrator::Ambient],
            layout: Layout::One,
            divider: 0.5,
            difference_scale: 4.0,
            background: Background::default(),
            curve: Curve::default(),
            exposure: 0.0,
            image_reflections: true,
            bounce: true,
            panels: true,
            sections: [true, true, true, false, true, false, false],
            lobes: 0,
            watch: true,
            light_speed: 0.6,
            resolution: 1.0,
            quality: Quality::Standard,
        }
    }
}

/// How well a mesh is baked.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub enum Quality {
    /// Within seconds.
    Draft,
    /// The default of `bake`.
    #[default]
    Standard,
    /// Small errors.
    High,
}

impl Quality {
    /// All of them, fastest first.
    pub const ALL: [Self; 3] = [Self::Draft, Self::Standard, Self::High];

    /// The stages of a bake that ends with this one.
    pub fn stages(self) -> &'static [Self] {
        match self {
            Self::Draft => &[Self::Draft],
            Self::Standard => &[Self::Draft, Self::Standard],
            Self::High => &Self::ALL,
        }
    }

    /// For people.
    pub fn name(self) -> &'static str {
        match self {
            Self::Draft => "draft",
            Self::Standard => "standard",
            Self::High => "high",
        }
    }
}

/// Distant light, ready for frames.
#[derive(Clone, Debug, Default)]
pub struct Light {
    /// For people.
    pub name: String,
    /// Where it came from, if from a file.
    pub source: Option<PathBuf>,
    /// The asset.
    pub environment: Arc<Environment>,
    /// Its lobes.
    pub lobes: Arc<[SphericalGaussian]>,
    /// Its image as lobes see it, without its sources.
    pub prefiltered: Option<Prefiltered>,
    /// Suns, lamps and windows, apart from the lobes.
    pub sources: Option<Arc<Sources>>,
    /// All of it, for backgrounds: the image itself, once it is there.
    pub panorama: Option<Panorama>,
    /// Whether it is the image that shows.
    shows_image: bool,
}

impl Light {
    /// An asset, ready for frames.
    pub fn new(
        name: String,
        source: Option<PathBuf>,
        environment: Environment,
        panorama: Option<Panorama>,
    ) -> Self {
        let lobes: Arc<[SphericalGaussian]> = environment.lobes.iter().map(Into::into).collect();
        Self {
            name,
            source,
            prefiltered: Prefiltered::new(&environment.prefiltered, &lobes),
            sources: Sources::new(&environment).map(Arc::new),
            lobes,
            shows_image: panorama.is_some(),
            panorama: panorama.or_else(|| Some(Panorama::of_environment(&environment))),
            environment: environment.into(),
        }
    }

    /// Shows the image of a light that is another fit of the same file until its own is there.
    pub fn keep_image(&mut self, before: &Self) {
        let same = self.name == before.name && self.source == before.source;
        if same && before.shows_image && !self.shows_image {
            self.panorama.clone_from(&before.panorama);
            self.shows_image = true;
        }
    }
}

/// A scene and everything about it that was changed since it was loaded.
#[derive(Clone, Debug)]
pub struct Document {
    /// As it was baked.
    pub scene: Arc<Scene>,
    /// Where it came from, if from a file.
    pub source: Option<PathBuf>,
    /// How well it is baked; `None` for an asset that was loaded.
    pub quality: Option<Quality>,
    /// Materials as edited, in the scene's order.
    pub materials: Arc<Vec<Material>>,
    /// Lights in the scene.
    pub local_lights: Vec<LocalLight>,
    /// Material that was clicked.
    pub selected: Option<usize>,
    /// Point that the inspector shows.
    pub inspected: Option<Hit>,
    /// Files that surfaces of materials came from, and what came.
    pub dropped: BTreeMap<usize, (PathBuf, Surface)>,
    /// Corners of the box about everything.
    pub bounds: (Vec3, Vec3),
}

impl Document {
    /// A scene as it was loaded.
    pub fn new(
        scene: Arc<Scene>,
        source: Option<PathBuf>,
        quality: Option<Quality>,
        local_lights: Vec<LocalLight>,
    ) -> Self {
        Self {
            materials: Arc::new(scene.materials.clone()),
            bounds: pick::bounds(&scene, None).unwrap_or((-Vec3::ONE, Vec3::ONE)),
            scene,
            source,
            quality,
            local_lights,
            selected: None,
            inspected: None,
            dropped: BTreeMap::new(),
        }
    }

    /// Gives the selected material another surface, whose slots count from the first of `textures`;
    /// `false` where nothing is selected.
    pub fn replace_selected(
        &mut self,
        source: PathBuf,
        surface: Surface,
        textures: Vec<Texture>,
    ) -> bool {
        let Some(index) = self.selected.filter(|index| *index < self.materials.len()) else {
            return false;
        };
        let first = self.scene.textures.len() as u32;
        let material = &mut Arc::make_mut(&mut self.materials)[index];
        material.base_color_texture = None;
        material.metallic_roughness_texture = None;
        material.surface = surface;
        for slot in ratios_mut(&mut material.surface) {
            slot.texture += first;
        }
        (self.dropped).insert(index, (source, material.surface.clone()));
        if !textures.is_empty() {
            // Textures are the scene's: it becomes another one, with the same geometry.
            Arc::make_mut(&mut self.scene).textures.extend(textures);
        }
        true
    }

    /// The same scene, baked better or read again: edits, lights and selection stay, unless it has
    /// other materials.
    pub fn improve(
        &mut self,
        scene: Arc<Scene>,
        quality: Option<Quality>,
        source: Option<PathBuf>,
    ) {
        let lights = std::mem::take(&mut self.local_lights);
        let mut new = Self::new(scene, source, quality, lights);
        let names = |scene: &Scene| -> Vec<String> {
            (scene.materials.iter())
                .map(|material| material.name.clone())
                .collect()
        };
        if names(&self.scene) == names(&new.scene) {
            new.selected = self.selected;
            let materials = Arc::make_mut(&mut new.materials);
            let edits = self.materials.iter().zip(&self.scene.materials);
            for (index, (material, (edited, original))) in
                materials.iter_mut().zip(edits).enumerate()
            {
                if edited != original {
                    material.surface = edited.surface.clone();
                    material.shadow_catcher = edited.shadow_catcher;
                    for slot in ratios_mut(&mut material.surface) {
                        // What was dropped onto the old scene; its own are where they were.
                        let index = slot.texture as usize;
                        if let Some(texture) = self.scene.textures.get(index)
                            && new.scene.textures.get(index) != Some(texture)
                        {
                            let textures = &mut Arc::make_mut(&mut new.scene).textures;
                            slot.texture = textures.len() as u32;
                            textures.push(texture.clone());
                        }
                    }
                    if let Some((source, surface)) = self.dropped.remove(&index)
                        && surface == edited.surface
                    {
                        let dropped = (source, material.surface.clone());
                        new.dropped.insert(index, dropped);
                    }
                }
            }
        }
        *self = new;
    }

    /// The camera of the scene, or one that shows all of it.
    pub fn camera(&self) -> Orbit {
        let (low, high) = self.bounds;
        self.scene.camera.map_or_else(
            || {
                let seen_from = Camera {
                    position: [0.55, 0.4, 1.0],
                    target: [0.0; 3],
                    up: [0.0, 1.0, 0.0],
                    field_of_view: FieldOfView::Y(40f32.to_radians()),
                };
                Orbit::new(&seen_from).framing(low, high, 1.0)
            },
            |camera| Orbit::new(&camera),
        )
    }
}

/// Slots of the ratios of a surface's fitted lobes.
fn ratios_mut(surface: &mut Surface) -> impl Iterator<Item = &mut TextureSlot> {
    let (layers, single): (&mut [Layer], _) = match surface {
        Surface::Layers { layers } => (layers, None),
        Surface::DiffuseSpecular { specular, .. } => (&mut [], Some(specular)),
        Surface::MetallicRoughness { .. } => (&mut [], None),
    };
    let speculars = layers
        .iter_mut()
        .map(|layer| &mut layer.specular)
        .chain(single);
    speculars.filter_map(|specular| match specular {
        Specular::Lobes { ratio, .. } => ratio.as_mut(),
        _ => None,
    })
}

/// The turn of distant light.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LightTurn {
    /// About +Y, radians.
    pub yaw: f32,
    /// About +X, after it, radians.
    pub pitch: f32,
}

impl LightTurn {
    /// As frames have it.
    pub fn rotation(self) -> Quat {
        Quat::from_rotation_x(self.pitch) * Quat::from_rotation_y(self.yaw)
    }
}
