//! Exact area of a union of caps on the unit sphere.
//!
//! The border of the union consists of those arcs of the caps' rims that no other cap covers. By
//! the theorem of Gauss and Bonnet, the area to the left of a closed curve is a sum over its arcs,
//! up to whole spheres. Each arc contributes the triangle between its ends and any fixed point, and
//! the area between the arc and the great circle through its ends. The arc's cap gives both.

use crate::geometry::transform::{cross, dot, minus, norm};
use rayon::ThreadPool;
use rayon::prelude::*;
use std::collections::HashMap;
use std::f64::consts::PI;
use std::ops::Range;

const SPHERE: f64 = 4.0 * PI;

/// Caps whose centres are closer than this count as one [rad].
const SAME: f64 = 1e-10;
/// Shorter gaps in the coverage of a rim are ignored [rad].
const LEAST_GAP: f64 = 1e-12;
/// Longest piece of an arc [rad] whose ends are connected by a great circle.
const LONGEST_PIECE: f64 = 2.0;
/// Number of caps that are handed to a thread at a time. It is fixed, so that sums do not depend on
/// the threads.
const CAPS_PER_CHUNK: usize = 1024;
/// A fixed point of the sphere, chosen without any special position.
const POLE: [f64; 3] = [0.6, 0.48, 0.64];

/// A cap on the unit sphere: all directions within an angular radius of its centre.
#[derive(Clone, Copy, Debug)]
pub struct Cap {
    /// Centre: a unit vector.
    pub center: [f64; 3],
    /// Angular radius, 0 to pi [rad].
    pub radius: f64,
}

impl Cap {
    /// Area on the unit sphere [sr].
    #[must_use]
    pub fn area(&self) -> f64 {
        let sine = libm::sin(0.5 * self.radius);
        4.0 * PI * sine * sine
    }
}

/// Unit vectors, sorted into cells of several sizes, so that neighbours at any distance are found
/// quickly.
pub struct Directions {
    units: Vec<[f64; 3]>,
    /// Cells of some size, of twice this size, and so on.
    levels: Vec<Cells>,
}

impl Directions {
    /// Sort the vectors `units`, which have length 1; equal ones count once. `largest`: largest
    /// radius of the caps around them [rad].
    #[must_use]
    pub fn new(mut units: Vec<[f64; 3]>, largest: f64) -> Self {
        units.iter_mut().flatten().for_each(|value| *value += 0.0); // -0 becomes 0: their bits differ
        units.sort_unstable_by_key(|unit| unit.map(f64::to_bits));
        // About one direction per cell.
        let mut size = (4.0 * PI / units.len().max(1) as f64).sqrt().min(1.0);
        let all = Cells::new(&units, size);
        let is_first = |index: usize| {
            let mut near = all.around(units[index]);
            !near.any(|other| other < index && norm(minus(units[other], units[index])) < SAME)
        };
        let first: Vec<bool> = (0..units.len()).map(is_first).collect();
        let mut first = first.iter();
        units.retain(|_| first.next().copied().unwrap_or(false));
        let mut levels = vec![Cells::new(&units, size)];
        // Two caps can overlap if their centres are less than two radii apart.
        while size < 2.0 * largest {
            size *= 2.0;
            levels.push(Cells::new(&units, size));
        }
        Self { units, levels }
    }

