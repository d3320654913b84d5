//! Search for the height of flat ground in the returns.
//!
//! The lowest returns are not always on the ground: a wet or polished floor mirrors what stands on
//! it, and the returns of mirrored rays are below it. A flat floor has many returns at one height,
//! from near and far. Walls and their mirror images have returns at all heights.

/// Height of a layer in which returns are counted [m].
const LAYER: f64 = 0.1;
/// Smallest depth of the floor below the sensor [m]. The rows beside the horizon look like layers,
/// too.
const LEAST_DEPTH: f64 = 0.5;
/// Largest depth of the floor below the sensor [m].
const MOST_DEPTH: f64 = 100.0;
/// Smallest share of all returns in the two layers of a floor.
const LEAST_SHARE: f64 = 0.1;
/// Smallest ratio of the returns on the floor to those in the layers next to it.
const CONTRAST: u32 = 3;
/// Smallest number of returns on a floor. Fewer may be of one thing.
const ENOUGH: u32 = 50;
/// Smallest ratio of the distances of the floor's far and near parts.
const RATIO: f64 = 1.8;

/// Search for the floor. It keeps its memory for the next scan.
#[derive(Default)]
pub(super) struct FloorFinder {
    counts: Vec<u32>,
    ranges: Vec<f64>,
}

impl FloorFinder {
    /// Height of the lowest floor relative to the sensor [m]. `samples`: range and height relative
    /// to the sensor of returns [m]. None if there is no floor.
    pub(super) fn find(&mut self, samples: &[[f64; 2]]) -> Option<f64> {
        self.counts.clear();
        self.counts.resize((MOST_DEPTH / LAYER) as usize, 0);
        for depth in samples.iter().map(|[_, height]| -height) {
            let layer = (depth / LAYER).max(0.0) as usize; // all above the sensor in the first
            if let Some(count) = self.counts.get_mut(layer) {
                *count += 1;
            }
        }
        let first = (LEAST_DEPTH / LAYER) as usize;
        let least = ((LEAST_SHARE * samples.len() as f64) as u32).max(ENOUGH);
        let pair = |layer: usize| -> u32 { self.counts.iter().skip(layer).take(2).sum() };
        let stands_out = |layer: usize| {
            let here = pair(layer);
            // One layer apart: noise of the ranges spreads the floor over its neighbours.
            let (above, below) = (pair(layer - 3), pair(layer + 3));
            here >= least && here >= CONTRAST * above.max(below)
        };
        let layer = (first..self.counts.len()).rev().find(|&layer| stands_out(layer))?;
        let inside = -LAYER * (layer as f64 + 2.0)..-LAYER * layer as f64;
        self.ranges.clear();
        let of_floor = samples.iter().filter(|[_, height]| inside.contains(height));
        self.ranges.extend(of_floor.map(|[range, _]| range));
        let near = super::observation::ranked(&mut self.ranges, 0.1);
        let far = super::observation::ranked(&mut self.ranges, 0.9);
        (far >= RATIO * near).then_some(inside.start + LAYER)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns at evenly spread heights, all at one range, as those of a wall [m].
    fn wall(range: f64, low: f64, high: f64, count: usize) -> impl Iterator<Item = [f64; 2]> {
        (0..count).map(move |index| [range, low + (high - low) * index as f64 / count as f64])
    }

    fn ground(height: f64, count: usize) -> impl Iterator<Item = [f64; 2]> {
        (0..count).map(move |index| {
            let noise = 0.03 * ((index % 7) as f64 / 3.0 - 1.0);
            [4.0 + 16.0 * index as f64 / count as f64, height + noise]
        })
    }

    fn found(samples: impl Iterator<Item = [f64; 2]>) -> Option<f64> {
        FloorFinder::default().find(&samples.collect::<Vec<_>>())
    }

    #[test]
    fn a_floor_that_mirrors_lies_above_its_mirror_images() {
        let mirrored = wall(14.0, -9.0, -2.0, 300);
        let all = ground(-1.9, 500).chain(wall(12.0, -1.9, 6.0, 900)).chain(mirrored);
        let height = found(all).unwrap_or_default();
        assert!((height + 1.9).abs() < 0.15, "{height}");
    }

    #[test]
    fn a_floor_at_the_edge_of_a_layer_is_found_too() {
        for step in 0..20 {
            let depth = 1.5 + 0.01 * f64::from(step);
            let height = found(ground(-depth, 400).chain(wall(9.0, -depth, 5.0, 400)));
            assert!(height.is_some_and(|height| (height + depth).abs() < 0.16), "{depth}");
        }
    }

    #[test]
    fn walls_rows_and_things_are_no_floor() {
        assert_eq!(found(wall(5.0, -4.0, 4.0, 2000)), None);
        // A row a little below the horizon in a room.
        let row = (0..400).map(|index| 3.0 + 7.0 * f64::from(index) / 400.0);
        assert_eq!(found(row.map(|range| [range, -0.05 * range])), None);
        // A table, all of it at one distance.
        let table = wall(3.0, -0.95, -0.9, 400);
        assert_eq!(found(table.chain(wall(5.0, -2.0, 4.0, 600))), None);
        assert_eq!(found(ground(-1.9, 40)), None); // too few
    }
}
