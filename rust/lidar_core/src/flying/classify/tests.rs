//! Tests of the classification of whole scans.

use super::scan_classifier::{ScanClassifier, ScanToClassify};
use crate::Error;
use crate::flying::map::local_map::LocalMap;
use crate::flying::parameters::FlyingParameters;
use crate::flying::point_class::PointClass;
use crate::flying::scan::prepared::Prepared;
use crate::util::stopwatch::Clock;

/// Number of points of one part of an object: 0.6 m long, 8 m to the side of the sensor.
const OF_PART: usize = 16;

fn part(start: f32) -> impl Iterator<Item = [f32; 3]> {
    let step = |number: usize| 0.2 * number as f32;
    (0..OF_PART).map(move |at| [start + step(at % 4), 8.0, 1.0 + step(at / 4)])
}

/// Number of points of each unknown object in a scan of parts that begin at `starts` [m], in a map
/// without any information.
fn unknown_things(starts: &[f32]) -> Result<Vec<usize>, Error> {
    let parameters = FlyingParameters::default();
    let mut scan = Prepared::default();
    scan.points = starts.iter().flat_map(|&start| part(start)).collect();
    scan.unknown = vec![PointClass::Unknown; scan.points.len()];
    let local = LocalMap::new(&parameters.map)?;
    let input = ScanToClassify {
        scan: &scan,
        local: &local,
        background_extent: None,
        parameters: &parameters,
        expected: &[],
        in_air: &[],
        pool: None,
    };
    let mut classifier = ScanClassifier::default();
    classifier.classify(&input, &mut Clock::start())?;
    assert!(classifier.class().iter().all(|&class| class == PointClass::Unknown));
    Ok(classifier.unknown_things(&input).iter().map(|rows| rows.len()).collect())
}

#[test]
fn a_fragment_of_a_large_group_is_no_unknown_thing() -> Result<(), Error> {
    assert_eq!(unknown_things(&[0.0])?, [OF_PART]);
    // Parts 0.6 m apart are fragments of one thing of 1.8 m, or of one of 4.2 m: no target is that large.
    assert_eq!(unknown_things(&[0.0, 1.2])?, [OF_PART; 2]);
    assert_eq!(unknown_things(&[0.0, 1.2, 2.4, 3.6])?, [0; 0]);
    // Further apart they are four things.
    assert_eq!(unknown_things(&[0.0, 2.0, 4.0, 6.0])?, [OF_PART; 4]);
    Ok(())
}
