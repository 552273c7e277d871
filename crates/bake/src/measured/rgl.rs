//! Measured isotropic BRDFs of the RGL material database: the adaptive parameterisation
//! of Dupuy & Jakob 2018, "An Adaptive Parameterization for Efficient Material Acquisition
//! and Rendering".
//!
//! A table is stored over the unit square of samples of the distribution of visible
//! normals (§4 of the paper): looking a pair of directions up inverts that sampling, and
//! sampling a direction runs it forwards. Directions are in the local frame of the
//! surface, z its normal. As in the authors' renderer the direction that parametrises the
//! table is the one towards the eye.

use relight_format::math;
use std::collections::BTreeMap;
use std::f32::consts::{FRAC_PI_2, PI, TAU};

use glam::{Vec2, Vec3};

use crate::error::{Objection, first_bytes};

/// First twelve bytes of a tensor file.
pub(super) const MAGIC: &[u8; 12] = b"tensor_file\0";
/// Element types of tensor fields that BRDFs use.
const UINT8: u8 = 1;
const FLOAT32: u8 = 10;
/// More than any table has; bounds loops over untrusted counts.
const MAX_DIMENSIONS: usize = 8;

/// An isotropic RGB BRDF table.
pub struct Rgl {
    /// Microfacet normal distribution over the (θ, φ) square.
    normals: Slices,
    /// Projected area of the microfacets over the (θ, φ) square.
    projected_area: Slices,
    /// Distribution of visible normals over the (θ, φ) square, one slice per elevation.
    visible_normals: Warp,
    /// Luminance over the square of samples, one slice per elevation.
    luminance: Warp,
    /// Reflectance over the square of samples: slices of one elevation after the other,
    /// for R, G and B.
    reflectance: [Slices; 3],
    /// Elevations of the view direction that have slices, radians, ascending.
    elevations: Vec<f32>,
    /// Whether reflectance is stored divided by the microfacet terms.
    microfacet_scale: bool,
}

/// The half vector and the table coordinates that belong to a pair of directions.
struct Lookup {
    half_vector: Vec3,
    /// Half vector in the (θ, φ) square, φ relative to the view direction.
    square: Vec2,
    /// Weights of the elevation slices.
    slice: SliceWeights,
    /// The sample that the visible normals warp to the half vector.
    sample: Vec2,
    /// Density of that warp at the half vector, with respect to the square.
    density: f32,
}

impl Rgl {
    /// Whether nothing is reflected.
    pub(super) fn is_black(&self) -> bool {
        let mut values = self.reflectance.iter().flat_map(|slices| &slices.values);
        values.all(|value| *value <= 0.0)
    }

