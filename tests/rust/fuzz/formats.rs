//! Saved maps and saved states: bytes of another program with a checksum that is right.

use super::flying::{flying_parameters, small_scan};
use super::input::Input;
use lidar_core::Error;
use lidar_core::circles::map::{CircleMap, CircleMapParameters, CircleScan};
use lidar_core::circles::parameters::PipelineParameters;
use lidar_core::circles::pipeline::{CirclePipeline, RawSweep};
use lidar_core::flying::detector::FlyingObjectDetector;
use lidar_core::flying::map::parameters::{MapParameters, Separation};
use lidar_core::flying::map::voxel_map::VoxelMap;
use lidar_core::flying::track::{Detections, OccupiedPoints, PointCloudTracker, TrackerParameters};
use lidar_core::fusion::{
    Filter, FusionParameters, ManyParameters, ManyTargets, Measurement, Sensor,
};
use lidar_core::geometry::transform::Transform;
use std::path::Path;
use std::sync::LazyLock;

/// A later stamp than any sensible state has.
const LATER_NS: i64 = 1 << 62;
/// Returns of a target.
const TARGET: [[f32; 3]; 3] = [[1.0, 2.0, 3.0], [1.1, 2.0, 3.0], [1.0, 2.1, 3.0]];
/// Larger maps than these only cost time.
const MOST_VOXELS: u64 = 1 << 20;

/// CRC-32 (IEEE 802.3), bit by bit.
fn crc32(bytes: &[u8]) -> u32 {
    !bytes.iter().fold(u32::MAX, |crc, &byte| {
        (0..8).fold(crc ^ u32::from(byte), |crc, _| {
            if crc & 1 == 1 { crc >> 1 ^ 0xEDB8_8320 } else { crc >> 1 }
        })
    })
}

fn with_checksum(mut bytes: Vec<u8>) -> Vec<u8> {
    bytes.extend(crc32(&bytes).to_le_bytes());
    bytes
}

/// A map file; the first byte decides whether its checksum is mended, and now and then that the map
/// is used, which takes a hundred times as long as reading it.
pub fn lcvm(bytes: &[u8]) {
    let [mended, bytes @ ..] = bytes else { return };
    let bytes = if mended % 4 == 3 { bytes.to_vec() } else { with_checksum(bytes.to_vec()) };
    let Ok(map) = VoxelMap::from_bytes(&bytes) else { return };
    assert_eq!(
        VoxelMap::from_bytes(&map.to_bytes()).map(|again| again.to_bytes()).ok(),
        Some(map.to_bytes())
    );
    if mended / 4 % 16 == 0 {
        let _ = used_map(map);
    }
}

fn used_map(mut map: VoxelMap) -> Result<(), Error> {
    let _ = map.occupied_voxels();
    let _ = map.observed_voxels();
    let size = map.lattice().voxel_size();
    let near = map.lattice().origin().map(|origin| (origin + size) as f32);
    map.set_occupied(&[near])?;
    if map.parameters().max_voxels < MOST_VOXELS {
        map.remove_separate(Separation { max_gap: size, ..Separation::default() })?;
    }
    if size > 0.05 && size < 10.0 && map.parameters().max_range < 200.0 {
        let mut detector = FlyingObjectDetector::new(flying_parameters(), 1)?;
        if detector.set_map(map).is_ok() {
            small_scan(&mut detector, LATER_NS)?;
        }
    }
    Ok(())
}

/// Valid states of an object, after none and more and more steps; made once.
type Bases = LazyLock<Vec<Vec<u8>>>;

/// States of `object` after 0, 1, 2, ... calls of `step`, as many as succeed, at most `most`.
fn states_of<O>(
    object: Result<O, Error>,
    most: i64,
    to_state: impl Fn(&O) -> Result<Vec<u8>, Error>,
    step: impl Fn(&mut O, i64) -> Result<(), Error>,
) -> Vec<Vec<u8>> {
    let Ok(mut object) = object else { return Vec::new() };
    let mut states: Vec<_> = to_state(&object).into_iter().collect();
    for number in 0..most {
        if step(&mut object, number * 100_000_000).is_ok() {
            states.extend(to_state(&object));
        }
    }
    states
}

