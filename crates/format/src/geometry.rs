//! Triangles, vertices and coefficients as differences from what earlier ones predict: on a
//! surface neighbours are alike, and little is left for compression.
//!
//! A vertex is expected to complete a parallelogram with the triangle on the other side of
//! an edge (Touma & Gotsman 1998). All arrays come back bit for bit, whatever they hold; they
//! take few bytes if triangles come in an order in which most share an edge with one shortly
//! before, vertices in the order in which triangles use them, and attributes are multiples
//! of steps.

use std::collections::HashMap;
use std::ops::Range;

use bytemuck::Zeroable as _;

mod coefficients;
mod numbers;

use numbers::{element, from_integer, from_zigzag, planes, step, to_integer, zigzag};

pub(crate) use coefficients::{decode_coefficients, encode_coefficients};

use crate::{CHANNELS_PER_TILE, Cluster, Triangle, Vertex};

/// Numbers of a [`Vertex`].
const COMPONENTS: usize = size_of::<Vertex>() / size_of::<f32>();
/// In place of an exponent: of numbers that are multiples of no step.
const NO_STEP: i8 = i8::MIN;
/// Multiples of a step up to this keep to 32 bits.
const MAX_MULTIPLE: f64 = (1u32 << 30) as f64;

/// For every vertex, three earlier ones: it is expected at the first two's sum less the third.
pub(crate) struct Parallelograms(Vec<[u32; 3]>);

impl Parallelograms {
    pub(crate) fn new(triangles: &[Triangle], vertices: usize) -> Self {
        // Where nothing better is known, the vertex before.
        let mut expected: Vec<[u32; 3]> = (0..vertices as u32)
            .map(|vertex| [vertex.saturating_sub(1); 3])
            .collect();
        let mut known = vec![false; vertices];
        // The last triangle that used a vertex.
        let mut last = vec![[u32::MAX; 3]; vertices];
        for triangle in triangles {
            let corners = triangle.vertices;
            // Not checked yet when they are read.
            if corners.iter().any(|&corner| corner as usize >= vertices) {
                continue;
            }
            for i in 0..3 {
                let [new, a, b] = [0, 1, 2].map(|j| corners[(i + j) % 3]);
                if known[new as usize] || new <= a || new <= b {
                    continue;
                }
                known[new as usize] = true;
                let across = [a, b].iter().find_map(|&end| {
                    let other = last[end as usize];
                    let shares_edge = other.contains(&a) && other.contains(&b);
                    let across = other.into_iter().find(|corner| ![a, b].contains(corner));
                    across.filter(|&across| shares_edge && across < new)
                });
                expected[new as usize] = [a, b, across.unwrap_or(a)];
            }
            for corner in corners {
                last[corner as usize] = corners;
            }
        }
        Self(expected)
    }

    /// What is expected of a vertex, after those before it; others than those `among` count
    /// as zero.
    fn of(&self, vertex: usize, among: &Range<usize>, value: impl Fn(usize) -> i32) -> i32 {
        let [a, b, c] = self.0[vertex].map(|other| {
            let other = other as usize;
            if other < vertex && among.contains(&other) {
                value(other)
            } else {
                0
            }
        });
        a.wrapping_add(b).wrapping_sub(c)
    }
}

/// Vertices that share their position and coefficients with an earlier one of their cluster.
/// Those that do not are the places, numbered in their order.
pub(crate) struct Places {
    /// Of every vertex.
    numbers: Vec<u32>,
    /// The vertex of every place.
    vertices: Vec<u32>,
    /// The first place of every cluster, and their number.
    first: Vec<u32>,
}

impl Places {
    /// Which vertices can share.
    pub(crate) fn find(vertices: &[Vertex], clusters: &[Cluster], coefficients: &[i16]) -> Self {
        let mut places = Self {
            numbers: Vec::with_capacity(vertices.len()),
            vertices: Vec::new(),
            first: Vec::with_capacity(clusters.len() + 1),
        };
        let mut known: HashMap<[u32; 3], Vec<u32>> = HashMap::new();
        for cluster in clusters {
            places.first.push(places.vertices.len() as u32);
            known.clear();
            let channels = cluster.tiles as usize * CHANNELS_PER_TILE;
            let row = |vertex: u32| {
                let start = cluster.first_coefficient as usize;
                let start = start + (vertex - cluster.first_vertex) as usize * channels;
                &coefficients[start..][..channels]
            };
            for vertex in cluster.first_vertex..cluster.first_vertex + cluster.vertex_count {
                let position = vertices[vertex as usize].position.map(f32::to_bits);
                let others = known.entry(position).or_default();
                let newest = others.iter().rev().take(MOST_ALIKE);
                let same = newest
                    .copied()
                    .find(|&place| row(places.vertices[place as usize]) == row(vertex));
                let place = same.unwrap_or_else(|| {
                    places.vertices.push(vertex);
                    others.push(places.vertices.len() as u32 - 1);
                    places.vertices.len() as u32 - 1
                });
                places.numbers.push(place);
            }
        }
        places.first.push(places.vertices.len() as u32);
        places
    }

