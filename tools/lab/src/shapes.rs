//! Meshes made by formula, and scenes made of them.

use std::f32::consts::{PI, TAU};

use glam::{Quat, Vec2, Vec3};
use relight_bake::import::plain_material;
use relight_bake::mesh::{Mesh, Triangle, Vertex, ground};
use relight_bake::scene::description::Ground;
use relight_bake::scene::load::SceneInput;
use relight_format::{Camera, Surface};

/// A scene of a mesh and a ground below it.
pub fn over_ground(
    name: &str,
    mut mesh: Mesh,
    ground: &Ground,
    surface: Surface,
    camera: Camera,
) -> anyhow::Result<SceneInput> {
    let diagonal = mesh.diagonal();
    ground::append(
        &mut mesh,
        &ground.extent(),
        plain_material("ground", surface),
    )
    .map_err(|(place, expected, found)| anyhow::anyhow!("{place}: {expected}, {found}"))?;
    Ok(SceneInput {
        name: name.to_owned(),
        object_diagonal: diagonal,
        mesh,
        camera: Some(camera),
        environment: None,
        lights: Vec::new(),
        refinement: None,
        measured: Vec::new(),
        warnings: Vec::new(),
    })
}

/// A grid of vertices, `columns + 1` per row, joined by triangles.
pub fn grid(
    mesh: &mut Mesh,
    material: u16,
    [columns, rows]: [u32; 2],
    at: impl Fn(f32, f32) -> Vertex,
) {
    let base = mesh.vertices.len() as u32;
    for row in 0..=rows {
        for column in 0..=columns {
            mesh.vertices
                .push(at(column as f32 / columns as f32, row as f32 / rows as f32));
        }
    }
    for row in 0..rows {
        for column in 0..columns {
            let a = base + row * (columns + 1) + column;
            let (b, c, d) = (a + 1, a + columns + 1, a + columns + 2);
            for vertices in [[a, c, b], [b, c, d]] {
                let [p, q, r] = vertices.map(|v| mesh.vertices[v as usize].position);
                // At a pole two corners are one but for rounding.
                let [a, b] = [q - p, r - p];
                if a.cross(b).length() > 1e-5 * (a.length_squared() + b.length_squared()) {
                    mesh.triangles.push(Triangle { vertices, material });
                }
            }
        }
    }
}

/// A sphere of `rows` rows and twice as many columns.
pub fn sphere(mesh: &mut Mesh, material: u16, centre: Vec3, radius: f32, rows: u32) {
    grid(mesh, material, [2 * rows, rows], |u, v| {
        let (phi, theta) = (TAU * u, PI * v);
        let normal = Vec3::new(
            phi.sin() * theta.sin(),
            theta.cos(),
            phi.cos() * theta.sin(),
        );
        let tangent = Vec3::new(phi.cos(), 0.0, -phi.sin());
        vertex(centre + radius * normal, normal, tangent, [u, v])
    });
}

/// A tube about a curve over \[0, 1\], without caps.
pub fn tube(
    mesh: &mut Mesh,
    material: u16,
    along: u32,
    around: u32,
    radius: f32,
    curve: impl Fn(f32) -> Vec3,
) {
    grid(mesh, material, [around, along], |u, v| {
        let step = 1e-3;
        let tangent = (curve(v + step) - curve(v - step)).normalize();
        // Any direction that the curve is never parallel to makes a frame without twist.
        let helper = Vec3::new(0.31, 0.11, 0.94).normalize();
        let side = tangent.cross(helper).normalize();
        let normal = Quat::from_axis_angle(tangent, -TAU * u) * side;
        vertex(curve(v) + radius * normal, normal, tangent, [u, v])
    });
}

/// A box with flat sides of one quadrilateral each.
pub fn cuboid(mesh: &mut Mesh, material: u16, low: Vec3, high: Vec3) {
    let (middle, half) = (0.5 * (low + high), 0.5 * (high - low));
    for (normal, tangent) in [(Vec3::X, Vec3::Y), (Vec3::Y, Vec3::Z), (Vec3::Z, Vec3::X)] {
        for normal in [normal, -normal] {
            let bitangent = tangent.cross(normal);
            grid(mesh, material, [1, 1], |u, v| {
                let at = normal + (2.0 * u - 1.0) * tangent + (2.0 * v - 1.0) * bitangent;
                vertex(middle + half * at, normal, tangent, [u, v])
            });
        }
    }
}

fn vertex(position: Vec3, normal: Vec3, tangent: Vec3, uv: [f32; 2]) -> Vertex {
    Vertex {
        position,
        normal,
        tangent,
        bitangent_sign: 1.0,
        uv: Vec2::from(uv),
        second_uv: Vec2::ZERO,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn triangles_face_as_their_normals_do() {
        let mut mesh = Mesh::default();
        sphere(&mut mesh, 0, Vec3::new(1.0, 2.0, 3.0), 0.5, 8);
        tube(&mut mesh, 0, 9, 7, 0.1, |t| Vec3::new(t, t * t, 0.0));
        cuboid(&mut mesh, 0, Vec3::ZERO, Vec3::new(1.0, 2.0, 3.0));
        for triangle in &mesh.triangles {
            let corners = triangle
                .vertices
                .map(|vertex| &mesh.vertices[vertex as usize]);
            let [a, b, c] = corners.map(|corner| corner.position);
            let normal: Vec3 = corners.iter().map(|corner| corner.normal).sum();
            assert!((b - a).cross(c - a).dot(normal) > 0.0, "{corners:?}");
        }
    }
}
