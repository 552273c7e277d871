//! Where instances may be seen, as lists of tiles of 8 × 8 pixels for the workgroups of dispatches.

use std::ops::Range;

use relight_shading::gpu;
use relight_shading::surfaces::TILE;

/// The largest alignment of dynamic offsets that WebGPU allows a device to ask for.
pub(crate) const OFFSET_ALIGNMENT: usize = 256;
/// Side of a compute workgroup in pixels, as in shade.wgsl.
pub(crate) const WORKGROUP: u32 = 8;

/// Tiles that are shaded at a time.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Dispatch {
    /// Where they begin in their buffer, bytes.
    pub(crate) offset: u32,
    pub(crate) workgroups: u32,
}

/// How a picture is shaded.
#[derive(Clone, Copy)]
pub(crate) struct Tiling {
    /// Columns and rows of the picture.
    pub(crate) size: [u32; 2],
    pub(crate) antialias: bool,
    /// Tiles that are shaded at a time, at most.
    pub(crate) at_once: u32,
}

/// Pixels that an instance may cover.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Region {
    pub(crate) column: u32,
    pub(crate) row: u32,
    pub(crate) width: u32,
    pub(crate) height: u32,
}

impl Region {
    /// What a box covers at most of an image, whole workgroups; `None` if nothing.
    pub(crate) fn of_box(
        view: &relight_shading::camera::View,
        [low, high]: [glam::Vec3; 2],
        [width, height]: [u32; 2],
    ) -> Option<Self> {
        if low.x > high.x {
            return None;
        }
        let image = glam::Vec2::new(width as f32, height as f32);
        let (mut first, mut last) = (glam::Vec2::INFINITY, glam::Vec2::NEG_INFINITY);
        for index in 0..8 {
            let corner = glam::Vec3::new(
                [low.x, high.x][index & 1],
                [low.y, high.y][index >> 1 & 1],
                [low.z, high.z][index >> 2],
            );
            let clip = view.view_projection * corner.extend(1.0);
            // At the eye, or behind: its edges may reach anywhere.
            let whole = clip.w <= 1e-3 * clip.truncate().abs().max_element() && !view.parallel;
            let at = if whole {
                first = glam::Vec2::ZERO;
                image
            } else {
                let ndc = glam::Vec2::new(clip.x, -clip.y) / clip.w;
                (0.5 * ndc + 0.5) * image
            };
            first = first.min(at);
            last = last.max(at);
        }
        // A pixel more, for rounding.
        let first = (first - 1.0).max(glam::Vec2::ZERO);
        let last = (last + 1.0).min(image);
        if !(first.x < last.x && first.y < last.y) {
            return None;
        }
        let [column, row] = [first.x, first.y].map(|at| at as u32 / WORKGROUP * WORKGROUP);
        Some(Self {
            column,
            row,
            width: (last.x.ceil() as u32).min(width) - column,
            height: (last.y.ceil() as u32).min(height) - row,
        })
    }

    /// The first row of images that holds further surfaces of pixels.
    pub(crate) fn first_extra_row([_, height]: [u32; 2], antialias: bool) -> u32 {
        if antialias {
            height.next_multiple_of(TILE)
        } else {
            u32::MAX
        }
    }

    /// Where further surfaces of the region's pixels are, in the images of a picture of such a size; whole
    /// workgroups.
    pub(crate) fn extras(self, size: [u32; 2]) -> Self {
        // Half as many rows for as many pixels.
        let first = Self::first_extra_row(size, true);
        let row = first + self.row / 2 / WORKGROUP * WORKGROUP;
        let end = first + (self.row + self.height).next_multiple_of(TILE) / 2;
        Self {
            row,
            height: end - row,
            ..self
        }
    }

    /// Rows of workgroups, and their columns. Of those only whose pixels lie in `rows` of the picture, `extra`
    /// being where further surfaces begin.
    pub(crate) fn tile_rows(
        self,
        extra: u32,
        rows: &Range<u32>,
    ) -> impl Iterator<Item = (u32, Range<u32>)> {
        let first = self.column / WORKGROUP;
        let columns = first..first + self.width.div_ceil(WORKGROUP);
        let tiles = self.row / WORKGROUP..(self.row + self.height).div_ceil(WORKGROUP);
        tiles.filter_map(move |tile| {
            let row = WORKGROUP * tile;
            let in_picture = row.checked_sub(extra).map_or(row, |below| 2 * below);
            (rows.contains(&in_picture)).then(|| (tile, columns.clone()))
        })
    }
}

