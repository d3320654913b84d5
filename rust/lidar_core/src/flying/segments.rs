//! Rays of a scan as segments, many at a time.
//!
//! Loops over the lanes of a bundle, which the compiler turns into instructions of the vector unit
//! that calls them.

use super::integrate::ClassifiedScan;
use super::voxel_map::MapParameters;
use crate::Error;
use crate::geometry::lattice::{Lattice, Voxel, floor, wide};
use crate::geometry::transform::minus;

/// Rays side by side: two vectors of the widest unit, so that one works while the other waits.
pub(super) const LANES: usize = 32;
/// Numbers of them along an axis.
pub(super) type Numbers = [f64; LANES];

/// A ray that is cast.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Ray {
    /// Its place in the scan.
    pub(crate) index: u32,
    /// Rays that it stands for.
    pub(crate) count: u32,
}

/// Where the rays of a scan lead.
#[derive(Clone, Copy)]
pub(crate) struct Source<'a> {
    pub(crate) scan: &'a ClassifiedScan<'a>,
    pub(crate) parameters: &'a MapParameters,
    pub(crate) lattice: &'a Lattice,
}

/// Rays side by side [m]; the last ones may repeat the first.
pub(super) struct Segments {
    pub(super) start: [Numbers; 3],
    pub(super) end: [Numbers; 3],
}

impl Source<'_> {
    /// The segments of up to [`LANES`] rays, at least one.
    #[inline(always)]
    pub(super) fn segments(&self, rays: &[Ray]) -> Segments {
        let mut start = [[0.0; LANES]; 3];
        let mut along = [[0.0; LANES]; 3];
        let mut end = [[0.0; LANES]; 3];
        let mut margin = [self.parameters.end_margin; LANES];
        for lane in 0..LANES {
            let index = rays[if lane < rays.len() { lane } else { 0 }].index as usize;
            let origin = self.scan.origins.at(index);
            let (point, span) = match (self.scan.directions, self.scan.no_return) {
                (Some(directions), Some(flags)) if flags[index] => {
                    margin[lane] = f64::NEG_INFINITY; // up to the maximum range
                    ([f64::NAN; 3], wide(directions[index]))
                }
                _ => {
                    let point = wide(self.scan.points[index]);
                    (point, minus(point, origin))
                }
            };
            if let Some(error) = self.scan.pose_error.filter(|_| margin[lane].is_finite()) {
                margin[lane] += error.end_margin(span);
            }
            for axis in 0..3 {
                start[axis][lane] = origin[axis];
                along[axis][lane] = span[axis];
                end[axis][lane] = point[axis];
            }
        }
        self.shorten(&start, &along, &margin, &mut end);
        Segments { start, end }
    }

    /// Let rays end before their points by the margin, and no further than `max_range` (eq. 20).
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
            let is_whole = reach >= distance && margin[lane] >= 0.0;
            for axis in 0..3 {
                let ahead = start[axis][lane] + reach / distance * along[axis][lane];
                end[axis][lane] = if is_whole { end[axis][lane] } else { ahead };
            }
        }
    }

    /// The voxels between which `rays` lie.
    ///
    /// # Errors
    /// [`Error::PointOutOfRange`] for the first ray of which an end cannot be indexed.
    #[inline(always)]
    pub(super) fn span(&self, rays: &[Ray]) -> Result<Option<[Voxel; 2]>, Error> {
        let (mut low, mut high) = ([[f64::MAX; LANES]; 3], [[f64::MIN; LANES]; 3]);
        let mut odd = [false; LANES];
        for rays in rays.chunks(LANES) {
            let Segments { start, end } = self.segments(rays);
            for axis in 0..3 {
                for lane in 0..LANES {
                    let (a, b) = (start[axis][lane], end[axis][lane]);
                    odd[lane] |= !(a.is_finite() & b.is_finite());
                    low[axis][lane] = least(low[axis][lane], least(a, b));
                    high[axis][lane] = -least(-high[axis][lane], least(-a, -b));
                }
            }
        }
        if rays.is_empty() {
            return Ok(None);
        }
        // Scaling keeps the order of numbers.
        let voxel = |point| floor(self.lattice.scaled(point));
        let low = voxel(low.map(|lanes| lanes.into_iter().fold(f64::MAX, f64::min)));
        let high = voxel(high.map(|lanes| lanes.into_iter().fold(f64::MIN, f64::max)));
        match low.zip(high).filter(|_| !odd.contains(&true)) {
            Some((low, high)) => Ok(Some([low, high])),
            None => self.check(rays).map(|()| None),
        }
    }

    /// # Errors
    /// As those of `span`.
    #[cold]
    fn check(&self, rays: &[Ray]) -> Result<(), Error> {
        for ray in rays {
            let Segments { start, end } = self.segments(std::slice::from_ref(ray));
            for point in [start, end].map(|lanes| lanes.map(|axis| axis[0])) {
                floor(self.lattice.scaled(point)).ok_or(Error::PointOutOfRange { point })?;
            }
        }
        Ok(())
    }
}

impl Segments {
    /// The same in units of voxels.
    #[inline(always)]
    pub(super) fn scaled(&self, lattice: &Lattice) -> Self {
        Self { start: scaled(&self.start, lattice), end: scaled(&self.end, lattice) }
    }
}

#[inline(always)]
fn scaled(points: &[Numbers; 3], lattice: &Lattice) -> [Numbers; 3] {
    let mut scaled = *points;
    for (axis, values) in scaled.iter_mut().enumerate() {
        for value in values {
            *value = (*value - lattice.origin()[axis]) / lattice.voxel_size();
        }
    }
    scaled
}

/// The voxel of the point of a lane, in units of voxels.
#[inline(always)]
pub(super) fn voxel(points: &[Numbers; 3], lane: usize) -> Voxel {
    let [x, y, z] = points;
    [x[lane].floor() as i32, y[lane].floor() as i32, z[lane].floor() as i32]
}

/// The lesser one, as the vector unit has it.
#[inline(always)]
pub(super) fn least(a: f64, b: f64) -> f64 {
    if a < b { a } else { b }
}

#[cfg(test)]
pub(super) mod tests {
    use super::super::integrate::tests::parameters;
    use super::super::integrate::{BACKGROUND, Origins};
    use super::*;

    /// Show `run` rays from starts to ends, in units of voxels.
    pub(in super::super) fn with_rays<T>(
        segments: &[([f64; 3], [f32; 3])],
        run: impl FnOnce(&Source<'_>, Vec<Ray>) -> Result<T, Error>,
    ) -> Result<T, Error> {
        let (origins, points): (Vec<_>, Vec<_>) = segments.iter().copied().unzip();
        let scan = ClassifiedScan {
            points: &points,
            class: &vec![BACKGROUND; points.len()],
            origins: Origins::Each(&origins),
            directions: None,
            no_return: None,
            no_ray: None,
            pose_error: None,
        };
        let parameters = MapParameters { voxel_size: 1.0, max_range: 1e9, ..parameters() };
        let lattice = Lattice::new(1.0, [0.0; 3])?;
        let rays = (0..points.len() as u32).map(|index| Ray { index, count: 1 }).collect();
        run(&Source { scan: &scan, parameters: &parameters, lattice: &lattice }, rays)
    }
}
