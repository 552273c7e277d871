//! Compact bright parts of an image: what lobes show with soft shadows only.
//!
//! Visibility boundaries are off by some hundredths of a radian, which a sun, a lamp or a window
//! shows in every shadow. At thresholds from the brightest pixel down to the image's mean the
//! connected regions above form a tree; from it those regions are taken that gain most by exact
//! shadows. A region with a margin gives what it has above its surroundings, so that what is left of
//! the image is level there; then the next one is looked for.

use relight_format::math;
use std::collections::{BTreeSet, HashMap};
use std::f64::consts::{PI, TAU};

use glam::DVec3;
use relight_format::Source;

use super::hdr::LatLong;

/// How far visibility boundaries are off, about, radians: light as compact as this would have
/// shadows whose edges are wholly wrong.
const BOUNDARY_ERROR: f64 = 0.02;

/// Least gain of a source, in the whole light: what it costs in every pixel.
const LEAST_GAIN: f64 = 0.003;

/// Least mean cosine to the middle of a region, weighted by light: that of a cap of 0.47 rad.
const LEAST_COSINE: f64 = 0.945;

/// Width of the margin around a region, in roots of its area.
const MARGIN: f64 = 0.25;

/// Thresholds per factor of 2.
const THRESHOLDS_PER_OCTAVE: f64 = 2.0;

/// Most thresholds: 20 octaves.
const MAX_THRESHOLDS: f64 = 40.0;

/// Texels that a source is stored in, about. Regions of more pixels are averaged.
const TEXELS: f64 = 1024.0;

/// An image in two parts.
#[derive(Clone, Debug, PartialEq)]
pub struct Split {
    /// The sources, the one that gains most first.
    pub sources: Vec<Source>,
    /// Their texels, as in [`relight_format::Environment::source_texels`].
    pub texels: Vec<[f32; 3]>,
    /// Of every source, its part of the image's light, over all channels.
    pub light: Vec<f32>,
    /// The image without them.
    pub rest: LatLong,
}

/// Takes the sources out of an image, at most `most`; there may be none.
pub(crate) fn split(image: &LatLong, most: usize) -> Split {
    let mut split = Split {
        sources: Vec::new(),
        texels: Vec::new(),
        light: Vec::new(),
        rest: image.clone(),
    };
    let whole: f64 = image.total_power().iter().sum();
    let mut before = whole;
    while split.sources.len() < most {
        let grid = Grid::new(&split.rest);
        let Some(region) = grid.best_region(luminous_power(image)) else {
            break;
        };
        let (pixels, level) = grid.surrounded(&region);
        let (source, texels, rest) = grid.source(&pixels, level);
        let left: f64 = rest.total_power().iter().sum();
        split.rest = rest;
        split.sources.push(source);
        split.texels.extend(texels);
        split.light.push(((before - left) / whole) as f32);
        before = left;
    }
    split
}

fn luminance(pixel: &[f32; 3]) -> f32 {
    0.2126 * pixel[0] + 0.7152 * pixel[1] + 0.0722 * pixel[2]
}

/// ∫ of luminance over the sphere.
fn luminous_power(image: &LatLong) -> f64 {
    let [r, g, b] = image.total_power();
    0.2126 * r + 0.7152 * g + 0.0722 * b
}

/// A connected region above a threshold.
#[derive(Clone, Copy, Debug)]
struct Region {
    /// One of its pixels.
    seed: usize,
    threshold: f32,
    gain: f64,
}

/// Sums over the pixels of a region.
#[derive(Clone, Copy, Default)]
struct Sums {
    light: f64,
    solid_angle: f64,
    /// Of directions by light.
    direction: DVec3,
}

struct Grid<'a> {
    image: &'a LatLong,
    luminance: Vec<f32>,
}

impl<'a> Grid<'a> {
    fn new(image: &'a LatLong) -> Self {
        Self {
            luminance: image.pixels.iter().map(luminance).collect(),
            image,
        }
    }

    fn width(&self) -> usize {
        self.image.width as usize
    }

