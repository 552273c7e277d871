//! Reading lat-long HDR images: which kind a file is, checks of its size and shape, Radiance.

#[cfg(not(target_family = "wasm"))]
use std::fs::File;
#[cfg(not(target_family = "wasm"))]
use std::io::BufReader;
use std::io::{BufRead, Cursor};
#[cfg(not(target_family = "wasm"))]
use std::path::Path;

use image::codecs::hdr::HdrDecoder;
use image::{ImageDecoder, ImageError};

use super::open_exr::decode_exr;
#[cfg(not(target_family = "wasm"))]
use super::open_exr::{check_exr, exr_metadata};
#[cfg(not(target_family = "wasm"))]
use crate::error::Error;
use crate::error::{Objection, first_bytes};
#[cfg(not(target_family = "wasm"))]
use crate::files::{Access, Files};

pub use super::lat_long::LatLong;

/// Most pixels that an image may have whatever is asked for: 32,768 × 16,384, 6 GiB as f32 RGB.
pub const MAX_PIXELS: u64 = 1 << 29;
/// How far a side may be from what the other asks of it, as a part of it: maps are cropped by
/// a row or two.
const SHAPE_TOLERANCE: f64 = 0.01;
/// How to read an image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Reading {
    /// Most pixels, at most [`MAX_PIXELS`]; each takes 12 bytes.
    pub max_pixels: u64,
    /// Take an image whose width is not twice its height as lat-long all the same.
    pub any_shape: bool,
    /// The image stands on its head: its first row is −Y.
    pub flip: bool,
    /// The image is seen from outside: its columns run the other way.
    pub mirror: bool,
}

impl Default for Reading {
    /// 8,192 × 4,096 pixels, upright lat-long.
    fn default() -> Self {
        Self {
            max_pixels: 1 << 25,
            any_shape: false,
            flip: false,
            mirror: false,
        }
    }
}

/// Loads a Radiance `.hdr` or OpenEXR file, told apart by content, and repairs it. See
/// [`load_from`].
#[cfg(not(target_family = "wasm"))]
pub fn load(path: &Path) -> Result<LatLong, Error> {
    let files = Files::new(path, &Access::default())?;
    load_from(&files, path, &Reading::default())
}

/// Loads a Radiance `.hdr` or OpenEXR file that the command line names, and repairs it.
///
/// OpenEXR: the first layer with red, green and blue channels of any spelling (`R`,
/// `view.red`), else with a luminance channel (`Y`). Pixels outside the data window are 0.
/// Colours of other primaries (attribute `chromaticities`) become Rec.709.
#[cfg(not(target_family = "wasm"))]
pub fn load_from(files: &Files, path: &Path, reading: &Reading) -> Result<LatLong, Error> {
    let bytes = files.read_named(path)?;
    parse(&bytes, reading).map_err(|objection| objection.in_file(path))
}

/// Decodes the bytes of an image, which are not trusted.
pub fn parse(bytes: &[u8], reading: &Reading) -> Result<LatLong, Objection> {
    let (width, height, mut pixels) = match Kind::of(bytes)? {
        Kind::Exr => decode_exr(bytes, reading)?,
        Kind::Radiance { strict } => decode_radiance(bytes, strict, reading)?,
    };
    if reading.flip {
        let (columns, rows) = (width as usize, height as usize);
        for row in 0..rows / 2 {
            let (upper, lower) = pixels.split_at_mut((rows - 1 - row) * columns);
            upper[row * columns..][..columns].swap_with_slice(&mut lower[..columns]);
        }
    }
    if reading.mirror {
        for row in pixels.chunks_exact_mut(width as usize) {
            row.reverse();
        }
    }
    Ok(LatLong::repair(width, height, pixels))
}

/// Checks that an opened file begins like an image that [`load`] would take, without its pixels.
#[cfg(not(target_family = "wasm"))]
pub(crate) fn check(path: &Path, file: File, reading: &Reading) -> Result<(), Error> {
    let mut reader = BufReader::new(file);
    let start = reader
        .fill_buf()
        .map_err(|source| Error::read(path, source))?;
    let checked = match Kind::of(start) {
        Ok(Kind::Exr) => exr_metadata(reader)
            .and_then(|metadata| check_exr(&metadata, u64::MAX, reading).map(|_| ())),
        Ok(Kind::Radiance { strict }) => radiance_decoder(reader, strict, reading).map(|_| ()),
        Err(objection) => Err(objection),
    };
    checked.map_err(|objection| objection.in_file(path))
}

