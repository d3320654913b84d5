//! Tests of the whole tracker with values calculated by hand. The comparison with an oracle is in `tests/python`.

use super::*;

const STEP_NS: i64 = 100_000_000;
const NOTHING: [[f32; 3]; 0] = [];

fn best() -> TrackerParameters {
    TrackerParameters {
        association: Association::Global { gate_probability: 0.997, clutter_density: 1e-5 },
        ageing: Ageing::Visible { max_coast: 3.0, report_coast: 3.0 },
        merging: Some(Merging { distance: 0.3, speed: 1.0 }),
        confirmation: Confirmation::Counts { hits: 2, window: 3 },
        measurement: MeasurementForm::Cluster,
        measurement_std: 0.1,
        ..TrackerParameters::paper()
    }
}

fn free() -> OccupiedPoints {
    OccupiedPoints::new(&NOTHING, 1.0)
}

fn detect(
    tracker: &mut PointCloudTracker,
    positions: &[[f64; 3]],
    stamp_ns: i64,
) -> Result<Stats, Error> {
    let detections = Detections {
        stamp_ns,
        positions,
        covariance: None,
        extent: None,
        delay: None,
        confidence: None,
        is_joined: None,
        is_among_surfaces: None,
        shape: None,
    };
    tracker.new_detections(&detections, &free())
}

/// One position axis of Table II after 0.1 s: 0.5^2 + 0.3^2 + 0.015^2 + 0.5^2 = 0.590225.
#[test]
fn the_first_correction_agrees_with_a_calculation_by_hand() -> Result<(), Error> {
    let mut tracker = PointCloudTracker::new(TrackerParameters::paper(), 1)?;
    detect(&mut tracker, &[[0.0; 3]], 0)?;
    let stats = tracker.new_point_cloud(&[[0.4, 0.0, 0.0]], None, &free(), None, STEP_NS)?;
    assert_eq!(stats.corrected, [0]);
    let track = &tracker.tracks_at(STEP_NS)[0];
    let gain = 0.590225 / 1.590225;
    assert!((track.state.mean[0] - gain * f64::from(0.4_f32)).abs() < 1e-12);
    assert!((track.state.covariance[(0, 0)] - gain).abs() < 1e-12);
    assert!(track.confirmed);
    Ok(())
}

#[test]
fn a_cluster_beside_an_occupied_voxel_corrects_nothing() -> Result<(), Error> {
    for (voxel, corrected) in [([0.0, 1.0, 0.0], 0), ([0.0, 1.001, 0.0], 1)] {
        let mut tracker = PointCloudTracker::new(TrackerParameters::paper(), 1)?;
        detect(&mut tracker, &[[0.0; 3]], 0)?;
        let occupied = OccupiedPoints::new(&[voxel], 1.0);
        let stats = tracker.new_point_cloud(&[[0.0; 3]], None, &occupied, None, STEP_NS)?;
        assert_eq!(stats.corrected.len(), corrected);
    }
    Ok(())
}

#[test]
fn the_paper_counts_a_similar_detection_and_adds_a_distant_one() -> Result<(), Error> {
    let mut tracker = PointCloudTracker::new(TrackerParameters::paper(), 1)?;
    let stats = detect(&mut tracker, &[[0.0; 3], [3.0, 0.0, 0.0], [3.1, 0.0, 0.0]], 0)?;
    // Radii 1.5 + 1.5: the second is the first again, the third is new.
    assert_eq!(stats.born, [0, 1]);
    let counts: Vec<u32> = tracker.tracks_at(0).iter().map(|track| track.n_detections).collect();
    assert_eq!(counts, [2, 1]);
    Ok(())
}

#[test]
fn one_cluster_corrects_one_track_only() -> Result<(), Error> {
    let mut tracker = PointCloudTracker::new(best(), 1)?;
    detect(&mut tracker, &[[0.0; 3], [1.0, 0.0, 0.0]], 0)?;
    let stats = tracker.new_point_cloud(&[[0.3, 0.0, 0.0]], None, &free(), None, STEP_NS)?;
    assert_eq!(stats.corrected, [0]);
    let stats = tracker.new_point_cloud(
        &[[0.3, 0.0, 0.0], [0.9, 0.0, 0.0]],
        None,
        &free(),
        None,
        2 * STEP_NS,
    )?;
    assert_eq!(stats.corrected, [0, 1]);
    Ok(())
}

