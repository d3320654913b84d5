//! Parameters of the first background.
//!
//! No voxel starts occupied and points become background only near occupied voxels, so without a
//! seed nothing is ever background and nothing is ever detected. The paper is silent about it.

/// Seeds of the background.
#[derive(Clone, Debug, PartialEq)]
pub struct SeedParameters {
    /// Scans of the burn-in, 0 for none.
    pub burn_in_scans: u32,
    /// Time between two scans for which `burn_in_scans` is meant [s]: other sensors take as many scans
    /// as fit into the same time, at least 3. None counts scans whatever their rate.
    pub burn_in_period: Option<f64>,
    /// During the burn-in larger clusters are background [m].
    pub burn_in_extent: f64,
    /// Number of scans of the burn-in with points in a voxel that make the voxel background; 0 for
    /// none.
    pub standing_scans: u32,
    /// Largest shift of a voxel's points between the halves of the burn-in that counts as standing [m].
    pub standing_shift: f64,
    /// Tracks this far from their start protect their surroundings from becoming background [m].
    pub standing_track_distance: f64,
    /// Clusters that reach down to this height are background, world frame [m].
    pub ground_height: Option<f64>,
    /// Height of the sensor above ground in the first scan: the voxel there is seeded [m].
    pub take_off_height: Option<f64>,
}

/// Best mode.
impl Default for SeedParameters {
    fn default() -> Self {
        Self {
            burn_in_scans: 10,
            burn_in_period: Some(0.1),
            burn_in_extent: 2.5,
            standing_scans: 5,
            standing_shift: 0.04,
            standing_track_distance: 0.5,
            ground_height: None,
            take_off_height: None,
        }
    }
}

impl SeedParameters {
    /// A burn-in for targets of the paper's size: the paper does not state the source of the first
    /// background.
    #[must_use]
    pub fn paper() -> Self {
        Self { burn_in_period: None, burn_in_extent: 1.0, standing_scans: 0, ..Self::default() }
    }
}

impl SeedParameters {
    /// The place on the ground below the first position of the sensor, as a range finder would
    /// see it: two readings make its voxel tentatively occupied.
    pub(crate) fn take_off_ground(&self, [x, y, z]: [f64; 3]) -> Option<[[f32; 3]; 2]> {
        let height = self.take_off_height?;
        Some([[x, y, z - height].map(|value| value as f32); 2])
    }
}
