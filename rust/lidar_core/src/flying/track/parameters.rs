//! Parameters of the tracker. Variants called `Paper` are the algorithm as published.

use crate::Error;
use crate::error::{require, require_positive};
use crate::geometry::cluster::{self, Clustering};

/// Largest number of tracks, and largest number of detections in one set.
pub const MAX_TRACKS: usize = 10_000;
/// Largest number of sets of detections in the history of a track: one bit for each.
pub const MAX_WINDOW: u32 = 64;

/// Which root of the covariance's determinant is the uncertainty radius.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RadiusForm {
    /// Cube root of the determinant, as in eq. 26. Its unit is that of a variance [m^2].
    Paper,
    /// Sixth root of the determinant: the geometric mean of the standard deviations [m].
    SixthRoot,
}

/// Radius of the region in which a track searches for its target. It grows with the uncertainty of
/// the position.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Radius {
    /// Root of the determinant.
    pub form: RadiusForm,
    /// Multiplier c_r of the root.
    pub scale: f64,
    /// Smallest radius [m].
    pub min: f64,
    /// Largest radius [m]. A track with a larger one is removed.
    pub max: f64,
}

/// Form of the process noise of the motion.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NoiseForm {
    /// The same covariance is added at every step, independent of the length of the step (eq. 31).
    Paper,
    /// White noise in continuous time: two short steps give the same result as one long step.
    Continuous,
    /// Like `Continuous`, with larger noise for a flying target while its measurements are further
    /// from their predictions than the noise allows. For a target that turns hard between two
    /// scans, the old acceleration is dropped.
    Adaptive,
}

/// Motion model of a target: a point mass with noise on position, velocity and acceleration.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Motion {
    /// Time constant with which the acceleration fades [s]. None: it stays constant, as in eq. 27.
    pub acceleration_time: Option<f64>,
    /// Time constant of the acceleration while a track is not measured [s]. None:
    /// `acceleration_time`.
    pub unseen_time: Option<f64>,
    /// Form of the process noise, which decides the meaning of `std`.
    pub form: NoiseForm,
    /// Standard deviations of the noise on position, velocity and acceleration, on every axis: per
    /// step [m, m/s, m/s^2] (`Paper`), or as roots of spectral densities [the same / sqrt(s)].
    pub std: [f64; 3],
}

/// Targets accelerate for about a second. A target that is not seen for long is assumed to fly
/// straight on.
impl Default for Motion {
    fn default() -> Self {
        Self {
            acceleration_time: Some(1.0),
            unseen_time: Some(0.3),
            form: NoiseForm::Adaptive,
            std: [0.0, 0.1, 4.0],
        }
    }
}

/// Position that a cluster measures, and the covariance of this measurement. Z is the parameter
/// `measurement_std`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MeasurementForm {
    /// The centroid at the stamp of the scan, with covariance Z^2 I (sec. III-F1).
    Paper,
    /// The centroid at the mean time of the cluster's points. Its covariance is Z^2 I plus the
    /// scatter of the points divided by their number.
    Cluster,
    /// The estimated centre of the target behind the points, at their mean time, with its own
    /// covariance. Like `Cluster` if the rays of the scan are not known.
    Center,
}

/// Treatment of clusters of targets that are partly hidden by something in front of them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hiding {
    /// A side of a cluster is partly hidden if it is shorter than this share of the track's usual
    /// side.
    pub share: f64,
    /// Time constant of the average that gives the usual size [s].
    pub time: f64,
}

/// Two seconds are long compared with the time between two scans. They are short compared with the
/// time in which a change of distance changes the visible size.
impl Default for Hiding {
    fn default() -> Self {
        Self { share: 0.75, time: 2.0 }
    }
}

/// Association of tracks with clusters, and of detections with tracks.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Association {
    /// Every track takes the nearest centroid, and every detection the nearest track (Algorithm 2).
    Paper,
    /// Global nearest neighbour: one-to-one assignment, with a gate on the Mahalanobis distance.
    Global {
        /// Probability that a true pair passes the gate.
        gate_probability: f64,
        /// Density of clusters that belong to no track [1/m^3].
        clutter_density: f64,
    },
}

/// Rule that decides when a track is confirmed and reported.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Confirmation {
    /// A track is confirmed for good as soon as `hits` of the last `window` sets of detections
    /// contained it.
    Counts {
        /// Number of sets that contained the track, >= 1.
        hits: u32,
        /// Number of sets in the history, from `hits` to [`MAX_WINDOW`].
        window: u32,
    },
    /// A track is confirmed when the probability that its target exists reaches `report`, until the
    /// probability falls below half of `report`. Improbable tracks are removed.
    Existence {
        /// Probability from which on a track is reported, above 0 and below 1.
        report: f64,
    },
}

impl Confirmation {
    fn check(self) -> Result<(), Error> {
        match self {
            Self::Counts { hits, window } => require(
                (1..=MAX_WINDOW).contains(&window) && (1..=window).contains(&hits),
                "confirm_hits",
                "1 <= confirm_hits <= confirm_window <= 64",
                format_args!("{hits} of {window}"),
            ),
            Self::Existence { report } => {
                require(report > 0.0 && report < 1.0, "report_existence", "0 < value < 1", report)
            }
        }
    }
}

/// Limits within which two tracks follow the same target.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Merging {
    /// Largest distance between their positions [m].
    pub distance: f64,
    /// Largest difference of their velocities [m/s].
    pub speed: f64,
}

/// Two targets that fly past each other differ by more than 1 m/s.
impl Default for Merging {
    fn default() -> Self {
        Self { distance: 0.3, speed: 1.0 }
    }
}

