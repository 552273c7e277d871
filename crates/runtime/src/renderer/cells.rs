//! The pass that shades by cells, to compare with the paper.

use relight_shading::wgsl;

use super::Renderer;
use crate::layouts::compute_pipeline;

impl Renderer {
    pub(super) fn cells_pipeline(&self, second_uvs: bool) -> &wgpu::ComputePipeline {
        let layouts = [&self.frame_layout, &self.scene_layout, &self.image_layout];
        let index = usize::from(second_uvs);
        (self.kernels.cells[index])
            .get_or_init(|| compute_pipeline(&self.device, &layouts, &wgsl::SHADE_CELLS[index]))
    }
}
