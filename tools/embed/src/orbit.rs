//! A camera that turns about a point.

use glam::{Mat3, Quat, Vec3};
use relight_format::{Camera, FieldOfView};

/// How close to the poles the camera may come, radians.
const POLE: f32 = 0.01;
/// Distances are kept within these, metres.
const DISTANCES: (f32, f32) = (1e-6, 1e12);

/// A camera by what it looks at and from where.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Orbit {
    /// The point in the middle of the picture, world space.
    pub target: Vec3,
    /// Turn about `up`, radians; 0 looks from +Z where `up` is +Y.
    pub yaw: f32,
    /// Height above the horizon of the target, radians.
    pub pitch: f32,
    /// From the target, metres.
    pub distance: f32,
    /// Unit vector, world space.
    pub up: Vec3,
    /// Full angle of view.
    pub field_of_view: FieldOfView,
}

impl Orbit {
    /// The camera in these terms; its distance is that of its target.
    pub fn new(camera: &Camera) -> Self {
        let up = Vec3::from(camera.up).normalize_or(Vec3::Y);
        let offset = Vec3::from(camera.position) - Vec3::from(camera.target);
        let distance = offset.length();
        let local = frame(up).transpose() * (offset / distance.max(f32::MIN_POSITIVE));
        Self {
            target: camera.target.into(),
            yaw: local.x.atan2(local.z),
            pitch: local.y.clamp(-1.0, 1.0).asin(),
            distance: distance.clamp(DISTANCES.0, DISTANCES.1),
            up,
            field_of_view: camera.field_of_view,
        }
        .limited()
    }

    /// The camera as the runtime has it.
    pub fn camera(&self) -> Camera {
        Camera {
            position: (self.target + self.distance * self.outward()).into(),
            target: self.target.into(),
            up: self.up.into(),
            field_of_view: self.field_of_view,
        }
    }

    /// From the target to the eye, of unit length.
    pub fn outward(&self) -> Vec3 {
        let (sine, cosine) = self.pitch.sin_cos();
        frame(self.up) * Vec3::new(cosine * self.yaw.sin(), sine, cosine * self.yaw.cos())
    }

    /// Turns by a drag, in fractions of the picture's height; to the right and down is positive.
    #[must_use]
    pub fn turned(self, x: f32, y: f32) -> Self {
        Self {
            yaw: self.yaw - 4.0 * x,
            pitch: self.pitch + 4.0 * y,
            ..self
        }
        .limited()
    }

    /// Moves so that the target follows a drag, in fractions of the picture's height.
    #[must_use]
    pub fn panned(self, x: f32, y: f32, aspect: f32) -> Self {
        let half = match self.field_of_view {
            FieldOfView::Y(angle) => (0.5 * angle).tan(),
            FieldOfView::X(angle) => (0.5 * angle).tan() / aspect,
        };
        let outward = self.outward();
        let right = self.up.cross(outward).normalize_or(Vec3::X);
        let up = outward.cross(right);
        let scale = 2.0 * half * self.distance;
        Self {
            target: self.target + scale * (y * up - x * right),
            ..self
        }
    }

    /// Comes closer by a factor above 1.
    #[must_use]
    pub fn dollied(self, factor: f32) -> Self {
        Self {
            distance: self.distance / factor,
            ..self
        }
        .limited()
    }

    /// Looks at a bounding box from where it looks now.
    #[must_use]
    pub fn framing(self, low: Vec3, high: Vec3, aspect: f32) -> Self {
        let radius = 0.5 * (high - low).length();
        let half = match self.field_of_view {
            FieldOfView::Y(angle) | FieldOfView::X(angle) => 0.5 * angle,
        };
        // The narrower of the two angles has to hold the sphere about the box.
        let narrow = match self.field_of_view {
            FieldOfView::Y(_) => (half.tan() * aspect.min(1.0)).atan(),
            FieldOfView::X(_) => (half.tan() / aspect.max(1.0)).atan(),
        };
        Self {
            target: 0.5 * (low + high),
            distance: radius / narrow.sin(),
            ..self
        }
        .limited()
    }

    fn limited(self) -> Self {
        let most = std::f32::consts::FRAC_PI_2 - POLE;
        Self {
            pitch: self.pitch.clamp(-most, most),
            distance: self.distance.clamp(DISTANCES.0, DISTANCES.1),
            ..self
        }
    }
}

/// Columns: the axes that play +X, +Y and +Z where `up` is +Y.
fn frame(up: Vec3) -> Mat3 {
    Mat3::from_quat(Quat::from_rotation_arc(Vec3::Y, up))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn camera() -> Camera {
        Camera {
            position: [1.0, 2.0, 4.0],
            target: [0.5, 0.25, -1.0],
            up: [0.0, 1.0, 0.0],
            field_of_view: FieldOfView::Y(0.7),
        }
    }

    #[test]
    fn a_camera_survives_the_round_trip() {
        for up in [Vec3::Y, Vec3::Z, Vec3::new(0.3, 0.9, -0.2).normalize()] {
            let camera = Camera {
                up: up.into(),
                ..camera()
            };
            let back = Orbit::new(&camera).camera();
            let distance = Vec3::from(back.position).distance(camera.position.into());
            assert!(distance < 1e-5, "{up}: {back:?}");
            assert_eq!(back.target, camera.target);
        }
    }

    #[test]
    fn drags_do_what_hands_expect() {
        let orbit = Orbit::new(&camera());
        // To the right: the camera goes left, so that the scene turns to the right.
        let right = orbit.up.cross(orbit.outward());
        let moved = orbit.turned(0.1, 0.0).outward() - orbit.outward();
        assert!(moved.dot(right) < 0.0);
        // Down: the camera rises; never over the pole.
        assert!(orbit.turned(0.0, 0.1).pitch > orbit.pitch);
        assert!(orbit.turned(0.0, 100.0).outward().y < 1.0);
        // Panning to the right moves the scene to the right, the camera to the left.
        assert!((orbit.panned(0.1, 0.0, 1.5).target - orbit.target).dot(right) < 0.0);
        assert!(orbit.dollied(2.0).distance < orbit.distance);
        assert!(orbit.dollied(f32::INFINITY).distance > 0.0);
    }

    #[test]
    fn framing_shows_the_box_in_any_picture() {
        let (low, high) = (Vec3::new(-3.0, 0.0, 2.0), Vec3::new(1.0, 0.5, 9.0));
        for (width, height) in [(100, 50), (50, 100)] {
            for field_of_view in [FieldOfView::X(0.8), FieldOfView::Y(0.8)] {
                let orbit = Orbit {
                    field_of_view,
                    ..Orbit::new(&camera())
                };
                let framed = orbit.framing(low, high, width as f32 / height as f32);
                let view =
                    relight_shading::camera::View::new(&framed.camera(), width, height, 0.01);
                for corner in 0..8 {
                    let pick = |axis: usize| {
                        if corner >> axis & 1 == 1 {
                            high[axis]
                        } else {
                            low[axis]
                        }
                    };
                    let clip =
                        view.view_projection * Vec3::new(pick(0), pick(1), pick(2)).extend(1.0);
                    let place = clip.truncate() / clip.w;
                    assert!(
                        place.x.abs() <= 1.0 && place.y.abs() <= 1.0 && clip.w > 0.0,
                        "{place}"
                    );
                }
            }
        }
    }
}
