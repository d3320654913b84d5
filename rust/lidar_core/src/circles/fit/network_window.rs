//! Input of the neural network for one segment: its own window, in its own frame.
//!
//! The frame has its x axis through the middle of the window. Its unit is the radius of a first
//! guess, the circle that fills the window. The input is the difference of the ranges from that
//! circle, the output is a correction of it. A circle therefore looks the same at every place and
//! for every field of view, number of rays and resolution of the scanner.

use super::circle::{Circle, CircleEstimate};
use crate::Error;
use crate::circles::preprocess::polar_scan::turn;
use crate::circles::segment::segments::Side;
use std::f64::consts::FRAC_PI_2;

/// Number of slots for rays; in windows with more hits, neighbouring rays share a slot.
pub const SLOTS: usize = 32;
/// Values per slot: difference of range, two coordinates on the initial circle, 1 if the slot is
/// used.
pub const SLOT_NUMBERS: usize = 4;
/// Number of values that describe the window as a whole.
pub const CONTEXT: usize = 21;
/// Number of outputs: circle, then the lower triangle of its uncertainty.
pub const ANSWER: usize = 9;

/// Smallest and largest unit of a frame [m].
const SCALES: [f64; 2] = [0.03, 1.0];
/// Largest difference of range in the input, in units of the frame.
const MOST_DIFFERENCE: f64 = 4.0;
/// Largest half angle of an initial circle [rad]: the scanner is outside of it.
const MOST_HALF_ANGLE: f64 = 1.55;
/// Distances to the far and to the near range limit [m] above which the input no longer grows.
const LIMIT_REACH: [f64; 2] = [1.0, 0.3];
/// Smallest radius of an answer [m].
const SMALLEST_RADIUS: f64 = 1e-3;

/// One segment of a scan: its rays from the first hit to the last.
#[derive(Clone, Copy, Debug)]
pub struct SegmentWindow<'a> {
    /// Direction of every ray [rad].
    pub bearings: &'a [f64],
    /// Range of every ray [m]; a range that is not finite is no hit.
    pub ranges: &'a [f64],
    /// What lies beside the first and beside the last ray.
    pub sides: [Side; 2],
    /// Angles from the first and from the last ray to the next ray outside the window [rad].
    pub gaps: [f64; 2],
    /// Standard deviation of a range [m].
    pub range_std: f64,
    /// Half the width of a ray [rad].
    pub beam_half_width: f64,
    /// Nearest and farthest surface that is measured [m].
    pub range_limits: [f64; 2],
}

/// Frame of a window: it converts an output of the network to a circle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WindowFrame {
    /// Bearing of the x axis of the window in the frame of the scan [rad].
    pub bearing: f64,
    /// Unit of length of the window [m].
    pub scale: f64,
    /// Initial circle: distance of the centre, which is on the x axis, and radius [m].
    pub guess: [f64; 2],
    /// Number of rays that returned.
    pub n_hits: usize,
}

/// Hits in the window's frame.
struct Hits {
    /// Bearing from the middle [rad], and range [m].
    rays: Vec<[f64; 2]>,
    half_angle: f64,
    bearing: f64,
}

/// Fill `slots` and `context` with the input of the network. Returns the frame of the window, in
/// which [`circle_of`] reads the output.
///
/// # Errors
/// [`Error::Length`] if the arrays differ in length or are not as long as they must be,
/// [`Error::Value`] if no ray returned or a bearing is not finite.
pub fn describe(
    window: &SegmentWindow<'_>,
    slots: &mut [f32],
    context: &mut [f32],
) -> Result<WindowFrame, Error> {
    check(window, slots, context)?;
    let hits = Hits::of(window)?;
    let sine = libm::sin(hits.half_angle);
    let (mut gz, mut gg) = (0.0, 0.0);
    for &[off, range] in &hits.rays {
        let unit = unit_range(off, sine);
        gz += unit * range;
        gg += unit * unit;
    }
    let distance = gz / gg;
    let radius = distance * sine;
    // A window of one ray, or one as wide as the view, must not scale its input out of range.
    let frame = WindowFrame {
        bearing: hits.bearing,
        scale: radius.clamp(SCALES[0], SCALES[1]),
        guess: [distance, radius],
        n_hits: hits.rays.len(),
    };
    let deviation = fill_slots(&hits, &frame, sine, slots);
    fill_context(window, &hits, &frame, deviation, context);
    Ok(frame)
}

