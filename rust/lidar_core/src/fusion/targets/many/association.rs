//! Association of measurements with tracks that are confirmed by counts of their measurements:
//! global nearest neighbour, and joint probabilistic data association (JPDA).

use super::hypotheses::is_another_target;
use super::near_pairs::ScanIndex;
use super::parameters::{ManyParameters, SHARE, TargetAssociation};
use super::track::{Assigned, Candidates, Scan, TargetTrack, TrackingWork, kind};
use super::tracks::Tracks;
use crate::Error;
use crate::estimation::assignment::{Pair, assign};
use crate::fusion::filter::engine::Innovation;
use crate::fusion::sensors::measurement::{Measurement, Sensor};
use crate::tracking::joint_association::probabilities;
use crate::tracking::surroundings::{ScannerPrior, Surroundings};

/// Cost of a track that gets no measurement although its gate contains one. It is far above the
/// cost of any pair, so that as many tracks as possible get a measurement.
const UNASSIGNED: f64 = 1e6;

impl TargetAssociation {
    /// Cost of assigning a measurement with this innovation to a track. `standing`: density of
    /// static clutter at the place of the measurement [1/m^2].
    pub(super) fn cost(&self, m: &Measurement, innovation: &Innovation, standing: f64) -> f64 {
        let distance = innovation.nis + innovation.log_determinant;
        match self {
            Self::Nearest | Self::Integrated(_) => distance,
            Self::Joint { detection, clutter } => {
                let constant = innovation.count as f64 * libm::log(std::f64::consts::TAU);
                let density = clutter[usize::from(m.sensor() == Sensor::Radar)].max(standing);
                0.5 * (distance + constant) + libm::log(density * (1.0 - detection) / detection)
            }
        }
    }
}

impl Tracks {
    /// Assign measurements to tracks. The global nearest neighbour uses the likelihood of the
    /// innovations.
    ///
    /// # Source
    /// Bar-Shalom, Li & Kirubarajan, "Estimation with Applications to Tracking and Navigation",
    /// 2001; Blackman & Popoli, "Design and Analysis of Modern Tracking Systems", 1999, sec. 6.4.
    pub(super) fn associate(
        &mut self,
        parameters: &ManyParameters,
        scan: &Scan,
        candidates: &Candidates,
        assigned: &mut [Assigned],
    ) -> Result<(), Error> {
        if let TargetAssociation::Joint { detection, .. } = parameters.association {
            self.associate_jointly(scan, assigned, candidates, detection);
            return Ok(());
        }
        let Candidates { pairs, innovations } = candidates;
        let column_of = assign(self.all.len(), scan.measurements.len(), pairs, UNASSIGNED)?;
        for (Pair { row, column, .. }, innovation) in pairs.iter().zip(innovations) {
            if column_of[*row] == Some(*column) {
                let track = &mut self.all[*row];
                track.filter.take(&scan.measurements[*column]);
                track.see(scan);
                assigned[*column] = Assigned { id: Some(track.id), innovation: Some(*innovation) };
            }
        }
        Ok(())
    }

    /// Density of clutter at each measurement of a scan, per unit of its values: the larger of the
    /// density of static clutter at its place and the density that its scanner measures anywhere.
    /// Only JPDA needs the second one.
    pub(super) fn clutter(
        &self,
        parameters: &ManyParameters,
        scan: &Scan,
        standing: &[f64],
    ) -> Vec<f64> {
        let anywhere =
            |m: &Measurement| match (parameters.association, self.scanners.get(&scan.source)) {
                (TargetAssociation::Joint { detection, clutter }, Some(scanner)) => {
                    let prior = ScannerPrior { detection, clutter: clutter[kind(m)], share: SHARE };
                    scanner[kind(m)].clutter(&prior, m.values().len())
                }
                _ => 0.0,
            };
        scan.measurements.iter().zip(standing).map(|(m, here)| here.max(anywhere(m))).collect()
    }

