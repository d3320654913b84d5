//! Clusters of a scan, and their classes.
//!
//! Longer than other files: only this file may use the private fields of the classifier.

use super::classifier::{Classification, Classifier, ClusterRules, reclassify};
use super::clusters::{Cluster, Clusters};
use super::expected::ExpectedIn;
use super::explained::{Explained, is_explained};
use super::may_fly::{is_alone, may_fly};
use super::standing::is_in_air;
use crate::Error;
use crate::flying::map::local_map::LocalMap;
use crate::flying::parameters::FlyingParameters;
use crate::flying::point_class::{PointClass, replace};
use crate::flying::scan::prepared::Prepared;
use crate::flying::sky::source::SkySource;
use crate::flying::track::ExpectedTarget;
use crate::geometry::cluster::angular_gap::AngularGap;
use crate::geometry::cluster::joined::JoinedLabeller;
use crate::geometry::lattice::{Voxel, floor, wide};
use crate::geometry::transform::norm;
use crate::util::cancel;
use crate::util::stopwatch::Clock;
use rayon::ThreadPool;

/// Ratio of the largest gap inside a cluster to the angle between rays. `WIDEST_GAP`: largest such gap [rad].
const GAP: f64 = 3.0;
const WIDEST_GAP: f64 = 0.06;

/// A scan, as input of the classification.
#[derive(Clone, Copy)]
pub(crate) struct ScanToClassify<'a> {
    pub(crate) scan: &'a Prepared,
    /// The map before this scan.
    pub(crate) local: &'a LocalMap,
    /// Diagonal beyond which clusters are background [m]. None: no limit.
    pub(crate) background_extent: Option<f64>,
    pub(crate) parameters: &'a FlyingParameters,
    /// Targets that tracks predict near structure.
    pub(crate) expected: &'a [ExpectedTarget],
    /// Indices of points beside objects that moved in the air, ascending. The map may wrongly show these points as
    /// background.
    pub(crate) in_air: &'a [usize],
    pub(crate) pool: Option<&'a ThreadPool>,
}

impl<'a> ScanToClassify<'a> {
    fn expected(&self) -> ExpectedIn<'a> {
        let scan = self.scan;
        ExpectedIn::new(self.expected, &scan.points, scan.delays.as_deref(), &self.local.map)
    }
}

/// Finds the clusters of a scan and their classes. The results stay until the next scan, which uses their memory.
#[derive(Default)]
pub(crate) struct ScanClassifier {
    labeller: JoinedLabeller,
    explained: Explained,
    /// The centre of every point's voxel [m], if the centres are clustered instead of the points.
    middles: Vec<[f32; 3]>,
    classifier: Classifier,
    clusters: Clusters,
    /// Class of each cluster.
    classifications: Vec<Classification>,
    /// Class of each cluster on the map after the scan.
    later: Vec<Classification>,
    /// Indices of points that may belong to targets that tracks predict near structure, ascending.
    expected: Vec<usize>,
    /// Indices of the clusters that count as flying only because a track predicts them.
    claimed: Vec<usize>,
    /// Class of every point of the scan.
    class: Vec<PointClass>,
}

impl ScanClassifier {
    /// Find the clusters of a scan and their classes on the map before it. Returns the times of the clustering and of
    /// the classification [ms].
    ///
    /// # Errors
    /// [`Error::Parameter`] for values that cannot work, [`Error::Interrupted`].
    pub(crate) fn classify(
        &mut self,
        input: &ScanToClassify<'_>,
        clock: &mut Clock,
    ) -> Result<[f64; 2], Error> {
        self.label(input)?;
        cancel::check()?;
        let (points, labels) = (&input.scan.points, self.labeller.labels());
        match self.labeller.searched() {
            Some((joined, rows)) => self.clusters.fill_some(points, labels, joined, rows),
            None => self.clusters.fill(points, labels),
        }
        let cluster_ms = clock.lap();
        cancel::check()?;

        let Self { clusters, classifier, classifications, .. } = self;
        classify_clusters_of(input, clusters, classifier, classifications)?;
        self.claim(input);
        self.class_rows(input.scan);
        if input.parameters.classify.after_update {
            replace(&mut self.class, PointClass::Flying, PointClass::Unknown); // rule B follows after the map update
        }
        Ok([cluster_ms, clock.lap()])
    }

