//! The pages: compiled, bound to JavaScript, and put together in `out/web`.

use std::net::TcpListener;
use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode};

use relight_xtask::server;
use wasm_bindgen_cli_support::Bindgen;

const TARGET: &str = "wasm32-unknown-unknown";
/// A page: the package whose library it runs, and its files that are taken as they are.
struct Page {
    package: &'static str,
    folder: &'static str,
    files: &'static [&'static str],
}

const PAGES: [Page; 2] = [
    Page {
        package: "relight-viewer",
        folder: "tools/viewer/web",
        files: &["index.html", "app.css", "app.js", "worker.js"],
    },
    Page {
        package: "relight-embed",
        folder: "tools/embed/web",
        files: &["embed.html", "embed.css", "embed.js"],
    },
];
/// Assets that `cargo demo` bakes, shown by the page where nothing else is asked for.
const ASSETS: [&str; 2] = ["demo.relight", "demo-environment.relight"];

/// What is wrong where pages cannot be compiled on this machine at all.
const NO_LIBRARY: &str = "no standard library for wasm32-unknown-unknown";

/// Builds the pages for the tests that open them.
pub fn for_tests(root: &Path) -> crate::Outcome {
    if std::env::var_os("RELIGHT_NO_BROWSER").is_some_and(|value| value == "1") {
        return crate::Outcome::Skipped("RELIGHT_NO_BROWSER=1".into());
    }
    match build(root) {
        Ok(_) => crate::Outcome::Passed,
        Err(message) if message.starts_with(NO_LIBRARY) => {
            // What was built before is of other sources.
            let _ = std::fs::remove_dir_all(root.join("out/web"));
            crate::Outcome::Skipped(format!("NO PAGE IS TESTED: {message}"))
        }
        Err(message) => crate::Outcome::Failed(message),
    }
}

/// Builds the pages into `out/web`, and serves it if that is asked for.
pub fn run(root: &Path, serve: bool) -> ExitCode {
    let built = demo(root).and_then(|()| build(root));
    match built.and_then(|folder| if serve { forever(&folder) } else { Ok(()) }) {
        Ok(()) => ExitCode::SUCCESS,
        Err(message) => {
            eprintln!("xtask: {message}");
            ExitCode::FAILURE
        }
    }
}

/// Bakes the demo, if that was not done before.
fn demo(root: &Path) -> Result<(), String> {
    let folder = root.join("out/demo");
    if ASSETS.iter().all(|name| folder.join(name).exists()) {
        return Ok(());
    }
    run_to_end(&mut crate::cargo(root, "demo"))
}

fn build(root: &Path) -> Result<PathBuf, String> {
    let folder = root.join("out/web");
    let failed = |what: &Path, error: std::io::Error| format!("{}: {error}", what.display());
    std::fs::create_dir_all(&folder).map_err(|error| failed(&folder, error))?;
    for page in &PAGES {
        let compiled = compile(root, page.package)?;
        // The JavaScript around it, which finds the module beside itself.
        (Bindgen::new().input_path(&compiled).typescript(false))
            .omit_default_module_path(false)
            .web(true)
            .and_then(|bindgen| bindgen.generate(&folder))
            .map_err(|error| format!("wasm-bindgen: {}: {error:#}", compiled.display()))?;
        for name in page.files {
            let (from, to) = (root.join(page.folder).join(name), folder.join(name));
            std::fs::copy(&from, &to).map_err(|error| failed(&from, error))?;
        }
        let name = format!("{}_bg.wasm", page.package.replace('-', "_"));
        let module = folder.join(&name);
        let bytes = std::fs::read(&module).map_err(|error| failed(&module, error))?;
        println!("xtask: {name}: {} kB", bytes.len() / 1000);
    }
    for name in ASSETS {
        // Without them the page asks for files.
        let _ = std::fs::copy(root.join("out/demo").join(name), folder.join(name));
    }
    println!("xtask: {}", folder.display());
    Ok(folder)
}

/// The library as a module of WebAssembly.
fn compile(root: &Path, package: &str) -> Result<PathBuf, String> {
    let output = |arguments: &[&str]| {
        let output = Command::new("rustc").args(arguments).output();
        let output = output.map_err(|error| format!("rustc: {error}"))?;
        Ok::<_, String>(String::from_utf8_lossy(&output.stdout).trim().to_owned())
    };
    let installed = output(&["--print", "target-libdir", "--target", TARGET])?;
    let mut from_source = false;
    let mut rustup = Command::new("rustup");
    if !Path::new(&installed).exists() && !crate::succeeds(rustup.args(["target", "add", TARGET])) {
        // Distributions ship the library's sources in a package of their own.
        let sources = Path::new(&output(&["--print", "sysroot"])?).join("lib/rustlib/src");
        if !sources.exists() {
            return Err(format!(
                "{NO_LIBRARY}: `rustup target add {TARGET}`, or install rust-src"
            ));
        }
        from_source = true;
    }
    let folder = std::env::var_os("CARGO_TARGET_DIR")
        .map_or_else(|| root.join("target"), |folder| root.join(folder))
        .join("web");
    let mut cargo = crate::cargo(root, "rustc --profile web --lib --crate-type cdylib");
    cargo
        .args(["--package", package, "--target", TARGET])
        .arg("--target-dir")
        .arg(&folder);
    if from_source {
        cargo
            .args(["-Z", "build-std=std,panic_abort"])
            .env("RUSTC_BOOTSTRAP", "1");
    }
    run_to_end(&mut cargo)?;
    let name = format!("{}.wasm", package.replace('-', "_"));
    Ok(folder.join(TARGET).join("web").join(name))
}

fn run_to_end(command: &mut Command) -> Result<(), String> {
    let name = command.get_program().to_string_lossy().into_owned();
    match command.status() {
        Ok(status) if status.success() => Ok(()),
        Ok(status) => Err(format!("{name}: {status}")),
        Err(error) => Err(format!("{name}: {error}")),
    }
}

/// Serves a folder on the loopback address, where browsers allow WebGPU without certificates.
fn forever(folder: &Path) -> Result<(), String> {
    let listener = TcpListener::bind("127.0.0.1:8080")
        .or_else(|_| TcpListener::bind("127.0.0.1:0"))
        .map_err(|error| error.to_string())?;
    let address = listener.local_addr().map_err(|error| error.to_string())?;
    println!("xtask: http://{address}/");
    for stream in listener.incoming().flatten() {
        let folder = folder.to_owned();
        // A browser that hangs up, or says nothing, is none of the others' business.
        std::thread::spawn(move || server::answer(stream, &[&folder]));
    }
    Ok(())
}
