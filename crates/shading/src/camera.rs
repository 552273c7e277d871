//! World to clip space, pixels to rays, and rays to barycentric coordinates.

use glam::{DMat3, DVec3, DVec4, Mat4, Vec2, Vec3, Vec4};
use relight_format::math;
use relight_format::{Camera, FieldOfView};

/// How a picture is looked at.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Viewpoint {
    /// A pinhole.
    Pinhole(Camera),
    /// What an app draws everything else with: off-centre, jittered, orthographic, mirrored, with
    /// or without a far plane, depth reversed or not. See [`View::from_matrix`].
    Matrices {
        /// World to view space. Any convention of axes.
        view: Mat4,
        /// View to clip space, depth from 0 to 1 as in `wgpu`.
        projection: Mat4,
    },
}

impl From<Camera> for Viewpoint {
    fn from(camera: Camera) -> Self {
        Self::Pinhole(camera)
    }
}

impl Viewpoint {
    /// World to clip space, as the app has it; `near` is for pinholes, see [`View::new`].
    pub fn matrix(&self, width: u32, height: u32, near: f32) -> Mat4 {
        match self {
            Self::Pinhole(camera) => View::new(camera, width, height, near).view_projection,
            Self::Matrices { view, projection } => *projection * *view,
        }
    }

    /// In the form that shading and rasterising need; `None` of matrices that project nothing.
    /// `near` is for pinholes, see [`View::new`].
    pub fn view(&self, width: u32, height: u32, near: f32) -> Option<View> {
        match self {
            Self::Pinhole(camera) => Some(View::new(camera, width, height, near)),
            Self::Matrices { .. } => {
                View::from_matrix(self.matrix(width, height, near), width, height)
            }
        }
    }
}

/// A camera at an image size, in the form that shading and rasterising need.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct View {
    /// World to clip space, z reversed: depth falls from 1 in front to 0 behind.
    pub view_projection: Mat4,
    /// Centre of projection, world space; unit direction towards the viewer where that is
    /// `parallel`.
    pub eye: Vec3,
    /// Direction through the upper left corner of the image; a point on its ray if `parallel`.
    pub corner: Vec3,
    /// Step of the direction, or point, from one column to the next.
    pub right: Vec3,
    /// Step of the direction, or point, from one row to the next.
    pub down: Vec3,
    /// All rays have one direction: the projection is orthographic.
    pub parallel: bool,
    /// The picture is mirrored: triangles that face the viewer turn clockwise in it.
    pub mirrored: bool,
    /// Depth of `view_projection` is 1 less that of the matrix that it was made of.
    pub flipped_depth: bool,
}

