//! Pictures drawn in a thread of their own.
//!
//! On a graphics device rows are submitted in groups that take a fraction of a second, on the
//! processor every pixel looks whether it is still wanted.

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Condvar, Mutex, PoisonError, mpsc};
use std::thread::JoinHandle;
use std::time::Instant;

use glam::Vec3;
use relight_format::{Material, Scene};
use relight_lab::truth::{self, Trees, lobes};
use relight_runtime::offscreen::Gpu;
use relight_runtime::{
    Image, Instance, Method, Options, PassTimes, View, twin, twin::Prepared, wgpu,
};

use super::uploaded::Uploaded;
use super::{BAND, Device, Event, Picture, Request, Shot, rows_of_group};
use crate::pace::{Level, Pace};
use crate::state::Integrator;

/// Samples per pixel of one pass of the ray tracer.
const PASS_SAMPLES: u32 = truth::REPLICAS;
/// Passes after which the ray tracer rests.
const MOST_PASSES: u32 = 64;

struct Mailbox {
    request: Mutex<(Option<(u64, Request)>, bool)>,
    posted: Condvar,
    /// Number of the newest request; older ones are not worth finishing.
    newest: AtomicU64,
}

/// Draws in a thread of its own.
pub struct Engine {
    mailbox: Arc<Mailbox>,
    events: mpsc::Receiver<Event>,
    thread: Option<JoinHandle<()>>,
}

impl Engine {
    /// Starts the thread. `wake` is called after every event.
    pub fn new(device: Device, wake: impl Fn() + Send + Sync + 'static) -> Self {
        let mailbox = Arc::new(Mailbox {
            request: Mutex::new((None, false)),
            posted: Condvar::new(),
            newest: AtomicU64::new(0),
        });
        let (sender, events) = mpsc::channel();
        let inbox = mailbox.clone();
        let post = move |event| {
            // Nobody listens any more while the application ends.
            let _ = sender.send(event);
            wake();
        };
        let thread = std::thread::Builder::new()
            .name("pictures".into())
            .spawn(move || work(&inbox, device, &post))
            .ok();
        Self {
            mailbox,
            events,
            thread,
        }
    }

    /// Asks for pictures in place of those asked for before; returns the number of the request.
    pub fn request(&self, request: Request) -> u64 {
        let number = self.mailbox.newest.fetch_add(1, Ordering::Relaxed) + 1;
        let mut slot = lock(&self.mailbox.request);
        slot.0 = Some((number, request));
        self.mailbox.posted.notify_one();
        number
    }

    /// What came since it was asked last.
    pub fn events(&self) -> impl Iterator<Item = Event> + '_ {
        self.events.try_iter()
    }
}

impl Drop for Engine {
    fn drop(&mut self) {
        lock(&self.mailbox.request).1 = true;
        self.mailbox.newest.fetch_add(1, Ordering::Relaxed);
        self.mailbox.posted.notify_one();
        if let Some(thread) = self.thread.take() {
            // What it panicked of was told when it did.
            let _ = thread.join();
        }
    }
}

fn lock<T>(mutex: &Mutex<T>) -> std::sync::MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// The thread.
fn work(mailbox: &Mailbox, device: Device, post: &(dyn Fn(Event) + Sync)) {
    let mut artist = Artist::open(device);
    post(Event::Device(artist.name()));
    loop {
        let (number, request) = {
            let mut slot = lock(&mailbox.request);
            loop {
                if slot.1 {
                    return;
                }
                if let Some(next) = slot.0.take() {
                    break next;
                }
                slot = (mailbox.posted.wait(slot)).unwrap_or_else(PoisonError::into_inner);
            }
        };
        let wanted = || mailbox.newest.load(Ordering::Relaxed) == number;
        let result = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| {
            artist.draw(number, &request, &wanted, post)
        }));
        match result {
            Ok(Ok(())) => {}
            Ok(Err(error)) => {
                post(Event::Failed(error));
                artist.forget();
            }
            Err(_) => {
                post(Event::Failed(
                    "this picture could not be drawn; the terminal says why".into(),
                ));
                artist = Artist::open(device);
            }
        }
    }
}

/// A scene, materials in place of its own, and both together.
type Edited = (Arc<Scene>, Arc<Vec<Material>>, Arc<Scene>);

