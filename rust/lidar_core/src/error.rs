//! The only error type of the crate: every text states the expected and the received value.

use std::fmt;

/// Why a call was refused. The object it was made on is unchanged.
#[derive(Debug)]
#[non_exhaustive]
pub enum Error {
    /// A parameter is outside its documented range.
    Parameter {
        /// Name as the caller wrote it.
        name: &'static str,
        /// Documented range.
        expected: &'static str,
        /// Value received.
        got: String,
    },
    /// Two arrays that belong together differ in length.
    Length {
        /// Name of the array.
        name: &'static str,
        /// Length of the array it belongs to.
        expected: usize,
        /// Length received.
        got: usize,
    },
    /// An array holds a value that cannot be used.
    Value {
        /// Name of the array.
        name: &'static str,
        /// Condition that its entries must meet.
        expected: &'static str,
        /// Row of the first bad entry.
        index: usize,
        /// Value of the entry.
        got: String,
    },
    /// A coordinate is not finite or too far away to be indexed.
    PointOutOfRange {
        /// The point [m].
        point: [f64; 3],
    },
    /// An input exceeds a limit.
    Limit {
        /// The object that exceeds the limit, with its size.
        what: String,
        /// The limit.
        limit: u64,
        /// The configuration key that raises it, or another cure.
        key: &'static str,
    },
    /// Memory that is not available.
    Memory {
        /// Object that needs the memory, and its size.
        what: String,
    },
    /// A covariance lost symmetry or positive definiteness.
    NotPositiveDefinite {
        /// Textbook letter of the matrix.
        matrix: &'static str,
    },
    /// A stamp lies before one that was processed.
    Time {
        /// The late or duplicate input, with both stamps and the cure.
        what: String,
    },
    /// A file breaks its format.
    Format {
        /// The fault, and the cure.
        what: String,
        /// Byte offset of the fault.
        offset: u64,
    },
    /// Reading or writing failed.
    Io(std::io::Error),
    /// The caller asked to stop.
    Interrupted,
}

/// Refuse a parameter that is outside its documented range.
///
/// # Errors
/// [`Error::Parameter`] unless `ok`.
pub(crate) fn require(
    ok: bool,
    name: &'static str,
    expected: &'static str,
    got: impl fmt::Display,
) -> Result<(), Error> {
    if ok { Ok(()) } else { Err(Error::Parameter { name, expected, got: got.to_string() }) }
}

/// Refuse a length, time or rate that cannot be one.
///
/// # Errors
/// [`Error::Parameter`] unless `value` is finite and > 0.
pub(crate) fn require_positive(name: &'static str, value: f64) -> Result<(), Error> {
    require(value.is_normal() && value > 0.0, name, "finite and > 0", value)
}

impl fmt::Display for Error {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Parameter { name, expected, got } => {
                write!(f, "{name}: expected {expected}, got {got}")
            }
            Self::Length { name, expected, got } => {
                write!(f, "{name}: expected {expected} rows, got {got}")
            }
            Self::Value { name, expected, index, got } => {
                write!(f, "{name}[{index}]: expected {expected}, got {got}")
            }
            Self::PointOutOfRange { point: [x, y, z] } => write!(
                f,
                "point ({x}, {y}, {z}): expected finite coordinates within 2^31 voxels of the origin"
            ),
            Self::Limit { what, limit, key } => {
                if key.contains(' ') {
                    return write!(f, "{what}: the limit is {limit}; {key}"); // a cure, no key
                }
                write!(f, "{what}: the limit is {limit}; raise `{key}` if this is intended")
            }
            Self::Memory { what } => {
                write!(f, "{what}, which is not available; free memory, or pass less data at once")
            }
            Self::NotPositiveDefinite { matrix } => {
                write!(f, "matrix {matrix}: expected symmetric positive definite")
            }
            Self::Time { what } => f.write_str(what),
            Self::Format { what, offset } => write!(f, "byte {offset}: {what}"),
            Self::Io(error) => error.fmt(f),
            Self::Interrupted => f.write_str("interrupted by the caller"),
        }
    }
}

impl std::error::Error for Error {
    fn source(&self) -> Option<&(dyn std::error::Error + 'static)> {
        match self {
            Self::Io(error) => Some(error),
            _ => None,
        }
    }
}

impl From<std::io::Error> for Error {
    fn from(error: std::io::Error) -> Self {
        Self::Io(error)
    }
}
