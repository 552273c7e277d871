//! The image at one resolution of a pyramid, as cells of near equal size on the sphere.

use relight_format::math;
use std::f64::consts::{PI, TAU};
use std::ops::Range;

use glam::DVec3;
use rayon::prelude::*;

use super::lobe::Shape;
use crate::environment::hdr::LatLong;

/// A lat-long grid whose rows have as many cells as their circumference needs, so that a
/// cap of the sphere holds about as many cells at the poles as at the equator.
#[derive(Clone)]
pub(super) struct Level {
    rows: Vec<Row>,
    /// Cells of the rows about the equator.
    columns: usize,
    /// Cell centres.
    x: Vec<f32>,
    y: Vec<f32>,
    z: Vec<f32>,
    /// Per channel and cell, radiance × solid angle.
    flux: [Vec<f32>; 3],
}

#[derive(Clone, Copy)]
struct Row {
    /// Index of the first cell.
    start: usize,
    /// Number of cells.
    count: usize,
    /// Solid angle of one cell.
    solid_angle: f64,
    /// Of the row's angle from +Y.
    sin_theta: f64,
    cos_theta: f64,
}

/// The directions nearer to an axis than some angle.
struct Cap {
    theta: f64,
    sin_theta: f64,
    cos_theta: f64,
    phi: f64,
    radius: f64,
    cos_radius: f64,
}

impl Cap {
    fn new(axis: DVec3, radius: f64) -> Self {
        Self {
            theta: math::acos(axis.y.clamp(-1.0, 1.0)),
            sin_theta: math::hypot(axis.x, axis.z),
            cos_theta: axis.y,
            phi: math::atan2(axis.x, -axis.z),
            radius,
            cos_radius: math::cos(radius.min(PI)),
        }
    }
}

/// ∫ I G and ∫ I G (ω − axis) per channel, I an image and G a lobe of amplitude 1.
#[derive(Clone, Copy, Default)]
pub(super) struct Moments {
    pub(super) integral: [f64; 3],
    pub(super) offset: [DVec3; 3],
}

impl Level {
    /// The image in at most `height` rows.
    pub(super) fn from_image(image: &LatLong, height: usize) -> Self {
        let width = image.width as usize;
        let source_height = image.height as usize;
        let height = height.min(source_height);
        resample(
            source_height,
            |_| width,
            |row, column| {
                let weight = image.solid_angle(row as u32);
                image.pixels[row * width + column].map(|value| (value as f64 * weight) as f32)
            },
            height,
            (width * height).div_ceil(source_height),
        )
    }

    /// The same image in half as many rows.
    pub(super) fn halved(&self) -> Self {
        resample(
            self.rows.len(),
            |row| self.rows[row].count,
            |row, column| {
                let index = self.rows[row].start + column;
                [0, 1, 2].map(|channel| self.flux[channel][index])
            },
            self.rows.len().div_ceil(2),
            self.columns.div_ceil(2),
        )
    }

    /// The same cells with a radiance of one.
    pub(super) fn even(&self) -> Self {
        let mut even = self.clone();
        for row in &self.rows {
            for flux in &mut even.flux {
                flux[row.start..row.start + row.count].fill(row.solid_angle as f32);
            }
        }
        even
    }

    pub(super) fn height(&self) -> usize {
        self.rows.len()
    }

    /// Angle between rows, radians.
    pub(super) fn spacing(&self) -> f64 {
        PI / self.rows.len() as f64
    }

    /// Centre, solid angle and flux of every cell.
    pub(super) fn cells(&self) -> impl Iterator<Item = (DVec3, f64, [f64; 3])> {
        self.rows.iter().flat_map(move |row| {
            (row.start..row.start + row.count).map(move |index| {
                let flux = [0, 1, 2].map(|channel| self.flux[channel][index] as f64);
                (self.centre(index), row.solid_angle, flux)
            })
        })
    }

    pub(super) fn centre(&self, index: usize) -> DVec3 {
        DVec3::new(
            self.x[index] as f64,
            self.y[index] as f64,
            self.z[index] as f64,
        )
    }

