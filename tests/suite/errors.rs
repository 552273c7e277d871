//! What `bake` and `lab` say of inputs and options that they refuse: one line each, of what it is about,
//! where in it, what was expected and what was found.

use std::path::Path;
use std::process::{Output, Stdio};

use libtest_mimic::Trial;

use crate::command::{BAD_INPUT, INPUT_OUTPUT, USAGE, describe};
use crate::support::{Outcome, binary};

/// A command, run in a folder of the files of [`FILES`], what it exits with and the line that it says.
type Row = (&'static str, i32, &'static str);

/// A file and what is in it.
type Contents = (&'static str, &'static [u8]);

pub fn trials() -> Vec<Trial> {
    vec![
        Trial::test("errors::of_scenes", || check(SCENES)),
        Trial::test("errors::of_what_scene_files_name", || check(REFERENCES)),
        Trial::test("errors::of_environments", || check(ENVIRONMENTS)),
        Trial::test("errors::of_materials", || check(MATERIALS)),
        Trial::test("errors::of_assets", || check(ASSETS)),
        Trial::test("errors::of_outputs", || check(OUTPUTS)),
        Trial::test("errors::of_options", || check(OPTIONS)),
        Trial::test("errors::of_lab", || check(LAB)),
        Trial::test("errors::as_json", as_json),
    ]
}

const FILES: &[Contents] = &[
    ("empty.glb", b""),
    ("empty.gltf", b""),
    ("empty.hdr", b""),
    ("empty.obj", b""),
    ("empty.toml", b""),
    ("empty.bsdf", b""),
    ("empty.relight", b""),
    ("text.txt", TEXT),
    ("text.glb", TEXT),
    ("text.gltf", TEXT),
    ("text.obj", TEXT),
    ("text.toml", TEXT),
    ("text.hdr", TEXT),
    ("text.exr", TEXT),
    ("text.bsdf", TEXT),
    ("text.relight", TEXT),
    ("header.glb", b"glTF"),
    ("version.glb", b"glTF\x01\0\0\0\x0c\0\0\0"),
    ("cut.glb", b"glTF\x02\0\0\0\x40\0\0\0\x30\0\0\0JSON{}"),
    ("chunk.glb", b"glTF\x02\0\0\0\x18\0\0\0\x04\0\0\0BINX{}  "),
    ("type.gltf", b"{\n\"asset\": {\"version\": 2}}"),
    ("end.gltf", b"{\"asset\": {\"version\": \"2.0\"}"),
    ("colon.gltf", b"{\"asset\" 2}"),
    ("asset.gltf", b"{}"),
    (
        "draco.gltf",
        b"{\"asset\":{\"version\":\"2.0\"},\"extensionsRequired\":[\"KHR_draco_mesh_compression\"]}",
    ),
    (
        "buffer.gltf",
        b"{\"asset\":{\"version\":\"2.0\"},\"buffers\":[{\"uri\":\"none.bin\",\"byteLength\":4}]}",
    ),
    ("index.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n"),
    ("good.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"),
    ("key.toml", b"mesh = 'good.obj'\n\nmehs = 3\n"),
    ("syntax.toml", b"mesh = 'good.obj'\n[ground\n"),
    ("type.toml", b"mesh = 3\n"),
    ("bytes.toml", b"mesh = '\xff'\n"),
    ("range.toml", b"mesh = 'good.obj'\n[transform]\nscale = 0\n"),
    ("mesh.toml", b"mesh = 'none.obj'\n"),
    ("folder.toml", b"mesh = 'folder.obj'\n"),
    ("outside.toml", b"mesh = '../good.obj'\n"),
    ("ending.toml", b"mesh = 'text.txt'\n"),
    ("light.toml", b"mesh = 'good.obj'\nenvironment = 'none.hdr'\n"),
    (
        "table.toml",
        b"mesh = 'good.obj'\nmaterials.default = { model = 'measured', file = 'none.bsdf' }\n",
    ),
    (
        "baked.toml",
        b"mesh = 'good.obj'\nmaterials.default = { model = 'measured', file = 'text.relight' }\n",
    ),
    (
        "texture.toml",
        b"mesh = 'good.obj'\n[[materials.default.layers]]\ndiffuse_texture = 'none.png'\n\
          material = { model = 'diffuse', diffuse = 1 }\n[materials.default]\nmodel = 'layers'\n",
    ),
    (
        "picture.toml",
        b"mesh = 'good.obj'\n[[materials.default.layers]]\ndiffuse_texture = 'text.txt'\n\
          material = { model = 'diffuse', diffuse = 1 }\n[materials.default]\nmodel = 'layers'\n",
    ),
    ("material.toml", b"model = 'ggx'\nf0 = 2\nalpha = 0.1\n"),
    ("good.toml", b"model = 'ggx'\nf0 = 1\nalpha = 0.1\n"),
    (
        "cut.hdr",
        b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 1000 +X 2000\nshort",
    ),
    (
        "square.hdr",
        b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 2 +X 2\nshort",
    ),
    (
        "huge.hdr",
        b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 100000 +X 200000\nshort",
    ),
    (
        "good.hdr",
        b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 1 +X 2\n\x80\x80\x80\x80\x80\x80\x80\x80",
    ),
    ("camera.toml", b"position = [0, 0, 1]\ntarget = [0, 0, 0]\n"),
];

