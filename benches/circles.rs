//! Circles: ten objects in a sweep of 1081 rays, stage by stage and from ranges to the map.

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use lidar_core::Error;
use lidar_core::circles::fit::{FitMethod, Fitter};
use lidar_core::circles::parameters::PipelineParameters;
use lidar_core::circles::pipeline::{CirclePipeline, RawSweep};
use lidar_core::circles::preprocess::misses::Misses;
use lidar_core::circles::preprocess::polar_scan::PolarScan;
use lidar_core::circles::preprocess::projection::{self, Projection};
use lidar_core::circles::preprocess::sweep_poses::SweepPoses;
use lidar_core::circles::segment::segmentation::segment;
use lidar_core::geometry::transform::Transform;
use std::f64::consts::PI;
use std::hint::black_box;

const BEAMS: usize = 1081;
const OBJECTS: usize = 10;
const PERIOD_NS: i64 = 50_000_000;

fn bearings() -> Vec<f64> {
    (0..BEAMS).map(|ray| (ray as f64 * 0.25 - 135.0) * PI / 180.0).collect()
}

/// A sensor that is pitched by 0.1 rad.
const POSE: [f64; 16] = [
    0.995_004_165,
    0.0,
    0.099_833_417,
    0.0,
    0.0,
    1.0,
    0.0,
    0.0,
    -0.099_833_417,
    0.0,
    0.995_004_165,
    1.0,
    0.0,
    0.0,
    0.0,
    1.0,
];

/// Ranges of the pitched sensor to upright cylinders around it, which move at 0.1 m/s, every other one
/// the other way, with noise of 0.01 m from a fixed sequence.
fn ranges(scan: i64) -> Vec<f32> {
    let moved = scan as f64 * 0.05 - 1.0;
    let objects: Vec<[f64; 3]> = (0..OBJECTS)
        .map(|k| {
            let (bearing, range) = (-2.1 + 0.45 * k as f64, 3.0 + (k % 3) as f64 * 1.5);
            let [x, y] = [range * bearing.cos(), range * bearing.sin()];
            let way = if k % 2 == 0 { 0.1 } else { -0.1 };
            [x + way * moved, y, 0.1 + 0.04 * k as f64]
        })
        .collect();
    let mut state = scan.cast_unsigned();
    let mut noise = move || {
        let uniform = (0..4).map(|_| {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963_407);
            (state >> 11) as f64 / (1_u64 << 53) as f64 - 0.5
        });
        0.01 * uniform.sum::<f64>() / (4.0_f64 / 12.0).sqrt()
    };
    let met = |bearing: f64| {
        let [dx, dy] = [POSE[0] * bearing.cos(), bearing.sin()];
        let square = dx * dx + dy * dy;
        let hit = |&[x, y, radius]: &[f64; 3]| {
            let along = dx * x + dy * y;
            let root = along * along - square * (x * x + y * y - radius * radius);
            if root < 0.0 || along < 0.0 { f64::INFINITY } else { (along - root.sqrt()) / square }
        };
        objects.iter().map(hit).fold(f64::INFINITY, f64::min)
    };
    bearings().into_iter().map(|bearing| (met(bearing) + noise()) as f32).collect()
}

/// What ships, in an operating volume.
fn parameters() -> PipelineParameters {
    PipelineParameters {
        planes: vec![[0.0, 0.0, 1.0, 3.0], [0.0, 0.0, -1.0, -0.1]],
        ..PipelineParameters::default()
    }
}

fn stages(c: &mut Criterion) -> Result<(), Error> {
    let parameters = parameters();
    let bearings = bearings();
    let directions = projection::directions(&bearings);
    let limits = parameters.scanner.range_limits;
    let ranges = Misses::default().marked(&ranges(0), limits, limits[0]);
    let sweep = SweepPoses::still(Transform::from_matrix(&POSE));
    let raw = PolarScan { ranges, bearings };
    let level = projection::project(&raw, &directions, &sweep, Projection::Exact)?;
    let segments = segment(&level.scan, None, &parameters.segment)?;
    let mut fitter = Fitter::new(parameters.fit)?;
    let mut circles = Vec::new();
    let mut group = c.benchmark_group("circles/stage");
    group.throughput(Throughput::Elements(BEAMS as u64));
    group.bench_function("limit_range", |b| {
        b.iter(|| projection::limit_range(&raw.ranges, &directions, &sweep, &parameters.planes));
    });
    group.bench_function("project_horizontal", |b| {
        b.iter(|| projection::project(&raw, &directions, &sweep, Projection::Exact));
    });
    group.bench_function("segment", |b| {
        b.iter(|| segment(&level.scan, None, &parameters.segment));
    });
    group.bench_function(format!("fit_{}_circles", segments.len()), |b| {
        b.iter(|| fitter.fit(&level.scan, &segments, black_box(&mut circles)));
    });
    group.finish();
    Ok(())
}

fn whole(c: &mut Criterion) -> Result<(), Error> {
    let sweeps: Vec<Vec<f32>> = (0..40).map(ranges).collect();
    let mut group = c.benchmark_group("circles");
    for (name, method) in [("ml", FitMethod::Expected), ("taubin", FitMethod::Taubin)] {
        let mut parameters = parameters();
        parameters.fit.method = method;
        let mut pipeline = CirclePipeline::new(parameters)?;
        let mut stamp_ns = 0;
        let mut process = |ranges: &[f32]| {
            stamp_ns += PERIOD_NS;
            pipeline.process(&RawSweep {
                scanner: "lidar",
                stamp_ns,
                ranges,
                poses: &[POSE],
                pose_stamps_ns: None,
                ray_time_ns: None,
                pose_covariance: None,
            })
        };
        for ranges in &sweeps {
            process(ranges)?;
        }
        // back and forth: the objects never jump
        let mut next = sweeps.iter().rev().chain(&sweeps).cycle();
        group.bench_function(format!("scan_10_objects_1081_beams_{name}"), |b| {
            b.iter(|| next.next().map(|ranges| process(ranges)));
        });
    }
    group.finish();
    Ok(())
}

fn run(c: &mut Criterion) {
    if let Err(error) = stages(c).and_then(|()| whole(c)) {
        std::process::exit(i32::from(!error.to_string().is_empty()));
    }
}

criterion_group!(benches, run);
criterion_main!(benches);
