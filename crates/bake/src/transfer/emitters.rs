//! Surfaces that emit, drawn from by how much of their light may reach a place.
//!
//! Triangles lie in groups that are near each other and look the same way; a group is chosen by a
//! bound of what it gives (after Conty Estevez and Kulla, *Importance Sampling of Many Lights with Adaptive
//! Tree Splitting*, 2018, with one level), a triangle of it by its power.

use std::f32::consts::{FRAC_PI_2, PI};

use glam::Vec3;
use relight_format::math;

/// Groups are halved so many times.
const HALVINGS: u32 = 6;
/// A difference of normals, 2 at most, as a part of the extent of everything: what is split first.
const NORMAL_EXTENT: f32 = 0.25;

/// A triangle that emits.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Emitter {
    /// Of the mesh.
    pub triangle: u32,
    /// Corners, world space, metres.
    pub corners: [Vec3; 3],
    /// Sum over channels of the radiance of its material, textures aside.
    pub radiance: f32,
}

impl Emitter {
    fn across(&self) -> Vec3 {
        let [a, b, c] = self.corners;
        (b - a).cross(c - a)
    }

    fn centre(&self) -> Vec3 {
        self.corners.iter().sum::<Vec3>() / 3.0
    }

    fn normal(&self) -> Vec3 {
        self.across().normalize_or_zero()
    }

    fn power(&self) -> f32 {
        0.5 * self.across().length() * self.radiance
    }
}

/// All triangles that emit.
#[derive(Debug, Default)]
pub(crate) struct Emitters {
    /// Group after group.
    members: Vec<Emitter>,
    /// Running sums of the powers within each one's group.
    powers: Vec<f32>,
    groups: Vec<Group>,
    /// By triangle of the mesh: its group, or the number of groups.
    group_of: Vec<u8>,
}

/// Triangles that are near each other.
#[derive(Debug)]
struct Group {
    /// The first of its emitters, and the first beyond.
    range: [usize; 2],
    power: f32,
    /// A ball about them.
    centre: Vec3,
    radius: f32,
    /// Their normals lie within `spread` radians of it.
    axis: Vec3,
    spread: f32,
}

/// What the groups may give a place, as running sums of probabilities.
#[derive(Debug)]
pub(crate) struct Choice {
    sums: Vec<f32>,
}

/// A point of an emitter.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Drawn {
    /// Triangle of the mesh.
    pub triangle: usize,
    /// In it.
    pub barycentrics: Vec3,
    /// World space, metres.
    pub position: Vec3,
    /// Of the front, unit length.
    pub normal: Vec3,
}

impl Emitters {
    /// Puts the triangles that emit, of a mesh of so many, into groups.
    pub(crate) fn new(mut emitters: Vec<Emitter>, triangles: usize) -> Self {
        emitters.retain(|emitter| emitter.power() > 0.0);
        let centres = || emitters.iter().map(Emitter::centre);
        let low = centres().fold(Vec3::INFINITY, Vec3::min);
        let high = centres().fold(Vec3::NEG_INFINITY, Vec3::max);
        let scale = NORMAL_EXTENT * (high - low).max_element().max(f32::MIN_POSITIVE);
        let mut ranges = Vec::new();
        if !emitters.is_empty() {
            halve(&mut emitters, 0, HALVINGS, scale, &mut ranges);
        }
        let mut all = Self {
            powers: Vec::with_capacity(emitters.len()),
            groups: Vec::with_capacity(ranges.len()),
            group_of: vec![ranges.len() as u8; triangles],
            members: emitters,
        };
        for (index, range) in ranges.into_iter().enumerate() {
            let members = &all.members[range[0]..range[1]];
            let group = Group::new(range, members);
            let mut sum = 0.0;
            for member in members {
                sum += member.power();
                all.powers.push(sum);
                all.group_of[member.triangle as usize] = index as u8;
            }
            all.groups.push(group);
        }
        all
    }

    /// Whether there are none.
    pub(crate) fn is_empty(&self) -> bool {
        self.members.is_empty()
    }

    /// How to draw for a place on a surface with a normal; `None` where nothing that emits is above it.
    pub(crate) fn seen_from(&self, position: Vec3, normal: Vec3) -> Option<Choice> {
        let mut sum = 0.0;
        let mut sums: Vec<f32> = (self.groups.iter())
            .map(|group| {
                sum += group.bound(position, normal);
                sum
            })
            .collect();
        if sum <= 0.0 {
            return None;
        }
        for value in &mut sums {
            *value /= sum;
        }
        Some(Choice { sums })
    }

