//! Bounces between points: irradiance of every point as a linear function of distant light.

use relight_format::math;
use std::f32::consts::PI;
use std::sync::atomic::{AtomicU32, Ordering};

use glam::{Vec2, Vec3};
use rayon::prelude::*;
use relight_shading::transfer::Harmonics;

use super::Options;
use super::emitters::{Emitter, Emitters};
use super::lamps::Emitted;
use super::points::{Point, Points};
use super::surfaces::{Met, Surfaces};
use crate::mesh::size::SizeFunction;
use crate::monitor::{Interrupted, Monitor};
use crate::simd::vectorised;
use crate::visibility::ray::RayCaster;

/// Without a number given, bounces end where the next and all after it would add less than this, as a part of what
/// each point has; root mean square over points. Of what all points have together, those in the open have most, and
/// rooms would be left dark.
const LEFT_OUT: f64 = 0.005;
/// A point counts as having at least this part of the mean: into the insides of solid things light comes through cracks,
/// bounce by bounce, and nobody looks at them.
const LEAST: f64 = 0.001;
/// And after so many in any case: albedos of nearly one in closed rooms.
const MOST_BOUNCES: u32 = 64;
/// Part of rays that meet backs from which on backs have points of their own.
const BACKS: f64 = 0.005;
/// One of so many rays tells it.
const FEW: u32 = 16;
/// Radius of the disc, in spacings of points, from which the point that stands for a place is
/// drawn: neighbours share what lies between them.
const BLUR: f32 = 0.6;
/// How far a point may be from what it stands for at most, in spacings, and what the cosine between their
/// normals must exceed.
const REACH: f32 = 2.0;
const ALIKE: f32 = 0.7;
/// Farther than this part of a point's clearance what it sees changes (Ward, Rubinstein and Clear 1988, "A Ray
/// Tracing Solution for Diffuse Interreflection"): there a point in a slit stands for what something is as close to
/// alone. The clearance is twice the slit's height.
const UNCHANGED: f32 = 0.7;
/// Surfaces that no point stands for, one after the other, before the nearest point has to.
const MOST_STEPS: u32 = 4;
/// Radiance that a ray brings by way of such surfaces is at most so many times the mean over the hemisphere. Seldom does
/// one meet what something very bright is close to, and would be a spot.
const MOST_TIMES_MEAN: f32 = 4.0;
/// Radians by which the sky is blurred that such surfaces see, by one ray.
const SKY_BLUR: f32 = 0.35;
/// Where a point is looked for that stands for what a ray met, one place after the other, in such radii along the one drawn by
/// chance and across it: about it, and farther off where those do not stand for it, as where a wall lies between that it passes through.
const PLACES: [[f32; 2]; 7] = [
    [1.0, 0.0],
    [-0.5, 0.0],
    [0.0, 0.0],
    [-2.0, 0.0],
    [0.0, 2.0],
    [0.0, -2.0],
    [2.0, 0.0],
];
/// Radiance of a sky that would give surfaces as much light as what emits does, on average, from which on they are lit by
/// lamps; skies are about 1.
const LIT_BY_LAMPS: f32 = 0.02;
/// How far above the surface what stands between neighbours is looked for, as a part of their
/// distance.
const ABOVE: f32 = 0.1;
/// Directions about a circle that random ones are drawn from.
const TURNS: usize = 256;

/// In place of the point that stands for a cell: there is none, or it has not been found yet.
const NONE: u32 = u32::MAX;
const UNKNOWN: u32 = u32::MAX - 1;
/// Something passes through the cell: what is met there has the points of its own side.
const PARTED: u32 = u32::MAX - 2;
/// Triangles that would have more cells along a side have none: rays seldom meet the same one of them.
const MOST_STEPS_A_SIDE: f32 = 8.0;
/// Cells beyond one for each triangle, at most.
const MOST_CELLS: usize = 1 << 20;

/// Light of the scene after all bounces.
pub(crate) struct Radiosity {
    pub(super) surfaces: Surfaces,
    pub(super) points: Points,
    harmonics: Harmonics,
    /// What [`SKY_BLUR`] leaves of each harmonic.
    blurs: Vec<f32>,
    /// Unit vectors evenly about a circle.
    turns: Vec<Vec2>,
    /// Where the rays of a hemisphere turn to, one after the other.
    spiral: Vec<Vec2>,
    pub(super) columns: usize,
    pub(super) ray_offset: f32,
    /// Of every point that something is above within it, the harmonic mean of how far its rays go, metres; without
    /// bound of others: what is beside a wall differs less from what is farther away than rays by chance do.
    clearances: Vec<f32>,
    /// Of every triangle.
    cells: Vec<Cells>,
    /// For each side of every cell, the point that stands for it, or [`NONE`], [`UNKNOWN`] or [`PARTED`].
    standing: Vec<[AtomicU32; 2]>,
    /// Irradiance of every point: per channel `columns` numbers.
    pub(super) irradiance: Vec<f32>,
    /// What points send on of what is emitted, as triangles about them.
    pub(super) relays: Emitters,
    /// Bounces followed, those at vertices among them.
    bounces: u32,
    /// What the last adds, by [`Self::part_of_each`].
    last_bounce: f32,
    rays: u64,
}

/// The parts of a triangle for which one point each stands, along two sides; none where there would be too many.
struct Cells {
    first: u32,
    steps: u32,
}

/// What a ray meets, and what it sends on.
pub(crate) struct Sender {
    pub(super) end: End,
    /// Albedos up to there, times what its light counts here.
    weight: Vec3,
    /// Whether what the ray met is what the light is known of.
    pub(super) direct: bool,
    /// Radiance of its own, times what its light counts here.
    pub(super) emission: Vec3,
    /// Radiance of surfaces that are seen by way of those that no point stands for, likewise.
    pub(super) beyond: Vec3,
}

