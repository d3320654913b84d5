//! Triangle meshes and height fields.

use crate::parry::{BoundingBox, CastRay, FARTHEST, Tree};
use crate::refused;
use lidar_core::Error;
use lidar_core::geometry::transform::{dot, minus, norm};
use lidar_core::util::budget;

/// Largest number of faces of one mesh.
pub const MAX_FACES: usize = 20_000_000;
/// Memory that a face may take, including its corners, its boxes and its part of the tree [bytes].
const ROOM_OF_FACE: usize = 640;

/// Triangle mesh with a tree of its own.
#[derive(Clone, Debug)]
pub struct Mesh {
    vertices: Vec<[f64; 3]>,
    faces: Vec<[u32; 3]>,
    /// First corner and the two edges from it, of every face.
    triangles: Vec<[[f64; 3]; 3]>,
    tree: Tree,
    radius: f64,
}

impl Mesh {
    /// Make a mesh of vertices [m] and faces. A face is a triple of indices of vertices.
    ///
    /// # Errors
    /// [`Error::Value`] if a vertex is not finite or beyond 1e15 m, there is no face, or an index of a face has no
    /// vertex; [`Error::Limit`] above [`MAX_FACES`], [`Error::Memory`].
    pub fn new(vertices: Vec<[f64; 3]>, faces: Vec<[u32; 3]>) -> Result<Self, Error> {
        let bad = |name, expected, index, got| Error::Value { name, expected, index, got };
        let is_near = |v: &[f64; 3]| v.iter().all(|c| c.abs() <= FARTHEST); // false for NaN
        if let Some(index) = vertices.iter().position(|v| !is_near(v)) {
            let got = format!("{:?}", vertices[index]);
            return Err(bad("vertices", "finite, within 1e15 m of the origin", index, got));
        }
        if faces.is_empty() {
            return Err(bad("faces", "at least one face", 0, "none".into()));
        }
        let outside = |face: &[u32; 3]| face.iter().any(|&v| v as usize >= vertices.len());
        if let Some(index) = faces.iter().position(outside) {
            let got = format!("{:?} of {} vertices", faces[index], vertices.len());
            return Err(bad("faces", "indices of vertices", index, got));
        }
        budget::check_memory("a mesh", faces.len(), ROOM_OF_FACE)?;
        let mut boxes =
            budget::vec_with_capacity("mesh", faces.len(), MAX_FACES, "split the mesh")?;
        boxes.extend(
            faces.iter().map(|face| BoundingBox::around(face.map(|v| vertices[v as usize]))),
        );
        let radius = vertices.iter().map(|&v| norm(v)).fold(0.0, f64::max);
        let triangles = faces.iter().map(|face| {
            let [a, b, c] = face.map(|v| vertices[v as usize]);
            [a, minus(b, a), minus(c, a)]
        });
        let triangles = triangles.collect();
        Ok(Self { tree: Tree::new(&boxes), vertices, faces, triangles, radius })
    }

    /// Ground of `heights` [m] (row by row, rows along x, `columns` along y) with `cell` [m]
    /// between neighbours, its middle at x = y = 0; every cell is two triangles.
    ///
    /// # Errors
    /// [`Error::Parameter`] unless there are at least 2 x 2 heights and `cell` is finite and > 0;
    /// otherwise as [`Mesh::new`].
    pub fn height_field(heights: &[f64], columns: usize, cell: f64) -> Result<Self, Error> {
        let rows = heights.len().checked_div(columns).unwrap_or(0);
        if rows < 2 || columns < 2 || rows * columns != heights.len() {
            let got = [rows, columns];
            return Err(refused("heights", "at least 2 x 2, all rows of equal length", &got));
        }
        if !(cell.is_finite() && cell > 0.0) {
            return Err(refused("cell", "finite and > 0", &cell));
        }
        let cells = (rows - 1) * (columns - 1);
        budget::check_memory("a height field", 2 * cells, ROOM_OF_FACE)?;
        let mut faces =
            budget::vec_with_capacity("height field", 2 * cells, MAX_FACES, "use larger cells")?;
        let half = [0.5 * cell * (rows - 1) as f64, 0.5 * cell * (columns - 1) as f64];
        let place = |index: usize| {
            let (row, column) = (index / columns, index % columns);
            [cell * row as f64 - half[0], cell * column as f64 - half[1], heights[index]]
        };
        let vertices = (0..heights.len()).map(place).collect();
        for row in 0..rows - 1 {
            for column in 0..columns - 1 {
                let corner = (row * columns + column) as u32; // fits: MAX_FACES is far below 2^32
                let (next_row, next) = (corner + columns as u32, corner + 1);
                faces.push([corner, next_row, next]);
                faces.push([next, next_row, next_row + 1]);
            }
        }
        Self::new(vertices, faces)
    }

    /// Vertices of the mesh [m].
    #[must_use]
    pub fn vertices(&self) -> &[[f64; 3]] {
        &self.vertices
    }

    /// Indices of the three vertices of every face.
    #[must_use]
    pub fn faces(&self) -> &[[u32; 3]] {
        &self.faces
    }

    pub(crate) fn radius(&self) -> f64 {
        self.radius
    }

    pub(crate) fn meet(&self, ray: &CastRay, limit: f64) -> Option<f64> {
        self.nearest(ray, limit).map(|(_, distance)| distance)
    }

