//! Places that stand for others -> what is seen from them, sampled once for all chunks that need it.
//!
//! Chunks that touch need what is seen from the same places on both sides of their border: where few places stand for many,
//! a third of all samples would be taken again.

use std::convert::Infallible;
use std::sync::OnceLock;

use glam::Vec3;
use rayon::prelude::*;

use super::sample::Prepared;
use crate::monitor::Interrupted;
use crate::visibility::arrange;
use crate::visibility::contour::RUNS;
use crate::visibility::sparse::Sparse;

/// Where what is kept would take more, each chunk samples what it needs.
const MOST_BYTES: usize = 256 << 20;

/// SSDFs of places in groups that are sampled together, which do not depend on who asks first.
#[derive(Default)]
pub(super) struct Kept {
    /// Group by group.
    places: Vec<u32>,
    /// Where each place of the scene is in `places`, if it is.
    number: Vec<u32>,
    /// Of each group, one place after the other.
    ssdfs: Vec<OnceLock<Vec<f32>>>,
    /// Places of a group.
    group: usize,
    texels: usize,
}

impl Kept {
    /// For those among the places that stand for others, with so many texels each. Samples `by_rays` have nothing in common, and few of
    /// them at a time keep all threads at work.
    pub(super) fn new(sparse: &Sparse, origins: &[Vec3], texels: usize, by_rays: bool) -> Self {
        let mut places = sparse.sources_of(0..origins.len() as u32);
        let bytes = places.len().saturating_mul(texels * size_of::<f32>());
        if places.len() == origins.len() || bytes > MOST_BYTES {
            return Self::default();
        }
        let group = RUNS[if by_rays { RUNS.len() - 1 } else { 0 }];
        arrange(&mut places, &RUNS, &|&place| {
            (origins[place as usize].to_array(), place)
        });
        let mut number = vec![u32::MAX; origins.len()];
        for (index, &place) in (0..).zip(&places) {
            number[place as usize] = index;
        }
        Self {
            ssdfs: (0..places.len().div_ceil(group))
                .map(|_| OnceLock::new())
                .collect(),
            places,
            number,
            group,
            texels,
        }
    }

    pub(super) fn is_empty(&self) -> bool {
        self.places.is_empty()
    }

    /// All are sampled again.
    pub(super) fn forget(&mut self) {
        for ssdf in &mut self.ssdfs {
            ssdf.take();
        }
    }

    /// How many places were sampled: for the choice of an aim, too.
    pub(super) fn sampled(&self) -> usize {
        let groups = self.ssdfs.iter().filter_map(OnceLock::get);
        groups.map(|group| group.len() / self.texels).sum()
    }

    /// The SSDF of a place, once its group was sampled.
    pub(super) fn ssdf(&self, place: u32) -> Option<&[f32]> {
        let number = *self.number.get(place as usize)? as usize;
        let group = self.ssdfs.get(number / self.group)?.get()?;
        group.chunks_exact(self.texels).nth(number % self.group)
    }
}

impl Prepared<'_> {
    /// Samples what some triangles need of what is kept, if anything is.
    pub(super) fn sample_kept_for<'a>(
        &self,
        triangles: impl Iterator<Item = &'a u32>,
    ) -> Result<(), Interrupted> {
        if self.kept.is_empty() {
            return Ok(());
        }
        let places = triangles.flat_map(|&triangle| self.triangles[triangle as usize]);
        self.sample_kept(&self.sparse.sources_of(places))
    }

    /// Samples some places and those of their groups, unless that was done before.
    pub(super) fn sample_kept(&self, places: &[u32]) -> Result<(), Interrupted> {
        let kept = &self.kept;
        let group = |&place: &u32| kept.number[place as usize] as usize / kept.group;
        let mut groups: Vec<usize> = places.iter().map(group).collect();
        groups.sort_unstable();
        groups.dedup();
        groups.par_iter().try_for_each_init(
            || self.sampler.scratch(&self.contours),
            |scratch, &group| {
                // Nothing in here is divided among threads: one that waited for another part would start on a
                // group that it has begun itself.
                kept.ssdfs[group].get_or_init(|| {
                    let end = kept.places.len().min((group + 1) * kept.group);
                    let places = &kept.places[group * kept.group..end];
                    let origin = |&place: &u32| self.origins[place as usize];
                    let origins: Vec<Vec3> = places.iter().map(origin).collect();
                    let mut ssdfs = vec![0.0; places.len() * kept.texels];
                    let Ok(()) = self.sampler.sample_group::<Infallible>(
                        &self.contours,
                        scratch,
                        &origins,
                        |index, sampled| {
                            self.verify(&sampled);
                            ssdfs[index * kept.texels..][..kept.texels]
                                .copy_from_slice(&sampled.distances);
                            Ok(())
                        },
                    );
                    ssdfs
                });
                self.report()
            },
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::cluster::tests::grid;
    use crate::visibility::sparse::Spacing;

    #[test]
    fn what_stands_for_others_is_in_one_group() {
        let (origins, triangles) = grid(60, |_, _| 0.0);
        let spacing = |distance: f32| Spacing {
            distances: vec![distance; origins.len()],
            smooth: 0.9,
        };
        let sparse = |distance| Sparse::new(&origins, &triangles, &spacing(distance));
        let some = sparse(4.0);
        let kept = Kept::new(&some, &origins, 16, false);
        let mut places = kept.places.clone();
        places.sort_unstable();
        assert_eq!(places, some.sources_of(0..origins.len() as u32));
        assert_eq!(kept.ssdfs.len(), places.len().div_ceil(kept.group));
        assert_eq!(kept.ssdf(places[0]), None);
        for group in 0..kept.ssdfs.len() {
            let members =
                &kept.places[group * kept.group..places.len().min((group + 1) * kept.group)];
            let ssdfs = members.iter().flat_map(|&place| [place as f32; 16]);
            kept.ssdfs[group].set(ssdfs.collect()).unwrap();
        }
        for place in 0..origins.len() as u32 {
            let known = places.binary_search(&place).is_ok();
            let ssdf = [place as f32; 16];
            assert_eq!(kept.ssdf(place), known.then_some(&ssdf[..]));
        }
        assert_eq!(kept.sampled(), places.len());
        // Where all are sampled, or too many, every chunk has its own.
        assert!(Kept::new(&sparse(0.5), &origins, 16, false).is_empty());
        assert!(Kept::new(&some, &origins, MOST_BYTES / 1024, false).is_empty());
    }
}
