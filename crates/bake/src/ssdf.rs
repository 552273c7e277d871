//! Spherical signed distance: angle to the nearest point of the visibility boundary.
//!
//! D(ω) is positive where ω is visible and negative where it is blocked (Wang et al. 2013,
//! §4). The boundary is known where it passes between neighbouring sample texels of
//! different class: at the contour that separates them where one was found
//! ([`Crossings`]), midway otherwise. |D| is the angle to the nearest of these points,
//! found exactly: directions that lie together look through bins of points in the order of
//! what they can be at least away, until no bin that is left can hold a nearer one.
//!
//! The distances may be wanted at fewer texels than were sampled. A texel then spans a
//! block of samples. Where these are of one class, that gives the sign of the distance at
//! the texel's centre; else, the boundary being nearly straight within a texel, the centre's
//! distance is the mean of the samples' signed ones.

use glam::{Vec2, Vec2Swizzles as _, Vec3};
use pulp::{Arch, Simd, WithSimd};
use relight_shading::octahedral;

use crate::visibility::{Bitmap, Directions};

/// Directions whose distances are computed side by side: those of 4 × 4 texels or samples.
const LANES: usize = SIDE * SIDE;
const SIDE: usize = 4;
/// Bins per side of the map, about.
const BINS: usize = 16;
/// Most samples per texel and side.
pub const MAX_SPAN: u32 = 16;
/// A coordinate of points that are nearest to nothing.
const FAR: f32 = 1e3;
/// Slack of what bins are away against rounding, radians.
const ANGLE_SLACK: f32 = 1e-4;

/// Tables for the transform between two resolutions.
pub struct Transform {
    /// Texels per side of the visibility bitmap.
    n: usize,
    /// Texels per side that distances are wanted at.
    resolution: usize,
    /// The texels' centres.
    tiles: Vec<Group>,
    /// Per tile every bin: what it is away at least, as a squared chord, ascending.
    order: Vec<(f32, u16)>,
    /// The samples.
    blocks: Vec<Block>,
    /// The cell of each sample texel. A link belongs to the cell of its first texel. A bin
    /// is a square of consecutive cells.
    cells: Vec<u16>,
    cell_count: usize,
    cells_per_bin: usize,
    /// Pairs of texels that are neighbours over the border, and the midpoint between them.
    border: Vec<([u32; 2], Vec2)>,
}

/// Directions of up to 4 × 4 texels that lie together. Lanes without a texel repeat another.
struct Group {
    x: usize,
    y: usize,
    columns: usize,
    rows: usize,
    centre: Vec3,
    /// Largest angle between a direction and the centre.
    radius: f32,
    /// Directions less the centre: small numbers, whose products keep their precision.
    offsets: [[f32; LANES]; 3],
    /// Squared lengths of the offsets.
    squares: [f32; LANES],
}

/// Samples, and where the boundary may be that is nearest to them.
struct Block {
    samples: Group,
    /// The texels that the samples belong to.
    texels: Vec<u32>,
    /// Cells no farther away than the texels are wide.
    cells: Vec<u16>,
}

/// Where contours cross the links between neighbouring sample texels of different class.
#[derive(Debug, Default)]
pub struct Crossings {
    /// Per link, from its first texel to the other, 0 to 1; NaN where no contour was found.
    /// The links to the right of every texel are followed by those to the texel below.
    /// Empty if nothing is known.
    pub(crate) positions: Vec<f32>,
}

impl Crossings {
    fn position(&self, link: usize) -> f32 {
        match self.positions.get(link) {
            Some(position) if !position.is_nan() => *position,
            _ => 0.5,
        }
    }
}

/// Points of the boundary, cell after cell.
struct Boundary {
    /// Followed by [`LANES`] more, far from the sphere.
    points: [Vec<f32>; 3],
    /// First point of each cell, and the end of the last one.
    starts: Vec<u32>,
}

