"""Results of benches: collected into one file per machine, and read again."""

import json
import os
import platform
import re
import subprocess
from datetime import date
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[2]
RESULTS = ROOT / "benches/results"
NS_TO_MS = 1e-6

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


def read_machines(folder: Path = RESULTS) -> list[Machine]:
    """All files of results, by name."""
    paths = sorted(folder.glob("*.json"))
    return [json.loads(path.read_text(encoding="utf-8")) for path in paths]
