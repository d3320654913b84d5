//! View of one scan: how far its rays go in each direction.
//!
//! A voxel that rays pass through says little about a point in it: far away, rays are further apart
//! than voxels are wide, and near surfaces, rays share voxels with them. A view stores how far the
//! rays around each direction go. A scan sees through a place if rays on all sides of it, within a
//! few tenths of a degree, end clearly behind it. No point of a flat surface is such a place, since
//! a ray on one of its sides ends no further away.

use crate::flying::scan::prepared::Prepared;
use crate::geometry::lattice::wide;
use crate::geometry::transform::{minus, norm};
use serde::{Deserialize, Serialize};

/// Number of bins per unit of the functions `azimuth` and `elevation`, finest first. The finest
/// bins are 0.3 to 0.6 degrees wide. Scanners with fewer rays use bins that are twice or four times
/// as wide.
const PER_UNIT: [usize; 3] = [200, 100, 50];
/// Number of sectors of azimuth. Each has its own mean start point of rays, since the sensor moves
/// during a scan.
const SECTORS: usize = 36;
/// Length up to which rays count [m]; `FARTHEST`: distance up to which places can be seen through
/// [m].
const LONGEST: f64 = 60.0;
/// Largest distance of a place that can be seen through [m].
const FARTHEST: f64 = 45.0;
/// Smallest distance behind a place at which rays that pass it must end [m]. It covers the noise of
/// ranges and poses.
const BEHIND: f64 = 0.2;
/// Step of the stored lengths, which are integers, rounded down [m].
const STEP: f64 = 0.01;

/// How far the rays of a scan go, by direction.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct RayView {
    /// Mean start point of all rays; `starts`: of the rays of each sector [m, frame of the map].
    middle: [f64; 3],
    starts: Vec<[f64; 3]>,
    levels: Vec<BinLevel>,
}

/// Bins of one width, row by row.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct BinLevel {
    per_unit: usize,
    /// Number of rows at the bottom without any ray. They are not stored.
    first_row: usize,
    /// Number of steps that the rays go at least: all rays with a return in a bin and its
    /// neighbours, and one ray on each side of the bin. 0 if a side has no ray.
    lengths: Vec<u16>,
}

/// Measure of the azimuth without trigonometry: 0 to 4 for a full turn, with 1 for a quarter turn.
fn azimuth([x, y, _]: [f64; 3]) -> f64 {
    let sum = x.abs() + y.abs();
    match (x >= 0.0, y >= 0.0) {
        _ if sum == 0.0 => 0.0,
        (true, true) => y / sum,
        (false, true) => 1.0 - x / sum,
        (false, false) => 2.0 - y / sum,
        (true, false) => 3.0 + x / sum,
    }
}

/// Measure of the elevation on an even scale: 0 straight down, 1 level, 2 straight up.
fn elevation([x, y, z]: [f64; 3]) -> f64 {
    let level = (x * x + y * y).sqrt();
    let sum = z.abs() + level;
    if sum == 0.0 { 1.0 } else { 1.0 + z / sum }
}

/// Row and column of a direction in a grid with `per_unit` bins per unit.
fn bin(way: [f64; 3], per_unit: usize) -> [usize; 2] {
    let index = |value: f64, count: usize| ((value * per_unit as f64) as usize).min(count - 1);
    [index(elevation(way), 2 * per_unit), index(azimuth(way), 4 * per_unit)]
}

fn sector(way: [f64; 3]) -> usize {
    ((azimuth(way) * (SECTORS / 4) as f64) as usize).min(SECTORS - 1)
}

impl RayView {
    /// View of a scan. None if it has no rays.
    pub(super) fn of(scan: &Prepared) -> Option<Self> {
        let rays: Vec<ViewedRay> =
            (0..scan.points.len()).filter_map(|row| ViewedRay::of(scan, row)).collect();
        let count = rays.len() as f64;
        if rays.is_empty() {
            return None;
        }
        let middle =
            [0, 1, 2].map(|axis| rays.iter().map(|ray| ray.start[axis]).sum::<f64>() / count);
        let mut sums = vec![[0.0; 4]; SECTORS];
        let [finest, ..] = PER_UNIT;
        let mut bins = vec![BinRays::default(); 8 * finest * finest];
        for ViewedRay { start, way, length, is_return } in &rays {
            let sum = &mut sums[sector(*way)];
            (0..3).for_each(|axis| sum[axis] += start[axis]);
            sum[3] += 1.0;
            let [row, column] = bin(*way, finest);
            let steps = (length.min(LONGEST) / STEP) as u16;
            bins[row * 4 * finest + column].add(BinRays::of(steps, *is_return));
        }
        let start = |[x, y, z, count]: [f64; 4]| match count {
            0.0 => middle,
            _ => [x / count, y / count, z / count],
        };
        let mut levels = Vec::new();
        for per_unit in PER_UNIT {
            if per_unit != finest {
                bins = halved(&bins, per_unit);
            }
            levels.push(BinLevel::of(&bins, per_unit));
        }
        Some(Self { middle, starts: sums.into_iter().map(start).collect(), levels })
    }