    /// Unit normal of the face that `ray` meets first; the reversed ray if it meets none.
    pub(crate) fn normal(&self, ray: &CastRay) -> [f64; 3] {
        let normal = self.nearest(ray, f64::MAX).map(|(face, _)| {
            let [_, ab, ac] = self.triangles[face as usize];
            cross(ab, ac)
        });
        let normal = normal.unwrap_or(ray.direction);
        let length = norm(normal);
        normal.map(|part| part / length)
    }

    fn nearest(&self, ray: &CastRay, limit: f64) -> Option<(u32, f64)> {
        self.tree.nearest(ray, limit, |face, _| meet_triangle(ray, &self.triangles[face as usize]))
    }

    pub(crate) fn clearance(&self, point: [f64; 3], limit: f64) -> f64 {
        self.tree.clearance(point, limit, |face| {
            norm(minus(point, nearest_on_triangle(point, self.triangle(face))))
        })
    }

    fn triangle(&self, face: u32) -> [[f64; 3]; 3] {
        self.faces[face as usize].map(|vertex| self.vertices[vertex as usize])
    }
}

fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// Distance along `ray` to a triangle, from either side; None if it misses the triangle.
///
/// # Source
/// Moeller & Trumbore, "Fast, Minimum Storage Ray/Triangle Intersection", 1997.
#[inline]
fn meet_triangle(ray: &CastRay, [a, ab, ac]: &[[f64; 3]; 3]) -> Option<f64> {
    let p = cross(ray.direction, *ac);
    let scale = dot(*ab, p);
    if scale == 0.0 {
        return None; // parallel, or no area
    }
    // Shares u and v of the edges, times |scale|: most triangles are refused without a division.
    let (size, sign) = (scale.abs(), scale.signum());
    let from_a = minus(ray.origin, *a);
    let u = sign * dot(from_a, p);
    if u < 0.0 || u > size {
        return None;
    }
    let q = cross(from_a, *ab);
    let v = sign * dot(ray.direction, q);
    if v < 0.0 || u + v > size {
        return None;
    }
    let distance = dot(*ac, q) / scale;
    (distance >= 0.0).then_some(distance)
}

/// Point of a triangle nearest to `point`: on its face, or else on an edge.
fn nearest_on_triangle(point: [f64; 3], [a, b, c]: [[f64; 3]; 3]) -> [f64; 3] {
    let normal = cross(minus(b, a), minus(c, a));
    let inside = |from: [f64; 3], to: [f64; 3]| {
        dot(cross(minus(to, from), minus(point, from)), normal) >= 0.0
    };
    let area = dot(normal, normal);
    if area > 0.0 && inside(a, b) && inside(b, c) && inside(c, a) {
        let height = dot(minus(point, a), normal) / area;
        return std::array::from_fn(|axis| point[axis] - height * normal[axis]);
    }
    let mut best = a;
    for (from, to) in [(a, b), (b, c), (c, a)] {
        let near = nearest_on_segment(point, from, to);
        if norm(minus(point, near)) < norm(minus(point, best)) {
            best = near;
        }
    }
    best
}

fn nearest_on_segment(point: [f64; 3], from: [f64; 3], to: [f64; 3]) -> [f64; 3] {
    let way = minus(to, from);
    let length = dot(way, way);
    if length == 0.0 {
        return from;
    }
    let share = (dot(minus(point, from), way) / length).clamp(0.0, 1.0);
    std::array::from_fn(|axis| from[axis] + share * way[axis])
}

#[cfg(test)]
mod tests {
    use super::*;

    fn square() -> Result<Mesh, Error> {
        Mesh::height_field(&[0.0, 0.0, 0.0, 2.0], 2, 2.0)
    }

    #[test]
    fn a_height_field_is_two_triangles_per_cell() -> Result<(), Error> {
        let mesh = square()?;
        assert_eq!(mesh.faces(), [[0, 2, 1], [1, 2, 3]]);
        assert_eq!(mesh.vertices()[3], [1.0, 1.0, 2.0]);
        for (x, y, height) in [(-0.5, -0.5, 0.0), (0.5, 0.5, 1.0), (0.0, 0.0, 0.0)] {
            let down = CastRay { origin: [x, y, 10.0], direction: [0.0, 0.0, -1.0] };
            assert_eq!(mesh.meet(&down, 100.0), Some(10.0 - height));
        }
        Ok(())
    }

    #[test]
    fn distances_to_face_edge_and_corner() -> Result<(), Error> {
        let mesh = Mesh::new(vec![[0.0; 3], [4.0, 0.0, 0.0], [0.0, 4.0, 0.0]], vec![[0, 1, 2]])?;
        for (point, expected) in
            [([1.0, 1.0, -2.0], 2.0), ([2.0, -3.0, 4.0], 5.0), ([-3.0, -4.0, 0.0], 5.0)]
        {
            assert!((mesh.clearance(point, 100.0) - expected).abs() < 1e-12);
        }
        Ok(())
    }

    #[test]
    fn bad_meshes_are_refused() {
        assert!(Mesh::new(vec![[0.0; 3]], vec![]).is_err());
        assert!(Mesh::new(vec![[0.0; 3]], vec![[0, 0, 1]]).is_err());
        assert!(Mesh::new(vec![[f64::NAN; 3]], vec![[0, 0, 0]]).is_err());
        assert!(Mesh::height_field(&[0.0; 3], 2, 1.0).is_err());
        assert!(Mesh::height_field(&[0.0; 4], 0, 1.0).is_err());
    }
}
