//! What benches share: meshes, the points that are sampled, the command line.

#![allow(dead_code, reason = "every bench uses another part")]

use std::path::{Path, PathBuf};
use std::time::Instant;

use glam::Vec3;
use relight_bake::import;
use relight_bake::internals::compress::Normal;
use relight_bake::internals::visibility;
use relight_bake::internals::visibility::RUNS;
use relight_bake::internals::visibility::RayCaster;
use relight_bake::internals::visibility::{EXPOSURE_RESOLUTION, Places};

/// Meshes that are measured unless others are named, below the data folder.
const MESHES: [&str; 5] = [
    "figures/spot.obj",
    "figures/cesium_man_walk/walk_1.obj",
    "stanford/bunny.obj",
    "stanford/armadillo.obj",
    "stanford/dragon_100k.obj",
];

/// A mesh as the bake samples it.
pub struct Subject {
    /// The file's name without its extension.
    pub name: String,
    /// Corners of every triangle.
    pub soup: Vec<[Vec3; 3]>,
    /// Points that visibility is sampled from.
    pub origins: Vec<Vec3>,
    /// Shading normals there.
    pub normals: Vec<Normal>,
}

/// `--name value` of the command line.
pub fn option(name: &str) -> Option<String> {
    let mut arguments = std::env::args().skip_while(|argument| argument != name);
    arguments.nth(1)
}

/// `--name N` of the command line.
pub fn number(name: &str, default: usize) -> usize {
    option(name).map_or(default, |value| value.parse().expect("a number"))
}

/// Seconds of the fastest round.
pub fn best(rounds: usize, mut work: impl FnMut()) -> f64 {
    let round = |_| {
        let start = Instant::now();
        work();
        start.elapsed().as_secs_f64()
    };
    (0..rounds).map(round).fold(f64::INFINITY, f64::min)
}

/// Whether `--name` is on the command line.
pub fn flag(name: &str) -> bool {
    std::env::args().any(|argument| argument == name)
}

/// Mesh files named on the command line, else those of the data folder if `cargo bench`
/// runs us, else none: a test run of all targets is over at once.
pub fn paths() -> Vec<PathBuf> {
    let mut paths = Vec::new();
    let mut arguments = std::env::args().skip(1);
    while let Some(argument) = arguments.next() {
        if !argument.starts_with("--") {
            paths.push(argument.into());
        } else if !["--bench", "--json", "--robust", "--test"].contains(&argument.as_str()) {
            // Every other option has a value.
            arguments.next();
        }
    }
    if paths.is_empty() && flag("--bench") {
        paths = MESHES
            .map(|mesh| data_folder().join("meshes").join(mesh))
            .into();
    }
    paths
}

/// `RELIGHT_DATA`, else `../shared/data` beside the checkout.
pub fn data_folder() -> PathBuf {
    std::env::var_os("RELIGHT_DATA").map_or_else(
        || Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data"),
        PathBuf::from,
    )
}

/// The name of a mesh that is made: a town of boxes that pass through one another and the ground, among loose triangles.
const CITY: &str = "city";
const BOXES: usize = 500;
const LOOSE_TRIANGLES: usize = 10_000;

/// [`CITY`] as OBJ.
fn city() -> String {
    let mut state = 1u64;
    let mut random = move || {
        state = state
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (state >> 40) as f32 / (1u64 << 24) as f32
    };
    let mut text = "v -60 0 -60\nv -60 0 60\nv 60 0 60\nv 60 0 -60\nf 1 2 3 4\n".to_owned();
    let mut vertices = 4;
    for _ in 0..BOXES {
        let middle = [100.0 * random() - 50.0, 100.0 * random() - 50.0];
        let half = [1.0 + 3.0 * random(), 1.0 + 3.0 * random()];
        let height = 2.0 + 14.0 * random() * random();
        for i in 0..8 {
            let sign = |bit: usize| if i >> bit & 1 == 1 { 1.0 } else { -1.0 };
            let [x, z] = [0, 1].map(|axis| middle[axis] + sign(2 * axis) * half[axis]);
            let y = if i >> 1 & 1 == 1 { height } else { -0.5 };
            text += &format!("v {x} {y} {z}\n");
        }
        for face in [
            [0, 2, 3, 1],
            [4, 5, 7, 6],
            [0, 1, 5, 4],
            [2, 6, 7, 3],
            [0, 4, 6, 2],
            [1, 3, 7, 5],
        ] {
            let [a, b, c, d] = face.map(|corner| vertices + 1 + corner);
            text += &format!("f {a} {b} {c} {d}\n");
        }
        vertices += 8;
    }
    for _ in 0..LOOSE_TRIANGLES {
        let middle = [
            100.0 * random() - 50.0,
            12.0 * random(),
            100.0 * random() - 50.0,
        ];
        for _ in 0..3 {
            let [x, y, z] = middle.map(|x| x + 0.8 * random());
            text += &format!("v {x} {y} {z}\n");
        }
        let first = vertices + 1;
        text += &format!("f {first} {} {}\n", first + 1, first + 2);
        vertices += 3;
    }
    text
}

/// Loads a mesh, or makes [`CITY`], and picks about `count` of its places: groups as the bake makes them, at
/// equal steps.
pub fn subject(path: &Path, count: usize) -> Subject {
    let load = |path: &Path| import::mesh(path).unwrap_or_else(|error| panic!("{error}"));
    let mesh = if path == Path::new(CITY) {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let made = folder.path().join("city.obj");
        std::fs::write(&made, city()).expect("a writable folder");
        load(&made)
    } else {
        load(path)
    };
    let (low, high) = mesh.bounds().expect("imported meshes have vertices");
    let (soup, triangles) = (mesh.soup(), mesh.indices());
    let caster = RayCaster::new(&soup);
    let offset = 1e-4 * low.distance(high);
    let positions = mesh.positions();
    let Places {
        origins, corners, ..
    } = Places::new(&positions, &triangles, &caster, offset, EXPOSURE_RESOLUTION);
    let mut vertices = vec![0; origins.len()];
    for (triangle, corners) in triangles.iter().zip(&corners) {
        for (vertex, place) in triangle.iter().zip(corners) {
            vertices[*place as usize] = *vertex;
        }
    }
    let mut order: Vec<u32> = (0..origins.len() as u32).collect();
    visibility::arrange(&mut order, &RUNS, &|&place| {
        (origins[place as usize].to_array(), place)
    });
    let step = (origins.len() / count).max(1);
    let picked: Vec<u32> = (order.chunks(RUNS[0]).step_by(step).flatten())
        .copied()
        .collect();
    let vertex = |place: u32| &mesh.vertices[vertices[place as usize] as usize];
    let normal = |&place: &u32| Normal {
        direction: vertex(place).normal.normalize_or_zero(),
        tilt: 0.0,
    };
    Subject {
        name: path.file_stem().unwrap_or_default().display().to_string(),
        soup,
        origins: (picked.iter()).map(|&v| origins[v as usize]).collect(),
        normals: picked.iter().map(normal).collect(),
    }
}
