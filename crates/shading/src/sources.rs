//! Suns, lamps and windows: light with an outline of its own, shadowed by rays.
//!
//! A source becomes points of equal luminance, the same for every pixel, so that there is no
//! noise. They are in groups of those that lie side by side, each in a cone of its own. Where nothing meets the cone
//! around the source, which one walk through the scene's hierarchy finds out, all of it is visible; where a ray to
//! each group and those to its rim all are blocked, nothing. Elsewhere every group tells for itself: by its cone, else
//! by rays, of which there are more for a source that matters much. The exact reflection models
//! ([`crate::models`]) weigh what arrives, at one place of a group where the reflection changes little over it.
//!
//! Most pixels of a tile ask for little of this: they take what the pixels about them agree on (`sources/seen.rs`).
//!
//! With antialiasing rays start all over the square that a pixel covers on the surface, each at a place of its
//! own, so that edges of shadows have no stairs at no further ray.

mod grid;
mod seen;

use relight_format::math;
use std::f32::consts::FRAC_1_PI;
use std::sync::Arc;

use bytemuck::Zeroable as _;
use glam::{Mat3, Vec2, Vec3};
use relight_format::Environment;

use self::grid::Grid;
pub use self::seen::Seen;
use crate::camera::View;
use crate::gpu;
use crate::models;
use crate::occluders::Occluders;
use crate::shadow_map::{DepthImage, Lookup};
use crate::spherical_gaussian::{SphericalGaussian, energy};
use crate::surface::{Model, Reflection, SurfacePoint};

/// Directions on the rim of a source: the outermost points in this many directions.
pub const RIM: u32 = 12;

/// Groups of a source's points.
pub const GROUPS: u32 = 8;

/// Places of a group, at which reflections look: each stands for a few points that lie side by side.
const PLACES: u32 = 8;

/// Most points of a group, to which rays go.
const GROUP_POINTS: u32 = 32;

/// Least points of a group: where all else is hidden, the least of sources may be all light there is.
const LEAST_POINTS: u32 = 4;

/// Points that sources are divided into.
pub const POINTS: u32 = GROUPS * GROUP_POINTS;

/// Entries of [`Sources::points`] for each source: its cone, its groups' cones, its rim, its groups' places and its
/// groups' points, behind which are zeros where those are few.
pub const STRIDE: u32 = FIRST_PLACE + GROUPS * PLACES + POINTS;

/// Of those, the first of groups, of the rim and of places.
const FIRST_GROUP: u32 = 1;
const FIRST_RIM: u32 = FIRST_GROUP + GROUPS;
const FIRST_PLACE: u32 = FIRST_RIM + RIM;
const FIRST_POINT: u32 = FIRST_PLACE + GROUPS * PLACES;

/// Place of a group that rays go to second, where those to the first are blocked: the one across the group.
const SECOND_PLACE: u32 = PLACES - 1;

/// Most of all light that one of a source's points stands for, where there may be more of them.
const POINT_SHARE: f32 = 0.125 / 64.0;

/// Radius of a source or of a group of its points, in roughnesses as slopes of the half vector, at which its middle stands
/// for all of it on the peak of a reflection. Far from there lobes change more slowly, or have nothing left to change.
const SMALL: f32 = 0.1;

/// Most radius at which its middle stands for all of it, radians.
const SMALL_DIFFUSE: f32 = 0.15;

/// Least cosine with the normal at which it does.
const LEAST_COSINE: f32 = 0.2;

/// Most that is raised to a power of e.
const MOST_EXPONENT: f32 = 80.0;

/// A bit for each group.
const ALL_GROUPS: u32 = (1 << GROUPS) - 1;

/// Taken from the cosine of a cone's half angle, so that rounding leaves no point outside.
const CONE_SLACK: f32 = 1e-6;

/// Sharpness of the lobe that stands for a point where sources are seen blurred.
const POINT_SHARPNESS: f32 = 1e4;

