//! Repository tasks: `cargo xtask test` installs what the tests need and runs them all,
//! `cargo xtask results` makes the tables of RESULTS.md, `cargo xtask figures` the pictures of README.md, `cargo xtask web` the pages.

mod figures;
mod results;
mod web;

use std::cell::Cell;
use std::io::{BufRead, BufReader, Write};
use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode, Stdio};
use std::thread::ScopedJoinHandle;
use std::time::Instant;

const USAGE: &str = "usage: cargo xtask test | results | figures | web [--serve] | gpu-cost [KERNEL...]

test: installs what the tests need (apt, only what is missing), then checks formatting and lints, builds
the pages if there is a standard library for them, runs every test, and checks dependencies by cargo-deny, which it installs into target/tools.

results: replaces all tables of RESULTS.md by those of the commit that is checked out. Runs every experiment on the
processor into out/results, which takes about an hour on two cores and needs the test data; then the compilers of
gpu-cost, and the comparison with Embree (tools/peers). What cannot be made here is left out, in a sentence that says so.

figures: makes the pictures of README.md anew, which takes minutes and needs the test data, and a screen or xvfb-run.

web: builds the viewer as a page, and a small one, into out/web, adding what that takes where it is missing
(the target wasm32-unknown-unknown). --serve then serves it on the loopback address.

gpu-cost: what compilers of an AMD and an NVIDIA GPU make of every kernel, on a machine without
either: registers, waves, memory, code. Makes the root that they live in (Linux, as root, a minute, a
gigabyte); the tests that hold kernels to their bounds are skipped without it.

environment:
  GPU_COST_ROOT=FOLDER  that root; default ~/.cache/gpu_cost
  RELIGHT_DATA=FOLDER   test data; default ../shared/data beside the checkout
  RELIGHT_NO_GPU=1      skip the tests that need a Vulkan adapter; without it they fail
                        where there is none
  RELIGHT_NO_BROWSER=1  skip the tests that need Chromium, likewise
  RELIGHT_NO_DISPLAY=1  skip the test that needs Xvfb, likewise";

/// All packages but this one: with them its crates have other features than they were compiled with for
/// `cargo xtask`, and would be compiled again.
const OTHERS: &str = "--release --workspace --exclude relight-xtask";

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    match arguments.iter().map(String::as_str).collect::<Vec<_>>()[..] {
        ["test"] => test(),
        ["results"] => results::run(&root()),
        ["figures"] => figures::run(&root()),
        ["web"] => web::run(&root(), false),
        ["web", "--serve"] => web::run(&root(), true),
        ["gpu-cost", ..] => gpu_cost(&arguments[1..]),
        ["--help" | "-h" | "help"] => {
            println!("{USAGE}");
            ExitCode::SUCCESS
        }
        _ => {
            eprintln!("{USAGE}");
            ExitCode::from(2)
        }
    }
}

/// How one step of a task ended.
enum Outcome {
    Passed,
    Failed(String),
    Skipped(String),
}

impl Outcome {
    fn of(command: &mut Command) -> Self {
        match command.status() {
            Ok(status) if status.success() => Self::Passed,
            Ok(status) => Self::Failed(status.to_string()),
            Err(error) => Self::Failed(error.to_string()),
        }
    }
}

fn root() -> PathBuf {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    root.canonicalize().unwrap_or(root)
}

