//! Figs. 12 and 13: what falls between the vertices, and what error-driven refinement does
//! about it.

use glam::Vec3;
use relight_bake::files::{Access, Files};
use relight_bake::import::plain_material;
use relight_bake::mesh::Mesh;
use relight_bake::scene;
use relight_bake::scene::description::Ground;
use relight_bake::scene::load::SceneInput;
use relight_format::{Camera, FieldOfView, Specular, Surface};
use relight_runtime::Frame;
use relight_shading::spherical_gaussian::SphericalGaussian;

use super::report::{Section, Table};
use super::{Laboratory, camera, percent};
use crate::image_file::Image;
use crate::shapes::{cuboid, over_ground};

/// Longest edges, as parts of the diagonal, and refinement errors, radians.
const BAKES: [(&str, Option<f32>, f32); 3] = [
    ("as it is", Some(f32::INFINITY), f32::INFINITY),
    ("default edges", None, f32::INFINITY),
    ("refined to 0.01 rad", None, 0.01),
];

pub fn run(laboratory: &mut Laboratory, section: &mut Section) -> anyhow::Result<()> {
    section.text = vec![
        "Visibility lives at vertices. A slit between two boards (Fig. 12a) and a small board \
         (12b) over a plane with few vertices, and the walking man's legs (Fig. 13) under two \
         softboxes: on the mesh as it is, with `bake`'s default edges, with edges cut where \
         interpolated visibility is off by more than 0.01 rad, and ray-traced."
            .to_owned(),
    ];
    section.tables.push(Table::new(
        "interpolation",
        "Errors on the mesh as it is and refined",
        &["scene", "mesh", "vertices", "asset, kB", "relative RMSE, %"],
    ));
    let lamp = [SphericalGaussian {
        axis: Vec3::new(0.15, 1.0, 0.1).normalize(),
        sharpness: 400.0,
        amplitude: Vec3::new(6.0, 5.5, 5.0),
    }];
    for (name, boards) in [
        (
            "slit",
            &[
                [Vec3::new(-1.2, 0.5, -0.8), Vec3::new(-0.06, 0.54, 0.8)],
                [Vec3::new(0.06, 0.5, -0.8), Vec3::new(1.2, 0.54, 0.8)],
            ][..],
        ),
        (
            "board",
            &[[Vec3::new(-0.1, 0.5, -0.1), Vec3::new(0.1, 0.54, 0.1)]],
        ),
    ] {
        let make = || over_plane(name, boards);
        compare_bakes(laboratory, section, name, &make, None, &lamp)?;
    }
    let light = laboratory.light("studio", 16)?;
    let legs = Camera {
        position: [0.55, 0.7, 1.35],
        target: [-0.05, 0.12, 0.05],
        up: [0.0, 1.0, 0.0],
        field_of_view: FieldOfView::Y(32f32.to_radians()),
    };
    let data = &laboratory.settings.data;
    let path = super::scene_file("walk_1", &laboratory.settings.folder, data)?;
    let make = || {
        Ok(scene::load::load_from(
            &Files::new(&path, &Access::anywhere())?,
            &path,
        )?)
    };
    compare_bakes(laboratory, section, "legs", &make, Some(legs), &light.lobes)
}

fn compare_bakes(
    laboratory: &mut Laboratory,
    section: &mut Section,
    name: &str,
    make: &dyn Fn() -> anyhow::Result<SceneInput>,
    view: Option<Camera>,
    lights: &[SphericalGaussian],
) -> anyhow::Result<()> {
    let mut images = Vec::new();
    let mut truth = None;
    for (label, max_edge, refine_error) in BAKES {
        let standard = &laboratory.settings.bake;
        let options = scene::Options {
            max_edge: max_edge.unwrap_or(standard.max_edge),
            refine_error,
            ..standard.clone()
        };
        let mut input = make()?;
        input.name = format!("{name}-{}", images.len());
        let scene = laboratory.bake(input, &options)?;
        let frame = Frame::new(view.map_or_else(|| camera(&scene), Ok)?, lights);
        let truth = match &truth {
            Some(truth) => truth,
            None => truth.insert(laboratory.truth(&scene, &frame)?),
        };
        let image = laboratory.draw(&scene, &frame)?;
        let bytes = relight_format::write_scene(&scene)?.len();
        section.tables[0].row([
            name.into(),
            label.into(),
            scene.vertices.len().into(),
            (bytes as f64 / 1e3).into(),
            percent(&image, truth)?,
        ]);
        images.push(image);
    }
    let mut shown: Vec<&Image> = images.iter().collect();
    shown.extend(&truth);
    let caption = format!("{name}: as it is, default edges, refined, truth");
    laboratory.strip(section, name, &caption, &shown)
}

fn over_plane(name: &str, boards: &[[Vec3; 2]]) -> anyhow::Result<SceneInput> {
    let grey = |albedo| Surface::DiffuseSpecular {
        diffuse: [albedo; 3],
        specular: Specular::None,
    };
    let mut mesh = Mesh {
        materials: vec![plain_material("board", grey(0.6))],
        ..Mesh::default()
    };
    for &[low, high] in boards {
        cuboid(&mut mesh, 0, low, high);
    }
    let ground = Ground {
        size: Some(3.0),
        height: Some(0.0),
        center: Some([0.0; 2]),
        spacing: Some(0.3),
        material: None,
    };
    let camera = Camera {
        position: [1.1, 2.3, 2.4],
        target: [0.0, 0.0, 0.1],
        up: [0.0, 1.0, 0.0],
        field_of_view: FieldOfView::Y(0.6),
    };
    Ok(SceneInput {
        // Longest edges are parts of the plane, not of a small board.
        object_diagonal: 3.0,
        ..over_ground(name, mesh, &ground, grey(0.5), camera)?
    })
}
