//! Files made to mislead a reader: none may panic it, allocate what it does not hold, or
//! pass for an asset.

use relight_format::{Error, Issue, Limits, inspect, read_environment, read_scene, write_scene};

use crate::container::{ENTRY_LENGTH, File, HEADER_LENGTH, Section};
use crate::generate::{Random, environment, full_scene, scene};

const METADATA: usize = 0;
const VERTICES: usize = 1;
const TEXELS: usize = 6;
const TRANSFER: usize = 7;

fn full() -> File {
    File::parse(&write_scene(&full_scene()).unwrap())
}

fn issue(bytes: &[u8]) -> Issue {
    issue_within(bytes, &Limits::default())
}

fn issue_within(bytes: &[u8], limits: &Limits) -> Issue {
    match read_scene(bytes, limits) {
        Ok(_) => panic!("the file was accepted"),
        Err(error) => error.issue().expect("no file was opened"),
    }
}

#[test]
fn every_prefix_is_truncated() {
    let bytes = full().bytes();
    for length in 0..bytes.len() {
        assert_eq!(
            issue(&bytes[..length]),
            Issue::Truncated,
            "{length} of {} bytes",
            bytes.len()
        );
    }
}

/// The checksums cover the stored bytes and the rules the rest, so no flip at all passes.
#[test]
fn every_changed_byte_is_noticed() {
    let mut bytes = full().bytes();
    for at in 0..bytes.len() {
        for mask in [0x01, 0x02, 0x03, 0x10, 0x80, 0xff] {
            bytes[at] ^= mask;
            let found = read_scene(&bytes, &Limits::default());
            assert!(
                found.is_err(),
                "byte {at} of {} changed by {mask:#04x}",
                bytes.len()
            );
            bytes[at] ^= mask;
        }
    }
}

/// Changes under a correct checksum reach the validators. What they let through is a
/// valid asset: it can be written and read again.
#[test]
fn changed_content_is_rejected_or_valid() {
    let (mut accepted, mut rejected) = (0, 0);
    for seed in [2, 5, 17] {
        let file = File::parse(&write_scene(&scene(&mut Random::new(seed))).unwrap());
        let mut random = Random::new(seed);
        for index in 0..file.sections.len() {
            for _ in 0..400 {
                let bytes = file.with_raw(index, |raw| {
                    if raw.is_empty() {
                        return;
                    }
                    let at = random.below(raw.len());
                    match random.below(4) {
                        0 => raw.truncate(at),
                        1 => raw.insert(at, random.bits() as u8),
                        2 => raw[at] = [0, 1, 0x7f, 0x80, 0xff][random.below(5)],
                        _ => raw[at] = random.bits() as u8,
                    }
                });
                match read_scene(&bytes, &Limits::default()) {
                    Ok(changed) => {
                        accepted += 1;
                        let again = write_scene(&changed).expect("what was read is valid");
                        assert_eq!(read_scene(&again, &Limits::default()).unwrap(), changed);
                    }
                    Err(error) => {
                        rejected += 1;
                        assert!(error.issue().is_some());
                    }
                }
            }
        }
    }
    assert!(
        accepted > 100 && rejected > 100,
        "{accepted} accepted, {rejected} rejected"
    );
}

#[test]
fn changed_environments_are_rejected_or_valid() {
    for seed in 0..10 {
        let bytes = relight_format::write_environment(&environment(&mut Random::new(seed)));
        let file = File::parse(&bytes.unwrap());
        let mut random = Random::new(seed);
        for _ in 0..400 {
            let bytes = file.with_raw(random.below(5), |raw| {
                if !raw.is_empty() {
                    let at = random.below(raw.len());
                    raw[at] = random.bits() as u8;
                }
            });
            if let Ok(changed) = read_environment(&bytes, &Limits::default()) {
                assert!(relight_format::write_environment(&changed).is_ok());
            }
        }
    }
}

