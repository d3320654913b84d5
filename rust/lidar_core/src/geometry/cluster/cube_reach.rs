//! Cubes of 4 x 4 x 4 octants, with one bit per octant: which octants of two cubes are in reach of
//! each other.

/// Which octants of one cube are in reach of which octants of another: no further than two octants
/// away along every axis.
pub(super) struct InReach {
    /// Octants of the first cube that are in reach of any octant of the other.
    pub(super) ours: u64,
    /// Octants of the other cube that are in reach of any octant of the first.
    pub(crate) theirs: u64,
    /// For every octant of the first cube, the octants of the other that are in its reach.
    pub(crate) of: [u64; 64],
}

impl InReach {
    /// Reach between a cube and the one that is `step` cubes away. For `step` 0: of each octant,
    /// only octants behind it in the order of bits.
    const fn across(step: [i32; 3]) -> Self {
        let mut reach = Self { ours: 0, theirs: 0, of: [0; 64] };
        let is_own = step[0] == 0 && step[1] == 0 && step[2] == 0;
        let mut pair = 0;
        // `while`, since `for` is not allowed in `const` functions: the tables are made by the compiler.
        while pair < 64 * 64 {
            let (one, other) = (pair / 64, pair % 64);
            let (mut axis, mut reached) = (0, !is_own || other > one);
            while axis < 3 {
                let away = 4 * step[axis] + (other >> (2 * axis) & 3) - (one >> (2 * axis) & 3);
                reached &= -2 <= away && away <= 2;
                axis += 1;
            }
            reach.of[one as usize] |= (reached as u64) << other;
            reach.ours |= (reached as u64) << one;
            reach.theirs |= (reached as u64) << other;
            pair += 1;
        }
        reach
    }
}

/// Reach within one cube. `NEXT`: between a cube and the next one along x.
pub(super) static OWN: InReach = InReach::across([0; 3]);
/// Reach between a cube and the next one along x.
pub(super) static NEXT: InReach = InReach::across([1, 0, 0]);
/// Reach between a cube and later cubes: first index, the four rows of cubes that follow it in the
/// order of keys (the next row, then those of the next plane); second index, steps of -1, 0 and 1
/// along x.
pub(super) static ROWS: [[InReach; 3]; 4] =
    [row_across([1, 0]), row_across([-1, 1]), row_across([0, 1]), row_across([1, 1])];

const fn row_across([y, z]: [i32; 2]) -> [InReach; 3] {
    [InReach::across([-1, y, z]), InReach::across([0, y, z]), InReach::across([1, y, z])]
}
