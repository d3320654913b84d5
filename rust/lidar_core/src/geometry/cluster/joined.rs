//! Clustering of clouds in which it is known that some points belong together.
//!
//! Such joined points need no links among each other, and those out of reach of all other points can be ignored. So
//! the number of the other points determines the cost.

use super::angular_gap::{AngularGap, SeenLabeller};
use super::keys::is_finite;
use super::octree_link::check_extent;
use super::{Clustering, NOISE, check};
use crate::Error;
use crate::geometry::lattice::{least, whole, wide};
use crate::util::budget::check_points;
use crate::util::cancel;
use crate::util::vector_unit::dispatch;
use pulp::{Simd, WithSimd};
use rayon::ThreadPool;

/// Relative margin of the cell size for rounding errors.
const MARGIN: f64 = 1e-6;
/// Number of points whose cells are found at a time.
const LANES: usize = 16;
/// Temporary label of clusters without a label yet. `JOINED`: of clusters that contain joined points.
const UNNAMED: i32 = -2;
const JOINED: i32 = -3;

/// Labels clouds, one after another. It keeps its memory.
#[derive(Default)]
pub(crate) struct JoinedLabeller {
    whole: SeenLabeller,
    labels: Vec<i32>,
    /// Indices of the points that are searched, ascending: points that are not joined, and joined points near them.
    rows: Vec<u32>,
    points: Vec<[f32; 3]>,
    cells: ReachCells,
    /// Label of each cluster of the searched points.
    named: Vec<i32>,
    /// Indices of the points that are not joined, with their labels.
    others: Vec<(u32, i32)>,
    /// Label of the joined points. None if none is joined, or if the last cloud was labelled without joined points.
    joined: Option<i32>,
}

impl JoinedLabeller {
    /// Label one cloud, like [`label_seen`](super::angular_gap::label_seen).
    ///
    /// # Errors
    /// As [`label_seen`](super::angular_gap::label_seen).
    pub(crate) fn label(
        &mut self,
        points: &[[f32; 3]],
        gap: &AngularGap,
        clustering: &Clustering,
        pool: Option<&ThreadPool>,
    ) -> Result<(), Error> {
        self.joined = None;
        self.whole.label(points, gap, clustering, pool).map(drop)
    }

    /// Label one cloud as if all points with `is_joined` were linked to each other. Clusters of any size count.
    /// Afterwards [`Self::searched`] includes all joined points within `reach` [m] of others, and more.
    ///
    /// # Errors
    /// As [`label_seen`](super::angular_gap::label_seen).
    pub(crate) fn label_joined(
        &mut self,
        points: &[[f32; 3]],
        is_joined: &[bool],
        gap: &AngularGap,
        max_distance: f64,
        reach: f64,
        pool: Option<&ThreadPool>,
    ) -> Result<(), Error> {
        let clustering = Clustering { max_distance, min_points: 1, max_points: None };
        check(&clustering)?;
        gap.check()?;
        check_points(points.len())?;
        check_extent(points, max_distance)?;
        let Self { whole, rows, points: taken, cells, .. } = self;
        cells.restart(gap, max_distance.max(reach));
        for (&point, _) in points.iter().zip(is_joined).filter(|(_, is_joined)| !**is_joined) {
            if is_finite(point) {
                cells.hold_around(wide(point));
            }
        }
        cancel::check()?;
        rows.clear();
        dispatch(SearchedRows { cells, points, is_joined, rows });
        taken.clear();
        taken.extend(rows.iter().map(|&row| points[row as usize]));
        cancel::check()?;
        whole.label(taken, gap, &clustering, pool)?;
        self.number(is_joined);
        Ok(())
    }

