//! Everything around the picture. Each panel reads and changes the state; none draws pictures.

mod environment;
mod inspector;
mod lights;
mod materials;
mod method;
mod picture;
mod scene;

use egui::{Panel, Ui};

use crate::app::Viewer;
use crate::dialog::Purpose;
use crate::jobs::Status;
use crate::state::Layout;

/// Contents of a section of the side panel.
type Section = fn(&mut Ui, &mut Viewer);

/// The sections, in the order of [`Settings::sections`](crate::state::Settings::sections).
const SECTIONS: [(&str, Section); 7] = [
    ("Scene", scene::show),
    ("Environment", environment::show),
    ("Method", method::show),
    ("Picture", picture::show),
    ("Material", materials::show),
    ("Lights in the scene", lights::show),
    ("Inspector", inspector::show),
];

/// Width of the side panel, points.
const SIDE: f32 = 300.0;

/// Draws all panels; what is left of `ui` is the picture's.
pub fn show(ui: &mut Ui, viewer: &mut Viewer) {
    Panel::top("menu").show(ui, |ui| menu(ui, viewer));
    Panel::bottom("status").show(ui, |ui| status(ui, viewer));
    if viewer.settings.panels {
        Panel::right("side").default_size(SIDE).show(ui, |ui| {
            egui::ScrollArea::vertical()
                .auto_shrink(false)
                .show(ui, |ui| side(ui, viewer));
        });
    }
}

fn side(ui: &mut Ui, viewer: &mut Viewer) {
    ui.spacing_mut().slider_width = 120.0;
    for (index, (name, add)) in SECTIONS.into_iter().enumerate() {
        let is_inspector = index + 1 == SECTIONS.len();
        let reveal = is_inspector && std::mem::take(&mut viewer.reveal_inspector);
        let shown = egui::CollapsingHeader::new(name)
            .default_open(viewer.settings.sections[index])
            .open(reveal.then_some(true))
            .show(ui, |ui| add(ui, viewer));
        viewer.settings.sections[index] = shown.fully_open();
    }
}

fn menu(ui: &mut Ui, viewer: &mut Viewer) {
    egui::MenuBar::new().ui(ui, |ui| {
        ui.menu_button("File", |ui| file_menu(ui, viewer));
        #[cfg(not(target_family = "wasm"))]
        ui.menu_button("Turntable", |ui| picture::turntable(ui, viewer));
        ui.menu_button("Keys", keys);
        ui.separator();
        let settings = &mut viewer.settings;
        ui.selectable_value(&mut settings.layout, Layout::One, "One");
        ui.selectable_value(&mut settings.layout, Layout::Split, "Split");
        ui.selectable_value(&mut settings.layout, Layout::Difference, "Difference");
        ui.separator();
        let play = if viewer.playing {
            "Stop the light"
        } else {
            "Turn the light"
        };
        if ui.button(play).clicked() {
            viewer.playing = !viewer.playing;
        }
        let mut inspecting = viewer.inspecting;
        if ui.toggle_value(&mut inspecting, "Inspect").changed() {
            viewer.set_inspecting(inspecting);
        }
        ui.toggle_value(&mut viewer.settings.panels, "Panels");
    });
}

fn file_menu(ui: &mut Ui, viewer: &mut Viewer) {
    let items = [
        ("Open…", Purpose::Open),
        ("Save picture…", Purpose::SavePicture),
        ("Save camera…", Purpose::SaveCamera),
        #[cfg(not(target_family = "wasm"))]
        ("Save scene file…", Purpose::SaveScene),
        ("Save baked scene…", Purpose::SaveAsset),
    ];
    for (name, purpose) in items {
        if ui.button(name).clicked() {
            viewer.choose(&purpose);
            ui.close();
        }
    }
    #[cfg(not(target_family = "wasm"))]
    files_by_name(ui, viewer);
}

