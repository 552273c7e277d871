//! A second implementation of the sections that hold differences, written from FORMAT.md and
//! sharing nothing with the crate.

use relight_format::{Scene, write_scene};

use crate::container::File;
use crate::generate::{Random, full_scene, scene};

/// Numbers of `bytes` bytes each.
fn numbers(planes: &[u8], bytes: usize) -> Vec<u32> {
    let count = planes.len() / bytes;
    (0..count)
        .map(|i| {
            (0..bytes)
                .map(|k| u32::from(planes[k * count + i]) << (8 * k))
                .sum()
        })
        .collect()
}

fn signed(code: u32) -> i64 {
    let code = i64::from(code);
    if code % 2 == 0 {
        code / 2
    } else {
        -(code + 1) / 2
    }
}

/// Corners, materials and clusters.
fn triangles(raw: &[u8]) -> Vec<([u32; 3], u16, u16)> {
    let numbers = numbers(raw, 4);
    let count = numbers.len() / 4;
    let (mut next, mut material, mut cluster) = (0u32, 0u16, 0u16);
    (0..count)
        .map(|i| {
            let corners = [0, 1, 2].map(|corner| {
                let vertex = next.wrapping_sub(numbers[corner * count + i]);
                next = next.max(vertex + 1);
                vertex
            });
            let last = numbers[3 * count + i];
            material = material.wrapping_add(last as u16);
            cluster = cluster.wrapping_add((last >> 16) as u16);
            (corners, material, cluster)
        })
        .collect()
}

/// The two vertices and the third that a vertex is expected from.
fn expected_from(v: u32, triangles: &[([u32; 3], u16, u16)]) -> [Option<u32>; 3] {
    let turned = |corners: [u32; 3]| [0, 1, 2].map(|i| [0, 1, 2].map(|j| corners[(i + j) % 3]));
    let first = triangles.iter().enumerate().find_map(|(i, (corners, ..))| {
        let found = turned(*corners)
            .into_iter()
            .find(|[w, a, b]| *w == v && v > *a && v > *b);
        found.map(|[_, a, b]| (i, a, b))
    });
    let Some((i, a, b)) = first else {
        return [v.checked_sub(1); 3];
    };
    let last_with = |end: u32| {
        triangles[..i]
            .iter()
            .rev()
            .find(|(corners, ..)| corners.contains(&end))
    };
    let across = |end: u32| {
        let (corners, ..) = last_with(end)?;
        let shared = corners.contains(&a) && corners.contains(&b);
        corners
            .iter()
            .copied()
            .find(|c| *c != a && *c != b)
            .filter(|c| shared && *c < v)
    };
    [
        Some(a),
        Some(b),
        across(a).or_else(|| across(b)).or(Some(a)),
    ]
}

/// Unit normal of the first triangle that uses a vertex; zero if none does.
fn face_normal(scene: &Scene, v: usize) -> [f64; 3] {
    let mut triangles = scene.triangles.iter();
    let Some(triangle) = triangles.find(|t| t.vertices.contains(&(v as u32))) else {
        return [0.0; 3];
    };
    let [a, b, c] = (triangle.vertices).map(|v| scene.vertices[v as usize].position.map(f64::from));
    let u = [0, 1, 2].map(|i| b[i] - a[i]);
    let w = [0, 1, 2].map(|i| c[i] - a[i]);
    let n = [0, 1, 2].map(|i| {
        let (j, k) = ((i + 1) % 3, (i + 2) % 3);
        u[j] * w[k] - u[k] * w[j]
    });
    let length = (n[0] * n[0] + n[1] * n[1] + n[2] * n[2]).sqrt();
    n.map(|x| x / length)
}

/// The tangent that runs around +Y.
fn axis_tangent(scene: &Scene, v: usize) -> [f64; 3] {
    let [x, _, z] = scene.vertices[v].normal.map(f64::from);
    let length = (x * x + z * z).sqrt();
    if length > 0.0 {
        [z / length, 0.0, -x / length]
    } else {
        [1.0, 0.0, 0.0]
    }
}

