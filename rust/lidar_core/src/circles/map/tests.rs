use super::*;
use crate::circles::fit::circle::{Circle, CircleEstimate};
use crate::circles::preprocess::polar_scan::PolarScan;
use crate::circles::shape::{ShapeEstimate, ShapeKind};
use crate::geometry::transform::Transform;
use std::f64::consts::PI;

const STEP_NS: i64 = 50_000_000;

fn best() -> Independent {
    let mode = |density, weight, duration| MotionMode { density, weight, duration };
    Independent {
        modes: vec![mode(0.003, 0.5, 2.0), mode(0.5, 0.48, 2.0), mode(100.0, 0.02, 0.1)],
        birth_density: 0.1,
        merge_gap: 0.1,
        visibility_test: VisibilityTest { margin: 0.1, min_rays: 4 },
        buffer_time: 1.0,
        ..Independent::default()
    }
}

fn map_of(filter: ElementFilter) -> Result<CircleMap, Error> {
    CircleMap::new(CircleMapParameters { filter, gate_probability: 0.999, initial_speed: 1.5 })
}

fn circle(x: f64, y: f64, radius: f64) -> CircleEstimate {
    let mut covariance = [[0.0; 3]; 3];
    for (axis, row) in covariance.iter_mut().enumerate() {
        row[axis] = 1e-4;
    }
    CircleEstimate {
        circle: Circle { center: [x, y], radius },
        covariance,
        n_hits: 20,
        is_fallback: false,
    }
}

fn scan(step: i64, estimates: &[CircleEstimate]) -> CircleScan<'_> {
    const HERE: &Transform = &Transform::IDENTITY;
    CircleScan {
        stamp_ns: step * STEP_NS,
        sensor: 0,
        world_from_lidar: HERE,
        pose_covariance: None,
        estimates,
        delays: None,
        outlines: &[],
        points: None,
        covered: None,
        lines: &[],
        view: None,
    }
}

/// A scan that sees everything up to 5 m in front.
fn wall() -> PolarScan {
    let bearings: Vec<f64> = (-540..=540).map(|ray| f64::from(ray) * PI / 720.0).collect();
    PolarScan { ranges: vec![5.0; bearings.len()], bearings }
}

fn paper() -> ElementFilter {
    ElementFilter::Paper(Joint { velocity_step: 0.1, max_eigenvalue: 3.0 })
}

#[test]
fn an_element_is_confirmed_moves_and_goes() -> Result<(), Error> {
    let mut map = map_of(ElementFilter::Independent(best()))?;
    let mut confirmed = Vec::new();
    for step in 0..40 {
        let stats = map.update(&scan(step, &[circle(3.0 + 0.05 * step as f64, 1.0, 0.3)]))?;
        assert_eq!(stats.elements, [0]);
        confirmed.extend(stats.confirmed.iter().map(|&id| (step, id)));
    }
    assert_eq!(confirmed, [(1, 0)]);
    let now = map.map_at(39 * STEP_NS);
    assert!((now[0].state.mean[2] - 1.0).abs() < 0.02 && (now[0].age - 1.95).abs() < 1e-9);
    let gone: Vec<i64> = (40..46)
        .map(|step| map.update(&scan(step, &[])).map(|stats| stats.removed))
        .collect::<Result<Vec<_>, _>>()?
        .concat();
    assert_eq!(gone, [0]);
    assert_eq!(map.update(&scan(46, &[circle(3.0, 1.0, 0.3)]))?.born, [1]); // numbers go on
    Ok(())
}

#[test]
fn hidden_elements_stay_and_absent_ones_go() -> Result<(), Error> {
    for (distance, stays) in [(7.0, true), (3.0, false)] {
        let mut map = map_of(ElementFilter::Independent(best()))?;
        for step in 0..20 {
            map.update(&scan(step, &[circle(distance, 0.0, 0.3)]))?;
        }
        let wall = wall();
        let view = Some(ScanWithLimits { scan: &wall, range_min: 0.1, range_max: 10.0 });
        for step in 20..60 {
            map.update(&CircleScan { view, ..scan(step, &[]) })?;
        }
        let now = map.map_at(60 * STEP_NS);
        assert_eq!(
            now.iter().map(|element| element.visible).collect::<Vec<_>>(),
            vec![false; usize::from(stays)]
        );
    }
    Ok(())
}