const TEXT: &[u8] = b"good morning\neverybody\n";

const SCENES: &[Row] = &[
    (
        "bake scene none.obj -o out.relight",
        INPUT_OUTPUT,
        "none.obj: file: expected a readable file, found No such file or directory (os error 2)",
    ),
    (
        "bake scene none/none.obj -o out.relight",
        INPUT_OUTPUT,
        "none/none.obj: file: expected a readable file, found No such file or directory (os error 2)",
    ),
    (
        "bake scene folder.obj -o out.relight",
        BAD_INPUT,
        "folder.obj: file: expected a regular file, found a folder, pipe, socket or device",
    ),
    (
        "bake scene text.txt -o out.relight",
        BAD_INPUT,
        "text.txt: file name: expected .toml, .gltf, .glb or .obj, found .txt",
    ),
    (
        "bake scene folder -o out.relight",
        BAD_INPUT,
        "folder: file name: expected .toml, .gltf, .glb or .obj, found no extension",
    ),
    (
        "bake scene empty.obj -o out.relight",
        BAD_INPUT,
        "empty.obj: mesh: expected at least one triangle, found no triangle",
    ),
    (
        "bake scene text.obj -o out.relight",
        BAD_INPUT,
        "text.obj: mesh: expected at least one triangle, found no triangle",
    ),
    (
        "bake scene index.obj -o out.relight",
        BAD_INPUT,
        "index.obj: line 4: expected an index into the file's 3 vertices, found 9",
    ),
    (
        "bake scene empty.glb -o out.relight",
        BAD_INPUT,
        r#"empty.glb: first bytes: expected "glTF" of a .glb or "{" of a .gltf, found an empty file"#,
    ),
    (
        "bake scene text.glb -o out.relight",
        BAD_INPUT,
        r#"text.glb: first bytes: expected "glTF" of a .glb or "{" of a .gltf, found "good morning""#,
    ),
    (
        "bake scene text.gltf -o out.relight",
        BAD_INPUT,
        r#"text.gltf: first bytes: expected "glTF" of a .glb or "{" of a .gltf, found "good morning""#,
    ),
    (
        "bake scene header.glb -o out.relight",
        BAD_INPUT,
        "header.glb: GLB header: expected 12 bytes, found 4 bytes",
    ),
    (
        "bake scene version.glb -o out.relight",
        BAD_INPUT,
        "version.glb: GLB header: expected version 2, found version 1",
    ),
    (
        "bake scene cut.glb -o out.relight",
        BAD_INPUT,
        "cut.glb: GLB: expected 64 bytes, as the header has it, found 22 bytes",
    ),
    (
        "bake scene chunk.glb -o out.relight",
        BAD_INPUT,
        "chunk.glb: GLB, byte 12: expected a whole JSON chunk, found 4 bytes of chunk \"BINX\", \
         4 bytes before the end of the file",
    ),
    (
        "bake scene type.gltf -o out.relight",
        BAD_INPUT,
        "type.gltf: line 2, column 22: expected a string, found integer `2`",
    ),
    (
        "bake scene end.gltf -o out.relight",
        BAD_INPUT,
        "end.gltf: line 1, column 28: expected glTF 2.0, found the end of the file",
    ),
    (
        "bake scene colon.gltf -o out.relight",
        BAD_INPUT,
        "colon.gltf: line 1, column 10: expected `:`, found \"2}\"",
    ),
    (
        "bake scene asset.gltf -o out.relight",
        BAD_INPUT,
        "asset.gltf: line 1, column 2: expected glTF 2.0 with `asset`, found none",
    ),
    (
        "bake scene draco.gltf -o out.relight",
        BAD_INPUT,
        "draco.gltf: extensionsRequired: expected extensions that are supported \
         (`gltf-transform copy IN.glb OUT.glb` writes the mesh without compression), \
         found KHR_draco_mesh_compression",
    ),
    (
        "bake scene empty.toml -o out.relight",
        BAD_INPUT,
        "empty.toml: line 1, column 1: expected a scene as in SCENE.md with `mesh`, found none",
    ),
    (
        "bake scene text.toml -o out.relight",
        BAD_INPUT,
        "text.toml: line 1, column 6: expected `=`, found key with no value",
    ),
    (
        "bake scene key.toml -o out.relight",
        BAD_INPUT,
        "key.toml: line 3, column 1: expected one of `mesh`, `environment`, `crease_degrees`, \
         `transform`, `materials`, `emission`, `shadow_catchers`, `cutout`, `ground`, `camera`, \
         `lights`, `refinement`, found unknown field `mehs`",
    ),
    (
        "bake scene syntax.toml -o out.relight",
        BAD_INPUT,
        "syntax.toml: line 2, column 8: expected `]`, found unclosed table",
    ),
    (
        "bake scene type.toml -o out.relight",
        BAD_INPUT,
        "type.toml: line 1, column 8: expected path string, found integer `3`",
    ),
    (
        "bake scene bytes.toml -o out.relight",
        BAD_INPUT,
        "bytes.toml: byte 8: expected text in UTF-8, found other bytes",
    ),
    (
        "bake scene range.toml -o out.relight",
        BAD_INPUT,
        "range.toml: transform.scale: expected a number above 0, found 0.0",
    ),
    (
        "bake scene good.obj -o out.relight --limit-bytes 3",
        BAD_INPUT,
        "good.obj: file: expected at most 3 bytes of input in all (--limit-bytes), \
         found 32 bytes after 0 of other files",
    ),
];