#[allow(
    clippy::too_many_lines,
    reason = "every section against what it was made of"
)]
fn compare(scene: &Scene) {
    let file = File::parse(&write_scene(scene).unwrap());
    let [vertices, triangles_raw, coefficients, basis, texels] =
        [1, 2, 4, 5, 6].map(|section: usize| file.sections[section].raw());
    let triangles = triangles(&triangles_raw);
    let found = scene
        .triangles
        .iter()
        .map(|t| (t.vertices, t.material, t.cluster));
    assert!(found.eq(triangles.iter().copied()));

    let count = scene.vertices.len();
    let codes = numbers(&vertices[13..][..4 * count], 4);
    // The place of every vertex, the vertex of every place.
    let (mut place, mut first): (Vec<usize>, Vec<usize>) = (Vec::new(), Vec::new());
    for (v, code) in codes.iter().enumerate() {
        place.push(first.len() - *code as usize);
        if *code == 0 {
            first.push(v);
        }
        let own = &scene.vertices[first[place[v]]];
        assert_eq!(own.position, scene.vertices[v].position);
    }
    let at_places: Vec<_> = triangles
        .iter()
        .map(|(corners, ..)| (corners.map(|v| place[v as usize] as u32), 0, 0))
        .collect();
    let from = |count: usize, triangles: &[([u32; 3], u16, u16)]| -> Vec<[Option<u32>; 3]> {
        (0..count as u32)
            .map(|v| expected_from(v, triangles))
            .collect()
    };
    let of_vertices = from(count, &triangles);
    let of_places = from(first.len(), &at_places);
    let sum = |of: &[[Option<u32>; 3]], v: usize, among: std::ops::Range<usize>, values: &[i64]| {
        let [a, b, c] = of[v].map(|other| {
            let other = other.map(|other| other as usize);
            other
                .filter(|other| *other < v && among.contains(other))
                .map_or(0, |other| values[other])
        });
        a + b - c
    };
    let decoded = |value: i64, exponent: i8| {
        if exponent == -128 {
            let bits = value as u32;
            f32::from_bits(if value < 0 { bits ^ 0x7fff_ffff } else { bits })
        } else {
            (value as f64 * relight_format::math::exp2(f64::from(exponent))) as f32
        }
    };
    let all = |v: usize| {
        let vertex = &scene.vertices[v];
        let (normal, tangent) = (&vertex.normal, &vertex.tangent);
        [&vertex.position[..], normal, tangent, &vertex.uv].concat()
    };
    let positions = numbers(&vertices[13 + 4 * count..][..12 * first.len()], 4);
    let others = numbers(&vertices[13 + 4 * count + 12 * first.len()..], 4);
    for component in 0..12 {
        let exponent = vertices[component] as i8;
        let (of, differences, vertex_of): (_, &[u32], Box<dyn Fn(usize) -> usize>) =
            if component < 3 {
                let start = component * first.len();
                (
                    &of_places,
                    &positions[start..][..first.len()],
                    Box::new(|p| first[p]),
                )
            } else {
                let start = (component - 3) * count;
                (&of_vertices, &others[start..][..count], Box::new(|v| v))
            };
        let by_face = (3..6).contains(&component) && vertices[12] & 1 != 0;
        let by_axis = (6..9).contains(&component) && vertices[12] & 2 != 0;
        let mut values = vec![0; differences.len()];
        for i in 0..values.len() {
            let other = if by_face {
                Some(face_normal(scene, i)[component - 3])
            } else if by_axis {
                Some(axis_tangent(scene, i)[component - 6])
            } else {
                None
            };
            let expected = match other {
                None => sum(of, i, 0..values.len(), &values),
                Some(x) if x.is_nan() => 0,
                Some(x) if exponent == -128 => {
                    let bits = (x as f32).to_bits() as i32;
                    i64::from(if bits < 0 { bits ^ 0x7fff_ffff } else { bits })
                }
                Some(x) => {
                    (x / relight_format::math::exp2(f64::from(exponent))).round_ties_even() as i64
                }
            };
            // Modulo 2³².
            values[i] = i64::from((expected + signed(differences[i])) as i32);
            let number = decoded(values[i], exponent);
            assert_eq!(number.to_bits(), all(vertex_of(i))[component].to_bits());
        }
    }

    let images: usize = scene
        .clusters
        .iter()
        .map(|cluster| 4 * cluster.tiles as usize)
        .sum();
    let steps = numbers(&coefficients[..2 * images], 2);
    let differences = numbers(&coefficients[2 * images..], 2);
    let (mut image, mut at) = (0, 0);
    for cluster in &scene.clusters {
        let start = cluster.first_vertex as usize;
        let vertices = start..start + cluster.vertex_count as usize;
        let channels = 4 * cluster.tiles as usize;
        let begins = first.partition_point(|v| *v < vertices.start);
        let members = begins..first.partition_point(|v| *v < vertices.end);
        for channel in 0..channels {
            let mut values = vec![0; first.len()];
            for p in members.clone() {
                let difference = signed(differences[at]) * i64::from(steps[image]);
                let expected = sum(&of_places, p, members.clone(), &values);
                values[p] = i64::from((expected + difference) as i16);
                at += 1;
            }
            for v in vertices.clone() {
                let index = cluster.first_coefficient as usize + (v - start) * channels + channel;
                assert_eq!(values[place[v]], i64::from(scene.coefficients[index]));
            }
            image += 1;
        }
    }

    let n = scene.visibility.basis_resolution as usize;
    let tiles = scene
        .basis
        .chunks_exact(4 * n * n)
        .zip(basis.chunks_exact(4 * n * n));
    for (tile, differences) in tiles {
        for (channel, differences) in differences.chunks_exact(n * n).enumerate() {
            let at = |x: usize, y: usize| i32::from(tile[4 * (y * n + x) + channel]);
            for (i, difference) in differences.iter().enumerate() {
                let (x, y) = (i % n, i / n);
                let (l, a) = match (x, y) {
                    (0, 0) => (0, 0),
                    (0, _) => (at(0, y - 1), at(0, y - 1)),
                    (_, 0) => (at(x - 1, 0), at(x - 1, 0)),
                    _ => (at(x - 1, y), at(x, y - 1)),
                };
                let c = match (x, y) {
                    (_, 0) => l,
                    (0, _) => a,
                    _ => at(x - 1, y - 1),
                };
                let r = if y > 0 && x + 1 < n {
                    at(x + 1, y - 1)
                } else {
                    a
                };
                let l2 = if x > 1 { at(x - 2, y) } else { l };
                let a2 = if y > 1 { at(x, y - 2) } else { a };
                let sum = 12 * l + 6 * a + 6 * r - c - 2 * l2 - 5 * a2 + 8;
                let expected = sum.div_euclid(16).clamp(-127, 127);
                assert_eq!((expected as u8).wrapping_add(*difference), at(x, y) as u8);
            }
        }
    }

    let mut left = &texels[..];
    for texture in &scene.textures {
        let (width, count) = (texture.width as usize, texture.texels.len() / 4);
        let by_green = left[0] == 1;
        for channel in 0..4 {
            let stored = |channel: usize, i: usize| left[1 + channel * count + i];
            for i in 0..count {
                let (x, y) = (i % width, i / width);
                let at = |inside: bool, before: usize| {
                    let texel = inside.then(|| texture.texels[4 * (i - before) + channel]);
                    i16::from(texel.unwrap_or(0))
                };
                let (l, a) = (at(x > 0, 1), at(y > 0, width));
                let c = at(x > 0 && y > 0, width + 1);
                let mut three = [l, a, l + a - c];
                three.sort_unstable();
                let green = if by_green && channel % 2 == 0 {
                    stored(1, i)
                } else {
                    0
                };
                let difference = stored(channel, i).wrapping_add(green);
                let texel = (three[1] as u8).wrapping_add(difference);
                assert_eq!(texel, texture.texels[4 * i + channel]);
            }
        }
        left = &left[1 + 4 * count..];
    }
    assert!(left.is_empty());
}

#[test]
fn sections_hold_what_the_specification_says() {
    compare(&full_scene());
    for seed in 0..200 {
        compare(&scene(&mut Random::new(seed)));
    }
}
