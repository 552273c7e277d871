//! Radiance of the pixels of a tile: lights times reflection, lobe by lobe, over what is visible.
//!
//! Lobes are taken in rounds of a few lights. What is visible of those of a round is found by the pixels of a tile
//! together, see [`crate::pixel_visibility`]; what was gathered in a round is known in the next.

use std::f32::consts::{FRAC_1_PI, PI};

use glam::Vec3;

use crate::contribution::{BLACK, negligible, share};
use crate::glossy::Glossy;
use crate::pixel_visibility::{Asked, PIXELS, Parents, Place};
use crate::shade::{EVEN, EVENLY, Lighting, Method, diffused, image_reflected, image_seen};
use crate::sources::{Lit, Seen};
use crate::spherical_gaussian::SphericalGaussian;
use crate::ssdf::SignedDistance;
use crate::surface::{MAX_REFLECTIONS, Model, SurfacePoint};
use crate::tables::Tables;
use crate::{ambient, polar};

/// Lights of a round.
const ROUND: usize = crate::slots::WAITING as usize;

/// What a pixel shows, its light and its visibility.
#[derive(Clone, Copy, Debug)]
pub struct Pixel<'a, F> {
    /// The point.
    pub point: &'a SurfacePoint<'a>,
    /// Its light.
    pub lighting: Lighting<'a>,
    /// Its visibility.
    pub field: &'a F,
    /// Instance and material.
    pub surface: [u32; 2],
    /// [`crate::surface::has_diffuse`] of the material.
    pub has_diffuse: bool,
}

impl<F> Pixel<'_, F> {
    /// Whether its surface faces the eye: else nothing is reflected.
    fn is_lit(&self) -> bool {
        self.point.normal.dot(self.point.view) > 0.0
    }
}

/// What shading takes.
#[derive(Clone, Copy, Debug, Default)]
pub struct Counts {
    /// Lobes or groups of lobes integrated.
    pub integrals: u64,
    /// Rays and cones followed towards sources.
    pub rays: u64,
}

/// Radiance of [`PIXELS`] pixels, row by row, towards the eye; or of a few that do not lie beside one
/// another. Zero where there is none. Adds to what is counted.
pub fn shade<F: SignedDistance>(
    pixels: &[Option<Pixel<F>>],
    method: &Method,
    counts: &mut Counts,
) -> Vec<Vec3> {
    let mut tile = Tile::new(pixels, *method);
    let seen = tile.sources();
    #[cfg(feature = "paper")]
    if let Method::Cells(options) = method {
        let mut of_sources = vec![Vec3::ZERO; pixels.len()];
        (0..MAX_REFLECTIONS).for_each(|index| tile.add_sources(&seen, index, &mut of_sources));
        let mut shade = |pixel: &Pixel<F>, of_sources: Vec3| {
            let (point, lighting, field) = (pixel.point, &pixel.lighting, pixel.field);
            let of_lobes = crate::shade_cells::radiance(
                point,
                lighting,
                field,
                options,
                &mut counts.integrals,
            );
            (of_sources + of_lobes).max(Vec3::ZERO)
        };
        counts.rays += tile.counts.rays;
        return (pixels.iter().zip(of_sources))
            .map(|(pixel, of_sources)| {
                (pixel.as_ref()).map_or(Vec3::ZERO, |pixel| shade(pixel, of_sources))
            })
            .collect();
    }
    // First, so that lobes that add nothing to it are left out.
    let mut radiance = vec![Vec3::ZERO; pixels.len()];
    tile.add_sources(&seen, 0, &mut radiance);
    let irradiance = tile.irradiance(&radiance);
    for ((pixel, radiance), irradiance) in tile.pixels.iter().zip(&mut radiance).zip(irradiance) {
        if let Some(pixel) = pixel {
            *radiance += pixel.point.appearance.diffuse * FRAC_1_PI * irradiance;
        }
    }
    let mut beside = vec![Vec3::ZERO; pixels.len()];
    for (pixel, beside) in tile.pixels.iter().zip(&mut beside) {
        if let Some(pixel) = pixel
            && let Some(reflections) = &pixel.lighting.reflections
        {
            *beside = diffused(
                pixel.point,
                reflections,
                pixel.field,
                &mut tile.counts.integrals,
            );
        }
    }
    for index in 0..MAX_REFLECTIONS {
        let glossies: Vec<_> = (tile.pixels.iter())
            .map(|pixel| {
                let point = pixel.as_ref()?.point;
                let reflection = &point.appearance.reflections[index];
                (reflection.model != Model::None).then(|| Glossy::new(point, reflection))
            })
            .collect();
        if glossies.iter().any(Option::is_some) {
            if index > 0 {
                tile.add_sources(&seen, index, &mut radiance);
            }
            tile.reflect(&glossies, &mut radiance);
            tile.reflect_image(&glossies, &radiance, &mut beside);
        }
    }
    counts.integrals += tile.counts.integrals;
    counts.rays += tile.counts.rays;
    (radiance.iter().zip(&beside))
        .map(|(radiance, beside)| (radiance + beside).max(Vec3::ZERO))
        .collect()
}

