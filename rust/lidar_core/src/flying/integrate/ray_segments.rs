//! Rays of a scan as segments, many at a time, in the frame of the map.
//!
//! The loops run over the lanes of a bundle. The compiler turns them into instructions of the
//! vector unit that the caller was compiled for.

use super::accumulate::window::Window;
use super::classified_scan::{ClassifiedScan, Origins};
use crate::Error;
use crate::flying::map::parameters::MapParameters;
use crate::geometry::lattice::{Lattice, Voxel, floor, least, whole, wide};
use crate::geometry::transform::norm;

/// Number of rays side by side: two vectors of the widest unit, so that one works while the other
/// waits.
pub(crate) const LANES: usize = 32;
/// One coordinate for each lane.
pub(crate) type Numbers = [f64; LANES];

/// One whole number for each lane.
pub(crate) type Lanes = [u32; LANES];
/// Index of the scan's entry for each lane.
pub(crate) type Indices = [usize; LANES];
/// One flag for each lane.
pub(crate) type Flags = [bool; LANES];

/// A ray that is cast.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Ray {
    /// Index of the ray in the scan.
    pub(crate) index: u32,
    /// Number of rays that it stands for.
    pub(crate) count: u32,
}

/// Source of the rays of a scan: the scan, the limits of the map, and its lattice.
#[derive(Clone, Copy)]
pub(crate) struct Source<'a> {
    pub(crate) scan: &'a ClassifiedScan<'a>,
    pub(crate) parameters: &'a MapParameters,
    pub(crate) lattice: &'a Lattice,
}

/// Starts and ends of rays side by side [m], or in voxels. The last lanes may repeat others.
pub(crate) struct RaySegments {
    pub(crate) start: [Numbers; 3],
    pub(crate) end: [Numbers; 3],
}

/// Corners of the box around rays, separately for each lane [m].
pub(crate) struct Bounds {
    low: [Numbers; 3],
    high: [Numbers; 3],
    /// Lanes that had a ray with a start or end that is not finite.
    odd: Flags,
}

impl Source<'_> {
    /// The segments of up to [`LANES`] rays; at least one is needed.
    #[inline(always)]
    pub(crate) fn segments(&self, rays: &[Ray]) -> RaySegments {
        let mut index = [rays[0].index as usize; LANES];
        for (index, ray) in index.iter_mut().zip(rays) {
            *index = ray.index as usize;
        }
        self.between(&index, &self.points(&index))
    }

    /// The segments of the rays of these entries. `points` are the points of the same entries.
    #[inline(always)]
    pub(crate) fn between(&self, index: &Indices, points: &[Numbers; 3]) -> RaySegments {
        let (start, mut end) = (self.starts(index), *points);
        let mut along = end;
        for axis in 0..3 {
            for lane in 0..LANES {
                along[axis][lane] -= start[axis][lane];
            }
        }
        let mut margin = [self.parameters.end_margin; LANES];
        self.aim_without_return(index, &mut along, &mut margin);
        if let Some(error) = self.scan.pose_error {
            error.add_to_margins(&along, &mut margin); // those of rays up to `max_range` are -infinity
        }
        self.shorten(&start, &along, &margin, &mut end);
        RaySegments { start, end }
    }

    /// The points of these entries [m].
    #[inline(always)]
    pub(crate) fn points(&self, index: &Indices) -> [Numbers; 3] {
        let mut points = [[0.0; LANES]; 3];
        for lane in 0..LANES {
            let point = wide(self.scan.points[index[lane]]);
            for axis in 0..3 {
                points[axis][lane] = point[axis];
            }
        }
        points
    }

    /// Start points of the rays of these entries [m].
    #[inline(always)]
    fn starts(&self, index: &Indices) -> [Numbers; 3] {
        let mut start = [[0.0; LANES]; 3];
        match self.scan.origins {
            Origins::One(origin) => start = origin.map(|value| [value; LANES]),
            Origins::Each(origins) => {
                for lane in 0..LANES {
                    for axis in 0..3 {
                        start[axis][lane] = origins[index[lane]][axis];
                    }
                }
            }
        }
        start
    }

    /// Set the ends of rays without return: along their direction, up to `reach` or the maximum
    /// range.
    #[inline(always)]
    fn aim_without_return(&self, index: &Indices, along: &mut [Numbers; 3], margin: &mut Numbers) {
        let (Some(directions), Some(flags)) = (self.scan.directions, self.scan.no_return) else {
            return;
        };
        let flags = index.map(|index| flags[index]);
        // Most bundles hold returns only: one test spares them the loop.
        if !flags.contains(&true) {
            return;
        }
        for lane in 0..LANES {
            let direction = wide(directions[index[lane]]);
            let beyond = self.scan.reach.map_or(f64::NEG_INFINITY, |reach| {
                // Behind its reach a ray clears nothing: that part is cut off as a margin.
                norm(direction) - f64::from(reach[index[lane]])
            });
            margin[lane] = if flags[lane] { beyond } else { margin[lane] };
            for axis in 0..3 {
                let to_point = along[axis][lane];
                along[axis][lane] = if flags[lane] { direction[axis] } else { to_point };
            }
        }
    }

    /// Set the ends of rays: before their points by the margin [m], and no further than `max_range`
    /// (eq. 20).
    #[inline(always)]
    fn shorten(
        &self,
        start: &[Numbers; 3],
        along: &[Numbers; 3],
        margin: &Numbers,
        end: &mut [Numbers; 3],
    ) {
        let range = self.parameters.max_range;
        let [x, y, z] = along;
        for lane in 0..LANES {
            let distance = (x[lane] * x[lane] + y[lane] * y[lane] + z[lane] * z[lane]).sqrt();
            let reach = (distance - margin[lane]).max(0.0).min(range);
            // A ray that is not shortened keeps its point to the bit: rounding must not move it to another
            // voxel. That includes length 0, for which `ahead` is NaN.
            let is_whole = reach >= distance && margin[lane] >= 0.0;
            for axis in 0..3 {
                let ahead = start[axis][lane] + reach / distance * along[axis][lane];
                end[axis][lane] = if is_whole { end[axis][lane] } else { ahead };
            }
        }
    }

    /// Check that both ends of every ray have a voxel.
    ///
    /// # Errors
    /// [`Error::PointOutOfRange`] for the first ray with an end that has no voxel.
    #[cold]
    pub(crate) fn check(&self, rays: &[Ray]) -> Result<(), Error> {
        for ray in rays {
            let RaySegments { start, end } = self.segments(std::slice::from_ref(ray));
            for point in [start, end].map(|lanes| lanes.map(|axis| axis[0])) {
                floor(self.lattice.scaled(point)).ok_or(Error::PointOutOfRange { point })?;
            }
        }
        Ok(())
    }
}

