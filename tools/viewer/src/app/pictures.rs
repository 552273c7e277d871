//! When to ask for which pictures, and for their pixels.

use std::sync::Arc;
use std::time::Duration;

use glam::Quat;
use relight_format::{Camera, Material, Scene};
use relight_runtime::{Image, LocalLight, SphericalGaussian};
use relight_shading::catcher;
use web_time::Instant;

use super::Viewer;
use crate::compose::Look;
use crate::engine::{Request, Shot};
use crate::state::{Integrator, Layout, Light};

/// Everything that a picture depends on, to tell when one has to be drawn.
#[derive(Clone, PartialEq)]
pub(super) struct Wanted {
    pub(super) scene: *const Scene,
    pub(super) materials: *const Vec<Material>,
    pub(super) lights: *const SphericalGaussian,
    pub(super) image_reflections: bool,
    pub(super) bounce: bool,
    pub(super) camera: Camera,
    pub(super) rotation: Quat,
    pub(super) local_lights: Vec<LocalLight>,
    pub(super) integrators: Vec<Integrator>,
    pub(super) size: [u32; 2],
}

/// A request under way.
pub(super) struct Flight {
    pub(super) number: u64,
    pub(super) asked: Instant,
    /// Whether a picture of it is on the screen.
    pub(super) answered: bool,
    /// The first picture that came of each pane.
    pub(super) seen: [Option<First>; 2],
    pub(super) panes: usize,
}

/// The first picture of a pane that a request brought.
#[derive(Clone, Copy, Debug)]
pub struct First {
    /// Columns and rows.
    pub size: [u32; 2],
    /// By the cheapest means, whatever was asked for.
    pub draft: bool,
    /// Whether no better one follows.
    pub complete: bool,
}

/// How a request was answered.
#[derive(Clone, Copy, Debug)]
pub struct Answer {
    /// From asking to a picture on the screen.
    pub after: Duration,
    /// The first picture of each pane that had come by then.
    pub first: [Option<First>; 2],
    /// Columns and rows of what was composed.
    pub composed: [u32; 2],
    /// And of the largest picture in it.
    pub shown: [u32; 2],
}

/// What to compose.
pub(super) struct Composition {
    /// The newest request that a picture of it answers.
    pub(super) request: u64,
    pub(super) images: [Option<Arc<Image>>; 2],
    pub(super) look: Look,
    pub(super) light: Light,
    pub(super) camera: Camera,
    pub(super) rotation: Quat,
    pub(super) size: [u32; 2],
}

/// What the composer makes.
pub(super) struct Composed {
    pub(super) request: u64,
    pub(super) size: [u32; 2],
    /// The largest picture in it.
    pub(super) shown: [u32; 2],
    /// Premultiplied RGBA8.
    pub(super) pixels: Vec<u8>,
}

#[derive(Clone, PartialEq)]
pub(super) struct ComposedKey {
    pub(super) images: [Option<*const Image>; 2],
    pub(super) look: Look,
    pub(super) lights: *const SphericalGaussian,
    pub(super) size: [u32; 2],
}

impl Viewer {
    /// What pictures are wanted of, in the order of the panes.
    pub fn integrators(&self) -> Vec<Integrator> {
        match self.settings.layout {
            Layout::One => vec![self.settings.integrators[0]],
            Layout::Split | Layout::Difference => self.settings.integrators.to_vec(),
        }
    }

    /// What the first picture shows.
    pub fn shot(&self, integrator: Integrator) -> Option<Shot> {
        let document = self.document.as_ref()?;
        let reflections = self.settings.image_reflections && integrator != Integrator::Truth;
        let direct = (self.direct.as_ref())
            .filter(|(of, _)| !self.settings.bounce && Arc::ptr_eq(of, &document.scene));
        Some(Shot {
            scene: direct.map_or(&document.scene, |(_, direct)| direct).clone(),
            materials: document.materials.clone(),
            camera: self.orbit.camera(),
            lights: self.light.lobes.clone(),
            reflections: self.light.prefiltered.clone().filter(|_| reflections),
            sources: self.light.sources.clone(),
            rotation: self.turn.rotation(),
            local_lights: document.local_lights.clone(),
            integrator,
        })
    }