const REFERENCES: &[Row] = &[
    (
        "bake scene mesh.toml -o out.relight",
        INPUT_OUTPUT,
        "mesh.toml: mesh: expected a readable file, found none.obj: \
         No such file or directory (os error 2)",
    ),
    (
        "bake scene folder.toml -o out.relight",
        BAD_INPUT,
        "folder.toml: mesh: expected a regular file, \
         found folder.obj: a folder, pipe, socket or device",
    ),
    (
        "bake scene ending.toml -o out.relight",
        BAD_INPUT,
        "ending.toml: mesh: expected a name that ends in .gltf, .glb or .obj, found .txt",
    ),
    (
        "bake scene light.toml -o out.relight",
        INPUT_OUTPUT,
        "light.toml: environment: expected a readable file, found none.hdr: \
         No such file or directory (os error 2)",
    ),
    (
        "bake scene table.toml -o out.relight",
        INPUT_OUTPUT,
        "table.toml: materials.default.file: expected a readable file, found none.bsdf: \
         No such file or directory (os error 2)",
    ),
    (
        "bake scene baked.toml -o out.relight",
        BAD_INPUT,
        r#"text.relight: header: expected "RELIGHT\n", found "good mor" (this is not a .relight file)"#,
    ),
    (
        "bake scene texture.toml -o out.relight",
        INPUT_OUTPUT,
        "texture.toml: materials.default.layers[0].diffuse_texture: expected a readable file, \
         found none.png: No such file or directory (os error 2)",
    ),
    (
        "bake scene picture.toml -o out.relight",
        BAD_INPUT,
        "text.txt: file: expected a readable PNG, JPEG or WebP image, found another format",
    ),
    (
        "bake scene buffer.gltf -o out.relight",
        INPUT_OUTPUT,
        "buffer.gltf: buffers[0]: expected a readable file, found none.bin: \
         No such file or directory (os error 2)",
    ),
    (
        "bake scene good.obj -o out.relight --root none",
        INPUT_OUTPUT,
        "none: --root: expected a folder that can be read, \
         found No such file or directory (os error 2)",
    ),
    (
        "bake scene good.obj -o out.relight --root text.txt",
        INPUT_OUTPUT,
        "text.txt: --root: expected a folder that can be read, found Not a directory (os error 20)",
    ),
];

