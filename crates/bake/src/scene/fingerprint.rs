//! A number that tells inputs apart: FNV-1a of 128 bits (Fowler, Noll & Vo 1991).
//!
//! The same on every machine and with every compiler, as files that outlive the program
//! need. It guards against mistakes, not against forgery.

use relight_format as format;

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
        self.add(format!("{width} {height} {encoding:?}").as_bytes());
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
