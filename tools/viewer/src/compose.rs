//! Linear pictures to what the screen shows: background, split, difference and tone curve.

use glam::{Mat3, Quat, Vec3, Vec4};
use rayon::prelude::*;
use relight_format::Camera;
use relight_runtime::{Image, Panorama};
use relight_shading::camera::View;
use relight_shading::catcher;
use relight_shading::tonemap;

use crate::state::{Background, Curve, Layout, Settings};

/// Linear grey where there is neither scene nor image.
const GREY: f32 = 0.035;
/// Exposed radiance of the plate over which caught shadows are exact in pictures of display colours;
/// over darker and brighter ones they are a little off, as those are coded.
const PLATE: f32 = 0.4;
/// Where exposed radiance is cut off: beyond it every curve is white, and infinity is not a colour.
const BRIGHTEST: f32 = 1e6;
/// Entries of the table of the sRGB curve: finer than its codes wherever it is steepest.
const CODES: usize = 1 << 14;

/// How pictures are shown.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Look {
    /// One, two or their difference.
    pub layout: Layout,
    /// Where the divider is, fraction of the width.
    pub divider: f32,
    /// Multiplies differences.
    pub difference_scale: f32,
    /// Behind the scene.
    pub background: Background,
    /// Tone curve.
    pub curve: Curve,
    /// Stops.
    pub exposure: f32,
    /// Whether coverage may be that of caught shadows, whose radiance is light to be added.
    pub catches: bool,
}

impl From<&Settings> for Look {
    fn from(settings: &Settings) -> Self {
        Self {
            layout: settings.layout,
            divider: settings.divider,
            difference_scale: settings.difference_scale,
            background: settings.background,
            curve: settings.curve,
            exposure: settings.exposure,
            catches: false,
        }
    }
}

/// What is behind the scene and how it is turned.
#[derive(Clone, Copy, Debug)]
pub struct Sky<'a> {
    /// All of it.
    pub panorama: Option<&'a Panorama>,
    /// Turns it.
    pub rotation: Quat,
}

/// Premultiplied sRGB, RGBA8, row 0 first, of `size`. Pictures may be smaller; the second is that
/// right of the divider.
pub fn compose(
    pictures: [Option<&Image>; 2],
    look: &Look,
    sky: &Sky,
    camera: &Camera,
    size: [u32; 2],
) -> Vec<u8> {
    let [width, height] = size;
    let view = View::new(camera, width, height, 1.0);
    let to_sky = Mat3::from_quat(sky.rotation).transpose();
    let behind = match (look.background, sky.panorama) {
        (Background::Sharp, Some(image)) => relight_runtime::Background::sharp(image),
        (Background::Blurred, Some(image)) => relight_runtime::Background::blurred(image),
        _ => relight_runtime::Background::Transparent,
    };
    let scale = look.exposure.exp2();
    let codes = code_table();
    let divider = (look.divider * width as f32).round() as u32;
    let [first, second] = pictures;
    let mut pixels = vec![0u8; 4 * width as usize * height as usize];
    let row = |(y, row): (usize, &mut [u8])| {
        for (x, out) in row.chunks_exact_mut(4).enumerate() {
            let at =
                |image: Option<&Image>| image.map_or([0.0; 4], |image| sample(image, x, y, size));
            let shown = match look.layout {
                Layout::Difference => {
                    let (a, b) = (at(first), at(second));
                    let factor = scale * look.difference_scale;
                    let apart = [0, 1, 2].map(|i| factor * (a[i] - b[i]).abs());
                    let [r, g, b] = apart.map(|value| code(&codes, value.min(1.0)));
                    out.copy_from_slice(&[r, g, b, 255]);
                    continue;
                }
                Layout::Split if x as u32 >= divider => at(second),
                Layout::Split | Layout::One => at(first),
            };
            let coverage = shown[3].clamp(0.0, 1.0);
            if look.catches && coverage < 1.0 {
                let direction = view.pixel_direction(x as u32, y as u32).normalize();
                let behind = match look.background {
                    Background::Transparent => None,
                    _ => Some(
                        (behind.radiance(direction, &to_sky))
                            .map_or(Vec3::splat(GREY), |radiance| scale * radiance),
                    ),
                };
                let exposed = [0, 1, 2].map(|i| scale * shown[i]);
                let caught = caught(look.curve, exposed.into(), coverage, behind);
                out.copy_from_slice(&caught);
                continue;
            }
            let mut color = Vec3::ZERO;
            if coverage > 0.0 {
                let radiance = Vec3::new(shown[0], shown[1], shown[2]) / coverage;
                color = coverage * curve(look.curve, scale * radiance);
            }
            let mut alpha = coverage;
            if coverage < 1.0 && look.background != Background::Transparent {
                let direction = view.pixel_direction(x as u32, y as u32).normalize();
                let behind = behind.radiance(direction, &to_sky);
                let behind = behind.map_or(Vec3::splat(GREY), |radiance| {
                    curve(look.curve, scale * radiance)
                });
                color += (1.0 - coverage) * behind;
                alpha = 1.0;
            }
            if alpha <= 0.0 {
                continue;
            }
            let codes = (color / alpha).to_array().map(|value| code(&codes, value));
            for (out, code) in out.iter_mut().zip(codes) {
                *out = (f32::from(code) * alpha).round() as u8;
            }
            out[3] = (255.0 * alpha).round() as u8;
        }
    };
    pixels
        .par_chunks_mut(4 * width.max(1) as usize)
        .enumerate()
        .for_each(row);
    pixels
}

