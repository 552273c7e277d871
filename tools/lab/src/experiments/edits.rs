//! Figs. 10 and 11: materials, bumps and local lights that change from frame to frame on one
//! baked scene.

use std::path::Path;

use glam::{Vec2, Vec3};
use relight_bake::import::plain_material;
use relight_format::{Scene, Specular, Surface, Texture, TextureEncoding, TextureSlot, write_file};
use relight_runtime::{Frame, LocalLight};

use super::report::{Section, Table};
use super::{Laboratory, camera, percent};
use crate::image_file::Image;

/// Width and height of generated textures, texels.
const TEXELS: u32 = 256;

/// A scene as one frame of a strip has it.
struct Step {
    label: String,
    scene: Scene,
    lamps: Vec<LocalLight>,
}

#[allow(
    clippy::too_many_lines,
    reason = "a list of edits, each with its strip of pictures"
)]
pub fn run(laboratory: &mut Laboratory, section: &mut Section) -> anyhow::Result<()> {
    section.text = vec![
        "Each strip is one asset, baked once; what changes is uploaded with the frame. Upper \
         row: polar. Lower row: truth with the same lobes."
            .to_owned(),
    ];
    section.tables.push(Table::new(
        "edits",
        "Relative RMSE of every frame",
        &["strip", "frame", "polar, %"],
    ));
    let spot = laboratory.scene("spot")?;
    let walker = laboratory.scene("walk_1")?;
    let duck = laboratory.scene("duck")?;

    let ward = |scene: &Scene, alpha: [f32; 2]| {
        let surface = |diffuse, specular| Surface::DiffuseSpecular {
            diffuse: [diffuse; 3],
            specular: Specular::Ward {
                specular: [specular; 3],
                alpha,
            },
        };
        put_on(scene, &surface(0.3, 0.3), &surface(0.2, 0.4))
    };
    let steps = [0.05, 0.1, 0.2, 0.4].map(|alpha| Step::new(&alpha, ward(&spot, [alpha; 2])));
    strip(
        laboratory,
        section,
        "ward",
        "Ward's α: 0.05, 0.1, 0.2, 0.4",
        "grace",
        &steps,
    )?;

    let steps = [[40.0, 40.0], [15.0, 110.0], [6.0, 270.0], [2.0, 800.0]].map(|exponents| {
        let surface = |diffuse: [f32; 3], f0| Surface::DiffuseSpecular {
            diffuse,
            specular: Specular::AshikhminShirley {
                f0: [f0; 3],
                exponents,
            },
        };
        let scene = put_on(
            &walker,
            &surface([0.1, 0.12, 0.15], 0.7),
            &surface([0.3; 3], 0.1),
        );
        Step::new(&format!("{}, {}", exponents[0], exponents[1]), scene)
    });
    strip(
        laboratory,
        section,
        "ashikhmin-shirley",
        "Ashikhmin-Shirley's exponents along tangent and bitangent, from isotropic to \
         anisotropic: 40, 40; 15, 110; 6, 270; 2, 800",
        "grace",
        &steps,
    )?;

    let steps = [0.0, 0.5, 1.0, 2.0].map(|scale| Step::new(&scale, dimpled(&duck, scale)));
    strip(
        laboratory,
        section,
        "bumps",
        "Scale of a normal map: 0, 0.5, 1, 2",
        "stpeters",
        &steps,
    )?;

    let plain = put_on(
        &duck,
        &Surface::DiffuseSpecular {
            diffuse: [0.5, 0.4, 0.1],
            specular: Specular::Ggx {
                f0: [0.04; 3],
                alpha: [0.2; 2],
            },
        },
        &Surface::DiffuseSpecular {
            diffuse: [0.4; 3],
            specular: Specular::None,
        },
    );
    let steps = [-1.6f32, -0.5, 0.6, 1.6].map(|x| {
        let lamp = |z, radiance| LocalLight {
            position: Vec3::new(x, 2.6, z),
            radius: 0.12,
            radiance,
            spot: None,
        };
        Step {
            label: format!("x = {x}"),
            scene: plain.clone(),
            lamps: vec![
                lamp(1.6, Vec3::new(60.0, 40.0, 20.0)),
                lamp(-0.8, Vec3::new(15.0, 25.0, 70.0)),
            ],
        }
    });
    strip(
        laboratory,
        section,
        "lamps",
        "Two lamps that move, without an environment: x = -1.6, -0.5, 0.6, 1.6",
        "",
        &steps,
    )
}

impl Step {
    fn new(label: &impl ToString, scene: Scene) -> Self {
        Self {
            label: label.to_string(),
            scene,
            lamps: Vec::new(),
        }
    }
}