/// Probability of existence after every set of detections of a target with `confidence` and `speed` [m/s]; `seen`:
/// which sets contain it. `left`: positions along x of points that stay [m].
fn existence_of(confidence: f64, speed: f64, left: &[f32], seen: &str) -> Result<Vec<f64>, Error> {
    let confirmation = Confirmation::Existence { report: 0.9 };
    let mut tracker = PointCloudTracker::new(TrackerParameters { confirmation, ..best() }, 1)?;
    let mut existence = Vec::new();
    for (set, is_seen) in (0_i64..).zip(seen.chars().map(|one| one == 'x')) {
        let at = speed * set as f64 * 0.1;
        let mut points: Vec<[f32; 3]> = left.iter().map(|&x| [x, 0.0, 0.0]).collect();
        points.extend(is_seen.then_some([at as f32, 0.0, 0.0]));
        tracker.new_point_cloud(&points, None, &free(), None, set * STEP_NS)?;
        let positions: &[[f64; 3]] = if is_seen { &[[at, 0.0, 0.0]] } else { &[] };
        let found = Detections {
            stamp_ns: set * STEP_NS,
            positions,
            covariance: None,
            extent: None,
            delay: None,
            confidence: Some(&[confidence][..positions.len()]),
            is_joined: None,
            is_among_surfaces: None,
            shape: None,
        };
        tracker.new_detections(&found, &free())?;
        existence.push(tracker.tracks_at(set * STEP_NS).first().map_or(0.0, |one| one.existence));
    }
    Ok(existence)
}

#[test]
fn certain_detections_and_motion_make_a_target_probable() -> Result<(), Error> {
    let after = |confidence, speed, left: &[f32]| {
        Ok::<_, Error>(existence_of(confidence, speed, left, "xxx")?.last().copied())
    };
    assert!(after(0.9, 0.0, &[])? > Some(0.9));
    assert!(after(0.5, 0.0, &[])? < after(0.9, 0.0, &[])?);
    let moved = existence_of(0.5, 4.0, &[], "xxxxxxxx")?;
    let stays = existence_of(0.5, 4.0, &[-0.2], "xxxxxxxx")?; // something is left where it began
    assert!(moved[5] > stays[5], "{moved:?} {stays:?}");
    Ok(())
}

#[test]
fn a_target_that_is_gone_becomes_improbable() -> Result<(), Error> {
    let existence = existence_of(0.9, 1.0, &[], "xxxxxxxxxx....................")?;
    assert!(existence[9] > 0.99 && existence[11] > 0.5, "{existence:?}");
    assert!(existence[20..].iter().all(|&one| one < 0.2), "{existence:?}");
    let gap = existence_of(0.9, 1.0, &[], "xxxxxxxxxx..xx")?;
    assert!(gap.last() > Some(&0.99), "{gap:?}");
    Ok(())
}

/// IDs of the tracks that begin when a target which was hidden for 0.8 s comes back `aside` [m] of its straight path.
/// `acceleration`: `rejoin_acceleration` of the parameters.
fn born_behind_cover(acceleration: Option<f64>, aside: f64) -> Result<Vec<i64>, Error> {
    let motion = Motion {
        form: NoiseForm::Continuous,
        std: [0.0, 0.1, 1.0],
        ..TrackerParameters::paper().motion
    };
    let parameters = TrackerParameters { rejoin_acceleration: acceleration, motion, ..best() };
    let mut tracker = PointCloudTracker::new(parameters, 1)?;
    for set in (0..10).chain(18..19) {
        let at = [0.2 * set as f64, if set < 10 { 0.0 } else { aside }, 0.0];
        tracker.new_point_cloud(
            &[at.map(|value| value as f32)],
            None,
            &free(),
            None,
            set * STEP_NS,
        )?;
        let stats = detect(&mut tracker, &[at], set * STEP_NS)?;
        if set == 18 {
            return Ok(stats.born);
        }
    }
    Ok(Vec::new())
}

