//! Things of a scan, and what they hide from the sensor.

use crate::flying::classify::shadow::SightLine;
use crate::flying::point_class::PointClass;
use crate::geometry::lattice::{Lattice, Voxel, floor, wide};

/// Indices of points by their voxels, which are in ascending order.
pub(super) struct PointsByVoxel {
    pub(super) voxels: Vec<Voxel>,
    rows: Vec<u32>,
    /// Index in `rows` of the first point of every voxel; last entry: number of all points.
    starts: Vec<usize>,
}

impl PointsByVoxel {
    /// The points as a list of voxels and indices. `pairs` must be in ascending order.
    pub(super) fn of(pairs: &[(Voxel, u32)]) -> Self {
        let (mut voxels, mut starts) = (Vec::new(), Vec::new());
        for (at, (voxel, _)) in pairs.iter().enumerate() {
            if voxels.last() != Some(voxel) {
                voxels.push(*voxel);
                starts.push(at);
            }
        }
        starts.push(pairs.len());
        Self { voxels, rows: pairs.iter().map(|&(_, point)| point).collect(), starts }
    }

    /// Indices of the points in the voxel at index `at`.
    pub(super) fn rows(&self, at: usize) -> &[u32] {
        &self.rows[self.starts[at]..self.starts[at + 1]]
    }
}

/// A scan, as input of the search for movers.
#[derive(Clone, Copy)]
pub(crate) struct ScanOfMovers<'a> {
    pub(crate) points: &'a [[f32; 3]],
    pub(crate) class: &'a [PointClass],
    /// For each point, whether it may be on the robot itself. Empty if no point may be.
    pub(crate) maybe_own: &'a [bool],
    /// Position of the sensor [m, frame of the map].
    pub(crate) origin: [f64; 3],
    /// Height of flat ground [m, frame of the map]. None if no flat ground is seen.
    pub(crate) floor: Option<f64>,
    /// For each thing of unknown class that is no larger than a target, the indices of its points.
    pub(crate) things: &'a [&'a [u32]],
}

/// Things of a scan, their voxels, and what they hide from the sensor.
pub(super) struct Things<'a> {
    /// Voxels with the numbers of the things that have points in them, ascending.
    of_voxel: Vec<(Voxel, usize)>,
    /// For each thing, its points by voxel. A line of sight meets few voxels, however many points they contain.
    rows: Vec<PointsByVoxel>,
    points: &'a [[f32; 3]],
    origin: [f64; 3],
    lattice: &'a Lattice,
}

impl<'a> Things<'a> {
    pub(super) fn of(scan: &ScanOfMovers<'a>, lattice: &'a Lattice) -> Self {
        let ScanOfMovers { points, origin, things, .. } = *scan;
        let in_voxel = |&point: &u32| {
            floor(lattice.scaled(wide(points[point as usize]))).map(|voxel| (voxel, point))
        };
        let by_voxel = |thing: &&[u32]| {
            let mut pairs: Vec<(Voxel, u32)> = thing.iter().filter_map(in_voxel).collect();
            pairs.sort_unstable();
            PointsByVoxel::of(&pairs)
        };
        let rows: Vec<PointsByVoxel> = things.iter().map(by_voxel).collect();
        let mut of_voxel: Vec<(Voxel, usize)> = Vec::new();
        for (thing, rows) in rows.iter().enumerate() {
            of_voxel.extend(rows.voxels.iter().map(|&voxel| (voxel, thing)));
        }
        of_voxel.sort_unstable();
        Self { of_voxel, rows, points, origin, lattice }
    }

    /// True if a thing with points in `voxel` also has points in `other`, or hides `other` from the sensor.
    pub(super) fn hide(&self, voxel: Voxel, other: Voxel) -> bool {
        let from = self.of_voxel.partition_point(|&(place, _)| place < voxel);
        let mut in_voxel = self.of_voxel[from..].iter().take_while(|(place, _)| *place == voxel);
        in_voxel.any(|&(_, thing)| {
            self.of_voxel.binary_search(&(other, thing)).is_ok()
                || SightLine::to(other, self.origin, self.lattice)
                    .is_some_and(|line| self.blocks(thing, &line))
        })
    }

