use super::*;
use crate::circles::segment::segments::Side;

fn shape_of(ranges: impl Fn(f64) -> f64, half: i32) -> Result<ShapeEstimate, Error> {
    let bearings: Vec<f64> =
        (-120..=120).map(|step| f64::from(step) * 0.25_f64.to_radians()).collect();
    let seen = |step: usize| (120 - half as usize..=120 + half as usize).contains(&step);
    let range = |(step, &bearing): (usize, &f64)| {
        if seen(step) { ranges(bearing) } else { f64::INFINITY }
    };
    let scan = PolarScan { ranges: bearings.iter().enumerate().map(range).collect(), bearings };
    let rays: Vec<u32> = (120 - half as u32..=120 + half as u32).collect();
    let (starts, sides) = (vec![0, rays.len()], vec![[Side::Free; 2]]);
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