#[test]
fn scans_that_come_late_leave_the_same_map() -> Result<(), Error> {
    let circles = |step: i64| {
        let x = 0.05 * step as f64;
        let mut all = vec![circle(3.0 + x, 1.0, 0.3), circle(5.0 - x, -1.0, 0.2)];
        if step >= 5 {
            all.push(circle(2.0, -3.0 + x, 0.25));
        }
        all
    };
    let (mut straight, mut mixed) =
        (map_of(ElementFilter::Independent(best()))?, map_of(ElementFilter::Independent(best()))?);
    for step in 0..12 {
        straight.update(&scan(step, &circles(step)))?;
    }
    for step in [0, 1, 2, 4, 3, 7, 5, 6, 8, 9, 11, 10] {
        let newest = mixed.map_at(0).len();
        let stats = mixed.update(&scan(step, &circles(step)))?;
        assert_eq!(stats.late, [3, 5, 6, 10].contains(&step), "{step} {newest}");
    }
    assert_eq!(straight.map_at(11 * STEP_NS), mixed.map_at(11 * STEP_NS));
    assert!(matches!(mixed.update(&scan(11, &circles(11))), Err(Error::Time { .. })));
    assert!(matches!(mixed.update(&scan(10, &circles(10))), Err(Error::Time { .. })));
    assert!(matches!(mixed.update(&scan(-1, &circles(10))), Err(Error::Time { .. })));
    assert_eq!(straight.map_at(11 * STEP_NS), mixed.map_at(11 * STEP_NS));
    Ok(())
}

#[test]
fn what_nearly_touches_becomes_one() -> Result<(), Error> {
    for (gap, count) in [(0.05, 1), (0.2, 2)] {
        let mut map = map_of(ElementFilter::Independent(best()))?;
        for step in 0..10 {
            map.update(&scan(step, &[circle(3.0, 0.0, 0.3), circle(3.0, 0.4 + gap, 0.1)]))?;
        }
        let now = map.map_at(9 * STEP_NS);
        assert_eq!(now.len(), count);
        assert!((now[0].state.mean[1]).abs() < 1e-6 && now[0].id == 0);
    }
    Ok(())
}

#[test]
fn elements_of_one_object_become_one() -> Result<(), Error> {
    let mut map = map_of(ElementFilter::Independent(best()))?;
    for step in 0..10 {
        map.update(&scan(step, &[circle(3.0, 0.0, 0.3)]))?;
    }
    let stats = map.update(&scan(10, &[circle(3.1, 0.1, 0.2), circle(3.0, 0.0, 0.3)]))?;
    assert_eq!((stats.elements, stats.born, stats.merged), (vec![0, 0], vec![], vec![]));
    assert_eq!(map.map_at(10 * STEP_NS).len(), 1);
    assert!((map.map_at(10 * STEP_NS)[0].state.mean[0] - 3.0).abs() < 1e-6);
    Ok(())
}

#[test]
fn what_comes_to_touch_another_becomes_one_with_it() -> Result<(), Error> {
    let mut map = map_of(ElementFilter::Independent(best()))?;
    let mut merged = Vec::new();
    for step in 0..12 {
        let comes = circle(3.0, 0.9 - 0.04 * step as f64, 0.1);
        merged.extend(map.update(&scan(step, &[circle(3.0, 0.0, 0.3), comes]))?.merged);
    }
    assert_eq!(merged, [[0, 1]]);
    assert_eq!(map.map_at(11 * STEP_NS).len(), 1);
    Ok(())
}

#[test]
fn what_stands_inside_a_large_circle_is_another() -> Result<(), Error> {
    for (radius, inside, number) in [(0.9, 0.2, 1), (0.9, 0.6, 0), (0.3, 0.1, 0)] {
        let mut map = map_of(ElementFilter::Independent(best()))?;
        for step in 0..10 {
            map.update(&scan(step, &[circle(3.0, 0.0, radius)]))?;
        }
        let stats = map.update(&scan(10, &[circle(3.1, 0.1, inside)]))?;
        assert_eq!(stats.elements, [number], "{inside} in {radius}");
    }
    Ok(())
}

