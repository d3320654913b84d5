"""Differences from the golden files on the vector unit that `LIDAR_CORE_SIMD` names, one a line.

Arguments: threads, scenes. The variable is read once in a process, so tests start one per unit.
"""

import json
import sys

from golden import digest
from golden.scenes import played
from lidar_core._core import vector_unit

if __name__ == "__main__":
    threads, scenes = json.loads(sys.argv[1]), sys.argv[2:]
    found = []
    for scene in scenes:
        expected = digest.golden("flying")[scene]
        for count in threads:
            got = digest.under_old_names(played("flying", scene, count), expected, digest.renames())
            found += digest.differences(f"{scene}, {count} threads", expected, got)
    sys.stdout.write(json.dumps({"unit": vector_unit(), "differences": found}) + "\n")