    /// Takes the lobes' radiance away from the image.
    pub(super) fn subtract(&mut self, shapes: &[Shape], amplitudes: &[[f64; 3]]) {
        let caps: Vec<Cap> = shapes
            .iter()
            .map(|shape| Cap::new(shape.axis, shape.radius()))
            .collect();
        let differences: Vec<[Vec<f32>; 3]> = self
            .rows
            .par_iter()
            .map(|row| {
                let mut sum = [0, 1, 2].map(|_| vec![0f32; row.count]);
                for ((shape, amplitude), cap) in shapes.iter().zip(amplitudes).zip(&caps) {
                    let amplitude = amplitude.map(|a| (a * row.solid_angle) as f32);
                    row.ranges(cap, |range| {
                        self.gaussian(shape, range.clone(), |offset, values| {
                            let first = range.start - row.start + offset;
                            for (sum, amplitude) in sum.iter_mut().zip(amplitude) {
                                let sum = &mut sum[first..first + values.len()];
                                for (sum, value) in sum.iter_mut().zip(values) {
                                    *sum += amplitude * value;
                                }
                            }
                        });
                    });
                }
                sum
            })
            .collect();
        for (row, difference) in self.rows.iter().zip(differences) {
            for (flux, difference) in self.flux.iter_mut().zip(difference) {
                let flux = &mut flux[row.start..row.start + row.count];
                for (flux, difference) in flux.iter_mut().zip(difference) {
                    *flux -= difference;
                }
            }
        }
    }

    /// The same cells, of a finer image seen through a normalised lobe of some sharpness.
    pub(super) fn blurred(&self, finer: &Self, sharpness: f64) -> Self {
        let integrals: Vec<[f64; 3]> = (0..self.x.len())
            .into_par_iter()
            .map(|index| {
                let axis = self.centre(index).normalize();
                let kernel = Shape { axis, sharpness };
                let whole = kernel.integral().0;
                finer
                    .moments(&kernel)
                    .integral
                    .map(|integral| integral / whole)
            })
            .collect();
        let mut blurred = self.clone();
        for row in &self.rows {
            for index in row.start..row.start + row.count {
                for (flux, integral) in blurred.flux.iter_mut().zip(integrals[index]) {
                    flux[index] = (integral * row.solid_angle) as f32;
                }
            }
        }
        blurred
    }

    /// ∫ of the squared image, over all channels.
    pub(super) fn power(&self) -> f64 {
        self.rows
            .iter()
            .map(|row| {
                let square = |flux: &Vec<f32>| -> f64 {
                    let cells = &flux[row.start..row.start + row.count];
                    cells.iter().map(|flux| (*flux as f64).powi(2)).sum()
                };
                self.flux.iter().map(square).sum::<f64>() / row.solid_angle
            })
            .sum()
    }

    /// Integrals of the image times a lobe of amplitude 1, over the cells within the
    /// lobe's support.
    pub(super) fn moments(&self, shape: &Shape) -> Moments {
        let mut sums = [[0f64; 4]; 3];
        let axis = shape.axis.as_vec3();
        let mut buffer = [0f32; BLOCK];
        let cap = Cap::new(shape.axis, shape.radius());
        for row in &self.rows[self.row_span(&cap)] {
            row.ranges(&cap, |range| {
                self.gaussian(shape, range.clone(), |offset, values| {
                    let first = range.start + offset;
                    let cells = first..first + values.len();
                    let (x, y, z) = (
                        &self.x[cells.clone()],
                        &self.y[cells.clone()],
                        &self.z[cells.clone()],
                    );
                    for (flux, sums) in self.flux.iter().zip(&mut sums) {
                        let product = &mut buffer[..values.len()];
                        for ((product, value), flux) in
                            product.iter_mut().zip(values).zip(&flux[cells.clone()])
                        {
                            *product = value * flux;
                        }
                        sums[0] += lanes(product, product, |p, _| p);
                        sums[1] += lanes(product, x, |p, x| p * (x - axis.x));
                        sums[2] += lanes(product, y, |p, y| p * (y - axis.y));
                        sums[3] += lanes(product, z, |p, z| p * (z - axis.z));
                    }
                });
            });
        }
        Moments {
            integral: sums.map(|sum| sum[0]),
            offset: sums.map(|sum| DVec3::new(sum[1], sum[2], sum[3])),
        }
    }

