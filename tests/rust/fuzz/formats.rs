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

/// A later stamp than any sensible state has.
const LATER_NS: i64 = 1 << 62;
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

/// A valid state with a checksum that is right, and another content: `bytes` as they are, or the
/// valid content with bytes changed at places of which `bytes` tells.
fn forged(valid: &[u8], bytes: &[u8]) -> Vec<u8> {
    let (head, content) = valid[..valid.len() - 4].split_at(9 + usize::from(valid[8]) + 4);
    let mut forged = head.to_vec();
    let [kind, bytes @ ..] = bytes else { return with_checksum(forged) };
    if kind % 2 == 0 {
        forged.extend(bytes);
        return with_checksum(forged);
    }
    let mut changed = content.to_vec();
    for [low, middle, high, value] in bytes.as_chunks().0 {
        let at = u32::from_le_bytes([*low, *middle, *high, 0]) as usize % content.len().max(1);
        if let Some(byte) = changed.get_mut(at) {
            *byte = *value;
        }
    }
    forged.extend(changed);
    with_checksum(forged)
}

pub fn state_map(bytes: &[u8]) {
    let make = || VoxelMap::new(MapParameters { max_voxels: 1 << 16, ..MapParameters::default() });
    let Ok(valid) = make().and_then(|map| map.to_state()) else { return };
    if let Ok(map) = VoxelMap::from_state(&forged(&valid, bytes)) {
        let _ = used_map(map);
    }
}

pub fn state_tracker(bytes: &[u8]) {
    let parameters = TrackerParameters::default();
    let new = PointCloudTracker::new(parameters, 1).and_then(|tracker| tracker.to_state());
    let Ok(valid) = new else { return };
    let made = PointCloudTracker::from_state(parameters, 1, &forged(&valid, bytes));
    let Ok(mut tracker) = made else { return };
    let nothing = OccupiedPoints::new(&[], 1.0);
    let points = [[1.0, 2.0, 3.0], [1.1, 2.0, 3.0], [1.0, 2.1, 3.0]];
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
    let parameters = flying_parameters();
    let new = FlyingObjectDetector::new(parameters.clone(), 1);
    let Ok(valid) = new.and_then(|mut detector| {
        small_scan(&mut detector, 0)?;
        detector.to_state()
    }) else {
        return;
    };
    let made = FlyingObjectDetector::from_state(parameters, 1, &forged(&valid, bytes));
    let Ok(mut detector) = made else { return };
    let _ = detector.sky_rays();
    let _ = detector.static_points();
    for step in 0..3 {
        let _ = small_scan(&mut detector, LATER_NS + step * 100_000_000);
    }
    let _ = detector.tracks_at(LATER_NS + 300_000_000);
    let _ = detector.to_state();
}

fn circle_parameters(bytes: &[u8]) -> CircleMapParameters {
    match bytes.len() % 2 {
        0 => CircleMapParameters::default(),
        _ => CircleMapParameters::paper(),
    }
}

pub fn state_circle_map(bytes: &[u8]) {
    let parameters = circle_parameters(bytes);
    let new = CircleMap::new(parameters.clone()).and_then(|map| map.to_state());
    let Ok(valid) = new else { return };
    let Ok(mut map) = CircleMap::from_state(parameters, &forged(&valid, bytes)) else { return };
    let _ = map.map_at(LATER_NS);
    let _ = map.shapes_at(LATER_NS);
    let _ = map.update(&CircleScan {
        stamp_ns: LATER_NS,
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
    });
    let _ = map.to_state();
}

pub fn state_pipeline(bytes: &[u8]) {
    let map = circle_parameters(bytes);
    let parameters = PipelineParameters { map, ..PipelineParameters::default() };
    let new = CirclePipeline::new(parameters.clone()).and_then(|pipeline| pipeline.to_state());
    let Ok(valid) = new else { return };
    let made = CirclePipeline::from_state(parameters.clone(), &forged(&valid, bytes));
    let Ok(mut pipeline) = made else { return };
    let ranges: Vec<f32> = (0..parameters.scanner.n_beams)
        .map(|ray| if (400..440).contains(&ray) { 3.0 } else { f32::INFINITY })
        .collect();
    for step in 0..3 {
        let _ = pipeline.process(&RawSweep {
            scanner: "lidar",
            stamp_ns: LATER_NS + step * 100_000_000,
            ranges: &ranges,
            poses: &[[1., 0., 0., 0., 0., 1., 0., 0., 0., 0., 1., 0., 0., 0., 0., 1.]],
            pose_stamps_ns: None,
            ray_time_ns: None,
            pose_covariance: None,
        });
    }
    let _ = pipeline.map_at(LATER_NS);
    let _ = pipeline.shapes_at(LATER_NS);
    let _ = pipeline.to_state();
}

fn measured(stamp_ns: i64) -> Result<[Measurement; 2], Error> {
    Ok([
        Measurement::new(stamp_ns, Sensor::Lidar, &[1.0, 2.0], None)?,
        Measurement::new(stamp_ns + 50_000_000, Sensor::Radar, &[2.2, 1.1, 0.1], None)?,
    ])
}

pub fn state_filter(bytes: &[u8]) {
    let mut input = Input::new(bytes);
    let parameters = if input.rarely() {
        FusionParameters::paper()
    } else if input.is_set() {
        ManyParameters::default().filter
    } else {
        FusionParameters::default()
    };
    let new = Filter::new(&parameters).and_then(|filter| filter.to_state(&parameters));
    let Ok(valid) = new else { return };
    let state = forged(&valid, input.rest());
    let Ok(mut filter) = Filter::from_state(&parameters, &state) else { return };
    for m in measured(LATER_NS).into_iter().flatten() {
        let _ = filter.step(&m);
    }
    let _ = filter.output_at(LATER_NS + 300_000_000);
    let _ = filter.to_state(&parameters);
}

pub fn state_many(bytes: &[u8]) {
    let parameters = ManyParameters::default();
    let new = ManyTargets::new(&parameters).and_then(|many| many.to_state());
    let Ok(valid) = new else { return };
    let made = ManyTargets::from_state(&parameters, &forged(&valid, bytes));
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
