//! A scene file, or a bare mesh, to everything that baking and rendering need.

use relight_format::math;
use std::path::{Path, PathBuf};

use glam::{Quat, Vec3};
use relight_format as format;
use relight_shading::local_light::LocalLight;

use crate::environment::hdr;
use crate::files::{Access, Files};
use crate::import::{self, Error};
use crate::mesh::{self, MAX_COORDINATE, Mesh, ground};
use crate::scene::description::{self, MaterialOverride, SceneFile};
use crate::scene::material::{Keys, Replaced, override_materials};

pub use crate::scene::material::{load_material, parse_table};

/// A scene, ready to bake.
#[derive(Clone, Debug)]
pub struct SceneInput {
    /// The input file's name without its extension.
    pub name: String,
    /// In world space, materials replaced, ground included, not refined.
    pub mesh: Mesh,
    /// Diagonal of the bounding box without the ground, metres.
    pub object_diagonal: f32,
    /// The camera of the scene file, if any.
    pub camera: Option<format::Camera>,
    /// The environment of the scene file, if any, relative to the working directory.
    pub environment: Option<PathBuf>,
    /// Lights of the scene file.
    pub lights: Vec<LocalLight>,
    /// Refinement asked for by the scene file, if any.
    pub refinement: Option<description::Refinement>,
    /// Measured BRDFs: index into the mesh's materials and path of the table, relative to
    /// the working directory. Those materials hold the lobes fitted to it.
    pub measured: Vec<(usize, PathBuf)>,
    /// What was left out or changed on the way, the mesh's warnings among them.
    pub warnings: Vec<String>,
}

/// Loads a `.toml` scene file, or a mesh without one, and what it refers to in its own folder.
pub fn load(path: &Path) -> Result<SceneInput, Error> {
    load_from(&Files::new(path, &Access::default())?, path)
}

/// Loads as [`load`] does, from `files`, which must be of the same path.
pub fn load_from(files: &Files, path: &Path) -> Result<SceneInput, Error> {
    read(files, path, &import::Options::default())?.fit()
}

/// A scene before the stage that fits lobes to its measured BRDFs.
pub struct Unfitted {
    input: SceneInput,
    /// Of the scene file, for messages.
    path: PathBuf,
    replaced: Replaced,
}

impl Unfitted {
    /// Whether there is anything to fit, which takes seconds for each table.
    pub fn has_tables(&self) -> bool {
        self.replaced.has_tables()
    }

    /// The fits. An error if layers have more reflections with them than they may.
    pub fn fit(mut self) -> Result<SceneInput, Error> {
        self.replaced.fit(&self.path, &mut self.input.mesh)?;
        Ok(self.input)
    }
}

/// Reads what [`load_from`] does, and fits nothing; what a scene file says wins over the options.
pub fn read(files: &Files, path: &Path, options: &import::Options) -> Result<Unfitted, Error> {
    let mut replaced = Replaced::default();
    let input = read_into(files, path, options, &mut replaced)?;
    Ok(Unfitted {
        input,
        path: path.to_owned(),
        replaced,
    })
}

fn read_into(
    files: &Files,
    path: &Path,
    options: &import::Options,
    replaced: &mut Replaced,
) -> Result<SceneInput, Error> {
    let is_scene = path
        .extension()
        .is_some_and(|e| e.eq_ignore_ascii_case("toml"));
    let name = path
        .file_stem()
        .unwrap_or_default()
        .to_string_lossy()
        .into_owned();
    if !is_scene {
        import::ending(path).map_err(|found| {
            let expected = format!(".toml, {}", import::ENDINGS);
            Error::invalid(path, "file name", expected, found)
        })?;
        let mesh = import::mesh_of(files, path, options, || files.read_named(path))?;
        return Ok(SceneInput {
            name,
            warnings: mesh.warnings.clone(),
            object_diagonal: mesh.diagonal(),
            mesh,
            camera: None,
            environment: None,
            lights: Vec::new(),
            refinement: None,
            measured: Vec::new(),
        });
    }
    let file = description::parse(path, &files.read_named(path)?)?;
    let folder = path.parent().unwrap_or(Path::new(""));
    let mesh_path = folder.join(&file.mesh);
    import::ending(&mesh_path).map_err(|found| {
        let expected = format!("a name that ends in {}", import::ENDINGS);
        Error::invalid(path, "mesh", expected, found)
    })?;
    let options = import::Options {
        cutoffs: file.cutout.clone(),
        crease_degrees: file.crease_degrees.or(options.crease_degrees),
        ..options.clone()
    };
    let mut mesh = import::mesh_of(files, &mesh_path, &options, || {
        let bytes = files.read(&mesh_path);
        bytes.map_err(|error| error.referred_to(path, "mesh"))
    })?;
    place(&mut mesh, &file.transform);
    let mut positions = mesh.vertices.iter().map(|vertex| vertex.position);
    if let Some(position) = mesh::distant_position(&mut positions) {
        return Err(Error::invalid(
            path,
            "transform",
            format_args!("coordinates within {MAX_COORDINATE} m of the origin"),
            format_args!("{:?}", position.to_array()),
        ));
    }
    override_materials(files, path, &file, &mut mesh, replaced)?;
    let object_diagonal = mesh.diagonal();
    if let Some(options) = &file.ground {
        let material = options.material.as_ref();
        let default = MaterialOverride::Diffuse {
            diffuse: description::Color::Grey(0.5),
        };
        let keys = Keys {
            files,
            path,
            place: "ground.material".into(),
        };
        let material = material.unwrap_or(&default);
        let made = replaced.make(&keys, material, &mut mesh.textures)?;
        replaced.note(mesh.materials.len(), &made, &keys.place);
        ground::append(&mut mesh, &options.extent(), made.material)
            .map_err(|(place, expected, found)| Error::invalid(path, place, expected, found))?;
    }
    emit(path, &file, &mut mesh)?;
    for name in &file.shadow_catchers {
        let named = of_name(path, "shadow_catchers", name, &mut mesh)?;
        named.for_each(|material| material.shadow_catcher = true);
    }
    // The bake does not need it, but what it is shown under should not turn out to be missing
    // when hours have passed.
    let environment = file.environment.map(|environment| folder.join(environment));
    if let Some(environment) = &environment {
        check_environment(files, path, environment)?;
    }
    Ok(SceneInput {
        name,
        warnings: mesh.warnings.clone(),
        object_diagonal,
        mesh,
        camera: file
            .camera
            .as_ref()
            .and_then(description::Camera::to_format),
        environment,
        lights: file
            .lights
            .iter()
            .map(description::Light::to_local_light)
            .collect(),
        refinement: file.refinement,
        measured: replaced.measured.clone(),
    })
}