fn test() -> ExitCode {
    let root = root();
    let data = match data_folder(&root) {
        Ok(data) => data,
        Err(message) => {
            eprintln!("xtask: {message}");
            return ExitCode::FAILURE;
        }
    };
    let cargo = |arguments: &str| {
        let mut command = cargo(&root, arguments);
        command.env("XDG_RUNTIME_DIR", runtime_folder(&root));
        if let Some(data) = &data {
            command.env("RELIGHT_DATA", data);
        }
        command
    };
    match &data {
        Some(folder) => println!("xtask: test data in {}", folder.display()),
        None => println!("xtask: no test data; tests on real input are skipped"),
    }
    let mut counts = Counts::default();
    let summary = std::thread::scope(|scope| {
        // Pages have a folder of their own, and are compiled while other steps leave the processor idle.
        let pages = Cell::new(None);
        run_steps(&mut [
            ("install", &mut || {
                let outcome = install(&root);
                pages.set(Some(scope.spawn(|| web::for_tests(&root))));
                outcome
            }),
            ("format", &mut || {
                Outcome::of(&mut cargo("fmt --all --check"))
            }),
            ("lints", &mut || {
                let arguments = "clippy --release --workspace --all-targets -- -D warnings";
                Outcome::of(&mut cargo(arguments))
            }),
            ("documentation", &mut || {
                let mut doc = cargo("doc --release --workspace --no-deps");
                Outcome::of(doc.env("RUSTDOCFLAGS", "-D warnings"))
            }),
            ("build", &mut || {
                Outcome::of(&mut cargo(&format!("test {OTHERS} --no-run --quiet")))
            }),
            (
                "pages",
                &mut || match pages.take().map(ScopedJoinHandle::join) {
                    Some(Ok(outcome)) => outcome,
                    _ => Outcome::Failed("a thread panicked".to_owned()),
                },
            ),
            ("tests", &mut || {
                std::thread::scope(|scope| {
                    // For the next step, as tests leave the processor idle at times.
                    scope.spawn(|| install_deny(&root));
                    tests(&cargo, &mut counts)
                })
            }),
            ("dependencies", &mut || dependencies(&root)),
        ])
    });
    println!();
    for skipped in &counts.skipped_tests {
        println!("skipped: {skipped}");
    }
    for (line, _) in &summary {
        println!("{line}");
    }
    println!(
        "total: {} passed, {} failed, {} skipped",
        counts.passed, counts.failed, counts.skipped
    );
    if summary.iter().all(|(_, passed)| *passed) {
        ExitCode::SUCCESS
    } else {
        ExitCode::FAILURE
    }
}

/// Runs steps one after the other, and says of each how it ended, and whether well.
fn run_steps(steps: &mut [(&str, &mut dyn FnMut() -> Outcome)]) -> Vec<(String, bool)> {
    let mut run = |(name, step): &mut (&str, &mut dyn FnMut() -> Outcome)| {
        println!("xtask: {name}");
        let start = Instant::now();
        let outcome = step();
        let seconds = start.elapsed().as_secs_f32();
        match outcome {
            Outcome::Passed => (format!("{name:<13} passed in {seconds:.1} s"), true),
            Outcome::Skipped(why) => (format!("{name:<13} skipped: {why}"), true),
            Outcome::Failed(why) => (format!("{name:<13} FAILED: {why}"), false),
        }
    };
    steps.iter_mut().map(&mut run).collect()
}

/// Builds all programs together, which compiles what they share once.
fn build_programs(root: &Path) -> Result<(), String> {
    let mut build = cargo(root, &format!("build {OTHERS} --bins"));
    match Outcome::of(&mut build) {
        Outcome::Failed(why) => Err(format!("cargo build: {why}")),
        Outcome::Passed | Outcome::Skipped(_) => Ok(()),
    }
}

/// One of them, which lie where this one does.
fn program(root: &Path, name: &str, arguments: &str) -> Command {
    let own = std::env::current_exe().unwrap_or_default();
    let mut command = Command::new(own.with_file_name(name));
    command
        .args(arguments.split(' ').filter(|word| !word.is_empty()))
        .current_dir(root)
        .stdin(Stdio::null());
    command
}

/// The program of tools/gpu_cost.
fn gpu_cost(arguments: &[String]) -> ExitCode {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let run = "run --release --quiet --package relight-gpu-cost --bin gpu-cost --";
    match cargo(&root, run).args(arguments).status() {
        Ok(status) if status.success() => ExitCode::SUCCESS,
        _ => ExitCode::FAILURE,
    }
}