    /// For every vertex 0 if it is a place of its own, else how long ago its place came up.
    fn codes(&self) -> Vec<u32> {
        let mut next = 0;
        (self.numbers.iter())
            .map(|&number| {
                let code = next - number;
                next = next.max(number + 1);
                code
            })
            .collect()
    }

    /// The inverse of [`Self::codes`]; none if a vertex has a place of another cluster.
    fn from_codes(codes: impl Iterator<Item = u32>, clusters: &[Cluster]) -> Option<Self> {
        let mut places = Self {
            numbers: Vec::new(),
            vertices: Vec::new(),
            first: Vec::with_capacity(clusters.len() + 1),
        };
        let mut codes = codes.enumerate();
        for cluster in clusters {
            let first = places.vertices.len() as u32;
            places.first.push(first);
            for _ in 0..cluster.vertex_count {
                let (vertex, code) = codes.next()?;
                let next = places.vertices.len() as u32;
                if code == 0 {
                    places.vertices.push(vertex as u32);
                } else if code > next - first {
                    return None;
                }
                places.numbers.push(next - code);
            }
        }
        places.first.push(places.vertices.len() as u32);
        Some(places)
    }

    /// What is expected of places: what is of vertices, were those of a place one.
    fn expected(&self, triangles: &[Triangle]) -> Parallelograms {
        let number = |vertex: u32| self.numbers.get(vertex as usize).copied();
        let triangles: Vec<Triangle> = (triangles.iter())
            .map(|triangle| Triangle {
                vertices: (triangle.vertices).map(|vertex| number(vertex).unwrap_or(u32::MAX)),
                ..*triangle
            })
            .collect();
        Parallelograms::new(&triangles, self.vertices.len())
    }

    /// Places and channels of every cluster.
    fn clusters<'a>(
        &'a self,
        clusters: &'a [Cluster],
    ) -> impl Iterator<Item = (Range<usize>, usize)> + 'a {
        (clusters.iter().zip(self.first.windows(2))).map(|(cluster, ends)| {
            let channels = cluster.tiles as usize * CHANNELS_PER_TILE;
            (ends[0] as usize..ends[1] as usize, channels)
        })
    }
}

/// Components of positions, normals, tangents.
const POSITION: Range<usize> = 0..3;
const NORMAL: Range<usize> = 3..6;
const TANGENT: Range<usize> = 6..9;
/// Places of one position that a vertex is compared with.
const MOST_ALIKE: usize = 8;
/// Bits that say how normals and tangents are expected.
const FACE_NORMALS: u8 = 1;
const AXIS_TANGENTS: u8 = 2;