    /// Number the clusters of the searched points in the order of their first points. All joined points get one
    /// label.
    fn number(&mut self, is_joined: &[bool]) {
        // Longer than other functions: the numbers of joined and other points come from one count
        // in the order of the rows.
        let Self { whole, labels, rows, named, others, joined, .. } = self;
        let parts = whole.labels();
        // What is linked to a joined point is joined, too.
        let count = parts.iter().max().map_or(0, |&last| (last + 1) as usize);
        named.clear();
        named.resize(count, UNNAMED);
        for (&row, &part) in rows.iter().zip(parts) {
            if is_joined[row as usize] {
                named[part as usize] = JOINED;
            }
        }
        // Labels by first appearance.
        let first_joined = is_joined.iter().position(|&is_joined| is_joined);
        let (mut next, mut label_joined) = (0, None);
        let mut name = || {
            next += 1;
            next - 1
        };
        others.clear();
        for (&row, &part) in rows.iter().zip(parts) {
            if first_joined.is_some_and(|first| first <= row as usize) {
                label_joined.get_or_insert_with(&mut name);
            }
            if is_joined[row as usize] {
                continue;
            }
            let label = match named[part as usize] {
                JOINED => *label_joined.get_or_insert_with(&mut name),
                UNNAMED => {
                    named[part as usize] = name();
                    named[part as usize]
                }
                label => label,
            };
            others.push((row, label));
        }
        *joined = first_joined.map(|_| label_joined.unwrap_or_else(name));
        let of_joined = joined.unwrap_or(NOISE);
        labels.clear();
        labels.extend(is_joined.iter().map(|&is| if is { of_joined } else { NOISE }));
        for &(row, label) in &*others {
            labels[row as usize] = label;
        }
    }

    /// Labels of the last cloud: number of the cluster of every point, or noise.
    pub(crate) fn labels(&self) -> &[i32] {
        if self.joined.is_some() { &self.labels } else { self.whole.labels() }
    }

    /// Label of the joined points of the last cloud, and the indices of the points that were searched. None if all
    /// points were searched.
    pub(crate) fn searched(&self) -> Option<(usize, &[u32])> {
        self.joined.map(|label| (label as usize, self.rows.as_slice()))
    }
}

/// Set of cells around points, as a bitmap of hashes. The cells grow with the range as reaches do. The set may seem to
/// contain other cells too, but none of its cells is missing.
#[derive(Default)]
struct ReachCells {
    origin: [f64; 3],
    /// Number of cells of the smallest size per metre.
    per_metre: f64,
    /// Square of the reach divided by the square of the range, with the reach in cells of the smallest size.
    growth: f64,
    bits: Vec<u64>,
    /// The cell that was added last.
    last: Option<(u32, [u32; 3])>,
}

impl ReachCells {
    const SIZE_BITS: u32 = 20;

    fn restart(&mut self, gap: &AngularGap, least: f64) {
        let size = least * (1.0 + MARGIN);
        self.origin = gap.origin;
        self.per_metre = 1.0 / size;
        self.growth = (gap.max_angle / least * (1.0 + MARGIN)).powi(2);
        self.bits.clear();
        self.bits.resize(1 << (Self::SIZE_BITS - 6), 0);
        self.last = None;
    }

    /// Size of the cells that are as wide as the reach of a point, as base-2 logarithm of the ratio to the smallest
    /// size. `square`: square of the point's range [m^2].
    #[inline(always)]
    fn size(&self, square: f64) -> u32 {
        // With q^2 below 2^(e + 1), q is below 2^((e + 1) / 2).
        let square = -least(-(self.growth * square), -0.25);
        // The bits are 1023 + e. The least square is 1/4, so the subtraction below cannot wrap.
        let exponent = (square.to_bits() >> 52) as u32;
        (exponent - 1021) >> 1
    }

    /// Number of cells of a size per metre. `size`: as from [`ReachCells::size`].
    #[inline(always)]
    fn per_metre(&self, size: u32) -> f64 {
        self.per_metre * f64::from_bits(u64::from(1023 - size) << 52)
    }

