//! Parameters of the tracker; `Paper` variants are the algorithm as published.

use crate::Error;
use crate::error::{require, require_positive};
use crate::geometry::cluster::{self, Clustering};

/// Largest number of tracks, and of detections in one set.
pub const MAX_TRACKS: usize = 10_000;
/// Largest number of sets of detections that confirmation looks back on: one bit each.
pub const MAX_WINDOW: u32 = 64;

/// Unit of the uncertainty radius.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RadiusForm {
    /// Eq. 26: cube root of the determinant, which is a variance [m^2].
    Paper,
    /// Sixth root: the geometric mean of the standard deviations [m].
    SixthRoot,
}

/// Radius of the region in which a track looks for its target.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Radius {
    /// Root that is taken.
    pub form: RadiusForm,
    /// Multiplier c_r.
    pub scale: f64,
    /// Never smaller [m].
    pub min: f64,
    /// A track beyond it is removed [m].
    pub max: f64,
}

/// Form of the process noise of the motion.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NoiseForm {
    /// Eq. 31: the same covariance at every step, however long.
    Paper,
    /// White noise in continuous time: two short steps equal one long one.
    Continuous,
    /// The same, wider for a flying target as long as its measurements lie further from their predictions than
    /// the noise allows. A target that turns hard between two scans has a new acceleration.
    Adaptive,
}

/// Motion of a target: a point mass with noise on position, velocity and acceleration, per axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Motion {
    /// Time constant with which the acceleration fades [s]; None, as in eq. 27: it stays.
    pub acceleration_time: Option<f64>,
    /// Time constant of the acceleration while a track is not seen [s]; None: `acceleration_time`.
    pub unseen_time: Option<f64>,
    /// Meaning of the numbers in `std`.
    pub form: NoiseForm,
    /// Standard deviations: per step [m, m/s, m/s^2], or as roots of densities [the same / sqrt(s)].
    pub std: [f64; 3],
}

/// Targets accelerate for about a second; what is not seen for long rather goes straight on.
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

/// Position that a cluster measures, and its uncertainty.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MeasurementForm {
    /// The centroid, with Z^2 I, sec. III-F1, at the stamp of the scan.
    Paper,
    /// The centroid, with Z^2 I plus the scatter of the cluster's points divided by their number,
    /// at the mean time of these points.
    Cluster,
    /// The centre behind the points with its own covariance, at their mean time; the same as
    /// `Cluster` where the rays of the scan are not known.
    Center,
}

/// Handling of clusters that are partly hidden by something in front of the target.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hiding {
    /// A side shorter than this share of the track's usual one is partly hidden.
    pub share: f64,
    /// Time constant of the usual size [s].
    pub time: f64,
}

/// Two seconds are long beside the time between two scans, and short beside a change of distance
/// that changes the visible size.
impl Default for Hiding {
    fn default() -> Self {
        Self { share: 0.75, time: 2.0 }
    }
}

/// Association of tracks with clusters and of detections with tracks.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Association {
    /// Algorithm 2: every track takes the nearest centroid, every detection the nearest track.
    Paper,
    /// Global nearest neighbour: one to one, gated by Mahalanobis distance.
    Global {
        /// Probability that a true pair passes the gate.
        gate_probability: f64,
        /// Density of clusters that belong to no track [1/m^3].
        clutter_density: f64,
    },
}

/// When a track is reported.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Confirmation {
    /// A track is confirmed for good once `hits` of the last `window` sets of detections contained
    /// it.
    Counts {
        /// Sets that held the track, >= 1.
        hits: u32,
        /// Sets looked back on, `hits` to [`MAX_WINDOW`].
        window: u32,
    },
    /// Once the probability that its target exists reaches `report`, until it falls below half of
    /// that. Improbable tracks are removed.
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

/// Two tracks this close are one target.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Merging {
    /// Distance of their positions [m].
    pub distance: f64,
    /// Difference of their velocities [m/s].
    pub speed: f64,
}

/// Two targets that fly past each other differ by more than 1 m/s.
impl Default for Merging {
    fn default() -> Self {
        Self { distance: 0.3, speed: 1.0 }
    }
}

/// Rule for the ageing of a track without a measurement.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Ageing {
    /// Always: Algorithm 2, lines 15-17.
    Paper,
    /// Only while its region should give returns; the region is then never larger than the
    /// largest radius.
    Visible {
        /// A track without measurement for longer is removed in any case [s].
        max_coast: f64,
        /// A track without measurement for longer is kept but not reported [s].
        report_coast: f64,
    },
}

/// All parameters of the tracker.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrackerParameters {
    /// Clouds kept for late detections, N_buf.
    pub buffer_size: usize,
    /// Clusters inside a track's region.
    pub clustering: Clustering,
    /// Largest side of the bounding box of a target's cluster [m].
    pub max_extent: Option<f64>,
    /// A centroid this close to an occupied voxel's centre is background, d_min [m].
    pub occupied_distance: f64,
    /// Uncertainty radius.
    pub radius: Radius,
    /// Motion model.
    pub motion: Motion,
    /// Standard deviations of a new track: position [m], velocity [m/s], acceleration [m/s^2].
    pub initial_std: [f64; 3],
    /// Covariance of centroids.
    pub measurement: MeasurementForm,
    /// Z: standard deviation of a centroid, and of a detection beside its own covariance [m].
    pub measurement_std: f64,
    /// Uncertainty that a hidden side adds to the position of a cluster; None: it adds none.
    pub hiding: Option<Hiding>,
    /// Rule that assigns clusters and detections to tracks.
    pub association: Association,
    /// Standard deviation of an acceleration of the target since it was lost [m/s^2]: it widens the
    /// region in which a detection continues a lost confirmed track. None: only the predicted
    /// region counts. Global association only.
    pub rejoin_acceleration: Option<f64>,
    /// A cluster this near to several tracks, which are further apart from each other, is divided
    /// among them [m]; None: clusters stay whole. Global association only.
    pub split_distance: Option<f64>,
    /// Confirmation.
    pub confirmation: Confirmation,
    /// Merging of duplicates.
    pub merging: Option<Merging>,
    /// Ageing.
    pub ageing: Ageing,
}

/// Best mode.
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
    /// Check what memory safety and termination need.
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
