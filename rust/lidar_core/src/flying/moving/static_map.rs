//! A map of all that stands: points of all scans, without those that are where space was free before
//! or is free after them.
//!
//! Fine voxels tell near the sensor, since feet stand beside the ground. Further away rays do not meet
//! every one of these, and coarse ones tell.

use super::free_space::{FreeSpace, around, with_beside};
use crate::Error;
use crate::flying::integrate::classified_scan::{ClassifiedScan, Origins};
use crate::flying::integrate::integrator::Integrator;
use crate::flying::map::blocks::Place;
use crate::flying::map::full_state::{MapState, SavedMap};
use crate::flying::map::parameters::{MapParameters, Rays};
use crate::flying::map::voxel_map::VoxelMap;
use crate::flying::point_class::PointClass;
use crate::flying::scan::prepared::Prepared;
use crate::geometry::lattice::{Voxel, floor, wide};
use crate::util::cancel;
use crate::util::key_hasher::KeyHasher;
use crate::util::threads::Workers;
use serde::{Deserialize, Serialize};
use std::collections::{HashMap, HashSet};
use std::hash::BuildHasherDefault;

/// Edge of the voxels [m], and length that rays clear in them [m].
const FINE: [f64; 2] = [0.1, 20.0];
const COARSE: [f64; 2] = [0.25, 40.0];
/// One point is kept in each cell of this edge [m]: no point is further than 5 cm from one that is kept.
const CELL: f64 = 0.028;
/// Updates after which a voxel is occupied for sure.
const SURE_UPDATES: f64 = 30.0;
/// Fewer voxels that hang together are not taken out: noise beside a surface.
const FEWEST: usize = 4;

type Keys = BuildHasherDefault<KeyHasher>;

/// Voxels of one size.
struct VoxelLayer {
    map: VoxelMap,
    /// Voxels in which points were while they were free, and those of them that were beside nothing.
    met_free: HashSet<Place, Keys>,
    met_open: HashSet<Place, Keys>,
}

/// Stage that takes scans and tells what stands.
pub(crate) struct StaticMapper {
    /// Fine, then coarse.
    layers: [VoxelLayer; 2],
    integrator: Integrator,
    /// The first point in every cell, frame of the map [m].
    points: HashMap<Place, [f32; 3], Keys>,
}

/// State of a [`VoxelLayer`] as bytes are written from it, in ascending order.
#[derive(Serialize)]
struct LayerState<'a> {
    map: MapState<'a>,
    met_free: Vec<Place>,
    met_open: Vec<Place>,
}

/// [`LayerState`] as it is read back.
#[derive(Deserialize)]
struct SavedLayer {
    map: SavedMap,
    met_free: Vec<Place>,
    met_open: Vec<Place>,
}

/// State of a [`StaticMapper`] as bytes are written from it, in ascending order.
#[derive(Serialize)]
pub(crate) struct StaticMapperState<'a> {
    layers: [LayerState<'a>; 2],
    points: Vec<(Place, [f32; 3])>,
}

/// [`StaticMapperState`] as it is read back.
#[derive(Deserialize)]
pub(crate) struct SavedStaticMapper {
    layers: [SavedLayer; 2],
    points: Vec<(Place, [f32; 3])>,
}

impl VoxelLayer {
    fn beside(of: &MapParameters, [voxel_size, max_range]: [f64; 2]) -> Result<Self, Error> {
        let rays = Rays::OnePerEnd;
        let parameters = MapParameters { voxel_size, max_range, rays, ..of.clone() };
        let (met_free, met_open) = Default::default();
        Ok(Self { map: VoxelMap::new(parameters)?, met_free, met_open })
    }

    fn voxel(&self, point: [f32; 3]) -> Option<Voxel> {
        floor(self.map.lattice().scaled(wide(point)))
    }

    fn take(
        &mut self,
        integrator: &mut Integrator,
        scan: &ClassifiedScan<'_>,
    ) -> Result<(), Error> {
        let (free, open) = self.met(scan.points);
        integrator.integrate(&mut self.map, scan)?;
        self.met_free.extend(free);
        self.met_open.extend(open);
        Ok(())
    }

    /// Free voxels that hold points, and those of them that are beside nothing else.
    fn met(&self, points: &[[f32; 3]]) -> (Vec<Place>, Vec<Place>) {
        let mut space = FreeSpace::of(&self.map);
        let mut voxels: Vec<Voxel> = Vec::new();
        for &point in points {
            let Some(voxel) = self.voxel(point) else { continue };
            if voxels.last() != Some(&voxel) && space.is_free(voxel) {
                voxels.push(voxel);
            }
        }
        voxels.sort_unstable();
        voxels.dedup();
        let is_entered = |voxel: Voxel| self.met_open.contains(&Place(voxel));
        let open = voxels.iter().filter(|&&voxel| space.is_open(voxel, is_entered));
        let open = open.map(|&voxel| Place(voxel)).collect();
        (voxels.into_iter().map(Place).collect(), open)
    }