const ENVIRONMENTS: &[Row] = &[
    (
        "bake environment none.hdr -o out.relight",
        INPUT_OUTPUT,
        "none.hdr: file: expected a readable file, found No such file or directory (os error 2)",
    ),
    (
        "bake environment folder -o out.relight",
        BAD_INPUT,
        "folder: file: expected a regular file, found a folder, pipe, socket or device",
    ),
    (
        "bake environment empty.hdr -o out.relight",
        BAD_INPUT,
        r##"empty.hdr: first bytes: expected "#?" of Radiance HDR or "v/1\x01" of OpenEXR, found an empty file"##,
    ),
    (
        "bake environment text.hdr -o out.relight",
        BAD_INPUT,
        r##"text.hdr: first bytes: expected "#?" of Radiance HDR or "v/1\x01" of OpenEXR, found "good morning""##,
    ),
    (
        "bake environment cut.hdr -o out.relight",
        BAD_INPUT,
        "cut.hdr: pixels: expected 2000 x 1000 pixels, found the end of the file",
    ),
    (
        "bake environment huge.hdr -o out.relight",
        BAD_INPUT,
        "huge.hdr: image size: expected 1 to 33554432 pixels (--limit-pixels), found 200000 x 100000",
    ),
    (
        "bake environment square.hdr -o out.relight",
        BAD_INPUT,
        "square.hdr: image size: expected a lat-long map, twice as wide as high (convert it, or take \
         it as one with --any-shape; --flip and --mirror turn maps that are upside down or seen from \
         outside), found 2 x 2, a square as of a light probe (angular map), a mirror ball or an \
         octahedral map",
    ),
    (
        "bake environment good.hdr -o out.relight --report text.txt",
        INPUT_OUTPUT,
        "text.txt: --report: expected a folder that can be written, found File exists (os error 17)",
    ),
];

