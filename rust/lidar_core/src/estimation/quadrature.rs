//! Integrals of functions of one variable.

/// Largest number of halvings of a panel.
const DEPTH: u32 = 16;

/// Integral by Kronrod's rule of 15 points, halved until Gauss's rule of 7 of them agrees.
pub(super) fn integrate(f: &dyn Fn(f64) -> f64, start: f64, end: f64, tolerance: f64) -> f64 {
    halved(f, [start, end], tolerance, DEPTH)
}

fn halved(f: &dyn Fn(f64) -> f64, [start, end]: [f64; 2], tolerance: f64, depth: u32) -> f64 {
    let (middle, half) = (0.5 * (start + end), 0.5 * (end - start));
    let center = f(middle);
    let (mut gauss, mut kronrod) = (GAUSS[3] * center, KRONROD[7] * center);
    for index in 0..7 {
        let offset = half * NODES[index];
        let both = f(middle - offset) + f(middle + offset);
        kronrod += KRONROD[index] * both;
        if index % 2 == 1 {
            gauss += GAUSS[index / 2] * both;
        }
    }
    if depth == 0 || half * (kronrod - gauss).abs() <= tolerance {
        return half * kronrod;
    }
    halved(f, [start, middle], tolerance, depth - 1)
        + halved(f, [middle, end], tolerance, depth - 1)
}

/// Nodes of the 15-point Kronrod rule on -1..1 without the middle one; every second is Gauss's.
pub(super) const NODES: [f64; 7] = [
    0.991_455_371_120_812_6,
    0.949_107_912_342_758_5,
    0.864_864_423_359_769_1,
    0.741_531_185_599_394_4,
    0.586_087_235_467_691_1,
    0.405_845_151_377_397_2,
    0.207_784_955_007_898_47,
];
/// Weights of the 15-point Kronrod rule; the last one is that of the middle.
pub(super) const KRONROD: [f64; 8] = [
    0.022_935_322_010_529_224,
    0.063_092_092_629_978_55,
    0.104_790_010_322_250_18,
    0.140_653_259_715_525_92,
    0.169_004_726_639_267_9,
    0.190_350_578_064_785_4,
    0.204_432_940_075_298_9,
    0.209_482_141_084_727_83,
];
/// Weights of Gauss's rule of 7 points; the last one is that of the middle.
const GAUSS: [f64; 4] = [
    0.129_484_966_168_869_7,
    0.279_705_391_489_276_64,
    0.381_830_050_505_118_9,
    0.417_959_183_673_469_4,
];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_rule_is_exact_for_polynomials() {
        for power in 0..=22 {
            let exact = if power % 2 == 0 { 2.0 / f64::from(power + 1) } else { 0.0 };
            let got = integrate(&|x: f64| x.powi(power), -1.0, 1.0, f64::INFINITY);
            assert!((got - exact).abs() < 1e-14, "{power}: {got}");
        }
    }
}
