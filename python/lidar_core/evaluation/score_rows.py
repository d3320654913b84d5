"""Scores as lines of a table, for consoles and pages."""

from typing import TYPE_CHECKING

from lidar_core.util.rows import Row, number

if TYPE_CHECKING:
    from rich.table import Table

    from lidar_core.evaluation import (
        Consistency,
        DetectionScores,
        Evaluation,
        EvaluationConfig,
        IdentityScores,
        Latency,
        Spread,
        TrackScores,
    )


def all_rows(report: "Evaluation") -> list[Row | None]:
    """Return rows of every score of a run; None draws a line."""
    rows: list[Row | None] = [*main_rows(report)]
    for what, item in _scores(report):
        rows += detail_rows(item, what)
    if report.identities is not None:
        rows += identity_rows(report.identities)
    if report.latency is not None:
        rows += latency_rows(report.latency)
    return rows


def main_rows(report: "Evaluation") -> list[Row]:
    """Return the main rows: recall, accuracy and others; tracks, then detections."""
    tracks, detections = report.tracks, report.detections
    rows = []
    if tracks is not None:
        rows.append(Row("recall of tracks", number(tracks.recall, 3), _found(tracks)))
    if detections is not None:
        rows.append(Row("recall of detections", number(detections.recall, 3), _found(detections)))
    if tracks is not None:
        rows += _track_rows(tracks)
    if detections is not None:
        false = f"of {detections.n_estimates}"
        rows.append(Row("false detections", str(detections.n_false), false))
    if tracks is not None:
        delays = [delay for delay in tracks.first_delay.values() if delay is not None]
        first = f"at the latest; {len(delays)} of {len(tracks.first_delay)} targets tracked"
        rows.append(Row("first track after", number(max(delays, default=None), 1, " s"), first))
    return rows


def _track_rows(tracks: "TrackScores") -> list[Row]:
    spread = f"RMSE {number(tracks.rmse, 2)}, largest {number(tracks.max_error, 2)}"
    rate = number(tracks.false_tracks_per_minute, 1)
    of_all = f"of {len(tracks.track_ids)}, {rate} per minute; {tracks.n_switches} id changes"
    return [
        Row("position error", number(tracks.mean_error, 2, " m"), f"mean of tracks; {spread}"),
        Row("false tracks", str(len(tracks.false_ids)), of_all),
    ]


def detail_rows(scores: "DetectionScores", what: str) -> list[Row | None]:
    """Return rows of errors, set distances and consistency, after a None that draws a line."""
    return [
        None,
        Row(
            f"precision of {what}",
            number(scores.precision, 3),
            f"{scores.n_matched} of {scores.n_estimates}, {scores.n_duplicate} duplicate",
        ),
        _spread_row("  position error", scores.position_error, " m"),
        _spread_row("  along the line of sight", scores.radial_error, " m"),
        _spread_row("  across it", scores.across_error, " m"),
        _spread_row("  velocity error", scores.velocity_error, " m/s"),
        *(
            []
            if scores.radius_error is None
            else [_spread_row("  radius error", scores.radius_error, " m")]
        ),
        _consistency_row("  NEES of positions", scores.position_nees),
        *_set_rows(scores),
        Row("  lost and found again", str(scores.n_fragmentations), _gap(scores)),
        *_metric_rows(scores),
    ]


def _metric_rows(scores: "DetectionScores") -> list[Row]:
    """Rows of the registered metrics, including those of other packages."""
    from lidar_core.evaluation.metric import METRICS

    known = {metric.name: metric for metric in METRICS.parts()}
    return [
        Row(f"  {known[name].title}", number(value, 3, f" {known[name].unit}".rstrip()), "")
        for name, value in scores.metrics.items()
    ]


