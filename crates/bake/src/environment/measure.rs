//! How far lobes are from their image.

use relight_format::math;
use std::f64::consts::{PI, TAU};

use glam::{DVec3, Vec3};
use rayon::prelude::*;
use relight_format::{Environment, Lobe, Source};

use super::level::Level;
use super::lobe::Shape;
use crate::environment::hdr::LatLong;

/// Exponent beyond which a lobe counts as zero: e⁻⁴⁰ of any f32 radiance is nothing.
const NEGLIGIBLE: f32 = 40.0;

/// The lobes' radiance at the pixel centres of a lat-long image.
pub fn render(lobes: &[Lobe], width: u32, height: u32) -> LatLong {
    let size = LatLong {
        width,
        height,
        ..LatLong::default()
    };
    let pixels = (0..height)
        .into_par_iter()
        .flat_map_iter(|row| {
            let theta = (row as f32 + 0.5) / height as f32 * std::f32::consts::PI;
            let near: Vec<&Lobe> = lobes
                .iter()
                .filter(|lobe| {
                    // Along the row the direction nearest the axis differs by this angle.
                    let angle = theta - math::acos(lobe.axis[1].clamp(-1.0, 1.0));
                    lobe.sharpness * 2.0 * math::sin(0.5 * angle).powi(2) < NEGLIGIBLE
                })
                .collect();
            let size = &size;
            (0..width).map(move |column| {
                let direction = size.direction(column, row);
                let mut sum = Vec3::ZERO;
                for lobe in &near {
                    let distance = direction.distance_squared(lobe.axis.into());
                    let exponent = 0.5 * lobe.sharpness * distance;
                    if exponent < NEGLIGIBLE {
                        sum += Vec3::from(lobe.amplitude) * math::exp(-exponent);
                    }
                }
                sum.to_array()
            })
        })
        .collect();
    LatLong { pixels, ..size }
}

/// The radiance of lobes and sources at the pixel centres of a lat-long image; sources keep their
/// light.
pub fn render_all(environment: &Environment, width: u32, height: u32) -> LatLong {
    let mut image = render(&environment.lobes, width, height);
    let mut first = 0;
    for source in &environment.sources {
        let texels = &environment.source_texels[first..][..source.texels()];
        first += texels.len();
        render_source(source, texels, &mut image);
    }
    image
}

/// Adds a source: every pixel as bright as texels make its centre, then all in proportion.
fn render_source(source: &Source, texels: &[[f32; 3]], image: &mut LatLong) {
    let (rows, columns) = (source.rows as i64, source.columns as i64);
    let light = |row: i64| {
        let theta = source.theta + row as f32 * source.row_step;
        f64::from(source.column_step * 2.0 * math::sin(theta) * math::sin(0.5 * source.row_step))
    };
    let mut wanted = [0.0; 3];
    for (row, texels) in (0..).zip(texels.chunks_exact(columns as usize)) {
        for (channel, wanted) in wanted.iter_mut().enumerate() {
            let sum: f64 = texels.iter().map(|texel| f64::from(texel[channel])).sum();
            *wanted += light(row) * sum;
        }
    }
    let mut found = [0.0; 3];
    let mut added: Vec<(usize, [f32; 3])> = Vec::new();
    for row in 0..image.height {
        let theta = PI * (f64::from(row) + 0.5) / f64::from(image.height);
        let y = ((theta - f64::from(source.theta)) / f64::from(source.row_step)) as f32;
        if y <= -1.0 || y >= rows as f32 {
            continue;
        }
        for column in 0..image.width {
            let phi = TAU * (f64::from(column) + 0.5) / f64::from(image.width);
            let from_first = phi - f64::from(source.phi) + f64::from(source.column_step);
            let x = (from_first.rem_euclid(TAU) / f64::from(source.column_step)) as f32 - 1.0;
            if x >= columns as f32 {
                continue;
            }
            let texel = |row: i64, column: i64| {
                let inside = (0..rows).contains(&row) && (0..columns).contains(&column);
                inside.then(|| Vec3::from(texels[(row * columns + column) as usize]))
            };
            let mut radiance = Vec3::ZERO;
            for (row, part) in [
                (y.floor(), 1.0 - y + y.floor()),
                (y.floor() + 1.0, y - y.floor()),
            ] {
                for (column, share) in [
                    (x.floor(), 1.0 - x + x.floor()),
                    (x.floor() + 1.0, x - x.floor()),
                ] {
                    let texel = texel(row as i64, column as i64).unwrap_or(Vec3::ZERO);
                    radiance += part * share * texel;
                }
            }
            let solid_angle = image.solid_angle(row);
            for (found, channel) in found.iter_mut().zip(radiance.to_array()) {
                *found += solid_angle * f64::from(channel);
            }
            added.push(((row * image.width + column) as usize, radiance.to_array()));
        }
    }
    for (index, radiance) in added {
        for (channel, pixel) in image.pixels[index].iter_mut().enumerate() {
            if found[channel] > 0.0 {
                *pixel += (f64::from(radiance[channel]) * wanted[channel] / found[channel]) as f32;
            }
        }
    }
}

