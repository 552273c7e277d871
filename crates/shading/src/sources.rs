//! Suns, lamps and windows: light with an outline of its own, shadowed by rays.
//!
//! A source becomes points of equal luminance, the same for every pixel, so that there is no
//! noise. Where nothing meets the cone around them, which one walk through the scene's hierarchy
//! finds out, all are visible; elsewhere there is a ray to each. Rays end early where the first
//! points and the rim agree that all of the source is visible, or nothing. The exact reflection models
//! ([`crate::models`]) weigh what arrives.
//!
//! With antialiasing rays start all over the square that a pixel covers on the surface, each at a place of its
//! own, so that edges of shadows have no stairs at no further ray.

use relight_format::math;
use std::f32::consts::FRAC_1_PI;
use std::sync::Arc;

use glam::{Mat3, Vec2, Vec3};
use relight_format::Environment;

use crate::camera::View;
use crate::gpu;
use crate::models;
use crate::occluders::Occluders;
use crate::spherical_gaussian::{SphericalGaussian, energy};
use crate::surface::{MAX_REFLECTIONS, Model, SurfacePoint};

/// Directions on the rim of a source: the outermost points in this many directions.
pub const RIM: u32 = 12;

/// Points that stand for a source where all of it is visible, and where some of it is hidden. The
/// fewer are the first of the more, and with the rim find out which is the case.
pub const LEVELS: [u32; 2] = [64, 256];

/// Points of a source.
pub const POINTS: u32 = LEVELS[1];

/// Entries of [`Sources::points`] for each source: its cone, its rim and its points.
pub const STRIDE: u32 = 1 + RIM + POINTS;

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

/// Texels of four words for the points of a source that a pixel sees: a word of whether there are any, a bit for each.
pub const SEEN_TEXELS: u32 = (1 + POINTS / 32).div_ceil(4);

/// Of a source and a workgroup's 64 pixels: how many such groups of texels lie side by side in an image.
pub const SEEN_COLUMNS: u32 = 16;

/// Most sources.
pub const MAX_SOURCES: u32 = relight_format::MAX_SOURCES as u32;

/// An environment's sources, as points. Clones share them.
#[derive(Clone, Debug)]
pub struct Sources {
    grids: Arc<[Grid]>,
    points: Arc<[gpu::SourcePoint]>,
    scales: Arc<[[Vec3; 2]]>,
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
        let (mut points, mut scales) = (Vec::new(), Vec::new());
        for grid in &grids {
            let new: Vec<_> = (0..POINTS).map(|index| grid.point(index)).collect();
            scales.push(LEVELS.map(|level| grid.scale(&new[..level as usize])));
            points.extend(cone_and_rim(&new));
            points.extend(new);
        }
        Some(Self {
            grids: grids.into(),
            points: points.into(),
            scales: scales.into(),
            rotation: Mat3::IDENTITY,
        })
    }

    /// Number of sources, at least 1.
    pub fn count(&self) -> usize {
        self.grids.len()
    }

    /// Per source the cone around its points, [`RIM`] directions of no light, and [`POINTS`] points.
    pub fn points(&self) -> &[gpu::SourcePoint] {
        &self.points
    }

    /// By source and level, what a point's light is multiplied by.
    pub fn scales(&self) -> &[[Vec3; 2]] {
        &self.scales
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
        let sources = (self.points.chunks_exact(STRIDE as usize)).zip(self.scales.iter());
        sources.flat_map(|(points, scales)| {
            let points = &points[(1 + RIM) as usize..][..LEVELS[0] as usize];
            points.iter().map(|point| SphericalGaussian {
                axis: point.direction.into(),
                sharpness: POINT_SHARPNESS,
                amplitude: Vec3::from(point.light) * scales[0] / energy(POINT_SHARPNESS),
            })
        })
    }

    /// A direction of one source, drawn in proportion to luminance by two numbers in [0, 1), and
    /// the light of the whole source as that direction's colour has it.
    pub fn sample(&self, source: usize, uniform: [f32; 2]) -> (Vec3, Vec3) {
        let (direction, light) = self.grids[source].sample(uniform);
        (self.rotation * direction, light)
    }
}

/// The cone around a source's points, and those that lie farthest out.
fn cone_and_rim(points: &[gpu::SourcePoint]) -> impl Iterator<Item = gpu::SourcePoint> {
    let directions = points.iter().map(|point| Vec3::from(point.direction));
    let axis = directions.clone().sum::<Vec3>().normalize_or(Vec3::Y);
    let least = directions
        .clone()
        .fold(1f32, |least, other| least.min(axis.dot(other)));
    let dark = |direction: Vec3, cone_cosine| gpu::SourcePoint {
        direction: direction.into(),
        ray_offset: 0.0,
        light: [0.0; 3],
        cone_cosine,
    };
    let (x, y) = axis.any_orthonormal_pair();
    let rim = (0..RIM).map(move |index| {
        let (sin, cos) = math::sin_cos(std::f32::consts::TAU * index as f32 / RIM as f32);
        let toward = x * cos + y * sin;
        let farthest = directions
            .clone()
            .max_by(|a, b| a.dot(toward).total_cmp(&b.dot(toward)));
        dark(farthest.unwrap_or(axis), 0.0)
    });
    std::iter::once(dark(axis, least - CONE_SLACK)).chain(rim)
}