const MATERIALS: &[Row] = &[
    (
        "bake material none.bsdf -o out.relight",
        INPUT_OUTPUT,
        "none.bsdf: file: expected a readable file, found No such file or directory (os error 2)",
    ),
    (
        "bake material folder -o out.relight",
        BAD_INPUT,
        "folder: file: expected a regular file, found a folder, pipe, socket or device",
    ),
    (
        "bake material empty.bsdf -o out.relight",
        BAD_INPUT,
        r#"empty.bsdf: first bytes: expected "tensor_file" of a .bsdf, the numbers 90, 90, 180 of a .binary, or the ending .toml, found an empty file"#,
    ),
    (
        "bake material text.txt -o out.relight",
        BAD_INPUT,
        r#"text.txt: first bytes: expected "tensor_file" of a .bsdf, the numbers 90, 90, 180 of a .binary, or the ending .toml, found "good morning""#,
    ),
    (
        "bake material text.toml -o out.relight",
        BAD_INPUT,
        "text.toml: line 1, column 6: expected `=`, found key with no value",
    ),
    (
        "bake material material.toml -o out.relight",
        BAD_INPUT,
        "material.toml: material.f0: expected reflectances in [0, 1], found [2.0, 2.0, 2.0]",
    ),
    (
        "bake material good.toml -o out.relight --lobes 3",
        USAGE,
        "--lobes: expected a table (.bsdf, .binary) with it, found it, without effect",
    ),
    (
        "bake material text.bsdf -o out.relight --root .",
        USAGE,
        "--root: expected a material file (.toml) with it, found it, without effect",
    ),
    (
        "bake material good.toml -o out.relight --root none",
        INPUT_OUTPUT,
        "none: --root: expected a folder that can be read, \
         found No such file or directory (os error 2)",
    ),
];

const ASSETS: &[Row] = &[
    (
        "bake inspect none.relight",
        INPUT_OUTPUT,
        "none.relight: file: expected a readable file, found No such file or directory (os error 2)",
    ),
    (
        "bake validate folder",
        BAD_INPUT,
        "folder: file: expected a regular file, found a folder, pipe, socket or device",
    ),
    (
        "bake validate empty.relight",
        BAD_INPUT,
        "empty.relight: header: expected at least 8 bytes, found 0 bytes (the file ends too early)",
    ),
    (
        "bake inspect text.relight",
        BAD_INPUT,
        r#"text.relight: header: expected "RELIGHT\n", found "good mor" (this is not a .relight file)"#,
    ),
    (
        "bake merge none.relight -o out.relight",
        INPUT_OUTPUT,
        "none.relight: file: expected a readable file, found No such file or directory (os error 2)",
    ),
    (
        "bake merge text.relight -o out.relight",
        BAD_INPUT,
        "text.relight: header: expected at least 48 bytes, as `bake scene --shard` writes them, \
         found 23 bytes",
    ),
    (
        "bake merge cut.hdr -o out.relight",
        BAD_INPUT,
        r##"cut.hdr: header: expected a parts file, found "#?RADIAN""##,
    ),
];

const OUTPUTS: &[Row] = &[
    (
        "bake scene good.obj -o none/out.relight",
        INPUT_OUTPUT,
        "none/out.relight: output: expected a file that can be written, \
         found No such file or directory (os error 2)",
    ),
    (
        "bake scene good.obj -o folder",
        INPUT_OUTPUT,
        "folder: output: expected a regular file or nothing, found a folder",
    ),
    (
        "bake scene good.obj -o good.obj",
        USAGE,
        "good.obj: output: expected another file than the inputs, found the input good.obj",
    ),
    (
        "bake environment good.hdr -o folder",
        INPUT_OUTPUT,
        "folder: output: expected a regular file or nothing, found a folder",
    ),
    (
        "bake material good.toml -o none/out.relight",
        INPUT_OUTPUT,
        "none/out.relight: output: expected a file that can be written, \
         found No such file or directory (os error 2)",
    ),
    (
        "bake merge text.relight -o text.relight",
        USAGE,
        "text.relight: output: expected another file than the inputs, found the input text.relight",
    ),
    (
        "lab render text.relight --environment text.relight -o picture.jpg",
        BAD_INPUT,
        "picture.jpg: file name: expected .exr or .png, found .jpg",
    ),
    (
        "lab render text.relight --environment text.relight -o none/picture.png",
        INPUT_OUTPUT,
        "none/picture.png: output: expected a file that can be written, \
         found No such file or directory (os error 2)",
    ),
    (
        "lab truth good.obj --kind full -o none/picture.png",
        INPUT_OUTPUT,
        "none/picture.png: output: expected a file that can be written, \
         found No such file or directory (os error 2)",
    ),
    (
        "lab demo --out text.txt",
        INPUT_OUTPUT,
        "text.txt: --out: expected a folder that can be written, found File exists (os error 17)",
    ),
    (
        "lab experiments brdf --device cpu --out text.txt",
        INPUT_OUTPUT,
        "text.txt: --out: expected a folder that can be written, found File exists (os error 17)",
    ),
    (
        "lab experiments occluders --device cpu --out folder --data none",
        INPUT_OUTPUT,
        "none: --data: expected a folder that can be read, \
         found No such file or directory (os error 2)",
    ),
];

