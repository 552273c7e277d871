//! Pictures drawn on a page's device, part by part between frames of the window: nothing waits.

use std::cell::RefCell;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use relight_format::Scene;
use relight_runtime::{Image, Instance, Options, Renderer, View, wgpu};
use relight_shading::catcher;
use web_time::Instant;

use super::uploaded::Uploaded;
use super::{Event, Picture, Request, Shot, rows_of_group};
use crate::pace::{Level, Pace};
use crate::state::Integrator;

/// Draws one request after the other.
pub struct Engine {
    state: RefCell<State>,
    /// The device works; whatever follows waits for it.
    busy: Arc<AtomicBool>,
    wake: Arc<dyn Fn() + Send + Sync>,
}

struct State {
    renderer: Renderer,
    uploaded: Option<Uploaded>,
    preparations: u32,
    view: Option<View>,
    pace: Pace,
    newest: u64,
    waiting: Option<Request>,
    drawing: Option<Drawing>,
    events: Vec<Event>,
}

/// A request under way.
struct Drawing {
    number: u64,
    request: Request,
    integrators: Vec<Integrator>,
    level: Level,
    pane: usize,
    /// The picture at hand.
    shot: Shot,
    row: u32,
    since: Instant,
    /// All of it is drawn, and on its way here.
    reading: Option<Reading>,
}

struct Reading {
    buffer: wgpu::Buffer,
    /// Bytes from row to row.
    stride: u32,
    /// What is behind the radiance: where nothing hides light, for what catches shadows.
    open: bool,
}

impl Engine {
    /// On the device that draws the window. `wake` is called whenever there is something to do.
    pub fn new(
        device: &wgpu::Device,
        queue: &wgpu::Queue,
        wake: impl Fn() + Send + Sync + 'static,
    ) -> Result<Self, relight_runtime::Error> {
        let state = State {
            renderer: Renderer::new(device, queue, Options::default())?,
            uploaded: None,
            preparations: 0,
            view: None,
            pace: Pace::default(),
            newest: 0,
            waiting: None,
            drawing: None,
            events: Vec::new(),
        };
        Ok(Self {
            state: RefCell::new(state),
            busy: Arc::default(),
            wake: Arc::new(wake),
        })
    }

    /// Asks for pictures in place of those asked for before; returns the number of the request.
    pub fn request(&self, request: Request) -> u64 {
        let mut state = self.state.borrow_mut();
        state.newest += 1;
        state.waiting = Some(request);
        (self.wake)();
        state.newest
    }

    /// What came since it was asked last. Goes on drawing: to be called with every frame.
    pub fn events(&self) -> impl Iterator<Item = Event> + '_ {
        let state = &mut *self.state.borrow_mut();
        if !self.busy.load(Ordering::Relaxed)
            && let Err(error) = self.go_on(state)
        {
            state.drawing = None;
            state.uploaded = None;
            state.view = None;
            state.events.push(Event::Failed(error));
        }
        std::mem::take(&mut state.events).into_iter()
    }

    fn go_on(&self, state: &mut State) -> Result<(), String> {
        if let Some(request) = state.waiting.take() {
            state.begin(request);
        }
        let Some(mut drawing) = state.drawing.take() else {
            return Ok(());
        };
        let size = drawing.level.size(drawing.request.size);
        if let Some(reading) = drawing.reading.take() {
            state.finish(&mut drawing, &reading, size)?;
            if state.advance(&mut drawing) {
                state.drawing = Some(drawing);
                (self.wake)();
            }
            return Ok(());
        }
        self.busy.store(true, Ordering::Relaxed);
        if drawing.row < size[1] {
            state.draw_rows(&mut drawing, size)?;
            let (busy, wake) = (self.busy.clone(), self.wake.clone());
            state.renderer.queue().on_submitted_work_done(move || {
                busy.store(false, Ordering::Relaxed);
                wake();
            });
        } else {
            let reading = state.read(size)?;
            let (busy, wake) = (self.busy.clone(), self.wake.clone());
            let mapped = move |_| {
                // What went wrong is told where the bytes are asked for.
                busy.store(false, Ordering::Relaxed);
                wake();
            };
            (reading.buffer).map_async(wgpu::MapMode::Read, .., mapped);
            drawing.reading = Some(reading);
        }
        state.drawing = Some(drawing);
        Ok(())
    }
}

impl State {
    fn begin(&mut self, request: Request) {
        let integrators: Vec<_> = request.shots.iter().map(|shot| shot.integrator).collect();
        let level = self.pace.first(&integrators, request.size);
        let Some(first) = request.shots.first() else {
            return;
        };
        self.drawing = Some(Drawing {
            number: self.newest,
            shot: shot_of(first, level),
            integrators,
            level,
            pane: 0,
            row: 0,
            since: Instant::now(),
            reading: None,
            request,
        });
    }

