//! Images in memory and in files: OpenEXR for numbers, PNG to look at.

use std::io::Cursor;
use std::path::Path;

use exr::prelude::{
    AnyChannel, AnyChannels, Compression, Encoding, FlatSamples, Layer, LayerAttributes, LineOrder,
    ReadChannels as _, ReadLayers as _, Vec2, WritableImage as _,
};

use relight_bake::error;
use relight_bake::files::{Access, Files};

/// Names of the EXR channels that hold the variance of the mean of R, G and B.
const VARIANCE_CHANNELS: [&str; 3] = ["variance.R", "variance.G", "variance.B"];

/// A linear, scene-referred Rec.709 image, row 0 first.
#[derive(Clone, Debug, PartialEq)]
pub struct Image {
    /// Pixels per row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Radiance multiplied by coverage, and coverage in [0, 1] as alpha.
    pub pixels: Vec<[f32; 4]>,
    /// Variance of the mean of R, G and B per pixel, when the image is an estimate.
    pub variance: Option<Vec<[f32; 3]>>,
}

/// Why an image could not be read or written.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The file cannot be read, or not be what it should be.
    #[error(transparent)]
    File(#[from] error::Error),
    /// The file could not be written.
    #[error(transparent)]
    Write(#[from] relight_format::Error),
}

impl Image {
    /// A black image without coverage.
    pub fn new(width: u32, height: u32) -> Self {
        let pixels = vec![[0.0; 4]; width as usize * height as usize];
        Self {
            width,
            height,
            pixels,
            variance: None,
        }
    }

    /// Root of the mean variance over the mean radiance, both over pixels with coverage
    /// above one half and all channels: the relative RMS noise of the estimate.
    pub fn relative_noise(&self) -> Option<f64> {
        let variance = self.variance.as_ref()?;
        let (mut noise, mut signal) = (0.0, 0.0);
        for (pixel, variance) in self.pixels.iter().zip(variance) {
            let alpha = f64::from(pixel[3]);
            if alpha > 0.5 {
                noise += variance.iter().map(|&v| f64::from(v)).sum::<f64>() / (alpha * alpha);
                signal += pixel[..3].iter().map(|&x| f64::from(x)).sum::<f64>() / alpha;
            }
        }
        let covered = self.pixels.iter().filter(|pixel| pixel[3] > 0.5).count();
        (signal > 0.0).then(|| (noise * 3.0 * covered as f64).sqrt() / signal)
    }
}

/// Reads the first layer that has channels R, G and B, with A and the variance channels
/// where it has them. Without A every pixel is covered.
pub fn read_exr(path: &Path) -> Result<Image, Error> {
    let error = |found: String| {
        let expected = "an OpenEXR image with channels R, G and B";
        Error::File(error::Error::invalid(path, "file", expected, found))
    };
    let bytes = Files::new(path, &Access::default())?.read_named(path)?;
    let file = exr::prelude::read()
        .no_deep_data()
        .largest_resolution_level()
        .all_channels()
        .all_layers()
        .all_attributes()
        .from_buffered(Cursor::new(bytes))
        .map_err(|reason| error(reason.to_string()))?;
    let channels = |layer: &Layer<AnyChannels<FlatSamples>>, name: &str| -> Option<Vec<f32>> {
        let find = |channel: &&AnyChannel<FlatSamples>| channel.name.eq_case_insensitive(name);
        let channel = layer.channel_data.list.iter().find(find)?;
        Some(channel.sample_data.values_as_f32().collect())
    };
    for layer in &file.layer_data {
        let [Some(r), Some(g), Some(b)] = ["R", "G", "B"].map(|name| channels(layer, name)) else {
            continue;
        };
        let Vec2(width, height) = layer.size;
        let count = width * height;
        let a = channels(layer, "A").unwrap_or_else(|| vec![1.0; count]);
        let variance = VARIANCE_CHANNELS.map(|name| channels(layer, name));
        // Subsampled channels are shorter than the image.
        let mut all = [&r, &g, &b, &a]
            .into_iter()
            .chain(variance.iter().flatten());
        if let Some(channel) = all.find(|channel| channel.len() != count) {
            return Err(error(format!(
                "{} of {count} samples in a channel",
                channel.len()
            )));
        }
        let variance = match &variance {
            [Some(r), Some(g), Some(b)] => Some((0..count).map(|i| [r[i], g[i], b[i]]).collect()),
            _ => None,
        };
        return Ok(Image {
            width: width as u32,
            height: height as u32,
            pixels: (0..count).map(|i| [r[i], g[i], b[i], a[i]]).collect(),
            variance,
        });
    }
    Err(error("no layer with them".into()))
}

/// Writes 32-bit float channels A, B, G, R and, where the image has it, the variance of
/// the mean as `variance.R`, `variance.G` and `variance.B`.
pub fn write_exr(path: &Path, image: &Image) -> Result<(), Error> {
    let channel = |name: &str, samples: Vec<f32>| AnyChannel::new(name, FlatSamples::F32(samples));
    let mut list: Vec<_> = ["R", "G", "B", "A"]
        .iter()
        .enumerate()
        .map(|(i, name)| channel(name, image.pixels.iter().map(|pixel| pixel[i]).collect()))
        .collect();
    if let Some(variance) = &image.variance {
        for (i, name) in VARIANCE_CHANNELS.iter().enumerate() {
            list.push(channel(
                name,
                variance.iter().map(|value| value[i]).collect(),
            ));
        }
    }
    let encoding = Encoding {
        compression: Compression::ZIP16,
        blocks: exr::image::Blocks::ScanLines,
        line_order: LineOrder::Increasing,
    };
    let layer = Layer::new(
        (image.width as usize, image.height as usize),
        LayerAttributes::default(),
        encoding,
        AnyChannels::sort(list.into()),
    );
    let mut bytes = Cursor::new(Vec::new());
    exr::prelude::Image::from_layer(layer)
        .write()
        .to_buffered(&mut bytes)
        .map_err(|reason| cannot_encode(path, &reason))?;
    Ok(relight_format::write_file(path, bytes.get_ref())?)
}

fn cannot_encode(path: &Path, reason: &dyn std::fmt::Display) -> error::Error {
    error::Error::invalid(path, "image", "one that can be encoded", reason)
}

/// Writes an 8-bit sRGB PNG of `width` columns.
pub fn write_png(path: &Path, width: u32, pixels: &[[u8; 3]]) -> Result<(), Error> {
    use image::ImageEncoder as _;
    let mut bytes = Vec::new();
    let height = pixels.len() as u32 / width.max(1);
    image::codecs::png::PngEncoder::new(&mut bytes)
        .write_image(
            pixels.as_flattened(),
            width,
            height,
            image::ExtendedColorType::Rgb8,
        )
        .map_err(|reason| cannot_encode(path, &reason))?;
    Ok(relight_format::write_file(path, &bytes)?)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn gradient(variance: bool) -> Image {
        let mut image = Image::new(7, 5);
        for (i, pixel) in image.pixels.iter_mut().enumerate() {
            *pixel = [
                i as f32 * 0.37,
                1e-7 * i as f32,
                3e4 - i as f32,
                (i % 2) as f32,
            ];
        }
        image.variance = variance.then(|| (0..35).map(|i| [i as f32, 0.5, 1e-9]).collect());
        image
    }

    #[test]
    fn exr_keeps_every_bit() {
        let folder = tempfile::tempdir().unwrap();
        for variance in [false, true] {
            let path = folder.path().join("image.exr");
            write_exr(&path, &gradient(variance)).unwrap();
            assert_eq!(read_exr(&path).unwrap(), gradient(variance));
        }
    }

    #[test]
    fn exr_bytes_do_not_vary() {
        let folder = tempfile::tempdir().unwrap();
        let bytes = ["a.exr", "b.exr"].map(|name| {
            let path = folder.path().join(name);
            write_exr(&path, &gradient(true)).unwrap();
            std::fs::read(path).unwrap()
        });
        assert_eq!(bytes[0], bytes[1]);
    }

    #[test]
    fn bad_files_and_names_are_errors() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("image.exr");
        std::fs::write(&path, b"not an image").unwrap();
        assert!(matches!(read_exr(&path), Err(Error::File(error)) if error.source.is_none()));
        let absent = read_exr(&folder.path().join("absent.exr"));
        assert!(matches!(absent, Err(Error::File(error)) if error.source.is_some()));
        let other = folder.path().join("image.jpeg");
        assert!(matches!(
            crate::display::write_image(&other, &gradient(false), 0.0),
            Err(Error::File(_))
        ));
        assert!(!other.exists());
    }

    #[test]
    fn noise_is_relative_to_the_mean() {
        let mut image = Image::new(2, 1);
        image.pixels = vec![[2.0, 4.0, 6.0, 1.0], [9.0; 4]];
        image.pixels[1][3] = 0.0;
        image.variance = Some(vec![[0.04; 3]; 2]);
        let noise = image.relative_noise().unwrap();
        assert!((noise - 0.2 / 4.0).abs() < 1e-6, "{noise}");
    }
}
