use glam::Vec2;
use relight_format::TextureEncoding;

use super::*;

/// Random numbers of a fixed seed (PCG's generator of odd multiples).
struct Random(u64);

impl Random {
    fn next(&mut self) -> f64 {
        self.0 = self
            .0
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1);
        (self.0 >> 11) as f64 / (1u64 << 53) as f64
    }
}

/// A leaf with a round hole beside its middle, and a stalk of two texels.
fn leaf(x: f64, y: f64) -> f64 {
    let (dx, dy) = (x - 0.5, y - 0.45);
    let blade = 0.36 - (dx * dx * 2.2 + dy * dy).sqrt();
    let hole = ((x - 0.6).powi(2) + (y - 0.4).powi(2)).sqrt() - 0.07;
    let stalk = if y > 0.5 { 0.017 - dx.abs() } else { -1.0 };
    blade.min(hole).max(stalk)
}

fn texture(size: u32, shape: impl Fn(f64, f64) -> f64) -> Texture {
    let texels = (0..size * size).flat_map(|at| {
        let [x, y] = [at % size, at / size].map(|i| (f64::from(i) + 0.5) / f64::from(size));
        // One texel wide from clear to opaque, as drawing programs smooth it.
        let alpha = (shape(x, y) * f64::from(size) + 0.5).clamp(0.0, 1.0);
        [0, 0, 0, (alpha * 255.0).round() as u8]
    });
    Texture {
        width: size,
        height: size,
        encoding: TextureEncoding::Srgb,
        texels: texels.collect(),
    }
}

fn at_most(most: usize) -> Bound {
    Bound { wanted: most, most }
}

fn cutout(wrap: Wrap) -> Cutout {
    Cutout {
        slot: TextureSlot::whole(0),
        channel: Channel::Alpha,
        wrap: [wrap; 2],
        factor: 1.0,
        cutoff: 0.5,
    }
}

/// A bent sheet of `cells` cells per side whose texture coordinates reach from `low` to `high`; no
/// two of its triangles share a vertex.
fn sheet(cells: u32, low: Vec2, high: Vec2) -> (Vec<Vertex>, Vec<[u32; 3]>) {
    let mut vertices = Vec::new();
    let mut corner = |i: u32, j: u32| {
        let [s, t] = [i, j].map(|k| k as f32 / cells as f32);
        vertices.push(Vertex {
            position: Vec3::new(s, 0.3 * math::sin(3.0 * s), 0.7 * t),
            normal: Vec3::Y,
            tangent: Vec3::X,
            bitangent_sign: 1.0,
            uv: low + (high - low) * Vec2::new(s, t),
            second_uv: Vec2::ZERO,
        });
        vertices.len() as u32 - 1
    };
    let mut triangles = Vec::new();
    for j in 0..cells {
        for i in 0..cells {
            triangles.push([corner(i, j), corner(i, j + 1), corner(i + 1, j + 1)]);
            triangles.push([corner(i, j), corner(i + 1, j + 1), corner(i + 1, j)]);
        }
    }
    (vertices, triangles)
}

fn area(vertices: &[Vertex], triangle: [u32; 3]) -> f64 {
    let [a, b, c] = triangle.map(|index| vertices[index as usize].position.as_dvec3());
    (b - a).cross(c - a).length() * 0.5
}

/// The part of the surface where what is left and the texture disagree, of all of it.
fn difference(
    before: (&[Vertex], &[[u32; 3]]),
    after: (&[Vertex], &[[u32; 3]]),
    texture: &Texture,
    wrap: Wrap,
) -> f64 {
    let mask = mask(&cutout(wrap), texture);
    let size = f64::from(texture.width);
    let mut random = Random(7);
    let mut points = |vertices: &[Vertex], triangles: &[[u32; 3]], kept: bool| {
        let (mut wrong, mut all) = (0.0, 0.0);
        let samples = (200_000 / triangles.len()).max(16);
        for &triangle in triangles {
            let part = area(vertices, triangle) / samples as f64;
            for _ in 0..samples {
                let (s, t) = (random.next().sqrt(), random.next());
                let weights = [1.0 - s, s * (1.0 - t), s * t];
                let uv: DVec2 = (0..3)
                    .map(|k| vertices[triangle[k] as usize].uv.as_dvec2() * weights[k])
                    .sum();
                let opaque = mask.at(uv * size) >= 0.0;
                all += part;
                wrong += if opaque == kept { 0.0 } else { part };
            }
        }
        (wrong, all)
    };
    // What is left but should not be, and what should be left in all.
    let (extra, left) = points(after.0, after.1, true);
    let (opaque, all) = points(before.0, before.1, false);
    let missing = (opaque - (left - extra)).abs();
    (extra + missing) / all
}