/// Longest side of the square that a pixel covers on a surface, over what it would be on one that
/// faces the eye. Surfaces seen edge-on may bend within a pixel.
const LONGEST_SIDE: f32 = 4.0;

/// What a ray meets closer than this times its way from the pixel's centre is the surface itself, which
/// is not as plane as the square.
const OWN: f32 = 2.0;

/// Parts of 2³² of a pixel from one ray to the next: the two numbers of Roberts 2018, "The Unreasonable
/// Effectiveness of Quasirandom Sequences".
const STEP: [u32; 2] = [3_242_174_889, 2_447_445_414];

/// Texels of four words for what a pixel sees of a source: a word about its groups, one of the bits of each, and one of
/// what an app's shadow map takes away.
pub const SEEN_TEXELS: u32 = (2 + GROUPS).div_ceil(4);

/// Of the word about groups: an app's shadow map takes light away, how much of it says one more word behind the others.
const SHADOWED: u32 = 1 << (2 * GROUPS);

/// Of a source and a workgroup's 64 pixels: how many such groups of texels lie side by side in an image.
pub const SEEN_COLUMNS: u32 = 16;

/// Most sources.
pub const MAX_SOURCES: u32 = relight_format::MAX_SOURCES as u32;

/// An environment's sources, as points. Clones share them.
#[derive(Clone, Debug)]
pub struct Sources {
    grids: Arc<[Grid]>,
    points: Arc<[gpu::SourcePoint]>,
    rotation: Mat3,
}

impl Sources {
    /// `None` where the environment has no sources.
    pub fn new(environment: &Environment) -> Option<Self> {
        let mut grids = Vec::new();
        let mut rest = environment.source_texels.as_slice();
        for &grid in &environment.sources {
            let (texels, behind) = rest.split_at_checked(grid.texels())?;
            grids.extend(Grid::new(grid, texels));
            rest = behind;
        }
        grids.truncate(MAX_SOURCES as usize);
        if grids.is_empty() {
            return None;
        }
        let lobes = environment.lobes.iter().map(|lobe| {
            let lobe = SphericalGaussian::from(lobe);
            grid::luminance(lobe.integral().into()).max(0.0)
        });
        let all = lobes.sum::<f32>() + grids.iter().map(|grid| grid.luminance).sum::<f32>();
        let entries = |grid: &Grid| entries(grid, points_of_group(grid.luminance / all));
        Some(Self {
            points: grids.iter().flat_map(entries).collect(),
            grids: grids.into(),
            rotation: Mat3::IDENTITY,
        })
    }

    /// Number of sources, at least 1.
    pub fn count(&self) -> usize {
        self.grids.len()
    }

    /// The direction that a source's light comes from, in the middle of it; `None` where there is no such source.
    pub fn axis(&self, source: usize) -> Option<Vec3> {
        let cones = self.points.chunks_exact(STRIDE as usize);
        Some(cones.map(|all| all[0].direction).nth(source)?.into())
    }

    /// Per source [`STRIDE`] entries.
    pub fn points(&self) -> &[gpu::SourcePoint] {
        &self.points
    }

    /// The sources turned, world space.
    #[must_use]
    pub fn turned(&self, rotation: &Mat3) -> Self {
        let turn = |point: &gpu::SourcePoint| gpu::SourcePoint {
            direction: (*rotation * Vec3::from(point.direction)).into(),
            ..*point
        };
        Self {
            points: self.points.iter().map(turn).collect(),
            rotation: *rotation * self.rotation,
            ..self.clone()
        }
    }

    /// The sources as narrow lobes, for what sees them blurred: light that bounces.
    pub fn lobes(&self) -> impl Iterator<Item = SphericalGaussian> {
        self.each_as_lobes().flatten()
    }

