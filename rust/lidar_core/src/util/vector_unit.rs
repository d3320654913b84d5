//! Choice of the CPU's vector unit for kernels. All units give the same bits.

use crate::Error;
use pulp::{Arch, WithSimd};
use std::sync::OnceLock;

/// Environment variable that names the vector unit to use, for tests and comparisons.
pub const VARIABLE: &str = "LIDAR_CORE_SIMD";
const NAMES: &str = "scalar, or avx2, avx512, neon where the CPU has it";

/// The unit that is used. If the variable names a unit that this CPU does not have: the text of the
/// variable.
static CHOSEN: OnceLock<Result<Arch, String>> = OnceLock::new();

/// Units of this CPU for which kernels are built, with their names. The best is last.
fn units() -> Vec<(&'static str, Arch)> {
    let mut found = vec![("scalar", Arch::Scalar)];
    #[cfg(target_arch = "x86_64")]
    {
        found.extend(pulp::x86::V3::try_new().map(|unit| ("avx2", Arch::V3(unit))));
        found.extend(pulp::x86::V4::try_new().map(|unit| ("avx512", Arch::V4(unit))));
    }
    #[cfg(target_arch = "aarch64")]
    found.extend(pulp::aarch64::Neon::try_new().map(|unit| ("neon", Arch::Neon(unit))));
    found
}

/// Names of the CPU's vector units for which kernels are built. The best is last.
#[must_use]
pub fn available() -> Vec<&'static str> {
    units().into_iter().map(|(name, _)| name).collect()
}

/// Name of the vector unit that kernels use: the best one, or the one that [`VARIABLE`] names. The
/// variable is read only once.
///
/// # Errors
/// [`Error::Parameter`] if the variable names a unit that this CPU does not have.
pub fn used() -> Result<&'static str, Error> {
    let parameter =
        |got: &String| Error::Parameter { name: VARIABLE, expected: NAMES, got: got.clone() };
    let arch = chosen().as_ref().map_err(parameter)?;
    let is_used = |unit: &Arch| std::mem::discriminant(unit) == std::mem::discriminant(arch);
    Ok(units().into_iter().find(|(_, unit)| is_used(unit)).map_or("scalar", |(name, _)| name))
}

/// Run a kernel on the chosen vector unit.
#[inline]
pub(crate) fn dispatch<Kernel: WithSimd>(kernel: Kernel) -> Kernel::Output {
    // Stages refuse a wrong variable when they are made, so nobody sees results of this choice.
    let arch = chosen().as_ref().copied().unwrap_or(Arch::Scalar);
    arch.dispatch(kernel)
}

fn chosen() -> &'static Result<Arch, String> {
    CHOSEN.get_or_init(|| match std::env::var_os(VARIABLE).filter(|text| !text.is_empty()) {
        None => Ok(Arch::new()),
        Some(text) => named(&text.to_string_lossy()),
    })
}

/// The unit of this CPU with this name. Otherwise the name, as an error.
fn named(name: &str) -> Result<Arch, String> {
    let found = units().into_iter().find(|(known, _)| *known == name);
    found.map(|(_, unit)| unit).ok_or_else(|| name.to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;
    use pulp::Simd;

    struct Lanes;

    impl WithSimd for Lanes {
        type Output = usize;

        fn with_simd<S: Simd>(self, _: S) -> usize {
            S::F32_LANES
        }
    }

    #[test]
    fn every_name_is_of_another_unit_and_unknown_names_are_of_none() {
        let lanes: Vec<usize> = units().into_iter().map(|(_, unit)| unit.dispatch(Lanes)).collect();
        assert!(lanes.windows(2).all(|two| two[0] < two[1]), "{lanes:?}");
        for (name, unit) in units() {
            assert_eq!(named(name).map(|found| found.dispatch(Lanes)), Ok(unit.dispatch(Lanes)));
        }
        for wrong in ["", "AVX2", "sse", "avx512 "] {
            assert!(named(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn the_best_unit_is_used_where_nobody_says_otherwise() -> Result<(), Error> {
        let expected = std::env::var(VARIABLE).ok().filter(|text| !text.is_empty());
        let best = available().last().copied().unwrap_or_default();
        assert_eq!(used()?, expected.as_deref().unwrap_or(best));
        Ok(())
    }
}
