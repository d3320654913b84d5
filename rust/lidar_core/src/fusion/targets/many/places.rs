//! Places of tracks and measurements: objects at rest, parts of long objects, extents of targets.

use super::company::{Bodies, Course, Fellow, keep_company};
use super::near_pairs::{Placed, clutter_at};
use super::parameters::{ManyParameters, TargetAssociation};
use super::track::{Assigned, Scan, TargetTrack};
use super::tracks::Tracks;
use crate::fusion::sensors::measurement::Measurement;
use crate::tracking::echo::PolarPlace;
use crate::tracking::near::{NearIndex, Rectangle};
use crate::tracking::spread::MeasuredSpread;
use crate::tracking::standing_clutter::PlaceLog;
use std::cmp::Reverse;
use std::collections::{BTreeMap, BTreeSet};

impl Tracks {
    /// Density of static clutter at each measurement [1/m^2]: zero if static targets are reported.
    pub(super) fn standing_clutter(
        &mut self,
        parameters: &ManyParameters,
        scan: &Scan,
        places: &[Placed],
        known: &mut BTreeMap<u8, PlaceLog>,
    ) -> Vec<f64> {
        if parameters.report_speed <= 0.0 {
            return vec![0.0; scan.measurements.len()];
        }
        let own = self.standing.entry(scan.source).or_default();
        let log = known.entry(scan.source).or_default();
        clutter_at((own, log), scan.stamp_ns, &scan.measurements, places)
    }

    /// Store the positions of the measurements of a scan for later scans, and update the extent of
    /// reported tracks.
    pub(super) fn learn_places(
        &mut self,
        parameters: &ManyParameters,
        scan: &Scan,
        places: &[Placed],
        known: &mut BTreeMap<u8, PlaceLog>,
    ) {
        let places: Vec<[f64; 2]> = places.iter().flatten().map(|(place, _)| *place).collect();
        if parameters.birth_distance > 0.0 {
            let reported = self.all.iter_mut().filter(|track| track.is_reported());
            let tracks = reported.filter_map(|track| {
                let place = track.place_at(scan.stamp_ns)?;
                Some((track.way.course(scan.stamp_ns, place), &mut track.spread))
            });
            measure_spread(tracks.collect(), parameters.birth_distance, &places);
        }
        if let Some(own) = self.standing.get_mut(&scan.source) {
            let log = known.entry(scan.source).or_default();
            own.take(log, scan.stamp_ns, places.into_iter());
        }
    }

    /// Decide for every confirmed track whether it is at rest or a part of another track. Tracks
    /// store their path from the first measurement on, so that a static object is not reported at
    /// first.
    pub(super) fn keep_company(&mut self, parameters: &ManyParameters, stamp_ns: i64) {
        let ManyParameters { report_speed, birth_distance, .. } = *parameters;
        if report_speed <= 0.0 && birth_distance <= 0.0 {
            return;
        }
        let fellows = self.all.iter_mut().filter_map(|track| {
            let place = track.place_at(stamp_ns)?;
            track.way.pass(stamp_ns, place);
            let rank = (Reverse(track.hits), track.born_ns, track.id);
            track.confirmed.then_some(Fellow { path: &mut track.way, place, rank })
        });
        keep_company(fellows.collect(), report_speed, birth_distance, stamp_ns);
    }

    /// Decide for every track of a target whether it is a double echo of a nearer one, for a radar
    /// whose position is known. A scan whose measurements state several positions is ignored.
    pub(super) fn hear_echoes(&mut self, parameters: &ManyParameters, scan: &Scan) {
        let mut places =
            scan.measurements.iter().filter(|m| !m.is_of_platform()).map(Measurement::seen_from);
        let Some(place) = places.next() else { return };
        let source = 1 << scan.source;
        let is_measured =
            |track: &TargetTrack| track.sources & source != 0 && track.history & 1 == 1;
        let Some(radar) = place.filter(|_| places.all(|other| other == place)) else {
            // What another scanner sees at its place is no echo of a radar's waves.
            if place.is_none() && self.radars & source == 0 {
                let measured = self.all.iter_mut().filter(|track| is_measured(track));
                measured.for_each(|track| track.echoes.deny());
            }
            return;
        };
        self.radars |= source;
        let ids: BTreeSet<i64> = self.all.iter().map(|track| track.id).collect();
        let own = self.all.iter_mut().filter(|track| track.is_of_target());
        let mut seen: Vec<(PolarPlace, &mut TargetTrack)> = own
            .filter_map(|track| {
                let output = track.filter.output_at(scan.stamp_ns)?;
                Some((PolarPlace::between(radar, [output.mean[0], output.mean[1]])?, track))
            })
            .collect();
        seen.sort_by(|(a, one), (b, other)| {
            a.range.total_cmp(&b.range).then(one.id.cmp(&other.id))
        });
        let stands = parameters.report_speed == 0.0;
        let mut targets: Vec<(i64, PolarPlace)> = Vec::new();
        for (sight, track) in seen {
            let beyond = is_measured(track).then_some((scan.stamp_ns, sight));
            track.echoes.compare(beyond, &targets, |id| ids.contains(&id), stands);
            if !track.echoes.is_echo {
                targets.push((track.id, sight));
            }
        }
    }