#[test]
fn bad_scans_change_nothing() -> Result<(), Error> {
    for filter in [paper(), ElementFilter::Independent(best())] {
        let mut map = map_of(filter)?;
        for step in 0..5 {
            map.update(&scan(step, &[circle(3.0, 0.0, 0.3)]))?;
        }
        let before = map.map_at(5 * STEP_NS);
        let mut bad = circle(3.0, 0.0, 0.3);
        bad.covariance[0][0] = -1.0;
        assert!(matches!(map.update(&scan(5, &[bad])), Err(Error::Value { .. })));
        assert!(map.update(&scan(5, &[circle(f64::NAN, 0.0, 0.3)])).is_err());
        assert!(map.update(&scan(5, &[circle(3.0, 0.0, 0.0)])).is_err());
        assert!(matches!(map.update(&scan(4, &[])), Err(Error::Time { .. })));
        let lost = Transform { translation: [f64::NAN; 3], ..Transform::IDENTITY };
        assert!(map.update(&CircleScan { world_from_lidar: &lost, ..scan(5, &[]) }).is_err());
        let mut doubt = [[0.0; 6]; 6];
        doubt[2][2] = -1.0;
        assert!(map.update(&CircleScan { pose_covariance: Some(&doubt), ..scan(5, &[]) }).is_err());
        assert_eq!(map.map_at(5 * STEP_NS), before);
        assert!(map.update(&scan(5, &[circle(3.0, 0.0, 0.3)])).is_ok());
    }
    Ok(())
}

#[test]
fn the_joint_filter_keeps_numbers_and_forgets_what_is_vague() -> Result<(), Error> {
    let mut map = map_of(paper())?;
    let mut doubt = [[0.0; 6]; 6];
    (doubt[0][0], doubt[1][1], doubt[5][5]) = (1e-4, 1e-4, 1e-5);
    let pose_covariance = Some(&doubt);
    for step in 0..30 {
        let x = 0.02 * step as f64;
        let circles = [circle(3.0 + x, 0.0, 0.3), circle(3.0, 2.0 - x, 0.2)];
        let stats = map.update(&CircleScan { pose_covariance, ..scan(step, &circles) })?;
        assert_eq!(stats.elements, [0, 1]);
    }
    let now = map.map_at(29 * STEP_NS);
    assert!((now[0].state.mean[2] - 0.4).abs() < 0.05 && (now[1].state.mean[3] + 0.4).abs() < 0.05);
    let mut step = 30;
    while !map.map_at(step * STEP_NS).is_empty() {
        map.update(&scan(step, &[]))?;
        step += 1;
        assert!(step < 300, "never deleted");
    }
    assert_eq!(map.update(&scan(step, &[circle(3.0, 0.0, 0.3)]))?.born, [2]);
    Ok(())
}

#[test]
fn parameters_outside_their_range_are_refused() {
    let changes: [fn(&mut Independent); 8] = [
        |p| p.modes[1].weight = 1e-17,
        |p| p.modes[1].duration = 1e-300,
        |p| p.modes.clear(),
        |p| p.modes[0].duration = 0.0,
        |p| p.birth_density = f64::NAN,
        |p| p.merge_gap = -0.1,
        |p| p.report_existence = 1.0,
        |p| p.limits.radius = -1.0,
    ];
    for change in changes {
        let mut parameters = best();
        change(&mut parameters);
        assert!(matches!(
            map_of(ElementFilter::Independent(parameters)),
            Err(Error::Parameter { .. })
        ));
    }
    let joint = Joint { velocity_step: -1.0, max_eigenvalue: 1.0 };
    assert!(map_of(ElementFilter::Paper(joint)).is_err());
}