/// The tiles that instances may be seen in, of some rows of the picture, and what shades them.
pub(crate) fn list(
    regions: &[Option<Region>],
    tiling: Tiling,
    rows: &Range<u32>,
) -> (Vec<u32>, Vec<Dispatch>) {
    let first_extra_row = Region::first_extra_row(tiling.size, tiling.antialias);
    let mut words: Vec<u32> = Vec::new();
    let mut dispatches: Vec<Dispatch> = Vec::new();
    for (place, region) in (0u32..).zip(regions) {
        let extras = (region.filter(|_| tiling.antialias)).map(|all| all.extras(tiling.size));
        let parts = region.iter().chain(&extras);
        let tile_rows = parts.flat_map(|part| part.tile_rows(first_extra_row, rows));
        for (row, columns) in tile_rows {
            for column in columns {
                match dispatches.last_mut() {
                    Some(last) if last.workgroups < tiling.at_once => last.workgroups += 1,
                    _ => {
                        words.resize(words.len().next_multiple_of(OFFSET_ALIGNMENT / 4), 0);
                        dispatches.push(Dispatch {
                            offset: 4 * words.len() as u32,
                            workgroups: 1,
                        });
                    }
                }
                words.push(gpu::tile(place, column, row));
            }
        }
    }
    (words, dispatches)
}

/// Adds a tile of every instance that may be seen; what is dispatched for these.
pub(crate) fn list_instances(regions: &[Option<Region>], words: &mut Vec<u32>) -> Dispatch {
    words.resize(words.len().next_multiple_of(OFFSET_ALIGNMENT / 4), 0);
    let offset = 4 * words.len() as u32;
    let seen = (0u32..).zip(regions).filter(|(_, region)| region.is_some());
    words.extend(seen.map(|(place, _)| gpu::tile(place, 0, 0)));
    Dispatch {
        offset,
        workgroups: words.len() as u32 - offset / 4,
    }
}

#[cfg(test)]
mod tests {
    use glam::Vec3;
    use relight_format::{Camera, FieldOfView};
    use relight_shading::camera::View as Projection;

    use super::*;

    fn camera(distance: f32) -> Projection {
        let camera = Camera {
            position: [0.0, 0.0, distance],
            target: [0.0; 3],
            up: [0.0, 1.0, 0.0],
            field_of_view: FieldOfView::Y(1.0),
        };
        Projection::new(&camera, 640, 480, 0.01)
    }

    #[test]
    fn regions_hold_what_boxes_cover() {
        let cube = [Vec3::splat(-0.5), Vec3::splat(0.5)];
        let size = [640, 480];
        let region = Region::of_box(&camera(10.0), cube, size).expect("visible");
        assert!(region.width < 80 && region.height < 80, "{region:?}");
        let middle = [320, 240];
        assert!(region.column < middle[0] && region.column + region.width > middle[0]);
        assert!(region.row < middle[1] && region.row + region.height > middle[1]);
        // The eye in the box, beside it, and far from it.
        let whole = Region {
            column: 0,
            row: 0,
            width: 640,
            height: 480,
        };
        assert_eq!(Region::of_box(&camera(0.2), cube, size), Some(whole));
        let aside = cube.map(|corner| corner + Vec3::X * 100.0);
        assert_eq!(Region::of_box(&camera(10.0), aside, size), None);
        let nothing = [Vec3::INFINITY, Vec3::NEG_INFINITY];
        assert_eq!(Region::of_box(&camera(10.0), nothing, size), None);
        let tiles = |rows| {
            let rows = whole.tile_rows(u32::MAX, &rows);
            rows.map(|(_, columns)| columns.len()).collect::<Vec<_>>()
        };
        assert_eq!(tiles(0..480), [80; 60]);
        assert_eq!((tiles(0..9).len(), tiles(9..480).len()), (2, 58));
        let extras = whole.extras(size);
        let (rows, extra) = (0..16, Region::first_extra_row(size, true));
        assert_eq!(extras.tile_rows(extra, &rows).count(), 1);
        assert_eq!(extras.tile_rows(extra, &(0..480)).count(), 30);
    }
}
