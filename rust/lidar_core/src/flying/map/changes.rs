//! Changes of a voxel map since the last removal of separate background.

use super::blocks::Place;
use super::islands::Marks;
use super::layers::{Layer, Neighbours};
use super::parameters::Separation;
use crate::geometry::lattice::Voxel;
use crate::util::key_hasher::Spread;
use std::collections::HashSet;
use std::hash::BuildHasherDefault;

/// Layers with changes that are kept; above it, as when removal has been given up, all is looked at again.
const MOST_CHANGES: usize = 1 << 20;

/// Voxels whose occupied state changed since the last removal.
#[derive(Clone, Default)]
pub(crate) struct Changes {
    /// Voxels that became occupied, at least tentatively.
    pub(super) gained: Vec<Layer>,
    /// Voxels that ceased to be occupied, or confidently so, and those that removal left occupied.
    pub(super) lost: Vec<Layer>,
    /// The parameters of the last removal; with others every component is looked at.
    pub(super) settled_with: Option<Separation>,
    /// A voxel of a component that had enough confident voxels.
    pub(super) anchor: Option<Voxel>,
    /// Memory that the searches use again.
    pub(super) marks: Marks,
    /// Neighbours for the parameters of the last removal.
    pub(super) neighbours: Option<Neighbours>,
    /// Voxels whose groups are never separate: what stands still from the beginning.
    pub(crate) kept: HashSet<Place, BuildHasherDefault<Spread>>,
}

impl Changes {
    /// Note voxels of a layer that changed, given those of it that were occupied before.
    pub(crate) fn note(&mut self, layer: Layer, before: u64) {
        if self.settled_with.is_none() {
            return; // the next removal looks at everything
        }
        add(&mut self.gained, Layer { bits: layer.bits & !before, ..layer });
        add(&mut self.lost, Layer { bits: layer.bits & before, ..layer });
        if self.gained.len() + self.lost.len() > MOST_CHANGES {
            (self.gained, self.lost) = (Vec::new(), Vec::new());
            self.settled_with = None;
        }
    }

    /// Forget the history: the next removal looks at every component.
    pub(crate) fn restart(&mut self) {
        *self = Self { kept: std::mem::take(&mut self.kept), ..Self::default() };
    }
}

fn add(layers: &mut Vec<Layer>, layer: Layer) {
    match layers.last_mut().filter(|last| last.is_same(&layer)) {
        Some(last) => last.bits |= layer.bits,
        None if layer.bits != 0 => layers.push(layer),
        None => {}
    }
}