#[test]
fn a_circle_measured_later_counts_at_its_own_time() -> Result<(), Error> {
    let mut map = map_of(ElementFilter::Independent(best()))?;
    for step in 0..40 {
        let circles = [circle(2.0 + 0.05 * step as f64 + 0.02, 0.0, 0.3)]; // 1 m/s, 20 ms later
        let late = CircleScan { delays: Some(&[0.02]), ..scan(step, &circles) };
        map.update(&late)?;
    }
    let found = map.map_at(39 * STEP_NS);
    assert!((found[0].state.mean[0] - (2.0 + 0.05 * 39.0)).abs() < 2e-3);
    let circles = [circle(4.0, 0.0, 0.3)];
    for delays in [&[][..], &[f64::NAN], &[1e300]] {
        assert!(map.update(&CircleScan { delays: Some(delays), ..scan(40, &circles) }).is_err());
    }
    Ok(())
}

/// View of a sensor that looks the other way.
fn blind() -> PolarScan {
    PolarScan { ranges: vec![f64::NAN; 3], bearings: vec![-0.1, 0.0, 0.1] }
}

#[test]
fn one_of_three_sensors_is_enough() -> Result<(), Error> {
    let (mut map, blind) = (map_of(ElementFilter::Independent(best()))?, blind());
    let view = Some(ScanWithLimits { scan: &blind, range_min: 0.1, range_max: 10.0 });
    for step in 0..60 {
        let (here, sensor) = ([circle(3.0, 0.0, 0.3)], (step % 3) as u32);
        let circles = if sensor == 0 { &here[..] } else { &[] };
        map.update(&CircleScan { view, sensor, ..scan(step, circles) })?;
        let now = map.map_at(step * STEP_NS);
        assert_eq!((now.len(), now[0].id, now[0].visible), (1, 0, true), "{step}");
        assert_eq!(now[0].confirmed, step >= 3, "{step}");
    }
    for step in 60..75 {
        map.update(&CircleScan { view, sensor: (step % 3) as u32, ..scan(step, &[]) })?;
    }
    assert!(!map.map_at(75 * STEP_NS)[0].visible);
    Ok(())
}

#[test]
fn what_no_sensor_sees_again_is_never_reported() -> Result<(), Error> {
    let (mut map, blind) = (map_of(ElementFilter::Independent(best()))?, blind());
    let view = Some(ScanWithLimits { scan: &blind, range_min: 0.1, range_max: 10.0 });
    map.update(&scan(0, &[circle(3.0, 0.0, 0.3)]))?;
    for step in 1..16 {
        map.update(&CircleScan { view, sensor: (step % 3) as u32, ..scan(step, &[]) })?;
    }
    assert!(map.map_at(15 * STEP_NS).is_empty());
    Ok(())
}

#[test]
fn a_slow_scanner_may_miss_a_scan() -> Result<(), Error> {
    let mut map = map_of(ElementFilter::Independent(best()))?;
    for step in 0..59 {
        let here = [circle(3.0, 0.0, 0.3)];
        let circles = if step % 10 == 9 { &[] } else { &here[..] };
        map.update(&scan(10 * step, circles))?; // 2 Hz
        assert_eq!(map.map_at(10 * step * STEP_NS)[0].id, 0);
    }
    let (mut reported, mut removed) = (Vec::new(), Vec::new());
    for step in 59..69 {
        removed.extend(map.update(&scan(10 * step, &[]))?.removed);
        let now = map.map_at(10 * step * STEP_NS);
        reported.push(now.iter().filter(|element| element.confirmed).count());
    }
    assert_eq!(reported, [1, 0, 0, 0, 0, 0, 0, 0, 0, 0]);
    assert_eq!(removed, [0]); // it might have come back elsewhere for some seconds
    Ok(())
}