fn cargo(root: &Path, arguments: &str) -> Command {
    let mut command = Command::new(std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into()));
    command
        .args(arguments.split(' '))
        .current_dir(root)
        .stdin(Stdio::null());
    command
}

/// `RELIGHT_DATA`, which must then exist, or `../shared/data` if that does.
fn data_folder(root: &Path) -> Result<Option<PathBuf>, String> {
    match std::env::var_os("RELIGHT_DATA") {
        Some(folder) => match Path::new(&folder).canonicalize() {
            Ok(folder) if folder.is_dir() => Ok(Some(folder)),
            _ => Err(format!(
                "RELIGHT_DATA is {}, which is no folder",
                folder.display()
            )),
        },
        None => Ok(root
            .join("../shared/data")
            .canonicalize()
            .ok()
            .filter(|path| path.is_dir())),
    }
}

/// Mesa prints a line to stderr where `XDG_RUNTIME_DIR` is unset; any folder will do.
fn runtime_folder(root: &Path) -> PathBuf {
    std::env::var_os("XDG_RUNTIME_DIR").map_or_else(
        || {
            let folder = root.join("target/xdg-runtime");
            // Should this fail, the line on stderr is all that is lost.
            let _ = std::fs::create_dir_all(&folder);
            folder
        },
        PathBuf::from,
    )
}

/// Installs missing parts of the toolchain and missing system packages.
fn install(root: &Path) -> Outcome {
    if !["fmt --version", "clippy --version"]
        .iter()
        .all(|check| succeeds(&mut cargo(root, check)))
        && !succeeds(Command::new("rustup").args(["component", "add", "rustfmt", "clippy"]))
    {
        return Outcome::Failed(
            "rustfmt or clippy is missing, and rustup cannot add it".to_owned(),
        );
    }
    let mut packages = Vec::new();
    if !succeeds(Command::new("c++").arg("--version")) {
        packages.push("g++");
    }
    let no_gpu = std::env::var_os("RELIGHT_NO_GPU").is_some_and(|value| value == "1");
    if !no_gpu && !has_vulkan() {
        packages.extend(["mesa-vulkan-drivers", "libvulkan1"]);
    }
    let no_browser = std::env::var_os("RELIGHT_NO_BROWSER").is_some_and(|value| value == "1");
    let browsers = ["chromium", "chromium-browser", "google-chrome"];
    if !no_browser && !(browsers.iter()).any(|name| succeeds(Command::new(name).arg("--version"))) {
        packages.push("chromium");
    }
    let no_display = std::env::var_os("RELIGHT_NO_DISPLAY").is_some_and(|value| value == "1");
    if !no_display && !succeeds(Command::new("Xvfb").arg("-help")) {
        packages.push("xvfb");
        // What a window loads when it opens.
        packages.extend([
            "libxkbcommon-x11-0",
            "libxcursor1",
            "libxi6",
            "libxrandr2",
            "libx11-xcb1",
        ]);
    }
    let imports =
        |name: &&str| succeeds(Command::new(*name).args(["-c", "import numpy, zstandard"]));
    if !["python3", "/usr/bin/python3"].iter().any(imports) {
        packages.extend(["python3-numpy", "python3-zstandard"]);
    }
    if packages.is_empty() {
        return Outcome::Passed;
    }
    let Some(mut apt_get) = apt_get() else {
        return Outcome::Failed(format!(
            "install {} (or what your system calls them), or run as root where apt is",
            packages.join(" ")
        ));
    };
    println!("xtask: installing {}", packages.join(" "));
    let mut apt = |arguments: &[&str]| {
        apt_get()
            .args(arguments)
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .status()
    };
    let _ = apt(&["update", "-qq"]);
    let arguments = ["install", "-qq", "-y", "--no-install-recommends"];
    match apt(&[&arguments[..], &packages].concat()) {
        Ok(status) if status.success() => Outcome::Passed,
        _ => Outcome::Failed(format!("apt-get cannot install {}", packages.join(" "))),
    }
}