/// Vertices as differences, with the steps of their numbers before them.
pub(crate) fn encode_vertices(
    vertices: &[Vertex],
    triangles: &[Triangle],
    places: &Places,
) -> Vec<u8> {
    let numbers: &[[f32; COMPONENTS]] = bytemuck::cast_slice(vertices);
    let of_vertices = Parallelograms::new(triangles, vertices.len());
    let of_places = places.expected(triangles);
    let mut steps = [0; COMPONENTS];
    let mut integers: [Vec<i32>; COMPONENTS] = [const { Vec::new() }; COMPONENTS];
    for component in 0..COMPONENTS {
        let numbers: Vec<f32> = if POSITION.contains(&component) {
            let places = places.vertices.iter();
            places
                .map(|&vertex| numbers[vertex as usize][component])
                .collect()
        } else {
            numbers.iter().map(|vertex| vertex[component]).collect()
        };
        steps[component] = step(&numbers);
        let numbers = numbers.into_iter();
        integers[component] = numbers.map(|x| to_integer(x, steps[component])).collect();
    }
    let mut differences: [Vec<u32>; COMPONENTS] = std::array::from_fn(|component| {
        let values = &integers[component];
        let expected = if POSITION.contains(&component) {
            &of_places
        } else {
            &of_vertices
        };
        (0..values.len())
            .map(|i| {
                let expected = expected.of(i, &(0..values.len()), |other| values[other]);
                zigzag(values[i].wrapping_sub(expected))
            })
            .collect()
    });
    let mut modes = 0;
    let others = [
        (FACE_NORMALS, NORMAL, face_normals(vertices, triangles)),
        (AXIS_TANGENTS, TANGENT, axis_tangents(vertices)),
    ];
    for (mode, components, expected) in others {
        let other = components.clone().zip(0..).map(|(component, axis)| {
            let step = steps[component];
            let values = integers[component].iter().zip(&expected);
            values
                .map(|(value, expected)| zigzag(value.wrapping_sub(expect(expected[axis], step))))
                .collect::<Vec<u32>>()
        });
        let other: Vec<Vec<u32>> = other.collect();
        // About the bits that differences take.
        let bits = |differences: &[Vec<u32>]| -> u64 {
            let differences = differences.iter().flatten();
            differences
                .map(|code| u64::from(u32::BITS - code.leading_zeros()))
                .sum()
        };
        if bits(&other) < bits(&differences[components.clone()]) {
            modes |= mode;
            differences[components].clone_from_slice(&other);
        }
    }
    let mut bytes: Vec<u8> = steps.iter().map(|step| *step as u8).collect();
    bytes.push(modes);
    bytes.extend(planes(&to_bytes(&places.codes())));
    let (positions, rest) = differences.split_at(POSITION.end);
    bytes.extend(planes(&to_bytes(&positions.concat())));
    bytes.extend(planes(&to_bytes(&rest.concat())));
    bytes
}

fn to_bytes(numbers: &[u32]) -> Vec<[u8; 4]> {
    numbers.iter().map(|number| number.to_le_bytes()).collect()
}

/// The inverse of [`encode_vertices`]; none if the bytes are not those of the clusters'
/// vertices.
pub(crate) fn decode_vertices(
    bytes: &[u8],
    triangles: &[Triangle],
    clusters: &[Cluster],
) -> Option<(Vec<Vertex>, Places)> {
    let count: u64 = (clusters.iter()).map(|c| u64::from(c.vertex_count)).sum();
    let (steps, bytes) = bytes.split_at_checked(COMPONENTS)?;
    let (&modes, bytes) = bytes.split_first()?;
    let count = usize::try_from(count).ok()?;
    let (codes, bytes) = bytes.split_at_checked(count.checked_mul(4)?)?;
    let codes = (0..count).map(|vertex| u32::from_le_bytes(element(codes, vertex)));
    let places = Places::from_codes(codes, clusters)?;
    let (positions, rest) = bytes.split_at_checked(12 * places.vertices.len())?;
    if rest.len() != 36 * count || modes > FACE_NORMALS | AXIS_TANGENTS {
        return None;
    }
    let mut vertices = vec![Vertex::zeroed(); count];
    let of_places = places.expected(triangles);
    let mut decoded = vec![0i32; places.vertices.len()];
    for component in POSITION {
        let step = steps[component] as i8;
        let start = component * decoded.len();
        undo(&mut decoded, &of_places, positions, start);
        for (vertex, &place) in vertices.iter_mut().zip(&places.numbers) {
            vertex.position[component] = from_integer(decoded[place as usize], step);
        }
    }
    let of_vertices = Parallelograms::new(triangles, count);
    let mut decoded = vec![0i32; count];
    let mut expected = Vec::new();
    for component in NORMAL.start..COMPONENTS {
        let start = (component - NORMAL.start) * count;
        let step = steps[component] as i8;
        if component == NORMAL.start && modes & FACE_NORMALS != 0 {
            expected = face_normals(&vertices, triangles);
        } else if component == TANGENT.start && modes & AXIS_TANGENTS != 0 {
            expected = axis_tangents(&vertices);
        } else if component == TANGENT.start || component == TANGENT.end {
            expected.clear();
        }
        if expected.is_empty() {
            undo(&mut decoded, &of_vertices, rest, start);
        } else {
            for (vertex, (value, expected)) in decoded.iter_mut().zip(&expected).enumerate() {
                let difference = u32::from_le_bytes(element(rest, start + vertex));
                let expected = expect(expected[component % 3], step);
                *value = expected.wrapping_add(from_zigzag(difference));
            }
        }
        let numbers: &mut [[f32; COMPONENTS]] = bytemuck::cast_slice_mut(&mut vertices);
        for (numbers, value) in numbers.iter_mut().zip(&decoded) {
            numbers[component] = from_integer(*value, step);
        }
    }
    Some((vertices, places))
}

