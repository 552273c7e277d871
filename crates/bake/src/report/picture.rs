//! Radiance as a picture to look at.

use relight_format::math;

/// An 8-bit sRGB PNG of exposed radiance, rows from the top, highlights compressed
/// (Reinhard et al. 2002, on each channel).
pub(crate) fn png(
    width: u32,
    height: u32,
    pixels: &[[f32; 3]],
    exposure: f32,
) -> Result<Vec<u8>, image::ImageError> {
    let bytes: Vec<u8> = pixels
        .as_flattened()
        .iter()
        .map(|radiance| {
            let exposed = radiance * exposure;
            let linear = exposed / (1.0 + exposed);
            let encoded = if linear <= 0.003_130_8 {
                12.92 * linear
            } else {
                1.055 * math::powf(linear, 1.0 / 2.4) - 0.055
            };
            (encoded * 255.0).round() as u8
        })
        .collect();
    let mut file = Vec::new();
    image::ImageEncoder::write_image(
        image::codecs::png::PngEncoder::new(&mut file),
        &bytes,
        width,
        height,
        image::ExtendedColorType::Rgb8,
    )?;
    Ok(file)
}
