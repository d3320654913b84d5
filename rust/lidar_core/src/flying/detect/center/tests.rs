//! Tests of the centres of balls and frames that a regular fan of rays meets.

use crate::Error;
use crate::flying::detect::center::*;

const STD: f64 = 0.03;
/// Angle between neighbouring rays [rad].
const STEP: f64 = 0.0062;

/// Rays from the origin around the x axis. The function gives the range at which a ray returns, if
/// it does.
struct Fan<F>(F);

impl<F: Fn(Vector3<f64>) -> Option<f64>> Fan<F> {
    fn rows(&self) -> Vec<Vector3<f64>> {
        let angle = |index: i32| f64::from(index) * STEP;
        (-40..=40)
            .flat_map(|row| (-40..=40).map(move |column| (row, column)))
            .map(|(row, column)| Vector3::new(1.0, angle(column), angle(row)).normalize())
            .collect()
    }

    fn observation(&self) -> TargetObservation {
        let hits: Vec<u32> = (0_u32..)
            .zip(self.rows())
            .filter(|(_, way)| (self.0)(*way).is_some())
            .map(|(row, _)| row)
            .collect();
        self.observations(&[&hits]).remove(0)
    }
}

impl<F: Fn(Vector3<f64>) -> Option<f64>> RaySource for Fan<F> {
    fn hit(&self, row: usize) -> TargetHit {
        let way = self.rows()[row];
        TargetHit::new([0.0; 3], (way * (self.0)(way).unwrap_or(f64::NAN)).into())
    }

    fn around(&self, regions: &[TargetRegion]) -> Vec<PassingRays> {
        let past = |way: &Vector3<f64>| (self.0)(*way).is_none();
        let ray = |direction| TargetRay { origin: Vector3::zeros(), direction };
        let near = |region: &TargetRegion| {
            let rays = self.rows().into_iter().filter(past).map(ray);
            let is_near = |ray: &TargetRay| ray.aside(&region.middle).norm() <= region.reach();
            PassingRays { passing: rays.filter(is_near).collect(), ..PassingRays::default() }
        };
        regions.iter().map(near).collect()
    }
}

fn ball(center: Vector3<f64>, radius: f64) -> impl Fn(Vector3<f64>) -> Option<f64> {
    move |way| {
        let along = way.dot(&center);
        let inside = radius * radius - (center - way * along).norm_squared();
        (inside >= 0.0).then(|| along - inside.sqrt())
    }
}

#[test]
fn the_centre_of_a_ball_is_found_whatever_its_radius() {
    for (distance, radius) in [(6.0, 0.15), (6.0, 0.6), (14.0, 0.3), (19.0, 0.6)] {
        let place = Vector3::new(distance, 0.013, -0.021);
        let observation = Fan(ball(place, radius)).observation();
        let center = Center::of(&observation, STD);
        assert!((center.position - place).norm() < 0.01, "{center:?}");
        assert!((center.radius - radius).abs() < 0.01, "{center:?}");
    }
}

#[test]
fn few_points_leave_the_radius_to_the_passing_rays() {
    let place = Vector3::new(17.0, 0.05, 0.05);
    let observation = Fan(ball(place, 0.16)).observation();
    assert!(observation.hits.len() <= 6);
    let center = Center::of(&observation, STD);
    let offset = center.position - place;
    assert!(offset.norm() < 0.1);
    let scaled = center.covariance.cholesky().map(|factor| factor.solve(&offset).dot(&offset));
    assert!(scaled.is_some_and(|nees| nees < 11.3), "{scaled:?}"); // chi-square, 3 degrees, 0.99
}

