//! The application: its state, its start, and what goes on between its frames.

mod inspecting;
mod open;
mod pictures;
mod receive;
mod saving;

use std::path::PathBuf;
use std::sync::{Arc, mpsc};

use relight_format::{Camera, Scene};
#[cfg(target_family = "wasm")]
use relight_runtime::wgpu;
use relight_shading::ssdf::Basis;

use crate::compose::{self, Sky};
use crate::composer::Worker;
use crate::dialog::{self, Dialog, Purpose};
#[cfg(not(target_family = "wasm"))]
use crate::engine::Device;
use crate::engine::{Engine, Picture};
use crate::inspect::Inspection;
#[cfg(not(target_family = "wasm"))]
use crate::jobs::Kind;
use crate::jobs::{self, Jobs};
use crate::orbit::Orbit;
use crate::state::{Document, Light, LightTurn, Settings};
#[cfg(not(target_family = "wasm"))]
use crate::turntable::Turntable;
#[cfg(not(target_family = "wasm"))]
use crate::watch::Watch;

pub use pictures::{Answer, First};
use pictures::{Composed, ComposedKey, Composition, Flight, Wanted};
#[cfg(not(target_family = "wasm"))]
use saving::Capture;

/// Messages that are kept.
const MOST_MESSAGES: usize = 50;

/// How the application starts in a page.
#[cfg(target_family = "wasm")]
pub struct Start {
    /// In place of the default ones.
    pub settings: Option<Settings>,
    /// What the page does for it.
    pub hooks: crate::browser::Hooks,
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

/// Something to tell.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Message {
    /// For people.
    pub text: String,
    /// Whether something went wrong.
    pub is_error: bool,
}

/// A file and what it was chosen for.
type Choice = (Purpose, PathBuf);

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
        // Threads that draw the next picture take nothing from outside before it is done.
        #[cfg(not(target_family = "wasm"))]
        let threads = rayon::ThreadPoolBuilder::new().build().ok();
        let compose = move |task: Composition| {
            let sky = Sky {
                panorama: task.light.panorama.as_ref(),
                rotation: task.rotation,
            };
            let images = [0, 1].map(|i: usize| task.images[i].as_deref());
            let work = || compose::compose(images, &task.look, &sky, &task.camera, task.size);
            #[cfg(not(target_family = "wasm"))]
            let pixels = match &threads {
                Some(threads) => threads.install(work),
                None => work(),
            };
            #[cfg(target_family = "wasm")]
            let pixels = work();
            let images = task.images.iter().flatten();
            let sizes = images.map(|image| [image.width, image.height]);
            Composed {
                request: task.request,
                size: task.size,
                shown: sizes.max_by_key(|[x, y]| x * y).unwrap_or_default(),
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

    /// Before a frame: takes what has come.
    pub(crate) fn take_what_has_come(&mut self, ui: &egui::Ui) {
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
    }

    /// After a frame: asks for what is missing.
    pub(crate) fn ask_for_what_is_missing(&mut self) {
        self.ask_for_pictures();
        self.ask_for_pixels();
        #[cfg(not(target_family = "wasm"))]
        self.capture();
    }

    /// Keeps settings that changed: nobody tells a page that it ends.
    #[cfg(target_family = "wasm")]
    pub(crate) fn keep_settings(&mut self) {
        if self.kept_settings != self.settings {
            self.kept_settings = self.settings;
            crate::settings::write(&self.settings);
        }
    }
}
