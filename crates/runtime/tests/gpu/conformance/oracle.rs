//! The functions of `functions` as they are defined, in `f64`; integrals by quadrature.

use std::f64::consts::{FRAC_1_PI, PI};

use glam::{DVec2, DVec3, DVec4};

/// The octahedral map: the direction's point on the octahedron, its lower half folded out.
pub fn octahedral_encode(direction: DVec3) -> DVec2 {
    let p = direction / direction.abs().element_sum();
    let q = if p.y < 0.0 {
        fold(DVec2::new(p.x, p.z))
    } else {
        DVec2::new(p.x, p.z)
    };
    (q + 1.0) / 2.0
}

pub fn octahedral_decode(uv: DVec2) -> DVec3 {
    let q = 2.0 * uv - 1.0;
    let y = 1.0 - q.abs().element_sum();
    let p = if y < 0.0 { fold(q) } else { q };
    DVec3::new(p.x, y, p.y).normalize()
}

fn fold(q: DVec2) -> DVec2 {
    DVec2::new(
        (1.0 - q.y.abs()).copysign(q.x),
        (1.0 - q.x.abs()).copysign(q.y),
    )
}

/// The value at the origin of bilinear interpolation in an `n` × `n` octahedral map.
pub fn octahedral_lookup(texel: impl Fn(i32, i32) -> f64, n: u32, direction: DVec3) -> f64 {
    let at = octahedral_encode(direction) * f64::from(n) - 0.5;
    let (low, part) = (at.floor(), at - at.floor());
    let mut sum = 0.0;
    for (right, down) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
        let weight = |part: f64, far: i32| if far == 1 { part } else { 1.0 - part };
        let (x, y) = (low.x as i32 + right, low.y as i32 + down);
        sum += weight(part.x, right) * weight(part.y, down) * texel(x, y);
    }
    sum
}

/// Axis times sharpness and sharpness, and what the amplitudes' product is multiplied by: from
/// exp(λ₁(p₁·ω − 1)) exp(λ₂(p₂·ω − 1)) = exp(|λ₁p₁ + λ₂p₂| − λ₁ − λ₂) exp(λ(p·ω − 1)).
pub fn product((p, a): (DVec3, f64), (q, b): (DVec3, f64)) -> (DVec4, f64) {
    let sum = a * p + b * q;
    (sum.extend(sum.length()), (sum.length() - a - b).exp())
}

/// ∫ exp(λ(p·ω − 1)) dω.
pub fn energy(sharpness: f64) -> f64 {
    -2.0 * PI * (-2.0 * sharpness).exp_m1() / sharpness
}

/// ∫ exp(λ(p·ω − 1)) max(n·ω, 0) dω, and the part of ∫ exp(λ(p·ω − 1)) dω where n·ω > 0, with n·p = `cosine`.
///
/// In t = cos θ about p circles are seen above the horizon from −φ to φ in closed form; over t by the midpoint rule,
/// in a variable in which the exponential is even.
pub fn above_horizon(sharpness: f64, cosine: f64) -> [f64; 2] {
    const STEPS: u32 = 1 << 14;
    let sine = (1.0 - cosine * cosine).max(0.0).sqrt();
    let all = -(-2.0 * sharpness).exp_m1();
    let mut sums = [0.0; 2];
    for step in 0..STEPS {
        let even = all * (f64::from(step) + 0.5) / f64::from(STEPS);
        let t = 1.0 + (-even).ln_1p() / sharpness;
        // n·ω = a + b cos φ.
        let (a, b) = (t * cosine, (1.0 - t * t).max(0.0).sqrt() * sine);
        let half = if a.abs() < b {
            (-a / b).acos()
        } else if a > 0.0 {
            PI
        } else {
            0.0
        };
        sums[0] += 2.0 * (a * half + b * half.sin());
        sums[1] += half * FRAC_1_PI;
    }
    [
        sums[0] * all / sharpness / f64::from(STEPS),
        sums[1] / f64::from(STEPS),
    ]
}

