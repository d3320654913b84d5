//! Parameters of the classification of clusters.

/// Parameters of the classification of clusters as background, flying or unknown.
#[derive(Clone, Debug, PartialEq)]
pub struct ClassifyParameters {
    /// Rule A: points closer than this to an occupied voxel are background, d_close [m].
    pub close_distance: f64,
    /// Rule B: length (L1) at which a path of uncertain voxels is a way out, d_search [m].
    pub search_distance: f64,
    /// If true, the diagonal of a cluster's box is added to its search distance.
    pub search_adds_extent: bool,
    /// If true, rule B is evaluated on the map after the update with this scan, else before it.
    pub after_update: bool,
    /// If true, a path that leaves the operating volume counts as a way out. If false, its border
    /// counts as a wall.
    pub open_border: bool,
    /// If true, uncertain voxels in a cluster's own shadow do not connect it with its surroundings.
    pub own_shadow: bool,
    /// If true, the search also continues from a cluster's own voxels that are free, so that a
    /// cluster beside unobserved space is connected with it. This concerns walls seen at a grazing
    /// angle: the rays along them have made their voxels free.
    pub expand_own: bool,
    /// Largest extent of a flying object [m]. None: no limit.
    pub max_extent: Option<f64>,
    /// Diagonal beyond which clusters are background [m]. None: no limit.
    pub background_extent: Option<f64>,
    /// Smallest number of points of a flying object.
    pub min_points: usize,
    /// Largest distance of a flying object from the sensor [m]. None: no limit.
    pub max_distance: Option<f64>,
    /// Largest gap between clusters that are classified together [m]: their common extent counts,
    /// and all are background if background of this scan is among them. None: each cluster is
    /// classified alone.
    pub group_distance: Option<f64>,
    /// Smallest share of free voxels among the neighbours of a flying object's voxels.
    pub min_clearance: f64,
    /// Height from which on clusters that are much higher than wide, such as signs and people,
    /// count as standing on something [m]. None: no limit.
    pub upright_height: Option<f64>,
    /// If true, unknown clusters on a confirmed track are flying objects, even if most of their
    /// surroundings are unknown.
    pub follow_tracks: bool,
    /// If true, enclosed uncertain voxels around a flying cluster are made free.
    pub fill_pockets: bool,
    /// If true, points that are background by rule A anyway form one cluster, without a search for
    /// their links, wherever no result depends on it.
    pub skips_explained: bool,
}

/// Parameters of the best mode (not of the paper).
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
    /// Rules A, B and C as published, without limits on size and distance.
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
