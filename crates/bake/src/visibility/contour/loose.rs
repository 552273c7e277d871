//! Triangles of pieces that are hardly more than one: litter, scraps, cards with leaves.
//!
//! Most of them look smaller than a texel and cover the centre of none: they change nothing, which
//! their corners tell at once. The others are counted by their edges, each with the layer that the
//! triangle itself is: what two of them share cancels.

use glam::Vec3;

use super::batch::LANES;

/// Some of them, near one another, side by side.
pub(super) struct Bundle {
    /// Coordinates of their corners.
    pub(super) corners: [[[f32; LANES]; 3]; 3],
    /// Their numbers in the list that the mesh was made of.
    triangles: [u32; LANES],
    count: usize,
}

impl Default for Bundle {
    fn default() -> Self {
        Self {
            corners: [[[0.0; LANES]; 3]; 3],
            triangles: [0; LANES],
            count: 0,
        }
    }
}

impl Bundle {
    /// # Panics
    ///
    /// If it is full.
    pub(super) fn push(&mut self, triangle: u32, corners: [Vec3; 3]) {
        for (all, corner) in self.corners.iter_mut().zip(corners) {
            for (axis, coordinate) in all.iter_mut().zip(corner.to_array()) {
                axis[self.count] = coordinate;
            }
        }
        self.triangles[self.count] = triangle;
        self.count += 1;
    }

    pub(super) fn triangles(&self) -> &[u32] {
        &self.triangles[..self.count]
    }

    /// Lanes in use.
    #[inline(always)]
    pub(super) fn lanes(&self) -> u64 {
        (1 << self.count) - 1
    }
}
