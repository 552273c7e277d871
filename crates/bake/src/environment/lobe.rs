//! Closed forms of spherical Gaussians of amplitude 1, with derivatives.

use relight_format::math;
use std::f64::consts::PI;

use glam::DVec3;

/// Exponent at which a lobe is cut off: what lies beyond is e⁻¹¹ of its integral.
const SUPPORT: f64 = 11.0;

/// exp(sharpness (axis·ω − 1)).
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Shape {
    /// Unit vector.
    pub(super) axis: DVec3,
    /// λ > 0.
    pub(super) sharpness: f64,
}

/// A function of two lobes with its derivatives by the first lobe's axis (in its tangent
/// plane) and sharpness.
#[derive(Clone, Copy, Default)]
pub(super) struct Pair {
    pub(super) value: f64,
    pub(super) by_axis: DVec3,
    pub(super) by_sharpness: f64,
}

impl Shape {
    /// Angle from the axis beyond which the lobe counts as zero, radians.
    pub(super) fn radius(&self) -> f64 {
        math::acos((1.0 - SUPPORT / self.sharpness).max(-1.0))
    }

    /// ∫ G over the sphere, and its derivative by sharpness.
    pub(super) fn integral(&self) -> (f64, f64) {
        let lambda = self.sharpness;
        let value = 2.0 * PI * -math::exp_m1(-2.0 * lambda) / lambda;
        (value, value * (langevin(lambda) - 1.0))
    }

    /// ∫ G G' over the sphere.
    pub(super) fn product_integral(&self, other: &Self) -> Pair {
        let (a, b) = (self.sharpness, other.sharpness);
        let sum = a + b;
        let across = a * b * self.axis.distance_squared(other.axis);
        // ‖a p + b p'‖, and that less a + b without cancellation.
        let length = (sum * sum - across).max(0.0).sqrt().max(1e-9);
        let excess = -across / (length + sum);
        let value = 2.0 * PI * -math::exp_m1(-2.0 * length) / length * math::exp(excess);
        let slope = value * langevin(length) / length;
        let cosine = self.axis.dot(other.axis);
        Pair {
            value,
            by_axis: (other.axis - self.axis * cosine) * (slope * a * b),
            by_sharpness: slope * (a + b * cosine) - value,
        }
    }

    /// The lobe convolved with a normalised lobe of sharpness [`GLOSS`]: again a lobe, of
    /// the same energy, whose squared widths add (exact on the plane).
    pub(super) fn blurred(&self) -> Blurred {
        let share = GLOSS / (self.sharpness + GLOSS);
        let shape = Self {
            axis: self.axis,
            sharpness: self.sharpness * share,
        };
        let (energy, energy_slope) = self.integral();
        let (blurred, blurred_slope) = shape.integral();
        let sharpness_slope = share * share;
        let amplitude = energy / blurred;
        Blurred {
            shape,
            amplitude,
            sharpness_slope,
            amplitude_slope: (energy_slope - amplitude * blurred_slope * sharpness_slope) / blurred,
        }
    }
}

/// Sharpness of the lobe that light is seen through on a rough glossy surface: GGX with
/// α = 0.16 (Wang et al. 2009, 0.5/α² at normal incidence).
pub(super) const GLOSS: f64 = 20.0;

/// A lobe of amplitude 1, blurred, with derivatives by the sharpness before.
#[derive(Clone, Copy)]
pub(super) struct Blurred {
    pub(super) shape: Shape,
    pub(super) amplitude: f64,
    sharpness_slope: f64,
    amplitude_slope: f64,
}

impl Blurred {
    /// ∫ of the product of two blurred lobes.
    pub(super) fn product_integral(&self, other: &Self) -> Pair {
        self.chain(self.shape.product_integral(&other.shape), other.amplitude)
    }

    /// Takes an inner product with the blurred shape to one with the blurred lobe, times a
    /// factor, and its derivatives to those by the lobe before.
    pub(super) fn chain(&self, inner: Pair, factor: f64) -> Pair {
        Pair {
            value: factor * self.amplitude * inner.value,
            by_axis: inner.by_axis * (factor * self.amplitude),
            by_sharpness: factor
                * (self.amplitude * inner.by_sharpness * self.sharpness_slope
                    + self.amplitude_slope * inner.value),
        }
    }
}

