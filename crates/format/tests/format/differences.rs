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

fn compare(scene: &Scene) {
    let file = File::parse(&write_scene(scene).unwrap());
    let [vertices, triangles_raw, coefficients, basis] =
        [1, 2, 4, 5].map(|section: usize| file.sections[section].raw());
    let triangles = triangles(&triangles_raw);
    let found = scene
        .triangles
        .iter()
        .map(|t| (t.vertices, t.material, t.cluster));
    assert!(found.eq(triangles.iter().copied()));

    let count = scene.vertices.len();
    let expected: Vec<_> = (0..count as u32)
        .map(|v| expected_from(v, &triangles))
        .collect();
    let sum = |v: usize, among: std::ops::Range<usize>, values: &[i64]| {
        let [a, b, c] = expected[v].map(|other| {
            let other = other.map(|other| other as usize);
            other
                .filter(|other| *other < v && among.contains(other))
                .map_or(0, |other| values[other])
        });
        a + b - c
    };
    let differences = numbers(&vertices[12..], 4);
    for component in 0..12 {
        let exponent = vertices[component] as i8;
        let mut values = vec![0; count];
        for v in 0..count {
            let value = sum(v, 0..count, &values) + signed(differences[component * count + v]);
            // Modulo 2³².
            values[v] = i64::from(value as i32);
            let number = if exponent == -128 {
                let bits = values[v] as u32;
                f32::from_bits(if values[v] < 0 {
                    bits ^ 0x7fff_ffff
                } else {
                    bits
                })
            } else {
                (values[v] as f64 * f64::from(exponent).exp2()) as f32
            };
            let vertex = &scene.vertices[v];
            let all = [
                &vertex.position[..],
                &vertex.normal,
                &vertex.tangent,
                &vertex.uv,
            ]
            .concat();
            assert_eq!(number.to_bits(), all[component].to_bits());
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
        let first = cluster.first_vertex as usize;
        let members = first..first + cluster.vertex_count as usize;
        let channels = 4 * cluster.tiles as usize;
        for channel in 0..channels {
            let mut values = vec![0; count];
            for v in members.clone() {
                let difference = signed(differences[at]) * i64::from(steps[image]);
                values[v] = i64::from((sum(v, members.clone(), &values) + difference) as i16);
                let place = cluster.first_coefficient as usize + (v - first) * channels + channel;
                assert_eq!(values[v], i64::from(scene.coefficients[place]));
                at += 1;
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
}

#[test]
fn sections_hold_what_the_specification_says() {
    compare(&full_scene());
    for seed in 0..200 {
        compare(&scene(&mut Random::new(seed)));
    }
}
