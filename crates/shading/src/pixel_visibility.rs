//! What pixels see of lobes, found at some of a tile's pixels and interpolated at others.
//!
//! A light's *radiance* changes from pixel to pixel, with normals, textures and roughness. Which *part*
//! of a lobe is visible changes slowly, but for where a shadow's edge passes. So of a tile of 8 × 8 pixels a
//! quarter integrates; another pixel takes what lies between those about it, where they show the same
//! surface and agree, and integrates for itself where they do not. Nothing is kept from
//! frame to frame, and a tile knows of no other: it does not matter what is shaded with it.

use glam::Vec3;

/// Pixels per side of a tile.
pub const SIDE: u32 = 8;
/// Pixels of a tile.
pub const PIXELS: usize = (SIDE * SIDE) as usize;
/// Columns, and rows, whose pixels integrate: the outermost are among them, so that all others lie
/// between two.
pub const COARSE: [u32; 4] = [0, 2, 5, 7];

/// Fractions about a pixel that differ by no more than this agree.
pub const AGREEMENT: f32 = 0.2;
/// A lobe that can add less than this, in what has been gathered before, may differ by more.
pub const SMALL_SHARE: f32 = 0.1;
/// How many times as much, at most.
pub const MOST_LEEWAY: f32 = 10.0;
/// How deep a lobe's axis lies in what is visible, in the lobe's radius, may differ by as much from what lies
/// between those of the pixels about it, with the same leeway: thin shadows between them are found by this.
pub const DEPTH_AGREEMENT: f32 = 0.2;
/// Part of what they may differ by up to which a pixel does not look for itself at all; from
/// there on it does more and more, so that neighbours differ by little.
pub const FIRM: f32 = 0.8;
/// Least cosine between the normals of one surface.
pub const LEAST_COSINE: f32 = 0.9;
/// Most distance from the other's plane, as a part of the distance from the other.
pub const MOST_SLOPE: f32 = 0.4;
/// Of a lobe that a pixel does not have.
pub const NONE: f32 = -1.0;

/// Where a pixel's surface is, and what tells it from others.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Place {
    /// Of the scene's own space.
    pub position: Vec3,
    /// Unit shading normal.
    pub normal: Vec3,
    /// Instance and material.
    pub surface: [u32; 2],
}

impl Place {
    /// Whether what `other` sees says something of what this sees.
    fn is_near(&self, other: &Self) -> bool {
        let between = other.position - self.position;
        self.surface == other.surface
            && self.normal.dot(other.normal) >= LEAST_COSINE
            && self.normal.dot(between).abs() <= MOST_SLOPE * between.length()
    }
}

/// What a pixel asks of one lobe.
#[derive(Clone, Copy, Debug)]
pub struct Asked {
    /// What is known of the visible fraction: the fraction is this and `unknown` times what the pixel
    /// finds.
    pub known: f32,
    /// 0 to 1.
    pub unknown: f32,
    /// What the lobe can add, in what has been gathered before.
    pub share: f32,
}

/// The pixels from which each pixel of a tile may take fractions.
#[derive(Clone, Debug)]
pub struct Parents {
    /// Two columns times two rows, and their weights; `None` for those that integrate.
    parents: Vec<Option<[(usize, f32); 4]>>,
}

impl Parents {
    /// Of the pixels of a tile, row by row, those that show nothing being `None`.
    pub fn new(places: &[Option<Place>]) -> Self {
        let parents = |(pixel, place): (usize, &Option<Place>)| {
            let place = place.as_ref()?;
            let (x, y) = (pixel as u32 % SIDE, pixel as u32 / SIDE);
            let (x, y) = (between(x)?, between(y)?);
            let parents = [0, 1, 2, 3].map(|index| {
                let (column, right) = x.of(index & 1);
                let (row, down) = y.of(index >> 1);
                ((row * SIDE + column) as usize, right * down)
            });
            let near = |&(parent, weight): &(usize, f32)| {
                weight == 0.0 || places[parent].is_some_and(|other| place.is_near(&other))
            };
            let own = parents.iter().any(|&(parent, _)| parent == pixel);
            (!own && parents.iter().all(near)).then_some(parents)
        };
        Self {
            parents: places.iter().enumerate().map(parents).collect(),
        }
    }

    /// Of pixels that all integrate.
    pub fn none(pixels: usize) -> Self {
        Self {
            parents: vec![None; pixels],
        }
    }

