//! Test: the layout of a saved state changes only together with the version of saved states.
//!
//! `state_layouts.txt` has the accepted layouts: the version, a checksum of the layout of every
//! kind, and the types in words. It is written again by
//! `LIDAR_CORE_WRITE_LAYOUTS=1 cargo test -p lidar_core --lib state_layouts`, but not where a
//! layout has changed and the version has not.

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
use crate::util::full_state::{VERSION, crc32};
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

/// Version of such a text, and its lines of checksum and kind.
fn head(text: &str) -> (&str, Vec<&str>) {
    let has_checksum = |line: &&str| {
        line.split_once(' ').is_some_and(|(sum, _)| {
            sum.len() == 8 && sum.bytes().all(|byte| byte.is_ascii_hexdigit())
        })
    };
    let mut lines = text.lines();
    (lines.next().unwrap_or_default(), lines.take_while(has_checksum).collect())
}

/// Whether layouts may be what they are now.
///
/// # Errors
/// What is wrong and what to do; `true` with it where writing the file again is the cure.
fn compared(accepted: &str, now: &str) -> Result<(), (bool, String)> {
    if accepted == now {
        return Ok(());
    }
    let (before, after) = (head(accepted), head(now));
    let changed: Vec<_> = before.1.iter().filter(|line| !after.1.contains(line)).collect();
    if before.0 == after.0 && !changed.is_empty() {
        let lines = |one: &str, other: &str| {
            let kept: Vec<_> = other.lines().collect();
            one.lines().filter(|line| !kept.contains(line)).collect::<Vec<_>>().join("\n    ")
        };
        return Err((
            false,
            format!(
                "the layout of saved states has changed, and their {} has not: a state of before \
                 would be misread. Raise VERSION in util/full_state.rs, then write \
                 state_layouts.txt again with {WRITE}=1.\n  Before:\n    {}\n  Now:\n    {}",
                after.0,
                lines(accepted, now),
                lines(now, accepted),
            ),
        ));
    }
    let what = "state_layouts.txt is of another version, or a type has another name, or a kind of \
                state is new: write it again with";
    Err((true, format!("{what} {WRITE}=1 cargo test -p lidar_core --lib state_layouts")))
}

#[test]
fn layouts_change_only_with_the_version() -> Result<(), Box<dyn std::error::Error>> {
    let layouts = heard(open_all)?;
    let now = told(VERSION, &layouts);
    assert!(!now.contains('?'), "a layout is not known to its end:\n{now}");
    let compared = compared(&fs::read_to_string(file())?, &now);
    if matches!(compared, Err((true, _))) && std::env::var_os(WRITE).is_some() {
        fs::write(file(), &now)?;
        return Ok(());
    }
    compared.map_err(|(_, text)| text.into())
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
    let known = head(&fs::read_to_string(file())?).1.len();
    assert_eq!(opened, known, "a state is opened that `open_all` does not open");
    Ok(())
}

mod planted {
    //! A change of a layout with the same version fails; so that the test above can fail.

    use super::{Layout, compared, told};
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

    fn text_of<T: serde::de::DeserializeOwned>(version: u32) -> Result<String, String> {
        let layout = Layout::of::<T>().map_err(|error| error.to_string())?;
        Ok(told(version, &BTreeMap::from([("thing", layout)])))
    }

    #[test]
    fn a_layout_is_known_to_its_last_variant() -> Result<(), String> {
        let text = text_of::<before::Kept>(1)?;
        assert!(text.contains("Choice: One | Two (u8, bool) | Three "), "{text}");
        assert!(text.contains("second option<list<(u32, [i16; 3])>>"), "{text}");
        assert!(text.contains("inner text"), "{text}");
        Ok(())
    }

    #[test]
    fn a_changed_layout_with_the_same_version_fails() -> Result<(), String> {
        let accepted = text_of::<before::Kept>(1)?;
        assert_eq!(compared(&accepted, &text_of::<before::Kept>(1)?), Ok(()));
        let others = [
            text_of::<Narrowed>(1)?,
            text_of::<Swapped>(1)?,
            text_of::<Longer>(1)?,
            text_of::<Shorter>(1)?,
        ];
        for now in others {
            let Err((false, text)) = compared(&accepted, &now) else {
                return Err(format!("not seen: {now}"));
            };
            assert!(text.contains("Raise VERSION in util/full_state.rs"), "{text}");
        }
        Ok(())
    }

    #[test]
    fn a_changed_layout_of_a_new_version_or_a_new_name_only_needs_the_file() -> Result<(), String> {
        let accepted = text_of::<before::Kept>(1)?;
        for now in [text_of::<Longer>(2)?, text_of::<Renamed>(1)?] {
            let compared = compared(&accepted, &now);
            assert!(matches!(compared, Err((true, _))), "{compared:?}");
        }
        Ok(())
    }
}
