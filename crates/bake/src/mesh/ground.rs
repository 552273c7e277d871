//! A horizontal receiver under a mesh, fine enough to carry the mesh's shadow.

use glam::{Vec2, Vec3};
use relight_format::Material;

use super::{Mesh, Triangle, Vertex};

/// Default side length, in longest extents of the mesh.
const DEFAULT_EXTENTS: f32 = 3.0;
/// Default vertex spacings per side.
const DEFAULT_CELLS: f32 = 80.0;
/// Most cells per side: four million vertices.
const MAX_CELLS: f32 = 2048.0;

/// Where a ground lies; what is left out follows from the mesh.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Extent {
    /// Length of its sides, metres. Default: three times the mesh's longest extent.
    pub size: Option<f32>,
    /// Its y coordinate, metres. Default: the mesh's lowest point.
    pub height: Option<f32>,
    /// x and z of its centre, metres. Default: under the centre of the mesh's bounding box.
    pub center: Option<[f32; 2]>,
    /// Largest distance of neighbouring vertices, metres. Default: 1/80 of `size`.
    pub spacing: Option<f32>,
}

/// Appends a square grid facing +Y and its material, named `ground`.
///
/// # Errors
///
/// Place, expected and found, when the options ask for too many vertices or the mesh has
/// too many materials.
pub fn append(
    mesh: &mut Mesh,
    extent: &Extent,
    material: Material,
) -> Result<(), (&'static str, String, String)> {
    let (low, high) = mesh.bounds().unwrap_or((Vec3::ZERO, Vec3::ZERO));
    let size = extent
        .size
        .unwrap_or((high - low).max_element() * DEFAULT_EXTENTS);
    let height = extent.height.unwrap_or(low.y);
    let [x, z] = extent
        .center
        .unwrap_or([(low.x + high.x) * 0.5, (low.z + high.z) * 0.5]);
    let cells = extent
        .spacing
        .map_or(DEFAULT_CELLS, |spacing| (size / spacing).ceil().max(1.0));
    // Written so that a size or spacing that overflows to infinity or NaN fails too.
    if !(cells <= MAX_CELLS && (x.abs() + z.abs() + size).is_finite()) {
        let expected = format!("at most {MAX_CELLS} spacings per side, inside finite space");
        return Err((
            "ground.spacing",
            expected,
            format!("{cells} spacings on {size} m"),
        ));
    }
    let Ok(index) = u16::try_from(mesh.materials.len()) else {
        return Err((
            "ground",
            "fewer than 65536 materials".into(),
            "65536 in the mesh".into(),
        ));
    };
    mesh.materials.push(Material {
        name: "ground".into(),
        ..material
    });
    let base = mesh.vertices.len() as u32;
    let cells = cells as u32;
    let row = cells + 1;
    for j in 0..row {
        for i in 0..row {
            let uv = [i, j].map(|k| k as f32 / cells as f32);
            let [u, v] = uv.map(|t| (t - 0.5) * size);
            mesh.vertices.push(Vertex {
                position: Vec3::new(x + u, height, z + v),
                normal: Vec3::Y,
                tangent: Vec3::X,
                bitangent_sign: 1.0,
                uv: Vec2::from(uv),
                second_uv: Vec2::ZERO,
            });
        }
    }
    for j in 0..cells {
        for i in 0..cells {
            let a = base + j * row + i;
            let (b, c, d) = (a + 1, a + row, a + row + 1);
            // Alternating diagonals keep shadow edges from following one direction.
            let halves = if (i + j) % 2 == 0 {
                [[a, c, d], [a, d, b]]
            } else {
                [[a, c, b], [b, c, d]]
            };
            mesh.triangles.extend(halves.map(|vertices| Triangle {
                vertices,
                material: index,
            }));
        }
    }
    Ok(())
}