#[test]
fn trailing_bytes_are_rejected() {
    let mut bytes = full().bytes();
    bytes.push(0);
    assert_eq!(issue(&bytes), Issue::TrailingBytes);
}

#[test]
fn foreign_headers_are_rejected() {
    let bytes = full().bytes();
    let with = |at: usize, value: u32| {
        let mut bytes = bytes.clone();
        bytes[at..at + 4].copy_from_slice(&value.to_le_bytes());
        issue(&bytes)
    };
    assert_eq!(with(0, 0), Issue::BadMagic);
    // "RELIGHT\r\n": a transfer that rewrote line ends.
    let mut text = bytes.clone();
    text.insert(7, b'\r');
    assert_eq!(issue(&text), Issue::BadMagic);
    for version in [0, 2, 3, 6, u32::MAX] {
        assert_eq!(with(8, version), Issue::UnknownVersion);
    }
    for kind in [0, 2, 3, u32::MAX] {
        assert_eq!(with(12, kind), Issue::WrongKind);
    }
    for count in [65, u32::MAX] {
        assert_eq!(with(16, count), Issue::BadSectionTable);
    }
    for reserved in [1, 1 << 31] {
        assert_eq!(with(20, reserved), Issue::ReservedNotZero);
    }
}

#[test]
fn the_other_kind_of_asset_is_rejected() {
    let scene = full().bytes();
    let error = read_environment(&scene, &Limits::default()).unwrap_err();
    assert_eq!(error.issue(), Some(Issue::WrongKind));
}

#[test]
fn sections_must_be_complete_known_and_in_order() {
    let file = full();
    for index in 0..file.sections.len() {
        let mut missing = file.clone();
        missing.sections.remove(index);
        if index == TRANSFER {
            let plain = read_scene(&missing.bytes(), &Limits::default()).unwrap();
            assert_eq!(plain.transfer, None, "light need not bounce");
        } else {
            assert_eq!(
                issue(&missing.bytes()),
                Issue::MissingSection,
                "without {index}"
            );
        }
        let mut twice = file.clone();
        twice.sections.insert(index, file.sections[index].clone());
        assert_eq!(
            issue(&twice.bytes()),
            Issue::BadSectionTable,
            "twice {index}"
        );
        let mut unknown = file.clone();
        unknown.sections[index].kind += 100;
        assert_eq!(
            issue(&unknown.bytes()),
            Issue::BadSectionTable,
            "unknown {index}"
        );
        if index > 0 {
            let mut swapped = file.clone();
            swapped.sections.swap(index - 1, index);
            assert_eq!(
                issue(&swapped.bytes()),
                Issue::BadSectionTable,
                "swapped {index}"
            );
        }
    }
    let mut extra = file.clone();
    extra.sections.push(Section::new(8, &[]));
    assert_eq!(issue(&extra.bytes()), Issue::BadSectionTable);
    let mut none = file;
    none.sections.clear();
    assert_eq!(issue(&none.bytes()), Issue::MissingSection);
}

#[test]
fn sections_must_be_contiguous() {
    let bytes = full().bytes();
    for row in 0..7 {
        let at = HEADER_LENGTH + row * ENTRY_LENGTH + 8;
        let offset = u64::from_le_bytes(bytes[at..at + 8].try_into().unwrap());
        for wrong in [0, offset - 1, offset + 1, u64::MAX] {
            let mut bytes = bytes.clone();
            bytes[at..at + 8].copy_from_slice(&wrong.to_le_bytes());
            assert_eq!(
                issue(&bytes),
                Issue::BadSectionTable,
                "row {row} at {wrong}"
            );
        }
        let mut bytes = bytes.clone();
        bytes[at + 8..at + 16].copy_from_slice(&u64::MAX.to_le_bytes());
        assert_eq!(issue(&bytes), Issue::BadSectionTable, "row {row}, endless");
    }
}

