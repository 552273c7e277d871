//! Fig. 8: a sphere over a glossy plane, three lights of different colour side by side, turned.

use glam::{Quat, Vec3};
use palette::{IntoColor as _, Lab, LinSrgb};
use relight_bake::import::plain_material;
use relight_bake::mesh::Mesh;
use relight_bake::scene;
use relight_bake::scene::description::Ground;
use relight_bake::scene::load::SceneInput;
use relight_format::{Camera, FieldOfView, Specular, Surface};
use relight_runtime::{Frame, twin};
use relight_shading::shade::Lighting;
use relight_shading::spherical_gaussian::SphericalGaussian;
use relight_shading::ssdf::{SignedDistance, Ssdf};
use relight_shading::surface::SurfacePoint;
use relight_shading::tile::point_radiance;

use super::report::{Section, Table};
use super::{Laboratory, METHODS, camera, percent};
use crate::image_file::Image;
use crate::shapes::{over_ground, sphere};

/// Part of the unblocked luminance that arrives in a penumbra.
const PENUMBRA: std::ops::Range<f64> = 0.1..0.9;
const ANGLES: [f32; 3] = [-40.0, 0.0, 40.0];

pub fn run(laboratory: &mut Laboratory, section: &mut Section) -> anyhow::Result<()> {
    let scene = laboratory.bake(
        sphere_over_plane()?,
        &scene::Options {
            max_edge: 0.05,
            ..laboratory.settings.bake.clone()
        },
    )?;
    let lights = lights();
    section.text = vec![
        "A green, a yellow and a red light side by side turn about a sphere over a glossy plane \
         (exponent 200). The penumbra is where 10 to 90 % of the unblocked luminance arrives. \
         Its error of hue is the mean |ΔH*ab| of CIE 1976 L*a*b* against truth, where white is \
         the brightest unblocked luminance; the rest of the table is relative RMSE."
            .to_owned(),
    ];
    let mut table = Table::new(
        "penumbra",
        "Errors in the penumbra and over the picture",
        &[
            "angle, °",
            "method",
            "penumbra, pixels",
            "hue, ΔH*ab",
            "penumbra RMSE, %",
            "picture RMSE, %",
        ],
    );
    for angle in ANGLES {
        let frame = Frame {
            rotation: Quat::from_rotation_y(angle.to_radians()),
            ..Frame::new(camera(&scene)?, &lights)
        };
        let truth = laboratory.truth(&scene, &frame)?;
        let unblocked = unblocked(&scene, &frame, laboratory.settings.size)?;
        let penumbra = Penumbra::new(&truth, &unblocked);
        let mut images = Vec::new();
        for (name, method) in METHODS {
            let frame = Frame {
                method,
                ..frame.clone()
            };
            let image = laboratory.draw(&scene, &frame)?;
            let (hue, rmse) = penumbra.errors(&image, &truth);
            table.row([
                f64::from(angle).into(),
                name.into(),
                penumbra.pixels.len().into(),
                hue.into(),
                (100.0 * rmse).into(),
                percent(&image, &truth)?,
            ]);
            images.push(image);
        }
        let mut shown: Vec<&Image> = images.iter().collect();
        shown.push(&truth);
        laboratory.strip(
            section,
            &format!("penumbra{angle:+}"),
            &format!("{angle}°: ambient, cells, polar, truth"),
            &shown,
        )?;
    }
    section.tables.push(table);
    Ok(())
}

/// The pixels of a penumbra and the luminance that counts as white.
struct Penumbra {
    pixels: Vec<usize>,
    white: f64,
}

impl Penumbra {
    fn new(truth: &Image, unblocked: &Image) -> Self {
        let luminance = |image: &Image, index: usize| {
            let [r, g, b, _] = image.pixels[index].map(f64::from);
            0.2126 * r + 0.7152 * g + 0.0722 * b
        };
        let pixels = (0..truth.pixels.len()).filter(|&index| {
            let share = luminance(truth, index) / luminance(unblocked, index);
            truth.pixels[index][3] > 0.5 && PENUMBRA.contains(&share)
        });
        let all = (0..unblocked.pixels.len()).map(|index| luminance(unblocked, index));
        Self {
            pixels: pixels.collect(),
            white: all.fold(f64::MIN_POSITIVE, f64::max),
        }
    }

