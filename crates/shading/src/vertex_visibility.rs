//! The visible fraction of every distant light at every vertex.
//!
//! A light's visible fraction changes slowly over most of a surface, and neither with the
//! view nor with the diffuse colour. Found once per vertex and light, it serves every pixel of the
//! triangles whose corners agree, until the light turns; where corners disagree a shadow's
//! edge passes between them and pixels integrate for themselves. So do those of triangles that cover few pixels: there
//! are more vertices than that is worth.

use glam::Vec3;
use relight_format::math;

use crate::camera::View;
use crate::contribution::{negligible, share};
use crate::polar::{self, PolarOptions, support_radius};
use crate::spherical_gaussian::SphericalGaussian;
use crate::ssdf::SignedDistance;

/// Corners whose fractions differ by no more than this agree.
pub const AGREEMENT: f32 = 0.05;
/// A light that can add less than this, in what has been gathered before, may differ by more.
pub const SMALL_SHARE: f32 = 0.1;
/// How many times as much, at most.
pub const MOST_LEEWAY: f32 = 3.0;
/// Part of what corners may differ by up to which a point does not look for itself at all; from
/// there on it does more and more, so that neighbours differ by little.
pub const FIRM: f32 = 0.8;
/// Least cosine between the shading normal of a point and the one that its vertices interpolate
/// to: normal maps that turn it further see another part of the sky.
pub const LEAST_COSINE: f32 = 0.95;
/// Fractions as close to 0 or 1 as this mean that nothing or all is seen.
pub const SURE: f32 = 1e-3;
/// Radius about a light, in that at which it ends, within which a lobe has to lie to be seen or
/// hidden with it.
pub const REACH: f32 = 1.0;
/// Pixels that a triangle covers, at least, for its corners to be asked: of smaller ones there are so many vertices that
/// pixels, which share what they find, do with less.
pub const LEAST_PIXELS: f32 = 4.0;
/// Stands for a fraction that was not integrated, as the light adds nothing there.
pub const UNKNOWN: f32 = -1.0;
/// Texels per row of the texture of fractions, four lights each.
pub const TEXTURE_WIDTH: u32 = 4096;
/// Bits of a vertex's state that number frames under one light; the others number the light.
pub const FRAME_BITS: u32 = 8;

/// Most texels of that texture: 256 MB.
const MOST_TEXELS: u64 = 1 << 24;
/// Most vertices that one dispatch of 64 each reaches at WebGPU's default limits.
const MOST_VERTICES: u64 = 64 * 65535;

/// Rows of the texture of fractions. None where there are no lights, or more of them at more vertices
/// than are kept: then pixels integrate for themselves.
pub fn texture_rows(vertices: usize, lights: usize) -> Option<u32> {
    let vertices = vertices as u64;
    let texels = vertices.checked_mul((lights as u64).div_ceil(4))?;
    let kept = texels > 0 && texels <= MOST_TEXELS && vertices <= MOST_VERTICES;
    kept.then(|| texels.div_ceil(u64::from(TEXTURE_WIDTH)) as u32)
}

/// Whether a triangle covers so many pixels that its corners are asked.
pub fn pays(view: &View, [a, b, c]: [Vec3; 3]) -> bool {
    let normal = (b - a).cross(c - a);
    let Some([x, y]) = view.steps(normal, (a + b + c) / 3.0) else {
        return false;
    };
    normal.length_squared() >= (2.0 * LEAST_PIXELS).powi(2) * x.cross(y).length_squared()
}

/// Spokes for each light at vertices, in the order in which pixels gather lights; none for what
/// is negligible beside those before it.
pub fn spokes(lights: &[SphericalGaussian], options: PolarOptions) -> Vec<u32> {
    let mut gathered = Vec3::ZERO;
    let mut spokes_of = |light: &SphericalGaussian| {
        let whole = light.integral();
        if negligible(whole, gathered) {
            return 0;
        }
        let spokes = options.for_share(share(whole, gathered)).spokes;
        gathered += whole;
        spokes
    };
    lights.iter().map(&mut spokes_of).collect()
}

/// The visible fraction of ∫ G(ω) max(n·ω, 0) dω at a vertex of unit normal n = `normal`, whose
/// SSDF is `field`, or [`UNKNOWN`] where there are no spokes.
pub fn light_fraction(
    light: &SphericalGaussian,
    spokes: u32,
    normal: Vec3,
    field: &impl SignedDistance,
) -> f32 {
    if spokes == 0 {
        return UNKNOWN;
    }
    let lobe = (light.sharpness, light.axis);
    polar::lobe_fraction(field, lobe, normal, (PolarOptions { spokes }, true))
}

/// Fractions at the corners of the triangle that a point lies on.
#[derive(Clone, Copy, Debug)]
pub struct Corners<'a> {
    /// [`light_fraction`] of every distant light, at each corner.
    pub fractions: [&'a [f32]; 3],
    /// Weights of the corners.
    pub barycentrics: Vec3,
}

