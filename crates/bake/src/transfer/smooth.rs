//! What the rays of a vertex's neighbours tell of it.
//!
//! Bounced light changes slowly, the slower the farther away is what sends it (Ward, Rubinstein & Clear 1988, "A Ray
//! Tracing Solution for Diffuse Interreflection", section 3.2). So a vertex takes the plane that is nearest to what was
//! gathered at itself and at those of its neighbours that stand as it does, least squares: the noise of the rays, which
//! neighbours do not share, is less, and where all neighbours lie on one side, as at the edge of a chunk, nothing is
//! shifted.

use glam::{Mat3, Vec3};

use super::gather::{Gathered, Receiver};
use crate::simd::add_scaled;

/// Most that a neighbour may differ by: how far away it is, over the distance of what sends light, plus how much it is
/// turned (Ward et al., equation 5).
const FARTHEST: f32 = 0.25;
/// Most height of a neighbour above or below the vertex's plane, over its distance.
const MOST_SLOPE: f32 = 0.1;
/// Most neighbours, the vertex itself among them: the nearest.
const MOST: usize = 64;
/// What unit vectors that are the same differ by for rounding, and more.
const ALIKE: f32 = 0.005;
/// Below so many there is nothing to gain.
const LEAST: usize = 4;
/// Added to the squares of the plane's slopes, over the square of the farthest neighbour's distance: a plane through
/// points on a line is level across it.
const PULL: f32 = 1e-3;

/// What was gathered at the `receivers`, with that of their neighbours.
pub(crate) fn smoothed(receivers: &[Receiver], gathered: &[Gathered]) -> Vec<Vec<f32>> {
    (0..receivers.len())
        .map(|index| {
            let own = &gathered[index].outputs;
            // Of nothing that is seen there is no noise.
            if gathered[index].nearness == 0.0 {
                return own.clone();
            }
            let parts = parts(receivers, gathered, index);
            if parts.len() < LEAST {
                return own.clone();
            }
            let mut sum = vec![0.0; own.len()];
            for (neighbour, part) in parts {
                add_scaled(&mut sum, &gathered[neighbour].outputs, part);
            }
            sum
        })
        .collect()
}

