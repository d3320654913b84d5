"""Conversion of stamps of a sensor's clock to the clock of this machine."""

from collections import deque
from dataclasses import replace

from lidar_core.io.records import Findings
from lidar_core.live.stats import told_difference
from lidar_core.messages import Scan

SYNCHRONISED_NS = 500_000_000
"""Clocks that differ by less are taken for synchronised (PTP): stamps stay as they are."""
KEPT = 600
"""Scans by which the difference is estimated: a minute, so that drift is followed."""


class SensorClock:
    """Offset between two clocks, estimated from arrivals, which can only be late.

    The least difference between the arrival and the newest measurement is the offset of the clocks
    plus the shortest delay of the network.
    """

    def __init__(self, findings: Findings) -> None:
        self._findings = findings
        self._differences: deque[int] = deque(maxlen=KEPT)

    def to_local_clock(self, scan: Scan, arrival_ns: int) -> Scan:
        """Return the scan with stamps of the clock of this machine."""
        times = scan.point_time_ns
        newest = scan.stamp_ns if times is None or not times.size else int(times.max())
        self._differences.append(arrival_ns - newest)
        shift = min(self._differences)
        if abs(shift) < SYNCHRONISED_NS:
            return scan
        self._findings.note(
            "stamps are moved to the clock of this machine, from which that of the sensor differs:"
            f" {told_difference(self._differences[0] * 1e-6)}; PTP makes them exact"
        )
        moved_times = None if times is None else times + shift
        return replace(scan, stamp_ns=scan.stamp_ns + shift, point_time_ns=moved_times)