#[test]
fn a_number_that_was_removed_never_comes_back() -> Result<(), Error> {
    let mut map = map_of(ElementFilter::Independent(best()))?;
    let here = [circle(3.0, 0.0, 0.3)];
    for step in 0..5 {
        map.update(&scan(step, &here))?;
    }
    let gone: Vec<i64> = (6..12)
        .map(|step| map.update(&scan(step, &[])).map(|stats| stats.removed))
        .collect::<Result<Vec<_>, _>>()?
        .concat();
    assert_eq!(gone, [0]);
    for late in [5 * STEP_NS, 8 * STEP_NS + 1] {
        let stats = map.update(&CircleScan { stamp_ns: late, ..scan(0, &here) })?;
        assert!(stats.late && !stats.born.contains(&0));
    }
    let now = map.map_at(11 * STEP_NS);
    assert_eq!((now.len(), now[0].confirmed), (1, true));
    let stats = map.update(&scan(12, &here))?;
    assert_eq!((stats.elements, stats.born), (vec![now[0].id], vec![]));
    Ok(())
}

#[test]
fn sensors_of_one_stamp_come_in_any_order() -> Result<(), Error> {
    for filter in [paper(), ElementFilter::Independent(best())] {
        let mut map = map_of(filter)?;
        for step in 0..5 {
            for sensor in [2, 0, 1] {
                map.update(&CircleScan { sensor, ..scan(step, &[circle(3.0, 0.0, 0.3)]) })?;
            }
            let again = map.update(&CircleScan { sensor: 0, ..scan(step, &[]) });
            assert!(again.is_err_and(|error| error.to_string().contains("from sensor 0")));
        }
        assert_eq!(map.map_at(5 * STEP_NS)[0].id, 0);
    }
    Ok(())
}

#[test]
fn a_full_buffer_names_its_limit() -> Result<(), Error> {
    let mut map = map_of(ElementFilter::Independent(Independent { buffer_time: 60.0, ..best() }))?;
    for step in 0..1_010 {
        map.update(&CircleScan { stamp_ns: step * 1_000_000, ..scan(0, &[]) })?;
    }
    let late = map.update(&CircleScan { stamp_ns: 1, ..scan(0, &[]) });
    assert!(late.is_err_and(|error| error.to_string().contains("the last 1000 scans")));
    Ok(())
}

/// A line of the level frame: bearing of its normal, distance, ends along it.
fn line(angle: f64, distance: f64, ends: [f64; 2]) -> ShapeEstimate {
    let mut covariance = [[0.0; 5]; 5];
    (covariance[0][0], covariance[1][1]) = (1e-5, 1e-5);
    let parameters = [angle, distance, ends[0], ends[1], 0.0];
    ShapeEstimate { kind: ShapeKind::Line, parameters, covariance, misfit: 10.0, n_hits: 30 }
}

fn walls(step: i64, lines: &[ShapeEstimate]) -> CircleScan<'_> {
    CircleScan { lines, ..scan(step, &[]) }
}

#[test]
fn a_line_grows_with_what_is_seen_of_it_and_waits_while_it_is_hidden() -> Result<(), Error> {
    let mut map = map_of(ElementFilter::Independent(best()))?;
    for step in 0..5 {
        let right = 1.0 + 0.2 * step as f64;
        let stats = map.update(&walls(step, &[line(0.0, 6.0, [-1.0, right])]))?;
        assert_eq!(stats.lines, [Some(0)]);
    }
    let now = map.shapes_at(5 * STEP_NS);
    assert_eq!((now.len(), now[0].kind, now[0].confirmed), (1, ShapeKind::Line, true));
    let [[x, y], [to_x, to_y]] = now[0].ends.unwrap_or_default();
    assert!((x - 6.0).abs() + (y + 1.0).abs() + (to_x - 6.0).abs() + (to_y - 1.8).abs() < 1e-9);
    assert!((now[0].state.mean[4] - 0.5 * PI).abs() < 1e-9 && map.map_at(0).is_empty());
    let wall = wall(); // 5 m away, before it
    let view = Some(ScanWithLimits { scan: &wall, range_min: 0.1, range_max: 10.0 });
    for step in 5..305 {
        map.update(&CircleScan { view, ..scan(step, &[]) })?;
    }
    let now = map.shapes_at(305 * STEP_NS);
    assert!(now.len() == 1 && !now[0].visible);
    let open = PolarScan { ranges: vec![f64::INFINITY; wall.len()], bearings: wall.bearings };
    let view = Some(ScanWithLimits { scan: &open, range_min: 0.1, range_max: 10.0 });
    let gone = (305..315).map(|step| map.update(&CircleScan { view, ..scan(step, &[]) }));
    let gone = gone.map(|stats| stats.map(|stats| stats.removed));
    assert_eq!(gone.collect::<Result<Vec<_>, _>>()?.concat(), [0]);
    Ok(())
}