    /// True if rays on all sides of a place [m, frame of the map] end clearly behind it.
    pub(super) fn sees_through(&self, place: [f64; 3]) -> bool {
        let about = minus(place, self.middle);
        if about.iter().any(|offset| offset.abs() > 2.0 * FARTHEST) {
            return false;
        }
        let way = minus(place, self.starts[sector(about)]);
        let length = norm(way);
        if length > FARTHEST {
            return false;
        }
        let needed = ((length + BEHIND) / STEP) as u16;
        self.levels.iter().any(|level| level.length(way) > needed)
    }

    /// True if all parts fit together. Checks a saved state.
    pub(super) fn is_whole(&self) -> bool {
        let widths = self.levels.iter().map(|level| level.per_unit);
        self.starts.len() == SECTORS
            && widths.eq(PER_UNIT)
            && self.levels.iter().all(BinLevel::is_whole)
    }

    /// Memory of the view [bytes].
    pub(super) fn size(&self) -> usize {
        self.levels.iter().map(|level| 2 * level.lengths.len()).sum()
    }
}

/// A ray of a scan.
struct ViewedRay {
    start: [f64; 3],
    way: [f64; 3],
    /// Length over which the ray is known to meet nothing [m].
    length: f64,
    is_return: bool,
}

impl ViewedRay {
    /// The ray of a row of a scan. None if the row has no ray.
    fn of(scan: &Prepared, row: usize) -> Option<Self> {
        let (start, is_return) = (scan.origin(row), !scan.no_return[row]);
        if !is_return {
            let is_cast = !scan.no_ray.as_ref().is_some_and(|no_ray| no_ray[row]);
            let way = wide(scan.directions.as_ref().filter(|_| is_cast)?[row]);
            let length = scan.reach.as_ref().map_or(LONGEST, |reach| f64::from(reach[row]));
            let is_known = norm(way) > 0.0 && length > 0.0;
            return is_known.then_some(Self { start, way, length, is_return });
        }
        let way = minus(wide(scan.points[row]), start);
        let length = norm(way);
        (length > 0.0).then_some(Self { start, way, length, is_return }) // false for NaN
    }
}

/// Rays in a bin, as numbers of steps.
#[derive(Clone, Copy)]
struct BinRays {
    /// Length of the shortest ray with a return. The largest number if there is none.
    returns: u16,
    /// Length of the longest ray without a return. 0 if there is none. The known length of such a
    /// ray may be too short, so a short ray does not contradict a long one.
    empty: u16,
}

impl Default for BinRays {
    fn default() -> Self {
        Self { returns: u16::MAX, empty: 0 }
    }
}

impl BinRays {
    fn of(steps: u16, is_return: bool) -> Self {
        let none = Self::default();
        if is_return { Self { returns: steps, ..none } } else { Self { empty: steps, ..none } }
    }

    fn add(&mut self, other: Self) {
        self.returns = self.returns.min(other.returns);
        self.empty = self.empty.max(other.empty);
    }

    fn length(self) -> u16 {
        if self.returns < u16::MAX { self.returns } else { self.empty }
    }
}

/// Bins that are twice as wide, with `per_unit` bins per unit.
fn halved(fine: &[BinRays], per_unit: usize) -> Vec<BinRays> {
    let (columns, of_fine) = (4 * per_unit, 8 * per_unit);
    let joined = |at: usize| {
        let corner = 2 * (at / columns) * of_fine + 2 * (at % columns);
        let mut all = fine[corner];
        [1, of_fine, of_fine + 1].into_iter().for_each(|step| all.add(fine[corner + step]));
        all
    };
    (0..2 * per_unit * columns).map(joined).collect()
}

impl BinLevel {
    fn of(bins: &[BinRays], per_unit: usize) -> Self {
        let (rows, columns) = (2 * per_unit, 4 * per_unit);
        let has_ray = |row: &usize| {
            bins[row * columns..(row + 1) * columns].iter().any(|rays| rays.length() > 0)
        };
        let used = || (0..rows).filter(has_ray);
        let (first_row, end) =
            (used().next().unwrap_or(0), used().next_back().map_or(0, |row| row + 1));
        let mut lengths = vec![0; (end - first_row) * columns];
        // A row at the end of those with rays has none on one of its sides.
        for row in first_row + 1..end.saturating_sub(1) {
            for column in 0..columns {
                let aside = [(column + columns - 1) % columns, column, (column + 1) % columns];
                let block = [row - 1, row, row + 1]
                    .map(|row| aside.map(|column| bins[row * columns + column]));
                let longest =
                    |of: [BinRays; 3]| of.into_iter().map(BinRays::length).fold(0, u16::max);
                let of_column = |side: usize| block.map(|row| row[side]);
                let sides = [block[0], block[2], of_column(0), of_column(2)].map(longest);
                let returns = block.into_iter().flatten().map(|rays| rays.returns);
                lengths[(row - first_row) * columns + column] =
                    returns.chain(sides).fold(u16::MAX, u16::min);
            }
        }
        Self { per_unit, first_row, lengths }
    }

