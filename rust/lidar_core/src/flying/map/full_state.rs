//! The whole state of a voxel map: values, and the history of changes, which a map file leaves out.

use super::blocks::Block;
use super::changes::{Changes, SavedChanges};
use super::local_map::LocalMap;
use super::parameters::MapParameters;
use super::voxel_map::VoxelMap;
use crate::Error;
use crate::geometry::transform::Transform;
use crate::util::full_state::{opened, sealed};
use serde::{Deserialize, Serialize};

const KIND: &str = "voxel map";

/// State of a map, for writing. The blocks are in the order in which they were made.
#[derive(Serialize)]
pub(crate) struct MapState<'a> {
    parameters: &'a MapParameters,
    blocks: Vec<&'a Block>,
    changes: SavedChanges,
}

/// [`MapState`], for reading.
#[derive(Deserialize)]
pub(crate) struct SavedMap {
    parameters: MapParameters,
    blocks: Vec<Block>,
    changes: SavedChanges,
}

impl VoxelMap {
    /// The whole state as bytes, including the parameters, for [`VoxelMap::from_state`].
    ///
    /// # Errors
    /// [`Error::Limit`] if the bytes do not fit into memory.
    pub fn to_state(&self) -> Result<Vec<u8>, Error> {
        sealed(KIND, &(), &self.whole_state())
    }

    /// The map of a saved state. Its later results are equal to those of the saved map, bit by bit.
    ///
    /// # Errors
    /// Errors of [`VoxelMap::new`]; [`Error::Format`] for bytes that [`VoxelMap::to_state`] did not
    /// make.
    pub fn from_state(bytes: &[u8]) -> Result<Self, Error> {
        Self::restored(opened(KIND, &(), bytes)?)
    }

    pub(crate) fn whole_state(&self) -> MapState<'_> {
        MapState {
            parameters: self.parameters(),
            blocks: self.blocks.iter().collect(),
            changes: self.changes.saved(),
        }
    }

    pub(crate) fn restored(saved: SavedMap) -> Result<Self, Error> {
        let mut map = Self::new(saved.parameters)?;
        map.blocks.restore(saved.blocks)?;
        map.changes = Changes::restored(saved.changes, map.blocks.len())?;
        Ok(map)
    }
}

/// State of a [`LocalMap`], for writing.
#[derive(Serialize)]
pub(crate) struct LocalState<'a> {
    map: MapState<'a>,
    map_from_world: Transform,
    is_anchored: bool,
}

/// [`LocalState`], for reading.
#[derive(Deserialize)]
pub(crate) struct SavedLocalMap {
    map: SavedMap,
    map_from_world: Transform,
    is_anchored: bool,
}

impl LocalMap {
    pub(crate) fn state(&self) -> LocalState<'_> {
        let Self { map, map_from_world, is_anchored } = self;
        LocalState {
            map: map.whole_state(),
            map_from_world: *map_from_world,
            is_anchored: *is_anchored,
        }
    }

    /// The local map of a saved state.
    ///
    /// # Errors
    /// As [`VoxelMap::from_state`].
    pub(crate) fn restored(saved: SavedLocalMap) -> Result<Self, Error> {
        let SavedLocalMap { map, map_from_world, is_anchored } = saved;
        Ok(Self { map: VoxelMap::restored(map)?, map_from_world, is_anchored })
    }
}