/// Draws, and remembers how long it takes.
pub struct Artist {
    gpu: Option<Box<Gpu>>,
    uploaded: Option<Uploaded>,
    view: Option<View>,
    /// With the materials of the last shot, for the processor.
    edited: Option<Edited>,
    /// For the processor, those used last, the newest one last.
    prepared: Vec<(Arc<Scene>, Prepared)>,
    /// What rays are traced through, for one scene and eye.
    trees: Option<(Arc<Scene>, Vec3, Arc<Trees>)>,
    /// How many scenes were prepared or uploaded.
    preparations: u32,
    pace: Pace,
}

/// Scenes that are kept prepared: one, and the same without light that bounces.
const MOST_PREPARED: usize = 2;

/// A picture that was finished, and how.
pub struct Drawn {
    /// The picture.
    pub image: Image,
    /// How long the passes took, on a graphics device that tells.
    pub passes: Option<PassTimes>,
}

impl Artist {
    /// Opens a device.
    pub fn open(device: Device) -> Self {
        let mut gpu = match device {
            Device::Cpu => None,
            Device::Auto | Device::Gpu => Gpu::new(&wgpu::Limits::default())
                .ok()
                .filter(|gpu| device == Device::Gpu || !gpu.is_software()),
        };
        // Programs on the processor gain nothing from long dispatches, and cannot be stopped in them.
        if let Some(gpu) = gpu.as_mut().filter(|gpu| gpu.is_software()) {
            let options = Options {
                rows_per_dispatch: Some(BAND),
                ..gpu.renderer.options().clone()
            };
            if let Ok(renderer) = gpu.renderer.with_options(options) {
                gpu.renderer = renderer;
            }
        }
        Self {
            gpu: gpu.map(Box::new),
            uploaded: None,
            view: None,
            edited: None,
            prepared: Vec::new(),
            trees: None,
            preparations: 0,
            pace: Pace::default(),
        }
    }

    /// For people.
    pub fn name(&self) -> String {
        match &self.gpu {
            Some(gpu) => gpu.name().to_owned(),
            None => format!("processor, {} threads", rayon::current_num_threads()),
        }
    }

    /// After a failure: what is on the device may be lost.
    fn forget(&mut self) {
        self.uploaded = None;
        self.view = None;
    }

    /// Draws a request, coarse pictures first, for as long as it is wanted.
    fn draw(
        &mut self,
        number: u64,
        request: &Request,
        wanted: &(dyn Fn() -> bool + Sync),
        post: &(dyn Fn(Event) + Sync),
    ) -> Result<(), String> {
        let count = request.shots.len();
        let integrators: Vec<_> = request.shots.iter().map(|shot| shot.integrator).collect();
        let mut level = if request.progressive {
            self.pace.first(&integrators, request.size)
        } else {
            Level::BEST
        };
        loop {
            let size = level.size(request.size);
            let full = level == Level::BEST;
            for (pane, shot) in request.shots.iter().enumerate() {
                let traced = shot.integrator == Integrator::Truth && !level.draft;
                if traced && full && request.progressive {
                    // Its passes come below.
                    continue;
                }
                let start = Instant::now();
                let draft = level.draft.then(|| shot.draft());
                let Some(drawn) = self.picture(draft.as_ref().unwrap_or(shot), size, 0, wanted)?
                else {
                    return Ok(());
                };
                let time = start.elapsed();
                self.pace
                    .note(level, shot.integrator, size, time.as_secs_f64(), count);
                post(Event::Picture(Picture {
                    request: number,
                    pane,
                    image: Arc::new(drawn.image),
                    camera: shot.camera,
                    rotation: shot.rotation,
                    draft: level.draft,
                    complete: full && !traced,
                    samples: if traced { PASS_SAMPLES } else { 0 },
                    time,
                    passes: drawn.passes,
                    preparations: self.preparations,
                }));
                if !wanted() {
                    return Ok(());
                }
            }
            match self.pace.next(level, &integrators, request.size) {
                Some(next) => level = next,
                None => break,
            }
        }
        self.own_edited();
        self.accumulate(number, request, wanted, post)
    }

    /// Takes a copy of the scene while nobody waits, so that the first edit need not.
    fn own_edited(&mut self) {
        if let Some((_, _, edited)) = &mut self.edited {
            Arc::make_mut(edited);
        }
    }