/// The fractions of one light.
#[derive(Clone, Copy, Debug)]
pub struct LightFractions {
    mean: f32,
    low: f32,
    high: f32,
}

impl Corners<'_> {
    /// Those of light `index`.
    pub fn of(&self, index: usize) -> LightFractions {
        let corners = Vec3::from(self.fractions.map(|fractions| fractions[index]));
        LightFractions {
            mean: self.barycentrics.dot(corners),
            low: corners.min_element(),
            high: corners.max_element(),
        }
    }
}

impl LightFractions {
    /// Nothing is known.
    pub const NONE: Self = Self {
        mean: 0.0,
        low: UNKNOWN,
        high: 1.0,
    };

    /// Interpolated to the point.
    pub fn mean(&self) -> f32 {
        self.mean
    }

    /// Part of the light's visibility that a point has to find for itself, if it can add `share`
    /// times what has been gathered before: 0 to 1.
    pub fn doubt(&self, share: f32) -> f32 {
        if self.low < 0.0 {
            return 1.0;
        }
        let limit = AGREEMENT * (SMALL_SHARE / share).clamp(1.0, MOST_LEEWAY);
        let above = (self.high - self.low) / limit - FIRM;
        (above / (1.0 - FIRM)).clamp(0.0, 1.0)
    }

    /// Visible fraction of `lobe`, which is about `light`: 1 or 0 where all that there is of the
    /// light at all corners is seen or hidden and the lobe lies within.
    pub fn whole(&self, light: &SphericalGaussian, lobe: &SphericalGaussian) -> Option<f32> {
        let visible = self.low >= 1.0 - SURE;
        let hidden = self.low >= 0.0 && self.high <= SURE;
        if !visible && !hidden {
            return None;
        }
        let aside = 2.0 * math::asin((0.5 * light.axis.distance(lobe.axis)).min(1.0));
        let reach = REACH * support_radius(light.sharpness);
        let fraction = if visible { 1.0 } else { 0.0 };
        (aside + support_radius(lobe.sharpness) <= reach).then_some(fraction)
    }
}