impl Default for Bounds {
    fn default() -> Self {
        let (low, high) = ([[f64::MAX; LANES]; 3], [[f64::MIN; LANES]; 3]);
        Self { low, high, odd: [false; LANES] }
    }
}

impl Bounds {
    /// Extend the bounds to the rays whose flags are set.
    #[inline(always)]
    pub(crate) fn hold(&mut self, RaySegments { start, end }: &RaySegments, is_ray: &Flags) {
        for axis in 0..3 {
            for lane in 0..LANES {
                let (a, b, is_ray) = (start[axis][lane], end[axis][lane], is_ray[lane]);
                self.odd[lane] |= is_ray & !(a.is_finite() & b.is_finite());
                let (low, high) = (self.low[axis][lane], self.high[axis][lane]);
                // One instruction each, unlike `f64::min`, which has to look for NaN; `odd` catches those.
                let (least, most) = (least(a, b), -least(-a, -b));
                self.low[axis][lane] = if is_ray & (least < low) { least } else { low };
                self.high[axis][lane] = if is_ray & (most > high) { most } else { high };
            }
        }
    }

    /// First and last voxel of the bounds. None without rays, or if a corner has no voxel.
    pub(crate) fn voxels(&self, lattice: &Lattice) -> Option<[Voxel; 2]> {
        // Scaling keeps the order of numbers: only the two extremes have to be scaled.
        let low = self.low.map(|lanes| lanes.into_iter().fold(f64::MAX, f64::min));
        let high = self.high.map(|lanes| lanes.into_iter().fold(f64::MIN, f64::max));
        if self.odd.contains(&true) || low[0] > high[0] {
            return None;
        }
        Some([floor(lattice.scaled(low))?, floor(lattice.scaled(high))?])
    }
}

impl RaySegments {
    /// Segments in units of voxels.
    #[inline(always)]
    pub(crate) fn scaled(&self, lattice: &Lattice) -> Self {
        Self { start: scaled(&self.start, lattice), end: scaled(&self.end, lattice) }
    }
}

#[inline(always)]
fn scaled(points: &[Numbers; 3], lattice: &Lattice) -> [Numbers; 3] {
    let mut scaled = *points;
    for (axis, values) in scaled.iter_mut().enumerate() {
        lattice.scale(axis, values);
    }
    scaled
}

/// Places in `window` of points that are inside it. The points are in units of voxels.
#[inline(always)]
pub(crate) fn places(points: &[Numbers; 3], window: &Window) -> Lanes {
    let mut places = [0; LANES];
    for (axis, points) in points.iter().enumerate() {
        let first = f64::from(window.first(axis));
        for lane in 0..LANES {
            // Both are whole numbers below 2^32: their difference is exact.
            places[lane] |= window.bits_at(axis, whole(points[lane].floor() - first));
        }
    }
    places
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::flying::map::parameters::tests::parameters;
    use crate::flying::point_class::PointClass;

    /// Call `run` with rays from starts to ends, in units of voxels.
    pub(in super::super) fn with_rays<T>(
        segments: &[([f64; 3], [f32; 3])],
        run: impl FnOnce(&Source<'_>, Vec<Ray>) -> Result<T, Error>,
    ) -> Result<T, Error> {
        let (origins, points): (Vec<_>, Vec<_>) = segments.iter().copied().unzip();
        let scan = ClassifiedScan {
            points: &points,
            class: &vec![PointClass::Background; points.len()],
            origins: Origins::Each(&origins),
            directions: None,
            no_return: None,
            no_ray: None,
            reach: None,
            pose_error: None,
        };
        let parameters = MapParameters { voxel_size: 1.0, max_range: 1e9, ..parameters() };
        let lattice = Lattice::new(1.0, [0.0; 3])?;
        let rays = (0..points.len() as u32).map(|index| Ray { index, count: 1 }).collect();
        run(&Source { scan: &scan, parameters: &parameters, lattice: &lattice }, rays)
    }
}
