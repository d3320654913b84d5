//! The exponential filter of voxel values, and the bounds between occupied states.
//!
//! Source: Vrba et al., eqs 7 and 12.

use super::block_shape::assign;
use super::blocks::Block;

/// Lower bounds of the states tentatively and confidently occupied.
#[derive(Clone, Copy)]
pub(crate) struct Levels {
    pub(crate) tentative: f32,
    pub(crate) confident: f32,
}

impl Levels {
    /// Store a value in a block. Returns true if groups of occupied voxels may have changed or
    /// become weaker: the state of the voxel has changed, except for a change of an occupied voxel
    /// to a higher state.
    #[inline]
    pub(crate) fn store(self, block: &mut Block, offset: usize, value: f32) -> bool {
        let old = block.value(offset);
        block.set(offset, value);
        if !self.crosses(old, value) {
            return false;
        }
        assign(&mut block.tentative, offset, value >= self.tentative);
        assign(&mut block.confident, offset, value >= self.confident);
        !(old >= self.tentative && value > old)
    }

    /// True if exactly one of the two values is at or above some bound. NaN (never observed) is
    /// below all bounds.
    #[inline]
    pub(crate) fn crosses(self, old: f32, new: f32) -> bool {
        ((old >= self.tentative) != (new >= self.tentative))
            | ((old >= self.confident) != (new >= self.confident))
    }
}

/// Result of the exponential filter. `keep` is 2^-n for n updates of `value` towards `target`.
///
/// A permanent voxel (infinite `value`, sec. III-E) never changes. Without this rule, a weight so
/// large that 2^-n is zero would give 0 * inf = NaN.
///
/// # Source
/// Vrba et al., eq. 12.
#[must_use]
#[inline]
pub fn filtered(value: f32, target: f32, keep: f64) -> f32 {
    let next = (keep * f64::from(value) + (1.0 - keep) * f64::from(target)) as f32;
    if value.is_infinite() { value } else { next }
}

/// 2^-n for n >= 0, with a relative error of 3e-13, and with the same bits on every platform (no
/// libm, no fused steps).
#[must_use]
#[inline]
pub fn two_to_minus(n: f64) -> f64 {
    const LN_2: f64 = std::f64::consts::LN_2;
    // From 2^52 on, a number has its whole part in the lowest bits: 1023 there is the exponent of 1.
    const EXPONENT: f64 = 1023.0 + (1u64 << 52) as f64;
    /// ln(2)^k / k! for k = 10..=1: the exponential series, highest power first.
    const SERIES: [f64; 10] = {
        let mut series = [0.0; 10];
        let (mut power, mut k) = (1.0, 1);
        while k <= 10 {
            power *= LN_2 / k as f64;
            series[10 - k] = power;
            k += 1;
        }
        series
    };
    let n = n.clamp(0.0, 1000.0);
    let whole = (n + 0.5).floor();
    let x = whole - n; // |x| <= 1/2: the terms that are left out sum up to less than 1e-12
    let series = SERIES.iter().fold(0.0, |sum, term| (sum + term) * x) + 1.0;
    series * f64::from_bits((EXPONENT - whole).to_bits() << 52)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_updates_equal_one_of_weight_two() {
        let half = two_to_minus(1.0);
        let once = filtered(-740.0, 0.0, half);
        assert_eq!(once, -370.0);
        assert_eq!(filtered(once, 0.0, half), -185.0);
        assert_eq!(filtered(-740.0, 0.0, two_to_minus(2.0)), -185.0);
    }

    #[test]
    fn a_permanent_voxel_survives_any_weight() {
        for value in [f32::INFINITY, f32::NEG_INFINITY] {
            assert_eq!(filtered(value, -1000.0, two_to_minus(f64::INFINITY)), value);
        }
        assert_eq!(filtered(-5.0, -1000.0, two_to_minus(1e9)), -1000.0);
    }

    #[test]
    fn powers_of_two() {
        for step in 0..4000 {
            let n = f64::from(step) * 0.01;
            assert!((two_to_minus(n) / libm::exp2(-n) - 1.0).abs() < 3e-13);
        }
        for n in [0.0, 1.0, 2.0, 3.0, 13.0, 500.0] {
            assert_eq!(two_to_minus(n), libm::exp2(-n));
        }
    }
}