/// Where a pixel looks.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ray {
    /// A point of it, world space.
    pub origin: Vec3,
    /// Not of unit length.
    pub direction: Vec3,
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
                let tangent = math::tan(0.5 * angle);
                (tangent, tangent * height / width)
            }
            FieldOfView::Y(angle) => {
                let tangent = math::tan(0.5 * angle);
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
            parallel: false,
            mirrored: false,
            flipped_depth: false,
        }
    }

    /// How far a plane is moved along by going from one column to the next and from one row to the next, at
    /// `position` on it; `normal` is of any length. `None` where it is seen edge-on.
    pub fn steps(&self, normal: Vec3, position: Vec3) -> Option<[Vec3; 2]> {
        // From the eye; as long as the ray of a pixel, times `distance`.
        let (mut ray, mut distance) = (-self.eye, 1.0);
        if !self.parallel {
            ray = position - self.eye;
            let axis = self.right.cross(self.down);
            let depth = self.corner.dot(axis);
            if depth == 0.0 {
                return None;
            }
            distance = ray.dot(axis) / depth;
        }
        let towards = ray.dot(normal);
        if towards == 0.0 {
            return None;
        }
        let along = |step: Vec3| {
            let step = distance * step;
            step - ray * (normal.dot(step) / towards)
        };
        Some([along(self.right), along(self.down)])
    }

    /// What `matrix`, world to clip space with depth from 0 to 1, shows in `width` × `height`
    /// pixels. Whether depth is reversed, the projection orthographic or the picture mirrored is
    /// found out; an orthographic projection is taken as not mirrored, which tells whether its depth is reversed.
    ///
    /// `None` where the matrix is not finite, or so nearly singular that pixels have no rays.
    pub fn from_matrix(matrix: Mat4, width: u32, height: u32) -> Option<Self> {
        let [x, y, z, w] = [0, 1, 2, 3].map(|index| matrix.row(index).as_dvec4());
        let parallel = w.truncate() == DVec3::ZERO;
        let pixel = [2.0 / f64::from(width), -2.0 / f64::from(height)];
        let (origin, steps, flipped, mirrored);
        if parallel {
            let forward = y.truncate().cross(x.truncate()).try_normalize()?;
            // Points by their place in the picture, at the depth of the world's origin.
            let inverse = invert(x.truncate(), y.truncate(), forward)?;
            let place =
                |at: [f64; 2]| inverse * DVec3::new(at[0] * w.w - x.w, at[1] * w.w - y.w, 0.0);
            let corner = place([-1.0, 1.0]);
            steps = [
                corner,
                place([-1.0 + pixel[0], 1.0]) - corner,
                place([-1.0, 1.0 + pixel[1]]) - corner,
            ];
            origin = -forward;
            flipped = z.truncate().dot(forward) * w.w > 0.0;
            mirrored = false;
        } else {
            let inverse = invert(x.truncate(), y.truncate(), w.truncate())?;
            origin = inverse * -DVec3::new(x.w, y.w, w.w);
            steps = [
                inverse * DVec3::new(-1.0, 1.0, 1.0),
                inverse * DVec3::new(pixel[0], 0.0, 0.0),
                inverse * DVec3::new(0.0, pixel[1], 0.0),
            ];
            // Depth is this over the distance, and a constant.
            flipped = z.dot(origin.extend(1.0)) < 0.0;
            mirrored = x.truncate().cross(y.truncate()).dot(w.truncate()) > 0.0;
        }
        let depth = if flipped { w - z } else { z };
        let rows = [x, y, depth, w].map(DVec4::as_vec4);
        let view = Self {
            view_projection: Mat4::from_cols(rows[0], rows[1], rows[2], rows[3]).transpose(),
            eye: origin.as_vec3(),
            corner: steps[0].as_vec3(),
            right: steps[1].as_vec3(),
            down: steps[2].as_vec3(),
            parallel,
            mirrored,
            flipped_depth: flipped,
        };
        let finite = view.view_projection.is_finite()
            && [view.eye, view.corner, view.right, view.down]
                .iter()
                .all(|vector| vector.is_finite());
        finite.then_some(view)
    }

    /// The ray through the centre of pixel (`x`, `y`).
    pub fn pixel_ray(&self, x: u32, y: u32) -> Ray {
        self.ray(Vec2::new(x as f32, y as f32) + 0.5)
    }

    /// The ray through a point of the image, in pixels from its upper left corner.
    pub fn ray(&self, at: Vec2) -> Ray {
        let place = self.corner + at.x * self.right + at.y * self.down;
        if self.parallel {
            Ray {
                origin: place,
                direction: -self.eye,
            }
        } else {
            Ray {
                origin: self.eye,
                direction: place,
            }
        }
    }

    /// Direction, not of unit length, of the ray through the centre of pixel (`x`, `y`).
    pub fn pixel_direction(&self, x: u32, y: u32) -> Vec3 {
        self.pixel_ray(x, y).direction
    }

    /// The eye in homogeneous coordinates: less a point times w, the direction from there to the
    /// viewer.
    pub fn homogeneous_eye(&self) -> Vec4 {
        self.eye.extend(if self.parallel { 0.0 } else { 1.0 })
    }
}

/// The inverse of a matrix of rows; `None` where their directions are nearly dependent.
fn invert(a: DVec3, b: DVec3, c: DVec3) -> Option<DMat3> {
    let matrix = DMat3::from_cols(a, b, c).transpose();
    let size = a.length() * b.length() * c.length();
    let independent = matrix.determinant().abs() > 1e-9 * size;
    // Not a number is not greater either.
    independent.then(|| matrix.inverse())
}