/// Where the light that something sends on is known.
pub(super) enum End {
    /// At the point that stands for it.
    Point(u32),
    /// In a direction in which nothing is met.
    Sky(Vec3),
}

/// A point that another sees, and its albedo times what its light counts there.
type Link = (u32, Vec3);

/// What reaches the points at once, and whom each sees.
type First = (Vec<f32>, Vec<Vec<Link>>);

impl Radiosity {
    /// Follows bounces until they end. Nothing where options ask for none or the scene has no
    /// surface.
    pub(crate) fn new(
        surfaces: Surfaces,
        caster: &RayCaster,
        options: &Options,
        (sizes, ray_offset): (&SizeFunction, f32),
        monitor: Monitor,
    ) -> Result<Option<Self>, Interrupted> {
        if options.bounces == Some(0) {
            return Ok(None);
        }
        let harmonics = Harmonics::new(options.order);
        let columns = harmonics.count() + usize::from(surfaces.emit());
        let points = Points::new(&surfaces, sizes, options.points, false);
        if points.as_slice().is_empty() {
            return Ok(None);
        }
        let mut all = Self {
            surfaces,
            points,
            harmonics,
            blurs: (0..=options.order)
                .flat_map(|degree| {
                    let exponent = (degree * (degree + 1)) as f32 * SKY_BLUR * SKY_BLUR;
                    std::iter::repeat_n(math::exp(-0.5 * exponent), 2 * degree as usize + 1)
                })
                .collect(),
            turns: (0..TURNS)
                .map(|i| turned(2.0 * PI * (i as f32 + 0.5) / TURNS as f32))
                .collect(),
            spiral: (0..options.point_rays.max(options.vertex_rays))
                .map(|i| turned(GOLDEN * i as f32))
                .collect(),
            columns,
            ray_offset,
            clearances: Vec::new(),
            cells: Vec::new(),
            standing: Vec::new(),
            irradiance: Vec::new(),
            relays: Emitters::default(),
            bounces: 1,
            last_bounce: 0.0,
            rays: 0,
        };
        if all.look_around(caster, options.point_rays / FEW) > BACKS {
            all.points = Points::new(&all.surfaces, sizes, 2 * options.points, true);
            all.look_around(caster, options.point_rays / FEW);
        }
        all.divide();
        let (direct, senders) = all.first(caster, options, monitor)?;
        all.bounce(direct, &senders, options.bounces, monitor)?;
        all.relays = all.relays();
        Ok(Some(all))
    }

    /// Casts so many rays from every point, finds the points' clearances and returns the part of the rays that meet
    /// backs.
    fn look_around(&mut self, caster: &RayCaster, count: u32) -> f64 {
        let points = self.points.as_slice();
        let look = |(index, point): (usize, &Point)| {
            let origin = point.position + self.ray_offset * point.geometric_normal;
            let (mut backs, mut inverse) = (0, 0.0);
            for ray in self.hemisphere(point.normal, count, index as u32) {
                if let Some(met) = self.meet(caster, origin, ray.direction) {
                    backs += u32::from(met.behind);
                    inverse += 1.0 / met.position.distance(origin).max(self.ray_offset);
                }
            }
            let clearance = count as f32 / inverse;
            let above = origin + clearance * point.geometric_normal;
            let covered = clearance.is_finite() && caster.blocked(origin, above);
            let clearance = if covered { clearance } else { f32::INFINITY };
            (backs, clearance)
        };
        let found: Vec<_> = points.par_iter().enumerate().map(look).collect();
        let rays = points.len() as u64 * u64::from(count);
        self.rays += rays;
        self.clearances = found.iter().map(|(_, clearance)| *clearance).collect();
        let backs: u32 = found.iter().map(|(backs, _)| backs).sum();
        f64::from(backs) / rays.max(1) as f64
    }

    /// What reaches the points at once, and whom else they see.
    fn first(
        &mut self,
        caster: &RayCaster,
        options: &Options,
        monitor: Monitor,
    ) -> Result<First, Interrupted> {
        let length = 3 * self.columns;
        let mut direct = vec![0.0; self.points.as_slice().len() * length];
        let this = &*self;
        let gathered: Result<Vec<_>, Interrupted> = (direct.par_chunks_exact_mut(length))
            .zip(this.points.as_slice())
            .enumerate()
            .map(|(index, (direct, point))| {
                monitor.step("bounces", 0.0)?;
                let origin = point.position + this.ray_offset * point.geometric_normal;
                let count = options.point_rays;
                let mut values = vec![0.0; this.harmonics.count()];
                let mut radiance = vec![0.0; length];
                let mut senders = Vec::new();
                let lamps = this.lamps(origin, point.normal, count);
                let mut emitted = Emitted::default();
                let mut beyond = Vec::new();
                for ray in this.hemisphere(point.normal, count, index as u32) {
                    let weight = ray.cosine * (2.0 * PI / count as f32);
                    let Some(met) = this.meet(caster, origin, ray.direction) else {
                        this.harmonics.evaluate(ray.direction, &mut values);
                        for channel in direct.chunks_exact_mut(this.columns) {
                            for (sum, value) in channel.iter_mut().zip(&values) {
                                *sum += weight * value;
                            }
                        }
                        continue;
                    };
                    emitted += lamps.met(&met, ray.direction);
                    let sender = this.sender(caster, &met, weight, ray.number);
                    if sender.beyond != Vec3::ZERO {
                        beyond.push((sender.beyond / weight, weight));
                    }
                    if let End::Point(point) = sender.end {
                        senders.push((point, sender.weight));
                    } else {
                        let (values, weight) = this.radiance(&sender, &mut radiance);
                        add_colored(direct, values, weight);
                    }
                }
                emitted += lamps.drawn(caster, index as u32);
                let emitted = emitted.dot_normal(point.normal);
                this.add_emitted(direct, emitted);
                limit(&mut beyond, emitted.element_sum());
                for (radiance, weight) in beyond {
                    this.add_emitted(direct, radiance * weight);
                }
                Ok(senders)
            })
            .collect();
        let gathered = gathered?;
        self.rays += (self.points.as_slice().len() * options.point_rays as usize) as u64;
        Ok((direct, gathered))
    }

