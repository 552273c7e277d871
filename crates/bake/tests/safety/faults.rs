//! Faults of disks, networks and machines, injected into the system calls of `bake` by strace:
//! whatever fails, and wherever the process dies, the old output or the new one is there whole.

use std::collections::BTreeMap;
use std::ffi::OsString;
use std::path::PathBuf;
use std::process::{Command, Stdio};
use std::time::Duration;

use libtest_mimic::{Completion, Failed, Trial};

use crate::command::{BAD_INPUT, INPUT_OUTPUT, OK, describe, error_line, expect_success};
use crate::{Folder, bake_environment, bake_material, bake_scene, grey_hdr};

pub fn trials() -> Vec<Trial> {
    vec![
        Trial::ignorable_test("faults::of_outputs", of_outputs),
        Trial::ignorable_test("faults::of_inputs", of_inputs),
        Trial::ignorable_test("faults::killed_at_every_call", killed_at_every_call),
        Trial::ignorable_test("faults::changed_input", changed_input),
    ]
}

/// Calls by which a file is opened, written and put in place, and what disks, quotas, read-only
/// and remote file systems answer.
const FAULTS: [(&str, &[&str]); 6] = [
    ("openat", &["EACCES", "ENOSPC", "EROFS", "EMFILE", "ESTALE"]),
    ("flock", &["ENOLCK", "EIO"]),
    ("ftruncate", &["EIO"]),
    ("write", &["ENOSPC", "EDQUOT", "EIO", "EFBIG", "ESTALE"]),
    ("fsync", &["EIO", "ENOSPC", "EDQUOT"]),
    ("rename", &["EACCES", "EIO", "EROFS", "ESTALE", "EXDEV"]),
];

/// What was there before.
const OLD: &[u8] = b"what was there before";

/// One command, its input and output.
struct Case {
    folder: Folder,
    name: &'static str,
    input: PathBuf,
    output: PathBuf,
}

impl Case {
    fn all() -> Result<Vec<Self>, Failed> {
        ["scene", "environment", "material"]
            .map(|name| {
                let folder = Folder::new()?;
                let input = match name {
                    "scene" => folder.at("a.obj"),
                    "environment" => folder.write("sky.hdr", grey_hdr(16, 8))?,
                    _ => folder.write("paint.toml", "model = 'diffuse'\ndiffuse = 0.5\n")?,
                };
                let output = folder.at("out.relight");
                Ok(Self {
                    folder,
                    name,
                    input,
                    output,
                })
            })
            .into_iter()
            .collect()
    }

    fn bake(&self) -> Command {
        match self.name {
            "scene" => bake_scene(&self.input, &self.output),
            "environment" => bake_environment(&self.input, &self.output, 2),
            _ => bake_material(&self.input, &self.output),
        }
    }

    /// The same under strace, which looks at calls that concern `paths`.
    fn traced(&self, paths: &[PathBuf], options: &[String]) -> Command {
        let bake = self.bake();
        let mut traced = Command::new("strace");
        traced
            .args(["-f", "-qq", "-o"])
            .arg(self.folder.at("trace"));
        traced.args(options);
        for path in paths {
            traced.arg("-P").arg(path);
        }
        traced.arg(bake.get_program()).args(bake.get_args());
        // Calls are then counted in one order.
        traced.args(["--threads", "1"]);
        traced.stdin(Stdio::null());
        traced
    }

    fn beside(&self, extension: &str) -> PathBuf {
        let mut path = OsString::from(&self.output);
        path.push(extension);
        path.into()
    }

    /// The output and what is written beside it.
    fn outputs(&self) -> [PathBuf; 3] {
        [
            self.output.clone(),
            self.beside(".partial"),
            self.beside(".parts"),
        ]
    }

    /// What one undisturbed run writes, and how often a thread calls what has faults, at most.
    fn expected(&self) -> Result<(Vec<u8>, BTreeMap<&'static str, usize>), Failed> {
        let calls = FAULTS.map(|(call, _)| call);
        let outputs = self.outputs();
        let options = ["-e".to_owned(), format!("trace={}", calls.join(","))];
        expect_success(&mut self.traced(&outputs, &options));
        let trace = std::fs::read_to_string(self.folder.at("trace"))?;
        // Strace counts by thread; a line begins with the thread's number.
        let count = |call: &'static str| {
            let mut by_thread = BTreeMap::new();
            for line in trace.lines() {
                let Some((thread, rest)) = line.split_once(' ') else {
                    continue;
                };
                if rest.trim_start().starts_with(&format!("{call}(")) {
                    *by_thread.entry(thread).or_default() += 1;
                }
            }
            (call, by_thread.into_values().max().unwrap_or(0))
        };
        Ok((std::fs::read(&self.output)?, calls.map(count).into()))
    }

    /// Whatever happened: the old or the new output, and the next run gives the new one and
    /// leaves nothing else.
    fn check(&self, expected: &[u8], what: &str) -> Result<(), Failed> {
        let found = std::fs::read(&self.output)?;
        if found != OLD && found != expected {
            return Err(format!("{what}: {} bytes of neither output", found.len()).into());
        }
        let mut again = self.bake();
        if self.beside(".parts").exists() {
            again.arg("--resume");
        }
        expect_success(&mut again);
        if std::fs::read(&self.output)? != expected {
            return Err(format!("{what}: other bytes afterwards").into());
        }
        for path in &self.outputs()[1..] {
            if path.exists() {
                return Err(format!("{what}: {} is left", path.display()).into());
            }
        }
        Ok(())
    }
}