/// Second texture coordinates as differences, with the steps of both before them.
pub(crate) fn encode_uvs(uvs: &[[f32; 2]], triangles: &[Triangle]) -> Vec<u8> {
    let expected = Parallelograms::new(triangles, uvs.len());
    let all = 0..uvs.len();
    let mut bytes = Vec::with_capacity(2 + 8 * uvs.len());
    let mut differences = Vec::with_capacity(2 * uvs.len());
    for component in 0..2 {
        let numbers: Vec<f32> = uvs.iter().map(|uv| uv[component]).collect();
        let step = step(&numbers);
        bytes.push(step as u8);
        let values: Vec<i32> = (numbers.into_iter().map(|x| to_integer(x, step))).collect();
        differences.extend(all.clone().map(|i| {
            let expected = expected.of(i, &all, |other| values[other]);
            zigzag(values[i].wrapping_sub(expected))
        }));
    }
    bytes.extend(planes(&to_bytes(&differences)));
    bytes
}

/// The inverse of [`encode_uvs`]; none if the bytes are not those of `count` vertices, of which there
/// are some.
pub(crate) fn decode_uvs(
    bytes: &[u8],
    triangles: &[Triangle],
    count: usize,
) -> Option<Vec<[f32; 2]>> {
    let (steps, differences) = bytes.split_at_checked(2)?;
    if count == 0 || differences.len() != count.checked_mul(8)? {
        return None;
    }
    let expected = Parallelograms::new(triangles, count);
    let mut uvs = vec![[0.0; 2]; count];
    let mut decoded = vec![0i32; count];
    for (component, &step) in steps.iter().enumerate() {
        undo(&mut decoded, &expected, differences, component * count);
        for (uv, value) in uvs.iter_mut().zip(&decoded) {
            uv[component] = from_integer(*value, step as i8);
        }
    }
    Some(uvs)
}

/// Adds differences, from number `start` of `planes` on, to what is expected.
fn undo(values: &mut [i32], expected: &Parallelograms, planes: &[u8], start: usize) {
    let all = 0..values.len();
    for i in all.clone() {
        let difference = u32::from_le_bytes(element(planes, start + i));
        let expected = expected.of(i, &all, |other| values[other]);
        values[i] = expected.wrapping_add(from_zigzag(difference));
    }
}

/// An expected number in steps.
fn expect(number: f64, step: i8) -> i32 {
    // Bits of what is not a number differ between processors.
    if number.is_nan() {
        return 0;
    }
    if step == NO_STEP {
        return to_integer(number as f32, step);
    }
    (number / 2f64.powi(i32::from(step))).round_ties_even() as i32
}

/// Unit normal of the first triangle that uses a vertex. Sums, products, quotients and square
/// roots are rounded alike everywhere.
fn face_normals(vertices: &[Vertex], triangles: &[Triangle]) -> Vec<[f64; 3]> {
    let mut normals = vec![[0.0; 3]; vertices.len()];
    let mut known = vec![false; vertices.len()];
    for triangle in triangles {
        let corners = triangle
            .vertices
            .map(|vertex| vertices.get(vertex as usize));
        let [Some(a), Some(b), Some(c)] = corners else {
            continue;
        };
        let edge = |end: &Vertex| {
            [0, 1, 2].map(|axis| f64::from(end.position[axis]) - f64::from(a.position[axis]))
        };
        let (u, v) = (edge(b), edge(c));
        let normal = [(1, 2), (2, 0), (0, 1)].map(|(i, j)| u[i] * v[j] - u[j] * v[i]);
        let [x, y, z] = normal.map(|x| x * x);
        let length = (x + y + z).sqrt();
        for vertex in triangle.vertices {
            if !std::mem::replace(&mut known[vertex as usize], true) {
                normals[vertex as usize] = normal.map(|x| x / length);
            }
        }
    }
    normals
}

