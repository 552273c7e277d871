//! Lat-long HDR images: loading, repair, directions, solid angles and sampling.
//!
//! Row 0 is +Y; with θ from +Y and φ about it, a direction is
//! (sinθ sinφ, cosθ, −sinθ cosφ), and u = φ/2π, v = θ/π run over the image.

use relight_format::math;
use std::f64::consts::{PI, TAU};
#[cfg(not(target_family = "wasm"))]
use std::fs::File;
#[cfg(not(target_family = "wasm"))]
use std::io::BufReader;
use std::io::{BufRead, Cursor, Read};
#[cfg(not(target_family = "wasm"))]
use std::path::Path;

use exr::prelude::{FlatSamples, MetaData, ReadChannels, ReadLayers};
use glam::{DMat3, DVec3, Vec3};
use image::codecs::hdr::HdrDecoder;
use image::{ImageDecoder, ImageError};

use super::primaries;
#[cfg(not(target_family = "wasm"))]
use crate::error::Error;
use crate::error::{Objection, first_bytes};
#[cfg(not(target_family = "wasm"))]
use crate::files::{Access, Files};

/// Most pixels that an image may have whatever is asked for: 32,768 × 16,384, 6 GiB as f32 RGB.
pub const MAX_PIXELS: u64 = 1 << 29;
/// How far a side may be from what the other asks of it, as a part of it: maps are cropped by
/// a row or two.
const SHAPE_TOLERANCE: f64 = 0.01;
/// Samples of an OpenEXR file per pixel that may be read: layers and channels besides those
/// of colour are decoded too.
const MAX_SAMPLES_PER_PIXEL: u64 = 8;

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

