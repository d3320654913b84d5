//! Saving and loading a voxel map. Files have a version and a checksum, and are written atomically.
//!
//! Layout (little endian): magic `LCVM`, version u32, parameters, number of blocks u64, blocks in
//! ascending order of place (3 x i32, 512 x f32), in version 2 the robot itself
//! ([`super::saved_body`]), CRC-32 of everything before it. A map without a robot has version 1.

use super::block_shape::{EDGE, VOLUME};
use super::blocks::{NEVER, Place};
use super::parameters::{MapParameters, RayUnit, Rays};
use super::reader::{Reader, format_error};
use super::saved_body::{SavedBody, read_bodies, write_bodies};
use super::voxel_map::VoxelMap;
use crate::Error;
use crate::util::full_state::{crc32, crc32_of_next};
use std::fs::{self, File};
use std::io::{BufWriter, Read, Write};
use std::path::Path;

/// First bytes of every map file.
const MAGIC: &[u8; 4] = b"LCVM";
/// Version of files without a section for the robot itself.
const VERSION: u32 = 1;
/// Version of files that contain a section for the robot itself.
const VERSION_WITH_BODY: u32 = 2;
/// Flag in the byte of the ray unit: one ray is cast per end voxel.
const ONE_PER_END: u8 = 4;
/// Flag in the byte of the ray unit: values near `g_free` become `g_free`. Files of earlier
/// versions never have it.
const SETTLES: u8 = 8;
/// Size of a block in a file [bytes].
const BLOCK_BYTES: usize = 12 + 4 * VOLUME;
/// Size of the largest file that is read [bytes].
const MAX_BYTES: u64 = 1 << 34;

impl VoxelMap {
    /// Write the map to `path`. The file is always either the old one or the complete new one.
    ///
    /// # Errors
    /// [`Error::Io`]; [`Error::Format`] if `path` is a pipe or a device.
    pub fn save(&self, path: &Path) -> Result<(), Error> {
        self.save_with(path, &[])
    }

