//! What a page tells the application in it.
//!
//! `web/app.js` is the other half: it hands over files, runs workers, and offers what is saved. What
//! tests ask is answered here too: what is shown, and where widgets are, as screen readers see them.

use std::cell::RefCell;
use std::rc::Rc;
use std::sync::{Arc, Mutex, PoisonError};

use egui::accesskit::{Node, TreeUpdate};
use js_sys::{Float32Array, Uint8Array};
use relight_runtime::Panorama;
use serde_json::json;
use wasm_bindgen::prelude::wasm_bindgen;
use wasm_bindgen::{JsError, JsValue};
use web_sys::HtmlCanvasElement;

use crate::app::{Start, Viewer};
use crate::browser::Hooks;
use crate::jobs::{Inbox, Message};
use crate::settings;

/// The application on a canvas.
#[wasm_bindgen]
pub struct Page {
    runner: eframe::WebRunner,
    inbox: Inbox,
    context: Rc<RefCell<Option<egui::Context>>>,
    widgets: Widgets,
    captured: Captured,
}

/// A picture of the window: columns, rows, RGBA8.
type Captured = Arc<Mutex<Option<(u32, u32, Vec<u8>)>>>;

#[wasm_bindgen]
impl Page {
    /// Starts it; rejected with the reason where there is no device.
    pub async fn start(canvas: HtmlCanvasElement, hooks: Hooks) -> Result<Page, JsValue> {
        let page = Self {
            runner: eframe::WebRunner::new(),
            inbox: Inbox::default(),
            context: Rc::default(),
            widgets: Widgets::default(),
            captured: Captured::default(),
        };
        let (inbox, context, widgets) = (
            page.inbox.clone(),
            page.context.clone(),
            page.widgets.clone(),
        );
        let create: eframe::AppCreator<'static> = Box::new(move |creation| {
            let state = creation.wgpu_render_state.as_ref();
            let state = state.ok_or("no device to draw with")?;
            creation.egui_ctx.add_plugin(widgets);
            *context.borrow_mut() = Some(creation.egui_ctx.clone());
            let start = Start {
                settings: Some(settings::read()),
                hooks,
                inbox,
                graphics: (state.device.clone(), state.queue.clone()),
            };
            Ok(Box::new(Viewer::new(&creation.egui_ctx, start)?))
        });
        let options = eframe::WebOptions::default();
        page.runner.start(canvas, options, create).await?;
        Ok(page)
    }

    /// Opens a file by its name and bytes.
    pub fn open(&self, name: String, bytes: Vec<u8>) {
        self.tell(Message::Open { name, bytes });
    }

    /// Shows that the page fetches something, as job `number`, which is above 2³¹.
    pub fn fetching(&self, number: u32, name: String) {
        self.tell(Message::Fetching { number, name });
    }

    /// How far a job is.
    pub fn progress(&self, number: u32, stage: &str, fraction: f32) {
        let known = ["fetch", "fitting lobes", "fit lobes", "read"];
        let stage = known.into_iter().find(|name| *name == stage);
        self.tell(Message::Progress {
            number,
            stage: stage.unwrap_or("work"),
            fraction,
        });
    }

    /// A worker fitted an image, whose texels for the background may be there already.
    pub fn light(&self, number: u32, asset: Vec<u8>, texels: &[u32]) {
        let image = Panorama::from_texels(texels);
        self.tell(Message::Light {
            number,
            asset,
            image,
        });
    }

    /// A worker fitted a table.
    pub fn material(&self, number: u32, asset: Vec<u8>) {
        self.tell(Message::Material { number, asset });
    }

    /// A job ended; `error` tells why if it failed.
    pub fn ended(&self, number: u32, error: Option<String>) {
        self.tell(Message::Ended { number, error });
    }

    fn tell(&self, message: Message) {
        self.inbox.borrow_mut().push(message);
        self.wake();
    }

    fn wake(&self) {
        if let Some(context) = &*self.context.borrow() {
            context.request_repaint();
        }
    }

    /// What is shown, as JSON.
    pub fn state(&self) -> Option<String> {
        let viewer = self.runner.app_mut::<Viewer>()?;
        let pictures: Vec<_> = (viewer.pictures.iter().flatten())
            .map(|picture| {
                json!({
                    "size": [picture.image.width, picture.image.height],
                    "draft": picture.draft,
                    "complete": picture.complete,
                    "milliseconds": picture.time.as_secs_f64() * 1e3,
                    "preparations": picture.preparations,
                })
            })
            .collect();
        let jobs: Vec<_> = (viewer.jobs.running().iter())
            .map(|job| json!({ "name": job.name, "fraction": job.status().fraction }))
            .collect();
        let messages: Vec<_> = (viewer.messages.iter())
            .map(|message| message.text.as_str())
            .collect();
        let answers: Vec<_> = (viewer.answers.iter())
            .map(|answer| answer.after.as_secs_f64() * 1e3)
            .collect();
        let document = viewer.document.as_ref();
        let lights: Vec<_> = (document.iter().flat_map(|document| &document.local_lights))
            .map(|light| {
                json!({
                    "position": light.position.to_array(),
                    "radius": light.radius,
                    "radiance": light.radiance.to_array(),
                })
            })
            .collect();
        let state = json!({
            "settled": viewer.is_settled(),
            "scene": document.map(|document| document.scene.name.as_str()),
            "selected": document.and_then(|document| document.selected),
            "light": viewer.light.name,
            "lobes": viewer.light.lobes.len(),
            "layout": format!("{:?}", viewer.settings.layout),
            "yaw": viewer.turn.yaw,
            "lights": lights,
            "pictures": pictures,
            "screen": viewer.screen().map(|(size, _)| size),
            "jobs": jobs,
            "messages": messages,
            "answers": answers,
        });
        Some(state.to_string())
    }

    /// Linear radiance times coverage, and coverage, of a picture, row 0 first.
    pub fn radiance(&self, pane: usize) -> Option<Float32Array> {
        let viewer = self.runner.app_mut::<Viewer>()?;
        let picture = viewer.pictures.get(pane)?.as_ref()?;
        Some(Float32Array::from(picture.image.pixels.as_flattened()))
    }

    /// What is on the screen, premultiplied RGBA8.
    pub fn screen(&self) -> Option<Uint8Array> {
        let viewer = self.runner.app_mut::<Viewer>()?;
        let (_, pixels) = viewer.screen()?;
        Some(Uint8Array::from(&pixels[..]))
    }

    /// The scene with its edits, and the light.
    pub fn assets(&self) -> Result<Vec<Uint8Array>, JsError> {
        let viewer = self.runner.app_mut::<Viewer>();
        let viewer = viewer.ok_or_else(|| JsError::new("it has ended"))?;
        let failed = |error: &dyn std::fmt::Display| JsError::new(&error.to_string());
        let scene = viewer.asset().map_err(|error| failed(&error))?;
        let light = relight_format::write_environment(&viewer.light.environment);
        let light = light.map_err(|error| failed(&error))?;
        Ok(vec![
            Uint8Array::from(&scene[..]),
            Uint8Array::from(&light[..]),
        ])
    }

    /// Takes a picture of the whole window with the next frame.
    pub fn capture(&self) {
        let Some(context) = self.context.borrow().clone() else {
            return;
        };
        let captured = self.captured.clone();
        context.request_screenshot(move |image| {
            let pixels = image.pixels.iter().flat_map(egui::Color32::to_array);
            let [width, height] = image.size.map(|side| side as u32);
            *captured.lock().unwrap_or_else(PoisonError::into_inner) =
                Some((width, height, pixels.collect()));
        });
        context.request_repaint();
    }

    /// The last picture of the window, once it is there, as PNG.
    pub fn captured(&self) -> Option<Uint8Array> {
        let captured = self.captured.lock().unwrap_or_else(PoisonError::into_inner);
        let (width, height, pixels) = captured.as_ref()?;
        let png = crate::save::encode_png([*width, *height], &[pixels], 0).ok()?;
        Some(Uint8Array::from(&png[..]))
    }

    /// Left, top, right and bottom of the last widget of this name, points of the page, once it was
    /// shown; `None` before, and where there is none.
    pub fn find(&self, name: &str) -> Option<Vec<f32>> {
        let context = self.context.borrow().clone()?;
        context.enable_accesskit();
        context.request_repaint();
        self.widgets.find(name)
    }
}

/// Widgets as they were shown last.
#[derive(Clone, Default)]
struct Widgets(Arc<Mutex<Option<TreeUpdate>>>);

impl Widgets {
    fn find(&self, name: &str) -> Option<Vec<f32>> {
        let shown = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let named = |node: &&Node| node.label() == Some(name) || node.value() == Some(name);
        let mut nodes = shown.as_ref()?.nodes.iter().map(|(_, node)| node);
        let bounds = nodes.rfind(named)?.bounds()?;
        Some(
            [bounds.x0, bounds.y0, bounds.x1, bounds.y1]
                .map(|side| side as f32)
                .to_vec(),
        )
    }
}

impl egui::Plugin for Widgets {
    fn debug_name(&self) -> &'static str {
        "widgets"
    }

    fn output_hook(&mut self, _context: &egui::Context, output: &mut egui::FullOutput) {
        if let Some(update) = output.platform_output.accesskit_update.take() {
            *self.0.lock().unwrap_or_else(PoisonError::into_inner) = Some(update);
        }
    }
}