    /// Adds up bounces. Gathering at vertices is one more.
    fn bounce(
        &mut self,
        direct: Vec<f32>,
        senders: &[Vec<Link>],
        most: Option<u32>,
        monitor: Monitor,
    ) -> Result<(), Interrupted> {
        let length = 3 * self.columns;
        self.irradiance.clone_from(&direct);
        let mut last = direct;
        let mut before = f64::INFINITY;
        while self.bounces < most.unwrap_or(MOST_BOUNCES) {
            monitor.step("bounces", 0.0)?;
            let mut next = vec![0.0; last.len()];
            (next.par_chunks_exact_mut(length).zip(senders)).for_each(|(sums, senders)| {
                for (point, weight) in senders {
                    vectorised!(
                        <'a>
                        sums: &'a mut [f32] = sums,
                        from: &'a [f32] = &last[*point as usize * length..][..length],
                        weight: Vec3 = weight / PI
                        => () { add_colored(sums, from, weight) }
                    );
                }
            });
            let added = self.part_of_each(&next);
            // Each bounce after it is smaller by as much as this one is.
            let left_out = added / (1.0 - added / before).max(f64::MIN_POSITIVE);
            if most.is_none() && left_out < LEFT_OUT {
                break;
            }
            before = added;
            self.last_bounce = added as f32;
            for (sum, value) in self.irradiance.iter_mut().zip(&next) {
                *sum += value;
            }
            self.bounces += 1;
            last = next;
        }
        Ok(())
    }

    /// The root mean square over points of what reaches each, by what it has or [`LEAST`].
    fn part_of_each(&self, values: &[f32]) -> f64 {
        let squares = |values: &[f32]| -> Vec<f64> {
            let square =
                |values: &[f32]| values.iter().map(|x| f64::from(*x) * f64::from(*x)).sum();
            values.chunks_exact(3 * self.columns).map(square).collect()
        };
        let [next, all] = [values, &self.irradiance].map(squares);
        let count = all.len() as f64;
        let least = LEAST * LEAST * all.iter().sum::<f64>() / count;
        let parts = next
            .iter()
            .zip(&all)
            .map(|(next, all)| next / all.max(least).max(f64::MIN_POSITIVE));
        (parts.sum::<f64>() / count).sqrt()
    }

    /// Points as emitters of what they send on of what is emitted elsewhere.
    fn relays(&self) -> Emitters {
        if !self.surfaces.emit() {
            return Emitters::default();
        }
        let relay = |(index, point): (usize, &Point)| {
            // An equilateral triangle as large as the part of the surface that a point stands for.
            let side = (4.0 / 3f32.sqrt()).sqrt() * self.points.spacing_at(point.position);
            let (x, y) = point.geometric_normal.any_orthonormal_pair();
            let corner =
                |turn: Vec2| point.position + side / 3f32.sqrt() * (turn.x * x + turn.y * y);
            let third = turned(2.0 * PI / 3.0);
            Emitter {
                triangle: index as u32,
                corners: [Vec2::X, third, third.rotate(third)].map(corner),
                radiance: self.sent_on(index).element_sum(),
            }
        };
        let points = self.points.as_slice();
        Emitters::new(points.iter().enumerate().map(relay).collect(), points.len())
    }

    /// Radiance that a point sends on of what is emitted elsewhere.
    pub(super) fn sent_on(&self, point: usize) -> Vec3 {
        self.points.as_slice()[point].albedo * self.emitted_at(point) / PI
    }

    /// Irradiance of a point from what is emitted.
    pub(super) fn emitted_at(&self, point: usize) -> Vec3 {
        self.emitted_of(&self.irradiance[point * 3 * self.columns..])
    }

    /// The column of what is emitted.
    pub(super) fn emitted_of(&self, values: &[f32]) -> Vec3 {
        Vec3::from([1, 2, 3].map(|channel| values[channel * self.columns - 1]))
    }

    /// Whether surfaces get as much light of what emits that it shows where they reflect it: lamps are bright and small, so
    /// that what lies in other directions is far darker than all together.
    pub(crate) fn lit_by_lamps(&self) -> bool {
        let points = 0..self.points.as_slice().len();
        let count = 3.0 * points.len() as f32;
        let sent = points.map(|point| self.emitted_at(point).element_sum());
        self.surfaces.emit() && sent.sum::<f32>() > LIT_BY_LAMPS * PI * count
    }

    /// Adds a colour to the column of what is emitted.
    pub(super) fn add_emitted(&self, values: &mut [f32], color: Vec3) {
        if self.surfaces.emit() {
            for channel in 0..3 {
                values[(channel + 1) * self.columns - 1] += color[channel];
            }
        }
    }

    /// Adds what comes of what surfaces emit to the irradiance that a vertex gathered.
    pub(crate) fn add_irradiance(&self, outputs: &mut [f32], emitted: &Emitted) {
        for (values, color) in (outputs.chunks_exact_mut(3 * self.columns)).zip(emitted.0) {
            self.add_emitted(values, color);
        }
    }

    /// What a ray meets.
    pub(super) fn meet(&self, caster: &RayCaster, origin: Vec3, direction: Vec3) -> Option<Met> {
        let hit = caster.closest_hit(origin, direction)?;
        Some(self.surfaces.meet(hit.triangle, hit.barycentrics, origin))
    }