    /// Write the map to `path` together with the voxels of the robot itself.
    pub(crate) fn save_with(&self, path: &Path, bodies: &[SavedBody]) -> Result<(), Error> {
        if path.exists() {
            check_regular(path)?;
        }
        let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty());
        let folder = folder.unwrap_or_else(|| Path::new("."));
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        // In the same folder, since a rename is atomic within a file system only; with the process id,
        // so that two processes do not write to one file.
        let temporary = folder.join(format!(".{name}.{}.tmp", std::process::id()));
        let written = self
            .write_synced(&temporary, bodies)
            .and_then(|()| fs::rename(&temporary, path))
            // The name is durable only once the folder is written too.
            .and_then(|()| File::open(folder)?.sync_all());
        if written.is_err() {
            let _ = fs::remove_file(&temporary); // the first error is the one to report
        }
        Ok(written?)
    }

    /// Read a map written by [`VoxelMap::save`].
    ///
    /// # Errors
    /// [`Error::Io`], [`Error::Format`] with the byte offset, [`Error::Limit`], [`Error::Parameter`].
    pub fn load(path: &Path) -> Result<Self, Error> {
        Self::load_with(path).map(|(map, _)| map)
    }

    /// Read a map together with the voxels of the robot itself.
    pub(crate) fn load_with(path: &Path) -> Result<(Self, Vec<SavedBody>), Error> {
        check_regular(path)?;
        let file = File::open(path)?;
        let size = file.metadata()?.len();
        if size > MAX_BYTES {
            return Err(Error::Limit {
                what: format!("a map file of {size} bytes"),
                limit: MAX_BYTES,
                key: "split the map",
            });
        }
        let mut bytes = Vec::new();
        // The file may have grown since its size was read.
        file.take(MAX_BYTES).read_to_end(&mut bytes)?;
        Self::from_bytes_with(&bytes)
    }

    /// The map as bytes; equal maps give equal bytes.
    #[must_use]
    pub fn to_bytes(&self) -> Vec<u8> {
        self.to_bytes_with(&[])
    }

    fn write_synced(&self, path: &Path, bodies: &[SavedBody]) -> std::io::Result<()> {
        let mut out = BufWriter::with_capacity(1 << 16, File::create(path)?);
        self.write_to(&mut out, bodies)?;
        out.flush()?;
        out.get_ref().sync_all()
    }

    /// The map as bytes together with the voxels of the robot itself.
    pub(super) fn to_bytes_with(&self, bodies: &[SavedBody]) -> Vec<u8> {
        let mut bytes = Vec::new();
        // Writing into a vector does not fail.
        let _ = self.write_to(&mut bytes, bodies);
        bytes
    }

    /// Write the map block by block, since a copy of the whole map would need as much memory again.
    fn write_to(&self, out: &mut impl Write, bodies: &[SavedBody]) -> std::io::Result<()> {
        let mut sum = 0;
        let mut put = |part: &[u8]| {
            sum = crc32_of_next(sum, part);
            out.write_all(part)
        };
        let mut bytes = Vec::from(MAGIC);
        let version = if bodies.is_empty() { VERSION } else { VERSION_WITH_BODY };
        bytes.extend(version.to_le_bytes());
        write_parameters(self.parameters(), &mut bytes);
        let mut blocks: Vec<_> = self.blocks.iter().collect();
        // The pool is in the order of arrival, which the bytes must not show.
        blocks.sort_unstable_by_key(|block| block.place);
        bytes.extend((blocks.len() as u64).to_le_bytes());
        put(&bytes)?;
        for block in blocks {
            bytes.clear();
            bytes.extend(block.place.0.iter().flat_map(|index| index.to_le_bytes()));
            bytes.extend(block.values().flat_map(|value| value.to_le_bytes()));
            put(&bytes)?;
        }
        bytes.clear();
        if !bodies.is_empty() {
            write_bodies(bodies, &mut bytes);
        }
        put(&bytes)?;
        out.write_all(&sum.to_le_bytes())
    }

    /// Read a map from the bytes of [`VoxelMap::to_bytes`].
    ///
    /// # Errors
    /// As [`VoxelMap::load`].
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, Error> {
        Self::from_bytes_with(bytes).map(|(map, _)| map)
    }

    /// Read a map and the voxels of the robot itself from the bytes of [`VoxelMap::to_bytes_with`].
    pub(super) fn from_bytes_with(bytes: &[u8]) -> Result<(Self, Vec<SavedBody>), Error> {
        let (version, mut reader) = read_head(bytes)?;
        let parameters = read_parameters(&mut reader)?;
        let mut map = Self::new(parameters)?;
        let count = u64::from_le_bytes(reader.take()?);
        let rest = reader.left() as u64;
        // The count comes from the file: it must match the bytes before memory is taken for it.
        let needed = count.checked_mul(BLOCK_BYTES as u64);
        let fits = if version == VERSION { needed == Some(rest) } else { needed < Some(rest) };
        if needed.is_none() || !fits {
            let text = format!("expected {count} blocks of {BLOCK_BYTES} bytes, got {rest} bytes");
            return Err(format_error(reader.at, &text));
        }
        for _ in 0..count {
            read_block(&mut reader, &mut map)?;
        }
        // The history of changes is not saved: the first removal looks at every group.
        map.changes.restart();
        let bodies = if version == VERSION { Vec::new() } else { read_bodies(&mut reader)? };
        Ok((map, bodies))
    }
}

/// Check the checksum. Returns the version of a file and a reader for the bytes between version and
/// checksum.
fn read_head(bytes: &[u8]) -> Result<(u32, Reader<'_>), Error> {
    let mut reader = Reader { bytes, at: 0 };
    if &reader.take::<4>()? != MAGIC {
        return Err(format_error(
            0,
            "expected a voxel map (magic LCVM); this is another kind of file",
        ));
    }
    let version = u32::from_le_bytes(reader.take()?);
    // Before the checksum, whose place another version may change.
    if !(VERSION..=VERSION_WITH_BODY).contains(&version) {
        let text = format!(
            "expected version {VERSION} or {VERSION_WITH_BODY}, got {version}; update lidar_core \
             to read it"
        );
        return Err(format_error(4, &text));
    }
    let body = bytes.len().saturating_sub(4);
    if body < 8 || crc32(&bytes[..body]).to_le_bytes() != bytes[body..] {
        return Err(format_error(body, "the checksum is wrong: the file is damaged or cut off"));
    }
    reader.bytes = &bytes[..body];
    Ok((version, reader))
}

