//! Pictures to files.

#[cfg(not(target_family = "wasm"))]
use std::path::Path;

#[cfg(not(target_family = "wasm"))]
use relight_lab::image_file;
#[cfg(not(target_family = "wasm"))]
use relight_runtime::Image;

/// Writes premultiplied RGBA8 as a PNG, with straight alpha as that format has it.
#[cfg(not(target_family = "wasm"))]
pub fn png(path: &Path, [width, height]: [u32; 2], pixels: &[u8]) -> anyhow::Result<()> {
    let bytes = encode_png([width, height], &[pixels], 0)?;
    Ok(relight_format::write_file(path, &bytes)?)
}

/// One PNG, or an animated one (APNG) that plays for ever, of frames that take `1 / rate` seconds.
pub fn encode_png(
    [width, height]: [u32; 2],
    frames: &[&[u8]],
    rate: u16,
) -> anyhow::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, width, height);
    encoder.set_color(png::ColorType::Rgba);
    encoder.set_depth(png::BitDepth::Eight);
    if frames.len() > 1 {
        encoder.set_animated(frames.len() as u32, 0)?;
        encoder.set_frame_delay(1, rate.max(1))?;
    }
    let mut writer = encoder.write_header()?;
    for frame in frames {
        writer.write_image_data(&straight(frame))?;
    }
    writer.finish()?;
    Ok(bytes)
}

/// Premultiplied to straight alpha.
fn straight(pixels: &[u8]) -> Vec<u8> {
    let mut straight = pixels.to_vec();
    for pixel in straight.chunks_exact_mut(4) {
        let alpha = u32::from(pixel[3]);
        if alpha > 0 && alpha < 255 {
            for value in &mut pixel[..3] {
                *value = ((u32::from(*value) * 255 + alpha / 2) / alpha).min(255) as u8;
            }
        }
    }
    straight
}

/// Writes linear radiance and coverage as OpenEXR.
#[cfg(not(target_family = "wasm"))]
pub fn exr(path: &Path, image: &Image) -> anyhow::Result<()> {
    let image = image_file::Image {
        width: image.width,
        height: image.height,
        pixels: image.pixels.clone(),
        variance: None,
    };
    Ok(image_file::write_exr(path, &image)?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn straight_alpha_undoes_premultiplication() {
        assert_eq!(straight(&[64, 32, 0, 128]), [128, 64, 0, 128]);
        assert_eq!(
            straight(&[9, 8, 7, 255, 0, 0, 0, 0]),
            [9, 8, 7, 255, 0, 0, 0, 0]
        );
    }

    #[test]
    fn an_animation_holds_all_its_frames() {
        let frames: Vec<Vec<u8>> = (0..3u8).map(|i| vec![80 * i; 4 * 6 * 5]).collect();
        let frames: Vec<&[u8]> = frames.iter().map(Vec::as_slice).collect();
        let bytes = encode_png([6, 5], &frames, 12).unwrap();
        let mut reader = png::Decoder::new(std::io::Cursor::new(bytes))
            .read_info()
            .unwrap();
        assert_eq!(reader.info().animation_control().unwrap().num_frames, 3);
        let mut buffer = vec![0; 4 * 6 * 5];
        for frame in &frames {
            reader.next_frame(&mut buffer).unwrap();
            assert_eq!(buffer, straight(frame));
        }
    }
}
