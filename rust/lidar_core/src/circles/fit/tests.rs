use super::*;
use crate::circles::segment::segments::Side;

fn parameters(method: FitMethod) -> FitParameters {
    FitParameters { method, range_std: 1e-4, ..FitParameters::default() }
}

/// A circle at (4, 0) with a radius of 0.3 m in front of empty space, one ray every 0.25 degrees.
fn scan() -> PolarScan {
    let bearings: Vec<f64> =
        (-40..=40).map(|step| f64::from(step) * 0.25_f64.to_radians()).collect();
    let range = |&bearing: &f64| {
        let (sine, cosine) = (libm::sin(bearing), libm::cos(bearing));
        let square = 0.09 - 16.0 * sine * sine;
        if square >= 0.0 { 4.0 * cosine - square.sqrt() } else { f64::INFINITY }
    };
    PolarScan { ranges: bearings.iter().map(range).collect(), bearings }
}

/// The hits of `scan` from one ray to another as a segment.
fn segment(rays: std::ops::Range<u32>, sides: [Side; 2]) -> Segments {
    let rays: Vec<u32> = rays.collect();
    Segments { labels: vec![], starts: vec![0, rays.len()], rays, sides: vec![sides] }
}

#[test]
fn every_method_finds_a_circle() -> Result<(), Error> {
    let methods = [
        FitMethod::Kasa,
        FitMethod::Pratt,
        FitMethod::Taubin,
        FitMethod::Expected,
        FitMethod::MostLikely,
    ];
    let mut circles = Vec::new();
    for method in methods {
        let hits = segment(23..58, [Side::Free; 2]);
        Fitter::new(parameters(method))?.fit(&scan(), &hits, &mut circles)?;
        let found = circles[0];
        assert!((found.circle.center[0] - 4.0).abs() < 1e-4, "{method:?}: {found:?}");
        assert!(found.circle.center[1].abs() < 1e-4, "{method:?}: {found:?}");
        assert!((found.circle.radius - 0.3).abs() < 1e-4, "{method:?}: {found:?}");
        assert_eq!(found.n_hits, 35);
    }
    Ok(())
}

#[test]
fn what_an_occluder_leaves_open_is_bounded_behind_it() -> Result<(), Error> {
    let mut scan = scan();
    for range in &mut scan.ranges[20..40] {
        *range = 2.0; // something nearer
    }
    let mut fitter =
        Fitter::new(FitParameters { range_std: 0.01, ..parameters(FitMethod::Expected) })?;
    let mut circles = Vec::new();
    let half = segment(40..58, [Side::Occluded, Side::Free]);
    fitter.fit(&scan, &half, &mut circles)?;
    let bounded = circles[0];
    for range in &mut scan.ranges[..20] {
        *range = f64::NAN; // no rays pass on the far side of the occluder
    }
    fitter.fit(&scan, &half, &mut circles)?;
    assert!(bounded.covariance[2][2] < circles[0].covariance[2][2]);
    assert!((bounded.circle.radius - 0.3).abs() < 0.05, "{bounded:?}");
    Ok(())
}

#[test]
fn a_circle_held_by_the_largest_radius_is_uncertain_by_what_is_beyond() -> Result<(), Error> {
    let methods = [
        FitMethod::Kasa,
        FitMethod::Pratt,
        FitMethod::Taubin,
        FitMethod::Expected,
        FitMethod::MostLikely,
    ];
    for method in methods {
        let held = FitParameters { radius: [0.02, 0.25], range_std: 0.01, ..parameters(method) };
        let mut circles = Vec::new();
        let hits = segment(23..58, [Side::Free; 2]);
        Fitter::new(held)?.fit(&scan(), &hits, &mut circles)?;
        let CircleEstimate { circle, covariance, .. } = circles[0];
        assert!(circle.radius <= 0.251, "{method:?}: {circle:?}");
        assert!(covariance[2][2] > 0.04 * 0.04, "{method:?}: {covariance:?}");
        assert!(covariance[0][0] > 0.03 * 0.03, "{method:?}: {covariance:?}");
    }
    Ok(())
}

#[test]
fn two_hits_tell_no_radius_where_something_hides_the_rest() -> Result<(), Error> {
    let mut circles = Vec::new();
    for (sides, least, most) in [([Side::Occluded; 2], 0.15, 0.5), ([Side::Free; 2], 0.0, 0.02)] {
        let two = segment(40..42, sides);
        let mut scan = scan();
        for (ray, range) in scan.ranges.iter_mut().enumerate() {
            *range = match sides[0] {
                _ if (40..42).contains(&ray) => *range,
                Side::Occluded => f64::NAN,
                _ => f64::INFINITY,
            };
        }
        let known = FitParameters { range_std: 0.01, ..parameters(FitMethod::Expected) };
        Fitter::new(known)?.fit(&scan, &two, &mut circles)?;
        let std = circles[0].covariance[2][2].sqrt();
        assert!((least..most).contains(&std), "{circles:?}");
        assert!(!circles[0].is_fallback);
    }
    Ok(())
}

#[test]
fn an_empty_segment_is_refused() -> Result<(), Error> {
    let mut fitter = Fitter::new(parameters(FitMethod::Expected))?;
    let mut circles = Vec::new();
    let none = segment(0..0, [Side::Free; 2]);
    assert!(matches!(fitter.fit(&scan(), &none, &mut circles), Err(Error::Value { .. })));
    let misses = segment(0..5, [Side::Free; 2]);
    assert!(matches!(fitter.fit(&scan(), &misses, &mut circles), Err(Error::Value { .. })));
    Ok(())
}

#[test]
fn parameters_outside_their_range_are_refused() {
    let good = parameters(FitMethod::Kasa);
    for bad in [
        FitParameters { range_std: 0.0, ..good },
        FitParameters { beam_half_width: -0.1, ..good },
        FitParameters { radius: [1.0, 0.5], ..good },
        FitParameters { usual_radius: f64::NAN, ..good },
        FitParameters { range_limits: [5.0, 1.0], ..good },
    ] {
        assert!(matches!(Fitter::new(bad), Err(Error::Parameter { .. })));
    }
}
