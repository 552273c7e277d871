//! Small meshes that trials make themselves.

use std::fmt::Write as _;

use relight_format::math;

/// A sphere of radius 1 over a square of side 6, as an OBJ file. The sphere has
/// `2 · steps²` or so triangles, the square `2 · steps²`.
pub fn sphere_over_ground(steps: usize) -> String {
    use std::f32::consts::{PI, TAU};
    let mut obj = String::from("# a sphere over the ground\n");
    for row in 0..=steps {
        for column in 0..steps {
            let (theta, phi) = (
                PI * row as f32 / steps as f32,
                TAU * column as f32 / steps as f32,
            );
            let (x, y, z) = (
                math::sin(theta) * math::cos(phi),
                math::cos(theta),
                math::sin(theta) * math::sin(phi),
            );
            let _ = writeln!(obj, "v {x} {} {z}\nvn {x} {y} {z}", y + 1.25);
        }
    }
    let ground = (steps + 1) * steps;
    for row in 0..=steps {
        for column in 0..=steps {
            let along = |index: usize| 6.0 * index as f32 / steps as f32 - 3.0;
            let _ = writeln!(obj, "v {} 0 {}\nvn 0 1 0", along(column), along(row));
        }
    }
    let mut face = |corners: [usize; 3]| {
        let [a, b, c] = corners.map(|corner| corner + 1);
        let _ = writeln!(obj, "f {a}//{a} {b}//{b} {c}//{c}");
    };
    for row in 0..steps {
        for column in 0..steps {
            let (next, below) = ((column + 1) % steps, (row + 1) * steps);
            let [a, b] = [row * steps + column, row * steps + next];
            let [c, d] = [below + column, below + next];
            if row > 0 {
                face([a, b, c]);
            }
            if row + 1 < steps {
                face([b, d, c]);
            }
            let [a, c] = [row, row + 1].map(|row| ground + row * (steps + 1) + column);
            face([a, c, a + 1]);
            face([a + 1, c, c + 1]);
        }
    }
    obj
}
