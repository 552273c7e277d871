//! Dialogs, and what is written to files that were chosen in them.

use std::path::{Path, PathBuf};
#[cfg(not(target_family = "wasm"))]
use std::sync::{Arc, mpsc};
#[cfg(not(target_family = "wasm"))]
use std::time::Duration;

#[cfg(target_family = "wasm")]
use relight_format::Scene;

use super::Viewer;
#[cfg(not(target_family = "wasm"))]
use crate::compose::Look;
use crate::dialog::Purpose;
#[cfg(not(target_family = "wasm"))]
use crate::jobs::{self, Kind, Loaded};
#[cfg(not(target_family = "wasm"))]
use crate::scene_file;
#[cfg(not(target_family = "wasm"))]
use crate::state::Layout;
#[cfg(not(target_family = "wasm"))]
use crate::turntable;
use crate::{camera_file, save};

/// A picture of the window: waited for, asked for, or there.
#[cfg(not(target_family = "wasm"))]
pub(super) enum Capture {
    Waiting(PathBuf),
    Asked(mpsc::Receiver<()>),
}

impl Viewer {
    /// Asks for a file in a dialog.
    pub fn choose(&self, purpose: &Purpose) {
        let name = self
            .document
            .as_ref()
            .map_or("scene", |document| document.scene.name.as_str());
        let (sender, context) = (self.choices.0.clone(), self.context.clone());
        let of = purpose.clone();
        let answered = move |path: Option<PathBuf>| {
            if let Some(path) = path {
                // Nobody listens any more while the application ends.
                let _ = sender.send((of, path));
                context.request_repaint();
            }
        };
        (self.dialog)(purpose, name, Box::new(answered));
    }

    /// Does what a file was chosen for.
    pub fn chosen(&mut self, purpose: &Purpose, path: &Path) {
        let saved = match purpose {
            Purpose::SavePicture => self.save_picture(path),
            #[cfg(not(target_family = "wasm"))]
            Purpose::Open => return self.open(path),
            #[cfg(not(target_family = "wasm"))]
            Purpose::SaveTurntable => return self.draw_turntable(path),
            #[cfg(not(target_family = "wasm"))]
            Purpose::SaveAsset => return self.save_asset(path),
            Purpose::SaveCamera => self.save_camera(path),
            #[cfg(not(target_family = "wasm"))]
            Purpose::SaveScene => match &self.document {
                Some(document) => {
                    scene_file::scene(path, document, &self.light, &self.orbit.camera())
                }
                None => Err(anyhow::anyhow!("there is no scene")),
            },
            #[cfg(target_family = "wasm")]
            Purpose::SaveAsset => self.save_asset(path),
            #[cfg(target_family = "wasm")]
            Purpose::Open => return,
        };
        match saved {
            Ok(()) => self.tell(format!("saved {}", path.display()), false),
            Err(error) => self.error(relight_bake::error::sentence(error.chain())),
        }
    }

    #[cfg_attr(
        target_family = "wasm",
        expect(
            clippy::unnecessary_wraps,
            reason = "elsewhere a file is written, which may fail"
        )
    )]
    fn save_camera(&self, path: &Path) -> anyhow::Result<()> {
        let text = camera_file::text(&self.orbit.camera());
        #[cfg(not(target_family = "wasm"))]
        relight_format::write_file(path, text.as_bytes())?;
        #[cfg(target_family = "wasm")]
        self.jobs.save(path, text.as_bytes());
        Ok(())
    }

    fn save_picture(&self, path: &Path) -> anyhow::Result<()> {
        let nothing = || anyhow::anyhow!("nothing is drawn yet");
        #[cfg(not(target_family = "wasm"))]
        if path
            .extension()
            .is_some_and(|ending| ending.eq_ignore_ascii_case("exr"))
        {
            let picture = self.pictures[0].as_ref().ok_or_else(nothing)?;
            return save::exr(path, &picture.image);
        }
        let (size, pixels) = self.composed.as_ref().ok_or_else(nothing)?;
        if *size != self.size {
            anyhow::bail!("the picture is not finished yet");
        }
        #[cfg(not(target_family = "wasm"))]
        return save::png(path, *size, pixels);
        #[cfg(target_family = "wasm")]
        self.jobs
            .save(path, &save::encode_png(*size, &[pixels], 0)?);
        #[cfg(target_family = "wasm")]
        Ok(())
    }

    #[cfg(target_family = "wasm")]
    fn save_asset(&self, path: &Path) -> anyhow::Result<()> {
        self.jobs.save(path, &self.asset()?);
        Ok(())
    }

    #[cfg(not(target_family = "wasm"))]
    fn save_asset(&mut self, path: &Path) {
        let Some(document) = &self.document else {
            return self.error("there is no scene");
        };
        let (scene, materials) = (document.scene.clone(), document.materials.clone());
        let path = path.to_owned();
        self.jobs
            .start(jobs::file_name(&path), Kind::Save, move |context| {
                context.monitor.step("write", 0.0)?;
                let mut scene = Arc::unwrap_or_clone(scene);
                scene.materials = materials.to_vec();
                let bytes = relight_format::write_scene(&scene)?;
                relight_format::write_file(&path, &bytes)?;
                (context.deliver)(Loaded::Saved(path.display().to_string()));
                Ok(())
            });
    }

    /// The scene with its edits, as an asset.
    #[cfg(target_family = "wasm")]
    pub fn asset(&self) -> anyhow::Result<Vec<u8>> {
        let document = self.document.as_ref();
        let document = document.ok_or_else(|| anyhow::anyhow!("there is no scene"))?;
        let mut scene = Scene::clone(&document.scene);
        scene.materials = document.materials.to_vec();
        Ok(relight_format::write_scene(&scene)?)
    }

    #[cfg(not(target_family = "wasm"))]
    fn draw_turntable(&mut self, folder: &Path) {
        let Some(shot) = self.shot(self.settings.integrators[0]) else {
            return self.error("there is no scene");
        };
        let (options, light, device) = (self.turntable.clone(), self.light.clone(), self.device);
        let look = Look {
            layout: Layout::One,
            ..self.look()
        };
        let folder = folder.to_owned();
        self.jobs.start("turntable", Kind::Save, move |context| {
            turntable::draw(&options, &shot, &light, &look, &folder, device, context)
        });
    }

    #[cfg(not(target_family = "wasm"))]
    pub(super) fn capture(&mut self) {
        let context = self.context.clone();
        match &self.capture {
            Some(Capture::Asked(done)) if done.try_recv().is_ok() => {
                self.capture = None;
                context.send_viewport_cmd(egui::ViewportCommand::Close);
            }
            Some(Capture::Waiting(path)) if self.is_settled() => {
                let (sender, done) = mpsc::channel();
                let path = path.clone();
                let wake = context.clone();
                context.request_screenshot(move |image| {
                    let size = image.size.map(|side| side as u32);
                    let pixels: Vec<u8> = image
                        .pixels
                        .iter()
                        .flat_map(egui::Color32::to_array)
                        .collect();
                    if let Err(error) = save::png(&path, size, &pixels) {
                        eprintln!("error: {}", relight_bake::error::sentence(error.chain()));
                    }
                    // The window may be gone.
                    let _ = sender.send(());
                    wake.request_repaint();
                });
                self.capture = Some(Capture::Asked(done));
            }
            Some(Capture::Waiting(_)) => context.request_repaint_after(Duration::from_millis(100)),
            None | Some(Capture::Asked(_)) => {}
        }
    }
}