    /// Pixels beside, above and below; columns wrap.
    fn neighbours(&self, pixel: usize) -> impl Iterator<Item = usize> + use<> {
        let width = self.width();
        let height = self.image.height as usize;
        let (row, column) = (pixel / width, pixel % width);
        (row.saturating_sub(1)..(row + 2).min(height)).flat_map(move |row| {
            [width - 1, 0, 1].map(move |step| row * width + (column + step) % width)
        })
    }

    /// The region that gains most by exact shadows, in an image that had the light `whole`, if any
    /// gains enough.
    fn best_region(&self, whole: f64) -> Option<Region> {
        let width = self.width();
        let brightest = self.luminance.iter().copied().fold(0.0, f32::max);
        let light = |pixel: usize| {
            f64::from(self.luminance[pixel]) * self.image.solid_angle((pixel / width) as u32)
        };
        let mean = (whole / (4.0 * PI)) as f32;
        if mean <= 0.0 {
            return None;
        }
        let octaves = math::log2(f64::from(brightest / mean)) * THRESHOLDS_PER_OCTAVE;
        let count = octaves.clamp(0.0, MAX_THRESHOLDS) as i32;
        let threshold =
            |level: i32| brightest * math::exp2(-f64::from(level) / THRESHOLDS_PER_OCTAVE) as f32;
        // Pixels above the lowest threshold by the first threshold that they exceed.
        let mut levels: Vec<Vec<usize>> = vec![Vec::new(); count as usize];
        for (pixel, &value) in self.luminance.iter().enumerate() {
            let level = (1..=count).find(|&level| value > threshold(level));
            if let Some(level) = level {
                levels[level as usize - 1].push(pixel);
            }
        }
        let mut forest = Forest::default();
        for (pixels, level) in levels.into_iter().zip(1..) {
            for pixel in pixels {
                let sums = Sums {
                    light: light(pixel),
                    solid_angle: self.image.solid_angle((pixel / width) as u32),
                    direction: light(pixel)
                        * (self.image)
                            .direction((pixel % width) as u32, (pixel / width) as u32)
                            .as_dvec3(),
                };
                let tree = forest.plant(pixel, sums);
                for neighbour in self.neighbours(pixel) {
                    if let Some(&other) = forest.of_pixel.get(&neighbour) {
                        forest.join(tree, other);
                    }
                }
            }
            forest.choose(threshold(level), whole);
        }
        let regions = forest.trees.into_iter().flat_map(|tree| tree.best);
        regions.max_by(|a, b| a.gain.total_cmp(&b.gain).then(b.seed.cmp(&a.seed)))
    }

    /// The pixels of a region and of a margin around it, ascending, and the luminance of what
    /// surrounds them: its median. Without a margin the edge of a source, which is rarely sharp,
    /// would be left to lobes.
    fn surrounded(&self, region: &Region) -> (Vec<usize>, f32) {
        let mut found = BTreeSet::from([region.seed]);
        let mut open = vec![region.seed];
        while let Some(pixel) = open.pop() {
            for neighbour in self.neighbours(pixel) {
                if self.luminance[neighbour] > region.threshold && found.insert(neighbour) {
                    open.push(neighbour);
                }
            }
        }
        let margin = 2 + (MARGIN * (found.len() as f64).sqrt()).ceil() as usize;
        let mut border: BTreeSet<usize> = found.clone();
        for _ in 0..margin {
            let around = border.iter().flat_map(|&pixel| self.neighbours(pixel));
            border = around.filter(|pixel| !found.contains(pixel)).collect();
            found.extend(&border);
        }
        let mut levels: Vec<f32> = border.iter().map(|&pixel| self.luminance[pixel]).collect();
        levels.sort_by(f32::total_cmp);
        let level = levels.get(levels.len() / 2).copied().unwrap_or(0.0);
        (found.into_iter().collect(), level.min(region.threshold))
    }

