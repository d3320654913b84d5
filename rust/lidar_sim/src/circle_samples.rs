//! Samples of single circles seen by a 2D scanner, for the training and the evaluation of circle
//! detectors.
//!
//! # Source
//! Sanchez-Lopez et al., "Deep learning based semantic situation awareness system for multirotor
//! aerial robots using LIDAR", 2019, sec. IV-B.

use crate::circle_beams::{Beams, CircleWindow};
use crate::random::{self, Purpose, Stream};
use lidar_core::Error;
use lidar_core::circles::segment::segments::Side;
use lidar_core::util::cancel;
use rayon::ThreadPool;
use rayon::prelude::*;
use std::ops::{Range, RangeInclusive};

/// Samples per chunk: fixed, so that the result cannot depend on the number of threads.
const SAMPLES_PER_CHUNK: u64 = 4096;
/// Number of drawn circles without a hit after which the scanner counts as blind.
const MOST_DRAWS: usize = 100_000;
/// Largest number of places of a lattice (circles, seen or not), and of samples.
pub const MOST_CIRCLES: u64 = 100_000_000;

/// Circles that a scanner sees.
#[derive(Clone, Copy, Debug)]
pub enum Source<'a> {
    /// Given circles, as centre x, centre y, radius [m], each repeated this many times.
    Given(&'a [[f64; 3]], u64),
    /// A new circle for every sample: centre uniform in a square around the scanner, radius
    /// uniform.
    Drawn {
        /// Half the side of the square [m].
        reach: f64,
        /// Smallest and largest radius [m].
        radius: [f64; 2],
    },
}

/// Largest distance behind a circle at which a ray that meets circle and background ends [m].
const MIXED_DEPTH: f64 = 0.1;

/// Disturbances of the ranges of a circle. Pairs are the ends of a uniform distribution, from which
/// every sample draws its own value.
#[derive(Clone, Copy, Debug)]
pub struct Disturbance {
    /// Standard deviation of a range [m].
    pub range_std: [f64; 2],
    /// Half the width of a ray [rad]: the ray returns if its edge hits the circle.
    pub beam_half_width: [f64; 2],
    /// Share of samples with one side hidden by a nearer object; one in four of them has both sides
    /// hidden.
    pub occluded_share: f64,
    /// Share of the ends of circles at which the last ray hits circle and background at once.
    pub mixed_share: f64,
    /// Largest distances from the nearer and the farther range limit at which it may cut a side
    /// [m].
    pub cut_margins: [f64; 2],
}

/// Several samples. Only the window of each scan is kept: from the first ray that hit the circle to
/// the last one.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Samples {
    /// Centre x, centre y, radius [m].
    pub circles: Vec<[f32; 3]>,
    /// Standard deviation of the ranges of the sample [m].
    pub range_std: Vec<f32>,
    /// Half the width of its rays [rad].
    pub beam_half_width: Vec<f32>,
    /// First ray of the window, which may continue at ray 0 after the end of the sweep.
    pub first_ray: Vec<u32>,
    /// Number of rays in the window.
    pub n_rays: Vec<u32>,
    /// What lies beside both ends of the window: index of a [`Side`] in the order of its variants.
    pub sides: Vec<[u8; 2]>,
    /// Ranges of all windows [m]; +inf is a miss between hits.
    pub ranges: Vec<f32>,
}

/// Circles on a lattice that the scanner sees. Centres are multiples of `spacing` within `reach` of
/// the scanner along both axes, radii are multiples of `radius_step`. The scanner is outside, and
/// at least one ray returns without noise. Sec. IV-B.
///
/// # Errors
/// [`Error::Parameter`] if the beams cover no angle or the lattice is infinite, [`Error::Limit`]
/// for more than [`MOST_CIRCLES`] places.
pub fn lattice(
    beams: &Beams,
    reach: f64,
    spacing: f64,
    radii: RangeInclusive<u32>,
    radius_step: f64,
) -> Result<Vec<[f64; 3]>, Error> {
    beams.check()?;
    let steps = (reach / spacing).round();
    if !(steps.is_finite() && steps >= 0.0) {
        let got = format!("{reach} and {spacing}");
        let expected = "reach >= 0 and spacing > 0";
        return Err(Error::Parameter { name: "reach, spacing", expected, got });
    }
    let places = (2.0 * steps + 1.0).powi(2) * radii.clone().count() as f64;
    if places > MOST_CIRCLES as f64 {
        let what = format!("a lattice of {places} circles");
        return Err(Error::Limit { what, limit: MOST_CIRCLES, key: "spacing" });
    }
    let steps = steps as i32;
    let mut circles = Vec::new();
    for radius in radii.map(|step| f64::from(step) * radius_step) {
        for x in -steps..=steps {
            cancel::check()?;
            for y in -steps..=steps {
                let circle = [f64::from(x) * spacing, f64::from(y) * spacing, radius];
                if beams.window(circle, 0.0).is_some() {
                    circles.push(circle);
                }
            }
        }
    }
    Ok(circles)
}

