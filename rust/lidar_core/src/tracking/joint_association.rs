//! Joint probabilistic data association: probability of each measurement for each track.

use crate::estimation::assignment::Pair;
use std::collections::{BTreeMap, BTreeSet};

/// Largest number of joint events that are enumerated for targets with common measurements.
pub const MOST_EVENTS: usize = 10_000;
/// Largest number of rounds of messages of belief propagation.
const MOST_ROUNDS: usize = 100;
/// Largest change of a message at which the messages have converged.
const SETTLED: f64 = 1e-9;
/// Largest logarithm of a weight: sums of weights stay finite.
const LARGEST: f64 = 600.0;

/// Association probability of every pair.
///
/// The cost of a pair is minus the logarithm of a likelihood ratio: the measurement comes from the
/// track, to the track was missed and the measurement is clutter. Tracks with common measurements
/// form a group, whose joint events are enumerated: a measurement belongs to one track at most, and
/// a track has one measurement at most. Groups with more than [`MOST_EVENTS`] use belief
/// propagation instead, whose marginal probabilities are approximate where measurements and tracks
/// form loops.
///
/// # Source
/// Fortmann, Bar-Shalom & Scheffe, "Sonar tracking of multiple targets using joint probabilistic
/// data association", 1983; Williams & Lau, "Approximate evaluation of marginal association
/// probabilities with belief propagation", 2014.
#[must_use]
pub fn probabilities(tracks: usize, measurements: usize, pairs: &[Pair]) -> Vec<f64> {
    let mut found = vec![0.0; pairs.len()];
    let links = Links::new(tracks, measurements, pairs);
    // One table for all groups: a table per group would cost groups times measurements.
    let mut is_taken = vec![false; measurements];
    for group in links.groups(pairs) {
        let mut events = Events::new(&group, pairs, &mut is_taken);
        events.follow(0, 1.0);
        if events.count > MOST_EVENTS {
            let marginals = links.approximate(&group, pairs);
            group.iter().flatten().zip(marginals).for_each(|(index, share)| found[*index] = share);
            continue;
        }
        for (index, sum) in &events.sums {
            found[*index] = sum / events.total;
        }
    }
    found
}

/// The options of every track of a group, as indices of pairs.
type TrackOptions = Vec<Vec<usize>>;

/// Indices of the pairs of every track and of every measurement.
struct Links {
    of_track: Vec<Vec<usize>>,
    of_measurement: Vec<Vec<usize>>,
}

impl Links {
    fn new(tracks: usize, measurements: usize, pairs: &[Pair]) -> Self {
        let (mut of_track, mut of_measurement) =
            (vec![Vec::new(); tracks], vec![Vec::new(); measurements]);
        for (index, pair) in pairs.iter().enumerate() {
            of_track[pair.row].push(index);
            of_measurement[pair.column].push(index);
        }
        Self { of_track, of_measurement }
    }

    /// Groups of tracks linked by measurements, with their pairs; ordered by the first track.
    fn groups(&self, pairs: &[Pair]) -> Vec<TrackOptions> {
        let mut is_done = vec![false; self.of_track.len()];
        let mut found = Vec::new();
        for first in 0..self.of_track.len() {
            let (mut group, mut waiting) = (TrackOptions::new(), vec![first]);
            while let Some(row) = waiting.pop() {
                let options = &self.of_track[row];
                if std::mem::replace(&mut is_done[row], true) || options.is_empty() {
                    continue;
                }
                for index in options {
                    let linked = &self.of_measurement[pairs[*index].column];
                    let rows = linked.iter().map(|other| pairs[*other].row);
                    waiting.extend(rows.filter(|row| !is_done[*row]));
                }
                group.push(options.clone());
            }
            if !group.is_empty() {
                found.push(group);
            }
        }
        found
    }

