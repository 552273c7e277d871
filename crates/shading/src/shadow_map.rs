//! An app's own shadow map: what of a source's light is hidden by things that are not in the scene.
//!
//! The point that a pixel sees is compared with the depths of the four texels around it, and the results, not the depths, are
//! interpolated (Reeves, Salesin & Cook 1987, "Rendering antialiased shadows with depth maps"): edges are as soft as a texel
//! is wide. What rays find visible of the source is multiplied by the rest.

use glam::{Mat4, Vec2, Vec3, Vec4Swizzles as _};

/// Depths on the CPU, row 0 at the top.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DepthImage<'a> {
    /// Texels per row, at least 1.
    pub width: u32,
    /// Rows, at least 1.
    pub height: u32,
    /// `width * height` depths.
    pub depths: &'a [f32],
}

/// How a shadow map is looked up.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lookup {
    /// From the space of the scene to the map's clip space.
    pub matrix: Mat4,
    /// Which source it is of.
    pub source: usize,
    /// 1 where depth grows with distance from the light, −1 where it falls.
    pub sign: f32,
    /// What hides a point is nearer by more than this, in units of depth.
    pub bias: f32,
}

impl Lookup {
    /// How much of the light does not reach a position of the scene: 0 to 1; 0 outside of the map.
    pub fn hidden(&self, image: &DepthImage, position: Vec3) -> f32 {
        let clip = self.matrix * position.extend(1.0);
        if clip.w <= 0.0 {
            return 0.0;
        }
        let place = clip.xyz() / clip.w;
        if !(0.0..=1.0).contains(&place.z) {
            return 0.0;
        }
        let size = Vec2::new(image.width as f32, image.height as f32);
        // From the first texel's centre.
        let at = (Vec2::new(place.x, -place.y) * 0.5 + 0.5) * size - 0.5;
        let low = at.floor();
        let f = at - low;
        let mut hidden = 0.0;
        for i in 0..4u32 {
            let corner = Vec2::new((i & 1) as f32, (i >> 1) as f32);
            let texel = low + corner;
            let inside = texel.cmpge(Vec2::ZERO).all() && texel.cmplt(size).all();
            if !inside {
                continue;
            }
            let depth = image.depths[texel.y as usize * image.width as usize + texel.x as usize];
            if self.sign * (depth - place.z) + self.bias < 0.0 {
                let weight = corner * f + (1.0 - corner) * (1.0 - f);
                hidden += weight.x * weight.y;
            }
        }
        hidden
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Half of a map of the square from −1 to 1, seen along −z from z = 1 to −1, has something at z = 0.
    #[test]
    fn what_is_behind_something_is_hidden() {
        let matrix = glam::camera::rh::proj::directx::orthographic(-1.0, 1.0, -1.0, 1.0, -1.0, 1.0);
        let depths: Vec<f32> = (0..64).map(|i| if i % 8 < 4 { 0.5 } else { 1.0 }).collect();
        let reversed: Vec<f32> = depths.iter().map(|depth| 1.0 - depth).collect();
        let flip = Mat4::from_translation(Vec3::Z) * Mat4::from_scale(Vec3::new(1.0, 1.0, -1.0));
        for (matrix, depths, sign) in [(matrix, &depths, 1.0), (flip * matrix, &reversed, -1.0)] {
            let image = DepthImage {
                width: 8,
                height: 8,
                depths,
            };
            let lookup = Lookup {
                matrix,
                source: 0,
                sign,
                bias: 0.01,
            };
            let hidden = |x: f32, y: f32, z: f32| lookup.hidden(&image, Vec3::new(x, y, z));
            let close = |a: f32, b: f32| assert!((a - b).abs() < 1e-5, "{sign}: {a} {b}");
            close(hidden(-0.5, 0.3, -0.5), 1.0);
            close(hidden(0.5, 0.3, -0.5), 0.0);
            // Nearer to the light, and on what hides.
            close(hidden(-0.5, 0.3, 0.5), 0.0);
            close(hidden(-0.5, 0.3, 0.0), 0.0);
            // A texel is a quarter wide; on the edge half is hidden, and less beside it.
            close(hidden(0.0, 0.1, -0.5), 0.5);
            close(hidden(0.0625, 0.1, -0.5), 0.25);
            // Outside.
            close(hidden(-2.0, 0.0, -0.5), 0.0);
            close(hidden(-0.5, 0.0, -3.0), 0.0);
        }
    }
}