#[test]
fn a_lost_track_finds_a_target_that_has_turned() -> Result<(), Error> {
    assert_eq!(born_behind_cover(None, 2.0)?, [1]);
    assert!(born_behind_cover(Some(2.0), 2.0)?.is_empty());
    assert_eq!(born_behind_cover(Some(2.0), 5.0)?, [1]); // too far for any target
    Ok(())
}

#[test]
fn a_track_is_confirmed_by_two_of_three_sets() -> Result<(), Error> {
    let mut tracker = PointCloudTracker::new(best(), 1)?;
    let target = [[0.0; 3]];
    assert!(detect(&mut tracker, &target, 0)?.confirmed.is_empty());
    assert!(detect(&mut tracker, &[], 1)?.confirmed.is_empty());
    assert_eq!(detect(&mut tracker, &target, 2)?.confirmed, [0]);
    detect(&mut tracker, &[[50.0, 0.0, 0.0]], 3)?;
    detect(&mut tracker, &[], 4)?;
    detect(&mut tracker, &[], 5)?;
    assert_eq!(detect(&mut tracker, &[], 6)?.removed, [1]); // its only set has left the window
    Ok(())
}

#[test]
fn a_detection_newer_than_all_clouds_corrects_the_track() -> Result<(), Error> {
    let mut tracker = PointCloudTracker::new(best(), 1)?;
    tracker.new_point_cloud(&[[0.0; 3]], None, &free(), None, 0)?;
    detect(&mut tracker, &[[0.0; 3]], 0)?;
    detect(&mut tracker, &[[0.3, 0.0, 0.0]], STEP_NS)?;
    let tracks = tracker.tracks_at(STEP_NS);
    assert_eq!(tracks.len(), 1);
    assert!(tracks[0].state.mean[0] > 0.1);
    assert_eq!(tracks[0].seen_ns, STEP_NS);
    // The cloud of that time brings nothing new.
    let stats = tracker.new_point_cloud(&[[0.3, 0.0, 0.0]], None, &free(), None, STEP_NS)?;
    assert!(stats.corrected.is_empty());
    Ok(())
}

struct Hidden;

impl Visibility for Hidden {
    fn rays(&self, _: [f64; 3], _: f64, _: usize) -> usize {
        0
    }
}

#[test]
fn a_hidden_track_outlives_its_radius_and_ends_with_the_coast() -> Result<(), Error> {
    let mut tracker = PointCloudTracker::new(best(), 1)?;
    detect(&mut tracker, &[[0.0; 3]], 0)?;
    for step in 1..=30 {
        let stats =
            tracker.new_point_cloud(&NOTHING, None, &free(), Some(&Hidden), step * STEP_NS)?;
        assert!(stats.removed.is_empty(), "{step}");
    }
    let stats = tracker.new_point_cloud(&NOTHING, None, &free(), Some(&Hidden), 31 * STEP_NS)?;
    assert_eq!(stats.removed, [0]);
    Ok(())
}

#[test]
fn converged_twins_become_the_elder() -> Result<(), Error> {
    let merging = Merging { distance: 0.3, speed: 1.0 };
    let mut tracker = PointCloudTracker::new(
        TrackerParameters { merging: Some(merging), ..TrackerParameters::paper() },
        1,
    )?;
    detect(&mut tracker, &[[0.0; 3], [3.1, 0.0, 0.0]], 0)?;
    let mut merged = Vec::new();
    for step in 1..20 {
        let points = [[1.5, 0.0, 0.0]]; // within 1.55 m of both
        merged
            .extend(tracker.new_point_cloud(&points, None, &free(), None, step * STEP_NS)?.merged);
    }
    assert_eq!(merged, [[0, 1]]);
    assert_eq!(tracker.tracks_at(0).len(), 1);
    Ok(())
}

