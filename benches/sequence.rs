//! Update of a map that grows: the scenes over 61 scans, beside the scalar yardstick on the same scans.
//!
//! Criterion repeats one piece of work. Here every scan finds the map that the scans before it have
//! left, so whole sequences are repeated, the systems in turn, and the least time counts per scan.
//! `LIDAR_CORE_REPEATS` sets how often.

use lidar_core::Error;
use lidar_core::flying::integrate::integrator::Integrator;
use lidar_core::flying::map::parameters::{MapParameters, Skip};
use lidar_core::flying::map::voxel_map::VoxelMap;
use lidar_sim::scenes::SEQUENCE;
use scenes::figures::{Figure, keep};
use scenes::reference::DenseMap;
use scenes::{Scan, street};
use std::io::{Write, stdout};
use std::time::Instant;

/// From this scan on the map is in its steady state.
const STEADY_FROM: usize = 15;
const REPEATS: usize = 9;

/// A system, and the least time that it took for each scan so far [ms].
struct System {
    name: String,
    least: Vec<f64>,
}

impl System {
    /// Note one run over all scans.
    fn note(
        &mut self,
        scans: &[Scan],
        mut integrate: impl FnMut(&Scan) -> Result<(), Error>,
    ) -> Result<(), Error> {
        self.least.resize(scans.len(), f64::INFINITY);
        for (scan, least) in scans.iter().zip(&mut self.least) {
            let start = Instant::now();
            integrate(scan)?;
            *least = least.min(start.elapsed().as_secs_f64() * 1e3);
        }
        Ok(())
    }

    /// Time of the first scan, and the median of the steady state [ms].
    fn times(&self) -> [f64; 2] {
        [self.least[0], median(&self.least[STEADY_FROM..])]
    }
}

fn median(values: &[f64]) -> f64 {
    let mut values = values.to_vec();
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

/// Time every system on a scene, print how it compares, and return its figures.
fn compare(
    number: u32,
    repeats: usize,
) -> Result<Vec<Figure<'static>>, Box<dyn std::error::Error>> {
    let scans = street(number, SEQUENCE)?;
    let mut reference = System { name: "ray_scalar".to_owned(), least: Vec::new() };
    let mut systems: Vec<(System, usize, Skip)> = Vec::new();
    for (title, skip) in [("integrate", Skip::Saturated), ("skip_none", Skip::Nothing)] {
        for threads in [1, 2] {
            let name = format!("{title}_{threads}_threads");
            systems.push((System { name, least: Vec::new() }, threads, skip));
        }
    }
    for _ in 0..repeats {
        let mut dense = DenseMap::new([-50.0, -50.0, -1.0]);
        reference.note(&scans, |scan| {
            dense.integrate(scan);
            Ok(())
        })?;
        for (system, threads, skip) in &mut systems {
            let parameters = MapParameters { skip: *skip, ..MapParameters::default() };
            let mut map = VoxelMap::new(parameters)?;
            let mut integrator = Integrator::new(*threads)?;
            system.note(&scans, |scan| {
                integrator.integrate(&mut map, &scan.classified()).map(|_| ())
            })?;
        }
    }
    let [_, yardstick] = reference.times();
    let mut figures = Vec::new();
    for system in [&reference].into_iter().chain(systems.iter().map(|(system, ..)| system)) {
        let [first, steady] = system.times();
        let (name, of_first, of_steady) = (&system.name, first / yardstick, steady / yardstick);
        writeln!(
            stdout(),
            "sequence/scene_{number}/{name}: first {first:.2} ms, ratio {of_first:.3}; \
             steady {steady:.2} ms, ratio {of_steady:.3}",
        )?;
        let values = [("first", of_first), ("steady", of_steady), ("steady_ms", steady)];
        figures.push((format!("scene_{number}/{name}"), values.to_vec()));
    }
    Ok(figures)
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let repeats = std::env::var("LIDAR_CORE_REPEATS").ok().and_then(|text| text.parse().ok());
    let mut figures = Vec::new();
    for number in [1, 2] {
        figures.extend(compare(number, repeats.unwrap_or(REPEATS))?);
    }
    Ok(keep("sequence", &figures)?)
}