/// A state with a checksum that is right, and the head of a valid one. The first byte says what its
/// content is: `bytes` as they are, or that of one of `bases` with bytes or whole numbers changed at
/// places of which `bytes` tells; the highest bit of a place says that the number has a sign.
fn forged(bases: &[Vec<u8>], bytes: &[u8]) -> Vec<u8> {
    let [kind, bytes @ ..] = bytes else { return Vec::new() };
    let Some(valid) = bases.get(usize::from(kind / 3) % bases.len().max(1)) else {
        return Vec::new();
    };
    let (head, content) = valid[..valid.len() - 4].split_at(9 + usize::from(valid[8]) + 4);
    let mut forged = head.to_vec();
    let at = |low, middle, high| {
        u32::from_le_bytes([low, middle, high, 0]) as usize % content.len().max(1)
    };
    match kind % 3 {
        0 => forged.extend(bytes),
        1 => {
            forged.extend(content);
            for &[low, middle, high, value] in bytes.as_chunks().0 {
                if let Some(byte) = forged.get_mut(head.len() + at(low, middle, high)) {
                    *byte = value;
                }
            }
        }
        _ => {
            let mut changed = content.to_vec();
            // Eight bytes a number, as the program compares it: libFuzzer can put in what it is compared with.
            for &[low, middle, high, ref value @ ..] in bytes.as_chunks::<11>().0 {
                let value = i64::from_le_bytes(*value);
                let signed = (value << 1 ^ value >> 63).cast_unsigned();
                let number = if high & 0x80 == 0 { value.cast_unsigned() } else { signed };
                put_number(&mut changed, at(low, middle, high & 0x7F), number);
            }
            forged.extend(changed);
        }
    }
    with_checksum(forged)
}

/// Replace the number that begins at a place, as postcard writes one: seven bits a byte, the lowest
/// first.
fn put_number(content: &mut Vec<u8>, at: usize, mut left: u64) {
    let Some(rest) = content.get(at..) else { return };
    let old = rest.iter().take_while(|&&byte| byte >= 0x80).count() + 1;
    let mut new = Vec::new();
    while left >= 0x80 {
        new.push(left as u8 | 0x80);
        left >>= 7;
    }
    new.push(left as u8);
    content.splice(at..(at + old).min(content.len()), new);
}

pub fn state_map(bytes: &[u8]) {
    static BASES: Bases = LazyLock::new(|| {
        let parameters = MapParameters { max_voxels: 1 << 16, ..MapParameters::default() };
        states_of(VoxelMap::new(parameters), 2, VoxelMap::to_state, |map, stamp_ns| {
            map.set_occupied(&[[1.0 + (stamp_ns as f32) * 1e-8, 2.0, 3.0], [0.1, 0.2, 0.3]])
        })
    });
    if let Ok(map) = VoxelMap::from_state(&forged(&BASES, bytes)) {
        let _ = used_map(map);
    }
}

pub fn state_tracker(bytes: &[u8]) {
    static BASES: Bases = LazyLock::new(|| {
        let new = PointCloudTracker::new(TrackerParameters::default(), 1);
        states_of(new, 4, PointCloudTracker::to_state, |tracker, stamp_ns| {
            // The first scan is empty: its state is short, so that changes meet what decides.
            let points: &[_] = if stamp_ns == 0 { &[] } else { &TARGET };
            let nothing = OccupiedPoints::new(&[], 1.0);
            tracker.new_point_cloud(points, None, &nothing, None, stamp_ns).map(|_| ())
        })
    });
    let parameters = TrackerParameters::default();
    let made = PointCloudTracker::from_state(parameters, 1, &forged(&BASES, bytes));
    let Ok(mut tracker) = made else { return };
    let nothing = OccupiedPoints::new(&[], 1.0);
    let points = TARGET;
    let detections =
        Detections { stamp_ns: LATER_NS, positions: &[[1.0, 2.0, 3.0]], ..Detections::default() };
    let _ = tracker.tracks_at(LATER_NS);
    let _ = tracker.new_point_cloud(&points, None, &nothing, None, LATER_NS);
    let _ = tracker.new_detections(&detections, &nothing);
    let _ = tracker.new_point_cloud(&points, None, &nothing, None, LATER_NS + 100_000_000);
    let _ = tracker.tracks_at(LATER_NS + 200_000_000);
    let _ = tracker.to_state();
}

