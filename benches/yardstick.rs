//! The yardsticks as a program, for the bench beside other systems.
//!
//! `yardstick write FOLDER SCENE COUNT` leaves scans for all systems; `yardstick rays|cluster
//! FOLDER` reads numbers of scans from standard input, one a line, works on each, and answers with
//! the voxels visited or the clusters found.

use lidar_core::geometry::cluster::Clustering;
use scenes::reference::{DenseMap, cluster_hash};
use scenes::{Scan, files, street};
use std::error::Error;
use std::io::{Write, stdin, stdout};
use std::path::Path;

type Result<T> = std::result::Result<T, Box<dyn Error>>;

fn main() -> Result<()> {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let words: Vec<&str> = words.iter().map(String::as_str).collect();
    match *words {
        ["write", folder, scene, count] => {
            Ok(files::write(Path::new(folder), &street(scene.parse()?, count.parse()?)?)?)
        }
        ["rays", folder] => {
            let mut map = DenseMap::new([-50.0, -50.0, -1.0]);
            serve(folder, |scan| map.integrate(scan))
        }
        ["cluster", folder] => {
            serve(folder, |scan| cluster_hash(&scan.returns(), Clustering::default().max_distance))
        }
        _ => Err("expected: write FOLDER SCENE COUNT, rays FOLDER, or cluster FOLDER".into()),
    }
}

fn serve(folder: &str, mut work: impl FnMut(&Scan) -> usize) -> Result<()> {
    let scans = files::read(Path::new(folder))?;
    let mut out = stdout();
    writeln!(out, "ready")?;
    for line in stdin().lines() {
        let number: usize = line?.trim().parse()?;
        let scan = scans.get(number).ok_or("no such scan")?;
        writeln!(out, "{}", work(scan))?;
        out.flush()?;
    }
    Ok(())
}