/// A source as stored, to be drawn from.
#[derive(Clone, Debug)]
struct Grid {
    stored: relight_format::Source,
    texels: Vec<[f32; 3]>,
    /// Running sums of luminance over rows, and within each row.
    rows: Vec<f32>,
    columns: Vec<f32>,
    /// Luminance of everything.
    luminance: f32,
    /// Light of everything.
    light: Vec3,
}

fn luminance(color: [f32; 3]) -> f32 {
    0.2126 * color[0] + 0.7152 * color[1] + 0.0722 * color[2]
}

impl Grid {
    /// `None` for a black source.
    fn new(grid: relight_format::Source, texels: &[[f32; 3]]) -> Option<Self> {
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

    fn sample(&self, [u, v]: [f32; 2]) -> (Vec3, Vec3) {
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

    fn point(&self, index: u32) -> gpu::SourcePoint {
        let (direction, light) = self.sample(sobol_pair(index));
        gpu::SourcePoint {
            direction: direction.into(),
            ray_offset: 0.0,
            cone_cosine: 0.0,
            light: (light / POINTS as f32).into(),
        }
    }

    /// What makes the light of some points that of the source.
    fn scale(&self, points: &[gpu::SourcePoint]) -> Vec3 {
        let sum: Vec3 = points.iter().map(|point| Vec3::from(point.light)).sum();
        // No point may have a channel that is next to nothing.
        let scale = |channel: usize| match sum[channel] {
            0.0 => 0.0,
            sum => self.light[channel] / sum,
        };
        Vec3::new(scale(0), scale(1), scale(2))
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

/// Where in a pixel the ray to a point starts, from its centre, in columns and rows: −½ to ½.
fn place(index: u32) -> Vec2 {
    STEP.map(|step| ((index.wrapping_mul(step) >> 8) ^ (1 << 23)) as f32 / 16_777_216.0 - 0.5)
        .into()
}

/// The sides of the square that a pixel covers on the plane of a surface, and the radius around it.
fn square(view: &View, point: &SurfacePoint) -> ([Vec3; 2], f32) {
    let Some(steps) = view.steps(point.geometric_normal, point.position) else {
        return ([Vec3::ZERO; 2], 0.0);
    };
    // The plane that faces the eye is crossed by the same rays.
    let facing = view.steps(point.view, point.position);
    let facing = facing.unwrap_or([Vec3::ZERO; 2]).map(Vec3::length);
    let longest = LONGEST_SIDE * facing[0].max(facing[1]);
    let [x, y] = steps.map(|side| side * (longest / side.length().max(1e-20)).min(1.0));
    ([x, y], 0.5 * (x + y).length().max((x - y).length()))
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

/// Which points of a source a pixel sees.
#[derive(Clone, Copy, Debug, Default)]
pub struct Seen {
    /// A bit each.
    points: [u32; (POINTS / 32) as usize],
    /// Of [`LEVELS`].
    level: usize,
}

impl Lit<'_> {
    /// Radiance from `point` towards the eye, which is above its horizon; adds the number of
    /// rays cast, a cone counting as one.
    pub fn radiance(&self, point: &SurfacePoint, rays: &mut u64) -> Vec3 {
        let seen = self.seen(point, rays);
        (0..MAX_REFLECTIONS)
            .map(|index| self.shown(point, &seen, index))
            .sum()
    }

    /// The points of every source that are visible from `point`, whose horizon the eye is above; adds the number of rays
    /// cast, a cone counting as one.
    pub fn seen(&self, point: &SurfacePoint, rays: &mut u64) -> Vec<Seen> {
        let origin = point.position + point.geometric_normal * self.ray_offset;
        let square = |pixel: Pixel| square(pixel.view, point);
        let ([x, y], radius) = self.pixel.map_or(([Vec3::ZERO; 2], 0.0), square);
        let at = |place: Vec2| x * place.x + y * place.y;
        let from_point = self.pixel.map_or(Vec2::ZERO, |pixel| pixel.centre);
        let origin = origin + at(from_point);
        let mut of_source = |all: &[gpu::SourcePoint]| {
            let mut found = Seen::default();
            let (cone, all) = (all[0], &all[1..]);
            let (rim, points) = all.split_at(RIM as usize);
            let above = |source: &gpu::SourcePoint| point.to_local(source.direction.into()).z > 0.0;
            if !rim.iter().any(above) && !points[..LEVELS[0] as usize].iter().any(above) {
                return found;
            }
            let (axis, cosine) = (cone.direction.into(), cone.cone_cosine);
            let touched = (self.occluders).meet_cone(origin, radius, axis, cosine);
            *rays += 1;
            let mut visible = |place: Vec2, source: &gpu::SourcePoint| {
                if point.geometric_normal.dot(source.direction.into()) <= 0.0 {
                    return false;
                }
                if !touched {
                    return true;
                }
                *rays += 1;
                let nearest = OWN * at(place + from_point).length();
                !(self.occluders).block(origin + at(place), source.direction.into(), nearest)
            };
            let (mut seen, mut hidden) = (false, false);
            for (index, source) in points.iter().enumerate() {
                if index == LEVELS[0] as usize {
                    for probe in rim {
                        if !(seen && hidden) && above(probe) {
                            let visible = visible(Vec2::ZERO, probe);
                            seen |= visible;
                            hidden |= !visible;
                        }
                    }
                    found.level = usize::from(hidden);
                    if !(seen && hidden) {
                        break;
                    }
                }
                if above(source) {
                    let visible = visible(place(index as u32), source);
                    seen |= visible;
                    hidden |= !visible;
                    found.points[index / 32] |= u32::from(visible) << (index % 32);
                }
            }
            found
        };
        let all = self.sources.points.chunks_exact(STRIDE as usize);
        all.map(&mut of_source).collect()
    }

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
        let of_source = |((all, scales), seen): ((&[gpu::SourcePoint], &[Vec3; 2]), &Seen)| {
            let mut sum = Vec3::ZERO;
            for (word, &bits) in all[(1 + RIM) as usize..].chunks(32).zip(&seen.points) {
                for source in (0..32)
                    .filter(|bit| bits & (1 << bit) != 0)
                    .map(|bit| &word[bit])
                {
                    let wi = point.to_local(source.direction.into());
                    let value = diffuse + models::evaluate_specular(reflection, wi, wo);
                    sum += Vec3::from(source.light) * (wi.z * value);
                }
            }
            sum * scales[seen.level]
        };
        let all = self.sources.points.chunks_exact(STRIDE as usize);
        (all.zip(self.sources.scales.iter()).zip(seen))
            .map(of_source)
            .sum()
    }
}

/// The constants of this module, as WGSL.
pub fn wgsl_constants() -> String {
    let [whole, partial] = LEVELS;
    format!(
        "const MAX_SOURCES: u32 = {MAX_SOURCES}u;\n\
         const SOURCE_LONGEST_SIDE: f32 = {LONGEST_SIDE:?};\n\
         const SOURCE_OWN: f32 = {OWN:?};\n\
         const SOURCE_STEP: vec2<u32> = vec2({}u, {}u);\n\
         const SOURCE_RIM: u32 = {RIM}u;\n\
         const SOURCE_POINTS: u32 = {POINTS}u;\n\
         const SOURCE_SEEN_TEXELS: u32 = {SEEN_TEXELS}u;\n\
         const SOURCE_SEEN_COLUMNS: u32 = {SEEN_COLUMNS}u;\n\
         const SOURCE_LEVELS: vec2<u32> = vec2({whole}u, {partial}u);\n",
        STEP[0], STEP[1],
    )
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
    fn points_carry_the_light_of_their_source_at_every_level() {
        let environment = environment();
        let sources = Sources::new(&environment).unwrap();
        assert_eq!(sources.count(), 2);
        let all = sources.points().chunks(STRIDE as usize);
        for ((points, scales), light) in all.zip(sources.scales()).zip(light(&environment)) {
            let (rim, points) = points.split_at(1 + RIM as usize);
            assert!(rim.iter().all(|probe| probe.light == [0.0; 3]));
            let cone = Vec3::from(rim[0].direction);
            assert!((points.iter()).all(|p| cone.dot(p.direction.into()) >= rim[0].cone_cosine));
            for (level, scale) in LEVELS.into_iter().zip(scales) {
                let sum: Vec3 = points[..level as usize]
                    .iter()
                    .map(|point| *scale * Vec3::from(point.light))
                    .sum();
                assert!(
                    (sum - light).abs().cmple(1e-5 * light).all(),
                    "{sum} for {light}"
                );
                // So few points hit all colours about as often as they occur.
                let part = level as f32 / POINTS as f32;
                assert!((part * *scale - 1.0).abs().max_element() < 0.3, "{scale}");
            }
            for point in points {
                assert!((Vec3::from(point.direction).length() - 1.0).abs() < 1e-5);
            }
        }
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
        let lit = Lit {
            sources: &sources,
            occluders: &empty,
            ray_offset: 0.0,
            pixel: None,
        };
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
            let lit = Lit {
                sources: &sources,
                occluders: &occluders,
                ray_offset: 0.0,
                pixel: None,
            };
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