#[test]
fn parameters_that_cannot_work_are_refused() {
    let bad = [
        TrackerParameters { buffer_size: 0, ..TrackerParameters::paper() },
        TrackerParameters {
            confirmation: Confirmation::Counts { hits: 1, window: 65 },
            ..TrackerParameters::paper()
        },
        TrackerParameters {
            confirmation: Confirmation::Counts { hits: 3, window: 2 },
            ..TrackerParameters::paper()
        },
        TrackerParameters {
            radius: Radius { max: f64::NAN, ..TrackerParameters::paper().radius },
            ..TrackerParameters::paper()
        },
        TrackerParameters { max_extent: Some(f64::INFINITY), ..TrackerParameters::paper() },
        TrackerParameters { split_distance: Some(0.0), ..TrackerParameters::paper() },
        TrackerParameters {
            hiding: Some(Hiding { share: 0.75, time: 0.0 }),
            ..TrackerParameters::paper()
        },
        TrackerParameters {
            motion: Motion { acceleration_time: Some(0.0), ..TrackerParameters::paper().motion },
            ..TrackerParameters::paper()
        },
        TrackerParameters {
            association: Association::Global { gate_probability: 1.0, clutter_density: 1.0 },
            ..TrackerParameters::paper()
        },
    ];
    for parameters in bad {
        assert!(matches!(PointCloudTracker::new(parameters, 1), Err(Error::Parameter { .. })));
    }
}

/// Number of reported tracks after ten scans with one detection each, whose track jumps by 0.3 m. `own` points belong
/// to its cluster, `stray` points lie around it.
fn tracks_among(stray: usize, own: usize) -> Result<usize, Error> {
    let confirmation = TrackerParameters::default().confirmation;
    let parameters = TrackerParameters { confirmation, ..best() };
    let mut tracker = PointCloudTracker::new(parameters, 1)?;
    for scan in 0..10 {
        let stamp_ns = scan * STEP_NS;
        let height = 0.3 * (scan % 2) as f64;
        let point = |x: f64, y: f64, z: f64| [x as f32, y as f32, z as f32];
        let mut points: Vec<_> =
            (0..own).map(|number| point(0.02 * number as f64, 0.0, height)).collect();
        // On a circle, further from each other than points of one cluster.
        points.extend((0..stray).map(|number| {
            let (sine, cosine) = (0.9 * number as f64).sin_cos();
            point(1.4 * cosine, 1.4 * sine, 0.0)
        }));
        tracker.new_point_cloud(&points, None, &free(), None, stamp_ns)?;
        detect(&mut tracker, &[[0.0, 0.0, height]], stamp_ns)?;
    }
    Ok(tracker.tracks_at(9 * STEP_NS).iter().filter(|track| track.confirmed).count())
}

#[test]
fn a_track_among_more_stray_points_than_its_own_is_not_confirmed() -> Result<(), Error> {
    assert_eq!(tracks_among(6, 3)?, 0); // a pane of glass that returns a few rays
    assert_eq!(tracks_among(0, 3)?, 1); // alone in the air
    assert_eq!(tracks_among(6, 12)?, 1); // larger than the flakes of snow around it
    Ok(())
}

/// IDs of tracks after some sets of detections of two objects that are `apart` [m]. The first has the sides `sides`
/// [m], the second 0.3 m.
fn tracks_of_two(apart: f64, sides: [f64; 3]) -> Result<Vec<i64>, Error> {
    let mut tracker = PointCloudTracker::new(best(), 1)?;
    for set in 0..4 {
        let found = Detections {
            stamp_ns: set * STEP_NS,
            positions: &[[0.0; 3], [apart, 0.0, 0.0]],
            covariance: Some(&[[[0.01, 0.0, 0.0], [0.0, 0.01, 0.0], [0.0, 0.0, 0.01]]; 2]),
            extent: Some(&[sides, [0.3; 3]]),
            delay: None,
            confidence: None,
            is_joined: None,
            is_among_surfaces: None,
            shape: None,
        };
        tracker.new_detections(&found, &free())?;
    }
    Ok(tracker.tracks_at(3 * STEP_NS).iter().map(|track| track.id).collect())
}