const OPTIONS: &[Row] = &[
    (
        "bake scene good.obj -o out.relight --max-error 0",
        USAGE,
        "invalid value '0' for '--max-error <RADIANS>': expected a number above 0",
    ),
    (
        "bake scene good.obj -o out.relight --shard 3/2",
        USAGE,
        "invalid value '3/2' for '--shard <I/N>': expected I/N with I from 1 to N",
    ),
    (
        "bake scene good.obj -o out.relight --sample-resolution 100 --basis-resolution 64",
        USAGE,
        "--sample-resolution: expected a multiple of the basis resolution, 64, found 100",
    ),
    (
        "bake scene good.obj -o out.relight --rank 3",
        USAGE,
        "--rank: expected --representation global with it, found it, without effect",
    ),
    (
        "bake environment good.hdr -o out.relight --lobes 0",
        USAGE,
        "invalid value '0' for '--lobes <N>': expected a number from 1 to 1024",
    ),
    (
        "lab render text.relight --environment text.relight -o picture.png --fov-y 180",
        USAGE,
        "invalid value '180' for '--fov-y <FOV_Y>': expected degrees above 0 and below 180",
    ),
    (
        "lab render text.relight --environment text.relight -o picture.png --rotate nan",
        USAGE,
        "invalid value 'nan' for '--rotate <ROTATE>': expected a finite number",
    ),
    (
        "lab truth good.obj --kind full -o picture.png",
        USAGE,
        "--environment: expected a lat-long image, found none",
    ),
];

const LAB: &[Row] = &[
    (
        "lab render none.relight --environment text.relight -o picture.png",
        INPUT_OUTPUT,
        "none.relight: file: expected a readable file, found No such file or directory (os error 2)",
    ),
    (
        "lab render folder --environment text.relight -o picture.png",
        BAD_INPUT,
        "folder: file: expected a regular file, found a folder, pipe, socket or device",
    ),
    (
        "lab render empty.relight --environment text.relight -o picture.png",
        BAD_INPUT,
        "empty.relight: header: expected at least 8 bytes, found 0 bytes (the file ends too early)",
    ),
    (
        "lab bench text.relight --environment text.relight",
        BAD_INPUT,
        r#"text.relight: header: expected "RELIGHT\n", found "good mor" (this is not a .relight file)"#,
    ),
    (
        "lab truth none.toml --kind full -o picture.png",
        INPUT_OUTPUT,
        "none.toml: file: expected a readable file, found No such file or directory (os error 2)",
    ),
    (
        "lab truth good.obj --kind full --environment text.hdr -o picture.png",
        BAD_INPUT,
        r##"text.hdr: first bytes: expected "#?" of Radiance HDR or "v/1\x01" of OpenEXR, found "good morning""##,
    ),
    (
        "lab truth good.obj --kind full --environment good.hdr -o picture.png --camera none.toml",
        INPUT_OUTPUT,
        "none.toml: file: expected a readable file, found No such file or directory (os error 2)",
    ),
    (
        "lab truth good.obj --kind full --environment good.hdr -o picture.png --camera camera.toml",
        BAD_INPUT,
        "camera.toml: camera: expected one of fov_x_degrees and fov_y_degrees, found none or both",
    ),
    (
        "lab truth good.obj --kind full --environment good.hdr -o picture.png --lights text.toml",
        BAD_INPUT,
        "text.toml: line 1, column 6: expected `=`, found key with no value",
    ),
    (
        "lab truth good.obj --kind full --environment good.hdr -o picture.png --root none",
        INPUT_OUTPUT,
        "none: --root: expected a folder that can be read, \
         found No such file or directory (os error 2)",
    ),
    (
        "lab compare none.exr text.exr",
        INPUT_OUTPUT,
        "none.exr: file: expected a readable file, found No such file or directory (os error 2)",
    ),
    (
        "lab compare text.exr text.exr",
        BAD_INPUT,
        "text.exr: file: expected an OpenEXR image with channels R, G and B, \
         found invalid: file identifier missing",
    ),
];