    /// Further passes of the ray tracer.
    fn accumulate(
        &mut self,
        number: u64,
        request: &Request,
        wanted: &(dyn Fn() -> bool + Sync),
        post: &(dyn Fn(Event) + Sync),
    ) -> Result<(), String> {
        let traced = || {
            (request.shots.iter().enumerate())
                .filter(|(_, shot)| shot.integrator == Integrator::Truth)
        };
        let mut sums: Vec<Option<Image>> = vec![None; request.shots.len()];
        let start = Instant::now();
        for pass in 0..MOST_PASSES {
            for (pane, shot) in traced() {
                let Some(drawn) = self.picture(shot, request.size, pass, wanted)? else {
                    return Ok(());
                };
                let sum = match &mut sums[pane] {
                    Some(sum) => {
                        for (sum, pixel) in sum.pixels.iter_mut().zip(&drawn.image.pixels) {
                            for (sum, value) in sum.iter_mut().zip(pixel) {
                                *sum += value;
                            }
                        }
                        sum
                    }
                    empty => empty.insert(drawn.image),
                };
                let mut mean = sum.clone();
                for value in mean.pixels.iter_mut().flatten() {
                    *value /= (pass + 1) as f32;
                }
                post(Event::Picture(Picture {
                    request: number,
                    pane,
                    image: Arc::new(mean),
                    camera: shot.camera,
                    rotation: shot.rotation,
                    draft: false,
                    complete: pass + 1 == MOST_PASSES,
                    samples: (pass + 1) * PASS_SAMPLES,
                    time: start.elapsed(),
                    passes: None,
                    preparations: self.preparations,
                }));
            }
            if traced().next().is_none() || !wanted() {
                break;
            }
        }
        Ok(())
    }

    /// Draws one picture for as long as it takes; of the ray tracer the mean of some passes.
    pub fn finished(&mut self, shot: &Shot, size: [u32; 2], passes: u32) -> Result<Image, String> {
        let passes = if shot.integrator == Integrator::Truth {
            passes.max(1)
        } else {
            1
        };
        let mut mean: Option<Image> = None;
        for pass in 0..passes {
            let drawn = self
                .picture(shot, size, pass, &|| true)?
                .ok_or("nothing was drawn")?;
            mean = Some(match mean {
                None => drawn.image,
                Some(mut mean) => {
                    let part = 1.0 / (pass + 1) as f32;
                    let pairs = mean
                        .pixels
                        .iter_mut()
                        .flatten()
                        .zip(drawn.image.pixels.iter().flatten());
                    for (mean, value) in pairs {
                        *mean += part * (value - *mean);
                    }
                    mean
                }
            });
        }
        mean.ok_or_else(|| "nothing was drawn".into())
    }

    /// Draws one picture; `None` where it was not wanted any more. `pass` chooses the random
    /// numbers of the ray tracer.
    pub fn picture(
        &mut self,
        shot: &Shot,
        size: [u32; 2],
        pass: u32,
        wanted: &(dyn Fn() -> bool + Sync),
    ) -> Result<Option<Drawn>, String> {
        let Some(method) = shot.integrator.method() else {
            let image = self.trace(shot, size, pass, wanted);
            return Ok(image.map(|image| Drawn {
                image,
                passes: None,
            }));
        };
        if self.gpu.is_some() {
            return self.gpu_picture(shot, method, size, wanted);
        }
        let scene = self.edited(shot);
        let frame = shot.frame(method);
        let prepared = self.prepared(&shot.scene);
        let image = twin::render_prepared(&scene, prepared, &frame, size[0], size[1], wanted)
            .map_err(|error| error.to_string())?;
        Ok(wanted().then_some(Drawn {
            image,
            passes: None,
        }))
    }

