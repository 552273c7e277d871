//! Triangles, vertices and coefficients as differences from what earlier ones predict: on a
//! surface neighbours are alike, and little is left for compression.
//!
//! A vertex is expected to complete a parallelogram with the triangle on the other side of
//! an edge (Touma & Gotsman 1998). All arrays come back bit for bit, whatever they hold; they
//! take few bytes if triangles come in an order in which most share an edge with one shortly
//! before, vertices in the order in which triangles use them, and attributes are multiples
//! of steps.

use std::ops::Range;

use bytemuck::Zeroable as _;

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

/// Vertices as differences, with the steps of their numbers before them.
pub(crate) fn encode_vertices(vertices: &[Vertex], expected: &Parallelograms) -> Vec<u8> {
    let numbers: &[[f32; COMPONENTS]] = bytemuck::cast_slice(vertices);
    let count = vertices.len();
    let mut steps = Vec::new();
    let mut differences = Vec::with_capacity(COMPONENTS * count);
    for component in 0..COMPONENTS {
        let numbers: Vec<f32> = numbers.iter().map(|vertex| vertex[component]).collect();
        let step = step(&numbers);
        let values: Vec<i32> = (numbers.iter())
            .map(|number| to_integer(*number, step))
            .collect();
        differences.extend((0..count).map(|vertex| {
            let expected = expected.of(vertex, &(0..count), |other| values[other]);
            zigzag(values[vertex].wrapping_sub(expected)).to_le_bytes()
        }));
        steps.push(step as u8);
    }
    let mut bytes = steps;
    bytes.extend(planes(&differences));
    bytes
}

