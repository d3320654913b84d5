//! Classes of points: results of the detector, and inputs of the map.

use crate::Error;
use crate::util::budget::check_points;

/// Class of a point.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[repr(u8)]
pub enum PointClass {
    /// No information: the point is ignored.
    #[default]
    Invalid = 0,
    /// A point on something that belongs to the environment.
    Background = 1,
    /// A point on a flying object.
    Flying = 2,
    /// A point that is neither background nor known to fly.
    Unknown = 3,
    /// A point on something that moves on the ground. Maps treat it as unknown.
    Moving = 4,
}

impl From<PointClass> for u8 {
    fn from(class: PointClass) -> Self {
        class as Self
    }
}

/// Classes from an array of their numbers (0 to 4).
///
/// The result is a copy. Otherwise another thread could write an invalid number into `numbers`
/// while a view of them is in use.
///
/// # Errors
/// [`Error::Limit`] for more points than a scan may have, [`Error::Value`] if a number is not a class
/// (0 to 4).
pub fn classes_from_numbers(numbers: &[u8]) -> Result<Vec<PointClass>, Error> {
    check_points(numbers.len())?;
    if let Some(index) = numbers.iter().position(|&number| number > PointClass::Moving.into()) {
        return Err(Error::Value {
            name: "point_class",
            expected: "0 invalid, 1 background, 2 flying, 3 unknown or 4 moving",
            index,
            got: numbers[index].to_string(),
        });
    }
    // Every number is known by now. Without a way to fail, the loop is one for vector units.
    Ok(numbers.iter().map(|&number| class_from_number(number)).collect())
}

/// The numbers of classes, in the same memory.
#[must_use]
pub fn numbers_from_classes(classes: Vec<PointClass>) -> Vec<u8> {
    classes.into_iter().map(u8::from).collect()
}

fn class_from_number(number: u8) -> PointClass {
    match number {
        1 => PointClass::Background,
        2 => PointClass::Flying,
        3 => PointClass::Unknown,
        4 => PointClass::Moving,
        _ => PointClass::Invalid,
    }
}

/// Replace the class `old` by `new` wherever it occurs.
pub(crate) fn replace(classes: &mut [PointClass], old: PointClass, new: PointClass) {
    classes.iter_mut().filter(|class| **class == old).for_each(|class| *class = new);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_of_classes_are_those_of_the_interface() -> Result<(), Error> {
        let classes = classes_from_numbers(&[0, 1, 2, 3, 4])?;
        use PointClass::{Background, Flying, Invalid, Moving, Unknown};
        assert_eq!(classes, [Invalid, Background, Flying, Unknown, Moving]);
        let memory = classes.as_ptr().cast::<u8>();
        let numbers = numbers_from_classes(classes);
        assert_eq!(numbers, [0, 1, 2, 3, 4]);
        assert_eq!(numbers.as_ptr(), memory); // nothing is copied on the way out
        Ok(())
    }

    #[test]
    fn the_first_number_of_no_class_is_refused() {
        let refused = classes_from_numbers(&[0, 4, 5, 255]);
        let is_named =
            |error: &Error| matches!(error, Error::Value { index: 2, got, .. } if got == "5");
        assert!(refused.as_ref().is_err_and(is_named), "{refused:?}");
    }
}
