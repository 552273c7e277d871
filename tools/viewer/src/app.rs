//! The application: state, what goes on in the background, and when to ask for what.

use std::path::{Path, PathBuf};
use std::sync::{Arc, mpsc};
use std::time::Duration;

use glam::Quat;
use relight_format::{Camera, Material, Scene};
#[cfg(target_family = "wasm")]
use relight_runtime::wgpu;
use relight_runtime::{Image, LocalLight, SphericalGaussian};
use relight_shading::ssdf::Basis;
use web_time::Instant;

use crate::compose::{self, Look, Sky};
use crate::composer::Worker;
#[cfg(not(target_family = "wasm"))]
use crate::engine::Device;
use crate::engine::{self, Engine, Picture, Request, Shot};
use crate::inspect::{self, Inspection};
use crate::jobs::{self, Jobs, Loaded};
#[cfg(not(target_family = "wasm"))]
use crate::jobs::{FileKind, Kind};
use crate::orbit::Orbit;
#[cfg(not(target_family = "wasm"))]
use crate::scene_file;
use crate::state::{Document, Integrator, Layout, Light, LightTurn, Settings};
#[cfg(not(target_family = "wasm"))]
use crate::turntable::{self, Turntable};
#[cfg(not(target_family = "wasm"))]
use crate::watch::{self, Watch};
use crate::{dialog, panels, save, settings, viewport};

/// Messages that are kept.
const MOST_MESSAGES: usize = 50;
/// Texels per side of the inspector's map.
const INSPECTION_SIDE: u32 = 160;

/// How the application starts in a page.
#[cfg(target_family = "wasm")]
pub struct Start {
    /// In place of the default ones.
    pub settings: Option<Settings>,
    /// What the page does for it.
    pub hooks: crate::page::Hooks,
    /// What the page tells it.
    pub inbox: jobs::Inbox,
    /// What draws the window, and the pictures.
    pub graphics: (wgpu::Device, wgpu::Queue),
}

/// How the application starts.
#[cfg(not(target_family = "wasm"))]
#[derive(Clone, Debug, Default)]
pub struct Start {
    /// What to open, in this order; without a scene among them the built-in one is shown.
    pub files: Vec<PathBuf>,
    /// Where to draw.
    pub device: Device,
    /// In place of the default ones.
    pub settings: Option<Settings>,
    /// Write a picture of the whole window here once nothing is under way, and end.
    pub capture: Option<PathBuf>,
}

/// A picture of the window: waited for, asked for, or there.
#[cfg(not(target_family = "wasm"))]
enum Capture {
    Waiting(PathBuf),
    Asked(mpsc::Receiver<()>),
}

/// Something to tell.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Message {
    /// For people.
    pub text: String,
    /// Whether something went wrong.
    pub is_error: bool,
}

/// What a file that was chosen in a dialog is for.
#[derive(Clone, Debug)]
pub enum Purpose {
    /// To be opened.
    Open,
    /// For the picture, as PNG or OpenEXR by its ending.
    SavePicture,
    /// For the camera.
    #[cfg(not(target_family = "wasm"))]
    SaveCamera,
    /// For a scene file.
    #[cfg(not(target_family = "wasm"))]
    SaveScene,
    /// For the baked scene.
    SaveAsset,
    /// A folder for a turntable.
    #[cfg(not(target_family = "wasm"))]
    SaveTurntable,
}

/// Everything that a picture depends on, to tell when one has to be drawn.
#[derive(Clone, PartialEq)]
struct Wanted {
    scene: *const Scene,
    materials: *const Vec<Material>,
    lights: *const SphericalGaussian,
    image_reflections: bool,
    bounce: bool,
    camera: Camera,
    rotation: Quat,
    local_lights: Vec<LocalLight>,
    integrators: Vec<Integrator>,
    size: [u32; 2],
}

/// A request under way.
struct Flight {
    number: u64,
    asked: Instant,
    /// Whether a picture of it is on the screen.
    answered: bool,
    /// The first picture that came of each pane.
    seen: [Option<First>; 2],
    panes: usize,
}

/// The first picture of a pane that a request brought.
#[derive(Clone, Copy, Debug)]
pub struct First {
    /// Columns and rows.
    pub size: [u32; 2],
    /// By the cheapest means, whatever was asked for.
    pub draft: bool,
}

/// How a request was answered.
#[derive(Clone, Copy, Debug)]
pub struct Answer {
    /// From asking to a picture on the screen.
    pub after: Duration,
    /// The first picture of each pane that had come by then.
    pub first: [Option<First>; 2],
}

/// What to compose.
struct Composition {
    /// The newest request that a picture of it answers.
    request: u64,
    images: [Option<Arc<Image>>; 2],
    look: Look,
    light: Light,
    camera: Camera,
    rotation: Quat,
    size: [u32; 2],
}