/// Khronos PBR Neutral, after its reference implementation.
pub fn neutral(color: DVec3) -> DVec3 {
    const START: f64 = 0.8 - 0.04;
    let least = color.min_element();
    let color = color
        - if least < 0.08 {
            least - 6.25 * least * least
        } else {
            0.04
        };
    let peak = color.max_element();
    if peak < START {
        return color;
    }
    let d = 1.0 - START;
    let new_peak = 1.0 - d * d / (peak + d - START);
    let g = 1.0 / (0.15 * (peak - new_peak) + 1.0);
    (color * (new_peak / peak)) * g + DVec3::splat(new_peak) * (1.0 - g)
}

/// IEC 61966-2-1.
pub fn encode_srgb(linear: f64) -> f64 {
    if linear <= 0.003_130_8 {
        12.92 * linear
    } else {
        1.055 * linear.powf(1.0 / 2.4) - 0.055
    }
}

/// Values of the reflection models for a colour of 1, in the order of `relight_shading::surface::Model`, of a light from
/// `i` seen from `o`; z along the normal.
pub const MODELS: [fn(DVec2, DVec3, DVec3) -> f64; 5] =
    [blinn_phong, ward, cook_torrance, ggx, ashikhmin_shirley];

/// (n + 8) / 8π (n·h)ⁿ.
fn blinn_phong(exponent: DVec2, i: DVec3, o: DVec3) -> f64 {
    let n = exponent.x;
    (n + 8.0) / (8.0 * PI) * (i + o).normalize().z.powf(n)
}

/// tan² of the half vector's angle, over α² along its azimuth.
fn slope(alpha: DVec2, h: DVec3) -> f64 {
    ((h.truncate() / alpha).length() / h.z).powi(2)
}

/// Ward 1992 with the normalisation of Duer 2005.
fn ward(alpha: DVec2, i: DVec3, o: DVec3) -> f64 {
    let h = (i + o).normalize();
    (-slope(alpha, h)).exp() / (4.0 * PI * alpha.x * alpha.y * i.z * o.z)
}

/// D G₁(i) G₁(o) / (4 n·i n·o), with Smith's masking `g1` of a direction and its α along its azimuth, times cot θ.
fn microfacets(d: f64, g1: impl Fn(f64) -> f64, alpha: DVec2, i: DVec3, o: DVec3) -> f64 {
    let of = |w: DVec3| g1(w.z / (w.truncate() * alpha).length().max(1e-300));
    d * of(i) * of(o) / (4.0 * i.z * o.z)
}

/// Beckmann's distribution; masking by the rational fit of Walter et al. 2007.
fn cook_torrance(alpha: DVec2, i: DVec3, o: DVec3) -> f64 {
    let h = (i + o).normalize();
    let d = (-slope(alpha, h)).exp() / (PI * alpha.x * alpha.y * h.z.powi(4));
    let g1 = |a: f64| {
        if a < 1.6 {
            (3.535 * a + 2.181 * a * a) / (1.0 + 2.276 * a + 2.577 * a * a)
        } else {
            1.0
        }
    };
    microfacets(d, g1, alpha, i, o)
}

/// Trowbridge and Reitz's distribution; Smith's masking.
fn ggx(alpha: DVec2, i: DVec3, o: DVec3) -> f64 {
    let h = (i + o).normalize();
    let d = 1.0 / (PI * alpha.x * alpha.y * h.z.powi(4) * (1.0 + slope(alpha, h)).powi(2));
    let g1 = |a: f64| 2.0 / (1.0 + (1.0 + 1.0 / (a * a)).sqrt());
    microfacets(d, g1, alpha, i, o)
}

/// Ashikhmin and Shirley 2000, eq. 4, with exponents 2/α².
fn ashikhmin_shirley(alpha: DVec2, i: DVec3, o: DVec3) -> f64 {
    let h = (i + o).normalize();
    let n = 2.0 / (alpha * alpha);
    let squares = h.truncate() * h.truncate();
    let exponent = n.dot(squares) / squares.element_sum().max(1e-300);
    let scale = ((n.x + 1.0) * (n.y + 1.0)).sqrt() / (8.0 * PI);
    scale * h.z.powf(exponent) / (h.dot(o) * i.z.max(o.z))
}
