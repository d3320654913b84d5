//! Random smooth motions without collisions.

use crate::parry::{BoundingBox, CastRay};
use crate::random::{Purpose, Stream};
use crate::refused;
use crate::scene::{Scene, inverse};
use crate::trajectory::Trajectory;
use lidar_core::Error;
use lidar_core::geometry::transform::{Transform, dot, minus, norm};
use lidar_core::util::cancel;

/// Time between control points [s].
const STEP: f64 = 0.5;
/// Number of checked places between two control points.
const SAMPLES: usize = 10;
/// Number of stamps between two control points.
const KNOTS: usize = 25;
/// Proposals for one control point; those of the first half must be in the sensor's view.
const PROPOSALS: usize = 32;
/// Largest number of starts that are tried.
const STARTS: usize = 4096;
/// Largest number of walks that are tried, each from a start that is free.
const WALKS: usize = 64;
/// Largest number of proposals per control point of a walk.
const EFFORT: usize = 64;

/// Condition to stay in the view of a sensor.
#[derive(Clone, Copy, Debug)]
pub struct Near<'a> {
    /// Trajectory of the sensor.
    pub sensor: &'a Trajectory,
    /// Least and greatest distance from the sensor [m].
    pub distance: [f64; 2],
    /// Least and greatest elevation in the frame of the sensor [rad].
    pub elevation: [f64; 2],
}

/// Conditions for a random motion.
#[derive(Clone, Debug)]
pub struct RandomMotion<'a> {
    /// Box that contains the centre [m].
    pub bounds: BoundingBox,
    /// Greatest speed [m/s].
    pub speed_max: f64,
    /// Greatest acceleration [m/s2].
    pub acceleration_max: f64,
    /// Least distance of the centre from every body at rest [m].
    pub clearance: f64,
    /// Trajectories of moving objects, each with the least distance of the centre from it [m].
    pub apart: Vec<(&'a Trajectory, f64)>,
    /// View in which the motion stays, preferably not hidden; None: anywhere in the box.
    pub near: Option<Near<'a>>,
    /// Start and end [ns].
    pub span_ns: (i64, i64),
    /// Seed and stream of the random numbers.
    pub seed: (u64, u64),
}