    /// Where the light is known that something a ray met sends on. No point may stand for it: for
    /// what lies in a slit, or is small. Then it is what a ray at random meets from there.
    pub(super) fn sender(&self, caster: &RayCaster, met: &Met, weight: f32, number: u32) -> Sender {
        let mut met = *met;
        let mut sender = Sender {
            end: End::Point(0),
            weight: met.albedo * weight,
            direct: true,
            emission: met.emission * weight,
            beyond: Vec3::ZERO,
        };
        for step in 0..MOST_STEPS {
            let number = hash(number, 11 * step);
            if let Some(point) = self.standing_at(caster, &met, number) {
                sender.end = End::Point(point as u32);
                return sender;
            }
            let origin = met.position + self.ray_offset * met.normal;
            let height = unit(hash(number, 6));
            let aside = height.sqrt() * self.aside(met.normal, hash(number, 7));
            let direction = (aside + (1.0 - height).sqrt() * met.normal).normalize();
            let Some(next) = self.meet(caster, origin, direction) else {
                sender.end = End::Sky(direction);
                return sender;
            };
            sender.direct = false;
            sender.beyond += sender.weight * next.emission;
            sender.weight *= next.albedo;
            met = next;
        }
        let nearest = self.points.nearest(met.position, met.normal);
        sender.end = End::Point(nearest.expect("there are points") as u32);
        sender
    }

    /// Divides triangles into cells so small that one point stands for all of each, and finds those that are one cell: they
    /// have one albedo.
    fn divide(&mut self) {
        let steps = |triangle: usize| {
            let [a, b, c] = self.surfaces.corners(triangle);
            let longest = (a.distance(b)).max(b.distance(c)).max(c.distance(a));
            let cell = BLUR * self.points.spacing_at((a + b + c) / 3.0);
            // What is no number has none.
            (longest / cell).ceil().clamp(1.0, f32::INFINITY)
        };
        let all = (0..self.surfaces.triangle_count()).into_par_iter();
        let steps: Vec<f32> = all.map(steps).collect();
        // Strands have as many cells as wide triangles, and there may be a million.
        let mut most = MOST_STEPS_A_SIDE;
        let within = |most: f32, steps: f32| if steps <= most { steps as u32 } else { 0 };
        let all_within = |most: f32| -> usize {
            let each = steps.iter().map(|&steps| within(most, steps) as usize);
            each.map(|steps| steps * steps).sum()
        };
        while most > 1.0 && all_within(most) > steps.len() + MOST_CELLS {
            most *= 0.5;
        }
        let mut cells = 0;
        self.cells = (steps.iter())
            .map(|&steps| {
                let steps = within(most, steps);
                let first = cells;
                cells += steps * steps;
                Cells { first, steps }
            })
            .collect();
        self.standing = (0..cells)
            .map(|_| [(); 2].map(|()| AtomicU32::new(UNKNOWN)))
            .collect();
        let small: Vec<bool> = steps.iter().map(|steps| *steps == 1.0).collect();
        self.surfaces.average(&small);
    }

    /// The point that stands for what a ray met; for all of a cell's side the same, found once.
    fn standing_at(&self, caster: &RayCaster, met: &Met, number: u32) -> Option<usize> {
        let Cells { first, steps } = self.cells[met.triangle];
        if steps == 0 {
            return self.standing_for(caster, met, number);
        }
        let [x, y] = [met.barycentrics.y, met.barycentrics.z]
            .map(|along| ((along * steps as f32) as u32).min(steps - 1));
        let cell = first + x * steps + y;
        let kept = &self.standing[cell as usize][usize::from(met.behind)];
        let mut stored = kept.load(Ordering::Relaxed);
        if stored == UNKNOWN {
            let [a, b, c] = self.surfaces.corners(met.triangle);
            let at = |right: f32, up: f32| {
                let [y, z] = [x as f32 + right, y as f32 + up].map(|at| at / steps as f32);
                a * (1.0 - y - z) + b * y + c * z
            };
            let middle = Met {
                position: at(1.0 / 3.0, 1.0 / 3.0),
                ..*met
            };
            // Squares, but for those at the triangle's third side.
            let last = if x + y + 1 < steps {
                at(1.0, 1.0)
            } else {
                at(0.5, 0.5)
            };
            let corners = [at(0.0, 0.0), at(1.0, 0.0), at(0.0, 1.0), last];
            // Small triangles lie on one side for the most part.
            stored = if steps > 1 && self.is_parted(caster, &middle, corners) {
                PARTED
            } else {
                let side = 2 * cell + u32::from(met.behind);
                let point = self.standing_for(caster, &middle, hash(side, 12));
                point.map_or(NONE, |point| point as u32)
            };
            kept.store(stored, Ordering::Relaxed);
        }
        match stored {
            PARTED => self.standing_for(caster, met, number),
            NONE => None,
            point => Some(point as usize),
        }
    }

    /// Whether something passes between the middle of a cell and its corners.
    fn is_parted(&self, caster: &RayCaster, middle: &Met, corners: [Vec3; 4]) -> bool {
        let above = self.ray_offset * middle.normal;
        let from = middle.position + above;
        (corners.into_iter()).any(|corner| caster.blocked(from, corner + above))
    }

    /// The point that stands for what a ray met: one of those about it, by chance, that has the
    /// same side and from which nothing parts it.
    fn standing_for(&self, caster: &RayCaster, met: &Met, number: u32) -> Option<usize> {
        let spacing = self.points.spacing_at(met.position);
        let radius = BLUR * spacing * unit(hash(number, 1)).sqrt();
        let aside = radius * self.aside(met.normal, hash(number, 2));
        let across = met.normal.cross(aside);
        let places = PLACES.map(|[along, turned]| met.position + along * aside + turned * across);
        let mut tried = [usize::MAX; PLACES.len()];
        places.into_iter().enumerate().find_map(|(at, place)| {
            let index = (self.points).nearest_alike(place, met.normal, REACH + BLUR, ALIKE)?;
            // Most often the same as at the last place.
            if tried[..at].contains(&index) {
                return None;
            }
            tried[at] = index;
            let point = &self.points.as_slice()[index];
            let distance = point.position.distance(met.position);
            let near = distance < REACH * spacing && point.geometric_normal.dot(met.normal) > ALIKE;
            let clearance = self.clearances[index];
            let alike =
                || distance < UNCHANGED * clearance || self.is_close(caster, met, clearance);
            (near && alike() && !self.parted(caster, met, index)).then_some(index)
        })
    }

