//! A scan in clusters, and what they are.

use super::classifier::{Classifier, Judge, Verdict, judge_again};
use super::clusters::Clusters;
use super::occupied_nearby::Near;
use crate::Error;
use crate::flying::detector::{FlyingObjectDetector, replace};
use crate::flying::frame::Timing;
use crate::flying::point_class::{BACKGROUND, FLYING, INVALID, UNKNOWN};
use crate::flying::scan::prepared::Prepared;
use crate::flying::sky::ON_GROUND;
use crate::geometry::cluster::angular_gap::{AngularGap, SeenLabeller};
use crate::geometry::lattice::{floor, wide};
use crate::util::stopwatch::Clock;

/// Things that are no higher than this and lie as low as the lowest returns are patches of ground
/// [m].
const FLAT: f64 = 0.1;
/// Mirror images are this far from what they show, at most [m]: the floor is not quite flat.
const MIRROR_ERROR: f64 = 0.75;

/// A scan in clusters, and memory for the next one.
#[derive(Default)]
pub(crate) struct Judged {
    labeller: SeenLabeller,
    /// The middle of every point's voxel, where these are grouped.
    middles: Vec<[f32; 3]>,
    pub(crate) clusters: Clusters,
    classifier: Classifier,
    /// Class of each cluster.
    pub(crate) verdicts: Vec<Verdict>,
    /// Class of each cluster on a later map.
    later: Vec<Verdict>,
    /// Class of every row.
    pub(crate) class: Vec<u8>,
}

impl Judged {
    /// Cluster of every row, -1 for none.
    pub(crate) fn labels(&self) -> &[i32] {
        self.labeller.labels()
    }

    /// Number of clusters of a class.
    pub(crate) fn count_of(&self, class: u8) -> usize {
        self.verdicts.iter().filter(|verdict| verdict.class == class).count()
    }

    /// Class of every row: that of its cluster; unknown for points in no cluster.
    pub(crate) fn tell_classes(&mut self, scan: &Prepared) {
        let Self { labeller, verdicts, class, .. } = self;
        let of_row = |(point, &label): (&[f32; 3], &i32)| match usize::try_from(label) {
            Ok(cluster) => verdicts[cluster].class,
            Err(_) => of_point(point),
        };
        class.clear();
        class.extend(scan.points.iter().zip(labeller.labels()).map(of_row));
    }

    /// Set the class of every row of a scan that is held.
    pub(crate) fn tell_nothing(&mut self, scan: &Prepared) {
        self.class.clear();
        self.class.extend(scan.points.iter().map(of_point));
    }
}

/// Class of a point of which only its place is known.
fn of_point(point: &[f32; 3]) -> u8 {
    if point.iter().all(|value| value.is_finite()) { UNKNOWN } else { INVALID }
}

impl FlyingObjectDetector {
    /// Find the clusters of a scan, and what the map says that they are.
    pub(crate) fn judge(
        &self,
        scan: &Prepared,
        judged: &mut Judged,
        clock: &mut Clock,
        timing: &mut Timing,
    ) -> Result<(), Error> {
        self.label(scan, judged)?;
        judged.clusters.fill(&scan.points, judged.labeller.labels());
        timing.cluster = clock.lap();

        let Judged { clusters, classifier, verdicts, .. } = judged;
        self.classify(scan, clusters, classifier, verdicts)?;
        judged.tell_classes(scan);
        if self.parameters.classify.after_update {
            replace(&mut judged.class, FLYING, UNKNOWN); // rule B is judged after the map update
        }
        timing.classify = clock.lap();
        Ok(())
    }

    /// Judge rule B on a later map.
    pub(crate) fn judge_again(&self, scan: &Prepared, judged: &mut Judged) -> Result<(), Error> {
        let Judged { clusters, classifier, verdicts, later, .. } = judged;
        self.classify(scan, clusters, classifier, later)?;
        judge_again(verdicts, later);
        judged.tell_classes(scan);
        Ok(())
    }

    fn label(&self, scan: &Prepared, judged: &mut Judged) -> Result<(), Error> {
        let Judged { labeller, middles, .. } = judged;
        let lattice = self.map.lattice();
        let middle = |&point: &[f32; 3]| match floor(lattice.scaled(wide(point))) {
            Some(voxel) => lattice.center(voxel).map(|value| value as f32),
            None => [f32::NAN; 3],
        };
        middles.clear();
        if self.parameters.cluster_voxels {
            middles.extend(scan.points.iter().map(middle));
        }
        let points = if self.parameters.cluster_voxels { middles } else { &scan.points };
        let gap =
            AngularGap { origin: scan.pose.translation, max_angle: self.parameters.cluster_angle };
        labeller.label(points, &gap, &self.parameters.clustering, self.workers.pool())?;
        Ok(())
    }

    fn classify(
        &self,
        scan: &Prepared,
        clusters: &Clusters,
        classifier: &mut Classifier,
        verdicts: &mut Vec<Verdict>,
    ) -> Result<(), Error> {
        let seed = &self.parameters.seed;
        let mut parameters = self.parameters.classify.clone();
        parameters.background_extent =
            seed.background_extent(&self.burn_in, parameters.background_extent);
        let (map, origin) = (&self.map, scan.pose.translation);
        let judge = Judge { map, points: &scan.points, origin, parameters: &parameters };
        classifier.classify(&judge, clusters, self.workers.pool(), verdicts)?;
        let world_from_map = self.map_from_world.inverse();
        for (verdict, cluster) in verdicts.iter_mut().zip(clusters.iter()) {
            let own = cluster
                .members
                .iter()
                .filter(|&&row| scan.maybe_own.get(row as usize).copied().unwrap_or(false));
            let may_be_own = !scan.maybe_own.is_empty() && 2 * own.count() > cluster.members.len();
            let is_low = |height: f64| world_from_map.apply(cluster.low)[2] < height;
            let is_flat = cluster.extent()[2] < FLAT && cluster.low[2] < scan.low;
            let is_at_floor =
                scan.floor.is_some_and(|floor| (cluster.low[2] - floor).abs() < ON_GROUND);
            let is_on_ground = is_flat || is_at_floor || cluster.low[2] < scan.ground;
            if seed.ground_height.is_some_and(is_low) {
                *verdict = Verdict { class: BACKGROUND, ..Verdict::default() };
            } else if verdict.class == FLYING
                && (may_be_own
                    || is_on_ground
                    || !map.has_background()
                    || self.is_mirrored(scan, cluster.centroid))
            {
                *verdict = Verdict { class: UNKNOWN, ..Verdict::default() };
            }
        }
        Ok(())
    }

    /// True if a place lies below flat ground and its mirror image above is occupied: points there
    /// are reflections.
    fn is_mirrored(&self, scan: &Prepared, [x, y, z]: [f64; 3]) -> bool {
        scan.floor.filter(|floor| z < floor - ON_GROUND).is_some_and(|floor| {
            Near::new(&self.map, MIRROR_ERROR).is_close([x, y, 2.0 * floor - z])
        })
    }
}
