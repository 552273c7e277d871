//! Lat-long HDR images: repair, directions, solid angles and sampling.
//!
//! Row 0 is +Y; with θ from +Y and φ about it, a direction is
//! (sinθ sinφ, cosθ, −sinθ cosφ), and u = φ/2π, v = θ/π run over the image.

use std::f64::consts::{PI, TAU};

use glam::{DVec3, Vec3};
use relight_format::math;

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
}
