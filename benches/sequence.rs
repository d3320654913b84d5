//! Update of a map that grows: the scenes over 61 scans, beside the scalar yardstick on the same scans.
//!
//! Criterion repeats one piece of work. Here every scan finds the map that the scans before it have
//! left, so whole sequences are repeated, the systems in turn, and the least time counts per scan.
//! `LIDAR_CORE_REPEATS` sets how often. The whole detector follows: what it takes for a scan, and for
//! clusters and their classes, beside the plain voxel hash. At last a LiDAR with few rays.

use lidar_core::Error;
use lidar_core::flying::detector::FlyingObjectDetector;
use lidar_core::flying::integrate::integrator::Integrator;
use lidar_core::flying::map::parameters::{MapParameters, Skip};
use lidar_core::flying::map::voxel_map::VoxelMap;
use lidar_core::flying::parameters::FlyingParameters;
use lidar_core::geometry::cluster::Clustering;
use lidar_sim::scenes::SEQUENCE;
use scenes::figures::{Figure, keep};
use scenes::reference::{DenseMap, cluster_hash};
use scenes::{Scan, street};
use std::hint::black_box;
use std::io::{Write, stdout};
use std::time::Instant;

/// From this scan on the map is in its steady state.
const STEADY_FROM: usize = 15;
const REPEATS: usize = 9;
const PERIOD_NS: i64 = 100_000_000;
/// Rows of a scan, columns of a row, and rows of which the LiDAR with few rays has one.
const ROWS: usize = 128;
const COLUMNS: usize = 1024;
const EVERY: usize = 8;

/// A system, and the least time that it took for each scan so far [ms].
struct System {
    name: String,
    least: Vec<f64>,
}

impl System {
    fn new(name: String) -> Self {
        Self { name, least: Vec::new() }
    }

    /// Note the time of a scan [ms].
    fn note_scan(&mut self, index: usize, time: f64) {
        self.least.resize(self.least.len().max(index + 1), f64::INFINITY);
        self.least[index] = self.least[index].min(time);
    }