    /// Set the class of clusters that tracks predict near structure to flying. By the rules, these clusters are
    /// background.
    fn claim(&mut self, input: &ScanToClassify<'_>) {
        let Self { clusters, classifications, claimed, expected, .. } = self;
        claimed.clear();
        let p = &input.parameters.classify;
        if input.expected.is_empty() || p.after_update {
            return;
        }
        let (map, scan) = (&input.local.map, input.scan);
        let (points, origin) = (scan.points.as_slice(), scan.pose.translation);
        let rules = ClusterRules { map, points, origin, parameters: p };
        // Whatever is linked to structure is a part of it.
        let is_apart = |cluster: &Cluster<'_>| {
            cluster.members.iter().all(|&row| {
                expected.binary_search(&(row as usize)).is_ok()
                    || !is_explained(map, p.close_distance, wide(points[row as usize]))
            })
        };
        let may_be_one = |index: usize, cluster: &Cluster<'_>| {
            !clusters.is_joined(index)
                && cluster.members.len() >= p.min_points
                && !rules.is_gated(cluster, cluster.diagonal())
                && may_fly(map, scan, cluster)
                && is_apart(cluster)
        };
        let all = (0..clusters.len()).map(|index| (index, clusters.get(index)));
        claimed.extend(input.expected().clusters(all, may_be_one));
        claimed.retain(|&index| classifications[index].class != PointClass::Flying);
        for &index in claimed.iter() {
            let (class, is_expected) = (PointClass::Flying, true);
            classifications[index] =
                Classification { class, is_expected, ..Classification::default() };
        }
    }

    /// Indices of the clusters that count as flying because a track predicts them, although structure is near.
    pub(crate) fn claimed(&self) -> &[usize] {
        &self.claimed
    }

    /// Indices of the points of each unknown cluster whose group (all clusters near it) has the size of a target.
    pub(crate) fn unknown_things(&self, input: &ScanToClassify<'_>) -> Vec<&[u32]> {
        let (scan, parameters) = (input.scan, &input.parameters.classify);
        let (points, origin) = (scan.points.as_slice(), scan.pose.translation);
        let rules = ClusterRules { map: &input.local.map, points, origin, parameters };
        let is_thing = |&index: &usize| {
            self.classifications[index].class == PointClass::Unknown
                && !self.clusters.is_joined(index)
                && self.clusters.get(index).members.len() >= parameters.min_points
                && !rules.is_gated(&self.clusters.get(index), self.classifier.group_extent(index))
        };
        let members = |index| self.clusters.get(index).members;
        (0..self.classifications.len()).filter(is_thing).map(members).collect()
    }

    /// Classify clusters of objects that move in the air again. More than half of the points of such a cluster are in
    /// `rows` (indices of points that move, with nothing close below, ascending) or in `over_unseen` (the same, above
    /// space that was never observed: such an object may stand on something). A background cluster of `rows` becomes
    /// unknown, because only its own points of earlier scans made it background. An unknown cluster of either list
    /// becomes flying if free space is around it: it may be unknown only because a path leads into space that was never
    /// observed, such as the space behind a table.
    pub(crate) fn lift(&mut self, input: &ScanToClassify<'_>, rows: &[u32], over_unseen: &[u32]) {
        // Longer than other functions: all conditions for one cluster.
        if rows.is_empty() && over_unseen.is_empty() {
            return;
        }
        let (map, scan, p) = (&input.local.map, input.scan, &input.parameters.classify);
        let (points, origin) = (scan.points.as_slice(), scan.pose.translation);
        let rules = ClusterRules { map, points, origin, parameters: p };
        let limit = input.background_extent.unwrap_or(f64::INFINITY);
        let beside = p.group_distance.unwrap_or(0.0);
        let mut is_changed = false;
        for index in 0..self.classifications.len() {
            let (cluster, class) = (self.clusters.get(index), self.classifications[index].class);
            let is_of = |rows: &[u32]| {
                let of_it = |row: &&u32| rows.binary_search(row).is_ok();
                2 * cluster.members.iter().filter(of_it).count() > cluster.members.len()
            };
            if class == PointClass::Flying
                || self.clusters.is_joined(index)
                || cluster.diagonal() > limit
            {
                continue;
            }
            let is_in_air = is_of(rows);
            let is_over_unseen = !is_in_air && class == PointClass::Unknown && is_of(over_unseen);
            if !is_in_air && !is_over_unseen {
                continue;
            }
            if class != PointClass::Unknown {
                self.classifications[index] = Classification::of(PointClass::Unknown);
            } else if may_fly(map, scan, &cluster)
                && let Some(found) = rules.in_free_shell(&cluster)
                && !self.is_beside_background(points, &cluster, beside)
            {
                self.classifications[index] = Classification { is_over_unseen, ..found };
            } else {
                continue;
            }
            is_changed = true;
        }
        if is_changed {
            self.class_rows(input.scan);
        }
    }

    /// True if a background point is within `distance` [m] of the box around a cluster.
    fn is_beside_background(
        &self,
        points: &[[f32; 3]],
        cluster: &Cluster<'_>,
        distance: f64,
    ) -> bool {
        points.iter().zip(&self.class).any(|(&point, &class)| {
            let place = wide(point);
            let away = |axis: usize| {
                (cluster.low[axis] - place[axis]).max(place[axis] - cluster.high[axis]).max(0.0)
            };
            class == PointClass::Background && norm([0, 1, 2].map(away)) <= distance
        })
    }

    /// Evaluate rule B again on the map after the scan, and update the classes.
    ///
    /// # Errors
    /// As [`ScanClassifier::classify`].
    pub(crate) fn reclassify(&mut self, input: &ScanToClassify<'_>) -> Result<(), Error> {
        let Self { clusters, classifier, classifications, later, .. } = self;
        classify_clusters_of(input, clusters, classifier, later)?;
        reclassify(classifications, later);
        self.class_rows(input.scan);
        Ok(())
    }

    /// Set the class of all points to unknown, or invalid, for a scan that is not classified.
    pub(crate) fn leave_unknown(&mut self, scan: &Prepared) {
        self.class.clear();
        self.class.extend(scan.points.iter().map(class_without_cluster));
    }

    /// Add the class of a point that was appended to the scan.
    pub(crate) fn add_row(&mut self, class: PointClass) {
        self.class.push(class);
    }

    /// Set the class of the cluster `index` to flying.
    pub(crate) fn make_flying(&mut self, index: usize) {
        self.classifications[index].class = PointClass::Flying;
    }

    /// Set the class of every point to that of its cluster. Points in no cluster are unknown or invalid.
    pub(crate) fn class_rows(&mut self, scan: &Prepared) {
        let Self { labeller, classifications, class, .. } = self;
        let of_row = |(point, &label): (&[f32; 3], &i32)| match usize::try_from(label) {
            Ok(cluster) => classifications[cluster].class,
            Err(_) => class_without_cluster(point),
        };
        class.clear();
        class.extend(scan.points.iter().zip(labeller.labels()).map(of_row));
    }

    /// Indices of the clusters in the air whose points are mostly inside the given voxels (sorted), which have become
    /// background, in ascending order.
    pub(crate) fn standing_in_air(
        &self,
        voxels: &[Voxel],
        input: &ScanToClassify<'_>,
    ) -> Vec<usize> {
        let (map, scan, parameters) = (&input.local.map, input.scan, &input.parameters.classify);
        let (points, origin) = (scan.points.as_slice(), scan.pose.translation);
        let rules = ClusterRules { map, points, origin, parameters };
        let is_in = |row: &&u32| {
            let voxel = floor(map.lattice().scaled(wide(points[**row as usize])));
            voxel.is_some_and(|voxel| voxels.binary_search(&voxel).is_ok())
        };
        let stands = |index: &usize| {
            let (cluster, class) = (self.clusters.get(*index), self.classifications[*index].class);
            2 * cluster.members.iter().filter(is_in).count() > cluster.members.len()
                && !self.clusters.is_joined(*index)
                && (class == PointClass::Flying
                    || class == PointClass::Unknown && is_in_air(&rules, scan, &cluster))
        };
        if voxels.is_empty() {
            return Vec::new();
        }
        (0..self.classifications.len()).filter(stands).collect()
    }

    /// Class of every point of the scan.
    pub(crate) fn class(&self) -> &[PointClass] {
        &self.class
    }

    /// Clusters of the scan.
    pub(crate) fn clusters(&self) -> &Clusters {
        &self.clusters
    }

    /// Class of each cluster, with the evidence for it.
    pub(crate) fn classifications(&self) -> &[Classification] {
        &self.classifications
    }

    /// Index of the cluster that contains the point `row`. None if the point is in no cluster.
    pub(crate) fn cluster_of(&self, row: u32) -> Option<usize> {
        usize::try_from(self.labeller.labels()[row as usize]).ok()
    }

    /// True if the point `row` belongs to a cluster that would be a flying object if it had more points: free voxels
    /// surround it on the map of `input`, and no other points are near it. The last condition excludes the crown of a
    /// tree that few rays hit, which has many such clusters.
    ///
    /// # Errors
    /// [`Error::Parameter`] for a distance that cannot be searched.
    pub(crate) fn is_hint(&self, input: &ScanToClassify<'_>, row: u32) -> Result<bool, Error> {
        let Some(index) = self.cluster_of(row) else { return Ok(false) };
        let (cluster, parameters) = (self.clusters.get(index), &input.parameters.classify);
        let (map, scan) = (&input.local.map, input.scan);
        let (origin, points) = (scan.pose.translation, scan.points.as_slice());
        let is_small = cluster.members.len() < parameters.min_points;
        let rules = ClusterRules { map, points, origin, parameters };
        Ok(self.classifications[index].class == PointClass::Unknown
            && is_small
            && may_fly(map, scan, &cluster)
            && is_alone(points, &cluster)
            && rules.is_in_free_space(&cluster)?)
    }

    /// Number of clusters of a class.
    pub(crate) fn count_of(&self, class: PointClass) -> usize {
        self.classifications.iter().filter(|classification| classification.class == class).count()
    }

    fn label(&mut self, input: &ScanToClassify<'_>) -> Result<(), Error> {
        let Self { labeller, explained, middles, expected, .. } = self;
        let (scan, parameters, lattice) = (input.scan, input.parameters, input.local.map.lattice());
        let middle = |&point: &[f32; 3]| match floor(lattice.scaled(wide(point))) {
            Some(voxel) => lattice.center(voxel).map(|value| value as f32),
            None => [f32::NAN; 3],
        };
        middles.clear();
        if parameters.cluster_voxels {
            middles.extend(scan.points.iter().map(middle));
        }
        let points = if parameters.cluster_voxels { middles } else { &scan.points };
        let max_angle = match parameters.cluster_angle {
            0.0 => 0.0,
            stated => gap_between_rays(scan).max(stated),
        };
        let gap = AngularGap { origin: scan.pose.translation, max_angle };
        let max_distance = parameters.clustering.max_distance;
        cancel::check()?;
        expected.clear();
        expected.extend(input.expected().rows());
        if !input.in_air.is_empty() {
            expected.extend(input.in_air);
            expected.sort_unstable();
            expected.dedup();
        }
        let is_joined = explained.find(points, &input.local.map, parameters, input.pool, expected);
        cancel::check()?;
        match is_joined {
            Some(is_joined) => {
                let reach = parameters.classify.group_distance.unwrap_or(0.0); // of groups of clusters
                labeller.label_joined(points, is_joined, &gap, max_distance, reach, input.pool)
            }
            None => labeller.label(points, &gap, &parameters.clustering, input.pool),
        }
    }
}

