//! Ray walk and map update, against the scalar yardstick on the same scans.

use criterion::{BatchSize, Criterion, Throughput, criterion_group, criterion_main};
use lidar_core::Error;
use lidar_core::flying::integrate::integrator::Integrator;
use lidar_core::flying::map::parameters::{MapParameters, Rays};
use lidar_core::flying::map::voxel_map::VoxelMap;
use lidar_core::geometry::lattice::Lattice;
use lidar_core::geometry::traverse::traverse;
use scenes::reference::DenseMap;
use scenes::{MAX_RANGE, VOXEL_SIZE};
use std::ops::ControlFlow;

const SCANS: u64 = 3;

fn raycast(c: &mut Criterion) -> Result<(), Error> {
    for (name, scans) in scenes::all(SCANS)? {
        let mut group = c.benchmark_group(format!("raycast/{name}"));
        group.sample_size(20);
        group.throughput(Throughput::Elements(scans[0].world.len() as u64));

        let lattice = Lattice::new(VOXEL_SIZE, [0.0; 3])?;
        group.bench_function("traverse", |b| {
            b.iter(|| {
                let mut visits = 0u64;
                for direction in &scans[0].directions {
                    let origin = scans[0].origin;
                    let end = std::array::from_fn(|axis| {
                        origin[axis] + MAX_RANGE * f64::from(direction[axis])
                    });
                    let count = |_, _| {
                        visits += 1;
                        ControlFlow::Continue(())
                    };
                    traverse(&lattice, origin, end, count)?;
                }
                Ok::<_, Error>(visits)
            });
        });

        let mut dense = DenseMap::new([-50.0, -50.0, -1.0]);
        let mut next = scans.iter().cycle();
        group.bench_function("ray_scalar", |b| {
            b.iter_batched(
                || next.next(),
                |scan| scan.map(|scan| dense.integrate(scan)),
                BatchSize::PerIteration,
            );
        });

        for (threads, rays) in [(1, Rays::All), (2, Rays::All), (1, Rays::OnePerEnd)] {
            let mut map = VoxelMap::new(MapParameters { rays, ..MapParameters::default() })?;
            let mut integrator = Integrator::new(threads)?;
            for scan in &scans {
                integrator.integrate(&mut map, &scan.classified())?;
            }
            let mut next = scans.iter().cycle();
            let title = if rays == Rays::All { "integrate" } else { "one_per_end" };
            group.bench_function(format!("{title}_{threads}_threads"), |b| {
                b.iter_batched(
                    || next.next(),
                    |scan| scan.map(|scan| integrator.integrate(&mut map, &scan.classified())),
                    BatchSize::PerIteration,
                );
            });
        }
        group.finish();
    }
    Ok(())
}

fn run(c: &mut Criterion) {
    if let Err(error) = raycast(c) {
        std::process::exit(i32::from(!error.to_string().is_empty()));
    }
}

criterion_group!(benches, run);
criterion_main!(benches);