/// Runs every row and tells of all that are otherwise.
fn check(rows: &[Row]) -> Outcome {
    let folder = tempfile::tempdir()?;
    for (name, bytes) in FILES {
        std::fs::write(folder.path().join(name), bytes)?;
    }
    for name in ["folder", "folder.obj"] {
        std::fs::create_dir(folder.path().join(name))?;
    }
    let before = names(folder.path())?;
    let mut wrong = Vec::new();
    for (command, code, expected) in rows {
        let mut words = command.split(' ');
        let output = binary(words.next().ok_or("an empty row")?)
            .args(words)
            .current_dir(folder.path())
            .stdin(Stdio::null())
            .output()?;
        let said = error_lines(&output);
        if output.status.code() != Some(*code) || said != [format!("error: {expected}")] {
            wrong.push(format!("{command}: {}", describe(&output)));
        }
        let after = names(folder.path())?;
        if after != before {
            return Err(format!("{command} leaves {after:?}").into());
        }
    }
    if wrong.is_empty() {
        return Ok(());
    }
    Err(wrong.join("\n").into())
}

/// A command, and what its `--json` says of file, place, expected, found and issue.
type JsonRow = (&'static str, [Option<&'static str>; 5]);

const JSON: &[JsonRow] = &[
    (
        "bake validate empty.relight",
        [
            Some("empty.relight"),
            Some("header"),
            Some("at least 8 bytes"),
            Some("0 bytes"),
            Some("Truncated"),
        ],
    ),
    (
        "bake scene baked.toml -o out.relight",
        [
            Some("text.relight"),
            Some("header"),
            Some("\"RELIGHT\\n\""),
            Some("\"good mor\""),
            Some("BadMagic"),
        ],
    ),
    (
        "bake scene type.toml -o out.relight",
        [
            Some("type.toml"),
            Some("line 1, column 8"),
            Some("path string"),
            Some("integer `3`"),
            None,
        ],
    ),
];

/// The same as programs read it.
fn as_json() -> Outcome {
    let folder = tempfile::tempdir()?;
    for (name, bytes) in FILES {
        std::fs::write(folder.path().join(name), bytes)?;
    }
    for (command, expected) in JSON {
        let mut words = command.split(' ');
        let output = binary(words.next().ok_or("an empty row")?)
            .args(words)
            .arg("--json")
            .current_dir(folder.path())
            .stdin(Stdio::null())
            .output()?;
        let object: serde_json::Value = serde_json::from_slice(&output.stdout)?;
        let found = ["file", "place", "expected", "found", "issue"]
            .map(|name| object["error"][name].as_str());
        if found != *expected {
            return Err(format!("{command}: {}", describe(&output)).into());
        }
    }
    Ok(())
}

fn error_lines(output: &Output) -> Vec<String> {
    let errors = String::from_utf8_lossy(&output.stderr);
    let lines = errors.lines().filter(|line| line.starts_with("error"));
    lines.map(str::to_owned).collect()
}

fn names(folder: &Path) -> std::io::Result<Vec<std::ffi::OsString>> {
    let entries = std::fs::read_dir(folder)?.map(|entry| Ok(entry?.file_name()));
    let mut names = entries.collect::<std::io::Result<Vec<_>>>()?;
    names.sort();
    Ok(names)
}
