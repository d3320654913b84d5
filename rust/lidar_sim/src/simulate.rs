//! Simulation of one scan of a scene.

use crate::random::{self, Purpose};
use crate::ray_patterns::{Beam, Lidar, SweepRays};
use crate::scene::{CastRay, RayHit, Scene, inverse, passes, within};
use crate::surface::{Surface, SurfaceInteraction, USUAL_REFLECTIVITY, is_seen, signal};
use crate::trajectory::Trajectory;
use lidar_core::Error;
use lidar_core::geometry::transform::{Transform, dot};
use lidar_core::util::budget::check_memory;
use lidar_core::util::cancel;
use rayon::ThreadPool;
use rayon::prelude::*;

/// Label of a ray without a range.
pub const NO_LABEL: i32 = -1;
/// Label of a ray that ended on rain or dust.
pub const AIR_LABEL: i32 = -2;
/// Label of a ray that was mirrored before it returned: there is no object at its point.
pub const GHOST_LABEL: i32 = -3;
/// Label of a ray that ended on the carrier of the sensor.
pub const OWN_LABEL: i32 = -4;

/// Largest number of surfaces that one ray passes or is mirrored by.
const MOST_TURNS: u32 = 4;
/// Distance behind a surface within which a ray meets no other surface [m].
const STEP: f64 = 1e-6;

/// Optical properties, in fog, of bodies for which none are given; met at normal incidence.
const USUAL: Surface = Surface { reflectivity: USUAL_REFLECTIVITY, mirror: 0.0, clear: 0.0 };

/// Memory that a ray may take, including the results for the caller [bytes].
const ROOM_OF_RAY: usize = 192;

/// Rays per chunk: fixed, so that the result cannot depend on the number of threads.
const RAYS_PER_CHUNK: usize = 4096;

/// Input of the simulation of a scan.
#[derive(Clone, Copy, Debug)]
pub struct Task<'a> {
    /// Scene that the rays hit.
    pub scene: &'a Scene,
    /// Model of the LiDAR.
    pub lidar: &'a Lidar,
    /// Trajectory of the LiDAR.
    pub sensor: &'a Trajectory,
    /// Start of the scan [ns].
    pub start_ns: i64,
    /// Number of the scan, from 0.
    pub scan: u64,
    /// Seed of the noise.
    pub seed: u64,
}

/// Ranges of one scan and their ground truth. Rays are in the order of the sweep.
#[derive(Clone, Debug)]
pub struct SimulatedScan {
    /// Rays in the LiDAR's frame.
    pub sweep: SweepRays,
    /// Range of every ray [m]; +inf is no return, NaN no information.
    pub ranges: Vec<f64>,
    /// Label of the body that every ray hit; [`NO_LABEL`] for rays without a range.
    pub labels: Vec<i32>,
    /// For every object ([`Scene::objects`]), the number of rays that would hit it within range if there were no other
    /// objects.
    pub unoccluded: Vec<u32>,
}

/// State of the world at one firing.
struct WorldState {
    world_from_lidar: Transform,
    /// Time since time 0 [s].
    seconds: f64,
    shape_from_world: Vec<Transform>,
}

/// Simulate one scan.
///
/// # Errors
/// Errors of [`Lidar::check`], [`Error::Memory`], [`Error::Interrupted`].
pub fn scan(pool: &ThreadPool, task: &Task<'_>) -> Result<SimulatedScan, Error> {
    task.lidar.check()?;
    check_memory("a scan", task.lidar.rays(), ROOM_OF_RAY)?;
    let sweep = task.lidar.sweep(task.scan);
    let watch = cancel::watch();
    let parts: Vec<ScanPart> = pool.install(|| {
        let worlds: Vec<WorldState> = sweep
            .offsets_ns
            .par_iter()
            .with_min_len(64)
            .map(|&offset| task.world_at(offset))
            .collect();
        let starts: Vec<usize> = (0..sweep.directions.len()).step_by(RAYS_PER_CHUNK).collect();
        let part = |&start: &usize| {
            if watch.is_asked() { ScanPart::default() } else { task.part(&sweep, &worlds, start) }
        };
        starts.par_iter().map(part).collect()
    });
    watch.check()?;
    let mut unoccluded = vec![0; task.objects()];
    let (mut ranges, mut labels) = (Vec::new(), Vec::new());
    for part in parts {
        ranges.extend(part.ranges);
        labels.extend(part.labels);
        for (total, count) in unoccluded.iter_mut().zip(part.unoccluded) {
            *total += count;
        }
    }
    Ok(SimulatedScan { sweep, ranges, labels, unoccluded })
}

