"""Leave scans of a real OS1-128 where the benches look for them: `make bench` calls this.

Needs recordings in the folder that LIDAR_CORE_DATA names.
"""

import os
import sys
from itertools import islice
from pathlib import Path

import numpy as np

import lidar_core as lc
from lidar_core.messages import Scan

RECORDING = "3d/ouster/OS-1-128_v2.3.0_1024x10_lb_n3.pcap"
SCANS = 3


def main(folder: Path) -> None:
    """Write directions and ends of the rays, as `benches/files.rs` reads them."""
    recording = Path(os.environ.get("LIDAR_CORE_DATA", "../shared/data")) / RECORDING
    if not recording.is_file():
        print(f"{recording} is not there: the benches take simulated scans only")
        return
    folder.mkdir(parents=True, exist_ok=True)
    count = 0
    messages = lc.io.open_recording(recording)
    for scan in islice((one for one in messages if isinstance(one, Scan)), SCANS):
        points = scan.points.reshape(-1, 3)
        rows = np.hstack([scan.directions.reshape(-1, 3), points]).astype("<f4")
        rows[~np.isfinite(points).all(axis=1), 3:] = np.nan
        rows.tofile(folder / f"{count}.f32")
        count += 1
    np.zeros((count, 3), "<f8").tofile(folder / "origins.f64")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
