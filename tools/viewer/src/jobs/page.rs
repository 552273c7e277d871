//! Jobs of a page: what it is given is read at once, fits go on in workers that the page starts.

use std::cell::RefCell;
use std::path::{Path, PathBuf};
use std::rc::Rc;
use std::sync::Arc;

use anyhow::Context as _;
use relight_format::{self as format, Limits};
use relight_runtime::Panorama;
use web_time::Instant;

use super::{
    Event, FileKind, Kind, Loaded, Plan, Status, Tracker, fit_plan, fit_stages_to, surface_of,
};
use crate::browser::{Hooks, console_error};
use crate::state::Light;

/// What the page tells the application.
pub enum Message {
    /// A file that was dropped, chosen or fetched.
    Open {
        /// Without folders.
        name: String,
        /// All of it.
        bytes: Vec<u8>,
    },
    /// The page fetches something, as a job of its number.
    Fetching {
        /// The page's.
        number: u32,
        /// For people.
        name: String,
    },
    /// How far a job is.
    Progress {
        /// Which.
        number: u32,
        /// Name of the stage.
        stage: &'static str,
        /// Of it, in [0, 1].
        fraction: f32,
    },
    /// A worker fitted an image.
    Light {
        /// Which job.
        number: u32,
        /// An environment asset.
        asset: Vec<u8>,
        /// The image, as it is shown.
        image: Option<Panorama>,
    },
    /// A worker fitted a table.
    Material {
        /// Which job.
        number: u32,
        /// A material asset.
        asset: Vec<u8>,
    },
    /// A job ended, for the reason told if it failed.
    Ended {
        /// Which.
        number: u32,
        /// For people.
        error: Option<String>,
    },
}

/// What came from the page since it was looked at last.
pub type Inbox = Rc<RefCell<Vec<Message>>>;

/// Something that goes on in the background.
pub struct Job {
    /// For people.
    pub name: String,
    /// Jobs of one kind replace each other.
    pub kind: Kind,
    number: u32,
    tracker: Tracker,
    hooks: Hooks,
}

impl Job {
    /// How far it is.
    pub fn status(&self) -> Status {
        self.tracker.status(self.tracker.since.elapsed())
    }

    /// Ends it.
    pub fn cancel(&self) {
        self.hooks.cancel(self.number);
    }
}

/// Everything in the background.
pub struct Jobs {
    running: Vec<Job>,
    events: Vec<Event>,
    inbox: Inbox,
    hooks: Hooks,
    /// Numbers of workers; the page's own count from above.
    next: u32,
    /// The image that was fitted last.
    image: Option<(String, Vec<u8>)>,
}

impl Jobs {
    /// Takes what the page puts into `inbox`.
    pub fn new(hooks: Hooks, inbox: Inbox) -> Self {
        Self {
            running: Vec::new(),
            events: Vec::new(),
            inbox,
            hooks,
            next: 0,
            image: None,
        }
    }

    /// Those that run.
    pub fn running(&self) -> &[Job] {
        &self.running
    }

    /// Where messages of the page go.
    pub fn inbox(&self) -> Inbox {
        self.inbox.clone()
    }

    /// Offers a file to whoever looks at the page.
    pub fn save(&self, path: &Path, bytes: &[u8]) {
        self.hooks.save(&super::file_name(path), bytes);
    }

    /// Reads a file, or has it fitted with so many lobes.
    pub fn open(&mut self, name: String, bytes: Vec<u8>, lobes: usize) {
        let path = PathBuf::from(&name);
        let is_asset = (path.extension()).is_some_and(|end| end.eq_ignore_ascii_case("relight"));
        let kind = FileKind::of(&path, || bytes.clone());
        match kind {
            Some(kind) if is_asset => match read_asset(kind, &path, &bytes) {
                Ok(loaded) => {
                    if kind == FileKind::Light {
                        self.cancel(Kind::Light);
                    }
                    self.events.push(Event::Loaded(Box::new(loaded)));
                }
                Err(error) => self.fail(format!(
                    "{name}: {}",
                    relight_bake::error::sentence(error.chain())
                )),
            },
            Some(FileKind::Light) => {
                self.image = Some((name, bytes));
                self.fit_again(lobes);
            }
            Some(FileKind::Material) => {
                let plan = vec![("fit lobes", 1.0)];
                self.start(Kind::Material, plan, name, |hooks, number, name| {
                    hooks.fit(number, "material", name, bytes, 0);
                });
            }
            Some(FileKind::Scene) => self.fail(format!(
                "{name}: a mesh, whose visibility has to be baked first: `bake scene {name} -o \
                 scene.relight`"
            )),
            None => self.fail(format!(
                "{name}: expected an asset (.relight), an image (.hdr, .exr) or a BRDF (.bsdf, \
                 .binary)"
            )),
        }
    }