pub fn state_detector(bytes: &[u8]) {
    static BASES: Bases = LazyLock::new(|| {
        let new = FlyingObjectDetector::new(flying_parameters(), 1);
        states_of(new, 3, FlyingObjectDetector::to_state, small_scan)
    });
    let made = FlyingObjectDetector::from_state(flying_parameters(), 1, &forged(&BASES, bytes));
    let Ok(mut detector) = made else { return };
    let _ = detector.sky_rays();
    let _ = detector.static_points();
    for step in 0..3 {
        let _ = small_scan(&mut detector, LATER_NS + step * 100_000_000);
    }
    let _ = detector.tracks_at(LATER_NS + 300_000_000);
    let _ = detector.to_state();
}

/// Parameters of a map of circles by a byte, and the number of their states.
fn circle_parameters(choice: u8) -> (usize, CircleMapParameters) {
    match choice % 2 {
        0 => (0, CircleMapParameters::default()),
        _ => (1, CircleMapParameters::paper()),
    }
}

pub fn state_circle_map(bytes: &[u8]) {
    static BASES: [Bases; 2] = [
        LazyLock::new(|| circle_maps(CircleMapParameters::default())),
        LazyLock::new(|| circle_maps(CircleMapParameters::paper())),
    ];
    let [choice, bytes @ ..] = bytes else { return };
    let (number, parameters) = circle_parameters(*choice);
    let state = forged(&BASES[number], bytes);
    let Ok(mut map) = CircleMap::from_state(parameters, &state) else { return };
    let _ = map.map_at(LATER_NS);
    let _ = map.shapes_at(LATER_NS);
    let _ = empty_sweep(&mut map, LATER_NS);
    let _ = map.to_state();
}

fn circle_maps(parameters: CircleMapParameters) -> Vec<Vec<u8>> {
    states_of(CircleMap::new(parameters), 1, CircleMap::to_state, empty_sweep)
}

fn empty_sweep(map: &mut CircleMap, stamp_ns: i64) -> Result<(), Error> {
    map.update(&CircleScan {
        stamp_ns,
        sensor: 0,
        world_from_lidar: &Transform::default(),
        pose_covariance: None,
        estimates: &[],
        delays: None,
        outlines: &[],
        points: None,
        covered: None,
        lines: &[],
        view: None,
    })?;
    Ok(())
}

pub fn state_pipeline(bytes: &[u8]) {
    static BASES: [Bases; 2] = [
        LazyLock::new(|| pipelines(CircleMapParameters::default())),
        LazyLock::new(|| pipelines(CircleMapParameters::paper())),
    ];
    let [choice, bytes @ ..] = bytes else { return };
    let (number, map) = circle_parameters(*choice);
    let parameters = PipelineParameters { map, ..PipelineParameters::default() };
    let state = forged(&BASES[number], bytes);
    let Ok(mut pipeline) = CirclePipeline::from_state(parameters, &state) else { return };
    for step in 0..3 {
        let _ = sweep(&mut pipeline, LATER_NS + step * 100_000_000);
    }
    let _ = pipeline.map_at(LATER_NS);
    let _ = pipeline.shapes_at(LATER_NS);
    let _ = pipeline.to_state();
}

fn pipelines(map: CircleMapParameters) -> Vec<Vec<u8>> {
    let parameters = PipelineParameters { map, ..PipelineParameters::default() };
    states_of(CirclePipeline::new(parameters), 3, CirclePipeline::to_state, sweep)
}