/// What takes a file system.
#[cfg(not(target_family = "wasm"))]
fn files_by_name(ui: &mut Ui, viewer: &mut Viewer) {
    if ui.button("Built-in scene").clicked() {
        viewer.open_built_in();
        ui.close();
    }
    ui.separator();
    ui.label("or type a path:");
    let label = ui.label("Path").id;
    let edit = ui.text_edit_singleline(&mut viewer.path).labelled_by(label);
    let entered = edit.lost_focus() && ui.input(|input| input.key_pressed(egui::Key::Enter));
    if (ui.button("Open path").clicked() || entered) && !viewer.path.trim().is_empty() {
        let path = std::path::PathBuf::from(viewer.path.trim());
        viewer.open(&path);
        ui.close();
    }
    ui.checkbox(
        &mut viewer.settings.watch,
        "Read files again when they change",
    );
}

fn keys(ui: &mut Ui) {
    let rows = [
        ("drag", "turn the camera"),
        ("shift or right button + drag, shift + wheel", "move it"),
        ("ctrl + drag", "turn the light"),
        ("wheel, pinch, + and −", "come closer, go away"),
        ("one finger, two", "turn the camera; move it"),
        ("click, double click", "select a surface, and frame it"),
        ("arrows", "turn the camera"),
        ("F", "frame what is selected"),
        ("space, [ and ]", "turn the light"),
        ("S", "one picture, two, their difference"),
        ("1, 2, 3…", "method"),
        ("I, P", "inspector, panels"),
    ];
    egui::Grid::new("keys").show(ui, |ui| {
        for (keys, what) in rows {
            ui.strong(keys);
            ui.label(what);
            ui.end_row();
        }
    });
}

/// What draws, and how soon it answered.
fn status(ui: &mut Ui, viewer: &Viewer) {
    ui.horizontal(|ui| {
        ui.weak(&viewer.device_name);
        if let Some(picture) = &viewer.pictures[0] {
            ui.weak(format!("{:.0} ms", picture.time.as_secs_f64() * 1e3));
        }
        if let Some(answer) = viewer.answers.last() {
            ui.weak(format!(
                "answer after {:.0} ms",
                answer.after.as_secs_f64() * 1e3
            ));
        }
    });
}

/// Jobs and messages, over the picture: it keeps its size, and need not be drawn again, when they
/// come and go.
pub fn notices(ui: &Ui, viewer: &mut Viewer, picture: egui::Rect) {
    if viewer.jobs.running().is_empty() && viewer.messages.is_empty() {
        return;
    }
    egui::Area::new(egui::Id::unique("notices"))
        .order(egui::Order::Middle)
        .pivot(egui::Align2::LEFT_BOTTOM)
        .fixed_pos(picture.left_bottom() + egui::vec2(8.0, -8.0))
        .show(ui.ctx(), |ui| {
            egui::Frame::popup(ui.style()).show(ui, |ui| {
                ui.set_width((picture.width() - 40.0).clamp(120.0, 520.0));
                jobs(ui, viewer);
                messages(ui, viewer);
            });
        });
}

fn jobs(ui: &mut Ui, viewer: &mut Viewer) {
    let mut cancel = None;
    for job in viewer.jobs.running() {
        let Status {
            stage,
            fraction,
            left,
        } = job.status();
        ui.horizontal(|ui| {
            if ui.button("Cancel").clicked() {
                cancel = Some(job.kind);
            }
            let left = left.map_or_else(String::new, |left| {
                format!(", {} s left", left.as_secs() + 1)
            });
            let text = format!("{}: {stage}{left}", job.name);
            ui.add(egui::ProgressBar::new(fraction).text(text));
        });
        // Progress does not wake the window by itself.
        ui.ctx()
            .request_repaint_after(std::time::Duration::from_millis(200));
    }
    if let Some(kind) = cancel {
        viewer.jobs.cancel(kind);
    }
}

fn messages(ui: &mut Ui, viewer: &mut Viewer) {
    let mut dismissed = None;
    let newest = viewer.messages.iter().enumerate().rev().take(3);
    for (index, message) in newest {
        ui.horizontal(|ui| {
            if ui.small_button("×").on_hover_text("dismiss").clicked() {
                dismissed = Some(index);
            }
            let color = if message.is_error {
                ui.visuals().error_fg_color
            } else {
                ui.visuals().text_color()
            };
            let text = egui::RichText::new(&message.text).color(color);
            ui.add(egui::Label::new(text).truncate())
                .on_hover_text(&message.text);
        });
    }
    if let Some(index) = dismissed {
        viewer.messages.remove(index);
    }
}
