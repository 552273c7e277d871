//! Files to scenes, environments and materials, beside the pictures.
//!
//! Whatever a file holds, the application goes on: what cannot be read, and what panics, becomes
//! a message. Programs read and bake in threads; pages read what they are given and leave fits to
//! workers.

#[cfg(target_family = "wasm")]
mod page;
#[cfg(not(target_family = "wasm"))]
mod thread;

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use relight_bake::environment::FitOptions;
use relight_bake::environment::hdr::LatLong;
use relight_format::{self as format, Limits, MaterialAsset, Scene, Specular, Surface, Texture};
use relight_runtime::{LocalLight, Panorama};
use web_time::Instant;

#[cfg(target_family = "wasm")]
pub use page::*;
#[cfg(not(target_family = "wasm"))]
pub use thread::*;

use crate::state::{Light, Quality};

/// Lobes of the first fit of an image: a second or so.
const DRAFT_LOBES: usize = 8;

/// What a job brings. Several may come from one job, better and better.
#[derive(Clone, Debug)]
pub enum Loaded {
    /// A scene.
    Scene {
        /// The scene.
        scene: Arc<Scene>,
        /// Where it came from; none for the built-in one.
        source: Option<PathBuf>,
        /// How well it was baked; none for an asset.
        quality: Option<Quality>,
        /// Lights of the scene file.
        lights: Vec<LocalLight>,
        /// Environment of the scene file.
        environment: Option<PathBuf>,
        /// What the file system may change it through.
        files: Vec<PathBuf>,
        /// What was left out or changed on the way.
        warnings: Vec<String>,
    },
    /// Distant light.
    Light(Light),
    /// A measured or packed material for the one selected.
    Material {
        /// Where it came from.
        source: PathBuf,
        /// What replaces the surface; its slots count from the first of `textures`.
        surface: Surface,
        /// To be added to the scene's.
        textures: Vec<Texture>,
    },
    /// A file was written.
    Saved(String),
}

/// How far a job is.
#[derive(Clone, Debug)]
pub struct Status {
    /// The stage at hand.
    pub stage: &'static str,
    /// Of the whole job, in [0, 1].
    pub fraction: f32,
    /// How long all that is left will take, once that can be told.
    pub left: Option<Duration>,
}

/// Stages of a job in their order, and how long they take beside each other.
pub type Plan = Vec<(&'static str, f32)>;

/// How far a job is by its plan, which may become longer.
#[derive(Debug)]
struct Tracker {
    stage: &'static str,
    plan: Plan,
    /// Where in the plan.
    at: usize,
    /// Of the stage at hand.
    fraction: f32,
    since: Instant,
}

impl Tracker {
    fn new(now: Instant) -> Self {
        Self {
            stage: "wait",
            plan: Vec::new(),
            at: 0,
            fraction: 0.0,
            since: now,
        }
    }

    /// Takes what a stage reports. Those that are not in the plan, as they are short, leave the rest
    /// as it is.
    fn report(&mut self, stage: &'static str, fraction: f32) {
        self.stage = stage;
        let fraction = fraction.clamp(0.0, 1.0);
        // Once a stage is done the next one of its name is meant.
        let from = self.at + usize::from(self.is_at(stage) && fraction + 0.5 < self.fraction);
        let found = (self.plan.iter().skip(from)).position(|(name, _)| *name == stage);
        match found {
            Some(0) if from == self.at => self.fraction = self.fraction.max(fraction),
            Some(further) => (self.at, self.fraction) = (from + further, fraction),
            None if self.plan.is_empty() => self.fraction = fraction,
            None => {}
        }
    }

    fn is_at(&self, stage: &str) -> bool {
        (self.plan.get(self.at)).is_some_and(|(name, _)| *name == stage)
    }

    /// Of all of it, in [0, 1].
    fn whole(&self) -> f32 {
        let sum = |plan: &[(&str, f32)]| plan.iter().map(|(_, weight)| weight).sum::<f32>();
        let Some((_, weight)) = self.plan.get(self.at) else {
            return self.fraction;
        };
        (sum(&self.plan[..self.at]) + weight * self.fraction) / sum(&self.plan)
    }

    fn status(&self, elapsed: Duration) -> Status {
        let fraction = self.whole();
        let elapsed = elapsed.as_secs_f64();
        // Too early, and the guess is wild.
        let left = (fraction > 0.02 && elapsed > 0.5)
            .then(|| Duration::try_from_secs_f64(elapsed * (1.0 / f64::from(fraction) - 1.0)).ok())
            .flatten();
        Status {
            stage: self.stage,
            fraction,
            left,
        }
    }
}

/// Stages of a bake beside each other, of spot and of the built-in scene; they vary by a factor of
/// two.
#[cfg(not(target_family = "wasm"))]
const BAKE: [(&str, f32); 4] = [
    ("build bvh", 0.01),
    ("bounces", 0.11),
    ("refine", 0.03),
    ("visibility and compression", 0.85),
];

/// The stages of bakes at these qualities.
#[cfg(not(target_family = "wasm"))]
fn bake_plan(qualities: &[Quality]) -> Plan {
    let weight = |quality: &Quality| match quality {
        Quality::Draft => 1.0,
        Quality::Standard => 3.2,
        Quality::High => 23.0,
    };
    (qualities.iter())
        .flat_map(|quality| BAKE.map(|(name, part)| (name, part * weight(quality))))
        .collect()
}

/// The stages of fits of these numbers of lobes: time grows with the square, or a little less.
fn fit_plan(stages: &[usize]) -> Plan {
    (stages.iter())
        .map(|lobes| {
            (
                "fitting lobes",
                (4.0 + fit_options(*lobes).lobes as f32).powf(1.8),
            )
        })
        .collect()
}

/// What a job is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// The scene.
    Scene,
    /// The environment.
    Light,
    /// A material.
    Material,
    /// A file to write.
    Save,
    /// A file to fetch, in a page.
    Fetch,
}