    /// A point, from three uniform numbers in [0, 1).
    pub(crate) fn draw(&self, choice: &Choice, [which, u, v]: [f32; 3]) -> Drawn {
        let last = self.groups.len() - 1;
        let group = (choice.sums.partition_point(|sum| *sum <= which)).min(last);
        let [before, part] = choice.part(group);
        let Group { range, power, .. } = self.groups[group];
        // What is left of the number is uniform within the group.
        let target = ((which - before) / part).clamp(0.0, 1.0) * power;
        let within = &self.powers[range[0]..range[1]];
        let member = (within.partition_point(|sum| *sum <= target)).min(within.len() - 1);
        let emitter = &self.members[range[0] + member];
        let root = u.sqrt();
        let barycentrics = Vec3::new(1.0 - root, root * (1.0 - v), root * v);
        let [a, b, c] = emitter.corners;
        Drawn {
            triangle: emitter.triangle as usize,
            barycentrics,
            position: a * barycentrics.x + b * barycentrics.y + c * barycentrics.z,
            normal: emitter.normal(),
        }
    }

    /// Density of drawing a point of a triangle whose material has such a sum of radiances, 1/m².
    pub(crate) fn density(&self, choice: &Choice, triangle: usize, radiance: f32) -> f32 {
        let group = usize::from(self.group_of[triangle]);
        match self.groups.get(group) {
            Some(found) => choice.part(group)[1] * radiance / found.power,
            None => 0.0,
        }
    }
}

impl Choice {
    /// Where the probabilities of a group begin, and how much they are.
    fn part(&self, group: usize) -> [f32; 2] {
        let before = if group == 0 {
            0.0
        } else {
            self.sums[group - 1]
        };
        [before, self.sums[group] - before]
    }
}

impl Group {
    fn new(range: [usize; 2], members: &[Emitter]) -> Self {
        let corners = || members.iter().flat_map(|member| member.corners);
        let low = corners().fold(Vec3::INFINITY, Vec3::min);
        let high = corners().fold(Vec3::NEG_INFINITY, Vec3::max);
        let centre = 0.5 * (low + high);
        let axis: Vec3 = members.iter().map(Emitter::across).sum();
        let axis = axis.normalize_or_zero();
        let least = (members.iter())
            .map(|member| member.normal().dot(axis))
            .fold(1.0, f32::min);
        Self {
            range,
            power: members.iter().map(Emitter::power).sum(),
            centre,
            radius: corners().map(|at| at.distance(centre)).fold(0.0, f32::max),
            axis,
            spread: if axis == Vec3::ZERO {
                PI
            } else {
                math::acos(least.clamp(-1.0, 1.0))
            },
        }
    }

    /// About how much reaches a place: never 0 where something does.
    fn bound(&self, position: Vec3, normal: Vec3) -> f32 {
        let offset = self.centre - position;
        if offset.dot(normal) <= -self.radius {
            return 0.0;
        }
        let distance = offset.length();
        if distance <= self.radius {
            return self.power / (self.radius * self.radius).max(f32::MIN_POSITIVE);
        }
        let towards = offset / distance;
        let half = math::asin((self.radius / distance).min(1.0));
        // From the axis to this place, less what corners and normals may deviate.
        let away = math::acos((-towards).dot(self.axis).clamp(-1.0, 1.0)) - self.spread - half;
        if away >= FRAC_PI_2 {
            return 0.0;
        }
        let above = math::acos(towards.dot(normal).clamp(-1.0, 1.0)) - half;
        // Bounds of nearly nothing would leave what there is to a draw once in a while.
        let cosine = |angle: f32| math::cos(angle.max(0.0)).max(0.05);
        self.power * cosine(away) * cosine(above) / (distance * distance)
    }
}

