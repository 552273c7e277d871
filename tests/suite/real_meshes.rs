//! Meshes of other people's making: the good ones bake, the broken ones say what is wrong.

use std::path::Path;

use libtest_mimic::Trial;

use crate::cli::{bake_scene, expect_refusal, expect_success};
use crate::support::{Outcome, with_data};

pub fn trials() -> Vec<Trial> {
    let good = GOOD.map(|(mesh, triangles)| {
        with_data(format!("real_meshes::bakes::{mesh}"), move |data| {
            bakes(&data.join("meshes").join(mesh), triangles)
        })
    });
    let broken = BROKEN.map(|(mesh, reason)| {
        with_data(format!("real_meshes::refuses::{mesh}"), move |data| {
            is_refused(&data.join("meshes").join(mesh), reason)
        })
    });
    good.into_iter().chain(broken).collect()
}

/// Meshes that bake, and their triangles: polygons in fans or ears, those of zero area
/// dropped, double-sided ones twice. Everything odd about them is legal or has one plain
/// meaning.
const GOOD: [(&str, u64); 73] = [
    ("awkward/draco/cube_att_partial.obj", 12),
    ("awkward/draco/cube_quads.obj", 12),
    ("awkward/draco/cube_subd.obj", 3072),
    ("awkward/draco/deg_faces.obj", 3),
    ("awkward/draco/empty_name.obj", 1),
    ("awkward/draco/eof_test.obj", 1),
    ("awkward/draco/extra_vertex.obj", 3),
    ("awkward/draco/mat_test.obj", 1300),
    ("awkward/draco/multiple_isolated_triangles.obj", 5),
    ("awkward/draco/multiple_tetrahedrons.obj", 20),
    ("awkward/draco/non_manifold_wrap.obj", 12),
    ("awkward/draco/octagon_preserved.obj", 6),
    ("awkward/draco/test_nm.obj", 170),
    ("awkward/draco/test_wrong_attribute_mapping.obj", 1),
    ("awkward/draco/triangle_with_degenerate_tex_coords.obj", 1),
    ("awkward/draco/two_faces_123.obj", 2),
    (
        "awkward/gltf/SimpleSparseAccessor/SimpleSparseAccessor.gltf",
        12,
    ),
    (
        "awkward/gltf/ZeroLengthBufferView/ZeroLengthBufferView.gltf",
        2,
    ),
    ("awkward/gltf/box_sparse.glb", 12),
    ("awkward/gltf/box_sparse/box_sparse.gltf", 12),
    ("awkward/gltf/cube_att/cube_att.gltf", 48),
    ("awkward/gltf/duplicate_meshes/duplicate_meshes.gltf", 224),
    (
        "awkward/gltf/one_face_123_cesium_rtc/one_face_123_cesium_rtc.gltf",
        1,
    ),
    (
        "awkward/gltf/one_face_123_mirror/one_face_123_mirror.gltf",
        1,
    ),
    (
        "awkward/gltf/one_face_123_translated/one_face_123_translated.gltf",
        1,
    ),
    ("awkward/gltf/sphere/sphere.gltf", 224),
    ("awkward/nested.glb", 72),
    ("awkward/simple-instancing.glb", 1500),
    ("awkward/tinyobj/catmark_torus_creases0.obj", 64),
    ("awkward/tinyobj/colorspace-issue-184.obj", 1),
    ("awkward/tinyobj/cornell_box.obj", 36),
    ("awkward/tinyobj/cornell_box_multimaterial.obj", 36),
    ("awkward/tinyobj/cube-vertex-w-component.obj", 12),
    ("awkward/tinyobj/cube-vertexcol.obj", 12),
    ("awkward/tinyobj/cube.obj", 12),
    ("awkward/tinyobj/issue-138.obj", 12),
    ("awkward/tinyobj/issue-161-inconsistent-f.obj", 12),
    ("awkward/tinyobj/issue-162-smoothing-group.obj", 12),
    ("awkward/tinyobj/issue-235-usemtl-then-o.obj", 2),
    ("awkward/tinyobj/issue-244-mtl-searchpaths.obj", 2),
    ("awkward/tinyobj/issue-246-usemtl-whitespace.obj", 1),
    ("awkward/tinyobj/issue-248-texres-texopt.obj", 12),
    ("awkward/tinyobj/issue-295-trianguation-failure.obj", 28),
    ("awkward/tinyobj/issue-319-002.obj", 13),
    ("awkward/tinyobj/issue-319-003.obj", 8),
    ("awkward/tinyobj/issue-330.obj", 3),
    ("awkward/tinyobj/issue-92.obj", 1),
    ("awkward/tinyobj/issue-95-2.obj", 1),
    ("awkward/tinyobj/issue-95.obj", 1),
    ("awkward/tinyobj/leading-decimal-dot-issue-201.obj", 1),
    (
        "awkward/tinyobj/leading-zero-in-exponent-notation-issue-210.obj",
        1,
    ),
    ("awkward/tinyobj/map-bump.obj", 400),
    ("awkward/tinyobj/missing_material_file.obj", 36),
    (
        "awkward/tinyobj/mtl filename with whitespace issue46.obj",
        12,
    ),
    ("awkward/tinyobj/mtllib-multiple-files-issue-112.obj", 1),
    ("awkward/tinyobj/no_material.obj", 36),
    ("awkward/tinyobj/norm-texopt.obj", 1),
    ("awkward/tinyobj/pbr-mat-ext.obj", 2),
    ("awkward/tinyobj/refl.obj", 12),
    ("awkward/tinyobj/skin-weight.obj", 12),
    ("awkward/tinyobj/smoothing-group-two-squares.obj", 3),
    ("awkward/tinyobj/smoothing-normal.obj", 6),
    ("awkward/tinyobj/texture-filename-with-whitespace.obj", 12),
    ("awkward/tinyobj/texture-options-issue-85.obj", 1),
    ("awkward/tinyobj/tr-and-d-issue-43.obj", 400),
    ("awkward/tinyobj/usemtl-issue-104.obj", 6),
    ("awkward/tinyobj/usemtl-issue-68.obj", 400),
    ("figures/Duck.glb", 4212),
    ("figures/suzanne_quads.obj", 968),
    ("scenes/CornellBox_bevy.glb", 72),
    ("scenes/cornell_box/scene.gltf", 64),
    ("thin/low-poly-tree.glb", 2252),
    ("thin/simple_pole.glb", 580),
];