impl Transform {
    /// Tables from bitmaps of the resolution of `samples` to distances at `resolution`
    /// squared texels. `resolution` must divide that of the samples, and be at least a
    /// [`MAX_SPAN`]th of it.
    pub fn new(samples: &Directions, resolution: u32) -> Self {
        let n = samples.resolution();
        assert!(
            n.is_multiple_of(resolution) && n / resolution <= MAX_SPAN,
            "{resolution} does not divide {n}, or into too small parts"
        );
        let (n, resolution) = (n as usize, resolution as usize);
        let per_bin_side = n.div_ceil(BINS * SIDE);
        let bins_per_side = n.div_ceil(per_bin_side * SIDE);
        let cells_per_bin = per_bin_side * per_bin_side;
        let cell = |i: usize| {
            let (x, y) = (i % n / SIDE, i / n / SIDE);
            let bin = y / per_bin_side * bins_per_side + x / per_bin_side;
            bin * cells_per_bin + y % per_bin_side * per_bin_side + x % per_bin_side
        };
        let mut transform = Self {
            n,
            resolution,
            tiles: groups(resolution),
            order: Vec::new(),
            blocks: Vec::new(),
            cells: (0..n * n).map(|i| cell(i) as u16).collect(),
            cell_count: bins_per_side * bins_per_side * cells_per_bin,
            cells_per_bin,
            border: border(n),
        };
        let cells = transform.cell_points();
        let bins: Vec<(Vec3, f32)> = (cells.chunks(cells_per_bin))
            .map(|cells| bounds(cells.iter().flatten().copied()))
            .collect();
        for tile in &transform.tiles {
            let start = transform.order.len();
            let away = bins.iter().map(|bin| squared_chord(tile.away(*bin)));
            transform.order.extend(away.zip(0..));
            transform.order[start..].sort_by(|a, b| a.0.total_cmp(&b.0));
        }
        if n > resolution {
            let cells: Vec<(Vec3, f32)> = (cells.iter())
                .map(|points| bounds(points.iter().copied()))
                .collect();
            transform.blocks = transform.blocks(&cells);
        }
        transform
    }

    /// Points near all those that each cell can hold.
    fn cell_points(&self) -> Vec<Vec<Vec3>> {
        let n = self.n;
        let mut points = vec![Vec::new(); self.cell_count];
        for (i, &cell) in self.cells.iter().enumerate() {
            let first = Vec2::new((i % n) as f32, (i / n) as f32);
            let reach = [Vec2::ZERO, Vec2::X, Vec2::Y, 0.5 * Vec2::X, 0.5 * Vec2::Y];
            points[usize::from(cell)].extend(reach.map(|offset| direction(first + offset, n)));
        }
        for ([first, _], midpoint) in &self.border {
            points[usize::from(self.cells[*first as usize])].push(direction(*midpoint, n));
        }
        points
    }

    /// `cells`: the bounds of each.
    fn blocks(&self, cells: &[(Vec3, f32)]) -> Vec<Block> {
        let span = self.n / self.resolution;
        let texel_of = |x: usize, y: usize| y / span * self.resolution + x / span;
        // The boundary crosses a link within every texel of mixed class.
        let widths: Vec<f32> = (0..self.resolution.pow(2))
            .map(|i| {
                let (x, y) = (i % self.resolution * span, i / self.resolution * span);
                let samples = (0..span * span).map(|j| {
                    direction(
                        Vec2::new((x + j % span) as f32, (y + j / span) as f32),
                        self.n,
                    )
                });
                2.0 * bounds(samples).1
            })
            .collect();
        (groups(self.n).into_iter())
            .map(|samples| {
                let mut texels: Vec<u32> = (0..samples.rows * samples.columns)
                    .map(|i| {
                        let (x, y) = (i % samples.columns, i / samples.columns);
                        texel_of(samples.x + x, samples.y + y) as u32
                    })
                    .collect();
                texels.sort_unstable();
                texels.dedup();
                let width = |texel: &u32| widths[*texel as usize];
                let reach = texels.iter().map(width).fold(0.0, f32::max);
                let near = cells.iter().zip(0..);
                let cells = near.filter(|(cell, _)| samples.away(**cell) <= reach);
                Block {
                    texels,
                    cells: cells.map(|(_, cell)| cell).collect(),
                    samples,
                }
            })
            .collect()
    }