/// Solid-angle-weighted ‖fit − image‖₂ / ‖image‖₂ over all channels, at the image's own
/// pixel centres; 0 for no lobes and a black image.
pub(crate) fn relative_l2(image: &LatLong, lobes: &[Lobe]) -> f32 {
    let fit = render(lobes, image.width, image.height);
    let (mut error, mut power) = (0.0, 0.0);
    let width = image.width as usize;
    let rows = image
        .pixels
        .chunks_exact(width)
        .zip(fit.pixels.chunks_exact(width));
    for (row, (image_row, fit_row)) in rows.enumerate() {
        let weight = image.solid_angle(row as u32);
        for (image, fit) in image_row.as_flattened().iter().zip(fit_row.as_flattened()) {
            error += weight * (*fit as f64 - *image as f64).powi(2);
            power += weight * (*image as f64).powi(2);
        }
    }
    if power > 0.0 {
        (error / power).sqrt() as f32
    } else {
        0.0
    }
}

/// Per channel (energy of lobes − energy of image) / energy of image, the lobes' energy in
/// closed form; 0 where the image has none.
pub(crate) fn energy_error(image: &LatLong, lobes: &[Lobe]) -> [f32; 3] {
    let power = image.total_power();
    std::array::from_fn(|channel| {
        let fit: f64 = lobes
            .iter()
            .map(|lobe| shape(lobe).integral().0 * lobe.amplitude[channel] as f64)
            .sum();
        if power[channel] > 0.0 {
            ((fit - power[channel]) / power[channel]) as f32
        } else {
            0.0
        }
    })
}

/// Relative root mean square error of irradiance over 1,000 even directions and all
/// channels; 0 for a black image.
pub(crate) fn irradiance_error(image: &LatLong, lobes: &[Lobe]) -> f32 {
    const DIRECTIONS: usize = 1000;
    // Irradiance is so smooth that cells of a degree and a half are exact to 1e-4.
    let level = Level::from_image(image, 128);
    let cells: Vec<(DVec3, [f64; 3])> = level.cells().map(|(at, _, flux)| (at, flux)).collect();
    let golden = PI * (3.0 - 5f64.sqrt());
    let sums: Vec<[f64; 2]> = (0..DIRECTIONS)
        .into_par_iter()
        .map(|index| {
            // Fibonacci lattice.
            let y = 1.0 - (2 * index + 1) as f64 / DIRECTIONS as f64;
            let (sin, cos) = math::sin_cos(golden * index as f64);
            let normal = DVec3::new(cos, 0.0, sin) * (1.0 - y * y).sqrt() + DVec3::Y * y;
            let mut truth = [0.0; 3];
            for (at, flux) in &cells {
                let cosine = at.dot(normal).max(0.0);
                for (truth, flux) in truth.iter_mut().zip(flux) {
                    *truth += cosine * flux;
                }
            }
            let mut fit = [0.0; 3];
            for lobe in lobes {
                let shape = shape(lobe);
                let irradiance = cosine_integral(&shape, shape.axis.dot(normal));
                for (fit, amplitude) in fit.iter_mut().zip(lobe.amplitude) {
                    *fit += irradiance * amplitude as f64;
                }
            }
            let difference: f64 = fit.iter().zip(&truth).map(|(f, t)| (f - t).powi(2)).sum();
            [difference, truth.iter().map(|t| t * t).sum()]
        })
        .collect();
    let [difference, truth] = sums
        .iter()
        .fold([0.0; 2], |sum, one| [sum[0] + one[0], sum[1] + one[1]]);
    if truth > 0.0 {
        (difference / truth).sqrt() as f32
    } else {
        0.0
    }
}