    /// Decodes the bytes of a `.bsdf` file, which are not trusted.
    pub(crate) fn parse(bytes: &[u8]) -> Result<Self, Objection> {
        let fields = fields(bytes)?;
        if fields.contains_key("wavelengths") {
            return Err(Objection::new(
                "header",
                "an RGB table (field rgb)",
                "a spectral one",
            ));
        }
        let elevations = floats(&fields, "theta_i", &[None])?.1;
        let azimuths = floats(&fields, "phi_i", &[None])?.1;
        if azimuths.len() != 1 {
            let found = format!("{} azimuths: an anisotropic table", azimuths.len());
            return Err(Objection::new(
                "field phi_i",
                "one azimuth, as isotropic tables have",
                found,
            ));
        }
        if elevations.is_empty() || !elevations.is_sorted_by(|a, b| a < b) {
            return Err(Objection::new(
                "field theta_i",
                "ascending elevations",
                format!("{elevations:?}"),
            ));
        }
        let count = Some(elevations.len());
        let table = |name: &str, shape: &[Option<usize>]| -> Result<Slices, Objection> {
            let (shape, values) = floats(&fields, name, shape)?;
            let [.., height, width] = shape[..] else {
                unreachable!("two dimensions or more")
            };
            if width < 2 || height < 2 {
                let place = format!("field {name}");
                return Err(Objection::new(
                    place,
                    "at least 2x2 values",
                    format!("{width}x{height}"),
                ));
            }
            Ok(Slices {
                width,
                height,
                values,
            })
        };
        let reflectance = table("rgb", &[Some(1), count, Some(3), None, None])?;
        let slice = reflectance.width * reflectance.height;
        let channel = |channel: usize| Slices {
            width: reflectance.width,
            height: reflectance.height,
            values: reflectance
                .values
                .chunks_exact(slice)
                .skip(channel)
                .step_by(3)
                .flatten()
                .copied()
                .collect(),
        };
        let scale = match fields
            .get("jacobian")
            .map(|field| (field.kind, field.bytes))
        {
            Some((UINT8, &[flag])) => flag != 0,
            _ => return Err(Objection::new("field jacobian", "one byte", "none")),
        };
        Ok(Self {
            normals: table("ndf", &[None, None])?,
            projected_area: table("sigma", &[None, None])?,
            visible_normals: Warp::new(table("vndf", &[Some(1), count, None, None])?),
            luminance: Warp::new(table("luminance", &[Some(1), count, None, None])?),
            reflectance: [channel(0), channel(1), channel(2)],
            elevations,
            microfacet_scale: scale,
        })
    }

    /// BRDF in 1/sr (linear Rec.709, cosine not included) for unit vectors towards the
    /// light and the eye; zero where either is below the surface. Measurements may be
    /// slightly negative.
    pub(crate) fn evaluate(&self, light: Vec3, view: Vec3) -> Vec3 {
        if light.z <= 0.0 || view.z <= 0.0 {
            return Vec3::ZERO;
        }
        let Some(lookup) = self.lookup(light, view) else {
            return Vec3::ZERO;
        };
        let reflectance = self
            .reflectance
            .each_ref()
            .map(|table| table.evaluate(lookup.sample, lookup.slice));
        Vec3::from(reflectance) * self.scale(&lookup, view) / light.z
    }

    /// A direction towards the light, distributed as `Self::pdf`, from two uniform
    /// numbers in [0, 1); `None` where the half vector reflects below the surface.
    pub fn sample(&self, view: Vec3, uniform: Vec2) -> Option<Vec3> {
        if view.z <= 0.0 {
            return None;
        }
        let slice = self.slice(view);
        let sample = self.luminance.sample(uniform, slice);
        let square = self.visible_normals.sample(sample, slice);
        let elevation = square.x * square.x * FRAC_PI_2;
        let azimuth = (2.0 * square.y - 1.0) * PI + azimuth(view);
        let half_vector = Vec3::new(
            math::cos(azimuth) * math::sin(elevation),
            math::sin(azimuth) * math::sin(elevation),
            math::cos(elevation),
        );
        let light = half_vector * (2.0 * half_vector.dot(view)) - view;
        (light.z > 0.0).then_some(light)
    }

    /// Density of [`Self::sample`] in 1/sr.
    pub(crate) fn pdf(&self, light: Vec3, view: Vec3) -> f32 {
        if light.z <= 0.0 || view.z <= 0.0 {
            return 0.0;
        }
        let Some(lookup) = self.lookup(light, view) else {
            return 0.0;
        };
        // Square -> half vector (θ = u²π/2, φ = 2πv − π), half vector -> reflected ray.
        let sine = lookup.half_vector.truncate().length();
        let jacobian =
            (2.0 * PI * PI * lookup.square.x * sine).max(1e-6) * 4.0 * lookup.half_vector.dot(view);
        self.luminance.density(lookup.sample, lookup.slice) * lookup.density / jacobian
    }