/// A pixel of some coverage as bytes: over what is behind it, or, without, such that over [`PLATE`] it is
/// what the light of both makes. Radiance is exposed.
fn caught(curve: Curve, radiance: Vec3, coverage: f32, behind: Option<Vec3>) -> [u8; 4] {
    let code = |radiance: Vec3| -> Vec3 {
        let light = self::curve(curve, radiance).to_array();
        light.map(tonemap::encode_srgb).into()
    };
    let bytes = |color: Vec4| color.to_array().map(|value| (255.0 * value).round() as u8);
    if let Some(behind) = behind {
        return bytes(code(radiance + (1.0 - coverage) * behind).extend(1.0));
    }
    let plate = Vec3::splat(PLATE);
    let over = code(radiance + (1.0 - coverage) * plate);
    let found = catcher::catch(over, code(plate));
    // Colours that are brighter than their coverage are no colours of bytes.
    bytes(found.truncate().min(Vec3::splat(found.w)).extend(found.w))
}

/// A picture at a pixel of one of another size, between the four nearest pixels.
fn sample(image: &Image, x: usize, y: usize, [width, height]: [u32; 2]) -> [f32; 4] {
    let columns = image.width as usize;
    if [image.width, image.height] == [width, height] {
        return image.pixels[y * columns + x];
    }
    let place = |index: usize, side: u32, from: u32| {
        let place = (index as f32 + 0.5) * from as f32 / side as f32 - 0.5;
        let low = place.floor().max(0.0);
        let last = from.saturating_sub(1) as usize;
        let low_index = (low as usize).min(last);
        (
            low_index,
            (low_index + 1).min(last),
            (place - low).clamp(0.0, 1.0),
        )
    };
    let (left, right, fx) = place(x, width, image.width);
    let (top, bottom, fy) = place(y, height, image.height);
    let at = |column: usize, row: usize| image.pixels[row * columns + column];
    let mix = |a: [f32; 4], b: [f32; 4], t: f32| [0, 1, 2, 3].map(|i| a[i] + t * (b[i] - a[i]));
    mix(
        mix(at(left, top), at(right, top), fx),
        mix(at(left, bottom), at(right, bottom), fx),
        fy,
    )
}

/// Exposed radiance to the light of a screen, in [0, 1].
pub fn curve(curve: Curve, radiance: Vec3) -> Vec3 {
    let radiance = radiance.max(Vec3::ZERO).min(Vec3::splat(BRIGHTEST));
    let light = match curve {
        Curve::Neutral => tonemap::neutral(radiance),
        Curve::Clip => radiance,
        Curve::Reinhard => radiance / (1.0 + radiance),
        Curve::Filmic => {
            (radiance * (2.51 * radiance + 0.03)) / (radiance * (2.43 * radiance + 0.59) + 0.14)
        }
    };
    light.clamp(Vec3::ZERO, Vec3::ONE)
}

fn code_table() -> Vec<u8> {
    (0..=CODES)
        .map(|i| (255.0 * tonemap::encode_srgb(i as f32 / CODES as f32)).round() as u8)
        .collect()
}

fn code(table: &[u8], value: f32) -> u8 {
    table[(value.clamp(0.0, 1.0) * CODES as f32 + 0.5) as usize]
}

/// Root mean square of the difference over the mean of the second picture, covered pixels of both,
/// all channels; `None` where nothing is covered, or sizes differ.
pub fn relative_difference(a: &Image, b: &Image) -> Option<f64> {
    if [a.width, a.height] != [b.width, b.height] {
        return None;
    }
    let (mut squares, mut sum, mut count) = (0.0, 0.0, 0u64);
    for (a, b) in a.pixels.iter().zip(&b.pixels) {
        if a[3] > 0.5 && b[3] > 0.5 {
            for channel in 0..3 {
                squares += f64::from(a[channel] - b[channel]).powi(2);
                sum += f64::from(b[channel]);
                count += 1;
            }
        }
    }
    (sum > 0.0).then(|| (squares / count as f64).sqrt() / (sum / count as f64))
}