#[test]
fn rays_through_a_target_make_it_a_frame() {
    let place = Vector3::new(8.0, 0.0, 0.0);
    // bars: every third row of rays, on a disc across the line of sight
    let bars = move |way: Vector3<f64>| {
        let at = way * (place.x / way.x);
        let row = (way.z / way.x / STEP).round().rem_euclid(3.0);
        ((at - place).norm() < 0.4 && row == 0.0).then(|| at.norm())
    };
    let observation = Fan(bars).observation();
    let frame = OpenFrame::of(&observation, STD);
    assert!(frame.solid_share < 0.4, "{}", frame.solid_share);
    let shift = Center::of(&observation, STD).position.x - place.x;
    assert!((0.05..0.15).contains(&shift), "{shift}"); // a ball of its width: 0.27
}

#[test]
fn a_wide_target_seen_from_below_is_in_the_middle_of_its_box() {
    // A disc of 0.7 m radius with a load below it, whose front is all that is seen of that.
    let seen = |way: Vector3<f64>| {
        let load = way * (6.8 / way.x);
        if load.y.abs() < 0.2 && (0.65..0.95).contains(&load.z) {
            return Some(load.norm());
        }
        let disc = way * (1.0 / way.z);
        let is_hit = way.z > 0.0 && (disc - Vector3::new(7.0, 0.0, 1.0)).norm() < 0.7;
        is_hit.then(|| disc.norm())
    };
    let offset = Center::of(&Fan(seen).observation(), STD).position - Vector3::new(7.0, 0.0, 0.825);
    assert!(offset.x.abs() < 0.1 && offset.y.abs() < 0.02 && offset.z.abs() < 0.03, "{offset}");
}

#[test]
fn the_order_of_rays_does_not_matter() {
    let fan = Fan(ball(Vector3::new(9.0, 0.1, 0.2), 0.35));
    let observation = fan.observation();
    let mut hits = observation.hits.clone();
    hits.reverse();
    let mut passing = observation.passing.clone();
    passing.reverse();
    assert_eq!(
        Center::of(
            &TargetObservation::new(hits, PassingRays { passing, ..PassingRays::default() }),
            STD
        ),
        Center::of(&observation, STD)
    );
}

#[test]
fn one_point_without_any_other_ray_is_a_place() -> Result<(), Error> {
    let hits = vec![TargetHit::new([0.0; 3], [5.0, 0.0, 0.0])];
    let center = Center::of(&TargetObservation::new(hits, PassingRays::default()), STD);
    assert!(center.position.iter().all(|value| value.is_finite()));
    assert!((center.position.x - 5.0).abs() < 0.7 && center.position.y.abs() < 0.01);
    let factor = center.covariance.cholesky();
    factor.map(|_| ()).ok_or(Error::NotPositiveDefinite { matrix: "covariance" })
}

/// Whether a ball 8 m away counts as being at an edge. `is_hidden`: whether a ray that crosses the
/// plane through its centre at a place [m] ends in front of it.
fn is_at_edge(is_hidden: impl Fn(f64, f64) -> bool) -> bool {
    let observation = Fan(ball(Vector3::new(8.0, 0.0, 0.0), 0.2)).observation();
    let hides = |ray: &TargetRay| {
        let at = ray.direction * (8.0 / ray.direction.x);
        is_hidden(at.y, at.z)
    };
    let (hiding, passing): (Vec<_>, Vec<_>) =
        observation.passing.iter().partition(|ray| hides(ray));
    let around = PassingRays { n_blocked: hiding.len(), hiding, passing, ..PassingRays::default() };
    TargetObservation::new(observation.hits, around).is_at_edge
}

#[test]
fn a_target_ends_at_an_edge_where_the_next_rays_beside_it_end_in_front() {
    assert!(is_at_edge(|_, up| up > 0.15));
    assert!(is_at_edge(|left, _| left < -0.15));
    // The opposites: nothing in front, something further aside, the ground below, or a speck of dust.
    assert!(!is_at_edge(|_, _| false));
    assert!(!is_at_edge(|_, up| up > 0.3));
    assert!(!is_at_edge(|_, up| up < -0.2));
    let speck = |left: f64, up: f64| left.abs() < 0.02 && (0.23..0.26).contains(&up);
    assert!(!is_at_edge(speck));
    assert!(!is_at_edge(|left, up| up < -0.2 || speck(left, up)));
}
