//! Elementary functions that give the same bits on every processor.
//!
//! Those of the standard library are the C library's, which differ in the last bit with the
//! processor's instructions. A fit that takes thousands of steps makes another file of that.
//! These are compiled from one source (the crate `libm`), and Clippy refuses the others in
//! the crates whose results reach a file (their `clippy.toml`).

mod sealed {
    /// One method by function of the parent module.
    pub trait Real: Copy {
        fn sin(self) -> Self;
        fn cos(self) -> Self;
        fn tan(self) -> Self;
        fn asin(self) -> Self;
        fn acos(self) -> Self;
        fn atan(self) -> Self;
        fn atan2(self, x: Self) -> Self;
        fn tanh(self) -> Self;
        fn exp(self) -> Self;
        fn exp2(self) -> Self;
        fn exp_m1(self) -> Self;
        fn ln(self) -> Self;
        fn ln_1p(self) -> Self;
        fn log2(self) -> Self;
        fn log10(self) -> Self;
        fn powf(self, exponent: Self) -> Self;
        fn hypot(self, other: Self) -> Self;
        fn sin_cos(self) -> (Self, Self);
    }
}

/// `f32` or `f64`.
pub trait Real: sealed::Real {}
impl<T: sealed::Real> Real for T {}

macro_rules! real {
    ($type:ty: $($name:ident = $function:path,)*; $($name2:ident = $function2:path,)*; $sincos:path) => {
        impl sealed::Real for $type {
            $(#[inline]
            fn $name(self) -> Self {
                $function(self)
            })*
            $(#[inline]
            fn $name2(self, other: Self) -> Self {
                $function2(self, other)
            })*
            #[inline]
            fn sin_cos(self) -> (Self, Self) {
                $sincos(self)
            }
        }
    };
}

real!(f32: sin = libm::sinf, cos = libm::cosf, tan = libm::tanf, asin = libm::asinf, acos = libm::acosf, atan = libm::atanf,
    tanh = libm::tanhf, exp = exponential, exp2 = libm::exp2f, exp_m1 = libm::expm1f, ln = libm::logf, ln_1p = libm::log1pf,
    log2 = libm::log2f, log10 = libm::log10f,; atan2 = libm::atan2f, powf = power, hypot = libm::hypotf,; libm::sincosf);
real!(f64: sin = libm::sin, cos = libm::cos, tan = libm::tan, asin = libm::asin, acos = libm::acos, atan = libm::atan,
    tanh = libm::tanh, exp = libm::exp, exp2 = libm::exp2, exp_m1 = libm::expm1, ln = libm::log, ln_1p = libm::log1p,
    log2 = libm::log2, log10 = libm::log10,; atan2 = libm::atan2, powf = libm::pow, hypot = libm::hypot,; libm::sincos);

/// `libm::powf` in a third of its time, which was most of that of highlights with exponents: of 53 bits, the logarithm
/// needs no second part.
fn power(base: f32, exponent: f32) -> f32 {
    if base > 0.0 && base.is_finite() && exponent.is_finite() {
        libm::exp2(f64::from(exponent) * libm::log2(f64::from(base))) as f32
    } else {
        libm::powf(base, exponent)
    }
}

/// `libm::expf` without its branches and its division: of 53 bits, neither the argument's remainder nor the series needs a
/// second part. Alone it takes four fifths of the time; a frame, whose highlights are made of these, 4 to 8 % less. Within
/// .6 of an ulp.
#[inline]
fn exponential(x: f32) -> f32 {
    // Added to a number, this rounds it to an integer and leaves that in the last bits.
    const ROUND: f64 = 6_755_399_441_055_744.0;
    // Beyond, it is 0 or infinite.
    let octaves = f64::from(x.clamp(-150.0, 100.0)) * std::f64::consts::LOG2_E;
    let rounded = octaves + ROUND;
    let r = (octaves - (rounded - ROUND)) * std::f64::consts::LN_2;
    let square = r * r;
    let low = (1.0 + r) + square * (1.0 / 2.0 + r * (1.0 / 6.0));
    let high = (1.0 / 24.0 + r * (1.0 / 120.0)) + square * (1.0 / 720.0 + r * (1.0 / 5040.0));
    let mantissa = low + square * square * high;
    f64::from_bits(mantissa.to_bits().wrapping_add(rounded.to_bits() << 52)) as f32
}