    /// What pixels have above a luminance, as a source, and the image without it.
    fn source(&self, pixels: &[usize], level: f32) -> (Source, Vec<[f32; 3]>, LatLong) {
        let mut rest = self.image.clone();
        let width = self.width();
        let height = self.image.height as usize;
        let (first_column, columns) = self.columns(pixels);
        let first_row = pixels[0] / width;
        let rows = pixels[pixels.len() - 1] / width - first_row + 1;
        let solid_angle: f64 = (first_row..first_row + rows)
            .map(|row| self.image.solid_angle(row as u32) * columns as f64)
            .sum();
        // Square texels.
        let side = (solid_angle / TEXELS).sqrt();
        let middle = (first_row as f64 + 0.5 * rows as f64) / height as f64 * PI;
        let mut rows = Axis::new(first_row, rows, height, side * height as f64 / PI);
        // The last texel may reach beyond the lower pole: all of them move up then.
        let end = rows.first as f64 + rows.texels as f64 * rows.merged;
        let beyond = (end - height as f64).max(0.0).ceil() as usize;
        rows.first = rows.first.saturating_sub(beyond);
        rows.centre = rows.first as f64 / height as f64 + 0.5 * rows.step;
        let columns_per_side = side * width as f64 / (TAU * math::sin(middle));
        let columns = Axis::new(first_column, columns, width, columns_per_side);
        let mut light = vec![[0f64; 3]; rows.texels * columns.texels];
        for &pixel in pixels {
            let (row, column) = (pixel / width, pixel % width);
            let part = (1.0 - level / self.luminance[pixel].max(level)).max(0.0);
            let texel = rows.texel(row) * columns.texels + columns.texel(column);
            let solid_angle = self.image.solid_angle(row as u32);
            for (light, channel) in light[texel].iter_mut().zip(&mut rest.pixels[pixel]) {
                let taken = *channel * part;
                *channel -= taken;
                *light += f64::from(taken) * solid_angle;
            }
        }
        let (row_step, column_step) = (rows.step * PI, columns.step * TAU);
        let theta = rows.centre * PI;
        // Around the image once at most.
        let phi = (columns.centre * TAU + PI).rem_euclid(TAU) - PI;
        let texels = light.iter().enumerate().map(|(index, light)| {
            let theta = theta + (index / columns.texels) as f64 * row_step;
            let solid_angle = column_step * 2.0 * math::sin(theta) * math::sin(0.5 * row_step);
            light.map(|light| (light / solid_angle) as f32)
        });
        let source = Source {
            theta: theta as f32,
            phi: phi as f32,
            row_step: row_step as f32,
            column_step: column_step as f32,
            rows: rows.texels as u32,
            columns: columns.texels as u32,
        };
        let texels = texels.collect();
        (source, texels, rest)
    }

    /// First column and number of columns of the shortest run, around the image, with all pixels.
    fn columns(&self, pixels: &[usize]) -> (usize, usize) {
        let width = self.width();
        let mut used: Vec<usize> = pixels.iter().map(|pixel| pixel % width).collect();
        used.sort_unstable();
        used.dedup();
        // The run starts behind the widest gap.
        let gap = |index: usize| {
            let before = used[(index + used.len() - 1) % used.len()];
            (used[index] + width - before - 1) % width
        };
        let first = (0..used.len()).max_by_key(|&index| gap(index)).unwrap_or(0);
        (used[first], width - gap(first))
    }
}

/// Rows or columns of an image, some to a texel.
struct Axis {
    first: usize,
    /// Of all rows or columns of the image.
    count: usize,
    /// Rows or columns per texel.
    merged: f64,
    texels: usize,
    /// Between texels, and centre of the first, in parts of the image.
    step: f64,
    centre: f64,
}

impl Axis {
    /// `used` of `count` rows or columns from `first` on, about `merged` to a texel.
    fn new(first: usize, used: usize, count: usize, merged: f64) -> Self {
        let merged = (merged.round() as usize).clamp(1, used);
        let mut texels = used.div_ceil(merged);
        let mut merged = merged as f64;
        if texels as f64 * merged > count as f64 {
            // More than there are.
            texels = (texels - 1).max(1);
            merged = count as f64 / texels as f64;
        }
        let step = merged / count as f64;
        Self {
            first,
            count,
            merged,
            texels,
            step,
            centre: first as f64 / count as f64 + 0.5 * step,
        }
    }

