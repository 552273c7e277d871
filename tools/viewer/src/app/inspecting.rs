//! Visibility at a point that was clicked.

use std::sync::Arc;

use relight_shading::ssdf::Basis;

use super::Viewer;
use crate::inspect;

/// Texels per side of the inspector's map.
const INSPECTION_SIDE: u32 = 160;

impl Viewer {
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
}
