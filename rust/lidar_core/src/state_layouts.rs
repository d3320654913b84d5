//! Test: the layout of a saved state changes only together with the version of saved states.
//!
//! `state_layouts.txt` has the accepted layouts: the version, a checksum of the layout of every
//! kind, and the types in words. It is written again by
//! `LIDAR_CORE_WRITE_LAYOUTS=1 cargo test -p lidar_core --lib state_layouts`. This also raises the
//! version if a layout has changed: a state of before would be misread.

use crate::Error;
use crate::circles::map::{CircleMap, CircleMapParameters};
use crate::circles::parameters::PipelineParameters;
use crate::circles::pipeline::CirclePipeline;
use crate::flying::detector::FlyingObjectDetector;
use crate::flying::map::parameters::MapParameters;
use crate::flying::map::voxel_map::VoxelMap;
use crate::flying::parameters::FlyingParameters;
use crate::flying::track::{PointCloudTracker, TrackerParameters};
use crate::fusion::{Filter, FusionParameters, ManyParameters, ManyTargets};
use crate::util::full_state::{VERSION, crc32, version_of};
use crate::util::layout::{Layout, heard};
use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

const WRITE: &str = "LIDAR_CORE_WRITE_LAYOUTS";

fn file() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("src/state_layouts.txt")
}

/// Open one state of every kind.
fn open_all() -> Result<(), Error> {
    let map = VoxelMap::new(MapParameters::default())?.to_state()?;
    VoxelMap::from_state(&map)?;
    let parameters = TrackerParameters::default();
    let state = PointCloudTracker::new(parameters, 1)?.to_state()?;
    PointCloudTracker::from_state(parameters, 1, &state)?;
    let parameters = FlyingParameters::default();
    let state = FlyingObjectDetector::new(parameters.clone(), 1)?.to_state()?;
    FlyingObjectDetector::from_state(parameters, 1, &state)?;
    let parameters = CircleMapParameters::default();
    let state = CircleMap::new(parameters.clone())?.to_state()?;
    CircleMap::from_state(parameters, &state)?;
    let parameters = PipelineParameters::default();
    let state = CirclePipeline::new(parameters.clone())?.to_state()?;
    CirclePipeline::from_state(parameters, &state)?;
    let parameters = FusionParameters::default();
    let state = Filter::new(&parameters)?.to_state(&parameters)?;
    Filter::from_state(&parameters, &state)?;
    let parameters = ManyParameters::default();
    let state = ManyTargets::new(&parameters)?.to_state()?;
    ManyTargets::from_state(&parameters, &state)?;
    Ok(())
}

/// What `state_layouts.txt` says of these layouts.
fn told(version: u32, layouts: &BTreeMap<&'static str, Layout>) -> String {
    let mut types = BTreeSet::new();
    let mut lines = vec![format!("version {version}")];
    for (kind, layout) in layouts {
        lines.push(format!("{:08x} {kind}", crc32(layout.bare().as_bytes())));
        let whole = layout.named(&mut types);
        types.insert(format!("{kind}: {whole}"));
    }
    lines.extend(types);
    lines.join("\n") + "\n"
}

/// Lines of checksum and kind of such a text.
fn sums(text: &str) -> Vec<&str> {
    let has_checksum = |line: &&str| {
        line.split_once(' ').is_some_and(|(sum, _)| {
            sum.len() == 8 && sum.bytes().all(|byte| byte.is_ascii_hexdigit())
        })
    };
    text.lines().skip(1).take_while(has_checksum).collect()
}

/// Version that these layouts need: the next one if the layout of an accepted kind has changed.
fn version_for(accepted: &str, layouts: &BTreeMap<&'static str, Layout>) -> u32 {
    let version = version_of(accepted);
    let now = told(version, layouts);
    let now = sums(&now);
    version + u32::from(sums(accepted).iter().any(|line| !now.contains(line)))
}

/// What is wrong with the accepted layouts, and what to do.
fn compared(accepted: &str, now: &str) -> Result<(), String> {
    if accepted == now {
        return Ok(());
    }
    let lines = |one: &str, other: &str| {
        let kept: Vec<_> = other.lines().collect();
        one.lines().filter(|line| !kept.contains(line)).collect::<Vec<_>>().join("\n    ")
    };
    Err(format!(
        "the layouts of saved states are not those of state_layouts.txt; a changed layout needs a \
         new version. Both are written by {WRITE}=1 cargo test -p lidar_core --lib state_layouts\n  \
         Before:\n    {}\n  Now:\n    {}",
        lines(accepted, now),
        lines(now, accepted),
    ))
}

