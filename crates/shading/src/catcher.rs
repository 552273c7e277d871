//! Shadow catchers: surfaces that pictures have only the shadow, reflection and bounced light of, to be
//! laid over a photograph of the same place.
//!
//! A catcher is shaded twice: as it is, and *open*, with nothing that hides light from it but its own
//! horizon, and without light that bounces. From both follow a colour C, multiplied by its coverage, and a
//! coverage α: over a plate P they make C + (1 − α) P. Over the open picture itself that is the
//! opaque picture, exactly; over another plate the light that every channel loses is that of the channel
//! that loses most, in proportion, and the others' rest is added as it is.

use glam::{Vec3, Vec4};
use relight_format::{CHANNELS_PER_TILE, Cluster, Material, Scene};

use crate::octahedral;

/// Texels per side of the images of [`open_scene`].
const RESOLUTION: u32 = 32;
/// Radiance, as a part of the brightest channel's, below which a channel tells nothing of shadows.
const DARK: f32 = 1e-4;

/// Colour, multiplied by coverage, and coverage, that make `shaded` over `open`; neither is negative.
pub fn catch(shaded: Vec3, open: Vec3) -> Vec4 {
    let least = DARK * open.max_element();
    let mut kept = 1.0f32;
    for channel in 0..3 {
        if open[channel] > least {
            kept = kept.min(shaded[channel] / open[channel]);
        }
    }
    (shaded - kept * open).max(Vec3::ZERO).extend(1.0 - kept)
}

/// A texel of the runtime's images: radiance and coverage as `shaded`, which is 0 where shadows are caught
/// and on the background, and radiance as `open`.
pub fn caught(shaded: [f32; 4], open: [f32; 4]) -> [f32; 4] {
    if shaded[3] != 0.0 {
        return shaded;
    }
    let [shaded, open] = [shaded, open].map(|[r, g, b, _]| Vec3::new(r, g, b));
    catch(shaded, open).to_array()
}

/// The constants of this module, as WGSL.
pub fn wgsl_constants() -> String {
    format!("const CATCHER_DARK: f32 = {DARK:?};\n")
}

/// Whether any material of a scene is a catcher.
pub fn catches(materials: &[Material]) -> bool {
    materials.iter().any(|material| material.shadow_catcher)
}

/// The scene with nothing that hides light from its surfaces but their own horizons, and without light
/// that bounces: the signed distance of every vertex is that to its horizon, to third order.
pub fn open_scene(scene: &Scene) -> Scene {
    // The sine of the angle above the horizon is the scalar product of direction and normal.
    let tile: Vec<i8> = (0..RESOLUTION * RESOLUTION)
        .flat_map(|index| {
            let axis =
                octahedral::texel_direction(index % RESOLUTION, index / RESOLUTION, RESOLUTION);
            let [x, y, z] = axis.to_array().map(|x| (127.0 * x).round() as i8);
            [x, y, z, 0]
        })
        .collect();
    let clusters = (0u32..)
        .zip(&scene.clusters)
        .map(|(index, cluster)| Cluster {
            first_coefficient: cluster.first_vertex * CHANNELS_PER_TILE as u32,
            first_tile: index,
            tiles: 1,
            coefficient_scale: 1.0,
            ..*cluster
        });
    let coefficients = scene.vertices.iter().flat_map(|vertex| {
        let normal = Vec3::from(vertex.normal).normalize_or(Vec3::Y);
        let [x, y, z] = normal.to_array().map(|x| (32767.0 * x).round() as i16);
        [x, y, z, 0]
    });
    let mut visibility = scene.visibility.clone();
    visibility.basis_resolution = RESOLUTION;
    Scene {
        name: scene.name.clone(),
        visibility,
        camera: scene.camera,
        materials: scene.materials.clone(),
        textures: scene.textures.clone(),
        report: relight_format::BakeReport::default(),
        vertices: scene.vertices.clone(),
        second_uvs: scene.second_uvs.clone(),
        triangles: scene.triangles.clone(),
        clusters: clusters.collect(),
        coefficients: coefficients.collect(),
        basis: tile.repeat(scene.clusters.len()),
        transfer: None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_caught_makes_the_shaded_picture_over_the_open_one() {
        let open = Vec3::new(0.5, 0.4, 2.0);
        for shaded in [
            Vec3::new(0.1, 0.2, 1.9),
            Vec3::new(0.5, 0.4, 2.0),
            Vec3::new(0.6, 0.7, 2.5),
            Vec3::ZERO,
        ] {
            let caught = catch(shaded, open);
            let over = caught.truncate() + (1.0 - caught.w) * open;
            assert!(over.distance(shaded) < 1e-6, "{shaded}: {over}");
            assert!(caught.min_element() >= 0.0 && caught.w <= 1.0, "{caught}");
        }
        assert_eq!(catch(open, open), Vec4::ZERO);
        assert_eq!(catch(Vec3::ONE, Vec3::ZERO), Vec3::ONE.extend(0.0));
        // A grey shadow is nothing but coverage.
        let grey = catch(0.25 * open, open);
        assert!(grey.truncate().length() < 1e-6 && (grey.w - 0.75).abs() < 1e-6);
    }
}
