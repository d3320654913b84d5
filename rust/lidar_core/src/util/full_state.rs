//! The whole state of an object as bytes: header, content and checksum.
//!
//! Layout (little endian): magic `LCFS`, version u32, length of the kind u8, kind (ASCII),
//! fingerprint of the parameters u32, content (postcard), CRC-32 of everything before it.
//! The parameters themselves are not included: an object is made from them, and its state is then
//! restored.

use crate::Error;
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::fmt::Debug;
use std::io::Write;

const MAGIC: &[u8; 4] = b"LCFS";
/// Version of the layouts of saved states. Every change of a layout raises it. The list of accepted
/// layouts states it, so that the program that writes the list also raises the version:
/// `state_layouts.rs` at the root of the crate.
pub(crate) const VERSION: u32 = version_of(include_str!("../state_layouts.txt"));
const CHECKSUM_BYTES: usize = 4;

/// The version number in the first line of a list of layouts, such as "version 8".
pub(crate) const fn version_of(layouts: &str) -> u32 {
    let bytes = layouts.as_bytes();
    let (mut at, mut version) = ("version ".len(), 0);
    while at < bytes.len() && bytes[at].is_ascii_digit() {
        version = 10 * version + (bytes[at] - b'0') as u32;
        at += 1;
    }
    version
}

/// Bytes with the state `content` of an object of this `kind` with these `parameters`, for
/// [`opened`].
///
/// # Errors
/// [`Error::Limit`] if the bytes do not fit into memory.
pub(crate) fn sealed(
    kind: &'static str,
    parameters: &impl Debug,
    content: &impl Serialize,
) -> Result<Vec<u8>, Error> {
    let mut bytes = Vec::from(MAGIC);
    bytes.extend(VERSION.to_le_bytes());
    bytes.push(kind.len() as u8);
    bytes.extend(kind.as_bytes());
    bytes.extend(fingerprint(parameters).to_le_bytes());
    let written = postcard::to_io(content, Growing(bytes)).and_then(|mut growing| {
        let sum = crc32(&growing.0);
        let ended = growing.write_all(&sum.to_le_bytes());
        ended.map(|()| growing.0).map_err(|_| postcard::Error::SerializeBufferFull)
    });
    written.map_err(|error| Error::Limit {
        what: format!("the state of a {kind}: {error}"),
        limit: u64::MAX,
        key: "free memory",
    })
}

/// Bytes that grow while there is memory. Without memory, writing returns an error.
pub(crate) struct Growing(pub(crate) Vec<u8>);

impl Write for Growing {
    fn write(&mut self, part: &[u8]) -> std::io::Result<usize> {
        self.0.try_reserve(part.len())?;
        self.0.extend_from_slice(part);
        Ok(part.len())
    }

    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}

/// The content of bytes that [`sealed`] made for the same `kind` and `parameters`.
///
/// # Errors
/// [`Error::Format`] with the byte offset for bytes that are damaged, cut off, of another kind or
/// version; [`Error::Parameter`] for those of an object with other parameters.
pub(crate) fn opened<T: DeserializeOwned>(
    kind: &'static str,
    parameters: &impl Debug,
    bytes: &[u8],
) -> Result<T, Error> {
    // Longer than other functions: the checks of the parts of the bytes in their order, each with
    // its error.
    #[cfg(test)]
    super::layout::tell::<T>(kind);
    let body = bytes.len().saturating_sub(CHECKSUM_BYTES);
    let content = MAGIC.len() + 4 + 1 + kind.len() + 4;
    if bytes.get(..4) != Some(MAGIC) {
        return Err(damaged(0, "expected the state of an object (magic LCFS)"));
    }
    let version = bytes.get(4..8).and_then(|four| four.try_into().ok()).map(u32::from_le_bytes);
    match version {
        Some(VERSION) => {}
        Some(older) if older < VERSION => {
            return Err(damaged(4, "an older lidar_core saved it, and only that one reads it"));
        }
        _ => return Err(damaged(4, "the version is unknown; update lidar_core to read it")),
    }
    if body < content || bytes[body..] != crc32(&bytes[..body]).to_le_bytes() {
        return Err(damaged(body, "the checksum is wrong: the bytes are damaged or cut off"));
    }
    if usize::from(bytes[8]) != kind.len() || &bytes[9..9 + kind.len()] != kind.as_bytes() {
        let found = bytes[9..body].get(..usize::from(bytes[8])).unwrap_or_default();
        let found = String::from_utf8_lossy(found);
        return Err(damaged(8, &format!("expected the state of a {kind}, got one of a {found}")));
    }
    if bytes[content - 4..content] != fingerprint(parameters).to_le_bytes() {
        return Err(Error::Parameter {
            name: "parameters",
            expected: "those of the object whose state was saved",
            got: "others".into(),
        });
    }
    match postcard::take_from_bytes(&bytes[content..body]) {
        Ok((found, [])) => Ok(found),
        Ok((_, rest)) => Err(damaged(body - rest.len(), "more bytes than the state has")),
        Err(error) => Err(damaged(content, &format!("the content breaks its format: {error}"))),
    }
}