/// What the composer makes.
struct Composed {
    request: u64,
    size: [u32; 2],
    /// Premultiplied RGBA8.
    pixels: Vec<u8>,
}

#[derive(Clone, PartialEq)]
struct ComposedKey {
    images: [Option<*const Image>; 2],
    look: Look,
    lights: *const SphericalGaussian,
    size: [u32; 2],
}

/// A file and what it was chosen for.
type Choice = (Purpose, PathBuf);
/// Asks for a file, for a purpose and a scene of this name; the answer may come at any time.
pub type Dialog = Box<dyn Fn(&Purpose, &str, dialog::Answer)>;

/// The application.
#[expect(
    clippy::struct_excessive_bools,
    reason = "switches that do not depend on each other"
)]
pub struct Viewer {
    /// Remembered.
    pub settings: Settings,
    /// The scene, once there is one.
    pub document: Option<Document>,
    /// Distant light.
    pub light: Light,
    /// How far it is turned.
    pub turn: LightTurn,
    /// Whether it turns by itself.
    pub playing: bool,
    /// The camera.
    pub orbit: Orbit,
    /// What goes on in the background.
    pub jobs: Jobs,
    /// What there is to tell, oldest first.
    pub messages: Vec<Message>,
    /// Newest pictures.
    pub pictures: [Option<Picture>; 2],
    /// Whether clicks look at visibility.
    pub inspecting: bool,
    /// Whether the inspector's section opens with the next frame.
    pub reveal_inspector: bool,
    /// What the inspector shows.
    pub inspection: Option<(Inspection, egui::TextureHandle)>,
    /// Turntable to draw.
    #[cfg(not(target_family = "wasm"))]
    pub turntable: Turntable,
    /// Text of the path to open.
    pub path: String,
    /// Name of the device that draws.
    pub device_name: String,
    /// How the last requests were answered.
    pub answers: Vec<Answer>,
    /// Asks for files: the system's own dialogs.
    pub dialog: Dialog,
    pub(crate) texture: Option<egui::TextureHandle>,
    pub(crate) size: [u32; 2],
    #[cfg(not(target_family = "wasm"))]
    device: Device,
    engine: Engine,
    wanted: Option<Wanted>,
    flight: Option<Flight>,
    composer: Worker<Composition, Composed>,
    composing: Option<ComposedKey>,
    composed: Option<([u32; 2], Vec<u8>)>,
    waiting_for_composer: bool,
    basis: Option<(Arc<Scene>, Basis)>,
    /// A scene and its copy without light that bounces.
    direct: Option<(Arc<Scene>, Arc<Scene>)>,
    choices: (mpsc::Sender<Choice>, mpsc::Receiver<Choice>),
    #[cfg(not(target_family = "wasm"))]
    watch: [Watch; 2],
    /// Whether the next scene to come brings its own camera and light.
    fresh: bool,
    #[cfg(not(target_family = "wasm"))]
    capture: Option<Capture>,
    /// As they were kept last.
    #[cfg(target_family = "wasm")]
    kept_settings: Settings,
    context: egui::Context,
}

impl Viewer {
    /// Everything as it is before the first file.
    fn empty(
        context: &egui::Context,
        settings: Option<Settings>,
        engine: Engine,
        jobs: Jobs,
        dialog: Dialog,
    ) -> Self {
        let wake = || {
            let context = context.clone();
            move || context.request_repaint()
        };
        let compose = |task: Composition| {
            let sky = Sky {
                panorama: task.light.panorama.as_ref(),
                rotation: task.rotation,
            };
            let images = [0, 1].map(|i: usize| task.images[i].as_deref());
            let pixels = compose::compose(images, &task.look, &sky, &task.camera, task.size);
            Composed {
                request: task.request,
                size: task.size,
                pixels,
            }
        };
        let settings = settings.unwrap_or_default();
        Self {
            settings,
            document: None,
            light: Light::default(),
            turn: LightTurn::default(),
            playing: false,
            orbit: Orbit::new(&Camera {
                position: [0.0, 0.0, 1.0],
                target: [0.0; 3],
                up: [0.0, 1.0, 0.0],
                field_of_view: relight_format::FieldOfView::Y(0.7),
            }),
            jobs,
            messages: Vec::new(),
            pictures: [None, None],
            inspecting: false,
            reveal_inspector: false,
            inspection: None,
            #[cfg(not(target_family = "wasm"))]
            turntable: Turntable::default(),
            path: String::new(),
            device_name: String::new(),
            answers: Vec::new(),
            dialog,
            texture: None,
            size: [0; 2],
            #[cfg(not(target_family = "wasm"))]
            device: Device::default(),
            engine,
            wanted: None,
            flight: None,
            composer: Worker::new("composer", compose, wake()),
            composing: None,
            composed: None,
            waiting_for_composer: false,
            basis: None,
            direct: None,
            choices: mpsc::channel(),
            #[cfg(not(target_family = "wasm"))]
            watch: Default::default(),
            fresh: true,
            #[cfg(not(target_family = "wasm"))]
            capture: None,
            #[cfg(target_family = "wasm")]
            kept_settings: settings,
            context: context.clone(),
        }
    }