    /// Add the cells of all places that may be in reach of a point [m].
    fn hold_around(&mut self, point: [f64; 3]) {
        let away: [f64; 3] = std::array::from_fn(|axis| point[axis] - self.origin[axis]);
        let range = away.iter().map(|value| value * value).sum::<f64>().sqrt();
        // Two points are linked by the reach of the nearer one, so the ranges of two linked points differ by
        // no more than the reach of either.
        let reach = (self.growth.sqrt() * range).max(1.0) / self.per_metre;
        let (low, high) =
            ((range - reach).max(0.0) * (1.0 - MARGIN), (range + reach) * (1.0 + MARGIN));
        for size in self.size(low * low)..=self.size(high * high) {
            let per_metre = self.per_metre(size);
            let cell = away.map(|value| whole((value * per_metre).floor()));
            if self.last.replace((size, cell)) == Some((size, cell)) {
                continue;
            }
            for place in 0..27 {
                let step = [place % 3, place / 3 % 3, place / 9];
                let bit = Self::bit(
                    size,
                    std::array::from_fn(|axis| cell[axis].wrapping_add(step[axis]).wrapping_sub(1)),
                ) as usize;
                self.bits[bit >> 6] |= 1 << (bit & 63);
            }
        }
    }

    #[inline(always)]
    fn bit(size: u32, [x, y, z]: [u32; 3]) -> u32 {
        let key = x.wrapping_mul(0x9E37_79B1)
            ^ y.wrapping_mul(0x85EB_CA77)
            ^ z.wrapping_mul(0xC2B2_AE3D)
            ^ size.wrapping_mul(0x27D4_EB2F);
        (key ^ key >> 15).wrapping_mul(0x2C1B_3C6D) >> (u32::BITS - Self::SIZE_BITS)
    }
}

/// Search for the points to label, many at a time on the vector unit of the machine.
struct SearchedRows<'a> {
    cells: &'a ReachCells,
    points: &'a [[f32; 3]],
    is_joined: &'a [bool],
    rows: &'a mut Vec<u32>,
}

