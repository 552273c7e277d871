//! What an error of an SSDF costs in a picture.
//!
//! An SSDF shades by the place of its boundary alone, and light from there by the cosine to the
//! surface's normal; what lies below the horizon is never looked at. Squares of errors are
//! weighted by the cosine, between its square, as is right for light from everywhere, and none,
//! as is right for a low sun and nothing else. Compression, refinement, probes and seams all
//! count in this measure.

use glam::Vec3;
use relight_format::math;

use super::samples::LANES;
use crate::simd::vectorised;
use crate::visibility::Directions;

/// Half-width of the weight about the visibility boundary, radians: two texels of a basis
/// image of usual size.
const BOUNDARY_WIDTH: f32 = 0.05;
/// The same where what was sampled stands for what lies between, whose boundaries are elsewhere: coefficients must be right
/// there as well.
const BOUNDARY_WIDTH_BETWEEN: f32 = 0.075;
/// Half of the angular width of lights that errors are told for.
const LIGHT_WIDTH: f32 = 0.05;
/// A small angle.
const LITTLE: f32 = 1e-3;
/// Weight of texels far from the boundary, which only guide the steps of sphere tracing.
const FAR_WEIGHT: f32 = 0.003;
/// Weight of texels below the horizon, for normals that interpolation turns.
const HIDDEN_WEIGHT: f32 = 0.02;

/// A vertex's shading normal as the weights see it.
#[derive(Clone, Copy, Debug)]
pub struct Normal {
    /// Unit length.
    pub direction: Vec3,
    /// Sine of the angle by which a normal map may turn it.
    pub tilt: f32,
}

impl Normal {
    /// Cosine to a direction, of the nearest normal.
    #[inline(always)]
    fn seen(&self, [x, y, z]: [f32; 3]) -> f32 {
        let normal = self.direction;
        let cosine = normal.x * x + normal.y * y + normal.z * z;
        ((cosine + self.tilt) / (1.0 + self.tilt)).max(0.0)
    }
}

/// What an error of an SSDF costs, by direction.
pub struct Weighting {
    directions: Directions,
    /// Their coordinates, each of all texels.
    coordinates: [Vec<f32>; 3],
    /// Solid angle of every texel, in units of the weights that a wall has: of a vertical
    /// wall that hides half of the sky, at a vertex whose normal points up.
    solid_angles: Vec<f32>,
    /// Of such a wall's edge that is off by one, squared, in [`Self::squared_displacement`],
    /// while it is off by little.
    wall: f32,
    /// Half of the weight's about the boundary, radians.
    width: f32,
}

impl Weighting {
    /// For basis images of this many texels per side.
    pub fn new(basis_resolution: u32) -> Self {
        Self::of_width(basis_resolution, BOUNDARY_WIDTH)
    }

    /// The same for vertices that stand for others between them.
    pub(crate) fn with_between(basis_resolution: u32) -> Self {
        Self::of_width(basis_resolution, BOUNDARY_WIDTH_BETWEEN)
    }

    fn of_width(basis_resolution: u32, width: f32) -> Self {
        let directions = Directions::new(basis_resolution);
        // The octahedral map shrinks by the third power of the distance to the octahedron's
        // face (Engelhardt & Dachsbacher 2008).
        let solid_angles = (directions.as_slice().iter())
            .map(|direction| direction.abs().element_sum().powi(3))
            .collect();
        let coordinates = std::array::from_fn(|axis| {
            let all = directions.as_slice().iter();
            all.map(|direction| direction[axis]).collect()
        });
        let mut weighting = Self {
            directions,
            coordinates,
            solid_angles,
            wall: 1.0,
            width,
        };
        let wall: Vec<f32> = (weighting.directions.as_slice().iter())
            .map(|direction| math::asin(direction.x))
            .collect();
        let up = Normal {
            direction: Vec3::Y,
            tilt: 0.0,
        };
        let mut weights = vec![0.0; wall.len()];
        weighting.weigh(&wall, up, &mut weights);
        let sum: f32 = weights.iter().sum();
        (weighting.solid_angles.iter_mut()).for_each(|solid_angle| *solid_angle /= sum);
        let off: Vec<f32> = wall.iter().map(|distance| distance + LITTLE).collect();
        weighting.wall = weighting.squared_displacement(&off, &wall, up) / (LITTLE * LITTLE);
        weighting
    }

