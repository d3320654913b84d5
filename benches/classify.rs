//! Classification of the clusters of a scan, and removal of separate voxels.

use criterion::{BatchSize, Criterion, Throughput, criterion_group, criterion_main};
use lidar_core::Error;
use lidar_core::flying::classify::classifier::classify_clusters;
use lidar_core::flying::classify::parameters::ClassifyParameters;
use lidar_core::flying::integrate::integrator::Integrator;
use lidar_core::flying::map::parameters::{MapParameters, Separation};
use lidar_core::flying::map::voxel_map::VoxelMap;
use lidar_core::geometry::cluster::{Clustering, label};
use lidar_core::util::threads::Workers;
use scenes::street;

fn classify(c: &mut Criterion) -> Result<(), Error> {
    for number in [1, 2] {
        let scans = street(number, 4)?;
        let mut map = VoxelMap::new(MapParameters::default())?;
        let mut integrator = Integrator::new(1)?;
        for scan in &scans[..3] {
            integrator.integrate(&mut map, &scan.classified())?;
            map.remove_separate(Separation::default())?;
        }
        let scan = &scans[3];
        let labels = label(&scan.world, &Clustering::default())?;
        let parameters = ClassifyParameters::default();
        let mut group = c.benchmark_group(format!("classify/scene_{number}"));
        group.sample_size(20);
        group.throughput(Throughput::Elements(scan.world.len() as u64));
        group.bench_function("classify", |b| {
            let workers = Workers::default();
            b.iter(|| {
                classify_clusters(&map, &scan.world, &labels, scan.origin, &parameters, &workers)
            });
        });
        let mut next = scans.iter().cycle();
        group.bench_function("remove_separate", |b| {
            b.iter_custom(|rounds| {
                (0..rounds)
                    .filter_map(|_| next.next())
                    .map(|scan| {
                        let integrated = integrator.integrate(&mut map, &scan.classified()).is_ok();
                        let start = std::time::Instant::now();
                        let removed = map.remove_separate(Separation::default());
                        std::hint::black_box((integrated, removed).0);
                        start.elapsed()
                    })
                    .sum()
            });
        });
        let fresh = || VoxelMap::from_bytes(&map.to_bytes());
        group.bench_function("remove_separate_everything", |b| {
            b.iter_batched(
                fresh,
                |map| map.and_then(|mut map| map.remove_separate(Separation::default())),
                BatchSize::PerIteration,
            );
        });
        group.finish();
    }
    Ok(())
}

fn run(c: &mut Criterion) {
    if let Err(error) = classify(c) {
        std::process::exit(i32::from(!error.to_string().is_empty()));
    }
}

criterion_group!(benches, run);
criterion_main!(benches);