    /// Update the kind of every track measured by the scan, from its measured positions and from
    /// the probability that they are clutter.
    pub(super) fn learn_kinds(
        &mut self,
        parameters: &ManyParameters,
        scan: &Scan,
        assigned: &[Assigned],
    ) {
        let filter = &parameters.filter;
        let is_integrated = matches!(parameters.association, TargetAssociation::Integrated(_));
        let is_joint = matches!(parameters.association, TargetAssociation::Joint { .. });
        let speed = filter.prior.speed;
        let speed = if is_integrated { self.population.speed(speed) } else { speed };
        let mut seen: BTreeMap<i64, ([[f64; 3]; 2], f64)> = BTreeMap::new();
        // Seen from a sensor that moves, what stands moves, too.
        if !filter.is_seen_from_sensor() {
            for (m, one) in scan.measurements.iter().zip(assigned) {
                let Some(id) = one.id else { continue };
                let Some(sight) = self.unseen.sight(m) else { continue };
                let (sums, count) = seen.entry(id).or_default();
                for (sums, values) in sums.iter_mut().zip(sight) {
                    sums.iter_mut().zip(values).for_each(|(sum, value)| *sum += value);
                }
                *count += 1.0;
            }
        }
        let is_in_space = filter.is_in_space();
        for track in self.all.iter_mut().filter(|track| track.seen_ns == scan.stamp_ns) {
            let clutter = if is_integrated {
                Some(1.0 - track.existence())
            } else {
                is_joint.then(|| track.score.clutter())
            };
            track.kinds.tell_clutter(clutter);
            if let Some((sums, count)) = seen.get(&track.id) {
                let [place, told] = sums.map(|sum| sum.map(|value| value / count));
                track.kinds.see(scan.stamp_ns, (place, told), speed, is_in_space);
            }
        }
    }

    /// Tracks that were measured at `stamp_ns` [ns], with their courses.
    pub(super) fn bodies_at(&self, stamp_ns: i64) -> Bodies {
        let measured = self.all.iter().filter(|track| track.seen_ns == stamp_ns);
        let course =
            |track: &TargetTrack| Some(track.way.course(stamp_ns, track.place_at(stamp_ns)?));
        Bodies::new(measured.filter_map(course).collect())
    }
}

/// Update the measured spread of tracks, given with their courses. Every measurement counts for the
/// nearest track, if it is nearer than `reach` [m] and not too far to the side of its course.
fn measure_spread(mut tracks: Vec<(Course, &mut MeasuredSpread)>, reach: f64, places: &[[f64; 2]]) {
    let index = NearIndex::new(tracks.iter().map(|(own, _)| own.place).zip(0..).collect());
    let (mut near, mut offsets) = (Vec::new(), vec![Vec::new(); tracks.len()]);
    for place in places {
        near.clear();
        index.collect(&Rectangle::around(*place, [reach; 2]), &mut near);
        let away = |number: usize| [0, 1].map(|axis| place[axis] - tracks[number].0.place[axis]);
        let distance = |number: usize| libm::hypot(away(number)[0], away(number)[1]);
        let nearer = |a: &usize, b: &usize| distance(*a).total_cmp(&distance(*b)).then(a.cmp(b));
        let nearest = near.iter().copied().min_by(nearer);
        let is_of = |number: &usize| {
            distance(*number) < reach && !tracks[*number].0.is_abeam(*place, reach)
        };
        if let Some(number) = nearest.filter(is_of) {
            offsets[number].push(away(number));
        }
    }
    for ((_, spread), offsets) in tracks.iter_mut().zip(offsets) {
        spread.take(&offsets);
    }
}