/// What the first bytes tell.
enum Kind {
    Exr,
    /// Other programs sign with their own name (`#?RGBE`), which strict mode refuses.
    Radiance {
        strict: bool,
    },
}

impl Kind {
    fn of(bytes: &[u8]) -> Result<Self, Objection> {
        match bytes {
            [0x76, 0x2f, 0x31, 0x01, ..] => Ok(Self::Exr),
            [b'#', b'?', ..] => Ok(Self::Radiance {
                strict: bytes.starts_with(image::codecs::hdr::SIGNATURE),
            }),
            _ => Err(Objection::new(
                "first bytes",
                "\"#?\" of Radiance HDR or \"v/1\\x01\" of OpenEXR",
                first_bytes(bytes),
            )),
        }
    }
}

/// Checks a size read from a header before anything of that size is allocated.
pub(super) fn check_size(
    width: u64,
    height: u64,
    reading: &Reading,
) -> Result<(u32, u32), Objection> {
    let most = reading.max_pixels.min(MAX_PIXELS);
    let valid = width > 0 && height > 0 && width.saturating_mul(height) <= most;
    match (u32::try_from(width), u32::try_from(height)) {
        (Ok(width), Ok(height)) if valid => Ok((width, height)),
        _ => Err(Objection::new(
            "image size",
            format_args!("1 to {most} pixels (--limit-pixels)"),
            format_args!("{width} x {height}"),
        )),
    }
}

/// Checks that an image is twice as wide as high, and says what it looks like otherwise.
pub(super) fn check_shape(width: u32, height: u32, reading: &Reading) -> Result<(), Objection> {
    let is = |columns: u32, rows: u32| {
        let ratio = f64::from(width) * f64::from(rows) / (f64::from(height) * f64::from(columns));
        (ratio - 1.0).abs() <= SHAPE_TOLERANCE
    };
    if reading.any_shape || is(2, 1) || width.abs_diff(2 * height.min(u32::MAX / 2)) <= 1 {
        return Ok(());
    }
    let looks = if is(1, 1) {
        ", a square as of a light probe (angular map), a mirror ball or an octahedral map"
    } else if is(3, 4) {
        ", as of a vertical cross of cube faces"
    } else if is(4, 3) {
        ", as of a horizontal cross of cube faces"
    } else if is(1, 6) || is(6, 1) {
        ", as of a strip of cube faces"
    } else if is(1, 2) {
        ", a lat-long map on its side, or half a sphere"
    } else if is(4, 1) {
        ", half a lat-long map, as of a sky without the ground"
    } else {
        ""
    };
    Err(Objection::new(
        "image size",
        "a lat-long map, twice as wide as high (convert it, or take it as one with --any-shape; \
         --flip and --mirror turn maps that are upside down or seen from outside)",
        format_args!("{width} x {height}{looks}"),
    ))
}

/// Columns, rows, and linear radiance row by row.
pub(super) type Pixels = (u32, u32, Vec<[f32; 3]>);

fn radiance_decoder<R: BufRead>(
    reader: R,
    strict: bool,
    reading: &Reading,
) -> Result<HdrDecoder<R>, Objection> {
    let header = |error| Objection::new("header", "Radiance HDR, 32-bit_rle_rgbe, -Y +X", error);
    let decoder = HdrDecoder::with_strictness(reader, strict).map_err(header)?;
    let metadata = decoder.metadata();
    let (width, height) = check_size(metadata.width.into(), metadata.height.into(), reading)?;
    check_shape(width, height, reading)?;
    Ok(decoder)
}