    /// The same, source by source.
    pub fn each_as_lobes(&self) -> impl Iterator<Item = impl Iterator<Item = SphericalGaussian>> {
        let lobe = |point: &gpu::SourcePoint| SphericalGaussian {
            axis: point.direction.into(),
            sharpness: POINT_SHARPNESS,
            amplitude: Vec3::from(point.light) / energy(POINT_SHARPNESS),
        };
        let sources = self.points.chunks_exact(STRIDE as usize);
        sources.map(move |all| {
            all[FIRST_PLACE as usize..FIRST_POINT as usize]
                .iter()
                .map(lobe)
        })
    }

    /// A direction of one source, drawn in proportion to luminance by two numbers in [0, 1), and
    /// the light of the whole source as that direction's colour has it.
    pub fn sample(&self, source: usize, uniform: [f32; 2]) -> (Vec3, Vec3) {
        let (direction, light) = self.grids[source].sample(uniform);
        (self.rotation * direction, light)
    }
}

/// How many points a group has of a source that has a part of all light.
fn points_of_group(share: f32) -> u32 {
    let least = (share / (GROUPS as f32 * POINT_SHARE)).ceil() as u32;
    least.clamp(LEAST_POINTS, GROUP_POINTS).next_power_of_two()
}

/// How many points a group has of a source.
fn of_group(all: &[gpu::SourcePoint]) -> u32 {
    all[FIRST_RIM as usize].cone_cosine as u32
}

/// The entries of a source whose groups have so many points.
fn entries(grid: &Grid, of_group: u32) -> Vec<gpu::SourcePoint> {
    let mut points = grid.points();
    let axis = mean(&points).0;
    arrange(&mut points, axis.any_orthonormal_pair().into());
    let entry = |(direction, light): (Vec3, Vec3)| gpu::SourcePoint {
        direction: direction.into(),
        ray_offset: 0.0,
        light: light.into(),
        cone_cosine: 0.0,
    };
    let cone = |points: &[(Vec3, Vec3)]| {
        let (axis, light) = mean(points);
        let cosines = points.iter().map(|(direction, _)| axis.dot(*direction));
        gpu::SourcePoint {
            cone_cosine: cosines.fold(1.0, f32::min) - CONE_SLACK,
            ..entry((axis, light))
        }
    };
    let mut rim: Vec<_> = rim(&points, axis)
        .map(|direction| entry((direction, Vec3::ZERO)))
        .collect();
    rim[0].cone_cosine = of_group as f32;
    let divided = |parts: u32| points.chunks((GROUP_POINTS / parts) as usize);
    let place = |points: &[(Vec3, Vec3)]| entry(mean(points));
    std::iter::once(cone(&points))
        .chain(divided(1).map(cone))
        .chain(rim)
        .chain(divided(PLACES).map(place))
        .chain(divided(of_group).map(place))
        .chain(std::iter::repeat(gpu::SourcePoint::zeroed()))
        .take(STRIDE as usize)
        .collect()
}

/// The direction in the middle of points of equal luminance, and their light.
fn mean(points: &[(Vec3, Vec3)]) -> (Vec3, Vec3) {
    let sum: Vec3 = points.iter().map(|(direction, _)| *direction).sum();
    let light = points.iter().map(|(_, light)| *light).sum();
    (sum.normalize_or(Vec3::Y), light)
}

/// Orders points so that every half, every quarter and so on lies side by side, as seen along two axes.
fn arrange(points: &mut [(Vec3, Vec3)], axes: [Vec3; 2]) {
    if points.len() < 2 {
        return;
    }
    let extent = |axis: &Vec3| {
        let along = points.iter().map(|(direction, _)| axis.dot(*direction));
        along.clone().fold(f32::MIN, f32::max) - along.fold(f32::MAX, f32::min)
    };
    let [x, y] = axes.each_ref().map(extent);
    let axis = if x >= y { axes[0] } else { axes[1] };
    points.sort_by(|(a, _), (b, _)| axis.dot(*a).total_cmp(&axis.dot(*b)));
    let (low, high) = points.split_at_mut(points.len() / 2);
    arrange(low, axes);
    arrange(high, axes);
}