    /// Goes to the next picture; `false` after the last.
    fn advance(&mut self, drawing: &mut Drawing) -> bool {
        drawing.pane += 1;
        if drawing.pane == drawing.request.shots.len() {
            let (integrators, size) = (&drawing.integrators, drawing.request.size);
            let Some(level) = self.pace.next(drawing.level, integrators, size) else {
                return false;
            };
            (drawing.level, drawing.pane) = (level, 0);
        }
        drawing.shot = shot_of(&drawing.request.shots[drawing.pane], drawing.level);
        drawing.row = 0;
        drawing.since = Instant::now();
        true
    }

    fn draw_rows(&mut self, drawing: &mut Drawing, size: [u32; 2]) -> Result<(), String> {
        let failed = |error: relight_runtime::Error| error.to_string();
        let shot = &drawing.shot;
        let method = (shot.integrator.method()).ok_or("pages do not trace rays")?;
        let renderer = &self.renderer;
        let upload = |scene: &Scene| renderer.upload(scene);
        let uploaded = Uploaded::keep(&mut self.uploaded, shot, &mut self.preparations, upload)
            .map_err(failed)?;
        match &mut self.view {
            Some(view) => view.resize(renderer, size).map_err(failed)?,
            empty => *empty = Some(renderer.view(size).map_err(failed)?),
        }
        let view = self.view.as_mut().ok_or("no view")?;
        let frame = shot.frame(method);
        let rows = rows_of_group(self.pace.rate(shot.integrator), size[0]);
        let rows = drawing.row..drawing.row.saturating_add(rows);
        drawing.row = rows.end;
        let mut encoder = encoder(renderer);
        let instances = [Instance::from(uploaded)];
        (renderer.prepare_rows(&mut encoder, view, &instances, &frame, rows)).map_err(failed)?;
        renderer.queue().submit([encoder.finish()]);
        Ok(())
    }

    /// Copies the picture to where it can be read.
    fn read(&self, [width, height]: [u32; 2]) -> Result<Reading, String> {
        let view = self.view.as_ref();
        let radiance = view.and_then(View::radiance).ok_or("nothing was drawn")?;
        let open = view.and_then(View::open_radiance);
        let stride = (16 * width).next_multiple_of(wgpu::COPY_BYTES_PER_ROW_ALIGNMENT);
        let buffer = (self.renderer.device()).create_buffer(&wgpu::BufferDescriptor {
            label: Some("relight picture"),
            size: u64::from(stride) * u64::from(height) * (1 + u64::from(open.is_some())),
            usage: wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::MAP_READ,
            mapped_at_creation: false,
        });
        let mut encoder = encoder(&self.renderer);
        for (index, texture) in (0..).zip([Some(radiance), open].into_iter().flatten()) {
            let layout = wgpu::TexelCopyBufferLayout {
                offset: index * u64::from(stride) * u64::from(height),
                bytes_per_row: Some(stride),
                rows_per_image: None,
            };
            encoder.copy_texture_to_buffer(
                texture.as_image_copy(),
                wgpu::TexelCopyBufferInfo {
                    buffer: &buffer,
                    layout,
                },
                texture.size(),
            );
        }
        self.renderer.queue().submit([encoder.finish()]);
        Ok(Reading {
            open: open.is_some(),
            buffer,
            stride,
        })
    }

    fn finish(
        &mut self,
        drawing: &mut Drawing,
        reading: &Reading,
        size: [u32; 2],
    ) -> Result<(), String> {
        let range = (reading.buffer.get_mapped_range(..)).map_err(|error| error.to_string())?;
        let mut pixels: Vec<[f32; 4]> = Vec::with_capacity(size[0] as usize * size[1] as usize);
        for line in range.chunks_exact(reading.stride as usize) {
            let line = &line[..16 * size[0] as usize];
            pixels.extend(bytemuck::pod_collect_to_vec::<u8, [f32; 4]>(line));
        }
        if reading.open {
            // The second half.
            let open = pixels.split_off(size[0] as usize * size[1] as usize);
            for (pixel, open) in pixels.iter_mut().zip(open) {
                *pixel = catcher::caught(*pixel, open);
            }
        }
        drop(range);
        reading.buffer.unmap();
        let shot = &drawing.request.shots[drawing.pane];
        let (level, time) = (drawing.level, drawing.since.elapsed());
        let count = drawing.request.shots.len();
        (self.pace).note(level, shot.integrator, size, time.as_secs_f64(), count);
        self.events.push(Event::Picture(Picture {
            request: drawing.number,
            pane: drawing.pane,
            image: Arc::new(Image {
                width: size[0],
                height: size[1],
                pixels,
            }),
            camera: shot.camera,
            rotation: shot.rotation,
            draft: level.draft,
            complete: level == Level::BEST,
            samples: 0,
            time,
            passes: None,
            preparations: self.preparations,
        }));
        Ok(())
    }
}

fn shot_of(shot: &Shot, level: Level) -> Shot {
    if level.draft {
        shot.draft()
    } else {
        shot.clone()
    }
}

fn encoder(renderer: &Renderer) -> wgpu::CommandEncoder {
    (renderer.device()).create_command_encoder(&wgpu::CommandEncoderDescriptor::default())
}
