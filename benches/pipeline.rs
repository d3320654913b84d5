//! Tracking, and the whole scan from raw points to tracks.

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use lidar_core::Error;
use lidar_core::flying::detector::FlyingObjectDetector;
use lidar_core::flying::parameters::FlyingParameters;
use lidar_core::flying::track::{Detections, OccupiedPoints, PointCloudTracker, TrackerParameters};
use scenes::street;
use std::time::Instant;

const PERIOD_NS: i64 = 100_000_000;

fn whole_scan(c: &mut Criterion) -> Result<(), Error> {
    for (name, scans) in scenes::all(20)? {
        let mut group = c.benchmark_group(format!("pipeline/{name}"));
        group.sample_size(10);
        group.throughput(Throughput::Elements(scans[0].world.len() as u64));
        for threads in [1, 2] {
            let mut detector = FlyingObjectDetector::new(FlyingParameters::default(), threads)?;
            let mut stamp_ns = 0;
            for scan in &scans {
                stamp_ns += PERIOD_NS;
                detector.process(&scan.raw(stamp_ns))?;
            }
            // back and forth along the street: the sensor never jumps
            let mut next = scans.iter().rev().chain(&scans).cycle();
            group.bench_function(format!("process_{threads}_threads"), |b| {
                b.iter(|| {
                    stamp_ns += PERIOD_NS;
                    next.next().map(|scan| detector.process(&scan.raw(stamp_ns)))
                });
            });
        }
        group.finish();
    }
    Ok(())
}

fn track(c: &mut Criterion) -> Result<(), Error> {
    let points = street(2, 1)?[0].returns();
    let occupied = OccupiedPoints::new(&points, 0.7);
    let mut group = c.benchmark_group("track");
    group.sample_size(10);
    for targets in [1, 10, 100] {
        let positions: Vec<[f64; 3]> = (0..targets)
            .map(|k| [f64::from(k % 10) * 4.0, f64::from(k / 10) * 4.0, 30.0])
            .collect();
        let mut cloud = points.clone();
        for position in &positions {
            for step in [-0.1f32, 0.0, 0.1] {
                cloud.push([position[0] as f32 + step, position[1] as f32, position[2] as f32]);
            }
        }
        let mut tracker = PointCloudTracker::new(TrackerParameters::default(), 1)?;
        let mut stamp_ns = 0;
        group.bench_function(format!("cloud_and_detections_{targets}_targets"), |b| {
            b.iter_custom(|rounds| {
                let start = Instant::now();
                for _ in 0..rounds {
                    stamp_ns += PERIOD_NS;
                    let detections =
                        Detections { stamp_ns, positions: &positions, ..Detections::default() };
                    let seen = tracker.new_point_cloud(&cloud, None, &occupied, None, stamp_ns);
                    std::hint::black_box(seen.is_ok());
                    std::hint::black_box(tracker.new_detections(&detections, &occupied).is_ok());
                }
                start.elapsed()
            });
        });
    }
    group.finish();
    Ok(())
}

fn run(c: &mut Criterion) {
    if let Err(error) = track(c).and_then(|()| whole_scan(c)) {
        std::process::exit(i32::from(!error.to_string().is_empty()));
    }
}

criterion_group!(benches, run);
criterion_main!(benches);