/// The points that lie farthest out from an axis.
fn rim(points: &[(Vec3, Vec3)], axis: Vec3) -> impl Iterator<Item = Vec3> {
    let (x, y) = axis.any_orthonormal_pair();
    (0..RIM).map(move |index| {
        let (sin, cos) = math::sin_cos(std::f32::consts::TAU * index as f32 / RIM as f32);
        let toward = x * cos + y * sin;
        let directions = points.iter().map(|(direction, _)| *direction);
        let farthest = directions.max_by(|a, b| a.dot(toward).total_cmp(&b.dot(toward)));
        farthest.unwrap_or(axis)
    })
}

/// Sources over a scene, turned.
#[derive(Clone, Copy, Debug)]
pub struct Lit<'a> {
    /// The sources.
    pub sources: &'a Sources,
    /// What blocks their light.
    pub occluders: &'a Occluders,
    /// Rays start at this distance from the surface, along its geometric normal.
    pub ray_offset: f32,
    /// The pixel whose square is lit, with antialiasing; without, a point is.
    pub pixel: Option<Pixel<'a>>,
    /// An app's own shadow map.
    pub shadow_map: Option<(Lookup, DepthImage<'a>)>,
}

/// A pixel that sees a surface.
#[derive(Clone, Copy, Debug)]
pub struct Pixel<'a> {
    /// Of the picture.
    pub view: &'a View,
    /// From the place of the picture where the surface was met to the pixel's centre, pixels.
    pub centre: Vec2,
}

impl<'a> Pixel<'a> {
    /// The pixel around a place of a picture.
    pub fn around(view: &'a View, place: Vec2) -> Self {
        let centre = place.floor() + 0.5 - place;
        Self { view, centre }
    }
}

impl Lit<'_> {
    /// Radiance of them from `point` towards the eye by one of its reflections, and with the first by its Lambertian base.
    pub fn shown(&self, point: &SurfacePoint, seen: &[Seen], index: usize) -> Vec3 {
        let reflection = &point.appearance.reflections[index];
        let mut diffuse = Vec3::ZERO;
        if index == 0 {
            diffuse = point.appearance.diffuse * FRAC_1_PI;
        }
        if diffuse == Vec3::ZERO && reflection.model == Model::None {
            return Vec3::ZERO;
        }
        let wo = point.to_local(point.view);
        let shown = |source: &gpu::SourcePoint| {
            let wi = point.to_local(source.direction.into());
            if wi.z <= 0.0 {
                return Vec3::ZERO;
            }
            let value = diffuse + models::evaluate_specular(reflection, wi, wo);
            Vec3::from(source.light) * (wi.z * value)
        };
        let is_small = |cone: &gpu::SourcePoint| {
            let wi = point.to_local(cone.direction.into());
            is_small(reflection, cone.cone_cosine, wi, wo)
        };
        let of_source = |(all, seen): (&[gpu::SourcePoint], &Seen)| {
            if seen.whole == ALL_GROUPS && is_small(&all[0]) {
                return shown(&all[0]) * (1.0 - seen.hidden);
            }
            let mut sum = Vec3::ZERO;
            let points = of_group(all);
            for group in 0..GROUPS {
                let part = seen.part(group, points);
                if part == 0.0 {
                    continue;
                }
                let cone = &all[(FIRST_GROUP + group) as usize];
                if is_small(cone) {
                    sum += part * shown(cone);
                    continue;
                }
                for place in 0..PLACES {
                    let part = seen.part_of_place(group, points, place);
                    if part > 0.0 {
                        sum += part * shown(&all[(FIRST_PLACE + group * PLACES + place) as usize]);
                    }
                }
            }
            sum * (1.0 - seen.hidden)
        };
        let all = self.sources.points.chunks_exact(STRIDE as usize);
        all.zip(seen).map(of_source).sum()
    }
}

