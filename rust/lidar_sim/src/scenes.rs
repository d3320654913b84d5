//! The fixed scene of all performance figures.

use crate::ray_patterns::{Lidar, Pattern};
use crate::refused;
use crate::scene::{Mover, Scene, SceneObject};
use crate::shape::Shape;
use crate::simulate::{self, Task};
use crate::trajectory::Trajectory;
use lidar_core::Error;
use lidar_core::geometry::transform::Transform;
use rayon::ThreadPool;

/// Number of scans of the scene.
pub const SCANS: u64 = 20;
/// Number of scans of the longer sequence: the same path further on, without boxes near it.
pub const SEQUENCE: u64 = 61;
/// Time from one scan to the next [ns].
const PERIOD_NS: i64 = 100_000_000;
/// Seed of the noise.
const SEED: u64 = 20_240_607;

/// Boxes of the scene: size x, y, height, centre x, y [m]; drawn by
/// `lidar_core.sim.scenes.performance` (numpy `default_rng(20240607)`), whose test compares both
/// tables.
pub const BOXES: [[f64; 5]; 15] = [
    [
        5.0702065986294675,
        7.274413130562706,
        13.666137814060923,
        29.712938534225486,
        12.087083356704035,
    ],
    [
        10.177819171115988,
        4.521649216957248,
        17.474928505681213,
        -25.58107378548991,
        -6.659497946916105,
    ],
    [
        8.396287747081367,
        7.618565041304508,
        21.104157869990658,
        -32.06149363947698,
        34.705281305685276,
    ],
    [
        5.0195266954278654,
        9.536391555333065,
        19.847308154764384,
        23.934080502587875,
        35.42442234611168,
    ],
    [
        8.326970474038852,
        9.720299547042803,
        16.613053269180497,
        6.403391591917277,
        -40.172927285735746,
    ],
    [
        7.771441738325417,
        9.641605561261656,
        12.867946044537002,
        -12.956303111082043,
        -21.254887183731526,
    ],
    [
        11.081462179087833,
        9.059666978985652,
        15.53840034355201,
        -6.679265469558118,
        -25.827829421013607,
    ],
    [11.00605206391376, 9.756954209853067, 8.455874041057427, 33.76965673947059, 14.16593310104912],
    [
        9.781053994646001,
        6.083925883839783,
        21.663896803862194,
        -14.129690993190437,
        40.798477763942756,
    ],
    [4.169299287673515, 9.28247594608191, 13.854300441174173, 8.446808091561891, 17.54357060274777],
    [
        11.311681235434076,
        6.128646415740017,
        6.731937742621302,
        34.510447063107776,
        28.352454509591112,
    ],
    [
        9.582585904648102,
        4.884109263505668,
        19.425889521771374,
        35.81170809514592,
        -32.53125745301146,
    ],
    [7.332884121797227, 7.081823494255216, 8.949662603113541, 20.54030851711107, 26.08594907102095],
    [6.8049170835616, 7.196653591526946, 7.566590659028778, 2.239273516190096, -24.784370815093318],
    [
        10.366068706857298,
        4.353563117436523,
        12.085118512108703,
        10.352968262442019,
        29.74595818181517,
    ],
];

/// Cylinders of the scene: radius, height, centre x, y [m]; drawn after the boxes.
pub const CYLINDERS: [[f64; 4]; 15] = [
    [1.4294012547330124, 8.47254720584207, -0.9073633058638073, 8.134985609109123],
    [0.47191104363975145, 13.536438915213536, -26.58164306771754, 26.222561746397794],
    [1.3077152677253214, 11.562487752520937, -3.2346318693696894, 16.773530243765038],
    [0.6100240488898441, 13.699569222475716, 27.106609900659826, -29.749880795612885],
    [0.7401283828115656, 10.64162165370545, 26.312028205258343, 15.334414498655057],
    [0.8063060778469748, 14.953473070757195, -3.842395933144946, 7.499926155787605],
    [1.3895211641272207, 12.262892000915302, 15.201113935335997, 7.032087299222759],
    [1.214506543747346, 12.99277586434497, 26.65870933694331, -17.2705904965755],
    [1.1806473193780311, 14.265665566739322, 2.083184064315134, -18.87795676408441],
    [1.072136461417578, 10.798707516224484, -18.38131154200424, 8.43022459179479],
    [1.3228865233711091, 10.51630789861471, 9.454610460688585, -21.96624203359489],
    [0.5447373438699952, 16.946623019887838, 26.635734876723284, 14.203691362190824],
    [0.6498538493961701, 16.51750226990858, -7.08120438361621, 28.64148156045949],
    [0.3511459369975734, 15.537711199883471, -19.703039888410423, 1.4376010465417046],
    [0.4331912647682751, 14.035395697025182, 1.3042765672618017, 12.161104056623081],
];

/// Positions of the spheres at scan 0, relative to the sensor's height, and their motion [m/scan].
const SPHERES: [([f64; 3], [f64; 3]); 2] =
    [([8.0, 5.0, 1.5], [0.4, 0.1, 0.05]), ([-6.0, -12.0, -1.0], [-0.2, 0.4, -0.05])];