    fn lookup(&self, light: Vec3, view: Vec3) -> Option<Lookup> {
        let half_vector = (light + view).try_normalize()?;
        let azimuth = azimuth(half_vector) - azimuth(view);
        let v = (azimuth + PI) / TAU;
        let square = Vec2::new((elevation(half_vector) / FRAC_PI_2).sqrt(), v - v.floor());
        let slice = self.slice(view);
        let (sample, density) = self.visible_normals.invert(square, slice);
        Some(Lookup {
            half_vector,
            square,
            slice,
            sample,
            density,
        })
    }

    /// What the stored reflectance is multiplied by: D / (4 σ), or 1.
    fn scale(&self, lookup: &Lookup, view: Vec3) -> f32 {
        if !self.microfacet_scale {
            return 1.0;
        }
        let view_square = Vec2::new(
            (elevation(view) / FRAC_PI_2).sqrt(),
            (azimuth(view) + PI) / TAU,
        );
        let only = SliceWeights {
            first: 0,
            second: 0,
            weight: 0.0,
        };
        let area = self.projected_area.evaluate(view_square, only);
        if area > 0.0 {
            self.normals.evaluate(lookup.square, only) / (4.0 * area)
        } else {
            0.0
        }
    }

    fn slice(&self, view: Vec3) -> SliceWeights {
        let elevation = elevation(view);
        let second = self.elevations.partition_point(|&x| x < elevation);
        if second == 0 || second == self.elevations.len() {
            let end = second.min(self.elevations.len() - 1);
            return SliceWeights {
                first: end,
                second: end,
                weight: 0.0,
            };
        }
        let (a, b) = (self.elevations[second - 1], self.elevations[second]);
        SliceWeights {
            first: second - 1,
            second,
            weight: (elevation - a) / (b - a),
        }
    }
}

/// Angle from +z, accurate near the pole.
fn elevation(direction: Vec3) -> f32 {
    2.0 * math::asin((0.5 * direction.distance(Vec3::Z)).min(1.0))
}

fn azimuth(direction: Vec3) -> f32 {
    math::atan2(direction.y, direction.x)
}

/// Linear interpolation between two slices.
#[derive(Clone, Copy)]
struct SliceWeights {
    first: usize,
    second: usize,
    /// Of the second; the first has the rest.
    weight: f32,
}

/// Grids of values at the corners of equal cells that tile the unit square, interpolated
/// bilinearly within a grid and linearly between grids.
struct Slices {
    width: usize,
    height: usize,
    values: Vec<f32>,
}

impl Slices {
    fn at(&self, x: usize, y: usize, slice: SliceWeights) -> f32 {
        let index = |slice: usize| (slice * self.height + y) * self.width + x;
        let (a, b) = (
            self.values[index(slice.first)],
            self.values[index(slice.second)],
        );
        a + (b - a) * slice.weight
    }

    /// Cell that holds a point of the square, and the point's place within the cell.
    fn cell(&self, point: Vec2) -> (usize, usize, Vec2) {
        let size = Vec2::new((self.width - 1) as f32, (self.height - 1) as f32);
        // max and min also cure NaN.
        let scaled = point.max(Vec2::ZERO).min(Vec2::ONE) * size;
        let (x, y) = (
            (scaled.x as usize).min(self.width - 2),
            (scaled.y as usize).min(self.height - 2),
        );
        (x, y, scaled - Vec2::new(x as f32, y as f32))
    }

    /// Values along the bottom and top edges of the cell at (`x`, `y`), interpolated to
    /// height `t`: at its left and its right.
    fn row(&self, x: usize, y: usize, t: f32, slice: SliceWeights) -> (f32, f32) {
        let at = |x| mix(self.at(x, y, slice), self.at(x, y + 1, slice), t);
        (at(x), at(x + 1))
    }

    fn evaluate(&self, point: Vec2, slice: SliceWeights) -> f32 {
        let (x, y, t) = self.cell(point);
        let (left, right) = self.row(x, y, t.y, slice);
        mix(left, right, t.x)
    }
}