/// Make the samples with the indices `numbers`. A sample depends only on the seed and on its index.
///
/// # Errors
/// [`Error::Parameter`] if the beams cover no angle, [`Error::Value`] for a given circle that the
/// scanner cannot see, [`Error::Limit`] if no drawn circle is seen, and for more than
/// [`MOST_CIRCLES`] samples.
pub fn make(
    pool: &ThreadPool,
    beams: &Beams,
    source: Source<'_>,
    disturbance: &Disturbance,
    seed: u64,
    numbers: Range<u64>,
) -> Result<Samples, Error> {
    beams.check()?;
    let count = numbers.end.saturating_sub(numbers.start);
    if count > MOST_CIRCLES {
        let what = format!("{count} samples");
        return Err(Error::Limit { what, limit: MOST_CIRCLES, key: "ask for them in parts" });
    }
    let generator = SampleGenerator { beams, source, disturbance, seed };
    let starts: Vec<u64> = numbers.clone().step_by(SAMPLES_PER_CHUNK as usize).collect();
    let watch = cancel::watch();
    let parts: Vec<Result<Samples, Error>> = pool.install(|| {
        let part = |&start: &u64| {
            watch.check()?;
            generator.samples(start..start.saturating_add(SAMPLES_PER_CHUNK).min(numbers.end))
        };
        starts.par_iter().map(part).collect()
    });
    let mut samples = Samples::default();
    for part in parts {
        samples.append(part?);
    }
    Ok(samples)
}

/// Generator of samples: inputs that all of them share.
struct SampleGenerator<'a> {
    beams: &'a Beams,
    source: Source<'a>,
    disturbance: &'a Disturbance,
    seed: u64,
}

