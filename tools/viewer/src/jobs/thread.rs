//! Jobs in threads of their own. Bakes have a pool of threads and yield to the pictures.

use std::any::Any;
use std::panic::AssertUnwindSafe;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError, mpsc};
use std::time::Instant;

use anyhow::Context as _;
use relight_bake::environment;
use relight_bake::environment::hdr::{self, LatLong};
use relight_bake::measured::{Table, fit};
use relight_bake::monitor::{Interrupted, Monitor, Progress};
use relight_bake::scene;
use relight_bake::scene::load::{self, SceneInput};
use relight_format::{self as format, Limits};
use relight_lab::demo;

use super::{
    Event, FileKind, Kind, Loaded, Plan, Status, Tracker, bake_plan, file_name, fit_options,
    fit_plan, panorama_of, surface_of,
};
use crate::state::{Light, Quality};

/// How much the threads of a bake yield to the rest, on Unix.
#[cfg(unix)]
const NICENESS: i32 = 10;

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
        Ok(Err(error)) => Some(relight_bake::error::sentence(error.chain())),
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

/// What a file is; `None` where its name says nothing that we know.
pub fn kind_of(path: &Path) -> Option<FileKind> {
    // Reading it will say what is wrong.
    FileKind::of(path, || std::fs::read(path).unwrap_or_default())
}

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
    let mut options = match quality {
        Quality::Draft => scene::Options {
            // Soon: what follows is finer.
            least_vertices: 0,
            ..scene::Options::draft()
        },
        Quality::Standard => scene::Options::standard(),
        Quality::High => scene::Options::high(),
    };
    if quality > Quality::Draft {
        // As `bake scene` does.
        options.transfer.bounces = None;
    }
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
    (context.plan)(fit_plan(stages));
    for (index, lobes) in stages.iter().copied().enumerate() {
        let options = fit_options(lobes);
        let mut fitted = environment::fit(image, &options, context.monitor)?.environment;
        name.clone_into(&mut fitted.report.source);
        let source = source.map(Path::to_owned);
        let panorama = panorama_of(image, index, stages);
        let light = Light::new(name.to_owned(), source, fitted, panorama);
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
        surface_of(asset).with_context(|| path.display().to_string())?
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