    /// Marginal probabilities of a group by belief propagation, in the order of its pairs.
    ///
    /// Tracks and measurements exchange messages about the remaining weight of each pair; the
    /// messages converge for every group.
    fn approximate(&self, group: &TrackOptions, pairs: &[Pair]) -> Vec<f64> {
        // Longer than other functions: both directions of the messages and their weights share the
        // tables of the group.
        let own: Vec<usize> = group.iter().flatten().copied().collect();
        let weights = own.iter().map(|index| libm::exp((-pairs[*index].cost).min(LARGEST)));
        let weights: Vec<f64> = weights.collect();
        let place_of: BTreeMap<usize, usize> = own.iter().copied().zip(0..).collect();
        let columns: BTreeSet<usize> = own.iter().map(|index| pairs[*index].column).collect();
        let linked = |column: &usize| {
            self.of_measurement[*column].iter().map(|index| place_of[index]).collect()
        };
        let linked: Vec<Vec<usize>> = columns.iter().map(linked).collect();
        let starts = group.iter().scan(0, |next, options| {
            *next += options.len();
            Some(*next - options.len()..*next)
        });
        let rows: Vec<_> = starts.collect();
        let (mut to_measurement, mut to_track) = (vec![0.0; own.len()], vec![1.0; own.len()]);
        let mut others = Others::default();
        for _ in 0..MOST_ROUNDS {
            for row in &rows {
                others.fill(row.clone().map(|place| weights[place] * to_track[place]));
                for (place, rest) in row.clone().zip(&others.sums) {
                    to_measurement[place] = weights[place] / (1.0 + rest);
                }
            }
            let mut change = 0.0_f64;
            for places in &linked {
                others.fill(places.iter().map(|place| to_measurement[*place]));
                for (place, rest) in places.iter().zip(&others.sums) {
                    let told = 1.0 / (1.0 + rest);
                    change = change.max((told - to_track[*place]).abs());
                    to_track[*place] = told;
                }
            }
            if change < SETTLED {
                break;
            }
        }
        let mut found = vec![0.0; own.len()];
        for row in rows {
            let total: f64 = row.clone().map(|place| weights[place] * to_track[place]).sum();
            row.for_each(|place| found[place] = weights[place] * to_track[place] / (1.0 + total));
        }
        found
    }
}

/// For each of several values, the sum of all others.
#[derive(Default)]
struct Others {
    sums: Vec<f64>,
    values: Vec<f64>,
}

impl Others {
    /// Replace the sums by those of `values`. They are computed from the sums before and after each
    /// value, not as the total minus the value, because the values may differ by more orders of
    /// magnitude than a double can represent.
    fn fill(&mut self, values: impl Iterator<Item = f64>) {
        let Self { sums, values: kept } = self;
        kept.clear();
        kept.extend(values);
        let before = kept.iter().scan(0.0, |sum, value| {
            let before = *sum;
            *sum += value;
            Some(before)
        });
        sums.clear();
        sums.extend(before);
        let mut after = 0.0;
        for (sum, value) in sums.iter_mut().zip(&*kept).rev() {
            *sum += after;
            after += value;
        }
    }
}

/// Sum over all joint events of a group.
struct Events<'a> {
    group: &'a TrackOptions,
    pairs: &'a [Pair],
    /// Weights of the pairs of each track and of no pair, the largest of which is 1.
    weights: Vec<(Vec<f64>, f64)>,
    is_taken: &'a mut [bool],
    chosen: Vec<usize>,
    count: usize,
    total: f64,
    /// Sum of the weights of all events that contain a pair.
    sums: Vec<(usize, f64)>,
    /// Index of the first pair of each track in `sums`.
    starts: Vec<usize>,
}

impl<'a> Events<'a> {
    fn new(group: &'a TrackOptions, pairs: &'a [Pair], is_taken: &'a mut [bool]) -> Self {
        let weights = group.iter().map(|options| {
            let least = options.iter().map(|index| pairs[*index].cost).fold(0.0, f64::min);
            let weigh = |cost: f64| libm::exp(least - cost);
            (options.iter().map(|index| weigh(pairs[*index].cost)).collect(), weigh(0.0))
        });
        let starts = group.iter().scan(0, |next, options| {
            let start = *next;
            *next += options.len();
            Some(start)
        });
        Self {
            group,
            pairs,
            weights: weights.collect(),
            is_taken,
            chosen: Vec::with_capacity(group.len()),
            count: 0,
            total: 0.0,
            sums: group.iter().flatten().map(|index| (*index, 0.0)).collect(),
            starts: starts.collect(),
        }
    }

