//! How cost grows: time against size, and the exponent of the power law fitted to it. One is
//! linear, nought does not depend on the size. `cargo bench --bench scaling [rays|voxel|...]`.

use lidar_core::Error;
use lidar_core::flying::integrate::integrator::Integrator;
use lidar_core::flying::map::parameters::{MapParameters, Separation};
use lidar_core::flying::map::voxel_map::VoxelMap;
use lidar_core::flying::track::{Detections, OccupiedPoints, PointCloudTracker, TrackerParameters};
use lidar_core::geometry::cluster::{Clustering, label};
use scenes::Scan;
use scenes::figures::keep;
use std::f64::consts::{PI, TAU};
use std::io::{Write, stdout};
use std::time::Instant;

/// Timings of every size; the least counts.
const ROUNDS: usize = 3;
/// Rays of a scan where their number is not what grows.
const ROWS: usize = 64;
const COLUMNS: usize = 512;
const PERIOD_NS: i64 = 100_000_000;
/// Of an object that is tracked, around its middle [m].
const OBJECT: [f32; 3] = [-0.1, 0.0, 0.1];

/// Sizes, and the time of each [s].
type Measured = Result<Vec<(f64, f64)>, Error>;
/// Name on the command line, title of the table, and how it is measured.
type Part = (&'static str, &'static str, fn() -> Measured);

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let all: [Part; 6] = [
        ("rays", "rays into the map; number of rays", rays),
        ("voxel", "rays into the map; voxels per metre", voxel),
        ("range", "rays into the map; range [m]", range),
        ("points", "clusters; number of points", points),
        ("tracks", "tracker, one scan; number of tracks", tracks),
        ("extent", "one scan into the map, removal of islands; length of the map [m]", extent),
    ];
    let wanted: Vec<String> =
        std::env::args().skip(1).filter(|word| !word.starts_with('-')).collect();
    let mut out = stdout();
    let mut figures = Vec::new();
    for (name, title, measure) in all {
        if !wanted.is_empty() && !wanted.iter().any(|word| word == name) {
            continue;
        }
        let found = measure()?;
        writeln!(out, "\n| {title} | ms |\n|---|---|")?;
        for (size, seconds) in &found {
            writeln!(out, "| {size} | {:.3} |", seconds * 1e3)?;
        }
        let power = exponent(&found);
        writeln!(out, "\ntime grows with the power {power:.2} of the size")?;
        if let [(least, quickest), .., (most, slowest)] = found[..] {
            let times = [("least_ms", quickest * 1e3), ("most_ms", slowest * 1e3)];
            let sizes = [("least", least), ("most", most), ("power", power)];
            figures.push((name.to_owned(), [&times[..], &sizes].concat()));
        }
    }
    Ok(keep("scaling", &figures)?)
}

/// Slope of the straight line through the logarithms.
fn exponent(found: &[(f64, f64)]) -> f64 {
    let logs: Vec<_> = found.iter().map(|&(size, seconds)| (size.ln(), seconds.ln())).collect();
    let count = logs.len() as f64;
    let mean_x = logs.iter().map(|log| log.0).sum::<f64>() / count;
    let mean_y = logs.iter().map(|log| log.1).sum::<f64>() / count;
    let product = logs.iter().map(|log| (log.0 - mean_x) * (log.1 - mean_y)).sum::<f64>();
    product / logs.iter().map(|log| (log.0 - mean_x).powi(2)).sum::<f64>()
}

/// Least time of some rounds, after one that does not count [s].
fn least(mut work: impl FnMut() -> Result<(), Error>) -> Result<f64, Error> {
    work()?;
    let mut best = f64::INFINITY;
    for _ in 0..ROUNDS {
        let start = Instant::now();
        work()?;
        best = best.min(start.elapsed().as_secs_f64());
    }
    Ok(best)
}

/// Rays of a 45 degree fan, all round, that end on a sphere of radius `reach` [m].
fn shell(rows: usize, columns: usize, reach: f64, x: f64) -> Scan {
    let origin = [x + 0.1, 0.12, 0.13];
    let directions = (0..rows * columns).map(|ray| {
        let up = (0.5 - (ray / columns) as f64 / rows as f64) * PI / 4.0;
        let (sine, cosine) = (TAU * (ray % columns) as f64 / columns as f64).sin_cos();
        [up.cos() * cosine, up.cos() * sine, up.sin()].map(|value| value as f32)
    });
    let directions: Vec<[f32; 3]> = directions.collect();
    let ends = directions.iter().map(|direction| {
        std::array::from_fn(|axis| (origin[axis] + reach * f64::from(direction[axis])) as f32)
    });
    let ends = ends.collect();
    Scan::new(origin, directions, ends)
}

