"""Speed and memory of the guide, from what the benches left: `make figures`.

`collect` reads criterion's results and the files that benches and peers wrote into a folder, and
writes `benches/results/<cpu>.json`. `write` writes the tables of all such files into README and
guide, between `<!-- figures: NAME -->` and `<!-- end of figures -->`. `check` fails where a table
differs from that.
"""

import argparse
import json
import os
import platform
import re
import subprocess
import sys
from collections.abc import Callable
from datetime import date
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
RESULTS = ROOT / "benches/results"
PAGES = [
    ROOT / "README.md",
    ROOT / "docs/performance.md",
    ROOT / "docs/performance-beside-others.md",
    ROOT / "docs/fusion.md",
]
BLOCK = re.compile(r"(<!-- figures: ([a-z-]+) -->\n).*?(<!-- end of figures -->)", re.DOTALL)
NS_TO_MS = 1e-6
MISSING = "-"
UNFAIR = f"{MISSING} (1)"
UNFAIR_NOTE = (
    "(1) The yardsticks of this run were too slow for a fair comparison, so that its ratios do not"
    " count. `docs/performance-beside-others.md` has them."
)

Machine = dict[str, Any]
"""One file of results: `cpu`, `cores`, `date`, `commit`, `rust` and `figures`."""


def cpu_name() -> str:
    """Name of the CPU, as the system gives it."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text(encoding="utf-8").splitlines() if info.is_file() else []
    names = (line.split(":", 1)[1].strip() for line in lines if line.startswith("model name"))
    return next(names, platform.processor() or platform.machine())


def output_of(*command: str) -> str:
    """What a command prints."""
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    return done.stdout.strip()


def criterion_figures(folder: Path) -> dict[str, dict[str, float]]:
    """Median of every bench of criterion, and the ends of its 95 % interval [ms]."""
    found = {}
    for path in sorted(folder.glob("**/new/estimates.json")):
        bench = json.loads((path.parent / "benchmark.json").read_text(encoding="utf-8"))
        median = json.loads(path.read_text(encoding="utf-8"))["median"]
        interval = median["confidence_interval"]
        found[bench["full_id"]] = {
            "ms": round(median["point_estimate"] * NS_TO_MS, 6),
            "low_ms": round(interval["lower_bound"] * NS_TO_MS, 6),
            "high_ms": round(interval["upper_bound"] * NS_TO_MS, 6),
        }
    return found


def collect(criterion: Path, folder: Path) -> Path:
    """Write the results of this machine; what was not measured again stays as it was."""
    cpu, cores = cpu_name(), os.cpu_count()
    slug = re.sub(r"[^a-z0-9]+", "-", f"{cpu} {cores} cores".lower()).strip("-")
    path = RESULTS / f"{slug}.json"
    known = json.loads(path.read_text(encoding="utf-8"))["figures"] if path.exists() else {}
    figures = known | {"criterion": known.get("criterion", {}) | criterion_figures(criterion)}
    for left in sorted(folder.glob("*.json")):
        name = left.stem.partition("_")[0]
        merged = figures[name] if left.stem != name and name in figures else {}
        figures[name] = merged | json.loads(left.read_text(encoding="utf-8"))
    machine = {
        "cpu": cpu,
        "cores": cores,
        "date": date.today().isoformat(),
        "commit": output_of("git", "rev-parse", "--short", "HEAD"),
        "rust": output_of("rustc", "--version").split()[1],
        "figures": figures,
    }
    path.parent.mkdir(exist_ok=True)
    path.write_text(json.dumps(machine, indent=1, sort_keys=True) + "\n", encoding="utf-8")
    return path


def number_text(value: float | None, digits: int = 2) -> str:
    """A number with this many significant digits, at least the whole ones."""
    if value is None:
        return MISSING
    if value == 0 or abs(value) >= 10 ** (digits - 1):
        return f"{value:,.0f}"
    text = f"{value:#.{digits}g}"
    return text if "e" not in text else f"{value:.6f}".rstrip("0")


def criterion_ms(machine: Machine, name: str) -> float | None:
    """Median of a bench [ms]."""
    bench = machine["figures"]["criterion"].get(name)
    return bench["ms"] if bench else None


def value_of(machine: Machine, group: str, name: str, key: str) -> float | None:
    """A figure of a bench that is not criterion's."""
    value: float | None = machine["figures"].get(group, {}).get(name, {}).get(key)
    return value


