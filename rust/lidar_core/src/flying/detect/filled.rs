//! Fill of a cluster (share of its outline that returns rays), if it is not known which rays passed
//! beside it.

use super::center::of_expected;
use super::hole::View;
use crate::flying::classify::clusters::Cluster;
use crate::flying::scan::prepared::Prepared;
use crate::geometry::lattice::wide;

/// Returns belong to another object in front of a cluster if they are nearer by more than this [m].
const IN_FRONT: f64 = 0.3;

/// Share of the rays inside the outline of a cluster that hit it, if only the mean density of the
/// rays is known. NaN if no ray is expected.
pub(super) fn share_of_expected(scan: &Prepared, cluster: &Cluster<'_>) -> f64 {
    let found = (View::of(scan, cluster), scan.sky_observation.as_ref());
    let (Some(view), Some(sky)) = found else { return f64::NAN };
    let density = sky.density_at(view.direction([0.0, 0.0])) / (view.range * view.range);
    let seen = cluster.members.iter().filter_map(|&row| view.seen(wide(scan.points[row as usize])));
    let hits: Vec<[f64; 2]> = seen.map(|(place, _)| place).collect();
    let reach = 0.5 * cluster.diagonal() + IN_FRONT;
    let nearer = scan.points.iter().filter_map(|&point| {
        view.seen(wide(point)).filter(|(_, beyond)| *beyond < -reach).map(|(place, _)| place)
    });
    of_expected(&hits, nearer, density)
}
