//! Pictures of a fit: the image, the lobes, their difference, and the error over the number
//! of lobes.

use std::fmt::Write as _;

use relight_format::Environment;

use super::Rung;
use super::measure::render_all;
use crate::environment::hdr::LatLong;
use crate::report::picture::png;
use crate::report::plot::{self, Curve};

/// 8-bit sRGB pictures of one size, as PNG files in memory.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Pictures {
    /// The image.
    pub original: Vec<u8>,
    /// The radiance of lobes and sources.
    pub fit: Vec<u8>,
    /// |fit − original|.
    pub difference: Vec<u8>,
}

/// Exposes image and fit alike, the image's mean radiance to a quarter of white, and
/// compresses highlights (Reinhard et al. 2002, on each channel).
pub fn pictures(image: &LatLong, environment: &Environment) -> Result<Pictures, image::ImageError> {
    let fit = render_all(environment, image.width, image.height);
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

/// The errors over the number of lobes, as CSV with a header.
pub fn curve_csv(curve: &[Rung]) -> String {
    let mut csv = String::from(
        "lobes,relative_l2,irradiance_error,energy_error_red,energy_error_green,energy_error_blue\n",
    );
    for rung in curve {
        let [red, green, blue] = rung.energy_error;
        let (l2, irradiance) = (rung.relative_l2, rung.irradiance_error);
        writeln!(
            csv,
            "{},{l2},{irradiance},{red},{green},{blue}",
            rung.allowed
        )
        .expect("a String accepts every write");
    }
    csv
}

/// The errors over the number of lobes as SVG; `None` where all are zero.
pub fn curve_svg(curve: &[Rung]) -> Option<String> {
    let line = |name: &str, error: fn(&Rung) -> f32| Curve {
        name: name.to_owned(),
        points: (curve.iter())
            .map(|rung| [rung.allowed as f64, f64::from(error(rung))])
            .collect(),
    };
    let lines = [
        line("relative L2", |rung| rung.relative_l2),
        line("irradiance", |rung| rung.irradiance_error),
    ];
    plot::svg(
        "lobes of an environment",
        ["lobes", "relative error"],
        &lines,
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use relight_format::Lobe;

    #[test]
    fn the_curve_names_every_rung() {
        let rung = |allowed: usize, relative_l2: f32| Rung {
            allowed,
            lobes: Vec::new(),
            relative_l2,
            energy_error: [0.0, 1e-8, -1e-8],
            irradiance_error: 0.1 * relative_l2,
        };
        let curve = [rung(1, 0.9), rung(2, 0.5), rung(3, 0.0)];
        let csv = curve_csv(&curve);
        assert_eq!(csv.lines().count(), 4);
        assert!(
            csv.contains("\n2,0.5,0.05,0,0.00000001,-0.00000001\n"),
            "{csv}"
        );
        let svg = curve_svg(&curve).unwrap();
        assert!(svg.starts_with("<svg") && svg.contains("irradiance"));
        assert!(curve_svg(&[]).is_none());
    }

    #[test]
    fn pictures_are_png_of_the_image_size() {
        let lobe = Lobe {
            axis: [0.0, 1.0, 0.0],
            sharpness: 5.0,
            amplitude: [1.0, 0.5, 0.2],
            reserved: 0.0,
        };
        let environment = Environment {
            lobes: vec![lobe],
            ..Environment::default()
        };
        let image = render_all(&environment, 32, 16);
        let pictures = pictures(&image, &environment).unwrap();
        assert_eq!(pictures.original, pictures.fit);
        let decode = |bytes: &[u8]| image::load_from_memory(bytes).unwrap().into_rgb8();
        let (original, difference) = (decode(&pictures.original), decode(&pictures.difference));
        assert_eq!((original.width(), original.height()), (32, 16));
        assert!(original.get_pixel(0, 0).0[0] > original.get_pixel(0, 15).0[0]);
        assert!(difference.pixels().all(|pixel| pixel.0 == [0; 3]));
    }
}