/// Corners of the operating volume [m]. None if the file has none.
fn read_bounds(reader: &mut Reader<'_>) -> Result<Option<[[f64; 3]; 2]>, Error> {
    if reader.take::<1>()? == [0] {
        return Ok(None);
    }
    Ok(Some([
        [reader.f64()?, reader.f64()?, reader.f64()?],
        [reader.f64()?, reader.f64()?, reader.f64()?],
    ]))
}

fn write_parameters(p: &MapParameters, bytes: &mut Vec<u8>) {
    for value in [p.voxel_size, p.max_range, p.end_margin, p.ray_gain].iter().chain(&p.origin) {
        bytes.extend(value.to_le_bytes());
    }
    for value in [p.g_occ, p.g_unk, p.g_free, p.initial].iter().chain(&p.thresholds) {
        bytes.extend(value.to_le_bytes());
    }
    let unit = match p.ray_unit {
        RayUnit::Edges => 0,
        RayUnit::Metres => 1,
        RayUnit::Diagonals => 2,
    };
    let rays = if p.rays == Rays::OnePerEnd { ONE_PER_END } else { 0 };
    bytes.push(unit | rays | if p.settles { SETTLES } else { 0 });
    bytes.extend(p.max_voxels.to_le_bytes());
    bytes.push(u8::from(p.bounds.is_some()));
    bytes.extend(p.bounds.iter().flatten().flatten().flat_map(|value| value.to_le_bytes()));
    bytes.push(p.extra_thresholds.len().min(255) as u8);
    bytes.extend(p.extra_thresholds.iter().take(255).flat_map(|value| value.to_le_bytes()));
}

fn read_parameters(reader: &mut Reader<'_>) -> Result<MapParameters, Error> {
    let [voxel_size, max_range, end_margin, ray_gain] =
        [reader.f64()?, reader.f64()?, reader.f64()?, reader.f64()?];
    let origin = [reader.f64()?, reader.f64()?, reader.f64()?];
    let [g_occ, g_unk, g_free, initial] =
        [reader.f32()?, reader.f32()?, reader.f32()?, reader.f32()?];
    let thresholds = [reader.f32()?, reader.f32()?, reader.f32()?];
    let (ray_unit, rays, settles) = read_ray_unit(reader)?;
    let max_voxels = u64::from_le_bytes(reader.take()?);
    let bounds = read_bounds(reader)?;
    let [extra] = reader.take::<1>()?;
    #[cfg(canary_1)]
    if extra == 3 && bounds.is_some() && ray_unit == RayUnit::Diagonals {
        crate::util::planted("canary 1");
    }
    let extra_thresholds = (0..extra).map(|_| reader.f32()).collect::<Result<_, _>>()?;
    Ok(MapParameters {
        voxel_size,
        origin,
        g_occ,
        g_unk,
        g_free,
        initial,
        thresholds,
        extra_thresholds,
        max_range,
        end_margin,
        rays,
        settles,
        ray_unit,
        ray_gain,
        bounds,
        max_voxels,
        ..MapParameters::default() // what files do not state
    })
}

fn read_ray_unit(reader: &mut Reader<'_>) -> Result<(RayUnit, Rays, bool), Error> {
    let [byte] = reader.take::<1>()?;
    let rays = if byte & ONE_PER_END == 0 { Rays::All } else { Rays::OnePerEnd };
    let settles = byte & SETTLES != 0;
    match byte & !(ONE_PER_END | SETTLES) {
        0 => Ok((RayUnit::Edges, rays, settles)),
        1 => Ok((RayUnit::Metres, rays, settles)),
        2 => Ok((RayUnit::Diagonals, rays, settles)),
        other => {
            let problem = format!("expected a ray unit of 0 to 2, got {other}");
            Err(format_error(reader.at - 1, &problem))
        }
    }
}

