//! State of a point in a scan: a surface, free space, or unknown.

use super::piece::SurfacePiece;
use super::visibility::SortedView;
use std::f64::consts::TAU;
use std::ops::Range;

/// The sine of an angle up to 1 rad is at least so many times the angle.
const LEAST_SINE: f64 = 0.84;

/// Whether a scan saw a surface at a point.
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
            let bearing = bearing + turn;
            let Some(middle) = self.first_from(bearing, half) else { continue };
            let mut near = NearestPiece { point, square: margin * margin, way: None };
            self.search(&mut near, middle, [bearing, half, distance], NearestPiece::is_found);
            if near.is_found() {
                return Met::Surface;
            }
            let after = (middle..self.len()).take_while(|&ray| self.ray(ray).0 <= bearing + half);
            let before = (0..middle).rev().take_while(|&ray| self.ray(ray).0 >= bearing - half);
            for range in after.chain(before).map(|ray| self.ray(ray).1) {
                if range < distance {
                    return Met::Unknown; // something nearer hides the place
                }
                is_free |= !range.is_nan();
            }
        }
        if is_free && distance < self.range_max() { Met::Free } else { Met::Unknown }
    }

    /// End of the ray beside a place, in the frame of the scan [m], if the ray ended in front of
    /// the place; else None.
    pub(super) fn before(&self, point: [f64; 2]) -> Option<[f64; 2]> {
        let (distance, bearing) =
            (libm::hypot(point[0], point[1]), libm::atan2(point[1], point[0]));
        let half = 0.51 * self.step();
        let mut rays =
            [-TAU, 0.0, TAU].into_iter().flat_map(|turn| self.around(bearing + turn, half));
        let (bearing, range) = self.ray(rays.next()?);
        (range < distance).then(|| [range * libm::cos(bearing), range * libm::sin(bearing)])
    }

    /// Distance of a point from the nearest surface that the scan saw near it [m]; None if the scan
    /// has no information there, infinite if it saw no surface.
    pub(in crate::circles::map) fn distance(&self, point: [f64; 2]) -> Option<f64> {
        let bearing = libm::atan2(point[1], point[0]);
        let half = 2.0 * self.step();
        let found = [-TAU, 0.0, TAU].into_iter().map(|turn| self.around(bearing + turn, half));
        let around = found.into_iter().find(|rays| !rays.is_empty())?;
        Some(self.off(point, around))
    }

    /// Distance of a point from the nearest surface [m], and the vector from there to the point
    /// [m]; None if there is none within `reach` [m].
    pub(super) fn within(&self, point: [f64; 2], reach: f64) -> Option<(f64, [f64; 2])> {
        let (distance, bearing) =
            (libm::hypot(point[0], point[1]), libm::atan2(point[1], point[0]));
        let half = (reach / distance.max(reach)).max(self.step());
        let mut nearest = NearestPiece { point, square: reach * reach, way: None };
        for turn in [-TAU, 0.0, TAU] {
            let bearing = bearing + turn;
            let Some(middle) = self.first_from(bearing, half) else { continue };
            self.search(&mut nearest, middle, [bearing, half, distance], |_| false);
        }
        nearest.way.map(|way| (nearest.distance(), way))
    }

    /// Search the surfaces on both sides of the bearing of a point, up to the angle `half` [rad].
    /// The search ends when the result is sufficient, or when all other surfaces are farther.
    fn search(
        &self,
        found: &mut NearestPiece,
        middle: usize,
        [bearing, half, distance]: [f64; 3],
        is_enough: impl Fn(&NearestPiece) -> bool,
    ) {
        let (pieces, step) = (self.pieces(), self.step());
        let is_done = |found: &NearestPiece, aside: f64| {
            let least = distance * LEAST_SINE * aside.min(1.0);
            aside > 0.0 && least * least >= found.square || is_enough(found)
        };
        for (number, piece) in pieces.iter().enumerate().skip(middle) {
            let ray = self.ray(number).0;
            // A surface that ends beside its ray reaches half a step to both sides.
            if is_done(found, ray - step - bearing) {
                break;
            }
            found.take(piece.as_ref(), true);
            if ray > bearing + half {
                break;
            }
        }
        for (number, piece) in pieces.iter().enumerate().take(middle).rev() {
            let ray = self.ray(number).0;
            // A surface that goes on reaches to the next ray: only past that the search may end.
            let next = self.ray((number + 1).min(self.len() - 1)).0;
            if is_done(found, bearing - next.max(ray + step)) {
                break;
            }
            let is_last = ray < bearing - half;
            found.take(piece.as_ref(), !is_last);
            if is_last {
                break;
            }
        }
    }

    /// Distance of a point from the surfaces that a range of rays hit [m].
    fn off(&self, point: [f64; 2], rays: Range<usize>) -> f64 {
        let mut nearest = NearestPiece { point, square: f64::INFINITY, way: None };
        let first = rays.start;
        for (number, piece) in (first..).zip(self.pieces().get(rays).unwrap_or_default()) {
            nearest.take(piece.as_ref(), number > first);
        }
        nearest.distance()
    }
}