def _set_rows(scores: "DetectionScores") -> list[Row]:
    sets = scores.sets
    if sets is None:
        return []
    parts = f"localisation {sets.localisation:.3f}, missed {sets.missed:.3f}, false"
    return [
        Row("  GOSPA", f"{sets.gospa:.3f} m", f"mean of scans; {parts} {sets.false:.3f}"),
        Row("  OSPA", f"{sets.ospa:.3f} m", "mean of scans"),
    ]


def identity_rows(scores: "IdentityScores") -> list[Row | None]:
    """Return rows of HOTA, MOTA, IDF1 and their parts, after a None that draws a line."""
    parts = f"detection {scores.deta:.3f}, association {scores.assa:.3f}, place {scores.loca:.3f}"
    whole = f"recall {scores.id_recall:.3f}, precision {scores.id_precision:.3f}"
    tracked = f"{scores.mostly_tracked} targets mostly tracked, {scores.mostly_lost} mostly lost"
    return [
        None,
        Row("HOTA", f"{scores.hota:.3f}", parts),
        Row("MOTA", f"{scores.mota:.3f}", tracked),
        Row("IDF1", f"{scores.idf1:.3f}", whole),
    ]


def latency_rows(latency: "Latency") -> list[Row | None]:
    """Return rows of the time per scan, after a None that draws a line."""
    total = latency.total
    tail = f"mean; 95 % within {total.p95:.0f} ms, longest {total.largest:.0f} ms"
    return [None, Row("time per scan", f"{total.mean:.0f} ms", tail)]


CAUSES = (
    "likely causes: wrong noise settings for ranges or poses, different clocks of ground truth and"
    " recording, ground truth of another point than the object's centre"
)


def consistency_warnings(report: "Evaluation") -> list[str]:
    """Warn about covariances that do not fit the errors, with the likely causes."""
    found = [(what, item.position_nees) for what, item in _scores(report)]
    return [
        f"{what}: {nees.warning}; {CAUSES}"
        for what, nees in found
        if nees is not None and nees.warning is not None
    ]


def counted_caption(config: "EvaluationConfig") -> str:
    """Return a caption that states which sightings count."""
    return (
        f"Sightings: target within {config.max_distance:g} m and hit by {config.min_hits} rays or"
        f" more, where ground truth is available; after the first {config.burn_in_scans} scans."
    )


def distance_table(report: "Evaluation") -> "Table | None":
    """Return a table of recall, precision and error over distance; None without distances."""
    from rich.table import Table

    table = Table("distance", "of", "sightings", "recall", "precision", "mean error")
    for what, item in _scores(report):
        for group in item.over_distance:
            error = None if group.position_error is None else group.position_error.mean
            table.add_row(
                f"{group.near:g} to {group.far:g} m",
                what,
                str(group.n_eligible),
                number(group.recall, 3),
                number(group.precision, 3),
                number(error, 3, " m"),
            )
    return table if table.row_count else None


def _scores(report: "Evaluation") -> "list[tuple[str, DetectionScores]]":
    """Available scores of tracks and of detections, with their names."""
    both = (("tracks", report.tracks), ("detections", report.detections))
    return [(what, item) for what, item in both if item is not None]


def _found(scores: "DetectionScores") -> str:
    return f"{scores.n_found} of {scores.n_eligible} sightings"


def _gap(scores: "DetectionScores") -> str:
    longest = max(scores.longest_gap.values(), default=None)
    return f"longest gap {number(longest, 1, ' s')}"


def _spread_row(name: str, spread: "Spread | None", unit: str) -> Row:
    if spread is None:
        return Row(name, "-", "not known")
    rest = f"std {spread.std:.3f}, RMSE {spread.rmse:.3f}, 95 % below {spread.p95:.3f}"
    return Row(name, f"{spread.mean:.3f}{unit}", rest)


def _consistency_row(name: str, found: "Consistency | None") -> Row:
    if found is None:
        return Row(name, "-", "no covariances")
    share = f"{100 * found.share_inside:.0f} % in the band"
    return Row(name, f"{found.mean:.2f}", f"mean; {found.degrees} is consistent; {share}")