    /// Enumerate the events of tracks from `depth` on, given the weight of the choices so far.
    fn follow(&mut self, depth: usize, weight: f64) {
        if self.count > MOST_EVENTS {
            return;
        }
        let Some(options) = self.group.get(depth) else {
            self.count += 1;
            self.total += weight;
            self.chosen.iter().for_each(|place| self.sums[*place].1 += weight);
            return;
        };
        self.follow(depth + 1, weight * self.weights[depth].1);
        for (option, index) in options.iter().enumerate() {
            let column = self.pairs[*index].column;
            if self.is_taken[column] {
                continue;
            }
            self.is_taken[column] = true;
            self.chosen.push(self.starts[depth] + option);
            self.follow(depth + 1, weight * self.weights[depth].0[option]);
            self.chosen.pop();
            self.is_taken[column] = false;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pair(row: usize, column: usize, weight: f64) -> Pair {
        Pair { row, column, cost: -libm::log(weight) }
    }

    /// Two tracks, one measurement: events none, first, second, of weights 1, 3, 4.
    #[test]
    fn a_shared_measurement_is_of_one_track() {
        let found = probabilities(2, 1, &[pair(0, 0, 3.0), pair(1, 0, 4.0)]);
        assert!((found[0] - 3.0 / 8.0).abs() < 1e-15 && (found[1] - 0.5).abs() < 1e-15);
    }

    /// A group far away changes nothing; neither do weights that no double could hold.
    #[test]
    fn groups_are_independent_and_weights_may_be_large() {
        let near = [pair(0, 0, 3.0), pair(0, 1, 2.0), pair(2, 0, 1.0)];
        let alone = probabilities(3, 3, &near);
        let far = Pair { row: 1, column: 2, cost: -2000.0 };
        let both = probabilities(3, 3, &[near[0], far, near[1], near[2]]);
        assert_eq!([both[0], both[2], both[3]], [alone[0], alone[1], alone[2]]);
        assert_eq!(both[1], 1.0);
    }

    /// Propagation against enumeration: equal without loops, near with them.
    #[test]
    fn messages_tell_what_events_do() {
        let chain = [(0, 0, 3.0), (0, 1, 0.4), (1, 1, 7.0), (1, 2, 1.0), (2, 2, 0.2)];
        let mut state = 1_u64;
        let mut weight = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            libm::exp(8.0 * ((state >> 40) as f64 / 16_777_216.0) - 4.0)
        };
        let full: Vec<_> = (0..9).map(|k| (k / 3, k % 3, weight())).collect();
        for (tuples, near) in [(&chain[..], 1e-8), (&full[..], 0.15)] {
            let pairs: Vec<Pair> = tuples.iter().map(|(r, c, w)| pair(*r, *c, *w)).collect();
            let exact = probabilities(3, 3, &pairs);
            let links = Links::new(3, 3, &pairs);
            let mut told = vec![0.0; pairs.len()];
            for group in links.groups(&pairs) {
                let marginals = links.approximate(&group, &pairs);
                group.iter().flatten().zip(marginals).for_each(|(k, share)| told[*k] = share);
            }
            for (one, other) in exact.iter().zip(&told) {
                assert!((one - other).abs() < near, "{one} {other}");
            }
        }
    }

    /// Ten tracks over ten measurements have 234 million events.
    #[test]
    fn a_crowd_gets_the_approximation() {
        let all = (0..100).map(|k| pair(k / 10, k % 10, if k / 10 == k % 10 { 1e6 } else { 1.0 }));
        let pairs: Vec<Pair> = all.collect();
        let found = probabilities(10, 10, &pairs);
        for row in 0..10 {
            assert!(found[11 * row] > 0.999);
            assert!(found[10 * row..10 * row + 10].iter().sum::<f64>() <= 1.0);
        }
    }
}