#[test]
fn a_part_of_a_large_target_is_no_other_target() -> Result<(), Error> {
    assert_eq!(tracks_of_two(1.1, [1.4, 0.5, 0.3])?, [0]);
    // Small targets side by side, and one that is further away, are targets of their own.
    assert_eq!(tracks_of_two(1.1, [0.6, 0.6, 0.3])?, [0, 1]);
    assert_eq!(tracks_of_two(1.7, [1.4, 0.5, 0.3])?, [0, 1]);
    Ok(())
}

#[test]
fn what_stands_is_unknown_and_then_static_and_gone_once_it_has_left() -> Result<(), Error> {
    let mut tracker = PointCloudTracker::new(best(), 1)?;
    let place = [5.0, 0.0, 0.0];
    let found = Detections {
        stamp_ns: 0,
        positions: &[place],
        covariance: None,
        extent: Some(&[[0.4; 3]]),
        delay: None,
        confidence: None,
        is_joined: None,
        is_among_surfaces: None,
        shape: None,
    };
    tracker.watch(&found);
    let wall: Vec<[f32; 3]> = (-20..20).map(|step| [9.0, 0.02 * step as f32, 0.0]).collect();
    let scan = |there: bool| -> Vec<[f32; 3]> {
        let target = there.then_some([4.8, 0.0, 0.0]);
        wall.iter().copied().chain(target).collect()
    };
    let look = |tracker: &mut PointCloudTracker, step: i64, there: bool| {
        let points = scan(there);
        let view = CloudView { points: &points, origin: [0.0; 3] };
        let held = OccupiedPoints::new(&points, 1.0);
        let stats = tracker.new_point_cloud(&points, None, &held, Some(&view), step * STEP_NS)?;
        let kinds: Vec<TrackKind> =
            tracker.tracks_at(step * STEP_NS).iter().map(|track| track.kind).collect();
        Ok::<_, Error>((kinds, stats.removed))
    };
    assert_eq!(look(&mut tracker, 1, true)?.0, [TrackKind::Unknown]);
    assert_eq!(look(&mut tracker, 1200, true)?.0, [TrackKind::Static]);
    let state = tracker.to_state()?;
    let mut copy = PointCloudTracker::from_state(best(), 1, &state)?;
    for tracker in [&mut tracker, &mut copy] {
        assert_eq!(look(tracker, 1201, false)?.0.len(), 1);
        look(tracker, 1202, false)?;
        look(tracker, 1203, false)?;
        let (kinds, removed) = look(tracker, 1204, false)?;
        assert!(kinds.is_empty());
        assert_eq!(removed, [0]);
    }
    Ok(())
}

/// One detection of a small target, right to 2 cm.
fn small_at(stamp_ns: i64, positions: &[[f64; 3]; 1]) -> Detections<'_> {
    Detections {
        stamp_ns,
        positions,
        covariance: Some(&[[[4e-4, 0.0, 0.0], [0.0, 4e-4, 0.0], [0.0, 0.0, 4e-4]]]),
        extent: Some(&[[0.4; 3]]),
        confidence: Some(&[0.9]),
        ..Detections::default()
    }
}

/// IDs of the confirmed tracks after one detection `away` [m] from an object that stood. `is_held`: whether the map
/// still holds the object.
fn after_standing(away: f64, is_held: bool) -> Result<Vec<i64>, Error> {
    let mut tracker = PointCloudTracker::new(TrackerParameters::default(), 1)?;
    let (place, other) = ([[5.0, 0.0, 0.0]], [[5.0 + away, 0.0, 0.0]]);
    tracker.watch(&small_at(0, &place));
    let point = [5.0 + away as f32, 0.0, 0.0];
    let held = OccupiedPoints::new(if is_held { &[[5.0, 0.0, 0.0]] } else { &NOTHING[..] }, 1.0);
    tracker.new_point_cloud(&[point], None, &held, None, STEP_NS)?;
    let stats = tracker.new_detections(&small_at(STEP_NS, &other), &free())?;
    Ok(stats.confirmed)
}

