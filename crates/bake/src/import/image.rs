//! PNG, JPEG and WebP to RGBA8.

use std::io::Cursor;
use std::path::Path;

use image::{ImageFormat, ImageReader};
use relight_format::{Texture, TextureEncoding};

use super::{Error, MAX_IMAGE_SIZE};

/// Decodes an image. `texels` counts those decoded so far for the same mesh, of which there
/// may be `most`.
pub(super) fn decode(
    file: &Path,
    place: &str,
    bytes: &[u8],
    encoding: TextureEncoding,
    texels: &mut u64,
    most: u64,
) -> Result<Texture, Error> {
    let malformed = |error: &dyn std::fmt::Display| {
        Error::invalid(file, place, "a readable PNG, JPEG or WebP image", error)
    };
    let reader = || {
        let mut reader = ImageReader::new(Cursor::new(bytes))
            .with_guessed_format()
            .ok()?;
        let mut limits = image::Limits::default();
        limits.max_image_width = Some(MAX_IMAGE_SIZE);
        limits.max_image_height = Some(MAX_IMAGE_SIZE);
        // 16-bit RGBA of the largest image.
        limits.max_alloc = Some(most.saturating_mul(8));
        reader.limits(limits);
        let known = matches!(
            reader.format(),
            Some(ImageFormat::Png | ImageFormat::Jpeg | ImageFormat::WebP)
        );
        known.then_some(reader)
    };
    let unknown = || malformed(&"another format");
    let (width, height) = reader()
        .ok_or_else(unknown)?
        .into_dimensions()
        .map_err(|error| malformed(&error))?;
    *texels += u64::from(width) * u64::from(height);
    if width.max(height) > MAX_IMAGE_SIZE || *texels > most {
        return Err(Error::invalid(
            file,
            place,
            format_args!(
                "at most {MAX_IMAGE_SIZE} texels per side and {most} in all textures (--limit-texels)"
            ),
            format_args!("{width}x{height}, {texels} in all so far"),
        ));
    }
    let image = reader()
        .ok_or_else(unknown)?
        .decode()
        .map_err(|error| malformed(&error))?
        .into_rgba8();
    let (width, height) = image.dimensions();
    Ok(Texture {
        width,
        height,
        encoding,
        texels: image.into_raw(),
    })
}
