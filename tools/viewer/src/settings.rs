//! Settings from one start to the next.

use std::path::PathBuf;

use crate::state::Settings;

/// Where they are kept; `None` where the system names no such folder.
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
pub fn read() -> Settings {
    file()
        .and_then(|file| std::fs::read_to_string(file).ok())
        .and_then(|text| serde_json::from_str(&text).ok())
        .unwrap_or_default()
}

/// Keeps them. What cannot be written is not worth a message.
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
