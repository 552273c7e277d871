use super::*;

fn parse(text: &str) -> Result<SceneFile, Error> {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("scene.toml");
    std::fs::write(&path, text).expect("a writable folder");
    load(&path)
}

#[test]
fn the_documented_example_is_valid_and_shows_every_model() {
    let document = include_str!("../../../SCENE.md");
    let (_, rest) = document.split_once("```toml\n").expect("an example");
    let (example, _) = rest.split_once("```").expect("its end");
    let scene = parse(example).expect("a valid example");
    let mut shown: Vec<_> = (scene.materials.values())
        .map(|material| match material {
            MaterialOverride::Diffuse { .. } => "diffuse",
            MaterialOverride::Reflecting(reflecting) => reflecting.model.key,
            MaterialOverride::MetallicRoughness { .. } => "metallic-roughness",
            MaterialOverride::Measured { .. } => "measured",
            MaterialOverride::Layers { .. } => "layers",
        })
        .collect();
    shown.sort_unstable();
    shown.dedup();
    let models = 4 + format::REFLECTION_MODELS.len();
    assert_eq!(shown.len(), models, "{shown:?}");
    assert!(scene.environment.is_some() && scene.refinement.is_some());
    let camera = scene
        .camera
        .expect("a camera")
        .to_format()
        .expect("one field of view");
    assert_eq!(
        camera.field_of_view,
        format::FieldOfView::X(28f32.to_radians())
    );
}

#[test]
fn a_mesh_is_enough() {
    let scene = parse("mesh = 'a.obj'").expect("a valid file");
    assert_eq!(scene.mesh, Path::new("a.obj"));
    assert_eq!(scene.transform, Transform::default());
    assert_eq!(
        (scene.ground, scene.camera, scene.refinement),
        (None, None, None)
    );
}

#[test]
fn every_model_of_the_format_is_written_and_read_again() {
    for model in format::REFLECTION_MODELS {
        let roughness = [0.3, if model.anisotropic { 0.2 } else { 0.3 }];
        let specular = model.reflection(format::ModelParameters {
            color: [0.1, 0.2, 0.3],
            roughness: roughness.map(|alpha| model.roughness.from_alpha(alpha)),
        });
        let material = MaterialOverride::over_base([0.5; 3], &specular);
        let text = toml::to_string(&material).expect("a table");
        assert!(
            text.contains(&format!("model = \"{}\"", model.key)),
            "{text}"
        );
        for name in [model.color(), model.roughness_name] {
            assert!(text.contains(&format!("\n{name}")), "{name}: {text}");
        }
        let scene = parse(&format!("mesh = 'a'\n[materials.m]\n{text}")).expect(&text);
        let found = scene.materials["m"].reflection().expect("a model");
        assert_eq!(found, (Color::Rgb([0.5; 3]), specular));
    }
}