/// Meshes that cannot bake, and what the message must say beyond the file's name.
const BROKEN: [(&str, &str); 15] = [
    ("awkward/draco/degenerate_mesh.obj", "zero area"),
    ("awkward/draco/inf_nan.obj", "line 1"),
    ("awkward/draco/test_lines.obj", "no triangle"),
    (
        "awkward/gltf/BoxMetaDraco/BoxMetaDraco.gltf",
        "KHR_draco_mesh_compression",
    ),
    ("awkward/gltf/Box_Draco.glb", "KHR_draco_mesh_compression"),
    ("awkward/gltf/minimal_accessor_invalid.gltf", "max"),
    (
        "awkward/gltf/non_sparse_accessor_without_buffer_view.gltf",
        "zero area",
    ),
    ("awkward/tinyobj/invalid-face-definition.obj", "no triangle"),
    (
        "awkward/tinyobj/invalid-relative-texture-index.obj",
        "line 2",
    ),
    (
        "awkward/tinyobj/invalid-relative-vertex-index.obj",
        "line 1",
    ),
    ("awkward/tinyobj/issue-140-zero-face-idx.obj", "line 16"),
    (
        "awkward/tinyobj/issue-356-leading-spaces-newmtl.obj",
        "no triangle",
    ),
    ("awkward/tinyobj/line-prim.obj", "no triangle"),
    ("awkward/tinyobj/points-prim.obj", "no triangle"),
    ("awkward/tinyobj/test-nan.obj", "line 12"),
];

fn bakes(mesh: &Path, triangles: u64) -> Outcome {
    let folder = tempfile::tempdir()?;
    let asset = folder.path().join("out.relight");
    expect_success(&mut bake_scene(mesh, &asset));
    let limits = relight_format::Limits::default();
    let scene = relight_format::read_scene(&std::fs::read(&asset)?, &limits)?;
    assert_eq!(scene.report.source_triangles, triangles);
    assert!(
        scene.triangles.len() as u64 >= triangles,
        "{} triangles",
        scene.triangles.len()
    );
    Ok(())
}

fn is_refused(mesh: &Path, reason: &str) -> Outcome {
    assert!(mesh.is_file(), "{} is missing", mesh.display());
    let folder = tempfile::tempdir()?;
    let asset = folder.path().join("out.relight");
    let line = expect_refusal(&mut bake_scene(mesh, &asset), mesh);
    assert!(line.contains(reason), "{line:?} does not say {reason:?}");
    assert_eq!(
        std::fs::read_dir(folder.path())?.count(),
        0,
        "something is left behind"
    );
    Ok(())
}
