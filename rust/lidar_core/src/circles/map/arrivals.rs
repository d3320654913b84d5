//! Probability that an unexplained measurement is an object, and not a random group of hits. It is
//! learnt from earlier new elements, for each class of place ([`BirthPlace`]).

use super::view::earlier::Trace;
use serde::{Deserialize, Serialize};

/// What earlier scans saw at the place of a new element.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(super) enum BirthPlace {
    /// Earlier scans did not see the place.
    Revealed,
    /// Earlier scans saw free space: an object came, or a part of one.
    Free,
    /// Earlier scans saw a surface that belongs to no element.
    Surface,
    /// Too few rays hit the new object to show its size. It is often a piece of a wall that is
    /// visible between two other objects.
    Piece,
}

/// Number of classes of places.
const SORTS: usize = 4;
/// Initial shares of objects among new elements, in the order of [`BirthPlace`].
const PRIOR: [f64; SORTS] = [0.85, 0.7, 0.6, 0.5];
/// Weight of the initial shares, as a number of elements.
const WEIGHT: f64 = 5.0;
/// Number of later elements after which the weight of an element has fallen to 1/e.
const MEMORY: f64 = 100.0;
/// Largest probability that a new element is an object: one scan is no proof.
const MOST: f64 = 0.94;
/// Share of points on earlier surfaces, above which the place of a new element counts as
/// [`BirthPlace::Surface`].
const THERE: f64 = 0.5;
/// Standard deviation above which a radius counts as unknown [m].
const VAGUE: f64 = 0.1;

impl BirthPlace {
    /// Class of a place, from what earlier scans saw there and from the variance of the measured
    /// radius [m^2].
    pub(super) fn of(trace: Option<Trace>, variance: f64) -> Self {
        match trace {
            _ if variance > VAGUE * VAGUE => Self::Piece,
            None => Self::Revealed,
            Some(there) if there < THERE => Self::Free,
            Some(_) => Self::Surface,
        }
    }
}

/// Counts per class of place: elements that started there, and how many of them were objects. The
/// weight of old elements decreases.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct Arrivals {
    objects: [f64; SORTS],
    all: [f64; SORTS],
}

impl Arrivals {
    /// Probability that a measurement that no element explains is an object.
    pub(super) fn share(&self, place: BirthPlace) -> f64 {
        let sort = place as usize;
        let share = (PRIOR[sort] * WEIGHT + self.objects[sort]) / (WEIGHT + self.all[sort]);
        share.min(MOST)
    }

    /// Count an element that started at `place`. `existence`: probability that it was an object.
    pub(super) fn learn(&mut self, place: BirthPlace, existence: f64) {
        let sort = place as usize;
        let kept = 1.0 - 1.0 / MEMORY;
        self.objects[sort] = kept * self.objects[sort] + existence;
        self.all[sort] = kept * self.all[sort] + 1.0;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shares_are_learnt_for_each_sort_of_place() {
        let mut arrivals = Arrivals::default();
        let [revealed, free] =
            [BirthPlace::Revealed, BirthPlace::Free].map(|place| arrivals.share(place));
        for number in 0..300 {
            arrivals.learn(BirthPlace::Free, if number % 4 == 0 { 1.0 } else { 0.02 });
        }
        assert_eq!(arrivals.share(BirthPlace::Revealed), revealed);
        let learnt = arrivals.share(BirthPlace::Free);
        assert!(learnt < free && (0.2..0.33).contains(&learnt), "{learnt}");
    }

    #[test]
    fn places_follow_from_what_was_met_there() {
        let places = [None, Some(0.1), Some(0.9)].map(|trace| BirthPlace::of(trace, 1e-4));
        assert_eq!(places, [BirthPlace::Revealed, BirthPlace::Free, BirthPlace::Surface]);
        assert_eq!(BirthPlace::of(None, 0.04), BirthPlace::Piece);
    }
}
