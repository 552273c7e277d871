//! OpenEXR images: their headers, which channels are colour, and their pixels in linear Rec.709.

use std::io::{Cursor, Read};

use exr::prelude::{FlatSamples, MetaData, ReadChannels, ReadLayers};
use glam::{DMat3, DVec3};

use super::hdr::{MAX_PIXELS, Pixels, Reading, check_shape, check_size};
use super::primaries;
use crate::error::Objection;

/// Samples of an OpenEXR file per pixel that may be read: layers and channels besides those
/// of colour are decoded too.
const MAX_SAMPLES_PER_PIXEL: u64 = 8;

pub(super) fn exr_metadata(reader: impl Read) -> Result<MetaData, Objection> {
    let header = |error| Objection::new("header", "a flat OpenEXR image", error);
    MetaData::read_from_buffered(reader, false).map_err(header)
}

/// Checks the headers of a file of so many bytes; gives the size of the display window.
pub(super) fn check_exr(
    metadata: &MetaData,
    bytes: u64,
    reading: &Reading,
) -> Result<(u32, u32), Objection> {
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

pub(super) fn decode_exr(bytes: &[u8], reading: &Reading) -> Result<Pixels, Objection> {
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