    /// True if there are no directions.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.units.is_empty()
    }

    /// Area of the union of caps of `radius` [rad] around all directions, and of the caps `others`
    /// [sr].
    ///
    /// `radius` is at most pi/2 and at most the value `largest` of the constructor. No two of
    /// `others` may be equal.
    #[must_use]
    pub fn covered(&self, pool: &ThreadPool, radius: f64, others: &[Cap]) -> f64 {
        let part = |chunk: &[[f64; 3]]| -> f64 {
            chunk.iter().map(|&center| self.rim(Cap { center, radius }, others)).sum()
        };
        // Collected in order and summed afterwards: the same bits for any number of threads.
        let parts: Vec<f64> =
            pool.install(|| self.units.par_chunks(CAPS_PER_CHUNK).map(part).collect());
        let more = (0..others.len()).map(|index| self.rim_of_other(index, radius, others));
        let area = (parts.iter().sum::<f64>() + more.sum::<f64>()).rem_euclid(SPHERE);
        let own = if self.units.is_empty() { 0.0 } else { Cap { center: POLE, radius }.area() };
        let least = others.iter().map(Cap::area).fold(own, f64::max);
        if area < 0.5 * least { SPHERE } else { area } // the sum leaves whole spheres open
    }

    /// Contribution to the area of those arcs of a cap's rim that no other cap covers. The cap is
    /// around one of the directions.
    fn rim(&self, cap: Cap, others: &[Cap]) -> f64 {
        let frame = RimFrame::of(cap);
        let mut covered = CoveredArcs::default();
        for &other in others {
            frame.add_covered(&mut covered, other, false);
        }
        // The nearest caps cover most of a rim, so the others are tested only near the arcs that stay open.
        let mut gaps = vec![[0.0, 2.0 * PI]];
        let chord = 2.0 * libm::sin(0.5 * cap.radius);
        for cells in &self.levels {
            let open: Vec<_> = gaps.iter().map(|&gap| frame.ball_around(gap)).collect();
            for index in cells.around(cap.center) {
                let center = self.units[index];
                let meets = |(middle, reach): &([f64; 3], f64)| {
                    // Chords in place of angles: no arc cosine per candidate.
                    norm(minus(center, *middle)) <= chord + reach
                };
                if center != cap.center && open.iter().any(meets) {
                    frame.add_covered(&mut covered, Cap { center, ..cap }, false);
                }
            }
            covered.settle();
            gaps = covered.gaps();
            if gaps.is_empty() || cells.size >= 2.0 * cap.radius {
                break;
            }
        }
        frame.contribution(&gaps)
    }

    /// Contribution to the area of the rim of the cap `index` of `others`.
    fn rim_of_other(&self, index: usize, radius: f64, others: &[Cap]) -> f64 {
        let frame = RimFrame::of(others[index]);
        let mut covered = CoveredArcs::default();
        for (_, &other) in others.iter().enumerate().filter(|(other, _)| *other != index) {
            frame.add_covered(&mut covered, other, false);
        }
        for &center in &self.units {
            frame.add_covered(&mut covered, Cap { center, radius }, true);
        }
        covered.settle();
        frame.contribution(&covered.gaps())
    }
}

/// Indices of unit vectors, cell by cell.
struct Cells {
    size: f64,
    indices: Vec<usize>,
    /// For each cell, the range of its entries in `indices`.
    ranges: HashMap<[i32; 3], Range<usize>>,
}

impl Cells {
    fn new(units: &[[f64; 3]], size: f64) -> Self {
        let cell = |index: usize| cell(units[index], size);
        let mut indices: Vec<usize> = (0..units.len()).collect();
        indices.sort_unstable_by_key(|&index| (cell(index), index));
        let mut ranges = HashMap::new();
        let mut start = 0;
        for part in indices.chunk_by(|&a, &b| cell(a) == cell(b)) {
            ranges.insert(cell(part[0]), start..start + part.len());
            start += part.len();
        }
        Self { size, indices, ranges }
    }

    /// Indices of all vectors within a cell's size of `unit`, and some others.
    fn around(&self, unit: [f64; 3]) -> impl Iterator<Item = usize> {
        let [x, y, z] = cell(unit, self.size);
        (0..27)
            .filter_map(move |k| {
                self.ranges.get(&[x + k % 3 - 1, y + k / 3 % 3 - 1, z + k / 9 - 1])
            })
            .flat_map(|range| self.indices[range.clone()].iter().copied())
    }
}

fn cell(unit: [f64; 3], size: f64) -> [i32; 3] {
    unit.map(|value| (value / size).floor() as i32)
}

/// The rim of a cap. Angles along it are counted from `x` towards `y`.
struct RimFrame {
    center: [f64; 3],
    x: [f64; 3],
    y: [f64; 3],
    sine: f64,
    cosine: f64,
}

