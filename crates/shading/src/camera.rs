//! World to clip space, pixels to rays, and rays to barycentric coordinates.

use glam::{Mat4, Vec2, Vec3, Vec4};
use relight_format::{Camera, FieldOfView};

/// A pinhole camera at an image size, in the form that shading and rasterising need.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct View {
    /// World to clip space, z reversed: depth is `near / distance along the axis`.
    pub view_projection: Mat4,
    /// Centre of projection, world space.
    pub eye: Vec3,
    /// Direction through the upper left corner of the image.
    pub corner: Vec3,
    /// Step of the direction from one column to the next.
    pub right: Vec3,
    /// Step of the direction from one row to the next.
    pub down: Vec3,
}

impl View {
    /// `camera` at `width` × `height` square pixels; what lies closer than `near` metres
    /// along the optical axis is clipped, and there is no far plane.
    ///
    /// A camera whose target is its position looks along −Z, and one whose up direction is
    /// its axis takes any other.
    pub fn new(camera: &Camera, width: u32, height: u32, near: f32) -> Self {
        let eye = Vec3::from(camera.position);
        let forward = (Vec3::from(camera.target) - eye).normalize_or(Vec3::NEG_Z);
        let right = forward
            .cross(camera.up.into())
            .try_normalize()
            .unwrap_or_else(|| forward.any_orthonormal_vector());
        let up = right.cross(forward);
        let (width, height) = (width as f32, height as f32);
        let (half_width, half_height) = match camera.field_of_view {
            FieldOfView::X(angle) => {
                let tangent = (0.5 * angle).tan();
                (tangent, tangent * height / width)
            }
            FieldOfView::Y(angle) => {
                let tangent = (0.5 * angle).tan();
                (tangent * width / height, tangent)
            }
        };
        let row = |axis: Vec3| axis.extend(-axis.dot(eye));
        let rows = [
            row(right / half_width),
            row(up / half_height),
            Vec4::new(0.0, 0.0, 0.0, near),
            row(forward),
        ];
        Self {
            view_projection: Mat4::from_cols(rows[0], rows[1], rows[2], rows[3]).transpose(),
            eye,
            corner: forward - half_width * right + half_height * up,
            right: 2.0 * half_width / width * right,
            down: -2.0 * half_height / height * up,
        }
    }

    /// Direction, not of unit length, of the ray through the centre of pixel (`x`, `y`).
    pub fn pixel_direction(&self, x: u32, y: u32) -> Vec3 {
        let centre = Vec2::new(x as f32, y as f32) + 0.5;
        self.corner + centre.x * self.right + centre.y * self.down
    }

    /// Barycentric coordinates of the point where a ray from the eye meets the plane of a
    /// triangle, clamped to the triangle: a pixel centre may lie a rounding error outside.
    pub fn barycentrics(&self, [a, b, c]: [Vec3; 3], direction: Vec3) -> Vec3 {
        let ab = b - a;
        let ac = c - a;
        let from_a = self.eye - a;
        let p = direction.cross(ac);
        let q = from_a.cross(ab);
        let determinant = ab.dot(p);
        if determinant == 0.0 {
            return Vec3::splat(1.0 / 3.0);
        }
        let v = (from_a.dot(p) / determinant).max(0.0);
        let w = (direction.dot(q) / determinant).max(0.0);
        let excess = (v + w).max(1.0);
        Vec3::new(1.0 - (v + w) / excess, v / excess, w / excess)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn camera(field_of_view: FieldOfView) -> Camera {
        Camera {
            position: [3.0, 2.0, 5.0],
            target: [0.5, -0.25, 1.0],
            up: [0.0, 1.0, 0.0],
            field_of_view,
        }
    }

    /// Pixels; a few roundings of numbers of the image's size.
    const PIXEL_TOLERANCE: f32 = 1e-3;

    #[test]
    fn a_ray_projects_to_its_own_pixel() {
        let (width, height) = (640, 360);
        for field_of_view in [FieldOfView::X(1.1), FieldOfView::Y(0.7)] {
            let view = View::new(&camera(field_of_view), width, height, 0.01);
            for (x, y, distance) in [(0, 0, 0.5), (639, 359, 20.0), (100, 300, 3.0)] {
                let point = view.eye + distance * view.pixel_direction(x, y);
                let clip = view.view_projection * point.extend(1.0);
                let ndc = clip.truncate() / clip.w;
                let column = (ndc.x * 0.5 + 0.5) * width as f32 - 0.5;
                let row = (0.5 - ndc.y * 0.5) * height as f32 - 0.5;
                assert!(
                    (column - x as f32).abs() < PIXEL_TOLERANCE,
                    "column {column}, not {x}"
                );
                assert!(
                    (row - y as f32).abs() < PIXEL_TOLERANCE,
                    "row {row}, not {y}"
                );
                assert!((ndc.z - 0.01 / distance).abs() < 1e-6, "depth {}", ndc.z);
            }
        }
    }

    #[test]
    fn field_of_view_spans_the_named_axis() {
        let view = View::new(&camera(FieldOfView::Y(1.0)), 400, 100, 0.01);
        let top = view.corner + 200.0 * view.right;
        let bottom = top + 100.0 * view.down;
        assert!((top.angle_between(bottom) - 1.0).abs() < 1e-5);
    }

    #[test]
    fn barycentrics_rebuild_the_point_hit() {
        let view = View::new(&camera(FieldOfView::X(1.0)), 64, 64, 0.01);
        let triangle = [
            Vec3::ZERO,
            Vec3::new(1.0, 0.0, 0.0),
            Vec3::new(0.0, 0.5, 1.0),
        ];
        let expected = Vec3::new(0.2, 0.5, 0.3);
        let point = expected.x * triangle[0] + expected.y * triangle[1] + expected.z * triangle[2];
        let found = view.barycentrics(triangle, 7.0 * (point - view.eye));
        assert!(found.distance(expected) < 1e-5, "{found}");
        let outside = view.barycentrics(triangle, Vec3::new(2.0, 0.1, 0.0) - view.eye);
        assert!(outside.min_element() >= 0.0 && (outside.element_sum() - 1.0).abs() < 1e-6);
    }

    #[test]
    fn degenerate_cameras_still_look_somewhere() {
        let mut camera = camera(FieldOfView::X(1.0));
        camera.up = [-2.5, -2.25, -4.0];
        assert!(View::new(&camera, 4, 4, 0.1).corner.is_finite());
        camera.target = camera.position;
        assert!(View::new(&camera, 4, 4, 0.1).corner.is_finite());
    }
}