    /// A direction along a surface, by chance, of unit length.
    fn aside(&self, normal: Vec3, bits: u32) -> Vec3 {
        let (x, y) = normal.any_orthonormal_pair();
        let turn = self.turns[(bits >> 8) as usize % TURNS];
        turn.x * x + turn.y * y
    }

    /// `count` directions over the hemisphere about `normal`, evenly in solid angle (a Fibonacci
    /// spiral), turned by chance; at most as many as points or vertices have rays.
    pub(super) fn hemisphere(
        &self,
        normal: Vec3,
        count: u32,
        seed: u32,
    ) -> impl Iterator<Item = HemisphereRay> {
        let (x, y) = normal.any_orthonormal_pair();
        let turn = turned(2.0 * PI * unit(hash(seed, 3)));
        let shift = unit(hash(seed, 4));
        (0..count).zip(&self.spiral).map(move |(i, along)| {
            let cosine = (i as f32 + shift) / count as f32;
            let sine = (1.0 - cosine * cosine).max(0.0).sqrt();
            let aside = sine * turn.rotate(*along);
            HemisphereRay {
                direction: (normal * cosine + aside.x * x + aside.y * y).normalize(),
                cosine,
                number: hash(seed, 5 + i),
            }
        })
    }

    /// Whether something is this close above what a ray met.
    fn is_close(&self, caster: &RayCaster, met: &Met, clearance: f32) -> bool {
        let along = |height: f32| met.position + height * met.normal;
        caster.blocked(along(self.ray_offset), along(clearance))
    }

    /// Whether something stands between what a ray met and a point: the other side of a wall or of
    /// a board on it has other light.
    fn parted(&self, caster: &RayCaster, met: &Met, point: usize) -> bool {
        let point = &self.points.as_slice()[point];
        // Above the surface, which may be round.
        let above = self.ray_offset + ABOVE * met.position.distance(point.position);
        caster.blocked(
            met.position + above * met.normal,
            point.position + above * point.geometric_normal,
        )
    }

    /// What a sender's light is known as, per channel `columns` numbers, and what that counts: its
    /// radiance but for what is emitted on the way. `values` hold what is not known beforehand.
    pub(super) fn radiance<'a>(
        &'a self,
        sender: &Sender,
        values: &'a mut [f32],
    ) -> (&'a [f32], Vec3) {
        match sender.end {
            End::Point(point) => {
                let length = 3 * self.columns;
                let known = &self.irradiance[point as usize * length..][..length];
                (known, sender.weight / PI)
            }
            End::Sky(direction) => {
                values.fill(0.0);
                self.harmonics.evaluate(direction, values);
                for (value, blur) in values.iter_mut().zip(&self.blurs) {
                    *value *= blur;
                }
                values.copy_within(..self.columns, self.columns);
                values.copy_within(..self.columns, 2 * self.columns);
                (values, sender.weight)
            }
        }
    }

    /// Numbers per channel.
    pub(crate) fn columns(&self) -> usize {
        self.columns
    }

    /// Of the asset, before any chunk is in it.
    pub(crate) fn head(&self, order: u32) -> relight_format::Transfer {
        relight_format::Transfer {
            order,
            emitted: self.surfaces.emit(),
            bounces: self.bounces,
            last_bounce: self.last_bounce,
            ..Default::default()
        }
    }

    /// Rays cast between points.
    pub(crate) fn rays(&self) -> u64 {
        self.rays
    }
}

/// One of the rays over a hemisphere.
pub(super) struct HemisphereRay {
    pub direction: Vec3,
    /// Of the angle to the normal.
    pub cosine: f32,
    /// Of this ray among all rays of all points.
    pub number: u32,
}

/// The golden angle, radians: what a Fibonacci spiral turns by.
const GOLDEN: f32 = 2.399_963_2;

fn turned(angle: f32) -> Vec2 {
    let (sine, cosine) = math::sin_cos(angle);
    Vec2::new(cosine, sine)
}

/// Adds values per channel, times its weight. Inlined into what is compiled for the processor.
#[inline(always)]
pub(super) fn add_colored(sums: &mut [f32], values: &[f32], weight: Vec3) {
    let columns = values.len() / 3;
    for (channel, weight) in weight.to_array().into_iter().enumerate() {
        let at = channel * columns..(channel + 1) * columns;
        for (sum, value) in sums[at.clone()].iter_mut().zip(&values[at]) {
            *sum += weight * value;
        }
    }
}

/// Limits what rays bring by way of surfaces that no point stands for: radiance, and what it counts of the
/// irradiance, whose sum over channels is `rest` without it.
pub(super) fn limit(beyond: &mut [(Vec3, f32)], rest: f32) {
    let whole = |sum, (radiance, weight): &(Vec3, f32)| sum + radiance.element_sum() * weight;
    let most = MOST_TIMES_MEAN / PI * beyond.iter().fold(rest, whole);
    for (radiance, _) in beyond {
        *radiance *= (most / radiance.element_sum()).min(1.0);
    }
}

/// A 32-bit hash of two numbers (PCG output function, O'Neill 2014).
pub(super) fn hash(a: u32, b: u32) -> u32 {
    let mut x = a.wrapping_mul(0x9e37_79b9) ^ b.wrapping_mul(0x85eb_ca6b).rotate_left(16);
    x = x.wrapping_mul(747_796_405).wrapping_add(2_891_336_453);
    x = ((x >> ((x >> 28) + 4)) ^ x).wrapping_mul(277_803_737);
    (x >> 22) ^ x
}

