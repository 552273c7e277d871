//! Where a picture is taken from.

use std::path::Path;

use glam::Vec3;
use relight_bake::error::{Error, Objection};
use relight_bake::files::{Access, Files};
use relight_bake::scene::description;
use relight_format::{Camera, FieldOfView};

/// Reads a camera file: TOML with the keys of a scene file's `[camera]` table.
pub fn load(path: &Path) -> Result<Camera, Error> {
    let bytes = Files::new(path, &Access::default())?.read_named(path)?;
    let camera: description::Camera = description::parse_toml(path, &bytes, "a camera")?;
    let found = camera.to_format().ok_or_else(|| {
        let expected = "one of fov_x_degrees and fov_y_degrees";
        Error::invalid(path, "camera", expected, "none or both")
    })?;
    check(&found).map_err(|objection| objection.in_file(path))?;
    Ok(found)
}

/// Objects to a camera that shows nothing.
pub fn check(camera: &Camera) -> Result<(), Objection> {
    let (FieldOfView::X(angle) | FieldOfView::Y(angle)) = camera.field_of_view;
    if !(angle > 0.0 && angle < std::f32::consts::PI) {
        let degrees = angle.to_degrees();
        let place = "field of view of the camera";
        return Err(Objection::new(place, "degrees in (0, 180)", degrees));
    }
    let [position, target, up] = [camera.position, camera.target, camera.up].map(Vec3::from);
    let forward = target - position;
    if !(position.is_finite() && forward.is_finite() && forward.length_squared() > 0.0) {
        let expected = format!("a point other than its position, {position}");
        return Err(Objection::new("target of the camera", expected, target));
    }
    if !(up.is_finite() && forward.cross(up).length_squared() > 0.0) {
        let expected = format!("a direction other than that of its view, {forward}");
        return Err(Objection::new("up of the camera", expected, up));
    }
    Ok(())
}

/// A view from the upper front right that holds all of a bounding box.
pub fn framing(low: Vec3, high: Vec3) -> Camera {
    let field_of_view = 40f32.to_radians();
    let radius = (0.5 * (high - low).length()).max(f32::MIN_POSITIVE);
    let target = 0.5 * (low + high);
    let distance = radius / (0.5 * field_of_view).sin();
    Camera {
        position: (target + Vec3::new(0.55, 0.4, 1.0).normalize() * distance).into(),
        target: target.into(),
        up: [0.0, 1.0, 0.0],
        field_of_view: FieldOfView::Y(field_of_view),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use relight_shading::camera::View;

    #[test]
    fn the_framing_shows_every_corner() {
        let (low, high) = (Vec3::new(-3.0, 0.0, 2.0), Vec3::new(1.0, 0.5, 9.0));
        let view = View::new(&framing(low, high), 100, 100, 0.1);
        for i in 0..8 {
            let pick = |bit: u32| if i >> bit & 1 == 1 { 1.0 } else { 0.0 };
            let corner = low + (high - low) * Vec3::new(pick(0), pick(1), pick(2));
            let clip = view.view_projection * corner.extend(1.0);
            let place = clip.truncate() / clip.w;
            assert!(
                place.x.abs() < 1.0 && place.y.abs() < 1.0 && clip.w > 0.0,
                "{place}"
            );
        }
    }

    #[test]
    fn camera_files_are_checked() {
        let folder = tempfile::tempdir().unwrap();
        let read = |text: &str| {
            let path = folder.path().join("camera.toml");
            std::fs::write(&path, text).unwrap();
            load(&path).map_err(|error| error.to_string())
        };
        let place = "position = [0, 1, 4]\ntarget = [0, 0, 0]\n";
        let camera = read(&format!("{place}fov_x_degrees = 28")).unwrap();
        assert_eq!(camera.field_of_view, FieldOfView::X(28f32.to_radians()));
        assert_eq!(camera.up, [0.0, 1.0, 0.0]);
        assert!(read(place).unwrap_err().contains("fov_x_degrees"));
        assert!(
            read(&format!("{place}fov_x_degrees = 280"))
                .unwrap_err()
                .contains("280")
        );
        assert!(read(&format!("{place}fov_y_degrees = 30\nup = [0, 1, 4]")).is_err());
        assert!(
            read("position = [0, 0, 0]\nzoom = 1")
                .unwrap_err()
                .contains("zoom")
        );
    }
}