/// Checks the beginning of a scene's lat-long image.
fn check_environment(files: &Files, scene: &Path, path: &Path) -> Result<(), Error> {
    let reading = hdr::Reading {
        max_pixels: hdr::MAX_PIXELS,
        ..hdr::Reading::default()
    };
    let opened = files.open(path);
    let file = opened.map_err(|error| error.referred_to(scene, "environment"))?;
    hdr::check(path, file, &reading)
}

/// Gives materials the emission that the scene file has for them.
fn emit(path: &Path, file: &SceneFile, mesh: &mut Mesh) -> Result<(), Error> {
    for (name, color) in &file.emission {
        let place = format!("emission.{name}");
        let emission = color.rgb();
        if !emission.iter().all(|x| x.is_finite() && *x >= 0.0) {
            let found = format!("{emission:?}");
            let expected = "finite radiance of at least 0";
            return Err(Error::invalid(path, place, expected, found));
        }
        let named = of_name(path, &place, name, mesh)?;
        named
            .for_each(|material| (material.emission, material.emission_texture) = (emission, None));
    }
    mesh.drop_unused_textures();
    Ok(())
}

/// The materials of a mesh that a scene file names, at least one.
fn of_name<'a>(
    path: &Path,
    place: &str,
    name: &'a str,
    mesh: &'a mut Mesh,
) -> Result<impl Iterator<Item = &'a mut format::Material>, Error> {
    if mesh.materials.iter().all(|material| material.name != name) {
        let names: Vec<_> = (mesh.materials.iter())
            .map(|material| format!("{:?}", material.name))
            .collect();
        let expected = format!("a material of the scene: {}", names.join(", "));
        return Err(Error::invalid(path, place, expected, format!("{name:?}")));
    }
    let named = (mesh.materials.iter_mut()).filter(move |material| material.name == name);
    Ok(named)
}

