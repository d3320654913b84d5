//! Euclidean clustering of all returns of a scan, against the plain voxel hash.

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use lidar_core::Error;
use lidar_core::geometry::cluster::{Clustering, Labeller, label};
use scenes::reference::cluster_hash;
use std::hint::black_box;
use std::time::{Duration, Instant};

fn cluster(c: &mut Criterion) -> Result<(), Error> {
    for (name, scans) in scenes::all(1)? {
        let points = scans[0].returns();
        let mut labeller = Labeller::default();
        let clustering = Clustering::default();
        let mut plain = || black_box(cluster_hash(&points, clustering.max_distance)) > 0;
        let mut fresh = || black_box(label(&points, &clustering)).is_ok();
        let mut kept = || black_box(labeller.label(&points, &clustering)).is_ok();
        let mut group = c.benchmark_group(format!("cluster/{name}"));
        group.sample_size(20);
        group.throughput(Throughput::Elements(points.len() as u64));
        group.bench_function("cluster_hash", |b| {
            b.iter_custom(|rounds| in_turn(rounds, &mut plain, &mut fresh));
        });
        group.bench_function("label", |b| {
            b.iter_custom(|rounds| in_turn(rounds, &mut fresh, &mut plain));
        });
        group.bench_function("label_in_memory_used_again", |b| {
            b.iter_custom(|rounds| in_turn(rounds, &mut kept, &mut plain));
        });
        group.finish();
    }
    Ok(())
}

/// Time of `timed`, in turn with `other`: in a pipeline too, something else comes between two calls.
fn in_turn(
    rounds: u64,
    timed: &mut impl FnMut() -> bool,
    other: &mut impl FnMut() -> bool,
) -> Duration {
    let round = |_| {
        black_box(other());
        let start = Instant::now();
        black_box(timed());
        start.elapsed()
    };
    (0..rounds).map(round).sum()
}

fn run(c: &mut Criterion) {
    if let Err(error) = cluster(c) {
        std::process::exit(i32::from(!error.to_string().is_empty()));
    }
}

criterion_group!(benches, run);
criterion_main!(benches);
