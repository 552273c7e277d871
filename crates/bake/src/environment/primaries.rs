//! Colours of other primaries to linear Rec.709.

use exr::meta::attribute::Chromaticities;
use glam::{DMat3, DVec3};

/// Largest difference of chromaticities that are the same, written with four digits.
const SAME: f32 = 1e-3;
/// Cone responses of Bradford's adaptation (Lam 1985), from XYZ; rows.
const BRADFORD: [[f64; 3]; 3] = [
    [0.8951, 0.2664, -0.1614],
    [-0.7502, 1.7135, 0.0367],
    [0.0389, -0.0685, 1.0296],
];

/// x and y of red, green, blue and white of Rec.709.
const REC709: [[f64; 2]; 4] = [[0.64, 0.33], [0.3, 0.6], [0.15, 0.06], [0.3127, 0.329]];

/// The matrix from colours of these primaries to Rec.709, white to white by Bradford's
/// adaptation: the identity if they are those of Rec.709, `None` if they span nothing.
pub(super) fn to_rec709(from: &Chromaticities) -> Option<DMat3> {
    let points = [from.red, from.green, from.blue, from.white].map(|point| [point.x(), point.y()]);
    let same = points.iter().flatten().zip(REC709.iter().flatten());
    if same.clone().all(|(a, b)| (a - *b as f32).abs() < SAME) {
        return Some(DMat3::IDENTITY);
    }
    let points = points.map(|point| point.map(f64::from));
    let (source, white) = to_xyz(points)?;
    let (target, target_white) = to_xyz(REC709)?;
    let cones = DMat3::from_cols_array_2d(&BRADFORD).transpose();
    let scale = (cones * target_white) / (cones * white);
    let adaptation = cones.inverse() * DMat3::from_diagonal(scale) * cones;
    let matrix = target.inverse() * adaptation * source;
    matrix.is_finite().then_some(matrix)
}

/// The matrix from colours to XYZ, and XYZ of white (SMPTE RP 177-1993).
fn to_xyz(points: [[f64; 2]; 4]) -> Option<(DMat3, DVec3)> {
    // Beyond these, as for primaries of ACES, nothing has a meaning.
    let sane = |value: &f64| value.is_finite() && value.abs() <= 2.0;
    let [red, green, blue, white] = points;
    if !points.iter().flatten().all(sane) || white.iter().any(|value| *value < 0.01) {
        return None;
    }
    let white = DVec3::new(
        white[0] / white[1],
        1.0,
        (1.0 - white[0] - white[1]) / white[1],
    );
    let columns = [red, green, blue].map(|[x, y]| DVec3::new(x, y, 1.0 - x - y));
    let primaries = DMat3::from_cols(columns[0], columns[1], columns[2]);
    if primaries.determinant().abs() < 1e-4 {
        return None;
    }
    let amounts = primaries.inverse() * white;
    // White is a mixture of the primaries.
    (amounts.min_element() > 0.0).then_some((primaries * DMat3::from_diagonal(amounts), white))
}

#[cfg(test)]
mod tests {
    use super::*;
    use exr::math::Vec2;

    /// Published matrices have five digits.
    const TOLERANCE: f64 = 2e-3;

    fn chromaticities(points: [[f32; 2]; 4]) -> Chromaticities {
        let [red, green, blue, white] = points.map(|[x, y]| Vec2(x, y));
        Chromaticities {
            red,
            green,
            blue,
            white,
        }
    }

    #[test]
    fn acescg_becomes_rec709_as_published() {
        let ap1 = [
            [0.713, 0.293],
            [0.165, 0.83],
            [0.128, 0.044],
            [0.321_68, 0.337_67],
        ];
        let matrix = to_rec709(&chromaticities(ap1)).expect("a matrix");
        // OpenColorIO's ACEScg to linear Rec.709, Bradford.
        let expected = [
            [1.705_05, -0.621_79, -0.083_26],
            [-0.130_26, 1.140_80, -0.010_55],
            [-0.024_00, -0.128_97, 1.152_97],
        ];
        let rows = matrix.transpose().to_cols_array_2d();
        for (row, expected) in rows.iter().flatten().zip(expected.iter().flatten()) {
            assert!((row - expected).abs() < TOLERANCE, "{rows:?}");
        }
        let white = matrix * DVec3::ONE;
        assert!(white.distance(DVec3::ONE) < 1e-6, "{white}");
    }

    #[test]
    fn rec709_stays_and_nonsense_is_refused() {
        let rec709 = REC709.map(|point| point.map(|value| value as f32));
        assert_eq!(to_rec709(&chromaticities(rec709)), Some(DMat3::IDENTITY));
        for broken in [
            [[0.0; 2]; 4],
            [[0.3, 0.3]; 4],
            [[f32::NAN, 0.3], [0.3, 0.6], [0.15, 0.06], [0.3127, 0.329]],
            [[0.64, 0.33], [0.3, 0.6], [0.15, 0.06], [0.3127, 0.0]],
            [[0.64, 0.33], [0.3, 0.6], [0.15, 0.06], [0.9, 0.05]],
            [[1e30, 0.33], [0.3, 0.6], [0.15, 0.06], [0.3127, 0.329]],
        ] {
            assert_eq!(to_rec709(&chromaticities(broken)), None, "{broken:?}");
        }
    }
}