#[test]
fn a_lying_raw_length_is_found_out() {
    let honest = full();
    for index in 0..honest.sections.len() {
        let size = [1, 48, 16, 24, 2, 1, 1, 1][index];
        let length = honest.sections[index].raw_length;
        for lie in [0, length - size, length + size, length + (size << 20)] {
            let mut file = honest.clone();
            file.sections[index].raw_length = lie;
            assert_eq!(
                issue(&file.bytes()),
                Issue::BadCompression,
                "{index}: {length} as {lie}"
            );
        }
    }
    // No machine has this much: the error shows that nothing was allocated on its word.
    let endless = Limits {
        max_bytes: u64::MAX,
        max_metadata_bytes: u64::MAX,
    };
    for lie in [48 << 54, u64::MAX - u64::MAX % 48] {
        let mut file = honest.clone();
        file.sections[VERTICES].raw_length = lie;
        assert_eq!(issue_within(&file.bytes(), &endless), Issue::BadCompression);
    }
    let mut file = honest;
    file.sections[METADATA].raw_length = u64::MAX;
    assert_eq!(issue_within(&file.bytes(), &endless), Issue::OverBudget);
}

#[test]
fn a_bomb_is_stopped_at_the_budget() {
    const BOMB: usize = 96 << 20;
    let mut file = full();
    file.sections[VERTICES] = Section::new(2, &vec![0; BOMB]);
    let bytes = file.bytes();
    assert!(bytes.len() < 1 << 16, "{} bytes are no bomb", bytes.len());
    let limits = Limits {
        max_bytes: 1 << 20,
        ..Limits::default()
    };
    assert_eq!(issue_within(&bytes, &limits), Issue::OverBudget);
    // The same with a modest raw length: decompression stops where it is exceeded.
    file.sections[VERTICES].raw_length = 48;
    assert_eq!(issue_within(&file.bytes(), &limits), Issue::BadCompression);
    // Metadata has a budget of its own, checked before decompression.
    let mut file = full();
    file.sections[METADATA] = Section::new(1, &vec![0; (16 << 20) + 1]);
    assert_eq!(issue(&file.bytes()), Issue::OverBudget);
    let small = Limits {
        max_metadata_bytes: 8,
        ..Limits::default()
    };
    assert_eq!(issue_within(&full().bytes(), &small), Issue::OverBudget);
}

#[test]
fn stored_bytes_are_exactly_one_modest_frame() {
    let file = full();
    let vertices = file.sections[VERTICES].clone();
    let with = |stored: Vec<u8>| {
        let mut file = file.clone();
        file.sections[VERTICES] = Section::stored(2, stored, vertices.raw_length);
        issue(&file.bytes())
    };
    let raw = vertices.raw();
    let frames = [&raw[..48], &raw[48..]].map(|part| zstd::bulk::compress(part, 1).unwrap());
    assert_eq!(with(frames.concat()), Issue::BadCompression);
    assert_eq!(
        with([&vertices.stored[..], &[0]].concat()),
        Issue::BadCompression
    );
    let empty = zstd::bulk::compress(&[], 1).unwrap();
    assert_eq!(
        with([&vertices.stored[..], &empty].concat()),
        Issue::BadCompression
    );
    assert_eq!(with(Vec::new()), Issue::BadCompression);
    assert_eq!(with(raw.clone()), Issue::BadCompression);
    // A frame may ask its reader for a window of 128 MiB, whatever its content.
    let mut encoder = zstd::stream::Encoder::new(Vec::new(), 1).unwrap();
    encoder
        .set_parameter(zstd::zstd_safe::CParameter::WindowLog(27))
        .unwrap();
    std::io::Write::write_all(&mut encoder, &raw).unwrap();
    assert_eq!(with(encoder.finish().unwrap()), Issue::BadCompression);
}

#[test]
fn array_lengths_must_be_whole_elements() {
    for index in 1..=4 {
        let bytes = full().with_raw(index, |raw| raw.push(0));
        assert_eq!(issue(&bytes), Issue::BadLength, "section {index}");
    }
}