/// Fixed scene, sensor and trajectory of the speed benchmarks.
#[derive(Clone, Debug)]
pub struct Performance {
    /// Ground, boxes and cylinders (labels 0 to 30), two spheres (31, 32).
    pub scene: Scene,
    /// 128 x 1024 rays, all at the start of the scan.
    pub lidar: Lidar,
    /// Trajectory of the sensor without rotation: directions in the world are those in the LiDAR's
    /// frame.
    pub sensor: Trajectory,
}

/// One scan in the world frame.
#[derive(Clone, Debug)]
pub struct WorldScan {
    /// Start of all rays [m].
    pub origin: [f64; 3],
    /// Unit directions.
    pub directions: Vec<[f64; 3]>,
    /// Range of every ray [m]; +inf is no return.
    pub ranges: Vec<f64>,
}

/// The fixed scene of this number: 1 with the sensor 10 m above the ground, 2 with 3 m.
///
/// # Errors
/// [`Error::Parameter`] for any other number.
pub fn performance(number: u32) -> Result<Performance, Error> {
    let height = match number {
        1 => 10.0,
        2 => 3.0,
        _ => return Err(refused("number", "1 or 2", &number)),
    };
    let step = [0.5, 0.0, 0.0];
    Ok(Performance {
        scene: Scene::new(bodies()?, spheres(height)?)?,
        lidar: lidar(),
        sensor: line([-4.887, 0.087, height + 0.061], step)?,
    })
}

impl Performance {
    /// Scan number `scan`, 0 to [`SEQUENCE`] - 1, with noise.
    ///
    /// # Errors
    /// [`Error::Parameter`] for a later scan.
    pub fn scan(&self, pool: &ThreadPool, scan: u64) -> Result<WorldScan, Error> {
        if scan >= SEQUENCE {
            return Err(refused("scan", "0 to 60", &scan));
        }
        let start_ns = scan as i64 * PERIOD_NS;
        let Self { scene, lidar, sensor } = self;
        let task = Task { scene, lidar, sensor, start_ns, scan, seed: SEED };
        let made = simulate::scan(pool, &task)?;
        let origin = sensor.pose_at(start_ns).translation;
        Ok(WorldScan { origin, directions: made.sweep.directions, ranges: made.ranges })
    }
}

fn bodies() -> Result<Vec<SceneObject>, Error> {
    let mut shapes = vec![(Shape::plane([100.0, 100.0])?, [0.0; 3])];
    for [size_x, size_y, height, x, y] in BOXES {
        shapes.push((Shape::cuboid([size_x, size_y, height])?, [x, y, 0.5 * height]));
    }
    for [radius, height, x, y] in CYLINDERS {
        shapes.push((Shape::cylinder(radius, height)?, [x, y, 0.5 * height]));
    }
    let body = |(label, (shape, place))| SceneObject {
        shape,
        world_from_shape: at(place),
        sway: None,
        surface: None,
        label,
    };
    Ok((0..).zip(shapes).map(body).collect())
}

fn spheres(height: f64) -> Result<Vec<Mover>, Error> {
    let first_label = 1 + BOXES.len() + CYLINDERS.len();
    let mut movers = Vec::new();
    for (index, ([x, y, z], step)) in SPHERES.into_iter().enumerate() {
        movers.push(Mover {
            shape: Shape::sphere(0.325)?,
            surface: None,
            trajectory: line([x, y, height + z], step)?,
            label: (first_label + index) as i32,
        });
    }
    Ok(movers)
}

fn lidar() -> Lidar {
    let row = |row: u32| (22.5 - 45.0 * f64::from(row) / 127.0).to_radians();
    Lidar {
        pattern: Pattern::Spinning {
            elevations: (0..128).map(row).collect(),
            columns: 1024,
            azimuth_start: 0.001,
            azimuth_per_scan: 0.05,
        },
        period_ns: PERIOD_NS,
        snapshot: true,
        range_min: 0.0,
        range_max: 100.0,
        range_std: 0.03,
        dropout: 0.0,
        beam: None,
    }
}

fn at(translation: [f64; 3]) -> Transform {
    Transform { translation, ..Transform::IDENTITY }
}

/// Trajectory from `start` [m] with `step` [m] per scan.
fn line(start: [f64; 3], step: [f64; 3]) -> Result<Trajectory, Error> {
    let place = |scan: u64| at(std::array::from_fn(|axis| start[axis] + scan as f64 * step[axis]));
    // A stamp of its own at the end of the scene: it is the same to the bit as without what follows.
    let scans = [0, SCANS, SEQUENCE];
    Trajectory::new(scans.map(|scan| scan as i64 * PERIOD_NS).to_vec(), scans.map(place).to_vec())
}

#[cfg(test)]
mod tests {
    use super::*;
    use lidar_core::util::threads;

    #[test]
    fn returns_per_scan_are_those_of_the_scene() -> Result<(), Error> {
        let pool = threads::pool(2)?;
        for (number, first, mean) in [(1, 74_127, 72_128), (2, 98_633, 98_924)] {
            let scene = performance(number)?;
            let mut total = 0;
            for scan in 0..SCANS {
                let ranges = scene.scan(&pool, scan)?.ranges;
                let returns = ranges.iter().filter(|range| range.is_finite()).count();
                assert!(scan > 0 || returns == first, "scene {number}: {returns} in scan 0");
                total += returns;
            }
            let found = total as f64 / SCANS as f64;
            assert!((found - f64::from(mean)).abs() < 0.5, "scene {number}: {found} per scan");
        }
        Ok(())
    }
}