/// A lat-long image of finite, non-negative radiance over the whole sphere.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LatLong {
    /// Columns; at least 1.
    pub width: u32,
    /// Rows; at least 1.
    pub height: u32,
    /// Linear Rec.709 radiance, row by row from +Y.
    pub pixels: Vec<[f32; 3]>,
    /// Pixels with a NaN, infinite or negative channel that was replaced; colours outside Rec.709
    /// are among the negative ones.
    pub repaired: u64,
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
fn check_size(width: u64, height: u64, reading: &Reading) -> Result<(u32, u32), Objection> {
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
fn check_shape(width: u32, height: u32, reading: &Reading) -> Result<(), Objection> {
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

type Pixels = (u32, u32, Vec<[f32; 3]>);

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

fn exr_metadata(reader: impl Read) -> Result<MetaData, Objection> {
    let header = |error| Objection::new("header", "a flat OpenEXR image", error);
    MetaData::read_from_buffered(reader, false).map_err(header)
}

/// Checks the headers of a file of so many bytes; gives the size of the display window.
fn check_exr(metadata: &MetaData, bytes: u64, reading: &Reading) -> Result<(u32, u32), Objection> {
    let mut samples = 0u64;
    for layer in &metadata.headers {
        let (width, height) = check_size(
            layer.layer_size.width() as u64,
            layer.layer_size.height() as u64,
            reading,
        )?;
        samples =
            samples.saturating_add(width as u64 * height as u64 * layer.channels.list.len() as u64);
        if layer.deep {
            return Err(Objection::new("header", "a flat image", "deep data"));
        }
        if layer.own_attributes.environment_map == Some(exr::meta::attribute::EnvironmentMap::Cube)
        {
            return Err(Objection::new("attribute envmap", "latlong", "cube"));
        }
    }
    // So that a small file cannot ask for much memory. Deflate packs at best 1,032:1, and
    // no other OpenEXR compression packs as much; a sample has at least two bytes.
    let packed = bytes.saturating_mul(1032) / 2;
    if samples > packed {
        return Err(Objection::new(
            "header",
            format_args!("at most {packed} samples in {bytes} bytes"),
            samples,
        ));
    }
    let most = MAX_SAMPLES_PER_PIXEL * reading.max_pixels.min(MAX_PIXELS);
    if samples > most {
        return Err(Objection::new(
            "header",
            format_args!("at most {most} samples in all channels and layers (--limit-pixels)"),
            samples,
        ));
    }
    let window = match metadata.headers.first() {
        Some(header) => header.shared_attributes.display_window,
        None => return Err(Objection::new("header", "at least one layer", "none")),
    };
    let (width, height) = (window.size.width() as u64, window.size.height() as u64);
    let (width, height) = check_size(width, height, reading)?;
    check_shape(width, height, reading)?;
    Ok((width, height))
}

fn decode_exr(bytes: &[u8], reading: &Reading) -> Result<Pixels, Objection> {
    let metadata = exr_metadata(Cursor::new(bytes))?;
    let (width, height) = check_exr(&metadata, bytes.len() as u64, reading)?;
    let to_rec709 = match metadata.headers[0].shared_attributes.chromaticities {
        Some(chromaticities) => primaries::to_rec709(&chromaticities).ok_or_else(|| {
            Objection::new(
                "attribute chromaticities",
                "three primaries that span a triangle about a white",
                format_args!("{chromaticities:?}"),
            )
        })?,
        None => DMat3::IDENTITY,
    };
    // Products of infinite pixels with zeros would be no numbers.
    let to_rec709 = (to_rec709 != DMat3::IDENTITY).then_some(to_rec709);
    let image = exr::prelude::read()
        .no_deep_data()
        .largest_resolution_level()
        .all_channels()
        .all_layers()
        .all_attributes()
        .non_parallel()
        .from_buffered(Cursor::new(bytes))
        .map_err(|error| Objection::new("pixels", "a complete OpenEXR image", error))?;

    let names = |layer: &exr::image::Layer<exr::image::AnyChannels<FlatSamples>>| -> Vec<String> {
        layer
            .channel_data
            .list
            .iter()
            .map(|channel| channel.name.to_string())
            .collect()
    };
    let (layer, channels) = image
        .layer_data
        .iter()
        .find_map(|layer| Some((layer, rgb_channels(&names(layer))?)))
        .ok_or_else(|| {
            let found: Vec<String> = image.layer_data.iter().flat_map(names).collect();
            Objection::new(
                "channels",
                "red, green and blue, or luminance",
                found.join(", "),
            )
        })?;
    let channels = channels.map(|index| &layer.channel_data.list[index]);
    for channel in channels {
        if (channel.sampling.x(), channel.sampling.y()) != (1, 1) {
            return Err(Objection::new(
                "channel sampling",
                "1 x 1",
                format_args!("{:?}", channel.sampling),
            ));
        }
    }

    let window = image.attributes.display_window;
    let (data_width, data_height) = (layer.size.width(), layer.size.height());
    let most = 16 * data_width as u64 * data_height as u64;
    if width as u64 * height as u64 > most {
        return Err(Objection::new(
            "display window",
            format_args!("at most {most} pixels, 16 times the data window"),
            format_args!("{width} x {height}"),
        ));
    }
    let offset = layer.attributes.layer_position;
    // Column and row of the data window's first pixel in the display window.
    let left = i64::from(offset.x()) - i64::from(window.position.x());
    let top = i64::from(offset.y()) - i64::from(window.position.y());
    let mut pixels = vec![[0f32; 3]; width as usize * height as usize];
    for (row, line) in pixels.chunks_exact_mut(width as usize).enumerate() {
        let Some(row) = usize::try_from(row as i64 - top)
            .ok()
            .filter(|&row| row < data_height)
        else {
            continue;
        };
        for (column, pixel) in line.iter_mut().enumerate() {
            let column = column as i64 - left;
            if let Some(column) = usize::try_from(column).ok().filter(|&x| x < data_width) {
                *pixel = channels.map(|channel| {
                    channel
                        .sample_data
                        .value_by_flat_index(row * data_width + column)
                        .to_f32()
                });
                if let Some(matrix) = to_rec709 {
                    *pixel = (matrix * DVec3::from(pixel.map(f64::from)))
                        .as_vec3()
                        .to_array();
                }
            }
        }
    }
    Ok((width, height, pixels))
}

/// Indices of the red, green and blue channel with a common prefix, the shortest prefix
/// first, or of one luminance channel thrice.
fn rgb_channels(names: &[String]) -> Option<[usize; 3]> {
    let split: Vec<(&str, String)> = names
        .iter()
        .map(|name| {
            let (prefix, stem) = name.rsplit_once('.').unwrap_or(("", name));
            (prefix, stem.to_ascii_lowercase())
        })
        .collect();
    let mut prefixes: Vec<&str> = split.iter().map(|(prefix, _)| *prefix).collect();
    prefixes.sort_by_key(|prefix| (prefix.len(), *prefix));
    prefixes.dedup();
    let find = |prefix: &str, stems: &[&str]| {
        split
            .iter()
            .position(|(p, stem)| *p == prefix && stems.contains(&stem.as_str()))
    };
    let rgb = prefixes.iter().find_map(|prefix| {
        Some([
            find(prefix, &["r", "red"])?,
            find(prefix, &["g", "green"])?,
            find(prefix, &["b", "blue"])?,
        ])
    });
    rgb.or_else(|| {
        prefixes.iter().find_map(|prefix| {
            // Luminance with chroma (RY, BY) is colour in another encoding, not grey.
            let chroma = find(prefix, &["ry", "by"]).is_some();
            let grey = find(prefix, &["y", "l", "luminance", "gray", "grey"])?;
            (!chroma).then_some([grey; 3])
        })
    })
}

impl LatLong {
    /// Takes any pixels and makes them finite and non-negative: NaN and negative channels
    /// become 0, infinite ones the largest finite value of the eight neighbours (columns
    /// wrap), or of the whole image where no neighbour is finite.
    ///
    /// # Panics
    /// If there are not exactly `width` × `height` pixels, or none.
    pub fn repair(width: u32, height: u32, mut pixels: Vec<[f32; 3]>) -> Self {
        assert!(!pixels.is_empty() && pixels.len() as u64 == width as u64 * height as u64);
        let (w, h) = (width as i64, height as i64);
        let bad = |value: f32| !value.is_finite() || value < 0.0;
        let broken: Vec<usize> = (0..pixels.len())
            .filter(|&index| pixels[index].into_iter().any(bad))
            .collect();
        let finite_max = |values: &mut dyn Iterator<Item = f32>| {
            values.filter(|value| value.is_finite()).reduce(f32::max)
        };
        let image_max: [f32; 3] = std::array::from_fn(|channel| {
            finite_max(&mut pixels.iter().map(|pixel| pixel[channel]))
                .unwrap_or(0.0)
                .max(0.0)
        });
        // All from the pixels as read: a repaired pixel is nobody's neighbour.
        let repaired: Vec<[f32; 3]> = broken
            .iter()
            .map(|&index| {
                let (x, y) = (index as i64 % w, index as i64 / w);
                std::array::from_fn(|channel| {
                    let value = pixels[index][channel];
                    if value.is_nan() || value < 0.0 {
                        0.0
                    } else if value.is_infinite() {
                        let mut neighbours = (-1..=1)
                            .flat_map(|dy| (-1..=1).map(move |dx| (x + dx, y + dy)))
                            .filter(|&(_, y)| (0..h).contains(&y))
                            .map(|(x, y)| pixels[(y * w + x.rem_euclid(w)) as usize][channel]);
                        finite_max(&mut neighbours)
                            .unwrap_or(image_max[channel])
                            .max(0.0)
                    } else {
                        value
                    }
                })
            })
            .collect();
        for (&index, pixel) in broken.iter().zip(repaired) {
            pixels[index] = pixel;
        }
        Self {
            width,
            height,
            pixels,
            repaired: broken.len() as u64,
        }
    }

    /// Direction of image coordinates u (columns) and v (rows), each in 0..=1; unit.
    pub fn direction_at(u: f64, v: f64) -> DVec3 {
        let ((sin_phi, cos_phi), (sin_theta, cos_theta)) =
            (math::sin_cos(TAU * u), math::sin_cos(PI * v));
        DVec3::new(sin_theta * sin_phi, cos_theta, -sin_theta * cos_phi)
    }

    /// Image coordinates of a direction of any length: u in 0..1, v in 0..=1.
    pub fn coordinates(direction: DVec3) -> (f64, f64) {
        let u = (math::atan2(direction.x, -direction.z) / TAU).rem_euclid(1.0);
        let v = math::atan2(math::hypot(direction.x, direction.z), direction.y) / PI;
        // rem_euclid rounds tiny negative numbers to 1.
        (if u < 1.0 { u } else { 0.0 }, v)
    }

    /// Direction of a pixel's centre; unit.
    pub(crate) fn direction(&self, column: u32, row: u32) -> Vec3 {
        Self::direction_at(
            (column as f64 + 0.5) / self.width as f64,
            (row as f64 + 0.5) / self.height as f64,
        )
        .as_vec3()
    }

    /// Solid angle of each pixel of a row, in steradians; over the image they sum to 4π.
    pub fn solid_angle(&self, row: u32) -> f64 {
        let half = PI / (2.0 * self.height as f64);
        let centre = (2 * row + 1) as f64 * half;
        // cos(centre − half) − cos(centre + half), without cancellation.
        TAU / self.width as f64 * 2.0 * math::sin(centre) * math::sin(half)
    }

    /// The pixel at a column and row.
    pub(crate) fn pixel(&self, column: u32, row: u32) -> Vec3 {
        self.pixels[row as usize * self.width as usize + column as usize].into()
    }

    /// Radiance from a direction of any length, bilinear between pixel centres: columns
    /// wrap around, and beyond the first and last row of centres the row is held.
    pub fn sample(&self, direction: Vec3) -> Vec3 {
        let (u, v) = Self::coordinates(direction.as_dvec3());
        let x = u * self.width as f64 - 0.5;
        let y = (v * self.height as f64 - 0.5).clamp(0.0, (self.height - 1) as f64);
        let left = (x.floor() as i64).rem_euclid(self.width as i64) as u32;
        let right = (left + 1) % self.width;
        let top = y.floor() as u32;
        let bottom = (top + 1).min(self.height - 1);
        let (fx, fy) = ((x - x.floor()) as f32, (y - y.floor()) as f32);
        let upper = self.pixel(left, top).lerp(self.pixel(right, top), fx);
        let lower = self.pixel(left, bottom).lerp(self.pixel(right, bottom), fx);
        upper.lerp(lower, fy)
    }

    /// Mean luminance of the upper and of the lower hemisphere.
    pub fn mean_luminance(&self) -> (f64, f64) {
        let mut sums = [(0.0, 0.0); 2];
        for (row, line) in self.pixels.chunks_exact(self.width as usize).enumerate() {
            let solid_angle = self.solid_angle(row as u32);
            let light = |p: &[f32; 3]| f64::from(0.2126 * p[0] + 0.7152 * p[1] + 0.0722 * p[2]);
            let (sum, weight) = &mut sums[usize::from(2 * row >= self.height as usize)];
            *sum += solid_angle * line.iter().map(light).sum::<f64>();
            *weight += solid_angle * self.width as f64;
        }
        let [upper, lower] =
            sums.map(|(sum, weight)| if weight > 0.0 { sum / weight } else { 0.0 });
        (upper, lower)
    }

    /// Integral of radiance over the sphere, per channel.
    pub fn total_power(&self) -> [f64; 3] {
        let mut power = [0.0; 3];
        for (row, line) in self.pixels.chunks_exact(self.width as usize).enumerate() {
            let weight = self.solid_angle(row as u32);
            for (channel, power) in power.iter_mut().enumerate() {
                *power += weight * line.iter().map(|pixel| pixel[channel] as f64).sum::<f64>();
            }
        }
        power
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Directions are unit vectors in f32.
    const DIRECTION_TOLERANCE: f32 = 1e-6;

    fn gradient(width: u32, height: u32) -> LatLong {
        let pixels = (0..width * height)
            .map(|i| [i as f32, (i * 7 % 13) as f32, 1.0])
            .collect();
        LatLong::repair(width, height, pixels)
    }

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
    fn solid_angles_sum_to_the_sphere() {
        for (width, height) in [(1, 1), (7, 3), (500, 250), (1024, 512)] {
            let image = gradient(width, height);
            let sum: f64 = (0..height)
                .map(|row| width as f64 * image.solid_angle(row))
                .sum();
            assert!((sum - 4.0 * PI).abs() < 1e-11, "{width} x {height}: {sum}");
        }
    }

    #[test]
    fn directions_follow_the_convention() {
        let close = |a: DVec3, b: DVec3| assert!(a.distance(b) < 1e-12, "{a} {b}");
        close(LatLong::direction_at(0.3, 0.0), DVec3::Y);
        close(LatLong::direction_at(0.0, 0.5), DVec3::NEG_Z);
        close(LatLong::direction_at(0.25, 0.5), DVec3::X);
        close(LatLong::direction_at(0.5, 0.5), DVec3::Z);
        close(LatLong::direction_at(0.75, 0.5), DVec3::NEG_X);
        let image = gradient(12, 6);
        for (column, row) in [(0, 0), (3, 2), (11, 5)] {
            let (u, v) = LatLong::coordinates(image.direction(column, row).as_dvec3() * 3.0);
            assert!((u * 12.0 - 0.5 - column as f64).abs() < 1e-5);
            assert!((v * 6.0 - 0.5 - row as f64).abs() < 1e-5);
        }
    }

    #[test]
    fn samples_at_pixel_centres_are_the_pixels() {
        let image = gradient(16, 8);
        for row in 0..8 {
            for column in 0..16 {
                let sample = image.sample(image.direction(column, row) * 2.0);
                // f32 rounding of the direction, times the gradient between pixels.
                assert!(sample.distance(image.pixel(column, row)) < 1e-3);
            }
        }
    }

    #[test]
    fn samples_wrap_in_u_and_hold_at_the_poles() {
        let image = gradient(4, 2);
        let seam = image.sample(LatLong::direction_at(0.0, 0.25).as_vec3());
        let expected = (image.pixel(3, 0) + image.pixel(0, 0)) * 0.5;
        assert!(seam.distance(expected) < 1e-4, "{seam} {expected}");
        let pole = LatLong::direction_at(0.125, 1e-9).as_vec3();
        assert!((pole - Vec3::Y).length() < DIRECTION_TOLERANCE);
        assert!(image.sample(Vec3::Y).is_finite() && image.sample(Vec3::NEG_Y).is_finite());
        let near_pole = image.sample(LatLong::direction_at(0.375, 0.01).as_vec3());
        assert!(near_pole.distance(image.pixel(1, 0)) < 1e-3);
    }

    #[test]
    fn power_of_a_constant_image_is_four_pi() {
        let image = LatLong::repair(9, 5, vec![[1.0, 2.0, 0.5]; 45]);
        for (power, radiance) in image.total_power().into_iter().zip([1.0, 2.0, 0.5]) {
            assert!((power / (4.0 * PI * radiance) - 1.0).abs() < 1e-12);
        }
    }

    #[test]
    fn broken_pixels_are_repaired_and_counted() {
        let mut pixels = vec![[1.0f32; 3]; 8 * 4];
        pixels[0] = [f32::NAN, 2.0, -1.0];
        pixels[7] = [9.0, 1.0, 1.0];
        pixels[8] = [f32::INFINITY, 1.0, 1.0];
        pixels[20] = [1.0, f32::NEG_INFINITY, 1.0];
        let image = LatLong::repair(8, 4, pixels);
        assert_eq!(image.repaired, 3);
        assert_eq!(image.pixels[0], [0.0, 2.0, 0.0]);
        // Its neighbour across the seam is the brightest.
        assert_eq!(image.pixels[8], [9.0, 1.0, 1.0]);
        assert_eq!(image.pixels[20], [1.0, 0.0, 1.0]);
        assert_eq!(image.pixels[1], [1.0; 3]);

        let mut pixels = vec![[f32::INFINITY; 3]; 25];
        pixels[24] = [5.0; 3];
        let image = LatLong::repair(5, 5, pixels);
        assert_eq!((image.repaired, image.pixels[0]), (24, [5.0; 3]));
        let image = LatLong::repair(2, 1, vec![[f32::INFINITY; 3]; 2]);
        assert_eq!(image.pixels, [[0.0; 3]; 2]);
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