pub(super) fn unit(bits: u32) -> f32 {
    (bits >> 8) as f32 / 16_777_216.0
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::import::plain_material;
    use crate::mesh::{Mesh, Triangle, Vertex};
    use crate::monitor::SILENT;
    use crate::transfer::gather::Receiver;
    use relight_format::{Specular, Surface};

    /// Squares by corner and two edges, front towards their cross product.
    pub(crate) fn squares(squares: &[[Vec3; 3]], albedo: f32, emission: f32) -> Mesh {
        let mut mesh = Mesh::default();
        for [corner, u, v] in squares {
            let normal = u.cross(*v).normalize();
            let base = mesh.vertices.len() as u32;
            for (s, t) in [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)] {
                mesh.vertices.push(Vertex {
                    position: *corner + s * *u + t * *v,
                    normal,
                    tangent: u.normalize(),
                    bitangent_sign: 1.0,
                    uv: Vec2::new(s, t),
                    second_uv: Vec2::ZERO,
                });
            }
            for vertices in [[0, 1, 2], [0, 2, 3]] {
                mesh.triangles.push(Triangle {
                    vertices: vertices.map(|i| base + i),
                    material: 0,
                });
            }
        }
        let surface = Surface::DiffuseSpecular {
            diffuse: [albedo; 3],
            specular: Specular::None,
        };
        mesh.materials.push(plain_material("wall", surface));
        mesh.materials[0].emission = [emission; 3];
        mesh
    }

    /// Adds a mesh with its material.
    pub(crate) fn join(mesh: &mut Mesh, other: Mesh) {
        let base = mesh.vertices.len() as u32;
        let material = mesh.materials.len() as u16;
        mesh.vertices.extend(other.vertices);
        let triangles = other.triangles.iter().map(|triangle| Triangle {
            vertices: triangle.vertices.map(|vertex| base + vertex),
            material: material + triangle.material,
        });
        mesh.triangles.extend(triangles);
        mesh.materials.extend(other.materials);
    }

    pub(crate) fn solve(mesh: &Mesh, bounces: Option<u32>) -> (Radiosity, RayCaster) {
        let caster = RayCaster::new(&mesh.soup());
        let options = Options {
            bounces,
            points: 600,
            ..Options::standard()
        };
        let surfaces = Surfaces::new(mesh);
        let sizes = SizeFunction::even(mesh.diagonal());
        let solved = Radiosity::new(surfaces, &caster, &options, (&sizes, 1e-4), SILENT);
        (solved.unwrap().expect("light bounces"), caster)
    }

    #[test]
    fn in_a_white_furnace_everything_is_white() {
        // A floor and a wall: what is not sky is as bright as the sky.
        let mesh = squares(
            &[
                [Vec3::ZERO, Vec3::Z, Vec3::X],
                [Vec3::ZERO, Vec3::Y, Vec3::Z],
            ],
            1.0,
            0.0,
        );
        let (solved, _) = solve(&mesh, Some(64));
        for point in solved.irradiance.chunks_exact(3 * solved.columns) {
            // Of a sky of radiance 1, whose first coefficient is √(4π).
            let irradiance = point[0] * (4.0 * PI).sqrt();
            // 256 rays, all of one hemisphere: the sum of cosines is off by less.
            assert!((irradiance / PI - 1.0).abs() < 0.02, "{irradiance}");
        }
    }

    /// A floor and a wall of so many squares along each side.
    fn corner_of(n: usize) -> Mesh {
        let step = 1.0 / n as f32;
        let at = |i: usize| [(i % n) as f32 * step, (i / n) as f32 * step];
        let floor = (0..n * n).map(|i| {
            let [x, z] = at(i);
            [Vec3::new(x, 0.0, z), step * Vec3::Z, step * Vec3::X]
        });
        let wall = (0..n * n).map(|i| {
            let [y, z] = at(i);
            [Vec3::new(0.0, y, z), step * Vec3::Y, step * Vec3::Z]
        });
        squares(&floor.chain(wall).collect::<Vec<_>>(), 0.5, 0.0)
    }

    #[test]
    fn one_point_stands_for_all_of_a_small_triangle() {
        // Squares wider than what one point stands for, and many times narrower.
        let [coarse, fine] = [4, 60].map(|n| solve(&corner_of(n), Some(64)));
        let stored = |solved: &Radiosity| -> Vec<u32> {
            let sides = solved.standing.iter();
            sides
                .map(|[front, _]| front.load(Ordering::Relaxed))
                .collect()
        };
        let steps = |solved: &Radiosity| -> Vec<u32> {
            let cells = solved.cells.iter();
            cells.map(|cells| cells.steps).collect()
        };
        assert!(steps(&coarse.0).iter().all(|&steps| steps == 0));
        assert!(steps(&fine.0).iter().all(|&steps| steps == 1));
        let (solved, caster) = &fine;
        let points = solved.points.as_slice();
        let mut known = 0;
        for (triangle, stored) in stored(solved).into_iter().enumerate() {
            assert!(stored != NONE);
            if let Some(point) = points.get(stored as usize) {
                known += 1;
                let [corner, ..] = solved.surfaces.corners(triangle);
                let reach = (REACH + BLUR) * solved.points.spacing_at(corner);
                assert!(point.position.distance(corner) < reach);
                let up = corner + point.geometric_normal;
                let met = solved.surfaces.meet(triangle, Vec3::splat(1.0 / 3.0), up);
                let again = solved.standing_at(caster, &met, triangle as u32);
                assert_eq!(again, Some(stored as usize));
            }
        }
        assert!(known > 1000, "{known}");
        // The light is the same.
        let [one, other] = [&coarse, &fine].map(|(solved, caster)| {
            let light = |i: u32| {
                let receiver = Receiver {
                    origin: Vec3::new(0.05 + 0.03 * i as f32, 1e-4, 0.5),
                    normal: Vec3::Y,
                };
                gathered_at(solved, caster, &receiver)[3 * solved.columns]
            };
            (0..30).map(light).sum::<f32>()
        });
        assert!((one / other - 1.0).abs() < 0.03, "{one} {other}");
    }

    #[test]
    fn one_point_stands_for_all_of_a_cell_of_a_larger_triangle() {
        let (solved, caster) = solve(&corner_of(8), Some(64));
        let points = solved.points.as_slice();
        let mut cells = 0;
        for triangle in 0..solved.surfaces.triangle_count() {
            let steps = solved.cells[triangle].steps;
            let [corner, ..] = solved.surfaces.corners(triangle);
            let eye = corner + 0.5 * Vec3::ONE;
            for (x, y) in (0..steps).flat_map(|x| (0..steps - x).map(move |y| (x, y))) {
                let met = |[u, v]: [f32; 2]| {
                    let [y, z] = [x as f32 + u, y as f32 + v].map(|along| along / steps as f32);
                    (solved.surfaces).meet(triangle, Vec3::new(1.0 - y - z, y, z), eye)
                };
                let (one, other) = (met([0.1, 0.3]), met([0.4, 0.2]));
                let found = solved.standing_at(&caster, &one, 2 * triangle as u32);
                let again = solved.standing_at(&caster, &other, 2 * triangle as u32 + 1);
                assert_eq!(found, again, "{triangle}: {x} {y}");
                let point = &points[found.expect("nothing parts them")];
                let reach = (REACH + 2.0 * BLUR) * solved.points.spacing_at(corner);
                assert!(point.position.distance(one.position) < reach);
                assert!(point.geometric_normal.dot(one.normal) > ALIKE);
                cells += 1;
            }
        }
        assert!(cells > 500, "{cells}");
    }

    #[test]
    fn what_passes_through_a_wall_has_points_on_either_side() {
        // A shelf through a wall of two sides, in whose plane no side of a cell lies.
        let (x, y, z) = (Vec3::X, Vec3::Y, Vec3::Z);
        let low = Vec3::new(0.53, -1.0, -1.0);
        let wall = [low, 3.0 * y, 3.0 * z];
        let shelf = [Vec3::new(0.4, 0.0, 0.4), 0.3 * z, 0.3 * x];
        let mesh = squares(&[shelf, wall, [low, wall[2], wall[1]]], 0.5, 0.0);
        let (solved, caster) = solve(&mesh, Some(64));
        let mut beside = 0;
        for triangle in 0..2 {
            assert!(solved.cells[triangle].steps > 1);
            for number in 0..4096 {
                let [u, v] = [1, 2].map(|turn| unit(hash(number, turn)));
                let weights = Vec3::new(1.0 - u.max(v), u.min(v), (u - v).abs());
                let met = solved.surfaces.meet(triangle, weights, 2.0 * y);
                let Some(point) = solved.standing_at(&caster, &met, number) else {
                    continue;
                };
                assert!(!solved.parted(&caster, &met, point), "{}", met.position);
                beside += usize::from((met.position.x - low.x).abs() < 0.05);
            }
        }
        assert!(beside > 100, "{beside}");
    }

    /// All that arrives at a place.
    fn gathered_at(solved: &Radiosity, caster: &RayCaster, receiver: &Receiver) -> Vec<f32> {
        let mut gathered = solved.gather(caster, receiver, 128, true, |_| false);
        solved.add_irradiance(&mut gathered.outputs, &gathered.lamps);
        gathered.outputs
    }

    #[test]
    fn a_glowing_room_lights_itself() {
        // Six walls of albedo ½ that emit 1: E = π + ½ E everywhere.
        let (o, x, y, z) = (Vec3::ZERO, Vec3::X, Vec3::Y, Vec3::Z);
        let walls = [
            [o, z, x],
            [o, x, y],
            [o, y, z],
            [y, x, z],
            [z, y, x],
            [x, z, y],
        ];
        let (solved, caster) = solve(&squares(&walls, 0.5, 1.0), None);
        assert!(solved.bounces > 6, "{}", solved.bounces);
        assert!(solved.lit_by_lamps());
        let (faint, _) = solve(&squares(&walls, 0.5, 0.005), None);
        assert!(faint.surfaces.emit() && !faint.lit_by_lamps());
        let mut mean = 0.0;
        let count = 40;
        for i in 0..count {
            let receiver = Receiver {
                origin: Vec3::new(0.1 + 0.02 * i as f32, 1e-4, 0.4),
                normal: y,
            };
            let gathered = gathered_at(&solved, &caster, &receiver);
            let block = 3 * solved.columns;
            mean += gathered[block + solved.columns - 1] / count as f32;
            // No light from outside.
            assert!(gathered[block].abs() < 1e-6);
        }
        // A few per cent of what 32 rays to emitters miss, over 40 places.
        assert!((mean / (2.0 * PI) - 1.0).abs() < 0.03, "{mean}");
    }

    #[test]
    fn bounces_end_where_rooms_are_bright_enough_too() {
        // A room of 1 m of albedo .9 whose lid leaves a tenth open, beside a floor of 6 m that has most of all light.
        let (o, x, y, z) = (Vec3::new(4.0, 0.0, 0.0), Vec3::X, Vec3::Y, Vec3::Z);
        let mesh = squares(
            &[
                [Vec3::new(-3.0, 0.0, -3.0), 6.0 * z, 6.0 * x],
                [o, z, x],
                [o, x, y],
                [o, y, z],
                [o + y, 0.9 * x, z],
                [o + z, y, x],
                [o + x, z, y],
            ],
            0.9,
            0.0,
        );
        let [found, all] = [None, Some(64)].map(|bounces| {
            let (solved, _) = solve(&mesh, bounces);
            let length = 3 * solved.columns;
            let within = |point: &Point| point.position.x > 3.9;
            let points =
                (solved.points.as_slice().iter()).zip(solved.irradiance.chunks_exact(length));
            let inside: Vec<f32> = points
                .filter_map(|(point, light)| within(point).then_some(light[0]))
                .collect();
            assert!(inside.len() > 50, "{}", inside.len());
            inside.iter().sum::<f32>() / inside.len() as f32
        });
        assert!(found < all && found > 0.99 * all, "{found} of {all}");
    }

    #[test]
    fn what_glows_lights_the_floor_without_noise() {
        // A black floor of 6 m, and above it a box that glows.
        let (half, height, radiance) = (0.15, 0.8, 3.0);
        let (x, y, z) = (
            2.0 * half * Vec3::X,
            2.0 * half * Vec3::Y,
            2.0 * half * Vec3::Z,
        );
        let low = Vec3::new(-half, height - half, -half);
        let mut all = squares(
            &[
                [low, x, z],
                [low + y, z, x],
                [low, z, y],
                [low + x, y, z],
                [low, y, x],
                [low + z, x, y],
            ],
            0.0,
            radiance,
        );
        let corner = Vec3::new(-3.0, 0.0, -3.0);
        let floor = squares(&[[corner, 6.0 * Vec3::Z, 6.0 * Vec3::X]], 0.0, 0.0);
        join(&mut all, floor);
        let (solved, caster) = solve(&all, None);
        let block = 3 * solved.columns;
        for i in 0..60 {
            let place = Vec3::new(0.03 * i as f32, 1e-4, 0.01 * i as f32);
            let receiver = Receiver {
                origin: place,
                normal: Vec3::Y,
            };
            // All of it comes straight from the box, and is kept apart from what is smoothed.
            let others = solved.gather(&caster, &receiver, 128, true, |_| false);
            assert_eq!(others.outputs[block + solved.columns - 1], 0.0);
            let gathered = gathered_at(&solved, &caster, &receiver);
            let found = gathered[block + solved.columns - 1];
            // Lambert's formula, over the edges of the faces that look at the place.
            let face = |corners: [Vec3; 4]| -> f32 {
                let directions = corners.map(|at| (at - place).normalize());
                let edge = |i: usize| {
                    let (a, b) = (directions[i], directions[(i + 1) % 4]);
                    math::acos(a.dot(b)) * a.cross(b).normalize_or_zero().y
                };
                0.5 * radiance * (0..4).map(edge).sum::<f32>()
            };
            let corners = [
                [low, x, z],
                [low, z, y],
                [low + x, y, z],
                [low, y, x],
                [low + z, x, y],
            ];
            let expected: f32 = (corners.iter())
                .filter(|[at, u, v]| u.cross(*v).dot(place - *at) > 0.0)
                .map(|[at, u, v]| face([*at, *at + *v, *at + *u + *v, *at + *u]).abs())
                .sum();
            assert!(
                (found / expected - 1.0).abs() < 0.05,
                "{place}: {found} for {expected}"
            );
        }
    }

    #[test]
    fn light_does_not_leak_into_slits() {
        // A white floor of 4 m under the sky, and on it a low box that is open at one end only: what
        // lies inside gets next to nothing, though points of the bright floor are near.
        let (o, x, y, z) = (Vec3::new(1.5, 0.0, 1.5), Vec3::X, Vec3::Y, Vec3::Z);
        let high = 0.05 * y;
        let mesh = squares(
            &[
                [Vec3::ZERO, 4.0 * z, 4.0 * x],
                // Top from below and above, three sides.
                [o + high, x, z],
                [o + 1.2 * high, z, x],
                [o, z, high],
                [o, high, x],
                [o + x, high, z],
            ],
            0.9,
            0.0,
        );
        let (solved, caster) = solve(&mesh, None);
        let receiver = Receiver {
            origin: Vec3::new(2.0, 1e-4, 1.55),
            normal: Vec3::Y,
        };
        let block = 3 * solved.columns;
        let inside = gathered_at(&solved, &caster, &receiver);
        let inside = inside[block];
        // What the open floor gets of the sky in the first harmonic, which is constant.
        let outside = PI * (0.25 / PI).sqrt();
        assert!(inside < 0.1 * outside, "{inside} of {outside}");
    }

    #[test]
    fn light_does_not_leak_out_of_slits() {
        // A lamp of 1 m, 4 mm below a ceiling: next to nothing of what its upper side emits gets out.
        let (x, y, z) = (Vec3::X, Vec3::Y, Vec3::Z);
        let room = [[Vec3::ZERO, 4.0 * z, 4.0 * x], [2.0 * y, 4.0 * x, 4.0 * z]];
        let corner = Vec3::new(1.5, 1.996, 1.5);
        let [dark, lit] = [0.0, 10.0].map(|above| {
            let mut mesh = squares(&room, 0.5, 0.0);
            join(&mut mesh, squares(&[[corner, x, z]], 0.5, 10.0));
            join(&mut mesh, squares(&[[corner, z, x]], 0.5, above));
            let (solved, caster) = solve(&mesh, None);
            let block = 3 * solved.columns;
            let count = 40;
            let at = |i| Vec3::new(0.2 + 0.09 * i as f32, 1e-4, 1.1);
            let receivers = (0..count).map(|i| Receiver {
                origin: at(i),
                normal: y,
            });
            let gathered = receivers.map(|receiver| gathered_at(&solved, &caster, &receiver));
            let found: Vec<f32> = gathered
                .map(|gathered| gathered[block + solved.columns - 1])
                .collect();
            found.iter().sum::<f32>() / count as f32
        });
        assert!((lit / dark - 1.0).abs() < 0.03, "{lit} for {dark}");
    }

    #[test]
    fn without_bounces_there_is_nothing() {
        let mesh = squares(&[[Vec3::ZERO, Vec3::Z, Vec3::X]], 0.5, 0.0);
        let caster = RayCaster::new(&mesh.soup());
        let surfaces = Surfaces::new(&mesh);
        let options = Options::standard();
        let sizes = SizeFunction::even(1.0);
        let solved = Radiosity::new(surfaces, &caster, &options, (&sizes, 1e-4), SILENT);
        assert!(solved.unwrap().is_none());
    }
}