impl WorldState {
    /// Ray in `direction` of the LiDAR's frame.
    fn ray(&self, direction: [f64; 3]) -> CastRay {
        CastRay {
            origin: self.world_from_lidar.translation,
            direction: self.world_from_lidar.rotate(direction),
        }
    }
}

#[derive(Default)]
struct ScanPart {
    ranges: Vec<f64>,
    labels: Vec<i32>,
    unoccluded: Vec<u32>,
}

impl Task<'_> {
    fn objects(&self) -> usize {
        self.scene.objects().last().map_or(0, |last| last + 1)
    }

    fn world_at(&self, offset_ns: i64) -> WorldState {
        let stamp_ns = self.start_ns.saturating_add(offset_ns);
        let movers = self.scene.movers().iter();
        WorldState {
            world_from_lidar: self.sensor.pose_at(stamp_ns),
            seconds: stamp_ns as f64 * 1e-9,
            shape_from_world: movers
                .map(|mover| inverse(&mover.trajectory.pose_at(stamp_ns)))
                .collect(),
        }
    }

    fn part(&self, sweep: &SweepRays, worlds: &[WorldState], start: usize) -> ScanPart {
        let end = (start + RAYS_PER_CHUNK).min(sweep.directions.len());
        let mut part = ScanPart {
            ranges: Vec::with_capacity(end - start),
            labels: Vec::with_capacity(end - start),
            unoccluded: vec![0; self.objects()],
        };
        let turns = self.lidar.beam.as_ref().map(Beam::turns);
        let mut met = vec![false; part.unoccluded.len()];
        for index in start..end {
            let world = &worlds[sweep.firings[index] as usize];
            let ray = world.ray(sweep.directions[index]);
            met.fill(false);
            let hit = match &turns {
                None => self.seen(&ray, world, &mut met, index as u32),
                Some(turns) => self.echo(sweep.directions[index], turns, world, &mut met),
            };
            for (count, &met) in part.unoccluded.iter_mut().zip(&met) {
                *count += u32::from(met);
            }
            let hit = self.own(sweep.directions[index], hit);
            let hit = self.in_air(&ray, world, hit, index as u32);
            let distance = hit.map_or(f64::INFINITY, |hit| hit.distance);
            let range = self.lidar.measured(distance, self.seed, self.scan, index as u32);
            part.ranges.push(range);
            let label = hit.filter(|_| range.is_finite()).map(|hit| hit.label);
            part.labels.push(label.unwrap_or(NO_LABEL));
        }
        part
    }

    /// Hit of a beam whose lines are rotated from `direction` about the z axis; None if no line
    /// hits.
    fn echo(
        &self,
        [x, y, z]: [f64; 3],
        turns: &[[f64; 2]],
        world: &WorldState,
        met: &mut [bool],
    ) -> Option<RayHit> {
        let line = |&[cosine, sine]: &[f64; 2]| {
            world.ray([cosine * x - sine * y, sine * x + cosine * y, z])
        };
        let limit = self.lidar.range_max;
        let hits: Vec<RayHit> =
            turns.iter().filter_map(|turn| self.meet(&line(turn), world, met, limit)).collect();
        let first = hits.iter().min_by(|a, b| a.distance.total_cmp(&b.distance))?;
        let last = first.distance + self.lidar.beam.map_or(0.0, |beam| beam.echo_length);
        let merged = hits.iter().map(|hit| hit.distance).filter(|&distance| distance <= last);
        let (count, sum) = merged.fold((0.0, 0.0), |(n, sum), value| (n + 1.0, sum + value));
        Some(RayHit { distance: sum / count, ..*first })
    }

    /// Hit on the carrier of the sensor, if it is before `hit`, else `hit`.
    fn own(&self, direction: [f64; 3], hit: Option<RayHit>) -> Option<RayHit> {
        let limit = hit.map_or(self.lidar.range_max, |hit| hit.distance);
        self.scene.meet_carried(direction, limit).or(hit)
    }

    /// Hit of a ray that may pass surfaces or be mirrored; None if the return is too weak. The distance is the length
    /// of the whole path.
    fn seen(
        &self,
        ray: &CastRay,
        world: &WorldState,
        met: &mut [bool],
        index: u32,
    ) -> Option<RayHit> {
        let mut hit = self.meet(ray, world, met, self.lidar.range_max)?;
        let extinction = self.scene.extinction();
        if hit.surface.is_none() && extinction == 0.0 {
            return Some(hit); // the ideal: every surface returns
        }
        let (mut ray, mut way, mut is_ghost) = (*ray, 0.0, false);
        let mut unused = vec![false; met.len()];
        for turn in 0..MOST_TURNS {
            let drawn = self.drawn(index, turn);
            let (surface, normal) = hit.surface.unwrap_or((USUAL, ray.direction));
            let distance = way + hit.distance;
            let draws = [random::uniform(drawn[0]), random::uniform(drawn[1])];
            let ahead = match surface.interaction(ray.direction, normal, draws) {
                SurfaceInteraction::Scattered => {
                    let cosine = dot(ray.direction, normal).abs();
                    let range = self.lidar.range_max;
                    let power = signal(surface.reflectivity, cosine, distance, range, extinction);
                    let fading = random::normal(drawn[2], drawn[3]);
                    let label = if is_ghost { GHOST_LABEL } else { hit.label };
                    return is_seen(power, fading).then_some(RayHit { distance, label, ..hit });
                }
                SurfaceInteraction::Mirrored(direction) => {
                    is_ghost = true;
                    direction
                }
                SurfaceInteraction::Passed => ray.direction,
            };
            way = distance + STEP;
            ray = turned(&ray, hit.distance, ahead);
            hit = self.meet(&ray, world, &mut unused, self.lidar.range_max - way)?;
        }
        None
    }

    /// Random words for the reflection at the surface that a ray meets after `turn` others.
    fn drawn(&self, index: u32, turn: u32) -> [u32; 4] {
        let [ray, scan, scan_high, purpose] = random::place(Purpose::Surface, self.scan, index);
        random::words(self.seed, [ray, scan, scan_high, purpose | turn << 8])
    }

    /// First hit of `ray`; marks in `met` the objects that it meets or would meet.
    fn meet(
        &self,
        ray: &CastRay,
        world: &WorldState,
        met: &mut [bool],
        limit: f64,
    ) -> Option<RayHit> {
        let mut nearest = self.scene.meet(ray, limit, world.seconds);
        for (index, mover) in self.scene.movers().iter().enumerate() {
            let local = within(&world.shape_from_world[index], ray);
            if !passes(&local, [0.0; 3], mover.shape.radius()) {
                continue;
            }
            let Some(distance) = mover.shape.meet(&local, limit) else { continue };
            met[self.scene.objects()[index]] = true;
            if nearest.is_none_or(|hit| distance < hit.distance) {
                let surface = mover.surface.map(|surface| {
                    let normal = mover.shape.normal(&local, distance);
                    (surface, inverse(&world.shape_from_world[index]).rotate(normal))
                });
                nearest = Some(RayHit { distance, label: mover.label, surface });
            }
        }
        nearest
    }

    /// Hit on a particle, if a ray ends on one, else `hit`.
    fn in_air(
        &self,
        ray: &CastRay,
        world: &WorldState,
        hit: Option<RayHit>,
        index: u32,
    ) -> Option<RayHit> {
        let mut nearest = hit;
        for (group, volumes) in (0_u32..).zip(self.scene.air().chunks(4)) {
            let [ray_at, scan, scan_high, purpose] = random::place(Purpose::Air, self.scan, index);
            let drawn = random::words(self.seed, [ray_at, scan, scan_high, purpose | group << 8]);
            for (volume, word) in volumes.iter().zip(drawn) {
                let depth = -libm::log(random::uniform(word));
                let found = volume.meet(ray, self.lidar.range_min, world.seconds, depth);
                let limit = nearest.map_or(self.lidar.range_max, |hit| hit.distance);
                if let Some(distance) = found.filter(|&distance| distance < limit) {
                    nearest = Some(RayHit { distance, label: AIR_LABEL, surface: None });
                }
            }
        }
        nearest
    }
}

/// The ray that continues from a hit in another direction. It starts a step away from the surface, because it would
/// meet the same surface again otherwise.
fn turned(ray: &CastRay, distance: f64, ahead: [f64; 3]) -> CastRay {
    let start =
        |axis: usize| ray.origin[axis] + distance * ray.direction[axis] + STEP * ahead[axis];
    CastRay { origin: std::array::from_fn(start), direction: ahead }
}
