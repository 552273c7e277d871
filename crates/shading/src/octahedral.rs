//! Sphere ↔ square: the octahedral map over the full sphere in world space
//! (Praun & Hoppe 2003; Engelhardt & Dachsbacher 2008).
//!
//! +Y is the centre of the square, −Y its four corners; x grows with u and z with v.

use glam::{Vec2, Vec3};

/// The point of the unit square that shows `direction` (any non-zero length).
pub fn encode(direction: Vec3) -> Vec2 {
    let p = direction / (direction.x.abs() + direction.y.abs() + direction.z.abs());
    let q = if p.y >= 0.0 {
        Vec2::new(p.x, p.z)
    } else {
        fold(Vec2::new(p.x, p.z))
    };
    q * 0.5 + 0.5
}

/// The unit direction shown at `uv` in the unit square.
pub fn decode(uv: Vec2) -> Vec3 {
    let q = uv * 2.0 - 1.0;
    let y = 1.0 - q.x.abs() - q.y.abs();
    let p = if y >= 0.0 { q } else { fold(q) };
    Vec3::new(p.x, y, p.y).normalize()
}

/// [`decode`] by arithmetic that vectorises, to roundings: in a loop over lanes, which nothing here branches on. `at` is a
/// point of an `n` × `n` map in texels, texel (x, y) having its centre at (x, y), and `scale` 2/n.
#[inline(always)]
pub fn decode_lane([u, v]: [f32; 2], scale: f32) -> [f32; 3] {
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

/// The unit direction of the centre of texel (`x`, `y`) of an `n` × `n` map.
pub fn texel_direction(x: u32, y: u32, n: u32) -> Vec3 {
    decode((Vec2::new(x as f32, y as f32) + 0.5) / n as f32)
}

/// Area on the unit sphere of the texel of an `n` × `n` map whose centre has this direction of unit
/// length: the map shrinks by the third power of the distance to the face.
pub fn texel_area(direction: Vec3, n: u32) -> f32 {
    4.0 / (n * n) as f32 * direction.abs().element_sum().powi(3)
}

/// The texel that continues the map at (`x`, `y`), which may lie up to one map outside:
/// crossing an edge reflects about the edge's middle.
pub fn wrap(x: i32, y: i32, n: u32) -> (u32, u32) {
    let n = n as i32;
    let (mut x, mut y) = (x, y);
    if x < 0 || x >= n {
        x = if x < 0 { -1 - x } else { 2 * n - 1 - x };
        y = n - 1 - y;
    }
    if y < 0 || y >= n {
        y = if y < 0 { -1 - y } else { 2 * n - 1 - y };
        x = n - 1 - x;
    }
    (x as u32, y as u32)
}

/// The four texels that bilinear interpolation reads, and what each counts.
#[derive(Clone, Copy, Debug)]
pub struct Footprint {
    /// Indices, row by row.
    pub texels: [usize; 4],
    /// Their sum is 1.
    pub weights: [f32; 4],
}

impl Footprint {
    /// At a point of an `n` × `n` map in texels: texel (x, y) has its centre at (x, y).
    #[inline]
    pub fn new(at: Vec2, n: u32) -> Self {
        // Without SSE4.1, `floor` is a call.
        let floor = |x: f32| x as i32 - i32::from(x < x as i32 as f32);
        let (left, top) = (floor(at.x), floor(at.y));
        let (u, v) = (at.x - left as f32, at.y - top as f32);
        let texel = |right: i32, down: i32| {
            let (x, y) = wrap(left + right, top + down, n);
            (y * n + x) as usize
        };
        let last = n as i32 - 1;
        let texels = if left.min(top) >= 0 && left.max(top) < last {
            // Most are: nothing wraps.
            let (first, n) = ((top * n as i32 + left) as usize, n as usize);
            [first, first + 1, first + n, first + n + 1]
        } else {
            [texel(0, 0), texel(1, 0), texel(0, 1), texel(1, 1)]
        };
        Self {
            texels,
            weights: [(1.0 - u) * (1.0 - v), u * (1.0 - v), (1.0 - u) * v, u * v],
        }
    }

    /// The interpolated value.
    pub fn read(&self, values: &[f32]) -> f32 {
        let pairs = self.texels.iter().zip(&self.weights);
        pairs.fold(0.0, |sum, (texel, weight)| sum + weight * values[*texel])
    }
}

/// Exchanges the inner diamond with the four outer triangles.
fn fold(q: Vec2) -> Vec2 {
    let sign = Vec2::new(1f32.copysign(q.x), 1f32.copysign(q.y));
    (Vec2::ONE - Vec2::new(q.y.abs(), q.x.abs())) * sign
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lanes_decode_as_scalars_do() {
        const N: u32 = 37;
        for index in 0..N * N {
            let (x, y) = (index % N, index / N);
            let lane = decode_lane([x as f32, y as f32], 2.0 / N as f32);
            let expected = texel_direction(x, y, N);
            assert!(expected.distance(lane.into()) < 1e-6, "{x} {y}");
        }
    }

    #[test]
    fn encode_inverts_decode_at_every_texel() {
        let n = 128;
        for y in 0..n {
            for x in 0..n {
                let uv = encode(texel_direction(x, y, n)) * n as f32 - 0.5;
                let error = (uv - Vec2::new(x as f32, y as f32)).length();
                assert!(error < 1e-3, "texel ({x}, {y}) came back as {uv}");
            }
        }
    }

    #[test]
    fn wrapped_texels_are_neighbours_on_the_sphere() {
        let n = 64;
        for i in 0..n as i32 {
            for (outside, inside) in [
                ((-1, i), (0, i)),
                ((n as i32, i), (n as i32 - 1, i)),
                ((i, -1), (i, 0)),
            ] {
                let (x, y) = wrap(outside.0, outside.1, n);
                let a = texel_direction(x, y, n);
                let b = texel_direction(inside.0 as u32, inside.1 as u32, n);
                assert!(
                    a.distance(b) < 3.0 / n as f32,
                    "{outside:?} wraps to ({x}, {y})"
                );
            }
        }
    }
}
