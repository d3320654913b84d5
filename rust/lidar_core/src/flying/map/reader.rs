//! Reader of numbers from bytes, whose errors name the offset.

use crate::Error;

/// Reads numbers from bytes, one after another.
pub(super) struct Reader<'a> {
    pub(super) bytes: &'a [u8],
    /// Offset of the next byte.
    pub(super) at: usize,
}

impl Reader<'_> {
    /// Number of bytes that are left.
    pub(super) fn left(&self) -> usize {
        self.bytes.len() - self.at
    }

    /// The next `len` bytes.
    pub(super) fn slice(&mut self, len: usize) -> Result<&[u8], Error> {
        let taken = self.bytes.get(self.at..).and_then(|rest| rest.get(..len));
        let taken = taken.ok_or_else(|| format_error(self.at, "the file ends too early"))?;
        self.at += len;
        Ok(taken)
    }

    pub(super) fn u32(&mut self) -> Result<u32, Error> {
        Ok(u32::from_le_bytes(self.take()?))
    }

    pub(super) fn take<const N: usize>(&mut self) -> Result<[u8; N], Error> {
        let taken = self.bytes.get(self.at..).and_then(|rest| rest.first_chunk::<N>());
        let taken = *taken.ok_or_else(|| format_error(self.at, "the file ends too early"))?;
        self.at += N;
        Ok(taken)
    }

    pub(super) fn f64(&mut self) -> Result<f64, Error> {
        Ok(f64::from_le_bytes(self.take()?))
    }

    pub(super) fn f32(&mut self) -> Result<f32, Error> {
        Ok(f32::from_le_bytes(self.take()?))
    }
}

/// Error for bytes that are not in the expected format at `offset`.
pub(super) fn format_error(offset: usize, what: &str) -> Error {
    Error::Format { what: what.into(), offset: offset as u64 }
}