/// Circle and covariance in the frame of the scan [m, m^2], from the output `answer` of the network
/// for the window `frame`.
///
/// The first three numbers are the offsets of the centre, along and across the axis of the window,
/// and of the radius, in units of `frame.scale`. The others are a lower triangle L with the
/// covariance L L': the logarithms of its diagonal, in these units, and its entries (1, 0), (2, 0)
/// and (2, 1) over the diagonal entry of their row.
#[must_use]
pub fn circle_of(frame: &WindowFrame, answer: &[f32; ANSWER]) -> CircleEstimate {
    let a = answer.map(f64::from);
    let [ahead, radius] = frame.guess;
    let local = [ahead + a[0] * frame.scale, a[1] * frame.scale, radius + a[2] * frame.scale];
    // The exponential keeps deviations positive whatever the network answers.
    let sd = [3, 4, 5].map(|place| libm::exp(a[place]) * frame.scale);
    // Rows of the lower triangle, in units of their diagonal.
    let lower =
        [[sd[0], 0.0, 0.0], [a[6] * sd[1], sd[1], 0.0], [a[7] * sd[2], a[8] * sd[2], sd[2]]];
    let (sine, cosine) = (libm::sin(frame.bearing), libm::cos(frame.bearing));
    let turned = |[x, y, r]: [f64; 3]| [cosine * x - sine * y, sine * x + cosine * y, r];
    // Columns of the triangle, turned: their outer products add up to the covariance.
    let columns: [[f64; 3]; 3] = [0, 1, 2].map(|k| turned(lower.map(|row| row[k])));
    let covariance = std::array::from_fn(|i| {
        std::array::from_fn(|j| columns.iter().map(|column| column[i] * column[j]).sum())
    });
    let [x, y, radius] = turned(local);
    let radius = radius.max(SMALLEST_RADIUS);
    CircleEstimate {
        circle: Circle { center: [x, y], radius },
        covariance,
        n_hits: frame.n_hits,
        is_fallback: false,
    }
}

fn check(window: &SegmentWindow<'_>, slots: &[f32], context: &[f32]) -> Result<(), Error> {
    let lengths = [
        ("ranges", window.bearings.len(), window.ranges.len()),
        ("slots", SLOTS * SLOT_NUMBERS, slots.len()),
        ("context", CONTEXT, context.len()),
    ];
    match lengths.into_iter().find(|(_, expected, got)| expected != got) {
        Some((name, expected, got)) => Err(Error::Length { name, expected, got }),
        None => Ok(()),
    }
}

impl Hits {
    fn of(window: &SegmentWindow<'_>) -> Result<Self, Error> {
        let is_hit = |range: &f64| range.is_finite();
        let (Some(first), Some(last)) =
            (window.ranges.iter().position(is_hit), window.ranges.iter().rposition(is_hit))
        else {
            let (expected, got) = ("a ray that returned", "none".into());
            return Err(Error::Value { name: "ranges", expected, index: 0, got });
        };
        if let Some(index) = window.bearings.iter().position(|bearing| !bearing.is_finite()) {
            let got = window.bearings[index].to_string();
            return Err(Error::Value { name: "bearings", expected: "finite values", index, got });
        }
        let start = window.bearings[first];
        let span = turn(window.bearings[last] - start);
        // A free side ends about half way to the next ray; wide rays reach beyond.
        let widened = |gap: f64| (0.5 * gap.abs() - window.beam_half_width).max(0.05 * gap.abs());
        let way = if span < 0.0 || (span == 0.0 && window.gaps[0] < 0.0) { -1.0 } else { 1.0 };
        let (before, after) = (widened(window.gaps[0]), widened(window.gaps[1]));
        let half_angle = 0.5 * (span.abs() + before + after);
        let bearing = start + 0.5 * way * (span.abs() + after - before);
        let rays = window.bearings.iter().zip(window.ranges).filter(|&(_, range)| is_hit(range));
        let rays = rays.map(|(&ray, &range)| [way * turn(ray - bearing), range]).collect();
        Ok(Self { rays, half_angle: half_angle.clamp(1e-6, MOST_HALF_ANGLE), bearing })
    }
}

