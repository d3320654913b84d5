"""Python functions of the package that `lidar-core detect` calls from one scan to the next.

    python tests/functions_per_scan.py [RECORDING]

Without RECORDING one is simulated. No run.mcap and no picture: what is counted is the way of a scan
from the file through the detector into the tables of the run.
"""

import sys
import tempfile
from collections import Counter
from pathlib import Path
from typing import Any

import lidar_core

PACKAGE = Path(lidar_core.__file__).parent
PROCESS = "FlyingObjectDetector.process"  # of the core: one call per scan
WARM_SCANS = 45  # imports, caches; 40 scans decide whether the poses' frame is right
COMPREHENSIONS = {"<genexpr>", "<listcomp>", "<dictcomp>", "<setcomp>", "<lambda>"}


def main() -> None:
    """Print the functions that one scan passes, and how many there are."""
    with tempfile.TemporaryDirectory() as folder:
        recording = Path(sys.argv[1]) if len(sys.argv) > 1 else simulated(Path(folder))
        counts = functions_per_scan(recording, Path(folder))
    for (file, name), count in sorted(counts.items()):
        print(f"{file}: {name} x {count}")
    print(f"{len(counts)} functions in {len({file for file, _ in counts})} files")


def simulated(folder: Path) -> Path:
    """A recording of a short scene, with poses and times of points."""
    from lidar_core.sim import scenes
    from lidar_core.sim.recording import record

    scene = scenes.demo(0, scans=WARM_SCANS + 5)
    lidar = type(scene.lidar).preset("vlp-16")
    path = folder / "scene.npz"
    record(scene.model_copy(update={"lidar": lidar}), path, seed=0)
    return path


def functions_per_scan(recording: Path, folder: Path) -> Counter[tuple[str, str]]:
    """Python functions of the package between two calls of the core's detector."""
    from lidar_core.cli import app

    calls: list[Counter[tuple[str, str]]] = [Counter()]

    def watch(frame: Any, event: str, argument: Any) -> None:
        if event == "c_call" and getattr(argument, "__qualname__", "") == PROCESS:
            calls.append(Counter())
        code = frame.f_code
        if event == "call" and code.co_filename.startswith(str(PACKAGE)):
            name = getattr(code, "co_qualname", code.co_name)
            if code.co_name not in COMPREHENSIONS:
                calls[-1][str(Path(code.co_filename).relative_to(PACKAGE)), name] += 1

    words = ["detect", str(recording), "-o", str(folder / "run"), "--no-picture", "--threads", "1"]
    sys.setprofile(watch)
    try:
        app([*words, "--no-mcap"], standalone_mode=False)
    finally:
        sys.setprofile(None)
    if len(calls) < WARM_SCANS:
        sys.exit(f"expected at least {WARM_SCANS} scans, got {len(calls)}")
    return calls[WARM_SCANS - 1]


if __name__ == "__main__":
    main()
