"""lidar_core beside what else a user would take, on the same input, in one run: `make peers`.

Systems take turns on every scan. A time is CPU time of one scan on one thread; ratios are the
middle of the ratios within a round. The table is printed and left in `target/peers/table.md`; its
numbers are left in `target/figures` for `make figures`.
"""

import argparse
import importlib
import json
import platform
import subprocess
import sys
from collections.abc import Callable
from datetime import date
from importlib.metadata import version
from pathlib import Path

import border
import clusters
import exports
import meshes
import native
import rays
from turns import Part, processor

import lidar_core as lc

HERE = Path(__file__).parent
FIGURES = native.BUILT.parent / "figures"
"""What `make figures` reads."""
SCANS = 4
"""Of the recording; rounds go through it again and again."""
PACKAGES = ["numpy", "scipy", "scikit-learn", "pyoctomap", "filterpy", "stonesoup", "open3d"]


def scans_of(yardstick: Path, scene: int) -> Path:
    """Let the bench crate write scans of a scene; the folder."""
    folder = native.BUILT / f"scene_{scene}"
    subprocess.run([yardstick, "write", folder, str(scene), str(SCANS)], check=True)
    return folder


def of_rays(yardstick: Path, scans: list[int]) -> Part:
    """Ray update of the map."""
    title = "scene 1, 131,072 rays into the map"
    turns = rays.measure(yardstick, scans_of(yardstick, 1), scans, title)
    return turns.part(yardstick=rays.YARDSTICK, ours=rays.OURS, gates=rays.GATES)


def of_clusters(yardstick: Path, scans: list[int]) -> Part:
    """Clusters, on both scenes."""
    tables, figures = [], {}
    for scene in (1, 2):
        title = f"scene {scene}, clusters of all returns"
        turns = clusters.measure(yardstick, scans_of(yardstick, scene), scans, title)
        table, numbers = turns.part(
            yardstick=clusters.YARDSTICK, ours=clusters.OURS, gates=clusters.GATES
        )
        tables.append(table)
        figures |= numbers
    return "\n\n".join(tables), figures


def of_meshes(yardstick: Path, scans: list[int]) -> Part:
    """The simulator's rays."""
    try:
        importlib.import_module("open3d")
    except ImportError as why:
        return f"Open3D is left out, and with it the simulator's rays: {why}.", {}
    turns = meshes.measure(scans_of(yardstick, 1), scans, 1, "scene 1, 131,072 rays simulated")
    return turns.part(yardstick=meshes.YARDSTICK, ours=meshes.OURS)


def printed_by(command: list[str | Path]) -> str:
    """What a script prints; its errors are seen."""
    done = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=False)
    if done.returncode:
        sys.exit(f"{Path(command[3]).name} failed")
    return done.stdout.strip()


def of_filters(yardstick: Path, scans: list[int]) -> Part:
    """Filters, by a script of their own."""
    rounds = ["--rounds", str(len(scans)), "--figures", FIGURES / "filters.json"]
    command = [sys.executable, "-W", "ignore", HERE / "fusion.py", *rounds]
    return printed_by(command), {}


def of_tracking(yardstick: Path, scans: list[int]) -> Part:
    """Targets among clutter, by a script of their own."""
    command = [sys.executable, "-W", "ignore", HERE / "tracking.py"]
    command += ["--figures", FIGURES / "tracking.json"]
    return printed_by(command), {}


def of_border(yardstick: Path, scans: list[int]) -> Part:
    """The way through Python."""
    return border.measure(scans_of(yardstick, 1), len(scans))


def of_exports(yardstick: Path, scans: list[int]) -> Part:
    """Maps written for OctoMap."""
    return exports.check(native.BUILT), {}


PARTS: dict[str, Callable[[Path, list[int]], Part]] = {
    "rays": of_rays,
    "clusters": of_clusters,
    "meshes": of_meshes,
    "filters": of_filters,
    "tracking": of_tracking,
    "border": of_border,
    "exports": of_exports,
}


def made_with() -> str:
    """Versions, processor and date."""
    found = []
    for name in PACKAGES:
        try:
            found.append(f"{name} {version(name)}")
        except ModuleNotFoundError:
            found.append(f"no {name}")
    built = f"; {native.versions()}" if native.SYSTEM.exists() else ""
    return (
        f"{date.today()}, {processor()}, one thread; lidar_core {lc.__version__}, Python"
        f" {platform.python_version()}, {', '.join(found)}{built}."
    )


def main() -> None:
    """Measure every part, print and keep the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=7, help="rounds that count")
    parser.add_argument("--only", choices=PARTS, nargs="+", default=list(PARTS))
    chosen = parser.parse_args()
    yardstick = native.yardstick()
    scans = [number % SCANS for number in range(chosen.rounds + 1)]
    FIGURES.mkdir(parents=True, exist_ok=True)
    texts, figures = [], {}
    for part in chosen.only:
        text, numbers = PARTS[part](yardstick, scans)
        texts.append(text)
        figures |= numbers
        print(texts[-1], end="\n\n", flush=True)
    print(made_with())
    table = native.BUILT / "table.md"
    (FIGURES / "peers.json").write_text(json.dumps(figures, indent=1), encoding="utf-8")
    table.write_text("\n\n".join([*texts, made_with()]) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