/// Edges that only one triangle has, by positions.
fn open_edges(vertices: &[Vertex], triangles: &[[u32; 3]]) -> Vec<[Vec3; 2]> {
    let mut edges: HashMap<[[u32; 3]; 2], (i32, [Vec3; 2])> = HashMap::new();
    for triangle in triangles {
        for k in 0..3 {
            let ends = [k, (k + 1) % 3].map(|k| vertices[triangle[k] as usize].position);
            let [a, b] = ends.map(|end| (end + Vec3::ZERO).to_array().map(f32::to_bits));
            let (key, step) = if a < b { ([a, b], 1) } else { ([b, a], -1) };
            edges.entry(key).or_insert((0, ends)).0 += step;
        }
    }
    let open = edges.into_values().filter(|(count, _)| *count != 0);
    open.map(|(_, ends)| ends).collect()
}

#[test]
fn what_is_left_is_what_the_texture_shows() {
    let texture = texture(64, leaf);
    for (cells, wrap, low, high) in [
        (1, Wrap::Repeat, Vec2::ZERO, Vec2::ONE),
        (1, Wrap::Repeat, Vec2::new(-1.3, 0.2), Vec2::new(2.1, 3.7)),
        (7, Wrap::Repeat, Vec2::ZERO, Vec2::ONE),
        (7, Wrap::Mirror, Vec2::new(-1.3, 0.2), Vec2::new(2.1, 3.7)),
        (5, Wrap::Clamp, Vec2::new(-1.3, -0.2), Vec2::new(2.1, 3.7)),
        // Turned about, so that triangles run the other way in the texture.
        (3, Wrap::Repeat, Vec2::new(1.0, 0.0), Vec2::new(0.0, 1.0)),
        (40, Wrap::Repeat, Vec2::ZERO, Vec2::ONE),
    ] {
        let (mut vertices, triangles) = sheet(cells, low, high);
        let before = vertices.clone();
        let outcome = cut(
            &mut vertices,
            &triangles,
            &cutout(wrap),
            &texture,
            0.0,
            at_most(1 << 20),
        )
        .expect("few triangles");
        let difference = difference(
            (&before, &triangles),
            (&vertices, &outcome.triangles),
            &texture,
            wrap,
        );
        let case = format!("{cells} {wrap:?} {low}: {difference}, {outcome:?}");
        assert!(difference < 0.006, "{case}");
        // Both sides of a cut edge of the sheet were cut at the same points: an open edge lies on
        // the outline or on the border of the sheet.
        let mask = mask(&cutout(wrap), &texture);
        for ends in open_edges(&vertices, &outcome.triangles) {
            let middle = (ends[0] + ends[1]) * 0.5;
            let s = ends.map(|end| end.x).iter().sum::<f32>() * 0.5;
            let uv = low + (high - low) * Vec2::new(s, middle.z / 0.7);
            let on_border = [(middle.x, 1.0), (middle.z, 0.7)]
                .iter()
                .any(|(x, end)| x.abs() < 1e-5 || (x - end).abs() < 1e-5);
            let value = mask.at(uv.as_dvec2() * 64.0).abs();
            assert!(
                on_border || value < 127.0,
                "{case}: {ends:?} is open, {value}"
            );
        }
    }
}

#[test]
fn triangles_keep_their_side_and_their_place() {
    let texture = texture(32, leaf);
    let (mut vertices, triangles) = sheet(3, Vec2::ZERO, Vec2::ONE);
    let outcome = cut(
        &mut vertices,
        &triangles,
        &cutout(Wrap::Repeat),
        &texture,
        0.0,
        at_most(10_000),
    )
    .expect("few triangles");
    assert!(outcome.divided > 0 && outcome.flat == 0);
    for triangle in outcome.triangles {
        let [a, b, c] = triangle.map(|index| vertices[index as usize].position);
        assert!((b - a).cross(c - a).y > 0.0);
        for vertex in triangle.map(|index| vertices[index as usize]) {
            assert!((vertex.position.x - vertex.uv.x).abs() < 1e-6);
            assert!((vertex.position.z - 0.7 * vertex.uv.y).abs() < 1e-6);
        }
    }
}