def ratio_text(machine: Machine, name: str, reference: str) -> str:
    """How long one bench takes, over another of the same run."""
    of, over = criterion_ms(machine, name), criterion_ms(machine, reference)
    return number_text(of / over) if of and over else MISSING


def ms_text(machine: Machine, *names: str) -> str:
    """Medians of benches with their unit."""
    found = [number_text(criterion_ms(machine, name)) for name in names]
    return MISSING if set(found) == {MISSING} else f"{', '.join(found)} ms"


def sequence_text(machine: Machine, key: str, threads: int, title: str = "integrate") -> str:
    """Ratio to `ray_scalar` in scenes 1 and 2."""
    names = [f"scene_{scene}/{title}_{threads}_threads" for scene in (1, 2)]
    return ", ".join(number_text(value_of(machine, "sequence", name, key)) for name in names)


def peer_range(machine: Machine, start: str, subject: str) -> str:
    """Least and largest ratio of peers whose name starts so, to lidar_core, of fair comparisons."""
    titles = [
        systems
        for title, systems in machine["figures"].get("peers", {}).items()
        if subject in title and any(name.startswith(start) for name in systems)
    ]
    found = [
        system["of_ours"]
        for systems in titles
        if is_fair(systems)
        for name, system in systems.items()
        if name.startswith(start)
    ]
    if not found:
        return UNFAIR if titles else MISSING
    return f"{number_text(min(found))} to {number_text(max(found))}"


def is_fair(systems: dict[str, dict[str, Any]]) -> bool:
    """Whether every peer that has to be so many times slower than the yardstick is."""
    return all(
        system["of_yardstick"] >= system["gate"] for system in systems.values() if "gate" in system
    )


def speed_rows(machine: Machine) -> list[tuple[str, str, str]]:
    """Figure, value on a machine, and the command that prints it."""
    sequence = "`cargo bench --bench sequence`"
    scan, scalar = "pipeline/scene_2/process_{}_threads", "raycast/scene_2/ray_scalar"
    whole = [ratio_text(machine, scan.format(threads), scalar) for threads in (1, 2)]
    return [
        ("`ray_scalar`, scene 2", ms_text(machine, scalar), "`cargo bench -- raycast`"),
        *(
            (
                f"exact ray update of a map that grows, {title}, {words}, scenes 1 and 2: share of"
                " the time of `ray_scalar`",
                sequence_text(machine, key, threads),
                sequence,
            )
            for threads, words in ((1, "one thread"), (2, "two threads"))
            for key, title in (("steady", "steady state"), ("first", "first scan"))
        ),
        (
            "whole scan, raw points to tracks, scene 2, one and two threads",
            f"{ms_text(machine, *(scan.format(threads) for threads in (1, 2)))};"
            f" {', '.join(whole)} of the time of `ray_scalar`",
            "`cargo bench -- pipeline`",
        ),
        (
            "clusters of all returns, scenes 1 and 2: share of the time of `cluster_hash`",
            ", ".join(
                ratio_text(
                    machine, f"cluster/scene_{scene}/label", f"cluster/scene_{scene}/cluster_hash"
                )
                for scene in (1, 2)
            ),
            "`cargo bench -- cluster`",
        ),
        (
            "classification; removal of separate voxels, scene 2",
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
            "OctoMap, default: multiple of the time of lidar_core",
            peer_range(machine, "OctoMap, default", "into the map"),
            "`make peers`",
        ),
        (
            "OctoMap, lazy and discretised: multiple of the time of lidar_core",
            peer_range(machine, "OctoMap, lazy", "into the map"),
            "`make peers`",
        ),
        (
            "PCL, clusters: multiple of the time of lidar_core",
            peer_range(machine, "PCL", "clusters"),
            "`make peers`",
        ),
        (
            "time that Python adds to a whole scan",
            share_text(value_of(machine, "peers", "border", "share")),
            "`make peers`",
        ),
    ]


