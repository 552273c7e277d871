//! Points -> what is seen from them, and its SSDF: the loop that refinement and the bake
//! share.

use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use glam::Vec3;
use rayon::prelude::*;

use super::DistanceTransform;
use crate::visibility::contour::{ContourMesh, Lent, RUNS, Scratch};
use crate::visibility::{self, Bitmap, Crossings, Directions, arrange};

/// What is seen from a point.
pub(crate) struct Sampled<'a> {
    pub origin: Vec3,
    pub visible: &'a Bitmap,
    pub crossings: &'a Crossings,
    /// The SSDF, radians.
    pub distances: Vec<f32>,
}

/// Samples points at one pair of resolutions, and counts what that takes.
pub(crate) struct Sampler {
    directions: Directions,
    transform: DistanceTransform,
    /// SSDFs are clamped to ± this angle, radians.
    clamp: f32,
    /// Whether a ray is cast in every direction, in place of contours.
    by_rays: bool,
    rays: AtomicU64,
    visibility_nanoseconds: AtomicU64,
    ssdf_nanoseconds: AtomicU64,
}

impl Sampler {
    /// For visibility of `samples` and SSDFs of `resolution` texels per side.
    pub(crate) fn new(samples: u32, resolution: u32, clamp: f32) -> Self {
        let directions = Directions::new(samples);
        Self {
            transform: DistanceTransform::new(&directions, resolution),
            directions,
            clamp,
            by_rays: false,
            rays: AtomicU64::default(),
            visibility_nanoseconds: AtomicU64::default(),
            ssdf_nanoseconds: AtomicU64::default(),
        }
    }

    /// Casts a ray in every direction in place of looking at contours: of little resolution that takes less time where there is
    /// much clutter. Boundaries lie midway between directions then.
    pub(crate) fn by_rays(mut self, by_rays: bool) -> Self {
        self.by_rays = by_rays;
        self
    }

    /// Of the bitmaps' texels.
    pub(crate) fn directions(&self) -> &Directions {
        &self.directions
    }

    /// From bitmaps to SSDFs.
    pub(crate) fn transform(&self) -> &DistanceTransform {
        &self.transform
    }

    /// Rays cast.
    pub(crate) fn rays(&self) -> u64 {
        self.rays.load(Ordering::Relaxed)
    }

    /// Processor time of visibility and of its transform.
    pub(crate) fn times(&self) -> [Duration; 2] {
        [&self.visibility_nanoseconds, &self.ssdf_nanoseconds]
            .map(|counter| Duration::from_nanos(counter.load(Ordering::Relaxed)))
    }

    /// Forgets rays and times.
    pub(crate) fn reset(&mut self) {
        self.rays = AtomicU64::default();
        self.visibility_nanoseconds = AtomicU64::default();
        self.ssdf_nanoseconds = AtomicU64::default();
    }

    /// Samples points, those close together one after the other, and hands over for each what
    /// is seen from there, from many threads and in no particular order. Stops at the first
    /// error.
    pub(crate) fn sample<T: Send, E: Send>(
        &self,
        contours: &ContourMesh,
        points: Vec<(Vec3, T)>,
        hand_over: impl Fn(&mut T, Sampled) -> Result<(), E> + Sync,
    ) -> Result<(), E> {
        let mut points: Vec<(u32, Vec3, T)> = (0..)
            .zip(points)
            .map(|(number, (origin, for_whom))| (number, origin, for_whom))
            .collect();
        arrange(&mut points, &RUNS, &|(number, origin, _)| {
            (origin.to_array(), *number)
        });
        points.par_chunks_mut(RUNS[0]).try_for_each_init(
            || self.scratch(contours),
            |scratch, group| {
                let origins: Vec<Vec3> = group.iter().map(|(_, origin, _)| *origin).collect();
                self.sample_group(contours, scratch, &origins, |index, sampled| {
                    hand_over(&mut group[index].2, sampled)
                })
            },
        )
    }