/// Range of a circle at distance 1 whose half angle has the sine `sine`, at angle `off` from its
/// middle; for rays beside the circle the range of its flank.
fn unit_range(off: f64, sine: f64) -> f64 {
    let aside = libm::sin(off);
    libm::cos(off) - (sine * sine - aside * aside).max(0.0).sqrt()
}

/// Fill the slots with differences from the initial circle; returns their root mean square in units
/// of the frame.
fn fill_slots(hits: &Hits, frame: &WindowFrame, sine: f64, slots: &mut [f32]) -> f64 {
    let count = hits.rays.len();
    let used = count.min(SLOTS);
    let mut sums = [[0.0f64; SLOT_NUMBERS]; SLOTS];
    let mut squares = 0.0;
    for (index, &[off, range]) in hits.rays.iter().enumerate() {
        let difference = (range - frame.guess[0] * unit_range(off, sine)) / frame.scale;
        let difference = difference.clamp(-MOST_DIFFERENCE, MOST_DIFFERENCE);
        let aside = (libm::sin(off) / sine).clamp(-1.0, 1.0);
        let depth = (1.0 - aside * aside).max(0.0).sqrt();
        // Rays are shared evenly: a network of fixed size sees windows of any number of hits.
        let sum = &mut sums[index * used / count];
        for (total, value) in sum.iter_mut().zip([difference, aside, depth, 1.0]) {
            *total += value;
        }
        squares += difference * difference;
    }
    for (numbers, sum) in slots.chunks_exact_mut(SLOT_NUMBERS).zip(sums) {
        for (number, total) in numbers.iter_mut().zip(sum) {
            *number = if sum[3] > 0.0 { (total / sum[3]) as f32 } else { 0.0 };
        }
    }
    (squares / count as f64).sqrt()
}

