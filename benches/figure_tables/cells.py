"""Cells of the tables: values of a machine as text."""

from typing import Any

from figure_tables.results import Machine

MISSING = "-"
UNFAIR = f"{MISSING} (1)"


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


def share_text(share: float | None) -> str:
    """A share in per cent."""
    return MISSING if share is None else f"{share:.1%}".replace("%", " %")


def caption(machine: Machine) -> str:
    """What a table says of its machine."""
    return f"{machine['cpu']}, {machine['cores']} cores, {machine['date']}"