fn decode_radiance(bytes: &[u8], strict: bool, reading: &Reading) -> Result<Pixels, Objection> {
    let decoder = radiance_decoder(Cursor::new(bytes), strict, reading)?;
    let (width, height) = decoder.dimensions();
    let metadata = decoder.metadata();
    let exposure = metadata.exposure.unwrap_or(1.0);
    let (r, g, b) = metadata.color_correction.unwrap_or((1.0, 1.0, 1.0));
    let divisors = [r * exposure, g * exposure, b * exposure];
    if !divisors
        .iter()
        .all(|divisor| divisor.is_normal() && *divisor > 0.0)
    {
        return Err(Objection::new(
            "header EXPOSURE and COLORCORR",
            "numbers > 0",
            format_args!("{divisors:?}"),
        ));
    }
    let mut pixels = vec![[0f32; 3]; width as usize * height as usize];
    decoder
        .read_image(bytemuck::cast_slice_mut(&mut pixels))
        .map_err(|error| {
            let found = match error {
                ImageError::IoError(_) => "the end of the file".into(),
                error => error.to_string(),
            };
            Objection::new("pixels", format_args!("{width} x {height} pixels"), found)
        })?;
    for pixel in &mut pixels {
        for (channel, divisor) in pixel.iter_mut().zip(divisors) {
            *channel /= divisor;
        }
    }
    Ok((width, height, pixels))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn encode_radiance(width: u32, height: u32, pixels: &[[f32; 3]]) -> Vec<u8> {
        let mut bytes = Vec::new();
        let pixels: Vec<_> = pixels.iter().map(|pixel| image::Rgb(*pixel)).collect();
        image::codecs::hdr::HdrEncoder::new(&mut bytes)
            .encode(&pixels, width as usize, height as usize)
            .unwrap();
        bytes
    }

    fn encode_exr(
        size: (usize, usize),
        names: &[&str],
        sample: impl Fn(usize, usize) -> f32,
        data_window: Option<(i32, i32)>,
    ) -> Vec<u8> {
        use exr::prelude::*;
        let list = names
            .iter()
            .enumerate()
            .map(|(channel, name)| {
                let values = (0..size.0 * size.1).map(|index| sample(channel, index));
                // Alternate the sample type: both must be read.
                let samples = if channel % 2 == 0 {
                    FlatSamples::F32(values.collect())
                } else {
                    FlatSamples::F16(values.map(f16::from_f32).collect())
                };
                AnyChannel::new(*name, samples)
            })
            .collect();
        let mut attributes = LayerAttributes::named("layer");
        if let Some((x, y)) = data_window {
            attributes.layer_position = Vec2(x, y);
        }
        let layer = Layer::new(
            size,
            attributes,
            Encoding::FAST_LOSSLESS,
            AnyChannels::sort(list),
        );
        let mut image = Image::from_layer(layer);
        if data_window.is_some() {
            image.attributes.display_window = IntegerBounds::new((0, 0), (8, 4));
        }
        let mut bytes = Cursor::new(Vec::new());
        image
            .write()
            .non_parallel()
            .to_buffered(&mut bytes)
            .unwrap();
        bytes.into_inner()
    }

    fn decode_any(bytes: &[u8]) -> Result<LatLong, Objection> {
        let reading = Reading {
            any_shape: true,
            ..Reading::default()
        };
        parse(bytes, &reading)
    }

    fn message(result: Result<LatLong, Objection>) -> String {
        let objection = result.expect_err("an error");
        format!(
            "{}: {} / {}",
            objection.place, objection.expected, objection.found
        )
    }

    #[test]
    fn radiance_files_are_read() {
        let pixels: Vec<[f32; 3]> = (0..32).map(|i| [i as f32, 0.5, 4.0]).collect();
        let bytes = encode_radiance(8, 4, &pixels);
        let image = decode_any(&bytes).ok().unwrap();
        assert_eq!((image.width, image.height, image.repaired), (8, 4, 0));
        for (read, written) in image.pixels.iter().zip(&pixels) {
            // RGBE keeps eight bits of the largest channel.
            let step = written[0].max(4.0) / 128.0;
            assert!(
                (0..3).all(|c| (read[c] - written[c]).abs() <= step),
                "{read:?} {written:?}"
            );
        }
        let text = String::from_utf8_lossy(&bytes).into_owned();
        assert!(text.starts_with("#?RADIANCE\n"));
        let exposed = [b"#?RGBE\nEXPOSURE=2\n", &bytes[b"#?RADIANCE\n".len()..]].concat();
        let halved = decode_any(&exposed).ok().unwrap();
        assert_eq!(halved.pixels[5][2], image.pixels[5][2] / 2.0);
    }

    #[test]
    fn exr_files_of_any_channel_naming_are_read() {
        let sample = |channel: usize, index: usize| (channel * 100 + index) as f32;
        for names in [
            &["R", "G", "B"][..],
            &["A", "view.red", "view.green", "view.blue"],
        ] {
            let image = decode_any(&encode_exr((4, 2), names, sample, None))
                .ok()
                .unwrap();
            let first = names.len() - 3;
            let expected = [first, first + 1, first + 2].map(|channel| sample(channel, 5));
            assert_eq!(
                (image.width, image.height, image.pixels[5]),
                (4, 2, expected)
            );
        }
        let image = decode_any(&encode_exr((4, 2), &["Y"], sample, None))
            .ok()
            .unwrap();
        assert_eq!(image.pixels[5], [5.0; 3]);
        let error = message(decode_any(&encode_exr((4, 2), &["Z", "id"], sample, None)));
        assert!(
            error.starts_with("channels: red, green and blue") && error.contains('Z'),
            "{error}"
        );
        let error = message(decode_any(&encode_exr(
            (4, 2),
            &["Y", "RY", "BY"],
            sample,
            None,
        )));
        assert!(error.contains("RY"), "{error}");
    }

    #[test]
    fn exr_data_windows_are_placed_in_the_display_window() {
        let sample = |_, index: usize| 1.0 + index as f32;
        let image = decode_any(&encode_exr((4, 2), &["R", "G", "B"], sample, Some((6, 1))))
            .ok()
            .unwrap();
        assert_eq!((image.width, image.height), (8, 4));
        assert_eq!(image.pixels[8 + 6], [1.0; 3]);
        assert_eq!(image.pixels[8 + 7], [2.0; 3]);
        assert_eq!(image.pixels[16 + 7], [6.0; 3]);
        assert_eq!(
            image.pixels.iter().filter(|pixel| pixel[0] > 0.0).count(),
            4
        );
    }

    #[test]
    fn broken_files_give_an_error_that_names_the_place() {
        assert!(message(decode_any(b"")).starts_with("first bytes"));
        assert!(message(decode_any(b"\x89PNG")).contains(r#""\x89PNG""#));
        let huge = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 60000 +X 60000\n";
        assert!(message(decode_any(huge)).starts_with("image size"));
        let empty = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 0 +X 8\n";
        assert!(message(decode_any(empty)).starts_with("image size"));
        let xyz = b"#?RADIANCE\nFORMAT=32-bit_rle_xyze\n\n-Y 8 +X 8\n";
        assert!(message(decode_any(xyz)).starts_with("header"));
        let dark = b"#?RADIANCE\nEXPOSURE=0\n\n-Y 8 +X 8\n";
        assert!(message(decode_any(dark)).contains("EXPOSURE"));
        let missing = load(Path::new("no/such/file.hdr")).unwrap_err().to_string();
        assert!(missing.contains("no/such/file.hdr"), "{missing}");
    }

    #[test]
    fn every_prefix_of_a_file_is_an_error_and_no_flipped_byte_panics() {
        let pixels: Vec<[f32; 3]> = (0..32).map(|i| [i as f32, 0.5, 4.0]).collect();
        let radiance = encode_radiance(8, 4, &pixels);
        let exr = encode_exr((8, 4), &["R", "G", "B"], |c, i| (c * i) as f32, None);
        for bytes in [radiance, exr] {
            for end in 0..bytes.len() {
                assert!(
                    decode_any(&bytes[..end]).is_err(),
                    "prefix of {end} of {}",
                    bytes.len()
                );
            }
            for position in 0..bytes.len() {
                for value in [0, 0x7f, 0x80, 0xff, bytes[position] ^ 1] {
                    let mut broken = bytes.clone();
                    broken[position] = value;
                    // Any answer will do, as long as there is one.
                    let _ = decode_any(&broken);
                }
            }
        }
    }
}