    /// Fits the last image; `false` where there is none.
    pub fn fit_again(&mut self, lobes: usize) -> bool {
        let Some((name, bytes)) = self.image.clone() else {
            return false;
        };
        let plan = fit_plan(&fit_stages_to(lobes));
        self.start(Kind::Light, plan, name, |hooks, number, name| {
            hooks.fit(number, "light", name, bytes, lobes as u32);
        });
        true
    }

    fn start(
        &mut self,
        kind: Kind,
        plan: Plan,
        name: String,
        begin: impl FnOnce(&Hooks, u32, &str),
    ) {
        self.cancel(kind);
        self.next += 1;
        begin(&self.hooks, self.next, &name);
        self.push(self.next, kind, name, plan);
    }

    fn push(&mut self, number: u32, kind: Kind, name: String, plan: Plan) {
        let mut tracker = Tracker::new(Instant::now());
        tracker.plan = plan;
        self.running.push(Job {
            name,
            kind,
            number,
            tracker,
            hooks: self.hooks.clone(),
        });
    }

    fn fail(&mut self, error: String) {
        self.events.push(Event::Failed(error));
    }

    /// Ends all jobs of a kind.
    pub fn cancel(&mut self, kind: Kind) {
        self.running.retain(|job| {
            if job.kind == kind {
                job.cancel();
            }
            job.kind != kind
        });
    }

    /// What came since it was asked last, of jobs that were not cancelled. Images are fitted with so
    /// many lobes.
    pub fn events(&mut self, lobes: usize) -> Vec<Event> {
        let messages = std::mem::take(&mut *self.inbox.borrow_mut());
        for message in messages {
            self.take(message, lobes);
        }
        std::mem::take(&mut self.events)
    }

    fn take(&mut self, message: Message, lobes: usize) {
        let find =
            |running: &[Job], number: u32| running.iter().position(|job| job.number == number);
        match message {
            Message::Open { name, bytes } => self.open(name, bytes, lobes),
            Message::Fetching { number, name } => {
                self.push(number, Kind::Fetch, name, vec![("fetch", 1.0)]);
            }
            Message::Progress {
                number,
                stage,
                fraction,
            } => {
                if let Some(index) = find(&self.running, number) {
                    self.running[index].tracker.report(stage, fraction);
                }
            }
            Message::Light {
                number,
                asset,
                image,
            } => {
                let Some(index) = find(&self.running, number) else {
                    return;
                };
                let name = self.running[index].name.clone();
                match format::read_environment(&asset, &Limits::default()) {
                    Ok(environment) => {
                        let light = Light::new(name, None, environment, image);
                        self.events
                            .push(Event::Loaded(Box::new(Loaded::Light(light))));
                    }
                    Err(error) => self.fail(format!("{name}: {error}")),
                }
            }
            Message::Material { number, asset } => {
                let Some(index) = find(&self.running, number) else {
                    return;
                };
                let name = self.running[index].name.clone();
                match read_asset(FileKind::Material, name.as_ref(), &asset) {
                    Ok(loaded) => self.events.push(Event::Loaded(Box::new(loaded))),
                    Err(error) => self.fail(format!(
                        "{name}: {}",
                        relight_bake::error::sentence(error.chain())
                    )),
                }
            }
            Message::Ended { number, error } => {
                let Some(index) = find(&self.running, number) else {
                    return;
                };
                let job = self.running.remove(index);
                if let Some(error) = error {
                    self.fail(format!("{}: {error}", job.name));
                }
            }
        }
    }
}

fn read_asset(kind: FileKind, path: &Path, bytes: &[u8]) -> anyhow::Result<Loaded> {
    let limits = Limits::default();
    Ok(match kind {
        FileKind::Scene => {
            let scene = format::read_scene(bytes, &limits)?;
            Loaded::Scene {
                warnings: scene.report.warnings.clone(),
                scene: scene.into(),
                source: None,
                quality: None,
                lights: Vec::new(),
                environment: None,
                files: Vec::new(),
            }
        }
        FileKind::Light => {
            let environment = format::read_environment(bytes, &limits)?;
            let name = super::file_name(path);
            Loaded::Light(Light::new(name, None, environment, None))
        }
        FileKind::Material => {
            let asset = format::read_material(bytes, &limits).context("a material asset")?;
            let (surface, textures) = surface_of(asset)?;
            Loaded::Material {
                source: path.into(),
                surface,
                textures,
            }
        }
    })
}

/// Reads a dropped file, which becomes a message.
pub fn take_dropped(file: Arc<dyn egui::DroppedFile>, inbox: Inbox, context: &egui::Context) {
    let context = context.clone();
    wasm_bindgen_futures::spawn_local(async move {
        let name = super::file_name(file.path());
        match file.bytes_async().await {
            Ok(bytes) => inbox.borrow_mut().push(Message::Open { name, bytes }),
            Err(error) => console_error(&format!("{name}: {error}")),
        }
        context.request_repaint();
    });
}
