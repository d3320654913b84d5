//! The robot itself, as it is saved with a map: for each sensor, the voxels around it that the
//! robot fills.
//!
//! Layout (little endian), after the blocks of the map: edge of a voxel f64 \[m\] and number of
//! voxels along an edge of the cube around the sensor u32, so that the reader notices another grid;
//! number of sensors u32. For each sensor, in ascending order of names: name (length u32, UTF-8),
//! whether turns of the robot have confirmed the voxels (u8, 0 or 1), voxels (their number u32,
//! then the index of each u32, ascending).

use super::reader::{Reader, format_error};
use crate::Error;
use crate::util::budget::{MAX_SENSORS, vec_with_capacity};
use serde::{Deserialize, Serialize};

/// Edge of a voxel of the robot itself [m].
pub(crate) const SIZE: f64 = 0.2;
/// Number of voxels along an edge of the cube around the sensor. The cube extends 6.4 m to each
/// side.
pub(crate) const EDGE: usize = 64;

/// Voxels around one sensor that the robot itself fills.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct SavedBody {
    /// Name of the sensor.
    pub sensor: String,
    /// Whether turns of the robot have confirmed that the voxels are the robot, and not an object
    /// that moves along with it.
    pub is_decided: bool,
    /// Indices of the voxels in the cube around the sensor, ascending: (x * edge + y) * edge + z.
    pub voxels: Vec<u32>,
}

/// Append the voxels of the robot itself, for each sensor, to `bytes`.
pub(super) fn write_bodies(bodies: &[SavedBody], bytes: &mut Vec<u8>) {
    let (size, edge) = (SIZE, EDGE as u32);
    bytes.extend(size.to_le_bytes());
    bytes.extend(edge.to_le_bytes());
    bytes.extend((bodies.len() as u32).to_le_bytes());
    for body in bodies {
        bytes.extend((body.sensor.len() as u32).to_le_bytes());
        bytes.extend(body.sensor.as_bytes());
        bytes.push(u8::from(body.is_decided));
        bytes.extend((body.voxels.len() as u32).to_le_bytes());
        bytes.extend(body.voxels.iter().flat_map(|voxel| voxel.to_le_bytes()));
    }
}

/// Read the voxels that [`write_bodies`] wrote, to the end of the bytes.
///
/// # Errors
/// [`Error::Format`] with the byte offset, [`Error::Limit`].
pub(super) fn read_bodies(reader: &mut Reader<'_>) -> Result<Vec<SavedBody>, Error> {
    let (size, edge) = (SIZE, EDGE as u32);
    let at = reader.at;
    let (given_size, given_edge) = (f64::from_le_bytes(reader.take()?), reader.u32()?);
    if (given_size, given_edge) != (size, edge) {
        let text = format!(
            "expected the robot in {edge} voxels of {size} m along an edge, got {given_edge} of \
             {given_size} m"
        );
        return Err(format_error(at, &text));
    }
    let at = reader.at;
    let count = reader.u32()? as usize;
    if count > MAX_SENSORS {
        let text = format!("expected the robot of at most {MAX_SENSORS} sensors, got {count}");
        return Err(format_error(at, &text));
    }
    let mut bodies: Vec<SavedBody> = Vec::new();
    for _ in 0..count {
        let at = reader.at;
        let body = read_body(reader)?;
        // Ascending order: no sensor comes twice, and equal robots give equal bytes.
        if bodies.last().is_some_and(|last| last.sensor >= body.sensor) {
            let text = format!("sensor {:?}: expected names in ascending order", body.sensor);
            return Err(format_error(at, &text));
        }
        bodies.push(body);
    }
    // The checksum has been cut off: nothing may follow.
    if reader.left() > 0 {
        let text = format!("expected the end of the map, got {} more bytes", reader.left());
        return Err(format_error(reader.at, &text));
    }
    Ok(bodies)
}

