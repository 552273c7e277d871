//! Pictures of a fit: the image, the lobes, and their difference.

use relight_format::Lobe;

use super::measure::render;
use crate::hdr::LatLong;
use crate::picture::png;

/// 8-bit sRGB pictures of one size, as PNG files in memory.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Pictures {
    /// The image.
    pub original: Vec<u8>,
    /// The lobes' radiance.
    pub fit: Vec<u8>,
    /// |fit − original|.
    pub difference: Vec<u8>,
}

/// Exposes image and lobes alike, the image's mean radiance to a quarter of white, and
/// compresses highlights (Reinhard et al. 2002, on each channel).
pub fn pictures(image: &LatLong, lobes: &[Lobe]) -> Result<Pictures, image::ImageError> {
    let fit = render(lobes, image.width, image.height);
    let mean = image.total_power().iter().sum::<f64>() / (12.0 * std::f64::consts::PI);
    let exposure = if mean > 0.0 {
        (1.0 / (3.0 * mean)) as f32
    } else {
        1.0
    };
    let difference: Vec<[f32; 3]> = image
        .pixels
        .iter()
        .zip(&fit.pixels)
        .map(|(image, fit)| [0, 1, 2].map(|channel| (fit[channel] - image[channel]).abs()))
        .collect();
    let encode = |pixels: &[[f32; 3]]| png(image.width, image.height, pixels, exposure);
    Ok(Pictures {
        original: encode(&image.pixels)?,
        fit: encode(&fit.pixels)?,
        difference: encode(&difference)?,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pictures_are_png_of_the_image_size() {
        let lobe = Lobe {
            axis: [0.0, 1.0, 0.0],
            sharpness: 5.0,
            amplitude: [1.0, 0.5, 0.2],
            reserved: 0.0,
        };
        let image = render(&[lobe], 32, 16);
        let pictures = pictures(&image, &[lobe]).unwrap();
        assert_eq!(pictures.original, pictures.fit);
        let decode = |bytes: &[u8]| image::load_from_memory(bytes).unwrap().into_rgb8();
        let (original, difference) = (decode(&pictures.original), decode(&pictures.difference));
        assert_eq!((original.width(), original.height()), (32, 16));
        assert!(original.get_pixel(0, 0).0[0] > original.get_pixel(0, 15).0[0]);
        assert!(difference.pixels().all(|pixel| pixel.0 == [0; 3]));
    }
}