    /// The visible fractions of `N` lobes at every pixel, those that a pixel does not ask for [`NONE`].
    ///
    /// Of a lobe, given by the pixel and its number, `look` tells how far its axis is from where visibility changes, and
    /// the lobe's radius; `find` integrates it, given that distance.
    pub fn fractions<const N: usize>(
        &self,
        asked: &[[Option<Asked>; N]],
        look: impl Fn(usize, usize) -> [f32; 2],
        mut find: impl FnMut(usize, usize, f32) -> f32,
    ) -> Vec<[f32; N]> {
        // Fractions and depths.
        let mut found = vec![[[NONE; 2]; N]; asked.len()];
        for (pixel, asked) in asked.iter().enumerate() {
            for (lobe, asked) in asked.iter().enumerate() {
                let Some(Asked { known, unknown, .. }) = *asked else {
                    continue;
                };
                if unknown == 0.0 {
                    found[pixel][lobe] = [known, 2.0 * known - 1.0];
                } else if self.parents[pixel].is_none() {
                    let [distance, radius] = look(pixel, lobe);
                    let fraction = known + unknown * find(pixel, lobe, distance);
                    found[pixel][lobe] = [fraction, (distance / radius).clamp(-1.0, 1.0)];
                }
            }
        }
        for (pixel, asked) in asked.iter().enumerate() {
            let Some(parents) = &self.parents[pixel] else {
                continue;
            };
            for (lobe, asked) in asked.iter().enumerate() {
                let Some(asked) = asked.filter(|asked| asked.unknown > 0.0) else {
                    continue;
                };
                let near = parents.map(|(parent, weight)| (found[parent][lobe], weight));
                let look = || look(pixel, lobe);
                let find = |distance| find(pixel, lobe, distance);
                found[pixel][lobe][0] = interpolate(asked, near, look, find);
            }
        }
        found
            .iter()
            .map(|found| found.map(|[fraction, _]| fraction))
            .collect()
    }
}

/// The fraction of a lobe between those about it, fractions and depths with their weights.
fn interpolate(
    asked: Asked,
    near: [([f32; 2], f32); 4],
    look: impl Fn() -> [f32; 2],
    mut find: impl FnMut(f32) -> f32,
) -> f32 {
    let (mut mean, mut mean_depth) = (0.0, 0.0);
    let (mut low, mut high) = (1f32, 0f32);
    for ([fraction, depth], weight) in near {
        if weight > 0.0 {
            mean += weight * fraction;
            mean_depth += weight * depth;
            low = low.min(fraction);
            high = high.max(fraction);
        }
    }
    let leeway = (SMALL_SHARE / asked.share).clamp(1.0, MOST_LEEWAY);
    let mut part = doubt((high - low) / (AGREEMENT * leeway));
    if low < 0.0 {
        (mean, part) = (0.0, 1.0);
    }
    let mut seen = None;
    if part < 1.0 {
        let [distance, radius] = look();
        let aside = ((distance / radius).clamp(-1.0, 1.0) - mean_depth).abs();
        part = part.max(doubt(aside / (DEPTH_AGREEMENT * leeway)));
        seen = Some(distance);
    }
    let known = mean * (1.0 - part) + asked.known * part;
    if part == 0.0 {
        return known;
    }
    let distance = seen.unwrap_or_else(|| look()[0]);
    known + asked.unknown * part * find(distance)
}

/// The part of a fraction that a pixel has to find for itself where others differ by a part of what they may.
fn doubt(part: f32) -> f32 {
    ((part - FIRM) / (1.0 - FIRM)).clamp(0.0, 1.0)
}

/// Two coarse columns or rows about another, and the weight of the second.
#[derive(Clone, Copy)]
struct Between {
    low: u32,
    high: u32,
    weight: f32,
}

impl Between {
    fn of(self, index: usize) -> (u32, f32) {
        [(self.low, 1.0 - self.weight), (self.high, self.weight)][index]
    }
}

fn between(at: u32) -> Option<Between> {
    let high = COARSE.iter().copied().find(|&coarse| coarse >= at)?;
    let low = COARSE.iter().copied().rfind(|&coarse| coarse <= at)?;
    let weight = if high > low {
        (at - low) as f32 / (high - low) as f32
    } else {
        0.0
    };
    Some(Between { low, high, weight })
}

/// The constants of this module, as WGSL.
pub fn wgsl_constants() -> String {
    let reals = [
        ("AGREEMENT", AGREEMENT),
        ("DEPTH_AGREEMENT", DEPTH_AGREEMENT),
        ("SMALL_SHARE", SMALL_SHARE),
        ("MOST_LEEWAY", MOST_LEEWAY),
        ("FIRM", FIRM),
        ("LEAST_COSINE", LEAST_COSINE),
        ("MOST_SLOPE", MOST_SLOPE),
        ("NONE", NONE),
    ];
    reals
        .map(|(name, value)| format!("const PIXEL_{name}: f32 = {value:?};\n"))
        .concat()
        + &format!(
            "const PIXEL_SIDE: u32 = {SIDE}u;\n\
             const PIXEL_COUNT: u32 = {PIXELS}u;\n\
             const PIXEL_LOBES: u32 = {}u;\n",
            PIXELS as u32 * crate::slots::WAITING,
        )
}