/// What jobs tell the application.
#[derive(Clone, Debug)]
pub enum Event {
    /// Something is there.
    Loaded(Box<Loaded>),
    /// For people: what went wrong and where.
    Failed(String),
}

/// What a file is, by its name and, for assets, by what is in it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FileKind {
    /// A scene, mesh or scene asset.
    Scene,
    /// An image or environment asset.
    Light,
    /// A measured BRDF or material asset.
    Material,
}

impl FileKind {
    /// `None` where the name says nothing that we know. Assets are told apart by their `bytes`.
    pub fn of(path: &Path, bytes: impl FnOnce() -> Vec<u8>) -> Option<Self> {
        let extension = path.extension()?.to_str()?.to_ascii_lowercase();
        match extension.as_str() {
            "toml" | "gltf" | "glb" | "obj" => Some(Self::Scene),
            "hdr" | "exr" => Some(Self::Light),
            "bsdf" | "binary" => Some(Self::Material),
            "relight" => {
                match format::inspect(&bytes(), &Limits::default()) {
                    Ok((format::Kind::Environment, ..)) => Some(Self::Light),
                    Ok((format::Kind::Material, ..)) => Some(Self::Material),
                    // Reading it will say what is wrong.
                    _ => Some(Self::Scene),
                }
            }
            _ => None,
        }
    }
}

/// Endings of the names of files that can be opened.
pub const SCENE_ENDINGS: [&str; 5] = ["toml", "gltf", "glb", "obj", "relight"];
/// The same of environments.
pub const LIGHT_ENDINGS: [&str; 3] = ["hdr", "exr", "relight"];
/// The same of materials.
pub const MATERIAL_ENDINGS: [&str; 3] = ["bsdf", "binary", "relight"];

/// How an image is fitted with so many lobes; 0: as many as it takes.
pub fn fit_options(lobes: usize) -> FitOptions {
    match lobes {
        0 => FitOptions::default(),
        lobes => FitOptions::with_lobes(lobes),
    }
}

/// Numbers of lobes of the stages of a fit that ends with `lobes`, as in [`fit_options`].
pub fn fit_stages_to(lobes: usize) -> Vec<usize> {
    let draft = match lobes {
        0 => DRAFT_LOBES,
        lobes => DRAFT_LOBES.min(lobes),
    };
    let mut stages = vec![draft, lobes];
    stages.dedup();
    stages
}

/// What is seen of an image behind the scene once the fit is at this stage: nothing of its own until the
/// last, as it takes longer than the first fit of a large image.
pub fn panorama_of(image: &LatLong, stage: usize, stages: &[usize]) -> Option<Panorama> {
    let is_last = stage + 1 == stages.len();
    is_last
        .then(|| Panorama::from_lat_long([image.width, image.height], &image.pixels))
        .flatten()
}

/// The surface of a material asset, and its textures: those that need no texture coordinates.
fn surface_of(asset: MaterialAsset) -> anyhow::Result<(Surface, Vec<Texture>)> {
    let mut plain = asset.material.clone();
    let layers = match &mut plain.surface {
        Surface::DiffuseSpecular { specular, .. } => vec![specular],
        Surface::Layers { layers } => layers.iter_mut().map(|layer| &mut layer.specular).collect(),
        Surface::MetallicRoughness { .. } => Vec::new(),
    };
    for specular in layers {
        if let Specular::Lobes { ratio, .. } = specular {
            *ratio = None;
        }
    }
    anyhow::ensure!(
        plain.slots().next().is_none(),
        "its textures have to be baked into a scene; name it in a scene file"
    );
    Ok((asset.material.surface, asset.textures))
}

/// Name without folders.
pub fn file_name(path: &Path) -> String {
    path.file_name()
        .unwrap_or_default()
        .to_string_lossy()
        .into_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_time_left_is_that_of_all_stages() {
        let start = Instant::now();
        let mut tracker = Tracker::new(start);
        tracker.plan = bake_plan(Quality::Standard.stages());
        let mut last = 0.0;
        let mut told = Vec::new();
        // A draft that takes a second and a standard bake of 3.2, as they report.
        for (quality, scale) in [(0.0, 1.0), (1.0, 3.2)] {
            let mut elapsed = quality;
            for (stage, part) in BAKE {
                for step in 0..=20 {
                    tracker.report(stage, step as f32 / 20.0);
                    let status = tracker.status(Duration::from_secs_f32(elapsed));
                    assert!(status.fraction >= last, "{stage} {step}: {status:?} {last}");
                    assert_eq!(status.stage, stage);
                    last = status.fraction;
                    if let Some(left) = status.left {
                        told.push(elapsed + left.as_secs_f32());
                    }
                    elapsed += part * scale / 20.0;
                }
                elapsed -= part * scale / 20.0;
            }
            tracker.report("assemble", 0.0);
        }
        assert!((last - 1.0).abs() < 1e-4, "{last}");
        assert!(told.len() > 50);
        for whole in told {
            assert!((whole - 4.2).abs() < 0.2, "{whole} of 4.2 seconds");
        }
    }

    #[test]
    fn jobs_without_a_plan_tell_of_their_stage() {
        let mut tracker = Tracker::new(Instant::now());
        tracker.report("draw frames", 0.25);
        let status = tracker.status(Duration::from_secs(10));
        assert_eq!(status.fraction, 0.25);
        assert_eq!(status.left.unwrap().as_secs(), 30);
    }
}
