//! Count of hits next to hits, in several directions across the line of sight.

use super::filled::SpreadEllipse;
use serde::{Deserialize, Serialize};

/// Number of directions across the line of sight in which neighbours are counted.
pub(crate) const DIRECTIONS: usize = 4;
/// Least numbers of hits and of rays that missed the target whose neighbours are counted.
const FEWEST_HITS: usize = 8;
const FEWEST_MISSED: usize = 4;
/// Number of hits whose neighbours are counted, at most.
const MOST_COMPARED: usize = 32;
/// Largest distance of a neighbour, in distances between neighbouring rays: beyond it, a ray between may be unknown.
const NEXT: f64 = 2.0;
/// Tangent of half the angle between two directions.
const TANGENT: f64 = std::f64::consts::SQRT_2 - 1.0;

/// Hits next to hits beyond chance, by direction: every 45 degrees, the first is horizontal.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Coherence {
    /// Number of rays next to hits that are hits, less the number expected by chance.
    pub excess: [f64; DIRECTIONS],
    /// The same number if all rays next to hits were hits.
    pub possible: [f64; DIRECTIONS],
}

/// Number of hits among the nearest rays on both sides of hits, in every direction, beyond chance. Only rays inside the
/// ellipse around the hits count, and neighbours within two distances between rays (`ray_gap` [m]). `hits` and `passing` are in a plane across the line of sight [m]. Zero if too few
/// rays hit or miss.
pub(super) fn coherence(hits: &[[f64; 2]], passing: &[[f64; 2]], ray_gap: f64) -> Coherence {
    let ellipse = SpreadEllipse::of(hits, ray_gap);
    let inside = |rays: &[[f64; 2]]| -> Vec<[f64; 2]> {
        rays.iter().copied().filter(|&ray| ellipse.holds(ray)).collect()
    };
    let (hits, missed) = (inside(hits), inside(passing));
    let mut found = Coherence::default();
    if hits.len() < FEWEST_HITS || missed.len() < FEWEST_MISSED {
        return found;
    }
    let chance = (hits.len() - 1) as f64 / (hits.len() + missed.len() - 1) as f64;
    let reach = NEXT * ray_gap;
    for &hit in hits.iter().step_by(hits.len().div_ceil(MOST_COMPARED)) {
        for (side, nearest) in nearest_around(hit, &hits, &missed).into_iter().enumerate() {
            let Some(nearest) = nearest.filter(|other| other.squared <= reach * reach) else {
                continue;
            };
            found.excess[side % DIRECTIONS] += f64::from(u8::from(nearest.is_hit)) - chance;
            found.possible[side % DIRECTIONS] += 1.0 - chance;
        }
    }
    found
}

/// The nearest ray to a side of another one.
#[derive(Clone, Copy)]
struct Neighbour {
    /// Squared distance [m^2].
    squared: f64,
    is_hit: bool,
}

/// The nearest ray around `place` to every side: along all directions, then against them. Of rays at the same distance
/// the one that missed counts. Rays at the place itself do not count.
fn nearest_around(
    place: [f64; 2],
    hits: &[[f64; 2]],
    missed: &[[f64; 2]],
) -> [Option<Neighbour>; 2 * DIRECTIONS] {
    let mut nearest = [None::<Neighbour>; 2 * DIRECTIONS];
    let all = missed.iter().map(|ray| (ray, false)).chain(hits.iter().map(|ray| (ray, true)));
    for (ray, is_hit) in all {
        let off = [ray[0] - place[0], ray[1] - place[1]];
        let squared = off[0] * off[0] + off[1] * off[1];
        if squared > 0.0 {
            let slot = &mut nearest[side_of(off)];
            if slot.is_none_or(|other| squared < other.squared) {
                *slot = Some(Neighbour { squared, is_hit });
            }
        }
    }
    nearest
}

