//! Parameters of the classification.

/// Parameters of the classification of clusters.
#[derive(Clone, Debug, PartialEq)]
pub struct ClassifyParameters {
    /// Rule A: closer than this to an occupied voxel is background, d_close [m].
    pub close_distance: f64,
    /// Rule B: a path of uncertain voxels this long (L1) ends the search, d_search [m].
    pub search_distance: f64,
    /// The diagonal of a cluster's box is added to its search distance.
    pub search_adds_extent: bool,
    /// Rule B is evaluated on the map after this scan's update, not before.
    pub after_update: bool,
    /// True if a search that leaves a fixed operating volume counts as a way out, false if the
    /// border counts as a wall.
    pub open_border: bool,
    /// Uncertain voxels in a cluster's own shadow do not connect it.
    pub own_shadow: bool,
    /// The search also continues from free voxels of a cluster, so that a cluster beside unobserved
    /// space is connected. A wall seen at a grazing angle lies in voxels that the rays along it
    /// have freed.
    pub expand_own: bool,
    /// Largest extent of a flying object [m].
    pub max_extent: Option<f64>,
    /// Larger clusters are background [m].
    pub background_extent: Option<f64>,
    /// Least number of points of a flying object.
    pub min_points: usize,
    /// Largest distance of a flying object from the sensor [m].
    pub max_distance: Option<f64>,
    /// Clusters with gaps up to this are classified together: by their common extent, and as
    /// background if background of this scan is among them [m].
    pub group_distance: Option<f64>,
    /// A flying object has at least this share of free voxels among the neighbours of its own.
    pub min_clearance: f64,
    /// Height of clusters that stand on something if they are much higher than wide, such as signs
    /// and people [m].
    pub upright_height: Option<f64>,
    /// Unknown clusters on a confirmed track are flying objects, even if their surroundings are
    /// mostly unknown.
    pub follow_tracks: bool,
    /// Enclosed uncertain voxels around a flying cluster are made free.
    pub fill_pockets: bool,
    /// Points that are background by rule A anyway are one cluster, without a search for their links,
    /// where no result depends on it.
    pub skips_explained: bool,
}

/// Best mode.
impl Default for ClassifyParameters {
    fn default() -> Self {
        Self {
            close_distance: 0.7,
            search_distance: 3.0,
            search_adds_extent: false,
            after_update: false,
            open_border: true,
            own_shadow: true,
            expand_own: true,
            max_extent: Some(2.5),
            background_extent: Some(3.5),
            min_points: 3,
            max_distance: Some(20.0),
            group_distance: Some(0.7),
            min_clearance: 0.625,
            upright_height: Some(1.2),
            follow_tracks: true,
            fill_pockets: false,
            skips_explained: true,
        }
    }
}

impl ClassifyParameters {
    /// Rules A, B and C as published, without gates.
    #[must_use]
    pub fn paper() -> Self {
        Self {
            open_border: false,
            own_shadow: false,
            expand_own: false,
            max_extent: None,
            background_extent: None,
            min_points: 1,
            max_distance: None,
            group_distance: None,
            min_clearance: 0.0,
            upright_height: None,
            follow_tracks: false,
            ..Self::default()
        }
    }
}
