//! Bakes that are killed, continued, divided among machines and joined, and bakes that run
//! out of disk: the bytes are always those of one undisturbed bake.

use std::fs::File;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use libtest_mimic::{Completion, Failed, Trial};

use crate::cli::{BAD_INPUT, INPUT_OUTPUT, USAGE, describe, error_line, expect, expect_success};
use crate::meshes::sphere_over_ground;
use crate::support::{Outcome, binary, with_data};

pub fn trials() -> Vec<Trial> {
    let verified = VERIFIED.map(|mesh| {
        with_data(format!("farm::verify_visibility::{mesh}"), move |data| {
            verify_visibility(&data.join("meshes").join(mesh), &[])
        })
    });
    // So large that some places are sampled to choose an aim, and kept.
    let draft = with_data("farm::verify_visibility::draft", |data| {
        verify_visibility(
            &data.join("meshes/stanford/bunny.obj"),
            &["--preset", "draft"],
        )
    });
    let mut trials = vec![
        Trial::test("farm::killed_at_random_points", killed_at_random_points),
        Trial::test("farm::resumes_from_any_cut", resumes_from_any_cut),
        Trial::test("farm::resume_refuses_another_scene", refuses_another_scene),
        Trial::test("farm::leftover_is_replaced", leftover_is_replaced),
        Trial::test("farm::one_bake_per_output", one_bake_per_output),
        Trial::test("farm::shards_merge_to_the_same_bytes", shards_merge),
        Trial::test("farm::merge_refuses_the_wrong_shards", wrong_shards),
        Trial::test("farm::damaged_shards", damaged_shards),
        Trial::test("farm::full_disk", full_disk),
        Trial::test("farm::memory", memory),
        Trial::test("farm::low_priority", low_priority),
        Trial::ignorable_test("farm::slurm", slurm),
        Trial::ignorable_test("farm::kubernetes", kubernetes),
    ];
    trials.extend(verified);
    trials.push(draft);
    trials
}

/// Meshes with thin parts, seams and open edges.
const VERIFIED: [&str; 4] = [
    "awkward/draco/non_manifold_wrap.obj",
    "awkward/draco/test_nm.obj",
    "awkward/gltf/duplicate_meshes/duplicate_meshes.gltf",
    "figures/suzanne_quads.obj",
];

/// A folder with a mesh of several chunks, and what one bake makes of it.
struct Fixture {
    folder: tempfile::TempDir,
    mesh: PathBuf,
    expected: Vec<u8>,
    seconds: Duration,
}