    /// Voxels with `points` of what moved, in ascending order. `grows`: those beside them, too, where
    /// rays have passed.
    fn moved<'a>(
        &self,
        points: impl Iterator<Item = &'a [f32; 3]>,
        grows: bool,
    ) -> Result<Vec<Voxel>, Error> {
        let mut voxels: Vec<Voxel> = points.filter_map(|&point| self.voxel(point)).collect();
        voxels.sort_unstable();
        voxels.dedup();
        cancel::check()?;
        let mut space = FreeSpace::of(&self.map);
        voxels.retain(|&voxel| space.is_free(voxel) || self.met_free.contains(&Place(voxel)));
        cancel::check()?;
        let mut is_open = |&voxel: &Voxel| {
            self.met_open.contains(&Place(voxel))
                || around(voxel).chain([voxel]).all(|one| space.is_free(one))
        };
        let open: Vec<bool> = voxels.iter().map(&mut is_open).collect();
        let moved = with_beside(&voxels, &open, if grows { FEWEST } else { 1 });
        let mut kept = moved.iter().zip(&open).map(|(&moved, &open)| moved && (grows || open));
        voxels.retain(|_| kept.next().unwrap_or(false));
        Ok(voxels)
    }

    fn state(&self) -> LayerState<'_> {
        let sorted = |places: &HashSet<Place, Keys>| {
            let mut sorted: Vec<Place> = places.iter().copied().collect();
            sorted.sort_unstable();
            sorted
        };
        let (met_free, met_open) = (sorted(&self.met_free), sorted(&self.met_open));
        LayerState { map: self.map.whole_state(), met_free, met_open }
    }

    fn restored(saved: SavedLayer) -> Result<Self, Error> {
        let met_free = saved.met_free.into_iter().collect();
        let met_open = saved.met_open.into_iter().collect();
        Ok(Self { map: VoxelMap::restored(saved.map)?, met_free, met_open })
    }
}

impl StaticMapper {
    /// An empty map in the frame of `of`.
    ///
    /// # Errors
    /// As [`VoxelMap::new`].
    pub(crate) fn beside(of: &MapParameters, workers: Workers) -> Result<Self, Error> {
        Ok(Self {
            layers: [VoxelLayer::beside(of, FINE)?, VoxelLayer::beside(of, COARSE)?],
            integrator: Integrator::on(workers),
            points: HashMap::default(),
        })
    }

    /// Take a scan.
    ///
    /// # Errors
    /// As [`Integrator::integrate`]; the map is unchanged then.
    pub(crate) fn take(&mut self, scan: &Prepared) -> Result<(), Error> {
        let is_finite = |point: &[f32; 3]| point.iter().all(|value| value.is_finite());
        let of_point = |point: &[f32; 3]| match is_finite(point) {
            true => PointClass::Background,
            false => PointClass::Invalid,
        };
        let class: Vec<PointClass> = scan.points.iter().map(of_point).collect();
        let one = Origins::One(scan.pose.translation);
        let rays = ClassifiedScan {
            points: &scan.points,
            class: &class,
            origins: scan.origins.as_deref().map_or(one, Origins::Each),
            directions: scan.directions.as_deref(),
            no_return: scan.directions.is_some().then_some(&scan.no_return),
            no_ray: scan.no_ray.as_deref(),
            reach: scan.reach.as_deref(),
            pose_error: None,
        };
        for layer in &mut self.layers {
            layer.take(&mut self.integrator, &rays)?;
        }
        for &point in scan.points.iter().filter(|point| is_finite(point)) {
            if let Some(cell) = floor(wide(point).map(|value| value / CELL)) {
                self.points.entry(Place(cell)).or_insert(point);
            }
        }
        Ok(())
    }

    /// Points of what stands, frame of the map [m], in ascending order of their cells.
    ///
    /// # Errors
    /// [`Error::Interrupted`].
    pub(crate) fn points(&self) -> Result<Vec<[f32; 3]>, Error> {
        let moved = self.moved()?;
        let mut points: Vec<_> =
            self.points.iter().filter(|(_, point)| !self.is_of(&moved, **point)).collect();
        points.sort_unstable_by_key(|(cell, _)| **cell);
        Ok(points.into_iter().map(|(_, &point)| point).collect())
    }

    /// A map in which the fine voxels are occupied that hold points of what stands.
    ///
    /// # Errors
    /// [`Error::Interrupted`]; [`Error::Limit`] above the budget of the map.
    pub(crate) fn cleaned(&self) -> Result<VoxelMap, Error> {
        let mut map = VoxelMap::new(self.layers[0].map.parameters().clone())?;
        let occupied = map.parameters().g_occ;
        map.pull(&self.points()?, occupied, SURE_UPDATES)?;
        Ok(map)
    }

    /// Voxels of every layer that held points of what moved, in ascending order.
    fn moved(&self) -> Result<[Vec<Voxel>; 2], Error> {
        let [fine, coarse] = &self.layers;
        Ok([fine.moved(self.points.values(), true)?, coarse.moved(self.points.values(), false)?])
    }

    fn is_of(&self, moved: &[Vec<Voxel>; 2], point: [f32; 3]) -> bool {
        self.layers.iter().zip(moved).any(|(layer, moved)| {
            layer.voxel(point).is_some_and(|voxel| moved.binary_search(&voxel).is_ok())
        })
    }

    pub(crate) fn state(&self) -> StaticMapperState<'_> {
        let mut points: Vec<_> = self.points.iter().map(|(&cell, &point)| (cell, point)).collect();
        points.sort_unstable_by_key(|(cell, _)| *cell);
        StaticMapperState { layers: [self.layers[0].state(), self.layers[1].state()], points }
    }

    /// # Errors
    /// As [`VoxelMap::from_state`].
    pub(crate) fn restored(saved: SavedStaticMapper, workers: Workers) -> Result<Self, Error> {
        let [fine, coarse] = saved.layers;
        Ok(Self {
            layers: [VoxelLayer::restored(fine)?, VoxelLayer::restored(coarse)?],
            integrator: Integrator::on(workers),
            points: saved.points.into_iter().collect(),
        })
    }
}
