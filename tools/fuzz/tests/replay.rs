//! Every input of the corpus, and mutants of each, through the readers. Crashes that fuzzing
//! finds become files of the corpus.

use std::path::{Path, PathBuf};

use relight_fuzz::{TARGETS, Target, mutate};

/// Mutants of each input: enough to notice what broke, not to find what is new.
const MUTANTS: u32 = 300;
/// Longest mutant.
const MOST: usize = 1 << 16;

fn corpus(target: &Target) -> Vec<(PathBuf, Vec<u8>)> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("corpus")
        .join(target.name);
    let mut files: Vec<PathBuf> = std::fs::read_dir(&folder)
        .unwrap_or_else(|error| panic!("{}: {error}", folder.display()))
        .map(|entry| entry.expect("a file").path())
        .collect();
    files.sort();
    assert!(!files.is_empty(), "{} is empty", folder.display());
    let read = |path: PathBuf| (path.clone(), std::fs::read(path).expect("a readable file"));
    files.into_iter().map(read).collect()
}

/// A small generator (Numerical Recipes' LCG).
struct Random(u32);

impl Random {
    fn next(&mut self) -> u32 {
        self.0 = self.0.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        self.0 >> 8
    }

    fn below(&mut self, count: usize) -> usize {
        self.next() as usize % count.max(1)
    }

    /// Changes, doubles, removes or inserts a few bytes.
    fn change(&mut self, bytes: &mut Vec<u8>) {
        for _ in 0..=self.below(4) {
            let at = self.below(bytes.len());
            match self.below(6) {
                0 if !bytes.is_empty() => bytes[at] ^= 1 << self.below(8),
                1 if !bytes.is_empty() => bytes[at] = [0, 1, 0x7f, 0x80, 0xff][self.below(5)],
                2 if bytes.len() > 4 => {
                    let words = [u32::MAX, 0x7f80_0000, 0x7fc0_0000, 1 << 31, 0];
                    let word = words[self.below(5)].to_le_bytes();
                    let at = at.min(bytes.len() - 4);
                    bytes[at..at + 4].copy_from_slice(&word);
                }
                3 if bytes.len() > 8 => {
                    bytes.drain(at..(at + 1 + self.below(8)).min(bytes.len()));
                }
                4 => bytes.insert(at.min(bytes.len()), self.next() as u8),
                _ => {
                    let end = (at + 1 + self.below(16)).min(bytes.len());
                    let part = bytes[at.min(end)..end].to_vec();
                    bytes.splice(at.min(end)..at.min(end), part);
                }
            }
        }
    }
}

fn replay(name: &str) {
    let target = TARGETS.into_iter().find(|target| target.name == name);
    let target = target.expect("a target");
    let mut random = Random(7);
    for (path, bytes) in corpus(&target) {
        // The test's output says which input was the last.
        println!("{}", path.display());
        (target.read)(&bytes);
        for _ in 0..MUTANTS {
            let seed = random.next();
            let change = &mut |bytes: &mut Vec<u8>| random.change(bytes);
            let mutant = mutate::mutant(target.repair, &bytes, seed, MOST, change);
            let mutant = mutant.unwrap_or_else(|| {
                let mut bytes = bytes.clone();
                random.change(&mut bytes);
                bytes
            });
            (target.read)(&mutant);
        }
    }
}

macro_rules! replays {
    ($($name:ident)*) => {
        $(
            #[test]
            fn $name() {
                replay(stringify!($name));
            }
        )*

        #[test]
        fn no_target_is_forgotten() {
            let replayed = [$(stringify!($name)),*];
            assert_eq!(TARGETS.map(|target| target.name), replayed);
        }
    };
}

replays!(scene environment material parts gltf obj mtl hdr exr rgl merl toml);

/// The corpus has today's files: those of an earlier form of the format reach nothing.
#[test]
fn seeds_are_valid() {
    let limits = relight_format::Limits::default();
    let seed = |index: usize| corpus(&TARGETS[index]).swap_remove(0).1;
    relight_format::read_scene(&seed(0), &limits).expect("tests/golden of the format");
    relight_format::read_environment(&seed(1), &limits).expect("tests/golden of the format");
    relight_format::read_material(&seed(2), &limits).expect("tests/golden of the format");
}

/// Structure-aware mutants are what they are meant to be: their checksums hold.
#[test]
fn mutants_get_past_checksums() {
    let target = TARGETS[0];
    let (_, bytes) = corpus(&target).swap_remove(0);
    let limits = relight_format::Limits::default();
    let mut random = Random(1);
    let (mut past, mut changed) = (0, 0);
    for _ in 0..200 {
        let seed = random.next();
        let change = &mut |bytes: &mut Vec<u8>| random.change(bytes);
        let mutant = mutate::mutant(target.repair, &bytes, seed, MOST, change).expect("an asset");
        // Now and then a byte is replaced by itself.
        changed += u32::from(mutant != bytes);
        let issue = relight_format::read_scene(&mutant, &limits)
            .err()
            .and_then(|error| error.issue());
        assert_ne!(issue, Some(relight_format::Issue::BadChecksum));
        assert_ne!(issue, Some(relight_format::Issue::BadCompression));
        past += u32::from(issue.is_none());
    }
    assert!(changed > 180, "{changed} of 200 mutants differ");
    assert!(past > 0, "no mutant is valid");
}