/// The constants of this module, as WGSL.
pub fn wgsl_constants() -> String {
    let reals = [
        ("AGREEMENT", AGREEMENT),
        ("SMALL_SHARE", SMALL_SHARE),
        ("MOST_LEEWAY", MOST_LEEWAY),
        ("FIRM", FIRM),
        ("LEAST_COSINE", LEAST_COSINE),
        ("SURE", SURE),
        ("REACH", REACH),
        ("LEAST_PIXELS", LEAST_PIXELS),
        ("UNKNOWN", UNKNOWN),
    ];
    reals
        .map(|(name, value)| format!("const VERTEX_VISIBILITY_{name}: f32 = {value:?};\n"))
        .concat()
        + &format!(
            "const VERTEX_VISIBILITY_TEXTURE_WIDTH: u32 = {TEXTURE_WIDTH}u;\n\
             const VERTEX_VISIBILITY_FRAME_BITS: u32 = {FRAME_BITS}u;\n"
        )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tables::Tables;

    /// Visible above a plane through the point, tilted by some angle from the horizon.
    struct HalfSpace(Vec3);

    impl SignedDistance for HalfSpace {
        fn distance(&self, direction: Vec3) -> f32 {
            math::asin(self.0.dot(direction).clamp(-1.0, 1.0))
        }
    }

    fn light(axis: Vec3, sharpness: f32, amplitude: f32) -> SphericalGaussian {
        SphericalGaussian {
            axis: axis.normalize(),
            sharpness,
            amplitude: Vec3::splat(amplitude),
        }
    }

    #[test]
    fn fractions_say_how_much_is_visible() {
        let field = HalfSpace(Vec3::X);
        let fraction =
            |axis, spokes| light_fraction(&light(axis, 30.0, 1.0), spokes, Vec3::Z, &field);
        assert!((fraction(Vec3::Z, 12) - 0.5).abs() < 0.02);
        assert!(fraction(Vec3::new(1.0, 0.0, 1.0), 12) > 0.999);
        assert!(fraction(Vec3::new(-1.0, 0.0, 1.0), 12) < 0.001);
        assert_eq!(fraction(Vec3::Z, 0), UNKNOWN);
    }

    /// Visible within a small circle.
    struct Window(Vec3, f32);

    impl SignedDistance for Window {
        fn distance(&self, direction: Vec3) -> f32 {
            let away = 2.0 * math::asin((0.5 * direction.distance(self.0)).min(1.0));
            (self.1 - away).clamp(-0.5, 0.5)
        }
    }

    /// A room's window is small, and seldom where a light is brightest: as it moves, neither may its light be lost
    /// nor change from one place to the next.
    #[test]
    fn windows_aside_of_wide_lights_are_found() {
        let wide = light(Vec3::new(1.0, 0.0, 1.0), 2.0, 1.0);
        let radius = 0.2f32;
        let (mut sum, mut squares, mut truth) = (0.0, 0.0, 0.0);
        for i in 0..90 {
            // On the other side of the normal, an eighth of a turn about it and back again.
            let (sine, cosine) = math::sin_cos(0.01 * (i as f32 - 45.0));
            let window = Vec3::new(-cosine, sine, 1.0).normalize();
            let field = Window(window, radius);
            let found = light_fraction(&wide, 12, Vec3::Z, &field);
            // Of so small a part of the sphere the light and the cosine are those of its middle.
            let at_middle = math::exp(2.0 * (wide.axis.dot(window) - 1.0)) * window.z;
            let solid_angle = std::f32::consts::TAU * (1.0 - math::cos(radius));
            let unoccluded = Tables::get().cosine_integral(2.0, wide.axis.z);
            let exact = at_middle * solid_angle / unoccluded;
            sum += found;
            squares += (found - exact).powi(2);
            truth += exact;
        }
        let error = (squares / 90.0).sqrt() / (truth / 90.0);
        assert!((sum / truth - 1.0).abs() < 0.05, "{}", sum / truth);
        assert!(error < 0.1, "{error}");
    }

    #[test]
    fn faint_lights_after_bright_ones_take_few_spokes_or_none() {
        let lights = [100.0, 1.0, 1e-4].map(|amplitude| light(Vec3::Z, 30.0, amplitude));
        let spokes = spokes(&lights, PolarOptions::STANDARD);
        assert!(spokes[0] > spokes[1], "{spokes:?}");
        assert!(spokes[1] > 0, "{spokes:?}");
        assert_eq!(spokes[2], 0, "{spokes:?}");
    }

    #[test]
    fn only_triangles_of_some_pixels_ask_their_corners() {
        // Ten pixels per metre at any distance, seen from above.
        let view = View {
            view_projection: glam::Mat4::IDENTITY,
            parallel: true,
            mirrored: false,
            eye: Vec3::Z,
            corner: Vec3::ZERO,
            right: 0.1 * Vec3::X,
            down: -0.1 * Vec3::Y,
            flipped_depth: false,
        };
        let side = (2.0 * LEAST_PIXELS).sqrt() * 0.1;
        let triangle = |side: f32, slope: f32| {
            [
                Vec3::ZERO,
                Vec3::new(side, 0.0, slope * side),
                Vec3::new(0.0, side, 0.0),
            ]
        };
        assert!(pays(&view, triangle(1.01 * side, 0.0)));
        assert!(!pays(&view, triangle(0.99 * side, 0.0)));
        // It is what is seen that counts, from either side.
        assert!(pays(&view, triangle(1.01 * side, 3.0)));
        assert!(!pays(&view, triangle(0.99 * side, -3.0)));
        let [a, b, c] = triangle(1.01 * side, 0.0);
        assert!(pays(&view, [a, c, b]));
        assert!(!pays(&view, [a, b, b]), "no plane");
        assert!(!pays(&view, [a, b, b + Vec3::Z]), "edge-on");
    }

    #[test]
    fn corners_that_agree_leave_no_doubt() {
        let of = |a: f32, b: f32, c: f32| {
            let corners = [[a], [b], [c]];
            Corners {
                fractions: corners.each_ref().map(|corner| &corner[..]),
                barycentrics: Vec3::new(0.5, 0.25, 0.25),
            }
            .of(0)
        };
        assert_eq!(of(0.4, 0.42, 0.41).doubt(1.0), 0.0);
        assert!((of(0.4, 0.42, 0.41).mean() - 0.4075).abs() < 1e-6);
        assert_eq!(of(0.4, 0.5, 0.41).doubt(1.0), 1.0);
        assert_eq!(of(0.4, 0.5, 0.41).doubt(0.01), 0.0);
        assert_eq!(of(0.4, UNKNOWN, 0.41).doubt(0.01), 1.0);
        let sun = light(Vec3::Z, 100.0, 1.0);
        let near = light(Vec3::new(0.05, 0.0, 1.0), 150.0, 1.0);
        let far = light(Vec3::new(0.5, 0.0, 1.0), 150.0, 1.0);
        assert_eq!(of(1.0, 1.0, 1.0).whole(&sun, &near), Some(1.0));
        assert_eq!(of(0.0, 0.0, 0.0).whole(&sun, &near), Some(0.0));
        assert_eq!(of(1.0, 1.0, 1.0).whole(&sun, &far), None);
        assert_eq!(of(1.0, 0.5, 1.0).whole(&sun, &near), None);
        assert_eq!(LightFractions::NONE.whole(&sun, &near), None);
    }
}