/// Growth of a track's uncertainty, for its removal, while it has no measurement.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Ageing {
    /// It always grows (Algorithm 2, lines 15-17).
    Paper,
    /// It grows only while the track's region should give returns. The search region then never
    /// exceeds the largest radius.
    Visible {
        /// Longest time without a measurement after which a track is kept [s].
        max_coast: f64,
        /// Longest time without a measurement for which a track is reported [s].
        report_coast: f64,
    },
}

/// All parameters of the tracker.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrackerParameters {
    /// Number of clouds kept for late detections, N_buf.
    pub buffer_size: usize,
    /// Parameters of the clustering of points inside the tracks' regions.
    pub clustering: Clustering,
    /// Largest side of the bounding box of a target's cluster [m]. None: no limit.
    pub max_extent: Option<f64>,
    /// A cluster is background if its centroid is within this distance of the centre of an occupied
    /// voxel, d_min [m].
    pub occupied_distance: f64,
    /// Uncertainty radius, within which a track searches for its target.
    pub radius: Radius,
    /// Motion model of the targets.
    pub motion: Motion,
    /// Standard deviations of the state of a new track: position [m], velocity [m/s], acceleration
    /// [m/s^2].
    pub initial_std: [f64; 3],
    /// Position and covariance that a cluster measures.
    pub measurement: MeasurementForm,
    /// Z: standard deviation of a centroid, on every axis [m]. It is also added to the given
    /// covariance of a detection in the mode `Cluster`.
    pub measurement_std: f64,
    /// How a hidden side makes the position of a cluster less certain. None: not at all.
    pub hiding: Option<Hiding>,
    /// Rule that assigns clusters and detections to tracks.
    pub association: Association,
    /// Standard deviation of a lost target's acceleration [m/s^2]. It widens the region in which a
    /// detection continues a track that was confirmed and lost. None: only the predicted region
    /// counts. Used with global association only.
    pub rejoin_acceleration: Option<f64>,
    /// A cluster within this distance of several tracks, which are further than this from each
    /// other, is split between them [m]. None: clusters stay whole. Used with global association
    /// only.
    pub split_distance: Option<f64>,
    /// Rule that confirms tracks.
    pub confirmation: Confirmation,
    /// Limits for merging tracks of the same target. None: tracks are not merged.
    pub merging: Option<Merging>,
    /// Growth of a track's uncertainty while it has no measurement.
    pub ageing: Ageing,
}

/// Parameters of the best mode (not of the paper).
impl Default for TrackerParameters {
    fn default() -> Self {
        Self {
            buffer_size: 10,
            clustering: Clustering { max_distance: 0.5, ..Clustering::default() },
            max_extent: Some(2.5),
            occupied_distance: 0.7,
            radius: Radius { form: RadiusForm::SixthRoot, scale: 1.22, min: 1.5, max: 3.0 },
            motion: Motion::default(),
            initial_std: [0.3, 4.0, 3.0],
            measurement: MeasurementForm::Center,
            measurement_std: 0.07,
            hiding: Some(Hiding::default()),
            association: Association::Global { gate_probability: 0.9999, clutter_density: 1e-5 },
            rejoin_acceleration: Some(2.0),
            split_distance: Some(0.8),
            confirmation: Confirmation::Existence { report: 0.9 },
            merging: Some(Merging::default()),
            ageing: Ageing::Visible { max_coast: 3.0, report_coast: 0.5 },
        }
    }
}

impl TrackerParameters {
    /// Algorithm 2 with the values of Table II.
    #[must_use]
    pub fn paper() -> Self {
        Self {
            clustering: Clustering::default(),
            max_extent: None,
            occupied_distance: 1.0,
            radius: Radius { form: RadiusForm::Paper, scale: 0.5, ..Self::default().radius },
            motion: Motion {
                acceleration_time: None,
                unseen_time: None,
                form: NoiseForm::Paper,
                std: [0.5, 0.5, 0.1],
            },
            initial_std: [0.5, 3.0, 3.0],
            measurement: MeasurementForm::Paper,
            measurement_std: 1.0,
            hiding: None,
            association: Association::Paper,
            rejoin_acceleration: None,
            split_distance: None,
            confirmation: Confirmation::Counts { hits: 1, window: 1 },
            merging: None,
            ageing: Ageing::Paper,
            ..Self::default()
        }
    }
}

impl TrackerParameters {
    /// Check the values that memory safety and termination depend on.
    ///
    /// # Errors
    /// [`Error::Parameter`] for the first value outside its range.
    pub(super) fn check(&self) -> Result<(), Error> {
        cluster::label(&[], &self.clustering)?;
        require(self.buffer_size >= 1, "buffer_size", ">= 1", self.buffer_size)?;
        self.confirmation.check()?;
        require_positive("radius_scale", self.radius.scale)?;
        require_positive("radius_min", self.radius.min)?;
        require_positive("radius_max", self.radius.max)?;
        let optional = [
            ("acceleration_time", self.motion.acceleration_time),
            ("unseen_acceleration_time", self.motion.unseen_time),
            ("size_time", self.hiding.map(|hiding| hiding.time)),
            ("split_distance", self.split_distance),
            ("rejoin_acceleration", self.rejoin_acceleration),
        ];
        for (name, value) in optional {
            require_positive(name, value.unwrap_or(1.0))?;
        }
        let extent = self.max_extent.unwrap_or(0.0);
        require(extent.is_finite() && extent >= 0.0, "max_extent", "finite and >= 0", extent)?;
        match self.association {
            Association::Paper => Ok(()),
            Association::Global { clutter_density, .. } => {
                require_positive("clutter_density", clutter_density)
            }
        }
    }
}