#[cfg(test)]
mod tests {
    use super::*;
    use relight_format::FieldOfView;

    const CAMERA: Camera = Camera {
        position: [0.0; 3],
        target: [0.0, 0.0, -1.0],
        up: [0.0, 1.0, 0.0],
        field_of_view: FieldOfView::Y(1.0),
    };
    const SKY: Sky<'static> = Sky {
        panorama: None,
        rotation: Quat::IDENTITY,
    };

    fn look() -> Look {
        Look {
            background: Background::Transparent,
            curve: Curve::Clip,
            ..Look::from(&Settings::default())
        }
    }

    fn image(width: u32, height: u32, pixel: [f32; 4]) -> Image {
        Image {
            width,
            height,
            pixels: vec![pixel; (width * height) as usize],
        }
    }

    #[test]
    fn the_neutral_curve_is_the_runtimes() {
        let mut picture = image(64, 1, [0.0, 0.0, 0.0, 1.0]);
        for (i, pixel) in picture.pixels.iter_mut().enumerate() {
            *pixel = [0.03 * i as f32, 0.001 * i as f32, 0.3, 1.0];
        }
        let look = Look {
            curve: Curve::Neutral,
            exposure: 1.0,
            ..look()
        };
        let composed = compose([Some(&picture), None], &look, &SKY, &CAMERA, [64, 1]);
        let expected = relight_runtime::twin::tonemap(&picture, 2.0);
        for (found, expected) in composed.iter().zip(&expected) {
            assert!(found.abs_diff(*expected) <= 1, "{found} {expected}");
        }
    }

    #[test]
    fn the_divider_parts_two_pictures() {
        let (red, green) = (
            image(10, 4, [1.0, 0.0, 0.0, 1.0]),
            // Half the size: enlarged.
            image(5, 2, [0.0, 1.0, 0.0, 1.0]),
        );
        let look = Look {
            layout: Layout::Split,
            divider: 0.3,
            ..look()
        };
        let pixels = compose([Some(&red), Some(&green)], &look, &SKY, &CAMERA, [10, 4]);
        for (i, pixel) in pixels.chunks(4).enumerate() {
            let expected = if i % 10 < 3 {
                [255, 0, 0, 255]
            } else {
                [0, 255, 0, 255]
            };
            assert_eq!(pixel, expected, "{i}");
        }
    }

    #[test]
    fn equal_pictures_have_no_difference_and_others_are_scaled() {
        let (a, b) = (
            image(3, 3, [0.5, 0.25, 0.0, 1.0]),
            image(3, 3, [0.5, 0.0, 0.0, 1.0]),
        );
        let look = Look {
            layout: Layout::Difference,
            difference_scale: 4.0,
            ..look()
        };
        let same = compose([Some(&a), Some(&a)], &look, &SKY, &CAMERA, [3, 3]);
        assert!(same.chunks(4).all(|pixel| pixel == [0, 0, 0, 255]));
        let apart = compose([Some(&a), Some(&b)], &look, &SKY, &CAMERA, [3, 3]);
        assert!(apart.chunks(4).all(|pixel| pixel == [0, 255, 0, 255]));
        assert_eq!(relative_difference(&a, &a), Some(0.0));
        // √(0.25²/3) over a mean of 0.5/3.
        let found = relative_difference(&a, &b).unwrap();
        assert!(
            (found - (0.0625f64 / 3.0).sqrt() * 6.0).abs() < 1e-6,
            "{found}"
        );
    }

    #[test]
    fn the_background_turns_with_the_light_and_may_be_absent() {
        // White towards −Z, black elsewhere.
        let white = |i: usize| f32::from(u8::from(!(8..56).contains(&(i % 64))));
        let pixels: Vec<_> = (0..64 * 32).map(|i| [white(i); 3]).collect();
        let panorama = Panorama::from_lat_long([64, 32], &pixels).expect("an image");
        let empty = image(9, 9, [0.0; 4]);
        let show = |background, rotation| {
            let sky = Sky {
                panorama: Some(&panorama),
                rotation,
            };
            let look = Look {
                background,
                ..look()
            };
            compose([Some(&empty), None], &look, &sky, &CAMERA, [9, 9])[4 * 40..][..4].to_vec()
        };
        assert_eq!(show(Background::Sharp, Quat::IDENTITY), [255; 4]);
        let half = Quat::from_rotation_y(std::f32::consts::PI);
        assert_eq!(show(Background::Sharp, half), [0, 0, 0, 255]);
        assert_eq!(show(Background::Transparent, half), [0; 4]);
        assert_eq!(show(Background::Off, half)[3], 255);
    }
}