    /// The SSDF of a visibility bitmap, radians per texel, clamped to ± `limit`.
    pub fn apply(&self, visible: &Bitmap, crossings: &Crossings, limit: f32) -> Vec<f32> {
        let mut distances = vec![0.0; self.resolution * self.resolution];
        Arch::new().dispatch(Apply {
            transform: self,
            visible,
            crossings,
            limit,
            distances: &mut distances,
        });
        distances
    }

    /// Finds all links between texels of different class.
    #[inline(always)]
    fn boundary(&self, visible: &Bitmap, crossings: &Crossings) -> Boundary {
        let n = self.n;
        let mut found: Vec<(u16, [f32; 2])> = Vec::with_capacity(16 * n);
        let mut starts = vec![0u32; self.cell_count + 1];
        let mut add = |first: usize, at: [f32; 2]| {
            let cell = self.cells[first];
            starts[usize::from(cell) + 1] += 1;
            found.push((cell, at));
        };
        visible.for_links(n, |texel, below| {
            let (x, y) = ((texel % n) as f32, (texel / n) as f32);
            add(
                texel,
                if below {
                    [x, y + crossings.position(n * n + texel)]
                } else {
                    [x + crossings.position(texel), y]
                },
            );
        });
        for ([a, b], midpoint) in &self.border {
            if visible.get(*a as usize) != visible.get(*b as usize) {
                add(*a as usize, midpoint.to_array());
            }
        }
        for cell in 0..self.cell_count {
            starts[cell + 1] += starts[cell];
        }
        let mut next = starts.clone();
        let padded = found.len() + LANES;
        let [mut u, mut v] = [vec![0.0; found.len()], vec![0.0; found.len()]];
        for (cell, at) in found {
            let place = &mut next[usize::from(cell)];
            [u[*place as usize], v[*place as usize]] = at;
            *place += 1;
        }
        let mut points = [(); 3].map(|()| vec![FAR; padded]);
        let [x, y, z] = &mut points;
        let scale = 2.0 / n as f32;
        for i in 0..u.len() {
            [x[i], y[i], z[i]] = decode([u[i], v[i]], scale);
        }
        Boundary { points, starts }
    }

    /// Visible samples per texel of a tile.
    #[inline(always)]
    fn visible_samples(&self, visible: &Bitmap, tile: &Group) -> [u32; LANES] {
        let (n, span) = (self.n, self.n / self.resolution);
        let one = (1u64 << span) - 1;
        let mut counts = [0; LANES];
        for y in 0..tile.rows * span {
            let bits = visible.bits((tile.y * span + y) * n + tile.x * span);
            for (column, count) in counts[y / span * SIDE..][..SIDE].iter_mut().enumerate() {
                *count += (bits >> (column * span) & one).count_ones();
            }
        }
        counts
    }
}

/// The vectorised body of [`Transform::apply`].
struct Apply<'a> {
    transform: &'a Transform,
    visible: &'a Bitmap,
    crossings: &'a Crossings,
    limit: f32,
    distances: &'a mut [f32],
}

impl WithSimd for Apply<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let Self {
            transform,
            visible,
            crossings,
            limit,
            distances,
        } = self;
        let Transform { n, resolution, .. } = *transform;
        let span = n / resolution;
        let samples = (span * span) as u32;
        let boundary = transform.boundary(visible, crossings);
        let mut mixed = vec![false; distances.len()];
        let bins = transform.cell_count / transform.cells_per_bin;
        let orders = transform.order.chunks_exact(bins);
        for (tile, order) in transform.tiles.iter().zip(orders) {
            let counts = transform.visible_samples(visible, tile);
            let found = boundary.in_order(tile, order, transform.cells_per_bin, limit);
            for row in 0..tile.rows {
                let start = (tile.y + row) * resolution + tile.x;
                for column in 0..tile.columns {
                    let (count, angle) = (counts[row * SIDE + column], found[row * SIDE + column]);
                    let out = &mut distances[start + column];
                    if count == 0 {
                        *out = -angle;
                    } else if count == samples {
                        *out = angle;
                    } else {
                        mixed[start + column] = true;
                    }
                }
            }
        }
        let share = 1.0 / samples as f32;
        for block in &transform.blocks {
            let mut any = false;
            for &texel in &block.texels {
                any |= mixed[texel as usize];
            }
            if !any {
                continue;
            }
            let group = &block.samples;
            let found = boundary.within(group, &block.cells, limit);
            for row in 0..group.rows {
                let y = group.y + row;
                let bits = visible.bits(y * n + group.x);
                for column in 0..group.columns {
                    let texel = y / span * resolution + (group.x + column) / span;
                    if mixed[texel] {
                        let part = share * found[row * SIDE + column];
                        distances[texel] += if bits >> column & 1 == 1 { part } else { -part };
                    }
                }
            }
        }
    }
}

