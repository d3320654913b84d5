//! Tests: assignment, late scans, refusals, memory.

use super::*;
use crate::fusion::model_list::Model;
use crate::fusion::parameters::Strengths;
use crate::fusion::sensors::measurement::Sensor;
use crate::fusion::sensors::sensing::Sensing;

fn parameters() -> Result<ManyParameters, Error> {
    let filter = FusionParameters {
        model: Model::ConstantVelocity,
        strengths: Strengths { acceleration: 0.5, start: 1.0, ..Strengths::default() },
        sensing: Sensing { lidar: [0.1; 3], radar: [0.1; 4], ..Sensing::default() },
        life: LifecycleRules {
            start_rows: 1,
            gate: LifecycleRules::gates(Some(0.99))?,
            loss_ratio: None,
            buffer_ns: 0,
            ..LifecycleRules::default()
        },
        ..FusionParameters::default()
    };
    Ok(ManyParameters {
        filter,
        confirm_hits: 2,
        confirm_window: 3,
        max_position_std: 20.0,
        association: TargetAssociation::Nearest,
        ..ManyParameters::default()
    })
}

fn scan(stamp_ns: i64, places: &[[f64; 2]]) -> Result<Vec<Measurement>, Error> {
    places.iter().map(|at| Measurement::new(stamp_ns, Sensor::Lidar, at, None)).collect()
}

fn numbers(assigned: &[Assigned]) -> Vec<Option<i64>> {
    assigned.iter().map(|one| one.id).collect()
}

/// Two targets that part, two scanners in turn, 50 ms from scan to scan.
fn parting() -> Result<Vec<(i64, u8, Vec<Measurement>)>, Error> {
    let one = |k: i64| {
        let (stamp, y) = (k * 50_000_000, 0.1 * k as f64);
        Ok((stamp, (k % 2) as u8, scan(stamp, &[[0.2 * y, y], [3.0, -y]])?))
    };
    (0..12).map(one).collect()
}

fn buffered(seconds: f64) -> Result<ManyTargets, Error> {
    let mut parameters = parameters()?;
    parameters.filter.life.buffer_ns = (seconds * 1e9) as i64;
    ManyTargets::new(&parameters)
}

/// Also of scans from before all others; the numbers are those of the order of arrival.
#[test]
fn the_order_of_arrival_changes_only_numbers() -> Result<(), Error> {
    let scans = parting()?;
    let (mut sorted, mut mixed) = (buffered(0.0)?, buffered(0.2)?);
    for (stamp, source, seen) in &scans {
        sorted.process(*stamp, *source, seen)?;
    }
    for k in [2, 0, 1, 5, 4, 3, 6, 7, 10, 8, 9, 11] {
        let (stamp, source, seen) = &scans[k];
        mixed.process(*stamp, *source, seen)?;
    }
    let (expected, found) = (sorted.tracks_at(1_000_000_000), mixed.tracks_at(1_000_000_000));
    assert_eq!(found.len(), 2);
    for (one, other) in expected.iter().zip(&found) {
        assert_eq!(TrackState { id: one.id, ..*other }, *one);
    }
    Ok(())
}

#[test]
fn tracks_keep_their_numbers_when_a_scan_comes_late() -> Result<(), Error> {
    let mut tracker = buffered(0.2)?;
    tracker.process(0, 0, &scan(0, &[[0.0, 0.0]])?)?;
    let third = scan(100_000_000, &[[0.0, 0.1], [8.0, 0.0]])?;
    assert_eq!(numbers(&tracker.process(100_000_000, 0, &third)?), [Some(0), Some(1)]);
    let second = scan(50_000_000, &[[0.0, 0.05], [-9.0, 0.0]])?;
    assert_eq!(numbers(&tracker.process(50_000_000, 0, &second)?), [Some(0), Some(2)]);
    let ids = tracker.tracks_at(100_000_000).iter().map(|t| t.id).collect::<Vec<i64>>();
    assert_eq!(ids, [0, 1, 2]);
    Ok(())
}

#[test]
fn a_scan_that_is_there_already_changes_nothing() -> Result<(), Error> {
    let mut tracker = buffered(0.2)?;
    for (stamp, source, seen) in parting()? {
        let first = tracker.process(stamp, source, &seen)?;
        let states = tracker.tracks_at(stamp);
        assert_eq!(tracker.process(stamp, source, &seen)?, first);
        assert_eq!(tracker.tracks_at(stamp), states);
    }
    Ok(())
}

#[test]
fn scans_older_than_the_buffer_are_refused() -> Result<(), Error> {
    let mut tracker = buffered(0.2)?;
    for (stamp, source, seen) in parting()? {
        tracker.process(stamp, source, &seen)?;
    }
    let (late, last) = (349_999_999, 350_000_000);
    assert!(matches!(tracker.process(late, 0, &[]), Err(Error::Time { .. })));
    assert!(tracker.process(last, 1, &[]).is_ok());
    Ok(())
}

/// The nearest pair alone would leave the second track without a measurement.
#[test]
fn as_many_tracks_as_possible_are_measured() -> Result<(), Error> {
    let mut tracker = ManyTargets::new(&parameters()?)?;
    let seen = scan(0, &[[0.0, 0.0], [0.6, 0.0]])?;
    assert_eq!(numbers(&tracker.process(0, 0, &seen)?), [Some(0), Some(1)]);
    let stamp = 100_000_000;
    let seen = scan(stamp, &[[0.5, 0.0], [1.9, 0.0]])?;
    let assigned = tracker.process(stamp, 0, &seen)?;
    assert_eq!(numbers(&assigned), [Some(0), Some(1)]);
    assert!(assigned.iter().all(|one| one.innovation.is_some_and(|y| y.nis > 0.0)));
    assert!(tracker.tracks_at(stamp).iter().all(|track| track.confirmed && track.hits == 2));
    Ok(())
}