/// Radiance of one point towards the eye.
pub fn point_radiance(
    point: &SurfacePoint,
    lighting: &Lighting,
    field: &impl SignedDistance,
    method: &Method,
) -> Vec3 {
    let pixel = Pixel {
        point,
        lighting: *lighting,
        field,
        surface: [0; 2],
        has_diffuse: point.appearance.diffuse != Vec3::ZERO,
    };
    shade(&[Some(pixel)], method, &mut Counts::default())[0]
}

/// A lobe of a round.
#[derive(Clone, Copy)]
struct Waiting {
    lobe: SphericalGaussian,
    /// Unit normals of the shading and of the plane behind which nothing is visible.
    normals: [Vec3; 2],
    /// ∫ exp(λ(p·ω − 1)) max(n·ω, 0) dω.
    unoccluded: f32,
    asked: Asked,
}

impl Waiting {
    fn new(lobe: SphericalGaussian, normals @ [normal, _]: [Vec3; 2]) -> Self {
        let cosine = normal.dot(lobe.axis);
        let meets = polar::meets_horizon(lobe.sharpness, cosine);
        Self {
            lobe,
            normals,
            unoccluded: Tables::get().cosine_integral(lobe.sharpness, cosine),
            asked: Asked {
                known: 0.0,
                unknown: if meets { 1.0 } else { 0.0 },
                share: 0.0,
            },
        }
    }

    /// All that it could add.
    fn whole(&self) -> Vec3 {
        self.lobe.amplitude * self.unoccluded
    }
}

/// From which pixels each may take what they have found: none where they are not those of a tile.
fn parents<F>(pixels: &[Option<Pixel<F>>]) -> Parents {
    let place = |pixel: &Option<Pixel<F>>| {
        pixel.as_ref().map(|pixel| Place {
            position: pixel.point.position,
            normal: pixel.point.normal,
            surface: pixel.surface,
        })
    };
    if pixels.len() == PIXELS {
        Parents::new(&pixels.iter().map(place).collect::<Vec<_>>())
    } else {
        Parents::none(pixels.len())
    }
}

type Round = [Option<Waiting>; ROUND];

struct Tile<'a, F> {
    /// Those that reflect anything.
    pixels: Vec<Option<Pixel<'a, F>>>,
    parents: Parents,
    method: Method,
    counts: Counts,
}

impl<'a, F: SignedDistance> Tile<'a, F> {
    fn new(pixels: &[Option<Pixel<'a, F>>], method: Method) -> Self {
        let lit = |pixel: &Option<Pixel<'a, F>>| {
            let pixel = pixel.as_ref().filter(|pixel| pixel.is_lit())?;
            Some(Pixel { ..*pixel })
        };
        let pixels: Vec<_> = pixels.iter().map(lit).collect();
        let parents = match method {
            Method::Polar(_) => parents(&pixels),
            Method::Ambient | Method::Cells(_) => Parents::none(pixels.len()),
        };
        Self {
            pixels,
            parents,
            method,
            counts: Counts::default(),
        }
    }

