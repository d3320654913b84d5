use super::*;
use crate::circles::segment::segments::Side;

fn shape_of(ranges: impl Fn(f64) -> f64, half: i32) -> Result<ShapeEstimate, Error> {
    shape_beside(ranges, half, [Side::Free; 2])
}

/// Shape of an arc of `half` rays on both sides of its middle, with this beside it.
fn shape_beside(
    ranges: impl Fn(f64) -> f64,
    half: i32,
    sides: [Side; 2],
) -> Result<ShapeEstimate, Error> {
    let bearings: Vec<f64> =
        (-120..=120).map(|step| f64::from(step) * 0.25_f64.to_radians()).collect();
    let seen = |step: usize| (120 - half as usize..=120 + half as usize).contains(&step);
    let range = |(step, &bearing): (usize, &f64)| {
        if seen(step) { ranges(bearing) } else { f64::INFINITY }
    };
    let scan = PolarScan { ranges: bearings.iter().enumerate().map(range).collect(), bearings };
    let rays: Vec<u32> = (120 - half as u32..=120 + half as u32).collect();
    let (starts, sides) = (vec![0, rays.len()], vec![sides]);
    let segments = Segments { labels: vec![], rays, starts, sides };
    let mut shapes = Vec::new();
    ShapeFitter::new(FitParameters::default())?.fit(&scan, &segments, &mut shapes)?;
    Ok(shapes[0])
}

#[test]
fn a_wall_is_a_line_with_its_ends() -> Result<(), Error> {
    let found = shape_of(|bearing| 3.0 / libm::cos(bearing), 40)?;
    assert_eq!((found.kind, found.circle()), (ShapeKind::Line, None));
    let ends = found.ends().unwrap_or_default();
    let expected = 3.0 * libm::tan(40.5 * 0.25_f64.to_radians());
    for (end, sign) in ends.iter().zip([-1.0, 1.0]) {
        assert!((end[0] - 3.0).abs() < 1e-4 && (end[1] - sign * expected).abs() < 1e-3, "{ends:?}");
    }
    assert!(found.covariance[2][2] > 1e-6 && found.covariance[3][3] > 1e-6, "{found:?}");
    Ok(())
}

#[test]
fn a_corner_is_a_rectangle() -> Result<(), Error> {
    // Its corner at (3, 0), its faces at 45 degrees behind it.
    let found = shape_of(|bearing| 3.0 / (libm::cos(bearing) - libm::sin(bearing).abs()), 20)?;
    assert_eq!(found.kind, ShapeKind::Rectangle, "{found:?}");
    let [x, y, length, width, _] = found.parameters;
    assert!((length - width).abs() < 1e-3 && y.abs() < 1e-3, "{found:?}");
    assert!((x - 3.0 - length * 0.5_f64.sqrt()).abs() < 1e-3, "{found:?}");
    Ok(())
}

#[test]
fn an_ellipse_keeps_its_axes() -> Result<(), Error> {
    // Centre (3, 0), semi-axes 0.2 towards the sensor and 0.5 across.
    let range = |bearing: f64| {
        let (x, y) = (libm::cos(bearing) / 0.2, libm::sin(bearing) / 0.5);
        let (a, b, c) = (x * x + y * y, x * 15.0, 224.0);
        (b - (b * b - a * c).max(0.0).sqrt()) / a
    };
    let found = shape_of(range, 38)?;
    let [x, y, long, short, heading] = found.parameters;
    assert_eq!(found.kind, ShapeKind::Ellipse);
    assert!((x - 3.0).abs() < 0.01 && y.abs() < 0.01, "{found:?}");
    assert!((long - 0.5).abs() < 0.02 && (short - 0.2).abs() < 0.02, "{found:?}");
    assert!((heading.abs() - std::f64::consts::FRAC_PI_2).abs() < 0.05, "{found:?}");
    Ok(())
}

/// Ranges to a circle ahead, 3 m from the scanner, and the number of rays on each half of it.
fn ahead(radius: f64) -> (impl Fn(f64) -> f64, i32) {
    let away = 3.0 + radius;
    let range = move |bearing: f64| {
        let across = away * libm::sin(bearing);
        away * libm::cos(bearing) - (radius * radius - across * across).max(0.0).sqrt()
    };
    let half = libm::asin(radius / away) / 0.25_f64.to_radians();
    (range, libm::floor(half) as i32)
}

#[test]
fn a_large_circle_is_one_where_both_its_sides_are_seen() -> Result<(), Error> {
    for radius in [0.9, 1.0, 1.1, 1.7, 2.5] {
        let (range, half) = ahead(radius);
        let found = shape_of(&range, half)?;
        let [x, y, r, ..] = found.parameters;
        assert_eq!(found.kind, ShapeKind::Circle, "{found:?}");
        assert!(libm::hypot(x - 3.0 - radius, y) < 0.01 && (r - radius).abs() < 0.01, "{found:?}");
        assert!(found.covariance[0][0].sqrt() < 0.03, "{found:?}");
    }
    // Of its middle part nobody knows if it is a wall that is a little bent.
    let (range, half) = ahead(1.7);
    for sides in [[Side::Occluded; 2], [Side::Free, Side::Occluded], [Side::FieldEdge; 2]] {
        let found = shape_beside(&range, half / 3, sides)?;
        assert!(found.circle().is_none_or(|circle| circle.radius <= 1.0), "{found:?}");
    }
    Ok(())
}

#[test]
fn of_a_large_circle_one_side_is_enough_if_the_arc_tells_its_radius() -> Result<(), Error> {
    let (range, half) = ahead(1.7);
    // Its left 0.7, and no more of it than to its middle.
    for (cut, is_known) in [(0.4, true), (-0.8, false)] {
        let last = (cut * f64::from(half)) as i32;
        let bearings: Vec<f64> =
            (-120..=last).map(|step| f64::from(step) * 0.25_f64.to_radians()).collect();
        let seen = (120 - half) as usize..bearings.len();
        let at = |(step, &bearing): (usize, &f64)| {
            if seen.contains(&step) { range(bearing) } else { f64::INFINITY }
        };
        let rays: Vec<u32> = seen.clone().map(|ray| ray as u32).collect();
        let scan = PolarScan { ranges: bearings.iter().enumerate().map(at).collect(), bearings };
        let (starts, sides) = (vec![0, rays.len()], vec![[Side::Free, Side::FieldEdge]]);
        let segments = Segments { labels: vec![], rays, starts, sides };
        let mut shapes = Vec::new();
        ShapeFitter::new(FitParameters::default())?.fit(&scan, &segments, &mut shapes)?;
        let radius = shapes[0].circle().map_or(0.0, |circle| circle.radius);
        assert_eq!((radius - 1.7).abs() < 0.05, is_known, "{:?}", shapes[0]);
    }
    Ok(())
}

#[test]
fn a_free_standing_wall_is_no_large_circle_even_if_it_is_bent() -> Result<(), Error> {
    for (half, bulge) in [(20, 0.0), (60, 0.0), (100, 0.0), (60, 0.05), (100, 0.1), (60, 0.16)] {
        // An arc of less than 0.9 rad, not one from tangent to tangent.
        let wall = |bearing: f64| {
            let middle = libm::cos(360.0 * bearing / f64::from(half));
            3.0 / libm::cos(bearing) - bulge * middle
        };
        let found = shape_of(wall, half)?;
        assert!(found.circle().is_none_or(|circle| circle.radius <= 1.0), "{half}: {found:?}");
    }
    Ok(())
}
