//! One zstd frame per section. C's library does it, except in WebAssembly, whose compilers have no
//! C library to link: there a decoder in Rust takes longer for the same bytes.

use std::io::{self, Read};

#[cfg(not(target_family = "wasm"))]
pub(crate) use c::{Decoder, compress, compress_noise, compress_numbers};
#[cfg(target_family = "wasm")]
pub(crate) use rust::{
    Decoder, compress, compress as compress_noise, compress as compress_numbers,
};

/// log2 of the largest window a reader allocates for; levels up to 15 use 22 at most.
const MAX_WINDOW_LOG: u32 = 23;

#[cfg(not(target_family = "wasm"))]
mod c {
    use zstd::zstd_safe::{CParameter, Strategy};

    use super::{MAX_WINDOW_LOG, Read, io};

    /// The last of the fast ones: the next takes three times as long for 0.2 % of the bytes. Decoding speed does
    /// not depend on it.
    const LEVEL: i32 = 12;
    const NUMBER_LEVEL: i32 = 1;

    /// All bytes in one frame.
    pub(crate) fn compress(raw: &[u8]) -> io::Result<Vec<u8>> {
        zstd::bulk::compress(raw, LEVEL)
    }

    /// The same of numbers that do not repeat each other: the fastest level finds little where the others find hardly
    /// more, or of coefficients less, since what they find by chance costs more than it saves.
    pub(crate) fn compress_numbers(raw: &[u8]) -> io::Result<Vec<u8>> {
        zstd::bulk::compress(raw, NUMBER_LEVEL)
    }

    /// The same of bytes that hardly repeat each other, but of which few are large: what takes fewest bits is chosen
    /// with care, and repetitions are looked for in one place. In the time of the other one it takes
    /// an eighth less, and less than the highest levels, which find many that cost more than they save.
    pub(crate) fn compress_noise(raw: &[u8]) -> io::Result<Vec<u8>> {
        let mut compressor = zstd::bulk::Compressor::new(LEVEL)?;
        for parameter in [
            CParameter::Strategy(Strategy::ZSTD_btopt),
            CParameter::MinMatch(4),
            CParameter::SearchLog(1),
            CParameter::ChainLog(12),
        ] {
            compressor.set_parameter(parameter)?;
        }
        compressor.compress(raw)
    }

    /// Decodes the first frame of some bytes.
    pub(crate) struct Decoder<'a>(zstd::stream::read::Decoder<'static, &'a [u8]>);

    impl<'a> Decoder<'a> {
        pub(crate) fn new(stored: &'a [u8]) -> io::Result<Self> {
            let mut decoder = zstd::stream::read::Decoder::with_buffer(stored)?.single_frame();
            decoder.window_log_max(MAX_WINDOW_LOG)?;
            Ok(Self(decoder))
        }

        /// Bytes after the frame, once all of it has been read.
        pub(crate) fn unused(self) -> usize {
            self.0.finish().len()
        }
    }

    impl Read for Decoder<'_> {
        fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
            self.0.read(buffer)
        }
    }
}

#[cfg(any(target_family = "wasm", test))]
mod rust {
    use ruzstd::decoding::{FrameDecoder, StreamingDecoder};
    use ruzstd::encoding::{CompressionLevel, compress_to_vec};

    use super::{MAX_WINDOW_LOG, Read, io};

    /// All bytes in one frame, less tightly than C's library does.
    #[expect(clippy::unnecessary_wraps, reason = "as the other one")]
    pub(crate) fn compress(raw: &[u8]) -> io::Result<Vec<u8>> {
        Ok(compress_to_vec(raw, CompressionLevel::Fastest))
    }

    /// Decodes the first frame of some bytes.
    pub(crate) struct Decoder<'a>(StreamingDecoder<&'a [u8], FrameDecoder>);

    impl<'a> Decoder<'a> {
        pub(crate) fn new(stored: &'a [u8]) -> io::Result<Self> {
            StreamingDecoder::new_with_max_window_size(stored, 1 << MAX_WINDOW_LOG)
                .map(Self)
                .map_err(io::Error::other)
        }

        /// Bytes after the frame, once all of it has been read.
        pub(crate) fn unused(self) -> usize {
            self.0.into_inner().len()
        }
    }

    impl Read for Decoder<'_> {
        fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
            self.0.read(buffer)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Bytes that compress well, badly and not at all.
    fn samples() -> Vec<Vec<u8>> {
        let mut state = 1u32;
        let mut noise = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 24) as u8
        };
        vec![
            Vec::new(),
            vec![7],
            vec![0; 3_000_000],
            (0..400_000u32)
                .flat_map(|i| (i / 3).to_le_bytes())
                .collect(),
            (0..700_000).map(|_| noise() & 15).collect(),
            (0..100_000).map(|_| noise()).collect(),
        ]
    }

    fn whole(mut decoder: impl Read) -> io::Result<Vec<u8>> {
        let mut bytes = Vec::new();
        decoder.read_to_end(&mut bytes)?;
        Ok(bytes)
    }

    #[test]
    fn both_decode_what_either_encodes() {
        for raw in samples() {
            for stored in [
                compress(&raw).unwrap(),
                compress_noise(&raw).unwrap(),
                compress_numbers(&raw).unwrap(),
                rust::compress(&raw).unwrap(),
            ] {
                assert!(whole(Decoder::new(&stored).unwrap()).unwrap() == raw);
                assert!(whole(rust::Decoder::new(&stored).unwrap()).unwrap() == raw);
            }
        }
    }

    #[test]
    fn rust_finds_what_follows_a_frame_and_what_is_missing() {
        let raw = vec![5; 1000];
        let mut stored = compress(&raw).unwrap();
        stored.extend([1, 2, 3]);
        let mut decoder = rust::Decoder::new(&stored).unwrap();
        assert!(whole(&mut decoder).unwrap() == raw);
        assert_eq!(decoder.unused(), 3);
        for length in 0..stored.len() - 3 {
            let short = rust::Decoder::new(&stored[..length]).and_then(whole);
            assert!(short.is_err(), "{length}");
        }
    }

    #[test]
    fn rust_refuses_wide_windows() {
        let mut encoder = zstd::stream::Encoder::new(Vec::new(), 1).unwrap();
        encoder
            .set_parameter(zstd::zstd_safe::CParameter::WindowLog(27))
            .unwrap();
        io::Write::write_all(&mut encoder, &[1; 1000]).unwrap();
        let stored = encoder.finish().unwrap();
        assert!(rust::Decoder::new(&stored).and_then(whole).is_err());
        assert!(Decoder::new(&stored).and_then(whole).is_err());
    }
}