#[test]
fn a_budget_coarsens_the_outline_and_then_refuses() {
    let texture = texture(128, leaf);
    let run = |most| {
        let (mut vertices, triangles) = sheet(1, Vec2::ZERO, Vec2::splat(4.0));
        cut(
            &mut vertices,
            &triangles,
            &cutout(Wrap::Repeat),
            &texture,
            0.0,
            at_most(most),
        )
    };
    let fine = run(1 << 20).expect("room");
    assert!((fine.tolerance - TOLERANCE).abs() < 1e-9);
    let coarse = run(fine.triangles.len() * 2 / 3).expect("room for a coarser one");
    assert!(coarse.tolerance > TOLERANCE);
    assert_eq!(run(20), Err(TooMuch::Triangles(20)));
}

/// Outlines get coarser for fewer triangles, but needles stay.
#[test]
fn a_wish_coarsens_the_outline_while_it_encloses_as_much() {
    let needles = |x: f64, y: f64| {
        let across = (x * 8.0).fract() - 0.5;
        (0.05 - across.abs()).min(0.45 - (y - 0.5).abs()) / 8.0
    };
    let run = |texture: &Texture, wanted| {
        let (mut vertices, triangles) = sheet(1, Vec2::ZERO, Vec2::splat(4.0));
        let bound = Bound {
            wanted,
            most: 1 << 20,
        };
        let cut = cut(
            &mut vertices,
            &triangles,
            &cutout(Wrap::Repeat),
            texture,
            0.0,
            bound,
        );
        let cut = cut.expect("room");
        let kept = cut
            .triangles
            .iter()
            .map(|triangle| area(&vertices, *triangle));
        (cut.triangles.len(), kept.sum::<f64>(), cut.tolerance)
    };
    for (texture, least) in [(texture(128, leaf), 4.0), (texture(128, needles), 0.25)] {
        let fine = run(&texture, 1 << 20);
        let coarse = run(&texture, 200);
        assert!(
            coarse.2 >= least && coarse.0 <= fine.0,
            "{coarse:?} {fine:?}"
        );
        assert!(
            (coarse.1 / fine.1 - 1.0).abs() < 0.05,
            "{coarse:?} {fine:?}"
        );
    }
}

#[test]
fn hostile_textures_and_coordinates_end_in_time() {
    let mut random = Random(3);
    let noise = texture(256, |_, _| 0.0);
    let noise = Texture {
        texels: (noise.texels.iter())
            .map(|_| (random.next() * 255.0) as u8)
            .collect(),
        ..noise
    };
    let one = Texture {
        width: 1,
        height: 2,
        texels: vec![0, 0, 0, 0, 0, 0, 0, 255],
        ..noise.clone()
    };
    for (texture, high, small) in [
        (&noise, 1.0, true),
        (&noise, 1e4, false),
        (&noise, 1e-6, true),
        (&one, 1.0, true),
        (&one, 1e8, false),
        (&one, 1e30, false),
    ] {
        for wrap in [Wrap::Repeat, Wrap::Mirror, Wrap::Clamp] {
            let (mut vertices, triangles) = sheet(2, Vec2::ZERO, Vec2::new(high, 0.7 * high));
            let result = cut(
                &mut vertices,
                &triangles,
                &cutout(wrap),
                texture,
                0.0,
                at_most(300_000),
            );
            assert!(
                result.is_ok() || !small,
                "{high} {wrap:?}: {:?}",
                result.err()
            );
        }
    }
    // Texture coordinates along a line, and all at one point.
    let leafy = texture(16, leaf);
    for shear in [Vec2::new(1.0, 0.0), Vec2::ZERO] {
        let (mut vertices, triangles) = sheet(4, Vec2::ZERO, Vec2::ONE);
        for vertex in &mut vertices {
            vertex.uv *= shear;
        }
        let outcome = cut(
            &mut vertices,
            &triangles,
            &cutout(Wrap::Repeat),
            &leafy,
            0.0,
            at_most(999),
        )
        .expect("nothing to divide");
        assert_eq!((outcome.divided, outcome.flat), (0, triangles.len()));
    }
}
