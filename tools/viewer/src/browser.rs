//! What the page does for the application, and what the browser keeps for it.

use wasm_bindgen::prelude::wasm_bindgen;

#[wasm_bindgen]
extern "C" {
    /// What the page does for the application.
    #[derive(Clone)]
    pub type Hooks;

    /// Fits a file, as job `number`, in a worker: of `kind` light or material.
    #[wasm_bindgen(method)]
    pub fn fit(this: &Hooks, number: u32, kind: &str, name: &str, bytes: Vec<u8>, lobes: u32);

    /// Ends a job; nothing is told of it afterwards.
    #[wasm_bindgen(method)]
    pub fn cancel(this: &Hooks, number: u32);

    /// Offers a file for download.
    #[wasm_bindgen(method)]
    pub fn save(this: &Hooks, name: &str, bytes: &[u8]);

    /// Lets somebody choose files to open.
    #[wasm_bindgen(method)]
    pub fn choose(this: &Hooks);

    /// Tells an error in the browser's console.
    #[wasm_bindgen(js_namespace = console, js_name = error)]
    pub fn console_error(text: &str);
}

fn storage() -> Option<web_sys::Storage> {
    web_sys::window()?.local_storage().ok()?
}

/// What the browser keeps under a name.
pub fn stored(key: &str) -> Option<String> {
    storage()?.get_item(key).ok()?
}

/// Has the browser keep it, if it may.
pub fn store(key: &str, text: &str) {
    if let Some(storage) = storage() {
        // Full, or forbidden: settings are not worth a message.
        let _ = storage.set_item(key, text);
    }
}
