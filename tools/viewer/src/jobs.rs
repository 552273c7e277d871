//! Files to scenes, environments and materials, in threads of their own.
//!
//! Whatever a file holds, the application goes on: what cannot be read, and what panics, becomes
//! a message. Bakes have a pool of threads of their own and yield to the pictures.

use std::any::Any;
use std::panic::AssertUnwindSafe;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError, mpsc};
use std::time::{Duration, Instant};

use anyhow::{Context as _, bail};
use relight_bake::environment::hdr::{self, LatLong};
use relight_bake::environment::{self, FitOptions};
use relight_bake::measured::{Table, fit};
use relight_bake::monitor::{Interrupted, Monitor, Progress};
use relight_bake::scene;
use relight_bake::scene::load::{self, SceneInput};
use relight_format::{self as format, Limits, Scene, Specular, Surface, Texture};
use relight_lab::demo;
use relight_runtime::LocalLight;

use crate::state::{Light, Quality, SkyImage};

/// Lobes of the first fit of an image: a second or so.
const DRAFT_LOBES: usize = 8;
/// How much the threads of a bake yield to the rest, on Unix.
#[cfg(unix)]
const NICENESS: i32 = 10;

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
const BAKE: [(&str, f32); 4] = [
    ("build bvh", 0.01),
    ("bounces", 0.11),
    ("refine", 0.03),
    ("visibility and compression", 0.85),
];

/// The stages of bakes at these qualities.
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
        .map(|lobes| ("fitting lobes", (4.0 + *lobes as f32).powf(1.8)))
        .collect()
}

/// Something that goes on in the background.
pub struct Job {
    /// For people.
    pub name: String,
    /// Jobs of one kind replace each other.
    pub kind: Kind,
    number: u64,
    tracker: Arc<Mutex<Tracker>>,
    stop: Arc<AtomicBool>,
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
}

impl Job {
    /// How far it is.
    pub fn status(&self) -> Status {
        let tracker = lock(&self.tracker);
        tracker.status(tracker.since.elapsed())
    }

    /// Asks it to stop; what it brings afterwards is dropped.
    pub fn cancel(&self) {
        self.stop.store(true, Ordering::Relaxed);
    }
}

/// Everything in the background.
pub struct Jobs {
    running: Vec<Job>,
    sender: mpsc::Sender<(u64, Report)>,
    reports: mpsc::Receiver<(u64, Report)>,
    next: u64,
    wake: Arc<dyn Fn() + Send + Sync>,
}

enum Report {
    Loaded(Box<Loaded>),
    Failed(String),
    Ended,
}

/// What jobs tell the application.
#[derive(Clone, Debug)]
pub enum Event {
    /// Something is there.
    Loaded(Box<Loaded>),
    /// For people: what went wrong and where.
    Failed(String),
}

/// What a job works with.
pub struct Context<'a> {
    /// Progress, and the wish to stop.
    pub monitor: Monitor<'a>,
    /// Takes what is ready.
    pub deliver: &'a (dyn Fn(Loaded) + Sync),
    /// Takes the stages to come; the time that is left counts from then on.
    pub plan: &'a (dyn Fn(Plan) + Sync),
}

impl Jobs {
    /// `wake` is called whenever there is something to collect.
    pub fn new(wake: impl Fn() + Send + Sync + 'static) -> Self {
        let (sender, reports) = mpsc::channel();
        Self {
            running: Vec::new(),
            sender,
            reports,
            next: 0,
            wake: Arc::new(wake),
        }
    }

    /// Those that run.
    pub fn running(&self) -> &[Job] {
        &self.running
    }