/// A density over the square, bilinear in each slice, that can be sampled and inverted:
/// y from the marginal, then x from the conditional distribution.
struct Warp {
    /// Each slice scaled to integrate to 1 over the square of unit *cells*.
    density: Slices,
    /// Integral of each row from its start to each column.
    rows: Slices,
    /// Integral from the first row to each row; one column.
    columns: Vec<f32>,
}

impl Warp {
    fn new(mut density: Slices) -> Self {
        let (width, height) = (density.width, density.height);
        let mut rows = Vec::with_capacity(density.values.len());
        let mut columns = Vec::new();
        for slice in density.values.chunks_exact_mut(width * height) {
            let sums: Vec<f64> = slice
                .chunks_exact(width)
                .flat_map(|row| trapezoids(row.iter().map(|&value| f64::from(value))))
                .collect();
            let marginal: Vec<f64> =
                trapezoids(sums.chunks_exact(width).map(|row| row[width - 1])).collect();
            let total = marginal[height - 1];
            let scale = if total > 0.0 { total.recip() } else { 0.0 };
            rows.extend(sums.iter().map(|sum| (sum * scale) as f32));
            columns.extend(marginal.iter().map(|sum| (sum * scale) as f32));
            for value in slice {
                *value = (f64::from(*value) * scale) as f32;
            }
        }
        Self {
            rows: Slices {
                width,
                height,
                values: rows,
            },
            density,
            columns,
        }
    }

    fn cells(&self) -> f32 {
        ((self.density.width - 1) * (self.density.height - 1)) as f32
    }

    fn column(&self, y: usize, slice: SliceWeights) -> f32 {
        let at = |slice: usize| self.columns[slice * self.density.height + y];
        mix(at(slice.first), at(slice.second), slice.weight)
    }

    fn density(&self, point: Vec2, slice: SliceWeights) -> f32 {
        self.density.evaluate(point, slice) * self.cells()
    }

    /// The sample that [`Self::sample`] maps to `point`, and the density there.
    fn invert(&self, point: Vec2, slice: SliceWeights) -> (Vec2, f32) {
        let (x, y, t) = self.density.cell(point);
        let (left, right) = self.density.row(x, y, t.y, slice);
        let before = self.rows.row(x, y, t.y, slice).0;
        let last = self.density.width - 1;
        let (low, high) = (
            self.rows.at(last, y, slice),
            self.rows.at(last, y + 1, slice),
        );
        let whole = mix(low, high, t.y);
        let sample_x = before + t.x * (left + 0.5 * t.x * (right - left));
        let sample_y = self.column(y, slice) + t.y * (low + 0.5 * t.y * (high - low));
        let sample = Vec2::new(if whole > 0.0 { sample_x / whole } else { 0.0 }, sample_y);
        (sample, mix(left, right, t.x) * self.cells())
    }

    /// The point that the uniform `sample` maps to.
    fn sample(&self, sample: Vec2, slice: SliceWeights) -> Vec2 {
        let (width, height) = (self.density.width, self.density.height);
        let last = width - 1;
        let y = bisect(height, |y| self.column(y, slice) <= sample.y);
        let (low, high) = (
            self.rows.at(last, y, slice),
            self.rows.at(last, y + 1, slice),
        );
        let t_y = invert_linear(low, high, sample.y - self.column(y, slice));
        let target = sample.x * mix(low, high, t_y);
        let before = |x: usize| {
            mix(
                self.rows.at(x, y, slice),
                self.rows.at(x, y + 1, slice),
                t_y,
            )
        };
        let x = bisect(width, |x| before(x) <= target);
        let (left, right) = self.density.row(x, y, t_y, slice);
        let t_x = invert_linear(left, right, target - before(x));
        Vec2::new(
            (x as f32 + t_x) / last as f32,
            (y as f32 + t_y) / (height - 1) as f32,
        )
    }
}

fn mix(a: f32, b: f32, t: f32) -> f32 {
    a + (b - a) * t
}