impl RimFrame {
    fn of(Cap { center, radius }: Cap) -> Self {
        // The axis furthest from the centre's direction keeps the cross product far from 0.
        let least = (0..3).fold(0, |a, b| if center[b].abs() < center[a].abs() { b } else { a });
        let axis = std::array::from_fn(|row| f64::from(u8::from(row == least)));
        let across = cross(axis, center);
        let length = norm(across);
        let x = across.map(|value| value / length);
        Self { center, x, y: cross(center, x), sine: libm::sin(radius), cosine: libm::cos(radius) }
    }

    /// Add the arc of this rim that `other` covers. `ties`: a cap that equals this one counts as
    /// covering all of the rim.
    fn add_covered(&self, covered: &mut CoveredArcs, other: Cap, ties: bool) {
        let (x, y) = (dot(self.x, other.center), dot(self.y, other.center));
        let (beside, along) = (libm::hypot(x, y), dot(self.center, other.center));
        let (needed, sine) = (libm::cos(other.radius) - self.cosine * along, self.sine * beside);
        // The rims do not cross: this one is covered as a whole or not at all.
        if beside < SAME || needed.abs() >= sine {
            if needed < 0.0 || (needed == 0.0 && ties) {
                covered.add(0.0, PI);
            }
            return;
        }
        covered.add(libm::atan2(y, x), libm::acos(needed / sine));
    }

    /// Centre and radius of a ball that contains an arc of the rim.
    fn ball_around(&self, [start, end]: [f64; 2]) -> ([f64; 3], f64) {
        if end - start > PI {
            return (self.center.map(|value| self.cosine * value), self.sine);
        }
        let middle = self.point(0.5 * (start + end));
        (middle, norm(minus(self.point(start), middle)) + SAME)
    }

    fn point(&self, angle: f64) -> [f64; 3] {
        let (x, y) = (self.sine * libm::cos(angle), self.sine * libm::sin(angle));
        std::array::from_fn(|axis| {
            self.cosine * self.center[axis] + x * self.x[axis] + y * self.y[axis]
        })
    }

    /// Area swept by the great circles from `POLE` to the arcs, up to whole spheres [sr].
    fn contribution(&self, arcs: &[[f64; 2]]) -> f64 {
        let mut area = 0.0;
        for &[start, end] in arcs {
            // Below pi the straight way between the ends is unique.
            let pieces = ((end - start) / LONGEST_PIECE).ceil();
            let turn = (end - start) / pieces;
            for piece in 0..pieces as u32 {
                let from = start + f64::from(piece) * turn;
                let ends = [self.point(from), self.point(from + turn)];
                // The sector of the cap less its triangle lies between the arc and the straight way.
                area += (1.0 - self.cosine) * turn - triangle(self.center, ends);
                area += triangle(POLE, ends);
            }
        }
        area
    }
}

/// Signed area of the spherical triangle of three unit vectors [sr].
///
/// # Source
/// Van Oosterom & Strackee, "The Solid Angle of a Plane Triangle", 1983.
fn triangle(a: [f64; 3], [b, c]: [[f64; 3]; 2]) -> f64 {
    2.0 * libm::atan2(dot(a, cross(b, c)), 1.0 + dot(a, b) + dot(b, c) + dot(c, a))
}

/// Covered arcs of a rim, as start and end angles from 0 to 2 pi [rad].
#[derive(Default)]
struct CoveredArcs {
    arcs: Vec<[f64; 2]>,
}

impl CoveredArcs {
    /// Add the arc of half width `half` (0 to pi) around the angle `middle` (-pi to pi) [rad].
    fn add(&mut self, middle: f64, half: f64) {
        let (start, end) = (middle - half, middle + half);
        self.arcs.push([start.max(0.0), end.min(2.0 * PI)]);
        if start < 0.0 {
            self.arcs.push([start + 2.0 * PI, (end + 2.0 * PI).min(2.0 * PI)]);
        }
    }

    /// Sort the arcs and merge those that overlap.
    fn settle(&mut self) {
        self.arcs.retain(|[start, end]| start < end);
        self.arcs.sort_unstable_by(|a, b| a[0].total_cmp(&b[0]));
        self.arcs.dedup_by(|next, kept| {
            let merges = next[0] <= kept[1] + LEAST_GAP;
            if merges {
                kept[1] = kept[1].max(next[1]);
            }
            merges
        });
    }