/// coth x − 1/x, the mean cosine to the axis under a lobe of sharpness x.
pub(super) fn langevin(x: f64) -> f64 {
    if x < 1e-2 {
        x / 3.0 - x * x * x / 45.0
    } else {
        let e = math::exp(-2.0 * x);
        (1.0 + e) / (1.0 - e) - 1.0 / x
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::environment::hdr::LatLong;

    /// Central differences over 1e-5 of f64 keep about ten digits.
    const SLOPE_TOLERANCE: f64 = 1e-6;

    /// The midpoint rule on 400 × 800 cells, for lobes many cells wide.
    const QUADRATURE_TOLERANCE: f64 = 1e-3;

    fn shapes() -> [Shape; 5] {
        let axis = |x, y, z| DVec3::new(x, y, z).normalize();
        [
            Shape {
                axis: axis(0.1, 0.9, -0.3),
                sharpness: 0.05,
            },
            Shape {
                axis: axis(0.5, 0.2, 0.7),
                sharpness: 1.3,
            },
            Shape {
                axis: axis(0.52, 0.25, 0.7),
                sharpness: 30.0,
            },
            Shape {
                axis: axis(-0.7, 0.1, 0.2),
                sharpness: 4.0,
            },
            Shape {
                axis: axis(0.5201, 0.25, 0.7),
                sharpness: 9e4,
            },
        ]
    }

    fn check_slopes(function: impl Fn(&Shape) -> Pair, shape: &Shape) {
        let pair = function(shape);
        let (s, t) = shape.axis.any_orthonormal_pair();
        let width = shape.sharpness.max(1.0).sqrt().recip();
        let scale = pair.value.abs().max(1e-12);
        for tangent in [s, t] {
            let at = |step: f64| {
                let axis = (shape.axis + tangent * (step * width)).normalize();
                function(&Shape { axis, ..*shape }).value
            };
            let slope = (at(1e-5) - at(-1e-5)) / 2e-5;
            let given = pair.by_axis.dot(tangent) * width;
            assert!(
                (slope - given).abs() < SLOPE_TOLERANCE * scale,
                "{slope} {given} of {scale}"
            );
        }
        let at = |step: f64| {
            function(&Shape {
                sharpness: shape.sharpness * math::exp(step),
                ..*shape
            })
            .value
        };
        let slope = (at(1e-5) - at(-1e-5)) / 2e-5;
        let given = pair.by_sharpness * shape.sharpness;
        assert!(
            (slope - given).abs() < SLOPE_TOLERANCE * scale,
            "{slope} {given} of {scale}"
        );
    }

    #[test]
    fn derivatives_match_differences() {
        for shape in &shapes() {
            for other in &shapes() {
                check_slopes(|shape| shape.product_integral(other), shape);
                let blurred = other.blurred();
                check_slopes(|shape| shape.blurred().product_integral(&blurred), shape);
            }
            check_slopes(
                |shape| {
                    let (value, by_sharpness) = shape.integral();
                    Pair {
                        value,
                        by_axis: DVec3::ZERO,
                        by_sharpness,
                    }
                },
                shape,
            );
        }
    }

    #[test]
    fn integrals_match_quadrature() {
        let grid = LatLong {
            width: 800,
            height: 400,
            ..LatLong::default()
        };
        let evaluate = |shape: &Shape, direction: DVec3| {
            math::exp(-0.5 * shape.sharpness * direction.distance_squared(shape.axis))
        };
        for shape in &shapes()[..4] {
            for other in &shapes()[..4] {
                let (mut product, mut integral) = (0.0, 0.0);
                for row in 0..grid.height {
                    let weight = grid.solid_angle(row);
                    for column in 0..grid.width {
                        let direction = grid.direction(column, row).as_dvec3();
                        let value = weight * evaluate(shape, direction);
                        product += value * evaluate(other, direction);
                        integral += value;
                    }
                }
                let close = |a: f64, b: f64, scale: f64| {
                    assert!((a - b).abs() < QUADRATURE_TOLERANCE * scale, "{a} {b}");
                };
                close(shape.product_integral(other).value, product, product);
                close(shape.integral().0, integral, integral);
            }
        }
    }
}