/// Running integral of the piecewise linear function through `values` at unit spacing.
fn trapezoids(values: impl Iterator<Item = f64>) -> impl Iterator<Item = f64> {
    values.scan((0.0, None), |(sum, previous), value| {
        *sum += previous.map_or(0.0, |previous: f64| 0.5 * (previous + value));
        *previous = Some(value);
        Some(*sum)
    })
}

/// The last cell of `points` cell corners whose left corner satisfies `inside`.
fn bisect(points: usize, inside: impl Fn(usize) -> bool) -> usize {
    let (mut low, mut high) = (0, points - 1);
    while high - low > 1 {
        let middle = usize::midpoint(low, high);
        if inside(middle) {
            low = middle;
        } else {
            high = middle;
        }
    }
    low
}

/// t in [0, 1] with ∫₀ᵗ (a + (b − a) s) ds = `target`: the root that also holds for a = b.
fn invert_linear(a: f32, b: f32, target: f32) -> f32 {
    let root = (a * a + 2.0 * (b - a) * target).max(0.0).sqrt();
    if a + root > 0.0 {
        (2.0 * target / (a + root)).clamp(0.0, 1.0)
    } else {
        0.0
    }
}

/// One field of a tensor file.
struct Field<'a> {
    kind: u8,
    shape: Vec<usize>,
    bytes: &'a [u8],
}

/// Takes little-endian numbers off the front of untrusted bytes.
struct Reader<'a>(&'a [u8]);

impl<'a> Reader<'a> {
    fn take(&mut self, length: usize) -> Result<&'a [u8], Objection> {
        let (head, tail) = self.0.split_at_checked(length).ok_or_else(|| {
            let found = format!("{} bytes", self.0.len());
            Objection::new(
                "header",
                format_args!("at least {length} more bytes"),
                found,
            )
        })?;
        self.0 = tail;
        Ok(head)
    }

    fn integer(&mut self, length: usize) -> Result<usize, Objection> {
        let bytes = self.take(length)?;
        let value = bytes
            .iter()
            .rev()
            .fold(0u64, |value, &byte| value << 8 | u64::from(byte));
        usize::try_from(value).map_err(|_| Objection::new("header", "a size in memory", value))
    }
}

/// The fields of a tensor file: magic, version 1.0, field count, then per field its name,
/// number of dimensions, element type, offset and shape.
fn fields(bytes: &[u8]) -> Result<BTreeMap<String, Field<'_>>, Objection> {
    let mut reader = Reader(bytes);
    let magic = reader.take(MAGIC.len())?;
    if magic != MAGIC {
        return Err(Objection::new("header", "tensor_file", first_bytes(magic)));
    }
    let version = reader.take(2)?;
    if version != [1, 0] {
        return Err(Objection::new(
            "header",
            "version 1.0",
            format_args!("version {}.{}", version[0], version[1]),
        ));
    }
    let count = reader.integer(4)?;
    let mut fields = BTreeMap::new();
    for _ in 0..count {
        let length = reader.integer(2)?;
        let name = String::from_utf8_lossy(reader.take(length)?).into_owned();
        let dimensions = reader.integer(2)?;
        let kind = reader.take(1)?[0];
        let offset = reader.integer(8)?;
        if dimensions > MAX_DIMENSIONS {
            let expected = format_args!("at most {MAX_DIMENSIONS} dimensions");
            return Err(Objection::new(
                format_args!("field {name}"),
                expected,
                dimensions,
            ));
        }
        let shape = (0..dimensions)
            .map(|_| reader.integer(8))
            .collect::<Result<Vec<_>, _>>()?;
        let size = match kind {
            UINT8 => 1,
            FLOAT32 => 4,
            // Other types occur in fields that nothing here reads.
            _ => 0,
        };
        let data = shape
            .iter()
            .try_fold(size, |product: usize, &extent| product.checked_mul(extent))
            .and_then(|length| bytes.get(offset..offset.checked_add(length)?))
            .ok_or_else(|| {
                let found = format!("{shape:?} elements at offset {offset}");
                let expected = format_args!("data inside the {} bytes of the file", bytes.len());
                Objection::new(format_args!("field {name}"), expected, found)
            })?;
        fields.insert(
            name,
            Field {
                kind,
                shape,
                bytes: data,
            },
        );
    }
    Ok(fields)
}