/// Unit tangents that run around the vertical axis.
fn axis_tangents(vertices: &[Vertex]) -> Vec<[f64; 3]> {
    let tangent = |vertex: &Vertex| {
        let [x, _, z] = vertex.normal.map(f64::from);
        let length = (x * x + z * z).sqrt();
        if length > 0.0 {
            [z / length, 0.0, -x / length]
        } else {
            [1.0, 0.0, 0.0]
        }
    };
    vertices.iter().map(tangent).collect()
}

/// Triangles: how long before the newest vertex their corners are, and how their material
/// and cluster differ from the last one's.
pub(crate) fn encode_triangles(triangles: &[Triangle]) -> Vec<u8> {
    let mut codes = vec![[0; 4]; 4 * triangles.len()];
    let mut next = 0u32;
    let mut last = Triangle::zeroed();
    for (i, triangle) in triangles.iter().enumerate() {
        for (corner, vertex) in triangle.vertices.into_iter().enumerate() {
            codes[corner * triangles.len() + i] = next.wrapping_sub(vertex).to_le_bytes();
            next = next.max(vertex.saturating_add(1));
        }
        let [a, b] = triangle.material.wrapping_sub(last.material).to_le_bytes();
        let [c, d] = triangle.cluster.wrapping_sub(last.cluster).to_le_bytes();
        codes[3 * triangles.len() + i] = [a, b, c, d];
        last = *triangle;
    }
    planes(&codes)
}

