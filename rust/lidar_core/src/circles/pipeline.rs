//! From one sweep of ranges to the map of circles: every stage in one call.

use super::fit::FitMethod;
use super::fit::circle::CircleEstimate;
use super::frame::{CircleFrame, CircleTiming, PreparedSweep};
use super::map::SavedCircleMap;
use super::map::{CircleMap, CircleScan, MapElement, MapShape, MapStats, ScanWithLimits};
use super::map_input::{ByKind, Parts, standing};
use super::parameters::PipelineParameters;
use super::pose_offset::PoseOffset;
use super::preprocess::misses::Misses;
use super::preprocess::projection;
use super::range_noise::RangeNoise;
pub use super::raw_sweep::RawSweep;
use super::raw_sweep::delays;
use super::scanner::Scanner;
use super::segment::parameters::SegmentParameters;
use super::segment::segmentation::segment;
use super::selection::ShapeParameters;
use super::shape::ShapeEstimate;
use crate::Error;
use crate::geometry::transform::Transform;
use crate::util::budget::check_memory;
use crate::util::full_state::{impossible, opened, sealed};
use crate::util::stopwatch::Clock;

const KIND: &str = "circle pipeline";
/// Largest number of scanners of one pipeline.
const MAX_SCANNERS: usize = 64;
/// Memory that a ray may take, all stages together [bytes].
const ROOM_OF_RAY: usize = 384;

/// Name and learnt properties of a scanner.
type SavedScanner = (String, RangeNoise, Misses, PoseOffset);

/// Pipeline from sweeps to a map of circles.
pub struct CirclePipeline {
    parameters: PipelineParameters,
    map: CircleMap,
    /// Scanners in the order in which they were first used.
    scanners: Vec<(String, Scanner)>,
}

impl CirclePipeline {
    /// A pipeline with an empty map.
    ///
    /// # Errors
    /// [`Error::Parameter`] for values that cannot work.
    pub fn new(parameters: PipelineParameters) -> Result<Self, Error> {
        let map = CircleMap::new(parameters.map.clone())?;
        projection::check_planes(&parameters.planes)?;
        parameters.shapes.iter().try_for_each(ShapeParameters::check)?;
        Scanner::new(&parameters.scanner, &parameters)?;
        let scanners = parameters
            .scanners
            .iter()
            .map(|(name, scanner)| Ok((name.clone(), Scanner::new(scanner, &parameters)?)))
            .collect::<Result<_, Error>>()?;
        Ok(Self { parameters, map, scanners })
    }