/// Orders emitters so that groups follow each other, and tells where.
fn halve(
    emitters: &mut [Emitter],
    start: usize,
    times: u32,
    scale: f32,
    ranges: &mut Vec<[usize; 2]>,
) {
    if times == 0 || emitters.len() < 2 {
        ranges.push([start, start + emitters.len()]);
        return;
    }
    let key = |emitter: &Emitter, axis: usize| {
        if axis < 3 {
            emitter.centre()[axis]
        } else {
            scale * emitter.normal()[axis - 3]
        }
    };
    let extent = |axis: usize| {
        let keys = || emitters.iter().map(|emitter| key(emitter, axis));
        keys().fold(f32::NEG_INFINITY, f32::max) - keys().fold(f32::INFINITY, f32::min)
    };
    let widest = (0..6).map(|axis| (axis, extent(axis)));
    let widest = widest.fold(
        (0, -1.0),
        |best, next| if next.1 > best.1 { next } else { best },
    );
    emitters.sort_by(|a, b| {
        (key(a, widest.0).total_cmp(&key(b, widest.0))).then(a.triangle.cmp(&b.triangle))
    });
    let middle = emitters.len() / 2;
    let (left, right) = emitters.split_at_mut(middle);
    halve(left, start, times - 1, scale, ranges);
    halve(right, start + middle, times - 1, scale, ranges);
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A ball of triangles about (0, 0, 3), fronts outward.
    fn ball() -> Emitters {
        let at = |i: usize, j: usize| {
            let (theta, phi) = (PI * i as f32 / 12.0, 2.0 * PI * j as f32 / 24.0);
            let (s, c) = math::sin_cos(theta);
            Vec3::new(s * math::cos(phi), s * math::sin(phi), c) + 3.0 * Vec3::Z
        };
        let mut emitters = Vec::new();
        for (i, j) in (0..12).flat_map(|i| (0..24).map(move |j| (i, j))) {
            let [a, b, c, d] = [at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)];
            for corners in [[a, b, c], [a, c, d]] {
                emitters.push(Emitter {
                    triangle: emitters.len() as u32,
                    corners,
                    radiance: 3.0,
                });
            }
        }
        Emitters::new(emitters, 2 * 12 * 24)
    }

    #[test]
    fn what_is_drawn_weighs_what_is_there() {
        let all = ball();
        assert!(all.groups.len() == 1 << HALVINGS);
        for (position, normal) in [
            (Vec3::ZERO, Vec3::Z),
            (Vec3::new(2.0, 0.0, 3.0), Vec3::new(-0.8, 0.6, 0.0)),
            (Vec3::new(0.0, 1.05, 3.0), Vec3::NEG_Y),
        ] {
            let choice = all.seen_from(position, normal).expect("it is above");
            // The solid angle above the horizon, by what is drawn and on a grid of directions.
            let (mut drawn, count) = (0.0, 40_000);
            for i in 0..count {
                let number = |k: f32| (0.5 + i as f32 * k).fract();
                let which = (i as f32 + 0.5) / count as f32;
                let point = all.draw(&choice, [which, number(0.754_877_7), number(0.569_840_3)]);
                let offset = point.position - position;
                let squared = offset.length_squared();
                let cosine = -point.normal.dot(offset) / squared.sqrt();
                if cosine > 0.0 && offset.dot(normal) > 0.0 {
                    let density = all.density(&choice, point.triangle, 3.0);
                    drawn += cosine / (squared * density * count as f32);
                }
            }
            let (mut seen, steps) = (0.0, 400);
            for (i, j) in (0..steps).flat_map(|i| (0..steps).map(move |j| (i, j))) {
                let z = (i as f32 + 0.5) / steps as f32 * 2.0 - 1.0;
                let phi = 2.0 * PI * (j as f32 + 0.5) / steps as f32;
                let s = (1.0 - z * z).sqrt();
                let direction = Vec3::new(s * math::cos(phi), s * math::sin(phi), z);
                let offset = 3.0 * Vec3::Z - position;
                let along = offset.dot(direction);
                let meets = along > 0.0 && offset.length_squared() - along * along < 1.0;
                if meets && direction.dot(normal) > 0.0 {
                    seen += 4.0 * PI / (steps * steps) as f32;
                }
            }
            // Triangles lie a little inside of the ball.
            assert!((drawn / seen - 1.0).abs() < 0.03, "{drawn} of {seen}");
        }
    }

    #[test]
    fn behind_a_surface_there_is_nothing_to_draw() {
        let all = ball();
        assert!(all.seen_from(Vec3::ZERO, Vec3::NEG_Z).is_none());
        assert!(Emitters::new(Vec::new(), 4).is_empty());
    }
}
