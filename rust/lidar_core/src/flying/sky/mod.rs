//! Open sky, found from the returns alone: directions in which rays are cast and give no return.
//!
//! Drivers leave out rays without return, or mark them without their directions. Where a sensor
//! casts its rays is learnt from its returns (`emission`). A direction with enough rays and no
//! return is empty: either nothing is within range, or a surface there absorbs the light. The rays
//! of empty directions therefore clear with these limits: not beyond surfaces beside them, not down
//! to the ground, not beyond the distance from which surfaces return at all, and not into voxels in
//! which returns were seen, unless the direction stayed empty for two seconds.
//!
//! Directions are in the axes of the map, seen from the sensor. The decision and its reasons are in
//! `docs/adr/0008-sky.md`.

mod elevations;
mod emission;
mod floor;
mod free_path;
mod grid;
mod observation;
pub mod source;

use elevations::Elevations;
use emission::Emission;
pub use emission::RayPattern;
use grid::CELLS;
pub(crate) use observation::{ON_GROUND, ScanToObserve, SkyObservation};

use crate::Error;
use crate::geometry::transform::{minus, norm};
use crate::util::full_state::impossible;
use observation::RecentReturns;
use serde::{Deserialize, Serialize};

/// Number of scans in which a stated sensor is compared with the returns.
const CHECKED_SCANS: u32 = 5;
/// Number of scans after which the ray directions are known; `ENOUGH_NS`: the same as time since
/// the first scan [ns].
const ENOUGH_SCANS: u32 = 3;
/// Time since the first scan after which the ray directions are known [ns].
const ENOUGH_NS: i64 = 300_000_000;
/// After the first [`LEARNING_SCANS`] scans, the ray pattern is learnt from one scan in this many.
const LEARNING_STEP: u32 = 8;
/// Number of first scans from each of which the ray pattern is learnt.
const LEARNING_SCANS: u32 = 64;
/// Distance of the sensor from the place of the last observation beyond which the sky is observed
/// anew [m].
const SAME_PLACE: f64 = 0.5;
/// Time for a direction that is not sky.
const NEVER: i64 = i64::MAX;

/// How the directions of rays without return are known.
#[derive(Clone, Debug, Default, PartialEq)]
pub enum Beams {
    /// Rays without return are given with the scan, or not known.
    #[default]
    Given,
    /// Rays without return are found from the returns.
    Learnt,
    /// Rays without return are found from the returns and the known ray pattern of the sensor.
    Known(RayPattern),
}

/// State of the directions of one sensor, over several scans.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(crate) struct Sky {
    emission: Emission,
    /// The ray pattern that the configuration states. None: it is learnt.
    #[serde(skip)]
    known: Option<RayPattern>,
    /// Whether the returns are in rows.
    has_rows: bool,
    /// Number of rays that were cast into every cell of direction since its last return.
    evidence: Vec<f32>,
    /// Range of what was last seen in every cell [m]; `surface_ns`: when, if it was a surface [ns].
    surface: Vec<f32>,
    surface_ns: Vec<i64>,
    /// Since when every cell is sky [ns], or [`NEVER`].
    since_ns: Vec<i64>,
    /// Near returns of the last scans, while the air is full of droplets.
    recent: RecentReturns,
    /// Position of the sensor from which `since_ns` was observed [m, frame of the map].
    place: [f64; 3],
    /// Height of the lowest returns relative to the sensor [m].
    lowest: f64,
    /// Number of returns in a usual scan.
    usual: f64,
    first_ns: Option<i64>,
    last_ns: Option<i64>,
    scans: u32,
    /// Number of scans that had enough returns to test the sensor.
    checked: u32,
}

impl Sky {
    /// The sky of a sensor whose rays without return must be found. None if they are given.
    pub(crate) fn of(beams: &Beams) -> Option<Self> {
        let known = match beams {
            Beams::Given => return None,
            Beams::Learnt => None,
            Beams::Known(rays) => Some(rays.clone()),
        };
        Some(Self {
            emission: Emission::of(known.as_ref()),
            known,
            has_rows: false,
            evidence: vec![0.0; CELLS],
            surface: vec![f32::INFINITY; CELLS],
            surface_ns: vec![i64::MIN; CELLS],
            since_ns: vec![NEVER; CELLS],
            recent: RecentReturns::default(),
            place: [0.0; 3],
            lowest: 0.0,
            usual: 0.0,
            first_ns: None,
            last_ns: None,
            scans: 0,
            checked: 0,
        })
    }