#[test]
fn what_has_left_its_place_is_a_target_at_once_and_what_is_there_is_not() -> Result<(), Error> {
    assert_eq!(after_standing(0.4, false)?, [0]);
    assert_eq!(after_standing(0.4, true)?, Vec::<i64>::new());
    assert_eq!(after_standing(0.15, false)?, Vec::<i64>::new());
    assert_eq!(after_standing(2.5, false)?, Vec::<i64>::new(), "another target");
    Ok(())
}

#[test]
fn a_track_that_was_known_before_keeps_the_number_of_what_the_map_lost() -> Result<(), Error> {
    let mut tracker = PointCloudTracker::new(TrackerParameters::default(), 1)?;
    let (place, beside) = ([[5.0, 0.0, 0.0]], [[5.4, 0.0, 0.0]]);
    tracker.watch(&small_at(0, &place));
    let wall: Vec<[f32; 3]> = (-20..20).map(|step| [9.0, 0.02 * step as f32, 0.0]).collect();
    let (mut removed, mut merged) = (Vec::new(), Vec::new());
    for step in 1..=9 {
        let is_lost = step > 4; // all rays pass its place from then on
        let own = [[5.0, 0.0, 0.0], [5.4, 0.0, 0.0]];
        let points: Vec<_> =
            wall.iter().copied().chain(own[usize::from(is_lost)..].to_vec()).collect();
        let held = OccupiedPoints::new(if is_lost { &NOTHING[..] } else { &own[..1] }, 0.1);
        let view = CloudView { points: &wall, origin: [0.0; 3] };
        let stamp_ns = step * STEP_NS;
        let stats = tracker.new_point_cloud(&points, None, &held, Some(&view), stamp_ns)?;
        removed.extend(stats.removed);
        merged.extend(stats.merged);
        let stats = tracker.new_detections(&small_at(stamp_ns, &beside), &free())?;
        let is_confirmed = |track: &&Track| track.confirmed;
        let tracks = tracker.tracks_at(stamp_ns);
        if step == 4 {
            assert_eq!(tracks.iter().filter(is_confirmed).count(), 2, "the object and the track");
            assert!(stats.merged.is_empty());
        }
    }
    assert_eq!((removed, merged), (vec![], vec![[0, 1]]));
    let tracks = tracker.tracks_at(9 * STEP_NS);
    assert_eq!(tracks.iter().map(|track| track.id).collect::<Vec<_>>(), [0]);
    Ok(())
}

/// IDs and probabilities of existence of the tracks of a target of 30 m/s that flies `step` [m] from scan to scan. The
/// rays of a scan meet it `delay` [s] after the stamp of the scan.
fn passer(delay: f64, scans: i64, step: f64) -> Result<Vec<(i64, f64)>, Error> {
    passer_of(TrackerParameters::default(), delay, scans, step)
}

fn passer_of(
    parameters: TrackerParameters,
    delay: f64,
    scans: i64,
    step: f64,
) -> Result<Vec<(i64, f64)>, Error> {
    let mut tracker = PointCloudTracker::new(parameters, 1)?;
    for scan in 0..scans {
        let stamp_ns = scan * STEP_NS;
        let position = [step * scan as f64, 8.0, 3.0];
        let point = position.map(|value| value as f32);
        let delays = [delay as f32];
        tracker.new_point_cloud(&[point], Some(&delays), &free(), None, stamp_ns)?;
        let found = Detections {
            stamp_ns,
            positions: &[position],
            covariance: Some(&[[[0.01, 0.0, 0.0], [0.0, 0.01, 0.0], [0.0, 0.0, 0.01]]]),
            delay: Some(&[delay]),
            confidence: Some(&[0.9]),
            ..Detections::default()
        };
        tracker.new_detections(&found, &free())?;
    }
    let tracks = tracker.tracks_at((scans - 1) * STEP_NS);
    Ok(tracks.into_iter().map(|track| (track.id, track.existence)).collect())
}

#[test]
fn a_fast_target_is_known_by_its_third_detection_however_late_in_the_scan() -> Result<(), Error> {
    for delay in [0.0, 0.03, 0.09] {
        let probable: Vec<_> =
            passer(delay, 3, 3.0)?.into_iter().filter(|&(_, existence)| existence > 0.9).collect();
        assert_eq!(probable.len(), 1, "{delay}: {probable:?}");
        let later = passer(delay, 8, 3.0)?;
        assert!(later.iter().any(|&(id, p)| id == probable[0].0 && p > 0.99), "{delay}: {later:?}");
    }
    Ok(())
}