impl Boundary {
    /// Angle from each direction of a tile to the nearest point, at most `limit`.
    #[inline(always)]
    fn in_order(
        &self,
        tile: &Group,
        order: &[(f32, u16)],
        cells_per_bin: usize,
        limit: f32,
    ) -> [f32; LANES] {
        let widest = squared_chord(limit);
        let mut nearest = less(widest, tile.squares);
        let (mut worst, mut looked) = (widest, false);
        for &(away, bin) in order {
            // Bins that overlap the tile are looked through in any case.
            if looked && away > 0.0 {
                worst = largest(add(nearest, tile.squares));
                looked = false;
            }
            if away >= worst {
                break;
            }
            let first = usize::from(bin) * cells_per_bin;
            looked |= self.look(tile, first, first + cells_per_bin, &mut nearest);
        }
        angles(add(nearest, tile.squares), limit)
    }

    /// The same among some cells.
    #[inline(always)]
    fn within(&self, group: &Group, cells: &[u16], limit: f32) -> [f32; LANES] {
        let widest = squared_chord(limit);
        let mut nearest = less(widest, group.squares);
        for &cell in cells {
            let cell = usize::from(cell);
            self.look(group, cell, cell + 1, &mut nearest);
        }
        angles(add(nearest, group.squares), limit)
    }

    /// Looks through the points of consecutive cells; whether there are any. `nearest` are
    /// squared chords less the squares of the group's offsets: with p a point and t a
    /// direction less the centre, |p − t|² − |t|² = |p|² − 2 p·t.
    #[inline(always)]
    fn look(&self, group: &Group, first: usize, past: usize, nearest: &mut [f32; LANES]) -> bool {
        let (mut start, end) = (self.starts[first] as usize, self.starts[past] as usize);
        let any = start < end;
        let [px, py, pz] = &self.points;
        let [tx, ty, tz] = &group.offsets;
        while start < end {
            // Arrays, as slices do not vectorise. The points are padded.
            let (Some(xs), Some(ys), Some(zs)) = (
                px[start..].first_chunk::<LANES>(),
                py[start..].first_chunk::<LANES>(),
                pz[start..].first_chunk::<LANES>(),
            ) else {
                break;
            };
            let mut terms = [[0.0; LANES]; 4];
            for i in 0..LANES {
                let x = xs[i] - group.centre.x;
                let y = ys[i] - group.centre.y;
                let z = zs[i] - group.centre.z;
                terms[0][i] = -2.0 * x;
                terms[1][i] = -2.0 * y;
                terms[2][i] = -2.0 * z;
                terms[3][i] = x * x + y * y + z * z;
            }
            let [xs, ys, zs, squares] = &terms;
            // By pairs, as every minimum waits for the one before. What a last pair takes in
            // addition is a point of the boundary too, or far away.
            for i in (0..LANES.min(end - start)).step_by(2) {
                let a = [xs[i], ys[i], zs[i], squares[i]];
                let b = [xs[i + 1], ys[i + 1], zs[i + 1], squares[i + 1]];
                for lane in 0..LANES {
                    let offset = [tx[lane], ty[lane], tz[lane]];
                    let (a, b) = (relative(a, offset), relative(b, offset));
                    let least = if b < a { b } else { a };
                    nearest[lane] = if least < nearest[lane] {
                        least
                    } else {
                        nearest[lane]
                    };
                }
            }
            start += LANES;
        }
        any
    }
}