    fn texel(&self, index: usize) -> usize {
        let behind = (index + self.count - self.first) % self.count;
        ((behind as f64 / self.merged) as usize).min(self.texels - 1)
    }
}

/// Connected regions, growing as the threshold falls.
#[derive(Default)]
struct Forest {
    of_pixel: HashMap<usize, usize>,
    trees: Vec<Tree>,
}

struct Tree {
    parent: usize,
    seed: usize,
    sums: Sums,
    /// The best choice of regions within.
    best: Vec<Region>,
}

impl Forest {
    fn plant(&mut self, pixel: usize, sums: Sums) -> usize {
        let tree = self.trees.len();
        self.trees.push(Tree {
            parent: tree,
            seed: pixel,
            sums,
            best: Vec::new(),
        });
        self.of_pixel.insert(pixel, tree);
        tree
    }

    fn root(&mut self, mut tree: usize) -> usize {
        while self.trees[tree].parent != tree {
            let above = self.trees[self.trees[tree].parent].parent;
            self.trees[tree].parent = above;
            tree = above;
        }
        tree
    }

    fn join(&mut self, a: usize, b: usize) {
        let (a, b) = (self.root(a), self.root(b));
        if a == b {
            return;
        }
        // The larger one stays, so that paths stay short.
        let (kept, gone) = if self.trees[a].sums.solid_angle >= self.trees[b].sums.solid_angle {
            (a, b)
        } else {
            (b, a)
        };
        let best = std::mem::take(&mut self.trees[gone].best);
        let sums = self.trees[gone].sums;
        self.trees[gone].parent = kept;
        let kept = &mut self.trees[kept];
        kept.best.extend(best);
        kept.sums.light += sums.light;
        kept.sums.solid_angle += sums.solid_angle;
        kept.sums.direction += sums.direction;
    }