fn read_body(reader: &mut Reader<'_>) -> Result<SavedBody, Error> {
    let at = reader.at;
    let length = reader.u32()? as usize;
    let name = reader.slice(length)?.to_vec();
    let sensor = String::from_utf8(name)
        .map_err(|_| format_error(at, "expected the name of a sensor in UTF-8"))?;
    let at = reader.at;
    let is_decided = match reader.take::<1>()? {
        [0] => false,
        [1] => true,
        [other] => {
            return Err(format_error(at, &format!("expected 0 or 1, got {other}")));
        }
    };
    let at = reader.at;
    let count = reader.u32()? as usize;
    // Compared with the bytes that are left before memory is taken for it.
    if count == 0 || reader.left() / 4 < count {
        let text = format!("expected 1 to {} voxels of the robot, got {count}", reader.left() / 4);
        return Err(format_error(at, &text));
    }
    let volume = (EDGE * EDGE * EDGE) as u32;
    let mut voxels =
        vec_with_capacity("voxels of a robot", count, volume as usize, "a smaller one")?;
    for _ in 0..count {
        let at = reader.at;
        let voxel = reader.u32()?;
        if voxel >= volume || voxels.last().is_some_and(|&last| last >= voxel) {
            let text = format!("expected ascending voxels below {volume}, got {voxel}");
            return Err(format_error(at, &text));
        }
        voxels.push(voxel);
    }
    Ok(SavedBody { sensor, is_decided, voxels })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::flying::map::persist::tests::sample;
    use crate::flying::map::voxel_map::VoxelMap;
    use crate::util::full_state::crc32;

    fn bodies() -> Vec<SavedBody> {
        let body = |sensor: &str, is_decided, voxels: &[u32]| SavedBody {
            sensor: sensor.into(),
            is_decided,
            voxels: voxels.to_vec(),
        };
        vec![body("", false, &[0]), body("vorn \u{e4}", true, &[5, 6, 262_143])]
    }

    #[test]
    fn the_robot_comes_back_with_its_map() -> Result<(), Error> {
        let map = sample()?;
        let bytes = map.to_bytes_with(&bodies());
        let (back, found) = VoxelMap::from_bytes_with(&bytes)?;
        assert_eq!((back.to_bytes(), found), (map.to_bytes(), bodies()));
        assert_eq!(VoxelMap::from_bytes(&bytes)?.to_bytes(), map.to_bytes());
        assert_eq!(VoxelMap::from_bytes_with(&map.to_bytes())?.1, []);
        assert_eq!(map.to_bytes_with(&[]), map.to_bytes());
        Ok(())
    }

    #[test]
    fn every_cut_and_every_hostile_byte_is_refused_by_a_typed_error() -> Result<(), Error> {
        let map = sample()?;
        let (bytes, plain) = (map.to_bytes_with(&bodies()), map.to_bytes().len() - 4);
        let body = bytes.len() - 4;
        let sealed = |bytes: &[u8]| [bytes, &crc32(bytes).to_le_bytes()].concat();
        for len in plain..body {
            let cut = VoxelMap::from_bytes(&sealed(&bytes[..len]));
            assert!(matches!(cut, Err(Error::Format { .. })), "{len}");
        }
        let longer = sealed(&[&bytes[..body], &[0]].concat());
        assert!(matches!(VoxelMap::from_bytes(&longer), Err(Error::Format { .. })));
        let (mut refused, mut all) = (0, 0);
        for at in plain..body {
            for flip in [0x01, 0x80, 0xFF] {
                let mut hostile = bytes[..body].to_vec();
                hostile[at] ^= flip;
                all += 1;
                match VoxelMap::from_bytes(&sealed(&hostile)) {
                    Err(Error::Format { .. } | Error::Limit { .. }) => refused += 1,
                    Err(other) => return Err(other),
                    Ok(_) => {} // another name, another voxel
                }
            }
        }
        assert!(2 * refused > all, "{refused} of {all}");
        Ok(())
    }
}
