//! Mechanisms that the trackers share.

use super::input::Input;
use lidar_core::estimation::assignment::Pair;
use lidar_core::tracking::existence::{GatedPair, PredictedTrack, Presence, Sojourn, associate};
use lidar_core::tracking::extent::{AXES, Recent};
use lidar_core::tracking::joint_association::probabilities;
use lidar_core::tracking::kind::{KindBelief, TrackKind};
use lidar_core::tracking::near::{NearIndex, Rectangle};
use lidar_core::tracking::sensor_noise::{InnovationStatistics, NoiseFactor};
use lidar_core::tracking::surroundings::{Population, ScannerPrior, Surroundings};

pub fn functions(bytes: &[u8]) {
    let mut input = Input::new(bytes);
    joint(&mut input);
    learnt(&mut input);
    near(&mut input);
    surroundings(&mut input);
}

fn joint(input: &mut Input<'_>) {
    let tracks = input.many(6, |input| {
        let mean = Sojourn { lifetime: 30.0, visible: input.positive(), hidden: input.positive() };
        let presence = Presence::measured(input.share()).predicted(input.positive(), &mean);
        let other = presence.weighed(input.share(), input.share());
        PredictedTrack {
            presence: presence.united(&other),
            detection: input.share(),
            is_in_view: input.is_set(),
        }
    });
    let measurements = input.below(7);
    let (mut pairs, mut costs) = (Vec::new(), Vec::new());
    for track in 0..tracks.len() {
        for measurement in 0..measurements {
            if input.is_set() {
                let log_ratio = input.f64();
                pairs.push(GatedPair { track, measurement, log_ratio });
                costs.push(Pair { row: track, column: measurement, cost: -log_ratio });
            }
        }
    }
    let found = associate(&tracks, measurements, &pairs);
    assert_eq!((found.presence.len(), found.pair.len()), (tracks.len(), pairs.len()));
    for presence in &found.presence {
        let _ = (presence.observable(), presence.hidden_share());
    }
    assert_eq!(probabilities(tracks.len(), measurements, &costs).len(), pairs.len());
}

fn learnt(input: &mut Input<'_>) {
    let mut factor = NoiseFactor::default();
    for _ in 0..input.below(12) {
        let surprise = InnovationStatistics {
            squared: input.positive(),
            predicted: input.positive(),
            configured: input.positive(),
        };
        factor.learn(&surprise, 1.0 + input.positive());
    }
    let _ = (factor.factor(), factor.is_known());
    let belief = KindBelief::prior(input.f64s()).weighed(input.f64s());
    let sum: f64 = belief.probabilities().iter().sum();
    assert!((sum - 1.0).abs() < 1e-6, "{sum}");
    let _ = (belief.kind(), belief.probability(TrackKind::Flying));
}

fn near(input: &mut Input<'_>) {
    let places: Vec<_> = input.many(30, |input| input.f64s::<2>());
    let index = NearIndex::new(places.iter().copied().zip(0..).collect());
    let window = Rectangle::around(input.f64s(), input.f64s()).shifted(input.f64());
    let mut found = Vec::new();
    index.collect(&window, &mut found);
    assert!(found.iter().all(|place| *place < places.len()));
    let _ = index.is_near(input.f64s(), input.f64());
}

fn surroundings(input: &mut Input<'_>) {
    let mut known = Surroundings::default();
    let mut recent = Recent::default();
    let mut population = Population::default();
    for _ in 0..input.below(10) {
        let scan = input.many(9, |input| input.f64s::<AXES>());
        recent.take(&scan);
        known.see(scan.iter().map(|row| &row[..]));
        let weighted: Vec<(&[f64], f64)> =
            scan.iter().map(|row| (&row[..], input.share())).collect();
        known.count_scan(&weighted);
        known.count_false(input.positive());
        known.count_first(input.share());
        known.count_look(input.share(), input.share());
        known.count_arrival();
        population.count_stay(&Presence::measured(input.share()), input.positive());
        population.count_return(input.share());
        population.count_end(input.is_set());
        population.count_speed(input.f64s());
    }
    let prior = ScannerPrior { detection: 0.9, clutter: 1e-3, share: input.share() };
    let _ = (recent.bounds(), known.is_settled(), known.volume(2), known.clutter(&prior, 2));
    let _ = (known.detection(&prior), known.share(&prior));
    let _ =
        (population.speed(input.positive()), population.lifetime(30.0), population.visible(5.0));
}