#[test]
fn layouts_change_only_with_the_version() -> Result<(), Box<dyn std::error::Error>> {
    let layouts = heard(open_all)?;
    let accepted = fs::read_to_string(file())?;
    let now = told(version_for(&accepted, &layouts), &layouts);
    assert!(!now.contains('?'), "a layout is not known to its end:\n{now}");
    assert_eq!(VERSION, version_of(&accepted), "the version is that of the list");
    if std::env::var_os(WRITE).is_some() {
        fs::write(file(), &now)?;
        return Ok(());
    }
    compared(&accepted, &now).map_err(Into::into)
}

#[test]
fn every_kind_of_state_is_compared() -> std::io::Result<()> {
    let (mut folders, mut opened) = (vec![Path::new(env!("CARGO_MANIFEST_DIR")).join("src")], 0);
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(folder)? {
            let path = entry?.path();
            if path.is_dir() {
                folders.push(path);
            } else if !path.ends_with("util/full_state.rs") && !path.ends_with(file!()) {
                let text = fs::read_to_string(&path)?;
                let code = text.split("#[cfg(test)]\nmod tests {").next().unwrap_or_default();
                opened += code.matches("opened(").count();
            }
        }
    }
    let known = sums(&fs::read_to_string(file())?).len();
    assert_eq!(opened, known, "a state is opened that `open_all` does not open");
    Ok(())
}

mod planted {
    //! A change of a layout is seen, and needs a new version; so that the test above can fail.

    use super::{Layout, compared, told, version_for};
    use serde::Deserialize;
    use std::collections::BTreeMap;

    mod before {
        use super::{Choice, Deserialize};
        #[derive(Deserialize)]
        #[allow(dead_code)]
        pub(super) struct Kept {
            pub(super) first: f64,
            pub(super) second: Option<Vec<(u32, [i16; 3])>>,
            pub(super) third: Choice,
        }
    }

    #[derive(Deserialize)]
    #[allow(dead_code)]
    pub(super) enum Choice {
        One,
        Two(u8, bool),
        Three { inner: String },
    }

    macro_rules! other {
        ($name:ident, $($field:ident: $type:ty),*) => {
            #[derive(Deserialize)]
            #[allow(dead_code)]
            struct $name { $($field: $type),* }
        };
    }
    other!(Renamed, first: f64, second: Option<Vec<(u32, [i16; 3])>>, third: Choice);
    other!(Narrowed, first: f64, second: Option<Vec<(u32, [i8; 3])>>, third: Choice);
    other!(Swapped, second: Option<Vec<(u32, [i16; 3])>>, first: f64, third: Choice);
    other!(Longer, first: f64, second: Option<Vec<(u32, [i16; 3])>>, third: Choice, fourth: bool);
    other!(Shorter, first: f64, third: Choice);

    fn layouts_of<T: serde::de::DeserializeOwned>() -> Result<BTreeMap<&'static str, Layout>, String>
    {
        let layout = Layout::of::<T>().map_err(|error| error.to_string())?;
        Ok(BTreeMap::from([("thing", layout)]))
    }

    #[test]
    fn a_layout_is_known_to_its_last_variant() -> Result<(), String> {
        let text = told(1, &layouts_of::<before::Kept>()?);
        assert!(text.contains("Choice: One | Two (u8, bool) | Three "), "{text}");
        assert!(text.contains("second option<list<(u32, [i16; 3])>>"), "{text}");
        assert!(text.contains("inner text"), "{text}");
        Ok(())
    }

    #[test]
    fn a_changed_layout_fails_and_needs_the_next_version() -> Result<(), String> {
        let accepted = told(7, &layouts_of::<before::Kept>()?);
        let same = layouts_of::<before::Kept>()?;
        assert_eq!(version_for(&accepted, &same), 7);
        assert_eq!(compared(&accepted, &told(7, &same)), Ok(()));
        let others = [
            layouts_of::<Narrowed>()?,
            layouts_of::<Swapped>()?,
            layouts_of::<Longer>()?,
            layouts_of::<Shorter>()?,
        ];
        for other in &others {
            assert_eq!(version_for(&accepted, other), 8);
            let Err(text) = compared(&accepted, &told(8, other)) else {
                return Err(format!("not seen: {}", told(8, other)));
            };
            assert!(text.contains("LIDAR_CORE_WRITE_LAYOUTS=1"), "{text}");
        }
        Ok(())
    }

    #[test]
    fn another_name_of_a_type_keeps_the_version() -> Result<(), String> {
        let accepted = told(7, &layouts_of::<before::Kept>()?);
        let renamed = layouts_of::<Renamed>()?;
        assert_eq!(version_for(&accepted, &renamed), 7);
        assert!(compared(&accepted, &told(7, &renamed)).is_err(), "the list is written again");
        Ok(())
    }
}
