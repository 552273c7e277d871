//! A source's texels, and directions drawn from them in proportion to luminance.

use glam::Vec3;
use relight_format::math;

use super::POINTS;

/// A source as stored, to be drawn from.
#[derive(Clone, Debug)]
pub(super) struct Grid {
    stored: relight_format::Source,
    texels: Vec<[f32; 3]>,
    /// Running sums of luminance over rows, and within each row.
    rows: Vec<f32>,
    columns: Vec<f32>,
    /// Luminance of everything.
    pub(super) luminance: f32,
    /// Light of everything.
    light: Vec3,
}

pub(super) fn luminance(color: [f32; 3]) -> f32 {
    0.2126 * color[0] + 0.7152 * color[1] + 0.0722 * color[2]
}

impl Grid {
    /// `None` for a black source.
    pub(super) fn new(grid: relight_format::Source, texels: &[[f32; 3]]) -> Option<Self> {
        let mut new = Self {
            stored: grid,
            texels: texels.to_vec(),
            rows: Vec::new(),
            columns: Vec::new(),
            luminance: 0.0,
            light: Vec3::ZERO,
        };
        for (row, texels) in texels.chunks_exact(grid.columns as usize).enumerate() {
            let theta = grid.theta + row as f32 * grid.row_step;
            let solid_angle =
                grid.column_step * 2.0 * math::sin(0.5 * grid.row_step) * math::sin(theta).max(0.0);
            let mut sum = 0.0;
            for texel in texels {
                sum += luminance(*texel) * solid_angle;
                new.columns.push(sum);
                new.light += Vec3::from(*texel) * solid_angle;
            }
            new.luminance += sum;
            new.rows.push(new.luminance);
        }
        (new.luminance > 0.0 && new.light.is_finite()).then_some(new)
    }

    /// A direction, and the light of the whole source as that direction's colour has it.
    pub(super) fn sample(&self, [u, v]: [f32; 2]) -> (Vec3, Vec3) {
        let (row, v) = draw(&self.rows, v);
        let columns = self.stored.columns as usize;
        let (column, u) = draw(&self.columns[row * columns..][..columns], u);
        let theta = self.stored.theta + (row as f32 + tent(v)) * self.stored.row_step;
        let phi = self.stored.phi + (column as f32 + tent(u)) * self.stored.column_step;
        let ((sin_theta, cos_theta), (sin_phi, cos_phi)) =
            (math::sin_cos(theta), math::sin_cos(phi));
        let texel = self.texels[row * columns + column];
        (
            Vec3::new(sin_theta * sin_phi, cos_theta, -sin_theta * cos_phi),
            Vec3::from(texel) * (self.luminance / luminance(texel)),
        )
    }

    /// Directions of equal luminance, and the light of each: that of all is the source's.
    pub(super) fn points(&self) -> Vec<(Vec3, Vec3)> {
        let drawn: Vec<_> = (0..POINTS)
            .map(|index| self.sample(sobol_pair(index)))
            .collect();
        let sum: Vec3 = drawn.iter().map(|(_, light)| *light).sum();
        // No point may have a channel that is next to nothing.
        let scale = |channel: usize| match sum[channel] {
            0.0 => 0.0,
            sum => self.light[channel] / sum,
        };
        let scale = Vec3::new(scale(0), scale(1), scale(2));
        (drawn.into_iter())
            .map(|(direction, light)| (direction, scale * light))
            .collect()
    }
}

/// The element that a number in [0, 1) falls into, each as wide as it adds to the running sums,
/// and where in it, in [0, 1).
fn draw(sums: &[f32], uniform: f32) -> (usize, f32) {
    let target = uniform * sums[sums.len() - 1];
    let index = sums
        .partition_point(|&sum| sum <= target)
        .min(sums.len() - 1);
    let before = if index == 0 { 0.0 } else { sums[index - 1] };
    let within = (target - before) / (sums[index] - before);
    (index, within.clamp(0.0, 1.0 - f32::EPSILON))
}

/// Takes a number in [0, 1) to [−1, 1] so that densities fall linearly from 0 to both ends.
fn tent(uniform: f32) -> f32 {
    if uniform < 0.5 {
        (2.0 * uniform).sqrt() - 1.0
    } else {
        1.0 - (2.0 - 2.0 * uniform).sqrt()
    }
}

/// The first two dimensions of Sobol's sequence, in the middle of their [`POINTS`] strata.
fn sobol_pair(index: u32) -> [f32; 2] {
    let (mut second, mut column, mut bits) = (0, 1u32 << 31, index);
    while bits > 0 {
        if bits & 1 == 1 {
            second ^= column;
        }
        column ^= column >> 1;
        bits >>= 1;
    }
    [index.reverse_bits(), second]
        .map(|value| (f64::from(value) / 4_294_967_296.0 + 0.5 / f64::from(POINTS)) as f32)
}
