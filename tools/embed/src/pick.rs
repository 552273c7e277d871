//! What lies under the pointer.

use glam::Vec3;
use relight_format::Scene;
use relight_shading::camera::View;

/// A point of a surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hit {
    /// Index into the scene's triangles.
    pub triangle: usize,
    /// Barycentric coordinates of the point.
    pub weights: Vec3,
    /// World space.
    pub position: Vec3,
}

/// The front that a ray from the eye through a point of the picture meets first. `x` and `y` are
/// pixels from the upper left corner of the picture that `view` is of.
pub fn pick(scene: &Scene, view: &View, x: f32, y: f32) -> Option<Hit> {
    let direction = view.corner + x * view.right + y * view.down;
    let mut nearest: Option<(f32, Hit)> = None;
    for (index, triangle) in scene.triangles.iter().enumerate() {
        let [a, b, c] =
            (triangle.vertices).map(|vertex| Vec3::from(scene.vertices[vertex as usize].position));
        // Möller and Trumbore 1997, fronts only.
        let (ab, ac, from) = (b - a, c - a, view.eye - a);
        let p = direction.cross(ac);
        let determinant = ab.dot(p);
        if determinant <= 0.0 {
            continue;
        }
        let v = from.dot(p);
        if !(0.0..=determinant).contains(&v) {
            continue;
        }
        let q = from.cross(ab);
        let w = direction.dot(q);
        if w < 0.0 || v + w > determinant {
            continue;
        }
        let distance = ac.dot(q) / determinant;
        if distance > 0.0 && nearest.is_none_or(|(least, _)| distance < least) {
            let (v, w) = (v / determinant, w / determinant);
            let hit = Hit {
                triangle: index,
                weights: Vec3::new(1.0 - v - w, v, w),
                position: view.eye + distance * direction,
            };
            nearest = Some((distance, hit));
        }
    }
    nearest.map(|(_, hit)| hit)
}

/// Corners of the box about the triangles of a material, or about all of them.
pub fn bounds(scene: &Scene, material: Option<usize>) -> Option<(Vec3, Vec3)> {
    let mut bounds: Option<(Vec3, Vec3)> = None;
    for triangle in &scene.triangles {
        if material.is_some_and(|material| usize::from(triangle.material) != material) {
            continue;
        }
        for vertex in triangle.vertices {
            let position = Vec3::from(scene.vertices[vertex as usize].position);
            let (low, high) = bounds.unwrap_or((position, position));
            bounds = Some((low.min(position), high.max(position)));
        }
    }
    bounds
}