/// Starts `apt-get` commands with the rights to install, if there are any.
fn apt_get() -> Option<impl FnMut() -> Command> {
    let root = Command::new("id")
        .arg("-u")
        .output()
        .is_ok_and(|id| id.stdout == b"0\n");
    let prefix: &[&str] = if root { &[] } else { &["sudo", "-n"] };
    let command = move || {
        let words = [
            prefix,
            &["env", "DEBIAN_FRONTEND=noninteractive", "apt-get"],
        ]
        .concat();
        let mut command = Command::new(words[0]);
        command.args(&words[1..]).stdin(Stdio::null());
        command
    };
    succeeds(command().arg("--version")).then_some(command)
}

/// Whether a Vulkan loader and a driver for it are installed. Other systems than Linux
/// have neither or bring their own: there the tests find out.
fn has_vulkan() -> bool {
    if !cfg!(target_os = "linux") {
        return true;
    }
    let entries = |folder: &str| {
        let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
        entries.map(|entry| entry.path()).collect::<Vec<_>>()
    };
    let libraries = ["/usr/lib", "/usr/lib64", "/usr/local/lib", "/lib"]
        .map(entries)
        .concat();
    let loader = libraries.iter().any(|path| {
        path.file_name()
            .is_some_and(|name| name == "libvulkan.so.1")
            || path.join("libvulkan.so.1").exists()
    });
    let named = ["VK_DRIVER_FILES", "VK_ICD_FILENAMES"];
    let folders = ["/usr/share", "/usr/local/share", "/etc"];
    let driver = named.iter().any(|name| std::env::var_os(name).is_some())
        || folders
            .iter()
            .any(|folder| !entries(&format!("{folder}/vulkan/icd.d")).is_empty());
    loader && driver
}

fn succeeds(command: &mut Command) -> bool {
    let quiet = command
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::null());
    quiet.status().is_ok_and(|status| status.success())
}

/// What test binaries reported, all together.
#[derive(Default)]
struct Counts {
    passed: u64,
    failed: u64,
    skipped: u64,
    skipped_tests: Vec<String>,
}

impl Counts {
    /// Reads one line of a test binary's report.
    fn read(&mut self, line: &str) {
        if let Some(test) = line.strip_prefix("test ")
            && let Some((name, why)) = test.split_once(" ... ignored")
        {
            self.skipped_tests.push(format!("{}{why}", name.trim_end()));
        }
        let Some(result) = line.strip_prefix("test result: ") else {
            return;
        };
        let count = |label: &str| -> u64 {
            let before = result
                .split_once(label)
                .map_or("", |(before, _)| before.trim_end());
            before
                .rsplit(' ')
                .next()
                .and_then(|number| number.parse().ok())
                .unwrap_or(0)
        };
        self.passed += count(" passed");
        self.failed += count(" failed");
        self.skipped += count(" ignored");
    }
}

/// Runs all tests. Software, which draws what those of the GPU ask for, does most of it by one thread: others run beside them.
fn tests(cargo: &dyn Fn(&str) -> Command, counts: &mut Counts) -> Outcome {
    // A target is in one of the two, whatever it is called.
    let gpu = format!("test {OTHERS} --no-fail-fast --test g*");
    let beside = format!("test {OTHERS} --no-fail-fast --lib --bins --test [!g]*");
    let documentation = format!("test {OTHERS} --no-fail-fast --doc");
    let own = "test --release --package relight-xtask --no-fail-fast";
    let mut gpu = cargo(&gpu);
    let outcomes = std::thread::scope(|scope| {
        let gpu = scope.spawn(move || {
            let mut report: Vec<String> = Vec::new();
            let outcome = run_tests(&mut gpu, &mut |line| report.push(line.to_owned()));
            (report, outcome)
        });
        let mut show = |line: &str| {
            counts.read(line);
            // Nobody may be listening any more; the exit status still counts.
            let _ = writeln!(std::io::stdout(), "{line}");
        };
        let mut run = |tests| run_tests(&mut cargo(tests), &mut show);
        let [beside, documentation, own] = [&beside, &documentation, own].map(&mut run);
        let failed = |_| (Vec::new(), Outcome::Failed("a thread panicked".to_owned()));
        let (report, gpu) = gpu.join().unwrap_or_else(failed);
        for line in &report {
            show(line);
        }
        [gpu, beside, documentation, own]
    });
    let failed = |outcome: &Outcome| matches!(outcome, Outcome::Failed(_));
    let worst = outcomes.into_iter().find(failed);
    worst.unwrap_or_else(|| match counts.passed {
        0 => Outcome::Failed("no test ran".to_owned()),
        _ => Outcome::Passed,
    })
}

