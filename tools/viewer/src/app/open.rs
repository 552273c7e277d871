//! Files that are opened, dropped, followed or read again.

#[cfg(not(target_family = "wasm"))]
use std::path::Path;

use super::Viewer;
#[cfg(not(target_family = "wasm"))]
use crate::jobs::{self, FileKind, Kind};
#[cfg(not(target_family = "wasm"))]
use crate::state::Document;
#[cfg(not(target_family = "wasm"))]
use crate::watch;

impl Viewer {
    /// Bakes the built-in scene and shows it.
    #[cfg(not(target_family = "wasm"))]
    pub fn open_built_in(&mut self) {
        let best = self.settings.quality;
        self.fresh = true;
        self.jobs
            .start("built-in scene", Kind::Scene, move |context| {
                jobs::built_in_scene(best.stages(), context)
            });
    }

    /// Opens whatever a file is.
    #[cfg(not(target_family = "wasm"))]
    pub fn open(&mut self, path: &Path) {
        match jobs::kind_of(path) {
            Some(FileKind::Scene) => {
                self.fresh = true;
                self.load_scene(path);
            }
            Some(FileKind::Light) => self.load_light(path),
            Some(FileKind::Material) => {
                let (path, name) = (path.to_owned(), jobs::file_name(path));
                self.jobs.start(name, Kind::Material, move |context| {
                    jobs::material_from_file(&path, context)
                });
            }
            None => self.error(format!(
                "{}: expected a scene (.toml, .gltf, .glb, .obj), an image (.hdr, .exr), a BRDF \
                 (.bsdf, .binary) or an asset (.relight)",
                path.display()
            )),
        }
    }

    #[cfg(not(target_family = "wasm"))]
    fn load_scene(&mut self, path: &Path) {
        let (path, best) = (path.to_owned(), self.settings.quality);
        self.jobs
            .start(jobs::file_name(&path), Kind::Scene, move |context| {
                jobs::scene_from_file(&path, best.stages(), context)
            });
    }

    #[cfg(not(target_family = "wasm"))]
    pub(super) fn load_light(&mut self, path: &Path) {
        let (path, lobes) = (path.to_owned(), self.settings.lobes);
        self.jobs
            .start(jobs::file_name(&path), Kind::Light, move |context| {
                jobs::light_from_file(&path, &jobs::fit_stages_to(lobes), context)
            });
    }

    /// Fits the environment again, with as many lobes as are asked for now.
    #[cfg(not(target_family = "wasm"))]
    pub fn fit_again(&mut self) {
        if let Some(path) = self.light.source.clone() {
            return self.load_light(&path);
        }
        let lobes = self.settings.lobes;
        self.jobs
            .start("built-in light", Kind::Light, move |context| {
                jobs::built_in_light(&jobs::fit_stages_to(lobes), context)
            });
    }

    /// Fits the image again, with as many lobes as are asked for now.
    #[cfg(target_family = "wasm")]
    pub fn fit_again(&mut self) {
        if !self.jobs.fit_again(self.settings.lobes) {
            self.error("drop an image (.hdr, .exr) first");
        }
    }

    /// Bakes the scene again, at the quality asked for now.
    #[cfg(not(target_family = "wasm"))]
    pub fn bake_again(&mut self) {
        let source = self
            .document
            .as_ref()
            .and_then(|document| document.source.clone());
        if let Some(path) = source {
            self.load_scene(&path);
        } else {
            self.open_built_in();
            self.fresh = self.document.is_none();
        }
    }

    pub(super) fn take_dropped(&mut self, ui: &egui::Ui) {
        let dropped = ui.input(|input| input.raw.dropped_files.clone());
        for file in dropped {
            #[cfg(not(target_family = "wasm"))]
            self.open(file.path());
            #[cfg(target_family = "wasm")]
            crate::jobs::take_dropped(file, self.jobs.inbox(), &self.context);
        }
    }

    #[cfg(not(target_family = "wasm"))]
    pub(super) fn follow_files(&mut self) {
        if !self.settings.watch {
            return;
        }
        let [scene, light] = &mut self.watch;
        let (scene, light) = (scene.changed(), light.changed());
        let source = |document: &Document| document.source.clone();
        if scene && let Some(path) = self.document.as_ref().and_then(source) {
            self.load_scene(&path);
        }
        if light && let Some(path) = self.light.source.clone() {
            self.load_light(&path);
        }
        self.context.request_repaint_after(watch::INTERVAL);
    }

    /// Whether a light that somebody named is still being loaded.
    #[cfg(not(target_family = "wasm"))]
    pub(super) fn is_loading_named_light(&self) -> bool {
        (self.jobs.running().iter())
            .any(|job| job.kind == Kind::Light && job.name != "built-in light")
    }
}