impl Fixture {
    fn new(steps: usize) -> std::io::Result<Self> {
        let folder = tempfile::tempdir()?;
        let mesh = folder.path().join("sphere.obj");
        std::fs::write(&mesh, sphere_over_ground(steps))?;
        let asset = folder.path().join("expected.relight");
        let start = Instant::now();
        expect_success(&mut bake(&mesh, &asset));
        Ok(Self {
            mesh,
            expected: std::fs::read(&asset)?,
            seconds: start.elapsed(),
            folder,
        })
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// Bakes shard `number` of `count`.
    fn shard(&self, number: usize, count: usize) -> PathBuf {
        let path = self.path(&format!("{number}-of-{count}.part"));
        let shard = format!("{number}/{count}");
        expect_success(bake(&self.mesh, &path).args(["--shard", &shard]));
        path
    }

    fn assert_same(&self, asset: &Path) {
        let bytes = std::fs::read(asset).expect("an asset");
        assert!(
            bytes == self.expected,
            "{} has other bytes",
            asset.display()
        );
        let parts = parts_of(asset);
        assert!(!parts.exists(), "{} is left", parts.display());
    }
}

/// Steps of a sphere over ground of about six chunks.
const STEPS: usize = 44;

/// Cheap, and without refinement.
fn bake(mesh: &Path, output: &Path) -> Command {
    let mut bake = binary("bake");
    bake.arg("scene").arg(mesh).arg("-o").arg(output);
    bake.args(["--sample-resolution", "32", "--basis-resolution", "16"]);
    bake.args(["--max-error", "0.2", "--max-edge", "1"]);
    bake
}

fn merge(parts: &[PathBuf], output: &Path) -> Command {
    let mut merge = binary("bake");
    merge.arg("merge").args(parts).arg("-o").arg(output);
    merge
}

fn parts_of(asset: &Path) -> PathBuf {
    let mut parts = asset.as_os_str().to_owned();
    parts.push(".parts");
    parts.into()
}

fn killed_at_random_points() -> Outcome {
    /// Kills; each is of a process that has lived up to an undisturbed bake's time.
    const KILLS: u32 = 20;
    let fixture = Fixture::new(STEPS)?;
    let asset = fixture.path("killed.relight");
    std::fs::write(&asset, "what was there before")?;
    let mut state = 1u32;
    for _ in 0..KILLS {
        let mut child = bake(&fixture.mesh, &asset)
            .arg("--resume")
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()?;
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        std::thread::sleep(
            fixture
                .seconds
                .mul_f64(f64::from(state) / f64::from(u32::MAX)),
        );
        child.kill()?;
        child.wait()?;
    }
    expect_success(bake(&fixture.mesh, &asset).arg("--resume"));
    fixture.assert_same(&asset);
    Ok(())
}

fn resumes_from_any_cut() -> Outcome {
    let fixture = Fixture::new(STEPS)?;
    // The only shard of one is what a bake leaves when it is killed, with an end behind it.
    let whole = std::fs::read(fixture.shard(1, 1))?;
    let asset = fixture.path("cut.relight");
    let mut most = 0;
    for cut in [
        0,
        7,
        48,
        60,
        whole.len() / 3,
        whole.len() / 2,
        whole.len() - 1,
        whole.len(),
    ] {
        // Of a few bytes all are needed.
        let kinds: &[bool] = if cut > 100 { &[false, true] } else { &[false] };
        for &damaged in kinds {
            let mut bytes = whole[..cut].to_vec();
            if damaged {
                bytes[cut * 2 / 3] ^= 1;
            }
            std::fs::write(parts_of(&asset), &bytes)?;
            let output = expect_success(bake(&fixture.mesh, &asset).args(["--resume", "--json"]));
            let summary: serde_json::Value = serde_json::from_slice(&output.stdout)?;
            let resumed = summary["resumed_chunks"].as_u64().expect("a number");
            let chunks = summary["chunks"].as_u64().expect("a number");
            assert!(chunks >= 4, "{chunks} chunks test nothing");
            assert!(damaged || cut < whole.len() - 1 || resumed == chunks);
            assert!(cut >= whole.len() / 3 || resumed == 0);
            most = most.max(if damaged { resumed } else { 0 });
            fixture.assert_same(&asset);
            std::fs::remove_file(&asset)?;
        }
    }
    assert!(most > 0, "what lies before the damage counts");
    Ok(())
}

fn refuses_another_scene() -> Outcome {
    let fixture = Fixture::new(8)?;
    let asset = fixture.path("out.relight");
    let parts = parts_of(&asset);
    std::fs::copy(fixture.shard(1, 1), &parts)?;
    let before = std::fs::read(&parts)?;
    let mut other = bake(&fixture.mesh, &asset);
    other.args(["--resume", "--max-tiles", "2"]);
    error_line(&expect(BAD_INPUT, &mut other), &parts);
    // A header whose checksum does not match is not taken for one either.
    let mut damaged = before.clone();
    damaged[20] ^= 1;
    std::fs::write(&parts, &damaged)?;
    let output = expect(BAD_INPUT, bake(&fixture.mesh, &asset).arg("--resume"));
    let line = error_line(&output, &parts);
    assert!(line.contains("checksum"), "{line}");
    assert!(!asset.exists() && std::fs::read(&parts)? == damaged);
    Ok(())
}

fn leftover_is_replaced() -> Outcome {
    let fixture = Fixture::new(8)?;
    let asset = fixture.path("out.relight");
    std::fs::write(parts_of(&asset), "RLPARTS\nand anything")?;
    let output = expect_success(&mut bake(&fixture.mesh, &asset));
    let warning = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(warning.contains("--resume"), "{warning}");
    fixture.assert_same(&asset);
    Ok(())
}

fn one_bake_per_output() -> Outcome {
    let fixture = Fixture::new(8)?;
    let asset = fixture.path("out.relight");
    let parts = parts_of(&asset);
    let file = File::create(&parts)?;
    file.lock()?;
    for resume in [&["--resume"][..], &[]] {
        let output = expect(BAD_INPUT, bake(&fixture.mesh, &asset).args(resume));
        error_line(&output, &parts);
    }
    assert!(parts.exists() && !asset.exists());
    Ok(())
}

fn shards_merge() -> Outcome {
    let fixture = Fixture::new(STEPS)?;
    let merged = fixture.path("merged.relight");
    // More shards than chunks leave some empty.
    for count in [1, 3, 20] {
        let mut shards: Vec<PathBuf> = (1..=count).map(|i| fixture.shard(i, count)).collect();
        shards.reverse();
        std::fs::write(&merged, "what was there before")?;
        expect_success(&mut merge(&shards, &merged));
        fixture.assert_same(&merged);
    }
    for wrong in ["0/3", "4/3", "1", "1/0", "a/b"] {
        expect(USAGE, bake(&fixture.mesh, &merged).args(["--shard", wrong]));
    }
    Ok(())
}

fn wrong_shards() -> Outcome {
    let fixture = Fixture::new(8)?;
    let merged = fixture.path("merged.relight");
    let shards: Vec<PathBuf> = (1..=3).map(|i| fixture.shard(i, 3)).collect();
    let [a, b, c] = &shards[..] else {
        unreachable!("three")
    };
    let refused = |parts: &[&PathBuf], file: &Path, reason: &str| {
        let parts: Vec<PathBuf> = parts.iter().map(|&path| path.clone()).collect();
        let line = error_line(&expect(BAD_INPUT, &mut merge(&parts, &merged)), file);
        assert!(line.contains(reason), "{line:?} does not say {reason:?}");
        assert!(!merged.exists());
    };
    refused(&[a, c], a, "none of 2");
    refused(&[a, b, b, c], b, "another shard");
    let other = fixture.path("other.part");
    let mut options = bake(&fixture.mesh, &other);
    expect_success(options.args(["--shard", "3/3", "--max-tiles", "2"]));
    refused(&[a, b, &other], &other, "scene and options");
    let of_two = fixture.shard(2, 2);
    refused(&[a, &of_two, c], &of_two, "of 2");
    refused(&[a, b, &fixture.mesh], &fixture.mesh, "parts file");
    let missing = fixture.path("missing.part");
    let gone = expect(
        INPUT_OUTPUT,
        &mut merge(&[a.clone(), missing.clone()], &merged),
    );
    error_line(&gone, &missing);
    expect(USAGE, &mut merge(&[], &merged));
    Ok(())
}

fn damaged_shards() -> Outcome {
    let fixture = Fixture::new(8)?;
    let (merged, damaged) = (fixture.path("merged.relight"), fixture.path("damaged.part"));
    let whole = std::fs::read(fixture.shard(1, 1))?;
    // Headers and records at every byte, payloads here and there.
    let places = (0..100)
        .chain((100..whole.len()).step_by(whole.len() / 40))
        .chain([whole.len() - 1]);
    let refused = |bytes: &[u8], what: &str| {
        std::fs::write(&damaged, bytes).expect("a writable folder");
        let parts = relight_bake::scene::parts::open_all(std::slice::from_ref(&damaged));
        assert!(parts.is_err(), "{what}");
    };
    for place in places {
        let mut bytes = whole.clone();
        bytes[place] ^= 0x10;
        refused(&bytes, &format!("byte {place} changed"));
        refused(&whole[..place], &format!("cut at byte {place}"));
    }
    refused(&[&whole[..], b"x"].concat(), "a byte too many");
    let line = error_line(
        &expect(
            BAD_INPUT,
            &mut merge(std::slice::from_ref(&damaged), &merged),
        ),
        &damaged,
    );
    assert!(line.contains("finished shard"), "{line}");
    assert!(!merged.exists());
    Ok(())
}

/// A limit on file size stands for a full disk: both fail in the middle of a write.
fn full_disk() -> Outcome {
    let fixture = Fixture::new(STEPS)?;
    let asset = fixture.path("out.relight");
    // Too small for a chunk, for all chunks, and just for the asset.
    let whole = std::fs::metadata(fixture.shard(1, 1))?.len();
    for bytes in [1024, whole / 2] {
        std::fs::write(&asset, "what was there before")?;
        let full = bake(&fixture.mesh, &asset);
        // Blocks are of 512 bytes, or of 1024 in some shells.
        let mut limited = Command::new("sh");
        limited.arg("-c").arg(format!(
            "trap '' XFSZ; ulimit -f {}; exec \"$@\"",
            bytes / 1024
        ));
        limited
            .arg("sh")
            .arg(full.get_program())
            .args(full.get_args());
        let output = expect(INPUT_OUTPUT, &mut limited);
        error_line(&output, &asset);
        assert_eq!(std::fs::read(&asset)?, b"what was there before");
        assert_eq!(parts_of(&asset).exists(), bytes > 1024);
        expect_success(bake(&fixture.mesh, &asset).arg("--resume"));
        fixture.assert_same(&asset);
    }
    Ok(())
}

/// At default resolutions, on many more threads than chunks may be at hand.
fn memory() -> Outcome {
    /// What may be at hand, with room for the scene. All chunks together come to more.
    const MOST_BYTES: u64 = 896 << 20;
    let folder = tempfile::tempdir()?;
    let (mesh, asset) = (
        folder.path().join("sphere.obj"),
        folder.path().join("out.relight"),
    );
    std::fs::write(&mesh, sphere_over_ground(72))?;
    let mut bake = binary("bake");
    bake.arg("scene").arg(&mesh).arg("-o").arg(&asset);
    bake.args([
        "--sample-resolution",
        "64",
        "--max-error",
        "1",
        "--max-edge",
        "1",
    ]);
    let output = expect_success(bake.args(["--threads", "64", "--json"]));
    let summary: serde_json::Value = serde_json::from_slice(&output.stdout)?;
    // Null where the system does not tell.
    if let Some(peak) = summary["peak_resident_bytes"].as_u64() {
        assert!(peak < MOST_BYTES, "{peak} bytes");
    }
    Ok(())
}

#[cfg(unix)]
fn low_priority() -> Outcome {
    let folder = tempfile::tempdir()?;
    let (mesh, asset) = (
        folder.path().join("sphere.obj"),
        folder.path().join("out.relight"),
    );
    std::fs::write(&mesh, sphere_over_ground(250))?;
    let mut child = bake(&mesh, &asset)
        .arg("--low-priority")
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()?;
    std::thread::sleep(Duration::from_secs(1));
    let priorities = Command::new("ps")
        .args(["-L", "-o", "ni=", "-p", &child.id().to_string()])
        .output();
    child.kill()?;
    child.wait()?;
    let Ok(priorities) = priorities else {
        return Err("this trial needs ps".into());
    };
    let text = String::from_utf8(priorities.stdout)?;
    assert!(text.lines().count() > 1, "several threads: {text:?}");
    // Niceness may already have been higher than 0, and 19 is the most there is.
    assert!(
        text.lines().all(|niceness| niceness.trim() == "19"),
        "{text:?}"
    );
    Ok(())
}

#[cfg(not(unix))]
fn low_priority() -> Outcome {
    Ok(())
}

fn verify_visibility(mesh: &Path, options: &[&str]) -> Outcome {
    let folder = tempfile::tempdir()?;
    let asset = folder.path().join("out.relight");
    let mut bake = bake(mesh, &asset);
    let output = expect_success(bake.args(["--verify-visibility", "--json"]).args(options));
    let summary: serde_json::Value = serde_json::from_slice(&output.stdout)?;
    assert_eq!(summary["differing_texels"], 0);
    let [verified, sampled, probes] = ["verified_points", "sampled_vertices", "probes"]
        .map(|key| summary[key].as_u64().unwrap_or(0));
    assert!(sampled > 0 && probes > 0, "{summary}");
    assert_eq!(verified, sampled + probes);
    Ok(())
}

/// The recipe of FARM.md on a Slurm of its own, a node of which dies.
fn slurm() -> Result<Completion, Failed> {
    /// What the script exits with where there is no Slurm.
    const SKIPPED: i32 = 77;
    let folder = tempfile::tempdir()?;
    let mesh = folder.path().join("sphere.obj");
    std::fs::write(&mesh, sphere_over_ground(STEPS))?;
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("../tools/farm/slurm");
    let mut farm = Command::new(script);
    farm.arg(binary("bake").get_program()).arg(&mesh);
    farm.args(["--sample-resolution", "32", "--basis-resolution", "16"]);
    let output = farm
        .args(["--max-error", "0.2"])
        .stdin(Stdio::null())
        .output()?;
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    let last = text.lines().last().unwrap_or_default();
    match output.status.code() {
        Some(0) => Ok(Completion::Completed),
        Some(SKIPPED) => Ok(Completion::ignored_with(last)),
        _ => Err(describe(&output).into()),
    }
}

/// The manifest of FARM.md against the schemas of Kubernetes, which refuse it when it is wrong.
fn kubernetes() -> Result<Completion, Failed> {
    let checks = |file: &Path| {
        Command::new("kubernetes-validate")
            .arg("--strict")
            .arg(file)
            .stdin(Stdio::null())
            .output()
    };
    let guide = Path::new(env!("CARGO_MANIFEST_DIR")).join("../crates/bake/FARM.md");
    let guide = std::fs::read_to_string(guide)?;
    let manifest = guide
        .split_once("```yaml\n")
        .and_then(|(_, rest)| rest.split_once("```"))
        .map(|(manifest, _)| manifest)
        .ok_or("FARM.md has no manifest")?;
    let folder = tempfile::tempdir()?;
    let file = folder.path().join("job.yaml");
    std::fs::write(&file, manifest)?;
    let Ok(output) = checks(&file) else {
        let why = "no kubernetes-validate (pip install kubernetes-validate)";
        return Ok(Completion::ignored_with(why));
    };
    assert!(output.status.success(), "{}", describe(&output));
    std::fs::write(
        &file,
        manifest.replace("completionMode: Indexed", "completionMode: 3"),
    )?;
    assert!(
        !checks(&file)?.status.success(),
        "a mode that is a number passes"
    );
    Ok(Completion::Completed)
}