def share_text(share: float | None) -> str:
    """A share in per cent."""
    return MISSING if share is None else f"{share:.1%}".replace("%", " %")


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


def update(machines: list[Machine]) -> str:
    """Ray update of the map, by scene."""
    return "\n\n".join(map(_update, machines))


def _update(machine: Machine) -> str:
    lines = [f"| {caption(machine)} | scene 1 | scene 2 |", "|---|---|---|"]
    rows = {
        "`ray_scalar`": "ray_scalar",
        "full map, one thread": "integrate_1_threads",
        "full map, two threads": "integrate_2_threads",
        "one ray per end voxel, one thread": "one_per_end_1_threads",
    }
    for title, bench in rows.items():
        cells = [_timed(machine, f"raycast/scene_{scene}", bench) for scene in (1, 2)]
        lines.append(f"| {title} (`raycast`) | {' | '.join(cells)} |")
    for threads, words in ((1, "one thread"), (2, "two threads")):
        for bench, rule in (("integrate", "saturated"), ("skip_none", "none")):
            for key, when in (("first", "first scan"), ("steady", "steady state")):
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


def caption(machine: Machine) -> str:
    """What a table says of its machine."""
    return f"{machine['cpu']}, {machine['cores']} cores, {machine['date']}"


def peers(subject: str) -> Callable[[list[Machine]], str]:
    """A writer of the tables of peers whose title has `subject`."""

    def tables(machines: list[Machine]) -> str:
        parts = []
        for machine in machines:
            for title, systems in sorted(machine["figures"].get("peers", {}).items()):
                if subject in title:
                    parts.append(_peer_table(machine, title, systems))
        return "\n\n".join(parts) or "Not measured."

    return tables


def _peer_table(machine: Machine, title: str, systems: dict[str, dict[str, Any]]) -> str:
    lines = [
        f"| {title}; {caption(machine)} | ms, least | ms, median | of the yardstick"
        " | of lidar_core |",
        "|---|---|---|---|---|",
    ]
    in_order = sorted(systems.items(), key=lambda system: system[1]["place"])
    for name, system in in_order:
        keys = ("least_ms", "median_ms", "of_yardstick", "of_ours")
        cells = [number_text(system[key], 3) for key in keys]
        lines.append(f"| {name} | {' | '.join(cells)} |")
    for name, system in in_order:
        if "gate" in system:
            counts = is_fair({name: system})
            verdict = "the comparison counts" if counts else "**these ratios do not count**"
            lines += [
                "",
                f"{name} takes {number_text(system['of_yardstick'], 3)} times as long as the"
                f" yardstick; at least {system['gate']:g} are required: {verdict}.",
            ]
    return "\n".join(lines)


def filters(machines: list[Machine]) -> str:
    """Filters of one target."""
    parts = []
    for machine in machines:
        systems = machine["figures"].get("filters", {})
        lines = [f"| {caption(machine)} | us per predict and update | of numpy |", "|---|---|---|"]
        for name, system in sorted(systems.items(), key=lambda system: system[1]["place"]):
            cells = [number_text(system[key], 3) for key in ("us", "of_numpy")]
            lines.append(f"| {name} | {' | '.join(cells)} |")
        parts.append("\n".join(lines) if systems else "Not measured.")
    return "\n\n".join(parts)


def tracking(machines: list[Machine]) -> str:
    """Targets among clutter."""
    parts = []
    for machine in machines:
        found = machine["figures"].get("tracking", {})
        for clutter in dict.fromkeys(name.partition("/")[0] for name in found):
            lines = [
                f"| {clutter} false measurements a scan; {caption(machine)} | OSPA [m]"
                " | false tracks per scan | missed targets per scan | CPU [ms per scan] |",
                "|---|---|---|---|---|",
            ]
            systems = {k: v for k, v in found.items() if k.startswith(f"{clutter}/")}
            for name, system in sorted(systems.items(), key=lambda system: system[1]["place"]):
                keys = ("ospa", "false", "missed", "ms")
                cells = [number_text(system[key], 3) for key in keys]
                lines.append(f"| {name.partition('/')[2]} | {' | '.join(cells)} |")
            parts.append("\n".join(lines))
    return "\n\n".join(parts) or "Not measured."


