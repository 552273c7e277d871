//! Takes what threads, workers and dialogs have made.

use super::Viewer;
use super::pictures::{Answer, Composed, First};
use crate::engine::{self, Picture};
use crate::jobs::{self, Loaded};
use crate::state::Document;

impl Viewer {
    /// Takes what threads have made.
    pub fn receive(&mut self) {
        #[cfg(not(target_family = "wasm"))]
        let events = self.jobs.events();
        #[cfg(target_family = "wasm")]
        let events = self.jobs.events(self.settings.lobes);
        for event in events {
            match event {
                jobs::Event::Failed(error) => self.error(error),
                jobs::Event::Loaded(loaded) => self.take(*loaded),
            }
        }
        let events: Vec<_> = self.engine.events().collect();
        for event in events {
            match event {
                engine::Event::Device(name) => self.device_name = name,
                engine::Event::Failed(error) => {
                    self.flight = None;
                    self.error(error);
                }
                engine::Event::Picture(picture) => self.take_picture(picture),
            }
        }
        let choices: Vec<_> = self.choices.1.try_iter().collect();
        for (purpose, path) in choices {
            self.chosen(&purpose, &path);
        }
        if let Some(composed) = self.composer.newest() {
            self.take_composed(composed);
        }
    }

    fn take_picture(&mut self, picture: Picture) {
        if let Some(flight) = &mut self.flight
            && flight.number == picture.request
        {
            flight.seen[picture.pane].get_or_insert(First {
                size: [picture.image.width, picture.image.height],
                draft: picture.draft,
                complete: picture.complete,
            });
        }
        let pane = picture.pane;
        self.pictures[pane] = Some(picture);
    }

    fn take_composed(&mut self, composed: Composed) {
        let Composed {
            request,
            size,
            shown,
            pixels,
        } = composed;
        if let Some(flight) = &mut self.flight
            && flight.number == request
            && !flight.answered
        {
            flight.answered = true;
            self.answers.push(Answer {
                after: flight.asked.elapsed(),
                first: flight.seen,
                composed: size,
                shown,
            });
            let surplus = self.answers.len().saturating_sub(100);
            self.answers.drain(..surplus);
        }
        let image =
            egui::ColorImage::from_rgba_premultiplied(size.map(|side| side as usize), &pixels);
        let options = egui::TextureOptions::LINEAR;
        match &mut self.texture {
            Some(texture) => texture.set(image, options),
            empty => *empty = Some(self.context.load_texture("picture", image, options)),
        }
        self.composed = Some((size, pixels));
    }

    /// Takes what a job has made.
    fn take(&mut self, loaded: Loaded) {
        match loaded {
            #[cfg_attr(
                target_family = "wasm",
                expect(
                    unused_variables,
                    reason = "pages neither watch files nor load them by name"
                )
            )]
            Loaded::Scene {
                scene,
                source,
                quality,
                lights,
                environment,
                files,
                warnings,
            } => {
                for warning in warnings {
                    self.tell(format!("{}: {warning}", scene.name), false);
                }
                #[cfg(not(target_family = "wasm"))]
                self.watch[0].set(&files);
                // A page opens nothing but what somebody chose.
                let fresh = self.fresh || cfg!(target_family = "wasm");
                if fresh || self.document.is_none() {
                    self.fresh = false;
                    let document = Document::new(scene, source, quality, lights);
                    self.orbit = document.camera();
                    self.document = Some(document);
                    #[cfg(not(target_family = "wasm"))]
                    if let Some(environment) = environment
                        && self.light.source.as_ref() != Some(&environment)
                        && !self.is_loading_named_light()
                    {
                        self.load_light(&environment);
                    }
                } else if let Some(document) = &mut self.document {
                    document.improve(scene, quality, source);
                    self.inspection = None;
                }
            }
            Loaded::Light(mut light) => {
                #[cfg(not(target_family = "wasm"))]
                self.watch[1].set(light.source.as_slice());
                light.keep_image(&self.light);
                self.light = light;
            }
            Loaded::Material {
                source,
                surface,
                textures,
            } => {
                let name = source.display().to_string();
                let taken = (self.document.as_mut())
                    .is_some_and(|document| document.replace_selected(source, surface, textures));
                if !taken {
                    self.error(format!(
                        "{name}: click the surface that it is for, then open it again"
                    ));
                }
            }
            Loaded::Saved(what) => self.tell(format!("saved {what}"), false),
        }
    }
}
