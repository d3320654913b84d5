//! Circles: sequences of sweeps through the pipeline, and its stages as functions.

use super::input::Input;
use lidar_core::Error;
use lidar_core::circles::fit::network_window::{
    ANSWER, CONTEXT, SLOT_NUMBERS, SLOTS, SegmentWindow, WindowFrame, circle_of, describe,
};
use lidar_core::circles::fit::{FitMethod, FitParameters, Fitter};
use lidar_core::circles::map::{
    CircleMap, CircleMapParameters, CircleScan, ScanWithLimits, VisibilityTest,
};
use lidar_core::circles::parameters::PipelineParameters;
use lidar_core::circles::pipeline::{CirclePipeline, RawSweep};
use lidar_core::circles::preprocess::misses::{Misses, NoReturn};
use lidar_core::circles::preprocess::polar_scan::PolarScan;
use lidar_core::circles::preprocess::projection::{Projection, directions, limit_range, project};
use lidar_core::circles::preprocess::sweep_poses::SweepPoses;
use lidar_core::circles::segment::parameters::{Bound, SegmentParameters};
use lidar_core::circles::segment::segmentation::segment;
use lidar_core::circles::segment::segments::Side;
use lidar_core::circles::shape::ShapeFitter;
use lidar_core::geometry::motion::ScanPoses;
use lidar_core::geometry::transform::Transform;

/// Ranges of a scene of posts, walls and gaps.
fn ranges(input: &mut Input<'_>, count: usize) -> Vec<f32> {
    let mut found = Vec::new();
    while found.len() < count {
        let (kind, length) = (input.byte(), 1 + input.below(12));
        let start = if kind % 4 == 3 { f64::INFINITY } else { input.positive() * 4.0 };
        let bend = f64::from(kind % 7) * 0.004;
        for step in 0..length {
            let off = step as f64 - length as f64 / 2.0;
            found.push((start + bend * off * off) as f32);
        }
        if input.is_empty() {
            found.resize(count, f32::INFINITY);
        }
    }
    found.truncate(count);
    if input.rarely() {
        found.push(input.f64() as f32);
    }
    found
}

pub fn pipeline(bytes: &[u8]) {
    let mut input = Input::new(bytes);
    let mut parameters =
        if input.rarely() { PipelineParameters::paper() } else { PipelineParameters::default() };
    parameters.scanner.n_beams = 1 + input.below(90);
    parameters.scanner.angle_increment = if input.rarely() { input.f64() } else { 0.02 };
    if input.rarely() {
        parameters.planes = input.many(2, |input| input.f64s());
        parameters.fit.range_std = input.f64();
    }
    if input.is_set() {
        parameters.shapes = None;
    }
    let beams = parameters.scanner.n_beams;
    let Ok(mut pipeline) = CirclePipeline::new(parameters.clone()) else { return };
    let mut stamp_ns = 0;
    for _ in 0..24 {
        if input.is_empty() {
            break;
        }
        stamp_ns = input.stamp(stamp_ns);
        let before = pipeline.to_state().ok();
        if sweep(&mut input, &mut pipeline, stamp_ns, beams).is_err() {
            assert_eq!(before, pipeline.to_state().ok()); // a refused call changes nothing
        }
    }
    let _ = (pipeline.map_at(stamp_ns), pipeline.shapes_at(stamp_ns));
    let state = pipeline.to_state().ok();
    let again = state.as_ref().map(|state| CirclePipeline::from_state(parameters, state));
    let again = again.and_then(|made| made.ok()).and_then(|pipeline| pipeline.to_state().ok());
    assert_eq!(again, state);
    if input.rarely() {
        pipeline.reset();
    }
}

fn sweep(
    input: &mut Input<'_>,
    pipeline: &mut CirclePipeline,
    stamp_ns: i64,
    beams: usize,
) -> Result<(), Error> {
    let ranges = ranges(input, beams);
    let poses = if input.rarely() { input.many(3, Input::pose) } else { vec![input.pose()] };
    let mut pose_ns = stamp_ns;
    let stamps = (poses.len() > 1).then(|| {
        input.beside(poses.len(), |input| {
            pose_ns = input.stamp(pose_ns);
            pose_ns
        })
    });
    let times = input.maybe(|input| {
        input.beside(ranges.len(), |input| stamp_ns.saturating_add(i64::from(input.byte()) << 16))
    });
    let raw = RawSweep {
        scanner: input.one_of(&["lidar", "lidar", "rear", ""]),
        stamp_ns,
        ranges: &ranges,
        poses: &poses,
        pose_stamps_ns: stamps.as_deref(),
        ray_time_ns: times.as_deref(),
        pose_covariance: input.maybe(Input::covariance),
    };
    if input.is_set() {
        pipeline.process(&raw)?;
        return Ok(());
    }
    let prepared = pipeline.prepare(&raw)?;
    let count = prepared.segments.len();
    let answers = input.beside(count, |input| circle_of(&frame(input), &input.f32s()));
    pipeline.integrate(prepared, answers)?;
    Ok(())
}

fn frame(input: &mut Input<'_>) -> WindowFrame {
    WindowFrame {
        bearing: input.f64(),
        scale: input.positive(),
        guess: input.f64s(),
        n_hits: input.below(20),
    }
}

pub fn functions(bytes: &[u8]) {
    let mut input = Input::new(bytes);
    let _ = stages(&mut input);
    let _ = window(&mut input);
    let _: [f32; ANSWER] = input.f32s();
}