fn integration(parameters: MapParameters, scan: &Scan) -> Result<f64, Error> {
    let mut map = VoxelMap::new(parameters)?;
    let mut integrator = Integrator::new(1)?;
    least(|| integrator.integrate(&mut map, &scan.classified()).map(|_| ()))
}

fn rays() -> Measured {
    let sizes = [(32, 512), (64, 1024), (128, 2048), (256, 4096)];
    let measure = |&(rows, columns): &(usize, usize)| {
        let seconds = integration(MapParameters::default(), &shell(rows, columns, 19.0, 0.0))?;
        Ok(((rows * columns) as f64, seconds))
    };
    sizes.iter().map(measure).collect()
}

fn voxel() -> Measured {
    let scan = shell(ROWS, COLUMNS, 19.0, 0.0);
    let measure = |&voxel_size: &f64| {
        let parameters = MapParameters { voxel_size, ..MapParameters::default() };
        Ok((1.0 / voxel_size, integration(parameters, &scan)?))
    };
    [0.5, 0.25, 0.1].iter().map(measure).collect()
}

fn range() -> Measured {
    let measure = |&reach: &f64| {
        let parameters = MapParameters { max_range: reach, ..MapParameters::default() };
        Ok((reach, integration(parameters, &shell(ROWS, COLUMNS, 0.95 * reach, 0.0))?))
    };
    [10.0, 20.0, 50.0, 100.0].iter().map(measure).collect()
}

fn points() -> Measured {
    let sizes = [(32, 512), (64, 1024), (128, 2048), (256, 4096)];
    let measure = |&(rows, columns): &(usize, usize)| {
        let cloud = shell(rows, columns, (rows * columns) as f64 / 16_384.0 + 10.0, 0.0).world;
        let seconds = least(|| label(&cloud, &Clustering::default()).map(|_| ()))?;
        Ok(((rows * columns) as f64, seconds))
    };
    sizes.iter().map(measure).collect()
}

fn tracks() -> Measured {
    [1u32, 10, 100, 1000].iter().map(|&count| Ok((f64::from(count), tracking(count)?))).collect()
}

/// A scan with `count` objects, each of three points, through the tracker [s].
fn tracking(count: u32) -> Result<f64, Error> {
    let places = (0..count).map(|k| [f64::from(k % 32) * 4.0, f64::from(k / 32) * 4.0, 30.0]);
    let positions: Vec<[f64; 3]> = places.collect();
    let narrow = positions.iter().map(|place| place.map(|value| value as f32));
    let cloud = narrow.flat_map(|[x, y, z]| OBJECT.map(|step| [x + step, y, z]));
    let cloud: Vec<[f32; 3]> = cloud.collect();
    let occupied = OccupiedPoints::new(&[[0.0, 0.0, 0.0]], 0.7);
    let mut tracker = PointCloudTracker::new(TrackerParameters::default(), 1)?;
    let mut stamp_ns = 0;
    least(|| {
        for _ in 0..5 {
            stamp_ns += PERIOD_NS;
            let detections =
                Detections { stamp_ns, positions: &positions, ..Detections::default() };
            tracker.new_point_cloud(&cloud, None, &occupied, None, stamp_ns)?;
            tracker.new_detections(&detections, &occupied)?;
        }
        Ok(())
    })
    .map(|seconds| seconds / 5.0)
}

fn extent() -> Measured {
    let mut map = VoxelMap::new(MapParameters::default())?;
    let mut integrator = Integrator::new(1)?;
    let near = shell(ROWS, COLUMNS, 19.0, 0.0);
    let mut reached = 0.0;
    let mut measure = |&length: &f64| {
        while reached < length {
            integrator.integrate(&mut map, &shell(32, 256, 19.0, reached).classified())?;
            reached += 10.0;
        }
        map.remove_separate(Separation::default())?;
        let seconds = least(|| {
            integrator.integrate(&mut map, &near.classified())?;
            map.remove_separate(Separation::default()).map(|_| ())
        })?;
        Ok((length, seconds))
    };
    [50.0, 200.0, 1000.0].iter().map(&mut measure).collect()
}
