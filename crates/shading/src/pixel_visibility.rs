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
/// Pixels of a tile that do.
pub const COARSE_PIXELS: u32 = (COARSE.len() * COARSE.len()) as u32;

/// Fractions about a pixel that differ by no more than this agree.
pub const AGREEMENT: f32 = 0.3;
/// A lobe that can add less than this, in what has been gathered before, may differ by more.
pub const SMALL_SHARE: f32 = 0.1;
/// How many times as much, at most.
pub const MOST_LEEWAY: f32 = 30.0;
/// How deep a lobe's axis lies in what is visible, in the lobe's radius, may differ by as much from what lies
/// between those of the pixels about it, with the same leeway: thin shadows between them are found by this.
pub const DEPTH_AGREEMENT: f32 = 0.3;
/// Part of what they may differ by up to which a pixel does not look for itself at all; from
/// there on it does more and more, so that neighbours differ by little.
pub const FIRM: f32 = 0.8;
/// Least cosine between the normals of one surface.
pub const LEAST_COSINE: f32 = 0.9;
/// Most distance from the other's plane, as a part of the distance from the other.
pub const MOST_SLOPE: f32 = 0.4;
/// Bits of what is unknown of a fraction, one of which is for 1, and last bits of a share that are left out: workgroups'
/// memory is what GPUs have least of.
const UNKNOWN_BITS: u32 = 18;
const SHARE_BITS: u32 = 17;
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

impl Asked {
    /// With as many bits as are kept.
    pub(crate) fn rounded(self) -> Self {
        let share = (self.share.to_bits() + (1 << (SHARE_BITS - 1))) >> SHARE_BITS;
        Self {
            unknown: kept(self.unknown),
            share: f32::from_bits(share << SHARE_BITS),
            ..self
        }
    }
}