    /// True if the number of bins is a possible one, and the rows are complete. Checks a saved
    /// state.
    fn is_whole(&self) -> bool {
        let (rows, columns) = (2 * self.per_unit, 4 * self.per_unit);
        let n_rows = self.lengths.len() / columns;
        self.lengths.len() == n_rows * columns && n_rows <= rows && self.first_row <= rows - n_rows
    }

    fn length(&self, way: [f64; 3]) -> u16 {
        let [row, column] = bin(way, self.per_unit);
        let row = row.checked_sub(self.first_row);
        let at = row.map(|row| row * 4 * self.per_unit + column);
        at.and_then(|at| self.lengths.get(at)).copied().unwrap_or(0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::transform::Transform;

    /// View from rays `step_deg` degrees apart over all azimuths, which end on a floor 1.8 m below
    /// or go 50 m, unless `blocks` gives another length for their direction.
    fn view(step_deg: f64, blocks: impl Fn([f64; 3]) -> Option<f64>) -> Option<RayView> {
        let mut scan = Prepared::default();
        let (mut azimuth_deg, mut points) = (0.0, Vec::new());
        while azimuth_deg < 360.0 {
            let mut elevation_deg = -25.0;
            while elevation_deg < 20.0 {
                let (azimuth, elevation) =
                    (f64::to_radians(azimuth_deg), f64::to_radians(elevation_deg));
                let (level, z) = (libm::cos(elevation), libm::sin(elevation));
                let way = [level * libm::cos(azimuth), level * libm::sin(azimuth), z];
                let floor = if z < 0.0 { (-1.8 / z).min(50.0) } else { 50.0 };
                let length = blocks(way).map_or(floor, |length| length.min(floor));
                points.push(way.map(|part| (length * part) as f32));
                elevation_deg += step_deg;
            }
            azimuth_deg += step_deg;
        }
        scan.no_return = vec![false; points.len()];
        (scan.points, scan.pose) = (points, Transform::IDENTITY);
        RayView::of(&scan)
    }

    #[test]
    fn what_rays_pass_is_seen_through_and_surfaces_are_not() -> Result<(), &'static str> {
        // A wall 12 m ahead, 2 m wide, and two scanners.
        let wall = |[x, y, _]: [f64; 3]| (x > 0.0 && y.abs() < x / 12.0).then(|| 12.0 / x);
        for step_deg in [0.35, 1.0] {
            let view = view(step_deg, wall).ok_or("no view")?;
            for through in [[8.0, 0.0, 0.0], [5.0, 5.0, -1.0], [-10.0, 3.0, 0.5], [10.0, 0.1, -1.0]]
            {
                assert!(view.sees_through(through), "{step_deg} {through:?}");
            }
            let behind = [[13.0, 0.0, 0.0], [14.0, 0.5, -1.0]];
            let on_wall = [[12.0, 0.0, 0.0], [12.05, 0.98, 0.4], [11.9, -0.99, -1.0]];
            let on_floor =
                [[6.0, 0.0, -1.8], [0.0, 15.0, -1.78], [-25.0, 1.0, -1.82], [3.0, 20.0, -1.8]];
            let unseen = [[2.0, 0.0, 3.0], [0.0, 0.0, -1.0]];
            for place in behind.into_iter().chain(on_wall).chain(on_floor).chain(unseen) {
                assert!(!view.sees_through(place), "{step_deg} {place:?}");
            }
        }
        Ok(())
    }

    #[test]
    fn a_view_of_other_parts_is_not_whole() -> Result<(), &'static str> {
        let made = view(1.0, |_| None).ok_or("no view")?;
        assert!(made.is_whole());
        let wrong: [fn(&mut RayView); 6] = [
            |view| view.starts.truncate(35),
            |view| view.levels.truncate(2),
            |view| view.levels[1].per_unit = 0,
            |view| view.levels[2].first_row = usize::MAX,
            |view| view.levels[0].lengths.push(7),
            |view| view.levels[2].lengths = vec![7; 101 * 200],
        ];
        for change in wrong {
            let mut view = made.clone();
            change(&mut view);
            assert!(!view.is_whole());
        }
        Ok(())
    }

    #[test]
    fn measures_of_angles_grow_with_the_angle() {
        let way = |angle: i32| {
            let angle = f64::from(angle) * 0.01;
            [libm::cos(angle), libm::sin(angle), 0.0]
        };
        assert!((1..628).all(|angle| azimuth(way(angle)) > azimuth(way(angle - 1))));
        let up = |angle: i32| [way(angle)[0], 0.0, way(angle)[1]];
        assert!((-156..157).all(|angle| elevation(up(angle)) > elevation(up(angle - 1))));
        assert_eq!(bin([1.0, -1e-300, 0.0], 200), [200, 799]);
    }
}