    /// Cells whose radiance, summed over channels, is positive and not less than that of
    /// the cells beside, above and below.
    pub(super) fn peaks(&self) -> Vec<usize> {
        let radiance = |row: &Row, index: usize| -> f64 {
            self.flux.iter().map(|flux| flux[index] as f64).sum::<f64>() / row.solid_angle
        };
        (0..self.rows.len())
            .into_par_iter()
            .flat_map_iter(|number| {
                let row = &self.rows[number];
                let around =
                    &self.rows[number.saturating_sub(1)..(number + 2).min(self.rows.len())];
                (0..row.count).filter_map(move |column| {
                    let own = radiance(row, row.start + column);
                    let peak = own > 0.0
                        && around.iter().all(|other| {
                            let below = (2 * column + 1) * other.count / (2 * row.count);
                            [other.count - 1, 0, 1].iter().all(|shift| {
                                let neighbour = (below + shift) % other.count;
                                radiance(other, other.start + neighbour) <= own
                            })
                        });
                    peak.then_some(row.start + column)
                })
            })
            .collect()
    }

    /// Rows that a cap may touch.
    fn row_span(&self, cap: &Cap) -> Range<usize> {
        let spacing = self.spacing();
        let first = ((cap.theta - cap.radius) / spacing - 0.5).floor().max(0.0) as usize;
        let last = ((cap.theta + cap.radius) / spacing + 0.5).ceil() as usize;
        first..last.min(self.rows.len())
    }

    /// Values of a lobe of amplitude 1 at the centres of some cells, block by block with
    /// the block's offset in the range.
    fn gaussian(&self, shape: &Shape, range: Range<usize>, mut visit: impl FnMut(usize, &[f32])) {
        let axis = shape.axis.as_vec3();
        let factor = -0.5 * shape.sharpness as f32;
        let mut values = [0f32; BLOCK];
        let mut start = range.start;
        while start < range.end {
            let length = BLOCK.min(range.end - start);
            let cells = start..start + length;
            let (x, y, z) = (
                &self.x[cells.clone()],
                &self.y[cells.clone()],
                &self.z[cells],
            );
            for (((value, x), y), z) in values.iter_mut().zip(x).zip(y).zip(z) {
                let (dx, dy, dz) = (x - axis.x, y - axis.y, z - axis.z);
                *value = exp(factor * (dx * dx + dy * dy + dz * dz));
            }
            visit(start - range.start, &values[..length]);
            start += length;
        }
    }
}

impl Row {
    /// Runs of cells whose centres lie in a cap.
    fn ranges(&self, cap: &Cap, mut visit: impl FnMut(Range<usize>)) {
        let &Self { start, count, .. } = self;
        // cos Δφ of the cap's border on this row's circle, times `scale`.
        let border = cap.cos_radius - self.cos_theta * cap.cos_theta;
        let scale = self.sin_theta * cap.sin_theta;
        if cap.radius >= PI || border <= -scale {
            return visit(start..start + count);
        }
        if border >= scale {
            return;
        }
        let half = math::acos(border / scale);
        let per_cell = count as f64 / TAU;
        let first = ((cap.phi - half) * per_cell - 0.5).ceil() as i64;
        let end = ((cap.phi + half) * per_cell - 0.5).floor() as i64 + 1;
        if end - first >= count as i64 {
            return visit(start..start + count);
        }
        if end <= first {
            return;
        }
        let length = (end - first) as usize;
        let first = first.rem_euclid(count as i64) as usize;
        if first + length <= count {
            visit(start + first..start + first + length);
        } else {
            visit(start..start + first + length - count);
            visit(start + first..start + count);
        }
    }
}

/// Cells handled at a time.
const BLOCK: usize = 128;

/// Sum of `term` over two slices, in eight interleaved partial sums that vectorise.
#[inline]
fn lanes(a: &[f32], b: &[f32], term: impl Fn(f32, f32) -> f32) -> f64 {
    let mut sums = [0f32; 8];
    let (a8, a_rest) = a.as_chunks::<8>();
    let (b8, b_rest) = b.as_chunks::<8>();
    for (a, b) in a8.iter().zip(b8) {
        for lane in 0..8 {
            sums[lane] += term(a[lane], b[lane]);
        }
    }
    for ((sum, a), b) in sums.iter_mut().zip(a_rest).zip(b_rest) {
        *sum += term(*a, *b);
    }
    sums.iter().map(|sum| *sum as f64).sum()
}