    /// The gaps between the covered arcs. Call `settle` before.
    fn gaps(&self) -> Vec<[f64; 2]> {
        let starts = std::iter::once(0.0).chain(self.arcs.iter().map(|arc| arc[1]));
        let ends = self.arcs.iter().map(|arc| arc[0]).chain(std::iter::once(2.0 * PI));
        starts
            .zip(ends)
            .filter(|(start, end)| end - start > LEAST_GAP)
            .map(|(start, end)| [start, end])
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Error;
    use crate::geometry::transform::direction_of;
    use crate::util::threads;

    fn covered(rays: &[[f64; 3]], radius: f64, others: &[Cap]) -> Result<f64, Error> {
        let units = rays.iter().filter_map(|&ray| direction_of(ray)).collect();
        Ok(Directions::new(units, radius).covered(&threads::pool(1)?, radius, others))
    }

    #[test]
    fn caps_apart_add_up() -> Result<(), Error> {
        let one = Cap { center: POLE, radius: 0.2 }.area();
        let axes = [[1.0, 0.0, 0.0], [0.0, 2.0, 0.0], [0.0, 0.0, -3.0], [1.0, 0.0, 0.0]];
        for count in 1..=3 {
            let area = covered(&axes[..count], 0.2, &[])?;
            assert!((area - count as f64 * one).abs() < 1e-12, "{count}: {area}");
        }
        assert!((covered(&axes, 0.2, &[])? - 3.0 * one).abs() < 1e-12); // twice the same: once
        assert_eq!(covered(&[], 0.2, &[])?, 0.0);
        Ok(())
    }

    #[test]
    fn two_caps_share_a_lens() -> Result<(), Error> {
        let (radius, away) = (0.5f64, 0.6f64);
        let units = [[1.0, 0.0, 0.0], [libm::cos(away), libm::sin(away), 0.0]];
        // The lens by polar coordinates about the first cap, beyond the middle line.
        let rows = 200_000;
        let half = libm::acos(libm::tan(away / 2.0) / libm::tan(radius));
        let lens: f64 = (0..rows)
            .map(|row| half * (2.0 * (f64::from(row) + 0.5) / f64::from(rows) - 1.0))
            .map(|angle| libm::cos(libm::atan(libm::tan(away / 2.0) / libm::cos(angle))))
            .map(|cosine| (cosine - libm::cos(radius)) * 2.0 * half / f64::from(rows))
            .sum();
        let exact = 2.0 * Cap { center: POLE, radius }.area() - 2.0 * lens;
        assert!((covered(&units, radius, &[])? - exact).abs() < 1e-9);
        Ok(())
    }

    #[test]
    fn enough_caps_cover_everything() -> Result<(), Error> {
        let axes: Vec<[f64; 3]> = (0..6)
            .map(|k| {
                std::array::from_fn(|a| if a == k / 2 { 1.0 - 2.0 * (k % 2) as f64 } else { 0.0 })
            })
            .collect();
        assert_eq!(covered(&axes, 1.0, &[])?, SPHERE); // corners are 0.955 rad away
        let corner_gaps = SPHERE - covered(&axes, 0.95, &[])?;
        assert!(0.0 < corner_gaps && corner_gaps < 2e-3, "{corner_gaps}");
        Ok(())
    }

    #[test]
    fn a_cap_inside_another_adds_nothing() -> Result<(), Error> {
        let big = Cap { center: [0.0, 0.0, 1.0], radius: 2.5 };
        for unit in [[0.0, 0.0, 1.0], [0.3, 0.2, 0.8]] {
            assert!((covered(&[unit], 0.4, &[big])? - big.area()).abs() < 1e-12);
        }
        let same = Cap { center: [0.0, 0.0, 1.0], radius: 0.4 };
        assert!((covered(&[same.center], 0.4, &[same])? - same.area()).abs() < 1e-12);
        Ok(())
    }
}