/// Largest angle between returns of one object [rad], computed from the mean density of the rays for sensors without
/// rows of rays whose sky is estimated. For these sensors, no parameter can state the angle. 0 for other sensors.
fn gap_between_rays(scan: &Prepared) -> f64 {
    let observation = scan.sky_observation.as_ref().filter(|_| scan.sky == SkySource::Density);
    let density = observation.map_or(0.0, |observation| observation.mean_density());
    if density > 0.0 { (GAP / density.sqrt()).min(WIDEST_GAP) } else { 0.0 }
}

/// Class of a point in no cluster: unknown, or invalid if it is not finite.
fn class_without_cluster(point: &[f32; 3]) -> PointClass {
    if point.iter().all(|value| value.is_finite()) {
        PointClass::Unknown
    } else {
        PointClass::Invalid
    }
}

fn classify_clusters_of(
    input: &ScanToClassify<'_>,
    clusters: &Clusters,
    classifier: &mut Classifier,
    classifications: &mut Vec<Classification>,
) -> Result<(), Error> {
    let ScanToClassify { scan, background_extent, pool, .. } = *input;
    let (map, world_from_map) = (&input.local.map, input.local.world_from_map());
    let mut parameters = input.parameters.classify.clone();
    parameters.background_extent = background_extent;
    let origin = scan.pose.translation;
    let rules = ClusterRules { map, points: &scan.points, origin, parameters: &parameters };
    classifier.classify(&rules, clusters, pool, classifications)?;
    let ground_height = input.parameters.seed.ground_height;
    for (classification, cluster) in classifications.iter_mut().zip(clusters.iter()) {
        let is_low = |height: f64| world_from_map.apply(cluster.low)[2] < height;
        if ground_height.is_some_and(is_low) {
            *classification = Classification::of(PointClass::Background);
        } else if classification.class == PointClass::Flying && !may_fly(map, scan, &cluster) {
            *classification = Classification::of(PointClass::Unknown);
        }
    }
    Ok(())
}