    /// Starts the threads and the first jobs.
    #[cfg(not(target_family = "wasm"))]
    pub fn new(context: &egui::Context, start: &Start) -> Self {
        let wake = || {
            let context = context.clone();
            move || context.request_repaint()
        };
        let engine = Engine::new(start.device, wake());
        let dialog = Box::new(dialog::of_the_system);
        let jobs = Jobs::new(wake());
        let mut viewer = Self::empty(context, start.settings, engine, jobs, dialog);
        viewer.device = start.device;
        viewer.capture = start.capture.clone().map(Capture::Waiting);
        for file in &start.files {
            viewer.open(file);
        }
        let started =
            |viewer: &Self, kind| viewer.jobs.running().iter().any(|job| job.kind == kind);
        if !started(&viewer, Kind::Light) {
            let lobes = viewer.settings.lobes;
            viewer
                .jobs
                .start("built-in light", Kind::Light, move |context| {
                    jobs::built_in_light(&jobs::fit_stages_to(lobes), context)
                });
        }
        if !started(&viewer, Kind::Scene) {
            viewer.open_built_in();
        }
        viewer
    }

    /// Starts under a plain sky; the page's files come in by its messages.
    #[cfg(target_family = "wasm")]
    pub fn new(context: &egui::Context, start: Start) -> Result<Self, relight_runtime::Error> {
        let wake = context.clone();
        let (device, queue) = &start.graphics;
        let engine = Engine::new(device, queue, move || wake.request_repaint())?;
        let jobs = Jobs::new(start.hooks.clone(), start.inbox);
        let dialog = dialog::of_the_page(start.hooks);
        let mut viewer = Self::empty(context, start.settings, engine, jobs, dialog);
        let sky = relight_embed::plain_sky();
        viewer.light = Light::new("plain sky".into(), None, sky, None);
        viewer.device_name = "WebGPU".into();
        Ok(viewer)
    }

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
    fn load_light(&mut self, path: &Path) {
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

    /// Fits the image again, with as many lobes as are asked for now.
    #[cfg(target_family = "wasm")]
    pub fn fit_again(&mut self) {
        if !self.jobs.fit_again(self.settings.lobes) {
            self.error("drop an image (.hdr, .exr) first");
        }
    }

    /// Tells something that went wrong.
    pub fn error(&mut self, text: impl Into<String>) {
        self.tell(text.into(), true);
    }

    fn tell(&mut self, text: String, is_error: bool) {
        let message = Message { text, is_error };
        if self.messages.last() != Some(&message) {
            self.messages.push(message);
        }
        let surplus = self.messages.len().saturating_sub(MOST_MESSAGES);
        self.messages.drain(..surplus);
    }

    /// One frame: takes what has come, draws the window, and asks for what is missing.
    pub fn show(&mut self, ui: &mut egui::Ui) {
        self.receive();
        self.take_dropped(ui);
        #[cfg(not(target_family = "wasm"))]
        self.follow_files();
        if self.playing {
            let step = ui.input(|input| input.stable_dt).min(0.1);
            self.turn.yaw = (self.turn.yaw + step * self.settings.light_speed)
                .rem_euclid(std::f32::consts::TAU);
            ui.ctx().request_repaint();
        }
        panels::show(ui, self);
        viewport::show(ui, self);
        self.ask_for_pictures();
        self.ask_for_pixels();
        #[cfg(not(target_family = "wasm"))]
        self.capture();
        #[cfg(target_family = "wasm")]
        if self.kept_settings != self.settings && !ui.input(|input| input.pointer.any_down()) {
            // Nobody tells a page that it ends.
            self.kept_settings = self.settings;
            settings::write(&self.settings);
        }
    }

    #[cfg(not(target_family = "wasm"))]
    fn capture(&mut self) {
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
                        eprintln!("error: {error:#}");
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

    fn take_dropped(&mut self, ui: &egui::Ui) {
        let dropped = ui.input(|input| input.raw.dropped_files.clone());
        for file in dropped {
            #[cfg(not(target_family = "wasm"))]
            self.open(file.path());
            #[cfg(target_family = "wasm")]
            crate::page::take_dropped(file, self.jobs.inbox(), &self.context);
        }
    }

    #[cfg(not(target_family = "wasm"))]
    fn follow_files(&mut self) {
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
        if let Some(Composed {
            request,
            size,
            pixels,
        }) = self.composer.newest()
        {
            self.waiting_for_composer = false;
            if let Some(flight) = &mut self.flight
                && flight.number == request
                && !flight.answered
            {
                flight.answered = true;
                self.answers.push(Answer {
                    after: flight.asked.elapsed(),
                    first: flight.seen,
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
    }

    fn take_picture(&mut self, picture: Picture) {
        if let Some(flight) = &mut self.flight
            && flight.number == picture.request
        {
            flight.seen[picture.pane].get_or_insert(First {
                size: [picture.image.width, picture.image.height],
                draft: picture.draft,
            });
        }
        let pane = picture.pane;
        self.pictures[pane] = Some(picture);
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
            Loaded::Light(light) => {
                #[cfg(not(target_family = "wasm"))]
                self.watch[1].set(light.source.as_slice());
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

    /// Whether a light that somebody named is still being loaded.
    #[cfg(not(target_family = "wasm"))]
    fn is_loading_named_light(&self) -> bool {
        (self.jobs.running().iter())
            .any(|job| job.kind == Kind::Light && job.name != "built-in light")
    }

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

    fn ask_for_pictures(&mut self) {
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

    fn ask_for_pixels(&mut self) {
        let Some(newest) = &self.pictures[0] else {
            return;
        };
        let images = [0, 1]
            .map(|pane: usize| (self.pictures[pane].as_ref()).map(|picture| picture.image.clone()));
        let images = match self.settings.layout {
            Layout::One => [images[0].clone(), None],
            Layout::Split | Layout::Difference => images,
        };
        let look = Look::from(&self.settings);
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
        self.waiting_for_composer = true;
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
        self.jobs.running().is_empty() && (0..panes).all(complete) && !self.waiting_for_composer
    }

    /// What is on the screen: size and premultiplied RGBA8.
    pub fn screen(&self) -> Option<&([u32; 2], Vec<u8>)> {
        self.composed.as_ref()
    }

    /// Whether clicks look at visibility from now on; its section opens when they do.
    pub fn set_inspecting(&mut self, inspecting: bool) {
        self.inspecting = inspecting;
        self.reveal_inspector = inspecting;
    }

    /// Looks at the visibility of the point that was clicked.
    pub fn inspect(&mut self) {
        let Some(document) = &self.document else {
            return;
        };
        let Some(hit) = document.inspected else {
            self.inspection = None;
            return;
        };
        let scene = &document.scene;
        if !self
            .basis
            .as_ref()
            .is_some_and(|(known, _)| Arc::ptr_eq(known, scene))
        {
            self.basis = Some((scene.clone(), Basis::new(scene)));
        }
        let Some((_, basis)) = &self.basis else {
            return;
        };
        let rotation = glam::Mat3::from_quat(self.turn.rotation());
        let lights: Vec<_> = self
            .light
            .lobes
            .iter()
            .map(|light| light.rotate(&rotation))
            .collect();
        let inspection = inspect::inspect(scene, basis, &hit, &lights, INSPECTION_SIDE);
        let pixels = inspect::picture(&inspection);
        let image =
            egui::ColorImage::from_rgba_premultiplied([INSPECTION_SIDE as usize; 2], &pixels);
        let texture = self
            .context
            .load_texture("inspection", image, egui::TextureOptions::LINEAR);
        self.inspection = Some((inspection, texture));
    }

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
            #[cfg(not(target_family = "wasm"))]
            Purpose::SaveCamera => scene_file::camera(path, &self.orbit.camera()),
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
            Err(error) => self.error(format!("{error:#}")),
        }
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

    #[cfg(not(target_family = "wasm"))]
    fn draw_turntable(&mut self, folder: &Path) {
        let Some(shot) = self.shot(self.settings.integrators[0]) else {
            return self.error("there is no scene");
        };
        let (options, light, device) = (self.turntable.clone(), self.light.clone(), self.device);
        let look = Look {
            layout: Layout::One,
            ..Look::from(&self.settings)
        };
        let folder = folder.to_owned();
        self.jobs.start("turntable", Kind::Save, move |context| {
            turntable::draw(&options, &shot, &light, &look, &folder, device, context)
        });
    }
}

impl eframe::App for Viewer {
    fn ui(&mut self, ui: &mut egui::Ui, _frame: &mut eframe::Frame) {
        self.show(ui);
    }

    #[cfg(not(target_family = "wasm"))]
    fn on_exit(&mut self) {
        settings::write(&self.settings);
    }

    #[cfg(target_family = "wasm")]
    fn as_any_mut(&mut self) -> Option<&mut dyn std::any::Any> {
        Some(self)
    }
}
