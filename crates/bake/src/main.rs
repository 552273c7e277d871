//! The `bake` command: meshes and HDR environments into `.relight` assets.

mod cli;
mod scene_command;

fn main() -> std::process::ExitCode {
    cli::run()
}