    /// Memory for samples of a group.
    pub(crate) fn scratch<'a>(&self, contours: &'a ContourMesh) -> Lent<'a> {
        contours.scratch(&self.directions)
    }

    /// Samples a group of points that lie close together, by this thread alone, and hands over for each its number
    /// and what is seen from there.
    pub(crate) fn sample_group<E>(
        &self,
        contours: &ContourMesh,
        scratch: &mut Scratch,
        origins: &[Vec3],
        mut hand_over: impl FnMut(usize, Sampled) -> Result<(), E>,
    ) -> Result<(), E> {
        if !self.by_rays {
            let start = Instant::now();
            contours.prepare(origins, scratch);
            add_time(&self.visibility_nanoseconds, start);
        }
        (origins.iter().enumerate()).try_for_each(|(index, &origin)| {
            self.sample_one(contours, origin, scratch, |sampled| {
                hand_over(index, sampled)
            })
        })
    }

    fn sample_one<E>(
        &self,
        contours: &ContourMesh,
        origin: Vec3,
        scratch: &mut Scratch,
        hand_over: impl FnOnce(Sampled) -> Result<(), E>,
    ) -> Result<(), E> {
        let start = Instant::now();
        let (visible, rays) = if self.by_rays {
            let rays = self.directions.as_slice().len() as u32;
            let visible = visibility::sample(contours.caster(), origin, &self.directions);
            (visible, rays)
        } else {
            contours.sample(origin, &self.directions, scratch)
        };
        add_time(&self.visibility_nanoseconds, start);
        self.rays.fetch_add(u64::from(rays), Ordering::Relaxed);
        let start = Instant::now();
        let unknown = Crossings::default();
        let crossings = if self.by_rays {
            &unknown
        } else {
            contours.crossings(&visible, scratch)
        };
        let distances = self.transform.apply(&visible, crossings, self.clamp);
        add_time(&self.ssdf_nanoseconds, start);
        hand_over(Sampled {
            origin,
            visible: &visible,
            crossings,
            distances,
        })
    }
}

fn add_time(counter: &AtomicU64, start: Instant) {
    counter.fetch_add(start.elapsed().as_nanos() as u64, Ordering::Relaxed);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rays_and_contours_see_the_same() {
        let p = Vec3::new;
        let square = |y: f32| [p(-1.0, y, -1.0), p(-1.0, y, 1.0), p(1.0, y, 0.3)];
        let contours = ContourMesh::new(&[square(0.3), square(-0.2)]);
        let points = || vec![(p(0.1, 0.02, -0.2), ()), (p(0.4, 0.1, 0.7), ())];
        let found = |by_rays: bool| {
            let sampler = Sampler::new(32, 32, 0.5).by_rays(by_rays);
            let seen = std::sync::Mutex::new(Vec::new());
            let result: Result<(), ()> = sampler.sample(&contours, points(), |(), sampled| {
                let known = !sampled.crossings.positions.is_empty();
                let origin = sampled.origin.to_array().map(f32::to_bits);
                let mut seen = seen.lock().unwrap();
                seen.push((origin, sampled.visible.clone(), sampled.distances, known));
                Ok(())
            });
            result.unwrap();
            let mut seen = seen.into_inner().unwrap();
            seen.sort_by_key(|(origin, ..)| *origin);
            (seen, sampler.rays())
        };
        let ((rays, cast), (contours, few)) = (found(true), found(false));
        assert!(cast == 2 * 32 * 32 && few < 200, "{cast} {few}");
        for (ray, contour) in rays.iter().zip(&contours) {
            assert_eq!((ray.0, &ray.1), (contour.0, &contour.1));
            assert!(!ray.3 && contour.3);
            // A texel is a tenth of a radian wide.
            let apart = ray.2.iter().zip(&contour.2).map(|(a, b)| (a - b).abs());
            assert!(apart.fold(0.0, f32::max) < 0.1);
        }
    }
}
