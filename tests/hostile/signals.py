"""`python -m hostile.signals`: Ctrl-C in calls of millions of points, at many times.

From the signal on a call may cost 0.2 s of the processor. On an idle machine the time of the clock
is hardly longer; beside other work it is whatever the system leaves to the call.
"""

import argparse
import json
import subprocess
import sys
from pathlib import Path

PROGRAM = Path(__file__).parents[1] / "python" / "helpers" / "stopped_calls.py"
MOST_CPU_S = 0.2


def main() -> int:
    """Print the worst of every call; 1 if one cost too much, or left its object changed by half."""
    parser = argparse.ArgumentParser(prog="python -m hostile.signals", description=__doc__)
    parser.add_argument("--points", type=int, default=2_000_000)
    parser.add_argument("--times", type=int, default=10, help="signals per call")
    chosen = parser.parse_args()
    told = [sys.executable, PROGRAM, str(chosen.points), str(chosen.times)]
    found = json.loads(subprocess.run(told, capture_output=True, text=True, check=True).stdout)
    bad = 0
    for name, call in found.items():
        if "rows" not in call:
            continue
        rows = call["rows"]
        cpu, wall = (max(row[key] for row in rows) for key in ("cpu", "wall"))
        torn = sum(row.get("state") == "neither" for row in rows)
        stopped = sum(row["stopped"] for row in rows)
        print(
            f"{name}: {len(rows)} signals, {stopped} stopped a call,"
            f" worst {1e3 * cpu:.0f} ms of CPU, {1e3 * wall:.0f} ms by the clock,"
            f" {torn} left half a change"
        )
        bad += cpu > MOST_CPU_S or torn > 0 or stopped == 0
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
