//! Linear radiance to 8-bit sRGB, for eyes and for FLIP: as the runtime shows it.

use std::path::Path;

use glam::Vec3;
use relight_bake::error;
use relight_bake::files;
pub use relight_shading::tonemap::luminance;
use relight_shading::tonemap::{self, encode_srgb, neutral};

use crate::image_file::{Error, Image, write_exr, write_png};

/// Linear grey shown where nothing covers the pixel.
const BACKGROUND: f32 = 0.18;

/// Where exposed radiance is cut off: beyond it the curve is white, and infinity is not a
/// colour.
const BRIGHTEST: f32 = 1e6;

/// How a picture is stored.
#[derive(Clone, Copy)]
enum Kind {
    Exr,
    Png,
}

/// By the name's ending.
fn kind(path: &Path) -> Result<Kind, error::Error> {
    let extension = path.extension().unwrap_or_default();
    let is = |kind: &str| extension.eq_ignore_ascii_case(kind);
    if is("exr") {
        return Ok(Kind::Exr);
    }
    if is("png") {
        return Ok(Kind::Png);
    }
    let found = match path.extension() {
        Some(extension) => format!(".{}", extension.display()),
        None => "no extension".into(),
    };
    Err(error::Error::invalid(
        path,
        "file name",
        ".exr or .png",
        found,
    ))
}

/// Checks, before the work, that [`write_image`] will be able to write a picture.
pub fn check_output(path: &Path) -> anyhow::Result<()> {
    kind(path)?;
    files::check_output(path)?;
    Ok(())
}

/// Makes a folder for what `--out` asks for.
pub fn create_folder(folder: &Path) -> Result<(), error::Error> {
    std::fs::create_dir_all(folder).map_err(|source| {
        error::Error::refused(folder, "--out", "a folder that can be written", source)
    })
}

/// Writes `image` as EXR, or tone-mapped at `exposure` stops as PNG, by the name's ending.
pub fn write_image(path: &Path, image: &Image, exposure: f32) -> Result<(), Error> {
    match kind(path)? {
        Kind::Exr => write_exr(path, image),
        Kind::Png => write_png(path, image.width, &pixels(image, exposure)),
    }
}

/// Tone-mapped sRGB pixels over a neutral background. `exposure` is in stops.
pub fn pixels(image: &Image, exposure: f32) -> Vec<[u8; 3]> {
    let scale = exposure.exp2();
    let show = |&[r, g, b, alpha]: &[f32; 4]| {
        let coverage = alpha.clamp(0.0, 1.0);
        // Only radiance is exposed and tone-mapped; coverage then blends as light does.
        let radiance = if alpha > 0.0 {
            Vec3::new(r, g, b) / alpha
        } else {
            Vec3::ZERO
        };
        let shown = neutral(
            (radiance * scale)
                .max(Vec3::ZERO)
                .min(Vec3::splat(BRIGHTEST)),
        );
        let linear = Vec3::splat(BACKGROUND).lerp(shown, coverage);
        linear
            .to_array()
            .map(|value| (encode_srgb(value.clamp(0.0, 1.0)) * 255.0).round() as u8)
    };
    image.pixels.iter().map(show).collect()
}

/// Images of one height beside each other, shown at one exposure with a white gap between,
/// as width and pixels.
///
/// # Panics
/// If the heights differ.
pub fn side_by_side(images: &[&Image], exposure: f32) -> (u32, Vec<[u8; 3]>) {
    const GAP: usize = 4;
    let shown: Vec<_> = images.iter().map(|image| pixels(image, exposure)).collect();
    let mut joined = Vec::new();
    let height = images.first().map_or(0, |image| image.height);
    for row in 0..height as usize {
        for (index, (image, pixels)) in images.iter().zip(&shown).enumerate() {
            assert_eq!(image.height, height, "height of image {index}");
            let width = image.width as usize;
            let gap = if index == 0 { 0 } else { GAP };
            joined.extend(std::iter::repeat_n([255; 3], gap));
            joined.extend_from_slice(&pixels[row * width..(row + 1) * width]);
        }
    }
    (joined.len() as u32 / height.max(1), joined)
}

/// [`tonemap::automatic_exposure`] of an image.
pub fn automatic_exposure(image: &Image) -> f32 {
    tonemap::automatic_exposure(&image.pixels)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn background_shows_where_nothing_covers() {
        let mut image = Image::new(2, 1);
        image.pixels = vec![[0.0; 4], [0.0, 0.0, 0.0, 1.0]];
        // sRGB of 0.18 is 0.4614.
        assert_eq!(pixels(&image, 0.0), [[118; 3], [0; 3]]);
    }

    #[test]
    fn images_stand_beside_each_other() {
        let mut left = Image::new(2, 2);
        left.pixels[2] = [0.0, 0.0, 0.0, 1.0];
        let right = Image::new(3, 2);
        let (width, pixels) = side_by_side(&[&left, &right], 0.0);
        assert_eq!((width, pixels.len()), (9, 18));
        assert_eq!(pixels[2..6], [[255; 3]; 4]);
        assert_eq!(pixels[9], [0; 3]);
        assert_eq!(pixels[17], pixels[0]);
    }

    #[test]
    fn automatic_exposure_undoes_a_scale() {
        let mut image = Image::new(8, 1);
        image.pixels = (0..8).map(|i| [i as f32, 1.0, 0.5, 1.0]).collect();
        let before = automatic_exposure(&image);
        for pixel in &mut image.pixels {
            for value in &mut pixel[..3] {
                *value *= 8.0;
            }
        }
        // Scaling by 2³ must take exactly three stops off, up to f32 rounding.
        assert!((before - automatic_exposure(&image) - 3.0).abs() < 1e-4);
    }
}