/// Index of the side to which an offset points: 0 to 3 for 0, 45, 90 and 135 degrees from the first axis, 4 to 7 for
/// the opposite sides.
fn side_of([x, y]: [f64; 2]) -> usize {
    let (direction, is_along) = if y.abs() <= TANGENT * x.abs() {
        (0, x > 0.0)
    } else if x.abs() < TANGENT * y.abs() {
        (2, y > 0.0)
    } else if (x > 0.0) == (y > 0.0) {
        (1, y > 0.0)
    } else {
        (3, y > 0.0)
    };
    if is_along { direction } else { direction + DIRECTIONS }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Largest coherence over the directions of rays in 24 rows and columns, of which those hit that `is_hit` names.
    /// `gaps`: distances between columns and between rows [m].
    fn largest(gaps: [f64; 2], is_hit: impl Fn(i32, i32) -> bool) -> Option<f64> {
        let rays = (0..24).flat_map(|row| (0..24).map(move |column| (row, column)));
        let place =
            |(row, column): (i32, i32)| [gaps[0] * f64::from(column), gaps[1] * f64::from(row)];
        let (hits, missed): (Vec<_>, Vec<_>) = rays.partition(|&(row, column)| is_hit(row, column));
        let [hits, missed] =
            [hits, missed].map(|rays| rays.into_iter().map(place).collect::<Vec<_>>());
        let found = coherence(&hits, &missed, (gaps[0] * gaps[1]).sqrt());
        let of = |side: usize| found.excess[side] / found.possible[side];
        (0..DIRECTIONS).filter(|&side| found.possible[side] > 0.0).map(of).max_by(f64::total_cmp)
    }

    #[test]
    fn the_sides_are_an_eighth_of_a_circle_each() {
        for side in 0..360 {
            let angle = f64::from(side).to_radians() + 0.005;
            let (sine, cosine) = (libm::sin(angle), libm::cos(angle));
            let eighth = ((f64::from(side) + 22.5 + 0.3) / 45.0) as usize % 8;
            assert_eq!(side_of([cosine, sine]), eighth, "{side} degrees");
        }
    }

    #[test]
    fn dust_is_met_at_random() {
        let mixed = |row: i32, column: i32| {
            let mut word = (row * 24 + column) as u64;
            for _ in 0..3 {
                word = (word ^ (word >> 29)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
                word ^= word >> 32;
            }
            (word >> 33) % 100
        };
        for share in [20, 40, 60] {
            let found = largest([0.02; 2], |row, column| mixed(row, column) < share);
            assert!(found.is_some_and(|found| found < 0.25), "{share}: {found:?}");
        }
    }

    #[test]
    fn bodies_are_coherent_along_one_direction_at_least() {
        let cross =
            |row: i32, column: i32| (row - column).abs() < 2 || (row + column - 23).abs() < 2;
        let is_body = |found: Option<f64>| found.is_some_and(|found| found > 0.4);
        assert!(is_body(largest([0.02; 2], cross)));
        assert!(is_body(largest([0.02; 2], |row, _| row % 12 < 6)));
        // A wing and a fuselage of one row or column, also where rows are closer than columns or farther apart.
        let level = |row: i32, column: i32| row == 12 || column == 12 && row.abs_diff(12) < 5;
        let upright = |row: i32, column: i32| level(column, row);
        for gaps in [[0.02, 0.02], [0.04, 0.02], [0.02, 0.04], [0.06, 0.02]] {
            assert!(is_body(largest(gaps, level)), "level, {gaps:?}");
            assert!(is_body(largest(gaps, upright)), "upright, {gaps:?}");
        }
        let banked =
            |row: i32, column: i32| row == column || row + column == 23 && row.abs_diff(12) < 5;
        assert!(is_body(largest([0.02; 2], banked)));
    }

    #[test]
    fn few_rays_show_nothing() {
        assert_eq!(largest([0.02; 2], |row, column| row == 0 && column < 7), None);
        assert_eq!(largest([0.02; 2], |_, _| true), None);
    }
}