fn fill_context(
    window: &SegmentWindow<'_>,
    hits: &Hits,
    frame: &WindowFrame,
    deviation: f64,
    context: &mut [f32],
) {
    let count = hits.rays.len() as f64;
    let [near, far] = window.range_limits;
    let [distance, radius] = frame.guess;
    let ranges = |ray: &[f64; 2]| ray[1];
    let (first, last) =
        (hits.rays.first().map_or(0.0, ranges), hits.rays.last().map_or(0.0, ranges));
    let nearest = hits.rays.iter().map(ranges).fold(f64::INFINITY, f64::min);
    let sigma = window.range_std.max(1e-4) / frame.scale;
    let gap = 0.5 * (window.gaps[0].abs() + window.gaps[1].abs());
    let to_far = |range: f64| ((far - range) / LIMIT_REACH[0]).clamp(-0.1, 1.0);
    let mut numbers = [0.0; CONTEXT];
    numbers[..13].copy_from_slice(&[
        libm::log(distance.max(1e-3)),
        libm::log(radius.max(1e-4)),
        libm::log(sigma),
        libm::log(count),
        libm::log((gap * distance / frame.scale).max(1e-6)),
        hits.half_angle / FRAC_PI_2,
        libm::log((deviation / sigma).max(1e-2)),
        window.beam_half_width * distance / frame.scale,
        1.0 - count / window.ranges.len() as f64,
        to_far(first),
        to_far(last),
        ((nearest - near) / LIMIT_REACH[1]).clamp(-0.1, 1.0),
        libm::log(sigma / (count / SLOTS as f64).max(1.0).sqrt()),
    ]);
    for (side, numbers) in window.sides.into_iter().zip(numbers[13..].chunks_exact_mut(4)) {
        numbers[side as usize] = 1.0;
    }
    for (place, number) in context.iter_mut().zip(numbers) {
        *place = number as f32;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Error;

    const STEP: f64 = 0.004;

    /// Rays that meet a circle at distance 3 on the bearing `middle`.
    fn seen(radius: f64, middle: f64, shift: f64) -> (Vec<f64>, Vec<f64>) {
        let sine = radius / 3.0;
        let all = (-200..=200).map(|k| (f64::from(k) + shift) * STEP);
        let met: Vec<f64> = all.filter(|off| libm::sin(*off).abs() < sine).collect();
        let ranges = met.iter().map(|&off| 3.0 * unit_range(off, sine)).collect();
        (met.iter().map(|off| off + middle).collect(), ranges)
    }

    fn window<'a>(bearings: &'a [f64], ranges: &'a [f64]) -> SegmentWindow<'a> {
        SegmentWindow {
            bearings,
            ranges,
            sides: [Side::Free; 2],
            gaps: [STEP; 2],
            range_std: 0.01,
            beam_half_width: 0.0,
            range_limits: [0.1, 10.0],
        }
    }

    fn described(window: &SegmentWindow<'_>) -> Result<(Vec<f32>, Vec<f32>, WindowFrame), Error> {
        let (mut slots, mut context) = (vec![0.0; SLOTS * SLOT_NUMBERS], vec![0.0; CONTEXT]);
        let frame = describe(window, &mut slots, &mut context)?;
        Ok((slots, context, frame))
    }

    #[test]
    fn the_first_guess_fills_the_window() -> Result<(), Error> {
        let (bearings, ranges) = seen(0.3, 1.0, 0.3);
        let (slots, context, frame) = described(&window(&bearings, &ranges))?;
        assert!((frame.guess[0] - 3.0).abs() < 0.02 && (frame.guess[1] - 0.3).abs() < 0.008);
        assert!((frame.bearing - 1.0).abs() < 0.5 * STEP);
        assert_eq!(frame.n_hits, bearings.len());
        assert!(slots.iter().all(|number| number.abs() <= 1.0));
        assert_eq!((context[13], context[17]), (1.0, 1.0));
        Ok(())
    }

    #[test]
    fn a_turned_window_looks_the_same() -> Result<(), Error> {
        let (bearings, ranges) = seen(0.3, 0.0, 0.3);
        let here = described(&window(&bearings, &ranges))?;
        let turned: Vec<f64> = bearings.iter().map(|bearing| turn(bearing + 3.1)).collect();
        let there = described(&window(&turned, &ranges))?;
        for (first, second) in here.0.iter().chain(&here.1).zip(there.0.iter().chain(&there.1)) {
            assert!((first - second).abs() < 1e-5);
        }
        assert!(turn(there.2.bearing - here.2.bearing - 3.1).abs() < 1e-9);
        Ok(())
    }

    #[test]
    fn answers_add_to_the_first_guess() {
        let frame = WindowFrame { bearing: FRAC_PI_2, scale: 0.5, guess: [3.0, 0.4], n_hits: 9 };
        let estimate = circle_of(&frame, &[0.2, 0.1, -0.2, 0.0, 0.0, 0.0, 0.5, 0.0, 0.0]);
        let [x, y] = estimate.circle.center;
        assert!((x + 0.05).abs() < 1e-7 && (y - 3.1).abs() < 1e-7);
        assert!((estimate.circle.radius - 0.3).abs() < 1e-7);
        // Ahead is y: variance 0.25 of it, 0.25 (1 + 0.5^2) aside, covariance 0.125, turned.
        let expected = [[0.3125, -0.125, 0.0], [-0.125, 0.25, 0.0], [0.0, 0.0, 0.25]];
        for (row, expected) in estimate.covariance.iter().zip(expected) {
            for (entry, expected) in row.iter().zip(expected) {
                assert!((entry - expected).abs() < 1e-7, "{:?}", estimate.covariance);
            }
        }
    }

    #[test]
    fn one_ray_is_enough_and_none_is_refused() -> Result<(), Error> {
        let (_, context, frame) = described(&window(&[0.5], &[2.0]))?;
        assert!(context.iter().all(|number| number.is_finite()) && frame.n_hits == 1);
        assert!(described(&window(&[0.5], &[f64::INFINITY])).is_err());
        assert!(described(&window(&[0.5, 0.6], &[2.0])).is_err());
        assert!(described(&window(&[f64::NAN], &[2.0])).is_err());
        Ok(())
    }
}
