//! The `bake` command: meshes and HDR environments into `.relight` assets.

mod cli;

fn main() -> std::process::ExitCode {
    cli::run()
}