/// Why nothing can be injected here.
fn unable() -> Option<&'static str> {
    let works = Command::new("strace")
        .args([
            "-f",
            "-qq",
            "-o",
            "/dev/null",
            "-e",
            "inject=mkdir:error=EIO:when=9",
            "true",
        ])
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .status();
    match works {
        Ok(status) if status.success() => None,
        Ok(_) => Some("strace may not trace"),
        Err(_) => Some("no strace"),
    }
}

macro_rules! need_strace {
    () => {
        if let Some(why) = unable() {
            return Ok(Completion::ignored_with(why));
        }
    };
}

fn of_outputs() -> Result<Completion, Failed> {
    need_strace!();
    let mut injected = 0;
    for case in Case::all()? {
        let (expected, counts) = case.expected()?;
        assert!(counts["write"] > 0 && counts["rename"] == 1, "{counts:?}");
        let outputs = case.outputs();
        for (call, errors) in FAULTS {
            for (when, error) in
                (1..=counts[call]).flat_map(|when| errors.iter().map(move |error| (when, error)))
            {
                let what = format!("{}: {error} of {call} {when}", case.name);
                std::fs::write(&case.output, OLD)?;
                let fault = format!("inject={call}:error={error}:when={when}");
                let output = case.traced(&outputs, &["-e".to_owned(), fault]).output()?;
                let partial = case.beside(".partial");
                match output.status.code() {
                    Some(OK) => {
                        assert!(std::fs::read(&case.output)? == expected, "{what}");
                    }
                    Some(INPUT_OUTPUT) => {
                        error_line(&output, &case.output);
                        assert!(!partial.exists(), "{what}: {} is left", partial.display());
                    }
                    _ => return Err(format!("{what}: {}", describe(&output)).into()),
                }
                case.check(&expected, &what)?;
                injected += 1;
            }
        }
    }
    assert!(injected > 60, "{injected} faults");
    Ok(Completion::Completed)
}

fn of_inputs() -> Result<Completion, Failed> {
    need_strace!();
    for case in Case::all()? {
        for fault in [
            "openat:error=EACCES",
            "openat:error=EIO",
            "read:error=EIO",
            "read:error=ESTALE",
        ] {
            let what = format!("{}: {fault}", case.name);
            std::fs::write(&case.output, OLD)?;
            let fault = ["-e".to_owned(), format!("inject={fault}:when=1")];
            let output = case
                .traced(std::slice::from_ref(&case.input), &fault)
                .output()?;
            assert_eq!(
                output.status.code(),
                Some(INPUT_OUTPUT),
                "{what}: {}",
                describe(&output)
            );
            error_line(&output, &case.input);
            assert_eq!(std::fs::read(&case.output)?, OLD, "{what}");
            for path in &case.outputs()[1..] {
                assert!(!path.exists(), "{what}: {} is left", path.display());
            }
        }
    }
    Ok(Completion::Completed)
}

fn killed_at_every_call() -> Result<Completion, Failed> {
    need_strace!();
    let mut kills = 0;
    for case in Case::all()? {
        let (expected, counts) = case.expected()?;
        let outputs = case.outputs();
        for (call, count) in counts {
            for when in 1..=count {
                let what = format!("{}: killed at {call} {when}", case.name);
                std::fs::write(&case.output, OLD)?;
                let fault = format!("inject={call}:signal=KILL:when={when}");
                let output = case.traced(&outputs, &["-e".to_owned(), fault]).output()?;
                assert!(!output.status.success(), "{what}: it lives");
                case.check(&expected, &what)?;
                kills += 1;
            }
        }
    }
    assert!(kills > 15, "{kills} kills");
    Ok(Completion::Completed)
}

/// The file grows between two reads.
fn changed_input() -> Result<Completion, Failed> {
    need_strace!();
    let case = Case::all()?.remove(0);
    std::fs::write(&case.output, OLD)?;
    let slowly = "inject=read:delay_exit=1500000:when=1";
    let child = case
        .traced(
            std::slice::from_ref(&case.input),
            &["-e".to_owned(), slowly.to_owned()],
        )
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()?;
    std::thread::sleep(Duration::from_millis(700));
    let mut mesh = std::fs::read(&case.input)?;
    mesh.extend(b"# and on it goes\n");
    std::fs::write(&case.input, mesh)?;
    let output = child.wait_with_output()?;
    assert_eq!(
        output.status.code(),
        Some(BAD_INPUT),
        "{}",
        describe(&output)
    );
    let line = error_line(&output, &case.input);
    assert!(line.contains("changed while it was read"), "{line}");
    assert_eq!(std::fs::read(&case.output)?, OLD);
    Ok(Completion::Completed)
}
