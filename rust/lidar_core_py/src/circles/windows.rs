//! Bindings of `lidar_core::circles::fit::network_window`.

use crate::arrays;
use crate::errors::BorderError;
use crate::guard::stoppable;
use lidar_core::Error;
use lidar_core::circles::fit::circle::CircleEstimate;
use lidar_core::circles::fit::network_window::{
    ANSWER, CONTEXT, SLOT_NUMBERS, SLOTS, SegmentWindow, WindowFrame, circle_of, describe,
};
use lidar_core::circles::segment::segments::Side;
use lidar_core::util::budget::check_memory;
use numpy::{
    IntoPyArray, PyArray2, PyArray3, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2,
    PyUntypedArrayMethods,
};
use pyo3::prelude::*;

/// Count of values per frame: bearing [rad], unit of length [m], distance and radius of the initial
/// estimate [m], number of hits.
const FRAME: usize = 5;
/// Kinds of the neighbourhood of a segment, in the order of their codes in arrays.
const SIDES: [Side; 4] = [Side::Free, Side::Occluded, Side::FieldEdge, Side::RangeCut];

/// Input of the network as arrays, one row per window: slots, context, frames.
type Described<'py> =
    (Bound<'py, PyArray3<f32>>, Bound<'py, PyArray2<f32>>, Bound<'py, PyArray2<f64>>);

/// All windows of one call, one after the other.
struct Windows<'a> {
    bearings: &'a [f64],
    ranges: &'a [f64],
    starts: &'a [i64],
    sides: &'a [[u8; 2]],
    gaps: &'a [[f64; 2]],
    noise: &'a [[f64; 2]],
    range_limits: [f64; 2],
}

#[pyfunction]
#[pyo3(signature = (bearings, ranges, starts, sides, *, gaps, noise, range_limits))]
#[allow(clippy::too_many_arguments)] // one per array
pub(crate) fn circle_windows<'py>(
    py: Python<'py>,
    bearings: PyReadonlyArray1<'py, f64>,
    ranges: PyReadonlyArray1<'py, f64>,
    starts: PyReadonlyArray1<'py, i64>,
    sides: PyReadonlyArray2<'py, u8>,
    gaps: PyReadonlyArray2<'py, f64>,
    noise: PyReadonlyArray2<'py, f64>,
    range_limits: [f64; 2],
) -> Result<Described<'py>, BorderError> {
    let windows = Windows {
        bearings: arrays::flat("bearings", &bearings)?,
        ranges: arrays::flat("ranges", &ranges)?,
        starts: arrays::flat("starts", &starts)?,
        sides: arrays::flat("sides", &sides)?.as_chunks::<2>().0,
        gaps: arrays::flat("gaps", &gaps)?.as_chunks::<2>().0,
        noise: arrays::flat("noise", &noise)?.as_chunks::<2>().0,
        range_limits,
    };
    let (slots, context, frames) = stoppable(py, || windows.described())?;
    let count = frames.len();
    Ok((
        slots.into_pyarray(py).reshape([count, SLOTS, SLOT_NUMBERS])?,
        context.into_pyarray(py).reshape([count, CONTEXT])?,
        frames.into_flattened().into_pyarray(py).reshape([count, FRAME])?,
    ))
}

impl Windows<'_> {
    /// Slots and context of all windows, and their frames.
    #[allow(clippy::type_complexity)] // three flat arrays
    fn described(&self) -> Result<(Vec<f32>, Vec<f32>, Vec<[f64; FRAME]>), Error> {
        let count = self.starts.len().saturating_sub(1);
        for (name, got) in
            [("sides", self.sides.len()), ("gaps", self.gaps.len()), ("noise", self.noise.len())]
        {
            if got != count {
                return Err(Error::Length { name, expected: count, got });
            }
        }
        let room = size_of::<[f32; SLOTS * SLOT_NUMBERS + CONTEXT]>() + size_of::<[f64; FRAME]>();
        check_memory("windows", count, room)?;
        let mut slots = vec![0.0; count * SLOTS * SLOT_NUMBERS];
        let mut context = vec![0.0; count * CONTEXT];
        let mut frames = Vec::with_capacity(count);
        let places = slots.chunks_exact_mut(SLOTS * SLOT_NUMBERS);
        for (index, (slots, context)) in places.zip(context.chunks_exact_mut(CONTEXT)).enumerate() {
            let frame = describe(&self.window(index)?, slots, context)?;
            let [distance, radius] = frame.guess;
            let hits = frame.n_hits as f64;
            frames.push([frame.bearing, frame.scale, distance, radius, hits]);
        }
        Ok((slots, context, frames))
    }

    fn window(&self, index: usize) -> Result<SegmentWindow<'_>, Error> {
        let refused = |name: &'static str, got: String| Error::Value {
            name,
            expected: "ascending places of windows, and known sides",
            index,
            got,
        };
        let bounds = [self.starts[index], self.starts[index + 1]];
        let span = || -> Option<_> {
            let from = usize::try_from(bounds[0]).ok()?;
            let to = usize::try_from(bounds[1]).ok()?;
            Some((self.bearings.get(from..to)?, self.ranges.get(from..to)?))
        };
        let (bearings, ranges) = span().ok_or_else(|| refused("starts", format!("{bounds:?}")))?;
        let side = |number: u8| SIDES.get(number as usize).copied();
        let [before, after] = self.sides[index];
        let (Some(before), Some(after)) = (side(before), side(after)) else {
            return Err(refused("sides", format!("{:?}", self.sides[index])));
        };
        Ok(SegmentWindow {
            bearings,
            ranges,
            sides: [before, after],
            gaps: self.gaps[index],
            range_std: self.noise[index][0],
            beam_half_width: self.noise[index][1],
            range_limits: self.range_limits,
        })
    }
}

/// Circles (N, 3) [m] and covariances (N, 3, 3) [m^2].
type Circles<'py> = (Bound<'py, PyArray2<f64>>, Bound<'py, PyArray3<f64>>);

#[pyfunction]
pub(crate) fn circles_from_answers<'py>(
    py: Python<'py>,
    frames: PyReadonlyArray2<'py, f64>,
    answers: PyReadonlyArray2<'py, f32>,
) -> Result<Circles<'py>, BorderError> {
    let count = frames.shape()[0];
    if frames.shape() != [count, FRAME] || answers.shape() != [count, ANSWER] {
        let got = [frames.shape(), answers.shape()].concat();
        return Err(BorderError::Shape {
            name: "frames, answers",
            expected: "(N, 5), (N, 9)",
            got,
        });
    }
    let frames = arrays::flat("frames", &frames)?.as_chunks::<FRAME>().0;
    let answers = arrays::flat("answers", &answers)?.as_chunks::<ANSWER>().0;
    check_memory("answers", count, 2 * size_of::<[f64; 12]>())?;
    let (mut circles, mut covariances) = (Vec::new(), Vec::new());
    for (&[bearing, scale, distance, radius, hits], answer) in frames.iter().zip(answers) {
        let frame =
            WindowFrame { bearing, scale, guess: [distance, radius], n_hits: hits as usize };
        let CircleEstimate { circle, covariance, .. } = circle_of(&frame, answer);
        circles.push([circle.center[0], circle.center[1], circle.radius]);
        covariances.extend(covariance.as_flattened());
    }
    Ok((arrays::rows_into(py, circles)?, covariances.into_pyarray(py).reshape([count, 3, 3])?))
}