    /// True if a point of a thing is on a line of sight, before the end of the line.
    fn blocks(&self, thing: usize, line: &SightLine) -> bool {
        let rows = &self.rows[thing];
        let is_blocked = |&point: &u32| line.is_blocked_by(wide(self.points[point as usize]));
        rows.voxels.iter().enumerate().any(|(at, &voxel)| {
            line.passes_near(self.lattice.center(voxel)) && rows.rows(at).iter().any(is_blocked)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Error;
    use crate::flying::classify::shadow::Shadow;

    #[test]
    fn a_thing_hides_what_is_behind_it_and_the_voxels_that_it_is_in() -> Result<(), Error> {
        let lattice = Lattice::new(0.25, [0.0; 3])?;
        let points = [[20, 0, 0], [20, 0, 1], [20, 40, 0]]
            .map(|voxel| lattice.center(voxel).map(|value| value as f32));
        let scan = ScanOfMovers {
            points: &points,
            class: &[PointClass::Unknown; 3],
            maybe_own: &[],
            origin: [0.125; 3],
            floor: None,
            things: &[&[0, 1], &[2]],
        };
        let things = Things::of(&scan, &lattice);
        assert!(things.hide([20, 0, 0], [20, 0, 1]) && things.hide([20, 0, 1], [22, 0, 0]));
        assert!(!things.hide([20, 0, 0], [20, 1, 0]), "beside it");
        assert!(!things.hide([20, 0, 0], [18, 0, 0]), "in front of it");
        assert!(!things.hide([20, 0, 0], [20, 40, 0]), "another thing is there");
        assert!(!things.hide([20, 0, 0], [23, 46, 0]), "another thing hides it");
        assert!(things.hide([20, 40, 0], [23, 46, 0]));
        assert!(!things.hide([19, 0, 0], [22, 0, 0]), "nothing is in that voxel");
        Ok(())
    }

    /// A thing hides the voxels that any one of its points hides, whatever its other points are.
    #[test]
    fn a_thing_hides_what_its_points_hide() -> Result<(), Error> {
        let lattice = Lattice::new(0.25, [0.0; 3])?;
        let origin = [0.3, -0.2, 0.1];
        let mut number = 0_u32;
        let mut random = |width: f32| {
            number = number.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            width * ((number >> 8) as f32 / (1 << 24) as f32 - 0.5)
        };
        for middle in [[5.0, 1.0, 0.5], [-0.5, 0.3, -0.4], [20.0, -30.0, 3.0]] {
            let points: Vec<[f32; 3]> =
                (0..40).map(|_| middle.map(|value: f32| value + random(1.2))).collect();
            let rows: Vec<u32> = (0..40).collect();
            let class = &[PointClass::Unknown; 40];
            let scan = ScanOfMovers {
                points: &points,
                class,
                maybe_own: &[],
                origin,
                floor: None,
                things: &[&rows],
            };
            let things = Things::of(&scan, &lattice);
            let wide_points: Vec<[f64; 3]> = points.iter().map(|&point| wide(point)).collect();
            let shadow = Shadow::of(&wide_points, origin, &lattice);
            let first = things.of_voxel[0].0;
            let mut n_hidden = 0;
            for _ in 0..3000 {
                let far = middle.map(|value| (1.1 * value + random(3.0)) * 4.0);
                let other = far.map(|value| value.floor() as i32);
                let is_in = things.of_voxel.binary_search(&(other, 0)).is_ok();
                assert_eq!(things.hide(first, other), is_in || shadow.hides(other), "{other:?}");
                n_hidden += i32::from(shadow.hides(other));
            }
            assert!((10..2990).contains(&n_hidden), "{middle:?} {n_hidden}");
        }
        Ok(())
    }
}