    /// Runs `work` in a thread of its own, in place of others of its kind unless it writes a file.
    pub fn start(
        &mut self,
        name: impl Into<String>,
        kind: Kind,
        work: impl FnOnce(&Context) -> anyhow::Result<()> + Send + 'static,
    ) {
        if kind != Kind::Save {
            self.cancel(kind);
        }
        let name = name.into();
        self.next += 1;
        let number = self.next;
        let stop = Arc::new(AtomicBool::new(false));
        let tracker = Arc::new(Mutex::new(Tracker::new(Instant::now())));
        let job = Job {
            name: name.clone(),
            kind,
            number,
            tracker: tracker.clone(),
            stop: stop.clone(),
        };
        self.running.push(job);
        let (sender, wake) = (self.sender.clone(), self.wake.clone());
        let send = move |report| {
            // Nobody listens any more while the application ends.
            let _ = sender.send((number, report));
            wake();
        };
        let spawned = std::thread::Builder::new().name(name.clone()).spawn({
            let send = send.clone();
            move || {
                if let Some(error) = run(work, &tracker, &stop, &send) {
                    // Whoever opened several files has to know which one.
                    let names_it = error.contains(&name);
                    let error = if names_it {
                        error
                    } else {
                        format!("{name}: {error}")
                    };
                    send(Report::Failed(error));
                }
                send(Report::Ended);
            }
        });
        if let Err(error) = spawned {
            send(Report::Failed(format!("no thread: {error}")));
            send(Report::Ended);
        }
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

    /// What came since it was asked last, of jobs that were not cancelled.
    pub fn events(&mut self) -> Vec<Event> {
        let mut events = Vec::new();
        while let Ok((number, report)) = self.reports.try_recv() {
            let Some(index) = self.running.iter().position(|job| job.number == number) else {
                continue;
            };
            let stopped = self.running[index].stop.load(Ordering::Relaxed);
            match report {
                Report::Ended => drop(self.running.remove(index)),
                _ if stopped => {}
                Report::Loaded(loaded) => events.push(Event::Loaded(loaded)),
                Report::Failed(error) => events.push(Event::Failed(error)),
            }
        }
        events
    }
}

impl Drop for Jobs {
    fn drop(&mut self) {
        for job in &self.running {
            job.cancel();
        }
    }
}

fn lock<T>(mutex: &Mutex<T>) -> std::sync::MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// The thread of a job; what went wrong, if anything did.
fn run(
    work: impl FnOnce(&Context) -> anyhow::Result<()> + Send,
    tracker: &Mutex<Tracker>,
    stop: &AtomicBool,
    send: &(impl Fn(Report) + Sync),
) -> Option<String> {
    let report = |Progress { stage, fraction }: Progress| {
        lock(tracker).report(stage, fraction);
    };
    let plan = |plan: Plan| {
        let mut tracker = lock(tracker);
        tracker.plan = plan;
        (tracker.at, tracker.fraction, tracker.since) = (0, 0.0, Instant::now());
    };
    let deliver = |loaded| send(Report::Loaded(Box::new(loaded)));
    let context = Context {
        monitor: Monitor {
            report: &report,
            stop,
        },
        deliver: &deliver,
        plan: &plan,
    };
    let pool = rayon::ThreadPoolBuilder::new()
        .thread_name(|index| format!("job {index}"))
        .start_handler(|_| yield_to_others())
        .build();
    let pool = match pool {
        Ok(pool) => pool,
        Err(error) => return Some(format!("no threads: {error}")),
    };
    let result = std::panic::catch_unwind(AssertUnwindSafe(|| pool.install(|| work(&context))));
    match result {
        Ok(Ok(())) => None,
        Ok(Err(error)) if is_interruption(&error) => None,
        Ok(Err(error)) => Some(format!("{error:#}")),
        Err(payload) => Some(format!("a defect of ours: {}", panic_message(&*payload))),
    }
}

fn yield_to_others() {
    // A refusal costs speed alone.
    #[cfg(unix)]
    let _ = rustix::process::setpriority_process(None, NICENESS);
}

fn is_interruption(error: &anyhow::Error) -> bool {
    error.chain().any(|cause| {
        cause.is::<Interrupted>()
            || matches!(cause.downcast_ref(), Some(scene::Error::Interrupted(_)))
            || matches!(
                cause.downcast_ref(),
                Some(environment::Error::Interrupted(_))
            )
    })
}

fn panic_message(payload: &(dyn Any + Send)) -> &str {
    (payload.downcast_ref::<&str>().copied())
        .or_else(|| payload.downcast_ref::<String>().map(String::as_str))
        .unwrap_or("no words")
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
    /// `None` where the name says nothing that we know.
    pub fn of(path: &Path) -> Option<Self> {
        let extension = path.extension()?.to_str()?.to_ascii_lowercase();
        match extension.as_str() {
            "toml" | "gltf" | "glb" | "obj" => Some(Self::Scene),
            "hdr" | "exr" => Some(Self::Light),
            "bsdf" | "binary" => Some(Self::Material),
            "relight" => {
                let bytes = std::fs::read(path).unwrap_or_default();
                match format::inspect(&bytes, &Limits::default()) {
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

/// Loads a scene, bakes a mesh at one quality after the other, and delivers every stage of it.
pub fn scene_from_file(path: &Path, stages: &[Quality], context: &Context) -> anyhow::Result<()> {
    context.monitor.step("read", 0.0)?;
    let is_asset = (path.extension()).is_some_and(|ending| ending.eq_ignore_ascii_case("relight"));
    if is_asset {
        let bytes = std::fs::read(path).with_context(|| path.display().to_string())?;
        let scene = format::read_scene(&bytes, &Limits::default())
            .with_context(|| path.display().to_string())?;
        (context.deliver)(Loaded::Scene {
            warnings: scene.report.warnings.clone(),
            scene: scene.into(),
            source: Some(path.into()),
            quality: None,
            lights: Vec::new(),
            environment: None,
            files: vec![path.into()],
        });
        return Ok(());
    }
    let input = load::load(path)?;
    let mut files = vec![path.to_owned()];
    if path
        .extension()
        .is_some_and(|ending| ending.eq_ignore_ascii_case("toml"))
    {
        let folder = path.parent().unwrap_or(Path::new(""));
        files.push(folder.join(scene::description::load(path)?.mesh));
    }
    (context.plan)(bake_plan(stages));
    for quality in stages {
        let (source, is_last) = (Some((path, &files[..])), Some(quality) == stages.last());
        bake_stage(&input, source, *quality, is_last, context)
            .with_context(|| path.display().to_string())?;
    }
    Ok(())
}

/// Bakes the built-in scene, the draft of a coarser mesh.
pub fn built_in_scene(stages: &[Quality], context: &Context) -> anyhow::Result<()> {
    (context.plan)(bake_plan(stages));
    for quality in stages {
        let detail = if *quality == Quality::Draft { 0.5 } else { 1.0 };
        let input = demo::scene_input(detail)?;
        let is_last = Some(quality) == stages.last();
        bake_stage(&input, None, *quality, is_last, context)?;
    }
    Ok(())
}

/// The built-in environment, fitted.
pub fn built_in_light(stages: &[usize], context: &Context) -> anyhow::Result<()> {
    fit_stages(&demo::sky(256, 128), "built-in", None, stages, context)
}

/// Runs a job in this thread, and returns what it brought.
pub fn collect(work: impl FnOnce(&Context) -> anyhow::Result<()>) -> anyhow::Result<Vec<Loaded>> {
    static NEVER: AtomicBool = AtomicBool::new(false);
    let loaded = Mutex::new(Vec::new());
    let deliver = |one| lock(&loaded).push(one);
    let context = Context {
        monitor: Monitor {
            report: &|_| (),
            stop: &NEVER,
        },
        deliver: &deliver,
        plan: &|_| (),
    };
    work(&context)?;
    Ok(std::mem::take(&mut *lock(&loaded)))
}

/// Bakes at one quality; whether it `is_last` of several.
fn bake_stage(
    input: &SceneInput,
    source: Option<(&Path, &[PathBuf])>,
    quality: Quality,
    is_last: bool,
    context: &Context,
) -> anyhow::Result<()> {
    let options = match quality {
        Quality::Draft => scene::Options::draft(),
        Quality::Standard => scene::Options::standard(),
        Quality::High => scene::Options::high(),
    };
    let (baked, _) = scene::bake(input.clone(), &options, context.monitor)?;
    let mut warnings = input.warnings.clone();
    // What is wrong with a draft is made good by what follows.
    if is_last {
        warnings.extend(baked.report.warnings.iter().cloned());
    }
    warnings.dedup();
    (context.deliver)(Loaded::Scene {
        scene: baked.into(),
        source: source.map(|(path, _)| path.to_owned()),
        quality: Some(quality),
        lights: input.lights.clone(),
        environment: input.environment.clone(),
        files: source.map_or_else(Vec::new, |(_, files)| files.to_vec()),
        warnings,
    });
    Ok(())
}

/// Numbers of lobes of the stages of a fit that ends with `lobes`.
pub fn fit_stages_to(lobes: usize) -> Vec<usize> {
    let mut stages = vec![DRAFT_LOBES.min(lobes), lobes];
    stages.dedup();
    stages
}

/// Loads an environment, fits an image, and delivers every stage of it.
pub fn light_from_file(path: &Path, stages: &[usize], context: &Context) -> anyhow::Result<()> {
    context.monitor.step("read", 0.0)?;
    let name = file_name(path);
    let is_asset = (path.extension()).is_some_and(|ending| ending.eq_ignore_ascii_case("relight"));
    if is_asset {
        let bytes = std::fs::read(path).with_context(|| path.display().to_string())?;
        let environment = format::read_environment(&bytes, &Limits::default())
            .with_context(|| path.display().to_string())?;
        let light = Light::new(name, Some(path.into()), environment, None);
        (context.deliver)(Loaded::Light(light));
        return Ok(());
    }
    let image = hdr::load(path)?;
    fit_stages(&image, &name, Some(path), stages, context)
        .with_context(|| path.display().to_string())
}

fn fit_stages(
    image: &LatLong,
    name: &str,
    source: Option<&Path>,
    stages: &[usize],
    context: &Context,
) -> anyhow::Result<()> {
    let sky = Arc::new(SkyImage {
        width: image.width,
        height: image.height,
        pixels: image.pixels.clone(),
    });
    (context.plan)(fit_plan(stages));
    for lobes in stages.iter().copied() {
        let options = FitOptions {
            lobes,
            ..FitOptions::default()
        };
        let mut fitted = environment::fit(image, &options, context.monitor)?.environment;
        name.clone_into(&mut fitted.report.source);
        let source = source.map(Path::to_owned);
        let light = Light::new(name.to_owned(), source, fitted, Some(sky.clone()));
        (context.deliver)(Loaded::Light(light));
    }
    Ok(())
}

/// Fits a measured BRDF, or takes the surface of a material asset without textures.
pub fn material_from_file(path: &Path, context: &Context) -> anyhow::Result<()> {
    context.monitor.step("read", 0.0)?;
    let is_asset = (path.extension()).is_some_and(|ending| ending.eq_ignore_ascii_case("relight"));
    let (surface, textures) = if is_asset {
        let bytes = std::fs::read(path).with_context(|| path.display().to_string())?;
        let asset = format::read_material(&bytes, &Limits::default())
            .with_context(|| path.display().to_string())?;
        // Ratios need no texture coordinates; other textures do, and are refused.
        let mut plain = asset.material.clone();
        let layers = match &mut plain.surface {
            Surface::Layered { specular, .. } => vec![specular],
            Surface::Layers { layers } => {
                layers.iter_mut().map(|layer| &mut layer.specular).collect()
            }
            Surface::MetallicRoughness { .. } => Vec::new(),
        };
        for specular in layers {
            if let Specular::Lobes { ratio, .. } = specular {
                *ratio = None;
            }
        }
        if plain.slots().next().is_some() {
            bail!(
                "{}: its textures have to be baked into a scene; name it in a scene file",
                path.display()
            );
        }
        (asset.material.surface, asset.textures)
    } else {
        let table = Table::load(path)?;
        context.monitor.step("fit lobes", 0.1)?;
        let fitted = fit::corrected(&table, fit::Stop::default());
        let slot = format::TextureSlot::whole(0);
        let surface = fitted.fit.surface(file_name(path), Some(slot));
        (surface, vec![fitted.ratio])
    };
    (context.deliver)(Loaded::Material {
        source: path.into(),
        surface,
        textures,
    });
    Ok(())
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
