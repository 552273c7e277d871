//! Settings from one start to the next.

#[cfg(not(target_family = "wasm"))]
use std::path::PathBuf;

use crate::state::Settings;

/// Where they are kept; `None` where the system names no such folder.
#[cfg(not(target_family = "wasm"))]
fn file() -> Option<PathBuf> {
    let set = |name: &str| std::env::var_os(name).filter(|value| !value.is_empty());
    let folder = if cfg!(windows) {
        PathBuf::from(set("APPDATA")?)
    } else {
        set("XDG_CONFIG_HOME")
            .map(PathBuf::from)
            .or_else(|| Some(PathBuf::from(set("HOME")?).join(".config")))?
    };
    Some(folder.join("relight").join("viewer.json"))
}

/// Those of the last time, or the default ones where they cannot be read.
#[cfg(not(target_family = "wasm"))]
pub fn read() -> Settings {
    file()
        .and_then(|file| std::fs::read_to_string(file).ok())
        .and_then(|text| serde_json::from_str(&text).ok())
        .unwrap_or_default()
}

/// Keeps them. What cannot be written is not worth a message.
#[cfg(not(target_family = "wasm"))]
pub fn write(settings: &Settings) {
    let Some(file) = file() else { return };
    let Ok(text) = serde_json::to_string_pretty(settings) else {
        return;
    };
    if file
        .parent()
        .is_some_and(|folder| std::fs::create_dir_all(folder).is_ok())
    {
        let _ = relight_format::write_file(&file, text.as_bytes());
    }
}

/// Under which name a browser keeps them.
#[cfg(target_family = "wasm")]
const KEY: &str = "relight.viewer";

/// Those of the last visit, or the default ones where they cannot be read.
#[cfg(target_family = "wasm")]
pub fn read() -> Settings {
    crate::browser::stored(KEY)
        .and_then(|text| serde_json::from_str(&text).ok())
        .unwrap_or_default()
}

/// Keeps them. What cannot be kept is not worth a message.
#[cfg(target_family = "wasm")]
pub fn write(settings: &Settings) {
    if let Ok(text) = serde_json::to_string(settings) {
        crate::browser::store(KEY, &text);
    }
}
