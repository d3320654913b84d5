"""Tables of speed: the overview in the README, and the ray update of the map."""

from figure_tables.cells import (
    UNFAIR,
    caption,
    ms_text,
    number_text,
    peer_range,
    ratio_text,
    share_text,
    value_of,
)
from figure_tables.results import Machine

UNFAIR_NOTE = (
    "(1) Left out: the comparison is not fair. `make peers` also times a reference program,"
    " `ray_scalar` or `cluster_hash`. In a fair comparison, the other system takes at least a"
    " certain multiple of the reference program's time. Here it took less, because the machine"
    " slowed down the reference program, and perhaps the others. [Speed beside"
    " others](docs/performance-beside-others.md#beside-others) has the multiples and all measured"
    " ratios."
)


def speed(machines: list[Machine]) -> str:
    """Figures of all machines side by side."""
    columns = [speed_rows(machine) for machine in machines]
    head = [f"{machine['cpu']}, {machine['cores']} cores" for machine in machines]
    lines = [f"| Figure | {' | '.join(head)} | Printed by |", "|---" * (len(head) + 2) + "|"]
    for rows in zip(*columns, strict=True):
        values = " | ".join(row[1] for row in rows)
        lines.append(f"| {rows[0][0]} | {values} | {rows[0][2]} |")
    if any(row[1] == UNFAIR for rows in columns for row in rows):
        lines += ["", UNFAIR_NOTE]
    return "\n".join(lines)


def speed_rows(machine: Machine) -> list[tuple[str, str, str]]:
    """Figure, value on a machine, and the command that prints it."""
    sequence = "`cargo bench --bench sequence`"
    scan, scalar = "pipeline/scene_2/process_{}_threads", "raycast/scene_2/ray_scalar"
    whole = [ratio_text(machine, scan.format(threads), scalar) for threads in (1, 2)]
    return [
        ("`ray_scalar`, scene 2", ms_text(machine, scalar), "`cargo bench -- raycast`"),
        *(
            (
                f"map update, {title} of a sequence that starts with an empty map, {words},"
                " scenes 1 and 2: ratio to `ray_scalar`",
                sequence_text(machine, key, threads),
                sequence,
            )
            for threads, words in ((1, "one thread"), (2, "two threads"))
            for key, title in (("steady", "scans 15 to 60"), ("first", "first scan"))
        ),
        (
            "whole scan, raw points to tracks, scene 2, one and two threads; ratio to `ray_scalar`",
            f"{ms_text(machine, *(scan.format(threads) for threads in (1, 2)))};"
            f" {', '.join(whole)}",
            "`cargo bench -- pipeline`",
        ),
        (
            "clusters of all returns, scenes 1 and 2: ratio to `cluster_hash`",
            ", ".join(
                ratio_text(
                    machine, f"cluster/scene_{scene}/label", f"cluster/scene_{scene}/cluster_hash"
                )
                for scene in (1, 2)
            ),
            "`cargo bench -- cluster`",
        ),
        (
            "classification of the points; removal of small isolated groups of occupied voxels from"
            " the map; scene 2",
            f"{ms_text(machine, 'classify/scene_2/classify')};"
            f" {ms_text(machine, 'classify/scene_2/remove_separate')}",
            "`cargo bench -- classify`",
        ),
        (
            "2D: whole scan to the map of circles, 10 objects, 1081 beams",
            ms_text(machine, "circles/scan_10_objects_1081_beams_ml"),
            "`cargo bench -- circles/scan`",
        ),
        (
            "OctoMap, default: its time divided by that of lidar_core",
            peer_range(machine, "OctoMap, default", "into the map"),
            "`make peers`",
        ),
        (
            "OctoMap, lazy and discretised: its time divided by that of lidar_core",
            peer_range(machine, "OctoMap, lazy", "into the map"),
            "`make peers`",
        ),
        (
            "PCL, clusters: its time divided by that of lidar_core",
            peer_range(machine, "PCL", "clusters"),
            "`make peers`",
        ),
        (
            "share of a whole scan's time that Python adds",
            share_text(value_of(machine, "peers", "border", "share")),
            "`make peers`",
        ),
    ]


def sequence_text(machine: Machine, key: str, threads: int, title: str = "integrate") -> str:
    """Ratio to `ray_scalar` in scenes 1 and 2."""
    names = [f"scene_{scene}/{title}_{threads}_threads" for scene in (1, 2)]
    return ", ".join(number_text(value_of(machine, "sequence", name, key)) for name in names)


def update(machines: list[Machine]) -> str:
    """Ray update of the map, by scene."""
    return "\n\n".join(map(_update, machines))


def _update(machine: Machine) -> str:
    lines = [f"| {caption(machine)} | scene 1 | scene 2 |", "|---|---|---|"]
    rows = {
        "`ray_scalar`": "ray_scalar",
        "map update, one thread": "integrate_1_threads",
        "map update, two threads": "integrate_2_threads",
        'map update, `rays = "one_per_end"`, one thread': "one_per_end_1_threads",
    }
    for title, bench in rows.items():
        cells = [_timed(machine, f"raycast/scene_{scene}", bench) for scene in (1, 2)]
        lines.append(f"| {title} (`raycast`) | {' | '.join(cells)} |")
    for threads, words in ((1, "one thread"), (2, "two threads")):
        for bench, rule in (("integrate", "saturated"), ("skip_none", "none")):
            for key, when in (("first", "first scan"), ("steady", "scans 15 to 60")):
                name = f"{bench}_{threads}_threads"
                cells = [
                    number_text(value_of(machine, "sequence", f"scene_{scene}/{name}", key))
                    for scene in (1, 2)
                ]
                title = f'{when}, `skip = "{rule}"`, {words} (`sequence`)'
                lines.append(f"| {title} | {' | '.join(cells)} |")
        bench = f"process_{threads}_threads"
        cells = [
            f"{ms_text(machine, name := f'pipeline/scene_{scene}/{bench}')}, "
            + ratio_text(machine, name, f"raycast/scene_{scene}/ray_scalar")
            for scene in (1, 2)
        ]
        lines.append(f"| whole scan, {words} (`pipeline`) | {' | '.join(cells)} |")
    return "\n".join(lines)


def _timed(machine: Machine, group: str, bench: str) -> str:
    """Time, and its ratio to `ray_scalar`."""
    text = ms_text(machine, f"{group}/{bench}")
    scalar = f"{group}/ray_scalar"
    if bench == "ray_scalar":
        return text
    return f"{text}, {ratio_text(machine, f'{group}/{bench}', scalar)}"
