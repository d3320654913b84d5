//! Every fuzz target on the corpus, cut and damaged: none may panic.

#[path = "fuzz/mod.rs"]
#[allow(unreachable_pub)] // the driver of `make fuzz` has it as a module, too
mod fuzz;

use std::fs;
use std::io::Result;
use std::path::Path;

/// Damaged copies of every file of the corpus.
const COPIES: u64 = 4;

/// A pseudo-random number (Marsaglia's xorshift).
fn next(state: &mut u64) -> u64 {
    *state ^= *state << 13;
    *state ^= *state >> 7;
    *state ^= *state << 17;
    *state
}

#[test]
fn no_target_panics() -> Result<()> {
    let corpus = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/rust/fuzz/corpus");
    for (name, body) in fuzz::TARGETS {
        body(&[]);
        let mut state = 88_172_645_463_325_252;
        let mut paths: Vec<_> = match fs::read_dir(corpus.join(name)) {
            Ok(folder) => {
                folder.map(|entry| entry.map(|entry| entry.path())).collect::<Result<_>>()?
            }
            Err(_) => Vec::new(),
        };
        paths.sort();
        assert!(!paths.is_empty(), "{name} has no corpus");
        for path in paths {
            let bytes = fs::read(path)?;
            body(&bytes);
            for copy in 0..COPIES {
                let mut other = bytes.clone();
                let at = next(&mut state) as usize % other.len().max(1);
                if copy == 0 {
                    other.truncate(at);
                } else if let Some(byte) = other.get_mut(at) {
                    *byte = next(&mut state) as u8;
                }
                body(&other);
            }
        }
    }
    Ok(())
}