    /// What every pixel sees of sources, if there are any.
    fn sources(&mut self) -> Vec<Option<Vec<Seen>>> {
        let lit = |pixel: &Option<Pixel<'a, F>>| {
            let pixel = pixel.as_ref()?;
            Some((pixel.point, pixel.lighting.sources?))
        };
        let lit: Vec<_> = self.pixels.iter().map(lit).collect();
        if lit.iter().all(Option::is_none) {
            return vec![None; lit.len()];
        }
        let rays = &mut self.counts.rays;
        match self.method {
            Method::Polar(_) => Lit::seen_by_tile(&lit, &self.parents, rays),
            Method::Ambient | Method::Cells(_) => {
                Lit::seen_by_tile(&lit, &parents(&self.pixels), rays)
            }
        }
    }

    /// Adds what one reflection of every pixel shows of that.
    fn add_sources(&self, seen: &[Option<Vec<Seen>>], index: usize, radiance: &mut [Vec3]) {
        for ((pixel, seen), sum) in self.pixels.iter().zip(seen).zip(radiance) {
            if let (Some(pixel), Some(seen)) = (pixel, seen)
                && let Some(sources) = &pixel.lighting.sources
            {
                *sum += sources.shown(pixel.point, seen, index);
            }
        }
    }

    /// Lights of all kinds, and the first of those that specular lobes reflect: of one pixel as of another.
    fn lights(&self) -> [usize; 3] {
        let lighting = self.pixels.iter().flatten().next();
        lighting.map_or([0; 3], |pixel| {
            let lighting = &pixel.lighting;
            let first = lighting.first_reflected();
            [first, lighting.count(), lighting.lights.len()]
        })
    }

    /// Irradiance by all lights, where the corners of a pixel's triangle agree on it interpolated from them. Lights that add
    /// little to the radiance that is `gathered` need not be known closely.
    fn irradiance(&mut self, gathered: &[Vec3]) -> Vec<Vec3> {
        let [_, count, _] = self.lights();
        let mut sums = vec![Vec3::ZERO; self.pixels.len()];
        // As irradiance.
        let besides = |(pixel, gathered): (&Option<Pixel<F>>, &Vec3)| {
            pixel.as_ref().map_or(Vec3::ZERO, |pixel| {
                gathered / (pixel.point.appearance.diffuse / PI).max(Vec3::splat(BLACK))
            })
        };
        let besides: Vec<Vec3> = self.pixels.iter().zip(gathered).map(besides).collect();
        for first in (0..count).step_by(ROUND) {
            let round = |(pixel, (sum, besides)): (&Option<Pixel<F>>, (&Vec3, &Vec3))| {
                let mut round: Round = [None; ROUND];
                let Some(pixel) = pixel.as_ref().filter(|pixel| pixel.has_diffuse) else {
                    return round;
                };
                let mut estimate = sum + besides;
                for (index, waiting) in (first..count).zip(&mut round) {
                    let light = pixel.lighting.light(index, pixel.point.position);
                    let whole = light.integral();
                    if negligible(whole, estimate) {
                        continue;
                    }
                    let share = share(whole, estimate);
                    let mut found = Waiting::new(light, [pixel.point.normal; 2]);
                    found.asked.share = share;
                    if found.asked.unknown > 0.0 {
                        let fractions = pixel.lighting.fractions(index, pixel.point);
                        found.asked.unknown = fractions.doubt(share);
                        found.asked.known = (1.0 - found.asked.unknown) * fractions.mean();
                    }
                    estimate += found.whole() * found.asked.known;
                    *waiting = Some(found);
                }
                round
            };
            let gathered = sums.iter().zip(&besides);
            let rounds: Vec<Round> = self.pixels.iter().zip(gathered).map(round).collect();
            let fractions = self.visible(&rounds);
            for ((sum, round), fractions) in sums.iter_mut().zip(&rounds).zip(fractions) {
                for (waiting, fraction) in round.iter().zip(fractions) {
                    *sum += waiting.map_or(Vec3::ZERO, |waiting| waiting.whole() * fraction);
                }
            }
        }
        sums
    }

    /// What one reflection of every pixel shows of lights.
    fn reflect(&mut self, glossies: &[Option<Glossy>], gathered: &mut [Vec3]) {
        let [begin, count, _] = self.lights();
        for first in (begin..count).step_by(ROUND) {
            let lights = first..count.min(first + ROUND);
            let mut rounds = self.round(glossies, (lights.clone(), false), gathered);
            for ((round, pixel), sum) in rounds.iter_mut().zip(&self.pixels).zip(&*gathered) {
                let mut estimate = *sum;
                for (waiting, index) in round.iter_mut().zip(lights.clone()) {
                    if let (Some(found), Some(pixel)) = (&mut *waiting, pixel) {
                        let whole = found.lobe.integral();
                        if negligible(whole, estimate) {
                            *waiting = None;
                            continue;
                        }
                        found.asked.share = share(whole, estimate);
                        pixel.ask_corners(index, found);
                        estimate += found.whole() * found.asked.known;
                    }
                }
            }
            let fractions = self.visible(&rounds);
            for ((sum, round), fractions) in gathered.iter_mut().zip(&rounds).zip(fractions) {
                for (waiting, fraction) in round.iter().zip(fractions) {
                    *sum += waiting.map_or(Vec3::ZERO, |waiting| waiting.whole() * fraction);
                }
            }
        }
    }

    /// What one reflection of every pixel shows of the environment's image, where the lights are visible. Of lights that
    /// add little to what is `gathered` it need not be known closely.
    fn reflect_image(
        &mut self,
        glossies: &[Option<Glossy>],
        gathered: &[Vec3],
        beside: &mut [Vec3],
    ) {
        let [begin, _, distant] = self.lights();
        if begin == 0 {
            return;
        }
        let mut scaled = vec![Vec3::ZERO; self.pixels.len()];
        let mut seen = scaled.clone();
        let mut part = vec![None; self.pixels.len()];
        // And light from everywhere.
        for first in (0..=distant).step_by(ROUND) {
            let lights = first..(distant + 1).min(first + ROUND);
            let sums: Vec<Vec3> = (gathered.iter().zip(&scaled))
                .map(|(gathered, scaled)| gathered + scaled)
                .collect();
            let mut rounds = self.round(glossies, (lights.clone(), true), &sums);
            let pixels = self.pixels.iter().zip(gathered).zip(&mut scaled);
            for (round, ((pixel, gathered), sum)) in rounds.iter_mut().zip(pixels) {
                for (waiting, index) in round.iter_mut().zip(lights.clone()) {
                    let (Some(found), Some(pixel)) = (&mut *waiting, pixel) else {
                        continue;
                    };
                    if index == distant {
                        found.asked.share = EVEN;
                        continue;
                    }
                    let whole = found.whole();
                    let estimate = *gathered + *sum;
                    if negligible(whole, estimate) {
                        *waiting = None;
                        continue;
                    }
                    found.asked.share = share(whole, estimate);
                    pixel.ask_corners(index, found);
                    *sum += whole;
                }
            }
            let fractions = self.visible(&rounds);
            for (pixel, (round, fractions)) in rounds.iter().zip(fractions).enumerate() {
                for ((waiting, fraction), index) in round.iter().zip(fractions).zip(lights.clone())
                {
                    let Some(waiting) = waiting else {
                        continue;
                    };
                    if index == distant {
                        part[pixel] = Some(fraction);
                    } else {
                        seen[pixel] += waiting.whole() * fraction;
                    }
                }
            }
        }
        for (pixel, glossy) in glossies.iter().enumerate() {
            if let (Some(part), Some(glossy)) = (part[pixel], glossy)
                && let Some(reflections) = &self.pixels[pixel]
                    .as_ref()
                    .and_then(|p| p.lighting.reflections)
            {
                let image = image_reflected(glossy, reflections);
                beside[pixel] += image_seen(image, scaled[pixel], seen[pixel], part);
            }
        }
    }

    /// The lobes that reflections make of some lights, of those that can add to what was gathered before. Where they
    /// are to say what is seen of an image, the one after the last distant light is light from everywhere, measured by
    /// itself.
    fn round(
        &self,
        glossies: &[Option<Glossy>],
        (lights, of_image): (std::ops::Range<usize>, bool),
        gathered: &[Vec3],
    ) -> Vec<Round> {
        let [_, _, distant] = self.lights();
        let round = |(pixel, (glossy, sum)): (&Option<Pixel<F>>, (&Option<Glossy>, &Vec3))| {
            let mut round: Round = [None; ROUND];
            let (Some(pixel), Some(glossy)) = (pixel, glossy) else {
                return round;
            };
            for (index, waiting) in lights.clone().zip(&mut round) {
                let (light, sum) = if of_image && index == distant {
                    (EVENLY, Vec3::ZERO)
                } else {
                    (pixel.lighting.light(index, pixel.point.position), *sum)
                };
                *waiting = glossy
                    .reflected(&light, sum)
                    .filter(|lobe| !negligible(lobe.integral(), sum))
                    .map(|lobe| {
                        Waiting::new(lobe, [pixel.point.normal, pixel.point.geometric_normal])
                    });
            }
            round
        };
        let glossies = glossies.iter().zip(gathered);
        self.pixels.iter().zip(glossies).map(round).collect()
    }

    /// Visible fractions of a round's lobes.
    fn visible(&mut self, rounds: &[Round]) -> Vec<[f32; ROUND]> {
        let asked: Vec<_> = (rounds.iter())
            .map(|round| round.map(|waiting| waiting.map(|waiting| waiting.asked)))
            .collect();
        let of = |pixel: usize, place: usize| {
            let (pixel, waiting) = (&self.pixels[pixel], &rounds[pixel][place]);
            (pixel.as_ref().zip(waiting.as_ref())).expect("only what was asked is looked for")
        };
        let look = |pixel, place| {
            let (pixel, Waiting { lobe, .. }) = of(pixel, place);
            let distance = match self.method {
                Method::Polar(_) => pixel.field.distance(lobe.axis),
                Method::Ambient | Method::Cells(_) => 0.0,
            };
            [distance, polar::support_radius(lobe.sharpness)]
        };
        let integrals = &mut self.counts.integrals;
        let find = |pixel, place, distance| {
            *integrals += 1;
            let (pixel, waiting) = of(pixel, place);
            let SphericalGaussian {
                axis, sharpness, ..
            } = waiting.lobe;
            match self.method {
                Method::Polar(options) => {
                    let share = waiting.asked.rounded().share;
                    let thoroughly = polar::is_thorough(share);
                    polar::visible_fraction(
                        pixel.field,
                        sharpness,
                        axis,
                        waiting.normals,
                        distance,
                        (options.for_share(share), thoroughly),
                    )
                }
                Method::Ambient | Method::Cells(_) => {
                    ambient::visible_fraction(pixel.field, sharpness, axis, pixel.point.normal)
                }
            }
        };
        self.parents.fractions(&asked, look, find)
    }
}

impl<F> Pixel<'_, F> {
    /// Leaves in `waiting`, a lobe of light `index`, what the corners of the pixel's triangle know of it.
    fn ask_corners(&self, index: usize, waiting: &mut Waiting) {
        if waiting.asked.unknown == 0.0 {
            return;
        }
        let light = self.lighting.light(index, self.point.position);
        let fractions = self.lighting.fractions(index, self.point);
        let SphericalGaussian {
            axis, sharpness, ..
        } = waiting.lobe;
        // What all corners see may be behind the triangle.
        let is_clipped =
            || polar::is_clipped(polar::support_radius(sharpness), axis, waiting.normals);
        if let Some(fraction) = fractions.whole(&light, &waiting.lobe)
            && (fraction == 0.0 || !is_clipped())
        {
            waiting.asked.known = fraction;
            waiting.asked.unknown = 0.0;
        }
    }
}