#[test]
#[allow(clippy::too_many_lines, reason = "a table of cases")]
fn what_is_wrong_is_named() {
    let cases = [
        ("", "mesh"),
        ("mesh = 1", "line 1, column 8: expected path string"),
        ("mesh = 'a'\nmehs = 'b'", "mehs"),
        ("mesh = 'a'\n[transform]\nsize = 1", "size"),
        ("mesh = 'a'\n[transform]\nscale = 0", "transform.scale"),
        ("mesh = 'a'\n[cutout]\nleaf = 1.5", "cutout.leaf"),
        ("mesh = 'a'\n[cutout]\nleaf = nan", "cutout.leaf"),
        ("mesh = 'a'\ncrease_degrees = -1", "crease_degrees"),
        (
            "mesh = 'a'\n[transform]\nrotation_axis = [0, 0, 0]",
            "rotation_axis",
        ),
        ("mesh = 'a'\n[ground]\nwidth = 1", "width"),
        (
            "mesh = 'a'\n[[lights]]\nposition = [0, 1, 0]\nradius = 0\nradiance = 1",
            "lights[0].radius",
        ),
        (
            "mesh = 'a'\n[[lights]]\nposition = [0, 1, 0]\nradius = 1\nradiance = -1",
            "lights[0].radiance",
        ),
        (
            "mesh = 'a'\n[[lights]]\nposition = [0, 1, 0]\nradius = 1\nradiance = 1\ninner_degrees = 5",
            "lights[0]",
        ),
        (
            "mesh = 'a'\n[[lights]]\nposition = [0, 1, 0]\nradius = 1\nradiance = 1\n\
             direction = [0, -1, 0]\ninner_degrees = 5\nouter_degrees = 5",
            "lights[0].outer_degrees",
        ),
        ("mesh = 'a'\n[ground]\nspacing = -1", "ground.spacing"),
        (
            "mesh = 'a'\n[ground]\nmaterial = { model = 'diffuse', diffuse = 2 }",
            "ground.mat",
        ),
        (
            "mesh = 'a'\n[refinement]\nmax_edge = inf",
            "refinement.max_edge",
        ),
        ("mesh = 'a'\n[refinement]\nerror = 0", "refinement.error"),
        (
            "mesh = 'a'\n[camera]\nposition = [0, 0, 1]\ntarget = [0, 0, 0]",
            "fov_x_degrees",
        ),
        (
            "mesh = 'a'\n[camera]\nposition = [0, 1, 0]\ntarget = [0, 0, 0]\nfov_x_degrees = 9",
            "camera.up",
        ),
        (
            "mesh = 'a'\n[camera]\nposition = [0, 0, 1]\ntarget = [0, 0, 0]\nfov_x_degrees = 9\n\
             fov_y_degrees = 9",
            "one of fov_x_degrees and fov_y_degrees",
        ),
        (
            "mesh = 'a'\n[camera]\nposition = [0, 0, 1]\ntarget = [0, 0, 0]\n\
             fov_x_degrees = 180",
            "field of view",
        ),
        ("mesh = 'a'\n[materials.m]\nmodel = 'plastic'", "plastic"),
        ("mesh = 'a'\n[materials.m]\ndiffuse = 0.5", "model"),
        (
            "mesh = 'a'\n[materials.m]\nmodel = 'diffuse'\ndiffuse = 0.5\nf0 = 1",
            "f0",
        ),
        (
            "mesh = 'a'\n[materials.m]\nmodel = 'diffuse'\ndiffuse = [1, 2]",
            "three numbers",
        ),
        (
            "mesh = 'a'\n[materials.m]\nmodel = 'ggx'\nf0 = 1",
            "materials.m",
        ),
        (
            "mesh = 'a'\n[materials.m]\nmodel = 'ggx'\nf0 = 1\nalpha = 0.1\nalpha_x = 0.1",
            "alpha",
        ),
        (
            "mesh = 'a'\n[materials.m]\nmodel = 'ggx'\nf0 = 1\nalpha = 0",
            "roughness in (0, 1]",
        ),
        (
            "mesh = 'a'\n[materials.m]\nmodel = 'layers'\nlayers = []",
            "1 to 4 layers",
        ),
        (
            "mesh = 'a'\n[materials.m]\nmodel = 'layers'\n[[materials.m.layers]]\nweight = 2\n\
             material = { model = 'diffuse', diffuse = 1 }",
            "layers[0].weight",
        ),
        (
            "mesh = 'a'\n[materials.m]\nmodel = 'layers'\n[[materials.m.layers]]\n\
             material = { model = 'metallic-roughness', base_color = 1 }",
            "layers[0].material",
        ),
        (
            "mesh = 'a'\n[materials.m]\nmodel = 'layers'\n[[materials.m.layers]]\n\
             material = { model = 'diffuse', diffuse = 1 }\nroughness_texture = 'a'\n\
             glossiness_texture = 'b'",
            "glossiness_texture",
        ),
        (
            "mesh = 'a'\n[materials.m]\nmodel = 'ashikhmin-shirley'\nf0 = 1\nexponent = 1",
            "exponent",
        ),
        (
            "mesh = 'a'\n[materials.m]\nmodel = 'blinn-phong'\nspecular = 1\nexponent = 0.5",
            "materials.m.exponent",
        ),
    ];
    for (text, expected) in cases {
        let message = parse(text).expect_err(text).to_string();
        assert!(message.contains(expected), "{text}: {message}");
        assert!(message.contains("scene.toml"), "{message}");
    }
}