def growth(machines: list[Machine]) -> str:
    """Power of the time in what grows."""
    titles = {
        "rays": "rays into the map",
        "voxel": "voxels per metre, same rays",
        "range": "range [m], same rays",
        "points": "clustered points",
        "tracks": "tracks",
        "extent": "length of the map [m], one scan and removal of islands",
    }
    parts = []
    for machine in machines:
        found = machine["figures"].get("scaling", {})
        lines = [f"| {caption(machine)} | Sizes | Time [ms] | Power |", "|---|---|---|---|"]
        for name, title in titles.items():
            if row := found.get(name):
                sizes = f"{row['least']:,g} to {row['most']:,g}"
                times = f"{number_text(row['least_ms'])} to {number_text(row['most_ms'])}"
                lines.append(f"| {title} | {sizes} | {times} | {row['power']:.2f} |")
        parts.append("\n".join(lines) if found else "Not measured.")
    return "\n\n".join(parts)


def memory(machines: list[Machine]) -> str:
    """Memory of map and detector."""
    parts = []
    for machine in machines:
        found = machine["figures"].get("memory", {})
        lines = [
            f"| {caption(machine)} | scene 1 | scene 2 |",
            "|---|---|---|",
            *(
                f"| {title} | "
                + " | ".join(
                    number_text(found.get(f"scene_{scene}", {}).get(key), digits)
                    for scene in (1, 2)
                )
                + " |"
                for title, key, digits in (
                    ("voxels observed", "voxels", 2),
                    ("map [MB]", "map_mb", 2),
                    ("bytes per voxel", "bytes_per_voxel", 2),
                    ("detector with its map [MB]", "held_mb", 3),
                    ("of which in use [MB]", "used_mb", 3),
                    ("allocations per scan, without targets", "allocations_empty", 2),
                    ("[MB]", "allocated_empty_mb", 2),
                    ("allocations per scan, with two targets", "allocations", 2),
                    ("[MB]", "allocated_mb", 2),
                )
            ),
        ]
        parts.append("\n".join(lines) if found else "Not measured.")
    return "\n\n".join(parts)


TABLES: dict[str, Callable[[list[Machine]], str]] = {
    "speed": speed,
    "update": update,
    "rays": peers("rays into the map"),
    "clusters": peers("clusters"),
    "simulated-rays": peers("simulated"),
    "filters": filters,
    "tracking": tracking,
    "growth": growth,
    "memory": memory,
}


def read_machines(folder: Path = RESULTS) -> list[Machine]:
    """All files of results, by name."""
    paths = sorted(folder.glob("*.json"))
    return [json.loads(path.read_text(encoding="utf-8")) for path in paths]


def page_with_tables(text: str, machines: list[Machine]) -> str:
    """A page with the tables as the results have them.

    Raises
    ------
    KeyError
        The page asks for a table that does not exist.
    """

    def table(found: re.Match[str]) -> str:
        return f"{found[1]}{TABLES[found[2]](machines)}\n{found[3]}"

    return BLOCK.sub(table, text)


def main() -> None:
    """Do what the command line asks for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    tasks = parser.add_subparsers(dest="task", required=True)
    collecting = tasks.add_parser("collect", help="write benches/results/<cpu>.json")
    collecting.add_argument("criterion", type=Path, help="criterion's folder, target/criterion")
    collecting.add_argument("folder", type=Path, help="what benches and peers left")
    tasks.add_parser("write", help="write the tables of README and guide")
    tasks.add_parser("check", help="fail where a table is not as the results have it")
    chosen = parser.parse_args()
    if chosen.task == "collect":
        path = collect(chosen.criterion, chosen.folder)
        print(f"{path.relative_to(ROOT)} written")
        return
    machines = read_machines()
    pages = {page: page.read_text(encoding="utf-8") for page in PAGES}
    changed = [page for page, text in pages.items() if page_with_tables(text, machines) != text]
    if chosen.task == "check" and changed:
        names = ", ".join(str(page.relative_to(ROOT)) for page in changed)
        sys.exit(f"{names}: tables differ from benches/results; run `make figures`, do not edit")
    for page in changed:
        page.write_text(page_with_tables(pages[page], machines), encoding="utf-8")


if __name__ == "__main__":
    main()
