//! The API of this crate is as `public-api.txt` has it.

#[path = "../../../tests/public_api.rs"]
mod public_api;

#[test]
fn the_public_api_is_as_written() {
    let here = std::path::Path::new(env!("CARGO_MANIFEST_DIR"));
    public_api::check(here, &["src/command", "src/main.rs"]);
}