/// |p|² − 2 p·t.
#[inline(always)]
fn relative([x, y, z, square]: [f32; 4], t: [f32; 3]) -> f32 {
    x.mul_add(t[0], y.mul_add(t[1], z.mul_add(t[2], square)))
}

#[inline(always)]
fn less(value: f32, mut squares: [f32; LANES]) -> [f32; LANES] {
    for square in &mut squares {
        *square = value - *square;
    }
    squares
}

#[inline(always)]
fn add(mut a: [f32; LANES], b: [f32; LANES]) -> [f32; LANES] {
    for lane in 0..LANES {
        a[lane] += b[lane];
    }
    a
}

/// Angles of squared chords, at most `limit`.
#[inline(always)]
fn angles(squared: [f32; LANES], limit: f32) -> [f32; LANES] {
    let mut angles = [0.0; LANES];
    for lane in 0..LANES {
        // Rounding may leave less than nothing.
        angles[lane] = small_angle(squared[lane].max(0.0));
    }
    for lane in 0..LANES {
        // The series is for small angles.
        if squared[lane] > SMALL_SQUARED_CHORD {
            angles[lane] = angle_of_squared_chord(squared[lane]);
        }
        angles[lane] = angles[lane].min(limit);
    }
    angles
}

impl Group {
    /// The least angle between one of these directions and a point within `radius` of
    /// another `centre`, or less.
    fn away(&self, (centre, radius): (Vec3, f32)) -> f32 {
        let angle = angle_of_squared_chord(self.centre.distance_squared(centre));
        (angle - self.radius - radius - ANGLE_SLACK).max(0.0)
    }
}

/// An `n` × `n` map's texels in groups.
fn groups(n: usize) -> Vec<Group> {
    let starts = || (0..n).step_by(SIDE);
    starts()
        .flat_map(|y| starts().map(move |x| (x, y)))
        .map(|(x, y)| {
            let columns = SIDE.min(n - x);
            let rows = SIDE.min(n - y);
            let directions = (0..LANES).map(|lane| {
                let column = (lane % SIDE).min(columns - 1);
                let row = (lane / SIDE).min(rows - 1);
                direction(Vec2::new((x + column) as f32, (y + row) as f32), n)
            });
            let (centre, radius) = bounds(directions.clone());
            let mut group = Group {
                x,
                y,
                columns,
                rows,
                centre,
                radius,
                offsets: [[0.0; LANES]; 3],
                squares: [0.0; LANES],
            };
            for (lane, direction) in directions.enumerate() {
                let offset = direction - centre;
                group.squares[lane] = offset.length_squared();
                for (axis, value) in group.offsets.iter_mut().zip(offset.to_array()) {
                    axis[lane] = value;
                }
            }
            group
        })
        .collect()
}

/// Neighbours over the border, each pair once.
fn border(n: usize) -> Vec<([u32; 2], Vec2)> {
    let last = n - 1;
    let middle = |x: f32, y: usize| Vec2::new(x, y as f32);
    (0..n / 2)
        .flat_map(|i| {
            let pair = |a: [usize; 2], b: [usize; 2]| [a, b].map(|[x, y]| (y * n + x) as u32);
            let (low, high) = (-0.5, last as f32 + 0.5);
            [
                (pair([0, i], [0, last - i]), middle(low, i)),
                (pair([last, i], [last, last - i]), middle(high, i)),
                (pair([i, 0], [last - i, 0]), middle(low, i).yx()),
                (pair([i, last], [last - i, last]), middle(high, i).yx()),
            ]
        })
        .collect()
}

/// The direction at a point of the map in texels: texel (x, y) has its centre at (x, y).
fn direction(at: Vec2, n: usize) -> Vec3 {
    octahedral::decode((at + 0.5) / n as f32)
}

