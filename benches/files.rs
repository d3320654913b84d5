//! Scans in plain files, for programs in other languages: `origins.f64` has the start of the rays
//! of every scan, `0.f32`, `1.f32` ... per ray its direction and its end, NaN without return.

use super::Scan;
use std::fs;
use std::io::Result;
use std::path::Path;

/// Write scans into a folder, which is made.
///
/// # Errors
/// Of the file system.
pub fn write(folder: &Path, scans: &[Scan]) -> Result<()> {
    fs::create_dir_all(folder)?;
    for (number, scan) in scans.iter().enumerate() {
        let rows = scan.directions.iter().zip(&scan.world);
        let values = rows.flat_map(|(direction, end)| direction.iter().chain(end));
        let bytes: Vec<u8> = values.flat_map(|value| value.to_le_bytes()).collect();
        fs::write(folder.join(format!("{number}.f32")), bytes)?;
    }
    let origins = scans.iter().flat_map(|scan| scan.origin);
    let bytes: Vec<u8> = origins.flat_map(f64::to_le_bytes).collect();
    fs::write(folder.join("origins.f64"), bytes)
}

/// Read the scans of a folder.
///
/// # Errors
/// Of the file system.
pub fn read(folder: &Path) -> Result<Vec<Scan>> {
    let origins = fs::read(folder.join("origins.f64"))?;
    let origins = origins.as_chunks::<8>().0.iter().map(|&bytes| f64::from_le_bytes(bytes));
    let origins: Vec<f64> = origins.collect();
    let scans = origins.as_chunks::<3>().0.iter().enumerate();
    scans
        .map(|(number, &origin)| {
            let bytes = fs::read(folder.join(format!("{number}.f32")))?;
            let values = bytes.as_chunks::<4>().0.iter().map(|&four| f32::from_le_bytes(four));
            let values: Vec<f32> = values.collect();
            let rows = values.as_chunks::<6>().0;
            let directions = rows.iter().map(|&[x, y, z, ..]| [x, y, z]).collect();
            Ok(Scan::new(origin, directions, rows.iter().map(|&[.., x, y, z]| [x, y, z]).collect()))
        })
        .collect()
}