macro_rules! functions {
    ($($(#[$doc:meta])* $name:ident($first:ident $(, $second:ident)?);)*) => {
        $($(#[$doc])*
        #[inline]
        pub fn $name<T: Real>($first: T $(, $second: T)?) -> T {
            $first.$name($($second)?)
        })*
    };
}

functions! {
    /// Sine of an angle in radians.
    sin(angle);
    /// Cosine of an angle in radians.
    cos(angle);
    /// Tangent of an angle in radians.
    tan(angle);
    /// Arc sine in [-π/2, π/2]; not a number outside [-1, 1].
    asin(sine);
    /// Arc cosine in [0, π]; not a number outside [-1, 1].
    acos(cosine);
    /// Arc tangent in [-π/2, π/2].
    atan(tangent);
    /// Angle of the point (x, y) in [-π, π].
    atan2(y, x);
    /// Hyperbolic tangent.
    tanh(x);
    /// e to the power of `x`.
    exp(x);
    /// 2 to the power of `x`.
    exp2(x);
    /// `exp(x) - 1`, exact near zero too.
    exp_m1(x);
    /// Natural logarithm.
    ln(x);
    /// `ln(1 + x)`, exact near zero too.
    ln_1p(x);
    /// Logarithm to base 2.
    log2(x);
    /// Logarithm to base 10.
    log10(x);
    /// `base` to the power of `exponent`.
    powf(base, exponent);
    /// Length of the vector (x, y).
    hypot(x, y);
}

/// Sine and cosine of an angle in radians.
#[inline]
pub fn sin_cos<T: Real>(angle: T) -> (T, T) {
    angle.sin_cos()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Every function once.
    fn all<T: Real>(x: T, unit: T, [minus, falling, power]: [T; 3]) -> [T; 18] {
        [
            sin(x),
            cos(x),
            tan(x),
            asin(unit),
            acos(unit),
            atan(x),
            atan2(unit, x),
            exp(falling),
            exp2(unit),
            exp_m1(minus),
            ln(x),
            ln_1p(x),
            log2(x),
            log10(x),
            powf(unit, power),
            hypot(x, unit),
            sin_cos(x).0,
            sin_cos(x).1,
        ]
    }

    #[test]
    fn bits_are_those_of_every_processor() {
        // A checksum over arguments of all sizes, taken with QEMU's Nehalem, Haswell and `max`.
        let mut sum = 0u64;
        let mut add =
            |bits: u64| sum = sum.rotate_left(5).wrapping_mul(0x9e37_79b9_7f4a_7c15) ^ bits;
        for index in 1..2000 {
            let x = 1e-6 * 1.011f64.powi(index);
            let unit = f64::from(index) / 2000.0;
            for value in all(x, unit, [-x, -x.min(700.0), x.min(50.0)]) {
                add(value.to_bits());
            }
            let (x, unit) = (x as f32, unit as f32);
            for value in all(x, unit, [-x, -x.min(80.0), x.min(50.0)]) {
                add(u64::from(value.to_bits()));
            }
        }
        assert_eq!(sum, 0xbb30_dfe3_88ec_dc6b, "{sum:#x}");
    }

    #[test]
    fn exponentials_end_where_numbers_do() {
        assert_eq!(exp(f32::NEG_INFINITY), 0.0);
        assert_eq!(exp(-104f32), 0.0);
        assert_eq!(exp(0f32), 1.0);
        assert_eq!(exp(89f32), f32::INFINITY);
        assert_eq!(exp(f32::INFINITY), f32::INFINITY);
        assert!(exp(f32::NAN).is_nan());
    }

    #[test]
    #[allow(clippy::disallowed_methods)]
    fn values_are_those_of_the_standard_library() {
        for index in 1..2000 {
            let x = 1e-6 * 1.011f64.powi(index);
            let unit = f64::from(index) / 2000.0;
            for (ours, theirs) in [
                (sin(x), x.sin()),
                (cos(x), x.cos()),
                (asin(unit), unit.asin()),
                (acos(unit), unit.acos()),
                (atan(x), x.atan()),
                (atan2(unit, x), unit.atan2(x)),
                (exp(-x), (-x).exp()),
                (exp2(unit), unit.exp2()),
                (exp_m1(-x), (-x).exp_m1()),
                (ln(x), x.ln()),
                (ln_1p(x), x.ln_1p()),
                (log2(x), x.log2()),
                (log10(x), x.log10()),
                (powf(unit, x), unit.powf(x)),
                (hypot(x, unit), x.hypot(unit)),
            ] {
                assert!(
                    (ours - theirs).abs() <= 4.0 * f64::EPSILON * theirs.abs(),
                    "{ours} {theirs}"
                );
            }
            for x in [
                x as f32,
                -x as f32,
                -100.0 * unit as f32,
                100.0 * unit as f32,
            ] {
                let (ours, theirs) = (exp(x), x.exp());
                let last = f32::from_bits(1).max(f32::EPSILON * theirs);
                assert!(
                    ours == theirs || (ours - theirs).abs() <= last,
                    "{x}: {ours} {theirs}"
                );
            }
            // Of large and small powers, and where there is no logarithm.
            for base in [unit as f32, x as f32, 0.0, -2.0, f32::INFINITY] {
                for exponent in [0.0, 0.3, -40.0, x as f32] {
                    let [ours, theirs] = [powf(base, exponent), base.powf(exponent)];
                    assert!(
                        ours == theirs
                            || ours.is_nan() && theirs.is_nan()
                            || (ours - theirs).abs() <= f32::EPSILON * theirs.abs(),
                        "{base} {exponent}: {ours} {theirs}"
                    );
                }
            }
        }
    }
}
