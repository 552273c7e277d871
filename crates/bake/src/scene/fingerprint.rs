//! A number that tells inputs apart: FNV-1a of 128 bits (Fowler, Noll & Vo 1991).
//!
//! The same on every machine and with every compiler, as files that outlive the program
//! need. It guards against mistakes, not against forgery.

use relight_format as format;
use serde::Serialize;

use super::load::SceneInput;
use super::options::Options;

/// A fingerprint in the making.
#[derive(Clone, Copy, Debug)]
pub struct Fingerprint(u128);

impl Default for Fingerprint {
    fn default() -> Self {
        Self(0x6c62_272e_07bb_0142_62b8_2175_6295_c58d)
    }
}

impl Fingerprint {
    const PRIME: u128 = (1 << 88) + 0x13b;

    /// Adds bytes and their number, so that neighbouring fields cannot trade bytes.
    pub fn add(&mut self, bytes: &[u8]) {
        for byte in (bytes.len() as u64).to_le_bytes() {
            self.add_byte(byte);
        }
        for &byte in bytes {
            self.add_byte(byte);
        }
    }

    /// Adds a texture's layout and texels.
    pub fn add_texture(&mut self, texture: &format::Texture) {
        let (width, height, encoding) = (texture.width, texture.height, texture.encoding);
        self.add(&width.to_le_bytes());
        self.add(&height.to_le_bytes());
        self.add(&[encoding as u8]);
        self.add(&texture.texels);
    }

    fn add_byte(&mut self, byte: u8) {
        self.0 = (self.0 ^ u128::from(byte)).wrapping_mul(Self::PRIME);
    }

    /// The fingerprint of everything added.
    pub fn value(self) -> u128 {
        self.0
    }
}

/// Everything that an asset depends on, each with a name: the version, the options, parts of the
/// input.
pub(super) struct Dependencies {
    options: Vec<(String, String)>,
    parts: Vec<(&'static str, Fingerprint)>,
}

impl Dependencies {
    pub(super) fn new(input: &SceneInput, options: &Options) -> Self {
        let SceneInput {
            name,
            mesh,
            object_diagonal,
            camera,
            environment: _,
            lights: _,
            refinement,
            measured: _,
            warnings,
        } = input;
        let mut texts = vec![("version".to_owned(), env!("CARGO_PKG_VERSION").to_owned())];
        // Options are plain data: they always become an object. Text of a number tells all its
        // bits.
        if let Ok(serde_json::Value::Object(options)) = serde_json::to_value(options) {
            texts.extend(
                options
                    .into_iter()
                    .map(|(key, value)| (key, value.to_string())),
            );
        }
        let mut textures = Fingerprint::default();
        for texture in &mesh.textures {
            textures.add_texture(texture);
        }
        let mut geometry = Fingerprint::default();
        geometry.add(bytemuck::cast_slice(&mesh.vertices));
        for triangle in &mesh.triangles {
            geometry.add(bytemuck::cast_slice(&triangle.vertices));
            geometry.add(&triangle.material.to_le_bytes());
        }
        Self {
            options: texts,
            parts: vec![
                ("name of the scene", of(name)),
                ("camera", of(camera)),
                ("refinement of the scene file", of(refinement)),
                ("materials", of(&mesh.materials)),
                ("textures", textures),
                ("mesh", geometry),
                ("size without the ground", of(object_diagonal)),
                ("warnings", of(warnings)),
            ],
        }
    }

    /// A number that tells them apart.
    pub(super) fn fingerprint(&self) -> u128 {
        let mut all = Fingerprint::default();
        for (name, value) in &self.options {
            all.add(name.as_bytes());
            all.add(value.as_bytes());
        }
        for (name, part) in &self.parts {
            all.add(name.as_bytes());
            all.add(&part.value().to_le_bytes());
        }
        all.value()
    }

    /// For messages, a line of name and value of each: options as they are, parts of the input by
    /// eight digits of their fingerprints.
    pub(super) fn description(&self) -> String {
        let options = self.options.iter();
        let options = options.map(|(name, value)| format!("{name}: {value}\n"));
        let parts = self.parts.iter();
        let parts = parts.map(|(name, part)| format!("{name}: {:08x}\n", part.value() as u32));
        options.chain(parts).collect()
    }
}

/// Of plain data, as JSON.
fn of(value: &impl Serialize) -> Fingerprint {
    let mut fingerprint = Fingerprint::default();
    fingerprint.add(&serde_json::to_vec(value).unwrap_or_default());
    fingerprint
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bytes_hash_as_published() {
        let mut fingerprint = Fingerprint::default();
        for byte in *b"foobar" {
            fingerprint.add_byte(byte);
        }
        assert_eq!(
            fingerprint.value(),
            0x343e_1662_793c_64bf_6f0d_3597_ba44_6f18
        );
    }

    #[test]
    fn fields_do_not_trade_bytes() {
        let of = |fields: [&str; 2]| {
            let mut fingerprint = Fingerprint::default();
            for field in fields {
                fingerprint.add(field.as_bytes());
            }
            fingerprint.value()
        };
        assert_ne!(of(["ab", "c"]), of(["a", "bc"]));
    }
}