impl SampleGenerator<'_> {
    fn samples(&self, numbers: Range<u64>) -> Result<Samples, Error> {
        let mut samples = Samples::default();
        for number in numbers {
            let mut stream = Stream::new(self.seed, Purpose::Circle, number);
            let [noise, width, ..] = stream.uniforms();
            let range_std = between(self.disturbance.range_std, noise);
            let half_width = between(self.disturbance.beam_half_width, width);
            let (circle, mut window) = self.seen(number, half_width, &mut stream)?;
            let mut sides = self.beams.sides(&window, self.disturbance.cut_margins);
            self.hide(&mut window, &mut sides, &mut stream);
            self.mix(&mut window, &mut stream);
            self.add_noise(&mut window, range_std, number);
            samples.circles.push(circle.map(|value| value as f32));
            samples.range_std.push(range_std as f32);
            samples.beam_half_width.push(half_width as f32);
            samples.first_ray.push(window.first_ray);
            samples.n_rays.push(window.ranges.len() as u32);
            samples.sides.push(sides.map(|side| side as u8));
            samples.ranges.extend(window.ranges.iter().map(|&range| range as f32));
        }
        Ok(samples)
    }

    /// A circle that the scanner sees, and its window without noise.
    fn seen(
        &self,
        number: u64,
        half_width: f64,
        stream: &mut Stream,
    ) -> Result<([f64; 3], CircleWindow), Error> {
        match self.source {
            Source::Given(circles, times) => {
                let index = (number / times.max(1)) as usize;
                let circle = circles.get(index).copied().unwrap_or([f64::NAN; 3]);
                let window = self.beams.window(circle, half_width);
                let got = format!("{circle:?}");
                let expected = "a circle that the scanner sees, from outside";
                let refused = Error::Value { name: "circles", expected, index, got };
                Ok((circle, window.ok_or(refused)?))
            }
            Source::Drawn { reach, radius } => {
                for _ in 0..MOST_DRAWS {
                    let [x, y, size, _] = stream.uniforms();
                    let square = [-reach, reach];
                    let circle = [between(square, x), between(square, y), between(radius, size)];
                    if let Some(window) = self.beams.window(circle, half_width) {
                        return Ok((circle, window));
                    }
                }
                Err(Error::Limit {
                    what: "circles drawn that the scanner does not see".into(),
                    limit: MOST_DRAWS as u64,
                    key: "choose circles within its range and field of view",
                })
            }
        }
    }

    /// Hide a part of the circle by a nearer object.
    fn hide(&self, window: &mut CircleWindow, sides: &mut [Side; 2], stream: &mut Stream) {
        let [whether, which, first, second] = stream.uniforms();
        if whether >= self.disturbance.occluded_share || window.ranges.len() < 2 {
            return;
        }
        let hidden = [which < 0.625, which >= 0.375]; // a quarter of them: both
        let places = window.ranges.len() as f64 / if hidden == [true; 2] { 2.0 } else { 1.0 };
        let mut ranges = window.ranges.clone();
        let mut sides_left = *sides;
        for (side, share) in [first, second].into_iter().enumerate() {
            let rays = (share * places) as usize;
            if !hidden[side] || rays == 0 {
                continue;
            }
            let gone = if side == 0 { 0..rays } else { ranges.len() - rays..ranges.len() };
            ranges[gone].fill(f64::INFINITY);
            sides_left[side] = Side::Occluded;
        }
        let left = CircleWindow { first_ray: window.first_ray, ranges }.trimmed(self.beams.n_beams);
        if let Some(left) = left {
            (*window, *sides) = (left, sides_left);
        }
    }

    /// Let rays at the ends meet circle and background at once.
    fn mix(&self, window: &mut CircleWindow, stream: &mut Stream) {
        let [first, second, near, far] = stream.uniforms();
        let last = window.ranges.len() - 1;
        for (whether, place, share) in [(first, 0, near), (second, last, far)] {
            if whether < self.disturbance.mixed_share {
                window.ranges[place] += share * MIXED_DEPTH;
            }
        }
    }

    fn add_noise(&self, window: &mut CircleWindow, range_std: f64, number: u64) {
        for (index, pair) in window.ranges.chunks_mut(2).enumerate() {
            let place = random::place(Purpose::CircleNoise, number, index as u32);
            let drawn = random::words(self.seed, place);
            for (range, words) in pair.iter_mut().zip(drawn.chunks(2)) {
                // A range is never below 0, whatever the noise.
                *range = (*range + range_std * random::normal(words[0], words[1])).max(0.0);
            }
        }
    }
}

/// Uniform between two ends.
fn between([low, high]: [f64; 2], uniform: f64) -> f64 {
    low + (high - low) * uniform
}