/// The inverse of [`encode_triangles`]; none if the length is not that of any triangles.
pub(crate) fn decode_triangles(bytes: &[u8]) -> Option<Vec<Triangle>> {
    if !bytes.len().is_multiple_of(size_of::<Triangle>()) {
        return None;
    }
    let count = bytes.len() / size_of::<Triangle>();
    let mut triangles = vec![Triangle::zeroed(); count];
    let mut next = 0u32;
    let mut last = Triangle::zeroed();
    for (i, triangle) in triangles.iter_mut().enumerate() {
        for (corner, vertex) in triangle.vertices.iter_mut().enumerate() {
            let code = u32::from_le_bytes(element(bytes, corner * count + i));
            *vertex = next.wrapping_sub(code);
            next = next.max(vertex.saturating_add(1));
        }
        let [a, b, c, d] = element(bytes, 3 * count + i);
        triangle.material = last.material.wrapping_add(u16::from_le_bytes([a, b]));
        triangle.cluster = last.cluster.wrapping_add(u16::from_le_bytes([c, d]));
        last = *triangle;
    }
    Some(triangles)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn random() -> impl FnMut() -> u32 {
        let mut state = 7u64;
        move || {
            state = (state.wrapping_mul(6_364_136_223_846_793_005)).wrapping_add(1);
            (state >> 33) as u32
        }
    }

    fn come_back(
        triangles: &[Triangle],
        vertices: &[Vertex],
        coefficients: &[i16],
        clusters: &[Cluster],
    ) {
        let decoded = decode_triangles(&encode_triangles(triangles)).unwrap();
        assert_eq!(decoded, triangles);
        let places = Places::find(vertices, clusters, coefficients);
        let bytes = encode_vertices(vertices, triangles, &places);
        let (decoded, again) = decode_vertices(&bytes, triangles, clusters).unwrap();
        assert_eq!(
            bytemuck::cast_slice::<_, u32>(&decoded),
            bytemuck::cast_slice::<_, u32>(vertices)
        );
        assert_eq!(again.numbers, places.numbers);
        assert_eq!(again.vertices, places.vertices);
        let bytes = encode_coefficients(coefficients, triangles, clusters, &places);
        assert_eq!(
            decode_coefficients(&bytes, triangles, clusters, &again).unwrap(),
            coefficients
        );
    }

    /// Of so many vertices and tiles each.
    fn clusters<const N: usize>(sizes: [[u32; 2]; N]) -> [Cluster; N] {
        let mut next = Cluster::zeroed();
        sizes.map(|[vertex_count, tiles]| {
            let cluster = Cluster {
                vertex_count,
                tiles,
                ..next
            };
            next.first_vertex += vertex_count;
            next.first_coefficient += vertex_count * tiles * CHANNELS_PER_TILE as u32;
            next.first_tile += tiles;
            cluster
        })
    }

    #[test]
    fn anything_comes_back() {
        let mut random = random();
        come_back(&[], &[], &[], &[]);
        for count in [1u32, 2, 17, 300] {
            let triangles: Vec<Triangle> = (0..2 * count)
                .map(|i| Triangle {
                    // Some corners do not exist.
                    vertices: [(); 3].map(|()| random() % (count + 2)),
                    material: random() as u16,
                    cluster: (i / 5) as u16,
                })
                .chain([Triangle {
                    vertices: [u32::MAX, 0, u32::MAX],
                    material: 0,
                    cluster: 0,
                }])
                .collect();
            for kind in 0..4 {
                let number = |random: u32| match kind {
                    // Any bits: infinities and all.
                    0 => f32::from_bits(random << 1 ^ random >> 20),
                    1 => (random % 1000) as f32 / 64.0 - 7.0,
                    2 => {
                        if random.is_multiple_of(2) {
                            -0.0
                        } else {
                            0.0
                        }
                    }
                    _ => {
                        f32::from_bits(1 << (random % 24))
                            * if random.is_multiple_of(2) { -1.0 } else { 1e30 }
                    }
                };
                let vertices: Vec<Vertex> = (0..count)
                    .map(|_| bytemuck::cast([(); COMPONENTS].map(|()| number(random()))))
                    .collect();
                let clusters = clusters([[count / 3, 2], [0, 1], [count - count / 3, 1]]);
                let images = clusters
                    .iter()
                    .map(|cluster| cluster.vertex_count * cluster.tiles * 4);
                let factor = if kind == 0 { 1 } else { 3 * kind };
                let coefficients: Vec<i16> = (0..images.sum::<u32>())
                    .map(|_| (random() as i16).wrapping_mul(factor))
                    .collect();
                come_back(&triangles, &vertices, &coefficients, &clusters);
            }
        }
    }

    #[test]
    fn second_uvs_come_back() {
        let mut random = random();
        for count in [1u32, 2, 17, 300] {
            let triangles: Vec<Triangle> = (0..2 * count)
                .map(|_| Triangle {
                    vertices: [(); 3].map(|()| random() % (count + 2)),
                    ..Triangle::zeroed()
                })
                .collect();
            // Steps, and any bits.
            let steps = |random: u32| (random % 1000) as f32 / 64.0 - 7.0;
            let bits = |random: u32| f32::from_bits(random << 1 ^ random >> 20);
            let uvs: Vec<[f32; 2]> = (0..count)
                .map(|_| [steps(random()), bits(random())])
                .collect();
            let bytes = encode_uvs(&uvs, &triangles);
            let count = count as usize;
            let decoded = decode_uvs(&bytes, &triangles, count).unwrap();
            assert_eq!(
                bytemuck::cast_slice::<_, u32>(&decoded),
                bytemuck::cast_slice::<_, u32>(&uvs)
            );
            assert!(decode_uvs(&bytes, &triangles, count + 1).is_none());
            assert!(decode_uvs(&bytes[..bytes.len() - 1], &triangles, count).is_none());
        }
        for length in [0, 1, 2] {
            assert!(decode_uvs(&[0; 2][..length], &[], 0).is_none());
        }
    }

    #[test]
    fn lengths_are_checked() {
        assert!(decode_triangles(&[0; 17]).is_none());
        let clusters = clusters([[2, 1], [1, 1]]);
        // One vertex of the first cluster shares a place.
        let codes = |codes: [u8; 3], places: usize| {
            let mut bytes = vec![0; COMPONENTS + 1];
            bytes.extend(codes);
            bytes.resize(COMPONENTS + 1 + 3 * 40 + 12 * places, 0);
            bytes
        };
        let decode = |bytes: &[u8]| decode_vertices(bytes, &[], &clusters);
        let shared = codes([0, 1, 0], 2);
        let (vertices, places) = decode(&shared).unwrap();
        assert_eq!(vertices.len(), 3);
        assert_eq!(places.numbers, [0, 0, 1]);
        assert!(decode(&codes([0, 0, 0], 3)).is_some());
        for wrong in [
            &shared[..COMPONENTS],
            &shared[..shared.len() - 1],
            &codes([0, 1, 0], 3),
            &codes([0, 2, 0], 2),
            &codes([1, 0, 0], 2),
            // The place of another cluster.
            &codes([0, 0, 1], 2),
            &codes([0, 0, 255], 2),
        ] {
            assert!(decode(wrong).is_none());
        }
        let mut unknown_mode = shared.clone();
        unknown_mode[COMPONENTS] = 4;
        assert!(decode(&unknown_mode).is_none());
        let decode = |length: usize, clusters: &[Cluster]| {
            decode_coefficients(&vec![0; length], &[], clusters, &places)
        };
        let found = decode(2 * (8 + 8), &clusters);
        assert_eq!(found.map(|coefficients| coefficients.len()), Some(12));
        assert!(decode(2 * (8 + 8) - 1, &clusters).is_none());
        let mut tiles = clusters;
        tiles[0].tiles = u32::MAX;
        assert!(decode(0, &tiles).is_none());
    }

    /// Flat triangles, which share no vertices but every position.
    #[test]
    fn vertices_of_one_place_share_what_is_known_of_it() {
        let n = 24;
        let at = |x: u32, z: u32| {
            let y = ((x * x + 3 * z * x) % 17) as f32 / 32.0;
            [x as f32 / 64.0, y, z as f32 / 64.0]
        };
        let corners = (0..n * n).flat_map(|i| {
            let (x, z) = (i % n, i / n);
            let [a, b, c, d] = [(x, z), (x, z + 1), (x + 1, z), (x + 1, z + 1)];
            [[a, b, c], [c, b, d]]
        });
        let channels = CHANNELS_PER_TILE as u32;
        let mut coefficients = Vec::new();
        let mut vertices = Vec::new();
        for triangle in corners {
            let [a, b, c] = triangle.map(|(x, z)| at(x, z));
            let edge = |end: [f32; 3]| [0, 1, 2].map(|axis| end[axis] - a[axis]);
            let (u, v) = (edge(b), edge(c));
            let normal = [(1, 2), (2, 0), (0, 1)].map(|(i, j)| u[i] * v[j] - u[j] * v[i]);
            let length = normal.iter().map(|x| x * x).sum::<f32>().sqrt();
            // Minus zero is a multiple of nothing.
            let normal = normal.map(|x| (x / length * 16384.0).round() / 16384.0 + 0.0);
            for (x, z) in triangle {
                vertices.push(Vertex {
                    position: at(x, z),
                    normal,
                    tangent: [1.0, 0.0, 0.0, 1.0],
                    uv: [0.0; 2],
                });
                coefficients.extend((0..channels).map(|channel| (7 * x + channel * z) as i16));
            }
        }
        let triangles: Vec<Triangle> = (0..2 * n * n)
            .map(|i| Triangle {
                vertices: [3 * i, 3 * i + 1, 3 * i + 2],
                ..Triangle::zeroed()
            })
            .collect();
        let clusters = clusters([[6 * n * n, 1]]);
        let places = Places::find(&vertices, &clusters, &coefficients);
        assert_eq!(places.vertices.len() as u32, (n + 1) * (n + 1));
        come_back(&triangles, &vertices, &coefficients, &clusters);
        let bytes = encode_vertices(&vertices, &triangles, &places);
        assert_eq!(bytes[COMPONENTS] & FACE_NORMALS, FACE_NORMALS);
        let normals = COMPONENTS + 1 + 4 * vertices.len() + 12 * places.vertices.len();
        let normals = &bytes[normals..][..3 * vertices.len()];
        let other = normals.iter().filter(|byte| **byte > 2).count();
        assert!(other < normals.len() / 100, "{other} of {}", normals.len());
    }

    #[test]
    fn a_smooth_surface_leaves_little() {
        let n = 40u32;
        let vertices: Vec<Vertex> = (0..n * n)
            .map(|i| {
                let (x, z) = ((i % n) as f32 / 64.0, (i / n) as f32 / 64.0);
                let y = ((x * x + z) * 4096.0).round() / 4096.0;
                Vertex {
                    position: [x, y, z],
                    normal: [0.0, 1.0, 0.0],
                    ..Vertex::zeroed()
                }
            })
            .collect();
        let triangles: Vec<Triangle> = (0..(n - 1) * (n - 1))
            .flat_map(|i| {
                let a = i / (n - 1) * n + i % (n - 1);
                [[a, a + n, a + 1], [a + 1, a + n, a + n + 1]]
            })
            .map(|vertices| Triangle {
                vertices,
                ..Triangle::zeroed()
            })
            .collect();
        let clusters = clusters([[n * n, 0]]);
        let places = Places::find(&vertices, &clusters, &[]);
        let bytes = encode_vertices(&vertices, &triangles, &places);
        // Rows and columns are straight, their heights all but: a few steps of curvature.
        let large = bytes[COMPONENTS..].iter().filter(|byte| **byte > 8).count();
        assert!(large < vertices.len() / 10, "{large} of {}", bytes.len());
    }
}