    /// Learn how much clutter a scanner measures, from the measurements of tracks in `ended` that
    /// were never confirmed.
    pub(super) fn learn_clutter(&mut self, scan: &Scan, ended: &[TargetTrack]) {
        let targets = || scan.measurements.iter().filter(|m| !m.is_of_platform() && m.is_usable());
        let scanner = self.scanners.entry(scan.source).or_default();
        for (k, of) in scanner.iter_mut().enumerate() {
            let own: Vec<&[f64]> =
                targets().filter(|m| kind(m) == k).map(Measurement::values).collect();
            if !own.is_empty() || *of != Surroundings::default() {
                of.see(own.iter().copied());
                of.count_scan(&[]);
            }
        }
        for track in ended.iter().filter(|track| !track.confirmed) {
            let (source, k) = track.belief.origin;
            if let Some(scanner) = self.scanners.get_mut(&source) {
                scanner[k].count_false(f64::from(track.hits));
            }
        }
    }

    /// Pairs of a `wanted` track and a measurement in its gate that has no track yet, with costs
    /// and innovations.
    pub(super) fn candidates(
        &mut self,
        parameters: &ManyParameters,
        (scan, standing): (&Scan, &[f64]),
        index: &ScanIndex,
        wanted: impl Fn(&TargetTrack) -> bool,
        assigned: &[Assigned],
        work: &mut TrackingWork,
    ) -> Candidates {
        let (mut found, mut near) = (Candidates::default(), Vec::new());
        let rows = self.all.iter_mut().enumerate();
        for (row, track) in rows.filter(|(_, track)| wanted(track)) {
            index.near(&mut track.filter, &parameters.filter.life.gate, &mut near);
            near.retain(|column| assigned[*column].id.is_none());
            work.pairs += near.len() as u64;
            for column in &near {
                let m = &scan.measurements[*column];
                let Some(innovation) = track.filter.score(m) else { continue };
                if is_another_target(track, m) {
                    continue;
                }
                let cost = parameters.association.cost(m, &innovation, standing[*column]);
                if cost.is_finite() {
                    found.pairs.push(Pair { row, column: *column, cost });
                    found.innovations.push(innovation);
                }
            }
        }
        found
    }

    /// Joint probabilistic data association of measurements without a track. A measurement gets the
    /// ID of its most likely track, if it more likely belongs to some track than to none.
    fn associate_jointly(
        &mut self,
        scan: &Scan,
        assigned: &mut [Assigned],
        candidates: &Candidates,
        detection: f64,
    ) {
        let Candidates { pairs, innovations } = candidates;
        let weights = probabilities(self.all.len(), scan.measurements.len(), pairs);
        let mut of_track = vec![Vec::new(); self.all.len()];
        let mut of_any = vec![(0.0, 0.0, Assigned::default()); assigned.len()]; // sum, largest
        let mut odds = vec![0.0; self.all.len()];
        for ((Pair { row, column, cost }, innovation), weight) in
            pairs.iter().zip(innovations).zip(weights)
        {
            odds[*row] += libm::exp(-cost);
            of_track[*row].push((weight, scan.measurements[*column]));
            let (sum, most, best) = &mut of_any[*column];
            *sum += weight;
            if weight > *most {
                let innovation = Some(*innovation);
                (*most, *best) = (weight, Assigned { id: Some(self.all[*row].id), innovation });
            }
        }
        for (given, (sum, _, best)) in assigned.iter_mut().zip(of_any) {
            if sum > 0.5 {
                *given = best;
            }
        }
        let has_clutter = !self.standing.is_empty();
        for ((track, weighted), odds) in self.all.iter_mut().zip(of_track).zip(odds) {
            let hits = track.hits;
            track.absorb(scan, &weighted);
            if track.hits > hits {
                track.score.weigh(odds, detection, has_clutter);
            }
        }
    }
}
