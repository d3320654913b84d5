//! What a scan met at a point: a surface, free space, or nothing known.

use super::visibility::SortedView;
use std::f64::consts::TAU;
use std::ops::Range;

/// Answer of a scan to the question if something was at a point.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::circles::map) enum Met {
    /// A ray ended there.
    Surface,
    /// All rays beside it passed beyond.
    Free,
    /// Hidden, out of view, or no information.
    Unknown,
}

impl SortedView {
    /// Content of a place, in the frame of the scan: a surface if one was within `margin` [m].
    pub(in crate::circles::map) fn met(&self, point: [f64; 2], margin: f64) -> Met {
        let (distance, bearing) =
            (libm::hypot(point[0], point[1]), libm::atan2(point[1], point[0]));
        let half = (margin / distance.max(margin)).max(self.step());
        let mut is_free = false;
        for turn in [-TAU, 0.0, TAU] {
            let around = self.around(bearing + turn, half);
            if around.is_empty() {
                continue;
            }
            let (low, high) = (around.start.saturating_sub(1), (around.end + 1).min(self.len()));
            if self.off(point, low..high) < margin {
                return Met::Surface;
            }
            for ray in around {
                let range = self.ray(ray).1;
                if range < distance {
                    return Met::Unknown; // behind something
                }
                is_free |= !range.is_nan();
            }
        }
        if is_free && distance < self.range_max() { Met::Free } else { Met::Unknown }
    }

    /// Where the ray beside a place ended, if that was nearer than the place.
    pub(super) fn before(&self, point: [f64; 2]) -> Option<[f64; 2]> {
        let (distance, bearing) =
            (libm::hypot(point[0], point[1]), libm::atan2(point[1], point[0]));
        let half = 0.51 * self.step();
        let mut rays =
            [-TAU, 0.0, TAU].into_iter().flat_map(|turn| self.around(bearing + turn, half));
        let (bearing, range) = self.ray(rays.next()?);
        (range < distance).then(|| [range * libm::cos(bearing), range * libm::sin(bearing)])
    }

    /// Distance of a point from the nearest surface that the scan met beside it [m]; None if the
    /// scan does not tell, infinite where it met nothing.
    pub(in crate::circles::map) fn distance(&self, point: [f64; 2]) -> Option<f64> {
        let bearing = libm::atan2(point[1], point[0]);
        let half = 2.0 * self.step();
        let found = [-TAU, 0.0, TAU].into_iter().map(|turn| self.around(bearing + turn, half));
        let around = found.into_iter().find(|rays| !rays.is_empty())?;
        Some(self.off(point, around))
    }

    /// Distance of a point from the surfaces that the rays of a range met [m].
    fn off(&self, point: [f64; 2], rays: Range<usize>) -> f64 {
        self.nearest(point, rays).map_or(f64::INFINITY, |(distance, _)| distance)
    }

    /// Distance of a point from the nearest surface that rays up to an angle `half` beside it met
    /// [m], and the way from there to the point.
    pub(super) fn beside(&self, point: [f64; 2], half: f64) -> Option<(f64, [f64; 2])> {
        let bearing = libm::atan2(point[1], point[0]);
        let found = [-TAU, 0.0, TAU].into_iter().map(|turn| self.around(bearing + turn, half));
        found
            .filter_map(|rays| self.nearest(point, rays))
            .min_by(|one, two| one.0.total_cmp(&two.0))
    }

    /// The same of the surfaces that the rays of a range met.
    fn nearest(&self, point: [f64; 2], rays: Range<usize>) -> Option<(f64, [f64; 2])> {
        let first = rays.start;
        let pieces = self.pieces().get(rays)?;
        let (mut least, mut nearest) = (f64::INFINITY, None);
        for (number, piece) in (first..).zip(pieces) {
            let Some(piece) = piece else { continue };
            for [x, y] in piece.ways_to(point, number > first) {
                let square = x * x + y * y;
                if square < least {
                    (least, nearest) = (square, Some([x, y]));
                }
            }
        }
        nearest.map(|way| (libm::hypot(way[0], way[1]), way))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Error;
    use crate::circles::map::view::visibility::ScanWithLimits;
    use crate::circles::preprocess::polar_scan::PolarScan;

    #[test]
    fn a_surface_is_where_rays_end_and_between_them() -> Result<(), Error> {
        // A slanted wall x = 4 + y, seen by a ray each 0.02 rad, 8 cm and more apart.
        let bearings: Vec<f64> = (-20..=20).map(|ray| 0.02 * f64::from(ray)).collect();
        let ranges = bearings.iter().map(|ray| 4.0 / (libm::cos(*ray) - libm::sin(*ray))).collect();
        let scan = PolarScan { ranges, bearings };
        let view = ScanWithLimits { scan: &scan, range_min: 0.1, range_max: 10.0 }.sorted()?;
        for y in [-0.3, -0.21, 0.0, 0.07, 0.31] {
            assert_eq!(view.met([4.0 + y, y], 0.01), Met::Surface);
            assert_eq!(view.met([3.9 + y, y], 0.02), Met::Free);
            assert_eq!(view.met([4.1 + y, y], 0.02), Met::Unknown);
            let [before_x, before_y] = view.before([4.1 + y, y]).unwrap_or([f64::NAN; 2]);
            assert!((before_x - 4.0 - before_y).abs() < 1e-9 && (before_y - y).abs() < 0.1);
            assert_eq!(view.before([3.9 + y, y]), None);
            let off = view.distance([3.9 + y, y]).unwrap_or(f64::NAN);
            assert!((off - 0.1 / 2.0_f64.sqrt()).abs() < 1e-3, "{off}");
        }
        assert_eq!(view.met([0.0, 3.0], 0.02), Met::Unknown);
        assert_eq!(view.distance([0.0, 3.0]), None);
        Ok(())
    }
}
