//! What the passes that shade hand on to one another: the layout of their buffers, see `slots.wgsl`.
//!
//! A frame is shaded in passes, each of which needs few registers: one knows materials and makes a
//! reflection's lobes, one makes a single lobe of every light and a reflection, one integrates
//! lobes over what is visible. An invocation has a slot in two buffers for what it hands on.

use std::mem::offset_of;

use crate::gpu::{Layer, Material, TextureSlot};

/// Lights of a round, and lobes of a pixel that wait to be integrated, at most: what is gathered in a round
/// is known in the next. All pixels take the same lights in the same round.
pub const WAITING: u32 = 6;
/// In place of the next light where none is left: as many as 22 bits tell apart.
const DONE: u32 = 0x3f_ffff;
/// Bytes of a field.
const FIELD_BYTES: u32 = 16;
/// Fields of a slot in either buffer.
const FIELDS: u32 = 16;
/// What comes before the amplitudes of a reflection's lobes, and before the rest of them.
const GREYS: u32 = 7;
const LOBES: u32 = 9;
/// What comes before the lobes that wait.
const FIRST: u32 = 4;
/// Bytes of a slot in either buffer.
pub const BYTES: u32 = FIELDS * FIELD_BYTES;

/// Rounds that so many lights take at most.
pub fn rounds(lights: usize) -> usize {
    lights.div_ceil(WAITING as usize)
}

/// The constants of this module, as WGSL.
pub fn wgsl_constants() -> String {
    let integers = [
        // Of the reflection.
        ("NORMAL", 0),
        ("TANGENT", 1),
        ("VIEW", 2),
        ("SPECULAR", 3),
        ("GRAZING", 4),
        ("COLOR", 5),
        ("POSITION", 6),
        ("GREYS", GREYS),
        ("LOBES", LOBES),
        // Of what is gathered. The Lambertian base and its irradiance are where lobes wait later.
        // SCALED is beside a field of the reflection that lobes are not made of: compilers keep places that both
        // have in registers.
        ("SUM", 0),
        ("SCALED", 1),
        ("BESIDE", 2),
        ("VISIBLE", 3),
        ("DIFFUSE", FIRST),
        ("IRRADIANCE", FIRST + 1),
        ("FIRST", FIRST),
        ("FIELDS", FIELDS),
        ("WAITING", WAITING),
        // No light is left.
        ("DONE", DONE),
    ];
    let integers = integers.map(|(name, value)| format!("const SLOTS_{name}: u32 = {value}u;\n"));
    integers.concat() + "const SLOTS_UNKNOWN: f32 = -1.0;\n" + &texture_constants()
}

/// Textures of a material beside those of its layers that are seen before its reflections.
const OWN_TEXTURES: u32 = 4;

/// Where textures are in materials, word by word.
fn texture_constants() -> String {
    let words = |bytes: usize| bytes / size_of::<u32>();
    let constants = [
        ("SURFACE_OWN_TEXTURES", OWN_TEXTURES as usize),
        ("SEEN_TEXTURES_MATERIAL", words(size_of::<Material>())),
        (
            "SEEN_TEXTURES_TEXTURED",
            words(offset_of!(Material, textured)),
        ),
        (
            "SEEN_TEXTURES_LAYER_COUNT",
            words(offset_of!(Material, layer_count)),
        ),
        (
            "SEEN_TEXTURES_OWN",
            words(offset_of!(Material, base_color_texture)),
        ),
        (
            "SEEN_TEXTURES_LAYERS",
            words(offset_of!(Material, layers) + offset_of!(Layer, diffuse_texture)),
        ),
        ("SEEN_TEXTURES_LAYER", words(size_of::<Layer>())),
        ("SEEN_TEXTURES_SLOT", words(size_of::<TextureSlot>())),
    ];
    constants
        .map(|(name, value)| format!("const {name}: u32 = {value}u;\n"))
        .concat()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::brdf::MAX_SPECULAR_LOBES;
    use crate::surface::MAX_REFLECTIONS;

    #[test]
    fn slots_have_room_for_what_waits() {
        // Six bits of a word tell which do.
        const { assert!(WAITING <= 6) };
        let lobes = MAX_SPECULAR_LOBES as u32;
        assert!(GREYS + lobes.div_ceil(4) <= LOBES && LOBES + lobes <= FIELDS);
        const { assert!(FIRST + 2 * WAITING <= FIELDS) };
        assert_eq!([rounds(0), rounds(6), rounds(7)], [0, 1, 2]);
    }

    #[test]
    fn slots_have_room_for_what_is_seen_of_textures() {
        const { assert!(FIRST + OWN_TEXTURES + 3 * MAX_REFLECTIONS as u32 <= 2 * FIELDS) };
        // One after the other, as the kernel takes them.
        let own = [
            offset_of!(Material, base_color_texture),
            offset_of!(Material, metallic_roughness_texture),
            offset_of!(Material, normal_texture),
            offset_of!(Material, anisotropy_texture),
        ];
        let layer = [
            offset_of!(Layer, diffuse_texture),
            offset_of!(Layer, specular_texture),
            offset_of!(Layer, roughness_texture),
            offset_of!(Layer, weight_texture),
        ];
        for offsets in [own, layer] {
            for pair in offsets.windows(2) {
                assert_eq!(pair[1] - pair[0], size_of::<TextureSlot>());
            }
        }
    }
}