#[test]
fn a_refused_scan_changes_nothing() -> Result<(), Error> {
    let mut tracker = ManyTargets::new(&parameters()?)?;
    tracker.process(5, 0, &scan(5, &[[0.0, 0.0]])?)?;
    let before = tracker.tracks_at(5);
    assert!(matches!(tracker.process(4, 0, &[]), Err(Error::Time { .. })));
    assert!(matches!(tracker.process(6, 0, &scan(7, &[[0.0; 2]])?), Err(Error::Value { .. })));
    assert!(matches!(tracker.process(6, 64, &[]), Err(Error::Parameter { .. })));
    let many = vec![[0.0; 2]; MAX_TARGETS + 1];
    assert!(matches!(tracker.process(6, 0, &scan(6, &many)?), Err(Error::Limit { .. })));
    assert_eq!(tracker.tracks_at(5), before);
    Ok(())
}

/// Places that a refused scan had added are dropped, too.
#[test]
fn a_scan_of_too_many_targets_leaves_the_state_as_it_was() -> Result<(), Error> {
    let mut tracker = ManyTargets::new(&ManyParameters { report_speed: 0.4, ..parameters()? })?;
    let row = |y: f64| (0..MAX_TARGETS).map(|x| [50.0 * x as f64, y]).collect::<Vec<_>>();
    tracker.process(0, 0, &scan(0, &row(0.0))?)?;
    let before = tracker.to_state()?;
    let stamp_ns = 100_000_000;
    let refused = tracker.process(stamp_ns, 0, &scan(stamp_ns, &row(5000.0))?);
    assert!(matches!(refused, Err(Error::Limit { .. })));
    assert!(tracker.to_state()? == before);
    Ok(())
}

#[test]
fn windows_that_cannot_be_are_refused() -> Result<(), Error> {
    for (confirm_hits, confirm_window) in [(0, 3), (4, 3), (3, 65)] {
        let wrong = ManyParameters { confirm_hits, confirm_window, ..parameters()? };
        assert!(ManyTargets::new(&wrong).is_err());
    }
    Ok(())
}

/// The last 300 scans of returns from everywhere are known to every kept state; they are kept once. Copies
/// would make 100 more scans of the buffer three times as large as the first 100.
#[test]
fn what_stands_is_kept_once_for_all_scans_of_the_buffer() -> Result<(), Error> {
    let mut parameters = ManyParameters { report_speed: 0.4, ..parameters()? };
    parameters.filter.life.buffer_ns = 600_000_000_000;
    let mut tracker = ManyTargets::new(&parameters)?;
    let mut sizes = [0; 3];
    for k in 0..300_i64 {
        let place = |n: i64| (k * 40 + n) as f64 * 0.618_034 % 1.0 * 500.0;
        let seen: Vec<[f64; 2]> = (0..12).map(|n| [place(n), place(n + 20)]).collect();
        tracker.process(k * 1_000_000_000, 0, &scan(k * 1_000_000_000, &seen)?)?;
        if k % 100 == 99 {
            sizes[k as usize / 100] = tracker.to_state()?.len();
        }
    }
    let [first, second, third] = sizes;
    assert!(third - second < second - first + first / 10, "{sizes:?}");
    assert!(second - first < first + first / 5, "{sizes:?}");
    assert_eq!(tracker.places[&0].len(), 300 * 12);
    // A saved tracker goes on to the same bits, also with a late scan.
    let mut again = ManyTargets::from_state(&parameters, &tracker.to_state()?)?;
    let (stamp, places) = (150_500_000_000, [[3.0, 4.0], [250.0, 8.0]]);
    for one in [&mut tracker, &mut again] {
        one.process(stamp, 0, &scan(stamp, &places)?)?;
    }
    assert_eq!(tracker.to_state()?, again.to_state()?);
    assert_eq!(tracker.places[&0].len(), 300 * 12 + 2);
    Ok(())
}

/// Bytes of a file may say anything: a number that is still to be given would name two targets.
#[test]
fn a_state_with_numbers_that_were_never_given_is_refused() -> Result<(), Error> {
    let mut parameters = parameters()?;
    parameters.filter.life.buffer_ns = 2_000_000_000;
    let restored = |change: fn(&mut ManyTargets)| {
        let mut tracker = ManyTargets::new(&parameters)?;
        for (stamp, source, measurements) in parting()? {
            tracker.process(stamp, source, &measurements)?;
        }
        change(&mut tracker);
        ManyTargets::from_state(&parameters, &tracker.to_state()?).map(drop)
    };
    restored(|_| ())?;
    restored(|tracker| tracker.next_id += 1000)?;
    let wrong: [fn(&mut ManyTargets); 8] = [
        |tracker| tracker.next_id = 1,
        |tracker| tracker.tracks.all[0].id = tracker.next_id,
        |tracker| tracker.tracks.all[0].id = -1,
        |tracker| tracker.history[3].before.all[0].id = i64::MAX,
        |tracker| tracker.history[0].births.of_column[0] = Some(-2),
        |tracker| tracker.history[5].assigned[0].id = Some(tracker.next_id),
        |tracker| tracker.history.swap(2, 3),
        |tracker| tracker.stamp_ns = Some(0),
    ];
    for (index, change) in wrong.into_iter().enumerate() {
        assert!(matches!(restored(change), Err(Error::Format { .. })), "{index}");
    }
    Ok(())
}