    /// Keeps a copy of the scene that nothing bounces in, where one is asked for.
    fn keep_direct(&mut self) {
        let Some(document) = &self.document else {
            return;
        };
        let scene = &document.scene;
        let kept = (self.direct.as_ref()).is_some_and(|(of, _)| Arc::ptr_eq(of, scene));
        if !self.settings.bounce && scene.transfer.is_some() && !kept {
            let mut direct = Scene::clone(scene);
            direct.transfer = None;
            self.direct = Some((scene.clone(), direct.into()));
        }
    }

    pub(super) fn ask_for_pictures(&mut self) {
        self.keep_direct();
        let Some(document) = &self.document else {
            return;
        };
        if self.size.contains(&0) {
            return;
        }
        let integrators = self.integrators();
        let wanted = Wanted {
            scene: Arc::as_ptr(&document.scene),
            materials: Arc::as_ptr(&document.materials),
            lights: self.light.lobes.as_ptr(),
            image_reflections: self.settings.image_reflections,
            bounce: self.settings.bounce,
            camera: self.orbit.camera(),
            rotation: self.turn.rotation(),
            local_lights: document.local_lights.clone(),
            integrators: integrators.clone(),
            size: self.size,
        };
        // Whoever drags sees the coarse pictures of a request before the next one replaces it.
        let waiting = (self.flight.as_ref())
            .is_some_and(|flight| flight.seen[..flight.panes].iter().any(Option::is_none));
        if waiting || self.wanted.as_ref() == Some(&wanted) {
            return;
        }
        let shots: Vec<_> = integrators.iter().filter_map(|i| self.shot(*i)).collect();
        let panes = shots.len();
        let number = self.engine.request(Request {
            shots,
            size: self.size,
            progressive: true,
        });
        self.flight = Some(Flight {
            number,
            asked: Instant::now(),
            answered: false,
            seen: [None; 2],
            panes,
        });
        self.wanted = Some(wanted);
    }

    pub(super) fn ask_for_pixels(&mut self) {
        let Some(newest) = &self.pictures[0] else {
            return;
        };
        let images = [0, 1]
            .map(|pane: usize| (self.pictures[pane].as_ref()).map(|picture| picture.image.clone()));
        let images = match self.settings.layout {
            Layout::One => [images[0].clone(), None],
            Layout::Split | Layout::Difference => images,
        };
        let look = self.look();
        // No larger than what there is to see: whoever drags waits for it.
        let size = [0, 1].map(|side: usize| {
            let sides = (images.iter().flatten()).map(|image| [image.width, image.height][side]);
            sides.max().unwrap_or(1).min(self.size[side])
        });
        let key = ComposedKey {
            images: [0, 1].map(|pane: usize| images[pane].as_ref().map(Arc::as_ptr)),
            look,
            lights: self.light.lobes.as_ptr(),
            size,
        };
        if self.composing.as_ref() == Some(&key) || self.size.contains(&0) {
            return;
        }
        self.composer.ask(Composition {
            request: newest.request,
            images,
            look,
            light: self.light.clone(),
            camera: newest.camera,
            rotation: newest.rotation,
            size,
        });
        self.composing = Some(key);
    }

    /// How pictures are shown.
    pub(super) fn look(&self) -> Look {
        let document = self.document.as_ref();
        Look {
            catches: document.is_some_and(|document| catcher::catches(&document.materials)),
            ..Look::from(&self.settings)
        }
    }

    /// Whether nothing is under way: the window shows the best there is.
    pub fn is_settled(&self) -> bool {
        let panes = self.integrators().len();
        let newest = self.flight.as_ref().map(|flight| flight.number);
        let complete = |pane: usize| {
            self.pictures[pane].as_ref().is_some_and(|picture| {
                let traced = self.settings.integrators[pane] == Integrator::Truth;
                Some(picture.request) == newest
                    && (picture.complete || (traced && picture.samples > 8))
            })
        };
        self.jobs.running().is_empty() && (0..panes).all(complete) && !self.composer.is_busy()
    }

    /// What is on the screen: size and premultiplied RGBA8.
    pub fn screen(&self) -> Option<&([u32; 2], Vec<u8>)> {
        self.composed.as_ref()
    }
}