    /// The whole state as bytes.
    ///
    /// # Errors
    /// [`Error::Limit`] if the bytes do not fit into memory.
    pub fn to_state(&self) -> Result<Vec<u8>, Error> {
        let saved = |(name, one): &'_ (String, Scanner)| {
            (name.clone(), one.noise, one.misses.clone(), one.offset.clone())
        };
        let scanners: Vec<SavedScanner> = self.scanners.iter().map(saved).collect();
        sealed(KIND, &self.parameters, &(scanners, self.map.state()))
    }

    /// Pipeline from a saved state; it continues with the same bits as the saved one.
    ///
    /// # Errors
    /// Errors of [`CirclePipeline::new`]; [`Error::Format`] for bytes that
    /// [`CirclePipeline::to_state`] did not make, [`Error::Parameter`] for the state of a pipeline
    /// with other parameters.
    pub fn from_state(parameters: PipelineParameters, bytes: &[u8]) -> Result<Self, Error> {
        let (scanners, map): (Vec<SavedScanner>, SavedCircleMap) =
            opened(KIND, &parameters, bytes)?;
        let mut pipeline = Self::new(parameters)?;
        for (place, (name, noise, misses, offset)) in scanners.into_iter().enumerate() {
            match pipeline.number(&name) {
                Some(known) if known == place => {}
                None if pipeline.scanners.len() == place => {
                    let scanner = pipeline.new_scanner(&name)?;
                    pipeline.scanners.push((name, scanner));
                }
                _ => return Err(impossible("scanners in another order")),
            }
            if !noise.is_sound() {
                return Err(impossible("a noise of ranges that is not positive"));
            }
            let (_, scanner) = &mut pipeline.scanners[place];
            if !misses.is_sound(scanner.bearings.len()) {
                return Err(impossible("impossible counts of rays without return"));
            }
            scanner.hear(noise)?;
            scanner.misses = misses;
            scanner.offset = offset;
        }
        pipeline.map.restore(map)?;
        Ok(pipeline)
    }

    /// Process one sweep.
    ///
    /// # Errors
    /// [`Error::Length`], [`Error::Value`], [`Error::Time`] for a sweep that cannot be used,
    /// [`Error::Limit`] for too many objects. After an error nothing has changed.
    pub fn process(&mut self, raw: &RawSweep<'_>) -> Result<CircleFrame, Error> {
        self.unless_refused(raw.scanner, |pipeline, number| {
            let prepared = pipeline.prepare_in(raw, number, &pipeline.scanners[number].1)?;
            #[cfg(canary_6)]
            if number == 1 && prepared.segments.len() == 3 {
                crate::util::planted("canary 6");
            }
            pipeline.fit(prepared)
        })
    }

    /// Process the stages before the estimation of circles. Any estimator may follow, and
    /// `integrate` after it. The pipeline is not changed.
    ///
    /// # Errors
    /// Errors of [`CirclePipeline::process`].
    pub fn prepare(&self, raw: &RawSweep<'_>) -> Result<PreparedSweep, Error> {
        match self.number(raw.scanner) {
            Some(number) => self.prepare_in(raw, number, &self.scanners[number].1),
            None => self.prepare_in(raw, self.scanners.len(), &self.new_scanner(raw.scanner)?),
        }
    }

    fn prepare_in(
        &self,
        raw: &RawSweep<'_>,
        number: usize,
        scanner: &Scanner,
    ) -> Result<PreparedSweep, Error> {
        let mut clock = Clock::start();
        let parameters = &self.parameters;
        raw.check(scanner.bearings.len())?;
        check_memory("a sweep", scanner.bearings.len(), ROOM_OF_RAY)?;
        self.map
            .check_stamp(raw.stamp_ns, number as u32)
            .map_err(|error| with_name(error, number, raw.scanner))?;
        let (given, sweep) = scanner.sweep(raw)?;
        let range_limits = scanner.horizontal_limits(projection::upright(&sweep)?);
        let misses = scanner.misses_with(raw, parameters);
        let (level, seen) = scanner.level(raw, &misses, &sweep, parameters)?;
        let prepare = clock.lap();
        let range_std = scanner.noise.std();
        let bound = parameters.segment.bound.for_noise(range_std);
        let segmenting = SegmentParameters { bound, range_limits, ..parameters.segment };
        let segments = segment(&level.scan, seen.as_deref(), &segmenting)?;
        Ok(PreparedSweep {
            delays: raw.ray_time_ns.map(|times| delays(&segments, times, raw.stamp_ns)),
            level,
            segments,
            world_from_lidar: *sweep.at_stamp(),
            world_from_level: sweep.world_from_level(),
            pose_covariance: scanner.offset.covariance(raw.stamp_ns, &given, raw.pose_covariance),
            stamp_ns: raw.stamp_ns,
            scanner: raw.scanner.into(),
            number,
            range_limits,
            range_std,
            misses,
            given,
            timing: CircleTiming { prepare, segment: clock.lap(), ..CircleTiming::default() },
        })
    }

    fn fit(&mut self, mut prepared: PreparedSweep) -> Result<CircleFrame, Error> {
        let mut clock = Clock::start();
        self.listen(&mut prepared)?;
        let mut circles = Vec::with_capacity(prepared.segments.len());
        let (scan, segments) = (&prepared.level.scan, &prepared.segments);
        let (_, scanner) = &mut self.scanners[prepared.number];
        let is_done =
            self.parameters.shapes.is_some() && self.parameters.fit.method == FitMethod::Expected;
        let mut shapes = Vec::new();
        if is_done {
            scanner.shaper.fit_both(scan, segments, &mut circles, &mut shapes)?;
        } else {
            scanner.fitter.fit(scan, segments, &mut circles)?;
            self.find_shapes(&prepared, &mut shapes)?;
        }
        prepared.timing.fit = clock.lap();
        self.take_in(prepared, circles, shapes)
    }

    /// Learn the properties of the scanner from a sweep; the stages as published do not.
    fn listen(&mut self, prepared: &mut PreparedSweep) -> Result<(), Error> {
        let (_, scanner) = &mut self.scanners[prepared.number];
        if self.parameters.learns() {
            scanner.listen(&prepared.level.scan, &prepared.segments)?;
            scanner.misses.clone_from(&prepared.misses);
        }
        prepared.range_std = scanner.noise.std();
        Ok(())
    }

    /// Shapes of the segments, if shapes are distinguished.
    fn find_shapes(
        &mut self,
        prepared: &PreparedSweep,
        shapes: &mut Vec<ShapeEstimate>,
    ) -> Result<(), Error> {
        let (_, scanner) = &mut self.scanners[prepared.number];
        match self.parameters.shapes {
            Some(_) => scanner.shaper.fit(&prepared.level.scan, &prepared.segments, shapes),
            None => Ok(()),
        }
    }

    /// Update the map with one circle per segment of a prepared sweep, in its level frame [m].
    ///
    /// # Errors
    /// [`Error::Length`] for a wrong number of circles, and the errors of
    /// [`CirclePipeline::process`].
    pub fn integrate(
        &mut self,
        mut prepared: PreparedSweep,
        circles: Vec<CircleEstimate>,
    ) -> Result<CircleFrame, Error> {
        let (expected, got) = (prepared.segments.len(), circles.len());
        if expected != got {
            return Err(Error::Length { name: "circles", expected, got });
        }
        let scanner = prepared.scanner.clone();
        self.unless_refused(&scanner, |pipeline, number| {
            prepared.number = number;
            pipeline.listen(&mut prepared)?;
            let mut shapes = Vec::new();
            pipeline.find_shapes(&prepared, &mut shapes)?;
            pipeline.take_in(prepared, circles, shapes)
        })
    }

    /// Update the map with the round segments.
    fn take_in(
        &mut self,
        prepared: PreparedSweep,
        circles: Vec<CircleEstimate>,
        shapes: Vec<ShapeEstimate>,
    ) -> Result<CircleFrame, Error> {
        let mut clock = Clock::start();
        let (ByKind { bodies: elements, lines, too_near }, stats) =
            self.update(&prepared, &circles, &shapes)?;
        let map = self.map.map_at(prepared.stamp_ns);
        let map_shapes = self.map.shapes_at(prepared.stamp_ns);
        let (_, scanner) = &mut self.scanners[prepared.number];
        if self.parameters.learns() {
            let standing = standing(&map, &elements, &circles);
            scanner.offset.add(prepared.stamp_ns, &prepared.given, standing);
        }
        let noise = scanner.noise;
        Ok(CircleFrame {
            pose_offset: scanner.offset.known(),
            range_std: noise.is_known().then(|| noise.estimate()),
            no_return: scanner.misses.no_return(),
            circles_world: in_world(&circles, &prepared.world_from_level),
            times_ns: prepared.times_ns(),
            level: prepared.level,
            segments: prepared.segments,
            circles,
            shapes,
            elements,
            too_near,
            lines,
            stats,
            map,
            map_shapes,
            timing: CircleTiming { map: clock.lap(), ..prepared.timing },
        })
    }

    /// Correct the map; returns the element ID of every body and of every line.
    fn update(
        &mut self,
        prepared: &PreparedSweep,
        circles: &[CircleEstimate],
        shapes: &[ShapeEstimate],
    ) -> Result<(ByKind, MapStats), Error> {
        let parts = Parts::of(prepared, circles, shapes, &self.parameters, &self.map);
        let delays: Option<Vec<f64>> = prepared
            .delays
            .as_ref()
            .map(|delays| parts.bodies.iter().map(|&number| delays[number]).collect());
        let points: Vec<_> =
            parts.bodies.iter().map(|&number| prepared.points_world(number)).collect();
        let covered: Vec<bool> =
            parts.bodies.iter().map(|&number| prepared.is_covered(number)).collect();
        let [range_min, range_max] = prepared.range_limits;
        let updated = self.map.update(&CircleScan {
            stamp_ns: prepared.stamp_ns,
            sensor: prepared.number as u32,
            world_from_lidar: &prepared.world_from_lidar,
            pose_covariance: prepared.pose_covariance.as_ref(),
            estimates: &parts.circles,
            delays: delays.as_deref(),
            outlines: &parts.outlines,
            points: Some(&points),
            covered: Some(&covered),
            lines: &parts.shapes,
            view: Some(ScanWithLimits { scan: &prepared.level.scan, range_min, range_max }),
        });
        let stats =
            updated.map_err(|error| with_name(error, prepared.number, &prepared.scanner))?;
        let elements = parts.elements(circles.len(), &stats);
        Ok((elements, stats))
    }

    /// Elements of the map predicted to a time [ns]; the map is not changed.
    #[must_use]
    pub fn map_at(&self, stamp_ns: i64) -> Vec<MapElement> {
        self.map.map_at(stamp_ns)
    }

    /// Map elements with other shapes than circles, predicted to a time [ns]; the map is not
    /// changed.
    #[must_use]
    pub fn shapes_at(&self, stamp_ns: i64) -> Vec<MapShape> {
        self.map.shapes_at(stamp_ns)
    }

    /// Remove all elements of the map. IDs are not used again.
    pub fn reset(&mut self) {
        self.map.reset();
    }

    /// Index of the scanner with this name, if it was used before.
    fn number(&self, name: &str) -> Option<usize> {
        self.scanners.iter().position(|(known, _)| known == name)
    }

    /// A scanner with a name that was not used before.
    ///
    /// # Errors
    /// [`Error::Limit`] for one more than [`MAX_SCANNERS`].
    fn new_scanner(&self, name: &str) -> Result<Scanner, Error> {
        if self.scanners.len() >= MAX_SCANNERS {
            return Err(Error::Limit {
                what: format!("scanner {name:?}, one more"),
                limit: MAX_SCANNERS as u64,
                key: "use fewer names",
            });
        }
        Scanner::new(&self.parameters.scanner, &self.parameters)
    }

    /// Result of `take` for a sweep of this scanner; after an error a new scanner stays unknown.
    fn unless_refused(
        &mut self,
        scanner: &str,
        take: impl FnOnce(&mut Self, usize) -> Result<CircleFrame, Error>,
    ) -> Result<CircleFrame, Error> {
        let known = self.scanners.len();
        let number = self.number(scanner).unwrap_or(known);
        if number == known {
            self.scanners.push((scanner.into(), self.new_scanner(scanner)?));
        }
        let (_, known_scanner) = &self.scanners[number];
        let (noise, misses) = (known_scanner.noise, known_scanner.misses.clone());
        let frame = take(self, number);
        if frame.is_err() {
            self.scanners[number].1.hear(noise)?;
            self.scanners[number].1.misses = misses;
            self.scanners.truncate(known);
        }
        frame
    }
}

/// Error of the map with the name of the scanner instead of its index.
fn with_name(error: Error, number: usize, name: &str) -> Error {
    let Error::Time { what } = error else { return error };
    let named = format!("from scanner {name:?}");
    Error::Time { what: what.replace(&format!("from sensor {number}"), &named) }
}

/// Transform circles from the level frame to the world.
fn in_world(circles: &[CircleEstimate], world_from_level: &Transform) -> Vec<CircleEstimate> {
    let placed = |estimate: &CircleEstimate| {
        let mut placed = *estimate;
        let [x, y] = estimate.circle.center;
        let [x, y, _] = world_from_level.apply([x, y, 0.0]);
        placed.circle.center = [x, y];
        placed.covariance = world_from_level.turn_covariance(&estimate.covariance);
        placed
    };
    circles.iter().map(placed).collect()
}
