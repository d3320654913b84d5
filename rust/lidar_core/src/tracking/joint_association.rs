//! Joint probabilistic data association: probability of each measurement for each track.

use crate::estimation::assignment::Pair;

/// Most joint events that are enumerated for targets with common measurements.
pub const MOST_EVENTS: usize = 100_000;

/// Association probability of every pair.
///
/// The cost of a pair is minus the logarithm of a likelihood ratio: the track was measured so, over
/// the track was missed and the measurement is clutter. Tracks with common measurements form a
/// group, whose joint events are enumerated: a measurement belongs to one track at most, and a
/// track has one measurement at most. Groups with more than [`MOST_EVENTS`] use Fitzgerald's
/// approximation.
///
/// # Source
/// Fortmann, Bar-Shalom & Scheffe, "Sonar tracking of multiple targets using joint probabilistic
/// data association", 1983; Fitzgerald, "Development of practical PDA logic for multitarget
/// tracking by microprocessor", 1986.
#[must_use]
pub fn probabilities(tracks: usize, measurements: usize, pairs: &[Pair]) -> Vec<f64> {
    let mut found = vec![0.0; pairs.len()];
    let links = Links::new(tracks, measurements, pairs);
    // One table for all groups: a table per group would cost groups times measurements.
    let mut is_taken = vec![false; measurements];
    for group in links.groups(pairs) {
        let mut events = Events::new(&group, pairs, &mut is_taken);
        events.follow(0, 1.0);
        let is_whole = events.count <= MOST_EVENTS;
        let (total, sums) = (events.total, events.sums);
        for (index, sum) in sums {
            found[index] = if is_whole { sum / total } else { links.approximate(index, pairs) };
        }
    }
    found
}

/// The options of every track of a group: indices of pairs.
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

    /// Probability of a pair from its competing pairs, as if these had no further competitors.
    fn approximate(&self, index: usize, pairs: &[Pair]) -> f64 {
        let pair = &pairs[index];
        let against = |other: &usize| libm::exp(pair.cost - pairs[*other].cost);
        let of_track: f64 = self.of_track[pair.row].iter().map(against).sum();
        let of_measurement: f64 = self.of_measurement[pair.column].iter().map(against).sum();
        1.0 / (of_track + of_measurement - 1.0 + libm::exp(pair.cost))
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