#[test]
fn pieces_of_one_surface_are_one_line_and_its_other_side_is_another() -> Result<(), Error> {
    let mut map = map_of(ElementFilter::Independent(best()))?;
    let pieces = [line(0.0, 4.0, [-2.0, -0.3]), line(0.0, 4.0, [0.1, 2.0])];
    for step in 0..6 {
        map.update(&walls(step, &pieces))?;
    }
    assert_eq!(map.shapes_at(0).len(), 1);
    let far = line(0.0, 4.0, [3.0, 4.0]); // a door between
    let behind = Transform { translation: [8.0, 0.0, 0.0], ..Transform::IDENTITY };
    let back = [line(PI, 4.0, [-2.0, 2.0])];
    for step in 6..12 {
        map.update(&walls(step, &[pieces[0], pieces[1], far]))?;
        map.update(&CircleScan { world_from_lidar: &behind, sensor: 1, ..walls(step, &back) })?;
    }
    let ends: Vec<_> = map.shapes_at(0).iter().filter_map(|line| line.ends).collect();
    assert_eq!(ends.len(), 3, "{ends:?}");
    let short = line(0.5 * PI, 3.0, [0.0, 0.2]);
    assert_eq!(map.update(&walls(12, &[short]))?.lines, [None]);
    Ok(())
}

#[test]
fn what_lies_on_a_reported_line_is_known() -> Result<(), Error> {
    let mut map = map_of(ElementFilter::Independent(best()))?;
    let here = [[4.0, 0.0], [4.01, 0.1], [3.99, 0.2]];
    for step in 0..6 {
        assert_eq!(map.is_on_line(&here, 0.01, 1.0), step >= 2);
        map.update(&walls(step, &[line(0.0, 4.0, [-2.0, 2.0])]))?;
    }
    let before = here.map(|[x, y]| [x - 0.1, y]);
    let beside = here.map(|[x, y]| [x, y + 2.5]);
    assert!(!map.is_on_line(&before, 0.01, 1.0) && !map.is_on_line(&beside, 0.01, 1.0));
    assert!(!map.is_on_line(&here, 0.01, 5.0));
    Ok(())
}

#[test]
fn lines_and_circles_share_their_numbers_and_late_scans_change_nothing() -> Result<(), Error> {
    let lines = [line(0.0, 6.0, [-1.0, 1.0]), line(0.5 * PI, 4.0, [-1.0, 2.0])];
    let posts = [circle(3.0, 0.0, 0.3), circle(2.0, -2.0, 0.2)];
    let of = |order: &[i64]| -> Result<_, Error> {
        let mut map = map_of(ElementFilter::Independent(best()))?;
        for &step in order {
            map.update(&CircleScan { lines: &lines, ..scan(step, &posts) })?;
        }
        Ok((map.map_at(10 * STEP_NS), map.shapes_at(10 * STEP_NS)))
    };
    let usual = of(&[0, 1, 2, 3, 4, 5])?;
    assert_eq!(usual, of(&[0, 1, 2, 4, 5, 3])?);
    let mut numbers: Vec<i64> = usual.0.iter().map(|one| one.id).collect();
    numbers.extend(usual.1.iter().map(|one| one.id));
    numbers.sort_unstable();
    assert_eq!(numbers, [0, 1, 2, 3]);
    Ok(())
}

#[test]
fn lines_that_are_none_are_refused() -> Result<(), Error> {
    let mut map = map_of(ElementFilter::Independent(best()))?;
    map.update(&walls(0, &[line(0.0, 4.0, [-2.0, 2.0])]))?;
    let before = map.shapes_at(0);
    let good = line(0.0, 4.0, [-2.0, 2.0]);
    let bad = [
        ShapeEstimate { kind: ShapeKind::Ellipse, ..good },
        line(f64::NAN, 4.0, [-2.0, 2.0]),
        line(0.0, 4.0, [2.0, -2.0]),
        ShapeEstimate { covariance: [[0.0; 5]; 5], ..good },
    ];
    for one in bad {
        assert!(matches!(map.update(&walls(1, &[one])), Err(Error::Value { .. })));
        assert_eq!(map.shapes_at(0), before);
    }
    assert!(map.update(&walls(1, &[good])).is_ok());
    Ok(())
}