    /// Note one run over all scans.
    fn note(
        &mut self,
        scans: &[Scan],
        mut integrate: impl FnMut(&Scan) -> Result<(), Error>,
    ) -> Result<(), Error> {
        for (index, scan) in scans.iter().enumerate() {
            let start = Instant::now();
            integrate(scan)?;
            self.note_scan(index, start.elapsed().as_secs_f64() * 1e3);
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

/// Print the time of every system, as a ratio to that of the yardstick, and add it to the figures.
fn print<'a>(
    figures: &mut Vec<Figure<'static>>,
    scene: &str,
    yardstick: &'a System,
    systems: impl Iterator<Item = &'a System>,
) -> std::io::Result<()> {
    let [_, whole] = yardstick.times();
    for system in [yardstick].into_iter().chain(systems) {
        let [first, steady] = system.times();
        let (name, of_first, of_steady) = (&system.name, first / whole, steady / whole);
        writeln!(
            stdout(),
            "sequence/{scene}/{name}: first {first:.2} ms, ratio {of_first:.3}; \
             steady {steady:.2} ms, ratio {of_steady:.3}",
        )?;
        let values = [("first", of_first), ("steady", of_steady), ("steady_ms", steady)];
        figures.push((format!("{scene}/{name}"), values.to_vec()));
    }
    Ok(())
}

/// Time every way to update the map on a scene.
fn compare(
    figures: &mut Vec<Figure<'static>>,
    scene: &str,
    scans: &[Scan],
    repeats: usize,
) -> Result<(), Box<dyn std::error::Error>> {
    let mut reference = System::new("ray_scalar".to_owned());
    let mut systems: Vec<(System, usize, Skip)> = Vec::new();
    for (title, skip) in [("integrate", Skip::Saturated), ("skip_none", Skip::Nothing)] {
        for threads in [1, 2] {
            systems.push((System::new(format!("{title}_{threads}_threads")), threads, skip));
        }
    }
    for _ in 0..repeats {
        let mut dense = DenseMap::new([-50.0, -50.0, -1.0]);
        reference.note(scans, |scan| {
            dense.integrate(scan);
            Ok(())
        })?;
        for (system, threads, skip) in &mut systems {
            let parameters = MapParameters { skip: *skip, ..MapParameters::default() };
            let mut map = VoxelMap::new(parameters)?;
            let mut integrator = Integrator::new(*threads)?;
            system.note(scans, |scan| {
                integrator.integrate(&mut map, &scan.classified()).map(|_| ())
            })?;
        }
    }
    print(figures, scene, &reference, systems.iter().map(|(system, ..)| system))?;
    Ok(())
}

/// Time the whole detector on a scene, and its clusters and classes alone.
fn detect(
    figures: &mut Vec<Figure<'static>>,
    scene: &str,
    scans: &[Scan],
    repeats: usize,
) -> Result<(), Box<dyn std::error::Error>> {
    let [mut scalar, mut hash] =
        ["ray_scalar", "cluster_hash"].map(|name| System::new(name.to_owned()));
    let (mut wholes, mut clusters) = (Vec::new(), Vec::new());
    let modes = [("explained", true), ("full", false)];
    let runs = modes.into_iter().flat_map(|mode| [(mode, 1), (mode, 2)]);
    let runs: Vec<_> = runs.map(|((name, skips), threads)| (name, skips, threads)).collect();
    for (name, _, threads) in &runs {
        let title = |what: &str| System::new(format!("{what}_{name}_{threads}_threads"));
        wholes.push(title("scan"));
        clusters.push(title("cluster_and_classify"));
    }
    let distance = Clustering::default().max_distance;
    for _ in 0..repeats {
        let mut dense = DenseMap::new([-50.0, -50.0, -1.0]);
        scalar.note(scans, |scan| {
            dense.integrate(scan);
            Ok(())
        })?;
        for (index, scan) in scans.iter().enumerate() {
            let points = scan.returns();
            let start = Instant::now();
            black_box(cluster_hash(&points, distance));
            hash.note_scan(index, start.elapsed().as_secs_f64() * 1e3);
        }
        for (run, &(_, skips_explained, threads)) in runs.iter().enumerate() {
            let mut parameters = FlyingParameters::default();
            parameters.classify.skips_explained = skips_explained;
            let mut detector = FlyingObjectDetector::new(parameters, threads)?;
            for (index, scan) in scans.iter().enumerate() {
                let start = Instant::now();
                let frame = detector.process(&scan.raw((index as i64 + 1) * PERIOD_NS))?;
                wholes[run].note_scan(index, start.elapsed().as_secs_f64() * 1e3);
                clusters[run].note_scan(index, frame.timing.cluster + frame.timing.classify);
            }
        }
    }
    print(figures, scene, &scalar, wholes.iter())?;
    // With two threads rays are cast at the same time: those figures are of a shared machine.
    print(figures, scene, &hash, clusters.iter())?;
    Ok(())
}

/// The scan of a LiDAR with an eighth of the rows, whose driver drops rays without return.
fn sparse(scan: &Scan) -> Scan {
    let rows = (0..ROWS).skip(EVERY / 2).step_by(EVERY);
    let kept = rows.flat_map(|row| row * COLUMNS..(row + 1) * COLUMNS);
    let kept = kept.filter(|&at| !scan.no_return[at]);
    let (directions, world) = kept.map(|at| (scan.directions[at], scan.world[at])).unzip();
    Scan::new(scan.origin, directions, world)
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let repeats = std::env::var("LIDAR_CORE_REPEATS").ok().and_then(|text| text.parse().ok());
    let repeats = repeats.unwrap_or(REPEATS);
    let mut figures = Vec::new();
    for number in [1, 2] {
        let scans = street(number, SEQUENCE)?;
        compare(&mut figures, &format!("scene_{number}"), &scans, repeats)?;
        detect(&mut figures, &format!("scene_{number}"), &scans, repeats)?;
        let scans: Vec<Scan> = scans.iter().map(sparse).collect();
        compare(&mut figures, &format!("scene_{number}_sparse"), &scans, repeats)?;
    }
    Ok(keep("sequence", &figures)?)
}