    /// Of the basis images' texels.
    pub(crate) fn directions(&self) -> &Directions {
        &self.directions
    }

    /// How far the boundary of `found` is off, squared: as an error of light shows, which
    /// grows with the displacement until the boundary has passed all of a light.
    pub(crate) fn squared_displacement(&self, found: &[f32], exact: &[f32], normal: Normal) -> f32 {
        vectorised!(
            <'a>
            weighting: &'a Weighting = self,
            found: &'a [f32] = found,
            exact: &'a [f32] = exact,
            normal: Normal = normal
            => f32 { weighting.sum_of_squares(found, exact, normal) }
        ) / self.wall
    }

    #[inline(always)]
    fn sum_of_squares(&self, found: &[f32], exact: &[f32], normal: Normal) -> f32 {
        let squash = |distance: f32| distance / (1.0 + (distance / LIGHT_WIDTH).powi(2)).sqrt();
        let [x, y, z] = self.coordinates.each_ref().map(|all| all.chunks(LANES));
        let texels = x.zip(y).zip(z).zip(self.solid_angles.chunks(LANES));
        // Side by side, as vector instructions want it.
        let mut sums = [0.0; LANES];
        for ((found, exact), (((x, y), z), solid_angles)) in
            found.chunks(LANES).zip(exact.chunks(LANES)).zip(texels)
        {
            let directions = x.iter().zip(y).zip(z).zip(solid_angles);
            let texels = found.iter().zip(exact).zip(directions);
            for (sum, ((found, exact), (((x, y), z), solid_angle))) in sums.iter_mut().zip(texels) {
                let difference = squash(*found) - squash(*exact);
                *sum += solid_angle * normal.seen([*x, *y, *z]) * difference.powi(2);
            }
        }
        sums.iter().sum()
    }

    /// Weight of a squared error at every texel of an SSDF.
    #[inline(always)]
    pub(crate) fn weigh(&self, ssdf: &[f32], normal: Normal, weights: &mut [f32]) {
        let [x, y, z] = &self.coordinates;
        let texels = x.iter().zip(y).zip(z).zip(&self.solid_angles);
        for ((weight, distance), (((x, y), z), solid_angle)) in
            weights.iter_mut().zip(ssdf).zip(texels)
        {
            let seen = normal.seen([*x, *y, *z]);
            let near = 1.0 / (1.0 + (distance / self.width).powi(4));
            *weight = solid_angle * (FAR_WEIGHT + near) * (HIDDEN_WEIGHT + seen);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn displacements_count_until_a_light_is_passed() {
        let weighting = Weighting::new(64);
        let wall = |off: f32| -> Vec<f32> {
            let directions = weighting.directions.as_slice().iter();
            directions
                .map(|d| (math::asin(d.x) + off).clamp(-0.5, 0.5))
                .collect()
        };
        let up = Normal {
            direction: Vec3::Y,
            tilt: 0.0,
        };
        let displacement = |off: f32| {
            weighting
                .squared_displacement(&wall(off), &wall(0.0), up)
                .sqrt()
        };
        for off in [-0.01f32, 0.003, 0.01] {
            assert!((displacement(off) / off.abs() - 1.0).abs() < 0.02, "{off}");
        }
        // An area, which is what is left of a displacement of several lights' widths, grows
        // with its square root.
        let growth = displacement(0.4) / displacement(0.2);
        assert!((1.3..1.7).contains(&growth), "{growth}");
    }

    #[test]
    fn boundaries_below_the_horizon_cost_next_to_nothing() {
        let weighting = Weighting::new(64);
        let floor: Vec<f32> = (weighting.directions.as_slice().iter())
            .map(|direction| math::asin(direction.y) + 0.1)
            .collect();
        let cost = |direction: Vec3, tilt: f32| {
            let mut weights = vec![0.0; floor.len()];
            weighting.weigh(&floor, Normal { direction, tilt }, &mut weights);
            weights.iter().sum::<f32>()
        };
        let (up, down) = (cost(Vec3::Y, 0.0), cost(Vec3::NEG_Y, 0.0));
        assert!(up < 0.2 && up < cost(Vec3::Y, 0.3), "{up}");
        assert!(cost(Vec3::X, 0.0) > 0.8, "{down}");
    }
}
