//! How far the lobes of `brdf` are from the reflection models of `models`: quadrature for
//! error tables, tests and reports. On the CPU only.

use relight_format::math;
use std::f32::consts::PI;

use glam::Vec3;

use crate::brdf::specular_lobes;
use crate::models;
use crate::surface::{Appearance, Reflection, local_point};

/// Errors of the lobes of one reflection seen from one direction.
#[derive(Clone, Copy, Debug)]
pub struct Accuracy {
    /// ‖(lobes − model) n·ω‖₂ / ‖model n·ω‖₂ over the hemisphere.
    pub relative_l2: f64,
    /// Albedo of the lobes over that of the model, less 1.
    pub albedo_error: f64,
    /// Part of the light that the lobes send elsewhere than the model does, were both to send as much.
    pub misplaced: f64,
    /// Spherical Gaussians used.
    pub lobes: usize,
}

/// Measures one grey reflection seen from the unit vector `view`, z along the normal, by
/// quadrature on a polar grid about the mirror direction, dense near it.
pub fn accuracy(reflection: &Reflection, view: Vec3) -> Accuracy {
    const RADII: usize = 160;
    const ANGLES: usize = 120;
    let mirror = Vec3::new(-view.x, -view.y, view.z);
    let (first, second) = mirror.any_orthonormal_pair();
    let point = local_point(Appearance::new(Vec3::ZERO, &[*reflection]), view);
    let lobes = specular_lobes(&point, reflection);
    let mut sums = [0.0f64; 4];
    let mut sent = Vec::with_capacity(RADII * ANGLES);
    for i in 0..RADII {
        let u = (i as f32 + 0.5) / RADII as f32;
        let theta = PI * u * u * u;
        let solid_angle =
            math::sin(theta) * 3.0 * PI * u * u / RADII as f32 * 2.0 * PI / ANGLES as f32;
        for j in 0..ANGLES {
            let phi = 2.0 * PI * (j as f32 + 0.5) / ANGLES as f32;
            let around = first * math::cos(phi) + second * math::sin(phi);
            let wi = mirror * math::cos(theta) + around * math::sin(theta);
            if wi.z <= 0.0 {
                continue;
            }
            let exact = models::evaluate_specular(reflection, wi, view).x;
            let found: f32 = lobes
                .as_slice()
                .iter()
                .map(|lobe| lobe.evaluate(wi).x)
                .sum();
            let (exact, found) = (exact * wi.z, found * wi.z);
            sent.push([exact, found].map(|light| f64::from(light * solid_angle)));
            let terms = [exact, found, exact * exact, (found - exact).powi(2)];
            for (sum, term) in sums.iter_mut().zip(terms) {
                *sum += f64::from(term * solid_angle);
            }
        }
    }
    let elsewhere = |[exact, found]: &[f64; 2]| (exact / sums[0] - found / sums[1]).abs();
    Accuracy {
        misplaced: 0.5 * sent.iter().map(elsewhere).sum::<f64>(),
        relative_l2: (sums[3] / sums[2]).sqrt(),
        albedo_error: sums[1] / sums[0] - 1.0,
        lobes: lobes.count,
    }
}