fn place(mesh: &mut Mesh, transform: &description::Transform) {
    let axis = Vec3::from(transform.rotation_axis).normalize();
    let (sin, cos) = math::sin_cos(0.5 * transform.rotation_degrees.to_radians());
    let rotation = Quat::from_vec4((sin * axis).extend(cos));
    for vertex in &mut mesh.vertices {
        let position = rotation * (vertex.position * transform.scale);
        vertex.position = position + Vec3::from(transform.translation);
        vertex.normal = rotation * vertex.normal;
        vertex.tangent = rotation * vertex.tangent;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Rotation and scale in f32.
    const TOLERANCE: f32 = 1e-5;

    const BOX: &str = "v 0 0 0\nv 2 0 0\nv 2 0 1\nv 0 0 1\nv 0 3 0\nv 2 3 0\nv 2 3 1\nv 0 3 1\n\
                       usemtl lid\nf 5 8 7 6\nusemtl wall\nf 1 5 6 2\nf 2 6 7 3\nf 3 7 8 4\n\
                       f 4 8 5 1\n";

    /// The header of an image of 2 by 1 pixels.
    const SKY: &str = "#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 1 +X 2\n";

    fn load_text(scene: &str) -> Result<SceneInput, Error> {
        let folder = tempfile::tempdir().expect("a temporary folder");
        std::fs::write(folder.path().join("box.obj"), BOX).expect("a writable folder");
        std::fs::write(folder.path().join("box scene.toml"), scene).expect("a writable folder");
        std::fs::write(folder.path().join("sky.hdr"), SKY).expect("a writable folder");
        load(&folder.path().join("box scene.toml"))
    }

    #[test]
    fn materials_that_catch_shadows_are_named() {
        let text = |names| format!("mesh = 'box.obj'\nshadow_catchers = {names}\n[ground]");
        let input = load_text(&text("['ground', 'lid']")).expect("a good scene");
        let catching: Vec<_> = (input.mesh.materials.iter())
            .map(|material| (material.name.as_str(), material.shadow_catcher))
            .collect();
        let expected = [("lid", true), ("wall", false), ("ground", true)];
        assert_eq!(catching, expected);
        let error = load_text(&text("['floor']")).expect_err("no such material");
        let error = error.to_string();
        assert!(
            error.contains("shadow_catchers") && error.contains("\"lid\""),
            "{error}"
        );
    }

    #[test]
    fn ground_appears_under_the_placed_mesh() {
        let input = load_text(
            "mesh = 'box.obj'\nenvironment = 'sky.hdr'\n[transform]\nscale = 2\n\
             rotation_axis = [1, 0, 0]\nrotation_degrees = 90\ntranslation = [0, 5, 0]\n[ground]",
        )
        .expect("a good scene");
        assert_eq!(input.name, "box scene");
        assert!(
            input
                .environment
                .expect("an environment")
                .ends_with("sky.hdr")
        );
        let ground = input.mesh.materials.len() - 1;
        assert_eq!(input.mesh.materials[ground].name, "ground");
        let (mut mesh, mut plane) = (Vec::new(), Vec::new());
        for triangle in &input.mesh.triangles {
            let list = if usize::from(triangle.material) == ground {
                &mut plane
            } else {
                &mut mesh
            };
            list.extend(
                triangle
                    .vertices
                    .map(|index| input.mesh.vertices[index as usize].position),
            );
        }
        let bounds = |points: &[Vec3]| {
            let first = (points[0], points[0]);
            points
                .iter()
                .fold(first, |(low, high), p| (low.min(*p), high.max(*p)))
        };
        // The box of 2 by 3 by 1 is turned so that its y becomes z, and its z becomes -y.
        let (low, high) = bounds(&mesh);
        assert!(low.distance(Vec3::new(0.0, 3.0, 0.0)) < TOLERANCE, "{low}");
        assert!(
            high.distance(Vec3::new(4.0, 5.0, 6.0)) < TOLERANCE,
            "{high}"
        );
        let (plane_low, plane_high) = bounds(&plane);
        assert_eq!((plane_low.y, plane_high.y), (low.y, low.y));
        // Three times the longest extent, 6, about (2, 3).
        assert!(
            plane_low.distance(Vec3::new(-7.0, low.y, -6.0)) < TOLERANCE,
            "{plane_low}"
        );
        assert!(
            plane_high.distance(Vec3::new(11.0, low.y, 12.0)) < TOLERANCE,
            "{plane_high}"
        );
        for corner in plane.as_chunks::<3>().0 {
            assert!((corner[1] - corner[0]).cross(corner[2] - corner[0]).y > 0.0);
        }
    }

    #[test]
    fn materials_are_replaced_by_name_or_by_default() {
        let input = load_text(
            "mesh = 'box.obj'\n[materials.lid]\nmodel = 'ggx'\nf0 = 1\nalpha_x = 0.1\nalpha_y = 0.2\n\
             [materials.default]\nmodel = 'diffuse'\ndiffuse = [0.1, 0.2, 0.3]",
        )
        .expect("a good scene");
        let surfaces: Vec<_> = input
            .mesh
            .materials
            .iter()
            .map(|m| m.surface.clone())
            .collect();
        let ggx = format::Specular::Ggx {
            f0: [1.0; 3],
            alpha: [0.1, 0.2],
        };
        let expected = [([0.0; 3], ggx), ([0.1, 0.2, 0.3], format::Specular::None)]
            .map(|(diffuse, specular)| format::Surface::DiffuseSpecular { diffuse, specular });
        assert_eq!(surfaces, expected);
    }

    #[test]
    fn what_does_not_fit_the_mesh_is_named() {
        let cases = [
            ("mesh = 'none.obj'", "none.obj"),
            ("mesh = 'box.fbx'", ".gltf, .glb or .obj"),
            (
                "mesh = 'box.obj'\n[materials.floor]\nmodel = 'diffuse'\ndiffuse = 1",
                "\"lid\", \"wall\"",
            ),
            (
                "mesh = 'box.obj'\n[materials.lid]\nmodel = 'measured'\nfile = 'x.bsdf'",
                "x.bsdf",
            ),
            (
                "mesh = 'box.obj'\n[ground]\nspacing = 1e-4",
                "ground.spacing",
            ),
            ("mesh = 'box.obj'\n[transform]\nscale = 1e38", "transform"),
        ];
        for (text, expected) in cases {
            let message = load_text(text).expect_err(text).to_string();
            assert!(message.contains(expected), "{text}: {message}");
        }
    }
}
