//! Images in memory.

/// Linear radiance, row 0 first. Alpha is coverage: 1 where a surface was shaded, 0 on the
/// background, between them in pixels that show both. Radiance is multiplied by it.
#[derive(Clone, Debug, PartialEq)]
pub struct Image {
    /// Pixels per row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// `width * height` RGBA pixels.
    pub pixels: Vec<[f32; 4]>,
}