/// The same by arithmetic that vectorises.
#[inline(always)]
fn decode([u, v]: [f32; 2], scale: f32) -> [f32; 3] {
    let x = (u + 0.5) * scale - 1.0;
    let z = (v + 0.5) * scale - 1.0;
    let y = 1.0 - x.abs() - z.abs();
    // How far a point of the lower hemisphere moves towards the middle.
    let over = if y < 0.0 { -y } else { 0.0 };
    let x = x - over.copysign(x);
    let z = z - over.copysign(z);
    let inverse = 1.0 / (x * x + y * y + z * z).sqrt();
    [x * inverse, y * inverse, z * inverse]
}

/// A direction amid others and the largest angle to one of them, radians.
fn bounds(directions: impl Iterator<Item = Vec3> + Clone) -> (Vec3, f32) {
    let sum: Vec3 = directions.clone().sum();
    let centre = sum.normalize_or(Vec3::Y);
    let squared = directions.map(|direction| centre.distance_squared(direction));
    (centre, angle_of_squared_chord(squared.fold(0.0, f32::max)))
}

/// By halves, which vectorises.
#[inline(always)]
fn largest(mut values: [f32; LANES]) -> f32 {
    let mut half = LANES / 2;
    while half > 0 {
        for lane in 0..half {
            let other = values[lane + half];
            if other > values[lane] {
                values[lane] = other;
            }
        }
        half /= 2;
    }
    values[0]
}

fn squared_chord(angle: f32) -> f32 {
    (2.0 * (0.5 * angle).sin()).powi(2)
}

fn angle_of_squared_chord(squared: f32) -> f32 {
    if squared > SMALL_SQUARED_CHORD {
        return 2.0 * (0.5 * squared.sqrt()).min(1.0).asin();
    }
    small_angle(squared)
}

/// Of an angle of half a radian.
const SMALL_SQUARED_CHORD: f32 = 0.25;