fn shape(lobe: &Lobe) -> Shape {
    let axis = DVec3::from(lobe.axis.map(f64::from)).normalize();
    Shape {
        axis,
        sharpness: lobe.sharpness as f64,
    }
}

/// ∫ G(ω) max(n·ω, 0) dω, n at the given cosine to the axis: the integral around the axis
/// in closed form, the one away from it by the midpoint rule in equal parts of the lobe.
fn cosine_integral(shape: &Shape, cosine: f64) -> f64 {
    const PARTS: usize = 64;
    let lambda = shape.sharpness;
    let whole = -math::exp_m1(-2.0 * lambda);
    let sine = (1.0 - cosine * cosine).max(0.0).sqrt();
    let mut sum = 0.0;
    for part in 0..PARTS {
        // cos θ of the circle that holds this part of the lobe.
        let inside = (part as f64 + 0.5) / PARTS as f64 * whole;
        let cos_theta = 1.0 + math::ln_1p(-inside) / lambda;
        let sin_theta = (1.0 - cos_theta * cos_theta).max(0.0).sqrt();
        let (a, b) = (cos_theta * cosine, sin_theta * sine);
        sum += if a >= b {
            TAU * a
        } else if a > -b {
            let half = math::acos(-a / b);
            2.0 * (a * half + b * math::sin(half))
        } else {
            0.0
        };
    }
    sum * whole / (PARTS as f64 * lambda)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lobe(axis: [f32; 3], sharpness: f32, amplitude: [f32; 3]) -> Lobe {
        let axis = Vec3::from(axis).normalize().to_array();
        Lobe {
            axis,
            sharpness,
            amplitude,
            reserved: 0.0,
        }
    }

    #[test]
    fn a_rendering_of_lobes_is_fitted_by_them() {
        let lobes = [
            lobe([0.2, 0.9, 0.1], 3.0, [1.0, 2.0, 0.5]),
            lobe([-0.2, 0.1, 0.7], 40.0, [0.0, 9.0, 5.0]),
        ];
        let image = render(&lobes, 128, 64);
        assert_eq!(relative_l2(&image, &lobes), 0.0);
        // Midpoint rule against closed form.
        assert!(
            energy_error(&image, &lobes)
                .iter()
                .all(|error| error.abs() < 1e-3)
        );
        assert!(irradiance_error(&image, &lobes) < 1e-3);
        assert!(irradiance_error(&image, &lobes[..1]) > 0.05);
        assert!((relative_l2(&image, &[]) - 1.0).abs() < 1e-6);
        assert_eq!(energy_error(&image, &[]), [-1.0; 3]);
    }

    #[test]
    fn irradiance_of_lobes_matches_quadrature() {
        let grid = LatLong {
            width: 600,
            height: 300,
            ..LatLong::default()
        };
        for (sharpness, cosine) in [
            (0.1, 0.3f64),
            (2.0, -0.5),
            (2.0, 0.9),
            (60.0, 0.1),
            (60.0, -0.1),
        ] {
            let shape = Shape {
                axis: DVec3::Y,
                sharpness,
            };
            let normal = DVec3::new((1.0 - cosine * cosine).sqrt(), cosine, 0.0);
            let mut sum = 0.0;
            for row in 0..grid.height {
                for column in 0..grid.width {
                    let direction = grid.direction(column, row).as_dvec3();
                    sum += grid.solid_angle(row)
                        * math::exp(sharpness * (direction.y - 1.0))
                        * direction.dot(normal).max(0.0);
                }
            }
            let integral = cosine_integral(&shape, cosine);
            // Both rules are of second order.
            assert!(
                (integral - sum).abs() < 2e-3 * shape.integral().0,
                "{integral} {sum}"
            );
        }
    }
}