    fn gpu_picture(
        &mut self,
        shot: &Shot,
        method: Method,
        [width, height]: [u32; 2],
        wanted: &(dyn Fn() -> bool + Sync),
    ) -> Result<Option<Drawn>, String> {
        let failed = |error: relight_runtime::Error| error.to_string();
        let rate = self.pace.rate(shot.integrator);
        let gpu = self.gpu.as_mut().ok_or("no graphics device")?;
        let upload = |scene: &Scene| gpu.upload(scene);
        let uploaded = Uploaded::keep(&mut self.uploaded, shot, &mut self.preparations, upload)
            .map_err(failed)?;
        let frame = shot.frame(method);
        let most = gpu.device.limits().max_texture_dimension_2d;
        if width.max(height) > most {
            return Err(format!(
                "pictures of at most {most} pixels a side, not {width}x{height}"
            ));
        }
        match &mut self.view {
            Some(view) => (view.resize(&gpu.renderer, [width, height])).map_err(failed)?,
            empty => *empty = Some(gpu.renderer.view([width, height]).map_err(failed)?),
        }
        let view = self.view.as_mut().ok_or("no view")?;
        let instances = [Instance::from(uploaded)];
        let rows = rows_of_group(rate, width);
        for first in (0..height).step_by(rows as usize) {
            if !wanted() {
                return Ok(None);
            }
            let mut encoder =
                (gpu.device).create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
            let renderer = &gpu.renderer;
            if rows >= height {
                renderer.prepare(&mut encoder, view, &instances, &frame)
            } else {
                let rows = first..first.saturating_add(rows);
                renderer.prepare_rows(&mut encoder, view, &instances, &frame, rows)
            }
            .map_err(failed)?;
            gpu.queue.submit([encoder.finish()]);
            gpu.device
                .poll(wgpu::PollType::wait_indefinitely())
                .map_err(|error| error.to_string())?;
        }
        // Those of parts are not known.
        let passes = gpu.renderer.pass_times().filter(|_| rows >= height);
        let pixels = gpu.read_radiance(view).map_err(failed)?;
        Ok(Some(Drawn {
            image: Image {
                width,
                height,
                pixels,
            },
            passes,
        }))
    }

    /// One pass of the ray tracer.
    fn trace(
        &mut self,
        shot: &Shot,
        size: [u32; 2],
        pass: u32,
        wanted: &(dyn Fn() -> bool + Sync),
    ) -> Option<Image> {
        let scene = self.edited(shot);
        let trees = self.trees(shot);
        let frame = shot.frame(Method::Ambient);
        let options = truth::Options {
            seed: pass,
            ..truth::Options::centers(PASS_SAMPLES).of(&scene)
        };
        let image = lobes::of_frame_while(&scene, &trees, &frame, size, &options, wanted)?;
        Some(Image {
            width: image.width,
            height: image.height,
            pixels: image.pixels,
        })
    }

    /// What rays of a shot are traced through.
    fn trees(&mut self, shot: &Shot) -> Arc<Trees> {
        let eye = Vec3::from(shot.camera.position);
        match &self.trees {
            Some((scene, of, trees)) if Arc::ptr_eq(scene, &shot.scene) && *of == eye => {
                trees.clone()
            }
            known => {
                let known = known
                    .as_ref()
                    .filter(|(of, ..)| Arc::ptr_eq(of, &shot.scene));
                let trees = Arc::new(match known {
                    Some((_, _, trees)) => trees.moved(&shot.scene, eye),
                    None => Trees::new(&shot.scene, eye),
                });
                self.trees = Some((shot.scene.clone(), eye, trees.clone()));
                trees
            }
        }
    }

    /// What the processor needs of a scene, whatever its materials.
    fn prepared(&mut self, scene: &Arc<Scene>) -> &Prepared {
        let known = (self.prepared.iter()).position(|(known, _)| Arc::ptr_eq(known, scene));
        let newest = known.map(|index| self.prepared.remove(index));
        let newest = newest.unwrap_or_else(|| {
            self.preparations += 1;
            (scene.clone(), Prepared::new(scene))
        });
        let surplus = (self.prepared.len() + 1).saturating_sub(MOST_PREPARED);
        self.prepared.drain(..surplus);
        &self.prepared.push_mut(newest).1
    }

    /// The scene with the shot's materials.
    fn edited(&mut self, shot: &Shot) -> Arc<Scene> {
        if let Some((scene, materials, edited)) = &mut self.edited
            && Arc::ptr_eq(scene, &shot.scene)
        {
            if !Arc::ptr_eq(materials, &shot.materials) {
                Arc::make_mut(edited).materials = shot.materials.to_vec();
                *materials = shot.materials.clone();
            }
            return edited.clone();
        }
        let mut edited = shot.scene.clone();
        if *shot.materials != edited.materials {
            Arc::make_mut(&mut edited).materials = shot.materials.to_vec();
        }
        self.edited = Some((shot.scene.clone(), shot.materials.clone(), edited.clone()));
        edited
    }
}