/// Runs `cargo test`, and hands on each line of its report.
fn run_tests(command: &mut Command, read: &mut dyn FnMut(&str)) -> Outcome {
    let mut child = match command.stdout(Stdio::piped()).spawn() {
        Ok(child) => child,
        Err(error) => return Outcome::Failed(error.to_string()),
    };
    if let Some(report) = child.stdout.take() {
        for line in BufReader::new(report).split(b'\n').map_while(Result::ok) {
            read(&String::from_utf8_lossy(&line));
        }
    }
    match child.wait() {
        Ok(status) if !status.success() => Outcome::Failed(status.to_string()),
        Ok(_) => Outcome::Passed,
        Err(error) => Outcome::Failed(error.to_string()),
    }
}

/// `cargo deny`, which may be one of our own.
fn deny(root: &Path, arguments: &str) -> Command {
    let own = root.join(DENY).join("bin/cargo-deny");
    let mut command = if own.exists() {
        let mut command = Command::new(&own);
        command.current_dir(root).stdin(Stdio::null());
        command
    } else {
        cargo(root, "deny")
    };
    command.args(arguments.split(' '));
    command
}

/// Where our own is.
const DENY: &str = "target/tools";

/// Builds `cargo deny` if it is missing, without optimisation: it runs for seconds. False if that fails.
fn install_deny(root: &Path) -> bool {
    let tools = root.join(DENY);
    if succeeds(&mut deny(root, "--version")) {
        return true;
    }
    println!("xtask: installing cargo-deny");
    let mut install = cargo(root, "install --quiet --locked --debug cargo-deny --root");
    let install = install.arg(&tools).env("CARGO_PROFILE_DEV_DEBUG", "0");
    let installed = succeeds(install.env("CARGO_TARGET_DIR", tools.join("target")));
    // Half a gigabyte that nobody needs again.
    let _ = std::fs::remove_dir_all(tools.join("target"));
    installed
}

/// Checks dependencies, without the advisories where their database cannot be had.
fn dependencies(root: &Path) -> Outcome {
    if !install_deny(root) {
        let why = "no cargo-deny, and cargo cannot install it";
        return Outcome::Skipped(why.to_owned());
    }
    match Outcome::of(&mut deny(root, "check bans licenses sources")) {
        Outcome::Passed if succeeds(&mut deny(root, "fetch db")) => {
            Outcome::of(&mut deny(root, "check advisories"))
        }
        Outcome::Passed => {
            Outcome::Skipped("advisories, for want of their database; the rest passed".to_owned())
        }
        failed => failed,
    }
}

#[cfg(test)]
mod tests {
    use super::Counts;

    #[test]
    fn counts_add_up_over_binaries() {
        let mut counts = Counts::default();
        for line in [
            "running 3 tests",
            "test gpu::frame ... ok",
            "test cli::real_meshes    ... ignored (no test data)",
            "test ssdf::slow ... ignored, minutes",
            "test result: ok. 12 passed; 0 failed; 2 ignored; 0 measured; 0 filtered out",
            "test result: FAILED. 3 passed; 1 failed; 0 ignored; 0 measured; 0 filtered out",
        ] {
            counts.read(line);
        }
        assert_eq!((counts.passed, counts.failed, counts.skipped), (15, 1, 2));
        let expected = ["cli::real_meshes (no test data)", "ssdf::slow, minutes"];
        assert_eq!(counts.skipped_tests, expected);
    }
}