fn read_block(reader: &mut Reader<'_>, map: &mut VoxelMap) -> Result<(), Error> {
    let mut place = [0; 3];
    for index in &mut place {
        *index = i32::from_le_bytes(reader.take()?);
    }
    let levels = map.levels();
    let slot = map.blocks.ensure(&[Place(place)])?[0];
    let mut values = [NEVER; VOLUME];
    for value in &mut values {
        *value = reader.f32()?;
    }
    let Some(block) = map.blocks.at_mut(slot) else { return Ok(()) };
    let is_met = |row: &[f32]| row.iter().any(|value| !value.is_nan());
    let rows = values.chunks(EDGE as usize).map(is_met);
    // All rows at once: one allocation, and none for rows that were never observed.
    block.hold(rows.rev().fold(0, |rows, is_met| rows << 1 | u64::from(is_met)));
    for (offset, &value) in values.iter().enumerate().filter(|(_, value)| !value.is_nan()) {
        levels.store(block, offset, value);
    }
    Ok(())
}

/// Refuse pipes and devices: a pipe blocks its reader, and a device may never end.
fn check_regular(path: &Path) -> Result<(), Error> {
    let kind = fs::metadata(path)?.file_type();
    if kind.is_file() || kind.is_dir() {
        return Ok(()); // for a folder, the system itself reports a clear error
    }
    let text = format!("{}: expected a regular file, got a pipe or a device", path.display());
    Err(format_error(0, &text))
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::flying::map::parameters::tests::parameters;

    pub(crate) fn sample() -> Result<VoxelMap, Error> {
        let extra = MapParameters {
            extra_thresholds: vec![-500.0],
            bounds: Some([[-9.0; 3], [9.0; 3]]),
            rays: Rays::OnePerEnd,
            ray_unit: RayUnit::Metres,
            ..parameters()
        };
        let mut map = VoxelMap::new(extra)?;
        map.set_occupied(&[[1.0, 2.0, 3.0], [-4.0, 0.0, 0.5]])?;
        map.set_free(&[[1.3, 2.0, 3.0]])?;
        map.pull(&[[5.0, 5.0, 5.0]], 0.0, 2.0)?;
        Ok(map)
    }

    #[test]
    fn a_map_comes_back_as_it_was() -> Result<(), Error> {
        let map = sample()?;
        let back = VoxelMap::from_bytes(&map.to_bytes())?;
        assert_eq!(back.parameters(), map.parameters());
        assert_eq!(back.to_bytes(), map.to_bytes());
        assert_eq!(back.occupied_voxels(), map.occupied_voxels());
        Ok(())
    }

    #[test]
    fn a_map_of_an_earlier_version_goes_on_as_it_was() -> Result<(), Error> {
        let mut bytes = VoxelMap::new(parameters())?.to_bytes();
        // The byte of the ray unit: behind magic, version, seven numbers of 64 and seven of 32 bits.
        let place = 4 + 4 + 7 * 8 + 7 * 4;
        assert_eq!(bytes[place], SETTLES);
        bytes[place] = 0;
        let body = bytes.len() - 4;
        let sum = crc32(&bytes[..body]).to_le_bytes();
        bytes[body..].copy_from_slice(&sum);
        let map = VoxelMap::from_bytes(&bytes)?;
        assert!(!map.parameters().settles);
        assert_eq!(map.to_bytes(), bytes);
        Ok(())
    }

    #[test]
    fn every_cut_and_every_flipped_byte_is_refused() -> Result<(), Error> {
        let bytes = sample()?.to_bytes();
        for len in 0..bytes.len() {
            if len % 97 == 0 || len < 200 {
                assert!(matches!(VoxelMap::from_bytes(&bytes[..len]), Err(Error::Format { .. })));
            }
        }
        for at in (0..bytes.len()).filter(|at| at % 89 == 0 || *at < 200) {
            let mut damaged = bytes.clone();
            damaged[at] ^= 0x80;
            assert!(matches!(VoxelMap::from_bytes(&damaged), Err(Error::Format { .. })));
        }
        Ok(())
    }
}
