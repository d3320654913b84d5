//! Parameters of the first background.
//!
//! No voxel is occupied at the start, and points become background only near occupied voxels. So
//! without a seed nothing is ever background, and nothing is ever detected. The paper does not say
//! where the first background comes from.

/// Parameters of the burn-in and of other seeds of the background.
#[derive(Clone, Debug, PartialEq)]
pub struct SeedParameters {
    /// Number of scans of the burn-in. 0: no burn-in.
    pub burn_in_scans: u32,
    /// Time between two scans for which `burn_in_scans` is meant [s]. With other sensors, the
    /// burn-in has as many scans as fit into the same time, at least 3. None: it has
    /// `burn_in_scans` scans at any scan rate.
    pub burn_in_period: Option<f64>,
    /// Diagonal beyond which clusters are background during the burn-in [m].
    pub burn_in_extent: f64,
    /// Number of scans of the burn-in with points in a voxel that make this voxel background. 0:
    /// points that stand still do not become background.
    pub standing_scans: u32,
    /// Largest shift of a voxel's points between the halves of the burn-in with which they still
    /// count as standing [m].
    pub standing_shift: f64,
    /// Distance of a track from its start beyond which its surroundings do not become background
    /// [m].
    pub standing_track_distance: f64,
    /// Height up to which clusters that reach down to it are background [m, world]. None: no such
    /// rule.
    pub ground_height: Option<f64>,
    /// Height of the sensor above the ground in the first scan [m]: the voxel below the sensor is
    /// seeded. None: not known.
    pub take_off_height: Option<f64>,
}

/// Parameters of the best mode (not of the paper).
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
    /// A burn-in for targets of the paper's size. The paper does not state the source of the first
    /// background.
    #[must_use]
    pub fn paper() -> Self {
        Self { burn_in_period: None, burn_in_extent: 1.0, standing_scans: 0, ..Self::default() }
    }
}

impl SeedParameters {
    /// Two points on the ground below the first position of the sensor, as a range finder would
    /// measure them: two readings make the voxel tentatively occupied. None if the height is not
    /// known.
    pub(crate) fn take_off_ground(&self, [x, y, z]: [f64; 3]) -> Option<[[f32; 3]; 2]> {
        let height = self.take_off_height?;
        Some([[x, y, z - height].map(|value| value as f32); 2])
    }
}