#[test]
fn a_wrong_yaw_turns_a_line_about_the_sensor() -> Result<(), Error> {
    let mut doubt = [[0.0; 6]; 6];
    doubt[5][5] = 1e-4;
    let mut rules = best();
    rules.lines.std = 0.0;
    let mut map = map_of(ElementFilter::Independent(rules))?;
    let lines = [line(0.0, 4.0, [1.0, 3.0])];
    map.update(&CircleScan { pose_covariance: Some(&doubt), ..walls(0, &lines) })?;
    let known = map.shapes_at(0)[0].state.covariance;
    assert!((known[(4, 4)] - 1.1e-4).abs() < 1e-9); // of the bearing
    assert!((known[(0, 0)] - (1e-5 + 4.0 * 1e-5 + 4.0 * 1e-4)).abs() < 1e-9); // 2 m along it
    assert!(known[(1, 1)].abs() < 1e-12);
    Ok(())
}

/// A rectangle of the level frame, and the circle that stands for it.
fn boxed(at: [f64; 2], sides: [f64; 2], heading: f64) -> (CircleEstimate, OutlineEstimate) {
    let mut covariance = [[0.0; 5]; 5];
    for (axis, row) in covariance.iter_mut().enumerate() {
        row[axis] = 1e-4;
    }
    let parameters = [at[0], at[1], sides[0], sides[1], heading];
    let kind = ShapeKind::Rectangle;
    let shape = ShapeEstimate { kind, parameters, covariance, misfit: 10.0, n_hits: 20 };
    let is_large = sides[0] > 1.0;
    (
        circle(at[0], at[1], 0.25 * (sides[0] + sides[1])),
        OutlineEstimate { shape, is_large, round: None },
    )
}

#[test]
fn a_box_is_a_circle_and_a_rectangle_with_one_number() -> Result<(), Error> {
    let mut map = map_of(ElementFilter::Independent(best()))?;
    for step in 0..20 {
        let x = 3.0 + 0.05 * step as f64; // 1 m/s
        let turned = if step % 2 == 0 { 0.3 } else { 0.3 - PI };
        let (body, outline) = boxed([x, 1.0], [0.6, 0.4], turned);
        let outlines = [Some(outline)];
        let stats = map.update(&CircleScan { outlines: &outlines, ..scan(step, &[body]) })?;
        assert_eq!(stats.elements, [0]);
    }
    let (round, shapes) = (map.map_at(19 * STEP_NS), map.shapes_at(19 * STEP_NS));
    assert_eq!((round.len(), shapes.len()), (1, 1));
    assert_eq!((round[0].id, shapes[0].id, shapes[0].kind), (0, 0, ShapeKind::Rectangle));
    let [x, y, vx, vy, heading, long, short] = shapes[0].state.mean.data.0[0];
    let apart = [x - 3.95, y - 1.0, vx - 1.0, vy, heading - 0.3, long - 0.3, short - 0.2];
    assert!(apart.iter().all(|apart| apart.abs() < 0.02), "{apart:?}");
    assert!(shapes[0].state.covariance.cholesky().is_some() && shapes[0].ends.is_none());
    let face = OutlineEstimate { shape: line(0.0, 3.0, [0.9, 1.1]), is_large: false, round: None };
    for step in 20..60 {
        let x = 3.0 + 0.05 * step as f64;
        let outlines = [(step < 40).then_some(face)]; // a face tells nothing, a circle does
        let bodies = [circle(x, 1.0, 0.25)];
        let stats = map.update(&CircleScan { outlines: &outlines, ..scan(step, &bodies) })?;
        assert_eq!(stats.elements, [0]);
        assert_eq!(map.shapes_at(step * STEP_NS).is_empty(), step >= 47, "{step}");
    }
    assert!(map.shapes_at(60 * STEP_NS).is_empty() && map.map_at(60 * STEP_NS)[0].id == 0);
    Ok(())
}