impl RandomMotion<'_> {
    /// Random motion through `scene`.
    ///
    /// The curve is a uniform cubic B-spline: it stays in the convex hull of its control points,
    /// and its derivatives stay in the convex hulls of the differences of these points. Limits of
    /// the points and their differences are therefore limits of the curve.
    ///
    /// # Errors
    /// [`Error::Parameter`] if a value is out of range, or no free path was found in the box,
    /// [`Error::Interrupted`].
    pub fn trajectory(&self, scene: &Scene) -> Result<Trajectory, Error> {
        self.check()?;
        let seconds = self.span_ns.1.abs_diff(self.span_ns.0) as f64 * 1e-9;
        let points = (seconds / STEP).ceil() as usize + 3;
        let mut numbers = Stream::new(self.seed.0, Purpose::Motion, self.seed.1);
        let mut walks = 0;
        for attempt in 0..STARTS {
            cancel::check()?;
            let in_view = attempt < STARTS / 2;
            let Some(start) = self.start(scene, &mut numbers, in_view) else { continue };
            if let Some(found) = self.walk(scene, &mut numbers, start, points) {
                return self.curve(&found);
            }
            walks += 1;
            if walks == WALKS {
                break;
            }
        }
        let expected = "a box with room for a motion that keeps clear of everything";
        Err(refused("bounds", expected, &self.bounds))
    }

    fn check(&self) -> Result<(), Error> {
        for (name, value) in
            [("speed_max", self.speed_max), ("acceleration_max", self.acceleration_max)]
        {
            if !(value.is_finite() && value > 0.0) {
                return Err(refused(name, "finite and > 0", &value));
            }
        }
        if !(self.clearance.is_finite() && self.clearance >= 0.0) {
            return Err(refused("clearance", "finite and >= 0", &self.clearance));
        }
        let sides = || (0..3).map(|axis| self.bounds.max[axis] - self.bounds.min[axis]);
        if !sides().all(|side| side.is_finite() && side >= 0.0) {
            return Err(refused("bounds", "finite, min <= max", &self.bounds));
        }
        let seconds = self.span_ns.1.abs_diff(self.span_ns.0) / 1_000_000_000;
        if self.span_ns.0 >= self.span_ns.1 || seconds > 86_400 {
            return Err(refused("span_ns", "start < end, at most a day", &self.span_ns));
        }
        Ok(())
    }

    /// Three control points on a line, a motion at constant velocity; None if they are not free.
    fn start(&self, scene: &Scene, numbers: &mut Stream, in_view: bool) -> Option<Vec<[f64; 3]>> {
        let share = numbers.uniforms();
        let BoundingBox { min, max } = self.bounds;
        let first = std::array::from_fn(|axis| min[axis] + share[axis] * (max[axis] - min[axis]));
        let step = numbers.direction().map(|part| part * share[3] * self.speed_max * STEP);
        let points = vec![first, sum(first, step), sum(first, sum(step, step))];
        let seconds = self.span_ns.0 as f64 * 1e-9;
        let free = points.iter().all(|&point| self.holds(point))
            && self.is_free(scene, points[1], seconds)
            && (!in_view || self.is_in_view(scene, points[1], seconds));
        free.then_some(points)
    }

    /// Append control points up to `needed`; step back if there is no free proposal. None after too
    /// many proposals.
    fn walk(
        &self,
        scene: &Scene,
        numbers: &mut Stream,
        mut points: Vec<[f64; 3]>,
        needed: usize,
    ) -> Option<Vec<[f64; 3]>> {
        let mut tries = 0;
        let watch = cancel::watch();
        for _ in 0..EFFORT * needed {
            if watch.is_asked() {
                return None;
            }
            if points.len() == needed {
                return Some(points);
            }
            points.push(self.proposal(numbers, &points, tries));
            if self.last_piece_is_good(scene, &points, tries < PROPOSALS / 2) {
                tries = 0;
                continue;
            }
            points.pop();
            tries += 1;
            if tries == PROPOSALS {
                points.truncate(points.len().saturating_sub(3).max(3));
                tries = 0;
            }
        }
        None
    }

    fn proposal(&self, numbers: &mut Stream, points: &[[f64; 3]], tries: usize) -> [f64; 3] {
        let last = points[points.len() - 1];
        let velocity = minus(last, points[points.len() - 2]).map(|way| way / STEP);
        let [wish, effort, ..] = numbers.uniforms();
        let speed = self.speed_max * (0.3 + 0.7 * effort);
        let straight_on = tries == 0 && wish < 0.7 && norm(velocity) > 0.1 * self.speed_max;
        let wanted = if straight_on {
            velocity.map(|part| part * speed / norm(velocity))
        } else {
            numbers.direction().map(|part| part * speed)
        };
        let change = limited(minus(wanted, velocity), self.acceleration_max * STEP);
        let next = limited(sum(velocity, change), self.speed_max);
        sum(last, next.map(|part| part * STEP))
    }

    fn last_piece_is_good(&self, scene: &Scene, points: &[[f64; 3]], in_view: bool) -> bool {
        let piece = points.len() - 4;
        let four = [points[piece], points[piece + 1], points[piece + 2], points[piece + 3]];
        if !self.holds(four[3]) {
            return false;
        }
        (0..=SAMPLES).all(|sample| {
            let share = sample as f64 / SAMPLES as f64;
            let place = spline(&four, share);
            let seconds = self.span_ns.0 as f64 * 1e-9 + (piece as f64 + share) * STEP;
            self.is_free(scene, place, seconds)
                && (!in_view || self.is_in_view(scene, place, seconds))
        })
    }

    fn holds(&self, point: [f64; 3]) -> bool {
        let BoundingBox { min, max } = self.bounds;
        (0..3).all(|axis| (min[axis]..=max[axis]).contains(&point[axis]))
    }

    /// True if the place is far enough from all bodies and moving objects, also half way to the
    /// next sample.
    fn is_free(&self, scene: &Scene, place: [f64; 3], seconds: f64) -> bool {
        let stamp_ns = (seconds * 1e9) as i64;
        let between = 0.5 * self.speed_max * STEP / SAMPLES as f64;
        let clearance = self.clearance + between;
        let distance_from =
            |other: &Trajectory| norm(minus(other.pose_at(stamp_ns).translation, place));
        scene.clearance(place, clearance + 1.0) >= clearance
            && self.apart.iter().all(|(other, least)| distance_from(other) >= least + between)
            && self.near.is_none_or(|near| near.holds(place, stamp_ns))
    }

    fn is_in_view(&self, scene: &Scene, place: [f64; 3], seconds: f64) -> bool {
        self.near.is_none_or(|near| {
            let origin = near.sensor.pose_at((seconds * 1e9) as i64).translation;
            let way = minus(place, origin);
            let length = norm(way);
            let ray = CastRay { origin, direction: way.map(|part| part / length) };
            length > 0.0 && scene.meet(&ray, length, 0.0).is_none()
        })
    }

    fn curve(&self, points: &[[f64; 3]]) -> Result<Trajectory, Error> {
        let (mut stamps_ns, mut poses) = (Vec::new(), Vec::new());
        let count = (points.len() - 3) * KNOTS;
        let spacing_ns = (STEP * 1e9) as i64 / KNOTS as i64;
        for knot in 0..=count {
            let piece = (knot / KNOTS).min(points.len() - 4);
            let share = (knot - piece * KNOTS) as f64 / KNOTS as f64;
            let four = [points[piece], points[piece + 1], points[piece + 2], points[piece + 3]];
            stamps_ns.push(self.span_ns.0.saturating_add(knot as i64 * spacing_ns));
            poses.push(Transform { translation: spline(&four, share), ..Transform::IDENTITY });
        }
        Trajectory::new(stamps_ns, poses)
    }
}

impl Near<'_> {
    fn holds(&self, place: [f64; 3], stamp_ns: i64) -> bool {
        let local = inverse(&self.sensor.pose_at(stamp_ns)).apply(place);
        let elevation = libm::atan2(local[2], libm::hypot(local[0], local[1]));
        let within = |value: f64, [least, greatest]: [f64; 2]| least <= value && value <= greatest;
        within(norm(local), self.distance) && within(elevation, self.elevation)
    }
}

/// Point of a uniform cubic B-spline at `share` (0..1) of the piece of four control points.
fn spline(points: &[[f64; 3]; 4], share: f64) -> [f64; 3] {
    let (rest, square) = (1.0 - share, share * share);
    let weights = [
        rest * rest * rest,
        3.0 * square * share - 6.0 * square + 4.0,
        -3.0 * square * share + 3.0 * square + 3.0 * share + 1.0,
        square * share,
    ];
    std::array::from_fn(|axis| {
        (0..4).map(|index| weights[index] * points[index][axis]).sum::<f64>() / 6.0
    })
}

fn sum(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    std::array::from_fn(|axis| a[axis] + b[axis])
}

/// `vector`, shortened to `length` if it is longer.
fn limited(vector: [f64; 3], length: f64) -> [f64; 3] {
    let norm = dot(vector, vector).sqrt();
    if norm > length { vector.map(|part| part * length / norm) } else { vector }
}