/// The uncertainty of the centre of a large target stays above that of its shape after any number of scans. The
/// uncertainty of the centre of a small target does not.
#[test]
fn scans_do_not_remove_what_the_shape_of_a_large_target_hides() -> Result<(), Error> {
    for (side, is_large) in [(1.5, true), (0.5, false)] {
        let parameters = TrackerParameters { measurement: MeasurementForm::Center, ..best() };
        let mut tracker = PointCloudTracker::new(parameters, 1)?;
        let detections = Detections {
            positions: &[[0.0; 3]],
            extent: Some(&[[side, 0.3, 0.3]]),
            ..Detections::default()
        };
        tracker.new_detections(&detections, &free())?;
        let points: Vec<[f32; 3]> =
            (-6_i8..=6).map(|at| [side as f32 / 12.0 * f32::from(at), 0.0, 0.0]).collect();
        for step in 1..30 {
            tracker.new_point_cloud(&points, None, &free(), None, step * STEP_NS)?;
        }
        let (told, own) = (&tracker.tracks_at(29 * STEP_NS)[0], &tracker.tracks[0]);
        let more = told.state.covariance - own.estimate.covariance;
        assert_eq!(more[(2, 2)] > 0.03_f64.powi(2), is_large, "{more}");
        assert!(is_large || more.norm() == 0.0);
    }
    Ok(())
}

/// Whether a track counts as moved if its target flies one round on a circle of `radius` [m] and is back at its
/// start. Errors are up to 0.02 m.
fn counts_as_moved(radius: f64) -> Result<bool, Error> {
    let mut tracker = PointCloudTracker::new(TrackerParameters::default(), 1)?;
    for scan in 0..10_i64 {
        let (angle, error) = (0.7 * scan as f64, 0.02 * libm::sin(2.5 * scan as f64));
        let [x, y] = [libm::cos(angle), libm::sin(angle)].map(|part| radius * part + error);
        tracker.new_point_cloud(
            &[[x as f32, y as f32, 0.0]],
            None,
            &free(),
            None,
            scan * STEP_NS,
        )?;
        let covariance =
            [0, 1, 2].map(|row| [0, 1, 2].map(|at| if row == at { 4e-4 } else { 0.0 }));
        let found = Detections {
            stamp_ns: scan * STEP_NS,
            positions: &[[x, y, 0.0]],
            covariance: Some(&[covariance]),
            confidence: Some(&[0.9]),
            ..Detections::default()
        };
        tracker.new_detections(&found, &free())?;
    }
    Ok(!tracker.moved_by(0.5).is_empty())
}

#[test]
fn a_target_on_a_small_circle_moves_and_one_that_hovers_does_not() -> Result<(), Error> {
    assert!(counts_as_moved(0.28)?);
    assert!(!counts_as_moved(0.0)?);
    Ok(())
}

/// The single detections of a fast target give no tracks beside its own. Its ID is that of the first of them that was
/// reported.
#[test]
fn the_parts_of_a_fast_target_end_when_it_is_confirmed() -> Result<(), Error> {
    let confirmation = |report| Confirmation::Existence { report };
    for (report, id) in [(0.9, 2), (0.5, 0)] {
        let parameters = TrackerParameters {
            confirmation: confirmation(report),
            ..TrackerParameters::default()
        };
        for delay in [0.0, 0.03, 0.09] {
            let tracks = passer_of(parameters, delay, 4, 3.0)?;
            let ids: Vec<i64> = tracks.iter().filter(|track| track.1 > 0.3).map(|t| t.0).collect();
            assert_eq!(ids, [id], "{delay}: {tracks:?}");
        }
    }
    // The opposite: what is detected again where it was is a target of its own.
    assert!(passer(0.0, 6, 0.0)?.iter().any(|&(id, existence)| id == 0 && existence > 0.9));
    Ok(())
}
