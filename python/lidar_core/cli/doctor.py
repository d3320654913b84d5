"""`lidar-core doctor`: machine, installed and missing packages, and a test of the core."""

import json
import os
import platform
import re
from importlib import metadata
from pathlib import Path
from typing import Annotated, Any

import typer

from lidar_core.extras import install_command
from lidar_core.util.threads import all_threads

_REQUIREMENT = re.compile(r"(?P<name>[A-Za-z0-9._-]+).*;.*extra\s*==\s*['\"](?P<extra>[\w-]+)['\"]")
_CORE = ("numpy", "pydantic", "onnxruntime", "typer", "rich", "tomli-w")


def command(
    as_json: Annotated[bool, typer.Option("--json", help="Print the result as JSON.")] = False,
) -> None:
    """Print versions and optional packages, and check the core; exit status 1 if it fails."""
    report = _report()
    if as_json:
        print(json.dumps(report, indent=2))
    else:
        _print(report)
    if report["core"] != "works":
        raise typer.Exit(1)


def _report() -> dict[str, Any]:
    from lidar_core import __version__

    return {
        "lidar_core": __version__,
        "python": platform.python_version(),
        "platform": platform.platform(),
        "cores": os.cpu_count(),
        "threads": all_threads(),
        "cpu": _cpu(),
        "recordings": _recordings(),
        "core": _check_core(),
        "packages": {name: _version(name) for name in _CORE},
        "extras": {
            extra: {name: _version(name) for name in names} for extra, names in _extras().items()
        },
    }


def _cpu() -> dict[str, Any]:
    """Return architecture, vector instructions that numpy finds, and vector unit of the core."""
    import numpy as np

    from lidar_core._core import vector_unit
    from lidar_core.errors import ConfigError

    config = np.show_config(mode="dicts")
    found = {} if config is None else config.get("SIMD Extensions", {})
    features = [*found.get("baseline", []), *found.get("found", [])]
    try:
        used = vector_unit()
    except ConfigError as error:
        used = str(error)
    return {"architecture": platform.machine(), "features": features, "vector_unit": used}


def _recordings() -> dict[str, Any]:
    """Return the folder that the environment names for the recordings of `reproduce`."""
    from lidar_core.reproduce.recordings import FOLDER

    named = os.environ.get(FOLDER)
    return {"variable": FOLDER, "folder": named, "exists": bool(named and Path(named).is_dir())}


def _check_core() -> str:
    """Map one scan, read the map, and return as text whether the core works."""
    import numpy as np

    import lidar_core as lc

    try:
        vmap = lc.VoxelMap(threads=2)
        wall = np.stack([np.full(50, 5.0), np.linspace(-2, 2, 50), np.zeros(50)], axis=1)
        vmap.integrate(wall, np.full(50, lc.PointClass.BACKGROUND), (0, 0, 0))
        states = vmap.state_at([[2.6, 0.0, 0.0], [5.0, 0.0, 0.0]]).tolist()
    except Exception as error:  # whatever it is, the user is to see it
        return f"fails: {type(error).__name__}: {error}"
    return "works" if states == [0, 2] else f"fails: expected states [0, 2], got {states}"


def _extras() -> dict[str, list[str]]:
    """Return the packages of every extra that the installed distribution declares."""
    found: dict[str, list[str]] = {}
    for line in metadata.requires("lidar-core") or []:
        match = _REQUIREMENT.match(line)
        if match and match["name"] != "lidar-core":
            found.setdefault(match["extra"], []).append(match["name"])
    return {extra: sorted(names) for extra, names in sorted(found.items())}


def _version(name: str) -> str | None:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return None


def _print(report: dict[str, Any]) -> None:
    from rich.console import Console
    from rich.table import Table

    console = Console()
    console.print(
        f"lidar_core {report['lidar_core']}, Python {report['python']}, {report['platform']},"
        f" {report['cores']} cores, {report['threads']} threads for this process"
    )
    cpu, recordings = report["cpu"], report["recordings"]
    console.print(f"{cpu['architecture']}: {' '.join(cpu['features'])}", markup=False)
    console.print(f"vector unit of the core: {cpu['vector_unit']}", markup=False)
    console.print(_recordings_text(recordings), markup=False, highlight=False, soft_wrap=True)
    console.print(f"core: {report['core']}", style=None if report["core"] == "works" else "red")
    table = Table("extra", "packages")
    table.add_row("-", _listed(report["packages"]))
    for extra, packages in report["extras"].items():
        table.add_row(extra, _listed(packages))
    console.print(table)
    for extra, packages in report["extras"].items():
        if None in packages.values():  # on a line that a terminal can copy: no cell of the table
            cure = f"to install {extra}: {install_command(extra)}"
            console.print(cure, markup=False, highlight=False, soft_wrap=True)


def _recordings_text(recordings: dict[str, Any]) -> str:
    variable, folder = recordings["variable"], recordings["folder"]
    if folder is None:
        return f"{variable} is not set: items of reproduce that need recordings are left out"
    return f"{variable}: {folder}" + ("" if recordings["exists"] else ", which is not a folder")


def _listed(packages: dict[str, str | None]) -> str:
    return ", ".join(f"{name} {version or '(missing)'}" for name, version in packages.items())
