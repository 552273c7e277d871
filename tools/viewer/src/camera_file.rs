//! What is seen from, as a file.

use std::fmt::Write as _;

use relight_format::{Camera, FieldOfView};

/// The text of a camera file, for `lab render --camera`, scene files and us.
pub fn text(camera: &Camera) -> String {
    let mut text = String::new();
    for (name, vector) in [
        ("position", camera.position),
        ("target", camera.target),
        ("up", camera.up),
    ] {
        writeln!(text, "{name} = {vector:?}").expect("a String accepts every write");
    }
    let (name, angle) = match camera.field_of_view {
        FieldOfView::X(angle) => ("fov_x_degrees", angle),
        FieldOfView::Y(angle) => ("fov_y_degrees", angle),
    };
    writeln!(text, "{name} = {:?}", angle.to_degrees()).expect("a String accepts every write");
    text
}