impl Samples {
    fn append(&mut self, mut other: Self) {
        self.circles.append(&mut other.circles);
        self.range_std.append(&mut other.range_std);
        self.beam_half_width.append(&mut other.beam_half_width);
        self.first_ray.append(&mut other.first_ray);
        self.n_rays.append(&mut other.n_rays);
        self.sides.append(&mut other.sides);
        self.ranges.append(&mut other.ranges);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use lidar_core::util::threads::pool;

    const QUIET: Disturbance = Disturbance {
        range_std: [0.0; 2],
        beam_half_width: [0.0; 2],
        occluded_share: 0.0,
        mixed_share: 0.0,
        cut_margins: [0.15, 1.0],
    };

    fn hokuyo() -> Beams {
        let degree = f64::to_radians(1.0);
        Beams {
            angle_min: -135.0 * degree,
            angle_increment: 0.25 * degree,
            n_beams: 1081,
            range_limits: [0.1, 10.0],
        }
    }

    fn one(beams: &Beams, circle: [f64; 3], how: &Disturbance) -> Result<Samples, Error> {
        make(&pool(1)?, beams, Source::Given(&[circle], 1), how, 1, 0..1)
    }

    #[test]
    fn the_middle_ray_ends_at_distance_less_radius() -> Result<(), Error> {
        let samples = one(&hokuyo(), [5.0, 0.0, 0.3], &QUIET)?;
        // asin(0.3 / 5) is 3.44 degrees: 13 rays to each side of ray 540.
        assert_eq!((samples.first_ray[0], samples.n_rays[0]), (527, 27));
        assert!((samples.ranges[13] - 4.7).abs() < 1e-6);
        assert_eq!(samples.sides[0], [Side::Free as u8; 2]);
        Ok(())
    }

    #[test]
    fn sides_tell_what_cuts_a_circle() -> Result<(), Error> {
        let edge = f64::to_radians(135.0);
        let circle = [3.0 * libm::cos(edge), 3.0 * libm::sin(edge), 0.5];
        let at_edge = one(&hokuyo(), circle, &QUIET)?;
        assert_eq!(at_edge.sides[0], [Side::Free as u8, Side::FieldEdge as u8]);
        let far = one(&hokuyo(), [10.2, 0.0, 0.5], &QUIET)?;
        assert_eq!(far.sides[0], [Side::RangeCut as u8; 2]);
        let hidden = Disturbance { occluded_share: 1.0, ..QUIET };
        let part = one(&hokuyo(), [5.0, 0.0, 0.3], &hidden)?;
        assert!(part.sides[0].contains(&(Side::Occluded as u8)) && part.n_rays[0] < 27);
        Ok(())
    }

    #[test]
    fn a_full_circle_sees_over_its_seam() -> Result<(), Error> {
        let mut beams = hokuyo();
        (beams.angle_min, beams.n_beams) = (0.0, 1440);
        let samples = one(&beams, [5.0, 0.0, 0.3], &QUIET)?;
        assert_eq!((samples.first_ray[0], samples.n_rays[0]), (1440 - 13, 27));
        assert_eq!(samples.sides[0], [Side::Free as u8; 2]);
        beams.angle_increment = -beams.angle_increment;
        assert_eq!(one(&beams, [5.0, 0.0, 0.3], &QUIET)?.n_rays, [27]);
        Ok(())
    }

    #[test]
    fn wide_rays_see_wider_circles() -> Result<(), Error> {
        let wide = Disturbance { beam_half_width: [0.01; 2], ..QUIET };
        let samples = one(&hokuyo(), [5.0, 0.0, 0.3], &wide)?;
        assert_eq!(samples.n_rays, [33]); // 3.44 + 0.57 degrees to each side
        assert!((samples.ranges[0] - (25.0f32 - 0.09).sqrt()).abs() < 1e-6);
        Ok(())
    }

    #[test]
    fn samples_depend_on_seed_and_number_only() -> Result<(), Error> {
        let source = Source::Drawn { reach: 10.0, radius: [0.05, 0.5] };
        let how = Disturbance { range_std: [0.01; 2], occluded_share: 0.3, ..QUIET };
        let beams = hokuyo();
        let all = make(&pool(1)?, &beams, source, &how, 3, 0..9000)?;
        assert_eq!(all, make(&pool(3)?, &beams, source, &how, 3, 0..9000)?);
        let late = make(&pool(1)?, &beams, source, &how, 3, 8000..9000)?;
        assert_eq!(all.circles[8000..], late.circles);
        assert!(all.ranges.ends_with(&late.ranges));
        Ok(())
    }

    #[test]
    fn what_cannot_be_seen_is_refused() -> Result<(), Error> {
        assert!(one(&hokuyo(), [0.1, 0.0, 0.3], &QUIET).is_err());
        assert!(one(&hokuyo(), [-5.0, 0.0, 0.3], &QUIET).is_err());
        let far = Source::Drawn { reach: 0.0, radius: [0.5, 0.5] };
        assert!(make(&pool(1)?, &hokuyo(), far, &QUIET, 1, 0..1).is_err());
        Ok(())
    }

    /// Sec. IV-B: 2,011,494 measurements, two of every circle. Rounding of rays that touch a
    /// circle decides about some tens of circles.
    #[test]
    fn the_lattice_has_as_many_circles_as_published() -> Result<(), Error> {
        let circles = lattice(&hokuyo(), 10.0, 0.05, 1..=10, 0.05)?;
        assert!(circles.len().abs_diff(1_005_747) <= 50, "{}", circles.len());
        Ok(())
    }
}