impl WithSimd for SearchedRows<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let Self { cells, points, is_joined, rows } = self;
        let origin = cells.origin;
        for (first, (points, is_joined)) in
            (0..).step_by(LANES).zip(points.chunks(LANES).zip(is_joined.chunks(LANES)))
        {
            let mut away = [[0.0; LANES]; 3];
            for (lane, &point) in points.iter().enumerate() {
                for axis in 0..3 {
                    away[axis][lane] = f64::from(point[axis]) - origin[axis];
                }
            }
            let mut bits = [0; LANES];
            // Without closures, which would not be compiled for the vector unit.
            for lane in 0..LANES {
                let [x, y, z] = [away[0][lane], away[1][lane], away[2][lane]];
                let size = cells.size(x * x + y * y + z * z);
                let per_metre = cells.per_metre(size);
                let x = whole((x * per_metre).floor());
                let y = whole((y * per_metre).floor());
                let z = whole((z * per_metre).floor());
                bits[lane] = ReachCells::bit(size, [x, y, z]);
            }
            let (mut found, mut count) = ([0; LANES], 0);
            for (lane, (&point, &is_joined)) in points.iter().zip(is_joined).enumerate() {
                let bit = bits[lane] as usize;
                let is_near = cells.bits[bit >> 6] >> (bit & 63) & 1 == 1;
                // Every lane writes, and the count moves on only if the row is searched.
                found[count] = first + lane as u32;
                count += usize::from(if is_joined { is_near } else { is_finite(point) });
            }
            rows.extend_from_slice(&found[..count]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::cluster::angular_gap::label_seen;

    /// The labels, numbered anew in the order of their first points.
    fn renumbered(labels: &[i32]) -> Vec<i32> {
        let mut known = Vec::new();
        let number = |&label: &i32| {
            if label == NOISE {
                return NOISE;
            }
            known.iter().position(|&seen| seen == label).unwrap_or_else(|| {
                known.push(label);
                known.len() - 1
            }) as i32
        };
        labels.iter().map(number).collect()
    }

    /// Test points on patches and lines and alone, near and far; some are not finite.
    fn cloud(seed: u32, count: u32) -> Vec<[f32; 3]> {
        let share = |index: u32| {
            let mixed = (index ^ seed.rotate_left(11)).wrapping_mul(2_654_435_769).rotate_left(9);
            (mixed.wrapping_mul(2_246_822_519) >> 8) as f32 / (1 << 24) as f32
        };
        let point = |row: u32| {
            let at = |axis: u32| share(8 * row + axis);
            let patch = [0, 1, 2].map(|axis| share(0xF000_0000 + 8 * (row % 37) + axis));
            let range = 90.0 * share(row % 37).powi(2);
            match row % 50 {
                0 => [f32::NAN, 0.0, 0.0],
                1..5 => [0, 1, 2].map(|axis| 80.0 * (at(axis) - 0.5)),
                _ => [0, 1, 2].map(|axis| {
                    range * (patch[axis as usize] - 0.5) + (0.3 + 0.05 * range) * (at(axis) - 0.5)
                }),
            }
        };
        (0..count).map(point).collect()
    }

    #[test]
    fn joined_points_are_as_if_all_were_linked() -> Result<(), Error> {
        let (mut labeller, mut n_left_out, mut n_linked) = (JoinedLabeller::default(), 0, 0);
        for (seed, max_angle, share) in [
            (1, 0.02, 20),
            (2, 0.0, 50),
            (3, 0.005, 97),
            (4, 0.1, 90),
            (5, 0.02, 100),
            (6, 0.3, 60),
        ] {
            let points = cloud(seed, 6000);
            let is_joined: Vec<bool> = (0..6000u32)
                .zip(&points)
                .map(|(row, &point)| {
                    is_finite(point) && (row % 37 * 53 + row % 7 + seed) % 100 < share
                })
                .collect();
            let gap = AngularGap { origin: [0.4, -1.0, 2.0], max_angle };
            let clustering = Clustering { max_distance: 0.25, min_points: 1, max_points: None };
            let mut expected = label_seen(&points, &gap, &clustering, None)?;
            let with_joined: std::collections::BTreeSet<i32> =
                expected.iter().zip(&is_joined).filter(|one| *one.1).map(|one| *one.0).collect();
            let first = with_joined.first().copied().unwrap_or(NOISE);
            for (label, &is_joined) in expected.iter_mut().zip(&is_joined) {
                if with_joined.contains(label) {
                    n_linked += u32::from(!is_joined);
                    *label = first;
                }
            }
            labeller.label_joined(&points, &is_joined, &gap, 0.25, 0.7, None)?;
            assert_eq!(labeller.labels(), renumbered(&expected), "seed {seed}");
            let Some((label, rows)) = labeller.searched() else { continue };
            assert_eq!(
                label as i32,
                renumbered(&expected)[is_joined.iter().position(|&is| is).unwrap_or(0)]
            );
            n_left_out += points.len() - rows.len();
        }
        assert!(n_left_out > 5000 && n_linked > 1000, "{n_left_out}, {n_linked}");
        Ok(())
    }

    #[test]
    fn what_is_searched_holds_all_joined_points_within_reach() -> Result<(), Error> {
        let mut labeller = JoinedLabeller::default();
        let points = cloud(9, 3000);
        let is_joined: Vec<bool> =
            (0..3000).zip(&points).map(|(row, &point)| is_finite(point) && row % 30 != 7).collect();
        let gap = AngularGap { origin: [0.0; 3], max_angle: 0.01 };
        labeller.label_joined(&points, &is_joined, &gap, 0.25, 0.7, None)?;
        let Some((_, rows)) = labeller.searched() else { return Ok(()) };
        assert!(rows.len() < 2900);
        for (row, &point) in (0..).zip(&points).filter(|(_, point)| is_finite(**point)) {
            let near = |other: &[f32; 3]| {
                let square: f32 = (0..3).map(|axis| (point[axis] - other[axis]).powi(2)).sum();
                square <= 0.7 * 0.7
            };
            let others = points.iter().zip(&is_joined).filter(|(_, is_joined)| !**is_joined);
            if others.map(|(other, _)| other).any(near) {
                assert!(rows.contains(&row), "row {row}");
            }
        }
        Ok(())
    }
}