/// The series of the arcsine, to the last bit of single precision for small angles.
#[inline(always)]
fn small_angle(squared: f32) -> f32 {
    let quarter = 0.25 * squared;
    let series =
        1.0 / 6.0 + quarter * (3.0 / 40.0 + quarter * (15.0 / 336.0 + quarter * (105.0 / 3456.0)));
    2.0 * quarter.sqrt() * (1.0 + quarter * series)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn brute_force(samples: &Directions, resolution: u32, bitmap: &Bitmap, limit: f32) -> Vec<f32> {
        let n = samples.resolution() as i32;
        let at = |x: i32, y: i32| {
            let (x, y) = octahedral::wrap(x, y, n as u32);
            (y * n as u32 + x) as usize
        };
        let mut midpoints = Vec::new();
        for (x, y) in (0..n * n).map(|i| (i % n, i / n)) {
            for (dx, dy) in [(-1, 0), (1, 0), (0, -1), (0, 1)] {
                let (a, b) = (at(x, y), at(x + dx, y + dy));
                if bitmap.get(a) != bitmap.get(b) {
                    let link = Vec2::new(dx as f32, dy as f32);
                    let at = Vec2::new(x as f32, y as f32) + 0.5 * link;
                    midpoints.push(direction(at, n as usize));
                }
            }
        }
        let span = n / resolution as i32;
        let distance = |direction: Vec3| {
            midpoints
                .iter()
                .map(|&midpoint| 2.0 * (0.5 * direction.distance(midpoint)).min(1.0).asin())
                .fold(limit, f32::min)
        };
        (0..(resolution * resolution) as i32)
            .map(|i| {
                let (x, y) = (i % resolution as i32, i / resolution as i32);
                let block = (0..span * span).map(|j| at(x * span + j % span, y * span + j / span));
                let visible = block.clone().filter(|&texel| bitmap.get(texel)).count();
                let centre = octahedral::texel_direction(x as u32, y as u32, resolution);
                match visible {
                    0 => -distance(centre),
                    all if all == (span * span) as usize => distance(centre),
                    _ => {
                        let signed = block.map(|texel| {
                            let sign = if bitmap.get(texel) { 1.0 } else { -1.0 };
                            sign * distance(samples.as_slice()[texel])
                        });
                        signed.sum::<f32>() / (span * span) as f32
                    }
                }
            })
            .collect()
    }

    /// Blobs, stripes and single texels from a small generator of random numbers.
    fn patterns(directions: &Directions) -> Vec<Bitmap> {
        let mut state = 7u64;
        let mut random = move || {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963_407);
            (state >> 40) as f32 / (1u64 << 24) as f32
        };
        let texels = directions.as_slice();
        let mut bitmaps = vec![
            Bitmap::from_fn(texels.len(), |_| true),
            Bitmap::from_fn(texels.len(), |_| false),
            Bitmap::from_fn(texels.len(), |i| i != 17),
            Bitmap::from_fn(texels.len(), |i| i == texels.len() - 1),
            Bitmap::from_fn(texels.len(), |_| random() < 0.5),
        ];
        for caps in [1, 3, 12] {
            let caps: Vec<(Vec3, f32)> = (0..caps)
                .map(|_| {
                    let axis = Vec3::new(random() - 0.5, random() - 0.5, random() - 0.5);
                    (axis.normalize(), 1.0 - 0.3 * random())
                })
                .collect();
            bitmaps.push(Bitmap::from_fn(texels.len(), |i| {
                caps.iter()
                    .all(|(axis, cosine)| axis.dot(texels[i]) < *cosine)
            }));
        }
        bitmaps
    }

    /// Both sides take the same nearest midpoint; arithmetic rounds its last bits otherwise,
    /// radians. An arcsine near a half-turn magnifies them.
    const ROUNDING: f32 = 4e-6;

    #[test]
    fn equals_brute_force() {
        for (samples, resolution) in [(16, 16), (48, 24), (64, 16)] {
            let directions = Directions::new(samples);
            let transform = Transform::new(&directions, resolution);
            for (number, bitmap) in patterns(&directions).iter().enumerate() {
                for limit in [0.5, 3.0] {
                    let fast = transform.apply(bitmap, &Crossings::default(), limit);
                    let exact = brute_force(&directions, resolution, bitmap, limit);
                    for (i, (a, b)) in fast.iter().zip(&exact).enumerate() {
                        assert!(
                            (a - b).abs() < ROUNDING,
                            "pattern {number}, {samples}², limit {limit}, texel {i}: {a} instead of {b}"
                        );
                    }
                }
            }
        }
    }

    #[test]
    fn matches_the_distance_to_an_analytic_cap() {
        for resolution in [64, 128] {
            matches_analytic_cap(resolution);
        }
    }

    fn matches_analytic_cap(resolution: u32) {
        let directions = Directions::new(128);
        let transform = Transform::new(&directions, resolution);
        let (axis, radius) = (Vec3::new(0.3, 0.8, -0.5).normalize(), 0.6f32);
        let angle = |direction: Vec3| axis.dot(direction).clamp(-1.0, 1.0).acos();
        let texels = directions.as_slice();
        let bitmap = Bitmap::from_fn(texels.len(), |i| angle(texels[i]) > radius);
        let distances = transform.apply(&bitmap, &Crossings::default(), std::f32::consts::PI);
        let exact: Vec<f32> = Directions::new(resolution)
            .as_slice()
            .iter()
            .copied()
            .map(|d| angle(d) - radius)
            .collect();
        let worst = exact
            .iter()
            .zip(&distances)
            .map(|(a, b)| (a - b).abs())
            .fold(0f32, f32::max);
        // Distances to texel centres shrink both sides alike; what shades is where the zero
        // crossing lies: the mean of both sides' errors.
        let mean_error = |side: &dyn Fn(f32) -> bool| {
            let errors: Vec<f32> = (exact.iter().zip(&distances))
                .filter(|(exact, _)| exact.abs() < 0.1 && side(**exact))
                .map(|(exact, found)| found - exact)
                .collect();
            errors.iter().sum::<f32>() / errors.len() as f32
        };
        let mean = 0.5 * (mean_error(&|x| x > 0.0) + mean_error(&|x| x < 0.0));
        assert!(worst < 0.02, "worst error {worst}");
        assert!(mean.abs() < 0.002, "the zero crossing lies {mean} off");
    }
}
