//! Cubes of 4 x 4 x 4 octants, each a bit of a word: which of two cubes are in reach of each other.

/// Which octants of a cube and of another are in reach of each other: no further than two octants away
/// along every axis.
pub(super) struct InReach {
    /// Octants of the one that have any in the other.
    pub(super) ours: u64,
    /// Octants of the other that have any in the one.
    pub(crate) theirs: u64,
    /// For every octant of the one, those of the other.
    pub(crate) of: [u64; 64],
}

impl InReach {
    /// For the cube `step` away; of an octant's own cube only those behind it.
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

/// For a cube itself, and for the next one along x.
pub(super) static OWN: InReach = InReach::across([0; 3]);
pub(super) static NEXT: InReach = InReach::across([1, 0, 0]);
/// For steps of -1, 0 and 1 along x to the four rows of cubes that follow a cube in the order of the
/// keys: the next one, then those of the next plane.
pub(super) static ROWS: [[InReach; 3]; 4] =
    [row_across([1, 0]), row_across([-1, 1]), row_across([0, 1]), row_across([1, 1])];

const fn row_across([y, z]: [i32; 2]) -> [InReach; 3] {
    [InReach::across([-1, y, z]), InReach::across([0, y, z]), InReach::across([1, y, z])]
}