/// e^x for x in −80..=0 to 3e-7, in operations that vectorise and round alike everywhere.
#[inline]
fn exp(x: f32) -> f32 {
    // Adding 1.5 × 2²³ rounds to an integer, which the low bits of the sum then hold.
    const ROUND: f32 = 12_582_912.0;
    let y = x.max(-80.0) * std::f32::consts::LOG2_E;
    let rounded = y + ROUND;
    let f = (y - (rounded - ROUND)) * std::f32::consts::LN_2;
    let series = 1.0 / 120.0 + f * (1.0 / 720.0);
    let series = 0.5 + f * (1.0 / 6.0 + f * (1.0 / 24.0 + f * series));
    let power = f32::from_bits((rounded.to_bits() << 23).wrapping_add(0x3f80_0000));
    (1.0 + f * (1.0 + f * series)) * power
}

/// Distributes the flux of a row-wise grid over one of `height` rows, by overlap. Rows
/// have `columns` cells, so that cells of an image are kept or merged in pairs and nothing
/// blurs, but near the poles only as many as make them square.
fn resample(
    source_height: usize,
    source_count: impl Fn(usize) -> usize + Sync,
    source_flux: impl Fn(usize, usize) -> [f32; 3] + Sync,
    height: usize,
    columns: usize,
) -> Level {
    let spacing = PI / height as f64;
    let source_spacing = PI / source_height as f64;
    let flux_of_rows: Vec<Vec<[f64; 3]>> = (0..height)
        .into_par_iter()
        .map(|row| {
            let (top, bottom) = (row as f64 * spacing, (row + 1) as f64 * spacing);
            let first = (top / source_spacing).floor() as usize;
            let end = ((bottom / source_spacing).ceil() as usize).min(source_height);
            let square = (TAU * math::sin((row as f64 + 0.5) * spacing) / spacing).round() as usize;
            let count = if 2 * square > columns {
                columns
            } else {
                square.max(1)
            };
            let mut cells = vec![[0f64; 3]; count];
            for source in first..end {
                let (source_top, source_bottom) = (
                    source as f64 * source_spacing,
                    (source + 1) as f64 * source_spacing,
                );
                let overlap = math::cos(source_top.max(top)) - math::cos(source_bottom.min(bottom));
                let part = overlap / (math::cos(source_top) - math::cos(source_bottom));
                if part <= 0.0 {
                    continue;
                }
                let source_columns = source_count(source);
                let scale = count as f64 / source_columns as f64;
                for column in 0..source_columns {
                    let flux = source_flux(source, column);
                    let (left, right) = (column as f64 * scale, (column + 1) as f64 * scale);
                    let mut cell = left as usize;
                    while cell < count && (cell as f64) < right - 1e-9 * scale {
                        let width = right.min((cell + 1) as f64) - left.max(cell as f64);
                        for (sum, flux) in cells[cell].iter_mut().zip(flux) {
                            *sum += flux as f64 * part * (width / scale);
                        }
                        cell += 1;
                    }
                }
            }
            cells
        })
        .collect();
    let mut level = Level {
        rows: Vec::with_capacity(height),
        columns,
        x: Vec::new(),
        y: Vec::new(),
        z: Vec::new(),
        flux: [Vec::new(), Vec::new(), Vec::new()],
    };
    for (row, cells) in flux_of_rows.iter().enumerate() {
        let count = cells.len();
        let (top, bottom) = (row as f64 * spacing, (row + 1) as f64 * spacing);
        let (sin_theta, cos_theta) = math::sin_cos((row as f64 + 0.5) * spacing);
        level.rows.push(Row {
            start: level.x.len(),
            count,
            solid_angle: (math::cos(top) - math::cos(bottom)) * TAU / count as f64,
            sin_theta,
            cos_theta,
        });
        for (column, flux) in cells.iter().enumerate() {
            let u = (column as f64 + 0.5) / count as f64;
            let centre = LatLong::direction_at(u, (row as f64 + 0.5) / height as f64).as_vec3();
            level.x.push(centre.x);
            level.y.push(centre.y);
            level.z.push(centre.z);
            for (all, one) in level.flux.iter_mut().zip(flux) {
                all.push(*one as f32);
            }
        }
    }
    level
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Fluxes are stored in f32.
    const FLUX_TOLERANCE: f64 = 1e-5;

    /// What a lobe has beyond its support, at places where the image is bright.
    const SUPPORT_TOLERANCE: f64 = 1e-3;

    fn image(width: u32, height: u32) -> LatLong {
        let pixels = (0..width * height)
            .map(|i| {
                [
                    1.0 + (i % 7) as f32,
                    1.0 + (i * i % 11) as f32,
                    if i == 77 { 1e4 } else { 0.1 },
                ]
            })
            .collect();
        LatLong::repair(width, height, pixels)
    }

    #[test]
    fn exponentials_are_exact() {
        for i in 0..8000 {
            let x = -0.01 * i as f32;
            let exact = math::exp(x as f64);
            // Three units in the last place, and the rounding of the argument.
            let tolerance = (3.6e-7 + 1e-7 * -x as f64) * exact;
            assert!(
                (exp(x) as f64 - exact).abs() <= tolerance,
                "{x}: {} {exact}",
                exp(x)
            );
        }
    }

    #[test]
    fn flux_is_kept_at_every_level() {
        for (width, height) in [(64, 32), (50, 25), (31, 64), (1, 1), (500, 3)] {
            let image = image(width, height);
            let mut level = Level::from_image(&image, 40);
            for _ in 0..4 {
                let mut sum = [0.0; 3];
                let mut sphere = 0.0;
                for (_, solid_angle, flux) in level.cells() {
                    sphere += solid_angle;
                    for (sum, flux) in sum.iter_mut().zip(flux) {
                        *sum += flux;
                    }
                }
                assert!((sphere / (4.0 * PI) - 1.0).abs() < 1e-12);
                for (sum, power) in sum.into_iter().zip(image.total_power()) {
                    assert!((sum / power - 1.0).abs() < FLUX_TOLERANCE, "{sum} {power}");
                }
                level = level.halved();
            }
        }
    }

    #[test]
    fn caps_hold_just_the_cells_within_their_radius() {
        let level = Level::from_image(&image(96, 48), 48);
        for axis in [
            DVec3::Y,
            DVec3::NEG_Y,
            DVec3::NEG_Z,
            DVec3::new(-0.01, 0.3, -0.9),
        ] {
            let axis = axis.normalize();
            for radius in [0.03, 0.4, 1.7, 3.1, PI] {
                let mut inside = vec![0; level.x.len()];
                let cap = Cap::new(axis, radius);
                for row in &level.rows[level.row_span(&cap)] {
                    row.ranges(&cap, |range| {
                        inside[range].iter_mut().for_each(|count| *count += 1);
                    });
                }
                for (index, count) in inside.into_iter().enumerate() {
                    let angle = level.centre(index).angle_between(axis);
                    // Centres on the border may fall either way.
                    if (angle - radius).abs() > 1e-5 {
                        assert_eq!(count, u32::from(angle < radius), "{angle} {radius} {axis}");
                    }
                }
            }
        }
    }

    #[test]
    fn moments_and_residuals_match_sums_over_all_cells() {
        let mut level = Level::from_image(&image(96, 48), 48);
        let shape = Shape {
            axis: DVec3::new(0.2, 0.8, -0.5).normalize(),
            sharpness: 20.0,
        };
        let value = |at: DVec3| math::exp(-0.5 * shape.sharpness * at.distance_squared(shape.axis));
        let sum = |level: &Level, channel: usize| -> (f64, DVec3) {
            level
                .cells()
                .fold((0.0, DVec3::ZERO), |sum, (at, _, flux)| {
                    let product = flux[channel] * value(at);
                    (sum.0 + product, sum.1 + (at - shape.axis) * product)
                })
        };
        let moments = level.moments(&shape);
        for channel in 0..3 {
            let (integral, offset) = sum(&level, channel);
            let tolerance = SUPPORT_TOLERANCE * integral;
            assert!((moments.integral[channel] - integral).abs() < tolerance);
            assert!(moments.offset[channel].distance(offset) < tolerance);
        }
        let before: f64 = sum(&level, 1).0;
        level.subtract(&[shape], &[[0.0, 2.0, 0.0]]);
        let removed: f64 = level
            .cells()
            .map(|(at, angle, _)| 2.0 * angle * value(at).powi(2))
            .sum();
        assert!((before - sum(&level, 1).0 - removed).abs() < SUPPORT_TOLERANCE * before);
    }
}