/// Draws every step, and truth below it.
fn strip(
    laboratory: &mut Laboratory,
    section: &mut Section,
    name: &str,
    caption: &str,
    environment: &str,
    steps: &[Step],
) -> anyhow::Result<()> {
    let light = match environment {
        "" => None,
        name => Some(laboratory.light(name, 16)?),
    };
    let lobes = light.as_ref().map_or(&[][..], |light| &light.lobes);
    let (mut images, mut truths) = (Vec::new(), Vec::new());
    for step in steps {
        let frame = Frame {
            local_lights: &step.lamps,
            ..Frame::new(camera(&step.scene)?, lobes)
        };
        let image = laboratory.draw(&step.scene, &frame)?;
        let truth = laboratory.truth(&step.scene, &frame)?;
        section.tables[0].row([
            name.into(),
            step.label.as_str().into(),
            percent(&image, &truth)?,
        ]);
        images.push(image);
        truths.push(truth);
    }
    let shown = |images: &[Image]| images.iter().map(half).collect::<Vec<_>>();
    let (images, truths) = (shown(&images), shown(&truths));
    let exposure = crate::display::automatic_exposure(&truths[0]);
    let row = |images: &[Image]| {
        crate::display::side_by_side(&images.iter().collect::<Vec<_>>(), exposure)
    };
    let ((width, mut pixels), (_, below)) = (row(&images), row(&truths));
    pixels.extend(below);
    laboratory.picture(section, name, caption, width, &pixels)
}

/// An image of half the width and height, of every four pixels' mean.
fn half(image: &Image) -> Image {
    let (width, height) = (image.width / 2, image.height / 2);
    let at = |x: u32, y: u32| image.pixels[(y * image.width + x) as usize];
    let pixels = (0..width * height).map(|index| {
        let (x, y) = (2 * (index % width), 2 * (index / width));
        let four = [at(x, y), at(x + 1, y), at(x, y + 1), at(x + 1, y + 1)];
        [0, 1, 2, 3].map(|channel| 0.25 * four.iter().map(|pixel| pixel[channel]).sum::<f32>())
    });
    Image {
        width,
        height,
        pixels: pixels.collect(),
        variance: None,
    }
}

/// The scene with one surface on everything but its ground.
fn put_on(scene: &Scene, object: &Surface, ground: &Surface) -> Scene {
    let mut scene = scene.clone();
    for material in &mut scene.materials {
        let surface = if material.name == "ground" {
            ground
        } else {
            object
        };
        *material = plain_material(&material.name, surface.clone());
    }
    scene
}

/// The scene in glossy plastic.
pub fn glossy(scene: &Scene) -> Scene {
    let surface = |diffuse, f0| Surface::DiffuseSpecular {
        diffuse,
        specular: Specular::Ggx {
            f0: [f0; 3],
            alpha: [0.2; 2],
        },
    };
    put_on(
        scene,
        &surface([0.5, 0.35, 0.05], 0.04),
        &surface([0.4; 3], 0.06),
    )
}

/// The same with dimples on everything but its ground.
fn dimpled(scene: &Scene, scale: f32) -> Scene {
    let mut scene = glossy(scene);
    scene.textures = vec![Texture {
        width: TEXELS,
        height: TEXELS,
        encoding: TextureEncoding::Linear,
        texels: texels(|at| {
            // Round dimples on a grid of eight by eight.
            let place = (8.0 * at).fract() - 0.5;
            let inside = (1.0 - 5.0 * place.length_squared()).max(0.0);
            let normal = (2.5 * inside * place).extend(1.0).normalize();
            (0.5 * normal + 0.5).to_array()
        }),
    }];
    for material in &mut scene.materials {
        if material.name != "ground" {
            material.normal_scale = scale;
            material.normal_texture = Some(TextureSlot::whole(0));
        }
    }
    scene
}

/// RGBA of a texture that is a function of texture coordinates.
fn texels(value: impl Fn(Vec2) -> [f32; 3]) -> Vec<u8> {
    (0..TEXELS * TEXELS)
        .flat_map(|index| {
            let at = Vec2::new((index % TEXELS) as f32, (index / TEXELS) as f32) + 0.5;
            let [r, g, b] = value(at / TEXELS as f32).map(|value| (255.0 * value).round() as u8);
            [r, g, b, 255]
        })
        .collect()
}

/// Writes blotches of two sizes: where a stain covers what is below it.
pub fn write_stain(path: &Path) -> anyhow::Result<()> {
    let texels = texels(|at| {
        let wave = |frequency: f32, x: f32, y: f32| {
            let turns = std::f32::consts::TAU * frequency * at;
            (turns.x + x * turns.y.sin()).sin() * (turns.y + y * turns.x.cos()).cos()
        };
        let height = wave(3.0, 0.7, 1.1) + 0.5 * wave(7.0, 0.4, 0.9);
        [(2.0 * height + 0.3).clamp(0.0, 1.0); 3]
    });
    let mut png = Vec::new();
    let encoder = image::codecs::png::PngEncoder::new(&mut png);
    image::ImageEncoder::write_image(
        encoder,
        &texels,
        TEXELS,
        TEXELS,
        image::ExtendedColorType::Rgba8,
    )?;
    write_file(path, &png)?;
    Ok(())
}