#[test]
fn metadata_is_one_value_of_known_fields() {
    type Edit = fn(&mut Vec<u8>);
    let edits: [(&str, Edit); 8] = [
        ("more after it", |raw| raw.push(b'1')),
        ("no UTF-8", |raw| raw[2..8].fill(0xff)),
        ("another field", |raw| {
            raw.splice(1..1, *b"\"else\":1,");
        }),
        ("a field twice", |raw| {
            raw.splice(1..1, *b"\"name\":\"b\",");
        }),
        ("too large a number", |raw| {
            replace(raw, "\"sample_resolution\":", "1e99");
        }),
        ("a number beyond all", |raw| {
            replace(raw, "\"ray_offset\":", "1e300");
        }),
        ("no number", |raw| {
            replace(raw, "\"ray_offset\":", "null");
        }),
        ("too deep", |raw| *raw = vec![b'['; 100_000]),
    ];
    for (what, edit) in edits {
        let bytes = full().with_raw(METADATA, edit);
        assert_eq!(issue(&bytes), Issue::BadMetadata, "{what}");
    }
}

/// Puts `value` in place of the one after `key`.
fn replace(raw: &mut Vec<u8>, key: &str, value: &str) {
    let text = String::from_utf8(raw.clone()).expect("UTF-8");
    let start = text.find(key).expect("a key") + key.len();
    let length = text[start..].find([',', '}']).expect("an end");
    raw.splice(start..start + length, value.bytes());
}

/// 2147549185 × 2147418113 × 4 is 4 modulo 2⁶⁴: one texel, to careless arithmetic.
#[test]
fn texture_sizes_cannot_wrap() {
    let mut scene = full_scene();
    scene.textures.truncate(1);
    scene.textures[0].width = 1;
    scene.textures[0].height = 1;
    scene.textures[0].texels = vec![1, 2, 3, 4];
    for material in &mut scene.materials {
        for slot in material.slots_mut() {
            slot.texture = 0;
        }
    }
    let file = File::parse(&write_scene(&scene).unwrap());
    // Red and blue less green.
    assert_eq!(file.sections[TEXELS].raw(), [1, 255, 2, 1, 4]);
    let bytes = file.with_raw(METADATA, |raw| {
        replace(raw, "\"textures\":[{\"width\":", "2147549185");
        replace(raw, "\"width\":2147549185,\"height\":", "2147418113");
    });
    assert_eq!(issue(&bytes), Issue::BadLength);
}

#[test]
fn texels_need_their_texture_and_its_planes() {
    let file = full();
    for other in [2, 0xff] {
        let bytes = file.with_raw(TEXELS, |raw| raw[0] = other);
        assert_eq!(issue(&bytes), Issue::ValueOutOfRange);
    }
    let length = file.sections[TEXELS].raw_length as usize;
    for end in 0..length {
        let bytes = file.with_raw(TEXELS, |raw| raw.truncate(end));
        assert_eq!(issue(&bytes), Issue::BadLength, "{end} of {length}");
    }
    let bytes = file.with_raw(TEXELS, |raw| raw.push(0));
    assert_eq!(issue(&bytes), Issue::BadLength);
    // The version before had no byte before each.
    let mut before = file;
    before.version = 4;
    assert_eq!(issue(&before.bytes()), Issue::BadLength);
}

#[test]
fn messages_name_place_expectation_and_finding_in_brief() {
    let mut bytes = full().bytes();
    bytes[8] = 9;
    let error = inspect(&bytes, &Limits::default()).unwrap_err();
    assert_eq!(
        error.to_string(),
        "header: expected version 4 to 5, found version 9 (it was written for another version of the format)"
    );
    let mut scene = full_scene();
    scene.materials[0].name = "é".repeat(1 << 20);
    scene.materials[0].normal_scale = f32::NAN;
    let error = write_scene(&scene).unwrap_err();
    assert!(matches!(error, Error::Invalid { .. }));
    assert!(
        error.to_string().len() < 1000,
        "{} bytes",
        error.to_string().len()
    );
}
