//! Where the knowledge about rays without return comes from.

/// Source of the rays without return of a scan.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum SkySource {
    /// Rays without return are not known, or not known yet. Open sky stays unknown in the map.
    #[default]
    Unknown,
    /// The caller has given the rays without return.
    Given,
    /// Rays without return were found from the returns of a sensor with rows.
    Pattern,
    /// Rays without return were found from the density of the returns.
    Density,
}

impl SkySource {
    /// The source as one word, for people and files.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Unknown => "unknown",
            Self::Given => "given",
            Self::Pattern => "pattern",
            Self::Density => "density",
        }
    }
}
