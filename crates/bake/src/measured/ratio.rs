//! What fitted lobes are multiplied by to be their table.
//!
//! The lobes have the peak, the ratio all that a handful of them misses: it changes slowly, so that
//! a small texture holds it. Its values are quotients of two averages, so that a peak that falls
//! between two of them loses no energy.

use glam::Vec3;
use rayon::prelude::*;
use relight_format::math;
use relight_format::{RATIO_NODES, RATIO_SIZE, Texture, TextureEncoding};
use relight_shading::models;
use relight_shading::surface::Appearance;
use relight_shading::textures::decode_rgbe;

use super::Table;

/// Offsets from a node within the cells about it, as fractions of a cell, and the weights of linear
/// interpolation there.
const OFFSETS: [(f32, f32); 5] = [(-0.6, 0.4), (-0.3, 0.7), (0.0, 1.0), (0.3, 0.7), (0.6, 0.4)];
/// Largest ratio, of lobes that are next to nothing.
const MOST: f32 = 1e4;
/// Average of lobes below which a ratio is of roundings.
const LEAST: f32 = 1e-9;

/// The ratio as a texture, for a base of `appearance`'s albedo and its reflections.
pub(crate) fn texture(table: &Table, appearance: &Appearance) -> Texture {
    let [width, rows, planes] = RATIO_NODES;
    let base = appearance.diffuse * std::f32::consts::FRAC_1_PI;
    let mut ratios: Vec<Option<Vec3>> = (0..width * rows * planes)
        .into_par_iter()
        .map(|index| {
            let node = [index % width, index / width % rows, index / (width * rows)];
            ratio(table, appearance, base, node)
        })
        .collect();
    fill(&mut ratios);
    Texture {
        width: RATIO_SIZE[0],
        height: RATIO_SIZE[1],
        encoding: TextureEncoding::Rgbe,
        texels: (ratios.iter())
            .flat_map(|ratio| encode_rgbe(ratio.unwrap_or(Vec3::ONE)))
            .collect(),
    }
}

/// The ratio about a node; `None` where no pair of directions is above the surface.
fn ratio(table: &Table, appearance: &Appearance, base: Vec3, node: [u32; 3]) -> Option<Vec3> {
    let (mut exact, mut lobes) = (Vec3::ZERO, Vec3::ZERO);
    let mut any = false;
    for (dx, x) in OFFSETS {
        for (dy, y) in OFFSETS {
            for (dz, z) in OFFSETS {
                let at = |axis: usize, offset: f32| {
                    (node[axis] as f32 + offset) / (RATIO_NODES[axis] - 1) as f32
                };
                let coordinates = Vec3::new(at(0, dx), at(1, dy), at(2, dz));
                let Some([wi, wo]) = directions(coordinates) else {
                    continue;
                };
                any = true;
                // As the picture weighs them.
                let weight = x * y * z * wi.z * wo.z;
                // Light and eye may be exchanged.
                let values = table.evaluate(wi, wo) + table.evaluate(wo, wi);
                exact += weight * (0.5 * values - base).max(Vec3::ZERO);
                let all = appearance.reflections();
                lobes += weight
                    * all
                        .map(|reflection| models::evaluate_specular(reflection, wi, wo))
                        .sum::<Vec3>();
            }
        }
    }
    let quotient = |channel: usize| {
        if lobes[channel] > LEAST {
            (exact[channel] / lobes[channel]).min(MOST)
        } else {
            0.0
        }
    };
    any.then(|| Vec3::new(quotient(0), quotient(1), quotient(2)))
}

