//! Memory: the map's bytes per voxel observed, what the whole detector holds beside its map once
//! nothing new appears, and what a scan allocates. `cargo bench --bench memory`.

use lidar_core::Error;
use lidar_core::flying::detector::FlyingObjectDetector;
use scenes::{flying_parameters, street};
use stats_alloc::{INSTRUMENTED_SYSTEM, Region, StatsAlloc};
use std::alloc::System;
use std::io::{Write, stdout};

#[global_allocator]
static ALLOCATOR: &StatsAlloc<System> = &INSTRUMENTED_SYSTEM;

const SCANS: u64 = 10;
const PERIOD_NS: i64 = 100_000_000;
const MEGA: f64 = 1e6;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut words = std::env::args().skip(1).filter(|word| !word.starts_with('-')).peekable();
    if words.peek().is_some() && !words.any(|word| word == "memory") {
        return Ok(()); // another bench was asked for
    }
    let mut out = stdout();
    writeln!(
        out,
        "| scene | voxels observed | map [MB] | bytes per voxel | detector with its map [MB] |\
         \x20of the map | allocations per scan | allocated per scan [MB] |\n|---|---|---|---|---|---|---|---|"
    )?;
    for number in [1, 2] {
        writeln!(out, "{}", row(number)?)?;
    }
    Ok(())
}

/// The detector goes along the street and back; the way back shows what it holds and asks for.
fn row(number: u32) -> Result<String, Error> {
    let scans = street(number, SCANS)?;
    let whole = Region::new(ALLOCATOR);
    let mut detector = FlyingObjectDetector::new(flying_parameters(), 1)?;
    let mut stamp_ns = 0;
    let mut run = |scan: &scenes::Scan| {
        stamp_ns += PERIOD_NS;
        detector.process(&scan.raw(stamp_ns)).map(|_| ())
    };
    scans.iter().try_for_each(&mut run)?;
    let back = Region::new(ALLOCATOR);
    scans.iter().rev().try_for_each(&mut run)?;
    let (held, asked) = (whole.change(), back.change());
    let held = (held.bytes_allocated - held.bytes_deallocated) as f64;
    let (bytes, voxels) = (detector.map().memory_bytes() as f64, detector.map().observed_voxels());
    Ok(format!(
        "| {number} | {voxels} | {:.1} | {:.2} | {:.1} | {:.2} | {} | {:.1} |",
        bytes / MEGA,
        bytes / voxels as f64,
        held / MEGA,
        held / bytes,
        asked.allocations as u64 / SCANS,
        asked.bytes_allocated as f64 / SCANS as f64 / MEGA,
    ))
}