/// Shape and values of a field of finite floats; `shape` gives the extents that are known.
fn floats(
    fields: &BTreeMap<String, Field>,
    name: &str,
    shape: &[Option<usize>],
) -> Result<(Vec<usize>, Vec<f32>), Objection> {
    let place = format!("field {name}");
    let field = fields
        .get(name)
        .ok_or_else(|| Objection::new(&place, "to be present", "nothing"))?;
    let fits = field.shape.len() == shape.len()
        && field
            .shape
            .iter()
            .zip(shape)
            .all(|(found, known)| known.is_none_or(|k| k == *found));
    if field.kind != FLOAT32 || !fits {
        let expected = format!("32-bit floats of shape {shape:?}");
        let found = format!("type {} of shape {:?}", field.kind, field.shape);
        return Err(Objection::new(place, expected, found));
    }
    let values: Vec<f32> = field
        .bytes
        .chunks_exact(4)
        .map(|bytes| f32::from_le_bytes(bytes.try_into().expect("four bytes")))
        .collect();
    match values.iter().find(|value| !value.is_finite()) {
        Some(value) => Err(Objection::new(place, "finite numbers", value)),
        None => Ok((field.shape.clone(), values)),
    }
}

#[cfg(test)]
mod tests {
    use super::super::radical_inverse;
    use super::*;

    /// A small table of positive pseudo-random numbers in the layout of real files.
    fn file() -> Vec<u8> {
        let mut state = 1u32;
        let mut random = |count: usize, low: f32| -> Vec<u8> {
            let mut next = || {
                state = state.wrapping_mul(747_796_405).wrapping_add(2_891_336_453);
                low + (state >> 8) as f32 / 2f32.powi(24)
            };
            (0..count).flat_map(|_| next().to_le_bytes()).collect()
        };
        let floats = |values: &[f32]| values.iter().flat_map(|v| v.to_le_bytes()).collect();
        let fields: Vec<(&str, u8, Vec<u64>, Vec<u8>)> = vec![
            ("description", UINT8, vec![4], b"test".to_vec()),
            ("phi_i", FLOAT32, vec![1], floats(&[0.0])),
            ("theta_i", FLOAT32, vec![3], floats(&[0.0, 0.7, 1.5])),
            ("sigma", FLOAT32, vec![2, 8], random(16, 0.5)),
            ("ndf", FLOAT32, vec![2, 8], random(16, 0.5)),
            ("vndf", FLOAT32, vec![1, 3, 6, 7], random(3 * 42, 0.2)),
            ("luminance", FLOAT32, vec![1, 3, 5, 5], random(3 * 25, 0.2)),
            ("rgb", FLOAT32, vec![1, 3, 3, 5, 5], random(9 * 25, 0.1)),
            ("jacobian", UINT8, vec![1], vec![1]),
        ];
        let header: usize = fields
            .iter()
            .map(|(name, _, shape, _)| 13 + name.len() + 8 * shape.len())
            .sum();
        let mut bytes = MAGIC.to_vec();
        bytes.extend([1, 0]);
        bytes.extend((fields.len() as u32).to_le_bytes());
        let mut offset = 18 + header;
        for (name, kind, shape, data) in &fields {
            bytes.extend((name.len() as u16).to_le_bytes());
            bytes.extend(name.as_bytes());
            bytes.extend((shape.len() as u16).to_le_bytes());
            bytes.push(*kind);
            bytes.extend((offset as u64).to_le_bytes());
            bytes.extend(shape.iter().flat_map(|extent| extent.to_le_bytes()));
            offset += data.len();
        }
        assert_eq!(bytes.len(), 18 + header);
        for (_, _, _, data) in fields {
            bytes.extend(data);
        }
        bytes
    }