    /// Replaces the regions within every tree by the whole of it where that gains more.
    fn choose(&mut self, threshold: f32, whole: f64) {
        for index in 0..self.trees.len() {
            let tree = &mut self.trees[index];
            if tree.parent != index {
                continue;
            }
            let Sums {
                light,
                solid_angle,
                direction,
            } = tree.sums;
            if direction.length() < LEAST_COSINE * light {
                continue;
            }
            let above = light - f64::from(threshold) * solid_angle;
            let width = 2.0 * (solid_angle / PI).sqrt();
            let gain = above / whole * BOUNDARY_ERROR / (BOUNDARY_ERROR + width) - LEAST_GAIN;
            let within: f64 = tree.best.iter().map(|region| region.gain).sum();
            if gain > within {
                tree.best = vec![Region {
                    seed: tree.seed,
                    threshold,
                    gain,
                }];
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::environment::{FitOptions, MAX_SOURCES, fit, render_all};
    use crate::monitor::SILENT;
    use glam::Vec3;

    /// A sky that brightens upwards with a bright disc about a direction.
    fn sky(width: u32, toward: DVec3, radius: f64, radiance: f32) -> LatLong {
        let size = LatLong {
            width,
            height: width / 2,
            ..LatLong::default()
        };
        let pixels = (0..width * width / 2).map(|index| {
            let direction = size.direction(index % width, index / width).as_dvec3();
            let sky = 0.5 + 0.4 * direction.y as f32;
            let sun = if direction.angle_between(toward) < radius {
                radiance
            } else {
                0.0
            };
            [0.8 * sky + sun, 0.9 * sky + 0.8 * sun, sky + 0.5 * sun]
        });
        LatLong::repair(width, width / 2, pixels.collect())
    }

    fn light(split: &Split) -> [f64; 3] {
        let mut texels = split.texels.iter();
        let mut sum = [0.0; 3];
        for source in &split.sources {
            for row in 0..source.rows {
                let theta = f64::from(source.theta) + f64::from(row) * f64::from(source.row_step);
                let solid_angle = f64::from(source.column_step)
                    * 2.0
                    * math::sin(theta)
                    * math::sin(0.5 * f64::from(source.row_step));
                for _ in 0..source.columns {
                    for (sum, channel) in sum.iter_mut().zip(texels.next().unwrap()) {
                        *sum += solid_angle * f64::from(*channel);
                    }
                }
            }
        }
        sum
    }

    #[test]
    fn a_disc_is_one_source_with_its_light_wherever_it_is() {
        for (toward, radius, radiance) in [
            (DVec3::new(0.5, 0.4, -0.6), 0.03, 500.0),
            // Across the seam of the image, at a pole, and a lamp as large as a hand.
            (DVec3::new(0.0, 0.3, -1.0), 0.05, 300.0),
            (DVec3::new(0.01, 1.0, 0.0), 0.1, 100.0),
            (DVec3::new(-0.8, -0.4, 0.1), 0.3, 20.0),
        ] {
            let toward = toward.normalize();
            let image = sky(256, toward, radius, radiance);
            let split = split(&image, MAX_SOURCES);
            let [source] = split.sources[..] else {
                panic!("{toward}: {:?}", split.sources);
            };
            let whole = image.total_power();
            let rest = split.rest.total_power();
            for channel in 0..3 {
                let sum = light(&split)[channel] + rest[channel];
                assert!((sum / whole[channel] - 1.0).abs() < 1e-4, "{toward}: {sum}");
            }
            // What is left is about as even as the sky.
            let brightest = split
                .rest
                .pixels
                .iter()
                .flatten()
                .copied()
                .fold(0.0, f32::max);
            assert!(brightest < 2.5, "{toward}: {brightest}");
            let middle = DVec3::from(source.direction().map(f64::from));
            let full = f64::from(source.columns as f32 * source.column_step) > 6.0;
            assert!(
                full || middle.angle_between(toward) < 0.03,
                "{middle} for {toward}"
            );
            // The asset accepts it, and a picture of it has the same light.
            let environment = fit(
                &image,
                &FitOptions {
                    lobes: 2,
                    ..FitOptions::default()
                },
                SILENT,
            )
            .unwrap()
            .environment;
            relight_format::write_environment(&environment).unwrap();
            let picture = render_all(&environment, 256, 128).total_power();
            for channel in 0..3 {
                let ratio = picture[channel] / whole[channel];
                // Lobes at pixel centres, by the midpoint rule.
                assert!((ratio - 1.0).abs() < 0.01, "{toward}: {ratio}");
            }
        }
    }

    #[test]
    fn an_even_sky_and_darkness_have_no_sources() {
        for image in [
            sky(128, DVec3::Y, 0.0, 0.0),
            LatLong::repair(8, 4, vec![[0.0; 3]; 32]),
            // A sun that is too faint to cast a shadow.
            sky(128, DVec3::Y, 0.1, 0.1),
        ] {
            let split = split(&image, MAX_SOURCES);
            assert!(split.sources.is_empty() && split.rest == image);
        }
    }

    #[test]
    fn two_lamps_are_two_sources_and_no_more_than_asked_for() {
        let mut image = sky(256, DVec3::new(0.5, 0.4, -0.6).normalize(), 0.03, 500.0);
        let other = sky(256, DVec3::new(-0.6, 0.3, 0.5).normalize(), 0.05, 100.0);
        for (pixel, other) in image.pixels.iter_mut().zip(&other.pixels) {
            for (channel, other) in pixel.iter_mut().zip(other) {
                *channel += other;
            }
        }
        assert_eq!(split(&image, MAX_SOURCES).sources.len(), 2);
        let one = split(&image, 1);
        assert_eq!(one.sources.len(), 1);
        assert!(Vec3::from(one.sources[0].direction()).dot(Vec3::new(0.5, 0.4, -0.6)) > 0.8);
    }
}
