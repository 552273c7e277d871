//! Dialogs that ask for files.

use std::path::PathBuf;

/// Takes the file that was chosen, or that none was.
pub type Answer = Box<dyn FnOnce(Option<PathBuf>) + Send>;

/// What a file that was chosen in a dialog is for.
#[derive(Clone, Debug)]
pub enum Purpose {
    /// To be opened.
    Open,
    /// For the picture, as PNG or OpenEXR by its ending.
    SavePicture,
    /// For the camera.
    SaveCamera,
    /// For a scene file.
    #[cfg(not(target_family = "wasm"))]
    SaveScene,
    /// For the baked scene.
    SaveAsset,
    /// A folder for a turntable.
    #[cfg(not(target_family = "wasm"))]
    SaveTurntable,
}

/// Asks for a file, for a purpose and a scene of this name; the answer may come at any time.
pub type Dialog = Box<dyn Fn(&Purpose, &str, Answer)>;

#[cfg(target_family = "wasm")]
pub use page::of_the_page;
#[cfg(not(target_family = "wasm"))]
pub use system::of_the_system;

#[cfg(target_family = "wasm")]
mod page {
    use super::{Dialog, Purpose};
    use crate::browser::Hooks;

    /// The page's: files to open come as its messages, those to save go where browsers put them.
    pub fn of_the_page(hooks: Hooks) -> Dialog {
        Box::new(move |purpose, name, answered| match purpose {
            Purpose::Open => hooks.choose(),
            Purpose::SavePicture => answered(Some(format!("{name}.png").into())),
            Purpose::SaveCamera => answered(Some(format!("{name}-camera.toml").into())),
            Purpose::SaveAsset => answered(Some(format!("{name}.relight").into())),
        })
    }
}

#[cfg(not(target_family = "wasm"))]
mod system {
    use std::pin::Pin;

    use super::{Answer, Purpose};
    use crate::jobs;

    /// A file that a dialog may bring.
    type Chosen = Pin<Box<dyn Future<Output = Option<rfd::FileHandle>> + Send>>;

    /// Asks in a window of its own; `name` is the scene's.
    pub fn of_the_system(purpose: &Purpose, name: &str, answered: Answer) {
        let dialog = rfd::AsyncFileDialog::new();
        let future: Chosen = match purpose {
            Purpose::Open => {
                let endings: Vec<&str> = (jobs::SCENE_ENDINGS.iter())
                    .chain(&jobs::LIGHT_ENDINGS)
                    .chain(&jobs::MATERIAL_ENDINGS)
                    .copied()
                    .collect();
                let dialog = dialog.add_filter("scenes, images, materials", &endings);
                Box::pin(dialog.pick_file())
            }
            Purpose::SavePicture => {
                let dialog = dialog.add_filter("PNG or OpenEXR", &["png", "exr"]);
                Box::pin(dialog.set_file_name(format!("{name}.png")).save_file())
            }
            Purpose::SaveCamera => {
                let dialog = dialog.set_file_name(format!("{name}-camera.toml"));
                Box::pin(dialog.save_file())
            }
            Purpose::SaveScene => {
                Box::pin(dialog.set_file_name(format!("{name}.toml")).save_file())
            }
            Purpose::SaveAsset => {
                Box::pin(dialog.set_file_name(format!("{name}.relight")).save_file())
            }
            Purpose::SaveTurntable => Box::pin(dialog.pick_folder()),
        };
        // Detached: a dialog that is never answered must not keep the application alive.
        std::thread::spawn(move || {
            let file = pollster::block_on(future);
            answered(file.map(|file| file.path().to_owned()));
        });
    }
}