/// The inverse of [`encode_vertices`], with what is expected of their coefficients; none if
/// the length is not that of any vertices.
pub(crate) fn decode_vertices(
    bytes: &[u8],
    triangles: &[Triangle],
) -> Option<(Vec<Vertex>, Parallelograms)> {
    let (steps, planes) = bytes.split_at_checked(COMPONENTS)?;
    if !planes.len().is_multiple_of(size_of::<Vertex>()) {
        return None;
    }
    let count = planes.len() / size_of::<Vertex>();
    let expected = Parallelograms::new(triangles, count);
    let mut vertices = vec![Vertex::zeroed(); count];
    let numbers: &mut [[f32; COMPONENTS]] = bytemuck::cast_slice_mut(&mut vertices);
    let mut values = vec![0i32; count];
    for (component, step) in steps.iter().enumerate() {
        for vertex in 0..count {
            let difference = u32::from_le_bytes(element(planes, component * count + vertex));
            let expected = expected.of(vertex, &(0..count), |other| values[other]);
            values[vertex] = expected.wrapping_add(from_zigzag(difference));
            numbers[vertex][component] = from_integer(values[vertex], *step as i8);
        }
    }
    Some((vertices, expected))
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

/// Bytes of every number by significance: all first bytes, then all second ones.
fn planes<const N: usize>(numbers: &[[u8; N]]) -> Vec<u8> {
    (0..N)
        .flat_map(|plane| numbers.iter().map(move |number| number[plane]))
        .collect()
}

/// A number of [`planes`].
fn element<const N: usize>(planes: &[u8], index: usize) -> [u8; N] {
    let count = planes.len() / N;
    std::array::from_fn(|plane| planes[plane * count + index])
}

/// Small for small numbers of either sign.
fn zigzag(value: i32) -> u32 {
    ((value << 1) ^ (value >> 31)) as u32
}

fn from_zigzag(code: u32) -> i32 {
    (code >> 1) as i32 ^ -((code & 1) as i32)
}

/// Exponent of the largest power of two that all numbers are multiples of, if those are not
/// too large.
fn step(numbers: &[f32]) -> i8 {
    let lowest_bit = |number: f32| {
        let (bits, implied) = (number.to_bits(), 1 << 23);
        let exponent = (bits >> 23 & 0xff) as i32;
        let digits = bits & (implied - 1) | if exponent > 0 { implied } else { 0 };
        exponent.max(1) - 150 + digits.trailing_zeros() as i32
    };
    let nonzero = numbers.iter().filter(|number| **number != 0.0);
    let exponent = nonzero.map(|number| lowest_bit(*number)).min().unwrap_or(0);
    let exponent = i8::try_from(exponent).unwrap_or(NO_STEP);
    let fits = |number: &f32| {
        let multiple = f64::from(*number) / 2f64.powi(i32::from(exponent));
        // A negative zero would lose its sign.
        multiple.abs() < MAX_MULTIPLE && number.to_bits() != (-0.0f32).to_bits()
    };
    if exponent > NO_STEP && numbers.iter().all(fits) {
        exponent
    } else {
        NO_STEP
    }
}

/// A number in steps, or its bits, ascending with it.
fn to_integer(number: f32, step: i8) -> i32 {
    if step == NO_STEP {
        let bits = number.to_bits() as i32;
        return bits ^ ((bits >> 31) as u32 >> 1) as i32;
    }
    (f64::from(number) / 2f64.powi(i32::from(step))) as i32
}

fn from_integer(integer: i32, step: i8) -> f32 {
    if step == NO_STEP {
        let bits = integer ^ ((integer >> 31) as u32 >> 1) as i32;
        return f32::from_bits(bits as u32);
    }
    (f64::from(integer) * 2f64.powi(i32::from(step))) as f32
}

/// Coefficients of image after image of every cluster: what all are multiples of, then
/// differences, in multiples of it.
pub(crate) fn encode_coefficients(
    coefficients: &[i16],
    clusters: &[Cluster],
    expected: &Parallelograms,
) -> Vec<u8> {
    let mut steps = Vec::new();
    let mut differences = Vec::with_capacity(coefficients.len());
    for_images(clusters, |vertices, place| {
        let value = |vertex: usize| i32::from(coefficients[place(vertex)]);
        let common = vertices.clone().fold(0, |step, vertex| {
            greatest_common_divisor(step, value(vertex))
        });
        // A lone −32768 has a step that 16 bits do not hold; such coefficients are not valid.
        let step = common.clamp(1, i32::from(i16::MAX));
        steps.push((step as u16).to_le_bytes());
        differences.extend(vertices.clone().map(|vertex| {
            let difference = value(vertex) - expected.of(vertex, &vertices, value);
            // Modulo 2¹⁶, like the coefficients themselves.
            let multiple = (difference / step) as i16;
            (zigzag(i32::from(multiple)) as u16).to_le_bytes()
        }));
    });
    let mut bytes = planes(&steps);
    bytes.extend(planes(&differences));
    bytes
}

/// The inverse of [`encode_coefficients`]; none if clusters and their vertices are not of
/// this length.
pub(crate) fn decode_coefficients(
    bytes: &[u8],
    clusters: &[Cluster],
    expected: &Parallelograms,
) -> Option<Vec<i16>> {
    let images = |cluster: &Cluster| u64::from(cluster.tiles) * CHANNELS_PER_TILE as u64;
    let vertices = |cluster: &Cluster| u64::from(cluster.vertex_count);
    let all_vertices: u64 = clusters.iter().map(vertices).sum();
    let all_images: u64 = clusters.iter().map(images).sum();
    let all = clusters.iter().try_fold(0u64, |sum, cluster| {
        sum.checked_add(vertices(cluster).checked_mul(images(cluster))?)
    });
    let expected_length = all?.checked_add(all_images)?.checked_mul(2)?;
    if all_vertices != expected.0.len() as u64 || expected_length != bytes.len() as u64 {
        return None;
    }
    let (steps, differences) = bytes.split_at(2 * all_images as usize);
    let mut coefficients = vec![0i16; differences.len() / 2];
    let (mut image, mut index) = (0, 0);
    for_images(clusters, |vertices, place| {
        let step = i32::from(u16::from_le_bytes(element(steps, image)));
        image += 1;
        for vertex in vertices.clone() {
            let value = |vertex: usize| i32::from(coefficients[place(vertex)]);
            let expected = expected.of(vertex, &vertices, value);
            let difference = u16::from_le_bytes(element(differences, index));
            index += 1;
            let difference = from_zigzag(u32::from(difference)).wrapping_mul(step);
            coefficients[place(vertex)] = expected.wrapping_add(difference) as i16;
        }
    });
    Some(coefficients)
}

fn greatest_common_divisor(a: i32, b: i32) -> i32 {
    if b == 0 {
        a.abs()
    } else {
        greatest_common_divisor(b, a % b)
    }
}

/// Hands over the vertices of every image of every cluster, and where a vertex's coefficient
/// is.
fn for_images(
    clusters: &[Cluster],
    mut hand_over: impl FnMut(Range<usize>, &dyn Fn(usize) -> usize),
) {
    let (mut first, mut start) = (0, 0);
    for cluster in clusters {
        let channels = cluster.tiles as usize * CHANNELS_PER_TILE;
        let vertices = first..first + cluster.vertex_count as usize;
        for channel in 0..channels {
            hand_over(vertices.clone(), &|vertex| {
                start + (vertex - first) * channels + channel
            });
        }
        start += vertices.len() * channels;
        first = vertices.end;
    }
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
        let expected = Parallelograms::new(triangles, vertices.len());
        let decoded = decode_triangles(&encode_triangles(triangles)).unwrap();
        assert_eq!(decoded, triangles);
        let bytes = encode_vertices(vertices, &expected);
        let (decoded, again) = decode_vertices(&bytes, triangles).unwrap();
        assert_eq!(
            bytemuck::cast_slice::<_, u32>(&decoded),
            bytemuck::cast_slice::<_, u32>(vertices)
        );
        assert_eq!(again.0, expected.0);
        let bytes = encode_coefficients(coefficients, clusters, &expected);
        assert_eq!(
            decode_coefficients(&bytes, clusters, &expected).unwrap(),
            coefficients
        );
    }

    fn cluster(vertex_count: u32, tiles: u32) -> Cluster {
        Cluster {
            vertex_count,
            tiles,
            ..Cluster::zeroed()
        }
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
                let clusters = [
                    cluster(count / 3, 2),
                    cluster(0, 1),
                    cluster(count - count / 3, 1),
                ];
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
    fn lengths_are_checked() {
        assert!(decode_triangles(&[0; 17]).is_none());
        assert!(decode_vertices(&[0; COMPONENTS - 1], &[]).is_none());
        assert!(decode_vertices(&[0; COMPONENTS + 47], &[]).is_none());
        let expected = Parallelograms::new(&[], 3);
        let decode = |length: usize, clusters: &[Cluster]| {
            decode_coefficients(&vec![0; length], clusters, &expected).is_some()
        };
        assert!(decode(2 * (4 + 12), &[cluster(3, 1)]));
        assert!(!decode(2 * (4 + 12) - 1, &[cluster(3, 1)]));
        assert!(!decode(2 * (4 + 8), &[cluster(2, 1)]));
        assert!(!decode(0, &[cluster(u32::MAX, u32::MAX); 3]));
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
        let expected = Parallelograms::new(&triangles, vertices.len());
        let bytes = encode_vertices(&vertices, &expected);
        // Rows and columns are straight, their heights all but: a few steps of curvature.
        let large = bytes[COMPONENTS..].iter().filter(|byte| **byte > 8).count();
        assert!(large < vertices.len() / 10, "{large} of {}", bytes.len());
    }
}