impl Ray {
    /// Barycentric coordinates of the point where it meets the plane of a
    /// triangle, clamped to the triangle: a pixel centre may lie a rounding error outside.
    pub fn barycentrics(&self, [a, b, c]: [Vec3; 3]) -> Vec3 {
        let ab = b - a;
        let ac = c - a;
        let from_a = self.origin - a;
        let p = self.direction.cross(ac);
        let q = from_a.cross(ab);
        let determinant = ab.dot(p);
        if determinant == 0.0 {
            return Vec3::splat(1.0 / 3.0);
        }
        let v = (from_a.dot(p) / determinant).max(0.0);
        let w = (self.direction.dot(q) / determinant).max(0.0);
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

    /// Checks that rays project to their own pixels, and that depth falls along them.
    fn rays_project_to_their_pixels(view: &View, [width, height]: [u32; 2]) {
        for (x, y) in [(0, 0), (width - 1, height - 1), (100, 40)] {
            let ray = view.pixel_ray(x, y);
            let mut last = f32::INFINITY;
            for distance in [0.5, 3.0, 20.0] {
                let point = ray.origin + distance * ray.direction;
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
                assert!(ndc.z < last, "depth {} after {last}", ndc.z);
                last = ndc.z;
            }
        }
    }

    #[test]
    fn a_ray_projects_to_its_own_pixel() {
        let (width, height) = (640, 360);
        for field_of_view in [FieldOfView::X(1.1), FieldOfView::Y(0.7)] {
            let view = View::new(&camera(field_of_view), width, height, 0.01);
            rays_project_to_their_pixels(&view, [width, height]);
            let point = view.eye + 3.0 * view.pixel_direction(7, 5);
            let clip = view.view_projection * point.extend(1.0);
            assert!((clip.z / clip.w - 0.01 / 3.0).abs() < 1e-6);
        }
    }

    #[test]
    fn every_kind_of_projection_has_rays() {
        use glam::camera::rh::{proj::directx as project, view::look_at_mat4};
        let size = [640, 360];
        let aspect = 640.0 / 360.0;
        let look = look_at_mat4(Vec3::new(3.0, 2.0, 5.0), Vec3::new(0.5, -0.2, 1.0), Vec3::Y);
        let reversed = Mat4::from_cols_array(&[
            1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0, 0.0, 1.0, 1.0,
        ]);
        let perspective = project::perspective(0.7, aspect, 0.1, 100.0);
        let orthographic = project::orthographic(-3.0, 4.0, -2.0, 1.5, 0.1, 100.0);
        let jitter = Mat4::from_translation(Vec3::new(0.001, -0.002, 0.0));
        let mirror = Mat4::from_scale(Vec3::new(-1.0, 1.0, 1.0));
        for (projection, flipped, mirrored) in [
            (perspective, true, false),
            (reversed * perspective, false, false),
            (jitter * perspective, true, false),
            (mirror * perspective, true, true),
            (
                project::perspective_infinite_reverse(0.7, aspect, 0.1),
                false,
                false,
            ),
            (project::perspective_infinite(0.7, aspect, 0.1), true, false),
            (
                project::frustum(-0.02, 0.05, -0.03, 0.01, 0.1, 50.0),
                true,
                false,
            ),
            (orthographic, true, false),
            (reversed * orthographic, false, false),
        ] {
            let view = View::from_matrix(projection * look, size[0], size[1]).expect("regular");
            assert_eq!((view.flipped_depth, view.mirrored), (flipped, mirrored));
            rays_project_to_their_pixels(&view, size);
        }
        let eye = View::from_matrix(perspective * look, 4, 4)
            .expect("regular")
            .eye;
        assert!(eye.distance(Vec3::new(3.0, 2.0, 5.0)) < 1e-5);
        for singular in [
            Mat4::ZERO,
            Mat4::from_scale(Vec3::new(1.0, 0.0, 1.0)) * perspective * look,
            Mat4::NAN,
            perspective * f32::INFINITY,
        ] {
            assert_eq!(View::from_matrix(singular, 4, 4), None);
        }
    }

    #[test]
    fn a_pinhole_is_its_own_matrix() {
        let pinhole = View::new(&camera(FieldOfView::X(1.1)), 64, 36, 0.01);
        let view = View::from_matrix(pinhole.view_projection, 64, 36).expect("regular");
        assert!(!view.parallel && !view.mirrored && !view.flipped_depth);
        for (found, expected) in [
            (view.eye, pinhole.eye),
            (view.corner, pinhole.corner),
            (view.right, pinhole.right),
            (view.down, pinhole.down),
        ] {
            assert!(found.distance(expected) < 2e-6, "{found}, not {expected}");
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
        let triangle = [
            Vec3::ZERO,
            Vec3::new(1.0, 0.0, 0.0),
            Vec3::new(0.0, 0.5, 1.0),
        ];
        let eye = Vec3::new(3.0, 2.0, 5.0);
        let through = |point: Vec3| Ray {
            origin: eye,
            direction: 7.0 * (point - eye),
        };
        let expected = Vec3::new(0.2, 0.5, 0.3);
        let point = expected.x * triangle[0] + expected.y * triangle[1] + expected.z * triangle[2];
        let found = through(point).barycentrics(triangle);
        assert!(found.distance(expected) < 1e-5, "{found}");
        let outside = through(Vec3::new(2.0, 0.1, 0.0)).barycentrics(triangle);
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