    fn direction(elevation: f32, azimuth: f32) -> Vec3 {
        let (sin, cos) = math::sin_cos(elevation);
        Vec3::new(sin * math::cos(azimuth), sin * math::sin(azimuth), cos)
    }

    #[test]
    fn sampling_inverts_the_lookup() {
        let table = Rgl::parse(&file()).unwrap();
        let view = direction(0.9, 0.3);
        let slice = table.slice(view);
        for i in 0..200u32 {
            let sample = Vec2::new((i as f32 + 0.5) / 200.0, radical_inverse(i));
            let point = table.visible_normals.sample(sample, slice);
            let (back, _) = table.visible_normals.invert(point, slice);
            // Square roots of differences in f32.
            assert!(back.distance(sample) < 1e-4, "{sample} came back as {back}");
        }
    }

    #[test]
    fn density_is_that_of_the_samples() {
        // E[g / pdf] under the sampling is ∫g over the directions that it reaches. With g =
        // cosine the integral is π minus what no half vector below the horizon reflects to.
        let table = Rgl::parse(&file()).unwrap();
        for view in [direction(0.2, 0.0), direction(0.8, 2.0)] {
            let count = 1 << 16;
            let mut sum = 0f64;
            for i in 0..count {
                let uniform = Vec2::new((i as f32 + 0.5) / count as f32, radical_inverse(i));
                if let Some(light) = table.sample(view, uniform) {
                    sum += f64::from(light.z / table.pdf(light, view));
                }
            }
            let mean = sum / f64::from(count);
            // Quasi-random quadrature of a bounded function with 65,536 points.
            assert!((mean / std::f64::consts::PI - 1.0).abs() < 5e-3, "{mean}");
        }
    }

    #[test]
    fn nothing_is_reflected_below_the_horizon() {
        let table = Rgl::parse(&file()).unwrap();
        let (up, down) = (direction(0.4, 1.0), direction(2.0, 1.0));
        assert!(table.evaluate(up, up).min_element() > 0.0);
        for (light, view) in [(up, down), (down, up), (down, down)] {
            assert_eq!(table.evaluate(light, view), Vec3::ZERO);
            assert_eq!(table.pdf(light, view), 0.0);
        }
        assert_eq!(table.sample(down, Vec2::splat(0.5)), None);
    }

    #[test]
    fn broken_files_are_errors_that_name_the_place() {
        let bytes = file();
        for end in 0..bytes.len() {
            assert!(Rgl::parse(&bytes[..end]).is_err(), "prefix of {end} bytes");
        }
        let message = |bytes: &[u8]| Rgl::parse(bytes).err().unwrap().to_string();
        assert!(message(b"not a tensor file").starts_with("header"));
        let mut renamed = bytes.clone();
        let place = bytes.windows(5).position(|name| name == b"sigma").unwrap();
        renamed[place] = b'S';
        assert!(
            message(&renamed).starts_with("field sigma"),
            "{}",
            message(&renamed)
        );
        let mut not_finite = bytes.clone();
        let end = bytes.len() - 1;
        not_finite[end - 4..end].copy_from_slice(&f32::NAN.to_le_bytes());
        assert!(message(&not_finite).starts_with("field rgb"));
    }

    #[test]
    fn no_flipped_byte_panics() {
        let bytes = file();
        let (light, view) = (direction(0.5, 0.1), direction(0.9, 2.0));
        for position in 0..bytes.len() {
            for value in [0, 0x7f, 0x80, 0xff] {
                let mut broken = bytes.clone();
                broken[position] = value;
                if let Ok(table) = Rgl::parse(&broken) {
                    let _ = table.evaluate(light, view);
                    let _ = table.sample(view, Vec2::splat(0.7));
                    let _ = table.pdf(light, view);
                }
            }
        }
    }
}
