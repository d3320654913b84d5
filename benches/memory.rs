//! Memory: the map's bytes per voxel observed, what the whole detector holds beside its map once
//! nothing new appears, and what a scan allocates, with targets and without.
//! `cargo bench --bench memory`.

use lidar_core::Error;
use lidar_core::flying::detector::FlyingObjectDetector;
use lidar_core::flying::parameters::FlyingParameters;
use scenes::figures::keep;
use scenes::{Scan, street};
use stats_alloc::{INSTRUMENTED_SYSTEM, Region, StatsAlloc};
use std::alloc::System;
use std::io::{Write, stdout};
use std::process::Command;

#[global_allocator]
static ALLOCATOR: &StatsAlloc<System> = &INSTRUMENTED_SYSTEM;

const SCANS: u64 = 10;
const PERIOD_NS: i64 = 100_000_000;
const MEGA: f64 = 1e6;
/// Bytes of a page of memory.
const PAGE: f64 = 4096.0;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let words: Vec<String> =
        std::env::args().skip(1).filter(|word| !word.starts_with('-')).collect();
    let mut out = stdout();
    if let [word, number] = words.as_slice()
        && word == "scene"
    {
        return measure(number.parse()?);
    }
    if !words.is_empty() && !words.iter().any(|word| word == "memory") {
        return Ok(()); // another bench was asked for
    }
    writeln!(
        out,
        "| scene | voxels observed | map [MB] | bytes per voxel | detector with its map [MB] |\
         \x20in use [MB] | allocations per scan | allocated per scan [MB] | the same without targets |\
         \x20[MB] |\n|---|---|---|---|---|---|---|---|---|---|"
    )?;
    for number in ["1", "2"] {
        // Each in a process of its own, in which memory that is freed is given back.
        let mut bench = Command::new(std::env::current_exe()?);
        let status =
            bench.args(["scene", number]).env("MALLOC_MMAP_THRESHOLD_", "65536").status()?;
        if !status.success() {
            return Err(format!("scene {number}: {status}").into());
        }
    }
    Ok(())
}

/// Print the row of a scene, and keep its figures.
fn measure(number: u32) -> Result<(), Box<dyn std::error::Error>> {
    let scans = street(number, SCANS)?;
    let mut parameters = FlyingParameters::default();
    let run = Run::new(&scans, parameters.clone())?;
    parameters.classify.min_points = usize::MAX; // so that nothing is a target
    let empty = Run::new(&scans, parameters)?;
    let values = vec![
        ("voxels", run.voxels as f64),
        ("map_mb", run.map / MEGA),
        ("bytes_per_voxel", run.map / run.voxels as f64),
        ("held_mb", run.held / MEGA),
        ("used_mb", run.used / MEGA),
        ("allocations", run.allocations as f64),
        ("allocated_mb", run.allocated / MEGA),
        ("allocations_empty", empty.allocations as f64),
        ("allocated_empty_mb", empty.allocated / MEGA),
    ];
    let mut out = stdout();
    write!(out, "| {number} |")?;
    for (name, value) in &values {
        let digits = if name.contains("mb") || name.contains("bytes") { 2 } else { 0 };
        write!(out, " {value:.digits$} |")?;
    }
    writeln!(out)?;
    Ok(keep(&format!("memory_{number}"), &[(format!("scene_{number}"), values)])?)
}

/// What a detector takes [bytes].
struct Run {
    voxels: usize,
    map: f64,
    /// It holds so much, of which so much was ever touched.
    held: f64,
    used: f64,
    /// Per scan.
    allocations: u64,
    allocated: f64,
}

impl Run {
    /// The detector goes along the street and back; the way back shows what it holds and asks for.
    fn new(scans: &[Scan], parameters: FlyingParameters) -> Result<Self, Error> {
        let before = resident();
        let whole = Region::new(ALLOCATOR);
        let mut detector = FlyingObjectDetector::new(parameters, 1)?;
        let mut stamp_ns = 0;
        let mut run = |scan: &Scan| {
            stamp_ns += PERIOD_NS;
            detector.process(&scan.raw(stamp_ns)).map(|_| ())
        };
        scans.iter().try_for_each(&mut run)?;
        let back = Region::new(ALLOCATOR);
        scans.iter().rev().try_for_each(&mut run)?;
        let (held, asked) = (whole.change(), back.change());
        Ok(Self {
            voxels: detector.map().observed_voxels(),
            map: detector.map().memory_bytes() as f64,
            held: (held.bytes_allocated - held.bytes_deallocated) as f64,
            used: resident() - before,
            allocations: (asked.allocations + asked.reallocations) as u64 / SCANS,
            allocated: asked.bytes_allocated as f64 / SCANS as f64,
        })
    }
}

/// Memory of this process that is in use [bytes]; NaN where the system does not tell.
fn resident() -> f64 {
    let told = std::fs::read_to_string("/proc/self/statm").unwrap_or_default();
    let pages = told.split(' ').nth(1).and_then(|pages| pages.parse::<f64>().ok());
    pages.map_or(f64::NAN, |pages| pages * PAGE)
}