#[test]
fn how_deep_a_box_is_stays_unknown_and_a_post_becomes_known() -> Result<(), Error> {
    let shape = line(0.0, 3.0, [-0.2, 0.2]);
    let face = OutlineEstimate { shape, is_large: false, round: None };
    for (outlines, least, most) in [(&[Some(face)], 0.15, 0.25), (&[None], 0.0, 0.01)] {
        let mut map = map_of(ElementFilter::Independent(best()))?;
        for step in 0..60 {
            map.update(&CircleScan { outlines, ..scan(step, &[circle(3.0, 0.0, 0.2)]) })?;
        }
        // Seen from the origin, so along x.
        let covariance = map.map_at(59 * STEP_NS)[0].state.covariance;
        let [deep, wide] = [0, 1].map(|axis| covariance[(axis, axis)].sqrt());
        assert!((least..most).contains(&deep) && wide < 0.5 * deep + 0.01, "{deep} {wide}");
    }
    Ok(())
}

#[test]
fn a_circle_that_one_scan_takes_for_something_else_is_followed() -> Result<(), Error> {
    let mut map = map_of(ElementFilter::Independent(best()))?;
    let (mut vague, outline) = boxed([5.3, 0.0], [0.6, 0.4], 0.1);
    for (row, diagonal) in vague.covariance.iter_mut().enumerate() {
        diagonal[row] = 0.04;
    }
    let outline = OutlineEstimate { round: Some(circle(5.1, 0.0, 0.25)), ..outline };
    for step in 0..11 {
        let bodies = [if step < 10 { circle(5.0, 0.0, 0.25) } else { vague }];
        let outlines = [(step == 10).then_some(outline)];
        map.update(&CircleScan { outlines: &outlines, ..scan(step, &bodies) })?;
    }
    let x = map.map_at(10 * STEP_NS)[0].state.mean[0];
    assert!((x - 5.1).abs() < 0.02, "{x}");
    Ok(())
}

#[test]
fn what_is_large_is_no_circle_and_takes_in_nothing_small() -> Result<(), Error> {
    let mut map = map_of(ElementFilter::Independent(best()))?;
    for step in 0..10 {
        let (body, outline) = boxed([5.0, 0.0], [4.0, 1.8], 0.1);
        let (bodies, outlines) = ([body, circle(5.0, 0.3, 0.2)], [Some(outline), None]);
        map.update(&CircleScan { outlines: &outlines, ..scan(step, &bodies) })?;
    }
    let (round, shapes) = (map.map_at(9 * STEP_NS), map.shapes_at(9 * STEP_NS));
    assert_eq!((round.len(), shapes.len()), (1, 1));
    assert!((round[0].state.mean[4] - 0.2).abs() < 0.01 && round[0].id != shapes[0].id);
    assert!((shapes[0].state.mean[5] - 2.0).abs() < 0.01);
    Ok(())
}

#[test]
fn outlines_that_are_none_are_refused() -> Result<(), Error> {
    let mut map = map_of(ElementFilter::Independent(best()))?;
    let (body, good) = boxed([5.0, 0.0], [0.6, 0.4], 0.1);
    let bodies = [body];
    let mut round = good;
    round.shape.kind = ShapeKind::Circle;
    let mut flat = good;
    flat.shape.parameters[3] = 0.0;
    let mut vague = good;
    vague.shape.covariance[4][4] = f64::NAN;
    for bad in [round, flat, vague] {
        let one = CircleScan { outlines: &[Some(bad)], ..scan(0, &bodies) };
        assert!(matches!(map.update(&one), Err(Error::Value { .. })));
    }
    let two = [Some(good), None];
    let lengths = CircleScan { outlines: &two, ..scan(0, &bodies) };
    assert!(matches!(map.update(&lengths), Err(Error::Length { .. })));
    assert!(map.map_at(0).is_empty());
    Ok(())
}
