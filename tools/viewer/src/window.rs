//! One frame of the window: panels around the picture.

use crate::app::Viewer;
#[cfg(not(target_family = "wasm"))]
use crate::settings;
use crate::{panels, viewport};

impl Viewer {
    /// One frame: takes what has come, draws the window, and asks for what is missing.
    pub fn show(&mut self, ui: &mut egui::Ui) {
        self.take_what_has_come(ui);
        panels::show(ui, self);
        viewport::show(ui, self);
        self.ask_for_what_is_missing();
        #[cfg(target_family = "wasm")]
        if !ui.input(|input| input.pointer.any_down()) {
            self.keep_settings();
        }
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