/// Unit vectors to light and eye at coordinates as of
/// [`relight_shading::surface::ratio_coordinates`]; `None` if they are not all within 0 and 1, or
/// one is below the surface.
fn directions(coordinates: Vec3) -> Option<[Vec3; 2]> {
    if coordinates.min_element() < 0.0 || coordinates.max_element() > 1.0 {
        return None;
    }
    let (half_sine, cosine) = (coordinates.x * coordinates.x, coordinates.y);
    let half_cosine = (1.0 - half_sine * half_sine).sqrt();
    let half = Vec3::new(half_sine, 0.0, half_cosine);
    let toward_normal = Vec3::new(-half_cosine, 0.0, half_sine);
    let (along, aside) = (coordinates.z.sqrt(), (1.0 - coordinates.z).sqrt());
    let sine = (1.0 - cosine * cosine).sqrt();
    let wi = cosine * half + sine * (along * toward_normal + aside * Vec3::Y);
    let wo = 2.0 * cosine * half - wi;
    (wi.z > 0.0 && wo.z > 0.0).then_some([wi, wo])
}

/// Nodes without a value take that of the next one towards smaller half vector angles, or else of
/// the next plane or row.
fn fill(ratios: &mut [Option<Vec3>]) {
    let [width, rows, planes] = RATIO_NODES.map(|nodes| nodes as usize);
    for row in ratios.chunks_exact_mut(width) {
        for x in 1..width {
            row[x] = row[x].or(row[x - 1]);
        }
    }
    for z in (0..planes).rev() {
        for y in (0..rows).rev() {
            for x in 0..width {
                let index = (z * rows + y) * width + x;
                let above = (y + 1 < rows).then(|| ratios[index + width]).flatten();
                let behind = (z + 1 < planes)
                    .then(|| ratios[index + rows * width])
                    .flatten();
                ratios[index] = ratios[index].or(above).or(behind);
            }
        }
    }
}

/// Ward 1991; rounded to the nearest. The inverse of [`decode_rgbe`].
fn encode_rgbe(color: Vec3) -> [u8; 4] {
    let largest = color.max_element();
    if largest < 1e-30 {
        return [0; 4];
    }
    // The least exponent with which all bytes fit.
    let mut exponent = math::log2(largest / 255.5).floor() as i32 + 136;
    let bytes = |exponent: i32| {
        let scale = decode_rgbe([1, 1, 1, exponent as u8]).x;
        (color / scale).round()
    };
    while bytes(exponent).max_element() > 255.0 {
        exponent += 1;
    }
    let bytes = bytes(exponent);
    [bytes.x as u8, bytes.y as u8, bytes.z as u8, exponent as u8]
}

#[cfg(test)]
mod tests {
    use super::*;
    use relight_shading::surface::ratio_coordinates;

    #[test]
    fn directions_are_where_they_are_looked_up() {
        let mut found = 0;
        for index in 0..1000u32 {
            let [u, v, w] = [0.618, 0.414_2, 0.732_1].map(|s| (index as f32 * s).fract());
            let coordinates = Vec3::new(u, v, w);
            if let Some([wi, wo]) = directions(coordinates) {
                found += 1;
                for (wi, wo) in [(wi, wo), (wo, wi)] {
                    let mut error = (ratio_coordinates(wi, wo) - coordinates).abs();
                    // The azimuth about the half vector is that of two short vectors.
                    error.z *= u * u * (1.0 - v * v).sqrt();
                    // The square root of a rounding, near the pole.
                    assert!(error.max_element() < 1e-3, "{coordinates} {error}");
                }
            }
        }
        assert!(found > 300, "{found}");
    }

    #[test]
    fn numbers_of_any_size_survive_within_half_a_step() {
        for color in [
            Vec3::new(1.0, 0.5, 0.25),
            Vec3::new(255.4, 3.0, 0.1),
            Vec3::new(1e-4, 9.9e-5, 0.0),
            Vec3::splat(0.999),
        ] {
            let error = (decode_rgbe(encode_rgbe(color)) - color)
                .abs()
                .max_element();
            assert!(error <= color.max_element() / 254.0, "{color} {error}");
        }
        assert_eq!(decode_rgbe(encode_rgbe(Vec3::ZERO)), Vec3::ZERO);
    }
}