/// What stands for 1.
const UNKNOWN_ONE: f32 = (1u32 << (UNKNOWN_BITS - 1)) as f32;

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

    /// Those of a pixel, and their weights; `None`: it takes nothing from others.
    pub fn of(&self, pixel: usize) -> Option<[(usize, f32); 4]> {
        self.parents[pixel]
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
                let Some(asked) = *asked else {
                    continue;
                };
                let Asked { known, unknown, .. } = asked.rounded();
                if asked.unknown == 0.0 {
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
    let asked = asked.rounded();
    let leeway = (SMALL_SHARE / asked.share).clamp(1.0, MOST_LEEWAY);
    let mut part = doubt((high - low) / (AGREEMENT * leeway));
    if low < 0.0 {
        (mean, part) = (0.0, 1.0);
    }
    if part == 0.0 && is_sure(mean_depth, leeway) {
        return mean;
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
    let left = Asked {
        unknown: asked.unknown * part,
        ..asked
    };
    known + left.rounded().unknown * find(distance)
}

/// Whether no depth that a pixel may find, -1 to 1, is far enough from what lies between others' for doubt.
fn is_sure(mean_depth: f32, leeway: f32) -> bool {
    1.0 + mean_depth.abs() <= FIRM * DEPTH_AGREEMENT * leeway
}

/// The part of a fraction that a pixel has to find for itself where others differ by a part of what they may. With the
/// bits that are kept of what is unknown, so that both parts make a whole.
fn doubt(part: f32) -> f32 {
    kept(((part - FIRM) / (1.0 - FIRM)).clamp(0.0, 1.0))
}

/// What is kept of a part.
fn kept(part: f32) -> f32 {
    (part * UNKNOWN_ONE + 0.5).floor() / UNKNOWN_ONE
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
             const PARENTS_COUNT: u32 = {COARSE_PIXELS}u;\n\
             const PIXEL_LOBES: u32 = {}u;\n\
             const PIXEL_UNKNOWN_BITS: u32 = {UNKNOWN_BITS}u;\n\
             const PIXEL_UNKNOWN_ONE: f32 = {UNKNOWN_ONE:?};\n\
             const PIXEL_SHARE_BITS: u32 = {SHARE_BITS}u;\n",
            PIXELS as u32 * crate::slots::WAITING,
        )
}

#[cfg(test)]
mod tests {
    use std::cell::RefCell;

    use super::*;

    /// A plane, seen obliquely.
    fn plane() -> Vec<Option<Place>> {
        (0..SIDE * SIDE)
            .map(|pixel| {
                let (x, y) = ((pixel % SIDE) as f32, (pixel / SIDE) as f32);
                Some(Place {
                    position: Vec3::new(0.1 * x, 0.0, 0.3 * y),
                    normal: Vec3::Y,
                    surface: [1, 2],
                })
            })
            .collect()
    }

    /// What pixels find of one lobe whose visible fraction and depth these are, and which of them integrate.
    fn found(
        places: &[Option<Place>],
        share: f32,
        fraction: impl Fn(usize) -> f32,
        depth: impl Fn(usize) -> f32,
    ) -> (Vec<f32>, Vec<usize>) {
        let asked = Some(Asked {
            known: 0.0,
            unknown: 1.0,
            share,
        });
        let integrated = RefCell::new(Vec::new());
        let find = |pixel, _, distance: f32| {
            assert_eq!(distance, depth(pixel), "{pixel}");
            integrated.borrow_mut().push(pixel);
            fraction(pixel)
        };
        let asked = vec![[asked]; places.len()];
        let look = |pixel, _| [depth(pixel), 1.0];
        let found = Parents::new(places).fractions(&asked, look, find);
        let found = found.iter().map(|[fraction]| *fraction).collect();
        (found, integrated.into_inner())
    }

    fn is_coarse(pixel: usize) -> bool {
        [pixel % 8, pixel / 8].map(|at| COARSE.contains(&(at as u32))) == [true, true]
    }

    #[test]
    fn what_changes_evenly_is_found_at_a_quarter_of_the_pixels() {
        let slope = |pixel: usize| 0.3 + 0.03 * (pixel % 8) as f32 + 0.02 * (pixel / 8) as f32;
        let (fractions, integrated) = found(&plane(), 1.0, slope, slope);
        assert_eq!(integrated.len(), PIXELS / 4);
        assert!(integrated.iter().all(|&pixel| is_coarse(pixel)));
        for (pixel, fraction) in fractions.iter().enumerate() {
            assert!((fraction - slope(pixel)).abs() < 1e-6, "{pixel}");
        }
    }

    #[test]
    fn shadows_edges_are_integrated() {
        // Visible up to the sixth column.
        let edge = |pixel: usize| if pixel % 8 < 6 { 1.0 } else { 0.0 };
        let depth = |pixel: usize| (0.5 * (5.5 - (pixel % 8) as f32)).clamp(-1.0, 1.0);
        let (fractions, _) = found(&plane(), 1.0, edge, depth);
        assert!((0..PIXELS).all(|pixel| (fractions[pixel] - edge(pixel)).abs() < 1e-6));
    }

    #[test]
    fn thin_shadows_between_others_are_found() {
        // The fourth column is hidden, and those beside it see all.
        let thin = |pixel: usize| if pixel % 8 == 3 { 0.0 } else { 1.0 };
        let depth = |pixel: usize| if pixel % 8 == 3 { -0.2 } else { 1.0 };
        let (fractions, integrated) = found(&plane(), 1.0, thin, depth);
        assert!((0..PIXELS).all(|pixel| (fractions[pixel] - thin(pixel)).abs() < 1e-6));
        assert_eq!(integrated.len(), PIXELS / 4 + 8);
    }

    #[test]
    fn lobes_that_add_little_may_differ_by_more() {
        // By more than what agrees in one row.
        let rough = |pixel: usize| if pixel / 8 < 4 { 0.2 } else { 0.9 };
        let integrated = |share| found(&plane(), share, rough, |_| 0.0).1.len();
        assert!(integrated(1.0) > PIXELS / 4);
        assert_eq!(integrated(0.001), PIXELS / 4);
    }

    #[test]
    fn other_surfaces_say_nothing() {
        let changes: [fn(&mut Place); 4] = [
            |place| place.surface[0] = 0,
            |place| place.surface[1] = 0,
            |place| place.normal = Vec3::new(0.8, 0.6, 0.0),
            |place| place.position.y += 1.0,
        ];
        for change in changes {
            let mut places = plane();
            // One of those that others ask, and all of its neighbours but one row.
            change(places[2 + 8 * 2].as_mut().unwrap());
            let (fractions, integrated) = found(&places, 1.0, |_| 0.5, |_| 0.5);
            assert!(
                fractions
                    .iter()
                    .all(|fraction| (fraction - 0.5).abs() < 1e-6)
            );
            let alone: Vec<usize> = (integrated.into_iter())
                .filter(|&pixel| !is_coarse(pixel))
                .collect();
            let (rows, columns) = (1..5, 1..5);
            let about = rows.flat_map(|y| columns.clone().map(move |x| 8 * y + x));
            let about: Vec<usize> = about.filter(|&pixel| !is_coarse(pixel)).collect();
            assert_eq!(alone, about);
        }
        let mut places = plane();
        places[0] = None;
        let (_, integrated) = found(&places, 1.0, |_| 0.5, |_| 0.5);
        // The pixel that is not there asks as well here.
        assert_eq!(integrated.len(), PIXELS / 4 + 3);
    }

    #[test]
    fn what_a_pixel_alone_is_asked_it_finds() {
        let mut asked = vec![[None; 2]; PIXELS];
        asked[9] = [
            None,
            Some(Asked {
                known: 0.1,
                unknown: 0.5,
                share: 1.0,
            }),
        ];
        let look = |_, _| [0.0, 1.0];
        let found = Parents::new(&plane()).fractions(&asked, look, |pixel, lobe, _| {
            assert_eq!((pixel, lobe), (9, 1));
            0.6
        });
        assert!((found[9][1] - 0.4).abs() < 1e-6 && found[9][0] == NONE);
        assert_eq!(found[8], [NONE; 2]);
    }
}
