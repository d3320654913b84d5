"""Tables that compare with other systems: maps, clusters, filters and trackers."""

from collections.abc import Callable
from typing import Any

from figure_tables.cells import caption, is_fair, number_text
from figure_tables.results import Machine


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
        f"| {title}; {caption(machine)} | ms, least | ms, median | ratio to the"
        " reference | ratio to lidar_core |",
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
                f" reference; at least {system['gate']:g} are required: {verdict}.",
            ]
    return "\n".join(lines)


def filters(machines: list[Machine]) -> str:
    """Filters of one target."""
    parts = []
    for machine in machines:
        systems = machine["figures"].get("filters", {})
        lines = [
            f"| {caption(machine)} | microseconds per predict and update | ratio to numpy |",
            "|---|---|---|",
        ]
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