fn stages(input: &mut Input<'_>) -> Result<(), Error> {
    let count = 1 + input.below(90);
    let ranges = ranges(input, count);
    let step = if input.rarely() { input.f64() } else { 0.02 };
    let bearings = input.beside(ranges.len(), |_| 0.0);
    let bearings: Vec<f64> = (0..bearings.len()).map(|ray| step * ray as f64).collect();
    let ways = directions(&bearings);
    let poses = vec![input.pose()];
    let motion = ScanPoses::new(&poses, None)?;
    let sweep = if input.is_set() {
        SweepPoses::still(Transform::from_matrix(&input.pose()))
    } else {
        SweepPoses::new(&motion, 0, None)?
    };
    let _ = (sweep.at_stamp(), sweep.is_moving(), sweep.world_from_level());
    let mut misses = Misses::default();
    let limits = [input.f64(), input.f64()];
    (0..input.below(30)).for_each(|_| misses.add(&ranges, limits));
    let near = misses.marked(&ranges, limits, input.f64());
    assert!(near.len() == ranges.len() && misses.no_return() != NoReturn::Nan);
    let limited = limit_range(&near, &ways, &sweep, &input.many(2, |input| input.f64s()));
    let raw = PolarScan { ranges: limited.unwrap_or(near), bearings };
    let level = project(&raw, &ways, &sweep, input.one_of(&[Projection::Exact, Projection::Paper]));
    let scan = level.map_or(raw, |level| level.scan);
    let _ = (scan.len(), scan.is_empty(), scan.point(input.below(100)));
    let parameters = SegmentParameters {
        bound: if input.rarely() {
            Bound::Fixed(input.f64())
        } else {
            SegmentParameters::default().bound
        },
        max_gap: input.below(4),
        merge_distance: input.positive(),
        min_points: input.below(6),
        ..SegmentParameters::default()
    };
    let segments = segment(&scan, None, &parameters)?;
    let hit: Vec<&[u32]> = (0..segments.len()).map(|number| segments.rays_of(number)).collect();
    assert_eq!(segments.is_empty(), hit.is_empty());
    let parameters = FitParameters {
        method: input.one_of(&[
            FitMethod::Kasa,
            FitMethod::Pratt,
            FitMethod::Taubin,
            FitMethod::Expected,
            FitMethod::MostLikely,
        ]),
        range_std: input.positive(),
        beam_half_width: input.share() * 0.1,
        ..FitParameters::default()
    };
    let mut circles = Vec::new();
    let mut fitter = Fitter::new(parameters)?;
    fitter.set_range_std(input.positive())?;
    fitter.fit(&scan, &segments, &mut circles)?;
    fitter.fit_row(&scan)?;
    let mut shapes = Vec::new();
    let mut both = ShapeFitter::new(parameters)?;
    both.set_range_std(input.positive())?;
    both.fit(&scan, &segments, &mut shapes)?;
    both.fit_both(&scan, &segments, &mut Vec::new(), &mut shapes)?;
    for shape in &shapes {
        let _ = (shape.circle(), shape.kind.half_length(), shape.ends());
    }
    map(input, &scan, &circles)
}

fn map(
    input: &mut Input<'_>,
    scan: &PolarScan,
    circles: &[lidar_core::circles::fit::circle::CircleEstimate],
) -> Result<(), Error> {
    let view = ScanWithLimits { scan, range_min: input.positive(), range_max: 30.0 };
    let sorted = view.sorted()?;
    let test = VisibilityTest { margin: input.positive(), min_rays: input.below(6) };
    for circle in circles {
        let _ = sorted.of(&circle.circle, &test);
        let _ = sorted.of_line([circle.circle.center, input.f64s()], &test);
    }
    let parameters =
        if input.is_set() { CircleMapParameters::paper() } else { CircleMapParameters::default() };
    let mut map = CircleMap::new(parameters.clone())?;
    let mut stamp_ns = 0;
    for _ in 0..6 {
        stamp_ns = input.stamp(stamp_ns);
        let pose_covariance = input.maybe(Input::covariance);
        let delays = input.maybe(|input| input.beside(circles.len(), Input::share));
        let _ = map.check_stamp(stamp_ns, 0);
        let _ = map.update(&CircleScan {
            stamp_ns,
            sensor: 0,
            world_from_lidar: &Transform::from_matrix(&input.pose()),
            pose_covariance: pose_covariance.as_ref(),
            estimates: circles,
            delays: delays.as_deref(),
            outlines: &[],
            points: None,
            covered: None,
            lines: &[],
            view: input.is_set().then_some(view),
        });
    }
    let _ = (map.map_at(stamp_ns), map.shapes_at(stamp_ns));
    let _ = map.is_on_line(&[input.f64s()], input.positive(), input.positive());
    let state = map.to_state()?;
    assert_eq!(CircleMap::from_state(parameters, &state)?.to_state()?, state);
    map.reset();
    Ok(())
}

fn window(input: &mut Input<'_>) -> Result<(), Error> {
    let ranges = input.many(40, Input::positive);
    let bearings = input.beside(ranges.len(), |_| 0.0);
    let bearings: Vec<f64> = (0..bearings.len()).map(|ray| 0.02 * ray as f64).collect();
    const SIDES: [Side; 4] = [Side::Free, Side::Occluded, Side::FieldEdge, Side::RangeCut];
    let sides = [input.one_of(&SIDES), input.one_of(&SIDES)];
    let window = SegmentWindow {
        bearings: &bearings,
        ranges: &ranges,
        sides,
        gaps: input.f64s(),
        range_std: input.positive(),
        beam_half_width: input.share(),
        range_limits: [input.f64(), input.f64()],
    };
    let mut slots = vec![0.0; SLOTS * SLOT_NUMBERS];
    let frame = describe(&window, &mut slots, &mut [0.0; CONTEXT])?;
    let _ = circle_of(&frame, &input.f32s());
    Ok(())
}
