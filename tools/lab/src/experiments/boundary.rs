//! Fig. 6: what straight boundaries cost and what linear lobes cost, one without the other.
//!
//! Both are integrated by brute force over the cells that `cells` ends with: the exact lobes
//! over the straight-edged part of each cell, the linear ones over the part that is visible.

use std::f32::consts::PI;

use glam::{Vec2, Vec3};
use relight_runtime::{CellsOptions, Frame, Method, twin};
use relight_shading::cells::{self, Leaf};
use relight_shading::shade::Lighting;
use relight_shading::shade_cells;
use relight_shading::spherical_gaussian::SphericalGaussian;
use relight_shading::ssdf::{SignedDistance, Ssdf};
use relight_shading::surface::SurfacePoint;

use super::report::{Section, Table};
use super::{Laboratory, camera, percent};
use crate::image_file::Image;

/// Samples per half-sphere, θ and φ; every cell has as many as fit in it, and at least [`LEAST`].
const STEPS: Vec2 = Vec2::new(96.0, 24.0);
const LEAST: f32 = 4.0;

const PARTITIONS: [(&str, Option<[u32; 2]>); 4] = [
    ("1x1", Some([1, 1])),
    ("2x8", Some([2, 8])),
    ("4x16", Some([4, 16])),
    ("adaptive", None),
];

/// Radiance by exact boundaries and lobes, by straight boundaries, and by linear lobes.
#[derive(Clone, Copy, Default)]
struct Pixel {
    covered: bool,
    exact: Vec3,
    straight: Vec3,
    linear: Vec3,
    cells: usize,
}

pub fn run(laboratory: &mut Laboratory, section: &mut Section) -> anyhow::Result<()> {
    let mut scene = (*laboratory.scene("duck")?).clone();
    super::compression::put_diffuse(&mut scene);
    let light = laboratory.light("grace", 16)?;
    let frame = light.frame(camera(&scene)?);
    let [width, height] = laboratory.settings.size.map(|side| side.div_ceil(3));
    section.text = vec![
        "A diffuse duck under 16 lobes of grace. `Boundaries` has straight boundaries in every \
         cell and the lobes as they are, `lobes` has lobes that are linear in every cell and \
         boundaries as they are; relative RMSE against neither, all three by brute force over \
         the same cells and the same signed distances."
            .to_owned(),
    ];
    let mut table = Table::new(
        "boundary",
        "Errors of the two approximations of the paper's cells",
        &["partition", "cells per pixel", "boundaries, %", "lobes, %"],
    );
    let (mut straights, mut linears) = (Vec::new(), Vec::new());
    let mut exact = None;
    for (name, uniform) in PARTITIONS {
        laboratory.monitor.step("integrate cells", 0.0)?;
        let options = CellsOptions {
            uniform,
            ..CellsOptions::STANDARD
        };
        let shade = |point: &SurfacePoint, lighting: &Lighting, field: &Ssdf| {
            integrate(point, lighting, field, &options)
        };
        let frame = Frame {
            method: Method::Cells(options),
            ..frame.clone()
        };
        let pixels = twin::map_pixels(&scene, &frame, [width, height], shade)?;
        let image = |radiance: fn(&Pixel) -> Vec3| Image {
            width,
            height,
            pixels: (pixels.iter())
                .map(|pixel| {
                    radiance(pixel)
                        .extend(f32::from(u8::from(pixel.covered)))
                        .into()
                })
                .collect(),
            variance: None,
        };
        let reference = image(|pixel| pixel.exact);
        let straight = image(|pixel| pixel.straight);
        let linear = image(|pixel| pixel.linear);
        let covered = pixels.iter().filter(|pixel| pixel.covered).count();
        let cells: usize = pixels.iter().map(|pixel| pixel.cells).sum();
        table.row([
            name.into(),
            (cells as f64 / covered.max(1) as f64).into(),
            percent(&straight, &reference)?,
            percent(&linear, &reference)?,
        ]);
        straights.push(straight);
        linears.push(linear);
        exact = Some(reference);
    }
    section.tables.push(table);
    for (name, what, images) in [
        ("straight", "Straight boundaries alone", &straights),
        ("linear", "Linear lobes alone", &linears),
    ] {
        let mut images: Vec<&Image> = images.iter().collect();
        images.extend(&exact);
        let caption = format!("{what}: 1x1, 2x8, 4x16, adaptive, neither");
        laboratory.strip(section, name, &caption, &images)?;
    }
    Ok(())
}

fn integrate(
    point: &SurfacePoint,
    lighting: &Lighting,
    field: &Ssdf,
    options: &CellsOptions,
) -> Pixel {
    let mut pixel = Pixel {
        covered: true,
        ..Pixel::default()
    };
    shade_cells::groups(point, lighting, |about, lobes| {
        let finest = Vec2::new(2.0 * PI, about.1) / STEPS;
        for leaf in cells::leaves(field, about, point.normal, lobes, options) {
            pixel.cells += 1;
            add(&leaf, finest, lobes, point.normal, field, &mut pixel);
        }
    });
    pixel
}

fn add(
    leaf: &Leaf,
    finest: Vec2,
    lobes: &[SphericalGaussian],
    normal: Vec3,
    field: &Ssdf,
    pixel: &mut Pixel,
) {
    let [low, high] = leaf.extent();
    let steps = ((high - low) / finest).ceil().max(Vec2::splat(LEAST));
    let step = (high - low) / steps;
    let linear: Vec<[f32; 2]> = lobes.iter().map(|lobe| leaf.linear(lobe)).collect();
    for row in 0..steps.y as u32 {
        for column in 0..steps.x as u32 {
            let at = low + (Vec2::new(column as f32, row as f32) + 0.5) * step;
            let direction = leaf.direction(at);
            let flux = step.x * step.y * at.y.sin() * normal.dot(direction);
            let straight = leaf.visible(at);
            let visible = flux > 0.0 && field.distance(direction) > 0.0;
            if visible || straight {
                let radiance: Vec3 = lobes.iter().map(|lobe| lobe.evaluate(direction)).sum();
                if visible {
                    pixel.exact += flux * radiance;
                    pixel.linear += (lobes.iter().zip(&linear))
                        .map(|(lobe, [alpha, beta])| {
                            lobe.amplitude * (flux * (alpha + beta * lobe.axis.dot(direction)))
                        })
                        .sum::<Vec3>();
                }
                if straight {
                    pixel.straight += flux * radiance;
                }
            }
        }
    }
}