/// Whether what is reflected from one direction of a cone, its axis `wi`, stands for all of it.
fn is_small(reflection: &Reflection, cosine: f32, wi: Vec3, wo: Vec3) -> bool {
    let radius_squared = 2.0 * (1.0 - cosine);
    if wi.z <= LEAST_COSINE || radius_squared > SMALL_DIFFUSE * SMALL_DIFFUSE {
        return false;
    }
    if reflection.model == Model::None {
        return true;
    }
    let half = (wi + wo).normalize();
    let alpha = reflection.roughness();
    // In roughnesses, as slopes of the half vector: how far the lobe's peak is, the radius of the cone, and how near it
    // comes to the peak.
    let away = (half.truncate() / (alpha * half.z)).length();
    let radius =
        radius_squared.sqrt() / (2.0 * half.dot(wo) * half.z * half.z * alpha.min_element());
    let near = (away - radius).max(0.0);
    if reflection.model == Model::Ggx {
        return radius * radius <= SMALL * SMALL * (1.0 + near * near);
    }
    let most = SMALL * SMALL * math::exp((near * near).min(MOST_EXPONENT));
    radius * radius * (1.0 + 4.0 * away * away) <= most
}

/// The constants of this module, as WGSL.
pub fn wgsl_constants() -> String {
    let counts = [
        ("MAX_SOURCES", MAX_SOURCES),
        ("SOURCE_RIM", RIM),
        ("SOURCE_GROUPS", GROUPS),
        ("SOURCE_PLACES", PLACES),
        ("SOURCE_SECOND_PLACE", SECOND_PLACE),
        ("SOURCE_STRIDE", STRIDE),
        ("SOURCE_FIRST_GROUP", FIRST_GROUP),
        ("SOURCE_FIRST_RIM", FIRST_RIM),
        ("SOURCE_FIRST_PLACE", FIRST_PLACE),
        ("SOURCE_FIRST_POINT", FIRST_POINT),
        ("SOURCE_SEEN_TEXELS", SEEN_TEXELS),
        ("SOURCE_SHADOWED", SHADOWED),
        ("SOURCE_SEEN_COLUMNS", SEEN_COLUMNS),
        ("SOURCE_TURN", seen::TURN),
        ("SOURCE_QUARTER", seen::QUARTER),
        ("SOURCE_ALL_GROUPS", ALL_GROUPS),
    ];
    let constants = counts.map(|(name, count)| format!("const {name}: u32 = {count}u;\n"));
    constants.concat()
        + &format!(
            "const SOURCE_LONGEST_SIDE: f32 = {LONGEST_SIDE:?};\n\
         const SOURCE_OWN: f32 = {OWN:?};\n\
         const SOURCE_SMALL: f32 = {SMALL:?};\n\
         const SOURCE_SMALL_DIFFUSE: f32 = {SMALL_DIFFUSE:?};\n\
         const SOURCE_LEAST_COSINE: f32 = {LEAST_COSINE:?};\n\
         const SOURCE_MOST_EXPONENT: f32 = {MOST_EXPONENT:?};\n\
         const SOURCE_STEP: vec2<u32> = vec2({}u, {}u);\n",
            STEP[0], STEP[1],
        )
}

#[cfg(test)]
impl<'a> Lit<'a> {
    /// Of points that are no pixels, with rays that start on the surface.
    fn at_points(sources: &'a Sources, occluders: &'a Occluders) -> Self {
        Self {
            sources,
            occluders,
            ray_offset: 0.0,
            pixel: None,
            shadow_map: None,
        }
    }

    /// Radiance from `point` towards the eye, which is above its horizon; adds the number of
    /// rays cast, a cone counting as one.
    fn radiance(&self, point: &SurfacePoint, rays: &mut u64) -> Vec3 {
        let seen = self.seen(point, rays);
        (0..crate::surface::MAX_REFLECTIONS)
            .map(|index| self.shown(point, &seen, index))
            .sum()
    }

