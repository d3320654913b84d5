//! Grid of directions with cells of 2 degrees: the six faces of a cube, each divided at equal
//! angles.
//!
//! All cells have nearly the same solid angle, and none has a pole. The grid is its own mirror
//! image in every plane of the axes.

use std::f64::consts::{FRAC_PI_2, FRAC_PI_4, PI, TAU};
use std::sync::LazyLock;

/// Number of cells along an edge of a face.
pub(crate) const EDGE: usize = 45;
/// Number of cells of the grid.
pub(crate) const CELLS: usize = 6 * EDGE * EDGE;
/// Number of bands of elevation, 2 degrees each.
pub(crate) const BANDS: usize = 90;
/// Number of sectors of azimuth, 10 degrees each.
pub(crate) const SECTORS: usize = 36;
/// Number of columns of azimuth, 2 degrees each.
pub(crate) const COLUMNS: usize = 180;
/// Number of parts of a cell along each edge. Rays into the sky go through the middles of the
/// parts.
pub(crate) const PARTS: usize = 3;

/// Angle from the centre of a cell within which a direction is in the cell or in a neighbour [rad]:
/// 2.4 degrees, which reaches the cells at the corners.
const REACH: f64 = 2.4 * PI / 180.0;
/// Number of directions around a centre with which neighbours are found.
const TRIED: usize = 24;
/// Directions this close below a border, in bands or sectors, count for the upper one. The middles
/// of some cells are on borders, so rounding must not decide.
const ON_BORDER: f64 = 1e-9;
/// Number of entries in the table of cells by coordinate. With it, no arc tangent is needed per
/// point.
const TABLE: usize = 1024;

/// Fixed geometry of the cells, shared by all sensors.
pub(crate) static GRID: LazyLock<Grid> = LazyLock::new(Grid::new);

/// Geometry of all cells, by cell.
pub(crate) struct Grid {
    /// Directions of the centres of the cells, as unit vectors.
    pub(crate) centers: Vec<[f64; 3]>,
    /// Solid angles of the cells [sr].
    pub(crate) solid_angles: Vec<f64>,
    /// Band of elevation and sector of azimuth of every cell's centre.
    pub(crate) bands: Vec<(u8, u8)>,
    /// Azimuth of every cell's centre [rad].
    pub(crate) azimuths: Vec<f64>,
    /// Column of azimuth of every cell's centre.
    pub(crate) columns: Vec<u8>,
    /// Unit vectors to the middles of the parts of every cell, row by row.
    pub(crate) parts: Vec<[f32; 3]>,
    neighbours: Vec<u16>,
    /// End of each cell's entries in `neighbours`.
    ends: Vec<u32>,
    /// Coordinates on a face at which cells begin.
    bounds: [f64; EDGE + 1],
    /// The cell at the beginning of every part of an edge.
    table: [u8; TABLE + 1],
}

impl Grid {
    fn new() -> Self {
        let mut bounds = [0.0; EDGE + 1];
        for (index, bound) in bounds.iter_mut().enumerate() {
            *bound = libm::tan(angle(index as f64));
        }
        let mut table = [0; TABLE + 1];
        for (index, first) in table.iter_mut().enumerate() {
            let place = 2.0 * index as f64 / TABLE as f64 - 1.0;
            *first = (bounds.partition_point(|&bound| bound <= place).clamp(1, EDGE) - 1) as u8;
        }
        let centers: Vec<[f64; 3]> = (0..CELLS).map(|cell| part_of(cell, [0.5; 2])).collect();
        let azimuths: Vec<f64> =
            centers.iter().map(|center| libm::atan2(center[1], center[0])).collect();
        let mut grid = Self {
            columns: azimuths.iter().map(|&azimuth| column_of(azimuth)).collect(),
            solid_angles: (0..CELLS).map(solid_angle).collect(),
            bands: centers.iter().map(|&center| band_and_sector(center)).collect(),
            parts: (0..CELLS * PARTS * PARTS).map(middle_of_part).collect(),
            azimuths,
            centers,
            neighbours: Vec::new(),
            ends: Vec::with_capacity(CELLS),
            bounds,
            table,
        };
        for cell in 0..CELLS {
            let mut found = grid.around(cell);
            found.sort_unstable();
            found.dedup();
            grid.neighbours.extend(found);
            grid.ends.push(grid.neighbours.len() as u32);
        }
        grid
    }

    /// Cell of a direction, which need not be a unit vector.
    #[inline]
    pub(crate) fn cell(&self, direction: [f64; 3]) -> usize {
        let mut axis = 0;
        for other in 1..3 {
            if direction[other].abs() > direction[axis].abs() {
                axis = other;
            }
        }
        let face = 2 * axis + usize::from(direction[axis] < 0.0);
        let depth = direction[axis].abs();
        let (u, v) = (direction[(axis + 1) % 3] / depth, direction[(axis + 2) % 3] / depth);
        (face * EDGE + self.along(u)) * EDGE + self.along(v)
    }

    #[inline]
    fn along(&self, place: f64) -> usize {
        let part = ((place + 1.0) * (0.5 * TABLE as f64)) as usize; // NaN gives 0
        let mut index = usize::from(self.table[part.min(TABLE)]);
        while index + 1 < EDGE && self.bounds[index + 1] <= place {
            index += 1;
        }
        index
    }

    /// A cell and its neighbours.
    #[inline]
    pub(crate) fn beside(&self, cell: usize) -> &[u16] {
        let start = cell.checked_sub(1).map_or(0, |before| self.ends[before] as usize);
        &self.neighbours[start..self.ends[cell] as usize]
    }