/// A post before the scanner.
fn sweep(pipeline: &mut CirclePipeline, stamp_ns: i64) -> Result<(), Error> {
    let ranges: Vec<f32> = (0..PipelineParameters::default().scanner.n_beams)
        .map(|ray| if (400..440).contains(&ray) { 3.0 } else { f32::INFINITY })
        .collect();
    pipeline.process(&RawSweep {
        scanner: "lidar",
        stamp_ns,
        ranges: &ranges,
        poses: &[[1., 0., 0., 0., 0., 1., 0., 0., 0., 0., 1., 0., 0., 0., 0., 1.]],
        pose_stamps_ns: None,
        ray_time_ns: None,
        pose_covariance: None,
    })?;
    Ok(())
}

fn measured(stamp_ns: i64) -> Result<[Measurement; 2], Error> {
    Ok([
        Measurement::new(stamp_ns, Sensor::Lidar, &[1.0, 2.0], None)?,
        Measurement::new(stamp_ns + 50_000_000, Sensor::Radar, &[2.2, 1.1, 0.1], None)?,
    ])
}

pub fn state_filter(bytes: &[u8]) {
    static BASES: [Bases; 3] = [
        LazyLock::new(|| filters(FusionParameters::default())),
        LazyLock::new(|| filters(FusionParameters::paper())),
        LazyLock::new(|| filters(ManyParameters::default().filter)),
    ];
    let mut input = Input::new(bytes);
    let (number, parameters) = match input.below(8) {
        0 => (1, FusionParameters::paper()),
        1..4 => (2, ManyParameters::default().filter),
        _ => (0, FusionParameters::default()),
    };
    let state = forged(&BASES[number], input.rest());
    let Ok(mut filter) = Filter::from_state(&parameters, &state) else { return };
    for m in measured(LATER_NS).into_iter().flatten() {
        let _ = filter.step(&m);
    }
    let _ = filter.output_at(LATER_NS + 300_000_000);
    let _ = filter.to_state(&parameters);
}

fn filters(parameters: FusionParameters) -> Vec<Vec<u8>> {
    let to_state = |filter: &Filter| filter.to_state(&parameters);
    states_of(Filter::new(&parameters), 4, to_state, |filter, stamp_ns| {
        for m in measured(stamp_ns)? {
            filter.step(&m);
        }
        Ok(())
    })
}

pub fn state_many(bytes: &[u8]) {
    static BASES: Bases = LazyLock::new(|| {
        let new = ManyTargets::new(&ManyParameters::default());
        states_of(new, 4, ManyTargets::to_state, |many, stamp_ns| {
            let [lidar, radar] = measured(stamp_ns)?;
            many.process(lidar.stamp_ns(), 0, &[lidar])?;
            many.process(radar.stamp_ns(), 1, &[radar]).map(drop)
        })
    });
    let parameters = ManyParameters::default();
    let made = ManyTargets::from_state(&parameters, &forged(&BASES, bytes));
    let Ok(mut many) = made else { return };
    let _ = many.tracks_at(LATER_NS);
    for step in 0..2 {
        let Ok([lidar, radar]) = measured(LATER_NS + step * 200_000_000) else { return };
        let _ = many.process(lidar.stamp_ns(), 0, &[lidar]);
        let _ = many.process(radar.stamp_ns(), 1, &[radar]);
    }
    let _ = many.tracks_at(LATER_NS + 900_000_000);
    let _ = many.work();
    let _ = many.to_state();
}

/// Files that are there and files that are not, for the functions that take a path.
pub fn paths(detector: &mut FlyingObjectDetector) {
    let nowhere = Path::new("/nonexistent/map.lcvm");
    let _ = VoxelMap::load(nowhere);
    let _ = detector.map().save(nowhere);
    let _ = detector.save_map(nowhere);
    let _ = detector.load_map(nowhere);
    let _ = detector.save_static_map(nowhere);
}