    /// What is visible of every source from `point`, whose horizon the eye is above; adds the number of rays
    /// cast, a cone counting as one.
    fn seen(&self, point: &SurfacePoint, rays: &mut u64) -> Vec<Seen> {
        self.seen_between(point, &[], 0, rays)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::occluders::Node;
    use crate::surface::{Appearance, Reflection, local_point};

    /// A window whose colour changes across it, and a lamp of one texel.
    fn environment() -> Environment {
        Environment {
            sources: vec![
                relight_format::Source {
                    theta: 0.5,
                    phi: -0.4,
                    row_step: 0.02,
                    column_step: 0.05,
                    rows: 20,
                    columns: 16,
                },
                relight_format::Source {
                    theta: 1.0,
                    phi: 2.0,
                    row_step: 0.006,
                    column_step: 0.006,
                    rows: 1,
                    columns: 1,
                },
            ],
            source_texels: (0..321)
                .map(|index| {
                    let x = (8 + 3 * (index % 16)) as f32;
                    [x, 64.0 - x, if index < 100 { 0.0 } else { 3.0 }]
                })
                .collect(),
            ..Environment::default()
        }
    }

    /// Light of every source, straight from the texels.
    fn light(environment: &Environment) -> Vec<Vec3> {
        let mut texels = environment.source_texels.iter();
        (environment.sources.iter())
            .map(|source| {
                let mut sum = Vec3::ZERO;
                for row in 0..source.rows {
                    let theta = source.theta + row as f32 * source.row_step;
                    let solid_angle = source.column_step
                        * 2.0
                        * math::sin(theta)
                        * math::sin(0.5 * source.row_step);
                    for _ in 0..source.columns {
                        sum += solid_angle * Vec3::from(*texels.next().unwrap());
                    }
                }
                sum
            })
            .collect()
    }

    #[test]
    fn every_level_carries_the_light_of_its_source() {
        let environment = environment();
        let sources = Sources::new(&environment).unwrap();
        assert_eq!(sources.count(), 2);
        let all = sources.points().chunks(STRIDE as usize);
        for (all, light) in all.zip(light(&environment)) {
            let parts = [0, FIRST_GROUP, FIRST_RIM, FIRST_PLACE, FIRST_POINT, STRIDE];
            let parts = parts.map(|part| part as usize);
            let [whole, groups, rim, places, points] =
                [0, 1, 2, 3, 4].map(|part| &all[parts[part]..parts[part + 1]]);
            let of_group = of_group(all);
            let points = &points[..(GROUPS * of_group) as usize];
            assert!(rim.iter().all(|probe| probe.light == [0.0; 3]));
            for level in [whole, groups, places, points] {
                let sum: Vec3 = level.iter().map(|point| Vec3::from(point.light)).sum();
                let error = (sum - light).abs();
                assert!(error.cmple(1e-5 * light).all(), "{sum} for {light}");
                for point in level {
                    assert!((Vec3::from(point.direction).length() - 1.0).abs() < 1e-5);
                }
            }
            let holds = |cone: &gpu::SourcePoint, points: &[gpu::SourcePoint]| {
                let axis = Vec3::from(cone.direction);
                let cosines = points.iter().map(|point| axis.dot(point.direction.into()));
                assert!(cosines.fold(1.0, f32::min) >= cone.cone_cosine);
            };
            holds(&all[0], points);
            holds(&all[0], rim);
            let of_groups = points.chunks(of_group as usize);
            for ((group, points), places) in
                (groups.iter().zip(of_groups)).zip(places.chunks(PLACES as usize))
            {
                holds(group, points);
                holds(group, places);
                // Side by side: a group is no wider than a part of the source.
                assert!(
                    2.0 * group.cone_cosine >= 1.0 + all[0].cone_cosine,
                    "{group:?}"
                );
            }
        }
    }

    #[test]
    fn only_sources_that_matter_ask_for_all_points() {
        let mut environment = environment();
        let asked = |environment: &Environment| {
            let sources = Sources::new(environment).unwrap();
            let rims = sources.points()[FIRST_RIM as usize..].iter();
            rims.step_by(STRIDE as usize)
                .map(|first| first.cone_cosine as u32)
                .collect::<Vec<_>>()
        };
        let [few, all] = [LEAST_POINTS, GROUP_POINTS];
        assert_eq!(asked(&environment), [all, few]);
        environment.source_texels[320] = [1e8; 3];
        assert_eq!(asked(&environment), [few, all]);
        environment.lobes.push(relight_format::Lobe {
            axis: [0.0, 1.0, 0.0],
            sharpness: 1.0,
            amplitude: [1e8; 3],
            reserved: 0.0,
        });
        assert_eq!(asked(&environment), [few, few]);
        let shares = [0.0, 0.04, 0.1, 0.2, 0.3, 1.0];
        assert_eq!(shares.map(points_of_group), [4, 4, 8, 16, 32, 32]);
    }

    #[test]
    fn a_source_of_no_light_is_none() {
        let mut environment = environment();
        environment.source_texels.fill([0.0; 3]);
        assert!(Sources::new(&environment).is_none());
        assert!(Sources::new(&Environment::default()).is_none());
    }

    /// 64 points in place of a source, a glossy lobe not much wider.
    const QUADRATURE_TOLERANCE: f32 = 0.02;

    #[test]
    #[allow(clippy::disallowed_methods)]
    fn reflected_light_is_that_of_the_models() {
        let environment = environment();
        let sources = Sources::new(&environment).unwrap();
        // World +Y is the local normal.
        let turn = Mat3::from_rotation_x(std::f32::consts::FRAC_PI_2);
        let sources = sources.turned(&turn);
        let empty = Occluders::default();
        let lit = Lit::at_points(&sources, &empty);
        let reflection = Reflection::new(Model::Ggx, Vec3::splat(0.6), Vec2::splat(0.3));
        for appearance in [
            Appearance::new(Vec3::splat(0.5), &[]),
            Appearance::new(Vec3::splat(0.2), &[reflection]),
        ] {
            let point = local_point(appearance, Vec3::new(0.5, 0.2, 0.8).normalize());
            let mut rays = 0;
            let found = lit.radiance(&point, &mut rays);
            assert_eq!(rays, 2, "one cone for each source");
            // Many random points.
            let count = 1 << 14;
            let mut expected = Vec3::ZERO;
            for source in 0..sources.count() {
                for index in 0..count {
                    let [u, v] = [0.754_877_7, 0.569_840_3f64]
                        .map(|step| (f64::from(index) * step).fract() as f32);
                    let (direction, light) = sources.sample(source, [u, v]);
                    let wi = point.to_local(direction);
                    let value = models::evaluate(&appearance, wi, point.to_local(point.view));
                    expected += light * value * (wi.z.max(0.0) / count as f32);
                }
            }
            let error = ((found - expected) / expected).abs().max_element();
            println!("{found} for {expected}");
            assert!(error < QUADRATURE_TOLERANCE, "{error}");
        }
    }

    /// The widest cones whose middle stands for them reflect what their middle does.
    #[test]
    fn middles_of_small_cones_reflect_as_much_as_all_of_them() {
        let mut wide = 0;
        for (model, x, y) in [
            (Model::Ggx, 0.1, 0.1),
            (Model::Ggx, 0.15, 0.5),
            (Model::Ward, 0.15, 0.3),
            (Model::CookTorrance, 0.1, 0.1),
            (Model::BlinnPhong, 200.0, 200.0),
            (Model::AshikhminShirley, 0.1, 0.2),
        ] {
            let reflection = Reflection::new(model, Vec3::ONE, Vec2::new(x, y));
            for (view, azimuth) in [(0.2f32, 0.0f32), (0.9, 0.7), (0.95, 2.0), (0.5, 1.2)] {
                let (sin, cos) = math::sin_cos(azimuth);
                let wo = (Vec2::new(cos, sin) * (1.0 - view * view).sqrt()).extend(view);
                let value = |wi: Vec3| wi.z * models::evaluate_specular(&reflection, wi, wo).x;
                let peak = value(Vec3::new(-wo.x, -wo.y, wo.z));
                for index in 0..400u32 {
                    let wi = local(index);
                    let cosine = |radius: f32| 1.0 - 0.5 * radius * radius;
                    let radii = (1..15).rev().map(|step| 0.01 * step as f32);
                    let mut small =
                        radii.filter(|radius| is_small(&reflection, cosine(*radius), wi, wo));
                    let Some(radius) = small.next() else {
                        continue;
                    };
                    wide += u32::from(radius > 0.1);
                    let (u, v) = wi.any_orthonormal_pair();
                    let around = |step: u32| {
                        let away = radius * ((step as f32 + 0.5) / 64.0).sqrt();
                        let (sin, cos) = math::sin_cos(2.399_963_2 * step as f32);
                        value((wi + away * (cos * u + sin * v)).normalize())
                    };
                    let mean = (0..64).map(around).sum::<f32>() / 64.0;
                    let error = (value(wi) - mean).abs() / (mean + 0.1 * peak);
                    assert!(
                        error < 0.04,
                        "{model:?} {x} {y} {wo} {wi} {radius}: {error}"
                    );
                }
            }
        }
        assert!(wide > 1000, "{wide}");
    }

    /// Directions all over the hemisphere.
    fn local(index: u32) -> Vec3 {
        let z = (index as f32 + 0.5) / 400.0;
        let (sin, cos) = math::sin_cos(2.399_963_2 * index as f32);
        (Vec2::new(cos, sin) * (1.0 - z * z).sqrt()).extend(z)
    }

    #[test]
    fn what_is_hidden_is_dark_and_half_is_half() {
        let mut environment = environment();
        environment.source_texels.fill([2.0; 3]);
        // One square texel grid about the equator's x axis, as uniform as a source can be.
        environment.sources.truncate(1);
        environment.source_texels.truncate(320);
        let sources = Sources::new(&environment).unwrap();
        let middle = Vec3::from(environment.sources[0].direction());
        // A frame whose normal is the middle of the source.
        let turn = Mat3::from_quat(glam::Quat::from_rotation_arc(middle, Vec3::Z));
        let sources = sources.turned(&turn);
        let wall = |edge: f32| {
            let triangle = [
                Vec3::new(-100.0, -100.0, 1.0),
                Vec3::new(edge, -100.0, 1.0),
                Vec3::new(edge, 300.0, 1.0),
            ];
            let root = Node {
                low: triangle[0],
                high: triangle[2],
                first: 0,
                count: 1,
            };
            Occluders::new(&[root], &[triangle])
        };
        let radiance = |edge| {
            let occluders = wall(edge);
            let lit = Lit::at_points(&sources, &occluders);
            let point = local_point(Appearance::new(Vec3::ONE, &[]), Vec3::Z);
            lit.radiance(&point, &mut 0).x
        };
        let whole = light(&environment)[0].x * FRAC_1_PI;
        assert!((radiance(-10.0) / whole - 1.0).abs() < 0.05 && whole > 0.0);
        assert_eq!(radiance(10.0), 0.0);
        let half = radiance(0.0) / radiance(-10.0);
        assert!((half - 0.5).abs() < 0.02, "{half}");
        // No steps: a wall that moves by a hundredth of the source changes little at a time.
        let mut last = radiance(-0.3);
        for step in 1..60 {
            let next = radiance(-0.3 + 0.01 * step as f32);
            assert!(
                next <= last + 1e-6 && last - next < 0.06 * whole,
                "{step}: {last} {next}"
            );
            last = next;
        }
    }
}