    /// Restore the saved state of a sensor with the same configuration.
    ///
    /// # Errors
    /// [`Error::Format`] for a state that no sensor has.
    pub(crate) fn restore(&mut self, saved: Self) -> Result<(), Error> {
        let lengths = [saved.evidence.len(), saved.surface.len()];
        let times = [saved.surface_ns.len(), saved.since_ns.len()];
        if [lengths, times].as_flattened().iter().any(|&len| len != CELLS)
            || !saved.emission.is_whole()
            || !saved.recent.is_whole()
        {
            return Err(impossible("a sky with another number of directions"));
        }
        *self = Self { known: self.known.take(), ..saved };
        Ok(())
    }

    /// Refuse a scan that the stated sensor cannot have given. `others`: known sensors with their
    /// names.
    ///
    /// # Errors
    /// [`Error::Parameter`], which names the known sensors that fit.
    pub(crate) fn check(
        &self,
        points: &[[f32; 3]],
        others: &[(String, RayPattern)],
    ) -> Result<(), Error> {
        let Some(rays) = self.known.as_ref().filter(|_| self.checked < CHECKED_SCANS) else {
            return Ok(());
        };
        let seen = Elevations::of(points);
        if !seen.contradict(rays) {
            return Ok(());
        }
        let is_it = |other: &&(String, RayPattern)| other.1 == *rays;
        let stated = others.iter().find(is_it).map_or("its rays", |(name, _)| name);
        let fits = others.iter().filter(|(_, rays)| !seen.contradict(rays));
        let names: Vec<&str> = fits.map(|(name, _)| name.as_str()).collect();
        let cure =
            if names.is_empty() { "none of the known sensors".into() } else { names.join(", ") };
        Err(Error::Parameter {
            name: "sensor.beams",
            expected: "\"auto\", or the sensor that gave the scans",
            got: format!("{stated}, which the returns contradict; sensors that fit: {cure}"),
        })
    }

    /// True if the directions of rays are known for a scan at `stamp_ns`. A few scans may miss a
    /// part of the field of view, unless they are far apart: slow sensors look longer.
    pub(crate) fn is_known_at(&self, stamp_ns: i64) -> bool {
        let seconds = self.first_ns.map_or(0, |first| stamp_ns.saturating_sub(first));
        self.known.is_some() || self.scans >= ENOUGH_SCANS || seconds >= ENOUGH_NS
    }

    /// True if the rays of the sensor are in rows.
    pub(crate) fn has_rows(&self) -> bool {
        match &self.known {
            Some(rays) => matches!(rays, RayPattern::Rows { .. }),
            None => self.has_rows,
        }
    }

    /// Store what an accepted scan has shown.
    pub(crate) fn take(&mut self, observation: &mut SkyObservation, points: &[[f32; 3]]) {
        if !observation.leave(self) {
            return;
        }
        self.first_ns = self.first_ns.or(self.last_ns);
        if self.scans < LEARNING_SCANS || self.scans.is_multiple_of(LEARNING_STEP) {
            let (returns, lowest) = observation.seen_by_sensor();
            self.emission.learn(returns, lowest);
        }
        if self.checked < CHECKED_SCANS {
            let seen = Elevations::of(points);
            self.has_rows = seen.are_rows();
            self.checked += u32::from(seen.tell_enough());
        }
        self.scans = self.scans.saturating_add(1);
    }

    /// Discard all that depends on the position of the sensor.
    pub(crate) fn forget_places(&mut self) {
        self.evidence.fill(0.0);
        self.surface.fill(f32::INFINITY);
        self.surface_ns.fill(i64::MIN);
        self.since_ns.fill(NEVER);
        self.recent.clear();
        self.last_ns = None;
    }

    /// True if what was observed from the last place is still valid at `place`.
    fn sees_the_same_from(&self, place: [f64; 3]) -> bool {
        norm(minus(place, self.place)) <= SAME_PLACE
    }
}