/// The neighbours of a receiver and what each counts for: 1 in all.
fn parts(receivers: &[Receiver], gathered: &[Gathered], index: usize) -> Vec<(usize, f32)> {
    let own = &receivers[index];
    let mut near: Vec<(f32, usize)> = (receivers.iter().zip(gathered).enumerate())
        .filter_map(|(other, (receiver, of_other))| {
            let between = receiver.origin - own.origin;
            let distance = between.length();
            let nearness = gathered[index].nearness.max(of_other.nearness);
            // Most are too far away for anything else to count.
            if distance * nearness > FARTHEST
                || own.normal.dot(between).abs() > MOST_SLOPE * distance
            {
                return None;
            }
            let turned = (1.0 - own.normal.dot(receiver.normal)).max(0.0).sqrt();
            let differs = distance * nearness + turned;
            (differs < FARTHEST).then_some((differs, other))
        })
        .collect();
    let order = |(a, i): &(f32, usize), (b, j): &(f32, usize)| a.total_cmp(b).then(i.cmp(j));
    if near.len() > MOST {
        near.select_nth_unstable_by(MOST - 1, order);
        near.truncate(MOST);
    }
    near.sort_unstable_by(order);
    let (x, y) = own.normal.any_orthonormal_pair();
    let farthest = (near.iter())
        .map(|&(_, other)| receivers[other].origin.distance(own.origin))
        .fold(f32::MIN_POSITIVE, f32::max);
    // The farthest of those that are taken counts for nothing, so that none comes or goes all at once; where all are
    // alike, they count alike.
    let limit = match near.get(MOST - 1) {
        Some((farthest, _)) => farthest.max(ALIKE),
        None => FARTHEST,
    };
    let row = |other: usize| {
        let between = (receivers[other].origin - own.origin) / farthest;
        Vec3::new(1.0, x.dot(between), y.dot(between))
    };
    let weight = |differs: f32| (1.0 - differs / limit).max(0.0);
    let mut squares = Mat3::from_diagonal(PULL * Vec3::new(0.0, 1.0, 1.0));
    for &(differs, other) in &near {
        let row = row(other);
        squares += weight(differs) * Mat3::from_cols(row * row.x, row * row.y, row * row.z);
    }
    let value = squares.inverse() * Vec3::X;
    (near.into_iter())
        .map(|(differs, other)| (other, weight(differs) * value.dot(row(other))))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::transfer::lamps::Emitted;
    use crate::transfer::radiosity::{hash, unit};

    /// Vertices a tenth apart on a floor of 16 by 16, with what `value` says, and noise.
    fn floor(nearness: f32, value: impl Fn(Vec3) -> f32) -> (Vec<Receiver>, Vec<Gathered>) {
        (0..256)
            .map(|index| {
                let origin = Vec3::new(0.1 * (index % 16) as f32, 0.0, 0.1 * (index / 16) as f32);
                let noise = unit(hash(index, 7)) - 0.5;
                let receiver = Receiver {
                    origin,
                    normal: Vec3::Y,
                };
                let gathered = Gathered {
                    outputs: vec![value(origin) + noise],
                    lamps: Emitted::default(),
                    nearness,
                    cast: 0,
                };
                (receiver, gathered)
            })
            .unzip()
    }

    /// Root mean square of what `smoothed` leaves of the noise, of vertices inside and at the edge.
    fn left(nearness: f32, value: impl Fn(Vec3) -> f32) -> [f32; 2] {
        let (receivers, gathered) = floor(nearness, &value);
        let smoothed = smoothed(&receivers, &gathered);
        [false, true].map(|at_edge| {
            let squares: Vec<f32> = (0..256)
                .filter(|index| [index % 16, index / 16].iter().any(|at| at % 15 == 0) == at_edge)
                .map(|index| (smoothed[index][0] - value(receivers[index].origin)).powi(2))
                .collect();
            (squares.iter().sum::<f32>() / squares.len() as f32).sqrt()
        })
    }

    #[test]
    fn noise_is_less_and_slopes_stay() {
        let noise = (1f32 / 12.0).sqrt();
        // Two metres away; of a slope at which a mean over one side would be far off.
        let [inside, edge] = left(0.5, |at| 3.0 * at.x - 2.0 * at.z);
        assert!(inside < 0.25 * noise, "{inside}");
        assert!(edge < 0.5 * noise, "{edge}");
    }

    #[test]
    fn those_that_are_alike_count_alike() {
        let (mut receivers, gathered) = floor(1e-9, |_| 1.0);
        // Whose square is less than 1 by a rounding.
        let normal = Vec3::new(-0.999_966_9, -0.005_799_808, -0.005_699_811_5);
        for receiver in &mut receivers {
            receiver.normal = normal;
            receiver.origin = Vec3::new(0.0, receiver.origin.x, receiver.origin.z);
        }
        let smoothed = smoothed(&receivers, &gathered);
        let is_smooth = |outputs: &Vec<f32>| (outputs[0] - 1.0).abs() < 0.4;
        assert!(smoothed.iter().all(is_smooth), "{smoothed:?}");
    }

    #[test]
    fn beside_what_is_near_nothing_is_smoothed() {
        let (receivers, gathered) = floor(5.0, |at| at.x);
        let smoothed = smoothed(&receivers, &gathered);
        for (smoothed, gathered) in smoothed.iter().zip(&gathered) {
            assert_eq!(*smoothed, gathered.outputs);
        }
    }

    #[test]
    fn what_stands_otherwise_stays() {
        let (mut receivers, gathered) = floor(0.5, |_| 1.0);
        // A wall and a step within the floor.
        receivers[40].normal = Vec3::X;
        receivers[200].origin.y = 0.05;
        for index in [40, 200] {
            let parts = parts(&receivers, &gathered, index);
            assert!(
                !parts.iter().any(|&(other, _)| other.abs_diff(index) == 1),
                "{parts:?}"
            );
        }
    }
}
