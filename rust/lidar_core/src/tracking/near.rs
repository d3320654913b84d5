//! Spatial index: search for the positions inside a rectangle.

/// Positions in the plane, in strips with equal numbers of positions, so that an outlier does not
/// enlarge the cells.
///
/// With N places there are about sqrt(N) strips of sqrt(N) places, so that a window visits the
/// strips that it touches and in each, by bisection, only places at its height.
#[derive(Clone, Debug, Default)]
pub struct NearIndex {
    strips: Vec<Strip>,
}

/// Places between two values of the first coordinate, by the second coordinate.
#[derive(Clone, Debug)]
struct Strip {
    first: f64,
    last: f64,
    places: Vec<([f64; 2], usize)>,
}

/// Rectangle, edges included.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rectangle {
    /// Smallest x and y.
    pub low: [f64; 2],
    /// Largest x and y.
    pub high: [f64; 2],
}

impl Rectangle {
    /// Rectangle that reaches `half` to each side of `center`.
    #[must_use]
    pub fn around(center: [f64; 2], half: [f64; 2]) -> Self {
        let [low, high] = [-1.0, 1.0].map(|side| [0, 1].map(|k| center[k] + side * half[k]));
        Self { low, high }
    }

    /// The window moved along the second coordinate.
    #[must_use]
    pub fn shifted(&self, by: f64) -> Self {
        Self { low: [self.low[0], self.low[1] + by], high: [self.high[0], self.high[1] + by] }
    }
}

impl NearIndex {
    /// Index of finite positions, each with its index.
    #[must_use]
    pub fn new(mut places: Vec<([f64; 2], usize)>) -> Self {
        let by = |k: usize| {
            move |a: &([f64; 2], usize), b: &([f64; 2], usize)| {
                a.0[k].total_cmp(&b.0[k]).then(a.1.cmp(&b.1))
            }
        };
        places.sort_by(by(0));
        let size = places.len().isqrt().max(1);
        let strips = places.chunks(size).filter_map(|strip| {
            let (first, last) = (strip.first()?.0[0], strip.last()?.0[0]);
            let mut places = strip.to_vec();
            places.sort_by(by(1));
            Some(Strip { first, last, places })
        });
        Self { strips: strips.collect() }
    }

    /// Append the indices of all positions in the rectangle, in no particular order.
    pub fn collect(&self, window: &Rectangle, found: &mut Vec<usize>) {
        let Rectangle { low, high } = window;
        let begin = self.strips.partition_point(|strip| strip.last < low[0]);
        for strip in self.strips[begin..].iter().take_while(|strip| strip.first <= high[0]) {
            let begin = strip.places.partition_point(|(at, _)| at[1] < low[1]);
            let level = strip.places[begin..].iter().take_while(|(at, _)| at[1] <= high[1]);
            let inside = level.filter(|(at, _)| low[0] <= at[0] && at[0] <= high[0]);
            found.extend(inside.map(|(_, number)| *number));
        }
    }

    /// True if a place lies within `distance` of `at`.
    #[must_use]
    pub fn is_near(&self, at: [f64; 2], distance: f64) -> bool {
        let begin = self.strips.partition_point(|strip| strip.last < at[0] - distance);
        let touched = self.strips[begin..].iter();
        touched.take_while(|strip| strip.first <= at[0] + distance).any(|strip| {
            let begin = strip.places.partition_point(|(place, _)| place[1] < at[1] - distance);
            let level = strip.places[begin..].iter();
            let mut level = level.take_while(|(place, _)| place[1] <= at[1] + distance);
            level.any(|(place, _)| libm::hypot(place[0] - at[0], place[1] - at[1]) < distance)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Places of a sequence of low discrepancy, and one far from them.
    fn places(count: usize) -> Vec<([f64; 2], usize)> {
        let place = |k: usize| [0.754_877_666, 0.569_840_290].map(|step| (k as f64 * step) % 1.0);
        let mut places: Vec<_> = (1..count).map(|k| (place(k), k)).collect();
        places.push(([1e9, -1e9], 0));
        places
    }

    #[test]
    fn a_rectangle_finds_what_comparing_with_every_place_finds() {
        for count in [1, 2, 7, 300] {
            let places = places(count);
            let index = NearIndex::new(places.clone());
            for (at, _) in &places {
                let window = Rectangle::around(*at, [0.07, 0.2]);
                let mut found = Vec::new();
                index.collect(&window, &mut found);
                found.sort_unstable();
                let inside =
                    |p: &[f64; 2]| (0..2).all(|k| window.low[k] <= p[k] && p[k] <= window.high[k]);
                let near = places.iter().filter(|(p, _)| inside(p)).map(|(_, number)| *number);
                let mut expected: Vec<usize> = near.collect();
                expected.sort_unstable();
                assert_eq!(found, expected);
                let others = |distance: f64| {
                    places.iter().any(|(p, _)| libm::hypot(p[0] - at[0], p[1] - at[1]) < distance)
                };
                assert_eq!(index.is_near(*at, 0.0), others(0.0));
                assert_eq!(index.is_near([at[0] + 0.03, at[1]], 0.02), {
                    let shifted = [at[0] + 0.03, at[1]];
                    let far = |p: &[f64; 2]| libm::hypot(p[0] - shifted[0], p[1] - shifted[1]);
                    places.iter().any(|(p, _)| far(p) < 0.02)
                });
            }
        }
    }

    #[test]
    fn no_places_are_near_nothing() {
        let mut found = Vec::new();
        let index = NearIndex::new(Vec::new());
        index.collect(&Rectangle::around([0.0; 2], [1e300; 2]), &mut found);
        assert!(found.is_empty() && !index.is_near([0.0; 2], 1e300));
    }
}
