//! Surface that one ray hit, between the surfaces of its neighbours.

/// Largest gap between the ends of neighbouring rays on one surface [m].
const JOINED: f64 = 0.3;

/// Surface that a ray met: two stretches of a line, from its end to both sides.
///
/// Between two rays that met one surface it is straight. Beside another one, a surface reaches
/// across half of the gap between the rays.
#[derive(Clone, Copy, Debug)]
pub(super) struct SurfacePiece {
    /// Ends of the stretches, towards the ray before and the ray after it [m].
    before: [f64; 2],
    after: [f64; 2],
    /// End of the ray [m].
    pub(super) end: [f64; 2],
    /// True if the ray before it met the same surface.
    is_joined: bool,
}

impl SurfacePiece {
    /// Vectors [m] from the nearest points of its two pieces to a point. `follows`: leave out the
    /// piece that is shared with the ray before.
    pub(super) fn ways_to(&self, point: [f64; 2], follows: bool) -> impl Iterator<Item = [f64; 2]> {
        let before = (!follows || !self.is_joined).then_some(self.before);
        let sides = before.into_iter().chain([self.after]);
        sides.map(move |side| from_stretch(point, [self.end, side]))
    }

    /// The surface pieces that rays with these bearings [rad] and ranges [m] hit; `step`: angle
    /// between rays [rad]. None for rays without return.
    pub(super) fn all(bearings: &[f64], ranges: &[f64], step: f64) -> Vec<Option<Self>> {
        let end = |(&bearing, &range): (&f64, &f64)| {
            let end = || [range * libm::cos(bearing), range * libm::sin(bearing)];
            range.is_finite().then(end)
        };
        let ends: Vec<Option<[f64; 2]>> = bearings.iter().zip(ranges).map(end).collect();
        let piece = |number: usize| {
            let end = ends[number]?;
            let joined = |neighbour: Option<usize>| {
                let other = ends.get(neighbour?).copied().flatten()?;
                (libm::hypot(end[0] - other[0], end[1] - other[1]) < JOINED).then_some(other)
            };
            let alone = |side: f64| {
                let reach = 0.5 * ranges[number] * step;
                let bearing = bearings[number];
                let aside = [-reach * libm::sin(bearing), reach * libm::cos(bearing)];
                [end[0] + side * aside[0], end[1] + side * aside[1]]
            };
            let (before, after) = (joined(number.checked_sub(1)), joined(Some(number + 1)));
            Some(Self {
                before: before.unwrap_or_else(|| alone(-1.0)),
                after: after.unwrap_or_else(|| alone(1.0)),
                end,
                is_joined: before.is_some(),
            })
        };
        (0..ends.len()).map(piece).collect()
    }
}

/// Vector from the nearest point of a line segment to a point [m].
fn from_stretch([x, y]: [f64; 2], [from, to]: [[f64; 2]; 2]) -> [f64; 2] {
    let [along_x, along_y] = [to[0] - from[0], to[1] - from[1]];
    let square = along_x * along_x + along_y * along_y;
    let share = ((x - from[0]) * along_x + (y - from[1]) * along_y) / square.max(f64::MIN_POSITIVE);
    let share = share.clamp(0.0, 1.0);
    [x - from[0] - share * along_x, y - from[1] - share * along_y]
}