/// [`Error::Format`] for a saved state that is well formed, but that no object can have. `what`:
/// what is wrong.
pub(crate) fn impossible(what: &str) -> Error {
    damaged(0, &format!("the saved state is inconsistent: {what}"))
}

/// Check the saved number that the next new object (such as a track) will get, and return it.
///
/// # Errors
/// [`Error::Format`] for a number that no object ever had, or that leaves no room for later
/// numbers.
pub(crate) fn next_number(saved: i64) -> Result<i64, Error> {
    const MOST: i64 = 1 << 62;
    if (0..=MOST).contains(&saved) {
        Ok(saved)
    } else {
        Err(impossible("numbers below 0 or beyond 2^62"))
    }
}

fn damaged(offset: usize, what: &str) -> Error {
    Error::Format { what: what.into(), offset: offset as u64 }
}

/// Number that distinguishes parameters: a checksum of their debug text, which has every field,
/// with floats to the last bit.
fn fingerprint(parameters: &impl Debug) -> u32 {
    crc32(format!("{parameters:?}").as_bytes())
}

/// CRC-32 (IEEE 802.3).
pub(crate) fn crc32(bytes: &[u8]) -> u32 {
    crc32_of_next(0, bytes)
}

/// CRC-32 of two parts together. `crc`: the CRC-32 of the first part; `bytes`: the second part.
pub(crate) fn crc32_of_next(crc: u32, bytes: &[u8]) -> u32 {
    const TABLE: [u32; 256] = table();
    !bytes
        .iter()
        .fold(!crc, |crc, &byte| crc >> 8 ^ TABLE[((crc ^ u32::from(byte)) & 0xFF) as usize])
}

const fn table() -> [u32; 256] {
    let mut table = [0; 256];
    let mut index = 0;
    while index < 256 {
        let mut crc = index as u32;
        let mut bit = 0;
        while bit < 8 {
            crc = if crc & 1 == 1 { crc >> 1 ^ 0xEDB8_8320 } else { crc >> 1 };
            bit += 1;
        }
        table[index] = crc;
        index += 1;
    }
    table
}

#[cfg(test)]
mod tests {
    use super::*;

    type Content = (Vec<f64>, Option<u32>);

    /// Found by `make fuzz`: for the largest number, computing the next one was a panic.
    #[test]
    fn numbers_that_leave_no_room_are_refused() {
        for saved in [0, 7, 1 << 62] {
            assert!(matches!(next_number(saved), Ok(found) if found == saved));
        }
        for saved in [-1, i64::MIN, (1 << 62) + 1, i64::MAX] {
            assert!(matches!(next_number(saved), Err(Error::Format { .. })), "{saved}");
        }
    }

    fn sample() -> Content {
        (vec![1.5, f64::NEG_INFINITY, -0.0], Some(7))
    }

    #[test]
    fn a_state_comes_back_to_the_bit() -> Result<(), Error> {
        let bytes = sealed("thing", &"parameters", &sample())?;
        let (floats, count): Content = opened("thing", &"parameters", &bytes)?;
        let bits = |floats: &[f64]| floats.iter().map(|f| f.to_bits()).collect::<Vec<_>>();
        assert_eq!(bits(&floats), bits(&sample().0));
        assert_eq!(count, Some(7));
        Ok(())
    }

    #[test]
    fn every_cut_and_every_flipped_bit_is_refused() -> Result<(), Error> {
        let bytes = sealed("thing", &"parameters", &sample())?;
        let open = |bytes: &[u8]| opened::<Content>("thing", &"parameters", bytes);
        for length in 0..bytes.len() {
            assert!(matches!(open(&bytes[..length]), Err(Error::Format { .. })));
        }
        for bit in 0..8 * bytes.len() {
            let mut other = bytes.clone();
            other[bit / 8] ^= 1 << (bit % 8);
            assert!(matches!(open(&other), Err(Error::Format { .. })));
        }
        Ok(())
    }

    #[test]
    fn another_kind_and_other_parameters_are_named() -> Result<(), Error> {
        let bytes = sealed("thing", &"parameters", &sample())?;
        let kind = opened::<Content>("other", &"parameters", &bytes).map_err(|e| e.to_string());
        let expected = "expected the state of a other, got one of a thing";
        assert!(kind.is_err_and(|text| text.contains(expected)));
        let told = opened::<Content>("thing", &"others", &bytes);
        assert!(matches!(told, Err(Error::Parameter { name: "parameters", .. })));
        Ok(())
    }

    #[test]
    fn a_length_that_lies_does_not_allocate() -> Result<(), Error> {
        let mut bytes = sealed("thing", &"parameters", &u64::MAX)?; // a length, for a list
        let body = bytes.len() - CHECKSUM_BYTES;
        bytes.truncate(body);
        bytes.extend(crc32(&bytes).to_le_bytes());
        let read = opened::<Vec<f64>>("thing", &"parameters", &bytes);
        assert!(matches!(read, Err(Error::Format { .. })));
        Ok(())
    }

    #[test]
    fn the_checksum_is_the_usual_one() {
        assert_eq!(crc32(b"123456789"), 0xCBF4_3926);
        assert_eq!(crc32_of_next(crc32(b"1234"), b"56789"), 0xCBF4_3926);
    }
}
