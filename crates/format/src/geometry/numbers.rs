//! Numbers as they are stored: planes of bytes, differences without sign, multiples of a power of two.

use super::{MAX_MULTIPLE, NO_STEP};

/// Bytes of every number by significance: all first bytes, then all second ones.
pub(super) fn planes<const N: usize>(numbers: &[[u8; N]]) -> Vec<u8> {
    (0..N)
        .flat_map(|plane| numbers.iter().map(move |number| number[plane]))
        .collect()
}

/// A number of [`planes`].
pub(super) fn element<const N: usize>(planes: &[u8], index: usize) -> [u8; N] {
    let count = planes.len() / N;
    std::array::from_fn(|plane| planes[plane * count + index])
}

/// Small for small numbers of either sign.
pub(super) fn zigzag(value: i32) -> u32 {
    ((value << 1) ^ (value >> 31)) as u32
}

pub(super) fn from_zigzag(code: u32) -> i32 {
    (code >> 1) as i32 ^ -((code & 1) as i32)
}

/// Exponent of the largest power of two that all numbers are multiples of, if those are not
/// too large.
pub(super) fn step(numbers: &[f32]) -> i8 {
    let lowest_bit = |number: f32| {
        let (bits, implied) = (number.to_bits(), 1 << 23);
        let exponent = (bits >> 23 & 0xff) as i32;
        let digits = bits & (implied - 1) | if exponent > 0 { implied } else { 0 };
        exponent.max(1) - 150 + digits.trailing_zeros() as i32
    };
    let nonzero = numbers.iter().filter(|number| **number != 0.0);
    let exponent = nonzero.map(|number| lowest_bit(*number)).min().unwrap_or(0);
    let exponent = i8::try_from(exponent).unwrap_or(NO_STEP);
    let fits = |number: &f32| {
        let multiple = f64::from(*number) / 2f64.powi(i32::from(exponent));
        // A negative zero would lose its sign.
        multiple.abs() < MAX_MULTIPLE && number.to_bits() != (-0.0f32).to_bits()
    };
    if exponent > NO_STEP && numbers.iter().all(fits) {
        exponent
    } else {
        NO_STEP
    }
}

/// A number in steps, or its bits, ascending with it.
pub(super) fn to_integer(number: f32, step: i8) -> i32 {
    if step == NO_STEP {
        let bits = number.to_bits() as i32;
        return bits ^ ((bits >> 31) as u32 >> 1) as i32;
    }
    (f64::from(number) / 2f64.powi(i32::from(step))) as i32
}

pub(super) fn from_integer(integer: i32, step: i8) -> f32 {
    if step == NO_STEP {
        let bits = integer ^ ((integer >> 31) as u32 >> 1) as i32;
        return f32::from_bits(bits as u32);
    }
    (f64::from(integer) * 2f64.powi(i32::from(step))) as f32
}