/// The nearest surface piece to a point, among those that were compared.
struct NearestPiece {
    point: [f64; 2],
    /// Squared distance of the nearest piece [m^2]; before a piece is found, that of the search
    /// limit.
    square: f64,
    /// Vector from the nearest piece to the point [m]; None if no piece was found.
    way: Option<[f64; 2]>,
}

impl NearestPiece {
    fn is_found(&self) -> bool {
        self.way.is_some()
    }

    /// Distance of the point [m]; infinite if nothing was found.
    fn distance(&self) -> f64 {
        self.way.map_or(f64::INFINITY, |[x, y]| libm::hypot(x, y))
    }

    /// Compare a surface piece. `follows`: leave out the part that it shares with the piece before.
    fn take(&mut self, piece: Option<&SurfacePiece>, follows: bool) {
        let Some(piece) = piece else { return };
        for [x, y] in piece.ways_to(self.point, follows) {
            let square = x * x + y * y;
            if square < self.square {
                (self.square, self.way) = (square, Some([x, y]));
            }
        }
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

    /// The search that ends early finds what a search of all surfaces finds.
    #[test]
    fn the_nearest_surface_is_that_of_all() -> Result<(), Error> {
        // Steps, gaps and rays without return, from a fixed sequence; bearings not quite even.
        let hash = |k: usize| (k.wrapping_mul(2_654_435_761) % 1000) as f64 / 1000.0;
        let bearings: Vec<f64> =
            (0..400).map(|k| -3.1 + 0.0155 * (k as f64 + 0.3 * hash(k))).collect();
        let range = |k: usize| {
            let block = hash(k / 17 + 500);
            if block < 0.2 { f64::INFINITY } else { 0.5 + 6.0 * block + 0.05 * hash(k) }
        };
        let scan = PolarScan { ranges: (0..400).map(range).collect(), bearings };
        let view = ScanWithLimits { scan: &scan, range_min: 0.1, range_max: 10.0 }.sorted()?;
        let mut found = 0;
        for k in 0..2000 {
            let (bearing, range) = (6.2 * hash(3 * k) - 3.1, 0.3 + 7.0 * hash(7 * k + 1));
            let point = [range * libm::cos(bearing), range * libm::sin(bearing)];
            let all = view.pieces().iter().flatten().flat_map(|piece| piece.ways_to(point, false));
            let least = all.map(|[x, y]| libm::hypot(x, y)).fold(f64::INFINITY, f64::min);
            for reach in [0.05, 0.6] {
                let nearest = view.within(point, reach).map_or(f64::INFINITY, |(off, _)| off);
                let expected = if least < reach { least } else { f64::INFINITY };
                assert!(
                    nearest == expected || (nearest - expected).abs() < 1e-12,
                    "{point:?} {reach}"
                );
                found += usize::from(nearest.is_finite());
            }
        }
        assert!(found > 500, "{found}");
        Ok(())
    }
}
