//! Late scans: the map returns to its state before such a scan, and processes it and all later
//! scans again.

use super::independent::{Elements, new_number};
use super::rules::Rules;
use super::scan::KeptScan;
use super::view::earlier::Earlier;
use super::{MapOutcome, seconds};
use crate::Error;
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;

/// Largest number of scans kept, whatever their time.
const MAX_SCANS: usize = 1_000;

/// A processed scan, and the elements as they were before it.
#[derive(Clone, Serialize, Deserialize)]
struct Entry {
    before: Elements,
    scan: KeptScan,
}

/// Elements, and the recent scans that led to them.
#[derive(Default, Serialize, Deserialize)]
pub(super) struct History {
    pub(super) now: Elements,
    pub(super) earlier: Earlier,
    entries: VecDeque<Entry>,
    newest: Option<(i64, u32)>,
}

impl History {
    /// True if the parts of a restored state agree.
    pub(super) fn fits(&self, rules: &Rules) -> bool {
        let motion = rules.motion();
        let is_sound = |entry: &Entry| entry.before.fits(motion) && entry.scan.is_sound();
        self.entries.len() <= MAX_SCANS
            && self.now.fits(motion)
            && self.earlier.is_sound()
            && self.entries.iter().all(is_sound)
            && self.entries.iter().map(|entry| entry.scan.key()).is_sorted()
    }

    /// True if a scan comes before the newest one.
    ///
    /// # Errors
    /// [`Error::Time`] if it was processed already, or comes too late.
    pub(super) fn is_late(&self, key: (i64, u32)) -> Result<bool, Error> {
        let Some(newest) = self.newest.filter(|&newest| key <= newest) else { return Ok(false) };
        let refuse = |what| Err(Error::Time { what });
        if key == newest || self.entries.iter().any(|entry| entry.scan.key() == key) {
            let (stamp_ns, sensor) = key;
            return refuse(format!("scan of {stamp_ns} ns from sensor {sensor}: it was processed"));
        }
        match self.entries.front() {
            Some(oldest) if key.0 >= oldest.scan.from.stamp_ns => Ok(true),
            _ => refuse(format!(
                "scan of {} ns: it comes later than the map can go back from {} ns; {}",
                key.0,
                newest.0,
                self.cure()
            )),
        }
    }

    /// Remedy for scans that come too late.
    fn cure(&self) -> String {
        if self.entries.len() < MAX_SCANS {
            return "raise `buffer_time`".into();
        }
        format!("it keeps the last {MAX_SCANS} scans at most, whatever `buffer_time`")
    }

    /// Process a scan at its place in time.
    ///
    /// # Errors
    /// Errors of [`History::is_late`] and [`Elements::step`]; nothing changes then.
    pub(super) fn push(
        &mut self,
        rules: &Rules,
        mut scan: KeptScan,
        next_id: &mut i64,
    ) -> Result<MapOutcome, Error> {
        if self.is_late(scan.key())? {
            return self.insert(rules, scan, next_id);
        }
        let mut number = *next_id; // an error must not leave anything changed
        let mut now = self.now.clone();
        let merged = now.step(rules, &mut scan, &mut number)?;
        let before = std::mem::replace(&mut self.now, now);
        let found = scan.found();
        self.earlier.keep(&scan.from);
        self.newest = Some(scan.key());
        self.entries.push_back(Entry { before, scan });
        self.forget(rules.parameters().buffer_time);
        *next_id = number;
        Ok(MapOutcome { late: false, found, merged })
    }

    /// Process a late scan, and all scans after it again.
    fn insert(
        &mut self,
        rules: &Rules,
        mut scan: KeptScan,
        next_id: &mut i64,
    ) -> Result<MapOutcome, Error> {
        let mut number = *next_id;
        let place = self.entries.partition_point(|entry| entry.scan.key() < scan.key());
        // All work is done on copies: after an error the map is as before.
        let mut after: Vec<Entry> = self.entries.range(place..).cloned().collect();
        let mut now = after.first().map_or_else(Elements::default, |entry| entry.before.clone());
        let before = now.clone();
        let mut merged = now.step(rules, &mut scan, &mut number)?;
        let mut pairs = Vec::new();
        for entry in &mut after {
            let known: Vec<_> = entry.scan.elements().copied().collect();
            entry.before = now.clone();
            let again = now.step(rules, &mut entry.scan, &mut number)?;
            // Mergers of elements that were never reported would be news about nothing.
            merged.extend(again.into_iter().filter(|&[_, gone]| self.now.holds(gone)));
            pairs.extend(known.into_iter().zip(entry.scan.elements().copied()));
        }
        // Going over the scans again may give an object a new number. The user knows it by the old
        // one.
        let renamed = renamed(&pairs, &self.now, &now);
        after.insert(0, Entry { before, scan });
        rename(&mut now, &mut after, &mut merged, &renamed);
        self.entries.truncate(place);
        self.entries.extend(after);
        let fresh = fresh_numbers(&self.now, &now, *next_id, &mut number);
        rename(&mut now, self.entries.make_contiguous(), &mut merged, &fresh);
        // A merged element may exist again after the change: then it was not merged.
        merged.retain(|&[_, gone]| !now.holds(gone));
        let found = self.entries[place].scan.found();
        (self.now, *next_id) = (now, number);
        self.forget(rules.parameters().buffer_time);
        Ok(MapOutcome { late: true, found, merged })
    }

    /// Remove scans older than `buffer_time` [s].
    fn forget(&mut self, buffer_time: f64) {
        let Some((newest_ns, _)) = self.newest else { return };
        let is_old = |entry: &Entry| seconds(entry.scan.from.stamp_ns, newest_ns) > buffer_time;
        while self.entries.len() > MAX_SCANS || self.entries.front().is_some_and(is_old) {
            self.entries.pop_front();
        }
    }
}

/// Elements with a new ID whose circles belonged to a reported element that no longer exists: pairs
/// of the new ID and the reported ID, which they keep.
fn renamed(
    pairs: &[(Option<i64>, Option<i64>)],
    before: &Elements,
    now: &Elements,
) -> Vec<(i64, i64)> {
    let mut renamed: Vec<(i64, i64)> = Vec::new();
    for &pair in pairs {
        let (Some(old), Some(new)) = pair else { continue };
        let is_gone = before.holds(old) && !now.holds(old);
        let is_fresh = now.holds(new) && !before.holds(new);
        let is_known = renamed.iter().any(|&(from, to)| from == new || to == old);
        if is_gone && is_fresh && !is_known {
            renamed.push((new, old));
        }
    }
    renamed
}

/// New IDs for elements that came back with an ID that was reported as removed, or that was never
/// reported.
fn fresh_numbers(
    before: &Elements,
    now: &Elements,
    first_new: i64,
    next_id: &mut i64,
) -> Vec<(i64, i64)> {
    let is_back = |id: &i64| *id < first_new && !before.holds(*id);
    let back = now.numbers().map(|(id, _)| id).filter(is_back);
    back.map(|id| {
        *next_id += 1;
        (id, *next_id - 1)
    })
    .collect()
}

/// Change the IDs of elements everywhere.
fn rename(
    now: &mut Elements,
    entries: &mut [Entry],
    merged: &mut [[i64; 2]],
    numbers: &[(i64, i64)],
) {
    if numbers.is_empty() {
        return;
    }
    now.rename(numbers);
    for entry in entries {
        entry.before.rename(numbers);
        for element in entry.scan.elements_mut().flatten() {
            *element = new_number(*element, numbers);
        }
    }
    for id in merged.iter_mut().flatten() {
        *id = new_number(*id, numbers);
    }
}