    /// Mean |ΔH*ab| and relative RMSE.
    fn errors(&self, image: &Image, truth: &Image) -> (f64, f64) {
        let (mut hue, mut square, mut sum) = (0.0, 0.0, 0.0);
        for &index in &self.pixels {
            let [a, b] = [image, truth].map(|image| image.pixels[index].map(f64::from));
            for channel in 0..3 {
                square += (a[channel] - b[channel]).powi(2);
                sum += b[channel];
            }
            let [a, b] = [a, b].map(|color| self.lab(color));
            let chroma = |c: &Lab<palette::white_point::D65, f64>| c.a.hypot(c.b);
            // ΔH² = Δa² + Δb² − ΔC².
            let rest = (a.a - b.a).powi(2) + (a.b - b.b).powi(2);
            hue += (rest - (chroma(&a) - chroma(&b)).powi(2)).max(0.0).sqrt();
        }
        let count = self.pixels.len().max(1) as f64;
        let rmse = (square / (3.0 * count)).sqrt() / (sum / (3.0 * count));
        (hue / count, rmse)
    }

    fn lab(&self, [r, g, b, _]: [f64; 4]) -> Lab<palette::white_point::D65, f64> {
        let scale = |value: f64| (value / self.white).max(0.0);
        LinSrgb::new(scale(r), scale(g), scale(b)).into_color()
    }
}

/// What would be drawn if nothing were blocked.
fn unblocked(
    scene: &relight_format::Scene,
    frame: &Frame,
    [width, height]: [u32; 2],
) -> anyhow::Result<Image> {
    struct Open;
    impl SignedDistance for Open {
        fn distance(&self, _: Vec3) -> f32 {
            std::f32::consts::PI
        }
    }
    let shade = |point: &SurfacePoint, lighting: &Lighting, _: &Ssdf| {
        let radiance = point_radiance(point, lighting, &Open, &frame.method);
        radiance.extend(1.0).to_array()
    };
    Ok(Image {
        width,
        height,
        pixels: twin::map_pixels(scene, frame, [width, height], shade)?,
        variance: None,
    })
}

fn lights() -> Vec<SphericalGaussian> {
    let light = |azimuth: f32, sharpness, amplitude| {
        let (sine, cosine) = azimuth.to_radians().sin_cos();
        SphericalGaussian {
            axis: Vec3::new(sine, 0.9, -cosine).normalize(),
            sharpness,
            amplitude,
        }
    };
    vec![
        light(-9.0, 150.0, Vec3::new(0.5, 6.0, 0.5)),
        light(0.0, 150.0, Vec3::new(5.0, 4.0, 0.3)),
        light(9.0, 150.0, Vec3::new(6.0, 0.5, 0.4)),
        light(180.0, 1.0, Vec3::new(0.05, 0.05, 0.06)),
    ]
}

fn sphere_over_plane() -> anyhow::Result<SceneInput> {
    let glossy = |diffuse, specular| Surface::DiffuseSpecular {
        diffuse: [diffuse; 3],
        specular: Specular::BlinnPhong {
            specular: [specular; 3],
            exponent: 200.0,
        },
    };
    let mut mesh = Mesh {
        materials: vec![plain_material("sphere", glossy(0.5, 0.1))],
        ..Mesh::default()
    };
    sphere(&mut mesh, 0, Vec3::new(0.0, 0.75, 0.0), 0.5, 48);
    let ground = Ground {
        size: Some(5.0),
        height: Some(0.0),
        center: Some([0.0, 0.6]),
        spacing: Some(0.05),
        material: None,
    };
    let camera = Camera {
        position: [0.0, 2.6, 3.6],
        target: [0.0, 0.3, 0.5],
        up: [0.0, 1.0, 0.0],
        field_of_view: FieldOfView::Y(0.7),
    };
    over_ground("sphere", mesh, &ground, glossy(0.4, 0.25), camera)
}
