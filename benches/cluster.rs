//! Euclidean clustering of all returns of a scan, against the plain voxel hash.

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use lidar_core::Error;
use lidar_core::geometry::cluster::label;
use scenes::CLUSTERING;
use scenes::reference::cluster_hash;

fn cluster(c: &mut Criterion) -> Result<(), Error> {
    for (name, scans) in scenes::all(1)? {
        let points = scans[0].returns();
        let mut group = c.benchmark_group(format!("cluster/{name}"));
        group.sample_size(20);
        group.throughput(Throughput::Elements(points.len() as u64));
        group.bench_function("cluster_hash", |b| {
            b.iter(|| cluster_hash(&points, CLUSTERING.max_distance))
        });
        group.bench_function("label", |b| b.iter(|| label(&points, &CLUSTERING)));
        group.finish();
    }
    Ok(())
}

fn run(c: &mut Criterion) {
    if let Err(error) = cluster(c) {
        std::process::exit(i32::from(!error.to_string().is_empty()));
    }
}

criterion_group!(benches, run);
criterion_main!(benches);