    fn around(&self, cell: usize) -> Vec<u16> {
        let center = self.centers[cell];
        let (side, up) = across(center);
        let mut found = vec![cell as u16];
        for turn in (0..TRIED).map(|step| step as f64 / TRIED as f64 * TAU) {
            let (sine, cosine) = (libm::sin(turn), libm::cos(turn));
            let offset = |axis: usize| cosine * side[axis] + sine * up[axis];
            let near = |axis: usize| center[axis] + libm::tan(REACH) * offset(axis);
            found.push(self.cell(std::array::from_fn(near)) as u16);
        }
        found
    }
}

/// Column of azimuth, for an azimuth [rad].
fn column_of(azimuth: f64) -> u8 {
    let column = ((azimuth / TAU + 0.5) * COLUMNS as f64 + ON_BORDER) as usize;
    (column % COLUMNS) as u8
}

/// Unit vector to a place in a cell, which is given as shares of the cell's edges.
pub(crate) fn part_of(cell: usize, [u, v]: [f64; 2]) -> [f64; 3] {
    let (face, inside) = (cell / (EDGE * EDGE), cell % (EDGE * EDGE));
    let (axis, sign) = (face / 2, if face.is_multiple_of(2) { 1.0 } else { -1.0 });
    let mut direction = [0.0; 3];
    direction[axis] = sign;
    direction[(axis + 1) % 3] = libm::tan(angle((inside / EDGE) as f64 + u));
    direction[(axis + 2) % 3] = libm::tan(angle((inside % EDGE) as f64 + v));
    let [x, y, z] = direction;
    let length = (x * x + y * y + z * z).sqrt();
    direction.map(|value| value / length)
}

fn middle_of_part(index: usize) -> [f32; 3] {
    let (cell, part) = (index / (PARTS * PARTS), index % (PARTS * PARTS));
    let share = |number: usize| (number as f64 + 0.5) / PARTS as f64;
    part_of(cell, [share(part / PARTS), share(part % PARTS)]).map(|value| value as f32)
}

/// Angle from the middle of a face, at a number of cells from its edge [rad].
fn angle(cells: f64) -> f64 {
    cells * (FRAC_PI_2 / EDGE as f64) - FRAC_PI_4
}

/// Solid angle of a cell [sr]: du dv (1 + tan^2 u) (1 + tan^2 v) / (1 + tan^2 u + tan^2 v)^(3/2) at
/// its centre.
fn solid_angle(cell: usize) -> f64 {
    let inside = cell % (EDGE * EDGE);
    let [u, v] = [inside / EDGE, inside % EDGE].map(|index| libm::tan(angle(index as f64 + 0.5)));
    let (u, v) = (u * u, v * v);
    let step = FRAC_PI_2 / EDGE as f64;
    step * step * (1.0 + u) * (1.0 + v) / libm::pow(1.0 + u + v, 1.5)
}

fn band_and_sector(direction: [f64; 3]) -> (u8, u8) {
    let azimuth = libm::atan2(direction[1], direction[0]);
    let sector = ((azimuth / TAU + 0.5) * SECTORS as f64 + ON_BORDER) as usize % SECTORS;
    (band_of(direction[2]) as u8, sector as u8)
}

/// Band of elevation of a unit vector with the vertical component `z`.
pub(crate) fn band_of(z: f64) -> usize {
    let elevation = libm::asin(z.clamp(-1.0, 1.0));
    (((elevation + FRAC_PI_2) / PI * BANDS as f64 + ON_BORDER) as usize).min(BANDS - 1)
}

/// Lowest and highest elevation of a band [rad].
pub(crate) fn limits_of(band: usize) -> [f64; 2] {
    [band, band + 1].map(|index| index as f64 / BANDS as f64 * PI - FRAC_PI_2)
}

/// Two unit vectors across a unit vector, and across each other.
fn across(direction: [f64; 3]) -> ([f64; 3], [f64; 3]) {
    use crate::geometry::transform::{cross, norm};
    let helper = if direction[2].abs() < 0.9 { [0.0, 0.0, 1.0] } else { [1.0, 0.0, 0.0] };
    let side = cross(direction, helper);
    let side = side.map(|value| value / norm(side));
    (side, cross(direction, side))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::transform::dot;

    #[test]
    fn a_direction_lies_in_the_cell_whose_middle_it_is() {
        for cell in 0..CELLS {
            assert_eq!(GRID.cell(GRID.centers[cell]), cell);
            for part in [[0.01, 0.01], [0.99, 0.01], [0.5, 0.99]] {
                assert_eq!(GRID.cell(part_of(cell, part).map(|value| 7.0 * value)), cell);
            }
        }
    }

    #[test]
    fn the_cells_fill_the_sphere() {
        let sum: f64 = GRID.solid_angles.iter().sum();
        assert!((sum / (2.0 * TAU) - 1.0).abs() < 1e-3, "{sum}");
    }

    #[test]
    fn neighbours_are_near_and_know_each_other() {
        for cell in 0..CELLS {
            let beside = GRID.beside(cell);
            assert!((7..=13).contains(&beside.len()), "{} around {cell}", beside.len());
            for &other in beside {
                let angle =
                    libm::acos(dot(GRID.centers[cell], GRID.centers[usize::from(other)]).min(1.0));
                assert!(angle < 4.5 * PI / 180.0);
            }
        }
    }
}
