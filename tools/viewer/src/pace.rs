//! In which pictures a request is answered: a draft at once, then better ones while nobody asks for
//! anything else.

use std::collections::HashMap;
use std::time::Duration;

use crate::state::Integrator;

/// How long the first pictures of a request may take together.
const FIRST: Duration = Duration::from_millis(45);
/// How long the first ones by the methods that are asked for may take, after drafts.
const SECOND: Duration = Duration::from_millis(250);
/// Pixels of the first draft, and of the smallest one: less says nothing, neither to those who look
/// nor about what others will take.
const FEWEST_PIXELS: f64 = 700.0;
/// Factors by which the size of drafts goes with the time of the last one, at least and at most:
/// times vary with what is in sight and with who else computes.
const STEPS: (f64, f64) = (0.1, 3.0);
/// A picture a little smaller than the best is not worth drawing before it.
const ALMOST: f32 = 0.7;

/// One picture of every shot of a request.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Level {
    /// By the cheapest means, whatever was asked for.
    pub draft: bool,
    /// Of the best picture's width.
    pub scale: f32,
}

impl Level {
    /// The best there is.
    pub const BEST: Self = Self {
        draft: false,
        scale: 1.0,
    };

    /// Size of its pictures, where the best one has this size.
    pub fn size(self, best: [u32; 2]) -> [u32; 2] {
        best.map(|side| ((side as f32 * self.scale).round() as u32).max(1))
    }
}

/// What pictures took so far.
#[derive(Clone, Debug)]
pub struct Pace {
    /// Seconds per pixel.
    rates: HashMap<Integrator, f64>,
    /// Pixels of the next draft.
    draft_pixels: f64,
}

impl Default for Pace {
    fn default() -> Self {
        Self {
            rates: HashMap::new(),
            draft_pixels: FEWEST_PIXELS,
        }
    }
}

impl Pace {
    /// Seconds that the best pictures will take; infinity where nothing is known.
    fn best(&self, integrators: &[Integrator], size: [u32; 2]) -> f64 {
        let rate = |integrator| self.rates.get(integrator).copied().unwrap_or(f64::INFINITY);
        integrators.iter().map(rate).sum::<f64>() * pixels(size)
    }

    /// Seconds per pixel, where they are known.
    pub fn rate(&self, integrator: Integrator) -> Option<f64> {
        self.rates.get(&integrator).copied()
    }

    /// What a request begins with.
    pub fn first(&self, integrators: &[Integrator], size: [u32; 2]) -> Level {
        if self.best(integrators, size) <= FIRST.as_secs_f64() {
            return Level::BEST;
        }
        let scale = (self.draft_pixels / pixels(size)).sqrt() as f32;
        Level {
            draft: true,
            scale: scale.min(1.0),
        }
    }

    /// What follows; `None` after the best.
    pub fn next(&self, level: Level, integrators: &[Integrator], size: [u32; 2]) -> Option<Level> {
        if level == Level::BEST {
            return None;
        }
        let scale = if level.draft {
            let scale = (SECOND.as_secs_f64() / self.best(integrators, size)).sqrt() as f32;
            scale.max(level.scale)
        } else {
            2.0 * level.scale
        };
        Some(Level {
            draft: false,
            scale: if scale > ALMOST { 1.0 } else { scale },
        })
    }

    /// Learns from a picture of this size by one of `count` shots.
    pub fn note(
        &mut self,
        level: Level,
        integrator: Integrator,
        size: [u32; 2],
        seconds: f64,
        count: usize,
    ) {
        let pixels = pixels(size);
        if level.draft {
            let budget = FIRST.as_secs_f64() / count.max(1) as f64;
            let step = (budget / seconds.max(1e-6)).clamp(STEPS.0, STEPS.1);
            self.draft_pixels = (pixels * step).max(FEWEST_PIXELS);
        } else {
            self.rates.insert(integrator, seconds / pixels);
        }
    }
}

fn pixels([width, height]: [u32; 2]) -> f64 {
    f64::from(width) * f64::from(height)
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZE: [u32; 2] = [1280, 800];
    const POLAR: [Integrator; 1] = [Integrator::Polar];

    /// A device that takes `fixed` seconds for a picture and `rate` for each of its pixels, four
    /// times as much where it is no draft: seconds to the first picture, and to each after it.
    fn times(pace: &mut Pace, fixed: f64, rate: f64, shots: &[Integrator]) -> Vec<f64> {
        let mut times = Vec::new();
        let mut level = Some(pace.first(shots, SIZE));
        while let Some(now) = level {
            let size = now.size(SIZE);
            let mut sum = 0.0;
            for integrator in shots {
                let factor = if now.draft { 1.0 } else { 4.0 };
                let seconds = fixed + factor * rate * pixels(size);
                pace.note(now, *integrator, size, seconds, shots.len());
                sum += seconds;
            }
            times.push(sum);
            level = pace.next(now, shots, SIZE);
        }
        times
    }

    #[test]
    fn slow_devices_answer_in_time_and_end_with_the_best() {
        // 1,000 seconds a picture at worst: as many processors have it.
        for (fixed, rate) in [(0.0, 5e-5), (0.01, 2e-5), (0.02, 1e-6), (0.0, 1e-4)] {
            for shots in [&POLAR[..], &[Integrator::Polar, Integrator::Cells]] {
                let mut pace = Pace::default();
                let mut last = Vec::new();
                for _ in 0..8 {
                    last = times(&mut pace, fixed, rate, shots);
                }
                let most = 0.08 * shots.len() as f64;
                assert!(last[0] < most.max(2.0 * fixed), "{fixed} {rate}: {last:?}");
                assert!(last.len() > 1 && last.len() < 10, "{last:?}");
                assert!(last[1] < 1.5, "{fixed} {rate}: {last:?}");
            }
        }
    }

    #[test]
    fn fast_devices_draw_nothing_but_the_best() {
        let mut pace = Pace::default();
        times(&mut pace, 1e-3, 1e-9, &POLAR);
        assert_eq!(pace.first(&POLAR, SIZE), Level::BEST);
        assert_eq!(pace.next(Level::BEST, &POLAR, SIZE), None);
    }

    #[test]
    fn drafts_shrink_at_once_when_a_device_becomes_slow() {
        let mut pace = Pace::default();
        for _ in 0..8 {
            times(&mut pace, 0.0, 1e-6, &POLAR);
        }
        let before = pace.first(&POLAR, SIZE).scale;
        times(&mut pace, 0.0, 1e-5, &POLAR);
        let after = pace.first(&POLAR, SIZE).scale;
        assert!(after < 0.4 * before, "{before} {after}");
    }
}
